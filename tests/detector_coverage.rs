//! Do the reported intervals hold the truth of the simulated world, detector and all?
//!
//! The estimator alone, without daemon and instruments: a small spray is rendered once; for each of 20 seeds its shot
//! law, drift, warm-up and noise make the frames of 6 levels × 10 cycles, which are summed and fitted with the exact
//! calibration. The truth is the world's own expectation, fitted with the weights of the map. A fraction of some
//! 200 pixels whose shots are correlated scatters by some 10 % from seed to seed, so only the mean is held to limits.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::Preset;
use ditd::estimate::accumulate::Sums;
use ditd::estimate::calibration::{CalibrationPoint, OffsetMode, fit_curve};
use ditd::estimate::map::{self, CameraNoise, Estimator, FitInputs};
use ditd::truth::WorldTruth;
use ditd_sim::rig::build::{self, View};
use ditd_sim::rig::chamber::{Moment, Target, World, WorldParts};
use ditd_sim::rig::detector::{Detector, Exposure};
use ditd_sim::rig::level::Illumination;
use ditd_sim::rig::truth::{Sampling, Truth};
use std::path::Path;

const PLATES_K: [f64; 6] = [373.0, 403.0, 433.0, 463.0, 498.0, 533.0];
const CYCLES: u64 = 10;
const BLANKS: u64 = 2;
const WARM_UP: u64 = 2;
const SEEDS: u32 = 20;
const INTEGRATION_S: f64 = 25e-6;
const ONE_SIGMA: f64 = 0.682_689_492_137_086;

/// Frames of a whole campaign at plate temperatures that are exactly known.
fn acquire(world: &World) -> Sums {
    let (rows, columns) = (world.sights().rows(), world.sights().columns());
    let mut sums = Sums::new(PLATES_K.len(), rows, columns, u16::try_from(BLANKS).unwrap(), 16_383).unwrap();
    let (mut ordinal, mut injection) = (0, 0);
    for (level, &plate_k) in PLATES_K.iter().enumerate() {
        for cycle in 0..CYCLES {
            let begins_s = f64::from(u32::try_from(level).unwrap()) * 900.0
                + f64::from(u32::try_from(cycle).unwrap()) * 15.1;
            let mut frames = Vec::new();
            for position in 0..=WARM_UP + BLANKS {
                let since_pause = u32::try_from(position).unwrap();
                let target =
                    if position == WARM_UP + BLANKS { Target::Spray { injection } } else { Target::Blank };
                let moment = Moment {
                    target,
                    light: Illumination { plate_k, integration_s: INTEGRATION_S, vapour_depth: 0.0 },
                    exposure: Exposure {
                        ordinal,
                        at_s: begins_s + 0.02 * f64::from(since_pause),
                        since_pause,
                    },
                };
                ordinal += 1;
                if position >= WARM_UP {
                    frames.push(world.expose(&moment));
                }
            }
            injection += 1;
            let (spray, blanks) = frames.split_last().unwrap();
            let blanks: Vec<&[u16]> = blanks.iter().map(Vec::as_slice).collect();
            sums.add_cycle(level, &blanks, spray).unwrap();
        }
    }
    sums
}

/// Relative gain of every pixel, from 64 frames of even light and 64 of none.
#[expect(clippy::cast_possible_truncation, reason = "images are f32")]
fn flat(detector: &Detector, pixels: usize) -> Vec<f64> {
    let counts = 5000.0;
    let light = vec![(counts * detector.config().electrons_per_count) as f32; pixels];
    let dark = vec![0.0; pixels];
    let mut sums = vec![0.0; pixels];
    for frame in 0..64 {
        let exposure = Exposure { ordinal: 1_000_000 + frame, at_s: 0.0, since_pause: 9 };
        let (bright, black) = (detector.read(exposure, &light), detector.read(exposure, &dark));
        for (sum, (bright, black)) in sums.iter_mut().zip(bright.iter().zip(&black)) {
            *sum += f64::from(*bright) - f64::from(*black);
        }
    }
    sums.into_iter().map(|sum| sum / (64.0 * counts)).collect()
}

