//! From sums of counts to emissivity and temperature. Pure: no files, no clock, no instruments.
//!
//! In reading order: exact sums per pixel and level, the camera's curve, the line of one pixel, the weights of our
//! own estimator, quantiles of Student's t, the map, the gate that finds shots without a spray; columns of what absorbs and
//! their inverse Abel transform.

pub mod abel;
pub mod accept;
pub mod accumulate;
pub mod budget;
pub mod calibration;
pub mod column;
pub mod convergence;
pub mod gate;
pub mod law;
pub mod line;
pub mod map;
pub mod mask;
pub mod pixel;
pub mod predict;
pub mod student;
pub mod walls;
