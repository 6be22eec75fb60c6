//! The medium as the straight sights read it: every cell at its own resolution, coefficients in f32.

use super::bricks::{Brick, Bricks, EDGE, NONE};
use super::medium::{EMPTY, GridMedium};
use super::spectrum::{One, Spectrum, narrow};
use rayon::prelude::*;

/// Extinction beyond which a cell of any size is opaque in f32; keeps products finite.
const K_MAX: f64 = 1e30;

/// Cells of a brick.
pub(super) const CELLS: usize = EDGE * EDGE * EDGE;

/// Coefficients per occupied cell.
#[derive(Clone)]
pub(super) struct Fine<S> {
    pub(super) bricks: Bricks,
    /// Number of each occupied brick in `bricks`, in the order of their cells.
    pub(super) occupied: Vec<usize>,
    /// Ordinal of the cell at each place, or [`EMPTY`].
    pub(super) slot: Vec<u32>,
    /// Its ordinal in the medium, `[ordinal]`.
    pub(super) original: Vec<u32>,
    /// Extinction in 1/m, and scattering over extinction, `[place]`; zero where nothing is. What is not scattered is
    /// emitted by channel 0.
    pub(super) core: Vec<[S; 2]>,
    /// Emission coefficient over extinction of the channels from 1 on, `[ordinal · (channels − 1) + channel − 1]`.
    pub(super) source: Vec<S>,
    pub(super) channels: usize,
    pub(super) groups: usize,
}

impl<S: Spectrum> Fine<S> {
    /// Packs a checked medium, each cell cut into `factor`³ equal ones; `factor` is 1, 2, 4 or 8.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "as many places as fit into u32 are checked by the caller"
    )]
    pub(super) fn new(medium: &GridMedium, factor: usize) -> Self {
        let mut bricks = Bricks::new(medium.lower_m, medium.upper_m, medium.cells.map(|n| n * factor));
        // Bricks are packed column by column along z, where the medium's cells lie in rows; whole cells of the medium lie
        // in each, so that what is counted there counts `factor`³ times.
        let columns: Vec<Column<'_>> = (0..bricks.count[0] * bricks.count[1])
            .map(|c| Column { medium, factor, at: [c / bricks.count[1], c % bricks.count[1]] })
            .collect();
        let counts: Vec<Vec<u32>> = columns.par_iter().map(|column| column.counts(bricks.count[2])).collect();
        let (groups, channels) = (medium.groups, medium.channels);
        let occupied: Vec<usize> =
            counts.iter().flatten().enumerate().filter(|&(_, &count)| count > 0).map(|(b, _)| b).collect();
        for (i, &b) in occupied.iter().enumerate() {
            bricks.list[b] = Brick { first: (i * CELLS) as u32, log: 3 };
        }
        let total: usize = counts.iter().flatten().map(|&count| count as usize).sum();
        let mut slot = vec![EMPTY; occupied.len() * CELLS];
        let mut core = vec![[S::ZERO; 2]; occupied.len() * CELLS];
        let mut original = vec![0_u32; total];
        let mut source = vec![S::ZERO; total * (channels - 1)];
        let mut jobs = Vec::with_capacity(columns.len());
        let mut left = Packed {
            first: 0,
            slot: &mut slot,
            core: &mut core,
            original: &mut original,
            source: &mut source,
        };
        for (column, counts) in columns.iter().zip(&counts) {
            let bricks = counts.iter().filter(|&&count| count > 0).count();
            let cells = counts.iter().sum::<u32>();
            let (packed, rest) = left.split(bricks * CELLS, cells, channels - 1);
            left = rest;
            jobs.push((column, counts, packed));
        }
        jobs.into_par_iter().for_each(|(column, counts, packed)| column.pack(counts, packed));
        Self { bricks, occupied, slot, original, core, source, channels, groups }
    }
}

/// A column of bricks along z.
struct Column<'a> {
    medium: &'a GridMedium,
    /// Into how many each cell is cut along its edges.
    factor: usize,
    /// Place of the column along x and y.
    at: [usize; 2],
}

