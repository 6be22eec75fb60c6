//! From the frames of a bare plate and a closed shutter to the standard curve and the flat.
//!
//! At every level the shutter's frames are subtracted from the plate's: offset, its drift and the camera's own
//! light go. What remains is I(T) − I(T_shutter) and the plate's mirrored laboratory, a constant: so the curve is
//! fitted with a free offset, and the shutter's own temperature is one more point, at zero counts. Pure.

use crate::config::Config;
use crate::estimate::calibration::{
    CalibrationFit, CalibrationPoint, CurveMapping, OffsetMode, fit_curve, map_on_standard,
};
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
    /// The curve I_cal(T) through them; of a short one the standard curve, scaled.
    pub fit: CalibrationFit,
    /// How a short curve was mapped on a standard one; absent for a standard curve.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mapping: Option<Mapping>,
}

/// Today's short curve on the standard one: counts = gain · I_standard(T) + offset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mapping {
    /// Gain, offset, their covariance (a systematic, common to all pixels), χ².
    #[serde(flatten)]
    pub line: CurveMapping,
    /// UTC at the start of the standard curve.
    pub standard_utc: String,
    /// Integration time of the standard curve, in s.
    pub standard_integration_s: f64,
    /// Age of the standard curve, in days; null when a stamp cannot be read.
    pub age_days: Option<f64>,
    /// Gain over the ratio of integration times, less 1: what changed in camera, lens or filter since.
    pub drift: f64,
}

/// Drift of the gain from which the operator is warned: cooled cameras keep their gain to a per cent over months, so that
/// more is a fouled lens, another filter, or a detector that lost its vacuum.
pub const DRIFT_MAX: f64 = 0.03;

/// Age of a standard curve from which the operator is warned, in days.
pub const AGE_MAX_DAYS: f64 = 180.0;

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
        mapping: None,
        schema: 1,
        utc: utc.to_owned(),
        key: Key::of(config),
        dark_counts: mean(&dark),
        points,
        fit,
    };
    Ok((calibration, flat))
}

/// Today's calibration from its own points and an older standard curve of the same camera, lens and filter: the paper's
/// mapping. Another integration time goes into the gain, the camera's offset into the offset.
///
/// # Errors
///
/// [`CalibrateError::Key`] for another region or number of bits, [`CalibrateError::Fit`] when the points do not follow the
/// standard curve.
pub fn today(measured: &Calibration, standard: &Calibration) -> Result<Calibration, CalibrateError> {
    let like = Key { integration_s: measured.key.integration_s, ..standard.key.clone() };
    if like != measured.key {
        return Err(CalibrateError::Key { made: standard.key.to_string(), used: measured.key.to_string() });
    }
    let line = map_on_standard(&standard.fit.curve, &measured.points)
        .map_err(|error| CalibrateError::Fit(error.to_string()))?;
    let curve = line.curve(&standard.fit.curve);
    let mut covariance = standard.fit.covariance;
    // ln A gets the gain's relative variance; the offset is today's own.
    covariance[0][0] += line.covariance[0][0] / (line.gain * line.gain);
    covariance.iter_mut().for_each(|row| row[3] = 0.0);
    covariance[3] = [0.0; 4];
    let cross = line.covariance[0][1] / line.gain;
    (covariance[0][3], covariance[3][0], covariance[3][3]) = (cross, cross, line.covariance[1][1]);
    let residual =
        |point: &CalibrationPoint| point.counts - curve.value(point.temperature_k) - line.offset_counts;
    let drift = line.gain * standard.key.integration_s / measured.key.integration_s - 1.0;
    Ok(Calibration {
        fit: CalibrationFit {
            curve,
            offset_counts: line.offset_counts,
            covariance,
            chi2: line.chi2,
            dof: line.dof,
            range: standard.fit.range,
            residuals: measured.points.iter().map(residual).collect(),
            iterations: 0,
        },
        mapping: Some(Mapping {
            standard_utc: standard.utc.clone(),
            standard_integration_s: standard.key.integration_s,
            age_days: age_days(&standard.utc, &measured.utc),
            drift,
            line,
        }),
        ..measured.clone()
    })
}

