//! What the unit remembers: its settings at delivery, and the grid to which it rounds them.

use super::CHANNELS;
use ditd_drivers::quantum_9520::{Key, Kind, Value, kind};
use std::collections::BTreeMap;

/// Every setting by channel and key; 0 is the clock.
pub(super) type Memory = BTreeMap<(u32, Key), Value>;

/// Rounds to the unit's grid: 10 ns for the period, 250 ps for width and delay (manual, specifications).
pub(super) fn on_grid(key: Key, value: Value) -> Value {
    match (key, value) {
        (Key::Period, Value::Time(ps)) => Value::Time(ps / 10_000 * 10_000),
        (_, Value::Time(ps)) => Value::Time(ps / 250 * 250),
        (_, value) => value,
    }
}

/// A channel as the catalogue spells it.
pub(super) fn channel_name(number: u32) -> String {
    match number {
        0 => "T0".to_owned(),
        _ => format!("CH{}", char::from(b'A' + u8::try_from(number - 1).unwrap_or(25).min(25))),
    }
}

/// All settings after `*RST`.
pub(super) fn delivered() -> Memory {
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
