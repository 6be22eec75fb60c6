//! Runs a plan on instruments: soak, arm, collect, label, check, retake; and ends in the safe state, always.
//!
//! The only room that commands instruments. It judges no picture: what counts is whether the frames of a cycle
//! are all there and lie where the trigger unit put them.

mod burst;
mod camera;
mod error;
mod matching;
mod monitors;
mod origin;
mod recorder;
mod stop;
mod watch;

pub use error::CampaignError;
pub use monitors::{Exceeded, MonitorLine, Monitors, Watched};
pub use origin::Origins;
pub use recorder::{Label, RecordError, Recorder, crc_of};
pub use stop::{StopFlag, Wish};

use camera::{camera_trouble, prepare_camera};

use crate::config::{Config, Soak};
use crate::journal::{CycleCount, JOURNAL_SCHEMA, Record};
use crate::plan::{LevelPlan, Plan, Purpose};
use crate::soak::{Judge, Verdict};
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{
    Calibrator, CalibratorSettings, Camera, CameraSettings, ShotProgram, TriggerUnit,
};
use ditd_drivers::quantity::{Kelvin, KelvinDelta};
use std::panic::AssertUnwindSafe;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// The stop wish is looked at this often while waiting.
const WISH_POLL: Duration = Duration::from_millis(250);

/// How often a camera may go and come back at one level.
const CAMERA_LOSSES_MAX: u32 = 3;

/// Where an interrupted soak or a plate that leaves its band is soaked again, at most this often per level.
const RESOAKS_MAX: u32 = 5;

/// The instruments of a rig.
pub struct Instruments {
    /// Black-body plate.
    pub plate: Box<dyn Calibrator>,
    /// Trigger unit.
    pub trigger: Box<dyn TriggerUnit>,
    /// Infrared camera.
    pub camera: Box<dyn Camera>,
    /// Sources of process values.
    pub monitors: Monitors,
}

impl std::fmt::Debug for Instruments {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Instruments")
    }
}

/// How a campaign ended when nothing went wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All of the plan is done.
    Done,
    /// Paused after a cycle on the operator's wish.
    Paused,
    /// Stopped at once on the operator's wish.
    Stopped,
}

/// The end of a campaign, in the safe state as far as the instruments could be reached.
#[derive(Debug)]
pub struct Outcome {
    /// How it ended.
    pub ended: Result<Ended, CampaignError>,
    /// What went wrong on the way to the safe state; empty when it was reached.
    pub unsafe_because: Vec<DriverError>,
    /// The account of cycles.
    pub cycles: CycleCount,
}

/// What the operator sees while it runs.
pub trait Progress {
    /// Cycles done of cycles planned, and the estimated remaining time of the whole in s.
    fn cycle(&mut self, done: u32, planned: u32, eta_s: f64);
    /// Why nothing happens just now.
    fn waiting(&mut self, reason: &str, eta_s: Option<f64>);
    /// Something worth a line.
    fn note(&mut self, text: &str);
    /// A level is complete: a chance to show the provisional map.
    fn level_done(&mut self, _recorder: &Recorder) {}
}

/// Everything a campaign needs.
pub struct Engine<'a> {
    /// The campaign file.
    pub config: &'a Config,
    /// The plan.
    pub plan: &'a Plan,
    /// The instruments.
    pub instruments: &'a mut Instruments,
    /// The record.
    pub recorder: &'a mut Recorder,
    /// The display.
    pub progress: &'a mut dyn Progress,
    /// The operator's wish.
    pub stop: StopFlag,
    /// Zero of the journal's time.
    pub started: Instant,
    /// Added to the journal's time when a run is resumed, in ns.
    pub elapsed_before_ns: u64,
    /// When fuel may last have been injected; a resumed run starts with its own beginning.
    pub last_injection: Option<Instant>,
    /// What the bursts before say of when first frames come.
    pub origins: Origins,
}

enum Interrupt {
    Wish(Wish),
    Error(CampaignError),
    /// The camera is gone: it may come back.
    CameraLost(DriverError),
}

impl<E: Into<CampaignError>> From<E> for Interrupt {
    fn from(error: E) -> Self {
        Self::Error(error.into())
    }
}

type Step<T> = Result<T, Interrupt>;

/// What has gone wrong at a level, over its bursts.
#[derive(Debug, Default)]
struct Streaks {
    /// Cycles in a row without a frame; a burst may have one cycle only.
    silent: u32,
    /// Lines that were lost and opened again.
    losses: u32,
}

