//! Campaigns over real lines: pseudo-terminals and a GigE camera on loopback, real drivers, real time, and faults on the way.
//!
//! Every campaign must end in a map that agrees with the one of the same rig inside the program, or in a clear error with the
//! rig in its safe state: no label shifted, no accepted frame lost, nothing that hangs.

#![cfg(all(feature = "aravis", target_os = "linux"))]
#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, Ran, assert_replays};
use ditd::campaign::StopFlag;
use ditd::files::npz;
use ditd::journal::Record;
use ditd::rigs::View;
use ditd::rigs::served::{self, ServedRig};
use ditd_drivers::instrument::ShotKind;
use ditd_sim::rig::build;
use ditd_sim::rig::chamber::World;
use ditd_sim::rig::gige::GigeStats;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// A campaign that hangs must fail, not stop the gate. The longest takes some 20 s on a quiet machine.
const HANGS: Duration = Duration::from_secs(240);

/// The quickstart's rig, small and quick: 64 × 32 pixels, three levels, a plate that lives 1000 s in one.
fn quick() -> Preset {
    Preset::spray()
        .with("camera.rows", "32")
        .with("camera.columns", "64")
        .with("rig.view.rows", "32")
        .with("rig.view.columns", "64")
        .with("campaign.levels_k", "[403.0, 463.0, 533.0]")
        .with("campaign.cycles", "3")
        .with("campaign.blanks", "2")
        .with("campaign.warm_up", "1")
        .with("campaign.frame_period_s", "0.04")
        .with("campaign.pause_s", "0.2")
        .with("campaign.pace", "\"real\"")
        .with("soak.band_k", "1.0")
        .with("soak.hold_s", "0.3")
        .with("soak.slope_limit_k_per_min", "600.0")
        .with("soak.poll_s", "0.05")
        .with("soak.timeout_s", "60.0")
        .with("trigger.injection_interval_limit_s", "0.3")
        .with("rig.chamber.residual.decay_s", "0.02")
        .with("rig.plate.time_factor", "1000.0")
        // Both rigs see the same world, however well it is rendered.
        .with("rig.target_error", "5e-2")
}

/// Claims that are tried at the same time: each waits for lines and plates nearly all of it.
fn at_once(claims: &[(&str, fn())]) {
    std::thread::scope(|scope| {
        let tried: Vec<_> = claims
            .iter()
            .map(|(name, claim)| {
                let thread = std::thread::Builder::new().name((*name).to_owned());
                (name, thread.spawn_scoped(scope, claim).unwrap())
            })
            .collect();
        let failed: Vec<_> =
            tried.into_iter().filter_map(|(name, thread)| thread.join().is_err().then_some(name)).collect();
        assert!(failed.is_empty(), "{failed:?}");
    });
}

/// The names of functions and themselves.
macro_rules! claims {
    ($($claim:path),+ $(,)?) => { &[$((stringify!($claim), $claim as fn())),+] };
}

#[test]
fn sockets_and_makes() {
    at_once(claims![
        a_packet_socket_gives_the_map_of_the_rig_inside,
        an_ordinary_socket_gives_the_map_of_the_rig_inside,
        a_flir_differs_and_its_counts_do_not,
        a_telops_differs_and_its_counts_do_not,
    ]);
}

#[test]
fn packets_and_answers() {
    at_once(claims![
        lost_packets_are_asked_for_again,
        frames_with_lost_packets_are_taken_again,
        control_answers_that_are_lost_or_late_harm_nothing,
        packets_in_disorder_twice_or_cut_harm_nothing,
    ]);
}

#[test]
fn cameras_and_lines_that_go() {
    at_once(claims![
        a_camera_that_restarts_is_found_again,
        a_camera_that_does_not_come_back_ends_the_campaign_safely,
        a_camera_that_another_program_has_is_named,
        a_stalled_stream_is_waited_for_and_its_cycles_taken_again,
        a_plates_line_that_is_pulled_is_named_and_the_rest_is_made_safe,
        a_trigger_units_line_that_is_pulled_is_named_and_the_rest_is_made_safe,
    ]);
}

/// The folder of a calibration of this rig, taken once inside the program.
fn calibration() -> &'static Path {
    static FOLDER: OnceLock<(tempfile::TempDir, std::path::PathBuf)> = OnceLock::new();
    let (_, path) = FOLDER.get_or_init(|| {
        let dir = common::folder();
        let path = dir.path().join("standard");
        let (source, config) = quick().with("campaign.pace", "\"max\"").parsed();
        ditd::session::calibrate(&common::setting(&source, &config, StopFlag::default()), &path).unwrap();
        (dir, path)
    });
    path
}