/// Days between two UTC stamps.
fn age_days(from: &str, to: &str) -> Option<f64> {
    let stamp = |text: &str| text.parse::<jiff::Timestamp>().ok().map(|t| t.as_second() as f64);
    Some((stamp(to)? - stamp(from)?) / 86_400.0)
}

impl Mapping {
    /// What the operator should know of it, a line each.
    pub fn alarms(&self) -> Vec<String> {
        let mut alarms = Vec::new();
        if self.drift.abs() > DRIFT_MAX {
            alarms.push(format!(
                "gain {:+.1} % off the standard curve of {}: fouled optics, another filter or lens, or an aged detector. Take a new standard curve.",
                100.0 * self.drift,
                self.standard_utc
            ));
        }
        if self.age_days.is_some_and(|days| days > AGE_MAX_DAYS) {
            alarms.push(format!(
                "the standard curve is {:.0} days old. Take a new one.",
                self.age_days.unwrap_or(f64::NAN)
            ));
        }
        let freedom = f64::from(u32::try_from(self.line.dof).unwrap_or(u32::MAX));
        if self.line.dof > 0 && self.line.chi2 > CHI2_MAX * freedom {
            alarms.push(format!(
                "χ² of the mapping is {:.1} for {freedom} degrees of freedom: today's points do not follow the standard curve",
                self.line.chi2
            ));
        }
        alarms
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::SakumaHattori;

    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn calibration(gain: f64, offset: f64, integration_s: f64, utc: &str) -> Calibration {
        let points: Vec<CalibrationPoint> = [340.0, 390.0, 440.0, 490.0, 540.0]
            .into_iter()
            .map(|temperature_k| CalibrationPoint {
                temperature_k,
                counts: gain * CURVE.value(temperature_k) + offset,
                sigma_counts: 0.1,
            })
            .collect();
        let fit = fit_curve(&points, OffsetMode::Free).unwrap();
        let key = Key { rows: 4, columns: 5, integration_s, bits: 14 };
        Calibration { schema: 1, utc: utc.into(), key, dark_counts: 1500.0, points, fit, mapping: None }
    }

    /// 25 µs to 20 µs, an offset, and no alarm; a changed gain and age raise theirs; another region is refused.
    #[test]
    fn a_short_curve_is_mapped_on_the_standard_one() {
        let standard = calibration(1.0, 0.0, 25e-6, "2026-01-01T00:00:00Z");
        let short = calibration(0.8, 4.0, 20e-6, "2026-02-01T00:00:00Z");
        let mapped = today(&short, &standard).unwrap();
        let mapping = mapped.mapping.clone().unwrap();
        assert!((mapping.line.gain - 0.8).abs() < 1e-6 && mapping.drift.abs() < 1e-6);
        assert!((mapping.age_days.unwrap() - 31.0).abs() < 1e-9 && mapping.alarms().is_empty());
        assert!((mapped.fit.offset_counts - 4.0).abs() < 1e-5);
        for t in [350.0, 450.0, 530.0] {
            assert!((mapped.fit.curve.inverse(0.8 * CURVE.value(t)) - t).abs() < 1e-3);
            // The gain's uncertainty is there, beside the standard curve's own.
            assert!(mapped.fit.sigma_counts(t) > 0.8 * standard.fit.sigma_counts(t) * 0.999);
        }
        let json = serde_json::to_string(&mapped).unwrap();
        assert_eq!(serde_json::from_str::<Calibration>(&json).unwrap().mapping, mapped.mapping);
        let fouled = today(&calibration(0.9, 0.0, 25e-6, "2027-01-01T00:00:00Z"), &standard).unwrap();
        assert_eq!(fouled.mapping.unwrap().alarms().len(), 2);
        let mut other = short;
        other.key.rows = 9;
        assert!(matches!(today(&other, &standard), Err(CalibrateError::Key { .. })));
    }
}
