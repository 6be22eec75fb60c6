//! Rows of an image joined to columns at the radii, with what is known of their noise and their ends.

use super::fold::{self, Joined, Pixels};
use super::grid::Grid;
use super::inverter::Memory;
use super::request::Columns;
use rayon::prelude::*;
use std::borrow::Cow;

/// Rows on each side whose halves tell the noise of a row, where no σ is given.
const NEIGHBOURS: usize = 8;

/// A row whose last column is above this part of its largest …
const EDGE_PART: f64 = 0.02;
/// … and this many standard deviations does not fall to zero at its end.
const EDGE_SIGMAS: f64 = 5.0;

/// Rows of one parallel task.
const TASK_ROWS: usize = 32;

/// Rows joined to columns at the radii, in units that keep squares finite.
pub(super) struct Work<'a> {
    pub(super) rows: usize,
    /// Joined columns, `[rows · n]`; of incomplete rows a guess, for the strength only.
    pub(super) columns: Vec<f64>,
    /// Their variances, if σ is given: else empty.
    pub(super) variances: Vec<f64>,
    pub(super) given: bool,
    /// Variance of a pixel by its own row and some rows around; NaN where nothing tells it.
    pub(super) noise: Vec<f64>,
    /// Rows that go alone.
    pub(super) incomplete: Vec<Option<Joined>>,
    pub(super) truncated: Vec<bool>,
    /// Sums of the squared columns of each row, and of their variances.
    pub(super) squares: Vec<f64>,
    pub(super) variance_sums: Vec<f64>,
    /// The image in units of `scale`.
    pub(super) pixels: Cow<'a, [f64]>,
    pub(super) scale: f64,
    /// The largest magnitude among the pixels, in that unit; 1 for none.
    pub(super) largest: f64,
    sigmas: Option<&'a [f64]>,
    width: usize,
}

/// What one row says.
#[derive(Default)]
struct Said {
    incomplete: Option<Joined>,
    /// Squared differences of the halves, and how many variances of a pixel they hold.
    differences: (f64, f64),
    /// Sums of the squared columns and of their variances.
    sums: (f64, f64),
    /// The largest magnitude among the pixels, and among the columns.
    largest: (f64, f64),
    /// The last column, and its variance.
    last: (f64, f64),
}

impl<'a> Work<'a> {
    pub(super) fn prepare(grid: &Grid, image: &Columns<'a>, memory: &mut Memory) -> Self {
        let Columns { values, sigmas, rows, columns: width } = *image;
        let mut columns = std::mem::take(&mut memory.columns);
        let mut variances = std::mem::take(&mut memory.variances);
        resize(&mut columns, rows * grid.n);
        resize(&mut variances, if sigmas.is_some() { rows * grid.n } else { 0 });
        let mut out = Self {
            rows,
            columns,
            variances,
            given: sigmas.is_some(),
            noise: Vec::new(),
            incomplete: Vec::new(),
            truncated: Vec::new(),
            squares: Vec::new(),
            variance_sums: Vec::new(),
            pixels: Cow::Borrowed(values),
            scale: 1.0,
            largest: 1.0,
            sigmas,
            width,
        };
        let mut said = out.join(grid);
        let largest = said.iter().map(|said| said.largest.0).fold(0.0, f64::max);
        let fits = largest <= 0.0 || (1e-100..1e100).contains(&largest);
        if !fits {
            // Squares must fit. A power of two: nothing is rounded.
            let scale = libm::ldexp(1.0, libm::ilogb(largest).clamp(-1000, 1000));
            out.scale = scale;
            out.pixels = Cow::Owned(values.par_iter().map(|value| value / scale).collect());
            said = out.join(grid);
        }
        out.largest = if largest > 0.0 { largest / out.scale } else { 1.0 };
        out.noise = (0..rows).map(|row| out.noise_about(row, &said)).collect();
        let ends = said.iter().zip(&out.noise).map(|(said, noise)| {
            let variance = if out.given { said.last.1 } else { *noise };
            let sigma = if variance.is_finite() { variance.sqrt() } else { 0.0 };
            said.last.0.abs() > (EDGE_PART * said.largest.1).max(EDGE_SIGMAS * sigma)
        });
        out.truncated = ends.collect();
        (out.squares, out.variance_sums) = said.iter().map(|said| said.sums).unzip();
        out.incomplete = said.into_iter().map(|said| said.incomplete).collect();
        out
    }

    /// Joins the halves of every row.
    fn join(&mut self, grid: &Grid) -> Vec<Said> {
        let mut columns = std::mem::take(&mut self.columns);
        let mut variances = std::mem::take(&mut self.variances);
        let mut said: Vec<Said> = (0..self.rows).map(|_| Said::default()).collect();
        let n = grid.n;
        let work = &*self;
        let rows = said.par_chunks_mut(TASK_ROWS).zip(columns.par_chunks_mut(TASK_ROWS * n)).enumerate();
        let each = |(task, (said, columns)): (usize, (&mut [Said], &mut [f64])), variances: &mut [f64]| {
            let first = task * TASK_ROWS;
            pulp::Arch::new().dispatch(Part { work, grid, first, said, columns, variances });
        };
        if work.given {
            rows.zip(variances.par_chunks_mut(TASK_ROWS * n))
                .for_each(|(row, variances)| each(row, variances));
        } else {
            rows.for_each(|row| each(row, &mut []));
        }
        (self.columns, self.variances) = (columns, variances);
        said
    }

