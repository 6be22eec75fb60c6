//! Planck's law in photons: spectral values, band integrals, their derivatives and inverses.
//!
//! Also the apparent temperatures of the paper's eqs 12 to 15. Knows no filters (those are `light::band`).
//!
//! Wavelengths are in µm in vacuum, temperatures in K. With x = hc / (λ k T) the photon exitance is the paper's
//! eq. 1, j = 2πc / λ⁴ / (exp(x) − 1), and the photon radiance is j / π. Everything underflows to 0 and nothing
//! returns NaN for λ > 0 and T ≥ 0.

use super::quadrature::gauss_legendre;
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Speed of light in m/s (SI, exact).
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;
/// Boltzmann's constant in J/K (SI, exact).
pub const BOLTZMANN: f64 = 1.380_649e-23;
/// hc/k in µm K: the exact SI ratio, rounded once.
pub const SECOND_RADIATION_UM_K: f64 = 14_387.768_775_039_337;

/// 2c with wavelengths in µm and results per µm: photons s⁻¹ m⁻² sr⁻¹ µm³.
const FIRST_RADIANCE: f64 = 2.0 * SPEED_OF_LIGHT * 1e18;

/// Photon radiance of a black body in photons s⁻¹ m⁻² sr⁻¹ µm⁻¹: 2c / λ⁴ / (exp(x) − 1).
///
/// Relative error below (6 + 3x) · 2⁻⁵³ (the rounding of x is amplified by exp): 6e-15 for 3–5 µm and
/// 280–800 K. Zero at T = 0.
pub fn photon_radiance(wavelength_um: f64, temperature_k: f64) -> f64 {
    FIRST_RADIANCE * occupation_per_um4(wavelength_um, temperature_k)
}

/// Photon exitance of a black body into the half-sphere, photons s⁻¹ m⁻² µm⁻¹: the paper's eq. 1, π times the radiance.
pub fn photon_exitance(wavelength_um: f64, temperature_k: f64) -> f64 {
    PI * FIRST_RADIANCE * occupation_per_um4(wavelength_um, temperature_k)
}

/// ∂/∂T of [`photon_radiance`], photons s⁻¹ m⁻² sr⁻¹ µm⁻¹ K⁻¹.
pub fn d_photon_radiance_dt(wavelength_um: f64, temperature_k: f64) -> f64 {
    derivative(photon_radiance(wavelength_um, temperature_k), wavelength_um, temperature_k)
}

/// ∂/∂T of [`photon_exitance`], photons s⁻¹ m⁻² µm⁻¹ K⁻¹.
pub fn d_photon_exitance_dt(wavelength_um: f64, temperature_k: f64) -> f64 {
    derivative(photon_exitance(wavelength_um, temperature_k), wavelength_um, temperature_k)
}

/// ∂ ln L/∂T = x / T / (1 − exp(−x)) in 1/K; the same for radiance and exitance. Infinite at T = 0.
pub fn d_ln_photon_radiance_dt(wavelength_um: f64, temperature_k: f64) -> f64 {
    let x = exponent(wavelength_um, temperature_k);
    // 1/T as its limit: x/(1 − exp(−x)) → 1.
    if x < 1e-17 { temperature_k.recip() } else { x / (-(-x).exp_m1()) / temperature_k }
}

/// ln of [`photon_exitance`]: finite where the exitance itself underflows.
pub fn ln_photon_exitance(wavelength_um: f64, temperature_k: f64) -> f64 {
    let x = exponent(wavelength_um, temperature_k);
    (PI * FIRST_RADIANCE).ln() - 4.0 * wavelength_um.ln() - x - (-(-x).exp_m1()).ln()
}

/// x = hc / (λ k T).
pub fn exponent(wavelength_um: f64, temperature_k: f64) -> f64 {
    SECOND_RADIATION_UM_K / (wavelength_um * temperature_k)
}

/// The temperature whose [`photon_radiance`] is `radiance`; `None` unless the radiance is positive and finite.
pub fn inverse_photon_radiance(wavelength_um: f64, radiance: f64) -> Option<f64> {
    if !(radiance > 0.0 && radiance.is_finite() && wavelength_um > 0.0) {
        return None;
    }
    let first = FIRST_RADIANCE / wavelength_um.powi(4);
    let ratio = first / radiance;
    let x = if ratio.is_finite() { ratio.ln_1p() } else { first.ln() - radiance.ln() };
    let temperature = SECOND_RADIATION_UM_K / (wavelength_um * x);
    (temperature.is_finite() && temperature > 0.0).then_some(temperature)
}

