//! Time and error of image mode on a spray like the quickstart's: eight plumes, 17 wavelengths, 6 channels, 640×512.
//!
//! `cargo bench -p ditd-sim --bench render [-- TARGET_ERROR [TIMES_FINER]]`: prints seconds, the declared error, and the difference
//! from a render with four times the accuracy.

#![expect(clippy::print_stdout, reason = "a bench prints its figures")]
#![expect(clippy::disallowed_methods, reason = "wall time is what is measured")]

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;
use std::time::Instant;

const GROUPS: usize = 17;
const CHANNELS: usize = 6;

fn spray() -> GridMedium {
    let cells = [50, 50, 60];
    let mut medium = GridMedium {
        lower_m: [-0.025, -0.025, -0.06],
        upper_m: [0.025, 0.025, 0.0],
        cells,
        groups: GROUPS,
        channels: CHANNELS,
        index: vec![EMPTY; cells[0] * cells[1] * cells[2]],
        k_ext: vec![],
        k_sca: vec![],
        emission: vec![],
        phase: (0..GROUPS)
            .map(|g| PhaseFunction::HenyeyGreenstein { asymmetry: 0.85 + 0.1 * g as f64 / GROUPS as f64 })
            .collect(),
    };
    let mut ordinal = 0;
    for x in 0..cells[0] {
        for y in 0..cells[1] {
            for z in 0..cells[2] {
                let p = [x, y, z].map(|i| i as f64 + 0.5);
                let (px, py, depth) = (p[0] - 25.0, p[1] - 25.0, 60.0 - p[2]);
                let mut k: f64 = 0.0;
                for hole in 0..8 {
                    let angle = std::f64::consts::TAU * (f64::from(hole) + 0.3) / 8.0;
                    let (cx, cy) = (0.36 * depth * angle.cos(), 0.36 * depth * angle.sin());
                    let w = 0.9 + 0.07 * depth;
                    let r2 = (px - cx).powi(2) + (py - cy).powi(2);
                    k += 3500.0 / (w * w) * (-r2 / (2.0 * w * w)).exp() * (-(depth / 48.0).powi(8)).exp();
                }
                if k < 0.5 {
                    continue;
                }
                medium.index[(x * cells[1] + y) * cells[2] + z] = ordinal;
                ordinal += 1;
                let temperature = 350.0 + 2.0 * depth;
                let ke: Vec<f64> = (0..GROUPS).map(|g| k * (0.8 + 0.4 * g as f64 / 16.0)).collect();
                let albedo: Vec<f64> =
                    (0..GROUPS).map(|g| 0.5 + 0.45 * ((g * 7) % 17) as f64 / 16.0).collect();
                for c in 0..CHANNELS {
                    let source =
                        if c == 0 { 1.0 } else { (temperature / 400.0).powi(i32::try_from(c).unwrap_or(1)) };
                    medium.emission.extend((0..GROUPS).map(|g| ke[g] * (1.0 - albedo[g]) * source));
                }
                medium.k_sca.extend((0..GROUPS).map(|g| ke[g] * albedo[g]));
                medium.k_ext.extend(ke);
            }
        }
    }
    medium
}

fn main() {
    let numbers: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let target = numbers.first().copied().unwrap_or(3e-3);
    let finer = numbers.get(1).copied().unwrap_or(4.0);
    let medium = spray();
    let camera = Camera {
        projection: Projection::Pinhole { horizontal_fov_deg: 9.5 },
        position_m: [0.0, -0.6, -0.03],
        look_at_m: [0.0, 0.0, -0.03],
        up: [0.0, 0.0, 1.0],
        columns: 640,
        rows: 512,
        pixel_filter: PixelFilter::Box,
    };
    let plate = PlateShape::Rectangle {
        centre_m: [0.0, 0.25, -0.03],
        facing: [0.0, -1.0, 0.0],
        width_m: 0.2,
        height_m: 0.2,
    };
    let render = |target_error: f64, seed: u64, path_coarsening: usize| {
        let options = RenderOptions { target_error, seed, path_coarsening, ..RenderOptions::default() };
        let (start, before) = (Instant::now(), processor_seconds());
        let image = render_image(&medium, &camera, Some(&plate), &options, &|_| {});
        let seconds = start.elapsed().as_secs_f64();
        println!("  processor {:.2} s", processor_seconds() - before);
        image.map(|image| (image, seconds))
    };
    let cells = medium.occupied();
    println!("cells {cells}");
    let reference = render(target / finer, 99, 1);
    for seed in 1..=3 {
        let coarse = numbers.get(2).map_or(0, |&c| if c > 1.5 { 2 } else { 1 });
        let (Ok((image, seconds)), Ok((reference, slow))) = (render(target, seed, coarse), &reference) else {
            return;
        };
        println!("target {target} seed {seed}: {seconds:.2} s (reference {slow:.2} s)");
        if seed == 1 {
            for (name, value) in &image.stats {
                println!("  {name} {value}");
            }
        }
        println!(
            "  true rms a_plate {:.2e} a_medium {:.2e}",
            rms(&image, reference, true),
            rms(&image, reference, false)
        );
    }
}

/// Processor time of this process in seconds (Linux; 0 elsewhere): what counts on a machine shared with others.
fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    // Fields 14 and 15, in hundredths of a second.
    after.split_whitespace().skip(11).take(2).filter_map(|f| f.parse::<f64>().ok()).sum::<f64>() / 100.0
}

fn rms(a: &Operator, b: &Operator, plate: bool) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for i in 0..a.pixels.len() {
        for g in 0..GROUPS {
            let d = if plate {
                a.a_plate[i * GROUPS + g] - b.a_plate[i * GROUPS + g]
            } else {
                a.emission[i * GROUPS * CHANNELS + g] - b.emission[i * GROUPS * CHANNELS + g]
            };
            sum += f64::from(d) * f64::from(d);
            n += 1.0;
        }
    }
    (sum / n).sqrt()
}
