//! Recorded frames from elsewhere: a folder with `case.json`, `spray.npy` and `nospray.npy`.
//!
//! Frames are read one at a time and summed exactly; for our own estimator misfires and spikes are then taken out again.
//! Knows nothing of run folders and journals.

use crate::estimate::accept::{self, LeftOut, Recorded, Visitor};
use crate::estimate::accumulate::{AccumulateError, BLANKS_MAX, Sums};
use crate::estimate::budget;
use crate::estimate::calibration::{C2_UM_K, CalibrationFit, Range, SakumaHattori};
use crate::estimate::convergence::{self, Step};
use crate::estimate::gate;
use crate::estimate::map::{self, CameraNoise, DitMap, Estimator, FitInputs};
use crate::files::npy::{FrameReader, NpyError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Most cycles of a level whose influence is told: a solve each.
pub const STEPS_MAX: usize = 100;

/// A curve as `case.json` writes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CaseCurve {
    /// A, in counts.
    #[serde(rename = "A")]
    pub a_counts: f64,
    /// a, in µm.
    pub a_um: f64,
    /// b, in µm K.
    #[serde(rename = "b_um_K")]
    pub b_um_k: f64,
    /// The second radiation constant it was made with, in µm K; ours if absent.
    #[serde(default, rename = "c2_um_K", skip_serializing_if = "Option::is_none")]
    pub c2_um_k: Option<f64>,
}

impl CaseCurve {
    /// The curve with our constant: a and b scale with it, so nothing is lost.
    pub fn curve(&self) -> SakumaHattori {
        let scale = self.c2_um_k.map_or(1.0, |c2| C2_UM_K / c2);
        SakumaHattori { a_counts: self.a_counts, a_um: self.a_um * scale, b_um_k: self.b_um_k * scale }
    }
}

/// `case.json`. Keys that are not listed are ignored.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Case {
    /// What to call it.
    #[serde(default)]
    pub name: String,
    /// Pairs of each level, in the order of the frames.
    pub pairs_per_setpoint: Vec<usize>,
    /// Plate temperature of each level, in K.
    #[serde(default, rename = "setpoints_K")]
    pub setpoints_k: Vec<Option<f64>>,
    /// x = γ·I_cal(T) of each level, in counts; null leaves the level out. Absent: from the plate temperatures.
    #[serde(default)]
    pub x_counts: Vec<Option<f64>>,
    /// Transmittance of a window; both are taken alike.
    pub gamma: f64,
    /// Emissivity of the plate.
    #[serde(rename = "eps_B")]
    pub emissivity_plate: f64,
    /// Samples from this count on are saturated.
    pub saturation_count: u16,
    /// Curve of the camera; without one a fit needs a file.
    #[serde(default)]
    pub calibration: Option<CaseCurve>,
    /// Blanks of each spray frame: `nospray.npy` has them in the order of the spray frames; absent = 1.
    #[serde(default)]
    pub blanks_per_spray: Option<u16>,
    /// The far window's own light and what it mirrors, in counts; absent = 0.
    #[serde(default)]
    pub far_window_counts: f64,
    /// The camera's noise; absent = rounding only.
    #[serde(default)]
    pub camera: Option<CameraNoise>,
    /// Score below which a shot is taken for a misfire, 0 … 0.9 of an ordinary one; absent = 0.2.
    #[serde(default)]
    pub misfire_score: Option<f64>,
}

