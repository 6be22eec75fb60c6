//! All reference rows of radiative transfer through the ray mode, to a tight target: z of every row, rms and largest z.
//!
//! `cargo bench -p ditd-sim --bench accuracy_rte [-- TARGET_ERROR [PATHS_MAX]]`

#![expect(clippy::print_stdout, reason = "a bench prints its figures")]
#![expect(clippy::disallowed_methods, reason = "wall time is what is measured")]

#[path = "../tests/rte_cases/mod.rs"]
mod rte_cases;

use ditd_sim::tracer::rays::RayOptions;
use rte_cases::{Row, grid, half_space, slab, summary, table};
use std::time::Instant;

fn main() {
    let numbers: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let target_error = numbers.first().copied().unwrap_or(2e-4);
    let paths_max = numbers.get(1).map_or(1 << 20, |&n| n.round().to_string().parse().unwrap_or(1 << 20));
    let options = RayOptions { target_error, paths_max, ..RayOptions::default() };
    let start = Instant::now();
    let mut all = Vec::new();
    for (name, f) in [
        ("slab_scatter.csv", slab as fn(&[String], &RayOptions) -> Row),
        ("grid3d.csv", grid),
        ("semi_infinite_isotropic.csv", half_space),
    ] {
        let mut rows = Vec::new();
        for row in table(name) {
            let started = Instant::now();
            let row = f(&row, &options);
            let seconds = started.elapsed().as_secs_f64();
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
        let (largest, rms) = summary(&rows);
        println!(
            "{name}: largest |z| {largest:.2}, rms z {rms:.3}, {:.1} s so far",
            start.elapsed().as_secs_f64()
        );
        all.extend(rows);
    }
    let (largest, rms) = summary(&all);
    println!("all: largest |z| {largest:.2}, rms z {rms:.3}");
}
