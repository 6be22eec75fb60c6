//! The black-body plate and its controller: block, surface and display temperature as time goes on.
//!
//! A pure state that is stepped on a fixed grid, so that what it shows depends on the commands and their times, never
//! on how often it was looked at. Knows no bytes and no clock; the camera sees [`Plate::surface_k`], never the display.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Step of the integration in seconds: a fiftieth of the shortest time constant, so that the explicit steps err by
/// less than the display's last digit.
const STEP_S: f64 = 0.25;

/// The display's last digit in kelvin (Users Guide, example replies `24.091`).
const DISPLAY_DIGIT_K: f64 = 0.001;

/// Time within the limit after which the unit calls itself stable (Users Guide, 5.2.1.1.2).
const STABLE_AFTER_S: f64 = 60.0;

/// Length of one bucket of the present stability; the last two and the running one are looked at.
const STABILITY_BUCKET_S: f64 = 30.0;

/// The plate has arrived, and its ripple begins, when the display is so near to the set-point.
const ARRIVAL_K: f64 = 1.0;

/// Farther from the set-point than this the ripple fades: it is made by the controller at its work.
const RIPPLE_WITHIN_K: f64 = 5.0;

/// 0 °C.
const ZERO_CELSIUS_K: f64 = 273.15;

/// Maker's stability against temperature (Technical Guide, specifications of the 4181): °C and ± kelvin.
const STABILITY_4181: [(f64, f64); 3] = [(35.0, 0.05), (200.0, 0.20), (500.0, 0.40)];

/// A plate and its surroundings, as a configuration gives them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlateModel {
    /// Temperature of the room in kelvin; the plate starts with it.
    pub ambient_k: f64,
    /// Display minus surface at 0 °C, in kelvin: the plate's calibration error. The maker's accuracy is 0.35 K at
    /// 35 °C and 1.6 K at 500 °C.
    pub display_error_k: f64,
    /// Growth of that error per kelvin.
    pub display_error_per_k: f64,
    /// Noise of one display reading, standard deviation in kelvin.
    pub display_noise_k: f64,
    /// How many seconds of the plate pass in one of the rig: above 1 for rigs that run in real time and cannot wait for
    /// a real plate. Times of its faults are the plate's.
    #[serde(default = "PlateModel::real_time")]
    pub time_factor: f64,
    /// How block, surface and controller move; a 4181 when absent.
    #[serde(default = "PlateDynamics::fluke_4181")]
    pub dynamics: PlateDynamics,
    /// What goes wrong; nothing when absent.
    #[serde(default)]
    pub faults: Vec<PlateFault>,
}

/// How block, surface and controller move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlateDynamics {
    /// Fastest heating without losses, in kelvin per second.
    pub heater_k_per_s: f64,
    /// Fastest active cooling, in kelvin per second; 0 for a plate that only heats.
    pub cooler_k_per_s: f64,
    /// The controller's own ceiling of the rate, in kelvin per second; the scan rate can only lower it.
    pub rate_max_k_per_s: f64,
    /// Time constant of natural cooling near room temperature, in seconds.
    pub cooling_time_s: f64,
    /// Relative growth of the loss per kelvin above the room (convection and radiation).
    pub cooling_growth_per_k: f64,
    /// Lag of the heater's heat, in seconds.
    pub heater_lag_s: f64,
    /// Lag of the surface behind the block, in seconds.
    pub surface_lag_s: f64,
    /// Part of block minus room by which the surface is cooler than the block.
    pub surface_deficit: f64,
    /// The controller's proportional band, in kelvin.
    pub band_k: f64,
    /// The controller's integral time, in seconds.
    pub integral_s: f64,
    /// Time constant with which its reference comes to the set-point, in seconds.
    pub approach_s: f64,
    /// Amplitude of the ripple on arrival, in kelvin.
    pub arrival_ripple_k: f64,
    /// Time constant with which that ripple decays, in seconds.
    pub ripple_decay_s: f64,
    /// Amplitude of the lasting ripple as a part of the maker's stability (0.05 K at 35 °C … 0.40 K at 500 °C).
    pub ripple_part: f64,
    /// Period of the ripple, in seconds.
    pub ripple_period_s: f64,
}

