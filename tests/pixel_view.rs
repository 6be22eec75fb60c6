//! What `ditd fit` tells of one pixel, and which pixels it masks.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, assert_replays};
use ditd::estimate::map::flag;
use ditd::files::image::read_exr;
use ditd::files::npy::Values;
use ditd::files::npz;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn ditd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ditd")).args(arguments).output().unwrap()
}

fn stack(name: &str) -> String {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/fit").join(name);
    path.to_str().unwrap().to_owned()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// The numbers of a pixel are those of the map, add up among themselves, and have a picture.
#[test]
fn a_pixels_numbers_are_those_of_the_map() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    for estimator in ["default", "paper", "ols"] {
        let told = ditd(&[
            "fit",
            &stack("fig5_like"),
            "--out",
            out,
            "--estimator",
            estimator,
            "--pixel",
            "7,20",
            "--json",
        ]);
        assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
        let view: Value = serde_json::from_slice(&told.stdout).unwrap();
        let arrays = npz::read(&dir.path().join("dit.npz")).unwrap();
        let at = |name: &str| arrays.iter().find(|(found, _)| found == name).unwrap().1.to_f64()[7 * 32 + 20];
        for (pointer, name) in [
            ("/temperature_k/value", "temperature_k"),
            ("/temperature_k/sigma", "sigma_temperature_k"),
            ("/temperature_k/set_95/0", "temperature_low_k"),
            ("/temperature_k/set_95/1", "temperature_high_k"),
            ("/emissivity/value", "emissivity"),
            ("/line/slope", "slope"),
            ("/line/crossing_counts", "crossing"),
            ("/line/chi2", "chi2"),
            ("/gain/0", "gain"),
        ] {
            let (told, map) = (number(view.pointer(pointer).unwrap()), at(name));
            // Vectors and the single pixel add in another order: rounding of sums of tens of counts.
            assert!((told - map).abs() <= 1e-9 * map.abs().max(1.0), "{estimator} {pointer}: {told} {map}");
        }
        let levels = view["levels"].as_array().unwrap();
        assert_eq!(levels.len(), 6);
        let shares: f64 = levels.iter().map(|level| number(&level["weight_share"])).sum();
        assert!((shares - 1.0).abs() < 1e-12);
        // Weighted residuals of a line with an offset add up to nothing.
        let balance: f64 =
            levels.iter().map(|l| number(&l["weight_share"]) * number(&l["residual_counts"])).sum();
        assert!(balance.abs() < 1e-9, "{balance}");
        for level in levels {
            let difference = number(&level["mean_spray_counts"]) - number(&level["mean_blank_counts"]);
            assert!((difference - number(&level["difference_counts"])).abs() < 1e-9);
            assert_eq!(level["accepted"].as_u64(), Some(6));
        }
        let narrow =
            number(&view["temperature_k"]["set_68"][1]) - number(&view["temperature_k"]["set_68"][0]);
        let wide = number(&view["temperature_k"]["set_95"][1]) - number(&view["temperature_k"]["set_95"][0]);
        assert!(narrow > 0.0 && wide > 1.5 * narrow, "{narrow} {wide}");
        // The curve goes through the pixel's temperature at ε_B (S + E_f).
        let points = view["calibration"]["points"].as_array().unwrap();
        let counts = number(&view["calibration"]["counts"]);
        assert!(number(&points[0][1]) < counts && number(&points[points.len() - 1][1]) > counts);
        let svg = std::fs::read_to_string(dir.path().join("pixel_7_20.svg")).unwrap();
        assert!(svg.starts_with("<svg xmlns=") && svg.contains("row 7, column 20") && !svg.contains("NaN"));
    }
}

/// Saturated and dead pixels have a view as well; a pixel that is not there has none. Without --out the picture alone is
/// written, where it is told to.
#[test]
fn every_pixel_has_a_view() {
    let dir = tempfile::tempdir().unwrap();
    let svg = dir.path().join("a/p.svg");
    let svg_text = svg.to_str().unwrap();
    let look =
        |at: &str| ditd(&["fit", &stack("saturated_dead"), "--pixel", at, "--pixel-svg", svg_text, "--json"]);
    let mut flags = 0;
    for row in 0..4 {
        for column in [0, 1, 2, 3, 31] {
            let told = look(&format!("{row},{column}"));
            assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
            let view: Value = serde_json::from_slice(&told.stdout).unwrap();
            flags += view["flags"].as_array().unwrap().len();
            for level in view["levels"].as_array().unwrap() {
                let sum = level["accepted"].as_u64().unwrap()
                    + level["spikes"].as_u64().unwrap()
                    + level["saturated"].as_u64().unwrap();
                assert!(sum <= 6);
            }
            let drawn = std::fs::read_to_string(&svg).unwrap();
            assert!(!drawn.contains("\"NaN") && !drawn.contains("NaN,"), "{row},{column}");
        }
    }
    assert!(flags > 0);
    assert_eq!(look("24,0").status.code(), Some(2));
    assert_eq!(look("7").status.code(), Some(2));
    assert_eq!(look("-1,2").status.code(), Some(2));
    assert!(!dir.path().join("dit.npz").exists());
}

