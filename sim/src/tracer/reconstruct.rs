//! From the sums of the leaves to in-scattered light anywhere in the medium: shares of plate, walls and medium, mixed
//! with those of neighbouring leaves as far as noise outweighs their difference, and quadratic inside each leaf.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over axes and rows step through several arrays at once"
)]

use super::bricks::{EDGE, EDGE_LOG, NONE};
use super::cache::{Cache, Leaves, owners};
use super::chamber::SIDES;
use super::fine::{CELLS, Fine};
use super::pyramid::Pyramid;
use super::sobol::hash;
use super::spectrum::{Spectrum, narrow};
use rayon::prelude::*;

/// Plate and medium (channel 0): the shares that are reconstructed; walls follow.
pub(super) const ROWS: usize = 2;

/// Mean, three slopes, three halves of second derivatives.
pub(super) const TERMS: usize = 7;

/// Share of a second difference between leaves that is taken for lost inside one, rms along one axis: a quadratic
/// function keeps most of it where the light is smooth.
const LOST_SMOOTH: f32 = 0.3 / 24.0;

/// The same of its difference from those of the leaves beside it: across a step of the extinction light has a kink, at
/// which two leaves bend and the next ones do not, and a quadratic function through their means is wrong by up to 1.7/24 of
/// the bend, which is twice this difference; less where sights cross the kink. Found by comparison with pixels traced one
/// by one: declared errors of blocky and of smooth sprays are 1 to 1.5 times the true ones.
const LOST_KINK: f32 = 2.4 / 24.0;

/// Variance that the bias estimate gets from noise, over the noise's own: 1.2 where all six neighbours of every leaf are as
/// large as it, less where they are not or are mixed.
const BIAS_NOISE: f32 = 1.1;

/// Rounds of mixing at most; each reaches one leaf further.
const ROUNDS_MAX: usize = 2;

/// Mixing that would move nobody by more than this part towards its neighbours is left out.
const MIX_MIN: f64 = 0.02;

/// Standard errors by which the difference between neighbours is taken for larger than it seems.
const CAUTION: f32 = 2.0;

/// Decay of the exchange between neighbours per optical depth of a leaf: over a mean free path the source function
/// changes by itself.
const DECAY: f32 = 2.0;

/// Boxes as large as itself that a leaf looks past where nothing is, for one that tells how light changes.
const FAR: usize = 4;

/// What light changes by inside a leaf whose neighbours tell nothing, rms over its own value and per optical depth: light
/// scattered in lumps that stand apart, compared with pixels traced one by one.
const UNTOLD: f32 = 0.15;

/// Least distance between the places that stand for two leaves, in edges: those places may lie side by side.
const CLOSE: f32 = 0.25;

/// What scattering adds to the sights inside each leaf.
pub(super) struct Scattered<S> {
    /// `[leaf]`.
    pub(super) leaves: Vec<InLeaf<S>>,
    /// Other channels over channel 0, `[leaf · (channels − 1) + channel − 1]`.
    pub(super) ratio: Vec<S>,
    /// The walls' shares by pairs of walls, the rows being the lower and the upper one: `[axis][leaf]`; empty unless
    /// walls are told apart.
    pub(super) sides: Vec<Vec<InLeaf<S>>>,
}

/// In-scattered light in one leaf; rows are plate and medium.
#[derive(Clone, Copy)]
pub(super) struct InLeaf<S> {
    /// Mean share, its change per cell along x, y, z, and half its second change, `[row][7]`: at an offset of x cells from
    /// the centre, an axis adds slope · x + half · (x² − edge²/12).
    pub(super) share: [[S; TERMS]; ROWS],
    /// Half the difference of the two halves of the paths.
    pub(super) noise: [S; ROWS],
    /// How far mixing and interpolation bend the shares: an estimate of what no number of paths mends, and of noise, see
    /// [`pure_bias`].
    pub(super) bias: [S; ROWS],
}

