//! Quantum Composers 9520 and BNC 575 pulse generators: codec in both directions, and the driver over a wire.
//!
//! Manual: Quantum Composers 9520 Operator's Manual v5.9, chapter 7 and appendix A (commands, error numbers, start-up
//! warning), and the note "System and Channel Modes"; BNC 575 Operating Manual, chapter 8, has the same text. Output
//! levels, polarities and the multiplexer belong to the wiring of the rig and are left as they were set at the
//! front panel. Gives no shot a label: it makes pulses.

use crate::error::DriverError;
use crate::instrument::{Identity, ShotProgram, TriggerUnit};
use crate::keyword::{Fit, path_fits, spell, word_fits};
use crate::wire::{LineHabits, Sign, Wire, WireSettings};
use async_trait::async_trait;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tokio::time::Instant;

/// Channel that triggers the camera: A.
pub const CAMERA_CHANNEL: u32 = 1;

/// Channel that fires the injector: B.
pub const INJECTOR_CHANNEL: u32 = 2;

/// Time that one command takes (manual, chapter 7: about 10 ms; faster sending may cause the unit not to respond).
const COMMAND_TIME: Duration = Duration::from_millis(10);

/// Tries of one exchange that may be repeated without harm.
const EXCHANGE_TRIES: u32 = 3;

/// Bit rate of the RS-232 port at delivery; the USB port comes with 38400.
const BAUD: u32 = 115_200;

/// Highest count of any counter (command table).
const COUNT_MAX: u64 = 9_999_999;

/// A year: a longer burst is a slip of a decimal point, and its times would overflow.
const BURST_MAX_NS: u64 = 365 * 86_400 * 1_000_000_000;

const PS_PER_NS: i64 = 1000;
const PS_PER_S: i64 = 1_000_000_000_000;

// ---------------------------------------------------------------------------------------------------- codec

/// What a command is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the command table below says what each one is")]
pub enum Key {
    Identity,
    Reset,
    Save,
    Recall,
    Label,
    Trigger,
    Arm,
    Catalogue,
    FullCatalogue,
    SelectNumber,
    SelectName,
    InstrumentState,
    State,
    Period,
    Mode,
    BurstCount,
    OnCount,
    OffCount,
    ClockIn,
    ClockOut,
    TriggerMode,
    TriggerEdge,
    TriggerLevel,
    GateMode,
    GateLogic,
    GateLevel,
    CounterState,
    CounterClear,
    CounterCount,
    Width,
    Delay,
    Sync,
    Polarity,
    OutputMode,
    Amplitude,
    Multiplexer,
    ChannelMode,
    WaitCount,
    ChannelGate,
    ChannelLogic,
    Running,
    KeypadLock,
    Autoload,
    Version,
    SerialNumber,
    Information,
    Baud,
    UsbBaud,
    Echo,
    Capitals,
}

/// What kind of value a key has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// None: an act.
    Act,
    /// 0 or 1, `OFF` or `ON`.
    Flag,
    /// A whole number with its legal range.
    Count(u64, u64),
    /// A time with its legal range, in picoseconds.
    Time(i64, i64),
    /// A level in volts with its legal range.
    Volts(f64, f64),
    /// One of these words (short form in capitals); the short form is what is stored and answered.
    Word(&'static [&'static str]),
    /// Any text.
    Text,
}

/// Which `:PULSEn` a key belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Not below `:PULSE`.
    Unit,
    /// Channel 0, the system clock.
    Clock,
    /// Channels 1 and up.
    Channel,
    /// Both.
    Any,
}

struct Row {
    key: Key,
    /// As the manual's examples write it, and as the driver sends it.
    spelling: &'static str,
    /// Capitals are the short form.
    pattern: &'static str,
    place: Place,
    kind: Kind,
    asks: bool,
    tells: bool,
}

