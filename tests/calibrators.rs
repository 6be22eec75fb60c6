//! Every calibrator that can be named, in whole campaigns on the simulated rig: the same map from each, and what becomes of
//! a campaign when line or plate misbehave.
//!
//! Runs through the same door as the command: the campaign file chooses the driver. What a plate did is read from
//! telemetry, journal and result; that nothing heats after the end is shown on bare instruments in `tests/fault.rs`.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, Ran, assert_replays};
use ditd::files::npz;
use ditd::journal::Record;

/// Driver, and the table of its simulated side.
const DRIVERS: [(&str, &str); 3] =
    [("fluke_418x", "rig.calibrator"), ("hart_9132", "rig.hart_9132"), ("ir_301", "rig.ir_301")];

fn small(driver: &str) -> Preset {
    Preset::small().calibrated().with("plate.driver", &format!("{driver:?}"))
}

fn with_line_fault(driver: &str, table: &str, fault: &str) -> Preset {
    small(driver).with(&format!("{table}.faults"), &format!("[{fault}]"))
}

fn with_plate_fault(driver: &str, fault: &str) -> Preset {
    small(driver).with("rig.plate.faults", &format!("[{fault}]"))
}

impl Ran {
    /// The instruments were confirmed safe, and the journal says so.
    fn assert_safe(&self) -> &Self {
        if let Err(error) = &self.ended {
            assert!(!error.to_string().contains("NOT BE CONFIRMED"), "{error}");
        }
        let records = self.records();
        let [.., Record::Done { act, .. }, Record::Stop { .. }] = &records[..] else {
            panic!("the journal ends with {:?}", records.last());
        };
        assert_eq!(act, "safe state");
        self
    }

    /// Done, with every cycle, each at a plate within its band; and again by a replay.
    fn assert_right(&self) -> &Self {
        assert!(self.ended.is_ok(), "{}", self.error());
        let summary = self.summary();
        assert_eq!(summary["cycles"]["received"], summary["cycles"]["planned"]);
        for level in summary["levels"].as_array().unwrap() {
            let (plate, set) = (level["plate_k"].as_f64().unwrap(), level["set_point_k"].as_f64().unwrap());
            assert!((plate - set).abs() < 0.6, "{level}");
        }
        assert_replays(&self.path);
        self.assert_safe()
    }

    /// Ended with this status, a message that has these words, and the safe state.
    fn assert_ends(&self, code: u8, words: &str) -> &Self {
        let error = self.error();
        assert_eq!(error.code(), code, "{error}");
        assert!(error.to_string().contains(words), "{error}");
        self.assert_safe()
    }

    /// Time of a record on the rig's clock, in s.
    fn time_s(&self, is_it: impl Fn(&Record) -> bool) -> f64 {
        let entry = self.entries().into_iter().find(|entry| is_it(&entry.record)).unwrap();
        #[expect(clippy::cast_precision_loss, reason = "hours in nanoseconds")]
        let time_s = entry.t_ns as f64 * 1e-9;
        time_s
    }
}

/// Whole campaigns, curve and map, with each calibrator. Shots and noise are the same, so that maps differ only by what
/// the displays round away: 0.05 K at most with the coarsest (0.1 K), which a straight line through four levels can carry
/// into a temperature between them twofold at most, plus the change of weights; and always by less than their own sigma.
#[test]
fn each_calibrator_gives_the_same_map() {
    let maps: Vec<_> = DRIVERS
        .iter()
        .map(|(driver, _)| {
            let ran = Preset::spray()
                .with("plate.driver", &format!("{driver:?}"))
                // The coolest set-point of a 9132 is 50 °C.
                .with("calibration.levels_k", "[333.0, 363.0, 403.0, 443.0, 483.0, 523.0, 563.0, 603.0]")
                .run()
                .done();
            ran.assert_safe();
            let arrays = npz::read(&ran.path.join("result/dit.npz")).unwrap();
            let of = |name: &str| arrays.iter().find(|(found, _)| found == name).unwrap().1.to_f64();
            let rms_k = ran.summary()["true_error"]["statistical"]["rms_k"].as_f64().unwrap();
            (of("temperature_k"), of("sigma_temperature_k"), of("emissivity"), rms_k)
        })
        .collect();
    let (base_k, base_sigma_k, emissivity, base_rms_k) = &maps[0];
    for ((driver, _), (kelvin, _, _, rms_k)) in DRIVERS.iter().zip(&maps).skip(1) {
        let seen: Vec<usize> = (0..base_k.len())
            .filter(|&i| emissivity[i] > 0.2 && base_k[i].is_finite() && kelvin[i].is_finite())
            .collect();
        assert!(seen.len() > 50, "{driver}: {} pixels", seen.len());
        #[expect(clippy::cast_precision_loss, reason = "a few hundred pixels")]
        let n = seen.len() as f64;
        let shift_k = seen.iter().map(|&i| kelvin[i] - base_k[i]).sum::<f64>() / n;
        let rms_z = (seen.iter().map(|&i| ((kelvin[i] - base_k[i]) / base_sigma_k[i]).powi(2)).sum::<f64>()
            / n)
            .sqrt();
        eprintln!(
            "{driver}: {} pixels, mean shift {shift_k:.3} K, rms z {rms_z:.3}, true rms {rms_k:.3} K ({base_rms_k:.3} K)",
            seen.len()
        );
        assert!(shift_k.abs() < 0.15, "{driver}: {shift_k} K");
        assert!(rms_z < 1.0, "{driver}: {rms_z}");
    }
}

