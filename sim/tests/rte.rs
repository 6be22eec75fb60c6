//! The ray tracer against tables that were made without it: exact where light is not scattered, within standard errors
//! where it is. The full table to a tight target is `cargo bench -p ditd-sim --bench accuracy_rte`.

mod rte_cases;

use ditd_sim::light::phase::{PhaseFunction, truncation};
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::cell;
use ditd_sim::tracer::chamber::Walls;
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::plate::PlateShape;
use ditd_sim::tracer::rays::{COLLISIONS_PER_RAY_MAX, RayOptions, render_rays};
use ditd_sim::tracer::shape::{Body, Shape, ShapeMedium};
use rte_cases::{Row, grid, grid_medium, half_space, json, number, phase, slab, slab_of, summary, table};

const QUICK: RayOptions = RayOptions {
    target_error: 1.5e-3,
    seed: 11,
    paths_max: 1 << 13,
    collisions_max: COLLISIONS_PER_RAY_MAX,
    walls: Walls::Far,
};

/// Largest |z| of n normal numbers stays below 4.5 with probability 1 − 7e-6 n; rms of ~200 correlated ones in 0.7 … 1.3.
fn assert_consistent(rows: &[Row]) {
    let (largest, rms) = summary(rows);
    for row in rows {
        assert_eq!(row.answer.cut, 0, "{}", row.name);
        assert!(row.z().all(|z| z.abs() < 4.5), "{}: {:?} seed {}", row.name, row.values, QUICK.seed);
    }
    assert!(rms < 1.3, "rms z {rms}, largest {largest}, seed {}", QUICK.seed);
}

#[test]
fn slabs_agree_with_doubling() {
    let rows: Vec<Row> = table("slab_scatter.csv").iter().map(|row| slab(row, &QUICK)).collect();
    assert_consistent(&rows);
}

/// Rows of the Mie-like slabs without the light scattered by less than 2 and 5 degrees, traced with what is left: the
/// rms difference from the exact rows stays within the stated error and the noise.
#[test]
fn slabs_without_their_forward_peak_stay_within_the_stated_error() {
    // The stated errors are 4e-2 and more: noise a tenth of that is none.
    let options = RayOptions { target_error: 4e-3, paths_max: 1 << 11, ..QUICK };
    for degrees in [2.0f64, 5.0] {
        let (mut square, mut allowed, mut count) = (0.0, 0.0, 0.0);
        for row in table("slab_scatter.csv").iter().filter(|row| row[1] == "mie_a") {
            let cut = truncation::cone(&phase("mie_a"), degrees.to_radians()).unwrap();
            let [albedo, depth, lowest, mu] = [2, 3, 4, 5].map(|i| number(&row[i]));
            let left =
                slab_of(cut.phase.clone(), row, cut.albedo(albedo), cut.extinction(depth, albedo), &options);
            // What is lost or gained by one coefficient is gained or lost by the others.
            let (_, want, _, got, se) = left.values[0];
            // Scatterings along the oblique sight; at most 1/(1 − ω) in all.
            let scatterings = (2.0 * albedo * depth / mu).min(1.0 / (1.0 - albedo).max(1e-9));
            let size = if lowest > 0.0 { 2.0 * lowest.acos() } else { std::f64::consts::PI };
            square += (got - want) * (got - want);
            allowed += cut.error(scatterings, size).powi(2) + se * se;
            count += 1.0;
        }
        assert!(count > 10.0);
        println!("{degrees} deg: {:e} of {:e}", (square / count).sqrt(), (allowed / count).sqrt());
        // The noise of so many rows is known to a quarter.
        assert!(square <= 1.25 * allowed, "{degrees}: {:e} {:e}", square / count, allowed / count);
    }
}

#[test]
fn grids_agree_with_regular_tracking() {
    let options = RayOptions { paths_max: 1 << 14, ..QUICK };
    let rows: Vec<Row> = table("grid3d.csv").iter().map(|row| grid(row, &options)).collect();
    assert_consistent(&rows);
}

#[test]
fn half_spaces_agree_with_chandrasekhar() {
    let rows: Vec<Row> =
        table("semi_infinite_isotropic.csv").iter().map(|row| half_space(row, &QUICK)).collect();
    assert_consistent(&rows);
    // Conservative rows are exact: nothing emits.
    for row in rows.iter().filter(|r| r.name.contains("omega 1 ")) {
        assert_eq!((row.answer.walls, row.answer.paths), (1.0, 0), "{}", row.name);
    }
}

