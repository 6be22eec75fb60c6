//! The report of a run: pictures first, then what they rest on.

use super::{Block, Picture, Point, Report, plot};
use crate::calibrate::{CHI2_MAX, Calibrated};
use crate::config::Config;
use crate::estimate::accumulate::{self, Sums};
use crate::estimate::map::{DitMap, FitInputs, flag};
use crate::reduce::Reduced;
use serde_json::Value;

/// Emissivity of the pixel whose line is shown, if there is one near it: that of the paper's Fig. 5.
const SHOWN_EMISSIVITY: f64 = 0.71;

/// Part of weighted pixels whose χ² may exceed its 95 % point before the reader is warned.
const BAD_LINES_MAX: f64 = 0.2;

/// 95 % points of χ² for 1 … 8 degrees of freedom (any table of the distribution).
const CHI2_95: [f64; 8] = [3.841, 5.991, 7.815, 9.488, 11.070, 12.592, 14.067, 15.507];

/// Everything that a report shows.
pub struct Material<'a> {
    /// The run.
    pub reduced: &'a Reduced,
    /// Its campaign file.
    pub config: &'a Config,
    /// Its calibration.
    pub calibrated: &'a Calibrated,
    /// Its sums.
    pub sums: &'a Sums,
    /// What the fit was given.
    pub inputs: &'a FitInputs<'a>,
    /// The map.
    pub map: &'a DitMap,
    /// `summary.json`.
    pub summary: &'a Value,
    /// Captions and PNG bytes of the previews.
    pub pictures: Vec<Picture>,
    /// Time in s, plate reading in K, set-point in K.
    pub telemetry: &'a [(f64, f64, f64)],
}

/// Puts the report together.
pub fn of_run(material: &Material<'_>) -> Report {
    let Material { config, map, summary, .. } = material;
    let rig = if config.is_simulated() { "simulated rig" } else { "measured" };
    let mut blocks = vec![
        Block::Pictures(material.pictures.clone()),
        Block::Text(
            "T_eff is the emissivity-weighted, intensity-averaged temperature of the shots; scattering is not \
             corrected for. Grey pixels have no significant answer; the flags in dit.npz say why."
                .to_owned(),
        ),
        Block::Values(key_values(material)),
    ];
    blocks.extend(true_errors(summary));
    blocks.push(Block::Heading("Levels".to_owned()));
    blocks.push(level_table(material));
    blocks.extend(line_of_a_pixel(material));
    blocks.push(Block::Heading("Calibration".to_owned()));
    blocks.push(Block::Plot {
        caption: format!(
            "Standard curve, χ² {:.2} for {} degrees of freedom; counts above the closed shutter.",
            material.calibrated.calibration.fit.chi2, material.calibrated.calibration.fit.dof
        ),
        plot: plot::calibration(
            &material.calibrated.calibration.fit,
            &material.calibrated.calibration.points,
        ),
    });
    if !material.telemetry.is_empty() {
        blocks.push(Block::Heading("Plate".to_owned()));
        let readings: Vec<(f64, f64)> = material.telemetry.iter().map(|(t, k, _)| (*t, *k)).collect();
        let set_points: Vec<(f64, f64)> = material.telemetry.iter().map(|(t, _, k)| (*t, *k)).collect();
        blocks.push(Block::Plot {
            caption: "Apparent temperature of the plate over the campaign.".to_owned(),
            plot: plot::plate_temperature(&readings, &set_points),
        });
    }
    blocks.push(Block::Heading("Flags".to_owned()));
    blocks.push(Block::Table {
        head: vec!["flag".to_owned(), "pixels".to_owned(), "meaning".to_owned()],
        rows: flag::LEGEND
            .iter()
            .zip(map.flag_counts())
            .map(|((_, name, meaning), (_, count))| {
                vec![(*name).to_owned(), count.to_string(), (*meaning).to_owned()]
            })
            .collect(),
    });
    Report {
        title: config.campaign.name.clone(),
        subtitle: format!(
            "Differential infrared thermography, {rig}, {} × {} pixels, ditd {}",
            map.columns,
            map.rows,
            env!("CARGO_PKG_VERSION")
        ),
        warnings: warnings(material),
        blocks,
    }
}

