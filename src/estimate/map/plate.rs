//! Pixels that do not see the plate: their blanks do not follow it.

use super::answers::{self, Answers};
use super::kernel::{self, Everywhere, GAIN, Ground, SIGMA_GAIN, Scratch};
use super::lanes::Machine;
use super::levels::Any;
use super::lines::{self, Credible};
use super::rows::{Row, Walk};
use super::solver::Common;
use super::{Estimator, flag};
use pulp::Scalar;

/// Pixels that take part in the estimate of the highest gain.
const GAINS_MAX: usize = 16_384;

/// Pixels that are looked at together: hardly any of them is beside the plate.
const TOGETHER: usize = 64;

/// Masks pixels of a gain below half of the 90th percentile of all pixels, if the blanks follow the plate clearly at
/// all. Our own estimator gives them no answer.
pub(super) fn mask<F: Machine, M: Answers<F>>(common: &Common<'_>, map: &mut M) {
    let (mut channels, flags) = answers::whole(map);
    let Some(limit) = limit(common, channels[GAIN], channels[SIGMA_GAIN]) else { return };
    for (start, flags) in (0..).step_by(TOGETHER).zip(flags.chunks_mut(TOGETHER)) {
        let gains = &channels[GAIN][start..start + flags.len()];
        if !gains.iter().fold(false, |any, gain| any | (*gain < limit)) {
            continue;
        }
        for (i, flags) in flags.iter_mut().enumerate() {
            if channels[GAIN][start + i] < limit {
                *flags |= flag::NO_PLATE;
                if common.inputs.estimator == Estimator::Default {
                    answers::silence(&mut channels, flags, start + i, F::NAN);
                }
            }
        }
    }
}

/// Half of the 90th percentile of `gains`; None where it is not six of its own standard deviations (so that noise alone
/// masks none). `sigmas` may be empty.
fn limit<F: Machine>(common: &Common<'_>, gains: &[F], sigmas: &[F]) -> Option<F> {
    let step = gains.len().div_ceil(GAINS_MAX).max(1);
    let sample = || (0..gains.len()).step_by(step);
    let mut known: Vec<F> = sample().map(|i| gains[i]).filter(|gain| gain.is_number()).collect();
    let place = known.len().checked_sub(1)? * 9 / 10;
    let order = |a: &F, b: &F| a.wide().total_cmp(&b.wide());
    let (_, &mut high, _) = known.select_nth_unstable_by(place, order);
    // Pixels of the very same gain take turns by their standard deviations.
    let lower = known.iter().filter(|gain| order(gain, &high).is_lt()).count();
    let twins: Vec<usize> = sample().filter(|&i| order(&gains[i], &high).is_eq()).collect();
    let mut sigmas = if sigmas.is_empty() {
        sigma_gains(common, &twins)
    } else {
        twins.iter().map(|&i| sigmas[i]).collect()
    };
    sigmas.sort_unstable_by(order);
    // NaN is not clear.
    let clear = F::of(6.0) * *sigmas.get(place - lower)? < high;
    clear.then_some(F::of(0.5) * high)
}

/// Standard deviations of the gains of some pixels, in order of pixels.
fn sigma_gains<F: Machine>(common: &Common<'_>, pixels: &[usize]) -> Vec<F> {
    let columns = common.source.like().columns();
    let mut walk = Walk::<F>::new(common.source, common.inputs, &common.used);
    let mut sigmas = Vec::with_capacity(pixels.len());
    for pixels in pixels.chunk_by(|a, b| a / columns == b / columns) {
        let row = pixels[0] / columns;
        walk.start(row..row + 1, false);
        if let Some(row) = walk.row() {
            sigmas.extend(pixels.iter().map(|pixel| sigma_gain(common, &row, pixel % columns)));
        }
    }
    sigmas
}

/// The standard deviation of one pixel's gain, with the operations of the vectors.
fn sigma_gain<F: Machine>(common: &Common<'_>, row: &Row<'_, F>, column: usize) -> F {
    let (simd, constants) = (Scalar::new(), &common.constants);
    let one = F::read(simd, row.flat, column);
    let mut places = lines::places::<_, Any>(one, &constants.x);
    let mut scratch = Scratch::<_, Any>::new(one, constants.x.len());
    for (k, (place, level)) in places.iter_mut().zip(&mut scratch.levels).enumerate() {
        let at = k * row.stride + column;
        place.count = F::read(simd, row.count, at);
        level.blank = F::read(simd, row.blank, at);
    }
    let plain = lines::place(one, &constants.x, &mut places);
    scratch.relate(one, &places, false);
    let credible = Credible::of(one, &places);
    let constants = Everywhere::new(one, constants);
    let ground = Ground { one, constants, places: &places, plain, credible, powers: &[] };
    let mut sigma = [F::NAN];
    F::write::<Scalar>(&mut sigma, kernel::gain(&ground, &scratch.darks).1);
    sigma[0]
}
