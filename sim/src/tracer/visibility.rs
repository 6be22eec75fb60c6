//! Which leaves the camera sees, and how strongly: what decides where paths are worth their time.

use super::bricks::Segment;
use super::cache::{Leaves, owners};
use super::camera::Sights;
use super::fine::{CELLS, Fine};
use super::lanes::LANES;
use super::packet::Packet;
use super::places::neighbours;
use super::plate::Plate;
use super::reconstruct::InLeaf;
use super::shares::ROWS;
use super::spectrum::{One, Spectrum, narrow, vectorised};
use super::vector::Vector;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Sums of squared weights are kept as integers in this unit, so that their order does not matter.
const UNIT: f32 = 1e-9;

/// Probes of one parallel task.
const TASK_PROBES: usize = 16 * LANES;

/// Behind this transmittance a leaf counts as unseen.
const OPAQUE: f32 = 1e-6;

/// What every leaf that is seen gets at least, against the mean demand.
const FLOOR: f32 = 0.05;

/// What some sights see of the leaves: enough to tell the errors of an image from those of the leaves.
pub(super) struct Views<S> {
    /// Where the leaves of each sight that met any begin; one entry more than sights.
    starts: Vec<u32>,
    leaves: Vec<u32>,
    /// Weight of what each of them scatters into the sight.
    weights: Vec<S>,
}

impl<S: Spectrum> Views<S> {
    /// What a sight sees of noise and bias in some leaves.
    #[inline(always)]
    fn sums(
        &self,
        seen: std::ops::Range<usize>,
        lit: &[InLeaf<S>],
        some: impl Fn(usize) -> bool,
    ) -> [[S; ROWS]; 2] {
        let mut sums = [[S::ZERO; ROWS]; 2];
        for (&leaf, &weight) in self.leaves[seen.clone()].iter().zip(&self.weights[seen]) {
            if !some(leaf as usize) {
                continue;
            }
            let leaf = &lit[leaf as usize];
            for (sums, of) in sums.iter_mut().zip([&leaf.noise, &leaf.bias]) {
                for row in 0..ROWS {
                    sums[row] = sums[row].plus_product(weight, of[row]);
                }
            }
        }
        sums
    }

    /// Mean square over the sights of the noise of a single path, shared out by the leaves' demands, if the light that
    /// paths tell deviates by one.
    pub(super) fn noise_of_a_path(&self, demand: &[f32], groups: usize) -> f64 {
        let per_group = 1.0 / real(groups);
        let seen = self.leaves.iter().zip(&self.weights);
        let squares: f64 = seen
            .map(|(&leaf, weight)| {
                f64::from(weight.times(*weight).sum()) * per_group / f64::from(demand[leaf as usize])
            })
            .filter(|square| square.is_finite())
            .sum();
        let all: f64 = demand.iter().map(|&d| f64::from(d)).sum();
        squares * all / real(self.starts.len().saturating_sub(1).max(1))
    }

    /// Mean squares over the sights of noise and bias of plate and medium in some leaves, the mean over `groups` of each.
    pub(super) fn errors(
        &self,
        lit: &[InLeaf<S>],
        groups: usize,
        some: impl Fn(usize) -> bool + Sync,
    ) -> [[f64; ROWS]; 2] {
        let sights = self.starts.len().saturating_sub(1);
        let squares: Vec<[[f32; ROWS]; 2]> = (0..sights)
            .into_par_iter()
            .with_min_len(256)
            .map(|i| {
                let seen = self.starts[i] as usize..self.starts[i + 1] as usize;
                vectorised(
                    #[inline(always)]
                    || self.sums(seen, lit, &some).map(|rows| rows.map(|row| row.times(row).sum())),
                )
            })
            .collect();
        let mut sums = [[0.0; ROWS]; 2];
        for square in &squares {
            for kind in 0..2 {
                for row in 0..ROWS {
                    sums[kind][row] += f64::from(square[kind][row]);
                }
            }
        }
        let per_square = 1.0 / real((sights * groups).max(1));
        sums.map(|rows| rows.map(|sum| sum * per_square))
    }
}

