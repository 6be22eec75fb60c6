//! Products of many rows with one matrix: where the time of an inverse Abel transform goes.
//!
//! The matrix is cut once into panels of some columns, so that a part of a panel stays in the nearest cache while all rows
//! pass by. Every sum runs in the order of its terms, without fused operations: the same bits whatever the vectors, the
//! machine of one architecture and the number of threads. f64 for answers; f32 for what only has to be nearly right.

use super::matrix::Matrix;
use pulp::Simd;
use rayon::prelude::*;
use std::ops::{Add, Mul, Range};

/// Bytes of a row of a panel: four of the widest vectors.
const PANEL_BYTES: usize = 256;
/// Columns of a panel of f32.
const WIDTH_MAX: usize = PANEL_BYTES / size_of::<f32>();
/// Rows of a panel that are passed at a time: 16 KiB, half of a nearest cache.
const DEPTH: usize = 64;
/// Rows that share what is read of a panel.
const ROWS: usize = 4;
/// Rows of one parallel task.
const TASK_ROWS: usize = 64;

/// f64 or f32, alone and in the vectors of a machine.
pub(super) trait Number:
    Copy + Default + Send + Sync + Add<Output = Self> + Mul<Output = Self>
{
    /// A vector of them.
    type Vector<S: Simd>: Copy;

    /// Rounded from f64.
    fn rounded(value: f64) -> Self;
    /// The same number everywhere.
    fn splat<S: Simd>(simd: S, value: Self) -> Self::Vector<S>;
    /// sum + a·b, rounded twice.
    fn plus<S: Simd>(
        simd: S,
        sum: Self::Vector<S>,
        a: Self::Vector<S>,
        b: Self::Vector<S>,
    ) -> Self::Vector<S>;
    /// Whole vectors of a slice.
    fn vectors<S: Simd>(values: &[Self]) -> &[Self::Vector<S>];
    /// As [`Self::vectors`].
    fn vectors_mut<S: Simd>(values: &mut [Self]) -> &mut [Self::Vector<S>];
}

impl Number for f64 {
    type Vector<S: Simd> = S::f64s;

    #[inline(always)]
    fn rounded(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn splat<S: Simd>(simd: S, value: Self) -> S::f64s {
        simd.splat_f64s(value)
    }
    #[inline(always)]
    fn plus<S: Simd>(simd: S, sum: S::f64s, a: S::f64s, b: S::f64s) -> S::f64s {
        simd.add_f64s(sum, simd.mul_f64s(a, b))
    }
    #[inline(always)]
    fn vectors<S: Simd>(values: &[Self]) -> &[S::f64s] {
        S::as_simd_f64s(values).0
    }
    #[inline(always)]
    fn vectors_mut<S: Simd>(values: &mut [Self]) -> &mut [S::f64s] {
        S::as_mut_simd_f64s(values).0
    }
}

impl Number for f32 {
    type Vector<S: Simd> = S::f32s;

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
    fn rounded(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn splat<S: Simd>(simd: S, value: Self) -> S::f32s {
        simd.splat_f32s(value)
    }
    #[inline(always)]
    fn plus<S: Simd>(simd: S, sum: S::f32s, a: S::f32s, b: S::f32s) -> S::f32s {
        simd.add_f32s(sum, simd.mul_f32s(a, b))
    }
    #[inline(always)]
    fn vectors<S: Simd>(values: &[Self]) -> &[S::f32s] {
        S::as_simd_f32s(values).0
    }
    #[inline(always)]
    fn vectors_mut<S: Simd>(values: &mut [Self]) -> &mut [S::f32s] {
        S::as_mut_simd_f32s(values).0
    }
}

/// The right-hand matrix of many products, in panels: `[panel][row][column of the panel]`, the last one filled up with zeros.
#[derive(Debug, Clone)]
pub(super) struct Packed<T> {
    /// Rows: numbers of a row on the left.
    pub(super) rows: usize,
    /// Columns: numbers of an answer.
    pub(super) columns: usize,
    /// Rows of each panel that are not zero, in the order of their terms.
    spans: Vec<Vec<Range<usize>>>,
    panels: Vec<T>,
}

impl<T: Number> Packed<T> {
    /// Columns of a panel.
    const WIDTH: usize = PANEL_BYTES / size_of::<T>();

