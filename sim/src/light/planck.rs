//! Planck's law in photons: spectral values, band integrals, their derivatives and inverses.
//!
//! Also the apparent temperatures of the paper's eqs 12 to 15. Knows no filters (those are `light::band`).
//!
//! Wavelengths are in µm in vacuum, temperatures in K. With x = hc / (λ k T) the photon exitance is the paper's
//! eq. 1, j = 2πc / λ⁴ / (exp(x) − 1), and the photon radiance is j / π. Everything underflows to 0 and nothing
//! returns NaN for λ > 0 and T ≥ 0.

mod cloud;
mod integral;

pub use cloud::Cloud;
pub use integral::{
    d_photon_exitance_band_dt, energy_exitance_band, inverse_ln_photon_exitance_band,
    inverse_photon_exitance_band, inverse_photon_radiance_band, ln_d_photon_exitance_band_dt,
    ln_photon_exitance_band, photon_exitance_band, photon_radiance_band,
};

use std::f64::consts::PI;

/// Speed of light in m/s (SI, exact).
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;
/// Boltzmann's constant in J/K (SI, exact).
pub const BOLTZMANN: f64 = 1.380_649e-23;
/// hc/k in µm K: the exact SI ratio, rounded once.
pub const SECOND_RADIATION_UM_K: f64 = 14_387.768_775_039_338;
/// What that rounding left over, µm K.
const SECOND_RADIATION_REST: f64 = 9.678_511_210_690_03e-14;

/// 2c with wavelengths in µm and results per µm: photons s⁻¹ m⁻² sr⁻¹ µm³.
const FIRST_RADIANCE: f64 = 2.0 * SPEED_OF_LIGHT * 1e18;

/// Photon radiance of a black body in photons s⁻¹ m⁻² sr⁻¹ µm⁻¹: 2c / λ⁴ / (exp(x) − 1).
///
/// Relative error below 12 · 2⁻⁵³ (1.4e-15) for any x, as long as the result is not subnormal: the rounding of x, which
/// exp would amplify, is carried along. Zero at T = 0.
pub fn photon_radiance(wavelength_um: f64, temperature_k: f64) -> f64 {
    planck(FIRST_RADIANCE, wavelength_um, temperature_k)
}

/// Photon exitance of a black body into the half-sphere, photons s⁻¹ m⁻² µm⁻¹: the paper's eq. 1, π times the radiance.
pub fn photon_exitance(wavelength_um: f64, temperature_k: f64) -> f64 {
    planck(PI * FIRST_RADIANCE, wavelength_um, temperature_k)
}

/// ∂/∂T of [`photon_radiance`], photons s⁻¹ m⁻² sr⁻¹ µm⁻¹ K⁻¹.
pub fn d_photon_radiance_dt(wavelength_um: f64, temperature_k: f64) -> f64 {
    slope(FIRST_RADIANCE, wavelength_um, temperature_k)
}

/// ∂/∂T of [`photon_exitance`], photons s⁻¹ m⁻² µm⁻¹ K⁻¹.
pub fn d_photon_exitance_dt(wavelength_um: f64, temperature_k: f64) -> f64 {
    slope(PI * FIRST_RADIANCE, wavelength_um, temperature_k)
}

/// ∂ ln L/∂T = x / T / (1 − exp(−x)) in 1/K; the same for radiance and exitance. Infinite at T = 0.
pub fn d_ln_photon_radiance_dt(wavelength_um: f64, temperature_k: f64) -> f64 {
    let x = exponent(wavelength_um, temperature_k);
    // 1/T as its limit: x/(1 − exp(−x)) → 1.
    if x < 1e-17 { temperature_k.recip() } else { x / (-(-x).exp_m1()) / temperature_k }
}

/// ln of [`photon_exitance`]: finite where the exitance itself underflows. Error below 2⁻⁵¹ |ln j| + 12 · 2⁻⁵³.
pub fn ln_photon_exitance(wavelength_um: f64, temperature_k: f64) -> f64 {
    let exitance = photon_exitance(wavelength_um, temperature_k);
    if exitance.is_normal() {
        // Where x and the logarithm of the prefactor nearly cancel, this keeps their digits.
        return exitance.ln();
    }
    let x = exponent(wavelength_um, temperature_k);
    (PI * FIRST_RADIANCE).ln() - 4.0 * wavelength_um.ln() - x - (-(-x).exp_m1()).ln()
}

