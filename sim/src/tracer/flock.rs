//! Many scattered paths at once through blocks.
//!
//! Paths go where they like, so that every lane has a ray of its own, stepping from block to block; what ends is scored and
//! replaced by its continuation or by the next path as soon as a few lanes wait (wavefront: S. Laine et al., Megakernels
//! considered harmful, HPG 2013). The next collision is drawn on the way, each block taking the place of the one kept so far
//! with the chance of its share of what has been scattered up to it (weighted reservoir, M. T. Chao, Biometrika 69, 653,
//! 1982), so that no list of visits is kept. The physics is that of [`World::follow`]; positions are f32 in cells.

use super::blocks::Blocks;
use super::lanes::{Floats, Ints, LANES, NO_INTS, ZEROS};
use super::paths::{
    FIRST_DIMENSIONS, GROUP_DIMENSION, MEDIUM, OPAQUE, ORDER_DIMENSIONS, ORDERS_MAX, PLATE,
    ROULETTE_DIMENSION, ROULETTE_WEIGHT, WALLS, World, turned,
};
use super::sobol::{Coordinates, hash};
use super::spectrum::{Spectrum, narrow, split};
use super::vector::{Vector, along};
use super::walk::{NOWHERE, Step, Walk};

/// Lanes that wait before they are served together.
const WAITING: i32 = 4;

/// What names the numbers by which the block is drawn that shines.
const OTHER: i32 = 0x5bd1_e995;

/// First coordinate of the numbers by which collisions are drawn on the way.
const COLLISION_DIMENSION: usize = 500_000;

/// Added to those numbers from block to block: 2³² over the golden ratio.
const GOLDEN: i32 = 0x9E37_79B9_u32.cast_signed();

/// A path at its first scattering, its new direction drawn.
pub(super) struct Begin<S> {
    /// Its coordinates.
    pub(super) at: Coordinates,
    pub(super) origin: Vector,
    pub(super) direction: Vector,
    pub(super) weight: S,
    /// The set of rows to which it adds.
    pub(super) set: usize,
}

/// What a lane holds besides its ray.
#[derive(Clone, Copy)]
struct Path {
    at: Coordinates,
    origin: Vector,
    direction: Vector,
    /// Where the ray enters the box.
    start: f64,
    order: usize,
    /// Mean weight that it began with.
    unit: f32,
    set: usize,
    sees_plate: bool,
}

/// The block kept for the next collision of each lane.
struct Chosen<S> {
    place: Ints,
    /// Where the ray enters it and how far it goes in it.
    start: Floats,
    length: Floats,
    /// What it scatters, all groups together, and the weight on entering; both used for several groups alone.
    part: Floats,
    weight: [S; LANES],
}

/// The block whose emission stands for that of a ray.
struct Shining<S> {
    place: Ints,
    /// What it emits in channel 0, all groups together, and all light that is stopped there.
    part: Floats,
    stopped: [S; LANES],
}

/// The lanes.
pub(super) struct Flock<S> {
    walk: Walk,
    through: [S; LANES],
    /// Of the last block: the weight on entering, what was stopped, and what of it was scattered.
    before: [S; LANES],
    here: [S; LANES],
    again: [S; LANES],
    /// Emission of channel 0 along the ray; of it and of what is scattered the sum over all groups.
    own: [S; LANES],
    emitted: Floats,
    scattered: Floats,
    /// Names the numbers by which blocks are drawn.
    key: Ints,
    chosen: Chosen<S>,
    shining: Shining<S>,
    blocks: Ints,
    paths: [Option<Path>; LANES],
    /// Scatterings and blocks so far.
    pub(super) scatterings: u64,
    pub(super) visited: u64,
}

impl<S: Spectrum> Flock<S> {
    /// Without paths.
    pub(super) fn new() -> Self {
        let none = [S::ZERO; LANES];
        Self {
            walk: Walk::new(),
            through: none,
            before: none,
            here: none,
            again: none,
            own: none,
            emitted: ZEROS,
            scattered: ZEROS,
            key: NO_INTS,
            chosen: Chosen { place: NO_INTS, start: ZEROS, length: ZEROS, part: ZEROS, weight: none },
            shining: Shining { place: NO_INTS, part: ZEROS, stopped: none },
            blocks: NO_INTS,
            paths: [const { None }; LANES],
            scatterings: 0,
            visited: 0,
        }
    }

    /// Follows all paths to their ends; what they collect is added to their sets of `world.rows()` rows.
    #[inline(always)]
    pub(super) fn run(
        &mut self,
        world: &World<'_, S>,
        mut begin: impl FnMut() -> Option<Begin<S>>,
        rows: &mut [S],
    ) {
        let mut more = true;
        loop {
            for l in 0..LANES {
                if more && self.paths[l].is_none() {
                    match begin() {
                        Some(begin) => self.begin(world, l, begin),
                        None => more = false,
                    }
                }
            }
            let flying: i32 = self.paths.iter().map(|path| i32::from(path.is_some())).sum();
            if flying == 0 {
                return;
            }
            let (mut going, enough) = (flying, (flying - WAITING).max(0));
            while going > enough {
                going = self.step(world.blocks);
            }
            for l in 0..LANES {
                if let Some(path) = self.paths[l].take_if(|_| self.walk.has_ended(l)) {
                    self.land(world, l, path, rows);
                }
            }
        }
    }