    /// Cuts a matrix. `reach` says that its values are zero where row + reach < column, as in operators that peel outside in.
    pub(super) fn new(matrix: &Matrix, reach: Option<usize>) -> Self {
        Self::from_fn(matrix.rows, matrix.columns, reach, |k, i| matrix.at(k, i))
    }

    /// As [`Self::new`] from values by row and column.
    pub(super) fn from_fn(
        rows: usize,
        columns: usize,
        reach: Option<usize>,
        value: impl Fn(usize, usize) -> f64,
    ) -> Self {
        let from = |first: usize| reach.map_or(0, |reach| first.saturating_sub(reach)).min(rows);
        Self::in_spans(rows, columns, |panel| std::iter::once(from(panel.start)..rows).collect(), value)
    }

    /// As [`Self::from_fn`]; of the columns of a panel only rows in its spans are looked at.
    pub(super) fn in_spans(
        rows: usize,
        columns: usize,
        spans: impl Fn(Range<usize>) -> Vec<Range<usize>>,
        value: impl Fn(usize, usize) -> f64,
    ) -> Self {
        let mut panels = vec![T::default(); columns.div_ceil(Self::WIDTH) * rows * Self::WIDTH];
        let mut all = Vec::new();
        for (panel, first) in panels.chunks_mut((rows * Self::WIDTH).max(1)).zip((0..).step_by(Self::WIDTH)) {
            let spans = spans(first..(first + Self::WIDTH).min(columns));
            for k in spans.iter().cloned().flatten() {
                let row = &mut panel[k * Self::WIDTH..(k + 1) * Self::WIDTH];
                row.iter_mut().zip(first..columns).for_each(|(to, i)| *to = T::rounded(value(k, i)));
            }
            all.push(spans);
        }
        Self { rows, columns, spans: all, panels }
    }
}

/// Rows on the left of a product.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a, T> {
    /// All of them, `[row][stride]`.
    pub(super) values: &'a [T],
    /// Numbers of a row.
    pub(super) stride: usize,
    /// Which are meant, in this order.
    pub(super) order: &'a [usize],
    /// So many numbers of each take part: as many rows of the matrix.
    pub(super) depth: usize,
}

/// out[r] = Σ_k left[order[r]][k] · right[k], on all threads.
pub(super) fn multiply<T: Number>(left: &Rows<'_, T>, right: &Packed<T>, out: &mut [T]) {
    let tasks = out.par_chunks_mut(TASK_ROWS * right.columns.max(1)).zip(left.order.par_chunks(TASK_ROWS));
    tasks.for_each(|(out, order)| multiply_here(&Rows { order, ..*left }, right, out));
}

/// As [`multiply`] on this thread.
pub(super) fn multiply_here<T: Number>(left: &Rows<'_, T>, right: &Packed<T>, out: &mut [T]) {
    assert!(left.depth <= left.stride && left.depth <= right.rows, "a row of the matrix for every number");
    assert!(out.len() == left.order.len() * right.columns, "an answer for every row");
    if left.depth == 0 {
        out.fill(T::default());
    } else if !out.is_empty() {
        pulp::Arch::new().dispatch(Product { left, right, out });
    }
}

struct Product<'a, T> {
    left: &'a Rows<'a, T>,
    right: &'a Packed<T>,
    out: &'a mut [T],
}

