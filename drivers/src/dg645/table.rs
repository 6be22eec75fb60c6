//! The commands: every key with its mnemonic, its index, its kind of value and its access.

use super::value::{PS_PER_S, Value};

/// What a command is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the command table below says what each one is")]
pub enum Key {
    Identity,
    Reset,
    ClearStatus,
    Trigger,
    Save,
    Recall,
    Complete,
    StatusByte,
    EventStatus,
    EventEnable,
    ServiceEnable,
    LastError,
    InstrumentStatus,
    InstrumentEnable,
    Timebase,
    AdvancedTrigger,
    Holdoff,
    Inhibit,
    Prescale,
    Phase,
    TriggerLevel,
    TriggerRate,
    TriggerSource,
    BurstMode,
    BurstCount,
    BurstPeriod,
    BurstDelay,
    BurstT0,
    Delay,
    Link,
    Amplitude,
    Offset,
    Polarity,
}

/// What kind of value a key has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// None: an act.
    Act,
    /// A whole number with its legal range.
    Count(u64, u64),
    /// A time with its legal range, in picoseconds.
    Time(i64, i64),
    /// A real number with its legal range: volts or hertz.
    Real(f64, f64),
    /// A reference channel and a time after it.
    Delay,
    /// Any text.
    Text,
}

/// One line of the table.
pub(super) struct Row {
    pub(super) key: Key,
    pub(super) mnemonic: &'static str,
    /// Range of the number of the channel, output or prescaler that the command is about.
    pub(super) index: Option<(u32, u32)>,
    pub(super) kind: Kind,
    pub(super) asks: bool,
    pub(super) tells: bool,
}

const fn row(
    key: Key,
    mnemonic: &'static str,
    index: Option<(u32, u32)>,
    kind: Kind,
    access: &'static str,
) -> Row {
    let access = access.as_bytes();
    Row { key, mnemonic, index, kind, asks: access[0] == b'r', tells: access[1] == b'w' }
}

/// Longest delay, in picoseconds (data sheet: 2000 s).
pub(super) const DELAY_MAX_PS: i64 = 2000 * PS_PER_S;

const FLAG: Kind = Kind::Count(0, 1);
const REGISTER: Kind = Kind::Count(0, 255);
const TIME: Kind = Kind::Time(0, DELAY_MAX_PS);
const OUTPUTS: Option<(u32, u32)> = Some((0, 4));
/// Counts whose upper end no source names: what the unit does not take, it says.
const MANY: u64 = 0x7fff_ffff;

