//! The instrument's side of a Fluke 4180 or 4181 infrared calibrator on a stream of bytes.
//!
//! Same codec as the driver, same manual (Users Guide rev. 812301-EN, 2007): replies end with CR alone unless told
//! otherwise, sets are silent, bad commands get silence and an entry in the error queue, a reply that was not read
//! before the next command is lost. Knows no heat: that is the plate's.

use crate::rig::line::{Line, LineFault, Unsent, check_seconds};
use crate::rig::plate::Plate;
use ditd_drivers::fluke_418x::{
    Act, Command, CommandError, Header, Model, Value, Write, encode_identity, encode_number, write_access,
};
use ditd_drivers::instrument::Identity;
use ditd_drivers::quantity::Kelvin;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

/// Entries that the error queue keeps; older ones fall out.
const ERRORS_MAX: usize = 16;

/// Password at delivery (Users Guide).
const PASSWORD: f64 = 1234.0;

/// What a calibrator is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlukeBehaviour {
    /// Which model it says it is.
    #[serde(default = "FlukeBehaviour::paper_model")]
    pub model: Model,
    /// Time from a query to its reply, in seconds.
    #[serde(default = "FlukeBehaviour::reply_delay_s")]
    pub reply_delay_s: f64,
    /// Replies end with CR LF instead of CR alone.
    #[serde(default)]
    pub linefeed: bool,
    /// It was left in degrees Fahrenheit.
    #[serde(default)]
    pub fahrenheit: bool,
    /// It was left with a decimal comma.
    #[serde(default)]
    pub decimal_comma: bool,
    /// Conditional protection is on: keypad lock and soft cutout ask for the password.
    #[serde(default)]
    pub protected: bool,
    /// Level of its soft cutout in °C; as delivered when absent.
    pub soft_cutout_c: Option<f64>,
    /// Somebody sets it to °F at the keypad at this time, in seconds of the rig's clock.
    pub fahrenheit_at_s: Option<f64>,
    /// Somebody switches its output off at this time, in seconds of the rig's clock.
    pub output_off_at_s: Option<f64>,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub faults: Vec<LineFault>,
}

impl FlukeBehaviour {
    /// A 4181 as delivered.
    pub fn fluke_4181() -> Self {
        Self {
            model: Self::paper_model(),
            reply_delay_s: Self::reply_delay_s(),
            linefeed: false,
            fahrenheit: false,
            decimal_comma: false,
            protected: false,
            soft_cutout_c: None,
            fahrenheit_at_s: None,
            output_off_at_s: None,
            faults: Vec::new(),
        }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_seconds("reply_delay_s", self.reply_delay_s)?;
        self.fahrenheit_at_s.iter().try_for_each(|at_s| check_seconds("fahrenheit_at_s", *at_s))?;
        self.output_off_at_s.iter().try_for_each(|at_s| check_seconds("output_off_at_s", *at_s))?;
        if self.soft_cutout_c.is_some_and(|level| !(0.0..=520.0).contains(&level)) {
            return Err("soft_cutout_c: 0 to 520".to_owned());
        }
        self.faults.iter().try_for_each(LineFault::check)
    }

    fn paper_model() -> Model {
        Model::Fluke4181
    }

    /// The manual says "at once"; 10 ms is what a reply of some ten characters takes at 9600 baud.
    fn reply_delay_s() -> f64 {
        0.010
    }
}

/// Answers on a stream until the other side has gone. `start` is the zero of the rig's clock, which the plate shares.
///
/// # Panics
/// When another user of the plate has panicked while holding it, or the behaviour fails its check.
pub async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    plate: Arc<Mutex<Plate>>,
    behaviour: FlukeBehaviour,
    start: Instant,
) {
    assert_eq!(behaviour.check(), Ok(()), "the behaviour was checked where it was read");
    let delay = Duration::from_secs_f64(behaviour.reply_delay_s);
    let mut line = Line::new(stream, behaviour.faults.clone(), Unsent::Lost, start);
    let mut unit = Unit::new(&behaviour, plate);
    while let Some(command) = line.next_command().await {
        unit.look(line.now_s());
        let answered = match command {
            Ok(text) => unit.obey(&text),
            Err(_) => Err(Complaint::Command(CommandError::Undefined)),
        };
        match answered {
            Ok(Some(answer)) => line.reply(&format!("{answer}{}", unit.line_end()), delay),
            Ok(None) => {}
            Err(complaint) => unit.complain(complaint),
        }
    }
}

