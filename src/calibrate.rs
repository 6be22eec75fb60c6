//! From the frames of a bare plate and a closed shutter to the standard curve and the flat.
//!
//! At every level the shutter's frames are subtracted from the plate's: offset, its drift and the camera's own
//! light go. What remains is I(T) − I(T_shutter) and the plate's mirrored laboratory, a constant: so the curve is
//! fitted with a free offset, and the shutter's own temperature is one more point, at zero counts. Pure.

use crate::config::Config;
use crate::estimate::calibration::{CalibrationFit, CalibrationPoint, OffsetMode, fit_curve};
use crate::reduce::{CurveSums, LevelState};
use serde::{Deserialize, Serialize};

/// Repeatability of the plate's reading within one level, in K: 418x manual, stability 0.05 … 0.2 K as two
/// standard deviations of a slow ripple, sampled once. It sets the weights of the points, and the fit's χ² scales
/// the covariance, so that a wrong value costs little.
const READING_REPEATABILITY_K: f64 = 0.03;

/// Repeatability of the camera's offset between the series with the shutter and the one without, in counts: chosen
/// as what is left of a count after averaging tens of frames of all pixels. It keeps the coldest points, whose
/// counting noise is far smaller, from ruling the fit.
const OFFSET_REPEATABILITY_COUNTS: f64 = 0.02;

/// Slope of the counts with temperature as a fraction of the counts, near 3.4 µm: c2/(λT²) at 450 K, in 1/K.
const RELATIVE_SLOPE_PER_K: f64 = 0.0209;

/// Which camera set-up a calibration belongs to; another one is refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// Rows of the region.
    pub rows: usize,
    /// Columns of the region.
    pub columns: usize,
    /// Integration time in s.
    pub integration_s: f64,
    /// Bits of a sample.
    pub bits: u32,
}

/// `calibration.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Calibration {
    /// Version of the format.
    pub schema: u32,
    /// UTC at its start.
    pub utc: String,
    /// The set-up it belongs to.
    pub key: Key,
    /// Mean counts with the shutter closed, over all levels and pixels: what the fit takes for no light.
    pub dark_counts: f64,
    /// The measured points: counts above the shutter, mean over all pixels.
    pub points: Vec<CalibrationPoint>,
    /// The curve I_cal(T) through them.
    pub fit: CalibrationFit,
}

/// A calibration and the flat that belongs to it.
#[derive(Debug, Clone)]
pub struct Calibrated {
    /// The curve.
    pub calibration: Calibration,
    /// Relative gain per pixel.
    pub flat: Vec<f64>,
}

/// χ² per degree of freedom from which the operator is warned.
pub const CHI2_MAX: f64 = 4.0;

/// Why frames do not make a calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// A level is incomplete.
    #[error("calibration, level {level}: {what} are missing. Acquire it again.")]
    Incomplete {
        /// Level number from 1.
        level: usize,
        /// What is not there.
        what: &'static str,
    },
    /// The curve did not fit.
    #[error(
        "calibration: the curve does not fit its points: {0}. Look at calibration/telemetry.csv and the frames."
    )]
    Fit(String),
    /// The calibration was made for another set-up.
    #[error(
        "calibration: made for {made}, but the campaign uses {used}. Calibrate again with the campaign's [camera] settings."
    )]
    Key {
        /// Its set-up.
        made: String,
        /// The campaign's.
        used: String,
    },
}

impl Key {
    /// The key of a campaign.
    pub fn of(config: &Config) -> Self {
        let c = &config.camera;
        Self { rows: c.rows, columns: c.columns, integration_s: c.integration_s, bits: c.bits }
    }
}

impl std::fmt::Display for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let microseconds = self.integration_s * 1e6;
        write!(f, "{} × {} pixels, {microseconds} µs, {} bits", self.columns, self.rows, self.bits)
    }
}

impl Calibration {
    /// Refuses a calibration that belongs to another set-up.
    ///
    /// # Errors
    ///
    /// [`CalibrateError::Key`].
    pub fn check_key(&self, config: &Config) -> Result<(), CalibrateError> {
        let used = Key::of(config);
        if self.key == used {
            return Ok(());
        }
        Err(CalibrateError::Key { made: self.key.to_string(), used: used.to_string() })
    }
}

