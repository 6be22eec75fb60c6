//! Joins the halves of a row: one column per radius, by the variances of both sides.
//!
//! A gap of a few radii that neither side knows is bridged by a straight line; what is missing about the axis stays
//! missing. Every joined value keeps the weights of its pixels, so that variances are exact.

use super::flag;
use super::grid::{Grid, Mix, Side};
use super::operators::radius;

/// Numbers of the widest vector.
const EIGHT: usize = 8;

/// Radii in a row that a straight line may bridge.
const GAP_MAX: usize = 4;

/// A row of pixels: values and variances; a pixel whose value or variance is not finite is missing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pixels<'a> {
    pub(super) values: &'a [f64],
    /// Variances, or none: then all pixels have the same.
    pub(super) variances: Option<&'a [f64]>,
}

impl Pixels<'_> {
    pub(super) fn known(&self, column: usize) -> bool {
        self.values[column].is_finite()
            && self.variances.is_none_or(|v| v[column].is_finite() && v[column] >= 0.0)
    }

    fn variance(&self, column: usize) -> f64 {
        self.variances.map_or(1.0, |v| v[column])
    }
}

/// A joined row: radii `from` ‥ `to` are known, or bridged.
#[derive(Debug, Clone, Default)]
pub(super) struct Joined {
    pub(super) from: usize,
    pub(super) to: usize,
    /// Pixels of each radius from `from` on.
    pub(super) mixes: Vec<Mix>,
    /// Flags of each radius of the grid.
    pub(super) flags: Vec<u32>,
    /// Squared differences of the halves, and how many variances of a pixel they hold.
    pub(super) squares: (f64, f64),
}

/// Joins any row.
pub(super) fn join(grid: &Grid, pixels: &Pixels<'_>) -> Joined {
    let mut out = Joined { flags: vec![0; grid.n], ..Joined::default() };
    let side = |side: Side, i: usize| -> Option<Mix> {
        if i >= grid.count(side) {
            return None;
        }
        let mix = grid.pixels(side, i);
        mix.iter().all(|&(column, _)| pixels.known(column)).then_some(mix)
    };
    let value = |mix: &Mix| mix.iter().map(|&(c, w)| w * pixels.values[c]).sum::<f64>();
    let variance = |mix: &Mix| mix.iter().map(|&(c, w)| w * w * pixels.variance(c)).sum::<f64>();
    let mut known: Vec<Option<Mix>> = Vec::with_capacity(grid.n);
    for i in 0..grid.n {
        let (left, right) = (side(Side::Left, i), side(Side::Right, i));
        let on_axis = i == 0 && grid.phase <= 0.0 && grid.plain;
        known.push(match (left, right) {
            (Some(left), Some(right)) if !on_axis => {
                let (a, b) = (variance(&left), variance(&right));
                out.squares.0 += (value(&left) - value(&right)).powi(2);
                out.squares.1 += left.iter().chain(&right).map(|(_, w)| w * w).sum::<f64>();
                let to_left = if a + b > 0.0 { b / (a + b) } else { 0.5 };
                Some(joined(&left, to_left, &right, 1.0 - to_left))
            }
            (None, None) => None,
            (left, right) => {
                out.flags[i] |= if on_axis { 0 } else { flag::ONE_SIDE };
                left.or(right)
            }
        });
    }
    let Some(last) = known.iter().rposition(Option::is_some) else {
        out.flags.fill(flag::HIDDEN);
        return out;
    };
    // From outside in, as far as gaps can be bridged.
    out.to = last + 1;
    let mut i = last;
    let mut from = last;
    while let Some(next) = known[..i].iter().rposition(Option::is_some) {
        let gap = i - next - 1;
        if gap > GAP_MAX {
            break;
        }
        for k in next + 1..i {
            let part = radius(k - next, 0.0) / radius(i - next, 0.0);
            let (inner, outer) = (known[next].clone(), known[i].clone());
            known[k] = inner.zip(outer).map(|(inner, outer)| joined(&inner, 1.0 - part, &outer, part));
        }
        if gap > 0 {
            out.flags[..i].iter_mut().for_each(|flags| *flags |= flag::BRIDGED);
        }
        (i, from) = (next, next);
    }
    // A short gap about the axis is bridged by symmetry: the column is flat there.
    if from > 0 && from <= GAP_MAX / 2 {
        let inner = known[from].clone();
        known[..from].fill(inner);
        out.flags[..from].iter_mut().for_each(|flags| *flags |= flag::BRIDGED);
        from = 0;
    }
    out.from = from;
    out.flags[..from].fill(flag::HIDDEN);
    out.flags[out.to..].fill(flag::HIDDEN);
    out.mixes = known.drain(from..out.to).flatten().collect();
    out
}

