//! Work that is left out by proof: each test shows that it was really not done, and that the answer moved by less than was
//! stated.

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::light::planck::photon_radiance;
use ditd_sim::scene::file::{self, MediumSource};
use ditd_sim::scene::lights::{Lights, Share};
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;
use ditd_sim::tracer::relight::Lighting;

const CELLS: usize = 24;
const COLUMNS: usize = 40;
const ROWS: usize = 30;

/// A blob of optical depth 3 in the middle of a cube from −1 to 1, empty around, of one or several equal groups.
fn blob(albedo: f64, groups: usize) -> GridMedium {
    let mut medium = GridMedium {
        lower_m: [-1.0; 3],
        upper_m: [1.0; 3],
        cells: [CELLS; 3],
        groups,
        channels: 1,
        index: vec![EMPTY; CELLS.pow(3)],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.8 }; groups],
    };
    let mut occupied = 0;
    for place in 0..CELLS.pow(3) {
        let at = [place / CELLS / CELLS, place / CELLS % CELLS, place % CELLS]
            .map(|i| (i as f64 + 0.5) / CELLS as f64 * 2.0 - 1.0);
        let square: f64 = at.iter().map(|x| x * x).sum();
        if square > 0.2 {
            continue;
        }
        let k = 6.0 * (-square / 0.08).exp();
        medium.index[place] = occupied;
        occupied += 1;
        medium.k_ext.extend(vec![k; groups]);
        medium.k_sca.extend(vec![albedo * k; groups]);
        medium.emission.extend(vec![(1.0 - albedo) * k; groups]);
    }
    medium
}

fn camera(look_at_m: [f64; 3]) -> Camera {
    Camera {
        projection: Projection::Telecentric { width_m: 2.4 },
        position_m: [look_at_m[0], -3.0, look_at_m[2]],
        look_at_m,
        up: [0.0, 0.0, 1.0],
        columns: COLUMNS,
        rows: ROWS,
        pixel_filter: PixelFilter::Box,
        lens: None,
    }
}

const PLATE: PlateShape = PlateShape::Rectangle {
    centre_m: [0.0, 1.5, 0.0],
    facing: [0.0, -1.0, 0.0],
    width_m: 6.0,
    height_m: 6.0,
};

fn render(medium: &GridMedium, target_error: f64) -> Operator {
    seen_by(medium, &camera([0.0; 3]), target_error)
}

fn seen_by(medium: &GridMedium, camera: &Camera, target_error: f64) -> Operator {
    let options = RenderOptions { target_error, ..RenderOptions::default() };
    render_image(medium, camera, Some(&PLATE), &options, &|_| {}).expect("a sound scene")
}

fn stat(image: &Operator, name: &str) -> Option<f64> {
    image.stats.iter().find(|(n, _)| n == name).map(|(_, v)| *v)
}

/// Plate and medium of all pixels: those that meet no medium see the plate, which fills the view.
fn whole(image: &Operator) -> [Vec<f64>; 2] {
    let mut all = [vec![1.0; ROWS * COLUMNS], vec![0.0; ROWS * COLUMNS]];
    for (i, &pixel) in image.pixels.iter().enumerate() {
        all[0][pixel as usize] = f64::from(image.a_plate[i]);
        all[1][pixel as usize] = f64::from(image.emission[i]);
    }
    all
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(s, n), v| (s + v * v, n + 1.0));
    f64::sqrt(sum / count)
}

