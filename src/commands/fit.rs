//! `ditd fit`: refits a run folder, a stack of recorded frames, or lines of known variances.

mod abel;
mod fitted;
mod pixel;
mod walls;

use super::{CommandError, CommandResult, print};
use crate::estimate::budget::Budget;
use crate::estimate::calibration::SakumaHattori;
use crate::estimate::convergence::Step;
use crate::estimate::line::Fieller;
use crate::estimate::map::{self, DitMap, Estimator};
use crate::estimate::mask::Limits;
use crate::files::{self, ResultMeta};
use crate::result::budget_of;
use crate::session;
use crate::stack::{Calibration, CaseCurve, Fitted, Stack, StackError};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Arguments of `ditd fit`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Run folder, stack folder (case.json, spray.npy, nospray.npy) or a JSON file of lines
    pub path: PathBuf,
    /// Where to write the map; needed for a stack
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// How the lines are weighted
    #[arg(long, value_enum, default_value = "default")]
    pub estimator: EstimatorName,
    /// Another calibration curve than the recorded one
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Also tell how the map settles with the number of cycles (OUT/convergence.csv)
    #[arg(long)]
    pub convergence: bool,
    #[command(flatten)]
    walls: walls::WallArgs,
    #[command(flatten)]
    abel: abel::AbelArgs,
    #[command(flatten)]
    masks: Masks,
    #[command(flatten)]
    pixel: pixel::PixelArgs,
    /// Print the summary as JSON
    #[arg(long)]
    pub json: bool,
}

/// What is flagged as not to be trusted; the numbers stay.
#[derive(Debug, Clone, Copy, clap::Args)]
struct Masks {
    /// Pixels of a smaller emissivity get the flag LOW_EMISSIVITY
    #[arg(long, value_name = "EPS", allow_negative_numbers = true)]
    mask_emissivity_below: Option<f64>,
    /// Pixels whose temperature has a larger standard deviation, K, or none, get the flag HIGH_SIGMA
    #[arg(long, value_name = "K")]
    mask_sigma_above_k: Option<f64>,
}

impl Masks {
    fn limits(&self) -> Limits {
        Limits { emissivity_below: self.mask_emissivity_below, sigma_above_k: self.mask_sigma_above_k }
    }
}

/// Names of the estimators on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum EstimatorName {
    /// Weights from a variance law fitted to pooled variances
    Default,
    /// The paper's weights
    Paper,
    /// All levels alike
    Ols,
}

impl From<EstimatorName> for Estimator {
    fn from(name: EstimatorName) -> Self {
        match name {
            EstimatorName::Default => Self::Default,
            EstimatorName::Paper => Self::Paper,
            EstimatorName::Ols => Self::Ols,
        }
    }
}

