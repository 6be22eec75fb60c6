//! How far the recurrences of a sphere go.
//!
//! Length of the series after Wiscombe, Appl. Opt. 19, 1505 (1980), longer here: his N costs 1e-9 in Q_ext of
//! absorbing spheres.

use super::Sphere;

/// Below this size the leading terms are scaled from here: their corrections are of the order (|m| x)², below 1e-30.
pub(super) const SIZE_MIN: f64 = 1e-20;
/// What a sphere of a batch is, and how far its recurrences go.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lane {
    pub(super) sphere: Sphere,
    /// Last order, 0 when there is no sphere (x = 0).
    pub(super) last: f64,
    /// Order at which the downward recurrence starts.
    pub(super) start: f64,
}

impl Lane {
    #[inline(always)]
    pub(super) fn new(sphere: Sphere) -> Self {
        let x = sphere.size_parameter.max(SIZE_MIN);
        let last = series_length(x);
        let square = sphere.n * sphere.n + sphere.k * sphere.k;
        let z = x * square.sqrt().max(1.0);
        // Past |z| until the start is forgotten, and a little past the last order: for small spheres the recurrence
        // forgets three digits a step there, and the last terms need few.
        let start = (z + 7.3 * cube_root(z) + 6.0).max(last + 4.0).floor();
        Self { sphere, last: if sphere.size_parameter > 0.0 { last } else { 0.0 }, start }
    }
}

/// Length of the series: terms beyond it are below the rounding of the sum.
pub(super) fn series_length(size_parameter: f64) -> f64 {
    (size_parameter + 6.9 * cube_root(size_parameter) + 3.0).floor()
}

/// The cube root to 0.2 %, never less than 0.999 of it: an exponent divided by three and one step of Newton's. Lengths of
/// series need no more.
#[inline(always)]
pub(super) fn cube_root(x: f64) -> f64 {
    // Kahan's first guess, within 5 % (BSD's s_cbrt.c): a third of the bits and two thirds of the bias.
    let guess = f64::from_bits(x.to_bits() / 3 + (715_094_163 << 32));
    (2.0 * guess + x / (guess * guess)) * (1.0 / 3.0)
}

/// A number of orders: whole, and at most a few times [`super::SIZE_MAX`].
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "bounded by SIZE_MAX, not negative"
)]
pub(super) fn integer(count: f64) -> usize {
    count.clamp(0.0, 4.0 * super::SIZE_MAX) as usize
}
