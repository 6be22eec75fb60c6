//! The camera's curve: counts against the temperature of a black body, and back.
//!
//! The Sakuma–Hattori equation follows filtered 3–5 µm cameras to a millikelvin where straight interpolation of ten
//! points errs by kelvins; what a camera's own nonlinearity adds is a monotone residual, only where the fit's χ² demands
//! it. Does not acquire calibrations and does not know which camera, lens or filter they belong to.
//!
//! In reading order: the curve and its range (`curve`), points to curve (`fit`, by `descent`, with its algebra in
//! `least_squares`), what a known filter and any band say of the curve before any point (`band`, `prior`), what the
//! equation leaves (`residual`), a short curve on a long one (`mapping`).

mod band;
mod curve;
mod descent;
mod fit;
mod least_squares;
mod mapping;
mod prior;
mod residual;

pub use band::Passband;
pub(super) use curve::EXTRAPOLATION_MAX;
pub use curve::{C2_UM_K, Range, Reach, SakumaHattori};
pub use fit::{CalibrationFit, OffsetMode, fit_curve, fit_curve_in_band};
pub use mapping::{CurveMapping, map_on_fit, map_on_standard};
pub use residual::Residual;

use serde::{Deserialize, Serialize};

/// One point of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationPoint {
    /// Temperature of the black body, in K.
    pub temperature_k: f64,
    /// Mean counts of the camera.
    pub counts: f64,
    /// Standard deviation of `counts`, > 0.
    pub sigma_counts: f64,
}

/// Why a calibration could not be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// calibration curve: {given} different temperatures for {needed} parameters. Add points, or measure the offset.
    #[error(
        "calibration curve: {given} different temperatures for {needed} parameters. Add points, or measure the offset."
    )]
    TooFewPoints {
        /// Different temperatures given.
        given: usize,
        /// Parameters to fit.
        needed: usize,
    },
    /// calibration curve: point {index} is not usable: temperature and sigma must be positive, all finite.
    #[error(
        "calibration curve: point {index} is not usable: temperature and sigma must be positive, all finite."
    )]
    BadPoint {
        /// Its place, from 0.
        index: usize,
    },
    /// calibration curve: the counts do not rise with temperature like a black body. Check the points and the offset.
    #[error(
        "calibration curve: the counts do not rise with temperature like a black body. Check the points and the offset."
    )]
    NotABlackBody,
}

/// Refuses points without a positive temperature and sigma, or not finite.
fn check(points: &[CalibrationPoint]) -> Result<(), CalibrationError> {
    let usable = |p: &CalibrationPoint| {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        positive(p.temperature_k) && positive(p.sigma_counts) && p.counts.is_finite()
    };
    match points.iter().position(|point| !usable(point)) {
        Some(index) => Err(CalibrationError::BadPoint { index }),
        None => Ok(()),
    }
}
