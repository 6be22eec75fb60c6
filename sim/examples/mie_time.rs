//! Time of Mie efficiencies on this machine: a table of 200 radii by 64 wavelengths, and single spheres; minima.

#![expect(
    clippy::disallowed_methods,
    clippy::print_stdout,
    reason = "a stopwatch that prints, not a simulation"
)]

use ditd_sim::light::mie::{Sphere, efficiencies, efficiencies_of_many};
use std::time::Instant;
fn index(um: f64) -> (f64, f64) {
    let (nu0, gamma, s) = (2930.0, 60.0, 0.02);
    let nu = 1e4 / um;
    let d = (nu0 * nu0 - nu * nu) / (nu0 * nu0);
    let g = gamma * nu / (nu0 * nu0);
    let den = d * d + g * g;
    (1.38 + 0.5 * s * d / den * 0.1, (0.5 * s * g / den * 0.2).max(5e-4))
}
fn main() {
    let mut spheres = Vec::new();
    for w in 0..64 {
        let um = 3.0 + 2.0 * w as f64 / 63.0;
        let (n, k) = index(um);
        for r in 0..200 {
            let radius = 0.1 * 1000f64.powf(r as f64 / 199.0);
            spheres.push(Sphere { size_parameter: 2.0 * std::f64::consts::PI * radius / um, n, k });
        }
    }
    let mut best = f64::INFINITY;
    let mut sum = 0.0;
    for _ in 0..20 {
        let start = Instant::now();
        sum = efficiencies_of_many(&spheres)
            .expect("every sphere here is legal")
            .iter()
            .map(|q| q.q_ext)
            .sum::<f64>();
        best = best.min(start.elapsed().as_secs_f64());
    }
    println!("table: {:.3} ms, sum {sum}", best * 1e3);
    for x in [1.0, 10.0, 100.0, 1000.0, 10000.0] {
        let (mut one, mut eight) = (f64::INFINITY, f64::INFINITY);
        let same = [Sphere { size_parameter: x, n: 1.38, k: 0.09 }; 64];
        for _ in 0..50 {
            let start = Instant::now();
            std::hint::black_box(
                efficiencies(std::hint::black_box(x), 1.38, 0.09).expect("every sphere here is legal"),
            );
            one = one.min(start.elapsed().as_secs_f64());
            let start = Instant::now();
            std::hint::black_box(
                efficiencies_of_many(std::hint::black_box(&same)).expect("every sphere here is legal"),
            );
            eight = eight.min(start.elapsed().as_secs_f64() / 64.0);
        }
        println!("x = {x}: {:.2} us alone, {:.3} us side by side", one * 1e6, eight * 1e6);
    }
}
