//! Plane windows: transmittance, reflectance and absorptance of a plate at normal incidence.

use super::table::{Table, TableError, interpolate, locate};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// What a window is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Material {
    /// Calcium fluoride: n of Malitson (1963) with the temperature shift of Zheng et al. (2023), k a model.
    CalciumFluoride,
    /// Sapphire, ordinary ray: n up to 5.0 µm, beyond it the last value; absorption neglected (Fresnel only).
    Sapphire,
    /// Fused silica: n and k of Franta (2016); k depends on the water in the glass.
    FusedSilica,
}

/// A window without wedge and without coherence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plate {
    /// Its material.
    pub material: Material,
    /// Its thickness in metres, not negative.
    pub thickness_m: f64,
}

/// What a plate does to light that meets it head on; the three sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateOptics {
    /// Through, in [0, 1].
    pub transmittance: f64,
    /// Back, in [0, 1].
    pub reflectance: f64,
    /// Kept, in [0, 1]: also the emissivity of the plate.
    pub absorptance: f64,
}

impl Material {
    /// The material of a configuration's word: `CaF2`, `sapphire`, `fused-silica`.
    pub fn named(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().replace(['_', ' '], "-").as_str() {
            "caf2" | "calcium-fluoride" => Some(Self::CalciumFluoride),
            "sapphire" | "al2o3" => Some(Self::Sapphire),
            "fused-silica" | "sio2" | "quartz" => Some(Self::FusedSilica),
            _ => None,
        }
    }

    /// Index (n, k) at a wavelength in µm and a temperature in K; both are clamped to the tables (2.5–6 µm;
    /// 297–640 K for calcium fluoride, 295 K for the others).
    pub fn index(self, wavelength_um: f64, temperature_k: f64) -> (f64, f64) {
        let tables = &*TABLES;
        match self {
            Self::CalciumFluoride => {
                let (cold, warmth) = locate(&CAF2_K, temperature_k);
                let at = |column: &[f64]| interpolate(&tables.caf2_um, column, wavelength_um);
                let n = (1.0 - warmth) * at(&tables.caf2_n[cold]) + warmth * at(&tables.caf2_n[cold + 1]);
                // k spans eighteen decades: straight in its logarithm.
                (n, interpolate(&tables.caf2_um, &tables.caf2_ln_k, wavelength_um).exp())
            }
            Self::Sapphire => (interpolate(&tables.sapphire_um, &tables.sapphire_n, wavelength_um), 0.0),
            Self::FusedSilica => (
                interpolate(&tables.silica_um, &tables.silica_n, wavelength_um),
                interpolate(&tables.silica_um, &tables.silica_k, wavelength_um),
            ),
        }
    }
}

impl Plate {
    /// All incoherent internal reflections at normal incidence:
    /// T = (1−r)² t / (1 − r² t²), R = r + (1−r)² r t² / (1 − r² t²), t = exp(−4πk d/λ).
    pub fn optics(&self, wavelength_um: f64, temperature_k: f64) -> PlateOptics {
        let (n, k) = self.material.index(wavelength_um, temperature_k);
        let surface = ((n - 1.0).powi(2) + k * k) / ((n + 1.0).powi(2) + k * k);
        let depth = 4.0 * PI * k * self.thickness_m / (wavelength_um * 1e-6);
        let through = (-depth).exp();
        let bounce = 1.0 - (surface * through).powi(2);
        let transmittance = (1.0 - surface).powi(2) * through / bounce;
        let reflectance = surface + (1.0 - surface).powi(2) * surface * through * through / bounce;
        // (1 − r)(1 − t)/(1 − r t): a product, where 1 − T − R would cancel.
        let absorptance = (1.0 - surface) * -(-depth).exp_m1() / (1.0 - surface * through);
        PlateOptics { transmittance, reflectance, absorptance }
    }
}

const CAF2_K: [f64; 8] = [297.0, 350.0, 400.0, 450.0, 500.0, 550.0, 600.0, 640.0];

struct Tables {
    caf2_um: Vec<f64>,
    caf2_n: Vec<Vec<f64>>,
    caf2_ln_k: Vec<f64>,
    silica_um: Vec<f64>,
    silica_n: Vec<f64>,
    silica_k: Vec<f64>,
    sapphire_um: Vec<f64>,
    sapphire_n: Vec<f64>,
}

static TABLES: LazyLock<Tables> =
    LazyLock::new(|| Tables::shipped().expect("the shipped tables are read by a test"));

impl Tables {
    fn shipped() -> Result<Self, TableError> {
        let caf2 = Table::parse(include_str!("../../data/optics/window_CaF2_n.csv"))?;
        let others = Table::parse(include_str!("../../data/optics/materials_n.csv"))?;
        let caf2_n = CAF2_K
            .iter()
            .map(|kelvin| Ok(caf2.column(&format!("n_{kelvin:.0}K"))?.to_vec()))
            .collect::<Result<_, TableError>>()?;
        let um = others.ascending("wavelength_um")?;
        let sapphire = others.column("sapphire_o_n")?;
        let known = um.iter().zip(sapphire).filter(|row| row.1.is_finite());
        let (sapphire_um, sapphire_n) = known.map(|(um, n)| (*um, *n)).unzip();
        Ok(Self {
            caf2_um: caf2.ascending("wavelength_um")?.to_vec(),
            caf2_n,
            caf2_ln_k: caf2.column("k_300K_model")?.iter().map(|k| k.ln()).collect(),
            silica_um: um.to_vec(),
            silica_n: others.column("fused_silica_n")?.to_vec(),
            silica_k: others.column("fused_silica_k")?.to_vec(),
            sapphire_um,
            sapphire_n,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plates_agree_with_the_table_of_window_transmittance() {
        let table = Table::parse(include_str!("../../tests/data/light/window_transmittance.csv")).unwrap();
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

    #[test]
    fn what_is_not_through_or_back_is_kept() {
        for material in [Material::CalciumFluoride, Material::Sapphire, Material::FusedSilica] {
            for um in [2.7, 3.4, 4.2, 5.9] {
                for mm in [0.0, 3.0, 30.0] {
                    let plate = Plate { material, thickness_m: mm * 1e-3 }.optics(um, 400.0);
                    let sum = plate.transmittance + plate.reflectance + plate.absorptance;
                    assert!((sum - 1.0).abs() < 4.0 * f64::EPSILON, "{material:?} {um} {mm}: {plate:?}");
                    assert!(plate.absorptance >= 0.0);
                }
            }
        }
        assert_eq!(Material::named("CaF2"), Some(Material::CalciumFluoride));
        assert_eq!(Material::named("fused_silica"), Some(Material::FusedSilica));
        assert_eq!(Material::named("sapphire"), Some(Material::Sapphire));
        assert_eq!(Material::named("wood"), None);
    }
}
