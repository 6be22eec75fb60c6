//! Folds the journal's records into what the fit needs. A live run and a replay call exactly this.
//!
//! Knows where frames are only through a [`FrameSource`]; reads no clock and no instrument.

use crate::estimate::accept::{self, LeftOut, Recorded, Visitor};
use crate::estimate::accumulate::{AccumulateError, Sums};
use crate::estimate::convergence::{self, Step};
use crate::estimate::map::FitInputs;
use crate::journal::Record;
use crate::plan::{Plan, Purpose};
use crate::stack::STEPS_MAX;
use ditd_drivers::instrument::{MonitorReading, ShotKind};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Gives the counts of a recorded frame.
pub trait FrameSource {
    /// The frame `index` of `file` (below the run folder), whose bytes have the CRC-32 `crc32`.
    ///
    /// # Errors
    ///
    /// Words that say what is wrong with the file.
    fn load(&mut self, file: &str, index: u64, crc32: u32) -> Result<Arc<[u16]>, String>;
}

/// A record that contradicts the ones before it, or a frame that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("record of the run: {0}. The run folder is damaged or was changed: restore it from a copy.")]
pub struct ReduceError(pub String);

/// What is known of one level.
#[derive(Debug, Clone, Default)]
pub struct LevelState {
    /// Accepted cycles.
    pub accepted: u32,
    /// Accepted series of frames with the shutter closed.
    pub references: u32,
    /// Rejected cycles with their reasons.
    pub rejected: Vec<(u32, String)>,
    /// Apparent plate temperature at each accepted cycle, in K.
    pub plate_k: Vec<f64>,
    /// Numbers of the accepted cycles, in their order.
    pub cycles: Vec<u32>,
    /// What of the accepted cycles the map does not rest on; empty before the map is final.
    pub left_out: LeftOut,
    /// The camera's numbers of the accepted spray frames.
    pub spray_ids: Vec<u64>,
    /// The next unused cycle number.
    pub next_cycle: u32,
    /// Process values at the accepted cycles, by their full names: how many, mean, least and greatest.
    pub process: BTreeMap<String, ProcessValue>,
}

/// A process value over the accepted cycles of a level, in the unit of its name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessValue {
    /// Readings.
    pub count: u32,
    /// Their mean.
    pub mean: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl ProcessValue {
    /// Takes one more reading.
    fn with(before: Option<Self>, value: f64) -> Self {
        let Some(Self { count, mean, min, max }) = before else {
            return Self { count: 1, mean: value, min: value, max: value };
        };
        let count = count + 1;
        Self {
            count,
            mean: mean + (value - mean) / f64::from(count),
            min: min.min(value),
            max: max.max(value),
        }
    }
}

impl LevelState {
    /// Mean apparent plate temperature at the accepted cycles, in K; `None` without any.
    pub fn plate_mean_k(&self) -> Option<f64> {
        let n = self.plate_k.len();
        (n > 0).then(|| self.plate_k.iter().sum::<f64>() / n as f64)
    }
}

/// Sums of frames of the bare plate and of the shutter, for the standard curve.
#[derive(Debug, Clone)]
pub struct CurveSums {
    /// Per level: sum of counts per pixel, plate.
    pub plate: Vec<Vec<u64>>,
    /// Per level: sum of squared counts per pixel, plate.
    pub plate_squares: Vec<Vec<u64>>,
    /// Per level: frames in `plate`.
    pub plate_frames: Vec<u32>,
    /// Per level: sum of counts per pixel, shutter closed.
    pub shutter: Vec<Vec<u64>>,
    /// Per level: sum of squared counts per pixel, shutter closed.
    pub shutter_squares: Vec<Vec<u64>>,
    /// Per level: frames in `shutter`.
    pub shutter_frames: Vec<u32>,
    /// Temperature of the shutter at each level, in K.
    pub shutter_k: Vec<Option<f64>>,
}

/// What the records add up to.
#[derive(Debug, Clone)]
pub enum Total {
    /// Sums of a measuring campaign.
    Map(Box<Sums>),
    /// Sums of a calibration.
    Curve(CurveSums),
}

#[derive(Debug, Clone)]
struct FrameRef {
    cycle: u32,
    position: u32,
    shot: ShotKind,
    camera_id: u64,
    file: String,
    index: u64,
    crc32: u32,
}

/// The state of a run as its records tell it.
#[derive(Debug, Clone)]
pub struct Reduced {
    /// The plan of the run.
    pub plan: Plan,
    /// Per level of the plan.
    pub levels: Vec<LevelState>,
    /// The sums.
    pub total: Total,
    /// One more than the highest frame number of the camera so far.
    pub frames_seen: u64,
    /// Spray frames so far, accepted or not.
    pub injections_seen: u64,
    /// Frames of the accepted cycles, level by level.
    taken: Vec<Vec<Vec<FrameRef>>>,
    pending: Vec<FrameRef>,
    /// Process values of the cycle under way: level index, cycle, values.
    shown: Option<(u32, u32, Vec<MonitorReading>)>,
    shutter_k: Option<f64>,
    pixels: usize,
}

