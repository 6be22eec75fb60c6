//! Liquid and vapour of the shipped pure fuels.
//!
//! Mixtures have no entry: their vapour pressure is that of no single substance.

use super::correlation::Correlation;
use super::{FluidError, within};
use crate::light::provenance::Provenance;
use crate::light::table::{Records, TableError};
use std::sync::LazyLock;

/// A property of a fuel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Property {
    /// Saturation pressure, Pa.
    VapourPressure,
    /// Density of the liquid at saturation, kg/m³.
    LiquidDensity,
    /// Isobaric heat capacity of the liquid at saturation, J/(kg K).
    LiquidHeatCapacity,
    /// Heat of vaporisation, J/kg.
    HeatOfVaporisation,
    /// Surface tension against its vapour, N/m.
    SurfaceTension,
    /// Viscosity of the liquid, Pa s.
    LiquidViscosity,
    /// Thermal conductivity of the liquid, W/(m K).
    LiquidConductivity,
    /// Isobaric heat capacity of the ideal gas, J/(kg K).
    VapourHeatCapacity,
    /// Viscosity of the dilute vapour, Pa s.
    VapourViscosity,
    /// Thermal conductivity of the dilute vapour, W/(m K).
    VapourConductivity,
    /// Diffusivity in nitrogen at 1 bar, m²/s.
    DiffusivityAt1Bar,
}

impl Property {
    /// All of them, with the names of their columns in `sim/data/fuels/fits.csv` (unit last) and in words.
    pub const ALL: [(Self, &str, &str); 11] = [
        (Self::VapourPressure, "p_sat_Pa", "saturation pressure"),
        (Self::LiquidDensity, "rho_liq_kg_m3", "density of the liquid"),
        (Self::LiquidHeatCapacity, "cp_liq_J_kgK", "heat capacity of the liquid"),
        (Self::HeatOfVaporisation, "h_vap_J_kg", "heat of vaporisation"),
        (Self::SurfaceTension, "sigma_N_m", "surface tension"),
        (Self::LiquidViscosity, "mu_liq_Pa_s", "viscosity of the liquid"),
        (Self::LiquidConductivity, "k_liq_W_mK", "conductivity of the liquid"),
        (Self::VapourHeatCapacity, "cp_ideal_gas_J_kgK", "heat capacity of the vapour"),
        (Self::VapourViscosity, "mu_vap_Pa_s", "viscosity of the vapour"),
        (Self::VapourConductivity, "k_vap_W_mK", "conductivity of the vapour"),
        (Self::DiffusivityAt1Bar, "D_in_N2_m2_s", "diffusivity in nitrogen at 1 bar"),
    ];

    /// The property in words.
    pub fn words(self) -> &'static str {
        Self::ALL[self.index()].2
    }

    /// Position in [`Property::ALL`], which is in the order of the variants.
    fn index(self) -> usize {
        self as usize
    }
}

/// Constants of a fuel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constants {
    /// Molar mass in kg/mol.
    pub molar_mass_kg_mol: f64,
    /// Boiling point at 101 325 Pa in K.
    pub boiling_k: f64,
    /// Critical temperature in K.
    pub critical_k: f64,
    /// Critical pressure in Pa.
    pub critical_pa: f64,
    /// Acentric factor.
    pub acentric: f64,
}

/// Thermophysical properties of one fuel.
#[derive(Debug, Clone)]
pub struct FuelProperties {
    name: String,
    constants: Constants,
    /// In the order of [`Property::ALL`].
    correlations: Vec<Correlation>,
}

struct Shipped {
    fuels: Vec<FuelProperties>,
    provenance: Provenance,
}

static SHIPPED: LazyLock<Shipped> = LazyLock::new(|| {
    let constants = include_str!("../../data/fuels/constants.csv");
    let fits = include_str!("../../data/fuels/fits.csv");
    Shipped::parse(constants, fits).expect("the shipped tables are read by a test")
});

