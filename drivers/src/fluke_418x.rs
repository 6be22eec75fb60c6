//! Fluke 4180 and 4181 infrared calibrators: codec in both directions, and the driver over a wire.
//!
//! Manual: Fluke/Hart Scientific "4180, 4181 Precision Infrared Calibrator", Users Guide (rev. 812301-EN, 2007) and
//! Technical Guide: command table (line settings, commands, password groups), specifications (ranges, set-point limit
//! against emissivity, cooling before power-off). Knows no physics: whether a plate is really settled is judged
//! elsewhere.

use crate::error::DriverError;
use crate::instrument::{Calibrator, CalibratorSettings, Identity, PlateReading};
use crate::keyword::{Fit, path_fits, spell};
use crate::quantity::Kelvin;
use crate::wire::{LineHabits, Sign, Wire, WireSettings};
use async_trait::async_trait;
use std::time::Duration;

/// Below this block temperature the heater may be switched off, in °C. Users Guide, warnings: cool below 100 °C first.
const SWITCH_OFF_BELOW_C: f64 = 100.0;

/// Set-point of the safe state, in °C: the least of a 4181 (command table). A 4180 could be sent to −15 °C, where it
/// would gather ice; room temperature is its rest.
const SAFE_SET_POINT_C: f64 = 25.0;

/// The instrument takes set-points in steps of 0.01 °C (command table: 25.00 … 500.00).
const SET_POINT_STEPS_PER_C: f64 = 100.0;

/// How far a confirmed value may lie from what was sent: one step of the instrument.
const CONFIRM_TOLERANCE: f64 = 0.011;

/// Emissivity settings have three digits (`0.950`).
const CONFIRM_TOLERANCE_EMISSIVITY: f64 = 0.000_6;

/// Tries of one query, each followed by finding the thread again. A third failure in a row is no accident.
const QUERY_TRIES: u32 = 3;

/// Tries of one set that is not confirmed.
const SET_TRIES: u32 = 2;

/// Temperatures outside of this range, in °C, are noise on the line: well beyond what either model can show.
const PLAUSIBLE_C: std::ops::RangeInclusive<f64> = -60.0..=620.0;

/// Default bit rate (Users Guide, communications).
const BAUD: u32 = 9600;

// ---------------------------------------------------------------------------------------------------- codec

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
    let fields: Vec<_> = text.split(',').map(|field| field.trim().to_owned()).collect();
    match <[String; 4]>::try_from(fields) {
        Ok([maker, model, serial, firmware]) => Ok(Identity { maker, model, serial, firmware }),
        Err(_) => Err("expected maker, model, serial number and firmware"),
    }
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

// --------------------------------------------------------------------------------------------------- driver

/// The line settings at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// A 4180 or 4181 at the end of a wire.
#[derive(Debug)]
pub struct Fluke418x {
    wire: Wire,
    model: Option<Model>,
    settings: Option<CalibratorSettings>,
}

impl Fluke418x {
    /// A driver over an open wire. Sends nothing.
    pub fn new(mut wire: Wire) -> Self {
        wire.adopt(LineHabits {
            ending: "\r",
            // Replies come at once (Users Guide); one second is what a USB adapter under load may add, tenfold.
            deadline: Duration::from_secs(1),
            // Long enough for a doubled answer of 20 characters at 9600 baud to show itself.
            pace: Duration::from_millis(20),
            sign: Some(Sign { query: "*IDN?", fits: |line| line.matches(',').count() == 3 }),
            hint: "Check power, cable and baud rate; bad commands get silence, and only one program may use the line.",
        });
        Self { wire, model: None, settings: None }
    }

