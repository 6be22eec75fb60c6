//! The inverse Abel transform against PyAbel and against analytic pairs (`docs/peers/abel_pairs.py` made the numbers), with
//! noise, and on the command line.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::estimate::abel::{Columns, Elements, Inverted, Method, Settings, Strength, emission, invert};
use ditd::estimate::calibration::SakumaHattori;
use ditd::files::npy::{self, Array, Values};
use ditd::files::npz;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn pairs() -> Value {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/abel/pairs.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// Both halves of a profile: an axis on a pixel, or between two.
fn mirrored(half: &[f64], shared: bool) -> Vec<f64> {
    half.iter().rev().take(half.len() - usize::from(shared)).chain(half).copied().collect()
}

fn run(columns: &[f64], method: Method, strength: Strength, pixel_m: f64) -> Inverted {
    run_of(Elements::Linear, columns, method, strength, pixel_m)
}

fn run_of(elements: Elements, columns: &[f64], method: Method, strength: Strength, pixel_m: f64) -> Inverted {
    let image = Columns { values: columns, sigmas: None, rows: 1, columns: columns.len() };
    invert(&image, &Settings { method, elements, strength, centre: None, pixel_m, weighted: false }).unwrap()
}

/// Each pair with its columns on an odd width and the size of a pixel.
fn odd_pairs(all: &Value) -> impl Iterator<Item = (&Value, Vec<f64>, f64)> {
    let pairs = all["pairs"].as_array().expect("a list of pairs");
    pairs.iter().map(|pair| {
        let odd = &pair["odd"];
        (pair, mirrored(&numbers(&odd["p"]), true), odd["dr"].as_f64().expect("the size of a pixel"))
    })
}

/// The same operators as PyAbel: the axis is found, and every radius agrees to the digits of the file; the strengths that
/// are searched for start at 1e-6 instead of none. Hansen and Law's first order differs from PyAbel's zeroth.
#[test]
fn operators_are_those_of_pyabel() {
    let all = pairs();
    for (pair, columns, dr) in odd_pairs(&all) {
        let cases = [
            ("three_point", Method::ThreePoint, Strength::Automatic, 1e-9),
            ("onion_peeling", Method::OnionPeeling, Strength::Automatic, 1e-9),
            ("daun", Method::Daun, Strength::Fixed(0.0), 1e-9),
            ("daun", Method::Daun, Strength::Automatic, 1e-6),
            ("daun_100", Method::Daun, Strength::Fixed(100.0), 1e-9),
            ("basex", Method::Basex, Strength::Fixed(0.0), 1e-8),
            ("basex", Method::Basex, Strength::Automatic, 1e-6),
            ("basex_10", Method::Basex, Strength::Fixed(10.0), 1e-8),
        ];
        for (name, method, strength, bound) in cases {
            let found = run(&columns, method, strength, dr);
            let wanted = mirrored(&numbers(&pair["methods"][name]), true);
            assert!((found.axis.column - 40.0).abs() < 1e-12);
            let scale = wanted.iter().fold(1.0_f64, |a, v| a.max(v.abs()));
            for (got, want) in found.alpha_per_m.iter().zip(&wanted) {
                let close = (got - want).abs() < bound * scale;
                assert!(close, "{} {name} {strength:?}: {got} {want}", pair["name"]);
            }
        }
    }
}

/// Daun's elements of every degree, with and without a strength, are PyAbel's; so is Hansen and Law's recursion of the first
/// order (`hold_order = 1`) but on the axis and at the last two radii, which PyAbel repeats from their neighbours. Degree 3 is
/// good to 1e-8 there: PyAbel's closed forms cancel.
#[test]
fn elements_of_every_degree_are_those_of_pyabel() {
    let all = pairs();
    for (pair, columns, dr) in odd_pairs(&all) {
        let cases = [
            ("daun_degree_0", Elements::Steps, 0.0, 1e-9),
            ("daun", Elements::Linear, 0.0, 1e-9),
            ("daun_degree_2", Elements::Quadratic, 0.0, 1e-9),
            ("daun_degree_3", Elements::Cubic, 0.0, 1e-8),
            ("daun_degree_3_100", Elements::Cubic, 100.0, 1e-8),
        ];
        for (name, elements, strength, bound) in cases {
            let found = run_of(elements, &columns, Method::Daun, Strength::Fixed(strength), dr);
            let wanted = mirrored(&numbers(&pair["methods"][name]), true);
            let scale = wanted.iter().fold(1.0_f64, |a, v| a.max(v.abs()));
            for (got, want) in found.alpha_per_m.iter().zip(&wanted) {
                assert!((got - want).abs() < bound * scale, "{} {name}: {got} {want}", pair["name"]);
            }
        }
        let found = run(&columns, Method::HansenLaw, Strength::Automatic, dr);
        let wanted = numbers(&pair["methods"]["hansenlaw"]);
        let scale = wanted.iter().fold(1.0_f64, |a, v| a.max(v.abs()));
        for (i, want) in wanted.iter().enumerate().take(wanted.len() - 2).skip(1) {
            let got = found.alpha_per_m[wanted.len() - 1 + i];
            assert!((got - want).abs() < 1e-9 * scale, "{} hansenlaw {i}: {got} {want}", pair["name"]);
        }
    }
}

/// Against the analytic coefficient, rms over 95 % of the radii, for odd and even widths. Bounds: a pixel is 1/40 of the
/// radius; a profile that bends on a scale of a tenth errs by (1/4)²/8 of its height or less; profile 5 is a disc
/// with a sharp edge, which cosines ring about and whose derivative Hansen and Law's recursion has no outer neighbour for.
#[test]
fn analytic_pairs_are_found_on_odd_and_even_widths() {
    let all = pairs();
    for pair in all["pairs"].as_array().unwrap() {
        for (kind, shared) in [("odd", true), ("even", false)] {
            let columns = mirrored(&numbers(&pair[kind]["p"]), shared);
            let truth = mirrored(&numbers(&pair[kind]["f"]), shared);
            let dr = pair[kind]["dr"].as_f64().unwrap();
            for method in Method::ALL {
                let found = run(&columns, method, Strength::Automatic, dr);
                let bound = match (method, pair["name"].as_str().unwrap()) {
                    (Method::Fourier, "profile5") => 0.1,
                    (Method::HansenLaw, "profile5") => 0.15,
                    (_, "profile5") => 0.03,
                    _ => 0.008,
                };
                let cut = columns.len() / 40;
                let inner = cut..columns.len() - cut;
                let square: f64 = inner.clone().map(|i| (found.alpha_per_m[i] - truth[i]).powi(2)).sum();
                #[expect(clippy::cast_precision_loss, reason = "a few pixels")]
                let rms = (square / inner.len() as f64).sqrt();
                assert!(rms < bound, "{} {kind} {}: {rms}", pair["name"], method.name());
            }
        }
    }
}

/// A hollow profile r²·exp(−r²/s²) with a hundredth of its largest column as noise: the Fourier method, its number of
/// cosines chosen by the data alone or with σ given, errs by a hundredth at most, and Dasch's by ten times more. Its
/// σ tells the noise: squared errors of the linear method are 1 in its unit.
#[test]
fn smooth_hollow_profiles_with_noise_are_found_by_cosines() {
    let (rows, n, s) = (40, 321_usize, 120.0_f64);
    let e = std::f64::consts::E;
    #[expect(clippy::cast_precision_loss, reason = "pixels")]
    let square = |i: usize| (i as f64 / s).powi(2);
    let truth: Vec<f64> = (0..n).map(|i| e * square(i) * (-square(i)).exp()).collect();
    let root = std::f64::consts::PI.sqrt();
    let column: Vec<f64> = (0..n).map(|i| e * root * s * (0.5 + square(i)) * (-square(i)).exp()).collect();
    let noise = 0.01 * column.iter().copied().fold(0.0, f64::max);
    let (column, truth) = (mirrored(&column, true), mirrored(&truth, true));
    let columns = column.len();
    let values: Vec<f64> =
        (0..rows * columns).map(|i| column[i % columns] + noise * normal(i as u64)).collect();
    let sigmas = vec![noise; values.len()];
    let rms = |method: Method, sigmas: Option<&[f64]>| {
        let image = Columns { values: &values, sigmas, rows, columns };
        let (elements, strength) = (Elements::Linear, Strength::Automatic);
        let wanted =
            Settings { method, elements, strength, centre: Some(320.0), pixel_m: 1.0, weighted: false };
        let found = invert(&image, &wanted).unwrap();
        let (mut sum, mut in_sigmas, mut count) = (0.0, 0.0, 0.0);
        for row in 0..rows {
            for (i, truth) in truth.iter().enumerate().take(columns - 16).skip(16) {
                let error = found.alpha_per_m[row * columns + i] - truth;
                sum += error * error;
                in_sigmas += (error / found.sigma_alpha[row * columns + i]).powi(2);
                count += 1.0;
            }
        }
        ((sum / count).sqrt(), in_sigmas / count)
    };
    for sigmas in [None, Some(sigmas.as_slice())] {
        let (fourier, _) = rms(Method::Fourier, sigmas);
        assert!(fourier < 0.01, "{fourier}");
        let (dasch, in_sigmas) = rms(Method::ThreePoint, sigmas);
        assert!(dasch > 10.0 * fourier, "{dasch} {fourier}");
        // Halves repeat each other: 40 · 321 errors, next to the axis strongly alike.
        assert!((in_sigmas - 1.0).abs() < 0.1, "{in_sigmas}");
    }
}

/// A medium of known absorption and temperature, depth 2.4 through its axis, hottest there: what is seen of it, emissivity
/// and light by a fine integral along each sight, gives both back where there is absorption to speak of.
#[test]
fn temperatures_inside_a_dense_medium_come_back() {
    let (columns, centre, pixel) = (161_usize, 80.0, 1e-4);
    let curve = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
    // r in pixels.
    let alpha = |r: f64| 450.0 * (-(r / 30.0).powi(2)).exp();
    let kelvin = |r: f64| 400.0 + 120.0 * (-(r / 25.0).powi(2)).exp();
    let mut depth: Vec<f64> = vec![0.0; columns];
    let mut light = vec![0.0; columns];
    for c in 0..columns {
        #[expect(clippy::cast_precision_loss, reason = "pixels")]
        let y = c as f64 - centre;
        // From the camera inwards, a twentieth of a pixel a step, the midpoint rule.
        let step = 0.05;
        for k in 0..4000 {
            let r = y.hypot((f64::from(k) - 1999.5) * step);
            let part = alpha(r) * step * pixel;
            light[c] += -(-part).exp_m1() * (-depth[c]).exp() * curve.value(kelvin(r));
            depth[c] += part;
        }
    }
    let image = |values| Columns { values, sigmas: None, rows: 1, columns };
    for method in [Method::ThreePoint, Method::Daun, Method::Fourier] {
        let (elements, strength) = (Elements::Linear, Strength::Automatic);
        let wanted = Settings { method, elements, strength, centre: None, pixel_m: pixel, weighted: false };
        let found = invert(&image(&depth), &wanted).unwrap();
        let sources = emission::sources(&image(&light), &found, pixel).unwrap();
        for c in 40..121 {
            #[expect(clippy::cast_precision_loss, reason = "pixels")]
            let r = (c as f64 - centre).abs();
            let got = curve.inverse(sources.source[c]);
            // Rings of constant light: a quarter of the second derivative in half a ring, 120 K · 2/25² · ¼ · ½.
            assert!((got - kelvin(r)).abs() < 0.3, "{} {r}: {got} {}", method.name(), kelvin(r));
        }
    }
}

/// A normal variable for a counter: Box and Muller's method on splitmix64.
fn normal(counter: u64) -> f64 {
    let uniform = |k: u64| {
        let mut z = k.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(0x1234_5678_9abc_def1);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        #[expect(clippy::cast_precision_loss, reason = "53 bits")]
        let unit = ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
        unit
    };
    let radius = (-2.0 * (1.0 - uniform(2 * counter)).ln()).sqrt();
    radius * (2.0 * std::f64::consts::PI * uniform(2 * counter + 1)).cos()
}

fn ditd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ditd")).args(arguments).output().unwrap()
}

