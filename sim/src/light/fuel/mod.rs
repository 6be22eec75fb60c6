//! Optical properties of fuels: index of the liquid, absorption cross-section of the vapour.
//!
//! Shipped fuels, mixtures, and fuels of the user's own tables. Knows neither droplets nor bands, and no files: text
//! comes in.

mod density;
mod mixture;
mod own;
mod shipped;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_liquid_at_its_reference_temperature_is_the_table() {
        // optics.md: n-heptane k max 0.159 at 3.419 um, 0.124 at 3.380, 0.069 at 3.400.
        let fuel = Fuel::named("n-heptane").unwrap();
        for (lam, k) in [(3.419, 0.159), (3.380, 0.124), (3.400, 0.069)] {
            assert!((fuel.liquid_index(lam, LIQUID_REFERENCE_K).1 - k).abs() < 1e-3, "{lam}");
        }
        let table =
            Table::parse(include_str!("../../../data/optics/liquid_n-octane_nk_measured.csv")).unwrap();
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
    fn the_index_stays_finite_and_falls_with_density_up_to_any_temperature() {
        for name in NAMES {
            let fuel = Fuel::named(name).unwrap();
            let [_, to] = fuel.density_range_k();
            for um in [2.0, 2.5, 3.38, 3.42, 6.0, 9.0] {
                let mut before = f64::INFINITY;
                for t in [0.0, 100.0, 239.0, 280.0, 400.0, to, to + 1.0, 2000.0] {
                    let (n, k) = fuel.liquid_index(um, t);
                    assert!(
                        n.is_finite() && n > 1.0 && (0.0..1.0).contains(&k),
                        "{name} {um} um {t} K: {n} {k}"
                    );
                    // |m² - 1| follows the density.
                    let m = Complex::new(n, k);
                    let strength = (m * m - Complex::new(1.0, 0.0)).abs();
                    assert!(strength <= before * (1.0 + 1e-12), "{name} {um} um {t} K");
                    before = strength;
                }
                // A mixture's range ends with that of its first part; the others go on a little.
                let (end, beyond) = (fuel.liquid_index(um, to + 300.0), fuel.liquid_index(um, to + 500.0));
                assert_eq!(end.0.to_bits(), beyond.0.to_bits(), "{name}");
            }
        }
    }

    #[test]
    fn vapour_between_two_temperatures_of_the_table_is_within_a_percent() {
        // Every inner column from its neighbours 50 K away on either side: the error of a straight line is a quarter
        // of that between columns. 1 % of the band's largest value, then, is far below the model's 15 %.
        for name in NAMES {
            let fuel = Fuel::named(name).unwrap();
            for own in 1..fuel.vapour_k.len() - 1 {
                let column = |at: usize| &fuel.vapour_m2_mol[at];
                let largest = column(own).iter().copied().fold(0.0, f64::max);
                for index in 0..fuel.vapour_um.len() {
                    let mean = 0.5 * (column(own - 1)[index] + column(own + 1)[index]);
                    let error = 0.25 * (mean - column(own)[index]).abs() / largest;
                    assert!(
                        error < 0.01,
                        "{name} {} um {} K: {error}",
                        fuel.vapour_um[index],
                        fuel.vapour_k[own]
                    );
                }
            }
        }
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
        for bad in
            ["3,1.4,0.1\n4,1.4,-0.1", "3,1.4,0.1\n4,0,0.1", "3,1.4,0.1\n4,nan,0.1", "3,1.4,0.1\n4,1.4,inf"]
        {
            let error = make(&format!("wavelength_um,n,k\n{bad}\n"), vapour, 0.1).unwrap_err().to_string();
            assert!(error.contains("row 2 (line 3)") && error.contains("table of the liquid"), "{error}");
        }
        // An index whose molar response has a pole when the liquid gets denser.
        assert!(matches!(
            make("wavelength_um,n,k\n3,6,0\n4,6,0\n", vapour, 0.1),
            Err(FuelError::Value { .. })
        ));
        let error = Fuel::named("n-heptan").unwrap_err().to_string();
        assert!(error.contains("did you mean `n-heptane`?"), "{error}");
        assert!(!Fuel::named("xyz").unwrap_err().to_string().contains("did you mean"));
    }
}
