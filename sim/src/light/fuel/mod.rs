//! Optical properties of fuels: index of the liquid, absorption cross-section of the vapour.
//!
//! Shipped fuels, mixtures, and fuels of the user's own tables. Knows neither droplets nor bands, and no files: text
//! comes in.

mod density;
mod mixture;
mod own;
mod shipped;
#[cfg(test)]
mod tests;

pub use density::{Density, EXTRAPOLATION_K};
pub use mixture::Part;
pub use own::Open;
pub use shipped::{NAMES, pure_name};

use super::complex::Complex;
use super::names;
use super::provenance::Provenance;
use super::table::{Table, TableError, locate};

/// Temperature of the shipped tables of liquid index, K.
pub const LIQUID_REFERENCE_K: f64 = 299.15;

/// Largest |(m² − 1)/(m² + 2)| of a liquid, at its largest density: at 1 the index has a pole. Fuels reach 0.3.
const RESPONSE_MAX: f64 = 0.9;

/// Why there is no such fuel.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuelError {
    /// The name is not known.
    #[error(
        "fuel `{name}` is not known{}; known are {}; a fuel of your own is a file that ends in .toml",
        names::guessed(name, &NAMES),
        NAMES.join(", ")
    )]
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
    /// A file of a fuel of the user's own cannot be used.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// What is wrong in it and what would be right.
        problem: String,
    },
}

impl FuelError {
    fn unknown(name: &str) -> Self {
        Self::Unknown { name: name.to_owned() }
    }
}

/// A fuel as light sees it.
#[derive(Debug, Clone)]
pub struct Fuel {
    name: String,
    source: String,
    molar_mass_kg_mol: f64,
    density: Density,
    /// Temperature of the table of the liquid, K.
    reference_k: f64,
    liquid_um: Vec<f64>,
    /// (m² − 1)/(m² + 2) at the reference temperature, per wavelength.
    response: Vec<Complex>,
    vapour_um: Vec<f64>,
    vapour_k: Vec<f64>,
    /// m²/mol, `[temperature][wavelength]`.
    vapour_m2_mol: Vec<Vec<f64>>,
    liquid_provenance: Provenance,
    vapour_provenance: Provenance,
}

impl Fuel {
    /// A fuel of the tables that are shipped, by one of [`NAMES`]; [`Fuel::source`] says what its numbers are.
    ///
    /// # Errors
    ///
    /// [`FuelError::Unknown`] with the names there are and the one that may be meant.
    pub fn named(name: &str) -> Result<Self, FuelError> {
        shipped::fuel(name)
    }

    /// Mixes fuels by volume: Lorentz–Lorenz for the liquid, mole fractions for the vapour. The fractions hold at
    /// [`LIQUID_REFERENCE_K`] and add up to 1 within 1e-3; the mixture covers the wavelengths that all liquids do.
    ///
    /// # Errors
    ///
    /// [`FuelError::Value`] for fractions that are no such fractions, or liquids without common wavelengths.
    pub fn mixture(name: &str, parts: &[Part]) -> Result<Self, FuelError> {
        mixture::mix(name, parts)
    }

