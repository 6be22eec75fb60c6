//! Spectral bands: a detector's response, cut into the wavelength samples that a computation can afford.
//!
//! A filter is never represented by one wavelength (3.40 µm is a valley between two peaks of the alkanes), and what
//! leaks through it far from its centre is a sample of its own: it is blind to the vapour.

use super::fuel::Fuel;
use super::planck::{d_ln_photon_radiance_dt, inverse_photon_radiance, photon_radiance};
use super::table::{Table, TableError, interpolate};
use std::f64::consts::PI;

/// Response below this fraction of its maximum is leak, not band.
const IN_BAND: f64 = 1e-3;
/// Plate temperatures at which the leak's sample is exact, K …
const LEAK_EXACT_K: [f64; 2] = [370.0, 530.0];
/// … and the range over which signals are judged, K.
const JUDGED_K: [f64; 2] = [350.0, 550.0];
/// Temperatures of the columns that band emissivities are judged by: black body behind, vapour, liquid.
const SOURCE_K: f64 = 450.0;
const VAPOUR_K: f64 = 450.0;
const LIQUID_K: f64 = 350.0;
/// Step of the reference quadrature, µm.
const REFERENCE_STEP_UM: f64 = 1e-3;
/// Largest number of samples that [`Band::automatic`] tries, and the numbers of leak samples among them.
const SAMPLES_MAX: usize = 96;
const LEAK_SAMPLES: [usize; 4] = [1, 2, 4, 8];

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
}

/// Response of camera, filter and lens over wavelength: photo-electrons per photon, or any multiple of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    wavelength_um: Vec<f64>,
    response: Vec<f64>,
}

/// Wavelength samples with weights: the signal of a radiance L(λ) is Σ wᵢ L(λᵢ).
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Wavelengths in µm; in band ascending, then the leak.
    pub wavelengths_um: Vec<f64>,
    /// Response × Δλ in µm.
    pub weights: Vec<f64>,
    /// Index of the first sample that stands for the leak, if there is one.
    pub leak_from: Option<usize>,
}

/// A band that was chosen for a fuel, and how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// The band.
    pub band: Band,
    /// Largest error of the band emissivity of liquid and vapour columns, see [`Band::emissivity_error`].
    pub emissivity_error: f64,
    /// Largest relative error of black-body signals, see [`Band::reference_error`].
    pub signal_error: f64,
}

impl Response {
    /// From ascending wavelengths in µm and values; linear between, 0 outside.
    ///
    /// # Errors
    ///
    /// [`BandError`] unless wavelengths ascend above 0 and values are finite, not negative, not all 0.
    pub fn new(wavelength_um: Vec<f64>, response: Vec<f64>) -> Result<Self, BandError> {
        let bad = |what: String| Err(BandError::Response(what));
        if wavelength_um.len() != response.len() || wavelength_um.len() < 2 {
            return bad(format!("{} wavelengths, {} values", wavelength_um.len(), response.len()));
        }
        if let Some(pair) = wavelength_um.windows(2).find(|pair| !(pair[0] > 0.0 && pair[1] > pair[0])) {
            return bad(format!("wavelengths {} and {} um do not ascend", pair[0], pair[1]));
        }
        if let Some(value) = response.iter().find(|r| !(**r >= 0.0 && r.is_finite())) {
            return bad(format!("{value}"));
        }
        if response.iter().all(|&r| r == 0.0) {
            return bad("all are 0".to_owned());
        }
        Ok(Self { wavelength_um, response })
    }

    /// From a table with the columns wavelength_um and response.
    ///
    /// # Errors
    ///
    /// [`BandError`] as [`Response::new`], or when the table cannot be read.
    pub fn from_csv(text: &str) -> Result<Self, BandError> {
        let table = Table::parse(text)?;
        Self::new(table.ascending("wavelength_um")?.to_vec(), table.column("response")?.to_vec())
    }

