//! The phase function of spheres of many sizes.
//!
//! Their pattern is a cosine series in θ ([`Pattern`]); it is integrated piece by piece, and the pieces are joined as
//! long as the cumulative distribution stays within the error wanted.

use super::cells::PhaseCells;
use super::inverse::Cells;
use super::{PhaseError, PhaseFunction};
use crate::light::mie::{Pattern, Sphere, efficiencies_of_many};
use std::f64::consts::PI;
use std::sync::Arc;

/// Error of the cumulative distribution that is far below any target of a render, yet costs only about 150 nodes for the
/// sizes of a spray and 500 for one size with x = 1000.
pub const DISTRIBUTION_ERROR: f64 = 1e-6;

/// A phase function with what is known about its making.
#[derive(Debug, Clone)]
pub struct MiePhase {
    /// The phase function.
    pub phase: PhaseFunction,
    /// Nodes it needs.
    pub nodes: usize,
    /// Largest distance of its cumulative distribution from the exact one.
    pub error: f64,
    /// The exact mean cosine, from the series.
    pub asymmetry: f64,
}

/// The phase function of a pattern (of any norm), to `target` in the cumulative distribution. `asymmetry` is the exact
/// mean cosine: it tells whether the pattern is what it claims.
///
/// # Errors
///
/// [`PhaseError::Zero`] when nothing scatters, and [`PhaseError::Unresolved`] when the mean cosine of the pattern is
/// off by more than `target`, or not a number.
pub fn of_pattern(pattern: &Pattern, asymmetry: f64, target: f64) -> Result<MiePhase, PhaseError> {
    let total = pattern.total();
    if !(total > 0.0 && total.is_finite()) {
        return Err(PhaseError::Zero);
    }
    // At most half a wave of the fastest cosine on a piece: its Gauss rule leaves less than 1e-9 of that term.
    let pieces = pattern.cosines.len().next_power_of_two().max(64);
    let bounds: Vec<f64> = (0..=pieces).map(|i| PI * i as f64 / pieces as f64).collect();
    let target = target.max(f64::EPSILON);
    // The series of squares is nowhere negative but for its rounding.
    let density = |theta: &[f64]| {
        let cosines: Vec<f64> = theta.iter().map(|theta| theta.cos()).collect();
        pattern.at_many(&cosines).into_iter().map(|p| (p / total).max(0.0)).collect()
    };
    let cells = Cells::new(&bounds, target, &density).ok_or(PhaseError::Zero)?;
    let cells = PhaseCells::new(cells);
    let found = cells.mean_cosine();
    let off = (found - asymmetry).abs();
    if off.is_nan() || off > target {
        return Err(PhaseError::Unresolved { found, asymmetry });
    }
    let (nodes, error) = (cells.nodes(), cells.error());
    Ok(MiePhase { phase: PhaseFunction::Cells(Arc::new(cells)), nodes, error, asymmetry })
}

/// The mean phase function of spheres, each with its number of droplets (in any unit), weighted with what they
/// scatter; to `target` in the cumulative distribution. Runs on rayon's threads; the answer does not depend on their
/// number.
///
/// # Errors
///
/// [`PhaseError::Length`] unless there is one number per sphere, [`PhaseError::Value`] for a number that is negative or
/// none, [`PhaseError::Sphere`] for a sphere without an answer or too large for [`Pattern::of`], and as [`of_pattern`].
pub fn of_spheres(spheres: &[Sphere], numbers: &[f64], target: f64) -> Result<MiePhase, PhaseError> {
    if spheres.len() != numbers.len() {
        return Err(PhaseError::Length { angles: spheres.len(), values: numbers.len() });
    }
    if let Some(entry) = numbers.iter().position(|&n| !(n.is_finite() && n >= 0.0)) {
        return Err(PhaseError::Value { entry });
    }
    let bad = |(entry, error): (usize, crate::light::mie::MieError)| PhaseError::Sphere {
        entry,
        problem: error.to_string(),
    };
    let answers = efficiencies_of_many(spheres).map_err(bad)?;
    let (mut scattered, mut forward) = (0.0, 0.0);
    for ((sphere, number), q) in spheres.iter().zip(numbers).zip(&answers) {
        let own = number * sphere.size_parameter * sphere.size_parameter * q.q_sca;
        scattered += own;
        forward += own * q.asymmetry;
    }
    if !(scattered > 0.0 && scattered.is_finite()) {
        return Err(PhaseError::Zero);
    }
    of_pattern(&Pattern::of(spheres, numbers).map_err(bad)?, forward / scattered, target)
}
