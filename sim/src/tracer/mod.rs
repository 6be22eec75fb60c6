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
mod chord;
mod gather;
mod guess;
mod lanes;
mod lattice;
mod packed;
mod path;
mod reconstruct;
mod sobol;
mod vector;
