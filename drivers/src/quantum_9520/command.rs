//! One command to the unit, and the answer to it, to bytes and back.

use super::table::{Key, Kind, TABLE, fit, table_row};
use super::value::{Value, decode_source, decode_value, encode_value};
use crate::keyword::spell;
use serde::{Deserialize, Serialize};

/// Whether a command asks or tells.
#[derive(Debug, Clone, PartialEq)]
pub enum Act {
    /// Asks; the counter's query has a word.
    Query(Option<String>),
    /// Tells, with its value; an act has none.
    Set(Option<Value>),
}

/// One command.
///
/// ```
/// use ditd_drivers::quantum_9520::{Command, Key, Value};
/// let command = Command::set_channel(0, Key::Period, Value::Time(20_000_000_000));
/// assert_eq!(command.encode(), ":PULSE0:PER 0.020000000");
/// assert_eq!(Command::decode(":puls0:period 0.02"), Ok(command));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// What it is about.
    pub key: Key,
    /// The number after `:PULSE`; `None` means the channel that was selected last.
    pub channel: Option<u32>,
    /// What is done.
    pub act: Act,
}

/// The unit's error answers, `?1` to `?8` (manual, chapter 7).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "kebab-case")]
pub enum UnitError {
    /// `?1`
    #[error("?1: incorrect prefix")]
    Prefix,
    /// `?2`
    #[error("?2: missing keyword")]
    MissingKeyword,
    /// `?3`
    #[error("?3: invalid keyword")]
    Keyword,
    /// `?4`
    #[error("?4: missing parameter")]
    MissingParameter,
    /// `?5`
    #[error("?5: invalid parameter")]
    Parameter,
    /// `?6`
    #[error("?6: query only, the command needs a question mark")]
    QueryOnly,
    /// `?7`
    #[error("?7: the command has no query form")]
    NoQuery,
    /// `?8`
    #[error("?8: unavailable in the present state")]
    Unavailable,
}

/// All of them, in order of their numbers.
pub(super) const UNIT_ERRORS: [UnitError; 8] = [
    UnitError::Prefix,
    UnitError::MissingKeyword,
    UnitError::Keyword,
    UnitError::MissingParameter,
    UnitError::Parameter,
    UnitError::QueryOnly,
    UnitError::NoQuery,
    UnitError::Unavailable,
];

/// One answer.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// `ok`
    Done,
    /// `?n`
    Failed(UnitError),
    /// The value asked for.
    Value(Value),
}

impl Command {
    /// A query of the unit, not of a channel.
    pub fn query(key: Key) -> Self {
        Self { key, channel: None, act: Act::Query(None) }
    }

    /// A set of the unit, not of a channel.
    pub fn set(key: Key, value: Value) -> Self {
        Self { key, channel: None, act: Act::Set(Some(value)) }
    }

    /// A query of a channel; 0 is the system clock.
    pub fn query_channel(channel: u32, key: Key) -> Self {
        Self { key, channel: Some(channel), act: Act::Query(None) }
    }

    /// A set of a channel; 0 is the system clock.
    pub fn set_channel(channel: u32, key: Key, value: Value) -> Self {
        Self { key, channel: Some(channel), act: Act::Set(Some(value)) }
    }

    /// An act without a value.
    pub fn act(key: Key) -> Self {
        Self { key, channel: None, act: Act::Set(None) }
    }

    /// The command as sent, without its line end.
    pub fn encode(&self) -> String {
        let spelled = spell(table_row(self.key).spelling, self.channel);
        match &self.act {
            Act::Query(None) => format!("{spelled}?"),
            Act::Query(Some(word)) => format!("{spelled}? {word}"),
            Act::Set(None) => spelled,
            Act::Set(Some(value)) => format!("{spelled} {}", encode_value(self.key, value)),
        }
    }

    /// Reads a line as the unit does.
    ///
    /// # Errors
    /// The unit's own error answer.
    pub fn decode(line: &str) -> Result<Self, UnitError> {
        let line = line.trim();
        if !line.starts_with([':', '*']) {
            return Err(UnitError::Prefix);
        }
        let (head, parameter) = line.split_once(' ').unwrap_or((line, ""));
        let parameter = parameter.trim();
        let (path, asks) = match head.strip_suffix('?') {
            Some(path) => (path, true),
            None => (head, false),
        };
        if path.len() < 2 || path.ends_with(':') {
            return Err(UnitError::MissingKeyword);
        }
        let (row, channel) = TABLE.iter().find_map(|row| fit(row, path)).ok_or(UnitError::Keyword)?;
        let act = match (asks, row.asks, row.tells) {
            (true, false, _) => return Err(UnitError::NoQuery),
            (false, _, false) => return Err(UnitError::QueryOnly),
            (true, true, _) => Act::Query((!parameter.is_empty()).then(|| parameter.to_owned())),
            (false, _, true) if row.kind == Kind::Act => Act::Set(None),
            (false, _, true) if parameter.is_empty() => return Err(UnitError::MissingParameter),
            (false, _, true) => {
                Act::Set(Some(decode_value(row.key, parameter).map_err(|_| UnitError::Parameter)?))
            }
        };
        Ok(Self { key: row.key, channel, act })
    }
}

impl Reply {
    /// The reply to a command about `key` as sent, without its line end.
    pub fn encode(&self, key: Key) -> String {
        match self {
            Self::Done => "ok".to_owned(),
            Self::Failed(error) => {
                let index = UNIT_ERRORS.iter().position(|other| other == error);
                format!("?{}", index.expect("the list has every error: tested") + 1)
            }
            Self::Value(value) => encode_value(key, value),
        }
    }

    /// Reads the reply to a command about `key`.
    ///
    /// # Errors
    /// Says what was expected instead.
    pub fn decode(key: Key, text: &str) -> Result<Self, &'static str> {
        if text.eq_ignore_ascii_case("ok") {
            return Ok(Self::Done);
        }
        if let Some(digits) = text.strip_prefix('?') {
            let index = digits.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
            let error = index.and_then(|index| UNIT_ERRORS.get(index));
            return error.map(|error| Self::Failed(*error)).ok_or("expected an error number from 1 to 8");
        }
        let value = if key == Key::ClockIn { decode_source(text) } else { decode_value(key, text) };
        value.map(Self::Value)
    }
}
