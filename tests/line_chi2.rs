//! What the χ² of the line sees and what it does not: wrong plate temperatures, media that are not gray, saturation and
//! walls that change between levels bend the line; scattered light of constant walls only shifts it.
//!
//! Generated counts with read noise only, 6 levels × 20 pairs × 900 pixels, fitted with our own estimator. Without a
//! fault the mean χ² is levels − 2 = 4; its standard error over 900 pixels is √(8/900) = 0.09, and weights from pooled
//! variances leave it within a few per cent.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::estimate::accumulate::Sums;
use ditd::estimate::calibration::SakumaHattori;
use ditd::estimate::map::{CONFIDENCE, CameraNoise, DitMap, Estimator, FitInputs, solve};

const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
const PLATES_K: [f64; 6] = [373.0, 403.0, 433.0, 463.0, 498.0, 533.0];
const GAMMA: f64 = 0.95;
const EMISSIVITY: f64 = 0.6;
const SPRAY_K: f64 = 449.0;
const READ_NOISE: f64 = 1.2;
const SIDE: usize = 30;

/// Expected counts of one level: blank and spray, above the offset.
struct Expected {
    blank: f64,
    spray: f64,
}

fn honest(plate_k: f64) -> Expected {
    let x = CURVE.value(plate_k);
    let spray = GAMMA * (GAMMA * x + EMISSIVITY * (CURVE.value(SPRAY_K) - GAMMA * x));
    Expected { blank: GAMMA * GAMMA * x, spray }
}

struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        f64::from(u32::try_from(z >> 33).unwrap()) / 2_147_483_648.0
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Mean χ² and median temperature of a map with these expected counts; `top` is where the detector stops counting.
fn fitted(expected: &[Expected], x: &[f64], top: f64) -> (f64, f64) {
    let mut sums = Sums::new(expected.len(), SIDE, SIDE, 1, 16_383).unwrap();
    let mut noise = Noise(4);
    for (level, counts) in expected.iter().enumerate() {
        for _ in 0..20 {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts near 1500")]
            let mut frame = |mean: f64| -> Vec<u16> {
                let sample =
                    |noise: &mut Noise| (1500.0 + mean + READ_NOISE * noise.normal()).min(top).round() as u16;
                (0..SIDE * SIDE).map(|_| sample(&mut noise)).collect()
            };
            let (blank, spray) = (frame(counts.blank), frame(counts.spray));
            sums.add_cycle(level, &[&blank], &spray).unwrap();
        }
    }
    let map: DitMap = solve(
        &sums,
        &FitInputs {
            x_counts: x.iter().map(|&x| Some(x)).collect(),
            gamma_near: GAMMA,
            gamma_far: GAMMA,
            emissivity_plate: 1.0,
            far_window_counts: 0.0,
            curve: CURVE,
            residual: None,
            range: None,
            camera: CameraNoise {
                read_noise_counts: READ_NOISE,
                electrons_per_count: f64::INFINITY,
                zero_counts: 0.0,
            },
            estimator: Estimator::Default,
            confidence: CONFIDENCE,
            flat_gain: None,
        },
    );
    let chi2 = map.chi2.iter().sum::<f64>() / f64::from(u32::try_from(map.chi2.len()).unwrap());
    let mut kelvins = map.temperature_k.clone();
    kelvins.sort_by(f64::total_cmp);
    (chi2, kelvins[kelvins.len() / 2])
}

fn nominal() -> Vec<f64> {
    PLATES_K.iter().map(|&t| GAMMA * CURVE.value(t)).collect()
}

const NO_TOP: f64 = f64::INFINITY;

/// Four standard errors, and five per cent for the weights.
fn is_ordinary(chi2: f64) -> bool {
    (chi2 - 4.0).abs() < 4.0 * 0.09 + 0.2
}

#[test]
fn a_straight_line_has_its_degrees_of_freedom() {
    let (chi2, kelvin) = fitted(&PLATES_K.map(honest), &nominal(), NO_TOP);
    assert!(is_ordinary(chi2), "{chi2}");
    assert!((kelvin - SPRAY_K).abs() < 0.2, "{kelvin}");
}

#[test]
fn a_wrong_level_is_seen() {
    let mut expected = PLATES_K.map(honest);
    expected[3] = honest(PLATES_K[3] - 3.0);
    let (chi2, _) = fitted(&expected, &nominal(), NO_TOP);
    assert!(chi2 > 8.0, "{chi2}");
}

#[test]
fn a_medium_that_is_not_gray_is_seen() {
    // Two halves of a band of their own colours, seen through emissivities of 0.95 and 0.1.
    let halves = [(3.1, 0.95), (3.9, 0.1)].map(|(a_um, emissivity)| {
        let curve = SakumaHattori { a_counts: 1.0, a_um, b_um_k: 0.0 };
        let scale = 0.5 * CURVE.value(SPRAY_K) / curve.value(SPRAY_K);
        (SakumaHattori { a_counts: scale, ..curve }, emissivity)
    });
    let band = |t: f64| halves.iter().map(|(curve, _)| curve.value(t)).sum::<f64>();
    let expected = PLATES_K.map(|plate| {
        let lost =
            |(curve, e): &(SakumaHattori, f64)| e * (curve.value(SPRAY_K) - GAMMA * curve.value(plate));
        let change: f64 = halves.iter().map(lost).sum();
        Expected { blank: GAMMA * GAMMA * band(plate), spray: GAMMA * (GAMMA * band(plate) + change) }
    });
    let x: Vec<f64> = PLATES_K.iter().map(|&t| GAMMA * band(t)).collect();
    let (chi2, _) = fitted(&expected, &x, NO_TOP);
    assert!(chi2 > 8.0, "{chi2}");
}

#[test]
fn saturation_below_its_limit_is_seen() {
    // The hottest blank has 1721 counts; the detector stops at 1710, unknown to the fit.
    let (chi2, _) = fitted(&PLATES_K.map(honest), &nominal(), 1710.0);
    assert!(chi2 > 8.0, "{chi2}");
}

/// w of the walls' light is scattered into the sight. Constant walls keep the line straight and shift its crossing;
/// walls that warm up by 15 K while the plate goes through its levels bend it.
#[test]
fn scattered_light_of_constant_walls_is_not_seen_and_of_changing_walls_is() {
    let share = 0.15;
    let scattered = |walls: [f64; 6]| {
        let mut expected = PLATES_K.map(honest);
        for (counts, wall) in expected.iter_mut().zip(walls) {
            counts.spray += GAMMA * share * CURVE.value(wall);
        }
        fitted(&expected, &nominal(), NO_TOP)
    };
    let (chi2, kelvin) = scattered([523.0; 6]);
    assert!(is_ordinary(chi2), "{chi2}");
    assert!(kelvin - SPRAY_K > 15.0, "{kelvin}");
    let (chi2, _) = scattered([508.0, 514.0, 518.0, 521.0, 522.5, 523.0]);
    assert!(chi2 > 8.0, "{chi2}");
}
