//! Finds spray frames without a spray: misfires that would bias every pixel.
//!
//! A frame's score is the projection of its spray − blank on what the current map predicts for its level: 1 for an
//! ordinary shot, 0 for none. No single pixel could tell; the frame can. Pure: hands back scores, removes nothing.

use super::map::{DitMap, flag};

/// Frames scoring below this are misfires. Good shots score above 0.9, misfires below 0.03 (simulated sprays).
pub const SCORE_MIN: f64 = 0.3;

/// Cycles that a level must have before one of them can be called a misfire: the map itself rests on them.
const CYCLES_MIN: usize = 3;

/// Median score below which a level is not judged: its frames do not look like the map at all.
const MEDIAN_MIN: f64 = 0.6;

/// Predicted spray − blank, in counts, and weight of each pixel for one level.
#[derive(Debug, Clone)]
pub struct Prediction {
    counts: Vec<f64>,
    norm: f64,
}

impl Prediction {
    /// What `map` predicts at x. None if it predicts nothing at all.
    pub fn at(map: &DitMap, x_counts: f64) -> Option<Self> {
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
        (norm > 0.0).then_some(Self { counts, norm })
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

/// Which frames of one level are misfires, from their scores.
///
/// None are where the level cannot tell: fewer than three cycles, or scores that scatter so much that three standard
/// deviations (by the median absolute deviation) reach down to [`SCORE_MIN`]. That happens at a plate temperature
/// near the spray's own, where an ordinary shot looks like none.
pub fn misfires(scores: &[f64]) -> Vec<bool> {
    let none = vec![false; scores.len()];
    if scores.len() < CYCLES_MIN || scores.iter().any(|s| !s.is_finite()) {
        return none;
    }
    let middle = median(scores);
    let deviations: Vec<f64> = scores.iter().map(|s| (s - middle).abs()).collect();
    let sigma = 1.4826 * median(&deviations);
    if middle < MEDIAN_MIN || middle - 3.0 * sigma < SCORE_MIN {
        return none;
    }
    scores.iter().map(|&s| s < SCORE_MIN).collect()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let half = sorted.len() / 2;
    if sorted.len() % 2 == 1 { sorted[half] } else { 0.5 * (sorted[half - 1] + sorted[half]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misfires_stand_out_or_nothing_is_said() {
        assert_eq!(misfires(&[1.0, 0.02, 0.95, 1.1]), [false, true, false, false]);
        assert_eq!(misfires(&[1.0, 0.02]), [false; 2]);
        assert_eq!(misfires(&[1.5, 0.2, 0.6, -0.4, 2.0, 1.0]), [false; 6]);
        assert_eq!(misfires(&[0.01, 0.02, 0.03, 1.0]), [false; 4]);
        assert_eq!(misfires(&[1.0, f64::NAN, 0.0, 1.0]), [false; 4]);
    }
}
