//! The mathematics of the fit for several pixels at once, from level means to emissivity, crossing and their sets.
//!
//! The same operations in the same order whatever the width, and no fused ones: a pixel's bits do not depend on its
//! neighbours or the machine. What a line cannot answer becomes NaN and a flag. Pixels whose variances cannot be
//! pooled are only marked; `single` fits them one by one.

use super::lanes::Lanes;
use super::{CHANNELS, Estimator, FitInputs, flag};
use crate::estimate::law::{FREEDOM_LAW, PASSES, VARIANCE_MIN};
use crate::estimate::line::{ROUNDING_VARIANCE, SPREAD_MIN};
use crate::estimate::student::{NODES, Quantiles};

/// Marks pixels that `single` has to fit. Not a bit of the legend: it never leaves the solver.
pub(super) const ALONE: u32 = 1 << 22;

/// Constants of a fit, the same for all pixels.
#[derive(Debug, Clone)]
pub(super) struct Constants {
    /// x of the levels that have one, in counts.
    pub(super) x: Vec<f64>,
    /// The camera's variance of a sample without light: spray, and mean of blanks.
    pub(super) fixed: f64,
    /// Variance per count of the spray frame and of the blanks.
    pub(super) per_count: f64,
    pub(super) zero_counts: f64,
    pub(super) blanks: f64,
    pub(super) gamma_near: f64,
    pub(super) gamma_far: f64,
    /// Chebyshev coefficients of 1/t over 2/ν − 1.
    quantile: [f64; NODES],
    /// t of infinitely many degrees of freedom.
    normal: f64,
}

impl Constants {
    pub(super) fn new(x: Vec<f64>, inputs: &FitInputs<'_>, blanks: f64, quantiles: &Quantiles) -> Self {
        let camera = &inputs.camera;
        let read = camera.read_noise_counts * camera.read_noise_counts + ROUNDING_VARIANCE;
        Self {
            x,
            fixed: read + read / blanks,
            per_count: 1.0 / camera.electrons_per_count,
            zero_counts: camera.zero_counts,
            blanks,
            gamma_near: inputs.gamma_near,
            gamma_far: inputs.gamma_far,
            quantile: *quantiles.coefficients(),
            normal: quantiles.at(f64::INFINITY),
        }
    }
}

/// One level of the pixels at hand.
#[derive(Clone, Copy)]
pub(super) struct Level<V> {
    /// Cycles that count; 0 leaves the level out.
    pub(super) count: V,
    /// Mean of spray − blank, 0 where nothing counts.
    pub(super) mean: V,
    /// Own sample variance, 0 below two cycles.
    pub(super) own: V,
    /// Mean of the blanks.
    pub(super) blank: V,
    /// Pooled sample variance, NaN where there is none.
    pub(super) pooled: V,
}

/// The pixels at hand.
pub(super) struct Group<V> {
    /// Gain of the pixels against the calibrated one.
    pub(super) flat: V,
    /// Flags so far.
    pub(super) flags: V,
    /// Where a pixel changes at all: 1, else 0.
    pub(super) alive: V,
    /// Whether any pixel nearby has a level of one cycle.
    pub(super) singles: bool,
}

/// A line.
#[derive(Clone, Copy)]
pub(super) struct Lined<V> {
    pub(super) slope: V,
    pub(super) chi2: V,
    pub(super) mean_x: V,
    pub(super) mean_y: V,
    pub(super) weight: V,
    pub(super) spread: V,
    pub(super) points: V,
}

/// A line and its uncertainty.
#[derive(Clone, Copy)]
pub(super) struct Fitted<V> {
    pub(super) line: Lined<V>,
    /// var(slope), var(ym), cov(ym, slope), for the crossing.
    pub(super) covariance: [V; 3],
    /// var(slope), for the emissivity.
    pub(super) slope_variance: V,
    /// Variance of the line at its crossing, in counts², that the camera's noise alone would give with these weights.
    pub(super) noise: V,
    /// 1/ν of the crossing's variance and of the slope's.
    pub(super) inverse_freedoms: [V; 2],
    pub(super) flags: V,
}

