//! Figures of the estimators: error and honesty on made-up shots, then time.

mod abel;
mod dirt;
mod judge;
mod shots;
mod speed;

use super::{Figure, Output, Watch};
use crate::commands::CommandError;
use crate::estimate::map::{CameraNoise, FitInputs, solve};
use judge::{Score, Trial, estimators, scores};
use shots::{CALM, CAMERA, Field, Regime, STRONG};

/// Cycles a level that are judged.
const CYCLES: [usize; 5] = [1, 2, 3, 5, 10];

/// Maps a case, 160 × 128 pixels each: 164 000 draws.
const REPEATS: u64 = 8;

/// Pixels of a judged map.
const SHAPE: (usize, usize) = (128, 160);

/// Seed of the first map of every case.
const SEED: u64 = 1000;

/// Arguments of `ditd bench fit`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Only this
    #[arg(long, value_enum)]
    only: Option<Subject>,
    #[command(flatten)]
    pub(super) output: Output,
}

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Subject {
    /// Times of sums and solves on full frames
    Speed,
    /// Errors and coverage of every estimator
    Honesty,
    /// What misfires and spikes cost
    Gates,
    /// Errors and times of the inverse Abel transform
    Abel,
}

/// All figures, measured now.
///
/// # Errors
///
/// Status 1 when there are no threads to measure on.
pub(super) fn figures(watch: &Watch<'_>, args: &Args) -> Result<Vec<Figure>, CommandError> {
    let failed = |what: String| CommandError::failure(format!("bench fit: {what}"));
    let wanted = |subject| args.only.is_none_or(|only| only == subject);
    let mut figures = Vec::new();
    if wanted(Subject::Speed) {
        figures.extend(speed::figures(watch).map_err(failed)?);
    }
    if wanted(Subject::Abel) {
        figures.extend(abel::figures(watch).map_err(failed)?);
    }
    for regime in [CALM, STRONG] {
        if wanted(Subject::Honesty) {
            for common in [0.0, 0.5] {
                for cycles in CYCLES {
                    figures.extend(honesty(watch, regime, common, cycles, REPEATS));
                }
            }
        }
        if wanted(Subject::Gates) {
            figures.extend([5, 10, 19].map(|cycles| robustness(watch, regime, cycles)));
        }
    }
    Ok(figures)
}

/// What misfires and spikes cost, and the gates clean shots.
fn robustness(watch: &Watch<'_>, regime: Regime, cycles: usize) -> Figure {
    let field = Field { rows: SHAPE.0, columns: SHAPE.1, regime, common: 0.5 };
    let e = dirt::errors(&field, cycles, REPEATS, SEED, &field.truths());
    let mut frames = dirt::Frames::dirty(&field, cycles, SEED);
    Figure {
        name: format!("{}, gates, n = {cycles}", regime.name),
        seconds: watch.best_of(3, || drop(frames.refined())),
        error: e.dirty,
        error_kind: format!(
            "rms of T, K, with {} % spikes and {} % misfires: {:.3} of the clean shots', {:.3} without the misfired ones; the gates make clean shots {:.4}; without gates {:.1} K",
            100.0 * dirt::SPIKES,
            100.0 * dirt::MISFIRES,
            e.dirty / e.clean,
            e.dirty / e.fewer,
            e.gated / e.clean,
            e.poisoned,
        ),
        n: field.pixels(),
        threads: rayon::current_num_threads(),
        seed: Some(SEED),
    }
}

/// Error and coverage of every estimator for one kind of shots.
fn honesty(watch: &Watch<'_>, regime: Regime, common: f64, cycles: usize, repeats: u64) -> Vec<Figure> {
    let field = Field { rows: SHAPE.0, columns: SHAPE.1, regime, common };
    let trial = Trial { field, cycles, repeats, seed: SEED };
    let mut names: Vec<String> = estimators().iter().map(|one| one.name().to_owned()).collect();
    let mut fits: Vec<FitInputs<'_>> = estimators().iter().map(|&one| shots::inputs(one, CAMERA)).collect();
    names.push("default, camera unknown".into());
    fits.push(FitInputs { camera: CameraNoise::ROUNDING_ONLY, ..fits[0].clone() });
    let (oracle, scores) = scores(&trial, &field.truths(), &fits);
    let sums = field.sums(cycles, SEED);
    let kind = if common > 0.0 { "neighbours alike" } else { "independent" };
    names
        .iter()
        .zip(&fits)
        .zip(&scores)
        .map(|((name, inputs), score)| Figure {
            name: format!("{}, {kind}, n = {cycles}: {name}", regime.name),
            seconds: watch.best_of(3, || {
                std::hint::black_box(solve(&sums, inputs));
            }),
            error: score.rmse_k,
            error_kind: words(score, &oracle),
            n: field.pixels(),
            threads: rayon::current_num_threads(),
            seed: Some(SEED),
        })
        .collect()
}

fn words(score: &Score, oracle: &Score) -> String {
    let percent = |[t, e]: [f64; 2]| format!("{:.1}/{:.1} %", 100.0 * t, 100.0 * e);
    format!(
        "rms of T, K: {:.3} of the oracle's, emissivity {:.4} ({:.3}); 68 % sets hold T/emissivity {}, 95 % {}; {:.2} % not resolved, {} without; {} draws",
        score.rmse_k / oracle.rmse_k,
        score.rmse_emissivity,
        score.rmse_emissivity / oracle.rmse_emissivity,
        percent(score.held_68),
        percent(score.held_95),
        100.0 * score.unresolved,
        score.without,
        score.draws,
    )
}
