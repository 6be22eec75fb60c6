//! Writes what happens as it happens: journal, raw frames, telemetry; and folds the same records live.

use crate::files::npy::{NpyBlock, NpyError};
use crate::journal::{Entry, Journal, JournalError, Record};
use crate::reduce::{FrameSource, ReduceError, Reduced};
use ditd_drivers::instrument::{Frame, MonitorReading, PlateReading, ShotKind};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Trouble with what is written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The journal.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A block of frames.
    #[error("frames: {0}")]
    Frames(#[from] NpyError),
    /// The live sums.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// Another file.
    #[error("{path}: {source}. Check the disk and its rights.")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
}

/// Frames of the cycle under way, so that live sums need not read the disk.
#[derive(Debug, Default)]
struct Recent(HashMap<(String, u64), Arc<[u16]>>);

impl FrameSource for Recent {
    fn load(&mut self, file: &str, index: u64, _crc32: u32) -> Result<Arc<[u16]>, String> {
        self.0
            .get(&(file.to_owned(), index))
            .cloned()
            .ok_or_else(|| format!("{file}[{index}] is not at hand"))
    }
}

/// What a frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Label {
    /// Level index.
    pub level: u32,
    /// Cycle within the level, counted over all bursts.
    pub cycle: u32,
    /// Position within the cycle.
    pub position: u32,
    /// What it is for.
    pub shot: ShotKind,
    /// Whether it was taken with the shutter closed.
    pub shutter: bool,
}

/// The memory of a run, on disk and live.
#[derive(Debug)]
pub struct Recorder {
    folder: PathBuf,
    journal: Journal,
    telemetry: BufWriter<File>,
    /// The telemetry has its first line.
    headed: bool,
    /// Full names of the process values, in the order of their columns.
    monitored: Vec<String>,
    blocks: BTreeMap<String, NpyBlock>,
    recent: Recent,
    reduced: Reduced,
    rows: usize,
    columns: usize,
    durable: bool,
}

/// File of the frames of one level and kind, below the run folder.
fn block_name(level: u32, shot: ShotKind, shutter: bool) -> String {
    let kind = match (shot, shutter) {
        (_, true) => "shutter",
        (ShotKind::Spray, false) => "spray",
        (ShotKind::Blank | ShotKind::WarmUp, false) => "blank",
    };
    format!("frames/level{:02}_{kind}.npy", level + 1)
}

impl Recorder {
    /// Begins a record in `folder`, which exists and holds no journal yet.
    ///
    /// # Errors
    ///
    /// [`RecordError`] when a file cannot be made.
    pub fn create(folder: &Path, reduced: Reduced, rows: usize, columns: usize) -> Result<Self, RecordError> {
        let journal = Journal::create(&folder.join("journal.jsonl"))?;
        Self::with_journal(folder, journal, reduced, rows, columns)
    }

    /// Goes on with a record: the journal's entries are folded with frames from disk.
    ///
    /// # Errors
    ///
    /// [`RecordError`] when something cannot be read or is damaged.
    pub fn reopen(
        folder: &Path,
        reduced: Reduced,
        rows: usize,
        columns: usize,
        frames: &mut dyn FrameSource,
    ) -> Result<(Self, Vec<Entry>), RecordError> {
        let (journal, entries) = Journal::reopen(&folder.join("journal.jsonl"))?;
        let mut recorder = Self::with_journal(folder, journal, reduced, rows, columns)?;
        for entry in &entries {
            recorder.reduced.apply(&entry.record, frames)?;
        }
        Ok((recorder, entries))
    }

    fn with_journal(
        folder: &Path,
        journal: Journal,
        reduced: Reduced,
        rows: usize,
        columns: usize,
    ) -> Result<Self, RecordError> {
        let path = folder.join("telemetry.csv");
        let telemetry = File::options().create(true).append(true).open(&path);
        let telemetry = telemetry.map_err(|source| RecordError::Io { path: path.clone(), source })?;
        let headed = telemetry.metadata().is_ok_and(|metadata| metadata.len() > 0);
        let frames = folder.join("frames");
        std::fs::create_dir_all(&frames).map_err(|source| RecordError::Io { path: frames, source })?;
        Ok(Self {
            folder: folder.to_owned(),
            journal,
            telemetry: BufWriter::new(telemetry),
            headed,
            monitored: Vec::new(),
            blocks: BTreeMap::new(),
            recent: Recent::default(),
            reduced,
            rows,
            columns,
            durable: true,
        })
    }

    /// Does not wait for the disk after every cycle: for a simulated rig, whose frames can be made again.
    pub fn without_waiting(mut self) -> Self {
        self.durable = false;
        self
    }

    /// Names the process values that readings will have: columns of the telemetry after those of the plate.
    pub fn monitor(&mut self, names: Vec<String>) {
        self.monitored = names;
    }

    /// The run folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What the records add up to so far.
    pub fn reduced(&self) -> &Reduced {
        &self.reduced
    }

