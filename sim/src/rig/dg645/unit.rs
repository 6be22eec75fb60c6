//! The unit: what it remembers, what it answers, and which pulses its triggers make.

use super::burst::{Burst, Prescaler};
use crate::rig::pulse::Pulse;
use crate::rig::pulser::{Meddling, PulserBehaviour, Unit};
use ditd_drivers::dg645::table::delivered;
use ditd_drivers::dg645::{
    Act, CAMERA_OUTPUT, Command, Fault, INJECTOR_OUTPUT, Key, Value, event_status, instrument_status,
    status_byte,
};
use std::collections::{BTreeMap, VecDeque};

/// Codes that wait in the error queue at most; the sources do not say how many.
const ERRORS_MAX: usize = 20;

/// Bursts that wait to be sent at most: as many triggers have come while the consumer of pulses stood still. Beyond,
/// triggers are overlooked.
const BURSTS_MAX: usize = 64;

/// From here on the rig's inputs take a pulse for high, in volts: a TTL input.
const HIGH_V: f64 = 2.0;

/// A delay cycle takes that much more than its longest delay, in ns (data sheet).
const RECOVERY_NS: u64 = 100;

/// `TSRC` for the internal rate and for single shots.
const INTERNAL: u64 = 0;
const SINGLE_SHOT: u64 = 5;

/// A DG645.
pub(in crate::rig) struct DelayGenerator {
    behaviour: PulserBehaviour,
    memory: BTreeMap<(Key, u32), Value>,
    stores: BTreeMap<u64, BTreeMap<(Key, u32), Value>>,
    errors: VecDeque<u64>,
    instrument_status: u64,
    event_status: u64,
    /// Of the trigger and of the outputs AB to GH.
    prescalers: [Prescaler; 5],
    bursts: VecDeque<Burst>,
    /// The internal rate's zero and the number of its next trigger.
    internal: Option<(u64, u64)>,
    /// Delay cycles since it was switched on.
    cycles: u64,
}

impl DelayGenerator {
    /// Switched on, as delivered.
    pub(in crate::rig) fn new(behaviour: PulserBehaviour) -> Self {
        Self {
            behaviour,
            memory: defaults(),
            stores: BTreeMap::new(),
            errors: VecDeque::new(),
            instrument_status: 0,
            event_status: event_status::POWER_ON,
            prescalers: [Prescaler::delivered(); 5],
            bursts: VecDeque::new(),
            internal: None,
            cycles: 0,
        }
    }

    fn fail(&mut self, fault: Fault) {
        self.event_status |= match fault {
            Fault::Other(_) => event_status::COMMAND,
            _ => event_status::EXECUTION,
        };
        if self.errors.len() < ERRORS_MAX {
            self.errors.push_back(fault.code());
        }
    }

    fn read(&mut self, key: Key, index: u32, now_ns: u64) -> Option<Value> {
        Some(match key {
            Key::Identity => Value::Text("Stanford Research Systems,DG645,s/n001645,ver1.14.10E".to_owned()),
            Key::Complete => Value::Count(1),
            Key::Timebase => Value::Count(0),
            Key::LastError => Value::Count(self.errors.pop_front().unwrap_or(0)),
            Key::EventStatus => Value::Count(std::mem::take(&mut self.event_status)),
            Key::InstrumentStatus => {
                self.note_ends(now_ns);
                Value::Count(std::mem::take(&mut self.instrument_status))
            }
            Key::StatusByte => {
                let running = if self.is_busy(now_ns) { status_byte::BUSY } else { 0 };
                let burst = if self.is_on(Key::BurstMode) { status_byte::BURST } else { 0 };
                Value::Count(running | if running == 0 { 0 } else { burst })
            }
            _ => self.memory.get(&(key, index))?.clone(),
        })
    }

    fn write(&mut self, key: Key, index: u32, value: Value, now_ns: u64) -> Result<(), Fault> {
        let value = on_grid(key, value);
        if let (Key::Delay, Value::Delay { .. }) = (key, &value) {
            let held = self.memory.insert((key, index), value);
            if (2..=9).any(|channel| self.delay_ps(channel).is_none()) {
                let held = held.expect("every channel from A to H has a delay");
                self.memory.insert((key, index), held);
                return Err(Fault::IllegalDelay);
            }
            return Ok(());
        }
        match (key, &value, self.prescalers.get_mut(index as usize)) {
            (Key::Save, Value::Count(slot), _) => {
                self.stores.insert(*slot, self.memory.clone());
                return Ok(());
            }
            (Key::Recall, Value::Count(slot), _) => {
                let stored = if *slot == 0 { Some(defaults()) } else { self.stores.get(slot).cloned() };
                self.recall(stored.ok_or(Fault::IllegalValue)?);
                return Ok(());
            }
            (Key::Prescale, Value::Count(factor), Some(prescaler)) => prescaler.set_factor(*factor),
            (Key::Phase, Value::Count(phase), Some(prescaler)) => prescaler.phase = *phase,
            (Key::TriggerSource, Value::Count(source), _) => {
                self.internal = (*source == INTERNAL).then_some((now_ns, 1));
                // What the internal rate had scheduled does not come.
                self.bursts.retain(|burst| burst.start_ns <= now_ns);
            }
            (Key::BurstMode, Value::Count(0), _) => self.abort(now_ns),
            _ => {}
        }
        self.memory.insert((key, index), value);
        Ok(())
    }

