//! The instrument's side of a Quantum Composers 9520 / BNC 575 pulse generator: its answers and its running clock.
//!
//! Same codec as the driver, same manual (Operator's Manual v5.9, chapter 7; "System and Channel Modes"). The clock does
//! not tick through idle pulses: it computes the next one with an active output and sleeps until then, so that a
//! pause of a campaign costs nothing. Widths and delays are numbers in a [`Pulse`], never sleeps.

use crate::rig::line::{Line, LineFault, Unsent, check_seconds};
use crate::rig::pulse::Pulse;
use ditd_drivers::instrument::Identity;
use ditd_drivers::quantum_9520::{
    Act, CAMERA_CHANNEL, Command, INJECTOR_CHANNEL, Key, Kind, Reply, UnitError, Value, belongs_to, kind,
    needs_channel,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc::{self, Permit};
use tokio::time::{Instant, sleep_until};

/// Channels of the largest model: A to H.
const CHANNELS: u32 = 8;

/// Stretches of pulses that may wait to be sent; each command during a run begins one. Beyond, commands are refused
/// as unavailable: it takes a consumer that has stood still through so many commands.
const STRETCHES_MAX: usize = 64;

const PS_PER_NS: i64 = 1000;

/// What a trigger unit does wrong, besides its line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum TriggerFault {
    /// One trigger of the camera is missing.
    DropsCameraPulse {
        /// Which, counted from 0 over the unit's whole life.
        pulse: u64,
    },
    /// The unit says that it runs, and nothing leaves its outputs.
    DropsAllPulses {
        /// Since when, in seconds of the rig's clock.
        from_s: f64,
    },
    /// A command is answered by an error.
    Refuses {
        /// Start of the command in the manual's spelling, such as `:PULSE2:STATE 1`.
        command: String,
        /// The answer.
        error: UnitError,
    },
    /// A command that sets something is answered by `ok` and not obeyed.
    Ignores {
        /// Start of the command in the manual's spelling.
        command: String,
    },
}

/// What a trigger unit is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantumBehaviour {
    /// Time of one command, in seconds.
    #[serde(default = "QuantumBehaviour::command_s")]
    pub command_s: f64,
    /// Time from the start of the rig's clock until the unit has booted, in seconds.
    #[serde(default)]
    pub boot_s: f64,
    /// It was left with its echo on.
    #[serde(default)]
    pub echo: bool,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub line_faults: Vec<LineFault>,
    /// What else goes wrong; nothing when absent.
    #[serde(default)]
    pub faults: Vec<TriggerFault>,
}

impl QuantumBehaviour {
    /// A unit as delivered, booted.
    pub fn delivered() -> Self {
        Self {
            command_s: Self::command_s(),
            boot_s: 0.0,
            echo: false,
            line_faults: Vec::new(),
            faults: Vec::new(),
        }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_seconds("command_s", self.command_s)?;
        check_seconds("boot_s", self.boot_s)?;
        self.line_faults.iter().try_for_each(LineFault::check)?;
        self.faults.iter().try_for_each(|fault| match fault {
            TriggerFault::DropsAllPulses { from_s } => check_seconds("from_s", *from_s),
            _ => Ok(()),
        })
    }

    /// Manual, chapter 7: about 10 ms a command. The driver leaves 10 ms after each answer besides.
    fn command_s() -> f64 {
        0.010
    }
}

/// Answers on a stream and sends the pulses of a running clock. `start` is the zero of the rig's clock.
///
/// When `pulses` is full the clock's next pulse waits, with its time unchanged, and commands are answered all the
/// same. When the other side of the stream has gone, a running burst goes on to its end, as a real one does. Ends when
/// both have ended.
///
/// # Panics
/// When the behaviour fails its check.
pub async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    pulses: mpsc::Sender<Pulse>,
    behaviour: QuantumBehaviour,
    start: Instant,
) {
    assert_eq!(behaviour.check(), Ok(()), "the behaviour was checked where it was read");
    let command_time = Duration::from_secs_f64(behaviour.command_s);
    // Commands sent too fast "may cause the unit to not respond properly": the earlier answer is lost.
    let mut line = Line::new(stream, behaviour.line_faults.clone(), Unsent::Lost, start);
    let mut unit = Unit::new(behaviour);
    let mut line_open = true;
    loop {
        let next = unit.next_pulse().filter(|_| !pulses.is_closed());
        if !line_open && next.is_none() {
            return;
        }
        let due = next.map_or(start, |pulse| start + Duration::from_nanos(pulse.at_ns));
        tokio::select! {
            biased;
            command = line.next_command(), if line_open => match command {
                None => line_open = false,
                Some(command) => {
                    let now_ns = nanoseconds(start.elapsed());
                    if let Some(answer) = unit.answer(command.as_deref().unwrap_or("garbage"), now_ns) {
                        line.reply(&answer, command_time);
                    }
                }
            },
            permit = permit_at(due, &pulses), if next.is_some() => {
                if let (Some(permit), Some(pulse)) = (permit, next) {
                    permit.send(pulse);
                    unit.note_sent(pulse);
                }
            }
        }
    }
}

/// A place in the channel once the time has come; `None` when nobody takes pulses any more.
async fn permit_at(due: Instant, pulses: &mpsc::Sender<Pulse>) -> Option<Permit<'_, Pulse>> {
    sleep_until(due).await;
    pulses.reserve().await.ok()
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).expect("a rig runs for less than 584 years")
}

// ---------------------------------------------------------------------------------------------------- clock

/// How often a mode lets pulses through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Normal,
    Single,
    Burst(u64),
    DutyCycle { on: u64, off: u64 },
}

/// The output of one channel.
#[derive(Debug, Clone, Copy)]
struct Output {
    on: bool,
    mode: Mode,
    wait: u64,
    /// Clock pulse from which it counts.
    from: u64,
    delay_ns: u64,
    width_ns: u64,
}

impl Output {
    /// The first clock pulse from `index` on in which it is active.
    fn next_active(&self, index: u64) -> Option<u64> {
        let first = self.from + self.wait;
        let index = index.max(first);
        let count = index - first;
        let is_in = match self.mode {
            Mode::Normal => true,
            Mode::Single => count == 0,
            Mode::Burst(burst) => count < burst,
            Mode::DutyCycle { on, off } => {
                let place = count % (on + off);
                let next = if place < on { index } else { index + on + off - place };
                return self.on.then_some(next);
            }
        };
        (self.on && is_in).then_some(index)
    }

