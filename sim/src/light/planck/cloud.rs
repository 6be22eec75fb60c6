//! The apparent temperature of a droplet cloud: the paper's eqs 12 to 15.

use super::{d_ln_photon_radiance_dt, exponent};

/// A droplet cloud in black surroundings, seen in single scattering at one wavelength (eqs 12 to 15).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cloud {
    /// Wavelength in µm.
    pub wavelength_um: f64,
    /// Temperature of the object (the droplets) in K, above 0.
    pub object_k: f64,
    /// Temperature of the environment in K, above 0.
    pub environment_k: f64,
    /// σ_s / σ_a, not negative.
    pub scattering_over_absorption: f64,
}

impl Cloud {
    /// Apparent temperature in K, eq. 12: (σ_a j(T_O) + σ_s j(T_E)) / (σ_a + σ_s) inverted at the one wavelength.
    pub fn apparent_temperature_k(&self) -> f64 {
        let ratio = self.scattering_over_absorption;
        if ratio == 0.0 {
            return self.object_k;
        }
        // From the hotter of the two, whose j cannot underflow in the quotient.
        let (hot_k, cold_k, hot_share) = if self.object_k >= self.environment_k {
            (self.object_k, self.environment_k, 1.0 / (1.0 + ratio))
        } else {
            (self.environment_k, self.object_k, ratio / (1.0 + ratio))
        };
        let lower = self.ln_ratio(cold_k, hot_k).exp_m1() * (1.0 - hot_share);
        // j_A = j_hot (1 + lower); exp(x_A) − 1 = (exp(x_hot) − 1) / (1 + lower).
        let x_hot = exponent(self.wavelength_um, hot_k);
        let x = x_hot + (-lower / (1.0 + lower) * -(-x_hot).exp_m1()).ln_1p();
        hot_k * (x_hot / x)
    }

    /// Eq. 13: the mean of the temperatures, weighted with the cross-sections.
    pub fn weighted_temperature_k(&self) -> f64 {
        let ratio = self.scattering_over_absorption;
        (self.object_k + ratio * self.environment_k) / (1.0 + ratio)
    }

    /// Eq. 14: linear about the environment, for strong scattering. Infinite when j(T_O)/j(T_E) overflows.
    pub fn environment_expansion_k(&self) -> f64 {
        let step = self.ln_ratio(self.object_k, self.environment_k).exp_m1()
            / d_ln_photon_radiance_dt(self.wavelength_um, self.environment_k);
        self.environment_k + step / self.scattering_over_absorption
    }

    /// Eq. 15: linear about the object, for weak scattering. Infinite when j(T_E)/j(T_O) overflows.
    pub fn object_expansion_k(&self) -> f64 {
        let step = self.ln_ratio(self.environment_k, self.object_k).exp_m1()
            / d_ln_photon_radiance_dt(self.wavelength_um, self.object_k);
        self.object_k + step * self.scattering_over_absorption
    }

    /// ln j(a) − ln j(b) without cancellation.
    fn ln_ratio(&self, a_k: f64, b_k: f64) -> f64 {
        let (x_a, x_b) = (exponent(self.wavelength_um, a_k), exponent(self.wavelength_um, b_k));
        let difference = x_b * ((a_k - b_k) / a_k);
        if difference.abs() < 1.0 {
            difference + (-(-difference).exp_m1() / x_a.exp_m1()).ln_1p()
        } else {
            difference + (-(-x_b).exp_m1()).ln() - (-(-x_a).exp_m1()).ln()
        }
    }
}
