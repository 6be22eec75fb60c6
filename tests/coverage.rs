//! Do the estimators' error bars tell the truth? Generated shots with known scatter, fitted as a campaign would be.
//!
//! The generator is written for this test and shares nothing with the simulator: Sakuma–Hattori counts, optical
//! depth lognormal and temperature normal from shot to shot with correlation −0.4, half of the scatter common to
//! blocks of 4 × 4 pixels, read and shot noise, rounding to integers. Truth is the ensemble's: E[ε] and the
//! temperature of E[εS]/E[ε], by quadrature.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::estimate::accumulate::Sums;
use ditd::estimate::calibration::SakumaHattori;
use ditd::estimate::map::{CameraNoise, DitMap, Estimator, FitInputs, solve};

const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
const GAMMA: f64 = 0.95;
const EMISSIVITY_PLATE: f64 = 0.99;
const OFFSET: f64 = 1500.0;
const PLATES_K: [f64; 5] = [373.0, 403.0, 433.0, 498.0, 533.0];
const CAMERA: CameraNoise =
    CameraNoise { read_noise_counts: 1.2, electrons_per_count: 500.0, zero_counts: OFFSET };
const CORRELATION: f64 = -0.4;
const ROWS: usize = 96;
const COLUMNS: usize = 112;

#[derive(Clone, Copy)]
struct Regime {
    sigma_ln_tau: f64,
    sigma_k: f64,
}

const CALM: Regime = Regime { sigma_ln_tau: 0.05, sigma_k: 1.0 };
const STRONG: Regime = Regime { sigma_ln_tau: 0.25, sigma_k: 5.0 };

/// A small generator (splitmix64) and Box–Muller.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        #[expect(clippy::cast_precision_loss, reason = "53 bits")]
        let value = ((z >> 11) as f64 + 0.5) / 9_007_199_254_740_992.0;
        value
    }

    fn normals(&mut self) -> [f64; 2] {
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let angle = std::f64::consts::TAU * self.uniform();
        [radius * libm::cos(angle), radius * libm::sin(angle)]
    }
}

/// Mean optical depth and temperature of a pixel: ε from 0.05 to 0.93 across, 395 to 500 K down.
fn pixel(row: usize, column: usize) -> (f64, f64) {
    #[expect(clippy::cast_precision_loss, reason = "pixels")]
    let (down, across) = (row as f64 / (ROWS - 1) as f64, column as f64 / (COLUMNS - 1) as f64);
    (-libm::log1p(-(0.05 + 0.88 * across)), 395.0 + 105.0 * down)
}

/// ε and εS of a shot whose scatter is (u, v) standard normal.
fn shot(depth: f64, temperature_k: f64, regime: Regime, u: f64, v: f64) -> (f64, f64) {
    let w = CORRELATION * u + (1.0 - CORRELATION * CORRELATION).sqrt() * v;
    let emissivity = -libm::expm1(-depth * libm::exp(regime.sigma_ln_tau * u));
    let crossing = CURVE.value(temperature_k + regime.sigma_k * w) / EMISSIVITY_PLATE;
    (emissivity, emissivity * crossing)
}

