//! Backward ray tracing: from a medium and a camera to the transport operator.

pub mod camera;
pub mod cell;
pub mod error;
pub mod image;
pub mod line;
pub mod medium;
pub mod operator;
pub mod plate;
pub mod rays;
pub mod shape;

mod cache;
mod gather;
mod lanes;
mod lattice;
mod packed;
mod reconstruct;
mod sobol;
mod vector;
