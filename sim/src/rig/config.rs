//! The `[rig]` table of a campaign file: the simulated world, with units in every name.
//!
//! Nothing physical has a hidden default. The few defaults that exist are the assumed camera (table
//! `camera_assumed`, notes on optics §3: typical values of a cooled 640×512 camera for 3–5 µm whose count scale
//! reproduces the paper's) and the plate's emissivity (the maker's curve at 3.4 µm); each says so. Builds no
//! scene and reads no file.

use super::RigError;
use super::fluke_418x::FlukeBehaviour;
use super::gige::{GigeFault, Preset};
use super::hart_9132::HartBehaviour;
use super::ir_301::Ir301Behaviour;
use super::plate::PlateModel;
use super::process::ProcessConfig;
use super::pulser::PulserBehaviour;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The simulated world behind the instruments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigConfig {
    /// The spray in the chamber; absent = an empty chamber.
    pub spray: Option<SprayConfig>,
    /// The chamber; absent = a bench: the camera looks straight at the plate, without windows.
    pub chamber: Option<ChamberConfig>,
    /// Windows of the chamber.
    pub window: Option<WindowsConfig>,
    /// The plate as the camera sees it.
    pub plate_view: PlateViewConfig,
    /// Where the camera stands and what it sees.
    pub view: ViewConfig,
    /// Detector, lens and electronics of the camera.
    pub detector: DetectorConfig,
    /// How injections differ from each other; absent = all alike.
    pub fluctuation: Option<FluctuationConfig>,
    /// The filter in front of the detector.
    pub filter: FilterConfig,
    /// Absolute rms error of the rendered coefficients over the pixels that meet the spray.
    pub target_error: f64,
    /// Faults to play.
    #[serde(default, rename = "fault")]
    pub faults: Vec<Fault>,
    /// The plate and its controller.
    pub plate: PlateModel,
    /// The side of its line of a calibrator `fluke_418x`; a well-behaved 4181 when absent.
    #[serde(default = "FlukeBehaviour::fluke_4181")]
    pub calibrator: FlukeBehaviour,
    /// The same for `hart_9132`; well behaved when absent.
    #[serde(default = "HartBehaviour::delivered")]
    pub hart_9132: HartBehaviour,
    /// The same for `ir_301`; well behaved when absent.
    #[serde(default = "Ir301Behaviour::delivered")]
    pub ir_301: Ir301Behaviour,
    /// Sensors besides those of chamber and windows, noise and faults of all; absent: none.
    pub process: Option<ProcessConfig>,
    /// The trigger unit's side of its line; well behaved when absent. Which model it is `trigger.driver` says.
    #[serde(default = "PulserBehaviour::delivered")]
    pub pulser: PulserBehaviour,
    /// The camera's side of the network, where it is served as a GigE Vision device; a generic one when absent.
    #[serde(default)]
    pub gige: GigeBehaviour,
}

/// The camera as a GigE Vision device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GigeBehaviour {
    /// Whose names and habits it has.
    #[serde(default = "GigeBehaviour::by_the_book")]
    pub preset: Preset,
    /// What goes wrong on the network; nothing when absent.
    #[serde(default, rename = "fault")]
    pub faults: Vec<GigeFault>,
}

impl GigeBehaviour {
    fn by_the_book() -> Preset {
        Preset::Generic
    }
}

impl Default for GigeBehaviour {
    fn default() -> Self {
        Self { preset: Self::by_the_book(), faults: Vec::new() }
    }
}

/// The spray and how it is rendered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SprayConfig {
    /// Where the spray comes from: `{ embedded = "NAME" }`, `{ path = "FILE" }` or
    /// `{ scene = "SCENE.toml" }`.
    pub source: SpraySource,
    /// Name of a shipped fuel, or the path of a fuel of your own (`.toml`, docs/MATERIALS.md), relative to the campaign
    /// file.
    pub fuel: String,
    /// Time after the start of injection, in seconds; absent = the only or last time of the source, or the scene's.
    pub time_s: Option<f64>,
    /// Edge of a cell of the rendered medium, in metres.
    pub cell_m: f64,
    /// Factors on the optical depth at which the spray is rendered, ascending; with fluctuations at least three
    /// that span the usual shots, for instance 0.7, 1.0, 1.4.
    pub scales: Vec<f64>,
    /// Offset in kelvin of the two additional medium temperatures that are rendered (below and above).
    pub temperature_offset_k: f64,
}