    /// Product of columns of the shipped table of assumed detectors, filters and lens (`sim/data/optics`,
    /// `detector_filter_model.csv`, 2.5–6 µm): for example `QE_InSb_model`, `filter_3.40_fwhm0.12`,
    /// `lens_transmission_model`. Placeholders, not measurements.
    ///
    /// # Errors
    ///
    /// [`BandError::Table`] naming the columns there are.
    pub fn shipped(columns: &[&str]) -> Result<Self, BandError> {
        let table = Table::parse(include_str!("../../data/optics/detector_filter_model.csv"))?;
        let wavelength_um = table.ascending("wavelength_um")?.to_vec();
        let mut response = vec![1.0; wavelength_um.len()];
        for name in columns {
            for (product, factor) in response.iter_mut().zip(table.column(name)?) {
                *product *= factor;
            }
        }
        Self::new(wavelength_um, response)
    }

    /// The shipped InSb camera with lens and the 3.40 µm filter of 0.12 µm width (all assumed).
    ///
    /// # Errors
    ///
    /// None in practice: the table is shipped and read by a test.
    pub fn filtered_insb() -> Result<Self, BandError> {
        Self::shipped(&["QE_InSb_model", "filter_3.40_fwhm0.12", "lens_transmission_model"])
    }

    /// Value at a wavelength in µm: linear, 0 outside the table.
    pub fn at(&self, wavelength_um: f64) -> f64 {
        let [from, to] = self.range_um();
        if (from..=to).contains(&wavelength_um) {
            interpolate(&self.wavelength_um, &self.response, wavelength_um)
        } else {
            0.0
        }
    }

    /// First and last wavelength of the table, µm.
    pub fn range_um(&self) -> [f64; 2] {
        [self.wavelength_um[0], self.wavelength_um[self.wavelength_um.len() - 1]]
    }

    /// The connected stretch about the maximum where the response is at least a thousandth of it, µm.
    pub fn in_band_um(&self) -> [f64; 2] {
        let top = self
            .response
            .iter()
            .enumerate()
            .fold(0, |top, (i, &r)| if r > self.response[top] { i } else { top });
        let limit = IN_BAND * self.response[top];
        let um = &self.wavelength_um;
        // The end of the stretch on the straight line between the last node inside and the first outside.
        let crossing = |inside: usize, outside: usize| {
            let (a, b) = (self.response[inside], self.response[outside]);
            um[inside] + (um[outside] - um[inside]) * ((a - limit) / (a - b)).clamp(0.0, 1.0)
        };
        let below = (0..top).rev().find(|&i| self.response[i] < limit);
        let above = (top + 1..um.len()).find(|&i| self.response[i] < limit);
        [below.map_or(um[0], |i| crossing(i + 1, i)), above.map_or(um[um.len() - 1], |i| crossing(i - 1, i))]
    }

    /// ∫ response · f dλ over [from, to] with steps of 1 nm at most, as (λ, response Δλ) pairs: midpoint rule on
    /// pieces that end at the nodes, so that the straight pieces of the response integrate exactly.
    fn quadrature(&self, from: f64, to: f64) -> Vec<(f64, f64)> {
        let mut points = Vec::new();
        let (mut low, mut node) = (from, self.wavelength_um.partition_point(|&um| um <= from));
        while low < to {
            let high = self.wavelength_um.get(node).copied().unwrap_or(to).min(to);
            let pieces = ((high - low) / REFERENCE_STEP_UM).ceil().max(1.0);
            let step = (high - low) / pieces;
            let mut piece = 0.0;
            while piece < pieces {
                let um = low + (piece + 0.5) * step;
                points.push((um, self.at(um) * step));
                piece += 1.0;
            }
            low = high;
            node += 1;
        }
        points
    }

    /// Quadrature over the whole table.
    fn whole(&self) -> Vec<(f64, f64)> {
        let [from, to] = self.range_um();
        self.quadrature(from, to)
    }

    /// Quadrature of what is outside the band.
    fn outside(&self) -> Vec<(f64, f64)> {
        let ([from, to], [low, high]) = (self.range_um(), self.in_band_um());
        let mut points = self.quadrature(from, low);
        points.extend(self.quadrature(high, to));
        points
    }
}

fn planck_signal(points: &[(f64, f64)], temperature_k: f64) -> f64 {
    points.iter().map(|&(um, weight)| weight * photon_radiance(um, temperature_k)).sum()
}

