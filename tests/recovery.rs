//! What is lost when a campaign is paused, stopped, or killed at any record: the cycle under way, and nothing else.
//!
//! A kill is played by cutting the journal of a finished run; raw frames stay, so that their blocks are longer than
//! the journal knows, as a real kill leaves them. A wish is played by a flag that is raised before the session begins,
//! or by the display when it is told of the n-th cycle.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, Ran, assert_replays, copy, folder};
use ditd::campaign::{Ended, Engine, Origins, Progress, Recorder, StopFlag, header};
use ditd::clock::Clock;
use ditd::journal::{self, Record};
use ditd::plan::Plan;
use ditd::reduce::Reduced;
use ditd::rigs::{self, View};
use ditd::run_folder::sha256;
use ditd::session::{self, SessionError};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::OnceLock;

fn preset() -> Preset {
    Preset::small().calibrated()
}

fn finished() -> &'static Ran {
    static RAN: OnceLock<Ran> = OnceLock::new();
    RAN.get_or_init(|| preset().run().done())
}

fn records(run: &Path) -> Vec<Record> {
    journal::read(&run.join("journal.jsonl")).unwrap().into_iter().map(|entry| entry.record).collect()
}

fn resume(run: &Path) -> Result<String, Box<SessionError>> {
    session::resume(run, Clock::start(), StopFlag::default()).map_err(Box::new)
}

fn accepted(records: &[Record]) -> Vec<(u32, u32)> {
    records
        .iter()
        .filter_map(|record| match record {
            Record::CycleAccepted { level, cycle, .. } => Some((*level, *cycle)),
            _ => None,
        })
        .collect()
}

/// All nine cycles, none twice, the safe state last, and a replay that writes the same bytes.
fn assert_whole(run: &Path) {
    let records = records(run);
    let cycles = accepted(&records);
    assert_eq!(cycles.len(), 9);
    assert_eq!(cycles.iter().collect::<BTreeSet<_>>().len(), 9, "a cycle was accepted twice: {cycles:?}");
    let [.., Record::Done { act, .. }, Record::Stop { status, cycles, .. }] = &records[..] else {
        panic!("the journal ends with {:?}", records.last());
    };
    assert_eq!((act.as_str(), status.as_str()), ("safe state", "done"));
    assert_eq!((cycles.planned, cycles.accepted, cycles.lost), (9, 9, 0));
    let summary = std::fs::read(run.join("result/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_slice(&summary).unwrap();
    assert_eq!(summary["cycles"]["received"], 9);
    assert_replays(run);
}

/// A copy of the finished run whose journal has its first `bytes` bytes only, and no result.
fn killed(bytes: usize) -> (tempfile::TempDir, std::path::PathBuf) {
    let dir = folder();
    let run = dir.path().join("run");
    copy(&finished().path, &run);
    std::fs::remove_dir_all(run.join("result")).unwrap();
    let path = run.join("journal.jsonl");
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..bytes]).unwrap();
    (dir, run)
}

/// Length of the journal's first lines.
fn ends() -> Vec<usize> {
    let bytes = std::fs::read(finished().path.join("journal.jsonl")).unwrap();
    (0..bytes.len()).filter(|&i| bytes[i] == b'\n').map(|i| i + 1).collect()
}

#[test]
fn a_run_that_was_killed_after_any_record_is_completed() {
    let ends = ends();
    for lines in 1..=ends.len() {
        let (_dir, run) = killed(ends[lines - 1]);
        let before = accepted(&records(&run));
        resume(&run).unwrap_or_else(|error| panic!("killed after record {lines}: {error}"));
        assert_whole(&run);
        assert!(accepted(&records(&run)).starts_with(&before), "record {lines}: an accepted cycle was lost");
    }
}

#[test]
fn a_torn_last_line_costs_that_line_only() {
    let ends = ends();
    for (line, torn) in [(5, 1), (20, 40), (ends.len() / 2, 100), (ends.len() - 1, 10)] {
        let (_dir, run) = killed(ends[line - 1] + torn);
        resume(&run).unwrap_or_else(|error| panic!("killed in line {}: {error}", line + 1));
        assert_whole(&run);
    }
}

