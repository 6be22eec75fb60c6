//! Blur by a lens and by motion during the exposure: against closed forms, against still images, and against pixels
//! traced one by one.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::lens::{Aperture, Lens};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;
use ditd_sim::tracer::reference::render_reference;
use std::f64::consts::PI;

const TARGET: f64 = 1e-3;

const EVERYWHERE: PlateShape = PlateShape::Cone { facing: [0.0, -1.0, 0.0], half_angle_deg: 90.0 };

/// A gray grid between two corners, filled where `extinction` of the cell's centre is positive.
fn medium(
    [lower_m, upper_m]: [[f64; 3]; 2],
    cells: [usize; 3],
    albedo: f64,
    extinction: impl Fn([f64; 3]) -> f64,
) -> GridMedium {
    let mut index = vec![EMPTY; cells[0] * cells[1] * cells[2]];
    let mut k_ext: Vec<f64> = Vec::new();
    for (i, entry) in index.iter_mut().enumerate() {
        let at = [i / (cells[1] * cells[2]), i / cells[2] % cells[1], i % cells[2]];
        let k = extinction(
            [0, 1, 2]
                .map(|a| lower_m[a] + (at[a] as f64 + 0.5) * (upper_m[a] - lower_m[a]) / cells[a] as f64),
        );
        if k > 0.0 {
            *entry = u32::try_from(k_ext.len()).unwrap();
            k_ext.push(k);
        }
    }
    GridMedium {
        lower_m,
        upper_m,
        cells,
        groups: 1,
        channels: 1,
        index,
        k_sca: k_ext.iter().map(|k| k * albedo).collect(),
        emission: k_ext.iter().map(|k| k * (1.0 - albedo)).collect(),
        k_ext,
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.7 }],
    }
}

fn camera(projection: Projection, lens: Option<Lens>) -> Camera {
    Camera {
        projection,
        position_m: [0.0, -0.6, 0.0],
        look_at_m: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        columns: 48,
        rows: 36,
        pixel_filter: PixelFilter::Box,
        lens,
    }
}

const PINHOLE: Projection = Projection::Pinhole { horizontal_fov_deg: 5.0 };

fn render(medium: &GridMedium, camera: &Camera, options: &RenderOptions) -> Operator {
    render_image(medium, camera, Some(&EVERYWHERE), options, &|_| {}).unwrap()
}

fn options() -> RenderOptions {
    RenderOptions { target_error: TARGET, ..RenderOptions::default() }
}

/// a_plate of all pixels, 1 where the medium is not met.
fn plate_image(operator: &Operator) -> Vec<f64> {
    let mut image: Vec<f64> = operator.plate_seen.iter().map(|&a| f64::from(a)).collect();
    for (&pixel, &a) in operator.pixels.iter().zip(&operator.a_plate) {
        image[pixel as usize] = f64::from(a);
    }
    image
}

fn stat(operator: &Operator, name: &str) -> f64 {
    operator.stats.iter().find(|(n, _)| n == name).map_or(f64::NAN, |(_, v)| *v)
}

/// A step from 0 to 1 in four dimensions, by 1024 scrambled points: ½ n^(−1/2 − 1/8) (Z. He and X. Wang, SIAM J. Numer.
/// Anal. 53, 2488 (2015): n^(−1/2 − 1/(2 d)) for steps).
const STEP_ERROR: f64 = 0.5 * 0.013_139;

/// Mean of a function over (0, 1), by midpoints.
fn mean(f: impl Fn(f64) -> f64) -> f64 {
    (0..400).map(|i| f((f64::from(i) + 0.5) / 400.0)).sum::<f64>() / 400.0
}

/// Rms error and rms declared error over the pixels whose a_plate, by columns, is between its ends; their number; the
/// largest error of all.
fn against(operator: &Operator, wanted: impl Fn(f64) -> f64) -> [f64; 4] {
    let columns: Vec<f64> = (0..operator.columns).map(|c| wanted(c as f64)).collect();
    let (low, high) = (columns[0], columns[operator.columns - 1]);
    let (mut square, mut told, mut count, mut largest) = (0.0, 0.0, 0.0, 0.0_f64);
    for (pixel, a) in plate_image(operator).iter().enumerate() {
        let wanted = columns[pixel % operator.columns];
        if wanted > low + 1e-12 && wanted < high - 1e-12 {
            square += (a - wanted).powi(2);
            let active = operator.pixels.iter().position(|&p| p as usize == pixel);
            // Pixels that met nothing declare nothing.
            told += active.map_or(0.0, |i| f64::from(operator.error_plate[i]).powi(2));
            count += 1.0;
        }
        largest = largest.max((a - wanted).abs());
    }
    [(square / count).sqrt(), (told / count).sqrt(), count, largest]
}

