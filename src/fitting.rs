//! From the sums of a run and its calibration to the map: the one function that live runs, replays and refits share.

use crate::calibrate::Calibrated;
use crate::calibrate::Calibration;
use crate::config::Config;
use crate::estimate::accumulate::Sums;
use crate::estimate::budget::{self, Budget, Setup, Stated};
use crate::estimate::gate;
use crate::estimate::map::{self, CameraNoise, DitMap, Estimator, FitInputs};
use crate::reduce::{FrameSource, LevelState, ReduceError, Reduced, Total};

/// Confidence of the low/high channels of archived maps.
const CONFIDENCE: f64 = 0.95;

/// x = γ_far·I_cal(T_plate) per level with the mean plate reading of the accepted shots (never the set-point), in
/// counts; `None` for a level without accepted cycles.
pub fn abscissae(levels: &[LevelState], config: &Config, calibration: &Calibration) -> Vec<Option<f64>> {
    levels
        .iter()
        .map(|level| Some(config.optics.gamma_far * calibration.fit.counts(level.plate_mean_k()?)))
        .collect()
}

/// E_f in counts of the crossing's scale: the walls that the far window mirrors. CaF₂ itself emits nothing at
/// 3–5 µm (absorption below 1e-4).
pub fn far_window_counts(config: &Config, calibration: &Calibration) -> f64 {
    let wall = calibration.fit.counts(config.optics.wall_temperature_k) / config.optics.emissivity_plate;
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
    calibration: &'a Calibration,
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
        residual: calibration.fit.residual.as_ref(),
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

/// The uncertainty budget of a run's map, part by part.
pub fn budget(
    map: &DitMap,
    sums: &Sums,
    inputs: &FitInputs<'_>,
    levels: &[LevelState],
    config: &Config,
    calibration: &Calibration,
) -> Budget {
    let o = &config.optics;
    let plates_k: Vec<Option<f64>> = levels.iter().map(LevelState::plate_mean_k).collect();
    let setup = Setup {
        fit: &calibration.fit,
        gamma_near: o.gamma_near,
        gamma_far: o.gamma_far,
        reflectance_far: o.reflectance_far,
        wall_temperature_k: o.wall_temperature_k,
        emissivity_plate: o.emissivity_plate,
        plates_k: &plates_k,
        stated: Stated {
            gamma_near: o.sigma_gamma_near,
            gamma_far: o.sigma_gamma_far,
            reflectance_far: o.sigma_reflectance_far,
            wall_temperature_k: o.sigma_wall_temperature_k,
            emissivity_plate: o.sigma_emissivity_plate,
            plate_uniformity_k: o.sigma_plate_uniformity_k,
            plate_reading_k: o.sigma_plate_reading_k,
        },
    };
    budget::budget(map, &map::crossing_shares(sums, inputs), &setup)
}

/// Whether enough is known for a map: two levels with accepted cycles.
pub fn can_fit(sums: &Sums) -> bool {
    sums.levels().iter().filter(|level| level.cycles() > 0).count() >= 2
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{Figures, Key};
    use crate::estimate::calibration::{CalibrationPoint, OffsetMode, SakumaHattori, fit_curve};

    /// x follows the readings of the accepted shots; a set-point that the plate missed by kelvins does not enter.
    #[test]
    fn abscissae_follow_readings_and_not_set_points() {
        let source = crate::samples::open(std::path::Path::new("long")).unwrap();
        let config = Config::parse("long", &source.text).unwrap();
        let curve = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
        let points: Vec<CalibrationPoint> = [340.0, 390.0, 440.0, 490.0, 540.0]
            .map(|temperature_k| CalibrationPoint {
                temperature_k,
                counts: curve.value(temperature_k),
                sigma_counts: 0.1,
            })
            .to_vec();
        let calibration = Calibration {
            schema: 1,
            utc: String::new(),
            key: Key::of(&config),
            dark_counts: 0.0,
            fit: fit_curve(&points, OffsetMode::Known(0.0)).unwrap(),
            points,
            mapping: None,
            figures: Figures::default(),
        };
        // The plan says 373 K for the first level.
        let level = LevelState { plate_k: vec![369.0, 371.0], ..LevelState::default() };
        let x = abscissae(&[level, LevelState::default()], &config, &calibration);
        let expected = config.optics.gamma_far * curve.value(370.0);
        assert!((x[0].unwrap() / expected - 1.0).abs() < 1e-6 && x[1].is_none());
    }
}
