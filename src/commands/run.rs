//! `ditd run`: the campaign, from the file to the maps.

use super::{CommandError, CommandResult, load, print, setting};
use crate::clock::Clock;
use crate::session;
use std::path::{Path, PathBuf};

/// Arguments of `ditd run`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign file, or the name of a built-in one (quickstart, long)
    config: PathBuf,
    /// Run folder to make; without it, a new one below `runs/` named after the time and the campaign file
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Runs a campaign.
///
/// # Errors
///
/// The statuses of the contract; the rig is in its safe state unless the message says otherwise.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let (source, config) = load(&args.config)?;
    let out = args.out.unwrap_or_else(|| default_out(&source.name, clock));
    let setting = setting(&source, &config, clock)?;
    let words = session::run(&setting, &out)?;
    if args.json { print_summary(&out) } else { print(&words) }
}

/// `runs/2026-01-01T080000Z_quickstart`
fn default_out(name: &str, clock: &Clock) -> PathBuf {
    let stamp: String = clock.utc().chars().take(19).filter(|c| *c != ':').collect();
    let stem = Path::new(name).file_stem().map_or_else(|| "run".into(), |stem| stem.to_string_lossy());
    PathBuf::from("runs").join(format!("{stamp}Z_{stem}"))
}

/// The summary of a run folder on standard output.
pub(super) fn print_summary(out: &Path) -> CommandResult {
    let path = out.join("result").join("summary.json");
    let text = std::fs::read_to_string(&path)
        .map_err(|error| CommandError::failure(format!("{}: {error}", path.display())))?;
    print(&text)
}