    #[inline(always)]
    fn begin(&mut self, world: &World<'_, S>, l: usize, begin: Begin<S>) {
        let Begin { at, origin, direction, weight, set } = begin;
        let unit = weight.sum() / groups(world);
        let path = Path { at, origin, direction, start: 0.0, order: 0, unit, set, sees_plate: false };
        self.send(world, l, path, weight);
    }

    /// Sends a path on its way in a lane.
    #[inline(always)]
    fn send(&mut self, world: &World<'_, S>, l: usize, mut path: Path, weight: S) {
        let ray = (path.origin, path.direction);
        let hit = world.plate.and_then(|p| p.hit(ray.0, ray.1));
        path.start = self.walk.send(&world.blocks.bricks, l, ray, hit.unwrap_or(f64::INFINITY));
        path.sees_plate = hit.is_some();
        self.through[l] = weight;
        self.own[l] = S::ZERO;
        self.emitted.0[l] = 0.0;
        self.scattered.0[l] = 0.0;
        self.blocks.0[l] = 0;
        self.key.0[l] = path.at.bits(COLLISION_DIMENSION + path.order).cast_signed();
        self.paths[l] = Some(path);
    }

    /// One step of every lane; how many go on.
    #[inline(always)]
    fn step(&mut self, blocks: &Blocks<S>) -> i32 {
        let step = self.walk.step::<false>(&blocks.bricks);
        for l in 0..LANES {
            self.key.0[l] = self.key.0[l].wrapping_add(GOLDEN);
            self.blocks.0[l] += i32::from(step.place.0[l] != NOWHERE && step.exit.0[l] > step.start.0[l]);
        }
        if S::WIDTH == 1 {
            self.collect_lone(blocks, &step);
            self.walk.settle(&step, |l| self.through[l].get(0) > OPAQUE)
        } else {
            self.collect(blocks, &step);
            self.walk.settle(&step, |_| true)
        }
    }

    /// What the blocks of one step do to rays of one group.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "places are counted from zero")]
    fn collect_lone(&mut self, blocks: &Blocks<S>, step: &Step) {
        let (mut k, mut albedo) = (ZEROS, ZEROS);
        for l in 0..LANES {
            if step.place.0[l] != NOWHERE {
                let [here, scattering] = blocks.core[step.place.0[l] as usize];
                k.0[l] = here.get(0);
                albedo.0[l] = scattering.get(0);
            }
        }
        for l in 0..LANES {
            let length = step.exit.0[l] - step.start.0[l];
            let (passed, stopped) = split(k.0[l] * length);
            let here = self.through[l].get(0) * stopped;
            self.through[l] = self.through[l].scaled(passed);
            let again = here * albedo.0[l];
            let own = here - again;
            self.own[l] = self.own[l].plus(S::splat(own));
            let scattered = self.scattered.0[l] + again;
            self.scattered.0[l] = scattered;
            let taken = drawn(self.key.0[l]) * scattered < again;
            let chosen = &mut self.chosen;
            chosen.place.0[l] = if taken { step.place.0[l] } else { chosen.place.0[l] };
            chosen.start.0[l] = if taken { step.start.0[l] } else { chosen.start.0[l] };
            chosen.length.0[l] = if taken { length } else { chosen.length.0[l] };
            if blocks.channels > 1 {
                let emitted = self.emitted.0[l] + own;
                self.emitted.0[l] = emitted;
                let shines = drawn(self.key.0[l] ^ OTHER) * emitted < own;
                let shining = &mut self.shining;
                shining.place.0[l] = if shines { step.place.0[l] } else { shining.place.0[l] };
                shining.part.0[l] = if shines { own } else { shining.part.0[l] };
                shining.stopped[l] = if shines { S::splat(here) } else { shining.stopped[l] };
            }
        }
    }

    /// The same for several groups, whose numbers lie side by side: lane by lane.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "places are counted from zero")]
    fn collect(&mut self, blocks: &Blocks<S>, step: &Step) {
        for l in 0..LANES {
            let (place, start) = (step.place.0[l], step.start.0[l]);
            let length = step.exit.0[l] - start;
            if place == NOWHERE || length <= 0.0 {
                continue;
            }
            let [k, albedo] = &blocks.core[place as usize];
            let (passed, stopped) = k.split(length);
            let weight = self.through[l];
            self.here[l] = weight.times(stopped);
            self.again[l] = self.here[l].times(*albedo);
            self.own[l] = self.own[l].plus(self.here[l].minus(self.again[l]));
            self.before[l] = weight;
            self.through[l] = weight.times(passed);
        }
        for l in 0..LANES {
            let (place, start) = (step.place.0[l], step.start.0[l]);
            let length = step.exit.0[l] - start;
            if place == NOWHERE || length <= 0.0 {
                continue;
            }
            let part = self.again[l].sum();
            let scattered = self.scattered.0[l] + part;
            self.scattered.0[l] = scattered;
            if drawn(self.key.0[l]) * scattered < part {
                let chosen = &mut self.chosen;
                (chosen.place.0[l], chosen.start.0[l], chosen.length.0[l]) = (place, start, length);
                (chosen.part.0[l], chosen.weight[l]) = (part, self.before[l]);
            }
            if blocks.channels > 1 {
                let part = (self.here[l].sum() - part).max(0.0);
                let emitted = self.emitted.0[l] + part;
                self.emitted.0[l] = emitted;
                if drawn(self.key.0[l] ^ OTHER) * emitted < part {
                    let shining = &mut self.shining;
                    (shining.place.0[l], shining.part.0[l], shining.stopped[l]) = (place, part, self.here[l]);
                }
            }
            if !self.through[l].any_above(OPAQUE) {
                self.walk.stop(l);
            }
        }
    }