impl Engine<'_> {
    /// Runs the plan to its end, to a wish, or to trouble; the safe state comes last, whatever happened.
    pub async fn run(mut self, header: Option<Record>) -> Outcome {
        self.recorder.monitor(self.instruments.monitors.names());
        let acquired = {
            let mut acquire = Box::pin(self.acquire(header));
            // A panic inside must not leave a hot plate and an armed injector behind.
            std::future::poll_fn(move |context| {
                match std::panic::catch_unwind(AssertUnwindSafe(|| acquire.as_mut().poll(context))) {
                    Ok(poll) => poll,
                    Err(panic) => {
                        let words = panic
                            .downcast_ref::<String>()
                            .map(String::as_str)
                            .or_else(|| panic.downcast_ref::<&str>().copied())
                            .unwrap_or("no words");
                        std::task::Poll::Ready(Err(Interrupt::Error(CampaignError::Internal(
                            words.to_owned(),
                        ))))
                    }
                }
            })
            .await
        };
        let ended = match acquired {
            Ok(()) => Ok(Ended::Done),
            Err(Interrupt::Wish(Wish::Stop)) => Ok(Ended::Stopped),
            Err(Interrupt::Wish(_)) => Ok(Ended::Paused),
            Err(Interrupt::Error(error)) => Err(error),
            Err(Interrupt::CameraLost(error)) => Err(error.into()),
        };
        // Injector and clock first, before anything that could wait for a disk or a terminal; once more in order, with its
        // record, when that was not confirmed.
        let rests = self.instruments.trigger.make_safe().await.is_ok();
        self.progress.waiting("bringing the rig to its safe state", None);
        let _ = self.note(Record::Intent { act: "safe state".to_owned(), level: None });
        let unsafe_because = safe_state(self.instruments, rests).await;
        if unsafe_because.is_empty() {
            let _ = self.note(Record::Done { act: "safe state".to_owned(), level: None });
        }
        let cycles = self.account(&ended);
        let status = match &ended {
            Ok(Ended::Done) => "done",
            Ok(Ended::Paused) => "paused",
            Ok(Ended::Stopped) => "aborted",
            Err(_) => "failed",
        };
        let mut trouble: Vec<String> = ended.as_ref().err().map(ToString::to_string).into_iter().collect();
        trouble.extend(unsafe_because.iter().map(|error| format!("safe state not confirmed: {error}")));
        let trouble = (!trouble.is_empty()).then(|| trouble.join("; "));
        let stop = self
            .note(Record::Stop { status: status.to_owned(), trouble, cycles })
            .and_then(|()| Ok(self.recorder.close()?));
        let ended = match (ended, stop) {
            (Ok(_), Err(error)) => Err(error),
            (ended, _) => ended,
        };
        Outcome { ended, unsafe_because, cycles }
    }

    async fn acquire(&mut self, header: Option<Record>) -> Step<()> {
        if let Some(header) = header {
            self.note(header)?;
        }
        self.prepare().await?;
        for (index, level) in self.plan.levels.iter().enumerate() {
            let number = u32::try_from(index).expect("levels are few");
            let mut losses = 0;
            loop {
                match self.level(number, level).await {
                    Err(Interrupt::CameraLost(error)) if losses < CAMERA_LOSSES_MAX => {
                        losses += 1;
                        self.find_camera_again(number, level, &error).await?;
                    }
                    ended => break ended?,
                }
            }
        }
        Ok(())
    }

    async fn prepare(&mut self) -> Step<()> {
        self.progress.waiting("asking the instruments who they are", None);
        let identity = self.instruments.trigger.identify().await?;
        self.note(Record::Identity { instrument: "trigger".to_owned(), identity })?;
        // Whatever an earlier run left behind: no pulse from here on but ours.
        self.instruments.trigger.make_safe().await?;
        let identity = self.instruments.plate.identify().await?;
        self.note(Record::Identity { instrument: "plate".to_owned(), identity })?;
        let identity = self.instruments.camera.identify().await.map_err(camera_trouble)?;
        self.note(Record::Identity { instrument: "camera".to_owned(), identity })?;
        self.instruments.plate.prepare(&calibrator_settings(self.config)).await?;
        let values = self.instruments.plate.particulars().await?;
        if !values.is_empty() {
            self.note(Record::Particulars { instrument: "plate".to_owned(), values })?;
        }
        prepare_camera(&mut *self.instruments.camera, self.config).await
    }

    async fn level(&mut self, number: u32, level: &LevelPlan) -> Step<()> {
        let index = number as usize;
        let map = self.plan.purpose == Purpose::Map;
        if map && self.recorder.reduced().missing(index) == 0 {
            return Ok(());
        }
        self.soak(number, level.set_point_k).await?;
        // Here and nowhere else: inside a level a new offset would tear spray and blanks apart.
        self.instruments.camera.correct_offset().await.map_err(camera_trouble)?;
        let mut settled = true;
        let mut resoaks = 0;
        let mut streaks = Streaks::default();
        if level.shutter_reference {
            let shutter = self.instruments.camera.shutter(true).await.map_err(camera_trouble)?;
            let mut reference = Ok(true);
            while self.recorder.reduced().levels[index].references == 0 {
                // A plate that left its band is soaked again, as for the frames of the plate itself.
                if let Ok(false) = reference {
                    reference = self.soak(number, level.set_point_k).await.map(|()| true);
                }
                if reference.is_err() {
                    break;
                }
                reference = self.burst_to_the_end(number, &level.program, 1, shutter, &mut streaks).await;
            }
            if !matches!(reference, Err(Interrupt::CameraLost(_))) {
                self.instruments.camera.shutter(false).await.map_err(camera_trouble)?;
            }
            reference?;
        }
        loop {
            let missing = if map {
                self.recorder.reduced().missing(index)
            } else {
                1 - self.recorder.reduced().levels[index].accepted.min(1)
            };
            if missing == 0 {
                break;
            }
            if !settled {
                resoaks += 1;
                if resoaks > RESOAKS_MAX {
                    return Err(Interrupt::Error(self.too_many_retakes(number)));
                }
                self.soak(number, level.set_point_k).await?;
            }
            self.await_flushed(&level.program).await?;
            settled = self.burst_to_the_end(number, &level.program, missing, None, &mut streaks).await?;
        }
        self.progress.level_done(self.recorder);
        Ok(())
    }

    /// Waits until the chamber has had its pause since the last injection, so that a burst's first blanks see no more
    /// residual vapour than the others, and injections stay apart.
    async fn await_flushed(&mut self, program: &ShotProgram) -> Step<()> {
        let Some(last) = self.last_injection.filter(|_| program.inject) else { return Ok(()) };
        let ready = last + Duration::from_nanos(program.cycle_ns());
        self.await_due(ready, Duration::ZERO, "pause, residual vapour is flushed out").await
    }

    /// Waits until `lead` before `due`, with an ear for wishes, and says what for.
    async fn await_due(&mut self, due: Instant, lead: Duration, reason: &str) -> Step<()> {
        loop {
            let left = due.saturating_duration_since(Instant::now());
            if left <= lead {
                return Ok(());
            }
            self.heed(Wish::Pause)?;
            self.progress.waiting(reason, Some(left.as_secs_f64()));
            sleep((left - lead).min(WISH_POLL)).await;
        }
    }

    /// Waits for so long, with an ear for wishes.
    async fn pause(&self, time: Duration) -> Step<()> {
        let until = Instant::now() + time;
        loop {
            self.heed(Wish::Pause)?;
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(());
            }
            sleep(left.min(WISH_POLL)).await;
        }
    }

    /// Sets the plate and waits until it is really settled.
    async fn soak(&mut self, level: u32, target_k: f64) -> Step<()> {
        let act = format!("set the plate to {target_k:.3} K");
        self.note(Record::Intent { act: act.clone(), level: Some(level) })?;
        let taken = self.instruments.plate.set_point(Kelvin(target_k)).await?;
        self.note(Record::Done { act, level: Some(level) })?;
        let begun = Instant::now();
        let mut judge = Judge::new(taken.0, &fresh_rules(&self.config.soak, self.instruments.plate.digit()));
        loop {
            self.heed(Wish::Pause)?;
            let (reading, values) = self.read_plate(level).await?;
            let now_s = begun.elapsed().as_secs_f64();
            match judge.push(now_s, reading.apparent.0) {
                Verdict::Settled => {
                    self.note_values(level, None, values)?;
                    self.note(Record::Settled { level, reading, waited_s: now_s })?;
                    return Ok(());
                }
                Verdict::Waiting { reason, eta_s } => {
                    let text = format!("level {}: {reason}", level + 1);
                    self.progress.waiting(&text, eta_s);
                }
                Verdict::GivenUp { reason, eta_s } => {
                    return Err(Interrupt::Error(CampaignError::NotSettled {
                        level: level + 1,
                        target_k,
                        waited_s: now_s,
                        reason,
                        eta_s,
                    }));
                }
            }
            self.pause(Duration::from_secs_f64(self.config.soak.poll_s)).await?;
        }
    }

    fn reject(&mut self, level: u32, cycle: u32, reason: String) -> Step<()> {
        self.progress.note(&format!("level {}, cycle {cycle} is taken again: {reason}", level + 1));
        self.note(Record::CycleRejected { level, cycle, reason })?;
        let rejected = self.recorder.reduced().levels[level as usize].rejected.len();
        if rejected > self.plan.retakes_max as usize {
            return Err(Interrupt::Error(self.too_many_retakes(level)));
        }
        Ok(())
    }

    fn too_many_retakes(&self, level: u32) -> CampaignError {
        let rejected = &self.recorder.reduced().levels[level as usize].rejected;
        CampaignError::TooManyRetakes {
            level: level + 1,
            rejected: u32::try_from(rejected.len()).unwrap_or(u32::MAX),
            allowed: self.plan.retakes_max,
            reason: rejected
                .last()
                .map_or_else(|| "the plate left its band".to_owned(), |(_, why)| why.clone()),
        }
    }

    /// Returns the wish as an interrupt when it is at least `from`.
    fn heed(&self, from: Wish) -> Step<()> {
        let wish = self.stop.wish();
        if wish >= from { Err(Interrupt::Wish(wish)) } else { Ok(()) }
    }

    fn show_cycle(&mut self, level: u32) {
        let reduced = self.recorder.reduced();
        let done: u32 = reduced.levels.iter().map(|state| state.accepted).sum();
        let planned: u32 = self.plan.levels.iter().map(|level| level.program.cycles).sum();
        let here = reduced.missing(level as usize);
        let mut eta_s = f64::from(here) * self.plan.levels[level as usize].program.cycle_ns() as f64 * 1e-9;
        for later in self.plan.levels.iter().skip(level as usize + 1) {
            eta_s += later.program.burst_ns() as f64 * 1e-9 + 600.0;
        }
        self.progress.cycle(done, planned, eta_s);
    }

    fn account(&self, ended: &Result<Ended, CampaignError>) -> CycleCount {
        let reduced = self.recorder.reduced();
        let planned = self.plan.levels.iter().map(|level| level.program.cycles).sum();
        let accepted = reduced.levels.iter().map(|state| state.accepted).sum();
        let retaken = reduced.levels.iter().map(|state| state.rejected.len()).sum::<usize>();
        let ended_well = matches!(ended, Ok(Ended::Done | Ended::Paused));
        let lost = if ended_well { 0 } else { u32::saturating_sub(planned, accepted) };
        CycleCount { planned, accepted, retaken: u32::try_from(retaken).unwrap_or(u32::MAX), lost }
    }

    fn note(&mut self, record: Record) -> Result<(), CampaignError> {
        let t_ns = self.now_ns();
        Ok(self.recorder.record(t_ns, record)?)
    }

    fn now_ns(&self) -> u64 {
        watch::now_ns(self.started, self.elapsed_before_ns)
    }
}

