//! `ditd resume`: goes on after a pause or a crash.

use super::run::print_summary;
use super::{CommandResult, listen, print};
use crate::clock::Clock;
use crate::session;
use std::path::PathBuf;

/// Arguments of `ditd resume`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Run folder
    folder: PathBuf,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Goes on with a run: accepted cycles stay as they are, the missing ones are taken.
///
/// # Errors
///
/// As `ditd run`.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let words = session::resume(&args.folder, *clock, listen()?)?;
    if args.json { print_summary(&args.folder) } else { print(&words) }
}
