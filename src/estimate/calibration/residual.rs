//! What the equation leaves of a camera's curve: a monotone correction of its temperatures.
//!
//! T = P(T_s) with T_s the equation's temperature and P a cubic through the points that never turns (Fritsch–Carlson).
//! Each point is drawn back to the equation by as much of its residual as noise explains; the fit makes one only where
//! χ² demands it, since noise alone made into a curve costs a factor of three.

use super::{CalibrationPoint, SakumaHattori};
use serde::{Deserialize, Serialize};

/// χ² above dof + this many times √(2 dof) demands a residual: by chance in fewer than one fit in a hundred.
const DEMAND: f64 = 4.0;

/// Halvings of the inverse: 2⁻⁶⁰ of a segment.
const HALVINGS: usize = 60;

/// A monotone correction of temperatures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Residual {
    /// Temperatures of the equation, in K, ascending.
    pub equation_k: Vec<f64>,
    /// Temperatures that they stand for, in K, ascending.
    pub temperature_k: Vec<f64>,
    /// dT/dT_s at the points.
    slopes: Vec<f64>,
}

/// Whether a fit's χ² says that the equation does not describe the points.
pub(super) fn is_demanded(chi2: f64, dof: usize) -> bool {
    #[expect(clippy::cast_precision_loss, reason = "a number of points")]
    let freedom = dof as f64;
    dof >= 2 && chi2 > freedom + DEMAND * (2.0 * freedom).sqrt()
}

impl Residual {
    /// The residual of points above their offset, counts − curve in `residuals`; None where there is none to be had.
    pub(super) fn of(
        points: &[CalibrationPoint],
        residuals: &[f64],
        curve: &SakumaHattori,
        dof: usize,
    ) -> Option<Self> {
        // Nonlinearity goes with the signal: f ~ τ·I beside noise of the points' sigmas, τ² by moments.
        let (mut excess, mut leverage) = (0.0, 0.0);
        #[expect(clippy::cast_precision_loss, reason = "a number of points")]
        let expected = dof as f64 / points.len() as f64;
        for (point, residual) in points.iter().zip(residuals) {
            let z = residual / point.sigma_counts;
            let signal = curve.value(point.temperature_k) / point.sigma_counts;
            excess += z * z - expected;
            leverage += signal * signal;
        }
        let tau_square = (excess / leverage).max(0.0);
        let mut pairs: Vec<(f64, f64)> = points
            .iter()
            .zip(residuals)
            .filter_map(|(point, residual)| {
                let signal = curve.value(point.temperature_k);
                let equation = curve.inverse(signal + residual);
                let of_signal = tau_square * signal * signal;
                let kept = of_signal / (of_signal + point.sigma_counts * point.sigma_counts);
                let corrected = equation + kept * (point.temperature_k - equation);
                (equation.is_finite() && kept > 0.0).then_some((equation, corrected))
            })
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self::through(&pairs)
    }

