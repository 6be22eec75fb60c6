//! Straight lines through the level means of one pixel, their crossing with zero, and Fieller's set of it.
//!
//! All sums are formed with centred x and y: x values that nearly coincide, or sit on a large pedestal, keep their
//! digits. Does not know where weights come from; see `law` for ours.

/// Variance of a value rounded to integers, in counts²: no sample variance is believed below it.
pub const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;

/// Relative spread of x below which a line is not defined: Sxx ≤ this · W.
pub(super) const SPREAD_MIN: f64 = 1e-9;

/// A weighted line y = slope·x + offset and what follows from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Slope, dy/dx.
    pub slope: f64,
    /// Value at x = 0, in units of y.
    pub offset: f64,
    /// Where y = 0: S = xm − ym/slope, in units of x. Not finite for a zero slope.
    pub crossing: f64,
    /// Weighted sum of squared residuals.
    pub chi2: f64,
    /// Weighted mean of x.
    pub mean_x: f64,
    /// Weighted mean of y.
    pub mean_y: f64,
    /// Sum of weights W.
    pub weight: f64,
    /// Σ w (x − xm)².
    pub spread: f64,
}

/// Variances of a line about its centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Covariance {
    /// var(slope).
    pub slope: f64,
    /// var(ym), the value at the weighted mean of x.
    pub mean: f64,
    /// cov(ym, slope): zero when the weights are the inverse variances.
    pub cross: f64,
}

/// Fieller's set of the crossing: every S that the line does not contradict.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fieller {
    /// The interval `low ..= high`.
    Bounded {
        /// Lower end, in units of x.
        low: f64,
        /// Upper end, in units of x.
        high: f64,
    },
    /// Everything but the open interval between `low` and `high`: the slope is not significant, the mean is.
    Complement {
        /// Upper end of the lower ray.
        low: f64,
        /// Lower end of the upper ray.
        high: f64,
    },
    /// Neither slope nor mean is significant: no value is excluded.
    WholeLine,
}

/// Fits the line with weights `w`. None for fewer than two points or Sxx ≤ 1e-9·W.
pub fn weighted(x: &[f64], y: &[f64], w: &[f64]) -> Option<Line> {
    let (&x0, &y0) = (x.first()?, y.first()?);
    if x.len() < 2 {
        return None;
    }
    // Differences to the first point are (nearly) exact, so a pedestal costs no digits in the means.
    let (mut weight, mut sum_x, mut sum_y) = (0.0, 0.0, 0.0);
    for ((&x, &y), &w) in x.iter().zip(y).zip(w) {
        weight += w;
        sum_x += w * (x - x0);
        sum_y += w * (y - y0);
    }
    let (centre_x, centre_y) = (sum_x / weight, sum_y / weight);
    let (mut sxx, mut sxy) = (0.0, 0.0);
    for ((&x, &y), &w) in x.iter().zip(y).zip(w) {
        let dx = (x - x0) - centre_x;
        sxx += w * dx * dx;
        sxy += w * dx * ((y - y0) - centre_y);
    }
    if sxx.is_nan() || weight.is_nan() || sxx <= SPREAD_MIN * weight {
        return None;
    }
    let slope = sxy / sxx;
    let mut chi2 = 0.0;
    for ((&x, &y), &w) in x.iter().zip(y).zip(w) {
        let residual = ((y - y0) - centre_y) - slope * ((x - x0) - centre_x);
        chi2 += w * residual * residual;
    }
    let (mean_x, mean_y) = (x0 + centre_x, y0 + centre_y);
    Some(Line {
        slope,
        offset: mean_y - slope * mean_x,
        crossing: mean_x - mean_y / slope,
        chi2,
        mean_x,
        mean_y,
        weight,
        spread: sxx,
    })
}

impl Line {
    /// Covariance when the weights are inverse variances: var(slope) = 1/Sxx, var(ym) = 1/W.
    pub fn covariance(&self) -> Covariance {
        Covariance { slope: 1.0 / self.spread, mean: 1.0 / self.weight, cross: 0.0 }
    }

    /// Covariance of a fit with equal weights, scaled by the scatter χ²/(points − 2). NaN for two points.
    pub fn covariance_scaled(&self, points: usize) -> Covariance {
        let freedom = points.saturating_sub(2);
        #[expect(clippy::cast_precision_loss, reason = "a number of levels")]
        let scale = if freedom == 0 { f64::NAN } else { self.chi2 / freedom as f64 };
        Covariance { slope: scale / self.spread, mean: scale / self.weight, cross: 0.0 }
    }

    /// Covariance for weights `w` when the true variances of y are `v`: the sandwich.
    pub fn covariance_sandwich(&self, x: &[f64], w: &[f64], v: &[f64]) -> Covariance {
        let (mut slope, mut mean, mut cross) = (0.0, 0.0, 0.0);
        for ((&x, &w), &v) in x.iter().zip(w).zip(v) {
            let at_mean = w / self.weight;
            let at_slope = w * (x - self.mean_x) / self.spread;
            slope += at_slope * at_slope * v;
            mean += at_mean * at_mean * v;
            cross += at_mean * at_slope * v;
        }
        Covariance { slope, mean, cross }
    }

