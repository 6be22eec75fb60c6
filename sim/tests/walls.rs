//! Chambers whose walls differ: every way of tracing must find the same walls, and light must be conserved.
//!
//! What is seen without a medium is geometry; with one, image mode, single rays and the reference are three separate
//! estimates. Radiosities are judged in the library (`scene::enclosure`).

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::light::planck::photon_radiance;
use ditd_sim::scene::enclosure::{Enclosure, SOURCES};
use ditd_sim::scene::file::{self, MediumSource, Scene};
use ditd_sim::scene::lights::{EndShares, Lights, Share};
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::chamber::{Chamber, ENDS, OUTSIDE, SIDES, Walls};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::reference::render_reference;
use ditd_sim::tracer::relight::Lighting;
use ditd_sim::tracer::shape::{Body, Shape, ShapeMedium};

const CELLS: usize = 12;

fn chamber() -> Chamber {
    Chamber::new([-0.1, -0.12, -0.1], [0.1, 0.12, 0.14]).unwrap()
}

/// A ball that fades outwards, denser below, with `groups` spectral groups of rising extinction.
fn medium(groups: usize, albedo: f64, depth: f64) -> GridMedium {
    let (mut index, mut k_ext, mut k_sca, mut emission) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let at = |i: usize| (i as f64 + 0.5) / CELLS as f64 * 2.0 - 1.0;
    for i in 0..CELLS * CELLS * CELLS {
        let [x, y, z] = [i / (CELLS * CELLS), i / CELLS % CELLS, i % CELLS].map(at);
        let r2 = x * x + y * y + z * z;
        if r2 > 1.0 {
            index.push(ditd_sim::tracer::medium::EMPTY);
            continue;
        }
        index.push(u32::try_from(k_ext.len() / groups).unwrap());
        for g in 0..groups {
            let k = depth / 0.1 * (1.0 - r2) * (1.0 - 0.5 * z) * (1.0 + g as f64);
            k_ext.push(k);
            k_sca.push(albedo * k);
        }
        for channel in 0..2 {
            for g in 0..groups {
                let k = k_ext[k_ext.len() - groups + g];
                emission.push((1.0 - albedo) * k * if channel == 0 { 1.0 } else { 7.0 });
            }
        }
    }
    GridMedium {
        lower_m: [-0.05; 3],
        upper_m: [0.05; 3],
        cells: [CELLS; 3],
        groups,
        channels: 2,
        index,
        k_ext,
        k_sca,
        emission,
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.6 }; groups],
    }
}

fn camera(filter: PixelFilter) -> Camera {
    Camera {
        projection: Projection::Pinhole { horizontal_fov_deg: 34.0 },
        position_m: [0.02, -0.5, 0.03],
        look_at_m: [0.0, 0.0, 0.01],
        up: [0.0, 0.0, 1.0],
        columns: 24,
        rows: 20,
        pixel_filter: filter,
        lens: None,
    }
}

fn plate() -> PlateShape {
    PlateShape::Disc { centre_m: [0.0, 0.2, 0.0], facing: [0.0, -1.0, 0.0], diameter_m: 0.08 }
}

fn image(medium: &GridMedium, filter: PixelFilter, target_error: f64) -> Operator {
    let options = RenderOptions { target_error, walls: Walls::Apart(chamber()), ..RenderOptions::default() };
    render_image(medium, &camera(filter), Some(&plate()), &options, &|_| {}).unwrap()
}

fn rays(camera: &Camera, pixels: &[u32]) -> Vec<([f64; 3], [f64; 3])> {
    let sights = camera.sights().unwrap();
    let at = |p: u32| (p as usize / camera.columns, p as usize % camera.columns);
    pixels.iter().map(|&p| at(p)).map(|(r, c)| sights.ray(r as f64 + 0.5, c as f64 + 0.5)).collect()
}

