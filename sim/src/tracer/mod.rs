//! Backward ray tracing: from a medium and a camera to the transport operator.

pub mod camera;
pub mod cell;
pub mod chamber;
pub mod error;
pub mod image;
pub mod lens;
pub mod line;
pub mod mean_rays;
pub mod medium;
pub mod operator;
pub mod plate;
pub mod rays;
pub mod reference;
pub mod relight;
pub mod shape;
pub mod uneven;

mod blocks;
mod bricks;
mod cache;
mod chord;
mod cuts;
mod ends;
mod fine;
mod gather;
mod guess;
mod lattice;
mod path;
mod paths;
mod pixels;
mod reconstruct;
mod scatter;
mod sobol;
mod spectrum;
mod spread;
mod vector;
mod visibility;
