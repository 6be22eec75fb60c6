//! Whole campaigns on the simulated rig, hours of virtual time in a second: what ends up in journal and result.
//!
//! Claims about order and labels are read from the journal and the raw frames, claims about temperatures from the
//! result and from what the simulated world knows of itself. The camera's world is rendered with rayon's global pool
//! or, when a run is started inside another pool, with that one; frames of this size are made in place, so that
//! both thread counts are really exercised. Larger frames are made in blocking jobs on the global pool, whose size
//! one process cannot change: for them the same claim rests on the tests of the rig.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, Ran, sums};
use ditd::calibrate::Calibration;
use ditd::files::npy::{self, Array};
use ditd::files::npz;
use ditd::journal::Record;
use ditd::plan::Plan;
use ditd_drivers::instrument::ShotKind;
use std::collections::HashMap;
use std::path::Path;
use std::sync::OnceLock;

/// The campaign with a spray that several tests look at.
fn spray() -> &'static Ran {
    static RAN: OnceLock<Ran> = OnceLock::new();
    RAN.get_or_init(|| Preset::spray().run().done())
}

fn arrays(path: &Path) -> HashMap<String, Array> {
    npz::read(path).unwrap().into_iter().collect()
}

/// Raw frames of a block, in the order in which they were written.
fn frames(ran: &Ran, file: &str) -> Vec<Vec<f64>> {
    let array = npy::read(&ran.path.join(file)).unwrap();
    let pixels = array.shape[1] * array.shape[2];
    array.to_f64().chunks(pixels).map(<[f64]>::to_vec).collect()
}

#[expect(clippy::cast_precision_loss, reason = "a few hundred pixels")]
fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.into_iter().collect();
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn a_campaign_ends_done_with_every_planned_cycle() {
    let ran = spray();
    let Some(Record::Stop { status, trouble, cycles }) = ran.records().pop() else {
        panic!("no stop at the end")
    };
    assert_eq!((status.as_str(), trouble), ("done", None));
    assert_eq!((cycles.planned, cycles.accepted, cycles.retaken, cycles.lost), (24, 24, 0, 0));
    let summary = ran.summary();
    assert_eq!(summary["cycles"]["received"], 24);
    for name in ["dit.exr", "dit.npz", "temperature_k.tif", "summary.json", "truth.npz"] {
        assert!(ran.path.join("result").join(name).is_file(), "{name}");
    }
}

#[test]
fn every_act_has_its_intent_and_the_plate_settles_before_every_burst() {
    let ran = spray();
    let records = ran.records();
    let mut open: Vec<&str> = Vec::new();
    let mut settled = None;
    let mut bursts = 0;
    for record in &records {
        match record {
            Record::Intent { act, .. } => open.push(act),
            Record::Done { act, .. } => {
                assert_eq!(open.pop(), Some(act.as_str()));
                if act.starts_with("set the plate") {
                    settled = None;
                }
            }
            // A cycle's intent is answered by its verdict.
            Record::CycleAccepted { cycle, .. } => {
                assert_eq!(open.pop(), Some(format!("cycle {cycle}").as_str()))
            }
            Record::Settled { level, .. } => settled = Some(*level),
            Record::Burst { level, .. } => {
                assert_eq!(settled, Some(*level), "a burst before the plate had settled");
                bursts += 1;
            }
            _ => {}
        }
    }
    assert!(open.is_empty(), "intents that were never done: {open:?}");
    assert_eq!(bursts, 4);
    let [.., Record::Intent { act: begun, .. }, Record::Done { act: done, .. }, Record::Stop { .. }] =
        &records[..]
    else {
        panic!("the journal ends with {:?}", records.last());
    };
    assert_eq!((begun.as_str(), done.as_str()), ("safe state", "safe state"));
}

