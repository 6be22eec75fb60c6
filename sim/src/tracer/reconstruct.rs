//! From the sums of the leaves to a source function per cell: filtered, interpolated, divided by plate + walls + medium.

#![expect(clippy::needless_range_loop, reason = "loops over lanes step through several arrays at once")]

use super::cache::{Cache, Halves, Leaves, ROWS_BEFORE_CHANNELS};
use super::lanes::Lane;
use super::packed::Packed;
use rayon::prelude::*;

/// What scattering adds to the sights in each cell.
pub(super) struct Scattered<const N: usize> {
    /// Rows per cell: plate, then the channels; J per group, `[cell · rows + row]`.
    pub(super) value: Vec<[Lane; N]>,
    /// Change of the rows per cell edge along x, y, z, `[(cell · 3 + axis) · rows + row]`.
    pub(super) slope: Vec<[Lane; N]>,
    /// Rows per cell.
    pub(super) rows: usize,
    /// Half the difference of the two halves of the samples, plate and channel 0, `[cell]`.
    pub(super) noise: Vec<[[Lane; N]; 2]>,
    /// How far filter and interpolation bend J, plate and channel 0, `[cell]`: an estimate of what no number of
    /// samples mends.
    pub(super) bias: Vec<[[Lane; N]; 2]>,
}

/// Mean squared second difference that linear interpolation between leaves of several cells loses: 1/24 for the
/// mean over a leaf, 1/12 for the chord; leaves of one cell only lose the first.
const LOST_BETWEEN_LEAVES: f32 = 1.0 / 8.0;
const LOST_IN_A_CELL: f32 = 1.0 / 24.0;

/// The source function of every occupied cell from the cache's sums.
pub(super) fn per_cell<const N: usize>(
    medium: &Packed<N>,
    leaves: &Leaves,
    cache: &Cache<N>,
    sums: &[[Lane; N]],
) -> Scattered<N> {
    let filtered = filter(medium, leaves, cache, sums);
    let rows = cache.rows - 1;
    let cells = medium.k.len();
    let places = places(medium);
    let mut value = vec![[Lane::ZERO; N]; cells * rows];
    let noise = value
        .par_chunks_mut(rows.max(1))
        .zip(places.par_iter())
        .enumerate()
        .with_min_len(256)
        .map(|(ordinal, (value, &cell))| {
            let mut sum = vec![[Lane::ZERO; N]; cache.rows];
            let mut halves = [[[Lane::ZERO; N]; 3]; 2];
            for (leaf, weight) in leaves.around(medium, ordinal, cell) {
                for (to, from) in
                    sum.iter_mut().zip(&filtered.sums[leaf * cache.rows..(leaf + 1) * cache.rows])
                {
                    for n in 0..N {
                        to[n] = to[n] + from[n].map(|v| weight * v);
                    }
                }
                add_halves(&mut halves, &filtered.halves[leaf], weight);
            }
            divide(value, &sum);
            half_difference(&halves)
        })
        .collect();
    let bent = bias(medium, leaves, cache.rows, &filtered.sums);
    let bias = leaves.of_cell.iter().map(|&leaf| bent[leaf as usize]).collect();
    Scattered { value, slope: Vec::new(), rows, noise, bias }
}

/// What filtering once more would change, and what interpolation loses, per leaf: the change by the second filtering
/// stands for that by the first.
fn bias<const N: usize>(
    medium: &Packed<N>,
    leaves: &Leaves,
    rows: usize,
    sums: &[[Lane; N]],
) -> Vec<[[Lane; N]; 2]> {
    let shares: Vec<[[Lane; N]; 2]> = sums
        .par_chunks(rows)
        .with_min_len(256)
        .map(|row| {
            let mut share = [[Lane::ZERO; N]; 2];
            for n in 0..N {
                let total = row[0][n] + row[1][n] + row[ROWS_BEFORE_CHANNELS][n];
                let over = |v: Lane| v.zip(total, |v, t| if t > 0.0 { v / t } else { 0.0 });
                share[0][n] = over(row[0][n]);
                share[1][n] = over(row[ROWS_BEFORE_CHANNELS][n]);
            }
            share
        })
        .collect();
    (0..shares.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let mut change = [[Lane::ZERO; N]; 2];
            let mut add = |other: usize, weight: f32| {
                for k in 0..2 {
                    for n in 0..N {
                        let difference = shares[other][k][n] - shares[leaf][k][n];
                        change[k][n] = change[k][n] + difference.map(|v| weight * v);
                    }
                }
            };
            let total: f32 = leaves.neighbours(medium, leaf).map(|(_, weight)| weight).sum();
            leaves.neighbours(medium, leaf).for_each(|(other, weight)| add(other, weight / total));
            let lost = if leaves.list[leaf].edge > 1 { LOST_BETWEEN_LEAVES } else { LOST_IN_A_CELL };
            for [below, above] in leaves.opposite(medium, leaf) {
                add(below, lost);
                add(above, lost);
            }
            change
        })
        .collect()
}

/// Divides plate and channels by plate + walls + channel 0, group by group.
fn divide<const N: usize>(value: &mut [[Lane; N]], sum: &[[Lane; N]]) {
    for n in 0..N {
        let total = sum[0][n] + sum[1][n] + sum[ROWS_BEFORE_CHANNELS][n];
        let over = |v: Lane| v.zip(total, |v, t| if t > 0.0 { v / t } else { 0.0 });
        value[0][n] = over(sum[0][n]);
        for (to, from) in value[1..].iter_mut().zip(&sum[ROWS_BEFORE_CHANNELS..]) {
            to[n] = over(from[n]);
        }
    }
}