    #[inline(always)]
    fn join_row(
        &self,
        grid: &Grid,
        row: usize,
        memory: &mut [f64],
        columns: &mut [f64],
        variances: &mut [f64],
    ) -> Said {
        let (known, memory) = memory.split_at_mut(self.width);
        let values = &self.pixels[row * self.width..(row + 1) * self.width];
        let known = self.sigmas.map(|sigmas| {
            square_sigmas(&sigmas[row * self.width..(row + 1) * self.width], self.scale, known);
            &*known
        });
        let pixels = Pixels { values, variances: known };
        let bits = largest_bits(values);
        let complete = is_finite(bits) && known.is_none_or(|known| is_finite(largest_bits(known)));
        let mut said = Said::default();
        let last;
        if grid.plain && complete {
            said.differences = fold::join_complete(grid, &pixels, columns, variances, memory);
            last = columns.len() - 1;
        } else {
            let found = fold::join(grid, &pixels);
            found.spread(&pixels, columns, variances);
            said.differences = found.squares;
            last = found.to.saturating_sub(1);
            said.incomplete = Some(found);
        }
        said.sums = (fold::squares(columns), fold::sum(variances));
        said.largest = (largest_finite(values, bits), largest_finite(columns, largest_bits(columns)));
        said.last = (columns[last], variances.get(last).copied().unwrap_or(f64::NAN));
        said
    }

    fn noise_about(&self, row: usize, said: &[Said]) -> f64 {
        let window = row.saturating_sub(NEIGHBOURS)..(row + NEIGHBOURS + 1).min(self.rows);
        let (square, count) = said[window]
            .iter()
            .fold((0.0, 0.0), |sum, one| (sum.0 + one.differences.0, sum.1 + one.differences.1));
        let n = self.columns.len() / self.rows;
        // Or one side only.
        if count > 0.0 { square / count } else { ripple(&self.columns[row * n..(row + 1) * n]) }
    }

    /// Variances of the pixels of a row, if σ is given; NaN where it is not usable.
    pub(super) fn pixel_variances(&self, row: usize) -> Option<Vec<f64>> {
        let mut out = vec![0.0; self.width];
        let sigmas = &self.sigmas?[row * self.width..(row + 1) * self.width];
        square_sigmas(sigmas, self.scale, &mut out);
        Some(out)
    }

    /// Values of the pixels of a row.
    pub(super) fn pixel_values(&self, row: usize) -> &[f64] {
        &self.pixels[row * self.width..(row + 1) * self.width]
    }
}

/// Some rows of an image.
struct Part<'a> {
    work: &'a Work<'a>,
    grid: &'a Grid,
    first: usize,
    said: &'a mut [Said],
    columns: &'a mut [f64],
    variances: &'a mut [f64],
}

impl pulp::WithSimd for Part<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { work, grid, first, said, columns, variances } = self;
        let mut memory = vec![0.0; 3 * work.width];
        let parts = variances.len() / said.len();
        for (k, (said, columns)) in said.iter_mut().zip(columns.chunks_mut(grid.n)).enumerate() {
            let variances = &mut variances[k * parts..(k + 1) * parts];
            *said = work.join_row(grid, first + k, &mut memory, columns, variances);
        }
    }
}

#[inline(always)]
fn square_sigmas(sigmas: &[f64], scale: f64, out: &mut [f64]) {
    // A power of two: so is its inverse.
    let unit = 1.0 / scale;
    for (out, s) in out.iter_mut().zip(sigmas) {
        let s = if *s >= 0.0 { s * unit } else { f64::NAN };
        *out = s * s;
    }
}

/// Makes room; what was there is overwritten.
pub(super) fn resize(values: &mut Vec<f64>, length: usize) {
    if values.len() != length {
        *values = vec![0.0; length];
    }
}

/// Variance of a column by the third differences of neighbours: next to none for a smooth row. Their median, so that edges
/// do not count. NaN for fewer than eight columns.
fn ripple(columns: &[f64]) -> f64 {
    if columns.len() < 8 {
        return f64::NAN;
    }
    let third = |w: &[f64]| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).abs();
    let mut sizes: Vec<f64> = columns.windows(4).map(third).collect();
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    // A normal variable's median magnitude is 0.6745 σ; 1 + 9 + 9 + 1 variances.
    (*median / 0.6745).powi(2) / 20.0
}

/// Bits of the largest magnitude: as integers they are in order, infinity and NaN above all numbers, and vectors can
/// compare them.
#[inline(always)]
fn largest_bits(values: &[f64]) -> u64 {
    values.iter().fold(0, |most, v| most.max(v.to_bits() & (u64::MAX >> 1)))
}

fn is_finite(bits: u64) -> bool {
    bits < f64::INFINITY.to_bits()
}

/// The largest magnitude of those that are finite, from [`largest_bits`].
#[inline(always)]
fn largest_finite(values: &[f64], bits: u64) -> f64 {
    if is_finite(bits) {
        return f64::from_bits(bits);
    }
    values.iter().filter(|v| v.is_finite()).fold(0.0, |most, v| most.max(v.abs()))
}
