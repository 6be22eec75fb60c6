//! What a parametric spray is, in numbers and in words.

/// A spray in numbers, SI units.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Fuel injected so far, kg.
    pub injected_kg: f64,
    /// Liquid on the grid, kg.
    pub liquid_kg: f64,
    /// Vapour on the grid, kg.
    pub vapour_kg: f64,
    /// Mass flow of the injector while it is open, kg/s.
    pub flow_kg_s: f64,
    /// Exit velocity, m/s.
    pub velocity_m_s: f64,
    /// Full angle by which plumes or sheet open, degrees.
    pub plume_angle_deg: f64,
    /// Sauter mean diameter at the nozzle, m.
    pub sauter_start_m: f64,
    /// Sauter mean diameter of all droplets now, m; NaN without droplets.
    pub sauter_now_m: f64,
    /// Temperature of the liquid, weighted with its mass, K; NaN without droplets.
    pub liquid_k: f64,
    /// Temperature of the gas, weighted with the vapour, K; NaN without vapour.
    pub vapour_k: f64,
    /// Along plume or sheet, where 99 % of the liquid and of all fuel are, m.
    pub tips_m: [f64; 2],
    /// The same along the injector's axis, m.
    pub axial_tips_m: [f64; 2],
    /// Tip along a plume by Naber and Siebers, and by Hiroyasu and Arai, m; none of a sheet.
    pub published_tips_m: Option<[f64; 2]>,
    /// Edge of a cell, m.
    pub cell_m: f64,
}

impl Summary {
    /// For the user to see.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![
            format!(
                "spray: {:.3} mg injected at {:.1} g/s and {:.0} m/s, {:.1} % evaporated; Sauter mean {:.1} um at the \
                 nozzle, {:.1} um now; liquid {:.0} K, gas with vapour {:.0} K",
                1e6 * self.injected_kg,
                1e3 * self.flow_kg_s,
                self.velocity_m_s,
                100.0 * self.vapour_kg / (self.liquid_kg + self.vapour_kg),
                1e6 * self.sauter_start_m,
                1e6 * self.sauter_now_m,
                self.liquid_k,
                self.vapour_k
            ),
            format!(
                "spray: tips {:.1} mm (liquid) and {:.1} mm (vapour) from the nozzle, {:.1} and {:.1} mm along the axis; \
                 opening {:.1} degrees; cells of {:.2} mm",
                1e3 * self.tips_m[0],
                1e3 * self.tips_m[1],
                1e3 * self.axial_tips_m[0],
                1e3 * self.axial_tips_m[1],
                self.plume_angle_deg,
                1e3 * self.cell_m
            ),
        ];
        if let Some([naber_siebers, hiroyasu_arai]) = self.published_tips_m {
            notes.push(format!(
                "spray: published tips of a steady plume: {:.1} mm (Naber and Siebers), {:.1} mm (Hiroyasu and Arai)",
                1e3 * naber_siebers,
                1e3 * hiroyasu_arai
            ));
        }
        notes
    }
}
