//! Scene files through the reader, the tracer and the lights: every kind of medium, the shipped spray, and windows.

use ditd_sim::light::fuel::Fuel;
use ditd_sim::light::window::{Material, Plate as Glass};
use ditd_sim::scene::compact;
use ditd_sim::scene::field::GasCell;
use ditd_sim::scene::file::{self, MediumSource, Scene, SceneError};
use ditd_sim::scene::lights::{Lights, Share};
use ditd_sim::scene::optics::OpticsOptions;
use ditd_sim::tracer::camera::{Camera, PixelFilter};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::plate::Plate;
use ditd_sim::tracer::rays::{RayOptions, render_rays};
use ditd_sim::tracer::shape::Body;
use std::path::Path;

const VIEW: &str = r#"
[camera]
kind = "pinhole"
position_m = [0.0, -0.6, -0.025]
look_at_m = [0.0, 0.0, -0.025]
up = [0.0, 0.0, 1.0]
columns = 32
rows = 24
horizontal_fov_deg = 6.68
[plate]
shape = "disc"
centre_m = [0.0, 0.5, -0.025]
facing = [0.0, -1.0, 0.0]
diameter_m = 0.3
temperature_k = 433.0
[walls]
temperature_k = 523.0
"#;

const SPRAY: &str = r#"
[medium]
kind = "cfd"
path = "eighthole_4bar_523K_0.9ms"
fuel = "n-heptane"
cell_m = 0.002
"#;

const BAND: &str = "[band]\nwavelength_um = 3.4\n";

fn scene_in(folder: &Path, text: &str) -> Result<Scene, SceneError> {
    let path = folder.join("scene.toml");
    std::fs::write(&path, text).expect("a sound scene");
    file::load(&path).and_then(|scene| scene.with_spray(&OpticsOptions::default()))
}

fn scene(text: &str) -> Result<Scene, SceneError> {
    scene_in(tempfile::tempdir().expect("a sound scene").path(), text)
}

/// One ray through the middle of the picture, 5 mm beside the axis: a share per spectral group.
fn shares(scene: &Scene) -> Vec<Share> {
    let plate = scene.plate.as_ref().map(|p| Plate::new(&p.shape).expect("a sound scene"));
    let bodies = match scene.medium.as_ref().expect("a sound scene") {
        MediumSource::Shape(shape, _) => vec![Body::shape(shape).expect("a sound scene")],
        MediumSource::Grid(grid, _) => vec![Body::grid(grid, 0).expect("a sound scene")],
        MediumSource::Spectral(grid, _) => {
            (0..grid.groups).map(|g| Body::grid(grid, g).expect("a sound scene")).collect()
        }
        MediumSource::Cfd(_) | MediumSource::Parametric(_) => panic!("the spray is made"),
    };
    let options = RayOptions { target_error: 3e-3, seed: 1, paths_max: 1 << 14, ..RayOptions::default() };
    let ray = ([0.005, -0.6, -0.025], [0.0, 2.0, 0.0]);
    let share = |body: &Body<'_>| {
        let answer = render_rays(body, &[ray], plate.as_ref(), &options).expect("a sound scene").remove(0);
        Share {
            plate: answer.plate,
            walls: answer.walls,
            medium: answer.medium[0],
            emission: answer.medium.get(1).copied().unwrap_or(0.0),
            se: [answer.se_plate, answer.se_walls, answer.se_medium[0]],
            ..Share::default()
        }
    };
    bodies.iter().map(share).collect()
}