fn text_of(value: &Value) -> String {
    match value {
        Value::Number(number) => number.as_f64().map_or_else(|| number.to_string(), |v| format!("{v:.2}")),
        Value::Null => "–".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn key_values(material: &Material<'_>) -> Vec<(String, String)> {
    let summary = material.summary;
    let spray = &summary["spray"];
    let optics = &material.config.optics;
    [
        ("estimator", material.map.estimator.name().to_owned()),
        (
            "cycles",
            format!(
                "{} planned, {} received, {} taken again, {} lost",
                summary["cycles"]["planned"],
                summary["cycles"]["received"],
                summary["cycles"]["retaken"],
                summary["cycles"]["lost"]
            ),
        ),
        (
            "spray",
            format!(
                "{} pixels with emissivity above {}: median {} K, median σ {} K",
                spray["pixels"],
                spray["emissivity_min"],
                text_of(&spray["median_temperature_k"]),
                text_of(&spray["median_sigma_temperature_k"])
            ),
        ),
        (
            "windows",
            format!(
                "γ near {}, γ far {}, far window mirrors {} of walls at {} K",
                optics.gamma_near, optics.gamma_far, optics.reflectance_far, optics.wall_temperature_k
            ),
        ),
        ("plate", format!("emissivity {} in the band", optics.emissivity_plate)),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .to_vec()
}

/// The error against the simulated world's truth; nothing on a real rig.
fn true_errors(summary: &Value) -> Vec<Block> {
    let errors = &summary["true_error"];
    if errors.is_null() {
        return Vec::new();
    }
    let head = ["truth", "rms / K", "bias / K", "50 % / K", "90 % / K", "99 % / K", "pixels"];
    let rows = [
        ("(a) statistical: mean of many perfect shots", "statistical"),
        ("(b) physical: absorbing mass along the sight", "physical"),
        ("droplets alone", "droplets"),
    ]
    .iter()
    .filter(|(_, key)| !errors[*key].is_null())
    .map(|(name, key)| {
        let one = &errors[*key];
        let mut row = vec![(*name).to_owned()];
        row.extend(["rms_k", "bias_k", "p50_k", "p90_k", "p99_k"].map(|figure| text_of(&one[figure])));
        row.push(one["pixels"].to_string());
        row
    })
    .collect();
    let percent =
        |value: &Value| value.as_f64().map_or_else(|| "–".to_owned(), |v| format!("{:.1} %", v * 100.0));
    vec![
        Block::Heading("Error against the simulated world".to_owned()),
        Block::Table { head: head.map(str::to_owned).to_vec(), rows },
        Block::Text(format!(
            "The 68 % sets hold truth (a) in {} of the pixels, the 95 % sets in {}. What (b) adds to (a) is the work of \
             scattering, walls, windows and the non-gray band: no further shots reduce it.",
            percent(&errors["coverage_68"]),
            percent(&errors["coverage_95"])
        )),
    ]
}

fn level_table(material: &Material<'_>) -> Block {
    let rows = material
        .reduced
        .plan
        .levels
        .iter()
        .zip(&material.reduced.levels)
        .zip(&material.inputs.x_counts)
        .enumerate()
        .map(|(index, ((plan, state), x))| {
            vec![
                (index + 1).to_string(),
                format!("{:.2}", plan.set_point_k),
                state.plate_mean_k().map_or_else(|| "–".to_owned(), |kelvin| format!("{kelvin:.3}")),
                x.map_or_else(|| "–".to_owned(), |x| format!("{x:.2}")),
                state.accepted.to_string(),
                state.rejected.len().to_string(),
            ]
        })
        .collect();
    let head = ["level", "set-point / K", "plate reading / K", "x / counts", "cycles", "taken again"];
    Block::Table { head: head.map(str::to_owned).to_vec(), rows }
}

/// The line of the pixel whose emissivity is nearest to that of the paper's Fig. 5.
fn line_of_a_pixel(material: &Material<'_>) -> Vec<Block> {
    let Material { map, sums, inputs, .. } = material;
    let resolved = |i: &usize| map.temperature_k[*i].is_finite() && map.sigma_temperature_k[*i].is_finite();
    let distance = |i: usize| (map.emissivity[i] - SHOWN_EMISSIVITY).abs();
    let Some(pixel) =
        (0..map.emissivity.len()).filter(resolved).min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
    else {
        return Vec::new();
    };
    let b = sums.blanks_per_cycle();
    let gain = inputs.flat_gain.map_or(1.0, |flat| flat[pixel]);
    let points: Vec<Point> = sums
        .levels()
        .iter()
        .zip(&inputs.x_counts)
        .filter_map(|(level, x)| {
            let n = level.count(pixel);
            let variance = accumulate::variance(level.sum(pixel), level.sum_squares(pixel), n, b);
            Some(Point {
                x: (*x)?,
                y: accumulate::mean(level.sum(pixel), n, b) / gain,
                sigma: (variance / f64::from(n)).sqrt() / gain,
            })
        })
        .collect();
    let (row, column) = (pixel / map.columns, pixel % map.columns);
    vec![
        Block::Heading("Line of a pixel".to_owned()),
        Block::Plot {
            caption: format!(
                "Row {row}, column {column}: emissivity {:.3} ± {:.3}, T_eff {:.2} ± {:.2} K.",
                map.emissivity[pixel],
                map.sigma_emissivity[pixel],
                map.temperature_k[pixel],
                map.sigma_temperature_k[pixel]
            ),
            plot: plot::pixel_line(&points, map.slope[pixel], map.offset[pixel], "level means"),
        },
    ]
}

fn warnings(material: &Material<'_>) -> Vec<String> {
    let mut found = Vec::new();
    let cycles = &material.summary["cycles"];
    if cycles["lost"].as_u64().is_some_and(|lost| lost > 0) {
        found.push(format!("{} planned cycles are missing.", cycles["lost"]));
    }
    let map = material.map;
    let spray: Vec<usize> =
        (0..map.emissivity.len()).filter(|&i| map.emissivity[i] > material.config.emissivity_min()).collect();
    let freedom = material.inputs.x_counts.iter().flatten().count().saturating_sub(2);
    if let Some(limit) = freedom.checked_sub(1).and_then(|i| CHI2_95.get(i))
        && !spray.is_empty()
    {
        let bad = spray.iter().filter(|&&i| map.chi2[i] > *limit).count() as f64 / spray.len() as f64;
        if bad > BAD_LINES_MAX {
            found.push(format!(
                "χ² of the line is above its 95 % point in {:.0} % of the spray's pixels: levels, windows or walls may be \
                 wrong, or the band is far from gray.",
                bad * 100.0
            ));
        }
    }
    let fit = &material.calibrated.calibration.fit;
    if fit.dof > 0 && fit.chi2 > CHI2_MAX * fit.dof as f64 {
        found.push(format!("The calibration's χ² is {:.1} for {} degrees of freedom.", fit.chi2, fit.dof));
    }
    let range = &fit.range;
    let warm =
        spray.iter().filter(|&&i| map.flags[i] & (flag::EXTRAPOLATED | flag::OUT_OF_RANGE) != 0).count();
    if warm > 0 {
        found.push(format!(
            "{warm} pixels of the spray are outside the calibrated range of {:.0} … {:.0} K.",
            range.low_k, range.high_k
        ));
    }
    found
}
