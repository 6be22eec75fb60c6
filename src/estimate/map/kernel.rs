//! The mathematics of the fit for several pixels at once, from level means to emissivity, crossing and their sets.
//!
//! The same operations in the same order whatever the width, and no fused ones: a pixel's bits do not depend on the
//! machine or on the pixels it is fitted with. What a line cannot answer becomes NaN and a flag. Pixels whose variances
//! cannot be pooled are only marked; `single` fits them one by one.
//!
//! A division costs as much as five to ten products here: what can be shared is divided once, and x and numbers of
//! cycles (`lines`) give their quotients once a row.

use super::lanes::Lanes;
use super::levels::Levels;
use super::lines::{self, Credible, Lined, Place, Plain};
use super::verdict::{Answer, Fitted, judge, quantile};
use super::ways::Way;
use super::weights::{Law, camera_noise, ours};
use super::{Estimator, FitInputs, flag};
use crate::estimate::line::ROUNDING_VARIANCE;
use crate::estimate::student::Quantiles;

/// Marks pixels that `single` has to fit. Not a bit of the legend: it never leaves the solver.
pub(super) const ALONE: u32 = 1 << 22;

/// Marks pixels whose crossing is to become a temperature; it never leaves the solver either.
pub(super) const ASKED: u32 = 1 << 21;

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
    /// Coefficients of 1/t over powers of 2/ν − 1, an even number of them.
    pub(super) quantile: Vec<f64>,
    /// t of infinitely many degrees of freedom.
    pub(super) normal: f64,
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
            quantile: even(quantiles.powers()),
            normal: quantiles.at(f64::INFINITY),
        }
    }
}

/// Constants as vectors, worked out once a row: a number that is read, rounded and spread costs three instructions.
#[derive(Clone, Copy)]
pub(super) struct Everywhere<V> {
    /// x of the first level; 0 without one.
    pub(super) first_x: V,
    /// See [`Constants`].
    pub(super) fixed: V,
    pub(super) per_count: V,
    pub(super) zero_counts: V,
    pub(super) gamma_far: V,
    pub(super) normal: V,
    /// One over the blanks of a cycle, and over the near window's transmittance.
    pub(super) per_blank: V,
    pub(super) per_gamma: V,
}

impl<V: Lanes> Everywhere<V> {
    /// `one` is any vector.
    #[inline(always)]
    pub(super) fn new(one: V, constants: &Constants) -> Self {
        Self {
            first_x: one.all(constants.x.first().copied().unwrap_or(0.0)),
            fixed: one.all(constants.fixed),
            per_count: one.all(constants.per_count),
            zero_counts: one.all(constants.zero_counts),
            gamma_far: one.all(constants.gamma_far),
            normal: one.all(constants.normal),
            per_blank: one.all(1.0 / constants.blanks),
            per_gamma: one.all(1.0 / constants.gamma_near),
        }
    }
}

fn even(mut powers: Vec<f64>) -> Vec<f64> {
    powers.resize(powers.len().next_multiple_of(2), 0.0);
    powers
}

/// One level of the pixels at hand.
#[derive(Clone, Copy)]
pub(super) struct Level<V> {
    /// Mean of spray − blank, 0 where nothing counts.
    pub(super) mean: V,
    /// n − 1 times the own sample variance, 0 below two cycles.
    pub(super) squares: V,
    /// Mean of the blanks.
    pub(super) blank: V,
    /// Pooled sample variance, NaN where there is none.
    pub(super) pooled: V,
}

/// The pixels at hand.
pub(super) struct Group<V> {
    /// Gain of the pixels against the calibrated one.
    pub(super) flat: V,
    /// Whether all gains are 1.
    pub(super) even: bool,
    /// Flags so far.
    pub(super) flags: V,
    /// Where a pixel changes at all: 1, else 0.
    pub(super) alive: V,
    /// Mean of spray − blank of the first level that is there.
    pub(super) first_mean: V,
    /// Whether any pixel nearby has a level of one cycle.
    pub(super) singles: bool,
    /// Whether all pixels of the row have as many cycles, at every level.
    pub(super) alike: bool,
}

/// What the pixels at hand share with the others of their row, or know before their counts of light.
pub(super) struct Ground<'a, V> {
    /// Any vector.
    pub(super) one: V,
    pub(super) constants: Everywhere<V>,
    pub(super) places: &'a [Place<V>],
    pub(super) plain: Plain<V>,
    pub(super) credible: Credible<V>,
    /// See [`Constants::quantile`].
    pub(super) powers: &'a [V],
}