#[test]
fn every_kind_of_medium_is_read_traced_and_lit() {
    let folder = tempfile::tempdir().unwrap();
    // An array of 2×2×2 in NPY, version 1.
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    let mut head = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 2, 2), }".to_owned();
    while !(10 + head.len() + 1).is_multiple_of(64) {
        head.push(' ');
    }
    head.push('\n');
    npy.extend(u16::try_from(head.len()).unwrap().to_le_bytes());
    npy.extend(head.as_bytes());
    (0..8).for_each(|_| npy.extend(50.0_f64.to_le_bytes()));
    std::fs::write(folder.path().join("sigma.npy"), npy).unwrap();
    let gray = "albedo = 0.5\ntemperature_k = 450\n";
    for kind in [
        "kind = \"slab\"\noptical_depth = 1.0\nthickness_m = 0.02",
        "kind = \"sphere\"\ncentre_m = [0, 0, -0.025]\nradius_m = 0.01\nextinction = 50",
        "kind = \"cylinder\"\ncentre_m = [0, 0, 0]\naxis = [0, 0, 1]\nradius_m = 0.01\nextinction = 50",
        "kind = \"gaussian\"\ncentre_m = [0, 0, -0.025]\nwidth_m = 0.01\nextinction = 50",
        "kind = \"box\"\nlower_m = [-0.01, -0.01, -0.03]\nupper_m = [0.01, 0.01, -0.02]\nextinction = 50",
        "kind = \"grid\"\nlower_m = [-0.01, -0.01, -0.03]\nupper_m = [0.01, 0.01, -0.02]\nextinction_npy = \"sigma.npy\"",
    ] {
        let scene = scene_in(folder.path(), &format!("{VIEW}{BAND}[medium]\n{kind}\n{gray}")).unwrap();
        let shares = shares(&scene);
        let lights = Lights::new(&scene);
        let seen = lights.see(&shares);
        // A slab is parallel to this ray, which passes below it.
        assert_eq!(seen.medium > 0.05, !kind.contains("slab"), "{kind}: {seen:?}");
        assert!((seen.plate + seen.walls + seen.medium - 1.0).abs() < 1e-14, "{kind}: {seen:?}");
        let band = scene.band.as_ref().unwrap();
        let light = seen.plate * band.radiance(433.0)
            + seen.walls * band.radiance(523.0)
            + seen.medium * band.radiance(450.0);
        assert!((seen.radiance / light - 1.0).abs() < 1e-12, "{kind}: {seen:?} {light}");
    }
}

/// A phase function without its peak: absorption stays to rounding, scattering loses the share that the note tells, and
/// bad angles are refused with their line.
#[test]
fn a_truncated_peak_changes_scattering_only() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("phase.csv"), "theta_deg,p11\n0,4000\n1,900\n4,20\n90,0.2\n180,0.1\n")
        .unwrap();
    let with = |phase: &str| {
        let medium =
            "kind = \"sphere\"\ncentre_m = [0, 0, 0]\nradius_m = 0.01\nextinction = 50\nalbedo = 0.8";
        scene_in(folder.path(), &format!("[medium]\n{medium}\nphase = {{ {phase} }}\n"))
    };
    let coefficients = |scene: &Scene| {
        let Some(MediumSource::Shape(medium, _)) = &scene.medium else { panic!("a sphere") };
        let ditd_sim::tracer::shape::Shape::Sphere { extinction, .. } = medium.shape else {
            panic!("a sphere")
        };
        (extinction * medium.albedo, extinction * (1.0 - medium.albedo))
    };
    for phase in ["kind = \"henyey-greenstein\", asymmetry = 0.9", "kind = \"table\", file = \"phase.csv\""] {
        let whole = with(phase).unwrap();
        let cut = with(&format!("{phase}, truncate_deg = 2")).unwrap();
        let ((before, absorbed), (after, still)) = (coefficients(&whole), coefficients(&cut));
        assert!((absorbed - 10.0).abs() < 1e-13 && (still - absorbed).abs() < 1e-12, "{absorbed} {still}");
        let fraction = 1.0 - after / before;
        assert!((0.02..0.9).contains(&fraction), "{fraction}");
        let note = cut.notes.iter().find(|note| note.contains("unscattered")).unwrap();
        assert!(note.contains(&format!("{fraction:.4}")) && note.contains("2 deg"), "{note}");
        // A table says that it was renormalised.
        assert_eq!(cut.notes.iter().any(|note| note.contains("phase.csv: norm")), phase.contains("table"));
        for bad in ["0", "-1", "91", "nan"] {
            let error = with(&format!("{phase}, truncate_deg = {bad}")).unwrap_err().to_string();
            assert!(error.contains("truncate_deg") && error.contains("scene.toml"), "{error}");
        }
    }
    assert!(with("kind = \"isotropic\", truncate_deg = 2").is_err());
}

