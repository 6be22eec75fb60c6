//! `ditd import`: reads a CFD spray and prints its totals per time.

use super::{CommandError, CommandResult};
use ditd_sim::scene::compact;
use ditd_sim::scene::deposit::{self, DepositOptions, Smoothness};
use ditd_sim::scene::field::{CfdSpray, Totals};
use ditd_sim::scene::import::{self, ImportOptions, SceneError, Time};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Arguments of `ditd import`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The spray: an OpenFOAM case folder, EnSight Gold .case, VTK .vtm/.vtu/.vtp/.vtk, a folder with parcels.csv
    /// and cells.csv, or a .spray file
    path: PathBuf,
    /// Which time: seconds, `latest`, or `all`
    #[arg(long, default_value = "all")]
    time: String,
    /// Print JSON: {"times": [{"time_s": …}, …]}, null where the form lacks a value
    #[arg(long)]
    json: bool,
    /// Write our compact form of one time to this file
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// Name of the fuel's field (default: the only field whose name is a fuel)
    #[arg(long)]
    fuel: Option<String>,
    /// Molar mass of the fuel in kg/mol (default: by its name)
    #[arg(long, value_name = "KG_PER_MOL")]
    fuel_molar_mass: Option<f64>,
    /// Molar mass of the other gas in kg/mol
    #[arg(long, value_name = "KG_PER_MOL", default_value_t = import::NITROGEN_KG_MOL)]
    carrier_molar_mass: f64,
    /// Length in metres of the unit of length in the files (0.001 for millimetres)
    #[arg(long, value_name = "METRES", default_value_t = 1.0)]
    length_unit: f64,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 if the path is no spray, the time is not there, or `--write` is asked for several times; status 5 if
/// a file is cut off or damaged; else 1.
pub fn run(args: Args) -> CommandResult {
    let options = ImportOptions {
        fuel: args.fuel.clone(),
        fuel_molar_mass_kg_mol: args.fuel_molar_mass,
        carrier_molar_mass_kg_mol: args.carrier_molar_mass,
        length_unit_m: args.length_unit,
    };
    let times = chosen(&args.path, &args.time)?;
    if args.write.is_some() && times.len() > 1 {
        let seconds = times.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        return Err(CommandError::usage(format!(
            "--write takes one time; choose with --time from: {seconds}"
        )));
    }
    let mut totals = Vec::new();
    let mut smooth = Vec::new();
    let mut told = BTreeSet::new();
    for &time in &times {
        let spray = import::read(&args.path, Time::At(time), &options).map_err(ended)?;
        if let Some(file) = &args.write {
            write(&spray, file)?;
        }
        for note in &spray.notes {
            // The same for all times as a rule.
            if told.insert(note.clone()) {
                eprintln!("ditd: {note}");
            }
        }
        totals.push(spray.totals());
        smooth.push(deposit::smoothness(&spray, &DepositOptions::default()).map_err(ended)?);
    }
    let text = if args.json {
        let times: Vec<_> = totals.iter().zip(&smooth).map(|(t, s)| entry(t, s.as_ref())).collect();
        let json = serde_json::json!({ "times": times });
        serde_json::to_string_pretty(&json).map_err(|e| CommandError::failure(e.to_string()))? + "\n"
    } else {
        table(&totals) + &noise_table(&smooth)
    };
    super::print(&text)
}

/// A time's totals, and what the picture of its droplets will rest on; null without droplets.
fn entry(totals: &Totals, smooth: Option<&Smoothness>) -> serde_json::Value {
    let mut entry = serde_json::json!(totals);
    entry["kernel_n_eff"] = serde_json::json!(smooth.map(|s| s.n_eff));
    entry["kernel_m"] = serde_json::json!(smooth.map(|s| s.kernel_m));
    entry["split_half"] = serde_json::json!(smooth.map(|s| s.split_half));
    entry
}