    async fn query<T>(
        &mut self,
        header: Header,
        decode: fn(&str) -> Result<T, &'static str>,
        doing: &str,
    ) -> Result<T, DriverError> {
        let question = Command::query(header).encode();
        let mut tries = 0;
        loop {
            tries += 1;
            let error = match self.wire.ask(&question, doing).await {
                Ok(answer) => match decode(&answer) {
                    Ok(value) => return Ok(value),
                    Err(why) => self.wire.unexpected(doing, &answer, why),
                },
                Err(error) => error,
            };
            match error {
                // A line that could not be found again is dead: more tries would only take longer.
                DriverError::Silent { tries: thread_tries, .. } if thread_tries > 1 => return Err(error),
                DriverError::Silent { .. } if tries >= QUERY_TRIES => {
                    return Err(self.explain_silence(error, tries, doing).await);
                }
                DriverError::Silent { .. } => {}
                DriverError::Garbled { .. } if tries < QUERY_TRIES => {}
                _ => return Err(error),
            }
        }
    }

    /// Bad commands get silence: after a time-out the error queue says whether it was the line or the command.
    async fn explain_silence(&mut self, silence: DriverError, tries: u32, doing: &str) -> DriverError {
        let DriverError::Silent { who, doing: act, waited, hint, .. } = silence else { return silence };
        // Asking finds the thread again first, since the wire is suspect.
        match self.wire.ask(&Command::query(Header::Error).encode(), doing).await {
            Ok(words) if is_complaint(&words) => {
                self.refused(doing, format!("the instrument says {words:?}"))
            }
            Ok(words) => DriverError::Silent {
                who,
                doing: act,
                waited,
                tries,
                hint: format!("It answers other queries; its last error is {words:?}. {hint}"),
            },
            Err(error) => error,
        }
    }

    /// Tells a value and confirms it by its query. A set has no reply, so one that was lost or garbled on the line is
    /// noticed only here, and told once more.
    async fn set_confirmed(
        &mut self,
        header: Header,
        value: f64,
        tolerance: f64,
        doing: &str,
    ) -> Result<f64, DriverError> {
        let mut held = f64::NAN;
        for _ in 0..SET_TRIES {
            self.wire.tell(&Command::set(header, value).encode(), doing).await?;
            held = self.query(header, decode_number, doing).await?;
            if (held - value).abs() <= tolerance {
                return Ok(held);
            }
        }
        let words = self.error_words(doing).await?;
        Err(self.refused(doing, format!("told {value}, holds {held}; the instrument says {words:?}")))
    }

    async fn error_words(&mut self, doing: &str) -> Result<String, DriverError> {
        self.query(Header::Error, |text| Ok(text.to_owned()), doing).await
    }

    /// Numbers in °C with a decimal point, whatever was set at the keypad.
    async fn force_formats(&mut self) -> Result<(), DriverError> {
        let doing = "setting the number format";
        self.wire.tell(&Command::set(Header::DecimalFormat, 0.0).encode(), doing).await?;
        if self.query(Header::DecimalFormat, decode_flag, doing).await? {
            return Err(self.refused(doing, "SYST:DEC:FORM stays 1 (decimal comma)".to_owned()));
        }
        let doing = "setting the unit";
        self.wire.tell(&Command::set_word(Header::Unit, "C").encode(), doing).await?;
        let unit = self.query(Header::Unit, |text| Ok(text.to_owned()), doing).await?;
        if !unit.eq_ignore_ascii_case("C") {
            return Err(self.refused(doing, format!("UNIT:TEMP stays {unit}")));
        }
        Ok(())
    }

    async fn check_cutout(&mut self, doing: &str) -> Result<(), DriverError> {
        if !self.query(Header::Tripped, decode_flag, doing).await? {
            return Ok(());
        }
        Err(DriverError::Interlock {
            who: self.wire.name().to_owned(),
            doing: doing.to_owned(),
            why: "a cutout has tripped: the plate neither heats nor cools".to_owned(),
            hint: "Find out why it became too hot, then clear the cutout at the keypad.".to_owned(),
        })
    }

