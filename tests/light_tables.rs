//! The table commands as a user meets them: the program itself, on the reference tables, against their columns.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn reference(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/tests/data/light").join(name)
}

fn ditd(arguments: &[&str], file: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ditd")).args(arguments).arg(file).output().unwrap()
}

/// One column of a table.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let at = csv.lines().next().unwrap().split(',').position(|own| own == name).unwrap();
    csv.lines().skip(1).map(|line| line.split(',').nth(at).unwrap().parse().unwrap()).collect()
}

/// Largest relative difference of a column between the program's table and the reference.
fn difference(arguments: &[&str], file: &str, name: &str) -> f64 {
    let output = ditd(arguments, &reference(file));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found = column(&String::from_utf8(output.stdout).unwrap(), name);
    let wanted = column(&std::fs::read_to_string(reference(file)).unwrap(), name);
    assert_eq!(found.len(), wanted.len());
    let relative = |(a, b): (&f64, &f64)| if *b == 0.0 { a.abs() } else { (a / b - 1.0).abs() };
    found.iter().zip(&wanted).map(relative).fold(0.0, f64::max)
}

#[test]
fn the_program_reproduces_the_reference_tables() {
    // Relative errors. The laws are tested row by row where they are written; this is the way through the program.
    // Band: its narrowest row, 1e-12 um wide, is rounded by 1e-4 (README of the table), ln M is 19 there.
    for (arguments, file, name, allowed) in [
        (&["mie", "polydisperse"][..], "mie_polydisperse.csv", "qabs_mean", 1e-9),
        (&["planck"], "planck_spectral.csv", "ln_j", 1e-15),
        (&["planck"], "planck_band.csv", "ln_M", 1e-4),
        (&["planck"], "eq12_15.csv", "T_A_eq12_K", 1e-14),
    ] {
        let found = difference(arguments, file, name);
        assert!(found <= allowed, "{file} {name}: {found:e}");
    }
}

#[test]
fn a_bad_row_ends_with_status_2_and_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("own.csv");
    std::fs::write(&file, "x,n,k\n1,1.4,0.1\n1,1.4,-0.1\n").unwrap();
    let output = ditd(&["mie", "efficiencies"], &file);
    assert_eq!(output.status.code(), Some(2));
    assert!(output.stdout.is_empty());
    assert!(String::from_utf8_lossy(&output.stderr).contains("row 2"));
}
