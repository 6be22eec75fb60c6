//! What `ditd fit` and `ditd check` can tell beyond the map: walls' light taken out, convergence, expected σ of T.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::estimate::calibration::{CalibrationPoint, OffsetMode, SakumaHattori, fit_curve};
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

/// A fitted curve whose points demand a residual is taken with it: x of every level and every temperature follow
/// `CalibrationFit`, which the uncertainty budget follows as well. Without it temperatures would be off by kelvins.
#[test]
fn stacks_take_a_fitted_curve_with_its_residual() {
    let dir = tempfile::tempdir().unwrap();
    let curve = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
    // A camera that is not linear: a quarter less at the hot end.
    let points: Vec<CalibrationPoint> = (0..12)
        .map(|k| {
            let temperature_k = 350.0 + 17.0 * f64::from(k);
            let counts = curve.value(temperature_k);
            let bent = counts * (1.0 - 0.3 * counts / (counts + 60.0));
            CalibrationPoint { temperature_k, counts: bent, sigma_counts: 0.02 }
        })
        .collect();
    let fit = fit_curve(&points, OffsetMode::Known(0.0)).unwrap();
    assert!(fit.residual.is_some());
    let file = dir.path().join("calibration.json");
    std::fs::write(&file, serde_json::to_string(&fit).unwrap()).unwrap();
    let out = dir.path().join("map");
    let told = ditd(&[
        "fit",
        &stack(),
        "--estimator",
        "ols",
        "--calibration",
        file.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(told.status.success());
    let summary: Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    for (level, plate_k) in [373.0, 403.0, 433.0, 463.0, 498.0, 533.0].into_iter().enumerate() {
        let x = summary["inputs"]["x_counts"][level].as_f64().unwrap();
        assert!((x - 0.95 * fit.counts(plate_k)).abs() < 1e-9, "{plate_k}");
    }
    let map = out.join("dit.npz");
    let (crossing, kelvin) = (plane(&map, "crossing"), plane(&map, "temperature_k"));
    let (mut seen, mut bent) = (0, 0.0_f64);
    for (crossing, kelvin) in crossing.iter().zip(&kelvin).filter(|(_, kelvin)| kelvin.is_finite()) {
        assert!((fit.temperature(0.99 * crossing) - kelvin).abs() < 1e-6, "{crossing} {kelvin}");
        bent = bent.max((fit.curve.inverse(0.99 * crossing) - kelvin).abs());
        seen += 1;
    }
    assert!(seen > 10 && bent > 0.1, "{seen} {bent}");
}
