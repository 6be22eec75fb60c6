//! Answers at the radii, with their variances: one operator for all rows, or a strength for each.

use super::bank::Bank;
use super::choose::{self, Residuals, Said, Strength};
use super::inverter::{Inverter, Kernel, Memory};
use super::product::{Rows, multiply};
use super::rows::{Work, resize};
use super::{single, singles};
use std::ops::Range;

/// Answers at the radii, row by row in the order of `place`.
pub(super) struct Answer {
    pub(super) values: Vec<f64>,
    /// Empty where no σ is given: the noise of the row tells it then.
    pub(super) variances: Vec<f64>,
    /// Where the answers of each row of the image are.
    pub(super) place: Vec<usize>,
    pub(super) strength: Vec<f64>,
    pub(super) choices: Vec<usize>,
    pub(super) discrepancy_failed: usize,
    /// Answers at the pixels, of rows that went alone.
    pub(super) incomplete: Vec<Option<single::Found>>,
}

/// Rows ordered by their choices, so that those of one operator are together.
struct Runs {
    order: Vec<usize>,
    /// A choice and its part of `order`.
    runs: Vec<(usize, Range<usize>)>,
}

impl Runs {
    fn of(choices: &[usize]) -> Self {
        let mut order: Vec<usize> = (0..choices.len()).collect();
        order.sort_by_key(|&row| choices[row]);
        let mut runs: Vec<(usize, Range<usize>)> = Vec::new();
        for (at, &row) in order.iter().enumerate() {
            match runs.last_mut() {
                Some((choice, range)) if *choice == choices[row] => range.end = at + 1,
                _ => runs.push((choices[row], at..at + 1)),
            }
        }
        Self { order, runs }
    }
}

/// The answers of all rows.
pub(super) fn answers(inverter: &Inverter, work: &Work<'_>, memory: &mut Memory) -> Answer {
    let n = inverter.grid.n;
    let mut values = std::mem::take(&mut memory.answers);
    let mut variances = std::mem::take(&mut memory.answer_variances);
    resize(&mut values, work.rows * n);
    resize(&mut variances, if work.given { work.rows * n } else { 0 });
    let Chosen { choices, discrepancy_failed } = match &inverter.kernel {
        Kernel::Fixed(..) => Chosen { choices: vec![0; work.rows], discrepancy_failed: 0 },
        Kernel::Bank(bank) => chosen(inverter, work, bank, memory),
    };
    let Runs { order, runs } = Runs::of(&choices);
    for (choice, range) in runs {
        let order = &order[range.clone()];
        let at = range.start * n..range.end * n;
        match &inverter.kernel {
            Kernel::Bank(bank) if bank.is_narrow() => {
                bank.synthesised(choice, &memory.coefficients, order, &mut values[at.clone()]);
            }
            kernel => {
                let rows = Rows { values: &work.columns, stride: n, order, depth: n };
                multiply(&rows, &kernel.operator(choice).across, &mut values[at.clone()]);
            }
        }
        if work.given {
            inverter.kernel.operator(choice).variances(&work.variances, order, &mut variances[at]);
        }
    }
    let strength = choices.iter().map(|&choice| inverter.strength(choice)).collect();
    let mut place = vec![0; work.rows];
    order.iter().enumerate().for_each(|(at, &row)| place[row] = at);
    Answer { values, variances, place, strength, choices, discrepancy_failed, incomplete: Vec::new() }
}

/// Residuals below this part of the columns, in squares, are not told by f32: its coefficients are good to a few 1e-7 of the
/// columns, hence residuals to a few thousandths at worst, and to 1e-5 as rounding adds up by chance.
const SINGLE_PART: f64 = 1e-6;

/// A choice of strength for each row.
struct Chosen {
    choices: Vec<usize>,
    discrepancy_failed: usize,
}

impl From<(Vec<usize>, usize)> for Chosen {
    fn from((choices, discrepancy_failed): (Vec<usize>, usize)) -> Self {
        Self { choices, discrepancy_failed }
    }
}

/// Chooses; leaves the coefficients of the rows in `memory` if the bank is narrow.
fn chosen(inverter: &Inverter, work: &Work<'_>, bank: &Bank, memory: &mut Memory) -> Chosen {
    let n = inverter.grid.n;
    let order: Vec<usize> = (0..work.rows).collect();
    let narrow = bank.is_narrow();
    if bank.filtered.choices.len() == 1 {
        if narrow {
            bank.double().coefficients(&work.columns, &order, &mut memory.coefficients);
        }
        return Chosen { choices: vec![0; work.rows], discrepancy_failed: 0 };
    }
    let shares: f64 = inverter.pixel_shares().iter().sum();
    let measured: Vec<f64> = work.noise.iter().map(|noise| noise * shares).collect();
    let discrepancy = match inverter.settings.strength {
        Strength::Automatic | Strength::Discrepancy => work.given,
        Strength::CrossValidation | Strength::Fixed(_) => false,
    };
    let given = discrepancy.then_some(work.variance_sums.as_slice());
    let said = Said { squares: &work.squares, measured: &measured, given };
    // Half of the digits are enough to choose, as long as the data are not better than that.
    let mut quick = || {
        let residuals = residuals_single(work, bank, &order, memory);
        choose::choices(&bank.filtered, &residuals, &said, n)
    };
    if let Some(found) = if narrow { None } else { quick() } {
        return found.into();
    }
    let residuals = residuals_double(work, bank, &order, memory);
    choose::choices(&bank.filtered, &residuals, &said, n).expect("no residual is less than none").into()
}