fn chosen(path: &Path, asked: &str) -> Result<Vec<f64>, CommandError> {
    let times = import::list(path).map_err(ended)?;
    let latest = || {
        times
            .last()
            .copied()
            .ok_or_else(|| CommandError::usage(format!("{}: there is no time in it", path.display())))
    };
    match asked {
        "all" => latest().map(|_| times.clone()),
        "latest" => Ok(vec![latest()?]),
        _ => {
            let seconds: f64 = asked.parse().map_err(|_| {
                CommandError::usage(format!("--time {asked}: expected seconds, `latest` or `all`"))
            })?;
            Ok(vec![seconds])
        }
    }
}

fn ended(error: SceneError) -> CommandError {
    let code = match error {
        SceneError::Unknown { .. } | SceneError::Time { .. } | SceneError::Unsupported { .. } => 2,
        SceneError::Malformed { .. } | SceneError::Checksum { .. } | SceneError::Length { .. } => 5,
        SceneError::Access { .. } | SceneError::Missing { .. } | SceneError::Deposit { .. } => 1,
    };
    CommandError { code, message: format!("import: {error}") }
}

/// Writes beside the target and renames, so that a cut-off run leaves no half file under the asked name.
fn write(spray: &CfdSpray, file: &Path) -> CommandResult {
    let failed = |doing: &str, e: std::io::Error| {
        CommandError::failure(format!("import: {doing} {}: {e}", file.display()))
    };
    let bytes = compact::pack(spray);
    let mut beside = file.as_os_str().to_owned();
    beside.push(".part");
    std::fs::write(&beside, &bytes).map_err(|e| failed("writing", e))?;
    std::fs::rename(&beside, file).map_err(|e| failed("renaming to", e))?;
    eprintln!("wrote {} ({} bytes)", file.display(), bytes.len());
    Ok(())
}

/// One column per time.
fn table(totals: &[Totals]) -> String {
    let mut text = String::new();
    row(&mut text, "time ms", totals, |t| Some(1e3 * t.time_s));
    row(&mut text, "parcels", totals, |t| t.parcels.map(|n| n as f64));
    row(&mut text, "  of them junk", totals, |t| t.junk_parcels.map(|n| n as f64));
    row(&mut text, "droplets", totals, |t| t.droplets);
    row(&mut text, "liquid mg", totals, |t| t.liquid_mass_kg.map(|m| 1e6 * m));
    row(&mut text, "area of droplets mm²", totals, |t| t.geometric_area_m2.map(|a| 1e6 * a));
    row(&mut text, "D10 µm", totals, |t| t.d10_um);
    row(&mut text, "D32 µm", totals, |t| t.d32_um);
    row(&mut text, "d min µm", totals, |t| t.d_min_um);
    row(&mut text, "d max µm", totals, |t| t.d_max_um);
    row(&mut text, "T liquid min K", totals, |t| t.t_liquid_min_k);
    row(&mut text, "T liquid mean K", totals, |t| t.t_liquid_mean_k);
    row(&mut text, "T liquid max K", totals, |t| t.t_liquid_max_k);
    row(&mut text, "N_eff of 1 mm voxels", totals, |t| t.n_eff);
    row(&mut text, "gas cells", totals, |t| t.cells.map(|n| n as f64));
    row(&mut text, "gas volume cm³", totals, |t| t.gas_volume_m3.map(|v| 1e6 * v));
    row(&mut text, "vapour mg", totals, |t| t.vapour_mass_kg.map(|m| 1e6 * m));
    row(&mut text, "T gas min K", totals, |t| t.t_gas_min_k);
    row(&mut text, "T gas vapour mean K", totals, |t| t.t_gas_vapour_mean_k);
    row(&mut text, "T gas max K", totals, |t| t.t_gas_max_k);
    text
}

