//! Pixels whose sights differ in more than their place in the pixel: through a lens, and over an exposure during which
//! the medium moves.
//!
//! A pixel is the mean over its area, the aperture and the exposure. Sub-sights are points of one scrambled Sobol
//! sequence over all five together, in opposite pairs, so that whatever changes evenly cancels. Two halves of them have
//! scrambles of their own: half their difference is the error of the mean, pooled over neighbouring pixels, and pixels
//! above the target get twice as many.

use super::bricks::Bricks;
use super::camera::PixelFilter;
use super::fine::Fine;
use super::gather::{Field, Light, Sight};
use super::image::{Job, Lit, PIXEL_SHARE, Stats, Summary, finish, tell, with_errors};
use super::lens::disc;
use super::operator::Operator;
use super::pixels::Frame;
use super::plate::Plate;
use super::reconstruct::ROWS;
use super::sobol::{self, Coordinates, Sequence};
use super::spectrum::{Spectrum, narrow, vectorised};
use super::vector::Vector;
use rayon::prelude::*;

/// Pairs of sub-sights in each half of a pixel's, at first and at most.
const PAIRS_MIN: u32 = 2;
const PAIRS_MAX: u32 = 256;

/// Pixels to either side over which differences are pooled, and again from where a pixel above the target keeps others
/// open: an edge far out of focus touches so few sub-sights at its rim that a pixel alone would not find it.
const REACH: usize = 2;

/// Pixels of one parallel task.
const TASK_PIXELS: usize = 16;

/// Chords of the aperture on which the border of the plate's image is sought, places tried on each, and halvings between.
const CHORDS: u32 = 64;
const CHORD_PLACES: usize = 8;
const HALVINGS: usize = 8;

/// Along which neighbours are pooled: rows and columns.
const DIRECTIONS: [[isize; 2]; 4] = [[0, 1], [1, 0], [1, 1], [1, -1]];

/// Corners of the polygon around the aperture.
const CORNERS: usize = 8;

