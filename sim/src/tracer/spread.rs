//! Pixels whose sights differ in more than their place in the pixel: through a lens, and over an exposure during which
//! the medium moves.
//!
//! A pixel is the mean over its area, the aperture and the exposure. Sub-sights are points of one scrambled Sobol
//! sequence over all five together, in opposite pairs, so that whatever changes evenly cancels. Two halves of them have
//! scrambles of their own: half their difference is the error of the mean, pooled over neighbouring pixels, and pixels
//! above the target get twice as many.

use super::behind::Behind;
use super::camera::PixelFilter;
use super::chamber::ENDS;
use super::ends;
use super::errormap::Summary;
use super::errormap::with_errors;
use super::exposure::{PIXEL_SHARE, finish};
use super::fine::Fine;
use super::gather::{Field, Light, Sight};
use super::image::{Job, Stats, tell};
use super::lens::disc;
use super::operator::Operator;
use super::pixels::{Frame, Refinement};
use super::sampling::Lit;
use super::shares::ROWS;
use super::sobol::{self, Coordinates, Sequence};
use super::spectrum::{Spectrum, narrow, vectorised};
use super::vector::Vector;
use rayon::prelude::*;

/// Pairs of sub-sights in each half of a pixel's, at first and at most.
const PAIRS_MIN: u32 = 2;
const PAIRS_MAX: u32 = 256;

/// Pairs of pixels that an edge between walls crosses.
const EDGE_PAIRS: u32 = 16;

/// Pixels to either side over which differences are pooled, and again from where a pixel above the target keeps others
/// open: an edge far out of focus touches so few sub-sights at its rim that a pixel alone would not find it.
const REACH: usize = 2;

/// Pixels of one parallel task.
const TASK_PIXELS: usize = 16;

/// Along which neighbours are pooled: rows and columns.
const DIRECTIONS: [[isize; 2]; 4] = [[0, 1], [1, 0], [1, 1], [1, -1]];

/// Names the sequences of the halves of the sub-sights.
pub(super) const NAMES: [u32; 2] = [0x51_6e_75_01, 0x51_6e_75_02];

/// One sight of a pixel: its ray, and how far the medium has moved at its moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct SubSight {
    pub(super) ray: (Vector, Vector),
    pub(super) moved: Vector,
}

impl Frame<'_> {
    /// Whether sights through one place of a pixel differ.
    pub(super) fn spreads(&self) -> bool {
        self.sights.has_lens() || self.moves()
    }

    fn moves(&self) -> bool {
        self.motion.iter().any(|c| *c != 0.0)
    }

    /// The sight at `at` in the unit cube of row, column, aperture (two) and exposure. The exposure is centred at the
    /// scene's own moment.
    #[inline]
    pub(super) fn sub_sight(&self, row: usize, column: usize, at: [f64; 5]) -> SubSight {
        let [r, c] = if self.camera.pixel_filter == PixelFilter::Centre { [0.5; 2] } else { [at[0], at[1]] };
        let ray = self.sights.ray_through(real(row) + r, real(column) + c, disc(at[2], at[3]));
        SubSight { ray, moved: self.motion.map(|m| (at[4] - 0.5) * m) }
    }
}

/// What has been collected of a pixel: plate and medium of the halves, means over the groups.
#[derive(Clone, Copy)]
struct Halves {
    shown: [[f32; ROWS]; 2],
    summary: Summary,
}