const fn row(
    key: Key,
    [spelling, pattern]: [&'static str; 2],
    place: Place,
    kind: Kind,
    access: &'static str,
) -> Row {
    let access = access.as_bytes();
    Row { key, spelling, pattern, place, kind, asks: access[0] == b'r', tells: access[1] == b'w' }
}

const COUNT: Kind = Kind::Count(1, COUNT_MAX);
const DELAY_MAX_PS: i64 = 999_999_999_999_750;
const MODES: Kind = Kind::Word(&["NORMal", "SINGle", "BURSt", "DCYCle"]);
const EXTERNAL: Kind = Kind::Word(&[
    "SYS", "T0", "EXT10", "EXT20", "EXT25", "EXT40", "EXT50", "EXT80", "EXT100", "10", "20", "25", "40",
    "50", "80", "100",
]);
const SOURCES: Kind = Kind::Word(&["T0", "CHA", "CHB", "CHC", "CHD", "CHE", "CHF", "CHG", "CHH"]);
const GATES: Kind = Kind::Word(&["DISable", "PULSe", "OUTPut", "CHANnel"]);
const EDGES: Kind = Kind::Word(&["RISing", "FALLing"]);
const LOGIC: Kind = Kind::Word(&["LOW", "HIGH"]);

/// The command table of chapter 7.
const TABLE: &[Row] = &[
    row(Key::Identity, ["*IDN", "*IDN"], Place::Unit, Kind::Text, "r-"),
    row(Key::Reset, ["*RST", "*RST"], Place::Unit, Kind::Act, "-w"),
    row(Key::Save, ["*SAV", "*SAV"], Place::Unit, Kind::Count(1, 12), "-w"),
    row(Key::Recall, ["*RCL", "*RCL"], Place::Unit, Kind::Count(0, 12), "-w"),
    row(Key::Label, ["*LBL", "*LBL"], Place::Unit, Kind::Text, "rw"),
    row(Key::Trigger, ["*TRG", "*TRG"], Place::Unit, Kind::Act, "-w"),
    row(Key::Arm, ["*ARM", "*ARM"], Place::Unit, Kind::Act, "-w"),
    row(Key::Catalogue, [":INST:CAT", ":INSTrument:CATalog"], Place::Unit, Kind::Text, "r-"),
    row(Key::FullCatalogue, [":INST:FULL", ":INSTrument:FULL"], Place::Unit, Kind::Text, "r-"),
    row(Key::SelectNumber, [":INST:NSEL", ":INSTrument:NSELect"], Place::Unit, Kind::Count(0, 8), "rw"),
    row(Key::SelectName, [":INST:SEL", ":INSTrument:SELect"], Place::Unit, SOURCES, "rw"),
    row(Key::InstrumentState, [":INST:STATE", ":INSTrument:STATe"], Place::Unit, Kind::Flag, "rw"),
    row(Key::State, [":PULSE#:STATE", ":PULSe#:STATe"], Place::Any, Kind::Flag, "rw"),
    row(
        Key::Period,
        [":PULSE#:PER", ":PULSe#:PERiod"],
        Place::Clock,
        Kind::Time(50 * PS_PER_NS, 5000 * PS_PER_S),
        "rw",
    ),
    row(Key::Mode, [":PULSE#:MODE", ":PULSe#:MODe"], Place::Clock, MODES, "rw"),
    row(Key::BurstCount, [":PULSE#:BCO", ":PULSe#:BCOunter"], Place::Any, COUNT, "rw"),
    row(Key::OnCount, [":PULSE#:PCO", ":PULSe#:PCOunter"], Place::Any, COUNT, "rw"),
    row(Key::OffCount, [":PULSE#:OCO", ":PULSe#:OCOunter"], Place::Any, COUNT, "rw"),
    row(Key::ClockIn, [":PULSE#:ICL", ":PULSe#:ICLock"], Place::Clock, EXTERNAL, "rw"),
    row(Key::ClockOut, [":PULSE#:OCL", ":PULSe#:OCLock"], Place::Clock, EXTERNAL, "rw"),
    row(
        Key::TriggerMode,
        [":PULSE#:TRIG:MODE", ":PULSe#:TRIGger:MODe"],
        Place::Clock,
        Kind::Word(&["DISable", "TRIGger", "DUAL"]),
        "rw",
    ),
    row(Key::TriggerEdge, [":PULSE#:TRIG:EDGE", ":PULSe#:TRIGger:EDGe"], Place::Clock, EDGES, "rw"),
    row(
        Key::TriggerLevel,
        [":PULSE#:TRIG:LEV", ":PULSe#:TRIGger:LEVel"],
        Place::Clock,
        Kind::Volts(0.2, 15.0),
        "rw",
    ),
    row(Key::GateMode, [":PULSE#:GATE:MODE", ":PULSe#:GATe:MODe"], Place::Clock, GATES, "rw"),
    row(Key::GateLogic, [":PULSE#:GATE:LOG", ":PULSe#:GATe:LOGic"], Place::Clock, LOGIC, "rw"),
    row(
        Key::GateLevel,
        [":PULSE#:GATE:LEV", ":PULSe#:GATe:LEVel"],
        Place::Clock,
        Kind::Volts(0.2, 15.0),
        "rw",
    ),
    row(Key::CounterState, [":PULSE#:COUN:STAT", ":PULSe#:COUNter:STATe"], Place::Clock, Kind::Flag, "rw"),
    row(Key::CounterClear, [":PULSE#:COUN:CL", ":PULSe#:COUNter:CLear"], Place::Clock, Kind::Text, "-w"),
    row(Key::CounterCount, [":PULSE#:COUN:COUN", ":PULSe#:COUNter:COUNts"], Place::Clock, Kind::Text, "r-"),
    row(
        Key::Width,
        [":PULSE#:WIDT", ":PULSe#:WIDTh"],
        Place::Channel,
        Kind::Time(10 * PS_PER_NS, DELAY_MAX_PS),
        "rw",
    ),
    row(
        Key::Delay,
        [":PULSE#:DEL", ":PULSe#:DELay"],
        Place::Channel,
        Kind::Time(-DELAY_MAX_PS, DELAY_MAX_PS),
        "rw",
    ),
    row(Key::Sync, [":PULSE#:SYNC", ":PULSe#:SYNC"], Place::Channel, SOURCES, "rw"),
    row(
        Key::Polarity,
        [":PULSE#:POL", ":PULSe#:POLarity"],
        Place::Channel,
        Kind::Word(&["NORMal", "COMPlement", "INVerted"]),
        "rw",
    ),
    row(
        Key::OutputMode,
        [":PULSE#:OUTP:MODE", ":PULSe#:OUTPut:MODe"],
        Place::Channel,
        Kind::Word(&["TTL", "ADJustable"]),
        "rw",
    ),
    row(
        Key::Amplitude,
        [":PULSE#:OUTP:AMPL", ":PULSe#:OUTPut:AMPLitude"],
        Place::Channel,
        Kind::Volts(2.0, 20.0),
        "rw",
    ),
    row(Key::Multiplexer, [":PULSE#:MUX", ":PULSe#:MUX"], Place::Channel, Kind::Count(0, 255), "rw"),
    row(Key::ChannelMode, [":PULSE#:CMOD", ":PULSe#:CMODe"], Place::Channel, MODES, "rw"),
    row(Key::WaitCount, [":PULSE#:WCO", ":PULSe#:WCOunter"], Place::Channel, Kind::Count(0, COUNT_MAX), "rw"),
    row(
        Key::ChannelGate,
        [":PULSE#:CGAT", ":PULSe#:CGATe"],
        Place::Channel,
        Kind::Word(&["DISable", "PULSe", "OUTPut"]),
        "rw",
    ),
    row(Key::ChannelLogic, [":PULSE#:CLOG", ":PULSe#:CLOGic"], Place::Channel, LOGIC, "rw"),
    row(Key::Running, [":SYST:STAT", ":SYSTem:STATe"], Place::Unit, Kind::Flag, "r-"),
    row(Key::KeypadLock, [":SYST:KLOC", ":SYSTem:KLOCk"], Place::Unit, Kind::Flag, "rw"),
    row(Key::Autoload, [":SYST:AUT", ":SYSTem:AUToload"], Place::Unit, Kind::Flag, "rw"),
    row(Key::Version, [":SYST:VERS", ":SYSTem:VERSion"], Place::Unit, Kind::Text, "r-"),
    row(Key::SerialNumber, [":SYST:SERN", ":SYSTem:SERNumber"], Place::Unit, Kind::Text, "r-"),
    row(Key::Information, [":SYST:INFO", ":SYSTem:INFOrmation"], Place::Unit, Kind::Text, "r-"),
    row(
        Key::Baud,
        [":SYST:COMM:SER:BAUD", ":SYSTem:COMMunicate:SERial:BAUD"],
        Place::Unit,
        Kind::Count(4800, 115_200),
        "rw",
    ),
    row(
        Key::UsbBaud,
        [":SYST:COMM:SER:USB", ":SYSTem:COMMunicate:SERial:USB"],
        Place::Unit,
        Kind::Count(4800, 38_400),
        "rw",
    ),
    row(Key::Echo, [":SYST:COMM:SER:ECH", ":SYSTem:COMMunicate:SERial:ECHo"], Place::Unit, Kind::Flag, "rw"),
    row(Key::Capitals, [":SYST:CAPS", ":SYSTem:CAPS"], Place::Unit, Kind::Flag, "rw"),
];

/// A value of a command or a reply.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// On or off.
    Flag(bool),
    /// A whole number.
    Count(u64),
    /// A time in picoseconds.
    Time(i64),
    /// Volts.
    Volts(f64),
    /// The short form of a word of the key's list.
    Word(String),
    /// Any text.
    Text(String),
}