/// Sights by which the camera's view of the medium is found.
pub(super) struct Probes<'a> {
    pub(super) sights: &'a Sights,
    pub(super) plate: Option<&'a Plate>,
    /// Row and column of each.
    pub(super) places: Vec<(f64, f64)>,
    /// How many of them, from the first on, are spread evenly over the image.
    pub(super) even: usize,
    /// One of so many of these is kept as a view.
    pub(super) stride: usize,
}

impl Probes<'_> {
    #[inline(always)]
    fn keeps(&self, probe: usize) -> bool {
        probe < self.even && probe.is_multiple_of(self.stride)
    }
}

/// The leaves on the way of a sight and their weights.
type Way<S> = Vec<(u32, S)>;

/// Sets the demand of each leaf: the root of Σ over the probes of (weight of its scattering)², to which the optimal
/// number of paths is proportional when all paths have the same variance (Neyman).
///
/// `depths` tells which leaves hold anything: no path begins in the others.
pub(super) fn demand<S: Spectrum>(
    fine: &Fine<S>,
    leaves: &mut Leaves,
    depths: &[f32],
    probes: &Probes<'_>,
) -> Views<S> {
    let sums: Vec<AtomicU64> = (0..leaves.demand.len()).map(|_| AtomicU64::new(0)).collect();
    let views = if let Some(fine) = fine.single() {
        let single = |way: Way<One>| way.into_iter().map(|(leaf, weight)| (leaf, S::splat(weight.get(0))));
        joined(packets(fine, leaves, probes, &sums).into_iter().flatten().map(single))
    } else {
        joined(one_by_one(fine, leaves, probes, &sums).into_iter().flatten().map(Vec::into_iter))
    };
    leaves.demand = sums
        .iter()
        .map(|sum| {
            #[expect(clippy::cast_precision_loss, reason = "a demand needs no more digits")]
            let sum = sum.load(Ordering::Relaxed) as f32;
            (sum * UNIT).sqrt()
        })
        .collect();
    let seen: Vec<usize> = (0..leaves.demand.len()).filter(|&l| leaves.demand[l] > 0.0).collect();
    let mean = seen.iter().map(|&l| f64::from(leaves.demand[l])).sum::<f64>() / real(seen.len().max(1));
    let floor = FLOOR * narrow(mean);
    // Slopes inside a leaf that is seen need the leaves beside it.
    let owner = owners(leaves);
    let beside: Vec<usize> = seen
        .par_iter()
        .with_min_len(256)
        .flat_map_iter(|&leaf| neighbours(leaves, leaves.occupied[owner[leaf] as usize], leaf))
        .collect();
    for leaf in beside {
        if leaves.demand[leaf] <= 0.0 && depths[leaf] > 0.0 {
            leaves.demand[leaf] = floor;
        }
    }
    for leaf in seen {
        leaves.demand[leaf] += floor;
    }
    views
}

/// Those that met any leaf, one after the other.
fn joined<S: Spectrum>(ways: impl Iterator<Item = impl Iterator<Item = (u32, S)>>) -> Views<S> {
    let mut views = Views { starts: vec![0], leaves: Vec::new(), weights: Vec::new() };
    for way in ways {
        let before = views.leaves.len();
        for (leaf, weight) in way {
            views.leaves.push(leaf);
            views.weights.push(weight);
        }
        if views.leaves.len() > before {
            views.starts.push(u32::try_from(views.leaves.len()).unwrap_or(u32::MAX));
        }
    }
    views
}

