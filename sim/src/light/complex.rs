//! Complex numbers: the few operations that optics needs.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A complex number re + i im.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Complex {
    /// re + i im.
    pub const fn new(re: f64, im: f64) -> Self {
        Self { re, im }
    }

    /// |z|².
    pub fn norm_sqr(self) -> f64 {
        self.re * self.re + self.im * self.im
    }

    /// |z|, without overflow.
    pub fn abs(self) -> f64 {
        self.re.hypot(self.im)
    }

    /// The number mirrored about the real axis.
    pub fn conj(self) -> Self {
        Self::new(self.re, -self.im)
    }

    /// The root with a real part that is not negative.
    pub fn sqrt(self) -> Self {
        let re = (0.5 * (self.abs() + self.re.abs())).sqrt();
        if re > 0.0 {
            let im = 0.5 * self.im / re;
            if self.re >= 0.0 { Self::new(re, im) } else { Self::new(im.abs(), re.copysign(self.im)) }
        } else {
            Self::default()
        }
    }
}

impl Add for Complex {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::new(self.re + other.re, self.im + other.im)
    }
}

impl Sub for Complex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::new(self.re - other.re, self.im - other.im)
    }
}

impl Neg for Complex {
    type Output = Self;
    fn neg(self) -> Self {
        Self::new(-self.re, -self.im)
    }
}

impl Mul for Complex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self::new(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)
    }
}

impl Mul<f64> for Complex {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self::new(self.re * factor, self.im * factor)
    }
}

impl Div for Complex {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        self * other.conj() * other.norm_sqr().recip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_squared_is_the_number_in_every_quadrant() {
        for z in [(3.0, 4.0), (-3.0, 4.0), (-3.0, -4.0), (3.0, -4.0), (-2.0, 0.0), (1e-12, 1.0)] {
            let z = Complex::new(z.0, z.1);
            let root = z.sqrt();
            assert!((root * root - z).abs() <= 4.0 * f64::EPSILON * z.abs(), "{z:?}");
            assert!(root.re >= 0.0);
        }
    }
}