fn occupation_per_um4(wavelength_um: f64, temperature_k: f64) -> f64 {
    let x = exponent(wavelength_um, temperature_k);
    // The exponential in two halves: one alone underflows while the product with 1/λ⁴ is still a number.
    let half = (-0.5 * x).exp();
    if half > 0.0 { half / wavelength_um.powi(4) * (half / -(-x).exp_m1()) } else { nothing(x) }
}

/// 0 for a number that underflowed, NaN for NaN.
fn nothing(x: f64) -> f64 {
    if x.is_nan() { x } else { 0.0 }
}

fn derivative(value: f64, wavelength_um: f64, temperature_k: f64) -> f64 {
    if value > 0.0 { value * d_ln_photon_radiance_dt(wavelength_um, temperature_k) } else { value }
}

/// Photon exitance between two wavelengths, photons s⁻¹ m⁻². Zero unless `lam1_um` < `lam2_um`.
///
/// One quadrature of the band itself, never a difference of integrals from 0: right for relative widths down to
/// the spacing of the numbers. Relative error below (20 + 3x₂) · 2⁻⁵³, with x₂ at the long end, plus the rounding
/// of the width `lam2_um − lam1_um` that the caller handed in.
pub fn photon_exitance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |_| 1.0).value()
}

/// Photon radiance between two wavelengths, photons s⁻¹ m⁻² sr⁻¹: the exitance over π.
pub fn photon_radiance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    photon_exitance_band(lam1_um, lam2_um, temperature_k) / PI
}

/// ln of [`photon_exitance_band`]: finite where the exitance itself underflows.
pub fn ln_photon_exitance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |_| 1.0).ln()
}

/// ∂/∂T of [`photon_exitance_band`], photons s⁻¹ m⁻² K⁻¹.
pub fn d_photon_exitance_band_dt(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    slope_band(lam1_um, lam2_um, temperature_k).value()
}

/// ln of [`d_photon_exitance_band_dt`].
pub fn ln_d_photon_exitance_band_dt(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    slope_band(lam1_um, lam2_um, temperature_k).ln()
}

/// Energy exitance between two wavelengths, W/m².
pub fn energy_exitance_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> f64 {
    let photon_energy = BOLTZMANN * temperature_k;
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |x| x * photon_energy).value()
}

fn slope_band(lam1_um: f64, lam2_um: f64, temperature_k: f64) -> BandIntegral {
    BandIntegral::new(lam1_um, lam2_um, temperature_k, |x| x / (-(-x).exp_m1()) / temperature_k)
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
        let x_long = exponent(lam2_um, temperature_k);
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
            for &(node, share) in RULE.iter() {
                let past = middle + half * node;
                let x = x_long + past;
                sum += share * half * x * x * weight(x) * (-past).exp() / -(-x).exp_m1();
            }
            panel += 1.0;
        }
        let scale = temperature_k / SECOND_RADIATION_UM_K;
        Self { factor: PI * FIRST_RADIANCE * scale * scale * scale * sum, x_long }
    }

    fn value(&self) -> f64 {
        let half = (-0.5 * self.x_long).exp();
        self.factor * half * half
    }

    fn ln(&self) -> f64 {
        self.factor.ln() - self.x_long
    }
}

/// A droplet cloud in black surroundings, seen in single scattering at one wavelength (eqs 12 to 15).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cloud {
    /// Wavelength in µm.
    pub wavelength_um: f64,
    /// Temperature of the object (the droplets) in K, above 0.
    pub object_k: f64,
    /// Temperature of the environment in K, above 0.
    pub environment_k: f64,
    /// σ_s / σ_a, not negative.
    pub scattering_over_absorption: f64,
}

impl Cloud {
    /// Apparent temperature in K, eq. 12: (σ_a j(T_O) + σ_s j(T_E)) / (σ_a + σ_s) inverted at the one wavelength.
    pub fn apparent_temperature_k(&self) -> f64 {
        let ratio = self.scattering_over_absorption;
        if ratio == 0.0 {
            return self.object_k;
        }
        // From the hotter of the two, whose j cannot underflow in the quotient.
        let (hot_k, cold_k, hot_share) = if self.object_k >= self.environment_k {
            (self.object_k, self.environment_k, 1.0 / (1.0 + ratio))
        } else {
            (self.environment_k, self.object_k, ratio / (1.0 + ratio))
        };
        let lower = self.ln_ratio(cold_k, hot_k).exp_m1() * (1.0 - hot_share);
        // j_A = j_hot (1 + lower); exp(x_A) − 1 = (exp(x_hot) − 1) / (1 + lower).
        let x_hot = exponent(self.wavelength_um, hot_k);
        let x = x_hot + (-lower / (1.0 + lower) * -(-x_hot).exp_m1()).ln_1p();
        hot_k * (x_hot / x)
    }

