//! Process values in whole campaigns: in telemetry, journal and summary, the same in a replay, and their limits.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, Ran, assert_replays};
use ditd::config::Config;
use ditd::journal::Record;

/// The chamber's sensors without a line, and the same over one.
const MONITORS: &str = r#"[
    { name = "chamber", driver = "sim", address = "sim", value = [
        { name = "wall_temperature_k", low = 500.0, high = 540.0 },
        { name = "fuel_temperature_k" },
    ] },
    { name = "rack", driver = "ascii_query", address = "sim", required = false, value = [
        { name = "chamber_pressure_pa", query = "ALL?", field = 0 },
        { name = "gas_temperature_k", query = "gas_temperature_k?", offset = 1.0 },
        { name = "rail_pressure_pa", query = "rail_pressure_pa?" },
    ] },
]"#;

fn monitored() -> Preset {
    Preset::small()
        .calibrated()
        .with("monitor", &MONITORS.replace('\n', " "))
        .with("rig.process.fuel_temperature_k", "353.0")
        .with("rig.process.rail_pressure_pa", "2e7")
}

/// The cycle that process values belong to, and their names and values.
type CycleValues = (Option<u32>, Vec<(String, f64)>);

fn values(ran: &Ran) -> Vec<CycleValues> {
    let of = |record| match record {
        Record::ProcessValues { cycle, values, .. } => {
            Some((cycle, values.into_iter().map(|value| (value.name, value.value)).collect()))
        }
        _ => None,
    };
    ran.records().into_iter().filter_map(of).collect()
}

#[test]
fn values_are_in_telemetry_journal_and_summary_and_a_replay_is_the_same() {
    let ran = monitored().with("rig.process.noise", "0.001").run().done();
    let telemetry = std::fs::read_to_string(ran.path.join("telemetry.csv")).unwrap();
    let header: Vec<&str> = telemetry.lines().next().unwrap().split(',').collect();
    assert_eq!(header[6], "plate_tripped", "columns of before stay where they were");
    assert_eq!(header[7], "chamber.wall_temperature_k");
    assert_eq!(header.len(), 7 + 5);
    for line in telemetry.lines() {
        assert_eq!(line.split(',').count(), header.len(), "{line}");
    }
    let values = values(&ran);
    let cycles = values.iter().filter(|(cycle, _)| cycle.is_some()).count();
    assert_eq!((cycles, values.len()), (9, 12), "one a cycle and one a level");
    for (_, values) in &values {
        for ((name, value), (expected_name, expected)) in values.iter().zip([
            ("chamber.wall_temperature_k", 523.0),
            ("chamber.fuel_temperature_k", 353.0),
            ("rack.chamber_pressure_pa", 4e5),
            ("rack.gas_temperature_k", 524.0),
            ("rack.rail_pressure_pa", 2e7),
        ]) {
            assert_eq!(name, expected_name);
            // Noise of one thousandth: six of its standard deviations.
            assert!((value / expected - 1.0).abs() < 0.006, "{name} {value}");
        }
    }
    // The summary's figures are those of the journal's cycles.
    let walls: Vec<f64> = values.iter().filter(|(cycle, _)| cycle.is_some()).map(|(_, v)| v[0].1).collect();
    let summary = ran.summary();
    let level = &summary["levels"][1]["monitors"]["chamber.wall_temperature_k"];
    assert_eq!(level["count"], 3);
    let mean = walls[3..6].iter().sum::<f64>() / 3.0;
    assert!((level["mean"].as_f64().unwrap() - mean).abs() < 1e-9 * mean, "{level}");
    assert_replays(&ran.path);
}

#[test]
fn a_value_beyond_its_limit_ends_with_status_4_and_names_both() {
    for (to, side, limit) in [("480.0", "below", "500"), ("541.5", "above", "540")] {
        for at_s in ["100.0", "900.0"] {
            let fault =
                format!("[{{ kind = \"step\", value = \"wall_temperature_k\", at_s = {at_s}, to = {to} }}]");
            let ran = monitored().with("rig.process.faults", &fault).run();
            let error = ran.error();
            assert_eq!(error.code(), 4, "{error}");
            let words = format!(
                "chamber.wall_temperature_k is {}, {side} its limit of {limit}",
                to.trim_end_matches(".0")
            );
            assert!(error.to_string().contains(&words), "{error}");
            assert!(!error.to_string().contains("NOT BE CONFIRMED"), "{error}");
            // The value is in the record before the end.
            let (cycle, last) = values(&ran).pop().unwrap();
            assert_eq!(cycle, None);
            assert!((last[0].1 - to.parse::<f64>().unwrap()).abs() < 1e-9);
            let Some(Record::Stop { status, .. }) = ran.records().pop() else { panic!("no stop") };
            assert_eq!(status, "failed");
        }
    }
}

#[test]
fn a_required_monitor_that_cannot_be_read_ends_the_campaign_and_another_does_not() {
    let broken = "[{ kind = \"not-a-number\", value = \"fuel_temperature_k\", from_s = 300.0 }]";
    let ran = monitored().with("rig.process.faults", broken).run();
    assert_eq!(ran.error().code(), 1);
    assert!(ran.error().to_string().contains("fuel_temperature_k"), "{}", ran.error());

    let silent = "[{ kind = \"silent\", from_s = 300.0 }]";
    let ran = monitored().with("rig.process.line_faults", silent).run().done();
    let telemetry = std::fs::read_to_string(ran.path.join("telemetry.csv")).unwrap();
    assert!(telemetry.lines().last().unwrap().ends_with(",,,"), "missing values are empty fields");
    assert_eq!(values(&ran).last().unwrap().1.len(), 2);
    assert_replays(&ran.path);
    let ran = monitored()
        .with("rig.process.line_faults", silent)
        .with("monitor", &MONITORS.replace('\n', " ").replace("required = false", "required = true"))
        .run();
    assert_eq!(ran.error().code(), 3, "{}", ran.error());
}

