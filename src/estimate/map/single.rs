//! Pixels one by one: those whose variances cannot be pooled (one cycle a level), and the weights of any pixel.

use super::kernel::{Constants, Everywhere};
use super::lanes::{Doubles, Lanes, Number};
use super::lines::Lined;
use super::rows::Row;
use super::verdict::{Answer, Fitted, judge, quantile};
use super::{Estimator, FitInputs, flag};
use crate::estimate::law;
use crate::estimate::line;
use pulp::Scalar;

/// What a pixel's shots so far tell of further ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Prospect {
    /// x of its levels, in counts.
    pub x: Vec<f64>,
    /// Their weights: cycles over the variance of a shot.
    pub weights: Vec<f64>,
    /// Where its line crosses zero, in counts.
    pub crossing: f64,
    /// γ_near·ε.
    pub slope: f64,
    /// Variance of a shot with the plate at the crossing, in counts², with the camera's mean part.
    pub variance_at_crossing: f64,
    /// What is added per squared distance of x from the crossing.
    pub curvature: f64,
    /// Its temperature, in K.
    pub temperature_k: f64,
}

/// How one pixel was fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Detail {
    /// Levels that took part.
    pub levels: Vec<usize>,
    /// Their weights, in 1/counts² (all 1 for an unweighted line).
    pub weights: Vec<f64>,
    /// The line through them.
    pub line: line::Line,
    /// Its covariance, as it stands behind the crossing's set.
    pub covariance: line::Covariance,
    /// Degrees of freedom of that set; infinite for normal quantiles.
    pub freedom: f64,
}

/// Reusable memory for one pixel: its levels that are there.
#[derive(Default)]
pub(super) struct Pixel {
    /// Which levels with an x they are.
    pub(super) levels: Vec<usize>,
    x: Vec<f64>,
    y: Vec<f64>,
    count: Vec<f64>,
    own: Vec<f64>,
    pooled: Vec<f64>,
    camera: Vec<f64>,
    residual_squares: Vec<f64>,
    scratch: law::Scratch,
}

impl Pixel {
    /// Collects the levels of column `i`. `residuals` are pooled squares of this pixel, one per level with an x, or
    /// none.
    pub(super) fn gather<F: Number>(
        &mut self,
        row: &Row<'_, F>,
        i: usize,
        inputs: &FitInputs<'_>,
        constants: &Constants,
        residuals: impl Iterator<Item = f64>,
    ) {
        for values in [
            &mut self.x,
            &mut self.y,
            &mut self.count,
            &mut self.own,
            &mut self.pooled,
            &mut self.camera,
            &mut self.residual_squares,
        ] {
            values.clear();
        }
        self.levels.clear();
        let flat = row.flat[i].wide();
        for (k, &x) in constants.x.iter().enumerate() {
            let at = k * row.stride + i;
            let n = row.count[at].wide();
            if n < 1.0 {
                continue;
            }
            let (mean, blank) = (row.mean[at].wide(), row.blank[at].wide());
            self.levels.push(k);
            self.x.push(x);
            self.y.push(mean);
            self.count.push(n);
            self.own.push(if n < 2.0 { f64::NAN } else { row.squares[at].wide() / (n - 1.0) });
            self.pooled.push(row.pooled[at].wide());
            let camera = inputs.camera.variance((blank + mean) * flat, blank * flat, constants.blanks);
            self.camera.push(camera / (flat * flat));
        }
        self.residual_squares.extend(residuals);
        // Pooled residuals belong to the line through all levels.
        if self.x.len() != constants.x.len() {
            self.residual_squares.clear();
        }
    }