/// What is known of the pixels before temperatures.
#[derive(Clone, Copy)]
pub(super) struct Answer<V> {
    /// In the order of [`CHANNELS`]; temperatures still as crossings, `sigma_temperature_k` as that of the crossing.
    pub(super) channels: [V; CHANNELS.len()],
    pub(super) flags: V,
    /// 1 where a temperature is asked for.
    pub(super) asked: V,
}

/// Memory of a solver for one group.
#[derive(Debug)]
pub(super) struct Scratch<V> {
    pub(super) levels: Vec<Level<V>>,
    weights: Vec<V>,
    camera: Vec<V>,
}

impl<V: std::fmt::Debug> std::fmt::Debug for Level<V> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Level").field("count", &self.count).field("mean", &self.mean).finish_non_exhaustive()
    }
}

impl<V> Default for Scratch<V> {
    fn default() -> Self {
        Self { levels: Vec::new(), weights: Vec::new(), camera: Vec::new() }
    }
}

impl<V: Lanes> Scratch<V> {
    /// Makes room for so many levels.
    pub(super) fn prepare(&mut self, levels: usize, one: V) {
        let none = Level { count: one, mean: one, own: one, blank: one, pooled: one };
        self.levels.resize(levels, none);
        self.weights.resize(levels, one);
        self.camera.resize(levels, one);
    }
}

/// Fits a group: gain, line, uncertainty, and everything but temperatures.
#[inline(always)]
pub(super) fn fit<V: Lanes>(
    one: V,
    constants: &Constants,
    estimator: Estimator,
    group: &Group<V>,
    scratch: &mut Scratch<V>,
) -> Answer<V> {
    let levels = &scratch.levels[..];
    let (weights, camera) = (&mut scratch.weights[..], &mut scratch.camera[..]);
    let zero = one.all(0.0);
    let gains = gain(one, constants, levels, weights);
    let (fitted, defined) = match estimator {
        Estimator::Ols => unweighted(one, constants, group, levels, weights),
        Estimator::Paper => papers(one, constants, group, levels, weights),
        Estimator::Default => ours(one, constants, group, levels, weights, camera),
    };
    let mut answer = judge(one, constants, estimator == Estimator::Default, &fitted);
    // Without a line: nothing but a flag. Our own estimator says nothing of pixels that never change either.
    let seen = match estimator {
        Estimator::Default => one.both(defined, zero.below(group.alive)),
        Estimator::Paper | Estimator::Ols => defined,
    };
    let nan = one.all(f64::NAN);
    for channel in &mut answer.channels {
        *channel = V::pick(seen, *channel, nan);
    }
    let undefined = V::pick(defined, zero, one.all(f64::from(flag::TOO_FEW_LEVELS)));
    answer.flags = group.flags + undefined + V::pick(seen, answer.flags, zero);
    answer.asked = V::pick(seen, answer.asked, zero);
    (answer.channels[GAIN], answer.channels[GAIN + 1]) = gains;
    answer
}

/// Where `gain` stands among the channels.
pub(super) const GAIN: usize = 13;

/// Slope of the blanks against I_cal and its standard deviation; NaN below two and three levels.
#[inline(always)]
fn gain<V: Lanes>(one: V, constants: &Constants, levels: &[Level<V>], weights: &mut [V]) -> (V, V) {
    let zero = one.all(0.0);
    present(one, levels, weights);
    let (line, defined) = line(one, &constants.x, levels, weights, |level| level.blank);
    let freedom = line.points - one.all(2.0);
    let variance = line.chi2 / (freedom * line.spread);
    let many = one.both(defined, zero.below(freedom));
    let (nan, far) = (one.all(f64::NAN), one.all(constants.gamma_far));
    (V::pick(defined, line.slope * far, nan), V::pick(many, variance.root() * far, nan))
}

