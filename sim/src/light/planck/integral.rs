//! Planck's law between two wavelengths, its derivative, and the temperature that belongs to an integral.
//!
//! One quadrature of the band itself in x = hc/(λkT), never a difference of integrals from 0: right for relative
//! widths down to the spacing of the numbers.

use super::{BOLTZMANN, FIRST_RADIANCE, SECOND_RADIATION_UM_K, exponent, exponent_and_rest};
use crate::light::quadrature::gauss_legendre;
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Photon exitance between two wavelengths, photons s⁻¹ m⁻². Zero unless `lam1_um` < `lam2_um`; the first may be 0,
/// the second infinite.
///
/// Relative error below 24 · 2⁻⁵³ for the two wavelengths as they are in f64 (their difference is exact up to a factor
/// of two between them), as long as the result is not subnormal.
pub fn photon_exitance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |_| 1.0).value()
}

/// Photon radiance between two wavelengths, photons s⁻¹ m⁻² sr⁻¹: the exitance over π.
pub fn photon_radiance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    photon_exitance_band(lam1_um, lam2_um, temperature_k) / PI
}

/// ln of [`photon_exitance_band`]: finite where the exitance itself underflows. Error below 2⁻⁵¹ |ln M| + 24 · 2⁻⁵³.
pub fn ln_photon_exitance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |_| 1.0).ln()
}

/// ∂/∂T of [`photon_exitance_band`], photons s⁻¹ m⁻² K⁻¹; error as there.
pub fn d_photon_exitance_band_dt(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    slope_band(lam1_um, lam2_um, temperature_k).value()
}

/// ln of [`d_photon_exitance_band_dt`].
pub fn ln_d_photon_exitance_band_dt(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    slope_band(lam1_um, lam2_um, temperature_k).ln()
}

/// Energy exitance between two wavelengths, W/m²; error as [`photon_exitance_band`].
pub fn energy_exitance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    let photon_energy = BOLTZMANN * temperature_k;
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |x| x * photon_energy).value()
}

/// The temperature in K whose [`photon_exitance_band`] is `exitance`.
///
/// `None` unless 0 ≤ `lam1_um` < `lam2_um`, the exitance is positive and finite, and the temperature is within 1e-30
/// to 1e30 K. Relative error below 30 · 2⁻⁵³, and less by ∂ ln M/∂ ln T in the Wien region.
pub fn inverse_photon_exitance_band(lam1_um: f64, lam2_um: f64, exitance: f64) -> Option<f64> {
    let wanted = (exitance > 0.0 && exitance.is_finite()).then_some(exitance)?;
    let ln_wanted = wanted.ln();
    temperature(lam1_um, lam2_um, |found| {
        let value = found.value();
        // Where both are ordinary numbers their ratio is good to rounding; the difference of logarithms is not.
        if value.is_normal() && value.is_finite() && wanted.is_normal() {
            let difference = (value - wanted) / wanted;
            if difference.abs() < 0.5 { difference.ln_1p() } else { found.ln() - ln_wanted }
        } else {
            found.ln() - ln_wanted
        }
    })
}

/// The temperature in K whose [`photon_radiance_band`] is `radiance`; as [`inverse_photon_exitance_band`].
pub fn inverse_photon_radiance_band(lam1_um: f64, lam2_um: f64, radiance: f64) -> Option<f64> {
    let exitance = PI * radiance;
    if exitance.is_normal() {
        inverse_photon_exitance_band(lam1_um, lam2_um, exitance)
    } else {
        (radiance > 0.0 && radiance.is_finite())
            .then(|| inverse_ln_photon_exitance_band(lam1_um, lam2_um, PI.ln() + radiance.ln()))?
    }
}

/// The temperature in K whose [`ln_photon_exitance_band`] is `ln_exitance`: also where the exitance underflows.
///
/// `None` as [`inverse_photon_exitance_band`]. Relative error below 30 · 2⁻⁵³ + 2⁻⁵² |ln M| / (∂ ln M/∂ ln T).
pub fn inverse_ln_photon_exitance_band(lam1_um: f64, lam2_um: f64, ln_exitance: f64) -> Option<f64> {
    if !ln_exitance.is_finite() {
        return None;
    }
    temperature(lam1_um, lam2_um, |found| found.ln() - ln_exitance)
}

/// Weight of ∂/∂ ln T.
fn log_slope(x: f64) -> f64 {
    x / (-(-x).exp_m1())
}

fn slope_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> BandIntegral {
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |x| log_slope(x) / temperature_k)
}

/// Temperatures within which inverses are looked for, K.
const TEMPERATURES_K: [f64; 2] = [1e-30, 1e30];
/// Rounds of an inverse. Ordinary ones need 2 to 8; with this many even bisection over the whole range has ended.
const ROUNDS_MAX: usize = 200;

