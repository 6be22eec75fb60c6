//! What a cloud of droplets needs at one wavelength: mean efficiencies, mean cosine, and the angular pattern.
//!
//! Both are sums over the size distribution, each with as many radii as its own error wants: absorption of weakly
//! absorbing droplets needs thousands (ripple and whispering-gallery lines), the pattern a few hundred.

use super::pattern::Pattern;
use super::polydisperse::{Effort, Lognormal, Polydisperse, means};
use super::{MieError, Sphere};

/// Means and pattern of a size distribution at one wavelength.
#[derive(Debug, Clone, PartialEq)]
pub struct Bulk {
    /// Efficiencies and mean cosine, with their number of radii and their error.
    pub means: Polydisperse,
    /// The pattern, normalised so that ½∫ of it over cos θ is 1; empty when nothing scatters.
    pub pattern: Pattern,
    /// Intervals of ln r behind the pattern, of which those that weigh nothing are left out.
    pub pattern_radii: usize,
    /// Estimated error of the pattern's cumulative distribution: its largest change when that number was last doubled,
    /// times the square root of how much this change had fallen.
    pub pattern_error: f64,
}

/// Mean efficiencies, mean cosine and pattern over `sizes` at one wavelength and index.
///
/// The means to a relative error of `target` as [`lognormal`](super::lognormal), the cumulative distribution of the pattern to an
/// absolute one, each judged by the last doublings of its number of radii; sizes that weigh less than 0.03 `target` of
/// the heaviest are left out of the pattern. Runs on rayon's threads; the answer does not depend on their number.
///
/// # Errors
///
/// As [`lognormal`](super::lognormal).
pub fn bulk(sizes: Lognormal, wavelength_um: f64, n: f64, k: f64, target: f64) -> Result<Bulk, MieError> {
    bulk_with(sizes, wavelength_um, n, k, &Effort::to(target))
}

/// [`bulk`] with an effort.
///
/// # Errors
///
/// As [`lognormal`](super::lognormal).
pub fn bulk_with(
    sizes: Lognormal,
    wavelength_um: f64,
    n: f64,
    k: f64,
    effort: &Effort,
) -> Result<Bulk, MieError> {
    let means = means(sizes, wavelength_um, n, k, effort)?;
    let x_median = sizes.median_size_parameter(wavelength_um)?;
    let over = |nodes: &[(f64, f64)]| {
        let heaviest = nodes.iter().fold(0.0f64, |heaviest, node| heaviest.max(node.1));
        let kept = nodes.iter().filter(|node| node.1 > 0.03 * effort.target * heaviest);
        // Number of droplets ∝ area/x².
        let (spheres, numbers): (Vec<Sphere>, Vec<f64>) =
            kept.map(|&(x, weight)| (Sphere { size_parameter: x, n, k }, weight / (x * x))).unzip();
        Pattern::of(&spheres, &numbers).map_err(|(_, error)| error)
    };
    if sizes.sigma_ln == 0.0 {
        let pattern = over(&[(x_median, 1.0)])?.normalised();
        return Ok(Bulk { means, pattern, pattern_radii: 1, pattern_error: 0.0 });
    }
    let rule = sizes.rule(x_median);
    let [mut radii, last] = effort.pattern_radii.map(|radii| radii.max(1));
    let mut sum = over(&rule.first(radii))?;
    // Nothing is known of the first change.
    let mut before = 0.0;
    loop {
        let finer = sum.clone().and(&over(&rule.between(radii))?);
        radii *= 2;
        // The largest of many angles: no small change by luck, as one number could have. What is left is smaller than
        // the change by as much as that fell, in 40 trials by its square root at least (the error was at most 3.3
        // times this where it was above 3e-6, and a fifth of it as a rule).
        let change = finer.distance(&sum);
        let fall = if before > 0.0 { (change / before).clamp(0.25, 1.0) } else { 1.0 };
        let error = change * fall.sqrt();
        before = change;
        if (effort.adaptive && error <= effort.target) || radii >= last {
            return Ok(Bulk {
                means,
                pattern: finer.normalised(),
                pattern_radii: radii,
                pattern_error: error,
            });
        }
        sum = finer;
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Direction, cumulative, lognormal};
    use super::*;

    #[test]
    fn means_and_pattern_agree_with_each_other_at_every_absorption() {
        for (n, k) in [(1.38, 0.09), (1.4, 2e-3), (1.38, 6e-4)] {
            let sizes = Lognormal { median_radius_um: 5.0, sigma_ln: 0.4 };
            let found = bulk(sizes, 3.4, n, k, 1e-4).unwrap();
            println!(
                "{n} {k}: {} and {} radii, {:e} and {:e}",
                found.means.radii, found.pattern_radii, found.means.error, found.pattern_error
            );
            assert!(found.means.error <= 1e-4 && found.pattern_error <= 1e-4);
            assert!((found.pattern.total() - 1.0).abs() < 1e-12);
            // The mean cosine moves by at most 2 max|ΔCDF|.
            assert!((found.pattern.mean_cosine() - found.means.asymmetry).abs() < 3e-4);
            let finer = bulk(sizes, 3.4, n, k, 1e-6).unwrap().pattern;
            assert!(found.pattern.distance(&finer) < 3.3 * found.pattern_error + 1e-6, "{n} {k}");
            let fine = lognormal(sizes, 3.4, n, k, 1e-8).unwrap();
            for (own, fine) in [
                (found.means.q_ext, fine.q_ext),
                (found.means.q_sca, fine.q_sca),
                (found.means.q_abs, fine.q_abs),
                (found.means.asymmetry, fine.asymmetry),
            ] {
                assert!(
                    (own / fine - 1.0).abs() < 2.0 * found.means.error.max(1e-8),
                    "{n} {k}: {own} {fine}"
                );
            }
        }
    }

    #[test]
    fn a_number_of_radii_is_kept_and_its_error_told() {
        let sizes = Lognormal { median_radius_um: 5.0, sigma_ln: 0.5 };
        let found = bulk_with(sizes, 4.0, 1.38, 5e-4, &Effort::of_radii(1e-4, 1024, 128)).unwrap();
        assert_eq!((found.means.radii, found.pattern_radii), (1024, 128));
        let fine = lognormal(sizes, 4.0, 1.38, 5e-4, 1e-7).unwrap();
        let error = (found.means.q_abs / fine.q_abs - 1.0).abs();
        // Far too few for this absorption, and it says so.
        assert!(error > 1e-4 && error < 3.0 * found.means.error, "{error:e} {:e}", found.means.error);
        assert!(found.pattern_error > 1e-4);
    }

    #[test]
    fn one_size_has_the_distribution_of_its_sphere() {
        let sizes = Lognormal { median_radius_um: 10.0, sigma_ln: 0.0 };
        let found = bulk(sizes, 3.4, 1.38, 0.09, 1e-4).unwrap();
        let sphere = Sphere { size_parameter: 2.0 * std::f64::consts::PI * 10.0 / 3.4, n: 1.38, k: 0.09 };
        for degrees in [0.5, 2.0, 10.0, 60.0, 150.0, 180.0] {
            let exact = cumulative(sphere, &[Direction::from_degrees(degrees).unwrap()]).unwrap()[0];
            let own = found.pattern.within().at(f64::to_radians(degrees).cos());
            assert!((own - exact).abs() < 1e-8, "{degrees}: {own} {exact}");
        }
    }
}
