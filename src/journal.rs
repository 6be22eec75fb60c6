//! The journal: append-only JSON lines with a CRC, an intent before an act and a done after.
//!
//! What is not in the journal did not happen. A line is `{"seq":…,"t_ns":…,"record":{…},"crc":"xxxxxxxx"}`; the
//! CRC-32 (IEEE) covers everything before `,"crc"`. A torn last line, as a kill leaves it, is dropped and said;
//! damage anywhere else is an error. Raw frames lie beside it in NPY blocks and are named by records.

use crate::plan::Plan;
use ditd_drivers::instrument::{Identity, MonitorReading, PlateReading, ShotKind, ShotProgram};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Version of the journal's format.
pub const JOURNAL_SCHEMA: u32 = 1;

/// One thing that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Record {
    /// The campaign begins.
    Start {
        /// Format of this journal.
        schema: u32,
        /// Version of the program.
        program: String,
        /// UTC of `t_ns` = 0, RFC 3339.
        utc: String,
        /// SHA-256 of `campaign.toml`.
        config_sha256: String,
        /// What will be done.
        plan: Plan,
    },
    /// An instrument said who it is.
    Identity {
        /// `plate`, `trigger` or `camera`.
        instrument: String,
        /// Its answer.
        identity: Identity,
    },
    /// What an instrument says of itself besides: settings that it holds, calibration constants.
    Particulars {
        /// `plate`.
        instrument: String,
        /// Names with units, and values.
        values: Vec<MonitorReading>,
    },
    /// About to act.
    Intent {
        /// The act in words.
        act: String,
        /// Level index, when the act belongs to one.
        level: Option<u32>,
    },
    /// The act is done.
    Done {
        /// The act in words.
        act: String,
        /// Level index, when the act belongs to one.
        level: Option<u32>,
    },
    /// The plate has settled.
    Settled {
        /// Level index.
        level: u32,
        /// The reading on which it was decided.
        reading: PlateReading,
        /// Time from the set-point's change, in s.
        waited_s: f64,
    },
    /// A burst was programmed, as the trigger unit took it.
    Burst {
        /// Level index.
        level: u32,
        /// The program that the unit confirmed.
        program: ShotProgram,
        /// Number of the burst's first cycle within the level.
        first_cycle: u32,
        /// Whether the shutter is closed, and then its temperature in K.
        shutter_k: Option<f64>,
    },
    /// A raw frame was written.
    Frame {
        /// Level index.
        level: u32,
        /// Cycle within the level, counted over all bursts.
        cycle: u32,
        /// Position within the cycle.
        position: u32,
        /// What it is.
        shot: ShotKind,
        /// The camera's frame number.
        camera_id: u64,
        /// The camera's time stamp.
        device_ns: u64,
        /// File below the run folder.
        file: String,
        /// Index in that file.
        index: u64,
        /// CRC-32 of its bytes (little-endian counts).
        crc32: u32,
    },
    /// What the monitors showed right after a cycle's last frame, when the plate had settled, or when a value left its
    /// limits.
    ProcessValues {
        /// Level index.
        level: u32,
        /// Cycle within the level, when the values belong to one.
        cycle: Option<u32>,
        /// Full names (monitor and value) and values.
        values: Vec<MonitorReading>,
    },
    /// All frames of a cycle are there and fit the plan: it counts.
    CycleAccepted {
        /// Level index.
        level: u32,
        /// Cycle within the level.
        cycle: u32,
        /// The plate's reading right after the cycle's last frame.
        reading: PlateReading,
    },
    /// A cycle does not count and is taken again.
    CycleRejected {
        /// Level index.
        level: u32,
        /// Cycle within the level.
        cycle: u32,
        /// Why.
        reason: String,
    },
    /// What the camera's transport counted in a burst: packets, resends, losses.
    Transport {
        /// Level index.
        level: u32,
        /// Counts by their names.
        counters: BTreeMap<String, u64>,
    },
    /// The campaign ended in its safe state, with or without trouble.
    Stop {
        /// `done`, `paused`, `aborted` or `failed`.
        status: String,
        /// What went wrong, if anything.
        trouble: Option<String>,
        /// Cycles: planned, accepted, taken again, given up.
        cycles: CycleCount,
    },
}

