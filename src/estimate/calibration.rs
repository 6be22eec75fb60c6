//! The camera's curve: counts against the temperature of a black body, and back.
//!
//! The Sakuma–Hattori equation in Planck form has three parameters, is monotone and has a closed inverse; it follows
//! filtered 3–5 µm cameras to a millikelvin where straight interpolation of ten points errs by kelvins
//! (F. Sakuma, S. Hattori 1982; recommended below the silver point by BIPM CCT-WG5).
//! Does not acquire calibrations and does not know which camera, lens or filter they belong to.

use serde::{Deserialize, Serialize};

/// Second radiation constant, in µm K (CODATA 2018, exact: hc/k).
pub const C2_UM_K: f64 = 14_387.768_775;

/// A reading is extrapolated by at most this fraction of the calibrated range, measured in 1/T.
pub(super) const EXTRAPOLATION_MAX: f64 = 0.1;

/// Iterations of the fit. Ordinary fits need 5 to 15; with this many the damping has tried everything.
const ITERATIONS_MAX: usize = 200;

/// I(T) = A / (exp(c2 / (a T + b)) − 1), counts without offset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SakumaHattori {
    /// A, in counts.
    pub a_counts: f64,
    /// a, in µm: near the mean effective wavelength.
    pub a_um: f64,
    /// b, in µm K: how the effective wavelength shifts with temperature.
    pub b_um_k: f64,
}

impl SakumaHattori {
    /// Counts of a black body at `temperature_k`, without offset. Relative error below (5 + 3u)·2⁻⁵³ with
    /// u = c2/(aT+b). Zero where a T + b ≤ 0.
    pub fn value(&self, temperature_k: f64) -> f64 {
        let w = self.a_um * temperature_k + self.b_um_k;
        if w <= 0.0 { 0.0 } else { self.a_counts / libm::expm1(C2_UM_K / w) }
    }

    /// Temperature, in K, of a black body that gives `counts` above the offset. NaN for counts ≤ 0 or NaN.
    pub fn inverse(&self, counts: f64) -> f64 {
        if counts > 0.0 {
            (C2_UM_K / libm::log1p(self.a_counts / counts) - self.b_um_k) / self.a_um
        } else {
            f64::NAN
        }
    }

    /// dT/dI, in K/count, where the curve gives `counts` > 0 at `temperature_k` = inverse(counts): no exponential.
    pub fn inverse_derivative(&self, counts: f64, temperature_k: f64) -> f64 {
        let w = self.a_um * temperature_k + self.b_um_k;
        w * w / (counts * (1.0 + counts / self.a_counts) * C2_UM_K * self.a_um)
    }

    /// dI/dT at `temperature_k`, in counts/K. Zero where a T + b ≤ 0.
    pub fn derivative(&self, temperature_k: f64) -> f64 {
        let w = self.a_um * temperature_k + self.b_um_k;
        if w <= 0.0 {
            return 0.0;
        }
        let counts = self.value(temperature_k);
        counts * (1.0 + counts / self.a_counts) * C2_UM_K * self.a_um / (w * w)
    }
}

/// Where a temperature stands against the calibrated range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// Between the coldest and the hottest point of the calibration.
    Inside,
    /// Outside by at most 10 % of the range in 1/T.
    Extrapolated,
    /// Further outside, or without a temperature: no answer.
    Outside,
}

/// The calibrated range of temperatures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Temperature of the coldest point, in K.
    pub low_k: f64,
    /// Temperature of the hottest point, in K.
    pub high_k: f64,
}

impl Range {
    /// Where `temperature_k` stands; NaN is outside.
    pub fn reach(&self, temperature_k: f64) -> Reach {
        let (cold, hot) = (1.0 / self.low_k, 1.0 / self.high_k);
        let margin = EXTRAPOLATION_MAX * (cold - hot);
        let at = 1.0 / temperature_k;
        if self.low_k <= temperature_k && temperature_k <= self.high_k {
            Reach::Inside
        } else if temperature_k > 0.0 && at <= cold + margin && at >= hot - margin {
            Reach::Extrapolated
        } else {
            Reach::Outside
        }
    }
}

