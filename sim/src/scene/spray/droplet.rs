//! Evaporation and warming of one droplet.
//!
//! Abramzon and Sirignano 1989 (Int. J. Heat Mass Transfer 32, 1605): Stefan flow, film thickness corrected for
//! blowing, liquid of one temperature; convection by their fit of Clift's numbers, Nu₀ = 1 + (1 + Re Pr)^⅓ max(1,
//! Re^0.077) for Re up to 400; film at the ⅓ rule. Without slip and blowing it is the d² law,
//! d(d²)/dt = −8 ρD/ρ_l ln(1 + B).

use super::properties::Properties;
use std::f64::consts::PI;

/// Largest mole fraction of vapour at the surface.
const SURFACE_MAX: f64 = 0.999;

/// The gas around droplets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Around {
    /// Temperature, K.
    pub(super) temperature_k: f64,
    /// Mass fraction of fuel vapour.
    pub(super) vapour: f64,
    /// Speed of the droplets relative to it, m/s.
    pub(super) slip_m_s: f64,
}

/// What happens to a droplet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rates {
    /// Mass that it loses, kg/s.
    pub(super) mass_kg_s: f64,
    /// Change of its temperature, K/s.
    pub(super) warming_k_s: f64,
}

/// Mass fraction of vapour at the surface of a liquid of a temperature in K.
pub(super) fn surface(properties: &Properties, temperature_k: f64) -> f64 {
    let [fuel, gas] = properties.molar_kg_mol;
    let moles = (properties.at(temperature_k).saturation_pa / properties.pressure_pa).min(SURFACE_MAX);
    moles * fuel / (moles * fuel + (1.0 - moles) * gas)
}

/// F(B) = (1 + B)^0.7 ln(1 + B)/B, the thickening of the film, from B and ln(1 + B).
fn thickening(transfer: f64, blowing: f64) -> f64 {
    if transfer < 1e-9 { 1.0 } else { (0.7 * blowing).exp() * blowing / transfer }
}