    fn recall(&mut self, memory: BTreeMap<(Key, u32), Value>) {
        self.memory = memory;
        self.internal = None;
        for (index, prescaler) in (0_u32..).zip(&mut self.prescalers) {
            if let Some(Value::Count(factor)) = self.memory.get(&(Key::Prescale, index)) {
                prescaler.set_factor(*factor);
            }
            if let Some(Value::Count(phase)) = self.memory.get(&(Key::Phase, index)) {
                prescaler.phase = *phase;
            }
        }
    }

    /// A running burst makes no further delay cycle.
    fn abort(&mut self, now_ns: u64) {
        if self.is_busy(now_ns) {
            self.instrument_status |= instrument_status::ABORTED;
        }
        for burst in &mut self.bursts {
            // Those that were due before are made, though they may still wait to be sent.
            let due = (now_ns + 1).saturating_sub(burst.start_ns).div_ceil(burst.period_ns.max(1));
            burst.count = burst.count.min(due.max(burst.made));
        }
    }

    fn trigger(&mut self, now_ns: u64) {
        self.note_ends(now_ns);
        if self.is_busy(now_ns) {
            self.instrument_status |= instrument_status::RATE;
            return;
        }
        self.instrument_status |= instrument_status::TRIGGER;
        let advanced = self.is_on(Key::AdvancedTrigger);
        let passes = !advanced || self.prescalers[0].is_open();
        if advanced {
            self.prescalers[0].step();
        }
        if !passes || self.bursts.len() >= BURSTS_MAX {
            return;
        }
        let is_burst = self.is_on(Key::BurstMode);
        self.bursts.push_back(Burst {
            start_ns: now_ns + if is_burst { self.time_ns(Key::BurstDelay) } else { 0 },
            period_ns: if is_burst { self.time_ns(Key::BurstPeriod) } else { 0 },
            count: if is_burst { self.count(Key::BurstCount, 0) } else { 1 },
            made: 0,
        });
    }

    /// Bursts that are over and sent are forgotten; their ends are in the register.
    fn note_ends(&mut self, now_ns: u64) {
        let cycle_ns = self.cycle_ns();
        while let Some(front) = self.bursts.front()
            && front.next_ns().is_none()
            && front.end_ns(cycle_ns) <= now_ns
        {
            self.instrument_status |= instrument_status::END_OF_DELAY;
            if self.is_on(Key::BurstMode) {
                self.instrument_status |= instrument_status::END_OF_BURST;
            }
            self.bursts.pop_front();
        }
    }

    fn is_busy(&self, now_ns: u64) -> bool {
        let cycle_ns = self.cycle_ns();
        self.bursts.back().is_some_and(|burst| now_ns < burst.end_ns(cycle_ns))
    }

    /// The delay cycle's length: its longest delay and the time to recover.
    fn cycle_ns(&self) -> u64 {
        let longest = (2..=9).filter_map(|channel| self.delay_ps(channel)).max().unwrap_or(0);
        u64::try_from(longest / 1000).unwrap_or(0) + RECOVERY_NS
    }

    /// A channel's time after T0; `None` when it hangs on itself or lies outside of 0 … 2000 s.
    fn delay_ps(&self, channel: u32) -> Option<i64> {
        let (mut channel, mut total) = (channel, 0);
        for _ in 0..10 {
            if channel == 0 {
                return (0..=2_000_000_000_000_000).contains(&total).then_some(total);
            }
            match self.memory.get(&(Key::Delay, channel)) {
                Some(Value::Delay { after, ps }) => (channel, total) = (*after, total + ps),
                _ => return None,
            }
        }
        None
    }

    /// Delay and width of an output that fires in this delay cycle and is high enough to be seen.
    fn output(&self, output: u32) -> Option<(u64, u64)> {
        let is_open = !self.is_on(Key::AdvancedTrigger) || self.prescalers[output as usize].is_open();
        let is_high =
            matches!(self.memory.get(&(Key::Amplitude, output)), Some(Value::Real(v)) if *v >= HIGH_V);
        let (begin, end) = (self.delay_ps(2 * output)?, self.delay_ps(2 * output + 1)?);
        let ns = |ps: i64| u64::try_from(ps / 1000).unwrap_or(0);
        (is_open && is_high && end > begin).then(|| (ns(begin), ns(end) - ns(begin)))
    }

