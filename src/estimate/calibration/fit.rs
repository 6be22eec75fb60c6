//! From points to the curve, with what is known of its band.

use super::band::Known;
use super::descent::{Parameters, b_asked_for, covariance, descend, gradient, start};
use super::prior;
use super::residual::{self, Residual};
use super::{CalibrationError, CalibrationPoint, Passband, Range, SakumaHattori};
use serde::{Deserialize, Serialize};

/// What is known of the counts without light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OffsetMode {
    /// They are this many and have been measured otherwise.
    Known(f64),
    /// They are fitted with the curve: needs a fourth point and doubles the error of T.
    Free,
}

/// A fitted curve with what is needed to judge it. Serialises as `calibration.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFit {
    /// The curve, counts above the offset.
    pub curve: SakumaHattori,
    /// Counts without light.
    pub offset_counts: f64,
    /// Covariance of (ln A, a in µm, b in µm K, offset in counts), from the points' sigmas. The last row is zero for
    /// a known offset.
    pub covariance: [[f64; 4]; 4],
    /// Σ ((counts − curve)/sigma)², before any residual; with a stated pass band also what its two parameters add.
    pub chi2: f64,
    /// Points, and two for a stated pass band, less parameters.
    pub dof: usize,
    /// What the curve leaves of the points, where χ² demands it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual: Option<Residual>,
    /// Coldest and hottest point.
    pub range: Range,
    /// counts − curve, in counts, in the order of the points.
    pub residuals: Vec<f64>,
    /// Iterations used.
    pub iterations: usize,
}

impl CalibrationFit {
    /// Counts above the offset at a temperature in K, the residual included. Zero where the curve is.
    pub fn counts(&self, temperature_k: f64) -> f64 {
        let equation = self.residual.as_ref().map_or(temperature_k, |residual| residual.undo(temperature_k));
        self.curve.value(equation)
    }

    /// Temperature in K that gives `counts` above the offset, the residual included. NaN for counts ≤ 0 or NaN.
    pub fn temperature(&self, counts: f64) -> f64 {
        let equation = self.curve.inverse(counts);
        self.residual.as_ref().map_or(equation, |residual| residual.apply(equation).0)
    }

    /// dI/dT at a temperature in K, in counts/K, the residual included.
    pub fn derivative(&self, temperature_k: f64) -> f64 {
        match &self.residual {
            None => self.curve.derivative(temperature_k),
            Some(residual) => {
                let equation = residual.undo(temperature_k);
                self.curve.derivative(equation) / residual.apply(equation).1
            }
        }
    }

    /// d(counts)/d(ln A, a in µm, b in µm K) at a temperature of the curve's equation, in K: what [`Self::variance_of`]
    /// adds up.
    pub fn gradient(&self, equation_k: f64) -> [f64; 3] {
        let [by_a, by_um, by_um_k, _] = gradient(&self.curve, equation_k);
        [by_a, by_um, by_um_k]
    }

    /// Variance, in counts², of a sum of the curve's counts at several temperatures, by the sum of their gradients.
    /// Scaled by χ² per degree of freedom where that is above one: the points then scatter more than their sigmas say.
    pub fn variance_of(&self, gradient: &[f64; 3]) -> f64 {
        let mut variance = 0.0;
        for (i, gi) in gradient.iter().enumerate() {
            for (j, gj) in gradient.iter().enumerate() {
                variance += gi * gj * self.covariance[i][j];
            }
        }
        variance.max(0.0) * self.excess()
    }

    /// χ² per degree of freedom, at least one.
    pub fn excess(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a number of points")]
        let freedom = self.dof as f64;
        if self.dof > 0 { (self.chi2 / freedom).max(1.0) } else { 1.0 }
    }

    /// Standard deviation, in counts, of the curve above its offset at `temperature_k`: common to all pixels.
    pub fn sigma_counts(&self, temperature_k: f64) -> f64 {
        let gradient = gradient(&self.curve, temperature_k);
        let mut variance = 0.0;
        for (i, gi) in gradient[..3].iter().enumerate() {
            for (j, gj) in gradient[..3].iter().enumerate() {
                variance += gi * gj * self.covariance[i][j];
            }
        }
        variance.max(0.0).sqrt()
    }
}

/// Fits the curve to 3 to 50 points by damped least squares (Levenberg–Marquardt) from start values of its own.
///
/// Noise-free points of the exact form come back to rounding: below 1e-6 K between the points. Where points have noise, b is
/// drawn to what the bands of cameras have, 0 to 290 µm K, by as much as the points do not know it; the covariance says
/// what is left.
///
/// # Errors
///
/// When points are fewer than parameters, not finite, or do not follow any rising curve.
pub fn fit_curve(
    points: &[CalibrationPoint],
    offset: OffsetMode,
) -> Result<CalibrationFit, CalibrationError> {
    fitted(points, offset, None)
}