/// Why a stack could not be read.
#[derive(Debug, thiserror::Error)]
pub enum StackError {
    /// stack {path}: reading: {source}. Check that it is a folder with case.json, spray.npy and nospray.npy.
    #[error(
        "stack {path}: reading: {source}. Check that it is a folder with case.json, spray.npy and nospray.npy."
    )]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// stack {path}: {reason}.
    #[error("stack {path}: {reason}.")]
    Case {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// stack: frames: {0}
    #[error("stack: frames: {0}")]
    Frames(#[from] NpyError),
    /// stack {path}: {reason}. Frames are missing or case.json belongs to others.
    #[error("stack {path}: {reason}. Frames are missing or case.json belongs to others.")]
    Shape {
        /// The folder.
        path: PathBuf,
        /// What does not fit.
        reason: String,
    },
    /// stack: summing: {0}
    #[error("stack: summing: {0}")]
    Sums(#[from] AccumulateError),
}

/// A cycle that was left out of the map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rejected {
    /// Cycle within its level, from 0.
    pub cycle: usize,
    /// Why.
    pub reason: &'static str,
    /// Its score: 1 for an ordinary shot, 0 for none.
    pub score: f64,
}

/// Samples of a cycle that were left out pixel by pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Spikes {
    /// Cycle within its level, from 0.
    pub cycle: usize,
    /// Pixels in which it was left out.
    pub pixels: u32,
}

/// What became of one level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LevelSummary {
    /// Plate temperature, in K.
    pub plate_temperature_k: Option<f64>,
    /// x, in counts; null = left out.
    pub x_counts: Option<f64>,
    /// Cycles in the stack.
    pub cycles: usize,
    /// Cycles in the map.
    pub accepted: usize,
    /// Cycles left out as a whole.
    pub rejected: Vec<Rejected>,
    /// Spikes taken out, per cycle that has any.
    pub spikes: Vec<Spikes>,
    /// Samples taken out as spikes, over all pixels.
    pub spike_samples: u64,
    /// Cycles in which at least one pixel was saturated.
    pub cycles_with_saturation: usize,
    /// Samples left out because of saturation, over all pixels and accepted cycles.
    pub saturated_samples: u64,
}

/// A fitted stack.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The map.
    pub map: DitMap,
    /// Its levels.
    pub levels: Vec<LevelSummary>,
}

/// A stack that is ready to be summed.
#[derive(Debug)]
pub struct Stack {
    dir: PathBuf,
    /// What `case.json` says.
    pub case: Case,
    spray: FrameReader,
    blank: FrameReader,
}

impl Stack {
    /// Opens a stack and checks that its parts belong together.
    ///
    /// # Errors
    ///
    /// When a file is missing, cannot be understood, or the number and shape of frames do not fit `case.json`.
    pub fn open(dir: &Path) -> Result<Self, StackError> {
        let path = dir.join("case.json");
        let text =
            std::fs::read_to_string(&path).map_err(|source| StackError::Io { path: path.clone(), source })?;
        let case: Case = serde_json::from_str(&text)
            .map_err(|e| StackError::Case { path: path.clone(), reason: e.to_string() })?;
        check(&case).map_err(|reason| StackError::Case { path, reason })?;
        let spray = FrameReader::open(&dir.join("spray.npy"))?;
        let blank = FrameReader::open(&dir.join("nospray.npy"))?;
        let shape = |reader: &FrameReader| [reader.frames, reader.rows, reader.columns];
        let frames: usize = case.pairs_per_setpoint.iter().sum();
        let blanks = usize::from(case.blanks_per_spray());
        let [_, rows, columns] = shape(&spray);
        if spray.frames != frames || shape(&blank) != [frames * blanks, rows, columns] {
            let reason = format!(
                "spray.npy is {:?}, nospray.npy {:?}, case.json says {frames} pairs of {blanks} blanks",
                shape(&spray),
                shape(&blank)
            );
            return Err(StackError::Shape { path: dir.to_path_buf(), reason });
        }
        Ok(Self { dir: dir.to_path_buf(), case, spray, blank })
    }

