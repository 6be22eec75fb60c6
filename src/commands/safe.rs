//! `ditd safe`: brings the rig to its safe state.

use super::{CommandResult, load, print, setting};
use crate::clock::Clock;
use crate::session;
use std::path::PathBuf;

/// Arguments of `ditd safe`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign file, or the name of a built-in one
    config: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Injector channel off, trigger clock off, camera off, plate to its minimum. Idempotent.
///
/// # Errors
///
/// Status 3 when an instrument is missing, 4 when the safe state could not be confirmed.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let (source, config) = load(&args.config)?;
    session::make_safe(&setting(&source, &config, clock)?)?;
    if args.json {
        return print("{\"safe\": true}\n");
    }
    print("safe: injector channel off, trigger clock off, camera off, plate to its minimum\n")
}
