//! One operator, ready to be applied to many rows: what is wanted of it is formed once.

use super::matrix::Matrix;
use super::operators::radius;
use super::product::{Packed, Rows, multiply_here};
use super::singles;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;

/// Rows of one parallel task of variances.
const TASK_ROWS: usize = 64;

/// Variances of one row may differ by this factor to go through in f32; its smallest normal number is 1e-38.
const SPAN_MAX: f64 = 1e12;

/// Squares of an operator's values below this part of the largest count as zero in f32: even where they meet the largest
/// variances and the others the smallest, they are less than 3e-10 of the answer.
const SQUARE_MIN: f64 = 1e-24;

/// Columns of one far block of variances …
const BLOCK: usize = 8;
/// … beyond so many radii from the answers of a panel …
const NEAR: usize = 32;
/// … where there are at least so many columns.
const BLOCKS_FROM: usize = 192;

/// A linear transform of one width: row i belongs to radius i.
#[derive(Debug, Clone)]
pub(super) struct Operator {
    pub(super) matrix: Matrix,
    /// Its transpose.
    pub(super) across: Packed<f64>,
    /// The same in f32, formed when it is first asked for.
    single: OnceLock<Packed<f32>>,
    reach: Option<usize>,
    /// The squares of that, over `square_unit`: near columns one by one, then means over blocks of far ones.
    squares: Packed<f32>,
    blocks: usize,
    square_unit: f64,
    /// Standard deviations at the radii for pixels of one, both halves complete.
    pub(super) unit_sigmas: Vec<f64>,
}

impl Operator {
    /// `reach`: columns nearer to the axis than by this many radii have no part in a radius; None: all have. `shares` are the
    /// variances of the columns, of complete halves, in variances of a pixel.
    pub(super) fn new(matrix: Matrix, reach: Option<usize>, shares: &[f64]) -> Self {
        let largest = matrix.values.iter().fold(0.0_f64, |most, d| most.max(d * d));
        let square_unit = power_of_two(largest);
        let square = |k: usize, i: usize| {
            let d = matrix.at(i, k);
            if d * d < SQUARE_MIN * largest { 0.0 } else { d * d / square_unit }
        };
        let (n, columns) = (matrix.rows, matrix.columns);
        let blocks = if columns < BLOCKS_FROM { 0 } else { columns.div_ceil(BLOCK) };
        let spans = |panel: Range<usize>| {
            let known = reach.map_or(0, |reach| panel.start.saturating_sub(reach)).min(columns);
            if blocks == 0 {
                return std::iter::once(known..columns).collect();
            }
            let first = panel.start.saturating_sub(NEAR) / BLOCK;
            let last = (panel.end + NEAR).div_ceil(BLOCK).min(blocks);
            let near = known.max(first * BLOCK)..(last * BLOCK).min(columns);
            vec![
                near,
                columns + (known / BLOCK).min(first)..columns + first,
                columns + last..columns + blocks,
            ]
        };
        let mean = |block: usize, i: usize| {
            let members = block * BLOCK..((block + 1) * BLOCK).min(columns);
            members.clone().map(|k| square(k, i)).sum::<f64>() / radius(members.len(), 0.0)
        };
        let squares = Packed::in_spans(columns + blocks, n, spans, |k, i| {
            if k < columns { square(k, i) } else { mean(k - columns, i) }
        });
        let variance =
            |i: usize| matrix.row(i).iter().zip(shares).map(|(d, share)| d * d * share).sum::<f64>();
        Self {
            across: Packed::from_fn(columns, n, reach, |k, i| matrix.at(i, k)),
            single: OnceLock::new(),
            reach,
            squares,
            blocks,
            square_unit,
            unit_sigmas: (0..n).map(|i| variance(i).sqrt()).collect(),
            matrix,
        }
    }

    /// Answers for the rows `order` of `narrow`, `[row][column]` in f32, times `unit`: good to a few 1e-7 of the largest
    /// column times the largest sum of a row's magnitudes.
    pub(super) fn answers_single(&self, narrow: &[f32], unit: f64, order: &[usize], out: &mut [f64]) {
        let (n, columns) = (self.matrix.rows, self.matrix.columns);
        let form = || Packed::from_fn(columns, n, self.reach, |k, i| self.matrix.at(i, k));
        let across = self.single.get_or_init(form);
        let chunks = out.par_chunks_mut(TASK_ROWS * n).zip(order.par_chunks(TASK_ROWS));
        chunks.for_each_init(Vec::new, |memory: &mut Vec<f32>, (out, order)| {
            memory.resize(out.len(), 0.0);
            multiply_here(&Rows { values: narrow, stride: columns, order, depth: columns }, across, memory);
            singles::widened(memory, unit, out);
        });
    }