/// The account of a campaign's cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CycleCount {
    /// Asked for.
    pub planned: u32,
    /// Complete and counted.
    pub accepted: u32,
    /// Rejected and taken again (or to be taken again).
    pub retaken: u32,
    /// Planned and not there at the end.
    pub lost: u32,
}

/// One line of the journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Number of the line, from 0.
    pub seq: u64,
    /// Time since the start of the campaign's clock, in ns.
    pub t_ns: u64,
    /// What happened.
    pub record: Record,
}

/// Trouble with the journal's file.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The system refused.
    #[error("journal {path}: {doing}: {source}. Check the disk and its rights.")]
    Io {
        /// The file.
        path: PathBuf,
        /// The act.
        doing: &'static str,
        /// The system's words.
        source: std::io::Error,
    },
    /// A line inside the file is not what was written.
    #[error("journal {path}, line {line}: {why}. The record is damaged: restore the folder from a copy.")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        why: String,
    },
}

/// Appends entries to a file.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: BufWriter<File>,
    next_seq: u64,
}

/// The text of one line, without its end.
fn line_of(entry: &Entry) -> String {
    let body = serde_json::to_string(entry).expect("records hold only values that JSON can carry");
    let open = &body[..body.len() - 1];
    format!("{open},\"crc\":\"{:08x}\"}}", crc32fast::hash(open.as_bytes()))
}

fn entry_of(line: &str) -> Result<Entry, String> {
    let at = line.rfind(",\"crc\":\"").ok_or("no crc at its end")?;
    let open = &line[..at];
    let stated = line[at..].strip_prefix(",\"crc\":\"").and_then(|rest| rest.strip_suffix("\"}"));
    let stated =
        stated.and_then(|hex| u32::from_str_radix(hex, 16).ok()).ok_or("its crc is not eight hex digits")?;
    let found = crc32fast::hash(open.as_bytes());
    if stated != found {
        return Err(format!("crc {found:08x} where {stated:08x} was written"));
    }
    serde_json::from_str(&format!("{open}}}")).map_err(|error| error.to_string())
}

impl Journal {
    /// Begins a new journal; refuses to overwrite one.
    ///
    /// # Errors
    ///
    /// [`JournalError::Io`] when the file exists or cannot be made.
    pub fn create(path: &Path) -> Result<Self, JournalError> {
        let file = OpenOptions::new().write(true).create_new(true).open(path);
        let file = file.map_err(|source| io(path, "creating it", source))?;
        Ok(Self { path: path.to_owned(), file: BufWriter::new(file), next_seq: 0 })
    }

    /// Goes on with a journal after a pause or crash: reads it, cuts a torn last line, appends.
    ///
    /// # Errors
    ///
    /// [`JournalError`] when it cannot be read or is damaged.
    pub fn reopen(path: &Path) -> Result<(Self, Vec<Entry>), JournalError> {
        let (entries, good_bytes) = read_prefix(path)?;
        let file =
            OpenOptions::new().append(true).open(path).map_err(|source| io(path, "opening it", source))?;
        file.set_len(good_bytes).map_err(|source| io(path, "cutting a torn line", source))?;
        let next_seq = entries.len() as u64;
        Ok((Self { path: path.to_owned(), file: BufWriter::new(file), next_seq }, entries))
    }

    /// Writes one record and hands it to the system.
    ///
    /// # Errors
    ///
    /// [`JournalError::Io`] when the disk refuses.
    pub fn append(&mut self, t_ns: u64, record: Record) -> Result<Entry, JournalError> {
        let entry = Entry { seq: self.next_seq, t_ns, record };
        let mut line = line_of(&entry);
        line.push('\n');
        self.file.write_all(line.as_bytes()).map_err(|source| io(&self.path, "writing", source))?;
        self.file.flush().map_err(|source| io(&self.path, "writing", source))?;
        self.next_seq += 1;
        Ok(entry)
    }

