//! How finely an image's medium is cut: as coarse as its light allows, again where that was too coarse, and with an error
//! that is told either way.

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;
use ditd_sim::tracer::reference::render_reference;

/// Cells of one optical depth along their edges, albedo 0.9, in a cube from −1 to 1, where `filled` says so.
fn cells(n: usize, depth: f64, filled: impl Fn([usize; 3], f64) -> bool) -> GridMedium {
    let mut medium = GridMedium {
        lower_m: [-1.0; 3],
        upper_m: [1.0; 3],
        cells: [n; 3],
        groups: 1,
        channels: 1,
        index: vec![EMPTY; n.pow(3)],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.5 }],
    };
    let k = depth * n as f64 / 2.0;
    for place in 0..n.pow(3) {
        let cell = [place / n / n, place / n % n, place % n];
        let radius =
            cell.map(|c| (c as f64 + 0.5) / n as f64 * 2.0 - 1.0).iter().map(|x| x * x).sum::<f64>().sqrt();
        if filled(cell, radius) {
            medium.index[place] = u32::try_from(medium.k_ext.len()).expect("few cells");
            medium.k_ext.push(k);
            medium.k_sca.push(0.9 * k);
            medium.emission.push(0.1 * k);
        }
    }
    medium
}

fn camera() -> Camera {
    Camera {
        projection: Projection::Telecentric { width_m: 2.4 },
        position_m: [0.3, -3.0, 0.2],
        look_at_m: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        columns: 24,
        rows: 18,
        // What is judged here is the light scattered into sights, not the mean over pixels.
        pixel_filter: PixelFilter::Centre,
        lens: None,
    }
}

const PLATE: PlateShape = PlateShape::Rectangle {
    centre_m: [0.0, 1.5, 0.0],
    facing: [0.0, -1.0, 0.0],
    width_m: 1.2,
    height_m: 1.2,
};

fn render(medium: &GridMedium, target_error: f64) -> Operator {
    let options = RenderOptions { target_error, ..RenderOptions::default() };
    render_image(medium, &camera(), Some(&PLATE), &options, &|_| {}).expect("a sound scene")
}

fn stat(image: &Operator, name: &str) -> f64 {
    image.stats.iter().find(|(n, _)| n == name).expect("a figure of the work").1
}

/// Whole numbers among the figures of the work, as they are written.
fn counts<const N: usize>(image: &Operator, names: [&str; N]) -> [String; N] {
    names.map(|name| stat(image, name).to_string())
}

/// Rms over the pixels of what the shares of the plate err, without what the judge does, and of what is declared.
fn errors(medium: &GridMedium, image: &Operator, judge_error: f64) -> [f64; 2] {
    let options = RenderOptions { target_error: judge_error, seed: 5, ..RenderOptions::default() };
    let judge =
        render_reference(medium, &camera(), Some(&PLATE), &options, None, &|_| {}).expect("a sound scene");
    assert_eq!(image.pixels, judge.pixels);
    let n = image.pixels.len() as f64;
    let square = |values: &[f32]| values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / n;
    let differ: Vec<f32> = image.a_plate.iter().zip(&judge.a_plate).map(|(a, b)| a - b).collect();
    let own = square(&differ) - square(&judge.error_plate);
    [own.max(0.0).sqrt(), square(&image.error_plate).sqrt()]
}

/// Parts of a brick in which nothing is tell nothing of the light in those beside them: read as darkness, they made
/// every border a kink, for which leaves and cells were cut thrice and a hundred times as many paths followed.
#[test]
fn borders_inside_bricks_call_for_no_smaller_leaves() {
    let medium = cells(12, 0.09, |_, radius| radius < 0.9);
    let image = render(&medium, 1e-3);
    assert_eq!(counts(&image, ["subdivision", "cuts"]), ["1", "1"]);
    assert!(stat(&image, "paths") < 1e6, "{:?}", image.stats);
    let [own, declared] = errors(&medium, &image, 6e-4);
    assert!(own < 1e-3 && (0.5..2.0).contains(&(declared / own)), "{own} {declared}");
}

/// Lumps of two cells along each edge, far from all others: each knows the light beside it from the next lump only.
#[test]
fn lumps_that_stand_apart_know_their_error() {
    let medium = cells(12, 0.09, |[x, y, z], radius| radius < 0.9 && (x / 2 + y / 2 + z / 2) % 2 == 1);
    let image = render(&medium, 1e-3);
    let [own, declared] = errors(&medium, &image, 6e-4);
    assert!(own < 1.3e-3 && (0.5..2.0).contains(&(declared / own)), "{own} {declared}");
}

/// Where nothing lies beside a lump along an axis, nothing tells how the light changes inside: wide lumps are cut into their
/// cells, and single cells once more. As wholes they erred by 7e-3 and 3e-3, and told a tenth of it.
#[test]
fn lumps_inside_which_nothing_tells_of_light_are_cut() {
    let wide = cells(6, 0.09, |[x, y, z], _| (x / 2 + y / 2 + z / 2) % 2 == 1);
    let two = cells(6, 0.09, |[x, y, z], _| !(2..4).contains(&x) && y / 2 == 1 && z / 2 == 1);
    let single = cells(9, 0.09, |[x, y, z], _| (x + y + z) % 2 == 1);
    for (medium, subdivision) in [(&wide, "1"), (&two, "1"), (&single, "2")] {
        let image = render(medium, 1e-3);
        assert_eq!(counts(&image, ["subdivision"]), [subdivision]);
        let [own, declared] = errors(medium, &image, 6e-4);
        // What errs by less than the target may promise less still.
        assert!(own < 1.8e-3 && declared < 1.5e-3, "{own} {declared}");
        assert!((0.5..2.0).contains(&(declared / own)) || own < 1e-3, "{own} {declared}");
    }
}

/// Less than one brick between empty ones: packets look up empty bricks too.
#[test]
fn the_smallest_lump_is_seen_between_empty_bricks() {
    let medium = cells(24, 0.02, |_, radius| radius < 0.15);
    let image = render(&medium, 1e-3);
    assert_eq!(counts(&image, ["bricks", "bricks_skipped"]), ["27", "26"]);
    let [own, declared] = errors(&medium, &image, 3e-4);
    assert!(!image.pixels.is_empty() && own < 5e-4 && declared < 1e-3, "{own} {declared}");
}

/// A thick sheet of more cells than are cut before any light is known: leaves cannot be smaller than cells, and those turn
/// out too coarse.
#[test]
fn cells_that_turn_out_too_coarse_are_cut_once_more() {
    let [wide, depth] = [270, 2];
    let n = wide * wide;
    let (half, k) = (1.0 / wide as f64, (depth * wide) as f64 / 2.0);
    let medium = GridMedium {
        lower_m: [-1.0, -half, -1.0],
        upper_m: [1.0, half, 1.0],
        cells: [wide, 1, wide],
        index: (0..u32::try_from(n).unwrap()).collect(),
        k_ext: vec![k; n],
        k_sca: vec![0.9 * k; n],
        emission: vec![0.1 * k; n],
        ..cells(1, 1.0, |_, _| true)
    };
    let image = render(&medium, 1.2e-2);
    // Leaves of single cells were not cut in vain before the cells were.
    assert_eq!(counts(&image, ["subdivision", "cuts"]), ["2", "1"]);
    assert!(stat(&image, "error_reconstruction") < 1.2e-2, "{:?}", image.stats);
}
