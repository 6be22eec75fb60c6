//! `ditd fit … --pixel R,C`: the data behind one pixel, as numbers and as a picture.

use super::super::{CommandError, CommandResult, print};
use super::Args;
use crate::estimate::accumulate::Sums;
use crate::estimate::map::{self, DitMap, FitInputs};
use crate::estimate::pixel::{LevelFacts, PixelView, view};
use crate::files::write_atomic;
use crate::reduce::Total;
use crate::stack::Stack;
use crate::{fitting, report, session};
use std::path::{Path, PathBuf};

/// Which pixel, and where its picture goes.
#[derive(Debug, clap::Args)]
pub(super) struct PixelArgs {
    /// Show what is behind the pixel at row R and column C (0 at the top and left): printed, and drawn as SVG
    #[arg(long, value_name = "R,C", value_parser = place)]
    pub(super) pixel: Option<(usize, usize)>,
    /// Where the picture of --pixel goes; otherwise OUT/pixel_R_C.svg, or pixel_R_C.svg here without --out
    #[arg(long, value_name = "FILE.svg", requires = "pixel")]
    pub(super) pixel_svg: Option<PathBuf>,
}

fn place(text: &str) -> Result<(usize, usize), String> {
    let (row, column) = text.split_once(',').ok_or("a row and a column, as in 12,40")?;
    let number = |text: &str| text.trim().parse().map_err(|_| format!("{text:?} is not a whole number"));
    Ok((number(row)?, number(column)?))
}

/// Looks at a pixel of a stack.
///
/// # Errors
///
/// Status 2 for a pixel that does not exist, and as a fit.
pub(super) fn of_stack(args: &Args, at: (usize, usize)) -> CommandResult {
    let mut stack = Stack::open(&args.path)?;
    let estimator = args.estimator.into();
    let calibration = super::calibration_of(&stack, args)?;
    let inputs = super::inputs_of(&stack, estimator, calibration.as_ref());
    let (mut fitted, sums) = stack.fit_keeping_sums(&inputs)?;
    args.masks.limits().apply(&mut fitted.map);
    let facts: Vec<LevelFacts> = fitted
        .levels
        .iter()
        .map(|level| LevelFacts {
            plate_temperature_k: level.plate_temperature_k,
            misfires: level.rejected.len(),
        })
        .collect();
    let name = stack.case.name.clone();
    shown(args, &Shown { sums: &sums, inputs: &inputs, map: &fitted.map, facts: &facts, name: &name }, at)
}

/// Looks at a pixel of a run.
///
/// # Errors
///
/// Status 2 for a pixel that does not exist, and as a fit.
pub(super) fn of_run(args: &Args, at: (usize, usize)) -> CommandResult {
    let last = session::last_state(&args.path, args.calibration.as_deref(), Some(args.estimator.into()))?;
    let session::Final { config, calibrated, reduced, estimator } = &last;
    let Total::Map(sums) = &reduced.total else {
        return Err(CommandError::usage("fit: --pixel: the run is a calibration, not a map"));
    };
    let inputs =
        fitting::inputs(&reduced.levels, config, &calibrated.calibration, &calibrated.flat, *estimator);
    let mut map = map::solve(sums, &inputs);
    args.masks.limits().or(config.fit.limits()).apply(&mut map);
    let facts: Vec<LevelFacts> = reduced
        .levels
        .iter()
        .map(|level| LevelFacts {
            plate_temperature_k: level.plate_mean_k(),
            misfires: level.left_out.misfires.len(),
        })
        .collect();
    let name = config.campaign.name.as_str();
    shown(args, &Shown { sums, inputs: &inputs, map: &map, facts: &facts, name }, at)
}

/// What a pixel is looked at with.
struct Shown<'a> {
    sums: &'a Sums,
    inputs: &'a FitInputs<'a>,
    map: &'a DitMap,
    facts: &'a [LevelFacts],
    name: &'a str,
}

fn shown(args: &Args, with: &Shown<'_>, at: (usize, usize)) -> CommandResult {
    let (rows, columns) = (with.sums.rows(), with.sums.columns());
    if at.0 >= rows || at.1 >= columns {
        return Err(CommandError::usage(format!(
            "fit: --pixel {},{}: the map has rows 0 … {} and columns 0 … {}.",
            at.0,
            at.1,
            rows.saturating_sub(1),
            columns.saturating_sub(1)
        )));
    }
    let found = view(with.sums, with.inputs, with.map, with.facts, at);
    let svg = picture_path(args, at);
    let page = report::pixel::sheet(&found, with.name).to_svg();
    write(&svg, page.as_bytes())?;
    if args.json {
        return print(&as_json(&found, &svg));
    }
    print(&format!("{}written to {}\n", report::pixel::text(&found), svg.display()))
}

fn picture_path(args: &Args, (row, column): (usize, usize)) -> PathBuf {
    let name = format!("pixel_{row}_{column}.svg");
    match (&args.pixel.pixel_svg, &args.out) {
        (Some(path), _) => path.clone(),
        (None, Some(out)) => out.join(name),
        (None, None) => PathBuf::from(name),
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), CommandError> {
    let failed = |why: String| CommandError::failure(format!("fit: {}: {why}", path.display()));
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|error| failed(error.to_string()))?;
    }
    write_atomic(path, bytes).map_err(|error| failed(error.to_string()))
}

fn as_json(found: &PixelView, svg: &Path) -> String {
    let mut value = serde_json::to_value(found).expect("numbers and texts");
    value["schema"] = 1.into();
    value["svg"] = svg.display().to_string().into();
    serde_json::to_string_pretty(&value).expect("numbers and texts") + "\n"
}