    /// Variances at the radii for the rows `order` of `variances`, `[row][column]`, all ≥ 0.
    ///
    /// In f32, scaled by powers of two: all terms are positive, so that the relative error is at most their number times
    /// 2⁻²⁴, in practice below 1e-6. Of wide images far columns go by the mean over some neighbours, which is exact where
    /// their variances are alike. Rows of variances too different for f32 are summed in f64.
    pub(super) fn variances(&self, variances: &[f64], order: &[usize], out: &mut [f64]) {
        let (n, columns) = (self.matrix.rows, self.matrix.columns);
        if out.is_empty() || columns == 0 {
            return;
        }
        let chunks = out.par_chunks_mut(TASK_ROWS * n).zip(order.par_chunks(TASK_ROWS));
        chunks.for_each_init(Vec::new, |memory: &mut Vec<f32>, (out, order)| {
            let stride = columns + self.blocks;
            memory.resize(TASK_ROWS * (n + stride), 0.0);
            let (left, rest) = memory.split_at_mut(order.len() * stride);
            let answers = &mut rest[..order.len() * n];
            let mut units = [None; TASK_ROWS];
            for ((left, unit), &row) in left.chunks_mut(stride).zip(&mut units).zip(order) {
                let (left, blocks) = left.split_at_mut(columns);
                *unit = singled(&variances[row * columns..(row + 1) * columns], left);
                singles::blocked::<BLOCK>(left, blocks);
            }
            let here: [usize; TASK_ROWS] = std::array::from_fn(|row| row);
            let rows = Rows { values: left, stride, order: &here[..order.len()], depth: stride };
            multiply_here(&rows, &self.squares, answers);
            let each = out.chunks_mut(n).zip(answers.chunks(n)).zip(units).zip(order);
            for (((out, answers), unit), &row) in each {
                match unit {
                    Some(unit) => {
                        let unit = unit * self.square_unit;
                        singles::widened(answers, unit, out);
                    }
                    None => self.doubled(&variances[row * columns..(row + 1) * columns], out),
                }
            }
        });
    }

    /// The same of one row in f64.
    fn doubled(&self, variances: &[f64], out: &mut [f64]) {
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.matrix.row(i).iter().zip(variances).map(|(d, v)| d * d * v).sum();
        }
    }
}

/// Rounds a row to f32 in a unit of its own, which is returned; None if its variances differ too much for that.
fn singled(variances: &[f64], out: &mut [f32]) -> Option<f64> {
    let (least, most) = singles::span(variances);
    let unit = power_of_two(most);
    let scale = 1.0 / unit;
    singles::narrowed(variances, scale, out);
    (least * SPAN_MAX >= most && scale.is_finite()).then_some(unit)
}

/// The power of two at or below a number ≥ 0, 1 for none.
fn power_of_two(value: f64) -> f64 {
    if value > 0.0 && value.is_finite() { libm::ldexp(1.0, libm::ilogb(value)) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::super::filtered::daun;
    use super::super::request::Elements;
    use super::*;

    /// f32 within its bound, f64 where a row spans too much, whatever the rows' own sizes; zero stays zero.
    #[test]
    fn variances_are_sums_of_squares() {
        let n = 90;
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        let matrix = Matrix::from_fn(n, n, |i, j| ((i * 37 + j * 101 + 7) % 64) as f64 * 1e-3 - 0.02);
        let operator = Operator::new(matrix.clone(), None, &vec![1.0; n]);
        let rows = 70;
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        let variance = |row: usize, k: usize| match row {
            0 => 0.0,
            // Beyond what f32 can hold beside each other, and sizes that it cannot hold at all.
            1 => libm::pow(10.0, -0.7 * k as f64),
            2 => 1e-120 * (1.0 + k as f64),
            3 => {
                if k.is_multiple_of(5) {
                    0.0
                } else {
                    1e90
                }
            }
            _ => 1.0 + ((row * 31 + k * 7) % 13) as f64,
        };
        let given: Vec<f64> = (0..rows * n).map(|at| variance(at / n, at % n)).collect();
        let order: Vec<usize> = (0..rows).rev().collect();
        let mut found = vec![f64::NAN; rows * n];
        operator.variances(&given, &order, &mut found);
        for (found, row) in found.chunks(n).zip(order) {
            for (i, found) in found.iter().enumerate() {
                let want: f64 = (0..n).map(|k| matrix.at(i, k).powi(2) * variance(row, k)).sum();
                // As many terms as columns, each rounded a few times.
                assert!((found - want).abs() <= 1e-7 * n as f64 * want, "{row} {i}: {found} {want}");
            }
        }
        assert!(operator.unit_sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0));
    }

    /// On wide rows σ is that of single columns to 1e-6 where all are alike, to 1e-3 where they change by four percent a
    /// radius, and to 1e-2 where neighbours differ at random by factors of some (the bounds that ABEL.md states).
    #[test]
    fn far_columns_may_go_by_blocks() {
        let n = 270;
        for (phase, strength) in [(0.0, 3.0), (0.5, 1e3)] {
            let filtered = daun(n, phase, Elements::Linear, Some(strength)).unwrap();
            let matrix = filtered.operator(0);
            let operator = Operator::new(matrix.clone(), None, &vec![1.0; n]);
            assert!(operator.blocks > 0);
            #[expect(clippy::cast_precision_loss, reason = "small numbers")]
            let kinds: [(&dyn Fn(usize) -> f64, f64); 3] = [
                (&|_| 3.0, 1e-6),
                (&|k| libm::exp(0.04 * k as f64), 1e-3),
                (&|k| libm::exp(0.5 * ((k * 7919 % 101) as f64 / 25.0 - 2.0)), 1e-2),
            ];
            for (variance, bound) in kinds {
                let given: Vec<f64> = (0..n).map(variance).collect();
                let (mut found, mut wanted) = (vec![0.0; n], vec![0.0; n]);
                operator.variances(&given, &[0], &mut found);
                operator.doubled(&given, &mut wanted);
                for (i, (found, wanted)) in found.iter().zip(&wanted).enumerate() {
                    let off = ((found / wanted).sqrt() - 1.0).abs();
                    assert!(off < bound, "{phase} {strength} {bound} {i}: {off}");
                }
            }
        }
    }
}
