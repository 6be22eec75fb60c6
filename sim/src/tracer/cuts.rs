//! How finely each brick is cut: for the leaves that share one estimate of in-scattered light, and for the blocks on
//! which paths march.
//!
//! Both follow the optical depth (the merge criterion of Villefranque et al., J. Adv. Model. Earth Syst. 11, 2449, 2019):
//! a block is what a path cannot tell from a uniform one.

use super::bricks::{Brick, Bricks, EDGE};
use super::fine::{CELLS, Fine};
use super::spectrum::{Spectrum, narrow};
use rayon::prelude::*;

/// What may be merged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Largest optical depth of a block's edge.
    pub(super) depth: f32,
    /// Largest difference of the optical depths of its edge at its thickest and its thinnest cell.
    pub(super) spread: f32,
}

/// Cuts every occupied brick into the largest blocks that keep the limits; blocks are numbered in the order of the bricks.
pub(super) fn cut<S: Spectrum>(fine: &Fine<S>, limits: Limits) -> Bricks {
    let size = fine.bricks.size;
    let edge = narrow(size[0].max(size[1]).max(size[2]));
    let logs: Vec<u32> = fine
        .core
        .par_chunks(CELLS)
        .map(|core| {
            let (mut low, mut high) = ([0.0_f32; CELLS], [0.0_f32; CELLS]);
            for (i, [k, _]) in core.iter().enumerate() {
                (low[i], high[i]) = (k.largest(), k.largest());
            }
            let mut log = 3;
            let mut blocks = EDGE;
            while blocks > 1 {
                // One level up: eight blocks become one.
                let half = blocks / 2;
                let length = edge * narrow(EDGE as f64 / half as f64);
                let mut good = true;
                for x in 0..half {
                    for y in 0..half {
                        for z in 0..half {
                            let (mut l, mut h) = (f32::INFINITY, 0.0_f32);
                            for i in 0..8 {
                                let at = ((2 * x + (i >> 2)) * blocks + 2 * y + (i >> 1 & 1)) * blocks
                                    + 2 * z
                                    + (i & 1);
                                (l, h) = (l.min(low[at]), h.max(high[at]));
                            }
                            good &= h * length <= limits.depth && (h - l) * length <= limits.spread;
                            // Never ahead of what is still to be read.
                            let to = (x * half + y) * half + z;
                            (low[to], high[to]) = (l, h);
                        }
                    }
                }
                if !good {
                    break;
                }
                log -= 1;
                blocks = half;
            }
            log
        })
        .collect();
    let mut bricks = fine.bricks.clone();
    let mut first = 0;
    for (&b, &log) in fine.occupied.iter().zip(&logs) {
        bricks.list[b] = Brick { first, log };
        first += 1 << (3 * log);
    }
    bricks
}
