//! Efficiencies of one sphere and of many: sums over the Mie series, spheres of similar size side by side.

use super::climb::Order;
use super::factors::Factor;
use super::kernel::{Batch, Workspace};
use super::lengths::{Lane, SIZE_MIN};
use super::precise::Precise;
use super::sums::{Sink, Sums};
use super::vector::BATCH;
use super::{Efficiencies, MieError, Sphere};
use pulp::{Scalar, Simd};

/// Indices closer to 1 than this take the recurrence of the difference; beyond it its subtraction costs one digit.
const NEAR: f64 = 0.1;

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
    Ok(pulp::Arch::new().dispatch(One(sphere)))
}

/// [`efficiencies`] of many spheres in any order, bit for bit what each has alone. Batches of similar size are
/// computed side by side: about four times as fast.
///
/// # Errors
///
/// The index of the first bad sphere and what is wrong with it.
pub fn efficiencies_of_many(spheres: &[Sphere]) -> Result<Vec<Efficiencies>, (usize, MieError)> {
    for (index, sphere) in spheres.iter().enumerate() {
        sphere.checked().map_err(|error| (index, error))?;
    }
    let mut answers = vec![Efficiencies::default(); spheres.len()];
    pulp::Arch::new()
        .dispatch(Many::<false>(spheres, &mut |at, sphere, sums| answers[at] = finished(sphere, sums)));
    Ok(answers)
}

/// [`efficiencies_of_many`] without loss on narrow resonances: spheres whose sums would lose more than a digit to
/// cancellation are computed again in twice the precision (about thirty times slower; |m| x up to 1e6).
///
/// There the relative error stays below 1e-12 for condition numbers |d ln q/d ln x| up to 1e12, x, n and k taken as
/// exact. Weakly absorbing spheres have lines of any narrowness; those that a grid of sizes meets by chance are rare,
/// so the time is that of [`efficiencies_of_many`] nearly always. Also returns how many were computed again.
///
/// # Errors
///
/// As [`efficiencies_of_many`].
pub fn efficiencies_refined(spheres: &[Sphere]) -> Result<(Vec<Efficiencies>, usize), (usize, MieError)> {
    for (index, sphere) in spheres.iter().enumerate() {
        sphere.checked().map_err(|error| (index, error))?;
    }
    let mut answers = vec![Efficiencies::default(); spheres.len()];
    let mut again = 0;
    pulp::Arch::new().dispatch(Many::<true>(spheres, &mut |at, sphere, sums| {
        answers[at] = if strained(&sphere, &sums) {
            again += 1;
            finished(sphere, Precise::new(sphere).sums)
        } else {
            finished(sphere, sums)
        };
    }));
    Ok((answers, again))
}

/// Magnification of roundings from which twice the precision is worth it.
const STRAIN: f64 = 20.0;

/// Whether the sums have lost digits that twice the precision would give back.
fn strained(sphere: &Sphere, sums: &Sums) -> bool {
    sums.strain > STRAIN && affordable(sphere)
}

/// Whether twice the precision takes seconds at most.
fn affordable(sphere: &Sphere) -> bool {
    /// Largest |m| x.
    const INSIDE: f64 = 1e6;
    sphere.size_parameter * sphere.n.hypot(sphere.k).max(1.0) <= INSIDE
}

/// Whether the index is so close to 1 that differences need care.
#[inline(always)]
pub(super) fn near(sphere: &Sphere) -> bool {
    let (n, k) = (sphere.n - 1.0, sphere.k);
    n * n + k * k < NEAR * NEAR
}

/// Whether the machine multiplies and adds in one operation wherever it has vectors of this width.
pub(super) const fn fused<S: Simd>() -> bool {
    S::F64_LANES >= 4
}

struct One(Sphere);

impl pulp::WithSimd for One {
    type Output = Efficiencies;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Efficiencies {
        let sums = if fused::<S>() { alone::<true, false>(self.0) } else { alone::<false, false>(self.0) };
        finished(self.0, sums)
    }
}

