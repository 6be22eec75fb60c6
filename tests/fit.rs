//! The fit against reference numbers that another program made (see `tests/data/fit/README.md`): means, variances,
//! unweighted and weighted lines of whole stacks, 60-digit lines, and the calibration.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::commands::fit;
use ditd::estimate::calibration::{self, CalibrationPoint, OffsetMode};
use ditd::estimate::map::{Estimator, flag};
use ditd::files::{self, npy, npz};
use ditd::stack::Stack;
use serde_json::Value;
use std::path::{Path, PathBuf};

const STACKS: [&str; 5] =
    ["fig5_like", "saturated_dead", "single_pair", "strong_scatter_drift", "two_setpoints"];

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/fit").join(name)
}

fn expected(name: &str, file: &str) -> npy::Array {
    npy::read(&folder(name).join(file)).unwrap()
}

fn close(got: f64, want: f64, relative: f64, absolute: f64) -> bool {
    (got.is_nan() && want.is_nan()) || (got - want).abs() <= relative * want.abs() + absolute || {
        // Infinities of one sign are alike.
        got.is_infinite() && want.is_infinite() && got.signum().total_cmp(&want.signum()).is_eq()
    }
}

/// README, tolerances: slope, offset, ε 1e-10 relative (1e-12 absolute near zero), T and σ_T 1e-8 where ε is
/// significant; elsewhere the answers are finite in the same pixels.
fn compare(name: &str, estimator: Estimator, file: &str) {
    let mut stack = Stack::open(&folder(name)).unwrap();
    let inputs = stack.inputs(estimator);
    let map = stack.fit(&inputs).unwrap().map;
    let want = expected(name, file);
    let pixels = map.rows * map.columns;
    assert_eq!(want.shape, [8, map.rows, map.columns]);
    let want = want.to_f64();
    let want = |row: usize, i: usize| want[row * pixels + i];
    let got = [
        &map.slope,
        &map.offset,
        &map.crossing,
        &map.emissivity,
        &map.temperature_k,
        &map.sigma_emissivity,
        &map.sigma_temperature_k,
        &map.chi2,
    ];
    for i in 0..pixels {
        let say = |row: usize| {
            let (value, wanted) = (got[row][i], want(row, i));
            format!(
                "{name} {estimator:?} row {row} pixel {i}: {value:e} for {wanted:e}, flags {:b}",
                map.flags[i]
            )
        };
        if want(0, i).is_nan() {
            // Fewer than two levels: everything is NaN (the reference leaves 0 and infinities in some rows).
            assert!(
                map.flags[i] & flag::TOO_FEW_LEVELS != 0 && got.iter().all(|row| row[i].is_nan()),
                "{}",
                say(0)
            );
            continue;
        }
        for row in [0, 1, 3, 5, 7] {
            assert!(close(got[row][i], want(row, i), 1e-10, 1e-12), "{}", say(row));
        }
        if want(3, i).abs() > 3.0 * want(5, i) || (want(5, i).is_nan() && want(3, i).abs() > 0.2) {
            for row in [2, 4, 6] {
                assert!(close(got[row][i], want(row, i), 1e-8, 1e-8), "{}", say(row));
            }
        } else if want(0, i).abs() > 1e-12 {
            // A slope below that is zero but for rounding, and its crossing arbitrary.
            assert_eq!(got[4][i].is_finite(), want(4, i).is_finite(), "{}", say(4));
            assert_eq!(got[6][i].is_finite(), want(6, i).is_finite(), "{}", say(6));
        }
    }
    let count = expected(name, "expected_count.npy").to_f64();
    assert!(
        map.count.iter().zip(&count).all(|(&got, want)| f64::from(got).total_cmp(want).is_eq()),
        "{name}: counts"
    );
    if estimator == Estimator::Paper {
        let fell = expected(name, "expected_wls_fell_back.npy").to_f64();
        for (i, (flags, fell)) in map.flags.iter().zip(fell).enumerate() {
            let none = flags & flag::TOO_FEW_LEVELS != 0;
            assert!(
                none || (flags & flag::FELL_BACK_TO_OLS != 0) == (fell > 0.5),
                "{name} pixel {i}: {flags:b}"
            );
        }
    }
}

#[test]
fn stacks_agree_with_unweighted_reference() {
    for name in STACKS {
        compare(name, Estimator::Ols, "expected_ols.npy");
    }
}