/// Names the sequences of sub-sights and of chords.
pub(super) const NAMES: [u32; 3] = [0x51_6e_75_01, 0x51_6e_75_02, 0x51_6e_75_03];

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

    /// The extreme views of a point, how many there are: one, or those from around the aperture at both ends of the exposure.
    pub(super) fn views(&self) -> usize {
        if self.spreads() { 2 * CORNERS } else { 1 }
    }

    /// Where a point of the medium appears in one of them. All sights lie between the extreme ones: what is in the
    /// middle of a convex set appears inside of the convex hull.
    pub(super) fn view(&self, number: usize, point: Vector) -> Option<(f64, f64)> {
        if !self.spreads() {
            return self.sights.project(point);
        }
        let end = if number < CORNERS { 0.5 } else { -0.5 };
        let point = [0, 1, 2].map(|a| point[a] + end * self.motion[a]);
        self.sights.project_through(point, corner(number % CORNERS))
    }

    /// Sights beside the image that meet what its blur brings in, `stride` pixels apart.
    pub(super) fn beside(&self, bricks: &Bricks, stride: usize) -> Vec<(f64, f64)> {
        let (rows, columns) = (self.camera.rows, self.camera.columns);
        let mut reach = 0.0_f64;
        for number in 0..8 * self.views() {
            let point = bricks
                .point([0, 1, 2].map(|a| if number >> a & 1 == 0 { 0.0 } else { real(bricks.cells[a]) }));
            if let (Some(a), Some(b)) = (self.view(number / 8, point), self.sights.project(point)) {
                reach = reach.max((a.0 - b.0).abs()).max((a.1 - b.1).abs());
            }
        }
        // As far as the image is large, where something is almost at the lens.
        let reach = reach.min(real(rows.max(columns)));
        let steps = (0..).map(|i| -reach + real(i * stride));
        let mut places = Vec::new();
        for row in steps.clone().take_while(|r| *r < real(rows) + reach) {
            for column in steps.clone().take_while(|c| *c < real(columns) + reach) {
                let inside = |v: f64, n: usize| (0.0..=real(n)).contains(&v);
                if !(inside(row, rows) && inside(column, columns)) {
                    places.push((row, column));
                }
            }
        }
        places
    }

    /// Share of each pixel's sights that see the plate through the lens.
    pub(super) fn plate_seen_through(&self, plate: &Plate) -> Vec<f32> {
        let columns = self.camera.columns;
        let chords = Sequence::new(NAMES[2]);
        (0..self.camera.rows * columns)
            .into_par_iter()
            .with_min_len(256)
            .map(|pixel| {
                let (row, column) = (pixel / columns, pixel % columns);
                self.seen_wholly(plate, row, column)
                    .unwrap_or_else(|| self.seen_partly(plate, row, column, &chords))
            })
            .collect()
    }

    /// 1 or 0 where all sights or none of a pixel see the plate, if that is plain.
    fn seen_wholly(&self, plate: &Plate, row: usize, column: usize) -> Option<f32> {
        let (mut hits, mut low, mut high) = (0, [f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let mut known = true;
        for number in 0..4 * CORNERS {
            let (r, c) = (real(row + (number & 1)), real(column + (number >> 1 & 1)));
            let (origin, direction) = self.sights.ray_through(r, c, corner(number / 4));
            hits += usize::from(plate.hit(origin, direction).is_some());
            match plate.place(origin, direction) {
                Some(place) => {
                    low = [0, 1].map(|k| low[k].min(place[k]));
                    high = [0, 1].map(|k| high[k].max(place[k]));
                }
                None => known = false,
            }
        }
        // The plate is convex, and so is what the sights meet of its plane.
        let beside = known && (0..2).any(|k| low[k] > 1.0 || high[k] < -1.0);
        if hits == 4 * CORNERS { Some(1.0) } else { beside.then_some(0.0) }
    }

    /// Mean over chords across the aperture of the part of each that sees the plate: one piece of it, the plate being
    /// convex.
    fn seen_partly(&self, plate: &Plate, row: usize, column: usize, chords: &Sequence) -> f32 {
        let centre = self.camera.pixel_filter == PixelFilter::Centre;
        let (mut seen, mut all) = (0.0, 0.0);
        let mut run = chords.from(0);
        for _ in 0..CHORDS {
            let at = run.next();
            let [r, c] = if centre { [0.5; 2] } else { [at.get(0), at.get(1)] };
            let height = 2.0 * at.get(2) - 1.0;
            let half = (1.0 - height * height).sqrt();
            let sees = |x: f64| {
                let (origin, direction) =
                    self.sights.ray_through(real(row) + r, real(column) + c, [x * half, height]);
                plate.hit(origin, direction).is_some()
            };
            let places: [f64; CHORD_PLACES + 1] =
                std::array::from_fn(|i| 2.0 * real(i) / real(CHORD_PLACES) - 1.0);
            let on = places.map(sees);
            let mut part = 0.0;
            for i in 0..CHORD_PLACES {
                let (mut from, mut to) = (places[i], places[i + 1]);
                part += if on[i] == on[i + 1] {
                    if on[i] { to - from } else { 0.0 }
                } else {
                    let (begin, end) = (from, to);
                    for _ in 0..HALVINGS {
                        let middle = 0.5 * (from + to);
                        if sees(middle) == on[i] { from = middle } else { to = middle }
                    }
                    let border = 0.5 * (from + to);
                    if on[i] { border - begin } else { end - border }
                };
            }
            seen += half * part;
            all += 2.0 * half;
        }
        narrow(seen / all)
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
            light: lit.map(|lit| Light::new(&lit.scattered, &lit.leaves)),
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
            pool([rows, columns], candidates, &squares, &mut open, &mut errors, tolerance);
        }
        let summaries: Vec<Summary> = halves.iter().map(|h| h.summary).collect();
        let refined: Vec<(usize, [f32; ROWS])> = errors.iter().map(|&e| (1, e)).collect();
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
        let mut operator = self.assemble(fine, plate_seen, candidates, &values, &active);
        operator.ends_seen = ends_seen;
        self.errors(operator, &summaries, &refined, &active, stats)
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
        let mut sight = Sight::<S>::new(channels, field.chamber.is_some());
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
                        sight.clear();
                        (sight.sights, sight.cells) = (0, 0);
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
            error: [0, 1].map(|k: usize| (0.5 * (a.error[k].powi(2) + b.error[k].powi(2))).sqrt()),
            error_ends: (0.5 * (a.error_ends.powi(2) + b.error_ends.powi(2))).sqrt(),
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
            mix(&mut self.summary.error[k], more.summary.error[k]);
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

/// A corner of the polygon around the unit disc.
fn corner(number: usize) -> [f64; 2] {
    let step = std::f64::consts::PI / real(CORNERS);
    let (sine, cosine) = (2.0 * step * real(number)).sin_cos();
    [cosine / step.cos(), sine / step.cos()]
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