/// E[ε] and I⁻¹(ε_B E[εS]/E[ε]); a trapezium over ±6 standard deviations is exact to 1e-8 here.
fn truth(depth: f64, temperature_k: f64, regime: Regime) -> (f64, f64) {
    let (mut weight, mut emissivity, mut product) = (0.0, 0.0, 0.0);
    for i in -12..=12 {
        for j in -12..=12 {
            let (u, v) = (0.5 * f64::from(i), 0.5 * f64::from(j));
            let w = libm::exp(-0.5 * (u * u + v * v));
            let (e, es) = shot(depth, temperature_k, regime, u, v);
            weight += w;
            emissivity += w * e;
            product += w * es;
        }
    }
    (emissivity / weight, CURVE.inverse(EMISSIVITY_PLATE * product / emissivity))
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts are near 1500")]
fn sample(noise: f64, signal: f64) -> u16 {
    let counts = OFFSET + signal;
    let variance = CAMERA.read_noise_counts.powi(2) + signal.max(0.0) / CAMERA.electrons_per_count;
    (counts + noise * variance.sqrt()).round() as u16
}

fn generate(regime: Regime, cycles: usize, seed: u64) -> Sums {
    let mut sums = Sums::new(PLATES_K.len(), ROWS, COLUMNS, 1, 16_383).unwrap();
    let mut noise = Noise(seed);
    let blocks = COLUMNS.div_ceil(4);
    for (level, &plate) in PLATES_K.iter().enumerate() {
        let x = GAMMA * CURVE.value(plate);
        for _ in 0..cycles {
            let common: Vec<[f64; 2]> = (0..ROWS.div_ceil(4) * blocks).map(|_| noise.normals()).collect();
            let (mut spray, mut blank) = (vec![0; ROWS * COLUMNS], vec![0; ROWS * COLUMNS]);
            for row in 0..ROWS {
                for column in 0..COLUMNS {
                    let (depth, temperature_k) = pixel(row, column);
                    let [a, b] = common[row / 4 * blocks + column / 4];
                    let [c, d] = noise.normals();
                    let half = std::f64::consts::FRAC_1_SQRT_2;
                    let (e, es) = shot(depth, temperature_k, regime, half * (a + c), half * (b + d));
                    let [p, q] = noise.normals();
                    blank[row * COLUMNS + column] = sample(p, GAMMA * x);
                    spray[row * COLUMNS + column] = sample(q, GAMMA * (x + es - e * x));
                }
            }
            sums.add_cycle(level, &[&blank], &spray).unwrap();
        }
    }
    sums
}

fn fit(sums: &Sums, estimator: Estimator, confidence: f64) -> DitMap {
    let inputs = FitInputs {
        x_counts: PLATES_K.iter().map(|&t| Some(GAMMA * CURVE.value(t))).collect(),
        gamma_near: GAMMA,
        gamma_far: GAMMA,
        emissivity_plate: EMISSIVITY_PLATE,
        far_window_counts: 0.0,
        curve: CURVE,
        residual: None,
        range: None,
        camera: CAMERA,
        estimator,
        confidence,
        flat_gain: None,
    };
    solve(sums, &inputs)
}

/// Rms errors of T and ε where ε > 0.2, and the fraction of sets that hold the truth where ε > 0.05.
struct Score {
    rmse_k: f64,
    rmse_emissivity: f64,
    inside_k: f64,
    inside_emissivity: f64,
    /// Pixels with ε > 0.2 and no temperature.
    without: usize,
}

/// Ensemble truth per pixel: (ε, T).
fn truths(regime: Regime) -> Vec<(f64, f64)> {
    (0..ROWS * COLUMNS)
        .map(|i| {
            let (depth, temperature_k) = pixel(i / COLUMNS, i % COLUMNS);
            truth(depth, temperature_k, regime)
        })
        .collect()
}

fn score(map: &DitMap, truths: &[(f64, f64)]) -> Score {
    let (mut n, mut t2, mut e2, mut without) = (0.0, 0.0, 0.0, 0);
    let (mut inside_k, mut inside_emissivity) = (0.0, 0.0);
    let all = f64::from(u32::try_from(truths.len()).unwrap());
    for (i, &(emissivity, temperature)) in truths.iter().enumerate() {
        if emissivity > 0.2 && map.temperature_k[i].is_finite() {
            n += 1.0;
            t2 += (map.temperature_k[i] - temperature).powi(2);
            e2 += (map.emissivity[i] - emissivity).powi(2);
        }
        without += usize::from(emissivity > 0.2 && map.temperature_k[i].is_nan());
        // An end of the set that is NaN is open.
        let below = |low: f64, value: f64| low.is_nan() || low <= value;
        let above = |high: f64, value: f64| high.is_nan() || value <= high;
        let t = below(map.temperature_low_k[i], temperature) && above(map.temperature_high_k[i], temperature);
        let e = below(map.emissivity_low[i], emissivity) && above(map.emissivity_high[i], emissivity);
        inside_k += f64::from(u8::from(t));
        inside_emissivity += f64::from(u8::from(e));
    }
    Score {
        rmse_k: (t2 / n).sqrt(),
        rmse_emissivity: (e2 / n).sqrt(),
        inside_k: inside_k / all,
        inside_emissivity: inside_emissivity / all,
        without,
    }
}

fn scores(sums: &Sums, truths: &[(f64, f64)], estimator: Estimator, confidence: f64) -> Score {
    let score = score(&fit(sums, estimator, confidence), truths);
    eprintln!(
        "n {:2}, {:7}: T {:.3} K, emissivity {:.4}, without {:2}; {:.0} % sets hold T {:.1} %, emissivity {:.1} %",
        sums.levels()[0].cycles(),
        estimator.name(),
        score.rmse_k,
        score.rmse_emissivity,
        score.without,
        100.0 * confidence,
        100.0 * score.inside_k,
        100.0 * score.inside_emissivity,
    );
    score
}

const ONE_SIGMA: f64 = 0.682_689_492_137_086;

/// The goals: with two or more cycles per level 68 % sets hold the truth in 64 to 73 %, 95 % sets in 92.5 to 98 %, for
/// T and ε; with one cycle 95 % sets in 90 % at least. One standard error of a fraction of 10 752 pixels in blocks of
/// 16 that share half of their scatter is at most 1 %.
fn error_bars_hold(regime: Regime) {
    let truths = truths(regime);
    for n in [1, 2, 3, 10] {
        let sums = generate(regime, n, 1000 + u64::try_from(n).unwrap());
        let wide = scores(&sums, &truths, Estimator::Default, 0.95);
        assert_eq!(wide.without, 0);
        if n == 1 {
            assert!(wide.inside_k > 0.90 && wide.inside_emissivity > 0.90);
            continue;
        }
        let narrow = scores(&sums, &truths, Estimator::Default, ONE_SIGMA);
        for inside in [narrow.inside_k, narrow.inside_emissivity] {
            assert!((0.64..=0.73).contains(&inside), "{inside}");
        }
        for inside in [wide.inside_k, wide.inside_emissivity] {
            assert!((0.925..=0.98).contains(&inside), "{inside}");
        }
    }
}

#[test]
fn error_bars_hold_for_calm_sprays() {
    error_bars_hold(CALM);
}

#[test]
fn error_bars_hold_for_strongly_scattering_sprays() {
    error_bars_hold(STRONG);
}

/// The paper's weights: too narrow, by the expected amount, with ten cycles; and worse in T by a factor with two
/// and three (found: 1.52 and 1.57, 1.22 and 1.25).
#[test]
fn default_beats_the_papers_weights() {
    for regime in [CALM, STRONG] {
        let truths = truths(regime);
        for (n, factor) in [(2, 1.45), (3, 1.15), (10, 0.99)] {
            let sums = generate(regime, n, 1000 + u64::try_from(n).unwrap());
            let paper = scores(&sums, &truths, Estimator::Paper, ONE_SIGMA);
            let ours = scores(&sums, &truths, Estimator::Default, ONE_SIGMA);
            assert!(paper.rmse_k > factor * ours.rmse_k, "n {n}");
            assert!(paper.rmse_emissivity > 0.99 * ours.rmse_emissivity, "n {n}");
            if n == 10 {
                assert!((0.55..=0.80).contains(&paper.inside_k));
            }
        }
    }
}
