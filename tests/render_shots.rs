//! `ditd render --shots`: an ensemble out of one rendering. Figures and files show that no path was traced for a shot, that
//! a shot is the one that `shot = k` renders, and that mean and deviation are theirs; what has no shots ends with status 2.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use std::path::Path;
use std::process::{Command, Output};

const SPRAY: &str = r#"
kind = "multi-hole"
fuel = "n-heptane"
time_s = 2e-4
cell_m = 1e-3
injector = { holes = 1, angle_deg = 0, pitch_circle_m = 0 }
"#;

fn scene(medium: &str) -> String {
    format!(
        r#"
[camera]
kind = "telecentric"
position_m = [0.0, -0.3, -0.008]
look_at_m = [0.0, 0.0, -0.008]
up = [0.0, 0.0, 1.0]
columns = 24
rows = 18
width_m = 0.03
[plate]
shape = "rectangle"
centre_m = [0.0, 0.1, 0.0]
facing = [0.0, -1.0, 0.0]
width_m = 0.4
height_m = 0.4
temperature_k = 450.0
[walls]
temperature_k = 400.0
[band]
wavelength_um = 3.4
[medium]
{medium}
"#
    )
}

fn render(folder: &Path, scene: &str, arguments: &[&str]) -> Output {
    std::fs::write(folder.join("scene.toml"), scene).unwrap();
    Command::new(env!("CARGO_BIN_EXE_ditd"))
        .args(["render", "scene.toml", "--target-error", "1e-2"])
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn figures(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn channel(path: &Path, name: &str) -> Vec<f64> {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let found = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name));
    let found = found.unwrap_or_else(|| panic!("{} has no {name}", path.display()));
    found.sample_data.values_as_f32().map(f64::from).collect()
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn shots_are_followed_without_a_path_and_are_those_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let arguments = ["--shots", "4", "--out", "a.exr", "--png", "a.png", "--json"];
    let found = figures(&render(folder.path(), &scene(SPRAY), &arguments));
    assert!(found["paths"].as_f64().unwrap() > 1000.0, "the mean spray is traced: {found}");
    assert_eq!((found["shots"].as_f64(), found["shots_paths"].as_f64()), (Some(4.0), Some(0.0)));
    let list = found["shot_list"].as_array().unwrap();
    assert_eq!(list.len(), 4);
    for shot in list {
        assert!(shot["paths"].as_f64() == Some(0.0) && shot["sights"].as_f64().unwrap() > 50.0, "{shot}");
    }

    // Mean and deviation are those of the files.
    let plates: Vec<Vec<f64>> =
        (1..=4).map(|k| channel(&path(&format!("a_shot{k}.exr")), "a_plate")).collect();
    let (mean, deviation) = (channel(&path("a.exr"), "a_plate"), channel(&path("a.exr"), "sd_a_plate"));
    let mut most = 0.0_f64;
    for pixel in 0..mean.len() {
        let values: Vec<f64> = plates.iter().map(|plate| plate[pixel]).collect();
        let expected = values.iter().sum::<f64>() / 4.0;
        let squares: f64 = values.iter().map(|v| (v - expected).powi(2)).sum();
        // Files hold single precision.
        assert!((mean[pixel] - expected).abs() < 1e-6);
        assert!((deviation[pixel] - (squares / 3.0).sqrt()).abs() < 1e-6);
        most = most.max(deviation[pixel]);
    }
    assert!(most > 0.02, "shots differ: {most}");
    let overall = list.iter().map(|shot| shot["mean_a_plate"].as_f64().unwrap()).sum::<f64>() / 4.0;
    assert!((overall - found["mean_a_plate"].as_f64().unwrap()).abs() < 1e-6);
    for name in ["a.png", "a_sd.png", "a_shot1.png", "a_shot4.png"] {
        assert!(std::fs::read(path(name)).unwrap().starts_with(b"\x89PNG"), "{name}");
    }

    // Shot 2 traced for itself: the same but for what is kept of the mean spray's light, a fifth of the difference.
    let itself =
        figures(&render(folder.path(), &scene(&format!("{SPRAY}shot = 2\n")), &["--out", "b.exr", "--json"]));
    assert!(itself["paths"].as_f64().unwrap() > 1000.0);
    figures(&render(folder.path(), &scene(SPRAY), &["--out", "m.exr", "--json"]));
    let [own, of_mean] = ["b.exr", "m.exr"].map(|name| channel(&path(name), "a_plate"));
    let (moved, error) = (rms(&own, &of_mean), rms(&own, &plates[1]));
    println!("moved {moved:.1e}, error {error:.1e}");
    // Both renderings have the target's error.
    assert!(moved > 0.02 && error < 0.2 * moved + 6e-3, "{moved} {error}");
    // Another shot is not nearer.
    assert!(rms(&own, &plates[2]) > 2.0 * error);
}

#[test]
fn a_seed_names_other_shots() {
    let folder = tempfile::tempdir().unwrap();
    let still = scene(&format!("{SPRAY}seed = 5\n"));
    let shots = |text: &str, seed: &[&str]| {
        let arguments = [&["--shots", "2", "--out", "a.exr", "--json"], seed].concat();
        figures(&render(folder.path(), text, &arguments));
        channel(&folder.path().join("a_shot1.exr"), "a_plate")
    };
    let [one, same, other] = [shots(&still, &[]), shots(&still, &[]), shots(&still, &["--seed", "6"])];
    assert_eq!(one, same);
    assert!(rms(&one, &other) > 0.01);
}

#[test]
fn what_has_no_shots_is_told_so() {
    let folder = tempfile::tempdir().unwrap();
    let sphere = "kind = \"sphere\"\ncentre_m = [0, 0, 0]\nradius_m = 0.01\nextinction = 40\nalbedo = 0.0\n\
                  temperature_k = 450";
    let none = format!("{SPRAY}shots = {{ turbulence = 0, mass = 0, angle_deg = 0 }}");
    let one = format!("{SPRAY}shot = 3");
    for (medium, number, words) in [
        (sphere, "3", vec!["--shots", "does not fluctuate", "multi-hole", "leave out"]),
        (&none, "3", vec!["[medium.shots]", "all 0", "Raise"]),
        (&one, "3", vec!["shot = 3", "Leave out `shot`"]),
        (SPRAY, "1", vec!["1 shots", "2 to 10000", "shot = 1"]),
        (SPRAY, "0", vec!["2 to 10000"]),
        (SPRAY, "10001", vec!["2 to 10000"]),
    ] {
        let output = render(folder.path(), &scene(medium), &["--shots", number]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{medium} {number}: {message}");
        for word in words {
            assert!(message.contains(word), "{medium} {number}: {message}");
        }
    }
    let moving = scene(SPRAY).replace("[band]", "[exposure]\ntime_s = 5e-5\n[band]");
    let output = render(folder.path(), &moving, &["--shots", "2"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("[exposure]"), "{message}");
    for clash in ["--reference", "--rays=a.csv"] {
        assert_eq!(render(folder.path(), &scene(SPRAY), &["--shots", "2", clash]).status.code(), Some(2));
    }
}
