//! The sums of one level in memory: 14 bytes a pixel while they fit, then 18, then 28.
//!
//! How wide the numbers are shows nowhere else: they are read as the widest.

use std::ops::AddAssign;

/// In place of the sum of before.
pub(super) const PUT: i32 = 0;
/// Added to it.
pub(super) const ADD: i32 = 1;
/// Subtracted from it.
pub(super) const REMOVE: i32 = -1;

/// Widths of the sums of a pixel.
///
/// Operations wrap, because checked ones stop the vectoriser; `Sums::cycles_max` and [`Cells::cycles_max`] are the proof
/// that none does.
pub(in crate::estimate) trait Width {
    /// ΣY.
    type Sum: Copy + Default + Send + AddAssign + Into<i64>;
    /// ΣY².
    type Squares: Copy + Default + Send + AddAssign + Into<u64>;
    /// Σ blanks.
    type Blanks: Copy + Default + Send + AddAssign + Into<u64>;
    /// Cycles that count.
    type Count: Copy + Default + Send + AddAssign + PartialEq + Into<u32>;
    /// Puts, adds or subtracts, by `HOW`.
    fn sum<const HOW: i32>(before: Self::Sum, more: i32) -> Self::Sum;
    /// The same; `more` fits.
    fn squares<const HOW: i32>(before: Self::Squares, more: u64) -> Self::Squares;
    /// The same.
    fn blanks<const HOW: i32>(before: Self::Blanks, more: u32) -> Self::Blanks;
    /// The same.
    fn count<const HOW: i32>(before: Self::Count, more: u16) -> Self::Count;
}

/// 14 bytes a pixel.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Short;

/// 18 bytes a pixel.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Narrow;

/// 28 bytes a pixel.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Wide;

macro_rules! put {
    ($how:ident, $before:ident, $more:expr) => {
        match $how {
            PUT => $more,
            ADD => $before.wrapping_add($more),
            _ => $before.wrapping_sub($more),
        }
    };
}

macro_rules! width {
    ($width:ident, $sum:ty, $squares:ty, $blanks:ty, $count:ty) => {
        impl Width for $width {
            type Sum = $sum;
            type Squares = $squares;
            type Blanks = $blanks;
            type Count = $count;

            #[inline(always)]
            fn sum<const HOW: i32>(before: $sum, more: i32) -> $sum {
                put!(HOW, before, <$sum>::from(more))
            }

            #[allow(clippy::cast_possible_truncation, reason = "what is added fits, by the number of cycles")]
            #[inline(always)]
            fn squares<const HOW: i32>(before: $squares, more: u64) -> $squares {
                put!(HOW, before, more as $squares)
            }

            #[inline(always)]
            fn blanks<const HOW: i32>(before: $blanks, more: u32) -> $blanks {
                put!(HOW, before, <$blanks>::from(more))
            }

            #[inline(always)]
            fn count<const HOW: i32>(before: $count, more: u16) -> $count {
                put!(HOW, before, <$count>::from(more))
            }
        }
    };
}

width!(Short, i32, u32, u32, u16);
width!(Narrow, i32, u64, u32, u16);
width!(Wide, i64, u64, u64, u32);

/// Sums of all pixels, each `[rows · columns]` in row order.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Planes<W: Width> {
    /// ΣY.
    pub(in crate::estimate) sum: Vec<W::Sum>,
    /// ΣY².
    pub(in crate::estimate) squares: Vec<W::Squares>,
    /// Σ blanks.
    pub(in crate::estimate) blanks: Vec<W::Blanks>,
    /// Cycles that count.
    pub(in crate::estimate) count: Vec<W::Count>,
}

impl<W: Width> Planes<W> {
    fn new(pixels: usize) -> Self {
        Self {
            sum: vec![W::Sum::default(); pixels],
            squares: vec![W::Squares::default(); pixels],
            blanks: vec![W::Blanks::default(); pixels],
            count: vec![W::Count::default(); pixels],
        }
    }
}

/// Sums of all pixels in one of the widths.
#[derive(Debug, Clone)]
pub(in crate::estimate) enum Cells {
    /// See [`Short`].
    Short(Planes<Short>),
    /// See [`Narrow`].
    Narrow(Planes<Narrow>),
    /// See [`Wide`].
    Wide(Planes<Wide>),
}

/// The sums of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Cell {
    pub(super) sum: i64,
    pub(super) squares: u64,
    pub(super) blanks: u64,
    pub(super) count: u32,
}

/// Samples of a cycle: so many blanks, all that count below a saturation count.
#[derive(Debug, Clone, Copy)]
pub(super) struct Samples {
    pub(super) blanks: u16,
    pub(super) saturation: u16,
}

impl Samples {
    /// Largest |Y| that can count.
    fn largest(self) -> u64 {
        u64::from(self.blanks) * u64::from(self.saturation.saturating_sub(1))
    }

