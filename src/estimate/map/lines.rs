//! Weighted straight lines for several pixels at once, see `line` for one.
//!
//! All sums are formed with centred x and y. What belongs to x and numbers of cycles alone ([`Place`], [`Plain`]) is
//! worked out once a row where all pixels are alike in that, with the operations that single vectors would take.

use super::kernel::Level;
use super::lanes::Lanes;
use super::levels::Levels;
use crate::estimate::law::FREEDOM_LAW;
use crate::estimate::line::SPREAD_MIN;

/// What is known of a level before its counts of light.
#[derive(Clone, Copy)]
pub(super) struct Place<V> {
    /// x, and its distance from the first level's: nearly exact, so a pedestal costs no digits in means.
    pub(super) x: V,
    pub(super) from_first: V,
    /// Cycles that count; 0 leaves the level out.
    pub(super) count: V,
    /// One over them; 0 where the level is not there.
    pub(super) share: V,
    /// n − 1, not below 0, and one over it; 0 where it is 0.
    pub(super) freedom: V,
    pub(super) per_freedom: V,
    /// One over n − 1 and the law's own degrees of freedom.
    pub(super) per_total: V,
    /// The same times one over n: what squared deviations give of the variance of a mean.
    pub(super) own_share: V,
    /// 1 where the level is there, else 0.
    pub(super) here: V,
    /// Distance of x from the mean of all levels that are there, 0 where this is not.
    pub(super) centred: V,
}

/// The x of an unweighted line.
#[derive(Clone, Copy)]
pub(super) struct Plain<V> {
    pub(super) mean_x: V,
    pub(super) weight: V,
    pub(super) spread: V,
    pub(super) per_weight: V,
    pub(super) per_spread: V,
}

/// Crossings that are believed: up to half the range of x outside it.
#[derive(Clone, Copy)]
pub(super) struct Credible<V> {
    low: V,
    high: V,
    middle: V,
}

/// A line.
#[derive(Clone, Copy)]
pub(super) struct Lined<V> {
    pub(super) slope: V,
    /// One over it, and how far the crossing is below the mean x.
    pub(super) per_slope: V,
    pub(super) drop: V,
    pub(super) chi2: V,
    pub(super) mean_x: V,
    pub(super) mean_y: V,
    pub(super) per_weight: V,
    pub(super) per_spread: V,
}

/// Sums of a line.
#[derive(Clone, Copy)]
pub(super) struct Summed<V> {
    pub(super) mean_x: V,
    pub(super) mean_y: V,
    weight: V,
    per_weight: V,
    pub(super) spread: V,
    pub(super) sxy: V,
    centre_y: V,
}

/// Places of levels at `x`, without cycles.
#[inline(always)]
pub(super) fn places<V: Lanes, L: Levels>(one: V, x: &[f64]) -> L::Each<Place<V>> {
    let zero = one.all(0.0);
    let nowhere = Place {
        x: zero,
        from_first: zero,
        count: zero,
        share: zero,
        freedom: zero,
        per_freedom: zero,
        per_total: zero,
        own_share: zero,
        here: zero,
        centred: zero,
    };
    let mut places = L::each(nowhere, x.len());
    for (place, &at) in places.as_mut().iter_mut().zip(x) {
        (place.x, place.from_first) = (one.all(at), one.all(at - x[0]));
    }
    places
}

/// Fills `places` for cycles that count, level by level, and gives the x of the unweighted line.
#[inline(always)]
pub(super) fn place<V: Lanes>(one: V, x: &[f64], places: &mut [Place<V>]) -> Plain<V> {
    let (zero, unit, law) = (one.all(0.0), one.all(1.0), one.all(FREEDOM_LAW));
    let (mut weight, mut sum) = (zero, zero);
    for place in places.iter_mut() {
        let there = zero.below(place.count);
        place.here = V::pick(there, unit, zero);
        place.share = V::pick(there, unit / place.count, zero);
        place.freedom = (place.count - unit).larger(zero);
        place.per_freedom = V::pick(zero.below(place.freedom), unit / place.freedom, zero);
        place.per_total = unit / (place.freedom + law);
        place.own_share = place.per_total * place.share;
        weight = weight + place.here;
        sum = sum + place.here * place.from_first;
    }
    let per_weight = unit / weight;
    let centre = sum * per_weight;
    let mut spread = zero;
    for place in places.iter_mut() {
        place.centred = place.here * (place.from_first - centre);
        spread = spread + place.centred * place.centred;
    }
    let mean_x = one.all(x.first().copied().unwrap_or(0.0)) + centre;
    Plain { mean_x, weight, spread, per_weight, per_spread: unit / spread }
}

impl<V: Lanes> Credible<V> {
    /// Those of the levels that are there.
    #[inline(always)]
    pub(super) fn of(one: V, places: &[Place<V>]) -> Self {
        let (mut low, mut high) = (one.all(f64::INFINITY), one.all(f64::NEG_INFINITY));
        for place in places {
            let there = one.all(0.0).below(place.here);
            low = V::pick(there, low.smaller(place.x), low);
            high = V::pick(there, high.larger(place.x), high);
        }
        let margin = (high - low) * one.all(0.5);
        let middle = (high + low) * one.all(0.5);
        Self { low: low - margin, high: high + margin, middle }
    }

