//! Which pixels can meet the medium, what each sees of the plate, and how finely each must be sampled.

use super::behind::Behind;
use super::bricks::{Bricks, EDGE};
use super::camera::{Camera, PixelFilter, Sights};
use super::plate::Plate;
use super::raster::Raster;
use super::spectrum::{narrow, vectorised};
use super::vector::Vector;
use rayon::prelude::*;

/// Sub-sights per axis in pixels that the plate's edge crosses.
const EDGE_SIGHTS: usize = 8;

/// Steps by √½ in the search for the error at which pixels are refined.
const HALVINGS_MAX: usize = 48;

/// Most sub-sights per axis in any other pixel.
pub(super) const SIGHTS_MAX: usize = 8;

/// The error of a single sight for the mean over a pixel, over the largest second difference to its neighbours: that of a
/// kink in its middle.
const CENTRE_ERROR: f32 = 1.0 / 8.0;

/// About so many pixels are looked at in the search for the error at which pixels are refined.
const SEARCHED: usize = 8192;

/// The camera with its plate.
pub(super) struct Frame<'a> {
    pub(super) camera: &'a Camera,
    pub(super) sights: &'a Sights,
    pub(super) plate: Option<&'a Plate>,
    /// How far the medium moves during the exposure.
    pub(super) motion: Vector,
}