    fn at(&self, index: u64) -> Option<(u64, u64)> {
        (self.next_active(index) == Some(index)).then_some((self.delay_ns, self.width_ns))
    }

    fn fires_once(&self) -> bool {
        matches!(self.mode, Mode::Single | Mode::Burst(_))
    }
}

/// A stretch of clock pulses during which no setting changes.
#[derive(Debug, Clone)]
struct Stretch {
    /// Time of the clock pulse `from`.
    base_ns: u64,
    period_ns: u64,
    /// The clock's own duty cycle: pulses on, pulses off.
    on: u64,
    off: u64,
    from: u64,
    /// One past the last pulse.
    end: Option<u64>,
    next: u64,
    camera: Output,
    injector: Output,
}

impl Stretch {
    /// The period in which a pulse comes: off pulses of the clock are skipped.
    fn slot(&self, index: u64) -> u64 {
        index / self.on * (self.on + self.off) + index % self.on
    }

    fn time_ns(&self, index: u64) -> u64 {
        self.base_ns + (self.slot(index) - self.slot(self.from)) * self.period_ns
    }

    /// The first pulse later than `now_ns`.
    fn first_after(&self, now_ns: u64) -> u64 {
        let Some(since_ns) = now_ns.checked_sub(self.base_ns) else { return self.from };
        let slot = self.slot(self.from) + since_ns / self.period_ns + 1;
        let cycle = self.on + self.off;
        slot / cycle * self.on + (slot % cycle).min(self.on)
    }

    fn is_over(&self, now_ns: u64) -> bool {
        self.end.is_some_and(|end| now_ns >= self.time_ns(end))
    }

    fn next_pulse(&self) -> Option<Pulse> {
        let camera = self.camera.next_active(self.next);
        let injector = self.injector.next_active(self.next);
        let index = camera.into_iter().chain(injector).min()?;
        (self.end.is_none_or(|end| index < end)).then(|| Pulse {
            t0_index: index,
            at_ns: self.time_ns(index),
            camera: self.camera.at(index),
            injector: self.injector.at(index),
        })
    }
}

// ----------------------------------------------------------------------------------------------------- unit

type Memory = BTreeMap<(u32, Key), Value>;

/// What the clock does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Stopped,
    /// `STATE 1` with a trigger mode: waits for triggers; the next pulse has this number.
    Armed(u64),
    /// The last stretch runs, until its end or a stop.
    Running,
}

struct Unit {
    behaviour: QuantumBehaviour,
    locked_up: bool,
    memory: Memory,
    stores: BTreeMap<u64, Memory>,
    selected: u32,
    label: String,
    state: State,
    stretches: VecDeque<Stretch>,
    /// Clock pulse from which a channel counts, and whether a channel that fires once may still fire.
    armed_from: [(u64, bool); 2],
    triggers: u64,
    camera_pulses: u64,
}

impl Unit {
    fn new(behaviour: QuantumBehaviour) -> Self {
        let mut memory = delivered();
        memory.insert((0, Key::Echo), Value::Flag(behaviour.echo));
        Self {
            behaviour,
            locked_up: false,
            memory,
            stores: BTreeMap::new(),
            selected: 1,
            label: String::new(),
            state: State::Stopped,
            stretches: VecDeque::new(),
            armed_from: [(0, true); 2],
            triggers: 0,
            camera_pulses: 0,
        }
    }

    /// The answer to a line, its echo included; `None` while it boots or is locked up.
    #[expect(clippy::cast_precision_loss, reason = "a boot time needs no nanoseconds")]
    fn answer(&mut self, line: &str, now_ns: u64) -> Option<String> {
        if (now_ns as f64) < self.behaviour.boot_s * 1e9 {
            self.locked_up |= line.trim_start().starts_with('*');
            return None;
        }
        if self.locked_up {
            return None;
        }
        let echo = if self.flag(0, Key::Echo) { format!("{line}\r\n") } else { String::new() };
        let (reply, key) = match Command::decode(line) {
            Ok(command) => (self.obey(&command, now_ns), command.key),
            Err(error) => (Reply::Failed(error), Key::Label),
        };
        Some(format!("{echo}{}\r\n", reply.encode(key)))
    }

    fn obey(&mut self, command: &Command, now_ns: u64) -> Reply {
        let spelled = command.encode();
        let is_set = matches!(command.act, Act::Set(_));
        let starts = |prefix: &String| {
            spelled.get(..prefix.len()).is_some_and(|start| start.eq_ignore_ascii_case(prefix))
        };
        for fault in &self.behaviour.faults {
            match fault {
                TriggerFault::Refuses { command, error } if starts(command) => return Reply::Failed(*error),
                TriggerFault::Ignores { command: told } if is_set && starts(told) => return Reply::Done,
                _ => {}
            }
        }
        let channel = match (needs_channel(command.key), command.channel) {
            (false, _) => 0,
            (true, number) => number.unwrap_or(self.selected),
        };
        if needs_channel(command.key) && (channel > CHANNELS || !belongs_to(command.key, channel)) {
            return Reply::Failed(UnitError::Keyword);
        }
        let gated = matches!(command.key, Key::ChannelGate | Key::ChannelLogic);
        if gated && self.memory.get(&(0, Key::GateMode)) != Some(&Value::Word("CHAN".to_owned())) {
            return Reply::Failed(UnitError::Unavailable);
        }
        if let Some(number) = command.channel {
            self.selected = number;
        }
        let done = match &command.act {
            Act::Query(word) => self.read(channel, command.key, word.as_deref(), now_ns).map(Reply::Value),
            Act::Set(value) => self.write(channel, command.key, value.as_ref(), now_ns).map(|()| Reply::Done),
        };
        done.unwrap_or_else(Reply::Failed)
    }

