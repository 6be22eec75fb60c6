//! Joins the halves of a row: one column per radius, by the variances of both sides.
//!
//! A gap of a few radii that neither side knows is bridged by a straight line; what is missing about the axis stays
//! missing. Every joined value keeps the weights of its pixels, so that variances are exact.

use super::flag;
use super::grid::{Grid, Mix, Side};
use super::operators::radius;

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

/// Joins a complete row of a plain grid quickly into columns and, if asked for, their variances. Returns the squared
/// differences of the halves and how many pixel variances they hold.
pub(super) fn join_complete(
    grid: &Grid,
    pixels: &Pixels<'_>,
    out: &mut [f64],
    variances: &mut [f64],
) -> (f64, f64) {
    let ((right, to_right), (left, to_left)) = (grid.right, grid.left);
    let both = to_right.min(to_left);
    let values = pixels.values;
    let right_half = &values[right..right + to_right];
    let left_half = || values[..=left].iter().rev();
    if to_right >= to_left {
        out.copy_from_slice(right_half)
    } else {
        out.iter_mut().zip(left_half()).for_each(|(o, v)| *o = *v)
    }
    // On an axis that is a pixel both sides are the same one.
    let own = usize::from(grid.phase <= 0.0 && both > 0);
    let mut square = 0.0;
    for ((out, a), b) in out[..both].iter_mut().zip(right_half).zip(left_half()) {
        *out = 0.5 * (a + b);
        square += (a - b) * (a - b);
    }
    if let Some(known) = pixels.variances {
        let right_known = known[right..right + to_right].iter();
        let left_known = || known[..=left].iter().rev();
        if to_right >= to_left {
            variances.iter_mut().zip(right_known.clone()).for_each(|(o, v)| *o = *v);
        } else {
            variances.iter_mut().zip(left_known()).for_each(|(o, v)| *o = *v);
        }
        let each = right_half.iter().zip(left_half()).zip(right_known.zip(left_known()));
        for (i, ((a, b), (va, vb))) in each.enumerate().take(both).skip(own) {
            let sum = va + vb;
            let to_a = if sum > 0.0 { vb / sum } else { 0.5 };
            out[i] = to_a * a + (1.0 - to_a) * b;
            variances[i] = to_a * to_a * va + (1.0 - to_a) * (1.0 - to_a) * vb;
        }
    }
    (square, 2.0 * radius(both - own, 0.0))
}
