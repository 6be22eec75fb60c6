//! The error map of an image: what is estimated for some pixels, averaged over those nearby.

use super::image::{Job, Stats, tell};
use super::operator::Operator;
use super::pixels::Refinement;
use super::raster::Raster;
use super::reconstruct::pure_bias;
use super::shares::ROWS;
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
    /// An image with its error maps: of plate and medium, and of the walls where they are told apart.
    pub(super) fn with_errors(
        &self,
        operator: Operator,
        summaries: &[Summary],
        refined: &[Refinement],
        active: &[usize],
        stats: &mut Stats,
    ) -> Operator {
        let mut operator = self.error_map(operator, summaries, refined, active, stats);
        if !operator.ends_seen.is_empty() {
            operator.error_ends = self.ends_error_map(&operator, summaries, refined, active);
        }
        operator
    }

    /// The half differences are single draws: their rms over nearby pixels is the error, to which that of the mean over
    /// the pixel's area is added.
    fn error_map(
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
        let mut seen = Sums::none(count);
        for (&pixel, &i) in operator.pixels.iter().zip(active) {
            let at = raster.at(pixel);
            if with_errors(at[0], at[1]) {
                seen.set(at[0] / ERROR_STRIDE * count[1] + at[1] / ERROR_STRIDE, &summaries[i].errors);
            }
        }
        let squared = seen.around();
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
    fn ends_error_map(
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

/// Kinds of sums: squares of noise and bias of each row, and how many pixels are in them.
const KINDS: usize = 2 * ROWS + 1;
const PIXELS: usize = 2 * ROWS;

/// Sums of squared errors about the places of a coarser image, row by row.
struct Sums {
    size: [usize; 2],
    planes: [Vec<f32>; KINDS],
}

impl Sums {
    fn none(size: [usize; 2]) -> Self {
        Self { size, planes: std::array::from_fn(|_| vec![0.0; size[0] * size[1]]) }
    }

    /// Puts in the one pixel of a place, `[noise, bias][row]`.
    fn set(&mut self, place: usize, errors: &[[f32; ROWS]; 2]) {
        for (plane, error) in self.planes.iter_mut().zip(errors.as_flattened()) {
            plane[place] = error * error;
        }
        self.planes[PIXELS][place] = 1.0;
    }

    /// Squares of the errors of pixels up to [`ERROR_REACH`] from those in each square of [`ERROR_STRIDE`]: from its
    /// corner, its upper edge, its left edge, and its inside.
    fn around(&self) -> [Vec<[f32; ROWS]>; 4] {
        // A lonely pixel between those with errors is like all of them.
        let mean = squared(self.planes.each_ref().map(|plane| plane.iter().sum()));
        let across =
            [0, 1].map(|between| self.planes.each_ref().map(|plane| self.along_rows(plane, between)));
        [0, 1, 2, 3].map(|k: usize| {
            let sums = across[k % 2].each_ref().map(|plane| self.along_columns(plane, k / 2));
            (0..self.size[0] * self.size[1])
                .map(|at| {
                    let here = sums.each_ref().map(|plane| plane[at]);
                    if here[PIXELS] > 0.0 { squared(here) } else { mean }
                })
                .collect()
        })
    }

    /// Sums over the places of the same row within reach; from a `between` place one less is, on its near side.
    fn along_rows(&self, plane: &[f32], between: usize) -> Vec<f32> {
        let mut sums = vec![0.0_f32; plane.len()];
        let columns = self.size[1];
        for (sums, row) in sums.chunks_exact_mut(columns.max(1)).zip(plane.chunks_exact(columns.max(1))) {
            for back in 0..=(REACH - between).min(columns) {
                sums[back..].iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            }
            for on in 1..=REACH.min(columns) {
                sums.iter_mut().zip(&row[on..]).for_each(|(sum, value)| *sum += value);
            }
        }
        sums
    }

    /// The same over columns.
    fn along_columns(&self, plane: &[f32], between: usize) -> Vec<f32> {
        let mut sums = vec![0.0_f32; plane.len()];
        let [rows, columns] = self.size;
        for back in 0..=(REACH - between).min(rows) {
            sums[back * columns..].iter_mut().zip(plane).for_each(|(sum, value)| *sum += value);
        }
        for on in 1..=REACH.min(rows) {
            sums.iter_mut().zip(&plane[on * columns..]).for_each(|(sum, value)| *sum += value);
        }
        sums
    }
}

/// Places within reach along an axis.
const REACH: usize = ERROR_REACH / ERROR_STRIDE;

/// Square of the error that pixels share whose sums are given.
fn squared(sums: [f32; KINDS]) -> [f32; ROWS] {
    let n = 1.0 / sums[PIXELS].max(1.0);
    [0, 1].map(|row: usize| {
        let (noise, bias) = (n * sums[row], n * sums[ROWS + row]);
        noise + pure_bias(noise, bias)
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

#[cfg(test)]
mod tests {
    use super::super::spectrum::narrow;
    use super::*;

    /// Against sums that are written down place by place.
    #[test]
    fn sums_reach_as_far_as_is_said() {
        for size in [[1, 1], [1, 9], [7, 2], [6, 11]] {
            let mut sums = Sums::none(size);
            let value = |at: usize| narrow(real(at % 5)) + 0.5;
            let filled = |at: usize| !at.is_multiple_of(3);
            for at in (0..size[0] * size[1]).filter(|&at| filled(at)) {
                let v = value(at);
                sums.set(at, &[[v, 2.0 * v], [v, 0.0]]);
            }
            let around = sums.around();
            for (k, around) in around.iter().enumerate() {
                for (at, found) in around.iter().enumerate() {
                    let within = |i: usize, n: usize, between: usize| {
                        i.saturating_sub(REACH - between)..(i + REACH + 1).min(n)
                    };
                    let (mut square, mut pixels) = (0.0, 0.0);
                    for r in within(at / size[1], size[0], k / 2) {
                        for c in within(at % size[1], size[1], k % 2) {
                            let place = r * size[1] + c;
                            if filled(place) {
                                square += value(place).powi(2);
                                pixels += 1.0;
                            }
                        }
                    }
                    if pixels > 0.0 {
                        let noise = square / pixels;
                        let want = [noise + pure_bias(noise, noise), 4.0 * noise];
                        for (found, want) in found.iter().zip(want) {
                            assert!((found - want).abs() < 1e-4 * want, "{size:?} {k} {at}: {found} {want}");
                        }
                    }
                }
            }
        }
    }
}
