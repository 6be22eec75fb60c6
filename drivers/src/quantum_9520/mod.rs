//! Quantum Composers 9520 and BNC 575 pulse generators: codec in both directions, and the driver over a wire.
//!
//! Manual: Quantum Composers 9520 Operator's Manual v5.9, chapter 7 and appendix A (commands, error numbers, start-up
//! warning), and the note "System and Channel Modes"; BNC 575 Operating Manual, chapter 8, has the same text. Output
//! levels, polarities and the multiplexer belong to the wiring of the rig and are left as they were set at the
//! front panel. The unit's trigger counter is in the codec, but the driver does not ask it: it counts external
//! triggers, and whether it counts the clock's own pulses the manual does not say. Gives no shot a label: it makes
//! pulses.
//!
//! Rooms: [`table`] the commands; [`value`] numbers and words; [`command`] lines and answers; `settings` the interleaving;
//! [`driver`] the unit at the end of a wire.

pub mod command;
pub mod driver;
mod settings;
pub mod table;
#[cfg(test)]
mod tests;
pub mod value;

pub use command::{Act, Command, Reply, UnitError};
pub use driver::{Quantum9520, wire_settings};
pub use table::{Key, Kind, belongs_to, kind, needs_channel};
pub use value::Value;

use crate::trigger_limits::{Counts, UnitRange};

/// Channel that triggers the camera: A.
pub const CAMERA_CHANNEL: u32 = 1;

/// Channel that fires the injector: B.
pub const INJECTOR_CHANNEL: u32 = 2;

/// Highest count of any counter (command table).
const COUNT_MAX: u64 = 9_999_999;

/// What it can time and count (specifications and command table).
pub const RANGE: UnitRange = UnitRange {
    period_min_ns: 50,
    period_max_ns: 5_000_000_000_000,
    width_min_ns: 10,
    recovery_ns: 0,
    pulses_max: COUNT_MAX,
    counts: Counts::WholeBurst,
};

const PS_PER_NS: i64 = 1000;
const PS_PER_S: i64 = 1_000_000_000_000;
