//! The control channel: commands heard, carried out, acknowledged; control given and lost.
//!
//! One task with the registers. An act that takes the camera behind some time is acknowledged when it is done; until
//! then PENDING_ACK is sent, reads are answered and other writes are BUSY. A command heard twice with the same id is
//! answered as before and not carried out again.

use super::bootstrap::DISCOVERY_BYTES;
use super::device::{Device, Effect, PENDING_MS};
use super::fault::GigeFault;
use super::gvcp::{self, Command, PAYLOAD_BYTES_MAX, Request, ResendRange, Status};
use super::gvsp;
use super::outlet::{Outlet, Ring};
use super::plan::Trigger;
use super::stream::{Act, Flags, Log, Order, Outcome, Pulser, Report};
use ditd_drivers::quantity::Kelvin;
use std::collections::VecDeque;
use std::net::{SocketAddr, SocketAddrV4};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep_until};

/// Clients whose last command is remembered.
const CLIENTS_MAX: usize = 8;

/// How long a command counts as the same when its id comes again: Aravis repeats for five times half a second.
const REPEAT: Duration = Duration::from_secs(3);

/// When the first PENDING_ACK is sent, and how far apart they are: clients wait 200 ms (standard) to 500 ms (Aravis).
const PENDING_FIRST: Duration = Duration::from_millis(100);
const PENDING_EVERY: Duration = Duration::from_millis(500);

/// How long the camera is silent after a `DeviceReset`.
const RESET_SILENCE: Duration = Duration::from_secs(2);

/// The camera's clock.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    /// The rig's start.
    pub(super) start: Instant,
    /// What the camera's clock showed then, in nanoseconds.
    pub(super) zero_ns: u64,
}

impl Clock {
    /// Nanoseconds now, not regarding resets of the clock.
    pub(super) fn raw_ns(&self) -> u64 {
        self.zero_ns.saturating_add(u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }
}

/// The last command of a client and its answer.
#[derive(Debug)]
struct Heard {
    client: SocketAddrV4,
    request: Vec<u8>,
    /// `None` while it is carried out.
    answer: Option<Vec<u8>>,
    /// When it was heard, and then when it was answered.
    at: Instant,
}

impl Heard {
    /// Whether an answer is one to this command: their headers end with the same id.
    fn has_id_of(&self, answer: &[u8]) -> bool {
        self.request.get(6..8) == answer.get(6..8)
    }
}

/// A command that is being carried out.
#[derive(Debug)]
struct Pending {
    client: SocketAddrV4,
    number: u16,
    id: u16,
    acknowledge: bool,
    /// What the acknowledge says when all acts are done.
    payload: Vec<u8>,
    status: Status,
    acts: VecDeque<oneshot::Receiver<Result<Outcome, String>>>,
    notice: Instant,
}

/// The control side.
pub(super) struct Control {
    device: Device,
    socket: Arc<UdpSocket>,
    clock: Clock,
    orders: mpsc::Sender<Order>,
    outlet: Outlet,
    ring: Ring,
    pulser: Pulser,
    flags: Flags,
    log: Log,
    heard: VecDeque<Heard>,
    pending: Option<Pending>,
    /// Since when somebody has control, and when it is lost without a heartbeat.
    control_since: Option<Instant>,
    heartbeat_due: Option<Instant>,
    silent_until: Option<Instant>,
    acknowledges: u64,
    /// The stream that was started last, and the last one that has ended by itself.
    run: u64,
    run_ended: u64,
}

impl Control {
    #[expect(clippy::too_many_arguments, reason = "one caller, in the next room")]
    pub(super) fn new(
        device: Device,
        socket: Arc<UdpSocket>,
        clock: Clock,
        orders: mpsc::Sender<Order>,
        outlet: Outlet,
        ring: Ring,
        pulser: Pulser,
        flags: Flags,
        log: Log,
    ) -> Self {
        Self {
            device,
            socket,
            clock,
            orders,
            outlet,
            ring,
            pulser,
            flags,
            log,
            heard: VecDeque::new(),
            pending: None,
            control_since: None,
            heartbeat_due: None,
            silent_until: None,
            acknowledges: 0,
            run: 0,
            run_ended: 0,
        }
    }

