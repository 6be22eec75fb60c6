//! Everything behind one pixel of a map: its levels, its line, its temperature (the paper's figure 5). Pure.

use super::accumulate::{self, Sums};
use super::calibration::{Range, SakumaHattori};
use super::map::{self, DitMap, FitInputs, flag};
use super::student::Quantiles;
use serde::Serialize;

/// Confidence of the narrow sets: one standard deviation of a normal variable.
pub const CONFIDENCE_68: f64 = 0.682_689_492_137_085_9;

/// Part of a temperature range that is shown on each side of the 95 % set.
const NEIGHBOURHOOD: f64 = 0.6;
/// Half width of the neighbourhood where there is no bounded set, K.
const NEIGHBOURHOOD_K: f64 = 15.0;
/// Points of the curve that are told.
const CURVE_POINTS: u32 = 25;
/// Points of the line's band.
const BAND_POINTS: u32 = 41;

/// One level of a pixel. Numbers that are not known are NaN (null in JSON).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PixelLevel {
    /// Plate temperature, in K.
    pub plate_temperature_k: Option<f64>,
    /// x, in counts; None = left out.
    pub x_counts: Option<f64>,
    /// Cycles of this pixel that count.
    pub accepted: u32,
    /// Cycles left out of the whole level: misfires.
    pub misfires: usize,
    /// Cycles left out of this pixel as spikes.
    pub spikes: u32,
    /// Cycles left out of this pixel because a sample was saturated.
    pub saturated: u32,
    /// Mean counts of the spray frames, as recorded.
    pub mean_spray_counts: f64,
    /// Mean counts of the blanks, as recorded.
    pub mean_blank_counts: f64,
    /// Mean of spray − blank over the flat's gain: what is fitted.
    pub difference_counts: f64,
    /// Standard deviation of one cycle's difference.
    pub standard_deviation_counts: f64,
    /// Standard error of the mean difference.
    pub standard_error_counts: f64,
    /// Weight in the fit, 1/counts²; 0 where the level takes no part.
    pub weight: f64,
    /// The same as a part of all weights.
    pub weight_share: f64,
    /// The line there.
    pub fitted_counts: f64,
    /// Mean difference less the line.
    pub residual_counts: f64,
}

/// A value, its standard deviation and its sets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// The 68 % set.
    pub set_68: [f64; 2],
    /// The 95 % set.
    pub set_95: [f64; 2],
}

/// The line and where it is known to be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PixelLine {
    /// Slope, −γ_near·ε.
    pub slope: f64,
    /// Value at x = 0, in counts.
    pub offset_counts: f64,
    /// x where it is zero, in counts.
    pub crossing_counts: f64,
    /// Weighted squares of the residuals.
    pub chi2: f64,
    /// Levels less two.
    pub degrees_of_freedom: usize,
    /// x, the line, and half the width of its 68 % and 95 % band, in counts.
    pub band: Vec<[f64; 4]>,
}

/// The calibration near the pixel's temperature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PixelCurve {
    /// The curve.
    pub curve: SakumaHattori,
    /// Where it is calibrated.
    pub range: Option<Range>,
    /// I_cal(T_eff) = ε_B·(S + E_f), in counts.
    pub counts: f64,
    /// dI/dT there, in counts/K.
    pub slope_counts_per_k: f64,
    /// Temperature in K and counts of the curve about it.
    pub points: Vec<[f64; 2]>,
}

/// A flag with its meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct NamedFlag {
    /// The bit.
    pub bit: u32,
    /// Its name.
    pub name: &'static str,
    /// Its meaning.
    pub meaning: &'static str,
}

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PixelView {
    /// Row, 0 at the top.
    pub row: usize,
    /// Column, 0 at the left.
    pub column: usize,
    /// How it was weighted.
    pub estimator: &'static str,
    /// Blanks of each cycle.
    pub blanks_per_cycle: u16,
    /// Gain of the pixel by the flat.
    pub flat_gain: f64,
    /// Its levels.
    pub levels: Vec<PixelLevel>,
    /// Its line; None where the levels define none.
    pub line: Option<PixelLine>,
    /// ε.
    pub emissivity: Measured,
    /// T_eff, in K.
    pub temperature_k: Measured,
    /// The calibration near it.
    pub calibration: PixelCurve,
    /// Slope of the blanks against I_cal, and its standard deviation.
    pub gain: [f64; 2],
    /// The flags it carries.
    pub flags: Vec<NamedFlag>,
}

/// What a level is called and how many of its cycles were left out as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelFacts {
    /// Plate temperature, in K.
    pub plate_temperature_k: Option<f64>,
    /// Misfires.
    pub misfires: usize,
}