/// The same for a spray, and what its coefficients took.
#[test]
fn a_spray_says_what_its_coefficients_took() {
    let whole = scene(&format!("{VIEW}{BAND}{SPRAY}")).unwrap();
    let cut = scene(&format!("{VIEW}{BAND}{SPRAY}truncate_deg = 2\n")).unwrap();
    let grid = |scene: &Scene| {
        let Some(MediumSource::Spectral(grid, _)) = &scene.medium else { panic!("a spectral grid") };
        grid.clone()
    };
    let (a, b) = (grid(&whole), grid(&cut));
    let left: f64 = b.k_sca.iter().sum::<f64>() / a.k_sca.iter().sum::<f64>();
    assert!((0.2..0.99).contains(&left), "{left}");
    for i in 0..a.k_ext.len() {
        let (before, after) = (a.k_ext[i] - a.k_sca[i], b.k_ext[i] - b.k_sca[i]);
        assert!((before - after).abs() <= 1e-14 * a.k_ext[i], "{i}: {before} {after}");
    }
    assert_eq!(a.emission, b.emission);
    let report = whole.optics.unwrap();
    assert!(report.mie_spheres > report.spheres && report.vapour_nodes > 0 && report.phase_tables == 1);
    assert!(report.skipped.is_empty() && whole.notes.iter().any(|note| note.contains("Mie calculations")));
}

/// The shipped spray on a grid: where there are no droplets, the absorption along sights is the closed form of the
/// CFD's own cells, Σ concentration × cross-section × length, as mean over the
/// width of a cell of the grid.
/// And its image is one that such columns can give.
#[test]
fn the_shipped_spray_absorbs_as_its_columns() {
    let scene = scene(&format!("{VIEW}{BAND}{SPRAY}")).unwrap();
    let Some(MediumSource::Spectral(grid, band)) = &scene.medium else { panic!("a spectral grid") };
    assert_eq!((grid.groups, grid.channels, band.len()), (1, 2, 1));
    let spray = compact::shipped().unwrap();
    let fuel = Fuel::named("n-heptane").unwrap();
    let scattering = GridMedium { k_ext: grid.k_sca.clone(), ..grid.as_ref().clone() };
    let [whole, scattering] = [grid, &scattering].map(|g| Body::grid(g, 0).unwrap());
    let step: [f64; 3] = [0, 1, 2].map(|a| (grid.upper_m[a] - grid.lower_m[a]) / grid.cells[a] as f64);
    let (mut found, mut wanted, mut sights) = (0.0, 0.0, 0);
    for i in 0..grid.cells[0] {
        for k in 0..grid.cells[2] {
            let low = [grid.lower_m[0] + i as f64 * step[0], grid.lower_m[2] + k as f64 * step[2]];
            let ray = ([low[0] + 0.5 * step[0], -1.0, low[1] + 0.5 * step[2]], [0.0, 1.0, 0.0]);
            let depth = whole.optical_depth(ray.0, ray.1);
            if depth < 0.01 || scattering.optical_depth(ray.0, ray.1) > 1e-3 * depth {
                continue;
            }
            found += depth;
            sights += 1;
            let overlap = |c: &GasCell, a: usize, low: f64| {
                ((low + step[a]).min(c.upper_m[a]) - low.max(c.lower_m[a])).max(0.0)
            };
            let columns = spray.cells.iter().flatten().map(|c| {
                let moles = c.density_kg_m3 * c.fuel_mass_fraction / spray.fuel_molar_mass_kg_mol;
                let area = overlap(c, 0, low[0]) * overlap(c, 2, low[1]);
                let cross_section = fuel.vapour_cross_section_m2_mol(3.4, c.temperature_k);
                moles * cross_section * area * (c.upper_m[1] - c.lower_m[1])
            });
            wanted += columns.sum::<f64>() / (step[0] * step[2]);
        }
    }
    println!("{sights} sights: {found} on the grid, {wanted} in the CFD's cells");
    assert!(sights >= 5, "{sights}");
    assert!((found / wanted - 1.0).abs() < 0.01, "{sights} sights: {found} {wanted}");

    let plate = scene.plate.as_ref().map(|p| &p.shape);
    let camera = Camera { pixel_filter: PixelFilter::Centre, ..scene.camera.clone().unwrap() };
    let options = RenderOptions { target_error: 3e-3, ..RenderOptions::default() };
    let image = render_image(grid, &camera, plate, &options, &|_| {}).unwrap();
    assert!(image.pixels.len() > 100, "{}", image.pixels.len());
    let sights = camera.sights().unwrap();
    for (i, &pixel) in image.pixels.iter().enumerate().step_by(7) {
        let (row, column) = (pixel as usize / 32, pixel as usize % 32);
        let (origin, direction) = sights.ray(row as f64 + 0.5, column as f64 + 0.5);
        let depth = whole.optical_depth(origin, direction);
        let [plate, medium] = [image.a_plate[i], image.emission[2 * i]].map(f64::from);
        // What is absorbed is at most what is stopped, but for light that is scattered on longer ways.
        assert!(medium <= -(-depth).exp_m1() + 0.05, "{medium} {depth}");
        assert!(plate + medium <= 1.0 + 1e-6 && plate >= 0.0 && medium >= 0.0);
    }
}