/// Which instrument it was is in the record.
#[test]
fn the_record_names_the_calibrator() {
    for ((driver, _), model) in DRIVERS.iter().zip(["4181", "9132", "IR-301"]) {
        let ran = small(driver).run();
        ran.assert_right();
        let named = ran.records().into_iter().any(|record| {
            matches!(record, Record::Identity { instrument, identity } if instrument == "plate" && identity.model == model)
        });
        assert!(named, "{driver}");
    }
    // A Fluke tells at which emissivity its display is calibrated, and its cutouts.
    let told = small("fluke_418x").run().records().into_iter().find_map(|record| match record {
        Record::Particulars { values, .. } => Some(values),
        _ => None,
    });
    let told = told.unwrap();
    let of = |name: &str| told.iter().find(|value| value.name == name).unwrap().value;
    assert!((of("calibration_emissivity_fraction") - 0.95).abs() < 1e-9);
    assert!((of("soft_cutout_k") - 793.15).abs() < 1e-9);
}

#[test]
fn bad_replies_cost_no_level() {
    for (driver, table) in DRIVERS {
        for fault in [
            "{ kind = \"late\", every = 31, delay_s = 2.3 }",
            "{ kind = \"garbled\", every = 11 }",
            "{ kind = \"missing\", every = 13 }",
            "{ kind = \"doubled\", every = 7 }",
        ] {
            let ran = with_line_fault(driver, table, fault).run();
            assert!(ran.ended.is_ok(), "{driver} {fault}: {}", ran.error());
            ran.assert_right();
        }
    }
}

/// Pulled for some seconds while the plate heats, while it settles and between two cycles; what the unit remembers is
/// then as at delivery.
#[test]
fn a_plug_that_was_pulled_and_put_back_costs_nothing() {
    for (driver, table) in DRIVERS {
        let sound = small(driver).run();
        let settled_s = sound.time_s(|record| matches!(record, Record::Settled { level: 1, .. }));
        let cycle_s = sound.time_s(|record| matches!(record, Record::CycleAccepted { level: 1, .. }));
        for (at_s, for_s) in
            [(100.3, 4.0), (settled_s - 20.0, 6.0), (cycle_s + 5.0, 4.0), (cycle_s + 5.0, 17.0)]
        {
            let fault = format!("{{ kind = \"unplugged\", at_s = {at_s}, for_s = {for_s} }}");
            let ran = with_line_fault(driver, table, &fault).run();
            assert!(ran.ended.is_ok(), "{driver} {fault}: {}", ran.error());
            ran.assert_right();
        }
    }
}

/// It was left in °F and with a decimal comma, and is so again whenever it was unplugged.
#[test]
fn formats_are_forced_again_after_a_loss() {
    let faults = "[{ kind = \"unplugged\", at_s = 100.0, for_s = 3.0 }, { kind = \"unplugged\", at_s = 700.0, for_s = 3.0 }]";
    let left = |preset: Preset, table: &str| {
        preset.with(&format!("{table}.faults"), faults).with(&format!("{table}.fahrenheit"), "true")
    };
    left(small("fluke_418x"), "rig.calibrator")
        .with("rig.calibrator.decimal_comma", "true")
        .run()
        .assert_right();
    left(small("hart_9132"), "rig.hart_9132").with("rig.hart_9132.form", "\"bare\"").run().assert_right();
}

