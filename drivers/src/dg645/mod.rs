//! Stanford Research DG645 delay generator: codec in both directions, and the driver over a wire.
//!
//! Sources: the maker's data sheet (ranges, resolution, rates); `srsinst.dg645`, the maker's own Python driver and its
//! tests, which run against the instrument (commands, ranges, defaults, error codes 10, 12, 13, 16, 17, registers); the
//! QCoDeS driver, which quotes the maker's manual on prescaling ("the output is enabled when the prescaler counter
//! equals the phase factor"). What no source says, and what follows from it:
//!
//! - Whether the prescalers count the delay cycles inside a burst, and from where, is not written there. The scheme of
//!   [`settings`] needs it, so a campaign file for a real unit must say that it was looked at with an oscilloscope
//!   (`trigger.prescaler_checked`, `docs/INSTRUMENTS.md`). Factor 1 leaves a counter no state but zero, so every
//!   program passes through it.
//! - Whether a change of settings breaks a running burst is not written either: a stop lowers the injector's
//!   amplitude to where no input takes it for a pulse, and then waits until the status byte says that the burst is over.
//!
//! The unit has no counter of cycles beyond one burst, and left to its own rate it would inject for ever if the program
//! died. So each cycle is one burst that the driver begins: without it nothing more is fired.

pub mod command;
pub mod driver;
mod settings;
pub mod table;
#[cfg(test)]
mod tests;
pub mod value;

pub use command::{Act, Command, Fault};
pub use driver::{Dg645, wire_settings};
pub use table::{Key, Kind, kind};
pub use value::Value;

use crate::trigger_limits::{Counts, UnitRange};

/// Output AB fires the injector.
pub const INJECTOR_OUTPUT: u32 = 1;

/// Output CD triggers the camera.
pub const CAMERA_OUTPUT: u32 = 2;

/// TCP port of the raw socket (`srsinst.dg645`).
pub const TCP_PORT: u16 = 5025;

/// What it can time and count: burst period by the data sheet (the maker's driver would allow 2000 s); a delay cycle
/// takes 100 ns more than its longest delay (data sheet, maximum rate). The highest burst count is not in the sources; the
/// longest series of a campaign stays far below this, and what the unit does not take shows when it is read back.
pub const RANGE: UnitRange = UnitRange {
    period_min_ns: 100,
    period_max_ns: 42_900_000_000,
    width_min_ns: 10,
    recovery_ns: 100,
    pulses_max: 100_000,
    counts: Counts::FramesOfCycle,
};

/// Bits of `INSR?`; reading clears them.
pub mod instrument_status {
    /// Got a trigger.
    pub const TRIGGER: u64 = 1;
    /// Got a trigger while a delay or a burst was in progress.
    pub const RATE: u64 = 2;
    /// A delay cycle is over.
    pub const END_OF_DELAY: u64 = 4;
    /// A burst is over.
    pub const END_OF_BURST: u64 = 8;
    /// A trigger or an output was inhibited.
    pub const INHIBITED: u64 = 16;
    /// A delay cycle was aborted.
    pub const ABORTED: u64 = 32;
    /// The 100 MHz loop came unlocked.
    pub const PLL_UNLOCKED: u64 = 64;
}

/// Bits of `*STB?`.
pub mod status_byte {
    /// A delay cycle is in progress.
    pub const BUSY: u64 = 2;
    /// A burst is in progress.
    pub const BURST: u64 = 4;
}

/// Bits of `*ESR?`; reading clears them.
pub mod event_status {
    /// Execution error.
    pub const EXECUTION: u64 = 16;
    /// Command error.
    pub const COMMAND: u64 = 32;
    /// It was switched on.
    pub const POWER_ON: u64 = 128;
}