fn traced(body: &Body<'_>, list: &[([f64; 3], [f64; 3])], target_error: f64) -> Vec<RayAnswer> {
    let options = RayOptions {
        target_error,
        paths_max: 1 << 16,
        walls: Walls::Apart(chamber()),
        ..RayOptions::default()
    };
    render_rays(body, list, Some(&Plate::new(&plate()).unwrap()), &options).unwrap()
}

#[test]
fn an_empty_chamber_shows_in_every_pixel_the_wall_it_sees() {
    // Nothing scatters, nothing absorbs: one cell of next to nothing.
    let mut nothing = medium(1, 0.5, 1.0);
    nothing.k_ext.fill(0.0);
    nothing.k_sca.fill(0.0);
    nothing.emission.fill(0.0);
    for filter in [PixelFilter::Centre, PixelFilter::Box] {
        let operator = image(&nothing, filter, 1e-3);
        let sights = camera(filter).sights().unwrap();
        let plate = Plate::new(&plate()).unwrap();
        let mut walls = [0; ENDS];
        for (pixel, seen) in operator.ends_seen.chunks_exact(ENDS).enumerate() {
            let sum: f32 = seen.iter().sum();
            assert!((sum + operator.plate_seen[pixel] - 1.0).abs() < 1e-6, "{pixel}: {seen:?}");
            // The mean over a fine raster of the pixel, or its centre.
            let n = if filter == PixelFilter::Centre { 1 } else { 40 };
            let mut expected = [0.0; ENDS];
            for k in 0..n * n {
                let place = |i: usize, k: usize| i as f64 + (k as f64 + 0.5) / n as f64;
                let (origin, direction) = sights.ray(place(pixel / 24, k / n), place(pixel % 24, k % n));
                if plate.hit(origin, direction).is_none() {
                    expected[chamber().end(origin, direction)] += 1.0 / (n * n) as f64;
                }
            }
            for (end, (seen, expected)) in seen.iter().zip(expected).enumerate() {
                // Eight sub-sights along an axis miss an edge by at most one of them.
                assert!(
                    (f64::from(*seen) - expected).abs() < if n == 1 { 1e-6 } else { 0.13 },
                    "{pixel} {end}"
                );
                walls[end] += usize::from(*seen > 0.5);
            }
        }
        // All walls but the one that the camera looks through are seen, and past the chamber.
        assert!((0..ENDS).all(|end| (walls[end] > 0) == (end != 2)), "{walls:?}");
    }
}

#[test]
fn walls_sum_to_what_closure_leaves_in_every_way_of_tracing() {
    let medium = medium(3, 0.7, 1.0);
    let camera = camera(PixelFilter::Box);
    let operator = image(&medium, PixelFilter::Box, 3e-3);
    let options =
        RenderOptions { target_error: 2e-2, walls: Walls::Apart(chamber()), ..RenderOptions::default() };
    let chosen: Vec<u32> = operator.pixels.iter().copied().step_by(7).collect();
    let reference =
        render_reference(&medium, &camera, Some(&plate()), &options, Some(&chosen), &|_| {}).unwrap();
    for operator in [&operator, &reference] {
        assert!(operator.pixels.len() > 5 && operator.error_ends.len() == operator.pixels.len());
        for i in 0..operator.pixels.len() {
            for g in 0..3 {
                let ends: Vec<f32> = (0..ENDS).map(|end| operator.a_ends[(i * ENDS + end) * 3 + g]).collect();
                let walls = 1.0 - operator.a_plate[i * 3 + g] - operator.emission[i * 2 * 3 + g];
                assert!(ends.iter().all(|e| *e >= 0.0), "{ends:?}");
                assert!((ends.iter().sum::<f32>() - walls).abs() < 1e-6, "{i} {g}: {ends:?} {walls}");
            }
        }
    }
    for group in 0..3 {
        let body = Body::grid(&medium, group).unwrap();
        for answer in traced(&body, &rays(&camera, &chosen), 5e-3) {
            assert!((answer.ends.iter().sum::<f64>() - answer.walls).abs() < 1e-12, "{answer:?}");
        }
    }
}