impl Shipped {
    fn parse(constants: &str, fits: &str) -> Result<Self, TableError> {
        let (constants, fits) = (Records::parse(constants)?, Records::parse(fits)?);
        let fuels = (0..constants.len())
            .map(|row| FuelProperties::of_tables(&constants, row, &fits))
            .collect::<Result<_, _>>()?;
        Ok(Self { fuels, provenance: fits.provenance().clone() })
    }
}

impl FuelProperties {
    /// The properties of a shipped pure fuel: n-heptane, n-hexadecane, isooctane, ethanol, toluene.
    pub fn named(name: &str) -> Option<&'static Self> {
        Self::all().iter().find(|fuel| fuel.name == name)
    }

    /// All fuels that have properties.
    pub fn all() -> &'static [Self] {
        &SHIPPED.fuels
    }

    /// Where all of them come from.
    pub fn provenance() -> &'static Provenance {
        &SHIPPED.provenance
    }

    fn of_tables(constants: &Records<'_>, row: usize, fits: &Records<'_>) -> Result<Self, TableError> {
        let name = constants.text(row, "fuel")?;
        let number = |column| constants.number(row, column);
        let own = Constants {
            molar_mass_kg_mol: number("M_g_mol")? * 1e-3,
            boiling_k: number("T_boil_1atm_K")?,
            critical_k: number("T_crit_K")?,
            critical_pa: number("p_crit_Pa")?,
            acentric: number("acentric")?,
        };
        let correlation = |wanted: &str| {
            let row = (0..fits.len())
                .find(|&row| fits.text(row, "fuel") == Ok(name) && fits.text(row, "property") == Ok(wanted));
            let missing =
                || TableError::Column { wanted: format!("{name} {wanted}"), found: "others".to_owned() };
            let critical = [own.critical_k, own.critical_pa];
            Correlation::of_row(fits, row.ok_or_else(missing)?, "max_rel_fit_error", critical)
        };
        let correlations = Property::ALL.iter().map(|row| correlation(row.1)).collect::<Result<_, _>>()?;
        Ok(Self { name: name.to_owned(), constants: own, correlations })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Molar mass, boiling and critical point.
    pub fn constants(&self) -> &Constants {
        &self.constants
    }

    /// The correlation of a property, without a guard of its range.
    pub fn correlation(&self, property: Property) -> &Correlation {
        &self.correlations[property.index()]
    }

    /// A property in its SI unit at a temperature in K.
    ///
    /// # Errors
    ///
    /// [`FluidError::Temperature`] outside the range of the correlation (liquid: 280 or 295 K to 0.9 T_c; vapour: to
    /// 700 K): nothing is extrapolated.
    pub fn at(&self, property: Property, temperature_k: f64) -> Result<f64, FluidError> {
        let correlation = self.correlation(property);
        within(property.words(), temperature_k, correlation.range_k).map(|t| correlation.at(t))
    }

    /// A property at the temperature of its range that is nearest: for solvers that must not stop. NaN stays NaN.
    pub fn nearest(&self, property: Property, temperature_k: f64) -> f64 {
        let correlation = self.correlation(property);
        correlation.at(temperature_k.clamp(correlation.range_k[0], correlation.range_k[1]))
    }

    /// Diffusivity of the vapour in nitrogen in m²/s: Fuller, Schettler and Giddings, about 5 %; ∝ T^1.75 / p.
    ///
    /// # Errors
    ///
    /// [`FluidError`] outside 200–800 K, or unless the pressure is finite and above 0.
    pub fn diffusivity_in_nitrogen(&self, temperature_k: f64, pressure_pa: f64) -> Result<f64, FluidError> {
        let property = Property::DiffusivityAt1Bar;
        if !(pressure_pa > 0.0 && pressure_pa.is_finite()) {
            let range_pa = [0.0, f64::INFINITY];
            return Err(FluidError::Pressure { what: property.words(), pressure_pa, range_pa });
        }
        Ok(self.at(property, temperature_k)? * (1e5 / pressure_pa))
    }
}
