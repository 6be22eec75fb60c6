//! What a calibration holds beside its curve: flat and broken pixels, offset, noise, windows, the plate's emissivity.

use super::points::{OFFSET_REPEATABILITY_COUNTS, READING_REPEATABILITY_K, Series, mean};
use super::{CalibrateError, Calibration};
use crate::config::Config;
use crate::estimate::calibration::map_on_fit;
use crate::estimate::line;
use crate::reduce::CurveSums;
use serde::{Deserialize, Serialize};

/// A pixel that follows the plate by less than this part of the mean, or more than its inverse, is broken, not weak.
const GAIN_MIN: f64 = 0.2;

/// A pixel whose variance is this many times the median one is broken: with ten frames and half a million pixels chance
/// does not reach six.
const VARIANCE_MAX: f64 = 10.0;

/// Gains and broken pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flat {
    /// UTC of the frames.
    pub utc: String,
    /// Pixels without a usable gain, or far noisier than the others: NaN in `flat.npy`, left out of maps.
    pub broken_pixels: usize,
    /// Standard deviation of the other gains.
    pub gain_spread: f64,
    /// Temperatures of the plate, in K, ascending.
    pub plate_k: Vec<f64>,
}

/// Gain of each pixel, `[row · columns + column]`, and its figures.
#[derive(Debug, Clone)]
pub struct FlatMap {
    /// Relative gain, mean 1; NaN for broken pixels.
    pub gains: Vec<f64>,
    /// Its figures.
    pub figures: Flat,
}

/// Gains of all pixels against the mean picture, and which are broken. A gain is counts over counts of the same frames:
/// nominal signals do not enter.
pub fn flat(series: &Series, sums: &CurveSums, utc: &str) -> FlatMap {
    let mut gains = gains(series);
    let variances = variances(sums);
    let mut sorted: Vec<f64> = variances.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN);
    for (gain, variance) in gains.iter_mut().zip(&variances) {
        let steady = median > 0.0 && *variance <= 0.0;
        if !(GAIN_MIN..=1.0 / GAIN_MIN).contains(gain) || *variance > VARIANCE_MAX * median || steady {
            *gain = f64::NAN;
        }
    }
    let good: Vec<f64> = gains.iter().copied().filter(|gain| gain.is_finite()).collect();
    let centre = mean(&good);
    let squares: f64 = good.iter().map(|gain| (gain - centre) * (gain - centre)).sum();
    let figures = Flat {
        utc: utc.to_owned(),
        broken_pixels: gains.len() - good.len(),
        gain_spread: (squares / good.len() as f64).sqrt(),
        plate_k: series.points.iter().map(|point| point.temperature_k).collect(),
    };
    FlatMap { gains, figures }
}

/// Least-squares gain of every pixel: through zero above a shutter, about the mean where the offset is still in.
fn gains(series: &Series) -> Vec<f64> {
    let counts: Vec<f64> = series.points.iter().map(|point| point.counts).collect();
    let pivot = if series.shutter_k.is_some() { 0.0 } else { mean(&counts) };
    let pixels = series.differences.first().map_or(0, Vec::len);
    let mut cross = vec![0.0; pixels];
    for (counts, difference) in counts.iter().zip(&series.differences) {
        for (sum, value) in cross.iter_mut().zip(difference) {
            // Σ (I − pivot) (d − anything) is the same for a pivot that is the mean.
            *sum += (counts - pivot) * value;
        }
    }
    let square: f64 = counts.iter().map(|counts| (counts - pivot) * (counts - pivot)).sum();
    cross.iter().map(|sum| sum / square).collect()
}

