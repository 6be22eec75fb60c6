//! `ditd planck`: Planck's law, tables in, tables out.

use super::{CommandError, CommandResult};
use crate::tables::TextTable;
use ditd_sim::light::planck::{self, Cloud};
use std::path::PathBuf;

/// Arguments of `ditd planck`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Table with T_K and lam_um, or T_K, lam1_um and lam2_um, or lam_um, T_O_K, T_E_K and sigma_s_over_sigma_a.
    /// Without T_K the temperature is found from L_photon_per_s_m2_sr_um, j_photon_per_s_m2_um or ln_j (between two
    /// wavelengths: L_photon_per_s_m2_sr, M_photon_per_s_m2 or ln_M). `-` is standard input. Other columns are carried
    /// through
    #[arg(value_name = "FILE.csv")]
    file: PathBuf,
    /// Print a list of JSON objects instead
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2, naming the row, when the table makes no sense.
pub fn run(args: Args) -> CommandResult {
    let mut table = TextTable::read(&args.file)?;
    complete(&mut table)?;
    table.print(args.json)
}

/// Adds the columns that follow from those there are.
fn complete(table: &mut TextTable) -> CommandResult {
    let (at, between, cloud) = (table.has("lam_um"), table.has("lam1_um"), table.has("T_O_K"));
    if cloud {
        return apparent(table);
    }
    if !table.has("T_K") {
        let known = if between { &BAND_INVERSES[..] } else { &SPECTRAL_INVERSES[..] };
        if (at || between)
            && let Some(inverse) = known.iter().find(|inverse| table.has(inverse.column))
        {
            return temperatures(table, inverse, between);
        }
    }
    if at {
        spectral(table)?;
    }
    if between || !at {
        band(table)?;
    }
    Ok(())
}

/// A column that a temperature follows from, with the wavelengths [λ] or [λ₁, λ₂] in µm.
struct Inverse {
    column: &'static str,
    /// Whether the column is a logarithm: may be negative.
    logarithm: bool,
    temperature: fn([f64; 2], f64) -> Option<f64>,
}

const SPECTRAL_INVERSES: [Inverse; 3] = [
    Inverse {
        column: "L_photon_per_s_m2_sr_um",
        logarithm: false,
        temperature: |[um, _], value| planck::inverse_photon_radiance(um, value),
    },
    Inverse {
        column: "j_photon_per_s_m2_um",
        logarithm: false,
        temperature: |[um, _], value| planck::inverse_photon_exitance(um, value),
    },
    Inverse {
        column: "ln_j",
        logarithm: true,
        temperature: |[um, _], value| planck::inverse_ln_photon_exitance(um, value),
    },
];

const BAND_INVERSES: [Inverse; 3] = [
    Inverse {
        column: "L_photon_per_s_m2_sr",
        logarithm: false,
        temperature: |[a, b], value| planck::inverse_photon_radiance_band(a, b, value),
    },
    Inverse {
        column: "M_photon_per_s_m2",
        logarithm: false,
        temperature: |[a, b], value| planck::inverse_photon_exitance_band(a, b, value),
    },
    Inverse {
        column: "ln_M",
        logarithm: true,
        temperature: |[a, b], value| planck::inverse_ln_photon_exitance_band(a, b, value),
    },
];

/// Adds T_K.
fn temperatures(table: &mut TextTable, inverse: &Inverse, between: bool) -> CommandResult {
    let um: Vec<[f64; 2]> = if between {
        limits(table, false)?
    } else {
        positive(table, "lam_um", false)?.into_iter().map(|um| [um, um]).collect()
    };
    let values = table.numbers(inverse.column)?;
    let mut found = Vec::with_capacity(values.len());
    for (row, (um, value)) in um.into_iter().zip(values).enumerate() {
        let allowed = value.is_finite() && (inverse.logarithm || value > 0.0);
        let t = allowed.then(|| (inverse.temperature)(um, value)).flatten();
        let limit = if inverse.logarithm { "finite" } else { "finite and above 0" };
        let column = inverse.column;
        found.push(t.ok_or_else(|| {
            table.bad_row(
                row,
                format!("{column} = {value} has no temperature: it must be {limit}, and in reach"),
            )
        })?);
    }
    table.set("T_K", &found);
    Ok(())
}

