//! Sums over the blocks of every brick at each size but the finest, made once: whatever merges cells reads these.

use super::bricks::EDGE;
use super::fine::{CELLS, Fine};
use super::spectrum::{Spectrum, vectorised};
use rayon::prelude::*;

/// Blocks along an edge at the finest size that is kept, and all blocks of all sizes.
const FINEST: usize = EDGE / 2;
const KEPT: usize = 1 + 8 + 64;

/// Where the blocks of 2^log along an edge begin.
const FIRST: [usize; 3] = [0, 1, 9];

/// Of every occupied brick the blocks of one, two and four along its edges.
pub(super) struct Pyramid<S> {
    blocks: Vec<[Block<S>; KEPT]>,
    /// What is scattered in every cell, in 1/m, all groups together: `[place]`.
    pub(super) scattering: Vec<f32>,
}

/// What is known of the cells in a block.
#[derive(Clone, Copy)]
pub(super) struct Block<S> {
    /// Sums of the extinction in 1/m and of its scattered part.
    pub(super) extinction: S,
    pub(super) scattering: S,
    /// Least and greatest of the cells' extinctions in the group that is largest there.
    pub(super) low: f32,
    pub(super) high: f32,
}

impl<S: Spectrum> Block<S> {
    const NOTHING: Self = Self { extinction: S::ZERO, scattering: S::ZERO, low: f32::INFINITY, high: 0.0 };

    #[inline(always)]
    fn and(self, other: Self) -> Self {
        Self {
            extinction: self.extinction.plus(other.extinction),
            scattering: self.scattering.plus(other.scattering),
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }
}

impl<S: Spectrum> Pyramid<S> {
    pub(super) fn new(fine: &Fine<S>) -> Self {
        let mut scattering = vec![0.0; fine.core.len()];
        let bricks = fine.core.par_chunks(CELLS).zip(scattering.par_chunks_mut(CELLS)).with_min_len(16);
        let blocks = bricks
            .map(|(cells, scattering)| {
                vectorised(
                    #[inline(always)]
                    || brick(cells, scattering),
                )
            })
            .collect();
        Self { blocks, scattering }
    }

    /// Blocks of 2^`log` along the edges of an occupied brick, given by its place among them; `log` at most 2.
    pub(super) fn blocks(&self, brick: usize, log: u32) -> &[Block<S>] {
        let log = log as usize;
        &self.blocks[brick][FIRST[log]..][..1 << (3 * log)]
    }
}

#[inline(always)]
fn brick<S: Spectrum>(cells: &[[S; 2]], scattered: &mut [f32]) -> [Block<S>; KEPT] {
    let mut kept = [Block::NOTHING; KEPT];
    for x in 0..EDGE {
        for y in 0..EDGE {
            let row = &cells[(x * EDGE + y) * EDGE..][..EDGE];
            let scattered = &mut scattered[(x * EDGE + y) * EDGE..][..EDGE];
            let to = &mut kept[FIRST[2] + ((x / 2) * FINEST + y / 2) * FINEST..][..FINEST];
            let pairs = row.chunks_exact(2).zip(scattered.chunks_exact_mut(2));
            for (block, (pair, scattered)) in to.iter_mut().zip(pairs) {
                for (&[k, albedo], scattered) in pair.iter().zip(scattered) {
                    let largest = k.largest();
                    let scattering = k.times(albedo);
                    *scattered = scattering.sum();
                    *block = block.and(Block { extinction: k, scattering, low: largest, high: largest });
                }
            }
        }
    }
    for log in [1, 0] {
        let n = 1 << log;
        for block in 0..n * n * n {
            let at = [block / (n * n), block / n % n, block % n].map(|i| 2 * i);
            let mut sum = Block::NOTHING;
            for corner in 0..8 {
                let [x, y, z] = [at[0] + (corner >> 2), at[1] + (corner >> 1 & 1), at[2] + (corner & 1)];
                sum = sum.and(kept[FIRST[log + 1] + (x * 2 * n + y) * 2 * n + z]);
            }
            kept[FIRST[log] + block] = sum;
        }
    }
    kept
}