    /// The folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Inputs of the fit as the case states them. Without a calibration of its own the curve is none: no temperature.
    pub fn inputs(&self, estimator: Estimator) -> FitInputs<'static> {
        let case = &self.case;
        let none = SakumaHattori { a_counts: f64::NAN, a_um: f64::NAN, b_um_k: f64::NAN };
        let curve = case.calibration.as_ref().map_or(none, CaseCurve::curve);
        FitInputs {
            x_counts: if case.x_counts.is_empty() {
                self.abscissae(|kelvin| curve.value(kelvin))
            } else {
                case.x_counts.clone()
            },
            gamma_near: case.gamma,
            gamma_far: case.gamma,
            emissivity_plate: case.emissivity_plate,
            far_window_counts: case.far_window_counts,
            curve,
            residual: None,
            range: None,
            camera: case.camera.unwrap_or(CameraNoise::ROUNDING_ONLY),
            estimator,
            confidence: map::CONFIDENCE,
            flat_gain: None,
        }
    }

    /// The same with another calibration: x is formed anew from the plate temperatures, with what a fitted curve leaves of the
    /// camera's behaviour, as temperatures are.
    pub fn inputs_with<'a>(&self, estimator: Estimator, calibration: &'a Calibration) -> FitInputs<'a> {
        let Calibration { curve, range, ref fit } = *calibration;
        let counts = |kelvin| fit.as_ref().map_or_else(|| curve.value(kelvin), |fit| fit.counts(kelvin));
        FitInputs {
            x_counts: self.abscissae(counts),
            curve,
            residual: fit.as_ref().and_then(|fit| fit.residual.as_ref()),
            range,
            ..self.inputs(estimator)
        }
    }

    /// x of the levels by the counts of a temperature in K; None for a level without a temperature, or that the case leaves out.
    fn abscissae(&self, counts: impl Fn(f64) -> f64) -> Vec<Option<f64>> {
        let case = &self.case;
        let left_out = |k: usize| !case.x_counts.is_empty() && case.x_counts[k].is_none();
        (0..case.pairs_per_setpoint.len())
            .map(|k| {
                let temperature = case.setpoints_k.get(k).copied().flatten()?;
                let x = case.gamma * counts(temperature);
                (!left_out(k) && x.is_finite()).then_some(x)
            })
            .collect()
    }

    /// Sums all pairs, for our own estimator takes misfires and spikes out again, and fits.
    ///
    /// # Errors
    ///
    /// When frames cannot be read or a level has too many.
    pub fn fit(&mut self, inputs: &FitInputs<'_>) -> Result<Fitted, StackError> {
        Ok(self.fit_keeping_sums(inputs)?.0)
    }

    /// As [`Self::fit`], with the sums that the map was made of.
    ///
    /// # Errors
    ///
    /// As [`Self::fit`].
    pub fn fit_keeping_sums(&mut self, inputs: &FitInputs<'_>) -> Result<(Fitted, Sums), StackError> {
        let mut levels = self.empty_summaries(inputs);
        let blanks = self.case.blanks_per_spray();
        let mut sums =
            Sums::new(levels.len(), self.spray.rows, self.spray.columns, blanks, self.case.saturation_count)?;
        let saturation = self.case.saturation_count;
        self.for_each_pair(|level, spray, blanks| {
            if spray.iter().chain(blanks.iter().copied().flatten()).any(|&count| count >= saturation) {
                levels[level].cycles_with_saturation += 1;
            }
            sums.add_cycle(level, blanks, spray)
        })?;
        if inputs.estimator == Estimator::Default {
            let left_out = accept::refine(&mut sums, inputs, self.case.misfire_score(), self)?;
            for (level, left_out) in levels.iter_mut().zip(&left_out) {
                level.leave_out(left_out);
            }
        }
        let mut map = map::solve(&sums, inputs);
        map.budget = Some(budget::statistical(&map));
        let pixels = sums.rows() * sums.columns();
        for (level, sums) in levels.iter_mut().zip(sums.levels()) {
            level.accepted = level.cycles - level.rejected.len();
            level.saturated_samples = (0..pixels).map(|i| u64::from(sums.saturated(i))).sum();
        }
        Ok((Fitted { map, levels }, sums))
    }

    /// The uncertainty budget of a map of this stack by a fitted curve: what the curve's covariance adds to the statistical
    /// parts. Of windows and plate a case states no uncertainty.
    ///
    /// Panics when map and sums do not belong together, which is the caller's mistake.
    pub fn budget(
        &self,
        map: &DitMap,
        sums: &Sums,
        inputs: &FitInputs<'_>,
        fit: &CalibrationFit,
    ) -> budget::Budget {
        let x_known = inputs.x_counts.iter().map(Option::is_some);
        let plates_k: Vec<Option<f64>> = x_known
            .enumerate()
            .map(|(k, known)| if known { self.case.setpoints_k.get(k).copied().flatten() } else { None })
            .collect();
        let setup = budget::Setup {
            fit,
            gamma_near: inputs.gamma_near,
            gamma_far: inputs.gamma_far,
            // A case knows no light of the window: nothing is mirrored, whatever the walls' temperature.
            reflectance_far: 0.0,
            wall_temperature_k: fit.range.low_k,
            emissivity_plate: inputs.emissivity_plate,
            plates_k: &plates_k,
            stated: budget::Stated::default(),
        };
        budget::budget(map, &map::crossing_shares(sums, inputs), &setup)
    }

    /// How the map settles with the number of pairs, at most 100 of a level; see [`convergence`].
    ///
    /// # Errors
    ///
    /// As [`Self::fit`].
    pub fn convergence(
        &mut self,
        inputs: &FitInputs<'_>,
        emissivity_min: f64,
    ) -> Result<Vec<Step>, StackError> {
        let levels = self.case.pairs_per_setpoint.len();
        let (rows, columns) = (self.spray.rows, self.spray.columns);
        let blanks = self.case.blanks_per_spray();
        let like = Sums::new(levels, rows, columns, blanks, self.case.saturation_count)?;
        convergence::convergence(&like, inputs, emissivity_min, STEPS_MAX, self)
    }

    fn empty_summaries(&self, inputs: &FitInputs<'_>) -> Vec<LevelSummary> {
        let cycles = self.case.pairs_per_setpoint.iter();
        cycles
            .enumerate()
            .map(|(k, &cycles)| LevelSummary {
                plate_temperature_k: self.case.setpoints_k.get(k).copied().flatten(),
                x_counts: inputs.x_counts[k],
                cycles,
                accepted: cycles,
                rejected: Vec::new(),
                spikes: Vec::new(),
                spike_samples: 0,
                cycles_with_saturation: 0,
                saturated_samples: 0,
            })
            .collect()
    }

    /// Calls `visit(level, spray, blanks)` for every cycle in order.
    fn for_each_pair(
        &mut self,
        mut visit: impl FnMut(usize, &[u16], &[&[u16]]) -> Result<(), AccumulateError>,
    ) -> Result<(), StackError> {
        self.spray.go_to(0)?;
        self.blank.go_to(0)?;
        let mut frames = self.frames();
        for (level, cycles) in self.case.pairs_per_setpoint.clone().into_iter().enumerate() {
            for _ in 0..cycles {
                self.next(&mut frames)?;
                visit(level, &frames.spray, &frames.blanks())?;
            }
        }
        Ok(())
    }

    /// Room for the frames of a cycle.
    fn frames(&self) -> Frames {
        let pixels = self.spray.rows * self.spray.columns;
        let blank = vec![0; pixels * usize::from(self.case.blanks_per_spray())];
        Frames { spray: vec![0; pixels], blank, pixels }
    }

    /// Reads the next cycle.
    fn next(&mut self, frames: &mut Frames) -> Result<(), StackError> {
        self.spray.next_into(&mut frames.spray)?;
        // Frames of no pixels have nothing to read.
        for blank in frames.blank.chunks_mut(frames.pixels.max(1)) {
            self.blank.next_into(blank)?;
        }
        Ok(())
    }
}