    /// The nearest of them; the middle for what is no number.
    #[inline(always)]
    pub(super) fn clip(&self, crossing: V) -> V {
        V::pick(crossing.finite(), crossing.smaller(self.high).larger(self.low), self.middle)
    }
}

impl<V: Lanes> Plain<V> {
    /// Whether there is a line.
    #[inline(always)]
    pub(super) fn defined(&self, one: V) -> V::Mask {
        (one.all(SPREAD_MIN) * self.weight).below(self.spread)
    }

    /// Mean, relative to whatever the values are, and slope.
    #[inline(always)]
    pub(super) fn slope(&self, one: V, places: &[Place<V>], values: &[V]) -> (V, V) {
        let mut sum = one.all(0.0);
        for (place, &value) in places.iter().zip(values) {
            sum = sum + place.here * value;
        }
        let centre = sum * self.per_weight;
        let mut sxy = one.all(0.0);
        for (place, &value) in places.iter().zip(values) {
            sxy = sxy + place.centred * (value - centre);
        }
        (centre, sxy * self.per_spread)
    }

    /// Squared residuals of the line with this mean and slope.
    #[inline(always)]
    pub(super) fn chi2(&self, one: V, places: &[Place<V>], values: &[V], centre: V, slope: V) -> V {
        let mut chi2 = one.all(0.0);
        for (place, &value) in places.iter().zip(values) {
            let residual = (value - centre) - slope * place.centred;
            chi2 = chi2 + place.here * residual * residual;
        }
        chi2
    }
}

/// Sums of a weighted line of values relative to `y0`; a weight of 0 leaves a level out. `x0` is the first x.
#[inline(always)]
pub(super) fn sums<V: Lanes>(
    one: V,
    places: &[Place<V>],
    values: &[V],
    weights: &[V],
    (x0, y0): (V, V),
) -> Summed<V> {
    let zero = one.all(0.0);
    let (mut weight, mut sum_x, mut sum_y) = (zero, zero, zero);
    for ((place, &value), &w) in places.iter().zip(values).zip(weights) {
        weight = weight + w;
        sum_x = sum_x + w * place.from_first;
        sum_y = sum_y + w * value;
    }
    let per_weight = one.all(1.0) / weight;
    let (centre_x, centre_y) = (sum_x * per_weight, sum_y * per_weight);
    let (mut spread, mut sxy) = (zero, zero);
    for ((place, &value), &w) in places.iter().zip(values).zip(weights) {
        let dx = place.from_first - centre_x;
        let wx = w * dx;
        spread = spread + wx * dx;
        sxy = sxy + wx * (value - centre_y);
    }
    Summed { mean_x: x0 + centre_x, mean_y: y0 + centre_y, weight, per_weight, spread, sxy, centre_y }
}

/// Where a weighted line is zero, in one go: weights that follow from it do not ask for the digits that it loses where one
/// level outweighs the others by far. `mean_x` is that of the unweighted line.
#[inline(always)]
pub(super) fn rough_crossing<V: Lanes>(
    one: V,
    places: &[Place<V>],
    levels: &[Level<V>],
    weights: &[V],
    mean_x: V,
) -> V {
    let zero = one.all(0.0);
    let (mut s, mut sx, mut sy, mut sxx, mut sxy) = (zero, zero, zero, zero, zero);
    for ((place, level), &w) in places.iter().zip(levels).zip(weights) {
        let (wx, wy) = (w * place.centred, w * level.mean);
        s = s + w;
        sx = sx + wx;
        sy = sy + wy;
        sxx = sxx + wx * place.centred;
        sxy = sxy + wx * level.mean;
    }
    mean_x + (sx * sxy - sxx * sy) / (s * sxy - sx * sy)
}

impl<V: Lanes> Summed<V> {
    /// Whether there is a line.
    #[inline(always)]
    pub(super) fn defined(&self, one: V) -> V::Mask {
        (one.all(SPREAD_MIN) * self.weight).below(self.spread)
    }

    /// The line.
    #[inline(always)]
    pub(super) fn line(&self, one: V, places: &[Place<V>], values: &[V], weights: &[V]) -> Lined<V> {
        let per_spread = one.all(1.0) / self.spread;
        let slope = self.sxy * per_spread;
        let mut chi2 = one.all(0.0);
        for ((place, &value), &w) in places.iter().zip(values).zip(weights) {
            let residual = (value - self.centre_y) - slope * (place.x - self.mean_x);
            chi2 = chi2 + w * residual * residual;
        }
        let (mean_x, mean_y) = (self.mean_x, self.mean_y);
        // Not 1/slope: what follows would wait for two divisions.
        let per_slope = self.spread / self.sxy;
        let drop = mean_y * per_slope;
        Lined { slope, per_slope, drop, chi2, mean_x, mean_y, per_weight: self.per_weight, per_spread }
    }
}
