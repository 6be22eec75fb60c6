//! What a simulated world knows of itself, as recorded, and how far the map is from it.
//!
//! Two truths. *Statistical*: the mean of many perfect shots of the same law at the true plate temperatures, read
//! with the exact calibration and fitted with the weights of the map: what more shots and a better camera would
//! give. *Physical*: the temperature of the absorbing mass along the straight sight: what scattering, walls,
//! windows and the non-gray band do to the number.

use crate::estimate::line::Line;
use serde::{Deserialize, Serialize};

/// The truth as it is kept in `world/truth.npz`; images are `[row · columns + column]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WorldTruth {
    /// Rows of an image.
    pub rows: usize,
    /// Columns of an image.
    pub columns: usize,
    /// True plate temperature at the accepted shots of each level, in K.
    pub plate_k: Vec<f64>,
    /// Exact abscissa γ_far·I_cal of each level, in counts.
    pub x_counts: Vec<f64>,
    /// Expected spray − blank in counts, `[level][pixel]`.
    pub difference_counts: Vec<Vec<f64>>,
    /// Its standard error, `[level][pixel]`.
    pub difference_error_counts: Vec<Vec<f64>>,
    /// Exact transmittance of the near window, in the band.
    pub gamma_near: f64,
    /// Exact emissivity of the plate.
    pub emissivity_plate: f64,
    /// Exact E_f, in counts of the crossing's scale.
    pub far_window_counts: f64,
    /// Temperatures of the exact calibration's table, ascending, in K.
    pub curve_k: Vec<f64>,
    /// I_cal at them, in counts.
    pub curve_counts: Vec<f64>,
    /// Temperature of the absorbing mass along the sight, in K; NaN without any.
    pub physical_k: Vec<f64>,
    /// Its absorptance.
    pub physical_emissivity: Vec<f64>,
    /// The same of the droplets alone, in K.
    pub droplets_k: Vec<f64>,
    /// Absorptance of the droplets alone.
    pub droplets_emissivity: Vec<f64>,
}

/// How far a map is from a truth, over the pixels that count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ErrorFigures {
    /// Root of the mean square, in K.
    pub rms_k: f64,
    /// Mean with its sign, in K.
    pub bias_k: f64,
    /// Median of the magnitude, in K.
    pub p50_k: f64,
    /// 90th percentile of the magnitude, in K.
    pub p90_k: f64,
    /// 99th percentile of the magnitude, in K.
    pub p99_k: f64,
    /// Pixels that count and have a temperature.
    pub pixels: usize,
    /// Pixels that count but got no temperature.
    pub without_temperature: usize,
}

/// The statistical truth of a map: one emissivity and temperature per pixel, and the temperature's own standard error.
#[derive(Debug, Clone, PartialEq)]
pub struct StatisticalTruth {
    /// ε, NaN where the map has no line.
    pub emissivity: Vec<f64>,
    /// T_eff in K.
    pub temperature_k: Vec<f64>,
    /// Standard error of `temperature_k` from the finite number of perfect shots, in K.
    pub error_k: Vec<f64>,
}

impl WorldTruth {
    /// Reads the expected differences as the map's estimator would: `lines` are fits of them with the map's weights
    /// over [`WorldTruth::x_counts`].
    pub fn statistical(&self, lines: &[Option<Line>]) -> StatisticalTruth {
        let pixels = self.rows * self.columns;
        let mut truth = StatisticalTruth {
            emissivity: vec![f64::NAN; pixels],
            temperature_k: vec![f64::NAN; pixels],
            error_k: vec![f64::NAN; pixels],
        };
        for (pixel, line) in lines.iter().enumerate() {
            let Some(line) = line else { continue };
            truth.emissivity[pixel] = -line.slope / self.gamma_near;
            let counts = self.emissivity_plate * (line.crossing + self.far_window_counts);
            let (kelvin, counts_per_k) = self.inverse(counts);
            truth.temperature_k[pixel] = kelvin;
            // The line's mean is as uncertain as the mean of its points; divided by slope and curve it is in K.
            let levels = self.difference_error_counts.len() as f64;
            let square: f64 = self.difference_error_counts.iter().map(|level| level[pixel].powi(2)).sum();
            truth.error_k[pixel] = (square / levels).sqrt() / levels.sqrt() / line.slope.abs()
                * self.emissivity_plate
                / counts_per_k;
        }
        truth
    }