    /// The cubic through ascending pairs; None unless both rise.
    fn through(pairs: &[(f64, f64)]) -> Option<Self> {
        let rises = pairs.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 < w[1].1);
        if pairs.len() < 3 || !rises {
            return None;
        }
        let secant = |i: usize| (pairs[i + 1].1 - pairs[i].1) / (pairs[i + 1].0 - pairs[i].0);
        let last = pairs.len() - 1;
        let slope = |i: usize| {
            if i == 0 || i == last {
                // Beyond the ends the correction is constant.
                return 1.0;
            }
            let (before, after) = (secant(i - 1), secant(i));
            let (h, k) = (pairs[i].0 - pairs[i - 1].0, pairs[i + 1].0 - pairs[i].0);
            // Fritsch and Butland's weighted harmonic mean: monotone, and exact for a straight line.
            3.0 * (h + k) / ((2.0 * k + h) / before + (k + 2.0 * h) / after)
        };
        // An end's slope of one stays monotone while it is below three secants; otherwise three.
        let bounded = |i: usize| match i {
            0 => slope(i).min(3.0 * secant(0)),
            i if i == last => slope(i).min(3.0 * secant(last - 1)),
            i => slope(i),
        };
        Some(Self {
            equation_k: pairs.iter().map(|pair| pair.0).collect(),
            temperature_k: pairs.iter().map(|pair| pair.1).collect(),
            slopes: (0..pairs.len()).map(bounded).collect(),
        })
    }

    /// Temperature, in K, and its derivative, for a temperature of the equation. NaN for NaN.
    pub fn apply(&self, equation_k: f64) -> (f64, f64) {
        let (x, y) = (&self.equation_k, &self.temperature_k);
        let last = x.len() - 1;
        if equation_k.is_nan() {
            return (f64::NAN, f64::NAN);
        }
        if equation_k <= x[0] {
            return (equation_k + (y[0] - x[0]), 1.0);
        }
        if equation_k >= x[last] {
            return (equation_k + (y[last] - x[last]), 1.0);
        }
        let i = x.partition_point(|&knot| knot <= equation_k) - 1;
        let h = x[i + 1] - x[i];
        let t = (equation_k - x[i]) / h;
        let (d0, d1) = (self.slopes[i] * h, self.slopes[i + 1] * h);
        let rise = y[i + 1] - y[i];
        // Hermite's cubic from the left point, in powers of t.
        let (square, cube) = (3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise);
        let value = y[i] + t * (d0 + t * (square + t * cube));
        let slope = (d0 + t * (2.0 * square + 3.0 * t * cube)) / h;
        (value, slope)
    }

    /// The equation's temperature, in K, for a temperature: the inverse of [`Self::apply`]. NaN for NaN.
    pub fn undo(&self, temperature_k: f64) -> f64 {
        let (x, y) = (&self.equation_k, &self.temperature_k);
        let last = x.len() - 1;
        if temperature_k.is_nan() {
            return f64::NAN;
        }
        if temperature_k <= y[0] {
            return temperature_k - (y[0] - x[0]);
        }
        if temperature_k >= y[last] {
            return temperature_k - (y[last] - x[last]);
        }
        let i = y.partition_point(|&knot| knot <= temperature_k) - 1;
        let (mut low, mut high) = (x[i], x[i + 1]);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if self.apply(middle).0 < temperature_k {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{OffsetMode, fit_curve};
    use super::*;

    const TRUTH: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn points(bend: f64, sigma: f64) -> Vec<CalibrationPoint> {
        (0..12)
            .map(|i| {
                let temperature_k = 340.0 + 24.0 * f64::from(i);
                let counts = bent(temperature_k, bend);
                CalibrationPoint { temperature_k, counts, sigma_counts: 0.01 + sigma * counts }
            })
            .collect()
    }

    /// A detector that loses `bend` of its signal at 700 counts, and ripples a little.
    fn bent(temperature_k: f64, bend: f64) -> f64 {
        let counts = TRUTH.value(temperature_k);
        counts * (1.0 - bend * counts / 700.0 + 0.3 * bend * (temperature_k / 25.0).sin())
    }

    /// A nonlinear camera, measured well: the equation alone leaves tenths of a kelvin, the residual a third of that;
    /// both directions agree, and the curve rises everywhere.
    #[test]
    fn nonlinear_camera_gets_a_residual_that_helps() {
        let fit = fit_curve(&points(0.03, 2e-4), OffsetMode::Known(0.0)).unwrap();
        assert!(fit.residual.is_some(), "chi2 {} of {}", fit.chi2, fit.dof);
        let error = |kelvin: &dyn Fn(f64) -> f64| {
            let squares: f64 =
                (345..600).map(|t| (kelvin(bent(f64::from(t), 0.03)) - f64::from(t)).powi(2)).sum();
            (squares / 255.0).sqrt()
        };
        let (alone, with) = (error(&|c| fit.curve.inverse(c)), error(&|c| fit.temperature(c)));
        eprintln!("{alone:.3} K without, {with:.3} K with the residual");
        assert!(with < 0.5 * alone, "{with} {alone}");
        let mut before = 0.0;
        for t in 300..700 {
            let counts = fit.counts(f64::from(t));
            assert!(counts > before, "{t}");
            before = counts;
            assert!((fit.temperature(counts) - f64::from(t)).abs() < 1e-9, "{t}");
            let h = 1e-4;
            let slope = (fit.counts(f64::from(t) + h) - fit.counts(f64::from(t) - h)) / (2.0 * h);
            // At the ends the slope jumps.
            assert!(
                (fit.derivative(f64::from(t)) / slope - 1.0).abs() < 1e-5 || [340, 604].contains(&t),
                "{t}"
            );
        }
    }

    /// Noise of the stated size makes no residual, whatever the draw: 500 fits, at most 2 % demand one.
    #[test]
    fn noise_alone_makes_no_residual() {
        let mut state = 5_u64;
        let mut normal = move || {
            let sum: f64 = (0..12)
                .map(|_| {
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    f64::from(u32::try_from(state >> 32).unwrap()) / 4_294_967_296.0
                })
                .sum();
            sum - 6.0
        };
        let mut demanded = 0;
        for _ in 0..500 {
            let mut noisy = points(0.0, 1e-3);
            noisy.iter_mut().for_each(|p| p.counts += p.sigma_counts * normal());
            let fit = fit_curve(&noisy, OffsetMode::Free).unwrap();
            demanded += u32::from(fit.residual.is_some());
        }
        assert!(demanded <= 10, "{demanded} of 500");
    }
}
