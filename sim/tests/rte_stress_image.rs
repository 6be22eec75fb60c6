//! Images where numbers hurt: every size, camera and field gives finite coefficients that close, or a typed error.

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;

/// A cube from −1 to 1 of n³ cells with the extinction of each cell.
fn cube(n: usize, albedo: f64, asymmetry: f64, extinction: impl Fn([usize; 3]) -> f64) -> GridMedium {
    let k_ext: Vec<f64> = (0..n * n * n).map(|i| extinction([i / (n * n), i / n % n, i % n])).collect();
    GridMedium {
        lower_m: [-1.0; 3],
        upper_m: [1.0; 3],
        cells: [n; 3],
        groups: 1,
        channels: 1,
        index: (0..).take(n * n * n).collect(),
        k_sca: k_ext.iter().map(|k| albedo * k).collect(),
        emission: k_ext.iter().map(|k| k - albedo * k).collect(),
        k_ext,
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry }],
    }
}

fn camera(columns: usize, rows: usize) -> Camera {
    Camera {
        projection: Projection::Pinhole { horizontal_fov_deg: 40.0 },
        position_m: [0.0, -4.0, 0.0],
        look_at_m: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        columns,
        rows,
        pixel_filter: PixelFilter::Centre,
        lens: None,
    }
}

fn plate() -> PlateShape {
    PlateShape::Rectangle { centre_m: [0.0, 1.5, 0.0], facing: [0.0, -1.0, 0.0], width_m: 6.0, height_m: 6.0 }
}

fn render(medium: &GridMedium, camera: &Camera) -> Operator {
    // Coefficients are sound whatever their errors are: few paths show it as well as many.
    let options = RenderOptions { target_error: 1e-2, paths_max: 1 << 13, ..RenderOptions::default() };
    let image = render_image(medium, camera, Some(&plate()), &options, &|_| {}).expect("a sound scene");
    assert_eq!(image.plate_seen.len(), camera.rows * camera.columns);
    assert!(image.pixels.windows(2).all(|p| p[0] < p[1]));
    for i in 0..image.pixels.len() {
        let (plate, medium) = (image.a_plate[i], image.emission[i]);
        // An enclosure at one temperature: the three shares are shares, to single precision.
        assert!((0.0..=1.0).contains(&plate) && (0.0..=1.0).contains(&medium), "{plate} {medium}");
        assert!(plate + medium <= 1.0 + 1e-6, "{plate} {medium}");
        assert!(image.error_plate[i].is_finite() && image.error_medium[i].is_finite());
    }
    image
}

#[test]
fn images_may_have_any_size() {
    let medium = cube(4, 0.5, 0.8, |_| 0.5);
    for (columns, rows) in [(0, 0), (0, 7), (7, 0), (1, 1), (1, 5), (5, 1), (3, 2)] {
        let image = render(&medium, &camera(columns, rows));
        assert_eq!((image.columns, image.rows), (columns, rows));
    }
    let black = cube(4, 0.0, 0.0, |_| 0.5);
    let image = render(&black, &camera(641, 513));
    let centre = image.pixels.iter().position(|p| *p as usize == 256 * 641 + 320).unwrap();
    // The sight through the middle of the middle pixel is the axis: two metres at 0.5 per metre.
    assert!((f64::from(image.a_plate[centre]) - (-1.0_f64).exp()).abs() < 2e-6);
}

#[test]
fn cameras_that_make_no_sense_are_refused_and_extreme_ones_are_not() {
    let medium = cube(3, 0.5, 0.5, |_| 0.5);
    let good = camera(9, 7);
    for angle in [1e-6, 90.0, 179.0] {
        render(
            &medium,
            &Camera { projection: Projection::Pinhole { horizontal_fov_deg: angle }, ..good.clone() },
        );
    }
    // Inside the medium, on its face and corner.
    for position_m in [[0.1, 0.2, 0.3], [0.0, -1.0, 0.0], [-1.0, -1.0, -1.0]] {
        render(&medium, &Camera { position_m, ..good.clone() });
    }
    let mut bad: Vec<Camera> = [0.0, -1.0, 180.0, f64::NAN]
        .map(|angle| Camera { projection: Projection::Pinhole { horizontal_fov_deg: angle }, ..good.clone() })
        .into();
    for width_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        bad.push(Camera { projection: Projection::Telecentric { width_m }, ..good.clone() });
    }
    bad.push(Camera { position_m: [f64::NAN, 0.0, 0.0], ..good.clone() });
    bad.push(Camera { look_at_m: good.position_m, ..good.clone() });
    bad.push(Camera { up: [0.0, 1.0, 0.0], ..good.clone() });
    bad.push(Camera { up: [0.0; 3], ..good.clone() });
    for camera in bad {
        let answer = render_image(&medium, &camera, None, &RenderOptions::default(), &|_| {});
        assert!(matches!(answer, Err(TracerError::Geometry { .. })), "{camera:?}");
    }
}

/// Single precision keeps what it can: e^−τ to its own rounding from denormal depths to opaque ones, never black or NaN.
#[test]
fn depths_may_be_denormal_or_opaque() {
    for depth in [0.0_f64, 5e-324, 1e-308, 1e-20, 1e-8, 1e-3, 1.0, 20.0, 36.8, 87.4, 103.3, 745.2, 1e4, 1e6] {
        for albedo in [0.0, 0.5, 1.0] {
            let medium = cube(1, albedo, 0.5, |_| 0.5 * depth);
            let image = render(&medium, &camera(5, 3));
            if albedo == 0.0 && !image.pixels.is_empty() {
                let centre = image.pixels.iter().position(|p| *p == 7).unwrap();
                let got = f64::from(image.a_plate[centre]);
                assert!((got - (-depth).exp()).abs() < 1e-6, "{depth}: {got}");
            }
        }
    }
}

#[test]
fn fields_may_be_wildly_uneven() {
    let decades =
        |c: [usize; 3]| 10_f64.powi(i32::try_from((c[0] * 49 + c[1] * 7 + c[2]) * 300 / 342).unwrap() - 150);
    let spike = |c: [usize; 3]| if c == [3, 3, 3] { 1e9 } else { 1.0 };
    let board = |c: [usize; 3]| if (c[0] + c[1] + c[2]).is_multiple_of(2) { 0.0 } else { 1e6 };
    let fields: [&dyn Fn([usize; 3]) -> f64; 3] = [&decades, &spike, &board];
    for field in fields {
        for (albedo, asymmetry) in
            [(0.0, 0.0), (0.6, 0.85), (1.0, 0.5), (0.9, 1.0), (0.9, -1.0), (0.9, -0.999), (0.5, 1e-9)]
        {
            let image = render(&cube(7, albedo, asymmetry, field), &camera(8, 6));
            assert!(!image.pixels.is_empty());
        }
    }
}

/// Layers across the sight change nothing: the same medium in 1 … 30 cells per axis.
#[test]
fn cuts_through_a_uniform_medium_change_nothing() {
    let images = [1, 2, 7, 30].map(|n| render(&cube(n, 0.0, 0.0, |_| 0.8), &camera(12, 9)));
    for image in &images[1..] {
        assert_eq!(image.pixels, images[0].pixels);
        for (a, b) in image.a_plate.iter().zip(&images[0].a_plate) {
            assert!((a - b).abs() < 2e-6, "{a} {b}");
        }
    }
}