impl Reduced {
    /// Nothing yet, for a plan and frames of `rows` × `columns` pixels that saturate at `saturation_count`.
    ///
    /// # Errors
    ///
    /// [`ReduceError`] when the plan asks for more than sums can hold.
    pub fn new(plan: Plan, rows: usize, columns: usize, saturation_count: u16) -> Result<Self, ReduceError> {
        let levels = plan.levels.len();
        let pixels = rows * columns;
        let total = match plan.purpose {
            Purpose::Map => {
                let blanks = plan.levels.first().map_or(1, |level| level.program.blanks);
                let blanks =
                    u16::try_from(blanks).map_err(|_| ReduceError(format!("{blanks} blanks a cycle")))?;
                let sums = Sums::new(levels, rows, columns, blanks, saturation_count);
                Total::Map(Box::new(sums.map_err(|error| ReduceError(error.to_string()))?))
            }
            Purpose::StandardCurve => Total::Curve(CurveSums {
                plate: vec![vec![0; pixels]; levels],
                plate_squares: vec![vec![0; pixels]; levels],
                plate_frames: vec![0; levels],
                shutter: vec![vec![0; pixels]; levels],
                shutter_squares: vec![vec![0; pixels]; levels],
                shutter_frames: vec![0; levels],
                shutter_k: vec![None; levels],
            }),
        };
        let taken = vec![Vec::new(); levels];
        let levels = vec![LevelState::default(); levels];
        Ok(Self {
            plan,
            levels,
            total,
            frames_seen: 0,
            injections_seen: 0,
            taken,
            pending: Vec::new(),
            shown: None,
            shutter_k: None,
            pixels,
        })
    }

    /// Takes the next record.
    ///
    /// # Errors
    ///
    /// [`ReduceError`] when the record does not fit the ones before it or a frame cannot be read.
    pub fn apply(&mut self, record: &Record, frames: &mut dyn FrameSource) -> Result<(), ReduceError> {
        match record {
            Record::Burst { shutter_k, .. } => {
                self.pending.clear();
                self.shutter_k = *shutter_k;
            }
            Record::Frame { cycle, position, shot, camera_id, file, index, crc32, .. } => {
                self.frames_seen = self.frames_seen.max(camera_id + 1);
                self.injections_seen += u64::from(*shot == ShotKind::Spray);
                self.pending.push(FrameRef {
                    cycle: *cycle,
                    position: *position,
                    shot: *shot,
                    camera_id: *camera_id,
                    file: file.clone(),
                    index: *index,
                    crc32: *crc32,
                });
            }
            Record::ProcessValues { level, cycle, values } => {
                self.shown = cycle.map(|cycle| (*level, cycle, values.clone()));
            }
            Record::CycleAccepted { level, cycle, reading } => {
                let index = self.level_index(*level)?;
                self.add_cycle(index, *cycle, frames)?;
                let state = &mut self.levels[index];
                let shown = self.shown.take().filter(|shown| (shown.0, shown.1) == (*level, *cycle));
                for MonitorReading { name, value } in shown.map(|shown| shown.2).unwrap_or_default() {
                    let before = state.process.get(&name).copied();
                    state.process.insert(name, ProcessValue::with(before, value));
                }
                if self.shutter_k.is_some() {
                    state.references += 1;
                } else {
                    state.accepted += 1;
                    state.plate_k.push(reading.apparent.0);
                }
                state.next_cycle = state.next_cycle.max(cycle + 1);
            }
            Record::CycleRejected { level, cycle, reason } => {
                let index = self.level_index(*level)?;
                self.pending.retain(|frame| frame.cycle != *cycle);
                let state = &mut self.levels[index];
                state.rejected.push((*cycle, reason.clone()));
                state.next_cycle = state.next_cycle.max(cycle + 1);
            }
            Record::Start { .. }
            | Record::Identity { .. }
            | Record::Particulars { .. }
            | Record::Intent { .. }
            | Record::Done { .. }
            | Record::Settled { .. }
            | Record::Transport { .. }
            | Record::Stop { .. } => {}
        }
        Ok(())
    }

    /// The final state: without the shots that had no spray, and without spikes. A pure function of all that was
    /// recorded; the plate's mean reading is then that of the shots that stayed. A calibration stays as it is.
    ///
    /// # Errors
    ///
    /// [`ReduceError`] when a frame cannot be read again.
    pub fn refined(
        &self,
        inputs: &FitInputs<'_>,
        score_min: f64,
        frames: &mut dyn FrameSource,
    ) -> Result<Self, ReduceError> {
        let mut refined = self.clone();
        let Total::Map(sums) = &mut refined.total else { return Ok(refined) };
        let mut recorded = Taken { cycles: &self.taken, frames };
        let left_out = accept::refine(sums, inputs, score_min, &mut recorded)?;
        for (level, left_out) in refined.levels.iter_mut().zip(left_out) {
            for misfire in left_out.misfires.iter().rev() {
                level.plate_k.remove(misfire.cycle);
            }
            level.left_out = left_out;
        }
        Ok(refined)
    }