    fn samples(&self) -> law::Samples<'_> {
        law::Samples {
            x: &self.x,
            y: &self.y,
            count: &self.count,
            own: &self.own,
            pooled: &self.pooled,
            camera: &self.camera,
            residual_squares: &self.residual_squares,
        }
    }

    /// Our own fit of the gathered levels; None where they do not define a line.
    pub(super) fn fit(&mut self, constants: &Constants) -> Option<Answer<Doubles<Scalar>>> {
        let mut scratch = std::mem::take(&mut self.scratch);
        let fit = law::fit(&self.samples(), &mut scratch);
        self.scratch = scratch;
        let fit = fit?;
        let one = |value: f64| Doubles(Scalar::new(), value);
        let powers: Vec<_> = constants.quantile.iter().map(|&power| one(power)).collect();
        let t = |freedom: f64| quantile(one(0.0), one(constants.normal), &powers, one(1.0 / freedom));
        let flags = if fit.camera_only { flag::NO_STATISTICS } else { 0 };
        let line = fit.line;
        let d = -line.mean_y / line.slope;
        let noise: f64 = self
            .scratch
            .weights()
            .iter()
            .zip(&self.x)
            .zip(self.camera.iter().zip(&self.count))
            .map(|((w, x), (camera, n))| {
                let at = w * (1.0 / line.weight + d * (x - line.mean_x) / line.spread);
                at * at * camera / n
            })
            .sum();
        let fitted = Fitted {
            line: Lined {
                slope: one(line.slope),
                per_slope: one(1.0 / line.slope),
                drop: one(line.mean_y * (1.0 / line.slope)),
                chi2: one(line.chi2),
                mean_x: one(line.mean_x),
                mean_y: one(line.mean_y),
                per_weight: one(1.0 / line.weight),
                per_spread: one(1.0 / line.spread),
            },
            covariance: [one(fit.covariance.slope), one(fit.covariance.mean), one(fit.covariance.cross)],
            slope_variance: one(fit.slope_variance),
            noise: one(noise),
            quantiles: [t(fit.freedom_crossing), t(fit.freedom_slope)],
            flags: one(f64::from(flags)),
        };
        let everywhere = one(0.0).at_most(one(0.0));
        Some(judge(one(0.0), &Everywhere::new(one(0.0), constants), true, everywhere, &fitted))
    }

    /// Slope of the unweighted line.
    pub(super) fn unweighted_slope(&self) -> Option<f64> {
        line::weighted(&self.x, &self.y, &vec![1.0; self.x.len()]).map(|line| line.slope)
    }

    /// What the gathered levels tell of further ones; None where they do not define a line with a temperature.
    pub(super) fn prospect(&mut self, inputs: &FitInputs<'_>) -> Option<Prospect> {
        let mut scratch = std::mem::take(&mut self.scratch);
        let fit = law::fit(&self.samples(), &mut scratch);
        self.scratch = scratch;
        let fit = fit?;
        let crossing = fit.line.crossing;
        let temperature_k =
            inputs.curve.inverse(inputs.emissivity_plate * (crossing + inputs.far_window_counts));
        #[expect(clippy::cast_precision_loss, reason = "a number of levels")]
        let camera = self.camera.iter().sum::<f64>() / self.camera.len() as f64;
        let prospect = Prospect {
            x: self.x.clone(),
            weights: self.scratch.weights().to_vec(),
            crossing,
            slope: -fit.line.slope,
            variance_at_crossing: camera + fit.law.0,
            curvature: fit.law.1,
            temperature_k,
        };
        temperature_k.is_finite().then_some(prospect)
    }

    /// How `estimator` fits the gathered levels; None where they do not define a line.
    pub(super) fn detail(&mut self, estimator: Estimator, used: &[usize]) -> Option<Detail> {
        let weights = self.weights(estimator)?;
        let line = line::weighted(&self.x, &self.y, &weights)?;
        let unweighted = || line.covariance_scaled(self.x.len());
        #[expect(clippy::cast_precision_loss, reason = "a number of levels")]
        let left = self.x.len().saturating_sub(2) as f64;
        let (covariance, freedom) = match estimator {
            Estimator::Ols => (unweighted(), left),
            Estimator::Paper if self.own.iter().any(|v| v.is_nan()) => (unweighted(), left),
            Estimator::Paper => (line.covariance(), f64::INFINITY),
            Estimator::Default => {
                let mut scratch = std::mem::take(&mut self.scratch);
                let fit = law::fit(&self.samples(), &mut scratch);
                self.scratch = scratch;
                let fit = fit?;
                (fit.covariance, fit.freedom_crossing)
            }
        };
        let levels = self.levels.iter().map(|&k| used[k]).collect();
        Some(Detail { levels, weights, line, covariance, freedom })
    }

    /// dS/dx of the gathered levels, in their order; None where they do not define a line.
    pub(super) fn crossing_shares(&mut self, estimator: Estimator) -> Option<Vec<f64>> {
        let weights = self.weights(estimator)?;
        let line = line::weighted(&self.x, &self.y, &weights)?;
        let d = line.crossing - line.mean_x;
        let share = |(w, x): (&f64, &f64)| w * (1.0 / line.weight + d * (x - line.mean_x) / line.spread);
        Some(weights.iter().zip(&self.x).map(share).collect())
    }

    /// The weights that `estimator` gives the gathered levels; None where they do not define a line.
    pub(super) fn weights(&mut self, estimator: Estimator) -> Option<Vec<f64>> {
        let alike = vec![1.0; self.x.len()];
        line::weighted(&self.x, &self.y, &alike)?;
        match estimator {
            Estimator::Ols => Some(alike),
            Estimator::Paper if self.own.iter().any(|v| v.is_nan()) => Some(alike),
            Estimator::Paper => {
                let own = self.own.iter().zip(&self.count);
                Some(own.map(|(&v, &n)| n / v.max(line::ROUNDING_VARIANCE)).collect())
            }
            Estimator::Default => {
                let mut scratch = std::mem::take(&mut self.scratch);
                let fitted = law::fit(&self.samples(), &mut scratch).is_some();
                self.scratch = scratch;
                fitted.then(|| self.scratch.weights().to_vec())
            }
        }
    }
}