/// Below a tenth of the target no path is traced, and no pixel moves by more than the albedo; just above, paths are.
#[test]
fn scattering_below_the_target_is_left_out() {
    for target in [1e-2, 1e-3] {
        let limit = 0.1 * target;
        let faint = blob(0.9 * limit, 1);
        // One sight through the middle of each pixel: what differs is what is scattered.
        let camera = Camera { pixel_filter: PixelFilter::Centre, ..camera([0.0; 3]) };
        let skipped = seen_by(&faint, &camera, target);
        assert_eq!(stat(&skipped, "skipped_scattering"), Some(1.0));
        for work in ["paths", "scatterings", "leaves"] {
            assert!(stat(&skipped, work).is_none(), "{work} at {target}");
        }
        let stated = stat(&skipped, "skipped_scattering_error").unwrap();
        // The albedo, to the rounding of 1 − ω in single precision.
        assert!((stated - 0.9 * limit).abs() < 6e-8 && stated < limit, "{stated}");
        // A finer target traces it.
        let traced = seen_by(&faint, &camera, 0.5 * target);
        assert!(stat(&traced, "paths").unwrap() > 100.0 && stat(&traced, "skipped_scattering").is_none());
        // What scattered light adds to a pixel is at most the albedo.
        let noise = rms(traced.error_plate.iter().map(|e| f64::from(*e)));
        assert_eq!(traced.pixels, skipped.pixels);
        for (a, b) in whole(&traced).iter().zip(&whole(&skipped)) {
            let moved = rms(traced.pixels.iter().map(|&pixel| a[pixel as usize] - b[pixel as usize]));
            println!("{target}: moved {moved:.1e}, stated {stated:.1e}, noise {noise:.1e}");
            assert!(moved > 0.0 && moved <= stated + 3.0 * noise, "{target}: {moved} {stated} {noise}");
            // Without any doubt it is not what a tenth of the target would hide.
            assert!(3.0 * noise < stated, "{target}: {noise} {stated}");
        }
        let above = render(&blob(1.1 * limit, 1), target);
        assert!(stat(&above, "paths").unwrap() > 100.0 && stat(&above, "skipped_scattering").is_none());
    }
}

/// Asked not to, nothing is scattered, and what would have been is lost: the stated error is that of doing as told, none.
#[test]
fn scattering_that_is_not_asked_for_is_not_traced() {
    let options = RenderOptions { scatter: false, ..RenderOptions::default() };
    let image = render_image(&blob(0.5, 1), &camera([0.0; 3]), Some(&PLATE), &options, &|_| {}).unwrap();
    assert!(stat(&image, "paths").is_none());
    assert_eq!(stat(&image, "skipped_scattering_error"), Some(0.0));
    let straight = image.a_plate.iter().zip(&image.emission).map(|(a, e)| a + e);
    assert!(straight.fold(f32::INFINITY, f32::min) < 0.6, "half of what is met is lost");
}

/// Pixels whose sights meet no medium are the plate or the walls, exactly, and cost nothing.
#[test]
fn untouched_pixels_are_exact_and_free() {
    let medium = blob(0.5, 1);
    let image = render(&medium, 4e-3);
    let active = image.pixels.len();
    assert_eq!(stat(&image, "pixels"), Some((ROWS * COLUMNS) as f64));
    assert_eq!(stat(&image, "pixels_active"), Some(active as f64));
    assert_eq!(stat(&image, "pixels_skipped"), Some((ROWS * COLUMNS - active) as f64));
    assert!(active > 50 && active < ROWS * COLUMNS / 2, "{active}");
    assert_eq!((image.a_plate.len(), image.emission.len()), (active, active));
    // The plate fills the view.
    assert!(image.plate_seen.iter().all(|seen| (seen - 1.0).abs() < f32::MIN_POSITIVE));
    let mut shown = vec![0.0; ROWS * COLUMNS];
    let light =
        Lighting { plate: vec![3.0], walls: vec![1.0], ends: Vec::new(), channel: 0, medium: vec![2.0] };
    assert_eq!(image.relight(&light, &mut shown).unwrap(), active);
    for (pixel, value) in shown.iter().enumerate() {
        let met = image.pixels.binary_search(&u32::try_from(pixel).unwrap()).is_ok();
        assert!(met || (value - 3.0_f32).abs() < f32::MIN_POSITIVE, "{pixel}: {value}");
    }
    // They have no sights: a camera that looks aside does nothing at all.
    let aside = camera([5.0, 0.0, 0.0]);
    let options = RenderOptions { target_error: 4e-3, ..RenderOptions::default() };
    let image = render_image(&medium, &aside, Some(&PLATE), &options, &|_| {}).unwrap();
    assert!(image.pixels.is_empty() && stat(&image, "paths").is_none());
    assert!(stat(&image, "sights").is_none_or(|sights| sights == 0.0));
    assert_eq!(stat(&image, "skipped_scattering_error").map(|e| e <= 0.5), Some(true));
    // The plate ends at x = 3.
    let seen: Vec<f32> = image.plate_seen.clone();
    assert!(seen.iter().all(|s| s.abs() < f32::MIN_POSITIVE));
}

