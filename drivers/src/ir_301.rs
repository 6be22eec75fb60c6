//! Infrared Systems Development IR-301 black-body controller (IR-2100 series sources): registers, and the driver.
//!
//! Source: the public driver of the StarDICE experiment: Modbus RTU, 19200 8N1, unit 1, functions 3 and 6, and the
//! registers below. Ranges belong to the source that hangs on the controller and are not known here: the configured limit
//! rules, and every write is read back. The controller has no output switch, no rate and no emissivity setting on its line;
//! register 200 (operation mode) is left as it was set at the front.

use crate::error::DriverError;
use crate::instrument::{Calibrator, CalibratorSettings, Identity, PlateReading};
use crate::modbus::{Master, Question};
use crate::quantity::{Kelvin, KelvinDelta};
use crate::set_point::{LIMIT_HINT, SetPoint, check_limit};
use crate::steadiness::Steadiness;
use crate::wire::{Wire, WireSettings};
use async_trait::async_trait;

/// Bit rate (StarDICE driver).
const BAUD: u32 = 19_200;

/// The controller's address at delivery (StarDICE driver).
pub const UNIT: u8 = 1;

/// What the model register answers (StarDICE driver).
pub const MODEL: u16 = 5280;

/// Registers count in tenths of a degree Celsius, signed.
const TENTHS_PER_C: f64 = 10.0;

/// Set-point of the safe state, in °C: room temperature.
const SAFE_SET_POINT_C: f64 = 25.0;

/// Temperatures outside of this range, in °C, are a broken sensor: the hottest source of the series goes to 1200 °C.
const PLAUSIBLE_C: std::ops::RangeInclusive<f64> = -60.0..=1300.0;

/// What a register holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u16)]
pub enum Register {
    /// Always [`MODEL`].
    Model = 0,
    /// Firmware.
    Revision = 3,
    /// Temperature of the source, 0.1 °C, signed.
    Temperature = 100,
    /// 0: the sensor works.
    SensorError = 101,
    /// Heater power.
    Power = 103,
    /// Operation mode.
    Mode = 200,
    /// 0: no error.
    SystemError = 209,
    /// Set-point, 0.1 °C, signed.
    SetPoint = 300,
}

impl Register {
    /// All that are known.
    pub const ALL: [Self; 8] = [
        Self::Model,
        Self::Revision,
        Self::Temperature,
        Self::SensorError,
        Self::Power,
        Self::Mode,
        Self::SystemError,
        Self::SetPoint,
    ];

    /// Its number on the line.
    pub fn number(self) -> u16 {
        self as u16
    }

    /// The register of a number.
    pub fn of(number: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|register| register.number() == number)
    }
}

/// Writes a temperature in °C into a register; `None` when it does not fit.
pub fn encode_celsius(celsius: f64) -> Option<u16> {
    let tenths = (celsius * TENTHS_PER_C).round();
    if !(f64::from(i16::MIN)..=f64::from(i16::MAX)).contains(&tenths) {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, reason = "a whole number within the range of i16")]
    let tenths = tenths as i16;
    Some(tenths.cast_unsigned())
}

/// Reads a temperature of a register, in °C.
pub fn decode_celsius(register: u16) -> f64 {
    f64::from(register.cast_signed()) / TENTHS_PER_C
}

/// The line settings at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// An IR-301 at the end of a wire.
#[derive(Debug)]
pub struct Ir301 {
    master: Master,
    settings: Option<CalibratorSettings>,
    steadiness: Steadiness,
}

impl Ir301 {
    /// A driver over an open wire. Sends nothing.
    pub fn new(wire: Wire) -> Self {
        let baud = wire.baud().unwrap_or(BAUD);
        // Temperature and sensor error in one reading: all others are of one register.
        let sign = Question::Holding { register: Register::Temperature.number(), count: 2 };
        let hint =
            "Check power, cable (RS-232 or RS-485 adapter), baud rate and that its Modbus address is 1.";
        let master = Master::new(wire, UNIT, baud, Some(sign), hint);
        Self { master, settings: None, steadiness: Steadiness::default() }
    }

    async fn read_register(&mut self, register: Register, doing: &str) -> Result<u16, DriverError> {
        let question = Question::Holding { register: register.number(), count: 1 };
        Ok(self.master.read(question, doing).await?[0])
    }

    async fn read_celsius(&mut self, register: Register, doing: &str) -> Result<f64, DriverError> {
        let celsius = decode_celsius(self.read_register(register, doing).await?);
        if PLAUSIBLE_C.contains(&celsius) {
            return Ok(celsius);
        }
        Err(DriverError::Garbled {
            who: self.master.name().to_owned(),
            doing: doing.to_owned(),
            answer: format!("{celsius} °C"),
            why: "a temperature that this source cannot have".to_owned(),
            hint: "Check the sensor and its cable.".to_owned(),
        })
    }

