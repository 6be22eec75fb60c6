//! The instrument's side of a Quantum Composers 9520 / BNC 575 pulse generator: its answers and its running clock.
//!
//! Same codec as the driver, same manual (Operator's Manual v5.9, chapter 7; "System and Channel Modes"). Rooms: `clock`
//! which pulses come when; `unit` memory, answers and modes.

mod clock;
mod memory;
#[cfg(test)]
mod tests;
mod unit;

pub(super) use unit::PulseGenerator;

/// Channels of the largest model: A to H.
const CHANNELS: u32 = 8;

/// Stretches of pulses that may wait to be sent; each command during a run begins one. Beyond, commands are refused
/// as unavailable: it takes a consumer that has stood still through so many commands.
const STRETCHES_MAX: usize = 64;

const PS_PER_NS: i64 = 1000;
