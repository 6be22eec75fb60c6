//! Plate and monitors during a campaign: read together, written into the telemetry, held against their limits.
//!
//! Has its own parts of the engine, so that it can go on while something else is waited for.

use super::{CampaignError, Engine, Exceeded, Interrupt, Monitors, Progress, Recorder, Step};
use crate::config::Config;
use crate::journal::Record;
use ditd_drivers::instrument::{Calibrator, Camera, MonitorReading, PlateReading};
use std::time::Duration;
use tokio::time::Instant;

/// Above `plate.limit_k` by more than this a reading stops the campaign: the 4181's overshoot is a few kelvin.
const OVERSHOOT_ALLOWED_K: f64 = 10.0;

/// What is needed to watch over the plate.
pub(super) struct Watch<'a> {
    config: &'a Config,
    plate: &'a mut dyn Calibrator,
    monitors: &'a mut Monitors,
    recorder: &'a mut Recorder,
    progress: &'a mut dyn Progress,
    started: Instant,
    elapsed_before_ns: u64,
}

impl Engine<'_> {
    /// The camera, and all that watches over the plate meanwhile.
    pub(super) fn camera_and_watch(&mut self) -> (&mut dyn Camera, Watch<'_>) {
        let instruments = &mut *self.instruments;
        let watch = Watch {
            config: self.config,
            plate: &mut *instruments.plate,
            monitors: &mut instruments.monitors,
            recorder: self.recorder,
            progress: self.progress,
            started: self.started,
            elapsed_before_ns: self.elapsed_before_ns,
        };
        (&mut *instruments.camera, watch)
    }

    /// Reads the plate and the monitors, writes both into the telemetry, and holds them against their limits.
    pub(super) async fn read_plate(&mut self, level: u32) -> Step<(PlateReading, Vec<MonitorReading>)> {
        self.camera_and_watch().1.read(level).await
    }

    /// Keeps process values in the record; a rig without monitors has none.
    pub(super) fn note_values(
        &mut self,
        level: u32,
        cycle: Option<u32>,
        values: Vec<MonitorReading>,
    ) -> Step<()> {
        self.camera_and_watch().1.note_values(level, cycle, values)
    }
}

impl Watch<'_> {
    /// How often the plate is read while something is waited for.
    pub(super) fn every(&self) -> Duration {
        Duration::from_secs_f64(self.config.soak.poll_s)
    }

    /// Tells the operator what is waited for.
    pub(super) fn waiting(&mut self, reason: &str) {
        self.progress.waiting(reason, None);
    }

    /// See [`Engine::read_plate`].
    pub(super) async fn read(&mut self, level: u32) -> Step<(PlateReading, Vec<MonitorReading>)> {
        let reading = self.plate.read().await?;
        let round = self.monitors.read().await?;
        for note in &round.notes {
            self.progress.note(note);
        }
        let t_ns = self.now_ns();
        self.recorder.reading(t_ns, level, &reading, &round.values)?;
        if let Some(Exceeded { name, value, side, limit }) = round.exceeded {
            self.note_values(level, None, round.values)?;
            return Err(Interrupt::Error(CampaignError::OutOfLimits { name, value, side, limit }));
        }
        if reading.tripped {
            return Err(Interrupt::Error(CampaignError::Tripped { apparent_k: reading.apparent.0 }));
        }
        // Overshoot of some kelvin is what controllers do; a plate that runs away is not.
        let limit_k = self.config.plate.limit_k + OVERSHOOT_ALLOWED_K;
        if reading.apparent.0 > limit_k || reading.block.0 > limit_k {
            return Err(Interrupt::Error(CampaignError::TooHot {
                reading_k: reading.apparent.0.max(reading.block.0),
                limit_k,
            }));
        }
        Ok((reading, round.values))
    }

    fn note_values(&mut self, level: u32, cycle: Option<u32>, values: Vec<MonitorReading>) -> Step<()> {
        if !values.is_empty() {
            let t_ns = self.now_ns();
            self.recorder.record(t_ns, Record::ProcessValues { level, cycle, values })?;
        }
        Ok(())
    }

    fn now_ns(&self) -> u64 {
        now_ns(self.started, self.elapsed_before_ns)
    }
}

/// The journal's time, in nanoseconds.
pub(super) fn now_ns(started: Instant, elapsed_before_ns: u64) -> u64 {
    elapsed_before_ns.saturating_add(u64::try_from(started.elapsed().as_nanos()).unwrap_or(u64::MAX))
}
