//! Several pixels at once: f64 or f32 numbers side by side, with the operations that a fit needs.
//!
//! No fused operations, and every choice by comparison: any width of vectors gives the bits of one pixel alone.

use pulp::Simd;
use std::ops::{Add, Deref, DerefMut, Div, Mul, Range, Sub};

/// Numbers of the widest vector (f32, AVX-512): rows in memory are padded to a multiple of it.
pub(super) const WIDEST: usize = 16;

/// Bytes of a line of the cache, which a vector should not straddle.
const LINE: usize = 64;

/// Vectors of x86 have a greatest and a least number of two that are these choices to the bit: the second where one is
/// NaN, or both are zero. Other machines' have rules of their own.
const NATIVE_EXTREMES: bool = cfg!(target_arch = "x86_64");

/// Numbers that begin with a line of the cache.
#[derive(Debug)]
pub(super) struct Aligned<T> {
    memory: Vec<T>,
    within: Range<usize>,
}

impl<T: Copy> Aligned<T> {
    /// `value`, `n` times.
    pub(super) fn new(value: T, n: usize) -> Self {
        let memory = vec![value; n + LINE / size_of::<T>()];
        let start = memory.as_ptr().align_offset(LINE).min(memory.len() - n);
        Self { memory, within: start..start + n }
    }
}

impl<T> Deref for Aligned<T> {
    type Target = [T];
    #[inline(always)]
    fn deref(&self) -> &[T] {
        &self.memory[self.within.clone()]
    }
}

impl<T> DerefMut for Aligned<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.memory[self.within.clone()]
    }
}

/// A vector of numbers.
pub(super) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Truth per number.
    type Mask: Copy;

    /// The same number everywhere.
    fn all(self, value: f64) -> Self;
    /// self < other; false for NaN.
    fn below(self, other: Self) -> Self::Mask;
    /// self ≤ other; false for NaN.
    fn at_most(self, other: Self) -> Self::Mask;
    /// Both.
    fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Either.
    fn either(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// The first without the second.
    fn without(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Where `mask`, `yes`, else `no`.
    fn pick(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Square root.
    fn root(self) -> Self;
    /// The larger; `other` if one is NaN, or both are zero.
    fn larger(self, other: Self) -> Self;
    /// The smaller, in the same way.
    fn smaller(self, other: Self) -> Self;

    /// Absolute value; ±0 and NaN stay what they are.
    #[inline(always)]
    fn size(self) -> Self {
        self.larger(self.all(0.0) - self)
    }

    /// Neither NaN nor infinite.
    #[expect(clippy::eq_op, reason = "what is not finite less itself is NaN")]
    #[inline(always)]
    fn finite(self) -> Self::Mask {
        (self - self).at_most(self.all(0.0))
    }

    /// `bit` where `mask`, else 0.
    #[inline(always)]
    fn bit(self, mask: Self::Mask, bit: u32) -> Self {
        Self::pick(mask, self.all(f64::from(bit)), self.all(0.0))
    }
}

/// One of the four operators of a vector.
macro_rules! operator {
    ($vector:ident, $trait:ident, $method:ident, $by:ident) => {
        impl<S: Simd> $trait for $vector<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(self.0, self.0.$by(self.1, other.1))
            }
        }
    };
}

