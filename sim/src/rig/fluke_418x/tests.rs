//! The unit against the manual, and the driver over it.

use super::*;
use crate::rig::calibrator_bench::{assert_never_wrong, bad_answers, settings};
use crate::rig::plate::{PlateFault, PlateModel};
use ditd_drivers::error::DriverError;
use ditd_drivers::fluke_418x::Fluke418x;
use ditd_drivers::instrument::{Calibrator, CalibratorSettings};
use ditd_drivers::quantity::Kelvin;
use ditd_drivers::quantity::KelvinDelta;
use ditd_drivers::wire::Wire;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio::time::{sleep, timeout};

fn model() -> PlateModel {
    PlateModel::fluke_4181(296.15)
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

/// A reading is right or it is an error, and what is not late is survived.
#[tokio::test(start_paused = true)]
async fn bad_replies_never_make_a_wrong_reading() {
    for fault in bad_answers(&[1.2]) {
        let behaviour = FlukeBehaviour { faults: vec![fault.clone()], ..FlukeBehaviour::fluke_4181() };
        let (mut driver, plate) = prepared(behaviour, model()).await;
        let count = if matches!(fault, LineFault::Late { .. }) { 720 } else { 50 };
        let good = assert_never_wrong(&mut driver, &plate, &fault, count, 10.0).await;
        let least = if matches!(fault, LineFault::Late { .. }) { 600 } else { count };
        assert!(good >= least, "{fault:?}: {good}");
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
    let nan = PlateModel { faults: vec![PlateFault::NanReading { from_s: 50.0, until_s: 1e9 }], ..model() };
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
