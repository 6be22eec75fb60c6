//! The simulated rig: one physical world behind every instrument's own protocol.

pub mod fluke_418x;
pub mod plate;
pub mod quantum_9520;