/// Pixels far smaller than cells: most are interpolated, but none across the edge between two walls, which stands behind
/// the middle of the ball.
#[test]
fn walls_behind_a_medium_are_interpolated_up_to_their_edges() {
    let medium = medium(1, 0.5, 0.7);
    let camera = Camera {
        projection: Projection::Pinhole { horizontal_fov_deg: 13.0 },
        position_m: [0.3, -0.4, 0.03],
        look_at_m: [0.0; 3],
        // Askew, so that the edge crosses rows and columns in every way.
        up: [0.15, 0.1, 1.0],
        columns: 160,
        rows: 128,
        ..camera(PixelFilter::Box)
    };
    let options =
        RenderOptions { target_error: 2e-3, walls: Walls::Apart(chamber()), ..RenderOptions::default() };
    let operator = render_image(&medium, &camera, Some(&plate()), &options, &|_| {}).unwrap();
    let stat = |name: &str| operator.stats.iter().find(|s| s.0 == name).map_or(0.0, |s| s.1);
    assert!(stat("pixels_interpolated") > 0.3 * operator.pixels.len() as f64);
    assert!(stat("sights") < operator.pixels.len() as f64, "{}", stat("sights"));
    let seen = |p: u32| &operator.ends_seen[p as usize * ENDS..][..ENDS];
    let alike = |a: u32, b: u32| seen(a).iter().zip(seen(b)).all(|(a, b)| (*a > 0.0) == (*b > 0.0));
    let near_edge = |p: u32| (1..4).any(|step| !alike(p, p - step) || !alike(p, p + step));
    let (beside, apart): (Vec<u32>, Vec<u32>) = operator.pixels.iter().copied().partition(|&p| near_edge(p));
    assert!(beside.len() > 300 && apart.len() > 3000, "{} {}", beside.len(), apart.len());
    for (pixels, edges) in [(beside, true), (apart, false)] {
        let chosen: Vec<u32> = pixels.iter().copied().step_by(pixels.len() / 60).collect();
        let reference =
            render_reference(&medium, &camera, Some(&plate()), &options, Some(&chosen), &|_| {}).unwrap();
        let (mut difference, mut declared, mut largest) = (0.0, 0.0, 0.0_f64);
        for (j, pixel) in reference.pixels.iter().enumerate() {
            let i = operator.pixels.binary_search(pixel).unwrap();
            for end in 0..SIDES {
                let d = f64::from(operator.a_ends[i * ENDS + end] - reference.a_ends[j * ENDS + end]);
                difference += d * d;
                largest = largest.max(d.abs());
                let [a, b] = [operator.error_ends[i], reference.error_ends[j]].map(f64::from);
                declared += a * a + b * b;
            }
        }
        // Where an edge crosses the pixel itself, eight sights along an axis find its share to a sixteenth at worst.
        let slack = if edges { 0.02 } else { 0.0 };
        let count = (SIDES * reference.pixels.len()) as f64;
        let (difference, declared) = ((difference / count).sqrt(), (declared / count).sqrt());
        assert!(difference < 1.5 * declared + slack, "{edges}: {difference:.1e} {declared:.1e}");
        assert!(largest < 6.0 * declared + 5.0 * slack, "{edges}: {largest:.1e} {declared:.1e}");
    }
}