/// Whether a command asks or tells.
#[derive(Debug, Clone, PartialEq)]
pub enum Act {
    /// Asks; the counter's query has a word.
    Query(Option<String>),
    /// Tells, with its value; an act has none.
    Set(Option<Value>),
}

/// One command.
///
/// ```
/// use ditd_drivers::quantum_9520::{Command, Key, Value};
/// let command = Command::set_channel(0, Key::Period, Value::Time(20_000_000_000));
/// assert_eq!(command.encode(), ":PULSE0:PER 0.020000000");
/// assert_eq!(Command::decode(":puls0:period 0.02"), Ok(command));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// What it is about.
    pub key: Key,
    /// The number after `:PULSE`; `None` means the channel that was selected last.
    pub channel: Option<u32>,
    /// What is done.
    pub act: Act,
}

/// The unit's error answers, `?1` to `?8` (manual, chapter 7).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "kebab-case")]
pub enum UnitError {
    /// `?1`
    #[error("?1: incorrect prefix")]
    Prefix,
    /// `?2`
    #[error("?2: missing keyword")]
    MissingKeyword,
    /// `?3`
    #[error("?3: invalid keyword")]
    Keyword,
    /// `?4`
    #[error("?4: missing parameter")]
    MissingParameter,
    /// `?5`
    #[error("?5: invalid parameter")]
    Parameter,
    /// `?6`
    #[error("?6: query only, the command needs a question mark")]
    QueryOnly,
    /// `?7`
    #[error("?7: the command has no query form")]
    NoQuery,
    /// `?8`
    #[error("?8: unavailable in the present state")]
    Unavailable,
}

const UNIT_ERRORS: [UnitError; 8] = [
    UnitError::Prefix,
    UnitError::MissingKeyword,
    UnitError::Keyword,
    UnitError::MissingParameter,
    UnitError::Parameter,
    UnitError::QueryOnly,
    UnitError::NoQuery,
    UnitError::Unavailable,
];

/// One answer.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// `ok`
    Done,
    /// `?n`
    Failed(UnitError),
    /// The value asked for.
    Value(Value),
}

impl Command {
    /// A query of the unit, not of a channel.
    pub fn query(key: Key) -> Self {
        Self { key, channel: None, act: Act::Query(None) }
    }

    /// A set of the unit, not of a channel.
    pub fn set(key: Key, value: Value) -> Self {
        Self { key, channel: None, act: Act::Set(Some(value)) }
    }

    /// A query of a channel; 0 is the system clock.
    pub fn query_channel(channel: u32, key: Key) -> Self {
        Self { key, channel: Some(channel), act: Act::Query(None) }
    }

    /// A set of a channel; 0 is the system clock.
    pub fn set_channel(channel: u32, key: Key, value: Value) -> Self {
        Self { key, channel: Some(channel), act: Act::Set(Some(value)) }
    }

    /// An act without a value.
    pub fn act(key: Key) -> Self {
        Self { key, channel: None, act: Act::Set(None) }
    }

    /// The command as sent, without its line end.
    pub fn encode(&self) -> String {
        let spelled = spell(table_row(self.key).spelling, self.channel);
        match &self.act {
            Act::Query(None) => format!("{spelled}?"),
            Act::Query(Some(word)) => format!("{spelled}? {word}"),
            Act::Set(None) => spelled,
            Act::Set(Some(value)) => format!("{spelled} {}", encode_value(self.key, value)),
        }
    }

