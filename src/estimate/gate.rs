//! Finds spray frames without a spray: misfires that would bias every pixel.
//!
//! A frame's score is the projection of its spray − blank on what the current map predicts for its level: 1 for an
//! ordinary shot, 0 for none. No single pixel could tell; the frame can. Pure: hands back scores, removes nothing.

use super::map::{DitMap, flag};

/// Frames scoring below this are misfires. Good shots score above 0.9, misfires below 0.03 (simulated sprays).
pub const SCORE_MIN: f64 = 0.3;

/// A score is only given if noise alone would move it by less than this (one standard deviation).
const SCORE_SIGMA_MAX: f64 = 0.1;

/// Predicted spray − blank, in counts, and weight of each pixel for one level.
#[derive(Debug, Clone)]
pub struct Prediction {
    counts: Vec<f64>,
    norm: f64,
}

impl Prediction {
    /// What `map` predicts at x. None if the prediction is too weak against noise of `sigma_counts` per sample.
    pub fn at(map: &DitMap, x_counts: f64, sigma_counts: f64) -> Option<Self> {
        let skip = flag::TOO_FEW_LEVELS | flag::DEAD | flag::NO_PLATE | flag::CONSTANT | flag::SATURATED;
        let counts: Vec<f64> = map
            .slope
            .iter()
            .zip(&map.offset)
            .zip(&map.flags)
            .map(|((slope, offset), flags)| {
                let y = slope * x_counts + offset;
                if flags & skip == 0 && y.is_finite() { y } else { 0.0 }
            })
            .collect();
        let norm: f64 = counts.iter().map(|y| y * y).sum();
        (sigma_counts / norm.sqrt() < SCORE_SIGMA_MAX).then_some(Self { counts, norm })
    }

    /// Score of one cycle: `blank_sum` is the sum of `blanks` blank frames, per pixel.
    pub fn score(&self, spray: &[u16], blank_sum: &[u32], blanks: u16) -> f64 {
        let b = f64::from(blanks);
        let product: f64 = self
            .counts
            .iter()
            .zip(spray)
            .zip(blank_sum)
            .map(|((y, &spray), &blank)| y * (f64::from(spray) - f64::from(blank) / b))
            .sum();
        product / self.norm
    }
}
