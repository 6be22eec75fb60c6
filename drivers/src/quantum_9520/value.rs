//! Values of commands and replies: numbers, times, levels and words to text and back.

use super::table::{Key, Kind, table_row};
use super::{PS_PER_NS, PS_PER_S};
use crate::keyword::{Fit, word_fits};

/// A value of a command or a reply.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// On or off.
    Flag(bool),
    /// A whole number.
    Count(u64),
    /// A time in picoseconds.
    Time(i64),
    /// Volts.
    Volts(f64),
    /// The short form of a word of the key's list.
    Word(String),
    /// A word with a question mark after it: a reference to which the clock is not locked (public driver of the 9530).
    Unlocked(String),
    /// Any text.
    Text(String),
}

/// A value as it is written.
pub(super) fn encode_value(key: Key, value: &Value) -> String {
    match value {
        Value::Flag(on) => u8::from(*on).to_string(),
        Value::Count(count) => count.to_string(),
        // Periods with 9 decimals, always: a 9530 is upset by more (seen by users of its public driver).
        Value::Time(ps) => encode_time(*ps, key == Key::Period),
        Value::Volts(volts) => format!("{volts:.2}"),
        Value::Word(text) | Value::Text(text) => text.clone(),
        Value::Unlocked(text) => format!("{text}?"),
    }
}

/// A value as it is read; says what was expected instead.
pub(super) fn decode_value(key: Key, text: &str) -> Result<Value, &'static str> {
    match table_row(key).kind {
        Kind::Act => Err("no value belongs here"),
        Kind::Flag => match text.to_ascii_uppercase().as_str() {
            "0" | "OFF" => Ok(Value::Flag(false)),
            "1" | "ON" => Ok(Value::Flag(true)),
            _ => Err("expected 0 or 1"),
        },
        Kind::Count(least, greatest) => match text.parse() {
            Ok(count) if (least..=greatest).contains(&count) => Ok(Value::Count(count)),
            _ => Err("expected a whole number within its range"),
        },
        Kind::Time(least, greatest) => match decode_time(text) {
            Some(ps) if (least..=greatest).contains(&ps) => Ok(Value::Time(ps)),
            _ => Err("expected a time in seconds within its range"),
        },
        Kind::Volts(least, greatest) => match text.parse() {
            Ok(volts) if (least..=greatest).contains(&volts) => Ok(Value::Volts(volts)),
            _ => Err("expected a voltage within its range"),
        },
        Kind::Word(words) => words
            .iter()
            .find(|word| word_fits(word, text) != Fit::No)
            .map(|word| Value::Word(word.chars().filter(|c| !c.is_ascii_lowercase()).collect()))
            .ok_or("expected a word of the manual's list"),
        Kind::Text => Ok(Value::Text(text.to_owned())),
    }
}

/// Seconds in fixed point: 9 decimals, 12 where picoseconds need them and `only_ns` is not asked for.
pub(super) fn encode_time(ps: i64, only_ns: bool) -> String {
    let sign = if ps < 0 { "-" } else { "" };
    let magnitude = ps.unsigned_abs();
    let (whole, part) = (magnitude / PS_PER_S.unsigned_abs(), magnitude % PS_PER_S.unsigned_abs());
    let (ns, rest) = (part / PS_PER_NS.unsigned_abs(), part % PS_PER_NS.unsigned_abs());
    if only_ns || rest == 0 {
        format!("{sign}{whole}.{ns:09}")
    } else {
        format!("{sign}{whole}.{ns:09}{rest:03}").trim_end_matches('0').to_owned()
    }
}

/// Seconds in fixed point to picoseconds, exactly; digits beyond are cut off as the unit does.
pub(super) fn decode_time(text: &str) -> Option<i64> {
    let (magnitude, sign) = match text.strip_prefix('-') {
        Some(rest) => (rest, -1),
        None => (text.strip_prefix('+').unwrap_or(text), 1),
    };
    let (whole, part) = magnitude.split_once('.').unwrap_or((magnitude, ""));
    let are_digits = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_digit());
    if !are_digits(whole) || !are_digits(part) || (whole.is_empty() && part.is_empty()) || whole.len() > 6 {
        return None;
    }
    let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
    let part: i64 = format!("{part:0<12}")[..12].parse().ok()?;
    Some(sign * (whole * PS_PER_S + part))
}

/// The source of the clock as the unit answers it. A 9530 has sources that the 9520's table does not: any name will do.
pub(super) fn decode_source(text: &str) -> Result<Value, &'static str> {
    let (name, is_locked) = text.strip_suffix('?').map_or((text, true), |name| (name, false));
    let is_name = name.len() <= 8
        && name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(|c| c.is_ascii_alphanumeric());
    match (is_name, is_locked) {
        (false, _) => Err("expected the name of a clock"),
        (true, true) => Ok(Value::Word(name.to_ascii_uppercase())),
        (true, false) => Ok(Value::Unlocked(name.to_ascii_uppercase())),
    }
}
