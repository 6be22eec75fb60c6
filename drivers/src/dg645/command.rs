//! One command to the unit, to bytes and back, and the codes of its error queue. Replies are bare values
//! ([`super::Value`]); a command that tells has none.

use super::table::{Key, Kind, TABLE, table_row};
use super::value::Value;

/// Whether a command asks or tells.
#[derive(Debug, Clone, PartialEq)]
pub enum Act {
    /// Asks.
    Query,
    /// Tells, with its value; an act has none.
    Set(Option<Value>),
}

/// One command.
///
/// ```
/// use ditd_drivers::dg645::{Command, Key, Value};
/// let command = Command::set(Key::Delay, 3, Value::Delay { after: 2, ps: 1_500_000_000 });
/// assert_eq!(command.encode(), "DLAY 3,2,0.001500000000");
/// assert_eq!(Command::decode("dlay 3, 2, 1.5e-3"), Ok(command));
/// assert_eq!(Command::query(Key::Delay, 3).encode(), "DLAY?3");
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// What it is about.
    pub key: Key,
    /// The channel, output or prescaler; 0 for commands that have none.
    pub index: u32,
    /// What is done.
    pub act: Act,
}

/// A code of the error queue. Only those below were seen by the sources; others keep their number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// 10
    #[error("error 10: illegal value")]
    IllegalValue,
    /// 12
    #[error("error 12: illegal delay")]
    IllegalDelay,
    /// 13
    #[error("error 13: illegal link")]
    IllegalLink,
    /// 16
    #[error("error 16: self-test failed")]
    SelfTest,
    /// 17
    #[error("error 17: auto-calibration failed")]
    Calibration,
    /// Any other.
    #[error("error {0}")]
    Other(u64),
}

impl Fault {
    /// From its number; `None` for 0, which means that the queue is empty.
    pub fn from_code(code: u64) -> Option<Self> {
        Some(match code {
            0 => return None,
            10 => Self::IllegalValue,
            12 => Self::IllegalDelay,
            13 => Self::IllegalLink,
            16 => Self::SelfTest,
            17 => Self::Calibration,
            other => Self::Other(other),
        })
    }

    /// Its number.
    pub fn code(self) -> u64 {
        match self {
            Self::IllegalValue => 10,
            Self::IllegalDelay => 12,
            Self::IllegalLink => 13,
            Self::SelfTest => 16,
            Self::Calibration => 17,
            Self::Other(code) => code,
        }
    }
}

/// What the simulated unit puts into its queue for a line it does not know. The maker's tests accept 110, 111 or 113
/// here: a driver must not tell them apart.
pub const NOT_UNDERSTOOD: Fault = Fault::Other(111);

impl Command {
    /// A query; `index` is 0 for commands without one.
    pub fn query(key: Key, index: u32) -> Self {
        Self { key, index, act: Act::Query }
    }

    /// A set; `index` is 0 for commands without one.
    pub fn set(key: Key, index: u32, value: Value) -> Self {
        Self { key, index, act: Act::Set(Some(value)) }
    }

    /// An act without a value.
    pub fn act(key: Key) -> Self {
        Self { key, index: 0, act: Act::Set(None) }
    }

    /// The command as sent, without its line end.
    pub fn encode(&self) -> String {
        let row = table_row(self.key);
        let index = if row.index.is_some() { self.index.to_string() } else { String::new() };
        match &self.act {
            Act::Query => format!("{}?{index}", row.mnemonic),
            Act::Set(None) => row.mnemonic.to_owned(),
            Act::Set(Some(value)) if index.is_empty() => format!("{} {}", row.mnemonic, value.encode()),
            Act::Set(Some(value)) => format!("{} {index},{}", row.mnemonic, value.encode()),
        }
    }

    /// Reads a line as the unit does: mnemonics without regard to case, spaces between parameters allowed.
    ///
    /// # Errors
    /// The code that goes into the error queue.
    pub fn decode(line: &str) -> Result<Self, Fault> {
        let line = line.trim();
        let end = line.find(['?', ' ']).unwrap_or(line.len());
        let (mnemonic, rest) = line.split_at(end);
        let row =
            TABLE.iter().find(|row| row.mnemonic.eq_ignore_ascii_case(mnemonic)).ok_or(NOT_UNDERSTOOD)?;
        if let Some(parameter) = rest.strip_prefix('?') {
            let index = read_index(row.index, parameter.trim())?;
            return if row.asks { Ok(Self::query(row.key, index)) } else { Err(NOT_UNDERSTOOD) };
        }
        let rest = rest.trim();
        if !row.tells {
            return Err(NOT_UNDERSTOOD);
        }
        if row.kind == Kind::Act {
            return if rest.is_empty() { Ok(Self::act(row.key)) } else { Err(NOT_UNDERSTOOD) };
        }
        let (index, text) = match row.index {
            None => (0, rest),
            Some(_) => {
                let (index, text) = rest.split_once(',').ok_or(NOT_UNDERSTOOD)?;
                (read_index(row.index, index.trim())?, text)
            }
        };
        let value = Value::decode(row.key, text).map_err(|_| Fault::IllegalValue)?;
        if let (Key::Delay, Value::Delay { after, .. }) = (row.key, &value) {
            // The link rule: no channel hangs on itself, T0 and T1 have no delay of their own, nothing hangs on T1.
            if index == *after || index <= 1 || *after == 1 {
                return Err(Fault::IllegalLink);
            }
        }
        Ok(Self::set(row.key, index, value))
    }
}

fn read_index(range: Option<(u32, u32)>, text: &str) -> Result<u32, Fault> {
    match (range, text.parse::<u32>()) {
        (None, _) if text.is_empty() => Ok(0),
        (Some((least, greatest)), Ok(index)) if (least..=greatest).contains(&index) => Ok(index),
        (Some(_), Ok(_)) => Err(Fault::IllegalValue),
        _ => Err(NOT_UNDERSTOOD),
    }
}