impl Frame<'_> {
    pub(super) fn raster(&self) -> Raster {
        Raster::new(self.camera.columns)
    }

    /// The pixels whose area meets the projection of an occupied brick, ascending.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the image before they become indices"
    )]
    pub(super) fn candidates(&self, bricks: &Bricks, occupied: &[usize]) -> Vec<u32> {
        let (rows, columns) = (self.camera.rows, self.camera.columns);
        let mut marked = vec![false; rows * columns];
        for &b in occupied {
            let low = bricks.at(b).map(|c| c * EDGE);
            let high = [0, 1, 2].map(|a| (low[a] + EDGE).min(bricks.cells[a]));
            let (mut from, mut to) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for corner in 0..8 * self.views() {
                let units = [0, 1, 2].map(|a| real(if corner >> a & 1 == 0 { low[a] } else { high[a] }));
                let Some((row, column)) = self.view(corner / 8, bricks.point(units)) else {
                    // Around or behind the pinhole: it may appear anywhere.
                    return (0..rows * columns).map(index).collect();
                };
                from = [from[0].min(row), from[1].min(column)];
                to = [to[0].max(row), to[1].max(column)];
            }
            // A pixel is met through rounding too.
            let first = [from[0] - 1e-6, from[1] - 1e-6].map(|v| v.max(0.0) as usize);
            let last = [to[0] + 1e-6, to[1] + 1e-6].map(|v| (v.max(-1.0) + 1.0) as usize);
            for row in first[0]..last[0].min(rows) {
                let from = first[1].min(columns);
                let to = last[1].min(columns).max(from);
                marked[row * columns + from..row * columns + to].iter_mut().for_each(|m| *m = true);
            }
        }
        (0..rows * columns).filter(|&i| marked[i]).map(index).collect()
    }

    /// Share of each pixel's area that sees the plate.
    pub(super) fn plate_seen(&self) -> Vec<f32> {
        let (rows, columns) = (self.camera.rows, self.camera.columns);
        let Some(plate) = self.plate else { return vec![0.0; rows * columns] };
        if self.sights.has_lens() {
            return self.plate_seen_through(plate);
        }
        if self.camera.pixel_filter == PixelFilter::Centre {
            return (0..rows * columns)
                .into_par_iter()
                .with_min_len(1024)
                .map(|i| f32::from(u8::from(self.sees(real(i / columns) + 0.5, real(i % columns) + 0.5))))
                .collect();
        }
        let mut corners = vec![false; (rows + 1) * (columns + 1)];
        corners.par_chunks_mut(columns + 1).enumerate().for_each(|(row, corners)| {
            let [first, step] = self.sights.row(real(row));
            if let Some(plate) = self.plate {
                vectorised(
                    #[inline(always)]
                    || plate.covers(first, step, corners),
                );
            }
        });
        // A plate smaller than a pixel may miss all corners, but not its own centre.
        let raster = self.raster();
        let centre = self.plate.and_then(Plate::centre).and_then(|c| self.sights.project(c));
        let around = |row: usize, column: usize| {
            centre.is_some_and(|(r, c)| {
                (r - real(row) - 0.5).abs() < 1.0 && (c - real(column) - 0.5).abs() < 1.0
            })
        };
        (0..rows * columns)
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| {
                let [row, column] = raster.at(index(i));
                let at = [0, 1, columns + 1, columns + 2].map(|k| corners[row * (columns + 1) + column + k]);
                if at.iter().all(|&c| c == at[0]) && !around(row, column) {
                    return f32::from(u8::from(at[0]));
                }
                let hits = sub_sights(row, column, EDGE_SIGHTS).filter(|&(r, c)| self.sees(r, c)).count();
                narrow(real(hits) / real(EDGE_SIGHTS * EDGE_SIGHTS))
            })
            .collect()
    }

    /// Whether the middle of a pixel's area, or any other place of it, looks at the plate.
    pub(super) fn sees(&self, row: f64, column: f64) -> bool {
        let (origin, direction) = self.sights.ray(row, column);
        self.plate.is_some_and(|p| p.hit(origin, direction).is_some())
    }

    /// Width of a pixel at the middle of the medium, in cells.
    pub(super) fn pixel_in_cells(&self, bricks: &Bricks) -> f64 {
        use super::vector::{along, dot, sub};
        let centre = bricks.point(bricks.cells.map(|n| 0.5 * real(n)));
        let distance = self.sights.towards(centre).1.max(0.0);
        let (row, column) = (0.5 * real(self.camera.rows), 0.5 * real(self.camera.columns));
        let [(o0, d0), (o1, d1)] = [0.0, 1.0].map(|c| self.sights.ray(row, column + c));
        let apart = sub(along(o1, distance, d1), along(o0, distance, d0));
        let smallest = bricks.size.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        dot(apart, apart).sqrt() / smallest
    }

    /// Largest second difference of two images at a pixel over `reach` pixels, across it in four directions.
    fn second_difference(&self, images: &[[f32; 2]], pixel: u32, reach: usize) -> [f32; 2] {
        let (rows, columns) = (self.camera.rows, self.camera.columns);
        let [row, column] = self.raster().at(pixel);
        let pixel = pixel as usize;
        let mut most = [0.0_f32; 2];
        let inner = |i: usize, n: usize| i >= reach && i + reach < n;
        let (inner_row, inner_column) = (inner(row, rows), inner(column, columns));
        let pairs = [
            (inner_column, 1),
            (inner_row, columns),
            (inner_row && inner_column, columns + 1),
            (inner_row && inner_column, columns - 1),
        ];
        for (inside, step) in pairs {
            if inside {
                let (before, behind) = (images[pixel - reach * step], images[pixel + reach * step]);
                for k in 0..2 {
                    most[k] = most[k].max((before[k] + behind[k] - 2.0 * images[pixel][k]).abs());
                }
            }
        }
        most
    }

    /// Sights per axis for each of the pixels so that the rms of the errors of their means is below `budget` with the
    /// fewest sights, and the errors left then of two images. `interpolated` are the errors of pixels that have no sight
    /// yet; nothing where all have one. `settled` is an earlier answer: what it left out stays left out.
    ///
    /// n² sights leave an error of e/n^(3/2): the sum of the former is least for a given sum of squares of the latter when
    /// n is proportional to e^(2/5); n = 0 where leaving it out costs less than that.
    pub(super) fn refinements(
        &self,
        images: &[[f32; 2]],
        pixels: &[u32],
        behind: &Behind,
        interpolated: &[Option<[f32; 2]>],
        settled: &[Refinement],
        budget: f32,
    ) -> Vec<Refinement> {
        let centre = self.camera.pixel_filter == PixelFilter::Centre;
        // Between samples the image is known two pixels apart: a kink bends it by about twice as much there.
        let (reach, scale) =
            if interpolated.is_empty() { (1, CENTRE_ERROR) } else { (2, 0.5 * CENTRE_ERROR) };
        let known: Vec<Known> = pixels
            .par_iter()
            .enumerate()
            .with_min_len(1024)
            .map(|(i, &p)| {
                let bent = |p: u32| self.second_difference(images, p, reach).map(|s| scale * s);
                Known {
                    single: if centre { [0.0; 2] } else { bent(p) },
                    interpolated: interpolated
                        .get(i)
                        .copied()
                        .flatten()
                        .filter(|e| e.iter().all(|v| v.is_finite())),
                    least: if centre { 1 } else { behind.sights_min(p as usize) },
                    settled: settled.get(i).copied().filter(|s| s.n == 0),
                }
            })
            .collect();
        // The error of a pixel that one sight is just good enough for, found by halving with a part of the pixels.
        let part = || {
            known.iter().step_by(if known.len() > 4 * SEARCHED { (known.len() / SEARCHED) | 1 } else { 1 })
        };
        let rms = |unit: f32| -> f32 {
            let mut sums = [0.0_f64; 2];
            for pixel in part() {
                let error = pixel.refinement(unit).error;
                sums = [0, 1].map(|k: usize| sums[k] + f64::from(error[k]).powi(2));
            }
            narrow((sums[0].max(sums[1]) / real(part().count().max(1))).sqrt())
        };
        let most = |e: [f32; 2]| e[0].max(e[1]);
        let mut unit =
            part().fold(0.0_f32, |all, p| all.max(most(p.single)).max(p.interpolated.map_or(0.0, most)));
        for _ in 0..HALVINGS_MAX {
            if rms(unit) <= budget {
                break;
            }
            unit *= 0.5_f32.sqrt();
        }
        known.par_iter().with_min_len(1024).map(|pixel| pixel.refinement(unit)).collect()
    }
}

