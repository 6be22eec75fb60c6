//! What a campaign can ask of its instruments, and the values that cross.
//!
//! Each trait is met by drivers of real models and, for the camera, by the simulated one. `prepare`, `set`
//! and `program` return what the instrument really took; deadlines are inside the driver except for frames,
//! whose deadline only the plan knows. Nothing here interprets a number.

use crate::error::DriverError;
use crate::quantity::{Kelvin, KelvinDelta};
use async_trait::async_trait;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Who an instrument says it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Maker, as the instrument spells it.
    pub maker: String,
    /// Model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
}

impl Identity {
    /// From an answer to `*IDN?`: maker, model, serial number and version, parted by commas.
    pub fn of_fields(answer: &str) -> Option<Self> {
        let fields: Vec<_> = answer.split(',').map(|field| field.trim().to_owned()).collect();
        let [maker, model, serial, firmware] = <[String; 4]>::try_from(fields).ok()?;
        Some(Self { maker, model, serial, firmware })
    }
}

/// What a calibrator is told before the first set-point.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratorSettings {
    /// Emissivity setting of the display (0.90 … 1.00 on a Fluke 418x); not the plate's emissivity in the band.
    pub display_emissivity: f64,
    /// Highest set-point that the driver lets through; the instrument's own limit applies besides.
    pub limit: Kelvin,
    /// Scan rate in K per minute.
    pub rate_k_per_min: f64,
    /// The instrument's own stability limit.
    pub stability: KelvinDelta,
}

/// One reading of a calibrator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlateReading {
    /// Apparent (display) temperature.
    pub apparent: Kelvin,
    /// Temperature of the block's own sensor.
    pub block: Kelvin,
    /// Set-point that the instrument holds.
    pub set_point: Kelvin,
    /// The instrument's own stable-at-set-point bit.
    pub stable: bool,
    /// A cutout has tripped: it neither heats nor cools.
    pub tripped: bool,
}

/// A black-body plate with a controller.
#[async_trait]
pub trait Calibrator: Send {
    /// Asks who it is; the first exchange after opening.
    async fn identify(&mut self) -> Result<Identity, DriverError>;
    /// Forces units, formats and limits, and checks cutouts. Does not heat.
    async fn prepare(&mut self, settings: &CalibratorSettings) -> Result<(), DriverError>;
    /// Sets and confirms a set-point and switches the output on; returns what the instrument took.
    async fn set_point(&mut self, target: Kelvin) -> Result<Kelvin, DriverError>;
    /// A fresh reading.
    async fn read(&mut self) -> Result<PlateReading, DriverError>;
    /// Set-point to its minimum, output left on until below 100 °C, then off. Idempotent; returns at once
    /// after commanding it, with the reading on which it decided.
    async fn make_safe(&mut self) -> Result<PlateReading, DriverError>;
    /// What a reader of the record should know of it besides its readings, once it is prepared: settings that it holds
    /// and calibration constants. Nothing where the line tells nothing.
    async fn particulars(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        Ok(Vec::new())
    }
    /// The last digit of its display: a reading that stands still by less than this says nothing.
    fn digit(&self) -> KelvinDelta {
        KelvinDelta(0.001)
    }
}

/// What one exposure is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShotKind {
    /// Discarded: a cooled camera needs some frames after an idle pause.
    WarmUp,
    /// Without spray.
    Blank,
    /// With spray.
    Spray,
}

/// The pattern that a trigger unit repeats by itself: per cycle `warm_up` discarded frames, `blanks` frames
/// without spray, one frame with spray, then pulses without any exposure (the pause).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShotProgram {
    /// Period of the unit's clock T0, in nanoseconds; frames of one cycle are this far apart.
    pub period_ns: u64,
    /// Clock pulses before the first frame of the first cycle.
    pub wait_periods: u32,
    /// Discarded frames at the start of each cycle.
    pub warm_up: u32,
    /// Blank frames of each cycle.
    pub blanks: u32,
    /// Whether the injector fires: false when a calibration is taken (then the last frame is a blank too).
    pub inject: bool,
    /// Clock pulses of a whole cycle, exposures and pause.
    pub cycle_periods: u32,
    /// Cycles in this burst; the unit stops by itself after them.
    pub cycles: u32,
    /// Start of the camera's trigger pulse after T0, in nanoseconds.
    pub camera_delay_ns: u64,
    /// Width of the camera's trigger pulse, in nanoseconds.
    pub camera_width_ns: u64,
    /// Start of the injector's pulse after T0, in nanoseconds.
    pub injector_delay_ns: u64,
    /// Width of the injector's pulse, in nanoseconds.
    pub injector_width_ns: u64,
}