macro_rules! lanes {
    ($name:ident, $vector:ident, $mask:ident, $splat:ident, $add:ident, $sub:ident, $mul:ident, $div:ident,
     $below:ident, $at_most:ident, $and:ident, $or:ident, $not:ident, $select:ident, $sqrt:ident, $max:ident, $min:ident, $lanes:ident, $as:ty) => {
        /// A vector of this machine, on a line of the cache.
        #[derive(Clone, Copy)]
        #[repr(align(64))]
        pub(super) struct $name<S: Simd>(pub(super) S, pub(super) S::$vector);

        operator!($name, Add, add, $add);
        operator!($name, Sub, sub, $sub);
        operator!($name, Mul, mul, $mul);
        operator!($name, Div, div, $div);

        impl<S: Simd> Lanes for $name<S> {
            type Mask = MaskOf<S, S::$mask>;

            #[inline(always)]
            fn all(self, value: f64) -> Self {
                #[allow(clippy::cast_possible_truncation, reason = "rounding to f32 is meant there")]
                let value = value as $as;
                Self(self.0, self.0.$splat(value))
            }

            #[inline(always)]
            fn below(self, other: Self) -> Self::Mask {
                MaskOf(self.0, self.0.$below(self.1, other.1))
            }

            #[inline(always)]
            fn at_most(self, other: Self) -> Self::Mask {
                MaskOf(self.0, self.0.$at_most(self.1, other.1))
            }

            #[inline(always)]
            fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                MaskOf(self.0, self.0.$and(a.1, b.1))
            }

            #[inline(always)]
            fn either(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                MaskOf(self.0, self.0.$or(a.1, b.1))
            }

            #[inline(always)]
            fn without(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                MaskOf(self.0, self.0.$and(a.1, self.0.$not(b.1)))
            }

            #[inline(always)]
            fn pick(mask: Self::Mask, yes: Self, no: Self) -> Self {
                Self(yes.0, yes.0.$select(mask.1, yes.1, no.1))
            }

            #[inline(always)]
            fn root(self) -> Self {
                Self(self.0, self.0.$sqrt(self.1))
            }

            #[inline(always)]
            fn larger(self, other: Self) -> Self {
                if NATIVE_EXTREMES && S::$lanes > 1 {
                    Self(self.0, self.0.$max(self.1, other.1))
                } else {
                    Self::pick(other.below(self), self, other)
                }
            }

            #[inline(always)]
            fn smaller(self, other: Self) -> Self {
                if NATIVE_EXTREMES && S::$lanes > 1 {
                    Self(self.0, self.0.$min(self.1, other.1))
                } else {
                    Self::pick(self.below(other), self, other)
                }
            }
        }
    };
}

/// A mask with the machine that it belongs to.
#[derive(Clone, Copy)]
pub(super) struct MaskOf<S: Simd, M: Copy>(S, M);

lanes!(
    Doubles,
    f64s,
    m64s,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    div_f64s,
    less_than_f64s,
    less_than_or_equal_f64s,
    and_m64s,
    or_m64s,
    not_m64s,
    select_f64s,
    sqrt_f64s,
    max_f64s,
    min_f64s,
    F64_LANES,
    f64
);
lanes!(
    Singles,
    f32s,
    m32s,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    div_f32s,
    less_than_f32s,
    less_than_or_equal_f32s,
    and_m32s,
    or_m32s,
    not_m32s,
    select_f32s,
    sqrt_f32s,
    max_f32s,
    min_f32s,
    F32_LANES,
    f32
);

/// A kind of number: f64 for what is kept, f32 for what is looked at.
pub(super) trait Number:
    Copy
    + Default
    + Send
    + Sync
    + PartialOrd
    + std::fmt::Debug
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
{
    /// Not a number.
    const NAN: Self;
    /// Least number that is not subnormal.
    const LEAST: Self;
    /// Coefficients of (ln((1 + s)/(1 − s))/s − 2)/s² over powers of s², for |s| ≤ 0.2.
    const LOGARITHM: &'static [f64];
    /// Rounded from f64.
    fn of(value: f64) -> Self;
    /// As f64, exactly.
    fn wide(self) -> f64;
    /// k and 2ᵏ·`small`, where 2ᵏ is about self over `small`: 2ᵏ·`small` is between 2/3 and 3/2 of self. Both are
    /// normal, and 0 < `small` ≤ self.
    fn lift(self, small: Self) -> (Self, Self);
    /// Whether it is a number and not infinite.
    fn is_number(self) -> bool;

    /// Bits from a sum of bits below 2²³: exact.
    fn bits_of(self) -> u32;
}