/// One point of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationPoint {
    /// Temperature of the black body, in K.
    pub temperature_k: f64,
    /// Mean counts of the camera.
    pub counts: f64,
    /// Standard deviation of `counts`, > 0.
    pub sigma_counts: f64,
}

/// What is known of the counts without light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OffsetMode {
    /// They are this many and have been measured otherwise.
    Known(f64),
    /// They are fitted with the curve: needs a fourth point and doubles the error of T.
    Free,
}

/// A fitted curve with what is needed to judge it. Serialises as `calibration.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFit {
    /// The curve, counts above the offset.
    pub curve: SakumaHattori,
    /// Counts without light.
    pub offset_counts: f64,
    /// Covariance of (ln A, a in µm, b in µm K, offset in counts), from the points' sigmas. The last row is zero for
    /// a known offset.
    pub covariance: [[f64; 4]; 4],
    /// Σ ((counts − curve)/sigma)².
    pub chi2: f64,
    /// Points less parameters.
    pub dof: usize,
    /// Coldest and hottest point.
    pub range: Range,
    /// counts − curve, in counts, in the order of the points.
    pub residuals: Vec<f64>,
    /// Iterations used.
    pub iterations: usize,
}

impl CalibrationFit {
    /// Standard deviation, in counts, of the curve above its offset at `temperature_k`: common to all pixels.
    pub fn sigma_counts(&self, temperature_k: f64) -> f64 {
        let gradient = gradient(&self.curve, temperature_k);
        let mut variance = 0.0;
        for (i, gi) in gradient[..3].iter().enumerate() {
            for (j, gj) in gradient[..3].iter().enumerate() {
                variance += gi * gj * self.covariance[i][j];
            }
        }
        variance.max(0.0).sqrt()
    }
}

/// Why a calibration could not be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// calibration curve: {given} different temperatures for {needed} parameters. Add points, or measure the offset.
    #[error(
        "calibration curve: {given} different temperatures for {needed} parameters. Add points, or measure the offset."
    )]
    TooFewPoints {
        /// Different temperatures given.
        given: usize,
        /// Parameters to fit.
        needed: usize,
    },
    /// calibration curve: point {index} is not usable: temperature and sigma must be positive, all finite.
    #[error(
        "calibration curve: point {index} is not usable: temperature and sigma must be positive, all finite."
    )]
    BadPoint {
        /// Its place, from 0.
        index: usize,
    },
    /// calibration curve: the counts do not rise with temperature like a black body. Check the points and the offset.
    #[error(
        "calibration curve: the counts do not rise with temperature like a black body. Check the points and the offset."
    )]
    NotABlackBody,
}

/// Fits the curve to 3 to 50 points by damped least squares (Levenberg–Marquardt) from start values of its own.
///
/// Noise-free points of the exact form come back to rounding: below 1e-6 K between the points.
///
/// # Errors
///
/// When points are fewer than parameters, not finite, or do not follow any rising curve.
pub fn fit_curve(
    points: &[CalibrationPoint],
    offset: OffsetMode,
) -> Result<CalibrationFit, CalibrationError> {
    check(points, offset)?;
    let start = start(points, offset).ok_or(CalibrationError::NotABlackBody)?;
    let (best, iterations) = descend(points, start);
    let Parameters { curve, offset_counts, free_offset, .. } = best;
    let finite = curve.a_counts.is_finite() && curve.a_um.is_finite() && curve.b_um_k.is_finite();
    if !finite || curve.a_counts <= 0.0 || curve.a_um <= 0.0 {
        return Err(CalibrationError::NotABlackBody);
    }
    let residuals: Vec<f64> =
        points.iter().map(|p| p.counts - curve.value(p.temperature_k) - offset_counts).collect();
    let chi2 = residuals.iter().zip(points).map(|(r, p)| (r / p.sigma_counts) * (r / p.sigma_counts)).sum();
    let fold = |pick: fn(f64, f64) -> f64| points.iter().map(|p| p.temperature_k).fold(f64::NAN, pick);
    Ok(CalibrationFit {
        curve,
        offset_counts,
        covariance: covariance(points, &best),
        chi2,
        dof: points.len() - (3 + usize::from(free_offset)),
        range: Range { low_k: fold(f64::min), high_k: fold(f64::max) },
        residuals,
        iterations,
    })
}