/// The commands that a rig needs, and their neighbours.
pub(super) const TABLE: &[Row] = &[
    row(Key::Identity, "*IDN", None, Kind::Text, "r-"),
    row(Key::Reset, "*RST", None, Kind::Act, "-w"),
    row(Key::ClearStatus, "*CLS", None, Kind::Act, "-w"),
    row(Key::Trigger, "*TRG", None, Kind::Act, "-w"),
    row(Key::Save, "*SAV", None, Kind::Count(1, 9), "-w"),
    row(Key::Recall, "*RCL", None, Kind::Count(0, 9), "-w"),
    row(Key::Complete, "*OPC", None, FLAG, "r-"),
    row(Key::StatusByte, "*STB", None, REGISTER, "r-"),
    row(Key::EventStatus, "*ESR", None, REGISTER, "r-"),
    row(Key::EventEnable, "*ESE", None, REGISTER, "rw"),
    row(Key::ServiceEnable, "*SRE", None, REGISTER, "rw"),
    row(Key::LastError, "LERR", None, REGISTER, "r-"),
    row(Key::InstrumentStatus, "INSR", None, REGISTER, "r-"),
    row(Key::InstrumentEnable, "INSE", None, REGISTER, "rw"),
    row(Key::Timebase, "TIMB", None, Kind::Count(0, 3), "r-"),
    row(Key::AdvancedTrigger, "ADVT", None, FLAG, "rw"),
    row(Key::Holdoff, "HOLD", None, TIME, "rw"),
    row(Key::Inhibit, "INHB", None, Kind::Count(0, 5), "rw"),
    row(Key::Prescale, "PRES", Some((0, 4)), Kind::Count(1, MANY), "rw"),
    row(Key::Phase, "PHAS", Some((1, 4)), Kind::Count(0, MANY), "rw"),
    row(Key::TriggerLevel, "TLVL", None, Kind::Real(-3.5, 3.5), "rw"),
    row(Key::TriggerRate, "TRAT", None, Kind::Real(0.0, 1e7), "rw"),
    row(Key::TriggerSource, "TSRC", None, Kind::Count(0, 6), "rw"),
    row(Key::BurstMode, "BURM", None, FLAG, "rw"),
    row(Key::BurstCount, "BURC", None, Kind::Count(1, MANY), "rw"),
    row(Key::BurstPeriod, "BURP", None, Kind::Time(100_000, DELAY_MAX_PS - 10_000), "rw"),
    row(Key::BurstDelay, "BURD", None, TIME, "rw"),
    row(Key::BurstT0, "BURT", None, FLAG, "rw"),
    row(Key::Delay, "DLAY", Some((0, 9)), Kind::Delay, "rw"),
    row(Key::Link, "LINK", Some((0, 9)), Kind::Count(0, 9), "rw"),
    row(Key::Amplitude, "LAMP", OUTPUTS, Kind::Real(0.5, 5.0), "rw"),
    row(Key::Offset, "LOFF", OUTPUTS, Kind::Real(-2.0, 2.0), "rw"),
    row(Key::Polarity, "LPOL", OUTPUTS, FLAG, "rw"),
];

/// The kind of a key's value.
pub fn kind(key: Key) -> Kind {
    table_row(key).kind
}

/// The row of a key.
pub(super) fn table_row(key: Key) -> &'static Row {
    TABLE.iter().find(|row| row.key == key).expect("the table has a row for every key: tested")
}

/// The value of every setting after `*RST`, by the maker's tests; channels T0 and T1 have no delay of their own.
pub fn delivered() -> Vec<(Key, u32, Value)> {
    let mut settings = vec![
        (Key::TriggerSource, 0, Value::Count(5)),
        (Key::TriggerRate, 0, Value::Real(1000.0)),
        (Key::TriggerLevel, 0, Value::Real(1.0)),
        (Key::Holdoff, 0, Value::Time(0)),
        (Key::Inhibit, 0, Value::Count(1)),
        (Key::AdvancedTrigger, 0, Value::Count(0)),
        (Key::BurstMode, 0, Value::Count(0)),
        (Key::BurstCount, 0, Value::Count(5)),
        (Key::BurstPeriod, 0, Value::Time(100_000_000)),
        (Key::BurstDelay, 0, Value::Time(0)),
        (Key::BurstT0, 0, Value::Count(0)),
        (Key::EventEnable, 0, Value::Count(0)),
        (Key::ServiceEnable, 0, Value::Count(0)),
        (Key::InstrumentEnable, 0, Value::Count(0)),
    ];
    settings.extend((0..=4).map(|index| (Key::Prescale, index, Value::Count(1))));
    settings.extend((1..=4).map(|index| (Key::Phase, index, Value::Count(0))));
    for output in 0..=4 {
        settings.push((Key::Amplitude, output, Value::Real(2.5)));
        settings.push((Key::Offset, output, Value::Real(0.0)));
        settings.push((Key::Polarity, output, Value::Count(1)));
    }
    settings.extend((2..=9).map(|channel| (Key::Link, channel, Value::Count(0))));
    for channel in [2, 4, 6, 8] {
        settings.push((Key::Delay, channel, Value::Delay { after: 0, ps: 0 }));
        settings.push((Key::Delay, channel + 1, Value::Delay { after: channel, ps: 10_000 }));
    }
    settings
}