/// Placed, the spray's tip and axis are where the scene wants them.
#[test]
fn a_spray_is_put_where_the_scene_says() {
    let at = |extra: &str| {
        let scene = scene(&format!("{VIEW}{BAND}{SPRAY}{extra}")).unwrap();
        let Some(MediumSource::Spectral(grid, _)) = scene.medium else { panic!("a spectral grid") };
        [grid.lower_m, grid.upper_m]
    };
    let (still, moved) = (at(""), at("scene_tip_m = [0.1, 0.2, 0.3]\n"));
    for (a, b) in still.iter().zip(&moved) {
        for (k, by) in [0.1, 0.2, 0.3].into_iter().enumerate() {
            assert!((b[k] - a[k] - by).abs() < 1e-9, "{still:?} {moved:?}");
        }
    }
    let turned = at("axis = [0, 0, -1]\nscene_axis = [0, 1, 0]\n");
    // What was below is now along y.
    assert!((turned[1][1] + still[0][2]).abs() < 1e-9, "{still:?} {turned:?}");
}

fn window(y: f64, t: f64) -> String {
    format!(
        "[[window]]\nposition_m = [0.0, {y}, -0.025]\nnormal = [0.0, 1.0, 0.0]\nmaterial = \"CaF2\"\n\
         thickness_m = 0.01\ntemperature_k = {t}\n"
    )
}

/// Between two windows: β γ_n [a_plate (γ_f I(T_P) + E_f) + spray and walls] + offset with E_f = A_f I(T_f) + R_f I(T_E)
/// and the offset A_n I(T_n) + R_n I(T_lab); all coefficients sum to 1.
#[test]
fn a_pair_of_windows_combines_as_the_equation_says() {
    let sphere = "[medium]\nkind = \"sphere\"\ncentre_m = [0, 0, -0.025]\nradius_m = 0.01\nextinction = 50\nalbedo = 0.5\n\
         temperature_k = 450\n";
    let text = format!(
        "{VIEW}{BAND}[lab]\ntemperature_k = 296\n{}{}{sphere}",
        window(-0.1, 400.0),
        window(0.1, 470.0)
    );
    let scene = scene(&text).unwrap();
    let shares = shares(&scene);
    let [share] = shares.as_slice() else { panic!("one share") };
    let seen = Lights::new(&scene).see(&shares);
    let sum = seen.plate + seen.walls + seen.medium + seen.window + seen.camera_side;
    assert!((sum - 1.0).abs() < 1e-14, "{seen:?}");
    let glass = Glass { material: Material::CalciumFluoride, thickness_m: 0.01 };
    let (n, f) = (glass.optics(3.4, 400.0), glass.optics(3.4, 470.0));
    let b = |t| scene.band.as_ref().unwrap().radiance(t);
    let far = f.absorptance * b(470.0) + f.reflectance * b(523.0);
    let inside =
        share.plate * (f.transmittance * b(433.0) + far) + share.walls * b(523.0) + share.medium * b(450.0);
    let wanted = n.transmittance * inside + n.absorptance * b(400.0) + n.reflectance * b(296.0);
    assert!((seen.radiance / wanted - 1.0).abs() < 1e-13, "{seen:?} {wanted}");
    assert!((seen.plate - n.transmittance * f.transmittance * share.plate).abs() < 1e-15);
    // All at one temperature looks like that temperature.
    let even = ["433.0", "523.0", "296", "400", "470", "450"]
        .iter()
        .fold(text, |text, t| text.replace(&format!("temperature_k = {t}"), "temperature_k = 500"));
    let even = self::scene(&even).unwrap();
    let seen = Lights::new(&even).see(&shares);
    assert!((seen.radiance / b(500.0) - 1.0).abs() < 1e-13, "{seen:?}");
}

