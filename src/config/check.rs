//! Limits and impossible combinations of a campaign file. Pure.

use super::{Config, Pace, Reference, SIMULATED, monitor};
use crate::estimate::mask::Limits;
use crate::plan::{Plan, Purpose};
use ditd_drivers::gige::GigeSettings;
use ditd_drivers::trigger_limits::{self, About};
use ditd_drivers::{CALIBRATORS, TRIGGER_UNITS, TriggerModel};
use ditd_sim::light::air::{AirPath, Atmosphere};
use ditd_sim::light::band::Response;
use ditd_sim::light::fuel::Fuel;
use ditd_sim::light::window::{Material, WindowError};
use ditd_sim::rig::RigError;
use ditd_sim::rig::process::ProcessConfig;
use ditd_sim::scene::library;

/// Something that cannot be done as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The key, as `table.key`.
    pub key: String,
    /// What is wrong and what would be right.
    pub message: String,
}

/// Longest side of a frame, in pixels: the largest arrays that are sold have 4096.
const PIXELS_SIDE_MAX: usize = 8192;

/// Everything that is wrong with a config whose keys are all known.
pub(super) fn problems(config: &Config) -> Vec<Problem> {
    let mut found = Vec::new();
    campaign(config, &mut found);
    soak(config, &mut found);
    instruments(config, &mut found);
    optics(config, &mut found);
    monitor::problems(config, &mut found);
    world(config, &mut found);
    // Times that are no times are named above; a plan is made of good ones only.
    if found.is_empty() {
        triggering(config, &mut found);
    }
    found
}

/// What the trigger unit's driver would refuse, asked of every program of the plans.
fn triggering(config: &Config, found: &mut Vec<Problem>) {
    let Some(model) = trigger_model(config) else { return };
    let limits = config.trigger_limits();
    let plans = [Some(Plan::of_map(config)), Plan::of_standard_curve(config)];
    for plan in plans.iter().flatten() {
        // All levels of a plan have the same program.
        for level in plan.levels.iter().take(1) {
            for complaint in trigger_limits::complaints(&level.program, &limits, &model.range) {
                let key = key_of(complaint.about, plan.purpose);
                if !found.iter().any(|problem| problem.key == key) {
                    found.push(Problem { key: key.to_owned(), message: complaint.why });
                }
            }
        }
    }
}

fn trigger_model(config: &Config) -> Option<&'static TriggerModel> {
    TRIGGER_UNITS.iter().find(|model| model.name == config.trigger.driver)
}

fn key_of(about: About, purpose: Purpose) -> &'static str {
    match (about, purpose) {
        (About::Limits, _) => "trigger.injection_limit_s",
        (About::Period | About::ReadOut, _) => "campaign.frame_period_s",
        (About::Counts | About::Pause, Purpose::StandardCurve) => "calibration.frames",
        (About::Counts, Purpose::Map) => "campaign.cycles",
        (About::Pause | About::InjectionInterval, _) => "campaign.pause_s",
        (About::CameraPulse, _) => "trigger.exposure_delay_s",
        (About::InjectorPulse | About::InjectorLength, _) => "trigger.injection_s",
    }
}

fn require(found: &mut Vec<Problem>, holds: bool, key: &'static str, message: impl FnOnce() -> String) {
    if !holds {
        found.push(Problem { key: key.to_owned(), message: message() });
    }
}

/// Longest time between two looks at the plate, in s: its limits are judged when it is read, and a 4181 heats by 25
/// kelvin in that time.
const POLL_MAX_S: f64 = 60.0;

fn positive(found: &mut Vec<Problem>, value: f64, key: &'static str, unit: &str) {
    require(found, value.is_finite() && value > 0.0, key, || {
        format!("must be a positive number of {unit}, found {value}")
    });
}

