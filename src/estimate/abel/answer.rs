//! Answers at the radii, with their variances: one operator for all rows, or a strength for each.

use super::bank::{Bank, Short};
use super::choose::{self, Residuals, Said, Strength};
use super::inverter::{Inverter, Kernel, Memory};
use super::operators::radius;
use super::product::{Number, Rows, multiply};
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
    let Chosen { choices, discrepancy_failed, half } = match &inverter.kernel {
        Kernel::Fixed(..) => Chosen::only(work.rows),
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
            // Noise that half of the digits tell is far above what they lose.
            kernel if half => {
                let operator = kernel.operator(choice);
                operator.answers_single(&memory.narrow, work.largest, order, &mut values[at.clone()]);
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

/// A short look leaves this part of the columns' squares to the members that it does not see by subtracting the others: with
/// f32's 1e-7 that rest is good to a half percent.
const SHORT_PART: f64 = 3e-5;
/// Rows that are judged together for that, and how much larger than the rest the last members' mean square may be.
const SHORT_ROWS: usize = 16;
const SHORT_UNLIKE: f64 = 1.25;
/// What a choice may keep of the members that a short look takes for noise of one size.
const SHORT_KEPT: f64 = 0.5;
/// The same where σ does not explain the residuals of some row: these are then good to a few 1e-3.
const SHORT_KEPT_FAILED: f64 = 0.1;

/// A choice of strength for each row.
struct Chosen {
    choices: Vec<usize>,
    discrepancy_failed: usize,
    /// Whether residuals are so large that f32 told them.
    half: bool,
}

impl Chosen {
    /// The only one there is.
    fn only(rows: usize) -> Self {
        Self { choices: vec![0; rows], discrepancy_failed: 0, half: false }
    }

    fn of((choices, discrepancy_failed): (Vec<usize>, usize), half: bool) -> Self {
        Self { choices, discrepancy_failed, half }
    }
}

/// Chooses; leaves the coefficients of the rows in `memory` if the bank is narrow, and the rows in f32 if the choice is
/// told in half of the digits.
fn chosen(inverter: &Inverter, work: &Work<'_>, bank: &Bank, memory: &mut Memory) -> Chosen {
    let n = inverter.grid.n;
    let narrow = bank.is_narrow();
    if bank.filtered.choices.len() == 1 {
        if narrow {
            let order: Vec<usize> = (0..work.rows).collect();
            bank.double().coefficients(&work.columns, &order, &mut memory.coefficients);
        }
        return Chosen::only(work.rows);
    }
    let order: Vec<usize> = (0..work.rows).collect();
    let shares: f64 = inverter.pixel_shares().iter().sum();
    let measured: Vec<f64> = work.noise.iter().map(|noise| noise * shares).collect();
    let discrepancy = match inverter.settings.strength {
        Strength::Automatic | Strength::Discrepancy => work.given,
        Strength::CrossValidation | Strength::Fixed(_) => false,
    };
    let given = discrepancy.then_some(work.variance_sums.as_slice());
    let said = Said { squares: &work.squares, measured: &measured, given };
    if !narrow {
        // Half of the digits are enough to choose, as long as the data are not better than that.
        narrowed(work, memory);
        let short = bank.short().and_then(|short| {
            let residuals = residuals_short(work, short, &order, memory)?;
            let found = choose::choices(&bank.filtered, &residuals, &said, n)?;
            let (choices, failed) = &found;
            // Residuals that differ by a percent decide whether σ explains them.
            let kept_max = if *failed > 0 { SHORT_KEPT_FAILED } else { SHORT_KEPT };
            choices.iter().all(|&choice| short.kept[choice] <= kept_max).then_some(found)
        });
        let found = short.or_else(|| {
            let residuals = residuals_single(work, bank, &order, memory);
            choose::choices(&bank.filtered, &residuals, &said, n)
        });
        if let Some(found) = found {
            return Chosen::of(found, true);
        }
    }
    let residuals = residuals_double(work, bank, &order, memory);
    let found = choose::choices(&bank.filtered, &residuals, &said, n);
    Chosen::of(found.expect("no residual is less than none"), false)
}

/// Columns in units of the largest, in f32.
fn narrowed(work: &Work<'_>, memory: &mut Memory) {
    memory.narrow.resize(work.columns.len(), 0.0);
    singles::narrowed(&work.columns, 1.0 / work.largest, &mut memory.narrow);
}

/// Residuals of every choice from the smoothest members alone: what is left of the columns counts as noise of one size.
/// None where the least smooth of the members show that it is not.
fn residuals_short(
    work: &Work<'_>,
    short: &Short,
    order: &[usize],
    memory: &mut Memory,
) -> Option<Residuals<f32>> {
    let unit = work.largest * work.largest;
    let Memory { narrow, narrow_coefficients: coefficients, .. } = memory;
    short.screen.coefficients(narrow, order, coefficients);
    singles::squared(coefficients);
    let mut each = short.screen.residuals(coefficients);
    let (members, count) = (short.members.len(), short.left.len());
    let blocks = each.chunks_mut(SHORT_ROWS * count).zip(coefficients.chunks(SHORT_ROWS * members));
    for ((residuals, held), whole) in blocks.zip(work.squares.chunks(SHORT_ROWS)) {
        let (mut last, mut rests) = (0.0, 0.0);
        let rows = residuals.chunks_mut(count).zip(held.chunks(members)).zip(whole);
        for ((residuals, held), whole) in rows {
            let sum = |part: &[f32]| part.iter().map(|&square| f64::from(square)).sum::<f64>();
            let rest = (whole / unit - sum(held)).max(0.0);
            last += sum(&held[short.last.clone()]);
            rests += rest;
            let rest = f32::rounded(rest);
            residuals.iter_mut().zip(&short.left).for_each(|(residual, left)| *residual += rest * left);
        }
        if last * short.others > SHORT_UNLIKE * rests * radius(short.last.len(), 0.0) {
            return None;
        }
    }
    Some(Residuals { each, unit, least: SHORT_PART })
}

/// Residuals of every choice in f32.
fn residuals_single(work: &Work<'_>, bank: &Bank, order: &[usize], memory: &mut Memory) -> Residuals<f32> {
    let unit = work.largest;
    let Memory { narrow, narrow_coefficients: coefficients, .. } = memory;
    bank.single().coefficients(narrow, order, coefficients);
    singles::squared(coefficients);
    Residuals { each: bank.single().residuals(coefficients), unit: unit * unit, least: SINGLE_PART }
}

/// In f64; leaves the coefficients in `memory`.
fn residuals_double(work: &Work<'_>, bank: &Bank, order: &[usize], memory: &mut Memory) -> Residuals<f64> {
    bank.double().coefficients(&work.columns, order, &mut memory.coefficients);
    let squares: Vec<f64> = memory.coefficients.iter().map(|c| c * c).collect();
    let mut each = bank.double().residuals(&squares);
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
                let settings =
                    Settings { method, elements, strength, centre: None, pixel_m: 1.0, weighted: false };
                let inverter = Inverter::new(columns, axis, &settings).unwrap();
                let Kernel::Bank(bank) = &inverter.kernel else { panic!("a strength for each row") };
                let mut memory = Memory::default();
                let image = Columns { values: &values, sigmas: None, rows, columns };
                let work = Work::prepare(&inverter.grid, &image, &mut memory);
                let order: Vec<usize> = (0..rows).collect();
                let (n, shares) = (inverter.grid.n, inverter.pixel_shares().iter().sum::<f64>());
                let measured: Vec<f64> = work.noise.iter().map(|noise| noise * shares).collect();
                let said = Said { squares: &work.squares, measured: &measured, given: None };
                narrowed(&work, &mut memory);
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

    /// On wide images the smoothest members choose what all of them do, to one step in a few rows; where an edge goes on
    /// beyond them, or where there is next to no noise, they do not choose. Answers in f32 are off by less than a
    /// thousandth of their σ.
    #[test]
    fn smooth_members_choose_as_all_do() {
        let (rows, columns) = (48, 531);
        let order: Vec<usize> = (0..rows).collect();
        let axis = Axis { column: 265.0, sigma: 0.0, found: false };
        for method in [Method::Daun, Method::Basex] {
            let elements = Elements::Linear;
            let strength = Strength::Automatic;
            let settings =
                Settings { method, elements, strength, centre: None, pixel_m: 1.0, weighted: false };
            let inverter = Inverter::new(columns, axis, &settings).unwrap();
            let Kernel::Bank(bank) = &inverter.kernel else { panic!("a strength for each row") };
            let (short, n) = (bank.short().unwrap(), inverter.grid.n);
            let mut memory = Memory::default();
            let look = |values: &[f64], memory: &mut Memory| {
                let image = Columns { values, sigmas: None, rows, columns };
                let work = Work::prepare(&inverter.grid, &image, memory);
                let said = Said { squares: &work.squares, measured: &vec![f64::NAN; rows], given: None };
                narrowed(&work, memory);
                let seen = residuals_short(&work, short, &order, memory)
                    .and_then(|seen| choose::choices(&bank.filtered, &seen, &said, n));
                let all = residuals_double(&work, bank, &order, memory);
                (seen, choose::choices(&bank.filtered, &all, &said, n).unwrap())
            };
            let noisy = image(rows, columns, 0.3);
            let (seen, all) = look(&noisy, &mut memory);
            let (seen, all) = (seen.unwrap().0, all.0);
            let moved: Vec<usize> = seen.iter().zip(&all).map(|(a, b)| a.abs_diff(*b)).collect();
            assert!(moved.iter().all(|&steps| steps <= 1), "{method:?} {moved:?}");
            assert!(moved.iter().sum::<usize>() * 8 <= rows, "{method:?} {moved:?}");
            assert!(look(&image(rows, columns, 1e-5), &mut memory).0.is_none());
            // A disc's edge between two pixels.
            let mut edged = image(rows, columns, 0.003);
            for (at, value) in edged.iter_mut().enumerate() {
                let y = radius(at % columns, -265.0);
                *value += 1e40 * (101.3 * 101.3 - y * y).max(0.0).sqrt();
            }
            assert!(look(&edged, &mut memory).0.is_none(), "{method:?}");
            let found = inverter.invert(&Columns { values: &noisy, sigmas: None, rows, columns }).unwrap();
            for row in 0..rows {
                let operator = bank.operator(seen[row]);
                for i in 1..n {
                    let column =
                        |k: usize| 0.5 * (noisy[row * columns + 265 + k] + noisy[row * columns + 265 - k]);
                    let double: f64 = (0..n).map(|k| operator.matrix.at(i, k) * column(k)).sum();
                    let at = row * columns + 265 + i;
                    let off = (found.alpha_per_m[at] - double).abs() / found.sigma_alpha[at];
                    assert!(off < 1e-3, "{method:?} {row} {i}: {off}");
                }
            }
        }
    }
}