/// How the droplets will be smoothed, and the difference of two halves of the parcels in transmission.
fn noise_table(smooth: &[Option<Smoothness>]) -> String {
    let mut text = String::new();
    let of = |value: fn(&Smoothness) -> f64| move |s: &Option<Smoothness>| s.as_ref().map(value);
    row(&mut text, "kernel mm", smooth, of(|s| 1e3 * s.kernel_m));
    row(&mut text, "N_eff of kernels", smooth, of(|s| s.n_eff));
    row(&mut text, "halves differ along x", smooth, of(|s| s.split_half[0]));
    row(&mut text, "halves differ along y", smooth, of(|s| s.split_half[1]));
    row(&mut text, "halves differ along z", smooth, of(|s| s.split_half[2]));
    text
}

fn row<T>(text: &mut String, name: &str, totals: &[T], value: impl Fn(&T) -> Option<f64>) {
    let padding = 22_usize.saturating_sub(name.chars().count());
    text.push_str(name);
    text.push_str(&" ".repeat(padding));
    for one in totals {
        let cell = match value(one) {
            None => "-".to_owned(),
            Some(v) if v.fract().abs() < 1e-12 && v.abs() < 1e9 => format!("{v:.0}"),
            Some(v) if v != 0.0 && !(1e-3..1e6).contains(&v.abs()) => format!("{v:.5e}"),
            Some(v) => format!("{v:.4}"),
        };
        text.push_str(&format!(" {cell:>13}"));
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(path: &Path, time: &str) -> Args {
        Args {
            path: path.to_owned(),
            time: time.into(),
            json: true,
            write: None,
            fuel: None,
            fuel_molar_mass: None,
            carrier_molar_mass: import::NITROGEN_KG_MOL,
            length_unit: 1.0,
        }
    }

    #[test]
    fn a_written_spray_is_read_again_and_wrong_requests_end_with_status_2() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("x.spray");
        write(&compact::shipped().unwrap(), &file).unwrap();
        assert_eq!(chosen(&file, "all").unwrap().len(), 1);
        assert!((chosen(&file, "latest").unwrap()[0] - 0.0009).abs() < 1e-12);
        assert_eq!(chosen(&file, "soon").unwrap_err().code, 2);
        assert_eq!(run(args(&file, "0.5")).unwrap_err().code, 2);
        assert_eq!(run(args(folder.path(), "all")).unwrap_err().code, 2);
        let mut bytes = std::fs::read(&file).unwrap();
        bytes.truncate(1000);
        std::fs::write(&file, bytes).unwrap();
        assert_eq!(run(args(&file, "all")).unwrap_err().code, 5);
    }

    #[test]
    fn every_key_is_there_and_null_where_the_form_lacks_it() {
        let mut spray = compact::shipped().unwrap();
        spray.cells = None;
        let smooth = deposit::smoothness(&spray, &DepositOptions::default()).unwrap();
        let json = entry(&spray.totals(), smooth.as_ref());
        let keys = [
            "kernel_n_eff",
            "kernel_m",
            "split_half",
            "time_s",
            "parcels",
            "junk_parcels",
            "droplets",
            "liquid_mass_kg",
            "d10_um",
            "d32_um",
            "d_min_um",
            "d_max_um",
            "t_liquid_min_k",
            "t_liquid_max_k",
            "cells",
            "vapour_mass_kg",
            "t_gas_min_k",
            "t_gas_max_k",
            "n_eff",
            "geometric_area_m2",
        ];
        for key in keys {
            let value = json.get(key).unwrap_or_else(|| panic!("{key} is missing"));
            let is_gas = matches!(key, "cells" | "vapour_mass_kg" | "t_gas_min_k" | "t_gas_max_k");
            assert_eq!(value.is_null(), is_gas, "{key}");
        }
    }

    #[test]
    fn the_table_has_a_column_per_time_and_a_dash_for_nothing() {
        let mut spray = compact::shipped().unwrap();
        let whole = spray.totals();
        spray.cells = None;
        let text = table(&[whole, spray.totals()]);
        let vapour = text.lines().find(|l| l.starts_with("vapour mg")).unwrap();
        assert_eq!(vapour.split_whitespace().collect::<Vec<_>>(), ["vapour", "mg", "6.6823", "-"]);
    }
}
