//! From the sums of the leaves to in-scattered light anywhere in the medium: shares of plate, walls and medium, which are
//! quadratic inside each leaf.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over axes and rows step through several arrays at once"
)]

use super::bricks::{EDGE, EDGE_LOG, NONE};
use super::cache::{Cache, Leaves};
use super::chamber::SIDES;
use super::mixing::{fill, mixed};
use super::places::{Place, Places, leaf_at};
use super::shares::{ROWS, Shares, shares, side_shares};
use super::sobol::hash;
use super::spectrum::{Spectrum, narrow, vectorised};
use rayon::prelude::*;

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

/// Boxes as large as itself that a leaf looks past where nothing is, for one that tells how light changes.
const FAR: usize = 4;

/// What light changes by inside a leaf whose neighbours tell nothing, rms over its own value and per optical depth, and per
/// edge over half the medium's: light scattered in lumps that stand apart, compared with pixels traced one by one.
const UNTOLD: [f32; 2] = [0.15, 0.25];

/// Part of its square that is left where the nearest leaves along an axis are behind gaps.
const FAR_UNTOLD: f32 = 0.5;

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

/// The square of the bias without what noise adds to it, from mean squares of noise and bias over many sights.
pub(super) fn pure_bias(noise: f32, bias: f32) -> f32 {
    (bias - BIAS_NOISE * noise).max(0.0)
}

/// The source function of every leaf from the sums over its paths.
pub(super) fn reconstruct<S: Spectrum>(places: &Places<'_>, cache: &Cache<S>) -> Scattered<S> {
    let of = |shares: Vec<Shares<S>>| shaped(places, shares, &cache.paths);
    let axes = if cache.sides.is_empty() { 0 } else { SIDES / 2 };
    Scattered {
        leaves: of(shares(cache)),
        ratio: ratios(places, cache),
        sides: (0..axes).map(|axis| of(side_shares(cache, axis))).collect(),
    }
}

/// Shares of two kinds of light, mixed between leaves and given a shape inside each.
fn shaped<S: Spectrum>(places: &Places<'_>, mut shares: Vec<Shares<S>>, paths: &[u32]) -> Vec<InLeaf<S>> {
    let Places { leaves, owner, list: places, .. } = places;
    let mut counts: Vec<f32> = paths.par_iter().map(|&n| narrow(f64::from(n))).collect();
    let unknown: Vec<bool> = counts.iter().map(|&c| c <= 0.0).collect();
    let spread = fill(owner, leaves.occupied.len(), &mut shares, &counts);
    let mixed_by = mixed(leaves, owner, places, &mut shares, &mut counts);
    let empty = InLeaf { share: [[S::ZERO; TERMS]; ROWS], noise: [S::ZERO; ROWS], bias: [S::ZERO; ROWS] };
    let mut done: Vec<InLeaf<S>> =
        (0..shares.len()).into_par_iter().with_min_len(256).map(|_| empty).collect();
    let extent = 0.5 * narrow(real(leaves.bricks.cells.into_iter().fold(1, usize::max)));
    let mut known = Known { leaves, places, shares: &shares, counts: &counts, slopes: Vec::new(), extent };
    let sizes: Vec<usize> = places.par_iter().map(|place| place.edge).collect();
    let smallest = sizes.iter().copied().min().unwrap_or(EDGE);
    // Large leaves first: small ones beside them look at their slopes.
    for edge in (0..=EDGE_LOG).map(|log| EDGE >> log).filter(|&edge| edge >= smallest) {
        done.par_iter_mut().zip(&sizes).enumerate().with_min_len(256).for_each(|(leaf, (to, &size))| {
            if size == edge {
                *to = vectorised(
                    #[inline(always)]
                    || known.shape(leaf, mixed_by[leaf]),
                );
            }
        });
        if edge > smallest {
            known.slopes.resize(done.len(), [[S::ZERO; 3]; ROWS]);
            let found = known.slopes.par_iter_mut().zip(done.par_iter().zip(&sizes)).with_min_len(256);
            found.filter(|(_, (_, size))| **size == edge).for_each(|(to, (leaf, _))| {
                *to = leaf.share.map(|[_, x, y, z, ..]| [x, y, z]);
            });
        }
    }
    let found = done.par_iter().zip(places).with_min_len(256);
    let lost: Vec<[S; ROWS]> = found
        .map(|(leaf, place)| {
            vectorised(
                #[inline(always)]
                || lost(leaf, place, &done),
            )
        })
        .collect();
    done.par_iter_mut().zip(lost).enumerate().with_min_len(256).for_each(|(i, (leaf, lost))| {
        leaf.bias = [0, 1].map(|row: usize| leaf.bias[row].plus(lost[row]));
        if unknown[i] {
            // It may be as far from the mean that it was given as any other, until paths tell.
            leaf.noise = [0, 1].map(|row: usize| leaf.noise[row].plus(spread[row].scaled(1.0 - mixed_by[i])));
        }
    });
    done
}

/// What a quadratic function misses inside a leaf.
#[inline(always)]
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

/// What is known of the leaves while their shapes are found.
struct Known<'a, S> {
    leaves: &'a Leaves,
    places: &'a [Place],
    shares: &'a [Shares<S>],
    counts: &'a [f32],
    /// Slopes of the leaves larger than those in work: `[leaf][row][axis]`.
    slopes: Vec<[[S; 3]; ROWS]>,
    /// Half the longest edge of the medium in cells.
    extent: f32,
}

impl<S: Spectrum> Known<'_, S> {
    /// Mean, slopes and curvatures of a leaf's shares, and how far they may be bent.
    #[inline(always)]
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
            // What is found behind a gap tells less.
            let far = |other: &Option<(Shares<S>, f32)>| {
                other.as_ref().is_none_or(|(_, there)| there.abs() > 0.75 * edge)
            };
            if far(&low) && far(&high) {
                untold += if low.is_none() && high.is_none() { 1.0 } else { FAR_UNTOLD };
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
            let change = UNTOLD[0] * place.depth.min(1.0) + UNTOLD[1] * edge / self.extent;
            let part = side * change * untold.sqrt();
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
    #[inline(always)]
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
    #[inline(always)]
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
                        half[row] = half[row].plus(self.slopes[other][row][axis].scaled(apart));
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
fn ratios<S: Spectrum>(places: &Places<'_>, cache: &Cache<S>) -> Vec<S> {
    let extra = places.channels - 1;
    if extra == 0 {
        return Vec::new();
    }
    let mut ratio = vec![S::ZERO; places.list.len() * extra];
    ratio.par_chunks_mut(extra).zip(&places.list).enumerate().with_min_len(256).for_each(
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