    fn read(&self, channel: u32, key: Key, word: Option<&str>, now_ns: u64) -> Result<Value, UnitError> {
        let text = |text: String| Ok(Value::Text(text));
        match key {
            Key::Identity => {
                let identity = Identity {
                    maker: "QC".to_owned(),
                    model: "9528".to_owned(),
                    serial: "10123".to_owned(),
                    firmware: "5.9".to_owned(),
                };
                text(format!(
                    "{},{},{},{}",
                    identity.maker, identity.model, identity.serial, identity.firmware
                ))
            }
            Key::Catalogue => text((0..=CHANNELS).map(channel_name).collect::<Vec<_>>().join(",")),
            Key::FullCatalogue => text(
                (0..=CHANNELS)
                    .map(|number| format!("{},{number}", channel_name(number)))
                    .collect::<Vec<_>>()
                    .join(","),
            ),
            Key::SelectNumber => Ok(Value::Count(u64::from(self.selected))),
            Key::SelectName => Ok(Value::Word(channel_name(self.selected))),
            Key::InstrumentState => self.read(self.selected, Key::State, None, now_ns),
            Key::Label => text(self.label.clone()),
            Key::State if channel == 0 => Ok(Value::Flag(self.is_on(now_ns))),
            Key::Running => Ok(Value::Flag(self.is_on(now_ns))),
            Key::CounterCount => match word {
                Some(word) if word.eq_ignore_ascii_case("TCNTS") => text(self.triggers.to_string()),
                Some(_) => Err(UnitError::Parameter),
                None => Err(UnitError::MissingParameter),
            },
            Key::Version => text("5.9".to_owned()),
            Key::SerialNumber => text("10123".to_owned()),
            Key::Information => text("9528 simulated".to_owned()),
            _ => self.memory.get(&(channel, key)).cloned().ok_or(UnitError::NoQuery),
        }
    }

    fn write(&mut self, channel: u32, key: Key, value: Option<&Value>, now_ns: u64) -> Result<(), UnitError> {
        match (key, value) {
            (Key::Reset, _) => {
                self.stop(now_ns);
                self.memory = delivered();
            }
            (Key::Trigger, _) => return self.trigger(now_ns),
            (Key::Arm, _) => return self.arm(now_ns),
            (Key::Save, Some(Value::Count(slot))) => {
                self.stores.insert(*slot, self.memory.clone());
            }
            (Key::Recall, Some(Value::Count(slot))) => {
                let memory = if *slot == 0 { Some(delivered()) } else { self.stores.get(slot).cloned() };
                self.memory = memory.ok_or(UnitError::Unavailable)?;
                self.begin_stretch(now_ns)?;
            }
            (Key::Label, Some(Value::Text(text))) => self.label.clone_from(text),
            (Key::SelectNumber, Some(Value::Count(number))) => {
                self.selected = u32::try_from(*number).map_err(|_| UnitError::Parameter)?;
            }
            (Key::SelectName, Some(Value::Word(word))) => {
                let found = (0..=CHANNELS).find(|number| channel_name(*number) == *word);
                self.selected = found.ok_or(UnitError::Parameter)?;
            }
            (Key::InstrumentState, _) => return self.write(self.selected, Key::State, value, now_ns),
            (Key::State, Some(Value::Flag(on))) if channel == 0 => match (on, self.is_on(now_ns)) {
                (true, false) => self.start(now_ns)?,
                (false, _) => self.stop(now_ns),
                (true, true) => {}
            },
            (Key::CounterClear, _) => self.triggers = 0,
            (_, Some(value)) => {
                self.memory.insert((channel, key), on_grid(key, value.clone()));
                self.begin_stretch(now_ns)?;
            }
            (_, None) => return Err(UnitError::MissingParameter),
        }
        Ok(())
    }

    fn is_on(&self, now_ns: u64) -> bool {
        match self.state {
            State::Stopped => false,
            State::Armed(_) => true,
            State::Running => self.stretches.back().is_some_and(|stretch| !stretch.is_over(now_ns)),
        }
    }

    fn start(&mut self, now_ns: u64) -> Result<(), UnitError> {
        self.retire();
        // A new run counts from its own first pulse.
        self.armed_from = self.armed_from.map(|(_, may_fire)| (0, may_fire));
        if self.is_triggered() {
            self.state = State::Armed(0);
            return Ok(());
        }
        let end = match self.mode(0, Key::Mode) {
            Mode::Single => Some(1),
            Mode::Burst(count) => Some(count),
            Mode::Normal | Mode::DutyCycle { .. } => None,
        };
        self.push_stretch(now_ns, 0, end)?;
        self.state = State::Running;
        Ok(())
    }

    /// Pulses up to this moment are made, later ones not.
    fn stop(&mut self, now_ns: u64) {
        self.cut(now_ns);
        self.retire();
        self.state = State::Stopped;
    }

    /// A software trigger: the same as an external one.
    fn trigger(&mut self, now_ns: u64) -> Result<(), UnitError> {
        let State::Armed(next) = self.state else { return Err(UnitError::Unavailable) };
        self.triggers += u64::from(self.flag(0, Key::CounterState));
        if self.stretches.back().is_some_and(|stretch| !stretch.is_over(now_ns)) {
            // A trigger during a burst is overlooked.
            return Ok(());
        }
        let (count, stays_armed) = match self.mode(0, Key::Mode) {
            Mode::Normal | Mode::DutyCycle { .. } => (1, true),
            Mode::Single => (1, false),
            Mode::Burst(count) => (count, true),
        };
        self.push_stretch(now_ns, next, Some(next + count))?;
        self.state = if stays_armed { State::Armed(next + count) } else { State::Running };
        Ok(())
    }

    /// Channels that fire once may fire again, counting from the next clock pulse.
    fn arm(&mut self, now_ns: u64) -> Result<(), UnitError> {
        let next = self.stretches.back().map_or(0, |stretch| stretch.first_after(now_ns));
        let next = if self.is_on(now_ns) { next } else { 0 };
        self.armed_from = self.armed_from.map(|_| (next, true));
        self.begin_stretch(now_ns)
    }

    /// A setting has changed: the pulses to come follow the new one.
    fn begin_stretch(&mut self, now_ns: u64) -> Result<(), UnitError> {
        let Some(last) = self.stretches.back().filter(|stretch| !stretch.is_over(now_ns)) else {
            return Ok(());
        };
        if self.state == State::Stopped {
            return Ok(());
        }
        let index = last.first_after(now_ns);
        let (base_ns, end) = (last.time_ns(index), last.end);
        if end.is_some_and(|end| index >= end) {
            return Ok(());
        }
        self.push_stretch(base_ns, index, end)?;
        let stretches = self.stretches.len();
        self.stretches[stretches - 2].end = Some(index);
        Ok(())
    }

