//! Which leaves the camera sees, and how strongly: what decides where paths are worth their time.

use super::bricks::Segment;
use super::cache::{Leaves, owners};
use super::camera::Sights;
use super::fine::{CELLS, Fine};
use super::packet::{LANES, Packet};
use super::plate::Plate;
use super::reconstruct::neighbours;
use super::spectrum::{One, Spectrum, narrow, vectorised};
use super::vector::Vector;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Sums of squared weights are kept as integers in this unit, so that their order does not matter.
const UNIT: f32 = 1e-9;

/// Behind this transmittance a leaf counts as unseen.
const OPAQUE: f32 = 1e-6;

/// What every leaf that is seen gets at least, against the mean demand.
const FLOOR: f32 = 0.05;

/// Sets the demand of each leaf: the root of Σ over the sights of (weight of its scattering)², to which the optimal
/// number of paths is proportional when all paths have the same variance (Neyman).
pub(super) fn demand<S: Spectrum>(
    fine: &Fine<S>,
    leaves: &mut Leaves,
    sights: &Sights,
    plate: Option<&Plate>,
    probes: &[(f64, f64)],
) {
    let sums: Vec<AtomicU64> = (0..leaves.demand.len()).map(|_| AtomicU64::new(0)).collect();
    if let Some(fine) = fine.single() {
        packets(fine, leaves, sights, plate, probes, &sums);
    } else {
        one_by_one(fine, leaves, sights, plate, probes, &sums);
    }
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
        if leaves.demand[leaf] <= 0.0 {
            leaves.demand[leaf] = floor;
        }
    }
    for leaf in seen {
        leaves.demand[leaf] += floor;
    }
}

/// Adds the squared weights of what the leaves scatter into the probes.
fn one_by_one<S: Spectrum>(
    fine: &Fine<S>,
    leaves: &Leaves,
    sights: &Sights,
    plate: Option<&Plate>,
    probes: &[(f64, f64)],
    sums: &[AtomicU64],
) {
    let cuts: Vec<_> = leaves.occupied.iter().map(|&b| leaves.bricks.list[b]).collect();
    let per_group = 1.0 / narrow(real(fine.groups));
    probes.par_chunks(64).for_each(|probes| {
        vectorised(
            #[inline(always)]
            || {
                for &(row, column) in probes {
                    let (origin, direction): (Vector, Vector) = sights.ray(row, column);
                    let far = plate.and_then(|p| p.hit(origin, direction)).unwrap_or(f64::INFINITY);
                    let mut through = S::splat(1.0);
                    let (mut leaf, mut sum) = (usize::MAX, 0.0_f32);
                    let mut march = fine.bricks.march(origin, direction, far);
                    while let Some(Segment { place, block: [x, y, z], start, end }) = march.next() {
                        let [k, albedo] = fine.core[place];
                        if k.largest() <= 0.0 {
                            continue;
                        }
                        let here = cuts[place / CELLS].place(x, y, z);
                        if here != leaf {
                            add(sums, leaf, sum);
                            (leaf, sum) = (here, 0.0);
                        }
                        let (passed, stopped) = k.split(narrow(end - start));
                        sum += through.times(stopped).times(albedo).sum() * per_group;
                        through = through.times(passed);
                        if through.largest() <= OPAQUE {
                            break;
                        }
                    }
                    add(sums, leaf, sum);
                }
            },
        );
    });
}

/// The same for one group, many probes at once.
fn packets(
    fine: &Fine<One>,
    leaves: &Leaves,
    sights: &Sights,
    plate: Option<&Plate>,
    probes: &[(f64, f64)],
    sums: &[AtomicU64],
) {
    probes.par_chunks(16 * LANES).for_each(|probes| {
        let mut packet = Packet::new(fine.channels);
        vectorised(
            #[inline(always)]
            || {
                for probes in probes.chunks(LANES) {
                    let mut last = [(usize::MAX, 0.0_f32); LANES];
                    for &(row, column) in probes {
                        packet.push(fine, plate, sights.ray(row, column), 1.0, false);
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
                                add(sums, before, sum);
                                last[lane] = (leaf, turned);
                            }
                        },
                    );
                    for (leaf, sum) in last {
                        add(sums, leaf, sum);
                    }
                    packet.clear();
                }
            },
        );
    });
}

#[inline(always)]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "weights are at most 1")]
fn add(sums: &[AtomicU64], leaf: usize, sum: f32) {
    if leaf != usize::MAX && sum > 0.0 {
        sums[leaf].fetch_add((sum * sum / UNIT).max(1.0) as u64, Ordering::Relaxed);
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
