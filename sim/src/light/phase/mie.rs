//! The phase function of spheres of many sizes, from values at equally spaced angles.
//!
//! |S₁|² + |S₂|² of a sphere with N orders is a polynomial of degree 2N in cos θ, hence a cosine series in θ: 2N + 1
//! values at the middles of equal steps of θ are all there is to know. The series is integrated piece by piece, and
//! the pieces are joined as long as the cumulative distribution stays within the error wanted.

use super::cells::PhaseCells;
use super::inverse::Cells;
use super::{PhaseError, PhaseFunction};
use crate::light::mie::{Direction, Sphere, amplitudes_towards, efficiencies_of_many};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Arc;

/// Error of the cumulative distribution that is far below any target of a render, yet costs only about 150 nodes for the
/// sizes of a spray and 500 for one size with x = 1000.
pub const DISTRIBUTION_ERROR: f64 = 1e-6;

/// Largest size parameter: the work grows with its square. Beyond it only the diffraction peak, already narrower than
/// 0.02°, gets narrower.
pub const SIZE_MAX: f64 = 5e3;

/// Fewest angles: a Rayleigh sphere needs five.
const ANGLES_MIN: usize = 17;

/// Angles evaluated together.
const LANES: usize = 8;

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

/// Number of angles at which spheres up to a size parameter must be known: 2N + 1 with Wiscombe's N, at which |a_n|²
/// is below 1e-14.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
pub fn angles_for(size_parameter: f64) -> usize {
    let x = size_parameter.clamp(0.0, SIZE_MAX);
    (2 * (x + 4.05 * x.cbrt() + 2.0).ceil() as usize + 1).max(ANGLES_MIN)
}

/// The angles (i + ½) π / count in radians: symmetric about 90°.
pub fn angles(count: usize) -> Vec<f64> {
    (0..count).map(|i| PI * (i as f64 + 0.5) / count as f64).collect()
}

