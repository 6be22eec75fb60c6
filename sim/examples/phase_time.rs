//! Time of sampling and making phase functions on this machine, with nodes and errors; minima.

#![expect(
    clippy::disallowed_methods,
    clippy::print_stdout,
    reason = "a stopwatch that prints, not a simulation"
)]

use ditd_sim::light::mie::Sphere;
use ditd_sim::light::phase::mie::{DISTRIBUTION_ERROR, of_spheres};
use ditd_sim::light::phase::{PhaseFunction, PhaseTable};
use std::f64::consts::{PI, TAU};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

/// Nanoseconds per call over quasi-random numbers.
fn time(mut call: impl FnMut(f64) -> f64) -> f64 {
    let calls = 1_000_000;
    let mut best = f64::INFINITY;
    for _ in 0..7 {
        let start = Instant::now();
        let mut u = 0.5;
        for _ in 0..calls {
            u += 0.618_033_988_749_895;
            if u >= 1.0 {
                u -= 1.0;
            }
            black_box(call(black_box(u)));
        }
        best = best.min(start.elapsed().as_secs_f64() / f64::from(calls));
    }
    1e9 * best
}

/// Spheres of a lognormal distribution with their numbers.
fn lognormal(median_um: f64, sigma: f64, um: f64, (n, k): (f64, f64), radii: u32) -> (Vec<Sphere>, Vec<f64>) {
    (0..radii)
        .map(|i| {
            let z = -3.0 + 8.5 * (f64::from(i) + 0.5) / f64::from(radii);
            let size_parameter = TAU * median_um * (sigma * z).exp() / um;
            (Sphere { size_parameter, n, k }, (-0.5 * z * z).exp())
        })
        .unzip()
}

fn main() {
    let theta: Vec<f64> = (0..=4000).map(|i| PI * f64::from(i) / 4000.0).collect();
    let peak = PhaseFunction::HenyeyGreenstein { asymmetry: 0.93 };
    let p: Vec<f64> = theta.iter().map(|t| peak.value(t.cos())).collect();
    let (table, _) = PhaseTable::new(&theta, &p).expect("a sound table");
    println!("table of 4001 angles: sampled with {} cells to {:.1e}", table.sampling().1, table.sampling().0);
    let spray = lognormal(5.0, 0.5, 3.4, (1.38, 0.09), 200);
    let mie = of_spheres(&spray.0, &spray.1, DISTRIBUTION_ERROR).expect("sound spheres").phase;
    for (name, phase) in [
        ("isotropic", PhaseFunction::Isotropic),
        ("rayleigh", PhaseFunction::Rayleigh),
        ("henyey-greenstein", peak),
        ("table", PhaseFunction::Table(Arc::new(table))),
        ("mie of a spray", mie),
    ] {
        let (sample, value) = (time(|u| phase.sample(u)), time(|u| phase.value(2.0 * u - 1.0)));
        println!("{name:18} sample {sample:5.1} ns, value {value:5.1} ns");
    }
    let one = |size_parameter| (vec![Sphere { size_parameter, n: 1.38, k: 0.05 }], vec![1.0]);
    for (name, (spheres, numbers)) in [
        ("200 radii, 5 um, sigma 0.5, at 3.4 um", spray),
        ("400 radii, 10 um, sigma 0.35, at 4 um, weak k", lognormal(10.0, 0.35, 4.0, (1.38, 8e-4), 400)),
        ("x = 18.5", one(18.5)),
        ("x = 92.4", one(92.4)),
        ("x = 300", one(300.0)),
        ("x = 1000", one(1000.0)),
    ] {
        for target in [1e-4, 1e-5, DISTRIBUTION_ERROR] {
            let start = Instant::now();
            let made = of_spheres(&spheres, &numbers, target).expect("sound spheres");
            let seconds = start.elapsed().as_secs_f64();
            println!(
                "{name}: {} nodes, error {:.1e}, mean cosine off by {:.0e}, {:.1} ms",
                made.nodes,
                made.error,
                (made.phase.mean_cosine() - made.asymmetry).abs(),
                1e3 * seconds
            );
        }
    }
}
