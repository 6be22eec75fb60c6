//! Quantiles of Student's t for real degrees of freedom, as a series for fast use per pixel.
//!
//! Only functions from `libm` and arithmetic: the same bits on every machine of an architecture.

/// Half-width in standard deviations of the normal 95 % interval.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Coefficients of a quantile's series. Fewer would not do for the curve's many derivatives at the normal end.
pub(super) const NODES: usize = 18;

/// Two-sided quantiles at one confidence level: t such that P(|T| ≤ t) = confidence, for any ν ≥ 1.
///
/// 1/t is smooth in 1/ν: a Chebyshev series over 0 … 1 replaces a table, so that vectors need no gathering.
#[derive(Debug, Clone)]
pub struct Quantiles {
    coefficients: [f64; NODES],
    normal: f64,
}

impl Quantiles {
    /// Prepares the series. `confidence` is in 0 … 1 exclusive.
    pub fn new(confidence: f64) -> Self {
        assert!(confidence > 0.0 && confidence < 1.0, "a confidence lies between 0 and 1");
        #[expect(clippy::cast_precision_loss, reason = "below twenty")]
        let part = |i: usize| i as f64 / (NODES - 1) as f64;
        // Interpolation at the extrema of the last polynomial: both ends are nodes, so they are exact.
        let inverse: [f64; NODES] = std::array::from_fn(|i| {
            let z = libm::cos(std::f64::consts::PI * part(i));
            1.0 / quantile(confidence, 0.5 * (z + 1.0))
        });
        let half_at_ends = |i: usize| if i == 0 || i == NODES - 1 { 0.5 } else { 1.0 };
        let coefficients = std::array::from_fn(|k| {
            #[expect(clippy::cast_precision_loss, reason = "below twenty")]
            let order = k as f64;
            let sum: f64 = (0..NODES)
                .map(|i| half_at_ends(i) * inverse[i] * libm::cos(std::f64::consts::PI * order * part(i)))
                .sum();
            2.0 * part(1) * half_at_ends(k) * sum
        });
        Self { coefficients, normal: quantile(confidence, 0.0) }
    }

    /// Quantile for `freedom` degrees of freedom; below 1 it is taken as 1, infinity is the normal distribution.
    /// Relative error below 2e-5, see the test. NaN stays NaN.
    pub fn at(&self, freedom: f64) -> f64 {
        if freedom.is_infinite() {
            return self.normal;
        }
        if freedom.is_nan() {
            return f64::NAN;
        }
        let z = 2.0 / freedom.max(1.0) - 1.0;
        let (mut b1, mut b2) = (0.0, 0.0);
        for c in self.coefficients[1..].iter().rev() {
            (b1, b2) = (2.0 * z * b1 - b2 + c, b1);
        }
        1.0 / (z * b1 - b2 + self.coefficients[0])
    }

    /// Coefficients of 1/t over powers of z = 2/ν − 1, as short as an error of 1e-6 of t allows: half as many operations
    /// as the series, for vectors.
    pub(super) fn powers(&self) -> Vec<f64> {
        // 1/t is least at one of its ends, ν = 1; no polynomial of the series is above 1 between them.
        let least: f64 = 1.0 / self.at(1.0);
        let mut dropped = 0.0;
        let mut kept = NODES;
        while kept > 1 {
            dropped += self.coefficients[kept - 1].abs();
            if dropped > POWERS_ERROR * least {
                break;
            }
            kept -= 1;
        }
        // Chebyshev's polynomials by their recurrence, T(n + 1) = 2 z T(n) − T(n − 1).
        let (mut before, mut now) = (vec![0.0; kept], vec![0.0; kept]);
        let mut powers = vec![0.0; kept];
        now[0] = 1.0;
        for (order, &c) in self.coefficients[..kept].iter().enumerate() {
            powers.iter_mut().zip(&now).for_each(|(power, part)| *power += c * part);
            let factor = if order == 0 { 1.0 } else { 2.0 };
            let next = (0..kept)
                .map(|i| if i == 0 { -before[0] } else { factor * now[i - 1] - before[i] })
                .collect();
            before = std::mem::replace(&mut now, next);
        }
        powers
    }
}

/// What [`Quantiles::powers`] may be off by, of t.
const POWERS_ERROR: f64 = 1e-6;

/// Steps of a search: the secant takes some ten, bisection alone would end within so many.
const STEPS_MAX: usize = 80;

