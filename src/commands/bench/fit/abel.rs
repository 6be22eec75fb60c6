//! Figures of the inverse Abel transform: error on a smooth hollow profile with noise, and the time of a full frame.

use super::super::{Figure, Watch};
use super::shots::Noise;
use super::speed::fastest;
use crate::estimate::abel::{
    Columns, Elements, Inverted, Inverter, Memory, Method, Settings, Strength, centre::Axis,
};

const ROWS: usize = 512;
const COLUMNS: usize = 640;
const SEED: u64 = 5;
/// Scale of the profile r²·exp(−r²/s²), in pixels.
const SCALE: f64 = 120.0;
/// Noise of a pixel over the largest column.
const NOISE: f64 = 0.01;

/// Errors and times of all methods on one thread.
pub(super) fn figures(watch: &Watch<'_>) -> Result<Vec<Figure>, String> {
    let image = Image::new();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| e.to_string())?;
    let sigmas = vec![image.sigma; image.values.len()];
    let mut figures = Vec::new();
    for method in Method::ALL {
        for known in [false, true] {
            // A minute each: once is enough.
            if method == Method::DaunNonNegative && known {
                continue;
            }
            let settings = Settings {
                method,
                elements: Elements::Linear,
                strength: Strength::Automatic,
                centre: None,
                pixel_m: 1.0,
                weighted: false,
            };
            let axis = Axis { column: 0.5 * (COLUMNS as f64 - 1.0), sigma: 0.0, found: false };
            let inverter = Inverter::new(COLUMNS, axis, &settings).map_err(|e| e.to_string())?;
            let sigmas = known.then_some(sigmas.as_slice());
            let columns = Columns { values: &image.values, sigmas, rows: ROWS, columns: COLUMNS };
            let (mut out, mut memory) = (Inverted::empty(), Memory::default());
            let mut work = || {
                inverter.invert_into(&columns, &mut out, &mut memory).expect("an image of this shape");
            };
            let seconds = pool.install(|| match method {
                Method::DaunNonNegative => watch.best_of(1, work),
                _ => fastest(watch, 1, &mut work),
            });
            figures.push(Figure {
                name: format!("{}{}", method.name(), if known { ", sigma given" } else { "" }),
                seconds,
                error: image.rms(&out),
                error_kind: format!(
                    "rms over r < 0.95 of a profile of peak 1, 1 % noise; {:.3} within 5 pixels of the axis",
                    image.rms_at_axis(&out)
                ),
                n: ROWS * COLUMNS,
                threads: 1,
                seed: Some(SEED),
            });
        }
    }
    Ok(figures)
}

/// A hollow profile, its columns with noise.
struct Image {
    truth: Vec<f64>,
    values: Vec<f64>,
    sigma: f64,
}

impl Image {
    fn new() -> Self {
        let square = |c: usize| ((c as f64 - 0.5 * (COLUMNS as f64 - 1.0)) / SCALE).powi(2);
        let e = std::f64::consts::E;
        let truth = (0..COLUMNS).map(|c| e * square(c) * (-square(c)).exp()).collect();
        let root = std::f64::consts::PI.sqrt();
        let column: Vec<f64> =
            (0..COLUMNS).map(|c| e * root * SCALE * (0.5 + square(c)) * (-square(c)).exp()).collect();
        let sigma = NOISE * column.iter().copied().fold(0.0, f64::max);
        let mut values = Vec::with_capacity(ROWS * COLUMNS);
        for row in 0..ROWS as u64 {
            let mut random = Noise::keyed([SEED, row, 0, 0]);
            for pair in column.chunks(2) {
                let normals = random.normals();
                values.extend(pair.iter().zip(normals).map(|(p, normal)| p + sigma * normal));
            }
        }
        Self { truth, values, sigma }
    }

    fn rms(&self, found: &Inverted) -> f64 {
        self.rms_within(found, 0.95 * 0.5 * COLUMNS as f64)
    }

    fn rms_at_axis(&self, found: &Inverted) -> f64 {
        self.rms_within(found, 5.0)
    }

    fn rms_within(&self, found: &Inverted, radius: f64) -> f64 {
        let (mut sum, mut n) = (0.0, 0.0);
        for (i, alpha) in found.alpha_per_m.iter().enumerate() {
            let c = i % COLUMNS;
            if (c as f64 - 0.5 * (COLUMNS as f64 - 1.0)).abs() < radius {
                sum += (alpha - self.truth[c]).powi(2);
                n += 1.0;
            }
        }
        (sum / n).sqrt()
    }
}