fn save(path: &Path, shape: [usize; 2], values: Vec<f64>) {
    npy::write(path, &Array { shape: shape.to_vec(), values: Values::F64(values) }).unwrap();
}

/// Columns in, coefficients out; emissivities of the same medium give the same; opaque pixels are flagged and hide the
/// core alone; contradictions are refused.
#[test]
fn the_command_reads_columns_and_emissivities() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let text = |name: &str| at(name).to_str().unwrap().to_owned();
    let gauss = |c: usize, width: f64| {
        #[expect(clippy::cast_precision_loss, reason = "pixels")]
        let r = (c as f64 - 30.0) / width;
        (-r * r).exp()
    };
    let column: Vec<f64> = (0..4 * 61).map(|i| 2.0 * gauss(i % 61, 10.0)).collect();
    save(&at("column.npy"), [4, 61], column.clone());
    save(&at("emissivity.npy"), [4, 61], column.iter().map(|p| -(-p).exp_m1()).collect());
    let image = |name: &str, more: &[&str]| {
        let (input, out) = (text(name), text("out.npz"));
        let told = ditd(
            &[&["abel", &input, "--method", "daun", "--pixel-m", "1e-4", "--out", &out, "--json"], more]
                .concat(),
        );
        assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
        let arrays = npz::read(&at("out.npz")).unwrap();
        let get = |name: &str| arrays.iter().find(|(found, _)| found == name).unwrap().1.clone();
        (
            get("alpha_per_m"),
            get("flags"),
            get("centre_column"),
            serde_json::from_slice::<Value>(&told.stdout).unwrap(),
        )
    };
    let (alpha, _, centre, summary) = image("column.npy", &[]);
    assert_eq!((alpha.shape.as_slice(), centre.shape.len()), ([4, 61].as_slice(), 0));
    assert!((centre.to_f64()[0] - 30.0).abs() < 1e-9 && summary["centre_found"] == Value::Bool(true));
    // 2/(√π · width) on the axis, by linear elements to a thousandth.
    let peak = 2.0 / (std::f64::consts::PI.sqrt() * 10.0 * 1e-4);
    assert!((alpha.to_f64()[30] / peak - 1.0).abs() < 3e-3, "{}", alpha.to_f64()[30] / peak);
    let (same, ..) = image("emissivity.npy", &["--emissivity"]);
    for (a, b) in alpha.to_f64().iter().zip(same.to_f64()) {
        assert!((a - b).abs() < 1e-9 * peak);
    }
    // A band whose absorber is gray by another name.
    std::fs::write(at("gray.csv"), "weight,k\n1,3\n2,3\n").unwrap();
    let (gray, ..) = image("emissivity.npy", &["--emissivity", "--growth", &text("gray.csv")]);
    assert!((gray.to_f64()[30] / alpha.to_f64()[30] - 1.0).abs() < 1e-9);
    // ε + 2σ reaches 1 about the axis.
    save(&at("sigma.npy"), [4, 61], vec![0.1; 4 * 61]);
    let (dense, flags, ..) = image("emissivity.npy", &["--emissivity", "--sigma", &text("sigma.npy")]);
    let opaque = |c: usize| -(-column[c]).exp_m1() + 0.2 >= 1.0;
    for c in 0..61 {
        let Values::U32(flags) = &flags.values else { panic!("bits") };
        assert_eq!(flags[c] & ditd::estimate::abel::flag::OPAQUE != 0, opaque(c), "{c}");
        assert_eq!(dense.to_f64()[c].is_nan(), opaque(c), "{c}");
    }
    let input = text("column.npy");
    for wrong in [
        ["--method", "daun", "--centre", "61"],
        ["--method", "fourier", "--strength", "-1"],
        ["--method", "basex", "--pixel-m", "-1"],
        ["--method", "daun", "--sigma", "missing.npy"],
    ] {
        assert_eq!(
            ditd(&[&["abel", input.as_str()], wrong.as_slice()].concat()).status.code(),
            Some(2),
            "{wrong:?}"
        );
    }
    assert_eq!(ditd(&["abel", &input, "--method", "basex", "--non-negative"]).status.code(), Some(2));
    let (smooth, .., summary) = image("column.npy", &["--degree", "3", "--strength", "0"]);
    assert_eq!(summary["elements"], "cubic");
    // A spline follows a Gaussian of ten pixels to its fourth derivative, 12/10⁴ times a few hundredths.
    assert!((smooth.to_f64()[30] / peak - 1.0).abs() < 1e-4, "{}", smooth.to_f64()[30] / peak);
    for wrong in [["--method", "fourier", "--degree", "1"], ["--method", "daun", "--degree", "4"]] {
        assert_eq!(ditd(&[&["abel", input.as_str()], wrong.as_slice()].concat()).status.code(), Some(2));
    }
}

