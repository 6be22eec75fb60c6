//! The Mie series: coefficients a_n, b_n of `L` spheres at once, and the sums over them.
//!
//! Three things keep every digit (notation: ψ_n, χ_n Riccati–Bessel functions, r_n(z) = ψ_{n+1}(z)/ψ_n(z), z = m x):
//!
//! 1. r_n by downward recurrence, r_{n−1} = 1/((2n+1)/z − r_n), for both arguments. It maps the upper half-plane
//!    into itself, so Im r keeps its relative accuracy however weak the absorption.
//! 2. D_n = r_n(x) − r_n(z) by its own recurrence, D_{n−1} = ((2n+1)(1−m)/(m x) + D_n) r_{n−1}(x) r_{n−1}(z), a sum
//!    of equal signs: the numerators of a_n and b_n survive m → 1.
//! 3. Absorption from the Wronskian: Re a − |a|² = −Im(u)/|denominator|², so that Q_ext = Q_sca + Q_abs is a sum of
//!    positive terms and no cross-section is ever a difference.
//!
//! Ratios instead of logarithmic derivatives: Du, Appl. Opt. 43, 1951 (2004); length of the series after Wiscombe,
//! Appl. Opt. 19, 1505 (1980), longer here: his N costs 1e-9 in Q_ext of absorbing spheres.

use super::lanes::{Cplx, Real};
use super::{Efficiencies, MieError, Sphere};
use crate::light::complex::Complex;
use std::array::from_fn;

/// Spheres per vector step: two AVX-512 or four SSE2 registers; 4 is bound by latency, 16 spills.
const LANES: usize = 8;
/// Below this size the leading terms are scaled from here: their corrections are of the order x².
const SIZE_MIN: f64 = 1e-30;
/// Added to denominators that may be exactly 0 (real arguments at a zero of ψ): far below their rounding.
const NOT_ZERO: f64 = 1e-40;

/// Efficiencies and mean cosine of one sphere.
///
/// Relative error below 2.2e-16 · (64 + 8·c + x), c = |d ln q / d ln x|, for x in 1e-10 … 1e6, n in 0.01 … 100,
/// k in 0 … 100 (against a multiprecision table). All zero for x = 0 and for m = 1. Work and memory grow as
/// max(x, |m| x).
///
/// ```
/// // Bohren and Huffman (1983), appendix A: a radius of 0.525 µm at 0.6328 µm (x = 5.21282), m = 1.55.
/// let x = std::f64::consts::TAU * 0.525 / 0.6328;
/// let q = ditd_sim::light::mie::efficiencies(x, 1.55, 0.0)?;
/// assert!((q.q_ext - 3.10543).abs() < 5e-6);
/// # Ok::<(), ditd_sim::light::mie::MieError>(())
/// ```
///
/// # Errors
///
/// [`MieError::Size`], [`MieError::Index`], [`MieError::TooLarge`] as their messages say.
pub fn efficiencies(size_parameter: f64, n: f64, k: f64) -> Result<Efficiencies, MieError> {
    let sphere = Sphere { size_parameter, n, k }.checked()?;
    let [answer] = sums([sphere], &mut Vec::new());
    Ok(answer)
}

/// [`efficiencies`] of many spheres, several at a time. Fastest when neighbours have similar sizes.
///
/// # Errors
///
/// The index of the first bad sphere and what is wrong with it.
pub fn efficiencies_of_many(spheres: &[Sphere]) -> Result<Vec<Efficiencies>, (usize, MieError)> {
    for (index, sphere) in spheres.iter().enumerate() {
        sphere.checked().map_err(|error| (index, error))?;
    }
    Ok(pulp::Arch::new().dispatch(Many(spheres)))
}

/// Checked spheres, to be computed with the vectors of this machine. A struct and not a closure, so that all of it
/// is inlined where those vectors are switched on. No fused operations: the bits are those of one sphere alone.
struct Many<'a>(&'a [Sphere]);

impl pulp::WithSimd for Many<'_> {
    type Output = Vec<Efficiencies>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Self::Output {
        let mut answers = Vec::with_capacity(self.0.len());
        let mut ratios = Vec::new();
        for chunk in self.0.chunks(LANES) {
            let mut lanes = [chunk[0]; LANES];
            lanes[..chunk.len()].copy_from_slice(chunk);
            let found = sums(lanes, &mut ratios);
            answers.extend_from_slice(&found[..chunk.len()]);
        }
        answers
    }
}

