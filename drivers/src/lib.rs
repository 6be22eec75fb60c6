//! How the instruments of a DIT rig talk.
//!
//! Wires, codecs and drivers, and the traits that a campaign commands. Knows no physics: what a plate or a
//! detector does lies in `ditd-sim`, what the numbers mean in `ditd`.

pub mod error;
pub mod fluke_418x;
pub mod instrument;
mod keyword;
pub mod modbus;
pub mod quantity;
pub mod quantum_9520;
pub mod wire;

use instrument::{Calibrator, TriggerUnit};
use wire::{Wire, WireSettings};

/// A model of calibrator that a configuration can name.
pub struct CalibratorModel {
    /// The name: that of the driver's file.
    pub name: &'static str,
    /// The line settings at delivery.
    pub wire_settings: fn() -> WireSettings,
    /// Makes the driver over an open wire. Sends nothing.
    pub drive: fn(Wire) -> Box<dyn Calibrator>,
}

/// A model of trigger unit that a configuration can name.
pub struct TriggerModel {
    /// The name: that of the driver's file.
    pub name: &'static str,
    /// The line settings at delivery.
    pub wire_settings: fn() -> WireSettings,
    /// Makes the driver over an open wire, with the limits of the rig. Sends nothing.
    pub drive: fn(Wire, quantum_9520::TriggerLimits) -> Box<dyn TriggerUnit>,
}

/// All calibrators.
pub const CALIBRATORS: &[CalibratorModel] = &[CalibratorModel {
    name: "fluke_418x",
    wire_settings: fluke_418x::wire_settings,
    drive: |wire| Box::new(fluke_418x::Fluke418x::new(wire)),
}];

/// All trigger units.
pub const TRIGGER_UNITS: &[TriggerModel] = &[TriggerModel {
    name: "quantum_9520",
    wire_settings: quantum_9520::wire_settings,
    drive: |wire, limits| Box::new(quantum_9520::Quantum9520::new(wire, limits)),
}];
