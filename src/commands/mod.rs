//! The subcommands of `ditd`, one room each. Thin: they read arguments, call the library, print.

pub mod abel;
pub mod bench;
pub mod calibrate;
pub mod check;
pub mod devices;
pub mod doctor;
pub mod fit;
pub mod fuel;
pub mod import;
pub mod import_frames;
pub mod schema;

use crate::campaign::StopFlag;
use crate::clock::Clock;
use crate::config::Config;
use crate::interrupt;
use crate::samples::{self, Source};
use crate::session::{SessionError, Setting};
use std::io::Write;
use std::path::Path;
pub mod mie;
pub mod planck;
pub mod probe;
pub mod render;
pub mod replay;
pub mod run;
pub mod resume;
pub mod safe;
pub mod sim;

/// Why a command ended without success, with the exit status of the contract: 1 failure, 2 usage or config,
/// 3 device missing, 4 interlock or limit, 5 data integrity, 6 paused, 130 interrupted after a safe state.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct CommandError {
    /// The process's exit status.
    pub code: u8,
    /// Who, doing what, why, what to try.
    pub message: String,
}

impl CommandError {
    /// Status 1: it did not work.
    pub fn failure(message: impl Into<String>) -> Self {
        Self { code: 1, message: message.into() }
    }

    /// Status 2: the request itself is wrong.
    pub fn usage(message: impl Into<String>) -> Self {
        Self { code: 2, message: message.into() }
    }
}

/// Reads and checks a campaign file.
fn load(path: &Path) -> Result<(Source, Config), CommandError> {
    let source = samples::open(path).map_err(CommandError::usage)?;
    let config =
        Config::parse(&source.name, &source.text).map_err(|error| CommandError::usage(error.to_string()))?;
    Ok((source, config))
}

/// Signals become wishes from here on.
fn listen() -> Result<StopFlag, CommandError> {
    let stop = StopFlag::default();
    interrupt::listen(stop.clone()).map_err(|error| CommandError::failure(format!("signals: {error}")))?;
    Ok(stop)
}

/// What a session is told, with the signals listened to.
fn setting<'a>(source: &'a Source, config: &'a Config, clock: &Clock) -> Result<Setting<'a>, CommandError> {
    Ok(Setting { source, config, clock: *clock, stop: listen()? })
}

impl From<SessionError> for CommandError {
    fn from(error: SessionError) -> Self {
        Self { code: error.code(), message: error.to_string() }
    }
}

/// Writes to standard output; a reader that has gone away is no failure.
///
/// # Errors
///
/// Status 1 with the system's words.
pub fn print(text: &str) -> CommandResult {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(CommandError::failure(format!("standard output: {error}")))
        }
        _ => Ok(()),
    }
}

/// What a command returns.
pub type CommandResult = Result<(), CommandError>;