    /// Reads a line as the unit does.
    ///
    /// # Errors
    /// The unit's own error answer.
    pub fn decode(line: &str) -> Result<Self, UnitError> {
        let line = line.trim();
        if !line.starts_with([':', '*']) {
            return Err(UnitError::Prefix);
        }
        let (head, parameter) = line.split_once(' ').unwrap_or((line, ""));
        let parameter = parameter.trim();
        let (path, asks) = match head.strip_suffix('?') {
            Some(path) => (path, true),
            None => (head, false),
        };
        if path.len() < 2 || path.ends_with(':') {
            return Err(UnitError::MissingKeyword);
        }
        let (row, channel) = TABLE.iter().find_map(|row| fit(row, path)).ok_or(UnitError::Keyword)?;
        let act = match (asks, row.asks, row.tells) {
            (true, false, _) => return Err(UnitError::NoQuery),
            (false, _, false) => return Err(UnitError::QueryOnly),
            (true, true, _) => Act::Query((!parameter.is_empty()).then(|| parameter.to_owned())),
            (false, _, true) if row.kind == Kind::Act => Act::Set(None),
            (false, _, true) if parameter.is_empty() => return Err(UnitError::MissingParameter),
            (false, _, true) => {
                Act::Set(Some(decode_value(row.key, parameter).map_err(|_| UnitError::Parameter)?))
            }
        };
        Ok(Self { key: row.key, channel, act })
    }
}

impl Reply {
    /// The reply to a command about `key` as sent, without its line end.
    pub fn encode(&self, key: Key) -> String {
        match self {
            Self::Done => "ok".to_owned(),
            Self::Failed(error) => {
                let index = UNIT_ERRORS.iter().position(|other| other == error);
                format!("?{}", index.expect("the list has every error: tested") + 1)
            }
            Self::Value(value) => encode_value(key, value),
        }
    }

    /// Reads the reply to a command about `key`.
    ///
    /// # Errors
    /// Says what was expected instead.
    pub fn decode(key: Key, text: &str) -> Result<Self, &'static str> {
        if text.eq_ignore_ascii_case("ok") {
            return Ok(Self::Done);
        }
        if let Some(digits) = text.strip_prefix('?') {
            let index = digits.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
            let error = index.and_then(|index| UNIT_ERRORS.get(index));
            return error.map(|error| Self::Failed(*error)).ok_or("expected an error number from 1 to 8");
        }
        decode_value(key, text).map(Self::Value)
    }
}

/// The kind of a key's value.
pub fn kind(key: Key) -> Kind {
    table_row(key).kind
}

/// Whether a key exists for `:PULSEn` with this number.
pub fn belongs_to(key: Key, channel: u32) -> bool {
    match table_row(key).place {
        Place::Unit => false,
        Place::Clock => channel == 0,
        Place::Channel => channel > 0,
        Place::Any => true,
    }
}

/// Whether a key lies below `:PULSE`, so that without a number the channel selected last is meant.
pub fn needs_channel(key: Key) -> bool {
    table_row(key).place != Place::Unit
}

fn fit(row: &'static Row, path: &str) -> Option<(&'static Row, Option<u32>)> {
    let Fit::Yes(channel) = path_fits(row.pattern, path) else { return None };
    let fits = channel.is_none_or(|number| belongs_to(row.key, number));
    fits.then_some((row, channel))
}

fn table_row(key: Key) -> &'static Row {
    TABLE.iter().find(|row| row.key == key).expect("the table has a row for every key: tested")
}

fn encode_value(key: Key, value: &Value) -> String {
    match value {
        Value::Flag(on) => u8::from(*on).to_string(),
        Value::Count(count) => count.to_string(),
        // Periods with 9 decimals, always: a 9530 is upset by more (seen by users of its public driver).
        Value::Time(ps) => encode_time(*ps, key == Key::Period),
        Value::Volts(volts) => format!("{volts:.2}"),
        Value::Word(text) | Value::Text(text) => text.clone(),
    }
}

fn decode_value(key: Key, text: &str) -> Result<Value, &'static str> {
    match table_row(key).kind {
        Kind::Act => Err("no value belongs here"),
        Kind::Flag => match text.to_ascii_uppercase().as_str() {
            "0" | "OFF" => Ok(Value::Flag(false)),
            "1" | "ON" => Ok(Value::Flag(true)),
            _ => Err("expected 0 or 1"),
        },
        Kind::Count(least, greatest) => match text.parse() {
            Ok(count) if (least..=greatest).contains(&count) => Ok(Value::Count(count)),
            _ => Err("expected a whole number within its range"),
        },
        Kind::Time(least, greatest) => match decode_time(text) {
            Some(ps) if (least..=greatest).contains(&ps) => Ok(Value::Time(ps)),
            _ => Err("expected a time in seconds within its range"),
        },
        Kind::Volts(least, greatest) => match text.parse() {
            Ok(volts) if (least..=greatest).contains(&volts) => Ok(Value::Volts(volts)),
            _ => Err("expected a voltage within its range"),
        },
        Kind::Word(words) => words
            .iter()
            .find(|word| word_fits(word, text) != Fit::No)
            .map(|word| Value::Word(word.chars().filter(|c| !c.is_ascii_lowercase()).collect()))
            .ok_or("expected a word of the manual's list"),
        Kind::Text => Ok(Value::Text(text.to_owned())),
    }
}

