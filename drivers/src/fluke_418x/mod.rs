//! Fluke 4180 and 4181 infrared calibrators: codec in both directions, and the driver over a wire.
//!
//! Manual: Fluke/Hart Scientific "4180, 4181 Precision Infrared Calibrator", Users Guide (rev. 812301-EN, 2007) and
//! Technical Guide: command table (line settings, commands, password groups), specifications (ranges, set-point limit
//! against emissivity, cooling before power-off). Knows no physics: whether a plate is really settled is judged
//! elsewhere.

mod codec;
mod driver;

pub use codec::{
    Act, Command, CommandError, Header, Model, Value, Write, decode_celsius, decode_flag, decode_identity,
    decode_number, encode_identity, encode_number, write_access,
};
pub use driver::Fluke418x;

use crate::quantity::Kelvin;
use crate::wire::WireSettings;

/// Default bit rate (Users Guide, communications).
const BAUD: u32 = 9600;

/// The line settings at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// The highest set-point that either model takes at an emissivity setting of its display (Technical Guide, table of
/// set-point limits).
pub fn set_point_max(display_emissivity: f64) -> Kelvin {
    Kelvin::from_celsius(Model::Fluke4181.set_point_max_c(display_emissivity))
}
