//! What a fit has to know besides the counts: levels, windows, plate, curve, camera, and how to weight.

use crate::estimate::calibration::{Range, Residual, SakumaHattori};
use crate::estimate::line;

/// How the lines are weighted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// Ours: weights from a variance law fitted to pooled variances, sandwich covariance, Student's t.
    Default,
    /// The paper's: weight n/max(s², 1/12) with each level's own variance, normal quantiles; pixels with a level of
    /// one cycle take the unweighted line.
    Paper,
    /// All levels alike, variance from the scatter about the line.
    Ols,
}

impl Estimator {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Paper => "paper",
            Self::Ols => "ols",
        }
    }
}

/// The camera's own noise.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraNoise {
    /// Standard deviation of a dark sample, in counts, without rounding.
    pub read_noise_counts: f64,
    /// Electrons per count; infinite for no shot noise.
    pub electrons_per_count: f64,
    /// Counts that hold no electrons.
    pub zero_counts: f64,
}

impl CameraNoise {
    /// A camera of which nothing is known: rounding only.
    pub const ROUNDING_ONLY: Self =
        Self { read_noise_counts: 0.0, electrons_per_count: f64::INFINITY, zero_counts: 0.0 };

    /// Variance, in counts², of spray − mean of `blanks` blanks at the given mean counts.
    pub fn variance(&self, spray_counts: f64, blank_counts: f64, blanks: f64) -> f64 {
        let fixed = self.read_noise_counts * self.read_noise_counts + line::ROUNDING_VARIANCE;
        let shot = |counts: f64| (counts - self.zero_counts).max(0.0) / self.electrons_per_count;
        fixed + shot(spray_counts) + (fixed + shot(blank_counts)) / blanks
    }
}

/// What the fit has to know besides the counts.
#[derive(Debug, Clone, PartialEq)]
pub struct FitInputs<'a> {
    /// x = γ_far·I_cal(T_plate) per level, in counts, with the mean plate reading of the accepted shots; a level
    /// without x is left out.
    pub x_counts: Vec<Option<f64>>,
    /// Transmittance of the window on the camera's side.
    pub gamma_near: f64,
    /// Transmittance of the window on the plate's side; used for the gain only, x holds it already.
    pub gamma_far: f64,
    /// Emissivity of the plate, ε_B.
    pub emissivity_plate: f64,
    /// E_f: the far window's own light and what it mirrors, in counts of the crossing's scale. Zero as in the paper.
    pub far_window_counts: f64,
    /// I_cal of a black body without offset.
    pub curve: SakumaHattori,
    /// What the curve leaves of the camera's behaviour; None for nothing.
    pub residual: Option<&'a Residual>,
    /// Where the curve is calibrated; None trusts it everywhere.
    pub range: Option<Range>,
    /// The camera's own noise.
    pub camera: CameraNoise,
    /// How the lines are weighted.
    pub estimator: Estimator,
    /// Confidence of the low/high channels, 0.95 for archived maps.
    pub confidence: f64,
    /// Gain of each pixel against the calibrated one, `[rows · columns]`: counts are divided by it. x stays nominal.
    pub flat_gain: Option<&'a [f64]>,
}
