//! Row by row from exact sums to means, variances and pooled variances, in memory that stays in the cache.
//!
//! Rows of statistics are kept, since a pooled variance needs two rows above and two below. A row's bits do not
//! depend on where the walk began, so any cut of the image among threads gives the same map.

use super::lanes::{Number, WIDEST};
use super::{FitInputs, flag};
use crate::estimate::accumulate::{self, LevelSums, Sums};
use std::ops::Range;

/// Rows and columns on each side of a pixel that lend it their variances: windows of 5 × 5.
const RADIUS: usize = 2;

/// Rows whose sums are read in one go: the machine fetches ahead within pages of memory, and a row of one sum is
/// hardly longer than a page.
const GULP: usize = 4;

/// Rows that are kept: a window's, and what is read ahead.
const KEPT: usize = 2 * RADIUS + GULP;

/// Statistics of a row, each `[level][stride]`, levels with an x only.
pub(super) struct Row<'a, F> {
    /// Its number.
    pub(super) row: usize,
    /// Columns, and numbers from level to level: columns rounded up to the widest vector.
    pub(super) columns: usize,
    pub(super) stride: usize,
    /// Cycles that count; 0 where a level is not there.
    pub(super) count: &'a [F],
    /// Mean of spray − blank; 0 without a cycle.
    pub(super) mean: &'a [F],
    /// Sample variance; 0 below two cycles.
    pub(super) own: &'a [F],
    /// Mean of the blanks; 0 without a cycle.
    pub(super) blank: &'a [F],
    /// Variance pooled over neighbours; NaN where there is none.
    pub(super) pooled: &'a [F],
    /// `[stride]`: gain against the calibrated pixel, flags so far, 0 where the pixel never changes.
    pub(super) flat: &'a [F],
    pub(super) flags: &'a [F],
    pub(super) alive: &'a [F],
    /// Whether any of its pixels has a level of one cycle.
    pub(super) singles: bool,
}

/// Rows kept of one band of an image.
pub(super) struct Walk<'a, F> {
    sums: &'a Sums,
    used: &'a [usize],
    flat_gain: Option<&'a [f64]>,
    columns: usize,
    stride: usize,
    slots: Vec<Slot<F>>,
    pooled: Vec<F>,
    vertical: [Vec<F>; 2],
    /// Rows still to be visited, the next to be filled, and how far it has to be ahead.
    rows: Range<usize>,
    filled: usize,
    reach: usize,
}

#[derive(Clone)]
struct Slot<F> {
    count: Vec<F>,
    mean: Vec<F>,
    own: Vec<F>,
    blank: Vec<F>,
    flat: Vec<F>,
    flags: Vec<F>,
    alive: Vec<F>,
    lost: Vec<u32>,
    singles: bool,
}

impl<'a, F: Number> Walk<'a, F> {
    /// A walk through the levels `used`.
    pub(super) fn new(sums: &'a Sums, inputs: &FitInputs<'a>, used: &'a [usize]) -> Self {
        let columns = sums.columns();
        let stride = columns.next_multiple_of(WIDEST);
        let zero = F::of(0.0);
        let all = || vec![zero; used.len() * stride];
        let slot = Slot {
            count: all(),
            mean: all(),
            own: all(),
            blank: all(),
            // Beyond the last column stand pixels without a cycle.
            flat: vec![F::of(1.0); stride],
            flags: vec![zero; stride],
            alive: vec![zero; stride],
            lost: vec![0; columns],
            singles: false,
        };
        let padded = || vec![zero; stride + 2 * RADIUS];
        Self {
            sums,
            used,
            flat_gain: inputs.flat_gain,
            columns,
            stride,
            slots: vec![slot; KEPT],
            pooled: all(),
            vertical: [padded(), padded()],
            rows: 0..0,
            filled: 0,
            reach: 0,
        }
    }

    /// Goes to the first of some rows; [`Self::row`] then takes them in order.
    pub(super) fn start(&mut self, rows: Range<usize>, pool: bool) {
        self.reach = if pool { RADIUS } else { 0 };
        self.filled = rows.start.saturating_sub(self.reach);
        self.rows = rows;
    }