/// Why a command was not obeyed.
#[derive(Debug, thiserror::Error)]
enum Complaint {
    #[error(transparent)]
    Command(#[from] CommandError),
    #[error("command protected")]
    Protected,
    #[error("parameter out of range")]
    Range,
}

/// What the unit remembers besides its plate.
struct Unit {
    plate: Arc<Mutex<Plate>>,
    model: Model,
    linefeed: bool,
    fahrenheit: bool,
    comma: bool,
    conditional: bool,
    password: bool,
    errors: Vec<String>,
    emissivity: f64,
    beep: bool,
    wavelength: f64,
    baud: f64,
    keypad_beep: bool,
    keypad_lock: bool,
    band_c: f64,
    integral_s: f64,
    derivative_s: f64,
    constants: [f64; 3],
    presets_c: [f64; 8],
    fahrenheit_at_s: Option<f64>,
    output_off_at_s: Option<f64>,
}

/// One numeric setting: where it is, its range and its value at delivery.
struct Range {
    least: f64,
    greatest: f64,
    default: f64,
}

impl Unit {
    fn new(behaviour: &FlukeBehaviour, plate: Arc<Mutex<Plate>>) -> Self {
        if let Some(level) = behaviour.soft_cutout_c {
            let mut held = plate.lock().expect("no user of the plate panics while holding it");
            held.settings.cutout_k = Kelvin::from_celsius(level).0;
        }
        Self {
            plate,
            model: behaviour.model,
            linefeed: behaviour.linefeed,
            fahrenheit: behaviour.fahrenheit,
            comma: behaviour.decimal_comma,
            conditional: behaviour.protected,
            password: false,
            errors: Vec::new(),
            emissivity: 0.95,
            beep: true,
            wavelength: 0.0,
            baud: 9600.0,
            keypad_beep: true,
            keypad_lock: false,
            band_c: 25.0,
            integral_s: 150.0,
            derivative_s: 0.0,
            constants: [0.0; 3],
            presets_c: [35.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0, 500.0],
            fahrenheit_at_s: behaviour.fahrenheit_at_s,
            output_off_at_s: behaviour.output_off_at_s,
        }
    }

    /// Goes on to a moment of the rig's clock, and plays what somebody does at the keypad.
    fn look(&mut self, now_s: f64) {
        self.plate().advance(now_s);
        if self.fahrenheit_at_s.is_some_and(|at_s| at_s <= now_s) {
            self.fahrenheit_at_s = None;
            self.fahrenheit = true;
        }
        if self.output_off_at_s.is_some_and(|at_s| at_s <= now_s) {
            self.output_off_at_s = None;
            self.plate().settings.output_on = false;
        }
    }

    fn plate(&self) -> MutexGuard<'_, Plate> {
        self.plate.lock().expect("no user of the plate panics while holding it")
    }