/// The temperature at which `excess` (ln of found over wanted) vanishes.
///
/// Each round replaces the band by the one wavelength that has its value and slope, and inverts that: exact for a
/// narrow band, quadratic for a wide one. Steps that leave the bracket are replaced by its geometric middle.
fn temperature(lam1_um: f64, lam2_um: f64, excess: impl Fn(&BandIntegral) -> f64) -> Option<f64> {
    if !(lam1_um >= 0.0 && lam2_um > lam1_um) {
        return None;
    }
    let [mut low, mut high] = TEMPERATURES_K;
    let scale_um = if lam2_um.is_finite() { lam2_um } else { lam1_um.max(1.0) };
    let mut t = (SECOND_RADIATION_UM_K / (5.0 * scale_um)).clamp(low, high);
    for _ in 0..ROUNDS_MAX {
        let found = BandIntegral::new(lam1_um, lam2_um, t, |_| 1.0);
        let gap = excess(&found);
        if gap == 0.0 {
            return Some(t);
        }
        if gap > 0.0 {
            high = t
        } else {
            low = t
        }
        if high <= low * (1.0 + 2.0 * f64::EPSILON) {
            // At an end of the range there is no answer.
            let inside = low > TEMPERATURES_K[0] && high < TEMPERATURES_K[1];
            return inside.then_some(t);
        }
        let slope = BandIntegral::new(lam1_um, lam2_um, t, log_slope).factor / found.factor;
        let next = t * equivalent_step(slope, gap);
        // A model that wants to leave the bracket is not to be trusted; NaN neither.
        let inside = next > low && next < high;
        let next = if inside { next } else { low.sqrt() * high.sqrt() };
        if inside && (next / t - 1.0).abs() < 1e-9 {
            // The next step would be below its square.
            return Some(next);
        }
        t = next;
    }
    None
}

/// Factor on T of a single wavelength with d ln L/d ln T = `slope` ≥ 1, so that ln L falls by `gap`.
fn equivalent_step(slope: f64, gap: f64) -> f64 {
    // x/(1 − exp(−x)) = slope by Newton's method from above, where the function is convex.
    let mut x = if slope > 2.0 { slope } else { 2.0 * (slope - 1.0).max(1e-9) };
    for _ in 0..20 {
        let small = (-x).exp();
        let step = (x - slope * -(-x).exp_m1()) / (1.0 - slope * small);
        if step.is_nan() || step.abs() <= 1e-12 * x {
            break;
        }
        x = (x - step).max(0.25 * x).max(1e-10);
    }
    // exp(x′) − 1 = (exp(x) − 1) exp(gap); as a sum of logarithms only where the product overflows.
    let wanted = (x.exp_m1() * gap.exp()).ln_1p();
    x / if wanted.is_finite() && wanted > 0.0 { wanted } else { (x + gap).max(1e-10) }
}

/// 2πc (kT/hc)³ ∫ x² weight(x) / (exp(x) − 1) dx, kept as factor · exp(−x₂) with x₂ at the long-wave end.
struct BandIntegral {
    factor: f64,
    x_long: f64,
}

impl BandIntegral {
    /// Beyond this distance from x₂ less than 60⁴ exp(−60), 1e-19 of the integral, is left out.
    const REACH: f64 = 60.0;
    /// Sixteen nodes on a panel of this width: the poles at ±2πi are at ρ > 6, error 6⁻³² (1e-25).
    const PANEL: f64 = 4.0;

    fn new(lam1_um: f64, lam2_um: f64, temperature_k: f64, weight: impl Fn(f64) -> f64) -> Self {
        static RULE: LazyLock<Vec<(f64, f64)>> = LazyLock::new(|| gauss_legendre(16));
        let (x_long, rest) = exponent_and_rest(lam2_um, temperature_k);
        if !(lam1_um >= 0.0 && lam2_um > lam1_um && temperature_k > 0.0) || x_long.is_infinite() {
            return Self { factor: 0.0, x_long: 0.0 };
        }
        let span = if lam2_um.is_infinite() {
            exponent(lam1_um, temperature_k)
        } else {
            // x₁ − x₂ from the width of the band, without subtracting the two.
            exponent(lam1_um, temperature_k) * ((lam2_um - lam1_um) / lam2_um)
        };
        let reach = span.min(Self::REACH);
        let panels = (reach / Self::PANEL).ceil().max(1.0);
        let half = 0.5 * reach / panels;
        let mut sum = 0.0;
        let mut panel = 0.0;
        while panel < panels {
            let middle = (2.0 * panel + 1.0) * half;
            let mut part = 0.0;
            for &(node, share) in RULE.iter() {
                let past = middle + half * node;
                let x = x_long + past;
                part += share * (x * x) * weight(x) * ((-past).exp() / -(-x).exp_m1());
            }
            sum += part * half;
            panel += 1.0;
        }
        let scale = temperature_k / SECOND_RADIATION_UM_K;
        // exp(−x₂) with the rounding of x₂ itself taken back.
        Self { factor: PI * FIRST_RADIANCE * scale * scale * scale * sum * (1.0 - rest), x_long }
    }

    fn value(&self) -> f64 {
        let half = (-0.5 * self.x_long).exp();
        self.factor * half * half
    }

    fn ln(&self) -> f64 {
        let value = self.value();
        // Where the two parts nearly cancel, the value keeps their digits.
        if value.is_normal() { value.ln() } else { self.factor.ln() - self.x_long }
    }
}