fn campaign(config: &Config, found: &mut Vec<Problem>) {
    let c = &config.campaign;
    let mut distinct = c.levels_k.clone();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    require(found, distinct.len() >= 2, "campaign.levels_k", || {
        "a line needs at least two different plate temperatures".to_owned()
    });
    for level in &c.levels_k {
        // 418x manual: the 4181 goes from 35 °C; the 4180 down to −15 °C.
        require(found, (258.0..=773.15).contains(level), "campaign.levels_k", || {
            format!("{level} K is outside 258 … 773 K (temperatures are in kelvin)")
        });
        require(found, *level <= config.plate.limit_k, "campaign.levels_k", || {
            format!("{level} K is above plate.limit_k = {} K", config.plate.limit_k)
        });
    }
    require(found, c.cycles >= 1, "campaign.cycles", || "at least one cycle a level".to_owned());
    require(found, (1..=256).contains(&c.blanks), "campaign.blanks", || {
        format!("between 1 and 256 blank frames a cycle, found {}", c.blanks)
    });
    require(found, c.warm_up <= 1000, "campaign.warm_up", || {
        format!("at most 1000 discarded frames a cycle, found {}", c.warm_up)
    });
    positive(found, c.frame_period_s, "campaign.frame_period_s", "seconds");
    positive(found, c.pause_s, "campaign.pause_s", "seconds");
    let busy = config.camera.integration_s + config.camera.readout_s;
    require(found, c.frame_period_s >= busy, "campaign.frame_period_s", || {
        format!(
            "{} s is shorter than exposure plus read-out ({busy} s): frames would overlap",
            c.frame_period_s
        )
    });
    let between = f64::from(c.warm_up + c.blanks + 1) * c.frame_period_s + c.pause_s;
    require(found, between >= config.trigger.injection_interval_limit_s, "campaign.pause_s", || {
        format!(
            "injections would be {between:.3} s apart; trigger.injection_interval_limit_s allows {} s at least",
            config.trigger.injection_interval_limit_s
        )
    });
    // The plan counts periods in 32 bits; what the trigger unit counts it says below.
    require(found, between / c.frame_period_s * f64::from(c.cycles.max(1)) < 4e9, "campaign.cycles", || {
        "cycles · (frames + pause) / frame_period exceeds 4·10⁹ clock periods".to_owned()
    });
    require(found, c.epoch.parse::<jiff::Timestamp>().is_ok(), "campaign.epoch", || {
        format!("must be an RFC 3339 time such as 2026-01-01T00:00:00Z, found {:?}", c.epoch)
    });
    require(
        found,
        !(c.pace == Pace::Real && config.rig.is_none()) || config.rig.is_none(),
        "campaign.pace",
        || "a real rig has only one pace".to_owned(),
    );
}

fn soak(config: &Config, found: &mut Vec<Problem>) {
    let s = &config.soak;
    positive(found, s.band_k, "soak.band_k", "kelvin");
    positive(found, s.hold_s, "soak.hold_s", "seconds");
    positive(found, s.slope_limit_k_per_min, "soak.slope_limit_k_per_min", "kelvin per minute");
    positive(found, s.poll_s, "soak.poll_s", "seconds");
    require(found, s.poll_s.is_nan() || s.poll_s <= POLL_MAX_S, "soak.poll_s", || {
        format!("{} s: the plate must be looked at every {POLL_MAX_S} s at least", s.poll_s)
    });
    positive(found, s.stale_s, "soak.stale_s", "seconds");
    positive(found, s.timeout_s, "soak.timeout_s", "seconds");
    require(found, s.hold_s >= 3.0 * s.poll_s, "soak.hold_s", || {
        format!("must hold at least three readings (3 × poll_s = {} s)", 3.0 * s.poll_s)
    });
    require(found, s.timeout_s > s.hold_s, "soak.timeout_s", || {
        format!("{} s would end before the hold time of {} s is over", s.timeout_s, s.hold_s)
    });
}

