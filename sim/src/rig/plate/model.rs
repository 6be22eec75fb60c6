//! What a plate is and what goes wrong with it, as a configuration gives them.

use super::STEP_S;
use serde::{Deserialize, Serialize};

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
