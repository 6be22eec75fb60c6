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

/// Rows joined to columns at the radii, in units that keep squares finite.
pub(super) struct Work<'a> {
    pub(super) rows: usize,
    /// Joined columns, `[rows · n]`; of incomplete rows a guess, for the strength only.
    pub(super) columns: Vec<f64>,
    /// Their variances, if σ is given: else zero.
    pub(super) variances: Vec<f64>,
    pub(super) given: bool,
    /// Variance of a pixel by its own row and some rows around; NaN where nothing tells it.
    pub(super) noise: Vec<f64>,
    /// Rows that go alone.
    pub(super) incomplete: Vec<Option<Joined>>,
    pub(super) truncated: Vec<bool>,
    /// The image in units of `scale`, and the variances of its pixels.
    pub(super) pixels: Cow<'a, [f64]>,
    pub(super) pixel_variances: Vec<f64>,
    pub(super) scale: f64,
}

impl<'a> Work<'a> {
    pub(super) fn prepare(grid: &Grid, image: &Columns<'a>, memory: &mut Memory) -> Self {
        let Columns { values, sigmas, rows, columns } = *image;
        let n = grid.n;
        let largest = values.par_chunks(columns).map(largest_finite).reduce(|| 0.0, f64::max);
        // Squares must fit. A power of two: nothing is rounded.
        let fits = largest <= 0.0 || (1e-100..1e100).contains(&largest);
        let scale = if fits { 1.0 } else { libm::ldexp(1.0, libm::ilogb(largest).clamp(-1000, 1000)) };
        let scaled = || values.par_iter().map(|value| value / scale).collect();
        let pixels = if fits { Cow::Borrowed(values) } else { Cow::Owned(scaled()) };
        let pixel_variances: Vec<f64> = sigmas
            .map(|sigmas| {
                let each = sigmas.par_iter();
                each.map(|s| if *s >= 0.0 { (s / scale) * (s / scale) } else { f64::NAN }).collect()
            })
            .unwrap_or_default();
        let mut joined = std::mem::take(&mut memory.columns);
        let mut variances = std::mem::take(&mut memory.variances);
        resize(&mut joined, rows * n);
        resize(&mut variances, if sigmas.is_some() { rows * n } else { 0 });
        let mut out = Self {
            rows,
            columns: joined,
            variances,
            given: sigmas.is_some(),
            noise: vec![f64::NAN; rows],
            incomplete: vec![None; rows],
            truncated: vec![false; rows],
            pixels,
            pixel_variances,
            scale,
        };
        let mut none: Vec<[f64; 0]> = vec![[]; rows];
        let mut parts: Vec<&mut [f64]> = if out.given {
            out.variances.chunks_mut(n).collect()
        } else {
            none.iter_mut().map(|none| &mut none[..]).collect()
        };
        let (pixels, pixel_variances) = (&out.pixels, &out.pixel_variances);
        let row_of = |row: usize| {
            let range = row * columns..(row + 1) * columns;
            let variances = sigmas.map(|_| &pixel_variances[range.clone()]);
            Pixels { values: &pixels[range], variances }
        };
        let squares: Vec<(f64, f64)> = out
            .columns
            .par_chunks_mut(n)
            .zip(parts.par_iter_mut())
            .zip(out.incomplete.par_iter_mut())
            .enumerate()
            .map(|(row, ((joined, variances), incomplete))| {
                let pixels = row_of(row);
                let complete = all_finite(pixels.values) && pixels.variances.is_none_or(all_finite);
                if grid.plain && complete {
                    return fold::join_complete(grid, &pixels, joined, variances);
                }
                let found = fold::join(grid, &pixels);
                let squares = found.squares;
                found.spread(&pixels, joined, variances);
                *incomplete = Some(found);
                squares
            })
            .collect();
        drop(parts);
        for row in 0..rows {
            let window = row.saturating_sub(NEIGHBOURS)..(row + NEIGHBOURS + 1).min(rows);
            let (square, count) =
                squares[window].iter().fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            // Or one side only.
            let alone = || ripple(&out.columns[row * n..(row + 1) * n]);
            out.noise[row] = if count > 0.0 { square / count } else { alone() };
        }
        for row in 0..rows {
            out.truncated[row] = out.ends_above_zero(row, n);
        }
        out
    }

    fn ends_above_zero(&self, row: usize, n: usize) -> bool {
        let columns = &self.columns[row * n..(row + 1) * n];
        let last = self.incomplete[row].as_ref().map_or(n, |joined| joined.to).saturating_sub(1);
        let most = largest_finite(columns);
        let variance = if self.given { self.variances[row * n + last] } else { self.noise[row] };
        let sigma = if variance.is_finite() { variance.sqrt() } else { 0.0 };
        columns[last].abs() > (EDGE_PART * most).max(EDGE_SIGMAS * sigma)
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
fn largest_bits(values: &[f64]) -> u64 {
    values.iter().fold(0, |most, v| most.max(v.to_bits() & (u64::MAX >> 1)))
}

fn all_finite(values: &[f64]) -> bool {
    largest_bits(values) < f64::INFINITY.to_bits()
}

/// The largest magnitude of those that are finite.
fn largest_finite(values: &[f64]) -> f64 {
    let bits = largest_bits(values);
    if bits < f64::INFINITY.to_bits() {
        return f64::from_bits(bits);
    }
    values.iter().filter(|v| v.is_finite()).fold(0.0, |most, v| most.max(v.abs()))
}
