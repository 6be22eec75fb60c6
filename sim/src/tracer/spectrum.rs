//! The spectral groups of one quantity, in f32: a single number, or eight or sixteen at a time so that the compiler vectorises.
//!
//! All loops of image mode are written once over [`Spectrum`]. A lone group must not pay for eight. Fused products are
//! one instruction inside [`vectorised`] where it finds AVX2 or NEON, and as exact, but a slow call, elsewhere: what runs
//! outside multiplies and adds.

#![expect(clippy::needless_range_loop, reason = "loops over lanes step through several arrays at once")]

use super::lanes::larger;

/// Values of all spectral groups. Lanes beyond the last group hold zeros and are never read.
pub(super) trait Spectrum: Copy + Send + Sync + 'static {
    /// Most groups that it holds.
    const WIDTH: usize;
    /// All zero.
    const ZERO: Self;

    /// All the same.
    fn splat(value: f32) -> Self;
    /// The value of a group.
    fn get(&self, group: usize) -> f32;
    /// Sets the value of a group.
    fn set(&mut self, group: usize, value: f32);
    /// self + other
    fn plus(self, other: Self) -> Self;
    /// self − other
    fn minus(self, other: Self) -> Self;
    /// self · other
    fn times(self, other: Self) -> Self;
    /// self / other; zero where other is not positive.
    fn over(self, other: Self) -> Self;
    /// self · factor
    fn scaled(self, factor: f32) -> Self;
    /// The larger of self and zero.
    fn not_negative(self) -> Self;
    /// Sum over the lanes.
    fn sum(self) -> f32;
    /// Largest lane.
    fn largest(self) -> f32;
    /// Whether any lane is above a limit.
    fn any_above(self, limit: f32) -> bool;
    /// The root of self² + square, with the sign of self.
    fn signed_hypot(self, square: Self) -> Self;
    /// e^−τ and 1 − e^−τ for the optical depth τ = self · length, see [`split`].
    fn split(self, length: f32) -> (Self, Self);

    /// self + a · b with one rounding
    fn plus_product(self, a: Self, b: Self) -> Self;
    /// self + a · factor with one rounding
    fn plus_scaled(self, a: Self, factor: f32) -> Self;
}

/// One group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct One(f32);

impl Spectrum for One {
    const WIDTH: usize = 1;
    const ZERO: Self = Self(0.0);

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(value)
    }
    #[inline(always)]
    fn get(&self, _: usize) -> f32 {
        self.0
    }
    #[inline(always)]
    fn set(&mut self, _: usize, value: f32) {
        self.0 = value;
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self(self.0 - other.0)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        Self(if other.0 > 0.0 { self.0 / other.0 } else { 0.0 })
    }
    #[inline(always)]
    fn scaled(self, factor: f32) -> Self {
        Self(self.0 * factor)
    }
    #[inline(always)]
    fn not_negative(self) -> Self {
        Self(self.0.max(0.0))
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        self.0
    }
    #[inline(always)]
    fn largest(self) -> f32 {
        self.0
    }
    #[inline(always)]
    fn any_above(self, limit: f32) -> bool {
        self.0 > limit
    }
    #[inline(always)]
    fn signed_hypot(self, square: Self) -> Self {
        Self((self.0 * self.0 + square.0).sqrt().copysign(self.0))
    }
    #[inline(always)]
    fn split(self, length: f32) -> (Self, Self) {
        let (through, stopped) = split(self.0 * length);
        (Self(through), Self(stopped))
    }
    #[inline(always)]
    fn plus_product(self, a: Self, b: Self) -> Self {
        Self(a.0.mul_add(b.0, self.0))
    }
    #[inline(always)]
    fn plus_scaled(self, a: Self, factor: f32) -> Self {
        Self(a.0.mul_add(factor, self.0))
    }
}

/// One for every group, zero in the lanes beyond them.
#[inline(always)]
pub(super) fn ones<S: Spectrum>(groups: usize) -> S {
    if S::WIDTH == 1 {
        return S::splat(1.0);
    }
    let mut all = S::ZERO;
    for g in 0..groups {
        all.set(g, 1.0);
    }
    all
}

/// Eight groups.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Lane([f32; 8]);

/// Sixteen groups: a line of the cache, which must not lie across two.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Wide([f32; 16]);

