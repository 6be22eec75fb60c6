//! Row by row from exact sums to means, variances and pooled variances, in memory that stays in the cache.
//!
//! Rows of statistics are kept, since a pooled variance needs two rows above and two below. A row's bits do not
//! depend on where the walk began, so any cut of the image among threads gives the same map.

use super::ahead::Ahead;
use super::lanes::{Aligned, Number, WIDEST};
use super::pool::Pool;
use super::source::{Held, Source};
use super::statistics::{Statistics, saturated, statistics};
use super::{FitInputs, flag};
use crate::estimate::accumulate::LevelSums;
use std::ops::Range;

/// Rows and columns on each side of a pixel that lend it their variances: windows of 5 × 5.
pub(super) const RADIUS: usize = 2;

/// Rows of a window.
pub(super) const WINDOW: usize = 2 * RADIUS + 1;

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
    /// n − 1 times the sample variance; 0 below two cycles.
    pub(super) squares: &'a [F],
    /// Mean of the blanks; 0 without a cycle.
    pub(super) blank: &'a [F],
    /// Variance pooled over neighbours; NaN where there is none.
    pub(super) pooled: &'a [F],
    /// `[stride]`: gain against the calibrated pixel, flags so far, 0 where the pixel never changes.
    pub(super) flat: &'a [F],
    pub(super) flags: &'a [F],
    pub(super) alive: &'a [F],
    /// Whether all gains are 1.
    pub(super) even: bool,
    /// Sums of the next row that will be read.
    pub(super) ahead: Ahead<'a>,
    /// Whether any of its pixels has a level of one cycle.
    pub(super) singles: bool,
    /// Whether every level has as many cycles in all of its pixels, and at least one.
    pub(super) alike: bool,
}

/// Rows kept of one band of an image.
pub(super) struct Walk<'a, F> {
    source: Source<'a>,
    held: Held<'a>,
    /// Rows of the image.
    height: usize,
    used: &'a [usize],
    flat_gain: Option<&'a [f64]>,
    columns: usize,
    stride: usize,
    slots: Vec<Slot<F>>,
    pool: Pool<F>,
    /// Rows still to be visited, the next to be filled, and how far it has to be ahead.
    rows: Range<usize>,
    filled: usize,
    reach: usize,
}

pub(super) struct Slot<F> {
    pub(super) count: Aligned<F>,
    pub(super) mean: Aligned<F>,
    pub(super) squares: Aligned<F>,
    pub(super) blank: Aligned<F>,
    pub(super) flat: Aligned<F>,
    pub(super) flags: Aligned<F>,
    pub(super) alive: Aligned<F>,
    lost: Vec<u32>,
    singles: bool,
    /// Every level has as many cycles in all pixels; and no pixel is dead.
    alike: bool,
    pub(super) lively: bool,
    /// `alike` of the row that was here before.
    before: bool,
}

impl<F: Number> Slot<F> {
    fn new(levels: usize, stride: usize, columns: usize) -> Self {
        let zero = F::of(0.0);
        let all = || Aligned::new(zero, levels * stride);
        Self {
            count: all(),
            mean: all(),
            squares: all(),
            blank: all(),
            // Beyond the last column stand pixels without a cycle.
            flat: Aligned::new(F::of(1.0), stride),
            flags: Aligned::new(zero, stride),
            alive: Aligned::new(zero, stride),
            lost: vec![0; columns],
            singles: false,
            alike: false,
            lively: true,
            before: false,
        }
    }

    /// Whether the weights of its variances follow from the first pixel's.
    pub(super) fn plain(&self) -> bool {
        self.alike && self.lively
    }
}

impl<'a, F: Number> Walk<'a, F> {
    /// A walk through the levels `used`.
    pub(super) fn new(source: Source<'a>, inputs: &FitInputs<'a>, used: &'a [usize]) -> Self {
        let columns = source.like().columns();
        Self {
            source,
            held: Held::new(source),
            height: source.like().rows(),
            used,
            flat_gain: inputs.flat_gain,
            columns,
            stride: columns.next_multiple_of(WIDEST),
            slots: Vec::new(),
            pool: Pool::new(0, 0),
            rows: 0..0,
            filled: 0,
            reach: 0,
        }
    }