    /// Locks the keypad, so that nobody changes a set-point during a campaign. Where the instrument asks for a
    /// password first it stays open, and that is no reason to stop.
    async fn try_keypad_lock(&mut self) -> Result<(), DriverError> {
        let doing = "locking the keypad";
        self.wire.tell(&Command::set(Header::KeypadLock, 1.0).encode(), doing).await?;
        if !self.query(Header::KeypadLock, decode_flag, doing).await? {
            // Takes the complaint off the queue, so that it does not explain a later failure.
            self.error_words(doing).await?;
        }
        Ok(())
    }

    fn check_target(
        &self,
        model: Model,
        settings: &CalibratorSettings,
        target_c: f64,
    ) -> Result<(), DriverError> {
        let doing = format!("setting {target_c:.2} °C");
        let limit_c = settings.limit.celsius();
        let (min_c, max_c) = (model.set_point_min_c(), model.set_point_max_c(settings.display_emissivity));
        if !target_c.is_finite() {
            Err(self.limit(&doing, "the set-point is not a number".to_owned()))
        } else if target_c > limit_c {
            Err(self.limit(&doing, format!("the configured limit is {limit_c:.2} °C")))
        } else if target_c < min_c || target_c > max_c {
            let model = model.encode();
            let emissivity = settings.display_emissivity;
            Err(self.limit(
                &doing,
                format!(
                    "a {model} goes from {min_c:.1} to {max_c:.1} °C at emissivity setting {emissivity:.3}"
                ),
            ))
        } else {
            Ok(())
        }
    }

    fn refused(&self, doing: &str, why: String) -> DriverError {
        DriverError::Refused {
            who: self.wire.name().to_owned(),
            doing: doing.to_owned(),
            why,
            hint:
                "Check at the keypad that the instrument is in its main menu and runs no program of its own."
                    .to_owned(),
        }
    }

    fn limit(&self, doing: &str, why: String) -> DriverError {
        DriverError::Limit {
            who: self.wire.name().to_owned(),
            doing: doing.to_owned(),
            why,
            hint: "Change the levels, or the limit if the rig really allows it.".to_owned(),
        }
    }
}

/// False for an empty error queue. What the instrument answers then is not documented; these are the usual texts.
fn is_complaint(words: &str) -> bool {
    let words = words.trim_matches(['"', ' ']).to_lowercase();
    !(words.is_empty() || words.starts_with("no error") || words.starts_with('0'))
}