/// As [`fit_curve`] with what the filter's data sheet says: it holds the exponent where few or noisy points do not, and
/// costs two points' worth of freedom where they do. Two different temperatures are enough.
///
/// # Errors
///
/// As [`fit_curve`].
pub fn fit_curve_in_band(
    points: &[CalibrationPoint],
    offset: OffsetMode,
    band: &Passband,
) -> Result<CalibrationFit, CalibrationError> {
    fitted(points, offset, Some(band.parameters()))
}

fn fitted(
    points: &[CalibrationPoint],
    offset: OffsetMode,
    known: Option<[Known; 2]>,
) -> Result<CalibrationFit, CalibrationError> {
    let parameters = if offset == OffsetMode::Free { 4 } else { 3 };
    let stated = if known.is_some() { 2 } else { 0 };
    super::check(points)?;
    check_number(points, (parameters - stated).max(2))?;
    let start = start(points, offset, known).ok_or(CalibrationError::NotABlackBody)?;
    let (best, iterations) = descend(points, start);
    if !best.is_black_body() {
        return Err(CalibrationError::NotABlackBody);
    }
    let dof = points.len() + stated - parameters;
    let (best, covariance) = match known {
        Some(_) => (best, covariance(points, &best)),
        None => in_any_band(points, best, dof),
    };
    let Parameters { curve, offset_counts, .. } = best;
    let residuals: Vec<f64> =
        points.iter().map(|p| p.counts - curve.value(p.temperature_k) - offset_counts).collect();
    let chi2 = best.chi2(points);
    let residual =
        residual::is_demanded(chi2, dof).then(|| Residual::of(points, &residuals, &curve, dof)).flatten();
    let fold = |pick: fn(f64, f64) -> f64| points.iter().map(|p| p.temperature_k).fold(f64::NAN, pick);
    Ok(CalibrationFit {
        curve,
        offset_counts,
        covariance,
        chi2,
        dof,
        residual,
        range: Range { low_k: fold(f64::min), high_k: fold(f64::max) },
        residuals,
        iterations,
    })
}

/// Refuses fewer different temperatures than parameters.
fn check_number(points: &[CalibrationPoint], needed: usize) -> Result<(), CalibrationError> {
    let mut temperatures: Vec<f64> = points.iter().map(|p| p.temperature_k).collect();
    temperatures.sort_by(f64::total_cmp);
    temperatures.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    if temperatures.len() < needed {
        return Err(CalibrationError::TooFewPoints { given: temperatures.len(), needed });
    }
    Ok(())
}

/// Rounds of [`in_any_band`]: the second one is at the answer of the first, where curves bend less.
const ROUNDS: usize = 3;

/// χ² is below this by chance once in twenty fits.
fn scatter_min(dof: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a number of points")]
    let half = 0.5 * dof as f64;
    // The lower end of the distribution: P(χ² < x) ≈ (x/2)^(dof/2)/Γ(dof/2 + 1).
    2.0 * libm::exp((libm::log(0.05) + libm::lgamma(half + 1.0)) / half)
}

/// Parameters and covariance with what any camera's band says of b (`prior`), for parameters that the points alone give.
///
/// Not where there are no more points than parameters, nor where χ² says that the equation does not describe the points: b then
/// stands for something else. Points that scatter less than any noise of their sigmas would are as good as they look: their
/// sigmas count for as much less.
fn in_any_band(points: &[CalibrationPoint], free: Parameters, dof: usize) -> (Parameters, [[f64; 4]; 4]) {
    let chi2 = free.chi2(points);
    let plain = covariance(points, &free);
    if dof == 0 || residual::is_demanded(chi2, dof) {
        return (free, plain);
    }
    let scatter = (chi2 / scatter_min(dof)).min(1.0);
    let mut best = (free, plain);
    let mut fitted = Known { value: free.curve.b_um_k, sigma: plain[2][2].sqrt() };
    for _ in 0..ROUNDS {
        let b = prior::b_of_any_band(Known { sigma: fitted.sigma * scatter.sqrt(), ..fitted });
        let pin = Known { value: b.value, sigma: PIN * fitted.sigma };
        let held = Parameters { known: Some([Known { value: 0.0, sigma: f64::INFINITY }, pin]), ..best.0 };
        let (held, _) = descend(points, held);
        if !held.is_black_body() {
            break;
        }
        let at = Parameters { known: None, ..held };
        let own = covariance(points, &at);
        // b and what follows from it: the covariance of the others at a given b, and b's own.
        let follows = own[2].map(|cell| cell / own[2][2]);
        let more = b.sigma * b.sigma / scatter - own[2][2];
        let with =
            std::array::from_fn(|i| std::array::from_fn(|j| own[i][j] + more * follows[i] * follows[j]));
        if !with.as_flattened().iter().all(|cell| cell.is_finite()) {
            break;
        }
        best = (at, with);
        // What the points say of b as seen from here.
        fitted = Known { value: b_asked_for(points, &at), sigma: own[2][2].sqrt() };
    }
    best
}