fn check(points: &[CalibrationPoint], offset: OffsetMode) -> Result<(), CalibrationError> {
    let bad = |p: &CalibrationPoint| {
        !(p.temperature_k.is_finite()
            && p.temperature_k > 0.0
            && p.counts.is_finite()
            && p.sigma_counts.is_finite()
            && p.sigma_counts > 0.0)
    };
    if let Some(index) = points.iter().position(bad) {
        return Err(CalibrationError::BadPoint { index });
    }
    let mut temperatures: Vec<f64> = points.iter().map(|p| p.temperature_k).collect();
    temperatures.sort_by(f64::total_cmp);
    temperatures.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    let needed = if offset == OffsetMode::Free { 4 } else { 3 };
    if temperatures.len() < needed {
        return Err(CalibrationError::TooFewPoints { given: temperatures.len(), needed });
    }
    Ok(())
}

#[derive(Debug, Clone, Copy)]
struct Parameters {
    curve: SakumaHattori,
    offset_counts: f64,
    free_offset: bool,
    /// Temperature at which the fit's own variables are taken: ln I and a T + b there, and a.
    pivot_k: f64,
}

impl Parameters {
    fn chi2(&self, points: &[CalibrationPoint]) -> f64 {
        points
            .iter()
            .map(|p| {
                let r = (p.counts - self.offset_counts - self.curve.value(p.temperature_k)) / p.sigma_counts;
                r * r
            })
            .sum()
    }

    /// Steps in (ln I(pivot), ln(a·pivot + b), a, offset). These are nearly independent, while A, a and b are
    /// correlated to 1e-6.
    fn stepped(&self, step: &[f64; 4]) -> Self {
        let SakumaHattori { a_counts, a_um, b_um_k } = self.curve;
        let w = a_um * self.pivot_k + b_um_k;
        let w_new = w * libm::exp(step[1]);
        let a_new = a_um + step[2];
        let ratio = libm::exp(step[0]) * libm::expm1(C2_UM_K / w_new) / libm::expm1(C2_UM_K / w);
        let curve =
            SakumaHattori { a_counts: a_counts * ratio, a_um: a_new, b_um_k: w_new - a_new * self.pivot_k };
        Self { curve, offset_counts: self.offset_counts + step[3], ..*self }
    }

    /// d(counts)/d(step) at one temperature.
    fn jacobian(&self, temperature_k: f64) -> [f64; 4] {
        let SakumaHattori { a_counts, a_um, b_um_k } = self.curve;
        let counts = self.curve.value(temperature_k);
        let w = a_um * temperature_k + b_um_k;
        let pivot = a_um * self.pivot_k + b_um_k;
        // d ln I / dw at T, and what A does to hold ln I at the pivot.
        let here = (1.0 + counts / a_counts) * C2_UM_K / (w * w);
        let there = (1.0 + self.curve.value(self.pivot_k) / a_counts) * C2_UM_K / (pivot * pivot);
        let offset = if self.free_offset { 1.0 } else { 0.0 };
        [counts, counts * (here - there) * pivot, counts * here * (temperature_k - self.pivot_k), offset]
    }
}

/// Start values: for each of many effective wavelengths (b = 0) the curve is linear in A and offset; the best wins.
fn start(points: &[CalibrationPoint], offset: OffsetMode) -> Option<Parameters> {
    // Weighted by counts the hot end matters most; the pivot is the middle of the range in 1/T.
    let cold = points.iter().map(|p| 1.0 / p.temperature_k).fold(0.0, f64::max);
    let hot = points.iter().map(|p| 1.0 / p.temperature_k).fold(f64::INFINITY, f64::min);
    let pivot_k = 2.0 / (cold + hot);
    let mut best: Option<(f64, Parameters)> = None;
    for i in 0..64 {
        // 0.5 … 30 µm, in steps of 7 %.
        let a_um = 0.5 * libm::pow(60.0, f64::from(i) / 63.0);
        let shape = SakumaHattori { a_counts: 1.0, a_um, b_um_k: 0.0 };
        let Some((a_counts, offset_counts)) = scaled(points, &shape, offset) else { continue };
        let parameters = Parameters {
            curve: SakumaHattori { a_counts, ..shape },
            offset_counts,
            free_offset: offset == OffsetMode::Free,
            pivot_k,
        };
        let chi2 = parameters.chi2(points);
        if chi2.is_finite() && best.as_ref().is_none_or(|(least, _)| chi2 < *least) {
            best = Some((chi2, parameters));
        }
    }
    best.map(|(_, parameters)| parameters)
}

