//! The Mie series of one sphere in twice the precision, for narrow resonances.
//!
//! On a whispering-gallery line the denominator of one coefficient is the small difference of large terms; a rounded
//! step of the recurrence shifts the line by as much as a rounded x would, and an efficiency with the condition number
//! c = |d ln q/d ln x| loses c units in the last place. Carried through in twice the precision, x, n and k being taken
//! as exact, the answer has its full digits up to c = 1e14. Formulas as in the fast kernel; the difference recurrence
//! is not needed, since 1e-12 lost near m = 1 leave 19 digits.

use super::Sphere;
use super::double::{Double, DoubleComplex};
use super::lengths::{SIZE_MIN, cube_root, integer, series_length};
use super::sums::Sums;

/// Sums over the series, and its terms: coefficients of n = 1, 2 … as in `series::terms`.
pub(super) struct Precise {
    pub(super) sums: Sums,
    pub(super) terms: Vec<[f64; 4]>,
}

/// One coefficient N/(N − iM) and what it is made of.
struct Coefficient {
    value: DoubleComplex,
    scattered: Double,
    kept: Double,
}

impl Precise {
    pub(super) fn new(sphere: Sphere) -> Self {
        let x_number = sphere.size_parameter.max(SIZE_MIN);
        let x = Double::new(x_number);
        let m = DoubleComplex { re: Double::new(sphere.n), im: Double::new(sphere.k) };
        let orders = integer(series_length(x_number));
        let reach = x_number * sphere.n.hypot(sphere.k).max(1.0);
        // Until a wrong start is forgotten to 32 digits: ψ ~ 1e-16 there.
        let start = integer((reach + 13.0 * cube_root(reach) + 20.0).max(orders as f64 + 8.0));

        let x_inverse = x.recip();
        let m_inverse = m.recip();
        let z_inverse = m_inverse.scaled(x_inverse);
        let first = x / Double::new(2.0 * start as f64 + 3.0);
        let (mut outside, mut inside) = (first, m.scaled(first));
        let mut ratios = vec![(outside, inside); orders + 1];
        for n in (1..=start).rev() {
            let odd = Double::new(2.0 * n as f64 + 1.0);
            outside = (odd * x_inverse - outside).recip();
            inside = (z_inverse.scaled(odd) - inside).recip();
            if n <= orders + 1 {
                ratios[n - 1] = (outside, inside);
            }
        }

        let one = DoubleComplex { re: Double::ONE, im: Double::ZERO };
        let step = (m_inverse * m_inverse - one).scaled(x_inverse);
        let (sine, cosine) = Double::sine_cosine(x_number);
        let direct = sine * x_inverse - cosine;
        let upward = sine * ratios[0].0;
        let from_below = x_number < 1.0 || direct.abs().high <= sine.abs().high;
        let mut psi = if from_below { upward } else { direct };
        let mut chi = cosine * x_inverse + sine;
        let mut chi_below = cosine;
        let mut adding = Adding::default();
        for (n, &(outside, inside)) in ratios.iter().enumerate().skip(1) {
            let order = n as f64;
            let chi_above = Double::new(2.0 * order + 1.0) * x_inverse * chi - chi_below;
            let psi_above = outside * psi;
            let u_a = step.scaled(Double::new(order + 1.0)) - inside * m_inverse;
            let through = m * inside;
            let u_b = DoubleComplex { re: -through.re, im: -through.im };
            let coefficient = |u: DoubleComplex| {
                let top = (psi_above + psi * u.re, psi * u.im);
                let other = (chi_above + chi * u.re, chi * u.im);
                let top_square = top.0.square() + top.1.square();
                let bottom = top_square + other.0.square() + other.1.square() - u.im - u.im;
                let inverse = bottom.recip();
                let (scattered, kept) = (top_square * inverse, u.im * inverse);
                let cross = top.0 * other.0 + top.1 * other.1;
                let value = DoubleComplex { re: scattered - kept, im: cross * inverse };
                Coefficient { value, scattered, kept }
            };
            adding.take(order, coefficient(u_a), coefficient(u_b));
            psi = psi_above;
            chi_below = chi;
            chi = chi_above;
        }
        adding.finish()
    }
}

/// The sums while they grow.
struct Adding {
    scattered: Double,
    kept: Double,
    forward: Double,
    back: DoubleComplex,
    below: (DoubleComplex, DoubleComplex),
    terms: Vec<[f64; 4]>,
}

impl Default for Adding {
    fn default() -> Self {
        let zero = DoubleComplex { re: Double::ZERO, im: Double::ZERO };
        Self {
            scattered: Double::ZERO,
            kept: Double::ZERO,
            forward: Double::ZERO,
            back: zero,
            below: (zero, zero),
            terms: Vec::new(),
        }
    }
}

impl Adding {
    fn take(&mut self, order: f64, a: Coefficient, b: Coefficient) {
        let odd = Double::new(2.0 * order + 1.0);
        self.scattered = self.scattered + (a.scattered + b.scattered) * odd;
        self.kept = self.kept + (a.kept + b.kept) * odd;
        let dot = |p: DoubleComplex, q: DoubleComplex| p.re * q.re + p.im * q.im;
        let (a, b) = (a.value, b.value);
        let steps = dot(self.below.0, a) + dot(self.below.1, b);
        let along = Double::new((order - 1.0) * (order + 1.0)) / Double::new(order);
        let across = odd / Double::new(order * (order + 1.0));
        self.forward = self.forward + steps * along + dot(a, b) * across;
        let difference = (a - b).scaled(odd);
        let sign = if order % 2.0 < 0.5 { Double::ONE } else { -Double::ONE };
        self.back.re = self.back.re + difference.re * sign;
        self.back.im = self.back.im + difference.im * sign;
        self.below = (a, b);
        self.terms.push([a.re, a.im, b.re, b.im].map(|part| (part * across).value()));
    }

    fn finish(self) -> Precise {
        Precise {
            sums: Sums {
                scattered: self.scattered.value(),
                absorbed: -self.kept.value(),
                forward: self.forward.value(),
                back: self.back.norm_sqr().value(),
                strain: 0.0,
            },
            terms: self.terms,
        }
    }
}