impl PlateDynamics {
    /// A 4181, fitted to the maker's figures: 20 min from 35 to 500 °C, 40 min from 500 to 100 °C, 60 min on to 35 °C
    /// (a loss proportional to x + 0.00324 x², x above the room, meets both cooling times), settled 10 min after
    /// arrival. Band, lags and ripple are chosen so that overshoot and settling look like the maker's 10 min.
    pub fn fluke_4181() -> Self {
        Self {
            heater_k_per_s: 0.95,
            cooler_k_per_s: 0.0,
            rate_max_k_per_s: 28.0 / 60.0,
            cooling_time_s: 2150.0,
            cooling_growth_per_k: 0.003_24,
            heater_lag_s: 12.0,
            surface_lag_s: 20.0,
            surface_deficit: 0.01,
            band_k: 25.0,
            integral_s: 150.0,
            approach_s: 65.0,
            arrival_ripple_k: 0.4,
            ripple_decay_s: 150.0,
            ripple_part: 0.4,
            ripple_period_s: 90.0,
        }
    }
}

/// What goes wrong with plate or controller. Times are seconds of the rig's clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum PlateFault {
    /// Swings about the set-point for ever.
    NeverSettles {
        /// Since when.
        from_s: f64,
        /// Amplitude in kelvin.
        amplitude_k: f64,
        /// Period in seconds.
        period_s: f64,
    },
    /// The display stands still; block and surface go on.
    FrozenReading {
        /// Since when.
        from_s: f64,
    },
    /// The display shows no number.
    NanReading {
        /// Since when.
        from_s: f64,
        /// Until when.
        until_s: f64,
    },
    /// A cutout trips once: no heating and no cooling until it is cleared.
    CutoutTrips {
        /// When.
        at_s: f64,
    },
    /// The controller is badly tuned: on every arrival the plate swings beyond the set-point by so much, and comes to rest.
    Overshoots {
        /// Amplitude of the first swing, in kelvin.
        by_k: f64,
    },
    /// The heater has lost part of its power.
    SlowHeating {
        /// Since when.
        from_s: f64,
        /// What is left of it, 0 … 1.
        factor: f64,
    },
}

/// What the controller has been told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlateSettings {
    /// Set-point of the display, in kelvin.
    pub set_point_k: f64,
    /// Whether it heats (and cools).
    pub output_on: bool,
    /// Scan rate in kelvin per minute.
    pub rate_k_per_min: f64,
    /// Stability limit in kelvin.
    pub stability_limit_k: f64,
    /// A block hotter than this, in kelvin, trips the cutout.
    pub cutout_k: f64,
}

/// The plate at one moment. Can be written down and taken up again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plate {
    /// What the controller has been told; takes effect from the next step on.
    pub settings: PlateSettings,
    model: PlateModel,
    seed: u64,
    steps: u64,
    offset_s: f64,
    now_s: f64,
    block_k: f64,
    plain_surface_k: f64,
    surface_k: f64,
    surface_rate: f64,
    reference_k: f64,
    heat: f64,
    integral: f64,
    approaching_k: Option<f64>,
    ripple_k: f64,
    ripple_phase: f64,
    within_s: f64,
    deviations_k: [f64; 3],
    tripped: bool,
    trips_played: u32,
    frozen_k: Option<f64>,
}

impl Plate {
    /// A plate at room temperature, output off, at time 0. `seed` keys the noise of its display.
    ///
    /// # Panics
    /// When the model fails its check.
    pub fn new(model: PlateModel, seed: u64) -> Self {
        assert_eq!(model.check(), Ok(()), "the model was checked where it was read");
        let ambient_k = model.ambient_k;
        Self {
            // At delivery, command table: 25 °C, 100 K/min, 0.4 K, soft cutout 520 °C.
            settings: PlateSettings {
                set_point_k: ZERO_CELSIUS_K + 25.0,
                output_on: false,
                rate_k_per_min: 100.0,
                stability_limit_k: 0.4,
                cutout_k: ZERO_CELSIUS_K + 520.0,
            },
            model,
            seed,
            steps: 0,
            offset_s: 0.0,
            now_s: 0.0,
            block_k: ambient_k,
            plain_surface_k: ambient_k,
            surface_k: ambient_k,
            surface_rate: 0.0,
            reference_k: ambient_k,
            heat: 0.0,
            integral: 0.0,
            approaching_k: None,
            ripple_k: 0.0,
            ripple_phase: 0.0,
            within_s: 0.0,
            deviations_k: [0.0; 3],
            tripped: false,
            trips_played: 0,
            frozen_k: None,
        }
    }