/// From the telemetry, which the soak did not write for itself: every reading of the hold time lay in the band.
#[test]
fn settled_means_that_the_band_was_held() {
    let ran = spray();
    let (_, config) = Preset::spray().parsed();
    let telemetry = std::fs::read_to_string(ran.path.join("telemetry.csv")).unwrap();
    let readings: Vec<(f64, f64)> = telemetry
        .lines()
        .skip(1)
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            (fields[0].parse::<f64>().unwrap() * 1e-9, fields[2].parse().unwrap())
        })
        .collect();
    let levels = config.levels_in_order();
    let mut checked = 0;
    for entry in ran.entries() {
        let Record::Settled { level, .. } = entry.record else { continue };
        #[expect(clippy::cast_precision_loss, reason = "hours in nanoseconds")]
        let now_s = entry.t_ns as f64 * 1e-9;
        let begins_s = now_s - config.soak.hold_s + config.soak.poll_s;
        let held: Vec<f64> =
            readings.iter().filter(|(t, _)| (begins_s..=now_s).contains(t)).map(|(_, k)| *k).collect();
        // A reading is some exchanges of 20 ms and more: about 0.2 s besides the wait between two.
        assert!(held.len() > 40, "level {level}: {} readings", held.len());
        let set_k = levels[level as usize];
        assert!(held.iter().all(|k| (k - set_k).abs() <= config.soak.band_k), "level {level}: {held:?}");
        checked += 1;
    }
    assert_eq!(checked, levels.len());
}

/// The label comes from the plan, the light from the world: where the spray is thick, each frame labelled spray
/// differs from the blanks of its cycle as the world's own expectation says, and blanks do not differ.
#[test]
fn frames_show_what_their_labels_say() {
    let ran = spray();
    let truth = arrays(&ran.path.join("world/truth.npz"));
    let emissivity = truth["physical_emissivity"].to_f64();
    let thick: Vec<usize> = (0..emissivity.len()).filter(|&i| emissivity[i] > 0.5).collect();
    assert!(thick.len() > 20, "{} thick pixels", thick.len());
    let expected = truth["difference_counts"].to_f64();
    let over = |frame: &[f64]| mean(thick.iter().map(|&i| frame[i]));
    let mut seen = 0;
    for level in [0, 3] {
        let due = over(&expected[level * emissivity.len()..(level + 1) * emissivity.len()]);
        assert!(due.abs() > 20.0, "level {level}: {due} counts say nothing");
        let sprays = frames(ran, &format!("frames/level{:02}_spray.npy", level + 1));
        let blanks = frames(ran, &format!("frames/level{:02}_blank.npy", level + 1));
        assert_eq!((sprays.len(), blanks.len()), (6, 12));
        for (spray, pair) in sprays.iter().zip(blanks.chunks(2)) {
            let change = over(spray) - 0.5 * (over(&pair[0]) + over(&pair[1]));
            // Shots scatter by 15 % in optical depth and by 3 K.
            assert!(
                (0.4..1.6).contains(&(change / due)),
                "level {level}: {change} where {due} counts were due"
            );
            assert!((over(&pair[0]) - over(&pair[1])).abs() < 2.0, "blanks differ");
            seen += 1;
        }
    }
    assert_eq!(seen, 12);
}

#[test]
fn accepted_frames_follow_the_plan() {
    let ran = spray();
    let (_, config) = Preset::spray().parsed();
    let plan = Plan::of_map(&config);
    let mut cycle: Vec<(u32, ShotKind, u64)> = Vec::new();
    for record in ran.records() {
        match record {
            Record::Frame { position, shot, camera_id, .. } => cycle.push((position, shot, camera_id)),
            Record::CycleAccepted { level, .. } => {
                let program = &plan.levels[level as usize].program;
                let due: Vec<u32> = (program.warm_up..program.frames_per_cycle()).collect();
                assert_eq!(cycle.iter().map(|frame| frame.0).collect::<Vec<_>>(), due);
                assert!(cycle.iter().all(|(position, shot, _)| program.kind_at(*position) == Some(*shot)));
                assert!(cycle.windows(2).all(|pair| pair[1].2 == pair[0].2 + 1), "camera numbers jump");
                cycle.clear();
            }
            _ => {}
        }
    }
}