    /// The internal rate's next trigger begins its burst when the last one is over.
    fn run_internal(&mut self) {
        let Some((zero_ns, next)) = self.internal.filter(|_| self.bursts.is_empty()) else { return };
        let Some(Value::Real(rate)) = self.memory.get(&(Key::TriggerRate, 0)) else { return };
        if *rate <= 0.0 {
            return;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "the hours of a rig at its trigger rate"
        )]
        let at_ns = zero_ns + (next as f64 / rate * 1e9).round() as u64;
        self.internal = Some((zero_ns, next + 1));
        self.trigger(at_ns);
    }

    fn is_on(&self, key: Key) -> bool {
        self.count(key, 0) == 1
    }

    fn count(&self, key: Key, index: u32) -> u64 {
        match self.memory.get(&(key, index)) {
            Some(Value::Count(count)) => *count,
            _ => 0,
        }
    }

    fn time_ns(&self, key: Key) -> u64 {
        match self.memory.get(&(key, 0)) {
            Some(Value::Time(ps)) => u64::try_from(ps / 1000).unwrap_or(0),
            _ => 0,
        }
    }

    fn obey(&mut self, command: Command, now_ns: u64) -> Option<String> {
        let is_set = matches!(command.act, Act::Set(_));
        match self.behaviour.meddling(&command.encode(), is_set) {
            Some(Meddling::Refused(_)) => {
                self.fail(Fault::IllegalValue);
                return None;
            }
            Some(Meddling::Ignored) => return None,
            None => {}
        }
        match (command.key, command.act) {
            (key, Act::Query) => match self.read(key, command.index, now_ns) {
                Some(value) => return Some(format!("{}\r\n", value.answer())),
                None => self.fail(Fault::IllegalValue),
            },
            (key, Act::Set(Some(value))) => {
                if let Err(fault) = self.write(key, command.index, value, now_ns) {
                    self.fail(fault);
                }
            }
            (Key::Reset, Act::Set(None)) => {
                self.abort(now_ns);
                self.recall(defaults());
            }
            (Key::ClearStatus, Act::Set(None)) => {
                self.errors.clear();
                (self.instrument_status, self.event_status) = (0, 0);
            }
            (Key::Trigger, Act::Set(None)) if self.count(Key::TriggerSource, 0) == SINGLE_SHOT => {
                self.trigger(now_ns);
            }
            _ => {}
        }
        None
    }
}

impl Unit for DelayGenerator {
    fn answer(&mut self, line: &str, now_ns: u64) -> Option<String> {
        match Command::decode(line) {
            Ok(command) => self.obey(command, now_ns),
            Err(fault) => {
                self.fail(fault);
                None
            }
        }
    }

    fn hear_while_booting(&mut self, _line: &str) {}

    fn next_pulse(&mut self) -> Option<Pulse> {
        self.run_internal();
        let at_ns = self.bursts.iter().find_map(Burst::next_ns)?;
        Some(Pulse {
            t0_index: self.cycles,
            at_ns,
            camera: self.output(CAMERA_OUTPUT),
            injector: self.output(INJECTOR_OUTPUT),
        })
    }

    fn note_sent(&mut self, pulse: Pulse) {
        if let Some(burst) = self.bursts.iter_mut().find(|burst| burst.next_ns().is_some()) {
            burst.made += 1;
        }
        self.cycles += 1;
        if self.is_on(Key::AdvancedTrigger) {
            self.prescalers[1..].iter_mut().for_each(Prescaler::step);
        }
        self.note_ends(pulse.at_ns);
        if self.internal.is_some() && self.bursts.iter().all(|burst| burst.next_ns().is_none()) {
            // Its next trigger comes later than this delay cycle's end, or is overlooked by the rate.
            let ends_ns = self.bursts.back().map_or(0, |burst| burst.end_ns(self.cycle_ns()));
            self.note_ends(ends_ns);
        }
    }

    fn power_cycle(&mut self) {
        *self = Self { cycles: self.cycles, ..Self::new(self.behaviour.clone()) };
    }
}

fn defaults() -> BTreeMap<(Key, u32), Value> {
    delivered().into_iter().map(|(key, index, value)| ((key, index), value)).collect()
}

/// Rounds to the unit's grid: 5 ps for delays (data sheet), 10 ns for the burst's times (its longest period is 10 ns less
/// than 2000 s).
fn on_grid(key: Key, value: Value) -> Value {
    match (key, value) {
        (Key::BurstPeriod | Key::BurstDelay, Value::Time(ps)) => Value::Time(ps / 10_000 * 10_000),
        (_, Value::Delay { after, ps }) => Value::Delay { after, ps: ps / 5 * 5 },
        (_, value) => value,
    }
}
