//! The campaign file: what the user asks for.
//!
//! TOML in, a checked [`Config`] out. Physical quantities have no hidden defaults; what may be left out says so.
//! Errors name file, line and key, show the line with a caret, list the keys that exist and guess the one that
//! was meant. Touches no instrument and, apart from the text it is given, no file.

mod check;
mod diagnose;
pub mod monitor;

pub use check::Problem;
pub use diagnose::ConfigError;
pub use monitor::{Monitor, MonitorValue};

use crate::estimate::calibration::Passband;
use crate::estimate::mask::Limits;
use ditd_drivers::gige::GigeSettings;
use ditd_drivers::trigger_limits::TriggerLimits;
use ditd_sim::rig::config::RigConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The address of an instrument that is simulated inside this program.
pub const SIMULATED: &str = "sim";

/// The newest campaign-file schema that this program reads.
pub const SCHEMA: u32 = 1;

/// A whole campaign file.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Version of the format; absent means 1.
    #[serde(default = "schema_one")]
    pub schema: u32,
    /// What is measured, in which order, how often.
    pub campaign: Campaign,
    /// When the plate counts as settled.
    pub soak: Soak,
    /// The black-body calibrator.
    pub plate: Plate,
    /// The trigger unit.
    pub trigger: Trigger,
    /// The infrared camera.
    pub camera: Camera,
    /// Sources of process values.
    #[serde(default, rename = "monitor")]
    pub monitors: Vec<Monitor>,
    /// What the light passes and is compared with.
    pub optics: Optics,
    /// How the calibration curve is acquired; needed by `ditd calibrate` and by `optics.calibration = "measure"`.
    pub calibration: Option<Calibration>,
    /// How the map is fitted.
    pub fit: Fit,
    /// When the map is good enough; absent means that all planned cycles are taken.
    pub target: Option<Target>,
    /// The simulated world; absent on a real rig.
    #[schemars(with = "Option<serde_json::Value>")]
    pub rig: Option<RigConfig>,
}

fn schema_one() -> u32 {
    1
}

/// `[campaign]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Campaign {
    /// Title of the run.
    pub name: String,
    /// Plate temperatures in K, at least two different ones.
    pub levels_k: Vec<f64>,
    /// Cycles (blanks and one spray each) at every level, at least 1.
    pub cycles: u32,
    /// Blank frames of each cycle, at least 1.
    pub blanks: u32,
    /// Frames thrown away at the start of each cycle.
    pub warm_up: u32,
    /// Time between the frames of one cycle, in s.
    pub frame_period_s: f64,
    /// Pause after the spray frame before the next cycle's first frame, in s: residual vapour is flushed out.
    pub pause_s: f64,
    /// Order of the levels.
    #[serde(default)]
    pub order: Order,
    /// Speed of a simulated campaign.
    #[serde(default)]
    pub pace: Pace,
    /// Seed of everything random in a simulated run.
    #[serde(default)]
    pub seed: u64,
    /// UTC at the start of a simulated campaign (RFC 3339); a real rig uses the clock.
    #[serde(default = "default_epoch")]
    pub epoch: String,
    /// Cycles that may be taken again at one level before the campaign gives up; absent: as many as planned.
    pub retakes_max: Option<u32>,
}

fn default_epoch() -> String {
    "2026-01-01T00:00:00Z".to_owned()
}

/// Order in which the levels are visited.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// From cold to hot: heating costs minutes, cooling tens of minutes.
    #[default]
    Ascending,
    /// From hot to cold.
    Descending,
    /// As written.
    AsGiven,
}

/// How fast a simulated campaign runs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// Virtual time: as fast as the machine computes.
    #[default]
    Max,
    /// Real time; the only choice on a real rig.
    Real,
}

/// `[soak]`: settled means in the band for the hold time, slower than the slope limit, with fresh readings.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Soak {
    /// Half width of the band around the set-point, in K.
    pub band_k: f64,
    /// Time that the reading must stay in the band, in s.
    pub hold_s: f64,
    /// Largest drift over the hold time, in K per minute.
    pub slope_limit_k_per_min: f64,
    /// Time between readings, in s.
    pub poll_s: f64,
    /// A reading that has not changed at all for this long is not fresh, in s.
    pub stale_s: f64,
    /// The campaign gives up on a level after this time, in s.
    pub timeout_s: f64,
}