/// A map is inverted when asked for, with temperatures of the size of the map's, and the map stays as it was.
#[test]
fn maps_are_inverted_when_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let stack = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/fit/fig5_like");
    let (stack, out) = (stack.to_str().unwrap(), dir.path().to_str().unwrap());
    assert!(ditd(&["fit", stack, "--out", out]).status.success());
    let before = std::fs::read(dir.path().join("dit.npz")).unwrap();
    assert!(!dir.path().join("abel.npz").exists());
    let told = ditd(&["fit", stack, "--out", out, "--abel", "onion_peeling", "--abel-pixel-m", "1e-4"]);
    assert!(told.status.success() && String::from_utf8(told.stdout).unwrap().contains("abel"));
    assert_eq!(std::fs::read(dir.path().join("dit.npz")).unwrap(), before);
    let arrays = npz::read(&dir.path().join("abel.npz")).unwrap();
    let get = |name: &str| arrays.iter().find(|(found, _)| found == name).unwrap().1.to_f64();
    let (alpha, column) = (get("alpha_per_m"), get("column"));
    assert!(alpha.len() == column.len() && alpha.iter().any(|a| *a > 0.0));
    let mut warm: Vec<f64> = get("temperature_k").into_iter().filter(|t| t.is_finite()).collect();
    warm.sort_unstable_by(f64::total_cmp);
    assert!((400.0..500.0).contains(&warm[warm.len() / 2]), "{}", warm[warm.len() / 2]);
    assert_eq!(ditd(&["fit", stack, "--out", out, "--abel-pixel-m", "1e-4"]).status.code(), Some(2));
}
