//! From exact sums to the map: emissivity, effective temperature, their uncertainty and flags, per pixel.
//!
//! Spray minus blank is a line in x = γ_far·I_cal(T_plate): slope −γ_near·ε, zero at the crossing S, and the
//! effective temperature follows from I_cal(T_eff) = ε_B·(S + E_f). T_eff is the emissivity-weighted,
//! intensity-averaged temperature of the shots. A pixel without an answer has a flag and NaN, never a guess and never
//! an error. Bits are the same for any number of threads and on any machine of one architecture: no fused
//! operations, logarithms of our own.
//!
//! Knows nothing of files, frames or instruments. In reading order: what goes in (`inputs`), what comes out (`full`,
//! `look`, `answers`) and what the flags mean (`flag`); the walk over the image (`solver`), sums of its rows (`source`), its rows (`rows`, `ahead`, `statistics`,
//! `pool`), a row's way to its answers (`writer`, `ways`), the mathematics (`kernel`: `lines`, `weights`, `verdict`) in vectors (`lanes`) of
//! some `levels`, the pixels that go alone (`single`, `residuals`), temperatures (`thermometer`), pixels beside the `plate`;
//! questions about single pixels (`queries`); single lines (`known`).

mod ahead;
mod answers;
#[cfg(test)]
mod extremes;
pub mod flag;
mod full;
mod inputs;
mod kernel;
mod known;
mod lanes;
mod levels;
mod lines;
mod look;
mod plate;
mod pool;
mod queries;
mod residuals;
mod rows;
mod single;
mod solver;
mod source;
mod statistics;
mod thermometer;
mod verdict;
mod ways;
mod weights;
mod writer;

use super::accumulate::{AccumulateError, Sums};
pub use full::DitMap;
pub use inputs::{CameraNoise, Estimator, FitInputs};
pub use known::{CONFIDENCE, KnownLine, T_KNOWN, known_line};
pub use look::LookMap;
pub use queries::{crossing_shares, detail, lines_with_same_weights, prospects};
pub use single::{Detail, Prospect};
pub use source::Shots;
use source::Source;

/// Most levels of a map.
pub const LEVELS_MAX: usize = 256;

/// Names and units of the f64 channels, in the order of [`DitMap::channels`].
pub const CHANNELS: [(&str, &str); 15] = [
    ("slope", "1"),
    ("offset", "counts"),
    ("crossing", "counts"),
    ("emissivity", "1"),
    ("temperature_k", "K"),
    ("sigma_emissivity", "1"),
    ("sigma_temperature_k", "K"),
    ("chi2", "1"),
    ("emissivity_low", "1"),
    ("emissivity_high", "1"),
    ("temperature_low_k", "K"),
    ("temperature_high_k", "K"),
    ("sigma_t_noise_k", "K"),
    ("gain", "1"),
    ("sigma_gain", "1"),
];

/// Fits every pixel.
///
/// Panics when the inputs do not fit the sums (number of levels, size of the flat), which is the caller's mistake.
pub fn solve(sums: &Sums, inputs: &FitInputs<'_>) -> DitMap {
    let mut map = DitMap::empty();
    solve_into(sums, inputs, &mut map);
    map.keep_counts(sums);
    map
}

/// As [`solve`], into a map whose memory is used again. `count` and `rejected` are left empty.
///
/// Panics as [`solve`].
pub fn solve_into(sums: &Sums, inputs: &FitInputs<'_>, map: &mut DitMap) {
    solver::solve_into(Source::Sums(sums), inputs, map);
}

/// As [`solve_into`], in f32 and only what is looked at, in less than half of the time: temperatures differ by less than a
/// millikelvin, far below their noise.
///
/// Panics as [`solve`].
pub fn look_into(sums: &Sums, inputs: &FitInputs<'_>, map: &mut LookMap) {
    solver::solve_into(Source::Sums(sums), inputs, map);
}

