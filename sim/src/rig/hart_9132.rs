//! The instrument's side of a Hart Scientific 9132 (or another of its family) on a stream of bytes.
//!
//! Same codec as the driver. What the manual leaves open can be chosen: how replies look, echo, unasked readings, and
//! whether the commands beyond set-point, temperature and unit are known. Knows no heat: that is the plate's.

use crate::rig::line::{Line, LineFault, Unsent, check_replies, check_seconds};
use crate::rig::plate::Plate;
use ditd_drivers::hart_9132::{Command, Header, Scale, encode_told};
use ditd_drivers::quantity::Kelvin;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::{Instant, sleep_until};

/// Set-points that the unit takes, in °C.
const RANGE_C: std::ops::RangeInclusive<f64> = 50.0..=500.0;

/// How replies look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReplyForm {
    /// `t: 149.98 C`.
    Labelled,
    /// `149.98 C`.
    WithUnit,
    /// `149.98`.
    Bare,
}

/// What a unit is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HartBehaviour {
    /// Time from a query to its reply, in seconds.
    #[serde(default = "HartBehaviour::reply_delay_s")]
    pub reply_delay_s: f64,
    /// How replies look.
    #[serde(default = "HartBehaviour::labelled")]
    pub form: ReplyForm,
    /// It sends every command back until it is told `du=h`.
    #[serde(default)]
    pub echo: bool,
    /// It was left in degrees Fahrenheit.
    #[serde(default)]
    pub fahrenheit: bool,
    /// It sends its temperature by itself so often, in seconds, until it is told `sa=0`; 0: never.
    #[serde(default)]
    pub sample_period_s: f64,
    /// It knows set-point, temperature and unit only, and is silent about everything else.
    #[serde(default)]
    pub basic: bool,
    /// Somebody sets it to °F at the keypad at this time, in seconds of the rig's clock.
    pub fahrenheit_at_s: Option<f64>,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub faults: Vec<LineFault>,
}

impl HartBehaviour {
    /// A unit as delivered.
    pub fn delivered() -> Self {
        Self {
            reply_delay_s: Self::reply_delay_s(),
            form: Self::labelled(),
            echo: false,
            fahrenheit: false,
            sample_period_s: 0.0,
            basic: false,
            fahrenheit_at_s: None,
            faults: Vec::new(),
        }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_replies(self.reply_delay_s, &self.faults)?;
        check_seconds("sample_period_s", self.sample_period_s)?;
        self.fahrenheit_at_s.iter().try_for_each(|at_s| check_seconds("fahrenheit_at_s", *at_s))
    }

    /// 15 characters at 2400 baud.
    fn reply_delay_s() -> f64 {
        0.060
    }

    fn labelled() -> ReplyForm {
        ReplyForm::Labelled
    }
}

/// Answers on a stream until the other side has gone. `start` is the zero of the rig's clock, which the plate shares.
///
/// # Panics
/// When another user of the plate has panicked while holding it, or the behaviour fails its check.
pub async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    plate: Arc<Mutex<Plate>>,
    behaviour: HartBehaviour,
    start: Instant,
) {
    assert_eq!(behaviour.check(), Ok(()), "the behaviour was checked where it was read");
    let delay = Duration::from_secs_f64(behaviour.reply_delay_s);
    let mut line = Line::new(stream, behaviour.faults.clone(), Unsent::Kept, start);
    let mut unit = Unit::new(&behaviour, plate);
    let mut sample = Instant::now();
    loop {
        let period = (unit.sample_period_s > 0.0).then(|| Duration::from_secs_f64(unit.sample_period_s));
        let command = tokio::select! {
            biased;
            command = line.next_command() => command,
            () = sleep_until(sample + period.unwrap_or_default()), if period.is_some() => {
                sample = Instant::now();
                unit.look(line.now_s());
                line.reply(&format!("{}\r", unit.temperature()), Duration::ZERO);
                continue;
            }
        };
        let Some(command) = command else { return };
        unit.look(line.now_s());
        let Ok(text) = command else { continue };
        if unit.echo {
            line.reply(&format!("{text}\r"), Duration::ZERO);
        }
        if let Some(answer) = Command::decode(&text).and_then(|command| unit.obey(&command)) {
            line.reply(&format!("{answer}\r\n"), delay);
        }
    }
}