/// Over a band each coefficient times the band radiance of its source is its light, and one temperature everywhere
/// looks like it.
#[test]
fn bands_weigh_coefficients_with_the_light_of_their_source() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("filter.csv"), "wavelength_um,response\n3.2,0\n3.3,1\n3.5,1\n3.6,0\n")
        .unwrap();
    let band = "[band]\nresponse = \"filter.csv\"\nsamples = 3\n";
    let scene = scene_in(folder.path(), &format!("{VIEW}{band}{SPRAY}")).unwrap();
    let shares = shares(&scene);
    // Three in band, and what leaks beside it.
    assert_eq!(shares.len(), 4);
    let lights = Lights::new(&scene);
    let seen = lights.see(&shares);
    let Some(MediumSource::Spectral(_, samples)) = &scene.medium else { panic!("a spectral grid") };
    let light =
        seen.plate * samples.signal(433.0) + seen.walls * samples.signal(523.0) + seen.radiance_medium;
    assert!((seen.radiance / light - 1.0).abs() < 1e-12, "{seen:?} {light}");
    // The medium's light corresponds to a temperature between those of droplets and gas.
    let t = samples.inverse(seen.radiance_medium / seen.medium).unwrap();
    assert!((300.0..523.0).contains(&t), "{t} K, {seen:?}");
    for g in 0..4 {
        let seen = lights.see_group(&shares, g);
        assert!((seen.plate + seen.walls + seen.medium - 1.0).abs() < 1e-14, "{g}: {seen:?}");
    }
}

#[test]
fn errors_name_file_and_line() {
    let says = |text: &str, words: &[&str]| {
        let error = scene(text).unwrap_err().to_string();
        assert!(words.iter().all(|w| error.contains(w)), "{words:?}: {error}");
    };
    // VIEW has 17 lines, the first one empty.
    says(&format!("{VIEW}{SPRAY}"), &["scene.toml", "line 20", "needs a [band]"]);
    says(&format!("{VIEW}{BAND}{}", SPRAY.replace("n-heptane", "water")), &["line 24", "water", "n-octane"]);
    says(&format!("{VIEW}{BAND}{}", SPRAY.replace("eight", "nine")), &["scene.toml", "ninehole"]);
    says(&format!("{VIEW}{BAND}{SPRAY}time_s = 0.5\n"), &["line 26", "0.0009"]);
    says(&format!("{VIEW}{BAND}{}", window(-0.1, 400.0)), &["line 20", "[lab]"]);
    let lab = "[lab]\ntemperature_k = 296\n";
    says(&format!("{VIEW}{lab}{}", window(-0.1, 400.0)), &["[band]"]);
    let wood = window(0.1, 400.0).replace("CaF2", "wood");
    says(&format!("{VIEW}{BAND}{lab}{}{wood}", window(-0.1, 400.0)), &["line 31", "wood", "sapphire"]);
    says(
        &format!("{VIEW}{BAND}{lab}{}{}", window(-0.1, 400.0), window(-0.2, 400.0)),
        &["second window", "camera"],
    );
    let askew = window(-0.1, 400.0).replace("normal = [0.0, 1.0", "normal = [1.0, 1.0");
    says(&format!("{VIEW}{BAND}{lab}{askew}"), &["line 24", "20°"]);
    let small = format!("{}diameter_m = 0.01\n", window(-0.1, 400.0));
    says(&format!("{VIEW}{BAND}{lab}{small}"), &["diameter_m", "past"]);
    says("[band]\nresponse = \"none.csv\"\n", &["none.csv"]);
    says("[band]\nwavelength_um = 3.4\nsamples = \"many\"\n", &["line 3", "auto"]);
}

