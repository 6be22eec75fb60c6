//! The stream's side of the camera: frames from the camera behind, made into blocks and sent; triggers made.
//!
//! One task owns the camera behind. It obeys orders between frames; while it waits for a frame it looks for orders
//! every 20 ms, because an exchange with an instrument is never dropped half-way. Frames that are not taken in time
//! stay in the camera's own queue.

use super::gvsp::{Block, Leader};
use super::image::Stamp;
use super::outlet::{Outlet, Ring};
use super::plan::{Plan, Trigger};
use super::stats::Shared;
use crate::rig::pulse::Pulse;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Camera, CameraSettings, Frame};
use ditd_drivers::quantity::Kelvin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, sleep_until};

/// How long the task waits for a frame before it looks for orders.
const FRAME_POLL: Duration = Duration::from_millis(20);

/// How long a non-uniformity correction keeps the shutter closed.
const CORRECTION: Duration = Duration::from_millis(500);

/// Where messages for the operator go.
pub(super) type Log = Arc<dyn Fn(&str) + Send + Sync>;

/// What the control side tells the task.
pub(super) struct Order {
    pub(super) act: Act,
    pub(super) done: oneshot::Sender<Result<Outcome, String>>,
}

pub(super) enum Act {
    Start(Box<Plan>),
    Stop,
    Shutter(bool),
    Correct,
}

/// What an act has led to.
#[derive(Debug)]
pub(super) enum Outcome {
    /// What the camera took, and the number of the stream.
    Started(CameraSettings, u64),
    Stopped,
    Shutter(bool, Option<Kelvin>),
    Corrected,
}

/// What the task tells the control side unasked.
pub(super) enum Report {
    /// The stream of this number has ended by itself.
    Ended(u64),
    /// The camera restarts and is silent for so long.
    Restart(Duration),
}

/// Makes triggers for the camera behind.
#[derive(Clone)]
pub(super) struct Pulser {
    pub(super) pulses: Option<mpsc::Sender<Pulse>>,
    pub(super) start: Instant,
    pub(super) made: Arc<AtomicU64>,
    pub(super) stats: Shared,
}

impl Pulser {
    /// One trigger, now.
    pub(super) fn fire(&self) {
        self.fire_at(self.start.elapsed());
    }

    fn fire_at(&self, at: Duration) {
        let Some(pulses) = &self.pulses else { return };
        let t0_index = self.made.fetch_add(1, Ordering::Relaxed);
        let at_ns = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
        // The width of a trigger does not matter to a camera.
        let pulse = Pulse { t0_index, at_ns, camera: Some((0, 10_000)), injector: None };
        let taken = pulses.try_send(pulse).is_ok();
        self.stats.note(|stats| {
            stats.triggers += 1;
            stats.triggers_missed += u64::from(!taken);
        });
    }

    /// Triggers at a rate until the task is aborted.
    async fn run(self, rate_hz: f64) {
        let begin = self.start.elapsed();
        for ordinal in 0_u64.. {
            let at = begin + Duration::from_secs_f64(ordinal as f64 / rate_hz);
            sleep_until(self.start + at).await;
            self.fire_at(at);
        }
    }
}

/// What control and stream both see.
#[derive(Debug, Clone, Default)]
pub(super) struct Flags {
    /// The factory gain has been overwritten.
    pub(super) spoiled: Arc<AtomicBool>,
    /// Raw clock, in nanoseconds, at the last reset of the clock.
    pub(super) clock_zero_ns: Arc<AtomicU64>,
    /// By how much a fault has put the clock forward, in nanoseconds.
    pub(super) clock_error_ns: Arc<AtomicI64>,
}

/// The task.
pub(super) struct Streamer {
    pub(super) camera: Box<dyn Camera>,
    pub(super) orders: mpsc::Receiver<Order>,
    pub(super) reports: mpsc::Sender<Report>,
    pub(super) outlet: Outlet,
    pub(super) ring: Ring,
    pub(super) pulser: Pulser,
    pub(super) flags: Flags,
    pub(super) log: Log,
    /// Frames so far over the life of the camera.
    pub(super) frames: u64,
    /// Streams so far.
    pub(super) runs: u64,
}

/// A stream that runs.
struct Run {
    plan: Plan,
    /// Id of the camera's last frame and its block id.
    last: Option<(u64, u64)>,
    frames: u64,
    stalled_until: Option<Instant>,
    clock: Option<JoinHandle<()>>,
}

impl Drop for Run {
    fn drop(&mut self) {
        if let Some(clock) = &self.clock {
            clock.abort();
        }
    }
}

impl Streamer {
    /// Lives until the control side has gone; gives the camera back, stopped.
    pub(super) async fn live(mut self) -> Box<dyn Camera> {
        let mut run: Option<Run> = None;
        loop {
            let order = if run.is_some() {
                match self.orders.try_recv() {
                    Ok(order) => Some(order),
                    Err(mpsc::error::TryRecvError::Empty) => None,
                    Err(mpsc::error::TryRecvError::Disconnected) => break,
                }
            } else {
                match self.orders.recv().await {
                    Some(order) => Some(order),
                    None => break,
                }
            };
            if let Some(order) = order {
                let result = self.obey(order.act, &mut run).await;
                // Nobody waits for the stop after a loss of control.
                let _ = order.done.send(result);
            } else if let Some(running) = &mut run
                && let Some(report) = self.next_frame(running).await
            {
                run = None;
                self.halt().await;
                if self.reports.send(report).await.is_err() {
                    break;
                }
            }
        }
        drop(run);
        if let Err(error) = self.camera.make_safe().await {
            (self.log)(&format!("camera on the network: stopping: {error}"));
        }
        self.camera
    }

