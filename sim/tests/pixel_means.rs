//! Means over the area of pixels, against a camera of 24² times as many: media of hard blocks, seen along their edges
//! and across them.

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;

const CELLS: usize = 24;
const ROWS: usize = 45;
const COLUMNS: usize = 60;
/// Faces of cells that are seen from the side fall between such pixels: 25/12 of a pixel lie between them.
const FINER: usize = 24;

/// A blob in a cube from −1 to 1 that ends at once, without scattering.
fn blob() -> GridMedium {
    let mut medium = GridMedium {
        lower_m: [-1.0; 3],
        upper_m: [1.0; 3],
        cells: [CELLS; 3],
        groups: 1,
        channels: 1,
        index: vec![EMPTY; CELLS.pow(3)],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: vec![PhaseFunction::Isotropic],
    };
    let mut occupied = 0;
    for place in 0..CELLS.pow(3) {
        let at = [place / CELLS / CELLS, place / CELLS % CELLS, place % CELLS]
            .map(|i| (i as f64 + 0.5) / CELLS as f64 * 2.0 - 1.0);
        let square: f64 = at.iter().map(|x| x * x).sum();
        if square > 0.4 {
            continue;
        }
        medium.index[place] = occupied;
        occupied += 1;
        let k = 4.0 * (-square / 0.2).exp();
        medium.k_ext.push(k);
        medium.k_sca.push(0.0);
        medium.emission.push(k);
    }
    medium
}

/// Plate in all pixels, and the declared error's mean square over those that meet the medium.
fn render(position_m: [f64; 3], finer: usize, target_error: f64) -> (Vec<f64>, f64, Operator) {
    let camera = Camera {
        projection: Projection::Telecentric { width_m: 2.4 },
        position_m,
        look_at_m: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        columns: COLUMNS * finer,
        rows: ROWS * finer,
        pixel_filter: if finer > 1 { PixelFilter::Centre } else { PixelFilter::Box },
        lens: None,
    };
    let plate = PlateShape::Cone { facing: [0.0, -1.0, 0.0], half_angle_deg: 90.0 };
    let options = RenderOptions { target_error, ..RenderOptions::default() };
    let image = render_image(&blob(), &camera, Some(&plate), &options, &|_| {}).expect("a sound scene");
    let mut plate = vec![1.0; camera.rows * camera.columns];
    for (&pixel, &a) in image.pixels.iter().zip(&image.a_plate) {
        plate[pixel as usize] = f64::from(a);
    }
    let square = image.error_plate.iter().map(|e| f64::from(*e).powi(2)).sum::<f64>();
    (plate, square / image.error_plate.len() as f64, image)
}

#[test]
fn means_over_pixels_of_blocky_media_keep_their_declared_errors() {
    for (view, position_m) in
        [("along the edges", [0.0, -3.0, 0.0]), ("across", [1.1, -3.0, 0.7]), ("slanted", [0.05, -3.0, 0.02])]
    {
        let (fine, _, _) = render(position_m, FINER, 1e-6);
        let mut mean = vec![0.0; ROWS * COLUMNS];
        for (i, value) in fine.iter().enumerate() {
            let (row, column) = (i / (COLUMNS * FINER) / FINER, i % (COLUMNS * FINER) / FINER);
            mean[row * COLUMNS + column] += value / (FINER * FINER) as f64;
        }
        for target in [1e-2, 3e-3, 1e-3] {
            let (plate, declared, image) = render(position_m, 1, target);
            let square: f64 =
                image.pixels.iter().map(|&p| (plate[p as usize] - mean[p as usize]).powi(2)).sum();
            let error = (square / image.pixels.len() as f64).sqrt();
            let ratio = declared.sqrt() / error;
            println!("{view}, {target}: error {error:.1e}, declared over it {ratio:.2}");
            assert!((0.7..2.5).contains(&ratio), "{view}, {target}: {error} {ratio}");
            assert!(error < 2.0 * target, "{view}: {error} at {target}");
        }
    }
}
