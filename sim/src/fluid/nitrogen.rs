//! Nitrogen as the gas of the chamber: ideal gas, transport fitted at 4 bar.

use super::correlation::Correlation;
use super::{FluidError, GAS_CONSTANT_J_MOL_K, within};
use crate::light::provenance::Provenance;
use crate::light::table::{Records, TableError};
use std::sync::LazyLock;

/// Molar mass in kg/mol (NIST Chemistry WebBook: 28.0134 g/mol).
pub const MOLAR_MASS_KG_MOL: f64 = 0.028_013_4;
/// Range of pressures in Pa in which the fits hold within 1.1 % and the ideal gas within 0.43 %.
pub const RANGE_PA: [f64; 2] = [1e5, 1e6];

/// A property of nitrogen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Property {
    /// Isobaric heat capacity, J/(kg K).
    HeatCapacity,
    /// Viscosity, Pa s.
    Viscosity,
    /// Thermal conductivity, W/(m K).
    Conductivity,
}

impl Property {
    /// All of them, with the names of their columns in `sim/data/fuels/nitrogen_fits.csv` and in words.
    pub const ALL: [(Self, &str, &str); 3] = [
        (Self::HeatCapacity, "cp_J_kgK", "heat capacity of nitrogen"),
        (Self::Viscosity, "mu_Pa_s", "viscosity of nitrogen"),
        (Self::Conductivity, "k_W_mK", "conductivity of nitrogen"),
    ];
}

struct Shipped {
    /// In the order of [`Property::ALL`].
    correlations: Vec<Correlation>,
    provenance: Provenance,
}

static SHIPPED: LazyLock<Shipped> = LazyLock::new(|| {
    Shipped::parse(include_str!("../../data/fuels/nitrogen_fits.csv"))
        .expect("the shipped table is read by a test")
});

impl Shipped {
    fn parse(text: &str) -> Result<Self, TableError> {
        let fits = Records::parse(text)?;
        let correlation = |wanted: &str| {
            let row = (0..fits.len()).find(|&row| fits.text(row, "property") == Ok(wanted));
            let missing = || TableError::Column { wanted: wanted.to_owned(), found: "others".to_owned() };
            // No form of nitrogen knows the critical point.
            Correlation::of_row(&fits, row.ok_or_else(missing)?, "max_rel_err_at_4bar", [f64::NAN; 2])
        };
        let correlations = Property::ALL.iter().map(|row| correlation(row.1)).collect::<Result<_, _>>()?;
        Ok(Self { correlations, provenance: fits.provenance().clone() })
    }
}

/// Where the fits come from.
pub fn provenance() -> &'static Provenance {
    &SHIPPED.provenance
}

/// The correlation of a property, without a guard of its range.
pub fn correlation(property: Property) -> &'static Correlation {
    &SHIPPED.correlations[property as usize]
}

/// A property in its SI unit at a temperature in K; made for 4 bar, within 1.1 % from 1 to 10 bar.
///
/// # Errors
///
/// [`FluidError::Temperature`] outside 280–700 K.
pub fn at(property: Property, temperature_k: f64) -> Result<f64, FluidError> {
    let correlation = correlation(property);
    within(Property::ALL[property as usize].2, temperature_k, correlation.range_k).map(|t| correlation.at(t))
}

/// Density in kg/m³ of the ideal gas, within 0.43 % for 280–700 K and 1–10 bar.
///
/// # Errors
///
/// [`FluidError`] outside these ranges.
pub fn density(temperature_k: f64, pressure_pa: f64) -> Result<f64, FluidError> {
    let what = "density of nitrogen";
    let range_k = SHIPPED.correlations[0].range_k;
    let t = within(what, temperature_k, range_k)?;
    if !(RANGE_PA[0]..=RANGE_PA[1]).contains(&pressure_pa) {
        return Err(FluidError::Pressure { what, pressure_pa, range_pa: RANGE_PA });
    }
    Ok(pressure_pa * MOLAR_MASS_KG_MOL / (GAS_CONSTANT_J_MOL_K * t))
}
