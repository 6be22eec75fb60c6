//! Errors and interval coverage of the estimators on made-up shots, beside the best that any fit of a pixel can do.
//!
//! The oracle is the line weighted with the true variances: no unbiased fit of a pixel's means has a smaller error.

use super::shots::{self, Field, Truth};
use crate::estimate::line;
use crate::estimate::map::{DitMap, Estimator, FitInputs, solve};
use rayon::prelude::*;

/// Confidence of one standard deviation.
const ONE_SIGMA: f64 = 0.682_689_492_137_086;

/// Emissivity above which errors are taken; coverage is taken everywhere.
const EMISSIVITY_MIN: f64 = 0.2;

/// Errors and coverage of one estimator.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Score {
    /// Rms error of T in K, and of ε.
    pub(super) rmse_k: f64,
    pub(super) rmse_emissivity: f64,
    /// Part of the 68 % sets that hold T and ε.
    pub(super) held_68: [f64; 2],
    /// The same of the 95 % sets.
    pub(super) held_95: [f64; 2],
    /// Part of the pixels whose 95 % set is reported as not resolved.
    pub(super) unresolved: f64,
    /// Pixels with ε > 0.2 that have no temperature.
    pub(super) without: usize,
    /// Pixels that were judged.
    pub(super) draws: usize,
}

/// Sums for a [`Score`].
#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    squares_k: f64,
    squares_emissivity: f64,
    errors: f64,
    held_68: [f64; 2],
    held_95: [f64; 2],
    unresolved: f64,
    without: usize,
    draws: usize,
}

impl Tally {
    pub(super) fn score(&self) -> Score {
        #[expect(clippy::cast_precision_loss, reason = "a number of pixels")]
        let draws = self.draws as f64;
        Score {
            rmse_k: (self.squares_k / self.errors).sqrt(),
            rmse_emissivity: (self.squares_emissivity / self.errors).sqrt(),
            held_68: self.held_68.map(|n| n / draws),
            held_95: self.held_95.map(|n| n / draws),
            unresolved: self.unresolved / draws,
            without: self.without,
            draws: self.draws,
        }
    }

    /// Takes one answer where errors are taken.
    pub(super) fn error(&mut self, temperature_k: f64, emissivity: f64, truth: &Truth) {
        if truth.emissivity <= EMISSIVITY_MIN {
            return;
        }
        if !temperature_k.is_finite() {
            self.without += 1;
            return;
        }
        self.errors += 1.0;
        self.squares_k += (temperature_k - truth.temperature_k).powi(2);
        self.squares_emissivity += (emissivity - truth.emissivity).powi(2);
    }
}

/// Whether the sets of a map hold the truth of pixel `i`: T and ε. An end that is NaN is open.
fn holds(map: &DitMap, i: usize, truth: &Truth) -> [f64; 2] {
    let inside = |low: f64, value: f64, high: f64| {
        f64::from(u8::from((low.is_nan() || low <= value) && (high.is_nan() || value <= high)))
    };
    [
        inside(map.temperature_low_k[i], truth.temperature_k, map.temperature_high_k[i]),
        inside(map.emissivity_low[i], truth.emissivity, map.emissivity_high[i]),
    ]
}

/// What is judged: `cycles` pairs a level, over `repeats` maps of new shots.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trial {
    pub(super) field: Field,
    pub(super) cycles: usize,
    pub(super) repeats: u64,
    pub(super) seed: u64,
}