    /// Goes to the first of some rows; [`Self::row`] then takes them in order.
    pub(super) fn start(&mut self, rows: Range<usize>, pool: bool) {
        let (levels, stride) = (self.used.len(), self.stride);
        let kept = if pool { WINDOW } else { 1 };
        if self.slots.len() != kept {
            self.slots =
                std::iter::repeat_with(|| Slot::new(levels, stride, self.columns)).take(kept).collect();
            self.pool = Pool::new(levels, stride);
        }
        self.reach = if pool { RADIUS } else { 0 };
        self.filled = rows.start.saturating_sub(self.reach);
        self.rows = rows;
    }

    /// Where the statistics of a row are.
    #[inline(always)]
    fn place(&self, row: usize) -> usize {
        if self.reach > 0 { row % WINDOW } else { 0 }
    }

    /// Pixels of a row of the image.
    fn pixels(&self, row: usize) -> Range<usize> {
        row * self.columns..(row + 1) * self.columns
    }

    /// The same among the sums that are held.
    fn pixels_held(&self, row: usize) -> Range<usize> {
        self.pixels(row - self.held.of().1)
    }

    /// The next row; None after the last. (No closure takes the rows: it would not be compiled for the widest vectors.)
    #[inline(always)]
    pub(super) fn row(&mut self) -> Option<Row<'_, F>> {
        let row = self.rows.next()?;
        while self.filled < (row + self.reach + 1).min(self.height) {
            self.fill(self.filled);
            self.filled += 1;
        }
        if self.reach > 0 {
            let window = row.saturating_sub(RADIUS)..(row + RADIUS + 1).min(self.height);
            self.pool.take(&self.slots, window);
        }
        let slot = &self.slots[self.place(row)];
        let last = (self.rows.end + self.reach).min(self.height);
        // Sums that are formed here are near.
        let ahead = match self.source {
            Source::Sums(sums) if self.filled < last => Ahead::new(sums, self.used, self.pixels(self.filled)),
            source => Ahead::new(source.like(), self.used, 0..0),
        };
        Some(Row {
            row,
            columns: self.columns,
            stride: self.stride,
            count: &slot.count,
            mean: &slot.mean,
            squares: &slot.squares,
            blank: &slot.blank,
            pooled: &self.pool.pooled,
            even: self.flat_gain.is_none(),
            ahead,
            flat: &slot.flat,
            flags: &slot.flags,
            alive: &slot.alive,
            singles: slot.singles,
            alike: slot.alike,
        })
    }

    /// Statistics of a row.
    #[inline(always)]
    fn fill(&mut self, row: usize) {
        self.held.hold(row);
        let range = self.pixels_held(row);
        let at = self.place(row);
        let slot = &mut self.slots[at];
        (slot.before, slot.alike) = (slot.alike, !self.used.is_empty());
        for (k, &level) in self.used.iter().enumerate() {
            let (sums, _) = self.held.of();
            let level = &sums.levels()[level];
            let to = k * self.stride..k * self.stride + self.columns;
            let out = Statistics {
                count: &mut slot.count[to.clone()],
                mean: &mut slot.mean[to.clone()],
                squares: &mut slot.squares[to.clone()],
                blank: &mut slot.blank[to],
            };
            slot.alike &= statistics(level, range.clone(), sums.blanks_per_cycle(), slot.before, out);
        }
        self.finish(row);
    }

    /// Gains, flags and life of a row whose statistics are there.
    #[inline(always)]
    fn finish(&mut self, row: usize) {
        let (range, columns, at) = (self.pixels_held(row), self.columns, self.place(row));
        let flat = self.flat_gain.map(|flat| &flat[self.pixels(row)]);
        let slot = &mut self.slots[at];
        if let Some(flat) = flat {
            slot.flat.iter_mut().zip(flat).for_each(|(to, &gain)| *to = F::of(gain));
            for k in 0..self.used.len() {
                slot.alike &= calibrate(slot, k * self.stride..k * self.stride + columns);
            }
        }
        slot.lost.fill(0);
        for (k, level) in self.held.levels().iter().enumerate() {
            // The first pixel stands for all of a level where all are alike.
            let nothing = slot.alike
                && self.used.contains(&k)
                && !level.has_outliers()
                && level.count(range.start) == level.cycles();
            if !nothing {
                lost_samples(&mut slot.lost, level, range.clone());
            }
        }
        for (flags, &lost) in slot.flags.iter_mut().zip(&slot.lost) {
            *flags = F::of(f64::from(lost));
        }
        slot.alive[..columns].fill(F::of(1.0));
        slot.lively = true;
        if self.used.is_empty() {
            return;
        }
        let (zero, two) = (F::of(0.0), F::of(2.0));
        let mut singles = 0_u32;
        if slot.alike {
            for count in slot.count.chunks(self.stride) {
                singles += u32::from(count[0] < two);
            }
        } else {
            for &n in slot.count.iter() {
                singles += u32::from(zero < n && n < two);
            }
        }
        slot.singles = singles > 0;
        // Hardly a pixel is still: a row without one is told by its first level alone.
        let mut still = 0_u32;
        for (&n, &squares) in slot.count[..columns].iter().zip(&slot.squares[..columns]) {
            still += u32::from(n < two || squares <= zero);
        }
        if still > 0 {
            self.find_constant(row);
        }
    }

    /// Marks pixels of a row that never change.
    fn find_constant(&mut self, row: usize) {
        let at = self.place(row);
        for i in 0..self.columns {
            let slot = &self.slots[at];
            let first = slot.count[i];
            if first >= F::of(2.0) && F::of(0.0) < slot.squares[i] {
                continue;
            }
            let still = self.constancy(row, i);
            let slot = &mut self.slots[at];
            if still != 0 {
                slot.flags[i] = F::of(f64::from(slot.lost[i] | still));
            }
            if still & flag::DEAD != 0 {
                slot.alive[i] = F::of(0.0);
                slot.lively = false;
            }
        }
    }

    /// Flags of a pixel that does not change: judged by the exact sums, since means of unlike counts are rounded.
    fn constancy(&self, row: usize, column: usize) -> u32 {
        let slot = &self.slots[self.place(row)];
        let (zero, two) = (F::of(0.0), F::of(2.0));
        let pixel = self.pixels_held(row).start + column;
        let at = |k: usize| k * self.stride + column;
        let mut seen = (0..self.used.len()).filter(|&k| zero < slot.count[at(k)]);
        let Some(first) = seen.next() else { return 0 };
        // A level of one cycle has no variance and cannot contradict.
        let still = |k: usize| slot.count[at(k)] < two || slot.squares[at(k)] <= zero;
        if !still(first) {
            return 0;
        }
        let level = |k: usize| &self.held.levels()[self.used[k]];
        let one = level(first);
        let n = i128::from(one.count(pixel));
        let (mut dark, mut levels, mut repeated) = (true, 1, two <= slot.count[at(first)]);
        for k in seen {
            let other = level(k);
            let m = i128::from(other.count(pixel));
            if !(still(k) && i128::from(other.sum(pixel)) * n == i128::from(one.sum(pixel)) * m) {
                return 0;
            }
            dark &= i128::from(other.sum_blanks(pixel)) * n == i128::from(one.sum_blanks(pixel)) * m;
            repeated |= two <= slot.count[at(k)];
            levels += 1;
        }
        let constant = if repeated && levels >= 2 { flag::CONSTANT } else { 0 };
        let dead = if dark && levels >= 2 && (repeated || levels >= 3) { flag::DEAD } else { 0 };
        constant | dead
    }
}

