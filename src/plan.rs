//! What will be done: a pure function of the config, printable before anything is touched.

use crate::config::{Config, Reference};
use ditd_drivers::instrument::ShotProgram;
use serde::{Deserialize, Serialize};

/// What the engine acquires.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Purpose {
    /// Spray and blank frames through the chamber.
    Map,
    /// The standard curve: frames of the bare plate and of the shutter, no injector.
    StandardCurve,
}

/// A campaign, spelled out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What it is for.
    pub purpose: Purpose,
    /// Levels in the order in which they are visited.
    pub levels: Vec<LevelPlan>,
    /// Upper limit of cycles taken again per level.
    pub retakes_max: u32,
}

/// One level of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelPlan {
    /// Plate set-point in K.
    pub set_point_k: f64,
    /// The burst that the trigger unit is given.
    pub program: ShotProgram,
    /// Whether frames with the shutter closed are taken first.
    pub shutter_reference: bool,
}

/// What a plan will cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Time spent heating and settling, in s (model of the maker's figures).
    pub soak_s: f64,
    /// Time spent in cycles, in s.
    pub cycles_s: f64,
    /// Frames kept.
    pub frames: u64,
    /// Injections.
    pub injections: u64,
    /// Bytes of raw frames.
    pub bytes: u64,
}

/// Nanoseconds from seconds, to the nearest one.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked config: 0 … 1e7 s")]
fn ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

impl Plan {
    /// The plan of a measuring campaign.
    pub fn of_map(config: &Config) -> Self {
        let c = &config.campaign;
        let period_ns = ns(c.frame_period_s);
        let frames = c.warm_up + c.blanks + 1;
        let pause_periods = ns(c.pause_s).div_ceil(period_ns);
        let program = ShotProgram {
            period_ns,
            wait_periods: 1,
            warm_up: c.warm_up,
            blanks: c.blanks,
            inject: true,
            cycle_periods: frames + u32::try_from(pause_periods).unwrap_or(u32::MAX - frames),
            cycles: c.cycles,
            camera_delay_ns: ns(config.trigger.exposure_delay_s),
            camera_width_ns: ns(config.camera.integration_s),
            injector_delay_ns: 0,
            injector_width_ns: ns(config.trigger.injection_s),
        };
        let levels = config
            .levels_in_order()
            .into_iter()
            .map(|set_point_k| LevelPlan { set_point_k, program: program.clone(), shutter_reference: false })
            .collect();
        Self { purpose: Purpose::Map, levels, retakes_max: c.retakes_max.unwrap_or(c.cycles) }
    }

    /// The plan of the standard curve; `None` without a `[calibration]` table.
    pub fn of_standard_curve(config: &Config) -> Option<Self> {
        Self::of_plate(config, |levels| levels)
    }

    /// As the standard curve, at its coldest and hottest level alone: for the flat.
    pub fn of_ends(config: &Config) -> Option<Self> {
        Self::of_plate(config, |levels| {
            let ends = [levels.first().copied(), levels.last().copied()];
            ends.into_iter().flatten().collect()
        })
    }

    /// As the standard curve, at its coldest level alone: for what does not depend on the plate.
    pub fn of_coldest(config: &Config) -> Option<Self> {
        Self::of_plate(config, |levels| levels.into_iter().take(1).collect())
    }

    /// Frames of the plate without an injector, at levels picked from those of `[calibration]`, ascending.
    fn of_plate(config: &Config, pick: impl Fn(Vec<f64>) -> Vec<f64>) -> Option<Self> {
        let calibration = config.calibration.as_ref()?;
        let period_ns = ns(config.campaign.frame_period_s);
        let warm_up = calibration.warm_up;
        let program = ShotProgram {
            period_ns,
            wait_periods: 1,
            warm_up,
            blanks: calibration.frames - 1,
            inject: false,
            cycle_periods: warm_up + calibration.frames + 1,
            cycles: 1,
            camera_delay_ns: ns(config.trigger.exposure_delay_s),
            camera_width_ns: ns(config.camera.integration_s),
            injector_delay_ns: 0,
            injector_width_ns: ns(config.trigger.injection_s),
        };
        let mut levels = calibration.levels_k.clone();
        levels.sort_by(f64::total_cmp);
        let shutter_reference = calibration.reference == Reference::Shutter;
        let levels = pick(levels)
            .into_iter()
            .map(|set_point_k| LevelPlan { set_point_k, program: program.clone(), shutter_reference })
            .collect();
        Some(Self { purpose: Purpose::StandardCurve, levels, retakes_max: 3 })
    }

    /// Time, frames and bytes.
    pub fn cost(&self, config: &Config) -> Cost {
        let mut plate_k: f64 = 296.0;
        let mut cost = Cost { soak_s: 0.0, cycles_s: 0.0, frames: 0, injections: 0, bytes: 0 };
        for level in &self.levels {
            cost.soak_s += soak_time_s(plate_k, level.set_point_k, config);
            plate_k = level.set_point_k;
            let p = &level.program;
            let shutters = if level.shutter_reference { 2u32 } else { 1 };
            cost.cycles_s += p.burst_ns() as f64 * 1e-9 * f64::from(shutters);
            cost.frames += u64::from(p.cycles) * u64::from(p.blanks + 1) * u64::from(shutters);
            cost.injections += if p.inject { u64::from(p.cycles) } else { 0 };
        }
        cost.bytes = cost.frames * (config.camera.rows * config.camera.columns * 2) as u64;
        cost
    }

    /// The plan in words, one act a line.
    pub fn describe(&self) -> String {
        let mut out = String::new();
        for (index, level) in self.levels.iter().enumerate() {
            let p = &level.program;
            out.push_str(&format!(
                "level {:2}  set {:.2} K, wait until settled, then {} cycle(s) of {} discarded + {} blank + {} each {:.3} s\n",
                index + 1,
                level.set_point_k,
                p.cycles,
                p.warm_up,
                if p.inject { p.blanks } else { p.blanks + 1 },
                if p.inject { "1 spray frame," } else { "no spray frame," },
                p.cycle_ns() as f64 * 1e-9,
            ));
        }
        out.push_str(
            "end       safe state: injector off, trigger clock off, camera off, plate to its minimum\n",
        );
        out
    }
}

/// Heating at 23 K/min and natural cooling towards 23 °C with 24.5 min (the middle of the two values that fit
/// the maker's cooling times of a 4181), then settling for half of the maker's 10 min and the hold time.
fn soak_time_s(from_k: f64, to_k: f64, config: &Config) -> f64 {
    const AMBIENT_K: f64 = 296.15;
    const COOLING_S: f64 = 24.5 * 60.0;
    let travel = if to_k >= from_k {
        (to_k - from_k) / config.plate.rate_k_per_min.min(23.0) * 60.0
    } else {
        COOLING_S * ((from_k - AMBIENT_K) / (to_k - AMBIENT_K).max(1.0)).ln().max(0.0)
    };
    travel + 300.0 + config.soak.hold_s
}
