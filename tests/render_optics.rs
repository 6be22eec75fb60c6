//! `ditd render` with lens, exposure, uneven plate and mirroring windows, against closed forms; what makes no sense ends
//! with status 2 and names table, key and what is allowed.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use ditd_sim::light::planck::photon_radiance;
use ditd_sim::light::window::{Material, Plate as Glass};
use std::path::Path;
use std::process::{Command, Output};

/// Along z through a slab (τ = 0.7, 450 K, nothing scattered) at a plate of 433 K that fills the view.
const VIEW: &str = r#"
[camera]
kind = "telecentric"
position_m = [0.0, 0.0, -0.6]
look_at_m = [0.0, 0.0, 0.0]
up = [0.0, 1.0, 0.0]
columns = 9
rows = 7
width_m = 0.045
[walls]
temperature_k = 523.0
[band]
wavelength_um = 3.4
"#;
const SLAB: &str = r#"
[medium]
kind = "slab"
optical_depth = 0.7
thickness_m = 0.02
albedo = 0.0
temperature_k = 450.0
"#;
const PLATE: &str = r#"
[plate]
shape = "disc"
centre_m = [0.0, 0.0, 0.4]
facing = [0.0, 0.0, -1.0]
diameter_m = 0.1
temperature_k = 433.0
"#;

fn window(z: f64, kelvin: f64, extra: &str) -> String {
    format!(
        "[[window]]\nposition_m = [0.0, 0.0, {z}]\nnormal = [0.0, 0.0, 1.0]\nmaterial = \"CaF2\"\n\
         thickness_m = 0.01\ntemperature_k = {kelvin}\n{extra}"
    )
}