impl Job<'_> {
    /// As `gather`, for pixels whose sights spread.
    pub(super) fn gather_spread<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        lit: Option<&Lit<S>>,
        plate_seen: Vec<f32>,
        candidates: &[u32],
        stats: &mut Stats,
    ) -> Operator {
        let chamber = self.options.walls.apart();
        let ends_seen = chamber.map_or_else(Vec::new, |c| self.frame.ends_seen(c, &plate_seen));
        let field = Field {
            fine,
            plate: self.frame.plate,
            chamber,
            light: lit.map(|lit| Light::new(fine, &lit.scattered, &lit.leaves)),
        };
        let width = self.width(fine.groups, fine.channels);
        let mut values = vec![0.0_f32; candidates.len() * width];
        let mut halves: Vec<Halves> = Vec::new();
        let mut errors = vec![[0.0_f32; ROWS]; candidates.len()];
        let mut open: Vec<usize> = (0..candidates.len()).collect();
        let tolerance = PIXEL_SHARE * narrow(self.options.target_error);
        let (rows, columns) = (self.frame.camera.rows, self.frame.camera.columns);
        let mut pairs = 0;
        while !open.is_empty() && pairs < PAIRS_MAX {
            let next = if pairs == 0 { PAIRS_MIN } else { 2 * pairs };
            let mut more = vec![0.0_f32; open.len() * width];
            let added: Vec<Halves> = more
                .par_chunks_mut(width * TASK_PIXELS)
                .zip(open.par_chunks(TASK_PIXELS))
                .flat_map_iter(|(values, chosen)| {
                    let pixels: Vec<u32> = chosen.iter().map(|&i| candidates[i]).collect();
                    self.sub_sights(&field, &pixels, pairs..next, values)
                })
                .collect();
            let share = (next - pairs) as f32 / next as f32;
            if pairs == 0 {
                (values, halves) = (more, added);
            } else {
                for ((&i, more), added) in open.iter().zip(more.chunks_exact(width)).zip(added) {
                    for (value, more) in values[i * width..(i + 1) * width].iter_mut().zip(more) {
                        *value += share * (more - *value);
                    }
                    halves[i].join(&added, share);
                }
            }
            pairs = next;
            let squares: Vec<[f32; ROWS]> = halves.iter().map(Halves::square).collect();
            let before = std::mem::take(&mut open);
            open.clone_from(&before);
            pool([rows, columns], candidates, &squares, &mut open, &mut errors, tolerance);
            if chamber.is_some() && pairs < EDGE_PAIRS {
                // Edges between walls show in none of the errors.
                let seen = |i: usize| &ends_seen[candidates[i] as usize * ENDS..][..ENDS];
                open = before
                    .into_iter()
                    .filter(|&i| open.binary_search(&i).is_ok() || ends::mixed(seen(i)))
                    .collect();
            }
        }
        let summaries: Vec<Summary> = halves.iter().map(|h| h.summary).collect();
        let refined: Vec<Refinement> = errors.iter().map(|&error| Refinement { n: 1, error }).collect();
        let first = 4 * PAIRS_MIN;
        tell(stats, "sights", summaries.iter().map(|s| f64::from(s.sights)).sum());
        tell(stats, "cells_visited", summaries.iter().map(|s| f64::from(s.cells)).sum());
        tell(stats, "pixels_refined", real(summaries.iter().filter(|s| s.sights > first).count()));
        tell(stats, "pixels_unrefined", real(open.len()));
        let rms = |row: usize| {
            (errors.iter().map(|e| f64::from(e[row]).powi(2)).sum::<f64>() / real(errors.len().max(1))).sqrt()
        };
        tell(stats, "error_pixel", rms(0).max(rms(1)));
        let active: Vec<usize> = (0..candidates.len()).filter(|&i| summaries[i].met).collect();
        let behind = Behind { plate: plate_seen, ends: ends_seen };
        let operator = self.assemble(fine, behind, candidates, &values, &active);
        self.with_errors(operator, &summaries, &refined, &active, stats)
    }

    /// Some pairs of sub-sights of some pixels: coefficients into `values`, the means of both halves.
    fn sub_sights<S: Spectrum>(
        &self,
        field: &Field<'_, S>,
        pixels: &[u32],
        pairs: std::ops::Range<u32>,
        values: &mut [f32],
    ) -> Vec<Halves> {
        let (groups, channels) = (field.fine.groups, field.fine.channels);
        let columns = self.frame.camera.columns;
        let width = self.width(groups, channels);
        let mut parts = [vec![0.0_f32; width], vec![0.0_f32; width]];
        let mut out = Vec::with_capacity(pixels.len());
        vectorised(
            #[inline(always)]
            || {
                for (&pixel, values) in pixels.iter().zip(values.chunks_exact_mut(width)) {
                    let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                    let mut found = [Summary::default(); 2];
                    // One call of the sight for both halves and both of a pair: it is a long piece of code.
                    for half in 0..2 {
                        let mut sight = Sight::<S>::new(channels, field.chamber.is_some());
                        let sequence = Sequence::new(sobol::sequence(self.options.seed, pixel, NAMES[half]));
                        let mut run = sequence.from(pairs.start);
                        let mut at = run.next();
                        for i in 0..2 * pairs.len() {
                            if i > 0 && i % 2 == 0 {
                                at = run.next();
                            }
                            let sub = self.frame.sub_sight(row, column, place(&at, i % 2 == 1));
                            if with_errors(row, column) {
                                sight.add_moved::<true>(field, sub.ray, sub.moved, 1.0);
                            } else {
                                sight.add_moved::<false>(field, sub.ray, sub.moved, 1.0);
                            }
                        }
                        found[half] = finish(&sight, groups, &mut parts[half]);
                    }
                    for (value, (a, b)) in values.iter_mut().zip(parts[0].iter().zip(&parts[1])) {
                        *value = 0.5 * (a + b);
                    }
                    out.push(Halves::of(found));
                }
            },
        );
        out
    }
}