/// Divides by the pixels' gains; a pixel without a gain has no cycle that counts, and false is returned.
#[inline(always)]
fn calibrate<F: Number>(slot: &mut Slot<F>, to: Range<usize>) -> bool {
    let zero = F::of(0.0);
    let mut all = true;
    let each = slot.count[to.clone()].iter_mut().zip(&mut slot.mean[to.clone()]);
    let more = slot.squares[to.clone()].iter_mut().zip(&mut slot.blank[to]);
    for (((count, mean), (squares, blank)), &gain) in each.zip(more).zip(slot.flat.iter()) {
        let known = zero < gain && gain.is_number();
        let g = if known { gain } else { F::of(1.0) };
        all &= known;
        *count = if known { *count } else { zero };
        *mean = *mean / g;
        *squares = *squares / (g * g);
        *blank = *blank / g;
    }
    all
}

/// A cycle that a pixel lacks was either saturated or taken out.
#[inline(always)]
fn lost_samples(lost: &mut [u32], level: &LevelSums, range: Range<usize>) {
    if !level.has_outliers() {
        saturated(lost, level, range);
        return;
    }
    for (lost, pixel) in lost.iter_mut().zip(range) {
        *lost |= u32::from(level.saturated(pixel) > 0) * flag::SATURATED;
        *lost |= u32::from(level.outliers(pixel) > 0) * flag::OUTLIERS;
    }
}