fn render(folder: &Path, scene: &str, arguments: &[&str]) -> Output {
    std::fs::write(folder.join("scene.toml"), scene).unwrap();
    Command::new(env!("CARGO_BIN_EXE_ditd"))
        .args(["render", "scene.toml"])
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// Some channels of the image of a scene.
fn image<const N: usize>(folder: &Path, scene: &str, names: [&str; N]) -> [Vec<f64>; N] {
    let output = render(folder, scene, &["--out", "a.exr"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let image = exr::prelude::read_first_flat_layer_from_file(folder.join("a.exr")).unwrap();
    names.map(|name| {
        let found = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
        found.sample_data.values_as_f32().map(f64::from).collect()
    })
}

/// An array of f64, version 1 of the format.
fn write_npy(folder: &Path, name: &str, shape: &str, values: &[f64]) {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let mut head = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    while !(10 + head.len() + 1).is_multiple_of(64) {
        head.push(' ');
    }
    head.push('\n');
    bytes.extend(u16::try_from(head.len()).unwrap().to_le_bytes());
    bytes.extend(head.as_bytes());
    values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    std::fs::write(folder.join(name), bytes).unwrap();
}

fn b(kelvin: f64) -> f64 {
    photon_radiance(3.4, kelvin)
}

/// Light that goes to and fro between two windows with a uniform slab between them, bounce by bounce: the far window lets
/// plate light in and mirrors, the near one lets laboratory light in and mirrors.
#[test]
fn a_slab_between_two_windows_is_seen_in_both() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |far: &str, near: &str| {
        let (near, far) = (window(-0.1, 400.0, near), window(0.1, 470.0, far));
        format!("{VIEW}[lab]\ntemperature_k = 296\n{near}{far}{PLATE}{SLAB}")
    };
    let glass = Glass { material: Material::CalciumFluoride, thickness_m: 0.01 };
    let (near, far) = (glass.optics(3.4, 400.0), glass.optics(3.4, 470.0));
    let through = (-0.7_f64).exp();
    let mut wanted = near.absorptance * b(400.0) + near.reflectance * b(296.0);
    let mut weight = near.transmittance;
    for _ in 0..100 {
        wanted += weight * (1.0 - through) * b(450.0);
        weight *= through;
        wanted += weight * (far.transmittance * b(433.0) + far.absorptance * b(470.0));
        weight *= far.reflectance;
        wanted += weight * (1.0 - through) * b(450.0);
        weight *= through;
        wanted += weight * (near.transmittance * b(296.0) + near.absorptance * b(400.0));
        weight *= near.reflectance;
    }
    let names = ["radiance", "a_plate", "a_walls", "a_medium", "a_window", "a_camera_side"];
    let mirroring = "mirrors = \"chamber\"\n";
    for near in ["", "diameter_m = 0.09\n"] {
        let [radiance, plate, walls, medium, glass, lab] =
            image(folder.path(), &scene(mirroring, near), names);
        for i in 0..radiance.len() {
            // Channels are f32.
            assert!((radiance[i] / wanted - 1.0).abs() < 3e-7, "{} {wanted}", radiance[i]);
            let sum = plate[i] + walls[i] + medium[i] + glass[i] + lab[i];
            assert!((sum - 1.0).abs() < 1e-6, "{sum}");
            assert!(walls[i].abs() < 1e-7, "no wall is in sight: {}", walls[i]);
        }
    }
    // As single rays, in f64.
    let rays =
        "origin_x_m,origin_y_m,origin_z_m,direction_x,direction_y,direction_z\n0.001,0.002,-0.6,0,0,1\n";
    std::fs::write(folder.path().join("rays.csv"), rays).unwrap();
    let output = render(folder.path(), &scene(mirroring, ""), &["--rays", "rays.csv", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let radiance = answer["rays"][0]["radiance"].as_f64().unwrap();
    assert!((radiance / wanted - 1.0).abs() < 1e-12, "{radiance} {wanted}");
    // Without the word the far window mirrors walls, as ever.
    let [radiance] = image(folder.path(), &scene("", ""), ["radiance"]);
    let plain = near.absorptance * b(400.0)
        + near.reflectance * b(296.0)
        + near.transmittance
            * ((1.0 - through) * b(450.0)
                + through
                    * (far.transmittance * b(433.0)
                        + far.absorptance * b(470.0)
                        + far.reflectance * b(523.0)));
    assert!((radiance[0] / plain - 1.0).abs() < 3e-7, "{} {plain}", radiance[0]);
    println!("the mirrored chamber changes the radiance by {:e}", wanted / plain - 1.0);
    // All at one temperature looks like it.
    let even =
        ["433.0", "523.0", "296", "400", "470", "450.0"].iter().fold(scene(mirroring, ""), |text, t| {
            text.replace(&format!("temperature_k = {t}\n"), "temperature_k = 500\n")
        });
    let [radiance] = image(folder.path(), &even, ["radiance"]);
    assert!(radiance.iter().all(|r| (r / b(500.0) - 1.0).abs() < 3e-7), "{radiance:?}");
}

/// A grid that fills one half of the view: what is mirrored in a pixel is the medium in front of this pixel, not of its
/// neighbour on the other side.
#[test]
fn a_grid_is_mirrored_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    write_npy(folder.path(), "sigma.npy", "(2, 1, 1)", &[0.0, 35.0]);
    let grid = "[medium]\nkind = \"grid\"\nextinction_npy = \"sigma.npy\"\nlower_m = [-0.1, -0.1, -0.01]\n\
                upper_m = [0.1, 0.1, 0.01]\nalbedo = 0.0\ntemperature_k = 450.0\n";
    let (near, far) = (window(-0.1, 400.0, ""), window(0.1, 470.0, "mirrors = \"chamber\"\n"));
    let scene = format!("{VIEW}[lab]\ntemperature_k = 296\n{near}{far}{PLATE}{grid}");
    let [radiance, medium] = image(folder.path(), &scene, ["radiance", "a_medium"]);
    let glass = Glass { material: Material::CalciumFluoride, thickness_m: 0.01 };
    let (near, far) = (glass.optics(3.4, 400.0), glass.optics(3.4, 470.0));
    for (pixel, (radiance, medium)) in radiance.iter().zip(&medium).enumerate() {
        // The camera looks along z with y up: +x is at the left.
        let through = match pixel % 9 {
            0..=2 => (-0.7_f64).exp(),
            // Beside the step pixels may be interpolated.
            3..=5 => continue,
            _ => 1.0,
        };
        let own = 1.0 - through;
        let again = 1.0 / (1.0 - through * through * far.reflectance * near.reflectance);
        let share = near.transmittance * again * own * (1.0 + through * far.reflectance);
        // The images keep the target, 1e-3 rms; the mirrored medium is 0.014 of the medium's coefficient.
        assert!((medium - share).abs() < 3e-3, "{pixel}: {medium} {share}");
        let lab = near.transmittance * b(296.0) + near.absorptance * b(400.0);
        let behind =
            far.transmittance * b(433.0) + far.absorptance * b(470.0) + far.reflectance * through * lab;
        let wanted = share * b(450.0)
            + near.transmittance * again * through * behind
            + near.absorptance * b(400.0)
            + near.reflectance * b(296.0);
        assert!((radiance / wanted - 1.0).abs() < 5e-3, "{pixel}: {radiance} {wanted}");
    }
}

/// The plate's edge is 6 K warmer than its middle and its emissivity comes from a table: straight sights see the parabola
/// exactly, through air and through a slab, at its own temperature and at others.
#[test]
fn an_uneven_gray_plate_is_seen_where_each_sight_meets_it() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("eps.csv"), "wavelength_um,emissivity\n3.3,0.9\n3.5,0.8\n").unwrap();
    let plate =
        format!("{PLATE}non_uniformity_k = 6.0\nemissivity = \"eps.csv\"\ntemperatures_k = [433.0, 373.0]\n");
    let through = (-0.7_f64).exp();
    for (mirrors, mirrored, medium, through) in [
        ("", 523.0, "", 1.0),
        ("mirrors = \"laboratory\"\n", 296.0, SLAB, through),
        ("mirrors = \"walls\"\n", 523.0, SLAB, through),
    ] {
        let scene = format!("{VIEW}[lab]\ntemperature_k = 296\n{plate}{mirrors}{medium}");
        let names = ["radiance_plate_433K", "radiance_plate_373K", "plate_excess_k"];
        let [warm, cold, excess] = image(folder.path(), &scene, names);
        for i in 0..warm.len() {
            let (row, column) = ((i / 9) as f64, (i % 9) as f64);
            let (x, y) = ((column - 4.0) * 0.005, (row - 3.0) * 0.005);
            let d = 6.0 * (x * x + y * y) / 0.0025;
            for (got, kelvin) in [(warm[i], 433.0), (cold[i], 373.0)] {
                let light = 0.85 * b(kelvin + d) + 0.15 * b(mirrored);
                let wanted = through * light + (1.0 - through) * b(450.0);
                assert!((got / wanted - 1.0).abs() < 1e-6, "{mirrors}: {got} {wanted}");
            }
            assert!((excess[i] - through * d).abs() < 1e-5, "{} {d}", excess[i]);
        }
    }
}

/// A map of the plate's temperature, and the mean that light scattered by a grid is taken to see.
#[test]
fn a_map_of_the_plate_is_read_and_told_with_its_error() {
    let folder = tempfile::tempdir().unwrap();
    let npy = |name: &str, shape: &str, values: &[f64]| write_npy(folder.path(), name, shape, values);
    npy("map.npy", "(1, 2)", &[-2.0, 2.0]);
    npy("sigma.npy", "(2, 2, 2)", &[20.0; 8]);
    let grid = "[medium]\nkind = \"grid\"\nextinction_npy = \"sigma.npy\"\nlower_m = [-0.1, -0.1, -0.01]\n\
                upper_m = [0.1, 0.1, 0.01]\nalbedo = 0.5\ntemperature_k = 450.0\n";
    let scene = format!("{VIEW}{PLATE}non_uniformity_npy = \"map.npy\"\n{grid}");
    let output = render(folder.path(), &scene, &["--json", "--out", "a.exr"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let error = stats["plate_excess_error_k"].as_f64().unwrap();
    // At most what is scattered at all, times the spread of a plate between −2 and 2 K.
    assert!(error > 0.0 && error < (1.0 - (-0.4_f64).exp()) * 2.0, "{error}");
    let [excess, plate] = image(folder.path(), &scene, ["plate_excess_k", "a_plate"]);
    let straight = (-0.4_f64).exp();
    for column in 0..9 {
        // Straight light sees −2 … 2 K between the middles of the two fields 0.05 m apart; scattered light the mean, 0.
        let wanted = straight * (column as f64 - 4.0) * 0.005 / 0.025 * 2.0;
        assert!((excess[27 + column] - wanted).abs() < 1e-4, "{column}: {} {wanted}", excess[27 + column]);
        assert!(plate[27 + column] > straight);
    }
    npy("map.npy", "(4,)", &[0.0; 4]);
    let output = render(folder.path(), &scene, &[]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(told.contains("map.npy") && told.contains("[rows, columns]"), "{told}");
}

/// Shapes have no grid: their pixels are means of single rays. A black sphere out of focus covers as much of the picture
/// as in focus (far from the picture's edge light only moves), and moving it does not change that either.
#[test]
fn shapes_are_blurred_by_lens_and_motion() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |camera: &str, exposure: &str| {
        format!(
            "{}{PLATE}{exposure}[medium]\nkind = \"sphere\"\ncentre_m = [0.0, 0.0, 0.0]\nradius_m = 0.008\n\
             extinction = 1e5\nalbedo = 0.0\ntemperature_k = 300\n",
            VIEW.replace("columns = 9\nrows = 7\n", &format!("columns = 18\nrows = 14\n{camera}"))
        )
    };
    let covered = |text: &str| {
        let [plate, se] = image(folder.path(), text, ["a_plate", "se_plate"]);
        let cells = 0.0025 * 0.0025;
        let sum = plate.iter().map(|a| (1.0 - a) * cells).sum::<f64>();
        (
            sum,
            plate.iter().filter(|a| **a > 0.01 && **a < 0.99).count(),
            se.iter().map(|s| s * s).sum::<f64>().sqrt() * cells,
        )
    };
    let lens = "lens = { numerical_aperture = 0.03, focus_m = 0.5 }\n";
    let motion = "[exposure]\ntime_s = 1e-4\nvelocity_m_s = [50.0, -30.0, 0.0]\n";
    let area = std::f64::consts::PI * 0.008 * 0.008;
    let mut blurred = Vec::new();
    for (camera, exposure) in [(lens, ""), ("", motion), (lens, motion)] {
        let (sum, partly, se) = covered(&scene(camera, exposure));
        println!("covered {sum:e} of {area:e}, {partly} pixels partly, declared {se:e}");
        // Sights that are slanted by up to 0.03 see the disc's outline 0.03² larger at most; 4σ of the declared error,
        // at least that of the black sphere's rim, whose pixels reach their limit of rays.
        assert!((sum - area).abs() < area * 0.0009 + 4.0 * se + 1e-7, "{sum:e} {area:e} {se:e}");
        blurred.push(partly);
    }
    // The sharp outline, a circle of 3.2 pixels, crosses 26 pixels at most.
    assert!(blurred.iter().all(|&partly| partly > 26), "{blurred:?}");
}

/// A parametric spray over an exposure: the mean of its images at Gauss–Legendre's moments, as many as its tips pass pixels.
#[test]
fn an_exposure_of_a_spray_is_the_mean_of_its_moments() {
    let folder = tempfile::tempdir().unwrap();
    let text = |time_s: f64, exposure: &str| {
        let scene = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/configs/hollow-cone.toml"))
            .unwrap();
        let scene = scene.replace("columns = 320\nrows = 256\n", "columns = 24\nrows = 18\n");
        scene.replace("time_s = 0.0003\n", &format!("time_s = {time_s:?}\ncell_m = 1e-3\n")) + exposure
    };
    let exposure = "[exposure]\ntime_s = 80e-6\n";
    let arguments = ["--json", "--target-error", "1e-2", "--out", "a.exr"];
    let channels = |scene: &str| {
        let output = render(folder.path(), scene, &arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let stats: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let image = exr::prelude::read_first_flat_layer_from_file(folder.path().join("a.exr")).unwrap();
        let values = ["a_plate", "a_medium", "radiance"].map(|name| {
            let found = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
            found.sample_data.values_as_f32().map(f64::from).collect::<Vec<_>>()
        });
        (values, stats)
    };
    let (blurred, stats) = channels(&text(3e-4, exposure));
    let count = stats["exposure_moments"].as_f64().unwrap();
    let pixels = stats["exposure_pixels"].as_f64().unwrap();
    println!("{count} moments for {pixels} pixels");
    assert!((2.0..=8.0).contains(&count) && count < pixels + 1.0, "{count} {pixels}");
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 2 to 8")]
    let count = count as usize;
    let mut mean = blurred.clone().map(|v| vec![0.0; v.len()]);
    for (x, weight) in ditd_sim::light::quadrature::gauss_legendre(count) {
        let (still, _) = channels(&text(3e-4 + 40e-6 * x, ""));
        for (mean, still) in mean.iter_mut().zip(&still) {
            mean.iter_mut().zip(still).for_each(|(m, s)| *m += 0.5 * weight * s);
        }
    }
    for (blurred, mean) in blurred.iter().zip(&mean) {
        for (a, b) in blurred.iter().zip(mean) {
            // Sums of f32.
            assert!((a - b).abs() <= 1e-6 * b.abs().max(1e-3), "{a} {b}");
        }
    }
    // A moment is one moment, and one that begins before the spray is none.
    let (still, _) = channels(&text(3e-4, ""));
    let (short, stats) = channels(&text(3e-4, "[exposure]\ntime_s = 0.0\n"));
    assert_eq!(still, short);
    assert!(stats.get("exposure_moments").is_none());
    let output = render(folder.path(), &text(3e-5, exposure), &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("[exposure] time_s"));
}

#[test]
fn senseless_values_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let pinhole =
        VIEW.replace("telecentric", "pinhole").replace("width_m = 0.045", "horizontal_fov_deg = 5.0");
    let camera =
        |view: &str, lens: &str| format!("{}{SLAB}", view.replace("[walls]", &format!("{lens}\n[walls]")));
    let plate = |extra: &str| format!("{VIEW}{PLATE}{extra}{SLAB}");
    let exposure = |text: &str| format!("{VIEW}[exposure]\n{text}\n{SLAB}");
    let near = format!(
        "{VIEW}[lab]\ntemperature_k = 296\n{}{PLATE}{SLAB}",
        window(-0.1, 400.0, "mirrors = \"chamber\"\n")
    );
    for (scene, words) in [
        (
            camera(&pinhole, "lens = { f_number = 0, focal_length_m = 0.05 }"),
            vec!["[camera] lens", "f_number"],
        ),
        (
            camera(&pinhole, "lens = { f_number = 2.5 }"),
            vec!["[camera] lens", "focal_length_m", "aperture_m"],
        ),
        (
            camera(&pinhole, "lens = { f_number = 2.5, focal_length_m = 0.7 }"),
            vec!["focal_length_m", "focus_m"],
        ),
        (camera(&pinhole, "lens = { aperture_m = -0.1 }"), vec!["aperture_m"]),
        (camera(&pinhole, "lens = { aperture_m = 0.01, focus_m = nan }"), vec!["focus_m"]),
        (camera(&pinhole, "lens = { fnumber = 2.5 }"), vec!["fnumber", "f_number"]),
        (camera(VIEW, "lens = { aperture_m = 0.01 }"), vec!["telecentric", "numerical_aperture"]),
        (camera(VIEW, "lens = { numerical_aperture = 1.2 }"), vec!["numerical_aperture", "0.9"]),
        (plate("non_uniformity_k = inf\n"), vec!["[plate] non_uniformity_k"]),
        (plate("non_uniformity_k = 1\nnon_uniformity_npy = \"a.npy\"\n"), vec!["exclude"]),
        (plate("emissivity = 1.5\n"), vec!["[plate] emissivity"]),
        (plate("emissivity = \"none.csv\"\n"), vec!["none.csv"]),
        (plate("mirrors = \"laboratory\"\n"), vec!["[lab]"]),
        (plate("mirrors = \"sky\"\n"), vec!["sky", "walls", "laboratory"]),
        (exposure("time_s = -1.0"), vec!["[exposure] time_s"]),
        (exposure("time_s = 1e-5\nvelocity_m_s = [0.0, inf, 0.0]"), vec!["[exposure] velocity_m_s"]),
        (exposure("time = 1e-5"), vec!["time_s"]),
        (near, vec!["[window] mirrors", "plate's side"]),
    ] {
        let output = render(folder.path(), &scene, &[]);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{words:?}: {told}");
        assert!(words.iter().all(|w| told.contains(w)), "{words:?}: {told}");
    }
}