/// Standard deviation at which b is held, over that of the points: nothing pulls it off by more than a millionth.
const PIN: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn exact(temperatures: &[f64], offset: f64) -> Vec<CalibrationPoint> {
        temperatures
            .iter()
            .map(|&temperature_k| {
                let counts = TRUTH.value(temperature_k) + offset;
                CalibrationPoint { temperature_k, counts, sigma_counts: 0.15 + 0.001 * counts }
            })
            .collect()
    }

    fn worst(fit: &CalibrationFit, low: f64, high: f64) -> f64 {
        (0..=100)
            .map(|i| low + (high - low) * f64::from(i) / 100.0)
            .map(|t| (fit.curve.inverse(TRUTH.value(t)) - t).abs())
            .fold(0.0, f64::max)
    }

    /// Ten noise-free points of the exact form: well below the 1.2 mK that other filters leave.
    #[test]
    fn exact_points_come_back_exactly() {
        let temperatures: Vec<f64> = (0..10).map(|i| 340.0 + 30.0 * f64::from(i)).collect();
        for (offset, mode) in
            [(0.0, OffsetMode::Known(0.0)), (1500.0, OffsetMode::Known(1500.0)), (1500.0, OffsetMode::Free)]
        {
            let fit = fit_curve(&exact(&temperatures, offset), mode).unwrap();
            assert!(worst(&fit, 345.0, 600.0) < 1e-6, "{mode:?}: {}", worst(&fit, 345.0, 600.0));
            assert!((fit.offset_counts - offset).abs() < 1e-6);
            assert!(fit.iterations < 60, "{}", fit.iterations);
        }
    }

    #[test]
    fn few_and_cold_points_converge() {
        let few = fit_curve(&exact(&[373.0, 449.0, 533.0], 0.0), OffsetMode::Known(0.0)).unwrap();
        assert!(worst(&few, 373.0, 533.0) < 1e-6 && few.dof == 0);
        let shutter = exact(&[296.0, 373.0, 403.0, 433.0, 533.0], 1500.0);
        let cold = fit_curve(&shutter, OffsetMode::Free).unwrap();
        assert!(worst(&cold, 300.0, 533.0) < 1e-5, "{}", worst(&cold, 300.0, 533.0));
        let fifty: Vec<f64> = (0..50).map(|i| 290.0 + 7.0 * f64::from(i)).collect();
        let many = fit_curve(&exact(&fifty, 3.0), OffsetMode::Free).unwrap();
        assert!(worst(&many, 290.0, 630.0) < 1e-6);
    }

    #[test]
    fn unusable_points_are_refused() {
        let known = OffsetMode::Known(0.0);
        let two = exact(&[373.0, 533.0], 0.0);
        assert_eq!(fit_curve(&two, known), Err(CalibrationError::TooFewPoints { given: 2, needed: 3 }));
        let three = exact(&[373.0, 449.0, 533.0], 0.0);
        assert_eq!(
            fit_curve(&three, OffsetMode::Free),
            Err(CalibrationError::TooFewPoints { given: 3, needed: 4 })
        );
        let mut bad = three.clone();
        bad[1].sigma_counts = 0.0;
        assert_eq!(fit_curve(&bad, known), Err(CalibrationError::BadPoint { index: 1 }));
        let mut dark = three;
        dark.iter_mut().for_each(|p| p.counts = -5.0);
        assert_eq!(fit_curve(&dark, known), Err(CalibrationError::NotABlackBody));
    }

    /// The covariance predicts the scatter of refits: 400 noisy sets, each parameter's variance within 25 %
    /// (4 standard errors of a variance of 400 draws are 28 %).
    #[test]
    fn covariance_predicts_scatter() {
        let temperatures: Vec<f64> = (0..8).map(|i| 350.0 + 30.0 * f64::from(i)).collect();
        let clean = exact(&temperatures, 0.0);
        let expected = fit_curve(&clean, OffsetMode::Known(0.0)).unwrap();
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            #[expect(clippy::cast_precision_loss, reason = "53 bits")]
            let value = (state >> 11) as f64 / 9_007_199_254_740_992.0;
            value
        };
        let (mut sum, mut sum_squares) = (0.0, 0.0);
        for _ in 0..400 {
            let mut noisy = clean.clone();
            for p in &mut noisy {
                let normal: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                p.counts += normal * p.sigma_counts;
            }
            let fit = fit_curve(&noisy, OffsetMode::Known(0.0)).unwrap();
            let off = fit.curve.value(449.0) - TRUTH.value(449.0);
            sum += off;
            sum_squares += off * off;
        }
        let variance = sum_squares / 400.0 - (sum / 400.0) * (sum / 400.0);
        let predicted = expected.sigma_counts(449.0);
        assert!((variance / (predicted * predicted) - 1.0).abs() < 0.28, "{variance} {predicted}");
    }
}
