//! What the pixels see of a chamber's walls when no medium is in the way.

use super::camera::PixelFilter;
use super::chamber::{Chamber, ENDS};
use super::pixels::{Frame, sub_sights};
use super::sobol::{self, Sequence};
use super::spectrum::narrow;
use rayon::prelude::*;

/// Sub-sights per axis in pixels that an edge between walls, or the plate's, crosses.
pub(super) const EDGE_SIGHTS: usize = 8;

/// Ends of rays, and the plate.
const PLATE: usize = ENDS;

impl Frame<'_> {
    /// Share of each pixel's area that sees each wall and the place outside: `[pixel][end]`, with sum 1 − `plate_seen`.
    pub(super) fn ends_seen(&self, chamber: &Chamber, plate_seen: &[f32]) -> Vec<f32> {
        if self.spreads() {
            return self.ends_spread(chamber, plate_seen);
        }
        let columns = self.camera.columns;
        let centre = self.camera.pixel_filter == PixelFilter::Centre;
        let corners: Vec<usize> = (0..(self.camera.rows + 1) * (columns + 1))
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| self.end(chamber, real(i / (columns + 1)), real(i % (columns + 1))))
            .collect();
        let mut seen = vec![0.0; plate_seen.len() * ENDS];
        seen.par_chunks_exact_mut(ENDS).zip(plate_seen).enumerate().with_min_len(1024).for_each(
            |(pixel, (seen, &plate))| {
                let (row, column) = (pixel / columns, pixel % columns);
                let at = [0, 1, columns + 1, columns + 2].map(|k| corners[row * (columns + 1) + column + k]);
                let even = at.iter().all(|&end| end == at[0]);
                if plate >= 1.0 {
                    return;
                }
                if !centre && even && at[0] != PLATE && plate <= 0.0 {
                    seen[at[0]] = 1.0;
                    return;
                }
                // Walls are convex: a pixel whose corners see one of them sees only that one, and the plate.
                let mut counts = [0_u16; ENDS];
                for (r, c) in sub_sights(row, column, if centre { 1 } else { EDGE_SIGHTS }) {
                    let end = self.end(chamber, r, c);
                    if end != PLATE {
                        counts[end] += 1;
                    }
                }
                let sum: u16 = counts.iter().sum();
                if sum == 0 {
                    // All sub-sights meet the plate, a corner does not.
                    let (origin, direction) = self.sights.ray(real(row) + 0.5, real(column) + 0.5);
                    counts[chamber.end(origin, direction)] = 1;
                }
                for (seen, count) in seen.iter_mut().zip(counts) {
                    *seen = (1.0 - plate) * f32::from(count) / f32::from(sum.max(1));
                }
            },
        );
        seen
    }

    /// The same where the sights through a pixel spread.
    fn ends_spread(&self, chamber: &Chamber, plate_seen: &[f32]) -> Vec<f32> {
        let columns = self.camera.columns;
        let mut seen = vec![0.0; plate_seen.len() * ENDS];
        seen.par_chunks_exact_mut(ENDS).zip(plate_seen).enumerate().with_min_len(1024).for_each(
            |(pixel, (seen, &plate))| {
                if plate >= 1.0 {
                    return;
                }
                let sequence = Sequence::new(sobol::sequence(0, index(pixel), u32::MAX));
                let mut run = sequence.from(0);
                let mut counts = [0_u16; ENDS + 1];
                let mut first = None;
                for _ in 0..EDGE_SIGHTS * EDGE_SIGHTS {
                    let at = run.next();
                    let at = [0, 1, 2, 3, 4].map(|d: usize| at.get(d));
                    let (origin, direction) = self.sub_sight(pixel / columns, pixel % columns, at).ray;
                    let end = chamber.end(origin, direction);
                    first = first.or(Some(end));
                    let plate = self.plate.is_some_and(|p| p.hit(origin, direction).is_some());
                    counts[if plate { PLATE } else { end }] += 1;
                }
                if let (true, Some(end)) = (counts[..ENDS].iter().all(|&n| n == 0), first) {
                    counts[end] = 1;
                }
                let sum: u16 = counts[..ENDS].iter().sum();
                for (seen, count) in seen.iter_mut().zip(counts) {
                    *seen = (1.0 - plate) * f32::from(count) / f32::from(sum.max(1));
                }
            },
        );
        seen
    }

    /// The end of a sight, or the plate.
    fn end(&self, chamber: &Chamber, row: f64, column: f64) -> usize {
        let (origin, direction) = self.sights.ray(row, column);
        let plate = self.plate.is_some_and(|p| p.hit(origin, direction).is_some());
        if plate { PLATE } else { chamber.end(origin, direction) }
    }
}

/// Whether an edge between walls crosses a pixel with these shares.
pub(super) fn mixed(seen: &[f32]) -> bool {
    seen.iter().filter(|&&share| share > 0.0).count() > 1
}

/// Scales the shares of one pixel's ends, `[end][group]`, so that each group's sum closes with plate and medium.
pub(super) fn close(ends: &mut [f32], plate: &[f32], medium: &[f32]) {
    if ends.is_empty() {
        return;
    }
    let groups = plate.len();
    for g in 0..groups {
        let walls = (1.0 - f64::from(plate[g]) - f64::from(medium[g])).max(0.0);
        let sum: f64 = ends.iter().skip(g).step_by(groups).map(|&e| f64::from(e)).sum();
        for end in ends.iter_mut().skip(g).step_by(groups) {
            *end = narrow(if sum > 0.0 { f64::from(*end) * walls / sum } else { walls / real(ENDS) });
        }
    }
}

fn index(pixel: usize) -> u32 {
    u32::try_from(pixel).unwrap_or(u32::MAX)
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
