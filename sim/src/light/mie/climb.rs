//! The way up: coefficients a_n, b_n from the ratios, order by order.

use super::descent::Ratios;
use super::factors::Factor;
use super::spheres::Spheres;
use super::trig::sine_cosine;
use super::vector::{Complexes, Vector};
use pulp::Simd;

/// Coefficients of one order.
#[derive(Clone, Copy)]
pub(super) struct Order<T> {
    pub(super) a: Complexes<T>,
    pub(super) b: Complexes<T>,
    /// |a|² + |b|².
    pub(super) scattered: T,
    /// |a|² |b|².
    pub(super) product: T,
    /// |a|² − Re a + |b|² − Re b.
    pub(super) kept: T,
    /// A rounding of M moves a coefficient by χ_{n+1}/|N − iM| of itself: the square of what it moves `scattered` by …
    pub(super) scattered_shift: T,
    /// … and `kept` …
    pub(super) kept_shift: T,
    /// … and the coefficients themselves.
    pub(super) shift: T,
}

/// The way up: ψ_n, χ_n, χ_{n−1}, and what stays the same.
pub(super) struct Climb<S: Simd> {
    x_inverse: S::f64s,
    m: Complexes<S::f64s>,
    /// 1/|m|².
    square_inverse: S::f64s,
    one_less_m: Complexes<S::f64s>,
    /// (m − 1)/m.
    shrink: Complexes<S::f64s>,
    /// (1 − m)(1 + m)/(m² x).
    pub(super) step: Complexes<S::f64s>,
    /// First order that is not there.
    beyond: S::f64s,
    pub(super) psi: S::f64s,
    chi: S::f64s,
    chi_below: S::f64s,
}

impl<S: Simd> Climb<S> {
    /// Stands below order 1; `outside` is r_0(x).
    #[inline(always)]
    pub(super) fn new<const FUSED: bool>(
        on: Vector<S, FUSED>,
        spheres: &Spheres<S>,
        outside: S::f64s,
    ) -> Self {
        let Spheres { x, x_inverse, m, m_inverse, square_inverse, last, .. } = *spheres;
        let one = on.all(1.0);
        let one_less_m = m.one_minus(on);
        let one_more_m = Complexes { re: on.add(one, m.re), im: m.im };
        let step = one_less_m.times(on, one_more_m).times(on, m_inverse).times(on, m_inverse);
        let step = Complexes {
            re: step.re,
            // Im(1/m²) = −2nk/|m|⁴ by itself: beside a real part of about −1 it would lose digits for large k.
            im: on.mul(on.mul(on.mul(m.re, square_inverse), on.mul(m.im, square_inverse)), on.all(-2.0)),
        };
        let (sine, cosine) = sine_cosine(on, x);
        // ψ₁ from the larger of ψ₀ and ψ₁, so that a zero of one of them does no harm; below x = 1 it is ψ₀.
        let direct = on.mul_sub(sine, x_inverse, cosine);
        let upward = on.mul(sine, outside);
        let larger = on.at_most(on.mul(direct, direct), on.mul(sine, sine));
        Self {
            x_inverse,
            m,
            square_inverse,
            one_less_m,
            shrink: Complexes { re: on.neg(one_less_m.re), im: m.im }.times(on, m_inverse),
            step: step.scaled(on, x_inverse),
            beyond: on.add(last, one),
            psi: on.select(on.at_most(x, one), upward, on.select(larger, upward, direct)),
            chi: on.mul_add(cosine, x_inverse, sine),
            chi_below: cosine,
        }
    }