/// Coefficients a_n and b_n of one sphere for n = 1 … N, empty when x = 0.
pub(super) fn coefficients(sphere: Sphere) -> Vec<(Complex, Complex)> {
    let spheres = Spheres::new([sphere]);
    let mut answer = Vec::with_capacity(spheres.orders);
    let mut ratios = Vec::new();
    let mut climb = spheres.climb(&mut ratios);
    for (n, ratios) in ratios.iter().enumerate().skip(1) {
        let order = climb.step(n as f64, *ratios);
        let number = |z: Cplx<1>| Complex::new(z.re.0[0], z.im.0[0]);
        answer.push((number(order.a), number(order.b)));
    }
    answer
}

/// Length of the series: terms beyond it are below the rounding of the sum.
pub(super) fn series_length(size_parameter: f64) -> f64 {
    (size_parameter + 7.4 * size_parameter.cbrt() + 4.0).floor()
}

/// Ratios of neighbouring Riccati–Bessel functions at one order.
#[derive(Debug, Clone, Copy)]
struct Ratios<const L: usize> {
    outside: Real<L>,
    inside: Cplx<L>,
    difference: Cplx<L>,
}

/// The coefficients of one order and the share of absorption of both.
struct Order<const L: usize> {
    a: Cplx<L>,
    b: Cplx<L>,
    /// Re(a) − |a|² + Re(b) − |b|².
    absorbed: Real<L>,
}

/// `L` spheres with the constants of their recurrences.
struct Spheres<const L: usize> {
    x: Real<L>,
    m: Cplx<L>,
    /// Last order of each sphere, 0 when it is absent (x = 0).
    last: Real<L>,
    /// Last order of the longest series.
    orders: usize,
}

impl<const L: usize> Spheres<L> {
    #[inline(always)]
    fn new(spheres: [Sphere; L]) -> Self {
        let x = Real(spheres.map(|sphere| sphere.size_parameter.max(SIZE_MIN)));
        let last = Real(spheres.map(|sphere| {
            if sphere.size_parameter > 0.0 { series_length(sphere.size_parameter) } else { 0.0 }
        }));
        let m = Cplx { re: Real(spheres.map(|s| s.n)), im: Real(spheres.map(|s| s.k)) };
        let longest = last.0.iter().fold(0.0f64, |a, &b| a.max(b));
        Self { x, m, last, orders: integer(longest) }
    }

    /// r_n(x), r_n(z), D_n for n = 0 … `orders`, ascending in n.
    #[inline(always)]
    fn ratios(&self, ratios: &mut Vec<Ratios<L>>) {
        let reach = |x: f64, m: f64| {
            let z = x * m.max(1.0);
            // Past |z| until the start is forgotten, and a little past the last order: for small spheres the
            // recurrence forgets three digits a step there, and the last terms need few.
            (z + 8.0 * z.cbrt() + 8.0).max(self.orders as f64 + 4.0)
        };
        let modulus = self.m.norm_sqr().map(f64::sqrt);
        let start = integer((0..L).fold(0.0f64, |far, i| far.max(reach(self.x.0[i], modulus.0[i]))));
        let one_less_m = Cplx { re: self.m.re.map(|n| 1.0 - n), im: -self.m.im };
        let x_inverse = self.x.map(|x| 1.0 / x);
        let z_inverse = self.m.recip().scale(x_inverse);
        let contrast = one_less_m * z_inverse;
        let first = 1.0 / (2.0 * start as f64 + 3.0);
        let mut here = Ratios {
            outside: self.x * first,
            inside: self.m.scale(self.x * first),
            difference: one_less_m.scale(self.x * first),
        };
        let nothing = Ratios { outside: Real::all(0.0), inside: Cplx::ZERO, difference: Cplx::ZERO };
        // What is left from other spheres is overwritten below.
        ratios.resize(self.orders + 1, nothing);
        for n in (1..=start).rev() {
            let odd = Real::all(2.0 * n as f64 + 1.0);
            let outside = (odd * x_inverse - here.outside + Real::all(NOT_ZERO)).map(|t| 1.0 / t);
            let mut below = z_inverse.scale(odd) - here.inside;
            below.re = below.re + Real::all(NOT_ZERO);
            let inside = below.recip();
            let difference = (contrast.scale(odd) + here.difference) * inside.scale(outside);
            here = Ratios { outside, inside, difference };
            if n <= self.orders + 1 {
                ratios[n - 1] = here;
            }
        }
    }