/// Memory of a solver for the pixels at hand.
pub(super) struct Scratch<V: Lanes, L: Levels> {
    pub(super) levels: L::Each<Level<V>>,
    /// Means of spray − blank, and of the blanks, less those of the first level that is there.
    pub(super) means: L::Each<V>,
    pub(super) darks: L::Each<V>,
    pub(super) weights: L::Each<V>,
    /// The camera's own variances.
    pub(super) cameras: L::Each<V>,
    pub(super) laws: L::Each<Law<V>>,
}

impl<V: Lanes, L: Levels> Scratch<V, L> {
    /// Memory for some levels; `one` is any vector.
    #[inline(always)]
    pub(super) fn new(one: V, levels: usize) -> Self {
        let zero = one.all(0.0);
        Self {
            levels: L::each(Level { mean: zero, squares: zero, blank: zero, pooled: zero }, levels),
            means: L::each(zero, levels),
            darks: L::each(zero, levels),
            weights: L::each(zero, levels),
            cameras: L::each(zero, levels),
            laws: L::each(Law::none(zero), levels),
        }
    }

    /// Differences of the levels to the first that is there; gives its mean of spray − blank.
    #[inline(always)]
    pub(super) fn relate(&mut self, one: V, places: &[Place<V>], alike: bool) -> V {
        let levels = self.levels.as_ref();
        let (mut mean, mut dark) = (one.all(0.0), one.all(0.0));
        if alike && let Some(first) = levels.first() {
            (mean, dark) = (first.mean, first.blank);
        } else {
            for (place, level) in places.iter().zip(levels).rev() {
                let there = one.all(0.0).below(place.count);
                mean = V::pick(there, level.mean, mean);
                dark = V::pick(there, level.blank, dark);
            }
        }
        let each = levels.iter().zip(self.means.as_mut().iter_mut().zip(self.darks.as_mut()));
        for (level, (of_mean, of_dark)) in each {
            *of_mean = level.mean - mean;
            *of_dark = level.blank - dark;
        }
        mean
    }
}

/// Fits a group: gain, line, uncertainty, and everything but temperatures.
#[inline(always)]
pub(super) fn fit<V: Lanes, W: Way, L: Levels>(
    ground: &Ground<'_, V>,
    mut group: Group<V>,
    scratch: &mut Scratch<V, L>,
) -> Answer<V> {
    let one = ground.one;
    let zero = one.all(0.0);
    group.first_mean = scratch.relate(one, ground.places, group.alike);
    let gains = gain(ground, scratch.darks.as_ref());
    let (fitted, defined) = match W::ESTIMATOR {
        Estimator::Ols => unweighted(ground, &group, scratch),
        Estimator::Paper => papers(ground, &group, scratch),
        Estimator::Default => ours(ground, &group, scratch),
    };
    // Without a line: nothing but a flag. Our own estimator says nothing of pixels that never change either.
    let seen = match W::ESTIMATOR {
        Estimator::Default => one.both(defined, zero.below(group.alive)),
        Estimator::Paper | Estimator::Ols => defined,
    };
    let mut answer = judge(one, &ground.constants, W::ESTIMATOR == Estimator::Default, seen, &fitted);
    let undefined = V::pick(defined, zero, one.all(f64::from(flag::TOO_FEW_LEVELS)));
    answer.flags = group.flags + undefined + answer.flags;
    (answer.channels[GAIN], answer.channels[GAIN + 1]) = gains;
    answer
}

/// Where `gain` stands among the channels, and `sigma_gain`.
pub(super) const GAIN: usize = 13;
pub(super) const SIGMA_GAIN: usize = 14;

/// Slope of the blanks against I_cal and its standard deviation; NaN below two and three levels.
#[inline(always)]
pub(super) fn gain<V: Lanes>(ground: &Ground<'_, V>, darks: &[V]) -> (V, V) {
    let &Ground { one, ref constants, places, plain, .. } = ground;
    let zero = one.all(0.0);
    let (centre, slope) = plain.slope(one, places, darks);
    let chi2 = plain.chi2(one, places, darks, centre, slope);
    let freedom = plain.weight - one.all(2.0);
    let variance = chi2 * plain.per_spread / freedom;
    let defined = plain.defined(one);
    let many = one.both(defined, zero.below(freedom));
    let (nan, far) = (one.all(f64::NAN), constants.gamma_far);
    (V::pick(defined, slope * far, nan), V::pick(many, variance.root() * far, nan))
}

