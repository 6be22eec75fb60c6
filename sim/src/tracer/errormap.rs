//! The error map of an image: what is estimated for some pixels, averaged over those nearby.

use super::image::{Job, Stats, tell};
use super::operator::Operator;
use super::pixels::Refinement;
use super::raster::Raster;
use super::reconstruct::{ROWS, pure_bias};
use rayon::prelude::*;

/// Errors are computed for pixels at this distance, and averaged up to that one.
const ERROR_STRIDE: usize = 4;

/// A multiple of it.
const ERROR_REACH: usize = 8;

/// What is known of a pixel besides its coefficients.
#[derive(Clone, Copy, Default)]
pub(super) struct Summary {
    /// Plate and medium, mean over the groups.
    pub(super) shown: [f32; ROWS],
    /// Noise and bias of plate and medium, single draws.
    pub(super) errors: [[f32; ROWS]; 2],
    /// The same of the wall that is known least.
    pub(super) errors_ends: [f32; 2],
    pub(super) met: bool,
    pub(super) sights: u32,
    pub(super) cells: u32,
}

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
        let count = [rows.div_ceil(ERROR_STRIDE), columns.div_ceil(ERROR_STRIDE)];
        let raster = Raster::new(columns);
        let mut squares = vec![Sum::NONE; count[0] * count[1]];
        for (&pixel, &i) in operator.pixels.iter().zip(active) {
            let at = raster.at(pixel);
            if with_errors(at[0], at[1]) {
                let square = summaries[i].errors.map(|kind| kind.map(|e| e * e));
                squares[at[0] / ERROR_STRIDE * count[1] + at[1] / ERROR_STRIDE] = Sum { square, pixels: 1.0 };
            }
        }
        let mean = Sum::of(squares.iter());
        // A lonely pixel between those with errors is like all of them.
        let squared = around(&squares, count).map(|sums| -> Vec<[f32; ROWS]> {
            sums.iter().map(|sum| if sum.pixels > 0.0 { sum.squared() } else { mean.squared() }).collect()
        });
        let spread: Vec<[f32; ROWS]> = operator
            .pixels
            .par_iter()
            .zip(active)
            .with_min_len(1024)
            .map(|(&pixel, &i)| {
                let at = raster.at(pixel);
                let place = at[0] / ERROR_STRIDE * count[1] + at[1] / ERROR_STRIDE;
                let between = at.map(|i| usize::from(!i.is_multiple_of(ERROR_STRIDE)));
                let near = squared[2 * between[0] + between[1]][place];
                [0, 1].map(|k: usize| {
                    let area = refined[i].error[k];
                    (area * area + near[k]).sqrt()
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

/// Squared errors of some pixels.
#[derive(Clone, Copy)]
struct Sum {
    /// `[noise, bias][row]`.
    square: [[f32; ROWS]; 2],
    pixels: f32,
}

impl Sum {
    const NONE: Self = Self { square: [[0.0; ROWS]; 2], pixels: 0.0 };

    /// Square of the error that they share.
    fn squared(&self) -> [f32; ROWS] {
        let n = 1.0 / self.pixels.max(1.0);
        let [noise, bias] = self.square.map(|square| square.map(|s| n * s));
        [0, 1].map(|k: usize| noise[k] + pure_bias(noise[k], bias[k]))
    }

    #[inline(always)]
    fn of<'a>(all: impl Iterator<Item = &'a Self>) -> Self {
        all.fold(Self::NONE, |all, one| all.plus(one))
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        let square =
            [0, 1].map(|kind: usize| [0, 1].map(|k: usize| self.square[kind][k] + other.square[kind][k]));
        Self { square, pixels: self.pixels + other.pixels }
    }
}

/// Sums over the pixels with errors up to [`ERROR_REACH`] from those in each square of [`ERROR_STRIDE`]: from its corner,
/// its upper edge, its left edge, and its inside.
fn around(squares: &[Sum], [rows, columns]: [usize; 2]) -> [Vec<Sum>; 4] {
    const REACH: usize = ERROR_REACH / ERROR_STRIDE;
    // From a place between two pixels with errors one less is in reach on its near side.
    let near = |i: usize, n: usize, between: usize| i.saturating_sub(REACH - between)..(i + REACH + 1).min(n);
    let across = [0, 1].map(|between| -> Vec<Sum> {
        let row = |row: &[Sum]| -> Vec<Sum> {
            (0..columns).map(|c| Sum::of(row[near(c, columns, between)].iter())).collect()
        };
        squares.chunks_exact(columns.max(1)).flat_map(row).collect()
    });
    [0, 1, 2, 3].map(|k: usize| {
        let of = &across[k % 2];
        let row = |r: usize| {
            let rows = near(r, rows, k / 2);
            (0..columns).map(move |c| Sum::of(rows.clone().map(|r| &of[r * columns + c])))
        };
        (0..rows).flat_map(row).collect()
    })
}

/// Whether a pixel's errors are followed: for one in 16, of which those nearby are averaged.
pub(super) fn with_errors(row: usize, column: usize) -> bool {
    row.is_multiple_of(ERROR_STRIDE) && column.is_multiple_of(ERROR_STRIDE)
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
