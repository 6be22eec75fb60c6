//! Optical properties of fuels: index of the liquid, absorption cross-section of the vapour.
//!
//! Holds the tables that are shipped in `sim/data`; their sources and licences are in `DATA-LICENSES.md`. Knows
//! neither droplets nor bands.

use super::complex::Complex;
use super::table::{Table, TableError, locate};

/// Temperature of the tables of liquid index, K.
pub const LIQUID_REFERENCE_K: f64 = 299.15;
/// How far below its range a density fit is extrapolated, K (droplets cool below 280 K as they evaporate); the
/// fits are smooth there, and 40 K more change n by 0.02.
const DENSITY_EXTRAPOLATION_K: f64 = 40.0;

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

/// Why there is no such fuel.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuelError {
    /// The name is not known.
    #[error("fuel `{name}` is not known; known are {}", NAMES.join(", "))]
    Unknown {
        /// The name asked for.
        name: String,
    },
    /// A table could not be read.
    #[error("fuel `{fuel}`, {which}: {source}")]
    Table {
        /// Name of the fuel.
        fuel: String,
        /// Which of its tables.
        which: &'static str,
        /// What is wrong with it.
        source: TableError,
    },
    /// A value has no physical meaning.
    #[error("fuel `{fuel}`, {which}: {value} is not a possible value")]
    Value {
        /// Name of the fuel.
        fuel: String,
        /// Which quantity.
        which: &'static str,
        /// Its value.
        value: f64,
    },
}

/// A fuel as light sees it.
#[derive(Debug, Clone)]
pub struct Fuel {
    name: String,
    source: String,
    molar_mass_kg_mol: f64,
    density: Density,
    liquid_um: Vec<f64>,
    /// (m² − 1)/(m² + 2) at [`LIQUID_REFERENCE_K`], per wavelength.
    response: Vec<Complex>,
    vapour_um: Vec<f64>,
    vapour_k: Vec<f64>,
    /// m²/mol, `[temperature][wavelength]`.
    vapour_m2_mol: Vec<Vec<f64>>,
}

/// Density of the liquid on the saturation line.
#[derive(Debug, Clone, PartialEq)]
pub enum Density {
    /// a + b τ^0.35 + c τ^(2/3) + d τ + e τ^(4/3) in kg/m³ with τ = 1 − T/T_c, between two temperatures.
    Fit {
        /// a … e in kg/m³.
        coefficients: [f64; 5],
        /// T_c in K.
        critical_k: f64,
        /// Range of the fit in K.
        range_k: [f64; 2],
    },
    /// Rackett's equation from one measured value: ρ = ρ₀ Z^((1−T₀/T_c)^(2/7) − (1−T/T_c)^(2/7)).
    Rackett {
        /// ρ₀ in kg/m³.
        reference_kg_m3: f64,
        /// T₀ in K.
        reference_k: f64,
        /// T_c in K.
        critical_k: f64,
        /// Rackett's compressibility.
        compressibility: f64,
        /// Range in K.
        range_k: [f64; 2],
    },
    /// Ideal mixture: mole fraction, molar mass in kg/mol and density of each part.
    Mixture(Vec<(f64, f64, Density)>),
}

impl Density {
    /// Density in kg/m³. The temperature is clamped to the range, extended by 40 K downwards.
    pub fn at(&self, temperature_k: f64) -> f64 {
        match self {
            Self::Fit { coefficients: [a, b, c, d, e], critical_k, range_k } => {
                let tau = 1.0 - clamped(temperature_k, range_k) / critical_k;
                let third = tau.cbrt();
                a + b * tau.powf(0.35) + c * third * third + d * tau + e * tau * third
            }
            Self::Rackett { reference_kg_m3, reference_k, critical_k, compressibility, range_k } => {
                let power = |t: f64| (1.0 - t / critical_k).powf(2.0 / 7.0);
                let exponent = power(*reference_k) - power(clamped(temperature_k, range_k));
                reference_kg_m3 * compressibility.powf(exponent)
            }
            Self::Mixture(parts) => {
                let mass: f64 = parts.iter().map(|(share, molar_mass, _)| share * molar_mass).sum();
                let volume: f64 = parts
                    .iter()
                    .map(|(share, molar_mass, density)| share * molar_mass / density.at(temperature_k))
                    .sum();
                mass / volume
            }
        }
    }
}