impl Number for f64 {
    const NAN: Self = Self::NAN;
    const LEAST: Self = Self::MIN_POSITIVE;
    // Error below 6e-17 of the logarithm: interpolation at seven Chebyshev nodes of s² in 0 … 0.0402.
    const LOGARITHM: &'static [f64] = &[
        0.666_666_666_666_669_4,
        0.399_999_999_993_253_36,
        0.285_714_288_394_464_1,
        0.222_221_823_694_774_1,
        0.181_846_320_054_238_31,
        0.152_831_733_202_977_27,
        0.151_232_952_086_141_01,
    ];

    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }

    // Bits as an integer are nearly the logarithm, at most 0.0861 below it: that of the quotient is off by as much. The
    // exponent becomes a number as the low bits of 2⁵² + k: no conversion instruction is needed.
    #[inline(always)]
    fn lift(self, small: Self) -> (Self, Self) {
        let bits = small.to_bits();
        let k = self.to_bits().wrapping_sub(bits).wrapping_add(1 << 51) >> 52;
        let exponent = Self::from_bits(k | 0x4330_0000_0000_0000) - 4_503_599_627_370_496.0;
        (exponent, Self::from_bits(bits.wrapping_add(k << 52)))
    }

    #[inline(always)]
    fn is_number(self) -> bool {
        self.abs() < Self::INFINITY
    }

    // The low bits of 2⁵² + n are n.
    #[expect(clippy::cast_possible_truncation, reason = "the low bits are meant")]
    #[inline(always)]
    fn bits_of(self) -> u32 {
        (self + 4_503_599_627_370_496.0).to_bits() as u32
    }
}

impl Number for f32 {
    const NAN: Self = Self::NAN;
    const LEAST: Self = Self::MIN_POSITIVE;
    // Error below 1e-8 of the logarithm: three nodes.
    const LOGARITHM: &'static [f64] =
        &[0.666_667_140_952_049_8, 0.399_788_022_128_124_75, 0.299_627_898_341_315_7];

    #[expect(clippy::cast_possible_truncation, reason = "rounding is what is meant")]
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as Self
    }

    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }

    #[inline(always)]
    fn lift(self, small: Self) -> (Self, Self) {
        let bits = small.to_bits();
        let k = self.to_bits().wrapping_sub(bits).wrapping_add(1 << 22) >> 23;
        let exponent = Self::from_bits(k | 0x4B00_0000) - 8_388_608.0;
        (exponent, Self::from_bits(bits.wrapping_add(k << 23)))
    }

    #[inline(always)]
    fn is_number(self) -> bool {
        self.abs() < Self::INFINITY
    }

    #[inline(always)]
    fn bits_of(self) -> u32 {
        (self + 8_388_608.0).to_bits() & 0x007F_FFFF
    }
}

/// Reads and writes vectors of a kind of number.
pub(super) trait Machine: Number {
    /// A vector of the machine `S`.
    type Lanes<S: Simd>: Lanes;
    /// How many numbers it has.
    fn width<S: Simd>() -> usize;
    fn read<S: Simd>(simd: S, numbers: &[Self], vector: usize) -> Self::Lanes<S>;
    /// Fills `numbers`, as many as there are in `value`.
    fn write<S: Simd>(numbers: &mut [Self], value: Self::Lanes<S>);
}

macro_rules! machine {
    ($number:ty, $lanes:ident, $width:ident, $as:ident, $as_mut:ident, $and:ident) => {
        impl Machine for $number {
            type Lanes<S: Simd> = $lanes<S>;

            #[inline(always)]
            fn width<S: Simd>() -> usize {
                S::$width
            }

            #[inline(always)]
            fn read<S: Simd>(simd: S, numbers: &[Self], vector: usize) -> $lanes<S> {
                // With themselves: the numbers come as a vector then, else they would be copied by way of the stack.
                let vector = S::$as(numbers).0[vector];
                $lanes(simd, simd.$and(vector, vector))
            }

            #[inline(always)]
            fn write<S: Simd>(numbers: &mut [Self], value: $lanes<S>) {
                let ([first], _) = S::$as_mut(numbers) else { panic!("room for a vector") };
                *first = value.1;
            }
        }
    };
}

machine!(f64, Doubles, F64_LANES, as_simd_f64s, as_mut_simd_f64s, and_f64s);
machine!(f32, Singles, F32_LANES, as_simd_f32s, as_mut_simd_f32s, and_f32s);