/// Shares of plate and medium in one leaf: of all its paths, and of each half of them.
type Shares<S> = [[S; ROWS]; 3];

/// A leaf's six neighbours of its own size (−x, +x, −y, …) or [`NONE`], and how much they may exchange.
struct Place {
    beside: [u32; 6],
    open: f32,
    /// Optical depth of its edge, the mean over the groups.
    depth: f32,
    /// Cells along its edge.
    edge: usize,
    centre: [f32; 3],
    /// Where in it light is scattered: mean offset from its centre in cells, and mean square.
    offset: [f32; 3],
    square: [f32; 3],
}

/// Centre of a leaf in cells.
pub(super) fn centre(leaves: &Leaves, brick: usize, leaf: usize) -> [f64; 3] {
    let b = leaves.bricks.list[brick];
    let (base, block, mask) = (leaves.bricks.at(brick), leaf - b.first as usize, (1_usize << b.log) - 1);
    let edge = EDGE >> b.log;
    let at = [block >> (2 * b.log), block >> b.log & mask, block & mask];
    [0, 1, 2].map(|a| real(base[a] * EDGE + at[a] * edge) + 0.5 * real(edge))
}

/// The square of the bias without what noise adds to it, from mean squares of noise and bias over many sights.
pub(super) fn pure_bias(noise: f32, bias: f32) -> f32 {
    (bias - BIAS_NOISE * noise).max(0.0)
}

/// The leaves of a medium and what lies beside each.
pub(super) struct Places<'a> {
    leaves: &'a Leaves,
    /// The occupied brick of each leaf.
    owner: Vec<u32>,
    list: Vec<Place>,
    channels: usize,
}

impl<'a> Places<'a> {
    /// `depths` as from [`depths`].
    pub(super) fn new<S: Spectrum>(
        fine: &Fine<S>,
        pyramid: &Pyramid<S>,
        leaves: &'a Leaves,
        depths: &[f32],
    ) -> Self {
        let owner = owners(leaves);
        let list = places(fine, pyramid, leaves, &owner, depths);
        Self { leaves, owner, list, channels: fine.channels }
    }

    /// Whether a leaf is a single cell, which cannot be cut.
    pub(super) fn is_cell(&self, leaf: usize) -> bool {
        self.list[leaf].edge == 1
    }
}

/// The source function of every leaf from the cache's sums.
pub(super) fn reconstruct<S: Spectrum>(places: &Places<'_>, cache: &Cache<S>) -> Scattered<S> {
    let Places { leaves, owner, list, channels } = places;
    let of = |shares: Vec<Shares<S>>| shaped(leaves, owner, list, shares, &cache.paths);
    let shares = cache.halves.par_iter().with_min_len(256).map(shares).collect();
    let sides = (0..if cache.sides.is_empty() { 0 } else { SIDES / 2 })
        .map(|axis| {
            let both = cache.halves.par_iter().zip(&cache.sides).with_min_len(256);
            of(both.map(|(halves, sides)| side_shares(halves, sides, axis)).collect())
        })
        .collect();
    Scattered { leaves: of(shares), ratio: ratios(channels - 1, list, cache), sides }
}