/// Variance of each pixel from frame to frame, in counts², mean over all series of frames; NaN below two frames.
fn variances(sums: &CurveSums) -> Vec<f64> {
    let pixels = sums.plate.first().map_or(0, Vec::len);
    let mut total = vec![0.0; pixels];
    let mut freedom = 0.0;
    let plates = sums.plate.iter().zip(&sums.plate_squares).zip(&sums.plate_frames);
    let shutters = sums.shutter.iter().zip(&sums.shutter_squares).zip(&sums.shutter_frames);
    for ((sum, squares), &frames) in plates.chain(shutters).filter(|(_, frames)| **frames > 1) {
        freedom += f64::from(frames - 1);
        for ((total, &sum), &square) in total.iter_mut().zip(sum).zip(squares) {
            *total += spread(sum, square, frames);
        }
    }
    total.into_iter().map(|total| total / freedom).collect()
}

/// Σ (count − mean)², exact: the integers are.
fn spread(sum: u64, squares: u64, frames: u32) -> f64 {
    let n = u128::from(frames);
    let scaled = n * u128::from(squares) - u128::from(sum) * u128::from(sum);
    scaled as f64 / f64::from(frames)
}

/// Counts without light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OffsetReference {
    /// UTC of the frames.
    pub utc: String,
    /// Mean counts with the shutter closed, over all pixels; its own light is in it.
    pub counts: f64,
    /// Standard deviation of `counts`: what is left of a count after averaging, and the scatter between levels.
    pub sigma_counts: f64,
    /// Temperature of the shutter, in K.
    pub shutter_k: f64,
}

/// The offset from the frames with the shutter closed.
///
/// # Errors
///
/// [`CalibrateError::Missing`] when there are none.
pub fn offset(series: &Series, utc: &str) -> Result<OffsetReference, CalibrateError> {
    let (Some(shutter_k), Some(counts)) = (series.shutter_k, series.dark_counts) else {
        return Err(CalibrateError::Missing(
            "the offset needs frames with the shutter closed; without a shutter it is fitted with the curve (--kind standard)"
                .to_owned(),
        ));
    };
    let scatter = if series.dark_scatter_counts.is_finite() { series.dark_scatter_counts } else { 0.0 };
    Ok(OffsetReference {
        utc: utc.to_owned(),
        counts,
        sigma_counts: scatter.hypot(OFFSET_REPEATABILITY_COUNTS),
        shutter_k,
    })
}

/// Electrons per count and read noise, by photon transfer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NoiseFigures {
    /// UTC of the frames.
    pub utc: String,
    /// Electrons of one count.
    pub electrons_per_count: f64,
    /// Standard deviation.
    pub sigma_electrons_per_count: f64,
    /// Read noise in counts, rounding to whole counts taken out; 0 when it is lost below it.
    pub read_noise_counts: f64,
    /// Standard deviation.
    pub sigma_read_noise_counts: f64,
    /// χ² of the straight line of variance against counts.
    pub chi2: f64,
    /// Points less two.
    pub dof: usize,
}

