//! Sources of process values: wall, gas, fuel and window temperatures, chamber and rail pressure.
//!
//! One file per kind of source. A source gives raw numbers; [`Scaled`] makes values of them in the unit that their name
//! says. Limits are judged elsewhere.

pub mod ascii_query;
pub mod csv_tail;
pub mod modbus_registers;

use crate::error::DriverError;
use crate::instrument::{Monitor, MonitorReading};
use async_trait::async_trait;

/// Numbers from here on are what instruments send for "no sensor" or "overload" (SCPI-99: 9.9E37).
const OVERLOAD: f64 = 1e30;

/// A value and how it comes from the raw number: `scale` · raw + `offset`.
#[derive(Debug, Clone, PartialEq)]
pub struct Scaled {
    /// Name with its unit, for instance `wall_temperature_k`.
    pub name: String,
    /// Unit of the name per raw unit.
    pub scale: f64,
    /// In the unit of the name: 273.15 for a source in °C.
    pub offset: f64,
}

impl Scaled {
    /// The value of a raw number.
    ///
    /// # Errors
    /// When it is not finite, or an overload.
    pub fn reading(&self, raw: f64) -> Result<MonitorReading, &'static str> {
        let value = self.scale * raw + self.offset;
        if !raw.is_finite() || !value.is_finite() {
            Err("not a finite number")
        } else if raw.abs() >= OVERLOAD {
            Err("an overload: no sensor, or out of its range")
        } else {
            Ok(MonitorReading { name: self.name.clone(), value })
        }
    }
}

/// A monitor that could not be opened: each reading says why.
#[derive(Debug)]
pub struct Absent(pub DriverError);

#[async_trait]
impl Monitor for Absent {
    async fn read(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        Err(self.0.clone())
    }
}

/// The number in one field of a text: `+296.15`, `T1=296.15K`, `24.1 °C`, `1.2E+05 Pa`.
///
/// # Errors
/// When there is none, or when what stands around it is neither a label nor a unit.
pub fn number_in(field: &str) -> Result<f64, &'static str> {
    // A label ends with = or :; what has no such sign has no label.
    let body = field.rsplit(['=', ':']).next().unwrap_or(field).trim();
    let body = body.trim_matches('"').trim();
    let is_part = |byte: u8| byte.is_ascii_digit() || b"+-.eE".contains(&byte);
    let longest = body.bytes().take_while(|byte| is_part(*byte)).count();
    // "24.1E" is 24.1 with the unit E…; the longest beginning that is a number counts.
    let number = (1..=longest).rev().find_map(|length| {
        let value = body.get(..length)?.parse::<f64>().ok()?;
        Some((value, &body[length..]))
    });
    let Some((value, unit)) = number else { return Err("expected a number") };
    // A digit, a comma or a second sign after the number: the field was cut wrongly.
    if unit.bytes().any(|byte| byte.is_ascii_digit() || b",+-.".contains(&byte)) {
        return Err("expected one number in the field");
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_between_label_and_unit() {
        for (text, value) in [
            ("+296.15", 296.15),
            (" 24.1 °C ", 24.1),
            ("T1=296.15K", 296.15),
            ("P: 1.2E+05 Pa", 1.2e5),
            ("-3", -3.0),
            ("\"7.5\"", 7.5),
            ("24.1E", 24.1),
            ("5 bar", 5.0),
        ] {
            assert_eq!(number_in(text), Ok(value), "{text}");
        }
        for text in ["", "OVER", "--", "24,1", "1.2.3", "5 6", "nan", "inf", "T1", "1e3e4", "0x10"] {
            assert!(number_in(text).is_err(), "{text}: {:?}", number_in(text));
        }
    }

    #[test]
    fn overloads_and_what_is_not_finite_are_no_values() {
        let celsius = Scaled { name: "t_k".to_owned(), scale: 1.0, offset: 273.15 };
        assert!((celsius.reading(100.0).unwrap().value - 373.15).abs() < 1e-9);
        for raw in [f64::NAN, f64::INFINITY, 9.9e37, -9.9e37] {
            assert!(celsius.reading(raw).is_err(), "{raw}");
        }
    }
}