/// `[plate]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plate {
    /// Driver: the name of its file (`fluke_418x`, `hart_9132`, `ir_301`).
    pub driver: String,
    /// `sim`, `serial:/dev/…` or `tcp:host:port`.
    pub address: String,
    /// Baud rate of a serial line; absent: the instrument's default.
    pub baud: Option<u32>,
    /// A line that has gone (unplugged, reset) is tried to be opened again for so long, in s; 0: never.
    #[serde(default = "default_reopen_s")]
    pub reopen_s: f64,
    /// No set-point above this leaves the program, in K.
    pub limit_k: f64,
    /// Emissivity setting of the display (0.90 … 1.00).
    pub display_emissivity: f64,
    /// Scan rate in K per minute.
    pub rate_k_per_min: f64,
    /// The instrument's own stability limit, in K.
    pub stability_k: f64,
}

/// `[trigger]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// Driver: the name of its file (`quantum_9520`, `dg645`).
    pub driver: String,
    /// `sim`, `serial:/dev/…` or `tcp:host:port`.
    pub address: String,
    /// Baud rate of a serial line; absent: the instrument's default.
    pub baud: Option<u32>,
    /// A line that has gone (unplugged, reset) is tried to be opened again for so long, in s; 0: never. No burst is
    /// ever started again by that.
    #[serde(default = "default_reopen_s")]
    pub reopen_s: f64,
    /// Length of the injector's pulse, in s.
    pub injection_s: f64,
    /// From the start of the injector's pulse to the start of the exposure, in s: the instant of the spray that is seen.
    pub exposure_delay_s: f64,
    /// Longest injector pulse that is ever allowed, in s.
    pub injection_limit_s: f64,
    /// Shortest time between two injections that the chamber allows, in s.
    pub injection_interval_limit_s: f64,
    /// A real `dg645`: somebody has seen on an oscilloscope that the injector's output fires with the last frame of a cycle
    /// (docs/INSTRUMENTS.md, Trigger units); absent: no.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub prescaler_checked: bool,
}

fn default_reopen_s() -> f64 {
    10.0
}

/// `[camera]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Driver: `sim` or `gige` (built with the feature `aravis`).
    pub driver: String,
    /// `sim` or the camera's network address.
    pub address: String,
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub columns: usize,
    /// Integration time, in s.
    pub integration_s: f64,
    /// Bits of a sample, 8 … 16.
    pub bits: u32,
    /// Counts from here on are saturated.
    pub saturation_count: u16,
    /// Time that the camera needs to read a frame out, in s: exposures may not overlap it.
    pub readout_s: f64,
    /// Read noise, in counts (standard deviation), for the noise floor of the fit.
    pub read_noise_counts: f64,
    /// Photoelectrons per count, for the shot noise of the fit.
    pub electrons_per_count: f64,
    /// What only a GigE camera needs: preset, names of features, packets, buffers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<serde_json::Value>")]
    pub gige: Option<GigeSettings>,
    /// Which camera it is, for the key of calibrations: a name or serial number. Absent: not told apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its lens, for the key of calibrations. Absent: not told apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<String>,
    /// Its gain setting, for the key of calibrations. Absent: not told apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<String>,
}

/// `[optics]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Transmittance γ of the window between spray and camera, in the band.
    pub gamma_near: f64,
    /// Transmittance γ of the window between plate and spray, in the band.
    pub gamma_far: f64,
    /// Reflectance of the far window: how much of the walls it mirrors into the camera.
    pub reflectance_far: f64,
    /// Temperature of the walls that the far window mirrors, in K.
    pub wall_temperature_k: f64,
    /// Emissivity ε_B of the plate in the band.
    pub emissivity_plate: f64,
    /// `"measure"` or the path of a calibration folder or `calibration.json`.
    pub calibration: String,
    /// The filter, for the key of calibrations. Absent: not told apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Pass band of camera, lens and filter from the data sheets: it holds the calibration curve's exponent where points
    /// are few or noisy. Absent: from the points alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub passband: Option<Passband>,
    /// Standard deviation of `gamma_near` for the uncertainty budget. Absent, as for all that follow: not in the budget, and
    /// the summary says so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_gamma_near: Option<f64>,
    /// Standard deviation of `gamma_far`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_gamma_far: Option<f64>,
    /// Standard deviation of `reflectance_far`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_reflectance_far: Option<f64>,
    /// Standard deviation of `wall_temperature_k`, in K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_wall_temperature_k: Option<f64>,
    /// Standard deviation of `emissivity_plate`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_emissivity_plate: Option<f64>,
    /// Standard deviation of the plate's temperature over its surface, in K: what a pixel's part of it differs from the
    /// reading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_plate_uniformity_k: Option<f64>,
    /// Standard deviation of the plate's reading against the true scale, in K, common to calibration and campaign: its
    /// certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_plate_reading_k: Option<f64>,
}

