//! How light and instruments behave.
//!
//! `light` holds the laws of nature, `fluid` the properties of fuels and nitrogen, `scene` turns sprays into
//! coefficients, `tracer` sends rays backwards from the camera, `rig` is the simulated world behind the instruments'
//! protocols. Knows nothing of campaigns, plans, journals or fits.

pub mod fluid;
pub mod light;
pub mod rig;
pub mod scene;
pub mod tracer;