#[test]
fn the_calibration_is_measured_and_not_handed_over() {
    let ran = spray();
    let text = std::fs::read(ran.path.join("calibration/calibration.json")).unwrap();
    let calibration: Calibration = serde_json::from_slice(&text).unwrap();
    assert!(ran.path.join("calibration/frames/level01_shutter.npy").is_file());
    let truth = arrays(&ran.path.join("world/truth.npz"));
    let (kelvin, exact) = (truth["curve_k"].to_f64(), truth["curve_counts"].to_f64());
    let mut largest: f64 = 0.0;
    for (t, counts) in kelvin.iter().zip(&exact).filter(|(t, _)| (373.0..=563.0).contains(*t)) {
        let off = calibration.fit.curve.value(*t) / counts - 1.0;
        largest = largest.max(off.abs());
    }
    // 0.1 K of display error is 0.2 % of the counts; ripple and noise add to it, never 1.5 K.
    assert!((1e-5..0.03).contains(&largest), "the measured curve is off by {largest}");
}

#[test]
fn temperatures_come_out_within_a_few_kelvin_of_the_truth() {
    let ran = spray();
    let truth = arrays(&ran.path.join("result/truth.npz"));
    let map = arrays(&ran.path.join("result/dit.npz"));
    let (is, emissivity) =
        (truth["temperature_statistical_k"].to_f64(), truth["emissivity_statistical"].to_f64());
    let (measured, sigma) = (map["temperature_k"].to_f64(), map["sigma_temperature_k"].to_f64());
    let counted: Vec<usize> =
        (0..is.len()).filter(|&i| emissivity[i] > 0.4 && measured[i].is_finite()).collect();
    assert!(counted.len() > 30, "{} pixels", counted.len());
    let rms = mean(counted.iter().map(|&i| (measured[i] - is[i]).powi(2))).sqrt();
    let claimed = mean(counted.iter().map(|&i| sigma[i].powi(2))).sqrt();
    eprintln!("rms {rms:.2} K, claimed {claimed:.2} K over {} pixels", counted.len());
    assert!(rms < 4.0, "{rms} K");
    // Six cycles a level and correlated shots: the claim may be off by half, not by a factor of two.
    assert!((0.5..2.0).contains(&(rms / claimed)), "rms {rms} K, claimed {claimed} K");
}

/// The seam of the trigger unit: another unit, which makes its pauses in another way, leaves the same labels in the same
/// order, and the same map as far as the noise lets tell.
#[test]
fn another_trigger_unit_gives_the_same_labels_and_the_same_map() {
    let (one, other) = (spray(), Preset::spray().with("trigger.driver", "\"dg645\"").run().done());
    let labels = |ran: &Ran| -> Vec<(u32, u32, u32, ShotKind, u64)> {
        let records = ran.records().into_iter();
        records
            .filter_map(|record| match record {
                Record::Frame { level, cycle, position, shot, camera_id, .. } => {
                    Some((level, cycle, position, shot, camera_id))
                }
                _ => None,
            })
            .collect()
    };
    assert_eq!(labels(one), labels(&other));
    assert_eq!(other.summary()["cycles"]["received"], 24);
    assert_eq!(other.summary()["cycles"]["retaken"], 0);
    let model = |ran: &Ran| {
        ran.records().into_iter().find_map(|record| match record {
            Record::Identity { instrument, identity } if instrument == "trigger" => Some(identity.model),
            _ => None,
        })
    };
    assert_eq!((model(one).as_deref(), model(&other).as_deref()), (Some("9528"), Some("DG645")));
    let map = |ran: &Ran| arrays(&ran.path.join("result/dit.npz"));
    let (a, b) = (map(one), map(&other));
    for (name, sigma) in [("temperature_k", "sigma_temperature_k"), ("emissivity", "sigma_emissivity")] {
        let (left, right) = (a[name].to_f64(), b[name].to_f64());
        let (s, t) = (a[sigma].to_f64(), b[sigma].to_f64());
        let emissivity = a["emissivity"].to_f64();
        let seen: Vec<f64> = (0..left.len())
            .filter(|&i| emissivity[i] > 0.3 && left[i].is_finite() && right[i].is_finite())
            .map(|i| (left[i] - right[i]) / s[i].hypot(t[i]))
            .collect();
        assert!(seen.len() > 30, "{} pixels", seen.len());
        // Both runs draw the same shots, so that they differ by less than two independent ones would.
        let rms = mean(seen.iter().map(|z| z * z)).sqrt();
        eprintln!("{name}: the two units differ by {rms:.3} of their noise over {} pixels", seen.len());
        assert!(rms < 1.0, "{name}: {rms}");
    }
}