/// Best A (and offset) for a given shape; None unless A > 0.
fn scaled(points: &[CalibrationPoint], shape: &SakumaHattori, offset: OffsetMode) -> Option<(f64, f64)> {
    // The shape spans many decades: scaled to 1 at the hottest point.
    let top = points.iter().map(|p| shape.value(p.temperature_k)).fold(0.0, f64::max);
    let x: Vec<f64> = points.iter().map(|p| shape.value(p.temperature_k) / top).collect();
    let w: Vec<f64> = points.iter().map(|p| 1.0 / (p.sigma_counts * p.sigma_counts)).collect();
    let (scale, offset_counts) = match offset {
        OffsetMode::Known(offset) => {
            let (mut up, mut down) = (0.0, 0.0);
            for ((x, w), p) in x.iter().zip(&w).zip(points) {
                up += w * x * (p.counts - offset);
                down += w * x * x;
            }
            (up / down, offset)
        }
        OffsetMode::Free => {
            let y: Vec<f64> = points.iter().map(|p| p.counts).collect();
            let line = super::line::weighted(&x, &y, &w)?;
            (line.slope, line.offset)
        }
    };
    let a_counts = scale / top;
    (a_counts.is_finite() && a_counts > 0.0).then_some((a_counts, offset_counts))
}

/// Levenberg–Marquardt with Marquardt's scaling. Stops when a step changes no count by 1e-12 of its sigma or
/// 1e-15 of itself, or nothing gets better any more.
fn descend(points: &[CalibrationPoint], start: Parameters) -> (Parameters, usize) {
    let mut at = start;
    let mut chi2 = at.chi2(points);
    let mut damping = 1e-3;
    for iteration in 1..=ITERATIONS_MAX {
        let (rows, residuals) = linearised(points, &at);
        let step = damped_step(&rows, &residuals, damping);
        let next = at.stepped(&step);
        let next_chi2 = next.chi2(points);
        if next.curve.a_um > 0.0 && next_chi2 <= chi2 {
            let gain = chi2 - next_chi2;
            let moved = rows.iter().map(|row| dot(row, &step).abs()).fold(0.0, f64::max);
            at = next;
            chi2 = next_chi2;
            damping = (damping * 0.1).max(1e-14);
            if moved < 1e-12 || (gain <= 1e-16 * chi2 && moved < 1e-7) {
                return (at, iteration);
            }
        } else {
            damping *= 10.0;
            if damping > 1e12 {
                return (at, iteration);
            }
        }
    }
    (at, ITERATIONS_MAX)
}

fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn linearised(points: &[CalibrationPoint], at: &Parameters) -> (Vec<[f64; 4]>, Vec<f64>) {
    points
        .iter()
        .map(|p| {
            let row = at.jacobian(p.temperature_k).map(|d| d / p.sigma_counts);
            let r = (p.counts - at.offset_counts - at.curve.value(p.temperature_k)) / p.sigma_counts;
            (row, r)
        })
        .unzip()
}

/// Least-squares step of the rows extended by √damping · column norm.
fn damped_step(rows: &[[f64; 4]], residuals: &[f64], damping: f64) -> [f64; 4] {
    let norms = column_norms(rows);
    let mut all: Vec<[f64; 4]> = rows.iter().map(|row| std::array::from_fn(|j| row[j] / norms[j])).collect();
    let mut right = residuals.to_vec();
    for j in 0..4 {
        let mut row = [0.0; 4];
        row[j] = damping.sqrt();
        all.push(row);
        right.push(0.0);
    }
    let scaled = solve(all, right).1;
    std::array::from_fn(|j| scaled[j] / norms[j])
}

fn column_norms(rows: &[[f64; 4]]) -> [f64; 4] {
    std::array::from_fn(|j| {
        let norm = rows.iter().map(|row| row[j] * row[j]).sum::<f64>().sqrt();
        if norm > 0.0 { norm } else { 1.0 }
    })
}

