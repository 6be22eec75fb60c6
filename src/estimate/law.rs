//! The variance law of shots and the weights that follow from it: our own estimator of one pixel's line.
//!
//! From shot to shot the spray's emissivity and temperature scatter, so that the variance of a sample is
//! cam(x) + A + B (S − x)²: the camera's own part, a constant, and a parabola with its minimum near the crossing S.
//! Two numbers per pixel, fitted to variances pooled over neighbours, replace one noisy sample variance per level:
//! with two or three cycles per level the paper's weights cost a factor 1.2 to 2 in the error of T, and its error bars
//! are two to three times too small. Knows nothing of images or files.

use super::line::{self, Covariance, Line};

/// Passes of (crossing → law → weights → line). A third changes T by less than 0.5 % of its standard deviation.
pub(super) const PASSES: usize = 2;

/// Smallest variance that is ever used, in counts²: keeps weights finite for a camera model of zero.
pub(super) const VARIANCE_MIN: f64 = 1e-6;

/// Degrees of freedom that the law's variance adds to a level's own when uncertainty is stated. Without it, 2.5 % of
/// strongly scattering pixels with two cycles per level had an unbounded 95 % set and thus no temperature, and the
/// 68 % sets held the truth in 73 to 75 %; with it none, and 68 to 72 % (`tests/coverage.rs`). More would take
/// neighbours that fluctuate together for independent ones.
pub(super) const FREEDOM_LAW: f64 = 1.0;

/// The level means of one pixel and what is known of their scatter. All slices are of equal length; variances are
/// of one sample, in the unit of `y` squared.
#[derive(Debug, Clone, Copy)]
pub struct Samples<'a> {
    /// Abscissae.
    pub x: &'a [f64],
    /// Level means.
    pub y: &'a [f64],
    /// Cycles behind each mean, ≥ 1.
    pub count: &'a [f64],
    /// The pixel's own sample variance, NaN for a single cycle.
    pub own: &'a [f64],
    /// Sample variance pooled over neighbours, NaN where there is none.
    pub pooled: &'a [f64],
    /// The camera's own variance: a floor.
    pub camera: &'a [f64],
    /// Squared residuals of an unweighted line, pooled over neighbours; empty when there are none of this shape.
    pub residual_squares: &'a [f64],
}

/// What the law gives for one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawFit {
    /// The weighted line.
    pub line: Line,
    /// Its covariance, for the crossing.
    pub covariance: Covariance,
    /// var(slope), for the emissivity.
    pub slope_variance: f64,
    /// Degrees of freedom of var(crossing).
    pub freedom_crossing: f64,
    /// Degrees of freedom of var(slope).
    pub freedom_slope: f64,
    /// A and B: what shots add to the camera's variance at the crossing, in counts², and per squared distance to it.
    pub law: (f64, f64),
    /// The variances rest on the camera model alone.
    pub camera_only: bool,
}

/// Reusable memory for [`fit`].
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    weights: Vec<f64>,
    model: Vec<f64>,
    distance: Vec<f64>,
    used: Vec<f64>,
}

impl Scratch {
    /// The weights of the last fit, one per level.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }
}

