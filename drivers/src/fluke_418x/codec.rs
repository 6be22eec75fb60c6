//! The command language of the 4180 and 4181, both directions: commands to bytes and back, replies to bytes and back.

use crate::instrument::Identity;
use crate::keyword::{Fit, path_fits, spell};

/// Temperatures outside of this range, in °C, are noise on the line: well beyond what either model can show.
const PLAUSIBLE_C: std::ops::RangeInclusive<f64> = -60.0..=620.0;

/// What a command is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "the command table below says what each one is")]
pub enum Header {
    Identity,
    ClearStatus,
    OutputState,
    OutputDuty,
    SetPoint,
    Temperature,
    Block,
    Rate,
    StabilityLimit,
    Stability,
    Stable,
    StableBeep,
    Emissivity,
    CalibrationEmissivity,
    CalibrationWavelength,
    CalibrationConstant,
    CalibrationDate,
    ProportionalBand,
    Integral,
    Derivative,
    Preset,
    SoftCutout,
    HardCutout,
    Tripped,
    ClearCutout,
    Error,
    Baud,
    Linefeed,
    DecimalFormat,
    Version,
    KeypadBeep,
    KeypadLock,
    PasswordEnable,
    PasswordDisable,
    PasswordState,
    Unit,
}

/// Whether a header can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Write {
    /// Only read.
    No,
    /// An act without a parameter.
    Act,
    /// With a parameter.
    Value,
    /// With a parameter; refused without password access when the instrument is set so.
    Conditional,
    /// With a parameter; always refused without password access.
    Protected,
}

struct Row {
    header: Header,
    /// As the manual's table writes it, and as the driver sends it.
    spelling: &'static str,
    /// Short form in capitals.
    pattern: &'static str,
    read: bool,
    write: Write,
}

const fn row(header: Header, spelling: &'static str, pattern: &'static str, read: bool, write: Write) -> Row {
    Row { header, spelling, pattern, read, write }
}

/// The command table of the Users Guide, without the unit's own ramp programs.
const TABLE: &[Row] = &[
    row(Header::Identity, "*IDN", "*IDN", true, Write::No),
    row(Header::ClearStatus, "*CLS", "*CLS", false, Write::Act),
    row(Header::OutputState, "OUTP:STAT", "OUTPut:STATe", true, Write::Value),
    row(Header::OutputDuty, "OUTP:DATA", "OUTPut:DATA", true, Write::No),
    row(Header::SetPoint, "SOUR:SPO", "SOURce:SPOint", true, Write::Value),
    row(Header::Temperature, "SOUR:SENS:DATA", "SOURce:SENSe:DATA", true, Write::No),
    row(Header::Block, "SOUR:SENS:BLOC", "SOURce:SENSe:BLOCk", true, Write::No),
    row(Header::Rate, "SOUR:RATE", "SOURce:RATE", true, Write::Value),
    row(Header::StabilityLimit, "SOUR:STAB:LIM", "SOURce:STABility:LIMit", true, Write::Value),
    row(Header::Stability, "SOUR:STAB:DAT", "SOURce:STABility:DATa", true, Write::No),
    row(Header::Stable, "SOUR:STAB:TEST", "SOURce:STABility:TEST", true, Write::No),
    row(Header::StableBeep, "SOUR:STAB:BEEP", "SOURce:STABility:BEEPer", true, Write::Value),
    row(Header::Emissivity, "SOUR:EMIS", "SOURce:EMISsivity", true, Write::Value),
    row(Header::CalibrationEmissivity, "SOUR:CAL:EMIS", "SOURce:CALibrate:EMISsivity", true, Write::No),
    row(Header::CalibrationWavelength, "SOUR:CAL:WAV", "SOURce:CALibrate:WAVelength", true, Write::Value),
    row(Header::CalibrationConstant, "SOUR:CAL:PAR#", "SOURce:CALibrate:PAR#", true, Write::Protected),
    row(Header::CalibrationDate, "SOUR:CAL:DATE", "SOURce:CALibrate:DATE", true, Write::Protected),
    row(Header::ProportionalBand, "SOUR:LCON:PBAN", "SOURce:LCONstant:PBANd", true, Write::Protected),
    row(Header::Integral, "SOUR:LCON:INT", "SOURce:LCONstant:INTegral", true, Write::Protected),
    row(Header::Derivative, "SOUR:LCON:DER", "SOURce:LCONstant:DERivative", true, Write::Protected),
    row(Header::Preset, "SOUR:LIST:SPO#", "SOURce:LIST:SPOint#", true, Write::Value),
    row(
        Header::SoftCutout,
        "SOUR:PROT:SCUT:LEV",
        "SOURce:PROTection:SCUTout:LEVel",
        true,
        Write::Conditional,
    ),
    row(Header::HardCutout, "SOUR:PROT:HCUT", "SOURce:PROTection:HCUTout", true, Write::No),
    row(Header::Tripped, "SOUR:PROT:TRIP", "SOURce:PROTection:TRIPped", true, Write::No),
    row(Header::ClearCutout, "SOUR:PROT:CLEA", "SOURce:PROTection:CLEAr", false, Write::Act),
    row(Header::Error, "SYST:ERR", "SYSTem:ERRor", true, Write::No),
    row(Header::Baud, "SYST:COMM:SER:BAUD", "SYSTem:COMMunicate:SERial:BAUD", true, Write::Value),
    row(Header::Linefeed, "SYST:COMM:SER:LIN", "SYSTem:COMMunicate:SERial:LINefeed", true, Write::Value),
    row(Header::DecimalFormat, "SYST:DEC:FORM", "SYSTem:DECimal:FORMat", true, Write::Value),
    row(Header::Version, "SYST:COD:VERS", "SYSTem:CODe:VERSion", true, Write::No),
    row(Header::KeypadBeep, "SYST:BEEP:KEYB", "SYSTem:BEEPer:KEYBoard", true, Write::Value),
    row(Header::KeypadLock, "SYST:KLOC", "SYSTem:KLOCk", true, Write::Conditional),
    row(Header::PasswordEnable, "SYST:PASS:CEN", "SYSTem:PASSword:CENable", false, Write::Value),
    row(Header::PasswordDisable, "SYST:PASS:CDIS", "SYSTem:PASSword:CDISable", false, Write::Act),
    row(Header::PasswordState, "SYST:PASS:CEN:STAT", "SYSTem:PASSword:CENable:STATe", true, Write::No),
    row(Header::Unit, "UNIT:TEMP", "UNIT:TEMPerature", true, Write::Value),
];

