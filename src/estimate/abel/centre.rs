//! Finds the axis of a picture: where it is its own mirror image, to a small part of a pixel.

use super::operators::radius;
use std::f64::consts::PI;

/// Rounds in which missing pixels are taken from the other side of the axis found so far.
const ROUNDS: usize = 3;
/// Steps of Newton's method for the highest point of the correlation.
const STEPS_MAX: usize = 40;
/// Correlations on each side of the highest one that shape it: a smooth picture is known from its samples.
const SAMPLES: usize = 64;

/// An axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// Where, in columns from the middle of the first one.
    pub column: f64,
    /// Standard deviation by what the halves differ, in columns; NaN if nothing tells.
    pub sigma: f64,
    /// Whether the picture told; else it is the middle.
    pub found: bool,
}

/// Finds the vertical axis of `[rows · columns]` values; those that are not finite are missing.
///
/// The picture's correlation with its mirror image is highest when the mirror is the axis; between columns it is the
/// band-limited curve through the correlations. What the outermost twentieth of a row on each side has is taken to be
/// background. Panics unless there is a value for every pixel.
pub fn find(values: &[f64], rows: usize, columns: usize) -> Axis {
    assert!(values.len() == rows * columns, "one value per pixel");
    let middle = 0.5 * (radius(columns.max(1), 0.0) - 1.0);
    let nowhere = Axis { column: middle, sigma: f64::NAN, found: false };
    if columns < 3 {
        return nowhere;
    }
    let scale = values.iter().filter(|v| v.is_finite()).fold(0.0_f64, |a, v| a.max(v.abs()));
    if scale <= 0.0 {
        return nowhere;
    }
    let flat: Vec<f64> = values.chunks(columns).flat_map(|row| without_background(row, scale)).collect();
    let mut column = middle;
    for round in 0..ROUNDS {
        let filled: Vec<f64> =
            flat.chunks(columns).flat_map(|row| mirrored(row, column, round > 0)).collect();
        let Some(found) = highest(&filled, columns) else { return nowhere };
        let moved = (found - column).abs();
        column = found;
        if moved < 1e-6 || flat.iter().all(|v| v.is_finite()) {
            break;
        }
    }
    let sigma = spread(&flat, columns, column);
    let half = 0.5 * (2.0 * column).round();
    // An axis that cannot be told from one on a pixel or between two is taken to be there: nothing is interpolated then.
    let near = (column - half).abs() <= (2.0 * sigma).clamp(NEAR, 0.1);
    let column = if near || sigma.is_nan() && (column - half).abs() < NEAR { half } else { column };
    Axis { column: column.clamp(0.0, radius(columns - 1, 0.0)), sigma, found: true }
}

/// Nearer to a half pixel than this nothing is interpolated, in columns: it changes a profile by this part of its
/// slope per pixel.
const NEAR: f64 = 1e-3;

/// A row less a line through the means of its ends, in units of `scale`.
fn without_background(row: &[f64], scale: f64) -> Vec<f64> {
    let width = (row.len() / 20).max(1);
    let mean = |part: &[f64]| {
        let known: Vec<f64> = part.iter().copied().filter(|v| v.is_finite()).collect();
        (!known.is_empty()).then(|| known.iter().sum::<f64>() / radius(known.len(), 0.0))
    };
    let ends = [mean(&row[..width]), mean(&row[row.len() - width..])];
    // The lower end: an axis near an edge leaves no background there.
    let level = ends.into_iter().flatten().fold(f64::INFINITY, f64::min);
    let level = if level.is_finite() { level } else { 0.0 };
    row.iter().map(|v| (v - level) / scale).collect()
}

/// A row with missing values taken from the other side of `column` if that is `known`, else from their neighbours: a hole
/// would have an axis of its own.
fn mirrored(row: &[f64], column: f64, known: bool) -> Vec<f64> {
    let finite: Vec<usize> = (0..row.len()).filter(|&i| row[i].is_finite()).collect();
    let between = |i: usize| {
        let after = finite.partition_point(|&k| k < i);
        match (after.checked_sub(1).map(|k| finite[k]), finite.get(after)) {
            (Some(a), Some(&b)) => row[a] + (row[b] - row[a]) * radius(i - a, 0.0) / radius(b - a, 0.0),
            // Beyond the last value there is nothing.
            _ => 0.0,
        }
    };
    let other = |i: usize| {
        let at = 2.0 * column - radius(i, 0.0);
        let inside = known && at >= 0.0 && at <= radius(row.len() - 1, 0.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the row")]
        let value = if inside { row[at.round() as usize] } else { f64::NAN };
        if value.is_finite() { value } else { between(i) }
    };
    row.iter().enumerate().map(|(i, &v)| if v.is_finite() { v } else { other(i) }).collect()
}

/// Where Σ p(i) p(m − i) over all rows is highest, as m/2.
fn highest(filled: &[f64], columns: usize) -> Option<f64> {
    let mut c = vec![0.0; 2 * columns - 1];
    for row in filled.chunks(columns) {
        for (i, &a) in row.iter().enumerate() {
            c[i..i + columns].iter_mut().zip(row).for_each(|(c, b)| *c += a * b);
        }
    }
    let (best, &top) = c.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)))?;
    if top.is_nan() || top <= 0.0 {
        return None;
    }
    // The curve through samples at whole lags: Σ c(m) sinc(t − m), tapered; its slope is zero at the top.
    let slope = |t: f64| {
        let (mut first, mut second) = (0.0, 0.0);
        let span = radius(SAMPLES, 0.5);
        for m in 0..=2 * SAMPLES {
            let x = t - (radius(best, 0.0) + radius(m, 0.0) - radius(SAMPLES, 0.0));
            // Beyond the picture there is nothing.
            let c = (best + m).checked_sub(SAMPLES).and_then(|m| c.get(m)).copied().unwrap_or(0.0);
            let (w, w1) = ((PI * x / (2.0 * span)).cos().powi(2), -(PI * x / span).sin() * PI / (2.0 * span));
            let (s, s1, s2) = sinc(x);
            let w2 = -(PI * x / span).cos() * PI * PI / (2.0 * span * span);
            first += (c - top) * (s1 * w + s * w1);
            second += (c - top) * (s2 * w + 2.0 * s1 * w1 + s * w2);
        }
        (first, second)
    };
    let start = radius(best, 0.0);
    let mut t = start;
    for _ in 0..STEPS_MAX {
        let (first, second) = slope(t);
        if second.is_nan() || second >= 0.0 {
            break;
        }
        let next = (t - first / second).clamp(start - 0.75, start + 0.75);
        let step = (next - t).abs();
        t = next;
        if step < 1e-12 {
            break;
        }
    }
    Some(0.5 * t)
}