    fn push_stretch(&mut self, base_ns: u64, from: u64, end: Option<u64>) -> Result<(), UnitError> {
        if self.stretches.len() >= STRETCHES_MAX {
            return Err(UnitError::Unavailable);
        }
        let (on, off) = match self.mode(0, Key::Mode) {
            Mode::DutyCycle { on, off } => (on, off),
            _ => (1, 0),
        };
        self.stretches.push_back(Stretch {
            base_ns,
            period_ns: self.time_ns(0, Key::Period),
            on,
            off,
            from,
            end,
            next: from,
            camera: self.output(CAMERA_CHANNEL, self.armed_from[0]),
            injector: self.output(INJECTOR_CHANNEL, self.armed_from[1]),
        });
        Ok(())
    }

    /// Ends the last stretch at this moment.
    fn cut(&mut self, now_ns: u64) {
        if let Some(last) = self.stretches.back_mut() {
            let index = last.first_after(now_ns);
            last.end = Some(last.end.map_or(index, |end| end.min(index)));
        }
    }

    /// After a run: a channel that fires once and has fired needs `*ARM`.
    fn retire(&mut self) {
        let Some(last) = self.stretches.back() else { return };
        let fired = [&last.camera, &last.injector].map(|output| {
            let first = Output { on: true, ..*output }.next_active(output.from);
            output.on && output.fires_once() && first.is_some_and(|i| last.end.is_none_or(|end| i < end))
        });
        for (armed, fired) in self.armed_from.iter_mut().zip(fired) {
            armed.1 &= !fired;
        }
    }

    /// The next pulse to send, with what the faults leave of it.
    fn next_pulse(&mut self) -> Option<Pulse> {
        loop {
            let next = self.stretches.front()?.next_pulse();
            let Some(mut pulse) = next.filter(|pulse| !self.is_mute(pulse.at_ns)) else {
                // The last one of a run stays: it knows the time.
                if self.stretches.len() > 1 || self.state == State::Stopped {
                    self.stretches.pop_front();
                    continue;
                }
                return None;
            };
            if self.is_dropped(&pulse) {
                pulse.camera = None;
            }
            if pulse.camera.is_none() && pulse.injector.is_none() {
                self.note_sent(pulse);
                continue;
            }
            return Some(pulse);
        }
    }

    /// Goes on to the pulse after this one.
    fn note_sent(&mut self, pulse: Pulse) {
        if let Some(front) = self.stretches.front_mut() {
            // Counted by the channel's output, whether or not a fault has taken the pulse away.
            self.camera_pulses += u64::from(front.camera.at(pulse.t0_index).is_some());
            front.next = pulse.t0_index + 1;
        }
    }

    fn is_dropped(&self, pulse: &Pulse) -> bool {
        pulse.camera.is_some()
            && self.behaviour.faults.iter().any(
                |fault| matches!(fault, TriggerFault::DropsCameraPulse { pulse } if *pulse == self.camera_pulses),
            )
    }

    #[expect(clippy::cast_precision_loss, reason = "the start of a fault needs no nanoseconds")]
    fn is_mute(&self, at_ns: u64) -> bool {
        let at_s = at_ns as f64 * 1e-9;
        self.behaviour
            .faults
            .iter()
            .any(|fault| matches!(fault, TriggerFault::DropsAllPulses { from_s } if *from_s <= at_s))
    }

    fn output(&self, channel: u32, (from, may_fire): (u64, bool)) -> Output {
        let mode = self.mode(channel, Key::ChannelMode);
        let once = matches!(mode, Mode::Single | Mode::Burst(_));
        Output {
            on: self.flag(channel, Key::State) && (may_fire || !once),
            mode,
            wait: self.count(channel, Key::WaitCount),
            from,
            delay_ns: self.time_ns(channel, Key::Delay),
            width_ns: self.time_ns(channel, Key::Width),
        }
    }

    fn is_triggered(&self) -> bool {
        self.memory.get(&(0, Key::TriggerMode)) != Some(&Value::Word("DIS".to_owned()))
    }

    fn mode(&self, channel: u32, key: Key) -> Mode {
        match self.memory.get(&(channel, key)) {
            Some(Value::Word(word)) if word == "SING" => Mode::Single,
            Some(Value::Word(word)) if word == "BURS" => Mode::Burst(self.count(channel, Key::BurstCount)),
            Some(Value::Word(word)) if word == "DCYC" => Mode::DutyCycle {
                on: self.count(channel, Key::OnCount),
                off: self.count(channel, Key::OffCount),
            },
            _ => Mode::Normal,
        }
    }

    fn flag(&self, channel: u32, key: Key) -> bool {
        self.memory.get(&(channel, key)) == Some(&Value::Flag(true))
    }

    fn count(&self, channel: u32, key: Key) -> u64 {
        match self.memory.get(&(channel, key)) {
            Some(Value::Count(count)) => *count,
            _ => 0,
        }
    }

    /// A time in nanoseconds; a pulse that begins before its clock pulse counts as beginning with it.
    fn time_ns(&self, channel: u32, key: Key) -> u64 {
        match self.memory.get(&(channel, key)) {
            Some(Value::Time(ps)) => u64::try_from(ps / PS_PER_NS).unwrap_or(0),
            _ => 0,
        }
    }
}

/// Rounds to the unit's grid: 10 ns for the period, 250 ps for width and delay (manual, specifications).
fn on_grid(key: Key, value: Value) -> Value {
    match (key, value) {
        (Key::Period, Value::Time(ps)) => Value::Time(ps / 10_000 * 10_000),
        (_, Value::Time(ps)) => Value::Time(ps / 250 * 250),
        (_, value) => value,
    }
}

fn channel_name(number: u32) -> String {
    match number {
        0 => "T0".to_owned(),
        _ => format!("CH{}", char::from(b'A' + u8::try_from(number - 1).unwrap_or(25).min(25))),
    }
}