/// Weight 1 for every level that is there.
#[inline(always)]
fn present<V: Lanes>(one: V, levels: &[Level<V>], weights: &mut [V]) {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    for (weight, level) in weights.iter_mut().zip(levels) {
        *weight = V::pick(zero.below(level.count), unit, zero);
    }
}

/// All levels alike, variance from the scatter about the line.
#[inline(always)]
fn unweighted<V: Lanes>(
    one: V,
    constants: &Constants,
    group: &Group<V>,
    levels: &[Level<V>],
    weights: &mut [V],
) -> (Fitted<V>, V::Mask) {
    present(one, levels, weights);
    let (line, defined) = line(one, &constants.x, levels, weights, |level| level.mean);
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let freedom = line.points - one.all(2.0);
    let some = zero.below(freedom);
    let scale = V::pick(some, line.chi2 / freedom, one.all(f64::NAN));
    let slope = scale / line.spread;
    let inverse = V::pick(some, unit / freedom, unit);
    let fitted = Fitted {
        line,
        covariance: [slope, scale / line.weight, zero],
        slope_variance: slope,
        noise: camera_noise(one, constants, group, levels, weights, &line),
        inverse_freedoms: [inverse, inverse],
        flags: V::pick(some, zero, one.all(f64::from(flag::NO_STATISTICS))),
    };
    (fitted, defined)
}

/// The paper's weights n/max(s², 1/12); a level of one cycle makes the line unweighted.
#[inline(always)]
fn papers<V: Lanes>(
    one: V,
    constants: &Constants,
    group: &Group<V>,
    levels: &[Level<V>],
    weights: &mut [V],
) -> (Fitted<V>, V::Mask) {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let floor = one.all(ROUNDING_VARIANCE);
    let mut single = unit.below(zero);
    for (weight, level) in weights.iter_mut().zip(levels) {
        *weight = level.count / level.own.larger(floor);
        let once = one.both(zero.below(level.count), level.count.at_most(unit));
        single = one.either(single, once);
    }
    let (line, defined) = line(one, &constants.x, levels, weights, |level| level.mean);
    let slope = unit / line.spread;
    let own = Fitted {
        line,
        covariance: [slope, unit / line.weight, zero],
        slope_variance: slope,
        noise: camera_noise(one, constants, group, levels, weights, &line),
        inverse_freedoms: [zero, zero],
        flags: zero,
    };
    if !group.singles {
        return (own, defined);
    }
    let (other, other_defined) = unweighted(one, constants, group, levels, weights);
    let back = one.all(f64::from(flag::FELL_BACK_TO_OLS));
    let other = Fitted { flags: other.flags + back, ..other };
    let here = one.all(1.0);
    let defined = V::pick(defined, here, zero);
    let other_defined = V::pick(other_defined, here, zero);
    (choose(single, &other, &own), zero.below(V::pick(single, other_defined, defined)))
}

/// `yes` where the mask, else `no`. (Spelled out: a closure would not be compiled for the widest vectors.)
#[inline(always)]
fn choose<V: Lanes>(mask: V::Mask, yes: &Fitted<V>, no: &Fitted<V>) -> Fitted<V> {
    let (a, b) = (&yes.line, &no.line);
    Fitted {
        line: Lined {
            slope: V::pick(mask, a.slope, b.slope),
            chi2: V::pick(mask, a.chi2, b.chi2),
            mean_x: V::pick(mask, a.mean_x, b.mean_x),
            mean_y: V::pick(mask, a.mean_y, b.mean_y),
            weight: V::pick(mask, a.weight, b.weight),
            spread: V::pick(mask, a.spread, b.spread),
            points: V::pick(mask, a.points, b.points),
        },
        covariance: [
            V::pick(mask, yes.covariance[0], no.covariance[0]),
            V::pick(mask, yes.covariance[1], no.covariance[1]),
            V::pick(mask, yes.covariance[2], no.covariance[2]),
        ],
        slope_variance: V::pick(mask, yes.slope_variance, no.slope_variance),
        noise: V::pick(mask, yes.noise, no.noise),
        inverse_freedoms: [
            V::pick(mask, yes.inverse_freedoms[0], no.inverse_freedoms[0]),
            V::pick(mask, yes.inverse_freedoms[1], no.inverse_freedoms[1]),
        ],
        flags: V::pick(mask, yes.flags, no.flags),
    }
}

