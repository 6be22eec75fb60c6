//! The codec's laws and the manual's examples, and what the driver remembers of injections.

use super::command::UNIT_ERRORS;
use super::table::{DELAY_MAX_PS, Place, TABLE};
use super::value::{decode_time, encode_time, encode_value};
use super::*;
use crate::error::DriverError;
use crate::instrument::{ShotProgram, TriggerUnit};
use crate::trigger_limits::TriggerLimits;
use crate::wire::{LineDecoder, Wire};
use proptest::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio::time::sleep;

fn any_value(kind: Kind) -> BoxedStrategy<Option<Value>> {
    match kind {
        Kind::Act => Just(None).boxed(),
        Kind::Flag => any::<bool>().prop_map(|on| Some(Value::Flag(on))).boxed(),
        Kind::Count(least, greatest) => (least..=greatest).prop_map(|n| Some(Value::Count(n))).boxed(),
        Kind::Time(least, greatest) => {
            (least / 250..=greatest / 250).prop_map(|n| Some(Value::Time(n * 250))).boxed()
        }
        Kind::Volts(least, _) => {
            (0_u32..100).prop_map(move |n| Some(Value::Volts(least + f64::from(n) / 100.0))).boxed()
        }
        Kind::Word(words) => prop::sample::select(words)
            .prop_map(|word| Some(Value::Word(word.chars().filter(|c| !c.is_ascii_lowercase()).collect())))
            .boxed(),
        Kind::Text => "[A-Z][A-Z ]{0,8}[A-Z]".prop_map(|text| Some(Value::Text(text))).boxed(),
    }
}

fn any_command() -> impl Strategy<Value = Command> {
    (0..TABLE.len(), 1_u32..8, any::<bool>()).prop_flat_map(|(index, number, asks)| {
        let row = &TABLE[index];
        let channel = match row.place {
            Place::Unit => None,
            Place::Clock => Some(0),
            _ => Some(number),
        };
        let asks = row.asks && (asks || !row.tells);
        any_value(row.kind).prop_map(move |value| {
            let value = match value {
                // Periods have a grain of 10 ns.
                Some(Value::Time(ps)) if row.key == Key::Period => Some(Value::Time(ps / 10_000 * 10_000)),
                other => other,
            };
            let act = if asks { Act::Query(None) } else { Act::Set(value) };
            Command { key: row.key, channel, act }
        })
    })
}

fn same(left: &Command, right: &Command) -> bool {
    match (&left.act, &right.act) {
        (Act::Set(Some(Value::Volts(a))), Act::Set(Some(Value::Volts(b)))) => {
            left.key == right.key && (a - b).abs() < 0.005
        }
        _ => left == right,
    }
}

proptest! {
    #[test]
    fn any_command_survives_the_line(command in any_command()) {
        let back = Command::decode(&command.encode());
        prop_assert!(back.as_ref().is_ok_and(|back| same(back, &command)), "{command:?} {back:?}");
    }

    #[test]
    fn any_reply_survives_the_line(command in any_command(), error in 0_usize..8) {
        let failed = Reply::Failed(UNIT_ERRORS[error]);
        prop_assert_eq!(Reply::decode(command.key, &failed.encode(command.key)), Ok(failed));
        prop_assert_eq!(Reply::decode(command.key, "ok"), Ok(Reply::Done));
        if let Act::Set(Some(value @ (Value::Flag(_) | Value::Count(_) | Value::Time(_) | Value::Word(_)))) =
            command.act
        {
            let reply = Reply::Value(value);
            prop_assert_eq!(Reply::decode(command.key, &reply.encode(command.key)), Ok(reply));
        }
    }

    #[test]
    fn no_line_makes_the_codec_panic(line in "[:*]?[ -~]{0,60}") {
        let _ = Command::decode(&line);
        for row in TABLE {
            let _ = Reply::decode(row.key, &line);
        }
    }
}

#[test]
fn the_table_has_one_row_per_key() {
    for row in TABLE {
        assert_eq!(TABLE.iter().filter(|other| other.key == row.key).count(), 1, "{:?}", row.key);
    }
}

/// Examples of chapter 7.
#[test]
fn the_manuals_examples_are_read_and_written() {
    let width = Reply::decode(Key::Width, "0.000120000").unwrap();
    assert_eq!(width, Reply::Value(Value::Time(120_000_000)));
    assert_eq!(width.encode(Key::Width), "0.000120000");
    assert_eq!(Reply::decode(Key::Polarity, "NORM"), Ok(Reply::Value(Value::Word("NORM".to_owned()))));
    let period = Command::set_channel(0, Key::Period, Value::Time(20_000_000_000));
    assert_eq!(period.encode(), ":PULSE0:PER 0.020000000");
    let long = Command::decode(":pulse0:period 0.02");
    assert_eq!(long, Ok(period));
    assert_eq!(encode_time(DELAY_MAX_PS, false), "999.99999999975");
    assert_eq!(decode_time("-999.99999999975"), Some(-DELAY_MAX_PS));
    assert_eq!(Command::query(Key::Running).encode(), ":SYST:STAT?");
}

