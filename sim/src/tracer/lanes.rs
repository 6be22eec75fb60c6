//! Many numbers side by side, as the compiler makes vectors of them.

/// Rays of a packet: two of the widest vectors, so that one has work while the other waits for memory (a sixth less time
/// than one; four gain sights as much again, and cost paths what two gain them).
pub(super) const LANES: usize = 32;

#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Floats(pub(super) [f32; LANES]);

#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Ints(pub(super) [i32; LANES]);

pub(super) const ZEROS: Floats = Floats([0.0; LANES]);
pub(super) const NO_INTS: Ints = Ints([0; LANES]);

/// The whole number below a number from 0 to 2²¹, or, of a whole number, perhaps the one before it: a conversion that
/// need not look for overflow.
#[inline(always)]
#[expect(clippy::cast_possible_wrap, reason = "the bits of a positive number")]
pub(super) fn whole(x: f32) -> i32 {
    // Adding 1.5·2²³ rounds to a whole number, which then stands in the low bits.
    (larger(x, 0.0) - 0.5 + 12_582_912.0).to_bits() as i32 - 0x4b40_0000
}

/// As [`larger`].
#[inline(always)]
pub(super) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// One instruction, unlike [`f32::max`], which looks for NaN.
#[inline(always)]
pub(super) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