    /// Most cycles whose ΣY² fits 32 bit (16 of 14 bit and one blank), and everything else as below.
    pub(super) fn short_max(self) -> u32 {
        let squares = u64::from(u32::MAX).checked_div(self.largest().pow(2));
        squares.and_then(|cycles| u32::try_from(cycles).ok()).unwrap_or(u32::MAX).min(self.narrow_max())
    }

    /// Most cycles for which |ΣY| and Σ blanks are below 2³¹, and that count in 16 bit.
    pub(super) fn narrow_max(self) -> u32 {
        let largest = u32::from(self.blanks) * u32::from(u16::MAX);
        (i32::MAX.unsigned_abs() / largest).min(u32::from(u16::MAX))
    }
}

impl Cells {
    /// Empty sums as narrow as a cycle allows.
    pub(super) fn new(pixels: usize, samples: Samples) -> Self {
        if samples.short_max() > 0 {
            Self::Short(Planes::new(pixels))
        } else {
            Self::Narrow(Planes::new(pixels))
        }
    }

    /// Most cycles that these widths hold.
    pub(super) fn cycles_max(&self, samples: Samples) -> u32 {
        match self {
            Self::Short(_) => samples.short_max(),
            Self::Narrow(_) => samples.narrow_max(),
            Self::Wide(_) => u32::MAX,
        }
    }

    pub(super) fn at(&self, pixel: usize) -> Cell {
        match self {
            Self::Short(planes) => planes.at(pixel),
            Self::Narrow(planes) => planes.at(pixel),
            Self::Wide(planes) => planes.at(pixel),
        }
    }

    /// Makes the numbers wider, if that is possible.
    pub(super) fn widen(&mut self) {
        match self {
            Self::Short(short) => {
                *self = Self::Narrow(Planes {
                    sum: std::mem::take(&mut short.sum),
                    squares: short.squares.iter().map(|&squares| squares.into()).collect(),
                    blanks: std::mem::take(&mut short.blanks),
                    count: std::mem::take(&mut short.count),
                });
            }
            Self::Narrow(narrow) => {
                *self = Self::Wide(Planes {
                    sum: narrow.sum.iter().map(|&sum| sum.into()).collect(),
                    squares: std::mem::take(&mut narrow.squares),
                    blanks: narrow.blanks.iter().map(|&blanks| blanks.into()).collect(),
                    count: narrow.count.iter().map(|&count| count.into()).collect(),
                });
            }
            Self::Wide(_) => {}
        }
    }

    /// Changes one pixel by one cycle's Y and sum of blanks.
    pub(super) fn remove(&mut self, pixel: usize, y: i32, lit: u32) {
        match self {
            Self::Short(planes) => planes.remove(pixel, y, lit),
            Self::Narrow(planes) => planes.remove(pixel, y, lit),
            Self::Wide(planes) => planes.remove(pixel, y, lit),
        }
    }

    /// Adds the sums of others, pixel by pixel. The caller has made room for them.
    pub(super) fn merge(&mut self, other: &Self) {
        match (&mut *self, other) {
            (Self::Short(to), Self::Short(from)) => to.merge(from),
            (Self::Narrow(to), Self::Narrow(from)) => to.merge(from),
            (Self::Wide(to), Self::Wide(from)) => to.merge(from),
            (Self::Short(_), _) | (Self::Narrow(_), Self::Wide(_)) => {
                self.widen();
                self.merge(other);
            }
            (_, Self::Short(_) | Self::Narrow(_)) => {
                let mut other = other.clone();
                other.widen();
                self.merge(&other);
            }
        }
    }
}

impl<W: Width> Planes<W> {
    fn at(&self, pixel: usize) -> Cell {
        Cell {
            sum: self.sum[pixel].into(),
            squares: self.squares[pixel].into(),
            blanks: self.blanks[pixel].into(),
            count: self.count[pixel].into(),
        }
    }

    fn remove(&mut self, pixel: usize, y: i32, lit: u32) {
        let size = u64::from(y.unsigned_abs());
        self.sum[pixel] = W::sum::<REMOVE>(self.sum[pixel], y);
        self.squares[pixel] = W::squares::<REMOVE>(self.squares[pixel], size * size);
        self.blanks[pixel] = W::blanks::<REMOVE>(self.blanks[pixel], lit);
        self.count[pixel] = W::count::<REMOVE>(self.count[pixel], 1);
    }

    fn merge(&mut self, other: &Self) {
        self.sum.iter_mut().zip(&other.sum).for_each(|(a, b)| *a += *b);
        self.squares.iter_mut().zip(&other.squares).for_each(|(a, b)| *a += *b);
        self.blanks.iter_mut().zip(&other.blanks).for_each(|(a, b)| *a += *b);
        self.count.iter_mut().zip(&other.count).for_each(|(a, b)| *a += *b);
    }
}
