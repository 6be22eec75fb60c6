//! The choice of samples, judged by columns that it was not trained on.

use super::columns::{Absorbers, Column, Family, Spectrum};
use super::grid::training_grid;
use super::{Band, BandSignal, Response, planck_signal};
use crate::light::fuel::{Fuel, NAMES};
use crate::light::planck::photon_radiance;

const TARGET: f64 = 1e-3;
/// Largest median diameter of a stranger's droplets, µm. Larger ones cost the test minutes: Mie's ripple has to be
/// resolved, size by size.
const LARGEST_UM: f64 = 8.0;
const DETECTORS: [&str; 2] = ["QE_InSb_model", "QE_MCT_MWIR_model"];
const FILTERS: [&str; 3] = ["filter_3.40_fwhm0.06", "filter_3.40_fwhm0.12", "filter_3.40_fwhm0.24"];

/// SplitMix64: numbers in [0, 1).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn below(&mut self, count: usize) -> usize {
        (0..count).rev().find(|&i| self.unit() * (i as f64 + 1.0) < 1.0).unwrap_or(0)
    }
}

/// Vapour of 300–650 K, liquid of 280–450 K, droplets of 3 µm to the largest, one to three of them together, mean optical depth
/// 0.01–30, black bodies of 350–550 K; droplets by Mie's theory, which the choice does not know.
fn strangers<'a>(response: &Response, fuel: &'a Fuel, absorbers: Absorbers, largest_um: f64) -> Family<'a> {
    let mut random = Random(7);
    let mut spectra = Vec::new();
    let mut droplets = Vec::new();
    for kind in 0..4 {
        if absorbers.vapour {
            spectra.push(Spectrum::Vapour(random.between(300.0, 650.0)));
        }
        if absorbers.liquid {
            spectra.push(Spectrum::Liquid(random.between(280.0, 450.0)));
        }
        if absorbers.liquid && kind < 1 {
            let diameter_um = 3.0 * (largest_um / 3.0).powf(random.unit());
            let kelvin = random.between(280.0, 400.0);
            droplets.push((spectra.len(), spectra.len() + 1));
            spectra.push(Spectrum::MieAbsorption(diameter_um, kelvin));
            spectra.push(Spectrum::MieExtinction);
        }
    }
    let columns = (0..90)
        .map(|i| {
            let parts = 1 + random.below(3);
            let shares: Vec<f64> = (0..parts).map(|_| random.between(0.1, 1.0)).collect();
            let sum: f64 = shares.iter().sum();
            let parts = shares.iter().map(|share| (random.below(spectra.len()), share / sum)).collect();
            let depth = 0.01 * 3000f64.powf(random.unit());
            match droplets.first().filter(|_| i % 9 == 0) {
                Some(&pair) => Column { parts: vec![(pair.1, 1.0)], depth, scattered: Some(pair) },
                None => Column { parts, depth, scattered: None },
            }
        })
        .collect();
    let sources: Vec<f64> = (0..3).map(|_| random.between(350.0, 550.0)).collect();
    Family::new(&training_grid(response), fuel, spectra, columns, &sources)
}

/// Chooses, and checks what any choice must be. The largest error of strangers.
fn checked(response: &Response, fuel: &Fuel, absorbers: Absorbers, what: &str) -> (Band, f64) {
    let chosen = Band::automatic_for(response, fuel, absorbers, TARGET).unwrap();
    let band = chosen.band;
    let [low, high] = response.in_band_um();
    let from = band.leak_from.unwrap_or(band.len());
    assert!(band.weights.iter().all(|&w| w > 0.0 && w.is_finite()), "{what}: {band:?}");
    assert!(band.wavelengths_um[..from].windows(2).all(|pair| pair[0] < pair[1]), "{what}: {band:?}");
    for (place, um) in band.wavelengths_um.iter().enumerate() {
        assert!((low..=high).contains(um) == (place < from) && response.at(*um) > 0.0, "{what}: {um}");
    }
    assert!(chosen.emissivity_error <= TARGET, "{what}: {:e}", chosen.emissivity_error);
    let strangers = strangers(response, fuel, absorbers, LARGEST_UM);
    let error = strangers.largest_error(&band.wavelengths_um, &band.weights);
    let worst = strangers.worst(&band.wavelengths_um, &band.weights);
    assert!(error <= TARGET, "{what}: {} samples err by {error:e} in front of {worst}", band.len());
    // Against the exact integral, not the grid: the grid's midpoint rule errs by 1e-6 itself.
    let exact = BandSignal::new(response, 300.0);
    for t in [350.0, 437.0, 550.0] {
        let signal = (band.signal(t) / exact.signal(t) - 1.0).abs();
        assert!(signal <= 2e-5, "{what}, {t} K: {signal:e}");
    }
    println!(
        "{what}: {} samples, {} of them leak; errors: trained {:.1e}, strangers {error:.1e}, signals {:.0e}; worst {worst}",
        band.len(),
        band.len() - from,
        chosen.emissivity_error,
        chosen.signal_error
    );
    (band, error)
}