/// Ours, for pixels with pooled variances at two levels at least; see `law` for the reasons. Others are marked.
#[inline(always)]
fn ours<V: Lanes>(
    one: V,
    constants: &Constants,
    group: &Group<V>,
    levels: &[Level<V>],
    weights: &mut [V],
    camera: &mut [V],
) -> (Fitted<V>, V::Mask) {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let least = one.all(VARIANCE_MIN);
    present(one, levels, weights);
    let (first, defined) = line(one, &constants.x, levels, weights, |level| level.mean);
    let (mut low, mut high) = (one.all(f64::INFINITY), one.all(f64::NEG_INFINITY));
    let mut pools = zero;
    for ((&x, level), &here) in constants.x.iter().zip(levels).zip(weights.iter()) {
        let there = zero.below(here);
        low = V::pick(there, low.smaller(one.all(x)), low);
        high = V::pick(there, high.larger(one.all(x)), high);
        pools = pools + V::pick(zero.at_most(level.pooled), here, zero);
    }
    let scale = unit / (group.flat * group.flat);
    for (camera, level) in camera.iter_mut().zip(levels) {
        *camera = camera_variance(one, constants, group, scale, level);
    }
    // A crossing is believed up to half the range of x outside it.
    let margin = (high - low) * one.all(0.5);
    let middle = (high + low) * one.all(0.5);
    let (low, high) = (low - margin, high + margin);
    let mut line_now = first;
    for pass in 0..PASSES {
        let crossing = line_now.mean_x - line_now.mean_y / line_now.slope;
        let crossing = V::pick(crossing.finite(), crossing.larger(low).smaller(high), middle);
        let (mut aa, mut ab, mut bb, mut ay, mut by) = (zero, zero, zero, zero, zero);
        let each = constants.x.iter().zip(levels).zip(camera.iter()).zip(weights.iter_mut());
        for (((&x, level), &camera), weight) in each {
            let pooled = zero.at_most(level.pooled);
            let there = one.both(pooled, zero.below(level.count));
            // `weight` holds n/v of the pass before; the first takes the pooled variances themselves.
            let inverse = if pass == 0 {
                unit / level.pooled.larger(camera).larger(least)
            } else {
                *weight / level.count
            };
            let distance = (crossing - one.all(x)) * (crossing - one.all(x));
            let r = V::pick(there, inverse * inverse, zero);
            let y = V::pick(there, level.pooled - camera, zero);
            let ru = r * distance;
            aa = aa + r;
            ab = ab + ru;
            bb = bb + ru * distance;
            ay = ay + r * y;
            by = by + ru * y;
        }
        let (a, b) = both_positive(one, [aa, ab, bb, ay, by]);
        let each = constants.x.iter().zip(levels).zip(camera.iter()).zip(weights.iter_mut());
        for (((&x, level), &camera), weight) in each {
            let distance = (crossing - one.all(x)) * (crossing - one.all(x));
            *weight = level.count / (camera + a + b * distance).larger(least);
        }
        line_now = line(one, &constants.x, levels, weights, |level| level.mean).0;
    }
    let fitted = sandwich(one, constants, levels, weights, camera, &line_now);
    let alone = one.both(defined, pools.below(one.all(2.0)));
    (Fitted { flags: fitted.flags + one.bit(alone, ALONE), ..fitted }, defined)
}

