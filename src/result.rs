//! Writes what a run comes to: maps, summary, report; and keeps and compares the simulated world's truth.
//!
//! Everything in the result folder is a function of the records, the calibration and the recorded truth: no time,
//! no host. So a replay's folder is equal byte for byte.

use crate::calibrate::{CHI2_MAX, Calibrated};
use crate::config::Config;
use crate::estimate::accumulate::{self, Sums};
use crate::estimate::budget::Budget;
use crate::estimate::map::{self, DitMap, Estimator, FitInputs, LookMap, flag};
use crate::estimate::predict::{Forecast, Visit};
use crate::files::npy::{Array, Values};
use crate::files::npz::{self, Packing};
use crate::files::{self, FileError, ResultMeta};
use crate::fitting;
use crate::reduce::{LevelState, Reduced, Total};
use crate::report::run::Material;
use crate::report::{self, Picture};
use crate::run_folder::{FolderError, RunFolder};
use crate::truth::{ErrorFigures, StatisticalTruth, WorldTruth, compare};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Why a result could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ResultError {
    /// A file.
    #[error(transparent)]
    File(#[from] FileError),
    /// The folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Too little was recorded for a map.
    #[error("result: {0}")]
    TooLittle(&'static str),
    /// The recorded truth does not have the arrays that it should.
    #[error("{path}: {why}. Restore the folder from a copy.")]
    World {
        /// The file.
        path: PathBuf,
        /// What is missing or of another shape.
        why: String,
    },
}

/// Mean of spray − blank without spray from which the operator is warned, in counts: at 58 counts (449 K) it is 0.04 K.
const ZERO_DIFFERENCE_MAX: f64 = 0.05;

/// Pixels whose emissivity is below this many of its standard deviations count as seeing no spray.
const NO_SPRAY_SIGMAS: f64 = 2.0;

/// Fewest such pixels for a mean to be told.
const NO_SPRAY_PIXELS_MIN: usize = 100;

/// Writes the result files to `out`; returns the summary in words.
///
/// # Errors
///
/// [`ResultError`] when there is no map in the records or the disk refuses.
pub fn write(
    out: &Path,
    reduced: &Reduced,
    config: &Config,
    calibrated: &Calibrated,
    estimator: Estimator,
    world: Option<&WorldTruth>,
    telemetry: &[(f64, f64, f64)],
) -> Result<String, ResultError> {
    let Total::Map(sums) = &reduced.total else {
        return Err(ResultError::TooLittle("these records are a calibration, not a campaign"));
    };
    if !fitting::can_fit(sums) {
        return Err(ResultError::TooLittle("a map needs accepted cycles at two levels at least"));
    }
    let inputs =
        fitting::inputs(&reduced.levels, config, &calibrated.calibration, &calibrated.flat, estimator);
    let mut map = map::solve(sums, &inputs);
    config.fit.limits().apply(&mut map);
    map.budget = Some(fitting::budget(&map, sums, &inputs, &reduced.levels, config, &calibrated.calibration));
    let map = map;
    let judged = world.map(|world| {
        let lines = map::lines_with_same_weights(sums, &inputs, &world.x_counts, &world.difference_counts);
        Judged::of(&map, world, world.statistical(&lines), config.emissivity_min())
    });
    let summary = summary(reduced, config, calibrated, &map, judged.as_ref(), sums);
    let meta = ResultMeta { title: config.campaign.name.clone(), more: json!({}) };
    files::write_result(out, &map, &meta)?;
    let folder = RunFolder::at(out);
    if let (Some(judged), Some(world)) = (&judged, world) {
        folder.write(&out.join("truth.npz"), &judged.to_npz(world)?)?;
    }
    let mut pictures = Vec::new();
    for (name, caption, png) in files::result::previews(&map, "") {
        let png = png.map_err(|source| FileError::Io { path: out.join(name), source })?;
        pictures.push(Picture { caption: caption.to_owned(), png });
    }
    let report = report::run::of_run(&Material {
        reduced,
        config,
        calibrated,
        sums,
        inputs: &inputs,
        map: &map,
        summary: &summary,
        pictures,
        telemetry,
    });
    folder.write(&out.join("report.html"), report.to_html().as_bytes())?;
    let mut text = format!("{summary:#}");
    text.push('\n');
    folder.write(&out.join("summary.json"), text.as_bytes())?;
    Ok(words(&summary, &map, judged.as_ref(), config))
}

/// The map as far as it is known, in words; `None` before two levels have cycles. The same fit over the same records
/// as the final one, but provisional: nothing is left out before all shots are known.
pub fn provisional(reduced: &Reduced, config: &Config, calibrated: &Calibrated) -> Option<String> {
    let Total::Map(sums) = &reduced.total else { return None };
    if !fitting::can_fit(sums) {
        return None;
    }
    let estimator = fitting::estimator(&config.fit.estimator).unwrap_or(Estimator::Default);
    let inputs =
        fitting::inputs(&reduced.levels, config, &calibrated.calibration, &calibrated.flat, estimator);
    // A line to be looked at: f32 says the same to 2e-4 K, in less than half of the time.
    let mut look = LookMap::empty();
    map::look_into(sums, &inputs, &mut look);
    let (pixels, temperature, sigma) = over_spray(
        [&look.emissivity, &look.temperature_k, &look.sigma_temperature_k],
        config.emissivity_min(),
    );
    (pixels > 0).then(|| {
        format!(
            "so far, misfires and spikes included: {pixels} pixels with emissivity above {}: median {temperature:.2} K, median σ {sigma:.2} K{}",
            config.emissivity_min(),
            next(reduced, sums, &inputs, config.emissivity_min()).unwrap_or_default()
        )
    })
}

/// Pixels on which a forecast rests: medians to 2 %.
const FORECAST_PIXELS: usize = 2000;

/// The level where one more cycle would lower the median σ most.
fn next(reduced: &Reduced, sums: &Sums, inputs: &FitInputs<'_>, emissivity_min: f64) -> Option<String> {
    let forecast = Forecast::of(sums, inputs, emissivity_min, FORECAST_PIXELS);
    let best = reduced
        .plan
        .levels
        .iter()
        .map(|level| {
            let visit = Visit { plate_k: level.set_point_k, cycles: 1.0 };
            (level.set_point_k, forecast.quantile_k(&[visit], 0.5))
        })
        .filter(|(_, sigma)| sigma.is_finite())
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(format!("; one more cycle at {:.1} K would make it {:.2} K", best.0, best.1))
}

/// The map held against the truth.
struct Judged {
    truth: StatisticalTruth,
    statistical: Option<ErrorFigures>,
    physical: Option<ErrorFigures>,
    droplets: Option<ErrorFigures>,
    /// Part of the pixels whose reported 68 % interval (one sigma) holds the statistical truth.
    coverage_68: f64,
    /// The same for the 95 % set.
    coverage_95: f64,
    /// Rms standard error of the statistical truth itself, in K.
    truth_error_k: f64,
}

impl Judged {
    fn of(map: &DitMap, world: &WorldTruth, truth: StatisticalTruth, emissivity_min: f64) -> Self {
        // The truth says which pixels count, so that noise cannot choose them.
        let counts = |pixel: usize| truth.emissivity[pixel] > emissivity_min;
        let (mut n, mut inside_68, mut inside_95, mut square, mut errors) = (0u32, 0u32, 0u32, 0.0, 0u32);
        for pixel in (0..map.temperature_k.len()).filter(|&pixel| counts(pixel)) {
            let (measured, sigma) = (map.temperature_k[pixel], map.sigma_temperature_k[pixel]);
            let is = truth.temperature_k[pixel];
            if measured.is_finite() && sigma.is_finite() && is.is_finite() {
                n += 1;
                inside_68 += u32::from((measured - is).abs() <= sigma);
                inside_95 +=
                    u32::from(map.temperature_low_k[pixel] <= is && is <= map.temperature_high_k[pixel]);
            }
            if truth.error_k[pixel].is_finite() {
                square += truth.error_k[pixel].powi(2);
                errors += 1;
            }
        }
        let part = |inside: u32| if n > 0 { f64::from(inside) / f64::from(n) } else { f64::NAN };
        Self {
            statistical: compare(&map.temperature_k, &truth.temperature_k, counts),
            physical: compare(&map.temperature_k, &world.physical_k, counts),
            droplets: compare(&map.temperature_k, &world.droplets_k, counts),
            coverage_68: part(inside_68),
            coverage_95: part(inside_95),
            truth_error_k: if errors > 0 { (square / f64::from(errors)).sqrt() } else { f64::NAN },
            truth,
        }
    }

    fn to_npz(&self, world: &WorldTruth) -> Result<Vec<u8>, ResultError> {
        let image = |values: &[f64]| Array {
            shape: vec![world.rows, world.columns],
            values: Values::F64(values.to_vec()),
        };
        let arrays = [
            ("temperature_statistical_k", image(&self.truth.temperature_k)),
            ("temperature_statistical_error_k", image(&self.truth.error_k)),
            ("emissivity_statistical", image(&self.truth.emissivity)),
            ("temperature_physical_k", image(&world.physical_k)),
            ("emissivity_physical", image(&world.physical_emissivity)),
            ("temperature_droplets_k", image(&world.droplets_k)),
            ("emissivity_droplets", image(&world.droplets_emissivity)),
        ];
        let named: Vec<(&str, &Array)> = arrays.iter().map(|(name, array)| (*name, array)).collect();
        npz::to_bytes(&named, Packing::Deflated)
            .map_err(|source| FileError::Io { path: PathBuf::from("truth.npz"), source }.into())
    }

    fn to_json(&self, emissivity_min: f64) -> Value {
        json!({
            "statistical": self.statistical,
            "statistical_standard_error_k": number(self.truth_error_k),
            "physical": self.physical,
            "droplets": self.droplets,
            "coverage_68": number(self.coverage_68),
            "coverage_95": number(self.coverage_95),
            "emissivity_min": emissivity_min,
        })
    }
}

/// A number, or null when it is none: JSON has no NaN.
fn number(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or(Value::Null, Value::Number)
}

fn summary(
    reduced: &Reduced,
    config: &Config,
    calibrated: &Calibrated,
    map: &DitMap,
    judged: Option<&Judged>,
    sums: &Sums,
) -> Value {
    let abscissae = fitting::abscissae(&reduced.levels, config, &calibrated.calibration);
    let levels: Vec<Value> = reduced
        .plan
        .levels
        .iter()
        .zip(&reduced.levels)
        .zip(&abscissae)
        .map(|((plan, state), x)| {
            let mut level = json!({
                "set_point_k": plan.set_point_k,
                "plate_k": state.plate_mean_k(),
                "x_counts": x,
                "cycles": state.accepted,
                "rejected": state.rejected.iter()
                    .map(|(cycle, reason)| json!({ "cycle": cycle, "reason": reason })).collect::<Vec<_>>(),
                "misfires": misfires(state),
                "spikes": spikes(state),
            });
            if !state.process.is_empty() {
                level["monitors"] = process(state);
            }
            level
        })
        .collect();
    let planned: u32 = reduced.plan.levels.iter().map(|level| level.program.cycles).sum();
    let received: u32 = reduced.levels.iter().map(|state| state.accepted).sum();
    let retaken: usize = reduced.levels.iter().map(|state| state.rejected.len()).sum();
    let flags: serde_json::Map<String, Value> =
        map.flag_counts().into_iter().map(|(name, count)| (name.to_owned(), count.into())).collect();
    let fit = &calibrated.calibration.fit;
    let spray = over_spray(spray_of(map), config.emissivity_min());
    json!({
        "schema": 1,
        "software": concat!("ditd ", env!("CARGO_PKG_VERSION")),
        "name": config.campaign.name,
        "simulated": config.is_simulated(),
        "estimator": map.estimator.name(),
        "rows": map.rows,
        "columns": map.columns,
        "levels": levels,
        "cycles": { "planned": planned, "received": received, "retaken": retaken, "lost": planned.saturating_sub(received) },
        "flags": flags,
        "flag_legend": files::result::flag_legend(),
        "masks": {
            "emissivity_below": config.fit.mask_emissivity_below,
            "sigma_above_k": config.fit.mask_sigma_above_k,
        },
        "calibration": {
            "curve": fit.curve,
            "chi2": fit.chi2,
            "dof": fit.dof,
            "low_k": fit.range.low_k,
            "high_k": fit.range.high_k,
            "points": calibrated.calibration.points.len(),
            "utc": calibrated.calibration.utc,
            "warnings": calibrated.calibration.figures.contradictions(config),
        },
        "budget": map.budget.as_ref().map(|budget| budget_of(budget, map, config.emissivity_min())),
        "zero_difference_counts": zero_difference(map, sums),
        "far_window_counts": fitting::far_window_counts(config, &calibrated.calibration),
        "spray": {
            "emissivity_min": config.emissivity_min(),
            "pixels": spray.0,
            "median_temperature_k": number(spray.1),
            "median_sigma_temperature_k": number(spray.2),
        },
        "true_error": judged.map(|judged| judged.to_json(config.emissivity_min())),
    })
}

/// Process values at the accepted cycles.
fn process(state: &LevelState) -> Value {
    let each = state.process.iter().map(|(name, value)| {
        let figures = json!({ "count": value.count, "mean": value.mean, "min": value.min, "max": value.max });
        (name.clone(), figures)
    });
    Value::Object(each.collect())
}

/// The uncertainty budget over the spray: medians in K, what is not in it, and the emissivity's systematic part.
pub(crate) fn budget_of(budget: &Budget, map: &DitMap, emissivity_min: f64) -> Value {
    let over = |sigma_k: &[f64]| {
        let each = sigma_k.iter().zip(&map.emissivity).zip(&map.temperature_k);
        let inside =
            each.filter(|((_, emissivity), kelvin)| **emissivity > emissivity_min && kelvin.is_finite());
        number(median(inside.map(|((sigma, _), _)| *sigma).collect()))
    };
    let mut medians = serde_json::Map::new();
    medians.insert("sigma_t_noise_k".to_owned(), over(&map.sigma_t_noise_k));
    for part in &budget.parts {
        medians.insert(part.name.to_owned(), over(&part.sigma_k));
    }
    json!({
        "median_k": medians,
        "systematic": budget.parts.iter().filter(|part| part.systematic).map(|part| part.name).collect::<Vec<_>>(),
        "not_in_it": budget.absent,
        "emissivity_relative": budget.emissivity_relative
            .map(|[windows, calibration]| json!({ "windows": number(windows), "calibration": number(calibration) })),
    })
}

/// Accepted cycles without a spray, left out of the map.
fn misfires(state: &LevelState) -> Vec<Value> {
    let each = state.left_out.misfires.iter();
    each.map(|one| json!({ "cycle": state.cycles.get(one.cycle), "score": number(one.score) })).collect()
}

/// Cycles with samples that were left out as spikes, and how many pixels that were.
fn spikes(state: &LevelState) -> Vec<Value> {
    let each = state.left_out.spikes.iter().zip(&state.cycles).filter(|(pixels, _)| **pixels > 0);
    each.map(|(pixels, cycle)| json!({ "cycle": cycle, "pixels": pixels })).collect()
}

/// What [`over_spray`] reads of a map.
fn spray_of(map: &DitMap) -> [&[f64]; 3] {
    [&map.emissivity, &map.temperature_k, &map.sigma_temperature_k]
}

/// Pixels with a temperature and an emissivity above the limit; their median temperature and median sigma, in K.
fn over_spray<F: Into<f64> + Copy>(
    [emissivities, temperatures_k, sigmas_k]: [&[F]; 3],
    emissivity_min: f64,
) -> (usize, f64, f64) {
    let (mut temperatures, mut sigmas) = (Vec::new(), Vec::new());
    for ((&emissivity, &kelvin), &sigma) in emissivities.iter().zip(temperatures_k).zip(sigmas_k) {
        let (emissivity, kelvin): (f64, f64) = (emissivity.into(), kelvin.into());
        if emissivity > emissivity_min && kelvin.is_finite() {
            temperatures.push(kelvin);
            sigmas.push(sigma.into());
        }
    }
    let pixels = temperatures.len();
    (pixels, median(temperatures), median(sigmas))
}

/// Mean of spray − blank, in counts, over all levels and the pixels that see no spray: zero but for a camera that is
/// still warming up, drift, or vapour that an injection left. `None` when there are too few such pixels.
fn zero_difference(map: &DitMap, sums: &Sums) -> Option<f64> {
    let bare: Vec<usize> = (0..map.emissivity.len())
        .filter(|&i| {
            map.emissivity[i].abs() < NO_SPRAY_SIGMAS * map.sigma_emissivity[i]
                && map.flags[i] & flag::DEAD == 0
        })
        .collect();
    if bare.len() < NO_SPRAY_PIXELS_MIN {
        return None;
    }
    let b = sums.blanks_per_cycle();
    let (mut sum, mut n) = (0.0, 0u32);
    for level in sums.levels() {
        for &i in bare.iter().filter(|&&i| level.count(i) > 0) {
            sum += accumulate::mean(level.sum(i), level.count(i), b);
            n += 1;
        }
    }
    (n > 0).then(|| sum / f64::from(n))
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    values.sort_by(f64::total_cmp);
    values[(values.len() - 1) / 2]
}

fn words(summary: &Value, map: &DitMap, judged: Option<&Judged>, config: &Config) -> String {
    let (pixels, temperature, sigma) = over_spray(spray_of(map), config.emissivity_min());
    let mut out = format!("{}\n", config.campaign.name);
    // Writing to a String cannot fail.
    let _ = writeln!(
        out,
        "cycles    {} planned, {} received, {} taken again, {} lost; estimator {}",
        summary["cycles"]["planned"],
        summary["cycles"]["received"],
        summary["cycles"]["retaken"],
        summary["cycles"]["lost"],
        map.estimator.name()
    );
    if pixels == 0 {
        let _ = writeln!(out, "spray     no pixel with emissivity above {}", config.emissivity_min());
    } else {
        let _ = writeln!(
            out,
            "spray     {pixels} pixels with emissivity above {}: median {temperature:.2} K, median σ {sigma:.2} K",
            config.emissivity_min()
        );
    }
    if let (Some(budget), true) = (&map.budget, pixels > 0) {
        let median = |name: &str| summary["budget"]["median_k"][name].as_f64();
        let parts: Vec<String> = budget
            .parts
            .iter()
            .filter(|part| part.systematic)
            .filter_map(|part| Some(format!("{} {:.2} K", part.of, median(part.name)?)))
            .collect();
        let _ = writeln!(out, "besides   common to all pixels: {}", parts.join(", "));
        if !budget.absent.is_empty() {
            let _ = writeln!(
                out,
                "          not in the budget, [optics] sigma_… would put it there: {}",
                budget.absent.join(", ")
            );
        }
    }
    for warning in summary["calibration"]["warnings"].as_array().into_iter().flatten() {
        let _ = writeln!(out, "WARNING   {}", warning.as_str().unwrap_or_default());
    }
    let (chi2, dof) = (summary["calibration"]["chi2"].as_f64(), summary["calibration"]["dof"].as_f64());
    if let (Some(chi2), Some(dof)) = (chi2, dof)
        && chi2 > CHI2_MAX * dof
    {
        let _ = writeln!(
            out,
            "WARNING   the calibration's χ² is {chi2:.1} for {dof} degrees of freedom: its points do not lie on one curve"
        );
    }
    if let Some(zero) = summary["zero_difference_counts"].as_f64()
        && zero.abs() > ZERO_DIFFERENCE_MAX
    {
        let _ = writeln!(
            out,
            "WARNING   spray − blank is {zero:+.3} counts where there is no spray: warming up, drift or left-over vapour"
        );
    }
    if let Some(judged) = judged {
        let mut figures = |what: &str, figures: Option<ErrorFigures>, note: &str| {
            if let Some(f) = figures {
                let _ = writeln!(
                    out,
                    "{what} rms {:.2} K, bias {:+.2} K, median {:.2} K, 90 % {:.2} K, 99 % {:.2} K over {} pixels{note}",
                    f.rms_k, f.bias_k, f.p50_k, f.p90_k, f.p99_k, f.pixels
                );
            }
        };
        let own = format!(" (truth known to {:.3} K)", judged.truth_error_k);
        figures("error (a)  statistical:", judged.statistical, &own);
        figures("error (b)  physical:   ", judged.physical, "");
        figures("           droplets:   ", judged.droplets, "");
        let _ = writeln!(
            out,
            "intervals  68 % sets hold the truth (a) in {:.1} % of pixels, 95 % sets in {:.1} %",
            judged.coverage_68 * 100.0,
            judged.coverage_95 * 100.0
        );
    }
    out
}

/// The plate's readings of a run: time in s, reading in K, set-point in K. Lines that are no reading are left out:
/// telemetry is for looking at, not for counting on.
pub fn read_telemetry(folder: &Path) -> Vec<(f64, f64, f64)> {
    let text = std::fs::read_to_string(folder.join("telemetry.csv")).unwrap_or_default();
    text.lines()
        .filter_map(|line| {
            let mut fields = line.split(',').map(|field| field.parse::<f64>().ok());
            let (t_ns, _, apparent, _, set_point) =
                (fields.next()??, fields.next()?, fields.next()??, fields.next()?, fields.next()??);
            Some((t_ns * 1e-9, apparent, set_point))
        })
        .collect()
}

/// Keeps the truth of a simulated world in the run folder.
///
/// # Errors
///
/// [`ResultError`] when the disk refuses.
pub fn write_world(folder: &RunFolder, truth: &WorldTruth) -> Result<(), ResultError> {
    let line = |values: &[f64]| Array { shape: vec![values.len()], values: Values::F64(values.to_vec()) };
    let image = |values: &[f64]| Array {
        shape: vec![truth.rows, truth.columns],
        values: Values::F64(values.to_vec()),
    };
    // f32 holds 24 bits: expected counts of hundreds to 1e-5 counts, far below their own standard error.
    let stack = |levels: &[Vec<f64>]| Array {
        shape: vec![levels.len(), truth.rows, truth.columns],
        values: Values::F32(levels.iter().flatten().map(|value| narrow(*value)).collect()),
    };
    let arrays = [
        ("plate_k", line(&truth.plate_k)),
        ("x_counts", line(&truth.x_counts)),
        ("gamma_near", line(&[truth.gamma_near])),
        ("emissivity_plate", line(&[truth.emissivity_plate])),
        ("far_window_counts", line(&[truth.far_window_counts])),
        ("curve_k", line(&truth.curve_k)),
        ("curve_counts", line(&truth.curve_counts)),
        ("difference_counts", stack(&truth.difference_counts)),
        ("difference_error_counts", stack(&truth.difference_error_counts)),
        ("physical_k", image(&truth.physical_k)),
        ("physical_emissivity", image(&truth.physical_emissivity)),
        ("droplets_k", image(&truth.droplets_k)),
        ("droplets_emissivity", image(&truth.droplets_emissivity)),
    ];
    let named: Vec<(&str, &Array)> = arrays.iter().map(|(name, array)| (*name, array)).collect();
    let path = folder.world().join("truth.npz");
    let bytes = npz::to_bytes(&named, Packing::Deflated)
        .map_err(|source| FileError::Io { path: path.clone(), source })?;
    Ok(folder.write(&path, &bytes)?)
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is what is wanted")]
fn narrow(value: f64) -> f32 {
    value as f32
}

/// Reads the truth back; `None` when the folder has none (a real rig).
///
/// # Errors
///
/// [`ResultError`] when the file is damaged.
pub fn read_world(folder: &Path) -> Result<Option<WorldTruth>, ResultError> {
    let path = folder.join("truth.npz");
    if !path.exists() {
        return Ok(None);
    }
    let arrays: HashMap<String, Array> = npz::read(&path)?.into_iter().collect();
    let get = |name: &str| {
        let missing = || ResultError::World { path: path.clone(), why: format!("array {name} is missing") };
        arrays.get(name).ok_or_else(missing)
    };
    let line = |name: &str| get(name).map(Array::to_f64);
    let scalar = |name: &str| line(name).map(|values| values.first().copied().unwrap_or(f64::NAN));
    let [levels, rows, columns] = get("difference_counts")?.shape[..] else {
        return Err(ResultError::World {
            path: path.clone(),
            why: "difference_counts is no stack".to_owned(),
        });
    };
    let stack = |name: &str| -> Result<Vec<Vec<f64>>, ResultError> {
        let flat = line(name)?;
        if flat.len() != levels * rows * columns || flat.is_empty() {
            return Err(ResultError::World { path: path.clone(), why: format!("{name} has another shape") });
        }
        Ok(flat.chunks(rows * columns).map(<[f64]>::to_vec).collect())
    };
    Ok(Some(WorldTruth {
        rows,
        columns,
        plate_k: line("plate_k")?,
        x_counts: line("x_counts")?,
        difference_counts: stack("difference_counts")?,
        difference_error_counts: stack("difference_error_counts")?,
        gamma_near: scalar("gamma_near")?,
        emissivity_plate: scalar("emissivity_plate")?,
        far_window_counts: scalar("far_window_counts")?,
        curve_k: line("curve_k")?,
        curve_counts: line("curve_counts")?,
        physical_k: line("physical_k")?,
        physical_emissivity: line("physical_emissivity")?,
        droplets_k: line("droplets_k")?,
        droplets_emissivity: line("droplets_emissivity")?,
    }))
}
