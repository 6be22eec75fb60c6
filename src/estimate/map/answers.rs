//! Where the answers of a fit go: the channels that a map has, whole or cut into bands and rows.

use super::kernel::GAIN;
use super::{CHANNELS, FitInputs, flag};
use crate::estimate::accumulate::Sums;

/// A map that a fit can fill.
pub(super) trait Answers<F> {
    /// Which of [`CHANNELS`] it has. What is only needed for the others is not computed.
    const WANTED: [bool; CHANNELS.len()];

    /// Takes down what is fitted, apart from channels; of `like` only shape and settings matter.
    fn prepare(&mut self, like: &Sums, inputs: &FitInputs<'_>);

    /// The channels in the order of [`CHANNELS`], None where it has none, and the flags.
    fn planes_mut(&mut self) -> ([Option<&mut Vec<F>>; CHANNELS.len()], &mut Vec<u32>);
}

/// Channels in the order of [`CHANNELS`]; empty where they are not wanted.
pub(super) type Channels<'a, F> = [&'a mut [F]; CHANNELS.len()];

/// Makes room for `pixels` pixels; every value is then written by the fit.
pub(super) fn reshape<F: Copy + Default>(map: &mut impl Answers<F>, pixels: usize) {
    let (planes, flags) = map.planes_mut();
    for plane in planes.into_iter().flatten() {
        // Zeroed, not NaN: fresh memory of that kind is only touched by the threads that fill it.
        if plane.len() != pixels {
            *plane = vec![F::default(); pixels];
        }
    }
    if flags.len() != pixels {
        *flags = vec![0; pixels];
    }
}

/// All channels of a map, and its flags.
pub(super) fn whole<F>(map: &mut impl Answers<F>) -> (Channels<'_, F>, &mut [u32]) {
    let (planes, flags) = map.planes_mut();
    (planes.map(|plane| plane.map_or(&mut [][..], Vec::as_mut_slice)), flags)
}

/// The first `n` pixels of what is left of all channels.
#[inline(always)]
pub(super) fn cut_channels<'a, F>(left: &mut Channels<'a, F>, n: usize) -> Channels<'a, F> {
    left.each_mut().map(|left| left.split_off_mut(..n.min(left.len())).expect("no longer than it is"))
}

/// Takes everything but the gain from pixel `i`, which is not looked at, and the flags of its line.
pub(super) fn silence<F: Copy>(channels: &mut Channels<'_, F>, flags: &mut u32, i: usize, nan: F) {
    channels[..GAIN].iter_mut().filter_map(|channel| channel.get_mut(i)).for_each(|value| *value = nan);
    *flags &= flag::NO_PLATE
        | flag::DEAD
        | flag::CONSTANT
        | flag::SATURATED
        | flag::OUTLIERS
        | flag::TOO_FEW_LEVELS;
}
