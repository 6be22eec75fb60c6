//! Sixteen scattered paths at once through blocks of one spectral group.
//!
//! Paths go where they like, so that every lane has a ray of its own, stepping from block to block; what ends is scored and
//! replaced by its continuation or by the next path as soon as a few lanes wait (wavefront: S. Laine et al., Megakernels
//! considered harmful, HPG 2013). The next collision is drawn on the way, each block taking the place of the one kept so far
//! with the chance of its share of what has been scattered up to it (weighted reservoir, M. T. Chao, Biometrika 69, 653,
//! 1982), so that no list of visits is kept. The physics is that of [`World::follow`]; positions are f32 in cells.

use super::blocks::Blocks;
use super::bricks::{EDGE, EDGE_LOG, NONE};
use super::lanes::{Floats, Ints, LANES, NEVER, NO_INTS, STILL, ZEROS, larger, smaller, whole};
use super::paths::{
    FIRST_DIMENSIONS, MEDIUM, OPAQUE, ORDER_DIMENSIONS, ORDERS_MAX, PLATE, ROULETTE_DIMENSION,
    ROULETTE_WEIGHT, WALLS, World, turned,
};
use super::sobol::{Coordinates, hash};
use super::spectrum::{One, Spectrum, narrow, split};
use super::vector::{Vector, along};

/// Lanes that wait before they are served together.
const WAITING: i32 = 4;

/// First coordinate of the numbers by which collisions are drawn on the way.
const COLLISION_DIMENSION: usize = 500_000;

/// Added to those numbers from block to block: 2³² over the golden ratio.
const GOLDEN: i32 = 0x9E37_79B9_u32 as i32;

/// A path at its first scattering, its new direction drawn.
pub(super) struct Begin {
    /// Its coordinates.
    pub(super) at: Coordinates,
    pub(super) origin: Vector,
    pub(super) direction: Vector,
    pub(super) weight: f32,
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
    /// Weight that it began with.
    unit: f32,
    set: usize,
    sees_plate: bool,
}

/// The lanes.
pub(super) struct Flock {
    /// Entry into the box in cells from its lower corner, and cells per metre.
    entry: [Floats; 3],
    slope: [Floats; 3],
    /// Metres per cell with the sign of the direction, and what is added where it stands still.
    inverse: [Floats; 3],
    still: [Floats; 3],
    /// 1 where the ray goes to higher cells.
    upward: [Ints; 3],
    cell: [Ints; 3],
    /// Where the ray is and where it ends, in metres from its entry; steps that it may still take.
    at: Floats,
    end: Floats,
    left: Ints,
    through: Floats,
    /// Emission of channel 0 and what is scattered along the ray.
    own: Floats,
    scattered: Floats,
    /// Names the numbers by which blocks are drawn.
    key: Ints,
    /// Extinction, start and length of the block kept for the next collision.
    chosen: [Floats; 3],
    /// Place of the block whose emission stands for the ray's, and all light stopped there over what it emits.
    shining: Ints,
    stopped: Floats,
    blocks: Ints,
    paths: [Option<Path>; LANES],
    /// Scatterings and blocks so far.
    pub(super) scatterings: u64,
    pub(super) visited: u64,
}