    /// Lives until it is switched off.
    pub(super) async fn live(mut self, mut reports: mpsc::Receiver<Report>, mut off: oneshot::Receiver<()>) {
        // No UDP datagram is longer than the buffer: none is cut unnoticed.
        let mut buffer = vec![0; 65_536];
        let socket = Arc::clone(&self.socket);
        loop {
            let far = Instant::now() + Duration::from_secs(3600);
            let notice = self.pending.as_ref().map(|pending| pending.notice);
            let due = notice.into_iter().chain(self.heartbeat_due).min().unwrap_or(far);
            tokio::select! {
                biased;
                _ = &mut off => return,
                done = next_done(&mut self.pending) => self.act_done(done).await,
                report = reports.recv() => match report {
                    Some(report) => self.take_report(report),
                    // The stream's side has died; without it there is no camera.
                    None => return,
                },
                // Before the commands: a flood of them does not keep control from being lost.
                () = sleep_until(due) => self.time_has_come().await,
                heard = socket.recv_from(&mut buffer) => {
                    // Errors of earlier answers (nobody listens) come back here and mean nothing.
                    if let Ok((count, SocketAddr::V4(client))) = heard {
                        self.hear(client, &buffer[..count]).await;
                    }
                }
            }
        }
    }

    fn now_ns(&self) -> u64 {
        let since_reset = self.clock.raw_ns().wrapping_sub(self.flags.clock_zero_ns.load(Ordering::Relaxed));
        since_reset.wrapping_add_signed(self.flags.clock_error_ns.load(Ordering::Relaxed))
    }

    async fn hear(&mut self, client: SocketAddrV4, bytes: &[u8]) {
        if self.silent_until.is_some_and(|until| Instant::now() < until) {
            return;
        }
        let Some(request) = Request::parse(bytes) else { return };
        self.outlet.stats.note(|stats| stats.commands += 1);
        self.heartbeat(client);
        if let Ok(Command::PacketResend { channel, range }) = request.command {
            self.resend(client, channel, range).await;
            return;
        }
        if self.answered_before(client, &request, bytes).await {
            return;
        }
        self.remember(client, bytes);
        match &request.command {
            Ok(command) => self.obey(client, &request, command.clone()).await,
            Err(status) => self.acknowledge(client, &request, *status, &[]).await,
        }
    }

    /// Whether the command is a repetition; then the old answer was sent again.
    async fn answered_before(&mut self, client: SocketAddrV4, request: &Request, bytes: &[u8]) -> bool {
        self.heard.retain(|heard| heard.at.elapsed() < REPEAT || heard.answer.is_none());
        let same = |heard: &&Heard| heard.client == client && heard.request == bytes;
        let Some(heard) = self.heard.iter().find(same) else { return false };
        let answer = heard.answer.clone();
        self.outlet.stats.note(|stats| stats.repeated += 1);
        match answer {
            Some(answer) => self.send(client, answer).await,
            None => self.send_pending(client, request.id).await,
        }
        true
    }

    fn remember(&mut self, client: SocketAddrV4, bytes: &[u8]) {
        // A command that is still being carried out stays known beside the client's next one.
        self.heard.retain(|heard| heard.client != client || heard.answer.is_none());
        if self.heard.len() >= CLIENTS_MAX {
            self.heard.pop_front();
        }
        self.heard.push_back(Heard { client, request: bytes.to_vec(), answer: None, at: Instant::now() });
    }

