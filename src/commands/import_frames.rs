//! `ditd import-frames`: recorded TIFF, raw or NPY frames and a table of what they are become a stack that `ditd fit` reads.

use super::{CommandError, CommandResult, print};
use crate::import_frames::{Constants, Imported, RawDefaults, import};
use crate::stack::CaseCurve;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Arguments of `ditd import-frames`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Table (CSV): file, page or frame (0 the first), level, plate_temperature_k, kind (spray, blank, discarded), time_s, cycle or pair; for raw files also header_bytes, rows, columns, byte_order, bits
    #[arg(value_name = "TABLE.csv")]
    table: PathBuf,
    /// Folder of the stack to be made
    #[arg(long, value_name = "STACK")]
    out: PathBuf,
    /// case.json of another stack, for what is not given here: gamma, eps_B, saturation_count, calibration …
    #[arg(long, value_name = "CASE.json")]
    case: Option<PathBuf>,
    /// Transmittance of a window (1 if nothing says)
    #[arg(long, value_name = "GAMMA")]
    gamma: Option<f64>,
    /// Emissivity of the plate (1 if nothing says)
    #[arg(long, value_name = "EPS")]
    eps_b: Option<f64>,
    /// Counts from which a sample is saturated (65535 if nothing says)
    #[arg(long, value_name = "COUNTS")]
    saturation_count: Option<u16>,
    /// The camera's curve: a file with A, a_um, b_um_K, or calibration.json; without one `ditd fit` needs --calibration
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Part of a frame's pixels that may be saturated
    #[arg(long, value_name = "PART", default_value_t = 0.5)]
    saturated_max: f64,
    /// Raw files: bytes before the first frame
    #[arg(long, value_name = "BYTES")]
    raw_header_bytes: Option<u64>,
    /// Raw files: rows of a frame
    #[arg(long, value_name = "N")]
    raw_rows: Option<usize>,
    /// Raw files: columns of a frame
    #[arg(long, value_name = "N")]
    raw_columns: Option<usize>,
    /// Raw files: which byte of a sample comes first
    #[arg(long, value_enum)]
    raw_byte_order: Option<ByteOrder>,
    /// Raw files: bits of a sample
    #[arg(long, value_name = "N")]
    raw_bits: Option<u32>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Which byte comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ByteOrder {
    /// The low one
    Little,
    /// The high one
    Big,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for a table or frames that make no sense, naming file and line.
pub fn run(args: &Args) -> CommandResult {
    let (constants, assumed) = constants(args)?;
    let imported = import(&args.table, &args.out, &constants)
        .map_err(|why| CommandError::usage(format!("import-frames: {why}.")))?;
    if args.json {
        let mut told = json!(imported);
        told["assumed"] = json!(assumed);
        told["schema"] = json!(1);
        return print(&(serde_json::to_string_pretty(&told).expect("numbers and texts") + "\n"));
    }
    print(&readable(&imported, &assumed, &args.out))
}

/// What the table does not say, and which of it nobody said.
fn constants(args: &Args) -> Result<(Constants, Vec<String>), CommandError> {
    let usage = |what: String| CommandError::usage(format!("import-frames: {what}."));
    let read = |path: &Path| -> Result<Value, CommandError> {
        let text = std::fs::read_to_string(path).map_err(|e| usage(format!("{}: {e}", path.display())))?;
        serde_json::from_str(&text).map_err(|e| usage(format!("{}: {e}", path.display())))
    };
    let case = args.case.as_deref().map(read).transpose()?.unwrap_or(Value::Null);
    let mut assumed = Vec::new();
    let mut number = |name: &str, given: Option<f64>, otherwise: f64| {
        let known = given.or_else(|| case[name].as_f64());
        known.unwrap_or_else(|| {
            assumed.push(format!("{name} = {otherwise}"));
            otherwise
        })
    };
    let gamma = number("gamma", args.gamma, 1.0);
    let emissivity_plate = number("eps_B", args.eps_b, 1.0);
    let saturation = number("saturation_count", args.saturation_count.map(f64::from), 65_535.0);
    for (name, value) in [("gamma", gamma), ("eps_B", emissivity_plate)] {
        if !(value > 0.0 && value <= 1.0) {
            return Err(usage(format!("{name} must lie in (0, 1], found {value}")));
        }
    }
    if !(1.0..=65_535.0).contains(&saturation) || saturation.fract() != 0.0 {
        return Err(usage(format!("saturation_count must be a count from 1 to 65535, found {saturation}")));
    }
    if !(0.0..=1.0).contains(&args.saturated_max) {
        return Err(usage(format!("--saturated-max must lie in 0 … 1, found {}", args.saturated_max)));
    }
    let calibration = match &args.calibration {
        Some(path) => Some(curve(path)?),
        None if case["calibration"].is_object() => {
            let found: Result<CaseCurve, _> = serde_json::from_value(case["calibration"].clone());
            Some(found.map_err(|e| usage(format!("--case: calibration: {e}")))?)
        }
        None => None,
    };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be 1 ..= 65535")]
    let saturation_count = saturation as u16;
    let raw = RawDefaults {
        header_bytes: args.raw_header_bytes,
        rows: args.raw_rows,
        columns: args.raw_columns,
        big_endian: args.raw_byte_order.map(|order| order == ByteOrder::Big),
        bits: args.raw_bits,
    };
    let saturated_max = args.saturated_max;
    Ok((
        Constants { case, gamma, emissivity_plate, saturation_count, calibration, raw, saturated_max },
        assumed,
    ))
}

/// A curve from a file, as a case states it.
fn curve(path: &Path) -> Result<CaseCurve, CommandError> {
    let found = crate::stack::Calibration::read(path)?.curve;
    Ok(CaseCurve { a_counts: found.a_counts, a_um: found.a_um, b_um_k: found.b_um_k, c2_um_k: None })
}

fn readable(imported: &Imported, assumed: &[String], out: &Path) -> String {
    let mut text = format!(
        "{} x {} pixels, {} levels, {} blanks a spray frame, {} frames discarded\n",
        imported.rows,
        imported.columns,
        imported.cycles.len(),
        imported.blanks_per_spray,
        imported.discarded
    );
    for ((plate, cycles), saturated) in
        imported.plate_temperature_k.iter().zip(&imported.cycles).zip(&imported.saturated)
    {
        let plate = plate.map_or_else(|| "-".into(), |kelvin| format!("{kelvin:.2} K"));
        text += &format!("  plate {plate:>10}  cycles {cycles:3}  saturated {:.2} %\n", 100.0 * saturated);
    }
    for warning in &imported.warnings {
        text += &format!("WARNING   {warning}\n");
    }
    if !assumed.is_empty() {
        text += &format!("WARNING   nothing says {}: assumed\n", assumed.join(", "));
    }
    text + &format!("written to {}\n", out.display())
}