/// Where a spray comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SpraySource {
    /// A compact spray that is part of the program.
    Embedded(String),
    /// A file or folder, relative to the campaign file.
    Path(PathBuf),
    /// The parametric spray of a scene file (`[medium] kind = "multi-hole"` or `"hollow-cone"`), relative to the campaign
    /// file: its mean over shots. Of the scene nothing else counts.
    Scene(PathBuf),
}

/// Gas and walls.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChamberConfig {
    /// Temperature of the gas and of left-over vapour, in kelvin.
    pub gas_temperature_k: f64,
    /// Temperature of the walls, in kelvin.
    pub wall_temperature_k: f64,
    /// Pressure, in pascal.
    pub pressure_pa: f64,
    /// Emissivity of the walls in the band, above 0 and at most 1.
    pub wall_emissivity: f64,
    /// Part of the chamber's inner surface that is the far window, as seen from the walls, from 0 to below 1.
    /// Walls of emissivity below one mirror the plate by it.
    pub window_fraction: f64,
    /// Vapour left after an injection; absent = none.
    pub residual: Option<ResidualConfig>,
}

/// Vapour that an injection leaves behind and the pause must flush out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualConfig {
    /// Optical depth (gray, in the band) right after an injection, in pixels where the spray is opaque.
    pub optical_depth: f64,
    /// Time in seconds in which it falls to 1/e.
    pub decay_s: f64,
}

/// Both windows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowsConfig {
    /// The window on the camera's side.
    pub near: WindowConfig,
    /// The window on the plate's side.
    pub far: WindowConfig,
}

/// One window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowConfig {
    /// Name of a shipped material, for instance `caf2`, or the path of a table of your own (`.csv`), relative to the
    /// campaign file.
    pub material: String,
    /// Thickness, in metres.
    pub thickness_m: f64,
    /// Temperature, in kelvin.
    pub temperature_k: f64,
}

/// The black-body plate as the camera sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlateViewConfig {
    /// Emissivity in the band. Default 0.959: the maker's curve of the paint at 3.4 µm (notes on hardware §2).
    #[serde(default = "plate_emissivity")]
    pub emissivity: f64,
    /// Temperature of the laboratory that the plate mirrors, in kelvin.
    pub lab_temperature_k: f64,
    /// Centre of the plate, in metres.
    pub centre_m: [f64; 3],
    /// Direction into which the plate looks.
    pub facing: [f64; 3],
    /// Diameter, in metres.
    pub diameter_m: f64,
}

/// Where the camera stands. Exactly one of `horizontal_fov_deg` and `width_m` is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewConfig {
    /// Position of the pupil, in metres.
    pub position_m: [f64; 3],
    /// Point in the centre of the image, in metres.
    pub look_at_m: [f64; 3],
    /// Direction towards row 0.
    pub up: [f64; 3],
    /// Columns of the image.
    pub columns: usize,
    /// Rows of the image.
    pub rows: usize,
    /// Horizontal field of view in degrees: a pinhole camera.
    pub horizontal_fov_deg: Option<f64>,
    /// Width of the image in metres: a telecentric camera.
    pub width_m: Option<f64>,
}

/// Lens, detector and electronics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorConfig {
    /// F-number of the lens. Default 2.0 (assumed camera).
    #[serde(default = "f_number")]
    pub f_number: f64,
    /// Edge of a pixel, in metres. Default 15e-6 (assumed camera).
    #[serde(default = "pixel_pitch_m")]
    pub pixel_pitch_m: f64,
    /// Factor on the band's response (electrons per photon at the lens). Default 1: the response holds filter, lens and
    /// quantum efficiency. For a response file of the filter alone: 0.675 (assumed camera: 0.75 · 0.90).
    #[serde(default = "response_factor")]
    pub response_factor: f64,
    /// Electrons per count. Default 427 (assumed camera: 7e6 electrons over 14 bits).
    #[serde(default = "electrons_per_count")]
    pub electrons_per_count: f64,
    /// Read noise, in electrons rms. Default 600 (assumed camera).
    #[serde(default = "read_noise_electrons")]
    pub read_noise_electrons: f64,
    /// Counts without light. Default 500 (assumed camera).
    #[serde(default = "offset_counts")]
    pub offset_counts: f64,
    /// Bits of a sample. Default 14 (assumed camera).
    #[serde(default = "bits")]
    pub bits: u32,
    /// Relative standard deviation of the pixels' gains.
    pub gain_spread: f64,
    /// Standard deviation of the pixels' offsets, in counts.
    pub offset_spread_counts: f64,
    /// Temperature of the internal shutter, in kelvin; absent = the camera has none.
    pub shutter_temperature_k: Option<f64>,
    /// Slow drift of the offset; absent = none.
    pub drift: Option<DriftConfig>,
    /// First frames after a pause; absent = they are like all others.
    pub warm_up: Option<WarmUpConfig>,
}

