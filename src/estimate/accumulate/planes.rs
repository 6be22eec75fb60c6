//! The sums of one level in memory: 18 bytes a pixel while they fit, 28 after.
//!
//! How wide the numbers are shows nowhere else: they are read as the widest.

/// In place of the sum of before.
pub(super) const PUT: i32 = 0;
/// Added to it.
pub(super) const ADD: i32 = 1;
/// Subtracted from it.
pub(super) const REMOVE: i32 = -1;

/// Widths of the sums of a pixel. ΣY² takes 64 bit in any case.
///
/// Operations wrap, because checked ones stop the vectoriser; `Sums::cycles_max` and [`narrow_max`] are the proof that
/// none does.
pub(in crate::estimate) trait Width {
    /// ΣY.
    type Sum: Copy + Default + Send + Into<i64>;
    /// Σ blanks.
    type Blanks: Copy + Default + Send + Into<u64>;
    /// Cycles that count.
    type Count: Copy + Default + Send + PartialEq + Into<u32>;
    /// Puts, adds or subtracts, by `HOW`.
    fn sum<const HOW: i32>(before: Self::Sum, more: i32) -> Self::Sum;
    /// The same.
    fn blanks<const HOW: i32>(before: Self::Blanks, more: u32) -> Self::Blanks;
    /// The same.
    fn count<const HOW: i32>(before: Self::Count, more: u16) -> Self::Count;
}

/// 18 bytes a pixel.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Narrow;

/// 28 bytes a pixel.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Wide;

/// Most cycles of so many blanks whose sums are narrow: |ΣY| and Σ blanks below 2³¹, and no more than count in 16 bit.
pub(super) fn narrow_max(blanks_per_cycle: u16) -> u32 {
    let largest = u32::from(blanks_per_cycle) * u32::from(u16::MAX);
    (i32::MAX.unsigned_abs() / largest).min(u32::from(u16::MAX))
}

impl Width for Narrow {
    type Sum = i32;
    type Blanks = u32;
    type Count = u16;

    #[inline(always)]
    fn sum<const HOW: i32>(before: i32, more: i32) -> i32 {
        match HOW {
            PUT => more,
            ADD => before.wrapping_add(more),
            _ => before.wrapping_sub(more),
        }
    }

    #[inline(always)]
    fn blanks<const HOW: i32>(before: u32, more: u32) -> u32 {
        match HOW {
            PUT => more,
            ADD => before.wrapping_add(more),
            _ => before.wrapping_sub(more),
        }
    }

    #[inline(always)]
    fn count<const HOW: i32>(before: u16, more: u16) -> u16 {
        match HOW {
            PUT => more,
            ADD => before.wrapping_add(more),
            _ => before.wrapping_sub(more),
        }
    }
}

impl Width for Wide {
    type Sum = i64;
    type Blanks = u64;
    type Count = u32;

    #[inline(always)]
    fn sum<const HOW: i32>(before: i64, more: i32) -> i64 {
        match HOW {
            PUT => i64::from(more),
            ADD => before.wrapping_add(i64::from(more)),
            _ => before.wrapping_sub(i64::from(more)),
        }
    }

    #[inline(always)]
    fn blanks<const HOW: i32>(before: u64, more: u32) -> u64 {
        match HOW {
            PUT => u64::from(more),
            ADD => before.wrapping_add(u64::from(more)),
            _ => before.wrapping_sub(u64::from(more)),
        }
    }

    #[inline(always)]
    fn count<const HOW: i32>(before: u32, more: u16) -> u32 {
        match HOW {
            PUT => u32::from(more),
            ADD => before.wrapping_add(u32::from(more)),
            _ => before.wrapping_sub(u32::from(more)),
        }
    }
}