/// What is known of a pixel before it is refined.
struct Known {
    /// Errors of two images after one sight.
    single: [f32; 2],
    /// Their errors without any, where it has none.
    interpolated: Option<[f32; 2]>,
    /// Fewest sights per axis, above 1 where what is behind changes across it.
    least: usize,
    /// Whether it stays without.
    settled: Option<Refinement>,
}

impl Known {
    /// The sights for the least n² + (error/unit)²/1.5: `unit` is what one sight is worth.
    fn refinement(&self, unit: f32) -> Refinement {
        if let Some(settled) = self.settled {
            return settled;
        }
        let error = self.single[0].max(self.single[1]);
        let mut n = 1;
        if error > unit {
            let wanted = (error / unit).powf(0.4);
            n = (1..SIGHTS_MAX).find(|&n| wanted <= narrow(real(n)) + 0.5).unwrap_or(SIGHTS_MAX);
        }
        if self.least > 1 {
            n = n.max(self.least);
        } else if let Some(interpolated) = self.interpolated {
            let (without, with) = (interpolated[0].max(interpolated[1]), error / power(n));
            if without * without <= with * with + 1.5 * unit * unit * narrow(real(n * n)) {
                return Refinement { n: 0, error: interpolated };
            }
        }
        Refinement { n, error: self.single.map(|e| e / power(n)) }
    }
}

/// How finely one pixel is sampled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refinement {
    /// Sights per axis; none where it is interpolated.
    pub(super) n: usize,
    /// Errors left of the means of two images.
    pub(super) error: [f32; 2],
}

/// Stratified sights average edges at the rate n^(3/2) of their number per axis.
fn power(n: usize) -> f32 {
    narrow(real(n) * real(n).sqrt())
}

/// Rows and columns of a tile of pixels whose sights run through the same cells. Samples of every other column of it fill a
/// packet.
const TILE: [usize; 2] = [16, 32];

/// Things that belong to pixels (each told by `pixel`) tile by tile, in their order within each: one row after the other
/// would run through more cells than caches hold before it comes back to the same ones.
pub(super) fn in_tiles<T: Copy>(raster: Raster, things: &[T], pixel: impl Fn(&T) -> u32) -> Vec<T> {
    let across = raster.columns().div_ceil(TILE[1]);
    let tile = |thing: &T| {
        let [row, column] = raster.at(pixel(thing));
        row / TILE[0] * across + column / TILE[1]
    };
    let mut starts: Vec<usize> = Vec::new();
    for thing in things {
        let tile = tile(thing);
        if starts.len() < tile + 2 {
            starts.resize(tile + 2, 0);
        }
        starts[tile + 1] += 1;
    }
    for tile in 1..starts.len() {
        starts[tile] += starts[tile - 1];
    }
    let mut sorted = things.to_vec();
    for thing in things {
        let next = &mut starts[tile(thing)];
        sorted[*next] = *thing;
        *next += 1;
    }
    sorted
}

/// Positions of `n`² sub-sights in a pixel.
pub(super) fn sub_sights(row: usize, column: usize, n: usize) -> impl Iterator<Item = (f64, f64)> {
    (0..n * n).map(move |k| sub_sight(row, column, n, k))
}

/// The k-th of them: one in each of n² squares, and one in each of n² strips along rows as along columns (Chiu, Shirley
/// and Wang, Graphics Gems IV, 1994, without their jitter), so that edges along them are averaged as well as others.
#[inline(always)]
pub(super) fn sub_sight(row: usize, column: usize, n: usize, k: usize) -> (f64, f64) {
    let (i, j, wide) = (real(k / n), real(k % n), real(n));
    (real(row) + (i + (j + 0.5) / wide) / wide, real(column) + (j + (i + 0.5) / wide) / wide)
}

fn index(pixel: usize) -> u32 {
    u32::try_from(pixel).unwrap_or(u32::MAX)
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sub_sights_share_no_square_no_row_and_no_column() {
        for n in 1..=EDGE_SIGHTS {
            let all: Vec<(f64, f64)> = sub_sights(3, 5, n).collect();
            let strip = |value: f64, strips: usize| (value.fract() * real(strips)).floor();
            let distinct = |of: &dyn Fn(&(f64, f64)) -> [f64; 2]| {
                let mut found: Vec<[u64; 2]> = all.iter().map(|at| of(at).map(f64::to_bits)).collect();
                found.sort_unstable();
                found.dedup();
                found.len()
            };
            assert_eq!(distinct(&|at| [strip(at.0, n), strip(at.1, n)]), n * n);
            assert_eq!(distinct(&|at| [strip(at.0, n * n), 0.0]), n * n);
            assert_eq!(distinct(&|at| [strip(at.1, n * n), 0.0]), n * n);
            // They lie evenly about the middle.
            let sum = all.iter().fold([0.0; 2], |sum, at| [sum[0] + at.0, sum[1] + at.1]);
            let middle = sum.map(|s| s / real(n * n));
            assert!((middle[0] - 3.5).abs() < 1e-12 && (middle[1] - 5.5).abs() < 1e-12, "{middle:?}");
        }
    }
}
