//! `ditd doctor`: what is wrong with this machine, and the command that mends it.

use super::{CommandError, CommandResult, load, print};
use crate::clock::Clock;
use crate::doctor::{Finding, Machine, State, examine};
use std::path::{Path, PathBuf};

/// Look at rights, ports, network, disk and clock of this machine; each finding with what mends it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign file: look at what this campaign needs
    config: Option<PathBuf>,
    /// Folder in which runs are written
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
///
/// Status 1 when something is bad, status 2 for a campaign file that cannot be used.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let config = match &args.config {
        Some(path) => Some(load(path)?.1),
        None => None,
    };
    let findings = examine(&Machine::at(Path::new("/")), config.as_ref(), &args.out, clock);
    if args.json {
        let text = serde_json::to_string_pretty(&findings)
            .map_err(|error| CommandError::failure(error.to_string()))?;
        print(&format!("{text}\n"))?;
    } else {
        print(&words(&findings))?;
    }
    let bad = findings.iter().filter(|finding| finding.state == State::Bad).count();
    if bad > 0 {
        return Err(CommandError::failure(format!("doctor: {bad} finding(s) would make a campaign fail")));
    }
    Ok(())
}

fn words(findings: &[Finding]) -> String {
    let mut out = String::new();
    for finding in findings {
        let mark = match finding.state {
            State::Good => "good",
            State::Warning => "warning",
            State::Bad => "BAD",
        };
        out.push_str(&format!("{mark:<8} {}: {}\n", finding.subject, finding.found));
        if !finding.mend.is_empty() {
            out.push_str(&format!("{:<8} mend: {}\n", "", finding.mend));
        }
    }
    out
}
