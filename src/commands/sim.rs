//! `ditd sim serve`: the simulated rig on real lines.

use super::{CommandError, CommandResult, listen, load, print};
use crate::campaign::StopFlag;
use crate::clock::Clock;
use crate::config::Config;
use crate::console::Console;
use crate::rigs::View;
use crate::rigs::served;
use crate::samples::Source;
use crate::session::{self, Setting};
use ditd_sim::rig::build;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

/// Simulate instruments
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    act: Act,
}

#[derive(Debug, clap::Subcommand)]
enum Act {
    /// Put the simulated rig of a campaign file on pseudo-terminals, TCP ports and a loopback GigE camera, until Ctrl-C
    Serve(Serve),
}

#[derive(Debug, clap::Args)]
struct Serve {
    /// Campaign file with a [rig] table and real addresses
    config: PathBuf,
    /// What stands before the camera
    #[arg(long, value_enum, default_value_t = Before::Chamber)]
    view: Before,
    /// Print what is served as JSON, and at the end what the camera's network side counted
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Before {
    /// Chamber, windows and spray, and the plate behind them
    Chamber,
    /// The bare plate, as a calibration wants it
    Bench,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for a campaign file that cannot be served, status 1 when a line cannot be opened.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let Act::Serve(args) = args.act;
    let (source, config) = load(&args.config)?;
    let stop = listen()?;
    if args.view == Before::Chamber {
        provide_calibration(&source, &config, clock, &stop)?;
    }
    let rig = config
        .rig
        .as_ref()
        .ok_or_else(|| CommandError::usage("sim serve: the campaign file has no [rig] table to simulate"))?;
    let view = match args.view {
        Before::Chamber => View::Chamber,
        Before::Bench => View::Bench,
    };
    let console = Console::new("rendering");
    let world = build::world(rig, view, config.campaign.seed, &source.folder, &|text, done| {
        console.fraction(text, done);
    })
    .map_err(|error| CommandError::usage(error.to_string()))?;
    console.finish();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| CommandError::failure(format!("starting the runtime: {error}")))?;
    runtime.block_on(async {
        let served = served::serve(&config, Arc::new(world), |text| {
            // A terminal that has gone does not stop the rig.
            let _ = writeln!(std::io::stderr(), "ditd: {text}");
        })
        .await
        .map_err(|error| CommandError { code: error.code(), message: error.to_string() })?;
        if args.json {
            let text = serde_json::to_string(&served.served)
                .map_err(|error| CommandError::failure(error.to_string()))?;
            print(&format!("{text}\n"))?;
        } else {
            for line in &served.served {
                print(&format!("{:<8} {}  ({})\n", line.instrument, line.address, line.behind))?;
            }
            print("serving; Ctrl-C ends it\n")?;
        }
        let stats = served.until_stopped(&stop).await;
        if let (true, Some(stats)) = (args.json, stats) {
            let text =
                serde_json::to_string(&stats).map_err(|error| CommandError::failure(error.to_string()))?;
            print(&format!("{text}\n"))?;
        }
        Ok(())
    })
}

/// A campaign in the chamber wants a calibration that was taken without it. Where the file names one that is not there, the
/// same rig takes it by itself, in virtual time.
fn provide_calibration(source: &Source, config: &Config, clock: &Clock, stop: &StopFlag) -> CommandResult {
    let folder = source.folder.join(&config.optics.calibration);
    if config.optics.calibration == "measure" || folder.exists() || config.calibration.is_none() {
        return Ok(());
    }
    let inside = config.simulated_inside();
    let setting = Setting { source, config: &inside, clock: *clock, stop: stop.clone() };
    session::calibrate(&setting, &folder)?;
    Ok(())
}
