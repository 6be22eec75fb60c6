//! Answers at the radii, with their variances: one operator for all rows, or a strength for each.

use super::choose::{self, Said, Strength};
use super::filtered::Filtered;
use super::inverter::{Fixed, Inverter, Memory};
use super::matrix::{self, Matrix};
use super::rows::{Work, resize};
use super::single;

/// Answers at the radii.
pub(super) struct Answer {
    pub(super) values: Vec<f64>,
    pub(super) variances: Vec<f64>,
    pub(super) strength: Vec<f64>,
    pub(super) choices: Vec<usize>,
    pub(super) discrepancy_failed: usize,
    /// Answers at the pixels, of rows that went alone.
    pub(super) incomplete: Vec<Option<single::Found>>,
}

impl Answer {
    pub(super) fn empty(work: &Work<'_>, n: usize, memory: &mut Memory) -> Self {
        let mut values = std::mem::take(&mut memory.answers);
        let mut variances = std::mem::take(&mut memory.answer_variances);
        resize(&mut values, work.rows * n);
        resize(&mut variances, work.rows * n);
        Self {
            values,
            variances,
            strength: vec![f64::NAN; work.rows],
            choices: vec![0; work.rows],
            discrepancy_failed: 0,
            incomplete: Vec::new(),
        }
    }
}

impl Inverter {
    pub(super) fn by_operator(&self, work: &Work<'_>, fixed: &Fixed, answer: &mut Answer) {
        let n = self.grid.n;
        matrix::multiply(&work.columns, n, &fixed.across, fixed.reach, &mut answer.values);
        match work.given {
            true => matrix::multiply(&work.variances, n, &fixed.squares, fixed.reach, &mut answer.variances),
            false => {
                let unit = self.unit_variances(&fixed.operator);
                for (row, variances) in answer.variances.chunks_mut(n).enumerate() {
                    variances.iter_mut().zip(&unit).for_each(|(v, unit)| *v = work.noise[row] * unit);
                }
            }
        }
        if let Strength::Fixed(strength) = self.settings.strength
            && self.settings.method.has_strength()
        {
            answer.strength.fill(strength);
        }
    }

    /// Variances at the radii for pixels of variance 1, where both halves are complete.
    fn unit_variances(&self, operator: &Matrix) -> Vec<f64> {
        let share = |(j, d): (usize, &f64)| d * d * self.pixel_share(j);
        (0..self.grid.n).map(|i| operator.row(i).iter().enumerate().map(share).sum()).collect()
    }

    /// Variance of radius `j`, of complete halves, in variances of a pixel.
    fn pixel_share(&self, j: usize) -> f64 {
        let grid = &self.grid;
        let on_axis = usize::from(grid.phase <= 0.0);
        if (on_axis..grid.right.1.min(grid.left.1)).contains(&j) { 0.5 } else { 1.0 }
    }

    fn pixel_shares(&self) -> f64 {
        (0..self.grid.n).map(|j| self.pixel_share(j)).sum()
    }

    pub(super) fn by_filter(&self, work: &Work<'_>, filtered: &Filtered, answer: &mut Answer) {
        let n = self.grid.n;
        let members = filtered.analysis.columns;
        let mut coefficients = vec![0.0; work.rows * members];
        matrix::multiply(&work.columns, n, &filtered.analysis, None, &mut coefficients);
        let squares: Vec<f64> = work.columns.chunks(n).map(|row| row.iter().map(|p| p * p).sum()).collect();
        let measured: Vec<f64> = work.noise.iter().map(|noise| noise * self.pixel_shares()).collect();
        let given: Vec<f64> = work.variances.chunks(n).map(|row| row.iter().sum()).collect();
        let discrepancy = match self.settings.strength {
            Strength::Automatic | Strength::Discrepancy => work.given,
            Strength::CrossValidation | Strength::Fixed(_) => false,
        };
        let said = Said {
            coefficients: &coefficients,
            squares: &squares,
            measured: &measured,
            given: discrepancy.then_some(&given),
        };
        let (choices, failed) = choose::choices(filtered, &said, n);
        for (coefficients, &choice) in coefficients.chunks_mut(members).zip(&choices) {
            let filter = &filtered.choices[choice].filter;
            coefficients.iter_mut().zip(filter).for_each(|(c, filter)| *c *= filter);
        }
        matrix::multiply(&coefficients, members, &filtered.synthesis, None, &mut answer.values);
        for (values, &choice) in answer.values.chunks_mut(n).zip(&choices) {
            let correction = &filtered.choices[choice].correction;
            values.iter_mut().zip(correction).for_each(|(value, factor)| *value *= factor);
        }
        // Variances, choice by choice.
        let mut used = choices.clone();
        used.sort_unstable();
        used.dedup();
        for choice in used {
            let operator = filtered.operator(choice);
            if work.given {
                let squares = operator.transposed().squared();
                let at: Vec<usize> = (0..work.rows).filter(|&row| choices[row] == choice).collect();
                let some: Vec<f64> =
                    at.iter().flat_map(|row| &work.variances[row * n..(row + 1) * n]).copied().collect();
                let mut out = vec![0.0; some.len()];
                matrix::multiply(&some, n, &squares, None, &mut out);
                for (row, out) in at.iter().zip(out.chunks(n)) {
                    answer.variances[row * n..(row + 1) * n].copy_from_slice(out);
                }
            } else {
                let unit = self.unit_variances(&operator);
                for row in (0..work.rows).filter(|&row| choices[row] == choice) {
                    let variances = &mut answer.variances[row * n..(row + 1) * n];
                    variances.iter_mut().zip(&unit).for_each(|(v, unit)| *v = work.noise[row] * unit);
                }
            }
        }
        for (strength, &choice) in answer.strength.iter_mut().zip(&choices) {
            *strength = filtered.choices[choice].strength;
        }
        answer.choices = choices;
        answer.discrepancy_failed = failed;
    }
}