/// All settings after `*RST`.
fn delivered() -> Memory {
    let word = |text: &str| Value::Word(text.to_owned());
    let mut memory = Memory::new();
    let clock = [
        (Key::Period, Value::Time(1_000_000_000)),
        (Key::Mode, word("NORM")),
        (Key::ClockIn, word("SYS")),
        (Key::ClockOut, word("T0")),
        (Key::TriggerMode, word("DIS")),
        (Key::TriggerEdge, word("RIS")),
        (Key::TriggerLevel, Value::Volts(2.5)),
        (Key::GateMode, word("DIS")),
        (Key::GateLogic, word("HIGH")),
        (Key::GateLevel, Value::Volts(2.5)),
        (Key::CounterState, Value::Flag(false)),
        (Key::KeypadLock, Value::Flag(false)),
        (Key::Autoload, Value::Flag(false)),
        (Key::Baud, Value::Count(115_200)),
        (Key::UsbBaud, Value::Count(38_400)),
        (Key::Echo, Value::Flag(false)),
        (Key::Capitals, Value::Flag(false)),
    ];
    memory.extend(clock.map(|(key, value)| ((0, key), value)));
    for channel in 0..=CHANNELS {
        let counts = [Key::BurstCount, Key::OnCount, Key::OffCount];
        memory.extend(counts.map(|key| ((channel, key), Value::Count(1))));
    }
    for channel in 1..=CHANNELS {
        let settings = [
            (Key::State, Value::Flag(false)),
            (Key::Width, Value::Time(1_000_000)),
            (Key::Delay, Value::Time(0)),
            (Key::Sync, word("T0")),
            (Key::Polarity, word("NORM")),
            (Key::OutputMode, word("TTL")),
            (Key::Amplitude, Value::Volts(4.0)),
            (Key::Multiplexer, Value::Count(1 << (channel - 1))),
            (Key::ChannelMode, word("NORM")),
            (Key::WaitCount, Value::Count(0)),
            (Key::ChannelGate, word("DIS")),
            (Key::ChannelLogic, word("HIGH")),
        ];
        memory.extend(settings.map(|(key, value)| ((channel, key), value)));
    }
    assert!(memory.keys().all(|(_, key)| kind(*key) != Kind::Act), "acts are not remembered");
    memory
}

#[cfg(test)]
mod tests {
    use super::*;
    use ditd_drivers::error::DriverError;
    use ditd_drivers::instrument::{ShotKind, ShotProgram, TriggerUnit};
    use ditd_drivers::quantum_9520::Quantum9520;
use ditd_drivers::trigger_limits::TriggerLimits;
    use ditd_drivers::wire::Wire;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
    use tokio::time::{sleep, timeout};

    fn limits() -> TriggerLimits {
        TriggerLimits {
            injector_pulse_max_s: 0.005,
            injection_interval_min_s: 15.0,
            camera_integration_s: 25e-6,
            camera_readout_s: 0.008,
        }
    }

    fn program() -> ShotProgram {
        ShotProgram {
            period_ns: 20_000_000,
            wait_periods: 5,
            warm_up: 2,
            blanks: 4,
            inject: true,
            cycle_periods: 800,
            cycles: 6,
            camera_delay_ns: 2_000_000,
            camera_width_ns: 25_000,
            injector_delay_ns: 500_000,
            injector_width_ns: 1_500_000,
        }
    }

    fn served(behaviour: QuantumBehaviour) -> (DuplexStream, mpsc::Receiver<Pulse>) {
        let (near, far) = duplex(256);
        let (sender, receiver) = mpsc::channel(64);
        tokio::spawn(serve(far, sender, behaviour, Instant::now()));
        (near, receiver)
    }

    fn driven(behaviour: QuantumBehaviour) -> (Quantum9520, mpsc::Receiver<Pulse>) {
        let (near, receiver) = served(behaviour);
        (Quantum9520::new(Wire::over(near, "trigger unit"), limits()), receiver)
    }

    fn with(fault: TriggerFault) -> QuantumBehaviour {
        QuantumBehaviour { faults: vec![fault], ..QuantumBehaviour::delivered() }
    }

    /// Takes pulses until none has come for a whole cycle.
    async fn all(receiver: &mut mpsc::Receiver<Pulse>) -> Vec<Pulse> {
        let mut pulses = Vec::new();
        while let Ok(Some(pulse)) = timeout(Duration::from_secs(60), receiver.recv()).await {
            pulses.push(pulse);
        }
        pulses
    }

    /// The pulses that a program means, from the seam's own definitions.
    fn meant(program: &ShotProgram) -> Vec<(u64, Option<(u64, u64)>)> {
        let injection = Some((program.injector_delay_ns, program.injector_width_ns));
        (0..program.cycles)
            .flat_map(|cycle| (0..program.frames_per_cycle()).map(move |position| (cycle, position)))
            .map(|(cycle, position)| {
                let is_spray = program.kind_at(position) == Some(ShotKind::Spray);
                (program.frame_ns(cycle, position), injection.filter(|_| is_spray))
            })
            .collect()
    }

    fn made(pulses: &[Pulse], program: &ShotProgram) -> Vec<(u64, Option<(u64, u64)>)> {
        let base_ns = pulses[0].at_ns - program.frame_ns(0, 0);
        pulses
            .iter()
            .map(|pulse| {
                assert_eq!(pulse.camera, Some((program.camera_delay_ns, program.camera_width_ns)));
                assert_eq!(pulse.t0_index * program.period_ns, pulse.at_ns - base_ns);
                (pulse.at_ns - base_ns, pulse.injector)
            })
            .collect()
    }

    async fn heard(near: &mut DuplexStream, said: &str) -> String {
        near.write_all(said.as_bytes()).await.unwrap();
        let mut bytes = [0; 128];
        match timeout(Duration::from_millis(500), near.read(&mut bytes)).await {
            Ok(count) => String::from_utf8_lossy(&bytes[..count.unwrap()]).into_owned(),
            Err(_) => String::new(),
        }
    }

