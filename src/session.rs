//! One run from config to result folder: calibration, campaign, map, truth, report. And the same again from a folder.

mod kinds;

pub use kinds::{Ask, Figure, acquire_figure};

use crate::archive::Archive;
use crate::calibrate::{self, CalibrateError, Calibrated, Calibration, Figures};
use crate::campaign::{
    CampaignError, Ended, Engine, Origins, Outcome, Progress, RecordError, Recorder, StopFlag, header,
};
use crate::clock::Clock;
use crate::config::{Config, ConfigError};
use crate::console::Console;
use crate::estimate::convergence::Step;
use crate::estimate::map::Estimator;
use crate::estimate::mask::Limits;
use crate::fitting;
use crate::journal::{self, Entry, JournalError, Record};
use crate::plan::Plan;
use crate::reduce::{ReduceError, Reduced, Total};
use crate::result::{self, ResultError};
use crate::rigs::{self, Beginning, OpenError, Prepared, View};
use crate::run_folder::{FolderError, RunFolder, sha256};
use crate::samples::Source;
use ditd_drivers::error::DriverError;
use std::path::{Component, Path, PathBuf};

/// Why a session ended without its result.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The campaign file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The rig could not be opened or built.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The campaign.
    #[error("{error}{}", unsafe_words(.unsafe_because))]
    Campaign {
        /// What went wrong.
        error: Box<CampaignError>,
        /// What could not be made safe.
        unsafe_because: Vec<DriverError>,
    },
    /// The operator stopped it at once.
    #[error("stopped; {}", safe_words(.0))]
    Stopped(Vec<DriverError>),
    /// The operator paused it.
    #[error("paused; go on with `ditd resume {}`", .0.display())]
    Paused(PathBuf),
    /// The safe state could not be confirmed.
    #[error("the safe state could not be confirmed: {} Switch the rig off by hand.", list(.0))]
    Unsafe(Vec<DriverError>),
    /// Instruments that could not be reached or made safe; the others are safe.
    #[error("the safe state could not be confirmed: {}. Switch what is named here off by hand.", words(.0))]
    NotSafe(Vec<OpenError>),
    /// The run folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The record.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The journal.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The records contradict each other.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// The calibration.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
    /// The result's files.
    #[error(transparent)]
    Result(#[from] ResultError),
    /// Something else that the message explains.
    #[error("{0}")]
    Other(String),
}

fn list(errors: &[DriverError]) -> String {
    errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

fn words(errors: &[OpenError]) -> String {
    errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

fn safe_words(errors: &[DriverError]) -> String {
    if errors.is_empty() { "the rig is in its safe state".to_owned() } else { unsafe_words(errors) }
}

fn unsafe_words(errors: &[DriverError]) -> String {
    if errors.is_empty() {
        String::new()
    } else {
        format!(" THE SAFE STATE COULD NOT BE CONFIRMED: {}. Switch the rig off by hand.", list(errors))
    }
}

impl SessionError {
    /// The process's exit status that stands for it.
    pub fn code(&self) -> u8 {
        match self {
            Self::Config(_) => 2,
            Self::Open(error) => error.code(),
            Self::Campaign { error, .. } => error.code(),
            Self::Stopped(_) => 130,
            Self::Paused(_) => 6,
            Self::Unsafe(_) => 4,
            Self::NotSafe(errors) => errors.first().map_or(4, OpenError::code),
            Self::Journal(JournalError::Damaged { .. }) | Self::Reduce(_) => 5,
            Self::Calibrate(CalibrateError::Key { .. }) => 2,
            Self::Folder(_)
            | Self::Record(_)
            | Self::Journal(_)
            | Self::Calibrate(_)
            | Self::Result(_)
            | Self::Other(_) => 1,
        }
    }
}

/// What a session is told.
#[derive(Debug, Clone)]
pub struct Setting<'a> {
    /// The campaign file's text and folder.
    pub source: &'a Source,
    /// The campaign file.
    pub config: &'a Config,
    /// The wall clock.
    pub clock: Clock,
    /// The operator's wish.
    pub stop: StopFlag,
}

impl Setting<'_> {
    /// UTC at the start of the campaign's clock.
    fn utc(&self) -> String {
        if self.config.is_simulated() { self.config.campaign.epoch.clone() } else { self.clock.utc() }
    }
}