/// A parameter.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A number; `ON` and `OFF` are 1 and 0.
    Number(f64),
    /// `MIN`: the least legal value.
    Least,
    /// `MAX`: the greatest legal value.
    Greatest,
    /// `DEF`: the value at delivery.
    Default,
    /// Any other word, in capitals.
    Word(String),
}

/// Whether a command asks or tells.
#[derive(Debug, Clone, PartialEq)]
pub enum Act {
    /// Asks, possibly with a word such as `MAX`.
    Query(Option<Value>),
    /// Tells, with its parameters.
    Set(Vec<Value>),
}

/// One command.
///
/// ```
/// use ditd_drivers::fluke_418x::{Command, Header};
/// let command = Command::set(Header::SetPoint, 50.0);
/// assert_eq!(command.encode(), "SOUR:SPO 50");
/// assert_eq!(Command::decode("source:spoint 50.00 C"), Ok(command));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// What it is about.
    pub header: Header,
    /// The number of a preset or a calibration constant.
    pub number: Option<u32>,
    /// What is done.
    pub act: Act,
}

/// Why a line is no command. The text is what the instrument side puts into its error queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// No such command.
    #[error("undefined header")]
    Undefined,
    /// A number is missing at the header's end.
    #[error("Header suffix out of range")]
    Suffix,
    /// It can only be told.
    #[error("query not allowed")]
    NoQuery,
    /// It can only be asked.
    #[error("query only")]
    QueryOnly,
    /// It needs a parameter.
    #[error("missing parameter")]
    Missing,
    /// It takes no parameter, or not so many.
    #[error("parameter not allowed")]
    TooMany,
    /// The parameter is no number and no word that is known.
    #[error("data type error")]
    Type,
}

impl Command {
    /// A query.
    pub fn query(header: Header) -> Self {
        Self { header, number: None, act: Act::Query(None) }
    }

    /// A set with a number.
    pub fn set(header: Header, number: f64) -> Self {
        Self { header, number: None, act: Act::Set(vec![Value::Number(number)]) }
    }

    /// A set with a word.
    pub fn set_word(header: Header, word: &str) -> Self {
        Self { header, number: None, act: Act::Set(vec![Value::Word(word.to_owned())]) }
    }

