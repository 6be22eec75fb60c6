//! The `ditd` program: parses the command line, runs one command, turns its end into an exit status.

use clap::{CommandFactory, Parser};
use ditd::clock::Clock;
use ditd::commands;
use std::io::Write;
use std::process::ExitCode;

/// Differential infrared thermography of fuel sprays: runs the campaign, fits the map, keeps the record.
#[derive(Debug, Parser)]
#[command(name = "ditd", version, about, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Run a campaign on a real or simulated rig, up to the maps and the report
    Run(commands::run::Args),
    /// Go on with a run that was paused or killed
    Resume(commands::resume::Args),
    /// Validate a config and print its plan, time, bytes and limits; touches no instrument
    Check(commands::check::Args),
    /// Feed a recorded run through the live path again and compare the results byte for byte
    Replay(commands::replay::Args),
    /// Acquire a calibration with the same engine, without injector
    Calibrate(commands::calibrate::Args),
    /// Bring the rig to its safe state
    Safe(commands::safe::Args),
    /// Refit a run folder or a stack of recorded frames
    Fit(commands::fit::Args),
    /// Inverse Abel transform of columns about a vertical axis
    Abel(commands::abel::Args),
    /// Make a stack of recorded TIFF, raw or NPY frames and a table of what they are
    ImportFrames(commands::import_frames::Args),
    /// Ray-trace a scene
    Render(commands::render::Args),
    /// Mie scattering of spheres: tables in, tables out
    Mie(commands::mie::Args),
    /// Planck's law: tables in, tables out
    Planck(commands::planck::Args),
    /// Fuels, window materials and air, shipped or your own: properties, ranges, sources
    Fuel(commands::fuel::Args),
    /// Read a CFD spray and print its totals
    Import(commands::import::Args),
    /// List serial ports and GigE Vision cameras
    Devices(commands::devices::Args),
    /// Say what is wrong with this machine, and how to mend it
    Doctor(commands::doctor::Args),
    /// Print every feature of a GenICam camera
    Probe(commands::probe::Args),
    /// Simulate instruments on real lines
    Sim(commands::sim::Args),
    /// Measure the speed and the accuracy of this machine's computations
    Bench(commands::bench::Args),
    /// Print the JSON schema of the campaign file
    Schema,
    /// Print completions for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

fn main() -> ExitCode {
    let clock = Clock::start();
    let cli = Cli::parse();
    let ended = match cli.command {
        Command::Run(args) => commands::run::run(args, &clock),
        Command::Resume(args) => commands::resume::run(args, &clock),
        Command::Check(args) => commands::check::run(args),
        Command::Replay(args) => commands::replay::run(args),
        Command::Calibrate(args) => commands::calibrate::run(args, &clock),
        Command::Safe(args) => commands::safe::run(args, &clock),
        Command::Fit(args) => commands::fit::run(args),
        Command::Abel(args) => commands::abel::run(&args),
        Command::ImportFrames(args) => commands::import_frames::run(&args),
        Command::Render(args) => commands::render::run(args),
        Command::Mie(args) => commands::mie::run(args),
        Command::Planck(args) => commands::planck::run(args),
        Command::Fuel(args) => commands::fuel::run(args),
        Command::Import(args) => commands::import::run(args),
        Command::Devices(args) => commands::devices::run(args),
        Command::Doctor(args) => commands::doctor::run(args, &clock),
        Command::Probe(args) => commands::probe::run(args),
        Command::Sim(args) => commands::sim::run(args, &clock),
        Command::Bench(args) => commands::bench::run(&args, &clock),
        Command::Schema => commands::schema::run(),
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "ditd", &mut text);
            commands::print(&String::from_utf8_lossy(&text))
        }
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Nobody may be listening; the status tells.
            let _ = writeln!(std::io::stderr(), "ditd: {error}");
            ExitCode::from(error.code)
        }
    }
}
