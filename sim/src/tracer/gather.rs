//! Along the sights of a camera: exact emission and transmission per cell, plus the reconstructed in-scattered light.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over axes and rows step through several arrays at once"
)]

use super::bricks::{Brick, EDGE, Segment};
use super::cache::Leaves;
use super::chamber::{Chamber, ENDS, SIDES};
use super::fine::{CELLS, Fine};
use super::pieces::Pieces;
use super::plate::Plate;
use super::reconstruct::{InLeaf, Scattered};
use super::shares::ROWS;
use super::spectrum::{Spectrum, narrow};
use super::vector::{Vector, sub};
use std::any::Any;

/// Nothing can be seen through less than this, the smallest normal number of f32 with a margin.
pub(super) const OPAQUE: f32 = 1e-30;

/// What sights run through.
pub(super) struct Field<'a, S> {
    pub(super) fine: &'a Fine<S>,
    pub(super) plate: Option<&'a Plate>,
    /// The chamber whose walls are told apart, if they are.
    pub(super) chamber: Option<&'a Chamber>,
    pub(super) light: Option<Light<'a, S>>,
}

/// In-scattered light by leaves.
pub(super) struct Light<'a, S> {
    scattered: &'a Scattered<S>,
    /// Leaves and centres, in the order of the occupied bricks.
    cuts: Vec<Brick>,
    /// The same for packets of a single group.
    pub(super) pieces: Option<Pieces>,
}

impl<'a, S: Spectrum> Light<'a, S> {
    pub(super) fn new(fine: &Fine<S>, scattered: &'a Scattered<S>, leaves: &Leaves) -> Self {
        let cuts = leaves.occupied.iter().map(|&b| leaves.bricks.list[b]).collect();
        let single = (scattered as &dyn Any).downcast_ref();
        let pieces = fine.single().zip(single).map(|(fine, single)| Pieces::new(fine, single, leaves));
        Self { scattered, cuts, pieces }
    }
}

/// What sights through one pixel collect, groups in lanes.
pub(super) struct Sight<S> {
    /// Share of the plate, in-scattering included.
    pub(super) plate: S,
    /// Emission of channel 0 that is scattered into the sight, and that along the straight sight.
    pub(super) medium: S,
    pub(super) direct: S,
    /// The same of the channels from 1 on: along the straight sight, and scattered into it.
    pub(super) extra: Vec<[S; 2]>,
    /// Noise of plate and channel 0: Σ weight · noise of the cache.
    pub(super) noise: [S; ROWS],
    /// Error of the reconstruction of plate and channel 0: Σ weight · bias of the cache.
    pub(super) bias: [S; ROWS],
    /// Shares of the walls and of the place outside, up to a factor that closure gives; empty unless they are told apart.
    pub(super) ends: Vec<S>,
    /// Noise and error of the reconstruction of the walls' shares: `[noise, bias][wall]`.
    ends_errors: [[S; SIDES]; 2],
    /// Whether any sight met a cell.
    pub(super) met: bool,
    /// Weight of the sights added.
    pub(super) weight: f32,
    /// Sights added, cells visited.
    pub(super) sights: u64,
    pub(super) cells: u64,
}

impl<S: Spectrum> Sight<S> {
    /// Nothing collected yet.
    pub(super) fn new(channels: usize, apart: bool) -> Self {
        Self {
            plate: S::ZERO,
            medium: S::ZERO,
            direct: S::ZERO,
            extra: vec![[S::ZERO; 2]; channels - 1],
            noise: [S::ZERO; ROWS],
            bias: [S::ZERO; ROWS],
            ends: vec![S::ZERO; if apart { ENDS } else { 0 }],
            ends_errors: [[S::ZERO; SIDES]; 2],
            met: false,
            weight: 0.0,
            sights: 0,
            cells: 0,
        }
    }

    /// The same for media of another number of groups, of which the first is meant.
    pub(super) fn widened<T: Spectrum>(&self) -> Sight<T> {
        let wide = |s: S| T::splat(s.get(0));
        Sight {
            plate: wide(self.plate),
            medium: wide(self.medium),
            direct: wide(self.direct),
            extra: self.extra.iter().map(|rows| rows.map(wide)).collect(),
            noise: self.noise.map(wide),
            bias: self.bias.map(wide),
            ends: self.ends.iter().map(|&s| wide(s)).collect(),
            ends_errors: self.ends_errors.map(|rows| rows.map(wide)),
            met: self.met,
            weight: self.weight,
            sights: self.sights,
            cells: self.cells,
        }
    }