/// Two-sided quantile by the secant in a bracket (Illinois' rule); `inverse` = 1/ν, 0 is the normal distribution.
fn quantile(confidence: f64, inverse: f64) -> f64 {
    let off = |t: f64| inside(t, inverse) - confidence;
    let (mut low, mut high) = (0.0, 1.0);
    let (mut at_low, mut at_high) = (-confidence, off(high));
    while at_high < 0.0 && high < 1e12 {
        (low, at_low) = (high, at_high);
        high *= 2.0;
        at_high = off(high);
    }
    let mut side = 0;
    for step in 0..STEPS_MAX {
        let secant = (low * at_high - high * at_low) / (at_high - at_low);
        // Rounding of the distribution function can put the secant outside: then half is safe, as at times anyway.
        let middle = 0.5 * (low + high);
        let t = if step % 8 < 7 && low < secant && secant < high { secant } else { middle };
        let at = off(t);
        if at < 0.0 {
            (low, at_low) = (t, at);
            at_high *= if side < 0 { 0.5 } else { 1.0 };
            side = -1;
        } else {
            (high, at_high) = (t, at);
            at_low *= if side > 0 { 0.5 } else { 1.0 };
            side = 1;
        }
        // Nothing is nearer than what rounds to the confidence itself.
        if at.abs() < 1e-16 || high - low <= 2.0 * f64::EPSILON * high {
            return t;
        }
    }
    0.5 * (low + high)
}

/// P(|T| ≤ t) for ν = 1/inverse.
fn inside(t: f64, inverse: f64) -> f64 {
    if inverse <= 0.0 {
        return libm::erf(t / std::f64::consts::SQRT_2);
    }
    let nu = 1.0 / inverse;
    1.0 - incomplete_beta(0.5 * nu, 0.5, nu / (nu + t * t))
}

/// Regularised incomplete beta function I_x(a, b) by its continued fraction (modified Lentz; DLMF 8.17.22).
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(b, a, 1.0 - x);
    }
    let front =
        a * libm::log(x) + b * libm::log1p(-x) + libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b);
    let tiny = 1e-300;
    let guard = |v: f64| if v.abs() < tiny { tiny } else { v };
    let mut c = 1.0;
    let mut d = 1.0 / guard(1.0 - (a + b) * x / (a + 1.0));
    let mut h = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = 1.0 / guard(1.0 + even * d);
        c = guard(1.0 + even / c);
        h *= d * c;
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = 1.0 / guard(1.0 + odd * d);
        c = guard(1.0 + odd / c);
        let step = d * c;
        h *= step;
        if (step - 1.0).abs() < 1e-16 {
            break;
        }
    }
    libm::exp(front) * h / a
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against printed tables (NIST/SEMATECH e-Handbook, 1.3.6.7.2) and closed forms for ν = 1, 2.
    #[test]
    fn quantiles_agree_with_tables() {
        let t = Quantiles::new(0.95);
        for (freedom, expected) in [
            (1.0, 12.706),
            (2.0, 4.303),
            (3.0, 3.182),
            (5.0, 2.571),
            (10.0, 2.228),
            (30.0, 2.042),
            (100.0, 1.984),
        ] {
            assert!((t.at(freedom) - expected).abs() < 6e-4, "{freedom}: {}", t.at(freedom));
        }
        assert!((t.at(f64::INFINITY) - NORMAL_95).abs() < 1e-12);
        let exact_1 = libm::tan(std::f64::consts::FRAC_PI_2 * 0.95);
        assert!((t.at(1.0) / exact_1 - 1.0).abs() < 1e-10);
        let exact_2 = 2.0 * 0.95 / (2.0 * (1.0 - 0.95_f64 * 0.95)).sqrt();
        assert!((t.at(2.0) / exact_2 - 1.0).abs() < 1e-10, "{} {exact_2}", t.at(2.0));
        assert!((t.at(0.2) - t.at(1.0)).abs() < 1e-12);
    }

    /// Short polynomials stay within their bound, and are short.
    #[test]
    fn powers_are_the_series() {
        for (confidence, most) in [(0.6827, 9), (0.95, 11), (0.99, 14), (0.999_9, NODES)] {
            let t = Quantiles::new(confidence);
            let powers = t.powers();
            assert!(powers.len() <= most, "{confidence}: {}", powers.len());
            for i in 0..=1000 {
                let freedom = 1000.0 / f64::from(i).max(1e-3);
                let z = 2.0 / freedom - 1.0;
                let inverse = powers.iter().rev().fold(0.0, |sum, c| sum * z + c);
                assert!((1.0 / inverse / t.at(freedom) - 1.0).abs() < 1.01e-6, "{confidence} {freedom}");
            }
        }
    }

    #[test]
    fn interpolation_is_accurate() {
        for confidence in [0.6827, 0.95, 0.99] {
            let t = Quantiles::new(confidence);
            for i in 1..400 {
                let inverse = f64::from(i) / 401.0;
                let exact = quantile(confidence, inverse);
                assert!((t.at(1.0 / inverse) / exact - 1.0).abs() < 2e-5, "{confidence} {inverse}");
            }
        }
    }
}
