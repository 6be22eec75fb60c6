//! How one shot's densities differ from the mean spray's: a factor per cell, smooth, seeded, conservative.
//!
//! Three causes, independent, each with mean 1 in every cell: the mass of each plume (log-normal), the direction of each
//! plume (to first order in the tilt δ of a Gaussian plume of the same half width, exp(δ·g − σ²|g|²/2) with
//! g = −∂ln ρ/∂δ), and turbulence (log-normal; eddies grow with the distance r from the tip: the field is isotropic in
//! (ln r, direction), correlation exp(−Δ²/2λ²) with λ = integral scale/r/√(π/2); relative fluctuations grow from the
//! axis to the edge as the mean's root falls, Becker, Hottel and Williams 1967, J. Fluid Mech. 30, 285). In the end each plume's mass is put
//! right, so that tilt and turbulence move fuel but make none; with many eddies to a plume that changes a cell's mean by
//! less than a hundredth, with eddies of a plume's size it takes away the part of the fluctuation that a plume shares.
//!
//! Random numbers are counter-based and keyed by (seed, shot): the same bits for any number of threads.

use super::description::ShotLaw;
use super::place::{Place, dot};
use super::spread::{Scattered, Spreading};
use crate::rig::noise::{Purpose, Stream};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

/// Cosine modes of the turbulence.
const MODES: usize = 96;
/// Distance from the tip in m below which eddies do not get smaller.
const CORE_M: f64 = 1e-3;
/// Largest fluctuation at the edge over that on the axis.
const STIRRED_MAX: f64 = 4.0;
/// −dln f/dη over η of the Gaussian that has Abramovich's half width, 0.441 of the full one: 2 ln 2 / 0.441².
const GAUSSIAN: f64 = 7.13;

/// One plume's part of a cell.
#[derive(Debug, Clone, Copy)]
struct Part {
    jet: u32,
    /// Fuel in kg.
    fuel_kg: f64,
    /// Change of ln ρ with the tilt in two directions, per rad.
    slope: [f64; 2],
    /// Fluctuations here over those on the axis.
    stirred: f64,
}

/// The law by which the shots of a spray differ, on the occupied cells of its grid.
#[derive(Debug, Clone)]
pub struct SprayShots {
    seed: u64,
    law: ShotLaw,
    jets: usize,
    /// Per occupied cell: (ln r, direction)/λ.
    places: Vec<[f64; 4]>,
    /// Per occupied cell the range of `parts`; one entry more than cells.
    start: Vec<usize>,
    parts: Vec<Part>,
}

impl SprayShots {
    pub(super) fn new(
        spreading: &Spreading<'_>,
        scattered: &Scattered,
        cells: &[u32],
        tip_m: [f64; 3],
        law: ShotLaw,
        seed: u64,
    ) -> Self {
        let grid = &spreading.grid;
        let size = grid.cell_m();
        let centre = |cell: u32| -> [f64; 3] {
            let index = grid.cell(cell as usize);
            std::array::from_fn(|a| grid.lower_m[a] + (index[a] as f64 + 0.5) * size[a])
        };
        let lambda = law.integral_scale / FRAC_PI_2.sqrt();
        let places = cells
            .iter()
            .map(|&cell| {
                let at = centre(cell);
                let from: [f64; 3] = std::array::from_fn(|a| at[a] - tip_m[a]);
                let r = dot(from, from).sqrt().hypot(CORE_M);
                [r.ln() / lambda, from[0] / (r * lambda), from[1] / (r * lambda), from[2] / (r * lambda)]
            })
            .collect();
        let mut lists = vec![Vec::new(); cells.len()];
        for (jet, fuel) in (0_u32..).zip(spreading.fuel_by_jet(scattered)) {
            let mut ordinal = 0;
            for (cell, fuel_kg) in fuel {
                while cells[ordinal] < cell {
                    ordinal += 1;
                }
                let (slope, eta) = slope(spreading, jet as usize, centre(cell));
                let stirred = (0.25 * GAUSSIAN * eta * eta).exp().min(STIRRED_MAX);
                lists[ordinal].push(Part { jet, fuel_kg, slope, stirred });
            }
        }
        let mut start = vec![0];
        let mut parts = Vec::new();
        for list in lists {
            parts.extend(list);
            start.push(parts.len());
        }
        Self { seed, law, jets: spreading.place.jets(), places, start, parts }
    }