/// Errors of the means of the open ones of some pixels: rms of half the differences of their halves (`squares`, of all)
/// over the pixels to either side of each, in that direction where it is largest: blurred edges err along a line. Keeps those open around which one is above the tolerance.
pub(super) fn pool(
    [rows, columns]: [usize; 2],
    pixels: &[u32],
    squares: &[[f32; ROWS]],
    open: &mut Vec<usize>,
    errors: &mut [[f32; ROWS]],
    tolerance: f32,
) {
    let around = |pixel: u32| {
        let (row, column) = (pixel as usize / columns, pixel as usize % columns);
        let columns_near = column.saturating_sub(REACH)..(column + REACH + 1).min(columns);
        (row.saturating_sub(REACH)..(row + REACH + 1).min(rows))
            .flat_map(move |r| columns_near.clone().map(move |c| r * columns + c))
    };
    let mut image = vec![[f32::NAN; ROWS]; rows * columns];
    for (&pixel, square) in pixels.iter().zip(squares) {
        image[pixel as usize] = *square;
    }
    let reach = REACH.cast_signed();
    let inside =
        |start: usize, step: isize, end: usize| start.checked_add_signed(step).filter(|&at| at < end);
    let pooled = |&i: &usize| {
        let (row, column) = (pixels[i] as usize / columns, pixels[i] as usize % columns);
        DIRECTIONS.iter().fold([0.0_f32; ROWS], |most, direction| {
            let (mut sum, mut n) = ([0.0_f32; ROWS], 0.0_f32);
            for step in -reach..=reach {
                let [r, c] = direction.map(|d| d * step);
                let (Some(r), Some(c)) = (inside(row, r, rows), inside(column, c, columns)) else { continue };
                let square = image[r * columns + c];
                if !square[0].is_nan() {
                    sum = [sum[0] + square[0], sum[1] + square[1]];
                    n += 1.0;
                }
            }
            [0, 1].map(|k: usize| most[k].max((sum[k] / n.max(1.0)).sqrt()))
        })
    };
    let found: Vec<[f32; ROWS]> = open.par_iter().with_min_len(256).map(pooled).collect();
    let mut above = vec![false; rows * columns];
    for (&i, error) in open.iter().zip(found) {
        errors[i] = error;
        above[pixels[i] as usize] = error.iter().any(|&e| e > tolerance);
    }
    open.retain(|&i| around(pixels[i]).any(|p| above[p]));
}

impl Halves {
    fn of([a, b]: [Summary; 2]) -> Self {
        let summary = Summary {
            shown: [0, 1].map(|k: usize| 0.5 * (a.shown[k] + b.shown[k])),
            errors: [0, 1].map(|kind: usize| {
                let mean = |k: usize| 0.5 * (a.errors[kind][k].powi(2) + b.errors[kind][k].powi(2));
                [0, 1].map(|k: usize| mean(k).sqrt())
            }),
            errors_ends: [0, 1].map(|kind: usize| {
                (0.5 * (a.errors_ends[kind].powi(2) + b.errors_ends[kind].powi(2))).sqrt()
            }),
            met: a.met || b.met,
            sights: a.sights + b.sights,
            cells: a.cells.saturating_add(b.cells),
        };
        Self { shown: [a.shown, b.shown], summary }
    }

    /// Of half the difference: the variance of the mean, estimated once.
    fn square(&self) -> [f32; ROWS] {
        [0, 1].map(|k: usize| (0.5 * (self.shown[0][k] - self.shown[1][k])).powi(2))
    }

    /// Takes in further sub-sights, which are then so much of all.
    fn join(&mut self, more: &Self, share: f32) {
        let mix = |a: &mut f32, b: f32| *a += share * (b - *a);
        for k in 0..ROWS {
            for half in 0..2 {
                mix(&mut self.shown[half][k], more.shown[half][k]);
            }
            mix(&mut self.summary.shown[k], more.summary.shown[k]);
            for kind in 0..2 {
                mix(&mut self.summary.errors[kind][k], more.summary.errors[kind][k]);
            }
        }
        self.summary.met |= more.summary.met;
        self.summary.sights += more.summary.sights;
        self.summary.cells = self.summary.cells.saturating_add(more.summary.cells);
    }
}

/// The point of a pair in the unit cube, or the opposite one.
#[inline(always)]
pub(super) fn place(at: &Coordinates, opposite: bool) -> [f64; 5] {
    let turn = |u: f64| if opposite { 1.0 - u } else { u };
    [0, 1, 2, 3, 4].map(|d: usize| turn(at.get(d)))
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