impl<T: Number> pulp::WithSimd for Product<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = size_of::<T::Vector<S>>() / size_of::<T>();
        // Sums of four rows stay in registers: of four vectors where there are 32 registers, of two where there are 16.
        let many = size_of::<T::Vector<S>>() * 4 == PANEL_BYTES;
        let mut column = 0;
        while column < self.right.columns {
            let left = self.right.columns - column;
            column += lanes
                * if many && left > 2 * lanes {
                    self.tiles::<S, 4>(simd, column)
                } else if left > lanes {
                    self.tiles::<S, 2>(simd, column)
                } else {
                    self.tiles::<S, 1>(simd, column)
                };
        }
    }
}

impl<T: Number> Product<'_, T> {
    /// All rows for some vectors of columns; returns how many.
    #[inline(always)]
    fn tiles<S: Simd, const VECTORS: usize>(&mut self, simd: S, column: usize) -> usize {
        let Packed { rows, .. } = *self.right;
        let width = Packed::<T>::WIDTH;
        let panel = &self.right.panels[column / width * rows * width..][..rows * width];
        let mut first = true;
        for span in &self.right.spans[column / width] {
            let to = span.end.min(self.left.depth);
            for from in (span.start..to).step_by(DEPTH) {
                self.all_rows::<S, VECTORS>(simd, panel, column, from..to.min(from + DEPTH), first);
                first = false;
            }
        }
        if first {
            // Nothing but zeros.
            self.all_rows::<S, VECTORS>(simd, panel, column, 0..0, true);
        }
        VECTORS
    }

    /// Adds some rows of the matrix to the sums of all rows.
    #[inline(always)]
    fn all_rows<S: Simd, const VECTORS: usize>(
        &mut self,
        simd: S,
        panel: &[T],
        column: usize,
        depth: Range<usize>,
        first: bool,
    ) {
        for row in (0..self.left.order.len()).step_by(ROWS) {
            let part = Part { panel, row, column, depth: depth.clone(), first };
            self.tile::<S, VECTORS>(simd, &part);
        }
    }

    /// Adds to the sums of four rows and some vectors of columns, in registers.
    #[inline(always)]
    fn tile<S: Simd, const VECTORS: usize>(&mut self, simd: S, part: &Part<'_, T>) {
        let columns = self.right.columns;
        let width = Packed::<T>::WIDTH;
        let length = VECTORS * size_of::<T::Vector<S>>() / size_of::<T>();
        let Part { panel, row, column, .. } = *part;
        let depth = part.depth.clone();
        // Rows beyond the last one are that one again, and their sums are dropped.
        let last = self.left.order.len() - 1;
        let left = |r: usize| {
            let at = self.left.order[(row + r).min(last)] * self.left.stride;
            &self.left.values[at + depth.start..at + depth.end]
        };
        let [a, b, c, d] = [left(0), left(1), left(2), left(3)];
        let mut sums = [[T::splat(simd, T::default()); VECTORS]; ROWS];
        let real = length.min(columns - column);
        let mut edge = [T::default(); WIDTH_MAX];
        if !part.first {
            for (r, sums) in sums.iter_mut().enumerate().take(last + 1 - row) {
                let out = &self.out[(row + r) * columns + column..][..real];
                if real == length {
                    sums.copy_from_slice(T::vectors::<S>(out));
                } else {
                    edge[..real].copy_from_slice(out);
                    sums.copy_from_slice(T::vectors::<S>(&edge[..length]));
                }
            }
        }
        let right = panel[depth.start * width..depth.end * width].chunks_exact(width);
        let offset = column % width;
        for ((((right, &a), &b), &c), &d) in right.zip(a).zip(b).zip(c).zip(d) {
            let vectors = T::vectors::<S>(&right[offset..offset + length]);
            let vectors: &[T::Vector<S>; VECTORS] = vectors.try_into().expect("a whole number of vectors");
            for (sums, factor) in sums.iter_mut().zip([a, b, c, d]) {
                let factor = T::splat(simd, factor);
                for (sum, &vector) in sums.iter_mut().zip(vectors) {
                    *sum = T::plus(simd, *sum, factor, vector);
                }
            }
        }
        for (r, sums) in sums.iter().enumerate().take(last + 1 - row) {
            let out = &mut self.out[(row + r) * columns + column..][..real];
            if real == length {
                T::vectors_mut::<S>(out).copy_from_slice(sums);
            } else {
                T::vectors_mut::<S>(&mut edge[..length]).copy_from_slice(sums);
                out.copy_from_slice(&edge[..real]);
            }
        }
    }
}