    /// The same law with other random numbers.
    #[must_use]
    pub fn with_seed(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// Whether shots differ at all.
    pub fn fluctuates(&self) -> bool {
        let ShotLaw { turbulence, mass, angle_deg, .. } = self.law;
        turbulence > 0.0 || mass > 0.0 || angle_deg > 0.0
    }

    /// Factors of shot number `shot` on the densities of liquid and vapour, one per occupied cell of the field, in its
    /// order.
    pub fn factors(&self, shot: u64) -> Vec<f32> {
        let stream = Stream::new(self.seed, Purpose::Plumes, shot);
        let deviation = |relative: f64| (relative * relative).ln_1p().sqrt();
        let sigma_mass = deviation(self.law.mass);
        let sigma_tilt = self.law.angle_deg.to_radians();
        let draws: Vec<[f64; 3]> = (0..self.jets as u64)
            .map(|jet| std::array::from_fn(|i| stream.gaussian(3 * jet + i as u64)))
            .collect();
        let turbulence = self.turbulence(shot);
        // Per part tilt × turbulence, then each plume's mass is put right.
        let cells = 0..self.places.len();
        let raw: Vec<f64> = cells
            .clone()
            .into_par_iter()
            .flat_map_iter(|cell| {
                let eddy = turbulence[cell];
                let draws = &draws;
                self.parts[self.start[cell]..self.start[cell + 1]].iter().map(move |part| {
                    let [_, x, y] = draws[part.jet as usize];
                    let sigma = deviation(self.law.turbulence * part.stirred);
                    let [gx, gy] = part.slope.map(|g| g * sigma_tilt);
                    (x * gx + y * gy - 0.5 * (gx * gx + gy * gy) + sigma * eddy - 0.5 * sigma * sigma).exp()
                })
            })
            .collect();
        let mut sums = vec![[0.0; 2]; self.jets];
        for (part, factor) in self.parts.iter().zip(&raw) {
            sums[part.jet as usize][0] += part.fuel_kg;
            sums[part.jet as usize][1] += part.fuel_kg * factor;
        }
        let scale: Vec<f64> = sums
            .iter()
            .zip(&draws)
            .map(|([wanted, made], draw)| {
                let mass = (sigma_mass * draw[0] - 0.5 * sigma_mass * sigma_mass).exp();
                if *made > 0.0 { mass * wanted / made } else { mass }
            })
            .collect();
        cells
            .map(|cell| {
                let range = self.start[cell]..self.start[cell + 1];
                let (mut before, mut after) = (0.0, 0.0);
                for (part, factor) in self.parts[range.clone()].iter().zip(&raw[range]) {
                    before += part.fuel_kg;
                    after += part.fuel_kg * factor * scale[part.jet as usize];
                }
                #[expect(clippy::cast_possible_truncation, reason = "densities are in single precision")]
                let factor = if before > 0.0 { (after / before) as f32 } else { 1.0 };
                factor
            })
            .collect()
    }

    /// Fuel of a cell in kg.
    #[cfg(test)]
    pub(super) fn fuel_kg(&self, cell: usize) -> f64 {
        self.parts[self.start[cell]..self.start[cell + 1]].iter().map(|part| part.fuel_kg).sum()
    }

    /// Cells of one plume only that are within η of its middle.
    #[cfg(test)]
    pub(super) fn middle(&self, eta: f64) -> Vec<usize> {
        let limit = (0.25 * GAUSSIAN * eta * eta).exp();
        (0..self.places.len())
            .filter(|&cell| {
                let parts = &self.parts[self.start[cell]..self.start[cell + 1]];
                parts.len() == 1 && parts[0].stirred < limit
            })
            .collect()
    }

    /// Place of a cell: (ln r, direction)/λ.
    #[cfg(test)]
    pub(super) fn place(&self, cell: usize) -> [f64; 4] {
        self.places[cell]
    }

    /// Standard normal numbers, smooth in space, per occupied cell.
    fn turbulence(&self, shot: u64) -> Vec<f64> {
        if self.law.turbulence <= 0.0 {
            return vec![0.0; self.places.len()];
        }
        let eddies = self.eddies(shot);
        self.places.par_iter().map(|&place| eddies.at(place)).collect()
    }

    /// The turbulence of a shot.
    pub(super) fn eddies(&self, shot: u64) -> Eddies {
        let stream = Stream::new(self.seed, Purpose::Turbulence, shot);
        let mut eddies = Eddies { waves: [[0.0; MODES]; 4], phases: [0.0; MODES], amplitudes: [0.0; MODES] };
        for (i, mode) in (0..MODES as u64).enumerate() {
            for (a, wave) in (0..4_u64).zip(&mut eddies.waves) {
                wave[i] = stream.gaussian(8 * mode + a) / (2.0 * PI);
            }
            eddies.amplitudes[i] = (-2.0 * stream.uniform(8 * mode + 4).ln() / MODES as f64).sqrt();
            eddies.phases[i] = stream.uniform(8 * mode + 5);
        }
        eddies
    }
}

/// A sum of cosines that is normal at every place: Rayleigh amplitudes and even phases are pairs of normal amplitudes of
/// cosine and sine.
pub(super) struct Eddies {
    /// Wave vectors of the modes, axis by axis, in turns, and phases in turns.
    waves: [[f64; MODES]; 4],
    phases: [f64; MODES],
    amplitudes: [f64; MODES],
}

impl Eddies {
    /// The standard normal number at a place (ln r, direction)/λ.
    pub(super) fn at(&self, place: [f64; 4]) -> f64 {
        // One mode after another in each step, so that steps are done several modes at a time.
        let mut values = self.phases;
        for (wave, along) in self.waves.iter().zip(place) {
            for (turns, k) in values.iter_mut().zip(wave) {
                *turns += k * along;
            }
        }
        for (value, amplitude) in values.iter_mut().zip(&self.amplitudes) {
            *value = amplitude * cosine(*value);
        }
        values.iter().sum()
    }
}

/// cos 2πx to 1e-14, for |x| below 2⁵¹; the same bits on every machine.
fn cosine(turns: f64) -> f64 {
    // Adding and taking away 1.5 · 2⁵² rounds to a whole number.
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    let part = turns - ((turns + WHOLE) - WHOLE);
    // cos 2πx = 1 − 2 sin² πx, and the series of sin y up to y = π/2, y²¹/21! < 3e-16.
    let y = PI * part;
    let square = y * y;
    let mut sum = 0.0;
    for term in SINE {
        sum = sum * square + term;
    }
    let sine = y * sum;
    1.0 - 2.0 * sine * sine
}

/// Coefficients of the series of sin y / y in y², the highest first: ±1/(2n + 1)!.
const SINE: [f64; 10] = [
    -8.220_635_246_624_33e-18,
    2.811_457_254_345_520_6e-15,
    -7.647_163_731_819_816e-13,
    1.605_904_383_682_161_3e-10,
    -2.505_210_838_544_172e-8,
    2.755_731_922_398_589_3e-6,
    -1.984_126_984_126_984e-4,
    8.333_333_333_333_333e-3,
    -1.666_666_666_666_666_6e-1,
    1.0,
];

/// −∂ln ρ/∂δ of a plume at a place, how much denser it gets there by a tilt of the plume, per rad; and η there.
fn slope(spreading: &Spreading<'_>, jet: usize, at: [f64; 3]) -> ([f64; 2], f64) {
    let (s, aside, towards) = spreading.place.seen(jet, at);
    let half = spreading.jet.start.opening.half_m(s.max(0.0));
    let eta = (aside / half).clamp(-1.0, 1.0);
    let slope = GAUSSIAN * eta * s.max(0.0) / half;
    match spreading.place {
        Place::Holes(_) => ([slope * towards[0], slope * towards[1]], eta),
        // A sheet can only open or close.
        Place::Cone { .. } => ([slope, 0.0], eta),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cosine_is_the_librarys() {
        for i in -20_000..20_000 {
            let turns = f64::from(i) * 7.3e-4;
            let error = cosine(turns) - libm::cos(2.0 * PI * turns);
            // 2π times the rounding of up to 15 turns.
            assert!(error.abs() < 2e-14, "{turns}: {error}");
        }
        for (turns, expected) in
            [(0.0, 1.0), (0.25, 0.0), (0.5, -1.0), (-3.0, 1.0), (1e9 + 0.125, 0.5_f64.sqrt())]
        {
            assert!((cosine(turns) - expected).abs() < 1e-14, "{turns}");
        }
    }
}