/// sin(πx)/(πx) and its first two derivatives.
fn sinc(x: f64) -> (f64, f64, f64) {
    let z = PI * x;
    if z.abs() < 1e-2 {
        let z2 = z * z;
        return (
            1.0 - z2 / 6.0 * (1.0 - z2 / 20.0),
            PI * z * (-1.0 / 3.0 + z2 / 30.0 * (1.0 - z2 / 28.0)),
            PI * PI * (-1.0 / 3.0 + z2 / 10.0 * (1.0 - 5.0 * z2 / 84.0)),
        );
    }
    let (sin, cos) = (libm::sin(z), libm::cos(z));
    let s = sin / z;
    let first = (cos - s) / z;
    (s, PI * first, PI * PI * (-s - 2.0 * first / z))
}

/// Standard deviation of the axis: σ² = (variance of a difference of the halves)/Σ(2 p')².
fn spread(flat: &[f64], columns: usize, column: f64) -> f64 {
    let (mut square, mut steep, mut n) = (0.0, 0.0, 0.0);
    for row in flat.chunks(columns) {
        for i in 1..columns.saturating_sub(1) {
            let at = 2.0 * column - radius(i, 0.0);
            if at <= radius(i, 0.0) {
                break;
            }
            if at >= radius(columns - 1, 0.0) {
                continue;
            }
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the row")]
            let (low, part) = (at as usize, at - at.floor());
            let other = row[low] * (1.0 - part) + row[low + 1] * part;
            let (difference, slope) = (row[i] - other, row[i + 1] - row[i - 1]);
            if difference.is_finite() && slope.is_finite() {
                square += difference * difference;
                steep += slope * slope;
                n += 1.0;
            }
        }
    }
    (square / n / steep).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(rows: usize, columns: usize, centre: f64, width: f64) -> Vec<f64> {
        let at = |row: usize, c: usize| {
            let r = (radius(c, 0.0) - centre) / (width * (1.0 + 0.1 * radius(row, 0.0)));
            (0.3 + r * r) * (-r * r).exp()
        };
        (0..rows).flat_map(|row| (0..columns).map(move |c| at(row, c))).collect()
    }

    #[test]
    fn any_axis_is_found_to_a_thousandth() {
        for columns in [40, 41, 101] {
            for part in [0.0, 0.1, 0.25, 0.37, 0.5, 0.81] {
                let centre = (0.5 * radius(columns, 0.0)).floor() - 2.0 + part;
                let axis = find(&picture(4, columns, centre, 5.0), 4, columns);
                assert!(axis.found && (axis.column - centre).abs() < 2e-3, "{columns} {centre} {axis:?}");
            }
        }
    }

    /// Holes on one side, in the middle, a background and a pattern of noise do not move it by more than they can.
    #[test]
    fn holes_background_and_noise_do_little() {
        let (rows, columns, centre) = (20, 121, 57.3);
        let mut image = picture(rows, columns, centre, 12.0);
        for (i, v) in image.iter_mut().enumerate() {
            *v += 0.2 + 0.01 * (((i * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5);
            let r = radius(i % columns, 0.0) - centre;
            if (20.0..24.0).contains(&r) && i % 3 == 0 || r.abs() < 1.5 {
                *v = f64::NAN;
            }
        }
        let axis = find(&image, rows, columns);
        assert!(axis.sigma < 0.02 && (axis.column - centre).abs() < 0.02, "{axis:?}");
    }

    #[test]
    fn nothing_to_see_is_the_middle() {
        for image in [vec![0.0; 10], vec![f64::NAN; 10]] {
            assert_eq!(find(&image, 2, 5).column.to_bits(), 2.0_f64.to_bits());
            assert!(!find(&image, 2, 5).found);
        }
        assert!((find(&[1.0, 2.0], 1, 2).column - 0.5).abs() < 1e-15);
        assert!(!find(&[], 0, 5).found);
    }
}