    /// Eq. 13: the mean of the temperatures, weighted with the cross-sections.
    pub fn weighted_temperature_k(&self) -> f64 {
        let ratio = self.scattering_over_absorption;
        (self.object_k + ratio * self.environment_k) / (1.0 + ratio)
    }

    /// Eq. 14: linear about the environment, for strong scattering. Infinite when j(T_O)/j(T_E) overflows.
    pub fn environment_expansion_k(&self) -> f64 {
        let step = self.ln_ratio(self.object_k, self.environment_k).exp_m1()
            / d_ln_photon_radiance_dt(self.wavelength_um, self.environment_k);
        self.environment_k + step / self.scattering_over_absorption
    }

    /// Eq. 15: linear about the object, for weak scattering. Infinite when j(T_E)/j(T_O) overflows.
    pub fn object_expansion_k(&self) -> f64 {
        let step = self.ln_ratio(self.environment_k, self.object_k).exp_m1()
            / d_ln_photon_radiance_dt(self.wavelength_um, self.object_k);
        self.object_k + step * self.scattering_over_absorption
    }

    /// ln j(a) − ln j(b) without cancellation.
    fn ln_ratio(&self, a_k: f64, b_k: f64) -> f64 {
        let (x_a, x_b) = (exponent(self.wavelength_um, a_k), exponent(self.wavelength_um, b_k));
        let difference = x_b * ((a_k - b_k) / a_k);
        if difference.abs() < 1.0 {
            difference + (-(-difference).exp_m1() / x_a.exp_m1()).ln_1p()
        } else {
            difference + (-(-x_b).exp_m1()).ln() - (-(-x_a).exp_m1()).ln()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::table::Table;
    use proptest::prelude::*;

    const ULP: f64 = f64::EPSILON;

    fn assert_close(found: f64, wanted: f64, relative: f64, what: &str) {
        let subnormal = 1e-307;
        assert!(
            (found - wanted).abs() <= relative * wanted.abs() + subnormal,
            "{what}: {found:e} against {wanted:e}, allowed {relative:e}"
        );
    }

    #[test]
    fn spectral_values_agree_with_the_multiprecision_table() {
        // Reference: 60-digit closed forms (tests/data/light). Allowed: the bound stated at photon_radiance.
        let table = Table::parse(include_str!("../../tests/data/light/planck_spectral.csv")).unwrap();
        let column = |name| table.column(name).unwrap();
        for row in 0..column("T_K").len() {
            let (t, lam, x) = (column("T_K")[row], column("lam_um")[row], column("x_hc_over_lkT")[row]);
            let bound = (10.0 + 3.0 * x) * ULP / 2.0;
            let what = format!("{t} K, {lam} um");
            assert_close(exponent(lam, t), x, 2.0 * ULP, &what);
            assert_close(photon_exitance(lam, t), column("j_photon_per_s_m2_um")[row], bound, &what);
            assert_close(PI * photon_radiance(lam, t), column("j_photon_per_s_m2_um")[row], bound, &what);
            assert_close(d_photon_exitance_dt(lam, t), column("dj_dT")[row], bound + 4.0 * ULP, &what);
            assert_close(ln_photon_exitance(lam, t), column("ln_j")[row], 4.0 * ULP, &what);
            assert_close(d_ln_photon_radiance_dt(lam, t), column("dln_j_dT")[row], 4.0 * ULP, &what);
        }
    }

    #[test]
    fn band_integrals_agree_with_the_multiprecision_table() {
        let table = Table::parse(include_str!("../../tests/data/light/planck_band.csv")).unwrap();
        let column = |name| table.column(name).unwrap();
        for row in 0..column("T_K").len() {
            let (t, a, b) = (column("T_K")[row], column("lam1_um")[row], column("lam2_um")[row]);
            // The width b − a of the decimal limits is itself rounded: 4.4e-16 λ / width (README of the table);
            // the table has 15 digits.
            let bound = 2e-15 + (20.0 + 3.0 * exponent(b, t)) * ULP / 2.0 + 4.4e-16 * b / (b - a);
            let what = format!("{t} K, {a}..{b} um");
            assert_close(photon_exitance_band(a, b, t), column("M_photon_per_s_m2")[row], bound, &what);
            assert_close(photon_radiance_band(a, b, t), column("L_photon_per_s_m2_sr")[row], bound, &what);
            assert_close(d_photon_exitance_band_dt(a, b, t), column("dM_dT")[row], bound, &what);
            assert_close(energy_exitance_band(a, b, t), column("M_energy_W_m2")[row], bound, &what);
            let in_log = 4.0 * ULP * column("ln_M")[row].abs() + bound;
            assert!((ln_photon_exitance_band(a, b, t) - column("ln_M")[row]).abs() <= in_log, "{what}");
            assert!(
                (ln_d_photon_exitance_band_dt(a, b, t) - column("ln_dM_dT")[row]).abs() <= in_log,
                "{what}"
            );
        }
    }

    #[test]
    fn apparent_temperatures_agree_with_the_closed_forms() {
        let table = Table::parse(include_str!("../../tests/data/light/eq12_15.csv")).unwrap();
        let column = |name| table.column(name).unwrap();
        for row in 0..column("lam_um").len() {
            let cloud = Cloud {
                wavelength_um: column("lam_um")[row],
                object_k: column("T_O_K")[row],
                environment_k: column("T_E_K")[row],
                scattering_over_absorption: column("sigma_s_over_sigma_a")[row],
            };
            let bound = 1e-14;
            assert_close(cloud.apparent_temperature_k(), column("T_A_eq12_K")[row], bound, "eq 12");
            assert_close(cloud.weighted_temperature_k(), column("T_A_eq13_K")[row], bound, "eq 13");
            let (eq14, eq15) = (column("T_A_eq14_K")[row], column("T_A_eq15_K")[row]);
            // The expansions carry exp(x_O − x_E): the rounding of x counts, and steps far larger than T.
            let x = exponent(cloud.wavelength_um, cloud.environment_k.min(cloud.object_k)).min(700.0);
            if eq14.is_finite() {
                assert_close(cloud.environment_expansion_k(), eq14, (20.0 + 3.0 * x) * ULP, "eq 14");
            } else {
                assert!(cloud.environment_expansion_k().is_infinite());
            }
            assert_close(cloud.object_expansion_k(), eq15, (20.0 + 3.0 * x) * ULP, "eq 15");
        }
    }

    #[test]
    fn extremes_underflow_to_zero_and_never_to_nan() {
        for lam in [1e-6, 1e-2, 3.4, 1e4, 1e12] {
            for t in [0.0, 1e-3, 1.0, 300.0, 1e9] {
                for value in [
                    photon_radiance(lam, t),
                    d_photon_radiance_dt(lam, t),
                    photon_exitance_band(lam, 2.0 * lam, t),
                    photon_exitance_band(0.0, lam, t),
                    photon_exitance_band(lam, f64::INFINITY, t),
                    d_photon_exitance_band_dt(lam, 1.001 * lam, t),
                ] {
                    assert!(value >= 0.0 && value.is_finite(), "{lam} um, {t} K: {value}");
                }
            }
        }
        assert_eq!(photon_exitance_band(3.0, 3.0, 300.0).to_bits(), 0);
        assert!(photon_radiance(f64::NAN, 300.0).is_nan());
    }

    proptest! {
        #[test]
        fn radiance_rises_with_temperature_and_inverts(lam in 0.5f64..20.0, t in 50.0f64..5000.0) {
            let radiance = photon_radiance(lam, t);
            prop_assert!(photon_radiance(lam, t * 1.0001) > radiance);
            let back = inverse_photon_radiance(lam, radiance).unwrap();
            // Error of ln L times dT/d ln L; log and rounding of the prefactor.
            prop_assert!((back / t - 1.0).abs() < 20.0 * ULP);
        }

        #[test]
        fn the_band_is_the_sum_of_its_parts(lam in 1.0f64..6.0, cut in 0.1f64..0.9, t in 200.0f64..1000.0) {
            let (end, middle) = (lam * 1.3, lam * (1.0 + 0.3 * cut));
            let parts = photon_exitance_band(lam, middle, t) + photon_exitance_band(middle, end, t);
            prop_assert!((parts / photon_exitance_band(lam, end, t) - 1.0).abs() < 1e-13);
        }

        #[test]
        fn the_derivative_is_the_slope(lam in 1.0f64..6.0, t in 200.0f64..1000.0) {
            let h = 1e-3 * t;
            let slope = (photon_radiance(lam, t + h) - photon_radiance(lam, t - h)) / (2.0 * h);
            // Truncation: h² L‴/6, with L‴/L′ below (x/T)² and x < 72.
            let x = exponent(lam, t) + 4.0;
            prop_assert!((slope / d_photon_radiance_dt(lam, t) - 1.0).abs() < 1e-6 * x * x);
        }
    }

    #[test]
    fn no_radiance_has_no_temperature() {
        for radiance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(inverse_photon_radiance(3.4, radiance), None);
        }
    }
}