/// Sums of all pixels, each `[rows · columns]` in row order.
#[derive(Debug, Clone)]
pub(in crate::estimate) struct Planes<W: Width> {
    /// ΣY.
    pub(in crate::estimate) sum: Vec<W::Sum>,
    /// ΣY².
    pub(in crate::estimate) squares: Vec<u64>,
    /// Σ blanks.
    pub(in crate::estimate) blanks: Vec<W::Blanks>,
    /// Cycles that count.
    pub(in crate::estimate) count: Vec<W::Count>,
}

impl<W: Width> Planes<W> {
    fn new(pixels: usize) -> Self {
        Self {
            sum: vec![W::Sum::default(); pixels],
            squares: vec![0; pixels],
            blanks: vec![W::Blanks::default(); pixels],
            count: vec![W::Count::default(); pixels],
        }
    }
}

/// Sums of all pixels in one of the widths.
#[derive(Debug, Clone)]
pub(in crate::estimate) enum Cells {
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

impl Cells {
    pub(super) fn new(pixels: usize) -> Self {
        Self::Narrow(Planes::new(pixels))
    }

    pub(super) fn at(&self, pixel: usize) -> Cell {
        match self {
            Self::Narrow(planes) => Cell {
                sum: planes.sum[pixel].into(),
                squares: planes.squares[pixel],
                blanks: planes.blanks[pixel].into(),
                count: planes.count[pixel].into(),
            },
            Self::Wide(planes) => Cell {
                sum: planes.sum[pixel],
                squares: planes.squares[pixel],
                blanks: planes.blanks[pixel],
                count: planes.count[pixel],
            },
        }
    }

    /// Makes the numbers wide.
    pub(super) fn widen(&mut self) {
        if let Self::Narrow(narrow) = self {
            *self = Self::Wide(Planes {
                sum: narrow.sum.iter().map(|&sum| sum.into()).collect(),
                squares: std::mem::take(&mut narrow.squares),
                blanks: narrow.blanks.iter().map(|&blanks| blanks.into()).collect(),
                count: narrow.count.iter().map(|&count| count.into()).collect(),
            });
        }
    }

    /// Changes one pixel by one cycle's Y and sum of blanks.
    pub(super) fn remove(&mut self, pixel: usize, y: i32, lit: u32) {
        match self {
            Self::Narrow(planes) => take_out(planes, pixel, y, lit),
            Self::Wide(planes) => take_out(planes, pixel, y, lit),
        }
    }

    /// Adds the sums of others, pixel by pixel. The caller has made room for them.
    pub(super) fn merge(&mut self, other: &Self) {
        match (&mut *self, other) {
            (Self::Narrow(to), Self::Narrow(from)) => {
                to.sum.iter_mut().zip(&from.sum).for_each(|(a, b)| *a += b);
                to.squares.iter_mut().zip(&from.squares).for_each(|(a, b)| *a += b);
                to.blanks.iter_mut().zip(&from.blanks).for_each(|(a, b)| *a += b);
                to.count.iter_mut().zip(&from.count).for_each(|(a, b)| *a += b);
            }
            (Self::Wide(to), from) => {
                let pixels = to.sum.iter_mut().zip(&mut to.squares).zip(&mut to.blanks).zip(&mut to.count);
                for (pixel, (((sum, squares), blanks), count)) in pixels.enumerate() {
                    let more = from.at(pixel);
                    *sum += more.sum;
                    *squares += more.squares;
                    *blanks += more.blanks;
                    *count += more.count;
                }
            }
            (Self::Narrow(_), Self::Wide(_)) => {
                self.widen();
                self.merge(other);
            }
        }
    }
}

fn take_out<W: Width>(planes: &mut Planes<W>, pixel: usize, y: i32, lit: u32) {
    planes.sum[pixel] = W::sum::<REMOVE>(planes.sum[pixel], y);
    planes.squares[pixel] -= u64::from(y.unsigned_abs()) * u64::from(y.unsigned_abs());
    planes.blanks[pixel] = W::blanks::<REMOVE>(planes.blanks[pixel], lit);
    planes.count[pixel] = W::count::<REMOVE>(planes.count[pixel], 1);
}
