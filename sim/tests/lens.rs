//! Blur by a lens and by motion during the exposure: against closed forms, against still images, and against pixels
//! traced one by one.

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

/// Share of a unit disc on the side x < s of a line.
fn disc_below(s: f64) -> f64 {
    let s = s.clamp(-1.0, 1.0);
    1.0 - (s.acos() - s * (1.0 - s * s).sqrt()) / PI
}

/// A black half plane 0.1 m behind the plane in focus: each pixel sees past it with the share of a uniform disc, averaged
/// over the pixel. 0.6 m from a lens of 20 mm focused at 0.5 m the disc's radius is 2 mm; for a telecentric one of
/// numerical aperture 0.02 it is 0.1 m · tan(asin 0.02).
#[test]
fn an_edge_out_of_focus_is_blurred_by_a_disc() {
    let edge = medium([[-0.1, -5e-6, -0.1], [0.0, 5e-6, 0.1]], [1, 1, 1], 0.0, |_| 5e6);
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
        let operator = render(&edge, &camera, &options());
        let image = plate_image(&operator);
        let (mut square, mut count, mut largest) = (0.0, 0.0, 0.0_f64);
        for (pixel, &a) in image.iter().enumerate() {
            let column = (pixel % 48) as f64;
            let x = |u: f64| ((column + u) / 48.0 - 0.5) * width;
            let n = 400;
            let wanted: f64 =
                (0..n).map(|i| disc_below(x((f64::from(i) + 0.5) / f64::from(n)) / radius)).sum::<f64>()
                    / f64::from(n);
            if wanted > 0.0 && wanted < 1.0 {
                square += (a - wanted).powi(2);
                count += 1.0;
            }
            largest = largest.max((a - wanted).abs());
        }
        let rms = f64::sqrt(square / count);
        let told = operator.error_plate.iter().map(|&e| f64::from(e).powi(2)).sum::<f64>();
        let told = (told / operator.error_plate.len() as f64).sqrt();
        println!(
            "{projection:?}: rms {rms:e}, largest {largest:e}, told {told:e} over all, {} sights",
            stat(&operator, "sights")
        );
        assert!(count > 100.0);
        // Half the target goes to the pixels' means; blurred pixels err like the declared errors of them say.
        assert!(rms < TARGET, "{rms:e}");
        // 1700 pixels: 5σ of the tolerance.
        assert!(largest < 5.0 * TARGET, "{largest:e}");
    }
}