#[test]
fn stacks_agree_with_the_papers_weights() {
    for name in STACKS {
        compare(name, Estimator::Paper, "expected_wls.npy");
    }
}

fn number(value: &Value) -> f64 {
    match value {
        Value::String(text) => text.parse().unwrap(),
        Value::Null => f64::NAN,
        other => other.as_f64().unwrap(),
    }
}

/// README: 1e-12 relative, 1e-11 for weights 1e12 apart, 1e-9 for the slope on a large pedestal; kinds exactly.
/// χ² of points that lie on their line is mere rounding of the decimal x and y: its bound is Σ (4 ulp of |y| and of
/// |slope x|)²/σ² and the cross term.
#[test]
fn lines_agree_with_sixty_digits() {
    let text = std::fs::read_to_string(folder("exact_lines.json")).unwrap();
    let want: Value = serde_json::from_str(&text).unwrap();
    let got = fit::lines(&text).unwrap();
    let (got, want) = (got["cases"].as_array().unwrap(), want["cases"].as_array().unwrap());
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(want) {
        let name = want["name"].as_str().unwrap();
        let bound = match name {
            "weights_1e12_apart" => 1e-11,
            "large_offset" | "nearly_equal_x" => 1e-9,
            _ => 1e-12,
        };
        for key in [
            "slope",
            "offset",
            "crossing",
            "var_slope",
            "var_offset",
            "cov_slope_offset",
            "var_crossing",
            "eps",
            "T",
        ] {
            let (g, w) = (number(&got[key]), number(&want[key]));
            assert!(close(g, w, bound, 0.0), "{name} {key}: {g:e} for {w:e}: {:e}", (g / w - 1.0).abs());
        }
        let (g, w) = (number(&got["chi2"]), number(&want["chi2"]));
        let each = |key: &str| want[key].as_array().unwrap().iter().map(number).collect::<Vec<_>>();
        let slope = number(&want["slope"]);
        let ulp = |x: f64, y: f64| 4.0 * f64::EPSILON * (y.abs() + (slope * x).abs());
        let points = each("x").into_iter().zip(each("y")).zip(each("var"));
        let rounding: f64 = points.map(|((x, y), v)| ulp(x, y).powi(2) / v).sum();
        assert!(
            (g - w).abs() <= bound * w + rounding + 2.0 * (rounding * w).sqrt(),
            "{name} chi2: {g:e} for {w:e}"
        );
        for (t, set) in want["fieller"].as_object().unwrap() {
            assert_eq!(got["fieller"][t]["kind"], set["kind"], "{name} {t}");
            for end in ["lo", "hi"] {
                if let Some(w) = set.get(end) {
                    let (g, w) = (number(&got["fieller"][t][end]), number(w));
                    assert!(
                        close(g, w, bound, 0.0),
                        "{name} {t} {end}: {g:e} for {w:e}: {:e}",
                        (g / w - 1.0).abs()
                    );
                }
            }
        }
    }
}

fn points(curve: &Value) -> Vec<CalibrationPoint> {
    let column = |name: &str| curve[name].as_array().unwrap().iter().map(number).collect::<Vec<_>>();
    let (t, counts, sigma) = (column("T_K"), column("counts"), column("sigma"));
    (0..t.len())
        .map(|i| CalibrationPoint { temperature_k: t[i], counts: counts[i], sigma_counts: sigma[i] })
        .collect()
}

