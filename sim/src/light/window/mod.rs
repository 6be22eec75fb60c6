//! Plane windows: transmittance, reflectance and absorptance of a plate.
//!
//! No coherence and no wedge: all internal reflections add up as intensities.

mod material;

pub use material::{IndexTable, Material, NAMES, WindowError};

use super::complex::Complex;
use std::f64::consts::PI;

/// A window without wedge and without coherence.
#[derive(Debug, Clone, PartialEq)]
pub struct Plate {
    /// Its material.
    pub material: Material,
    /// Its thickness in metres, not negative.
    pub thickness_m: f64,
}

/// What a plate does to light that meets it; the three sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateOptics {
    /// Through, in [0, 1].
    pub transmittance: f64,
    /// Back, in [0, 1].
    pub reflectance: f64,
    /// Kept, in [0, 1]: also the emissivity of the plate.
    pub absorptance: f64,
}

impl Plate {
    /// All incoherent internal reflections at normal incidence:
    /// T = (1−r)² t / (1 − r² t²), R = r + (1−r)² r t² / (1 − r² t²), t = exp(−4πk d/λ).
    pub fn optics(&self, wavelength_um: f64, temperature_k: f64) -> PlateOptics {
        let (n, k) = self.material.index(wavelength_um, temperature_k);
        let surface = ((n - 1.0).powi(2) + k * k) / ((n + 1.0).powi(2) + k * k);
        let depth = 4.0 * PI * k * self.thickness_m / (wavelength_um * 1e-6);
        bounced(surface, depth)
    }

    /// The same for unpolarised light that meets the plate at an angle to its normal, in radians from 0 to below π/2:
    /// Fresnel's reflectances of both polarisations, each with its own internal reflections. The absorbed path is
    /// d / cos θ' with θ' of the real index, right for the weak absorption of windows (k ≪ n).
    pub fn optics_at_angle(&self, wavelength_um: f64, temperature_k: f64, angle_rad: f64) -> PlateOptics {
        let (n, k) = self.material.index(wavelength_um, temperature_k);
        let (sine, cosine) = angle_rad.sin_cos();
        let m = Complex::new(n, k);
        let one = Complex::new(1.0, 0.0);
        // cos θ' = √(1 − (sin θ / m)²), with the real part that is not negative: into the plate.
        let across = one * sine / m;
        let within = (one - across * across).sqrt();
        let s = (one * cosine - m * within) / (one * cosine + m * within);
        let p = (m * cosine - within) / (m * cosine + within);
        let path = self.thickness_m / (1.0 - (sine / n).powi(2)).max(0.0).sqrt();
        let depth = if self.thickness_m > 0.0 { 4.0 * PI * k * path / (wavelength_um * 1e-6) } else { 0.0 };
        // No passive surface reflects more than arrives; rounding at grazing incidence must not.
        let [s, p] = [s, p].map(|amplitude| bounced(amplitude.norm_sqr().min(1.0), depth));
        PlateOptics {
            transmittance: 0.5 * (s.transmittance + p.transmittance),
            reflectance: 0.5 * (s.reflectance + p.reflectance),
            absorptance: 0.5 * (s.absorptance + p.absorptance),
        }
    }
}

