//! The profile of fuel and velocity across a jet, and its moments.
//!
//! f(η) = (1 − η^α)², η = distance from the middle over the half width: Abramovich's profile of the developed jet is
//! α = 1.5 (Abramovich 1963, The Theory of Turbulent Jets); near the nozzle α grows until the profile is flat (Musculus
//! and Kattke 2009, SAE 2009-01-1355). In a round jet the mean is over the disc, in a sheet over the thickness.

/// Exponent of the developed jet.
pub(super) const DEVELOPED: f64 = 1.5;

/// Largest exponent: with it the profile is flat to 1e-6.
const ALPHA_MAX: f64 = 4e6;

/// How near an η is sought; 2⁻⁴⁰ with the quadratic convergence of the last step in hand.
const ETA_ERROR: f64 = 1e-12;

/// Steps to it at most: halving alone takes 40.
const ETA_STEPS: usize = 48;

/// Over what a profile is averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Across {
    /// A sheet: over its thickness.
    Sheet,
    /// A round jet: over its disc.
    Disc,
}

impl Across {
    fn dimension(self) -> f64 {
        match self {
            Self::Sheet => 1.0,
            Self::Disc => 2.0,
        }
    }

    /// The profile whose mean is `mean` of its middle (0 … 1), or the developed one if that is fuller.
    pub(super) fn with_mean(self, mean: f64) -> Profile {
        // 2α²/((α + n)(2α + n)) = mean.
        let (n, q) = (self.dimension(), mean.clamp(0.0, 1.0));
        let rest = (1.0 - q).max(1e-12);
        let alpha = n * (3.0 * q + (q * (q + 8.0)).sqrt()) / (4.0 * rest);
        Profile { across: self, alpha: alpha.clamp(DEVELOPED, ALPHA_MAX) }
    }
}

/// A profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Profile {
    across: Across,
    alpha: f64,
}

impl Profile {
    /// Mean of f.
    pub(super) fn mean(self) -> f64 {
        let (n, a) = (self.across.dimension(), self.alpha);
        2.0 * a * a / ((a + n) * (2.0 * a + n))
    }

    /// Mean of f² over the square of the mean of f: Musculus and Kattke's β, 1 when flat.
    pub(super) fn beta(self) -> f64 {
        let (n, a) = (self.across.dimension(), self.alpha);
        // Fourth powers as ratios: α may be large.
        let square = 24.0 / ((1.0 + n / a) * (2.0 + n / a) * (3.0 + n / a) * (4.0 + n / a));
        square / (self.mean() * self.mean())
    }

    /// Share of the fuel that is within η, 0 … 1.
    pub(super) fn within(self, eta: f64) -> f64 {
        let (n, a) = (self.across.dimension(), self.alpha);
        let eta = eta.clamp(0.0, 1.0);
        let power = eta.powf(a);
        let sum = 1.0 - 2.0 * n * power / (a + n) + n * power * power / (2.0 * a + n);
        (self.area(eta) * sum / self.mean()).clamp(0.0, 1.0)
    }

    /// η within which a share of the fuel is: the inverse of [`Profile::within`], to 2⁻⁴⁰.
    ///
    /// Newton's steps, kept between ends that enclose the answer; halved where they leave those.
    pub(super) fn eta(self, share: f64) -> f64 {
        if share >= 1.0 {
            return 1.0;
        }
        let (n, mean) = (self.across.dimension(), self.mean());
        let (mut low, mut high) = (0.0, 1.0);
        // What it is in the middle, where the profile is flat.
        let mut eta = (share.max(0.0) * mean).powf(1.0 / n);
        for _ in 0..ETA_STEPS {
            let missing = self.within(eta) - share;
            if missing < 0.0 {
                low = eta;
            } else {
                high = eta;
            }
            let edge = 1.0 - eta.powf(self.alpha);
            let slope = n * eta.powf(n - 1.0) * edge * edge / mean;
            let step = eta - missing / slope;
            let next = if step > low && step < high { step } else { 0.5 * (low + high) };
            let moved = (next - eta).abs();
            eta = next;
            if moved < ETA_ERROR {
                break;
            }
        }
        eta
    }

    /// η within which a share of the area is: the inverse of [`Profile::area`].
    pub(super) fn eta_of_area(self, share: f64) -> f64 {
        match self.across {
            Across::Sheet => share,
            Across::Disc => share.max(0.0).sqrt(),
        }
    }

    /// Share of the area (of the thickness of a sheet) within η.
    pub(super) fn area(self, eta: f64) -> f64 {
        match self.across {
            Across::Sheet => eta,
            Across::Disc => eta * eta,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::quadrature::gauss_legendre;

    /// Second source: quadrature of the profile itself.
    #[test]
    fn moments_are_those_of_the_profile() {
        let rule = gauss_legendre(64);
        for (across, n) in [(Across::Sheet, 1.0), (Across::Disc, 2.0)] {
            for mean in [0.0, 0.1, 0.5, 0.7] {
                let profile = across.with_mean(mean);
                let upto = |end: f64, power: i32| -> f64 {
                    rule.iter()
                        .map(|&(x, w)| {
                            let eta = 0.5 * end * (x + 1.0);
                            let f = (1.0 - eta.powf(profile.alpha)).powi(2);
                            0.5 * end * w * n * eta.powf(n - 1.0) * f.powi(power)
                        })
                        .sum()
                };
                assert!((profile.mean() - upto(1.0, 1)).abs() < 1e-5);
                assert!(mean < profile.mean() + 1e-12);
                assert!((profile.beta() - upto(1.0, 2) / upto(1.0, 1).powi(2)).abs() < 1e-4);
                assert!((profile.within(0.3) - upto(0.3, 1) / upto(1.0, 1)).abs() < 1e-5);
                for share in [0.0, 1e-6, 0.2, 0.9, 0.999, 1.0 - 1e-9, 1.0] {
                    let eta = profile.eta(share);
                    assert!((0.0..=1.0).contains(&eta) && (profile.within(eta) - share).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn a_flat_profile_is_flat_and_a_wanted_mean_is_met() {
        let flat = Across::Disc.with_mean(1.0);
        assert!((flat.mean() - 1.0).abs() < 1e-5 && (flat.beta() - 1.0).abs() < 1e-5);
        assert!((flat.within(0.5) - 0.25).abs() < 1e-5);
        for share in [0.01, 0.5, 0.999_999, 1.0] {
            assert!((flat.within(flat.eta(share)) - share).abs() < 1e-9);
        }
        for mean in [0.3, 0.6, 0.95] {
            assert!((Across::Disc.with_mean(mean).mean() - mean).abs() < 1e-12);
        }
        // Musculus and Kattke quote 2 for the developed round jet.
        assert!((Across::Disc.with_mean(0.0).beta() - 2.02).abs() < 0.01);
    }
}