/// The camera's own variance of spray − blank in one cycle, in the scale of the calibrated gain; `scale` is 1/flat².
#[inline(always)]
fn camera_variance<V: Lanes>(
    one: V,
    constants: &Constants,
    group: &Group<V>,
    scale: V,
    level: &Level<V>,
) -> V {
    let zero = one.all(0.0);
    let (dark, share) = (one.all(constants.zero_counts), one.all(1.0 / constants.blanks));
    let blank = level.blank * group.flat;
    let spray = blank + level.mean * group.flat;
    let shot = (spray - dark).larger(zero) + (blank - dark).larger(zero) * share;
    (one.all(constants.fixed) + shot * one.all(constants.per_count)) * scale
}

/// Variance of a line at its crossing that the camera's noise alone would give.
#[inline(always)]
fn camera_noise<V: Lanes>(
    one: V,
    constants: &Constants,
    group: &Group<V>,
    levels: &[Level<V>],
    weights: &[V],
    line: &Lined<V>,
) -> V {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let scale = unit / (group.flat * group.flat);
    let (per_weight, per_spread) = (unit / line.weight, unit / line.spread);
    let d = (zero - line.mean_y / line.slope) * per_spread;
    let mut noise = zero;
    for ((&x, level), &w) in constants.x.iter().zip(levels).zip(weights) {
        let at = w * (per_weight + d * (one.all(x) - line.mean_x));
        let camera = camera_variance(one, constants, group, scale, level) / level.count;
        noise = noise + V::pick(zero.below(w), at * at * camera, zero);
    }
    noise
}

/// A, B ≥ 0 of the normal equations (aa, ab, bb, ay, by), in closed form.
#[inline(always)]
fn both_positive<V: Lanes>(one: V, [aa, ab, bb, ay, by]: [V; 5]) -> (V, V) {
    let zero = one.all(0.0);
    let determinant = aa * bb - ab * ab;
    let regular = (one.all(1e-9) * (aa * bb)).below(determinant);
    let inverse = one.all(1.0) / determinant;
    let a = (ay * bb - by * ab) * inverse;
    let b = (by * aa - ay * ab) * inverse;
    let (a_right, b_right) = (zero.at_most(a), zero.at_most(b));
    let only_a = V::pick(zero.below(aa), (ay / aa).larger(zero), zero);
    let only_b = V::pick(zero.below(bb), (by / bb).larger(zero), zero);
    // a < 0 ≤ b leaves b alone; anything else that is not inside leaves a alone.
    let inside = one.both(regular, one.both(a_right, b_right));
    let edge_b = one.both(regular, one.both(a.below(zero), b_right));
    (V::pick(inside, a, V::pick(edge_b, zero, only_a)), V::pick(inside, b, V::pick(edge_b, only_b, zero)))
}