    async fn obey(&mut self, client: SocketAddrV4, request: &Request, command: Command) {
        let now_ns = self.now_ns();
        match command {
            Command::Discovery => {
                let answer = self.device.discovery().to_vec();
                debug_assert_eq!(answer.len(), usize::from(DISCOVERY_BYTES));
                self.acknowledge(client, request, Status::Success, &answer).await;
            }
            Command::ReadRegister(addresses) => {
                let mut payload = Vec::with_capacity(4 * addresses.len());
                let mut status = Status::Success;
                for address in addresses {
                    match self.device.read(client, address, 4, now_ns) {
                        Ok(bytes) => payload.extend(bytes),
                        Err(error) => {
                            self.note_refusal(client, "read", address, error);
                            status = error;
                            break;
                        }
                    }
                }
                self.acknowledge(client, request, status, &payload).await;
            }
            Command::ReadMemory { address, count } => {
                match self.device.read(client, address, u32::from(count), now_ns) {
                    Ok(bytes) => {
                        let payload = [&address.to_be_bytes()[..], &bytes].concat();
                        debug_assert!(payload.len() <= PAYLOAD_BYTES_MAX);
                        self.acknowledge(client, request, Status::Success, &payload).await;
                    }
                    Err(status) => {
                        self.note_refusal(client, "read", address, status);
                        self.acknowledge(client, request, status, &[]).await;
                    }
                }
            }
            Command::WriteRegister(pairs) => {
                let writes =
                    pairs.into_iter().map(|(address, value)| (address, value.to_be_bytes().to_vec()));
                self.write(client, request, writes.collect()).await;
            }
            Command::WriteMemory { address, bytes } => {
                self.write(client, request, vec![(address, bytes)]).await;
            }
            Command::ForceIp | Command::PacketResend { .. } | Command::Unknown => {
                self.acknowledge(client, request, Status::NotImplemented, &[]).await;
            }
        }
    }

    /// Writes in order up to the first refusal, then carries out what follows from those that were taken.
    async fn write(&mut self, client: SocketAddrV4, request: &Request, writes: Vec<(u32, Vec<u8>)>) {
        let mut status = Status::Success;
        let mut done = 0_u16;
        let mut effects = Vec::new();
        let memory = matches!(request.command, Ok(Command::WriteMemory { .. }));
        for (address, bytes) in writes {
            match self.write_one(client, address, &bytes) {
                Ok(effect) => effects.extend(effect),
                Err(error) => {
                    let first = &bytes[..bytes.len().min(8)];
                    self.note_refusal(client, &format!("write of {first:02X?} to"), address, error);
                    status = error;
                    break;
                }
            }
            done += if memory { u16::try_from(bytes.len()).unwrap_or(u16::MAX) } else { 1 };
        }
        let [high, low] = done.to_be_bytes();
        let payload = [0, 0, high, low];
        if effects.contains(&Effect::Reset) {
            // Acknowledged first: afterwards it is silent.
            self.acknowledge(client, request, status, &payload).await;
            self.order(Act::Stop).await;
            self.restart(RESET_SILENCE);
            return;
        }
        let mut acts = VecDeque::new();
        for effect in effects {
            acts.extend(self.carry_out(effect).await);
        }
        if acts.is_empty() {
            self.acknowledge(client, request, status, &payload).await;
        } else {
            self.pending = Some(Pending {
                client,
                number: request.number,
                id: request.id,
                acknowledge: request.acknowledge,
                payload: payload.to_vec(),
                status,
                acts,
                notice: Instant::now() + PENDING_FIRST,
            });
        }
    }

    fn note_refusal(&self, client: SocketAddrV4, act: &str, address: u32, status: Status) {
        (self.log)(&format!("camera on the network: {client}: {act} 0x{address:08X}: {status:?}"));
    }

    fn write_one(
        &mut self,
        client: SocketAddrV4,
        address: u32,
        bytes: &[u8],
    ) -> Result<Option<Effect>, Status> {
        if self.outlet.faults.has(&GigeFault::AccessDenied) {
            return Err(Status::AccessDenied);
        }
        if self.pending.is_some() && self.device.controller() == Some(client) {
            return Err(Status::Busy);
        }
        let effect = self.device.write(client, address, bytes, self.now_ns())?;
        if self.control_since.is_none() && self.device.controller().is_some() {
            self.control_since = Some(Instant::now());
            self.heartbeat(client);
        }
        if self.device.controller() == Some(client) && self.heartbeat_due.is_some() {
            // The timeout itself may have been written.
            self.heartbeat(client);
        }
        Ok(effect)
    }

