//! Numbers near the ends of f32: pixels of extreme gains, with no noise and with all that 16 bits can hold.

use super::{CONFIDENCE, CameraNoise, DitMap, Estimator, FitInputs, LookMap, flag, look_into, solve_into};
use crate::estimate::accumulate::Sums;
use crate::estimate::calibration::SakumaHattori;

const ROWS: usize = 12;
const COLUMNS: usize = 48;
const CYCLES: usize = 4;
const PLATES_K: [f64; 5] = [373.0, 403.0, 433.0, 498.0, 533.0];
const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

fn inputs(estimator: Estimator, flat: &[f64]) -> FitInputs<'_> {
    FitInputs {
        x_counts: PLATES_K.iter().map(|&t| Some(0.95 * CURVE.value(t))).collect(),
        gamma_near: 0.95,
        gamma_far: 0.95,
        emissivity_plate: 0.99,
        far_window_counts: 0.0,
        curve: CURVE,
        residual: None,
        range: None,
        camera: CameraNoise::ROUNDING_ONLY,
        estimator,
        confidence: CONFIDENCE,
        flat_gain: Some(flat),
    }
}

/// Shots of pixels of one gain; `noise` is the whole width of what is added to every sample, in raw counts.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
fn sums(gain: f64, noise: f64) -> Sums {
    let mut sums = Sums::new(PLATES_K.len(), ROWS, COLUMNS, 1, u16::MAX).unwrap();
    let mut state = 11_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from(u32::try_from(state >> 40).unwrap()) / 16_777_216.0 - 0.5
    };
    for (level, plate) in PLATES_K.iter().enumerate() {
        let x = 0.95 * CURVE.value(*plate);
        for _ in 0..CYCLES {
            let mut frame = |depth: f64| -> Vec<u16> {
                let each = (0..ROWS * COLUMNS).map(|i| {
                    let emissivity = f64::from(u32::try_from(i % COLUMNS).unwrap() + 4) / 55.0;
                    let shot = depth * emissivity * (1.0 + 0.2 * random());
                    let counts = 32_000.0 + gain * 0.95 * (x + shot * (60.0 - x)) + noise * random();
                    counts.round().clamp(0.0, 65_534.0) as u16
                });
                each.collect()
            };
            let (blank, spray) = (frame(0.0), frame(1.0));
            sums.add_cycle(level, &[&blank], &spray).unwrap();
        }
    }
    sums
}

/// What is looked at in f32 has the flags of the map in f64, and temperatures to a hundredth of their standard deviation or 5
/// mK, and σ to a hundredth: for gains from 1/1000 to 100, each with hardly any noise and with all that 16 bits can hold.
#[test]
fn extreme_gains_and_noises_are_alike_in_f32() {
    let (mut told, mut noisy) = (0, 0);
    for gain in [1e-3, 0.01, 0.03, 0.2, 1.0, 10.0, 100.0] {
        let flat = vec![gain; ROWS * COLUMNS];
        for noise in [0.0, 2.0, 300.0, 64_000.0] {
            let sums = sums(gain, noise);
            for estimator in [Estimator::Default, Estimator::Paper, Estimator::Ols] {
                let inputs = inputs(estimator, &flat);
                let (mut kept, mut look) = (DitMap::empty(), LookMap::empty());
                solve_into(&sums, &inputs, &mut kept);
                look_into(&sums, &inputs, &mut look);
                let case = format!("{estimator:?} gain {gain} noise {noise}");
                let other = (0..kept.flags.len()).filter(|&i| kept.flags[i] != look.flags[i]).count();
                let mut worst = (0.0_f64, 0.0_f64);
                for i in 0..kept.flags.len() {
                    let (t, sigma) = (kept.temperature_k[i], kept.sigma_temperature_k[i]);
                    let (t32, sigma32) =
                        (f64::from(look.temperature_k[i]), f64::from(look.sigma_temperature_k[i]));
                    let (e, e32) = (kept.sigma_emissivity[i], f64::from(look.sigma_emissivity[i]));
                    if kept.flags[i] == look.flags[i] {
                        assert_eq!(t.is_finite(), t32.is_finite(), "{case} {i}");
                        assert_eq!(e.is_finite(), e32.is_finite(), "{case} {i}: {e} {e32}");
                    }
                    if t.is_finite() && t32.is_finite() {
                        worst.0 = worst.0.max((t - t32).abs() / (0.01 * sigma).max(0.005));
                        worst.1 = worst.1.max((sigma32 / sigma - 1.0).abs().max((e32 / e - 1.0).abs()));
                        told += 1;
                    }
                    noisy += usize::from(kept.flags[i] & flag::NOT_RESOLVED != 0);
                }
                assert!(other == 0 && worst.0 < 1.0 && worst.1 < 0.01, "{case}: {other} flags, {worst:?}");
            }
        }
    }
    assert!(told > 20_000 && noisy > 10_000, "{told} {noisy}");
}
