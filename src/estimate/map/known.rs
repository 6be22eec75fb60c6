//! One line of known variances: what `ditd fit LINES.json` asks for.

use crate::estimate::calibration::SakumaHattori;
use crate::estimate::line::{self, Covariance, Line};
use crate::estimate::student::NORMAL_95;

/// One line of known variances, as `ditd fit LINES.json` prints it.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownLine {
    /// The line.
    pub line: Line,
    /// Its covariance.
    pub covariance: Covariance,
    /// ε = −slope/γ.
    pub emissivity: f64,
    /// Temperature of the crossing, in K; NaN for a crossing ≤ 0.
    pub temperature_k: f64,
}

/// Fits one line with known variances. None if the points do not define a line.
pub fn known_line(
    x: &[f64],
    y: &[f64],
    variance: &[f64],
    gamma: f64,
    emissivity_plate: f64,
    curve: &SakumaHattori,
) -> Option<KnownLine> {
    let weights: Vec<f64> = variance.iter().map(|v| 1.0 / v).collect();
    let line = line::weighted(x, y, &weights)?;
    Some(KnownLine {
        covariance: line.covariance(),
        emissivity: -line.slope / gamma,
        temperature_k: curve.inverse(emissivity_plate * line.crossing),
        line,
    })
}

/// The usual confidence of the archived channels.
pub const CONFIDENCE: f64 = 0.95;

/// Quantile that belongs to [`CONFIDENCE`] for known variances.
pub const T_KNOWN: f64 = NORMAL_95;
