//! Shares of light in one leaf from the sums over its paths.

use super::cache::Cache;
use super::chamber::SIDES;
use super::spectrum::Spectrum;
use rayon::prelude::*;

/// Plate and medium (channel 0): the shares that are reconstructed; walls follow.
pub(super) const ROWS: usize = 2;

/// Shares of plate and medium in one leaf: of all its paths, and of each half of them.
pub(super) type Shares<S> = [[S; ROWS]; 3];

/// Plate and medium divided by plate + walls + medium, of every leaf.
pub(super) fn shares<S: Spectrum>(cache: &Cache<S>) -> Vec<Shares<S>> {
    let divide = |sums: [S; 3]| {
        let total = sums[0].plus(sums[1]).plus(sums[2]);
        [sums[0].over(total), sums[2].over(total)]
    };
    let of = |halves: &[[S; 3]; 2]| {
        let whole = divide([0, 1, 2].map(|k: usize| halves[0][k].plus(halves[1][k])));
        let half = |h: usize| {
            let sum = halves[h][0].plus(halves[h][1]).plus(halves[h][2]).sum();
            if sum > 0.0 { divide(halves[h]) } else { whole }
        };
        [whole, half(0), half(1)]
    };
    cache.halves.par_iter().with_min_len(256).map(of).collect()
}

/// Light from the two walls across an axis divided by plate + walls + medium, as [`shares`].
pub(super) fn side_shares<S: Spectrum>(cache: &Cache<S>, axis: usize) -> Vec<Shares<S>> {
    let of = |(halves, sides): (&[[S; 3]; 2], &[[S; SIDES]; 2])| {
        let total = [0, 1].map(|h: usize| halves[h][0].plus(halves[h][1]).plus(halves[h][2]));
        let pair = [0, 1].map(|h: usize| [sides[h][2 * axis], sides[h][2 * axis + 1]]);
        let whole = [0, 1].map(|row: usize| pair[0][row].plus(pair[1][row]).over(total[0].plus(total[1])));
        let half =
            |h: usize| if total[h].sum() > 0.0 { pair[h].map(|side| side.over(total[h])) } else { whole };
        [whole, half(0), half(1)]
    };
    cache.halves.par_iter().zip(&cache.sides).with_min_len(256).map(of).collect()
}