/// x = hc / (λ k T).
pub fn exponent(wavelength_um: f64, temperature_k: f64) -> f64 {
    SECOND_RADIATION_UM_K / (wavelength_um * temperature_k)
}

/// The temperature in K whose [`photon_radiance`] is `radiance`; `None` unless the radiance is positive and finite.
///
/// Relative error below 8 · 2⁻⁵³.
pub fn inverse_photon_radiance(wavelength_um: f64, radiance: f64) -> Option<f64> {
    inverse(FIRST_RADIANCE, wavelength_um, radiance)
}

/// The temperature in K whose [`photon_exitance`] is `exitance`; as [`inverse_photon_radiance`].
pub fn inverse_photon_exitance(wavelength_um: f64, exitance: f64) -> Option<f64> {
    inverse(PI * FIRST_RADIANCE, wavelength_um, exitance)
}

/// The temperature in K whose [`ln_photon_exitance`] is `ln_exitance`: also where the exitance itself underflows.
///
/// `None` unless it is finite. Relative error below 8 · 2⁻⁵³ + 2⁻⁵³ |ln j| (1 − exp(−x)) / x.
pub fn inverse_ln_photon_exitance(wavelength_um: f64, ln_exitance: f64) -> Option<f64> {
    if !(wavelength_um > 0.0 && ln_exitance.is_finite()) {
        return None;
    }
    let ln_ratio = (PI * FIRST_RADIANCE).ln() - 4.0 * wavelength_um.ln() - ln_exitance;
    // ln(1 + exp(r)), which is r itself where exp would overflow.
    let x = if ln_ratio > 40.0 { ln_ratio } else { ln_ratio.exp().ln_1p() };
    temperature_of(wavelength_um, x)
}

fn inverse(first: f64, wavelength_um: f64, value: f64) -> Option<f64> {
    if !(value > 0.0 && value.is_finite() && wavelength_um > 0.0) {
        return None;
    }
    let square = wavelength_um * wavelength_um;
    let ratio = first / square / square / value;
    let x =
        if ratio.is_finite() { ratio.ln_1p() } else { first.ln() - 4.0 * wavelength_um.ln() - value.ln() };
    temperature_of(wavelength_um, x)
}

fn temperature_of(wavelength_um: f64, x: f64) -> Option<f64> {
    let temperature = SECOND_RADIATION_UM_K / (wavelength_um * x);
    (temperature.is_finite() && temperature > 0.0).then_some(temperature)
}

/// [`exponent`] and what its rounding left over: x is their sum to about 2⁻¹⁰⁰.
///
/// exp(−x) = exp(−x₀)(1 − rest) then has no error that grows with x.
fn exponent_and_rest(wavelength_um: f64, temperature_k: f64) -> (f64, f64) {
    let product = wavelength_um * temperature_k;
    let x = SECOND_RADIATION_UM_K / product;
    // Residuals of the product and of the quotient, both exact.
    let lost = wavelength_um.mul_add(temperature_k, -product);
    let remainder = (-x).mul_add(product, SECOND_RADIATION_UM_K);
    let rest = (remainder - x * lost + SECOND_RADIATION_REST) / product;
    (x, if rest.is_finite() { rest } else { 0.0 })
}

/// first / λ⁴ / (exp(x) − 1).
fn planck(first: f64, wavelength_um: f64, temperature_k: f64) -> f64 {
    let (x, rest) = exponent_and_rest(wavelength_um, temperature_k);
    // The exponential in two halves: one alone underflows while the product is still a number. `first` is multiplied
    // in before it can be one that has lost digits.
    let half = (-0.5 * x).exp();
    if half > 0.0 {
        let square = wavelength_um * wavelength_um;
        let emptiness = -(-x).exp_m1();
        if emptiness > 0.0 {
            first * half / square * (half / (square * emptiness)) * (1.0 - rest / emptiness)
        } else {
            // λT beyond all numbers: 1/(exp(x) − 1) → 1/x.
            first * (temperature_k / SECOND_RADIATION_UM_K) / square / wavelength_um
        }
    } else {
        nothing(x)
    }
}

/// ∂/∂T of [`planck`].
fn slope(first: f64, wavelength_um: f64, temperature_k: f64) -> f64 {
    if temperature_k > 0.0 {
        let per_k = d_ln_photon_radiance_dt(wavelength_um, temperature_k);
        // An infinite slope of ln L at T → 0 belongs to a radiance of 0.
        planck(first * per_k.min(f64::MAX / (2.0 * first)), wavelength_um, temperature_k)
    } else {
        nothing(temperature_k)
    }
}

