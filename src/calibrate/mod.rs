//! From the frames of a plate and a closed shutter to a calibration: the curve and what else belongs to it.
//!
//! One file, `calibration.json`, keyed by camera, lens, filter, integration time, gain and region; another set-up's is
//! refused unless it is mapped. In reading order: the file and its key (here), frames to points (`points`), points to the
//! standard curve and today's mapped on it (`curve`), and the figures beside the curve: flat, offset, noise, windows,
//! plate (`figures`). Pure.

mod curve;
mod figures;
mod points;

pub use curve::{standard, today};
pub use figures::{
    Flat, FlatMap, NoiseFigures, OffsetReference, PlateEmissivity, Windows, flat, noise, offset,
    plate_from_ambient, plate_from_reference, windows,
};
pub use points::{Series, series};

use crate::config::Config;
use crate::estimate::calibration::{CalibrationFit, CalibrationPoint, CurveMapping};
use serde::{Deserialize, Serialize};

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
    /// Camera, lens, filter and gain setting as the campaign file names them; absent where it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// The lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens: Option<String>,
    /// The filter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// The camera's gain setting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<String>,
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
    /// What else was measured of the same set-up.
    #[serde(flatten)]
    pub figures: Figures,
}

/// What a calibration holds beside its curve: each acquired by a kind of its own, absent until then.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Gains and broken pixels; the map of gains lies in `flat.npy`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flat: Option<Flat>,
    /// Counts without light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset: Option<OffsetReference>,
    /// Electrons per count and read noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<NoiseFigures>,
    /// Transmittance of the windows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub windows: Option<Windows>,
    /// ε_B of the plate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plate: Option<PlateEmissivity>,
}

impl Figures {
    /// Where the campaign file states something else than was measured, a line each: by more than three standard
    /// deviations and a per cent.
    pub fn contradictions(&self, config: &Config) -> Vec<String> {
        let mut found = Vec::new();
        let mut compare = |key: &str, stated: f64, measured: f64, sigma: f64| {
            if (stated - measured).abs() > 3.0 * sigma && (stated / measured - 1.0).abs() > 0.01 {
                found.push(format!(
                    "{key} is {stated} in the campaign file, {measured:.4} ± {sigma:.4} was measured"
                ));
            }
        };
        let (optics, camera) = (&config.optics, &config.camera);
        if let Some(windows) = &self.windows {
            let stated = optics.gamma_near * optics.gamma_far;
            compare("gamma_near · gamma_far", stated, windows.transmittance, windows.sigma_transmittance);
        }
        if let Some(plate) = &self.plate {
            compare(
                "optics.emissivity_plate",
                optics.emissivity_plate,
                plate.emissivity,
                plate.sigma_emissivity,
            );
        }
        if let Some(noise) = &self.noise {
            let (electrons, sigma) = (noise.electrons_per_count, noise.sigma_electrons_per_count);
            compare("camera.electrons_per_count", camera.electrons_per_count, electrons, sigma);
            let (read, sigma) = (noise.read_noise_counts, noise.sigma_read_noise_counts);
            compare("camera.read_noise_counts", camera.read_noise_counts, read, sigma);
        }
        found
    }
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
    /// Something that must be there first.
    #[error("calibration: {0}")]
    Missing(String),
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
        Self {
            rows: c.rows,
            columns: c.columns,
            integration_s: c.integration_s,
            bits: c.bits,
            camera: c.name.clone(),
            lens: c.lens.clone(),
            filter: config.optics.filter.clone(),
            gain: c.gain.clone(),
        }
    }
}

impl std::fmt::Display for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let microseconds = self.integration_s * 1e6;
        write!(f, "{} × {} pixels, {microseconds:.4} µs, {} bits", self.columns, self.rows, self.bits)?;
        for (what, name) in
            [("camera", &self.camera), ("lens", &self.lens), ("filter", &self.filter), ("gain", &self.gain)]
        {
            match name {
                Some(name) => write!(f, ", {what} {name:?}")?,
                None => write!(f, ", no {what} named")?,
            }
        }
        Ok(())
    }
}

impl Key {
    /// Refuses what belongs to another set-up.
    ///
    /// # Errors
    ///
    /// [`CalibrateError::Key`].
    pub fn check(&self, config: &Config) -> Result<(), CalibrateError> {
        let used = Self::of(config);
        if *self == used {
            return Ok(());
        }
        Err(CalibrateError::Key { made: self.to_string(), used: used.to_string() })
    }
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