/// Seconds in fixed point: 9 decimals, 12 where picoseconds need them and `only_ns` is not asked for.
fn encode_time(ps: i64, only_ns: bool) -> String {
    let sign = if ps < 0 { "-" } else { "" };
    let magnitude = ps.unsigned_abs();
    let (whole, part) = (magnitude / PS_PER_S.unsigned_abs(), magnitude % PS_PER_S.unsigned_abs());
    let (ns, rest) = (part / PS_PER_NS.unsigned_abs(), part % PS_PER_NS.unsigned_abs());
    if only_ns || rest == 0 {
        format!("{sign}{whole}.{ns:09}")
    } else {
        format!("{sign}{whole}.{ns:09}{rest:03}").trim_end_matches('0').to_owned()
    }
}

/// Seconds in fixed point to picoseconds, exactly; digits beyond are cut off as the unit does.
fn decode_time(text: &str) -> Option<i64> {
    let (magnitude, sign) = match text.strip_prefix('-') {
        Some(rest) => (rest, -1),
        None => (text.strip_prefix('+').unwrap_or(text), 1),
    };
    let (whole, part) = magnitude.split_once('.').unwrap_or((magnitude, ""));
    let are_digits = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_digit());
    if !are_digits(whole) || !are_digits(part) || (whole.is_empty() && part.is_empty()) || whole.len() > 6 {
        return None;
    }
    let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
    let part: i64 = format!("{part:0<12}")[..12].parse().ok()?;
    Some(sign * (whole * PS_PER_S + part))
}

// --------------------------------------------------------------------------------------------------- driver

/// What the rig allows; checked before anything is sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriggerLimits {
    /// Longest pulse that the injector (its coil, its driver) takes, in seconds.
    pub injector_pulse_max_s: f64,
    /// Shortest time between two injections, in seconds; also between the last of one burst and the first of the next.
    pub injection_interval_min_s: f64,
    /// Integration time of the camera, in seconds.
    pub camera_integration_s: f64,
    /// Time that the camera needs after an exposure before it takes the next trigger, in seconds: it does not expose
    /// while it reads out.
    pub camera_readout_s: f64,
}

/// The line settings of the RS-232 port at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// A 9520 or 575 at the end of a wire.
#[derive(Debug)]
pub struct Quantum9520 {
    wire: Wire,
    limits: TriggerLimits,
    programmed: Option<ShotProgram>,
    started: Option<Started>,
    last_injection: Option<Instant>,
}

/// A burst that was started.
#[derive(Debug, Clone)]
struct Started {
    program: ShotProgram,
    at: Instant,
}

impl Quantum9520 {
    /// A driver over an open wire. Sends nothing.
    pub fn new(mut wire: Wire, limits: TriggerLimits) -> Self {
        wire.adopt(LineHabits {
            ending: "\r\n",
            deadline: Duration::from_secs(1),
            pace: COMMAND_TIME,
            // No command with `*`: while the unit boots it may lock up (manual, chapter 7).
            sign: Some(Sign { query: ":INST:CAT?", fits: |line| line.starts_with("T0,") }),
            hint: "Check power, cable and baud rate (RS-232 comes with 115200, USB with 38400).",
        });
        Self { wire, limits, programmed: None, started: None, last_injection: None }
    }

    async fn exchange(&mut self, command: &Command, doing: &str) -> Result<Reply, DriverError> {
        let answer = self.wire.ask(&command.encode(), doing).await?;
        match Reply::decode(command.key, &answer) {
            Ok(Reply::Failed(error)) => {
                Err(self.refused(doing, format!("{} is answered by {error}", command.encode())))
            }
            Ok(reply) => Ok(reply),
            Err(why) => Err(self.wire.unexpected(doing, &answer, why)),
        }
    }

    /// An exchange that may be repeated without harm.
    async fn exchange_patiently(&mut self, command: &Command, doing: &str) -> Result<Reply, DriverError> {
        let mut tries = 0;
        loop {
            tries += 1;
            match self.exchange(command, doing).await {
                Err(DriverError::Silent { who, doing, waited, tries: 1, hint })
                    if tries >= EXCHANGE_TRIES =>
                {
                    return Err(DriverError::Silent { who, doing, waited, tries, hint });
                }
                Err(DriverError::Silent { tries: 1, .. }) => {}
                Err(DriverError::Garbled { .. }) if tries < EXCHANGE_TRIES => {}
                result => return result,
            }
        }
    }

    async fn query(&mut self, command: &Command, doing: &str) -> Result<Value, DriverError> {
        match self.exchange_patiently(command, doing).await? {
            Reply::Value(value) => Ok(value),
            _ => Err(self.wire.unexpected(doing, "ok", "expected a value")),
        }
    }

    async fn tell(&mut self, command: &Command, doing: &str) -> Result<(), DriverError> {
        match self.exchange_patiently(command, doing).await? {
            Reply::Done => Ok(()),
            reply => Err(self.wire.unexpected(doing, &reply.encode(command.key), "expected ok")),
        }
    }

    /// Tells a value and confirms it by its query.
    async fn set(&mut self, channel: u32, key: Key, value: Value, doing: &str) -> Result<(), DriverError> {
        self.tell(&Command::set_channel(channel, key, value.clone()), doing).await?;
        let taken = self.query(&Command::query_channel(channel, key), doing).await?;
        if taken == value {
            return Ok(());
        }
        let (told, taken) = (encode_value(key, &value), encode_value(key, &taken));
        let spelled = spell(table_row(key).spelling, Some(channel));
        Err(self.refused(doing, format!("{spelled}: told {told}, holds {taken}")))
    }

