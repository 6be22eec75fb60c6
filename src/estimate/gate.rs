//! Finds spray frames without a spray: misfires that would bias every pixel.
//!
//! A frame's score is the projection of its spray − blank on what is expected of its level: 1 for an ordinary shot,
//! 0 for none. No single pixel could tell; the frame can. Pure: judges scores, removes nothing.

/// Frames scoring below this are misfires, unless the campaign says otherwise. Misfires score below 0.03, good shots
/// of simulated sprays above 0.9; a real shot of a fifth of the usual strength is weak, but it belongs to the ensemble.
pub const SCORE_MIN: f64 = 0.2;

/// Cycles that a level must have before one of them can be called a misfire: the map itself rests on them.
const CYCLES_MIN: usize = 3;

/// Median score below which a level is not judged: its frames do not look like the map at all.
const MEDIAN_MIN: f64 = 0.6;

/// Which frames of one level are misfires, from their scores.
///
/// None are where the level cannot tell: fewer than three cycles, or scores that scatter so much that three standard
/// deviations (by the median absolute deviation) reach down to `score_min`. That happens at a plate temperature
/// near the spray's own, where an ordinary shot looks like none.
pub fn misfires(scores: &[f64], score_min: f64) -> Vec<bool> {
    let none = vec![false; scores.len()];
    if scores.len() < CYCLES_MIN || scores.iter().any(|s| !s.is_finite()) {
        return none;
    }
    let middle = median(scores);
    let deviations: Vec<f64> = scores.iter().map(|s| (s - middle).abs()).collect();
    let sigma = 1.4826 * median(&deviations);
    if middle < MEDIAN_MIN || middle - 3.0 * sigma < score_min {
        return none;
    }
    scores.iter().map(|&s| s < score_min).collect()
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
        assert_eq!(misfires(&[1.0, 0.02, 0.95, 1.1], SCORE_MIN), [false, true, false, false]);
        assert_eq!(misfires(&[1.0, 0.02], SCORE_MIN), [false; 2]);
        assert_eq!(misfires(&[1.5, 0.2, 0.6, -0.4, 2.0, 1.0], SCORE_MIN), [false; 6]);
        assert_eq!(misfires(&[0.01, 0.02, 0.03, 1.0], SCORE_MIN), [false; 4]);
        assert_eq!(misfires(&[1.0, f64::NAN, 0.0, 1.0], SCORE_MIN), [false; 4]);
    }
}