/// Share of a unit disc on the side x < s of a line.
fn disc_below(s: f64) -> f64 {
    let s = s.clamp(-1.0, 1.0);
    1.0 - (s.acos() - s * (1.0 - s * s).sqrt()) / PI
}

/// A black half plane 0.1 m behind the plane in focus: each pixel sees past it with the share of a uniform disc, averaged
/// over the pixel. 0.6 m from a lens of 20 mm focused at 0.5 m the disc's radius is 2 mm; for a telecentric one of
/// numerical aperture 0.02 it is 0.1 m · tan(asin 0.02). A pale edge keeps the target; a black one comes to the limit of
/// sub-sights, and its error is what its error image says.
#[test]
fn an_edge_out_of_focus_is_blurred_by_a_disc() {
    let width = 2.0 * 0.5 * 2.5_f64.to_radians().tan();
    let cases = [
        (PINHOLE, Aperture::DiameterM(0.02), width * 1.2, 0.01 * 0.2),
        (
            Projection::Telecentric { width_m: 0.05 },
            Aperture::Numerical(0.02),
            0.05,
            0.1 * 0.02_f64.asin().tan(),
        ),
    ];
    for (projection, aperture, width, radius) in cases {
        let camera = camera(projection, Some(Lens { aperture, focus_m: 0.5 }));
        for depth in [0.2_f64, 50.0] {
            let edge = medium([[-0.1, -5e-6, -0.1], [0.0, 5e-6, 0.1]], [1, 1, 1], 0.0, |_| depth / 1e-5);
            let operator = render(&edge, &camera, &options());
            let [rms, told, count, largest] = against(&operator, |column| {
                let x = |u: f64| ((column + u) / 48.0 - 0.5) * width;
                mean(|u| disc_below(x(u) / radius)) * -(-depth).exp_m1() + (-depth).exp()
            });
            println!(
                "{projection:?}, depth {depth}: {count} blurred pixels, rms {rms:e}, told {told:e}, largest \
                 {largest:e}, {} sights",
                stat(&operator, "sights")
            );
            assert!(count > 100.0);
            if depth < 1.0 {
                assert!(rms < TARGET && largest < 5.0 * TARGET, "{rms:e} {largest:e}");
            } else {
                assert!(rms < STEP_ERROR && largest < 5.0 * STEP_ERROR, "{rms:e} {largest:e}");
            }
            // Both are rms of a few hundred pixels, and what is told holds the largest of four directions.
            assert!((0.7..3.0).contains(&(told / rms)), "{told:e} {rms:e}");
        }
    }
}

/// Through a layer that is the same everywhere a pinhole sees e^−τ/cos θ; through an aperture its mean over the sines.
#[test]
fn a_uniform_slab_is_not_blurred() {
    let slab = medium([[-0.3, -0.01, -0.3], [0.3, 0.01, 0.3]], [20, 4, 20], 0.0, |_| 50.0);
    let numerical = 0.3;
    let parallel = Projection::Telecentric { width_m: 0.05 };
    let camera_of = |lens| camera(parallel, lens);
    let lens = Lens { aperture: Aperture::Numerical(numerical), focus_m: 0.55 };
    let (plain, blurred) =
        (render(&slab, &camera_of(None), &options()), render(&slab, &camera_of(Some(lens)), &options()));
    // Uniform over the disc of sines: s² is uniform.
    let n = 1000;
    let wanted: f64 = (0..n)
        .map(|i| (-1.0 / (1.0 - numerical * numerical * (f64::from(i) + 0.5) / f64::from(n)).sqrt()).exp())
        .sum::<f64>()
        / f64::from(n);
    for (a, b) in plain.a_plate.iter().zip(&blurred.a_plate) {
        assert!((f64::from(*a) - (-1.0_f64).exp()).abs() < 2e-6, "{a}");
        // 8 sub-sights at least: of 0.016 between centre and rim.
        assert!((f64::from(*b) - wanted).abs() < 2.0 * TARGET, "{b} {wanted}");
    }
    assert_eq!(blurred.pixels.len(), 48 * 36);
}