    /// Sensor and system errors, in words; `None` when there is none.
    async fn trouble(&mut self, doing: &str) -> Result<Option<String>, DriverError> {
        let sensor = self.read_register(Register::SensorError, doing).await?;
        let system = self.read_register(Register::SystemError, doing).await?;
        Ok(match (sensor, system) {
            (0, 0) => None,
            (0, system) => Some(format!("the controller reports system error {system} (register 209)")),
            (sensor, _) => Some(format!("the controller reports sensor error {sensor} (register 101)")),
        })
    }

    async fn check_trouble(&mut self, doing: &str) -> Result<(), DriverError> {
        match self.trouble(doing).await? {
            None => Ok(()),
            Some(why) => Err(DriverError::interlock(
                self.master.name(),
                doing,
                why,
                "Look the number up in the controller's manual and clear it at the front.",
            )),
        }
    }

    async fn set_confirmed(&mut self, target_c: f64, doing: &str) -> Result<f64, DriverError> {
        let Some(value) = encode_celsius(target_c) else {
            let why = format!("{target_c} °C does not fit into a register");
            return Err(DriverError::limit(self.master.name(), doing, why, LIMIT_HINT));
        };
        self.master.write(Register::SetPoint.number(), value, doing).await?;
        // The answer to a write repeats it; what counts is what the controller holds.
        let held = self.read_register(Register::SetPoint, doing).await?;
        if held == value {
            return Ok(decode_celsius(held));
        }
        Err(DriverError::refused(
            self.master.name(),
            doing,
            format!("told {target_c:.1} °C, holds {:.1} °C", decode_celsius(held)),
            "Check the range of the source and that the controller is in remote operation.",
        ))
    }
}

#[async_trait]
impl Calibrator for Ir301 {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let doing = "asking who it is";
        let model = self.read_register(Register::Model, doing).await?;
        if model != MODEL {
            return Err(DriverError::refused(
                self.master.name(),
                doing,
                format!("its model register holds {model}, an IR-301 answers {MODEL}"),
                "Check the address: another instrument may sit on this line.",
            ));
        }
        let revision = self.read_register(Register::Revision, doing).await?;
        Ok(Identity {
            maker: "Infrared Systems Development".to_owned(),
            model: "IR-301".to_owned(),
            serial: String::new(),
            firmware: revision.to_string(),
        })
    }

    async fn prepare(&mut self, settings: &CalibratorSettings) -> Result<(), DriverError> {
        self.settings = None;
        check_limit(self.master.name(), settings)?;
        self.check_trouble("checking for errors").await?;
        self.settings = Some(settings.clone());
        Ok(())
    }

    async fn set_point(&mut self, target: Kelvin) -> Result<Kelvin, DriverError> {
        let target = SetPoint::new(self.master.name(), target, TENTHS_PER_C, self.settings.as_ref())?;
        self.check_trouble(&target.doing).await?;
        Ok(Kelvin::from_celsius(self.set_confirmed(target.celsius, &target.doing).await?))
    }

    async fn read(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "reading the plate";
        // A source whose sensor is broken shows a number like any other.
        self.check_trouble(doing).await?;
        let apparent = Kelvin::from_celsius(self.read_celsius(Register::Temperature, doing).await?);
        let set_point = Kelvin::from_celsius(self.read_celsius(Register::SetPoint, doing).await?);
        let limit = self.settings.as_ref().map_or(KelvinDelta(0.0), |settings| settings.stability);
        let stable = self.steadiness.is_stable(apparent, set_point, limit);
        Ok(PlateReading { apparent, block: apparent, set_point, stable, tripped: false })
    }

    async fn make_safe(&mut self) -> Result<PlateReading, DriverError> {
        let doing = "sending the source to its rest";
        let mut taken = self.set_confirmed(SAFE_SET_POINT_C, doing).await;
        if matches!(taken, Err(DriverError::Refused { .. })) {
            taken = self.set_confirmed(SAFE_SET_POINT_C, doing).await;
        }
        let set_point = Kelvin::from_celsius(taken?);
        // For the record only: the set-point is confirmed, and there is no output to switch.
        let celsius = self.read_celsius(Register::Temperature, doing).await.unwrap_or(f64::NAN);
        let apparent = Kelvin::from_celsius(celsius);
        let tripped = self.trouble(doing).await.is_ok_and(|trouble| trouble.is_some());
        Ok(PlateReading { apparent, block: apparent, set_point, stable: false, tripped })
    }

    fn digit(&self) -> KelvinDelta {
        KelvinDelta(1.0 / TENTHS_PER_C)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_register_is_a_temperature_and_back(register: u16) {
            prop_assert_eq!(encode_celsius(decode_celsius(register)), Some(register));
        }
    }

    #[test]
    fn negative_temperatures_and_what_does_not_fit() {
        assert_eq!(encode_celsius(-0.1), Some(0xffff));
        assert!((decode_celsius(0xffff) + 0.1).abs() < 1e-12);
        for celsius in [3276.8, -3276.9, f64::NAN, f64::INFINITY] {
            assert_eq!(encode_celsius(celsius), None, "{celsius}");
        }
        for register in Register::ALL {
            assert_eq!(Register::of(register.number()), Some(register));
        }
    }
}