fn clamped(temperature_k: f64, range_k: &[f64; 2]) -> f64 {
    temperature_k.clamp(range_k[0] - DENSITY_EXTRAPOLATION_K, range_k[1])
}

impl Fuel {
    /// A fuel of the tables that are shipped, by one of [`NAMES`].
    ///
    /// `isooctane` and `n-heptane` … are model or measured as [`Fuel::source`] says; `isooctane-lowres` is the
    /// measured but smeared liquid of isooctane with the model vapour.
    ///
    /// # Errors
    ///
    /// [`FuelError::Unknown`] with the names there are.
    pub fn named(name: &str) -> Result<Self, FuelError> {
        let shipped = SHIPPED
            .iter()
            .find(|s| s.name == name)
            .ok_or_else(|| FuelError::Unknown { name: name.to_owned() })?;
        let (molar_mass, density) = shipped_liquid(name)?;
        Self::from_csv(name, shipped.source, shipped.liquid, shipped.vapour, molar_mass, density)
    }

    /// A fuel of the user's own tables.
    ///
    /// `liquid` has the columns wavelength_um, n, k (k ≥ 0 absorbs) at [`LIQUID_REFERENCE_K`]; `vapour` has
    /// wavelength_um and one or more sigma_m2_mol_…K (base e, per mole) of ascending temperature. A column
    /// wavenumber_cm-1, where present, takes precedence over the rounded wavelengths.
    ///
    /// # Errors
    ///
    /// [`FuelError::Table`] or [`FuelError::Value`] when a table, the molar mass or the density makes no sense.
    pub fn from_csv(
        name: &str,
        source: &str,
        liquid: &str,
        vapour: &str,
        molar_mass_kg_mol: f64,
        density: Density,
    ) -> Result<Self, FuelError> {
        let value = |which, value| FuelError::Value { fuel: name.to_owned(), which, value };
        let at = |which| move |source| FuelError::Table { fuel: name.to_owned(), which, source };
        if !(molar_mass_kg_mol > 0.0 && molar_mass_kg_mol.is_finite()) {
            return Err(value("molar mass in kg/mol", molar_mass_kg_mol));
        }
        let reference = density.at(LIQUID_REFERENCE_K);
        if !(reference > 0.0 && reference.is_finite()) {
            return Err(value("density at 299.15 K in kg/m3", reference));
        }
        let liquid_at = at("table of the liquid");
        let table = Table::parse(liquid).map_err(&liquid_at)?;
        let liquid_um = wavelengths(&table).map_err(&liquid_at)?;
        let (n, k) = (table.column("n").map_err(&liquid_at)?, table.column("k").map_err(&liquid_at)?);
        if let Some(&bad) = n.iter().find(|&&n| !(n > 0.0 && n.is_finite())) {
            return Err(value("real index of the liquid", bad));
        }
        if let Some(&bad) = k.iter().find(|&&k| !(k >= 0.0 && k.is_finite())) {
            return Err(value("imaginary index of the liquid (k ≥ 0 absorbs)", bad));
        }
        let response = n.iter().zip(k).map(|(&n, &k)| lorentz_lorenz(Complex::new(n, k))).collect();

        let vapour_at = at("table of the vapour");
        let table = Table::parse(vapour).map_err(&vapour_at)?;
        let vapour_um = wavelengths(&table).map_err(&vapour_at)?;
        let mut columns: Vec<(f64, Vec<f64>)> = Vec::new();
        for name in table.names() {
            let kelvin = name.strip_prefix("sigma_m2_mol_").and_then(|rest| rest.strip_suffix('K'));
            if let Some(kelvin) = kelvin.and_then(|text| text.parse::<f64>().ok()) {
                columns.push((kelvin, table.column(name).map_err(&vapour_at)?.to_vec()));
            }
        }
        columns.sort_by(|a, b| a.0.total_cmp(&b.0));
        if columns.is_empty() {
            let wanted = "sigma_m2_mol_<T>K".to_owned();
            return Err(vapour_at(TableError::Column { wanted, found: table.names().join(", ") }));
        }
        if let Some(&bad) = columns.iter().flat_map(|c| &c.1).find(|&&s| !(s >= 0.0 && s.is_finite())) {
            return Err(value("cross-section of the vapour in m2/mol", bad));
        }
        let (vapour_k, vapour_m2_mol) = columns.into_iter().unzip();
        Ok(Self {
            name: name.to_owned(),
            source: source.to_owned(),
            molar_mass_kg_mol,
            density,
            liquid_um,
            response,
            vapour_um,
            vapour_k,
            vapour_m2_mol,
        })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where the numbers come from and what they are: measured, model, assumed; with uncertainties.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Molar mass in kg/mol.
    pub fn molar_mass_kg_mol(&self) -> f64 {
        self.molar_mass_kg_mol
    }

    /// Density of the liquid in kg/m³, see [`Density::at`].
    pub fn liquid_density(&self, temperature_k: f64) -> f64 {
        self.density.at(temperature_k)
    }

    /// Range of the liquid's table in µm; outside it the ends are used.
    pub fn liquid_range_um(&self) -> [f64; 2] {
        [self.liquid_um[0], self.liquid_um[self.liquid_um.len() - 1]]
    }

    /// Range of the vapour's table in µm; outside it the cross-section is 0.
    pub fn vapour_range_um(&self) -> [f64; 2] {
        [self.vapour_um[0], self.vapour_um[self.vapour_um.len() - 1]]
    }

    /// Range of the vapour's table in K; outside it the ends are used.
    pub fn vapour_range_k(&self) -> [f64; 2] {
        [self.vapour_k[0], self.vapour_k[self.vapour_k.len() - 1]]
    }

    /// Index (n, k) of the liquid, k ≥ 0 absorbing.
    ///
    /// Linear between the wavelengths of the table, clamped to its ends. Over temperature the molar response
    /// A = V (m² − 1)/(m² + 2) is kept and the molar volume V follows the density; hot bands are neglected.
    pub fn liquid_index(&self, wavelength_um: f64, temperature_k: f64) -> (f64, f64) {
        let (lower, fraction) = locate(&self.liquid_um, wavelength_um);
        let response = self.response[lower] * (1.0 - fraction) + self.response[lower + 1] * fraction;
        let x = response * (self.density.at(temperature_k) / self.density.at(LIQUID_REFERENCE_K));
        let one = Complex::new(1.0, 0.0);
        let m = ((one + x * 2.0) / (one - x)).sqrt();
        (m.re, m.im.max(0.0))
    }

    /// Absorption cross-section of the vapour in m²/mol (base e): linear in λ and T, T clamped to the table,
    /// 0 outside its wavelengths.
    pub fn vapour_cross_section_m2_mol(&self, wavelength_um: f64, temperature_k: f64) -> f64 {
        let [from, to] = self.vapour_range_um();
        if !(from..=to).contains(&wavelength_um) {
            return 0.0;
        }
        let (lower, fraction) = locate(&self.vapour_um, wavelength_um);
        let at = |column: &[f64]| column[lower] + fraction * (column[lower + 1] - column[lower]);
        if self.vapour_k.len() == 1 {
            return at(&self.vapour_m2_mol[0]);
        }
        let (cold, warmth) = locate(&self.vapour_k, temperature_k);
        (1.0 - warmth) * at(&self.vapour_m2_mol[cold]) + warmth * at(&self.vapour_m2_mol[cold + 1])
    }
}

fn lorentz_lorenz(m: Complex) -> Complex {
    let square = m * m;
    (square - Complex::new(1.0, 0.0)) / (square + Complex::new(2.0, 0.0))
}

/// Wavelengths of a table: 1e4/wavenumber where there is one (the wavelengths beside it are rounded).
fn wavelengths(table: &Table) -> Result<Vec<f64>, TableError> {
    let rounded = table.ascending("wavelength_um")?;
    Ok(match table.column("wavenumber_cm-1") {
        Ok(wavenumber) if wavenumber.windows(2).all(|pair| pair[0] > pair[1] && pair[1] > 0.0) => {
            wavenumber.iter().map(|nu| 1e4 / nu).collect()
        }
        _ => rounded.to_vec(),
    })
}

/// One shipped pair of tables.
struct Shipped {
    name: &'static str,
    source: &'static str,
    liquid: &'static str,
    vapour: &'static str,
}

const SHIPPED: [Shipped; 8] = [
    Shipped {
        name: "n-heptane",
        source: "liquid: model from measured n-octane (Myers et al. 2018, CC0), CH2/CH3 split; k 5 %, n 0.005; \
                 vapour: model, area of Williams et al. 2013, 10 %, shape 15-25 %",
        liquid: include_str!("../../data/optics/liquid_n-heptane_nk_model.csv"),
        vapour: include_str!("../../data/optics/vapour_n-heptane_xsec_model.csv"),
    },
    Shipped {
        name: "n-octane",
        source: "liquid: measured (Myers et al. 2018, CC0), n 0.4 %, k 3 %; vapour: model, area of Williams et \
                 al. 2013, 10 %, shape 15-25 %; density: Rackett's equation from 698.6 kg/m3 at 298.15 K",
        liquid: include_str!("../../data/optics/liquid_n-octane_nk_measured.csv"),
        vapour: include_str!("../../data/optics/vapour_n-octane_xsec_model.csv"),
    },
    Shipped {
        name: "n-hexadecane",
        source: "liquid: model from measured n-octane (Myers et al. 2018, CC0), CH2/CH3 split; k 8 %, n 0.005; \
                 vapour: model, area of Williams et al. 2013, 10 %, shape 15-25 %",
        liquid: include_str!("../../data/optics/liquid_n-hexadecane_nk_model.csv"),
        vapour: include_str!("../../data/optics/vapour_n-hexadecane_xsec_model.csv"),
    },
    Shipped {
        name: "isooctane",
        source: "liquid: model from the CH3 bands of n-octane, broadened and shifted; k 25 %, n 0.02; vapour: \
                 model, area of Williams et al. 2013, 10 %, shape 25 %",
        liquid: include_str!("../../data/optics/liquid_isooctane_nk_model.csv"),
        vapour: include_str!("../../data/optics/vapour_isooctane_xsec_model.csv"),
    },
    Shipped {
        name: "isooctane-lowres",
        source: "liquid: measured but smeared over 8 nm (Anderson, CC0), shape not resolved: integrals only; \
                 vapour: model as for isooctane",
        liquid: include_str!("../../data/optics/liquid_isooctane_nk_measured_lowres.csv"),
        vapour: include_str!("../../data/optics/vapour_isooctane_xsec_model.csv"),
    },
    Shipped {
        name: "ethanol",
        source: "liquid: measured (Myers et al. 2018, CC0), n 0.4 %, k 3 %; vapour: model, liquid response x 1.10, \
                 area 20 %",
        liquid: include_str!("../../data/optics/liquid_ethanol_nk_measured.csv"),
        vapour: include_str!("../../data/optics/vapour_ethanol_xsec_model.csv"),
    },
    Shipped {
        name: "toluene",
        source: "liquid: measured (Myers et al. 2018, CC0), n 0.4 %, k 3 %; vapour: model, liquid response x 1.10, \
                 area 20 %",
        liquid: include_str!("../../data/optics/liquid_toluene_nk_measured.csv"),
        vapour: include_str!("../../data/optics/vapour_toluene_xsec_model.csv"),
    },
    Shipped {
        name: "E10-surrogate",
        source: "model: Lorentz-Lorenz mixing by volume of 10 % ethanol, 28 % toluene, 37 % isooctane, 25 % \
                 n-heptane (our composition); k 15 %",
        liquid: include_str!("../../data/optics/liquid_E10_surrogate_nk_model.csv"),
        vapour: include_str!("../../data/optics/vapour_E10_surrogate_xsec_model.csv"),
    },
];

/// Volume fractions of the E10 surrogate at [`LIQUID_REFERENCE_K`], as in the source of its optical table.
const E10_VOLUMES: [(f64, &str); 4] =
    [(0.10, "ethanol"), (0.28, "toluene"), (0.37, "isooctane"), (0.25, "n-heptane")];

/// Molar mass in kg/mol and density of a shipped fuel.
fn shipped_liquid(name: &str) -> Result<(f64, Density), FuelError> {
    match name {
        "E10-surrogate" => {
            let mut parts = Vec::new();
            for (volume, part) in E10_VOLUMES {
                let (molar_mass, density) = fitted_liquid(part)?;
                parts.push((volume * density.at(LIQUID_REFERENCE_K) / molar_mass, molar_mass, density));
            }
            let moles: f64 = parts.iter().map(|part| part.0).sum();
            for part in &mut parts {
                part.0 /= moles;
            }
            let molar_mass = parts.iter().map(|part| part.0 * part.1).sum();
            Ok((molar_mass, Density::Mixture(parts)))
        }
        // No fit is shipped for n-octane: density 0.6986 g/cm3 at 25 °C and T_c 568.7 K (CRC Handbook), Z_RA 0.2571
        // (Spencer and Danner 1972); molar mass as its isomer's.
        "n-octane" => Ok((
            0.114_228_52,
            Density::Rackett {
                reference_kg_m3: 698.6,
                reference_k: 298.15,
                critical_k: 568.7,
                compressibility: 0.2571,
                range_k: [280.0, 510.0],
            },
        )),
        "isooctane-lowres" => fitted_liquid("isooctane"),
        fitted => fitted_liquid(fitted),
    }
}

/// Molar mass in kg/mol and density fit from `fuels/constants.csv` and `fuels/fits.csv`.
fn fitted_liquid(name: &str) -> Result<(f64, Density), FuelError> {
    let unknown = || FuelError::Unknown { name: name.to_owned() };
    let row = |text: &'static str, property: Option<&str>| {
        text.lines().map(|line| line.split(',').collect::<Vec<&str>>()).find(|fields| {
            fields[0] == name && property.is_none_or(|property| fields.get(1) == Some(&property))
        })
    };
    let constants = row(include_str!("../../data/fuels/constants.csv"), None).ok_or_else(unknown)?;
    let fit = row(include_str!("../../data/fuels/fits.csv"), Some("rho_liq_kg_m3")).ok_or_else(unknown)?;
    let number = |fields: &[&str], index: usize| {
        fields.get(index).and_then(|text| text.parse::<f64>().ok()).ok_or_else(unknown)
    };
    // constants: fuel, CAS, M_g_mol, T_boil, T_crit; fits: fuel, property, form, T_min, T_max, error, a … e.
    let mut coefficients = [0.0; 5];
    for (index, coefficient) in coefficients.iter_mut().enumerate() {
        *coefficient = number(&fit, 6 + index)?;
    }
    let density = Density::Fit {
        coefficients,
        critical_k: number(&constants, 4)?,
        range_k: [number(&fit, 3)?, number(&fit, 4)?],
    };
    Ok((number(&constants, 2)? * 1e-3, density))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_fuel_loads_with_its_source() {
        for name in NAMES {
            let fuel = Fuel::named(name).unwrap();
            assert!(fuel.source().contains("model") || fuel.source().contains("measured"));
            let mut before = f64::INFINITY;
            for t in [240.0, 260.0, 280.0, 300.0, 383.0, 450.0, 700.0] {
                let density = fuel.liquid_density(t);
                assert!(density > 300.0 && density <= before, "{name} at {t} K: {density} kg/m3");
                before = density;
                let (n, k) = fuel.liquid_index(3.4, t);
                assert!(n > 1.1 && n < 1.6 && (0.0..0.3).contains(&k), "{name} at {t} K: {n} {k}");
            }
        }
        assert!(matches!(Fuel::named("water"), Err(FuelError::Unknown { .. })));
    }