/// Shares of two kinds of light, mixed between leaves and given a shape inside each.
fn shaped<S: Spectrum>(
    leaves: &Leaves,
    owner: &[u32],
    places: &[Place],
    mut shares: Vec<Shares<S>>,
    paths: &[u32],
) -> Vec<InLeaf<S>> {
    let mut counts: Vec<f32> = paths.par_iter().map(|&n| narrow(f64::from(n))).collect();
    let unknown: Vec<bool> = counts.iter().map(|&c| c <= 0.0).collect();
    let spread = fill(owner, leaves.occupied.len(), &mut shares, &counts);
    let mut mixed_by = vec![0.0_f32; shares.len()];
    for _ in 0..ROUNDS_MAX {
        let strength = strengths(owner, places, &shares, &counts);
        let parts: Vec<f32> = places
            .iter()
            .zip(counts.iter().zip(owner))
            .map(|(place, (count, &o))| {
                let alpha = strength[o as usize] * place.open;
                if alpha > 0.0 { alpha / (alpha + count) } else { 0.0 }
            })
            .collect();
        let (mut moved, mut all) = (0.0_f64, 0.0_f64);
        for (part, demand) in parts.iter().zip(&leaves.demand) {
            moved += f64::from(part * demand);
            all += f64::from(*demand);
        }
        if moved < MIX_MIN * all {
            break;
        }
        let next: Vec<(Shares<S>, f32)> = (0..shares.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|leaf| mix(leaf, &places[leaf].beside, &shares, &counts, parts[leaf]))
            .collect();
        for (leaf, (value, count)) in next.into_iter().enumerate() {
            mixed_by[leaf] = 1.0 - (1.0 - mixed_by[leaf]) * (1.0 - parts[leaf]);
            shares[leaf] = value;
            counts[leaf] = count;
        }
    }
    let empty = InLeaf { share: [[S::ZERO; TERMS]; ROWS], noise: [S::ZERO; ROWS], bias: [S::ZERO; ROWS] };
    let mut known =
        Known { leaves, places, shares: &shares, counts: &counts, done: vec![empty; shares.len()] };
    // Large leaves first: small ones beside them look at their slopes.
    for log in 0..=EDGE_LOG {
        let edge = EDGE >> log;
        let found: Vec<(usize, InLeaf<S>)> = (0..shares.len())
            .into_par_iter()
            .with_min_len(256)
            .filter(|&leaf| places[leaf].edge == edge)
            .map(|leaf| (leaf, known.shape(leaf, mixed_by[leaf])))
            .collect();
        for (leaf, shape) in found {
            known.done[leaf] = shape;
        }
    }
    let found = known.done.par_iter().zip(places).with_min_len(256);
    let lost: Vec<[S; ROWS]> = found.map(|(leaf, place)| lost(leaf, place, &known.done)).collect();
    for (i, (leaf, lost)) in known.done.iter_mut().zip(lost).enumerate() {
        leaf.bias = [0, 1].map(|row: usize| leaf.bias[row].plus(lost[row]));
        if unknown[i] {
            // It may be as far from the mean that it was given as any other, until paths tell.
            leaf.noise = [0, 1].map(|row: usize| leaf.noise[row].plus(spread[row].scaled(1.0 - mixed_by[i])));
        }
    }
    known.done
}

/// What a quadratic function misses inside a leaf.
fn lost<S: Spectrum>(leaf: &InLeaf<S>, place: &Place, all: &[InLeaf<S>]) -> [S; ROWS] {
    let mut lost = [S::ZERO; ROWS];
    let edge = narrow(real(place.edge));
    for axis in 0..3 {
        let beside = [place.beside[2 * axis], place.beside[2 * axis + 1]];
        for row in 0..ROWS {
            let bend = |leaf: &InLeaf<S>| leaf.share[row][4 + axis].scaled(2.0 * edge * edge);
            let own = bend(leaf);
            let (mut others, mut count) = (S::ZERO, 0.0_f32);
            for &b in beside.iter().filter(|&&b| b != NONE) {
                others = others.plus(bend(&all[b as usize]));
                count += 1.0;
            }
            let kink = if count > 0.0 { own.minus(others.scaled(1.0 / count)) } else { own };
            lost[row] = lost[row].plus(kink.scaled(LOST_KINK)).plus(own.scaled(LOST_SMOOTH));
        }
    }
    lost
}

#[expect(clippy::cast_possible_truncation, reason = "leaf counts are below 2^32")]
fn places<S: Spectrum>(
    fine: &Fine<S>,
    pyramid: &Pyramid<S>,
    leaves: &Leaves,
    owner: &[u32],
    depths: &[f32],
) -> Vec<Place> {
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
            let open = (-DECAY * depth).exp();
            let [offset, square] =
                moments(fine, pyramid, o as usize, leaf - bricks.list[b].first as usize, edge);
            Place { beside, open, depth, edge, centre: middle.map(narrow), offset, square }
        })
        .collect()
}

