//! What blurred pixels can meet: how far the medium spreads in the image, and what is seen of the plate.
//!
//! Both rest on convexity: all sights of a pixel lie between those from the corners of a polygon around the aperture, at
//! both ends of the exposure.

use super::bricks::Bricks;
use super::camera::PixelFilter;
use super::pixels::Frame;
use super::plate::Plate;
use super::sobol::Sequence;
use super::spectrum::narrow;
use super::vector::Vector;
use rayon::prelude::*;

/// Chords of the aperture on which the border of the plate's image is sought, places tried on each, and halvings between.
const CHORDS: u32 = 64;
const CHORD_PLACES: usize = 8;
const HALVINGS: usize = 8;

/// Corners of the polygon around the aperture.
const CORNERS: usize = 8;

/// Names the sequence of chords.
const NAME: u32 = 0x51_6e_75_03;

impl Frame<'_> {
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
        let chords = Sequence::new(NAME);
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
