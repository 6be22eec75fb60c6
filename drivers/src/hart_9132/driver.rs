//! The driver of a 9132 and its family.

use super::codec::{Command, Header, Scale, Told, decode_cutout, decode_told, decode_unit, decode_version};
use crate::error::DriverError;
use crate::instrument::{Calibrator, CalibratorSettings, Identity, PlateReading};
use crate::quantity::{Kelvin, KelvinDelta};
use crate::set_point::{SetPoint, check_limit};
use crate::steadiness::Steadiness;
use crate::wire::{LineHabits, Sign, Tries, Wire};
use async_trait::async_trait;
use std::time::Duration;

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
