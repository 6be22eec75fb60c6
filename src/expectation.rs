//! What a campaign is expected to bring before it runs: σ(T) of its plan on sprays of some emissivities and temperatures.
//!
//! The camera's curve comes from the calibration that the campaign names or, on a simulated rig that measures its own,
//! from the rig's optics. How much shots scatter is the rig's law or, on a real rig, an assumption that is told.

use crate::calibrate::Calibration;
use crate::config::Config;
use crate::estimate::calibration::{CalibrationPoint, OffsetMode, SakumaHattori, fit_curve};
use crate::estimate::map::{CameraNoise, Estimator, FitInputs};
use crate::estimate::predict::{Expected, Visit, sigma_of_plan};
use crate::plan::Plan;
use ditd_sim::rig::build::{self, View};
use serde::Serialize;
use std::path::Path;

/// Emissivities for which σ(T) is told.
const EMISSIVITIES: [f64; 3] = [0.2, 0.5, 0.8];

/// Places between the coldest and the hottest level for which it is told.
const PLACES: [f64; 3] = [0.1, 0.5, 0.9];

/// Scatter that is assumed where nothing is known: between the calm (0.05, 1 K) and strong (0.25, 5 K) sprays with which
/// the estimator was judged; correlation of a spray that is colder where it is denser.
const SCATTER: Scatter = Scatter { sigma_ln_depth: 0.15, sigma_k: 3.0, correlation: -0.4 };

/// How shots scatter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Scatter {
    /// Standard deviation of ln(optical depth).
    pub sigma_ln_depth: f64,
    /// Standard deviation of the temperature, in K.
    pub sigma_k: f64,
    /// Correlation of the two.
    pub correlation: f64,
}

/// Expected σ(T) of a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Expectation {
    /// The scatter that was taken.
    pub scatter: Scatter,
    /// Whether it is an assumption.
    pub assumed: bool,
    /// One row per temperature.
    pub rows: Vec<Row>,
}

/// Expected σ(T) at one temperature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Effective temperature of the spray, in K.
    pub temperature_k: f64,
    /// Emissivity and σ(T) in K; null where the plan has no line.
    pub sigma_k: Vec<(f64, Option<f64>)>,
}

/// What `plan` is expected to bring; `None` when the camera's curve is not known before the calibration.
pub fn of(config: &Config, plan: &Plan, folder: &Path) -> Option<Expectation> {
    let (curve, zero_counts) = curve(config, folder)?;
    let law = config.rig.as_ref().and_then(|rig| rig.fluctuation.as_ref());
    let scatter = law.map_or(SCATTER, |law| Scatter {
        sigma_ln_depth: law.sigma_ln_tau,
        sigma_k: law.sigma_temperature_k,
        correlation: law.correlation,
    });
    let inputs = FitInputs {
        x_counts: Vec::new(),
        gamma_near: config.optics.gamma_near,
        gamma_far: config.optics.gamma_far,
        emissivity_plate: config.optics.emissivity_plate,
        far_window_counts: config.optics.reflectance_far * curve.value(config.optics.wall_temperature_k)
            / config.optics.emissivity_plate,
        curve,
        residual: None,
        range: None,
        camera: CameraNoise {
            read_noise_counts: config.camera.read_noise_counts,
            electrons_per_count: config.camera.electrons_per_count,
            zero_counts,
        },
        estimator: Estimator::Default,
        confidence: crate::estimate::map::CONFIDENCE,
        flat_gain: None,
    };
    let visits: Vec<Visit> = plan
        .levels
        .iter()
        .map(|level| Visit { plate_k: level.set_point_k, cycles: f64::from(level.program.cycles) })
        .collect();
    let blanks = plan.levels.first().map_or(1.0, |level| f64::from(level.program.blanks));
    let low = visits.iter().map(|visit| visit.plate_k).fold(f64::INFINITY, f64::min);
    let high = visits.iter().map(|visit| visit.plate_k).fold(f64::NEG_INFINITY, f64::max);
    let row = |place: f64| {
        let temperature_k = low + place * (high - low);
        let sigma = |emissivity: f64| {
            let spray = Expected {
                emissivity,
                temperature_k,
                sigma_ln_depth: scatter.sigma_ln_depth,
                sigma_k: scatter.sigma_k,
                correlation: scatter.correlation,
            };
            let sigma = sigma_of_plan(&spray, &visits, &inputs, blanks);
            (emissivity, sigma.is_finite().then_some(sigma))
        };
        Row { temperature_k, sigma_k: EMISSIVITIES.map(sigma).to_vec() }
    };
    Some(Expectation { scatter, assumed: law.is_none(), rows: PLACES.map(row).to_vec() })
}

/// The camera's curve and its counts without light.
fn curve(config: &Config, folder: &Path) -> Option<(SakumaHattori, f64)> {
    if config.optics.calibration != "measure" {
        let path = folder.join(&config.optics.calibration);
        let path = if path.is_dir() { path.join("calibration.json") } else { path };
        let calibration: Calibration = serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()?;
        return Some((calibration.fit.curve, calibration.dark_counts));
    }
    let rig = config.rig.as_ref()?;
    let bench = build::world(rig, View::Bench, config.campaign.seed, folder, &|_, _| {}).ok()?;
    let point = |i: u32| {
        let temperature_k = 330.0 + 20.0 * f64::from(i);
        let counts = bench.optics().calibration_counts(temperature_k, config.camera.integration_s);
        CalibrationPoint { temperature_k, counts, sigma_counts: 1e-3 * counts }
    };
    let points: Vec<CalibrationPoint> = (0..16).map(point).collect();
    let fit = fit_curve(&points, OffsetMode::Known(0.0)).ok()?;
    Some((fit.curve, rig.detector.offset_counts))
}

impl Expectation {
    /// In words, a line per temperature.
    pub fn words(&self) -> String {
        let Scatter { sigma_ln_depth, sigma_k, correlation } = self.scatter;
        let taken = if self.assumed { "assumed" } else { "the simulated" };
        let mut out = format!(
            "\nExpected σ of T for emissivities {} ({taken} scatter of shots: {sigma_ln_depth} in ln depth, {sigma_k} K, correlation {correlation}):\n",
            EMISSIVITIES.map(|e| e.to_string()).join(", ")
        );
        for row in &self.rows {
            let cells: Vec<String> = row
                .sigma_k
                .iter()
                .map(|(_, sigma)| {
                    sigma.map_or_else(|| "no line".to_owned(), |sigma| format!("{sigma:6.2} K"))
                })
                .collect();
            out += &format!("  at {:5.1} K  {}\n", row.temperature_k, cells.join("  "));
        }
        out
    }
}
