//! Mixtures of fuels by volume: Lorentz–Lorenz for the liquid, mole fractions for the vapour.
//!
//! The parts do not react and their volumes add up. The vapour has the composition of the liquid: that light parts
//! evaporate first is neglected.

use super::{Density, Fuel, FuelError, LIQUID_REFERENCE_K, lorentz_lorenz};
use crate::light::complex::Complex;
use crate::light::provenance::{Provenance, Status};

/// One part of a mixture.
#[derive(Debug, Clone)]
pub struct Part {
    /// The fuel.
    pub fuel: Fuel,
    /// Its part of the volume at [`LIQUID_REFERENCE_K`], above 0.
    pub volume_fraction: f64,
}

/// How far volume fractions may be from adding up to 1.
const SUM_TOLERANCE: f64 = 1e-3;

/// Wavelengths of two tables closer than this, relatively, are one (1e4/wavenumber rounds differently).
const SAME_WAVELENGTH: f64 = 1e-9;

/// Mixes fuels; the fractions are scaled to add up to 1 exactly.
pub(super) fn mix(name: &str, parts: &[Part]) -> Result<Fuel, FuelError> {
    let value = |which, value| FuelError::Value { fuel: name.to_owned(), which, value };
    if let Some(bad) = parts.iter().map(|part| part.volume_fraction).find(|f| !(*f > 0.0 && *f <= 1.0)) {
        return Err(value("volume fraction (above 0 and at most 1)", bad));
    }
    let sum: f64 = parts.iter().map(|part| part.volume_fraction).sum();
    if parts.is_empty() || (sum - 1.0).abs() > SUM_TOLERANCE {
        return Err(value("sum of the volume fractions (it must be 1)", sum));
    }
    let (molar_mass_kg_mol, density) = liquid(parts);
    let liquid_um =
        common(parts.iter().map(|part| part.fuel.liquid_um.as_slice()), Fuel::liquid_range_um, parts);
    if liquid_um.len() < 2 {
        return Err(value(
            "number of wavelengths that the liquids' tables share (at least 2)",
            liquid_um.len() as f64,
        ));
    }
    let response = liquid_um
        .iter()
        .map(|&um| {
            parts.iter().fold(Complex::default(), |sum, part| {
                let (n, k) = part.fuel.liquid_index(um, LIQUID_REFERENCE_K);
                sum + lorentz_lorenz(Complex::new(n, k)) * part.volume_fraction
            }) * sum.recip()
        })
        .collect();
    let shares = mole_fractions(parts);
    let all = |_: &Fuel| [0.0, f64::INFINITY];
    let vapour_um = common(parts.iter().map(|part| part.fuel.vapour_um.as_slice()), all, parts);
    let mut vapour_k: Vec<f64> = parts.iter().flat_map(|part| part.fuel.vapour_k.iter().copied()).collect();
    vapour_k.sort_by(f64::total_cmp);
    vapour_k.dedup();
    let cross_section = |um: f64, t: f64| -> f64 {
        parts
            .iter()
            .zip(&shares)
            .map(|(part, share)| share * part.fuel.vapour_cross_section_m2_mol(um, t))
            .sum()
    };
    let vapour_m2_mol =
        vapour_k.iter().map(|&t| vapour_um.iter().map(|&um| cross_section(um, t)).collect()).collect();
    let liquid_provenance = provenance(parts, "by volume, Lorentz-Lorenz", |f| f.liquid_provenance().status);
    let vapour_provenance = provenance(parts, "composition of the liquid", |f| f.vapour_provenance().status);
    Ok(Fuel {
        name: name.to_owned(),
        source: super::sources(&liquid_provenance, &vapour_provenance),
        molar_mass_kg_mol,
        density,
        reference_k: LIQUID_REFERENCE_K,
        liquid_um,
        response,
        vapour_um,
        vapour_k,
        vapour_m2_mol,
        liquid_provenance,
        vapour_provenance,
    })
}

/// Mean molar mass in kg/mol and density of an ideal mixture.
pub(super) fn liquid(parts: &[Part]) -> (f64, Density) {
    let shares = mole_fractions(parts);
    let of = |part: &Part, share: f64| (share, part.fuel.molar_mass_kg_mol, part.fuel.density.clone());
    let molar_mass = parts.iter().zip(&shares).map(|(part, share)| share * part.fuel.molar_mass_kg_mol).sum();
    (molar_mass, Density::Mixture(parts.iter().zip(&shares).map(|(part, share)| of(part, *share)).collect()))
}

fn mole_fractions(parts: &[Part]) -> Vec<f64> {
    let moles: Vec<f64> = parts
        .iter()
        .map(|part| {
            part.volume_fraction * part.fuel.liquid_density(LIQUID_REFERENCE_K) / part.fuel.molar_mass_kg_mol
        })
        .collect();
    let sum: f64 = moles.iter().sum();
    moles.iter().map(|moles| moles / sum).collect()
}

