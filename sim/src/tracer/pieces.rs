//! In-scattered light of one spectral group as packets of sights read it: linear in pieces of the leaves.
//!
//! Inside a leaf the light is quadratic; a piece of half its edge keeps all but a quarter of the curvature in its own
//! mean and slopes. Leaves of one cell are cut no further: there only the slopes count, as the light bends by less than
//! its own error estimate inside them.

use super::bricks::{Brick, EDGE, EDGE_LOG};
use super::cache::Leaves;
use super::fine::Fine;
use super::places::centre;
use super::reconstruct::{InLeaf, Scattered};
use super::shares::ROWS;
use super::spectrum::{One, Spectrum, narrow};
use rayon::prelude::*;

/// Light by pieces.
pub(super) struct Pieces {
    /// The pieces of every brick of the box.
    pub(super) cuts: Vec<Brick>,
    /// Half the number of rows (plate, medium, and the channels from 1 on), rounded up.
    pub(super) pairs: usize,
    /// Value at `middle` and change per cell along x, y, z of two rows, `[piece · pairs + pair]`.
    pub(super) lines: Vec<[f32; 8]>,
    /// Noise and bias of the leaf, `[piece][noise, bias][row]`.
    pub(super) errors: Vec<[[f32; ROWS]; 2]>,
    /// Where values are given, in cells: near the middle of the box, against cancellation.
    pub(super) middle: [f32; 3],
}

impl Pieces {
    /// Cuts the leaves.
    pub(super) fn new(fine: &Fine<One>, scattered: &Scattered<One>, leaves: &Leaves) -> Self {
        let rows = 1 + fine.channels;
        let pairs = rows.div_ceil(2);
        let mut cuts = vec![Brick::EMPTY; fine.bricks.list.len()];
        let mut count = 0;
        let mut firsts = Vec::with_capacity(leaves.occupied.len());
        for &b in &leaves.occupied {
            let log = (leaves.bricks.list[b].log + 1).min(EDGE_LOG);
            cuts[b] = Brick { first: count, log };
            firsts.push(count as usize);
            count += 1 << (3 * log);
        }
        let middle = fine.bricks.cells.map(|n| 0.5 * real(n));
        let mut lines = vec![[0.0_f32; 8]; count as usize * pairs];
        let mut errors = vec![[[0.0_f32; ROWS]; 2]; count as usize];
        let mut jobs = Vec::with_capacity(leaves.occupied.len());
        let (mut lines_left, mut errors_left) = (lines.as_mut_slice(), errors.as_mut_slice());
        for &b in &leaves.occupied {
            let (l, rest) = lines_left.split_at_mut(cuts[b].blocks() * pairs);
            lines_left = rest;
            let (e, rest) = errors_left.split_at_mut(cuts[b].blocks());
            errors_left = rest;
            jobs.push((b, l, e));
        }
        jobs.into_par_iter().with_min_len(16).for_each(|(b, lines, errors)| {
            let leaf_cut = leaves.bricks.list[b];
            let log = cuts[b].log;
            let per_leaf = log - leaf_cut.log;
            let edge = real(EDGE >> log);
            let corner = leaves.bricks.at(b).map(|c| real(c * EDGE));
            let mask = (1_usize << log) - 1;
            for (piece, (lines, errors)) in lines.chunks_exact_mut(pairs).zip(errors).enumerate() {
                let at = [piece >> (2 * log), piece >> log & mask, piece & mask];
                let [x, y, z] = at.map(|i| i >> per_leaf);
                let leaf = leaf_cut.first as usize + (x << (2 * leaf_cut.log) | y << leaf_cut.log | z);
                let inside = &scattered.leaves[leaf];
                let here = [0, 1, 2].map(|a: usize| corner[a] + (real(at[a]) + 0.5) * edge);
                let from_leaf = centre(leaves, b, leaf);
                let offset = [0, 1, 2].map(|a: usize| narrow(here[a] - from_leaf[a]));
                let place = [0, 1, 2].map(|a: usize| here[a] - middle[a]);
                let leaf_edge = narrow(real(EDGE >> leaf_cut.log));
                let lines = lines.as_flattened_mut().as_chunks_mut().0;
                for (row, to) in lines[..ROWS].iter_mut().enumerate() {
                    *to = line(inside, row, offset, place, [narrow(edge), leaf_edge]);
                }
                for c in ROWS..rows {
                    let ratio = scattered.ratio[leaf * (rows - ROWS) + c - ROWS].get(0);
                    lines[c] = lines[1].map(|v| v * ratio);
                }
                *errors = [inside.noise.map(|v| v.get(0)), inside.bias.map(|v| v.get(0))];
            }
        });
        Self { cuts, pairs, lines, errors, middle: middle.map(narrow) }
    }
}

/// Value at the middle of the box and slopes of a piece at `offset` from its leaf's centre and `place` from the middle.
fn line(
    inside: &InLeaf<One>,
    row: usize,
    offset: [f32; 3],
    place: [f64; 3],
    [edge, leaf_edge]: [f32; 2],
) -> [f32; 4] {
    let share = &inside.share[row];
    let mut value = share[0].get(0);
    let mut slope = [0.0_f32; 3];
    for a in 0..3 {
        let (first, half) = (share[1 + a].get(0), share[4 + a].get(0));
        let x = offset[a];
        // The mean over the piece: x² there is offset² + edge²/12.
        let square = x * x + (edge * edge - leaf_edge * leaf_edge) / 12.0;
        value += first * x + half * square;
        slope[a] = 2.0 * half * x + first;
    }
    // Steep slopes must not make light negative.
    let value = value.max(0.0);
    let swing = 0.5 * edge * (slope[0].abs() + slope[1].abs() + slope[2].abs());
    let keep = if swing > value { value / swing } else { 1.0 };
    let slope = slope.map(|s| s * keep);
    let at_middle = f64::from(value) - (0..3).map(|a| f64::from(slope[a]) * place[a]).sum::<f64>();
    [narrow(at_middle), slope[0], slope[1], slope[2]]
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