/// Photon transfer: the variance of a pixel from frame to frame rises by one count² per count and electron-per-count.
/// Pixels whose gain in `gains` is NaN are left out.
///
/// # Errors
///
/// [`CalibrateError::Missing`] when frames are too few or their noise does not rise with the light.
pub fn noise(sums: &CurveSums, gains: &[f64], utc: &str) -> Result<NoiseFigures, CalibrateError> {
    let (mut counts, mut variance, mut weight) = (Vec::new(), Vec::new(), Vec::new());
    let plates = sums.plate.iter().zip(&sums.plate_squares).zip(&sums.plate_frames);
    let shutters = sums.shutter.iter().zip(&sums.shutter_squares).zip(&sums.shutter_frames);
    let dark = shutters.clone().find(|(_, frames)| **frames > 1);
    for ((sum, squares), &frames) in plates.chain(shutters).filter(|(_, frames)| **frames > 1) {
        let (mut total, mut spreads, mut pixels) = (0.0, 0.0, 0.0);
        for ((&sum, &square), gain) in sum.iter().zip(squares).zip(gains) {
            if gain.is_finite() {
                total += sum as f64 / f64::from(frames);
                spreads += spread(sum, square, frames) / f64::from(frames - 1);
                pixels += 1.0;
            }
        }
        if pixels < 1.0 {
            continue;
        }
        let v = spreads / pixels;
        counts.push(total / pixels);
        variance.push(v);
        // The variance of a mean of sample variances of normal noise; a constant picture still has a weight.
        let of_v = 2.0 * v.max(1e-6) * v.max(1e-6) / (f64::from(frames - 1) * pixels);
        weight.push(1.0 / of_v);
    }
    let poor = |why: &str| CalibrateError::Missing(format!("photon transfer: {why}"));
    if dark.is_none() {
        return Err(poor("no frames with the shutter closed to say where the light begins"));
    }
    // The shutter's frames stand last; their own light is a count at most, its shot noise 1e-3 of the read noise.
    let zero = counts.last().copied().unwrap_or(f64::NAN);
    let signal: Vec<f64> = counts.iter().map(|counts| counts - zero).collect();
    let line = line::weighted(&signal, &variance, &weight)
        .ok_or_else(|| poor("two frames at two levels at least are needed"))?;
    let covariance = line.covariance();
    if line.slope.is_nan() || line.slope <= 3.0 * covariance.slope.sqrt() {
        return Err(poor("the noise does not rise with the light; take more frames or hotter levels"));
    }
    let dof = signal.len() - 2;
    let excess = if dof > 0 { (line.chi2 / dof as f64).max(1.0) } else { 1.0 };
    let read = (line.offset - line::ROUNDING_VARIANCE).max(0.0).sqrt();
    let of_offset = (line.offset_variance(&covariance) * excess).sqrt();
    Ok(NoiseFigures {
        utc: utc.to_owned(),
        electrons_per_count: 1.0 / line.slope,
        sigma_electrons_per_count: (covariance.slope * excess).sqrt() / (line.slope * line.slope),
        read_noise_counts: read,
        // d read = d variance/(2 read); where it is lost below rounding, the root of what it could be.
        sigma_read_noise_counts: if read * read > of_offset {
            of_offset / (2.0 * read)
        } else {
            of_offset.sqrt()
        },
        chi2: line.chi2,
        dof,
    })
}

/// The windows, from frames through them at the levels of the curve without.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Windows {
    /// UTC of the frames.
    pub utc: String,
    /// Transmittance of all windows that were mounted: γ_far · γ_near.
    pub transmittance: f64,
    /// Standard deviation, the curve's own uncertainty included.
    pub sigma_transmittance: f64,
    /// E_f: light of the far window, what it mirrors, and the plate's own mirrored room, in counts before the near
    /// window; it is true for walls as they were.
    pub far_window_counts: f64,
    /// Standard deviation.
    pub sigma_far_window_counts: f64,
    /// χ² of the points with windows on the curve without.
    pub chi2: f64,
    /// Points less two.
    pub dof: usize,
}

/// Transmittance of the windows: the slope of the counts with against those without, at equal plate temperatures; the
/// constant is the far window's light.
///
/// # Errors
///
/// [`CalibrateError::Fit`] when the points with windows do not follow the curve.
pub fn windows(
    with: &Series,
    without: &Calibration,
    config: &Config,
    utc: &str,
) -> Result<Windows, CalibrateError> {
    let fit = &without.fit;
    let line = map_on_fit(fit, &with.points).map_err(|error| CalibrateError::Fit(error.to_string()))?;
    let excess = if line.dof > 0 { (line.chi2 / line.dof as f64).max(1.0) } else { 1.0 };
    // The slope hangs on the hot end: what the curve may be wrong there goes over whole.
    let hot = with.points.iter().map(|point| point.temperature_k).fold(0.0, f64::max);
    let relative = fit.variance_of(&fit.gradient(hot)).sqrt() / fit.counts(hot);
    let shutter = with.shutter_k.map_or(0.0, |kelvin| fit.counts(kelvin) / config.optics.emissivity_plate);
    Ok(Windows {
        utc: utc.to_owned(),
        transmittance: line.gain,
        sigma_transmittance: (line.covariance[0][0] * excess).sqrt().hypot(line.gain * relative),
        far_window_counts: (line.offset_counts + shutter) / config.optics.gamma_near,
        sigma_far_window_counts: (line.covariance[1][1] * excess).sqrt() / config.optics.gamma_near,
        chi2: line.chi2,
        dof: line.dof,
    })
}

