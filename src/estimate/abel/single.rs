//! Rows that go alone: with missing pixels, an axis between the radii, or bounds. The operator is formed for the radii that
//! are known, and variances follow from the weight of every pixel in every answer.

use super::answer::Answer;
use super::elements;
use super::filtered::{self, cosines_seen, orthogonal, roughness};
use super::fold::{Joined, Pixels};
use super::inverter::{Inverter, Kernel};
use super::matrix::{self, Matrix};
use super::request::Method;
use super::rows::Work;
use super::{bounded, flag};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Shells of BASEX this far inside the first known radius reach beyond it.
const SHELL_REACH: usize = 3;

/// Least strength of BASEX where shells outnumber columns, relative to the mean square of a shell.
const SHELL_STRENGTH_MIN: f64 = 1e-10;

/// Answers at the pixels of one row.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub(super) values: Vec<f64>,
    pub(super) variances: Vec<f64>,
    pub(super) flags: Vec<u32>,
}

impl Joined {
    /// Columns at all radii, for a first look: what is missing about the axis is flat, and nothing lies beyond.
    pub(super) fn spread(&self, pixels: &Pixels<'_>, columns: &mut [f64], variances: &mut [f64]) {
        columns.fill(0.0);
        variances.fill(0.0);
        for (mix, i) in self.mixes.iter().zip(self.from..) {
            columns[i] = mix.iter().map(|&(c, w)| w * pixels.values[c]).sum();
            if let (Some(known), Some(variance)) = (pixels.variances, variances.get_mut(i)) {
                *variance = mix.iter().map(|&(c, w)| w * w * known[c]).sum();
            }
        }
        if let Some(&first) = columns.get(self.from) {
            columns[..self.from].fill(first);
        }
        if let Some(&first) = variances.get(self.from) {
            variances[..self.from].fill(first);
        }
    }
}

/// Operators are alike for rows of the same known radii and choice.
type Key = (usize, usize, usize);

/// The rows of `work` that go alone, answered; None for the others.
pub(super) fn answers(inverter: &Inverter, work: &Work<'_>, answer: &Answer) -> Vec<Option<Found>> {
    let bounds = inverter.settings.method == Method::DaunNonNegative;
    let whole = bounds.then(|| {
        // Complete rows take part as well: their pixels are asked for anew.
        (0..work.rows).map(|row| joined_again(inverter, work, row)).collect::<Vec<Joined>>()
    });
    let row_of = |row: usize| match &whole {
        Some(all) => Some(&all[row]),
        None => work.incomplete[row].as_ref(),
    };
    let key = |row: usize, joined: &Joined| (joined.from, joined.to, answer.choices[row]);
    let mut keys: Vec<Key> =
        (0..work.rows).filter_map(|row| row_of(row).map(|joined| key(row, joined))).collect();
    keys.sort_unstable();
    keys.dedup();
    let operators: BTreeMap<Key, Option<Matrix>> =
        keys.par_iter().map(|&key| (key, operator(inverter, key))).collect();
    let quadratics: BTreeMap<Key, Quadratic> = if bounds {
        keys.par_iter().map(|&key| (key, Quadratic::new(inverter, key))).collect()
    } else {
        BTreeMap::new()
    };
    (0..work.rows)
        .into_par_iter()
        .map(|row| {
            let joined = row_of(row)?;
            let key = key(row, joined);
            let variances = work.pixel_variances(row);
            let pixels = Pixels { values: work.pixel_values(row), variances: variances.as_deref() };
            let linear = operators.get(&key).and_then(Option::as_ref);
            let found = Row { inverter, joined, pixels, noise: work.noise[row] };
            Some(match (linear, quadratics.get(&key)) {
                (Some(operator), None) => found.linear(operator),
                (Some(operator), Some(quadratic)) => found.bounded(operator, quadratic),
                (None, _) => found.nothing(),
            })
        })
        .collect()
}

fn joined_again(inverter: &Inverter, work: &Work<'_>, row: usize) -> Joined {
    let known = work.incomplete[row].clone();
    known.unwrap_or_else(|| {
        let variances = work.pixel_variances(row);
        let pixels = Pixels { values: work.pixel_values(row), variances: variances.as_deref() };
        super::fold::join(&inverter.grid, &pixels)
    })
}