/// Fits the line with the weights of the law. None if the points do not define a line.
pub fn fit(samples: &Samples<'_>, scratch: &mut Scratch) -> Option<LawFit> {
    let Scratch { weights, model, distance, used } = scratch;
    let points = samples.x.len();
    weights.clear();
    weights.resize(points, 1.0);
    let mut line = line::weighted(samples.x, samples.y, weights)?;
    let first = line;
    let by_variance = samples.pooled.iter().filter(|v| v.is_finite()).count() >= 2;
    let by_residual = !by_variance && points >= 3;
    let (low, high) = clip(samples.x);
    model.clear();
    if by_variance {
        let known = samples.pooled.iter().zip(samples.camera);
        model.extend(known.map(|(&p, &c)| if p.is_finite() { p.max(c) } else { c }.max(VARIANCE_MIN)));
    } else {
        model.extend(samples.camera.iter().map(|&c| c.max(VARIANCE_MIN)));
    }
    let mut law = (0.0, 0.0);
    for pass in 0..PASSES {
        let middle = 0.5 * (low + high);
        let crossing = if line.crossing.is_finite() { line.crossing.clamp(low, high) } else { middle };
        distance.clear();
        distance.extend(samples.x.iter().map(|x| (crossing - x) * (crossing - x)));
        let (a, b) = if by_variance {
            from_variances(samples, model, distance)
        } else if by_residual {
            from_residuals(samples, &first, model, distance, pass > 0)
        } else {
            (0.0, 0.0)
        };
        law = (a, b);
        for ((v, w), ((u, camera), n)) in model
            .iter_mut()
            .zip(weights.iter_mut())
            .zip(distance.iter().zip(samples.camera).zip(samples.count))
        {
            *v = (camera + a + b * u).max(VARIANCE_MIN);
            *w = n / *v;
        }
        line = line::weighted(samples.x, samples.y, weights)?;
    }
    if !by_variance {
        // Chosen: with one cycle per level the neighbours' residuals add some, unknown, freedom to the pixel's own.
        #[expect(clippy::cast_precision_loss, reason = "a number of levels")]
        let freedom = if by_residual { 3.0 * (points - 2) as f64 } else { f64::INFINITY };
        return Some(LawFit {
            line,
            covariance: line.covariance(),
            slope_variance: 1.0 / line.spread,
            freedom_crossing: freedom,
            freedom_slope: freedom,
            law,
            camera_only: !by_residual,
        });
    }
    used.clear();
    for ((own, n), model) in samples.own.iter().zip(samples.count).zip(model.iter()) {
        let freedom = n - 1.0;
        let squares = if freedom > 0.0 { freedom * own } else { 0.0 } + FREEDOM_LAW * model;
        used.push(squares / ((freedom + FREEDOM_LAW) * n));
    }
    let covariance = line.covariance_sandwich(samples.x, weights, used);
    let (crossing, slope) = freedoms(samples, &line, weights, used);
    // The camera's noise is a floor for the whole, not for each level: levels of one or two degrees of freedom fall
    // below it by chance half of the time, and raising each would make every interval too wide.
    used.clear();
    used.extend(samples.camera.iter().zip(samples.count).map(|(camera, n)| camera.max(VARIANCE_MIN) / n));
    let floor = line.covariance_sandwich(samples.x, weights, used);
    let low = line.crossing_variance(&floor) > line.crossing_variance(&covariance);
    let low_slope = floor.slope > covariance.slope;
    Some(LawFit {
        line,
        covariance: if low { floor } else { covariance },
        slope_variance: if low_slope { floor.slope } else { covariance.slope },
        freedom_crossing: if low { f64::INFINITY } else { crossing },
        freedom_slope: if low_slope { f64::INFINITY } else { slope },
        law,
        camera_only: false,
    })
}

/// A crossing is believed up to half the range of x outside it: further out the parabola has no support.
fn clip(x: &[f64]) -> (f64, f64) {
    let low = x.iter().copied().fold(f64::INFINITY, f64::min);
    let high = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let margin = 0.5 * (high - low);
    (low - margin, high + margin)
}

/// A, B ≥ 0 of pooled ≈ camera + A + B·distance, weights 1/model².
fn from_variances(samples: &Samples<'_>, model: &[f64], distance: &[f64]) -> (f64, f64) {
    let mut sums = Normal::default();
    for ((&pooled, &camera), (&v, &u)) in
        samples.pooled.iter().zip(samples.camera).zip(model.iter().zip(distance))
    {
        if pooled.is_finite() {
            sums.add(1.0, u, pooled - camera, 1.0 / (v * v));
        }
    }
    sums.solve()
}

/// A, B ≥ 0 from squared residuals r² of the unweighted line: E r_i² = Σ_k M_ik² v_k with M = 1 − H, so the two
/// sums of M² are the abscissae (MINQUE; unbiased for the given S).
fn from_residuals(
    samples: &Samples<'_>,
    first: &Line,
    model: &[f64],
    distance: &[f64],
    weighted: bool,
) -> (f64, f64) {
    let x = samples.x;
    let own = samples.residual_squares.len() != x.len();
    let mut sums = Normal::default();
    for (i, (&xi, &yi)) in x.iter().zip(samples.y).enumerate() {
        let (mut at_a, mut at_b, mut camera, mut expected) = (0.0, 0.0, 0.0, 0.0);
        for (k, &xk) in x.iter().enumerate() {
            let hat = 1.0 / first.weight + (xi - first.mean_x) * (xk - first.mean_x) / first.spread;
            let m = if i == k { 1.0 - hat } else { -hat };
            let share = m * m / samples.count[k];
            at_a += share;
            at_b += share * distance[k];
            camera += share * samples.camera[k];
            expected += share * model[k];
        }
        let square = if own {
            let residual = (yi - first.mean_y) - first.slope * (xi - first.mean_x);
            residual * residual
        } else {
            samples.residual_squares[i]
        };
        if square.is_finite() && expected > 0.0 {
            let weight = if weighted { 1.0 / (expected * expected) } else { 1.0 };
            sums.add(at_a, at_b, square - camera, weight);
        }
    }
    sums.solve()
}

/// Normal equations of two unknowns.
#[derive(Default)]
struct Normal {
    aa: f64,
    ab: f64,
    bb: f64,
    ay: f64,
    by: f64,
}

