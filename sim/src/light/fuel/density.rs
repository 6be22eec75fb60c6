//! Density of a liquid over temperature: it carries the liquid's index from one temperature to another.

use crate::fluid::correlation::Correlation;
use crate::light::table::{Table, TableError, interpolate};

/// How far below its range a density is extrapolated, K (droplets cool below 280 K as they evaporate); the fits are
/// smooth there, and 40 K more change n by 0.02.
pub const EXTRAPOLATION_K: f64 = 40.0;

/// Density of the liquid on the saturation line.
///
/// Every form has a range of temperatures in K. Above it the density of its upper end holds (0.9 T_c in the shipped
/// fits: droplets do not live there), below it fits go on for [`EXTRAPOLATION_K`] and then stay; tables stay at
/// once.
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
    /// Values in kg/m³ at ascending temperatures in K, linear between.
    Table {
        /// Temperatures in K.
        temperature_k: Vec<f64>,
        /// Densities in kg/m³.
        kg_m3: Vec<f64>,
    },
    /// Ideal mixture: mole fraction, molar mass in kg/mol and density of each part.
    Mixture(Vec<(f64, f64, Density)>),
}

impl Density {
    /// From a table with the columns T_K and rho_liq_kg_m3.
    ///
    /// # Errors
    ///
    /// [`TableError`] unless temperatures ascend above 0 and densities are finite and above 0.
    pub fn from_csv(text: &str) -> Result<Self, TableError> {
        let table = Table::parse(text)?;
        let wanted = "finite and above 0";
        let possible = |value: f64| value > 0.0 && value.is_finite();
        table.possible("T_K", wanted, possible)?;
        Ok(Self::Table {
            temperature_k: table.ascending("T_K")?.to_vec(),
            kg_m3: table.possible("rho_liq_kg_m3", wanted, possible)?.to_vec(),
        })
    }

    /// The density fit of a fuel with thermophysical properties.
    pub(super) fn of_correlation(fit: &Correlation) -> Self {
        Self::Fit { coefficients: fit.coefficients, critical_k: fit.critical_k, range_k: fit.range_k }
    }

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
            Self::Table { temperature_k: nodes, kg_m3 } => interpolate(nodes, kg_m3, temperature_k),
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

    /// The temperatures in K between which the density is known; of a mixture, all of whose parts are.
    pub fn range_k(&self) -> [f64; 2] {
        match self {
            Self::Fit { range_k, .. } | Self::Rackett { range_k, .. } => *range_k,
            Self::Table { temperature_k, .. } => [temperature_k[0], temperature_k[temperature_k.len() - 1]],
            Self::Mixture(parts) => parts
                .iter()
                .map(|part| part.2.range_k())
                .fold([0.0, f64::INFINITY], |all, own| [all[0].max(own[0]), all[1].min(own[1])]),
        }
    }
}

fn clamped(temperature_k: f64, range_k: &[f64; 2]) -> f64 {
    temperature_k.clamp(range_k[0] - EXTRAPOLATION_K, range_k[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn racketts_equation_agrees_with_a_fuel_whose_density_is_known() {
        // As used for n-octane, tried on n-heptane (T_c 540.2 K, Z_RA 0.2611, 679.6 kg/m3 at 298.15 K) against its
        // table at 380 K: the equation's usual error is below 1 %.
        let rackett = Density::Rackett {
            reference_kg_m3: 679.6,
            reference_k: 298.15,
            critical_k: 540.2,
            compressibility: 0.2611,
            range_k: [280.0, 485.0],
        };
        assert!((rackett.at(380.0) / 605.276 - 1.0).abs() < 0.01, "{}", rackett.at(380.0));
        assert_eq!(rackett.at(900.0).to_bits(), rackett.at(485.0).to_bits());
        assert_eq!(rackett.at(100.0).to_bits(), rackett.at(240.0).to_bits());
    }

    #[test]
    fn a_table_is_linear_and_keeps_its_ends() {
        let table = Density::from_csv("T_K,rho_liq_kg_m3\n300,700\n400,600\n").unwrap();
        for (t, wanted) in [(200.0, 700.0), (325.0, 675.0), (900.0, 600.0)] {
            assert!((table.at(t) - wanted).abs() < 1e-12 * wanted);
        }
        assert_eq!(table.range_k().map(f64::to_bits), [300f64, 400.0].map(f64::to_bits));
        let mixed = Density::Mixture(vec![(0.5, 0.1, table.clone()), (0.5, 0.1, table.clone())]);
        assert!((mixed.at(325.0) - 675.0).abs() < 1e-9);
        for bad in [
            "T_K,rho_liq_kg_m3\n300,700\n",
            "T_K,rho_liq_kg_m3\n400,7\n300,6\n",
            "T_K,rho_liq_kg_m3\n3,-7\n4,6\n",
        ] {
            assert!(Density::from_csv(bad).is_err(), "{bad}");
        }
    }
}
