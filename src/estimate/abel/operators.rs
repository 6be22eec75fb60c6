//! The operators of one width: from columns at the radii (i + phase), in pixels, to the local coefficient there.
//!
//! Row i of an operator belongs to radius i. `phase` is 0 for an axis on a pixel and ½ for one between two.

use super::matrix::Matrix;
use std::f64::consts::PI;

/// Radius i.
#[expect(clippy::cast_precision_loss, reason = "numbers of pixels")]
pub(super) fn radius(i: usize, phase: f64) -> f64 {
    i as f64 + phase
}

/// √(a² − b²) without cancellation; zero for b ≥ a.
fn leg(a: f64, b: f64) -> f64 {
    ((a - b) * (a + b)).max(0.0).sqrt()
}

/// Dasch's three-point method: the column is a parabola through three radii about each, its derivative is integrated
/// exactly (C. J. Dasch, Appl. Opt. 31, 1146 (1992), Eqs. 7 and 8 with the sign of I₁ mended; here for any phase).
pub(super) fn three_point(n: usize, phase: f64) -> Matrix {
    let mut d = Matrix::zeros(n, n);
    for i in 0..n {
        let r = radius(i, phase);
        for j in i..=n {
            let y = radius(j, phase);
            let (low, high) = ((y - 0.5).max(r), y + 0.5);
            let (near, far) = (leg(low, r), leg(high, r));
            // On the axis the derivative is zero, and with it the weight of the logarithm, which has a pole there.
            let zeroth = if low > 0.0 { ((high + far) / (low + near)).ln() } else { 0.0 };
            let first = far - near - y * zeroth;
            // p' = (p₊ − p₋)/2 + (y' − y)(p₊ − 2p + p₋), and f = −1/π ∫ p'/√(y'² − r²) dy'.
            let ahead = -(0.5 * zeroth + first) / PI;
            let behind = -(-0.5 * zeroth + first) / PI;
            let mut add = |j: usize, value: f64| {
                if j < n {
                    d.row_mut(i)[j] += value;
                }
            };
            add(j + 1, ahead);
            add(j, 2.0 * first / PI);
            match j {
                // The mirror image of the column beyond the axis.
                0 => add(if phase > 0.0 { 0 } else { 1 }, behind),
                _ => add(j - 1, behind),
            }
        }
    }
    d
}

/// Lengths of the sight at radius i in the rings of half a pixel to both sides of radius j (upper triangular).
pub(super) fn rings(n: usize, phase: f64) -> Matrix {
    Matrix::from_fn(n, n, |i, j| {
        let y = radius(i, phase);
        let inner = (radius(j, phase) - 0.5).max(0.0);
        if j < i { 0.0 } else { 2.0 * (leg(radius(j, phase) + 0.5, y) - leg(inner, y)) }
    })
}

/// Columns at radius i of the hat about radius j: linear between radii, flat inside the first one, zero one pixel beyond the
/// last (K. J. Daun et al., Appl. Opt. 45, 4638 (2006), with linear elements). Upper triangular.
pub(super) fn hats(n: usize, phase: f64) -> Matrix {
    Matrix::from_fn(n, n, |i, j| {
        let y = radius(i, phase);
        if j < i {
            return 0.0;
        }
        let at = radius(j, phase);
        let mut sum = ramp(y, at, at + 1.0, 1.0, 0.0);
        sum += if j == 0 { 2.0 * leg(at, y) } else { ramp(y, at - 1.0, at, 0.0, 1.0) };
        sum
    })
}

/// 2 ∫ f r/√(r² − y²) dr from `low` to `high` for f linear between its values there.
fn ramp(y: f64, low: f64, high: f64, f_low: f64, f_high: f64) -> f64 {
    if y >= high {
        return 0.0;
    }
    let slope = (f_high - f_low) / (high - low);
    let from = low.max(y);
    let (near, far) = (leg(from, y), leg(high, y));
    let logarithm = if y > 0.0 { y * y * ((high + far) / (from + near)).ln() } else { 0.0 };
    // f = f_low + slope (r − low); ∫ r/√ = √, ∫ r²/√ = (r √ + y² ln(r + √))/2.
    2.0 * (f_low - slope * low) * (far - near) + slope * (high * far - from * near + logarithm)
}