    /// Adds the sight from `origin` along `direction` with a weight; its errors only where they are wanted.
    #[inline(always)]
    pub(super) fn add<const ERRORS: bool>(
        &mut self,
        field: &Field<'_, S>,
        ray: (Vector, Vector),
        share: f32,
    ) {
        self.add_moved::<ERRORS>(field, ray, [0.0; 3], share);
    }

    /// The same at a moment at which the medium, but not the plate, has moved.
    #[inline(always)]
    pub(super) fn add_moved<const ERRORS: bool>(
        &mut self,
        field: &Field<'_, S>,
        ray: (Vector, Vector),
        moved: Vector,
        share: f32,
    ) {
        let (origin, direction) = ray;
        let fine = field.fine;
        let hit = field.plate.and_then(|p| p.hit(origin, direction));
        let origin = sub(origin, moved);
        let mut through = S::splat(share);
        let extra = fine.channels - 1;
        let mut own = S::ZERO;
        let mut run = Run::<S>::new();
        let mut cells = 0;
        let origin_units = fine.bricks.units(origin);
        let size = fine.bricks.size;
        let step = [direction[0] / size[0], direction[1] / size[1], direction[2] / size[2]];
        let mut march = fine.bricks.march(origin, direction, hit.unwrap_or(f64::INFINITY));
        while let Some(Segment { place, block, start, end }) = march.next() {
            let [k, albedo] = fine.core[place];
            if !k.any_above(0.0) {
                continue;
            }
            cells += 1;
            let (passed, stopped) = k.split(narrow(end - start));
            let weight = through.times(stopped);
            through = through.times(passed);
            let turned = weight.times(albedo);
            own = own.plus(weight.minus(turned));
            if extra > 0 {
                let o = fine.ordinal[place] as usize;
                for c in 0..extra {
                    let to = &mut self.extra[c][0];
                    *to = to.plus_product(weight, fine.source[o * extra + c]);
                }
            }
            if let Some(light) = &field.light {
                let [x, y, z] = block;
                let cut = light.cuts[place / CELLS];
                let leaf = cut.place(x, y, z);
                if leaf != run.leaf {
                    self.lit::<ERRORS>(light, &run, origin_units, step);
                    let edge = EDGE >> cut.log;
                    // Inside the leaf, where the nearest brick is beyond doubt.
                    run = Run { leaf, edge, at: 0.5 * (start + end), ..Run::new() };
                    run.corner = [x & !(edge - 1), y & !(edge - 1), z & !(edge - 1)];
                }
                run.weight = run.weight.plus(turned);
                let middle = narrow(0.5 * (start + end) - run.at);
                run.moment = run.moment.plus_scaled(turned, middle);
                let length = narrow(end - start);
                let square = middle.mul_add(middle, length * length * (1.0 / 12.0));
                run.second = run.second.plus_scaled(turned, square);
            }
            if !through.any_above(OPAQUE) {
                break;
            }
        }
        if let Some(light) = &field.light {
            self.lit::<ERRORS>(light, &run, origin_units, step);
        }
        self.direct = self.direct.plus(own);
        if hit.is_some() {
            self.plate = self.plate.plus(through);
        } else if let Some(chamber) = field.chamber
            && let Some(end) = self.ends.get_mut(chamber.end(ray.0, direction))
        {
            *end = end.plus(through);
        }
        self.met |= cells > 0;
        self.weight += share;
        self.sights += 1;
        self.cells += cells;
    }