/// Image mode against single rays, pixel centres, over the walls: rms of the difference and of both declared errors.
fn compare(albedo: f64, depth: f64) -> (f64, f64) {
    let medium = medium(1, albedo, depth);
    let operator = image(&medium, PixelFilter::Centre, 2e-3);
    let chosen: Vec<usize> = (0..operator.pixels.len()).step_by(5).collect();
    let pixels: Vec<u32> = chosen.iter().map(|&i| operator.pixels[i]).collect();
    let answers =
        traced(&Body::grid(&medium, 0).unwrap(), &rays(&camera(PixelFilter::Centre), &pixels), 1e-3);
    let (mut difference, mut declared, mut count) = (0.0, 0.0, 0.0);
    for (&i, answer) in chosen.iter().zip(&answers) {
        let ends = &operator.a_ends[i * ENDS..(i + 1) * ENDS];
        for (end, &share) in ends.iter().enumerate().take(SIDES) {
            difference += (f64::from(share) - answer.ends[end]).powi(2);
            declared += f64::from(operator.error_ends[i]).powi(2) + answer.se_ends[end].powi(2);
            count += 1.0;
        }
        assert!(answer.ends[OUTSIDE].abs() < 1e-12 && ends[OUTSIDE] < 1e-6);
    }
    ((difference / count).sqrt(), (declared / count).sqrt())
}

#[test]
fn image_mode_and_single_rays_find_the_same_walls() {
    for (albedo, depth) in [(1.0, 0.5), (0.7, 2.0), (0.0, 1.0)] {
        let (difference, declared) = compare(albedo, depth);
        // Declared is the largest wall's error: the mean over the walls is smaller.
        assert!(difference < 1.5 * declared.max(1e-5), "albedo {albedo}: {difference:.1e} {declared:.1e}");
        assert!(declared < 3e-3, "albedo {albedo}: {declared}");
        println!("albedo {albedo}, depth {depth}: difference {difference:.2e}, declared {declared:.2e}");
    }
}

#[test]
fn the_reference_and_single_rays_find_the_same_walls() {
    let medium = medium(1, 0.9, 1.0);
    let camera = camera(PixelFilter::Centre);
    let pixels: Vec<u32> = vec![250, 251, 180, 300, 205];
    let options =
        RenderOptions { target_error: 2e-3, walls: Walls::Apart(chamber()), ..RenderOptions::default() };
    let reference =
        render_reference(&medium, &camera, Some(&plate()), &options, Some(&pixels), &|_| {}).unwrap();
    let answers = traced(&Body::grid(&medium, 0).unwrap(), &rays(&camera, &reference.pixels), 1e-3);
    assert!(reference.pixels.len() >= 4);
    for (i, answer) in answers.iter().enumerate() {
        for end in 0..ENDS {
            let share = f64::from(reference.a_ends[i * ENDS + end]);
            // Eight replicates know their standard error to 27 %: five of it.
            let sigma = f64::from(reference.error_ends[i]).hypot(answer.se_ends[end]) + 1e-6;
            assert!(
                (share - answer.ends[end]).abs() < 5.0 * sigma,
                "{i} {end}: {share} {}",
                answer.ends[end]
            );
        }
    }
}

#[test]
fn telling_walls_apart_changes_nothing_else() {
    let medium = medium(1, 0.0, 1.0);
    let camera = camera(PixelFilter::Centre);
    let at = |walls| {
        let options = RenderOptions { walls, ..RenderOptions::default() };
        render_image(&medium, &camera, Some(&plate()), &options, &|_| {}).unwrap()
    };
    let [far, alike, apart] = [Walls::Far, Walls::Alike(chamber()), Walls::Apart(chamber())].map(at);
    assert_eq!((&far.a_plate, &far.emission), (&alike.a_plate, &alike.emission));
    assert_eq!((&far.plate_seen, &far.pixels), (&alike.plate_seen, &alike.pixels));
    // Told apart they are gathered another way, which agrees to the target.
    assert_eq!((&far.plate_seen, &far.pixels), (&apart.plate_seen, &apart.pixels));
    for (a, b) in far.a_plate.iter().chain(&far.emission).zip(apart.a_plate.iter().chain(&apart.emission)) {
        // Emission is in channels of 1 and of 7.
        assert!((a - b).abs() < 7e-3, "{a} {b}");
    }
    assert!(alike.a_ends.is_empty() && alike.ends_seen.is_empty() && alike.error_ends.is_empty());
}