    /// Goes on to a moment of the rig's clock; an earlier one changes nothing.
    pub fn advance(&mut self, now_s: f64) {
        self.now_s = self.now_s.max(now_s * self.model.time_factor + self.offset_s);
        while self.next_step_s() <= self.now_s {
            self.step();
        }
    }

    /// Declares that this state is what the plate is at `now_s` of a new clock, for a run that is taken up again.
    pub fn rebase(&mut self, now_s: f64) {
        self.offset_s = self.now_s - now_s * self.model.time_factor;
    }

    /// True temperature of the surface, in kelvin: what a camera sees.
    pub fn surface_k(&self) -> f64 {
        self.surface_k + self.surface_rate * (self.now_s - self.grid_s())
    }

    /// Temperature of the block's own sensor, in kelvin.
    pub fn block_k(&self) -> f64 {
        quantised(self.block_k)
    }

    /// What the display shows, in kelvin; NaN when it shows no number.
    pub fn display_k(&self) -> f64 {
        let shows_nan = self.model.faults.iter().any(|fault| {
            matches!(fault, PlateFault::NanReading { from_s, until_s } if (*from_s..*until_s).contains(&self.now_s))
        });
        if shows_nan {
            return f64::NAN;
        }
        self.frozen_k.unwrap_or_else(|| {
            let noise_k = self.model.display_noise_k * gaussian(self.seed, self.steps);
            quantised(self.displayed(self.surface_k()) + noise_k)
        })
    }

    /// Heater duty in percent.
    pub fn duty_percent(&self) -> f64 {
        100.0 * self.heat
    }

    /// True when the display has been within the stability limit for a minute.
    pub fn is_stable(&self) -> bool {
        self.settings.output_on && self.within_s >= STABLE_AFTER_S
    }

    /// Largest distance of the display from the set-point in the last 60 to 90 s, in kelvin.
    pub fn stability_k(&self) -> f64 {
        self.deviations_k.iter().copied().fold(0.0, f64::max)
    }

    /// True when a cutout has tripped.
    pub fn is_tripped(&self) -> bool {
        self.tripped
    }

    /// Clears the cutout; it trips again at once if the block is still too hot.
    pub fn clear_cutout(&mut self) {
        self.tripped = false;
    }

    fn grid_s(&self) -> f64 {
        step_time(self.steps)
    }

    fn next_step_s(&self) -> f64 {
        step_time(self.steps + 1)
    }

    fn displayed(&self, surface_k: f64) -> f64 {
        surface_k + self.model.display_error_k + self.model.display_error_per_k * (surface_k - ZERO_CELSIUS_K)
    }

    fn step(&mut self) {
        self.steps += 1;
        self.play_faults();
        self.control();
        self.conduct();
        self.ripple();
        self.judge();
    }

    fn play_faults(&mut self) {
        let now_s = self.grid_s();
        let mut trips_due = 0;
        for fault in &self.model.faults {
            match fault {
                PlateFault::CutoutTrips { at_s } if *at_s <= now_s => trips_due += 1,
                PlateFault::FrozenReading { from_s } if *from_s <= now_s && self.frozen_k.is_none() => {
                    self.frozen_k = Some(quantised(self.displayed(self.surface_k)));
                }
                _ => {}
            }
        }
        if trips_due > self.trips_played || self.block_k > self.settings.cutout_k {
            self.tripped = true;
        }
        self.trips_played = trips_due;
    }

