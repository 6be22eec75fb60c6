//! Scattering without its forward peak: what is deflected by less than an angle counts as not scattered at all.
//!
//! Both ways keep the mean cosine of all light, fraction + (1 − fraction) · g′ = g, so that diffusion stays the same.
//! What they change is known: the scattering operator is diagonal in Legendre polynomials, and the change of each
//! eigenvalue says how far an angular structure of that order is wrong per scattering. Off unless asked for.

use super::cells::PhaseCells;
use super::inverse::{Cells, versine};
use super::{PhaseError, PhaseFunction};
use crate::light::quadrature::gauss_legendre;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Error of the cumulative distribution of a truncated phase function.
const DISTRIBUTION_ERROR: f64 = 1e-7;

/// Highest order that the error estimate looks at; beyond it the whole fraction counts as wrong.
const ORDER_MAX: usize = 1000;

/// A phase function without its forward peak.
#[derive(Debug, Clone)]
pub struct Truncation {
    /// Share of the scattered light that counts as not scattered, in [0, 1].
    pub fraction: f64,
    /// How the rest is scattered.
    pub phase: PhaseFunction,
    /// How it was made.
    pub form: Form,
    original: PhaseFunction,
}

/// How a truncated phase function is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// Nothing was cut off: there is no peak.
    Whole,
    /// The first moments of a Legendre series, all scaled: exact for structures below this order.
    DeltaM {
        /// Number of moments kept.
        order: usize,
    },
    /// All light within a cone, and an isotropic part that makes up for its mean deflection.
    Cone {
        /// Half angle in radians.
        half_angle_rad: f64,
    },
}

/// The delta-M method of order N (Wiscombe, J. Atmos. Sci. 34, 1408, 1977): the fraction is the moment χ_N, and
/// χ′_l = (χ_l − χ_N) / (1 − χ_N) below N.
///
/// Where the series of those moments is negative at some angle it is no density to sample from; then a cone with that
/// fraction is cut off instead, and [`Truncation::form`] says so.
///
/// # Errors
///
/// [`PhaseError::Zero`] for order 0.
pub fn delta_m(phase: &PhaseFunction, order: usize) -> Result<Truncation, PhaseError> {
    if order == 0 {
        return Err(PhaseError::Zero);
    }
    let chi = moments(phase, order + 1);
    let fraction = chi[order];
    if fraction >= 1.0 - f64::EPSILON {
        return Ok(nothing_left(phase));
    }
    if fraction <= 0.0 {
        return Ok(whole(phase));
    }
    let scaled: Vec<f64> = chi[..order].iter().map(|c| (c - fraction) / (1.0 - fraction)).collect();
    // A polynomial of degree N − 1 cannot dip below zero unseen between 16 angles per wave.
    let steps = 16 * order.max(16);
    let bounds: Vec<f64> = (0..=steps).map(|i| PI * i as f64 / steps as f64).collect();
    let series = |theta: &f64| legendre_series(&scaled, theta.cos());
    if bounds.iter().any(|theta| series(theta) < 0.0) {
        let half_angle_rad = super::inverse::angle(1.0 - phase.sample(1.0 - fraction)).min(FRAC_PI_2);
        // A share below the rounding of one is no peak.
        return if half_angle_rad > 0.0 { cone(phase, half_angle_rad) } else { Ok(whole(phase)) };
    }
    let cells = Cells::new(&bounds, DISTRIBUTION_ERROR, &|at| at.iter().map(series).collect())
        .ok_or(PhaseError::Zero)?;
    let form = Form::DeltaM { order };
    let phase_left = PhaseFunction::Cells(Arc::new(PhaseCells::new(cells)));
    Ok(Truncation { fraction, phase: phase_left, form, original: phase.clone() })
}