    /// Waits until everything written is on the disk.
    ///
    /// # Errors
    ///
    /// [`JournalError::Io`] when the disk refuses.
    pub fn sync(&mut self) -> Result<(), JournalError> {
        self.file.get_ref().sync_data().map_err(|source| io(&self.path, "syncing", source))
    }
}

/// Reads a whole journal. A torn last line is left out.
///
/// # Errors
///
/// [`JournalError`] when the file cannot be read or a line inside is damaged.
pub fn read(path: &Path) -> Result<Vec<Entry>, JournalError> {
    Ok(read_prefix(path)?.0)
}

fn read_prefix(path: &Path) -> Result<(Vec<Entry>, u64), JournalError> {
    let bytes = std::fs::read(path).map_err(|source| io(path, "reading it", source))?;
    let mut entries: Vec<Entry> = Vec::new();
    let mut good = 0usize;
    for (index, raw) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
        let last = good + raw.len() == bytes.len();
        let parsed = std::str::from_utf8(raw).map_err(|error| error.to_string()).and_then(|text| {
            let text = text.strip_suffix('\n').ok_or("it does not end")?;
            entry_of(text)
        });
        let damage = |why: String| JournalError::Damaged { path: path.to_owned(), line: index + 1, why };
        match parsed {
            Ok(entry) if entry.seq == entries.len() as u64 => entries.push(entry),
            Ok(entry) => {
                return Err(damage(format!("its number is {} where {} was due", entry.seq, entries.len())));
            }
            Err(_) if last && !raw.ends_with(b"\n") => break,
            Err(why) => return Err(damage(why)),
        }
        good += raw.len();
    }
    Ok((entries, good as u64))
}

fn io(path: &Path, doing: &'static str, source: std::io::Error) -> JournalError {
    JournalError::Io { path: path.to_owned(), doing, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(n: u32) -> Record {
        Record::Intent { act: format!("act {n}"), level: Some(n) }
    }

    fn written() -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let mut journal = Journal::create(&path).unwrap();
        for n in 0..5 {
            journal.append(u64::from(n) * 10, sample(n)).unwrap();
        }
        journal.sync().unwrap();
        (dir, path)
    }

    #[test]
    fn what_was_written_is_read() {
        let (_dir, path) = written();
        let entries = read(&path).unwrap();
        assert_eq!(entries.len(), 5);
        assert_eq!(entries[3].record, sample(3));
        assert_eq!(entries[3].t_ns, 30);
    }

    #[test]
    fn a_torn_end_costs_only_the_torn_line_at_any_cut() {
        let (_dir, path) = written();
        let whole = std::fs::read(&path).unwrap();
        for cut in 0..=whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let complete = whole[..cut].iter().filter(|byte| **byte == b'\n').count();
            assert_eq!(read(&path).unwrap().len(), complete, "cut at {cut}");
            let (mut journal, entries) = Journal::reopen(&path).unwrap();
            assert_eq!(entries.len(), complete);
            journal.append(99, sample(9)).unwrap();
            assert_eq!(read(&path).unwrap().len(), complete + 1);
        }
    }

    #[test]
    fn a_changed_byte_inside_is_found() {
        let (_dir, path) = written();
        let whole = std::fs::read(&path).unwrap();
        let last_line = whole[..whole.len() - 1].iter().rposition(|byte| *byte == b'\n').unwrap();
        for at in (0..last_line).step_by(7) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x01;
            std::fs::write(&path, &bytes).unwrap();
            assert!(matches!(read(&path), Err(JournalError::Damaged { .. })), "byte {at}");
        }
    }

    #[test]
    fn a_journal_is_never_overwritten() {
        let (_dir, path) = written();
        assert!(matches!(Journal::create(&path), Err(JournalError::Io { .. })));
    }
}