/// Modified Gram–Schmidt on the augmented matrix: returns R and the solution. A column without content gives zero.
fn solve(mut rows: Vec<[f64; 4]>, mut right: Vec<f64>) -> ([[f64; 4]; 4], [f64; 4]) {
    let mut r = [[0.0; 4]; 4];
    let mut z = [0.0; 4];
    for j in 0..4 {
        let norm = rows.iter().map(|row| row[j] * row[j]).sum::<f64>().sqrt();
        r[j][j] = norm;
        if norm <= 1e-150 {
            continue;
        }
        rows.iter_mut().for_each(|row| row[j] /= norm);
        for k in j + 1..4 {
            let projection: f64 = rows.iter().map(|row| row[j] * row[k]).sum();
            r[j][k] = projection;
            rows.iter_mut().for_each(|row| row[k] -= projection * row[j]);
        }
        let projection: f64 = rows.iter().zip(&right).map(|(row, right)| row[j] * right).sum();
        z[j] = projection;
        rows.iter().zip(&mut right).for_each(|(row, right)| *right -= projection * row[j]);
    }
    let mut x = [0.0; 4];
    for j in (0..4).rev() {
        let above: f64 = (j + 1..4).map(|k| r[j][k] * x[k]).sum();
        x[j] = if r[j][j] > 1e-150 { (z[j] - above) / r[j][j] } else { 0.0 };
    }
    (r, x)
}

/// d(counts)/d(ln A, a, b, offset).
fn gradient(curve: &SakumaHattori, temperature_k: f64) -> [f64; 4] {
    let counts = curve.value(temperature_k);
    let w = curve.a_um * temperature_k + curve.b_um_k;
    let by_w = counts * (1.0 + counts / curve.a_counts) * C2_UM_K / (w * w);
    [counts, by_w * temperature_k, by_w, 1.0]
}

/// Covariance of (ln A, a, b, offset): computed in the fit's own variables, then transformed, so that the strong
/// correlation of A, a and b costs no digits.
fn covariance(points: &[CalibrationPoint], at: &Parameters) -> [[f64; 4]; 4] {
    let (rows, residuals) = linearised(points, at);
    let norms = column_norms(&rows);
    let scaled = rows.iter().map(|row| std::array::from_fn(|j| row[j] / norms[j])).collect();
    let (r, _) = solve(scaled, residuals);
    let inverse = upper_inverse(&r);
    let mut own = [[0.0; 4]; 4];
    for (i, row) in own.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            *cell = dot(&inverse[i], &inverse[j]) / (norms[i] * norms[j]);
        }
    }
    let SakumaHattori { a_counts, a_um, b_um_k } = at.curve;
    let pivot = a_um * at.pivot_k + b_um_k;
    let there = (1.0 + at.curve.value(at.pivot_k) / a_counts) * C2_UM_K / (pivot * pivot);
    // Rows: ln A, a, b, offset; columns: ln I(pivot), ln w(pivot), a, offset.
    let change = [
        [1.0, -there * pivot, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, pivot, -at.pivot_k, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    let mut out = [[0.0; 4]; 4];
    for (i, row) in out.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            for (k, own) in own.iter().enumerate() {
                *cell += change[i][k] * dot(own, &change[j]);
            }
        }
    }
    out
}

/// Inverse of an upper triangle; rows of absent parameters are zero.
fn upper_inverse(r: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
    // By columns: column c solves R·z = e_c from below.
    let columns: [[f64; 4]; 4] = std::array::from_fn(|column| {
        let mut z = [0.0; 4];
        for i in (0..=column).rev() {
            let unit = if i == column { 1.0 } else { 0.0 };
            let above: f64 = (i + 1..=column).map(|k| r[i][k] * z[k]).sum();
            z[i] = if r[i][i] > 1e-12 { (unit - above) / r[i][i] } else { 0.0 };
        }
        z
    });
    std::array::from_fn(|row| columns.map(|column| column[row]))
}

