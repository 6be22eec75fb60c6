//! The simulated rig: one physical world behind every instrument's own protocol.

pub mod build;
#[cfg(test)]
mod calibrator_bench;
pub mod camera;
pub mod chamber;
pub mod config;
mod dg645;
pub mod detector;
mod error;
pub mod fluctuation;
pub mod fluke_418x;
pub mod gige;
pub mod hart_9132;
pub mod ir_301;
pub mod level;
pub mod line;
pub mod noise;
pub mod plate;
pub mod process;
pub mod pulse;
pub mod pulser;
#[cfg(test)]
mod pulser_bench;
mod quantum_9520;
pub mod radiometry;
#[cfg(test)]
mod sample;
pub mod sights;
pub mod truth;

pub use error::RigError;