    /// Coefficients of order `n`, to be asked for in order from 1. `ENDING`: zeros where the series has ended.
    #[inline(always)]
    pub(super) fn step<const FUSED: bool, const NEAR: bool, const ENDING: bool>(
        &mut self,
        on: Vector<S, FUSED>,
        factor: Factor,
        ratios: Ratios<S::f64s>,
        difference: Complexes<S::f64s>,
    ) -> Order<S::f64s> {
        let Ratios { outside, inside } = ratios;
        let Self { m, psi, chi, .. } = *self;
        let chi_above = on.mul_sub(on.mul(on.all(factor.odd), self.x_inverse), chi, self.chi_below);
        let psi_above = on.mul(outside, psi);
        let rise = self.step.scaled(on, on.all(factor.above));
        // The four products of m r_n(z) are those of r_n(z)/m = m* r_n(z)/|m|² too.
        let (straight, turned) = (inside.scaled(on, m.re), inside.scaled(on, m.im));
        let u_a = Complexes {
            re: on.sub_mul(rise.re, on.add(straight.re, turned.im), self.square_inverse),
            im: on.sub_mul(rise.im, on.sub(straight.im, turned.re), self.square_inverse),
        };
        let u_b =
            Complexes { re: on.sub(turned.im, straight.re), im: on.neg(on.add(straight.im, turned.re)) };
        let (top_a, top_b) = if NEAR {
            // Every part of these is of the order of m − 1, which is lost where parts of u are added.
            let rising = Complexes { re: on.add(rise.re, difference.re), im: on.add(rise.im, difference.im) };
            let top_a = rising.plus(on, self.shrink.times(on, inside));
            let top_b = difference.plus(on, self.one_less_m.times(on, inside));
            (top_a.scaled(on, psi), top_b.scaled(on, psi))
        } else {
            let top = |u: Complexes<S::f64s>| Complexes {
                re: on.mul_add(psi, u.re, psi_above),
                im: on.mul(psi, u.im),
            };
            (top(u_a), top(u_b))
        };
        let half_a = Half::new(on, top_a, u_a, chi, chi_above);
        let half_b = Half::new(on, top_b, u_b, chi, chi_above);
        let mut inverse = on.div(on.all(1.0), on.mul(half_a.bottom, half_b.bottom));
        self.psi = psi_above;
        if ENDING {
            let going = on.at_most(on.all(factor.above), self.beyond);
            inverse = on.select(going, inverse, on.all(0.0));
            // What has ended stands still: it would overflow.
            self.chi = on.select(going, chi_above, chi);
            self.chi_below = on.select(going, chi, self.chi_below);
        } else {
            self.chi = chi_above;
            self.chi_below = chi;
        }
        let (inverse_a, inverse_b) = (on.mul(inverse, half_b.bottom), on.mul(inverse, half_a.bottom));
        let (scattered_a, scattered_b) =
            (on.mul(half_a.top_square, inverse_a), on.mul(half_b.top_square, inverse_b));
        let (kept_a, kept_b) = (on.mul(u_a.im, inverse_a), on.mul(u_b.im, inverse_b));
        let (a_re, b_re) = (on.sub(scattered_a, kept_a), on.sub(scattered_b, kept_b));
        // Squares of χ_{n+1}/|N − iM|; dropped by the compiler where nobody looks.
        let chi_square = on.mul(chi_above, chi_above);
        let (weak_a, weak_b) = (on.mul(chi_square, inverse_a), on.mul(chi_square, inverse_b));
        let weighed = |a, b| on.mul_add(on.mul(a, a), weak_a, on.mul(on.mul(b, b), weak_b));
        Order {
            a: Complexes { re: a_re, im: on.mul(half_a.cross, inverse_a) },
            b: Complexes { re: b_re, im: on.mul(half_b.cross, inverse_b) },
            scattered: on.add(scattered_a, scattered_b),
            product: on.mul(scattered_a, scattered_b),
            kept: on.add(kept_a, kept_b),
            scattered_shift: weighed(scattered_a, scattered_b),
            kept_shift: weighed(kept_a, kept_b),
            shift: on.mul_add(scattered_a, weak_a, on.mul(scattered_b, weak_b)),
        }
    }
}

/// What a coefficient is made of: N/(N − iM).
struct Half<T> {
    /// |N|².
    top_square: T,
    /// |N − iM|².
    bottom: T,
    /// Im(N conj(N − iM)).
    cross: T,
}

impl<T: Copy> Half<T> {
    #[inline(always)]
    fn new<S: Simd<f64s = T>, const FUSED: bool>(
        on: Vector<S, FUSED>,
        top: Complexes<T>,
        u: Complexes<T>,
        chi: T,
        chi_above: T,
    ) -> Self {
        let other_re = on.mul_add(chi, u.re, chi_above);
        let other_im = on.mul(chi, u.im);
        let top_square = top.norm_sqr(on);
        let other_square = on.mul_add(other_re, other_re, on.mul(other_im, other_im));
        Self {
            top_square,
            bottom: on.add(on.sub(top_square, on.add(u.im, u.im)), other_square),
            cross: on.mul_add(top.re, other_re, on.mul(top.im, other_im)),
        }
    }
}