    /// An act without a parameter.
    pub fn act(header: Header) -> Self {
        Self { header, number: None, act: Act::Set(Vec::new()) }
    }

    /// The command as sent, without its line end.
    pub fn encode(&self) -> String {
        let spelled = spell(table_row(self.header).spelling, self.number);
        match &self.act {
            Act::Query(None) => format!("{spelled}?"),
            Act::Query(Some(value)) => format!("{spelled}? {}", encode_value(value)),
            Act::Set(values) if values.is_empty() => spelled,
            Act::Set(values) => {
                let values: Vec<_> = values.iter().map(encode_value).collect();
                format!("{spelled} {}", values.join(","))
            }
        }
    }

    /// Reads a line as the instrument does: short or long forms, any case, units ignored.
    ///
    /// # Errors
    /// [`CommandError`] says what the instrument would put into its error queue.
    pub fn decode(line: &str) -> Result<Self, CommandError> {
        let line = line.trim();
        let (head, parameters) = line.split_once(' ').unwrap_or((line, ""));
        let (path, asks) = match head.strip_suffix('?') {
            Some(path) => (path, true),
            None => (head, false),
        };
        let (row, number) = TABLE
            .iter()
            .find_map(|row| match path_fits(row.pattern, path) {
                Fit::Yes(number) => Some((row, number)),
                Fit::No => None,
            })
            .ok_or(CommandError::Undefined)?;
        if row.pattern.ends_with('#') && number.is_none() {
            return Err(CommandError::Suffix);
        }
        let values = parameters
            .split(',')
            .map(str::trim)
            .filter(|text| !text.is_empty())
            .map(decode_value)
            .collect::<Result<Vec<_>, _>>()?;
        let act = if asks { read_act(row, values)? } else { write_act(row, values)? };
        Ok(Self { header: row.header, number, act })
    }
}

/// Whether the header can be written, and under which protection.
pub fn write_access(header: Header) -> Write {
    table_row(header).write
}

fn read_act(row: &Row, values: Vec<Value>) -> Result<Act, CommandError> {
    if !row.read {
        return Err(CommandError::NoQuery);
    }
    let mut values = values.into_iter();
    let first = values.next();
    if values.next().is_some() { Err(CommandError::TooMany) } else { Ok(Act::Query(first)) }
}

fn write_act(row: &Row, values: Vec<Value>) -> Result<Act, CommandError> {
    // A calibration date has three parameters, everything else one.
    let most = if row.header == Header::CalibrationDate { 3 } else { 1 };
    match row.write {
        Write::No => Err(CommandError::QueryOnly),
        Write::Act if values.is_empty() => Ok(Act::Set(values)),
        Write::Act => Err(CommandError::TooMany),
        _ if values.is_empty() => Err(CommandError::Missing),
        _ if values.len() > most => Err(CommandError::TooMany),
        _ => Ok(Act::Set(values)),
    }
}

fn table_row(header: Header) -> &'static Row {
    TABLE.iter().find(|row| row.header == header).expect("the table has a row for every header: tested")
}

fn encode_value(value: &Value) -> String {
    match value {
        Value::Number(number) => number.to_string(),
        Value::Least => "MIN".to_owned(),
        Value::Greatest => "MAX".to_owned(),
        Value::Default => "DEF".to_owned(),
        Value::Word(word) => word.clone(),
    }
}

fn decode_value(text: &str) -> Result<Value, CommandError> {
    let word = text.to_ascii_uppercase();
    match word.as_str() {
        "MIN" | "MINIMUM" => return Ok(Value::Least),
        "MAX" | "MAXIMUM" => return Ok(Value::Greatest),
        "DEF" | "DEFAULT" => return Ok(Value::Default),
        "ON" => return Ok(Value::Number(1.0)),
        "OFF" => return Ok(Value::Number(0.0)),
        _ => {}
    }
    // A unit suffix is accepted and ignored.
    let unitless = word.trim_end_matches(|c: char| c.is_ascii_alphabetic()).trim_end();
    if let Ok(number) = decode_number(&word).or_else(|_| decode_number(unitless)) {
        Ok(Value::Number(number))
    } else if word.starts_with(|c: char| c.is_ascii_alphabetic()) {
        Ok(Value::Word(word))
    } else {
        Err(CommandError::Type)
    }
}

