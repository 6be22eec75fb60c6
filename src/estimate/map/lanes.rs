//! Several pixels at once: f64 or f32 numbers side by side, with the operations that a fit needs.
//!
//! No fused operations, and every choice by comparison: any width of vectors gives the bits of one pixel alone.

use pulp::Simd;
use std::ops::{Add, Div, Mul, Sub};

/// Numbers of the widest vector (f32, AVX-512): rows in memory are padded to a multiple of it.
pub(super) const WIDEST: usize = 16;

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
    /// Where `mask`, `yes`, else `no`.
    fn pick(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Square root.
    fn root(self) -> Self;
    /// Absolute value; ±0 and NaN stay what they are.
    #[inline(always)]
    fn size(self) -> Self {
        self.larger(self.all(0.0) - self)
    }

    /// The larger; `other` if one is NaN.
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        Self::pick(other.below(self), self, other)
    }

    /// The smaller; `other` if one is NaN.
    #[inline(always)]
    fn smaller(self, other: Self) -> Self {
        Self::pick(self.below(other), self, other)
    }

    /// Neither NaN nor infinite.
    #[inline(always)]
    fn finite(self) -> Self::Mask {
        self.size().below(self.all(f64::INFINITY))
    }

    /// `bit` where `mask`, else 0.
    #[inline(always)]
    fn bit(self, mask: Self::Mask, bit: u32) -> Self {
        Self::pick(mask, self.all(f64::from(bit)), self.all(0.0))
    }
}

macro_rules! lanes {
    ($name:ident, $vector:ident, $mask:ident, $splat:ident, $add:ident, $sub:ident, $mul:ident, $div:ident,
     $below:ident, $at_most:ident, $and:ident, $or:ident, $select:ident, $sqrt:ident, $as:ty) => {
        /// A vector of this machine.
        #[derive(Clone, Copy)]
        pub(super) struct $name<S: Simd>(pub(super) S, pub(super) S::$vector);

        impl<S: Simd> Add for $name<S> {
            type Output = Self;
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                Self(self.0, self.0.$add(self.1, other.1))
            }
        }

        impl<S: Simd> Sub for $name<S> {
            type Output = Self;
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                Self(self.0, self.0.$sub(self.1, other.1))
            }
        }

        impl<S: Simd> Mul for $name<S> {
            type Output = Self;
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                Self(self.0, self.0.$mul(self.1, other.1))
            }
        }

        impl<S: Simd> Div for $name<S> {
            type Output = Self;
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                Self(self.0, self.0.$div(self.1, other.1))
            }
        }

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
            fn pick(mask: Self::Mask, yes: Self, no: Self) -> Self {
                Self(yes.0, yes.0.$select(mask.1, yes.1, no.1))
            }

            #[inline(always)]
            fn root(self) -> Self {
                Self(self.0, self.0.$sqrt(self.1))
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
    select_f64s,
    sqrt_f64s,
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
    select_f32s,
    sqrt_f32s,
    f32
);

/// A kind of number: f64 for what is kept, f32 for what is looked at.
pub trait Number:
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
    /// ln 2 in two parts: any exponent times the first is exact.
    const LN2_HIGH: f64;
    /// The rest.
    const LN2_LOW: f64;
    /// Rounded from f64.
    fn of(value: f64) -> Self;
    /// As f64, exactly.
    fn wide(self) -> f64;
    /// k and m of self = 2ᵏ·m with m in √½ … √2, for normal numbers > 0.
    fn split(self) -> (Self, Self);
    /// Whether it is a number and not infinite.
    fn is_number(self) -> bool;
    /// Square root.
    fn square_root(self) -> Self;
}

impl Number for f64 {
    const NAN: Self = Self::NAN;
    const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;

    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }

    // The exponent becomes a number as the low bits of 2⁵² + e: no conversion instruction is needed.
    #[inline(always)]
    fn split(self) -> (Self, Self) {
        const HALF_ROOT: u64 = 0x3FE6_A09E_667F_3BCD;
        let bits = self.to_bits().wrapping_add(0x3FF0_0000_0000_0000 - HALF_ROOT);
        let exponent = Self::from_bits((bits >> 52) | 0x4330_0000_0000_0000) - 4_503_599_627_371_519.0;
        (exponent, Self::from_bits((bits & 0x000F_FFFF_FFFF_FFFF).wrapping_add(HALF_ROOT)))
    }

    #[inline(always)]
    fn is_number(self) -> bool {
        self.abs() < Self::INFINITY
    }

    #[inline(always)]
    fn square_root(self) -> Self {
        self.sqrt()
    }
}

impl Number for f32 {
    const NAN: Self = Self::NAN;
    // 355/512 and the rest.
    const LN2_HIGH: f64 = 0.693_359_375;
    const LN2_LOW: f64 = -2.121_944_400_546_905_8e-4;

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
    fn split(self) -> (Self, Self) {
        const HALF_ROOT: u32 = 0x3F35_04F3;
        let bits = self.to_bits().wrapping_add(0x3F80_0000 - HALF_ROOT);
        let exponent = Self::from_bits((bits >> 23) | 0x4B00_0000) - 8_388_735.0;
        (exponent, Self::from_bits((bits & 0x007F_FFFF).wrapping_add(HALF_ROOT)))
    }

    #[inline(always)]
    fn is_number(self) -> bool {
        self.abs() < Self::INFINITY
    }

    #[inline(always)]
    fn square_root(self) -> Self {
        self.sqrt()
    }
}

/// Reads and writes vectors of a kind of number.
pub(super) trait Machine<S: Simd>: Number {
    type Lanes: Lanes;
    /// How many numbers a vector has.
    const WIDTH: usize;
    fn read(simd: S, numbers: &[Self], vector: usize) -> Self::Lanes;
    fn write(numbers: &mut [Self], vector: usize, value: Self::Lanes);
}

impl<S: Simd> Machine<S> for f64 {
    type Lanes = Doubles<S>;
    const WIDTH: usize = S::F64_LANES;

    #[inline(always)]
    fn read(simd: S, numbers: &[Self], vector: usize) -> Self::Lanes {
        Doubles(simd, S::as_simd_f64s(numbers).0[vector])
    }

    #[inline(always)]
    fn write(numbers: &mut [Self], vector: usize, value: Self::Lanes) {
        S::as_mut_simd_f64s(numbers).0[vector] = value.1;
    }
}

impl<S: Simd> Machine<S> for f32 {
    type Lanes = Singles<S>;
    const WIDTH: usize = S::F32_LANES;

    #[inline(always)]
    fn read(simd: S, numbers: &[Self], vector: usize) -> Self::Lanes {
        Singles(simd, S::as_simd_f32s(numbers).0[vector])
    }

    #[inline(always)]
    fn write(numbers: &mut [Self], vector: usize, value: Self::Lanes) {
        S::as_mut_simd_f32s(numbers).0[vector] = value.1;
    }
}