/// a·left + b·right.
fn joined(left: &Mix, a: f64, right: &Mix, b: f64) -> Mix {
    let mut out: Mix = left.iter().map(|&(column, weight)| (column, a * weight)).collect();
    for &(column, weight) in right {
        match out.iter_mut().find(|(known, _)| *known == column) {
            Some((_, sum)) => *sum += b * weight,
            None => out.push((column, b * weight)),
        }
    }
    out.retain(|(_, weight)| *weight != 0.0);
    out
}

/// Numbers in the opposite order, as many as both hold: `to` from its begin, `from` from its end.
#[inline(always)]
pub(super) fn reverse(from: &[f64], to: &mut [f64]) {
    let length = from.len().min(to.len());
    let (from, to) = (&from[from.len() - length..], &mut to[..length]);
    for (from, to) in from.rchunks_exact(EIGHT).zip(to.chunks_exact_mut(EIGHT)) {
        let mut eight = [0.0; EIGHT];
        eight.copy_from_slice(from);
        eight.reverse();
        to.copy_from_slice(&eight);
    }
    let rest = length % EIGHT;
    from[..rest].iter().rev().zip(&mut to[length - rest..]).for_each(|(from, to)| *to = *from);
}

/// Joins a complete row of a plain grid quickly into columns and, if asked for, their variances. Returns the squared
/// differences of the halves and how many pixel variances they hold. `memory` is two rows long.
#[inline(always)]
pub(super) fn join_complete(
    grid: &Grid,
    pixels: &Pixels<'_>,
    out: &mut [f64],
    variances: &mut [f64],
    memory: &mut [f64],
) -> (f64, f64) {
    let ((right, to_right), (left, to_left)) = (grid.right, grid.left);
    let both = to_right.min(to_left);
    let (a, known_a) = (&pixels.values[right..right + to_right], pixels.variances);
    // The left half, from the axis on.
    let (b, known_b) = memory.split_at_mut(grid.columns);
    reverse(&pixels.values[..=left], b);
    let b = &b[..to_left];
    let longer = if to_right >= to_left { a } else { b };
    out[both..].copy_from_slice(&longer[both..]);
    // On an axis that is a pixel both sides are the same one.
    let own = usize::from(grid.phase <= 0.0 && both > 0);
    let square = in_eights(&a[..both], &b[..both], |a, b| (a - b) * (a - b));
    match known_a {
        None => {
            let halves = a[..both].iter().zip(&b[..both]);
            out[..both].iter_mut().zip(halves).for_each(|(out, (a, b))| *out = 0.5 * (a + b));
        }
        Some(known) => {
            let known_a = &known[right..right + to_right];
            reverse(&known[..=left], known_b);
            let known_b = &known_b[..to_left];
            let longer = if to_right >= to_left { known_a } else { known_b };
            variances[both..].copy_from_slice(&longer[both..]);
            out[..own].copy_from_slice(&a[..own]);
            variances[..own].copy_from_slice(&known_a[..own]);
            let halves = a[own..both].iter().zip(&b[own..both]);
            let known = known_a[own..both].iter().zip(&known_b[own..both]);
            let to = out[own..both].iter_mut().zip(&mut variances[own..both]);
            for ((out, variance), ((a, b), (va, vb))) in to.zip(halves.zip(known)) {
                let sum = va + vb;
                let to_a = if sum > 0.0 { vb / sum } else { 0.5 };
                *out = to_a * a + (1.0 - to_a) * b;
                *variance = to_a * to_a * va + (1.0 - to_a) * (1.0 - to_a) * vb;
            }
        }
    }
    (square, 2.0 * radius(both - own, 0.0))
}

/// Σ f(a, b), in eight sums so that vectors can add them.
#[inline(always)]
fn in_eights(a: &[f64], b: &[f64], f: impl Fn(f64, f64) -> f64) -> f64 {
    let mut sums = [0.0; EIGHT];
    let ((whole_a, rest_a), (whole_b, rest_b)) = (a.as_chunks::<EIGHT>(), b.as_chunks::<EIGHT>());
    for (a, b) in whole_a.iter().zip(whole_b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += f(*a, *b);
        }
    }
    sums.iter().sum::<f64>() + rest_a.iter().zip(rest_b).map(|(a, b)| f(*a, *b)).sum::<f64>()
}

/// Σ value².
#[inline(always)]
pub(super) fn squares(values: &[f64]) -> f64 {
    in_eights(values, values, |v, _| v * v)
}

/// Σ value.
#[inline(always)]
pub(super) fn sum(values: &[f64]) -> f64 {
    in_eights(values, values, |v, _| v)
}
