//! Sums over the series: efficiencies, mean cosine, backscatter, and how much rounding is magnified in them.

use super::climb::Order;
use super::factors::Factor;
use super::vector::{Complexes, Vector};
use pulp::Simd;

/// What is done with the coefficients of each order in turn. A trait and not a closure: it must be inlined where
/// the vectors are switched on.
pub(super) trait Sink<T> {
    fn take(&mut self, factor: Factor, order: Order<T>);
}

/// Sums over the series of one sphere.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    /// Σ (2n+1) (|a|² + |b|²).
    pub(super) scattered: f64,
    /// Σ (2n+1) (Re a − |a|² + Re b − |b|²).
    pub(super) absorbed: f64,
    /// g x² Q_sca / 4.
    pub(super) forward: f64,
    /// |Σ (−1)^n (2n+1) (a − b)|².
    pub(super) back: f64,
    /// How much roundings of M are magnified in the efficiencies and in the mean cosine, by the worst order; about 1
    /// for most spheres, 0 where nobody watches.
    pub(super) strain: f64,
}

/// The sums while they grow.
pub(super) struct Adding<S: Simd, const FUSED: bool, const WATCH: bool> {
    on: Vector<S, FUSED>,
    scattered: S::f64s,
    absorbed: S::f64s,
    forward: S::f64s,
    back: Complexes<S::f64s>,
    below: (Complexes<S::f64s>, Complexes<S::f64s>),
    scattered_shift: S::f64s,
    kept_shift: S::f64s,
    forward_shift: S::f64s,
    /// Square of the largest term that may cancel in `forward`.
    forward_size: S::f64s,
    scattered_below: S::f64s,
}

impl<S: Simd, const FUSED: bool, const WATCH: bool> Adding<S, FUSED, WATCH> {
    #[inline(always)]
    pub(super) fn new(on: Vector<S, FUSED>) -> Self {
        let nothing = on.all(0.0);
        let zero = Complexes { re: nothing, im: nothing };
        Self {
            on,
            scattered: nothing,
            absorbed: nothing,
            forward: nothing,
            back: zero,
            below: (zero, zero),
            scattered_shift: nothing,
            kept_shift: nothing,
            forward_shift: nothing,
            forward_size: nothing,
            scattered_below: nothing,
        }
    }

    #[inline(always)]
    pub(super) fn finish(self, sums: &mut [Sums]) {
        let on = self.on;
        let scattered = on.store(self.scattered);
        let absorbed = on.store(self.absorbed);
        let forward = on.store(self.forward);
        let back = on.store(self.back.norm_sqr(on));
        let forward_size = on.store(self.forward_size);
        let shifts = [self.scattered_shift, self.kept_shift, self.forward_shift];
        let shifts = [on.store(shifts[0]), on.store(shifts[1]), on.store(shifts[2])];
        for (i, sums) in sums.iter_mut().enumerate() {
            *sums = Sums {
                scattered: scattered[i],
                absorbed: absorbed[i],
                forward: forward[i],
                back: back[i],
                strain: if WATCH {
                    let of =
                        |square: f64, sum: f64| if square > 0.0 { square.sqrt() / sum.abs() } else { 0.0 };
                    of(shifts[0][i], scattered[i])
                        .max(of(shifts[1][i], absorbed[i]))
                        .max(of(shifts[2][i], forward[i]))
                        .max(of(forward_size[i], forward[i]))
                } else {
                    0.0
                },
            };
        }
    }
}

impl<S: Simd, const FUSED: bool, const WATCH: bool> Sink<S::f64s> for Adding<S, FUSED, WATCH> {
    #[inline(always)]
    fn take(&mut self, factor: Factor, order: Order<S::f64s>) {
        let on = self.on;
        let odd = on.all(factor.odd);
        self.scattered = on.mul_add(order.scattered, odd, self.scattered);
        self.absorbed = on.sub_mul(self.absorbed, order.kept, odd);
        // (n−1)(n+1)/n Re(a_{n−1} a_n* + b_{n−1} b_n*) + (2n+1)/(n(n+1)) Re(a_n b_n*).
        if WATCH {
            let square = on.mul(odd, odd);
            let along = on.all(factor.along);
            let across = on.all(factor.across);
            let steps = on.mul(self.scattered_below, on.mul(along, along));
            let forward_shift = on.mul(order.shift, steps);
            let forward_size =
                on.larger(on.mul(order.scattered, steps), on.mul(order.product, on.mul(across, across)));
            self.forward_size = on.larger(self.forward_size, forward_size);
            self.scattered_shift = on.larger(self.scattered_shift, on.mul(order.scattered_shift, square));
            self.kept_shift = on.larger(self.kept_shift, on.mul(order.kept_shift, square));
            self.forward_shift = on.larger(self.forward_shift, forward_shift);
            self.scattered_below = order.scattered;
        }
        let (a, b) = (order.a, order.b);
        let pair = on.mul_add(a.re, b.re, on.mul(a.im, b.im));
        let steps = on.mul_add(self.below.0.re, a.re, on.mul(self.below.0.im, a.im));
        let others = on.mul_add(self.below.1.re, b.re, on.mul(self.below.1.im, b.im));
        let steps = on.add(steps, others);
        self.forward = on.mul_add(pair, on.all(factor.across), self.forward);
        self.forward = on.mul_add(steps, on.all(factor.along), self.forward);
        let alternating = on.all(factor.alternating);
        self.back.re = on.mul_add(on.sub(a.re, b.re), alternating, self.back.re);
        self.back.im = on.mul_add(on.sub(a.im, b.im), alternating, self.back.im);
        self.below = (a, b);
    }
}