    /// Exchanges as chapter 7 describes them.
    #[tokio::test(start_paused = true)]
    async fn a_transcript_goes_as_the_manual_says() {
        let (mut near, mut pulses) = served(QuantumBehaviour::delivered());
        for (said, expected) in [
            (":SYST:STAT?\r\n", "0\r\n"),
            (":INST:CAT?\r\n", "T0,CHA,CHB,CHC,CHD,CHE,CHF,CHG,CHH\r\n"),
            ("*IDN?\r\n", "QC,9528,10123,5.9\r\n"),
            (":PULSE1:WIDT 0.00012\r\n", "ok\r\n"),
            (":PULSE1:WIDT?\r\n", "0.000120000\r\n"),
            (":pulse1:width?\r\n", "0.000120000\r\n"),
            (":PULSE:STATE?\r\n", "0\r\n"),
            (":PULSE1:POL?\r\n", "NORM\r\n"),
            (":PULSE1:POLAR?\r\n", "?3\r\n"),
            ("PULSE1:POL?\r\n", "?1\r\n"),
            (":PULSE1:WIDT\r\n", "?4\r\n"),
            (":PULSE1:WIDT -1\r\n", "?5\r\n"),
            (":SYST:STAT 1\r\n", "?6\r\n"),
            ("*TRG?\r\n", "?7\r\n"),
            (":PULSE1:CGAT PULS\r\n", "?8\r\n"),
            ("*TRG\r\n", "?8\r\n"),
            (":PULSE9:STATE 1\r\n", "?3\r\n"),
            (":SYST:COMM:SER:ECH 1\r\n", "ok\r\n"),
            (":PULSE1:STATE?\r\n", ":PULSE1:STATE?\r\n0\r\n"),
            (":SYST:COMM:SER:ECH 0\r\n", ":SYST:COMM:SER:ECH 0\r\nok\r\n"),
            // Arms, and fires nothing.
            (":PULSE0:TRIG:MODE TRIG\r\n", "ok\r\n"),
            (":PULSE0:COUN:STAT 1\r\n", "ok\r\n"),
            (":PULSE1:STATE 1\r\n", "ok\r\n"),
            (":PULSE0:STATE 1\r\n", "ok\r\n"),
            (":SYST:STAT?\r\n", "1\r\n"),
        ] {
            assert_eq!(heard(&mut near, said).await, expected, "{said}");
        }
        assert!(all(&mut pulses).await.is_empty());
        assert_eq!(heard(&mut near, "*TRG\r\n").await, "ok\r\n");
        assert_eq!(heard(&mut near, ":PULSE0:COUN:COUN? TCNTS\r\n").await, "1\r\n");
        assert_eq!(all(&mut pulses).await.len(), 1);
    }

    #[tokio::test(start_paused = true)]
    async fn a_programmed_burst_makes_exactly_the_pulses_that_are_meant() {
        for program in [
            program(),
            ShotProgram { wait_periods: 0, warm_up: 0, ..program() },
            ShotProgram { inject: false, ..program() },
            ShotProgram { blanks: 0, cycles: 1, ..program() },
        ] {
            let (mut unit, mut receiver) = driven(QuantumBehaviour::delivered());
            unit.identify().await.unwrap();
            assert_eq!(unit.program(&program).await.unwrap(), program);
            let collected = tokio::spawn(async move { all(&mut receiver).await });
            unit.start().await.unwrap();
            assert!(unit.running().await.unwrap());
            let pulses = collected.await.unwrap();
            assert_eq!(made(&pulses, &program), meant(&program));
            assert!(!unit.running().await.unwrap());
        }
    }

    /// 1200 cycles of 15 s are five hours of virtual time; the clock wakes up for active pulses only, which the number
    /// of timers it needs does not show, but the time of this test does.
    #[tokio::test(start_paused = true)]
    async fn a_campaign_of_five_hours_costs_nothing_and_keeps_its_times_exactly() {
        let program = ShotProgram { period_ns: 10_000_130, cycle_periods: 1500, cycles: 1200, ..program() };
        let (mut unit, mut receiver) = driven(QuantumBehaviour::delivered());
        unit.program(&program).await.unwrap();
        let collected = tokio::spawn(async move { all(&mut receiver).await });
        unit.start().await.unwrap();
        let pulses = collected.await.unwrap();
        assert_eq!(made(&pulses, &program), meant(&program));
    }

    #[tokio::test(start_paused = true)]
    async fn a_stop_cuts_the_burst_and_leaves_the_injector_off() {
        let (mut unit, mut receiver) = driven(QuantumBehaviour::delivered());
        unit.program(&program()).await.unwrap();
        unit.start().await.unwrap();
        let started = Instant::now();
        for _ in 0..9 {
            receiver.recv().await.unwrap();
        }
        for _ in 0..2 {
            unit.make_safe().await.unwrap();
            assert!(!unit.running().await.unwrap());
        }
        assert!(started.elapsed() < Duration::from_secs(18));
        let late = all(&mut receiver).await;
        assert!(late.len() < 6 && late.iter().all(|pulse| pulse.injector.is_none()), "{late:?}");
        let error = unit.start().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    }

    /// The injector is switched off before the clock: no injection after the first of the two commands.
    #[tokio::test(start_paused = true)]
    async fn switching_a_channel_off_during_a_run_takes_effect_at_once() {
        let (mut near, mut receiver) = served(QuantumBehaviour::delivered());
        for said in [
            ":PULSE0:PER 0.1\r\n",
            ":PULSE1:STATE 1\r\n",
            ":PULSE2:STATE 1\r\n",
            ":PULSE2:CMOD DCYC\r\n",
            ":PULSE2:PCO 1\r\n",
            ":PULSE2:OCO 1\r\n",
            ":PULSE0:STATE 1\r\n",
        ] {
            assert_eq!(heard(&mut near, said).await, "ok\r\n");
        }
        sleep(Duration::from_millis(1020)).await;
        assert_eq!(heard(&mut near, ":PULSE2:STATE 0\r\n").await, "ok\r\n");
        sleep(Duration::from_millis(1000)).await;
        assert_eq!(heard(&mut near, ":PULSE0:STATE 0\r\n").await, "ok\r\n");
        let pulses = all(&mut receiver).await;
        for (index, pulse) in (0_u64..).zip(&pulses) {
            assert_eq!(pulse.t0_index, index);
            assert_eq!(pulse.at_ns - pulses[0].at_ns, index * 100_000_000);
            assert_eq!(pulse.injector.is_some(), index % 2 == 0 && index <= 10, "{index}");
        }
        assert!((20..=22).contains(&pulses.len()), "{}", pulses.len());
    }