#[test]
fn frames_of_the_kill_stay_in_their_blocks_and_shift_nothing() {
    let ends = ends();
    let lines =
        finished().records().iter().position(|record| matches!(record, Record::Frame { .. })).unwrap() + 1;
    let (_dir, run) = killed(ends[lines - 1]);
    let header = 128;
    let frames =
        |run: &Path| (std::fs::read(run.join("frames/level01_blank.npy")).unwrap().len() - header) / (2 * 48);
    assert_eq!(frames(&run), 6);
    resume(&run).unwrap();
    assert_eq!(frames(&run), 12);
    assert_whole(&run);
}

#[test]
fn killed_again_and_again_it_still_ends_whole() {
    let (_dir, run) = killed(ends()[8]);
    for _ in 0..6 {
        resume(&run).unwrap();
        let path = run.join("journal.jsonl");
        let bytes = std::fs::read(&path).unwrap();
        let last: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i] == b'\n').map(|i| i + 1).collect();
        // All but the last 25 records of each session survive.
        std::fs::write(&path, &bytes[..last[last.len() - 25] - 7]).unwrap();
    }
    resume(&run).unwrap();
    assert_whole(&run);
}

#[test]
fn a_run_without_a_beginning_is_refused_with_status_5() {
    let (_dir, run) = killed(0);
    let error = resume(&run).unwrap_err();
    assert_eq!(error.code(), 5, "{error}");
}

#[test]
fn a_finished_run_that_is_resumed_stays_as_it_is() {
    let dir = folder();
    let run = dir.path().join("run");
    copy(&finished().path, &run);
    let before = std::fs::read(run.join("result/dit.npz")).unwrap();
    resume(&run).unwrap();
    assert_whole(&run);
    assert_eq!(before, std::fs::read(run.join("result/dit.npz")).unwrap());
}

#[test]
fn a_resumed_run_begins_with_a_running_clock() {
    let (_dir, run) = killed(ends()[30]);
    resume(&run).unwrap();
    let entries = journal::read(&run.join("journal.jsonl")).unwrap();
    assert!(entries.windows(2).all(|pair| pair[0].t_ns <= pair[1].t_ns), "journal time went back");
}

#[test]
fn one_wish_pauses_with_status_6_and_a_resumed_run_completes() {
    let stop = StopFlag::default();
    stop.escalate();
    let ran = preset().run_with(stop);
    let SessionError::Paused(folder) = ran.error() else { panic!("{}", ran.error()) };
    assert_eq!((folder, ran.error().code()), (&ran.path, 6));
    let Some(Record::Stop { status, .. }) = ran.records().pop() else { panic!("no stop at the end") };
    assert_eq!(status, "paused");
    resume(&ran.path).unwrap();
    assert_whole(&ran.path);
}

#[test]
fn a_window_of_the_users_own_goes_along_with_the_run_and_is_found_when_it_resumes() {
    let home = folder();
    std::fs::create_dir(home.path().join("mine")).unwrap();
    let table = "wavelength_um,n\n2.5,1.42\n6,1.39\n";
    std::fs::write(home.path().join("mine/glass.csv"), table).unwrap();
    let glass = "{ material = \"mine/glass.csv\", thickness_m = 0.01, temperature_k = 450.0 }";
    let preset = preset().with("rig.window.near", glass).with("rig.window.far", glass);
    let (mut source, config) = preset.parsed();
    source.folder = home.path().to_owned();
    let run = home.path().join("run");
    let stop = StopFlag::default();
    stop.escalate();
    let paused = session::run(&common::setting(&source, &config, stop), &run).unwrap_err();
    assert_eq!(paused.code(), 6, "{paused}");
    std::fs::remove_dir_all(home.path().join("mine")).unwrap();
    assert_eq!(std::fs::read_to_string(run.join("mine/glass.csv")).unwrap(), table);
    resume(&run).unwrap();
    assert_whole(&run);
    // Without the file nothing begins, and no folder is left.
    let other = home.path().join("other");
    let refused = session::run(&common::setting(&source, &config, StopFlag::default()), &other).unwrap_err();
    assert!(refused.code() == 2 && refused.to_string().contains("glass.csv"), "{refused}");
    assert!(!other.exists());
}

