//! From points to the curve: damped least squares from start values of its own.

use super::band::Known;
use super::least_squares::{column_norms, damped_step, dot, solve, upper_inverse};
use super::prior;
use super::residual::{self, Residual};
use super::{C2_UM_K, CalibrationError, CalibrationPoint, Passband, Range, SakumaHattori};
use crate::estimate::line;
use serde::{Deserialize, Serialize};

/// Iterations of the fit. Ordinary fits need 5 to 15; with this many the damping has tried everything.
const ITERATIONS_MAX: usize = 200;

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
/// Noise-free points of the exact form come back to rounding: below 1e-6 K between the points.
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
        let (rows, residuals) = linearised(points, &at);
        let step = damped_step(&rows, &residuals, 0.0);
        let w = at.curve.a_um * at.pivot_k + at.curve.b_um_k;
        let value = at.curve.b_um_k + w * step[1] - at.pivot_k * step[2];
        fitted = Known { value, sigma: own[2][2].sqrt() };
    }
    best
}

/// Standard deviation at which b is held, over that of the points: nothing pulls it off by more than a millionth.
const PIN: f64 = 1e-3;

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

#[derive(Debug, Clone, Copy)]
struct Parameters {
    curve: SakumaHattori,
    offset_counts: f64,
    free_offset: bool,
    /// Temperature at which the fit's own variables are taken: ln I and a T + b there, and a.
    pivot_k: f64,
    /// a and b as they are known before the points.
    known: Option<[Known; 2]>,
}

impl Parameters {
    fn chi2(&self, points: &[CalibrationPoint]) -> f64 {
        points
            .iter()
            .map(|p| {
                let r = (p.counts - self.offset_counts - self.curve.value(p.temperature_k)) / p.sigma_counts;
                r * r
            })
            .chain(self.known_rows().into_iter().flatten().map(|(_, r)| r * r))
            .sum()
    }

    /// d/d(step) and the distance of a and b from what is known of them, over their sigmas.
    fn known_rows(&self) -> Option<[([f64; 4], f64); 2]> {
        let [a, b] = self.known?;
        let SakumaHattori { a_um, b_um_k, .. } = self.curve;
        let w = a_um * self.pivot_k + b_um_k;
        // b = w − a·pivot at constant w and a.
        Some([
            ([0.0, 0.0, 1.0 / a.sigma, 0.0], (a.value - a_um) / a.sigma),
            ([0.0, w / b.sigma, -self.pivot_k / b.sigma, 0.0], (b.value - b_um_k) / b.sigma),
        ])
    }

    fn is_black_body(&self) -> bool {
        let SakumaHattori { a_counts, a_um, b_um_k } = self.curve;
        let finite = a_counts.is_finite() && a_um.is_finite() && b_um_k.is_finite();
        finite && a_counts > 0.0 && a_um > 0.0
    }

    /// Steps in (ln I(pivot), ln(a·pivot + b), a, offset). These are nearly independent, while A, a and b are
    /// correlated to 1e-6.
    fn stepped(&self, step: &[f64; 4]) -> Self {
        let SakumaHattori { a_counts, a_um, b_um_k } = self.curve;
        let w = a_um * self.pivot_k + b_um_k;
        let w_new = w * libm::exp(step[1]);
        let a_new = a_um + step[2];
        let ratio = libm::exp(step[0]) * libm::expm1(C2_UM_K / w_new) / libm::expm1(C2_UM_K / w);
        let curve =
            SakumaHattori { a_counts: a_counts * ratio, a_um: a_new, b_um_k: w_new - a_new * self.pivot_k };
        Self { curve, offset_counts: self.offset_counts + step[3], ..*self }
    }

    /// d(counts)/d(step) at one temperature.
    fn jacobian(&self, temperature_k: f64) -> [f64; 4] {
        let SakumaHattori { a_counts, a_um, b_um_k } = self.curve;
        let counts = self.curve.value(temperature_k);
        let w = a_um * temperature_k + b_um_k;
        let pivot = a_um * self.pivot_k + b_um_k;
        // d ln I / dw at T, and what A does to hold ln I at the pivot.
        let here = (1.0 + counts / a_counts) * C2_UM_K / (w * w);
        let there = (1.0 + self.curve.value(self.pivot_k) / a_counts) * C2_UM_K / (pivot * pivot);
        let offset = if self.free_offset { 1.0 } else { 0.0 };
        [counts, counts * (here - there) * pivot, counts * here * (temperature_k - self.pivot_k), offset]
    }
}

/// Start values: for each of many effective wavelengths (b = 0) the curve is linear in A and offset; the best wins.
fn start(points: &[CalibrationPoint], offset: OffsetMode, known: Option<[Known; 2]>) -> Option<Parameters> {
    // Weighted by counts the hot end matters most; the pivot is the middle of the range in 1/T.
    let cold = points.iter().map(|p| 1.0 / p.temperature_k).fold(0.0, f64::max);
    let hot = points.iter().map(|p| 1.0 / p.temperature_k).fold(f64::INFINITY, f64::min);
    let pivot_k = 2.0 / (cold + hot);
    let mut best: Option<(f64, Parameters)> = None;
    for i in 0..64 {
        // 0.5 … 30 µm, in steps of 7 %.
        let a_um = 0.5 * libm::pow(60.0, f64::from(i) / 63.0);
        let shape = SakumaHattori { a_counts: 1.0, a_um, b_um_k: 0.0 };
        let Some((a_counts, offset_counts)) = scaled(points, &shape, offset) else { continue };
        let parameters = Parameters {
            curve: SakumaHattori { a_counts, ..shape },
            offset_counts,
            free_offset: offset == OffsetMode::Free,
            pivot_k,
            known,
        };
        let chi2 = parameters.chi2(points);
        if chi2.is_finite() && best.as_ref().is_none_or(|(least, _)| chi2 < *least) {
            best = Some((chi2, parameters));
        }
    }
    best.map(|(_, parameters)| parameters)
}