impl ShotProgram {
    /// Frames of one cycle, discarded ones included.
    pub fn frames_per_cycle(&self) -> u32 {
        self.warm_up + self.blanks + 1
    }

    /// What the frame at `position` (0-based within its cycle) is for; `None` beyond the cycle's frames.
    pub fn kind_at(&self, position: u32) -> Option<ShotKind> {
        if position < self.warm_up {
            Some(ShotKind::WarmUp)
        } else if position < self.warm_up + self.blanks
            || (position < self.frames_per_cycle() && !self.inject)
        {
            Some(ShotKind::Blank)
        } else if position < self.frames_per_cycle() {
            Some(ShotKind::Spray)
        } else {
            None
        }
    }

    /// Length of one cycle, in nanoseconds.
    pub fn cycle_ns(&self) -> u64 {
        self.period_ns * u64::from(self.cycle_periods)
    }

    /// Time of the T0 pulse of the frame at `position` of `cycle`, in nanoseconds after the first T0 pulse.
    pub fn frame_ns(&self, cycle: u32, position: u32) -> u64 {
        self.period_ns
            * (u64::from(self.wait_periods)
                + u64::from(cycle) * u64::from(self.cycle_periods)
                + u64::from(position))
    }

    /// Length of the whole burst, in nanoseconds.
    pub fn burst_ns(&self) -> u64 {
        self.period_ns * u64::from(self.wait_periods) + self.cycle_ns() * u64::from(self.cycles)
    }
}

/// When something that a unit was told has begun, by this computer's clock: between these two moments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Begun {
    /// Not before: the command had not been sent.
    pub earliest: Instant,
    /// Not after: the unit had said that it had begun.
    pub latest: Instant,
}

/// A pulse generator that fires injector and camera.
#[async_trait]
pub trait TriggerUnit: Send {
    /// Asks who it is; the first exchange after opening.
    async fn identify(&mut self) -> Result<Identity, DriverError>;
    /// Programs a burst, reads it back, and returns what the unit really took. Fires nothing.
    async fn program(&mut self, program: &ShotProgram) -> Result<ShotProgram, DriverError>;
    /// Starts the burst that was programmed and confirms that the unit runs; when its clock began. Begins nothing yet on a
    /// unit whose cycles are begun one by one.
    async fn start(&mut self) -> Result<Begun, DriverError>;
    /// Whether each cycle of a started burst has to be begun by [`TriggerUnit::begin_cycle`]: true for a unit that
    /// cannot make the pauses by itself. Such a unit fires nothing more when nobody begins a cycle.
    fn is_begun_by_cycle(&self) -> bool {
        false
    }
    /// Asks whether cycle `cycle` (counted from 0, in order) may begin at `due`, some seconds before; returns when it may:
    /// later than `due` when the chamber needs it. Waits for nothing but answers, so that a wish to stop is heard between
    /// this and [`TriggerUnit::begin_cycle`]. Does nothing on a unit that makes its cycles by itself.
    async fn ready_cycle(&mut self, _cycle: u32, due: Instant) -> Result<Instant, DriverError> {
        Ok(due)
    }
    /// Begins cycle `cycle` at `due`, or later when the chamber needs it or `due` is past, after
    /// [`TriggerUnit::ready_cycle`] if that was not asked for it yet; when the cycle's first T0 pulse came. Does nothing on
    /// a unit that makes its cycles by itself.
    async fn begin_cycle(&mut self, _cycle: u32, due: Instant) -> Result<Begun, DriverError> {
        Ok(Begun { earliest: due, latest: due })
    }
    /// Whether pulses are still being made.
    async fn running(&mut self) -> Result<bool, DriverError>;
    /// Stops the clock; outputs go to rest. The injector's channel is switched off first.
    async fn stop(&mut self) -> Result<(), DriverError>;
    /// Injector channel off, then clock off, both confirmed. Idempotent.
    async fn make_safe(&mut self) -> Result<(), DriverError>;
}

/// What a camera is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub columns: usize,
    /// Integration time in seconds.
    pub integration_s: f64,
    /// Bits of a sample: counts run from 0 to 2^bits − 1.
    pub bits: u32,
}