/// The standard curve and the flat (relative gain of each pixel, `[row · columns + column]`, mean 1; NaN for a
/// pixel that does not answer to the plate).
///
/// # Errors
///
/// [`CalibrateError`] when frames are missing or the curve cannot be fitted.
pub fn standard(
    sums: &CurveSums,
    levels: &[LevelState],
    config: &Config,
    utc: &str,
) -> Result<(Calibration, Vec<f64>), CalibrateError> {
    let mut points = Vec::new();
    let mut differences: Vec<Vec<f64>> = Vec::new();
    let mut shutter_k = Vec::new();
    let mut dark = Vec::new();
    for (index, level) in levels.iter().enumerate() {
        let incomplete = |what| CalibrateError::Incomplete { level: index + 1, what };
        let temperature_k = level.plate_mean_k().ok_or_else(|| incomplete("plate readings"))?;
        let kelvin = sums.shutter_k[index].ok_or_else(|| incomplete("shutter frames"))?;
        if sums.plate_frames[index] == 0 || sums.shutter_frames[index] == 0 {
            return Err(incomplete("frames"));
        }
        shutter_k.push(kelvin);
        let shutter_frames = f64::from(sums.shutter_frames[index]);
        dark.push(
            sums.shutter[index].iter().sum::<u64>() as f64
                / shutter_frames
                / sums.shutter[index].len() as f64,
        );
        let (n_plate, n_shutter) =
            (f64::from(sums.plate_frames[index]), f64::from(sums.shutter_frames[index]));
        let difference: Vec<f64> = sums.plate[index]
            .iter()
            .zip(&sums.shutter[index])
            .map(|(plate, shutter)| *plate as f64 / n_plate - *shutter as f64 / n_shutter)
            .collect();
        let counts = mean(&difference);
        let camera = config.camera.read_noise_counts.powi(2)
            + counts.max(0.0) / config.camera.electrons_per_count
            + 1.0 / 12.0;
        let noise = camera * (1.0 / n_plate + 1.0 / n_shutter) / difference.len() as f64;
        let reading = counts * RELATIVE_SLOPE_PER_K * READING_REPEATABILITY_K;
        points.push(CalibrationPoint {
            temperature_k,
            counts,
            sigma_counts: (noise + reading * reading + OFFSET_REPEATABILITY_COUNTS.powi(2)).sqrt(),
        });
        differences.push(difference);
    }
    let flat = flat_of(&points, &differences);
    let cold = mean(&shutter_k);
    let quietest = points.iter().map(|point| point.sigma_counts).fold(f64::INFINITY, f64::min);
    points.insert(0, CalibrationPoint { temperature_k: cold, counts: 0.0, sigma_counts: quietest });
    let fit = fit_curve(&points, OffsetMode::Free).map_err(|error| CalibrateError::Fit(error.to_string()))?;
    let calibration = Calibration {
        schema: 1,
        utc: utc.to_owned(),
        key: Key::of(config),
        dark_counts: mean(&dark),
        points,
        fit,
    };
    Ok((calibration, flat))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Least-squares gain of every pixel against the mean signal of the levels.
fn flat_of(points: &[CalibrationPoint], differences: &[Vec<f64>]) -> Vec<f64> {
    let pixels = differences.first().map_or(0, Vec::len);
    let mut cross = vec![0.0; pixels];
    for (point, difference) in points.iter().zip(differences) {
        for (sum, value) in cross.iter_mut().zip(difference) {
            *sum += point.counts * value;
        }
    }
    let square: f64 = points.iter().map(|point| point.counts * point.counts).sum();
    // A pixel that follows the plate by less than a fifth or more than five-fold is broken, not weak.
    cross
        .iter()
        .map(|sum| sum / square)
        .map(|gain| if (0.2..=5.0).contains(&gain) { gain } else { f64::NAN })
        .collect()
}