    async fn obey(&mut self, act: Act, run: &mut Option<Run>) -> Result<Outcome, String> {
        match act {
            Act::Start(plan) => {
                *run = None;
                let taken = self.camera.prepare(&plan.settings).await.map_err(|error| error.to_string())?;
                self.camera.start().await.map_err(|error| error.to_string())?;
                self.ring.clear();
                let free = plan.trigger == Trigger::Free && self.pulser.pulses.is_some();
                let clock = free.then(|| tokio::spawn(self.pulser.clone().run(plan.rate_hz)));
                let mut plan = *plan;
                plan.layout.integration_s = taken.integration_s;
                self.runs += 1;
                *run = Some(Run { plan, last: None, frames: 0, stalled_until: None, clock });
                self.outlet.stats.note(|stats| stats.streams += 1);
                Ok(Outcome::Started(taken, self.runs))
            }
            Act::Stop => {
                *run = None;
                self.halt().await;
                Ok(Outcome::Stopped)
            }
            Act::Shutter(closed) => {
                let temperature = self.camera.shutter(closed).await.map_err(|error| error.to_string())?;
                Ok(Outcome::Shutter(closed, temperature))
            }
            Act::Correct => {
                self.camera.shutter(true).await.map_err(|error| error.to_string())?;
                sleep(CORRECTION).await;
                self.camera.shutter(false).await.map_err(|error| error.to_string())?;
                self.outlet.stats.note(|stats| stats.corrections += 1);
                Ok(Outcome::Corrected)
            }
        }
    }

    async fn halt(&mut self) {
        if let Err(error) = self.camera.stop().await {
            (self.log)(&format!("camera on the network: stopping: {error}"));
        }
    }

    /// Waits for a frame and sends it; a report when the stream ends with it.
    async fn next_frame(&mut self, run: &mut Run) -> Option<Report> {
        let frame = match self.camera.frame(FRAME_POLL).await {
            Ok(frame) => frame,
            Err(DriverError::Silent { .. }) => return None,
            Err(error) => {
                (self.log)(&format!("camera on the network: the stream ends: {error}"));
                return Some(Report::Ended(self.runs));
            }
        };
        let ordinal = self.frames;
        self.frames += 1;
        self.outlet.stats.note(|stats| stats.frames += 1);
        if let Some(silence) = self.outlet.faults.restart(ordinal) {
            return Some(Report::Restart(silence));
        }
        let block = match self.block(run, &frame, ordinal) {
            Ok(block) => block,
            Err(why) => {
                (self.log)(&format!("camera on the network: the stream ends: {why}"));
                return Some(Report::Ended(self.runs));
            }
        };
        if let Some(block) = block {
            let block = Arc::new(block);
            self.ring.keep(Arc::clone(&block), ordinal);
            if let Some(to) = run.plan.destination {
                self.outlet.send_block(&block, ordinal, to, run.plan.packet_delay_ns).await;
            }
        }
        run.frames += 1;
        run.plan.frames_max.is_some_and(|max| run.frames >= max).then_some(Report::Ended(self.runs))
    }

    /// The block of a frame; `None` when a fault takes it whole.
    fn block(&mut self, run: &mut Run, frame: &Frame, ordinal: u64) -> Result<Option<Block>, String> {
        let faults = &self.outlet.faults;
        let (plan, ids) = (&run.plan, run.plan.ids);
        let id = match run.last {
            None => ids.after(1, (faults.first_id() - 1).saturating_add(faults.id_jump(ordinal))),
            Some((camera_id, block_id)) => {
                // A frame that the camera lost leaves a gap; an id that does not rise counts as the next one.
                let step = frame.id.saturating_sub(camera_id).max(1);
                self.outlet.stats.note(|stats| stats.frames_missing += step - 1);
                ids.after(block_id, step.saturating_add(faults.id_jump(ordinal)))
            }
        };
        run.last = Some((frame.id, id));
        if let Some(duration) = faults.stall(ordinal) {
            run.stalled_until = Some(Instant::now() + duration);
        }
        let stalled = run.stalled_until.is_some_and(|until| Instant::now() < until);
        if stalled || faults.loses_frame(ordinal) {
            self.outlet.stats.note(|stats| stats.frames_lost += 1);
            return Ok(None);
        }
        let zero_ns = self.flags.clock_zero_ns.load(Ordering::Relaxed);
        let error_ns = faults.clock_error_ns(ordinal);
        self.flags.clock_error_ns.store(error_ns, Ordering::Relaxed);
        let timestamp_ns = frame.device_ns.saturating_sub(zero_ns).saturating_add_signed(error_ns);
        let spoiled = self.flags.spoiled.load(Ordering::Relaxed);
        let (payload, present_bytes) =
            plan.layout.payload(frame, Stamp { block: id, timestamp_ns, spoiled })?;
        let leader = Leader {
            payload_type: plan.layout.payload_type,
            timestamp: timestamp_ns,
            pixel_format: faults.pixel_format().unwrap_or(plan.layout.pixel_format),
            width: plan.layout.width,
            height: plan.layout.rows + plan.layout.header_rows,
            offset_x: plan.layout.offset_x,
            offset_y: plan.layout.offset_y,
        };
        Ok(Some(Block { id, ids, leader, payload, packet_bytes: plan.packet_bytes, present_bytes }))
    }
}
