//! Equal stretches of a band, each as one wavelength, and its leak: the sampling that needs to know no absorber.

use super::{Band, BandError, Response, SOURCE_K, planck_signal};
use crate::light::planck::photon_radiance;

/// Plate temperatures at which the leak's sample is exact, K.
const LEAK_EXACT_K: [f64; 2] = [370.0, 530.0];

impl Band {
    /// `samples` equal stretches of the band, each represented by its response-weighted mean wavelength and its
    /// integral of the response; with `with_leak` one more sample for all that is outside.
    ///
    /// The leak's wavelength and weight are chosen so that its black-body signal is exact at 370 and 530 K.
    ///
    /// # Errors
    ///
    /// [`BandError::Samples`] when `samples` is 0.
    pub fn sample(response: &Response, samples: usize, with_leak: bool) -> Result<Self, BandError> {
        let band = Self::in_band(response, samples)?;
        Ok(if with_leak { band.with_leak(&leak(response, 1)) } else { band })
    }

    pub(super) fn in_band(response: &Response, samples: usize) -> Result<Self, BandError> {
        if samples == 0 {
            return Err(BandError::Samples);
        }
        let [low, high] = response.in_band_um();
        let edge = |i: usize| low + (high - low) * (i as f64 / samples as f64);
        let mut band = Self { wavelengths_um: Vec::new(), weights: Vec::new(), leak_from: None };
        for i in 0..samples {
            let points = response.fine(edge(i), edge(i + 1));
            let weight: f64 = points.iter().map(|point| point.1).sum();
            if weight > 0.0 {
                let moment: f64 = points.iter().map(|(um, weight)| um * weight).sum();
                band.wavelengths_um.push(moment / weight);
                band.weights.push(weight);
            }
        }
        Ok(band)
    }

    pub(super) fn with_leak(mut self, samples: &[(f64, f64)]) -> Self {
        if !samples.is_empty() {
            self.leak_from = Some(self.weights.len());
        }
        for &(um, weight) in samples {
            self.wavelengths_um.push(um);
            self.weights.push(weight);
        }
        self
    }
}

/// The leak in up to `count` stretches of equal signal at 450 K, each as one wavelength and weight with its
/// black-body signals at two temperatures.
pub(super) fn leak(response: &Response, count: usize) -> Vec<(f64, f64)> {
    let points = response.fine_outside();
    let share = planck_signal(&points, SOURCE_K) / count as f64;
    let mut stretches = vec![Vec::new()];
    let mut gathered = 0.0;
    for point in points {
        if gathered >= share * stretches.len() as f64 && stretches.len() < count {
            stretches.push(Vec::new());
        }
        gathered += planck_signal(&[point], SOURCE_K);
        if let Some(stretch) = stretches.last_mut() {
            stretch.push(point);
        }
    }
    stretches.iter().filter_map(|stretch| representative(stretch, response.range_um())).collect()
}

/// One wavelength inside the range and its weight, with the black-body signals of `points` at two temperatures.
fn representative(points: &[(f64, f64)], range_um: [f64; 2]) -> Option<(f64, f64)> {
    let signals = LEAK_EXACT_K.map(|t| planck_signal(points, t));
    if signals[0] <= 0.0 {
        return None;
    }
    let wanted = (signals[1] / signals[0]).ln();
    let ratio = |um: f64| (photon_radiance(um, LEAK_EXACT_K[1]) / photon_radiance(um, LEAK_EXACT_K[0])).ln();
    // The ratio falls with the wavelength: bisection to the last bit.
    let [mut low, mut high] = range_um;
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if ratio(middle) > wanted { low = middle } else { high = middle }
    }
    let um = 0.5 * (low + high);
    Some((um, signals[0] / photon_radiance(um, LEAK_EXACT_K[0])))
}