/// The standard curve of 25 noisy points gives queries within 0.15 K rms where straight interpolation errs by 0.26 K,
/// and the short current curve maps on it within four standard deviations.
#[test]
fn calibration_gives_queries_their_temperatures() {
    let text = std::fs::read_to_string(folder("calibration.json")).unwrap();
    let file: Value = serde_json::from_str(&text).unwrap();
    let fit = calibration::fit_curve(&points(&file["standard"]), OffsetMode::Known(0.0)).unwrap();
    assert!(fit.chi2 / 22.0 < 2.0, "chi2 {}", fit.chi2);
    let column = |name: &str| file["query"][name].as_array().unwrap().iter().map(number).collect::<Vec<_>>();
    let (counts, truth, linear) = (column("counts"), column("true_T_K"), column("linear_interp_T"));
    let rms = |got: &dyn Fn(usize) -> f64| {
        let squares: f64 = (0..truth.len()).map(|i| (got(i) - truth[i]).powi(2)).sum();
        (squares / f64::from(u32::try_from(truth.len()).unwrap())).sqrt()
    };
    let ours = rms(&|i| fit.curve.inverse(counts[i]));
    eprintln!("calibration: ours {ours:.4} K rms, linear {:.4} K rms", rms(&|i| linear[i]));
    assert!(ours < 0.15);
    let mapping = calibration::map_on_standard(&fit.curve, &points(&file["current"])).unwrap();
    let off = [
        (mapping.gain - number(&file["current"]["true_gain"])) / mapping.covariance[0][0].sqrt(),
        (mapping.offset_counts - number(&file["current"]["true_offset"])) / mapping.covariance[1][1].sqrt(),
    ];
    assert!(off.iter().all(|o| o.abs() < 4.0), "{off:?}");
    let json = serde_json::to_string(&fit).unwrap();
    assert_eq!(serde_json::from_str::<calibration::CalibrationFit>(&json).unwrap(), fit);
}

/// The written files hold the map, twice the same bytes, for any number of threads.
#[test]
fn results_are_the_same_bytes_for_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let mut all: Vec<Vec<(String, Vec<u8>)>> = Vec::new();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let out = dir.path().join(threads.to_string());
        pool.install(|| {
            let mut stack = Stack::open(&folder("strong_scatter_drift")).unwrap();
            let inputs = stack.inputs(Estimator::Default);
            let fitted = stack.fit(&inputs).unwrap();
            let meta = files::ResultMeta { title: stack.case.name.clone(), more: Value::Null };
            files::write_result(&out, &fitted.map, &meta).unwrap();
        });
        let mut written: Vec<(String, Vec<u8>)> = std::fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .map(|path| {
                (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap())
            })
            .collect();
        written.sort();
        all.push(written);
    }
    assert!(all[0] == all[1]);
    let names: Vec<&str> = all[0].iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        [
            "dit.exr",
            "dit.npz",
            "preview_emissivity.png",
            "preview_flags.png",
            "preview_sigma_temperature.png",
            "preview_temperature.png",
            "temperature_k.tif"
        ]
    );
    let arrays = npz::read(&dir.path().join("1/dit.npz")).unwrap();
    let count = arrays.iter().find(|(name, _)| name == "count").unwrap();
    assert_eq!(count.1.shape.len(), 3);
    assert!(arrays.iter().any(|(name, _)| name == "temperature_low_k"));
}

/// Our estimator against the truth of the reference stacks: better than both of the others on strong scatter.
#[test]
fn default_beats_the_other_weights_on_strong_scatter() {
    let name = "strong_scatter_drift";
    let truth = expected(name, "truth_eps_T.npy").to_f64();
    let rmse = |estimator: Estimator| {
        let mut stack = Stack::open(&folder(name)).unwrap();
        let inputs = stack.inputs(estimator);
        let map = stack.fit(&inputs).unwrap().map;
        let pixels = map.rows * map.columns;
        let off: Vec<f64> = (0..pixels)
            .filter(|&i| truth[i] > 0.2)
            .map(|i| map.temperature_k[i] - truth[pixels + i])
            .collect();
        assert!(off.iter().all(|o| o.is_finite()));
        (off.iter().map(|o| o * o).sum::<f64>() / f64::from(u32::try_from(off.len()).unwrap())).sqrt()
    };
    let (ours, paper, ols) = (rmse(Estimator::Default), rmse(Estimator::Paper), rmse(Estimator::Ols));
    eprintln!("strong scatter, rmse of T: default {ours:.3} K, paper {paper:.3} K, ols {ols:.3} K");
    assert!(ours < 2.5 && ours < paper && ours < ols, "{ours} {paper} {ols}");
}

