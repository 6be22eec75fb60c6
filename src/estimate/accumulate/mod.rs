//! Exact integer sums of counts per pixel and level.
//!
//! A cycle is b blanks and one spray frame; its sample in a pixel is the integer Y = b·spray − Σ blanks, so that a
//! mean of blanks needs no division here. ΣY, ΣY² and Σ blanks are exact: any order of cycles, any number of
//! threads and any merge of partial sums gives the same bits, and a cycle can be taken out again exactly.
//! Knows nothing of files, time or which frames belong together.

mod add;
mod error;
mod moments;
mod planes;

use add::How;
pub use error::AccumulateError;
pub use moments::{mean, variance};
use planes::{Cell, Samples};
pub(super) use planes::{Cells, Planes, Width};

/// Largest number of blanks in a cycle: |Y| ≤ 256 · 65535 < 2²⁴ then, so that Y fits i32 and Y² fits 48 bit.
pub const BLANKS_MAX: u16 = 256;

/// Sums of one level.
#[derive(Debug, Clone)]
pub struct LevelSums {
    cycles: u32,
    /// Empty memory or stale where there is no cycle.
    cells: Cells,
    /// Cycles that were taken out for the pixel alone; empty if there are none.
    outliers: Vec<u16>,
}

impl LevelSums {
    fn new(pixels: usize, samples: Samples) -> Self {
        Self { cycles: 0, cells: Cells::new(pixels, samples), outliers: Vec::new() }
    }

    /// Cycles added, valid or not.
    pub fn cycles(&self) -> u32 {
        self.cycles
    }

    /// The sums themselves; None without a cycle, whatever is in memory then.
    pub(super) fn cells(&self) -> Option<&Cells> {
        (self.cycles > 0).then_some(&self.cells)
    }

    fn at(&self, pixel: usize) -> Cell {
        self.cells().map_or(Cell::default(), |cells| cells.at(pixel))
    }

    /// ΣY over the cycles that count for the pixel, Y = b·spray − Σ blanks, in counts · b.
    pub fn sum(&self, pixel: usize) -> i64 {
        self.at(pixel).sum
    }

    /// ΣY², in (counts · b)².
    pub fn sum_squares(&self, pixel: usize) -> u64 {
        self.at(pixel).squares
    }

    /// Sum of all blank samples of the cycles that count, in counts: count · b samples.
    pub fn sum_blanks(&self, pixel: usize) -> u64 {
        self.at(pixel).blanks
    }

    /// Cycles that count for the pixel: all b + 1 samples below the saturation count.
    pub fn count(&self, pixel: usize) -> u32 {
        self.at(pixel).count
    }

    /// Whether a cycle was taken out of any pixel alone.
    pub fn has_outliers(&self) -> bool {
        !self.outliers.is_empty()
    }

    /// Cycles that were taken out for the pixel alone.
    pub fn outliers(&self, pixel: usize) -> u32 {
        self.outliers.get(pixel).map_or(0, |&n| u32::from(n))
    }

    /// Cycles in which a sample of the pixel was saturated.
    pub fn saturated(&self, pixel: usize) -> u32 {
        self.cycles - self.count(pixel) - self.outliers(pixel)
    }

    /// Makes the sums wider where so many cycles might not fit.
    fn make_room(&mut self, cycles: u32, samples: Samples) {
        while cycles > self.cells.cycles_max(samples) {
            self.cells.widen();
        }
    }
}

/// Exact sums of all levels of one map.
///
/// Limits: Σ Y² is kept in u64, so a level takes at most `cycles_max()` cycles, ⌊(2⁶⁴−1)/(b·65535)²⌋ (4.29e9 for
/// b = 1, 4.3e7 for b = 10, 65 540 for b = 256); |ΣY| is then below 2⁴⁸ and Σ blanks below 2⁵⁶. The limit is
/// checked when a cycle is added or sums are merged.
#[derive(Debug, Clone)]
pub struct Sums {
    rows: usize,
    columns: usize,
    blanks_per_cycle: u16,
    saturation_count: u16,
    levels: Vec<LevelSums>,
}

/// Equal settings and equal sums of every pixel, however wide they are kept.
impl PartialEq for Sums {
    fn eq(&self, other: &Self) -> bool {
        let pixels = 0..self.rows * self.columns;
        let equal = |(a, b): (&LevelSums, &LevelSums)| {
            a.cycles == b.cycles
                && pixels.clone().all(|i| a.at(i) == b.at(i) && a.outliers(i) == b.outliers(i))
        };
        self.like(other) && self.levels.iter().zip(&other.levels).all(equal)
    }
}

