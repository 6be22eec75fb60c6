//! `ditd check`.

use super::{CommandError, CommandResult};

/// Arguments of `ditd check`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
///
/// As [`CommandError`] says.
pub fn run(_args: Args) -> CommandResult {
    Err(CommandError::failure("check: not there yet"))
}
