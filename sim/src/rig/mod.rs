//! The simulated rig: one physical world behind every instrument's own protocol.

pub mod config;
mod error;
pub mod plate;
pub mod fluke_418x;
pub mod quantum_9520;

pub use error::RigError;