macro_rules! side_by_side {
    ($lane:ident, $width:literal) => {
        impl<const N: usize> Spectrum for [$lane; N] {
            const WIDTH: usize = $width * N;
            const ZERO: Self = [$lane([0.0; $width]); N];

            #[inline(always)]
            fn splat(value: f32) -> Self {
                [$lane([value; $width]); N]
            }
            #[inline(always)]
            fn get(&self, group: usize) -> f32 {
                self[group / $width].0[group % $width]
            }
            #[inline(always)]
            fn set(&mut self, group: usize, value: f32) {
                self[group / $width].0[group % $width] = value;
            }
            #[inline(always)]
            fn plus(mut self, other: Self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        self[n].0[i] += other[n].0[i];
                    }
                }
                self
            }
            #[inline(always)]
            fn minus(mut self, other: Self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        self[n].0[i] -= other[n].0[i];
                    }
                }
                self
            }
            #[inline(always)]
            fn times(mut self, other: Self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        self[n].0[i] *= other[n].0[i];
                    }
                }
                self
            }
            #[inline(always)]
            fn over(mut self, other: Self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        let d = other[n].0[i];
                        self[n].0[i] = if d > 0.0 { self[n].0[i] / d } else { 0.0 };
                    }
                }
                self
            }
            #[inline(always)]
            fn scaled(mut self, factor: f32) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        self[n].0[i] *= factor;
                    }
                }
                self
            }
            #[inline(always)]
            fn not_negative(mut self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        let v = self[n].0[i];
                        self[n].0[i] = if v > 0.0 { v } else { 0.0 };
                    }
                }
                self
            }
            #[inline(always)]
            fn sum(self) -> f32 {
                let mut all = self[0].0;
                for n in 1..N {
                    for i in 0..$width {
                        all[i] += self[n].0[i];
                    }
                }
                sum_of(all)
            }
            #[inline(always)]
            fn largest(self) -> f32 {
                let mut most = self[0].0;
                for n in 1..N {
                    for i in 0..$width {
                        most[i] = larger(self[n].0[i], most[i]);
                    }
                }
                largest_of(most)
            }
            #[inline(always)]
            fn any_above(self, limit: f32) -> bool {
                let mut any = false;
                for n in 0..N {
                    for i in 0..$width {
                        any |= self[n].0[i] > limit;
                    }
                }
                any
            }
            #[inline(always)]
            fn signed_hypot(mut self, square: Self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        let v = self[n].0[i];
                        self[n].0[i] = (v * v + square[n].0[i]).sqrt().copysign(v);
                    }
                }
                self
            }
            #[inline(always)]
            fn split(self, length: f32) -> (Self, Self) {
                let mut through = Self::ZERO;
                let mut stopped = Self::ZERO;
                for n in 0..N {
                    let mut tau = self[n].0;
                    for i in 0..$width {
                        tau[i] *= length;
                    }
                    (through[n].0, stopped[n].0) = splits(tau);
                }
                (through, stopped)
            }
            #[inline(always)]
            fn plus_product(mut self, a: Self, b: Self) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        self[n].0[i] = a[n].0[i].mul_add(b[n].0[i], self[n].0[i]);
                    }
                }
                self
            }
            #[inline(always)]
            fn plus_scaled(mut self, a: Self, factor: f32) -> Self {
                for n in 0..N {
                    for i in 0..$width {
                        self[n].0[i] = a[n].0[i].mul_add(factor, self[n].0[i]);
                    }
                }
                self
            }
        }
    };
}

side_by_side!(Lane, 8);
side_by_side!(Wide, 16);

/// Sum by halves.
#[inline(always)]
fn sum_of<const N: usize>(mut all: [f32; N]) -> f32 {
    let mut n = N / 2;
    while n > 0 {
        for i in 0..n {
            all[i] += all[i + n];
        }
        n /= 2;
    }
    all[0]
}

/// Largest by halves.
#[inline(always)]
fn largest_of<const N: usize>(mut all: [f32; N]) -> f32 {
    let mut n = N / 2;
    while n > 0 {
        for i in 0..n {
            all[i] = larger(all[i], all[i + n]);
        }
        n /= 2;
    }
    all[0]
}

/// e^−τ and 1 − e^−τ for τ ≥ 0, each with a relative error below 5e-7 (tested); e^−τ is zero beyond τ = 87, where it is
/// below 2e-38.
#[inline(always)]
pub(super) fn split(tau: f32) -> (f32, f32) {
    let ([through], [stopped]) = splits([tau]);
    (through, stopped)
}

