//! Our own estimator for several pixels at once: the variance law, the weights that follow, and the sandwich of their
//! uncertainty. See `law` for the reasons.

use super::kernel::{ALONE, Constants, Ground, Group, Level, Scratch};
use super::lanes::Lanes;
use super::levels::Levels;
use super::lines::{self, Lined, Place};
use super::verdict::{Fitted, quantile};
use crate::estimate::law::{PASSES, VARIANCE_MIN};

/// Ours, for pixels with pooled variances at two levels at least. Others are marked.
#[inline(always)]
pub(super) fn ours<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    group: &Group<V>,
    scratch: &mut Scratch<V, L>,
) -> (Fitted<V>, V::Mask) {
    let &Ground { one, constants, places, plain, .. } = ground;
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let least = one.all(VARIANCE_MIN);
    let (levels, values) = (scratch.levels.as_ref(), scratch.means.as_ref());
    let (weights, laws) = (scratch.weights.as_mut(), scratch.laws.as_mut());
    let defined = plain.defined(one);
    let first = (one.all(constants.x.first().copied().unwrap_or(0.0)), group.first_mean);
    let (centre, slope) = plain.slope(one, places, values);
    let mut crossing = plain.mean_x - (first.1 + centre) / slope;
    let (low, high) = range(one, places);
    let mut pools = zero;
    let scale = unit / (group.flat * group.flat);
    for ((law, level), place) in laws.iter_mut().zip(levels).zip(places) {
        let camera = camera_variance(one, constants, group, scale, level);
        let pooled = zero.at_most(level.pooled);
        let near = V::pick(pooled, place.here, zero);
        pools = pools + near;
        let excess = V::pick(pooled, level.pooled - camera, zero);
        // The first pass takes the pooled variances themselves.
        let inverse = unit / level.pooled.larger(camera).larger(least);
        *law = Law { camera, near, excess, inverse, variance: zero };
    }
    // A crossing is believed up to half the range of x outside it.
    let margin = (high - low) * one.all(0.5);
    let middle = (high + low) * one.all(0.5);
    let (low, high) = (low - margin, high + margin);
    let mut sums = None;
    for _ in 0..PASSES {
        let clipped = V::pick(high.below(crossing), high, V::pick(crossing.below(low), low, crossing));
        let clipped = V::pick(crossing.finite(), clipped, middle);
        let (mut aa, mut ab, mut bb, mut ay, mut by) = (zero, zero, zero, zero, zero);
        for (place, law) in places.iter().zip(laws.iter()) {
            let off = clipped - place.x;
            let distance = off * off;
            let r = law.near * law.inverse * law.inverse;
            let ru = r * distance;
            aa = aa + r;
            ab = ab + ru;
            bb = bb + ru * distance;
            ay = ay + r * law.excess;
            by = by + ru * law.excess;
        }
        let (a, b) = both_positive(one, [aa, ab, bb, ay, by]);
        for ((place, law), weight) in places.iter().zip(laws.iter_mut()).zip(weights.iter_mut()) {
            let off = clipped - place.x;
            law.variance = (law.camera + a + b * (off * off)).larger(least);
            law.inverse = unit / law.variance;
            *weight = place.count * law.inverse;
        }
        let of_pass = lines::sums(one, places, values, weights, first);
        crossing = of_pass.crossing();
        sums = Some(of_pass);
    }
    let line = sums.expect("there are passes").line(one, places, values, weights);
    let fitted = sandwich(ground, scratch, &line);
    let alone = one.both(defined, pools.below(one.all(2.0)));
    (Fitted { flags: fitted.flags + one.bit(alone, ALONE), ..fitted }, defined)
}

/// What the law says of a level.
#[derive(Clone, Copy)]
pub(super) struct Law<V> {
    /// The camera's own variance.
    camera: V,
    /// 1 where there is a pooled variance, and what it has beyond the camera's; else 0.
    near: V,
    excess: V,
    /// One over the variance by the law, and the variance.
    inverse: V,
    variance: V,
}

impl<V: Copy> Law<V> {
    pub(super) fn none(one: V) -> Self {
        Self { camera: one, near: one, excess: one, inverse: one, variance: one }
    }
}

