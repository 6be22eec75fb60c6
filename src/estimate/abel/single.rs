//! Rows that go alone: with missing pixels, an axis between the radii, bounds, or weights of their own. Variances follow from
//! the weight of every pixel in every answer.

use super::alone::{Alone, Key, Quadratic};
use super::answer::Answer;
use super::fold::{Joined, Pixels};
use super::inverter::Inverter;
use super::matrix::{self, Matrix};
use super::operators::radius;
use super::request::Method;
use super::rows::Work;
use super::{bounded, flag};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Variances below this part of a row's mean count as that: no column outweighs the usual ones by more than a thousand σ.
const VARIANCE_PART: f64 = 1e-6;

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

/// The rows of `work` that go alone, answered; None for the others.
pub(super) fn answers(inverter: &Inverter, work: &Work<'_>, answer: &Answer) -> Vec<Option<Found>> {
    let bounds = inverter.settings.method == Method::DaunNonNegative;
    let weighted = inverter.settings.weighted && inverter.settings.method.has_strength() && work.given;
    let whole = (bounds || weighted).then(|| {
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
    if weighted {
        keys.clear();
    }
    let alone = Alone::new(inverter);
    let operators: BTreeMap<Key, Option<Matrix>> =
        keys.par_iter().map(|&key| (key, alone.operator(key, None))).collect();
    let quadratics: BTreeMap<Key, Quadratic> = if bounds {
        keys.par_iter().map(|&key| (key, alone.quadratic(key, None))).collect()
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
            let found = Row { inverter, joined, pixels, noise: work.noise[row] };
            if weighted {
                let roots = found.roots();
                let Some(operator) = alone.operator(key, Some(&roots)) else {
                    return Some(found.nothing());
                };
                return Some(if bounds {
                    found.bounded(&operator, &alone.quadratic(key, Some(&roots)), &roots)
                } else {
                    found.linear(&operator)
                });
            }
            let linear = operators.get(&key).and_then(Option::as_ref);
            Some(match (linear, quadratics.get(&key)) {
                (Some(operator), None) => found.linear(operator),
                (Some(operator), Some(quadratic)) => {
                    found.bounded(operator, quadratic, &vec![1.0; operator.rows])
                }
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

    /// Roots of the weights of the known radii: their mean variance over their own, so that a strength which fits the noise of
    /// columns that count alike fits this one's.
    fn roots(&self) -> Vec<f64> {
        let variance = |mix: &super::grid::Mix| -> f64 {
            mix.iter().map(|&(c, w)| w * w * self.pixels.variances.map_or(1.0, |known| known[c])).sum()
        };
        let variances: Vec<f64> = self.joined.mixes.iter().map(variance).collect();
        let mean = variances.iter().sum::<f64>() / radius(variances.len(), 0.0);
        let root = |v: &f64| (mean / v.max(VARIANCE_PART * mean)).sqrt();
        variances.iter().map(|v| if mean > 0.0 { root(v) } else { 1.0 }).collect()
    }

    fn linear(&self, operator: &Matrix) -> Found {
        let known = self.columns_known();
        let values = (0..operator.rows)
            .map(|i| operator.row(i).iter().zip(&known).map(|(d, p)| d * p).sum())
            .collect::<Vec<f64>>();
        self.at_pixels(&values, &self.weights(operator), &self.joined.flags)
    }

    /// Under f ≥ 0; `roots` are those of the weights that `quadratic` was formed with.
    fn bounded(&self, operator: &Matrix, quadratic: &Quadratic, roots: &[f64]) -> Found {
        let known = self.columns_known();
        let dot = |row: &[f64]| row.iter().zip(&known).map(|(a, p)| a * p).sum::<f64>();
        let start: Vec<f64> = (0..operator.rows).map(|i| dot(operator.row(i))).collect();
        let across = quadratic.a.transposed();
        let heavy: Vec<f64> = known.iter().zip(roots).map(|(p, root)| p * root).collect();
        let weighted = |row: &[f64]| row.iter().zip(&heavy).map(|(a, p)| a * p).sum::<f64>();
        let b: Vec<f64> = (0..across.rows).map(|i| weighted(across.row(i))).collect();
        let found = bounded::minimum(&quadratic.quadratic, &b, &start);
        let mut flags = self.joined.flags.clone();
        let settled = if found.settled { 0 } else { flag::NOT_SETTLED };
        let mut weights = operator.clone();
        let free = &found.free;
        (0..operator.rows).for_each(|i| flags[self.joined.from + i] |= settled | flag::AT_BOUND);
        // Where values are free the answer is linear in the columns as long as the same ones are free.
        let part = Matrix::from_fn(free.len(), free.len(), |i, j| quadratic.quadratic.at(free[i], free[j]));
        let right = Matrix::from_fn(free.len(), across.columns, |i, j| across.at(free[i], j) * roots[j]);
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
