//! Today's short curve on the standard one: the paper's linear mapping.

use super::{CalibrationError, CalibrationFit, CalibrationPoint, SakumaHattori};
use crate::estimate::line;
use serde::{Deserialize, Serialize};

/// How today's counts follow from the standard curve: counts = gain · I_standard(T) + offset (the paper's mapping).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurveMapping {
    /// Gain of today against the standard curve.
    pub gain: f64,
    /// Offset of today, in counts.
    pub offset_counts: f64,
    /// Covariance of (gain, offset_counts): a systematic, common to all pixels.
    pub covariance: [[f64; 2]; 2],
    /// Σ ((counts − mapped)/sigma)².
    pub chi2: f64,
    /// Points less 2.
    pub dof: usize,
}

impl CurveMapping {
    /// Today's curve, counts above `offset_counts`: the standard one with A scaled.
    pub fn curve(&self, standard: &SakumaHattori) -> SakumaHattori {
        SakumaHattori { a_counts: self.gain * standard.a_counts, ..*standard }
    }

    /// Standard counts that today's `counts` stand for.
    pub fn to_standard(&self, counts: f64) -> f64 {
        (counts - self.offset_counts) / self.gain
    }
}

/// Maps a short current curve of two or more points on the standard one.
///
/// # Errors
///
/// When the points are fewer than two, not finite, at one temperature, or fall with temperature.
pub fn map_on_standard(
    standard: &SakumaHattori,
    current: &[CalibrationPoint],
) -> Result<CurveMapping, CalibrationError> {
    mapped(&|temperature_k| standard.value(temperature_k), current)
}

/// As [`map_on_standard`], on a standard curve with its residual.
///
/// # Errors
///
/// As [`map_on_standard`].
pub fn map_on_fit(
    standard: &CalibrationFit,
    current: &[CalibrationPoint],
) -> Result<CurveMapping, CalibrationError> {
    mapped(&|temperature_k| standard.counts(temperature_k), current)
}

fn mapped(
    standard: &dyn Fn(f64) -> f64,
    current: &[CalibrationPoint],
) -> Result<CurveMapping, CalibrationError> {
    super::check(current)?;
    let x: Vec<f64> = current.iter().map(|p| standard(p.temperature_k)).collect();
    let y: Vec<f64> = current.iter().map(|p| p.counts).collect();
    let w: Vec<f64> = current.iter().map(|p| 1.0 / (p.sigma_counts * p.sigma_counts)).collect();
    let line = line::weighted(&x, &y, &w)
        .ok_or(CalibrationError::TooFewPoints { given: current.len(), needed: 2 })?;
    if line.slope.is_nan() || line.slope <= 0.0 {
        return Err(CalibrationError::NotABlackBody);
    }
    let c = line.covariance();
    let cross = line.slope_offset_covariance(&c);
    Ok(CurveMapping {
        gain: line.slope,
        offset_counts: line.offset,
        covariance: [[c.slope, cross], [cross, line.offset_variance(&c)]],
        chi2: line.chi2,
        dof: current.len() - 2,
    })
}
