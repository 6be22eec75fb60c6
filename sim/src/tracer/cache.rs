//! In-scattered radiance towards the camera, estimated once per leaf of the medium and shared by all pixels.
//!
//! A camera sees every point from one direction only, so what is scattered into its sights is a scalar field per group
//! (backward form of the source function of RADMC-3D and SHDOM). The radiance from walls is estimated too, and plate,
//! walls and medium are divided by their sum, so that a uniform enclosure stays uniform whatever the noise.

use super::bricks::{Bricks, EDGE};
use super::camera::Sights;
use super::chamber::{ENDS, SIDES};
use super::fine::{CELLS, Fine, is_occupied};
use super::lens::disc;
use super::paths::{FIRST_DIMENSIONS, MEDIUM, Memory, PLATE, WALLS, World};
use super::sobol::{self, Coordinates, Sequence};
use super::spectrum::{Spectrum, narrow, vectorised};
use super::vector::{Vector, along};
use rayon::prelude::*;

/// Leaves of one parallel task: each leaf holds up to hundreds of paths.
const TASK_LEAVES: usize = 64;

/// Optical depth of a cell below which places in it are taken as uniform; bends the mean by less.
const THIN: f64 = 1e-6;

/// First of the two coordinates of a place in the aperture.
const APERTURE_DIMENSION: usize = 400_000;

const _: () = assert!(FIRST_DIMENSIONS == 7);

/// The leaves of a medium.
#[derive(Clone)]
pub(super) struct Leaves {
    pub(super) bricks: Bricks,
    /// Number in `bricks` of each occupied brick.
    pub(super) occupied: Vec<usize>,
    /// How much of the samples each leaf deserves, `[leaf]`; zero for leaves that nobody sees.
    pub(super) demand: Vec<f32>,
}

/// Where paths begin.
pub(super) struct Origin<'a, S> {
    pub(super) fine: &'a Fine<S>,
    pub(super) leaves: &'a Leaves,
    pub(super) sights: &'a Sights,
    /// Names the random numbers.
    pub(super) seed: u64,
}

/// Sums over the paths of every leaf: for each half of them plate, walls and channel 0; together the other channels.
pub(super) struct Cache<S> {
    /// `[leaf][half]`.
    pub(super) halves: Vec<[[S; 3]; 2]>,
    /// `[leaf · (channels − 1) + channel − 1]`.
    pub(super) others: Vec<S>,
    /// The walls' sum by walls, `[leaf][half]`; empty unless walls are told apart.
    pub(super) sides: Vec<[[S; SIDES]; 2]>,
    /// Paths from each leaf.
    pub(super) paths: Vec<u32>,
    /// Paths, scatterings and blocks of all.
    pub(super) samples: u64,
    pub(super) scatterings: u64,
    pub(super) blocks: u64,
    batches: u32,
}

impl<S: Spectrum> Cache<S> {
    /// A cache without paths.
    pub(super) fn new(leaves: usize, channels: usize, apart: bool) -> Self {
        Self {
            halves: vec![[[S::ZERO; 3]; 2]; leaves],
            others: vec![S::ZERO; leaves * (channels - 1)],
            sides: vec![[[S::ZERO; SIDES]; 2]; if apart { leaves } else { 0 }],
            paths: vec![0; leaves],
            samples: 0,
            scatterings: 0,
            blocks: 0,
            batches: 0,
        }
    }