    /// var(crossing) by linear propagation: (var ym + 2 d cov + d² var slope)/slope², d = S − xm.
    pub fn crossing_variance(&self, covariance: &Covariance) -> f64 {
        let d = self.mean_y / self.slope;
        (covariance.mean - 2.0 * d * covariance.cross + d * d * covariance.slope) / (self.slope * self.slope)
    }

    /// var(offset).
    pub fn offset_variance(&self, covariance: &Covariance) -> f64 {
        let x = self.mean_x;
        covariance.mean - 2.0 * x * covariance.cross + x * x * covariance.slope
    }

    /// cov(slope, offset).
    pub fn slope_offset_covariance(&self, covariance: &Covariance) -> f64 {
        covariance.cross - self.mean_x * covariance.slope
    }

    /// All S with (ym + slope·(S − xm))² ≤ t²·var(ym + slope·(S − xm)). Whole line if anything is NaN.
    pub fn fieller(&self, covariance: &Covariance, t: f64) -> Fieller {
        let Covariance { slope: v_slope, mean: v_mean, cross } = *covariance;
        let (slope, mean) = (self.slope, self.mean_y);
        let t2 = t * t;
        // a d² + 2 b d + c ≤ 0 for d = S − xm; the discriminant is expanded so that b² − a c does not cancel.
        let a = slope * slope - t2 * v_slope;
        let b = slope * mean - t2 * cross;
        let c = mean * mean - t2 * v_mean;
        let inner = v_mean * slope * slope + v_slope * mean * mean - 2.0 * slope * mean * cross;
        let discriminant = t2 * (inner - t2 * (v_mean * v_slope - cross * cross));
        if discriminant.is_nan() || discriminant < 0.0 || !a.is_finite() || a.abs() < f64::MIN_POSITIVE {
            return Fieller::WholeLine;
        }
        // Both roots from the sum of like signs.
        let q = -(b + discriminant.sqrt().copysign(b));
        let (one, two) = if q.abs() < f64::MIN_POSITIVE { (0.0, 0.0) } else { (q / a, c / q) };
        let (low, high) = (self.mean_x + one.min(two), self.mean_x + one.max(two));
        if a > 0.0 { Fieller::Bounded { low, high } } else { Fieller::Complement { low, high } }
    }
}

/// The paper's weight of a level mean: n / max(s², 1/12).
pub fn paper_weight(count: u32, variance: f64) -> f64 {
    f64::from(count) / variance.max(ROUNDING_VARIANCE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn too_little_spread_is_no_line() {
        assert_eq!(weighted(&[1.0], &[1.0], &[1.0]), None);
        assert_eq!(weighted(&[1.0, 1.0], &[1.0, 2.0], &[1.0, 1.0]), None);
        assert_eq!(weighted(&[1.0, 2.0], &[1.0, f64::NAN], &[1.0, f64::NAN]), None);
        assert_eq!(weighted(&[], &[], &[]), None);
    }

    #[test]
    fn sandwich_with_true_weights_is_the_plain_covariance() {
        let x = [1.0, 2.0, 4.0, 9.0];
        let v = [0.5, 0.25, 2.0, 4.0];
        let w = v.map(|v| 1.0 / v);
        let line = weighted(&x, &[3.0, 2.0, -1.0, -7.0], &w).unwrap();
        let (plain, sandwich) = (line.covariance(), line.covariance_sandwich(&x, &w, &v));
        assert!((plain.slope / sandwich.slope - 1.0).abs() < 1e-14);
        assert!((plain.mean / sandwich.mean - 1.0).abs() < 1e-14);
        assert!(sandwich.cross.abs() < 1e-15);
    }

    proptest! {
        /// The ends of a Fieller set are where the line is exactly t standard deviations from zero, and the
        /// crossing is inside a bounded set.
        #[test]
        fn fieller_ends_are_t_sigma_away(
            slope in -1.0..-0.01_f64, offset in -50.0..150.0_f64, variance in 1e-4..10.0_f64, t in 0.5..3.0_f64,
        ) {
            let x = [8.0, 40.0, 140.0, 245.0];
            let y = x.map(|x| slope * x + offset);
            let w = [1.0 / variance; 4];
            let line = weighted(&x, &y, &w).unwrap();
            let covariance = line.covariance();
            let off = |s: f64| {
                let d = s - line.mean_x;
                let at = line.mean_y + line.slope * d;
                at * at / (covariance.mean + d * d * covariance.slope)
            };
            match line.fieller(&covariance, t) {
                Fieller::Bounded { low, high } => {
                    prop_assert!(low <= line.crossing && line.crossing <= high);
                    prop_assert!((off(low) / (t * t) - 1.0).abs() < 1e-6);
                    prop_assert!((off(high) / (t * t) - 1.0).abs() < 1e-6);
                }
                Fieller::Complement { low, high } => {
                    prop_assert!(!(low < line.crossing && line.crossing < high));
                }
                Fieller::WholeLine => {}
            }
        }
    }
}
