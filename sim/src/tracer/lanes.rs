//! Vectors of spectral groups: eight f32 at a time, written so that the compiler vectorises them.

#![expect(clippy::needless_range_loop, reason = "loops over lanes step through several arrays at once")]

/// Eight groups.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Lane(pub(super) [f32; 8]);

impl Lane {
    /// All zero.
    pub(super) const ZERO: Self = Self([0.0; 8]);

    /// All one.
    pub(super) const ONE: Self = Self([1.0; 8]);

    /// The sum of the eight.
    #[inline(always)]
    pub(super) fn sum(self) -> f32 {
        let a = self.0;
        ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
    }

    /// Applies `f` to pairs.
    #[inline(always)]
    pub(super) fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = f(self.0[i], other.0[i]);
        }
        Self(out)
    }

    /// Applies `f` to each.
    #[inline(always)]
    pub(super) fn map(self, f: impl Fn(f32) -> f32) -> Self {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = f(self.0[i]);
        }
        Self(out)
    }

    /// Adds the product of two others.
    #[inline(always)]
    pub(super) fn add_product(&mut self, a: Self, b: Self) {
        for i in 0..8 {
            self.0[i] += a.0[i] * b.0[i];
        }
    }
}

impl std::ops::Mul for Lane {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl std::ops::Add for Lane {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl std::ops::Sub for Lane {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

/// exp(−τ) for τ ≥ 0, relative error below 3e-7 (tested); zero beyond τ = 87, where the answer is below 2e-38.
#[inline(always)]
pub(super) fn exp_minus(tau: Lane) -> Lane {
    let mut out = [0.0_f32; 8];
    for i in 0..8 {
        let clamped = if tau.0[i] < 87.0 { tau.0[i] } else { 87.0 };
        let y = clamped * -std::f32::consts::LOG2_E;
        // Adding 1.5·2²³ rounds to an integer, which then stands in the low bits.
        let shifted = y + 12_582_912.0;
        let whole = shifted - 12_582_912.0;
        // x = −τ − whole·ln 2 in two parts, so that the rounding of τ·log₂e does not count.
        let x = (-clamped - whole * 0.693_359_4) - whole * -2.121_944_4e-4;
        // Taylor terms to x⁶/720: |x| ≤ 0.347 leaves 1.2e-7.
        let p = 1.388_888_9e-3;
        let p = p * x + 8.333_334e-3;
        let p = p * x + 4.166_666_6e-2;
        let p = p * x + 0.166_666_67;
        let p = p * x + 0.5;
        let p = p * x + 1.0;
        let p = p * x + 1.0;
        let scale = f32::from_bits(shifted.to_bits().wrapping_shl(23).wrapping_add(0x3f80_0000));
        out[i] = if tau.0[i] < 87.0 { p * scale } else { 0.0 };
    }
    Lane(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_keeps_its_stated_error() {
        let mut worst = 0.0_f64;
        for i in 0..870_000 {
            let tau = crate::tracer::packed::narrow(f64::from(i) * 1e-4);
            let got = f64::from(exp_minus(Lane([tau; 8])).0[3]);
            let want = (-f64::from(tau)).exp();
            worst = worst.max((got / want - 1.0).abs());
        }
        assert!(worst < 3e-7, "{worst}");
        for tau in [0.0, 87.4, 103.3, 1e6, f32::INFINITY] {
            let e = exp_minus(Lane([tau; 8])).0[0];
            assert!((0.0..=1.0).contains(&e), "{tau} {e}");
        }
        assert_eq!(exp_minus(Lane::ZERO), Lane::ONE);
    }
}