/// The columns lam1_um and lam2_um.
fn limits(table: &TextTable, empty_allowed: bool) -> Result<Vec<[f64; 2]>, CommandError> {
    let (lam1, lam2) = (positive(table, "lam1_um", true)?, positive(table, "lam2_um", false)?);
    let bad = |row: &usize| lam1[*row] > lam2[*row] || (!empty_allowed && lam1[*row] >= lam2[*row]);
    match (0..table.len()).find(bad) {
        Some(row) => {
            let relation = if empty_allowed { "above" } else { "not below" };
            Err(table.bad_row(row, format!("lam1_um = {} is {relation} lam2_um = {}", lam1[row], lam2[row])))
        }
        None => Ok(lam1.into_iter().zip(lam2).map(|(a, b)| [a, b]).collect()),
    }
}

/// A column whose values must be finite and at or above 0 (temperatures), or above it (wavelengths).
fn positive(table: &TextTable, name: &str, with_zero: bool) -> Result<Vec<f64>, CommandError> {
    let values = table.numbers(name)?;
    let good = |value: &f64| value.is_finite() && (*value > 0.0 || (with_zero && *value == 0.0));
    match values.iter().position(|value| !good(value)) {
        Some(row) => {
            let limit = if with_zero { "not negative" } else { "above 0" };
            Err(table.bad_row(row, format!("{name} = {}: it must be finite and {limit}", values[row])))
        }
        None => Ok(values),
    }
}

