//! The medium as the tracer sees it: constant coefficients per cell, per spectral group.
//!
//! Knows nothing of droplets, vapour or fuels; those are turned into coefficients in `scene::optics`.

use super::error::TracerError;
use crate::light::phase::PhaseFunction;
use rayon::prelude::*;

/// Marks an empty cell in [`GridMedium::index`].
pub const EMPTY: u32 = u32::MAX;

/// Values that are checked in one go.
const CHECKED: usize = 4096;

/// A box of equal cells, constant inside each cell; empty cells cost four bytes.
///
/// All coefficients are in 1/m. Group `g` of `groups` is one wavelength sample; channel `c` of `channels` is one
/// set of sources. The emission coefficient of a channel is Σ_species k_abs · S with S the source of that channel:
/// channel 0 has S = 1 for everything, so that its image is the coefficient a_medium and the walls follow by
/// closure (1 − a_plate − a_medium); further channels hold radiances B(λ_g, T_cell), or zones.
#[derive(Debug, Clone)]
pub struct GridMedium {
    /// Lower corner in metres.
    pub lower_m: [f64; 3],
    /// Upper corner in metres.
    pub upper_m: [f64; 3],
    /// Number of cells along x, y, z.
    pub cells: [usize; 3],
    /// Number of spectral groups, at least 1.
    pub groups: usize,
    /// Number of emission channels, at least 1.
    pub channels: usize,
    /// Ordinal of the coefficients of cell `(x · ny + y) · nz + z`, or [`EMPTY`].
    pub index: Vec<u32>,
    /// Extinction, `[ordinal][group]`.
    pub k_ext: Vec<f64>,
    /// Scattering, `[ordinal][group]`; at most the extinction.
    pub k_sca: Vec<f64>,
    /// Emission coefficients (k_abs · source), `[ordinal][channel][group]`.
    pub emission: Vec<f64>,
    /// Phase function of each group, for the whole medium.
    pub phase: Vec<PhaseFunction>,
}

impl GridMedium {
    /// Number of occupied cells.
    pub fn occupied(&self) -> usize {
        self.k_ext.len() / self.groups.max(1)
    }

    /// Checks shapes and values: every loop of the tracer relies on it.
    ///
    /// # Errors
    ///
    /// [`TracerError::Shape`] where an array does not fit, [`TracerError::Geometry`] for a box without volume,
    /// [`TracerError::Coefficient`] for a negative or undefined coefficient or scattering above extinction.
    pub fn check(&self) -> Result<(), TracerError> {
        let shape = |what, found, expected| {
            if found == expected { Ok(()) } else { Err(TracerError::Shape { what, found, expected }) }
        };
        if self.groups == 0 || self.channels == 0 {
            return Err(TracerError::Geometry {
                what: "the numbers of groups and channels",
                condition: "at least 1",
            });
        }
        let span = |a: usize| self.upper_m[a] - self.lower_m[a];
        if !(0..3).all(|a| self.cells[a] > 0 && span(a) > 0.0 && span(a).is_finite()) {
            return Err(TracerError::Geometry {
                what: "the medium's box",
                condition: "of positive finite size with at least one cell",
            });
        }
        shape("index", self.index.len(), self.cells[0] * self.cells[1] * self.cells[2])?;
        let occupied = self.occupied();
        shape("k_ext", self.k_ext.len(), occupied * self.groups)?;
        shape("k_sca", self.k_sca.len(), self.k_ext.len())?;
        shape("emission", self.emission.len(), self.k_ext.len() * self.channels)?;
        shape("phase", self.phase.len(), self.groups)?;
        // One more than the largest ordinal that is not [`EMPTY`], which wraps to zero.
        let beyond = self
            .index
            .par_chunks(CHECKED)
            .map(|chunk| chunk.iter().fold(0, |most: u32, &i| most.max(i.wrapping_add(1))))
            .reduce(|| 0, u32::max);
        if beyond as usize > occupied {
            let entry = self.index.iter().position(|&i| i != EMPTY && i as usize >= occupied).unwrap_or(0);
            let value = f64::from(self.index[entry]);
            return Err(TracerError::Coefficient {
                what: "index",
                entry,
                value,
                condition: "an ordinal or EMPTY",
            });
        }
        for (what, values) in [("k_ext", &self.k_ext), ("k_sca", &self.k_sca), ("emission", &self.emission)] {
            let good = |v: f64| (0.0..=f64::MAX).contains(&v);
            if let Some(entry) = first_bad(values, values, |v, _| good(v)) {
                let (value, condition) = (values[entry], "finite and not negative");
                return Err(TracerError::Coefficient { what, entry, value, condition });
            }
        }
        // A sum of two roundings may exceed the extinction by a few units in the last place.
        if let Some(entry) = first_bad(&self.k_sca, &self.k_ext, |s, e| s <= e * (1.0 + 1e-12)) {
            let value = self.k_sca[entry];
            return Err(TracerError::Coefficient { what: "k_sca", entry, value, condition: "at most k_ext" });
        }
        Ok(())
    }
}

/// Place of the first pair of values that is not good. Whole chunks are looked through without branches.
fn first_bad(a: &[f64], b: &[f64], good: impl Fn(f64, f64) -> bool + Sync) -> Option<usize> {
    let chunk = a
        .par_chunks(CHECKED)
        .zip(b.par_chunks(CHECKED))
        .position_first(|(a, b)| !a.iter().zip(b).fold(true, |all, (&a, &b)| all & good(a, b)))?;
    let start = chunk * CHECKED;
    a[start..].iter().zip(&b[start..]).position(|(&a, &b)| !good(a, b)).map(|i| start + i)
}