/// What the unit remembers besides its plate.
struct Unit {
    plate: Arc<Mutex<Plate>>,
    form: ReplyForm,
    basic: bool,
    echo: bool,
    scale: Scale,
    fahrenheit_at_s: Option<f64>,
    sample_period_s: f64,
    scans: bool,
    rate_per_min: f64,
}

impl Unit {
    fn new(behaviour: &HartBehaviour, plate: Arc<Mutex<Plate>>) -> Self {
        let unit = Self {
            plate,
            form: behaviour.form,
            basic: behaviour.basic,
            echo: behaviour.echo,
            scale: if behaviour.fahrenheit { Scale::Fahrenheit } else { Scale::Celsius },
            fahrenheit_at_s: behaviour.fahrenheit_at_s,
            sample_period_s: behaviour.sample_period_s,
            scans: false,
            rate_per_min: 10.0,
        };
        // It heats whenever it is switched on.
        unit.plate().settings.output_on = true;
        unit
    }

    fn plate(&self) -> MutexGuard<'_, Plate> {
        self.plate.lock().expect("no user of the plate panics while holding it")
    }

    /// Goes on to a moment of the rig's clock.
    fn look(&mut self, now_s: f64) {
        self.plate().advance(now_s);
        if self.fahrenheit_at_s.is_some_and(|at_s| at_s <= now_s) {
            self.fahrenheit_at_s = None;
            self.scale = Scale::Fahrenheit;
        }
    }

    /// Obeys one command; gives the answer if it was a query.
    fn obey(&mut self, command: &Command) -> Option<String> {
        if self.basic && !matches!(command.header, Header::SetPoint | Header::Temperature | Header::Unit) {
            return None;
        }
        match &command.value {
            None => Some(self.answer(command.header)),
            Some(value) => {
                self.set(command.header, value);
                None
            }
        }
    }

    fn answer(&self, header: Header) -> String {
        match header {
            Header::SetPoint => self.told("set", self.plate().settings.set_point_k),
            Header::Temperature => self.temperature(),
            Header::Unit => self.labelled("u", if self.scale == Scale::Celsius { "C" } else { "F" }),
            Header::Scan => self.labelled("scan", if self.scans { "ON" } else { "OFF" }),
            Header::ScanRate => self.labelled("srat", &format!("{:.1} C/min", self.rate_per_min)),
            Header::Cutout => {
                let plate = self.plate();
                let (level, tripped) = (plate.settings.cutout_k, plate.is_tripped());
                let state = if tripped { "out" } else { "in" };
                self.labelled("cu", &format!("{:.0} C, {state}", Kelvin(level).celsius()))
            }
            Header::SamplePeriod => self.labelled("sa", &format!("{}", self.sample_period_s)),
            Header::Duplex => self.labelled("du", if self.echo { "FULL" } else { "HALF" }),
            Header::Version => "ver.9132,1.12".to_owned(),
        }
    }

    fn set(&mut self, header: Header, value: &str) {
        let number = value.trim_end_matches(|c: char| c.is_ascii_alphabetic()).parse::<f64>().ok();
        match (header, number) {
            (Header::SetPoint, Some(number)) => {
                let celsius = if self.scale == Scale::Celsius { number } else { (number - 32.0) / 1.8 };
                // What lies outside is not taken, and nothing is said.
                if RANGE_C.contains(&celsius) {
                    self.plate().settings.set_point_k = Kelvin::from_celsius(celsius).0;
                }
            }
            (Header::Unit, _) => {
                self.scale = if value.starts_with('f') { Scale::Fahrenheit } else { Scale::Celsius };
            }
            (Header::Scan, _) => {
                self.scans = matches!(value, "on" | "1");
                self.apply_rate();
            }
            (Header::ScanRate, Some(number)) => {
                self.rate_per_min = number.clamp(0.1, 500.0);
                self.apply_rate();
            }
            (Header::SamplePeriod, Some(number)) => self.sample_period_s = number.clamp(0.0, 4000.0),
            (Header::Duplex, _) => self.echo = value.starts_with('f'),
            _ => {}
        }
    }

    fn apply_rate(&self) {
        self.plate().settings.rate_k_per_min = if self.scans { self.rate_per_min } else { 500.0 };
    }

    fn temperature(&self) -> String {
        let display_k = self.plate().display_k();
        self.told("t", display_k)
    }

    fn told(&self, label: &str, kelvin: f64) -> String {
        let celsius = Kelvin(kelvin).celsius();
        let value = if self.scale == Scale::Celsius { celsius } else { celsius * 1.8 + 32.0 };
        let whole = encode_told(label, value, self.scale);
        match self.form {
            ReplyForm::Labelled => whole,
            ReplyForm::WithUnit => whole.split_once(": ").map_or(whole.clone(), |(_, rest)| rest.to_owned()),
            ReplyForm::Bare => format!("{value:.2}"),
        }
    }

    fn labelled(&self, label: &str, text: &str) -> String {
        if self.form == ReplyForm::Labelled { format!("{label}: {text}") } else { text.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::calibrator_bench::{assert_never_wrong, bad_answers, plate, settings};
    use crate::rig::plate::PlateFault;
    use ditd_drivers::error::DriverError;
    use ditd_drivers::hart_9132::Hart9132;
    use ditd_drivers::instrument::Calibrator;
    use ditd_drivers::wire::Wire;
    use tokio::io::duplex;
    use tokio::time::sleep;

    fn driven(behaviour: HartBehaviour, faults: Vec<PlateFault>) -> (Hart9132, Arc<Mutex<Plate>>) {
        let (near, far) = duplex(256);
        let plate = plate(faults);
        tokio::spawn(serve(far, Arc::clone(&plate), behaviour, Instant::now()));
        (Hart9132::new(Wire::over(near, "plate calibrator")), plate)
    }

    async fn prepared(behaviour: HartBehaviour) -> (Hart9132, Arc<Mutex<Plate>>) {
        let (mut driver, plate) = driven(behaviour, Vec::new());
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        (driver, plate)
    }

    /// Everything that the manual leaves open, in all combinations.
    #[tokio::test(start_paused = true)]
    async fn every_form_of_the_family_is_driven() {
        for form in [ReplyForm::Labelled, ReplyForm::WithUnit, ReplyForm::Bare] {
            for bits in 0..16 {
                let behaviour = HartBehaviour {
                    form,
                    echo: bits & 1 != 0,
                    fahrenheit: bits & 2 != 0,
                    basic: bits & 4 != 0,
                    // A unit that sends readings by itself and cannot be told to stop is set so at its keypad.
                    sample_period_s: if bits & 8 != 0 && bits & 4 == 0 { 1.0 } else { 0.0 },
                    ..HartBehaviour::delivered()
                };
                let (mut driver, plate) = prepared(behaviour.clone()).await;
                let taken = driver.set_point(Kelvin(403.0)).await.unwrap();
                assert!((taken.0 - 403.0).abs() < 0.006, "{behaviour:?}: {taken}");
                assert!((plate.lock().unwrap().settings.set_point_k - 403.0).abs() < 0.006, "{behaviour:?}");
                sleep(Duration::from_secs(1800)).await;
                for _ in 0..70 {
                    driver.read().await.unwrap();
                    sleep(Duration::from_secs(1)).await;
                }
                let reading = driver.read().await.unwrap();
                assert!((reading.apparent.0 - 403.0).abs() < 0.3, "{behaviour:?}: {reading:?}");
                assert!(reading.stable && !reading.tripped);
                let rest = driver.make_safe().await.unwrap();
                assert!((rest.set_point.celsius() - 50.0).abs() < 0.01, "{rest:?}");
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn model_and_firmware_are_told_where_they_are_known() {
        let (mut driver, _) = driven(HartBehaviour::delivered(), Vec::new());
        let identity = driver.identify().await.unwrap();
        assert_eq!((identity.model.as_str(), identity.firmware.as_str()), ("9132", "1.12"));
        let (mut driver, _) = driven(HartBehaviour { basic: true, ..HartBehaviour::delivered() }, Vec::new());
        assert!(driver.identify().await.unwrap().model.contains("unknown"));
    }

    /// 300 readings with bad replies: a reading is right or it is an error, and the set-point is what was confirmed.
    #[tokio::test(start_paused = true)]
    async fn bad_replies_never_make_a_wrong_reading() {
        for form in [ReplyForm::Labelled, ReplyForm::Bare] {
            for fault in bad_answers(&[2.4]) {
                let behaviour =
                    HartBehaviour { form, faults: vec![fault.clone()], ..HartBehaviour::delivered() };
                let (mut driver, plate) = driven(behaviour, Vec::new());
                driver.identify().await.unwrap();
                driver.prepare(&settings()).await.unwrap();
                let good = assert_never_wrong(&mut driver, &plate, &fault, 100, 15.0).await;
                assert!(good > 50, "{fault:?}: {good}");
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn fahrenheit_in_the_middle_changes_no_reading() {
        for form in [ReplyForm::Labelled, ReplyForm::Bare] {
            let at_s = Some(1000.0);
            let (mut driver, plate) =
                prepared(HartBehaviour { form, fahrenheit_at_s: at_s, ..HartBehaviour::delivered() }).await;
            driver.set_point(Kelvin(403.0)).await.unwrap();
            for _ in 0..1200 {
                sleep(Duration::from_secs(1)).await;
                let reading = driver.read().await.unwrap();
                let true_k = plate.lock().unwrap().surface_k();
                assert!((reading.apparent.0 - true_k).abs() < 3.0, "{reading:?} {true_k}");
                assert!((reading.set_point.0 - 403.0).abs() < 0.01);
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn limits_ranges_and_a_tripped_cutout() {
        let (mut driver, plate) = driven(HartBehaviour::delivered(), Vec::new());
        let error = driver.set_point(Kelvin(373.0)).await.unwrap_err();
        assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        let before = plate.lock().unwrap().settings.set_point_k;
        for kelvin in [560.1, f64::NAN, f64::INFINITY] {
            assert!(
                matches!(driver.set_point(Kelvin(kelvin)).await, Err(DriverError::Limit { .. })),
                "{kelvin}"
            );
        }
        // Below its own range: it holds what it held, and that is told.
        let error = driver.set_point(Kelvin(300.0)).await.unwrap_err();
        assert!(error.to_string().contains("holds 25.00"), "{error}");
        assert_eq!(plate.lock().unwrap().settings.set_point_k.to_bits(), before.to_bits());

        let trips = vec![PlateFault::CutoutTrips { at_s: 100.0 }];
        let (mut driver, _) = driven(HartBehaviour::delivered(), trips);
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        sleep(Duration::from_secs(200)).await;
        assert!(driver.read().await.unwrap().tripped);
        let error = driver.set_point(Kelvin(400.0)).await.unwrap_err();
        assert!(matches!(error, DriverError::Interlock { .. }), "{error}");
        driver.make_safe().await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn a_reading_that_is_no_number_is_an_error_and_the_safe_state_is_reached() {
        let faults = vec![PlateFault::NanReading { from_s: 50.0, until_s: 1e9 }];
        let (mut driver, plate) = driven(HartBehaviour::delivered(), faults);
        driver.identify().await.unwrap();
        driver.prepare(&settings()).await.unwrap();
        driver.set_point(Kelvin(400.0)).await.unwrap();
        sleep(Duration::from_secs(60)).await;
        assert!(matches!(driver.read().await, Err(DriverError::Garbled { .. })));
        driver.make_safe().await.unwrap();
        assert!((plate.lock().unwrap().settings.set_point_k - 323.15).abs() < 0.01);
    }
}
