//! In-scattered radiance towards the camera, estimated once per leaf of the medium and shared by all pixels.
//!
//! A camera sees every point from one direction only, so what is scattered into its sights is a scalar field per group
//! (backward form of the source function of RADMC-3D and SHDOM). The radiance from walls is estimated too, and plate,
//! walls and medium are divided by their sum, so that a uniform enclosure stays uniform whatever the noise.

use super::begin::{Members, start};
use super::bricks::Bricks;
use super::camera::Sights;
use super::chamber::SIDES;
use super::fine::Fine;
use super::flock::{Begin, Flock};
use super::paths::{MEDIUM, PLATE, WALLS, World};
use super::sobol::{self, Sequence};
use super::spectrum::{Spectrum, vectorised};
use rayon::prelude::*;

/// Leaves of one parallel task: each leaf holds up to hundreds of paths.
const TASK_LEAVES: usize = 64;

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
    /// The medium, and what each of its cells scatters in all groups together.
    pub(super) fine: &'a Fine<S>,
    pub(super) scattering: &'a [f32],
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
        let Origin { fine, scattering, leaves, sights, seed } = *from;
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
                let leaves_from = task * TASK_LEAVES;
                let width = world.rows();
                let mut rows = vec![S::ZERO; 2 * halves.len() * width];
                let begin = Beginnings {
                    leaves,
                    scattering,
                    sights,
                    starts: &starts,
                    owner: &owner,
                    names: &names,
                    first: leaves_from,
                };
                let counted = vectorised(
                    #[inline(always)]
                    || follow(&begin, fine, world, halves.len(), &mut rows),
                );
                for (i, halves) in halves.iter_mut().enumerate() {
                    for (h, half) in halves.iter_mut().enumerate() {
                        let rows = &rows[(2 * i + h) * width..][..width];
                        for (sum, row) in half.iter_mut().zip([PLATE, WALLS, MEDIUM]) {
                            *sum = sum.plus(rows[row]);
                        }
                        for c in 0..extra {
                            let to = &mut others[i * extra + c];
                            *to = to.plus(rows[MEDIUM + 1 + c]);
                        }
                        if let Some(sides) = sides.get_mut(i) {
                            // Paths begin inside the chamber: nothing ends outside but by rounding.
                            for (sum, row) in sides[h].iter_mut().zip(&rows[world.first_end()..]) {
                                *sum = sum.plus(*row);
                            }
                        }
                    }
                }
                let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
                progress((n * TASK_LEAVES) as f64 / count as f64);
                counted
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

/// Where the paths of a task begin.
struct Beginnings<'a> {
    leaves: &'a Leaves,
    scattering: &'a [f32],
    sights: &'a Sights,
    /// Number of the first path of each leaf in its sequence, and one more.
    starts: &'a [u32],
    owner: &'a [u32],
    /// The sequences of both halves.
    names: &'a [Sequence; 2],
    /// First leaf of the task.
    first: usize,
}

/// Follows the paths of some leaves; scatterings and blocks of all.
#[inline(always)]
fn follow<S: Spectrum>(
    begin: &Beginnings<'_>,
    fine: &Fine<S>,
    world: &World<'_, S>,
    leaves: usize,
    rows: &mut [S],
) -> [u64; 2] {
    let mut flock = Flock::new();
    let (mut i, mut h, mut left) = (0, 1, 0_u32);
    let mut now = Members::NONE;
    let mut run = begin.names[0].from(0);
    flock.run(
        world,
        #[inline(always)]
        || {
            loop {
                while left == 0 {
                    // The second half of a leaf's paths, or the next leaf that has any.
                    if h == 0 {
                        h = 1;
                    } else {
                        while i < leaves && begin.starts[begin.first + i] == begin.starts[begin.first + i + 1]
                        {
                            i += 1;
                        }
                        if i == leaves {
                            return None;
                        }
                        h = 0;
                        now = Members::of(
                            fine,
                            begin.scattering,
                            begin.leaves,
                            begin.owner[begin.first + i],
                            begin.first + i,
                        );
                        i += 1;
                    }
                    let (from, to) = (begin.starts[begin.first + i - 1], begin.starts[begin.first + i]);
                    run = begin.names[h].from(from);
                    left = to - from;
                }
                left -= 1;
                let at = run.next();
                if let Some((origin, direction, weight)) = start(fine, begin.sights, &now, &at) {
                    let (direction, share) = world.turned(&at, direction);
                    let weight = weight.times(share);
                    return Some(Begin { at, origin, direction, weight, set: 2 * (i - 1) + h });
                }
            }
        },
        rows,
    );
    [flock.scatterings, flock.visited]
}