/// How today's counts follow from the standard curve: counts = gain · I_standard(T) + offset (the paper's mapping).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurveMapping {
    /// Gain of today against the standard curve.
    pub gain: f64,
    /// Offset of today, in counts.
    pub offset_counts: f64,
    /// Covariance of (gain, offset_counts): a systematic, common to all pixels.
    pub covariance: [[f64; 2]; 2],
    /// Σ ((counts − mapped)/sigma)².
    pub chi2: f64,
    /// Points less 2.
    pub dof: usize,
}

impl CurveMapping {
    /// Today's curve, counts above `offset_counts`: the standard one with A scaled.
    pub fn curve(&self, standard: &SakumaHattori) -> SakumaHattori {
        SakumaHattori { a_counts: self.gain * standard.a_counts, ..*standard }
    }

    /// Standard counts that today's `counts` stand for.
    pub fn to_standard(&self, counts: f64) -> f64 {
        (counts - self.offset_counts) / self.gain
    }
}

/// Maps a short current curve of two or more points on the standard one.
///
/// # Errors
///
/// When the points are fewer than two, not finite, at one temperature, or fall with temperature.
pub fn map_on_standard(
    standard: &SakumaHattori,
    current: &[CalibrationPoint],
) -> Result<CurveMapping, CalibrationError> {
    let bad = |p: &CalibrationPoint| !(p.sigma_counts > 0.0 && p.counts.is_finite() && p.temperature_k > 0.0);
    if let Some(index) = current.iter().position(bad) {
        return Err(CalibrationError::BadPoint { index });
    }
    let x: Vec<f64> = current.iter().map(|p| standard.value(p.temperature_k)).collect();
    let y: Vec<f64> = current.iter().map(|p| p.counts).collect();
    let w: Vec<f64> = current.iter().map(|p| 1.0 / (p.sigma_counts * p.sigma_counts)).collect();
    let line = super::line::weighted(&x, &y, &w)
        .ok_or(CalibrationError::TooFewPoints { given: current.len(), needed: 2 })?;
    if line.slope.is_nan() || line.slope <= 0.0 {
        return Err(CalibrationError::NotABlackBody);
    }
    let c = line.covariance();
    let cross = line.slope_offset_covariance(&c);
    Ok(CurveMapping {
        gain: line.slope,
        offset_counts: line.offset,
        covariance: [[c.slope, cross], [cross, line.offset_variance(&c)]],
        chi2: line.chi2,
        dof: current.len() - 2,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn exact(temperatures: &[f64], offset: f64) -> Vec<CalibrationPoint> {
        temperatures
            .iter()
            .map(|&temperature_k| {
                let counts = TRUTH.value(temperature_k) + offset;
                CalibrationPoint { temperature_k, counts, sigma_counts: 0.15 + 0.001 * counts }
            })
            .collect()
    }

    fn worst(fit: &CalibrationFit, low: f64, high: f64) -> f64 {
        (0..=100)
            .map(|i| low + (high - low) * f64::from(i) / 100.0)
            .map(|t| (fit.curve.inverse(TRUTH.value(t)) - t).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn inverse_and_derivative_belong_to_the_curve() {
        for t in [250.0, 300.0, 373.0, 449.0, 533.0, 900.0] {
            assert!((TRUTH.inverse(TRUTH.value(t)) / t - 1.0).abs() < 1e-14);
            let h = 1e-3;
            let slope = (TRUTH.value(t + h) - TRUTH.value(t - h)) / (2.0 * h);
            assert!((TRUTH.derivative(t) / slope - 1.0).abs() < 1e-8);
            let inverse = TRUTH.inverse_derivative(TRUTH.value(t), t);
            assert!((TRUTH.derivative(t) * inverse - 1.0).abs() < 1e-13);
        }
        assert!(
            TRUTH.inverse(0.0).is_nan() && TRUTH.inverse(-1.0).is_nan() && TRUTH.inverse(f64::NAN).is_nan()
        );
    }

    /// Ten noise-free points of the exact form: well below the 1.2 mK that other filters leave.
    #[test]
    fn exact_points_come_back_exactly() {
        let temperatures: Vec<f64> = (0..10).map(|i| 340.0 + 30.0 * f64::from(i)).collect();
        for (offset, mode) in
            [(0.0, OffsetMode::Known(0.0)), (1500.0, OffsetMode::Known(1500.0)), (1500.0, OffsetMode::Free)]
        {
            let fit = fit_curve(&exact(&temperatures, offset), mode).unwrap();
            assert!(worst(&fit, 345.0, 600.0) < 1e-6, "{mode:?}: {}", worst(&fit, 345.0, 600.0));
            assert!((fit.offset_counts - offset).abs() < 1e-6);
            assert!(fit.iterations < 60, "{}", fit.iterations);
        }
    }

    #[test]
    fn few_and_cold_points_converge() {
        let few = fit_curve(&exact(&[373.0, 449.0, 533.0], 0.0), OffsetMode::Known(0.0)).unwrap();
        assert!(worst(&few, 373.0, 533.0) < 1e-6 && few.dof == 0);
        let shutter = exact(&[296.0, 373.0, 403.0, 433.0, 533.0], 1500.0);
        let cold = fit_curve(&shutter, OffsetMode::Free).unwrap();
        assert!(worst(&cold, 300.0, 533.0) < 1e-5, "{}", worst(&cold, 300.0, 533.0));
        let fifty: Vec<f64> = (0..50).map(|i| 290.0 + 7.0 * f64::from(i)).collect();
        let many = fit_curve(&exact(&fifty, 3.0), OffsetMode::Free).unwrap();
        assert!(worst(&many, 290.0, 630.0) < 1e-6);
    }

    #[test]
    fn unusable_points_are_refused() {
        let known = OffsetMode::Known(0.0);
        let two = exact(&[373.0, 533.0], 0.0);
        assert_eq!(fit_curve(&two, known), Err(CalibrationError::TooFewPoints { given: 2, needed: 3 }));
        let three = exact(&[373.0, 449.0, 533.0], 0.0);
        assert_eq!(
            fit_curve(&three, OffsetMode::Free),
            Err(CalibrationError::TooFewPoints { given: 3, needed: 4 })
        );
        let mut bad = three.clone();
        bad[1].sigma_counts = 0.0;
        assert_eq!(fit_curve(&bad, known), Err(CalibrationError::BadPoint { index: 1 }));
        let mut dark = three;
        dark.iter_mut().for_each(|p| p.counts = -5.0);
        assert_eq!(fit_curve(&dark, known), Err(CalibrationError::NotABlackBody));
    }

    /// The covariance predicts the scatter of refits: 400 noisy sets, each parameter's variance within 25 %
    /// (4 standard errors of a variance of 400 draws are 28 %).
    #[test]
    fn covariance_predicts_scatter() {
        let temperatures: Vec<f64> = (0..8).map(|i| 350.0 + 30.0 * f64::from(i)).collect();
        let clean = exact(&temperatures, 0.0);
        let expected = fit_curve(&clean, OffsetMode::Known(0.0)).unwrap();
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            #[expect(clippy::cast_precision_loss, reason = "53 bits")]
            let value = (state >> 11) as f64 / 9_007_199_254_740_992.0;
            value
        };
        let (mut sum, mut sum_squares) = (0.0, 0.0);
        for _ in 0..400 {
            let mut noisy = clean.clone();
            for p in &mut noisy {
                let normal: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                p.counts += normal * p.sigma_counts;
            }
            let fit = fit_curve(&noisy, OffsetMode::Known(0.0)).unwrap();
            let off = fit.curve.value(449.0) - TRUTH.value(449.0);
            sum += off;
            sum_squares += off * off;
        }
        let variance = sum_squares / 400.0 - (sum / 400.0) * (sum / 400.0);
        let predicted = expected.sigma_counts(449.0);
        assert!((variance / (predicted * predicted) - 1.0).abs() < 0.28, "{variance} {predicted}");
    }

    #[test]
    fn range_is_judged_in_inverse_temperature() {
        let range = Range { low_k: 373.0, high_k: 533.0 };
        assert_eq!(range.reach(373.0), Reach::Inside);
        assert_eq!(range.reach(365.0), Reach::Extrapolated);
        assert_eq!(range.reach(555.0), Reach::Extrapolated);
        assert_eq!(range.reach(340.0), Reach::Outside);
        assert_eq!(range.reach(600.0), Reach::Outside);
        assert_eq!(range.reach(f64::NAN), Reach::Outside);
    }
}