    /// The controller follows a reference that runs to the set-point at a limited rate and slows down before it.
    fn control(&mut self) {
        let dynamics = &self.model.dynamics;
        let set_point_k = self.settings.set_point_k;
        let display_k = self.displayed(self.surface_k);
        if !self.settings.output_on || self.tripped {
            self.reference_k = display_k;
            self.integral = 0.0;
            self.heat -= self.heat * STEP_S / dynamics.heater_lag_s;
            self.approaching_k = None;
            return;
        }
        let rate_max = dynamics.rate_max_k_per_s.min(self.settings.rate_k_per_min / 60.0);
        let rate = ((set_point_k - self.reference_k) / dynamics.approach_s).clamp(-rate_max, rate_max);
        // The reference never runs far ahead of what the plate can do.
        let lead_k = 1.6 * dynamics.band_k;
        self.reference_k = (self.reference_k + rate * STEP_S).clamp(display_k - lead_k, display_k + lead_k);
        let error_k = self.reference_k - display_k;
        let forward = (self.loss(self.reference_k) + rate.max(0.0)) / dynamics.heater_k_per_s;
        let wanted = error_k / dynamics.band_k + self.integral + forward;
        let least = -dynamics.cooler_k_per_s / dynamics.heater_k_per_s;
        let duty = wanted.clamp(least, 1.0);
        // The integral rests while the output is at its end.
        if (least..=1.0).contains(&wanted) {
            self.integral += error_k / dynamics.band_k / dynamics.integral_s * STEP_S;
        }
        let left = self.heating_left();
        let power = if duty > 0.0 { duty * left } else { duty };
        self.heat += (power - self.heat) * STEP_S / dynamics.heater_lag_s;
    }

    /// Block and surface.
    fn conduct(&mut self) {
        let loss = self.loss(self.block_k);
        let dynamics = &self.model.dynamics;
        self.block_k += STEP_S * (dynamics.heater_k_per_s * self.heat - loss);
        let rest_k = self.block_k - dynamics.surface_deficit * (self.block_k - self.model.ambient_k);
        self.plain_surface_k += STEP_S * (rest_k - self.plain_surface_k) / dynamics.surface_lag_s;
    }

    /// The controller's hunting: large on arrival, then decaying to a part of the maker's stability.
    fn ripple(&mut self) {
        let dynamics = &self.model.dynamics;
        let set_point_k = self.settings.set_point_k;
        let off_k = (self.displayed(self.plain_surface_k) - set_point_k).abs();
        let works = self.settings.output_on && !self.tripped;
        // A new set-point is a new approach.
        let is_new = works && self.approaching_k.is_none_or(|k| (k - set_point_k).abs() > DISPLAY_DIGIT_K);
        if is_new && off_k < ARRIVAL_K {
            self.approaching_k = Some(set_point_k);
            // From its zero, so that the surface does not jump.
            self.ripple_phase = 0.0;
            self.ripple_k = self.overshoot_k().max(dynamics.arrival_ripple_k);
        }
        let lasting_k = if works && off_k < RIPPLE_WITHIN_K {
            dynamics.ripple_part * stability_spec_k(set_point_k)
        } else {
            0.0
        };
        self.ripple_k += (lasting_k - self.ripple_k) * STEP_S / dynamics.ripple_decay_s;
        self.ripple_phase = (self.ripple_phase + TAU * STEP_S / dynamics.ripple_period_s) % TAU;
        let surface_k = self.plain_surface_k + self.ripple_k * libm::sin(self.ripple_phase) + self.swing_k();
        self.surface_rate = (surface_k - self.surface_k) / STEP_S;
        self.surface_k = surface_k;
    }

    fn overshoot_k(&self) -> f64 {
        let faults = self.model.faults.iter();
        faults.fold(0.0, |most: f64, fault| match fault {
            PlateFault::Overshoots { by_k } => most.max(*by_k),
            _ => most,
        })
    }

    fn swing_k(&self) -> f64 {
        let now_s = self.grid_s();
        self.model
            .faults
            .iter()
            .map(|fault| match fault {
                PlateFault::NeverSettles { from_s, amplitude_k, period_s } if *from_s <= now_s => {
                    amplitude_k * libm::sin(TAU * (now_s - from_s) / period_s)
                }
                _ => 0.0,
            })
            .sum()
    }

