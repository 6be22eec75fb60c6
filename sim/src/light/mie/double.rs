//! Numbers of twice the precision: an unevaluated sum of two f64, about 31 digits.
//!
//! Sums after Knuth and Møller, products by fused operations; Joldes, Muller and Popescu, ACM Trans. Math. Softw. 44,
//! 15 (2017), algorithms 4, 6, 12 and 17: relative errors of a few 2⁻¹⁰⁶.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// high + low, |low| at most half a unit in the last place of high.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Double {
    pub(super) high: f64,
    pub(super) low: f64,
}

impl Double {
    pub(super) const ZERO: Self = Self { high: 0.0, low: 0.0 };
    pub(super) const ONE: Self = Self { high: 1.0, low: 0.0 };

    pub(super) const fn new(high: f64) -> Self {
        Self { high, low: 0.0 }
    }

    /// a + b for |a| ≥ |b|.
    fn from_sum(a: f64, b: f64) -> Self {
        let high = a + b;
        Self { high, low: b - (high - a) }
    }

    /// a + b without error.
    fn exact_sum(a: f64, b: f64) -> Self {
        let high = a + b;
        let part = high - a;
        Self { high, low: (a - (high - part)) + (b - part) }
    }

    /// a b without error.
    pub(super) fn exact_product(a: f64, b: f64) -> Self {
        let high = a * b;
        Self { high, low: a.mul_add(b, -high) }
    }

    pub(super) fn abs(self) -> Self {
        if self.high < 0.0 { -self } else { self }
    }

    pub(super) fn square(self) -> Self {
        self * self
    }

    pub(super) fn recip(self) -> Self {
        Self::ONE / self
    }

    /// The nearest f64.
    pub(super) fn value(self) -> f64 {
        self.high + self.low
    }

    /// (sin x, cos x) of a number that is not negative and at most 1e9.
    ///
    /// Reduction by multiples of π/2 of 212 bits, Taylor series of an eighth of the rest, doubled three times.
    pub(super) fn sine_cosine(x: f64) -> (Self, Self) {
        let quarter = (x * std::f64::consts::FRAC_2_PI).round();
        let mut rest = Self::new(x);
        for part in HALF_PI {
            rest = rest - Self::exact_product(quarter, part);
        }
        let eighth = Self { high: rest.high * 0.125, low: rest.low * 0.125 };
        let square = eighth.square();
        // sin h = h − h³/6 …, and 1 − cos h for the doublings: with |h| below 0.1 eleven terms leave 1e-36.
        let (mut sine, mut versine) = (Self::ZERO, Self::ZERO);
        let mut term = eighth;
        for i in 0..11 {
            let n = f64::from(2 * i + 1);
            sine = sine + term;
            let even = term * eighth / Self::new(n + 1.0);
            versine = versine + even;
            term = -(term * square) / Self::new((n + 1.0) * (n + 2.0));
        }
        let mut cosine = Self::ONE - versine;
        for _ in 0..3 {
            // 1 − cos 2h = 2 sin² h, sin 2h = 2 sin h cos h.
            versine = sine.square() * Self::new(2.0);
            sine = sine * cosine * Self::new(2.0);
            cosine = Self::ONE - versine;
        }
        match quarter.rem_euclid(4.0) {
            q if q < 0.5 => (sine, cosine),
            q if q < 1.5 => (cosine, -sine),
            q if q < 2.5 => (-sine, -cosine),
            _ => (-cosine, sine),
        }
    }
}

/// π/2 in four parts.
const HALF_PI: [f64; 4] = [
    std::f64::consts::FRAC_PI_2,
    6.123_233_995_736_766e-17,
    -1.497_384_904_859_169_8e-33,
    5.562_271_104_316_826e-50,
];

impl Add for Double {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let high = Self::exact_sum(self.high, other.high);
        let low = Self::exact_sum(self.low, other.low);
        let sum = Self::from_sum(high.high, high.low + low.high);
        Self::from_sum(sum.high, low.low + sum.low)
    }
}

impl Neg for Double {
    type Output = Self;
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Sub for Double {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Double {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = Self::exact_product(self.high, other.high);
        let low = self.low.mul_add(other.high, self.high * other.low + self.low * other.low);
        Self::from_sum(product.high, product.low + low)
    }
}

impl Div for Double {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * Self::new(first);
        let second = rest.high / other.high;
        let rest = rest - other * Self::new(second);
        let third = rest.high / other.high;
        let sum = Self::from_sum(first, second);
        Self::from_sum(sum.high, sum.low + third)
    }
}

/// A complex number of twice the precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DoubleComplex {
    pub(super) re: Double,
    pub(super) im: Double,
}

impl DoubleComplex {
    pub(super) fn norm_sqr(self) -> Double {
        self.re.square() + self.im.square()
    }

    pub(super) fn recip(self) -> Self {
        let inverse = self.norm_sqr().recip();
        Self { re: self.re * inverse, im: -(self.im * inverse) }
    }

    pub(super) fn scaled(self, factor: Double) -> Self {
        Self { re: self.re * factor, im: self.im * factor }
    }
}

impl Sub for DoubleComplex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }
}

impl Mul for DoubleComplex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { re: self.re * other.re - self.im * other.im, im: self.re * other.im + self.im * other.re }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_and_quotients_keep_thirty_digits() {
        // 1/3 · 3 and (1 + 2⁻⁶⁰)² − 1 = 2⁻⁵⁹ + 2⁻¹²⁰.
        let third = Double::ONE / Double::new(3.0);
        assert!((third * Double::new(3.0) - Double::ONE).abs().value() < 1e-31);
        let small = Double { high: 1.0, low: 2f64.powi(-60) };
        assert!(((small.square() - Double::ONE).value() / 2f64.powi(-59) - 1.0).abs() < 1e-13);
    }

    #[test]
    fn sines_agree_with_thirty_digits() {
        // mpmath with 70 digits, as high + low.
        for (x, sine, cosine) in [
            (
                1.0,
                (0.841_470_984_807_896_5, 1.776_845_092_935_536e-18),
                (0.540_302_305_868_139_8, -4.760_954_612_604_417e-17),
            ),
            (
                12_345.678,
                (-0.704_081_313_753_381_6, -1.964_696_919_630_147_4e-17),
                (0.710_119_358_716_062_8, -2.481_574_741_536_530_5e-17),
            ),
            (
                1_000_000.5,
                (0.141_954_699_000_744, -2.184_367_841_909_782e-18),
                (0.989_873_155_223_237_8, -5.524_974_838_526_726_4e-17),
            ),
        ] {
            let (s, c) = Double::sine_cosine(x);
            let wanted = |pair: (f64, f64)| Double { high: pair.0, low: pair.1 };
            assert!((s - wanted(sine)).abs().value() < 1e-30, "{x}: {s:?}");
            assert!((c - wanted(cosine)).abs().value() < 1e-30, "{x}: {c:?}");
        }
        for x in [0.1, 3.0, 100.0, 1e5 + 0.1, 1e8] {
            let (s, c) = Double::sine_cosine(x);
            assert!((s.square() + c.square() - Double::ONE).abs().value() < 1e-30);
            assert!((s.value() - x.sin()).abs() < 2e-16 && (c.value() - x.cos()).abs() < 2e-16);
        }
    }
}
