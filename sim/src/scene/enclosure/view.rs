//! View factors between the walls of a box, in closed form.
//!
//! J. R. Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-11 (identical, parallel, directly opposed
//! rectangles) and C-14 (rectangles with a common edge at 90°), written so that nothing cancels in their logarithms.

use crate::tracer::chamber::SIDES;
use std::f64::consts::PI;

/// View factor between two rectangles `a` × `b` opposite each other at a distance `c` (C-11).
///
/// Absolute error below 1e-14 for sides from 1e-3 to 1e3 times the distance; dimensionless, in [0, 1].
pub fn opposite(a: f64, b: f64, c: f64) -> f64 {
    let (x, y) = (a / c, b / c);
    let (rx, ry) = (1.0_f64.hypot(x), 1.0_f64.hypot(y));
    // (1 + x²)(1 + y²) / (1 + x² + y²) = 1 + x²y² / (1 + x² + y²).
    let log = 0.5 * (x * y / 1.0_f64.hypot(x).hypot(y)).powi(2).ln_1p();
    let arcs = x * ry * (x / ry).atan() + y * rx * (y / rx).atan() - x * x.atan() - y * y.atan();
    (2.0 / (PI * x * y) * (log + arcs)).clamp(0.0, 1.0)
}

/// View factor from a rectangle of width `w` to one of height `h` at a right angle, both along a common edge of length
/// `l` (C-14).
///
/// Absolute error below 1e-14 for sides from 1e-3 to 1e3 times the edge; dimensionless, in [0, 1].
pub fn adjacent(w: f64, h: f64, l: f64) -> f64 {
    let (w, h) = (w / l, h / l);
    let (w2, h2) = (w * w, h * h);
    let both = w2 + h2;
    let r = w.hypot(h);
    // The three logarithms of the catalogue as ln(1 + …).
    let logs = (w2 * h2 / (1.0 + both)).ln_1p()
        + w2 * (-h2 / ((1.0 + w2) * both)).ln_1p()
        + h2 * (-w2 / ((1.0 + h2) * both)).ln_1p();
    let arcs = w * (1.0 / w).atan() + h * (1.0 / h).atan() - r * (1.0 / r).atan();
    ((arcs + 0.25 * logs) / (PI * w)).clamp(0.0, 1.0)
}

/// Exchange areas of the walls of a box: area × view factor in m², `[from][to]` in the order of
/// [`crate::tracer::chamber::SIDE_NAMES`].
///
/// Symmetric; every row sums to the area of its wall within a few rounding errors. `size` are the edges in metres.
pub fn exchange_areas(size: [f64; 3]) -> [[f64; SIDES]; SIDES] {
    // By pairs of axes: between a wall across the one and a wall across the other.
    let mut between = [[0.0; 3]; 3];
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let common = 3 - a - b;
        // The wall across a stretches along b, and the other way round.
        let exchange = size[common] * size[b] * adjacent(size[b], size[a], size[common]);
        between[a][b] = exchange;
        between[b][a] = exchange;
    }
    for (axis, row) in between.iter_mut().enumerate() {
        let [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
        // What is left for the opposite wall agrees with C-11 but for rounding, and closes the row.
        row[axis] = (size[b] * size[c] - 2.0 * (row[b] + row[c])).max(0.0);
    }
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 0.0 } else { between[i / 2][j / 2] }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_squares_have_the_published_factors() {
        // Howell C-11 and C-14, also Siegel and Howell, Thermal Radiation Heat Transfer, tables of squares: six digits.
        assert!((opposite(1.0, 1.0, 1.0) - 0.199_825).abs() < 5e-7, "{}", opposite(1.0, 1.0, 1.0));
        assert!((adjacent(1.0, 1.0, 1.0) - 0.200_044).abs() < 5e-7, "{}", adjacent(1.0, 1.0, 1.0));
    }

    /// ∫∫ cos cos / (π r²) over both areas by the midpoint rule, extrapolated.
    fn double_area(pair: impl Fn([f64; 4]) -> f64, n: usize) -> f64 {
        let at = |i: usize| (i as f64 + 0.5) / n as f64;
        let mut sum = 0.0;
        for i in 0..n {
            for j in 0..n {
                for k in 0..n {
                    for l in 0..n {
                        sum += pair([at(i), at(j), at(k), at(l)]);
                    }
                }
            }
        }
        sum / (n as f64).powi(4)
    }

    #[test]
    fn oblong_rectangles_have_the_factors_of_their_double_integrals() {
        let (a, b, c) = (0.7, 1.9, 1.3);
        let parallel = |u: [f64; 4]| {
            let r2 = (a * (u[0] - u[2])).powi(2) + (b * (u[1] - u[3])).powi(2) + c * c;
            a * b * c * c / (PI * r2 * r2)
        };
        // The midpoint rule errs by a multiple of h²: one step of Richardson leaves h⁴.
        let [coarse, fine] = [12, 24].map(|n| double_area(parallel, n));
        let integral = fine + (fine - coarse) / 3.0;
        assert!((opposite(a, b, c) - integral).abs() < 2e-6, "{} {integral}", opposite(a, b, c));
        let (w, h, l) = (0.7, 1.9, 1.3);
        let perpendicular = |u: [f64; 4]| {
            let (x, z) = (w * u[0], h * u[2]);
            let r2 = x * x + z * z + (l * (u[1] - u[3])).powi(2);
            l * h * x * z / (PI * r2 * r2)
        };
        // At the common edge the integrand is as 1/r²: first order in h.
        let [coarse, fine] = [16, 32].map(|n| double_area(perpendicular, n));
        let integral = 2.0 * fine - coarse;
        assert!((adjacent(w, h, l) - integral).abs() < 1e-3, "{} {integral}", adjacent(w, h, l));
    }

    #[test]
    fn rows_close_reciprocity_holds_and_both_catalogue_entries_agree() {
        for size in [[1.0; 3], [0.7, 1.9, 1.3], [1.0, 1e-3, 5.0], [1e3, 1.0, 1.0], [0.1, 0.12, 100.0]] {
            let exchange = exchange_areas(size);
            for (i, row) in exchange.iter().enumerate() {
                let [b, c] = [size[(i / 2 + 1) % 3], size[(i / 2 + 2) % 3]];
                let closure: f64 = row.iter().sum::<f64>() / (b * c) - 1.0;
                assert!(closure.abs() < 1e-12, "{size:?} {i}: {closure}");
                for (j, &g) in row.iter().enumerate() {
                    assert!(g >= 0.0 && (g - exchange[j][i]).abs() <= f64::EPSILON * g);
                }
                let factor = opposite(b, c, size[i / 2]);
                let closed = row[i ^ 1] / (b * c);
                assert!((factor - closed).abs() < 1e-11, "{size:?} {i}: {factor} {closed}");
            }
        }
    }

    #[test]
    fn limits_of_long_and_flat_boxes() {
        // Plates close together see each other only; far apart as A / (π c²).
        assert!((opposite(1.0, 1.0, 1e-6) - 1.0).abs() < 1e-5);
        assert!((opposite(1.0, 1.0, 1e3) * PI * 1e6 - 1.0).abs() < 1e-3);
        // Two long strips at a right angle: Hottel's crossed strings, (1 + h/w − √(1 + h²/w²)) / 2.
        let strings = 0.5 * (1.0 + 2.0 - 5.0_f64.sqrt());
        assert!((adjacent(1.0, 2.0, 1e5) - strings).abs() < 1e-4, "{}", adjacent(1.0, 2.0, 1e5));
    }
}