impl Flock {
    /// Without paths.
    pub(super) fn new() -> Self {
        Self {
            entry: [ZEROS; 3],
            slope: [ZEROS; 3],
            inverse: [ZEROS; 3],
            still: [ZEROS; 3],
            upward: [NO_INTS; 3],
            cell: [NO_INTS; 3],
            at: ZEROS,
            end: ZEROS,
            left: NO_INTS,
            through: ZEROS,
            own: ZEROS,
            scattered: ZEROS,
            key: NO_INTS,
            chosen: [ZEROS; 3],
            shining: NO_INTS,
            stopped: ZEROS,
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
        world: &World<'_, One>,
        mut begin: impl FnMut() -> Option<Begin>,
        rows: &mut [f32],
    ) {
        let most = 2 * world.blocks.bricks.cells.iter().sum::<usize>() + 8;
        let most = i32::try_from(most).unwrap_or(i32::MAX);
        let mut more = true;
        loop {
            let mut flying = 0;
            for l in 0..LANES {
                if self.paths[l].is_none() && more {
                    if let Some(begin) = begin() {
                        let Begin { at, origin, direction, weight, set } = begin;
                        let path = Path {
                            at,
                            origin,
                            direction,
                            start: 0.0,
                            order: 0,
                            unit: weight,
                            set,
                            sees_plate: false,
                        };
                        self.send(world, l, path, weight, most);
                    } else {
                        more = false;
                    }
                }
                flying += i32::from(self.paths[l].is_some());
            }
            if flying == 0 {
                return;
            }
            let enough = (flying - WAITING).max(0);
            while self.step(world.blocks) > enough {}
            for l in 0..LANES {
                if self.at.0[l] >= self.end.0[l] {
                    if let Some(path) = self.paths[l].take() {
                        self.land(world, l, path, rows, most);
                    }
                }
            }
        }
    }

    /// Sends a path on its way in a lane.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "clamped to the box, whose cells fit into i32; numbers are mixed"
    )]
    fn send(&mut self, world: &World<'_, One>, l: usize, mut path: Path, weight: f32, most: i32) {
        let bricks = &world.blocks.bricks;
        let (origin, direction) = (path.origin, path.direction);
        let hit = world.plate.and_then(|p| p.hit(origin, direction));
        let (start, end) = bricks.clip(origin, direction, hit.unwrap_or(f64::INFINITY)).unwrap_or((0.0, 0.0));
        let entry = bricks.units(along(origin, start, direction));
        for a in 0..3 {
            let slope = direction[a] / bricks.size[a];
            let moves = slope.abs() > STILL;
            self.entry[a].0[l] = narrow(entry[a]);
            self.slope[a].0[l] = narrow(slope);
            self.inverse[a].0[l] = if moves { narrow(1.0 / slope) } else { 0.0 };
            self.still[a].0[l] = if moves { 0.0 } else { NEVER };
            self.upward[a].0[l] = i32::from(slope > 0.0);
            self.cell[a].0[l] = (entry[a].max(0.0) as i32).min(bricks.cells[a] as i32 - 1);
        }
        self.at.0[l] = 0.0;
        self.end.0[l] = narrow(end - start);
        self.left.0[l] = most;
        self.through.0[l] = weight;
        self.own.0[l] = 0.0;
        self.scattered.0[l] = 0.0;
        self.key.0[l] = path.at.bits(COLLISION_DIMENSION + path.order) as i32;
        path.start = start;
        path.sees_plate = hit.is_some();
        self.paths[l] = Some(path);
    }

    /// One step of every lane; how many go on.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "cells stay inside the box, whose bricks, cells and places fit into 31 bits"
    )]
    fn step(&mut self, blocks: &Blocks<One>) -> i32 {
        let bricks = &blocks.bricks;
        let [_, ny, nz] = bricks.count.map(|n| n as i32);
        let last = bricks.cells.map(|n| n as i32 - 1);
        let low = EDGE as i32 - 1;
        let [cx, cy, cz] = self.cell;
        let mut brick = NO_INTS;
        for l in 0..LANES {
            let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]];
            brick.0[l] = ((x >> EDGE_LOG) * ny + (y >> EDGE_LOG)) * nz + (z >> EDGE_LOG);
        }
        let (mut first, mut down) = (NO_INTS, NO_INTS);
        for l in 0..LANES {
            let cut = bricks.list[brick.0[l] as usize];
            first.0[l] = cut.first as i32;
            down.0[l] = EDGE_LOG as i32 - cut.log as i32;
        }
        let (mut place, mut size) = (NO_INTS, NO_INTS);
        for l in 0..LANES {
            let shift = down.0[l];
            let log = EDGE_LOG as i32 - shift;
            let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]].map(|c| (c & low) >> shift);
            place.0[l] = first.0[l] + (((x << log) + y) << log) + z;
            size.0[l] = 1 << shift;
        }
        let (mut k, mut albedo) = (ZEROS, ZEROS);
        for l in 0..LANES {
            // An empty brick is cut into one block.
            if first.0[l] != NONE as i32 {
                let [here, scattering] = blocks.core[place.0[l] as usize];
                k.0[l] = here.get(0);
                albedo.0[l] = scattering.get(0);
            }
        }
        let mut next = [ZEROS; 3];
        let mut base = [NO_INTS; 3];
        for a in 0..3 {
            for l in 0..LANES {
                let from = self.cell[a].0[l] & -size.0[l];
                base[a].0[l] = from;
                let face = from + if self.upward[a].0[l] == 1 { size.0[l] } else { 0 };
                next[a].0[l] =
                    (face as f32 - self.entry[a].0[l]).mul_add(self.inverse[a].0[l], self.still[a].0[l]);
            }
        }
        let mut leave = ZEROS;
        let mut exit = ZEROS;
        for l in 0..LANES {
            let least = smaller(smaller(next[0].0[l], next[1].0[l]), next[2].0[l]);
            leave.0[l] = least;
            exit.0[l] = larger(smaller(least, self.end.0[l]), self.at.0[l]);
        }
        for l in 0..LANES {
            let length = exit.0[l] - self.at.0[l];
            let (passed, stopped) = split(k.0[l] * length);
            let here = self.through.0[l] * stopped;
            self.through.0[l] *= passed;
            let again = here * albedo.0[l];
            let own = here - again;
            self.own.0[l] += own;
            let scattered = self.scattered.0[l] + again;
            self.scattered.0[l] = scattered;
            let key = self.key.0[l].wrapping_add(GOLDEN);
            self.key.0[l] = key;
            let u = unit(mixed(key as u32));
            let taken = u * scattered < again;
            self.chosen[0].0[l] = if taken { k.0[l] } else { self.chosen[0].0[l] };
            self.chosen[1].0[l] = if taken { self.at.0[l] } else { self.chosen[1].0[l] };
            self.chosen[2].0[l] = if taken { length } else { self.chosen[2].0[l] };
            self.blocks.0[l] += i32::from(first.0[l] != NONE as i32 && length > 0.0);
            if blocks.channels > 1 {
                let v = unit(mixed(key as u32 ^ 0x5bd1_e995));
                let shines = v * self.own.0[l] < own;
                self.shining.0[l] = if shines { place.0[l] } else { self.shining.0[l] };
                self.stopped.0[l] = if shines { here / own } else { self.stopped.0[l] };
            }
        }
        let mut inside = Ints([1; LANES]);
        for a in 0..3 {
            for l in 0..LANES {
                let (from, wide) = (base[a].0[l], size.0[l]);
                let place = whole(exit.0[l].mul_add(self.slope[a].0[l], self.entry[a].0[l]));
                let within = place.max(from).min(from + wide - 1);
                let beyond = if self.upward[a].0[l] == 1 { from + wide } else { from - 1 };
                let cell = if next[a].0[l] <= leave.0[l] { beyond } else { within };
                let kept = cell.max(0).min(last[a]);
                inside.0[l] &= i32::from(cell == kept);
                self.cell[a].0[l] = kept;
            }
        }
        let mut going = 0;
        for l in 0..LANES {
            self.at.0[l] = exit.0[l];
            self.left.0[l] -= 1;
            let on = inside.0[l] == 1
                && exit.0[l] < self.end.0[l]
                && self.through.0[l] > OPAQUE
                && self.left.0[l] > 0;
            self.end.0[l] = if on { self.end.0[l] } else { exit.0[l] };
            going += i32::from(on);
        }
        going
    }

    /// Scores a ray that has come to its end and sends the path on, unless it ends too.
    #[inline(always)]
    fn land(&mut self, world: &World<'_, One>, l: usize, mut path: Path, rows: &mut [f32], most: i32) {
        let width = world.rows();
        let rows = &mut rows[path.set * width..(path.set + 1) * width];
        self.scatterings += 1;
        self.visited += u64::from(self.blocks.0[l].unsigned_abs());
        self.blocks.0[l] = 0;
        let weight = self.through.0[l];
        rows[MEDIUM] += self.own.0[l];
        if path.sees_plate {
            rows[PLATE] += weight;
        } else {
            rows[WALLS] += weight;
            if let Some(chamber) = world.chamber {
                rows[world.first_end() + chamber.end(path.origin, path.direction)] += weight;
            }
        }
        let own = self.own.0[l];
        if world.blocks.channels > 1 && own > 0.0 {
            let extra = world.blocks.channels - 1;
            let place = self.shining.0[l].unsigned_abs() as usize;
            let sources = &world.blocks.source[place * extra..(place + 1) * extra];
            let here = own * self.stopped.0[l];
            for (row, source) in rows[MEDIUM + 1..].iter_mut().zip(sources) {
                *row = source.get(0).mul_add(here, *row);
            }
        }
        let scattered = self.scattered.0[l];
        let order = path.order;
        if !(scattered > 0.0 && scattered.is_finite()) || order + 1 >= ORDERS_MAX {
            return;
        }
        let mut weight = scattered;
        let least = ROULETTE_WEIGHT * path.unit;
        if scattered < least {
            if narrow(path.at.get(ROULETTE_DIMENSION + order)) * least >= scattered {
                return;
            }
            weight = least;
        }
        let dimension = FIRST_DIMENSIONS + ORDER_DIMENSIONS * order;
        let [k, start, length] = [0, 1, 2].map(|i: usize| f64::from(self.chosen[i].0[l]));
        let depth = deep(k * length, path.at.get(dimension + 1));
        let (cosine, _) = world.scatter.sample(path.at.get(dimension + 2), 0.0);
        path.origin = along(path.origin, path.start + start + depth * length, path.direction);
        path.direction = turned(path.direction, cosine, path.at.get(dimension + 3));
        path.order += 1;
        self.send(world, l, path, weight, most);
    }
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