    fn line_end(&self) -> &'static str {
        if self.linefeed { "\r\n" } else { "\r" }
    }

    fn complain(&mut self, complaint: Complaint) {
        if self.errors.len() >= ERRORS_MAX {
            self.errors.remove(0);
        }
        self.errors.push(complaint.to_string());
    }

    /// Obeys one command; gives the answer if it was a query.
    fn obey(&mut self, line: &str) -> Result<Option<String>, Complaint> {
        let command = Command::decode(line)?;
        match &command.act {
            Act::Query(None) => self.answer(&command).map(Some),
            Act::Query(Some(word)) => self.answer_word(&command, word).map(Some),
            Act::Set(values) => {
                let refused = match write_access(command.header) {
                    Write::Protected => !self.password,
                    Write::Conditional => self.conditional && !self.password,
                    _ => false,
                };
                if refused {
                    return Err(Complaint::Protected);
                }
                match values.first() {
                    None => self.act(command.header),
                    Some(value) => self.set(&command, value)?,
                }
                Ok(None)
            }
        }
    }

    fn answer(&mut self, command: &Command) -> Result<String, Complaint> {
        let flag = |on: bool| u8::from(on).to_string();
        Ok(match command.header {
            Header::Identity => encode_identity(&Identity {
                maker: "FLUKE".to_owned(),
                model: self.model.encode().to_owned(),
                serial: "A79002".to_owned(),
                firmware: "1.00".to_owned(),
            }),
            Header::OutputState => flag(self.plate().settings.output_on),
            Header::OutputDuty => self.number(self.plate().duty_percent(), 1),
            Header::SetPoint => self.temperature(self.plate().settings.set_point_k),
            Header::Temperature => self.temperature(self.plate().display_k()),
            Header::Block => self.temperature(self.plate().block_k()),
            Header::Rate => self.difference(self.plate().settings.rate_k_per_min, 2),
            Header::StabilityLimit => self.difference(self.plate().settings.stability_limit_k, 3),
            Header::Stability => self.difference(self.plate().stability_k(), 3),
            Header::Stable => flag(self.plate().is_stable()),
            Header::StableBeep => flag(self.beep),
            Header::Emissivity => self.number(self.emissivity, 3),
            Header::CalibrationEmissivity => self.number(0.95, 3),
            Header::CalibrationWavelength => self.number(self.wavelength, 0),
            Header::CalibrationConstant => {
                self.number(*slot(&mut self.constants.clone(), command.number)?, 3)
            }
            Header::CalibrationDate => "2007,1,18".to_owned(),
            Header::ProportionalBand => self.difference(self.band_c, 1),
            Header::Integral => self.number(self.integral_s, 1),
            Header::Derivative => self.number(self.derivative_s, 1),
            Header::Preset => {
                let celsius = *slot(&mut self.presets_c.clone(), command.number)?;
                self.temperature(Kelvin::from_celsius(celsius).0)
            }
            Header::SoftCutout => {
                let cutout_k = self.plate().settings.cutout_k;
                self.number(self.in_unit(Kelvin(cutout_k).celsius()), 0)
            }
            Header::HardCutout => {
                let celsius = if self.model == Model::Fluke4180 { 140.0 } else { 540.0 };
                self.number(self.in_unit(celsius), 0)
            }
            Header::Tripped => flag(self.plate().is_tripped()),
            Header::Error => self.errors.pop().unwrap_or_else(|| "no error".to_owned()),
            Header::Baud => self.number(self.baud, 0),
            Header::Linefeed => flag(self.linefeed),
            Header::DecimalFormat => flag(self.comma),
            Header::Version => "1.00".to_owned(),
            Header::KeypadBeep => flag(self.keypad_beep),
            Header::KeypadLock => flag(self.keypad_lock),
            Header::PasswordState => flag(self.password),
            Header::Unit => if self.fahrenheit { "F" } else { "C" }.to_owned(),
            Header::ClearStatus | Header::ClearCutout | Header::PasswordEnable | Header::PasswordDisable => {
                return Err(CommandError::NoQuery.into());
            }
        })
    }

    /// Queries with a word: `SOUR:SENS:DATA? BLOC`, `SOUR:SPO? MAX`.
    fn answer_word(&mut self, command: &Command, word: &Value) -> Result<String, Complaint> {
        let header = command.header;
        if let (Header::Temperature, Value::Word(word)) = (header, word) {
            return match word.as_str() {
                "TEMP" | "TEMPERATURE" => self.answer(command),
                "BLOC" | "BLOCK" => self.answer(&Command::query(Header::Block)),
                _ => Err(CommandError::Type.into()),
            };
        }
        let range = self.range(header).ok_or(CommandError::TooMany)?;
        let value = match word {
            Value::Least => range.least,
            Value::Greatest => range.greatest,
            Value::Default => range.default,
            _ => return Err(CommandError::Type.into()),
        };
        Ok(match header {
            Header::SetPoint | Header::Preset | Header::SoftCutout => {
                self.temperature(Kelvin::from_celsius(value).0)
            }
            Header::Rate | Header::StabilityLimit | Header::ProportionalBand => self.difference(value, 3),
            _ => self.number(value, 3),
        })
    }

    fn act(&mut self, header: Header) {
        match header {
            Header::ClearStatus => self.errors.clear(),
            Header::ClearCutout => self.plate().clear_cutout(),
            Header::PasswordDisable => self.password = false,
            _ => {}
        }
    }

    fn set(&mut self, command: &Command, value: &Value) -> Result<(), Complaint> {
        let header = command.header;
        match (header, value) {
            (Header::Unit, Value::Word(word)) if word == "C" || word == "F" => {
                self.fahrenheit = word == "F";
                return Ok(());
            }
            (Header::Unit, _) => return Err(CommandError::Type.into()),
            (Header::PasswordEnable, Value::Number(number)) => {
                self.password = (number - PASSWORD).abs() < 0.5;
                return if self.password { Ok(()) } else { Err(Complaint::Protected) };
            }
            (Header::CalibrationDate, _) => return Ok(()),
            _ => {}
        }
        let range = self.range(header).ok_or(CommandError::Type)?;
        let number = match value {
            Value::Number(number) => self.taken_as(header, *number),
            Value::Least => range.least,
            Value::Greatest => range.greatest,
            Value::Default => range.default,
            Value::Word(_) => return Err(CommandError::Type.into()),
        };
        // Half a digit of grace for what a change of units rounds.
        if number < range.least - 0.005 || number > range.greatest + 0.005 {
            return Err(Complaint::Range);
        }
        let on = number.round() >= 1.0;
        match header {
            Header::OutputState => self.plate().settings.output_on = on,
            Header::SetPoint => self.plate().settings.set_point_k = Kelvin::from_celsius(number).0,
            Header::Rate => self.plate().settings.rate_k_per_min = number,
            Header::StabilityLimit => self.plate().settings.stability_limit_k = number,
            Header::StableBeep => self.beep = on,
            Header::Emissivity => self.emissivity = number,
            Header::CalibrationWavelength => self.wavelength = number.round(),
            Header::CalibrationConstant => *slot(&mut self.constants, command.number)? = number,
            Header::ProportionalBand => self.band_c = number,
            Header::Integral => self.integral_s = number,
            Header::Derivative => self.derivative_s = number,
            Header::Preset => *slot(&mut self.presets_c, command.number)? = number,
            Header::SoftCutout => self.plate().settings.cutout_k = Kelvin::from_celsius(number.round()).0,
            Header::Baud => self.baud = number,
            Header::Linefeed => self.linefeed = on,
            Header::DecimalFormat => self.comma = on,
            Header::KeypadBeep => self.keypad_beep = on,
            Header::KeypadLock => self.keypad_lock = on,
            _ => return Err(CommandError::QueryOnly.into()),
        }
        Ok(())
    }

    /// Ranges of the command table, in °C where they are temperatures.
    fn range(&self, header: Header) -> Option<Range> {
        let is_4181 = self.model == Model::Fluke4181;
        let highest_c = self.model.set_point_max_c(self.emissivity);
        let (least, greatest, default) = match header {
            Header::OutputState
            | Header::StableBeep
            | Header::Linefeed
            | Header::DecimalFormat
            | Header::KeypadLock => (0.0, 1.0, 0.0),
            Header::KeypadBeep => (0.0, 1.0, 1.0),
            Header::SetPoint | Header::Preset => (self.model.set_point_min_c(), highest_c, 25.0),
            Header::Rate => (0.1, 500.0, 100.0),
            Header::StabilityLimit => (0.01, 5.0, if is_4181 { 0.4 } else { 0.1 }),
            Header::Emissivity => (0.9, 1.0, 0.95),
            Header::CalibrationWavelength => (0.0, 1.0, 0.0),
            Header::CalibrationConstant => (-99.0, 99.0, 0.0),
            Header::ProportionalBand => (1.0, 99.9, 25.0),
            Header::Integral => (10.0, 999.9, 150.0),
            Header::Derivative => (0.0, 99.9, 0.0),
            Header::SoftCutout if is_4181 => (0.0, 520.0, 520.0),
            Header::SoftCutout => (0.0, 140.0, 140.0),
            Header::Baud => (1200.0, 38400.0, 9600.0),
            _ => return None,
        };
        Some(Range { least, greatest, default })
    }

    /// A parameter as °C, kelvin or whatever the header takes: temperatures follow `UNIT:TEMP`.
    fn taken_as(&self, header: Header, number: f64) -> f64 {
        match header {
            Header::SetPoint | Header::Preset | Header::SoftCutout if self.fahrenheit => {
                (number - 32.0) / 1.8
            }
            Header::Rate | Header::StabilityLimit | Header::ProportionalBand if self.fahrenheit => {
                number / 1.8
            }
            _ => number,
        }
    }

    fn in_unit(&self, celsius: f64) -> f64 {
        if self.fahrenheit { celsius * 1.8 + 32.0 } else { celsius }
    }

    fn temperature(&self, kelvin: f64) -> String {
        self.number(self.in_unit(Kelvin(kelvin).celsius()), 3)
    }

    fn difference(&self, kelvin: f64, digits: usize) -> String {
        self.number(if self.fahrenheit { kelvin * 1.8 } else { kelvin }, digits)
    }

    fn number(&self, number: f64, digits: usize) -> String {
        encode_number(number, digits, self.comma)
    }
}