/// Temperatures at which errors are judged.
fn judged_k() -> impl Iterator<Item = f64> {
    (0..=8).map(|i| JUDGED_K[0] + (JUDGED_K[1] - JUDGED_K[0]) * f64::from(i) / 8.0)
}

impl Band {
    /// One wavelength in µm with response 1 over 1 µm: signals are spectral radiances per µm.
    pub fn monochromatic(wavelength_um: f64) -> Self {
        Self { wavelengths_um: vec![wavelength_um], weights: vec![1.0], leak_from: None }
    }

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

    fn in_band(response: &Response, samples: usize) -> Result<Self, BandError> {
        if samples == 0 {
            return Err(BandError::Samples);
        }
        let [low, high] = response.in_band_um();
        let edge = |i: usize| low + (high - low) * (i as f64 / samples as f64);
        let mut band = Self { wavelengths_um: Vec::new(), weights: Vec::new(), leak_from: None };
        for i in 0..samples {
            let points = response.quadrature(edge(i), edge(i + 1));
            let weight: f64 = points.iter().map(|point| point.1).sum();
            if weight > 0.0 {
                let moment: f64 = points.iter().map(|(um, weight)| um * weight).sum();
                band.wavelengths_um.push(moment / weight);
                band.weights.push(weight);
            }
        }
        Ok(band)
    }

    fn with_leak(mut self, samples: &[(f64, f64)]) -> Self {
        if !samples.is_empty() {
            self.leak_from = Some(self.weights.len());
        }
        for &(um, weight) in samples {
            self.wavelengths_um.push(um);
            self.weights.push(weight);
        }
        self
    }

    /// The fewest samples whose band emissivity errs by less than `target` for columns of this fuel's liquid and
    /// vapour (absolute, typically 1e-3): equal stretches in band, and one to eight samples for the leak. At most
    /// 96, then the best there was, with the error it has.
    ///
    /// # Errors
    ///
    /// As [`Band::sample`].
    pub fn automatic(response: &Response, fuel: &Fuel, target: f64) -> Result<Chosen, BandError> {
        let columns = Columns::new(response, fuel);
        let leaks: Vec<Vec<(f64, f64)>> = LEAK_SAMPLES.iter().map(|&count| leak(response, count)).collect();
        let mut best: Option<(Self, f64)> = None;
        for total in 4..=SAMPLES_MAX {
            for leak in leaks.iter().filter(|leak| leak.len() < total) {
                let band = Self::in_band(response, total - leak.len())?.with_leak(leak);
                let error = columns.largest_error(&band, fuel);
                if best.as_ref().is_none_or(|(_, least)| error < *least) {
                    best = Some((band, error));
                }
            }
            if best.as_ref().is_some_and(|(_, least)| *least <= target) {
                break;
            }
        }
        let (band, emissivity_error) = best.ok_or(BandError::Samples)?;
        let signal_error = band.reference_error(response);
        Ok(Chosen { band, emissivity_error, signal_error })
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
        let points = if self.leak_from.is_some() {
            response.whole()
        } else {
            let [low, high] = response.in_band_um();
            response.quadrature(low, high)
        };
        judged_k().map(|t| (self.signal(t) / planck_signal(&points, t) - 1.0).abs()).fold(0.0, f64::max)
    }

    /// Largest absolute error of the band emissivity of columns of the fuel's vapour (450 K), of its liquid
    /// (350 K, absorption only) and of both together, thin to opaque, against a 1 nm quadrature; weighted with a
    /// black body of 450 K.
    pub fn emissivity_error(&self, response: &Response, fuel: &Fuel) -> f64 {
        Columns::new(response, fuel).largest_error(self, fuel)
    }

    fn samples(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.wavelengths_um.iter().copied().zip(self.weights.iter().copied())
    }
}

