//! Process values of the simulated rig: wall, gas, fuel and window temperatures, chamber and rail pressure.
//!
//! The values are those of the world that the camera sees, with noise and faults. They are given in process, as a monitor
//! of its own, or by an instrument that answers lines of text.

use super::config::RigConfig;
use super::line::{Line, LineFault, Unsent, check_seconds};
use super::noise::{Purpose, Stream};
use async_trait::async_trait;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Monitor, MonitorReading};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

/// Time from a query to its reply.
const REPLY_DELAY: Duration = Duration::from_millis(10);

/// What the simulated rig's sensors know besides chamber and windows; nothing more when absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessConfig {
    /// Temperature of the fuel in the rail, in kelvin.
    pub fuel_temperature_k: Option<f64>,
    /// Pressure of the fuel in the rail, in pascal.
    pub rail_pressure_pa: Option<f64>,
    /// Noise of one reading relative to the value, standard deviation.
    #[serde(default)]
    pub noise: f64,
    /// What goes wrong with sensors.
    #[serde(default)]
    pub faults: Vec<ProcessFault>,
    /// What goes wrong on the line, where they are asked over one.
    #[serde(default)]
    pub line_faults: Vec<LineFault>,
}

/// What goes wrong with one sensor. Times are seconds of the rig's clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ProcessFault {
    /// The value changes to another.
    Step {
        /// Which value.
        value: String,
        /// When.
        at_s: f64,
        /// What it is from then on.
        to: f64,
    },
    /// The sensor shows no number.
    NotANumber {
        /// Which value.
        value: String,
        /// Since when.
        from_s: f64,
    },
}

impl ProcessConfig {
    /// Whether it can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        for (name, value) in
            [("fuel_temperature_k", self.fuel_temperature_k), ("rail_pressure_pa", self.rail_pressure_pa)]
        {
            if value.is_some_and(|value| !(value > 0.0 && value.is_finite())) {
                return Err(format!("{name}: must be a positive number"));
            }
        }
        if !(0.0..1.0).contains(&self.noise) {
            return Err(format!("noise = {}: expected 0 to below 1", self.noise));
        }
        self.faults.iter().try_for_each(|fault| match fault {
            ProcessFault::Step { at_s, .. } => check_seconds("faults", *at_s),
            ProcessFault::NotANumber { from_s, .. } => check_seconds("faults", *from_s),
        })?;
        self.line_faults.iter().try_for_each(LineFault::check)
    }
}

/// The sensors of a simulated rig.
#[derive(Debug, Clone)]
pub struct Sensors {
    values: BTreeMap<String, f64>,
    process: ProcessConfig,
    seed: u64,
    start: Instant,
    readings: u64,
}

/// The names that a rig's sensors can have.
pub const NAMES: [&str; 7] = [
    "chamber_pressure_pa",
    "fuel_temperature_k",
    "gas_temperature_k",
    "rail_pressure_pa",
    "wall_temperature_k",
    "window_far_temperature_k",
    "window_near_temperature_k",
];

/// The values that the sensors of a rig show, by name.
pub fn values_of(rig: &RigConfig) -> BTreeMap<String, f64> {
    let chamber = rig.chamber.as_ref();
    let window = rig.window.as_ref();
    let process = rig.process.as_ref();
    let all = [
        chamber.map(|c| c.pressure_pa),
        process.and_then(|p| p.fuel_temperature_k),
        chamber.map(|c| c.gas_temperature_k),
        process.and_then(|p| p.rail_pressure_pa),
        chamber.map(|c| c.wall_temperature_k),
        window.map(|w| w.far.temperature_k),
        window.map(|w| w.near.temperature_k),
    ];
    NAMES.iter().zip(all).filter_map(|(name, value)| Some(((*name).to_owned(), value?))).collect()
}

impl Sensors {
    /// The sensors of a rig; `start` is the zero of its clock, `seed` keys the noise.
    pub fn new(rig: &RigConfig, seed: u64, start: Instant) -> Self {
        let process = rig.process.clone().unwrap_or_default();
        Self { values: values_of(rig), process, seed, start, readings: 0 }
    }

    /// What a sensor shows just now; `None` when there is no such sensor, NaN when it shows no number.
    pub fn show(&mut self, name: &str) -> Option<f64> {
        let mut value = *self.values.get(name)?;
        let now_s = self.start.elapsed().as_secs_f64();
        for fault in &self.process.faults {
            match fault {
                ProcessFault::Step { value: which, at_s, to } if which == name && *at_s <= now_s => {
                    value = *to
                }
                ProcessFault::NotANumber { value: which, from_s } if which == name && *from_s <= now_s => {
                    value = f64::NAN;
                }
                _ => {}
            }
        }
        self.readings += 1;
        Some(
            value
                * (1.0
                    + self.process.noise
                        * Stream::new(self.seed, Purpose::Sensors, self.readings).gaussian(0)),
        )
    }
}

/// The sensors as a monitor, without any line.
#[derive(Debug)]
pub struct SensorMonitor {
    sensors: Sensors,
    names: Vec<String>,
}

impl SensorMonitor {
    /// A monitor of the values of these names.
    pub fn new(sensors: Sensors, names: Vec<String>) -> Self {
        Self { sensors, names }
    }
}

#[async_trait]
impl Monitor for SensorMonitor {
    async fn read(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        let mut readings = Vec::with_capacity(self.names.len());
        for name in &self.names {
            let value = self.sensors.show(name).filter(|value| value.is_finite());
            let value = value.ok_or_else(|| DriverError::Garbled {
                who: "monitor at sim".to_owned(),
                doing: format!("reading {name}"),
                answer: "NaN".to_owned(),
                why: "the sensor shows no number".to_owned(),
                hint: "Check the sensor and its cable.".to_owned(),
            })?;
            readings.push(MonitorReading { name: name.clone(), value });
        }
        Ok(readings)
    }
}

/// Answers lines of text on a stream until the other side has gone: `*IDN?`, `ALL?` (every value in the order of its
/// name) and `NAME?`; anything else by `ERR`.
pub async fn serve(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, mut sensors: Sensors) {
    let faults = sensors.process.line_faults.clone();
    let mut line = Line::new(stream, faults, Unsent::Kept, sensors.start);
    while let Some(command) = line.next_command().await {
        let text = command.unwrap_or_default().trim().to_lowercase();
        let shown =
            |value: f64| if value.is_finite() { format!("{value:+.6E}") } else { "+9.9E37".to_owned() };
        let answer = match text.strip_suffix('?') {
            Some("*idn") => "DITD,SENSORS,1,1.0".to_owned(),
            Some("all") => {
                let names: Vec<String> = sensors.values.keys().cloned().collect();
                let all: Vec<String> =
                    names.iter().filter_map(|name| sensors.show(name)).map(shown).collect();
                all.join(",")
            }
            Some(name) => sensors.show(name).map_or_else(|| "ERR".to_owned(), shown),
            None => "ERR".to_owned(),
        };
        line.reply(&format!("{answer}\r\n"), REPLY_DELAY);
    }
}
