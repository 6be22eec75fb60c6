//! `ditd render`.

use super::{CommandError, CommandResult};

/// Arguments of `ditd render`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
///
/// As [`CommandError`] says.
pub fn run(_args: Args) -> CommandResult {
    Err(CommandError::failure("render: not there yet"))
}
