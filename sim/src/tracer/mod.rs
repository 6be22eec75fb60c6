//! Backward ray tracing: from a medium and a camera to the transport operator.

pub mod medium;
pub mod operator;