/// Pulled for good in the soak and in a burst: told within the time that the file allows, and not confirmed safe.
#[test]
fn a_plug_that_stays_pulled_ends_with_status_3() {
    for (driver, table) in DRIVERS {
        let cycle_s =
            small(driver).run().time_s(|record| matches!(record, Record::CycleAccepted { level: 1, .. }));
        for (at_s, reopen_s) in [(100.0, "10.0"), (cycle_s + 5.0, "10.0"), (100.0, "0.0")] {
            let fault = format!("{{ kind = \"unplugged\", at_s = {at_s}, for_s = 1e6 }}");
            let ran = with_line_fault(driver, table, &fault).with("plate.reopen_s", reopen_s).run();
            let error = ran.error();
            assert_eq!(error.code(), 3, "{driver}: {error}");
            let message = error.to_string();
            assert!(
                message.contains("plate calibrator at sim") && message.contains("the line is gone"),
                "{message}"
            );
            assert_eq!(message.contains("tried to open it again"), reopen_s == "10.0", "{message}");
            assert!(message.contains("SAFE STATE COULD NOT BE CONFIRMED"), "{message}");
            let stop_s = ran.time_s(|record| matches!(record, Record::Stop { .. }));
            // Until the next reading 16 s at most, then ten of trying; later exchanges do not wait again.
            assert!(stop_s - at_s < 30.0, "{driver}: {} s", stop_s - at_s);
        }
    }
}

/// Set at the keypad in the soak and between cycles.
#[test]
fn fahrenheit_in_the_middle_changes_no_temperature() {
    for (driver, table) in &DRIVERS[..2] {
        let cycle_s =
            small(driver).run().time_s(|record| matches!(record, Record::CycleAccepted { level: 1, .. }));
        for at_s in [150.0, cycle_s + 5.0] {
            small(driver)
                .with(&format!("{table}.fahrenheit_at_s"), &format!("{at_s:.1}"))
                .run()
                .assert_right();
        }
    }
}

#[test]
fn a_frozen_reading_is_never_settled() {
    for (driver, _) in DRIVERS {
        for from_s in ["100.0", "900.0"] {
            let ran =
                with_plate_fault(driver, &format!("{{ kind = \"frozen-reading\", from_s = {from_s} }}"))
                    .run();
            ran.assert_ends(1, "has not settled");
        }
    }
}

/// A Fluke and a Hart show no number, an IR-301 reports its sensor.
#[test]
fn a_reading_that_is_no_number_ends_clearly() {
    for ((driver, _), (code, words)) in DRIVERS.iter().zip([(1, "NaN"), (1, "NaN"), (4, "sensor error")]) {
        let ran = with_plate_fault(driver, "{ kind = \"nan-reading\", from_s = 200.0, until_s = 1e9 }").run();
        ran.assert_ends(code, words);
    }
}

#[test]
fn a_tripped_cutout_ends_with_status_4() {
    for ((driver, _), words) in DRIVERS.iter().zip(["cutout", "cutout", "system error"]) {
        for at_s in ["100.0", "1000.0"] {
            with_plate_fault(driver, &format!("{{ kind = \"cutout-trips\", at_s = {at_s} }}"))
                .run()
                .assert_ends(4, words);
        }
    }
}

/// A badly tuned controller: the first touch does not count, the end of the swings does; one that swings above the
/// limit ends the campaign.
#[test]
fn overshoot_is_waited_out_or_stopped() {
    for (driver, _) in DRIVERS {
        let calm_s = small(driver).run().time_s(|record| matches!(record, Record::Settled { level: 0, .. }));
        let swings = with_plate_fault(driver, "{ kind = \"overshoots\", by_k = 8.0 }").run();
        swings.assert_right();
        let settled_s = swings.time_s(|record| matches!(record, Record::Settled { level: 0, .. }));
        // 8 K · exp(−t / 150 s) falls below the band of 0.6 K after 389 s; the calm plate's 0.4 K never leave it.
        assert!(settled_s > calm_s + 200.0, "{driver}: {settled_s} s, calm {calm_s} s");
        let ran = with_plate_fault(driver, "{ kind = \"overshoots\", by_k = 30.0 }")
            .with("plate.limit_k", "540.0")
            .with("calibration.levels_k", "[323.0, 363.0, 403.0, 443.0]")
            .run();
        ran.assert_ends(4, "above the limit");
    }
}

#[test]
fn what_somebody_does_at_the_keypad_is_told() {
    let ran = small("fluke_418x").with("rig.calibrator.output_off_at_s", "300.0").run();
    ran.assert_ends(1, "output was switched off");
    let ran = small("fluke_418x").with("rig.calibrator.soft_cutout_c", "200").run();
    ran.assert_ends(4, "soft cutout trips at 200 °C");
}

/// Not settled in time: the message says what was missing and how long it would have taken.
#[test]
fn the_reason_and_the_time_that_was_missing_reach_the_message() {
    let ran = small("fluke_418x").with("soak.timeout_s", "61.0").run();
    let message = ran.error().to_string();
    assert!(message.contains("band 373.00 ± 0.60 K, drifting +"), "{message}");
    assert!(message.contains("it would have taken about") && message.contains("min"), "{message}");
}
