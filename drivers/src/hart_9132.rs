//! Hart Scientific (Fluke) 9132 infrared calibrator and the classic Hart family: codec in both directions, and the driver.
//!
//! Manual: Hart/Fluke 9132 User Manual, section 8: RS-232 8N1, commands end with CR, any case, abbreviated to the
//! shortest unique form, a value after `=`; `s` set-point, `t` temperature, `u` units, scan mode and scan rate. How
//! replies look, the names of scan and cutout commands, echo and unasked readings differ between models of the family and
//! were not seen by us: replies are read in every form that means something, and none of those commands is relied on. The
//! unit has no block sensor, no output switch and no stable bit on its line.

use crate::error::DriverError;
use crate::instrument::{Calibrator, CalibratorSettings, Identity, PlateReading};
use crate::quantity::{Kelvin, KelvinDelta};
use crate::set_point::{SetPoint, check_limit};
use crate::steadiness::Steadiness;
use crate::wire::{LineHabits, Sign, Tries, Wire, WireSettings};
use async_trait::async_trait;
use std::time::Duration;

/// Bit rate at delivery, as the family is commonly found; the unit shows its own in the communication menu.
const BAUD: u32 = 2400;

/// The display's last digit, in °C.
const DIGIT_C: f64 = 0.01;

/// How far a confirmed set-point may lie from what was sent: one step of a unit that shows tenths.
const CONFIRM_TOLERANCE_C: f64 = 0.051;

/// Set-points of the safe state, in °C, the coolest first: a unit takes the first that lies in its range.
const SAFE_SET_POINTS_C: [f64; 3] = [25.0, 35.0, 50.0];

/// Temperatures outside of this range, in °C, are noise on the line: beyond any unit of the family.
const PLAUSIBLE_C: std::ops::RangeInclusive<f64> = -60.0..=700.0;

/// Tries of one set that is not confirmed.
const SET_TRIES: u32 = 2;

/// Tries of a reading or set in whose middle the unit was found changed.
const UNIT_TRIES: u32 = 2;

// ---------------------------------------------------------------------------------------------------- codec

/// What a command is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Header {
    /// `s`: set-point.
    SetPoint,
    /// `t`: temperature.
    Temperature,
    /// `u`: unit.
    Unit,
    /// `sc`: scan on or off.
    Scan,
    /// `sr`: scan rate in degrees per minute.
    ScanRate,
    /// `cu`: cutout.
    Cutout,
    /// `sa`: period of unasked readings in seconds, 0 for none.
    SamplePeriod,
    /// `du`: full (echo) or half duplex.
    Duplex,
    /// `*ver`: model and firmware.
    Version,
}

/// Header, what the driver sends, the whole word, and the fewest letters of it that are unique.
const TABLE: &[(Header, &str, &str, usize)] = &[
    (Header::SetPoint, "s", "setpoint", 1),
    (Header::Scan, "sc", "scan", 2),
    (Header::ScanRate, "sr", "srate", 2),
    (Header::SamplePeriod, "sa", "sample", 2),
    (Header::Temperature, "t", "temperature", 1),
    (Header::Unit, "u", "units", 1),
    (Header::Cutout, "cu", "cutout", 2),
    (Header::Duplex, "du", "duplex", 2),
    (Header::Version, "*ver", "*version", 2),
];

/// One command.
///
/// ```
/// use ditd_drivers::hart_9132::{Command, Header};
/// assert_eq!(Command::decode("SETPOINT = 150.0"), Some(Command::set(Header::SetPoint, "150.0")));
/// assert_eq!(Command::query(Header::Temperature).encode(), "t");
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Command {
    /// What it is about.
    pub header: Header,
    /// What stands after `=`; a query without.
    pub value: Option<String>,
}

impl Command {
    /// A query.
    pub fn query(header: Header) -> Self {
        Self { header, value: None }
    }

    /// A set.
    pub fn set(header: Header, value: &str) -> Self {
        Self { header, value: Some(value.to_owned()) }
    }

    /// The command as sent, without its line end.
    pub fn encode(&self) -> String {
        let (_, sent, ..) =
            TABLE.iter().find(|row| row.0 == self.header).expect("the table has a row for every header");
        match &self.value {
            None => (*sent).to_owned(),
            Some(value) => format!("{sent}={value}"),
        }
    }

