//! Gauss–Legendre quadrature, and an adaptive Gauss–Kronrod rule for functions of which nothing is known.

use std::f64::consts::PI;

/// Nodes in (−1, 1), ascending, and weights; exact for polynomials up to degree 2·count − 1.
///
/// Nodes by Newton's method on the Legendre recurrence in O(count²); both are within a few rounding errors.
pub fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    gauss_legendre_unit(count).into_iter().map(|(t, weight)| (2.0 * t - 1.0, 2.0 * weight)).collect()
}

/// [`gauss_legendre`] on (0, 1): nodes near 0 keep their relative accuracy, for integrands with a peak there.
pub fn gauss_legendre_unit(count: usize) -> Vec<(f64, f64)> {
    assert!(count > 0, "a quadrature needs at least one node");
    let mut rule = vec![(0.5, 1.0); count];
    let size = count as f64;
    for i in 0..count.div_ceil(2) {
        let mut node = ((i as f64 + 0.75) / (size + 0.5) * PI).cos();
        if 2 * i + 1 == count {
            node = 0.0;
        }
        let (mut slope, mut step) = (1.0, 0.0);
        // Newton converges from Tricomi's first guess in at most five steps; the last one is the distance from the
        // rounded node to the root.
        for round in 0..8 {
            let (value, derivative) = legendre(count, node);
            slope = derivative;
            step = value / derivative;
            if round == 7 || step.abs() < 1.1e-16 * node {
                break;
            }
            node -= step;
        }
        // Distance of the root from 1, and P′ at the root from P″ = 2x P′/(1 − x²): the rounding of a node close to
        // 1 would cost digits of both.
        let from_end = (1.0 - node) + step;
        let slope = slope * (1.0 - 2.0 * node * step / ((1.0 - node) * (1.0 + node)));
        let weight = 1.0 / (from_end * (2.0 - from_end) * slope * slope);
        rule[i] = (0.5 * from_end, weight);
        rule[count - 1 - i] = (1.0 - 0.5 * from_end, weight);
    }
    rule
}

/// P_n and its derivative at `x` inside (−1, 1).
fn legendre(n: usize, x: f64) -> (f64, f64) {
    let (mut below, mut here) = (1.0, x);
    for l in 1..n {
        let l = l as f64;
        let above = ((2.0 * l + 1.0) * x * here - l * below) / (l + 1.0);
        below = here;
        here = above;
    }
    let n = n as f64;
    (here, n * (x * here - below) / ((x - 1.0) * (x + 1.0)))
}

/// What [`adaptive`] found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Adaptive {
    /// The integral.
    pub value: f64,
    /// Estimate of its absolute error; an upper one for smooth functions. Infinite when a value was not finite.
    pub error: f64,
    /// Number of times the function was evaluated.
    pub evaluations: usize,
}

/// Most pieces that [`adaptive`] cuts an interval into.
const PIECES_MAX: usize = 2000;

/// ∫ f over [from, to] by bisection of the piece with the largest error, 21-point Gauss–Kronrod on each, until the
/// estimated error is below `relative` of the integral (or of rounding), or there are 2000 pieces.
///
/// Deterministic; never fails: the caller judges `error`. Kinks cost pieces, so cut there.
pub fn adaptive(f: impl Fn(f64) -> f64, from: f64, to: f64, relative: f64) -> Adaptive {
    let mut pieces = vec![kronrod(&f, from, to)];
    let mut evaluations = 21;
    loop {
        let value: f64 = pieces.iter().map(|p| p.value).sum();
        let error: f64 = pieces.iter().map(|p| p.error).sum();
        let size: f64 = pieces.iter().map(|p| p.size).sum();
        let enough = (relative * value.abs()).max(8.0 * f64::EPSILON * size);
        let error = if value.is_finite() && error.is_finite() { error } else { f64::INFINITY };
        if error <= enough || pieces.len() >= PIECES_MAX {
            return Adaptive { value, error: error.max(4.0 * f64::EPSILON * size), evaluations };
        }
        let worst = (1..pieces.len()).fold(0, |worst, i| {
            if pieces[i].error > pieces[worst].error || pieces[i].error.is_nan() { i } else { worst }
        });
        let Piece { from, to, .. } = pieces.swap_remove(worst);
        let middle = 0.5 * (from + to);
        pieces.push(kronrod(&f, from, middle));
        pieces.push(kronrod(&f, middle, to));
        evaluations += 42;
    }
}

struct Piece {
    from: f64,
    to: f64,
    value: f64,
    error: f64,
    /// ∫ |f|: what rounding is measured against.
    size: f64,
}

