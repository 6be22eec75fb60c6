//! How finely each brick is cut: for the leaves that share one estimate of in-scattered light, and for the blocks on
//! which paths march.
//!
//! Both follow the optical depth (the merge criterion of Villefranque et al., J. Adv. Model. Earth Syst. 11, 2449, 2019):
//! a block is what a path cannot tell from a uniform one.

use super::bricks::{Brick, Bricks, EDGE, EDGE_LOG};
use super::fine::Fine;
use super::pyramid::Pyramid;
use super::spectrum::{Spectrum, narrow};

/// What may be merged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Largest optical depth of a block's edge.
    pub(super) depth: f32,
    /// Largest difference of the optical depths of its edge at its thickest and its thinnest cell.
    pub(super) spread: f32,
}

/// Cuts every occupied brick into the largest blocks that keep the limits, blocks of half of which keep them too; they are
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
        bricks.list[b] = Brick { first, log };
        first += 1 << (3 * log);
    }
    bricks
}