/// Least and greatest x of the levels that are there.
#[inline(always)]
fn range<V: Lanes>(one: V, places: &[Place<V>]) -> (V, V) {
    let (mut low, mut high) = (one.all(f64::INFINITY), one.all(f64::NEG_INFINITY));
    for place in places {
        let there = one.all(0.0).below(place.here);
        low = V::pick(there, low.smaller(place.x), low);
        high = V::pick(there, high.larger(place.x), high);
    }
    (low, high)
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
pub(super) fn camera_noise<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    group: &Group<V>,
    scratch: &Scratch<V, L>,
    line: &Lined<V>,
) -> V {
    let &Ground { one, constants, places, .. } = ground;
    let zero = one.all(0.0);
    let scale = one.all(1.0) / (group.flat * group.flat);
    let d = (zero - line.drop) * line.per_spread;
    let mut noise = zero;
    let each = places.iter().zip(scratch.levels.as_ref()).zip(scratch.weights.as_ref());
    for ((place, level), &w) in each {
        let at = w * (line.per_weight + d * (place.x - line.mean_x));
        let camera = camera_variance(one, constants, group, scale, level) * place.share;
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
    let a = ay * bb - by * ab;
    let b = by * aa - ay * ab;
    let (a_right, b_right) = (zero.at_most(a), zero.at_most(b));
    // a < 0 ≤ b leaves b alone; anything else that is not inside leaves a alone.
    let inside = one.both(regular, one.both(a_right, b_right));
    let edge_b = one.both(regular, one.both(a.below(zero), b_right));
    let divisor = V::pick(inside, determinant, V::pick(edge_b, bb, aa));
    let inverse = V::pick(zero.below(divisor), one.all(1.0) / divisor, zero);
    let only_a = V::pick(edge_b, zero, ay.larger(zero));
    let only_b = V::pick(edge_b, by.larger(zero), zero);
    (V::pick(inside, a, only_a) * inverse, V::pick(inside, b, only_b) * inverse)
}

/// Covariance from the pixel's own variances with a little of the law's, and Satterthwaite's degrees of freedom; the
/// camera's noise is a floor for the whole.
#[inline(always)]
fn sandwich<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    scratch: &Scratch<V, L>,
    line: &Lined<V>,
) -> Fitted<V> {
    let &Ground { one, constants, places, powers, .. } = ground;
    let zero = one.all(0.0);
    let law_freedom = one.all(crate::estimate::law::FREEDOM_LAW);
    let least = one.all(VARIANCE_MIN);
    let d = zero - line.drop;
    let mut own = [zero; 3];
    let mut floor = [zero; 3];
    let (mut crossing, mut crossing_2, mut slope_2, mut noise) = (zero, zero, zero, zero);
    let (levels, weights) = (scratch.levels.as_ref(), scratch.weights.as_ref());
    let each = places.iter().zip(levels).zip(weights).zip(scratch.laws.as_ref());
    for (((place, level), &w), law) in each {
        // Where the level is not there its weight, and with it every part, is 0.
        let squares = level.squares + law_freedom * law.variance;
        let used = squares * (place.per_total * place.share);
        let camera = law.camera.larger(least) * place.share;
        let at_mean = w * line.per_weight;
        let at_slope = w * (place.x - line.mean_x) * line.per_spread;
        let at_crossing = at_mean + d * at_slope;
        let (mm, ss, ms) = (at_mean * at_mean, at_slope * at_slope, at_mean * at_slope);
        let cc = at_crossing * at_crossing;
        let of_slope = ss * used;
        own[0] = own[0] + of_slope;
        own[1] = own[1] + mm * used;
        own[2] = own[2] + ms * used;
        floor[0] = floor[0] + ss * camera;
        floor[1] = floor[1] + mm * camera;
        floor[2] = floor[2] + ms * camera;
        let part = cc * used;
        crossing = crossing + part;
        crossing_2 = crossing_2 + part * part * place.per_total;
        noise = noise + cc * camera;
        slope_2 = slope_2 + of_slope * of_slope * place.per_total;
    }
    let lower = crossing.below(noise);
    let lower_slope = own[0].below(floor[0]);
    let inverse_freedoms = [
        V::pick(lower, zero, crossing_2 / (crossing * crossing)),
        V::pick(lower_slope, zero, slope_2 / (own[0] * own[0])),
    ];
    Fitted {
        line: *line,
        covariance: [
            V::pick(lower, floor[0], own[0]),
            V::pick(lower, floor[1], own[1]),
            V::pick(lower, floor[2], own[2]),
        ],
        slope_variance: V::pick(lower_slope, floor[0], own[0]),
        noise,
        quantiles: [
            quantile(one, constants, powers, inverse_freedoms[0]),
            quantile(one, constants, powers, inverse_freedoms[1]),
        ],
        flags: zero,
    }
}
