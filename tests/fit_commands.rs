//! What `ditd fit` and `ditd check` can tell beyond the map: walls' light taken out, convergence, expected σ of T.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::files::npz;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn ditd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ditd")).args(arguments).output().unwrap()
}

fn stack() -> String {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/fit/fig5_like");
    path.to_str().unwrap().to_owned()
}

fn plane(path: &Path, name: &str) -> Vec<f64> {
    let arrays = npz::read(path).unwrap();
    arrays.iter().find(|(found, _)| found == name).unwrap().1.to_f64()
}

/// No share changes nothing; walls that are hotter than the spray leave it colder; without their temperature or with
/// an impossible share nothing is done.
#[test]
fn walls_are_taken_out_only_when_asked_for_and_known() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("map");
    let fit = |more: &[&str]| {
        let stack = stack();
        let out = out.to_str().unwrap();
        ditd(&[&["fit", &stack, "--out", out], more].concat())
    };
    assert!(fit(&[]).status.success() && !out.join("object.npz").exists());
    assert!(fit(&["--wall-share", "0", "--wall-temperature", "523"]).status.success());
    let seen = plane(&out.join("dit.npz"), "temperature_k");
    let same = plane(&out.join("object.npz"), "temperature_object_k");
    for (seen, same) in seen.iter().zip(&same) {
        assert!((seen - same).abs() < 1e-9 || (seen.is_nan() && same.is_nan()));
    }
    let told = fit(&["--wall-share", "0.05", "--wall-temperature", "523", "--wall-share-is-bound"]);
    assert!(String::from_utf8(told.stdout).unwrap().contains("UPPER BOUND"));
    let colder = plane(&out.join("object.npz"), "temperature_object_k");
    let lower = seen.iter().zip(&colder).filter(|(seen, own)| own < seen).count();
    let finite = seen.iter().filter(|t| t.is_finite() && **t < 520.0).count();
    assert!(lower * 10 > finite * 9, "{lower} of {finite}");
    assert_eq!(fit(&["--wall-share", "0.05"]).status.code(), Some(2));
    assert_eq!(fit(&["--wall-share", "1.5", "--wall-temperature", "523"]).status.code(), Some(2));
    assert_eq!(fit(&["--wall-share", "missing.exr", "--wall-temperature", "523"]).status.code(), Some(2));
}

/// Six cycles make six lines; the last is the map itself, and a cycle matters less and less.
#[test]
fn a_map_settles_with_the_number_of_cycles() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    assert!(ditd(&["fit", &stack(), "--out", out, "--convergence"]).status.success());
    let text = std::fs::read_to_string(dir.path().join("convergence.csv")).unwrap();
    let lines: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect())
        .collect();
    assert_eq!(lines.len(), 6);
    assert!(lines[0][3].is_nan() && lines[5][2].abs() < 1e-12 && lines[5][0] > 5.5);
    assert!(lines[5][3] < lines[1][3] && lines[4][2] < lines[0][2]);
    // Independent cycles: from five to six the map moves by σ₆·√(1/5) or so; a factor of two for what σ means here.
    let ratio = lines[5][3] / (lines[5][4] * (1.0_f64 / 5.0).sqrt());
    assert!((0.5..2.0).contains(&ratio), "{ratio}");
}

/// A simulated rig knows its curve and its law of shots, so `check` can say what the plan will bring: more for denser
/// sprays.
#[test]
fn check_tells_what_a_plan_will_bring() {
    let told = ditd(&["check", "quickstart", "--json"]);
    assert!(told.status.success());
    let told: Value = serde_json::from_slice(&told.stdout).unwrap();
    let expected = &told["expected"];
    assert_eq!(expected["assumed"], Value::Bool(false));
    let rows = expected["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 3);
    for row in rows {
        let sigmas: Vec<f64> =
            row["sigma_k"].as_array().unwrap().iter().map(|pair| pair[1].as_f64().unwrap()).collect();
        assert!(sigmas.iter().all(|sigma| (0.05..30.0).contains(sigma)), "{sigmas:?}");
        assert!(sigmas[0] > sigmas[1] && sigmas[1] > sigmas[2], "{sigmas:?}");
    }
    let words = String::from_utf8(ditd(&["check", "quickstart"]).stdout).unwrap();
    assert!(words.contains("Expected σ of T"));
}
