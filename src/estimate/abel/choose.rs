//! How strong to regularise: by what the data themselves say, for every row with its neighbours.

use super::filtered::Filtered;
use super::operators::radius;
use super::product::Number;

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
    /// Σ of the squared columns of each row.
    pub(super) squares: &'a [f64],
    /// Σ of their variances by the data themselves; NaN where nothing tells it.
    pub(super) measured: &'a [f64],
    /// Σ of their given variances, for the discrepancy principle.
    pub(super) given: Option<&'a [f64]>,
}

/// What every choice leaves of every row.
pub(super) struct Residuals<T> {
    /// Sums of squares, `[rows · choices]`.
    pub(super) each: Vec<T>,
    /// Their unit.
    pub(super) unit: f64,
    /// They are not told to better than this part of the squares of the columns.
    pub(super) least: f64,
}

/// A choice for every row, and in how many the discrepancy principle had no answer. None if residuals are too small to be
/// told.
pub(super) fn choices<T: Number + Into<f64>>(
    filtered: &Filtered,
    residuals: &Residuals<T>,
    said: &Said<'_>,
    n: usize,
) -> Option<(Vec<usize>, usize)> {
    let rows = said.squares.len();
    let count = filtered.choices.len();
    let freedoms: Vec<f64> = filtered.choices.iter().map(super::filtered::Choice::freedom).collect();
    let n = radius(n, 0.0);
    let prices: Vec<f64> = freedoms
        .iter()
        .map(|freedom| {
            let left = 1.0 - freedom / n;
            if left > 0.0 { 1.0 / libm::pow(left, 2.0 * PRICE) } else { f64::INFINITY }
        })
        .collect();
    let (mut failed, mut untold) = (0, false);
    let each = (0..rows).map(|row| {
        let window = row.saturating_sub(NEIGHBOURS)..(row + NEIGHBOURS + 1).min(rows);
        let mut pooled = vec![0.0; count];
        pulp::Arch::new().dispatch(Pool { residuals, rows: window.clone(), pooled: &mut pooled });
        let measured = noise_of(said.measured, window.clone());
        let mut by_itself = cross_validated(&pooled, &prices);
        // Data without noise do not tell a strength: residuals far beyond what halves or neighbours differ are bias.
        while by_itself > 0 && pooled[by_itself] > BIAS_MAX * measured {
            by_itself -= 1;
        }
        let columns: f64 = said.squares[window.clone()].iter().sum();
        untold |= pooled[by_itself] < residuals.least * columns;
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
    (!untold).then_some((found, failed))
}

/// Sums the residuals of some rows, choice by choice.
struct Pool<'a, T> {
    residuals: &'a Residuals<T>,
    rows: std::ops::Range<usize>,
    pooled: &'a mut [f64],
}

impl<T: Number + Into<f64>> pulp::WithSimd for Pool<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let count = self.pooled.len();
        for row in self.residuals.each[self.rows.start * count..self.rows.end * count].chunks(count) {
            self.pooled.iter_mut().zip(row).for_each(|(sum, residual)| *sum += (*residual).into());
        }
        self.pooled.iter_mut().for_each(|sum| *sum *= self.residuals.unit);
    }
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
