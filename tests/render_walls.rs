//! `ditd render` of a chamber whose walls differ: channels and columns of each wall, radiances out of them, and nothing of
//! it where all walls shine alike.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use ditd_sim::light::planck::photon_radiance;
use std::path::Path;
use std::process::{Command, Output};

/// A scattering sphere at 450 K in a chamber, looked at from outside.
const SCENE: &str = r#"
[camera]
kind = "pinhole"
position_m = [0.0, -0.5, 0.0]
look_at_m = [0.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
columns = 10
rows = 8
horizontal_fov_deg = 40.0
pixel_filter = "centre"
[walls]
temperature_k = 300.0
[chamber]
lower_m = [-0.1, -0.1, -0.1]
upper_m = [0.1, 0.1, 0.1]
[band]
wavelength_um = 3.4
[medium]
kind = "sphere"
centre_m = [0.0, 0.0, 0.0]
radius_m = 0.03
extinction = 30.0
albedo = 0.5
temperature_k = 450.0
"#;

const HOT: &str =
    "[[wall]]\nside = \"y+\"\ntemperature_k = 420.0\n[[wall]]\nside = \"x-\"\ntemperature_k = 350.0\n";

const RAYS: &str =
    "origin_x_m,origin_y_m,origin_z_m,direction_x,direction_y,direction_z\n0,-0.5,0,0,1,0\n0,0,0.09,1,0,0\n";

const WALLS: [(&str, f64); 7] = [
    ("a_wall_x-", 350.0),
    ("a_wall_x+", 300.0),
    ("a_wall_y-", 300.0),
    ("a_wall_y+", 420.0),
    ("a_wall_z-", 300.0),
    ("a_wall_z+", 300.0),
    ("a_outside", 300.0),
];

fn render(folder: &Path, scene: &str, arguments: &[&str]) -> Output {
    std::fs::write(folder.join("scene.toml"), scene).unwrap();
    std::fs::write(folder.join("rays.csv"), RAYS).unwrap();
    Command::new(env!("CARGO_BIN_EXE_ditd"))
        .args(["render", "scene.toml", "--target-error", "2e-3"])
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// Radiance by the coefficients, walls being black.
fn light(value: impl Fn(&str) -> f64) -> f64 {
    let walls: f64 = WALLS.iter().map(|(name, kelvin)| value(name) * photon_radiance(3.4, *kelvin)).sum();
    walls + value("a_medium") * photon_radiance(3.4, 450.0)
}

#[test]
fn every_wall_has_its_channel_and_the_radiance_is_made_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let output = render(folder.path(), &format!("{SCENE}{HOT}"), &["--out", "a.exr", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(stats["skipped_walls"], 0.0);
    let image = exr::prelude::read_first_flat_layer_from_file(folder.path().join("a.exr")).unwrap();
    let channel = |name: &str| -> Vec<f32> {
        let found = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
        found.sample_data.values_as_f32().collect()
    };
    let (radiance, walls) = (channel("radiance"), channel("a_walls"));
    for pixel in 0..80 {
        let value = |name: &str| f64::from(channel(name)[pixel]);
        let sum: f64 = WALLS.iter().map(|(name, _)| value(name)).sum();
        assert!((sum - f64::from(walls[pixel])).abs() < 1e-6, "{pixel}: {sum} {}", walls[pixel]);
        assert!((f64::from(radiance[pixel]) / light(value) - 1.0).abs() < 1e-5, "{pixel}");
    }
    // The corner looks past the box; beside the sphere is the hot wall.
    assert!((channel("a_outside")[0] - 1.0).abs() < 1e-6);
    assert!((channel("a_wall_y+")[4 * 10 + 3] - 1.0).abs() < 1e-6);
}

#[test]
fn rays_have_columns_for_the_walls() {
    let folder = tempfile::tempdir().unwrap();
    let scene = format!("{SCENE}{HOT}");
    let output = render(folder.path(), &scene, &["--rays", "rays.csv", "--groups", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for ray in answer["rays"].as_array().unwrap() {
        let value = |name: &str| ray[name].as_f64().unwrap();
        let sum: f64 = WALLS.iter().map(|(name, _)| value(name)).sum();
        assert!((sum - value("a_walls")).abs() < 1e-12);
        assert!((value("radiance") / light(value) - 1.0).abs() < 1e-12);
        assert!((value("a_wall_y+_g00") - value("a_wall_y+")).abs() < 1e-12);
        assert!(value("se_wall") >= 0.0 && value("se_wall") <= 2e-3);
    }
    // From inside, past the sphere: the wall ahead and nothing else.
    assert!((answer["rays"][1]["a_wall_x+"].as_f64().unwrap() - 1.0).abs() < 1e-15);
}

#[test]
fn walls_that_shine_alike_are_one() {
    let folder = tempfile::tempdir().unwrap();
    let wall = "[[wall]]\nside = \"y+\"\nemissivity = 0.3\n";
    let output = render(folder.path(), &format!("{SCENE}{wall}"), &["--out", "a.exr", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(stats["skipped_walls"], 6.0);
    let image = exr::prelude::read_first_flat_layer_from_file(folder.path().join("a.exr")).unwrap();
    assert!(image.layer_data.channel_data.list.iter().all(|c| !c.name.to_string().starts_with("a_wall_")));
}

#[test]
fn unknown_walls_end_with_status_2_and_the_known_ones() {
    let folder = tempfile::tempdir().unwrap();
    let output = render(folder.path(), &format!("{SCENE}[[wall]]\nside = \"top\"\ntemperature_k = 1\n"), &[]);
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("top") && message.contains("z+"), "{message}");
}