/// The element with the number, counted from 1.
fn slot(values: &mut [f64], number: Option<u32>) -> Result<&mut f64, CommandError> {
    let index = number.and_then(|number| usize::try_from(number).ok()?.checked_sub(1));
    index.and_then(|index| values.get_mut(index)).ok_or(CommandError::Suffix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::plate::{PlateFault, PlateModel};
    use ditd_drivers::error::DriverError;
    use ditd_drivers::fluke_418x::Fluke418x;
    use ditd_drivers::instrument::{Calibrator, CalibratorSettings};
    use ditd_drivers::quantity::KelvinDelta;
    use ditd_drivers::wire::Wire;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
    use tokio::time::{sleep, timeout};

    fn model() -> PlateModel {
        PlateModel::fluke_4181(296.15)
    }

    fn settings() -> CalibratorSettings {
        CalibratorSettings {
            display_emissivity: 0.95,
            limit: Kelvin(560.0),
            rate_k_per_min: 100.0,
            stability: KelvinDelta(0.4),
        }
    }

    fn served(behaviour: FlukeBehaviour, model: PlateModel) -> (DuplexStream, Arc<Mutex<Plate>>) {
        let (near, far) = duplex(256);
        let plate = Arc::new(Mutex::new(Plate::new(model, 3)));
        tokio::spawn(serve(far, plate.clone(), behaviour, Instant::now()));
        (near, plate)
    }

    fn driven(behaviour: FlukeBehaviour, model: PlateModel) -> (Fluke418x, Arc<Mutex<Plate>>) {
        let (near, plate) = served(behaviour, model);
        (Fluke418x::new(Wire::over(near, "plate calibrator")), plate)
    }

    async fn prepared(behaviour: FlukeBehaviour, model: PlateModel) -> (Fluke418x, Arc<Mutex<Plate>>) {
        let (mut driver, plate) = driven(behaviour, model);
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        (driver, plate)
    }

    /// What is heard after each thing said, as bytes.
    async fn heard(near: &mut DuplexStream, said: &str) -> String {
        near.write_all(said.as_bytes()).await.unwrap();
        let mut bytes = [0; 128];
        match timeout(Duration::from_millis(500), near.read(&mut bytes)).await {
            Ok(count) => String::from_utf8_lossy(&bytes[..count.unwrap()]).into_owned(),
            Err(_) => String::new(),
        }
    }

    /// The manual's own exchanges: silence after sets and bad commands, CR alone, the error queue.
    #[tokio::test(start_paused = true)]
    async fn a_transcript_goes_as_the_manual_says() {
        let (mut near, _plate) = served(FlukeBehaviour::fluke_4181(), model());
        for (said, expected) in [
            ("*IDN?\r", "FLUKE,4181,A79002,1.00\r"),
            ("SOUR:SPO 50\n", ""),
            ("SOUR:SPO?\r", "50.000\r"),
            ("source:spoint min\r", ""),
            ("SOUR:SPO?\r", "25.000\r"),
            ("SOUR:SPO? MAX\r", "500.000\r"),
            ("SOUR:EMIS 0.98\r", ""),
            ("SOUR:SPO? MAX\r", "489.800\r"),
            ("SOUR:SPO 495\r", ""),
            ("SYST:ERR?\r", "parameter out of range\r"),
            ("SYST:ERR?\r", "no error\r"),
            ("SOUR:LCON:PBAN 5\r", ""),
            ("SYST:ERR?\r", "command protected\r"),
            ("SYST:PASS:CEN 1234\r", ""),
            ("SOUR:LCON:PBAN 5\r", ""),
            ("SOUR:LCON:PBAN?\r", "5.0\r"),
            ("NONSENSE?\r", ""),
            ("SYST:ERR?\r", "undefined header\r"),
            ("SOUR:LIST:SPO?\r", ""),
            ("SYST:ERR?\r", "Header suffix out of range\r"),
            ("UNIT:TEMP F\r", ""),
            ("SOUR:SPO?\r", "77.000\r"),
            ("SYST:DEC:FORM 1\r", ""),
            ("SOUR:SPO?\r", "77,000\r"),
            ("SYST:COMM:SER:LIN ON\r", ""),
            ("SOUR:PROT:TRIP?\r", "0\r\n"),
        ] {
            assert_eq!(heard(&mut near, said).await, expected, "{said}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_unread_reply_is_lost() {
        let (mut near, _plate) = served(FlukeBehaviour::fluke_4181(), model());
        near.write_all(b"SOUR:SPO?\r").await.unwrap();
        sleep(Duration::from_millis(1)).await;
        assert_eq!(heard(&mut near, "SOUR:EMIS?\r").await, "0.950\r");
    }

    #[tokio::test(start_paused = true)]
    async fn a_unit_left_in_fahrenheit_with_commas_is_brought_to_celsius() {
        let behaviour = FlukeBehaviour {
            fahrenheit: true,
            decimal_comma: true,
            linefeed: true,
            protected: true,
            ..FlukeBehaviour::fluke_4181()
        };
        let (mut driver, plate) = prepared(behaviour, model()).await;
        assert_eq!(driver.set_point(Kelvin(403.0)).await.unwrap(), Kelvin::from_celsius(129.85));
        assert!((plate.lock().unwrap().settings.set_point_k - 403.0).abs() < 0.006);
        let reading = driver.read().await.unwrap();
        assert!((reading.apparent.0 - 296.15).abs() < 1.0, "{reading:?}");
        assert!(!reading.stable && !reading.tripped);
    }

    #[tokio::test(start_paused = true)]
    async fn a_level_is_reached_and_read() {
        let (mut driver, _plate) = prepared(FlukeBehaviour::fluke_4181(), model()).await;
        driver.set_point(Kelvin(373.15)).await.unwrap();
        sleep(Duration::from_secs(1500)).await;
        let reading = driver.read().await.unwrap();
        assert!(reading.stable);
        assert!((reading.apparent.0 - 373.15).abs() < 0.2, "{reading:?}");
        assert!(reading.block > reading.apparent);
    }

    /// 720 readings while every fifth reply is late by more than the deadline: a reading is right or it is an error.
    #[tokio::test(start_paused = true)]
    async fn late_replies_never_make_a_stale_reading() {
        let late = LineFault::Late { every: 7, delay_s: 1.2 };
        let behaviour = FlukeBehaviour { faults: vec![late], ..FlukeBehaviour::fluke_4181() };
        let (mut driver, plate) = driven(behaviour, model());
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        let mut good = 0;
        for index in 0..720 {
            let target_k = 310.0 + f64::from(index % 10) * 7.0;
            let Ok(taken) = driver.set_point(Kelvin(target_k)).await else { continue };
            assert!((taken.0 - target_k).abs() < 0.01);
            let Ok(reading) = driver.read().await else { continue };
            let true_k = plate.lock().unwrap().surface_k();
            assert!((reading.set_point.0 - target_k).abs() < 0.01, "{reading:?}, sent {target_k}");
            // The plate moves by at most 0.5 K/s during the exchanges of one reading.
            assert!((reading.apparent.0 - true_k).abs() < 10.0, "{reading:?} {true_k}");
            assert!(!reading.tripped);
            good += 1;
        }
        assert!(good > 600, "{good}");
    }

    #[tokio::test(start_paused = true)]
    async fn garbled_missing_and_doubled_replies_are_survived() {
        for fault in [
            LineFault::Garbled { every: 6 },
            LineFault::Missing { every: 6 },
            LineFault::Doubled { every: 6 },
        ] {
            let behaviour = FlukeBehaviour { faults: vec![fault.clone()], ..FlukeBehaviour::fluke_4181() };
            let (mut driver, _plate) = prepared(behaviour, model()).await;
            for index in 0..50 {
                let target_k = 320.0 + f64::from(index);
                driver.set_point(Kelvin(target_k)).await.unwrap();
                let reading = driver.read().await.unwrap();
                assert!((reading.set_point.0 - target_k).abs() < 0.01, "{fault:?}");
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn limits_are_refused_before_anything_is_sent() {
        let (mut driver, plate) = driven(FlukeBehaviour::fluke_4181(), model());
        let error = driver.set_point(Kelvin(373.0)).await.unwrap_err();
        assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        driver.identify().await.unwrap();
        let wide = CalibratorSettings { limit: Kelvin(1000.0), display_emissivity: 0.99, ..settings() };
        driver.prepare(&wide).await.unwrap();
        let before = plate.lock().unwrap().settings;
        for celsius in [20.0, 486.5, 600.0, f64::NAN] {
            let error = driver.set_point(Kelvin::from_celsius(celsius)).await.unwrap_err();
            assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        }
        driver.prepare(&settings()).await.unwrap();
        let error = driver.set_point(Kelvin(560.1)).await.unwrap_err();
        assert!(error.is_interlock_or_limit(), "{error}");
        assert_eq!(plate.lock().unwrap().settings, before);
        for bad in [
            CalibratorSettings { display_emissivity: 1.1, ..settings() },
            CalibratorSettings { rate_k_per_min: 0.0, ..settings() },
            CalibratorSettings { stability: KelvinDelta(f64::NAN), ..settings() },
        ] {
            let error = driver.prepare(&bad).await.unwrap_err();
            assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        }
    }

    /// The unit's own soft cutout is read; a level that would trip it on arrival is refused.
    #[tokio::test(start_paused = true)]
    async fn the_units_own_soft_cutout_is_a_limit() {
        let behaviour = FlukeBehaviour { soft_cutout_c: Some(150.0), ..FlukeBehaviour::fluke_4181() };
        let (mut driver, plate) = prepared(behaviour, model()).await;
        driver.set_point(Kelvin::from_celsius(144.9)).await.unwrap();
        let error = driver.set_point(Kelvin::from_celsius(146.0)).await.unwrap_err();
        assert!(error.to_string().contains("soft cutout trips at 150 °C"), "{error}");
        assert!((plate.lock().unwrap().settings.set_point_k - 418.05).abs() < 0.01);
    }

    /// °F set at the keypad in the middle, as the paper's levels would be read 100 to 200 K too high.
    #[tokio::test(start_paused = true)]
    async fn fahrenheit_in_the_middle_changes_no_reading_and_no_set_point() {
        for at_s in [0.5, 300.0, 300.2] {
            let behaviour = FlukeBehaviour { fahrenheit_at_s: Some(at_s), ..FlukeBehaviour::fluke_4181() };
            let (mut driver, plate) = prepared(behaviour, model()).await;
            for index in 0..600 {
                let target_k = 330.0 + f64::from(index % 7);
                let taken = driver.set_point(Kelvin(target_k)).await.unwrap();
                assert!((taken.0 - target_k).abs() < 0.006);
                assert!((plate.lock().unwrap().settings.set_point_k - target_k).abs() < 0.006, "at {at_s} s");
                let reading = driver.read().await.unwrap();
                assert!((reading.set_point.0 - target_k).abs() < 0.006, "{reading:?}");
                let true_k = plate.lock().unwrap().surface_k();
                assert!((reading.apparent.0 - true_k).abs() < 2.0, "{reading:?} {true_k}");
                sleep(Duration::from_millis(700)).await;
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_output_that_somebody_switched_off_is_told() {
        let behaviour = FlukeBehaviour { output_off_at_s: Some(60.0), ..FlukeBehaviour::fluke_4181() };
        let (mut driver, _plate) = prepared(behaviour, model()).await;
        driver.set_point(Kelvin(373.0)).await.unwrap();
        driver.read().await.unwrap();
        sleep(Duration::from_secs(60)).await;
        let error = driver.read().await.unwrap_err();
        assert!(error.to_string().contains("output was switched off"), "{error}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_tripped_cutout_is_an_interlock() {
        let tripping = PlateModel { faults: vec![PlateFault::CutoutTrips { at_s: 100.0 }], ..model() };
        let (mut driver, _plate) = prepared(FlukeBehaviour::fluke_4181(), tripping).await;
        driver.set_point(Kelvin(400.0)).await.unwrap();
        sleep(Duration::from_secs(200)).await;
        assert!(driver.read().await.unwrap().tripped);
        let error = driver.set_point(Kelvin(410.0)).await.unwrap_err();
        assert!(matches!(error, DriverError::Interlock { .. }), "{error}");
        let error = driver.prepare(&settings()).await.unwrap_err();
        assert!(matches!(error, DriverError::Interlock { .. }), "{error}");
        // The safe state is reached all the same.
        assert!(driver.make_safe().await.unwrap().tripped);
    }

    #[tokio::test(start_paused = true)]
    async fn the_safe_state_keeps_the_output_on_until_below_100_celsius() {
        let (mut driver, plate) = prepared(FlukeBehaviour::fluke_4181(), model()).await;
        driver.set_point(Kelvin(473.15)).await.unwrap();
        sleep(Duration::from_secs(1500)).await;
        for _ in 0..2 {
            let reading = driver.make_safe().await.unwrap();
            assert!(reading.block > Kelvin::from_celsius(150.0));
            let settings = plate.lock().unwrap().settings;
            assert!(settings.output_on && (settings.set_point_k - 298.15).abs() < 0.01);
        }
        sleep(Duration::from_secs(7200)).await;
        for _ in 0..2 {
            assert!(driver.make_safe().await.unwrap().block < Kelvin::from_celsius(100.0));
            assert!(!plate.lock().unwrap().settings.output_on);
        }
    }

    /// A fresh process that finds the plate hot and in Fahrenheit.
    #[tokio::test(start_paused = true)]
    async fn the_safe_state_needs_no_preparation() {
        let behaviour = FlukeBehaviour { fahrenheit: true, ..FlukeBehaviour::fluke_4181() };
        let (mut driver, plate) = driven(behaviour, model());
        plate.lock().unwrap().settings.set_point_k = 500.0;
        plate.lock().unwrap().settings.output_on = true;
        driver.make_safe().await.unwrap();
        let settings = plate.lock().unwrap().settings;
        assert!((settings.set_point_k - 298.15).abs() < 0.01 && !settings.output_on);
    }

    #[tokio::test(start_paused = true)]
    async fn a_reading_that_is_no_number_is_garbled() {
        let nan =
            PlateModel { faults: vec![PlateFault::NanReading { from_s: 50.0, until_s: 1e9 }], ..model() };
        let (mut driver, _plate) = prepared(FlukeBehaviour::fluke_4181(), nan).await;
        sleep(Duration::from_secs(60)).await;
        let error = driver.read().await.unwrap_err();
        assert!(matches!(error, DriverError::Garbled { .. }), "{error}");
        // The safe state does not hang on the display.
        driver.make_safe().await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn a_dead_calibrator_is_silent_and_a_closed_line_is_lost() {
        let silent = LineFault::Silent { from_s: 60.0 };
        let behaviour = FlukeBehaviour { faults: vec![silent], ..FlukeBehaviour::fluke_4181() };
        let (mut driver, _plate) = prepared(behaviour, model()).await;
        sleep(Duration::from_secs(60)).await;
        let asked = Instant::now();
        let error = driver.read().await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { .. }), "{error}");
        assert!(asked.elapsed() < Duration::from_secs(15));

        let (near, far) = duplex(64);
        drop(far);
        let mut driver = Fluke418x::new(Wire::over(near, "plate calibrator"));
        let error = driver.identify().await.unwrap_err();
        assert!(matches!(error, DriverError::Lost { .. }), "{error}");
    }

    /// An instrument that knows not all commands: the words of its error queue are in the error.
    #[tokio::test(start_paused = true)]
    async fn silence_after_a_command_is_explained_by_the_error_queue() {
        let (near, far) = duplex(256);
        tokio::spawn(async move {
            let mut line = Line::new(far, vec![], Unsent::Kept, Instant::now());
            while let Some(Ok(command)) = line.next_command().await {
                match command.as_str() {
                    "*IDN?" => line.reply("HART,4181,1,1\r", Duration::ZERO),
                    "SYST:ERR?" => line.reply("undefined header\r", Duration::ZERO),
                    _ => {}
                }
            }
        });
        let mut driver = Fluke418x::new(Wire::over(near, "plate calibrator"));
        assert_eq!(driver.identify().await.unwrap().maker, "HART");
        let error = driver.read().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
        assert!(error.to_string().contains("undefined header"), "{error}");
    }

    #[tokio::test(start_paused = true)]
    async fn another_instrument_is_refused() {
        let (near, far) = duplex(256);
        tokio::spawn(async move {
            let mut line = Line::new(far, vec![], Unsent::Kept, Instant::now());
            while line.next_command().await.is_some() {
                line.reply("HART,9132,1,1\r", Duration::ZERO);
            }
        });
        let mut driver = Fluke418x::new(Wire::over(near, "plate calibrator"));
        let error = driver.identify().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    }

    #[test]
    fn a_behaviour_is_read_from_a_file_and_unknown_keys_are_refused() {
        let text = "model = \"4181\"\n[[faults]]\nkind = \"late\"\nevery = 7\ndelay_s = 1.5\n";
        let behaviour: FlukeBehaviour = toml::from_str(text).unwrap();
        assert_eq!(behaviour.faults, [LineFault::Late { every: 7, delay_s: 1.5 }]);
        assert_eq!(toml::from_str::<FlukeBehaviour>("").unwrap(), FlukeBehaviour::fluke_4181());
        assert!(toml::from_str::<FlukeBehaviour>("colour = 1\n").is_err());
        let impossible: FlukeBehaviour = toml::from_str("reply_delay_s = -0.1\n").unwrap();
        assert!(impossible.check().unwrap_err().starts_with("reply_delay_s"));
    }
}
