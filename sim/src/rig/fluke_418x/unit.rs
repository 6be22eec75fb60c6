//! What the unit remembers, and how it answers and obeys.

use super::FlukeBehaviour;
use crate::rig::plate::Plate;
use ditd_drivers::fluke_418x::{
    Act, Command, CommandError, Header, Model, Value, Write, encode_identity, encode_number, write_access,
};
use ditd_drivers::instrument::Identity;
use ditd_drivers::quantity::Kelvin;
use std::sync::{Arc, Mutex, MutexGuard};

/// Entries that the error queue keeps; older ones fall out.
const ERRORS_MAX: usize = 16;

/// Password at delivery (Users Guide).
const PASSWORD: f64 = 1234.0;

/// Why a command was not obeyed.
#[derive(Debug, thiserror::Error)]
pub(super) enum Complaint {
    #[error(transparent)]
    Command(#[from] CommandError),
    #[error("command protected")]
    Protected,
    #[error("parameter out of range")]
    Range,
}

/// What the unit remembers besides its plate.
pub(super) struct Unit {
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
    pub(super) fn new(behaviour: &FlukeBehaviour, plate: Arc<Mutex<Plate>>) -> Self {
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
    pub(super) fn look(&mut self, now_s: f64) {
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

    pub(super) fn line_end(&self) -> &'static str {
        if self.linefeed { "\r\n" } else { "\r" }
    }

    pub(super) fn complain(&mut self, complaint: Complaint) {
        if self.errors.len() >= ERRORS_MAX {
            self.errors.remove(0);
        }
        self.errors.push(complaint.to_string());
    }

    /// Obeys one command; gives the answer if it was a query.
    pub(super) fn obey(&mut self, line: &str) -> Result<Option<String>, Complaint> {
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