/// Covariance from the pixel's own variances with a little of the law's, and Satterthwaite's degrees of freedom; the
/// camera's noise is a floor for the whole.
#[inline(always)]
fn sandwich<V: Lanes>(
    one: V,
    constants: &Constants,
    levels: &[Level<V>],
    weights: &[V],
    camera: &[V],
    line: &Lined<V>,
) -> Fitted<V> {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let law = one.all(FREEDOM_LAW);
    let (per_weight, per_spread) = (unit / line.weight, unit / line.spread);
    let d = zero - line.mean_y / line.slope;
    let mut own = [zero; 3];
    let mut floor = [zero; 3];
    let (mut crossing, mut crossing_2, mut slope_2) = (zero, zero, zero);
    let each = constants.x.iter().zip(levels).zip(weights).zip(camera);
    for (((&x, level), &w), &camera) in each {
        let there = zero.below(w);
        let n = V::pick(there, level.count, unit);
        let freedom = n - unit;
        let total = freedom + law;
        let inverse_total = unit / total;
        // The law's variance is n/w.
        let squares = freedom * level.own + law * (n / w);
        let used = squares * inverse_total / n;
        let used = V::pick(there, used, zero);
        let least = camera.larger(one.all(VARIANCE_MIN)) / n;
        let at_mean = w * per_weight;
        let at_slope = w * (one.all(x) - line.mean_x) * per_spread;
        let at_crossing = at_mean + d * at_slope;
        let (mm, ss, ms) = (at_mean * at_mean, at_slope * at_slope, at_mean * at_slope);
        let of_slope = ss * used;
        own[0] = own[0] + of_slope;
        own[1] = own[1] + mm * used;
        own[2] = own[2] + ms * used;
        floor[0] = floor[0] + ss * least;
        floor[1] = floor[1] + mm * least;
        floor[2] = floor[2] + ms * least;
        let part = at_crossing * at_crossing * used;
        crossing = crossing + part;
        crossing_2 = crossing_2 + part * part * inverse_total;
        slope_2 = slope_2 + of_slope * of_slope * inverse_total;
    }
    let noise = at_crossing_of(one, d, &floor);
    let lower = at_crossing_of(one, d, &own).below(noise);
    let lower_slope = own[0].below(floor[0]);
    Fitted {
        line: *line,
        covariance: [
            V::pick(lower, floor[0], own[0]),
            V::pick(lower, floor[1], own[1]),
            V::pick(lower, floor[2], own[2]),
        ],
        slope_variance: V::pick(lower_slope, floor[0], own[0]),
        noise,
        inverse_freedoms: [
            V::pick(lower, zero, crossing_2 / (crossing * crossing)),
            V::pick(lower_slope, zero, slope_2 / (own[0] * own[0])),
        ],
        flags: zero,
    }
}

/// Variance of the line at a distance from its centre, from var(slope), var(ym), cov.
#[inline(always)]
fn at_crossing_of<V: Lanes>(one: V, d: V, c: &[V; 3]) -> V {
    c[1] + d * d * c[0] + one.all(2.0) * d * c[2]
}

/// A weighted line through one value a level; a weight of 0 leaves a level out. The mask says where there is a line.
#[inline(always)]
fn line<V: Lanes>(
    one: V,
    x: &[f64],
    levels: &[Level<V>],
    weights: &[V],
    value: impl Fn(&Level<V>) -> V,
) -> (Lined<V>, V::Mask) {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    // Differences to a first point are nearly exact, so a pedestal costs no digits in the means.
    let x0 = x.first().copied().unwrap_or(0.0);
    let mut y0 = zero;
    for (level, &w) in levels.iter().zip(weights).rev() {
        y0 = V::pick(zero.below(w), value(level), y0);
    }
    let (mut weight, mut sum_x, mut sum_y, mut points) = (zero, zero, zero, zero);
    for ((&x, level), &w) in x.iter().zip(levels).zip(weights) {
        weight = weight + w;
        sum_x = sum_x + w * one.all(x - x0);
        sum_y = sum_y + w * (value(level) - y0);
        points = points + V::pick(zero.below(w), unit, zero);
    }
    let inverse = unit / weight;
    let (centre_x, centre_y) = (sum_x * inverse, sum_y * inverse);
    let (mut spread, mut sxy) = (zero, zero);
    for ((&x, level), &w) in x.iter().zip(levels).zip(weights) {
        let dx = one.all(x - x0) - centre_x;
        let wx = w * dx;
        spread = spread + wx * dx;
        sxy = sxy + wx * ((value(level) - y0) - centre_y);
    }
    let slope = sxy / spread;
    let mut chi2 = zero;
    for ((&x, level), &w) in x.iter().zip(levels).zip(weights) {
        let residual = ((value(level) - y0) - centre_y) - slope * (one.all(x - x0) - centre_x);
        chi2 = chi2 + w * residual * residual;
    }
    let defined = (one.all(SPREAD_MIN) * weight).below(spread);
    let (mean_x, mean_y) = (one.all(x0) + centre_x, y0 + centre_y);
    (Lined { slope, chi2, mean_x, mean_y, weight, spread, points }, defined)
}