/// The expected differences and exact calibration of a world, as a run folder would keep them.
fn truth_of(world: &World) -> WorldTruth {
    let truth = Truth::new(world, &PLATES_K, INTEGRATION_S, Sampling { points: 512, replicates: 4 }).unwrap();
    let optics = world.optics();
    let curve_k: Vec<f64> = (280..700).map(f64::from).collect();
    let image = |values: &[f64]| truth.image(values, 0.0);
    WorldTruth {
        rows: truth.rows,
        columns: truth.columns,
        plate_k: PLATES_K.to_vec(),
        x_counts: PLATES_K
            .iter()
            .map(|&t| optics.window_transmittances(t).0 * optics.calibration_counts(t, INTEGRATION_S))
            .collect(),
        difference_counts: truth.statistical.difference_counts.iter().map(|level| image(level)).collect(),
        difference_error_counts: truth
            .statistical
            .standard_error_counts
            .iter()
            .map(|level| image(level))
            .collect(),
        gamma_near: optics.window_transmittances(450.0).1,
        emissivity_plate: 0.959,
        far_window_counts: optics.far_window_counts(INTEGRATION_S),
        curve_counts: curve_k.iter().map(|&t| optics.calibration_counts(t, INTEGRATION_S)).collect(),
        curve_k,
        ..WorldTruth::default()
    }
}

#[test]
fn intervals_hold_the_truth_of_the_simulated_world_as_often_as_they_say() {
    let (_, config) = Preset::spray().parsed();
    let rig = config.rig.unwrap();
    let rendered = build::world(&rig, View::Chamber, 1, Path::new(""), &|_, _| {}).unwrap();
    let truth = truth_of(&rendered);
    let points: Vec<CalibrationPoint> = truth
        .curve_k
        .iter()
        .zip(&truth.curve_counts)
        .filter(|(t, _)| (360.0..=560.0).contains(*t))
        .map(|(&temperature_k, &counts)| CalibrationPoint {
            temperature_k,
            counts,
            sigma_counts: 1e-3 * counts,
        })
        .collect();
    let fit = fit_curve(&points, OffsetMode::Free).unwrap();
    let estimators = [Estimator::Default, Estimator::Paper];
    // Per estimator: mean over seeds of the fractions that hold T and ε.
    let mut inside = [[0.0; 2]; 2];
    let mut counted = 0;
    for seed in 100..100 + u64::from(SEEDS) {
        let world = World::new(WorldParts {
            optics: rendered.optics().clone(),
            sights: rendered.sights().clone(),
            detector: rig.detector.clone(),
            fluctuation: rig.fluctuation,
            residual: None,
            seed,
        })
        .unwrap();
        let sums = acquire(&world);
        let flat = flat(world.detector(), truth.rows * truth.columns);
        for (estimator, inside) in estimators.into_iter().zip(&mut inside) {
            let inputs = FitInputs {
                x_counts: truth.x_counts.iter().copied().map(Some).collect(),
                gamma_near: truth.gamma_near,
                gamma_far: rendered.optics().window_transmittances(450.0).0,
                emissivity_plate: truth.emissivity_plate,
                far_window_counts: truth.far_window_counts,
                curve: fit.curve,
                residual: None,
                range: None,
                camera: CameraNoise {
                    read_noise_counts: config.camera.read_noise_counts,
                    electrons_per_count: config.camera.electrons_per_count,
                    zero_counts: rig.detector.offset_counts,
                },
                estimator,
                confidence: ONE_SIGMA,
                flat_gain: Some(&flat),
            };
            let map = map::solve(&sums, &inputs);
            let lines =
                map::lines_with_same_weights(&sums, &inputs, &truth.x_counts, &truth.difference_counts);
            let is = truth.statistical(&lines);
            let pixels: Vec<usize> = (0..flat.len())
                .filter(|&i| is.emissivity[i] > 0.2 && map.temperature_k[i].is_finite())
                .collect();
            counted = pixels.len();
            let part = |low: &[f64], high: &[f64], is: &[f64]| {
                let held = pixels.iter().filter(|&&i| low[i] <= is[i] && is[i] <= high[i]).count();
                f64::from(u32::try_from(held).unwrap()) / f64::from(u32::try_from(pixels.len()).unwrap())
            };
            let t = part(&map.temperature_low_k, &map.temperature_high_k, &is.temperature_k);
            let e = part(&map.emissivity_low, &map.emissivity_high, &is.emissivity);
            eprintln!(
                "seed {seed}, {:7}: T {:.1} %, emissivity {:.1} %",
                estimator.name(),
                100.0 * t,
                100.0 * e
            );
            inside[0] += t / f64::from(SEEDS);
            inside[1] += e / f64::from(SEEDS);
        }
    }
    assert!(counted > 100, "{counted} pixels");
    for (estimator, [t, e]) in estimators.into_iter().zip(inside) {
        eprintln!(
            "{}: 68 % sets hold T in {:.1} %, emissivity in {:.1} %",
            estimator.name(),
            100.0 * t,
            100.0 * e
        );
        assert!((0.55..=0.80).contains(&t), "{}: T in {t}", estimator.name());
        assert!((0.55..=0.80).contains(&e), "{}: emissivity in {e}", estimator.name());
    }
}
