//! Damped least squares for the curve: its variables, start values, steps and covariance.

use super::band::Known;
use super::fit::OffsetMode;
use super::least_squares::{column_norms, damped_step, dot, solve, upper_inverse};
use super::{C2_UM_K, CalibrationPoint, SakumaHattori};
use crate::estimate::line;

/// Iterations of the fit. Ordinary fits need 5 to 15; with this many the damping has tried everything.
const ITERATIONS_MAX: usize = 200;

/// The curve and its offset, with what else a fit has to know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Parameters {
    pub(super) curve: SakumaHattori,
    pub(super) offset_counts: f64,
    pub(super) free_offset: bool,
    /// Temperature at which the fit's own variables are taken: ln I and a T + b there, and a.
    pub(super) pivot_k: f64,
    /// a and b as they are known before the points.
    pub(super) known: Option<[Known; 2]>,
}

impl Parameters {
    pub(super) fn chi2(&self, points: &[CalibrationPoint]) -> f64 {
        points
            .iter()
            .map(|p| {
                let r = (p.counts - self.offset_counts - self.curve.value(p.temperature_k)) / p.sigma_counts;
                r * r
            })
            .chain(self.known_rows().into_iter().flatten().map(|(_, r)| r * r))
            .sum()
    }

    /// d/d(step) and the distance of a and b from what is known of them, over their sigmas.
    fn known_rows(&self) -> Option<[([f64; 4], f64); 2]> {
        let [a, b] = self.known?;
        let SakumaHattori { a_um, b_um_k, .. } = self.curve;
        let w = a_um * self.pivot_k + b_um_k;
        // b = w − a·pivot at constant w and a.
        Some([
            ([0.0, 0.0, 1.0 / a.sigma, 0.0], (a.value - a_um) / a.sigma),
            ([0.0, w / b.sigma, -self.pivot_k / b.sigma, 0.0], (b.value - b_um_k) / b.sigma),
        ])
    }

    pub(super) fn is_black_body(&self) -> bool {
        let SakumaHattori { a_counts, a_um, b_um_k } = self.curve;
        let finite = a_counts.is_finite() && a_um.is_finite() && b_um_k.is_finite();
        finite && a_counts > 0.0 && a_um > 0.0
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
pub(super) fn start(
    points: &[CalibrationPoint],
    offset: OffsetMode,
    known: Option<[Known; 2]>,
) -> Option<Parameters> {
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
            known,
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
            let line = line::weighted(&x, &y, &w)?;
            (line.slope, line.offset)
        }
    };
    let a_counts = scale / top;
    (a_counts.is_finite() && a_counts > 0.0).then_some((a_counts, offset_counts))
}

/// Levenberg–Marquardt with Marquardt's scaling. Stops when a step changes no count by 1e-12 of its sigma or
/// 1e-15 of itself, or nothing gets better any more.
pub(super) fn descend(points: &[CalibrationPoint], start: Parameters) -> (Parameters, usize) {
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

fn linearised(points: &[CalibrationPoint], at: &Parameters) -> (Vec<[f64; 4]>, Vec<f64>) {
    points
        .iter()
        .map(|p| {
            let row = at.jacobian(p.temperature_k).map(|d| d / p.sigma_counts);
            let r = (p.counts - at.offset_counts - at.curve.value(p.temperature_k)) / p.sigma_counts;
            (row, r)
        })
        .chain(at.known_rows().into_iter().flatten())
        .unzip()
}

/// b, in µm K, that the points alone ask for, as seen from here.
pub(super) fn b_asked_for(points: &[CalibrationPoint], at: &Parameters) -> f64 {
    let (rows, residuals) = linearised(points, at);
    let step = damped_step(&rows, &residuals, 0.0);
    let w = at.curve.a_um * at.pivot_k + at.curve.b_um_k;
    // b = w − a·pivot.
    at.curve.b_um_k + w * step[1] - at.pivot_k * step[2]
}

/// d(counts)/d(ln A, a, b, offset).
pub(super) fn gradient(curve: &SakumaHattori, temperature_k: f64) -> [f64; 4] {
    let counts = curve.value(temperature_k);
    let w = curve.a_um * temperature_k + curve.b_um_k;
    let by_w = counts * (1.0 + counts / curve.a_counts) * C2_UM_K / (w * w);
    [counts, by_w * temperature_k, by_w, 1.0]
}

/// Covariance of (ln A, a, b, offset): computed in the fit's own variables, then transformed, so that the strong
/// correlation of A, a and b costs no digits.
pub(super) fn covariance(points: &[CalibrationPoint], at: &Parameters) -> [[f64; 4]; 4] {
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
