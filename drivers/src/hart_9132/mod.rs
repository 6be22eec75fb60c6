//! Hart Scientific (Fluke) 9132 infrared calibrator and the classic Hart family: codec in both directions, and the driver.
//!
//! Manual: Hart/Fluke 9132 User Manual, section 8: RS-232 8N1, commands end with CR, any case, abbreviated to the
//! shortest unique form, a value after `=`; `s` set-point, `t` temperature, `u` units, scan mode and scan rate. How
//! replies look, the names of scan and cutout commands, echo and unasked readings differ between models of the family and
//! were not seen by us: replies are read in every form that means something, and none of those commands is relied on. The
//! unit has no block sensor, no output switch and no stable bit on its line.

mod codec;
mod driver;

pub use codec::{Command, Header, Scale, Told, decode_told, decode_unit, encode_told};
pub use driver::Hart9132;

use crate::wire::WireSettings;

/// Bit rate at delivery, as the family is commonly found; the unit shows its own in the communication menu.
const BAUD: u32 = 2400;

/// The line settings at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}
