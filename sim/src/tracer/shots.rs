//! Further shots of a spray: its densities change cell by cell, and what is scattered in each place is brought in line
//! without a path.
//!
//! The source function of a place holds what it sees around it: a share J_m of medium and E = 1 − J_m of plate and walls
//! behind it. E falls like the transmittance of what lies around, so that where all around is f times as dense it becomes
//! E^f, and the shares of plate and walls follow it. f is the mean factor over the bricks around, weighted with the
//! extinction. What is left out: changes of the way on which light comes (of the order of the albedo times the change of
//! depth) and eddies smaller than bricks, which cancel in E.

use super::cache::Leaves;
use super::error::TracerError;
use super::fine::{CELLS, Fine};
use super::medium::EMPTY;
use super::reconstruct::{InLeaf, Scattered, TERMS};
use super::sampling::Lit;
use super::shares::ROWS;
use super::spectrum::{Spectrum, narrow};
use rayon::prelude::*;

/// Largest factor of a shot's density.
const DENSER_MAX: f32 = 1e6;

/// Factors beyond which surroundings are not followed.
const AROUND_MIN: f32 = 0.1;
const AROUND_MAX: f32 = 10.0;

/// A medium with densities multiplied by one factor for each of its `expected` occupied cells, and the light in it.
///
/// # Errors
///
/// [`TracerError::Shape`] or [`TracerError::Coefficient`] for factors that do not fit, are negative or undefined.
pub(super) fn denser<S: Spectrum>(
    fine: &Fine<S>,
    expected: usize,
    lit: Option<&Lit<S>>,
    factors: &[f32],
) -> Result<(Fine<S>, Option<Lit<S>>), TracerError> {
    let what = "a shot's factors";
    if factors.len() != expected {
        return Err(TracerError::Shape { what, found: factors.len(), expected });
    }
    if let Some(entry) = factors.iter().position(|f| !(0.0..=DENSER_MAX).contains(f)) {
        let (value, condition) = (f64::from(factors[entry]), "from 0 to 1e6");
        return Err(TracerError::Coefficient { what, entry, value, condition });
    }
    let core: Vec<[S; 2]> = fine
        .core
        .par_iter()
        .zip(&fine.ordinal)
        .with_min_len(CELLS)
        .map(|(&[k, albedo], &ordinal)| match ordinal {
            EMPTY => [k, albedo],
            o => [k.scaled(factors[o as usize]), albedo],
        })
        .collect();
    let lit = lit.map(|lit| {
        let around = around(fine, &core);
        let scattered = dimmed(&lit.scattered, &lit.leaves, &around);
        Lit { scattered, leaves: lit.leaves.clone(), coarse: lit.coarse }
    });
    Ok((Fine { core, ..fine.clone() }, lit))
}

/// Mean factor of the extinction over each occupied brick and those that touch it, weighted with the extinction.
fn around<S: Spectrum>(fine: &Fine<S>, core: &[[S; 2]]) -> Vec<f32> {
    let sums: Vec<[f64; 2]> = fine
        .core
        .par_chunks(CELLS)
        .zip(core.par_chunks(CELLS))
        .map(|(before, after)| {
            [before, after].map(|cells| cells.iter().map(|[k, _]| f64::from(k.sum())).sum())
        })
        .collect();
    let bricks = &fine.bricks;
    let mut ordinal = vec![usize::MAX; bricks.list.len()];
    for (i, &b) in fine.occupied.iter().enumerate() {
        ordinal[b] = i;
    }
    fine.occupied
        .iter()
        .map(|&b| {
            let at = bricks.at(b);
            let near = |a: usize| at[a].saturating_sub(1)..(at[a] + 2).min(bricks.count[a]);
            let mut sum = [0.0; 2];
            for x in near(0) {
                for y in near(1) {
                    for z in near(2) {
                        let o = ordinal[(x * bricks.count[1] + y) * bricks.count[2] + z];
                        if let Some(s) = sums.get(o) {
                            sum = [sum[0] + s[0], sum[1] + s[1]];
                        }
                    }
                }
            }
            let factor = if sum[0] > 0.0 { narrow(sum[1] / sum[0]) } else { 1.0 };
            factor.clamp(AROUND_MIN, AROUND_MAX)
        })
        .collect()
}

/// The light where all around is so much denser.
fn dimmed<S: Spectrum>(scattered: &Scattered<S>, leaves: &Leaves, around: &[f32]) -> Scattered<S> {
    let mut factors = Vec::with_capacity(leaves.demand.len());
    for (&b, &factor) in leaves.occupied.iter().zip(around) {
        factors.resize(factors.len() + leaves.bricks.list[b].blocks(), factor);
    }
    // E^(f − 1) of every leaf.
    let shares: Vec<S> = scattered
        .leaves
        .par_iter()
        .zip(&factors)
        .with_min_len(256)
        .map(|(leaf, &factor)| {
            let mut share = S::ZERO;
            for g in 0..S::WIDTH {
                let passed = (1.0 - leaf.share[1][0].get(g)).clamp(1e-6, 1.0);
                share.set(g, passed.powf(factor - 1.0));
            }
            share
        })
        .collect();
    let scaled = |rows: &[S; TERMS], by: S| rows.map(|term| term.times(by));
    let lit = scattered.leaves.par_iter().zip(&shares).zip(&factors).with_min_len(256);
    let lit = lit.map(|((leaf, &share), &factor)| {
        let mut out = InLeaf { share: [scaled(&leaf.share[0], share); ROWS], ..*leaf };
        // Of the medium 1 − E^f, whose slopes are f · E^(f − 1) times those of J_m.
        out.share[1] = scaled(&leaf.share[1], share.scaled(factor));
        let one = S::splat(1.0);
        // Where no light is scattered, as the centre of a leaf may be, it may be less than none.
        out.share[1][0] = one.minus(one.minus(leaf.share[1][0]).times(share));
        out
    });
    let sides = scattered.sides.iter().map(|axis| {
        let both = axis.par_iter().zip(&shares).with_min_len(256);
        both.map(|(leaf, &share)| InLeaf { share: leaf.share.map(|rows| scaled(&rows, share)), ..*leaf })
            .collect()
    });
    Scattered { leaves: lit.collect(), ratio: scattered.ratio.clone(), sides: sides.collect() }
}