/// The shipped scene of the eight-hole spray in front of two plates, coarsely: against 500 K the wet plumes are dark and
/// their hot rims bright, against 400 K all of the spray is brighter than the plate.
#[test]
fn the_eight_hole_spray_is_dark_before_a_hot_plate_and_bright_before_a_cold_one() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/figure7.toml");
    let options = OpticsOptions { target_error: 0.02 };
    let mut scene = file::load(&path).unwrap().with_spray(&options).unwrap();
    assert!(scene.shots.is_some());
    let plate = scene.plate.clone().unwrap();
    assert_eq!(plate.temperatures_k, [400.0, 500.0]);
    let Some(MediumSource::Spectral(medium, _)) = &scene.medium else { panic!("the spray is made") };
    let camera = Camera { columns: 96, rows: 77, ..scene.camera.clone().unwrap() };
    let render = RenderOptions { target_error: 0.02, ..RenderOptions::default() };
    let operator = render_image(medium, &camera, Some(&plate.shape), &render, &|_| {}).unwrap();
    let shares: Vec<Share> = (0..operator.pixels.len())
        .map(|i| {
            let (plate, medium) = (f64::from(operator.a_plate[i]), f64::from(operator.emission[2 * i]));
            let emission = f64::from(operator.emission[2 * i + 1]);
            Share { plate, walls: 1.0 - plate - medium, medium, emission, ..Share::default() }
        })
        .filter(|share| share.medium > 0.5)
        .collect();
    assert!(shares.len() > 500, "{} pixels of spray", shares.len());
    let band = scene.band.clone().unwrap();
    let mut darker = |kelvin: f64| {
        if let Some(plate) = &mut scene.plate {
            plate.temperature_k = Some(kelvin);
        }
        let lights = Lights::new(&scene);
        let plate = band.radiance(kelvin);
        let dark = shares.iter().filter(|share| lights.see(&[**share]).radiance < plate).count();
        dark as f64 / shares.len() as f64
    };
    let (cold, hot) = (darker(400.0), darker(500.0));
    assert!(cold < 0.05, "{cold}");
    assert!((0.3..0.97).contains(&hot), "{hot}");
}

#[test]
fn parametric_sprays_are_refused_with_line_and_guess() {
    let head = "[medium]\nkind = \"multi-hole\"\nfuel = \"n-heptane\"\n";
    let error = |text: &str| scene(&format!("{VIEW}{BAND}{head}{text}")).unwrap_err().to_string();
    let message = error("[medium.injector]\nholes = 8\nhole_diameter_m = -1.0\n");
    let line = format!("{VIEW}{BAND}{head}").lines().count() + 3;
    assert!(message.contains(&format!("line {line}")), "{message}");
    assert!(message.contains("hole_diameter_m is -1") && message.contains("0.00002 to 0.002"), "{message}");
    let message = error("[medium.injector]\nhole_diametre_m = 1e-4\n");
    assert!(message.contains("did you mean `hole_diameter_m`?"), "{message}");
    let message = error("time = 1e-3\n");
    assert!(message.contains("time_s"), "{message}");
    let message =
        scene(&format!("{VIEW}{BAND}{}", head.replace("multi-hole", "multihole"))).unwrap_err().to_string();
    assert!(message.contains("did you mean `multi-hole`?"), "{message}");
    let message = scene(&format!("{VIEW}{head}")).unwrap_err().to_string();
    assert!(message.contains("multi-hole") && message.contains("[band]"), "{message}");
    let message = error("[medium.gas]\ntemperature_k = 2000\n");
    assert!(message.contains("temperature_k is 2000"), "{message}");
}

/// The hollow cone of the shipped scene, seen by single rays: its sheet is opaque to the plate beside the axis; on the
/// axis, above the sheet's closing point, light passes twice through it.
#[test]
fn the_hollow_cone_is_read_and_traced() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/hollow-cone.toml");
    let scene = file::load(&path).unwrap().with_spray(&OpticsOptions { target_error: 0.02 }).unwrap();
    let Some(MediumSource::Spectral(medium, _)) = &scene.medium else { panic!("the spray is made") };
    let depth = |x: f64| -> f64 {
        let size: Vec<f64> =
            (0..3).map(|a| (medium.upper_m[a] - medium.lower_m[a]) / medium.cells[a] as f64).collect();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "places inside the grid")]
        let place = |a: usize, v: f64| ((v - medium.lower_m[a]) / size[a]) as usize;
        let (ix, iz) = (place(0, x), place(2, -0.010));
        (0..medium.cells[1])
            .map(|iy| medium.index[(ix * medium.cells[1] + iy) * medium.cells[2] + iz])
            .filter(|&index| index != ditd_sim::tracer::medium::EMPTY)
            .map(|index| medium.k_ext[index as usize] * size[1])
            .sum()
    };
    // 10 mm below the tip the sheet is at 12 mm from the axis: along its tangent there is most of it.
    let (axis, tangent, outside) = (depth(0.0), depth(0.0118), depth(0.017));
    assert!(axis > 0.5 && tangent > 1.5 * axis && outside < 0.05 * axis, "{axis} {tangent} {outside}");
}