#[test]
fn every_fuel_behind_every_filter_is_right_to_a_thousandth() {
    for detector in DETECTORS {
        for filter in FILTERS.iter().map(Some).chain([None]) {
            let columns: Vec<&str> =
                [detector, "lens_transmission_model"].into_iter().chain(filter.copied()).collect();
            let response = Response::shipped(&columns).unwrap();
            // With the second detector the same fuels would say the same: two of them.
            let fuels = if detector == DETECTORS[0] { &NAMES[..] } else { &NAMES[..2] };
            for name in fuels {
                let fuel = Fuel::named(name).unwrap();
                let what = format!("{detector}, {}, {name}", filter.unwrap_or(&"open"));
                let (band, _) = checked(&response, &fuel, Absorbers::BOTH, &what);
                // Room for every fuel in the tracer's 64 groups.
                assert!(band.len() <= if filter.is_some() { 24 } else { 40 }, "{what}: {}", band.len());
            }
        }
    }
}

#[test]
fn fewer_absorbers_need_fewer_samples_and_none_a_handful() {
    let response = Response::filtered_insb().unwrap();
    let fuel = Fuel::named("n-heptane").unwrap();
    let (both, _) = checked(&response, &fuel, Absorbers::BOTH, "both");
    for (absorbers, what) in [
        (Absorbers { liquid: true, vapour: false }, "liquid"),
        (Absorbers { liquid: false, vapour: true }, "vapour"),
    ] {
        let (one, _) = checked(&response, &fuel, absorbers, what);
        assert!(one.len() <= both.len(), "{what}: {} of {}", one.len(), both.len());
    }
    let gray = Band::automatic_for(&response, &fuel, Absorbers::NONE, TARGET).unwrap();
    assert!(gray.band.len() <= 4 && gray.emissivity_error == 0.0, "{gray:?}");
    assert!(gray.signal_error <= 2e-5, "{gray:?}");
}

#[test]
fn where_nothing_changes_one_wavelength_is_enough() {
    let fuel = Fuel::named("n-heptane").unwrap();
    // A laser line, of 0.02 nm, and one that is 1e-9 um wide.
    for half in [1e-5, 5e-10] {
        let response = Response::new(vec![3.41 - half, 3.41, 3.41 + half], vec![0.0, 1.0, 0.0]).unwrap();
        let (band, _) = checked(&response, &fuel, Absorbers::BOTH, "line");
        assert_eq!(band.len(), 1);
        assert!((band.wavelengths_um[0] - 3.41).abs() <= half);
        assert!((band.weights[0] / half - 1.0).abs() < 1e-3);
    }
    // Where vapour does not absorb at all (its table ends at 3.7 um) the scene is gray whatever is asked.
    let far = Response::new(vec![4.4, 4.5, 4.6], vec![0.0, 1.0, 0.0]).unwrap();
    let vapour = Absorbers { liquid: false, vapour: true };
    assert!(Band::automatic_for(&far, &fuel, vapour, TARGET).unwrap().band.len() <= 3);
}