/// Two equal surfaces of this reflectance with this optical depth between them.
fn bounced(surface: f64, depth: f64) -> PlateOptics {
    let through = (-depth).exp();
    let once = 1.0 - surface * through;
    if once <= 0.0 {
        // A perfect mirror: nothing enters.
        return PlateOptics { transmittance: 0.0, reflectance: 1.0, absorptance: 0.0 };
    }
    let bounce = 1.0 - (surface * through).powi(2);
    let transmittance = (1.0 - surface).powi(2) * through / bounce;
    let reflectance = surface + (1.0 - surface).powi(2) * surface * through * through / bounce;
    // (1 − r)(1 − t)/(1 − r t): a product, where 1 − T − R would cancel.
    let absorptance = (1.0 - surface) * -(-depth).exp_m1() / once;
    PlateOptics { transmittance, reflectance, absorptance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::table::Table;

    #[test]
    fn plates_agree_with_the_table_of_window_transmittance() {
        let table = Table::parse(include_str!("../../../tests/data/light/window_transmittance.csv")).unwrap();
        let column = |name: &str| table.column(name).unwrap();
        for (row, &um) in column("wavelength_um").iter().enumerate() {
            let at = |material, thickness_m, t| Plate { material, thickness_m }.optics(um, t);
            for t in [297.0, 450.0, 600.0] {
                let plate = at(Material::CalciumFluoride, 0.010, t);
                let wanted_t = column(&format!("CaF2_10mm_T_{t}K"))[row];
                let wanted_r = column(&format!("CaF2_10mm_R_{t}K"))[row];
                // Last printed digit of T and R, of n (dR/dn = 0.3), and of k: three digits of an optical depth
                // of at most 0.03.
                assert!((plate.transmittance - wanted_t).abs() < 2e-5, "{um} um {t} K: {plate:?} {wanted_t}");
                assert!((plate.reflectance - wanted_r).abs() < 2e-5, "{um} um {t} K: {plate:?} {wanted_r}");
            }
            for (mm, name) in [(10.0, "fused_silica_10mm_T"), (30.0, "fused_silica_30mm_T")] {
                let plate = at(Material::FusedSilica, mm * 1e-3, 295.0);
                // Four digits of T, and k to four digits: τ exp(−τ) 5e-4 ≤ 2e-4.
                assert!((plate.transmittance - column(name)[row]).abs() < 2.5e-4, "{um} um: {plate:?}");
            }
            let wanted = column("sapphire_5mm_T_Fresnel_only")[row];
            if wanted.is_finite() {
                assert!(
                    (at(Material::Sapphire, 0.005, 295.0).transmittance - wanted).abs() < 6e-5,
                    "{um} um"
                );
            }
        }
    }

    fn all() -> impl Iterator<Item = Material> {
        NAMES.iter().filter_map(|name| Material::named(name))
    }

    #[test]
    fn what_is_not_through_or_back_is_kept() {
        for material in all() {
            for um in [2.7, 3.4, 4.2, 5.9] {
                for mm in [0.0, 3.0, 30.0, 1e9] {
                    let plate = Plate { material: material.clone(), thickness_m: mm * 1e-3 };
                    let head_on = plate.optics(um, 400.0);
                    for one in [0.0, 0.3, 1.0, 1.4, 1.57].map(|a| plate.optics_at_angle(um, 400.0, a)) {
                        let sum = one.transmittance + one.reflectance + one.absorptance;
                        assert!((sum - 1.0).abs() < 8.0 * f64::EPSILON, "{material:?} {um} {mm}: {one:?}");
                        assert!(one.absorptance >= 0.0 && one.transmittance >= 0.0 && one.reflectance <= 1.0);
                    }
                    let sum = head_on.transmittance + head_on.reflectance + head_on.absorptance;
                    assert!((sum - 1.0).abs() < 4.0 * f64::EPSILON, "{material:?} {um} {mm}: {head_on:?}");
                    let along = plate.optics_at_angle(um, 400.0, 0.0);
                    // Optical depths up to 1e9 round: only what is near 1 counts.
                    assert!((along.transmittance - head_on.transmittance).abs() < 1e-12);
                    assert!((along.reflectance - head_on.reflectance).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn thickness_zero_loses_only_by_reflection_and_an_opaque_plate_keeps_the_rest() {
        // Fused silica at 5.5 um absorbs everything within 30 mm: R is that of one surface.
        let silica = |thickness_m| Plate { material: Material::FusedSilica, thickness_m }.optics(5.5, 295.0);
        let (n, k) = Material::FusedSilica.index(5.5, 295.0);
        let surface = ((n - 1.0).powi(2) + k * k) / ((n + 1.0).powi(2) + k * k);
        assert!((silica(0.03).reflectance - surface).abs() < 1e-15 && silica(0.03).transmittance < 1e-12);
        assert!((silica(0.03).absorptance - (1.0 - surface)).abs() < 1e-12);
        let thin = silica(0.0);
        assert!(thin.absorptance == 0.0);
        // T = (1 − r)/(1 + r) for a plate that does not absorb.
        assert!((thin.transmittance - (1.0 - surface) / (1.0 + surface)).abs() < 1e-15);
    }

    #[test]
    fn oblique_light_obeys_brewster_and_the_textbook() {
        // n = 1.5 exactly, no absorption. At Brewster's angle p passes whole: T_p = 1, and r_s = ((n²−1)/(n²+1))².
        let glass = Material::from_csv("glass", "wavelength_um,n\n1,1.5\n9,1.5\n").unwrap();
        let plate = Plate { material: glass, thickness_m: 0.01 };
        let s = (1.25f64 / 3.25).powi(2);
        let wanted = 0.5 * (1.0 + (1.0 - s) / (1.0 + s));
        let found = plate.optics_at_angle(3.0, 295.0, 1.5f64.atan()).transmittance;
        assert!((found - wanted).abs() < 1e-14, "{found} {wanted}");
        // Hecht, Optics (4th ed.), 4.6: at 45° into n = 1.5, r_s = −0.3034 and r_p = 0.0920.
        let [s, p] = [0.3034f64.powi(2), 0.0920f64.powi(2)].map(|r| (1.0 - r) / (1.0 + r));
        let found = plate.optics_at_angle(3.0, 295.0, std::f64::consts::FRAC_PI_4).transmittance;
        assert!((found - 0.5 * (s + p)).abs() < 2e-4, "{found}");
        // More is reflected the flatter the light comes in, all of it at last.
        assert!(plate.optics_at_angle(3.0, 295.0, std::f64::consts::FRAC_PI_2 - 1e-6).reflectance > 0.999);
        // optics.md: at 20° an uncoated CaF2 window reflects as at 0° to 1e-3.
        let plate = Plate { material: Material::CalciumFluoride, thickness_m: 0.01 };
        let [flat, tilted] = [0.0, 20f64.to_radians()].map(|angle| plate.optics_at_angle(3.4, 450.0, angle));
        assert!((flat.reflectance - tilted.reflectance).abs() < 1e-3);
    }
}
