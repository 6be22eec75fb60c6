//! Shares of leaves mixed with those of their neighbours, as far as noise outweighs their difference.

use super::bricks::NONE;
use super::cache::Leaves;
use super::places::Place;
use super::shares::{ROWS, Shares};
use super::spectrum::{Spectrum, vectorised};
use rayon::prelude::*;

/// Rounds of mixing at most; each reaches one leaf further.
const ROUNDS_MAX: usize = 2;

/// Mixing that would move nobody by more than this part towards its neighbours is left out.
const MIX_MIN: f64 = 0.02;

/// Standard errors by which the difference between neighbours is taken for larger than it seems.
const CAUTION: f32 = 2.0;

/// Decay of the exchange between neighbours per optical depth of a leaf: over a mean free path the source function
/// changes by itself.
const DECAY: f32 = 2.0;

/// Mixes the shares of the leaves, which then are worth more paths than their own; how much of each is its neighbours'.
pub(super) fn mixed<S: Spectrum>(
    leaves: &Leaves,
    owner: &[u32],
    places: &[Place],
    shares: &mut Vec<Shares<S>>,
    counts: &mut Vec<f32>,
) -> Vec<f32> {
    let mut mixed_by = vec![0.0_f32; shares.len()];
    for _ in 0..ROUNDS_MAX {
        let strength = strengths(owner, places, shares, counts);
        let parts: Vec<f32> = places
            .iter()
            .zip(counts.iter().zip(owner))
            .map(|(place, (count, &o))| {
                let alpha = strength[o as usize] * (-DECAY * place.depth).exp();
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
        let (mut mixed, mut worth) = (Vec::new(), Vec::new());
        let of = |leaf: usize| {
            vectorised(
                #[inline(always)]
                || mix(leaf, &places[leaf].beside, shares, counts, parts[leaf]),
            )
        };
        (0..shares.len()).into_par_iter().with_min_len(256).map(of).unzip_into_vecs(&mut mixed, &mut worth);
        (*shares, *counts) = (mixed, worth);
        for (by, part) in mixed_by.iter_mut().zip(&parts) {
            *by = 1.0 - (1.0 - *by) * (1.0 - part);
        }
    }
    mixed_by
}

/// Gives leaves without paths the mean of their brick, or of all; the standard deviation of those that have some.
pub(super) fn fill<S: Spectrum>(
    owner: &[u32],
    bricks: usize,
    shares: &mut [Shares<S>],
    counts: &[f32],
) -> [S; ROWS] {
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
            vectorised(
                #[inline(always)]
                || strength(first[b]..first[b + 1], places, shares, counts),
            )
        })
        .collect()
}

/// The same for some leaves together.
#[inline(always)]
fn strength<S: Spectrum>(
    leaves: std::ops::Range<usize>,
    places: &[Place],
    shares: &[Shares<S>],
    counts: &[f32],
) -> f32 {
    let (mut noise, mut apart, mut square, mut number) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
    for leaf in leaves {
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
}

/// Sum of the neighbours' shares, pair by pair weighted by their paths (at least a little), and the weights' sum.
#[inline(always)]
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
#[inline(always)]
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