    /// Adds what a run through one leaf scatters into the sight. In-scattered light is quadratic inside a leaf, so its
    /// mean over the run follows from the run's moments.
    #[inline(always)]
    fn lit<const ERRORS: bool>(&mut self, light: &Light<'_, S>, run: &Run<S>, origin: Vector, step: Vector) {
        if run.leaf == usize::MAX {
            return;
        }
        let inside = &light.scattered.leaves[run.leaf];
        // Offset of the run's first cell from the leaf's centre, in cells: coordinates in the brick are those in the grid
        // but for multiples of its edge.
        let mut offset = [0.0_f32; 3];
        for a in 0..3 {
            let units = run.at.mul_add(step[a], origin[a]);
            let in_brick = units - count_up(run.corner[a]) - 0.5 * count_up(run.edge);
            // The nearest of all places that differ by whole bricks.
            let bricks = (in_brick * (1.0 / EDGE as f64)).round();
            offset[a] = narrow(in_brick - bricks * EDGE as f64);
        }
        let seen = run.seen(inside, offset, step);
        self.plate = self.plate.plus(seen[0]);
        self.medium = self.medium.plus(seen[1]);
        let extra = self.extra.len();
        for (c, rows) in self.extra.iter_mut().enumerate() {
            rows[1] = rows[1].plus_product(seen[1], light.scattered.ratio[run.leaf * extra + c]);
        }
        if ERRORS {
            for row in 0..ROWS {
                self.noise[row] = self.noise[row].plus_product(run.weight, inside.noise[row]);
                self.bias[row] = self.bias[row].plus_product(run.weight, inside.bias[row]);
            }
        }
        if self.ends.is_empty() {
            return;
        }
        for (axis, leaves) in light.scattered.sides.iter().enumerate() {
            let inside = &leaves[run.leaf];
            let seen = run.seen(inside, offset, step);
            for row in 0..ROWS {
                let side = 2 * axis + row;
                self.ends[side] = self.ends[side].plus(seen[row]);
                if ERRORS {
                    let [noise, bias] = &mut self.ends_errors;
                    noise[side] = noise[side].plus_product(run.weight, inside.noise[row]);
                    bias[side] = bias[side].plus_product(run.weight, inside.bias[row]);
                }
            }
        }
    }

    /// Of the walls' shares the largest of what [`Sight::errors`] gives of plate and channel 0: `[noise, bias]`.
    pub(super) fn ends_errors(&self, groups: usize) -> [f32; 2] {
        if self.ends.is_empty() {
            return [0.0; 2];
        }
        let scale = 1.0 / self.weight.max(f32::MIN_POSITIVE);
        let square = |row: &S| row.times(*row).sum() / count(groups);
        self.ends_errors.map(|rows| rows.iter().map(square).fold(0.0, f32::max).sqrt() * scale)
    }

    /// Rms over the groups of noise and of the reconstruction's error, of plate and channel 0: `[noise, bias][row]`.
    pub(super) fn errors(&self, groups: usize) -> [[f32; ROWS]; 2] {
        let scale = 1.0 / self.weight.max(f32::MIN_POSITIVE);
        [self.noise, self.bias]
            .map(|rows| rows.map(|row| (row.times(row).sum() / count(groups)).sqrt() * scale))
    }
}

/// Cells of a sight one after the other in the same leaf.
struct Run<S> {
    leaf: usize,
    /// Cells along the leaf's edge, and its lower corner in the brick.
    edge: usize,
    corner: [usize; 3],
    /// The middle of its first cell.
    at: f64,
    /// Weight of what is scattered into the sight, and the sum of weight · distance from there.
    weight: S,
    moment: S,
    /// The sum of weight · the square of that distance.
    second: S,
}

impl<S: Spectrum> Run<S> {
    #[inline(always)]
    fn new() -> Self {
        Self {
            leaf: usize::MAX,
            edge: 1,
            corner: [0; 3],
            at: 0.0,
            weight: S::ZERO,
            moment: S::ZERO,
            second: S::ZERO,
        }
    }

    /// What two kinds of light, scattered inside the leaf, add to the sight.
    #[inline(always)]
    fn seen(&self, inside: &InLeaf<S>, offset: [f32; 3], step: Vector) -> [S; ROWS] {
        let (weight, moment) = (self.weight, self.moment);
        let edge = narrow(count_up(self.edge));
        let mut seen = [inside.share[0][0].times(weight), inside.share[1][0].times(weight)];
        for a in 0..3 {
            let (x, s) = (offset[a], narrow(step[a]));
            // Σ weight · x and Σ weight · (x² − edge²/12) along the run, x moving from the first cell's offset.
            let first = weight.scaled(x).plus_scaled(moment, s);
            let second = weight
                .scaled(x * x - edge * edge / 12.0)
                .plus_scaled(moment, 2.0 * x * s)
                .plus_scaled(self.second, s * s);
            for row in 0..ROWS {
                let share = &inside.share[row];
                seen[row] = seen[row].plus_product(share[1 + a], first).plus_product(share[4 + a], second);
            }
        }
        // Steep slopes must not make light negative.
        [seen[0].not_negative(), seen[1].not_negative()]
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are small")]
#[inline(always)]
fn count_up(n: usize) -> f64 {
    n as f64
}

#[expect(clippy::cast_precision_loss, reason = "counts are small")]
#[inline(always)]
fn count(n: usize) -> f32 {
    n as f32
}