    /// Reads a line as the unit does: any case, spaces ignored, BS erases, abbreviated words.
    pub fn decode(line: &str) -> Option<Self> {
        let mut text = String::new();
        for character in line.chars() {
            match character {
                '\u{8}' => drop(text.pop()),
                ' ' => {}
                other => text.push(other.to_ascii_lowercase()),
            }
        }
        let (word, value) = match text.split_once('=') {
            Some((word, value)) => (word, Some(value.to_owned())),
            None => (&text[..], None),
        };
        let (header, ..) = TABLE.iter().find(|(_, sent, whole, fewest)| {
            word == *sent || (word.len() >= *fewest && whole.starts_with(word))
        })?;
        Some(Self { header: *header, value })
    }
}

/// The unit of a reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// °C.
    Celsius,
    /// °F.
    Fahrenheit,
}

/// A temperature as a reply tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// The number.
    pub value: f64,
    /// Its unit, if the reply names one.
    pub scale: Option<Scale>,
}

/// Writes a reply such as `set: 150.00 C`.
pub fn encode_told(label: &str, value: f64, scale: Scale) -> String {
    format!("{label}: {value:.2} {}", if scale == Scale::Celsius { "C" } else { "F" })
}

/// Reads a temperature of a reply: `t: 149.98 C`, `set: 150.00`, `149.98 C` or `149.98`.
///
/// # Errors
/// Says what is wrong: an echo, another label than one that begins with `initial`, no number, or one that is not finite.
pub fn decode_told(text: &str, initial: char) -> Result<Told, &'static str> {
    if text.contains('=') {
        return Err("an echo of a command");
    }
    let body = match text.split_once(':') {
        None => text,
        Some((label, body)) if label.trim().to_ascii_lowercase().starts_with(initial) => body,
        Some(_) => return Err("an answer to another query"),
    };
    let mut words = body.split_whitespace();
    let number = words.next().unwrap_or_default();
    let stem = number.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let glued = &number[stem.len()..];
    let is_number =
        !stem.is_empty() && stem.bytes().all(|byte| byte.is_ascii_digit() || b"+-.".contains(&byte));
    let value =
        stem.parse::<f64>().ok().filter(|value| is_number && value.is_finite()).ok_or("expected a number")?;
    let scale = match (glued, words.next(), words.next()) {
        ("", None, None) => None,
        ("", Some(word), None) => Some(decode_scale(word)?),
        (word, None, None) => Some(decode_scale(word)?),
        _ => return Err("expected a number and its unit"),
    };
    Ok(Told { value, scale })
}

/// Reads the reply to `u`: `u: C`, `units: F`, `C`.
///
/// # Errors
/// When it names neither.
pub fn decode_unit(text: &str) -> Result<Scale, &'static str> {
    if text.contains('=') {
        return Err("an echo of a command");
    }
    let word = match text.split_once(':') {
        None => text,
        Some((label, word)) if label.trim().to_ascii_lowercase().starts_with('u') => word,
        Some(_) => return Err("an answer to another query"),
    };
    decode_scale(word.trim())
}

fn decode_scale(word: &str) -> Result<Scale, &'static str> {
    match word.to_ascii_lowercase().as_str() {
        "c" | "degc" | "celsius" => Ok(Scale::Celsius),
        "f" | "degf" | "fahrenheit" => Ok(Scale::Fahrenheit),
        _ => Err("expected C or F"),
    }
}

/// Reads the reply to the cutout's query as far as it says whether it has tripped: `cu: 400 C, in`, `out`.
fn decode_cutout(text: &str) -> Option<bool> {
    let text = text.to_ascii_lowercase();
    let state = text.rsplit([',', ' ', ':']).find(|word| !word.is_empty())?;
    match state {
        "out" | "tripped" => Some(true),
        "in" | "ok" => Some(false),
        _ => None,
    }
}

/// Reads the reply to `*ver`: `ver.9132,1.00` and its like give model and firmware.
fn decode_version(text: &str) -> Option<(String, String)> {
    let rest = text.trim().to_ascii_lowercase();
    let rest = rest.strip_prefix("version").or_else(|| rest.strip_prefix("ver")).unwrap_or(&rest);
    let (model, firmware) = rest.trim_start_matches(['.', ':', ' ']).split_once(',')?;
    let is_model = model.len() >= 3 && model.bytes().all(|byte| byte.is_ascii_digit());
    is_model.then(|| (model.to_owned(), firmware.trim().to_owned()))
}

