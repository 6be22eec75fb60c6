//! Gauss–Legendre quadrature.

/// Nodes in (−1, 1), ascending, and weights; exact for polynomials up to degree 2·count − 1.
///
/// Nodes by Newton's method on the Legendre recurrence in O(count²); both are within a few rounding errors.
pub fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    assert!(count > 0, "a quadrature needs at least one node");
    let mut rule = vec![(0.0, 2.0); count];
    let size = count as f64;
    for i in 0..count.div_ceil(2) {
        let mut node = ((i as f64 + 0.75) / (size + 0.5) * std::f64::consts::PI).cos();
        if 2 * i + 1 == count {
            node = 0.0;
        }
        let mut slope = 1.0;
        // Newton converges from Tricomi's first guess in at most five steps; the last one polishes.
        for _ in 0..8 {
            let (value, derivative) = legendre(count, node);
            slope = derivative;
            let step = value / derivative;
            node -= step;
            if step.abs() <= 1e-16 {
                break;
            }
        }
        let weight = 2.0 / ((1.0 - node) * (1.0 + node) * slope * slope);
        rule[count - 1 - i] = (node, weight);
        rule[i] = (-node, weight);
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