fn add_halves<const N: usize>(to: &mut Halves<N>, from: &Halves<N>, weight: f32) {
    for (to, from) in to.iter_mut().flatten().zip(from.iter().flatten()) {
        for n in 0..N {
            to[n] = to[n] + from[n].map(|v| weight * v);
        }
    }
}

/// (A − B)/2 of plate and channel 0; half the value where one half has no samples.
fn half_difference<const N: usize>(halves: &Halves<N>) -> [[Lane; N]; 2] {
    let mut out = [[Lane::ZERO; N]; 2];
    for n in 0..N {
        let [a, b] = [0, 1].map(|h: usize| halves[h][0][n] + halves[h][1][n] + halves[h][2][n]);
        for (k, row) in [0, 2].into_iter().enumerate() {
            let share = |h: usize, total: Lane| {
                halves[h][row][n].zip(total, |v, t| if t > 0.0 { v / t } else { 0.0 })
            };
            out[k][n] = (share(0, a) - share(1, b)).map(|v| 0.5 * v);
        }
    }
    out
}

struct Filtered<const N: usize> {
    sums: Vec<[Lane; N]>,
    halves: Vec<Halves<N>>,
}

/// Adds to each leaf the samples of its neighbours, weighted by how near they are in space and optical depth.
fn filter<const N: usize>(
    medium: &Packed<N>,
    leaves: &Leaves,
    cache: &Cache<N>,
    sums: &[[Lane; N]],
) -> Filtered<N> {
    let mut out = vec![[Lane::ZERO; N]; sums.len()];
    let halves = out
        .par_chunks_mut(cache.rows)
        .enumerate()
        .with_min_len(64)
        .map(|(leaf, out)| {
            let mut halves = [[[Lane::ZERO; N]; 3]; 2];
            for (other, weight) in leaves.neighbours(medium, leaf) {
                for (to, from) in out.iter_mut().zip(&sums[other * cache.rows..(other + 1) * cache.rows]) {
                    for n in 0..N {
                        to[n] = to[n] + from[n].map(|v| weight * v);
                    }
                }
                add_halves(&mut halves, &cache.halves[other], weight);
            }
            // Back to sums that count a leaf's own visits, so that interpolation weights leaves equally.
            let total: f32 = halves.iter().flatten().flatten().map(|lane| lane.sum()).sum();
            if total > 0.0 {
                let scale =
                    |row: &mut [Lane; N]| row.iter_mut().for_each(|lane| *lane = lane.map(|v| v / total));
                out.iter_mut().for_each(scale);
                halves.iter_mut().flatten().for_each(scale);
            }
            halves
        })
        .collect();
    Filtered { sums: out, halves }
}

/// The cell of every ordinal.
#[expect(clippy::cast_possible_truncation, reason = "cells per axis are below 65536")]
fn places<const N: usize>(medium: &Packed<N>) -> Vec<[u16; 3]> {
    let cells = medium.lattice.cells;
    let mut places = vec![[0_u16; 3]; medium.k.len()];
    for x in 0..cells[0] {
        for y in 0..cells[1] {
            for z in 0..cells[2] {
                let ordinal = medium.lattice.index[(x * cells[1] + y) * cells[2] + z];
                if ordinal != super::medium::EMPTY {
                    places[ordinal as usize] = [x as u16, y as u16, z as u16];
                }
            }
        }
    }
    places
}

impl<const N: usize> Scattered<N> {
    /// Turns J into what the gather adds: albedo · J for the plate, source + albedo · J for the channels; and finds the
    /// slopes of albedo · J from the neighbouring cells, since sights through the same cell see different J.
    pub(super) fn times_albedo(&mut self, medium: &Packed<N>) {
        self.slope = self.slopes(medium);
        let channels = medium.channels;
        self.value.par_chunks_mut(self.rows).enumerate().with_min_len(256).for_each(|(o, rows)| {
            for n in 0..N {
                let albedo = medium.albedo[o][n];
                rows[0][n] = rows[0][n] * albedo;
                for c in 0..channels {
                    rows[1 + c][n] = medium.source[o * channels + c][n] + rows[1 + c][n] * albedo;
                }
            }
        });
    }

    /// Central differences of J times albedo; one-sided at the rim of the medium.
    fn slopes(&self, medium: &Packed<N>) -> Vec<[Lane; N]> {
        let lattice = &medium.lattice;
        let cells = lattice.cells;
        let rows = self.rows;
        let mut slope = vec![[Lane::ZERO; N]; 3 * self.value.len()];
        let places = places(medium);
        slope.par_chunks_mut(3 * rows).zip(places.par_iter()).enumerate().with_min_len(256).for_each(
            |(o, (slope, place))| {
                let at = |axis: usize, step: isize| {
                    let mut c = place.map(usize::from);
                    c[axis] = c[axis].checked_add_signed(step).filter(|&i| i < cells[axis])?;
                    let ordinal = lattice.index[(c[0] * cells[1] + c[1]) * cells[2] + c[2]];
                    (ordinal != super::medium::EMPTY).then_some(ordinal as usize)
                };
                for axis in 0..3 {
                    let (below, above) = (at(axis, -1), at(axis, 1));
                    let share = if below.is_some() && above.is_some() { 0.5 } else { 1.0 };
                    let (low, high) = (below.unwrap_or(o), above.unwrap_or(o));
                    for row in 0..rows {
                        for n in 0..N {
                            let change = self.value[high * rows + row][n] - self.value[low * rows + row][n];
                            slope[axis * rows + row][n] =
                                change.zip(medium.albedo[o][n], |c, albedo| share * c * albedo);
                        }
                    }
                }
            },
        );
        slope
    }
}
