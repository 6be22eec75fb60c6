//! The stream's side of the camera: frames from the camera behind, cut into packets and sent; packets sent again.
//!
//! One task owns the camera behind. It obeys orders between frames; while it waits for a frame it looks for orders
//! every 20 ms, because an exchange with an instrument is never dropped half-way. Frames that are not taken in time
//! stay in the camera's own queue.

use super::device::Plan;
use super::fault::{Faults, PacketKey};
use super::gvcp::ResendRange;
use super::gvsp::{Block, IdMode, Leader, unavailable};
use super::image::Stamp;
use super::stats::{GigeStats, Shared};
use crate::rig::pulse::Pulse;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Camera, CameraSettings, Frame};
use ditd_drivers::quantity::Kelvin;
use std::collections::VecDeque;
use std::net::{SocketAddr, SocketAddrV4};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, sleep_until};

/// Payload bytes kept for resend requests: 25 frames of 640 × 512 pixels of two bytes. Beyond, the oldest frame goes,
/// and requests for it are answered with PACKET_UNAVAILABLE.
pub const RESEND_BYTES_MAX: usize = 16 << 20;

/// Datagrams on their way late at the same time; beyond, they are lost.
const LATE_MAX: usize = 4096;

/// Packets that one resend request can ask for; the rest of it is ignored.
const RESEND_PACKETS_MAX: u32 = 8192;

/// How long the task waits for a frame before it looks for orders.
const FRAME_POLL: Duration = Duration::from_millis(20);

/// Grain of the clock: shorter pauses between packets are made up for by sending several at once.
const PAUSE_GRAIN: Duration = Duration::from_millis(1);

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
    Started(CameraSettings),
    Stopped,
    Shutter(bool, Option<Kelvin>),
    Corrected,
}

/// What the task tells the control side unasked.
pub(super) enum Report {
    /// The stream has ended by itself.
    Ended,
    /// The camera restarts and is silent for so long.
    Restart(Duration),
}

/// Sends packets, whole or as the faults have it.
#[derive(Clone)]
pub(super) struct Outlet {
    pub(super) socket: Arc<UdpSocket>,
    pub(super) faults: Arc<Faults>,
    pub(super) stats: Shared,
    pub(super) late: Late,
}

/// Datagrams on their way late.
#[derive(Clone)]
pub(super) struct Late(Arc<Semaphore>);

impl Late {
    pub(super) fn new() -> Self {
        Self(Arc::new(Semaphore::new(LATE_MAX)))
    }

    /// Sends a datagram after `delay`.
    pub(super) fn send(&self, socket: &Arc<UdpSocket>, bytes: Vec<u8>, to: SocketAddr, delay: Duration) {
        let Ok(permit) = Arc::clone(&self.0).try_acquire_owned() else { return };
        let socket = Arc::clone(socket);
        tokio::spawn(async move {
            sleep(delay).await;
            // A client that has gone does not matter any more.
            let _ = socket.send_to(&bytes, to).await;
            drop(permit);
        });
    }
}

impl Outlet {
    async fn send(&self, bytes: &[u8], to: SocketAddrV4, tally: &mut GigeStats) {
        match self.socket.send_to(bytes, to).await {
            Ok(_) => tally.packets_sent += 1,
            Err(_) => tally.packets_failed += 1,
        }
    }

    /// Sends one packet that lies in `bytes`; false when it is to come behind the next one.
    async fn send_packet(
        &self,
        key: PacketKey,
        bytes: &mut Vec<u8>,
        to: SocketAddrV4,
        tally: &mut GigeStats,
    ) -> bool {
        let fate = self.faults.packet(key);
        if fate.lost {
            tally.packets_dropped += 1;
            return true;
        }
        if fate.cut {
            tally.packets_cut += 1;
            bytes.truncate(bytes.len() / 2);
        }
        if let Some(delay) = fate.late {
            tally.packets_late += 1;
            self.late.send(&self.socket, bytes.clone(), to.into(), delay);
            return true;
        }
        if fate.swapped {
            tally.packets_swapped += 1;
            return false;
        }
        self.send(bytes, to, tally).await;
        if fate.doubled {
            tally.packets_doubled += 1;
            self.send(bytes, to, tally).await;
        }
        true
    }

    /// Sends a block, at least `delay_ns` from packet to packet on average.
    async fn send_block(&self, block: &Block, frame: u64, to: SocketAddrV4, delay_ns: u64) {
        let mut tally = GigeStats::default();
        let packets = block.packets();
        let mut bytes = Vec::with_capacity(block.packet_bytes);
        let mut held: Option<Vec<u8>> = None;
        let start = Instant::now();
        for packet in 0..packets {
            if delay_ns > 0 {
                let due = start + Duration::from_nanos(delay_ns.saturating_mul(u64::from(packet)));
                if due.duration_since(Instant::now()) > PAUSE_GRAIN {
                    sleep_until(due).await;
                }
            }
            if !block.write_packet(packet, &mut bytes) {
                continue;
            }
            let key = PacketKey { frame, packet, packets, attempt: 0 };
            if self.send_packet(key, &mut bytes, to, &mut tally).await {
                if let Some(earlier) = held.take() {
                    self.send(&earlier, to, &mut tally).await;
                }
            } else if let Some(earlier) = held.replace(bytes.clone()) {
                self.send(&earlier, to, &mut tally).await;
            }
        }
        if let Some(last) = held {
            self.send(&last, to, &mut tally).await;
        }
        self.stats.note(|stats| {
            stats.frames_sent += 1;
            stats.packets_sent += tally.packets_sent;
            stats.packets_failed += tally.packets_failed;
            stats.packets_dropped += tally.packets_dropped;
            stats.packets_swapped += tally.packets_swapped;
            stats.packets_doubled += tally.packets_doubled;
            stats.packets_cut += tally.packets_cut;
            stats.packets_late += tally.packets_late;
        });
    }