impl From<StackError> for CommandError {
    fn from(error: StackError) -> Self {
        let code = match &error {
            StackError::Io { .. } | StackError::Case { .. } => 2,
            StackError::Frames(_) | StackError::Shape { .. } => 5,
            StackError::Sums(_) => 1,
        };
        Self { code, message: error.to_string() }
    }
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for arguments or files that are not understood, 5 for frames that are missing, 1 for output that cannot be
/// written.
pub fn run(args: Args) -> CommandResult {
    let path = &args.path;
    if let Some(problem) = args.masks.limits().problem() {
        return Err(CommandError::usage(format!("fit: {problem}.")));
    }
    if path.is_file() {
        fit_lines(path)
    } else if path.join("journal.jsonl").exists() || path.join("campaign.toml").exists() {
        fit_run(&args)
    } else if path.join("case.json").exists() {
        fit_stack(&args)
    } else {
        Err(CommandError::usage(format!(
            "fit {}: neither a run folder (journal.jsonl), nor a stack (case.json), nor a file of lines. Check the path.",
            path.display()
        )))
    }
}

/// Refits a run folder from its journal and frames.
fn fit_run(args: &Args) -> CommandResult {
    if let (Some(at), None) = (args.pixel.pixel, &args.out) {
        return pixel::of_run(args, at);
    }
    let Some(out) = &args.out else {
        return Err(CommandError::usage(
            "fit: refitting a run needs --out DIR; the recorded result is never touched",
        ));
    };
    let wishes = session::Wishes {
        calibration: args.calibration.as_deref(),
        estimator: Some(args.estimator.into()),
        limits: args.masks.limits(),
    };
    let words = session::refit_as(&args.path, out, &wishes)?;
    let more = walls::correct(&args.walls, out)? + &abel::inverted(&args.abel, out)?;
    if args.convergence {
        let steps = session::convergence(&args.path, args.calibration.as_deref(), args.estimator.into())?;
        write_convergence(out, &steps)?;
    }
    if let Some(at) = args.pixel.pixel {
        return pixel::of_run(args, at);
    }
    if args.json {
        let path = out.join("summary.json");
        let text = std::fs::read_to_string(&path)
            .map_err(|error| CommandError::failure(format!("{}: {error}", path.display())))?;
        return print(&text);
    }
    print(&(words + &more))
}

fn fit_stack(args: &Args) -> CommandResult {
    if let (Some(at), None) = (args.pixel.pixel, &args.out) {
        return pixel::of_stack(args, at);
    }
    let Some(out) = &args.out else {
        return Err(CommandError::usage("fit: a stack needs --out DIR for its map"));
    };
    let mut stack = Stack::open(&args.path)?;
    let estimator = args.estimator.into();
    let calibration = calibration_of(&stack, args)?;
    let inputs = inputs_of(&stack, estimator, calibration.as_ref());
    let (mut fitted, sums) = stack.fit_keeping_sums(&inputs)?;
    if let Some(fit) = calibration.as_ref().and_then(|calibration| calibration.fit.as_ref()) {
        fitted.map.budget = Some(stack.budget(&fitted.map, &sums, &inputs, fit));
    }
    args.masks.limits().apply(&mut fitted.map);
    let mut summary = summary(&stack, &inputs, &fitted);
    summary["masks"] = json!({
        "emissivity_below": args.masks.mask_emissivity_below,
        "sigma_above_k": args.masks.mask_sigma_above_k,
    });
    let meta = ResultMeta { title: stack.case.name.clone(), more: calibration_json(&inputs) };
    let cannot = |error: files::FileError| CommandError::failure(format!("fit: writing the map: {error}"));
    files::write_result(out, &fitted.map, &meta).map_err(cannot)?;
    let text = serde_json::to_string_pretty(&summary).expect("numbers and texts") + "\n";
    files::write_atomic(&out.join("summary.json"), text.as_bytes()).map_err(cannot)?;
    let more = walls::correct(&args.walls, out)? + &abel::inverted(&args.abel, out)?;
    if args.convergence {
        write_convergence(out, &stack.convergence(&inputs, EMISSIVITY_MIN)?)?;
    }
    if let Some(at) = args.pixel.pixel {
        return pixel::of_stack(args, at);
    }
    if args.json { print(&text) } else { print(&(readable(&fitted, out) + &more)) }
}

/// The curve that takes the place of a stack's own, if one is given.
fn calibration_of(stack: &Stack, args: &Args) -> Result<Option<Calibration>, CommandError> {
    if args.calibration.is_none() && stack.case.calibration.is_none() {
        return Err(CommandError::usage(format!(
            "fit {}: case.json has no calibration. Give --calibration FILE.",
            args.path.display()
        )));
    }
    Ok(args.calibration.as_deref().map(Calibration::read).transpose()?)
}

/// What a stack is fitted with.
fn inputs_of<'a>(
    stack: &Stack,
    estimator: Estimator,
    calibration: Option<&'a Calibration>,
) -> map::FitInputs<'a> {
    calibration
        .map_or_else(|| stack.inputs(estimator), |calibration| stack.inputs_with(estimator, calibration))
}

/// Emissivity above which pixels of a stack count where not all do.
const EMISSIVITY_MIN: f64 = 0.2;

/// OUT/convergence.csv: a line per number of cycles.
fn write_convergence(out: &Path, steps: &[Step]) -> Result<(), CommandError> {
    let mut text = String::from("cycles,pixels,rms_to_last_k,rms_of_cycle_k,median_sigma_k\n");
    let cell = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    for step in steps {
        text += &format!(
            "{},{},{},{},{}\n",
            step.cycles,
            step.pixels,
            cell(step.rms_to_last_k),
            cell(step.rms_of_cycle_k),
            cell(step.median_sigma_k)
        );
    }
    let path = out.join("convergence.csv");
    files::write_atomic(&path, text.as_bytes())
        .map_err(|error| CommandError::failure(format!("fit: {error}")))
}