fn instruments(config: &Config, found: &mut Vec<Problem>) {
    let simulated = config.rig.is_some();
    for (key, address) in [
        ("plate.address", &config.plate.address),
        ("trigger.address", &config.trigger.address),
        ("camera.address", &config.camera.address),
    ] {
        require(found, address != "sim" || simulated, key, || {
            "`sim` needs a [rig] table that describes the simulated world".to_owned()
        });
    }
    plate(config, found);
    let driver = config.trigger.driver.as_str();
    require(found, trigger_model(config).is_some(), "trigger.driver", || {
        let names: Vec<_> = TRIGGER_UNITS.iter().map(|model| model.name).collect();
        format!("unknown driver {driver:?}; there are: {}", names.join(", "))
    });
    let needs_check = driver == "dg645" && config.trigger.address != "sim";
    require(found, !needs_check || config.trigger.prescaler_checked, "trigger.driver", || {
        "no source says from where the prescalers of a DG645 count inside a burst, and a spray in the wrong frame is a wrong \
         label that nothing shows: look once with an oscilloscope as docs/INSTRUMENTS.md says, then write \
         prescaler_checked = true"
            .to_owned()
    });
    camera_driver(config, found);
    let t = &config.trigger;
    positive(found, t.injection_s, "trigger.injection_s", "seconds");
    positive(found, t.injection_limit_s, "trigger.injection_limit_s", "seconds");
    positive(found, t.injection_interval_limit_s, "trigger.injection_interval_limit_s", "seconds");
    require(found, t.injection_s <= t.injection_limit_s, "trigger.injection_s", || {
        format!("{} s is longer than trigger.injection_limit_s = {} s", t.injection_s, t.injection_limit_s)
    });
    require(
        found,
        t.exposure_delay_s >= 0.0
            && t.exposure_delay_s + config.camera.integration_s + config.camera.readout_s
                <= config.campaign.frame_period_s,
        "trigger.exposure_delay_s",
        || "exposure and read-out must end before the next clock pulse (campaign.frame_period_s)".to_owned(),
    );
    let c = &config.camera;
    let sides = 1..=PIXELS_SIDE_MAX;
    require(found, sides.contains(&c.rows) && sides.contains(&c.columns), "camera.rows", || {
        format!("1 to {PIXELS_SIDE_MAX} rows and columns, found {} × {}", c.rows, c.columns)
    });
    require(found, (8..=16).contains(&c.bits), "camera.bits", || format!("8 to 16 bits, found {}", c.bits));
    require(
        found,
        u32::from(c.saturation_count) < (1u32 << c.bits.clamp(8, 16)),
        "camera.saturation_count",
        || {
            format!(
                "{} can never be reached with {} bits; the largest count is {}",
                c.saturation_count,
                c.bits,
                (1u32 << c.bits.clamp(8, 16)) - 1
            )
        },
    );
    positive(found, c.integration_s, "camera.integration_s", "seconds");
    require(found, c.readout_s >= 0.0, "camera.readout_s", || "must not be negative".to_owned());
    positive(found, c.electrons_per_count, "camera.electrons_per_count", "electrons");
    require(found, c.read_noise_counts >= 0.0, "camera.read_noise_counts", || {
        "must not be negative".to_owned()
    });
}

/// The camera's driver, address and the settings of its own.
fn camera_driver(config: &Config, found: &mut Vec<Problem>) {
    let c = &config.camera;
    require(found, ["sim", "gige"].contains(&c.driver.as_str()), "camera.driver", || {
        format!(
            "unknown driver {:?}; there are: sim (the simulated camera), gige (GenICam over GigE Vision)",
            c.driver
        )
    });
    require(found, (c.driver == "sim") == (c.address == SIMULATED), "camera.address", || {
        if c.driver == "sim" {
            format!("the simulated camera has the address \"sim\", found {:?}", c.address)
        } else {
            "a GigE camera has a network address, such as 192.168.1.20; \"sim\" belongs to the driver sim"
                .to_owned()
        }
    });
    require(found, c.gige.is_none() || c.driver == "gige", "camera.gige", || {
        "[camera.gige] belongs to driver = \"gige\"".to_owned()
    });
    if let Some(Err((key, why))) = c.gige.as_ref().map(GigeSettings::check) {
        found.push(Problem { key: format!("camera.gige.{key}"), message: why });
    }
}