    /// Fills `ratios` and stands below order 1. Nothing is filled when all spheres are absent.
    #[inline(always)]
    fn climb(&self, ratios: &mut Vec<Ratios<L>>) -> Climb<L> {
        self.ratios(ratios);
        let x_inverse = self.x.map(|x| 1.0 / x);
        let one = Cplx { re: Real::all(1.0), im: Real::all(0.0) };
        let m_inverse = self.m.recip();
        let one_less_m = Cplx { re: self.m.re.map(|n| 1.0 - n), im: -self.m.im };
        // (1 − m)(1 + m)/(m² x), ((m − 1)/m).
        let mut step = one_less_m * (one + self.m) * m_inverse * m_inverse;
        // Im(1/m²) = −2nk/|m|⁴ by itself: beside a real part of about −1 it would lose digits for large k.
        let square = m_inverse.norm_sqr();
        step.im = -(self.m.re * square * (self.m.im * square)) * 2.0;
        let shrink = Cplx { re: -one_less_m.re, im: -one_less_m.im } * m_inverse;

        let (sine, cosine) = (self.x.map(f64::sin), self.x.map(f64::cos));
        let psi_1_direct = sine * x_inverse - cosine;
        // From the larger of ψ₀ and ψ₁, so that a zero of one of them does no harm; below x = 1 it is ψ₀.
        let psi_1_up = sine * ratios[0].outside;
        let mut psi = psi_1_up;
        for i in 0..L {
            if self.x.0[i] >= 1.0 && sine.0[i].abs() < psi_1_direct.0[i].abs() {
                psi.0[i] = psi_1_direct.0[i];
            }
        }
        Climb {
            last: self.last,
            m: self.m,
            m_inverse,
            one_less_m,
            shrink,
            step: step.scale(x_inverse),
            x_inverse,
            psi,
            chi: cosine * x_inverse + sine,
            chi_below: cosine,
        }
    }
}

/// The way up through the orders: ψ_n, χ_n, χ_{n−1}, and what stays the same.
struct Climb<const L: usize> {
    last: Real<L>,
    m: Cplx<L>,
    m_inverse: Cplx<L>,
    one_less_m: Cplx<L>,
    /// (m − 1)/m.
    shrink: Cplx<L>,
    /// (1 − m)(1 + m)/(m² x).
    step: Cplx<L>,
    x_inverse: Real<L>,
    psi: Real<L>,
    chi: Real<L>,
    chi_below: Real<L>,
}

impl<const L: usize> Climb<L> {
    /// Coefficients of order `n`, to be asked for in order from 1. Lanes past their last order hold zeros.
    #[inline(always)]
    fn step(&mut self, n: f64, ratios: Ratios<L>) -> Order<L> {
        let Ratios { outside, inside, difference } = ratios;
        let chi_above = (self.x_inverse * (2.0 * n + 1.0)) * self.chi - self.chi_below;
        let rise = self.step.scale(Real::all(n + 1.0));
        let top_a = (rise + difference + self.shrink * inside).scale(self.psi);
        let top_b = (difference + self.one_less_m * inside).scale(self.psi);
        let u_a = rise - inside * self.m_inverse;
        let u_b = Cplx::ZERO - self.m * inside;
        let (a, absorbed_a) = coefficient(top_a, u_a, self.chi, chi_above);
        let (b, absorbed_b) = coefficient(top_b, u_b, self.chi, chi_above);
        self.psi = outside * self.psi;
        self.chi_below = self.chi;
        self.chi = chi_above;
        Order {
            a: a.up_to(self.last, n),
            b: b.up_to(self.last, n),
            absorbed: (absorbed_a + absorbed_b).up_to(self.last, n),
        }
    }
}

/// N/(N − iM) with M = χ_{n+1} + χ_n u, and its Re(a) − |a|².
#[inline(always)]
fn coefficient<const L: usize>(
    top: Cplx<L>,
    u: Cplx<L>,
    chi: Real<L>,
    chi_above: Real<L>,
) -> (Cplx<L>, Real<L>) {
    let mut other = u.scale(chi);
    other.re = other.re + chi_above;
    let bottom = Cplx { re: top.re + other.im, im: top.im - other.re };
    let inverse = bottom.norm_sqr().map(|square| 1.0 / square);
    ((top * bottom.conj()).scale(inverse), -(u.im * inverse))
}