/// The frames of one cycle.
struct Frames {
    spray: Vec<u16>,
    blank: Vec<u16>,
    pixels: usize,
}

impl Frames {
    fn blanks(&self) -> Vec<&[u16]> {
        if self.pixels == 0 { vec![&[]] } else { self.blank.chunks(self.pixels).collect() }
    }
}

impl Recorded for Stack {
    type Error = StackError;

    fn cycles(&self, level: usize) -> usize {
        self.case.pairs_per_setpoint[level]
    }

    fn one(&mut self, level: usize, cycle: usize, visit: &mut Visitor<'_>) -> Result<(), StackError> {
        let at = self.case.pairs_per_setpoint[..level].iter().sum::<usize>() + cycle;
        self.spray.go_to(at)?;
        self.blank.go_to(at * usize::from(self.case.blanks_per_spray()))?;
        let mut frames = self.frames();
        self.next(&mut frames)?;
        visit(cycle, &frames.blanks(), &frames.spray);
        Ok(())
    }
}

impl Case {
    /// Score below which a shot is a misfire.
    pub fn misfire_score(&self) -> f64 {
        self.misfire_score.unwrap_or(gate::SCORE_MIN)
    }

    /// Blanks of each spray frame.
    pub fn blanks_per_spray(&self) -> u16 {
        self.blanks_per_spray.unwrap_or(1)
    }
}