    /// Adds about `samples` paths, shared out by the leaves' demands. Neighbouring leaves take neighbouring points of
    /// one scrambled sequence per half, so that what one misses the next one has.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "sample counts are below 2^31"
    )]
    pub(super) fn add(
        &mut self,
        from: &Origin<'_, S>,
        world: &World<'_, S>,
        samples: f64,
        progress: &(dyn Fn(f64) + Sync),
    ) {
        let Origin { fine, leaves, sights, seed } = *from;
        let total: f64 = leaves.demand.iter().map(|&d| f64::from(d)).sum();
        if total <= 0.0 {
            return;
        }
        let share = 0.5 * samples / total;
        let mut running = 0.0;
        let mut starts: Vec<u32> = Vec::with_capacity(leaves.demand.len() + 1);
        starts.push(0);
        for &demand in &leaves.demand {
            running += share * f64::from(demand);
            starts.push(running.round().min(f64::from(u32::MAX)) as u32);
        }
        let names = [0, 1].map(|half| Sequence::new(sobol::sequence(seed, self.batches, half)));
        self.batches += 1;
        let extra = fine.channels - 1;
        let count = leaves.demand.len();
        let owner = owners(leaves);
        let done = std::sync::atomic::AtomicUsize::new(0);
        // Zero-sized chunks are not allowed, and without further channels there is nothing to chunk.
        let mut others: Vec<&mut [S]> = if extra > 0 {
            self.others.chunks_mut(TASK_LEAVES * extra).collect()
        } else {
            (0..count.div_ceil(TASK_LEAVES)).map(|_| Default::default()).collect()
        };
        let mut sides: Vec<&mut [[[S; SIDES]; 2]]> = if self.sides.is_empty() {
            (0..count.div_ceil(TASK_LEAVES)).map(|_| Default::default()).collect()
        } else {
            self.sides.chunks_mut(TASK_LEAVES).collect()
        };
        let counted: Vec<[u64; 2]> = self
            .halves
            .par_chunks_mut(TASK_LEAVES)
            .zip(others.par_iter_mut().zip(&mut sides))
            .enumerate()
            .map(|(task, (halves, (others, sides)))| {
                let mut memory = Memory::new();
                let mut rows = vec![S::ZERO; world.rows()];
                vectorised(
                    #[inline(always)]
                    || {
                        for (i, halves) in halves.iter_mut().enumerate() {
                            let leaf = task * TASK_LEAVES + i;
                            let (from, to) = (starts[leaf], starts[leaf + 1]);
                            if from == to {
                                continue;
                            }
                            let cells = members(fine, leaves, owner[leaf], leaf);
                            for (h, (half, name)) in halves.iter_mut().zip(&names).enumerate() {
                                rows[..MEDIUM + 1].iter_mut().for_each(|row| *row = S::ZERO);
                                let mut run = name.from(from);
                                for _ in from..to {
                                    start(fine, sights, world, &cells, &run.next(), &mut rows, &mut memory);
                                }
                                for (sum, row) in half.iter_mut().zip([PLATE, WALLS, MEDIUM]) {
                                    *sum = sum.plus(rows[row]);
                                }
                                if let Some(sides) = sides.get_mut(i) {
                                    // Paths begin inside the chamber: nothing ends outside but by rounding.
                                    let ends = &mut rows[world.first_end()..][..ENDS];
                                    for (sum, row) in sides[h].iter_mut().zip(&*ends) {
                                        *sum = sum.plus(*row);
                                    }
                                    ends.fill(S::ZERO);
                                }
                            }
                            for c in 0..extra {
                                let to = &mut others[i * extra + c];
                                *to = to.plus(rows[MEDIUM + 1 + c]);
                                rows[MEDIUM + 1 + c] = S::ZERO;
                            }
                        }
                    },
                );
                let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
                progress((n * TASK_LEAVES) as f64 / count as f64);
                [memory.scatterings, memory.blocks]
            })
            .collect();
        for [scatterings, blocks] in counted {
            self.scatterings += scatterings;
            self.blocks += blocks;
        }
        for (paths, pair) in self.paths.iter_mut().zip(starts.windows(2)) {
            *paths += 2 * (pair[1] - pair[0]);
        }
        self.samples += 2 * u64::from(starts[count]);
    }
}

/// The occupied brick (its place in the list of occupied ones) of each leaf.
pub(super) fn owners(leaves: &Leaves) -> Vec<u32> {
    let mut owner = Vec::with_capacity(leaves.demand.len());
    for (i, &b) in leaves.occupied.iter().enumerate() {
        owner.resize(owner.len() + leaves.bricks.list[b].blocks(), u32::try_from(i).unwrap_or(u32::MAX));
    }
    owner
}

/// A leaf's occupied cells with the running sums of what they scatter.
struct Members {
    cells: Vec<(usize, [f64; 3], f32)>,
}