/// A frame without spray among ten is found, named in the summary, and does not move the map.
#[test]
fn misfires_are_taken_out() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder("fig5_like");
    for file in ["case.json", "nospray.npy"] {
        std::fs::copy(source.join(file), dir.path().join(file)).unwrap();
    }
    let mut spray = npy::read(&source.join("spray.npy")).unwrap();
    let blank = npy::read(&source.join("nospray.npy")).unwrap();
    let (npy::Values::U16(spray_counts), npy::Values::U16(blank_counts)) = (&mut spray.values, &blank.values)
    else {
        panic!("u16")
    };
    // Cycle 3 of level 5 shows its own blank.
    let pixels = spray.shape[1] * spray.shape[2];
    let frame = (5 * 6 + 3) * pixels..(5 * 6 + 4) * pixels;
    spray_counts[frame.clone()].copy_from_slice(&blank_counts[frame]);
    npy::write(&dir.path().join("spray.npy"), &spray).unwrap();
    let fit = |dir: &Path| {
        let mut stack = Stack::open(dir).unwrap();
        let inputs = stack.inputs(Estimator::Default);
        stack.fit(&inputs).unwrap()
    };
    let (with, without) = (fit(dir.path()), fit(&source));
    assert_eq!(with.levels[5].rejected.len(), 1);
    assert_eq!((with.levels[5].rejected[0].cycle, with.levels[5].accepted), (3, 5));
    assert!(without.levels.iter().all(|level| level.rejected.is_empty()));
    let mut off: Vec<f64> =
        (0..pixels).map(|i| (with.map.emissivity[i] - without.map.emissivity[i]).abs()).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[pixels / 2] < 0.01, "{}", off[pixels / 2]);
}

/// The gates of our own estimator take nothing out of clean stacks, whatever else is wrong with their pixels.
#[test]
fn clean_stacks_lose_no_sample() {
    for name in STACKS {
        let mut stack = Stack::open(&folder(name)).unwrap();
        let inputs = stack.inputs(Estimator::Default);
        let fitted = stack.fit(&inputs).unwrap();
        let count = expected(name, "expected_count.npy").to_f64();
        let same =
            fitted.map.count.iter().zip(&count).all(|(&got, want)| f64::from(got).total_cmp(want).is_eq());
        assert!(same && fitted.map.rejected.is_empty(), "{name}");
        assert!(fitted.levels.iter().all(|level| level.rejected.is_empty() && level.spike_samples == 0));
    }
}

/// A stack says in words and in its summary that its sigmas are statistical and what nobody knows; a fitted curve brings
/// its own part, which vanishes with the points' noise, and is then not among the unknown.
#[test]
fn stacks_say_what_their_sigmas_hold() {
    let dir = tempfile::tempdir().unwrap();
    let stack = folder("fig5_like");
    let run = |more: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_ditd"));
        let out = command.arg("fit").arg(&stack).arg("--out").arg(dir.path()).args(more).output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stdout).unwrap()
    };
    let summary = |more: &[&str]| serde_json::from_str::<Value>(&run(more)).unwrap();
    let bare = summary(&["--json"]);
    let unknown = ["calibration", "windows", "plate emissivity and uniformity", "plate reading"];
    assert_eq!(bare["budget"]["not_in_it"], serde_json::json!(unknown));
    assert_eq!(bare["budget"]["systematic"], serde_json::json!([]));
    let told = run(&[]);
    assert!(told.contains("statistical") && unknown.iter().all(|what| told.contains(what)), "{told}");

    let case = Stack::open(&stack).unwrap().case;
    let curve = case.calibration.unwrap().curve();
    let mut medians = Vec::new();
    for noise in [1e-3, 1e-5] {
        let points: Vec<CalibrationPoint> = (0..10)
            .map(|i| {
                let temperature_k = 360.0 + 20.0 * f64::from(i);
                let counts = curve.value(temperature_k);
                CalibrationPoint { temperature_k, counts, sigma_counts: noise * counts }
            })
            .collect();
        let fitted = calibration::fit_curve(&points, OffsetMode::Known(0.0)).unwrap();
        let file = dir.path().join("curve.json");
        std::fs::write(&file, serde_json::to_string(&fitted).unwrap()).unwrap();
        let file = file.to_str().unwrap();
        let known = summary(&["--json", "--calibration", file]);
        assert_eq!(known["budget"]["not_in_it"], serde_json::json!(unknown[1..]));
        let median = |name: &str| known["budget"]["median_k"][name].as_f64().unwrap();
        let (part, total) = (median("sigma_t_calibration_k"), median("sigma_t_total_k"));
        assert!(part > 0.0 && total >= part, "{part} {total}");
        assert!(run(&["--calibration", file]).contains("the calibration curve"));
        medians.push(part);
    }
    assert!(medians[1] < 0.1 * medians[0], "{medians:?}");
}