/// Adds the squared weights of what the leaves scatter into the probes; the leaves and weights of each that is kept.
fn one_by_one<S: Spectrum>(
    fine: &Fine<S>,
    leaves: &Leaves,
    probes: &Probes<'_>,
    sums: &[AtomicU64],
) -> Vec<Vec<Way<S>>> {
    let cuts: Vec<_> = leaves.occupied.iter().map(|&b| leaves.bricks.list[b]).collect();
    let per_group = 1.0 / narrow(real(fine.groups));
    let task = |(task, places): (usize, &[(f64, f64)])| {
        let mut ways = Vec::new();
        vectorised(
            #[inline(always)]
            || {
                for (i, &(row, column)) in places.iter().enumerate() {
                    let (origin, direction): (Vector, Vector) = probes.sights.ray(row, column);
                    let hit = probes.plate.and_then(|p| p.hit(origin, direction));
                    let far = hit.unwrap_or(f64::INFINITY);
                    let mut through = S::splat(1.0);
                    let mut way = probes.keeps(task * TASK_PROBES + i).then(Vec::new);
                    let (mut leaf, mut sum) = (usize::MAX, S::ZERO);
                    let mut march = fine.bricks.march(origin, direction, far);
                    while let Some(Segment { place, block: [x, y, z], start, end }) = march.next() {
                        let [k, albedo] = fine.core[place];
                        if !k.any_above(0.0) {
                            continue;
                        }
                        let here = cuts[place / CELLS].place(x, y, z);
                        if here != leaf {
                            add(sums, leaf, sum, per_group, way.as_mut());
                            (leaf, sum) = (here, S::ZERO);
                        }
                        let (passed, stopped) = k.split(narrow(end - start));
                        sum = sum.plus(through.times(stopped).times(albedo));
                        through = through.times(passed);
                        if !through.any_above(OPAQUE) {
                            break;
                        }
                    }
                    add(sums, leaf, sum, per_group, way.as_mut());
                    ways.extend(way);
                }
            },
        );
        ways
    };
    probes.places.par_chunks(TASK_PROBES).enumerate().map(task).collect()
}

/// The same for one group, many probes at once.
fn packets(fine: &Fine<One>, leaves: &Leaves, probes: &Probes<'_>, sums: &[AtomicU64]) -> Vec<Vec<Way<One>>> {
    let task = |(task, places): (usize, &[(f64, f64)])| {
        let mut ways = Vec::new();
        let mut packet = Packet::new(fine.channels);
        vectorised(
            #[inline(always)]
            || {
                for (p, places) in places.chunks(LANES).enumerate() {
                    let mut last = [(usize::MAX, 0.0_f32); LANES];
                    let mut way = [const { None }; LANES];
                    for (lane, &(row, column)) in places.iter().enumerate() {
                        packet.push(fine, probes.plate, probes.sights.ray(row, column), 1.0, false);
                        way[lane] = probes.keeps(task * TASK_PROBES + p * LANES + lane).then(Vec::new);
                    }
                    packet.visit(
                        fine,
                        &leaves.bricks.list,
                        #[inline(always)]
                        |lane, leaf, turned| {
                            let (before, sum) = last[lane];
                            if leaf == before {
                                last[lane].1 += turned;
                            } else {
                                add(sums, before, One::splat(sum), 1.0, way[lane].as_mut());
                                last[lane] = (leaf, turned);
                            }
                        },
                    );
                    for ((leaf, sum), way) in last.into_iter().zip(&mut way) {
                        add(sums, leaf, One::splat(sum), 1.0, way.as_mut());
                    }
                    ways.extend(way.into_iter().flatten());
                    packet.clear();
                }
            },
        );
        ways
    };
    probes.places.par_chunks(TASK_PROBES).enumerate().map(task).collect()
}

#[inline(always)]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "weights are at most 1, leaves fit into u32"
)]
fn add<S: Spectrum>(sums: &[AtomicU64], leaf: usize, weight: S, per_group: f32, way: Option<&mut Way<S>>) {
    let sum = weight.sum() * per_group;
    if leaf != usize::MAX && sum > 0.0 {
        sums[leaf].fetch_add((sum * sum / UNIT).max(1.0) as u64, Ordering::Relaxed);
        if let Some(way) = way {
            way.push((leaf as u32, weight));
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
