//! Thermophysical properties of fuels and of nitrogen: what evaporates, flows and conducts.
//!
//! A room of its own beside `light`: light needs only the density of a liquid. Correlations, no measurements; each has
//! a range outside which it is refused. Knows neither wavelengths nor sprays.

pub mod correlation;
pub mod fuel;
pub mod nitrogen;

/// Molar gas constant in J/(mol K), exact since 2019.
pub const GAS_CONSTANT_J_MOL_K: f64 = 8.314_462_618_153_24;

/// Why there is no value.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FluidError {
    /// The temperature is outside the correlation's range.
    #[error("{what} at {temperature_k} K: known from {} to {} K only", range_k[0], range_k[1])]
    Temperature {
        /// The property.
        what: &'static str,
        /// The temperature asked for, in K.
        temperature_k: f64,
        /// The range in K.
        range_k: [f64; 2],
    },
    /// The pressure is outside the range.
    #[error("{what} at {pressure_pa} Pa: known from {} to {} Pa only", range_pa[0], range_pa[1])]
    Pressure {
        /// The property.
        what: &'static str,
        /// The pressure asked for, in Pa.
        pressure_pa: f64,
        /// The range in Pa.
        range_pa: [f64; 2],
    },
}

fn within(what: &'static str, temperature_k: f64, range_k: [f64; 2]) -> Result<f64, FluidError> {
    if (range_k[0]..=range_k[1]).contains(&temperature_k) {
        Ok(temperature_k)
    } else {
        Err(FluidError::Temperature { what, temperature_k, range_k })
    }
}