impl Column<'_> {
    /// Rows of the medium's index along z, and where they begin in a brick.
    fn rows(&self) -> impl Iterator<Item = (usize, &[u32])> {
        let edge = EDGE / self.factor;
        let [nx, ny, nz] = self.medium.cells;
        let [x0, y0] = self.at.map(|b| b * edge);
        (x0..(x0 + edge).min(nx)).flat_map(move |x| {
            (y0..(y0 + edge).min(ny)).map(move |y| {
                let local = ((x - x0) * EDGE + (y - y0)) * EDGE * self.factor;
                (local, &self.medium.index[(x * ny + y) * nz..][..nz])
            })
        })
    }

    /// Occupied cells in each brick.
    fn counts(&self, bricks: usize) -> Vec<u32> {
        let mut counts = vec![0; bricks];
        for (_, row) in self.rows() {
            for (count, run) in counts.iter_mut().zip(row.chunks(EDGE / self.factor)) {
                *count += run.iter().map(|&i| u32::from(i != EMPTY)).sum::<u32>();
            }
        }
        let copies = u32::try_from(self.factor.pow(3)).unwrap_or(u32::MAX);
        counts.iter().map(|n| n * copies).collect()
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "as many places as fit into u32 are checked by the caller"
    )]
    fn pack<S: Spectrum>(&self, counts: &[u32], to: Packed<'_, S>) {
        let Self { medium, factor, .. } = *self;
        let (groups, channels) = (medium.groups, medium.channels);
        let extra = channels - 1;
        // Where the next cell of each brick comes, and its places.
        let (mut cells, mut bricks) = (0, 0);
        let mut next: Vec<(usize, usize)> = counts
            .iter()
            .map(|&count| {
                let here = (cells, bricks * CELLS);
                (cells, bricks) = (cells + count as usize, bricks + usize::from(count > 0));
                here
            })
            .collect();
        for (local, row) in self.rows() {
            for ((next, places), run) in next.iter_mut().zip(row.chunks(EDGE / factor)) {
                for (i, &o) in run.iter().enumerate().filter(|&(_, &o)| o != EMPTY) {
                    let (cell, from) = (cell(medium, o as usize), o as usize * groups);
                    // The copies of a cell lie side by side.
                    for x in 0..factor {
                        for y in 0..factor {
                            for z in 0..factor {
                                let place = *places + local + (x * EDGE + y) * EDGE + i * factor + z;
                                to.slot[place] = to.first + *next as u32;
                                to.core[place] = cell;
                                to.original[*next] = o;
                                for c in 0..extra {
                                    let start = (o as usize * channels + 1 + c) * groups;
                                    let k = &medium.k_ext[from..from + groups];
                                    to.source[*next * extra + c] =
                                        over(&medium.emission[start..start + groups], k);
                                }
                                *next += 1;
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Where a part of the medium is packed.
struct Packed<'a, S> {
    /// Ordinal of its first cell.
    first: u32,
    slot: &'a mut [u32],
    core: &'a mut [[S; 2]],
    original: &'a mut [u32],
    source: &'a mut [S],
}

impl<S> Packed<'_, S> {
    /// Its first places and cells, and the rest.
    fn split(self, places: usize, cells: u32, extra: usize) -> (Self, Self) {
        let (slot, slots) = self.slot.split_at_mut(places);
        let (core, cores) = self.core.split_at_mut(places);
        let (original, originals) = self.original.split_at_mut(cells as usize);
        let (source, sources) = self.source.split_at_mut(cells as usize * extra);
        (
            Self { first: self.first, slot, core, original, source },
            Self {
                first: self.first + cells,
                slot: slots,
                core: cores,
                original: originals,
                source: sources,
            },
        )
    }
}

/// Extinction and albedo of a cell of the medium, given by its ordinal.
#[inline(always)]
fn cell<S: Spectrum>(medium: &GridMedium, o: usize) -> [S; 2] {
    let groups = o * medium.groups..(o + 1) * medium.groups;
    let k = &medium.k_ext[groups.clone()];
    let mut extinction = S::ZERO;
    for (g, k) in k.iter().enumerate() {
        extinction.set(g, narrow(k.min(K_MAX)));
    }
    let one = S::splat(1.0);
    // A sum of roundings may exceed the extinction by a unit in the last place.
    [extinction, one.minus(one.minus(over(&medium.k_sca[groups], k)).not_negative())]
}

/// Values over extinctions, group by group; zero where nothing is.
#[inline(always)]
fn over<S: Spectrum>(values: &[f64], k: &[f64]) -> S {
    let mut out = S::ZERO;
    for (g, (value, k)) in values.iter().zip(k).enumerate() {
        out.set(g, narrow(if *k > 0.0 { value / k } else { 0.0 }));
    }
    out
}

impl<S: Spectrum> Fine<S> {
    /// Itself, if it holds a single group.
    pub(super) fn single(&self) -> Option<&Fine<One>> {
        (self as &dyn std::any::Any).downcast_ref()
    }
}

/// Whether a place is occupied.
pub(super) fn is_occupied(slot: u32) -> bool {
    slot != EMPTY
}

const _: () = assert!(NONE == EMPTY);