/// The operator on the radii `from` ‥ `to` alone: nothing is beyond, nothing is asked of what is inside. None where there
/// is no radius or no answer.
fn operator(inverter: &Inverter, key: Key) -> Option<Matrix> {
    let (from, to, choice) = key;
    let (n, phase) = (inverter.grid.n, inverter.grid.phase);
    if from >= to {
        return None;
    }
    let trimmed =
        |matrix: &Matrix| Matrix::from_fn(to - from, to - from, |i, j| matrix.at(from + i, from + j));
    match &inverter.kernel {
        Kernel::Fixed(fixed, Some(reach)) => {
            let reach = *reach;
            let mut out = trimmed(&fixed.matrix);
            // The column just inside is not known: the parabola through the first three goes on.
            for i in 0..out.rows.min(reach) {
                for lost in from.saturating_sub(reach)..from {
                    let weight = fixed.matrix.at(from + i, lost);
                    #[expect(clippy::cast_precision_loss, reason = "one or two radii")]
                    let t = -((from - lost) as f64);
                    let parabola = match out.columns {
                        1 => vec![1.0],
                        2 => vec![1.0 - t, t],
                        _ => vec![0.5 * (t - 1.0) * (t - 2.0), t * (2.0 - t), 0.5 * t * (t - 1.0)],
                    };
                    out.row_mut(i).iter_mut().zip(&parabola).for_each(|(d, share)| *d += weight * share);
                }
            }
            Some(out)
        }
        kernel if from == 0 && to == n => Some(kernel.operator(choice).matrix.clone()),
        _ => {
            let strength = inverter.strength(choice);
            match inverter.settings.method {
                Method::Basex => {
                    let shells = filtered::shells(n, phase);
                    let first = from.saturating_sub(SHELL_REACH);
                    let part =
                        |m: &Matrix| Matrix::from_fn(to - from, to - first, |i, k| m.at(from + i, first + k));
                    let (seen, own) = (part(&shells.seen), part(&shells.own));
                    let mut normal = seen.transposed().times(&seen);
                    #[expect(clippy::cast_precision_loss, reason = "numbers of radii")]
                    let mean = (0..normal.rows).map(|k| normal.at(k, k)).sum::<f64>() / normal.rows as f64;
                    let least = strength.max(SHELL_STRENGTH_MIN * mean);
                    (0..normal.rows).for_each(|k| normal.row_mut(k)[k] += least);
                    let mut out = own.times(&matrix::solve_positive(&normal, &seen.transposed())?);
                    // The disc that the whole row is corrected with, as far as it is known here.
                    let (disc, chords) = filtered::soft_disc(to, phase);
                    for i in 0..out.rows {
                        let made: f64 = out.row(i).iter().zip(&chords[from..]).map(|(d, p)| d * p).sum();
                        let factor = filtered::correction(made, disc[from + i]);
                        out.row_mut(i).iter_mut().for_each(|d| *d *= factor);
                    }
                    Some(out)
                }
                Method::Fourier => {
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "a number of cosines"
                    )]
                    let cosines = (strength.max(0.0) as usize).min((to - from) / 2);
                    let (seen, own) = cosines_seen(n, phase, cosines);
                    let cut = |m: &Matrix| Matrix::from_fn(to - from, cosines + 1, |i, k| m.at(from + i, k));
                    let both = orthogonal(&cut(&seen), &cut(&own), 0);
                    Some(both.meaning.times(&both.basis.transposed()))
                }
                _ => {
                    let Quadratic { a, quadratic, .. } = Quadratic::new(inverter, key);
                    matrix::solve_positive(&quadratic, &a.transposed())
                }
            }
        }
    }
}

/// |A f − p|² + λ |L f|² on the radii `from` ‥ `to`.
struct Quadratic {
    a: Matrix,
    quadratic: Matrix,
}

impl Quadratic {
    fn new(inverter: &Inverter, key: Key) -> Self {
        let (from, to, choice) = key;
        let (grid, strength) = (&inverter.grid, inverter.strength(choice));
        let whole = elements::columns(inverter.settings.elements, grid.n, grid.phase);
        let a = elements::part(&whole, from, to);
        let mut quadratic = a.transposed().times(&a);
        let rough = roughness(to - from);
        quadratic.values.iter_mut().zip(&rough.values).for_each(|(v, rough)| *v += strength * rough);
        Self { a, quadratic }
    }
}

/// One row that goes alone.
struct Row<'a> {
    inverter: &'a Inverter,
    joined: &'a Joined,
    pixels: Pixels<'a>,
    noise: f64,
}

