//! `ditd calibrate`: the same engine without injector.

use super::{CommandError, CommandResult, load, print, setting};
use crate::calibrate::Calibration;
use crate::clock::Clock;
use crate::session::{self, Figure, SessionError};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

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
    /// Curve (folder or calibration.json) of a body of known emissivity, for `--kind emissivity`
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// Emissivity of that body
    #[arg(long, value_name = "E", default_value_t = 1.0, value_parser = emissivity)]
    reference_emissivity: f64,
    /// Ask nobody: everything is mounted
    #[arg(long)]
    yes: bool,
    /// Print the calibration as JSON
    #[arg(long)]
    json: bool,
}

fn emissivity(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1.0 => Ok(value),
        _ => Err("an emissivity lies in (0, 1]".to_owned()),
    }
}

/// What is acquired.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// The standard curve and the flat
    Standard,
    /// Today's short curve, mapped on the standard curve of `--standard`, and the flat
    Today,
    /// Transmittance of the windows, and the far window's light
    Window,
    /// ε_B of the plate: from the curve of `--reference`, or from mirrored surroundings at two temperatures
    Emissivity,
    /// Gains and broken pixels
    Flat,
    /// Counts with the shutter closed
    Offset,
    /// Electrons per count and read noise, by photon transfer
    Noise,
}

/// Acquires a calibration.
///
/// # Errors
///
/// The statuses of the contract.
pub fn run(args: Args, clock: &Clock) -> CommandResult {
    let (source, config) = load(&args.config)?;
    let setting = setting(&source, &config, clock)?;
    let by_itself = config.rig.is_some() || args.yes;
    let ask = |what: &str| ask(what, by_itself);
    let figure = match (args.kind, args.reference) {
        (Kind::Standard | Kind::Today, _) => None,
        (Kind::Window, _) => Some(Figure::Windows),
        (Kind::Emissivity, None) => Some(Figure::PlateFromAmbient),
        (Kind::Emissivity, Some(standard)) => {
            Some(Figure::PlateFromReference { standard, emissivity: args.reference_emissivity })
        }
        (Kind::Flat, _) => Some(Figure::Flat),
        (Kind::Offset, _) => Some(Figure::Offset),
        (Kind::Noise, _) => Some(Figure::Noise),
    };
    if let Some(figure) = figure {
        let (name, value) = session::acquire_figure(&setting, &args.out, &figure, &ask)?;
        if args.json {
            return print(&format!("{:#}\n", serde_json::json!({ name: value })));
        }
        return print(&figure_words(name, &value, &args.out));
    }
    let calibrated = match (args.kind, &args.standard) {
        (Kind::Today, Some(standard)) => session::calibrate_today(&setting, &args.out, standard)?,
        _ => session::calibrate(&setting, &args.out)?,
    };
    if args.json {
        let text = serde_json::to_string_pretty(&calibrated.calibration)
            .map_err(|error| CommandError::failure(error.to_string()))?;
        return print(&format!("{text}\n"));
    }
    print(&curve_words(&calibrated.calibration, &args.out))
}

/// Asks the operator and waits for the return key; a simulated rig, or one that nobody stands at, is only told.
fn ask(what: &str, by_itself: bool) -> Result<(), SessionError> {
    let mut err = std::io::stderr();
    // A terminal that is gone cannot be asked; reading then ends the calibration.
    if by_itself {
        let _ = writeln!(err, "{what} (taken as done)");
        return Ok(());
    }
    let _ = write!(err, "{what} Then press return: ");
    let _ = err.flush();
    let mut answer = String::new();
    match std::io::stdin().read_line(&mut answer) {
        Ok(n) if n > 0 => Ok(()),
        _ => Err(SessionError::Other(
            "calibrate: nobody answered. Use --yes when everything is in place.".to_owned(),
        )),
    }
}

/// A figure, a number a line.
fn figure_words(name: &str, value: &serde_json::Value, out: &Path) -> String {
    let mut words = format!("{name}\n");
    for (key, value) in value.as_object().into_iter().flatten() {
        // Writing to a String cannot fail.
        let _ = writeln!(words, "  {key:<28} {value}");
    }
    let _ = writeln!(words, "file   {}", out.join("calibration.json").display());
    words
}

fn curve_words(calibration: &Calibration, folder: &Path) -> String {
    let fit = &calibration.fit;
    let mut out = String::from("   T / K   counts   residual / counts\n");
    for (point, residual) in calibration.points.iter().zip(&fit.residuals) {
        // Writing to a String cannot fail.
        let _ = writeln!(out, "{:8.2} {:8.3} {:+8.4}", point.temperature_k, point.counts, residual);
    }
    let c = &fit.curve;
    let _ = writeln!(
        out,
        "I(T) = {:.6e} / (exp(14387.77 / ({:.6} T + {:.4})) - 1), offset {:+.4} counts, chi2 {:.2} for {} degrees of freedom",
        c.a_counts, c.a_um, c.b_um_k, fit.offset_counts, fit.chi2, fit.dof
    );
    if let Some(mapping) = &calibration.mapping {
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
    if let Some(residual) = &fit.residual {
        let largest = residual.equation_k.iter().zip(&residual.temperature_k).map(|(t, k)| (k - t).abs());
        let _ = writeln!(
            out,
            "the equation does not describe the points: monotone residual of up to {:.3} K",
            largest.fold(0.0, f64::max)
        );
    }
    let _ = writeln!(out, "folder {}", folder.display());
    out
}
