//! Where the leaves of a medium lie: their neighbours, depths, and the places in them at which light is scattered.

use super::bricks::{EDGE, EDGE_LOG, NONE};
use super::cache::{Leaves, owners};
use super::fine::{CELLS, Fine};
use super::pyramid::Pyramid;
use super::spectrum::{Spectrum, narrow};
use rayon::prelude::*;

/// The leaves of a medium and what lies beside each.
pub(super) struct Places<'a> {
    pub(super) leaves: &'a Leaves,
    /// The occupied brick of each leaf.
    pub(super) owner: Vec<u32>,
    pub(super) list: Vec<Place>,
    pub(super) channels: usize,
}

impl<'a> Places<'a> {
    /// `depths` as from [`depths`].
    pub(super) fn new<S: Spectrum>(
        pyramid: &Pyramid<S>,
        leaves: &'a Leaves,
        depths: &[f32],
        channels: usize,
    ) -> Self {
        let owner = owners(leaves);
        let list = places(pyramid, leaves, &owner, depths);
        Self { leaves, owner, list, channels }
    }

    /// Whether a leaf is a single cell, which cannot be cut.
    pub(super) fn is_cell(&self, leaf: usize) -> bool {
        self.list[leaf].edge == 1
    }
}

/// A leaf's six neighbours of its own size (−x, +x, −y, …) or [`NONE`], and what it is like.
pub(super) struct Place {
    pub(super) beside: [u32; 6],
    /// Optical depth of its edge, the mean over the groups.
    pub(super) depth: f32,
    /// Cells along its edge.
    pub(super) edge: usize,
    pub(super) centre: [f32; 3],
    /// Where in it light is scattered: mean offset from its centre in cells, and mean square.
    pub(super) offset: [f32; 3],
    pub(super) square: [f32; 3],
}

/// Centre of a leaf in cells.
pub(super) fn centre(leaves: &Leaves, brick: usize, leaf: usize) -> [f64; 3] {
    let b = leaves.bricks.list[brick];
    let (base, block, mask) = (leaves.bricks.at(brick), leaf - b.first as usize, (1_usize << b.log) - 1);
    let edge = EDGE >> b.log;
    let at = [block >> (2 * b.log), block >> b.log & mask, block & mask];
    [0, 1, 2].map(|a| real(base[a] * EDGE + at[a] * edge) + 0.5 * real(edge))
}

#[expect(clippy::cast_possible_truncation, reason = "leaf counts are below 2^32")]
fn places<S: Spectrum>(pyramid: &Pyramid<S>, leaves: &Leaves, owner: &[u32], depths: &[f32]) -> Vec<Place> {
    let bricks = &leaves.bricks;
    let size = narrow(bricks.size[0].max(bricks.size[1]).max(bricks.size[2]));
    owner
        .par_iter()
        .enumerate()
        .with_min_len(256)
        .map(|(leaf, &o)| {
            let b = leaves.occupied[o as usize];
            let edge = EDGE >> bricks.list[b].log;
            let middle = centre(leaves, b, leaf);
            let alike = |l: usize| bricks.list[leaves.occupied[owner[l] as usize]].log == bricks.list[b].log;
            let beside = [0, 1, 2, 3, 4, 5].map(|k: usize| {
                let mut at = middle;
                at[k / 2] += if k.is_multiple_of(2) { -1.0 } else { 1.0 } * 0.5 * (real(edge) + 1.0);
                leaf_at(leaves, at).filter(|&l| depths[l] > 0.0 && alike(l)).map_or(NONE, |l| l as u32)
            });
            let depth = depths[leaf] * size * narrow(real(edge));
            let [offset, square] = moments(pyramid, o as usize, leaf - bricks.list[b].first as usize, edge);
            Place { beside, depth, edge, centre: middle.map(narrow), offset, square }
        })
        .collect()
}