/// 15 digits in the table; 1e-12 absolute as its README asks.
#[test]
fn shapes_have_the_optical_depth_of_the_closed_forms() {
    for case in json("shapes.json").as_array().unwrap() {
        let vector = |v: &serde_json::Value| [0, 1, 2].map(|i| v[i].as_f64().unwrap());
        let shape = &case["shape"];
        let f = |key: &str| shape[key].as_f64().unwrap();
        let shape = match shape["type"].as_str().unwrap() {
            "sphere" => {
                Shape::Sphere { centre_m: vector(&shape["center"]), radius_m: f("R"), extinction: f("sigma") }
            }
            "cylinder_z" => Shape::Cylinder {
                centre_m: if shape["center"].is_array() { vector(&shape["center"]) } else { [0.0; 3] },
                axis: [0.0, 0.0, 1.0],
                radius_m: f("R"),
                extinction: f("sigma"),
            },
            "gaussian" | "gauss" => {
                let centre_m = if shape["center"].is_array() { vector(&shape["center"]) } else { [0.0; 3] };
                Shape::Gaussian { centre_m, width_m: f("w"), extinction: f("sigma") }
            }
            "box" => {
                let corner =
                    |keys: [&str; 2]| keys.iter().find(|k| shape[**k].is_array()).map(|k| vector(&shape[*k]));
                let (lower_m, upper_m) = (corner(["min", "lo"]).unwrap(), corner(["max", "hi"]).unwrap());
                Shape::Cuboid { lower_m, upper_m, extinction: f("sigma") }
            }
            other => panic!("{other}"),
        };
        let medium = ShapeMedium { shape, albedo: 0.0, phase: PhaseFunction::Isotropic };
        let body = Body::shape(&medium).unwrap();
        let ray = (vector(&case["origin"]), vector(&case["direction"]));
        let answer = render_rays(&body, &[ray], None, &RayOptions::default()).unwrap().remove(0);
        let (tau, eps) = (case["tau"].as_f64().unwrap(), case["eps"].as_f64().unwrap());
        assert!(
            (answer.optical_depth - tau).abs() <= 1e-12 * tau.max(1.0),
            "{case} {}",
            answer.optical_depth
        );
        assert!((answer.medium[0] - eps).abs() <= 1e-12, "{case} {}", answer.medium[0]);
        assert_eq!((answer.se_medium[0], answer.paths), (0.0, 0));
    }
}

#[test]
fn cell_weights_survive_all_limits() {
    for row in table("cell_weights.csv") {
        let tau = number(&row[0]);
        let relative = |got: f64, want: f64| (got - want).abs() <= 1e-12 * want.abs();
        assert!(relative(cell::absorbed(tau), number(&row[1])), "{tau}");
        if tau < 1e-50 {
            // The table prints 0 here; the limits are τ/2 (5e-324 has no half) and ½.
            assert!((cell::far_weight(tau) - 0.5 * tau).abs() <= 5e-324 + 1e-12 * tau);
            assert!((cell::near_weight(tau) - 0.5 * tau).abs() <= 5e-324 + 1e-12 * tau);
        } else {
            assert!(relative(cell::far_weight(tau), number(&row[3])), "{tau} {}", cell::far_weight(tau));
            assert!(relative(cell::near_weight(tau), number(&row[4])), "{tau} {}", cell::near_weight(tau));
            let depth = cell::mean_depth_fraction(tau);
            assert!(relative(depth, number(&row[5])), "{tau} {depth}");
        }
        assert!((0.0..=0.5).contains(&cell::mean_depth_fraction(tau)));
    }
}

