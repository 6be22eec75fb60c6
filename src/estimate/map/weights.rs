//! Our own estimator for several pixels at once: the variance law, the weights that follow, and the sandwich of their
//! uncertainty. See `law` for the reasons.

use super::kernel::{ALONE, Everywhere, Ground, Group, Scratch};
use super::lanes::Lanes;
use super::levels::Levels;
use super::lines::{self, Lined};
use super::verdict::{Fitted, quantile};
use crate::estimate::law::{PASSES, VARIANCE_MIN};

/// Ours, for pixels with pooled variances at two levels at least. Others are marked.
#[inline(always)]
pub(super) fn ours<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    group: &Group<V>,
    scratch: &mut Scratch<V, L>,
) -> (Fitted<V>, V::Mask) {
    measure(ground, group, scratch);
    let &Ground { one, ref constants, places, plain, .. } = ground;
    let zero = one.all(0.0);
    let mut least = one.all(VARIANCE_MIN);
    let (levels, values) = (scratch.levels.as_ref(), scratch.means.as_ref());
    let (weights, laws) = (scratch.weights.as_mut(), scratch.laws.as_mut());
    let defined = plain.defined(one);
    let (centre, slope) = plain.slope(one, places, values);
    let mut crossing = plain.mean_x - (group.first_mean + centre) / slope;
    let mut pools = zero;
    let each = laws.iter_mut().zip(levels).zip(scratch.cameras.as_ref());
    for (((law, level), &camera), place) in each.zip(places) {
        let pooled = zero.at_most(level.pooled);
        let near = V::pick(pooled, place.here, zero);
        pools = pools + near;
        let excess = V::pick(pooled, level.pooled - camera, zero);
        // The first pass takes the pooled variances themselves.
        let variance = level.pooled.larger(camera).larger(least);
        *law = Law { camera, near, excess, inverse: zero, variance };
    }
    if !group.even {
        // In counts of the pixel: what 16 bits can hold has products that f32 can, whatever the gain.
        let scale = group.flat * group.flat;
        least = least * scale;
        laws.iter_mut().for_each(|law| *law = law.scaled(scale));
    }
    invert(one, laws);
    for _ in 1..PASSES {
        weigh(ground, laws, weights, crossing, least);
        crossing = lines::rough_crossing(one, places, levels, weights, plain.mean_x);
    }
    weigh(ground, laws, weights, crossing, least);
    if !group.even {
        let scale = group.flat * group.flat;
        let per_scale = one.all(1.0) / scale;
        laws.iter_mut().for_each(|law| *law = law.scaled(per_scale));
        weights.iter_mut().for_each(|weight| *weight = *weight * scale);
    }
    let first = (constants.first_x, group.first_mean);
    let line = lines::sums(one, places, values, weights, first).line(one, places, values, weights);
    let fitted = sandwich(ground, scratch, &line);
    let alone = one.both(defined, pools.below(one.all(2.0)));
    (Fitted { flags: fitted.flags + one.bit(alone, ALONE), ..fitted }, defined)
}

