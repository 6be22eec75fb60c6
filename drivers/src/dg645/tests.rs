//! The codec's laws and the sources' examples.

use super::command::NOT_UNDERSTOOD;
use super::settings::settings_of;
use super::table::{TABLE, delivered};
use super::value::{decode_time, encode_time};
use super::*;
use crate::instrument::ShotProgram;
use proptest::prelude::*;

fn any_value(key: Key, kind: Kind, index: u32) -> BoxedStrategy<Option<Value>> {
    match kind {
        Kind::Act => Just(None).boxed(),
        Kind::Count(least, greatest) => (least..=greatest).prop_map(|n| Some(Value::Count(n))).boxed(),
        Kind::Time(least, greatest) => (least..=greatest).prop_map(|ps| Some(Value::Time(ps))).boxed(),
        Kind::Real(least, _) => {
            (0_u32..50).prop_map(move |n| Some(Value::Real(least + f64::from(n) / 100.0))).boxed()
        }
        Kind::Delay => (-5_000_000_i64..2_000_000_000_000_000)
            .prop_map(move |ps| Some(Value::Delay { after: if index == 0 { 2 } else { 0 }, ps }))
            .boxed(),
        Kind::Text => Just(Some(Value::Text(format!("{key:?}")))).boxed(),
    }
}

fn any_command() -> impl Strategy<Value = Command> {
    (0..TABLE.len(), 0_u32..10, any::<bool>()).prop_flat_map(|(place, number, asks)| {
        let row = &TABLE[place];
        let (least, greatest) = row.index.unwrap_or((0, 0));
        // T0 and T1 have no delay of their own.
        let least = if row.key == Key::Delay { 2 } else { least };
        let index = least + number % (greatest - least + 1);
        let asks = row.asks && (asks || !row.tells);
        any_value(row.key, row.kind, index).prop_map(move |value| Command {
            key: row.key,
            index,
            act: if asks { Act::Query } else { Act::Set(value) },
        })
    })
}

fn same(left: &Command, right: &Command) -> bool {
    match (&left.act, &right.act) {
        (Act::Set(Some(a)), Act::Set(Some(b))) => {
            (left.key, left.index) == (right.key, right.index) && a.is_same(b)
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
    fn any_answer_survives_the_line(command in any_command()) {
        if let Act::Set(Some(value)) = command.act {
            let back = Value::decode(command.key, &value.answer());
            prop_assert!(back.as_ref().is_ok_and(|back| back.is_same(&value)), "{value:?} {back:?}");
        }
    }

    #[test]
    fn times_are_exact_to_the_picosecond(ps in -2_000_000_000_000_000_i64..2_000_000_000_000_000) {
        prop_assert_eq!(decode_time(&encode_time(ps)), Some(ps));
        let with_exponent = format!("{ps}e-12");
        prop_assert_eq!(decode_time(&with_exponent), Some(ps));
    }

    #[test]
    fn no_line_makes_the_codec_panic(line in "[*A-Z]{0,5}[ -~]{0,60}") {
        let _ = Command::decode(&line);
        for row in TABLE {
            let _ = Value::decode(row.key, &line);
        }
    }
}

#[test]
fn the_table_has_one_row_per_key_and_what_is_delivered_is_legal() {
    for row in TABLE {
        assert_eq!(TABLE.iter().filter(|other| other.key == row.key).count(), 1, "{:?}", row.key);
    }
    for (key, index, value) in delivered() {
        let command = Command::set(key, index, value);
        assert_eq!(Command::decode(&command.encode()), Ok(command));
    }
}

/// Examples of the maker's driver and its tests.
#[test]
fn the_makers_examples_are_read_and_written() {
    let delay = Value::Delay { after: 2, ps: 1_000_000_000 };
    assert_eq!(Value::decode(Key::Delay, "2,+0.001000000000"), Ok(delay.clone()));
    assert_eq!(delay.answer(), "2,+0.001000000000");
    assert_eq!(Command::decode("DLAY 3,2,1.000000e-03"), Ok(Command::set(Key::Delay, 3, delay)));
    assert_eq!(Command::decode("DLAY? 3"), Ok(Command::query(Key::Delay, 3)));
    assert_eq!(Command::decode("PRES 1,2").map(|c| c.encode()), Ok("PRES 1,2".to_owned()));
    assert_eq!(Command::act(Key::Trigger).encode(), "*TRG");
    assert_eq!(Command::query(Key::LastError, 0).encode(), "LERR?");
    for (line, fault) in [
        ("TSRC 7", Fault::IllegalValue),
        ("TLVL 5.0", Fault::IllegalValue),
        ("INHB 6", Fault::IllegalValue),
        ("BURC 0", Fault::IllegalValue),
        ("BURT 2", Fault::IllegalValue),
        ("LAMP 1, 10.0", Fault::IllegalValue),
        ("TRAT -1", Fault::IllegalValue),
        ("DLAY 2,2,0", Fault::IllegalLink),
        ("DLAY 1,0,0", Fault::IllegalLink),
        ("DLAY 2,1,0", Fault::IllegalLink),
        ("*IDN", NOT_UNDERSTOOD),
        ("INSR 0", NOT_UNDERSTOOD),
        ("*SRE? 3", NOT_UNDERSTOOD),
        ("PULS 1", NOT_UNDERSTOOD),
    ] {
        assert_eq!(Command::decode(line), Err(fault), "{line}");
    }
    for (text, ps) in [
        ("0", Some(0)),
        ("+1e-7", Some(100_000)),
        (".5E-11", Some(5)),
        ("2000", Some(2_000_000_000_000_000)),
        ("0.0000000000019", Some(1)),
        ("1e99", None),
        ("", None),
        ("nan", None),
        ("1.2.3", None),
        ("--1", None),
    ] {
        assert_eq!(decode_time(text), ps, "{text}");
    }
}

#[test]
fn codes_keep_their_numbers() {
    assert_eq!(Fault::from_code(0), None);
    for code in 1..256 {
        assert_eq!(Fault::from_code(code).map(Fault::code), Some(code));
    }
}

/// The injector is off before anything else is told, and the last thing told is what arms it.
#[test]
fn a_program_begins_and_ends_with_the_injector() {
    let program = ShotProgram {
        period_ns: 20_000_000,
        wait_periods: 1,
        warm_up: 4,
        blanks: 4,
        inject: true,
        cycle_periods: 759,
        cycles: 12,
        camera_delay_ns: 900_000,
        camera_width_ns: 25_000,
        injector_delay_ns: 0,
        injector_width_ns: 1_000_000,
    };
    let lines = |program: &ShotProgram| -> Vec<String> {
        let told = settings_of(program).into_iter();
        told.map(|(key, index, value)| Command::set(key, index, value).encode()).collect()
    };
    let armed = lines(&program);
    assert_eq!(armed.first().map(String::as_str), Some("LAMP 1,0.5"));
    assert_eq!(armed.last().map(String::as_str), Some("LAMP 1,5"));
    for line in ["PRES 1,9", "PHAS 1,8", "BURC 9", "BURP 0.020000000000", "DLAY 3,2,0.001000000000", "TSRC 5"]
    {
        assert!(armed.iter().any(|told| told == line), "{line}: {armed:?}");
    }
    let harmless = lines(&ShotProgram { inject: false, ..program });
    assert!(harmless.iter().all(|line| line != "LAMP 1,5"), "{harmless:?}");
}