#[test]
fn any_shape_of_response_is_served() {
    let fuel = Fuel::named("ethanol").unwrap();
    let csv = |rows: &[(f64, f64)]| {
        let (um, value) = rows.iter().copied().unzip();
        Response::new(um, value).unwrap()
    };
    let two_bands =
        csv(&[(3.2, 0.0), (3.3, 0.8), (3.4, 0.0), (3.8, 0.0), (3.9, 0.7), (4.1, 0.9), (4.2, 0.0)]);
    // As a spectrometer writes it: half a nanometre, noise in the floor, zero stretches in between.
    let mut random = Random(3);
    let noisy: Vec<(f64, f64)> = (0..2400)
        .map(|i| {
            let um = 3.0 + 5e-4 * f64::from(i);
            let floor = if (i / 100) % 3 == 0 { 0.0 } else { 2e-4 * random.unit() };
            (um, 0.71 * (-((um - 3.46) / 0.07f64).powi(4)).exp() + floor)
        })
        .collect();
    let product = Response::product(&[
        csv(&[(3.0, 0.1), (3.3, 0.8), (3.6, 0.1)]),
        csv(&[(2.0, 0.5), (3.35, 0.9), (5.0, 0.2)]),
        Response::shipped(&["QE_InSb_model"]).unwrap(),
    ])
    .unwrap();
    for (what, response) in [
        ("two bands", two_bands),
        ("flat", csv(&[(3.0, 1.0), (3.7, 1.0)])),
        ("peak", csv(&[(3.0, 0.0), (3.4, 1.0), (3.41, 0.0)])),
        ("noisy", csv(&noisy)),
        ("product", product),
    ] {
        checked(&response, &fuel, Absorbers::BOTH, what);
    }
}

#[test]
fn the_choice_is_the_same_again_and_never_needs_more_than_equal_stretches() {
    let response = Response::shipped(&["QE_InSb_model", "filter_3.40_fwhm0.24"]).unwrap();
    for name in ["toluene", "isooctane"] {
        let fuel = Fuel::named(name).unwrap();
        let chosen = Band::automatic(&response, &fuel, TARGET).unwrap();
        assert_eq!(chosen, Band::automatic(&response, &fuel, TARGET).unwrap());
        // Computed another way round.
        let again = chosen.band.emissivity_error(&response, &fuel);
        assert!((again - chosen.emissivity_error).abs() < 1e-10, "{again:e} {:e}", chosen.emissivity_error);
        for samples in 1..chosen.band.len() - 1 {
            let equal = Band::sample(&response, samples, true).unwrap();
            let error = equal.emissivity_error(&response, &fuel);
            assert!(error > chosen.emissivity_error, "{name}: {samples} equal stretches err by {error:e}");
        }
    }
    let ultraviolet = Response::new(vec![0.01, 0.02], vec![1.0, 1.0]).unwrap();
    let dark = Band::automatic(&ultraviolet, &Fuel::named("toluene").unwrap(), TARGET).unwrap_err();
    assert!(dark.to_string().contains("0.02 um"), "{dark}");
    for target in [0.0, -1.0, f64::NAN] {
        assert!(Band::automatic(&response, &Fuel::named("toluene").unwrap(), target).is_err());
    }
}

#[test]
fn a_stranger_is_what_beer_and_lambert_say() {
    // One column by hand: vapour of 400 K of mean optical depth 2 before a black body of 500 K.
    let response = Response::filtered_insb().unwrap();
    let fuel = Fuel::named("n-heptane").unwrap();
    let fine = response.fine_whole();
    let column = Column { parts: vec![(0, 1.0)], depth: 2.0, scattered: None };
    let family = Family::new(&fine, &fuel, vec![Spectrum::Vapour(400.0)], vec![column], &[500.0]);
    let sigma = |um: f64| fuel.vapour_cross_section_m2_mol(um, 400.0);
    let mean = fine.iter().map(|&(um, w)| w * photon_radiance(um, 450.0) * sigma(um)).sum::<f64>()
        / planck_signal(&fine, 450.0);
    let taken =
        fine.iter().map(|&(um, w)| w * photon_radiance(um, 500.0) * -(-2.0 * sigma(um) / mean).exp_m1());
    let wanted = taken.sum::<f64>() / planck_signal(&fine, 500.0);
    assert!((family.wanted[0] - wanted).abs() < 1e-13, "{} {wanted}", family.wanted[0]);
}