#[inline(always)]
fn alone<const FUSED: bool, const WATCH: bool>(sphere: Sphere) -> Sums {
    let batch = Batch::<Scalar, FUSED, 1>::new(Scalar, &[Lane::new(sphere)]);
    let mut workspace = Workspace::default();
    let mut sums = [Sums::default()];
    if near(&sphere) {
        batch.sums::<true, WATCH>(&mut workspace, &mut sums);
    } else {
        batch.sums::<false, WATCH>(&mut workspace, &mut sums);
    }
    sums[0]
}

/// Checked spheres, to be computed with the vectors of this machine, and what takes the sums of each. A struct and
/// not a closure, so that all of it is inlined where those vectors are switched on.
struct Many<'a, const WATCH: bool>(&'a [Sphere], &'a mut dyn FnMut(usize, Sphere, Sums));

impl<const WATCH: bool> pulp::WithSimd for Many<'_, WATCH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => batches::<S, true, 2, WATCH>(simd, self.0, self.1),
            4 => batches::<S, true, 4, WATCH>(simd, self.0, self.1),
            2 => batches::<S, false, 4, WATCH>(simd, self.0, self.1),
            _ => batches::<S, false, 1, WATCH>(simd, self.0, self.1),
        }
    }
}

#[inline(always)]
fn batches<S: Simd, const FUSED: bool, const V: usize, const WATCH: bool>(
    simd: S,
    spheres: &[Sphere],
    take: &mut dyn FnMut(usize, Sphere, Sums),
) {
    let width = V * S::F64_LANES;
    let mut workspace = Workspace::default();
    let mut lanes = [Lane::new(Sphere { size_parameter: 0.0, n: 1.5, k: 0.0 }); BATCH];
    let mut sums = [Sums::default(); BATCH];
    let order = by_size(spheres);
    let close = order.partition_point(|&at| near(&spheres[at as usize]));
    for (places, is_near) in [(&order[..close], true), (&order[close..], false)] {
        for chunk in places.chunks(width) {
            for (i, lane) in lanes[..width].iter_mut().enumerate() {
                // A batch that is not full repeats its first sphere.
                *lane = Lane::new(spheres[chunk[if i < chunk.len() { i } else { 0 }] as usize]);
            }
            let batch = Batch::<S, FUSED, V>::new(simd, &lanes[..width]);
            if is_near {
                batch.sums::<true, WATCH>(&mut workspace, &mut sums[..width]);
            } else {
                batch.sums::<false, WATCH>(&mut workspace, &mut sums[..width]);
            }
            for (&at, (lane, sums)) in chunk.iter().zip(lanes.iter().zip(&sums)) {
                take(at as usize, lane.sphere, *sums);
            }
        }
    }
}

/// Places of the spheres, those with an index near 1 first, then by size in sixteen classes to an octave: a counting
/// sort.
pub(super) fn by_size(spheres: &[Sphere]) -> Vec<u32> {
    /// Classes of size: 16 to an octave, from 2⁻⁶⁴ to 2³².
    const CLASSES: usize = 96 * 16;
    let class = |sphere: &Sphere| {
        // Exponent and four bits of the mantissa of a number that is not negative.
        let bits = (sphere.size_parameter.to_bits() >> 48) as usize;
        let class = bits.saturating_sub((1023 - 64) * 16).min(CLASSES - 1);
        if near(sphere) { class } else { class + CLASSES }
    };
    let mut places = vec![0u32; 2 * CLASSES + 1];
    for sphere in spheres {
        places[class(sphere) + 1] += 1;
    }
    for i in 1..places.len() {
        places[i] += places[i - 1];
    }
    let mut order = vec![0u32; spheres.len()];
    for (at, sphere) in (0u32..).zip(spheres) {
        let place = &mut places[class(sphere)];
        order[*place as usize] = at;
        *place += 1;
    }
    order
}

/// Efficiencies from the sums.
#[inline(always)]
fn finished(sphere: Sphere, sums: Sums) -> Efficiencies {
    if (sums.scattered + sums.absorbed + sums.forward + sums.back).is_finite() {
        scaled(sphere, sums)
    } else {
        // A denominator that is exactly 0 (x on a zero of ψ to the last bit): never seen, but not impossible.
        scaled(sphere, Precise::new(sphere).sums)
    }
}