fn world() -> Arc<World> {
    static WORLD: OnceLock<Arc<World>> = OnceLock::new();
    Arc::clone(WORLD.get_or_init(|| {
        let (_, config) = quick().parsed();
        let rig = config.rig.unwrap();
        Arc::new(build::world(&rig, View::Chamber, config.campaign.seed, Path::new(""), &|_, _| {}).unwrap())
    }))
}

fn calibrated(preset: Preset) -> Preset {
    preset.with("optics.calibration", &format!("{:?}", calibration().display().to_string()))
}

/// The map of the same campaign inside the program.
fn inside() -> &'static Ran {
    static RAN: OnceLock<Ran> = OnceLock::new();
    RAN.get_or_init(|| calibrated(quick().with("campaign.pace", "\"max\"")).run().done())
}

/// A campaign over lines of its own, with the camera at 127.0.0.`host`.
struct Wired {
    ran: Ran,
    stats: GigeStats,
}

fn over_wires(host: u8, change: impl FnOnce(Preset) -> Preset) -> Wired {
    over_wires_then(host, change, |_| {})
}

/// The same; `meanwhile` is called with the rig while the campaign runs.
fn over_wires_then(
    host: u8,
    change: impl FnOnce(Preset) -> Preset,
    meanwhile: impl FnOnce(&ServedRig) + Send,
) -> Wired {
    let lines = common::folder();
    let at = |name: &str| format!("\"serial:{}\"", lines.path().join(name).display());
    let preset = change(
        calibrated(quick())
            .with("plate.address", &at("plate"))
            .with("trigger.address", &at("trigger"))
            .with("camera.driver", "\"gige\"")
            .with("camera.address", &format!("\"127.0.0.{host}\"")),
    );
    let (_, config) = preset.parsed();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let served =
        runtime.block_on(served::serve(&config, world(), |_| {})).unwrap_or_else(|error| panic!("{error}"));
    let (sender, finished) = std::sync::mpsc::channel();
    let ran = std::thread::scope(|scope| {
        scope.spawn(|| meanwhile(&served));
        let campaign = std::thread::spawn(move || {
            let ran = preset.run();
            let _ = sender.send(());
            ran
        });
        finished.recv_timeout(HANGS).expect("the campaign hangs");
        campaign.join().unwrap()
    });
    let stats = served.camera_stats().unwrap();
    drop(served);
    drop(runtime);
    Wired { ran, stats }
}

/// Mean of squares of the differences of two maps of temperature in their standard deviations, over the pixels that both
/// resolve, and their number.
fn disagreement(a: &Path, b: &Path) -> (f64, usize) {
    let plane = |run: &Path, name: &str| {
        let arrays = npz::read(&run.join("result/dit.npz")).unwrap();
        arrays.into_iter().find(|(known, _)| known == name).unwrap().1.to_f64()
    };
    let (ta, tb) = (plane(a, "temperature_k"), plane(b, "temperature_k"));
    let (sa, sb) = (plane(a, "sigma_temperature_k"), plane(b, "sigma_temperature_k"));
    let (ea, eb) = (plane(a, "emissivity"), plane(b, "emissivity"));
    let mut squares = Vec::new();
    for i in 0..ta.len() {
        let variance = sa[i] * sa[i] + sb[i] * sb[i];
        let square = (ta[i] - tb[i]).powi(2) / variance;
        if square.is_finite() && ea[i] > 0.2 && eb[i] > 0.2 {
            squares.push(square);
        }
    }
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64, squares.len())
}

/// The run is complete, its labels are right, it replays, and its map is that of the rig inside the program.
fn assert_right(wired: &Wired) {
    if let Err(error) = &wired.ran.ended {
        let told: Vec<String> = wired
            .ran
            .entries()
            .into_iter()
            .filter(|entry| !matches!(entry.record, Record::Start { .. }))
            .map(|entry| format!("{:.3} s {:?}", entry.t_ns as f64 * 1e-9, entry.record))
            .collect();
        panic!("{error}\n{:?}\n{}", wired.stats, told.join("\n"));
    }
    let summary = wired.ran.summary();
    assert_eq!(summary["cycles"]["received"], summary["cycles"]["planned"], "{summary}");
    assert_eq!(summary["cycles"]["lost"], 0);
    let (disagreement, pixels) = disagreement(&inside().path, &wired.ran.path);
    assert!(pixels > 100, "{pixels} pixels");
    // Shots of one run are common to all pixels, and six degrees of freedom each: the mean of squares is near 1 and
    // hardly above 2; a spray frame taken for a blank makes it hundreds.
    assert!(disagreement < 4.0, "{disagreement} over {pixels} pixels");
    assert_replays(&wired.ran.path);
}

