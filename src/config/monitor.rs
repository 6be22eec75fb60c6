//! `[[monitor]]`: sources of process values, and what can be wrong with them.

use super::check::Problem;
use super::{Config, default_reopen_s};
use ditd_sim::rig::process;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The drivers that exist.
pub const DRIVERS: [&str; 4] = ["ascii_query", "modbus_registers", "csv_tail", "sim"];

/// Units that the name of a value may end with.
const UNITS: [&str; 14] = [
    "_k",
    "_pa",
    "_s",
    "_m",
    "_m_per_s",
    "_kg_per_s",
    "_m3_per_s",
    "_hz",
    "_v",
    "_a",
    "_w",
    "_percent",
    "_fraction",
    "_counts",
];

/// `[[monitor]]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Monitor {
    /// Name in the telemetry.
    pub name: String,
    /// Driver: `ascii_query`, `modbus_registers`, `csv_tail` or `sim`.
    pub driver: String,
    /// `sim`, `serial:/dev/…`, `tcp:host:port` or, for `csv_tail`, `file:PATH`.
    pub address: String,
    /// Baud rate of a serial line; absent: 9600 for `ascii_query`, 19200 for `modbus_registers`.
    pub baud: Option<u32>,
    /// A line that has gone is tried to be opened again for so long, in s; 0: never.
    #[serde(default = "default_reopen_s")]
    pub reopen_s: f64,
    /// Whether the campaign ends when it cannot be read; otherwise its values are missing then.
    #[serde(default = "yes")]
    pub required: bool,
    /// `ascii_query`: what ends a query, `"\r"`, `"\n"` or `"\r\n"`; absent: `"\r\n"`.
    pub ending: Option<String>,
    /// `ascii_query`: longest wait for an answer, in s; absent: 1.
    pub timeout_s: Option<f64>,
    /// `modbus_registers`: address of the unit, 1 … 247; absent: 1.
    pub unit: Option<u8>,
    /// `csv_tail`: what parts the fields; absent: a comma.
    pub separator: Option<char>,
    /// `csv_tail`: a file without a new line for so long is stale, in s.
    pub stale_s: Option<f64>,
    /// What it gives.
    #[serde(rename = "value")]
    pub values: Vec<MonitorValue>,
}

/// `[[monitor.value]]`: value = scale · number + offset.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MonitorValue {
    /// Name with its unit, for instance `wall_temperature_k`.
    pub name: String,
    /// `ascii_query`: the text that asks for it.
    pub query: Option<String>,
    /// `ascii_query`: field of the answer, from 0; absent: 0.
    pub field: Option<usize>,
    /// `modbus_registers`: its first register as it goes over the line, from 0.
    pub register: Option<u16>,
    /// `modbus_registers`: 3 (holding) or 4 (input); absent: 3.
    pub function: Option<u8>,
    /// `modbus_registers`: `u16`, `i16`, `u32`, `i32` or `f32`.
    #[serde(rename = "type")]
    pub kind: Option<Kind>,
    /// `modbus_registers`: `high-first` or `low-first`; absent: `high-first`.
    pub word_order: Option<WordOrder>,
    /// `csv_tail`: name of its column.
    pub column: Option<String>,
    /// Unit of the name per unit of the number.
    #[serde(default = "one")]
    pub scale: f64,
    /// Added to it: 273.15 for a number in °C.
    #[serde(default)]
    pub offset: f64,
    /// Below this the campaign ends in the safe state.
    pub low: Option<f64>,
    /// Above this the campaign ends in the safe state.
    pub high: Option<f64>,
}

/// How the bits of a register are meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// One register, unsigned.
    U16,
    /// One register, signed.
    I16,
    /// Two registers, unsigned.
    U32,
    /// Two registers, signed.
    I32,
    /// Two registers, IEEE 754 single.
    F32,
}

/// Which of two registers comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WordOrder {
    /// The high word.
    HighFirst,
    /// The low word.
    LowFirst,
}