#[test]
fn equal_seeds_give_equal_bytes_with_one_thread_and_with_two() {
    let files = |ran: &Ran| {
        let mut files = sums(&ran.path);
        // Wall times and host, and the sums over all files, that one included.
        files.remove("machine.json");
        files.remove("manifest-sha256.txt");
        files
    };
    let first = files(spray());
    assert!(first.contains_key("journal.jsonl") && first.contains_key("calibration/journal.jsonl"));
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let again = pool.install(|| Preset::spray().run().done());
        assert_eq!(first, files(&again), "{threads} threads");
    }
}

#[test]
fn another_seed_gives_another_journal() {
    let journal = |seed: &str| {
        sums(&Preset::small().with("campaign.seed", seed).run().done().path)["journal.jsonl"].clone()
    };
    assert_ne!(journal("7"), journal("8"));
}

/// Vapour of the previous injection dims the plate for blank and spray alike: the slope, and with it the
/// emissivity, comes out too small.
#[test]
fn a_pause_that_is_too_short_biases_the_emissivity_and_a_long_one_does_not() {
    let bias_in_sigma = |pause_s: &str| {
        let ran = Preset::spray()
            .with("rig.chamber.residual", "{ optical_depth = 0.3, decay_s = 3.0 }")
            .with("trigger.injection_interval_limit_s", "1.0")
            .with("campaign.pause_s", pause_s)
            .run()
            .done();
        let truth = arrays(&ran.path.join("result/truth.npz"))["emissivity_statistical"].to_f64();
        let map = arrays(&ran.path.join("result/dit.npz"));
        let (measured, sigma) = (map["emissivity"].to_f64(), map["sigma_emissivity"].to_f64());
        let counted = (0..truth.len()).filter(|&i| truth[i] > 0.5 && measured[i].is_finite());
        mean(counted.map(|i| (measured[i] - truth[i]) / sigma[i]))
    };
    let (short, long) = (bias_in_sigma("2.0"), bias_in_sigma("40.0"));
    eprintln!("bias of the emissivity: {short:.1} sigma after 2 s, {long:.1} sigma after 40 s");
    assert!(short < -3.0, "{short} sigma after 2 s");
    assert!(long.abs() < 1.0, "{long} sigma after 40 s");
}

#[test]
fn five_hours_of_orchestration_run_completely() {
    let ran = Preset::long().run().done();
    let last = ran.entries().pop().unwrap();
    #[expect(clippy::cast_precision_loss, reason = "hours in nanoseconds")]
    let hours = last.t_ns as f64 / 3.6e12;
    assert!((4.5..5.5).contains(&hours), "{hours} h");
    let Record::Stop { status, cycles, .. } = last.record else { panic!("no stop at the end") };
    assert_eq!((status.as_str(), cycles.accepted, cycles.retaken, cycles.lost), ("done", 384, 0, 0));
}
