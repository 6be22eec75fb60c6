//! The medium as scattered paths read it: mean coefficients of blocks that are nearly uniform.

use super::bricks::{Bricks, EDGE};
use super::cuts::{Limits, cut};
use super::fine::{CELLS, Fine, is_occupied};
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
    pub(super) fn new(fine: &Fine<S>, limits: Limits) -> Self {
        Self::of(fine, cut(fine, limits))
    }

    /// The cells themselves.
    pub(super) fn cells(fine: &Fine<S>) -> Self {
        Self::of(fine, fine.bricks.clone())
    }

    fn of(fine: &Fine<S>, bricks: Bricks) -> Self {
        let extra = fine.channels - 1;
        let packed: Vec<(Vec<[S; 2]>, Vec<S>)> = fine
            .occupied
            .par_iter()
            .enumerate()
            .map(|(i, &b)| {
                vectorised(
                    #[inline(always)]
                    || brick(fine, &bricks, b, i * CELLS),
                )
            })
            .collect();
        let mut core = Vec::with_capacity(packed.iter().map(|p| p.0.len()).sum());
        let mut source = Vec::with_capacity(core.capacity() * extra);
        for (c, s) in packed {
            core.extend(c);
            source.extend(s);
        }
        Self { bricks, core, source, channels: fine.channels, groups: fine.groups }
    }
}

#[inline(always)]
fn brick<S: Spectrum>(fine: &Fine<S>, bricks: &Bricks, b: usize, first: usize) -> (Vec<[S; 2]>, Vec<S>) {
    let cut = bricks.list[b];
    let extra = fine.channels - 1;
    let (mut core, mut source) = (vec![[S::ZERO; 2]; cut.blocks()], vec![S::ZERO; cut.blocks() * extra]);
    let low = bricks.at(b).map(|c| c * EDGE);
    // Cells of the brick inside the box.
    let [nx, ny, nz] = [0, 1, 2].map(|a| EDGE.min(bricks.cells[a] - low[a]));
    let mut inside = vec![0_u32; cut.blocks()];
    for row in (0..nx).flat_map(|x| (0..ny).map(move |y| [x, y])) {
        let start = (row[0] * EDGE + row[1]) * EDGE;
        for z in 0..nz {
            let block = cut.place(row[0], row[1], z) - cut.first as usize;
            inside[block] += 1;
            let [k, albedo] = fine.core[first + start + z];
            core[block][0] = core[block][0].plus(k);
            core[block][1] = core[block][1].plus_product(k, albedo);
            if extra > 0 && is_occupied(fine.slot[first + start + z]) {
                let o = fine.slot[first + start + z] as usize;
                for c in 0..extra {
                    let to = &mut source[block * extra + c];
                    *to = to.plus_product(k, fine.source[o * extra + c]);
                }
            }
        }
    }
    for (block, [k, albedo]) in core.iter_mut().enumerate() {
        *albedo = albedo.over(*k);
        for s in &mut source[block * extra..(block + 1) * extra] {
            *s = s.over(*k);
        }
        *k = k.scaled(narrow(1.0 / f64::from(inside[block].max(1))));
    }
    (core, source)
}
