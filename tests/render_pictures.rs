//! `ditd render` with several plate temperatures: one image each out of one rendering, right by the closed form, and
//! pictures beside it; what makes no sense ends with status 2.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use std::path::Path;
use std::process::{Command, Output};

/// A black sphere at 450 K that fills part of the view, in front of a plate that fills all of it.
const SCENE: &str = r#"
[camera]
kind = "telecentric"
position_m = [0.0, -1.0, 0.0]
look_at_m = [0.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
columns = 8
rows = 6
width_m = 0.08
pixel_filter = "centre"
[plate]
shape = "rectangle"
centre_m = [0.0, 1.0, 0.0]
facing = [0.0, -1.0, 0.0]
width_m = 1.0
height_m = 1.0
[walls]
temperature_k = 300.0
[band]
wavelength_um = 3.4
[medium]
kind = "sphere"
centre_m = [0.0, 0.0, 0.0]
radius_m = 0.02
extinction = 40.0
albedo = 0.0
temperature_k = 450.0
"#;

fn render(folder: &Path, arguments: &[&str]) -> Output {
    std::fs::write(folder.join("scene.toml"), SCENE).unwrap();
    let command = ["render", "scene.toml", "--target-error", "1e-3"];
    Command::new(env!("CARGO_BIN_EXE_ditd"))
        .args(command)
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn channel(path: &Path, name: &str) -> Vec<f32> {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let found = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
    found.sample_data.values_as_f32().collect()
}

#[test]
fn each_plate_temperature_has_its_image_and_picture() {
    let folder = tempfile::tempdir().unwrap();
    let output =
        render(folder.path(), &["--out", "a.exr", "--png", "a.png", "--plate-temperatures", "400,500.5"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let exr = folder.path().join("a.exr");
    let plate = channel(&exr, "a_plate");
    let medium = channel(&exr, "a_medium");
    assert!(plate.iter().any(|a| *a < 0.5) && plate.iter().any(|a| *a > 0.999));
    let b = |kelvin| ditd_sim::light::planck::photon_radiance(3.4, kelvin);
    for (name, kelvin) in [("radiance_plate_400K", 400.0), ("radiance_plate_500_5K", 500.5)] {
        for ((got, a_plate), a_medium) in channel(&exr, name).iter().zip(&plate).zip(&medium) {
            let rest = 1.0 - f64::from(*a_plate) - f64::from(*a_medium);
            let expected =
                f64::from(*a_plate) * b(kelvin) + f64::from(*a_medium) * b(450.0) + rest * b(300.0);
            // Coefficients are rounded to 2^-24 each.
            assert!((f64::from(*got) / expected - 1.0).abs() < 1e-5, "{name}: {got} {expected}");
        }
    }
    for name in ["a_400K.png", "a_500_5K.png"] {
        let bytes = std::fs::read(folder.path().join(name)).unwrap();
        assert!(bytes.starts_with(b"\x89PNG"), "{name}");
    }
    // One temperature: the name as it was given.
    let output = render(folder.path(), &["--png", "one.png", "--plate-temperatures", "450"]);
    assert!(output.status.success() && folder.path().join("one.png").exists());
}

#[test]
fn impossible_temperatures_and_unlit_scenes_end_with_status_2() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        vec!["--plate-temperatures", "-1"],
        vec!["--plate-temperatures", "400,nan"],
        vec!["--plate-temperatures", "warm"],
        // The plate has no temperature: there is no radiance to show.
        vec!["--png", "a.png"],
    ] {
        let output = render(folder.path(), &arguments);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{arguments:?}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        assert!(!folder.path().join("a.png").exists());
    }
}

/// Before anything is rendered: a picture that has no place is known at once.
#[test]
fn places_that_cannot_be_written_are_told_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("maps")).unwrap();
    for (arguments, told) in [
        (["--out", "maps"], "maps: is a folder. Name a file, maps/image for example"),
        (["--png", "maps"], "is a folder"),
        (["--out", "nowhere/a.exr"], "there is no folder nowhere. Create it, or name another place"),
    ] {
        // No scene is needed to see it.
        let output = Command::new(env!("CARGO_BIN_EXE_ditd"))
            .args(["render", "no-such-scene.toml"])
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && error.contains(told), "{arguments:?}: {error}");
    }
}
