//! Spectral bands: a detector's response, cut into the wavelength samples that a computation can afford.
//!
//! A filter is never represented by one wavelength (3.40 µm is a valley between two peaks of the alkanes), and what
//! leaks through it far from its centre is a sample of its own: it is blind to the vapour.
//!
//! - [`Response`]: curves of filter, detector, lens … and their product;
//! - [`BandSignal`], [`signal`], [`smooth_signal`]: black-body signals, exact;
//! - [`SignalTable`]: the same as a fast table, both ways;
//! - [`Band::sample`]: equal stretches; [`Band::automatic`]: the fewest samples for a fuel.

mod choose;
mod columns;
mod droplets;
mod equal;
mod exchange;
mod grid;
mod response;
mod signal;
mod table;
#[cfg(test)]
mod tests_of_choice;

pub use choose::Chosen;
pub use columns::Absorbers;
pub use response::Response;
pub use signal::{BandSignal, COLDEST_K, signal, smooth_signal};
pub use table::SignalTable;

use super::planck::{d_ln_photon_radiance_dt, inverse_photon_radiance, photon_radiance};
use super::table::TableError;

/// Range of temperatures over which signals of samples are judged, K.
const JUDGED_K: [f64; 2] = [350.0, 550.0];
/// Black body that weights a band where one number must do, K.
const SOURCE_K: f64 = 450.0;

/// Why there is no band.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BandError {
    /// The table of the response could not be read.
    #[error("response: {0}")]
    Table(#[from] TableError),
    /// The response is negative, not finite, or nowhere above 0.
    #[error("response: values must be finite, not negative, and somewhere above 0 ({0})")]
    Response(String),
    /// No samples were asked for.
    #[error("a band needs at least one sample")]
    Samples,
    /// An error that cannot be aimed at.
    #[error("the error of emissivities to aim at is {0}: it must be above 0")]
    Target(f64),
    /// Nothing to judge samples by.
    #[error("response: no black body of {low:.0} to {high:.0} K shines below its longest wavelength, {0} um", low = JUDGED_K[0], high = JUDGED_K[1])]
    Dark(f64),
    /// A table of signals over these temperatures cannot be made.
    #[error("table of signals over temperatures {0}")]
    Range(String),
}

/// Wavelength samples with weights: the signal of a radiance L(λ) is Σ wᵢ L(λᵢ).
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Wavelengths in µm; in band ascending, then the leak.
    pub wavelengths_um: Vec<f64>,
    /// Response × Δλ in µm, positive.
    pub weights: Vec<f64>,
    /// Index of the first sample that stands for the leak, if there is one.
    pub leak_from: Option<usize>,
}

impl Band {
    /// One wavelength in µm with response 1 over 1 µm: signals are spectral radiances per µm.
    pub fn monochromatic(wavelength_um: f64) -> Self {
        Self { wavelengths_um: vec![wavelength_um], weights: vec![1.0], leak_from: None }
    }

    /// Number of samples, leak included.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there is no sample at all.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// Black-body signal Σ w L(λ, T): photons s⁻¹ m⁻² sr⁻¹, times the unit of the response.
    pub fn signal(&self, temperature_k: f64) -> f64 {
        self.samples().map(|(um, weight)| weight * photon_radiance(um, temperature_k)).sum()
    }

    /// ∂/∂T of [`Band::signal`].
    pub fn d_signal_dt(&self, temperature_k: f64) -> f64 {
        self.samples()
            .map(|(um, weight)| {
                let radiance = weight * photon_radiance(um, temperature_k);
                if radiance > 0.0 { radiance * d_ln_photon_radiance_dt(um, temperature_k) } else { 0.0 }
            })
            .sum()
    }

    /// The temperature in K whose [`Band::signal`] is `signal`; `None` unless that is positive, finite and in reach.
    ///
    /// Newton's method on ln S against 1/T, which is nearly straight; relative error of T below 1e-14.
    pub fn inverse(&self, signal: f64) -> Option<f64> {
        let weight: f64 = self.weights.iter().sum();
        let mean = self.samples().map(|(um, weight)| um * weight).sum::<f64>() / weight;
        let mut inverse_t = 1.0 / inverse_photon_radiance(mean, signal / weight)?;
        let wanted = signal.ln();
        // Four steps are usual; the curve is convex in 1/T, so Newton cannot cycle.
        for _ in 0..60 {
            let t = 1.0 / inverse_t;
            let (value, slope) = (self.signal(t), self.d_signal_dt(t));
            if !(value > 0.0 && slope > 0.0 && t > 0.0) {
                return None;
            }
            // d ln S / d(1/T) = −T² S'/S.
            let step = (wanted - value.ln()) / (-t * t * slope / value);
            // At most a factor of two at a time.
            inverse_t = (inverse_t + step).clamp(0.5 * inverse_t, 2.0 * inverse_t);
            if step.abs() <= 2e-15 * inverse_t {
                break;
            }
        }
        Some(1.0 / inverse_t).filter(|t| t.is_finite())
    }

