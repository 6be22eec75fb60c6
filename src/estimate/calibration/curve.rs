//! The Sakuma–Hattori curve: counts of a black body against its temperature, back, and the range in which it is trusted.
//!
//! Planck form, three parameters, monotone, closed inverse (F. Sakuma, S. Hattori 1982; recommended below the silver
//! point by BIPM CCT-WG5).

use serde::{Deserialize, Serialize};

/// Second radiation constant, in µm K (CODATA 2018, exact: hc/k).
pub const C2_UM_K: f64 = 14_387.768_775;

/// A reading is extrapolated by at most this fraction of the calibrated range, measured in 1/T.
pub(in crate::estimate) const EXTRAPOLATION_MAX: f64 = 0.1;

/// I(T) = A / (exp(c2 / (a T + b)) − 1), counts without offset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SakumaHattori {
    /// A, in counts.
    pub a_counts: f64,
    /// a, in µm: near the mean effective wavelength.
    pub a_um: f64,
    /// b, in µm K: how the effective wavelength shifts with temperature.
    pub b_um_k: f64,
}

impl SakumaHattori {
    /// Counts of a black body at `temperature_k`, without offset. Relative error below (5 + 3u)·2⁻⁵³ with
    /// u = c2/(aT+b). Zero where a T + b ≤ 0.
    pub fn value(&self, temperature_k: f64) -> f64 {
        let w = self.a_um * temperature_k + self.b_um_k;
        if w <= 0.0 { 0.0 } else { self.a_counts / libm::expm1(C2_UM_K / w) }
    }

    /// Temperature, in K, of a black body that gives `counts` above the offset. NaN for counts ≤ 0 or NaN.
    pub fn inverse(&self, counts: f64) -> f64 {
        if counts > 0.0 {
            (C2_UM_K / libm::log1p(self.a_counts / counts) - self.b_um_k) / self.a_um
        } else {
            f64::NAN
        }
    }

    /// dT/dI, in K/count, where the curve gives `counts` > 0 at `temperature_k` = inverse(counts): no exponential.
    pub fn inverse_derivative(&self, counts: f64, temperature_k: f64) -> f64 {
        let w = self.a_um * temperature_k + self.b_um_k;
        w * w / (counts * (1.0 + counts / self.a_counts) * C2_UM_K * self.a_um)
    }

    /// dI/dT at `temperature_k`, in counts/K. Zero where a T + b ≤ 0.
    pub fn derivative(&self, temperature_k: f64) -> f64 {
        let w = self.a_um * temperature_k + self.b_um_k;
        if w <= 0.0 {
            return 0.0;
        }
        let counts = self.value(temperature_k);
        counts * (1.0 + counts / self.a_counts) * C2_UM_K * self.a_um / (w * w)
    }
}

/// Where a temperature stands against the calibrated range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// Between the coldest and the hottest point of the calibration.
    Inside,
    /// Outside by at most 10 % of the range in 1/T.
    Extrapolated,
    /// Further outside, or without a temperature: no answer.
    Outside,
}

/// The calibrated range of temperatures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Temperature of the coldest point, in K.
    pub low_k: f64,
    /// Temperature of the hottest point, in K.
    pub high_k: f64,
}

impl Range {
    /// Where `temperature_k` stands; NaN is outside.
    pub fn reach(&self, temperature_k: f64) -> Reach {
        let (cold, hot) = (1.0 / self.low_k, 1.0 / self.high_k);
        let margin = EXTRAPOLATION_MAX * (cold - hot);
        let at = 1.0 / temperature_k;
        if self.low_k <= temperature_k && temperature_k <= self.high_k {
            Reach::Inside
        } else if temperature_k > 0.0 && at <= cold + margin && at >= hot - margin {
            Reach::Extrapolated
        } else {
            Reach::Outside
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    #[test]
    fn inverse_and_derivative_belong_to_the_curve() {
        for t in [250.0, 300.0, 373.0, 449.0, 533.0, 900.0] {
            assert!((TRUTH.inverse(TRUTH.value(t)) / t - 1.0).abs() < 1e-14);
            let h = 1e-3;
            let slope = (TRUTH.value(t + h) - TRUTH.value(t - h)) / (2.0 * h);
            assert!((TRUTH.derivative(t) / slope - 1.0).abs() < 1e-8);
            let inverse = TRUTH.inverse_derivative(TRUTH.value(t), t);
            assert!((TRUTH.derivative(t) * inverse - 1.0).abs() < 1e-13);
        }
        assert!(
            TRUTH.inverse(0.0).is_nan() && TRUTH.inverse(-1.0).is_nan() && TRUTH.inverse(f64::NAN).is_nan()
        );
    }

    #[test]
    fn range_is_judged_in_inverse_temperature() {
        let range = Range { low_k: 373.0, high_k: 533.0 };
        assert_eq!(range.reach(373.0), Reach::Inside);
        assert_eq!(range.reach(365.0), Reach::Extrapolated);
        assert_eq!(range.reach(555.0), Reach::Extrapolated);
        assert_eq!(range.reach(340.0), Reach::Outside);
        assert_eq!(range.reach(600.0), Reach::Outside);
        assert_eq!(range.reach(f64::NAN), Reach::Outside);
    }
}