/// Slow drift of the offset in time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftConfig {
    /// Standard deviation over long times of the part common to all pixels, in counts.
    pub common_counts: f64,
    /// The same for the tilt from one edge of the image to the other, in counts at the edge.
    pub tilt_counts: f64,
    /// Time scale of the drift, in seconds.
    pub time_s: f64,
}

/// The transient of the first frames after an idle pause.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WarmUpConfig {
    /// Additional counts of the first frame after a pause.
    pub counts: f64,
    /// Frames in which the excess falls to 1/e.
    pub frames: f64,
    /// A gap between exposures longer than this, in seconds, is a pause.
    pub idle_s: f64,
}

/// How injections differ from each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FluctuationConfig {
    /// Standard deviation of ln(optical depth) over injections.
    pub sigma_ln_tau: f64,
    /// Standard deviation of the medium's temperature over injections, in kelvin.
    pub sigma_temperature_k: f64,
    /// Correlation of both, from −1 to 1.
    pub correlation: f64,
    /// Correlation length over the image, in pixels.
    pub correlation_length_px: f64,
}

/// The filter and its sampling: the product of all that is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterConfig {
    /// Column of the shipped response table, for instance `filter_3.40_fwhm0.12`.
    pub name: Option<String>,
    /// Column of the detector in the same table: `QE_InSb_model` or `QE_MCT_MWIR_model`. The lens of that table comes
    /// with it.
    pub detector: Option<String>,
    /// Tables of one's own (columns wavelength_um and response; several are multiplied on their own grids).
    #[serde(default)]
    pub response: Vec<PathBuf>,
    /// Air of the laboratory in front of the camera, on the bench as at the chamber; absent: none.
    pub air: Option<AirConfig>,
    /// Wavelength samples inside the band (leakage has its own besides), or `"auto"`: the fewest that are right for the
    /// fuel.
    pub samples: Sampling,
}

/// A path through the laboratory's air.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AirConfig {
    /// `us-standard`, `midlatitude-summer` or `midlatitude-winter`.
    pub atmosphere: String,
    /// Length in metres, 0 to 10.
    pub length_m: f64,
}

/// How finely a band is sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Sampling {
    /// Equal stretches of wavelength, above 0.
    Number(usize),
    /// The word `"auto"`.
    Word(SamplingWord),
}

/// A word in the place of a number of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum SamplingWord {
    /// As few as the fuel allows.
    #[serde(rename = "auto")]
    Automatic,
}

/// A fault that the simulated camera or injector plays. Ordinals count from 0 over the life of the rig.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Fault {
    /// Frame `frame` is exposed and numbered but never delivered: the ids show a gap.
    LoseFrame {
        /// Ordinal of the exposure.
        frame: u64,
    },
    /// Frame `frame` is delivered with its lower half missing and marked incomplete.
    IncompleteFrame {
        /// Ordinal of the exposure.
        frame: u64,
    },
    /// From exposure `frame` on the camera ignores triggers until it is stopped and started again.
    Stuck {
        /// Ordinal of the exposure that would have come.
        frame: u64,
    },
    /// The injector does not open at injection `injection`: the spray frame shows none.
    Misfire {
        /// Ordinal of the injection.
        injection: u64,
    },
}

