//! Columns of the elements of Daun's method: what each value at a radius adds to the column at every radius.
//!
//! Steps and hats are in [`super::operators`]; here are the smooth ones, and the inverse of any of them. Values are zero one
//! pixel beyond the last radius.

use super::matrix::{self, Matrix};
use super::operators::{hats, radius, rings};
use super::request::Elements;
use ditd_sim::light::quadrature::gauss_legendre_unit;

/// Nodes of the quadrature along a sight inside one pixel. The integrand has branch points at ± i times the radius in the path;
/// nearest is half a pixel, where 24 nodes leave 2.2⁻⁴⁸.
const NODES: usize = 24;

/// Columns at radius i of the element of radius j.
pub(super) fn columns(elements: Elements, n: usize, phase: f64) -> Matrix {
    match elements {
        Elements::Steps => rings(n, phase),
        Elements::Linear => hats(n, phase),
        Elements::Quadratic => quadratics(n, phase),
        Elements::Cubic => splines(n, phase),
    }
}

/// The inverse of [`columns`]; None if it has none in f64.
pub(super) fn inverse(elements: Elements, columns: &Matrix) -> Option<Matrix> {
    if elements != Elements::Cubic {
        return columns.upper_inverse();
    }
    // Not triangular, but well conditioned: normal equations, and once again with what they leave.
    let across = columns.transposed();
    let first = matrix::solve_positive(&across.times(columns), &across)?;
    let made = first.times(columns);
    let left = Matrix::from_fn(made.rows, made.rows, |i, j| if i == j { 2.0 } else { 0.0 } - made.at(i, j));
    Some(left.times(&first))
}

/// Σ over sights and pixels: `add(i, j, parts)` gets 2 ∫ shape(t) along the sight at radius i between radii j and j + 1, for
/// shapes of t = r − (radius j) from `low` to `high`.
fn along_sights<const N: usize>(
    (n, phase): (usize, f64),
    (low, high): (f64, f64),
    shapes: impl Fn(f64) -> [f64; N],
    mut add: impl FnMut(usize, usize, [f64; N]),
) {
    let rule = gauss_legendre_unit(NODES);
    for i in 0..n {
        let y = radius(i, phase);
        for j in i..n {
            let at = radius(j, phase);
            let path = |r: f64| ((r - y) * (r + y)).max(0.0).sqrt();
            let (from, to) = (path(at + low), path(at + high));
            let mut sums = [0.0; N];
            for &(u, weight) in &rule {
                let z = from + u * (to - from);
                // r − at without cancellation: r² − at² = z² − path(at)².
                let t = (z - path(at)) * (z + path(at)) / (y.hypot(z) + at);
                let weight = 2.0 * (to - from) * weight;
                sums.iter_mut().zip(shapes(t)).for_each(|(sum, shape)| *sum += weight * shape);
            }
            add(i, j, sums);
        }
    }
}

/// Two parabolas a pixel, which meet half way with one slope: a value's own falls as 1 − 2t² and ends as 2(1 − t)².
fn quadratics(n: usize, phase: f64) -> Matrix {
    let mut out = Matrix::zeros(n, n);
    let own = |t: f64| if t < 0.5 { 1.0 - 2.0 * t * t } else { 2.0 * (1.0 - t) * (1.0 - t) };
    for half in [(0.0, 0.5), (0.5, 1.0)] {
        along_sights(
            (n, phase),
            half,
            |t| [own(t), 1.0 - own(t)],
            |i, j, [own, next]| {
                out.row_mut(i)[j] += own;
                if j + 1 < n {
                    out.row_mut(i)[j + 1] += next;
                }
            },
        );
    }
    out
}

