//! Fuel and nitrogen at one pressure, tabulated over the temperature for the many look-ups of the evaporation.
//!
//! Enthalpies are consistent: that of the liquid is the integral of its heat capacity, that of the vapour starts from
//! the heat of vaporisation at the fuel's temperature and is the integral of the vapour's heat capacity (Kirchhoff).

use crate::fluid::fuel::{FuelProperties, Property};
use crate::fluid::nitrogen;
use crate::fluid::{GAS_CONSTANT_J_MOL_K, fuel::Constants};

/// First and last temperature of the table, K; beyond them its ends are used. Correlations beyond their own range are
/// taken at its end, but for the saturation pressure, whose form holds from the triple to the critical point.
const RANGE_K: [f64; 2] = [200.0, 760.0];
/// Nodes, one every kelvin.
const NODES: usize = 561;
/// Least heat of vaporisation in J/kg: near the critical point the model ends.
const LATENT_MIN: f64 = 1e4;

/// Properties at one temperature, in SI units.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Node {
    /// Saturation pressure of the fuel.
    pub(super) saturation_pa: f64,
    /// Density, heat capacity and enthalpy of the liquid; the enthalpy is 0 at the fuel's temperature.
    pub(super) liquid_kg_m3: f64,
    pub(super) liquid_j_kg_k: f64,
    pub(super) liquid_j_kg: f64,
    /// Heat capacity, enthalpy (counted from the liquid at the fuel's temperature) and conductivity of the vapour, and
    /// its diffusivity in the gas.
    pub(super) vapour_j_kg_k: f64,
    pub(super) vapour_j_kg: f64,
    pub(super) vapour_w_m_k: f64,
    pub(super) diffusivity_m2_s: f64,
    /// Heat capacity, enthalpy (0 at the first temperature of the table), conductivity and viscosity of the gas.
    pub(super) gas_j_kg_k: f64,
    pub(super) gas_j_kg: f64,
    pub(super) gas_w_m_k: f64,
    pub(super) gas_pa_s: f64,
}

/// Fuel and gas at one pressure.
#[derive(Debug, Clone)]
pub(super) struct Properties {
    nodes: Vec<Node>,
    /// Pressure in Pa.
    pub(super) pressure_pa: f64,
    /// Molar masses of fuel and gas in kg/mol.
    pub(super) molar_kg_mol: [f64; 2],
    /// Temperature in K at which the fuel boils at this pressure, or the end of its liquid's range.
    pub(super) boiling_k: f64,
}

impl Node {
    /// Heat of vaporisation, J/kg.
    pub(super) fn latent_j_kg(&self) -> f64 {
        (self.vapour_j_kg - self.liquid_j_kg).max(LATENT_MIN)
    }
}