/// `[calibration]`: acquisition of the standard curve, without chamber and injector.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Plate temperatures in K, at least four.
    pub levels_k: Vec<f64>,
    /// Frames averaged at each level, and as many with the shutter closed.
    pub frames: u32,
    /// Frames thrown away before each series: more than in a campaign, since the series with the shutter follows a
    /// long pause and the other does not, so that a camera's warming up does not cancel.
    pub warm_up: u32,
    /// What the frames are compared with: the camera's shutter, or nothing, and the offset is fitted with the curve.
    #[serde(default)]
    pub reference: Reference,
    /// Two temperatures of what the plate mirrors, in K, for `--kind emissivity` without a reference body.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ambient_k: Option<[f64; 2]>,
}

/// Where the offset of a calibration comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Reference {
    /// Frames with the camera's shutter closed, at every level.
    #[default]
    Shutter,
    /// The camera has none: the offset is a parameter of the curve, with its uncertainty.
    Fitted,
}

/// `[fit]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fit {
    /// `default`, `paper` or `ols`.
    pub estimator: String,
    /// A shot that shows less than this part of an ordinary spray is a misfire and left out of the map, 0 … 0.9;
    /// absent: 0.2. Low, so that weak real shots stay in the ensemble.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub misfire_score: Option<f64>,
    /// Pixels of a smaller emissivity get the flag `LOW_EMISSIVITY`; absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask_emissivity_below: Option<f64>,
    /// Pixels whose temperature has a larger standard deviation, in K, or none, get the flag `HIGH_SIGMA`; absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask_sigma_above_k: Option<f64>,
}

impl Fit {
    /// What is masked.
    pub fn limits(&self) -> Limits {
        Limits { emissivity_below: self.mask_emissivity_below, sigma_above_k: self.mask_sigma_above_k }
    }
}

/// `[target]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Emissivity above which pixels count in the true error of a simulated run.
    pub emissivity_min: f64,
}

impl Config {
    /// Reads a campaign file's text; `name` is how messages call the file.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] when the text is no TOML, has unknown or missing keys, or asks for something impossible.
    pub fn parse(name: &str, text: &str) -> Result<Self, ConfigError> {
        diagnose::refuse_newer_schema(name, text)?;
        let config: Self =
            toml::from_str(text).map_err(|error| ConfigError::from_toml(name, text, &error))?;
        let problems = check::problems(&config);
        if problems.is_empty() { Ok(config) } else { Err(ConfigError::from_problems(name, text, &problems)) }
    }

    /// The levels in the order in which they are visited, in K.
    pub fn levels_in_order(&self) -> Vec<f64> {
        let mut levels = self.campaign.levels_k.clone();
        match self.campaign.order {
            Order::Ascending => levels.sort_by(f64::total_cmp),
            Order::Descending => levels.sort_by(|a, b| b.total_cmp(a)),
            Order::AsGiven => {}
        }
        levels
    }

    /// Whether every instrument is simulated inside this program. A rig that is simulated behind real lines
    /// (`ditd sim serve`) is real to the one that runs it.
    pub fn is_simulated(&self) -> bool {
        let instruments = [&self.plate.address, &self.trigger.address, &self.camera.address];
        let monitors = self.monitors.iter().map(|monitor| &monitor.address);
        instruments.into_iter().chain(monitors).all(|address| address == SIMULATED)
    }

    /// The same campaign with every instrument simulated inside this program, in virtual time.
    #[must_use]
    pub fn simulated_inside(&self) -> Self {
        let mut inside = self.clone();
        for address in [&mut inside.plate.address, &mut inside.trigger.address, &mut inside.camera.address] {
            SIMULATED.clone_into(address);
        }
        // Of monitors only those can be inside whose queries the simulated sensors are asked.
        inside.monitors.retain(|monitor| matches!(monitor.driver.as_str(), "ascii_query" | "sim"));
        inside.monitors.iter_mut().for_each(|monitor| SIMULATED.clone_into(&mut monitor.address));
        SIMULATED.clone_into(&mut inside.camera.driver);
        inside.camera.gige = None;
        inside.campaign.pace = Pace::Max;
        inside
    }

    /// What the rig allows of a program of shots.
    pub fn trigger_limits(&self) -> TriggerLimits {
        TriggerLimits {
            injector_pulse_max_s: self.trigger.injection_limit_s,
            injection_interval_min_s: self.trigger.injection_interval_limit_s,
            camera_integration_s: self.camera.integration_s,
            camera_readout_s: self.camera.readout_s,
        }
    }

    /// Emissivity above which pixels count in the true error of a simulated run (0.2 unless set).
    pub fn emissivity_min(&self) -> f64 {
        self.target.as_ref().map_or(0.2, |target| target.emissivity_min)
    }
}