    /// The next row; None after the last. (No closure takes the rows: it would not be compiled for the widest vectors.)
    #[inline(always)]
    pub(super) fn row(&mut self) -> Option<Row<'_, F>> {
        let row = self.rows.next()?;
        while self.filled < (row + self.reach + 1).min(self.sums.rows()) {
            let last = (self.rows.end + self.reach).min(self.sums.rows());
            let to = (self.filled + GULP).min(last);
            self.fill(self.filled..to);
            self.filled = to;
        }
        if self.reach > 0 {
            self.pool(row);
        }
        let slot = &self.slots[row % KEPT];
        Some(Row {
            row,
            columns: self.columns,
            stride: self.stride,
            count: &slot.count,
            mean: &slot.mean,
            own: &slot.own,
            blank: &slot.blank,
            pooled: &self.pooled,
            flat: &slot.flat,
            flags: &slot.flags,
            alive: &slot.alive,
            singles: slot.singles,
        })
    }

    /// Statistics of some rows.
    #[inline(always)]
    fn fill(&mut self, rows: Range<usize>) {
        for (k, &level) in self.used.iter().enumerate() {
            let level = &self.sums.levels()[level];
            for row in rows.clone() {
                let range = row * self.columns..(row + 1) * self.columns;
                let slot = &mut self.slots[row % KEPT];
                let to = k * self.stride..k * self.stride + self.columns;
                let out = Statistics {
                    count: &mut slot.count[to.clone()],
                    mean: &mut slot.mean[to.clone()],
                    own: &mut slot.own[to.clone()],
                    blank: &mut slot.blank[to],
                };
                statistics(level, range, self.sums.blanks_per_cycle(), out);
            }
        }
        for row in rows {
            self.finish(row);
        }
    }

    /// Gains, flags and life of a row whose statistics are there.
    #[inline(always)]
    fn finish(&mut self, row: usize) {
        let range = row * self.columns..(row + 1) * self.columns;
        let slot = &mut self.slots[row % KEPT];
        if let Some(flat) = self.flat_gain {
            slot.flat.iter_mut().zip(&flat[range.clone()]).for_each(|(to, &gain)| *to = F::of(gain));
            for k in 0..self.used.len() {
                calibrate(slot, k * self.stride..k * self.stride + self.columns);
            }
        }
        slot.lost.fill(0);
        for level in self.sums.levels() {
            if level.outliers.is_empty() {
                for (lost, &count) in slot.lost.iter_mut().zip(&level.count[range.clone()]) {
                    *lost |= u32::from(count < level.cycles) * flag::SATURATED;
                }
            } else {
                lost_samples(&mut slot.lost, level, range.clone());
            }
        }
        let (one, lost) = (F::of(1.0), &slot.lost);
        for (flags, &lost) in slot.flags.iter_mut().zip(lost) {
            *flags = F::of(f64::from(lost));
        }
        slot.alive[..self.columns].fill(one);
        if self.used.is_empty() {
            return;
        }
        let two = F::of(2.0);
        let mut singles = 0_u32;
        for &n in &slot.count[..self.used.len() * self.stride] {
            singles += u32::from(F::of(0.0) < n && n < two);
        }
        slot.singles = singles > 0;
        // Hardly a pixel is still: a row without one is told by its first level alone.
        let zero = F::of(0.0);
        let mut still = 0_u32;
        for (&n, &own) in slot.count[..self.columns].iter().zip(&slot.own[..self.columns]) {
            still += u32::from(n < two || own <= zero);
        }
        if still > 0 {
            self.find_constant(row);
        }
    }

    /// Marks pixels of a row that never change.
    fn find_constant(&mut self, row: usize) {
        let slot = &mut self.slots[row % KEPT];
        for i in 0..self.columns {
            let still = constancy(slot, self.used.len(), self.stride, i);
            if still != 0 {
                slot.flags[i] = F::of(f64::from(slot.lost[i] | still));
            }
            if still & flag::DEAD != 0 {
                slot.alive[i] = F::of(0.0);
            }
        }
    }

    /// Variances of `row` pooled over neighbours: weighted by n − 1, dead pixels left out.
    #[inline(always)]
    fn pool(&mut self, row: usize) {
        let (zero, one) = (F::of(0.0), F::of(1.0));
        let first = row.saturating_sub(RADIUS);
        let last = (row + RADIUS + 1).min(self.sums.rows());
        let [weights, values] = &mut self.vertical;
        for k in 0..self.used.len() {
            let here = k * self.stride..(k + 1) * self.stride;
            for from in first..last {
                let slot = &self.slots[from % KEPT];
                let inner = RADIUS..RADIUS + self.stride;
                let each = weights[inner.clone()].iter_mut().zip(&mut values[inner]);
                let of = slot.count[here.clone()].iter().zip(&slot.own[here.clone()]).zip(&slot.alive);
                for ((weight, value), ((&n, &own), &alive)) in each.zip(of) {
                    let w = if n < one { zero } else { (n - one) * alive };
                    let (before_w, before_v) = if from == first { (zero, zero) } else { (*weight, *value) };
                    *weight = before_w + w;
                    *value = before_v + w * own;
                }
            }
            let n = self.stride;
            let pooled = &mut self.pooled[here];
            let (w, v) = (&weights[..n + 2 * RADIUS], &values[..n + 2 * RADIUS]);
            for i in 0..n {
                let weight = w[i] + w[i + 1] + w[i + 2] + w[i + 3] + w[i + 4];
                let value = v[i] + v[i + 1] + v[i + 2] + v[i + 3] + v[i + 4];
                pooled[i] = value / weight;
            }
        }
    }
}