/// ε_B of the plate in the band of the camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlateEmissivity {
    /// UTC of the frames.
    pub utc: String,
    /// ε_B.
    pub emissivity: f64,
    /// Standard deviation.
    pub sigma_emissivity: f64,
    /// How it was found.
    pub method: String,
}

/// ε_B from what the plate mirrors: with the surroundings at T₁ and T₂ the plate's picture moves by
/// (1 − ε_B)·(I_BB(T₂) − I_BB(T₁)), and I_BB is the curve over ε_B.
///
/// # Errors
///
/// [`CalibrateError::Fit`] when the surroundings give no signal.
pub fn plate_from_ambient(
    [cool, warm]: [&Series; 2],
    ambient_k: [f64; 2],
    curve: &Calibration,
    utc: &str,
) -> Result<PlateEmissivity, CalibrateError> {
    let fit = &curve.fit;
    let ([before, ..], [after, ..]) = (&cool.points[..], &warm.points[..]) else {
        return Err(CalibrateError::Incomplete { level: 1, what: "frames" });
    };
    // The plate may have moved between the two.
    let moved = fit.counts(after.temperature_k) - fit.counts(before.temperature_k);
    let mirrored = after.counts - before.counts - moved;
    let offered = fit.counts(ambient_k[1]) - fit.counts(ambient_k[0]);
    if offered.is_nan() || offered <= 0.0 {
        return Err(CalibrateError::Fit("the two surroundings give the same light".to_owned()));
    }
    let ratio = mirrored / offered;
    // Between the two series nothing is common: the offset's and the reading's repeatability count twice.
    let reading = fit.derivative(after.temperature_k) * READING_REPEATABILITY_K;
    let sigma = std::f64::consts::SQRT_2 * OFFSET_REPEATABILITY_COUNTS.hypot(reading);
    let [warm_by, cool_by] = [fit.gradient(ambient_k[1]), fit.gradient(ambient_k[0])];
    let curves = fit.variance_of(&std::array::from_fn(|i| warm_by[i] - cool_by[i])).sqrt() / offered;
    let of_ratio = (sigma / offered).hypot(ratio * curves);
    let emissivity = 1.0 / (1.0 + ratio);
    Ok(PlateEmissivity {
        utc: utc.to_owned(),
        emissivity,
        sigma_emissivity: of_ratio * emissivity * emissivity,
        method: format!("mirrored surroundings at {} K and {} K", ambient_k[0], ambient_k[1]),
    })
}