impl Properties {
    /// `fuel` at `pressure_pa` in nitrogen, enthalpies counted from `fuel_k`.
    pub(super) fn new(fuel: &FuelProperties, pressure_pa: f64, fuel_k: f64) -> Self {
        let Constants { critical_k, molar_mass_kg_mol, .. } = *fuel.constants();
        let gas = |property, t: f64| {
            let correlation = nitrogen::correlation(property);
            correlation.at(t.clamp(correlation.range_k[0], correlation.range_k[1]))
        };
        let mut nodes: Vec<Node> = (0..NODES)
            .map(|i| {
                let t = RANGE_K[0] + i as f64;
                Node {
                    saturation_pa: fuel.correlation(Property::VapourPressure).at(t.min(critical_k)),
                    liquid_kg_m3: fuel.nearest(Property::LiquidDensity, t),
                    liquid_j_kg_k: fuel.nearest(Property::LiquidHeatCapacity, t),
                    vapour_j_kg_k: fuel.nearest(Property::VapourHeatCapacity, t),
                    vapour_w_m_k: fuel.nearest(Property::VapourConductivity, t),
                    diffusivity_m2_s: fuel.nearest(Property::DiffusivityAt1Bar, t) * 1e5 / pressure_pa,
                    gas_j_kg_k: gas(nitrogen::Property::HeatCapacity, t),
                    gas_w_m_k: gas(nitrogen::Property::Conductivity, t),
                    gas_pa_s: gas(nitrogen::Property::Viscosity, t),
                    ..Node::default()
                }
            })
            .collect();
        for i in 1..NODES {
            let (low, high) = (nodes[i - 1], nodes[i]);
            let mean = |of: fn(&Node) -> f64| 0.5 * (of(&low) + of(&high));
            nodes[i].liquid_j_kg = low.liquid_j_kg + mean(|n| n.liquid_j_kg_k);
            nodes[i].vapour_j_kg = low.vapour_j_kg + mean(|n| n.vapour_j_kg_k);
            nodes[i].gas_j_kg = low.gas_j_kg + mean(|n| n.gas_j_kg_k);
        }
        let upper_k = fuel.correlation(Property::VapourPressure).range_k[1];
        let boiling_k = fuel.correlation(Property::VapourPressure);
        let boiling_k = if boiling_k.at(upper_k) <= pressure_pa {
            upper_k
        } else {
            let (mut low, mut high) = (RANGE_K[0], upper_k);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if boiling_k.at(middle) < pressure_pa {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            0.5 * (low + high)
        };
        let mut made = Self {
            nodes,
            pressure_pa,
            molar_kg_mol: [molar_mass_kg_mol, nitrogen::MOLAR_MASS_KG_MOL],
            boiling_k,
        };
        let (liquid, vapour) = (made.at(fuel_k).liquid_j_kg, made.at(fuel_k).vapour_j_kg);
        let latent = fuel.nearest(Property::HeatOfVaporisation, fuel_k);
        for node in &mut made.nodes {
            node.liquid_j_kg -= liquid;
            node.vapour_j_kg += latent - vapour;
        }
        made
    }

    /// Properties at a temperature in K, linear between whole kelvins.
    // Most callers need two or three of them: inlined, the others are not computed.
    #[inline]
    pub(super) fn at(&self, temperature_k: f64) -> Node {
        let place = (temperature_k - RANGE_K[0]).clamp(0.0, (NODES - 1) as f64);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the table")]
        let cell = (place as usize).min(NODES - 2);
        let (low, high, share) = (&self.nodes[cell], &self.nodes[cell + 1], place - cell as f64);
        let mix = |of: fn(&Node) -> f64| of(low) + share * (of(high) - of(low));
        Node {
            saturation_pa: mix(|n| n.saturation_pa),
            liquid_kg_m3: mix(|n| n.liquid_kg_m3),
            liquid_j_kg_k: mix(|n| n.liquid_j_kg_k),
            liquid_j_kg: mix(|n| n.liquid_j_kg),
            vapour_j_kg_k: mix(|n| n.vapour_j_kg_k),
            vapour_j_kg: mix(|n| n.vapour_j_kg),
            vapour_w_m_k: mix(|n| n.vapour_w_m_k),
            diffusivity_m2_s: mix(|n| n.diffusivity_m2_s),
            gas_j_kg_k: mix(|n| n.gas_j_kg_k),
            gas_j_kg: mix(|n| n.gas_j_kg),
            gas_w_m_k: mix(|n| n.gas_w_m_k),
            gas_pa_s: mix(|n| n.gas_pa_s),
        }
    }

    /// Density of a mixture of ideal gases in kg/m³ at a temperature in K, `fuel_share` of its mass being vapour.
    pub(super) fn mixture_kg_m3(&self, temperature_k: f64, fuel_share: f64) -> f64 {
        let [fuel, gas] = self.molar_kg_mol;
        let moles = fuel_share / fuel + (1.0 - fuel_share) / gas;
        self.pressure_pa / (GAS_CONSTANT_J_MOL_K * temperature_k * moles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_the_correlations() {
        let fuel = FuelProperties::named("isooctane").unwrap();
        let table = Properties::new(fuel, 6e5, 363.0);
        for t in [290.0, 350.4, 420.0, 470.0] {
            let at = table.at(t);
            let near = |own: f64, property, tolerance: f64| {
                assert!(
                    (own / fuel.at(property, t).unwrap() - 1.0).abs() < tolerance,
                    "{property:?} {t}: {own}"
                );
            };
            near(at.saturation_pa, Property::VapourPressure, 5e-4);
            near(at.liquid_kg_m3, Property::LiquidDensity, 1e-5);
            // Kirchhoff's law neglects that the vapour is no ideal gas.
            near(at.latent_j_kg(), Property::HeatOfVaporisation, if t < 430.0 { 0.06 } else { 0.25 });
        }
        // Isooctane boils at 372.36 K at one atmosphere.
        let boiling = Properties::new(fuel, 101_325.0, 363.0).boiling_k;
        assert!((boiling - 372.36).abs() < 0.1, "{boiling}");
        assert!((table.mixture_kg_m3(573.0, 0.0) - nitrogen::density(573.0, 6e5).unwrap()).abs() < 1e-9);
    }
}
