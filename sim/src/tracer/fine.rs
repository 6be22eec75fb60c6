//! The medium as the straight sights read it: every cell at its own resolution, coefficients in f32.

use super::bricks::{Brick, Bricks, EDGE, NONE};
use super::medium::{EMPTY, GridMedium};
use super::spectrum::{One, Spectrum, narrow, vectorised};
use rayon::prelude::*;

/// Extinction beyond which a cell of any size is opaque in f32; keeps products finite.
const K_MAX: f64 = 1e30;

/// Cells of a brick.
pub(super) const CELLS: usize = EDGE * EDGE * EDGE;

/// Coefficients per place.
#[derive(Clone)]
pub(super) struct Fine<S> {
    pub(super) bricks: Bricks,
    /// Number of each occupied brick in `bricks`, in the order of their places.
    pub(super) occupied: Vec<usize>,
    /// Ordinal in the medium of the cell at each place, or [`EMPTY`].
    pub(super) ordinal: Vec<u32>,
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
        // Bricks are packed column by column along z, where the medium's cells lie in rows.
        let columns: Vec<Column<'_>> = (0..bricks.count[0] * bricks.count[1])
            .map(|c| Column { medium, factor, at: [c / bricks.count[1], c % bricks.count[1]] })
            .collect();
        let filled: Vec<Vec<bool>> =
            columns.par_iter().map(|column| column.filled(bricks.count[2])).collect();
        let occupied: Vec<usize> =
            filled.iter().flatten().enumerate().filter(|&(_, &filled)| filled).map(|(b, _)| b).collect();
        for (i, &b) in occupied.iter().enumerate() {
            bricks.list[b] = Brick { first: (i * CELLS) as u32, log: 3 };
        }
        let mut ordinal = vec![EMPTY; occupied.len() * CELLS];
        // By all threads: where zeros are written first, the system finds pages for them.
        let mut core: Vec<[S; 2]> =
            (0..occupied.len() * CELLS).into_par_iter().with_min_len(CELLS).map(|_| [S::ZERO; 2]).collect();
        let mut jobs = Vec::with_capacity(columns.len());
        let mut left = (ordinal.as_mut_slice(), core.as_mut_slice());
        for (column, filled) in columns.iter().zip(&filled) {
            let places = CELLS * filled.iter().filter(|&&filled| filled).count();
            let (ordinal, ordinals) = left.0.split_at_mut(places);
            let (core, cores) = left.1.split_at_mut(places);
            left = (ordinals, cores);
            jobs.push((column, filled, ordinal, core));
        }
        jobs.into_par_iter().for_each(|(column, filled, ordinal, core)| {
            vectorised(
                #[inline(always)]
                || column.pack(filled, ordinal, core),
            );
        });
        let source = sources(medium);
        Self { bricks, occupied, ordinal, core, source, channels: medium.channels, groups: medium.groups }
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

    /// Which bricks have any occupied cell.
    fn filled(&self, bricks: usize) -> Vec<bool> {
        let mut filled = vec![false; bricks];
        for (_, row) in self.rows() {
            for (filled, run) in filled.iter_mut().zip(row.chunks(EDGE / self.factor)) {
                *filled |= run.iter().fold(false, |any, &o| any | (o != EMPTY));
            }
        }
        filled
    }

    /// Fills the places of the bricks that have any occupied cell.
    #[inline(always)]
    fn pack<S: Spectrum>(&self, filled: &[bool], ordinal: &mut [u32], core: &mut [[S; 2]]) {
        let Self { medium, factor, .. } = *self;
        for (local, row) in self.rows() {
            let runs = row.chunks(EDGE / factor).zip(filled).filter(|&(_, &filled)| filled);
            for (brick, (run, _)) in runs.enumerate() {
                let first = brick * CELLS + local;
                for (i, &o) in run.iter().enumerate() {
                    if o == EMPTY {
                        continue;
                    }
                    let cell = cell(medium, o as usize);
                    // The copies of a cell lie side by side.
                    for x in 0..factor {
                        for y in 0..factor {
                            let from = first + (x * EDGE + y) * EDGE + i * factor;
                            ordinal[from..from + factor].fill(o);
                            core[from..from + factor].fill(cell);
                        }
                    }
                }
            }
        }
    }
}

/// Emission over extinction of the channels from 1 on, cell by cell of the medium.
fn sources<S: Spectrum>(medium: &GridMedium) -> Vec<S> {
    let (groups, extra) = (medium.groups, medium.channels - 1);
    let mut source = vec![S::ZERO; medium.occupied() * extra];
    if extra > 0 {
        let emission = medium.emission.par_chunks_exact(groups * medium.channels);
        source.par_chunks_exact_mut(extra).zip(emission).zip(medium.k_ext.par_chunks_exact(groups)).for_each(
            |((source, emission), k)| {
                for (to, emission) in source.iter_mut().zip(emission.chunks_exact(groups).skip(1)) {
                    *to = over(emission, k);
                }
            },
        );
    }
    source
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

/// Whether a place, given by its ordinal, is occupied.
pub(super) fn is_occupied(ordinal: u32) -> bool {
    ordinal != EMPTY
}

const _: () = assert!(NONE == EMPTY);
