//! Angular functions at vectors of angles, and the amplitudes that grow from them order by order.
//!
//! Every angle comes with its mirror image θ → π − θ: π_n(−μ) = (−1)^{n+1} π_n(μ), τ_n(−μ) = (−1)^n τ_n(μ), so that
//! the sums of the even and of the odd parts give both.

use super::factors::Factor;
use super::vector::{BATCH, Vector};
use pulp::Simd;

/// π_n and τ_n at one vector of angles with μ ≥ 0, order by order from 1.
///
/// By their differences (after Reinsch): with v = 1 − μ and d_n = (π_{n+1} − π_n)/(n + 1),
/// d_n = d_{n−1} − (2n+1)/(n(n+1)) v π_n, π_{n+1} = π_n + (n+1) d_n, τ_n = n(n+1) d_{n−1} − π_n − n v π_n: near the
/// axis nothing cancels.
#[derive(Clone, Copy)]
pub(super) struct Angles<S: Simd> {
    versine: S::f64s,
    pi: S::f64s,
    difference: S::f64s,
}

impl<S: Simd> Angles<S> {
    /// At 1 − μ in [0, 1].
    #[inline(always)]
    pub(super) fn new<const FUSED: bool>(on: Vector<S, FUSED>, versine: S::f64s) -> Self {
        Self { versine, pi: on.all(1.0), difference: on.all(1.0) }
    }

    /// π_n and τ_n of the order that `factor` belongs to.
    #[inline(always)]
    pub(super) fn step<const FUSED: bool>(
        &mut self,
        on: Vector<S, FUSED>,
        factor: Factor,
    ) -> (S::f64s, S::f64s) {
        let pi = self.pi;
        let t = on.mul(self.versine, pi);
        let low = on.mul_add(t, on.all(factor.order), pi);
        let tau = on.mul_sub(self.difference, on.all(factor.product), low);
        self.difference = on.sub_mul(self.difference, t, on.all(factor.across));
        self.pi = on.mul_add(self.difference, on.all(factor.above), pi);
        (pi, tau)
    }
}

/// Coefficients of one order of one sphere in all lanes.
pub(super) struct Coefficients<S: Simd> {
    a: [S::f64s; 2],
    b: [S::f64s; 2],
}

impl<S: Simd> Coefficients<S> {
    /// From Re a, Im a, Re b, Im b.
    #[inline(always)]
    pub(super) fn of<const FUSED: bool>(on: Vector<S, FUSED>, [a_re, a_im, b_re, b_im]: [f64; 4]) -> Self {
        Self { a: [on.all(a_re), on.all(a_im)], b: [on.all(b_re), on.all(b_im)] }
    }
}

/// S₁ = U₁ ± V₁ and S₂ = U₂ ± V₂ at one vector of pairs of angles ±μ.
#[derive(Clone, Copy)]
pub(super) struct Amplitudes<S: Simd> {
    pub(super) u1: [S::f64s; 2],
    pub(super) v1: [S::f64s; 2],
    pub(super) u2: [S::f64s; 2],
    pub(super) v2: [S::f64s; 2],
}

impl<S: Simd> Amplitudes<S> {
    #[inline(always)]
    pub(super) fn nothing<const FUSED: bool>(on: Vector<S, FUSED>) -> Self {
        let zero = [on.all(0.0); 2];
        Self { u1: zero, v1: zero, u2: zero, v2: zero }
    }

    /// With one odd order more: π is even, τ odd.
    #[inline(always)]
    pub(super) fn with_odd<const FUSED: bool>(
        self,
        on: Vector<S, FUSED>,
        factors: &Coefficients<S>,
        pi: S::f64s,
        tau: S::f64s,
    ) -> Self {
        Self {
            u1: added(on, self.u1, factors.a, pi),
            v1: added(on, self.v1, factors.b, tau),
            u2: added(on, self.u2, factors.b, pi),
            v2: added(on, self.v2, factors.a, tau),
        }
    }

    /// With one even order more: π is odd, τ even.
    #[inline(always)]
    pub(super) fn with_even<const FUSED: bool>(
        self,
        on: Vector<S, FUSED>,
        factors: &Coefficients<S>,
        pi: S::f64s,
        tau: S::f64s,
    ) -> Self {
        Self {
            u1: added(on, self.u1, factors.b, tau),
            v1: added(on, self.v1, factors.a, pi),
            u2: added(on, self.u2, factors.a, tau),
            v2: added(on, self.v2, factors.b, pi),
        }
    }

    /// Re S₁, Im S₁, Re S₂, Im S₂ at μ and at −μ.
    #[inline(always)]
    pub(super) fn both<const FUSED: bool>(self, on: Vector<S, FUSED>) -> [[[f64; BATCH]; 4]; 2] {
        let Self { u1, v1, u2, v2 } = self;
        [
            [
                on.store(on.add(u1[0], v1[0])),
                on.store(on.add(u1[1], v1[1])),
                on.store(on.add(u2[0], v2[0])),
                on.store(on.add(u2[1], v2[1])),
            ],
            [
                on.store(on.sub(u1[0], v1[0])),
                on.store(on.sub(u1[1], v1[1])),
                on.store(on.sub(u2[0], v2[0])),
                on.store(on.sub(u2[1], v2[1])),
            ],
        ]
    }

    /// The even and the odd part of |S₁|² + |S₂|².
    #[inline(always)]
    pub(super) fn square<const FUSED: bool>(self, on: Vector<S, FUSED>) -> [S::f64s; 2] {
        let Self { u1, v1, u2, v2 } = self;
        let mut even = on.mul(u1[0], u1[0]);
        for part in [u1[1], v1[0], v1[1], u2[0], u2[1], v2[0], v2[1]] {
            even = on.mul_add(part, part, even);
        }
        let odd = on.mul_add(u1[0], v1[0], on.mul(u1[1], v1[1]));
        let odd = on.mul_add(u2[0], v2[0], on.mul_add(u2[1], v2[1], odd));
        [even, on.add(odd, odd)]
    }
}

/// sum + factor · value, re and im.
#[inline(always)]
fn added<const FUSED: bool, S: Simd>(
    on: Vector<S, FUSED>,
    sum: [S::f64s; 2],
    factor: [S::f64s; 2],
    value: S::f64s,
) -> [S::f64s; 2] {
    [on.mul_add(factor[0], value, sum[0]), on.mul_add(factor[1], value, sum[1])]
}
