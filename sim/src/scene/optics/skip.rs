//! What need not be computed, and what leaving it out can cost at most.
//!
//! Skips by proof only: each one has a bound of the error of any coefficient of any sight.

/// Share of the error wanted that a skip may use; the rest is for the noise of the tracer.
const SHARE: f64 = 0.5;
/// Bound of half the absolute difference of a sphere's phase function from Rayleigh's (its distance in probability)
/// over (max(|m|, 1) x)²: 0.1113 is the largest found for n 0.5 … 5, k 0 … 3 and sizes up to [`SMALL_MAX`].
const SMALL_DISTANCE: f64 = 0.12;
/// Largest max(|m|, 1) x at which that bound is used.
const SMALL_MAX: f64 = 0.3;

/// A kind of work that can be left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// Mie calculations of cross-sections and patterns.
    Mie,
    /// The table of the vapour's cross-sections.
    Vapour,
    /// The tabulated phase function.
    Phase,
}

impl Work {
    /// Its name in statistics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mie => "mie",
            Self::Vapour => "vapour",
            Self::Phase => "phase",
        }
    }
}

/// Work that was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skip {
    /// What.
    pub work: Work,
    /// Why, for people.
    pub reason: &'static str,
    /// In how many spectral groups.
    pub groups: usize,
    /// Most that a coefficient of any sight can be off by it, absolute.
    pub admitted_error: f64,
}

/// How the phase function of a group is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Choice {
    Table,
    Isotropic(&'static str, f64),
    Rayleigh(&'static str, f64),
}

impl Choice {
    /// For the largest albedo of any cell and the largest max(|m|, 1) x of any droplet.
    ///
    /// Light that is not scattered does not care: paths with and without the right phase function are the same up to
    /// the first scattering, which a share of at most the albedo reaches. With Rayleigh's function they part at each
    /// scattering with at most the distance of both functions; there are ω + ω² + … = ω/(1 − ω) of them on average.
    pub(super) fn new(albedo: f64, size: f64, target: f64) -> Self {
        let allowed = SHARE * target;
        if albedo <= 0.0 {
            return Self::Isotropic("nothing scatters", 0.0);
        }
        if albedo <= allowed {
            return Self::Isotropic("the albedo is below the error wanted", albedo);
        }
        let small = SMALL_DISTANCE * size * size * albedo / (1.0 - albedo);
        if size <= SMALL_MAX && small <= allowed {
            return Self::Rayleigh("the droplets are far smaller than the wavelength", small);
        }
        Self::Table
    }

    /// What this leaves out.
    fn skip(self) -> Option<Skip> {
        let (Self::Isotropic(reason, admitted_error) | Self::Rayleigh(reason, admitted_error)) = self else {
            return None;
        };
        Some(Skip { work: Work::Phase, reason, groups: 1, admitted_error })
    }
}

/// Skips of all groups, one for each reason.
pub(super) fn sum(choices: &[Choice]) -> Vec<Skip> {
    let mut list: Vec<Skip> = Vec::new();
    for skip in choices.iter().filter_map(|choice| choice.skip()) {
        match list.iter_mut().find(|known| known.reason == skip.reason) {
            Some(known) => {
                known.groups += 1;
                known.admitted_error = known.admitted_error.max(skip.admitted_error);
            }
            None => list.push(skip),
        }
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::mie::{Direction, Sphere, phase};
    use crate::light::quadrature::gauss_legendre;

    #[test]
    fn the_bound_of_small_spheres_holds() {
        let rule = gauss_legendre(48);
        let towards: Vec<Direction> =
            rule.iter().map(|&(mu, _)| Direction::from_cosine(mu).unwrap()).collect();
        let mut largest = 0.0_f64;
        for n in [0.5, 1.01, 1.2, 1.38, 1.6, 2.5, 5.0] {
            for k in [0.0, 1e-3, 0.1, 0.5, 3.0] {
                for size in [1e-4, 0.02, 0.1, 0.2, SMALL_MAX] {
                    let size_parameter = size / f64::max(f64::hypot(n, k), 1.0);
                    let p = phase(Sphere { size_parameter, n, k }, &towards).unwrap();
                    let distance: f64 = rule
                        .iter()
                        .zip(p)
                        .map(|(&(mu, w), p)| 0.25 * w * (p - 0.75 * (1.0 + mu * mu)).abs())
                        .sum();
                    // Below 1e-13 it is the rounding of the sum.
                    assert!(distance <= SMALL_DISTANCE * size * size + 1e-13, "{n} {k} {size}: {distance:e}");
                    largest = largest.max(distance / (size * size));
                }
            }
        }
        assert!(largest > 0.8 * SMALL_DISTANCE, "{largest}");
    }

    #[test]
    fn choices_never_admit_more_than_half_the_target() {
        for albedo in [0.0, 1e-9, 4e-4, 6e-4, 0.3, 1.0 - 1e-12, 1.0] {
            for size in [0.0, 1e-3, 0.1, 0.29, 0.31, 10.0] {
                for target in [1e-6, 1e-3, 0.1] {
                    match Choice::new(albedo, size, target).skip() {
                        Some(skip) => assert!(skip.admitted_error <= 0.5 * target),
                        None => assert!(albedo > 0.5 * target),
                    }
                }
            }
        }
        assert_eq!(Choice::new(f64::NAN, 1.0, 1e-3), Choice::Table);
        let parts = [Choice::new(1e-5, 9.0, 1e-3), Choice::new(0.5, 9.0, 1e-3), Choice::new(2e-5, 9.0, 1e-3)];
        let skips = sum(&parts);
        assert_eq!((skips.len(), skips[0].groups, skips[0].admitted_error), (1, 2, 2e-5));
    }
}