impl RigConfig {
    /// Checks every range that the simulated world relies on.
    ///
    /// # Errors
    /// [`RigError::Config`] with the first key whose value is impossible, and why.
    pub fn validate(&self) -> Result<(), RigError> {
        positive("target_error", self.target_error)?;
        self.spray.iter().try_for_each(SprayConfig::validate)?;
        self.chamber.iter().try_for_each(ChamberConfig::validate)?;
        self.window.iter().try_for_each(WindowsConfig::validate)?;
        if self.chamber.is_none() && (self.spray.is_some() || self.window.is_some()) {
            return refuse("chamber", "a spray or a window needs a chamber");
        }
        self.plate_view.validate()?;
        self.view.validate()?;
        self.detector.validate()?;
        if let (Some(law), Some(spray)) = (&self.fluctuation, &self.spray) {
            law.validate()?;
            if law.sigma_ln_tau > 0.0 && spray.scales.len() < 3 {
                return refuse("spray.scales", "a fluctuating spray is rendered at three scales at least");
            }
        }
        if self.filter.samples == Sampling::Number(0) {
            return refuse("filter.samples", "at least one sample");
        }
        if self.filter.name.is_none() && self.filter.detector.is_none() && self.filter.response.is_empty() {
            return refuse("filter", "name a filter and a detector, or a table: response = [\"my.csv\"]");
        }
        Ok(())
    }
}

impl SprayConfig {
    fn validate(&self) -> Result<(), RigError> {
        positive("spray.cell_m", self.cell_m)?;
        positive("spray.temperature_offset_k", self.temperature_offset_k)?;
        if self.scales.is_empty() || self.scales.windows(2).any(|pair| pair[0] >= pair[1]) {
            return refuse("spray.scales", "one factor or more, ascending");
        }
        self.scales.iter().try_for_each(|&s| positive("spray.scales", s))
    }
}

impl ChamberConfig {
    fn validate(&self) -> Result<(), RigError> {
        positive("chamber.gas_temperature_k", self.gas_temperature_k)?;
        positive("chamber.wall_temperature_k", self.wall_temperature_k)?;
        positive("chamber.pressure_pa", self.pressure_pa)?;
        fraction("chamber.wall_emissivity", self.wall_emissivity)?;
        fraction("chamber.window_fraction", self.window_fraction)?;
        if self.wall_emissivity <= 0.0 || self.window_fraction >= 1.0 {
            return refuse("chamber", "the walls must have an area and an emissivity");
        }
        self.residual.iter().try_for_each(|r| {
            not_negative("chamber.residual.optical_depth", r.optical_depth)?;
            positive("chamber.residual.decay_s", r.decay_s)
        })
    }
}

impl WindowsConfig {
    fn validate(&self) -> Result<(), RigError> {
        [&self.near, &self.far].into_iter().try_for_each(|w| {
            positive("window.thickness_m", w.thickness_m)?;
            positive("window.temperature_k", w.temperature_k)
        })
    }
}

impl PlateViewConfig {
    fn validate(&self) -> Result<(), RigError> {
        fraction("plate_view.emissivity", self.emissivity)?;
        positive("plate_view.emissivity", self.emissivity)?;
        positive("plate_view.lab_temperature_k", self.lab_temperature_k)?;
        positive("plate_view.diameter_m", self.diameter_m)
    }
}

impl ViewConfig {
    fn validate(&self) -> Result<(), RigError> {
        if self.rows == 0 || self.columns == 0 {
            return refuse("view", "an image has at least one row and one column");
        }
        match (self.horizontal_fov_deg, self.width_m) {
            (Some(angle), None) if angle > 0.0 && angle < 180.0 => Ok(()),
            (None, Some(width)) => positive("view.width_m", width),
            (Some(_), None) => refuse("view.horizontal_fov_deg", "between 0 and 180"),
            _ => refuse("view", "give either horizontal_fov_deg (pinhole) or width_m (telecentric)"),
        }
    }
}

impl DetectorConfig {
    /// The assumed camera (table `camera_assumed`) without spread, shutter, drift and warm-up transient.
    pub fn assumed() -> Self {
        Self {
            f_number: f_number(),
            pixel_pitch_m: pixel_pitch_m(),
            response_factor: response_factor(),
            electrons_per_count: electrons_per_count(),
            read_noise_electrons: read_noise_electrons(),
            offset_counts: offset_counts(),
            bits: bits(),
            gain_spread: 0.0,
            offset_spread_counts: 0.0,
            shutter_temperature_k: None,
            drift: None,
            warm_up: None,
        }
    }