/// A run's own limits are in its result and its replay, the command line's come first, and its pixels can be looked at.
#[test]
fn runs_have_masks_and_pixels() {
    let ran = Preset::spray().with("fit.mask_emissivity_below", "0.3").run().done();
    let summary = ran.summary();
    let own = summary["flags"]["LOW_EMISSIVITY"].as_u64().unwrap();
    assert!(own > 0 && summary["flags"]["HIGH_SIGMA"].as_u64() == Some(0));
    assert_replays(&ran.path);
    let dir = tempfile::tempdir().unwrap();
    let (run, out) = (ran.path.to_str().unwrap(), dir.path().to_str().unwrap());
    let told = ditd(&["fit", run, "--out", out, "--mask-emissivity-below", "0.6", "--json"]);
    assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
    let refitted: Value = serde_json::from_slice(&told.stdout).unwrap();
    assert!(refitted["flags"]["LOW_EMISSIVITY"].as_u64().unwrap() > own);
    let told = ditd(&["fit", run, "--out", out, "--pixel", "10,16", "--json"]);
    assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
    let view: Value = serde_json::from_slice(&told.stdout).unwrap();
    let arrays = npz::read(&dir.path().join("dit.npz")).unwrap();
    let kelvin = arrays.iter().find(|(found, _)| found == "temperature_k").unwrap().1.to_f64()[10 * 32 + 16];
    assert!((number(&view["temperature_k"]["value"]) - kelvin).abs() < 1e-9);
    assert_eq!(view["blanks_per_cycle"].as_u64(), Some(2));
    assert!(dir.path().join("pixel_10_16.svg").exists());
}

/// Masks flag pixels in every output and take nothing away.
#[test]
fn masks_are_flags_in_every_output() {
    let dir = tempfile::tempdir().unwrap();
    let (plain, masked) = (dir.path().join("plain"), dir.path().join("masked"));
    assert!(ditd(&["fit", &stack("fig5_like"), "--out", plain.to_str().unwrap()]).status.success());
    let limits = ["--mask-emissivity-below", "0.5", "--mask-sigma-above-k", "2.5"];
    let arguments =
        [&["fit", &stack("fig5_like"), "--out", masked.to_str().unwrap(), "--json"], limits.as_slice()];
    let told = ditd(&arguments.concat());
    assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
    let read = |folder: &Path| npz::read(&folder.join("dit.npz")).unwrap();
    let (before, after) = (read(&plain), read(&masked));
    let get = |arrays: &[(String, ditd::files::npy::Array)], name: &str| {
        arrays.iter().find(|(found, _)| found == name).unwrap().1.clone()
    };
    for (name, array) in before.iter().filter(|(name, _)| name != "flags") {
        assert_eq!(array.to_bytes(), get(&after, name).to_bytes(), "{name}");
    }
    let (emissivity, temperature) =
        (get(&after, "emissivity").to_f64(), get(&after, "temperature_k").to_f64());
    let sigma = get(&after, "sigma_temperature_k").to_f64();
    let Values::U32(flags) = get(&after, "flags").values else { panic!("bits") };
    let (mut low, mut high) = (0_u64, 0_u64);
    for i in 0..flags.len() {
        let bits = flags[i];
        assert_eq!(bits & flag::LOW_EMISSIVITY != 0, emissivity[i] < 0.5);
        let uncertain = temperature[i].is_finite() && (sigma[i] > 2.5 || sigma[i].is_nan());
        assert_eq!(bits & flag::HIGH_SIGMA != 0, uncertain);
        low += u64::from(emissivity[i] < 0.5);
        high += u64::from(uncertain);
    }
    assert!(low > 0 && high > 0);
    // The legend is in the archive, the EXR, the TIFF and the summary; the picture is there.
    let names = get(&after, "flag_names");
    let Values::U8(letters) = names.values else { panic!("letters") };
    let names: Vec<String> = letters
        .chunks(names.shape[1])
        .map(|bytes| bytes.iter().map(|&b| char::from(b)).take_while(|c| *c != '\0').collect())
        .collect();
    let wanted: Vec<&str> = flag::LEGEND.iter().map(|(_, name, _)| *name).collect();
    assert_eq!(names, wanted);
    let Values::U32(bits) = get(&after, "flag_bits").values else { panic!("bits") };
    assert_eq!(bits, flag::LEGEND.map(|(bit, ..)| bit));
    let exr = read_exr(&masked.join("dit.exr")).unwrap();
    let tiff = std::fs::File::open(masked.join("temperature_k.tif")).unwrap();
    let mut tiff = tiff::decoder::Decoder::new(std::io::BufReader::new(tiff)).unwrap();
    let tiff = tiff.get_tag_ascii_string(tiff::tags::Tag::ImageDescription).unwrap();
    for text in [exr.description, tiff] {
        let legend: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(legend["flags"].as_array().unwrap().len(), flag::LEGEND.len());
        assert_eq!(legend["flags"][13]["name"], "LOW_EMISSIVITY");
    }
    let summary: Value = serde_json::from_slice(&told.stdout).unwrap();
    assert_eq!(summary["flags"]["LOW_EMISSIVITY"].as_u64(), Some(low));
    assert_eq!(summary["flags"]["HIGH_SIGMA"].as_u64(), Some(high));
    assert_eq!(summary["flag_legend"].as_array().unwrap().len(), flag::LEGEND.len());
    assert!((number(&summary["masks"]["emissivity_below"]) - 0.5).abs() < 1e-15);
    assert!(masked.join("preview_flags.png").exists());
    for wrong in [["--mask-sigma-above-k", "-1"], ["--mask-emissivity-below", "nan"]] {
        let out = masked.to_str().unwrap();
        assert_eq!(
            ditd(&["fit", &stack("fig5_like"), "--out", out, wrong[0], wrong[1]]).status.code(),
            Some(2)
        );
    }
}
