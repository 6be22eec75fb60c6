//! How the instruments of a DIT rig talk.
//!
//! Wires, codecs and drivers, and the traits that a campaign commands. Knows no physics: what a plate or a
//! detector does lies in `ditd-sim`, what the numbers mean in `ditd`.

pub mod dg645;
pub mod error;
pub mod fluke_418x;
pub mod gige;
pub mod instrument;
mod keyword;
pub mod ports;
pub mod quantity;
pub mod quantum_9520;
pub mod trigger_limits;
pub mod wire;

use instrument::{Calibrator, TriggerUnit};
use trigger_limits::{TriggerLimits, UnitRange};
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
    /// What it can time and count.
    pub range: UnitRange,
    /// Makes the driver over an open wire, with the limits of the rig. Sends nothing.
    pub drive: fn(Wire, TriggerLimits) -> Box<dyn TriggerUnit>,
}

/// All calibrators.
pub const CALIBRATORS: &[CalibratorModel] = &[CalibratorModel {
    name: "fluke_418x",
    wire_settings: fluke_418x::wire_settings,
    drive: |wire| Box::new(fluke_418x::Fluke418x::new(wire)),
}];

/// All trigger units.
pub const TRIGGER_UNITS: &[TriggerModel] = &[
    TriggerModel {
        name: "quantum_9520",
        wire_settings: quantum_9520::wire_settings,
        range: quantum_9520::RANGE,
        drive: |wire, limits| Box::new(quantum_9520::Quantum9520::new(wire, limits)),
    },
    TriggerModel {
        name: "dg645",
        wire_settings: dg645::wire_settings,
        range: dg645::RANGE,
        drive: |wire, limits| Box::new(dg645::Dg645::new(wire, limits)),
    },
];
