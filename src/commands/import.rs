//! `ditd import`.

use super::{CommandError, CommandResult};

/// Arguments of `ditd import`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
///
/// As [`CommandError`] says.
pub fn run(_args: Args) -> CommandResult {
    Err(CommandError::failure("import: not there yet"))
}