/// Residuals of every choice in f32.
fn residuals_single(work: &Work<'_>, bank: &Bank, order: &[usize], memory: &mut Memory) -> Residuals<f32> {
    let unit = work.largest;
    let Memory { narrow, narrow_coefficients: coefficients, .. } = memory;
    narrow.resize(work.columns.len(), 0.0);
    singles::narrowed(&work.columns, 1.0 / unit, narrow);
    bank.single().coefficients(narrow, order, coefficients);
    singles::squared(coefficients);
    Residuals { each: bank.single().residuals(coefficients, order), unit: unit * unit, least: SINGLE_PART }
}

/// In f64; leaves the coefficients in `memory`.
fn residuals_double(work: &Work<'_>, bank: &Bank, order: &[usize], memory: &mut Memory) -> Residuals<f64> {
    bank.double().coefficients(&work.columns, order, &mut memory.coefficients);
    let squares: Vec<f64> = memory.coefficients.iter().map(|c| c * c).collect();
    let mut each = bank.double().residuals(&squares, order);
    if !bank.filtered.complete {
        // What the basis does not hold.
        let members = bank.filtered.analysis.columns;
        let held = squares.chunks(members).map(|held| held.iter().sum::<f64>());
        let rests = held.zip(&work.squares).map(|(held, whole)| (whole - held).max(0.0));
        for (residuals, rest) in each.chunks_mut(bank.filtered.choices.len()).zip(rests) {
            residuals.iter_mut().for_each(|residual| *residual += rest);
        }
    }
    Residuals { each, unit: 1.0, least: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::super::centre::Axis;
    use super::super::operators::radius;
    use super::super::request::{Columns, Elements, Method, Settings};
    use super::*;

    /// Columns of a Gaussian with `noise` (over its largest column) that is uniform.
    fn image(rows: usize, columns: usize, noise: f64) -> Vec<f64> {
        let mut state = 3_u64;
        (0..rows * columns)
            .map(|at| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                #[expect(clippy::cast_precision_loss, reason = "53 bits")]
                let uniform = (state >> 11) as f64 / 9_007_199_254_740_992.0 - 0.5;
                let r = (radius(at % columns, 0.0) - 60.0) / 25.0;
                1e40 * ((-r * r).exp() + noise * uniform)
            })
            .collect()
    }

    /// Residuals in f32 are those of f64 to what their least part allows, and choose the same strengths; where the data
    /// are better than f32 they do not choose.
    #[test]
    fn half_of_the_digits_choose_the_same_strengths() {
        let (rows, columns) = (40, 121);
        for method in [Method::Daun, Method::Basex] {
            for (noise, told) in [(0.05, true), (0.01, true), (1e-6, false), (0.0, false)] {
                let values = image(rows, columns, noise);
                let axis = Axis { column: 60.0, sigma: 0.0, found: false };
                let strength = Strength::Automatic;
                let elements = Elements::Linear;
                let settings = Settings { method, elements, strength, centre: None, pixel_m: 1.0 };
                let inverter = Inverter::new(columns, axis, &settings).unwrap();
                let Kernel::Bank(bank) = &inverter.kernel else { panic!("a strength for each row") };
                let mut memory = Memory::default();
                let image = Columns { values: &values, sigmas: None, rows, columns };
                let work = Work::prepare(&inverter.grid, &image, &mut memory);
                let order: Vec<usize> = (0..rows).collect();
                let (n, shares) = (inverter.grid.n, inverter.pixel_shares().iter().sum::<f64>());
                let measured: Vec<f64> = work.noise.iter().map(|noise| noise * shares).collect();
                let said = Said { squares: &work.squares, measured: &measured, given: None };
                let double = residuals_double(&work, bank, &order, &mut memory);
                let single = residuals_single(&work, bank, &order, &mut memory);
                let largest = work.squares.iter().copied().fold(0.0, f64::max);
                for (double, single) in double.each.iter().zip(&single.each) {
                    // Coefficients to 1e-6 of the columns: √(residual · columns) · 2e-6, and its own rounding.
                    let error = f64::from(*single) * work.largest.powi(2) - double;
                    assert!(
                        error.abs() <= 2e-6 * (double * largest).sqrt() + 1e-12 * largest + 1e-5 * double
                    );
                }
                let choices = choose::choices(&bank.filtered, &single, &said, n);
                assert_eq!(choices.is_some(), told, "{method:?} {noise}");
                if let Some(choices) = choices {
                    assert_eq!(Some(choices), choose::choices(&bank.filtered, &double, &said, n));
                }
            }
        }
    }
}