/// Closed down, a lens sees what a pinhole sees: exactly where there is no aperture left, within the errors where it is
/// tiny. An edge in focus stays as sharp as the pixels.
#[test]
fn a_closed_lens_is_a_pinhole() {
    let blob = medium([[-0.02; 3], [0.02; 3]], [24; 3], 0.6, |p| {
        120.0 * (-(p[0] * p[0] + 2.0 * p[1] * p[1] + p[2] * p[2]) / 5e-5).exp()
    });
    let plain = render(&blob, &camera(PINHOLE, None), &options());
    let lens = |diameter_m| Some(Lens { aperture: Aperture::DiameterM(diameter_m), focus_m: 0.5 });
    let shut = render(&blob, &camera(PINHOLE, lens(0.0)), &options());
    assert_eq!((&shut.a_plate, &shut.emission), (&plain.a_plate, &plain.emission));
    let tiny = render(&blob, &camera(PINHOLE, lens(1e-6)), &options());
    let (a, b) = (plate_image(&plain), plate_image(&tiny));
    let rms = (a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt();
    println!("pinhole and closed lens differ by {rms:e} rms");
    // Both have the same target and samples of their own.
    assert!(rms < 1.5 * TARGET, "{rms:e}");
}

/// Scattered light through a wide aperture, against pixels traced one by one, and the same bits for one thread and many.
#[test]
fn scattered_light_through_a_lens_agrees_with_pixels_traced_one_by_one() {
    let blob = medium([[-0.02; 3], [0.02; 3]], [24; 3], 0.7, |p| {
        200.0 * (-(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) / 4e-5).exp()
    });
    let lens = Lens { aperture: Aperture::DiameterM(0.05), focus_m: 0.55 };
    let camera = Camera { columns: 24, rows: 18, ..camera(PINHOLE, Some(lens)) };
    let plate = PlateShape::Rectangle {
        centre_m: [0.0, 0.4, 0.0],
        facing: [0.0, -1.0, 0.0],
        width_m: 0.3,
        height_m: 0.3,
    };
    let options =
        RenderOptions { target_error: 2e-3, motion_m: [2e-3, 0.0, -4e-3], ..RenderOptions::default() };
    let render = || render_image(&blob, &camera, Some(&plate), &options, &|_| {}).unwrap();
    let image = render();
    let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(render);
    assert_eq!((&single.a_plate, &single.emission), (&image.a_plate, &image.emission));
    assert_eq!((&single.error_plate, &single.plate_seen), (&image.error_plate, &image.plate_seen));
    let exact = RenderOptions { target_error: 1e-3, seed: 7, ..options };
    let truth = render_reference(&blob, &camera, Some(&plate), &exact, None, &|_| {}).unwrap();
    let (mut square, mut told, mut count) = ([0.0; 2], [0.0; 2], 0.0);
    for (i, pixel) in image.pixels.iter().enumerate() {
        let Ok(k) = truth.pixels.binary_search(pixel) else { continue };
        let sq = |a: f32, b: f32, se: f32| f64::from(a - b).powi(2) - f64::from(se).powi(2);
        square[0] += sq(image.a_plate[i], truth.a_plate[k], truth.error_plate[k]);
        square[1] += sq(image.emission[i], truth.emission[k], truth.error_medium[k]);
        told[0] += f64::from(image.error_plate[i]).powi(2);
        told[1] += f64::from(image.error_medium[i]).powi(2);
        count += 1.0;
    }
    let [rms, told] = [square, told].map(|s| s.map(|s: f64| (s / count).max(0.0).sqrt()));
    println!("{count} pixels: true rms {rms:?}, told {told:?}, {} sights", stat(&image, "sights"));
    assert!(count > 100.0);
    assert!(rms.iter().all(|&r| r < options.target_error), "{rms:?}");
    assert!(rms.iter().zip(&told).all(|(r, t)| *t > 0.4 * r), "{rms:?} {told:?}");
}

/// An edge that moves by k pixels: each pixel is the mean of still images, here a ramp in closed form; and no motion costs
/// nothing, to the bit.
#[test]
fn motion_blurs_like_the_mean_of_shifted_images() {
    let parallel = camera(Projection::Telecentric { width_m: 0.048 }, None);
    let pixel = 1e-3;
    let edge = medium([[-0.1, -5e-6, -0.1], [0.0, 5e-6, 0.1]], [1, 1, 1], 0.0, |_| 5e6);
    let motion = 5.0 * pixel;
    let moving = RenderOptions { motion_m: [motion, 0.0, 0.0], ..options() };
    let operator = render(&edge, &parallel, &moving);
    let [rms, told, count, largest] = against(&operator, |column| {
        // What lies to the right of the edge, which is uniform over ±motion/2.
        mean(|u| ((column + u - 24.0) * pixel / motion + 0.5).clamp(0.0, 1.0))
    });
    println!(
        "edge moved by 5 pixels: rms {rms:e}, told {told:e}, largest {largest:e} over {count} pixels, {} sights",
        stat(&operator, "sights")
    );
    assert!(count > 150.0 && rms < STEP_ERROR && largest < 5.0 * STEP_ERROR, "{rms:e} {largest:e}");
    assert!((0.7..3.0).contains(&(told / rms)), "{told:e} {rms:e}");

    // A blob with scattering: the mean of 16 still images at midpoints of the exposure, h apart, which errs by h²/24 of
    // the change of the slope over it: below 2.5e-4.
    let blob_at = |shift: f64| {
        medium([[-0.02 + shift, -0.02, -0.02], [0.02 + shift, 0.02, 0.02]], [24; 3], 0.5, |p| {
            let x = p[0] - shift;
            150.0 * (-(x * x + p[1] * p[1] + p[2] * p[2]) / 5e-5).exp()
        })
    };
    let small = Camera { columns: 24, rows: 18, ..parallel };
    let motion = 4.0 * 2e-3;
    let moving = RenderOptions { motion_m: [motion, 0.0, 0.0], ..options() };
    let blurred = plate_image(&render(&blob_at(0.0), &small, &moving));
    let n = 16_u32;
    let mut mean = vec![0.0; blurred.len()];
    for k in 0..n {
        let shift = motion * ((f64::from(k) + 0.5) / f64::from(n) - 0.5);
        let still = plate_image(&render(
            &blob_at(shift),
            &small,
            &RenderOptions { seed: 100 + u64::from(k), ..options() },
        ));
        mean.iter_mut().zip(&still).for_each(|(m, s)| *m += s / f64::from(n));
    }
    let rms =
        (blurred.iter().zip(&mean).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / mean.len() as f64).sqrt();
    println!("blob moved by 4 pixels: rms {rms:e}");
    // Both have the same target, and the still images' errors are alike: they do not average out.
    assert!(rms < 1.5 * TARGET, "{rms:e}");

    let still = render(&blob_at(0.0), &small, &options());
    let zero = render(&blob_at(0.0), &small, &RenderOptions { motion_m: [0.0, -0.0, 0.0], ..options() });
    assert_eq!((&still.a_plate, &still.emission, &still.stats), (&zero.a_plate, &zero.emission, &zero.stats));
    assert!(
        render_image(
            &blob_at(0.0),
            &small,
            None,
            &RenderOptions { motion_m: [f64::NAN; 3], ..options() },
            &|_| {}
        )
        .is_err()
    );
}

/// A plate in focus or not, without a medium: its edge is blurred over the aperture like any other.
#[test]
fn the_plates_edge_is_blurred_too() {
    let nothing = medium([[-0.01; 3], [0.01; 3]], [2; 3], 0.0, |_| 0.0);
    let plate = PlateShape::Rectangle {
        centre_m: [0.1, 0.0, 0.0],
        facing: [0.0, -1.0, 0.0],
        width_m: 0.2,
        height_m: 0.4,
    };
    let camera = camera(PINHOLE, Some(Lens { aperture: Aperture::DiameterM(0.02), focus_m: 0.5 }));
    let image = render_image(&nothing, &camera, Some(&plate), &options(), &|_| {}).unwrap();
    let width = 2.0 * 0.6 * 2.5_f64.to_radians().tan();
    let mut largest = 0.0_f64;
    for (i, &seen) in image.plate_seen.iter().enumerate() {
        let n = 400;
        let x = |u: f64| (((i % 48) as f64 + u) / 48.0 - 0.5) * width;
        let wanted = (0..n).map(|k| disc_below(x((f64::from(k) + 0.5) / f64::from(n)) / 2e-3)).sum::<f64>()
            / f64::from(n);
        largest = largest.max((f64::from(seen) - wanted).abs());
    }
    println!("the plate's edge: largest error {largest:e}");
    // Chords of a smooth profile: the border is found to 2/8/2^9 of a diameter, and 64 of them vary little.
    assert!(largest < 5e-3, "{largest:e}");
}
