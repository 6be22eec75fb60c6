//! The driver of a 4180 or 4181.

use super::codec::{Command, Header, Model, decode_celsius, decode_flag, decode_identity, decode_number};
use crate::error::DriverError;
use crate::instrument::{Calibrator, CalibratorSettings, Identity, MonitorReading, PlateReading};
use crate::quantity::Kelvin;
use crate::set_point::{LIMIT_HINT, SetPoint, check_limit};
use crate::wire::{LineHabits, Sign, Tries, Wire};
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

/// Tries of one set that is not confirmed.
const SET_TRIES: u32 = 2;

/// A set-point must stay below the unit's own soft cutout by this much, in °C: what a plate overshoots on arrival.
const CUTOUT_MARGIN_C: f64 = 5.0;

/// Tries of a reading or a set in whose middle the unit was found changed. Twice in a row is somebody at the keypad.
const UNIT_TRIES: u32 = 2;

const UNIT_CHANGES: &str = "UNIT:TEMP is changed again and again by somebody else";

/// A 4180 or 4181 at the end of a wire.
#[derive(Debug)]
pub struct Fluke418x {
    wire: Wire,
    model: Option<Model>,
    settings: Option<CalibratorSettings>,
    /// The unit's own soft cutout in °C, as read when it was prepared.
    cutout_c: f64,
    /// It was told to heat, and nobody told it to stop.
    heats: bool,
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
        Self { wire, model: None, settings: None, cutout_c: f64::NAN, heats: false }
    }

    async fn query<T>(
        &mut self,
        header: Header,
        decode: fn(&str) -> Result<T, &'static str>,
        doing: &str,
    ) -> Result<T, DriverError> {
        let question = Command::query(header).encode();
        let mut tries = Tries::default();
        loop {
            let failure = match self.wire.ask(&question, doing).await {
                Ok(answer) => match decode(&answer) {
                    Ok(value) => return Ok(value),
                    Err(why) => self.wire.unexpected(doing, &answer, why),
                },
                Err(failure) => failure,
            };
            // A line that could not be found again needs no explanation.
            let is_heard = matches!(failure, DriverError::Silent { tries: 1, .. });
            match tries.again(failure) {
                Ok(()) => {}
                Err(silence) if is_heard => return Err(self.explain_silence(silence, doing).await),
                Err(error) => return Err(error),
            }
        }
    }

    /// Bad commands get silence: after a time-out the error queue says whether it was the line or the command.
    async fn explain_silence(&mut self, silence: DriverError, doing: &str) -> DriverError {
        let DriverError::Silent { who, doing: act, waited, tries, hint } = silence else { return silence };
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

    /// Whether numbers are in °C just now: the unit can be changed at the keypad in the middle of a campaign, and then
    /// changes every number without a word.
    async fn is_celsius(&mut self, doing: &str) -> Result<bool, DriverError> {
        Ok(self.query(Header::Unit, |text| Ok(text.to_owned()), doing).await?.eq_ignore_ascii_case("C"))
    }

    async fn read_once(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "reading the plate";
        let reading = PlateReading {
            apparent: Kelvin::from_celsius(self.query(Header::Temperature, decode_celsius, doing).await?),
            block: Kelvin::from_celsius(self.query(Header::Block, decode_celsius, doing).await?),
            set_point: Kelvin::from_celsius(self.query(Header::SetPoint, decode_celsius, doing).await?),
            stable: self.query(Header::Stable, decode_flag, doing).await?,
            tripped: self.query(Header::Tripped, decode_flag, doing).await?,
        };
        let output_on = self.query(Header::OutputState, decode_flag, doing).await?;
        if self.heats && !output_on && !reading.tripped {
            return Err(self.refused(doing, "its output was switched off by somebody else".to_owned()));
        }
        Ok(reading)
    }

    async fn check_cutout(&mut self, doing: &str) -> Result<(), DriverError> {
        if !self.query(Header::Tripped, decode_flag, doing).await? {
            return Ok(());
        }
        Err(DriverError::interlock(
            self.wire.name(),
            doing,
            "a cutout has tripped: the plate neither heats nor cools",
            "Find out why it became too hot, then clear the cutout at the keypad.",
        ))
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

    /// What the unit itself allows.
    fn check_target(&self, model: Model, emissivity: f64, target: &SetPoint) -> Result<(), DriverError> {
        let SetPoint { celsius: target_c, doing } = target;
        let (min_c, max_c) = (model.set_point_min_c(), model.set_point_max_c(emissivity));
        if target_c + CUTOUT_MARGIN_C > self.cutout_c {
            let cutout_c = self.cutout_c;
            let why = format!(
                "the unit's own soft cutout trips at {cutout_c:.0} °C; overshoot needs {CUTOUT_MARGIN_C} °C"
            );
            Err(self.limit(doing, why))
        } else if *target_c < min_c || *target_c > max_c {
            let model = model.encode();
            Err(self.limit(
                doing,
                format!(
                    "a {model} goes from {min_c:.1} to {max_c:.1} °C at emissivity setting {emissivity:.3}"
                ),
            ))
        } else {
            Ok(())
        }
    }

    fn refused(&self, doing: &str, why: String) -> DriverError {
        DriverError::refused(
            self.wire.name(),
            doing,
            why,
            "Check at the keypad that the instrument is in its main menu and runs no program of its own.",
        )
    }

    fn limit(&self, doing: &str, why: String) -> DriverError {
        DriverError::limit(self.wire.name(), doing, why, LIMIT_HINT)
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
                return Err(DriverError::refused(
                    self.wire.name(),
                    doing,
                    format!("it is a {model:?}, this driver is for 4180 and 4181"),
                    "Check the address: another instrument may sit on this line.",
                ));
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
        check_limit(self.wire.name(), settings)?;
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
        self.cutout_c = self.query(Header::SoftCutout, decode_celsius, "reading the soft cutout").await?;
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
        let target = SetPoint::new(self.wire.name(), target, SET_POINT_STEPS_PER_C, self.settings.as_ref())?;
        if let (Some(model), Some(settings)) = (self.model, &self.settings) {
            self.check_target(model, settings.display_emissivity, &target)?;
        }
        let SetPoint { celsius: target_c, doing } = target;
        self.check_cutout(&doing).await?;
        for _ in 0..UNIT_TRIES {
            if !self.is_celsius(&doing).await? {
                self.force_formats().await?;
            }
            let taken = self.set_confirmed(Header::SetPoint, target_c, CONFIRM_TOLERANCE, &doing).await?;
            // A set-point that was taken in °F is confirmed in °F: what it means is only known if the unit has stayed.
            if self.is_celsius(&doing).await? {
                self.set_confirmed(Header::OutputState, 1.0, CONFIRM_TOLERANCE, "switching the output on")
                    .await?;
                self.heats = true;
                return Ok(Kelvin::from_celsius(taken));
            }
        }
        Err(self.refused(&doing, UNIT_CHANGES.to_owned()))
    }

    async fn read(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "reading the plate";
        let mut last = Err(self.refused(doing, UNIT_CHANGES.to_owned()));
        for _ in 0..UNIT_TRIES {
            let reading = self.read_once().await;
            match reading {
                Ok(_) | Err(DriverError::Garbled { .. }) => {}
                Err(error) => return Err(error),
            }
            // Asked after the numbers: a change in their middle shows itself too.
            let celsius = self.is_celsius(doing).await?;
            if celsius && reading.is_ok() {
                return reading;
            }
            if reading.is_err() {
                last = reading;
            }
            self.force_formats().await?;
        }
        last
    }

    async fn particulars(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        let doing = "reading its settings";
        let mut values = Vec::new();
        // The display is a radiometric calibration at these; what another band makes of it is judged elsewhere.
        for (name, header) in [
            ("display_emissivity_fraction", Header::Emissivity),
            ("calibration_emissivity_fraction", Header::CalibrationEmissivity),
            ("calibration_wavelength_code", Header::CalibrationWavelength),
            ("stability_limit_k", Header::StabilityLimit),
            ("stability_k", Header::Stability),
            ("scan_rate_k_per_min", Header::Rate),
        ] {
            let value = self.query(header, decode_number, doing).await?;
            values.push(MonitorReading { name: name.to_owned(), value });
        }
        for (name, header) in [("soft_cutout_k", Header::SoftCutout), ("hard_cutout_k", Header::HardCutout)] {
            let celsius = self.query(header, decode_celsius, doing).await?;
            values.push(MonitorReading { name: name.to_owned(), value: Kelvin::from_celsius(celsius).0 });
        }
        Ok(values)
    }

    async fn make_safe(&mut self) -> Result<PlateReading, DriverError> {
        self.heats = false;
        let doing = "sending the plate to its rest";
        // Each step is tried even if an earlier one failed, as long as the unit answers; what failed first is told.
        let formats = answered(self.force_formats().await)?;
        let rest = self.set_confirmed(Header::SetPoint, SAFE_SET_POINT_C, CONFIRM_TOLERANCE, doing).await;
        let rest = answered(rest)?;
        // The display may fail where the block's sensor does not, and only the latter decides.
        let block = answered(self.query(Header::Block, decode_celsius, doing).await)?;
        // One that does not take its rest must not go on heating, however hot it is.
        let output = if rest.is_err() || block.as_ref().is_ok_and(|celsius| *celsius < SWITCH_OFF_BELOW_C) {
            let doing = "switching the output off";
            answered(self.set_confirmed(Header::OutputState, 0.0, CONFIRM_TOLERANCE, doing).await)?
                .map(|_| ())
        } else {
            Ok(())
        };
        // Whoever comes to the rig now needs the keypad. Where a password is asked for it was never locked.
        self.wire.tell(&Command::set(Header::KeypadLock, 0.0).encode(), "unlocking the keypad").await?;
        let apparent = answered(self.query(Header::Temperature, decode_celsius, doing).await)?;
        let stable = answered(self.query(Header::Stable, decode_flag, doing).await)?;
        let tripped = answered(self.query(Header::Tripped, decode_flag, doing).await)?;
        rest?;
        output?;
        formats?;
        let block_c = block?;
        Ok(PlateReading {
            apparent: Kelvin::from_celsius(apparent.unwrap_or(block_c)),
            block: Kelvin::from_celsius(block_c),
            set_point: Kelvin::from_celsius(SAFE_SET_POINT_C),
            // For the record only: what makes it safe is confirmed.
            stable: stable.unwrap_or(false),
            tripped: tripped.unwrap_or(false),
        })
    }
}

/// Passes on what a unit that answers has said, be it trouble; the outer error is that of a line on which nothing more can
/// be done.
fn answered<T>(result: Result<T, DriverError>) -> Result<Result<T, DriverError>, DriverError> {
    match result {
        Err(error) if error.is_missing_device() => Err(error),
        other => Ok(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::LineDecoder;
    use std::collections::HashMap;
    use std::sync::{Arc, Mutex};
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    /// A unit in whose memory everything lies that was told, but for a set-point that it does not take.
    async fn stubborn(mut far: DuplexStream, memory: Arc<Mutex<HashMap<Header, String>>>) {
        let mut decoder = LineDecoder::default();
        while let Ok(byte) = far.read_u8().await {
            let Some(Ok(line)) = decoder.push(byte) else { continue };
            let command = Command::decode(&line).unwrap();
            let answer = match (command.header, line.split_once(' ')) {
                (Header::SetPoint, Some(_)) => None,
                (header, Some((_, value))) => {
                    memory.lock().unwrap().insert(header, value.to_owned());
                    None
                }
                (Header::Identity, None) => Some("FLUKE,4181,A1,1.0".to_owned()),
                (header, None) => memory.lock().unwrap().get(&header).cloned().or(Some("300.0".to_owned())),
            };
            if let Some(answer) = answer {
                far.write_all(format!("{answer}\r").as_bytes()).await.unwrap();
            }
        }
    }

    /// It is hot, and does not take the set-point of its rest: its output is switched off, and the trouble is told.
    #[tokio::test(start_paused = true)]
    async fn a_plate_that_does_not_take_its_rest_does_not_heat_on() {
        let (near, far) = duplex(256);
        let memory: Arc<Mutex<HashMap<Header, String>>> = Arc::default();
        memory.lock().unwrap().insert(Header::OutputState, "1".to_owned());
        memory.lock().unwrap().insert(Header::Tripped, "0".to_owned());
        memory.lock().unwrap().insert(Header::KeypadLock, "1".to_owned());
        tokio::spawn(stubborn(far, Arc::clone(&memory)));
        let mut plate = Fluke418x::new(Wire::over(near, "plate"));
        let error = plate.make_safe().await.unwrap_err();
        assert!(error.to_string().contains("told 25, holds 300"), "{error}");
        let held = |header| memory.lock().unwrap().get(&header).cloned();
        assert_eq!(held(Header::OutputState).as_deref(), Some("0"));
        assert_eq!(held(Header::KeypadLock).as_deref(), Some("0"));
    }

    #[test]
    fn an_empty_error_queue_is_no_complaint() {
        assert!(is_complaint("command protected"));
        assert!(!is_complaint("no error"));
        assert!(!is_complaint("0,\"No error\""));
        assert!(!is_complaint("\"\""));
    }
}