    async fn is_running(&mut self, doing: &str) -> Result<bool, DriverError> {
        let running = self.query(&Command::query(Key::Running), doing).await?;
        Ok(running == Value::Flag(true))
    }

    fn check(&self, program: &ShotProgram) -> Result<(), DriverError> {
        let ns = |ns: u64| Duration::from_nanos(ns).as_secs_f64();
        let limits = &self.limits;
        let period_s = ns(program.period_ns);
        let camera_s = limits.camera_integration_s + limits.camera_readout_s;
        let cycle_s = period_s * f64::from(program.cycle_periods);
        let pulses =
            u64::from(program.wait_periods) + u64::from(program.cycle_periods) * u64::from(program.cycles);
        let frames = u64::from(program.warm_up) + u64::from(program.blanks) + 1;
        let camera_end_ns = program.camera_delay_ns.saturating_add(program.camera_width_ns);
        let injector_end_ns = program.injector_delay_ns.saturating_add(program.injector_width_ns);
        let injector_s = ns(program.injector_width_ns);
        let limits_are_numbers = [
            limits.injector_pulse_max_s,
            limits.injection_interval_min_s,
            limits.camera_integration_s,
            limits.camera_readout_s,
        ]
        .iter()
        .all(|limit| limit.is_finite() && *limit >= 0.0);
        let complaint = if !limits_are_numbers {
            format!("the limits must be numbers from 0 on: {limits:?}")
        } else if !(50..=5_000_000_000_000).contains(&program.period_ns) {
            format!("period {period_s} s: the unit's clock goes from 50 ns to 5000 s")
        } else if program.cycles == 0 || pulses > COUNT_MAX {
            format!("{pulses} clock pulses in a burst: the unit counts from 1 to {COUNT_MAX}")
        } else if program.period_ns.saturating_mul(pulses) > BURST_MAX_NS {
            format!("a burst of {pulses} periods of {period_s} s would last for more than a year")
        } else if frames >= u64::from(program.cycle_periods) {
            format!("{frames} frames in a cycle of {} periods: no pause is left", program.cycle_periods)
        } else if period_s < camera_s {
            format!(
                "frames {period_s} s apart: exposure and read-out take {camera_s} s, and the camera is busy"
            )
        } else if program.camera_width_ns < 10 || camera_end_ns >= program.period_ns {
            format!("camera pulse ends {camera_end_ns} ns after the clock: it must end within one period")
        } else if program.inject && injector_s > limits.injector_pulse_max_s {
            format!("injector pulse {injector_s} s: the longest allowed is {} s", limits.injector_pulse_max_s)
        } else if program.inject && (program.injector_width_ns < 10 || injector_end_ns >= program.period_ns) {
            format!("injector pulse ends {injector_end_ns} ns after the clock: it must end within one period")
        } else if program.inject && cycle_s < limits.injection_interval_min_s {
            let least = limits.injection_interval_min_s;
            format!("injections {cycle_s} s apart: the shortest interval allowed is {least} s")
        } else {
            return Ok(());
        };
        Err(self.limit("programming a burst", complaint))
    }

    /// The injections of one burst keep their distance by its cycle; this keeps it between two bursts.
    fn check_interval(&self, program: &ShotProgram) -> Result<(), DriverError> {
        let Some(last) = self.last_injection.filter(|_| program.inject) else { return Ok(()) };
        let first_ns = program.frame_ns(0, program.warm_up + program.blanks);
        let first = Instant::now() + Duration::from_nanos(first_ns + program.injector_delay_ns);
        let interval_s = first.saturating_duration_since(last).as_secs_f64();
        let least = self.limits.injection_interval_min_s;
        if interval_s >= least {
            return Ok(());
        }
        let why = format!(
            "the last injection would be only {interval_s:.3} s before the first: {least} s are needed"
        );
        Err(self.limit("starting a burst", why))
    }

    /// Remembers when the injector was last fired, at the latest.
    fn note_last_injection(&mut self) {
        let Some(Started { program, at }) = self.started.take().filter(|started| started.program.inject)
        else {
            return;
        };
        let last_ns = program.frame_ns(program.cycles - 1, program.warm_up + program.blanks);
        let planned = at + Duration::from_nanos(last_ns + program.injector_delay_ns);
        self.last_injection = Some(planned.min(Instant::now()));
    }

    /// Injector channel off, then clock off; the second is done even if the first fails.
    async fn halt(&mut self, doing: &str) -> Result<(), DriverError> {
        let injector = self.set(INJECTOR_CHANNEL, Key::State, Value::Flag(false), doing).await;
        let clock = self.set(0, Key::State, Value::Flag(false), doing).await;
        self.note_last_injection();
        injector.and(clock)
    }

    fn refused(&self, doing: &str, why: String) -> DriverError {
        DriverError::Refused {
            who: self.wire.name().to_owned(),
            doing: doing.to_owned(),
            why,
            hint: "Check that nobody works at its front panel, and switch it off and on if it persists."
                .to_owned(),
        }
    }

    fn limit(&self, doing: &str, why: String) -> DriverError {
        DriverError::Limit {
            who: self.wire.name().to_owned(),
            doing: doing.to_owned(),
            why,
            hint: "Change the times of the plan, or the limit if the rig really allows it.".to_owned(),
        }
    }
}

fn time(ns: u64) -> Value {
    // Checked before: a period is at most 5000 s, and everything else ends within it.
    Value::Time(i64::try_from(ns).expect("times are below 5000 s") * PS_PER_NS)
}

fn count(pulses: u32) -> Value {
    Value::Count(u64::from(pulses))
}