/// Runs a campaign and leaves a run folder; returns the text of its summary.
///
/// # Errors
///
/// [`SessionError`]; the rig is then in its safe state unless the error says otherwise.
pub fn run(setting: &Setting<'_>, out: &Path) -> Result<String, SessionError> {
    let own = rigs::own_files(setting.config, &setting.source.folder)?;
    let folder = RunFolder::create(out)?;
    // Fuels and windows of the user's own go along, so that `resume` finds them where the campaign file says. Files
    // that are not below the campaign file's folder stay where they are.
    for (path, text) in own.iter().filter(|file| is_below(&file.0)) {
        folder.write(&folder.root().join(path), text.as_bytes())?;
    }
    folder.write(&folder.campaign(), setting.source.text.as_bytes())?;
    begin(setting, &folder)
}

/// Whether a relative path never leaves its folder.
fn is_below(path: &Path) -> bool {
    path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
}

/// Calibration and campaign in a folder that holds only its campaign file.
fn begin(setting: &Setting<'_>, folder: &RunFolder) -> Result<String, SessionError> {
    let calibrated = obtain_calibration(setting, folder)?;
    let plan = Plan::of_map(setting.config);
    let c = &setting.config.camera;
    let reduced = Reduced::new(plan.clone(), c.rows, c.columns, c.saturation_count)?;
    let prepared = prepare(setting, View::Chamber)?;
    let mut recorder = recorder(setting, folder, reduced)?;
    let start = header(&plan, setting.utc(), sha256(setting.source.text.as_bytes()));
    let engine = campaign(setting, &plan, &prepared, &mut recorder, Some(start), Some(&calibrated))?;
    finish(setting, folder, &prepared, recorder.reduced(), &calibrated, &engine)
}

/// Goes on with a run that was paused or killed.
///
/// # Errors
///
/// [`SessionError`], as [`run`].
pub fn resume(root: &Path, clock: Clock, stop: StopFlag) -> Result<String, SessionError> {
    let folder = RunFolder::at(root);
    let (source, config) = config_of(&folder)?;
    let setting = Setting { source: &source, config: &config, clock, stop };
    if !folder.journal().exists() {
        // It ended during the calibration. What was recorded is kept aside; a curve is taken in one go.
        set_aside(&folder.calibration())?;
        return begin(&setting, &folder);
    }
    let calibrated = load_calibration(&folder.calibration(), &config)?;
    let plan = Plan::of_map(&config);
    let c = &config.camera;
    let reduced = Reduced::new(plan.clone(), c.rows, c.columns, c.saturation_count)?;
    let mut archive = Archive::new(folder.root(), c.rows * c.columns);
    let (mut recorder, entries) = Recorder::reopen(folder.root(), reduced, c.rows, c.columns, &mut archive)?;
    check_config(&entries, &source)?;
    let begins = Beginning {
        elapsed_ns: entries.last().map_or(0, |entry| entry.t_ns),
        frames: recorder.reduced().frames_seen,
        injections: recorder.reduced().injections_seen,
        resumed: true,
    };
    let prepared = prepare(&setting, View::Chamber)?.beginning_at(begins);
    let engine = campaign(&setting, &plan, &prepared, &mut recorder, None, Some(&calibrated))?;
    finish(&setting, &folder, &prepared, recorder.reduced(), &calibrated, &engine)
}

/// Acquires the standard curve into a folder of its own.
///
/// # Errors
///
/// [`SessionError`], as [`run`].
pub fn calibrate(setting: &Setting<'_>, out: &Path) -> Result<Calibrated, SessionError> {
    acquire(setting, out, None)
}

/// Acquires today's curve and maps it on the standard one at `standard` (a folder or its `calibration.json`).
///
/// # Errors
///
/// [`SessionError`], as [`run`]; also when the standard curve cannot be read or belongs to another camera.
pub fn calibrate_today(
    setting: &Setting<'_>,
    out: &Path,
    standard: &Path,
) -> Result<Calibrated, SessionError> {
    let standard = curve_at(&calibration_folder(standard))?;
    acquire(setting, out, Some(&standard))
}

