//! The medium as scattered paths read it: mean coefficients of blocks that are nearly uniform.

use super::bricks::{Bricks, EDGE, EDGE_LOG};
use super::cuts::{Limits, cut};
use super::fine::{CELLS, Fine, is_occupied};
use super::pyramid::Pyramid;
use super::spectrum::{Spectrum, narrow, vectorised};
use rayon::prelude::*;

/// Coefficients per block.
pub(super) struct Blocks<S> {
    pub(super) bricks: Bricks,
    /// Extinction in 1/m and albedo, `[place]`.
    pub(super) core: Vec<[S; 2]>,
    /// Emission coefficient over extinction of the channels from 1 on, `[place · (channels − 1) + channel − 1]`.
    pub(super) source: Vec<S>,
    pub(super) channels: usize,
    pub(super) groups: usize,
}

impl<S: Spectrum> Blocks<S> {
    /// Averages the cells of blocks within the limits.
    pub(super) fn new(fine: &Fine<S>, pyramid: &Pyramid<S>, limits: Limits) -> Self {
        Self::of(fine, Some(pyramid), cut(fine, pyramid, limits))
    }

    /// The cells themselves.
    pub(super) fn cells(fine: &Fine<S>) -> Self {
        Self::of(fine, None, fine.bricks.clone())
    }

    /// Without a pyramid blocks are cells.
    fn of(fine: &Fine<S>, pyramid: Option<&Pyramid<S>>, bricks: Bricks) -> Self {
        let count = fine.occupied.iter().map(|&b| bricks.list[b].blocks()).sum();
        let extra = fine.channels - 1;
        let mut core = vec![[S::ZERO; 2]; count];
        let mut source = vec![S::ZERO; count * extra];
        let (mut cores, mut sources) = (core.as_mut_slice(), source.as_mut_slice());
        let mut jobs = Vec::with_capacity(fine.occupied.len());
        for (i, &b) in fine.occupied.iter().enumerate() {
            let blocks = bricks.list[b].blocks();
            let to = (take(&mut cores, blocks), take(&mut sources, blocks * extra));
            jobs.push((i, b, to));
        }
        jobs.into_par_iter().with_min_len(16).for_each(|(i, b, (core, source))| {
            let cells = &fine.core[i * CELLS..(i + 1) * CELLS];
            match pyramid.filter(|_| bricks.list[b].log < EDGE_LOG) {
                Some(pyramid) => average(pyramid, &bricks, i, b, core),
                None => core.copy_from_slice(cells),
            }
            if extra > 0 {
                vectorised(
                    #[inline(always)]
                    || sources_of(fine, &bricks, [b, i * CELLS], core, source),
                );
            }
        });
        Self { bricks, core, source, channels: fine.channels, groups: fine.groups }
    }
}

/// Takes the first `n` of what is left.
fn take<'a, T>(left: &mut &'a mut [T], n: usize) -> &'a mut [T] {
    let (first, rest) = std::mem::take(left).split_at_mut(n);
    *left = rest;
    first
}

/// Mean extinction and albedo of the blocks of the `i`-th occupied brick, number `b` of all; cells beyond the box do not
/// count.
fn average<S: Spectrum>(pyramid: &Pyramid<S>, bricks: &Bricks, i: usize, b: usize, core: &mut [[S; 2]]) {
    let log = bricks.list[b].log;
    let (low, edge, mask) = (bricks.at(b).map(|c| c * EDGE), EDGE >> log, (1 << log) - 1);
    for (n, (block, to)) in pyramid.blocks(i, log).iter().zip(core).enumerate() {
        let at = [n >> (2 * log), n >> log & mask, n & mask];
        let inside = [0, 1, 2].map(|a: usize| {
            let from = low[a] + at[a] * edge;
            edge.min(bricks.cells[a].saturating_sub(from))
        });
        let cells = inside[0] * inside[1] * inside[2];
        let mean = block.extinction.scaled(narrow(1.0 / real(cells.max(1))));
        *to = [mean, block.scattering.over(block.extinction)];
    }
}

/// Emission coefficient over extinction of the channels from 1 on, of the blocks of a brick whose cells begin at a place.
#[inline(always)]
fn sources_of<S: Spectrum>(
    fine: &Fine<S>,
    bricks: &Bricks,
    [b, first]: [usize; 2],
    core: &[[S; 2]],
    source: &mut [S],
) {
    let cut = bricks.list[b];
    let extra = fine.channels - 1;
    let mut sums = vec![S::ZERO; core.len()];
    for cell in 0..CELLS {
        let ordinal = fine.ordinal[first + cell];
        if !is_occupied(ordinal) {
            continue;
        }
        let block = cut.place(cell / (EDGE * EDGE), cell / EDGE % EDGE, cell % EDGE) - cut.first as usize;
        let k = fine.core[first + cell][0];
        sums[block] = sums[block].plus(k);
        let o = ordinal as usize;
        let each = source[block * extra..].iter_mut().zip(&fine.source[o * extra..(o + 1) * extra]);
        for (to, from) in each {
            *to = to.plus_product(k, *from);
        }
    }
    for (sum, source) in sums.iter().zip(source.chunks_exact_mut(extra)) {
        source.iter_mut().for_each(|s| *s = s.over(*sum));
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