/// The settings that make the unit repeat a program by itself.
///
/// The clock runs one burst of all pulses, pauses included. The camera's channel is on for the frames of a cycle and
/// off for the rest of it; the injector's is on for one pulse a cycle, and its wait count puts that pulse on the
/// last frame.
fn settings_of(program: &ShotProgram) -> Vec<(u32, Key, Value)> {
    let word = |text: &str| Value::Word(text.to_owned());
    let frames = program.frames_per_cycle();
    let spray_wait = program.wait_periods + program.warm_up + program.blanks;
    let burst = program.wait_periods + program.cycle_periods * program.cycles;
    let camera_off = program.cycle_periods - frames;
    let mut settings = vec![
        // Off first: a change of counts while a channel is on could let a pulse out.
        (INJECTOR_CHANNEL, Key::State, Value::Flag(false)),
        (0, Key::Period, time(program.period_ns)),
        (0, Key::Mode, word("BURS")),
        (0, Key::BurstCount, count(burst)),
        // With a trigger mode on, STATE 1 would only arm.
        (0, Key::TriggerMode, word("DIS")),
        (0, Key::GateMode, word("DIS")),
    ];
    for (channel, on, off, wait, delay_ns, width_ns) in [
        (
            CAMERA_CHANNEL,
            frames,
            camera_off,
            program.wait_periods,
            program.camera_delay_ns,
            program.camera_width_ns,
        ),
        (
            INJECTOR_CHANNEL,
            1,
            program.cycle_periods - 1,
            spray_wait,
            program.injector_delay_ns,
            program.injector_width_ns,
        ),
    ] {
        if channel == INJECTOR_CHANNEL && !program.inject {
            continue;
        }
        settings.extend([
            (channel, Key::Sync, word("T0")),
            (channel, Key::ChannelMode, word("DCYC")),
            (channel, Key::OnCount, count(on)),
            (channel, Key::OffCount, count(off)),
            (channel, Key::WaitCount, count(wait)),
            (channel, Key::Delay, time(delay_ns)),
            (channel, Key::Width, time(width_ns)),
            (channel, Key::State, Value::Flag(true)),
        ]);
    }
    settings
}

fn decode_identity(text: &str) -> Option<Identity> {
    let fields: Vec<_> = text.split(',').map(|field| field.trim().to_owned()).collect();
    let [maker, model, serial, firmware] = <[String; 4]>::try_from(fields).ok()?;
    Some(Identity { maker, model, serial, firmware })
}