/// The run ended in an error, in the safe state; every cycle that counts has its frames.
fn assert_safe(wired: &Wired) -> String {
    let words = wired.ran.error().to_string();
    let records = wired.ran.records();
    assert!(matches!(records.last(), Some(Record::Stop { .. })), "{:?}", records.last());
    words
}

fn retaken(wired: &Wired) -> u64 {
    wired.ran.summary()["cycles"]["retaken"].as_u64().unwrap()
}

fn transport(wired: &Wired, name: &str) -> u64 {
    let records = wired.ran.records();
    let counters = records.iter().filter_map(|record| match record {
        Record::Transport { counters, .. } => counters.get(name),
        _ => None,
    });
    counters.sum()
}

fn a_packet_socket_gives_the_map_of_the_rig_inside() {
    assert_socket(41, "true");
}

fn an_ordinary_socket_gives_the_map_of_the_rig_inside() {
    assert_socket(42, "false");
}

fn assert_socket(host: u8, packet_socket: &str) {
    let wired = over_wires(host, |preset| {
        preset.with("camera.gige.packet_socket", packet_socket).with("camera.gige.offset_correction", "true")
    });
    assert_right(&wired);
    assert_eq!(wired.stats.corrections, 3, "one before each level, none inside");
    assert_eq!(wired.stats.spoilings, 0);
    let frames = wired.ran.records().iter().filter(|record| matches!(record, Record::Frame { .. })).count();
    // Blanks and sprays; discarded frames are not recorded.
    assert!(frames >= 3 * 3 * 3, "{frames}");
}

/// The trigger's names of a FLIR are not public: those of the simulated one are given as a user would.
fn a_flir_differs_and_its_counts_do_not() {
    let settings = r#"{ preset = "flir", trigger_source = "External", features = { trigger-source = "SyncSource", trigger-activation = "SyncEdge" } }"#;
    assert_make(43, "\"flir\"", settings);
}

