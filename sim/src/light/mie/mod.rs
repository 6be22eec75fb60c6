//! Scattering and absorption by a homogeneous sphere (Mie), for one sphere, many spheres, or a size distribution.
//!
//! Convention: exp(−iωt), index n + i k relative to the surroundings with k ≥ 0 absorbing, size parameter
//! x = 2πr/λ. Knows no fuels: the index is handed in.
//!
//! - [`efficiencies`], [`efficiencies_of_many`]: cross-sections over the geometric one, mean cosine, backscatter;
//! - [`amplitudes`], [`phase`]: the angular pattern;
//! - [`Pattern`]: the angular pattern of many spheres together;
//! - [`cumulative`]: exact cumulative distribution over the scattering angle;
//! - [`lognormal`], [`bulk`]: means and pattern over a lognormal size distribution.

mod amplitudes;
mod angular;
mod bulk;
mod climb;
mod cumulative;
mod descent;
mod double;
mod factors;
mod kernel;
mod lengths;
mod pattern;
mod polydisperse;
mod precise;
mod series;
mod spheres;
mod sums;
mod together;
mod trig;
mod vector;

pub use amplitudes::{Direction, amplitudes, amplitudes_towards, phase};
pub use bulk::{Bulk, bulk, bulk_with};
pub use cumulative::cumulative;
pub use pattern::Pattern;
pub use polydisperse::{Effort, Lognormal, Polydisperse, lognormal};
pub use series::{efficiencies, efficiencies_of_many, efficiencies_refined};

/// What a sphere does to light, per geometric cross-section πr², and where the scattered light goes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Efficiencies {
    /// Extinction: `q_sca + q_abs`.
    pub q_ext: f64,
    /// Scattering.
    pub q_sca: f64,
    /// Absorption; exactly 0 for k = 0.
    pub q_abs: f64,
    /// Backscattering in the radar convention, 4 |S₁(180°)|² / x².
    pub q_back: f64,
    /// Mean cosine of the scattering angle, in [−1, 1]; 0 when nothing is scattered.
    pub asymmetry: f64,
}

/// A sphere in its own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// 2πr/λ, not negative.
    pub size_parameter: f64,
    /// Real part of the relative index.
    pub n: f64,
    /// Imaginary part of the relative index, not negative.
    pub k: f64,
}

/// Largest |m| x and largest x: the series and its work grow with it (at 1e9 it runs for seconds).
pub const SIZE_MAX: f64 = 1e9;
/// Largest |m| that is accepted.
pub const INDEX_MAX: f64 = 1e4;
/// Smallest |m| that is accepted.
pub const INDEX_MIN: f64 = 1e-3;

/// Why there is no answer for a sphere.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum MieError {
    /// The size parameter is negative, infinite or NaN.
    #[error("size parameter {0}: it must be finite and not negative (2πr/λ)")]
    Size(f64),
    /// The index is outside what is accepted.
    #[error(
        "index {n} + {k} i: n must be above 0, k not negative (absorbing: n + i k), and |m| within \
         {INDEX_MIN} to {INDEX_MAX}"
    )]
    Index {
        /// Real part.
        n: f64,
        /// Imaginary part.
        k: f64,
    },
    /// The series would be too long.
    #[error("size parameter {size_parameter} with |m| x = {inside}: more than {limit} is not computed")]
    TooLarge {
        /// x.
        size_parameter: f64,
        /// |m| x.
        inside: f64,
        /// The limit that was met.
        limit: f64,
    },
    /// A direction is no direction.
    #[error("cosine {0}: it must be within -1 and 1")]
    Cosine(f64),
    /// A scattering angle is no angle.
    #[error("scattering angle {0} rad: it must be within 0 and pi")]
    Angle(f64),
    /// A size distribution is none.
    #[error(
        "lognormal distribution with median radius {median_radius_um} um, width {sigma_ln}, wavelength {wavelength_um} um: \
         radius and wavelength must be above 0, the width within 0 and 3"
    )]
    Distribution {
        /// Median radius.
        median_radius_um: f64,
        /// Standard deviation of ln r.
        sigma_ln: f64,
        /// Wavelength.
        wavelength_um: f64,
    },
}

impl Sphere {
    /// Refuses what has no answer.
    fn checked(self) -> Result<Self, MieError> {
        let Self { size_parameter, n, k } = self;
        if !(size_parameter >= 0.0 && size_parameter.is_finite()) {
            return Err(MieError::Size(size_parameter));
        }
        let square = n * n + k * k;
        let within = (INDEX_MIN * INDEX_MIN..=INDEX_MAX * INDEX_MAX).contains(&square);
        if !(n > 0.0 && k >= 0.0 && within) {
            return Err(MieError::Index { n, k });
        }
        let inside = size_parameter * square.sqrt();
        if size_parameter.max(inside) > SIZE_MAX {
            return Err(MieError::TooLarge { size_parameter, inside, limit: SIZE_MAX });
        }
        Ok(self)
    }
}