/// Cuts off all light within `half_angle_rad`: the fraction is ½∫p μ dμ over the cone, and ½∫p (1 − μ) dμ over the
/// cone is spread over all angles. The rest is never negative.
///
/// # Errors
///
/// [`PhaseError::Cone`] for an angle that is not within (0, π/2].
pub fn cone(phase: &PhaseFunction, half_angle_rad: f64) -> Result<Truncation, PhaseError> {
    if !(half_angle_rad > 0.0 && half_angle_rad <= FRAC_PI_2) {
        return Err(PhaseError::Cone { half_angle_rad });
    }
    if let PhaseFunction::HenyeyGreenstein { asymmetry } = phase
        && asymmetry.abs() >= 1.0
    {
        return Ok(if *asymmetry > 0.0 { nothing_left(phase) } else { whole(phase) });
    }
    let mut bounds = phase.smooth_between();
    let at = bounds.partition_point(|&t| t < half_angle_rad);
    bounds.insert(at, half_angle_rad);
    let inside = masses(phase, &bounds[..=at]);
    let (mut share, mut spread) = (0.0, 0.0);
    for (v, mass) in inside {
        share += mass;
        spread += mass * v;
    }
    let fraction = share - spread;
    if fraction <= 0.0 {
        return Ok(whole(phase));
    }
    let left =
        |theta: &f64| spread + if *theta < half_angle_rad { 0.0 } else { phase.at_versine(versine(*theta)) };
    let Some(cells) = Cells::new(&bounds, DISTRIBUTION_ERROR, &|at: &[f64]| at.iter().map(left).collect())
    else {
        return Ok(nothing_left(phase));
    };
    let form = Form::Cone { half_angle_rad };
    let phase_left = PhaseFunction::Cells(Arc::new(PhaseCells::new(cells)));
    Ok(Truncation { fraction, phase: phase_left, form, original: phase.clone() })
}

fn whole(phase: &PhaseFunction) -> Truncation {
    Truncation { fraction: 0.0, phase: phase.clone(), form: Form::Whole, original: phase.clone() }
}

/// All light goes straight on.
fn nothing_left(phase: &PhaseFunction) -> Truncation {
    let form = Form::Cone { half_angle_rad: 0.0 };
    Truncation { fraction: 1.0, phase: PhaseFunction::Isotropic, form, original: phase.clone() }
}

impl Truncation {
    /// Scattering coefficient of what is left: (1 − f) k_sca.
    pub fn scattering(&self, k_sca: f64) -> f64 {
        (1.0 - self.fraction) * k_sca
    }

    /// Extinction, or optical depth, without the light that goes straight on: (1 − ω f) k_ext. Absorption is unchanged.
    pub fn extinction(&self, k_ext: f64, albedo: f64) -> f64 {
        (1.0 - albedo * self.fraction) * k_ext
    }

    /// Scattering over extinction of what is left: ω (1 − f) / (1 − ω f).
    pub fn albedo(&self, albedo: f64) -> f64 {
        let left = 1.0 - albedo * self.fraction;
        if left > 0.0 { (albedo * (1.0 - self.fraction) / left).min(1.0) } else { 0.0 }
    }

    /// p(μ) / (1 − ω f) with the original phase function: times the albedo ω it is the source of light scattered once
    /// along paths of the truncated optical depth (the TMS correction of Nakajima and Tanaka, J. Quant. Spectrosc.
    /// Radiat. Transfer 40, 51, 1988). It takes the place of ω′ p′ in the first order, outside the peak itself, which
    /// the transmitted light already contains; outside a cone it differs from ω′ p′ by the isotropic part only.
    pub fn single_scattering(&self, albedo: f64, cosine: f64) -> f64 {
        self.original.value(cosine) / (1.0 - albedo * self.fraction)
    }

    /// Change of the eigenvalue of scattering for structures of orders 0 … `count` − 1, per scattering of the
    /// original: (1 − χ_l) − (1 − f)(1 − χ′_l). Zero for orders 0 and 1.
    pub fn eigenvalue_errors(&self, count: usize) -> Vec<f64> {
        let before = moments(&self.original, count);
        let after = moments(&self.phase, count);
        let left = 1.0 - self.fraction;
        before.iter().zip(&after).map(|(b, a)| (1.0 - b) - left * (1.0 - a)).collect()
    }