    /// Does what follows from a write; what takes time is ordered and handed back.
    async fn carry_out(&mut self, effect: Effect) -> Option<oneshot::Receiver<Result<Outcome, String>>> {
        match effect {
            Effect::Start => self.order(Act::Start(Box::new(self.device.plan()))).await,
            Effect::Stop if !self.device.acquiring() => None,
            Effect::Stop => self.order(Act::Stop).await,
            Effect::Shutter(closed) => self.order(Act::Shutter(closed)).await,
            Effect::Correct => self.order(Act::Correct).await,
            Effect::Trigger => {
                if self.device.acquiring() && self.device.trigger() == Trigger::Software {
                    self.pulser.fire();
                } else {
                    self.outlet.stats.note(|stats| stats.triggers_missed += 1);
                }
                None
            }
            Effect::Released => {
                self.control_is_free().await;
                None
            }
            Effect::TestPacket(size) => {
                if let Some(to) = self.device.plan().destination {
                    // A packet that is too long for the way does not arrive: that is the answer.
                    let _ = self.outlet.socket.send_to(&gvsp::test_packet(size), to).await;
                    self.outlet.stats.note(|stats| stats.test_packets += 1);
                }
                None
            }
            Effect::Spoil => {
                self.flags.spoiled.store(true, Ordering::Relaxed);
                self.outlet.stats.note(|stats| stats.spoilings += 1);
                (self.log)("camera on the network: the factory gain has been overwritten");
                None
            }
            Effect::ClockReset => {
                self.flags.clock_zero_ns.store(self.clock.raw_ns(), Ordering::Relaxed);
                None
            }
            Effect::Reset => None,
        }
    }

    async fn order(&self, act: Act) -> Option<oneshot::Receiver<Result<Outcome, String>>> {
        let (done, receiver) = oneshot::channel();
        // A dead stream's side drops `done`, and the receiver says so.
        let _ = self.orders.send(Order { act, done }).await;
        Some(receiver)
    }

    async fn act_done(&mut self, done: Option<Result<Outcome, String>>) {
        let now_ns = self.now_ns();
        let result = done.unwrap_or_else(|| Err("the camera's task has died".to_owned()));
        let failed = match result {
            Ok(Outcome::Started(taken, run)) => {
                self.device.set_integration(taken.integration_s);
                let owner = self.pending.as_ref().map(|pending| pending.client);
                if owner.is_some() && self.device.controller() == owner {
                    // A stream of few frames may have ended before this is heard.
                    self.run = run;
                    self.device.set_acquiring(run > self.run_ended, now_ns);
                } else {
                    // Control was lost meanwhile: nobody wants this stream.
                    self.order(Act::Stop).await;
                }
                false
            }
            Ok(Outcome::Stopped) => {
                self.device.set_acquiring(false, now_ns);
                false
            }
            Ok(Outcome::Shutter(closed, temperature)) => {
                self.device.set_shutter(closed, temperature.map(celsius));
                false
            }
            Ok(Outcome::Corrected) => {
                self.device.set_shutter(false, None);
                false
            }
            Err(why) => {
                (self.log)(&format!("camera on the network: {why}"));
                true
            }
        };
        let Some(pending) = &mut self.pending else { return };
        pending.acts.pop_front();
        if failed {
            pending.status = Status::Error;
        }
        if !pending.acts.is_empty() {
            return;
        }
        if let Some(pending) = self.pending.take() {
            let answer = gvcp::acknowledge(pending.status, pending.number, pending.id, &pending.payload);
            self.answer(pending.client, pending.acknowledge, pending.status, answer).await;
        }
    }

    fn take_report(&mut self, report: Report) {
        match report {
            Report::Ended(run) => {
                self.run_ended = run;
                if run == self.run {
                    self.device.set_acquiring(false, self.now_ns());
                }
            }
            Report::Restart(silence) => self.restart(silence),
        }
    }

    /// Everything as after switching on; nothing is heard for `silence`.
    fn restart(&mut self, silence: Duration) {
        self.device.power_on(self.now_ns());
        self.heard.clear();
        self.pending = None;
        self.ring.clear();
        (self.control_since, self.heartbeat_due) = (None, None);
        self.silent_until = Some(Instant::now() + silence);
        self.outlet.stats.note(|stats| stats.restarts += 1);
        (self.log)("camera on the network: restarting");
    }

    /// A command of the owner counts as a heartbeat.
    fn heartbeat(&mut self, client: SocketAddrV4) {
        if self.device.controller() != Some(client) {
            return;
        }
        let held = self.control_since.map(|since| since.elapsed()).unwrap_or_default();
        let ignored = self.outlet.faults.heartbeat_ignored().is_some_and(|after| held >= after);
        if ignored && self.heartbeat_due.is_some() {
            return;
        }
        let timeout = self.device.heartbeat_ms().map(|ms| Duration::from_millis(u64::from(ms)));
        self.heartbeat_due = timeout.map(|timeout| Instant::now() + timeout);
    }