fn yes() -> bool {
    true
}

fn one() -> f64 {
    1.0
}

/// Everything that is wrong with the monitors of a config whose keys are all known.
pub(super) fn problems(config: &Config, found: &mut Vec<Problem>) {
    for (index, monitor) in config.monitors.iter().enumerate() {
        let mut check = Check { table: format!("monitor[{index}]"), found };
        check.monitor(monitor, config);
        let earlier = &config.monitors[..index];
        check.require(!earlier.iter().any(|other| other.name == monitor.name), "name", || {
            format!("two monitors are called {:?}", monitor.name)
        });
        for (number, value) in monitor.values.iter().enumerate() {
            let mut check = Check { table: format!("monitor[{index}].value[{number}]"), found };
            check.value(value, monitor, config);
            check.require(
                !monitor.values[..number].iter().any(|other| other.name == value.name),
                "name",
                || format!("two values are called {:?}", value.name),
            );
        }
    }
}

struct Check<'a> {
    table: String,
    found: &'a mut Vec<Problem>,
}

impl Check<'_> {
    fn require(&mut self, holds: bool, key: &str, message: impl FnOnce() -> String) {
        if !holds {
            self.found.push(Problem { key: format!("{}.{key}", self.table), message: message() });
        }
    }

    /// A key that belongs to one driver: needed there if it has no default, and refused elsewhere.
    fn belongs(&mut self, key: &str, is_given: bool, is_right: bool, is_needed: bool, owner: &str) {
        self.require(!is_given || is_right, key, || {
            format!("only monitors with driver = {owner:?} have this")
        });
        self.require(is_given || !is_right || !is_needed, key, || format!("driver = {owner:?} needs it"));
    }

    fn monitor(&mut self, monitor: &Monitor, config: &Config) {
        let driver = monitor.driver.as_str();
        self.require(DRIVERS.contains(&driver), "driver", || {
            format!("unknown driver {driver:?}; there are: {}", DRIVERS.join(", "))
        });
        let plain = |text: &str| {
            !text.is_empty() && text.bytes().all(|b| b.is_ascii_alphanumeric() || b"_-".contains(&b))
        };
        self.require(plain(&monitor.name), "name", || {
            format!(
                "letters, digits, _ and - only (it heads a column of the telemetry), found {:?}",
                monitor.name
            )
        });
        self.require(!monitor.values.is_empty(), "value", || "at least one [[monitor.value]]".to_owned());
        let is_sim = monitor.address == "sim";
        self.require(!is_sim || config.rig.is_some(), "address", || {
            "`sim` needs a [rig] table that describes the simulated world".to_owned()
        });
        let address = monitor.address.as_str();
        let has = |prefix: &str| address.strip_prefix(prefix).is_some_and(|rest| !rest.is_empty());
        let (fits, forms) = match driver {
            "csv_tail" => (has("file:"), "file:PATH"),
            "sim" => (is_sim, "sim"),
            "modbus_registers" => (has("serial:") || has("tcp:"), "serial:/dev/… or tcp:host:port"),
            _ => (is_sim || has("serial:") || has("tcp:"), "sim, serial:/dev/… or tcp:host:port"),
        };
        self.require(fits || !DRIVERS.contains(&driver), "address", || {
            format!("driver = {driver:?} takes {forms}, found {address:?}")
        });
        let (ascii, modbus, csv) =
            (driver == "ascii_query", driver == "modbus_registers", driver == "csv_tail");
        self.belongs("ending", monitor.ending.is_some(), ascii, false, "ascii_query");
        self.belongs("timeout_s", monitor.timeout_s.is_some(), ascii, false, "ascii_query");
        self.belongs("unit", monitor.unit.is_some(), modbus, false, "modbus_registers");
        self.belongs("separator", monitor.separator.is_some(), csv, false, "csv_tail");
        self.belongs("stale_s", monitor.stale_s.is_some(), csv, true, "csv_tail");
        let ending = monitor.ending.as_deref().unwrap_or("\r\n");
        self.require(["\r", "\n", "\r\n"].contains(&ending), "ending", || {
            format!(r#"one of "\r", "\n" and "\r\n", found {ending:?}"#)
        });
        let within =
            |value: Option<f64>, greatest: f64| value.is_none_or(|value| value > 0.0 && value <= greatest);
        self.require(within(monitor.timeout_s, 60.0), "timeout_s", || "above 0 to 60 s".to_owned());
        self.require(within(monitor.stale_s, 86_400.0), "stale_s", || "above 0 to 86400 s".to_owned());
        self.require((0.0..=3600.0).contains(&monitor.reopen_s), "reopen_s", || "0 to 3600 s".to_owned());
        self.require(monitor.unit.is_none_or(|unit| (1..=247).contains(&unit)), "unit", || {
            "a Modbus address is 1 to 247".to_owned()
        });
        self.require(monitor.baud.is_none_or(|baud| baud >= 300), "baud", || "at least 300".to_owned());
    }

    fn value(&mut self, value: &MonitorValue, monitor: &Monitor, config: &Config) {
        let driver = monitor.driver.as_str();
        let (ascii, modbus, csv) =
            (driver == "ascii_query", driver == "modbus_registers", driver == "csv_tail");
        let name = value.name.as_str();
        let plain = name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
        let has_unit = UNITS.iter().any(|unit| name.len() > unit.len() && name.ends_with(unit));
        self.require(plain && has_unit, "name", || {
            let units = UNITS.map(|unit| unit.trim_start_matches('_')).join(", ");
            format!("small letters, digits and _, with its unit at the end ({units}), found {name:?}")
        });
        self.belongs("query", value.query.is_some(), ascii, true, "ascii_query");
        self.belongs("field", value.field.is_some(), ascii, false, "ascii_query");
        self.belongs("register", value.register.is_some(), modbus, true, "modbus_registers");
        self.belongs("function", value.function.is_some(), modbus, false, "modbus_registers");
        self.belongs("type", value.kind.is_some(), modbus, true, "modbus_registers");
        self.belongs("word_order", value.word_order.is_some(), modbus, false, "modbus_registers");
        self.belongs("column", value.column.is_some(), csv, true, "csv_tail");
        let printable = |text: &str| !text.is_empty() && text.bytes().all(|b| (0x20..=0x7e).contains(&b));
        self.require(value.query.as_deref().is_none_or(printable), "query", || {
            "printable ASCII without its line end".to_owned()
        });
        self.require(value.function.is_none_or(|f| f == 3 || f == 4), "function", || {
            "3 (holding registers) or 4 (input registers)".to_owned()
        });
        self.require(
            value.register != Some(u16::MAX)
                || !matches!(value.kind, Some(Kind::U32 | Kind::I32 | Kind::F32)),
            "register",
            || "the second register of the value would be 65536".to_owned(),
        );
        self.require(value.scale.is_finite() && value.scale.abs() > 0.0, "scale", || {
            format!("a number other than 0, found {}", value.scale)
        });
        self.require(value.offset.is_finite(), "offset", || format!("a number, found {}", value.offset));
        let limits = [value.low, value.high];
        self.require(limits.iter().flatten().all(|limit| limit.is_finite()), "low", || {
            "limits are numbers".to_owned()
        });
        if let [Some(low), Some(high)] = limits {
            self.require(low < high, "low", || format!("{low} is not below high = {high}"));
        }
        if let (true, Some(rig)) = (driver == "sim", &config.rig) {
            let known = process::values_of(rig);
            self.require(known.contains_key(name), "name", || {
                let names: Vec<&str> = known.keys().map(String::as_str).collect();
                format!("the simulated rig has no such sensor; there are: {}", names.join(", "))
            });
        }
    }
}