fn acquire(
    setting: &Setting<'_>,
    out: &Path,
    standard: Option<&Calibration>,
) -> Result<Calibrated, SessionError> {
    let plan = Plan::of_standard_curve(setting.config).ok_or_else(no_table)?;
    let earlier = file_at(out)?;
    if let Some(file) = &earlier {
        file.key.check(setting.config)?;
    }
    let reduced = frames_into(setting, out, setting.config, View::Bench, plan, 0)?;
    let mut calibrated = calibration_of(&reduced, setting.config, &setting.utc())?;
    if let Some(standard) = standard {
        calibrated.calibration = calibrate::today(&calibrated.calibration, standard)?;
    }
    // What was measured before of the same set-up stays; the flat is the new one.
    if let Some(file) = earlier {
        let flat = calibrated.calibration.figures.flat.take();
        calibrated.calibration.figures = Figures { flat, ..file.figures };
    }
    let folder = RunFolder::at(out);
    store_calibration(&folder, &folder.root().join("calibration.json"), &calibrated, setting.config)?;
    Ok(calibrated)
}

fn no_table() -> SessionError {
    SessionError::Other("calibrate: the campaign file has no [calibration] table".to_owned())
}

/// Runs a plan of the plate without injector into a folder of its own. `world` is the campaign file as the simulated rig is
/// to be for it; `part` tells its frames from those of other parts of a calibration.
fn frames_into(
    setting: &Setting<'_>,
    out: &Path,
    world: &Config,
    view: View,
    plan: Plan,
    part: u64,
) -> Result<Reduced, SessionError> {
    let folder = RunFolder::create(out)?;
    folder.write(&folder.campaign(), setting.source.text.as_bytes())?;
    let c = &setting.config.camera;
    let reduced = Reduced::new(plan.clone(), c.rows, c.columns, c.saturation_count)?;
    let prepared = prepare(&Setting { config: world, ..setting.clone() }, view)?;
    let frames = match (view, part) {
        (View::Bench, 0) => prepared.beginning().frames,
        _ => rigs::FIRST_CALIBRATION_FRAME + (part + 1) * FRAMES_PART,
    };
    let prepared = prepared.beginning_at(Beginning { frames, ..Beginning::default() });
    let mut recorder = recorder(setting, &folder, reduced)?;
    let start = header(&plan, setting.utc(), sha256(setting.source.text.as_bytes()));
    campaign(setting, &plan, &prepared, &mut recorder, Some(start), None)?;
    Ok(recorder.reduced().clone())
}

/// Numbers between the frames of two parts of a simulated calibration: more than any part has.
const FRAMES_PART: u64 = 1 << 24;

/// Brings a rig to its safe state.
///
/// # Errors
///
/// [`SessionError::Unsafe`] when an instrument could not be reached.
pub fn make_safe(setting: &Setting<'_>) -> Result<(), SessionError> {
    let prepared = rigs::without_world(setting.config);
    let runtime = prepared.runtime().map_err(SessionError::Other)?;
    let trouble = runtime.block_on(prepared.make_safe());
    if trouble.is_empty() { Ok(()) } else { Err(SessionError::NotSafe(trouble)) }
}

/// Folds a recorded run again and writes its result to `out`; returns the reduced run.
///
/// # Errors
///
/// [`SessionError`] when the folder is damaged.
pub fn replay(root: &Path, out: &Path, estimator: Option<Estimator>) -> Result<String, SessionError> {
    let folder = RunFolder::at(root);
    let (source, config) = config_of(&folder)?;
    let calibrated = load_calibration(&folder.calibration(), &config)?;
    refit(&folder, &source, &config, &calibrated, out, estimator)
}

/// What a refit may do otherwise than the campaign file says.
#[derive(Debug, Clone, Copy)]
pub struct Wishes<'a> {
    /// A calibration from elsewhere; None takes the recorded one.
    pub calibration: Option<&'a Path>,
    /// How to weight; None as the campaign file says.
    pub estimator: Option<Estimator>,
    /// What to mask, over what the campaign file says.
    pub limits: Limits,
}

/// As [`replay`], with wishes.
///
/// # Errors
///
/// [`SessionError`] when the folder or the calibration is damaged or does not belong to the camera's settings.
pub fn refit_as(root: &Path, out: &Path, wishes: &Wishes<'_>) -> Result<String, SessionError> {
    let folder = RunFolder::at(root);
    let (source, mut config) = config_of(&folder)?;
    let given = wishes.calibration.map_or_else(|| folder.calibration(), calibration_folder);
    let calibrated = load_calibration(&given, &config)?;
    let limits = wishes.limits.or(config.fit.limits());
    config.fit.mask_emissivity_below = limits.emissivity_below;
    config.fit.mask_sigma_above_k = limits.sigma_above_k;
    refit(&folder, &source, &config, &calibrated, out, wishes.estimator)
}

