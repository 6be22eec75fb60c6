//! How finely each brick is cut: for the leaves that share one estimate of in-scattered light, and for the blocks on
//! which paths march.
//!
//! Both follow the optical depth (the merge criterion of Villefranque et al., J. Adv. Model. Earth Syst. 11, 2449, 2019):
//! a block is what a path cannot tell from a uniform one.

use super::bricks::{Brick, Bricks, EDGE, EDGE_LOG, NONE};
use super::fine::{CELLS, Fine};
use super::pyramid::Pyramid;
use super::spectrum::{Spectrum, narrow};

/// What may be merged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Largest optical depth of a block's edge.
    pub(super) depth: f32,
    /// Largest difference of the optical depths of its edge at its thickest and its thinnest cell.
    pub(super) spread: f32,
    /// Optical depth of what scatters along the edge of a block from which on it must not lie alone, see [`cut`].
    pub(super) alone: f32,
}

/// Part of a brick's extinction in blocks that lie alone from which on it is cut once more.
const ALONE_PART: f32 = 0.25;

/// Cuts every occupied brick into the largest blocks that keep the limits, blocks of half of which keep them too, and once
/// more where blocks lie alone: with nothing to both sides along an axis, nothing tells how light changes inside. They are
/// numbered in the order of the bricks.
pub(super) fn cut<S: Spectrum>(fine: &Fine<S>, pyramid: &Pyramid<S>, limits: Limits) -> Bricks {
    let size = fine.bricks.size;
    let edge = narrow(size[0].max(size[1]).max(size[2]));
    let mut bricks = fine.bricks.clone();
    let mut first = 0;
    for (i, &b) in fine.occupied.iter().enumerate() {
        let mut log = EDGE_LOG;
        while log > 0 {
            let length = edge * narrow((EDGE >> (log - 1)) as f64);
            let mut good = true;
            for block in pyramid.blocks(i, log - 1) {
                good &= block.high * length <= limits.depth;
                good &= (block.high - block.low) * length <= limits.spread;
            }
            if !good {
                break;
            }
            log -= 1;
        }
        if limits.alone < f32::INFINITY && log < EDGE_LOG && alone(fine, pyramid, i, log, edge, limits.alone)
        {
            log += 1;
        }
        bricks.list[b] = Brick { first, log };
        first += 1 << (3 * log);
    }
    bricks
}

/// Whether much of a brick, the `i`-th occupied one, lies alone in blocks of 2^`log` along its edges, `size` being a cell's.
fn alone<S: Spectrum>(
    fine: &Fine<S>,
    pyramid: &Pyramid<S>,
    i: usize,
    log: u32,
    size: f32,
    limit: f32,
) -> bool {
    let (n, bricks) = (1_usize << log, &fine.bricks);
    let base = bricks.at(fine.occupied[i]);
    let length = size * narrow((EDGE >> log) as f64) / narrow(fine.groups as f64);
    // Whether anything is in a block, given by its place in the grid of such blocks.
    let filled = |at: [Option<usize>; 3]| {
        let [Some(x), Some(y), Some(z)] = at else { return false };
        let brick = [x / n, y / n, z / n];
        if (0..3).any(|a| brick[a] >= bricks.count[a]) {
            return false;
        }
        let first = bricks.list[(brick[0] * bricks.count[1] + brick[1]) * bricks.count[2] + brick[2]].first;
        let block = ((x % n) * n + y % n) * n + z % n;
        first != NONE && pyramid.blocks(first as usize / CELLS, log)[block].high > 0.0
    };
    let (mut lonely, mut all) = (0.0, 0.0);
    for (block, sums) in pyramid.blocks(i, log).iter().enumerate() {
        if sums.high <= 0.0 {
            continue;
        }
        let extinction = sums.extinction.sum();
        all += extinction;
        let cells = narrow((CELLS >> (3 * log)) as f64);
        if sums.scattering.sum() / cells * length <= limit {
            continue;
        }
        let local = [block >> (2 * log), block >> log & (n - 1), block & (n - 1)];
        let beside = |axis: usize, up: bool| {
            filled([0, 1, 2].map(|a| {
                let at = base[a] * n + local[a];
                match (a == axis, up) {
                    (false, _) => Some(at),
                    (true, true) => Some(at + 1),
                    (true, false) => at.checked_sub(1),
                }
            }))
        };
        if (0..3).any(|axis| !beside(axis, false) && !beside(axis, true)) {
            lonely += extinction;
        }
    }
    lonely > ALONE_PART * all
}