    /// The unit's own test of stability.
    fn judge(&mut self) {
        let off_k = (self.displayed(self.surface_k) - self.settings.set_point_k).abs();
        self.within_s = if off_k <= self.settings.stability_limit_k { self.within_s + STEP_S } else { 0.0 };
        let bucket = step_time(self.steps) / STABILITY_BUCKET_S;
        if bucket.fract() < STEP_S / STABILITY_BUCKET_S {
            self.deviations_k.rotate_left(1);
            self.deviations_k[2] = 0.0;
        }
        self.deviations_k[2] = self.deviations_k[2].max(off_k);
    }

    /// Loss to the room at a temperature of the block, in kelvin per second.
    fn loss(&self, at_k: f64) -> f64 {
        let dynamics = &self.model.dynamics;
        let above_k = at_k - self.model.ambient_k;
        above_k * (1.0 + dynamics.cooling_growth_per_k * above_k.max(0.0)) / dynamics.cooling_time_s
    }

    fn heating_left(&self) -> f64 {
        let now_s = self.grid_s();
        self.model
            .faults
            .iter()
            .map(|fault| match fault {
                PlateFault::SlowHeating { from_s, factor } if *from_s <= now_s => *factor,
                _ => 1.0,
            })
            .product()
    }
}

impl PlateModel {
    fn real_time() -> f64 {
        1.0
    }

    /// Whether the plate can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        let d = &self.dynamics;
        let no_less_than = |least: f64, values: &[(&str, f64)]| {
            values.iter().try_for_each(|(name, value)| {
                if *value >= least && value.is_finite() {
                    Ok(())
                } else {
                    Err(format!("{name} = {value}: expected a number from {least} on"))
                }
            })
        };
        // Below four steps the explicit integration would swing by itself.
        let lag_s = 4.0 * STEP_S;
        no_less_than(
            lag_s,
            &[
                ("cooling_time_s", d.cooling_time_s),
                ("heater_lag_s", d.heater_lag_s),
                ("surface_lag_s", d.surface_lag_s),
                ("integral_s", d.integral_s),
                ("approach_s", d.approach_s),
                ("ripple_decay_s", d.ripple_decay_s),
                ("ripple_period_s", d.ripple_period_s),
            ],
        )?;
        no_less_than(
            1e-3,
            &[
                ("ambient_k", self.ambient_k),
                ("time_factor", self.time_factor),
                ("heater_k_per_s", d.heater_k_per_s),
                ("rate_max_k_per_s", d.rate_max_k_per_s),
                ("band_k", d.band_k),
            ],
        )?;
        no_less_than(
            0.0,
            &[
                ("display_noise_k", self.display_noise_k),
                ("cooler_k_per_s", d.cooler_k_per_s),
                ("cooling_growth_per_k", d.cooling_growth_per_k),
                ("surface_deficit", d.surface_deficit),
                ("arrival_ripple_k", d.arrival_ripple_k),
                ("ripple_part", d.ripple_part),
            ],
        )?;
        no_less_than(
            f64::MIN,
            &[("display_error_k", self.display_error_k), ("display_error_per_k", self.display_error_per_k)],
        )?;
        self.faults.iter().try_for_each(|fault| match fault {
            PlateFault::NeverSettles { from_s, amplitude_k, period_s } => {
                no_less_than(0.0, &[("from_s", *from_s), ("amplitude_k", *amplitude_k)])?;
                no_less_than(lag_s, &[("period_s", *period_s)])
            }
            PlateFault::Overshoots { by_k } => no_less_than(0.0, &[("by_k", *by_k)]),
            PlateFault::FrozenReading { from_s } => no_less_than(0.0, &[("from_s", *from_s)]),
            PlateFault::NanReading { from_s, until_s } => {
                no_less_than(0.0, &[("from_s", *from_s), ("until_s", *until_s)])
            }
            PlateFault::CutoutTrips { at_s } => no_less_than(0.0, &[("at_s", *at_s)]),
            PlateFault::SlowHeating { from_s, factor } => {
                no_less_than(0.0, &[("from_s", *from_s), ("factor", *factor)])
            }
        })
    }

    /// A 4181 without calibration error or faults, in a room of this temperature. The display's noise of 5 mK is
    /// our choice: the maker gives none.
    pub fn fluke_4181(ambient_k: f64) -> Self {
        Self {
            ambient_k,
            display_error_k: 0.0,
            display_error_per_k: 0.0,
            display_noise_k: 0.005,
            time_factor: Self::real_time(),
            dynamics: PlateDynamics::fluke_4181(),
            faults: Vec::new(),
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "2^53 steps are 71 million years")]
fn step_time(steps: u64) -> f64 {
    steps as f64 * STEP_S
}