    /// How the map settles with the number of cycles; nothing for a calibration.
    ///
    /// # Errors
    ///
    /// [`ReduceError`] when a frame cannot be read again.
    pub fn convergence(
        &self,
        inputs: &FitInputs<'_>,
        emissivity_min: f64,
        frames: &mut dyn FrameSource,
    ) -> Result<Vec<Step>, ReduceError> {
        let Total::Map(sums) = &self.total else { return Ok(Vec::new()) };
        let mut recorded = Taken { cycles: &self.taken, frames };
        convergence::convergence(sums, inputs, emissivity_min, STEPS_MAX, &mut recorded)
    }

    /// Cycles that the plan asks for at a level and that are not accepted yet.
    pub fn missing(&self, level: usize) -> u32 {
        self.plan.levels[level].program.cycles.saturating_sub(self.levels[level].accepted)
    }

    fn level_index(&self, level: u32) -> Result<usize, ReduceError> {
        let index = level as usize;
        if index < self.levels.len() {
            Ok(index)
        } else {
            Err(ReduceError(format!("level {level} where the plan has {}", self.levels.len())))
        }
    }

    fn add_cycle(
        &mut self,
        level: usize,
        cycle: u32,
        frames: &mut dyn FrameSource,
    ) -> Result<(), ReduceError> {
        let mut mine: Vec<FrameRef> = Vec::new();
        self.pending.retain(|frame| {
            if frame.cycle == cycle {
                mine.push(frame.clone());
            }
            frame.cycle != cycle
        });
        mine.sort_by_key(|frame| frame.position);
        let program = &self.plan.levels[level].program;
        let wanted = (program.blanks + 1) as usize;
        let in_order = mine.iter().enumerate().all(|(i, frame)| {
            frame.position as usize == program.warm_up as usize + i
                && program.kind_at(frame.position) == Some(frame.shot)
        });
        if mine.len() != wanted || !in_order {
            return Err(ReduceError(format!(
                "level {level}, cycle {cycle} was accepted with {} frames where {wanted} in order were due",
                mine.len()
            )));
        }
        let mut counts = Vec::with_capacity(wanted);
        for frame in &mine {
            let picture = frames
                .load(&frame.file, frame.index, frame.crc32)
                .map_err(|why| ReduceError(format!("level {level}, cycle {cycle}: {why}")))?;
            if picture.len() != self.pixels {
                return Err(ReduceError(format!(
                    "level {level}, cycle {cycle}: a frame has {} pixels where {} were due",
                    picture.len(),
                    self.pixels
                )));
            }
            counts.push(picture);
        }
        if let Some(last) = mine.last() {
            self.levels[level].spray_ids.push(last.camera_id);
        }
        match &mut self.total {
            Total::Map(sums) => {
                let (spray, blanks) = counts.split_last().expect("blanks + 1 frames were checked above");
                let blanks: Vec<&[u16]> = blanks.iter().map(|frame| &frame[..]).collect();
                sums.add_cycle(level, &blanks, spray).map_err(|error| ReduceError(error.to_string()))?;
                self.taken[level].push(mine);
                self.levels[level].cycles.push(cycle);
            }
            Total::Curve(curve) => {
                let (sums, squares, frames_so_far) = match self.shutter_k {
                    Some(kelvin) => {
                        curve.shutter_k[level] = Some(kelvin);
                        let frames = &mut curve.shutter_frames[level];
                        (&mut curve.shutter[level], &mut curve.shutter_squares[level], frames)
                    }
                    None => {
                        let frames = &mut curve.plate_frames[level];
                        (&mut curve.plate[level], &mut curve.plate_squares[level], frames)
                    }
                };
                // 2³² squares of 16 bits fit into a u64; a plan has 10 000 frames a level at most.
                for frame in &counts {
                    for ((sum, square), &count) in sums.iter_mut().zip(squares.iter_mut()).zip(frame.iter()) {
                        *sum += u64::from(count);
                        *square += u64::from(count) * u64::from(count);
                    }
                }
                *frames_so_far += program.blanks + 1;
            }
        }
        Ok(())
    }
}

/// Accepted cycles and where their frames are.
struct Taken<'a> {
    cycles: &'a [Vec<Vec<FrameRef>>],
    frames: &'a mut dyn FrameSource,
}

impl From<AccumulateError> for ReduceError {
    fn from(error: AccumulateError) -> Self {
        Self(error.to_string())
    }
}

impl Recorded for Taken<'_> {
    type Error = ReduceError;

    fn cycles(&self, level: usize) -> usize {
        self.cycles[level].len()
    }

    fn one(&mut self, level: usize, cycle: usize, visit: &mut Visitor<'_>) -> Result<(), ReduceError> {
        let mut pictures = Vec::new();
        for frame in &self.cycles[level][cycle] {
            let picture = self.frames.load(&frame.file, frame.index, frame.crc32);
            pictures.push(picture.map_err(ReduceError)?);
        }
        let (spray, blanks) = pictures.split_last().expect("an accepted cycle has blanks and a spray");
        let blanks: Vec<&[u16]> = blanks.iter().map(|frame| &frame[..]).collect();
        visit(cycle, &blanks, spray);
        Ok(())
    }
}