fn calibration_json(inputs: &map::FitInputs<'_>) -> Value {
    json!({
        "gamma_near": inputs.gamma_near,
        "gamma_far": inputs.gamma_far,
        "emissivity_plate": inputs.emissivity_plate,
        "far_window_counts": inputs.far_window_counts,
        "curve": inputs.curve,
        "residual": inputs.residual,
        "range": inputs.range,
        "x_counts": inputs.x_counts,
    })
}

fn summary(stack: &Stack, inputs: &map::FitInputs<'_>, fitted: &Fitted) -> Value {
    let Fitted { map, levels } = fitted;
    let flags: BTreeMap<&str, usize> = map.flag_counts().into_iter().collect();
    json!({
        "schema": 1,
        "name": stack.case.name,
        "estimator": map.estimator.name(),
        "confidence": map.confidence,
        "rows": map.rows,
        "columns": map.columns,
        "levels": levels,
        "cycles": {
            "received": levels.iter().map(|l| l.cycles).sum::<usize>(),
            "accepted": levels.iter().map(|l| l.accepted).sum::<usize>(),
            "rejected": levels.iter().map(|l| l.rejected.len()).sum::<usize>(),
            "spike_samples": levels.iter().map(|l| l.spike_samples).sum::<u64>(),
        },
        "flags": flags,
        "flag_legend": files::result::flag_legend(),
        "temperature_k": quantiles(&map.temperature_k),
        "sigma_temperature_k": quantiles(&map.sigma_temperature_k),
        "emissivity": quantiles(&map.emissivity),
        "inputs": calibration_json(inputs),
        "budget": map.budget.as_ref().map(|budget| budget_of(budget, map, EMISSIVITY_MIN)),
    })
}

/// Number of finite values and some of their quantiles.
fn quantiles(values: &[f64]) -> Value {
    let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    finite.sort_unstable_by(f64::total_cmp);
    let at = |hundredths: usize| finite.get(finite.len().saturating_sub(1) * hundredths / 100).copied();
    json!({ "pixels": finite.len(), "p10": at(10), "p50": at(50), "p90": at(90) })
}

fn readable(fitted: &Fitted, out: &Path) -> String {
    let DitMap { rows, columns, .. } = fitted.map;
    let mut text = format!("{rows} x {columns} pixels, {} levels\n", fitted.levels.len());
    for level in &fitted.levels {
        let plate = level.plate_temperature_k.map_or_else(|| "-".into(), |t| format!("{t:.2} K"));
        text += &format!("  plate {plate:>10}  cycles {:3}  accepted {:3}", level.cycles, level.accepted);
        for rejected in &level.rejected {
            text +=
                &format!("  [cycle {}: {}, score {:.2}]", rejected.cycle, rejected.reason, rejected.score);
        }
        if level.spike_samples > 0 {
            text += &format!("  [{} spikes in {} cycles]", level.spike_samples, level.spikes.len());
        }
        text += "\n";
    }
    for (name, pixels) in fitted.map.flag_counts().into_iter().filter(|(_, pixels)| *pixels > 0) {
        text += &format!("  {pixels:8} pixels {name}\n");
    }
    if let Some(budget) = &fitted.map.budget {
        text += &uncertainty(budget, &fitted.map);
    }
    text + &format!("written to {}\n", out.display())
}

/// What the standard deviations hold, and what they do not.
fn uncertainty(budget: &Budget, map: &DitMap) -> String {
    let figures = budget_of(budget, map, EMISSIVITY_MIN);
    let mut text = String::from(
        "sigma_temperature_k is statistical: the camera's noise and differences between shots\n",
    );
    for part in budget.parts.iter().filter(|part| part.systematic) {
        if let Some(median) = figures["median_k"][part.name].as_f64() {
            text += &format!("  besides, common to all pixels: {} {median:.2} K (median)\n", part.of);
        }
    }
    if !budget.absent.is_empty() {
        text += &format!("  not known, and in no sigma: {}\n", budget.absent.join(", "));
    }
    text
}