#[test]
fn bad_commands_get_the_units_error_numbers() {
    use UnitError::{Keyword, MissingKeyword, MissingParameter, NoQuery, Parameter, Prefix, QueryOnly};
    for (line, error) in [
        ("PULSE1:STATE 1", Prefix),
        (":", MissingKeyword),
        (":PULSE1:", MissingKeyword),
        (":PULSE1:POLAR NORM", Keyword),
        (":PULSE1:PER 1", Keyword),
        (":PULSE0:WIDT 1", Keyword),
        (":PULSE1:WIDT", MissingParameter),
        (":PULSE1:WIDT 1e-3", Parameter),
        (":PULSE1:WIDT 1000", Parameter),
        (":PULSE1:POL POSITIVE", Parameter),
        (":PULSE0:BCO 0", Parameter),
        (":SYST:STAT 1", QueryOnly),
        ("*TRG?", NoQuery),
    ] {
        assert_eq!(Command::decode(line), Err(error), "{line}");
    }
}

/// A 9530 puts a question mark behind the name of a reference to which it is not locked.
#[test]
fn an_unlocked_clock_is_told_from_a_locked_one() {
    let read = |text| Reply::decode(Key::ClockIn, text);
    assert_eq!(read("SYS"), Ok(Reply::Value(Value::Word("SYS".to_owned()))));
    assert_eq!(read("XPL?"), Ok(Reply::Value(Value::Unlocked("XPL".to_owned()))));
    assert_eq!(read("EXT10?"), Ok(Reply::Value(Value::Unlocked("EXT10".to_owned()))));
    assert_eq!(Reply::Value(Value::Unlocked("XPL".to_owned())).encode(Key::ClockIn), "XPL?");
    assert!(read("0.1").is_err() && read("??").is_err());
    // A question mark has no place behind any other word.
    assert!(Reply::decode(Key::Polarity, "NORM?").is_err());
}

/// A unit that holds what it is told and runs when it is told to; mute on command.
async fn unit(mut far: DuplexStream, mute: Arc<AtomicBool>) {
    let mut decoder = LineDecoder::default();
    let mut held: HashMap<(Option<u32>, Key), String> = HashMap::new();
    while let Ok(byte) = far.read_u8().await {
        let Some(Ok(line)) = decoder.push(byte) else { continue };
        if mute.load(Ordering::Relaxed) {
            continue;
        }
        let command = Command::decode(&line).unwrap();
        let answer = match (&command.act, command.key) {
            (Act::Set(Some(value)), key) => {
                held.insert((command.channel, key), encode_value(key, value));
                "ok".to_owned()
            }
            (Act::Set(None), _) => "ok".to_owned(),
            (Act::Query(_), Key::Catalogue) => "T0,CHA,CHB".to_owned(),
            (Act::Query(_), Key::ClockIn) => "SYS".to_owned(),
            (Act::Query(_), Key::Running) => {
                held.get(&(Some(0), Key::State)).cloned().unwrap_or("0".to_owned())
            }
            (Act::Query(_), key) => held[&(command.channel, key)].clone(),
        };
        far.write_all(format!("{answer}\r\n").as_bytes()).await.unwrap();
    }
}

/// The line is dead while a burst is stopped, so that the burst goes on: its later injections count for the next one.
#[tokio::test(start_paused = true)]
async fn a_burst_that_could_not_be_stopped_counts_to_its_end() {
    let limits = TriggerLimits {
        injector_pulse_max_s: 0.005,
        injection_interval_min_s: 15.0,
        camera_integration_s: 25e-6,
        camera_readout_s: 0.008,
    };
    // Injections 0, 15, 30, … s after the start.
    let program = ShotProgram {
        period_ns: 20_000_000,
        wait_periods: 0,
        warm_up: 0,
        blanks: 0,
        inject: true,
        cycle_periods: 750,
        cycles: 5,
        camera_delay_ns: 900_000,
        camera_width_ns: 25_000,
        injector_delay_ns: 0,
        injector_width_ns: 1_000_000,
    };
    let (near, far) = duplex(256);
    let mute = Arc::new(AtomicBool::new(false));
    tokio::spawn(unit(far, Arc::clone(&mute)));
    let mut driver = Quantum9520::new(Wire::over(near, "trigger unit"), limits);
    driver.program(&program).await.unwrap();
    let begun = driver.start().await.unwrap();
    assert!(begun.earliest <= begun.latest);
    mute.store(true, Ordering::Relaxed);
    assert!(driver.stop().await.is_err());
    let failed_after = begun.earliest.elapsed();
    assert!(failed_after < Duration::from_secs(28), "{failed_after:?}");
    // It is heard again shortly after the injection at 30 s.
    sleep(Duration::from_secs(31) - failed_after).await;
    mute.store(false, Ordering::Relaxed);
    driver.stop().await.unwrap();
    driver.program(&program).await.unwrap();
    // 15 s have gone since the failure, but not since that injection.
    sleep(Duration::from_secs(44).saturating_sub(begun.earliest.elapsed())).await;
    let error = driver.start().await.unwrap_err();
    assert!(matches!(error, DriverError::Limit { .. }), "{error}");
    sleep(Duration::from_secs(3)).await;
    driver.start().await.unwrap();
}
