//! What a filter's data sheet says of the curve before any point is measured.
//!
//! For a response of mean wavelength λ₀ and rms width s the Sakuma–Hattori parameters are a = λ₀(1 − 6 s²/λ₀²) and
//! b = c2 s²/(2 λ₀²) (F. Sakuma, M. Kobayashi, Interpolation equations of scales of radiation thermometers, TEMPMEKO
//! 1996). With a free offset four parameters meet a few noisy points, and it is the exponent that they know least and
//! the data sheet knows best.

use super::C2_UM_K;
use serde::{Deserialize, Serialize};

/// Rms width over full width at half maximum: 0.289 for a rectangle, 0.425 for a Gaussian; interference filters lie
/// between.
const RMS_PER_FWHM: f64 = 0.36;

/// Relative standard deviation of a mean wavelength taken from a data sheet: makers state the centre to 0.5 … 1 %,
/// detector and lens shift the mean by as much again.
const CENTRE_SIGMA: f64 = 0.01;

/// Standard deviation of b over b: the shape of the pass band between rectangle and Gaussian (30 % of s, 60 % of s²).
const WIDTH_SIGMA: f64 = 0.6;

/// Standard deviation of b that a leak outside the pass band adds, in µm K: a leak of 1e-4 over 1 … 6 µm, as table
/// filters state, moves b by 1 to 3.
const LEAK_SIGMA_UM_K: f64 = 3.0;

/// The pass band of camera, lens and filter as the data sheet states it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Passband {
    /// Centre, in µm, > 0.
    pub centre_um: f64,
    /// Full width at half maximum, in µm, > 0.
    pub fwhm_um: f64,
}

/// A parameter as it is known before the points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub(super) value: f64,
    pub(super) sigma: f64,
}

impl Passband {
    /// a in µm and b in µm K.
    pub(super) fn parameters(&self) -> [Known; 2] {
        let relative = RMS_PER_FWHM * self.fwhm_um / self.centre_um;
        let square = relative * relative;
        let b = 0.5 * C2_UM_K * square;
        // A wide band's centre is as uncertain as its shape: a tenth of the rms width.
        let centre = self.centre_um * CENTRE_SIGMA.hypot(0.1 * relative);
        [
            Known { value: self.centre_um * (1.0 - 6.0 * square), sigma: centre },
            Known { value: b, sigma: LEAK_SIGMA_UM_K.hypot(WIDTH_SIGMA * b) },
        ]
    }
}
