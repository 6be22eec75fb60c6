//! Which pixels can meet the medium, what each sees of the plate, and how finely each must be sampled.

use super::bricks::{Bricks, EDGE};
use super::camera::{Camera, PixelFilter, Sights};
use super::plate::Plate;
use super::spectrum::narrow;
use super::vector::Vector;
use rayon::prelude::*;

/// Sub-sights per axis in pixels that the plate's edge crosses.
const EDGE_SIGHTS: usize = 8;

/// Most sub-sights per axis in any other pixel.
pub(super) const SIGHTS_MAX: usize = 8;

/// The error of a single sight for the mean over a pixel, over the largest second difference to its neighbours: for
/// steps and kinks at random places.
const CENTRE_ERROR: f32 = 0.2;

/// The camera with its plate.
pub(super) struct Frame<'a> {
    pub(super) camera: &'a Camera,
    pub(super) sights: &'a Sights,
    pub(super) plate: Option<&'a Plate>,
    /// How far the medium moves during the exposure.
    pub(super) motion: Vector,
}

impl Frame<'_> {
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
        let corners: Vec<bool> = (0..(rows + 1) * (columns + 1))
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| self.sees(real(i / (columns + 1)), real(i % (columns + 1))))
            .collect();
        // A plate smaller than a pixel may miss all corners, but not its own centre.
        let centre = self.plate.and_then(Plate::centre).and_then(|c| self.sights.project(c));
        let around = |pixel: usize| {
            let (row, column) = (real(pixel / columns), real(pixel % columns));
            centre.is_some_and(|(r, c)| (r - row - 0.5).abs() < 1.0 && (c - column - 0.5).abs() < 1.0)
        };
        (0..rows * columns)
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| {
                let (row, column) = (i / columns, i % columns);
                let at = [0, 1, columns + 1, columns + 2].map(|k| corners[row * (columns + 1) + column + k]);
                if at.iter().all(|&c| c == at[0]) && !around(i) {
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

    /// Largest second difference of two images at a pixel, across it in four directions, for each image.
    fn second_difference(&self, images: &[[f32; 2]], pixel: usize) -> [f32; 2] {
        let (rows, columns) = (self.camera.rows, self.camera.columns);
        let (row, column) = (pixel / columns, pixel % columns);
        let mut most = [0.0_f32; 2];
        let (inner_row, inner_column) = (row > 0 && row + 1 < rows, column > 0 && column + 1 < columns);
        let pairs = [
            (inner_column, 1),
            (inner_row, columns),
            (inner_row && inner_column, columns + 1),
            (inner_row && inner_column, columns - 1),
        ];
        for (inside, step) in pairs {
            if inside {
                for k in 0..2 {
                    let twice = images[pixel - step][k] + images[pixel + step][k] - 2.0 * images[pixel][k];
                    most[k] = most[k].max(twice.abs());
                }
            }
        }
        most
    }

    /// Sub-sights per axis that a pixel needs for its mean to keep `tolerance`, and the errors left then of two images.
    pub(super) fn refinement(
        &self,
        images: &[[f32; 2]],
        pixel: usize,
        plate_seen: f32,
        tolerance: f32,
    ) -> (usize, [f32; 2]) {
        if self.camera.pixel_filter == PixelFilter::Centre {
            return (1, [0.0; 2]);
        }
        let error = self.second_difference(images, pixel).map(|s| CENTRE_ERROR * s);
        let worst = error[0].max(error[1]);
        let mut n = 1;
        while n < SIGHTS_MAX && worst > tolerance * power(n) {
            n += 1;
        }
        if plate_seen > 0.0 && plate_seen < 1.0 {
            n = n.max(4);
        }
        (n, error.map(|e| e / power(n)))
    }
}

/// Stratified sights average edges at the rate n^(3/2) of their number per axis.
fn power(n: usize) -> f32 {
    narrow(real(n) * real(n).sqrt())
}

/// Positions of `n`² sub-sights in a pixel.
pub(super) fn sub_sights(row: usize, column: usize, n: usize) -> impl Iterator<Item = (f64, f64)> {
    let place = move |k: usize| (real(k) + 0.5) / real(n);
    (0..n * n).map(move |k| (real(row) + place(k / n), real(column) + place(k % n)))
}

fn index(pixel: usize) -> u32 {
    u32::try_from(pixel).unwrap_or(u32::MAX)
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