/// The calibrator: what its driver would refuse.
fn plate(config: &Config, found: &mut Vec<Problem>) {
    let driver = config.plate.driver.as_str();
    let model = ditd_drivers::calibrator(driver);
    require(found, model.is_some(), "plate.driver", || {
        let names: Vec<&str> = CALIBRATORS.iter().map(|model| model.name).collect();
        format!("unknown driver {driver:?}; there are: {}", names.join(", "))
    });
    for (key, seconds) in
        [("plate.reopen_s", config.plate.reopen_s), ("trigger.reopen_s", config.trigger.reopen_s)]
    {
        require(found, (0.0..=3600.0).contains(&seconds), key, || format!("0 to 3600 s, found {seconds}"));
    }
    require(found, (258.0..=773.15).contains(&config.plate.limit_k), "plate.limit_k", || {
        format!("must lie between 258 and 773 K, found {}", config.plate.limit_k)
    });
    require(
        found,
        (0.9..=1.0).contains(&config.plate.display_emissivity),
        "plate.display_emissivity",
        || "the display's emissivity setting goes from 0.90 to 1.00".to_owned(),
    );
    // 418x manual, command table: SOUR:RATE 0.10 … 500, SOUR:STAB:LIM 0.01 … 5.
    require(found, (0.1..=500.0).contains(&config.plate.rate_k_per_min), "plate.rate_k_per_min", || {
        format!(
            "the calibrator's scan rate goes from 0.1 to 500 K/min, found {}",
            config.plate.rate_k_per_min
        )
    });
    require(found, (0.01..=5.0).contains(&config.plate.stability_k), "plate.stability_k", || {
        format!("the calibrator's stability limit goes from 0.01 to 5 K, found {}", config.plate.stability_k)
    });
    // Where the set-point's end is known before the instrument is asked.
    let highest = model.and_then(|model| model.set_point_max);
    let Some(highest_k) = highest.map(|highest| highest(config.plate.display_emissivity).0) else { return };
    let calibration = config.calibration.iter().flat_map(|calibration| &calibration.levels_k);
    for (key, level) in (config.campaign.levels_k.iter().map(|level| ("campaign.levels_k", level)))
        .chain(calibration.map(|level| ("calibration.levels_k", level)))
    {
        require(found, *level <= highest_k + 0.005, key, || {
            format!(
                "{level} K: at plate.display_emissivity = {} the instrument's set-point ends at {highest_k:.2} K",
                config.plate.display_emissivity
            )
        });
    }
}

fn optics(config: &Config, found: &mut Vec<Problem>) {
    let o = &config.optics;
    for (key, value) in [
        ("optics.gamma_near", o.gamma_near),
        ("optics.gamma_far", o.gamma_far),
        ("optics.emissivity_plate", o.emissivity_plate),
    ] {
        require(found, value > 0.0 && value <= 1.0, key, || format!("must lie in (0, 1], found {value}"));
    }
    require(found, (0.0..1.0).contains(&o.reflectance_far), "optics.reflectance_far", || {
        format!("must lie in [0, 1), found {}", o.reflectance_far)
    });
    require(found, o.gamma_far + o.reflectance_far <= 1.0 + 1e-9, "optics.reflectance_far", || {
        "transmittance and reflectance of a window add up to at most 1".to_owned()
    });
    positive(found, o.wall_temperature_k, "optics.wall_temperature_k", "kelvin");
    for (key, sigma) in [
        ("optics.sigma_gamma_near", o.sigma_gamma_near),
        ("optics.sigma_gamma_far", o.sigma_gamma_far),
        ("optics.sigma_reflectance_far", o.sigma_reflectance_far),
        ("optics.sigma_wall_temperature_k", o.sigma_wall_temperature_k),
        ("optics.sigma_emissivity_plate", o.sigma_emissivity_plate),
        ("optics.sigma_plate_uniformity_k", o.sigma_plate_uniformity_k),
        ("optics.sigma_plate_reading_k", o.sigma_plate_reading_k),
    ] {
        let right = sigma.is_none_or(|sigma| sigma.is_finite() && sigma >= 0.0);
        require(found, right, key, || "a standard deviation is not negative".to_owned());
    }
    if let Some(band) = &o.passband {
        positive(found, band.centre_um, "optics.passband.centre_um", "micrometres");
        positive(found, band.fwhm_um, "optics.passband.fwhm_um", "micrometres");
        // The relation between width and curve is a second-order one.
        require(found, band.fwhm_um <= band.centre_um, "optics.passband.fwhm_um", || {
            format!("{} um is wider than the centre's {} um", band.fwhm_um, band.centre_um)
        });
    }
    require(found, o.calibration != "measure" || config.calibration.is_some(), "optics.calibration", || {
        "\"measure\" needs a [calibration] table with its levels".to_owned()
    });
    require(
        found,
        ["default", "paper", "ols"].contains(&config.fit.estimator.as_str()),
        "fit.estimator",
        || format!("unknown estimator {:?}; there are: default, paper, ols", config.fit.estimator),
    );
    if let Some(score) = config.fit.misfire_score {
        require(found, (0.0..=0.9).contains(&score), "fit.misfire_score", || {
            format!("must lie in 0 … 0.9, found {score}")
        });
    }
    for (key, limit) in [
        ("fit.mask_emissivity_below", Limits { sigma_above_k: None, ..config.fit.limits() }),
        ("fit.mask_sigma_above_k", Limits { emissivity_below: None, ..config.fit.limits() }),
    ] {
        let problem = limit.problem();
        require(found, problem.is_none(), key, || problem.unwrap_or_default());
    }
    if let Some(calibration) = &config.calibration {
        require(found, calibration.levels_k.len() >= 4, "calibration.levels_k", || {
            "the curve has three parameters and an offset: at least four levels".to_owned()
        });
        for level in &calibration.levels_k {
            require(found, *level <= config.plate.limit_k && *level >= 258.0, "calibration.levels_k", || {
                format!("{level} K is outside 258 K … plate.limit_k = {} K", config.plate.limit_k)
            });
        }
        require(found, calibration.warm_up <= 1000, "calibration.warm_up", || {
            format!("at most 1000 discarded frames, found {}", calibration.warm_up)
        });
        if let Some([cold, hot]) = calibration.ambient_k {
            // Closer together they move the picture by less than the offset's own wandering.
            require(found, cold > 0.0 && hot - cold >= 20.0, "calibration.ambient_k", || {
                format!(
                    "two temperatures in K, the second 20 K above the first at least, found {cold} and {hot}"
                )
            });
        }
        require(found, (2..=10_000).contains(&calibration.frames), "calibration.frames", || {
            format!("between 2 and 10000 frames, found {}", calibration.frames)
        });
    }
    if let Some(target) = &config.target {
        require(found, (0.0..1.0).contains(&target.emissivity_min), "target.emissivity_min", || {
            "must lie in [0, 1)".to_owned()
        });
    }
}