/// As [`look_into`] from recorded cycles that are all at hand, bit for bit, without sums of the whole image: a fifth less time
/// from frames to map.
///
/// # Errors
///
/// None that [`Shots::new`] would have let through.
///
/// Panics as [`solve`].
pub fn look_at(shots: &Shots<'_>, inputs: &FitInputs<'_>, map: &mut LookMap) -> Result<(), AccumulateError> {
    let used = |level: &usize| inputs.x_counts[*level].is_some_and(f64::is_finite);
    let used: Vec<usize> = (0..inputs.x_counts.len()).filter(used).collect();
    let repeated = || used.iter().filter(|&&level| shots.repeats(level)).count();
    if inputs.estimator == Estimator::Default && residuals::Residuals::needed(repeated(), used.len()) {
        // Residuals are pooled over more rows than a band has.
        look_into(&shots.sums()?, inputs, map);
    } else {
        solver::solve_into(Source::Shots(shots), inputs, map);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::{Range, SakumaHattori};

    /// Counts of ten thousands, so that rounding is below 10 mK and noise-free levels test the equations.
    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e7, a_um: 3.4, b_um_k: 1.5 };
    const PLATES_K: [f64; 4] = [403.0, 433.0, 463.0, 533.0];
    const GAMMA_NEAR: f64 = 0.93;
    const GAMMA_FAR: f64 = 0.96;
    const EMISSIVITY_PLATE: f64 = 0.98;
    const FAR_WINDOW: f64 = 150.0;

    fn inputs(estimator: Estimator) -> FitInputs<'static> {
        FitInputs {
            x_counts: PLATES_K.iter().map(|&t| Some(GAMMA_FAR * CURVE.value(t))).collect(),
            gamma_near: GAMMA_NEAR,
            gamma_far: GAMMA_FAR,
            emissivity_plate: EMISSIVITY_PLATE,
            far_window_counts: FAR_WINDOW,
            curve: CURVE,
            residual: None,
            range: None,
            camera: CameraNoise::ROUNDING_ONLY,
            estimator,
            confidence: CONFIDENCE,
            flat_gain: None,
        }
    }

    /// Sums of a row of pixels (emissivity, temperature, gain), two cycles of two blanks; the second cycle is one
    /// count brighter with spray. A gain of zero does not see the plate.
    fn sums(pixels: &[(f64, f64, f64)]) -> Sums {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
        let counts = |signal: f64| (1000.0 + signal).round() as u16;
        let mut sums = Sums::new(PLATES_K.len(), 1, pixels.len(), 2, 60_000).unwrap();
        for (level, &plate) in PLATES_K.iter().enumerate() {
            let x = GAMMA_FAR * CURVE.value(plate);
            let blank: Vec<u16> =
                pixels.iter().map(|p| counts(p.2 * GAMMA_NEAR * (x + FAR_WINDOW))).collect();
            for cycle in [0.0, 1.0] {
                let spray: Vec<u16> = pixels
                    .iter()
                    .map(|&(emissivity, temperature_k, gain)| {
                        let s = CURVE.value(temperature_k) / EMISSIVITY_PLATE - FAR_WINDOW;
                        let signal = x + FAR_WINDOW + emissivity * (s - x);
                        counts(gain * GAMMA_NEAR * signal + cycle)
                    })
                    .collect();
                sums.add_cycle(level, &[&blank, &blank], &spray).unwrap();
            }
        }
        sums
    }

    const ALL: [Estimator; 3] = [Estimator::Default, Estimator::Paper, Estimator::Ols];

    #[test]
    fn windows_plate_and_flat_follow_the_equations() {
        let flat = [1.0, 0.8, 1.0];
        let sums = sums(&[(0.7, 449.0, 1.0), (0.7, 449.0, 0.8), (0.3, 480.0, 1.0)]);
        for estimator in ALL {
            let map = solve(&sums, &FitInputs { flat_gain: Some(&flat), ..inputs(estimator) });
            for (i, (emissivity, temperature)) in
                [(0.7, 449.0), (0.7, 449.0), (0.3, 480.0)].into_iter().enumerate()
            {
                assert!((map.emissivity[i] - emissivity).abs() < 2e-4, "{estimator:?} {}", map.emissivity[i]);
                assert!((map.temperature_k[i] - temperature).abs() < 0.1, "{}", map.temperature_k[i]);
                assert!((map.gain[i] - GAMMA_NEAR * GAMMA_FAR).abs() < 1e-3, "{}", map.gain[i]);
                assert_eq!(map.flags[i], 0);
            }
        }
    }

    #[test]
    fn pixels_beside_the_plate_are_masked() {
        let sums = sums(&[(0.7, 449.0, 1.0), (0.5, 449.0, 1.0), (0.6, 449.0, 0.0)]);
        let map = solve(&sums, &inputs(Estimator::Default));
        assert_eq!(map.flags[0] & flag::NO_PLATE, 0);
        assert_ne!(map.flags[2] & flag::NO_PLATE, 0);
        assert!(map.temperature_k[2].is_nan() && map.emissivity[2].is_nan());
    }

    #[test]
    fn temperatures_outside_the_calibration_are_marked() {
        let sums = sums(&[(0.7, 449.0, 1.0), (0.7, 538.0, 1.0), (0.7, 600.0, 1.0)]);
        let range = Some(Range { low_k: 403.0, high_k: 533.0 });
        for estimator in ALL {
            let map = solve(&sums, &FitInputs { range, ..inputs(estimator) });
            assert_eq!(map.flags[0], 0);
            assert_eq!(map.flags[1], flag::EXTRAPOLATED);
            assert!(map.temperature_k[1].is_finite());
            assert_eq!(map.flags[2], flag::OUT_OF_RANGE);
            assert!(map.temperature_k[2].is_nan() && map.sigma_temperature_k[2].is_nan());
        }
    }

    #[test]
    fn levels_without_x_are_left_out() {
        let sums = sums(&[(0.7, 449.0, 1.0)]);
        for estimator in ALL {
            let mut few = inputs(estimator);
            few.x_counts[1] = None;
            let map = solve(&sums, &few);
            assert!((map.temperature_k[0] - 449.0).abs() < 0.1);
            assert_eq!(map.count, [2, 2, 2, 2]);
            few.x_counts = vec![None, few.x_counts[2], Some(f64::NAN), None];
            let none = solve(&sums, &few);
            assert_eq!(none.flags[0] & flag::TOO_FEW_LEVELS, flag::TOO_FEW_LEVELS);
            assert!(none.channels()[..12].iter().all(|channel| channel[0].is_nan()));
        }
    }

    /// Dead, saturated, empty and one-pixel maps: flags and NaN, whichever the estimator.
    #[test]
    fn nasty_sums_give_flags() {
        for estimator in ALL {
            let empty = Sums::new(4, 2, 3, 2, 60_000).unwrap();
            let map = solve(&empty, &inputs(estimator));
            assert!(map.flags.iter().all(|f| f & flag::TOO_FEW_LEVELS != 0));
            let mut dead = Sums::new(4, 1, 2, 2, 60_000).unwrap();
            for level in 0..4 {
                for _ in 0..2 {
                    dead.add_cycle(level, &[&[0, 60_000], &[0, 60_000]], &[0, 60_000]).unwrap();
                }
            }
            let map = solve(&dead, &inputs(estimator));
            assert_ne!(map.flags[0] & flag::DEAD, 0);
            assert_ne!(map.flags[1] & flag::SATURATED, 0);
            assert!(map.temperature_k.iter().all(|t| t.is_nan()));
            let none = Sums::new(4, 0, 0, 2, 60_000).unwrap();
            assert!(solve(&none, &inputs(estimator)).flags.is_empty());
        }
    }
}
