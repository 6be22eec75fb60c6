//! The light that leaves the walls of a chamber: gray, diffuse, mirrored between the walls and the plate.
//!
//! J_k = ε_k B(T_k) + (1 − ε_k) (Σ_j F_kj J_j + F_kp J_plate), one radiosity per wall, J and B as radiances. Solved once as a
//! linear map from the sources, so that any temperatures are lit without tracing. Left out: that the light on a wall varies
//! over it, and that the spray stands in the way of light between walls. The latter changes the light that falls on a wall
//! by at most the share of its view that the spray stops, times the contrast of walls, plate and spray; of the wall's
//! radiosity (1 − ε) of it; sprays that fill little of the chamber are far below the target of an image.

mod facing;
pub mod view;

use crate::tracer::chamber::{Chamber, ENDS, OUTSIDE, SIDES};
use crate::tracer::plate::Plate;
use facing::Facing;

/// Sources of light: the six walls, the plate, the place outside.
pub const SOURCES: usize = SIDES + 2;

/// The plate among the sources and the surfaces.
pub const PLATE: usize = SIDES;

/// The place outside among the sources.
pub const BEYOND: usize = SIDES + 1;

/// Surfaces: the six walls and the plate.
const SURFACES: usize = SIDES + 1;

/// A chamber's exchange of light between walls and plate.
#[derive(Debug, Clone)]
pub struct Enclosure {
    /// Share of what a surface receives that comes from each source, unit rows, `[wall or plate][wall, plate, outside]`.
    factors: [[f64; SOURCES]; SURFACES],
}

impl Enclosure {
    /// View factors of a chamber's walls, and of the plate in it or behind an opening.
    ///
    /// The plate takes from the walls what it hides of them: light between two walls that it would stop counts for neither.
    pub fn new(chamber: &Chamber, plate: Option<&Plate>) -> Self {
        let size = [0, 1, 2].map(|a: usize| chamber.upper_m()[a] - chamber.lower_m()[a]);
        let exchange = view::exchange_areas(size);
        let facing = plate.map_or(Facing::NOTHING, |plate| Facing::new(chamber, plate));
        let mut factors = [[0.0; SOURCES]; SURFACES];
        for (i, row) in factors[..SIDES].iter_mut().enumerate() {
            for j in 0..SIDES {
                row[j] = (exchange[i][j] - facing.hidden[i][j] - facing.hidden[j][i]).max(0.0);
            }
            row[PLATE] = facing.hidden[i].iter().sum();
            if row.iter().sum::<f64>() <= 1e-12 * exchange[i].iter().sum::<f64>() {
                // A wall that the plate covers as a whole: nobody sees it.
                row[..SIDES].copy_from_slice(&exchange[i]);
            }
        }
        let [ends @ .., outside] = facing.seen;
        factors[PLATE][..SIDES].copy_from_slice(&ends);
        factors[PLATE][BEYOND] = outside;
        for row in &mut factors {
            let sum: f64 = row.iter().sum();
            row.iter_mut().for_each(|f| *f /= sum);
        }
        Self { factors }
    }

    /// View factors from a wall, or from [`PLATE`], to the walls, the plate and the place outside; they sum to 1.
    pub fn factors(&self, surface: usize) -> [f64; SOURCES] {
        self.factors[surface]
    }

    /// The map from sources to radiosities for emissivities in (0, 1] of the walls and of the plate.
    pub fn radiosity(&self, emissivity: &[f64; SIDES], plate_emissivity: f64) -> Radiosity {
        // An absorbing Markov chain: light seen on a surface was emitted by it, or came from one that it sees. Eliminating
        // surface after surface (W. Grassmann, M. Taksar, D. Heyman, Oper. Res. 33, 1107, 1985) subtracts nothing: rows sum
        // to 1 and every entry keeps its digits for any emissivity.
        let mut onward = [[0.0; SURFACES]; SURFACES];
        let mut emitted = [[0.0; SOURCES]; SURFACES];
        for surface in 0..SURFACES {
            let own = emissivity.get(surface).copied().unwrap_or(plate_emissivity);
            for (to, factor) in onward[surface].iter_mut().zip(self.factors[surface]) {
                *to = (1.0 - own) * factor;
            }
            emitted[surface][BEYOND] = (1.0 - own) * self.factors[surface][BEYOND];
            emitted[surface][surface] = own;
        }
        for k in 0..SURFACES {
            onward[k][k] = 0.0;
            let sum = onward[k].iter().sum::<f64>() + emitted[k].iter().sum::<f64>();
            onward[k].iter_mut().chain(&mut emitted[k]).for_each(|share| *share /= sum);
            let from = (onward[k], emitted[k]);
            for i in (0..SURFACES).filter(|&i| i != k) {
                let part = std::mem::take(&mut onward[i][k]);
                let shares = onward[i].iter_mut().chain(&mut emitted[i]);
                for (share, from) in shares.zip(from.0.iter().chain(&from.1)) {
                    *share += part * from;
                }
            }
        }
        Radiosity { map: emitted }
    }
}

/// Radiosities as means of sources.
#[derive(Debug, Clone, PartialEq)]
pub struct Radiosity {
    /// `[wall or plate][source]`, rows sum to 1.
    map: [[f64; SOURCES]; SURFACES],
}

impl Radiosity {
    /// The radiances that leave the walls, with that of the place outside ([`ENDS`] in all), and the plate, for the black
    /// body radiances of the walls, the plate and the place outside; all in one unit. Sources that are all alike are given
    /// back to the bit.
    pub fn lit(&self, sources: &[f64; SOURCES]) -> ([f64; ENDS], f64) {
        let light = |surface: usize| {
            let own = sources[surface];
            let contrast = |(share, source): (&f64, &f64)| share * (source - own);
            own + self.map[surface].iter().zip(sources).map(contrast).sum::<f64>()
        };
        let ends = std::array::from_fn(|end| if end == OUTSIDE { sources[BEYOND] } else { light(end) });
        (ends, light(PLATE))
    }
}

#[cfg(test)]
mod tests;
