//! `ditd run`.

use super::{CommandError, CommandResult};

/// Arguments of `ditd run`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
///
/// As [`CommandError`] says.
pub fn run(_args: Args) -> CommandResult {
    Err(CommandError::failure("run: not there yet"))
}
