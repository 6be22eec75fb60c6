//! Standard deviation of the temperature that a plan will have: before it runs, and of every further cycle while it
//! runs.
//!
//! For known variances v_k of a shot, var(S) = [1/W + (S − xm)²/Sxx]/(γ_near ε)² with W = Σ n_k/v_k and so on; the
//! variance law gives v at any plate temperature, so a candidate level is judged without a shot of it. Bad luck of a
//! small sample is not foreseen: it is what intervals are for.

use super::accumulate::Sums;
use super::calibration::SakumaHattori;
use super::line;
use super::map::{FitInputs, Prospect, prospects};

/// A spray as one expects it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// DIT emissivity, 0 … 1 exclusive.
    pub emissivity: f64,
    /// Effective temperature, in K.
    pub temperature_k: f64,
    /// Standard deviation of ln(optical depth) from shot to shot.
    pub sigma_ln_depth: f64,
    /// Standard deviation of the temperature from shot to shot, in K.
    pub sigma_k: f64,
    /// Correlation of the two.
    pub correlation: f64,
}

/// Some cycles at one plate temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visit {
    /// Plate temperature, in K.
    pub plate_k: f64,
    /// Cycles.
    pub cycles: f64,
}

/// σ(T) in K of a plan on a spray that is only expected. NaN when the visits define no line.
///
/// `inputs` gives windows, plate, curve and camera (its levels are not read), `blanks` the blanks of a cycle.
pub fn sigma_of_plan(spray: &Expected, visits: &[Visit], inputs: &FitInputs<'_>, blanks: f64) -> f64 {
    let Expected { emissivity, temperature_k, sigma_ln_depth, sigma_k, correlation } = *spray;
    let curve = &inputs.curve;
    let crossing = curve.value(temperature_k) / inputs.emissivity_plate - inputs.far_window_counts;
    // Small changes: dε = (1 − ε) τ d ln τ, dS = I'(T)/ε_B dT.
    let depth = -libm::log1p(-emissivity);
    let of_emissivity = (1.0 - emissivity) * depth * sigma_ln_depth;
    let of_crossing = curve.derivative(temperature_k) / inputs.emissivity_plate * sigma_k;
    let variance = |x: f64| {
        let d = crossing - x;
        let shot = d * d * of_emissivity * of_emissivity
            + 2.0 * d * emissivity * correlation * of_emissivity * of_crossing
            + emissivity * emissivity * of_crossing * of_crossing;
        let lit = inputs.gamma_near * x + inputs.camera.zero_counts;
        let spray = lit + inputs.gamma_near * emissivity * d;
        inputs.gamma_near * inputs.gamma_near * shot + inputs.camera.variance(spray, lit, blanks)
    };
    let x: Vec<f64> = visits.iter().map(|visit| inputs.gamma_far * curve.value(visit.plate_k)).collect();
    let weights: Vec<f64> = visits.iter().zip(&x).map(|(visit, &x)| visit.cycles / variance(x)).collect();
    let to_kelvin = kelvin_per_count(curve, inputs.emissivity_plate, temperature_k);
    sigma_of_crossing(&x, &weights, crossing, inputs.gamma_near * emissivity) * to_kelvin
}

/// σ(S) of a line of known variances with crossing S and slope −`slope`.
fn sigma_of_crossing(x: &[f64], weights: &[f64], crossing: f64, slope: f64) -> f64 {
    let y: Vec<f64> = x.iter().map(|x| slope * (crossing - x)).collect();
    match line::weighted(x, &y, weights) {
        Some(line) => {
            let d = crossing - line.mean_x;
            (1.0 / line.weight + d * d / line.spread).sqrt() / slope.abs()
        }
        None => f64::NAN,
    }
}

fn kelvin_per_count(curve: &SakumaHattori, emissivity_plate: f64, temperature_k: f64) -> f64 {
    emissivity_plate / curve.derivative(temperature_k)
}

/// What a running campaign knows of its pixels: enough to say what further cycles would bring.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecast {
    prospects: Vec<Prospect>,
    gamma_far: f64,
    emissivity_plate: f64,
    curve: SakumaHattori,
}

impl Forecast {
    /// From the sums so far, over at most `pixels_max` pixels of an emissivity above `emissivity_min`, evenly taken.
    pub fn of(sums: &Sums, inputs: &FitInputs<'_>, emissivity_min: f64, pixels_max: usize) -> Self {
        Self {
            prospects: prospects(sums, inputs, emissivity_min, pixels_max),
            gamma_far: inputs.gamma_far,
            emissivity_plate: inputs.emissivity_plate,
            curve: inputs.curve,
        }
    }

    /// Pixels that it rests on.
    pub fn pixels(&self) -> usize {
        self.prospects.len()
    }

    /// σ(T) in K of every pixel after `further` visits; none: as it stands now.
    pub fn sigmas_k(&self, further: &[Visit]) -> Vec<f64> {
        let added: Vec<f64> = further.iter().map(|v| self.gamma_far * self.curve.value(v.plate_k)).collect();
        self.prospects
            .iter()
            .map(|pixel| {
                let (mut x, mut weights) = (pixel.x.clone(), pixel.weights.clone());
                for (&at, visit) in added.iter().zip(further) {
                    let d = pixel.crossing - at;
                    x.push(at);
                    weights.push(visit.cycles / (pixel.variance_at_crossing + pixel.curvature * d * d));
                }
                sigma_of_crossing(&x, &weights, pixel.crossing, pixel.slope)
                    * kelvin_per_count(&self.curve, self.emissivity_plate, pixel.temperature_k)
            })
            .collect()
    }

    /// The quantile `part` (0 … 1) of σ(T) in K over the pixels after `further` visits; NaN without pixels.
    pub fn quantile_k(&self, further: &[Visit], part: f64) -> f64 {
        let mut sigmas = self.sigmas_k(further);
        sigmas.retain(|sigma| sigma.is_finite());
        sigmas.sort_unstable_by(f64::total_cmp);
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a place among pixels"
        )]
        let place = (part.clamp(0.0, 1.0) * sigmas.len().saturating_sub(1) as f64).round() as usize;
        sigmas.get(place).copied().unwrap_or(f64::NAN)
    }
}