impl Eq for Sums {}

impl Sums {
    /// Empty sums. A sample counts if it is *below* `saturation_count`.
    ///
    /// # Errors
    ///
    /// [`AccumulateError::BlanksPerCycle`] unless 1 ≤ `blanks_per_cycle` ≤ 256.
    pub fn new(
        levels: usize,
        rows: usize,
        columns: usize,
        blanks_per_cycle: u16,
        saturation_count: u16,
    ) -> Result<Self, AccumulateError> {
        if !(1..=BLANKS_MAX).contains(&blanks_per_cycle) {
            return Err(AccumulateError::BlanksPerCycle { blanks: blanks_per_cycle });
        }
        let pixels = rows * columns;
        let samples = Samples { blanks: blanks_per_cycle, saturation: saturation_count };
        Ok(Self {
            rows,
            columns,
            blanks_per_cycle,
            saturation_count,
            levels: (0..levels).map(|_| LevelSums::new(pixels, samples)).collect(),
        })
    }

    /// Rows of a frame.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns of a frame.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Blanks per cycle, b.
    pub fn blanks_per_cycle(&self) -> u16 {
        self.blanks_per_cycle
    }

    /// Samples from this count on do not count.
    pub fn saturation_count(&self) -> u16 {
        self.saturation_count
    }

    /// The sums, one entry a level.
    pub fn levels(&self) -> &[LevelSums] {
        &self.levels
    }

    /// Most cycles that a level can hold without overflow.
    pub fn cycles_max(&self) -> u32 {
        let largest = u64::from(self.blanks_per_cycle) * 65_535;
        u32::try_from(u64::MAX / (largest * largest)).unwrap_or(u32::MAX)
    }

    /// Adds one cycle: `blanks_per_cycle` blanks and a spray frame, each `[rows · columns]` raw counts.
    ///
    /// # Errors
    ///
    /// When the shape is wrong or the level is full; the sums are then unchanged.
    pub fn add_cycle(
        &mut self,
        level: usize,
        blanks: &[&[u16]],
        spray: &[u16],
    ) -> Result<(), AccumulateError> {
        self.check(level, blanks, spray)?;
        let cycles = self.levels[level].cycles;
        if cycles >= self.cycles_max() {
            return Err(AccumulateError::Full { level, cycles });
        }
        self.add(level, cycles + 1, &[Cycle { blanks, spray }]);
        Ok(())
    }