impl Row<'_> {
    /// No answer at any pixel.
    fn nothing(&self) -> Found {
        let columns = self.inverter.grid.columns;
        let mut flags = vec![flag::HIDDEN; columns];
        self.mark_missing(&mut flags);
        Found { values: vec![f64::NAN; columns], variances: vec![f64::NAN; columns], flags }
    }

    fn mark_missing(&self, flags: &mut [u32]) {
        for (column, flags) in flags.iter_mut().enumerate() {
            *flags |= if self.pixels.known(column) { 0 } else { flag::NO_INPUT };
        }
    }

    fn columns_known(&self) -> Vec<f64> {
        let value = |mix: &super::grid::Mix| mix.iter().map(|&(c, w)| w * self.pixels.values[c]).sum();
        self.joined.mixes.iter().map(value).collect()
    }

    fn linear(&self, operator: &Matrix) -> Found {
        let known = self.columns_known();
        let values = (0..operator.rows)
            .map(|i| operator.row(i).iter().zip(&known).map(|(d, p)| d * p).sum())
            .collect::<Vec<f64>>();
        self.at_pixels(&values, &self.weights(operator), &self.joined.flags)
    }

    fn bounded(&self, operator: &Matrix, quadratic: &Quadratic) -> Found {
        let known = self.columns_known();
        let dot = |row: &[f64]| row.iter().zip(&known).map(|(a, p)| a * p).sum::<f64>();
        let start: Vec<f64> = (0..operator.rows).map(|i| dot(operator.row(i))).collect();
        let across = quadratic.a.transposed();
        let b: Vec<f64> = (0..across.rows).map(|i| dot(across.row(i))).collect();
        let found = bounded::minimum(&quadratic.quadratic, &b, &start);
        let mut flags = self.joined.flags.clone();
        let settled = if found.settled { 0 } else { flag::NOT_SETTLED };
        let mut weights = operator.clone();
        let free = &found.free;
        (0..operator.rows).for_each(|i| flags[self.joined.from + i] |= settled | flag::AT_BOUND);
        // Where values are free the answer is linear in the columns as long as the same ones are free.
        let part = Matrix::from_fn(free.len(), free.len(), |i, j| quadratic.quadratic.at(free[i], free[j]));
        let right = Matrix::from_fn(free.len(), across.columns, |i, j| across.at(free[i], j));
        let solved = matrix::solve_positive(&part, &right);
        for (k, &i) in free.iter().enumerate() {
            flags[self.joined.from + i] &= !flag::AT_BOUND;
            if let Some(solved) = &solved {
                weights.row_mut(i).copy_from_slice(solved.row(k));
            }
        }
        self.at_pixels(&found.values, &self.weights(&weights), &flags)
    }

    /// Weight of every pixel in every radius.
    fn weights(&self, operator: &Matrix) -> Matrix {
        let mut out = Matrix::zeros(operator.rows, self.inverter.grid.columns);
        for i in 0..operator.rows {
            let row = &mut out.values[i * out.columns..(i + 1) * out.columns];
            for (d, mix) in operator.row(i).iter().zip(&self.joined.mixes) {
                mix.iter().for_each(|&(column, weight)| row[column] += d * weight);
            }
        }
        out
    }

    fn at_pixels(&self, values: &[f64], weights: &Matrix, radius_flags: &[u32]) -> Found {
        let grid = &self.inverter.grid;
        let known = self.joined.from..self.joined.to;
        let mut out = self.nothing();
        let mut sum = vec![0.0; grid.columns];
        for column in 0..grid.columns {
            let mix = grid.radii(column);
            out.flags[column] &= !flag::HIDDEN;
            mix.iter().for_each(|&(i, _)| out.flags[column] |= radius_flags[i]);
            if !mix.iter().all(|(i, _)| known.contains(i)) {
                out.flags[column] |= flag::HIDDEN;
                continue;
            }
            out.values[column] = mix.iter().map(|&(i, w)| w * values[i - known.start]).sum();
            sum.fill(0.0);
            for &(i, w) in &mix {
                sum.iter_mut().zip(weights.row(i - known.start)).for_each(|(sum, value)| *sum += w * value);
            }
            let variance = |(weight, column): (&f64, usize)| match self.pixels.variances {
                _ if *weight == 0.0 => 0.0,
                Some(variances) => weight * weight * variances[column],
                None => weight * weight * self.noise,
            };
            out.variances[column] = sum.iter().zip(0..).map(variance).sum();
        }
        out
    }
}
