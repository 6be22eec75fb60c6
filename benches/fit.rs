//! Times of the accumulator and of the solve on full frames: 640 × 512 pixels, six levels. Minimum of several runs.
//!
//! `cargo bench --bench fit`; `RAYON_NUM_THREADS=1` for one core.

use ditd::estimate::accumulate::Sums;
use ditd::estimate::calibration::SakumaHattori;
use ditd::estimate::map::{CameraNoise, Estimator, FitInputs, solve};
use std::time::Duration;

const ROWS: usize = 512;
const COLUMNS: usize = 640;
const PLATES_K: [f64; 6] = [373.0, 403.0, 433.0, 463.0, 498.0, 533.0];

#[expect(clippy::disallowed_methods, reason = "a bench measures real time")]
fn least(runs: usize, mut work: impl FnMut()) -> Duration {
    (0..runs)
        .map(|_| {
            let start = std::time::Instant::now();
            work();
            start.elapsed()
        })
        .min()
        .unwrap_or_default()
}

#[expect(clippy::print_stdout, reason = "a bench prints")]
fn say(what: &str, time: Duration) {
    println!("{what:32} {:9.3} ms", time.as_secs_f64() * 1e3);
}

fn main() {
    let curve = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
    let mut state = 1_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from(u32::try_from(state >> 40).unwrap_or_default()) / 16_777_216.0 - 0.5
    };
    let mut frame = |signal: &dyn Fn(usize) -> f64| -> Vec<u16> {
        (0..ROWS * COLUMNS)
            .map(|i| {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
                let counts = (1500.0 + signal(i) + 6.0 * noise()).round() as u16;
                counts
            })
            .collect()
    };
    let mut sums = Sums::new(PLATES_K.len(), ROWS, COLUMNS, 1, 16_383).expect("one blank");
    let x: Vec<f64> = PLATES_K.iter().map(|&t| 0.95 * curve.value(t)).collect();
    let mut pair = (Vec::new(), Vec::new());
    for (level, &x) in x.iter().enumerate() {
        for _ in 0..4 {
            #[expect(clippy::cast_precision_loss, reason = "a column")]
            let emissivity = |i: usize| 0.1 + 0.8 * (i % COLUMNS) as f64 / COLUMNS as f64;
            pair = (frame(&|_| 0.95 * x), frame(&|i| 0.95 * (x + emissivity(i) * (58.0 - x))));
            sums.add_cycle(level, &[&pair.0], &pair.1).expect("a frame");
        }
    }
    let mut running = sums.clone();
    let time = least(50, || running.add_cycle(0, &[&pair.0], &pair.1).expect("a frame"));
    say("add_cycle, one blank", time);
    let mut many = Sums::new(1, ROWS, COLUMNS, 10, 16_383).expect("ten blanks");
    let blanks = [pair.0.as_slice(); 10];
    say("add_cycle, ten blanks", least(20, || many.add_cycle(0, &blanks, &pair.1).expect("a frame")));
    let (source, mut target) = (vec![1_u8; ROWS * COLUMNS * 34], vec![0_u8; ROWS * COLUMNS * 34]);
    say("memcpy of the same bytes", least(50, || target.copy_from_slice(std::hint::black_box(&source))));
    std::hint::black_box(&target);
    for estimator in [Estimator::Ols, Estimator::Paper, Estimator::Default] {
        let inputs = FitInputs {
            x_counts: x.iter().map(|&x| Some(x)).collect(),
            gamma_near: 0.95,
            gamma_far: 0.95,
            emissivity_plate: 0.99,
            far_window_counts: 0.0,
            curve,
            range: None,
            camera: CameraNoise { read_noise_counts: 1.2, electrons_per_count: 500.0, zero_counts: 1500.0 },
            estimator,
            confidence: 0.95,
            flat_gain: None,
        };
        let time = least(5, || {
            std::hint::black_box(solve(&sums, &inputs));
        });
        say(&format!("solve, {}", estimator.name()), time);
    }
}