/// t for 1/ν degrees of freedom, clamped to ν ≥ 1: Clenshaw's sum of the Chebyshev series of 1/t.
#[inline(always)]
fn quantile<V: Lanes>(one: V, constants: &Constants, inverse_freedom: V) -> V {
    let zero = one.all(0.0);
    let u = inverse_freedom.smaller(one.all(1.0));
    let z = u + u - one.all(1.0);
    let twice = z + z;
    let (mut b1, mut b2) = (zero, zero);
    for &c in constants.quantile[1..].iter().rev() {
        let b0 = twice * b1 - b2 + one.all(c);
        b2 = b1;
        b1 = b0;
    }
    let t = one.all(1.0) / (z * b1 - b2 + one.all(constants.quantile[0]));
    V::pick(zero.below(u), t, one.all(constants.normal))
}

/// From lines to emissivity, its interval, the crossing and Fieller's set of it.
#[inline(always)]
pub(super) fn judge<V: Lanes>(one: V, constants: &Constants, ours: bool, fitted: &Fitted<V>) -> Answer<V> {
    let (zero, nan) = (one.all(0.0), one.all(f64::NAN));
    let Lined { slope, chi2, mean_x, mean_y, .. } = fitted.line;
    let [v_slope, v_mean, cross] = fitted.covariance;
    let per_gamma = one.all(1.0 / constants.gamma_near);
    let emissivity = (zero - slope) / one.all(constants.gamma_near);
    let sigma = fitted.slope_variance.root() * per_gamma;
    let width = quantile(one, constants, fitted.inverse_freedoms[1]) * sigma;
    let negative = emissivity.below(zero);
    let crossing = mean_x - mean_y / slope;
    let d = mean_y / slope;
    let variance = (v_mean - one.all(2.0) * d * cross + d * d * v_slope) / (slope * slope);
    // Fieller: a d² + 2 b d + c ≤ 0; the discriminant is expanded so that b² − a c does not cancel.
    let t = quantile(one, constants, fitted.inverse_freedoms[0]);
    let t2 = t * t;
    let a = slope * slope - t2 * v_slope;
    let b = slope * mean_y - t2 * cross;
    let c = mean_y * mean_y - t2 * v_mean;
    let inner = v_mean * slope * slope + v_slope * mean_y * mean_y - one.all(2.0) * slope * mean_y * cross;
    let discriminant = t2 * (inner - t2 * (v_mean * v_slope - cross * cross));
    let bounded = one.both(zero.at_most(discriminant), zero.below(a));
    let root = discriminant.root();
    let q = V::pick(b.below(zero), root - b, zero - (b + root));
    let nothing = q.size().below(one.all(f64::from(f32::MIN_POSITIVE)));
    let r1 = V::pick(nothing, zero, q / a);
    let r2 = V::pick(nothing, zero, c / q);
    let (low, high) = (mean_x + r1.smaller(r2), mean_x + r1.larger(r2));
    let open = V::pick(bounded, zero, V::pick(v_slope.finite(), one.all(1.0), zero));
    let mut flags = one.bit(negative, flag::NEGATIVE_EMISSIVITY) + fitted.flags;
    flags = flags + one.bit(zero.below(open), flag::NOT_RESOLVED);
    // A line without a slope has no crossing; the NaN of 0 · ∞ carries a sign that depends on how it was compiled.
    let noise = fitted.noise.root() / slope.size();
    let silent = if ours { one.either(zero.below(open), negative) } else { one.below(zero) };
    let crossing = V::pick(silent, nan, crossing);
    let channels = [
        slope,
        mean_y - slope * mean_x,
        crossing,
        emissivity,
        crossing,
        sigma,
        V::pick(silent, nan, variance.root()),
        chi2,
        emissivity - width,
        emissivity + width,
        V::pick(silent, nan, V::pick(bounded, low, nan)),
        V::pick(silent, nan, V::pick(bounded, high, nan)),
        V::pick(silent, nan, V::pick(noise.finite(), noise, nan)),
        nan,
        nan,
    ];
    Answer { channels, flags, asked: V::pick(silent, zero, one.all(1.0)) }
}