/// Rates of a droplet of a diameter in m at a temperature in K. Condensation is left out.
pub(super) fn rates(properties: &Properties, diameter_m: f64, temperature_k: f64, around: &Around) -> Rates {
    let at_surface = surface(properties, temperature_k);
    let transfer = ((at_surface - around.vapour) / (1.0 - at_surface)).max(0.0);
    let film_k = temperature_k + (around.temperature_k - temperature_k) / 3.0;
    let film = properties.at(film_k);
    let vapour = at_surface + (around.vapour - at_surface) / 3.0;
    let density = properties.mixture_kg_m3(film_k, vapour);
    let capacity = vapour * film.vapour_j_kg_k + (1.0 - vapour) * film.gas_j_kg_k;
    let conductivity = vapour * film.vapour_w_m_k + (1.0 - vapour) * film.gas_w_m_k;
    let diffusion = density * film.diffusivity_m2_s;
    let viscosity = film.gas_pa_s;
    let reynolds = density * around.slip_m_s * diameter_m / viscosity;
    let stirring = if reynolds > 1.0 { reynolds.powf(0.077) } else { 1.0 };
    let number = |other: f64| 1.0 + (1.0 + reynolds * other).cbrt() * stirring;
    let blowing = transfer.ln_1p();
    let sherwood = 2.0 + (number(viscosity / diffusion) - 2.0) / thickening(transfer, blowing);
    let mass_kg_s = PI * diameter_m * diffusion * sherwood * blowing;
    // c_v/c_g · Sh/Nu / Le, with Nu found from the heat transfer number it belongs to.
    let still = number(viscosity * capacity / conductivity);
    let lewis = conductivity / (diffusion * capacity);
    let mut nusselt = still;
    let mut heating = blowing;
    for _ in 0..3 {
        heating = film.vapour_j_kg_k / capacity * sherwood / (nusselt * lewis) * blowing;
        let blowing = heating.min(50.0);
        nusselt = 2.0 + (still - 2.0) / thickening(blowing.exp_m1(), blowing);
    }
    // ln(1 + B_T)/B_T, which is 1 without evaporation.
    let shield = if heating < 1e-9 { 1.0 } else { heating / heating.min(500.0).exp_m1() };
    let heat_w = PI * diameter_m * conductivity * nusselt * shield * (around.temperature_k - temperature_k);
    let liquid = properties.at(temperature_k);
    let mass_kg = super::sizes::sphere_kg(diameter_m, liquid.liquid_kg_m3);
    let warming_k_s = (heat_w - mass_kg_s * liquid.latent_j_kg()) / (mass_kg * liquid.liquid_j_kg_k);
    Rates { mass_kg_s, warming_k_s }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fluid::fuel::FuelProperties;

    fn heptane(pressure_pa: f64) -> Properties {
        Properties::new(FuelProperties::named("n-heptane").unwrap(), pressure_pa, 300.0)
    }

    /// Where warming stops.
    fn wet_bulb_k(properties: &Properties, around: &Around) -> f64 {
        let (mut low, mut high) = (250.0, properties.boiling_k);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if rates(properties, 10e-6, middle, around).warming_k_s > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }

    /// Second source: at the wet-bulb temperature all heat evaporates, so that by the heat balance alone
    /// K = 8 λ/(ρ_l c_v) ln(1 + c_v (T − T_w)/L) (Godsave 1953, Spalding 1953). The Stefan flow must give the same.
    #[test]
    fn mass_and_heat_agree_at_the_wet_bulb_temperature() {
        let properties = heptane(1e5);
        for gas_k in [400.0, 555.0, 648.0] {
            let around = Around { temperature_k: gas_k, vapour: 0.0, slip_m_s: 0.0 };
            let wet_k = wet_bulb_k(&properties, &around);
            assert!((290.0..371.0).contains(&wet_k), "{wet_k}");
            let d = 100e-6;
            let mass = rates(&properties, d, wet_k, &around).mass_kg_s;
            let liquid = properties.at(wet_k);
            let shrinking = 4.0 * mass / (PI * liquid.liquid_kg_m3 * d);
            let film = properties.at(wet_k + (gas_k - wet_k) / 3.0);
            let vapour = 2.0 / 3.0 * surface(&properties, wet_k);
            let conductivity = vapour * film.vapour_w_m_k + (1.0 - vapour) * film.gas_w_m_k;
            let capacity = film.vapour_j_kg_k;
            let by_heat = 8.0 * conductivity / (liquid.liquid_kg_m3 * capacity)
                * (capacity * (gas_k - wet_k) / liquid.latent_j_kg()).ln_1p();
            assert!((shrinking / by_heat - 1.0).abs() < 1e-6, "{gas_k} K: {shrinking} {by_heat}");
        }
    }

    #[test]
    fn limits_are_those_of_the_theory() {
        let properties = heptane(4e5);
        let calm = Around { temperature_k: 523.0, vapour: 0.0, slip_m_s: 0.0 };
        // The d² law: the mass flow is proportional to the diameter.
        let [a, b] = [5e-6, 10e-6].map(|d| rates(&properties, d, 370.0, &calm).mass_kg_s);
        assert!((b / a - 2.0).abs() < 1e-12);
        // Wind helps both, saturated gas stops one.
        let windy = rates(&properties, 10e-6, 370.0, &Around { slip_m_s: 20.0, ..calm });
        assert!(windy.mass_kg_s > 1.2 * b);
        let moist = Around { vapour: surface(&properties, 370.0), ..calm };
        let still = rates(&properties, 10e-6, 370.0, &moist);
        assert!(still.mass_kg_s.abs() < 1e-18 && still.warming_k_s > 0.0);
        // At the boiling point heat goes into vapour only.
        let boiling = rates(&properties, 10e-6, properties.boiling_k, &calm);
        assert!(boiling.mass_kg_s.is_finite() && boiling.warming_k_s < 0.0);
        // The adiabatic state: a droplet at the wet-bulb temperature neither warms nor cools.
        let wet_k = wet_bulb_k(&properties, &calm);
        assert!(rates(&properties, 10e-6, wet_k, &calm).warming_k_s.abs() < 1.0);
    }
}