    /// Temperature and dI/dT of the exact curve at `counts`: ln I is straight in 1/T between points a kelvin apart
    /// to 1e-5 K. NaN outside the table.
    fn inverse(&self, counts: f64) -> (f64, f64) {
        let after = self.curve_counts.partition_point(|value| *value < counts);
        if after == 0 || after >= self.curve_counts.len() || !counts.is_finite() {
            return (f64::NAN, f64::NAN);
        }
        let (low, high) = (after - 1, after);
        let (i0, i1) = (self.curve_counts[low], self.curve_counts[high]);
        let (t0, t1) = (self.curve_k[low], self.curve_k[high]);
        let part = libm::log(counts / i0) / libm::log(i1 / i0);
        (1.0 / (1.0 / t0 + part * (1.0 / t1 - 1.0 / t0)), (i1 - i0) / (t1 - t0))
    }
}

/// Compares temperatures with a truth over the pixels for which `counts` says so; `None` when there are none.
pub fn compare(measured_k: &[f64], true_k: &[f64], counts: impl Fn(usize) -> bool) -> Option<ErrorFigures> {
    let mut differences = Vec::new();
    let mut without = 0;
    for pixel in (0..measured_k.len()).filter(|&pixel| counts(pixel) && true_k[pixel].is_finite()) {
        let difference = measured_k[pixel] - true_k[pixel];
        if difference.is_finite() {
            differences.push(difference);
        } else {
            without += 1;
        }
    }
    let n = differences.len();
    if n == 0 {
        return None;
    }
    let square: f64 = differences.iter().map(|d| d * d).sum();
    let bias: f64 = differences.iter().sum::<f64>() / n as f64;
    let mut magnitudes: Vec<f64> = differences.iter().map(|d| d.abs()).collect();
    magnitudes.sort_by(f64::total_cmp);
    let percentile = |percent: usize| magnitudes[((n - 1) * percent) / 100];
    Some(ErrorFigures {
        rms_k: (square / n as f64).sqrt(),
        bias_k: bias,
        p50_k: percentile(50),
        p90_k: percentile(90),
        p99_k: percentile(99),
        pixels: n,
        without_temperature: without,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_known_differences() {
        let truth = vec![400.0; 101];
        let mut measured: Vec<f64> = (0..101).map(|i| 400.0 + f64::from(i) * 0.01).collect();
        measured[100] = f64::NAN;
        let figures = compare(&measured, &truth, |_| true).unwrap();
        assert_eq!(figures.pixels, 100);
        assert_eq!(figures.without_temperature, 1);
        assert!((figures.p50_k - 0.49).abs() < 1e-9);
        assert!((figures.bias_k - 0.495).abs() < 1e-9);
        assert!(compare(&measured, &truth, |_| false).is_none());
    }

    #[test]
    fn the_table_of_the_exact_curve_inverts_to_ten_microkelvin() {
        let planck = |t: f64| 7.2e5 / (14_387.768_775 / (3.4 * t)).exp_m1();
        let curve_k: Vec<f64> = (300..700).map(f64::from).collect();
        let truth = WorldTruth {
            curve_counts: curve_k.iter().map(|t| planck(*t)).collect(),
            curve_k,
            ..WorldTruth::default()
        };
        for t in [300.3, 373.37, 449.5, 533.21, 698.9] {
            let (found, slope) = truth.inverse(planck(t));
            assert!((found - t).abs() < 1e-5, "{t}: {found}");
            let exact = (planck(t + 0.01) - planck(t - 0.01)) / 0.02;
            assert!((slope / exact - 1.0).abs() < 0.02);
        }
        assert!(truth.inverse(1e9).0.is_nan());
    }
}