#[test]
fn two_wishes_stop_with_status_130_and_a_resumed_run_completes() {
    let stop = StopFlag::default();
    stop.escalate();
    stop.escalate();
    let ran = preset().run_with(stop);
    assert_eq!(ran.error().code(), 130, "{}", ran.error());
    let Some(Record::Stop { status, .. }) = ran.records().pop() else { panic!("no stop at the end") };
    assert_eq!(status, "aborted");
    resume(&ran.path).unwrap();
    assert_whole(&ran.path);
}

/// Raises the flag `times` times when it is told of cycle `at`.
struct Operator {
    stop: StopFlag,
    at: u32,
    times: u32,
}

impl Progress for Operator {
    fn cycle(&mut self, done: u32, _planned: u32, _eta_s: f64) {
        if done == self.at {
            (0..self.times).for_each(|_| self.stop.escalate());
        }
    }

    fn waiting(&mut self, _reason: &str, _eta_s: Option<f64>) {}

    fn note(&mut self, _text: &str) {}
}

/// A run folder in which the operator raised the flag after cycle `at`.
fn wished(at: u32, times: u32) -> (tempfile::TempDir, Ended) {
    let dir = folder();
    let (source, config) = preset().parsed();
    std::fs::write(dir.path().join("campaign.toml"), &source.text).unwrap();
    copy(Path::new(&config.optics.calibration), &dir.path().join("calibration"));
    let plan = Plan::of_map(&config);
    let c = &config.camera;
    let reduced = Reduced::new(plan.clone(), c.rows, c.columns, c.saturation_count).unwrap();
    let prepared = rigs::prepare(&config, View::Chamber, Path::new(""), &|_, _| {}).unwrap();
    let mut recorder = Recorder::create(dir.path(), reduced, c.rows, c.columns).unwrap();
    let stop = StopFlag::default();
    let ended = prepared.runtime().unwrap().block_on(async {
        let mut opened = prepared.open().await.unwrap();
        let engine = Engine {
            config: &config,
            plan: &plan,
            instruments: &mut opened.instruments,
            recorder: &mut recorder,
            progress: &mut Operator { stop: stop.clone(), at, times },
            stop,
            started: tokio::time::Instant::now(),
            elapsed_before_ns: 0,
            last_injection: None,
            origins: Origins::default(),
        };
        let first = header(&plan, config.campaign.epoch.clone(), sha256(source.text.as_bytes()));
        Box::pin(engine.run(Some(first))).await.ended.unwrap()
    });
    (dir, ended)
}

#[test]
fn a_wish_in_the_middle_ends_after_the_cycle_and_nothing_is_taken_twice() {
    for at in [1, 3, 5, 8] {
        for (times, due) in [(1, Ended::Paused), (2, Ended::Stopped)] {
            let (dir, ended) = wished(at, times);
            assert_eq!(ended, due);
            let before = accepted(&records(dir.path()));
            assert_eq!(before.len(), at as usize);
            resume(dir.path()).unwrap();
            assert_whole(dir.path());
            assert!(accepted(&records(dir.path())).starts_with(&before));
        }
    }
}

/// A calibration is taken in one go: what an unfinished one recorded is kept aside, and it is taken anew.
#[test]
fn a_pause_during_the_calibration_is_taken_up_by_calibrating_anew() {
    let stop = StopFlag::default();
    stop.escalate();
    let ran = Preset::small().run_with(stop);
    assert_eq!(ran.error().code(), 6);
    assert!(ran.error().to_string().contains(&ran.path.display().to_string()), "{}", ran.error());
    assert!(!ran.path.join("journal.jsonl").exists(), "the campaign had begun");
    resume(&ran.path).unwrap();
    assert_whole(&ran.path);
    assert!(ran.path.join("calibration.unfinished-1/journal.jsonl").exists(), "the record was not kept");
}