#[test]
fn line_of_sight_integrals_agree() {
    for case in json("line_of_sight.json").as_array().unwrap() {
        let length = case["L"].as_f64().unwrap();
        let (alpha, temperature) = (profile(&case["alpha"], length), profile(&case["T_K"], length));
        let lambda = case["lambda_um"].as_f64().unwrap();
        let exitance = |t: f64| {
            // Eq. 1 per µm: 2πc/λ⁴/(exp(hc/λkT) − 1).
            let l = lambda * 1e-6;
            let x = 6.626_070_15e-34 * 299_792_458.0 / (l * 1.380_649e-23 * t);
            2e-6 * std::f64::consts::PI * 299_792_458.0 / l.powi(4) / x.exp_m1()
        };
        let mut breaks = Vec::new();
        for key in ["alpha", "T_K"] {
            breaks.extend(["x", "c"].iter().filter_map(|k| case[key][*k].as_f64()));
        }
        // The camera is at x = L.
        let flip: Vec<f64> = breaks.iter().map(|x| length - x).collect();
        let sight = ditd_sim::tracer::line::integrate(
            length,
            &flip,
            |s| alpha(length - s),
            |s| exitance(temperature(length - s)),
        );
        let want = |key: &str| case[key].as_f64().unwrap();
        let near = |got: f64, want: f64| (got - want).abs() <= 1e-12 * want.abs();
        assert!(near(sight.optical_depth, want("tau")), "{case} {}", sight.optical_depth);
        assert!(near(sight.absorbed, want("eps")), "{case} {}", sight.absorbed);
        assert!(near(sight.emitted, want("emitted")), "{case} {}", sight.emitted);
    }
}

fn profile(form: &serde_json::Value, length: f64) -> Box<dyn Fn(f64) -> f64> {
    let f = |key: &str| form[key].as_f64().expect("a number");
    match form["type"].as_str().expect("a form") {
        "const" => {
            let a = f("a");
            Box::new(move |_| a)
        }
        "linear" => {
            let (a, b) = (f("a"), f("b"));
            Box::new(move |x| a + (b - a) * x / length)
        }
        "exp" => {
            let (a, l) = (f("a"), f("l"));
            Box::new(move |x| a * (-x / l).exp())
        }
        "gauss" => {
            let (base, a, c, w) = (form["base"].as_f64().unwrap_or(0.0), f("a"), f("c"), f("w"));
            Box::new(move |x| base + a * (-(x - c) * (x - c) / (2.0 * w * w)).exp())
        }
        "two" => {
            let (a, b, place) = (f("a"), f("b"), f("x"));
            Box::new(move |x| if x < place { a } else { b })
        }
        other => panic!("{other}"),
    }
}

fn camera(columns: usize, rows: usize) -> Camera {
    Camera {
        projection: Projection::Telecentric { width_m: 1.6 },
        position_m: [0.0, -3.0, 0.0],
        look_at_m: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        columns,
        rows,
        pixel_filter: PixelFilter::Centre,
        lens: None,
    }
}

/// The errors that an image declares are its true ones within a factor of two, although most of them is not noise but
/// the reconstruction of scattered light between its samples.
#[test]
fn declared_errors_of_images_are_the_true_ones() {
    for case in ["blob", "jets"] {
        let (medium, plate) = grid_medium(case);
        let camera = camera(24, 18);
        let options = RenderOptions { target_error: 2e-3, ..RenderOptions::default() };
        let image = render_image(&medium, &camera, Some(&plate), &options, &|_| {}).unwrap();
        let sights = camera.sights().unwrap();
        let plate = ditd_sim::tracer::plate::Plate::new(&plate).unwrap();
        let body = Body::grid(&medium, 0).unwrap();
        let chosen: Vec<usize> = (0..image.pixels.len()).step_by(9).collect();
        let rays: Vec<_> = chosen
            .iter()
            .map(|&i| image.pixels[i] as usize)
            .map(|p| sights.ray((p / 24) as f64 + 0.5, (p % 24) as f64 + 0.5))
            .collect();
        // Their own errors are taken away from what is found, on some forty pixels.
        let options =
            RayOptions { target_error: 1.2e-3, seed: 3, paths_max: 1 << 12, ..RayOptions::default() };
        let answers = render_rays(&body, &rays, Some(&plate), &options).unwrap();
        let square = |v: f64| v * v;
        let (mut truth, mut declared) = ([0.0; 2], [0.0; 2]);
        for (&i, answer) in chosen.iter().zip(&answers) {
            // The rays' own errors do not count.
            truth[0] += square(f64::from(image.a_plate[i]) - answer.plate) - square(answer.se_plate);
            truth[1] +=
                square(f64::from(image.emission[3 * i]) - answer.medium[0]) - square(answer.se_medium[0]);
            declared[0] += square(f64::from(image.error_plate[i]));
            declared[1] += square(f64::from(image.error_medium[i]));
        }
        let ratio = [0, 1].map(|k| (declared[k] / truth[k]).sqrt());
        let n = chosen.len() as f64;
        let rms = truth.map(|t| (t / n).sqrt());
        println!("{case}: true rms {rms:?}, declared over true {ratio:?}");
        assert!(ratio.iter().all(|r| (0.5..2.0).contains(r)), "{case}: {ratio:?} of {rms:?}");
        assert!(rms.iter().all(|r| *r < 2.4e-3), "{case}: {rms:?}");
    }
}

