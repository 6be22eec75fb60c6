//! Vectors of this machine with the few operations that a series needs.
//!
//! A product and a sum are one operation (rounded once) where the machine has it, and two where it would be a slow
//! library call: the bits are those of one CPU feature level. One sphere alone takes the same operations as many.

use pulp::Simd;

/// Most spheres, or angles, of one batch: all lanes of all its vectors.
pub(super) const BATCH: usize = 16;

/// Vectors in memory, each from the start of a cache line.
#[derive(Debug, Default)]
pub(super) struct Lines {
    numbers: Vec<f64>,
    /// Numbers before the first line.
    before: usize,
}

impl Lines {
    /// Makes room for so many numbers, all 0; false where there was room enough.
    pub(super) fn reach(&mut self, count: usize) -> bool {
        /// Numbers of a cache line.
        const LINE: usize = 8;
        if self.numbers.len() >= count + LINE {
            return false;
        }
        self.numbers = vec![0.0; count + LINE];
        // An address that cannot be aligned (nothing says that it always can) starts where it is.
        self.before =
            Some(self.numbers.as_ptr().align_offset(64)).filter(|before| *before < LINE).unwrap_or(0);
        true
    }

    /// Numbers there is room for.
    pub(super) fn len(&self) -> usize {
        self.numbers.len()
    }

    #[inline(always)]
    pub(super) fn vectors<S: Simd>(&mut self) -> &mut [S::f64s] {
        S::as_mut_simd_f64s(self.numbers.get_mut(self.before..).unwrap_or_default()).0
    }

    #[inline(always)]
    pub(super) fn read<S: Simd>(&self) -> &[S::f64s] {
        S::as_simd_f64s(self.numbers.get(self.before..).unwrap_or_default()).0
    }
}

/// Operations on `S::f64s`; `FUSED` says that the machine multiplies and adds in one operation.
#[derive(Clone, Copy)]
pub(super) struct Vector<S: Simd, const FUSED: bool>(pub(super) S);

impl<S: Simd, const FUSED: bool> Vector<S, FUSED> {
    #[inline(always)]
    pub(super) fn all(self, value: f64) -> S::f64s {
        self.0.splat_f64s(value)
    }

    /// From the first numbers of an array.
    #[inline(always)]
    pub(super) fn load(self, numbers: &[f64; BATCH]) -> S::f64s {
        S::as_simd_f64s(numbers).0[0]
    }

    /// The first numbers of an array, zeros beyond.
    #[inline(always)]
    pub(super) fn store(self, vector: S::f64s) -> [f64; BATCH] {
        let mut numbers = [0.0; BATCH];
        S::as_mut_simd_f64s(&mut numbers).0[0] = vector;
        numbers
    }

    #[inline(always)]
    pub(super) fn add(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.add_f64s(a, b)
    }

    #[inline(always)]
    pub(super) fn sub(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.sub_f64s(a, b)
    }

    #[inline(always)]
    pub(super) fn mul(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.mul_f64s(a, b)
    }

    #[inline(always)]
    pub(super) fn div(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.div_f64s(a, b)
    }

    #[inline(always)]
    pub(super) fn neg(self, a: S::f64s) -> S::f64s {
        self.0.neg_f64s(a)
    }

    /// a b + c.
    #[inline(always)]
    pub(super) fn mul_add(self, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
        if FUSED { self.0.mul_add_f64s(a, b, c) } else { self.add(self.mul(a, b), c) }
    }

    /// a b − c.
    #[inline(always)]
    pub(super) fn mul_sub(self, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
        if FUSED { self.0.mul_add_f64s(a, b, self.neg(c)) } else { self.sub(self.mul(a, b), c) }
    }

    /// c − a b.
    #[inline(always)]
    pub(super) fn sub_mul(self, c: S::f64s, a: S::f64s, b: S::f64s) -> S::f64s {
        if FUSED { self.0.mul_add_f64s(self.neg(a), b, c) } else { self.sub(c, self.mul(a, b)) }
    }

    /// `a` where `mask`, else `b`.
    #[inline(always)]
    pub(super) fn select(self, mask: S::m64s, a: S::f64s, b: S::f64s) -> S::f64s {
        self.0.select_f64s(mask, a, b)
    }

    /// The larger of the two; `a` where `b` is no number.
    #[inline(always)]
    pub(super) fn larger(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.select(self.at_most(a, b), b, a)
    }

    /// a ≤ b.
    #[inline(always)]
    pub(super) fn at_most(self, a: S::f64s, b: S::f64s) -> S::m64s {
        self.0.less_than_or_equal_f64s(a, b)
    }
}

/// Complex numbers side by side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Complexes<T> {
    pub(super) re: T,
    pub(super) im: T,
}

impl<T: Copy> Complexes<T> {
    #[inline(always)]
    pub(super) fn scaled<S: Simd<f64s = T>, const FUSED: bool>(
        self,
        on: Vector<S, FUSED>,
        factor: T,
    ) -> Self {
        Self { re: on.mul(self.re, factor), im: on.mul(self.im, factor) }
    }

    #[inline(always)]
    pub(super) fn times<S: Simd<f64s = T>, const FUSED: bool>(
        self,
        on: Vector<S, FUSED>,
        other: Self,
    ) -> Self {
        Self {
            re: on.mul_sub(self.re, other.re, on.mul(self.im, other.im)),
            im: on.mul_add(self.re, other.im, on.mul(self.im, other.re)),
        }
    }

    #[inline(always)]
    pub(super) fn plus<S: Simd<f64s = T>, const FUSED: bool>(
        self,
        on: Vector<S, FUSED>,
        other: Self,
    ) -> Self {
        Self { re: on.add(self.re, other.re), im: on.add(self.im, other.im) }
    }

    #[inline(always)]
    pub(super) fn conj<S: Simd<f64s = T>, const FUSED: bool>(self, on: Vector<S, FUSED>) -> Self {
        Self { re: self.re, im: on.neg(self.im) }
    }

    #[inline(always)]
    pub(super) fn norm_sqr<S: Simd<f64s = T>, const FUSED: bool>(self, on: Vector<S, FUSED>) -> T {
        on.mul_add(self.re, self.re, on.mul(self.im, self.im))
    }

    /// `self` where `mask`, else `other`.
    #[inline(always)]
    pub(super) fn or<S: Simd<f64s = T>, const FUSED: bool>(
        self,
        on: Vector<S, FUSED>,
        mask: S::m64s,
        other: Self,
    ) -> Self {
        Self { re: on.select(mask, self.re, other.re), im: on.select(mask, self.im, other.im) }
    }

    /// 1 − z.
    #[inline(always)]
    pub(super) fn one_minus<S: Simd<f64s = T>, const FUSED: bool>(self, on: Vector<S, FUSED>) -> Self {
        Self { re: on.sub(on.all(1.0), self.re), im: on.neg(self.im) }
    }
}
