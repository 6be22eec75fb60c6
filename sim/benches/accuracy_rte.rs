//! All reference rows of radiative transfer through the ray mode, to a tight target: z of every row, rms and largest z.
//!
//! `cargo bench -p ditd-sim --bench accuracy_rte [-- TARGET_ERROR [PATHS_MAX [SEED]]]`, rows of which the name holds ROWS in the environment.

#![expect(clippy::print_stdout, reason = "a bench prints its figures")]
#![expect(clippy::disallowed_methods, reason = "wall time is what is measured")]

#[path = "../tests/rte_cases/mod.rs"]
mod rte_cases;

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::shape::{Body, Shape, ShapeMedium};
use rte_cases::{Row, grid, half_space, slab, summary, table};
use std::time::Instant;

fn main() {
    let numbers: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let target_error = numbers.first().copied().unwrap_or(1e-4);
    let paths_max = numbers.get(1).map_or(1 << 24, |&n| n.round().to_string().parse().unwrap_or(1 << 24));
    let seed = numbers.get(2).map_or(1, |&n| n.round().to_string().parse().unwrap_or(1));
    let rows_wanted = std::env::var("ROWS").unwrap_or_default();
    let options = RayOptions { target_error, paths_max, seed, ..RayOptions::default() };
    let start = Instant::now();
    let mut all = Vec::new();
    for (name, f) in [
        ("slab_scatter.csv", slab as fn(&[String], &RayOptions) -> Row),
        ("grid3d.csv", grid),
        ("semi_infinite_isotropic.csv", half_space),
    ] {
        let mut rows = Vec::new();
        for row in table(name) {
            if !row.join(",").contains(&rows_wanted) {
                continue;
            }
            let started = processor_seconds();
            let row = f(&row, &options);
            let seconds = processor_seconds() - started;
            let z: Vec<String> =
                row.values.iter().zip(row.z()).map(|(v, z)| format!("{} {z:+.2}", v.0)).collect();
            let worst = row.values.iter().fold(0.0_f64, |a, v| a.max(v.4));
            println!(
                "{:60} se {worst:.1e} paths {:8} cut {} {seconds:6.2} s  z {}",
                row.name,
                row.answer.paths,
                row.answer.cut,
                z.join(" ")
            );
            rows.push(row);
        }
        if rows.is_empty() {
            continue;
        }
        let (largest, rms) = summary(&rows);
        let furthest = rows.iter().flat_map(|r| &r.values).fold(0.0_f64, |a, v| a.max((v.3 - v.1).abs()));
        println!(
            "{name}: largest |z| {largest:.2}, rms z {rms:.3}, largest error {furthest:.1e}; so far processor {:.1} s, wall {:.1} s",
            processor_seconds(),
            start.elapsed().as_secs_f64()
        );
        all.extend(rows);
    }
    lists(&options);
    pixels();
    if all.is_empty() {
        return;
    }
    let (largest, rms) = summary(&all);
    println!("all: largest |z| {largest:.2}, rms z {rms:.3}");
}

/// Lists of four rays through deep slabs, the cosines of the tables: time, and the largest standard error.
fn lists(options: &RayOptions) {
    for (name, albedo, depth, half_angle_deg) in [
        ("iso", 1.0, 40.0, 90.0),
        ("iso", 0.999, 40.0, 90.0),
        ("iso", 0.9, 40.0, 90.0),
        ("hg0_9", 1.0, 40.0, 90.0),
        ("hg0_9", 0.999, 40.0, 90.0),
        ("hg0_9", 0.9, 40.0, 10.0),
        ("mie_a", 1.0, 40.0, 90.0),
        ("mie_a", 0.95, 40.0, 20.0),
        ("iso", 1.0, 400.0, 90.0),
        ("hg0_9", 0.9999, 1000.0, 90.0),
    ] {
        let medium = ShapeMedium {
            shape: Shape::Slab { thickness_m: 0.01, optical_depth: depth },
            albedo,
            phase: rte_cases::phase(name),
        };
        let plate =
            Plate::new(&PlateShape::Cone { facing: [0.0, 0.0, 1.0], half_angle_deg }).expect("a plate");
        let body = Body::shape(&medium).expect("a slab");
        let rays = [1.0_f64, 0.9, 0.6, 0.2].map(|mu| ([0.0, 0.0, 1.0], [(1.0 - mu * mu).sqrt(), 0.0, -mu]));
        let (wall, processor) = (Instant::now(), processor_seconds());
        let answers = render_rays(&body, &rays, Some(&plate), options).expect("rays");
        let worst =
            answers.iter().fold(0.0_f64, |a, r| a.max(r.se_plate).max(r.se_walls).max(r.se_medium[0]));
        let cut: u64 = answers.iter().map(|a| a.cut).sum();
        println!(
            "four rays: slab {name} omega {albedo} tau {depth} half angle {half_angle_deg}: largest se {worst:.1e}, \
             paths {:?} cut {cut}, processor {:.2} s, wall {:.2} s, a_plate {:.6?}",
            answers.iter().map(|a| a.paths).collect::<Vec<_>>(),
            processor_seconds() - processor,
            wall.elapsed().as_secs_f64(),
            answers.iter().map(|a| a.plate).collect::<Vec<_>>()
        );
    }
}

