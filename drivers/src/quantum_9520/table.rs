//! The command table of chapter 7: every key with its spelling, its place, its kind of value and its access.

use super::{COUNT_MAX, PS_PER_NS, PS_PER_S};
use crate::keyword::{Fit, path_fits};

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
pub(super) enum Place {
    /// Not below `:PULSE`.
    Unit,
    /// Channel 0, the system clock.
    Clock,
    /// Channels 1 and up.
    Channel,
    /// Both.
    Any,
}

/// One line of the table.
pub(super) struct Row {
    pub(super) key: Key,
    /// As the manual's examples write it, and as the driver sends it.
    pub(super) spelling: &'static str,
    /// Capitals are the short form.
    pattern: &'static str,
    pub(super) place: Place,
    pub(super) kind: Kind,
    pub(super) asks: bool,
    pub(super) tells: bool,
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
/// Longest width and delay, in picoseconds.
pub(super) const DELAY_MAX_PS: i64 = 999_999_999_999_750;
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
pub(super) const TABLE: &[Row] = &[
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

/// The row if the path is its, with the channel's number.
pub(super) fn fit(row: &'static Row, path: &str) -> Option<(&'static Row, Option<u32>)> {
    let Fit::Yes(channel) = path_fits(row.pattern, path) else { return None };
    let fits = channel.is_none_or(|number| belongs_to(row.key, number));
    fits.then_some((row, channel))
}

/// The row of a key.
pub(super) fn table_row(key: Key) -> &'static Row {
    TABLE.iter().find(|row| row.key == key).expect("the table has a row for every key: tested")
}