/// Where a tile lies.
struct Part<'a, T> {
    panel: &'a [T],
    row: usize,
    column: usize,
    /// Rows of the matrix.
    depth: Range<usize>,
    /// Whether the sums begin here.
    first: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rough(rows: usize, columns: usize) -> Matrix {
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        Matrix::from_fn(rows, columns, |i, j| ((i * 37 + j * 101 + 7) % 64) as f64 / 61.0 - 0.4)
    }

    fn in_order<T: Number>(left: &Matrix, order: &[usize], right: &Matrix) -> Vec<T> {
        let mut out = Vec::new();
        for &row in order {
            for i in 0..right.columns {
                let term = |k: usize| T::rounded(left.at(row, k)) * T::rounded(right.at(k, i));
                out.push((0..right.rows).fold(T::default(), |sum, k| sum + term(k)));
            }
        }
        out
    }

    fn product<T: Number + Into<f64>>(left: &Matrix, order: &[usize], right: &Packed<T>) -> Vec<T> {
        let left: Vec<T> = left.values.iter().map(|&v| T::rounded(v)).collect();
        let mut out = vec![T::rounded(f64::NAN); order.len() * right.columns];
        let rows = Rows { values: &left, stride: right.rows, order, depth: right.rows };
        multiply(&rows, right, &mut out);
        if !out.is_empty() && right.rows > 0 {
            // As on a machine without vectors, and with narrower ones.
            let bits = |values: &[T]| values.iter().map(|&v| v.into().to_bits()).collect::<Vec<u64>>();
            let mut other = vec![T::rounded(f64::NAN); out.len()];
            pulp::Simd::vectorize(pulp::Scalar::new(), Product { left: &rows, right, out: &mut other });
            assert_eq!(bits(&out), bits(&other));
            #[cfg(target_arch = "x86_64")]
            if let Some(narrow) = pulp::x86::V3::try_new() {
                other.fill(T::rounded(f64::NAN));
                pulp::Simd::vectorize(narrow, Product { left: &rows, right, out: &mut other });
                assert_eq!(bits(&out), bits(&other));
            }
        }
        out
    }

    /// Whatever the shape, the order of the rows and the vectors of the machine, terms are added in one order: bit for bit.
    #[test]
    fn products_are_the_plain_sums() {
        for (rows, inner, columns) in [(1, 1, 1), (4, 7, 32), (67, 65, 45), (130, 200, 64), (6, 129, 161)] {
            let (a, b) = (rough(rows, inner), rough(inner, columns));
            let order: Vec<usize> = (0..rows).map(|row| (row * 7 + 3) % rows).collect();
            assert_eq!(product::<f64>(&a, &order, &Packed::new(&b, None)), in_order::<f64>(&a, &order, &b));
            assert_eq!(product::<f32>(&a, &order, &Packed::new(&b, None)), in_order::<f32>(&a, &order, &b));
            for reach in [0, 2] {
                let upper =
                    Matrix::from_fn(inner, columns, |k, i| if k + reach < i { 0.0 } else { b.at(k, i) });
                let packed = Packed::new(&upper, Some(reach));
                assert_eq!(product::<f64>(&a, &order, &packed), in_order::<f64>(&a, &order, &upper));
            }
        }
        assert!(
            product::<f64>(&rough(3, 0), &[0, 1, 2], &Packed::new(&rough(0, 2), None))
                .iter()
                .all(|v| *v == 0.0)
        );
    }
}
