//! Squared residuals pooled over neighbours: what maps with one cycle a level have instead of variances.

use super::FitInputs;
use super::rows::Walk;
use super::source::Source;
use crate::estimate::accumulate::Sums;
use crate::estimate::line;
use rayon::prelude::*;

/// Rows and columns on each side: windows of 9 × 9.
const RADIUS: usize = 4;

/// Per level with an x and pixel: pooled squares of the residuals about the unweighted line.
pub(super) struct Residuals(Vec<Vec<f64>>);

impl Residuals {
    /// None.
    pub(super) fn none() -> Self {
        Self(Vec::new())
    }

    /// Whether they are asked for, where so many of `used` levels were repeated: not where variances are, or too few to
    /// scatter about a line.
    pub(super) fn needed(repeated: usize, used: usize) -> bool {
        repeated < 2 && used >= 3
    }

    /// None when levels were repeated, or are too few to scatter about a line.
    pub(super) fn of(sums: &Sums, inputs: &FitInputs<'_>, used: &[usize], x: &[f64]) -> Self {
        let pixels = sums.rows() * sums.columns();
        let repeated = used
            .iter()
            .filter(|&&level| (0..pixels).any(|pixel| sums.levels()[level].count(pixel) >= 2))
            .count();
        if !Self::needed(repeated, used.len()) || sums.columns() == 0 {
            return Self::none();
        }
        let (rows, columns, points) = (sums.rows(), sums.columns(), used.len());
        let ones = vec![1.0; points];
        // Rows are independent: each has its own walk, which without pooling costs nothing.
        let lines: Vec<Vec<Option<Vec<f64>>>> = (0..rows)
            .into_par_iter()
            .map(|row| {
                let mut out = Vec::new();
                let mut walk = Walk::<f64>::new(Source::Sums(sums), inputs, used);
                walk.start(row..row + 1, false);
                while let Some(row) = walk.row() {
                    let mut y = vec![0.0; points];
                    for i in 0..columns {
                        let at = |k: usize| k * row.stride + i;
                        let whole = (0..points).all(|k| row.count[at(k)] >= 1.0) && row.alive[i] > 0.0;
                        (0..points).for_each(|k| y[k] = row.mean[at(k)]);
                        let line = if whole { line::weighted(x, &y, &ones) } else { None };
                        out.push(line.map(|line| {
                            let squared = |(&x, &y): (&f64, &f64)| {
                                let residual = (y - line.mean_y) - line.slope * (x - line.mean_x);
                                residual * residual
                            };
                            x.iter().zip(&y).map(squared).collect::<Vec<f64>>()
                        }));
                    }
                }
                out
            })
            .collect();
        let flat: Vec<Option<Vec<f64>>> = lines.into_iter().flatten().collect();
        let weight: Vec<f64> = flat.iter().map(|line| if line.is_some() { 1.0 } else { 0.0 }).collect();
        let level = |k: usize| -> Vec<f64> {
            let squares: Vec<f64> =
                flat.iter().map(|line| line.as_ref().map_or(f64::NAN, |line| line[k])).collect();
            pool(&squares, &weight, rows, columns, RADIUS)
        };
        Self((0..points).map(level).collect())
    }

    /// The pooled squares of a pixel, level by level; nothing where there are none.
    pub(super) fn at(&self, pixel: usize) -> impl Iterator<Item = f64> {
        self.0.iter().map(move |level| level[pixel])
    }
}

/// Weighted mean over a window of (2·radius + 1)² pixels, cut at the edges; NaN where no weight is. Values of zero
/// weight are not read.
fn pool(values: &[f64], weights: &[f64], rows: usize, columns: usize, radius: usize) -> Vec<f64> {
    let mut out = vec![f64::NAN; rows * columns];
    out.par_chunks_mut(columns.max(1)).enumerate().for_each(|(row, out)| {
        let mut sums = vec![(0.0, 0.0); columns];
        for from in row.saturating_sub(radius)..(row + radius + 1).min(rows) {
            let line = from * columns..(from + 1) * columns;
            for ((sum, &value), &weight) in sums.iter_mut().zip(&values[line.clone()]).zip(&weights[line]) {
                sum.0 += if weight > 0.0 { weight * value } else { 0.0 };
                sum.1 += weight;
            }
        }
        for (column, out) in out.iter_mut().enumerate() {
            let window = column.saturating_sub(radius)..(column + radius + 1).min(columns);
            let (sum, weight) = sums[window].iter().fold((0.0, 0.0), |s, v| (s.0 + v.0, s.1 + v.1));
            if weight > 0.0 {
                *out = sum / weight;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_averaged_by_weight() {
        let values = [1.0, 2.0, 3.0, f64::NAN, 5.0, 6.0];
        let weights = [1.0, 1.0, 1.0, 0.0, 2.0, 1.0];
        let pooled = pool(&values, &weights, 2, 3, 1);
        assert!((pooled[0] - (1.0 + 2.0 + 10.0) / 4.0).abs() < 1e-15);
        assert!((pooled[5] - (2.0 + 3.0 + 10.0 + 6.0) / 5.0).abs() < 1e-15);
        assert!(pool(&[f64::NAN], &[0.0], 1, 1, 2)[0].is_nan());
    }
}