/// A number in (0, 1) from 23 of its bits.
#[inline(always)]
#[expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, reason = "23 bits")]
fn unit(bits: u32) -> f32 {
    ((bits >> 9) as i32 as f32 + 0.5) * (1.0 / 8_388_608.0)
}

#[inline(always)]
fn mixed(bits: u32) -> u32 {
    hash(bits)
}

#[cfg(test)]
mod tests {
    use super::super::chamber::{Chamber, ENDS};
    use super::super::cuts::Limits;
    use super::super::fine::Fine;
    use super::super::medium::{EMPTY, GridMedium};
    use super::super::paths::Memory;
    use super::super::plate::{Plate, PlateShape};
    use super::super::scatter::Scatter;
    use super::super::sobol::Sequence;
    use super::*;
    use crate::light::phase::PhaseFunction;

    const CELLS: [usize; 3] = [19, 13, 21];

    /// Lumps of very different density between empty bricks; two channels.
    fn lumps(albedo: f64) -> GridMedium {
        let mut medium = GridMedium {
            lower_m: [-0.1, 0.2, -0.3],
            upper_m: [0.4, 0.5, 0.3],
            cells: CELLS,
            groups: 1,
            channels: 2,
            index: vec![EMPTY; CELLS.iter().product()],
            k_ext: Vec::new(),
            k_sca: Vec::new(),
            emission: Vec::new(),
            phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.6 }],
        };
        for (i, place) in medium.index.iter_mut().enumerate() {
            let number = hash(u32::try_from(i).unwrap());
            let x = i / (CELLS[1] * CELLS[2]);
            if (8..16).contains(&x) || number % 3 == 0 {
                continue;
            }
            let k = [0.03, 3.0, 20.0, 200.0][number as usize / 3 % 4];
            *place = u32::try_from(medium.k_ext.len()).unwrap();
            medium.k_ext.push(k);
            medium.k_sca.push(k * albedo);
            let own = k * (1.0 - albedo);
            medium.emission.extend([own, own * (1.0 + f64::from(number % 7))]);
        }
        medium
    }

    /// Rows of every path (plate, walls, two channels, ends) one by one and together.
    fn both(medium: &GridMedium, limits: Limits, paths: u32) -> [Vec<f32>; 2] {
        let fine = Fine::<One>::new(medium, 1);
        let blocks = Blocks::new(&fine, limits);
        let scatter = Scatter::new(&medium.phase);
        let shape = PlateShape::Rectangle {
            centre_m: [0.15, 0.7, 0.0],
            facing: [0.0, -1.0, 0.0],
            width_m: 0.5,
            height_m: 0.4,
        };
        let plate = Plate::new(&shape).unwrap();
        let chamber = Chamber::new([-0.5, -0.5, -0.5], [0.8, 0.9, 0.5]).unwrap();
        let world =
            World { blocks: &blocks, scatter: &scatter, plate: Some(&plate), chamber: Some(&chamber) };
        let begin = |i: u32| {
            let at = Sequence::new(5).from(i).next();
            let share = |d: usize| at.get(1000 + d);
            let size = [0.5, 0.3, 0.6];
            let origin = [0, 1, 2].map(|a: usize| medium.lower_m[a] + size[a] * share(a));
            // Every fourth one along an axis.
            let direction = if i % 4 == 0 {
                [0, 1, 2].map(|a: usize| if a == i as usize / 4 % 3 { 1.0 } else { 0.0 })
            } else {
                turned([0.0, 1.0, 0.0], 2.0 * share(3) - 1.0, share(4))
            };
            (at, origin, direction)
        };
        let width = world.rows();
        assert_eq!(width, 4 + ENDS);
        let mut alone = vec![0.0_f32; paths as usize * width];
        let mut memory = Memory::new();
        for (i, rows) in (0..paths).zip(alone.chunks_exact_mut(width)) {
            let (at, origin, direction) = begin(i);
            let mut sums = vec![One::ZERO; width];
            world.follow(&at, origin, direction, One::splat(1.0), Some(1.0), &mut sums, &mut memory);
            rows.iter_mut().zip(sums).for_each(|(row, sum)| *row = sum.get(0));
        }
        let mut together = vec![0.0_f32; paths as usize * width];
        let mut flock = Flock::new();
        let mut next = 0..paths;
        let more = || {
            next.next().map(|i| {
                let (at, origin, direction) = begin(i);
                Begin { at, origin, direction, weight: 1.0, set: i as usize }
            })
        };
        flock.run(&world, more, &mut together);
        assert!(flock.paths.iter().all(Option::is_none));
        let blocks = flock.visited as f64 / memory.blocks as f64;
        assert!((0.9..1.1).contains(&blocks), "{blocks}");
        [alone, together]
    }

    const EXACT: Limits = Limits { depth: 0.0, spread: 0.0 };

    #[test]
    fn straight_rays_are_those_that_are_followed_alone() {
        for limits in [EXACT, Limits { depth: 0.5, spread: 0.5 }] {
            let [alone, together] = both(&lumps(0.0), limits, 3000);
            for (i, (a, b)) in alone.iter().zip(&together).enumerate() {
                // The second channel is that of one block.
                if i % (4 + ENDS) != 3 {
                    // Through a depth of up to 5 by a length that errs by 1e-5 of a cell.
                    assert!((a - b).abs() < 2e-4, "{i}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn paths_have_the_means_of_those_that_are_followed_alone() {
        let n = 40_000;
        for albedo in [0.4, 0.97] {
            let [alone, together] = both(&lumps(albedo), EXACT, n);
            for row in 0..4 + ENDS {
                let moments = |rows: &[f32]| {
                    let (mut sum, mut square) = (0.0_f64, 0.0_f64);
                    for value in rows.iter().skip(row).step_by(4 + ENDS) {
                        sum += f64::from(*value);
                        square += f64::from(*value).powi(2);
                    }
                    let mean = sum / f64::from(n);
                    (mean, (square / f64::from(n) - mean * mean) / f64::from(n))
                };
                let ((a, va), (b, vb)) = (moments(&alone), moments(&together));
                assert!((a - b).abs() <= 4.5 * (va + vb).sqrt() + 1e-6, "{albedo} row {row}: {a} {b}");
                assert!(row >= 4 || a > 0.01, "{albedo} row {row} is never met: {a}");
            }
            // What is not absorbed gets out: the mean weight is kept.
            let all: f64 = together.chunks_exact(4 + ENDS).map(|r| f64::from(r[0] + r[1] + r[2])).sum();
            assert!((all / f64::from(n) - 1.0).abs() < 0.02, "{albedo}: {all}");
        }
    }

    #[test]
    fn numbers_lie_inside_and_depths_stay_in_the_block() {
        assert!(unit(0) > 0.0 && unit(u32::MAX) < 1.0);
        for depth in [0.0, 1e-300, 1e-5, 9.9e-5, 1.1e-4, 1.0, 50.0, 800.0] {
            for u in [1e-10, 0.5, 1.0 - 1e-10] {
                let part = deep(depth, u);
                assert!((0.0..=1.0).contains(&part), "{depth} {u}: {part}");
                assert!(depth > 1e-3 || (part - u).abs() < 1e-4);
            }
        }
    }
}