/// ε_B from the curve of a body whose emissivity is known (a cavity): the plate's curve is it, times ε_B over the
/// reference's, and a constant that the plate mirrors.
///
/// # Errors
///
/// [`CalibrateError::Key`] when the reference was seen by another set-up, [`CalibrateError::Fit`] when the curves differ
/// by more than a factor and a constant.
pub fn plate_from_reference(
    plate: &Calibration,
    reference: &Calibration,
    reference_emissivity: f64,
    utc: &str,
) -> Result<PlateEmissivity, CalibrateError> {
    if plate.key != reference.key {
        return Err(CalibrateError::Key { made: reference.key.to_string(), used: plate.key.to_string() });
    }
    // Points of the plate only: the shutter is no plate.
    let points: Vec<_> = plate.points.iter().filter(|point| point.counts.abs() > 0.0).copied().collect();
    let line = map_on_fit(&reference.fit, &points).map_err(|error| CalibrateError::Fit(error.to_string()))?;
    let excess = if line.dof > 0 { (line.chi2 / line.dof as f64).max(1.0) } else { 1.0 };
    let hot = points.iter().map(|point| point.temperature_k).fold(0.0, f64::max);
    let relative = reference.fit.variance_of(&reference.fit.gradient(hot)).sqrt() / reference.fit.counts(hot);
    Ok(PlateEmissivity {
        utc: utc.to_owned(),
        emissivity: reference_emissivity * line.gain,
        sigma_emissivity: reference_emissivity
            * (line.covariance[0][0] * excess).sqrt().hypot(line.gain * relative),
        method: format!("against a body of emissivity {reference_emissivity}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::CalibrationPoint;

    /// Four pixels at two levels of ten frames above a shutter: an ordinary one, a weaker one, one that is stuck, one
    /// that flickers. `frames(level, pixel)` are their counts.
    fn sums(frames: impl Fn(usize, usize) -> Vec<u64>) -> (Series, CurveSums) {
        let sum = |level: usize| (0..4).map(|p| frames(level, p).iter().sum()).collect::<Vec<u64>>();
        let squares =
            |level: usize| (0..4).map(|p| frames(level, p).iter().map(|c| c * c).sum()).collect::<Vec<u64>>();
        let levels = 0..3_usize;
        let sums = CurveSums {
            plate: levels.clone().skip(1).map(sum).collect(),
            plate_squares: levels.clone().skip(1).map(squares).collect(),
            plate_frames: vec![10; 2],
            shutter: vec![sum(0); 2],
            shutter_squares: vec![squares(0); 2],
            shutter_frames: vec![10; 2],
            shutter_k: vec![Some(296.0); 2],
        };
        let differences: Vec<Vec<f64>> = (0..2)
            .map(|l| (0..4).map(|p| (sums.plate[l][p] as f64 - sums.shutter[l][p] as f64) / 10.0).collect())
            .collect();
        let points = differences
            .iter()
            .zip([400.0, 500.0])
            .map(|(d, temperature_k)| CalibrationPoint { temperature_k, counts: mean(d), sigma_counts: 0.1 })
            .collect();
        let series = Series {
            points,
            differences,
            shutter_k: Some(296.0),
            dark_counts: Some(1000.0),
            dark_scatter_counts: 0.0,
        };
        (series, sums)
    }

    #[test]
    fn broken_pixels_have_no_gain_and_weak_ones_keep_theirs() {
        let (series, sums) = sums(|level, pixel| {
            let signal = [0, 100, 400][level] * [10, 8, 0, 10][pixel] / 10;
            let flicker = [1, 1, 0, 30][pixel];
            (0..10).map(|i| 1000 + signal + if i % 2 == 0 { flicker } else { 0 }).collect()
        });
        let flat = flat(&series, &sums, "");
        assert!((flat.gains[1] / flat.gains[0] - 0.8).abs() < 1e-9, "{:?}", flat.gains);
        assert!(flat.gains[2].is_nan() && flat.gains[3].is_nan(), "{:?}", flat.gains);
        assert_eq!(flat.figures.broken_pixels, 2);
    }

    /// A noise that is the same with and without light gives no electrons; an offset needs a shutter.
    #[test]
    fn noise_that_does_not_rise_is_refused() {
        let (series, sums) =
            sums(|level, _| (0..10).map(|i| 1000 + [0, 100, 400][level] + 2 * (i % 2)).collect());
        let gains = vec![1.0; 4];
        assert!(noise(&sums, &gains, "").is_err());
        assert!(offset(&series, "").is_ok());
        let none = Series { shutter_k: None, dark_counts: None, ..series };
        assert!(matches!(offset(&none, ""), Err(CalibrateError::Missing(_))));
    }
}