/// All levels alike, variance from the scatter about the line.
#[inline(always)]
fn unweighted<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    group: &Group<V>,
    scratch: &mut Scratch<V, L>,
) -> (Fitted<V>, V::Mask) {
    let &Ground { one, ref constants, places, plain, powers, .. } = ground;
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    for (weight, place) in scratch.weights.as_mut().iter_mut().zip(places) {
        *weight = place.here;
    }
    let values = scratch.means.as_ref();
    let (centre, slope) = plain.slope(one, places, values);
    let chi2 = plain.chi2(one, places, values, centre, slope);
    let (per_slope, mean_y) = (unit / slope, group.first_mean + centre);
    let line = Lined {
        slope,
        per_slope,
        drop: mean_y * per_slope,
        chi2,
        mean_x: plain.mean_x,
        mean_y,
        per_weight: plain.per_weight,
        per_spread: plain.per_spread,
    };
    let freedom = plain.weight - one.all(2.0);
    let some = zero.below(freedom);
    let per_freedom = unit / freedom;
    let scale = V::pick(some, chi2 * per_freedom, one.all(f64::NAN));
    let of_slope = scale * plain.per_spread;
    let t = quantile(one, constants.normal, powers, V::pick(some, per_freedom, unit));
    let fitted = Fitted {
        line,
        covariance: [of_slope, scale * plain.per_weight, zero],
        slope_variance: of_slope,
        noise: camera_noise(ground, group, scratch, &line),
        quantiles: [t, t],
        flags: V::pick(some, zero, one.all(f64::from(flag::NO_STATISTICS))),
    };
    (fitted, plain.defined(one))
}

/// The paper's weights n/max(s², 1/12); a level of one cycle makes the line unweighted.
#[inline(always)]
fn papers<V: Lanes, L: Levels>(
    ground: &Ground<'_, V>,
    group: &Group<V>,
    scratch: &mut Scratch<V, L>,
) -> (Fitted<V>, V::Mask) {
    let &Ground { one, ref constants, places, .. } = ground;
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let floor = one.all(ROUNDING_VARIANCE);
    let mut single = unit.below(zero);
    let each = scratch.weights.as_mut().iter_mut().zip(places).zip(scratch.levels.as_ref());
    for ((weight, place), level) in each {
        *weight = place.count / (level.squares * place.per_freedom).larger(floor);
        let once = one.both(zero.below(place.count), place.count.at_most(unit));
        single = one.either(single, once);
    }
    let first = (constants.first_x, group.first_mean);
    let (values, weights) = (scratch.means.as_ref(), scratch.weights.as_ref());
    let sums = lines::sums(one, places, values, weights, first);
    let line = sums.line(one, places, values, weights);
    let defined = sums.defined(one);
    let normal = constants.normal;
    let own = Fitted {
        line,
        covariance: [line.per_spread, line.per_weight, zero],
        slope_variance: line.per_spread,
        noise: camera_noise(ground, group, scratch, &line),
        quantiles: [normal, normal],
        flags: zero,
    };
    if !group.singles {
        return (own, defined);
    }
    let (other, other_defined) = unweighted(ground, group, scratch);
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
            per_slope: V::pick(mask, a.per_slope, b.per_slope),
            drop: V::pick(mask, a.drop, b.drop),
            chi2: V::pick(mask, a.chi2, b.chi2),
            mean_x: V::pick(mask, a.mean_x, b.mean_x),
            mean_y: V::pick(mask, a.mean_y, b.mean_y),
            per_weight: V::pick(mask, a.per_weight, b.per_weight),
            per_spread: V::pick(mask, a.per_spread, b.per_spread),
        },
        covariance: [
            V::pick(mask, yes.covariance[0], no.covariance[0]),
            V::pick(mask, yes.covariance[1], no.covariance[1]),
            V::pick(mask, yes.covariance[2], no.covariance[2]),
        ],
        slope_variance: V::pick(mask, yes.slope_variance, no.slope_variance),
        noise: V::pick(mask, yes.noise, no.noise),
        quantiles: [
            V::pick(mask, yes.quantiles[0], no.quantiles[0]),
            V::pick(mask, yes.quantiles[1], no.quantiles[1]),
        ],
        flags: V::pick(mask, yes.flags, no.flags),
    }
}
