//! Shots of a made-up spray with known scatter, known truth and known variances: what an estimator is judged on.
//!
//! Shares nothing with the simulator. Optical depth is lognormal and temperature normal from shot to shot, correlated
//! by −0.4; a part of the scatter is common to blocks of 4 × 4 pixels; the camera adds read noise, shot noise and
//! rounding. The scale is the paper's: 20 K of wall are twelve counts.

use crate::estimate::accumulate::Sums;
use crate::estimate::calibration::SakumaHattori;
use crate::estimate::line::ROUNDING_VARIANCE;
use crate::estimate::map::{CONFIDENCE, CameraNoise, Estimator, FitInputs};
use rayon::prelude::*;

pub(super) const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
const GAMMA: f64 = 0.95;
pub(super) const EMISSIVITY_PLATE: f64 = 0.99;
const OFFSET_COUNTS: f64 = 1500.0;
const SATURATION_COUNT: u16 = 16_383;
const CORRELATION: f64 = -0.4;
/// Rows and columns of pixels that share scatter.
const BLOCK: usize = 4;

/// The camera of the shots.
pub(super) const CAMERA: CameraNoise =
    CameraNoise { read_noise_counts: 1.2, electrons_per_count: 500.0, zero_counts: OFFSET_COUNTS };

/// Plate temperatures of the usual map, in K.
pub(super) const PLATES_K: [f64; 5] = [373.0, 403.0, 433.0, 498.0, 533.0];

/// How much a spray changes from shot to shot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Regime {
    pub(super) name: &'static str,
    /// Standard deviation of ln(optical depth).
    pub(super) sigma_ln_depth: f64,
    /// Standard deviation of the temperature, in K.
    pub(super) sigma_k: f64,
}

pub(super) const CALM: Regime = Regime { name: "calm", sigma_ln_depth: 0.05, sigma_k: 1.0 };
pub(super) const STRONG: Regime = Regime { name: "strong", sigma_ln_depth: 0.25, sigma_k: 5.0 };

/// What is measured: a map with ε from 0.05 to 0.93 across and 395 to 500 K down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Field {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) regime: Regime,
    /// Part of the scatter's variance that neighbours share, 0 … 1.
    pub(super) common: f64,
}

/// What is true of one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Truth {
    /// E[ε].
    pub(super) emissivity: f64,
    /// Temperature of E[εS]/E[ε], in K: the effective temperature by its definition.
    pub(super) temperature_k: f64,
    /// Variance of one sample of each level, in counts².
    pub(super) variance: [f64; PLATES_K.len()],
    /// Expectation of spray − blank of each level, in counts.
    pub(super) difference: [f64; PLATES_K.len()],
}

/// x of the levels, in counts.
pub(super) fn abscissae() -> [f64; PLATES_K.len()] {
    PLATES_K.map(|t| GAMMA * CURVE.value(t))
}

/// What a fit of these shots is told; `camera` is what it believes of the camera.
pub(super) fn inputs(estimator: Estimator, camera: CameraNoise) -> FitInputs<'static> {
    FitInputs {
        x_counts: abscissae().map(Some).to_vec(),
        gamma_near: GAMMA,
        gamma_far: GAMMA,
        emissivity_plate: EMISSIVITY_PLATE,
        far_window_counts: 0.0,
        curve: CURVE,
        residual: None,
        range: None,
        camera,
        estimator,
        confidence: CONFIDENCE,
        flat_gain: None,
    }
}

/// Emissivity of a line: −slope/γ.
pub(super) fn emissivity(slope: f64) -> f64 {
    -slope / GAMMA
}

/// Temperature of a crossing, in K.
pub(super) fn temperature(crossing: f64) -> f64 {
    CURVE.inverse(EMISSIVITY_PLATE * crossing)
}

/// Random numbers of one row of one frame (splitmix64, Box–Muller): no order of threads changes them.
pub(super) struct Noise(u64);

impl Noise {
    pub(super) fn keyed(keys: [u64; 4]) -> Self {
        let mut noise = Self(0x5851_F42D_4C95_7F2D);
        for key in keys {
            noise.0 = noise.bits() ^ key.wrapping_mul(0xD605_1F3A_9E2B_7C45);
        }
        noise
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(super) fn uniform(&mut self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "53 bits")]
        let value = ((self.bits() >> 11) as f64 + 0.5) / 9_007_199_254_740_992.0;
        value
    }

    pub(super) fn normals(&mut self) -> [f64; 2] {
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let angle = std::f64::consts::TAU * self.uniform();
        [radius * libm::cos(angle), radius * libm::sin(angle)]
    }
}

impl Field {
    pub(super) fn pixels(&self) -> usize {
        self.rows * self.columns
    }

    /// Mean optical depth and temperature of a pixel.
    #[expect(clippy::cast_precision_loss, reason = "pixels")]
    fn mean(&self, row: usize, column: usize) -> (f64, f64) {
        let part = |at: usize, of: usize| at as f64 / of.saturating_sub(1).max(1) as f64;
        let across = part(column, self.columns);
        (-libm::log1p(-(0.05 + 0.88 * across)), 395.0 + 105.0 * part(row, self.rows))
    }

    /// ε and εS of the shot whose scatter is (u, v) standard normal.
    fn shot(&self, (depth, temperature_k): (f64, f64), u: f64, v: f64) -> (f64, f64) {
        let w = CORRELATION * u + (1.0 - CORRELATION * CORRELATION).sqrt() * v;
        let emissivity = -libm::expm1(-depth * libm::exp(self.regime.sigma_ln_depth * u));
        let crossing = CURVE.value(temperature_k + self.regime.sigma_k * w) / EMISSIVITY_PLATE;
        (emissivity, emissivity * crossing)
    }