    #[test]
    fn the_liquid_at_its_reference_temperature_is_the_table() {
        // optics.md: n-heptane k max 0.159 at 3.419 um, 0.124 at 3.380, 0.069 at 3.400.
        let fuel = Fuel::named("n-heptane").unwrap();
        for (lam, k) in [(3.419, 0.159), (3.380, 0.124), (3.400, 0.069)] {
            assert!((fuel.liquid_index(lam, LIQUID_REFERENCE_K).1 - k).abs() < 1e-3, "{lam}");
        }
        let table = Table::parse(include_str!("../../data/optics/liquid_n-octane_nk_measured.csv")).unwrap();
        let fuel = Fuel::named("n-octane").unwrap();
        for row in (0..table.names().len() * 100).step_by(7) {
            let at = |name| table.column(name).unwrap()[row];
            let (n, k) = fuel.liquid_index(1e4 / at("wavenumber_cm-1"), LIQUID_REFERENCE_K);
            // The same number through Lorentz-Lorenz and back: rounding only.
            assert!((n - at("n")).abs() < 1e-14 && (k - at("k")).abs() < 1e-14, "row {row}");
        }
    }

    #[test]
    fn molar_response_is_kept_when_the_liquid_expands() {
        let fuel = Fuel::named("n-heptane").unwrap();
        let response = |t: f64| {
            let (n, k) = fuel.liquid_index(3.42, t);
            let a = lorentz_lorenz(Complex::new(n, k));
            a * (fuel.molar_mass_kg_mol() / fuel.liquid_density(t))
        };
        let (cold, warm) = (response(299.15), response(400.0));
        assert!((cold - warm).abs() < 1e-14 * cold.abs() * 10.0);
    }