/// The sums over the series.
#[inline(always)]
fn sums<const L: usize>(lanes: [Sphere; L], ratios: &mut Vec<Ratios<L>>) -> [Efficiencies; L] {
    let spheres = Spheres::new(lanes);
    let nothing = Real::all(0.0);
    let (mut scattered, mut absorbed, mut forward) = (nothing, nothing, nothing);
    let mut back = Cplx::ZERO;
    let mut below = (Cplx::ZERO, Cplx::ZERO);
    let mut sign = 1.0;
    let mut climb = spheres.climb(ratios);
    for (order, ratios) in ratios.iter().enumerate().skip(1) {
        let n = order as f64;
        let odd = 2.0 * n + 1.0;
        let order = climb.step(n, *ratios);
        scattered = scattered + (order.a.norm_sqr() + order.b.norm_sqr()) * odd;
        absorbed = absorbed + order.absorbed * odd;
        // (n−1)(n+1)/n Re(a_{n−1} a_n* + b_{n−1} b_n*) + (2n+1)/(n(n+1)) Re(a_n b_n*).
        forward = forward
            + (below.0.dot(order.a) + below.1.dot(order.b)) * ((n - 1.0) * (n + 1.0) / n)
            + order.a.dot(order.b) * (odd / (n * (n + 1.0)));
        sign = -sign;
        back = back + (order.a - order.b).scale(Real::all(sign * odd));
        below = (order.a, order.b);
    }
    from_fn(|i| {
        let x = spheres.x.0[i];
        let per_area = 2.0 / (x * x);
        let (q_sca, q_abs) = (per_area * scattered.0[i], per_area * absorbed.0[i]);
        let asymmetry = if scattered.0[i] > 0.0 { 2.0 * forward.0[i] / scattered.0[i] } else { 0.0 };
        let q_back = back.norm_sqr().0[i] / (x * x);
        let shrink = (lanes[i].size_parameter / x).min(1.0);
        let (square, fourth) = (shrink * shrink, shrink.powi(4));
        let (q_sca, q_abs) = (q_sca * fourth, if lanes[i].k > 0.0 { q_abs * shrink } else { 0.0 });
        Efficiencies {
            q_ext: q_sca + q_abs,
            q_sca,
            q_abs,
            q_back: q_back * fourth,
            asymmetry: asymmetry * square,
        }
    })
}

/// A number of orders: whole, and at most a few times [`super::SIZE_MAX`].
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "bounded by SIZE_MAX, not negative"
)]
fn integer(count: f64) -> usize {
    count.clamp(0.0, 4.0 * super::SIZE_MAX) as usize
}

#[cfg(test)]
mod tests {
    use super::super::SIZE_MAX;
    use super::*;
    use proptest::prelude::*;

    /// A sphere, its five numbers with their condition numbers, its name.
    type Row = (Sphere, [(f64, f64); 5], String);

    fn reference() -> Vec<Row> {
        let text = include_str!("../../../tests/data/light/mie_efficiencies.csv");
        let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let at = |name: &str| names.iter().position(|own| *own == name).unwrap();
        text.lines()
            .skip(1)
            .map(|line| {
                let fields: Vec<&str> = line.split(',').collect();
                let number = |name: &str| fields[at(name)].parse::<f64>().unwrap();
                let sphere = Sphere { size_parameter: number("x"), n: number("n"), k: number("k") };
                let wanted = ["qext", "qsca", "qabs", "qback", "g"]
                    .map(|name| (number(name), number(&format!("cx_{name}"))));
                (sphere, wanted, format!("{} {}", fields[0], fields[1]))
            })
            .collect()
    }

    fn in_order(q: Efficiencies) -> [f64; 5] {
        [q.q_ext, q.q_sca, q.q_abs, q.q_back, q.asymmetry]
    }

    /// Rows outside the bound, and the worst error in units of it.
    fn judge(find: impl Fn(Sphere) -> Efficiencies) -> (Vec<String>, f64) {
        let mut bad = Vec::new();
        let mut worst = 0.0f64;
        for (sphere, wanted, id) in reference() {
            let found = in_order(find(sphere));
            for (column, ((wanted, condition), found)) in wanted.into_iter().zip(found).enumerate() {
                let mut allowed = 2.2e-16 * (64.0 + 8.0 * condition + sphere.size_parameter) * wanted.abs();
                if column == 3 {
                    // Backscatter is the square of an alternating sum S with |S| = x √q and Σ|terms| ≤ 2x²
                    // (large x): its relative error is that of the terms times 2 Σ|terms| / |S|.
                    allowed *= 1.0 + 4.0 * sphere.size_parameter / wanted.sqrt();
                }
                let error = (found - wanted).abs();
                if allowed > 0.0 {
                    worst = worst.max(error / allowed);
                }
                if error > allowed {
                    bad.push(format!(
                        "{id} column {column}: {found:e} against {wanted:e}, {:.1}",
                        error / allowed
                    ));
                }
            }
        }
        (bad, worst)
    }