/// The phase function with the values `p11`, of any norm, at [`angles`]`(p11.len())`, to `target` in the cumulative
/// distribution. `asymmetry` is the exact mean cosine: it tells whether the angles were enough.
///
/// # Errors
///
/// [`PhaseError::Length`] for fewer than two values, [`PhaseError::Value`] for negative or undefined ones,
/// [`PhaseError::Zero`], and [`PhaseError::Unresolved`] when the mean cosine of the values is off by more than `target`.
pub fn from_values(p11: &[f64], asymmetry: f64, target: f64) -> Result<MiePhase, PhaseError> {
    if p11.len() < 2 {
        return Err(PhaseError::Length { angles: p11.len(), values: p11.len() });
    }
    if let Some(entry) = p11.iter().position(|&p| !(p.is_finite() && p >= 0.0)) {
        return Err(PhaseError::Value { entry });
    }
    let peak = p11.iter().fold(0.0_f64, |peak, &p| peak.max(p));
    if peak <= 0.0 {
        return Err(PhaseError::Zero);
    }
    let series = CosineSeries::through(p11, peak);
    // At most half a wave of the fastest cosine on a piece: its Gauss rule leaves less than 1e-9 of that term.
    let pieces = p11.len().next_power_of_two().max(64);
    let bounds: Vec<f64> = (0..=pieces).map(|i| PI * i as f64 / pieces as f64).collect();
    let target = target.max(f64::EPSILON);
    let cells = Cells::new(&bounds, target, &|at| series.at(at)).ok_or(PhaseError::Zero)?;
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
/// [`PhaseError::Length`] unless there is one number per sphere, [`PhaseError::Sphere`] for a sphere without an answer
/// or with a size parameter above [`SIZE_MAX`], [`PhaseError::Zero`] when nothing scatters, and as [`from_values`].
pub fn of_spheres(spheres: &[Sphere], numbers: &[f64], target: f64) -> Result<MiePhase, PhaseError> {
    if spheres.len() != numbers.len() {
        return Err(PhaseError::Length { angles: spheres.len(), values: numbers.len() });
    }
    if let Some(entry) = numbers.iter().position(|&n| !(n.is_finite() && n >= 0.0)) {
        return Err(PhaseError::Value { entry });
    }
    let answers = efficiencies_of_many(spheres)
        .map_err(|(entry, error)| PhaseError::Sphere { entry, problem: error.to_string() })?;
    if let Some(entry) = spheres.iter().position(|s| s.size_parameter > SIZE_MAX) {
        let problem = format!("size parameter {}: above {SIZE_MAX}", spheres[entry].size_parameter);
        return Err(PhaseError::Sphere { entry, problem });
    }
    let (mut scattered, mut forward) = (0.0, 0.0);
    for ((sphere, number), q) in spheres.iter().zip(numbers).zip(&answers) {
        let own = number * sphere.size_parameter * sphere.size_parameter * q.q_sca;
        scattered += own;
        forward += own * q.asymmetry;
    }
    if !(scattered > 0.0 && scattered.is_finite()) {
        return Err(PhaseError::Zero);
    }
    let largest = spheres.iter().fold(0.0_f64, |x, sphere| x.max(sphere.size_parameter));
    let towards: Vec<Direction> =
        angles(angles_for(largest)).iter().filter_map(|&theta| Direction::from_radians(theta).ok()).collect();
    let sum = pattern(spheres, numbers, &towards)?;
    let p11: Vec<f64> = sum.iter().map(|s| 2.0 * s / scattered).collect();
    from_values(&p11, forward / scattered, target)
}

/// Σ number · (|S₁|² + |S₂|²) towards each direction.
fn pattern(spheres: &[Sphere], numbers: &[f64], towards: &[Direction]) -> Result<Vec<f64>, PhaseError> {
    /// Spheres whose sum is made in one go: fixes the order of additions.
    const TASK: usize = 16;
    let parts: Vec<Vec<f64>> = spheres
        .par_chunks(TASK)
        .zip(numbers.par_chunks(TASK))
        .enumerate()
        .map(|(task, (spheres, numbers))| {
            let mut sum = vec![0.0; towards.len()];
            for (i, (&sphere, number)) in spheres.iter().zip(numbers).enumerate() {
                let amplitudes = amplitudes_towards(sphere, towards).map_err(|error| PhaseError::Sphere {
                    entry: task * TASK + i,
                    problem: error.to_string(),
                })?;
                for (sum, (s1, s2)) in sum.iter_mut().zip(amplitudes) {
                    *sum += number * (s1.norm_sqr() + s2.norm_sqr());
                }
            }
            Ok(sum)
        })
        .collect::<Result<_, _>>()?;
    let mut total = vec![0.0; towards.len()];
    for part in parts {
        total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
    Ok(total)
}

/// Σ c_k cos kθ.
struct CosineSeries(Vec<f64>);

impl CosineSeries {
    /// The series of as many terms as values, over `scale`, that goes through them at [`angles`].
    fn through(values: &[f64], scale: f64) -> Self {
        let n = values.len();
        // cos(k (2j + 1) π / 2n) has 4n different values.
        let circle: Vec<f64> = (0..4 * n).map(|m| (PI * m as f64 / (2.0 * n as f64)).cos()).collect();
        let coefficient = |k: usize| {
            let (mut place, mut sum) = (k, 0.0);
            for value in values {
                sum += value / scale * circle[place];
                place += 2 * k;
                if place >= 4 * n {
                    place -= 4 * n;
                }
            }
            sum * if k == 0 { 1.0 } else { 2.0 } / n as f64
        };
        Self((0..n).map(coefficient).collect())
    }

    /// Values at angles, by Clenshaw's recurrence on several at once.
    fn at(&self, theta: &[f64]) -> Vec<f64> {
        let mut values = Vec::with_capacity(theta.len());
        for chunk in theta.chunks(LANES) {
            let mut cosine = [0.0; LANES];
            cosine.iter_mut().zip(chunk).for_each(|(c, t)| *c = t.cos());
            let twice = cosine.map(|c| 2.0 * c);
            let (mut b1, mut b2) = ([0.0; LANES], [0.0; LANES]);
            for &c in self.0[1..].iter().rev() {
                for lane in 0..LANES {
                    let b = c + twice[lane] * b1[lane] - b2[lane];
                    b2[lane] = b1[lane];
                    b1[lane] = b;
                }
            }
            values.extend((0..chunk.len()).map(|lane| self.0[0] + cosine[lane] * b1[lane] - b2[lane]));
        }
        values
    }
}