    /// A fuel of the user's own tables, whose source is said by `source` instead of the files.
    ///
    /// `liquid` has the columns wavelength_um, n, k (k ≥ 0 absorbs) at [`LIQUID_REFERENCE_K`]; `vapour` has
    /// wavelength_um and one or more sigma_m2_mol_…K (base e, per mole). A column wavenumber_cm-1, where present,
    /// takes precedence over the rounded wavelengths.
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
        let fuel = Self::of_tables(name, liquid, vapour, molar_mass_kg_mol, density)?;
        Ok(Self { source: source.to_owned(), ..fuel })
    }

    fn of_tables(
        name: &str,
        liquid: &str,
        vapour: &str,
        molar_mass_kg_mol: f64,
        density: Density,
    ) -> Result<Self, FuelError> {
        Self::of_tables_at(name, liquid, vapour, molar_mass_kg_mol, (density, LIQUID_REFERENCE_K))
    }

    /// The liquid's table is at the temperature beside the density.
    fn of_tables_at(
        name: &str,
        liquid: &str,
        vapour: &str,
        molar_mass_kg_mol: f64,
        (density, reference_k): (Density, f64),
    ) -> Result<Self, FuelError> {
        let value = |which, value| FuelError::Value { fuel: name.to_owned(), which, value };
        let at = |which| move |source| FuelError::Table { fuel: name.to_owned(), which, source };
        if !(molar_mass_kg_mol > 0.0 && molar_mass_kg_mol.is_finite()) {
            return Err(value("molar mass in kg/mol", molar_mass_kg_mol));
        }
        if !(reference_k > 0.0 && reference_k.is_finite()) {
            return Err(value("temperature of the liquid's table in K", reference_k));
        }
        let reference = density.at(reference_k);
        if !(reference > 0.0 && reference.is_finite()) {
            return Err(value("density at the temperature of the liquid's table in kg/m3", reference));
        }
        // The density is clamped, so these are its largest and smallest values.
        let (densest, thinnest) = (density.at(0.0), density.at(f64::MAX));
        if !(densest.is_finite() && thinnest > 0.0) {
            return Err(value(
                "density in kg/m3 over its range",
                if thinnest > 0.0 { densest } else { thinnest },
            ));
        }
        let liquid = liquid_table(liquid).map_err(at(LIQUID_TABLE))?;
        let vapour = vapour_table(vapour).map_err(at(VAPOUR_TABLE))?;
        let strongest =
            liquid.response.iter().map(|x| x.abs()).fold(0.0, f64::max) * densest.max(reference) / reference;
        if strongest >= RESPONSE_MAX {
            return Err(value("largest (m²-1)/(m²+2) of the liquid, 0.9 at most", strongest));
        }
        Ok(Self {
            name: name.to_owned(),
            source: sources(&liquid.provenance, &vapour.provenance),
            molar_mass_kg_mol,
            density,
            reference_k,
            liquid_um: liquid.um,
            response: liquid.response,
            vapour_um: vapour.um,
            vapour_k: vapour.kelvin,
            vapour_m2_mol: vapour.m2_mol,
            liquid_provenance: liquid.provenance,
            vapour_provenance: vapour.provenance,
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

    /// What the table of the liquid says of itself.
    pub fn liquid_provenance(&self) -> &Provenance {
        &self.liquid_provenance
    }

    /// What the table of the vapour says of itself.
    pub fn vapour_provenance(&self) -> &Provenance {
        &self.vapour_provenance
    }

    /// Molar mass in kg/mol.
    pub fn molar_mass_kg_mol(&self) -> f64 {
        self.molar_mass_kg_mol
    }

    /// Density of the liquid in kg/m³, see [`Density::at`].
    pub fn liquid_density(&self, temperature_k: f64) -> f64 {
        self.density.at(temperature_k)
    }

    /// Range of the density in K; above it its upper end is used, below it see [`Density`].
    pub fn density_range_k(&self) -> [f64; 2] {
        self.density.range_k()
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
    /// A = V (m² − 1)/(m² + 2) is kept and the molar volume V follows the density; hot bands are neglected. Above the
    /// range of the density (0.9 T_c for shipped fuels) the index stays what it is at its upper end.
    pub fn liquid_index(&self, wavelength_um: f64, temperature_k: f64) -> (f64, f64) {
        let (lower, fraction) = locate(&self.liquid_um, wavelength_um);
        let response = self.response[lower] * (1.0 - fraction) + self.response[lower + 1] * fraction;
        let x = response * (self.density.at(temperature_k) / self.density.at(self.reference_k));
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

/// (m² − 1)/(m² + 2).
fn lorentz_lorenz(m: Complex) -> Complex {
    let square = m * m;
    (square - Complex::new(1.0, 0.0)) / (square + Complex::new(2.0, 0.0))
}

const LIQUID_TABLE: &str = "table of the liquid";
const VAPOUR_TABLE: &str = "table of the vapour";

struct Liquid {
    um: Vec<f64>,
    response: Vec<Complex>,
    provenance: Provenance,
}

fn liquid_table(text: &str) -> Result<Liquid, TableError> {
    let table = Table::parse(text)?;
    let um = table.wavelengths_um()?;
    let n = table.possible("n", "finite and above 0", |n| n > 0.0 && n.is_finite())?;
    let k = table.possible("k", "finite and not negative (k > 0 absorbs)", |k| k >= 0.0 && k.is_finite())?;
    let response = n.iter().zip(k).map(|(&n, &k)| lorentz_lorenz(Complex::new(n, k))).collect();
    Ok(Liquid { um, response, provenance: table.provenance().clone() })
}

struct Vapour {
    um: Vec<f64>,
    kelvin: Vec<f64>,
    m2_mol: Vec<Vec<f64>>,
    provenance: Provenance,
}

fn vapour_table(text: &str) -> Result<Vapour, TableError> {
    let table = Table::parse(text)?;
    let um = table.wavelengths_um()?;
    let columns = table.over_temperature("sigma_m2_mol_");
    if columns.is_empty() {
        let wanted = "sigma_m2_mol_<T>K".to_owned();
        return Err(TableError::Column { wanted, found: table.names().join(", ") });
    }
    let column = |name| table.possible(name, "finite and not negative", |s| s >= 0.0 && s.is_finite());
    let m2_mol = columns.iter().map(|(_, name)| Ok(column(name)?.to_vec())).collect::<Result<_, _>>()?;
    let kelvin = columns.iter().map(|(kelvin, _)| *kelvin).collect();
    Ok(Vapour { um, kelvin, m2_mol, provenance: table.provenance().clone() })
}

fn sources(liquid: &Provenance, vapour: &Provenance) -> String {
    format!("liquid: {liquid}; vapour: {vapour}")
}
