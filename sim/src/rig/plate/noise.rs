//! The noise of the display: normal numbers by their count, so that they do not depend on how often it is looked at.

use std::f64::consts::TAU;

/// A standard normal number keyed by (seed, count): Box and Muller over two SplitMix64 outputs.
pub(super) fn gaussian(seed: u64, count: u64) -> f64 {
    let key = mixed(seed ^ mixed(count));
    let radius = libm::sqrt(-2.0 * libm::log(1.0 - unit(key)));
    radius * libm::cos(TAU * unit(mixed(key)))
}

/// SplitMix64's output function (Steele, Lea and Flood 2014) after its increment.
fn mixed(key: u64) -> u64 {
    let mut z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The upper 53 bits as a number in [0, 1).
#[expect(clippy::cast_precision_loss, reason = "53 bits fit exactly")]
fn unit(key: u64) -> f64 {
    (key >> 11) as f64 / (1_u64 << 53) as f64
}