fn quantised(kelvin: f64) -> f64 {
    ((kelvin - ZERO_CELSIUS_K) / DISPLAY_DIGIT_K).round() * DISPLAY_DIGIT_K + ZERO_CELSIUS_K
}

/// Maker's stability at a temperature, linear between the table's points and constant beyond.
fn stability_spec_k(at_k: f64) -> f64 {
    let celsius = at_k - ZERO_CELSIUS_K;
    let [first, .., last] = STABILITY_4181;
    if celsius <= first.0 {
        return first.1;
    }
    STABILITY_4181.windows(2).find(|pair| celsius <= pair[1].0).map_or(last.1, |pair| {
        pair[0].1 + (pair[1].1 - pair[0].1) * (celsius - pair[0].0) / (pair[1].0 - pair[0].0)
    })
}

/// A standard normal number keyed by (seed, count): Box and Muller over two SplitMix64 outputs.
fn gaussian(seed: u64, count: u64) -> f64 {
    let key = mixed(seed ^ mixed(count));
    let radius = libm::sqrt(-2.0 * libm::log(1.0 - unit(key)));
    radius * libm::cos(TAU * unit(mixed(key)))
}

/// SplitMix64's output function (Steele, Lea and Flood 2014) after its increment.
fn mixed(key: u64) -> u64 {
    let mut z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The upper 53 bits as a number in [0, 1).
#[expect(clippy::cast_precision_loss, reason = "53 bits fit exactly")]
fn unit(key: u64) -> f64 {
    (key >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM_K: f64 = 296.15;

    fn quiet() -> PlateModel {
        PlateModel { display_noise_k: 0.0, ..PlateModel::fluke_4181(ROOM_K) }
    }

    fn heated(model: PlateModel, set_point_k: f64) -> Plate {
        let mut plate = Plate::new(model, 1);
        plate.settings.set_point_k = set_point_k;
        plate.settings.output_on = true;
        plate
    }

    /// Seconds until the surface first passes `target_k`, in steps of one second.
    fn time_to(plate: &mut Plate, target_k: f64, limit_s: u32) -> Option<f64> {
        let start_s = plate.now_s;
        let rises = plate.surface_k() < target_k;
        (1..limit_s).map(f64::from).find(|s| {
            plate.advance(start_s + s);
            (plate.surface_k() >= target_k) == rises
        })
    }

    /// Largest distance of the surface from a temperature within a time.
    fn largest_off(plate: &mut Plate, from_k: f64, duration_s: u32) -> f64 {
        let start_s = plate.now_s;
        (1..duration_s).map(f64::from).fold(0.0, |largest: f64, s| {
            plate.advance(start_s + s);
            largest.max((plate.surface_k() - from_k).abs())
        })
    }

    /// The maker: 20 min from 35 to 500 °C; 40 min from 500 to 100 °C, 100 min from 500 to 35 °C (within 15 %).
    #[test]
    fn heating_and_cooling_take_the_makers_times() {
        let mut plate = heated(quiet(), 308.15);
        plate.advance(3600.0);
        plate.settings.set_point_k = 773.15;
        let heating_min = time_to(&mut plate, 772.65, 7200).unwrap() / 60.0;
        assert!((17.0..23.0).contains(&heating_min), "{heating_min} min");
        plate.advance(plate.now_s + 1800.0);
        plate.settings.set_point_k = 298.15;
        let first_min = time_to(&mut plate, 373.15, 20_000).unwrap() / 60.0;
        let second_min = time_to(&mut plate, 308.15, 20_000).unwrap() / 60.0;
        assert!((34.0..46.0).contains(&first_min), "{first_min} min");
        assert!((85.0..115.0).contains(&(first_min + second_min)), "{} min", first_min + second_min);
    }

    /// The levels of the paper's Figure 5: each overshoots, has settled ten minutes after arrival, and then stays
    /// within the maker's stability.
    #[test]
    fn levels_overshoot_settle_and_stay_within_the_makers_stability() {
        let mut plate = heated(quiet(), 300.0);
        plate.advance(3600.0);
        for level_k in [373.0, 403.0, 433.0, 463.0, 498.0, 533.0] {
            plate.settings.set_point_k = level_k;
            let arrival_s = time_to(&mut plate, level_k - 0.5, 3600).unwrap();
            assert!((30.0..600.0).contains(&arrival_s), "{level_k}: {arrival_s} s");
            let start_s = plate.now_s;
            let peak_k = (1..600).map(f64::from).fold(0.0, |peak: f64, s| {
                plate.advance(start_s + s);
                peak.max(plate.surface_k())
            });
            let overshoot_k = peak_k - level_k;
            assert!(overshoot_k > 0.0 && overshoot_k < 5.0, "{level_k}: overshoot {overshoot_k}");
            let spec_k = stability_spec_k(level_k);
            let off_k = largest_off(&mut plate, level_k, 900);
            assert!(off_k < spec_k, "{level_k}: {off_k} K, the maker says {spec_k} K");
            assert!(off_k > 0.1 * spec_k, "{level_k}: {off_k} K, a real plate is never at rest");
            assert!(plate.is_stable());
            assert!(plate.stability_k() < spec_k);
        }
    }

    #[test]
    fn what_it_shows_does_not_depend_on_how_often_it_is_looked_at() {
        let mut seldom = heated(PlateModel::fluke_4181(ROOM_K), 400.0);
        let mut often = seldom.clone();
        for tick in 0..20_000 {
            often.advance(f64::from(tick) * 0.0617);
        }
        let end_s = 1234.1;
        often.advance(end_s);
        seldom.advance(end_s);
        assert_eq!(seldom, often);
        assert_eq!(seldom.display_k().to_bits(), often.display_k().to_bits());
        seldom.advance(3.0);
        assert_eq!(seldom, often);
    }

    #[test]
    fn a_state_written_down_goes_on_to_the_same_bits() {
        let mut plate = heated(PlateModel::fluke_4181(ROOM_K), 400.0);
        plate.advance(777.7);
        let text = serde_json::to_string(&plate).unwrap();
        let mut again: Plate = serde_json::from_str(&text).unwrap();
        assert_eq!(again, plate);
        again.rebase(0.0);
        again.advance(1000.0);
        plate.advance(1777.7);
        assert_eq!(again.surface_k().to_bits(), plate.surface_k().to_bits());
        assert_eq!(again.display_k().to_bits(), plate.display_k().to_bits());
    }

    #[test]
    fn the_camera_does_not_see_the_displays_error() {
        let model = PlateModel { display_error_k: 0.5, display_error_per_k: 0.001, ..quiet() };
        let mut plate = heated(model, 423.15);
        plate.advance(5000.0);
        assert!((plate.display_k() - 423.15).abs() < 0.3);
        assert!((plate.display_k() - plate.surface_k() - 0.65).abs() < 0.01);
    }

    #[test]
    fn the_displays_noise_has_the_spread_it_was_given() {
        let spread = |noise_k: f64| {
            let readings: Vec<f64> = (0..4000).map(|n| noise_k * gaussian(7, n)).collect();
            let mean = readings.iter().sum::<f64>() / 4000.0;
            (mean, (readings.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 3999.0).sqrt())
        };
        let (mean, sigma) = spread(1.0);
        // Five standard errors of mean and spread at 4000 numbers.
        assert!(mean.abs() < 5.0 / 63.2 && (sigma - 1.0).abs() < 5.0 / 89.4, "{mean} {sigma}");
    }

    #[test]
    fn every_fault_shows() {
        let with = |fault| PlateModel { faults: vec![fault], ..quiet() };
        let mut swinging =
            heated(with(PlateFault::NeverSettles { from_s: 0.0, amplitude_k: 2.0, period_s: 120.0 }), 400.0);
        swinging.advance(5000.0);
        assert!(largest_off(&mut swinging, 400.0, 300) > 1.5);
        assert!(!swinging.is_stable());

        let mut frozen = heated(with(PlateFault::FrozenReading { from_s: 100.0 }), 400.0);
        frozen.advance(100.0);
        let shown_k = frozen.display_k();
        frozen.advance(2000.0);
        assert_eq!(frozen.display_k().to_bits(), shown_k.to_bits());
        assert!(frozen.surface_k() > shown_k + 50.0);

        let mut blank = heated(with(PlateFault::NanReading { from_s: 10.0, until_s: 20.0 }), 400.0);
        blank.advance(15.0);
        assert!(blank.display_k().is_nan());
        blank.advance(20.0);
        assert!(blank.display_k().is_finite());

        let mut tripped = heated(with(PlateFault::CutoutTrips { at_s: 600.0 }), 400.0);
        tripped.advance(599.0);
        assert!(!tripped.is_tripped());
        tripped.advance(5000.0);
        assert!(tripped.is_tripped() && tripped.surface_k() < 330.0);
        tripped.clear_cutout();
        tripped.advance(7000.0);
        assert!(!tripped.is_tripped() && tripped.surface_k() > 395.0);

        let mut swinging = heated(with(PlateFault::Overshoots { by_k: 8.0 }), 400.0);
        let arrival_s = time_to(&mut swinging, 400.0, 3600).unwrap();
        assert!(largest_off(&mut swinging, 400.0, 200) > 5.0);
        swinging.advance(arrival_s + 1200.0);
        assert!(largest_off(&mut swinging, 400.0, 200) < 0.3);

        let mut slow = heated(with(PlateFault::SlowHeating { from_s: 0.0, factor: 0.2 }), 400.0);
        let mut sound = heated(quiet(), 400.0);
        let slow_s = time_to(&mut slow, 390.0, 20_000).unwrap();
        assert!(slow_s > 1.5 * time_to(&mut sound, 390.0, 20_000).unwrap(), "{slow_s}");
    }

    #[test]
    fn an_overheated_block_trips_the_cutout() {
        let mut plate = heated(quiet(), 400.0);
        plate.settings.cutout_k = 350.0;
        plate.advance(2000.0);
        assert!(plate.is_tripped());
        plate.settings.output_on = true;
        plate.advance(9000.0);
        assert!(plate.surface_k() < 330.0);
    }

    #[test]
    fn a_model_is_read_from_a_file_and_unknown_keys_are_refused() {
        let text = "ambient_k = 296.0\ndisplay_error_k = 0.3\ndisplay_error_per_k = 0.002\ndisplay_noise_k = 0.005\n";
        let fault = "[[faults]]\nkind = \"slow-heating\"\nfrom_s = 10.0\nfactor = 0.5\n";
        let model: PlateModel = toml::from_str(&format!("{text}{fault}")).unwrap();
        assert_eq!(model.dynamics, PlateDynamics::fluke_4181());
        assert_eq!(model.faults, [PlateFault::SlowHeating { from_s: 10.0, factor: 0.5 }]);
        assert!(toml::from_str::<PlateModel>(&format!("{text}colour = 1\n")).is_err());
        assert!(toml::from_str::<PlateModel>(&format!("{text}{fault}until_s = 3.0\n")).is_err());
        assert!(toml::from_str::<PlateModel>("ambient_k = 296.0\n").is_err());
        assert_eq!(model.check(), Ok(()));
        let mut impossible = model.clone();
        impossible.dynamics.surface_lag_s = 0.0;
        assert!(impossible.check().unwrap_err().starts_with("surface_lag_s"));
        let impossible = PlateModel { display_error_k: f64::NAN, ..model };
        assert!(impossible.check().unwrap_err().starts_with("display_error_k"));
    }
}