/// The law by pooled variances and a crossing, and the weights that follow; no variance is below `least`.
#[inline(always)]
fn weigh<V: Lanes>(ground: &Ground<'_, V>, laws: &mut [Law<V>], weights: &mut [V], crossing: V, least: V) {
    let &Ground { one, places, .. } = ground;
    let zero = one.all(0.0);
    let clipped = ground.credible.clip(crossing);
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
    for (place, law) in places.iter().zip(laws.iter_mut()) {
        let off = clipped - place.x;
        law.variance = (law.camera + a + b * (off * off)).larger(least);
    }
    invert(one, laws);
    for ((place, law), weight) in places.iter().zip(laws.iter()).zip(weights) {
        *weight = place.count * law.inverse;
    }
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

impl<V: Lanes> Law<V> {
    /// The same in another unit of variances, but for the inverse.
    #[inline(always)]
    fn scaled(self, scale: V) -> Self {
        let Self { camera, excess, variance, .. } = self;
        Self { camera: camera * scale, excess: excess * scale, variance: variance * scale, ..self }
    }
}

/// Works out the camera's own variance of spray − blank in one cycle, level by level, in the scale of the calibrated gain.
#[inline(always)]
fn measure<V: Lanes, L: Levels>(ground: &Ground<'_, V>, group: &Group<V>, scratch: &mut Scratch<V, L>) {
    let &Ground { one, ref constants, .. } = ground;
    let each = scratch.cameras.as_mut().iter_mut().zip(scratch.levels.as_ref());
    if group.even {
        for (camera, level) in each {
            *camera = camera_variance(one, constants, level.blank, level.mean);
        }
    } else {
        let scale = one.all(1.0) / (group.flat * group.flat);
        for (camera, level) in each {
            let (blank, mean) = (level.blank * group.flat, level.mean * group.flat);
            *camera = camera_variance(one, constants, blank, mean) * scale;
        }
    }
}

/// One over the variances: one division for three of them, whose product is far from the ends of f32 in counts of the pixel
/// (variances of 16 bit are below 10¹⁰). Two or three roundings more than a quotient each.
#[inline(always)]
fn invert<V: Lanes>(one: V, laws: &mut [Law<V>]) {
    let unit = one.all(1.0);
    let (threes, rest) = laws.as_chunks_mut::<3>();
    for [a, b, c] in threes {
        let both = a.variance * b.variance;
        let inverse = unit / (both * c.variance);
        let of_both = inverse * c.variance;
        c.inverse = inverse * both;
        a.inverse = of_both * b.variance;
        b.inverse = of_both * a.variance;
    }
    match rest {
        [a, b] => {
            let inverse = unit / (a.variance * b.variance);
            a.inverse = inverse * b.variance;
            b.inverse = inverse * a.variance;
        }
        [a] => a.inverse = unit / a.variance,
        _ => {}
    }
}

/// The same of one level in the counts of the pixel.
#[inline(always)]
fn camera_variance<V: Lanes>(one: V, constants: &Everywhere<V>, blank: V, mean: V) -> V {
    let (zero, dark) = (one.all(0.0), constants.zero_counts);
    let spray = blank + mean;
    let shot = (spray - dark).larger(zero) + (blank - dark).larger(zero) * constants.per_blank;
    constants.fixed + shot * constants.per_count
}

/// Variance of a line at its crossing that the camera's noise alone would give.
#[inline(always)]
pub(super) fn camera_noise<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    group: &Group<V>,
    scratch: &mut Scratch<V, L>,
    line: &Lined<V>,
) -> V {
    measure(ground, group, scratch);
    let &Ground { one, places, .. } = ground;
    let zero = one.all(0.0);
    let d = (zero - line.drop) * line.per_spread;
    let mut noise = zero;
    let each = places.iter().zip(scratch.cameras.as_ref()).zip(scratch.weights.as_ref());
    for ((place, &camera), &w) in each {
        let at = w * (line.per_weight + d * (place.x - line.mean_x));
        let camera = camera * place.share;
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
    let &Ground { one, ref constants, places, powers, .. } = ground;
    let zero = one.all(0.0);
    let law_freedom = one.all(crate::estimate::law::FREEDOM_LAW);
    let least = one.all(VARIANCE_MIN);
    // What all levels have in common, one over the sums of the line, is multiplied in at the end.
    let reach = (zero - line.drop) * line.per_spread;
    let (mut own, mut floor) = ([zero; 3], [zero; 3]);
    let (mut crossing, mut crossing_2, mut slope_2, mut noise) = (zero, zero, zero, zero);
    let (levels, weights) = (scratch.levels.as_ref(), scratch.weights.as_ref());
    let each = places.iter().zip(levels).zip(weights).zip(scratch.laws.as_ref());
    for (((place, level), &w), law) in each {
        // Where the level is not there its weight, and with it every part, is 0.
        let w_2 = w * w;
        let squares = level.squares + law_freedom * law.variance;
        let used = squares * place.own_share * w_2;
        let camera = law.camera.larger(least) * place.share * w_2;
        let off = place.x - line.mean_x;
        let at_crossing = line.per_weight + reach * off;
        let cc = at_crossing * at_crossing;
        let (used_off, camera_off) = (used * off, camera * off);
        let of_slope = used_off * off;
        own[0] = own[0] + of_slope;
        own[1] = own[1] + used;
        own[2] = own[2] + used_off;
        floor[0] = floor[0] + camera_off * off;
        floor[1] = floor[1] + camera;
        floor[2] = floor[2] + camera_off;
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
    let of_slope = line.per_spread * line.per_spread;
    let of_mean = line.per_weight * line.per_weight;
    let of_both = line.per_weight * line.per_spread;
    Fitted {
        line: *line,
        covariance: [
            V::pick(lower, floor[0], own[0]) * of_slope,
            V::pick(lower, floor[1], own[1]) * of_mean,
            V::pick(lower, floor[2], own[2]) * of_both,
        ],
        slope_variance: V::pick(lower_slope, floor[0], own[0]) * of_slope,
        noise,
        quantiles: [
            quantile(one, constants.normal, powers, inverse_freedoms[0]),
            quantile(one, constants.normal, powers, inverse_freedoms[1]),
        ],
        flags: zero,
    }
}
