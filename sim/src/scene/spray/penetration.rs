//! Published penetrations of a steady full-cone spray, as closed forms.
//!
//! The field does not use them: its jet follows from conservation (see `jet`). They are what that jet is compared
//! with, here and by whoever reads the notes of a render.

/// What the penetration of one hole's spray depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hole {
    /// Diameter in m.
    pub diameter_m: f64,
    /// Contraction of the area, 0 … 1.
    pub area_coefficient: f64,
    /// Exit velocity over that of Bernoulli, 0 … 1.
    pub velocity_coefficient: f64,
    /// Pressure drop in Pa.
    pub drop_pa: f64,
    /// Density of the liquid in kg/m³.
    pub liquid_kg_m3: f64,
    /// Density of the gas in kg/m³.
    pub gas_kg_m3: f64,
    /// Full angle of the plume in rad.
    pub plume_angle_rad: f64,
}

/// Tip of the spray along its axis in m, `time_s` after the start of injection.
///
/// Naber and Siebers 1996 (SAE 960034): S = x⁺ [t̃^−2.2 + t̃^−1.1]^(−1/2.2) with t̃ = t/t⁺,
/// x⁺ = √C_a d √(ρ_l/ρ_g) / (0.66 tan(θ/2)) and t⁺ = x⁺/U. Made for 3.6–124 kg/m³, 75–160 MPa and 0.1–0.5 mm; with
/// the plume angle of the spray at hand its scales follow from momentum alone.
pub fn naber_siebers_m(hole: &Hole, time_s: f64) -> f64 {
    let velocity = hole.velocity_coefficient * (2.0 * hole.drop_pa / hole.liquid_kg_m3).sqrt();
    let width = 0.66 * (0.5 * hole.plume_angle_rad).tan();
    let length_m =
        hole.area_coefficient.sqrt() * hole.diameter_m * (hole.liquid_kg_m3 / hole.gas_kg_m3).sqrt() / width;
    let time = time_s * velocity / length_m;
    if time <= 0.0 {
        return 0.0;
    }
    length_m * (time.powf(-2.2) + time.powf(-1.1)).powf(-1.0 / 2.2)
}

/// Tip of the spray along its axis in m, `time_s` after the start of injection.
///
/// Hiroyasu and Arai 1990 (SAE 900475): S = 0.39 √(2Δp/ρ_l) t up to t_b = 28.65 ρ_l d / √(ρ_g Δp), then
/// S = 2.95 (Δp/ρ_g)^0.25 √(d t). Made for diesel at 10–200 MPa and 1–3 MPa of gas; knows nothing of the plume angle.
pub fn hiroyasu_arai_m(hole: &Hole, time_s: f64) -> f64 {
    let breakup_s = 28.65 * hole.liquid_kg_m3 * hole.diameter_m / (hole.gas_kg_m3 * hole.drop_pa).sqrt();
    if time_s <= breakup_s {
        0.39 * (2.0 * hole.drop_pa / hole.liquid_kg_m3).sqrt() * time_s.max(0.0)
    } else {
        2.95 * (hole.drop_pa / hole.gas_kg_m3).powf(0.25) * (hole.diameter_m * time_s).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPRAY_G: Hole = Hole {
        diameter_m: 165e-6,
        area_coefficient: 0.56,
        velocity_coefficient: 0.9,
        drop_pa: 194e5,
        liquid_kg_m3: 632.0,
        gas_kg_m3: 3.5,
        plume_angle_rad: 0.349,
    };

    #[test]
    fn both_start_at_the_nozzle_and_grow_as_the_root_of_time() {
        for tip in [naber_siebers_m, hiroyasu_arai_m] {
            assert!(tip(&SPRAY_G, 0.0).abs() < 1e-12);
            let ratio = tip(&SPRAY_G, 40.0) / tip(&SPRAY_G, 10.0);
            assert!((ratio - 2.0).abs() < 0.01, "{ratio}");
        }
        // Early: the exit velocity times the time.
        let early = naber_siebers_m(&SPRAY_G, 1e-9) / 1e-9;
        assert!((early / (0.9 * (2.0f64 * 194e5 / 632.0).sqrt()) - 1.0).abs() < 0.01, "{early}");
        // Both branches of Hiroyasu and Arai meet at the break-up time.
        let breakup_s = 28.65 * 632.0 * 165e-6 / (3.5f64 * 194e5).sqrt();
        let [a, b] = [0.9999, 1.0001].map(|f| hiroyasu_arai_m(&SPRAY_G, f * breakup_s));
        assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
    }
}