/// Looks at a pixel. `map` is the map of `sums` and `inputs` (with whatever was masked afterwards); one fact per level.
///
/// Panics when pixel, map and facts do not belong to the sums, which is the caller's mistake.
pub fn view(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    map: &DitMap,
    facts: &[LevelFacts],
    (row, column): (usize, usize),
) -> PixelView {
    assert!(row < sums.rows() && column < sums.columns(), "a pixel of the sums");
    assert!(facts.len() == sums.levels().len(), "one fact per level");
    let i = row * sums.columns() + column;
    assert!(map.flags.len() == sums.rows() * sums.columns(), "the map of the sums");
    let narrow = map::solve(sums, &FitInputs { confidence: CONFIDENCE_68, ..inputs.clone() });
    let detail = map::detail(sums, inputs, row, column);
    let gain = inputs.flat_gain.map_or(1.0, |flat| flat[i]);
    let whole: f64 = detail.as_ref().map_or(f64::NAN, |detail| detail.weights.iter().sum());
    let b = sums.blanks_per_cycle();
    let line_at = |x: Option<f64>| {
        let detail = detail.as_ref()?;
        Some(detail.line.mean_y + detail.line.slope * (x? - detail.line.mean_x))
    };
    let levels = sums
        .levels()
        .iter()
        .zip(&inputs.x_counts)
        .zip(facts)
        .enumerate()
        .map(|(k, ((level, &x), facts))| {
            let n = level.count(i);
            let difference = accumulate::mean(level.sum(i), n, b);
            let deviation = accumulate::variance(level.sum(i), level.sum_squares(i), n, b).sqrt();
            #[expect(clippy::cast_precision_loss, reason = "a mean of counts")]
            let blank = level.sum_blanks(i) as f64 / (f64::from(n) * f64::from(b));
            let weight = detail.as_ref().and_then(|detail| {
                detail.levels.iter().position(|&own| own == k).map(|at| detail.weights[at])
            });
            let fitted = line_at(x).unwrap_or(f64::NAN);
            PixelLevel {
                plate_temperature_k: facts.plate_temperature_k,
                x_counts: x,
                accepted: n,
                misfires: facts.misfires,
                spikes: level.outliers(i),
                saturated: level.saturated(i),
                mean_spray_counts: blank + difference,
                mean_blank_counts: blank,
                difference_counts: difference / gain,
                standard_deviation_counts: deviation / gain,
                standard_error_counts: deviation / gain / f64::from(n).sqrt(),
                weight: weight.unwrap_or(0.0),
                weight_share: weight.unwrap_or(0.0) / whole,
                fitted_counts: fitted,
                residual_counts: difference / gain - fitted,
            }
        })
        .collect::<Vec<_>>();
    let temperature_k = Measured {
        value: map.temperature_k[i],
        sigma: map.sigma_temperature_k[i],
        set_68: [narrow.temperature_low_k[i], narrow.temperature_high_k[i]],
        set_95: [map.temperature_low_k[i], map.temperature_high_k[i]],
    };
    let emissivity = Measured {
        value: map.emissivity[i],
        sigma: map.sigma_emissivity[i],
        set_68: [narrow.emissivity_low[i], narrow.emissivity_high[i]],
        set_95: [map.emissivity_low[i], map.emissivity_high[i]],
    };
    PixelView {
        row,
        column,
        estimator: inputs.estimator.name(),
        blanks_per_cycle: b,
        flat_gain: gain,
        line: detail.as_ref().map(|detail| line(detail, &levels)),
        levels,
        emissivity,
        temperature_k,
        calibration: curve(inputs, map.crossing[i], &temperature_k),
        gain: [map.gain[i], map.sigma_gain[i]],
        flags: flag::LEGEND
            .iter()
            .filter(|(bit, ..)| map.flags[i] & bit != 0)
            .map(|&(bit, name, meaning)| NamedFlag { bit, name, meaning })
            .collect(),
    }
}

/// The line with its band, over the levels and the crossing if that is not far off.
fn line(detail: &map::Detail, levels: &[PixelLevel]) -> PixelLine {
    let map::Detail { line, covariance, freedom, .. } = detail;
    let x = || levels.iter().filter_map(|level| level.x_counts).filter(|x| x.is_finite());
    let (low, high) = (x().fold(f64::INFINITY, f64::min), x().fold(f64::NEG_INFINITY, f64::max));
    let span = high - low;
    let near = line.crossing > low - span && line.crossing < high + span;
    let (low, high) = if near { (low.min(line.crossing), high.max(line.crossing)) } else { (low, high) };
    let margin = 0.04 * (high - low);
    let (low, high) = (low - margin, high + margin);
    // Student's t of the degrees of freedom, as the crossing's sets.
    let t = [CONFIDENCE_68, map::CONFIDENCE].map(|confidence| Quantiles::new(confidence).at(*freedom));
    let band = (0..BAND_POINTS)
        .map(|k| {
            let x = low + (high - low) * f64::from(k) / f64::from(BAND_POINTS - 1);
            let d = x - line.mean_x;
            let variance = covariance.mean + 2.0 * d * covariance.cross + d * d * covariance.slope;
            let sigma = variance.max(0.0).sqrt();
            [x, line.mean_y + line.slope * d, t[0] * sigma, t[1] * sigma]
        })
        .collect();
    PixelLine {
        slope: line.slope,
        offset_counts: line.offset,
        crossing_counts: line.crossing,
        chi2: line.chi2,
        degrees_of_freedom: detail.levels.len().saturating_sub(2),
        band,
    }
}

/// The calibration about the pixel's temperature.
fn curve(inputs: &FitInputs<'_>, crossing: f64, temperature: &Measured) -> PixelCurve {
    let counts = inputs.emissivity_plate * (crossing + inputs.far_window_counts);
    let kelvin = temperature.value;
    let [low, high] = temperature.set_95;
    let (low, high) = if low.is_finite() && high.is_finite() && high > low {
        let margin = NEIGHBOURHOOD * (high - low);
        (low - margin, high + margin)
    } else {
        (kelvin - NEIGHBOURHOOD_K, kelvin + NEIGHBOURHOOD_K)
    };
    let points = (0..CURVE_POINTS)
        .map(|k| low + (high - low) * f64::from(k) / f64::from(CURVE_POINTS - 1))
        .filter(|t| *t > 0.0)
        .map(|t| [t, inputs.curve.value(t)])
        .collect();
    PixelCurve {
        curve: inputs.curve,
        range: inputs.range,
        counts,
        slope_counts_per_k: inputs.curve.derivative(kelvin),
        points,
    }
}