/// Writes a number of a reply with so many digits after the point; `comma` is the state of `SYST:DEC:FORM`.
pub fn encode_number(number: f64, digits: usize, comma: bool) -> String {
    let text = format!("{number:.digits$}");
    if comma { text.replace('.', ",") } else { text }
}

/// Reads a number of a reply.
///
/// # Errors
/// Says what is wrong: a comma, not a number, or not finite.
pub fn decode_number(text: &str) -> Result<f64, &'static str> {
    if text.contains(',') {
        return Err("a decimal comma: SYST:DEC:FORM is not 0");
    }
    let is_number = text.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    match text.parse::<f64>() {
        Ok(number) if is_number && number.is_finite() => Ok(number),
        _ => Err("expected a number"),
    }
}

/// Reads a temperature of a reply, in °C.
///
/// # Errors
/// As [`decode_number`], and for values that neither model can show.
pub fn decode_celsius(text: &str) -> Result<f64, &'static str> {
    let celsius = decode_number(text)?;
    if PLAUSIBLE_C.contains(&celsius) {
        Ok(celsius)
    } else {
        Err("a temperature that this plate cannot have")
    }
}

/// Reads a 0 or a 1 of a reply.
///
/// # Errors
/// When it is neither.
pub fn decode_flag(text: &str) -> Result<bool, &'static str> {
    match text {
        "0" => Ok(false),
        "1" => Ok(true),
        _ => Err("expected 0 or 1"),
    }
}

/// Writes the reply to `*IDN?`.
pub fn encode_identity(identity: &Identity) -> String {
    format!("{},{},{},{}", identity.maker, identity.model, identity.serial, identity.firmware)
}

/// Reads the reply to `*IDN?`.
///
/// # Errors
/// When it has not four fields.
pub fn decode_identity(text: &str) -> Result<Identity, &'static str> {
    Identity::of_fields(text).ok_or("expected maker, model, serial number and firmware")
}

/// The two models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Model {
    /// −15 … 120 °C, heats and cools.
    #[serde(rename = "4180")]
    Fluke4180,
    /// 35 … 500 °C, heats.
    #[serde(rename = "4181")]
    Fluke4181,
}

impl Model {
    /// Reads the model field of the identity; `None` for any other instrument.
    pub fn decode(field: &str) -> Option<Self> {
        match field {
            "4180" => Some(Self::Fluke4180),
            "4181" => Some(Self::Fluke4181),
            _ => None,
        }
    }