/// 0 for a number that underflowed, NaN for NaN.
fn nothing(x: f64) -> f64 {
    if x.is_nan() { x } else { 0.0 }
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
        // Reference: 60-digit closed forms (tests/data/light) with 16 digits. Allowed: the bound stated at
        // photon_radiance and the rounding of the table; its decimal wavelengths and temperatures are rounded to f64
        // when they are read, which exp amplifies by x.
        let table = Table::parse(include_str!("../../tests/data/light/planck_spectral.csv")).unwrap();
        let column = |name| table.column(name).unwrap();
        for row in 0..column("T_K").len() {
            let (t, lam, x) = (column("T_K")[row], column("lam_um")[row], column("x_hc_over_lkT")[row]);
            let bound = (14.0 + 2.0 * x) * ULP / 2.0;
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
            let bound = 2e-15 + (24.0 + 2.0 * exponent(b, t)) * ULP / 2.0 + 4.4e-16 * b / (b - a);
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
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(inverse_photon_radiance(3.4, value), None);
            assert_eq!(inverse_photon_exitance(3.4, value), None);
            assert_eq!(inverse_photon_exitance_band(3.0, 5.0, value), None);
            assert_eq!(inverse_photon_radiance_band(3.0, 5.0, value), None);
        }
        assert_eq!(inverse_photon_exitance_band(5.0, 3.0, 1.0), None);
        assert_eq!(inverse_ln_photon_exitance(3.4, f64::NAN), None);
        assert_eq!(inverse_ln_photon_exitance_band(3.0, 5.0, f64::INFINITY), None);
        // Hotter than 1e30 K.
        assert_eq!(inverse_photon_exitance_band(3.0, 5.0, 1e300), None);
    }

    /// Rows of numbers with 17 digits: the reference was computed for exactly these.
    fn exact_rows(text: &str) -> Vec<Vec<f64>> {
        let number = |field: &str| field.trim().parse::<f64>().unwrap();
        text.lines().skip(1).map(|line| line.split(',').map(number).collect()).collect()
    }

    #[test]
    fn random_cases_hold_the_stated_bounds() {
        // 50-digit values for wavelengths and temperatures exactly as they are in f64 (17 digits in the file):
        // 1e-3 to 1e9 K, 1e-3 to 1e4 um, relative widths 1e-12 to 1e3.
        for row in exact_rows(include_str!("../../tests/data/light/planck_random.csv")) {
            let [t, a, b, j, dj, ln_j, m, dm, ln_m, energy] = row[..] else { panic!("ten columns: {row:?}") };
            let what = format!("{t} K, {a}..{b} um");
            let bound = |units: f64| units * ULP / 2.0;
            assert_close(photon_exitance(a, t), j, bound(12.0), &what);
            assert_close(d_photon_exitance_dt(a, t), dj, bound(16.0), &what);
            assert_close(photon_exitance_band(a, b, t), m, bound(24.0), &what);
            assert_close(d_photon_exitance_band_dt(a, b, t), dm, bound(24.0), &what);
            assert_close(energy_exitance_band(a, b, t), energy, bound(24.0), &what);
            assert!(
                (ln_photon_exitance(a, t) - ln_j).abs() <= 4.0 * ULP * ln_j.abs() + bound(12.0),
                "{what}"
            );
            let ln_found = ln_photon_exitance_band(a, b, t);
            assert!((ln_found - ln_m).abs() <= 4.0 * ULP * ln_m.abs() + bound(24.0), "{what}");
            let back = |found: Option<f64>, allowed: f64| {
                let found = found.unwrap();
                assert!((found / t - 1.0).abs() <= allowed, "{what}: {found}, allowed {allowed:e}");
            };
            if j.is_normal() {
                back(inverse_photon_exitance(a, j), bound(10.0));
                back(inverse_photon_radiance(a, j / PI), bound(10.0));
            }
            if m.is_normal() {
                back(inverse_photon_exitance_band(a, b, m), bound(30.0));
                back(inverse_photon_radiance_band(a, b, m / PI), bound(32.0));
            }
            let (x_a, x_b) = (exponent(a, t), exponent(b, t));
            back(inverse_ln_photon_exitance(a, ln_j), bound(10.0) + ULP * ln_j.abs() / x_a.max(1.0));
            back(
                inverse_ln_photon_exitance_band(a, b, ln_m),
                bound(30.0) + 2.0 * ULP * ln_m.abs() / x_b.max(1.0),
            );
        }
    }
}