/// A recorded run as its final map rests on it.
#[derive(Debug)]
pub struct Final {
    /// The campaign file.
    pub config: Config,
    /// The calibration used.
    pub calibrated: Calibrated,
    /// The records, without what was left out.
    pub reduced: Reduced,
    /// The estimator asked for, or the campaign file's.
    pub estimator: Estimator,
}

/// Folds a recorded run again, for looking at.
///
/// # Errors
///
/// [`SessionError`] when the folder or the calibration is damaged.
pub fn last_state(
    root: &Path,
    calibration: Option<&Path>,
    estimator: Option<Estimator>,
) -> Result<Final, SessionError> {
    let folder = RunFolder::at(root);
    let (source, config) = config_of(&folder)?;
    let given = calibration.map_or_else(|| folder.calibration(), calibration_folder);
    let calibrated = load_calibration(&given, &config)?;
    let (reduced, estimator) = final_state(&folder, &source, &config, &calibrated, estimator)?;
    Ok(Final { config, calibrated, reduced, estimator })
}

fn final_state(
    folder: &RunFolder,
    source: &Source,
    config: &Config,
    calibrated: &Calibrated,
    estimator: Option<Estimator>,
) -> Result<(Reduced, Estimator), SessionError> {
    let entries = journal::read(&folder.journal())?;
    check_config(&entries, source)?;
    let c = &config.camera;
    let mut reduced = Reduced::new(Plan::of_map(config), c.rows, c.columns, c.saturation_count)?;
    let mut archive = Archive::new(folder.root(), c.rows * c.columns);
    for entry in &entries {
        reduced.apply(&entry.record, &mut archive)?;
    }
    let estimator =
        estimator.or_else(|| fitting::estimator(&config.fit.estimator)).unwrap_or(Estimator::Default);
    let reduced = fitting::final_state(&reduced, config, calibrated, estimator, &mut archive)?;
    Ok((reduced, estimator))
}

fn refit(
    folder: &RunFolder,
    source: &Source,
    config: &Config,
    calibrated: &Calibrated,
    out: &Path,
    estimator: Option<Estimator>,
) -> Result<String, SessionError> {
    let (reduced, estimator) = final_state(folder, source, config, calibrated, estimator)?;
    let truth = result::read_world(&folder.world())?;
    Ok(result::write(
        out,
        &reduced,
        config,
        calibrated,
        estimator,
        truth.as_ref(),
        &result::read_telemetry(folder.root()),
    )?)
}

/// How the map of a recorded run settles with the number of cycles.
///
/// # Errors
///
/// [`SessionError`] when the folder or the calibration is damaged.
pub fn convergence(
    root: &Path,
    calibration: Option<&Path>,
    estimator: Estimator,
) -> Result<Vec<Step>, SessionError> {
    let folder = RunFolder::at(root);
    let (source, config) = config_of(&folder)?;
    let given = calibration.map_or_else(|| folder.calibration(), calibration_folder);
    let calibrated = load_calibration(&given, &config)?;
    let entries = journal::read(&folder.journal())?;
    check_config(&entries, &source)?;
    let c = &config.camera;
    let mut reduced = Reduced::new(Plan::of_map(&config), c.rows, c.columns, c.saturation_count)?;
    let mut archive = Archive::new(folder.root(), c.rows * c.columns);
    for entry in &entries {
        reduced.apply(&entry.record, &mut archive)?;
    }
    let inputs =
        fitting::inputs(&reduced.levels, &config, &calibrated.calibration, &calibrated.flat, estimator);
    Ok(reduced.convergence(&inputs, config.emissivity_min(), &mut archive)?)
}

