//! The black-body plate and its controller: block, surface and display temperature as time goes on.
//!
//! A pure state that is stepped on a fixed grid, so that what it shows depends on the commands and their times, never
//! on how often it was looked at. Knows no bytes and no clock; the camera sees [`Plate::surface_k`], never the display.

mod model;
mod noise;

#[cfg(test)]
mod tests;

pub use model::{PlateDynamics, PlateFault, PlateModel};

use noise::gaussian;
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