    /// Adds several cycles of a level: the same sums as one by one, in less time.
    ///
    /// # Errors
    ///
    /// As [`Self::add_cycle`], for the first cycle that does not fit; the sums are then unchanged.
    pub fn add_cycles(&mut self, level: usize, cycles: &[Cycle<'_>]) -> Result<(), AccumulateError> {
        for cycle in cycles {
            self.check(level, cycle.blanks, cycle.spray)?;
        }
        let Some(held) = self.levels.get(level).map(|level| level.cycles) else { return Ok(()) };
        let more = u32::try_from(cycles.len()).ok().and_then(|more| held.checked_add(more));
        match more {
            Some(sum) if sum <= self.cycles_max() => self.add(level, sum, cycles),
            _ => return Err(AccumulateError::Full { level, cycles: held }),
        }
        Ok(())
    }

    /// Takes out a cycle that was added before: the sums are then as if it had never been added.
    ///
    /// # Errors
    ///
    /// When the shape is wrong or the level is empty; the sums are then unchanged.
    pub fn remove_cycle(
        &mut self,
        level: usize,
        blanks: &[&[u16]],
        spray: &[u16],
    ) -> Result<(), AccumulateError> {
        self.check(level, blanks, spray)?;
        let cycles = self.levels[level].cycles;
        self.levels[level].cycles = cycles.checked_sub(1).ok_or(AccumulateError::Empty { level })?;
        self.apply(level, &[Cycle { blanks, spray }], How::Remove);
        Ok(())
    }

    /// Takes a cycle that was added before out of one pixel alone, exactly; nothing happens if it did not count there.
    ///
    /// Panics when level, pixel or frames are not those of the sums, which is the caller's mistake.
    pub fn remove_sample(&mut self, level: usize, pixel: usize, blanks: &[&[u16]], spray: &[u16]) {
        let saturation = self.saturation_count;
        let pixels = self.rows * self.columns;
        assert!(blanks.len() == usize::from(self.blanks_per_cycle), "as many blanks as were added");
        let level = &mut self.levels[level];
        if spray[pixel] >= saturation || blanks.iter().any(|blank| blank[pixel] >= saturation) {
            return;
        }
        // At most 256 samples of 16 bits.
        let lit: u32 = blanks.iter().map(|blank| u32::from(blank[pixel])).sum();
        let all = u32::from(self.blanks_per_cycle) * u32::from(spray[pixel]);
        level.cells.remove(pixel, all.cast_signed() - lit.cast_signed(), lit);
        if level.outliers.is_empty() {
            level.outliers = vec![0; pixels];
        }
        level.outliers[pixel] = level.outliers[pixel].saturating_add(1);
    }

    /// Forgets all cycles and keeps the memory.
    pub fn clear(&mut self) {
        for level in &mut self.levels {
            level.cycles = 0;
            level.outliers.clear();
        }
    }

    /// Adds the sums of `other`, acquired with the same settings, level by level.
    ///
    /// # Errors
    ///
    /// When the settings differ or a level would overflow; the sums are then unchanged.
    pub fn merge(&mut self, other: &Self) -> Result<(), AccumulateError> {
        if !self.like(other) {
            return Err(AccumulateError::Unlike);
        }
        for (level, (to, from)) in self.levels.iter().zip(&other.levels).enumerate() {
            if to.cycles.checked_add(from.cycles).is_none_or(|sum| sum > self.cycles_max()) {
                return Err(AccumulateError::Full { level, cycles: to.cycles });
            }
        }
        let samples = self.samples();
        for (to, from) in self.levels.iter_mut().zip(&other.levels) {
            let Some(cells) = from.cells() else { continue };
            let cycles = to.cycles + from.cycles;
            if to.cycles == 0 {
                to.cells.clone_from(cells);
            } else {
                to.make_room(cycles, samples);
                to.cells.merge(cells);
            }
            to.cycles = cycles;
            if to.outliers.is_empty() {
                to.outliers.clone_from(&from.outliers);
            } else {
                to.outliers.iter_mut().zip(&from.outliers).for_each(|(a, b)| *a = a.saturating_add(*b));
            }
        }
        Ok(())
    }

    /// Whether a cycle could be added.
    pub(super) fn check(
        &self,
        level: usize,
        blanks: &[&[u16]],
        spray: &[u16],
    ) -> Result<(), AccumulateError> {
        if level >= self.levels.len() {
            return Err(AccumulateError::Level { level, levels: self.levels.len() });
        }
        let expected = usize::from(self.blanks_per_cycle);
        if blanks.len() != expected {
            return Err(AccumulateError::Blanks { given: blanks.len(), expected });
        }
        let expected = self.rows * self.columns;
        let wrong = blanks.iter().chain(std::iter::once(&spray)).find(|frame| frame.len() != expected);
        match wrong {
            Some(frame) => Err(AccumulateError::Pixels { given: frame.len(), expected }),
            None => Ok(()),
        }
    }

    fn samples(&self) -> Samples {
        Samples { blanks: self.blanks_per_cycle, saturation: self.saturation_count }
    }

    fn like(&self, other: &Self) -> bool {
        self.rows == other.rows
            && self.columns == other.columns
            && self.blanks_per_cycle == other.blanks_per_cycle
            && self.saturation_count == other.saturation_count
            && self.levels.len() == other.levels.len()
    }

    fn add(&mut self, level: usize, sum: u32, cycles: &[Cycle<'_>]) {
        let samples = self.samples();
        let to = &mut self.levels[level];
        to.make_room(sum, samples);
        let how = if to.cycles == 0 { How::Put } else { How::Add };
        to.cycles = sum;
        self.apply(level, cycles, how);
    }

    fn apply(&mut self, level: usize, cycles: &[Cycle<'_>], how: How) {
        let settings = add::Settings { saturation: self.saturation_count, how };
        match &mut self.levels[level].cells {
            Cells::Short(planes) => add::apply(planes, cycles, settings),
            Cells::Narrow(planes) => add::apply(planes, cycles, settings),
            Cells::Wide(planes) => add::apply(planes, cycles, settings),
        }
    }
}

/// One cycle: its blanks and its spray frame, each `[rows · columns]` raw counts.
#[derive(Debug, Clone, Copy)]
pub struct Cycle<'a> {
    /// As many blanks as the sums expect.
    pub blanks: &'a [&'a [u16]],
    /// The spray frame.
    pub spray: &'a [u16],
}

#[cfg(test)]
mod tests;
