//! The instrument's side of an IR-301 black-body controller on a stream of bytes: Modbus RTU.
//!
//! Same codec and registers as the driver. Knows no heat: that is the plate's.

use crate::rig::line::{Line, LineFault, Unsent, check_replies};
use crate::rig::plate::Plate;
use ditd_drivers::ir_301::{MODEL, Register, UNIT, decode_celsius, encode_celsius};
use ditd_drivers::modbus::{Answer, Question, cut_question};
use ditd_drivers::quantity::Kelvin;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

/// Set-points that the controller takes, in °C.
const RANGE_C: std::ops::RangeInclusive<f64> = 0.0..=600.0;

/// Exceptions of the Modbus specification.
const NO_FUNCTION: u8 = 1;
const NO_REGISTER: u8 = 2;
const NO_VALUE: u8 = 3;

/// What a controller is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ir301Behaviour {
    /// Time from a question to its answer, in seconds.
    #[serde(default = "Ir301Behaviour::reply_delay_s")]
    pub reply_delay_s: f64,
    /// It refuses to read several registers at once.
    #[serde(default)]
    pub single_only: bool,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub faults: Vec<LineFault>,
}

impl Ir301Behaviour {
    /// A controller as delivered.
    pub fn delivered() -> Self {
        Self { reply_delay_s: Self::reply_delay_s(), single_only: false, faults: Vec::new() }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_replies(self.reply_delay_s, &self.faults)
    }

    /// 8 characters at 19200 baud and the controller's own loop.
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
    behaviour: Ir301Behaviour,
    start: Instant,
) {
    assert_eq!(behaviour.check(), Ok(()), "the behaviour was checked where it was read");
    let delay = Duration::from_secs_f64(behaviour.reply_delay_s);
    let mut line = Line::new(stream, behaviour.faults.clone(), Unsent::Kept, start);
    let unit = Unit { plate, single_only: behaviour.single_only };
    // It heats whenever it is switched on.
    unit.plate().settings.output_on = true;
    while let Some(frame) = line.next_frame(cut_question).await {
        unit.plate().advance(line.now_s());
        // Another unit's question, or none that is understood, is met by silence.
        if let Ok((UNIT, question)) = Question::decode(&frame) {
            line.reply_bytes(unit.obey(question).encode(UNIT, question), delay);
        }
    }
}

struct Unit {
    plate: Arc<Mutex<Plate>>,
    single_only: bool,
}

impl Unit {
    fn plate(&self) -> MutexGuard<'_, Plate> {
        self.plate.lock().expect("no user of the plate panics while holding it")
    }

    fn obey(&self, question: Question) -> Answer {
        match question {
            Question::Input { .. } => Answer::Refused(NO_FUNCTION),
            Question::Holding { count, .. } if self.single_only && count > 1 => Answer::Refused(NO_REGISTER),
            Question::Holding { register, count } => {
                let numbers = (0..count).map(|offset| register.checked_add(offset));
                let values: Option<Vec<u16>> =
                    numbers.map(|number| Some(self.value(Register::of(number?)?))).collect();
                values.map_or(Answer::Refused(NO_REGISTER), Answer::Registers)
            }
            Question::Write { register, value } if register == Register::SetPoint.number() => {
                let celsius = decode_celsius(value);
                if !RANGE_C.contains(&celsius) {
                    return Answer::Refused(NO_VALUE);
                }
                self.plate().settings.set_point_k = Kelvin::from_celsius(celsius).0;
                Answer::Written { register, value }
            }
            Question::Write { .. } => Answer::Refused(NO_REGISTER),
        }
    }

    fn value(&self, register: Register) -> u16 {
        let plate = self.plate();
        let celsius = |kelvin: f64| encode_celsius(Kelvin(kelvin).celsius());
        // Without a number the sensor is broken, and the register holds its least value.
        let shown = celsius(plate.display_k());
        match register {
            Register::Model => MODEL,
            Register::Revision => 104,
            Register::Temperature => shown.unwrap_or(0x8000),
            Register::SensorError => u16::from(shown.is_none()),
            Register::Power => percent(plate.duty_percent()),
            Register::Mode => 1,
            Register::SystemError => 3 * u16::from(plate.is_tripped()),
            Register::SetPoint => celsius(plate.settings.set_point_k).unwrap_or(0),
        }
    }
}

