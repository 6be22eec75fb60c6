//! Time and error of Planck's law, band integrals, signal tables and the choice of samples.
//!
//! `cargo bench -p ditd-sim --bench light`: prints nanoseconds of one evaluation (the least of several rounds) and the
//! error beside it.

#![expect(clippy::print_stdout, reason = "a bench prints its figures")]
#![expect(clippy::disallowed_methods, reason = "wall time is what is measured")]

use ditd_sim::light::band::{Absorbers, Band, BandSignal, COLDEST_K, Response, SignalTable};
use ditd_sim::light::fuel::{Fuel, NAMES};
use ditd_sim::light::planck::{
    inverse_photon_exitance_band, inverse_photon_radiance, photon_exitance_band, photon_radiance,
};
use std::hint::black_box;
use std::time::Instant;

/// Temperatures of an evaluation each, K.
fn temperatures() -> Vec<f64> {
    (0..1000).map(|i| 300.0 + 0.3 * f64::from(i)).collect()
}

/// Nanoseconds of one evaluation: the least mean of seven rounds.
fn nanoseconds(inputs: &[f64], evaluate: impl Fn(f64) -> f64) -> f64 {
    let round = || {
        let start = Instant::now();
        for &input in inputs {
            black_box(evaluate(black_box(input)));
        }
        start.elapsed().as_secs_f64() * 1e9 / inputs.len() as f64
    };
    (0..7).map(|_| round()).fold(f64::INFINITY, f64::min)
}

fn line(what: &str, nanoseconds: f64, error: &str) {
    println!("{what:64} {nanoseconds:12.1} ns   {error}");
}

fn main() {
    let kelvins = temperatures();
    line("photon radiance at one wavelength", nanoseconds(&kelvins, |t| photon_radiance(3.4, t)), "8e-16");
    let radiances: Vec<f64> = kelvins.iter().map(|&t| photon_radiance(3.4, t)).collect();
    let back = |l| inverse_photon_radiance(3.4, l).unwrap_or(f64::NAN);
    line("its temperature", nanoseconds(&radiances, back), "7e-16");
    line("exitance of 3 to 5 um", nanoseconds(&kelvins, |t| photon_exitance_band(3.0, 5.0, t)), "1.4e-15");
    let exitances: Vec<f64> = kelvins.iter().map(|&t| photon_exitance_band(3.0, 5.0, t)).collect();
    let back = |m| inverse_photon_exitance_band(3.0, 5.0, m).unwrap_or(f64::NAN);
    line("its temperature", nanoseconds(&exitances, back), "1.4e-15");

    for (name, columns) in [
        ("filter 0.12 um", &["QE_InSb_model", "filter_3.40_fwhm0.12", "lens_transmission_model"][..]),
        ("open band", &["QE_InSb_model", "lens_transmission_model"]),
    ] {
        let response = Response::shipped(columns).expect("the shipped table is read by a test");
        tables(name, &response, &kelvins);
        choices(name, &response);
    }
}

/// The integral over a response, the sum over sixteen samples, and the table, both ways.
fn tables(name: &str, response: &Response, kelvins: &[f64]) {
    let exact = BandSignal::new(response, COLDEST_K);
    let points = exact.points().len();
    let few = &kelvins[..100];
    line(&format!("{name}: integral, {points} nodes"), nanoseconds(few, |t| exact.signal(t)), "3e-14");
    let band = Band::sample(response, 15, true).expect("15 is above 0");
    let worst = |signal: &dyn Fn(f64) -> f64| {
        kelvins.iter().map(|&t| (signal(t) / exact.signal(t) - 1.0).abs()).fold(0.0, f64::max)
    };
    let error = worst(&|t| band.signal(t));
    let sum = nanoseconds(kelvins, |t| band.signal(t));
    line(&format!("{name}: sum over {} samples", band.len()), sum, &format!("{error:.0e}"));
    for relative in [1e-9, 1e-12] {
        let start = Instant::now();
        let table = SignalTable::of_response(&exact, [280.0, 700.0], relative).expect("an ordinary range");
        let built = start.elapsed().as_secs_f64() * 1e3;
        let error = worst(&|t| table.signal(t).unwrap_or(f64::NAN));
        let forth = nanoseconds(kelvins, |t| table.signal(t).unwrap_or(f64::NAN));
        let text = format!("{name}: table of {} pieces, made in {built:.1} ms", table.pieces());
        line(&text, forth, &format!("{error:.0e}, states {:.0e}", table.relative_error()));
        let signals: Vec<f64> = kelvins.iter().map(|&t| exact.signal(t)).collect();
        let back = |s: f64| table.temperature(s).unwrap_or(f64::NAN);
        let error = kelvins.iter().zip(&signals).map(|(t, &s)| (back(s) / t - 1.0).abs()).fold(0.0, f64::max);
        line(&format!("{name}: its temperature"), nanoseconds(&signals, back), &format!("{error:.0e}"));
    }
}

/// Samples and time of the automatic choice.
fn choices(name: &str, response: &Response) {
    for fuel in NAMES {
        let fuel = Fuel::named(fuel).expect("shipped fuels are read by a test");
        for (absorbers, what) in [
            (Absorbers::BOTH, "liquid and vapour"),
            (Absorbers { liquid: false, vapour: true }, "vapour"),
            (Absorbers::NONE, "gray"),
        ] {
            let mut least = f64::INFINITY;
            let mut text = String::new();
            for _ in 0..3 {
                let start = Instant::now();
                let chosen =
                    Band::automatic_for(response, &fuel, absorbers, 1e-3).expect("a positive target");
                least = least.min(start.elapsed().as_secs_f64() * 1e9);
                let errors = format!("{:.1e}, signals {:.0e}", chosen.emissivity_error, chosen.signal_error);
                text = format!("{} samples, emissivity {errors}", chosen.band.len());
            }
            line(&format!("{name}: choice for {}, {what}", fuel.name()), least, &text);
        }
    }
}