    async fn time_has_come(&mut self) {
        let now = Instant::now();
        if let Some(pending) = &mut self.pending
            && pending.notice <= now
        {
            pending.notice = now + PENDING_EVERY;
            let (client, id) = (pending.client, pending.id);
            self.send_pending(client, id).await;
        }
        if self.heartbeat_due.is_some_and(|due| due <= now) {
            self.device.release();
            self.outlet.stats.note(|stats| stats.control_lost += 1);
            (self.log)("camera on the network: control lost: no heartbeat");
            self.control_is_free().await;
        }
    }

    /// Nobody has control any more: the stream ends.
    async fn control_is_free(&mut self) {
        (self.control_since, self.heartbeat_due) = (None, None);
        if self.device.acquiring() {
            self.device.set_acquiring(false, self.now_ns());
            self.order(Act::Stop).await;
        }
    }

    async fn resend(&mut self, client: SocketAddrV4, channel: u16, range: ResendRange) {
        self.outlet.stats.note(|stats| stats.resend_requests += 1);
        // Aravis asks from the stream's socket: the address must be the owner's, the port need not.
        let owner = self.device.controller().map(|owner| *owner.ip());
        if channel != 0 || range.last < range.first || owner != Some(*client.ip()) {
            return;
        }
        let (Some(to), ids) = (self.device.plan().destination, self.device.ids()) else { return };
        if self.outlet.faults.has(&GigeFault::ResendIgnored) {
            return;
        }
        if self.outlet.faults.has(&GigeFault::ResendRefused) {
            self.outlet.refuse_resend(range, ids, to).await;
        } else {
            self.outlet.resend(&self.ring, range, ids, to).await;
        }
    }

    async fn acknowledge(&mut self, client: SocketAddrV4, request: &Request, status: Status, payload: &[u8]) {
        let answer = gvcp::acknowledge(status, request.number, request.id, payload);
        self.answer(client, request.acknowledge, status, answer).await;
    }

    async fn answer(&mut self, client: SocketAddrV4, wanted: bool, status: Status, answer: Vec<u8>) {
        if status != Status::Success {
            self.outlet.stats.note(|stats| stats.refused += 1);
        }
        if !wanted {
            self.heard.retain(|heard| heard.client != client || !heard.has_id_of(&answer));
            return;
        }
        let asked = |heard: &&mut Heard| heard.client == client && heard.has_id_of(&answer);
        if let Some(heard) = self.heard.iter_mut().rev().find(asked) {
            heard.answer = Some(answer.clone());
            heard.at = Instant::now();
        }
        self.send(client, answer).await;
    }

    async fn send_pending(&mut self, client: SocketAddrV4, id: u16) {
        self.outlet.stats.note(|stats| stats.pending += 1);
        // One that the system does not take is repeated.
        let _ = self.socket.send_to(&gvcp::pending(id, PENDING_MS), client).await;
    }

    async fn send(&mut self, client: SocketAddrV4, answer: Vec<u8>) {
        self.acknowledges += 1;
        match self.outlet.faults.answer(self.acknowledges) {
            None => self.outlet.stats.note(|stats| stats.answers_lost += 1),
            Some(Duration::ZERO) => {
                // A client that has gone does not matter any more.
                let _ = self.socket.send_to(&answer, client).await;
                self.outlet.stats.note(|stats| stats.answers += 1);
            }
            Some(delay) => {
                let sent = self.outlet.late.send(&self.socket, answer, client.into(), delay);
                self.outlet.stats.note(|stats| {
                    stats.answers += u64::from(sent);
                    stats.answers_late += u64::from(sent);
                    stats.answers_lost += u64::from(!sent);
                });
            }
        }
    }
}

/// The result of the next act that is being waited for; never when there is none. May be dropped without losing
/// anything.
async fn next_done(pending: &mut Option<Pending>) -> Option<Result<Outcome, String>> {
    match pending.as_mut().and_then(|pending| pending.acts.front_mut()) {
        Some(act) => act.await.ok(),
        None => std::future::pending().await,
    }
}

fn celsius(temperature: Kelvin) -> f64 {
    temperature.0 - 273.15
}
