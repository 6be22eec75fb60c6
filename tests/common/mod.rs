//! Small campaigns for the tests of whole runs: the shipped files with tiny pictures and few cycles.

#![allow(dead_code, reason = "every test file uses a part of it")]

use ditd::campaign::StopFlag;
use ditd::clock::Clock;
use ditd::config::Config;
use ditd::journal::{self, Entry, Record};
use ditd::samples::Source;
use ditd::session::{self, SessionError, Setting};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use toml::{Table, Value};

/// A campaign file as a table whose values can be replaced.
#[derive(Clone)]
pub(crate) struct Preset(Table);

impl Preset {
    /// Three levels, three cycles of 1 + 2 + 1 frames, 8 × 6 pixels, an empty chamber.
    pub(crate) fn small() -> Self {
        Self::of(include_str!("../../configs/long.toml"))
            .with("campaign.levels_k", "[373.0, 433.0, 533.0]")
            .with("campaign.cycles", "3")
            .with("campaign.blanks", "2")
            .with("campaign.warm_up", "1")
            .with("campaign.pause_s", "15.0")
            .with("soak.hold_s", "60.0")
            .with("soak.band_k", "0.6")
            .with("calibration.frames", "4")
    }

    /// The quickstart's spray, chamber and detector at 32 × 24 pixels, coarse enough to render in a second or two.
    pub(crate) fn spray() -> Self {
        Self::of(include_str!("../../configs/quickstart.toml"))
            .with("campaign.levels_k", "[373.0, 433.0, 498.0, 533.0]")
            .with("campaign.cycles", "6")
            .with("campaign.blanks", "2")
            .with("camera.rows", "24")
            .with("camera.columns", "32")
            .with("rig.view.rows", "24")
            .with("rig.view.columns", "32")
            .with("rig.filter.samples", "3")
            .with("rig.target_error", "1e-2")
            .with("rig.spray.cell_m", "0.002")
            .with("rig.fluctuation.correlation_length_px", "2.0")
    }

    /// The same without the value at a dotted path.
    pub(crate) fn without(mut self, path: &str) -> Self {
        let mut keys: Vec<&str> = path.split('.').collect();
        let last = keys.pop().unwrap();
        let mut table = &mut self.0;
        for key in keys {
            table = table.get_mut(key).and_then(Value::as_table_mut).unwrap();
        }
        table.remove(last).unwrap();
        self
    }

    /// The five hours of orchestration as shipped.
    pub(crate) fn long() -> Self {
        Self::of(include_str!("../../configs/long.toml"))
    }

    fn of(text: &str) -> Self {
        Self(text.parse().unwrap())
    }

    /// The same with one value, in TOML's spelling, at a dotted path.
    pub(crate) fn with(mut self, path: &str, value: &str) -> Self {
        let value = format!("value = {value}").parse::<Table>().unwrap().remove("value").unwrap();
        let mut keys: Vec<&str> = path.split('.').collect();
        let last = keys.pop().unwrap();
        let mut table = &mut self.0;
        for key in keys {
            let next = table.entry(key.to_owned()).or_insert_with(|| Value::Table(Table::new()));
            table = next.as_table_mut().unwrap();
        }
        table.insert(last.to_owned(), value);
        self
    }

    /// The same with a calibration that was measured once, without faults, for all tests of this file.
    pub(crate) fn calibrated(self) -> Self {
        static FOLDER: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
        let (_, path) = FOLDER.get_or_init(|| {
            let dir = folder();
            let path = dir.path().join("standard");
            let (source, config) = Self::small().parsed();
            session::calibrate(&setting(&source, &config, StopFlag::default()), &path).unwrap();
            (dir, path)
        });
        self.with("optics.calibration", &format!("{:?}", path.display().to_string()))
    }

    /// As the program takes it.
    pub(crate) fn parsed(&self) -> (Source, Config) {
        let text = toml::to_string(&self.0).unwrap();
        let config = Config::parse("test.toml", &text).unwrap_or_else(|error| panic!("{error}"));
        (Source { name: "test.toml".to_owned(), text, folder: PathBuf::new() }, config)
    }

    /// Runs it into a new folder `run` below a temporary one.
    pub(crate) fn run(&self) -> Ran {
        self.run_with(StopFlag::default())
    }

    /// The same with a wish to stop.
    pub(crate) fn run_with(&self, stop: StopFlag) -> Ran {
        let dir = folder();
        let path = dir.path().join("run");
        let (source, config) = self.parsed();
        let ended = session::run(&setting(&source, &config, stop), &path);
        Ran { dir, path, ended }
    }
}

/// A run folder and how the session ended.
pub(crate) struct Ran {
    pub(crate) dir: tempfile::TempDir,
    pub(crate) path: PathBuf,
    pub(crate) ended: Result<String, SessionError>,
}

impl Ran {
    /// The same, which must have ended well.
    pub(crate) fn done(self) -> Self {
        if let Err(error) = &self.ended {
            panic!("{error}");
        }
        self
    }

    /// The error that it must have ended with.
    pub(crate) fn error(&self) -> &SessionError {
        self.ended.as_ref().expect_err("it must not end well")
    }

    pub(crate) fn entries(&self) -> Vec<Entry> {
        journal::read(&self.path.join("journal.jsonl")).unwrap()
    }

    pub(crate) fn records(&self) -> Vec<Record> {
        self.entries().into_iter().map(|entry| entry.record).collect()
    }

    pub(crate) fn summary(&self) -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(self.path.join("result/summary.json")).unwrap()).unwrap()
    }
}

/// What `session` functions are told.
pub(crate) fn setting<'a>(source: &'a Source, config: &'a Config, stop: StopFlag) -> Setting<'a> {
    Setting { source, config, clock: Clock::start(), stop }
}

/// A temporary folder, in memory where the system has such a place: the journal is synced at every cycle.
pub(crate) fn folder() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// SHA-256 of every file below a folder, by name.
pub(crate) fn sums(root: &Path) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().display().to_string();
                found.insert(name, ditd::run_folder::sha256(&std::fs::read(&path).unwrap()));
            }
        }
    }
    found
}

/// Copies a folder.
pub(crate) fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}

/// Asserts that a replay of a run folder writes its result again, byte for byte.
pub(crate) fn assert_replays(run: &Path) {
    let out = folder();
    session::replay(run, out.path(), None).unwrap_or_else(|error| panic!("{error}"));
    let (recorded, replayed) = (sums(&run.join("result")), sums(out.path()));
    assert!(recorded.len() >= 6, "{recorded:?}");
    assert_eq!(recorded, replayed);
}