    /// Moments of (ε, εS) by a trapezium over ±6 standard deviations (exact to 1e-8 here), and what follows.
    pub(super) fn truth(&self, row: usize, column: usize) -> Truth {
        let mean = self.mean(row, column);
        let (mut sum, mut e, mut s, mut ee, mut es, mut ss) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for i in -12..=12 {
            for j in -12..=12 {
                let (u, v) = (0.5 * f64::from(i), 0.5 * f64::from(j));
                let w = libm::exp(-0.5 * (u * u + v * v));
                let (one, product) = self.shot(mean, u, v);
                sum += w;
                e += w * one;
                s += w * product;
                ee += w * one * one;
                es += w * one * product;
                ss += w * product * product;
            }
        }
        let (e, s) = (e / sum, s / sum);
        let (ee, es, ss) = (ee / sum - e * e, es / sum - e * s, ss / sum - s * s);
        let x = abscissae();
        Truth {
            emissivity: e,
            temperature_k: temperature(s / e),
            variance: x.map(|x| {
                let shots = GAMMA * GAMMA * (ss - 2.0 * x * es + x * x * ee);
                let blank = GAMMA * x;
                let spray = blank + GAMMA * (s - e * x);
                let electrons = (spray.max(0.0) + blank) / CAMERA.electrons_per_count;
                shots + 2.0 * (CAMERA.read_noise_counts.powi(2) + ROUNDING_VARIANCE) + electrons
            }),
            difference: x.map(|x| GAMMA * (s - e * x)),
        }
    }

    /// Truth of every pixel.
    pub(super) fn truths(&self) -> Vec<Truth> {
        (0..self.pixels()).into_par_iter().map(|i| self.truth(i / self.columns, i % self.columns)).collect()
    }

    /// A blank and a spray frame of one cycle.
    pub(super) fn pair(&self, level: usize, cycle: usize, seed: u64) -> (Vec<u16>, Vec<u16>) {
        let x = abscissae()[level];
        let columns = self.columns;
        let blocks = columns.div_ceil(BLOCK);
        let key = |kind: u64, row: usize| [seed, (level as u64) << 32 | cycle as u64, kind, row as u64];
        let (own, shared) = ((1.0 - self.common).sqrt(), self.common.sqrt());
        let (mut blank, mut spray) = (vec![0; self.pixels()], vec![0; self.pixels()]);
        let rows = blank.par_chunks_mut(columns).zip(spray.par_chunks_mut(columns));
        rows.enumerate().for_each(|(row, (blank, spray))| {
            let mut noise = Noise::keyed(key(1, row));
            let mut blocks_noise = Noise::keyed(key(2, row / BLOCK));
            let common: Vec<[f64; 2]> = (0..blocks).map(|_| blocks_noise.normals()).collect();
            for column in 0..columns {
                let [a, b] = common[column / BLOCK];
                let [c, d] = noise.normals();
                let mean = self.mean(row, column);
                let (e, es) = self.shot(mean, shared * a + own * c, shared * b + own * d);
                let [p, q] = noise.normals();
                blank[column] = counts(p, GAMMA * x);
                spray[column] = counts(q, GAMMA * (x + es - e * x));
            }
        });
        (blank, spray)
    }

    /// Exact sums of `cycles` pairs a level.
    pub(super) fn sums(&self, cycles: usize, seed: u64) -> Sums {
        let mut sums = Sums::new(PLATES_K.len(), self.rows, self.columns, 1, SATURATION_COUNT)
            .expect("one blank is allowed");
        for level in 0..PLATES_K.len() {
            for cycle in 0..cycles {
                let (blank, spray) = self.pair(level, cycle, seed);
                sums.add_cycle(level, &[&blank], &spray).expect("frames of this shape");
            }
        }
        sums
    }
}

/// A sample with its noise, rounded.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the counts there are"
)]
fn counts(noise: f64, signal: f64) -> u16 {
    let variance = CAMERA.read_noise_counts.powi(2) + signal.max(0.0) / CAMERA.electrons_per_count;
    (OFFSET_COUNTS + signal + noise * variance.sqrt()).round().clamp(0.0, 16_383.0) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means and variances of many shots of one pixel are those that the truth states: 40 000 draws, four standard
    /// errors (a variance's is √(2/n) of it and somewhat more for lognormal shots, 3 is taken).
    #[test]
    fn shots_have_the_moments_of_the_truth() {
        let mean_of = |field: &Field| {
            // 200 × 200 pixels that are all alike: the field of one pixel, repeated.
            let truth = field.truth(0, 0);
            (0..PLATES_K.len()).for_each(|level| {
                let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
                for cycle in 0..40_000 {
                    let (blank, spray) = field.pair(level, cycle, 5);
                    let y = f64::from(spray[0]) - f64::from(blank[0]) - truth.difference[level];
                    n += 1.0;
                    sum += y;
                    squares += y * y;
                }
                let (mean, variance) = (sum / n, squares / n - (sum / n) * (sum / n));
                let is = truth.variance[level];
                assert!(mean.abs() < 4.0 * (is / n).sqrt(), "level {level}: {mean}");
                assert!((variance / is - 1.0).abs() < 4.0 * (3.0_f64 / n).sqrt(), "{level}: {variance} {is}");
            });
        };
        mean_of(&Field { rows: 1, columns: 1, regime: STRONG, common: 0.5 });
    }
}
