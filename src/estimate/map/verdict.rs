//! From lines to emissivity, crossing, their intervals and flags, for several pixels at once.

use super::kernel::{ASKED, Everywhere};
use super::lanes::Lanes;
use super::lines::Lined;
use super::{CHANNELS, flag};

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
    /// Quantiles of the crossing's variance and of the slope's.
    pub(super) quantiles: [V; 2],
    pub(super) flags: V,
}

/// What is known of the pixels before temperatures.
#[derive(Clone, Copy)]
pub(super) struct Answer<V> {
    /// In the order of [`CHANNELS`]; temperatures still as crossings, `sigma_temperature_k` as that of the crossing.
    pub(super) channels: [V; CHANNELS.len()],
    /// With [`ASKED`] where a temperature is wanted.
    pub(super) flags: V,
}

/// t for 1/ν degrees of freedom, clamped to ν ≥ 1: Horner's sum of a polynomial of 1/t in 2/ν − 1,
/// whose coefficients are `powers`, an even number of them; `normal` is t of infinitely many.
#[inline(always)]
pub(super) fn quantile<V: Lanes>(one: V, normal: V, powers: &[V], inverse_freedom: V) -> V {
    let (zero, unit) = (one.all(0.0), one.all(1.0));
    let u = inverse_freedom.smaller(unit);
    let z = u + u - unit;
    // In twos: half as many operations that wait for each other.
    let (z_2, mut sum) = (z * z, zero);
    for &[even, odd] in powers.as_chunks().0.iter().rev() {
        sum = sum * z_2 + (odd * z + even);
    }
    V::pick(zero.below(u), unit / sum, normal)
}

/// From lines to emissivity, its interval, the crossing and Fieller's set of it, where there is a line; else NaN and no
/// flag.
#[inline(always)]
pub(super) fn judge<V: Lanes>(
    one: V,
    constants: &Everywhere<V>,
    ours: bool,
    seen: V::Mask,
    fitted: &Fitted<V>,
) -> Answer<V> {
    let (zero, nan) = (one.all(0.0), one.all(f64::NAN));
    let Lined { slope, per_slope, drop: d, chi2, mean_x, mean_y, .. } = fitted.line;
    let [v_slope, v_mean, cross] = fitted.covariance;
    let [t, t_slope] = fitted.quantiles;
    let per_gamma = constants.per_gamma;
    let emissivity = (zero - slope) * per_gamma;
    let sigma = fitted.slope_variance.root() * per_gamma;
    let width = t_slope * sigma;
    let negative = emissivity.below(zero);
    let crossing = mean_x - d;
    let variance = v_mean - (cross + cross) * d + d * d * v_slope;
    // Fieller: a d² + 2 b d + c ≤ 0; the discriminant is expanded so that b² − a c does not cancel.
    let t2 = t * t;
    let slope_2 = slope * slope;
    let mean_2 = mean_y * mean_y;
    let product = slope * mean_y;
    let a = slope_2 - t2 * v_slope;
    let b = product - t2 * cross;
    let c = mean_2 - t2 * v_mean;
    let inner = v_mean * slope_2 + v_slope * mean_2 - (product + product) * cross;
    let discriminant = t2 * (inner - t2 * (v_mean * v_slope - cross * cross));
    let bounded = one.both(zero.at_most(discriminant), zero.below(a));
    let root = discriminant.root();
    let q = V::pick(b.below(zero), root - b, zero - (b + root));
    let nothing = q.size().below(one.all(f64::from(f32::MIN_POSITIVE)));
    let r1 = V::pick(nothing, zero, q / a);
    let r2 = V::pick(nothing, zero, c / q);
    let (low, high) = (mean_x + r1.smaller(r2), mean_x + r1.larger(r2));
    let opened = one.without(v_slope.finite(), bounded);
    let flags = one.bit(negative, flag::NEGATIVE_EMISSIVITY) + fitted.flags;
    let flags = flags + one.bit(opened, flag::NOT_RESOLVED);
    let size = per_slope.size();
    // A line without a slope has no crossing; the NaN of 0 · ∞ carries a sign that depends on how it was compiled.
    let noise = fitted.noise.root() * size;
    let told = if ours { one.without(seen, one.either(opened, negative)) } else { seen };
    let set = one.both(told, bounded);
    let crossing = V::pick(told, crossing, nan);
    let channels = [
        V::pick(seen, slope, nan),
        V::pick(seen, mean_y - slope * mean_x, nan),
        crossing,
        V::pick(seen, emissivity, nan),
        crossing,
        V::pick(seen, sigma, nan),
        V::pick(told, variance.root() * size, nan),
        V::pick(seen, chi2, nan),
        V::pick(seen, emissivity - width, nan),
        V::pick(seen, emissivity + width, nan),
        V::pick(set, low, nan),
        V::pick(set, high, nan),
        V::pick(one.both(told, noise.finite()), noise, nan),
        nan,
        nan,
    ];
    Answer { channels, flags: V::pick(seen, flags, zero) + one.bit(told, ASKED) }
}
