//! The unit: what it remembers, what it answers, and how its modes let pulses through.

use super::clock::{Mode, Output, Stretch};
use super::memory::{Memory, channel_name, delivered, on_grid};
use super::{CHANNELS, PS_PER_NS, STRETCHES_MAX};
use crate::rig::pulse::Pulse;
use crate::rig::pulser::{Meddling, PulserBehaviour, Unit};
use ditd_drivers::instrument::Identity;
use ditd_drivers::quantum_9520::{
    Act, CAMERA_CHANNEL, Command, INJECTOR_CHANNEL, Key, Reply, UnitError, Value, belongs_to, needs_channel,
};
use std::collections::{BTreeMap, VecDeque};

/// What the clock does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Stopped,
    /// `STATE 1` with a trigger mode: waits for triggers; the next pulse has this number.
    Armed(u64),
    /// The last stretch runs, until its end or a stop.
    Running,
}

/// A 9520 or 575.
pub(in crate::rig) struct PulseGenerator {
    behaviour: PulserBehaviour,
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
}

impl PulseGenerator {
    /// Switched on, as delivered.
    pub(in crate::rig) fn new(behaviour: PulserBehaviour) -> Self {
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
        }
    }

    fn obey(&mut self, command: &Command, now_ns: u64) -> Reply {
        let spelled = command.encode();
        let is_set = matches!(command.act, Act::Set(_));
        match self.behaviour.meddling(&spelled, is_set) {
            Some(Meddling::Refused(error)) => return Reply::Failed(error),
            Some(Meddling::Ignored) => return Reply::Done,
            None => {}
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
            // Nothing is connected to its reference input: told to follow it, the clock is not locked.
            Key::ClockIn => match self.memory.get(&(0, key)) {
                Some(Value::Word(word)) if word != "SYS" => Ok(Value::Unlocked(word.clone())),
                held => held.cloned().ok_or(UnitError::NoQuery),
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

impl Unit for PulseGenerator {
    /// Its echo included; `None` when it is locked up.
    fn answer(&mut self, line: &str, now_ns: u64) -> Option<String> {
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

    /// A star locks it up for good.
    fn hear_while_booting(&mut self, line: &str) {
        self.locked_up |= line.trim_start().starts_with('*');
    }

    fn next_pulse(&mut self) -> Option<Pulse> {
        loop {
            if let Some(pulse) = self.stretches.front()?.next_pulse() {
                return Some(pulse);
            }
            // The last one of a run stays: it knows the time.
            if self.stretches.len() == 1 && self.state != State::Stopped {
                return None;
            }
            self.stretches.pop_front();
        }
    }

    fn note_sent(&mut self, pulse: Pulse) {
        if let Some(front) = self.stretches.front_mut() {
            front.next = pulse.t0_index + 1;
        }
    }

    fn power_cycle(&mut self) {
        *self = Self::new(PulserBehaviour { echo: false, ..self.behaviour.clone() });
    }
}