#[test]
fn media_end_at_the_walls() {
    // A slab without sides in a chamber is a box as wide as the chamber.
    let shape = |shape| ShapeMedium { shape, albedo: 0.6, phase: PhaseFunction::Isotropic };
    let slab = shape(Shape::Slab { thickness_m: 0.1, optical_depth: 2.0 });
    let (lower_m, upper_m) = ([-0.1, -0.12, -0.05], [0.1, 0.12, 0.05]);
    let cuboid = shape(Shape::Cuboid { lower_m, upper_m, extinction: 20.0 });
    let list = [
        ([0.0, -0.5, 0.0], [0.05, 1.0, 0.01]),
        ([0.3, -0.5, 0.02], [-0.5, 1.0, 0.0]),
        ([0.01, 0.0, 0.1], [0.1, 0.2, -1.0]),
    ];
    let [one, two] = [&slab, &cuboid].map(|medium| traced(&Body::shape(medium).unwrap(), &list, 1e-3));
    for (a, b) in one.iter().zip(&two) {
        assert!((a.optical_depth - b.optical_depth).abs() < 1e-12, "{} {}", a.optical_depth, b.optical_depth);
        let sigma = a.se_plate.hypot(b.se_plate) + 1e-12;
        assert!((a.plate - b.plate).abs() < 5.0 * sigma, "{} {} {sigma}", a.plate, b.plate);
        for end in 0..ENDS {
            let sigma = a.se_ends[end].hypot(b.se_ends[end]) + 1e-12;
            assert!((a.ends[end] - b.ends[end]).abs() < 5.0 * sigma, "{end}: {:?} {:?}", a.ends, b.ends);
        }
    }
}

const SCENE: &str = r#"
[plate]
shape = "disc"
centre_m = [0.0, 0.2, 0.0]
facing = [0.0, -1.0, 0.0]
diameter_m = 0.08
temperature_k = 433.0
emissivity = 0.95
[walls]
temperature_k = 433.0
emissivity = 0.4
[chamber]
lower_m = [-0.1, -0.12, -0.1]
upper_m = [0.1, 0.12, 0.14]
[band]
wavelength_um = 3.4
[medium]
kind = "sphere"
centre_m = [0.0, 0.0, 0.0]
radius_m = 0.04
extinction = 30.0
albedo = 0.8
temperature_k = 433.0
"#;

fn scene(text: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, text).unwrap();
    file::load(&path).unwrap()
}

/// Radiances of some rays, told apart or not.
fn seen(scene: &Scene, walls: Walls) -> Vec<(f64, f64)> {
    let Some(MediumSource::Shape(shape, _)) = &scene.medium else { panic!("a sphere") };
    let options = RayOptions { target_error: 2e-3, paths_max: 1 << 14, walls, ..RayOptions::default() };
    let plate = Plate::new(&scene.plate.as_ref().unwrap().shape).unwrap();
    let list: Vec<_> = (0..6).map(|i| ([0.0, -0.5, 0.0], [0.02 * f64::from(i), 1.0, 0.05])).collect();
    let lights = Lights::new(scene);
    let answers = render_rays(&Body::shape(shape).unwrap(), &list, Some(&plate), &options).unwrap();
    answers
        .iter()
        .map(|a| {
            let share = Share {
                plate: a.plate,
                walls: a.walls,
                medium: a.medium[0],
                emission: 0.0,
                se: [a.se_plate, a.se_walls, a.se_medium[0]],
                ..Share::default()
            };
            if walls.apart().is_none() {
                let seen = lights.see(&[share]);
                return (seen.radiance, seen.se_radiance);
            }
            let ends = EndShares {
                shares: vec![std::array::from_fn(|end| a.ends[end])],
                se: std::array::from_fn(|end| a.se_ends[end]),
            };
            let (seen, by_end) = lights.see_apart(&[share], &ends);
            assert!((seen.walls - by_end.iter().sum::<f64>()).abs() < 1e-12);
            assert!((seen.walls - a.walls).abs() < 1e-12 && seen.se_radiance.is_finite());
            (seen.radiance, seen.se_radiance)
        })
        .collect()
}

