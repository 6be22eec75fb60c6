//! Room for something of every level: arrays where the compiler knows their number, so that a fit of few levels
//! stays in registers and its loops are spelled out, else memory.

/// How many levels a fit has.
pub(super) trait Levels {
    /// One `T` per level.
    type Each<T: Copy>: AsRef<[T]> + AsMut<[T]>;

    /// `value` for each of `levels` levels.
    fn each<T: Copy>(value: T, levels: usize) -> Self::Each<T>;

    /// The number of levels, a constant if it is known.
    fn number(levels: usize) -> usize;
}

/// `K` levels.
pub(super) struct Known<const K: usize>;

/// Any number of levels.
pub(super) struct Any;

impl<const K: usize> Levels for Known<K> {
    type Each<T: Copy> = [T; K];

    #[inline(always)]
    fn each<T: Copy>(value: T, _: usize) -> [T; K] {
        [value; K]
    }

    #[inline(always)]
    fn number(_: usize) -> usize {
        K
    }
}

impl Levels for Any {
    type Each<T: Copy> = Vec<T>;

    #[inline(always)]
    fn each<T: Copy>(value: T, levels: usize) -> Vec<T> {
        vec![value; levels]
    }

    #[inline(always)]
    fn number(levels: usize) -> usize {
        levels
    }
}
