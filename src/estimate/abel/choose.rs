//! How strong to regularise: by what the data themselves say, for every row with its neighbours.

use super::filtered::Filtered;
use super::matrix::{self, Matrix};
use super::operators::radius;

/// Rows on each side that have a say in the strength of a row: sprays change slowly along their axis, and the score of one
/// row of a few hundred columns is a noisy guide.
const NEIGHBOURS: usize = 8;

/// Price of a degree of freedom in the score, 1 being plain generalised cross-validation. The plain score follows the noise
/// in one of some rows; 1.4 mends that at the cost of a little bias (Y.-J. Kim, C. Gu, J. R. Stat. Soc. B 66, 337
/// (2004), section 4). As a power of what is left, (1 − f/n)^2.8 for their (1 − 1.4 f/n)², it lets data without noise
/// have as many degrees as they like.
const PRICE: f64 = 1.4;

/// Squares of residuals over those of the noise from which cross-validation is not believed.
const BIAS_MAX: f64 = 4.0;

/// Where strengths come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Strength {
    /// By the discrepancy principle where σ is given, else by generalised cross-validation.
    Automatic,
    /// Generalised cross-validation: least |residual|²/(1 − freedom/n)^2.8.
    CrossValidation,
    /// The strongest whose residuals are no larger than σ explains, but never weaker than by cross-validation.
    Discrepancy,
    /// This: Tikhonov's λ in pixel units, or the number of cosines; at least 0.
    Fixed(f64),
}

/// What a row says.
pub(super) struct Said<'a> {
    /// Coefficients in the basis, `[rows · members]`.
    pub(super) coefficients: &'a [f64],
    /// Σ of the squared columns of each row.
    pub(super) squares: &'a [f64],
    /// Σ of their variances by the data themselves; NaN where nothing tells it.
    pub(super) measured: &'a [f64],
    /// Σ of their given variances, for the discrepancy principle.
    pub(super) given: Option<&'a [f64]>,
}

/// A choice for every row, and in how many the discrepancy principle had no answer.
pub(super) fn choices(filtered: &Filtered, said: &Said<'_>, n: usize) -> (Vec<usize>, usize) {
    let rows = said.squares.len();
    let members = filtered.analysis.columns;
    let count = filtered.choices.len();
    if count == 1 {
        return (vec![0; rows], 0);
    }
    // Residual squares: Σ (1 − φ)² c² and what the basis does not hold.
    let squares: Vec<f64> = said.coefficients.iter().map(|c| c * c).collect();
    let left =
        Matrix::from_fn(members, count, |k, choice| (1.0 - filtered.choices[choice].filter[k]).powi(2));
    let mut residuals = vec![0.0; rows * count];
    matrix::multiply(&squares, members, &left, None, &mut residuals);
    if !filtered.complete {
        let held = squares.chunks(members).map(|c| c.iter().sum::<f64>());
        for ((residuals, held), whole) in residuals.chunks_mut(count).zip(held).zip(said.squares) {
            let rest = (whole - held).max(0.0);
            residuals.iter_mut().for_each(|residual| *residual += rest);
        }
    }
    let freedoms: Vec<f64> = filtered.choices.iter().map(super::filtered::Choice::freedom).collect();
    let n = radius(n, 0.0);
    let prices: Vec<f64> = freedoms
        .iter()
        .map(|freedom| {
            let left = 1.0 - freedom / n;
            if left > 0.0 { 1.0 / libm::pow(left, 2.0 * PRICE) } else { f64::INFINITY }
        })
        .collect();
    let mut failed = 0;
    let each = (0..rows).map(|row| {
        let window = row.saturating_sub(NEIGHBOURS)..(row + NEIGHBOURS + 1).min(rows);
        let mut pooled = vec![0.0; count];
        for row in window.clone() {
            let residuals = &residuals[row * count..(row + 1) * count];
            pooled.iter_mut().zip(residuals).for_each(|(sum, residual)| *sum += residual);
        }
        let measured = noise_of(said.measured, window.clone());
        let mut by_itself = cross_validated(&pooled, &prices);
        // Data without noise do not tell a strength: residuals far beyond what halves or neighbours differ are bias.
        while by_itself > 0 && pooled[by_itself] > BIAS_MAX * measured {
            by_itself -= 1;
        }
        let Some(given) = said.given else { return by_itself };
        let whole = noise_of(given, window.clone());
        // Squares of as many residuals scatter by √(2/number); a fit takes its share of the noise away.
        let scatter = (2.0 / (n * radius(window.len(), 0.0))).sqrt();
        let explained =
            |&choice: &usize| pooled[choice] <= whole * ((1.0 - freedoms[choice] / n).max(0.0) + scatter);
        match (0..count).rev().find(explained) {
            // Where chance or a σ that is too small asks for a fit of the noise, cross-validation knows better.
            Some(choice) if choice >= by_itself => choice,
            _ => {
                failed += 1;
                by_itself
            }
        }
    });
    let found = each.collect();
    (found, failed)
}

/// What is known of the noise in some rows; NaN if it is known of none.
fn noise_of(noise: &[f64], window: std::ops::Range<usize>) -> f64 {
    let rows = radius(window.len(), 0.0);
    let known: Vec<f64> = noise[window].iter().copied().filter(|v| v.is_finite()).collect();
    known.iter().sum::<f64>() * rows / radius(known.len(), 0.0)
}

fn cross_validated(residuals: &[f64], prices: &[f64]) -> usize {
    // From the strongest: of equal scores the stronger is taken. An infinite price of nothing is no score.
    let mut best = (residuals.len() - 1, f64::INFINITY);
    for choice in (0..residuals.len()).rev() {
        let score = residuals[choice] * prices[choice];
        if score < best.1 {
            best = (choice, score);
        }
    }
    best.0
}