#[test]
fn an_isothermal_chamber_is_uniform_and_its_walls_are_not_told_apart() {
    let scene = scene(SCENE);
    let walls = scene.surroundings(&[]);
    assert!(matches!(walls, Walls::Alike(_)));
    let black = photon_radiance(3.4, 433.0);
    // Told apart all the same, it stays uniform.
    for walls in [walls, Walls::Apart(chamber())] {
        for (radiance, _) in seen(&scene, walls) {
            assert!((radiance / black - 1.0).abs() < 1e-12, "{radiance} {black}");
        }
    }
}

#[test]
fn every_wall_shines_with_its_own_light() {
    let hot = "[[wall]]\nside = \"y+\"\ntemperature_k = 480\nemissivity = 1\n";
    let scene = scene(&format!("{}{hot}", SCENE.replace("emissivity = 0.4", "emissivity = 1")));
    assert!(matches!(scene.surroundings(&[]), Walls::Apart(_)));
    let [cold, hot] = [433.0, 480.0].map(|t| photon_radiance(3.4, t));
    let shares: Vec<Share> = vec![Share { walls: 1.0, ..Share::default() }];
    let lights = Lights::new(&scene);
    for end in 0..ENDS {
        let mut ends = EndShares { shares: vec![[0.0; ENDS]], se: [0.0; ENDS] };
        ends.shares[0][end] = 1.0;
        let (seen, by_end) = lights.see_apart(&shares, &ends);
        let expected = if end == 3 { hot } else { cold };
        assert!((seen.radiance / expected - 1.0).abs() < 1e-14, "{end}");
        assert!((by_end[end] - 1.0).abs() < 1e-14);
    }
}

#[test]
fn lights_and_relighting_agree() {
    let text =
        SCENE.replace("temperature_k = 433.0\nemissivity = 0.95", "temperature_k = 500.0\nemissivity = 0.95");
    let scene = scene(&format!("{text}[[wall]]\nside = \"x+\"\ntemperature_k = 350\n"));
    let medium = medium(1, 0.7, 1.0);
    let operator = image(&medium, PixelFilter::Box, 5e-3);
    let lights = Lights::new(&scene);
    let unit = |end: usize| {
        let mut ends = EndShares { shares: vec![[0.0; ENDS]], se: [0.0; ENDS] };
        ends.shares[0][end] = 1.0;
        lights.see_apart(&[Share { walls: 1.0, ..Share::default() }], &ends).0.radiance
    };
    let ends: Vec<f64> = (0..ENDS).map(unit).collect();
    // Gray walls mirror the hot plate and the cold wall.
    assert!(ends[1] < ends[2] && (ends[2] / ends[0] - 1.0).abs() > 1e-6);
    let plate = lights.see(&[Share { plate: 1.0, ..Share::default() }]).radiance;
    let own = lights.see(&[Share { medium: 1.0, ..Share::default() }]).radiance;
    let light = Lighting { plate: vec![plate], walls: vec![ends[0]], ends, channel: 0, medium: vec![own] };
    let mut image = vec![0.0; operator.plate_seen.len()];
    operator.relight(&light, &mut image).unwrap();
    for (i, &pixel) in operator.pixels.iter().enumerate() {
        let share = Share {
            plate: f64::from(operator.a_plate[i]),
            walls: 1.0 - f64::from(operator.a_plate[i]) - f64::from(operator.emission[2 * i]),
            medium: f64::from(operator.emission[2 * i]),
            ..Share::default()
        };
        let ends = EndShares {
            shares: vec![std::array::from_fn(|end| f64::from(operator.a_ends[i * ENDS + end]))],
            se: [0.0; ENDS],
        };
        let expected = lights.see_apart(&[share], &ends).0.radiance;
        // f32 shares that close to 1e-6.
        assert!((f64::from(image[pixel as usize]) / expected - 1.0).abs() < 1e-5);
    }
}

