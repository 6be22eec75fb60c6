//! Values of commands and replies to text and back. Times are whole picoseconds: the unit's grain is 5 ps.

use super::table::{DELAY_MAX_PS, Key, Kind, table_row};

/// Picoseconds of a second.
pub(super) const PS_PER_S: i64 = 1_000_000_000_000;

/// Decimals of a second that are written: picoseconds, as the unit does.
const DECIMALS: usize = 12;

/// Digits of a number that are read at most: 2000 s in picoseconds have 16.
const DIGITS_MAX: usize = 30;

/// A value of a command or a reply.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A whole number.
    Count(u64),
    /// A time in picoseconds.
    Time(i64),
    /// Volts or hertz.
    Real(f64),
    /// A time after a channel.
    Delay {
        /// The reference: 0 T0, 1 T1, 2 A … 9 H.
        after: u32,
        /// Picoseconds after it.
        ps: i64,
    },
    /// Any text.
    Text(String),
}

/// Levels that differ by less are equal: half of the 10 mV that the unit writes.
const REAL_TOLERANCE: f64 = 0.005;

impl Value {
    /// Whether what the unit holds is what it was told: exact but for levels.
    pub fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Real(a), Self::Real(b)) => (a - b).abs() < REAL_TOLERANCE,
            (a, b) => a == b,
        }
    }

    /// As it is written in a command.
    pub fn encode(&self) -> String {
        match self {
            Self::Count(count) => count.to_string(),
            Self::Time(ps) => encode_time(*ps),
            Self::Real(value) => value.to_string(),
            Self::Delay { after, ps } => format!("{after},{}", encode_time(*ps)),
            Self::Text(text) => text.clone(),
        }
    }

    /// As the unit answers it: times of a delay carry their sign, levels two decimals.
    pub fn answer(&self) -> String {
        match self {
            Self::Delay { after, ps } if *ps >= 0 => format!("{after},+{}", encode_time(*ps)),
            Self::Real(value) if value.abs() < 100.0 => format!("{value:.2}"),
            value => value.encode(),
        }
    }

    /// Reads a value of a key. A number in exponent form is as good as any: the sources differ in how the unit writes them.
    ///
    /// # Errors
    /// Says what was expected instead.
    pub fn decode(key: Key, text: &str) -> Result<Self, &'static str> {
        let text = text.trim();
        match table_row(key).kind {
            Kind::Act => Err("no value belongs here"),
            Kind::Count(least, greatest) => match text.strip_prefix('+').unwrap_or(text).parse() {
                Ok(count) if (least..=greatest).contains(&count) => Ok(Self::Count(count)),
                _ => Err("expected a whole number within its range"),
            },
            Kind::Time(least, greatest) => match decode_time(text) {
                Some(ps) if (least..=greatest).contains(&ps) => Ok(Self::Time(ps)),
                _ => Err("expected a time in seconds within its range"),
            },
            Kind::Real(least, greatest) => match text.parse::<f64>() {
                Ok(value) if (least..=greatest).contains(&value) => Ok(Self::Real(value)),
                _ => Err("expected a number within its range"),
            },
            Kind::Delay => {
                let (after, time) = text.split_once(',').ok_or("expected a channel and a time")?;
                let after = after.trim().parse().ok().filter(|after| *after <= 9);
                let ps = decode_time(time.trim()).filter(|ps| ps.abs() <= DELAY_MAX_PS);
                match (after, ps) {
                    (Some(after), Some(ps)) => Ok(Self::Delay { after, ps }),
                    _ => Err("expected a channel from 0 to 9 and a time within 2000 s"),
                }
            }
            Kind::Text if text.is_empty() => Err("expected a text"),
            Kind::Text => Ok(Self::Text(text.to_owned())),
        }
    }
}

/// Seconds in fixed point with twelve decimals.
pub(super) fn encode_time(ps: i64) -> String {
    let sign = if ps < 0 { "-" } else { "" };
    let magnitude = ps.unsigned_abs();
    let unit = PS_PER_S.unsigned_abs();
    format!("{sign}{}.{:0DECIMALS$}", magnitude / unit, magnitude % unit)
}

/// Seconds, in fixed point or with an exponent, to the picosecond; what is finer is cut off. `None` for anything else
/// and for more than some days.
pub(super) fn decode_time(text: &str) -> Option<i64> {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (sign, magnitude) = match mantissa.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, part) = magnitude.split_once('.').unwrap_or((magnitude, ""));
    let digits = format!("{whole}{part}");
    if digits.is_empty() || digits.len() > DIGITS_MAX || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    if !(-20..=20).contains(&exponent) {
        return None;
    }
    let decimals = i32::try_from(part.len()).ok()?;
    let shift = exponent - decimals + 12;
    let number: i128 = digits.parse().ok()?;
    let scale = 10_i128.checked_pow(shift.unsigned_abs())?;
    let ps = if shift >= 0 { number.checked_mul(scale)? } else { number / scale };
    i64::try_from(ps).ok().map(|ps| sign * ps)
}