/// A column and what computes it.
type Column<T> = (&'static str, fn(&T) -> f64);

fn fill<T>(table: &mut TextTable, rows: &[T], columns: &[Column<T>]) {
    for (name, compute) in columns {
        let values: Vec<f64> = rows.iter().map(compute).collect();
        table.set(name, &values);
    }
}

fn spectral(table: &mut TextTable) -> CommandResult {
    let (t, um) = (positive(table, "T_K", true)?, positive(table, "lam_um", false)?);
    let rows: Vec<(f64, f64)> = um.into_iter().zip(t).collect();
    let columns: [Column<(f64, f64)>; 6] = [
        ("x_hc_over_lkT", |r| planck::exponent(r.0, r.1)),
        ("ln_j", |r| planck::ln_photon_exitance(r.0, r.1)),
        ("j_photon_per_s_m2_um", |r| planck::photon_exitance(r.0, r.1)),
        ("dj_dT", |r| planck::d_photon_exitance_dt(r.0, r.1)),
        ("dln_j_dT", |r| planck::d_ln_photon_radiance_dt(r.0, r.1)),
        ("L_photon_per_s_m2_sr_um", |r| planck::photon_radiance(r.0, r.1)),
    ];
    fill(table, &rows, &columns);
    Ok(())
}

fn band(table: &mut TextTable) -> CommandResult {
    let t = positive(table, "T_K", true)?;
    let rows: Vec<[f64; 3]> = limits(table, true)?.into_iter().zip(t).map(|([a, b], t)| [a, b, t]).collect();
    let columns: [Column<[f64; 3]>; 6] = [
        ("ln_M", |r| planck::ln_photon_exitance_band(r[0], r[1], r[2])),
        ("M_photon_per_s_m2", |r| planck::photon_exitance_band(r[0], r[1], r[2])),
        ("L_photon_per_s_m2_sr", |r| planck::photon_radiance_band(r[0], r[1], r[2])),
        ("dM_dT", |r| planck::d_photon_exitance_band_dt(r[0], r[1], r[2])),
        ("ln_dM_dT", |r| planck::ln_d_photon_exitance_band_dt(r[0], r[1], r[2])),
        ("M_energy_W_m2", |r| planck::energy_exitance_band(r[0], r[1], r[2])),
    ];
    fill(table, &rows, &columns);
    Ok(())
}

/// Eqs 12 to 15.
fn apparent(table: &mut TextTable) -> CommandResult {
    let um = positive(table, "lam_um", false)?;
    let (object, environment) = (positive(table, "T_O_K", false)?, positive(table, "T_E_K", false)?);
    let ratio = positive(table, "sigma_s_over_sigma_a", true)?;
    let rows: Vec<Cloud> = (0..table.len())
        .map(|row| Cloud {
            wavelength_um: um[row],
            object_k: object[row],
            environment_k: environment[row],
            scattering_over_absorption: ratio[row],
        })
        .collect();
    let columns: [Column<Cloud>; 7] = [
        ("T_A_eq12_K", Cloud::apparent_temperature_k),
        ("T_A_eq13_K", Cloud::weighted_temperature_k),
        ("T_A_eq14_K", Cloud::environment_expansion_k),
        ("T_A_eq15_K", Cloud::object_expansion_k),
        ("err13_K", |cloud| cloud.weighted_temperature_k() - cloud.apparent_temperature_k()),
        ("err14_K", |cloud| cloud.environment_expansion_k() - cloud.apparent_temperature_k()),
        ("err15_K", |cloud| cloud.object_expansion_k() - cloud.apparent_temperature_k()),
    ];
    fill(table, &rows, &columns);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn completed(text: &str) -> Result<TextTable, CommandError> {
        let mut table = TextTable::parse("t", text).unwrap();
        complete(&mut table).map(|()| table)
    }

    #[test]
    fn the_columns_decide_what_is_computed() {
        let at = completed("id,T_K,lam_um\na,300,3.4\n").unwrap();
        assert!(at.has("dln_j_dT") && !at.has("ln_M"));
        // Multiprecision table, first row.
        assert!((at.numbers("j_photon_per_s_m2_um").unwrap()[0] / 1.0545733945807244e19 - 1.0).abs() < 1e-14);
        let between = completed("T_K,lam1_um,lam2_um\n300,3,5\n0,3,5\n").unwrap();
        assert!(
            (between.numbers("M_photon_per_s_m2").unwrap()[0] / 1.3141624901975726e20 - 1.0).abs() < 1e-14
        );
        assert!(between.numbers("M_photon_per_s_m2").unwrap()[1] == 0.0);
        let cloud = completed("lam_um,T_O_K,T_E_K,sigma_s_over_sigma_a\n3.4,449,400,0.7\n").unwrap();
        assert!((cloud.numbers("T_A_eq12_K").unwrap()[0] - 433.755_439_647_657_1).abs() < 1e-11);
    }

    #[test]
    fn temperatures_come_back_from_what_they_gave() {
        let at = completed("T_K,lam_um\n300,3.4\n4.2,10\n1e6,0.2\n").unwrap();
        let between = completed("T_K,lam1_um,lam2_um\n300,3,5\n1e3,0.5,500\n40,3.4,3.400000001\n").unwrap();
        let without = |table: &TextTable, wavelengths: &[&str], column: &str| {
            let names = [wavelengths, &[column]].concat();
            let columns: Vec<Vec<f64>> = names.iter().map(|name| table.numbers(name).unwrap()).collect();
            let rows = (0..table.len()).map(|row| {
                columns.iter().map(|c| format!("{:e}", c[row])).collect::<Vec<String>>().join(",")
            });
            std::iter::once(names.join(",")).chain(rows).collect::<Vec<String>>().join("\n")
        };
        for (table, wavelengths, known) in [
            (&at, &["lam_um"][..], SPECTRAL_INVERSES.map(|i| i.column)),
            (&between, &["lam1_um", "lam2_um"], BAND_INVERSES.map(|i| i.column)),
        ] {
            for column in known {
                let back = completed(&without(table, wavelengths, column)).unwrap();
                for (found, t) in back.numbers("T_K").unwrap().iter().zip(table.numbers("T_K").unwrap()) {
                    // Stated at the inverses: 30 · 2⁻⁵³, and 2⁻⁵² |ln M| for the logarithms of the hot row.
                    assert!((found / t - 1.0).abs() < 2e-14, "{column}: {found} {t}");
                }
            }
        }
    }

    #[test]
    fn what_has_no_temperature_is_named() {
        let message = |text| completed(text).unwrap_err().message;
        assert!(message("lam_um,ln_j\n3.4,10\n3.4,inf\n").starts_with("t, row 2: ln_j = inf has no temp"));
        assert!(message("lam1_um,lam2_um,M_photon_per_s_m2\n3,5,0\n").starts_with("t, row 1: M_photon"));
        assert!(message("lam1_um,lam2_um,M_photon_per_s_m2\n3,3,1\n").contains("not below lam2_um = 3"));
        assert!(message("lam_um\n3.4\n").contains("no column `T_K`"));
    }

    #[test]
    fn impossible_rows_are_named() {
        let message = |text| completed(text).unwrap_err().message;
        assert!(message("T_K,lam_um\n300,3.4\n-1,3.4\n").starts_with("t, row 2: T_K = -1"));
        assert!(message("T_K,lam_um\n300,0\n").starts_with("t, row 1: lam_um = 0"));
        assert!(message("T_K,lam1_um,lam2_um\n300,5,3\n").starts_with("t, row 1: lam1_um = 5"));
        assert!(message("T_K\n300\n").contains("no column `lam1_um`"));
    }
}
