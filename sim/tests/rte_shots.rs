//! Further shots of a spray: only the sights are followed again.

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::{RenderOptions, render_image, render_shots};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;

const CELLS: usize = 32;

/// Two plumes of optical depth 2 with two channels.
fn plumes() -> GridMedium {
    let mut medium = GridMedium {
        lower_m: [-0.02; 3],
        upper_m: [0.02; 3],
        cells: [CELLS; 3],
        groups: 1,
        channels: 2,
        index: vec![EMPTY; CELLS.pow(3)],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.8 }],
    };
    for place in 0..CELLS.pow(3) {
        let at = [place / CELLS / CELLS, place / CELLS % CELLS, place % CELLS]
            .map(|i| (i as f64 + 0.5) / CELLS as f64 * 2.0 - 1.0);
        let plume = |x: f64| {
            let r = (at[0] - x * (1.2 - at[2])).powi(2) + at[1].powi(2);
            (-r / (2.0 * 0.15_f64.powi(2))).exp()
        };
        let k = 200.0 * (plume(0.25) + plume(-0.25));
        if k < 0.5 {
            continue;
        }
        medium.index[place] = u32::try_from(medium.k_ext.len()).expect("a small grid");
        medium.k_ext.push(k);
        medium.k_sca.push(0.5 * k);
        medium.emission.extend([0.5 * k, 0.5 * k * (1.0 + 0.2 * at[2])]);
    }
    medium
}

/// Smooth factors with a mean of 1 and a deviation of about 0.2.
#[expect(clippy::cast_possible_truncation, reason = "factors near 1")]
fn factors(medium: &GridMedium, shot: f64) -> Vec<f32> {
    let mut out = vec![1.0; medium.occupied()];
    for (place, &ordinal) in medium.index.iter().enumerate().filter(|(_, o)| **o != EMPTY) {
        let [x, y, z] =
            [place / CELLS / CELLS, place / CELLS % CELLS, place % CELLS].map(|i| i as f64 / CELLS as f64);
        let wave = (9.0 * x + 2.0 * shot).sin() + (7.0 * z - shot).sin() * (8.0 * y + shot).cos();
        out[ordinal as usize] = (1.0 + 0.2 * wave) as f32;
    }
    out
}

fn camera() -> Camera {
    Camera {
        projection: Projection::Telecentric { width_m: 0.05 },
        position_m: [0.0, -0.2, 0.0],
        look_at_m: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        columns: 60,
        rows: 48,
        pixel_filter: PixelFilter::Box,
        lens: None,
    }
}

const PLATE: PlateShape = PlateShape::Rectangle {
    centre_m: [0.0, 0.2, 0.0],
    facing: [0.0, -1.0, 0.0],
    width_m: 0.3,
    height_m: 0.3,
};

fn stat(image: &Operator, name: &str) -> Option<f64> {
    image.stats.iter().find(|(n, _)| n == name).map(|(_, v)| *v)
}

#[test]
fn a_shot_follows_sights_only_and_is_what_a_whole_rendering_gives() {
    let medium = plumes();
    let options = RenderOptions { target_error: 2e-3, ..RenderOptions::default() };
    let shot = factors(&medium, 1.0);
    let mut images = Vec::new();
    let mut shots = [vec![1.0; medium.occupied()], shot.clone()].into_iter();
    let mut take = |image| images.push(image);
    render_shots(&medium, &camera(), Some(&PLATE), &options, &mut shots, &mut take, &|_| {}).unwrap();
    let [mean, same, denser] = &images[..] else { panic!("three images") };
    assert!(stat(mean, "paths").unwrap() > 1e4);
    assert!(stat(denser, "paths").is_none() && stat(denser, "sights").unwrap() > 500.0);

    let mut whole = medium.clone();
    for (cell, f) in shot.iter().enumerate() {
        whole.k_ext[cell] *= f64::from(*f);
        whole.k_sca[cell] *= f64::from(*f);
        whole.emission[2 * cell] *= f64::from(*f);
        whole.emission[2 * cell + 1] *= f64::from(*f);
    }
    let whole = render_image(&whole, &camera(), Some(&PLATE), &options, &|_| {}).unwrap();
    assert_eq!(whole.pixels, denser.pixels);
    let rms = |a: &[f32], b: &[f32]| {
        (a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
    };
    // The mean spray once more is the same image but for the rounding of E^f, without a path.
    let again = rms(&mean.a_plate, &same.a_plate).max(rms(&mean.emission, &same.emission));
    assert!(again < 1e-6, "{again}");
    let moved = rms(&mean.a_plate, &whole.a_plate);
    let [plate, emission] = [rms(&denser.a_plate, &whole.a_plate), rms(&denser.emission, &whole.emission)];
    let direct = rms(&denser.direct, &whole.direct);
    println!("moved {moved:.1e}, plate {plate:.1e}, emission {emission:.1e}, direct {direct:.1e}");
    // The shot is far from the mean; what is kept of the mean's light shows by an eighth of that.
    assert!(moved > 2e-2, "{moved}");
    assert!(plate < 0.13 * moved && emission < 0.13 * moved, "{plate} {emission} of {moved}");
    // The straight part is that of the shot itself but for the pixels' own errors.
    assert!(direct < 1.2e-3, "{direct}");
}

#[test]
fn factors_that_make_no_sense_are_refused() {
    let medium = plumes();
    let options = RenderOptions { target_error: 2e-2, ..RenderOptions::default() };
    let n = medium.occupied();
    for (bad, entry) in [(f32::NAN, 3), (-0.1, 0), (f32::INFINITY, n - 1)] {
        let mut factors = vec![1.0; n];
        factors[entry] = bad;
        let mut shots = [factors].into_iter();
        let answer =
            render_shots(&medium, &camera(), Some(&PLATE), &options, &mut shots, &mut |_| {}, &|_| {});
        assert!(
            matches!(answer, Err(TracerError::Coefficient { what: "a shot's factors", entry: e, .. }) if e == entry)
        );
    }
    let mut shots = [vec![1.0; n - 1]].into_iter();
    let answer = render_shots(&medium, &camera(), Some(&PLATE), &options, &mut shots, &mut |_| {}, &|_| {});
    assert!(
        matches!(answer, Err(TracerError::Shape { found, expected, .. }) if found + 1 == n && expected == n)
    );
}