/// All wavelengths of the tables that lie in the range of every part.
fn common<'a>(
    tables: impl Iterator<Item = &'a [f64]>,
    range_um: impl Fn(&Fuel) -> [f64; 2],
    parts: &[Part],
) -> Vec<f64> {
    let (from, to) =
        parts.iter().map(|part| range_um(&part.fuel)).fold((0.0f64, f64::INFINITY), |all, own| {
            (all.0.max(own[0] * (1.0 - SAME_WAVELENGTH)), all.1.min(own[1] * (1.0 + SAME_WAVELENGTH)))
        });
    let mut all: Vec<f64> = tables.flatten().copied().filter(|um| (from..=to).contains(um)).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|next, kept| *next - *kept <= SAME_WAVELENGTH * *kept);
    all
}

/// A mixture is a model whatever its parts are, and assumed as soon as one of them is.
fn provenance(parts: &[Part], how: &str, status: impl Fn(&Fuel) -> Option<Status>) -> Provenance {
    let stated: Vec<Option<Status>> = parts.iter().map(|part| status(&part.fuel)).collect();
    let worst = if stated.contains(&None) {
        None
    } else if stated.contains(&Some(Status::Assumed)) {
        Some(Status::Assumed)
    } else {
        Some(Status::Model)
    };
    let shares: Vec<String> =
        parts.iter().map(|part| format!("{} % {}", 100.0 * part.volume_fraction, part.fuel.name)).collect();
    Provenance {
        status: worst,
        source: format!("mixed from {} ({how})", shares.join(", ")),
        ..Provenance::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fuel::shipped::composition;

    #[test]
    fn the_shipped_e10_is_the_mixture_of_its_four_parts() {
        let mixed = Fuel::mixture("own", &composition("E10-surrogate").unwrap().unwrap()).unwrap();
        let shipped = Fuel::named("E10-surrogate").unwrap();
        assert!((mixed.molar_mass_kg_mol() / shipped.molar_mass_kg_mol() - 1.0).abs() < 1e-14);
        let mut seen = 0;
        for &um in &shipped.liquid_um {
            let (wanted, found) =
                (shipped.liquid_index(um, LIQUID_REFERENCE_K), mixed.liquid_index(um, LIQUID_REFERENCE_K));
            // Tables of five digits in n, of five significant ones in k; the parts are as coarse.
            assert!((found.0 - wanted.0).abs() < 2e-5, "{um} um: {found:?} {wanted:?}");
            assert!((found.1 - wanted.1).abs() < 2e-5 + 2e-4 * wanted.1, "{um} um: {found:?} {wanted:?}");
            seen += 1;
        }
        assert!(seen > 500);
        for &t in &shipped.vapour_k {
            for &um in &shipped.vapour_um {
                let wanted = shipped.vapour_cross_section_m2_mol(um, t);
                let found = mixed.vapour_cross_section_m2_mol(um, t);
                assert!((found - wanted).abs() < 2e-3 * (1.0 + wanted), "{um} um {t} K: {found} {wanted}");
            }
        }
        assert_eq!(mixed.liquid_provenance().status, Some(Status::Model));
        assert!(mixed.source().contains("10 % ethanol"), "{}", mixed.source());
    }

    #[test]
    fn a_fuel_mixed_with_itself_is_itself_and_impossible_fractions_are_refused() {
        let half = |volume_fraction| Part { fuel: Fuel::named("n-octane").unwrap(), volume_fraction };
        let (own, mixed) = (half(1.0).fuel, Fuel::mixture("twice", &[half(0.3), half(0.7)]).unwrap());
        for um in [2.6, 3.3801, 3.4, 5.5] {
            for t in [250.0, 299.15, 400.0, 700.0] {
                let ((a, b), (c, d)) = (own.liquid_index(um, t), mixed.liquid_index(um, t));
                assert!((a - c).abs() < 1e-12 && (b - d).abs() < 1e-12, "{um} {t}");
                let (a, b) =
                    (own.vapour_cross_section_m2_mol(um, t), mixed.vapour_cross_section_m2_mol(um, t));
                assert!((a - b).abs() < 1e-12 * (1.0 + a), "{um} {t}");
            }
        }
        for fractions in
            [vec![], vec![0.5], vec![0.5, 0.6], vec![1.2, -0.2], vec![f64::NAN, 1.0], vec![0.0, 1.0]]
        {
            let parts: Vec<Part> = fractions.iter().map(|f| half(*f)).collect();
            assert!(matches!(Fuel::mixture("bad", &parts), Err(FuelError::Value { .. })), "{fractions:?}");
        }
    }
}
