//! From the sums of a run and its calibration to the map: the one function that live runs, replays and refits share.

use crate::calibrate::Calibrated;
use crate::calibrate::Calibration;
use crate::config::Config;
use crate::estimate::accumulate::Sums;
use crate::estimate::gate;
use crate::estimate::map::{CameraNoise, Estimator, FitInputs};
use crate::reduce::{FrameSource, LevelState, ReduceError, Reduced, Total};

/// Confidence of the low/high channels of archived maps.
const CONFIDENCE: f64 = 0.95;

/// x = γ_far·I_cal(T_plate) per level with the mean plate reading of the accepted shots (never the set-point), in
/// counts; `None` for a level without accepted cycles.
pub fn abscissae(levels: &[LevelState], config: &Config, calibration: &Calibration) -> Vec<Option<f64>> {
    levels
        .iter()
        .map(|level| Some(config.optics.gamma_far * calibration.fit.curve.value(level.plate_mean_k()?)))
        .collect()
}

/// E_f in counts of the crossing's scale: the walls that the far window mirrors. CaF₂ itself emits nothing at
/// 3–5 µm (absorption below 1e-4).
pub fn far_window_counts(config: &Config, calibration: &Calibration) -> f64 {
    let wall = calibration.fit.curve.value(config.optics.wall_temperature_k) / config.optics.emissivity_plate;
    config.optics.reflectance_far * wall
}

/// The estimator that a campaign file names.
pub fn estimator(name: &str) -> Option<Estimator> {
    [Estimator::Default, Estimator::Paper, Estimator::Ols].into_iter().find(|one| one.name() == name)
}

/// Everything that the fit of a run needs besides its sums.
pub fn inputs<'a>(
    levels: &[LevelState],
    config: &Config,
    calibration: &Calibration,
    flat: &'a [f64],
    estimator: Estimator,
) -> FitInputs<'a> {
    FitInputs {
        x_counts: abscissae(levels, config, calibration),
        gamma_near: config.optics.gamma_near,
        gamma_far: config.optics.gamma_far,
        emissivity_plate: config.optics.emissivity_plate,
        far_window_counts: far_window_counts(config, calibration),
        curve: calibration.fit.curve,
        range: Some(calibration.fit.range),
        camera: CameraNoise {
            read_noise_counts: config.camera.read_noise_counts,
            electrons_per_count: config.camera.electrons_per_count,
            zero_counts: calibration.dark_counts,
        },
        estimator,
        confidence: CONFIDENCE,
        flat_gain: Some(flat),
    }
}

/// Whether enough is known for a map: two levels with accepted cycles.
pub fn can_fit(sums: &Sums) -> bool {
    sums.levels().iter().filter(|level| level.cycles > 0).count() >= 2
}

/// The records as the final map rests on them: our own estimator takes misfires and spikes out, the others nothing.
///
/// # Errors
///
/// [`ReduceError`] when a frame cannot be read again.
pub fn final_state(
    reduced: &Reduced,
    config: &Config,
    calibrated: &Calibrated,
    estimator: Estimator,
    frames: &mut dyn FrameSource,
) -> Result<Reduced, ReduceError> {
    match &reduced.total {
        Total::Map(sums) if estimator == Estimator::Default && can_fit(sums) => {
            let inputs =
                inputs(&reduced.levels, config, &calibrated.calibration, &calibrated.flat, estimator);
            let score_min = config.fit.misfire_score.unwrap_or(gate::SCORE_MIN);
            reduced.refined(&inputs, score_min, frames)
        }
        Total::Map(_) | Total::Curve(_) => Ok(reduced.clone()),
    }
}
