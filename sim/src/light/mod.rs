//! The laws of light: pure functions of wavelength, temperature, size and index.

pub mod air;
pub mod band;
pub mod complex;
pub mod fuel;
pub mod mie;
pub mod names;
pub mod phase;
pub mod planck;
pub mod provenance;
pub mod quadrature;
pub mod table;
pub mod window;
