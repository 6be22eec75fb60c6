//! Physical quantities at the seams: the only place where °C and kelvin meet.
//!
//! Kernels use plain `f64` in SI units; these types guard what crosses from one room to another. They do no
//! checking of ranges: limits belong to plans, orchestrators and drivers.

use serde::{Deserialize, Serialize};
use std::ops::{Add, Sub};

/// 0 °C in kelvin (exact by the definition of the Celsius scale).
const ZERO_CELSIUS_K: f64 = 273.15;

/// A thermodynamic temperature in kelvin.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Kelvin(pub f64);

/// A difference of two temperatures in kelvin.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct KelvinDelta(pub f64);

/// A length or wavelength in micrometres.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Micrometre(pub f64);

impl Kelvin {
    /// From degrees Celsius.
    pub fn from_celsius(celsius: f64) -> Self {
        Self(celsius + ZERO_CELSIUS_K)
    }

    /// In degrees Celsius.
    pub fn celsius(self) -> f64 {
        self.0 - ZERO_CELSIUS_K
    }
}

impl Sub for Kelvin {
    type Output = KelvinDelta;
    fn sub(self, other: Self) -> KelvinDelta {
        KelvinDelta(self.0 - other.0)
    }
}

impl Add<KelvinDelta> for Kelvin {
    type Output = Self;
    fn add(self, delta: KelvinDelta) -> Self {
        Self(self.0 + delta.0)
    }
}

impl Sub<KelvinDelta> for Kelvin {
    type Output = Self;
    fn sub(self, delta: KelvinDelta) -> Self {
        Self(self.0 - delta.0)
    }
}

impl KelvinDelta {
    /// The magnitude.
    #[must_use]
    pub fn abs(self) -> Self {
        Self(self.0.abs())
    }
}

impl std::fmt::Display for Kelvin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match f.precision() {
            Some(digits) => write!(f, "{:.*} K", digits, self.0),
            None => write!(f, "{} K", self.0),
        }
    }
}

impl Micrometre {
    /// In metres.
    pub fn metres(self) -> f64 {
        self.0 * 1e-6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn celsius_and_kelvin_differ_by_exactly_273_15() {
        assert!((Kelvin::from_celsius(100.0).0 - 373.15).abs() < 1e-12);
        assert!((Kelvin(373.15).celsius() - 100.0).abs() < 1e-12);
    }

    #[test]
    fn differences_are_not_temperatures() {
        let delta = Kelvin(373.0) - Kelvin(403.0);
        assert!((delta.abs().0 - 30.0).abs() < 1e-12);
        assert!(((Kelvin(403.0) + delta).0 - 373.0).abs() < 1e-12);
    }
}
