//! From the exact sums of a row of pixels to the numbers that a fit needs.
//!
//! Every quotient is a product with a reciprocal, one division for a whole row whose cycles all count, or one a
//! pixel: the same bits either way, one rounding (2⁻⁵³ of the value in f64, 2⁻²⁴ in f32) further from the quotient.

use super::flag;
use super::lanes::Number;
use crate::estimate::accumulate::{self, Cells, LevelSums, Planes, Width};
use std::ops::Range;

/// Where the statistics of a level go, pixel by pixel.
pub(super) struct Statistics<'a, F> {
    /// Cycles that count.
    pub(super) count: &'a mut [F],
    /// Mean of spray − blank; 0 without a cycle.
    pub(super) mean: &'a mut [F],
    /// Squared deviations from it, summed: n − 1 times the sample variance; 0 below two cycles.
    pub(super) squares: &'a mut [F],
    /// Mean of the blanks; 0 without a cycle.
    pub(super) blank: &'a mut [F],
}

/// Statistics of one level and row, not yet divided by the pixels' gains. True if as many cycles count in every pixel,
/// and at least one.
#[inline(always)]
pub(super) fn statistics<F: Number>(
    level: &LevelSums,
    range: Range<usize>,
    blanks: u16,
    before: bool,
    out: Statistics<'_, F>,
) -> bool {
    let settings = Settings { cycles: level.cycles(), blanks, range, before };
    match level.cells() {
        Some(Cells::Short(planes)) => settings.of(planes, out),
        Some(Cells::Narrow(planes)) => settings.of(planes, out),
        Some(Cells::Wide(planes)) => settings.of(planes, out),
        None => {
            let zero = F::of(0.0);
            out.count.fill(zero);
            out.mean.fill(zero);
            out.squares.fill(zero);
            out.blank.fill(zero);
            false
        }
    }
}

/// Marks pixels that lack a cycle of a level from which none was taken out.
#[inline(always)]
pub(super) fn saturated(lost: &mut [u32], level: &LevelSums, range: Range<usize>) {
    match level.cells() {
        Some(Cells::Short(planes)) => below(lost, &planes.count[range], level.cycles()),
        Some(Cells::Narrow(planes)) => below(lost, &planes.count[range], level.cycles()),
        Some(Cells::Wide(planes)) => below(lost, &planes.count[range], level.cycles()),
        None => {}
    }
}

#[inline(always)]
fn below<C: Copy + Into<u32>>(lost: &mut [u32], count: &[C], cycles: u32) {
    for (lost, &count) in lost.iter_mut().zip(count) {
        *lost |= u32::from(count.into() < cycles) * flag::SATURATED;
    }
}

/// Below so many cycles times blanks n²·Y² < (n·b·2¹⁶)² stays below 2⁵³.
const EXACT_SAMPLES: u64 = 1448;

struct Settings {
    cycles: u32,
    blanks: u16,
    range: Range<usize>,
    /// Whether `count` was last filled with like numbers.
    before: bool,
}

impl Settings {
    #[inline(always)]
    fn of<W: Width, F: Number>(&self, planes: &Planes<W>, out: Statistics<'_, F>) -> bool {
        let (n, range) = (self.range.len(), self.range.clone());
        // Cut twice, so that the compiler sees equal lengths: loops with checks leave a tenth of a row to single numbers.
        let (sum, squares) = (&planes.sum[range.clone()][..n], &planes.squares[range.clone()][..n]);
        let (lit, count) = (&planes.blanks[range.clone()][..n], &planes.count[range][..n]);
        let (means, blank) = (&mut out.mean[..n], &mut out.blank[..n]);
        let (counts, spreads) = (&mut out.count[..n], &mut out.squares[..n]);
        let first = count.first().map_or(0, |&count| count.into());
        let mut unlike = 0_u32;
        for i in 0..n {
            unlike |= u32::from(count[i] != count[0]);
        }
        let (zero, b, before) = (F::of(0.0), f64::from(self.blanks), self.before);
        let alike = unlike == 0 && first > 0;
        if alike {
            let cycles = f64::from(first);
            let shares = Shares::of(cycles, b);
            // Rows of a campaign are alike one after the other.
            if !before || counts[0] != F::of(cycles) {
                counts.fill(F::of(cycles));
            }
            // One loop over all sums: as many streams of memory at once.
            let square = if first > 1 { shares.square } else { zero };
            for i in 0..n {
                means[i] = F::of(float::<W>(sum[i])) * shares.sample;
                blank[i] = F::of(light::<W>(lit[i])) * shares.sample;
                spreads[i] = spread::<W, F>(cycles, sum[i], squares[i].into()) * square;
            }
        } else {
            for i in 0..n {
                let cycles = f64::from(count[i].into());
                let shares = Shares::of(cycles, b);
                let (here, more) = (cycles > 0.0, cycles > 1.0);
                counts[i] = F::of(cycles);
                let mean = F::of(float::<W>(sum[i])) * shares.sample;
                means[i] = if here { mean } else { zero };
                let dark = F::of(light::<W>(lit[i])) * shares.sample;
                blank[i] = if here { dark } else { zero };
                let own = spread::<W, F>(cycles, sum[i], squares[i].into()) * shares.square;
                spreads[i] = if more { own } else { zero };
            }
        }
        // n·ΣY² and (ΣY)² ≤ n·ΣY² are exact in f64 below 2⁵³. |Y| is below 2¹⁶ for every blank, so that few cycles need
        // no look at the sums.
        let exact = u64::from(self.cycles) * u64::from(self.blanks) < EXACT_SAMPLES || {
            let (mut most, mut largest) = (0_u32, 0_u64);
            for i in 0..n {
                most = most.max(count[i].into());
                largest |= squares[i].into();
            }
            u128::from(most) * (u128::from(largest) + 1) < 1 << 53
        };
        if !exact {
            for i in 0..n {
                let cycles: u32 = count[i].into();
                if cycles > 1 {
                    let own = accumulate::variance(sum[i].into(), squares[i].into(), cycles, self.blanks);
                    spreads[i] = F::of(own * f64::from(cycles - 1));
                }
            }
        }
        alike
    }
}

/// What a sum is multiplied with.
struct Shares<F> {
    /// 1/(n·b), of ΣY and Σ blanks.
    sample: F,
    /// 1/(n·b²), of n·ΣY² − (ΣY)².
    square: F,
}

impl<F: Number> Shares<F> {
    #[inline(always)]
    fn of(cycles: f64, blanks: f64) -> Self {
        let one = F::of(1.0);
        Self { sample: one / F::of(cycles * blanks), square: one / F::of(cycles * blanks * blanks) }
    }
}

/// Exact: ΣY is below 2⁴⁸.
#[expect(clippy::cast_precision_loss, reason = "sums stay below 2^48")]
#[inline(always)]
fn float<W: Width>(sum: W::Sum) -> f64 {
    let sum: i64 = sum.into();
    sum as f64
}

#[expect(clippy::cast_precision_loss, reason = "may round once")]
#[inline(always)]
fn light<W: Width>(blanks: W::Blanks) -> f64 {
    let blanks: u64 = blanks.into();
    blanks as f64
}

/// n·ΣY² − (ΣY)²: exact where both are below 2⁵³.
#[expect(clippy::cast_precision_loss, reason = "exact below 2^53, which the caller ensures")]
#[inline(always)]
fn spread<W: Width, F: Number>(cycles: f64, sum: W::Sum, squares: u64) -> F {
    let s = float::<W>(sum);
    F::of(cycles * squares as f64 - s * s)
}