    /// Estimate of the rms change, over all directions, of a coefficient (the share of light from one source) after
    /// `mean_scatterings` scatterings of the original medium, for a source with a sharp edge that looks `size_rad`
    /// wide.
    ///
    /// To first order the radiance changes by Σ ΔK L per scattering. A source of contrast 1 is ±½ about its mean, with
    /// a power spectrum like 1/(l² + l₀²), l₀ = π/size, that of a step; each order is off by its eigenvalue error.
    pub fn error(&self, mean_scatterings: f64, size_rad: f64) -> f64 {
        let start = PI / size_rad.clamp(1e-6, PI);
        let power = |l: f64| 1.0 / (l * l + start * start);
        let (mut total, mut wrong) = (0.0, 0.0);
        for (l, error) in self.eigenvalue_errors(ORDER_MAX).into_iter().enumerate().skip(1) {
            total += power(l as f64);
            wrong += power(l as f64) * error * error;
        }
        // The rest of the series, by its integral.
        let rest = (start / ORDER_MAX as f64).atan() / start;
        total += rest;
        wrong += rest * self.fraction * self.fraction;
        (0.5 * mean_scatterings.max(0.0) * (wrong / total).sqrt()).min(1.0)
    }

    /// Root mean square angle in radians by which the light that a cone lets pass is really deflected per scattering:
    /// √(2 ⟨1 − μ⟩) over the cone. Zero for the other forms.
    pub fn deflection_rad(&self) -> f64 {
        let Form::Cone { half_angle_rad } = self.form else { return 0.0 };
        if half_angle_rad <= 0.0 {
            return 0.0;
        }
        let share = self.original.within(half_angle_rad.cos());
        if share > 0.0 { (2.0 * (share - self.fraction).max(0.0) / share).sqrt() } else { 0.0 }
    }
}

/// Legendre moments χ_l = ½∫p P_l dμ for l = 0 … `count` − 1.
pub fn moments(phase: &PhaseFunction, count: usize) -> Vec<f64> {
    if let PhaseFunction::HenyeyGreenstein { asymmetry } = phase {
        let mut power = 1.0;
        return (0..count)
            .map(|_| {
                let own = power;
                power *= asymmetry;
                own
            })
            .collect();
    }
    // At most half a wave of P_l on a piece.
    let mut bounds = phase.smooth_between();
    let step = PI / count.max(1) as f64;
    let mut between = Vec::new();
    for t in bounds.windows(2) {
        let parts = ((t[1] - t[0]) / step).ceil();
        let mut part = 1.0;
        while part < parts {
            between.push(t[0] + (t[1] - t[0]) * part / parts);
            part += 1.0;
        }
    }
    bounds.extend(between);
    bounds.sort_unstable_by(f64::total_cmp);
    let mut chi = vec![0.0; count];
    for (v, mass) in masses(phase, &bounds) {
        let mu = 1.0 - v;
        let (mut before, mut now) = (0.0, 1.0);
        for (l, chi) in chi.iter_mut().enumerate() {
            *chi += mass * now;
            let l = l as f64;
            (before, now) = (now, ((2.0 * l + 1.0) * mu * now - l * before) / (l + 1.0));
        }
    }
    // The rule leaves 1e-9 of the norm at a kink of the function; the moments are those of a normalised one.
    let norm = chi.first().copied().unwrap_or(1.0);
    chi.iter_mut().for_each(|chi| *chi /= norm);
    chi
}

/// Versines and masses of a Gauss rule between bounds.
fn masses(phase: &PhaseFunction, bounds: &[f64]) -> Vec<(f64, f64)> {
    let rule = gauss_legendre(6);
    bounds
        .windows(2)
        .flat_map(|t| {
            let half = 0.5 * (t[1] - t[0]);
            rule.iter().map(move |(x, w)| {
                let theta = t[0] + half * (1.0 + x);
                let v = versine(theta);
                (v, 0.5 * half * w * theta.sin() * phase.at_versine(v))
            })
        })
        .collect()
}

/// Σ (2l + 1) χ_l P_l(μ).
fn legendre_series(chi: &[f64], mu: f64) -> f64 {
    let (mut before, mut now, mut sum) = (0.0, 1.0, 0.0);
    for (l, c) in chi.iter().enumerate() {
        let l = l as f64;
        sum += (2.0 * l + 1.0) * c * now;
        (before, now) = (now, ((2.0 * l + 1.0) * mu * now - l * before) / (l + 1.0));
    }
    sum
}

#[cfg(test)]
#[path = "truncation_tests.rs"]
mod tests;