/// Mean offset from a leaf's centre at which light is scattered in it, and mean square, in cells; from parts of an eighth of
/// its volume at most. `block` is its number in the `i`-th occupied brick.
fn moments<S: Spectrum>(pyramid: &Pyramid<S>, i: usize, block: usize, edge: usize) -> [[f32; 3]; 2] {
    let even = [[0.0; 3], [narrow(real(edge * edge)) / 12.0; 3]];
    // Parts along its edge, and cells along theirs.
    let (parts, wide) = if edge > 2 { (edge / 2, 2) } else { (edge, 1) };
    if parts == 1 {
        return even;
    }
    let log = (EDGE / edge).trailing_zeros();
    let mask = (1_usize << log) - 1;
    let corner = [block >> (2 * log), block >> log & mask, block & mask].map(|c| c * parts);
    let finest = (EDGE / wide).trailing_zeros();
    let (mut sum, mut first, mut second) = (0.0_f32, [0.0_f32; 3], [0.0_f32; 3]);
    let weight = |[x, y, z]: [usize; 3]| {
        let place = x << (2 * finest) | y << finest | z;
        if wide == 1 {
            pyramid.scattering[i * CELLS + place]
        } else {
            pyramid.blocks(i, finest)[place].scattering.sum()
        }
    };
    for x in 0..parts {
        for y in 0..parts {
            for z in 0..parts {
                let weight = weight([corner[0] + x, corner[1] + y, corner[2] + z]);
                sum += weight;
                let at = [x, y, z]
                    .map(|c| (narrow(real(c)) + 0.5) * narrow(real(wide)) - 0.5 * narrow(real(edge)));
                for a in 0..3 {
                    first[a] += weight * at[a];
                    second[a] += weight * at[a] * at[a];
                }
            }
        }
    }
    if !(sum > 0.0 && sum.is_finite()) {
        return even;
    }
    let inside = narrow(real(wide * wide)) / 12.0;
    [first.map(|f| f / sum), second.map(|s| s / sum + inside)]
}

/// Mean extinction of every leaf over its volume in 1/m; zero where nothing is.
pub(super) fn depths<S: Spectrum>(fine: &Fine<S>, pyramid: &Pyramid<S>, leaves: &Leaves) -> Vec<f32> {
    let mut depths = Vec::with_capacity(leaves.demand.len());
    for (i, &b) in leaves.occupied.iter().enumerate() {
        let brick = leaves.bricks.list[b];
        let cells = narrow(real(CELLS / brick.blocks()) * real(fine.groups));
        if brick.log < EDGE_LOG {
            depths.extend(pyramid.blocks(i, brick.log).iter().map(|block| block.extinction.sum() / cells));
        } else {
            depths.extend(fine.core[i * CELLS..(i + 1) * CELLS].iter().map(|[k, _]| k.sum() / cells));
        }
    }
    depths
}

/// The leaves beside the faces of one in a brick; of smaller ones the four that touch the middle of the face.
pub(super) fn neighbours(leaves: &Leaves, brick: usize, leaf: usize) -> impl Iterator<Item = usize> {
    let middle = centre(leaves, brick, leaf);
    let edge = EDGE >> leaves.bricks.list[brick].log;
    let reach = 0.5 * (real(edge) + 1.0);
    (0..24_usize).filter_map(move |k| {
        let (axis, side) = (k / 8, k / 4 % 2);
        let mut at = middle;
        for (turn, other) in [(axis + 1) % 3, (axis + 2) % 3].into_iter().enumerate() {
            at[other] += if k >> turn & 1 == 0 { -0.25 } else { 0.25 };
        }
        at[axis] += if side == 0 { -reach } else { reach };
        leaf_at(leaves, at)
    })
}

/// The leaf at a place in cell units.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked against the box")]
pub(super) fn leaf_at(leaves: &Leaves, units: [f64; 3]) -> Option<usize> {
    let bricks = &leaves.bricks;
    if !(0..3).all(|a| units[a] >= 0.0 && units[a] < real(bricks.cells[a])) {
        return None;
    }
    let c = units.map(|u| u as usize);
    let b = c.map(|c| c / EDGE);
    let brick = bricks.list[(b[0] * bricks.count[1] + b[1]) * bricks.count[2] + b[2]];
    let c = c.map(|c| c % EDGE);
    (brick.first != NONE).then(|| brick.place(c[0], c[1], c[2]))
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