/// What the spray in the way changes: view factors between walls traced through the medium, light it stops and emits
/// included, against those of the empty chamber.
#[test]
fn a_spray_in_the_way_changes_radiosities_by_no_more_than_it_hides() {
    let empty = Enclosure::new(&chamber(), None);
    let emissivity = [0.5; SIDES];
    let mut changes = Vec::new();
    for depth in [0.2, 1.0] {
        let medium = medium(1, 0.0, depth);
        let body = Body::grid(&medium, 0).unwrap();
        let options = RayOptions { walls: Walls::Apart(chamber()), ..RayOptions::default() };
        let (mut factors, mut stopped) = ([[0.0; SIDES]; SIDES], [0.0; SIDES]);
        for side in 0..SIDES {
            // A raster over the wall, and directions by the cosine law: exact without scattering.
            let mut list = Vec::new();
            let (n, low, high) = (12, chamber().lower_m(), chamber().upper_m());
            for k in 0..n * n * n * n {
                let u =
                    [k / (n * n * n), k / (n * n) % n, k / n % n, k % n].map(|i| (i as f64 + 0.5) / n as f64);
                let (axis, b, c) = (side / 2, (side / 2 + 1) % 3, (side / 2 + 2) % 3);
                let (mut place, mut direction) = ([0.0; 3], [0.0; 3]);
                place[axis] = if side.is_multiple_of(2) { low[axis] } else { high[axis] };
                place[b] = low[b] + u[0] * (high[b] - low[b]);
                place[c] = low[c] + u[1] * (high[c] - low[c]);
                let (sine, phi) = (u[2].sqrt(), std::f64::consts::TAU * u[3]);
                direction[axis] = (1.0 - u[2]).sqrt() * if side.is_multiple_of(2) { 1.0 } else { -1.0 };
                (direction[b], direction[c]) = (sine * phi.cos(), sine * phi.sin());
                list.push((place, direction));
            }
            let answers = render_rays(&body, &list, None, &options).unwrap();
            for answer in &answers {
                for (factor, share) in factors[side].iter_mut().zip(&answer.ends) {
                    *factor += share / list.len() as f64;
                }
                stopped[side] += answer.medium[0] / list.len() as f64;
            }
        }
        // One hot wall, the others and the spray cold.
        let mut sources = [0.0; SOURCES];
        sources[3] = 1.0;
        let (before, _) = empty.radiosity(&emissivity, 1.0).lit(&sources);
        let mut after = before;
        for _ in 0..200 {
            after = std::array::from_fn(|i| {
                if i >= SIDES {
                    return 0.0;
                }
                let from: f64 = (0..SIDES).map(|j| factors[i][j] * after[j]).sum();
                emissivity[i] * sources[i] + (1.0 - emissivity[i]) * from
            });
        }
        let most = stopped.iter().copied().fold(0.0, f64::max);
        let change = (0..SIDES).map(|i| (after[i] - before[i]).abs()).fold(0.0, f64::max);
        // (1 − ε) × what is stopped × contrast, mirrored again and again: 1/(1 − (1 − ε)) of it.
        assert!(change < most * 0.5 / 0.5 + 2e-3, "depth {depth}: {change} {most}");
        changes.push((change, most));
    }
    // In thin sprays it goes with the optical depth, and it is small against the contrast of the walls.
    assert!(changes[0].0 < changes[1].0 && changes[1].0 < 0.05, "{changes:?}");
    println!("{changes:?}");
}
