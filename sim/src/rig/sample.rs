//! Hand-made worlds for the tests of the rig: a layer of absorbing and scattering fuel with known coefficients.

use super::chamber::{World, WorldParts};
use super::config::{DetectorConfig, FluctuationConfig};
use super::radiometry::{Enclosure, Optics, PlateSurfaceSpectrum, Spectrum, WindowSpectrum};
use super::sights::{ScaleNode, Sights};
use crate::light::band::Band;
use crate::tracer::operator::Operator;

pub(crate) const ROWS: usize = 12;
pub(crate) const COLUMNS: usize = 16;
pub(crate) const OFFSET_K: f64 = 8.0;
const GROUPS: usize = 4;

pub(crate) const LAW: FluctuationConfig = FluctuationConfig {
    sigma_ln_tau: 0.25,
    sigma_temperature_k: 5.0,
    correlation: -0.4,
    correlation_length_px: 6.0,
};
pub(crate) const LAW_WITHOUT_SHIFT: FluctuationConfig = FluctuationConfig { sigma_temperature_k: 0.0, ..LAW };

/// What a test wants to differ.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Choices {
    pub(crate) medium_k: f64,
    pub(crate) surroundings_k: f64,
    pub(crate) lab_k: f64,
    pub(crate) wall_emissivity: f64,
    pub(crate) albedo: f64,
    pub(crate) gray: bool,
    pub(crate) channels: usize,
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) fluctuation: Option<FluctuationConfig>,
}

impl Choices {
    pub(crate) fn usual() -> Self {
        Self {
            medium_k: 430.0,
            surroundings_k: 480.0,
            lab_k: 296.0,
            wall_emissivity: 0.9,
            albedo: 0.4,
            gray: false,
            channels: 6,
            rows: ROWS,
            columns: COLUMNS,
            fluctuation: Some(LAW),
        }
    }
}

pub(crate) fn band() -> Band {
    Band {
        wavelengths_um: vec![3.36, 3.39, 3.42, 3.45],
        // A filter of 0.12 µm with peak 0.8, lens and quantum efficiency of the assumed camera.
        weights: [0.018, 0.024, 0.024, 0.018].map(|w| w * 0.675).to_vec(),
        leak_from: None,
    }
}

fn window(temperature_k: f64) -> WindowSpectrum {
    WindowSpectrum {
        transmittance: vec![0.943; GROUPS],
        reflectance: vec![0.056; GROUPS],
        absorptance: vec![0.001; GROUPS],
        temperature_k,
    }
}

pub(crate) fn optics(choices: &Choices) -> Optics {
    let plate = PlateSurfaceSpectrum { emissivity: vec![0.959; GROUPS], lab_temperature_k: choices.lab_k };
    let enclosure = Enclosure {
        near: window(choices.surroundings_k),
        far: window(choices.surroundings_k),
        gas_temperature_k: choices.surroundings_k,
        wall_temperature_k: choices.surroundings_k,
        wall_emissivity: choices.wall_emissivity,
        window_fraction: 0.05,
    };
    Optics::chamber(Spectrum::from(&band()), plate, enclosure, &DetectorConfig::assumed()).unwrap()
}

/// A layer whose optical depth grows from 0.05 at the left to 4 at the right; the last column sees no plate,
/// row 0 no medium.
pub(crate) fn operator(choices: &Choices, scale: f64) -> Operator {
    let (rows, columns) = (choices.rows, choices.columns);
    let optics = optics(choices);
    let mut op =
        Operator { rows, columns, groups: GROUPS, channels: choices.channels, ..Operator::default() };
    op.plate_seen = (0..rows * columns)
        .map(|p| if columns > 4 && p % columns == columns - 1 { 0.0 } else { 1.0 })
        .collect();
    let first = if rows > 1 { columns } else { 0 };
    for p in first..rows * columns {
        op.pixels.push(u32::try_from(p).unwrap());
        let depth = 0.05 + 3.95 * (p % columns) as f64 / columns as f64;
        let tau: Vec<f64> = (0..GROUPS)
            .map(|g| scale * depth * if choices.gray { 1.0 } else { 0.7 + 0.2 * g as f64 })
            .collect();
        let seen = f64::from(op.plate_seen[p]);
        op.a_plate.extend(tau.iter().map(|t| single(seen * (-t).exp())));
        for c in 0..choices.channels {
            for (g, t) in tau.iter().enumerate() {
                let offset = [0.0, 0.0, -OFFSET_K, OFFSET_K, 0.0, 0.0][c];
                let source = if c % 4 == 0 { 1.0 } else { optics.black(g, choices.medium_k + offset) };
                let share = if c >= 4 { 0.5 } else { 1.0 };
                let weight = share * (1.0 - choices.albedo) * (1.0 - (-t).exp());
                op.emission.push(single(weight * source));
                op.direct.push(single(0.9 * weight * source));
            }
        }
        op.error_plate.push(0.0);
        op.error_medium.push(0.0);
    }
    op
}

pub(crate) fn sights(choices: &Choices) -> Sights {
    let nodes = [0.7, 1.0, 1.4].map(|scale| ScaleNode { scale, operator: operator(choices, scale) });
    Sights::new(nodes.to_vec(), OFFSET_K).unwrap()
}

pub(crate) fn parts(choices: &Choices) -> WorldParts {
    WorldParts {
        optics: optics(choices),
        sights: sights(choices),
        detector: DetectorConfig::assumed(),
        fluctuation: choices.fluctuation,
        residual: None,
        seed: 42,
    }
}

pub(crate) fn world(choices: &Choices) -> World {
    World::new(parts(choices)).unwrap()
}

pub(crate) fn bench(rows: usize, columns: usize) -> World {
    let detector = DetectorConfig { shutter_temperature_k: Some(300.0), ..DetectorConfig::assumed() };
    let plate = PlateSurfaceSpectrum { emissivity: vec![0.959; GROUPS], lab_temperature_k: 296.0 };
    World::new(WorldParts {
        optics: Optics::bench(Spectrum::from(&band()), plate, &detector).unwrap(),
        sights: Sights::empty(rows, columns, vec![1.0; rows * columns]).unwrap(),
        detector,
        fluctuation: None,
        residual: None,
        seed: 42,
    })
    .unwrap()
}

/// A pixel that sees the plate through the thickest part of the layer.
pub(crate) fn opaque_pixel(sights: &Sights) -> usize {
    2 * sights.columns() - 2
}

/// Electrons per second that the near window adds to every pixel of the usual world.
pub(crate) fn camera_side_electrons(optics: &Optics) -> f64 {
    let choices = Choices::usual();
    (0..optics.groups())
        .map(|g| {
            let own =
                0.056 * optics.black(g, choices.lab_k) + 0.001 * optics.black(g, choices.surroundings_k);
            optics.inside_sensitivity(g) / 0.943 * own
        })
        .sum()
}

#[expect(clippy::cast_possible_truncation, reason = "operators are f32")]
fn single(value: f64) -> f32 {
    value as f32
}