/// The leak in up to `count` stretches of equal signal at 450 K, each as one wavelength and weight with its
/// black-body signals at two temperatures.
fn leak(response: &Response, count: usize) -> Vec<(f64, f64)> {
    let points = response.outside();
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

/// Reference emissivities of columns of one fuel.
struct Columns {
    /// (moles of vapour per m², metres of liquid) and the band emissivity.
    columns: Vec<(f64, f64, f64)>,
}

impl Columns {
    fn new(response: &Response, fuel: &Fuel) -> Self {
        let [low, high] = response.in_band_um();
        let in_band = response.quadrature(low, high);
        let absorbers = absorbers(&in_band, fuel);
        let total: f64 = absorbers.iter().map(|a| a.source).sum();
        let vapour = absorbers.iter().map(|a| a.source * a.vapour_m2_mol).sum::<f64>() / total;
        let liquid = absorbers.iter().map(|a| a.source * a.liquid_per_m).sum::<f64>() / total;
        let whole = self::absorbers(&response.whole(), fuel);
        let mut columns = Vec::new();
        for tenths in 0..=14 {
            // Mean optical depth 0.03 to 20.
            let depth = 0.03 * 10f64.powf(0.2 * f64::from(tenths));
            for (v, l) in [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5)] {
                let moles = if vapour > 0.0 { v * depth / vapour } else { 0.0 };
                let metres = if liquid > 0.0 { l * depth / liquid } else { 0.0 };
                columns.push((moles, metres, emissivity(&whole, moles, metres)));
            }
        }
        Self { columns }
    }

    fn largest_error(&self, band: &Band, fuel: &Fuel) -> f64 {
        let points: Vec<(f64, f64)> = band.samples().collect();
        let absorbers = absorbers(&points, fuel);
        self.columns
            .iter()
            .map(|&(moles, metres, wanted)| (emissivity(&absorbers, moles, metres) - wanted).abs())
            .fold(0.0, f64::max)
    }
}

/// One wavelength of a column: what a black body of 450 K gives there, and what absorbs it.
struct Absorber {
    source: f64,
    vapour_m2_mol: f64,
    liquid_per_m: f64,
}

fn absorbers(points: &[(f64, f64)], fuel: &Fuel) -> Vec<Absorber> {
    points
        .iter()
        .map(|&(um, weight)| Absorber {
            source: weight * photon_radiance(um, SOURCE_K),
            vapour_m2_mol: fuel.vapour_cross_section_m2_mol(um, VAPOUR_K),
            liquid_per_m: 4.0 * PI * fuel.liquid_index(um, LIQUID_K).1 / (um * 1e-6),
        })
        .collect()
}

fn emissivity(absorbers: &[Absorber], moles_m2: f64, metres: f64) -> f64 {
    let (mut seen, mut total) = (0.0, 0.0);
    for Absorber { source, vapour_m2_mol, liquid_per_m } in absorbers {
        total += source;
        seen += source * -(-moles_m2 * vapour_m2_mol - metres * liquid_per_m).exp_m1();
    }
    seen / total
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
    fn some_fifteen_samples_hold_the_emissivity_of_every_fuel_to_a_thousandth() {
        let filtered = Response::filtered_insb().unwrap();
        for name in crate::light::fuel::NAMES {
            let fuel = Fuel::named(name).unwrap();
            let chosen = Band::automatic(&filtered, &fuel, 1e-3).unwrap();
            println!(
                "{name}: {} samples, {:e}, {:e}",
                chosen.band.len(),
                chosen.emissivity_error,
                chosen.signal_error
            );
            assert!(chosen.emissivity_error <= 1e-3, "{name}");
            assert!(chosen.band.len() <= 33, "{name}: {}", chosen.band.len());
            let again = chosen.band.emissivity_error(&filtered, &fuel);
            assert_eq!(again.to_bits(), chosen.emissivity_error.to_bits());
        }
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
    fn impossible_responses_are_refused() {
        for text in
            ["", "wavelength_um,response\n3,1\n", "wavelength_um,response\n3,0\n4,0\n", "a,b\n1,2\n2,3\n"]
        {
            assert!(Response::from_csv(text).is_err(), "{text}");
        }
        assert!(Response::from_csv("wavelength_um,response\n3,1\n4,-1\n").is_err());
        let flat = Response::from_csv("wavelength_um,response\n3,1\n4,1\n").unwrap();
        assert_eq!(flat.in_band_um().map(f64::to_bits), [3.0, 4.0].map(f64::to_bits));
        assert_eq!(Band::sample(&flat, 0, true), Err(BandError::Samples));
        // A response without an outside has no leak.
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