    /// The model field of the identity.
    pub fn encode(self) -> &'static str {
        match self {
            Self::Fluke4180 => "4180",
            Self::Fluke4181 => "4181",
        }
    }

    /// Least set-point in °C (command table).
    pub fn set_point_min_c(self) -> f64 {
        match self {
            Self::Fluke4180 => -15.0,
            Self::Fluke4181 => 25.0,
        }
    }

    /// Greatest set-point in °C at an emissivity setting.
    ///
    /// 4181: Technical Guide, table of set-point limits: 500.0 °C up to 0.95, then 3.4 °C less per 0.01, linear between.
    pub fn set_point_max_c(self, display_emissivity: f64) -> f64 {
        match self {
            Self::Fluke4180 => 120.0,
            Self::Fluke4181 => 500.0 - 340.0 * (display_emissivity - 0.95).max(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_has_one_row_per_header_and_reads_its_own_spelling() {
        for row in TABLE {
            assert_eq!(TABLE.iter().filter(|other| other.header == row.header).count(), 1);
            let number = row.spelling.contains('#').then_some(2);
            if row.read {
                let query = Command { number, ..Command::query(row.header) };
                assert_eq!(Command::decode(&query.encode()), Ok(query));
            }
            if row.write == Write::Act {
                let act = Command::act(row.header);
                assert_eq!(Command::decode(&act.encode()), Ok(act));
            }
        }
    }

    fn any_value() -> impl Strategy<Value = Value> {
        prop_oneof![
            (-1_000_000_i32..1_000_000).prop_map(|n| Value::Number(f64::from(n) / 1000.0)),
            any::<f64>().prop_filter("finite", |x| x.is_finite()).prop_map(Value::Number),
            Just(Value::Least),
            Just(Value::Greatest),
            Just(Value::Default),
            Just(Value::Word("F".to_owned())),
        ]
    }

    proptest! {
        #[test]
        fn any_command_survives_the_line(
            index in 0..TABLE.len(), value in any_value(), number in 1_u32..9, asks: bool,
        ) {
            let row = &TABLE[index];
            let act = match (asks, row.write) {
                (true, _) if row.read => Act::Query(None),
                (_, Write::No) => Act::Query(None),
                (_, Write::Act) => Act::Set(vec![]),
                _ => Act::Set(vec![value]),
            };
            let number = row.spelling.contains('#').then_some(number);
            let command = Command { header: row.header, number, act };
            prop_assert_eq!(Command::decode(&command.encode()), Ok(command.clone()));
            prop_assert_eq!(Command::decode(&command.encode().to_lowercase()), Ok(command));
        }

        #[test]
        fn any_temperature_survives_the_line(milli in -60_000_i32..600_000) {
            let celsius = f64::from(milli) / 1000.0;
            let back = decode_celsius(&encode_number(celsius, 3, false)).unwrap();
            prop_assert!((back - celsius).abs() < 1e-9);
            prop_assert!(decode_celsius(&encode_number(celsius, 3, true)).is_err());
        }

        #[test]
        fn no_line_makes_the_codec_panic(line in "[ -~]{0,60}") {
            drop(Command::decode(&line));
            let _ = decode_celsius(&line);
            drop(decode_identity(&line));
        }
    }

    #[test]
    fn the_manuals_examples_are_read() {
        let set = Command::decode("SOUR:SPO 50.00").unwrap();
        assert_eq!(set, Command::set(Header::SetPoint, 50.0));
        for line in ["source:spoint 50", "SOUR:SPO 5.0E1", "SOUR:SPO +50.00C", "SOUR:SPO 50 C"] {
            assert_eq!(Command::decode(line).as_ref(), Ok(&set), "{line}");
        }
        assert_eq!(Command::decode("OUTP:STAT ON"), Ok(Command::set(Header::OutputState, 1.0)));
        let identity = decode_identity("FLUKE,4180,A79002,1.00").unwrap();
        assert_eq!(Model::decode(&identity.model), Some(Model::Fluke4180));
        assert_eq!(encode_identity(&identity), "FLUKE,4180,A79002,1.00");
        assert_eq!(decode_number("24.091"), Ok(24.091));
        assert_eq!(Command::decode("SOUR:STAB:DAT?"), Ok(Command::query(Header::Stability)));
        assert_eq!(
            Command::decode("SOUR:SENS:DATA? BLOC").unwrap().act,
            Act::Query(Some(Value::Word("BLOC".to_owned())))
        );
    }

    #[test]
    fn bad_commands_are_named() {
        use CommandError::{Missing, NoQuery, QueryOnly, Suffix, TooMany, Type, Undefined};
        for (line, error) in [
            ("SOUR:SPOI 50", Undefined),
            ("OUTP:STAT 1;SOUR:SPO 50", Undefined),
            ("SOUR:LIST:SPO 50", Suffix),
            ("*CLS?", NoQuery),
            ("OUTP:DATA 5", QueryOnly),
            ("SOUR:SPO", Missing),
            ("SOUR:SPO 50,60", TooMany),
            ("SOUR:SPO 5x0", Type),
        ] {
            let got = Command::decode(line);
            // A compound command is read as a bad parameter, as on the instrument nothing is answered.
            assert!(got == Err(error) || line.contains(';') && got.is_err(), "{line}: {got:?}");
        }
    }

    #[test]
    fn what_is_no_number_is_rejected() {
        for text in ["24,091", "NaN", "inf", "-inf", "", "24.0.1", "2 4", "1e999", "0x10", "infinity"] {
            assert!(decode_number(text).is_err(), "{text}");
        }
        assert!(decode_celsius("2409.1").is_err());
        assert!(decode_flag("2").is_err());
    }

    /// Technical Guide, table of the 4181's set-point limit against the emissivity setting.
    #[test]
    fn set_point_limits_are_the_manuals_table() {
        for (emissivity, limit_c) in [
            (0.90, 500.0),
            (0.95, 500.0),
            (0.96, 496.6),
            (0.97, 493.2),
            (0.98, 489.8),
            (0.99, 486.4),
            (1.0, 483.0),
        ] {
            assert!((Model::Fluke4181.set_point_max_c(emissivity) - limit_c).abs() < 1e-9, "{emissivity}");
        }
    }
}