// --------------------------------------------------------------------------------------------------- driver

/// The line settings at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// A 9132 at the end of a wire.
#[derive(Debug)]
pub struct Hart9132 {
    wire: Wire,
    settings: Option<CalibratorSettings>,
    /// The unit answers its cutout's query in a form that is understood.
    tells_cutout: bool,
    steadiness: Steadiness,
}

impl Hart9132 {
    /// A driver over an open wire. Sends nothing.
    pub fn new(mut wire: Wire) -> Self {
        wire.adopt(LineHabits {
            ending: "\r",
            // 20 characters at 1200 baud take 0.2 s each way, the unit's own loop some tenths.
            deadline: Duration::from_secs(2),
            // Long enough for an echo at 1200 baud to show itself.
            pace: Duration::from_millis(60),
            // No other reply is C or F alone.
            sign: Some(Sign { query: "u", fits: |line| decode_unit(line).is_ok() }),
            hint: "Check power and cable, and that baud rate and `sample period 0` are set in its communication menu.",
        });
        Self { wire, settings: None, tells_cutout: false, steadiness: Steadiness::default() }
    }

    async fn query<T>(
        &mut self,
        header: Header,
        decode: impl Fn(&str) -> Result<T, &'static str>,
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
            tries.again(failure)?;
        }
    }

    /// One try of a query that not every unit knows; a line that is lost is an error all the same.
    async fn query_if_known<T>(
        &mut self,
        header: Header,
        decode: impl Fn(&str) -> Option<T>,
        doing: &str,
    ) -> Result<Option<T>, DriverError> {
        match self.wire.ask(&Command::query(header).encode(), doing).await {
            Ok(answer) => {
                let decoded = decode(&answer);
                if decoded.is_none() {
                    self.wire.distrust();
                }
                Ok(decoded)
            }
            Err(DriverError::Silent { tries: 1, .. } | DriverError::Garbled { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Tells something that not every unit knows. Whatever it answers is waited out and dropped.
    async fn tell_if_known(&mut self, header: Header, value: &str, doing: &str) -> Result<(), DriverError> {
        self.wire.tell(&Command::set(header, value).encode(), doing).await?;
        self.wire.resync(doing).await
    }

    /// A temperature in °C; `None` when the reply says that it is in °F.
    async fn celsius(
        &mut self,
        header: Header,
        initial: char,
        doing: &str,
    ) -> Result<Option<f64>, DriverError> {
        let decode = |text: &str| match decode_told(text, initial)? {
            Told { scale: Some(Scale::Fahrenheit), .. } => Ok(None),
            Told { value, .. } if PLAUSIBLE_C.contains(&value) => Ok(Some(value)),
            _ => Err("a temperature that this plate cannot have"),
        };
        self.query(header, decode, doing).await
    }

    async fn is_celsius(&mut self, doing: &str) -> Result<bool, DriverError> {
        Ok(self.query(Header::Unit, decode_unit, doing).await? == Scale::Celsius)
    }

    async fn force_celsius(&mut self) -> Result<(), DriverError> {
        let doing = "setting the unit";
        for _ in 0..SET_TRIES {
            self.wire.tell(&Command::set(Header::Unit, "c").encode(), doing).await?;
            // An echo or an acknowledgement comes now, and is not the answer to the query.
            self.wire.resync(doing).await?;
            if self.is_celsius(doing).await? {
                return Ok(());
            }
        }
        Err(self.refused(doing, "the unit stays °F".to_owned()))
    }

    /// Tells a set-point in °C and reads it back; what it holds then.
    async fn set_celsius(&mut self, target_c: f64, doing: &str) -> Result<f64, DriverError> {
        let mut held = None;
        for _ in 0..SET_TRIES.max(UNIT_TRIES) {
            if !self.is_celsius(doing).await? {
                self.force_celsius().await?;
            }
            self.wire
                .tell(&Command::set(Header::SetPoint, &format!("{target_c:.2}")).encode(), doing)
                .await?;
            self.wire.resync(doing).await?;
            held = self.celsius(Header::SetPoint, 's', doing).await?;
            let confirmed = held.filter(|held| (held - target_c).abs() <= CONFIRM_TOLERANCE_C);
            if let Some(held) = confirmed
                && self.is_celsius(doing).await?
            {
                return Ok(held);
            }
        }
        let held = held.map_or_else(|| "a set-point in °F".to_owned(), |held| format!("{held:.2} °C"));
        Err(self.refused(doing, format!("told {target_c:.2} °C, holds {held}")))
    }

    async fn is_tripped(&mut self, doing: &str) -> Result<bool, DriverError> {
        if !self.tells_cutout {
            return Ok(false);
        }
        let decode = |text: &str| decode_cutout(text).ok_or("expected the cutout's state");
        self.query(Header::Cutout, decode, doing).await
    }

    async fn check_cutout(&mut self, doing: &str) -> Result<(), DriverError> {
        if !self.is_tripped(doing).await? {
            return Ok(());
        }
        Err(DriverError::interlock(
            self.wire.name(),
            doing,
            "its cutout has tripped: the plate does not heat",
            "Find out why it became too hot, then reset the cutout at the unit.",
        ))
    }

    fn refused(&self, doing: &str, why: String) -> DriverError {
        DriverError::refused(
            self.wire.name(),
            doing,
            why,
            "Check at the keypad that it shows its temperature and that the set-point lies in its range.",
        )
    }
}

#[async_trait]
impl Calibrator for Hart9132 {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let doing = "asking who it is";
        // Units that send readings by themselves or echo would be taken for babblers: ask for quiet before anything else.
        self.wire.tell(&Command::set(Header::SamplePeriod, "0").encode(), doing).await?;
        self.query(Header::Unit, decode_unit, doing).await?;
        let version = self.query_if_known(Header::Version, decode_version, doing).await?;
        let (model, firmware) =
            version.unwrap_or_else(|| ("unknown model of the Hart family".to_owned(), String::new()));
        Ok(Identity { maker: "Hart Scientific".to_owned(), model, serial: String::new(), firmware })
    }

    async fn prepare(&mut self, settings: &CalibratorSettings) -> Result<(), DriverError> {
        self.settings = None;
        check_limit(self.wire.name(), settings)?;
        self.tell_if_known(Header::Duplex, "h", "switching the echo off").await?;
        self.force_celsius().await?;
        self.tells_cutout =
            self.query_if_known(Header::Cutout, decode_cutout, "asking for the cutout").await?.is_some();
        self.check_cutout("checking the cutout").await?;
        let rate = format!("{:.1}", settings.rate_k_per_min);
        self.tell_if_known(Header::ScanRate, &rate, "setting the scan rate").await?;
        self.tell_if_known(Header::Scan, "on", "switching the scan on").await?;
        self.settings = Some(settings.clone());
        Ok(())
    }

    async fn set_point(&mut self, target: Kelvin) -> Result<Kelvin, DriverError> {
        let target = SetPoint::new(self.wire.name(), target, DIGIT_C.recip(), self.settings.as_ref())?;
        self.check_cutout(&target.doing).await?;
        Ok(Kelvin::from_celsius(self.set_celsius(target.celsius, &target.doing).await?))
    }

    async fn read(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "reading the plate";
        let limit = self.settings.as_ref().map_or(KelvinDelta(0.0), |settings| settings.stability);
        for _ in 0..UNIT_TRIES {
            let apparent = self.celsius(Header::Temperature, 't', doing).await?;
            let set_point = self.celsius(Header::SetPoint, 's', doing).await?;
            // Asked after the numbers, which may not name their unit.
            let (true, Some(apparent), Some(set_point)) =
                (self.is_celsius(doing).await?, apparent, set_point)
            else {
                self.force_celsius().await?;
                continue;
            };
            let (apparent, set_point) = (Kelvin::from_celsius(apparent), Kelvin::from_celsius(set_point));
            return Ok(PlateReading {
                apparent,
                block: apparent,
                set_point,
                stable: self.steadiness.is_stable(apparent, set_point, limit),
                tripped: self.is_tripped(doing).await?,
            });
        }
        Err(self.refused(doing, "the unit is changed to °F again and again".to_owned()))
    }

    async fn make_safe(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "sending the plate to its rest";
        let mut taken = Ok(f64::NAN);
        for rest_c in SAFE_SET_POINTS_C {
            taken = self.set_celsius(rest_c, doing).await;
            if !matches!(taken, Err(DriverError::Refused { .. })) {
                break;
            }
        }
        let set_point = Kelvin::from_celsius(taken?);
        // Its temperature is asked for the record only: the set-point is confirmed, and there is no output to switch.
        let apparent = self.celsius(Header::Temperature, 't', doing).await.ok().flatten();
        let apparent = Kelvin::from_celsius(apparent.unwrap_or(f64::NAN));
        let tripped = self.is_tripped(doing).await.unwrap_or(false);
        Ok(PlateReading { apparent, block: apparent, set_point, stable: false, tripped })
    }

    fn digit(&self) -> KelvinDelta {
        KelvinDelta(DIGIT_C)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEADERS: [Header; 9] = [
        Header::SetPoint,
        Header::Temperature,
        Header::Unit,
        Header::Scan,
        Header::ScanRate,
        Header::Cutout,
        Header::SamplePeriod,
        Header::Duplex,
        Header::Version,
    ];

    proptest! {
        #[test]
        fn any_command_survives_the_line(index in 0..HEADERS.len(), value in prop::option::of("[0-9]{1,4}\\.[0-9]")) {
            let command = Command { header: HEADERS[index], value };
            prop_assert_eq!(Command::decode(&command.encode()), Some(command.clone()));
            let spaced: String = command.encode().to_uppercase().chars().flat_map(|c| [c, ' ']).collect();
            prop_assert_eq!(Command::decode(&spaced), Some(command));
        }

        #[test]
        fn any_temperature_survives_the_line_in_every_form(centi in -6_000_i32..70_000, fahrenheit: bool) {
            let value = f64::from(centi) / 100.0;
            let scale = if fahrenheit { Scale::Fahrenheit } else { Scale::Celsius };
            let told = Told { value, scale: Some(scale) };
            let whole = encode_told("set", value, scale);
            prop_assert_eq!(decode_told(&whole, 's'), Ok(told));
            prop_assert_eq!(decode_told(whole.trim_start_matches("set: "), 's'), Ok(told));
            prop_assert_eq!(decode_told(&whole.replace(' ', ""), 's'), Ok(told));
            let bare = format!("{value:.2}");
            prop_assert_eq!(decode_told(&bare, 't'), Ok(Told { value, scale: None }));
            prop_assert!(decode_told(&whole, 't').is_err());
            let echo = format!("s={bare}");
            prop_assert!(decode_told(&echo, 's').is_err());
        }

        #[test]
        fn no_line_makes_the_codec_panic(line in "[ -~\u{8}]{0,40}") {
            drop(Command::decode(&line));
            let _ = decode_told(&line, 's');
            let _ = decode_unit(&line);
            let _ = decode_cutout(&line);
            drop(decode_version(&line));
        }
    }

    #[test]
    fn words_are_abbreviated_to_the_shortest_unique_form_and_bs_erases() {
        for (line, header) in [
            ("s", Header::SetPoint),
            ("set", Header::SetPoint),
            ("sc", Header::Scan),
            ("scan", Header::Scan),
            ("sr", Header::ScanRate),
            ("temp", Header::Temperature),
            ("sx\u{8}c", Header::Scan),
            ("*ve", Header::Version),
        ] {
            assert_eq!(Command::decode(line), Some(Command::query(header)), "{line}");
        }
        assert_eq!(Command::decode("c"), None);
        assert_eq!(Command::decode(""), None);
    }

    #[test]
    fn what_is_no_number_or_no_unit_is_rejected() {
        for text in ["", "t:", "t: NaN C", "t: --- C", "t: 1e3 C", "inf", "24,5 C", "24.5 C F", "t: 24.5 K"] {
            assert!(decode_told(text, 't').is_err(), "{text}");
        }
        for text in ["u", "u=c", "t: 24.5 C", "scan: OFF", "K", ""] {
            assert!(decode_unit(text).is_err(), "{text}");
        }
        assert_eq!(decode_unit("units: F"), Ok(Scale::Fahrenheit));
    }

    #[test]
    fn versions_and_cutouts_are_understood_where_they_can_be() {
        assert_eq!(decode_version("ver.9132,1.23"), Some(("9132".to_owned(), "1.23".to_owned())));
        assert_eq!(decode_version("version: 9133,2.0").unwrap().0, "9133");
        assert_eq!(decode_version("?"), None);
        assert_eq!(decode_cutout("cu: 400 C, in"), Some(false));
        assert_eq!(decode_cutout("cu: 400 C,out"), Some(true));
        assert_eq!(decode_cutout("cu: 400 C"), None);
    }
}