impl LevelSummary {
    fn leave_out(&mut self, left_out: &LeftOut) {
        self.rejected = left_out
            .misfires
            .iter()
            .map(|misfire| Rejected {
                cycle: misfire.cycle,
                reason: "misfire: no spray in the frame",
                score: misfire.score,
            })
            .collect();
        let some = left_out.spikes.iter().enumerate().filter(|(_, pixels)| **pixels > 0);
        self.spikes = some.map(|(cycle, &pixels)| Spikes { cycle, pixels }).collect();
        self.spike_samples = left_out.spikes.iter().map(|&pixels| u64::from(pixels)).sum();
    }
}

fn check(case: &Case) -> Result<(), String> {
    let levels = case.pairs_per_setpoint.len();
    let positive = |name: &str, value: f64| {
        if value.is_finite() && value > 0.0 { Ok(()) } else { Err(format!("{name} must be positive")) }
    };
    positive("gamma", case.gamma)?;
    positive("eps_B", case.emissivity_plate)?;
    if let Some(curve) = &case.calibration {
        positive("calibration.A", curve.a_counts)?;
        positive("calibration.a_um", curve.a_um)?;
        if let Some(c2) = curve.c2_um_k {
            positive("calibration.c2_um_K", c2)?;
        }
    }
    if !(1..=BLANKS_MAX).contains(&case.blanks_per_spray()) {
        return Err(format!("blanks_per_spray must be from 1 to {BLANKS_MAX}"));
    }
    if case.misfire_score.is_some_and(|score| !(0.0..=0.9).contains(&score)) {
        return Err("misfire_score must be from 0 to 0.9".into());
    }
    if case.x_counts.len() != levels && !case.x_counts.is_empty() {
        return Err(format!("x_counts has {} entries for {levels} levels", case.x_counts.len()));
    }
    if levels > map::LEVELS_MAX {
        return Err(format!("{levels} levels, at most {} are possible", map::LEVELS_MAX));
    }
    Ok(())
}

/// A curve from a file, with the range it was calibrated in if the file says so.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The curve.
    pub curve: SakumaHattori,
    /// Where it is calibrated.
    pub range: Option<Range>,
    /// The fit that it comes from, with its covariance; None for bare parameters.
    pub fit: Option<CalibrationFit>,
}

impl Calibration {
    /// Reads `calibration.json` of a run folder, or a file with `A`, `a_um`, `b_um_K` (bare or under `calibration`).
    ///
    /// # Errors
    ///
    /// When the file cannot be read or holds no curve.
    pub fn read(path: &Path) -> Result<Self, StackError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| StackError::Io { path: path.to_path_buf(), source })?;
        if let Ok(fit) = serde_json::from_str::<CalibrationFit>(&text) {
            return Ok(Self { curve: fit.curve, range: Some(fit.range), fit: Some(fit) });
        }
        #[derive(Deserialize)]
        struct Inside {
            calibration: CaseCurve,
        }
        let bare = serde_json::from_str::<CaseCurve>(&text);
        let curve = bare.or_else(|_| serde_json::from_str::<Inside>(&text).map(|inside| inside.calibration));
        curve.map(|c| Self { curve: c.curve(), range: None, fit: None }).map_err(|_| StackError::Case {
            path: path.to_path_buf(),
            reason: "holds no calibration curve: neither a fitted one nor A, a_um and b_um_K".into(),
        })
    }
}