    #[test]
    fn densities_agree_with_the_tables_they_were_fitted_to() {
        // data/fuels/liquid_*.csv, 300 and 380 K; fit error at most 0.014 %.
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
        // Rackett's equation as used for n-octane, tried on n-heptane (T_c 540.2 K, Z_RA 0.2611, 679.6 kg/m3 at
        // 298.15 K) against its table at 380 K: the equation's usual error is below 1 %.
        let rackett = Density::Rackett {
            reference_kg_m3: 679.6,
            reference_k: 298.15,
            critical_k: 540.2,
            compressibility: 0.2611,
            range_k: [280.0, 485.0],
        };
        assert!((rackett.at(380.0) / 605.276 - 1.0).abs() < 0.01, "{}", rackett.at(380.0));
    }

    #[test]
    fn vapour_absorbs_in_its_band_only_and_keeps_the_ends_of_its_temperatures() {
        let fuel = Fuel::named("n-heptane").unwrap();
        // optics.md: 46 m2/mol at 3.39 um and 300 K.
        assert!((fuel.vapour_cross_section_m2_mol(1e4 / 2947.9, 300.0) - 46.0).abs() < 1.0);
        let [from, to] = fuel.vapour_range_um();
        for lam in [2.5, from - 1e-6, to + 1e-6, 4.3] {
            assert_eq!(fuel.vapour_cross_section_m2_mol(lam, 450.0).to_bits(), 0);
        }
        let at = |t| fuel.vapour_cross_section_m2_mol(3.4, t);
        assert_eq!(at(200.0).to_bits(), at(300.0).to_bits());
        assert_eq!(at(900.0).to_bits(), at(650.0).to_bits());
        assert!((at(325.0) - 0.5 * (at(300.0) + at(350.0))).abs() < 1e-12);
    }

    #[test]
    fn impossible_tables_are_refused() {
        let density = || Density::Rackett {
            reference_kg_m3: 700.0,
            reference_k: 298.0,
            critical_k: 560.0,
            compressibility: 0.26,
            range_k: [280.0, 500.0],
        };
        let liquid = "wavelength_um,n,k\n3,1.4,0.1\n4,1.4,0.1\n";
        let vapour = "wavelength_um,sigma_m2_mol_300K\n3,1\n4,1\n";
        let make =
            |liquid: &str, vapour: &str, mass| Fuel::from_csv("own", "test", liquid, vapour, mass, density());
        assert!(make(liquid, vapour, 0.1).is_ok());
        assert!(matches!(make(liquid, vapour, -0.1), Err(FuelError::Value { .. })));
        assert!(matches!(make("wavelength_um,n\n3,1\n4,1\n", vapour, 0.1), Err(FuelError::Table { .. })));
        assert!(matches!(make(liquid, "wavelength_um\n3\n4\n", 0.1), Err(FuelError::Table { .. })));
        let negative = "wavelength_um,n,k\n3,1.4,0.1\n4,1.4,-0.1\n";
        assert!(matches!(make(negative, vapour, 0.1), Err(FuelError::Value { .. })));
    }
}