/// One picture as it left the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The camera's own frame number; consecutive unless a frame was lost.
    pub id: u64,
    /// Start of the exposure by the camera's clock, in nanoseconds; the zero is the camera's own.
    pub device_ns: u64,
    /// Rows, row 0 at the top.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Raw counts, `[row, column]`.
    pub counts: Arc<[u16]>,
    /// False when the camera or the transport says that part of the picture is missing.
    pub complete: bool,
}

/// What a camera's clock showed at a moment of this computer's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraClock {
    /// The clock that stamps the frames, in nanoseconds.
    pub device_ns: u64,
    /// Not before: the camera had not been asked.
    pub earliest: Instant,
    /// Not after: it had answered.
    pub latest: Instant,
}

/// An infrared camera that exposes on a trigger.
#[async_trait]
pub trait Camera: Send {
    /// Asks who it is.
    async fn identify(&mut self) -> Result<Identity, DriverError>;
    /// Sets region, integration time and trigger mode; returns what was taken.
    async fn prepare(&mut self, settings: &CameraSettings) -> Result<CameraSettings, DriverError>;
    /// Closes or opens the internal shutter (a reference of known temperature). Returns the shutter's
    /// temperature when closed; an error when the camera has none.
    async fn shutter(&mut self, closed: bool) -> Result<Option<Kelvin>, DriverError>;
    /// Takes a new offset at its own shutter, if it is told to do so before every level; called only between levels.
    async fn correct_offset(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
    /// Begins to wait for triggers.
    async fn start(&mut self) -> Result<(), DriverError>;
    /// The next frame; [`DriverError::Silent`] when none has come within `deadline`.
    async fn frame(&mut self, deadline: Duration) -> Result<Frame, DriverError>;
    /// Stops; frames not fetched are dropped.
    async fn stop(&mut self) -> Result<(), DriverError>;
    /// Asks whether it is still there and obeys: what a silence means. [`DriverError::Lost`] when it is gone; then
    /// [`Camera::prepare`] looks for it again for as long as its driver is told.
    async fn check(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
    /// What the clock that stamps its frames shows now; `None` where the camera cannot tell.
    async fn clock(&mut self) -> Result<Option<CameraClock>, DriverError> {
        Ok(None)
    }
    /// What the transport counted between the last start and stop: packets, resends, losses.
    fn counters(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }
    /// Stops, whatever state it is in. Idempotent.
    async fn make_safe(&mut self) -> Result<(), DriverError>;
}

/// One process value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MonitorReading {
    /// Name with unit, for instance `wall_temperature_k` or `chamber_pressure_pa`.
    pub name: String,
    /// Value in the unit of the name.
    pub value: f64,
}

/// A source of process values: wall, gas, fuel and window temperatures, chamber and rail pressure.
#[async_trait]
pub trait Monitor: Send {
    /// All its values, fresh.
    async fn read(&mut self) -> Result<Vec<MonitorReading>, DriverError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program() -> ShotProgram {
        ShotProgram {
            period_ns: 20_000_000,
            wait_periods: 3,
            warm_up: 2,
            blanks: 4,
            inject: true,
            cycle_periods: 750,
            cycles: 10,
            camera_delay_ns: 0,
            camera_width_ns: 25_000,
            injector_delay_ns: 0,
            injector_width_ns: 1_000_000,
        }
    }

    #[test]
    fn a_cycle_is_warm_up_then_blanks_then_one_spray() {
        let p = program();
        let kinds: Vec<_> = (0..8).map(|i| p.kind_at(i)).collect();
        use ShotKind::{Blank, Spray, WarmUp};
        assert_eq!(
            kinds,
            [
                Some(WarmUp),
                Some(WarmUp),
                Some(Blank),
                Some(Blank),
                Some(Blank),
                Some(Blank),
                Some(Spray),
                None
            ]
        );
        assert_eq!(p.frame_ns(1, 0), 20_000_000 * 753);
        assert_eq!(p.burst_ns(), 20_000_000 * 7503);
    }

    #[test]
    fn without_injection_the_last_frame_is_a_blank() {
        let p = ShotProgram { inject: false, ..program() };
        assert_eq!(p.kind_at(6), Some(ShotKind::Blank));
        assert_eq!(p.kind_at(7), None);
    }
}