/// Acquires or copies the calibration into the run folder.
fn obtain_calibration(setting: &Setting<'_>, folder: &RunFolder) -> Result<Calibrated, SessionError> {
    if setting.config.optics.calibration == "measure" {
        return calibrate(setting, &folder.calibration()).map_err(|error| match error {
            SessionError::Paused(_) => SessionError::Paused(folder.root().to_owned()),
            other => other,
        });
    }
    let given = calibration_folder(&setting.source.folder.join(&setting.config.optics.calibration));
    let calibrated = load_calibration(&given, setting.config)?;
    let target = RunFolder::at(&folder.calibration());
    store_calibration(&target, &folder.calibration().join("calibration.json"), &calibrated, setting.config)?;
    Ok(calibrated)
}

/// Renames an unfinished folder to the first free `NAME.unfinished-N`.
fn set_aside(unfinished: &Path) -> Result<(), SessionError> {
    if !unfinished.exists() {
        return Ok(());
    }
    let name = unfinished.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let free = (1..=ASIDE_MAX)
        .map(|n| unfinished.with_file_name(format!("{name}.unfinished-{n}")))
        .find(|candidate| !candidate.exists());
    let target = free.ok_or_else(|| {
        SessionError::Other(format!(
            "{}: {ASIDE_MAX} unfinished ones lie there already",
            unfinished.display()
        ))
    })?;
    std::fs::rename(unfinished, &target)
        .map_err(|error| SessionError::Other(format!("{}: {error}", unfinished.display())))
}

/// Unfinished calibrations that are kept in one run folder.
const ASIDE_MAX: u32 = 100;

/// The folder that a path to a calibration folder or to its `calibration.json` means.
fn calibration_folder(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|extension| extension == "json") {
        path.parent().map(Path::to_owned).unwrap_or_default()
    } else {
        path.to_owned()
    }
}

fn calibration_of(reduced: &Reduced, config: &Config, utc: &str) -> Result<Calibrated, SessionError> {
    let Total::Curve(sums) = &reduced.total else {
        return Err(SessionError::Other("calibration: the record holds no calibration frames".to_owned()));
    };
    let series = calibrate::series(sums, &reduced.levels, config)?;
    let mut calibration = calibrate::standard(&series, config, utc)?;
    let flat = calibrate::flat(&series, sums, utc);
    calibration.figures.flat = Some(flat.figures);
    Ok(Calibrated { calibration, flat: flat.gains })
}

fn store_calibration(
    folder: &RunFolder,
    path: &Path,
    calibrated: &Calibrated,
    config: &Config,
) -> Result<(), SessionError> {
    let mut text = serde_json::to_string_pretty(&calibrated.calibration)
        .map_err(|error| SessionError::Other(format!("calibration: {error}")))?;
    text.push('\n');
    folder.write(path, text.as_bytes())?;
    store_flat(path.parent().unwrap_or(folder.root()), &calibrated.flat, config)
}

/// Writes the gains of all pixels beside a calibration.
fn store_flat(out: &Path, gains: &[f64], config: &Config) -> Result<(), SessionError> {
    let shape = vec![config.camera.rows, config.camera.columns];
    let flat = crate::files::npy::Array { shape, values: crate::files::npy::Values::F64(gains.to_vec()) };
    Ok(RunFolder::at(out).write(&out.join("flat.npy"), &flat.to_bytes())?)
}

/// Writes one figure into the `calibration.json` of `out`, which is made if there is none; the rest of it stays.
fn store_figure(
    setting: &Setting<'_>,
    out: &Path,
    name: &str,
    figure: serde_json::Value,
) -> Result<(), SessionError> {
    let path = out.join("calibration.json");
    let new = || serde_json::json!({ "schema": 1, "utc": setting.utc(), "key": calibrate::Key::of(setting.config) });
    let mut file = match read_json(&path)? {
        Some(file) => file,
        None => new(),
    };
    file[name] = figure;
    crate::files::result::write_atomic(&path, format!("{file:#}\n").as_bytes())
        .map_err(|error| SessionError::Other(error.to_string()))
}

/// What is known of a calibration folder without its curve.
struct CalibrationFile {
    key: calibrate::Key,
    figures: Figures,
    has_curve: bool,
}

/// The calibration file in a folder; `None` when there is none.
fn file_at(folder: &Path) -> Result<Option<CalibrationFile>, SessionError> {
    let path = folder.join("calibration.json");
    let Some(file) = read_json(&path)? else { return Ok(None) };
    let bad =
        |error: serde_json::Error| SessionError::Other(format!("calibration {}: {error}", path.display()));
    Ok(Some(CalibrationFile {
        key: serde_json::from_value(file["key"].clone()).map_err(bad)?,
        has_curve: file.get("fit").is_some(),
        figures: serde_json::from_value(file).map_err(bad)?,
    }))
}