/// The simulated world and its fit to the rest of the file.
fn world(config: &Config, found: &mut Vec<Problem>) {
    let Some(rig) = &config.rig else { return };
    if let Err(error) = rig.validate() {
        let (key, message) = match error {
            RigError::Config { key, why } => (format!("rig.{}", key.trim_start_matches("rig.")), why),
            other => ("rig".to_owned(), other.to_string()),
        };
        found.push(Problem { key, message });
    }
    for (table, checked) in [
        ("plate", rig.plate.check()),
        ("calibrator", rig.calibrator.check()),
        ("hart_9132", rig.hart_9132.check()),
        ("ir_301", rig.ir_301.check()),
        ("pulser", rig.pulser.check()),
        ("process", rig.process.as_ref().map_or(Ok(()), ProcessConfig::check)),
    ] {
        if let Err(message) = checked {
            let key = message.split([' ', ':']).next().unwrap_or_default();
            found.push(Problem { key: format!("rig.{table}.{key}"), message: message.clone() });
        }
    }
    let columns: Vec<&str> = rig.filter.detector.iter().chain(&rig.filter.name).map(String::as_str).collect();
    if let Err(error) = Response::shipped(&columns)
        && !columns.is_empty()
    {
        found.push(Problem { key: "rig.filter.name".to_owned(), message: error.to_string() });
    }
    if let Some(air) = &rig.filter.air
        && let Err(error) = Atmosphere::named(&air.atmosphere).and_then(|own| AirPath::new(own, air.length_m))
    {
        found.push(Problem { key: "rig.filter.air".to_owned(), message: error.to_string() });
    }
    // Files of the user's own are read when the world is built; here no file is touched.
    if let Some(spray) = &rig.spray
        && !library::is_file(&spray.fuel)
        && let Err(error) = Fuel::named(&spray.fuel)
    {
        found.push(Problem { key: "rig.spray.fuel".to_owned(), message: error.to_string() });
    }
    for (key, window) in
        rig.window.iter().flat_map(|both| [("rig.window.near", &both.near), ("rig.window.far", &both.far)])
    {
        let known = library::is_file(&window.material) || Material::named(&window.material).is_some();
        require(found, known, key, || WindowError::Unknown { name: window.material.clone() }.to_string());
    }
    let c = &config.camera;
    require(found, (rig.view.rows, rig.view.columns) == (c.rows, c.columns), "rig.view.rows", || {
        format!(
            "the simulated camera has {} × {} pixels, [camera] asks for {} × {}",
            rig.view.columns, rig.view.rows, c.columns, c.rows
        )
    });
    require(found, rig.detector.bits == c.bits, "camera.bits", || {
        format!("the simulated detector has {} bits, [camera] says {}", rig.detector.bits, c.bits)
    });
    require(
        found,
        config.calibration.as_ref().is_none_or(|c| c.reference == Reference::Fitted)
            || rig.detector.shutter_temperature_k.is_some(),
        "rig.detector",
        || {
            "the calibration needs a camera with a shutter: shutter_temperature_k is missing; or [calibration] reference = \"fitted\""
                .to_owned()
        },
    );
}