    /// Largest relative error of black-body signals of 350 to 550 K against a 1 nm quadrature of the response
    /// (of the in-band part when this band has no leak sample).
    pub fn reference_error(&self, response: &Response) -> f64 {
        if self.leak_from.is_some() {
            self.signal_error(&response.fine_whole())
        } else {
            let [low, high] = response.in_band_um();
            self.signal_error(&response.fine(low, high))
        }
    }

    /// The same against given points.
    fn signal_error(&self, points: &[(f64, f64)]) -> f64 {
        judged_k().map(|t| (self.signal(t) / planck_signal(points, t) - 1.0).abs()).fold(0.0, f64::max)
    }

    /// The samples as (wavelength in µm, weight).
    pub fn samples(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.wavelengths_um.iter().copied().zip(self.weights.iter().copied())
    }
}

fn planck_signal(points: &[(f64, f64)], temperature_k: f64) -> f64 {
    points.iter().map(|&(um, weight)| weight * photon_radiance(um, temperature_k)).sum()
}

/// Temperatures at which errors are judged.
fn judged_k() -> impl Iterator<Item = f64> {
    (0..=8).map(|i| JUDGED_K[0] + (JUDGED_K[1] - JUDGED_K[0]) * f64::from(i) / 8.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn open_band() -> Response {
        Response::shipped(&["QE_InSb_model", "lens_transmission_model"]).unwrap()
    }

    #[test]
    fn signals_of_the_samples_are_those_of_the_response() {
        let filtered = Response::filtered_insb().unwrap();
        for samples in [4, 8, 16, 32] {
            let band = Band::sample(&filtered, samples, true).unwrap();
            let error = band.reference_error(&filtered);
            println!("filter, {samples} samples and leak: {error:e}");
            // Second order in the stretch: (Δ²/24) (ln L)″ ~ (0.18/n)²/24 · 20. The one leak sample: its variance of
            // hc/λk is (400 K)², so (1/350 − 1/370)(1/350 − 1/530)/2 of that, 1.2 %, of a share of 1.2 % at 350 K.
            assert!(error < 0.03 / (samples * samples) as f64 + 1.6e-4, "{samples}: {error:e}");
        }
        let error = Band::sample(&open_band(), 16, true).unwrap().reference_error(&open_band());
        println!("open band, 16 samples: {error:e}");
        assert!(error < 5e-3);
    }

    #[test]
    fn the_leak_is_the_share_that_was_measured() {
        // optics.md, section 4: 0.67 / 0.44 / 0.32 % of the filtered signal at 373 / 449 / 533 K come from outside
        // 3.2-3.6 um (MCT); our band is narrower than that by 0.2 um of floor, 1e-4 · 0.2/0.12/0.8, so a little
        // more is leak.
        let columns = ["QE_MCT_MWIR_model", "filter_3.40_fwhm0.12", "lens_transmission_model"];
        let filtered = Response::shipped(&columns).unwrap();
        let band = Band::sample(&filtered, 16, true).unwrap();
        let from = band.leak_from.unwrap();
        assert_eq!(from, 16);
        for (t, share) in [(373.0, 0.0067), (449.0, 0.0044), (533.0, 0.0032)] {
            let leak = band.weights[from] * photon_radiance(band.wavelengths_um[from], t) / band.signal(t);
            println!("{t} K: {leak}, {share}");
            assert!(leak > share - 1e-4 && leak < share + 5e-4, "{t}: {leak}");
        }
        assert_eq!(Band::sample(&filtered, 16, false).unwrap().leak_from, None);
    }

    #[test]
    fn a_single_wavelength_is_planck_itself() {
        let band = Band::monochromatic(3.4);
        assert_eq!(band.signal(450.0).to_bits(), photon_radiance(3.4, 450.0).to_bits());
        assert!((band.inverse(photon_radiance(3.4, 450.0)).unwrap() / 450.0 - 1.0).abs() < 1e-14);
        assert_eq!(band.len(), 1);
        assert!(!band.is_empty());
    }

    #[test]
    fn signals_without_a_temperature_have_none() {
        let band = Band::sample(&open_band(), 4, false).unwrap();
        for signal in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(band.inverse(signal), None);
        }
    }

    #[test]
    fn a_band_needs_samples_and_a_response_without_an_outside_has_no_leak() {
        let flat = Response::from_csv("wavelength_um,response\n3,1\n4,1\n").unwrap();
        assert_eq!(Band::sample(&flat, 0, true), Err(BandError::Samples));
        assert_eq!(Band::sample(&flat, 3, true).unwrap().leak_from, None);
    }

    proptest! {
        #[test]
        fn a_signal_gives_its_temperature_back(t in 30.0f64..5000.0, samples in 1usize..20) {
            let band = Band::sample(&open_band(), samples, true).unwrap();
            let back = band.inverse(band.signal(t)).unwrap();
            // Rounding of the signal is (6 + 3x) ulp with dT/T = dS/S / x.
            prop_assert!((back / t - 1.0).abs() < 2e-14, "{} {}", t, back);
        }
    }
}