struct Statistics<'a, F> {
    count: &'a mut [F],
    mean: &'a mut [F],
    own: &'a mut [F],
    blank: &'a mut [F],
}

/// Below so many cycles times blanks n²·Y² < (n·b·2¹⁶)² stays below 2⁵³.
const EXACT_SAMPLES: u64 = 1448;

/// Means and variances of one level and row, not yet divided by the pixels' gains.
#[inline(always)]
fn statistics<F: Number>(level: &LevelSums, range: Range<usize>, blanks: u16, out: Statistics<'_, F>) {
    let (n, b) = (range.len(), f64::from(blanks));
    let (sum, squares) = (&level.sum[range.clone()], &level.sum_squares[range.clone()]);
    let (lit, count) = (&level.sum_blanks[range.clone()], &level.count[range]);
    let (counts, means) = (&mut out.count[..n], &mut out.mean[..n]);
    let (owns, blank) = (&mut out.own[..n], &mut out.blank[..n]);
    // n·ΣY² and (ΣY)² ≤ n·ΣY² are exact in f64 below 2⁵³. |Y| is below 2¹⁶ for every blank, so that few cycles need no
    // look at the sums.
    let exact = u64::from(level.cycles) * u64::from(blanks) < EXACT_SAMPLES || {
        let (mut most, mut largest) = (0_u32, 0_u64);
        for i in 0..n {
            most = most.max(count[i]);
            largest |= squares[i];
        }
        u128::from(most) * (u128::from(largest) + 1) < 1 << 53
    };
    let zero = F::of(0.0);
    #[expect(
        clippy::cast_precision_loss,
        reason = "exact below 2^53, which the sums' limits ensure; Σ blanks may round once"
    )]
    for i in 0..n {
        let cycles = f64::from(count[i]);
        let (s, q) = (sum[i] as f64, squares[i] as f64);
        let samples = F::of(cycles * b);
        let here = count[i] > 0;
        counts[i] = F::of(cycles);
        let mean = F::of(s) / samples;
        means[i] = if here { mean } else { zero };
        let dark = F::of(lit[i] as f64) / samples;
        blank[i] = if here { dark } else { zero };
        let own = F::of(cycles * q - s * s) / F::of(cycles * (cycles - 1.0) * (b * b));
        owns[i] = if count[i] > 1 { own } else { zero };
    }
    if !exact {
        for i in (0..n).filter(|&i| count[i] > 1) {
            owns[i] = F::of(accumulate::variance(sum[i], squares[i], count[i], blanks));
        }
    }
}

/// Divides by the pixels' gains; a pixel without a gain has no cycle that counts.
#[inline(always)]
fn calibrate<F: Number>(slot: &mut Slot<F>, to: Range<usize>) {
    let zero = F::of(0.0);
    let each = slot.count[to.clone()].iter_mut().zip(&mut slot.mean[to.clone()]);
    let more = slot.own[to.clone()].iter_mut().zip(&mut slot.blank[to]);
    for (((count, mean), (own, blank)), &gain) in each.zip(more).zip(&slot.flat) {
        let known = zero < gain && gain.is_number();
        let g = if known { gain } else { F::of(1.0) };
        *count = if known { *count } else { zero };
        *mean = *mean / g;
        *own = *own / (g * g);
        *blank = *blank / g;
    }
}

/// A cycle that a pixel lacks was either saturated or taken out.
fn lost_samples(lost: &mut [u32], level: &LevelSums, range: Range<usize>) {
    for (lost, pixel) in lost.iter_mut().zip(range) {
        *lost |= u32::from(level.saturated(pixel) > 0) * flag::SATURATED;
        *lost |= u32::from(level.outliers(pixel) > 0) * flag::OUTLIERS;
    }
}

/// Flags of a pixel that does not change.
fn constancy<F: Number>(slot: &Slot<F>, levels: usize, stride: usize, pixel: usize) -> u32 {
    let (zero, two) = (F::of(0.0), F::of(2.0));
    let mut seen = (0..levels).map(|k| k * stride + pixel).filter(|&at| zero < slot.count[at]);
    let Some(first) = seen.next() else { return 0 };
    // A level of one cycle has no variance and cannot contradict.
    let still = |at: usize| slot.count[at] < two || slot.own[at] <= zero;
    if !still(first) {
        return 0;
    }
    let mut dark = true;
    let (mut levels, mut repeated) = (1, two <= slot.count[first]);
    for at in seen {
        if !(still(at) && slot.mean[at] == slot.mean[first]) {
            return 0;
        }
        dark &= slot.blank[at] == slot.blank[first];
        repeated |= two <= slot.count[at];
        levels += 1;
    }
    let constant = if repeated && levels >= 2 { flag::CONSTANT } else { 0 };
    let dead = if dark && levels >= 2 && (repeated || levels >= 3) { flag::DEAD } else { 0 };
    constant | dead
}