/// Best A (and offset) for a given shape; None unless A > 0.
fn scaled(points: &[CalibrationPoint], shape: &SakumaHattori, offset: OffsetMode) -> Option<(f64, f64)> {
    // The shape spans many decades: scaled to 1 at the hottest point.
    let top = points.iter().map(|p| shape.value(p.temperature_k)).fold(0.0, f64::max);
    let x: Vec<f64> = points.iter().map(|p| shape.value(p.temperature_k) / top).collect();
    let w: Vec<f64> = points.iter().map(|p| 1.0 / (p.sigma_counts * p.sigma_counts)).collect();
    let (scale, offset_counts) = match offset {
        OffsetMode::Known(offset) => {
            let (mut up, mut down) = (0.0, 0.0);
            for ((x, w), p) in x.iter().zip(&w).zip(points) {
                up += w * x * (p.counts - offset);
                down += w * x * x;
            }
            (up / down, offset)
        }
        OffsetMode::Free => {
            let y: Vec<f64> = points.iter().map(|p| p.counts).collect();
            let line = line::weighted(&x, &y, &w)?;
            (line.slope, line.offset)
        }
    };
    let a_counts = scale / top;
    (a_counts.is_finite() && a_counts > 0.0).then_some((a_counts, offset_counts))
}

/// Levenberg–Marquardt with Marquardt's scaling. Stops when a step changes no count by 1e-12 of its sigma or
/// 1e-15 of itself, or nothing gets better any more.
fn descend(points: &[CalibrationPoint], start: Parameters) -> (Parameters, usize) {
    let mut at = start;
    let mut chi2 = at.chi2(points);
    let mut damping = 1e-3;
    for iteration in 1..=ITERATIONS_MAX {
        let (rows, residuals) = linearised(points, &at);
        let step = damped_step(&rows, &residuals, damping);
        let next = at.stepped(&step);
        let next_chi2 = next.chi2(points);
        if next.curve.a_um > 0.0 && next_chi2 <= chi2 {
            let gain = chi2 - next_chi2;
            let moved = rows.iter().map(|row| dot(row, &step).abs()).fold(0.0, f64::max);
            at = next;
            chi2 = next_chi2;
            damping = (damping * 0.1).max(1e-14);
            if moved < 1e-12 || (gain <= 1e-16 * chi2 && moved < 1e-7) {
                return (at, iteration);
            }
        } else {
            damping *= 10.0;
            if damping > 1e12 {
                return (at, iteration);
            }
        }
    }
    (at, ITERATIONS_MAX)
}

fn linearised(points: &[CalibrationPoint], at: &Parameters) -> (Vec<[f64; 4]>, Vec<f64>) {
    points
        .iter()
        .map(|p| {
            let row = at.jacobian(p.temperature_k).map(|d| d / p.sigma_counts);
            let r = (p.counts - at.offset_counts - at.curve.value(p.temperature_k)) / p.sigma_counts;
            (row, r)
        })
        .chain(at.known_rows().into_iter().flatten())
        .unzip()
}

/// d(counts)/d(ln A, a, b, offset).
fn gradient(curve: &SakumaHattori, temperature_k: f64) -> [f64; 4] {
    let counts = curve.value(temperature_k);
    let w = curve.a_um * temperature_k + curve.b_um_k;
    let by_w = counts * (1.0 + counts / curve.a_counts) * C2_UM_K / (w * w);
    [counts, by_w * temperature_k, by_w, 1.0]
}

/// Covariance of (ln A, a, b, offset): computed in the fit's own variables, then transformed, so that the strong
/// correlation of A, a and b costs no digits.
fn covariance(points: &[CalibrationPoint], at: &Parameters) -> [[f64; 4]; 4] {
    let (rows, residuals) = linearised(points, at);
    let norms = column_norms(&rows);
    let scaled = rows.iter().map(|row| std::array::from_fn(|j| row[j] / norms[j])).collect();
    let (r, _) = solve(scaled, residuals);
    let inverse = upper_inverse(&r);
    let mut own = [[0.0; 4]; 4];
    for (i, row) in own.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            *cell = dot(&inverse[i], &inverse[j]) / (norms[i] * norms[j]);
        }
    }
    let SakumaHattori { a_counts, a_um, b_um_k } = at.curve;
    let pivot = a_um * at.pivot_k + b_um_k;
    let there = (1.0 + at.curve.value(at.pivot_k) / a_counts) * C2_UM_K / (pivot * pivot);
    // Rows: ln A, a, b, offset; columns: ln I(pivot), ln w(pivot), a, offset.
    let change = [
        [1.0, -there * pivot, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, pivot, -at.pivot_k, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    let mut out = [[0.0; 4]; 4];
    for (i, row) in out.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            for (k, own) in own.iter().enumerate() {
                *cell += change[i][k] * dot(own, &change[j]);
            }
        }
    }
    out
}

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