fn percent(duty: f64) -> u16 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 … 100")]
    let whole = duty.clamp(0.0, 100.0).round() as u16;
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::calibrator_bench::{assert_never_wrong, bad_answers, plate, settings};
    use crate::rig::plate::PlateFault;
    use ditd_drivers::error::DriverError;
    use ditd_drivers::instrument::Calibrator;
    use ditd_drivers::ir_301::Ir301;
    use ditd_drivers::wire::Wire;
    use tokio::io::duplex;
    use tokio::time::sleep;

    async fn prepared(behaviour: Ir301Behaviour, faults: Vec<PlateFault>) -> (Ir301, Arc<Mutex<Plate>>) {
        let (near, far) = duplex(256);
        let plate = plate(faults);
        tokio::spawn(serve(far, Arc::clone(&plate), behaviour, Instant::now()));
        let mut driver = Ir301::new(Wire::over(near, "plate calibrator"));
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        (driver, plate)
    }

    #[tokio::test(start_paused = true)]
    async fn a_level_is_reached_read_and_left() {
        for single_only in [false, true] {
            let behaviour = Ir301Behaviour { single_only, ..Ir301Behaviour::delivered() };
            let (mut driver, plate) = prepared(behaviour, Vec::new()).await;
            // 99.85 °C lies between two tenths.
            let taken = driver.set_point(Kelvin(373.0)).await.unwrap();
            assert!((taken.0 - 373.0).abs() < 0.0501, "{taken}");
            assert!((plate.lock().unwrap().settings.set_point_k - taken.0).abs() < 1e-9);
            sleep(Duration::from_secs(1500)).await;
            for _ in 0..70 {
                driver.read().await.unwrap();
                sleep(Duration::from_secs(1)).await;
            }
            let reading = driver.read().await.unwrap();
            assert!((reading.apparent.0 - taken.0).abs() < 0.2 && reading.stable, "{reading:?}");
            assert_eq!(driver.make_safe().await.unwrap().set_point, Kelvin::from_celsius(25.0));
            assert!((plate.lock().unwrap().settings.set_point_k - 298.15).abs() < 1e-9);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn bad_replies_never_make_a_wrong_reading() {
        for fault in bad_answers(&[1.2, 2.9]) {
            let behaviour = Ir301Behaviour { faults: vec![fault.clone()], ..Ir301Behaviour::delivered() };
            let (mut driver, plate) = prepared(behaviour, Vec::new()).await;
            let good = assert_never_wrong(&mut driver, &plate, &fault, 200, 10.0).await;
            assert!(good > 150, "{fault:?}: {good}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn limits_errors_of_sensor_and_system_and_another_instrument() {
        let trips = vec![PlateFault::CutoutTrips { at_s: 100.0 }];
        let (mut driver, _) = prepared(Ir301Behaviour::delivered(), trips).await;
        for kelvin in [560.2, f64::NAN] {
            assert!(
                matches!(driver.set_point(Kelvin(kelvin)).await, Err(DriverError::Limit { .. })),
                "{kelvin}"
            );
        }
        let error = driver.set_point(Kelvin(200.0)).await.unwrap_err();
        assert!(error.to_string().contains("not allowed"), "{error}");
        sleep(Duration::from_secs(200)).await;
        let error = driver.read().await.unwrap_err();
        assert!(error.to_string().contains("system error 3") && error.is_interlock_or_limit(), "{error}");
        assert!(driver.make_safe().await.unwrap().tripped);

        let broken = vec![PlateFault::NanReading { from_s: 50.0, until_s: 1e9 }];
        let (mut driver, _) = prepared(Ir301Behaviour::delivered(), broken).await;
        sleep(Duration::from_secs(60)).await;
        let error = driver.read().await.unwrap_err();
        assert!(error.to_string().contains("sensor error 1"), "{error}");
        driver.make_safe().await.unwrap();

        let (near, far) = duplex(256);
        tokio::spawn(async move {
            let mut line = Line::new(far, vec![], Unsent::Kept, Instant::now());
            while let Some(frame) = line.next_frame(cut_question).await {
                let (unit, question) = Question::decode(&frame).unwrap();
                let Question::Holding { count, .. } = question else { continue };
                let answer = Answer::Registers(vec![7; usize::from(count)]);
                line.reply_bytes(answer.encode(unit, question), Duration::ZERO);
            }
        });
        let error = Ir301::new(Wire::over(near, "plate calibrator")).identify().await.unwrap_err();
        assert!(error.to_string().contains("an IR-301 answers 5280"), "{error}");
    }
}