    #[test]
    fn every_row_of_the_multiprecision_table_is_met() {
        let (bad, worst) = judge(|s| efficiencies(s.size_parameter, s.n, s.k).unwrap());
        println!("worst {worst:.3} of the bound");
        assert!(bad.is_empty(), "{bad:#?}");
    }

    #[test]
    fn spheres_of_any_sizes_side_by_side_keep_their_accuracy() {
        let rows = reference();
        let spheres: Vec<Sphere> = rows.iter().map(|row| row.0).collect();
        let answers = efficiencies_of_many(&spheres).unwrap();
        let (bad, worst) = judge(|s| answers[spheres.iter().position(|own| *own == s).unwrap()]);
        println!("worst {worst:.3} of the bound");
        assert!(bad.is_empty(), "{bad:#?}");
    }

    #[test]
    fn nothing_there_scatters_nothing() {
        for (x, n, k) in [(0.0, 1.4, 0.1), (3.0, 1.0, 0.0), (1e5, 1.0, 0.0), (0.0, 1.0, 0.0)] {
            assert_eq!(efficiencies(x, n, k).unwrap(), Efficiencies::default());
        }
    }

    #[test]
    fn bad_spheres_are_refused() {
        for x in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(efficiencies(x, 1.4, 0.1), Err(MieError::Size(_))));
        }
        for (n, k) in
            [(0.0, 0.1), (-1.4, 0.1), (1.4, -0.1), (f64::NAN, 0.0), (1.4, f64::NAN), (f64::INFINITY, 0.0)]
        {
            assert!(matches!(efficiencies(1.0, n, k), Err(MieError::Index { .. })), "{n} {k}");
        }
        assert!(matches!(efficiencies(2.0 * SIZE_MAX, 1.4, 0.0), Err(MieError::TooLarge { .. })));
        let spheres =
            [Sphere { size_parameter: 1.0, n: 1.4, k: 0.0 }, Sphere { size_parameter: 1.0, n: 1.4, k: -1.0 }];
        assert_eq!(efficiencies_of_many(&spheres).unwrap_err().0, 1);
    }

    #[test]
    fn tiny_spheres_follow_the_power_laws_down_to_underflow() {
        // Rayleigh: Q_abs ~ x, Q_sca and Q_back ~ x⁴, g ~ x².
        let (near, far) = (efficiencies(1e-25, 1.4, 0.08).unwrap(), efficiencies(1e-50, 1.4, 0.08).unwrap());
        assert!((far.q_abs / near.q_abs / 1e-25 - 1.0).abs() < 1e-13);
        assert!((far.q_sca / near.q_sca / 1e-100 - 1.0).abs() < 1e-13);
        assert!((far.asymmetry / near.asymmetry / 1e-50 - 1.0).abs() < 1e-13);
        assert!(efficiencies(1e-300, 1.4, 0.08).unwrap().q_abs > 0.0);
    }

    #[test]
    fn the_corners_of_the_accepted_range_have_an_answer() {
        for x in [1e-10, 1e-3, 1.0, 1e3] {
            for n in [0.011, 0.9, 1.0, 1.0 + 1e-15, 99.0] {
                for k in [0.0, 1e-300, 1e-14, 1.0, 100.0] {
                    let q = efficiencies(x, n, k).unwrap();
                    let what = format!("{x} {n} {k}: {q:?}");
                    assert!(in_order(q).iter().all(|v| v.is_finite()), "{what}");
                    assert!(q.q_sca >= 0.0 && q.q_abs >= 0.0 && q.q_back >= 0.0, "{what}");
                    assert!(q.asymmetry.abs() <= 1.0, "{what}");
                }
            }
        }
        assert!(efficiencies(1e6, 1.4, 0.08).unwrap().q_ext > 2.0);
    }

    proptest! {
        #[test]
        fn any_sphere_obeys_the_laws(e in -3.0f64..2.5, n in 0.02f64..10.0, f in -12.0f64..1.5) {
            let (x, k) = (10f64.powf(e), 10f64.powf(f));
            let q = efficiencies(x, n, k).unwrap();
            prop_assert_eq!(q.q_ext.to_bits(), (q.q_sca + q.q_abs).to_bits());
            prop_assert!(q.q_sca > 0.0 && q.q_abs > 0.0 && q.asymmetry.abs() < 1.0);
        }
    }
}