/// A file of lines with known variances. Numbers are decimal texts or numbers.
#[derive(Debug, Deserialize)]
struct Lines {
    gamma: f64,
    #[serde(rename = "eps_B")]
    emissivity_plate: f64,
    calibration: CaseCurve,
    cases: Vec<LineCase>,
}

#[derive(Debug, Deserialize)]
struct LineCase {
    #[serde(default)]
    name: String,
    x: Vec<Number>,
    y: Vec<Number>,
    var: Vec<Number>,
    /// Only its keys are read: the quantiles t to form sets for.
    #[serde(default)]
    fieller: BTreeMap<String, Value>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Number {
    Value(f64),
    Text(String),
}

impl Number {
    fn parse(&self) -> Result<f64, String> {
        match self {
            Self::Value(value) => Ok(*value),
            Self::Text(text) => text.trim().parse().map_err(|_| format!("{text:?} is not a number")),
        }
    }
}

fn fit_lines(path: &Path) -> CommandResult {
    let wrong = |reason: String| CommandError::usage(format!("fit {}: {reason}.", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
    let answer = lines(&text).map_err(wrong)?;
    print(&(serde_json::to_string_pretty(&answer).expect("numbers and texts") + "\n"))
}

/// Fits every line of a JSON text in the form of `exact_lines.json` and answers in the same form, with numbers.
/// What a line does not define is null.
///
/// # Errors
///
/// What is wrong with the text.
pub fn lines(text: &str) -> Result<Value, String> {
    let lines: Lines = serde_json::from_str(text).map_err(|e| e.to_string())?;
    let curve = lines.calibration.curve();
    let cases: Vec<Value> = lines
        .cases
        .iter()
        .map(|case| {
            fit_line(case, &lines, &curve).map_err(|reason| format!("line {:?}: {reason}", case.name))
        })
        .collect::<Result<_, _>>()?;
    Ok(json!({ "gamma": lines.gamma, "eps_B": lines.emissivity_plate, "cases": cases }))
}

fn fit_line(case: &LineCase, lines: &Lines, curve: &SakumaHattori) -> Result<Value, String> {
    let parse = |numbers: &[Number]| numbers.iter().map(Number::parse).collect::<Result<Vec<f64>, _>>();
    let (x, y, variance) = (parse(&case.x)?, parse(&case.y)?, parse(&case.var)?);
    if x.len() != y.len() || x.len() != variance.len() {
        return Err("x, y and var differ in length".into());
    }
    if !variance.iter().all(|&v| v > 0.0) {
        return Err("variances must be positive".into());
    }
    let Some(known) = map::known_line(&x, &y, &variance, lines.gamma, lines.emissivity_plate, curve) else {
        return Ok(json!({ "name": case.name, "slope": null }));
    };
    let map::KnownLine { line, covariance, emissivity, temperature_k } = &known;
    let usual = ["1".to_owned(), map::T_KNOWN.to_string()];
    let keys: Vec<&String> =
        if case.fieller.is_empty() { usual.iter().collect() } else { case.fieller.keys().collect() };
    let mut fieller = serde_json::Map::new();
    for key in keys {
        let t: f64 = key.parse().map_err(|_| format!("the quantile {key:?} is not a number"))?;
        let set = match line.fieller(covariance, t) {
            Fieller::Bounded { low, high } => json!({ "kind": "bounded", "lo": low, "hi": high }),
            Fieller::Complement { low, high } => json!({ "kind": "complement", "lo": low, "hi": high }),
            Fieller::WholeLine => json!({ "kind": "whole_line" }),
        };
        fieller.insert(key.clone(), set);
    }
    Ok(json!({
        "name": case.name,
        "slope": line.slope,
        "offset": line.offset,
        "crossing": line.crossing,
        "var_slope": covariance.slope,
        "var_offset": line.offset_variance(covariance),
        "cov_slope_offset": line.slope_offset_covariance(covariance),
        "var_crossing": line.crossing_variance(covariance),
        "chi2": line.chi2,
        "eps": emissivity,
        "fieller": fieller,
        "T": temperature_k,
    }))
}