    /// Writes a record and folds it.
    ///
    /// # Errors
    ///
    /// [`RecordError`] when the disk refuses or the record does not fit.
    pub fn record(&mut self, t_ns: u64, record: Record) -> Result<(), RecordError> {
        let settles = matches!(record, Record::CycleAccepted { .. } | Record::CycleRejected { .. });
        if settles {
            if self.durable {
                self.flush_frames()?;
            }
            self.telemetry.flush().map_err(|source| self.telemetry_error(source))?;
        }
        let entry = self.journal.append(t_ns, record)?;
        self.reduced.apply(&entry.record, &mut self.recent)?;
        if settles {
            self.recent.0.clear();
        }
        // A plate that heats or an injector that fires must not be unknown to the record after a power cut.
        if self.durable && (settles || matches!(entry.record, Record::Intent { .. })) {
            self.journal.sync()?;
        }
        Ok(())
    }

    /// Writes a raw frame and its record. Discarded frames are not kept.
    ///
    /// # Errors
    ///
    /// [`RecordError`] when the disk refuses.
    pub fn frame(&mut self, t_ns: u64, label: Label, frame: &Frame) -> Result<(), RecordError> {
        let Label { level, cycle, position, shot, shutter } = label;
        if shot == ShotKind::WarmUp {
            return Ok(());
        }
        let name = block_name(level, shot, shutter);
        if !self.blocks.contains_key(&name) {
            let path = self.folder.join(&name);
            let block = if path.exists() {
                NpyBlock::repair(&path)?
            } else {
                NpyBlock::create(&path, self.rows, self.columns)?
            };
            self.blocks.insert(name.clone(), block);
        }
        let block = self.blocks.get_mut(&name).expect("it was put there above");
        let index = block.append(&frame.counts)? as u64;
        let crc32 = crc_of(&frame.counts);
        self.recent.0.insert((name.clone(), index), Arc::clone(&frame.counts));
        let record = Record::Frame {
            level,
            cycle,
            position,
            shot,
            camera_id: frame.id,
            device_ns: frame.device_ns,
            file: name,
            index,
            crc32,
        };
        self.record(t_ns, record)
    }

    /// One line of telemetry. A process value that could not be read is an empty field.
    ///
    /// # Errors
    ///
    /// [`RecordError::Io`] when the disk refuses.
    pub fn reading(
        &mut self,
        t_ns: u64,
        level: u32,
        reading: &PlateReading,
        values: &[MonitorReading],
    ) -> Result<(), RecordError> {
        self.head_telemetry()?;
        let mut line = format!(
            "{t_ns},{},{:.4},{:.4},{:.4},{},{}",
            level + 1,
            reading.apparent.0,
            reading.block.0,
            reading.set_point.0,
            u8::from(reading.stable),
            u8::from(reading.tripped)
        );
        for name in &self.monitored {
            line.push(',');
            if let Some(value) = values.iter().find(|value| value.name == *name) {
                line.push_str(&format!("{:?}", value.value));
            }
        }
        self.telemetry_line(&line)
    }

    /// The first line, once.
    fn head_telemetry(&mut self) -> Result<(), RecordError> {
        if self.headed {
            return Ok(());
        }
        self.headed = true;
        let columns = self.monitored.iter().map(|name| format!(",{name}")).collect::<String>();
        self.telemetry_line(&format!(
            "t_ns,level,plate_apparent_k,plate_block_k,plate_set_point_k,plate_stable,plate_tripped{columns}"
        ))
    }

    /// Makes everything durable and closes the frame blocks.
    ///
    /// # Errors
    ///
    /// [`RecordError`] when the disk refuses.
    pub fn close(&mut self) -> Result<(), RecordError> {
        self.flush_frames()?;
        self.head_telemetry()?;
        self.blocks.clear();
        self.telemetry.flush().map_err(|source| self.telemetry_error(source))?;
        self.journal.sync()?;
        Ok(())
    }

    fn flush_frames(&mut self) -> Result<(), RecordError> {
        for block in self.blocks.values_mut() {
            block.sync()?;
        }
        Ok(())
    }

    fn telemetry_line(&mut self, line: &str) -> Result<(), RecordError> {
        writeln!(self.telemetry, "{line}").map_err(|source| self.telemetry_error(source))
    }

    fn telemetry_error(&self, source: std::io::Error) -> RecordError {
        RecordError::Io { path: self.folder.join("telemetry.csv"), source }
    }
}

/// CRC-32 of a frame's counts as little-endian bytes.
pub fn crc_of(counts: &[u16]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    let mut buffer = [0u8; 4096];
    for chunk in counts.chunks(buffer.len() / 2) {
        for (bytes, count) in buffer.chunks_exact_mut(2).zip(chunk) {
            bytes.copy_from_slice(&count.to_le_bytes());
        }
        hasher.update(&buffer[..chunk.len() * 2]);
    }
    hasher.finalize()
}