/// A JSON object from a file; `None` when there is no file.
fn read_json(path: &Path) -> Result<Option<serde_json::Value>, SessionError> {
    let named = |why: String| SessionError::Other(format!("calibration {}: {why}", path.display()));
    let text = match std::fs::read_to_string(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        text => text.map_err(|error| named(error.to_string()))?,
    };
    let file: serde_json::Value = serde_json::from_str(&text).map_err(|error| named(error.to_string()))?;
    if file.is_object() { Ok(Some(file)) } else { Err(named("it is no JSON object".to_owned())) }
}

/// The curve of a calibration folder.
fn curve_at(folder: &Path) -> Result<Calibration, SessionError> {
    let path = folder.join("calibration.json");
    let named = |why: &str| SessionError::Other(format!("calibration {}: {why}", path.display()));
    let file = read_json(&path)?.ok_or_else(|| named("there is no such file"))?;
    if file.get("fit").is_none() {
        return Err(named(
            "it holds no curve yet. Acquire one into the same folder: ditd calibrate CONFIG --kind standard",
        ));
    }
    serde_json::from_value(file).map_err(|error| named(&error.to_string()))
}

fn load_calibration(folder: &Path, config: &Config) -> Result<Calibrated, SessionError> {
    let calibration = curve_at(folder)?;
    calibration.key.check(config)?;
    let path = folder.join("flat.npy");
    let flat =
        crate::files::npy::read(&path).map_err(|error| SessionError::Other(error.to_string()))?.to_f64();
    if flat.len() != config.camera.rows * config.camera.columns {
        return Err(SessionError::Other(format!(
            "{}: the flat has another size than the frames",
            path.display()
        )));
    }
    Ok(Calibrated { calibration, flat })
}

fn config_of(folder: &RunFolder) -> Result<(Source, Config), SessionError> {
    let path = folder.campaign();
    let text = std::fs::read_to_string(&path).map_err(|error| {
        SessionError::Other(format!("{}: {error}. Is this a run folder?", path.display()))
    })?;
    let name = path.display().to_string();
    let config = Config::parse(&name, &text)?;
    Ok((Source { name, text, folder: folder.root().to_owned() }, config))
}

/// The journal belongs to the campaign file beside it.
fn check_config(entries: &[Entry], source: &Source) -> Result<(), SessionError> {
    let stated = entries.iter().find_map(|entry| match &entry.record {
        Record::Start { config_sha256, .. } => Some(config_sha256),
        _ => None,
    });
    let found = sha256(source.text.as_bytes());
    match stated {
        Some(stated) if *stated == found => Ok(()),
        Some(_) => Err(SessionError::Reduce(ReduceError(format!(
            "{} is not the file with which the run was made",
            source.name
        )))),
        None => Err(SessionError::Reduce(ReduceError("the journal has no beginning".to_owned()))),
    }
}

fn prepare(setting: &Setting<'_>, view: View) -> Result<Prepared, SessionError> {
    let console = Console::new("rendering");
    let prepared = rigs::prepare(setting.config, view, &setting.source.folder, &|text, done| {
        console.fraction(text, done)
    });
    console.finish();
    Ok(prepared?)
}

/// A new record; on a simulated rig it does not wait for the disk.
fn recorder(setting: &Setting<'_>, folder: &RunFolder, reduced: Reduced) -> Result<Recorder, SessionError> {
    let c = &setting.config.camera;
    let recorder = Recorder::create(folder.root(), reduced, c.rows, c.columns)?;
    Ok(if setting.config.is_simulated() { recorder.without_waiting() } else { recorder })
}

