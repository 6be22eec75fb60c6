//! Gauss–Legendre quadrature.

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
        let mut node = ((i as f64 + 0.75) / (size + 0.5) * std::f64::consts::PI).cos();
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
}
