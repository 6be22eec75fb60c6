//! From sums of counts to emissivity and temperature. Pure: no files, no clock, no instruments.
//!
//! In reading order: exact sums per pixel and level, the camera's curve, the line of one pixel, the weights of our
//! own estimator, quantiles of Student's t, the map, and the gate that finds shots without a spray.

pub mod accept;
pub mod accumulate;
pub mod calibration;
pub mod convergence;
pub mod gate;
pub mod law;
pub mod line;
pub mod map;
pub mod predict;
pub mod student;
pub mod walls;