/// Every pixel of a small image as a ray of its own, to the target of images.
fn pixels() {
    let (columns, rows, target_error) = (160_u32, 128_u32, 1e-3);
    let shape = Shape::Sphere { centre_m: [0.0; 3], radius_m: 1.0, extinction: 2.0 };
    let medium =
        ShapeMedium { shape, albedo: 0.9, phase: PhaseFunction::HenyeyGreenstein { asymmetry: 0.8 } };
    let body = Body::shape(&medium).expect("a sphere");
    let shape = PlateShape::Rectangle {
        centre_m: [0.0, 2.0, 0.0],
        facing: [0.0, -1.0, 0.0],
        width_m: 3.0,
        height_m: 3.0,
    };
    let plate = Plate::new(&shape).expect("a plate");
    let place = |i: u32, n: u32| 3.0 * ((f64::from(i) + 0.5) / f64::from(n) - 0.5);
    let rays: Vec<_> = (0..rows * columns)
        .map(|i| ([place(i % columns, columns), -3.0, place(i / columns, rows)], [0.0, 1.0, 0.0]))
        .collect();
    let see = |seed: u64, target_error: f64, rays: &[_]| {
        let options = RayOptions { target_error, seed, ..RayOptions::default() };
        render_rays(&body, rays, Some(&plate), &options).expect("rays")
    };
    let (wall, processor) = (Instant::now(), processor_seconds());
    let image = see(1, target_error, &rays);
    let (processor, wall) = (processor_seconds() - processor, wall.elapsed().as_secs_f64());
    let active: Vec<usize> = (0..rays.len()).filter(|&i| image[i].paths > 0).collect();
    let chosen: Vec<usize> = active.iter().copied().step_by(101).collect();
    let truth = see(2, 1e-4, &chosen.iter().map(|&i| rays[i]).collect::<Vec<_>>());
    let rms = |f: &dyn Fn(usize, &RayAnswer) -> f64| {
        (chosen.iter().zip(&truth).map(|(&i, t)| f(i, t).powi(2)).sum::<f64>() / chosen.len() as f64).sqrt()
    };
    println!(
        "sphere {columns}x{rows}, target {target_error}: {} pixels meet it, paths each {:.0}, processor {processor:.1} s, \
         wall {wall:.1} s, true rms error a_plate {:.1e} a_medium {:.1e}, declared {:.1e} {:.1e}",
        active.len(),
        active.iter().map(|&i| image[i].paths as f64).sum::<f64>() / active.len() as f64,
        rms(&|i, t| image[i].plate - t.plate),
        rms(&|i, t| image[i].medium[0] - t.medium[0]),
        rms(&|i, _| image[i].se_plate),
        rms(&|i, _| image[i].se_medium[0]),
    );
}

/// Processor time of this process in seconds (Linux; 0 elsewhere): what counts on a machine shared with others.
fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    // Fields 14 and 15, in hundredths of a second.
    after.split_whitespace().skip(11).take(2).filter_map(|f| f.parse::<f64>().ok()).sum::<f64>() / 100.0
}
