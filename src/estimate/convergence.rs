//! How a map settles with the number of cycles: the paper's figure 10, from any record.

use super::accept::Recorded;
use super::accumulate::Sums;
use super::map::{DitMap, FitInputs, solve};
use serde::Serialize;

/// The map after the first `cycles` cycles of every level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Step {
    /// Cycles of each level; levels that have fewer took all of theirs.
    pub cycles: usize,
    /// Pixels that are compared.
    pub pixels: usize,
    /// Rms of T against the map of all cycles, in K; null without pixels.
    pub rms_to_last_k: Option<f64>,
    /// Rms of T against the step before: the influence of a cycle, in K; null for the first.
    pub rms_of_cycle_k: Option<f64>,
    /// Median σ(T) as the map states it, in K.
    pub median_sigma_k: Option<f64>,
}

/// Steps of one cycle up to `steps_max`, over the pixels that have a temperature in the map of all cycles and an
/// emissivity above `emissivity_min` there. Every cycle counts, as recorded: no gates.
///
/// # Errors
///
/// When a frame cannot be read or does not belong to sums like `like`.
pub fn convergence<R: Recorded>(
    like: &Sums,
    inputs: &FitInputs<'_>,
    emissivity_min: f64,
    steps_max: usize,
    recorded: &mut R,
) -> Result<Vec<Step>, R::Error> {
    let levels = like.levels().len();
    let most = (0..levels).map(|level| recorded.cycles(level)).max().unwrap_or(0).min(steps_max);
    let mut sums = like.clone();
    sums.clear();
    let mut temperatures: Vec<Vec<f64>> = Vec::with_capacity(most);
    let mut sigmas: Vec<Vec<f64>> = Vec::with_capacity(most);
    let mut last: Option<DitMap> = None;
    for cycle in 0..most {
        for level in (0..levels).filter(|&level| cycle < recorded.cycles(level)).collect::<Vec<_>>() {
            let mut added = Ok(());
            recorded.one(level, cycle, &mut |_, blanks, spray| {
                added = sums.add_cycle(level, blanks, spray);
            })?;
            added?;
        }
        let map = solve(&sums, inputs);
        temperatures.push(map.temperature_k.clone());
        sigmas.push(map.sigma_temperature_k.clone());
        last = Some(map);
    }
    let Some(last) = last else { return Ok(Vec::new()) };
    let chosen: Vec<usize> = (0..last.temperature_k.len())
        .filter(|&i| last.temperature_k[i].is_finite() && last.emissivity[i] > emissivity_min)
        .collect();
    Ok((0..most)
        .map(|step| {
            let before = step
                .checked_sub(1)
                .and_then(|before| rms(&chosen, &temperatures[step], &temperatures[before]));
            Step {
                cycles: step + 1,
                pixels: chosen.len(),
                rms_to_last_k: rms(&chosen, &temperatures[step], &last.temperature_k),
                rms_of_cycle_k: before,
                median_sigma_k: median(&chosen, &sigmas[step]),
            }
        })
        .collect())
}

/// Rms difference over the chosen pixels that have both.
fn rms(chosen: &[usize], a: &[f64], b: &[f64]) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0.0);
    for &i in chosen {
        let off = a[i] - b[i];
        if off.is_finite() {
            sum += off * off;
            n += 1.0;
        }
    }
    (n > 0.0).then(|| (sum / n).sqrt())
}

fn median(chosen: &[usize], values: &[f64]) -> Option<f64> {
    let mut finite: Vec<f64> = chosen.iter().map(|&i| values[i]).filter(|v| v.is_finite()).collect();
    finite.sort_unstable_by(f64::total_cmp);
    finite.get(finite.len() / 2).copied()
}
