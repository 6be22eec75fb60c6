//! `ditd mie`.

use super::{CommandError, CommandResult};

/// Arguments of `ditd mie`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
///
/// As [`CommandError`] says.
pub fn run(_args: Args) -> CommandResult {
    Err(CommandError::failure("mie: not there yet"))
}
