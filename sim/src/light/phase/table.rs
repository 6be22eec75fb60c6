//! Phase functions given as a table over the scattering angle, linear in the angle between nodes.
//!
//! The value keeps that contract exactly. Samples follow the same density to [`SAMPLING_ERROR`] in the cumulative
//! distribution, far below what any Monte Carlo run resolves, and cost one square root.

use super::PhaseError;
use super::inverse::{Cells, angle, versine};
use std::f64::consts::PI;

/// Largest distance of a table's ends from 0 and π that is taken for rounding, in radians.
const END_TOLERANCE_RAD: f64 = 1e-6;

/// Largest distance of the sampled from the evaluated cumulative distribution: an expectation of a function between 0
/// and 1 of the direction is off by less than this times the function's total variation.
pub const SAMPLING_ERROR: f64 = 1e-8;

/// Widest piece on which p(θ) sin θ is integrated as one: 6 Gauss points leave 1e-17 there.
const PIECE_RAD: f64 = 0.2;

/// A tabulated phase function, normalised at construction.
#[derive(Debug, Clone)]
pub struct PhaseTable {
    theta_rad: Vec<f64>,
    /// 1 − cos θ of the nodes.
    versine: Vec<f64>,
    value: Vec<f64>,
    cells: Cells,
}

impl PhaseTable {
    /// Makes a phase function from values `p11` at the scattering angles `theta_rad` (rising from 0 to π), linear in
    /// the angle between nodes, and renormalises it. Returns the norm ½∫p sin θ dθ that was found.
    ///
    /// # Errors
    ///
    /// [`PhaseError`] for fewer than two nodes, angles that do not rise from 0 to π, negative or undefined values, and
    /// a table that is zero everywhere.
    pub fn new(theta_rad: &[f64], p11: &[f64]) -> Result<(Self, f64), PhaseError> {
        if theta_rad.len() != p11.len() || theta_rad.len() < 2 {
            return Err(PhaseError::Length { angles: theta_rad.len(), values: p11.len() });
        }
        let mut theta = theta_rad.to_vec();
        let last = theta.len() - 1;
        if theta[0].is_nan() || theta[0].abs() > END_TOLERANCE_RAD {
            return Err(PhaseError::Angle { entry: 0 });
        }
        if theta[last].is_nan() || (theta[last] - PI).abs() > END_TOLERANCE_RAD {
            return Err(PhaseError::Angle { entry: last });
        }
        theta[0] = 0.0;
        theta[last] = PI;
        if let Some(entry) = (1..=last)
            .find(|&i| !matches!(theta[i].partial_cmp(&theta[i - 1]), Some(std::cmp::Ordering::Greater)))
        {
            return Err(PhaseError::Angle { entry });
        }
        if let Some(entry) = p11.iter().position(|&p| !(p.is_finite() && p >= 0.0)) {
            return Err(PhaseError::Value { entry });
        }
        // A spike of 1e300 must not overflow the sum.
        let peak = p11.iter().fold(0.0_f64, |peak, &p| peak.max(p));
        if peak <= 0.0 {
            return Err(PhaseError::Zero);
        }
        let mut value: Vec<f64> = p11.iter().map(|&p| p / peak).collect();
        let cells = Cells::new(&pieces(&theta), SAMPLING_ERROR, &|at| {
            at.iter().map(|&t| linear(&theta, &value, t)).collect()
        })
        .ok_or(PhaseError::Zero)?;
        let norm = cells.norm;
        value.iter_mut().for_each(|v| *v /= norm);
        let versine = theta.iter().map(|&t| versine(t)).collect();
        Ok((Self { theta_rad: theta, versine, value, cells }, norm * peak))
    }

    /// The normalised phase function at the cosine of the scattering angle.
    pub fn value(&self, cosine: f64) -> f64 {
        self.at_versine(1.0 - cosine.clamp(-1.0, 1.0))
    }

    /// The scattering angles of the nodes in radians.
    pub fn theta_rad(&self) -> &[f64] {
        &self.theta_rad
    }

    /// Largest distance of the sampled cumulative distribution from that of the table, and the number of cells that
    /// the sampler needs for it.
    pub fn sampling(&self) -> (f64, usize) {
        (self.cells.error, self.cells.len())
    }

    #[inline]
    pub(super) fn at_versine(&self, versine: f64) -> f64 {
        let i = self.versine.partition_point(|&v| v <= versine).clamp(1, self.versine.len() - 1);
        let (t0, t1) = (self.theta_rad[i - 1], self.theta_rad[i]);
        let f = ((angle(versine) - t0) / (t1 - t0)).clamp(0.0, 1.0);
        self.value[i - 1] * (1.0 - f) + self.value[i] * f
    }

    /// What samples, and all integrals.
    pub(super) fn cells(&self) -> &Cells {
        &self.cells
    }
}

/// Node angles with those between, so that no piece is wider than [`PIECE_RAD`].
fn pieces(theta: &[f64]) -> Vec<f64> {
    let mut bounds = vec![0.0];
    for t in theta.windows(2) {
        let parts = ((t[1] - t[0]) / PIECE_RAD).ceil().max(1.0);
        let mut part = 1.0;
        while part < parts {
            bounds.push(t[0] + (t[1] - t[0]) * part / parts);
            part += 1.0;
        }
        bounds.push(t[1]);
    }
    bounds
}

fn linear(theta: &[f64], value: &[f64], at: f64) -> f64 {
    let i = theta.partition_point(|&t| t <= at).clamp(1, theta.len() - 1);
    let f = (at - theta[i - 1]) / (theta[i] - theta[i - 1]);
    value[i - 1] * (1.0 - f) + value[i] * f
}