    /// Each system mode with each channel mode, against the manual's description.
    #[tokio::test(start_paused = true)]
    async fn modes_restrict_as_the_manual_says() {
        for (system, channel, expected) in [
            ("SING", "NORM", vec![0]),
            ("BURS", "NORM", vec![0, 1, 2, 3, 4, 5]),
            ("BURS", "SING", vec![0]),
            ("BURS", "BURS", vec![0, 1, 2]),
            ("BURS", "DCYC", vec![0, 1, 5]),
            // Two clock pulses on, one off: the sixth pulse comes in the ninth period.
            ("DCYC", "BURS", vec![0, 1, 3]),
        ] {
            let (mut near, mut receiver) = served(QuantumBehaviour::delivered());
            for said in [
                ":PULSE0:PER 1".to_owned(),
                format!(":PULSE0:MODE {system}"),
                ":PULSE0:BCO 6".to_owned(),
                ":PULSE0:PCO 2".to_owned(),
                ":PULSE0:OCO 1".to_owned(),
                ":PULSE1:STATE 1".to_owned(),
                format!(":PULSE1:CMOD {channel}"),
                ":PULSE1:BCO 3".to_owned(),
                ":PULSE1:PCO 2".to_owned(),
                ":PULSE1:OCO 3".to_owned(),
                ":PULSE0:STATE 1".to_owned(),
            ] {
                assert_eq!(heard(&mut near, &format!("{said}\r\n")).await, "ok\r\n", "{said}");
            }
            let pulses = all(&mut receiver).await;
            let seconds: Vec<_> =
                pulses.iter().map(|pulse| (pulse.at_ns - pulses[0].at_ns) / 1_000_000_000).collect();
            assert_eq!(seconds, expected, "{system} {channel}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_channel_that_fires_once_needs_to_be_armed_again() {
        let (mut near, mut receiver) = served(QuantumBehaviour::delivered());
        let run = [":PULSE0:STATE 1\r\n", ":PULSE0:STATE 0\r\n"];
        for said in [":PULSE1:STATE 1\r\n", ":PULSE1:CMOD SING\r\n", run[0], run[1]] {
            assert_eq!(heard(&mut near, said).await, "ok\r\n");
        }
        assert_eq!(all(&mut receiver).await.len(), 1);
        for said in run {
            assert_eq!(heard(&mut near, said).await, "ok\r\n");
        }
        assert_eq!(all(&mut receiver).await.len(), 0);
        for said in ["*ARM\r\n", run[0], run[1]] {
            assert_eq!(heard(&mut near, said).await, "ok\r\n");
        }
        assert_eq!(all(&mut receiver).await.len(), 1);
    }

    #[tokio::test(start_paused = true)]
    async fn limits_are_refused_before_anything_is_sent() {
        let (near, _far) = duplex(256);
        let mut unit = Quantum9520::new(Wire::over(near, "trigger unit"), limits());
        for (words, bad) in [
            ("longest allowed", ShotProgram { injector_width_ns: 5_000_001, ..program() }),
            ("shortest interval", ShotProgram { cycle_periods: 749, ..program() }),
            ("busy", ShotProgram { period_ns: 8_000_000, ..program() }),
            ("no pause", ShotProgram { blanks: 797, ..program() }),
            ("counts", ShotProgram { cycles: 20_000, ..program() }),
            ("counts", ShotProgram { cycles: 0, ..program() }),
            ("counts", ShotProgram { cycles: u32::MAX, cycle_periods: u32::MAX, ..program() }),
            ("5000 s", ShotProgram { period_ns: 10, ..program() }),
            ("a year", ShotProgram { period_ns: 5_000_000_000_000, cycles: 10_000, ..program() }),
            ("camera pulse", ShotProgram { camera_delay_ns: 19_990_000, ..program() }),
            ("camera pulse", ShotProgram { camera_delay_ns: u64::MAX, ..program() }),
            ("injector pulse", ShotProgram { injector_delay_ns: 19_000_000, ..program() }),
        ] {
            let error = unit.program(&bad).await.unwrap_err();
            assert!(matches!(error, DriverError::Limit { .. }), "{error}");
            assert!(error.to_string().contains(words), "{error}");
        }
        let (near, _far) = duplex(256);
        let no_number = TriggerLimits { injection_interval_min_s: f64::NAN, ..limits() };
        let mut unlimited = Quantum9520::new(Wire::over(near, "trigger unit"), no_number);
        let error = unlimited.program(&program()).await.unwrap_err();
        assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        // Nobody answers on this line: a program that passed the limits would be silent.
        let error = unit.program(&program()).await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { .. }), "{error}");
    }