fn members<S: Spectrum>(fine: &Fine<S>, leaves: &Leaves, owner: u32, leaf: usize) -> Members {
    let b = leaves.occupied[owner as usize];
    let (brick, base) = (leaves.bricks.list[b], leaves.bricks.at(b).map(|c| c * EDGE));
    let first = owner as usize * CELLS;
    let block = leaf - brick.first as usize;
    let mask = (1 << brick.log) - 1;
    let edge = EDGE >> brick.log;
    let low = [block >> (2 * brick.log), block >> brick.log & mask, block & mask].map(|i| i * edge);
    let mut cells = Vec::with_capacity(edge * edge * edge);
    let mut sum = 0.0;
    for x in low[0]..low[0] + edge {
        for y in low[1]..low[1] + edge {
            for z in low[2]..low[2] + edge {
                let place = first + (x * EDGE + y) * EDGE + z;
                if is_occupied(fine.slot[place]) {
                    let [k, albedo] = fine.core[place];
                    let scattering = k.times(albedo).sum();
                    // A cell that does not scatter still gets a value, though nothing will be multiplied with it.
                    sum += scattering.clamp(f32::MIN_POSITIVE, 1e30);
                    cells.push((place, [x + base[0], y + base[1], z + base[2]].map(|c| c as f64), sum));
                }
            }
        }
    }
    Members { cells }
}

/// One path from a leaf.
#[inline(always)]
fn start<S: Spectrum>(
    fine: &Fine<S>,
    sights: &Sights,
    world: &World<'_, S>,
    members: &Members,
    at: &Coordinates,
    rows: &mut [S],
    memory: &mut Memory<S>,
) {
    let cells = &members.cells;
    let Some(last) = cells.last() else { return };
    let wanted = narrow(at.get(2)) * last.2;
    let (cell, corner, _) = cells[cells.partition_point(|c| c.2 <= wanted).min(cells.len() - 1)];
    let place = fine.bricks.point([corner[0] + at.get(3), corner[1] + at.get(4), corner[2] + at.get(5)]);
    let (direction, distance) = if sights.has_lens() {
        // The mean over the aperture: what sights through one place differ by is left to the straight part.
        sights.towards_through(place, disc(at.get(APERTURE_DIMENSION), at.get(APERTURE_DIMENSION + 1)))
    } else {
        sights.towards(place)
    };
    if distance > 0.0 {
        let (place, weight) = seen_place(fine, cell, corner, place, direction);
        world.scattered(at, place, direction, weight, rows, memory);
    }
}

/// Moves a uniform place in a cell along its sight to where the camera sees the cell scatter: exponentially towards the
/// near side, with the groups' weights against the mean. This makes the mean over samples the very mean that the
/// gather needs, however the source function falls off inside an opaque cell.
#[inline(always)]
fn seen_place<S: Spectrum>(
    fine: &Fine<S>,
    cell: usize,
    corner: Vector,
    start: Vector,
    direction: Vector,
) -> (Vector, S) {
    let low = fine.bricks.point(corner);
    let high = fine.bricks.point([corner[0] + 1.0, corner[1] + 1.0, corner[2] + 1.0]);
    let (mut before, mut behind) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        if direction[a].abs() > 1e-100 {
            let inverse = 1.0 / direction[a];
            let (t0, t1) = ((low[a] - start[a]) * inverse, (high[a] - start[a]) * inverse);
            before = before.max(t0.min(t1));
            behind = behind.min(t0.max(t1));
        }
    }
    let chord = behind - before;
    let k = f64::from(fine.core[cell][0].sum()) / fine.groups as f64;
    let depth = k * chord;
    if depth.is_nan() || depth < THIN {
        return (start, S::splat(1.0));
    }
    let open = -(-depth).exp_m1();
    let fraction = (-before / chord).clamp(0.0, 1.0);
    let place = (-(-fraction * open).ln_1p() / k).min(chord);
    let share = narrow(open / depth);
    let weight = if S::WIDTH == 1 {
        S::splat(share)
    } else {
        // e^((k̄ − k) s) for each group, kept finite.
        let mut weight = S::ZERO;
        for g in 0..fine.groups {
            let stretch = (narrow(k) - fine.core[cell][0].get(g)) * narrow(place);
            weight.set(g, share * stretch.clamp(-20.0, 20.0).exp());
        }
        weight
    };
    (along(start, before + place, direction), weight)
}
