//! The phase functions of all groups as paths need them: one direction for all, and each group's weight.
//!
//! A direction is drawn from the phase function of one group chosen at random; the weights are those of the balance
//! heuristic (E. Veach, 1997), p_g over the mean of all p. A lone group is sampled by its own phase function, exactly,
//! with weight 1.

use super::spectrum::{Spectrum, narrow};
use crate::light::phase::PhaseFunction;

/// Bins per octave of 1 − cos θ, as a power of two.
const OCTAVE_BITS: u32 = 5;

/// Octaves down to 1 − cos θ = 2^−34, an angle of 1e-5 rad.
const OCTAVES: u32 = 35;

/// What a peak of any width counts at most; keeps ratios finite.
const VALUE_MAX: f64 = 1e12;

/// Phase functions of groups in lanes.
pub(super) struct Scatter<'a, S> {
    phases: &'a [PhaseFunction],
    /// p over the mean of all groups' p at the edges of logarithmic bins; empty where all weights are 1.
    weight: Vec<S>,
}

impl<'a, S: Spectrum> Scatter<'a, S> {
    /// Tabulates the weights: linear between bins, so a weight is off by up to 5e-4 of itself for smooth functions.
    pub(super) fn new(phases: &'a [PhaseFunction]) -> Self {
        let alike = phases.windows(2).all(|p| same(&p[0], &p[1]));
        if alike {
            return Self { phases, weight: Vec::new() };
        }
        let bins = OCTAVES << OCTAVE_BITS;
        let weight = (0..=bins)
            .map(|bin| {
                let cosine = 1.0 - edge(bin);
                let values: Vec<f64> = phases.iter().map(|p| p.value(cosine).min(VALUE_MAX)).collect();
                #[expect(clippy::cast_precision_loss, reason = "at most 64 groups")]
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                let mut weight = S::ZERO;
                for (g, value) in values.iter().enumerate() {
                    weight.set(g, if mean > 0.0 { narrow(value / mean) } else { 1.0 });
                }
                weight
            })
            .collect();
        Self { phases, weight }
    }

    /// Cosine of a scattering angle for `u` in (0, 1), from the group that `choice` in (0, 1) picks, and the weights.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "choice is in (0, 1), at most 64 groups"
    )]
    pub(super) fn sample(&self, u: f64, choice: f64) -> (f64, S) {
        if self.weight.is_empty() {
            return (self.phases[0].sample(u), S::splat(1.0));
        }
        let group = ((choice * self.phases.len() as f64) as usize).min(self.phases.len() - 1);
        let cosine = self.phases[group].sample(u);
        (cosine, self.weights(1.0 - cosine))
    }

    #[inline(always)]
    fn weights(&self, versine: f64) -> S {
        let (bin, f) = place(versine);
        let low = self.weight[bin];
        low.plus(self.weight[bin + 1].minus(low).scaled(f))
    }
}

/// Whether two phase functions are the same for certain.
fn same(a: &PhaseFunction, b: &PhaseFunction) -> bool {
    match (a, b) {
        (PhaseFunction::Isotropic, PhaseFunction::Isotropic)
        | (PhaseFunction::Rayleigh, PhaseFunction::Rayleigh) => true,
        (
            PhaseFunction::HenyeyGreenstein { asymmetry: a },
            PhaseFunction::HenyeyGreenstein { asymmetry: b },
        ) => a.to_bits() == b.to_bits(),
        (PhaseFunction::Table(a), PhaseFunction::Table(b)) => std::sync::Arc::ptr_eq(a, b),
        (PhaseFunction::Cells(a), PhaseFunction::Cells(b)) => std::sync::Arc::ptr_eq(a, b),
        _ => false,
    }
}

const SHIFT: u32 = 52 - OCTAVE_BITS;

/// The leading bits of 2^(1 − OCTAVES), the smallest versine of the table.
const SMALLEST: u64 = ((1024 - OCTAVES as u64) << 52) >> SHIFT;

/// 1 − cos θ at the lower edge of a bin; the first bin begins at 0.
fn edge(bin: u32) -> f64 {
    if bin == 0 { 0.0 } else { f64::from_bits((SMALLEST + u64::from(bin)) << SHIFT).min(2.0) }
}

/// The bin of a versine and the place in it.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "at most OCTAVES << OCTAVE_BITS bins")]
fn place(versine: f64) -> (usize, f32) {
    let lowest = f64::from_bits(SMALLEST << SHIFT);
    let clamped = versine.clamp(lowest, 2.0 * (1.0 - f64::EPSILON));
    let bits = clamped.to_bits();
    let bin = ((bits >> SHIFT) - SMALLEST) as usize;
    let low = f64::from_bits((bits >> SHIFT) << SHIFT);
    let high = f64::from_bits(((bits >> SHIFT) + 1) << SHIFT);
    (bin, narrow((clamped - low) / (high - low)))
}

#[cfg(test)]
mod tests {
    use super::super::spectrum::Lane;
    use super::*;

    /// Averages over the samples equal integrals over each group's own phase function.
    #[test]
    fn weights_turn_the_mixture_into_each_group() {
        let phases = [
            PhaseFunction::HenyeyGreenstein { asymmetry: 0.95 },
            PhaseFunction::Isotropic,
            PhaseFunction::HenyeyGreenstein { asymmetry: -0.3 },
            PhaseFunction::Rayleigh,
        ];
        let scatter = Scatter::<[Lane; 1]>::new(&phases);
        let n = 40_000;
        let (mut mean, mut norm) = ([0.0; 4], [0.0; 4]);
        for i in 0..n {
            let (u, choice) = ((f64::from(i) + 0.5) / f64::from(n), f64::from(i % 4) / 4.0 + 0.1);
            let (cosine, weight) = scatter.sample((u * 7919.0).fract(), choice);
            for g in 0..4 {
                norm[g] += f64::from(weight.get(g)) / f64::from(n);
                mean[g] += cosine * f64::from(weight.get(g)) / f64::from(n);
            }
        }
        for (g, phase) in phases.iter().enumerate() {
            assert!((norm[g] - 1.0).abs() < 2e-3, "group {g}: {}", norm[g]);
            assert!((mean[g] - phase.mean_cosine()).abs() < 2e-3, "group {g}: {}", mean[g]);
        }
    }

    #[test]
    fn a_lone_group_has_weight_one() {
        let phases = [PhaseFunction::HenyeyGreenstein { asymmetry: 0.8 }];
        let scatter = Scatter::<[Lane; 1]>::new(&phases);
        for i in 0..100 {
            let u = (f64::from(i) + 0.5) / 100.0;
            let (cosine, weight) = scatter.sample(u, 0.5);
            assert_eq!(cosine.to_bits(), phases[0].sample(u).to_bits());
            assert_eq!(weight.get(0).to_bits(), 1.0_f32.to_bits());
        }
    }

    #[test]
    fn bins_cover_all_angles() {
        for versine in [0.0, 1e-300, 1e-12, 0.3, 1.0, 1.999_999, 2.0] {
            let (bin, f) = place(versine);
            assert!((0.0..=1.0).contains(&f) && bin < (OCTAVES << OCTAVE_BITS) as usize, "{versine}");
            let low = edge(u32::try_from(bin).unwrap());
            let high = edge(u32::try_from(bin + 1).unwrap());
            assert!(versine < 1e-10 || (low <= versine && versine <= high), "{versine} {low} {high}");
        }
    }
}