    /// Highest count of a sample: 2^bits − 1.
    pub fn counts_max(&self) -> u16 {
        u16::try_from((1_u32 << self.bits.min(16)) - 1).unwrap_or(u16::MAX)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`RigError::Config`] with the first impossible key.
    pub fn validate(&self) -> Result<(), RigError> {
        positive("detector.f_number", self.f_number)?;
        positive("detector.pixel_pitch_m", self.pixel_pitch_m)?;
        positive("detector.response_factor", self.response_factor)?;
        positive("detector.electrons_per_count", self.electrons_per_count)?;
        not_negative("detector.read_noise_electrons", self.read_noise_electrons)?;
        not_negative("detector.offset_counts", self.offset_counts)?;
        not_negative("detector.gain_spread", self.gain_spread)?;
        not_negative("detector.offset_spread_counts", self.offset_spread_counts)?;
        if !(1..=16).contains(&self.bits) {
            return refuse("detector.bits", "1 to 16");
        }
        self.shutter_temperature_k.iter().try_for_each(|&t| positive("detector.shutter_temperature_k", t))?;
        self.drift.iter().try_for_each(|d| {
            not_negative("detector.drift.common_counts", d.common_counts)?;
            not_negative("detector.drift.tilt_counts", d.tilt_counts)?;
            positive("detector.drift.time_s", d.time_s)
        })?;
        self.warm_up.iter().try_for_each(|w| {
            positive("detector.warm_up.frames", w.frames)?;
            positive("detector.warm_up.idle_s", w.idle_s)
        })
    }
}

impl FluctuationConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`RigError::Config`] with the first impossible key.
    pub fn validate(&self) -> Result<(), RigError> {
        not_negative("fluctuation.sigma_ln_tau", self.sigma_ln_tau)?;
        not_negative("fluctuation.sigma_temperature_k", self.sigma_temperature_k)?;
        positive("fluctuation.correlation_length_px", self.correlation_length_px)?;
        if self.correlation.abs() <= 1.0 { Ok(()) } else { refuse("fluctuation.correlation", "−1 to 1") }
    }
}

fn refuse<T>(key: &str, why: &str) -> Result<T, RigError> {
    Err(RigError::Config { key: format!("rig.{key}"), why: why.to_owned() })
}

fn positive(key: &str, value: f64) -> Result<(), RigError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { refuse(key, &format!("{value} is not above zero")) }
}

fn not_negative(key: &str, value: f64) -> Result<(), RigError> {
    if value >= 0.0 && value.is_finite() { Ok(()) } else { refuse(key, &format!("{value} is negative")) }
}

fn fraction(key: &str, value: f64) -> Result<(), RigError> {
    if (0.0..=1.0).contains(&value) { Ok(()) } else { refuse(key, &format!("{value} is not from 0 to 1")) }
}