fn small_medium() -> (GridMedium, PlateShape) {
    grid_medium("blob")
}

/// A uniform enclosure looks uniform: coefficients lie in [0, 1] and close to 1e-6, with few paths and with many.
#[test]
fn isothermal_enclosure_is_exact_and_threads_do_not_matter() {
    let (medium, plate) = small_medium();
    for paths_max in [1, 20_000] {
        let options = RenderOptions { target_error: 1e-3, paths_max, ..RenderOptions::default() };
        let render = || render_image(&medium, &camera(33, 21), Some(&plate), &options, &|_| {}).unwrap();
        let image = render();
        for i in 0..image.pixels.len() {
            let (p, m) = (image.a_plate[i], image.emission[3 * i]);
            assert!((0.0..=1.0).contains(&p) && (0.0..=1.0).contains(&m) && p + m <= 1.0 + 1e-6, "{p} {m}");
            // The zones are a partition of the medium.
            let zones = image.emission[3 * i + 1] + image.emission[3 * i + 2];
            assert!(paths_max == 1 || (zones - m).abs() < 0.02, "{zones} {m}");
        }
        let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(render);
        assert_eq!(single.a_plate, image.a_plate);
        assert_eq!(single.emission, image.emission);
        assert_eq!(single.error_plate, image.error_plate);
    }
}

/// Without scattering nothing is sampled: the image is the deterministic line of sight, to the f32 sums' 2e-6.
#[test]
fn without_scattering_an_image_is_the_line_of_sight() {
    let (mut medium, plate) = small_medium();
    medium.k_sca.iter_mut().for_each(|k| *k = 0.0);
    for cell in 0..medium.k_ext.len() {
        medium.emission[3 * cell] = medium.k_ext[cell];
    }
    let camera = camera(20, 15);
    let image = render_image(&medium, &camera, Some(&plate), &RenderOptions::default(), &|_| {}).unwrap();
    assert!(image.stats.iter().all(|(name, _)| name != "paths"));
    let sights = camera.sights().unwrap();
    let plate = ditd_sim::tracer::plate::Plate::new(&plate).unwrap();
    let body = Body::grid(&medium, 0).unwrap();
    for (i, &pixel) in image.pixels.iter().enumerate() {
        let (row, column) = (pixel as usize / 20, pixel as usize % 20);
        let ray = sights.ray(row as f64 + 0.5, column as f64 + 0.5);
        let answer = render_rays(&body, &[ray], Some(&plate), &RayOptions::default()).unwrap().remove(0);
        assert!((f64::from(image.a_plate[i]) - answer.plate).abs() < 2e-6);
        assert!((f64::from(image.emission[3 * i]) - answer.medium[0]).abs() < 2e-6);
        assert_eq!(answer.paths, 0);
    }
}

/// Opaque, denormal and wildly uneven cells give finite coefficients; bad ones are refused when the medium is checked.
#[test]
fn extreme_cells_give_no_nan_and_bad_cells_are_refused() {
    let (mut medium, plate) = small_medium();
    for (cell, k) in [(7, 5e-324), (1900, 1e9), (2040, 1e300), (2100, 0.0), (2200, 1e-300)] {
        medium.k_ext[cell] = k;
        medium.k_sca[cell] = 0.5 * k;
        medium.emission[3 * cell..3 * cell + 3].copy_from_slice(&[0.5 * k, 0.25 * k, 0.25 * k]);
    }
    let options = RenderOptions { target_error: 1e-2, ..RenderOptions::default() };
    let image = render_image(&medium, &camera(16, 12), Some(&plate), &options, &|_| {}).unwrap();
    assert!(image.a_plate.iter().chain(&image.emission).chain(&image.error_plate).all(|v| v.is_finite()));
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let mut medium = medium.clone();
        medium.k_ext[3] = bad;
        assert!(matches!(medium.check(), Err(TracerError::Coefficient { what: "k_ext", entry: 3, .. })));
    }
}