impl Normal {
    fn add(&mut self, a: f64, b: f64, y: f64, weight: f64) {
        self.aa += weight * a * a;
        self.ab += weight * a * b;
        self.bb += weight * b * b;
        self.ay += weight * a * y;
        self.by += weight * b * y;
    }

    /// The least-squares solution with both unknowns ≥ 0, in closed form.
    fn solve(&self) -> (f64, f64) {
        let determinant = self.aa * self.bb - self.ab * self.ab;
        let only = |top: f64, bottom: f64| if bottom > 0.0 { (top / bottom).max(0.0) } else { 0.0 };
        if determinant > 1e-9 * self.aa * self.bb {
            let a = (self.ay * self.bb - self.by * self.ab) / determinant;
            let b = (self.by * self.aa - self.ay * self.ab) / determinant;
            if a >= 0.0 && b >= 0.0 {
                return (a, b);
            }
            if a < 0.0 && b >= 0.0 {
                return (0.0, only(self.by, self.bb));
            }
        }
        (only(self.ay, self.aa), 0.0)
    }
}

/// Satterthwaite's degrees of freedom of var(crossing) and var(slope), sums of independent estimated variances.
fn freedoms(samples: &Samples<'_>, line: &Line, weights: &[f64], used: &[f64]) -> (f64, f64) {
    let d = -line.mean_y / line.slope;
    let (mut crossing, mut crossing_2, mut slope, mut slope_2) = (0.0, 0.0, 0.0, 0.0);
    for ((&x, &n), (&w, &v)) in samples.x.iter().zip(samples.count).zip(weights.iter().zip(used)) {
        let freedom = n - 1.0 + FREEDOM_LAW;
        let dx = (x - line.mean_x) / line.spread;
        let at_crossing = w * (1.0 / line.weight + d * dx);
        let part = at_crossing * at_crossing * v;
        crossing += part;
        crossing_2 += part * part / freedom;
        let part = w * w * dx * dx * v;
        slope += part;
        slope_2 += part * part / freedom;
    }
    (crossing * crossing / crossing_2, slope * slope / slope_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Variances that follow the law exactly give the weights of the law exactly.
    #[test]
    fn exact_law_gives_inverse_variance_weights() {
        let x = [8.0, 19.0, 39.0, 141.0, 245.0];
        let crossing = 60.0;
        let y = x.map(|x| 0.6 * (crossing - x));
        let count = [4.0; 5];
        let camera = [3.0; 5];
        let variance = x.map(|x| 3.0 + 2.0 + 0.004 * (crossing - x) * (crossing - x));
        let samples = Samples {
            x: &x,
            y: &y,
            count: &count,
            own: &variance,
            pooled: &variance,
            camera: &camera,
            residual_squares: &[],
        };
        let fit = fit(&samples, &mut Scratch::default()).unwrap();
        let w: Vec<f64> = variance.iter().map(|v| 4.0 / v).collect();
        let exact = line::weighted(&x, &y, &w).unwrap();
        assert!((fit.line.weight / exact.weight - 1.0).abs() < 1e-12);
        assert!((fit.covariance.slope * exact.spread - 1.0).abs() < 1e-12);
        assert!((fit.line.crossing - crossing).abs() < 1e-9);
        assert!(fit.freedom_crossing > 3.0 && fit.freedom_crossing <= 20.0);
    }

    #[test]
    fn nasty_samples_stay_finite() {
        let x = [8.0, 19.0, 39.0];
        for (y, pooled) in
            [([0.0; 3], [0.0; 3]), ([1.0, 1.0, 1.0], [f64::NAN; 3]), ([1e4, -1e4, 1e4], [1e8, 0.0, f64::NAN])]
        {
            let samples = Samples {
                x: &x,
                y: &y,
                count: &[1.0, 2.0, 1.0],
                own: &[f64::NAN, 0.0, f64::NAN],
                pooled: &pooled,
                camera: &[0.0; 3],
                residual_squares: &[],
            };
            let fit = fit(&samples, &mut Scratch::default()).unwrap();
            assert!(fit.line.slope.is_finite() && fit.covariance.slope.is_finite());
        }
    }

    #[test]
    fn both_unknowns_stay_positive() {
        let mut falling = Normal::default();
        for (u, y) in [(0.0, 5.0), (1.0, 3.0), (2.0, 1.0)] {
            falling.add(1.0, u, y, 1.0);
        }
        assert_eq!(falling.solve(), (3.0, 0.0));
        let mut below = Normal::default();
        for (u, y) in [(1.0, -1.0), (2.0, 1.0), (3.0, 3.0)] {
            below.add(1.0, u, y, 1.0);
        }
        let (a, b) = below.solve();
        assert!(a == 0.0 && (b - 10.0 / 14.0).abs() < 1e-15);
    }
}
