//! Numbers side by side: plain loops over `[f64; L]` that the compiler turns into vectors.
//!
//! Everything is inlined into the caller, so that the vectors are those of the caller's CPU features.

use std::array::from_fn;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// `L` real numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Real<const L: usize>(pub(super) [f64; L]);

/// `L` complex numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cplx<const L: usize> {
    pub(super) re: Real<L>,
    pub(super) im: Real<L>,
}

impl<const L: usize> Real<L> {
    #[inline(always)]
    pub(super) fn all(value: f64) -> Self {
        Self([value; L])
    }

    #[inline(always)]
    pub(super) fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self(from_fn(|i| f(self.0[i])))
    }

    #[inline(always)]
    pub(super) fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self(from_fn(|i| f(self.0[i], other.0[i])))
    }

    /// `self` where `limit` is at least `n`, else 0, whatever stands there.
    #[inline(always)]
    pub(super) fn up_to(self, limit: Self, n: f64) -> Self {
        self.zip(limit, |value, limit| if n <= limit { value } else { 0.0 })
    }
}

macro_rules! lanewise {
    ($trait:ident, $name:ident, $op:tt) => {
        impl<const L: usize> $trait for Real<L> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.zip(other, |a, b| a $op b)
            }
        }
    };
}
lanewise!(Add, add, +);
lanewise!(Sub, sub, -);
lanewise!(Mul, mul, *);
lanewise!(Div, div, /);

impl<const L: usize> Mul<f64> for Real<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self.map(|a| a * factor)
    }
}

impl<const L: usize> Neg for Real<L> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

impl<const L: usize> Cplx<L> {
    pub(super) const ZERO: Self = Self { re: Real([0.0; L]), im: Real([0.0; L]) };

    #[inline(always)]
    pub(super) fn norm_sqr(self) -> Real<L> {
        self.re * self.re + self.im * self.im
    }

    #[inline(always)]
    pub(super) fn conj(self) -> Self {
        Self { re: self.re, im: -self.im }
    }

    /// 1 / z.
    #[inline(always)]
    pub(super) fn recip(self) -> Self {
        let inverse = self.norm_sqr().map(|square| 1.0 / square);
        Self { re: self.re * inverse, im: -(self.im * inverse) }
    }

    /// z times a real number.
    #[inline(always)]
    pub(super) fn scale(self, factor: Real<L>) -> Self {
        Self { re: self.re * factor, im: self.im * factor }
    }

    /// Re(z · conj(other)).
    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> Real<L> {
        self.re * other.re + self.im * other.im
    }

    #[inline(always)]
    pub(super) fn up_to(self, limit: Real<L>, n: f64) -> Self {
        Self { re: self.re.up_to(limit, n), im: self.im.up_to(limit, n) }
    }
}

impl<const L: usize> Add for Cplx<L> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }
}

impl<const L: usize> Sub for Cplx<L> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }
}

impl<const L: usize> Mul for Cplx<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { re: self.re * other.re - self.im * other.im, im: self.re * other.im + self.im * other.re }
    }
}
