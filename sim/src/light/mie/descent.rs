//! The way down: ratios of neighbouring Riccati–Bessel functions, from beyond |m| x to order 0.

use super::spheres::Spheres;
use super::vector::{Complexes, Vector};
use pulp::Simd;

/// r_n(x), r_n(z) of one order.
#[derive(Clone, Copy)]
pub(super) struct Ratios<T> {
    pub(super) outside: T,
    pub(super) inside: Complexes<T>,
}

impl<T: Copy> Ratios<T> {
    /// From three numbers in their order.
    #[inline(always)]
    pub(super) fn of(row: &[T]) -> Self {
        Self { outside: row[0], inside: Complexes { re: row[1], im: row[2] } }
    }
}

/// The way down: ratios and their difference at one order.
#[derive(Clone, Copy)]
pub(super) struct Descent<S: Simd> {
    x_inverse: S::f64s,
    z_inverse: Complexes<S::f64s>,
    /// (1 − m)/(m x).
    contrast: Complexes<S::f64s>,
    start: S::f64s,
    ratios: Ratios<S::f64s>,
    difference: Complexes<S::f64s>,
}

impl<S: Simd> Descent<S> {
    #[inline(always)]
    pub(super) fn new<const FUSED: bool>(on: Vector<S, FUSED>, spheres: &Spheres<S>) -> Self {
        let z_inverse = spheres.m_inverse.scaled(on, spheres.x_inverse);
        let one_less_m = spheres.m.one_minus(on);
        let odd = on.mul_add(spheres.start, on.all(2.0), on.all(3.0));
        let first = on.div(spheres.x, odd);
        Self {
            x_inverse: spheres.x_inverse,
            z_inverse,
            contrast: one_less_m.times(on, z_inverse),
            start: spheres.start,
            ratios: Ratios { outside: first, inside: spheres.m.scaled(on, first) },
            difference: one_less_m.scaled(on, first),
        }
    }

    /// Writes what stands here to a place of the workspace.
    #[inline(always)]
    pub(super) fn keep<const NEAR: bool>(
        &self,
        at: usize,
        ratios: &mut [S::f64s],
        differences: &mut [S::f64s],
    ) {
        let row = &mut ratios[3 * at..][..3];
        row[0] = self.ratios.outside;
        row[1] = self.ratios.inside.re;
        row[2] = self.ratios.inside.im;
        if NEAR {
            let row = &mut differences[2 * at..][..2];
            row[0] = self.difference.re;
            row[1] = self.difference.im;
        }
    }

    /// From order n to n − 1. `WAITING`: only where the recurrence has begun.
    #[inline(always)]
    pub(super) fn step<const FUSED: bool, const NEAR: bool, const WAITING: bool>(
        self,
        on: Vector<S, FUSED>,
        n: usize,
    ) -> Self {
        let odd = on.all(2.0 * n as f64 + 1.0);
        let Ratios { outside, inside } = self.ratios;
        let t = on.mul_sub(odd, self.x_inverse, outside);
        let z = Complexes {
            re: on.mul_sub(odd, self.z_inverse.re, inside.re),
            im: on.mul_sub(odd, self.z_inverse.im, inside.im),
        };
        let square = z.norm_sqr(on);
        let one = on.all(1.0);
        let (below, next) = if NEAR {
            // The difference gathers the roundings of every step: as few as possible.
            (on.div(one, t), z.conj(on).scaled(on, on.div(one, square)))
        } else {
            // One division for both reciprocals.
            let inverse = on.div(one, on.mul(t, square));
            (on.mul(square, inverse), z.conj(on).scaled(on, t).scaled(on, inverse))
        };
        let mut ratios = Ratios { outside: below, inside: next };
        let mut difference = self.difference;
        if NEAR {
            let sum = Complexes {
                re: on.mul_add(odd, self.contrast.re, difference.re),
                im: on.mul_add(odd, self.contrast.im, difference.im),
            };
            difference = sum.times(on, next.scaled(on, below));
        }
        if WAITING {
            let begun = on.at_most(on.all(n as f64), self.start);
            ratios.outside = on.select(begun, ratios.outside, outside);
            ratios.inside = ratios.inside.or(on, begun, inside);
            difference = difference.or(on, begun, self.difference);
        }
        Self { ratios, difference, ..self }
    }
}
