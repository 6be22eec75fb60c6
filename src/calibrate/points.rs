//! From sums of frames to calibration points: means over the picture, and their uncertainty.

use super::CalibrateError;
use crate::config::Config;
use crate::estimate::calibration::CalibrationPoint;
use crate::reduce::{CurveSums, LevelState};

/// Repeatability of the plate's reading within one level, in K: 418x manual, stability 0.05 … 0.2 K as two
/// standard deviations of a slow ripple, sampled once. It sets the weights of the points, and the fit's χ² scales
/// the covariance, so that a wrong value costs little.
pub(super) const READING_REPEATABILITY_K: f64 = 0.03;

/// Repeatability of the camera's offset between the series with the shutter and the one without, in counts: chosen
/// as what is left of a count after averaging tens of frames of all pixels. It keeps the coldest points, whose
/// counting noise is far smaller, from ruling the fit.
pub(super) const OFFSET_REPEATABILITY_COUNTS: f64 = 0.02;

/// Slope of the counts with temperature as a fraction of the counts, near 3.4 µm: c2/(λT²) at 450 K, in 1/K.
const RELATIVE_SLOPE_PER_K: f64 = 0.0209;

/// What the frames of a plate say, level by level.
#[derive(Debug, Clone)]
pub struct Series {
    /// Temperature of the plate by its readings, counts above the shutter (raw counts without one), mean over all
    /// pixels.
    pub points: Vec<CalibrationPoint>,
    /// The same per pixel, `[level][row · columns + column]`.
    pub differences: Vec<Vec<f64>>,
    /// Mean temperature of the shutter, in K; None without one.
    pub shutter_k: Option<f64>,
    /// Mean counts with the shutter closed, over all levels and pixels; None without one.
    pub dark_counts: Option<f64>,
    /// Its scatter from level to level, in counts; NaN for a single level.
    pub dark_scatter_counts: f64,
}

/// Evaluates the frames of a calibration.
///
/// # Errors
///
/// [`CalibrateError::Incomplete`] when frames or readings are missing.
pub fn series(sums: &CurveSums, levels: &[LevelState], config: &Config) -> Result<Series, CalibrateError> {
    let mut points = Vec::new();
    let mut differences: Vec<Vec<f64>> = Vec::new();
    let mut shutter_k = Vec::new();
    let mut dark = Vec::new();
    for (index, level) in levels.iter().enumerate() {
        let incomplete = |what| CalibrateError::Incomplete { level: index + 1, what };
        let temperature_k = level.plate_mean_k().ok_or_else(|| incomplete("plate readings"))?;
        let n_plate = f64::from(sums.plate_frames[index]);
        let n_shutter = f64::from(sums.shutter_frames[index]);
        if sums.plate_frames[index] == 0 {
            return Err(incomplete("frames"));
        }
        let plate = sums.plate[index].iter().map(|&sum| sum as f64 / n_plate);
        let closed = sums.shutter_k[index];
        let difference: Vec<f64> = match closed {
            Some(kelvin) if sums.shutter_frames[index] > 0 => {
                shutter_k.push(kelvin);
                let pixels = sums.shutter[index].len() as f64;
                dark.push(sums.shutter[index].iter().sum::<u64>() as f64 / n_shutter / pixels);
                plate.zip(&sums.shutter[index]).map(|(plate, &sum)| plate - sum as f64 / n_shutter).collect()
            }
            Some(_) => return Err(incomplete("shutter frames")),
            None => plate.collect(),
        };
        let counts = mean(&difference);
        // Without a shutter the counts hold the offset, which makes no shot noise: at most too much.
        let camera = config.camera.read_noise_counts.powi(2)
            + counts.max(0.0) / config.camera.electrons_per_count
            + 1.0 / 12.0;
        let frames = 1.0 / n_plate + if closed.is_some() { 1.0 / n_shutter } else { 0.0 };
        let noise = camera * frames / difference.len() as f64;
        points.push(CalibrationPoint { temperature_k, counts, sigma_counts: noise });
        differences.push(difference);
    }
    if !shutter_k.is_empty() && shutter_k.len() < levels.len() {
        return Err(CalibrateError::Incomplete { level: shutter_k.len() + 1, what: "shutter frames" });
    }
    // The plate's part of a reading's error goes with the light, not with the offset.
    let floor = if shutter_k.is_empty() {
        points.iter().map(|point| point.counts).fold(f64::INFINITY, f64::min)
    } else {
        0.0
    };
    for point in &mut points {
        let reading = (point.counts - floor) * RELATIVE_SLOPE_PER_K * READING_REPEATABILITY_K;
        point.sigma_counts =
            (point.sigma_counts + reading * reading + OFFSET_REPEATABILITY_COUNTS.powi(2)).sqrt();
    }
    let known = !shutter_k.is_empty();
    Ok(Series {
        points,
        differences,
        shutter_k: known.then(|| mean(&shutter_k)),
        dark_counts: known.then(|| mean(&dark)),
        dark_scatter_counts: scatter(&dark),
    })
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Sample standard deviation; NaN below two values.
fn scatter(values: &[f64]) -> f64 {
    let centre = mean(values);
    let squares: f64 = values.iter().map(|value| (value - centre) * (value - centre)).sum();
    if values.len() < 2 { f64::NAN } else { (squares / (values.len() - 1) as f64).sqrt() }
}