/// Node in [0, 1], Kronrod's weight, and Gauss's weight (0 where Gauss has no node): QUADPACK's dqk21 (R. Piessens et
/// al. 1983).
const KRONROD: [(f64, f64, f64); 11] = [
    (0.995_657_163_025_808_1, 0.011_694_638_867_371_874, 0.0),
    (0.973_906_528_517_171_7, 0.032_558_162_307_964_725, 0.066_671_344_308_688_14),
    (0.930_157_491_355_708_2, 0.054_755_896_574_351_995, 0.0),
    (0.865_063_366_688_984_5, 0.075_039_674_810_919_96, 0.149_451_349_150_580_6),
    (0.780_817_726_586_416_9, 0.093_125_454_583_697_6, 0.0),
    (0.679_409_568_299_024_4, 0.109_387_158_802_297_64, 0.219_086_362_515_982_04),
    (0.562_757_134_668_604_7, 0.123_491_976_262_065_84, 0.0),
    (0.433_395_394_129_247_2, 0.134_709_217_311_473_34, 0.269_266_719_309_996_35),
    (0.294_392_862_701_460_2, 0.142_775_938_577_060_09, 0.0),
    (0.148_874_338_981_631_22, 0.147_739_104_901_338_5, 0.295_524_224_714_752_87),
    (0.0, 0.149_445_554_002_916_9, 0.0),
];

fn kronrod(f: &impl Fn(f64) -> f64, from: f64, to: f64) -> Piece {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let (mut fine, mut coarse, mut size) = (0.0, 0.0, 0.0);
    for (node, weight, gauss) in KRONROD {
        let (low, high) = (f(middle - half * node), f(middle + half * node));
        let share = if node > 0.0 { 1.0 } else { 0.5 };
        fine += share * weight * (low + high);
        coarse += share * gauss * (low + high);
        size += share * weight * (low.abs() + high.abs());
    }
    // The difference is the error of the coarser rule: far above that of the finer one.
    Piece { from, to, value: fine * half, error: ((fine - coarse) * half).abs(), size: (size * half).abs() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn n_nodes_integrate_degree_2n_minus_1() {
        for count in [1usize, 2, 5, 16, 101] {
            let rule = gauss_legendre(count);
            for power in [0usize, 1, count, 2 * count - 2, 2 * count - 1] {
                let sum: f64 = rule.iter().map(|&(x, w)| w * x.powf(power as f64)).sum();
                let exact = if power % 2 == 0 { 2.0 / (power as f64 + 1.0) } else { 0.0 };
                assert!((sum - exact).abs() < 1e-14, "{count} nodes, x^{power}: {sum} against {exact}");
            }
        }
    }

    #[test]
    fn kronrods_rule_is_exact_to_degree_31_and_gauss_inside_it_to_19() {
        for power in 0..=31 {
            let exact = if power % 2 == 0 { 2.0 / (f64::from(power) + 1.0) } else { 0.0 };
            let found = kronrod(&|x: f64| x.powi(power), -1.0, 1.0);
            assert!((found.value - exact).abs() < 2e-15, "x^{power}: {}", found.value);
            assert!(power > 19 || found.error < 2e-15, "x^{power}: {}", found.error);
        }
        // The first even power that Gauss's ten nodes miss.
        assert!(kronrod(&|x: f64| x.powi(20), -1.0, 1.0).error > 1e-7);
    }

    #[test]
    fn the_adaptive_rule_states_an_error_that_holds() {
        // A peak of width 1e-3, a kink, a root at the end; closed forms.
        let peak = adaptive(|x| 1e-3 / (x * x + 1e-6), -1.0, 2.0, 1e-12);
        let kink = adaptive(|x: f64| (x - 0.3).abs(), 0.0, 1.0, 1e-10);
        let root = adaptive(f64::sqrt, 0.0, 1.0, 1e-10);
        for (found, exact) in
            [(peak, 2e3f64.atan() + 1e3f64.atan()), (kink, 0.5 * (0.09 + 0.49)), (root, 2.0 / 3.0)]
        {
            assert!((found.value - exact).abs() <= found.error, "{found:?} {exact}");
            assert!(found.error <= 1e-10 * exact && found.evaluations < 5000, "{found:?}");
        }
        assert!(adaptive(|_| f64::NAN, 0.0, 1.0, 1e-6).error.is_infinite());
        assert_eq!(adaptive(|x| x, 1.0, 1.0, 1e-6).value.to_bits(), 0);
    }
}
