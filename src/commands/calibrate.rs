//! `ditd calibrate`: the same engine without injector.

use super::{CommandError, CommandResult, load, print, setting};
use crate::clock::Clock;
use crate::session;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `ditd calibrate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign file, or the name of a built-in one
    config: PathBuf,
    /// What is acquired
    #[arg(long, value_enum, default_value = "standard")]
    kind: Kind,
    /// Folder to make
    #[arg(long, value_name = "DIR", default_value = "calibration")]
    out: PathBuf,
    /// Standard curve (folder or calibration.json) that today's is mapped on
    #[arg(long, value_name = "DIR", required_if_eq("kind", "today"))]
    standard: Option<PathBuf>,
    /// Print the calibration as JSON
    #[arg(long)]
    json: bool,
}

/// What is acquired.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// The standard curve and the flat
    Standard,
    /// Today's short curve, mapped on the standard curve of `--standard`, and the flat
    Today,
}

/// Acquires a calibration.
///
/// # Errors
///
/// The statuses of the contract.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let (source, config) = load(&args.config)?;
    let setting = setting(&source, &config, clock)?;
    let calibrated = match (args.kind, &args.standard) {
        (Kind::Today, Some(standard)) => session::calibrate_today(&setting, &args.out, standard)?,
        (Kind::Standard | Kind::Today, _) => session::calibrate(&setting, &args.out)?,
    };
    if args.json {
        let text = serde_json::to_string_pretty(&calibrated.calibration)
            .map_err(|error| CommandError::failure(error.to_string()))?;
        return print(&format!("{text}\n"));
    }
    let fit = &calibrated.calibration.fit;
    let mut out = String::from("   T / K   counts   residual / counts\n");
    for (point, residual) in calibrated.calibration.points.iter().zip(&fit.residuals) {
        // Writing to a String cannot fail.
        let _ = writeln!(out, "{:8.2} {:8.3} {:+8.4}", point.temperature_k, point.counts, residual);
    }
    let c = &fit.curve;
    let _ = writeln!(
        out,
        "I(T) = {:.6e} / (exp(14387.77 / ({:.6} T + {:.4})) - 1), offset {:+.4} counts, chi2 {:.2} for {} degrees of freedom",
        c.a_counts, c.a_um, c.b_um_k, fit.offset_counts, fit.chi2, fit.dof
    );
    if let Some(mapping) = &calibrated.calibration.mapping {
        let _ = writeln!(
            out,
            "mapped on the standard curve of {}: gain {:.5} ± {:.5}, drift {:+.2} %",
            mapping.standard_utc,
            mapping.line.gain,
            mapping.line.covariance[0][0].sqrt(),
            100.0 * mapping.drift
        );
        for alarm in mapping.alarms() {
            let _ = writeln!(out, "WARNING {alarm}");
        }
    }
    let _ = writeln!(out, "folder {}", args.out.display());
    print(&out)
}