// Maker's curve of the paint at 3.4 µm: notes on hardware §2.
fn plate_emissivity() -> f64 {
    0.959
}
// The rest: table camera_assumed, whose status column says which numbers the paper gives and which are typical.
fn f_number() -> f64 {
    2.0
}
fn pixel_pitch_m() -> f64 {
    15e-6
}
fn response_factor() -> f64 {
    1.0
}
fn electrons_per_count() -> f64 {
    427.0
}
fn read_noise_electrons() -> f64 {
    600.0
}
fn offset_counts() -> f64 {
    500.0
}
fn bits() -> u32 {
    14
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: &str = r#"
        target_error = 1e-3
        [spray]
        source = { embedded = "eight-hole" }
        fuel = "n-heptane"
        cell_m = 5e-4
        scales = [0.7, 1.0, 1.4]
        temperature_offset_k = 8.0
        [chamber]
        gas_temperature_k = 523.0
        wall_temperature_k = 523.0
        pressure_pa = 4e5
        wall_emissivity = 0.9
        window_fraction = 0.05
        residual = { optical_depth = 0.5, decay_s = 4.0 }
        [window.near]
        material = "caf2"
        thickness_m = 0.01
        temperature_k = 400.0
        [window.far]
        material = "caf2"
        thickness_m = 0.01
        temperature_k = 450.0
        [plate_view]
        lab_temperature_k = 296.0
        centre_m = [0.0, 0.4, 0.0]
        facing = [0.0, -1.0, 0.0]
        diameter_m = 0.1524
        [view]
        position_m = [0.0, -0.6, 0.0]
        look_at_m = [0.0, 0.0, 0.0]
        up = [0.0, 0.0, 1.0]
        columns = 640
        rows = 512
        width_m = 0.16
        [detector]
        gain_spread = 0.01
        offset_spread_counts = 3.0
        shutter_temperature_k = 300.0
        drift = { common_counts = 1.0, tilt_counts = 0.3, time_s = 600.0 }
        warm_up = { counts = 20.0, frames = 1.0, idle_s = 1.0 }
        [fluctuation]
        sigma_ln_tau = 0.05
        sigma_temperature_k = 1.0
        correlation = -0.4
        correlation_length_px = 40.0
        [filter]
        name = "filter_3.40_fwhm0.12"
        detector = "QE_InSb_model"
        samples = 16
        [plate]
        ambient_k = 296.0
        display_error_k = 0.3
        display_error_per_k = 0.001
        display_noise_k = 0.02
        [[fault]]
        kind = "lose-frame"
        frame = 12
        [[fault]]
        kind = "misfire"
        injection = 3
    "#;

    #[test]
    fn sample_loads_validates_and_survives_a_round_trip() {
        let config: RigConfig = toml::from_str(SAMPLE).unwrap();
        config.validate().unwrap();
        assert_eq!(config.detector.counts_max(), 16383);
        assert_eq!(config.faults.len(), 2);
        assert_eq!(config.plate_view.emissivity.to_bits(), 0.959_f64.to_bits());
        let again: RigConfig = toml::from_str(&toml::to_string(&config).unwrap()).unwrap();
        assert_eq!(again, config);
    }

    #[test]
    fn the_filter_is_sampled_as_it_says() {
        let with = |to: &str| toml::from_str::<RigConfig>(&SAMPLE.replacen("samples = 16", to, 1));
        let sampling = |to: &str| with(to).unwrap().filter.samples;
        assert_eq!(sampling("samples = 16"), Sampling::Number(16));
        assert_eq!(sampling("samples = \"auto\""), Sampling::Word(SamplingWord::Automatic));
        assert!(with("samples = \"all\"").is_err() && with("samples = -1").is_err());
        let auto = with("samples = \"auto\"\nresponse = [\"own.csv\"]").unwrap();
        let again: RigConfig = toml::from_str(&toml::to_string(&auto).unwrap()).unwrap();
        assert_eq!(again, auto);
        let none = SAMPLE.replacen("name = \"filter_3.40_fwhm0.12\"", "", 1);
        let none = none.replacen("detector = \"QE_InSb_model\"", "", 1);
        let refused = toml::from_str::<RigConfig>(&none).unwrap().validate().unwrap_err().to_string();
        assert!(refused.contains("response"), "{refused}");
    }

    #[test]
    fn unknown_keys_are_refused() {
        for (from, to) in [
            ("target_error", "target_eror"),
            ("decay_s", "decay_ms"),
            ("frame = 12", "frames = 12"),
            ("fuel =", "fule ="),
        ] {
            let text = SAMPLE.replacen(from, to, 1);
            assert!(toml::from_str::<RigConfig>(&text).is_err(), "{to}");
        }
    }

    #[test]
    fn impossible_values_name_their_key() {
        for (from, to, key) in [
            ("correlation = -0.4", "correlation = -1.4", "rig.fluctuation.correlation"),
            ("scales = [0.7, 1.0, 1.4]", "scales = [1.0]", "rig.spray.scales"),
            ("width_m = 0.16", "", "rig.view"),
            ("pressure_pa = 4e5", "pressure_pa = -1.0", "rig.chamber.pressure_pa"),
        ] {
            let config: RigConfig = toml::from_str(&SAMPLE.replacen(from, to, 1)).unwrap();
            let message = config.validate().unwrap_err().to_string();
            assert!(message.contains(key), "{message}");
        }
    }
}