/// Scores of the oracle and of each of `fits`, on the same shots.
pub(super) fn scores(trial: &Trial, truths: &[Truth], fits: &[FitInputs<'_>]) -> (Score, Vec<Score>) {
    let mut oracle = Tally::default();
    let mut tallies = vec![Tally::default(); fits.len()];
    for repeat in 0..trial.repeats {
        let sums = trial.field.sums(trial.cycles, trial.seed + repeat);
        tally_oracle(&sums, trial, truths, &mut oracle);
        for (inputs, tally) in fits.iter().zip(&mut tallies) {
            let wide = solve(&sums, inputs);
            let narrow = solve(&sums, &FitInputs { confidence: ONE_SIGMA, ..inputs.clone() });
            for (i, truth) in truths.iter().enumerate() {
                tally.draws += 1;
                tally.error(wide.temperature_k[i], wide.emissivity[i], truth);
                for (sums, held) in [
                    (&mut tally.held_95, holds(&wide, i, truth)),
                    (&mut tally.held_68, holds(&narrow, i, truth)),
                ] {
                    sums.iter_mut().zip(held).for_each(|(sum, held)| *sum += held);
                }
                let open = wide.flags[i] & crate::estimate::map::flag::NOT_RESOLVED != 0;
                tally.unresolved += f64::from(u8::from(open));
            }
        }
    }
    (oracle.score(), tallies.iter().map(Tally::score).collect())
}

fn tally_oracle(
    sums: &crate::estimate::accumulate::Sums,
    trial: &Trial,
    truths: &[Truth],
    tally: &mut Tally,
) {
    let x = shots::abscissae();
    #[expect(clippy::cast_precision_loss, reason = "a number of cycles")]
    let n = trial.cycles as f64;
    let lines: Vec<Option<line::Line>> = truths
        .par_iter()
        .enumerate()
        .map(|(i, truth)| {
            let y: Vec<f64> = sums
                .levels()
                .iter()
                .map(|level| crate::estimate::accumulate::mean(level.sum(i), level.count(i), 1))
                .collect();
            let w = truth.variance.map(|v| n / v);
            line::weighted(&x, &y, &w)
        })
        .collect();
    for (line, truth) in lines.iter().zip(truths) {
        tally.draws += 1;
        if let Some(line) = line {
            tally.error(shots::temperature(line.crossing), shots::emissivity(line.slope), truth);
        }
    }
}

/// The estimators with their names, as the bench judges them.
pub(super) fn estimators() -> [Estimator; 3] {
    [Estimator::Default, Estimator::Paper, Estimator::Ols]
}

#[cfg(test)]
mod tests {
    use super::super::shots::{CALM, CAMERA, PLATES_K, Regime, STRONG};
    use super::*;
    use crate::estimate::predict::{Expected, Forecast, Visit, sigma_of_plan};

    fn visits(cycles: f64) -> Vec<Visit> {
        PLATES_K.iter().map(|&plate_k| Visit { plate_k, cycles }).collect()
    }

    /// The goals on one map of a kind, against the oracle on the same shots: RMSE of T within 5 % at two cycles, 4 %
    /// from three on, 8 % at one; never 1 % worse than the paper's; sets that hold the truth. 20 480 pixels, half of
    /// their scatter shared by blocks of 16: a fraction has a standard error of 1 %, ratios on equal shots far less.
    #[test]
    fn default_is_near_the_oracle_and_honest() {
        for regime in [CALM, STRONG] {
            let field = Field { rows: 96, columns: 120, regime, common: 0.5 };
            let truths = field.truths();
            for (cycles, factor) in [(1, 1.08), (2, 1.05), (3, 1.04), (10, 1.04)] {
                let trial = Trial { field, cycles, repeats: 1, seed: 40 };
                let fits = [Estimator::Default, Estimator::Paper].map(|one| shots::inputs(one, CAMERA));
                let (oracle, found) = scores(&trial, &truths, &fits);
                let [ours, paper] = [found[0], found[1]];
                let say = format!("{} n {cycles}: {ours:?} {oracle:?}", regime.name);
                assert!(ours.rmse_k <= factor * oracle.rmse_k, "{say}");
                assert!(ours.rmse_k <= 1.01 * paper.rmse_k, "{say}");
                if cycles >= 2 {
                    assert!(ours.held_68.iter().all(|held| (0.61..=0.75).contains(held)), "{say}");
                    assert!(ours.held_95.iter().all(|held| (0.92..=0.985).contains(held)), "{say}");
                }
            }
        }
    }

    /// The prediction for a spray that is only expected is the oracle's error: small changes of ε and T from shot to
    /// shot leave out its second order, 3 % at 25 % of depth; 10 752 pixels have 1 %.
    #[test]
    fn a_plans_sigma_is_the_oracles_error() {
        for (regime, bound) in [(CALM, 0.03), (STRONG, 0.06)] {
            let field = Field { rows: 96, columns: 112, regime, common: 0.0 };
            let truths = field.truths();
            let trial = Trial { field, cycles: 5, repeats: 1, seed: 3 };
            let inputs = shots::inputs(Estimator::Default, CAMERA);
            let (oracle, _) = scores(&trial, &truths, std::slice::from_ref(&inputs));
            let (mut squares, mut n) = (0.0, 0.0);
            for truth in truths.iter().filter(|truth| truth.emissivity > EMISSIVITY_MIN) {
                let Regime { sigma_ln_depth, sigma_k, .. } = regime;
                let spray = Expected {
                    emissivity: truth.emissivity,
                    temperature_k: truth.temperature_k,
                    sigma_ln_depth,
                    sigma_k,
                    correlation: -0.4,
                };
                squares += sigma_of_plan(&spray, &visits(5.0), &inputs, 1.0).powi(2);
                n += 1.0;
            }
            let predicted = (squares / n).sqrt();
            assert!((predicted / oracle.rmse_k - 1.0).abs() < bound, "{predicted} {}", oracle.rmse_k);
        }
    }

    /// From five cycles of a running campaign the median σ after five more is foreseen within 5 % of what they then
    /// bring; a further cycle helps, and more so at the level that a brute search finds.
    #[test]
    fn further_cycles_bring_what_was_foreseen() {
        for regime in [CALM, STRONG] {
            let field = Field { rows: 64, columns: 80, regime, common: 0.5 };
            let inputs = shots::inputs(Estimator::Default, CAMERA);
            let (now, later) = (field.sums(5, 9), field.sums(10, 9));
            let forecast = Forecast::of(&now, &inputs, 0.3, 4000);
            let then = Forecast::of(&later, &inputs, 0.3, 4000);
            assert!(forecast.pixels() > 1000);
            let (foreseen, came) = (forecast.quantile_k(&visits(5.0), 0.5), then.quantile_k(&[], 0.5));
            assert!((foreseen / came - 1.0).abs() < 0.05, "{}: {foreseen} {came}", regime.name);
            let before = forecast.quantile_k(&[], 0.5);
            for visit in visits(1.0) {
                let after = forecast.quantile_k(&[visit], 0.5);
                assert!(after < before && after > 0.8 * before, "{before} {after}");
            }
        }
    }
}