/// E. W. Hansen and P.-L. Law's recursion (J. Opt. Soc. Am. A 2, 510 (1985)) with a derivative that is linear between
/// radii, written out as an operator. Their exponentials represent 1/√ to some 1e-3: a check, not a method to keep.
pub(super) fn hansen_law(n: usize, phase: f64) -> Matrix {
    // Their table 1.
    #[expect(clippy::approx_constant, reason = "a fitted weight of theirs, not 1/π")]
    const H: [f64; 9] = [0.318, 0.19, 0.35, 0.82, 1.8, 3.9, 8.3, 19.6, 48.3];
    const LAMBDA: [f64; 9] = [0.0, -2.1, -6.2, -22.4, -92.5, -414.5, -1889.4, -8990.9, -47391.1];
    if n < 3 {
        return rings(n, phase).upper_inverse().expect("rings have a positive diagonal");
    }
    // The derivative as rows over the column.
    let mut derivative = Matrix::zeros(n, n);
    for i in 0..n {
        let row = derivative.row_mut(i);
        if i + 1 == n {
            (row[i], row[i - 1]) = (1.0, -1.0);
        } else if i > 0 {
            (row[i + 1], row[i - 1]) = (0.5, -0.5);
        } else if phase > 0.0 {
            (row[1], row[0]) = (0.5, -0.5);
        }
    }
    let mut out = Matrix::zeros(n, n);
    let mut state = vec![vec![0.0; n]; H.len()];
    for i in (0..n - 1).rev() {
        let (r, outer) = (radius(i, phase), radius(i + 1, phase));
        if r <= 0.0 {
            break;
        }
        let ratio = outer / r;
        for (k, state) in state.iter_mut().enumerate() {
            let lambda = LAMBDA[k];
            // ∫ of the kernel, plain and times the radius.
            let plain = if lambda < 0.0 { (1.0 - ratio.powf(lambda)) / lambda } else { -ratio.ln() };
            let moment = r * (1.0 - ratio.powf(lambda + 1.0)) / (lambda + 1.0);
            let at_outer = H[k] * (moment - plain * r);
            let at_inner = H[k] * (plain * outer - moment);
            let decay = ratio.powf(lambda);
            let (inner_row, outer_row) = (derivative.row(i), derivative.row(i + 1));
            for ((state, inner), outer) in state.iter_mut().zip(inner_row).zip(outer_row) {
                *state = decay * *state + at_outer * outer + at_inner * inner;
            }
        }
        for state in &state {
            out.row_mut(i).iter_mut().zip(state).for_each(|(out, state)| *out += state);
        }
    }
    if phase <= 0.0 {
        // The recursion has a pole on the axis; the profile is even there.
        let axis: Vec<f64> = out.row(1).iter().zip(out.row(2)).map(|(a, b)| (4.0 * a - b) / 3.0).collect();
        out.row_mut(0).copy_from_slice(&axis);
    }
    let edge = out.row(n - 2).to_vec();
    out.row_mut(n - 1).copy_from_slice(&edge);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apply(operator: &Matrix, column: &[f64]) -> Vec<f64> {
        (0..operator.rows).map(|i| operator.row(i).iter().zip(column).map(|(a, b)| a * b).sum()).collect()
    }

    /// A Gaussian is its own Abel transform but for √π·width; a disc's is a half ellipse.
    #[test]
    fn closed_forms_come_back() {
        for phase in [0.0, 0.5] {
            let n = 120;
            let width = 30.0;
            let gauss = |i: usize| (-(radius(i, phase) / width).powi(2)).exp();
            let column: Vec<f64> = (0..n).map(|i| width * PI.sqrt() * gauss(i)).collect();
            let linear = hats(n, phase).upper_inverse().unwrap();
            let onion = rings(n, phase).upper_inverse().unwrap();
            // Bounds by the second derivative on the axis, 2/30²: a quarter of it for parabolas, two thirds for rings; and
            // the exponentials of Hansen and Law.
            let all =
                [(three_point(n, phase), 6e-4), (onion, 2e-3), (linear, 6e-4), (hansen_law(n, phase), 3e-3)];
            for (k, (operator, bound)) in all.iter().enumerate() {
                for (i, f) in apply(operator, &column).iter().enumerate() {
                    assert!((f - gauss(i)).abs() < *bound, "{k} {phase} {i}: {f} {}", gauss(i));
                }
            }
        }
    }

    /// Rings of a uniform disc add up to its chords, hats of f = 1 to them and the last ramp.
    #[test]
    fn uniform_discs_have_chords() {
        for phase in [0.0, 0.5] {
            let n = 9;
            let edge = radius(n - 1, phase) + 0.5;
            let (rings, hats) = (rings(n, phase), hats(n, phase));
            for i in 0..n {
                let chord = 2.0 * leg(edge, radius(i, phase));
                assert!((rings.row(i).iter().sum::<f64>() - chord).abs() < 1e-12);
                let last = radius(n - 1, phase);
                let chord =
                    2.0 * leg(last, radius(i, phase)) + ramp(radius(i, phase), last, last + 1.0, 1.0, 0.0);
                assert!((hats.row(i).iter().sum::<f64>() - chord).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_smallest_widths_have_operators() {
        for phase in [0.0, 0.5] {
            for n in 1..4 {
                let column = vec![1.0; n];
                for operator in
                    [three_point(n, phase), hansen_law(n, phase), rings(n, phase).upper_inverse().unwrap()]
                {
                    assert!(apply(&operator, &column).iter().all(|f| f.is_finite()));
                }
            }
        }
    }
}