#[async_trait]
impl Calibrator for Fluke418x {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let doing = "asking who it is";
        let identity = self.query(Header::Identity, decode_identity, doing).await?;
        // Only the model field tells: sister instruments answer with either maker's name.
        match Model::decode(&identity.model) {
            Some(model) => self.model = Some(model),
            None => {
                let model = &identity.model;
                return Err(DriverError::Refused {
                    who: self.wire.name().to_owned(),
                    doing: doing.to_owned(),
                    why: format!("it is a {model:?}, this driver is for 4180 and 4181"),
                    hint: "Check the address: another instrument may sit on this line.".to_owned(),
                });
            }
        }
        Ok(identity)
    }

    async fn prepare(&mut self, settings: &CalibratorSettings) -> Result<(), DriverError> {
        if self.model.is_none() {
            self.identify().await?;
        }
        self.settings = None;
        // Users Guide, command table: SOUR:EMIS, SOUR:RATE, SOUR:STAB:LIM.
        let stability_k = settings.stability.0;
        if !settings.limit.0.is_finite() {
            return Err(self.limit("preparing", "the configured limit is not a number".to_owned()));
        }
        for (name, value, least, greatest) in [
            ("emissivity setting", settings.display_emissivity, 0.9, 1.0),
            ("scan rate in K per minute", settings.rate_k_per_min, 0.1, 500.0),
            ("stability limit in K", stability_k, 0.01, 5.0),
        ] {
            if !(least..=greatest).contains(&value) {
                return Err(
                    self.limit("preparing", format!("{name} {value}: legal is {least} to {greatest}"))
                );
            }
        }
        self.wire.tell(&Command::act(Header::ClearStatus).encode(), "clearing the status").await?;
        self.force_formats().await?;
        self.check_cutout("checking the cutouts").await?;
        self.try_keypad_lock().await?;
        let emissivity = settings.display_emissivity;
        self.set_confirmed(
            Header::Emissivity,
            emissivity,
            CONFIRM_TOLERANCE_EMISSIVITY,
            "setting the display's emissivity",
        )
        .await?;
        self.set_confirmed(
            Header::StabilityLimit,
            stability_k,
            CONFIRM_TOLERANCE,
            "setting the stability limit",
        )
        .await?;
        self.set_confirmed(Header::Rate, settings.rate_k_per_min, CONFIRM_TOLERANCE, "setting the scan rate")
            .await?;
        self.settings = Some(settings.clone());
        Ok(())
    }

    async fn set_point(&mut self, target: Kelvin) -> Result<Kelvin, DriverError> {
        let target_c = (target.celsius() * SET_POINT_STEPS_PER_C).round() / SET_POINT_STEPS_PER_C;
        let doing = format!("setting {target_c:.2} °C");
        let (Some(model), Some(settings)) = (self.model, self.settings.clone()) else {
            return Err(
                self.limit(&doing, "the limits are not known before the instrument is prepared".to_owned())
            );
        };
        self.check_target(model, &settings, target_c)?;
        self.check_cutout(&doing).await?;
        let taken = self.set_confirmed(Header::SetPoint, target_c, CONFIRM_TOLERANCE, &doing).await?;
        self.set_confirmed(Header::OutputState, 1.0, CONFIRM_TOLERANCE, "switching the output on").await?;
        Ok(Kelvin::from_celsius(taken))
    }

    async fn read(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "reading the plate";
        Ok(PlateReading {
            apparent: Kelvin::from_celsius(self.query(Header::Temperature, decode_celsius, doing).await?),
            block: Kelvin::from_celsius(self.query(Header::Block, decode_celsius, doing).await?),
            set_point: Kelvin::from_celsius(self.query(Header::SetPoint, decode_celsius, doing).await?),
            stable: self.query(Header::Stable, decode_flag, doing).await?,
            tripped: self.query(Header::Tripped, decode_flag, doing).await?,
        })
    }

    async fn make_safe(&mut self) -> Result<PlateReading, DriverError> {
        // A unit that does not confirm its formats is sent to its rest all the same; the trouble is told at the end.
        let formats = self.force_formats().await;
        let doing = "sending the plate to its rest";
        self.set_confirmed(Header::SetPoint, SAFE_SET_POINT_C, CONFIRM_TOLERANCE, doing).await?;
        // The display may fail where the block's sensor does not, and only the latter decides.
        let block_c = self.query(Header::Block, decode_celsius, doing).await?;
        if block_c < SWITCH_OFF_BELOW_C {
            self.set_confirmed(Header::OutputState, 0.0, CONFIRM_TOLERANCE, "switching the output off")
                .await?;
        }
        let apparent = self.query(Header::Temperature, decode_celsius, doing).await;
        let reading = PlateReading {
            apparent: Kelvin::from_celsius(apparent.unwrap_or(block_c)),
            block: Kelvin::from_celsius(block_c),
            set_point: Kelvin::from_celsius(SAFE_SET_POINT_C),
            stable: self.query(Header::Stable, decode_flag, doing).await?,
            tripped: self.query(Header::Tripped, decode_flag, doing).await?,
        };
        // Whoever comes to the rig now needs the keypad. Where a password is asked for it was never locked.
        self.wire.tell(&Command::set(Header::KeypadLock, 0.0).encode(), "unlocking the keypad").await?;
        formats.map(|_| reading)
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

    #[test]
    fn an_empty_error_queue_is_no_complaint() {
        assert!(is_complaint("command protected"));
        assert!(!is_complaint("no error"));
        assert!(!is_complaint("0,\"No error\""));
        assert!(!is_complaint("\"\""));
    }
}