#[async_trait]
impl TriggerUnit for Quantum9520 {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let doing = "asking who it is";
        // Answered only when the unit has booted; until then no command with `*` may be sent.
        self.is_running(doing).await?;
        self.tell(&Command::set(Key::Echo, Value::Flag(false)), "switching the echo off").await?;
        let answer = self.query(&Command::query(Key::Identity), doing).await?;
        let text = encode_value(Key::Identity, &answer);
        decode_identity(&text).ok_or_else(|| {
            self.wire.unexpected(doing, &text, "expected maker, model, serial number and version")
        })
    }

    async fn program(&mut self, program: &ShotProgram) -> Result<ShotProgram, DriverError> {
        let doing = "programming a burst";
        self.programmed = None;
        self.check(program)?;
        if self.is_running(doing).await? {
            return Err(self.refused(doing, "the unit still runs".to_owned()));
        }
        self.note_last_injection();
        let settings = settings_of(program);
        for (channel, key, value) in &settings {
            self.tell(&Command::set_channel(*channel, *key, value.clone()), doing).await?;
        }
        // Read back after everything is set: a later command may have moved an earlier value. The injector's channel
        // is in the list twice when it is used; only its last setting counts.
        for (index, (channel, key, value)) in settings.iter().enumerate() {
            let superseded = settings[index + 1..].iter().any(|later| later.0 == *channel && later.1 == *key);
            if superseded {
                continue;
            }
            let taken = self.query(&Command::query_channel(*channel, *key), doing).await?;
            if taken != *value {
                let (told, taken) = (encode_value(*key, value), encode_value(*key, &taken));
                let spelled = spell(table_row(*key).spelling, Some(*channel));
                return Err(self.refused(doing, format!("{spelled}: told {told}, holds {taken}")));
            }
        }
        self.programmed = Some(program.clone());
        Ok(program.clone())
    }

    async fn start(&mut self) -> Result<(), DriverError> {
        let doing = "starting a burst";
        let Some(program) = self.programmed.clone() else {
            return Err(self.refused(doing, "no burst has been programmed since the last error".to_owned()));
        };
        if self.is_running(doing).await? {
            return Err(self.refused(doing, "the unit still runs".to_owned()));
        }
        self.note_last_injection();
        self.check_interval(&program)?;
        let at = Instant::now();
        self.started = Some(Started { program: program.clone(), at });
        // Sent once: repeated after a lost answer it might start a second burst. Whether it was taken, the unit's
        // state tells.
        match self.exchange(&Command::set_channel(0, Key::State, Value::Flag(true)), doing).await {
            Ok(_) | Err(DriverError::Silent { .. } | DriverError::Garbled { .. }) => {}
            Err(error) => return Err(error),
        }
        let running = self.is_running(doing).await?;
        // A burst that is over already is no failure.
        if running || at.elapsed() >= Duration::from_nanos(program.burst_ns()) {
            return Ok(());
        }
        Err(self.refused(doing, "told to run, it does not run".to_owned()))
    }

    async fn running(&mut self) -> Result<bool, DriverError> {
        self.is_running("asking whether pulses are made").await
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        self.halt("stopping the clock").await
    }

    async fn make_safe(&mut self) -> Result<(), DriverError> {
        self.programmed = None;
        self.halt("bringing it to its safe state").await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_value(kind: Kind) -> BoxedStrategy<Option<Value>> {
        match kind {
            Kind::Act => Just(None).boxed(),
            Kind::Flag => any::<bool>().prop_map(|on| Some(Value::Flag(on))).boxed(),
            Kind::Count(least, greatest) => (least..=greatest).prop_map(|n| Some(Value::Count(n))).boxed(),
            Kind::Time(least, greatest) => {
                (least / 250..=greatest / 250).prop_map(|n| Some(Value::Time(n * 250))).boxed()
            }
            Kind::Volts(least, _) => {
                (0_u32..100).prop_map(move |n| Some(Value::Volts(least + f64::from(n) / 100.0))).boxed()
            }
            Kind::Word(words) => prop::sample::select(words)
                .prop_map(|word| {
                    Some(Value::Word(word.chars().filter(|c| !c.is_ascii_lowercase()).collect()))
                })
                .boxed(),
            Kind::Text => "[A-Z][A-Z ]{0,8}[A-Z]".prop_map(|text| Some(Value::Text(text))).boxed(),
        }
    }

    fn any_command() -> impl Strategy<Value = Command> {
        (0..TABLE.len(), 1_u32..8, any::<bool>()).prop_flat_map(|(index, number, asks)| {
            let row = &TABLE[index];
            let channel = match row.place {
                Place::Unit => None,
                Place::Clock => Some(0),
                _ => Some(number),
            };
            let asks = row.asks && (asks || !row.tells);
            any_value(row.kind).prop_map(move |value| {
                let value = match value {
                    // Periods have a grain of 10 ns.
                    Some(Value::Time(ps)) if row.key == Key::Period => {
                        Some(Value::Time(ps / 10_000 * 10_000))
                    }
                    other => other,
                };
                let act = if asks { Act::Query(None) } else { Act::Set(value) };
                Command { key: row.key, channel, act }
            })
        })
    }

    fn same(left: &Command, right: &Command) -> bool {
        match (&left.act, &right.act) {
            (Act::Set(Some(Value::Volts(a))), Act::Set(Some(Value::Volts(b)))) => {
                left.key == right.key && (a - b).abs() < 0.005
            }
            _ => left == right,
        }
    }

    proptest! {
        #[test]
        fn any_command_survives_the_line(command in any_command()) {
            let back = Command::decode(&command.encode());
            prop_assert!(back.as_ref().is_ok_and(|back| same(back, &command)), "{command:?} {back:?}");
        }

        #[test]
        fn any_reply_survives_the_line(command in any_command(), error in 0_usize..8) {
            let failed = Reply::Failed(UNIT_ERRORS[error]);
            prop_assert_eq!(Reply::decode(command.key, &failed.encode(command.key)), Ok(failed));
            prop_assert_eq!(Reply::decode(command.key, "ok"), Ok(Reply::Done));
            if let Act::Set(Some(value @ (Value::Flag(_) | Value::Count(_) | Value::Time(_) | Value::Word(_)))) =
                command.act
            {
                let reply = Reply::Value(value);
                prop_assert_eq!(Reply::decode(command.key, &reply.encode(command.key)), Ok(reply));
            }
        }

        #[test]
        fn no_line_makes_the_codec_panic(line in "[:*]?[ -~]{0,60}") {
            let _ = Command::decode(&line);
            for row in TABLE {
                let _ = Reply::decode(row.key, &line);
            }
        }
    }

    #[test]
    fn the_table_has_one_row_per_key() {
        for row in TABLE {
            assert_eq!(TABLE.iter().filter(|other| other.key == row.key).count(), 1, "{:?}", row.key);
        }
    }

    /// Examples of chapter 7.
    #[test]
    fn the_manuals_examples_are_read_and_written() {
        let width = Reply::decode(Key::Width, "0.000120000").unwrap();
        assert_eq!(width, Reply::Value(Value::Time(120_000_000)));
        assert_eq!(width.encode(Key::Width), "0.000120000");
        assert_eq!(Reply::decode(Key::Polarity, "NORM"), Ok(Reply::Value(Value::Word("NORM".to_owned()))));
        let period = Command::set_channel(0, Key::Period, Value::Time(20_000_000_000));
        assert_eq!(period.encode(), ":PULSE0:PER 0.020000000");
        let long = Command::decode(":pulse0:period 0.02");
        assert_eq!(long, Ok(period));
        assert_eq!(encode_time(DELAY_MAX_PS, false), "999.99999999975");
        assert_eq!(decode_time("-999.99999999975"), Some(-DELAY_MAX_PS));
        assert_eq!(Command::query(Key::Running).encode(), ":SYST:STAT?");
    }

    #[test]
    fn bad_commands_get_the_units_error_numbers() {
        use UnitError::{Keyword, MissingKeyword, MissingParameter, NoQuery, Parameter, Prefix, QueryOnly};
        for (line, error) in [
            ("PULSE1:STATE 1", Prefix),
            (":", MissingKeyword),
            (":PULSE1:", MissingKeyword),
            (":PULSE1:POLAR NORM", Keyword),
            (":PULSE1:PER 1", Keyword),
            (":PULSE0:WIDT 1", Keyword),
            (":PULSE1:WIDT", MissingParameter),
            (":PULSE1:WIDT 1e-3", Parameter),
            (":PULSE1:WIDT 1000", Parameter),
            (":PULSE1:POL POSITIVE", Parameter),
            (":PULSE0:BCO 0", Parameter),
            (":SYST:STAT 1", QueryOnly),
            ("*TRG?", NoQuery),
        ] {
            assert_eq!(Command::decode(line), Err(error), "{line}");
        }
    }
}