    #[tokio::test(start_paused = true)]
    async fn two_bursts_keep_the_shortest_interval_between_injections() {
        let (mut unit, mut receiver) = driven(QuantumBehaviour::delivered());
        tokio::spawn(async move { while receiver.recv().await.is_some() {} });
        let short = ShotProgram { cycles: 1, wait_periods: 0, ..program() };
        unit.program(&short).await.unwrap();
        unit.start().await.unwrap();
        sleep(Duration::from_secs(5)).await;
        unit.stop().await.unwrap();
        unit.program(&short).await.unwrap();
        let error = unit.start().await.unwrap_err();
        assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        sleep(Duration::from_secs(10)).await;
        unit.start().await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn what_was_not_taken_is_refused() {
        let odd = ShotProgram { period_ns: 20_000_003, ..program() };
        let (mut unit, _pulses) = driven(QuantumBehaviour::delivered());
        let error = unit.program(&odd).await.unwrap_err();
        assert!(error.to_string().contains("told 0.020000003, holds 0.020000000"), "{error}");

        for fault in [
            TriggerFault::Ignores { command: ":PULSE2:WCO".to_owned() },
            TriggerFault::Refuses { command: ":PULSE0:MODE BURS".to_owned(), error: UnitError::Unavailable },
        ] {
            let (mut unit, _pulses) = driven(with(fault));
            let error = unit.program(&program()).await.unwrap_err();
            assert!(matches!(error, DriverError::Refused { .. }), "{error}");
        }
        let (mut unit, _pulses) =
            driven(with(TriggerFault::Ignores { command: ":PULSE0:STATE 1".to_owned() }));
        unit.program(&program()).await.unwrap();
        let error = unit.start().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    }

    #[tokio::test(start_paused = true)]
    async fn the_clock_is_stopped_even_if_the_injector_is_not() {
        let fault =
            TriggerFault::Refuses { command: ":PULSE2:STATE 0".to_owned(), error: UnitError::Unavailable };
        let (mut near, _receiver) = served(with(fault));
        assert_eq!(heard(&mut near, ":PULSE0:STATE 1\r\n").await, "ok\r\n");
        let mut unit = Quantum9520::new(Wire::over(near, "trigger unit"), limits());
        let error = unit.make_safe().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
        assert!(!unit.running().await.unwrap());
    }

    #[tokio::test(start_paused = true)]
    async fn lost_pulses_are_lost_and_the_others_keep_their_times() {
        let program = program();
        let (mut unit, mut receiver) = driven(with(TriggerFault::DropsCameraPulse { pulse: 8 }));
        unit.program(&program).await.unwrap();
        let collected = tokio::spawn(async move { all(&mut receiver).await });
        unit.start().await.unwrap();
        let pulses = collected.await.unwrap();
        let mut expected = meant(&program);
        expected.remove(8);
        assert_eq!(made(&pulses, &program), expected);

        let (mut unit, mut receiver) = driven(with(TriggerFault::DropsAllPulses { from_s: 0.0 }));
        unit.program(&program).await.unwrap();
        unit.start().await.unwrap();
        assert!(unit.running().await.unwrap());
        assert!(all(&mut receiver).await.is_empty());
    }

    #[tokio::test(start_paused = true)]
    async fn a_mute_unit_that_runs_for_ever_still_answers() {
        let (mut near, mut receiver) = served(with(TriggerFault::DropsAllPulses { from_s: 2.0 }));
        for said in [":PULSE0:PER 1\r\n", ":PULSE1:STATE 1\r\n", ":PULSE0:STATE 1\r\n"] {
            assert_eq!(heard(&mut near, said).await, "ok\r\n");
        }
        assert_eq!(all(&mut receiver).await.len(), 2);
        for _ in 0..100 {
            assert_eq!(heard(&mut near, ":PULSE1:WIDT 0.001\r\n").await, "ok\r\n");
        }
        assert_eq!(heard(&mut near, ":SYST:STAT?\r\n").await, "1\r\n");
    }

    /// A spray whose camera trigger is lost is still a spray: the injector has fired.
    #[tokio::test(start_paused = true)]
    async fn a_lost_camera_pulse_does_not_stop_the_injector() {
        let program = ShotProgram { cycles: 1, ..program() };
        let (mut unit, mut receiver) = driven(with(TriggerFault::DropsCameraPulse { pulse: 6 }));
        unit.program(&program).await.unwrap();
        unit.start().await.unwrap();
        let pulses = all(&mut receiver).await;
        assert_eq!(pulses.len(), 7);
        assert!(pulses[6].camera.is_none() && pulses[6].injector.is_some());
    }

    #[tokio::test(start_paused = true)]
    async fn a_full_channel_delays_pulses_but_no_answers() {
        let program = program();
        let (near, far) = duplex(256);
        let (sender, mut receiver) = mpsc::channel(1);
        tokio::spawn(serve(far, sender, QuantumBehaviour::delivered(), Instant::now()));
        let mut unit = Quantum9520::new(Wire::over(near, "trigger unit"), limits());
        unit.program(&program).await.unwrap();
        unit.start().await.unwrap();
        sleep(Duration::from_secs(40)).await;
        assert!(unit.running().await.unwrap());
        unit.stop().await.unwrap();
        let pulses = all(&mut receiver).await;
        // All pulses that were due before the stop, and none after it.
        assert_eq!(made(&pulses, &program), meant(&program)[..21]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_burst_goes_on_when_the_line_has_gone() {
        let program = program();
        let (mut unit, mut receiver) = driven(QuantumBehaviour::delivered());
        unit.program(&program).await.unwrap();
        unit.start().await.unwrap();
        drop(unit);
        let mut pulses = Vec::new();
        while let Some(pulse) = receiver.recv().await {
            pulses.push(pulse);
        }
        assert_eq!(made(&pulses, &program), meant(&program));
    }

    #[tokio::test(start_paused = true)]
    async fn a_booting_unit_is_waited_for_and_not_locked_up() {
        let behaviour = QuantumBehaviour { boot_s: 3.0, echo: true, ..QuantumBehaviour::delivered() };
        let (mut unit, _pulses) = driven(behaviour.clone());
        assert_eq!(unit.identify().await.unwrap().model, "9528");
        // A star while booting locks it up for ever.
        let (mut near, _pulses) = served(behaviour);
        assert_eq!(heard(&mut near, "*IDN?\r\n").await, "");
        sleep(Duration::from_secs(10)).await;
        assert_eq!(heard(&mut near, ":SYST:STAT?\r\n").await, "");
    }

    #[tokio::test(start_paused = true)]
    async fn faults_of_the_line_do_not_change_the_program() {
        for fault in [
            LineFault::Late { every: 9, delay_s: 1.3 },
            LineFault::Garbled { every: 9 },
            LineFault::Missing { every: 9 },
            LineFault::Doubled { every: 9 },
        ] {
            let behaviour =
                QuantumBehaviour { line_faults: vec![fault.clone()], ..QuantumBehaviour::delivered() };
            let (mut unit, mut receiver) = driven(behaviour);
            unit.program(&program()).await.unwrap();
            let collected = tokio::spawn(async move { all(&mut receiver).await });
            unit.start().await.unwrap();
            let pulses = collected.await.unwrap();
            assert_eq!(made(&pulses, &program()), meant(&program()), "{fault:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_dead_unit_is_silent() {
        let silent = LineFault::Silent { from_s: 10.0 };
        let behaviour = QuantumBehaviour { line_faults: vec![silent], ..QuantumBehaviour::delivered() };
        let (mut unit, _pulses) = driven(behaviour);
        unit.identify().await.unwrap();
        sleep(Duration::from_secs(10)).await;
        let error = unit.make_safe().await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { .. }), "{error}");
    }

    #[test]
    fn a_behaviour_is_read_from_a_file_and_unknown_keys_are_refused() {
        let text = "boot_s = 2.0\n[[faults]]\nkind = \"drops-camera-pulse\"\npulse = 3\n\
                    [[faults]]\nkind = \"refuses\"\ncommand = \":PULSE0:STATE\"\nerror = \"unavailable\"\n\
                    [[line_faults]]\nkind = \"silent\"\nfrom_s = 9.0\n";
        let behaviour: QuantumBehaviour = toml::from_str(text).unwrap();
        assert_eq!(behaviour.faults.len(), 2);
        assert_eq!(behaviour.line_faults, [LineFault::Silent { from_s: 9.0 }]);
        assert_eq!(toml::from_str::<QuantumBehaviour>("").unwrap(), QuantumBehaviour::delivered());
        assert!(toml::from_str::<QuantumBehaviour>("colour = 1\n").is_err());
        let impossible: QuantumBehaviour = toml::from_str("boot_s = nan\n").unwrap();
        assert!(impossible.check().unwrap_err().starts_with("boot_s"));
    }
}
