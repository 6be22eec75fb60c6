//! From a spray (CFD parcels and cells, or a shape) to coefficients that the tracer understands.

pub mod compact;
pub mod deposit;
pub mod enclosure;
pub mod field;
pub mod file;
pub mod import;
pub mod library;
pub mod exposure;
pub mod lights;
pub mod mirror;
pub mod optics;
pub mod spray;
