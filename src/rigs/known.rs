//! What a simulated world knows of itself after a campaign: the truth that a map is compared with.

use super::{OpenError, Prepared};
use crate::config::Config;
use crate::reduce::Reduced;
use crate::truth::WorldTruth;
use ditd_sim::rig::build::BuildError;
use ditd_sim::rig::truth::{Sampling, Truth};
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;
use std::sync::PoisonError;

/// Perfect shots of the statistical truth: 8 scrambles of 512 leave a standard error far below one run's noise.
const TRUTH: Sampling = Sampling { points: 512, replicates: 8 };

/// Temperatures of the exact calibration's table, in K.
const CURVE_K: std::ops::RangeInclusive<u32> = 250..=850;

impl Prepared {
    /// What the simulated world knows of itself at the accepted shots; `None` on a real rig or without a spray.
    ///
    /// # Errors
    ///
    /// [`OpenError::Build`] when the world cannot tell.
    pub fn truth(
        &self,
        reduced: &Reduced,
        config: &Config,
        folder: &Path,
    ) -> Result<Option<WorldTruth>, OpenError> {
        let (Some(world), Some(rig)) = (&self.world, &config.rig) else { return Ok(None) };
        if rig.spray.is_none() || reduced.levels.iter().any(|level| level.spray_ids.is_empty()) {
            return Ok(None);
        }
        let surface = read_surface(folder);
        let plate_k: Vec<f64> =
            reduced.levels.iter().map(|level| mean_surface(&surface, &level.spray_ids)).collect();
        if plate_k.iter().any(|kelvin| !kelvin.is_finite()) {
            return Ok(None);
        }
        let integration_s = config.camera.integration_s;
        let truth = Truth::new(world, &plate_k, integration_s, TRUTH).map_err(BuildError::from)?;
        let optics = world.optics();
        let mean_k = plate_k.iter().sum::<f64>() / plate_k.len() as f64;
        let (_, gamma_near) = optics.window_transmittances(mean_k);
        let image = |values: &[f64], fill: f64| truth.image(values, fill);
        Ok(Some(WorldTruth {
            rows: truth.rows,
            columns: truth.columns,
            x_counts: plate_k
                .iter()
                .map(|kelvin| {
                    let (gamma_far, _) = optics.window_transmittances(*kelvin);
                    gamma_far * optics.calibration_counts(*kelvin, integration_s)
                })
                .collect(),
            plate_k,
            difference_counts: truth
                .statistical
                .difference_counts
                .iter()
                .map(|level| image(level, 0.0))
                .collect(),
            difference_error_counts: truth
                .statistical
                .standard_error_counts
                .iter()
                .map(|level| image(level, 0.0))
                .collect(),
            gamma_near,
            emissivity_plate: rig.plate_view.emissivity,
            far_window_counts: optics.far_window_counts(integration_s),
            curve_k: CURVE_K.map(f64::from).collect(),
            curve_counts: CURVE_K.map(|t| optics.calibration_counts(f64::from(t), integration_s)).collect(),
            physical_k: image(&truth.physical.temperature_k, f64::NAN),
            physical_emissivity: image(&truth.physical.emissivity, 0.0),
            droplets_k: image(&truth.droplets.temperature_k, f64::NAN),
            droplets_emissivity: image(&truth.droplets.emissivity, 0.0),
        }))
    }

    /// Adds the plate's true surface temperature at this session's exposures to `world/surface.csv`.
    ///
    /// # Errors
    ///
    /// [`OpenError::Config`] with the system's words.
    pub fn keep_surface(&self, folder: &Path) -> Result<(), OpenError> {
        let log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        if self.world.is_none() || log.is_empty() {
            return Ok(());
        }
        let path = folder.join(SURFACE);
        let text: String = log
            .iter()
            .enumerate()
            .map(|(index, kelvin)| format!("{},{kelvin:?}\n", self.begins.frames + index as u64))
            .collect();
        let write = || -> std::io::Result<()> {
            std::fs::create_dir_all(folder.join("world"))?;
            let mut file = std::fs::File::options().create(true).append(true).open(&path)?;
            file.write_all(text.as_bytes())
        };
        write().map_err(|error| OpenError::Config(format!("{}: {error}", path.display())))
    }
}

/// The plate's true surface temperature at every exposure of a simulated run: frame number, K.
const SURFACE: &str = "world/surface.csv";

fn read_surface(folder: &Path) -> HashMap<u64, f64> {
    let text = std::fs::read_to_string(folder.join(SURFACE)).unwrap_or_default();
    text.lines()
        .filter_map(|line| {
            let (frame, kelvin) = line.split_once(',')?;
            Some((frame.parse().ok()?, kelvin.parse().ok()?))
        })
        .collect()
}

/// Mean true surface temperature at the frames of which it is known; NaN without any.
fn mean_surface(surface: &HashMap<u64, f64>, frames: &[u64]) -> f64 {
    let seen: Vec<f64> = frames.iter().filter_map(|frame| surface.get(frame).copied()).collect();
    if seen.is_empty() { f64::NAN } else { seen.iter().sum::<f64>() / seen.len() as f64 }
}
