//! Phase functions: isotropic, Rayleigh, Henyey–Greenstein, tables, Mie.
//!
//! Each one evaluates, samples what it evaluates in constant time, and knows its mean cosine. Polarisation is absent.
//!
//! - [`PhaseTable`]: a user's table, linear in the angle;
//! - [`mie`]: the mean of many spheres, to an error that is chosen;
//! - [`truncation`]: what to do without the forward peak, and what that costs.

mod cells;
mod henyey_greenstein;
mod inverse;
pub mod mie;
mod rayleigh;
mod table;
pub mod truncation;

pub use cells::PhaseCells;
pub use table::{PhaseTable, SAMPLING_ERROR};

use std::f64::consts::PI;
use std::sync::Arc;

/// An angular distribution of scattered light, normalised so that ½∫p dμ = 1.
#[derive(Debug, Clone)]
pub enum PhaseFunction {
    /// The same into all directions.
    Isotropic,
    /// Henyey and Greenstein (1941) with mean cosine `asymmetry` in [−1, 1].
    HenyeyGreenstein {
        /// Mean cosine.
        asymmetry: f64,
    },
    /// Spheres much smaller than the wavelength: ¾ (1 + μ²).
    Rayleigh,
    /// A table over the scattering angle, linear in the angle between nodes. Samples follow it to [`SAMPLING_ERROR`].
    Table(Arc<PhaseTable>),
    /// Linear in the cosine between nodes, sampled exactly as evaluated.
    Cells(Arc<PhaseCells>),
}

/// Why there is no phase function.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhaseError {
    /// phase table: {angles} angles and {values} values; give at least two pairs
    #[error("phase table: {angles} angles and {values} values; give at least two pairs")]
    Length {
        /// Number of angles given.
        angles: usize,
        /// Number of values given.
        values: usize,
    },
    /// phase table: the angles must rise from 0 to 180 degrees, entry {entry} does not
    #[error("phase table: the angles must rise from 0 to 180 degrees, entry {entry} does not")]
    Angle {
        /// Index of the first bad angle.
        entry: usize,
    },
    /// phase table: entry {entry} is negative or not a number
    #[error("phase table: entry {entry} is negative or not a number")]
    Value {
        /// Index of the first bad value.
        entry: usize,
    },
    /// phase table: it is zero at all angles
    #[error("phase table: it is zero at all angles")]
    Zero,
    /// phase function: the values have the mean cosine {found}, it should be {asymmetry}; give more angles
    #[error(
        "phase function: the values have the mean cosine {found}, it should be {asymmetry}; give more angles"
    )]
    Unresolved {
        /// Mean cosine of the values.
        found: f64,
        /// Mean cosine that was claimed.
        asymmetry: f64,
    },
    /// phase function: sphere {entry}: {problem}
    #[error("phase function: sphere {entry}: {problem}")]
    Sphere {
        /// Index of the first bad sphere.
        entry: usize,
        /// What is wrong with it.
        problem: String,
    },
    /// phase function: a cone of {half_angle_rad} rad cannot be cut off; give an angle between 0 and pi/2
    #[error(
        "phase function: a cone of {half_angle_rad} rad cannot be cut off; give an angle between 0 and pi/2"
    )]
    Cone {
        /// The half angle asked for.
        half_angle_rad: f64,
    },
}

impl PhaseFunction {
    /// The phase function at the cosine of the scattering angle (1 = forward), normalised so that ½∫p dμ = 1.
    ///
    /// At asymmetry ±1 the function is a Dirac peak: zero everywhere but at the peak itself, where the largest
    /// finite number stands for it.
    pub fn value(&self, cosine: f64) -> f64 {
        self.at_versine(1.0 - cosine.clamp(-1.0, 1.0))
    }

    /// The cosine of the scattering angle below which the fraction `u` in [0, 1] of the light is scattered. Distributed as `value` when `u` is uniform.
    pub fn sample(&self, u: f64) -> f64 {
        match self {
            Self::Isotropic => (2.0 * u - 1.0).clamp(-1.0, 1.0),
            Self::HenyeyGreenstein { asymmetry } => henyey_greenstein::sample(*asymmetry, u),
            Self::Rayleigh => rayleigh::sample(u),
            Self::Table(table) => 1.0 - table.cells().sample(1.0 - u),
            Self::Cells(cells) => 1.0 - cells.cells().sample(1.0 - u),
        }
    }

    /// The mean cosine ½∫p μ dμ.
    pub fn mean_cosine(&self) -> f64 {
        match self {
            Self::Isotropic | Self::Rayleigh => 0.0,
            Self::HenyeyGreenstein { asymmetry } => *asymmetry,
            Self::Table(table) => 1.0 - table.cells().mean_versine(),
            Self::Cells(cells) => cells.mean_cosine(),
        }
    }

    /// The share of the light that is scattered by less than the angle of this cosine: the inverse of
    /// [`sample`](Self::sample) with u = 1 − share.
    pub fn within(&self, cosine: f64) -> f64 {
        let versine = 1.0 - cosine.clamp(-1.0, 1.0);
        match self {
            Self::Isotropic => 0.5 * versine,
            Self::HenyeyGreenstein { asymmetry } => henyey_greenstein::within(*asymmetry, versine),
            Self::Rayleigh => rayleigh::within(versine),
            Self::Table(table) => table.cells().within(versine),
            Self::Cells(cells) => cells.cells().within(versine),
        }
    }

    /// The phase function at 1 − cos θ in [0, 2].
    fn at_versine(&self, versine: f64) -> f64 {
        match self {
            Self::Isotropic => 1.0,
            Self::HenyeyGreenstein { asymmetry } => henyey_greenstein::value(*asymmetry, versine),
            Self::Rayleigh => rayleigh::value(1.0 - versine),
            Self::Table(table) => table.at_versine(versine),
            Self::Cells(cells) => cells.cells().value(versine),
        }
    }

    /// Angles from 0 to π between which the function is smooth and changes little.
    fn smooth_between(&self) -> Vec<f64> {
        /// Equal steps of the angle, and of the cumulative distribution.
        const STEPS: u32 = 64;
        let mut bounds: Vec<f64> = match self {
            Self::Table(table) => table.theta_rad().to_vec(),
            Self::Cells(cells) => cells.theta_rad(),
            Self::Isotropic | Self::Rayleigh => Vec::new(),
            Self::HenyeyGreenstein { .. } => (0..=STEPS)
                .map(|i| inverse::angle(1.0 - self.sample(f64::from(i) / f64::from(STEPS))))
                .collect(),
        };
        bounds.extend((0..=STEPS).map(|i| PI * f64::from(i) / f64::from(STEPS)));
        bounds.sort_unstable_by(f64::total_cmp);
        // Pieces narrower than this hold nothing that a double could tell apart.
        bounds.dedup_by(|next, kept| *next - *kept <= 1e-14 * PI);
        bounds[0] = 0.0;
        let last = bounds.len() - 1;
        bounds[last] = PI;
        bounds
    }
}

#[cfg(test)]
mod mie_tests;
#[cfg(test)]
mod slab;
#[cfg(test)]
mod tests;