/// Mean offset from a leaf's centre at which light is scattered in it, and mean square, in cells; from parts of an eighth of
/// its volume at most. `block` is its number in the `i`-th occupied brick.
fn moments<S: Spectrum>(
    fine: &Fine<S>,
    pyramid: &Pyramid<S>,
    i: usize,
    block: usize,
    edge: usize,
) -> [[f32; 3]; 2] {
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
            let [k, albedo] = fine.core[i * CELLS + place];
            k.times(albedo).sum()
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
fn leaf_at(leaves: &Leaves, units: [f64; 3]) -> Option<usize> {
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

/// Plate and medium divided by plate + walls + medium: of both halves together, and of each.
fn shares<S: Spectrum>(halves: &[[S; 3]; 2]) -> Shares<S> {
    let divide = |sums: [S; 3]| {
        let total = sums[0].plus(sums[1]).plus(sums[2]);
        [sums[0].over(total), sums[2].over(total)]
    };
    let both = [0, 1, 2].map(|k: usize| halves[0][k].plus(halves[1][k]));
    let whole = divide(both);
    let half = |h: usize| {
        let sum = halves[h][0].plus(halves[h][1]).plus(halves[h][2]).sum();
        if sum > 0.0 { divide(halves[h]) } else { whole }
    };
    [whole, half(0), half(1)]
}

/// Light from the two walls across an axis divided by plate + walls + medium, as [`shares`].
fn side_shares<S: Spectrum>(halves: &[[S; 3]; 2], sides: &[[S; SIDES]; 2], axis: usize) -> Shares<S> {
    let total = [0, 1].map(|h: usize| halves[h][0].plus(halves[h][1]).plus(halves[h][2]));
    let pair = [0, 1].map(|h: usize| [sides[h][2 * axis], sides[h][2 * axis + 1]]);
    let whole = [0, 1].map(|row: usize| pair[0][row].plus(pair[1][row]).over(total[0].plus(total[1])));
    let half = |h: usize| if total[h].sum() > 0.0 { pair[h].map(|side| side.over(total[h])) } else { whole };
    [whole, half(0), half(1)]
}

/// Gives leaves without paths the mean of their brick, or of all; the standard deviation of those that have some.
fn fill<S: Spectrum>(owner: &[u32], bricks: usize, shares: &mut [Shares<S>], counts: &[f32]) -> [S; ROWS] {
    let zero = [[S::ZERO; ROWS]; 3];
    let add = |to: &mut Shares<S>, from: &Shares<S>, weight: f32| {
        for k in 0..3 {
            for row in 0..ROWS {
                to[k][row] = to[k][row].plus(from[k][row].scaled(weight));
            }
        }
    };
    let mut sums = vec![(zero, 0.0_f32); bricks];
    let mut all = (zero, 0.0_f32);
    for (leaf, &o) in owner.iter().enumerate() {
        if counts[leaf] > 0.0 {
            let sum = &mut sums[o as usize];
            add(&mut sum.0, &shares[leaf], counts[leaf]);
            sum.1 += counts[leaf];
        }
    }
    for (sum, count) in &sums {
        add(&mut all.0, sum, 1.0);
        all.1 += count;
    }
    for (leaf, &o) in owner.iter().enumerate() {
        if counts[leaf] <= 0.0 {
            let (sum, count) = if sums[o as usize].1 > 0.0 { &sums[o as usize] } else { &all };
            let mut value = zero;
            add(&mut value, sum, if *count > 0.0 { 1.0 / count } else { 0.0 });
            shares[leaf] = value;
        }
    }
    let mut square = [S::ZERO; ROWS];
    let per_path = if all.1 > 0.0 { 1.0 / all.1 } else { 0.0 };
    for (share, &count) in shares.iter().zip(counts) {
        for row in 0..ROWS {
            let apart = share[0][row].minus(all.0[0][row].scaled(per_path));
            square[row] = square[row].plus(apart.times(apart).scaled(count * per_path));
        }
    }
    square.map(|s| S::ZERO.signed_hypot(s))
}

/// How many paths the mean of the neighbours is worth, for the leaves of each brick: the variance of one path over the
/// squared difference between a leaf and its neighbours that is not noise (the product of the differences in the two
/// independent halves), at the upper end of its uncertainty, so that few leaves mix little.
fn strengths<S: Spectrum>(owner: &[u32], places: &[Place], shares: &[Shares<S>], counts: &[f32]) -> Vec<f32> {
    let bricks = owner.last().map_or(0, |&o| o as usize + 1);
    let mut first = vec![0_usize; bricks + 1];
    for &o in owner {
        first[o as usize + 1] += 1;
    }
    for b in 0..bricks {
        first[b + 1] += first[b];
    }
    (0..bricks)
        .into_par_iter()
        .with_min_len(8)
        .map(|b| {
            let (mut noise, mut apart, mut square, mut number) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
            for leaf in first[b]..first[b + 1] {
                let (sum, n) = mean_beside(&places[leaf].beside, shares, counts);
                if n <= 0.0 || counts[leaf] <= 0.0 {
                    continue;
                }
                let own = &shares[leaf];
                let (mut half, mut product) = (0.0, 0.0);
                for row in 0..ROWS {
                    let differ = own[1][row].minus(own[2][row]);
                    half += differ.times(differ).sum();
                    let [x, y] = [1, 2].map(|h: usize| own[h][row].minus(sum[h][row].scaled(1.0 / n)));
                    product += x.times(y).sum();
                }
                noise += 0.25 * half * counts[leaf];
                apart += product;
                square += product * product;
                number += 1.0;
            }
            let upper = apart + CAUTION * square.sqrt();
            if number > 0.0 && noise > 0.0 { (noise / upper.max(1e-3 * noise)).max(0.0) } else { 0.0 }
        })
        .collect()
}

/// Sum of the neighbours' shares, pair by pair weighted by their paths (at least a little), and the weights' sum.
fn mean_beside<S: Spectrum>(beside: &[u32; 6], shares: &[Shares<S>], counts: &[f32]) -> (Shares<S>, f32) {
    let mut sum = [[S::ZERO; ROWS]; 3];
    let mut total = 0.0;
    for pair in beside.chunks_exact(2) {
        // Both sides with one weight, so that what rises from one to the other cancels.
        if pair[0] == NONE || pair[1] == NONE {
            continue;
        }
        let [low, high] = [pair[0] as usize, pair[1] as usize];
        let weight = 2.0 / (1.0 / counts[low].max(1e-3) + 1.0 / counts[high].max(1e-3));
        total += 2.0 * weight;
        for k in 0..3 {
            for row in 0..ROWS {
                let both = shares[low][k][row].plus(shares[high][k][row]);
                sum[k][row] = sum[k][row].plus(both.scaled(weight));
            }
        }
    }
    (sum, total)
}

/// A leaf moved by `part` towards the mean of its neighbours; and how many paths it is worth then.
fn mix<S: Spectrum>(
    leaf: usize,
    beside: &[u32; 6],
    shares: &[Shares<S>],
    counts: &[f32],
    part: f32,
) -> (Shares<S>, f32) {
    let (sum, total) = mean_beside(beside, shares, counts);
    if total <= 0.0 || part <= 0.0 {
        return (shares[leaf], counts[leaf]);
    }
    let mut out = shares[leaf];
    for k in 0..3 {
        for row in 0..ROWS {
            out[k][row] = out[k][row].scaled(1.0 - part).plus(sum[k][row].scaled(part / total));
        }
    }
    let variance = (1.0 - part) * (1.0 - part) / counts[leaf].max(1e-3) + part * part / total;
    (out, if variance > 0.0 { 1.0 / variance } else { counts[leaf] })
}

/// What is known of the leaves while their shapes are found.
struct Known<'a, S> {
    leaves: &'a Leaves,
    places: &'a [Place],
    shares: &'a [Shares<S>],
    counts: &'a [f32],
    /// Shapes of the leaves larger than those in work.
    done: Vec<InLeaf<S>>,
}

impl<S: Spectrum> Known<'_, S> {
    /// Mean, slopes and curvatures of a leaf's shares, and how far they may be bent.
    fn shape(&self, leaf: usize, mixed: f32) -> InLeaf<S> {
        let own = &self.shares[leaf];
        let edge = narrow(real(self.places[leaf].edge));
        let mut share = [[S::ZERO; TERMS]; ROWS];
        let mut bias = [S::ZERO; ROWS];
        let mut wobble = [S::ZERO; ROWS];
        let (mut around, mut count, mut untold) = ([S::ZERO; ROWS], 0.0, 0.0_f32);
        for row in 0..ROWS {
            share[row][0] = own[0][row];
        }
        for axis in 0..3 {
            let [low, high] = [-1.0, 1.0].map(|side| self.beside(leaf, axis, side));
            if low.is_none() && high.is_none() {
                untold += 1.0;
            }
            let here = self.places[leaf].offset[axis];
            // From where light is scattered in one leaf to where it is in the next.
            let [before, behind] = [(&low, -1.0), (&high, 1.0)].map(|(other, side)| match other {
                Some((_, there)) => (edge + side * (there - here)).max(CLOSE * edge),
                None => 0.0,
            });
            let distance = if low.is_some() || high.is_some() { before + behind } else { edge };
            let [low, high] = [low, high].map(|other| other.map(|(shares, _)| shares));
            let (from, to) = (low.as_ref().unwrap_or(own), high.as_ref().unwrap_or(own));
            for row in 0..ROWS {
                let differ = to[1][row].minus(from[1][row]).minus(to[2][row].minus(from[2][row]));
                let differ = differ.scaled(0.5 / distance);
                wobble[row] = wobble[row].plus(differ.times(differ));
                let mut slope = to[0][row].minus(from[0][row]).scaled(1.0 / distance);
                if low.is_some() && high.is_some() {
                    let rise = to[0][row].minus(own[0][row]).scaled(1.0 / behind);
                    let past = own[0][row].minus(from[0][row]).scaled(1.0 / before);
                    let half = rise.minus(past).scaled(1.0 / distance);
                    share[row][4 + axis] = half;
                    // The slope where light is scattered here is that at the leaf's centre a little later.
                    slope = slope.plus(half.scaled(before - behind - 2.0 * here));
                }
                share[row][1 + axis] = slope;
                for other in [&low, &high].into_iter().flatten() {
                    around[row] = around[row].plus(other[0][row]);
                }
            }
            count += f32::from(u8::from(low.is_some()) + u8::from(high.is_some()));
        }
        // The mean is that of the places where light is scattered.
        let place = &self.places[leaf];
        for row in &mut share {
            for a in 0..3 {
                let bent = place.square[a] - edge * edge / 12.0;
                row[0] = row[0].minus(row[1 + a].scaled(place.offset[a])).minus(row[4 + a].scaled(bent));
            }
        }
        if count > 0.0 {
            for row in 0..ROWS {
                let moved = around[row].scaled(1.0 / count).minus(own[0][row]);
                bias[row] = bias[row].plus(moved.scaled(mixed));
            }
        }
        if untold > 0.0 {
            // To either side: leaves that stand apart do not err together.
            let side = if hash(u32::try_from(leaf).unwrap_or(u32::MAX)) & 1 == 0 { 1.0 } else { -1.0 };
            let part = side * UNTOLD * place.depth.min(1.0) * untold.sqrt();
            for row in 0..ROWS {
                bias[row] = bias[row].plus(own[0][row].scaled(part));
            }
        }
        let noise = [0, 1].map(|row: usize| {
            // Slopes carry noise of their own, which counts by the distance from the centre (1/12 of the edge squared).
            let half = own[1][row].minus(own[2][row]).scaled(0.5);
            half.signed_hypot(wobble[row].scaled(edge * edge / 12.0))
        });
        InLeaf { share, noise, bias }
    }

    /// Shares of the nearest box as large as the leaf in the direction of one of its faces of which anything is known, at
    /// most [`FAR`] of them away; and where along the axis they are meant, from the centre of the one beside the face.
    fn beside(&self, leaf: usize, axis: usize, side: f64) -> Option<(Shares<S>, f32)> {
        let place = &self.places[leaf];
        let edge = real(place.edge);
        (1..=FAR).find_map(|step| {
            let mut middle = place.centre.map(f64::from);
            middle[axis] += side * edge * real(step);
            let (shares, offset) = self.around(middle, place.edge, axis)?;
            Some((shares, offset + narrow(side * edge * real(step - 1))))
        })
    }

    /// Shares of a box of an edge: those of the leaf there, of a larger one at the box's centre, or the mean of smaller
    /// ones; and where from the box's centre they are meant, along an axis. A leaf without paths knows nothing of its own.
    fn around(&self, middle: [f64; 3], edge: usize, axis: usize) -> Option<(Shares<S>, f32)> {
        let known = |at| leaf_at(self.leaves, at).filter(|&l| self.counts[l] > 0.0);
        let other = leaf_at(self.leaves, middle)?;
        let size = self.places[other].edge;
        if size == edge {
            return known(middle).map(|l| (self.shares[l], self.places[l].offset[axis]));
        }
        if size > edge {
            let other = known(middle)?;
            let mut shares = self.shares[other];
            for axis in 0..3 {
                let place = &self.places[other];
                let apart = narrow(middle[axis]) - place.centre[axis] - place.offset[axis];
                for half in &mut shares {
                    for row in 0..ROWS {
                        half[row] = half[row].plus(self.done[other].share[row][1 + axis].scaled(apart));
                    }
                }
            }
            return Some((shares, 0.0));
        }
        let (mut sum, mut offset, mut count) = ([[S::ZERO; ROWS]; 3], 0.0_f32, 0.0_f32);
        for corner in 0..8 {
            // A quarter of a cell off the faces, so that what is chosen lies evenly about the middle.
            let apart = 0.25 * real(edge) + 0.25;
            let at =
                [0, 1, 2].map(|a| if corner >> a & 1 == 0 { middle[a] - apart } else { middle[a] + apart });
            let Some(l) = known(at) else { continue };
            count += 1.0;
            let place = &self.places[l];
            offset += place.centre[axis] + place.offset[axis] - narrow(middle[axis]);
            for (sum, share) in sum.iter_mut().flatten().zip(self.shares[l].iter().flatten()) {
                *sum = sum.plus(*share);
            }
        }
        let per_leaf = 1.0 / count.max(1.0);
        (count > 0.0).then(|| (sum.map(|rows| rows.map(|row| row.scaled(per_leaf))), offset * per_leaf))
    }
}

/// Other channels over channel 0, of each leaf with its neighbours.
fn ratios<S: Spectrum>(extra: usize, places: &[Place], cache: &Cache<S>) -> Vec<S> {
    if extra == 0 {
        return Vec::new();
    }
    let mut ratio = vec![S::ZERO; places.len() * extra];
    ratio.par_chunks_mut(extra).zip(places).enumerate().with_min_len(256).for_each(
        |(leaf, (ratio, place))| {
            let mut unit = S::ZERO;
            let around = place.beside.iter().filter(|&&b| b != NONE).map(|&b| b as usize);
            for l in std::iter::once(leaf).chain(around) {
                unit = unit.plus(cache.halves[l][0][2]).plus(cache.halves[l][1][2]);
                for (to, from) in ratio.iter_mut().zip(&cache.others[l * extra..(l + 1) * extra]) {
                    *to = to.plus(*from);
                }
            }
            ratio.iter_mut().for_each(|r| *r = r.over(unit));
        },
    );
    ratio
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
