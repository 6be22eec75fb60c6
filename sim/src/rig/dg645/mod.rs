//! The instrument's side of a Stanford DG645: silent sets, an error queue, registers, bursts and prescalers.
//!
//! Same codec and sources as the driver. Where the sources are silent it behaves as is worst for a driver that relies on
//! something: a running burst goes on when the trigger source changes, is cut short when burst mode is switched off, and
//! leaves the prescalers where they stood; these count delay cycles, in bursts too, and are cut back only when a
//! factor is written.

mod burst;
#[cfg(test)]
mod tests;
mod unit;

pub(super) use unit::DelayGenerator;