/// Late, garbled, missing and doubled answers, and a plug that is pulled: every value that is written is right.
#[test]
fn a_bad_line_gives_no_wrong_value() {
    for fault in [
        "{ kind = \"late\", every = 31, delay_s = 1.4 }",
        "{ kind = \"garbled\", every = 11 }",
        "{ kind = \"missing\", every = 13 }",
        "{ kind = \"doubled\", every = 7 }",
        "{ kind = \"unplugged\", at_s = 300.0, for_s = 4.0 }",
    ] {
        let ran = monitored().with("rig.process.line_faults", &format!("[{fault}]")).run().done();
        let telemetry = std::fs::read_to_string(ran.path.join("telemetry.csv")).unwrap();
        let mut read = 0;
        for line in telemetry.lines().skip(1) {
            let fields: Vec<&str> = line.split(',').collect();
            for (field, expected) in fields[9..].iter().zip([4e5, 524.0, 2e7]) {
                if !field.is_empty() {
                    // The sender's seven digits.
                    assert!((field.parse::<f64>().unwrap() / expected - 1.0).abs() < 1e-6, "{fault}: {line}");
                    read += 1;
                }
            }
        }
        assert!(read > 1000, "{fault}: {read} values");
    }
}

fn quickstart_with(monitors: &str) -> Result<Config, String> {
    let text = format!("{}\n{monitors}", include_str!("../configs/quickstart.toml"));
    Config::parse("x.toml", &text).map_err(|error| error.to_string())
}

const GOOD: &str = r#"
[[monitor]]
name = "loggers"
driver = "csv_tail"
address = "file:/var/log/rig.csv"
stale_s = 20.0
[[monitor.value]]
name = "wall_temperature_k"
column = "T_wall"
offset = 273.15

[[monitor]]
name = "plc"
driver = "modbus_registers"
address = "serial:/dev/ttyUSB3"
baud = 9600
unit = 5
[[monitor.value]]
name = "rail_pressure_pa"
register = 40
type = "f32"
word_order = "low-first"
scale = 1e5
[[monitor.value]]
name = "gas_temperature_k"
register = 7
function = 4
type = "i16"
scale = 0.1
offset = 273.15
low = 300.0
high = 600.0

[[monitor]]
name = "gauge"
driver = "ascii_query"
address = "tcp:192.168.0.7:4001"
ending = "\r"
[[monitor.value]]
name = "chamber_pressure_pa"
query = "PR1"
field = 1
scale = 100.0
"#;

#[test]
fn every_kind_of_monitor_is_read_from_a_file() {
    let config = quickstart_with(GOOD).unwrap();
    assert_eq!(config.monitors.len(), 3);
    assert!(config.monitors.iter().all(|monitor| monitor.required));
}

/// Mistakes are told with the line of the very table and value.
#[test]
fn mistakes_are_named_with_their_line() {
    for (from, to, key) in [
        ("driver = \"csv_tail\"", "driver = \"csv\"", "monitor[0].driver"),
        ("address = \"file:/var/log/rig.csv\"", "address = \"/var/log/rig.csv\"", "monitor[0].address"),
        ("stale_s = 20.0", "stale_s = -1.0", "monitor[0].stale_s"),
        ("unit = 5", "unit = 250", "monitor[1].unit"),
        ("name = \"plc\"", "name = \"loggers\"", "monitor[1].name"),
        ("name = \"plc\"", "name = \"a,b\"", "monitor[1].name"),
        ("name = \"rail_pressure_pa\"", "name = \"rail_pressure\"", "monitor[1].value[0].name"),
        ("register = 40", "register = 65535", "monitor[1].value[0].register"),
        ("function = 4", "function = 6", "monitor[1].value[1].function"),
        ("low = 300.0", "low = 700.0", "monitor[1].value[1].low"),
        ("scale = 0.1", "scale = 0.0", "monitor[1].value[1].scale"),
        ("function = 4", "column = \"T\"", "monitor[1].value[1].column"),
        ("ending = \"\\r\"", "ending = \";\"", "monitor[2].ending"),
        ("query = \"PR1\"", "query = \"\"", "monitor[2].value[0].query"),
    ] {
        assert!(GOOD.contains(from), "{from}");
        let text = GOOD.replacen(from, to, 1);
        let message = quickstart_with(&text).expect_err(to);
        let whole = format!("{}\n{text}", include_str!("../configs/quickstart.toml"));
        let line = whole.lines().collect::<Vec<_>>().iter().rposition(|line| *line == to).unwrap() + 1;
        assert!(message.starts_with(&format!("x.toml:{line}:1: `{key}`")), "{to}: {message}");
    }
    for (gone, words) in [
        ("stale_s = 20.0\n", "`monitor[0].stale_s`: driver = \"csv_tail\" needs it"),
        ("register = 7\n", "`monitor[1].value[1].register`: driver = \"modbus_registers\" needs it"),
        ("name = \"gauge\"\n", "missing field `name`"),
    ] {
        let message = quickstart_with(&GOOD.replacen(gone, "", 1)).expect_err(gone);
        assert!(message.contains(words), "{message}");
    }
    let sim = "[[monitor]]\nname = \"s\"\ndriver = \"sim\"\naddress = \"sim\"\nvalue = [{ name = \"fuel_temperature_k\" }]\n";
    let message = quickstart_with(sim).expect_err("the quickstart has no such sensor");
    assert!(
        message.contains("`monitor[0].value[0].name`") && message.contains("wall_temperature_k"),
        "{message}"
    );
    assert!(message.starts_with("x.toml:"), "{message}");
}