/// Injector channel off, trigger clock off (unless they rest already), camera off, plate to its minimum: in this order,
/// each tried even if an earlier one could not be reached. Returns what could not be confirmed.
async fn safe_state(instruments: &mut Instruments, trigger_rests: bool) -> Vec<DriverError> {
    let mut trouble = Vec::new();
    if !trigger_rests {
        let mut made = instruments.trigger.make_safe().await;
        if made.as_ref().is_err_and(DriverError::is_reopened) {
            // The line is there again, and nothing was repeated yet.
            made = instruments.trigger.make_safe().await;
        }
        trouble.extend(made.err());
    }
    if let Err(error) = instruments.camera.make_safe().await {
        trouble.push(error);
    }
    if let Err(error) = instruments.plate.make_safe().await {
        trouble.push(error);
    }
    trouble
}

/// The rules of settling for a display whose last digit is `digit`. A reading that stands still says that the display
/// froze only where its digit is finer than what a settled plate moves; a coarser one may stand still for all of the hold
/// time, so that twice that time is allowed.
fn fresh_rules(rules: &Soak, digit: KelvinDelta) -> Soak {
    let is_fine = digit.0 <= FINE_DIGIT_K;
    let stale_s = if is_fine { rules.stale_s } else { rules.stale_s.max(2.0 * rules.hold_s) };
    Soak { stale_s, ..rules.clone() }
}

/// Finest digit at which a settled plate may stand still: black bodies of this kind are stable to 0.05 K at best, with
/// periods of a minute or two (Technical Guide of the 418x, specifications).
const FINE_DIGIT_K: f64 = 0.01;

/// What the calibrator is told.
pub fn calibrator_settings(config: &Config) -> CalibratorSettings {
    CalibratorSettings {
        display_emissivity: config.plate.display_emissivity,
        limit: Kelvin(config.plate.limit_k),
        rate_k_per_min: config.plate.rate_k_per_min,
        stability: KelvinDelta(config.plate.stability_k),
    }
}

/// What the camera is told.
pub fn camera_settings(config: &Config) -> CameraSettings {
    CameraSettings {
        rows: config.camera.rows,
        columns: config.camera.columns,
        integration_s: config.camera.integration_s,
        bits: config.camera.bits,
    }
}

/// The first record of a run.
pub fn header(plan: &Plan, utc: String, config_sha256: String) -> Record {
    Record::Start {
        schema: JOURNAL_SCHEMA,
        program: concat!("ditd ", env!("CARGO_PKG_VERSION")).to_owned(),
        utc,
        config_sha256,
        plan: plan.clone(),
    }
}