    /// Answers a resend request.
    pub(super) async fn resend(&self, ring: &Ring, range: ResendRange, ids: IdMode, to: SocketAddrV4) {
        let mut tally = GigeStats::default();
        let found = ring.find(range.block);
        let packets = found.as_ref().map_or(0, |(block, ..)| block.packets());
        // The standard lets the last packet be all ones: to the end of the block.
        let last = range.last.min(packets.max(range.first + 1).saturating_sub(1));
        let last = last.min(range.first.saturating_add(RESEND_PACKETS_MAX - 1));
        let mut bytes = Vec::new();
        for packet in range.first..=last {
            let written = match &found {
                Some((block, ..)) => block.write_packet(packet, &mut bytes),
                None => false,
            };
            if let (true, Some((_, frame, attempt))) = (written, &found) {
                let key = PacketKey { frame: *frame, packet, packets, attempt: *attempt };
                if !self.send_packet(key, &mut bytes, to, &mut tally).await {
                    self.send(&bytes, to, &mut tally).await;
                }
                tally.packets_resent += 1;
            } else {
                self.refuse(range.block, packet, ids, to, &mut tally).await;
            }
        }
        self.note_resend(&tally);
    }

    /// Answers a resend request with a refusal of every packet.
    pub(super) async fn refuse_resend(&self, range: ResendRange, ids: IdMode, to: SocketAddrV4) {
        let mut tally = GigeStats::default();
        let last = range.last.min(range.first.saturating_add(RESEND_PACKETS_MAX - 1));
        for packet in range.first..=last {
            self.refuse(range.block, packet, ids, to, &mut tally).await;
        }
        self.note_resend(&tally);
    }

    async fn refuse(&self, block: u64, packet: u32, ids: IdMode, to: SocketAddrV4, tally: &mut GigeStats) {
        tally.packets_refused += 1;
        self.send(&unavailable(ids, block, packet), to, tally).await;
    }

    fn note_resend(&self, tally: &GigeStats) {
        self.stats.note(|stats| {
            stats.packets_sent += tally.packets_sent;
            stats.packets_failed += tally.packets_failed;
            stats.packets_dropped += tally.packets_dropped;
            stats.packets_resent += tally.packets_resent;
            stats.packets_refused += tally.packets_refused;
        });
    }
}

/// The last frames, for resend requests.
#[derive(Debug, Clone, Default)]
pub(super) struct Ring(Arc<Mutex<VecDeque<Kept>>>);

#[derive(Debug)]
struct Kept {
    block: Arc<Block>,
    frame: u64,
    attempts: u32,
}

impl Ring {
    fn keep(&self, block: Arc<Block>, frame: u64) {
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        ring.push_back(Kept { block, frame, attempts: 0 });
        let mut bytes: usize = ring.iter().map(|kept| kept.block.payload.len()).sum();
        while bytes > RESEND_BYTES_MAX && ring.len() > 1 {
            bytes -= ring.pop_front().map_or(0, |kept| kept.block.payload.len());
        }
    }

    /// The youngest block with this id, the ordinal of its frame, and how often it was asked for, this time included.
    fn find(&self, id: u64) -> Option<(Arc<Block>, u64, u32)> {
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = ring.iter_mut().rev().find(|kept| kept.block.id == id)?;
        kept.attempts = kept.attempts.saturating_add(1);
        Some((Arc::clone(&kept.block), kept.frame, kept.attempts))
    }

    pub(super) fn clear(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
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
                let free = plan.trigger == super::device::Trigger::Free && self.pulser.pulses.is_some();
                let clock = free.then(|| tokio::spawn(self.pulser.clone().run(plan.rate_hz)));
                let mut plan = *plan;
                plan.layout.integration_s = taken.integration_s;
                *run = Some(Run { plan, last: None, frames: 0, stalled_until: None, clock });
                self.outlet.stats.note(|stats| stats.streams += 1);
                Ok(Outcome::Started(taken))
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
                return Some(Report::Ended);
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
                return Some(Report::Ended);
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
        run.plan.frames_max.is_some_and(|max| run.frames >= max).then_some(Report::Ended)
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
        let timestamp_ns =
            frame.device_ns.saturating_sub(zero_ns).saturating_add_signed(faults.clock_error_ns(ordinal));
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
