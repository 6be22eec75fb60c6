//! How the instruments of a DIT rig talk.
//!
//! Wires, codecs and drivers, and the traits that a campaign commands. Knows no physics: what a plate or a
//! detector does lies in `ditd-sim`, what the numbers mean in `ditd`.

pub mod dg645;
pub mod error;
pub mod fluke_418x;
pub mod gige;
pub mod hart_9132;
pub mod instrument;
pub mod ir_301;
mod keyword;
pub mod modbus;
pub mod monitors;
pub mod ports;
pub mod quantity;
pub mod quantum_9520;
pub mod restored;
mod set_point;
mod steadiness;
pub mod trigger_limits;
pub mod wire;

use instrument::{Calibrator, TriggerUnit};
use quantity::Kelvin;
use trigger_limits::{TriggerLimits, UnitRange};
use wire::{Wire, WireSettings};

/// A model of calibrator that a configuration can name.
#[derive(Debug)]
pub struct CalibratorModel {
    /// The name: that of the driver's file.
    pub name: &'static str,
    /// What it is, for lists.
    pub words: &'static str,
    /// The line settings at delivery.
    pub wire_settings: fn() -> WireSettings,
    /// Makes the driver over an open wire. Sends nothing.
    pub drive: fn(Wire) -> Box<dyn Calibrator>,
    /// The highest set-point that any such instrument takes at an emissivity setting of its display, where that is known
    /// before it is asked.
    pub set_point_max: Option<fn(f64) -> Kelvin>,
    /// Whether it can be told scan rate, stability limit and the display's emissivity.
    pub is_adjustable: bool,
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
pub const CALIBRATORS: &[CalibratorModel] = &[
    CalibratorModel {
        name: "fluke_418x",
        words: "Fluke 4180 and 4181",
        wire_settings: fluke_418x::wire_settings,
        drive: |wire| restored(wire, fluke_418x::Fluke418x::new),
        set_point_max: Some(fluke_418x::set_point_max),
        is_adjustable: true,
    },
    CalibratorModel {
        name: "hart_9132",
        words: "Hart Scientific 9132 and its family",
        wire_settings: hart_9132::wire_settings,
        drive: |wire| restored(wire, hart_9132::Hart9132::new),
        set_point_max: None,
        is_adjustable: false,
    },
    CalibratorModel {
        name: "ir_301",
        words: "Infrared Systems Development IR-301 (Modbus RTU)",
        wire_settings: ir_301::wire_settings,
        drive: |wire| restored(wire, ir_301::Ir301::new),
        set_point_max: None,
        is_adjustable: false,
    },
];

/// Wraps a driver so that it survives the loss of its line.
fn restored<C: Calibrator + 'static>(wire: Wire, drive: fn(Wire) -> C) -> Box<dyn Calibrator> {
    let name = wire.name().to_owned();
    Box::new(restored::Restored::new(drive(wire), name))
}

/// The calibrator of a name.
pub fn calibrator(name: &str) -> Option<&'static CalibratorModel> {
    CALIBRATORS.iter().find(|model| model.name == name)
}

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
