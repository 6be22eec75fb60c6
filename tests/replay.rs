//! A replay is the live run again, bit for bit, and whatever was changed in a run folder is found.
//!
//! One run with a spray is made and replayed; damaged ones are copies of a small run with one byte changed.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, Ran, assert_replays, copy, folder, sums};
use ditd::estimate::map::Estimator;
use ditd::journal::{JournalError, Record};
use ditd::session::{self, SessionError};
use std::path::Path;
use std::sync::OnceLock;

fn small() -> &'static Ran {
    static RAN: OnceLock<Ran> = OnceLock::new();
    RAN.get_or_init(|| Preset::small().calibrated().run().done())
}

/// Replays a copy of the small run in which `damage` was done to one file.
fn damaged(file: &str, damage: impl Fn(&mut Vec<u8>)) -> SessionError {
    let dir = folder();
    let run = dir.path().join("run");
    copy(&small().path, &run);
    let mut bytes = std::fs::read(run.join(file)).unwrap();
    damage(&mut bytes);
    std::fs::write(run.join(file), bytes).unwrap();
    session::replay(&run, &dir.path().join("out"), None).expect_err("the damage must be found")
}

#[test]
fn a_replay_equals_the_live_result_byte_for_byte() {
    assert_replays(&Preset::spray().run().done().path);
}

#[test]
fn a_replay_of_a_run_with_lost_frames_equals_it_too() {
    let faults = "[{ kind = \"lose-frame\", frame = 6 }, { kind = \"incomplete-frame\", frame = 19 }]";
    let ran = Preset::small().calibrated().with("rig.fault", faults).run().done();
    assert_eq!(ran.summary()["cycles"]["retaken"], 2);
    assert_replays(&ran.path);
}

/// A shot that did not fire (the third of the hottest level) counts as a cycle, but not in the map: it is found, named, its
/// plate reading left out, and found again by the replay.
#[test]
fn a_misfire_is_named_and_left_out_of_the_map() {
    let ran = Preset::spray().with("rig.fault", "[{ kind = \"misfire\", injection = 20 }]").run().done();
    let summary = ran.summary();
    assert_eq!(summary["cycles"]["received"], 24);
    for (level, expected) in [(0, 0), (1, 0), (2, 0), (3, 1)] {
        let misfires = summary["levels"][level]["misfires"].as_array().unwrap();
        assert_eq!(misfires.len(), expected, "level {level}: {misfires:?}");
    }
    let found = &summary["levels"][3]["misfires"][0];
    assert_eq!(found["cycle"], 2);
    assert!(found["score"].as_f64().unwrap() < 0.1, "{found}");
    assert_replays(&ran.path);
}

#[test]
fn a_replay_changes_nothing_in_the_run_folder() {
    let before = sums(&small().path);
    assert_replays(&small().path);
    assert_eq!(before, sums(&small().path));
}

#[test]
fn a_flipped_bit_in_any_frame_is_found() {
    for file in ["frames/level01_blank.npy", "frames/level03_spray.npy"] {
        let length = std::fs::read(small().path.join(file)).unwrap().len();
        // The first and the last count, and one in the middle; the header has 128 bytes.
        for at in [128, 128 + (length - 128) / 2, length - 1] {
            let error = damaged(file, |bytes| bytes[at] ^= 0x01);
            assert!(matches!(error, SessionError::Reduce(_)), "{file} byte {at}: {error}");
            assert_eq!(error.code(), 5);
            assert!(error.to_string().contains(file), "{error}");
        }
    }
}

#[test]
fn a_frame_block_that_was_cut_is_found() {
    let error = damaged("frames/level02_spray.npy", |bytes| bytes.truncate(bytes.len() - 1));
    assert_eq!(error.code(), 5, "{error}");
}

#[test]
fn a_flipped_bit_in_the_journal_is_found_with_its_line() {
    let journal = std::fs::read(small().path.join("journal.jsonl")).unwrap();
    let lines = journal.iter().filter(|byte| **byte == b'\n').count();
    for line in [1, lines / 2, lines] {
        let starts: usize =
            journal.split_inclusive(|byte| *byte == b'\n').take(line - 1).map(<[u8]>::len).sum();
        let error = damaged("journal.jsonl", |bytes| bytes[starts + 30] ^= 0x04);
        assert_eq!(error.code(), 5, "{error}");
        let SessionError::Journal(JournalError::Damaged { line: found, .. }) = error else {
            panic!("{error}")
        };
        assert_eq!(found, line);
    }
}

#[test]
fn a_line_taken_out_of_the_journal_is_found() {
    let error = damaged("journal.jsonl", |bytes| {
        let ends: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i] == b'\n').collect();
        let middle = ends.len() / 2;
        bytes.drain(ends[middle] + 1..=ends[middle + 1]);
    });
    assert_eq!(error.code(), 5, "{error}");
}

#[test]
fn an_edited_campaign_file_is_found() {
    let error = damaged("campaign.toml", |bytes| {
        let text = String::from_utf8(bytes.clone()).unwrap();
        let edited = text.replace("gamma_near = 0.943", "gamma_near = 0.953");
        assert_ne!(text, edited);
        *bytes = edited.into_bytes();
    });
    assert!(matches!(error, SessionError::Reduce(_)), "{error}");
    assert_eq!(error.code(), 5);
    assert!(error.to_string().contains("campaign.toml"), "{error}");
}

#[test]
fn another_estimator_gives_other_maps_from_the_same_frames() {
    let out = folder();
    let maps = |estimator| {
        let out = out.path().join("out");
        session::replay(&small().path, &out, estimator).unwrap();
        sums(&out)["dit.npz"].clone()
    };
    let (own, default) = (maps(None), maps(Some(Estimator::Default)));
    let (paper, ols) = (maps(Some(Estimator::Paper)), maps(Some(Estimator::Ols)));
    assert_eq!(own, default);
    assert!(own != paper && own != ols && paper != ols);
}

/// The journal alone says what counts: frames of a cycle without `CycleAccepted` are not in the result.
#[test]
fn frames_without_an_accepted_cycle_do_not_count() {
    let dir = folder();
    let run = dir.path().join("run");
    copy(&small().path, &run);
    let entries = small().entries();
    let last =
        entries.iter().rposition(|entry| matches!(entry.record, Record::CycleAccepted { .. })).unwrap();
    cut(&run, last);
    let out = dir.path().join("out");
    session::replay(&run, &out, None).unwrap();
    let summary: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("summary.json")).unwrap()).unwrap();
    assert_eq!((&summary["cycles"]["received"], &summary["cycles"]["lost"]), (&8.into(), &1.into()));
}

/// Keeps the first `records` records of a journal.
fn cut(run: &Path, records: usize) {
    let path = run.join("journal.jsonl");
    let bytes = std::fs::read(&path).unwrap();
    let kept: usize = bytes.split_inclusive(|byte| *byte == b'\n').take(records).map(<[u8]>::len).sum();
    std::fs::write(&path, &bytes[..kept]).unwrap();
}
