//! The fuels that are part of the program.

use super::mixture::{self, Part};
use super::{Density, Fuel, FuelError};
use crate::fluid::fuel::{FuelProperties, Property};
use crate::light::table::{Records, TableError};

/// Names of the fuels that are shipped, as [`Fuel::named`] takes them.
pub const NAMES: [&str; 8] = [
    "n-heptane",
    "n-octane",
    "n-hexadecane",
    "isooctane",
    "isooctane-lowres",
    "ethanol",
    "toluene",
    "E10-surrogate",
];

/// Text of the tables of liquid and vapour of each of [`NAMES`]; `isooctane-lowres` is the measured but smeared
/// liquid with the same model vapour.
const TABLES: [(&str, &str); NAMES.len()] = [
    (
        include_str!("../../../data/optics/liquid_n-heptane_nk_model.csv"),
        include_str!("../../../data/optics/vapour_n-heptane_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_n-octane_nk_measured.csv"),
        include_str!("../../../data/optics/vapour_n-octane_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_n-hexadecane_nk_model.csv"),
        include_str!("../../../data/optics/vapour_n-hexadecane_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_isooctane_nk_model.csv"),
        include_str!("../../../data/optics/vapour_isooctane_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_isooctane_nk_measured_lowres.csv"),
        include_str!("../../../data/optics/vapour_isooctane_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_ethanol_nk_measured.csv"),
        include_str!("../../../data/optics/vapour_ethanol_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_toluene_nk_measured.csv"),
        include_str!("../../../data/optics/vapour_toluene_xsec_model.csv"),
    ),
    (
        include_str!("../../../data/optics/liquid_E10_surrogate_nk_model.csv"),
        include_str!("../../../data/optics/vapour_E10_surrogate_xsec_model.csv"),
    ),
];

/// A shipped fuel.
pub(super) fn fuel(name: &str) -> Result<Fuel, FuelError> {
    let index = NAMES.iter().position(|own| *own == name).ok_or_else(|| FuelError::unknown(name))?;
    let (molar_mass, density) = liquid(name)?;
    let (liquid, vapour) = TABLES[index];
    Fuel::of_tables(name, liquid, vapour, molar_mass, density)
}

/// Molar mass in kg/mol and density: from the mixture's parts, the fits, or Rackett's equation.
fn liquid(name: &str) -> Result<(f64, Density), FuelError> {
    if let Some(parts) = composition(name)? {
        return Ok(mixture::liquid(&parts));
    }
    let pure = pure_name(name);
    if let Some(properties) = FuelProperties::named(pure) {
        let density = Density::of_correlation(properties.correlation(Property::LiquidDensity));
        return Ok((properties.constants().molar_mass_kg_mol, density));
    }
    rackett(pure)
        .map_err(|source| FuelError::Table { fuel: name.to_owned(), which: "Rackett's equation", source })?
        .ok_or_else(|| FuelError::unknown(name))
}

/// The pure substance that a shipped fuel is, under which `fluid` and the density know it.
pub fn pure_name(name: &str) -> &str {
    if name == "isooctane-lowres" { "isooctane" } else { name }
}

fn rackett(name: &str) -> Result<Option<(f64, Density)>, TableError> {
    let records = Records::parse(include_str!("../../../data/fuels/rackett.csv"))?;
    let Some(row) = (0..records.len()).find(|&row| records.text(row, "fuel") == Ok(name)) else {
        return Ok(None);
    };
    let number = |column| records.number(row, column);
    let density = Density::Rackett {
        reference_kg_m3: number("rho_kg_m3")?,
        reference_k: number("T_K")?,
        critical_k: number("T_crit_K")?,
        compressibility: number("Z_RA")?,
        range_k: [number("T_min_K")?, number("T_max_K")?],
    };
    Ok(Some((number("M_g_mol")? * 1e-3, density)))
}

/// Parts of a shipped mixture by volume at [`LIQUID_REFERENCE_K`]; `None` for a pure fuel.
pub(super) fn composition(name: &str) -> Result<Option<Vec<Part>>, FuelError> {
    let wrong = |source| FuelError::Table { fuel: name.to_owned(), which: "composition", source };
    let records = Records::parse(include_str!("../../../data/fuels/mixtures.csv")).map_err(wrong)?;
    let mut parts = Vec::new();
    for row in 0..records.len() {
        if records.text(row, "mixture") == Ok(name) {
            let part = fuel(records.text(row, "part").map_err(wrong)?)?;
            let volume_fraction = records.number(row, "volume_fraction").map_err(wrong)?;
            parts.push(Part { fuel: part, volume_fraction });
        }
    }
    Ok((!parts.is_empty()).then_some(parts))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_fuel_loads_with_status_and_source() {
        for name in NAMES {
            let fuel = Fuel::named(name).unwrap();
            for provenance in [fuel.liquid_provenance(), fuel.vapour_provenance()] {
                assert!(provenance.status.is_some() && !provenance.source.is_empty(), "{name}");
                assert!(fuel.source().contains(&provenance.to_string()), "{name}: {}", fuel.source());
            }
            let mut before = f64::INFINITY;
            for t in [240.0, 260.0, 280.0, 300.0, 383.0, 450.0, 700.0] {
                let density = fuel.liquid_density(t);
                assert!(density > 300.0 && density <= before, "{name} at {t} K: {density} kg/m3");
                before = density;
                let (n, k) = fuel.liquid_index(3.4, t);
                assert!(n > 1.1 && n < 1.6 && (0.0..0.3).contains(&k), "{name} at {t} K: {n} {k}");
            }
        }
    }

    #[test]
    fn densities_agree_with_the_tables_they_were_fitted_to() {
        // liquid_*.csv, 300 and 380 K; fit error at most 0.014 %.
        for (name, t, rho) in [
            ("n-heptane", 300.0, 678.033),
            ("n-heptane", 380.0, 605.276),
            ("isooctane", 300.0, 686.369),
            ("toluene", 380.0, 782.995),
            ("n-hexadecane", 380.0, 712.989),
        ] {
            let found = Fuel::named(name).unwrap().liquid_density(t);
            assert!((found / rho - 1.0).abs() < 1.5e-4, "{name} {t}: {found}");
        }
    }

    #[test]
    fn volume_fractions_of_shipped_mixtures_add_up() {
        let parts = composition("E10-surrogate").unwrap().unwrap();
        let sum: f64 = parts.iter().map(|part| part.volume_fraction).sum();
        assert!((sum - 1.0).abs() < 1e-15);
        assert!(composition("ethanol").unwrap().is_none());
    }
}