/// Cubic splines: slopes are such that the second derivative has no steps. Even about the axis; flat at the last radius, as
/// PyAbel has it.
fn splines(n: usize, phase: f64) -> Matrix {
    let mut values = Matrix::zeros(n, n);
    let mut slopes = Matrix::zeros(n, n);
    let hermite = |t: f64| {
        let s = 1.0 - t;
        [s * s * (1.0 + 2.0 * t), t * t * (3.0 - 2.0 * t), t * s * s, -t * t * s]
    };
    along_sights((n, phase), (0.0, 1.0), hermite, |i, j, [own, next, slope, next_slope]| {
        values.row_mut(i)[j] += own;
        slopes.row_mut(i)[j] += slope;
        if j + 1 < n {
            values.row_mut(i)[j + 1] += next;
            slopes.row_mut(i)[j + 1] += next_slope;
        }
    });
    // Slopes at radii first ‥ n − 1 follow from T d = 3 (f₊ − f₋), T = (1, 4, 1); on the axis the slope is zero. Half a pixel
    // beside it the mirror image gives (3, 1) and 3 (f₁ − f₀).
    let first = usize::from(phase <= 0.0);
    let last = n.saturating_sub(1);
    let diagonal = |j: usize| if j == 0 { 3.0 } else { 4.0 };
    for i in 0..n {
        // T is symmetric: what columns see of slopes, by what they see of values.
        let mut seen = slopes.row(i).to_vec();
        let mut pivots = vec![0.0; n];
        for j in first..last {
            pivots[j] = diagonal(j);
            if j > first {
                pivots[j] -= 1.0 / pivots[j - 1];
                seen[j] -= seen[j - 1] / pivots[j - 1];
            }
        }
        for j in (first..last).rev() {
            let above = if j + 1 < last { seen[j + 1] } else { 0.0 };
            seen[j] = (seen[j] - above) / pivots[j];
            values.row_mut(i)[j + 1] += 3.0 * seen[j];
            values.row_mut(i)[j.saturating_sub(1)] -= 3.0 * seen[j];
        }
    }
    values
}

/// Columns of the radii `from` ‥ `to` alone. Splines reach inwards by a little: what is inside is taken to go on as the parabola
/// through the first three.
pub(super) fn part(columns: &Matrix, from: usize, to: usize) -> Matrix {
    let mut out = Matrix::from_fn(to - from, to - from, |i, j| columns.at(from + i, from + j));
    for lost in from.saturating_sub(REACH)..from {
        #[expect(clippy::cast_precision_loss, reason = "a few radii")]
        let t = -((from - lost) as f64);
        let parabola = match to - from {
            0 => vec![],
            1 => vec![1.0],
            2 => vec![1.0 - t, t],
            _ => vec![0.5 * (t - 1.0) * (t - 2.0), t * (2.0 - t), 0.5 * t * (t - 1.0)],
        };
        for i in 0..out.rows {
            let weight = columns.at(from + i, lost);
            out.row_mut(i).iter_mut().zip(&parabola).for_each(|(to, share)| *to += weight * share);
        }
    }
    out
}

/// Radii over which a spline's slope feels a value: 0.27¹² is 1e-7.
const REACH: usize = 12;

#[cfg(test)]
mod tests {
    use super::*;

    /// Every degree has the chords of a uniform disc inside of its last pixel, and the better ones follow a Gaussian better:
    /// by the second derivative 2/12² times a quarter (steps), by its fourth for splines.
    #[test]
    fn discs_and_gaussians_are_seen_as_they_are() {
        let (n, width) = (60, 12.0);
        for phase in [0.0, 0.5] {
            let gauss = |i: usize| (-(radius(i, phase) / width).powi(2)).exp();
            for (elements, bound) in [
                (Elements::Steps, 0.02),
                (Elements::Linear, 0.02),
                (Elements::Quadratic, 0.02),
                (Elements::Cubic, 1e-4),
            ] {
                let columns = columns(elements, n, phase);
                for i in 0..n {
                    let seen: f64 = columns.row(i).iter().zip(0..).map(|(a, j)| a * gauss(j)).sum();
                    let error = seen - std::f64::consts::PI.sqrt() * width * gauss(i);
                    assert!(error.abs() < bound * width, "{elements:?} {phase} {i} {error}");
                }
                let inverse = inverse(elements, &columns).unwrap();
                let unit = inverse.times(&columns);
                for (at, value) in unit.values.iter().enumerate() {
                    let want = f64::from(u8::from(at % (n + 1) == 0));
                    assert!((value - want).abs() < 1e-11, "{elements:?} {at} {value}");
                }
                // One everywhere but in the last pixel, where all fall to zero by the same integral.
                let whole: f64 = columns.row(0).iter().sum();
                let y = radius(0, phase);
                let path = |r: f64| 2.0 * (r * r - y * y).max(0.0).sqrt();
                let (inner, outer) = (path(radius(n - 1, phase)), path(radius(n, phase)));
                assert!((whole - 0.5 * (inner + outer)).abs() < 1e-3, "{elements:?} {whole}");
            }
        }
    }

    #[test]
    fn the_smallest_widths_have_inverses() {
        for elements in Elements::ALL {
            for phase in [0.0, 0.5] {
                for n in 1..6 {
                    let inverse = inverse(elements, &columns(elements, n, phase)).unwrap();
                    assert!(inverse.values.iter().all(|v| v.is_finite()), "{elements:?} {n}");
                }
            }
        }
    }
}
