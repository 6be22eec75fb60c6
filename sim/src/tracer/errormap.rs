//! The error map of an image: what is estimated for some pixels, averaged over those nearby.

use super::exposure::Summary;
use super::image::{Job, Stats, tell};
use super::operator::Operator;
use super::pixels::Refinement;
use super::reconstruct::{ROWS, pure_bias};
use rayon::prelude::*;

/// Errors are computed for pixels at this distance, and averaged up to that one.
const ERROR_STRIDE: usize = 4;

const ERROR_REACH: usize = 8;

impl Job<'_> {
    /// The half differences are single draws: their rms over nearby pixels is the error, to which that of the mean over
    /// the pixel's area is added.
    pub(super) fn error_map(
        &self,
        mut operator: Operator,
        summaries: &[Summary],
        refined: &[Refinement],
        active: &[usize],
        stats: &mut Stats,
    ) -> Operator {
        let (rows, columns) = (operator.rows, operator.columns);
        let mut image = vec![[[f32::NAN; ROWS]; 2]; rows * columns];
        let (mut mean, mut count) = ([[0.0_f32; ROWS]; 2], 0.0_f32);
        for (&pixel, &i) in operator.pixels.iter().zip(active) {
            if with_errors(pixel as usize / columns, pixel as usize % columns) {
                let square = summaries[i].errors.map(|kind| kind.map(|e| e * e));
                image[pixel as usize] = square;
                mean = plus(mean, square);
                count += 1.0;
            }
        }
        let mean = mean.map(|kind| kind.map(|m| m / count.max(1.0)));
        let spread: Vec<[f32; ROWS]> = operator
            .pixels
            .par_iter()
            .zip(active)
            .with_min_len(256)
            .map(|(&pixel, &i)| {
                let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                let (mut sum, mut n) = ([[0.0_f32; ROWS]; 2], 0.0_f32);
                let low = [row, column].map(|i| i.saturating_sub(ERROR_REACH).next_multiple_of(ERROR_STRIDE));
                for r in (low[0]..(row + ERROR_REACH + 1).min(rows)).step_by(ERROR_STRIDE) {
                    for c in (low[1]..(column + ERROR_REACH + 1).min(columns)).step_by(ERROR_STRIDE) {
                        let e = image[r * columns + c];
                        if !e[0][0].is_nan() {
                            sum = plus(sum, e);
                            n += 1.0;
                        }
                    }
                }
                if n <= 0.0 {
                    // A lonely pixel between those with errors.
                    (sum, n) = (mean, 1.0);
                }
                [0, 1].map(|k: usize| {
                    let [noise, bias] = sum.map(|kind| kind[k] / n);
                    (noise + pure_bias(noise, bias)).sqrt().hypot(refined[i].error[k])
                })
            })
            .collect();
        operator.error_plate = spread.iter().map(|s| s[0]).collect();
        operator.error_medium = spread.iter().map(|s| s[1]).collect();
        let rms = |errors: &[f32]| {
            (errors.iter().map(|&e| f64::from(e).powi(2)).sum::<f64>() / real(errors.len().max(1))).sqrt()
        };
        tell(stats, "error_plate_rms", rms(&operator.error_plate));
        tell(stats, "error_medium_rms", rms(&operator.error_medium));
        operator
    }

    /// The same of the wall that is known least.
    pub(super) fn ends_error_map(
        &self,
        operator: &Operator,
        summaries: &[Summary],
        refined: &[Refinement],
        active: &[usize],
    ) -> Vec<f32> {
        let frame = Operator {
            rows: operator.rows,
            columns: operator.columns,
            pixels: operator.pixels.clone(),
            ..Operator::default()
        };
        let of_ends = |s: &Summary| Summary { errors: s.errors_ends.map(|e| [e; ROWS]), ..*s };
        let summaries: Vec<Summary> = summaries.iter().map(of_ends).collect();
        let map = self.error_map(frame, &summaries, refined, active, &mut Vec::new());
        map.error_plate.iter().zip(&map.error_medium).map(|(a, b)| a.max(*b)).collect()
    }
}

fn plus(a: [[f32; ROWS]; 2], b: [[f32; ROWS]; 2]) -> [[f32; ROWS]; 2] {
    [0, 1].map(|kind: usize| [0, 1].map(|k: usize| a[kind][k] + b[kind][k]))
}

/// Whether a pixel's errors are followed: for one in 16, of which those nearby are averaged.
pub(super) fn with_errors(row: usize, column: usize) -> bool {
    row.is_multiple_of(ERROR_STRIDE) && column.is_multiple_of(ERROR_STRIDE)
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