#[inline(always)]
fn scaled(sphere: Sphere, sums: Sums) -> Efficiencies {
    let x = sphere.size_parameter.max(SIZE_MIN);
    let per_area = 2.0 / (x * x);
    let mut q = Efficiencies {
        q_ext: 0.0,
        q_sca: per_area * sums.scattered,
        q_abs: if sphere.k > 0.0 { per_area * sums.absorbed } else { 0.0 },
        q_back: 0.5 * per_area * sums.back,
        asymmetry: if sums.scattered > 0.0 { 2.0 * sums.forward / sums.scattered } else { 0.0 },
    };
    if sphere.size_parameter < SIZE_MIN {
        let shrink = sphere.size_parameter / SIZE_MIN;
        let square = shrink * shrink;
        q.q_sca *= square * square;
        q.q_back *= square * square;
        q.q_abs *= shrink;
        q.asymmetry *= square;
    }
    q.q_ext = q.q_sca + q.q_abs;
    q
}

/// Re a_n, Im a_n, Re b_n, Im b_n of one sphere for n = 1 … N, each times (2n+1)/(n(n+1)); empty when x = 0. In twice
/// the precision where roundings would be magnified in the amplitudes.
pub(super) fn terms(sphere: Sphere) -> Vec<[f64; 4]> {
    let list = pulp::Arch::new().dispatch(Terms(sphere));
    if list.strain() > STRAIN && affordable(&sphere) { Precise::new(sphere).terms } else { list.terms }
}

struct Terms(Sphere);

impl pulp::WithSimd for Terms {
    type Output = List;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> List {
        if fused::<S>() { listed::<true>(self.0) } else { listed::<false>(self.0) }
    }
}

#[inline(always)]
fn listed<const FUSED: bool>(sphere: Sphere) -> List {
    let batch = Batch::<Scalar, FUSED, 1>::new(Scalar, &[Lane::new(sphere)]);
    let mut workspace = Workspace::default();
    let mut list = List { terms: Vec::with_capacity(batch.orders()), forward: 0.0, shift: 0.0 };
    if near(&sphere) {
        batch.descend::<true>(&mut workspace);
        batch.climb::<true>(&workspace, 0, &mut list);
    } else {
        batch.descend::<false>(&mut workspace);
        batch.climb::<false>(&workspace, 0, &mut list);
    }
    list
}

/// Terms of the amplitudes.
struct List {
    terms: Vec<[f64; 4]>,
    /// Σ (2n+1) (Re a + Re b): twice the forward amplitude.
    forward: f64,
    /// The largest ((2n+1) shift)² of an order.
    shift: f64,
}

impl List {
    /// How much roundings are magnified in the amplitudes, by the worst order.
    fn strain(&self) -> f64 {
        // A pattern that is no number is computed again, too.
        if self.shift <= 0.0 { 0.0 } else { self.shift.sqrt() / self.forward.abs().max(f64::MIN_POSITIVE) }
    }
}

impl Sink<f64> for List {
    #[inline(always)]
    fn take(&mut self, factor: Factor, order: Order<f64>) {
        let w = factor.across;
        self.terms.push([order.a.re * w, order.a.im * w, order.b.re * w, order.b.im * w]);
        self.forward += factor.odd * (order.a.re + order.b.re);
        self.shift = self.shift.max(order.shift * (factor.odd * factor.odd));
    }
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
    fn resonances_keep_twelve_digits_when_refined() {
        let rows = reference();
        let spheres: Vec<Sphere> = rows.iter().map(|row| row.0).collect();
        let (answers, again) = efficiencies_refined(&spheres).unwrap();
        let mut worst = 0.0f64;
        for ((sphere, wanted, id), found) in rows.iter().zip(answers) {
            for (column, ((wanted, condition), found)) in wanted.iter().zip(in_order(found)).enumerate() {
                if column == 3 || *wanted == 0.0 {
                    continue;
                }
                let error = (found / wanted - 1.0).abs();
                // Rounding grows with the number of orders; what strains less than 20-fold stays with the fast kernel.
                let allowed = 2.2e-16 * (64.0 + 8.0 * condition.min(50.0) + sphere.size_parameter);
                worst = worst.max(error / allowed);
                assert!(error <= allowed, "{id} column {column}: {error:e} with condition {condition:e}");
            }
        }
        println!("worst {worst:.3} of the bound, {again} computed again");
        assert!(again > 0);
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