/// Other temperatures need no ray: an operator answers for all of them, as the sum of shares it stands for; and an
/// enclosure at one temperature needs not even its coefficients, and has no walls to see.
#[test]
fn other_temperatures_trace_nothing_and_an_isothermal_enclosure_reads_nothing() {
    let image = render(&blob(0.7, 1), 4e-3);
    let before = image.clone();
    let mut shown = vec![0.0; ROWS * COLUMNS];
    let light = |plate: f64, walls: f64, medium: f64| Lighting {
        plate: vec![plate],
        walls: vec![walls],
        ends: Vec::new(),
        channel: 0,
        medium: vec![medium],
    };
    let [cold, mild, hot] = [400.0, 450.0, 500.0].map(|t| 1e-20 * photon_radiance(3.4, t));
    for (plate, walls, medium) in [(hot, cold, mild), (cold, hot, mild), (mild, mild, hot)] {
        let read = image.relight(&light(plate, walls, medium), &mut shown).unwrap();
        assert_eq!(read, image.pixels.len());
        for (i, &pixel) in image.pixels.iter().enumerate() {
            let [a, e] = [image.a_plate[i], image.emission[i]].map(f64::from);
            let expected = a * plate + e * medium + (1.0 - a - e) * walls;
            let got = f64::from(shown[pixel as usize]);
            assert!((got / expected - 1.0).abs() < 1e-6, "{pixel}: {got} {expected}");
        }
    }
    assert_eq!(image.relight(&light(mild, mild, mild), &mut shown).unwrap(), 0);
    // Walls that fill what is missing to 1 make the sum of the shares times one radiance: nothing moved but roundings.
    assert!(shown.iter().all(|v| (f64::from(*v) / mild - 1.0).abs() < 1e-7));
    assert_eq!((image.stats, image.a_plate), (before.stats, before.a_plate));
}

/// A gray medium is traced at one wavelength however wide the band; several equal wavelengths say the same.
#[test]
fn gray_media_are_traced_at_one_wavelength() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("filter.csv"),
        "wavelength_um,response\n3.0,0.0\n3.2,0.7\n3.6,0.9\n4.4,0.2\n5.0,0.0\n",
    )
    .unwrap();
    let path = folder.path().join("scene.toml");
    std::fs::write(
        &path,
        "[plate]\nshape = \"disc\"\ncentre_m = [0, 1, 0]\nfacing = [0, -1, 0]\ndiameter_m = 1\ntemperature_k = 500\n\
         [walls]\ntemperature_k = 300\n[band]\nresponse = \"filter.csv\"\nsamples = \"auto\"\n\
         [medium]\nkind = \"sphere\"\ncentre_m = [0, 0, 0]\nradius_m = 0.1\nextinction = 5\nalbedo = 0.4\n\
         temperature_k = 450\n",
    )
    .unwrap();
    let scene = file::load(&path).unwrap();
    assert!(matches!(scene.medium, Some(MediumSource::Shape(..))), "gray: one group");
    // Seen through one group, the radiance is that of the whole band: each of 20 000 wavelengths by Planck's law.
    let share = Share { plate: 0.5, walls: 0.3, medium: 0.2, ..Share::default() };
    let seen = Lights::new(&scene).see(&[share]);
    let nodes = [(3.0, 0.0), (3.2, 0.7), (3.6, 0.9), (4.4, 0.2), (5.0, 0.0)];
    let response = |um: f64| {
        let piece = nodes.windows(2).find(|w| um <= w[1].0).unwrap();
        let [(a, low), (b, high)] = [piece[0], piece[1]];
        low + (high - low) * (um - a) / (b - a)
    };
    let steps = 20_000;
    let expected: f64 = (0..steps)
        .map(|i| {
            let um = 3.0 + 2.0 * (f64::from(i) + 0.5) / f64::from(steps);
            let light = |kelvin: f64| photon_radiance(um, kelvin);
            response(um) * (0.5 * light(500.0) + 0.3 * light(300.0) + 0.2 * light(450.0)) * 2.0
                / f64::from(steps)
        })
        .sum();
    // The midpoint rule's error at the response's kinks.
    assert!((seen.radiance / expected - 1.0).abs() < 1e-6, "{} {expected}", seen.radiance);

    let (one, four) = (render(&blob(0.5, 1), 4e-3), render(&blob(0.5, 4), 4e-3));
    assert_eq!((one.groups, four.groups, one.pixels.len()), (1, 4, four.pixels.len()));
    let declared = rms(one.error_plate.iter().chain(&four.error_plate).map(|e| f64::from(*e)));
    for g in 0..4 {
        let moved = rms(one.a_plate.iter().enumerate().map(|(i, a)| f64::from(a - four.a_plate[4 * i + g])));
        assert!(moved <= 2.0 * declared, "{g}: {moved} {declared}");
    }
}