    /// Scores a ray that has come to its end and sends the path on, unless it ends too.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "places are counted from zero")]
    fn land(&mut self, world: &World<'_, S>, l: usize, mut path: Path, rows: &mut [S]) {
        let width = world.rows();
        let rows = &mut rows[path.set * width..(path.set + 1) * width];
        let blocks = world.blocks;
        self.scatterings += 1;
        self.visited += u64::from(self.blocks.0[l].unsigned_abs());
        let mut add = |row: usize, value: S| rows[row] = rows[row].plus(value);
        add(MEDIUM, self.own[l]);
        if path.sees_plate {
            add(PLATE, self.through[l]);
        } else {
            add(WALLS, self.through[l]);
            if let Some(chamber) = world.chamber {
                add(world.first_end() + chamber.end(path.origin, path.direction), self.through[l]);
            }
        }
        let emitted = self.emitted.0[l];
        if blocks.channels > 1 && emitted > 0.0 {
            let extra = blocks.channels - 1;
            let shining = &self.shining;
            let place = shining.place.0[l] as usize;
            let here = shining.stopped[l].scaled(emitted / shining.part.0[l]);
            let sources = &blocks.source[place * extra..(place + 1) * extra];
            for (row, source) in rows[MEDIUM + 1..].iter_mut().zip(sources) {
                *row = row.plus_product(here, *source);
            }
        }
        let (scattered, order) = (self.scattered.0[l], path.order);
        if !(scattered > 0.0 && scattered.is_finite()) || order + 1 >= ORDERS_MAX {
            return;
        }
        let mut scale = 1.0;
        let (mean, least) = (scattered / groups(world), ROULETTE_WEIGHT * path.unit);
        if mean < least {
            if narrow(path.at.get(ROULETTE_DIMENSION + order)) * least >= mean {
                return;
            }
            scale = least / mean;
        }
        let dimension = FIRST_DIMENSIONS + ORDER_DIMENSIONS * order;
        let chosen = &self.chosen;
        let [k, albedo] = blocks.core[chosen.place.0[l] as usize];
        // The place inside the block by the mean extinction, corrected per group.
        let (mean_k, length) = (f64::from(k.sum() / groups(world)), f64::from(chosen.length.0[l]));
        let part = deep(mean_k * length, path.at.get(dimension + 1));
        let distance = part * length;
        let choice = path.at.get(GROUP_DIMENSION + order);
        let (cosine, share) = world.scatter.sample(path.at.get(dimension + 2), choice);
        let weight = if S::WIDTH == 1 {
            // One group: the densities cancel, and what is captured goes on.
            S::splat(scattered * scale)
        } else {
            let density =
                mean_k * (-mean_k * distance).exp() / -(-mean_k * length).exp_m1().min(-f64::MIN_POSITIVE);
            let chance = f64::from(chosen.part.0[l] / scattered);
            let (through, _) = k.split(narrow(distance));
            let weight = chosen.weight[l].times(through).times(k).times(albedo).times(share);
            weight.scaled(narrow(f64::from(scale) / (chance * density)))
        };
        path.origin =
            along(path.origin, path.start + f64::from(chosen.start.0[l]) + distance, path.direction);
        path.direction = turned(path.direction, cosine, path.at.get(dimension + 3));
        path.order += 1;
        self.send(world, l, path, weight);
    }
}

fn groups<S>(world: &World<'_, S>) -> f32 {
    world.blocks.groups as f32
}

/// The part of a block of optical depth `depth` that light crosses before it is stopped there, for `u` in (0, 1).
#[inline(always)]
fn deep(depth: f64, u: f64) -> f64 {
    if depth < 1e-4 {
        // Off by less than 1e-4/8 of the block.
        return u;
    }
    let open = -(-depth).exp_m1();
    (-(-u * open).ln_1p() / depth).min(1.0)
}

/// A number in (0, 1) that a key names.
#[inline(always)]
#[expect(clippy::cast_precision_loss, reason = "23 bits")]
fn drawn(key: i32) -> f32 {
    ((hash(key.cast_unsigned()) >> 9).cast_signed() as f32 + 0.5) * (1.0 / 8_388_608.0)
}

#[cfg(test)]
mod tests;