/// The same for many. Every step is taken for all of them before the next one: a loop over the whole function is unrolled
/// into scalars.
#[inline(always)]
fn splits<const N: usize>(tau: [f32; N]) -> ([f32; N], [f32; N]) {
    let clamped: [f32; N] = each(
        #[inline(always)]
        |i| if tau[i] < 87.0 { tau[i] } else { 87.0 },
    );
    // Adding 1.5·2²³ rounds to an integer, which then stands in the low bits.
    let shifted: [f32; N] = each(
        #[inline(always)]
        |i| clamped[i].mul_add(-std::f32::consts::LOG2_E, 12_582_912.0),
    );
    let whole: [f32; N] = each(
        #[inline(always)]
        |i| shifted[i] - 12_582_912.0,
    );
    // x = −τ − whole·ln 2 in two parts, so that the rounding of τ·log₂e does not count.
    let x: [f32; N] = each(
        #[inline(always)]
        |i| whole[i].mul_add(2.121_944_4e-4, whole[i].mul_add(-0.693_359_4, -clamped[i])),
    );
    // Taylor terms to x⁶/720: |x| ≤ 0.347 leaves 1.2e-7. q = e^x − 1 keeps thin cells to their last digit.
    let q: [f32; N] = each(
        #[inline(always)]
        |i| {
            let x = x[i];
            let p = 1.388_888_9e-3_f32;
            let p = p.mul_add(x, 8.333_334e-3);
            let p = p.mul_add(x, 4.166_666_6e-2);
            let p = p.mul_add(x, 0.166_666_67);
            let p = p.mul_add(x, 0.5);
            p.mul_add(x * x, x)
        },
    );
    let scale: [f32; N] = each(
        #[inline(always)]
        |i| f32::from_bits(shifted[i].to_bits().wrapping_shl(23).wrapping_add(0x3f80_0000)),
    );
    let through = each(
        #[inline(always)]
        |i| if tau[i] < 87.0 { scale[i].mul_add(q[i], scale[i]) } else { 0.0 },
    );
    let stopped = each(
        #[inline(always)]
        |i| if tau[i] < 87.0 { (-scale[i]).mul_add(q[i], 1.0 - scale[i]) } else { 1.0 },
    );
    (through, stopped)
}

#[inline(always)]
fn each<const N: usize>(f: impl Fn(usize) -> f32) -> [f32; N] {
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = f(i);
    }
    out
}

/// Runs work with the widest vectors of this machine. What is to be compiled for them must be inlined into the closure,
/// which `#[inline(always)]` before it asks for.
#[inline(always)]
pub(super) fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    /// Calls the closure itself: a closure that is handed to `dispatch` goes through a shim that is not inlined.
    struct Run<F>(F);
    impl<R, F: FnOnce() -> R> pulp::NullaryFnOnce for Run<F> {
        type Output = R;
        #[inline(always)]
        fn call(self) -> R {
            (self.0)()
        }
    }
    pulp::Arch::new().dispatch(Run(work))
}

/// The nearest f32.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is what is asked for")]
pub(super) fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_parts_keep_their_stated_error() {
        let mut worst = [0.0_f64; 2];
        for i in 0..870_000 {
            let tau = narrow(f64::from(i) * 1e-4);
            let (through, stopped) = split(tau);
            let want = (-f64::from(tau)).exp();
            worst[0] = worst[0].max((f64::from(through) / want - 1.0).abs());
            if i > 0 {
                let want = -(-f64::from(tau)).exp_m1();
                worst[1] = worst[1].max((f64::from(stopped) / want - 1.0).abs());
            }
        }
        assert!(worst[0] < 3e-7 && worst[1] < 5e-7, "{worst:?}");
        for tau in [1e-45_f32, 1e-38, 1e-20, 1e-8, 1e-3] {
            let stopped = split(tau).1;
            assert!((f64::from(stopped) / -(-f64::from(tau)).exp_m1() - 1.0).abs() < 3e-7, "{tau} {stopped}");
        }
        for tau in [87.4, 103.3, 1e6, f32::INFINITY] {
            assert_eq!(split(tau), (0.0, 1.0));
        }
        assert_eq!(split(0.0), (1.0, 0.0));
    }

    #[test]
    fn lanes_and_the_single_group_agree_to_the_bit() {
        let lanes = <[Wide; 1]>::splat(3.7);
        let (through, stopped) = lanes.split(0.41);
        let (one, rest) = One::splat(3.7).split(0.41);
        for g in 0..16 {
            assert_eq!((through.get(g), stopped.get(g)), (one.get(0), rest.get(0)));
        }
        assert!((lanes.sum() - 16.0 * 3.7).abs() < 1e-5);
        assert_eq!(lanes.minus(<[Wide; 1]>::splat(1.7)), <[Wide; 1]>::splat(3.7 - 1.7));
    }
}