fn a_telops_differs_and_its_counts_do_not() {
    assert_make(44, "\"telops\"", r#"{ preset = "telops" }"#);
}

fn assert_make(host: u8, make: &str, settings: &str) {
    let wired = over_wires(host, |preset| preset.with("camera.gige", settings).with("rig.gige.preset", make));
    assert_right(&wired);
    assert_eq!(wired.stats.spoilings, 0, "the factory gain was overwritten");
}

fn lost_packets_are_asked_for_again() {
    let wired = over_wires(45, |preset| {
        preset
            .with("rig.gige.fault", "[{ kind = \"packet-loss\", probability = 0.05 }]")
            .with("camera.gige.packet_size", "576")
            .with("campaign.retakes_max", "20")
    });
    assert_right(&wired);
    assert!(wired.stats.packets_resent > 0, "{:?}", wired.stats);
    assert!(transport(&wired, "n_resent_packets") > 0);
}

/// Without resends every loss costs its cycle, and only its cycle.
fn frames_with_lost_packets_are_taken_again() {
    let wired = over_wires(46, |preset| {
        preset
            .with("rig.gige.fault", "[{ kind = \"packet-loss\", probability = 0.02 }]")
            .with("camera.gige.packet_size", "576")
            .with("camera.gige.resend", "false")
            .with("campaign.retakes_max", "40")
    });
    assert_right(&wired);
    assert!(wired.stats.packets_dropped > 0);
    assert!(retaken(&wired) > 0);
}

/// Answers of the camera's control channel that are lost or late: asked again, and never taken for other ones.
fn control_answers_that_are_lost_or_late_harm_nothing() {
    let wired = over_wires(59, |preset| {
        preset.with(
            "rig.gige.fault",
            "[{ kind = \"answer-lost\", every = 17 }, { kind = \"answer-late\", every = 13, delay_s = 0.6 }]",
        )
    });
    assert_right(&wired);
    assert!(wired.stats.answers_lost > 0 && wired.stats.answers_late > 0, "{:?}", wired.stats);
}

fn packets_in_disorder_twice_or_cut_harm_nothing() {
    let wired = over_wires(47, |preset| {
        preset
            .with(
                "rig.gige.fault",
                "[{ kind = \"reordered\", probability = 0.1 }, { kind = \"duplicated\", probability = 0.1 }, \
                 { kind = \"truncated\", probability = 0.02 }]",
            )
            .with("camera.gige.packet_size", "576")
            .with("campaign.retakes_max", "40")
    });
    assert_right(&wired);
    assert!(wired.stats.packets_swapped > 0 && wired.stats.packets_doubled > 0, "{:?}", wired.stats);
}

/// A frame number that jumps, ids that wrap, a clock that steps: each is seen, and the cycle taken again where it must be.
#[test]
fn jumps_of_numbers_and_clocks_shift_no_label() {
    let faults = [
        (48, "{ kind = \"id-jump\", frame = 9, by = 3 }"),
        (49, "{ kind = \"id-start\", id = 65531 }"),
        (50, "{ kind = \"timestamp-step\", frame = 10, step_ns = 70000000 }"),
        (51, "{ kind = \"lose-frame\", frame = 7 }"),
        (52, "{ kind = \"lose-leader\", frame = 7 }"),
    ];
    // They wait most of their time.
    std::thread::scope(|scope| {
        for (host, fault) in faults {
            scope.spawn(move || {
                let wired = over_wires(host, |preset| {
                    preset.with("rig.gige.fault", &format!("[{fault}]")).with("campaign.retakes_max", "10")
                });
                assert_right(&wired);
                assert!(fault.contains("id-start") || retaken(&wired) > 0, "{fault}");
                let sprays = wired.ran.records().into_iter().filter(|record| {
                    matches!(record, Record::Frame { shot: ShotKind::Spray, position, .. } if *position != 3)
                });
                assert_eq!(sprays.count(), 0, "{fault}");
            });
        }
    });
}

/// The camera restarts in the middle of a level: all its registers are lost, and so is our control of it.
fn a_camera_that_restarts_is_found_again() {
    let wired = over_wires(53, |preset| {
        preset
            .with("rig.gige.fault", "[{ kind = \"restart\", frame = 14, silent_s = 3.0 }]")
            .with("campaign.retakes_max", "20")
    });
    assert_right(&wired);
    assert_eq!(wired.stats.restarts, 1);
    let looked = wired.ran.records().into_iter().any(
        |record| matches!(record, Record::Done { act, .. } if act.starts_with("look for the camera again")),
    );
    assert!(looked);
}

fn a_camera_that_does_not_come_back_ends_the_campaign_safely() {
    let wired = over_wires(54, |preset| {
        preset
            .with("rig.gige.fault", "[{ kind = \"restart\", frame = 5, silent_s = 100.0 }]")
            .with("camera.gige.reconnect_s", "0.0")
    });
    let words = assert_safe(&wired);
    assert!(words.contains("camera at 127.0.0.54"), "{words}");
    assert!(!words.contains("THE SAFE STATE COULD NOT BE CONFIRMED"), "{words}");
}

fn a_camera_that_another_program_has_is_named() {
    let wired = over_wires(55, |preset| preset.with("rig.gige.fault", "[{ kind = \"access-denied\" }]"));
    let words = assert_safe_or_unopened(&wired);
    assert!(words.contains("camera at 127.0.0.55"), "{words}");
}

/// Trouble at the very beginning may come before there is a journal.
fn assert_safe_or_unopened(wired: &Wired) -> String {
    wired.ran.error().to_string()
}

fn a_stalled_stream_is_waited_for_and_its_cycles_taken_again() {
    let wired = over_wires(56, |preset| {
        preset
            .with("rig.gige.fault", "[{ kind = \"stall\", frame = 8, duration_s = 1.0 }]")
            .with("campaign.retakes_max", "20")
    });
    assert_right(&wired);
    assert!(retaken(&wired) > 0);
}

fn a_plates_line_that_is_pulled_is_named_and_the_rest_is_made_safe() {
    assert_pulled(57, "plate", "plate calibrator at", "trigger unit at");
}

fn a_trigger_units_line_that_is_pulled_is_named_and_the_rest_is_made_safe() {
    assert_pulled(58, "trigger", "trigger unit at", "plate calibrator at");
}

/// A line that is pulled out while the campaign is under way: an error that names it, and everything else safe.
fn assert_pulled(host: u8, instrument: &str, words: &str, other: &str) {
    let (never, wait) = std::sync::mpsc::channel::<()>();
    let wired = over_wires_then(
        host,
        |preset| preset.with("campaign.cycles", "100"),
        move |served| {
            // Some cycles into the first level.
            let _ = wait.recv_timeout(Duration::from_secs(5));
            served.unplug(instrument);
            drop(never);
        },
    );
    let error = assert_safe(&wired);
    assert!(error.contains(words), "{error}");
    assert!(error.contains("THE SAFE STATE COULD NOT BE CONFIRMED"), "{error}");
    assert_eq!(wired.ran.error().code(), 3, "{error}");
    assert!(!error.contains(other), "the {other} it could be reached: {error}");
}