/// Runs a plan on the prepared rig, in virtual or real time; an early end becomes an error.
fn campaign(
    setting: &Setting<'_>,
    plan: &Plan,
    prepared: &Prepared,
    recorder: &mut Recorder,
    start: Option<Record>,
    calibrated: Option<&Calibrated>,
) -> Result<Virtual, SessionError> {
    let title = if calibrated.is_some() { "campaign" } else { "calibration" };
    let mut live = Live { console: Console::new(title), config: setting.config, calibrated };
    let runtime = prepared.runtime().map_err(SessionError::Other)?;
    let (outcome, elapsed_s) = runtime.block_on(async {
        let mut opened = prepared.open().await?;
        let started = tokio::time::Instant::now();
        let engine = Engine {
            config: setting.config,
            plan,
            instruments: &mut opened.instruments,
            recorder,
            progress: &mut live,
            stop: setting.stop.clone(),
            started,
            elapsed_before_ns: prepared.beginning().elapsed_ns,
            // Another process may have injected just before this one began.
            last_injection: prepared.beginning().resumed.then_some(started),
            origins: Origins::default(),
        };
        let outcome = Box::pin(engine.run(start)).await;
        Ok::<_, OpenError>((outcome, started.elapsed().as_secs_f64()))
    })?;
    live.console.finish();
    prepared.keep_surface(recorder.folder())?;
    let Outcome { ended, unsafe_because, .. } = outcome;
    match ended {
        Err(error) => Err(SessionError::Campaign { error: Box::new(error), unsafe_because }),
        Ok(Ended::Stopped) => Err(SessionError::Stopped(unsafe_because)),
        Ok(_) if !unsafe_because.is_empty() => Err(SessionError::Unsafe(unsafe_because)),
        Ok(Ended::Paused) => Err(SessionError::Paused(recorder.folder().to_owned())),
        Ok(Ended::Done) => Ok(Virtual { seconds: elapsed_s }),
    }
}

/// The console, and after every level the map as far as it is known.
struct Live<'a> {
    console: Console,
    config: &'a Config,
    calibrated: Option<&'a Calibrated>,
}

impl Progress for Live<'_> {
    fn cycle(&mut self, done: u32, planned: u32, eta_s: f64) {
        self.console.cycle(done, planned, eta_s);
    }

    fn waiting(&mut self, reason: &str, eta_s: Option<f64>) {
        self.console.waiting(reason, eta_s);
    }

    fn note(&mut self, text: &str) {
        self.console.note(text);
    }

    fn level_done(&mut self, recorder: &Recorder) {
        self.console.level_done(recorder);
        if let Some(calibrated) = self.calibrated
            && let Some(words) = result::provisional(recorder.reduced(), self.config, calibrated)
        {
            self.console.line(&words);
        }
    }
}

/// Time on the campaign's clock.
struct Virtual {
    seconds: f64,
}

/// Map, truth, report, seal.
fn finish(
    setting: &Setting<'_>,
    folder: &RunFolder,
    prepared: &Prepared,
    reduced: &Reduced,
    calibrated: &Calibrated,
    campaign: &Virtual,
) -> Result<String, SessionError> {
    let config = setting.config;
    let estimator = fitting::estimator(&config.fit.estimator).unwrap_or(Estimator::Default);
    let console = Console::new("result");
    console.fraction("shots without spray, spikes", 0.1);
    let mut archive = Archive::new(folder.root(), config.camera.rows * config.camera.columns);
    let reduced = &fitting::final_state(reduced, config, calibrated, estimator, &mut archive)?;
    console.fraction("what the simulated world knows of itself", 0.3);
    if let Some(truth) = prepared.truth(reduced, config, folder.root())? {
        result::write_world(folder, &truth)?;
    }
    console.fraction("maps, pictures and report", 0.7);
    let truth = result::read_world(&folder.world())?;
    let telemetry = result::read_telemetry(folder.root());
    let summary =
        result::write(&folder.result(), reduced, config, calibrated, estimator, truth.as_ref(), &telemetry)?;
    console.finish();
    let machine = serde_json::json!({
        "wall_s": setting.clock.elapsed().as_secs_f64(),
        "campaign_s": campaign.seconds,
        "utc": setting.clock.utc(),
        "threads": rayon::current_num_threads(),
        "os": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
    });
    folder.write(&folder.root().join("machine.json"), format!("{machine:#}\n").as_bytes())?;
    folder.seal(&config.campaign.name, &setting.utc())?;
    Ok(format!(
        "{summary}time      {} of campaign in {:.1} s on this machine\nfolder    {}\n",
        crate::console::duration_words(campaign.seconds),
        setting.clock.elapsed().as_secs_f64(),
        folder.root().display()
    ))
}
