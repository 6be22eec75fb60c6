//! Exact integer sums of counts per pixel and level.
//!
//! A cycle is b blanks and one spray frame; its sample in a pixel is the integer Y = b·spray − Σ blanks, so that a
//! mean of blanks needs no division here. ΣY, ΣY² and Σ blanks are exact: any order of cycles, any number of
//! threads and any merge of partial sums gives the same bits, and a cycle can be taken out again exactly.
//! Knows nothing of files, time or which frames belong together.

use rayon::prelude::*;

/// Largest number of blanks in a cycle: |Y| ≤ 256 · 65535 < 2²⁴ then, so that Y fits i32 and Y² fits 48 bit.
pub const BLANKS_MAX: u16 = 256;

/// Pixels that one task handles: 8192 · 32 B of sums stay in a core's second-level cache.
const CHUNK_PIXELS: usize = 8192;

/// Why a cycle was not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccumulateError {
    /// a cycle has {given} blanks where {expected} are expected. Check `blanks` of the campaign.
    #[error("a cycle has {given} blanks where {expected} are expected. Check `blanks` of the campaign.")]
    Blanks {
        /// Blanks handed in.
        given: usize,
        /// Blanks per cycle of these sums.
        expected: usize,
    },
    /// a frame has {given} pixels where {expected} are expected. Check the camera's region of interest.
    #[error(
        "a frame has {given} pixels where {expected} are expected. Check the camera's region of interest."
    )]
    Pixels {
        /// Pixels handed in.
        given: usize,
        /// rows · columns of these sums.
        expected: usize,
    },
    /// level {level} does not exist: there are {levels}.
    #[error("level {level} does not exist: there are {levels}.")]
    Level {
        /// Level asked for, from 0.
        level: usize,
        /// Number of levels.
        levels: usize,
    },
    /// level {level} holds {cycles} cycles, more would overflow the sums of squares. Use fewer blanks per cycle.
    #[error(
        "level {level} holds {cycles} cycles, more would overflow the sums of squares. Use fewer blanks per cycle."
    )]
    Full {
        /// Level, from 0.
        level: usize,
        /// Cycles it holds.
        cycles: u32,
    },
    /// level {level} holds no cycle that could be taken out.
    #[error("level {level} holds no cycle that could be taken out.")]
    Empty {
        /// Level, from 0.
        level: usize,
    },
    /// sums of different shape, number of blanks or saturation count cannot be merged.
    #[error("sums of different shape, number of blanks or saturation count cannot be merged.")]
    Unlike,
    /// {blanks} blanks per cycle: 1 to 256 are possible.
    #[error("{blanks} blanks per cycle: 1 to 256 are possible.")]
    BlanksPerCycle {
        /// Blanks per cycle asked for.
        blanks: u16,
    },
}

/// Sums of one level, each `[rows · columns]` in row order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LevelSums {
    /// Cycles added, valid or not.
    pub cycles: u32,
    /// ΣY over the cycles that count for the pixel, Y = b·spray − Σ blanks, in counts · b.
    pub sum: Vec<i64>,
    /// ΣY², in (counts · b)².
    pub sum_squares: Vec<u64>,
    /// Sum of all blank samples of the cycles that count, in counts: count · b samples.
    pub sum_blanks: Vec<u64>,
    /// Cycles that count for the pixel: all b + 1 samples below the saturation count.
    pub count: Vec<u32>,
    /// Cycles that were taken out for the pixel alone; empty if there are none.
    pub outliers: Vec<u16>,
}

impl LevelSums {
    fn new(pixels: usize) -> Self {
        Self {
            cycles: 0,
            sum: vec![0; pixels],
            sum_squares: vec![0; pixels],
            sum_blanks: vec![0; pixels],
            count: vec![0; pixels],
            outliers: Vec::new(),
        }
    }

    /// Cycles that were taken out for the pixel alone.
    pub fn outliers(&self, pixel: usize) -> u32 {
        self.outliers.get(pixel).map_or(0, |&n| u32::from(n))
    }

    /// Cycles in which a sample of the pixel was saturated.
    pub fn saturated(&self, pixel: usize) -> u32 {
        self.cycles - self.count[pixel] - self.outliers(pixel)
    }
}

/// Exact sums of all levels of one map.
///
/// Limits: Σ Y² is kept in u64, so a level takes at most `cycles_max()` cycles, ⌊(2⁶⁴−1)/(b·65535)²⌋ (4.29e9 for
/// b = 1, 4.3e7 for b = 10, 65 540 for b = 256); |ΣY| is then below 2⁴⁸ and Σ blanks below 2⁵⁶. The limit is
/// checked when a cycle is added or sums are merged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sums {
    rows: usize,
    columns: usize,
    blanks_per_cycle: u16,
    saturation_count: u16,
    levels: Vec<LevelSums>,
}

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
        Ok(Self {
            rows,
            columns,
            blanks_per_cycle,
            saturation_count,
            levels: (0..levels).map(|_| LevelSums::new(pixels)).collect(),
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
        self.levels[level].cycles = cycles + 1;
        self.apply(level, &[Cycle { blanks, spray }], Sign::Add);
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
            Some(sum) if sum <= self.cycles_max() => self.levels[level].cycles = sum,
            _ => return Err(AccumulateError::Full { level, cycles: held }),
        }
        self.apply(level, cycles, Sign::Add);
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
        self.apply(level, &[Cycle { blanks, spray }], Sign::Remove);
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
        let lit: u64 = blanks.iter().map(|blank| u64::from(blank[pixel])).sum();
        let signed = i64::try_from(lit).expect("256 samples of 16 bits");
        let y = i64::from(self.blanks_per_cycle) * i64::from(spray[pixel]) - signed;
        level.sum[pixel] -= y;
        level.sum_squares[pixel] -= y.unsigned_abs() * y.unsigned_abs();
        level.sum_blanks[pixel] -= lit;
        level.count[pixel] -= 1;
        if level.outliers.is_empty() {
            level.outliers = vec![0; pixels];
        }
        level.outliers[pixel] = level.outliers[pixel].saturating_add(1);
    }

    /// Forgets all cycles and keeps the memory.
    pub fn clear(&mut self) {
        for LevelSums { cycles, sum, sum_squares, sum_blanks, count, outliers } in &mut self.levels {
            *cycles = 0;
            outliers.clear();
            sum.fill(0);
            sum_squares.fill(0);
            sum_blanks.fill(0);
            count.fill(0);
        }
    }

    /// Adds the sums of `other`, acquired with the same settings, level by level.
    ///
    /// # Errors
    ///
    /// When the settings differ or a level would overflow; the sums are then unchanged.
    pub fn merge(&mut self, other: &Self) -> Result<(), AccumulateError> {
        let like = self.rows == other.rows
            && self.columns == other.columns
            && self.blanks_per_cycle == other.blanks_per_cycle
            && self.saturation_count == other.saturation_count
            && self.levels.len() == other.levels.len();
        if !like {
            return Err(AccumulateError::Unlike);
        }
        for (level, (to, from)) in self.levels.iter().zip(&other.levels).enumerate() {
            if to.cycles.checked_add(from.cycles).is_none_or(|sum| sum > self.cycles_max()) {
                return Err(AccumulateError::Full { level, cycles: to.cycles });
            }
        }
        for (to, from) in self.levels.iter_mut().zip(&other.levels) {
            to.cycles += from.cycles;
            to.sum.iter_mut().zip(&from.sum).for_each(|(a, b)| *a += b);
            to.sum_squares.iter_mut().zip(&from.sum_squares).for_each(|(a, b)| *a += b);
            to.sum_blanks.iter_mut().zip(&from.sum_blanks).for_each(|(a, b)| *a += b);
            to.count.iter_mut().zip(&from.count).for_each(|(a, b)| *a += b);
            if to.outliers.is_empty() {
                to.outliers.clone_from(&from.outliers);
            } else {
                to.outliers.iter_mut().zip(&from.outliers).for_each(|(a, b)| *a = a.saturating_add(*b));
            }
        }
        Ok(())
    }

    fn check(&self, level: usize, blanks: &[&[u16]], spray: &[u16]) -> Result<(), AccumulateError> {
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

    /// Every part of the image takes all cycles before the next part, so that its sums stay in the cache.
    fn apply(&mut self, level: usize, cycles: &[Cycle<'_>], sign: Sign) {
        let saturation = self.saturation_count;
        let LevelSums { sum, sum_squares, sum_blanks, count, .. } = &mut self.levels[level];
        sum.par_chunks_mut(CHUNK_PIXELS)
            .zip(sum_squares.par_chunks_mut(CHUNK_PIXELS))
            .zip(sum_blanks.par_chunks_mut(CHUNK_PIXELS))
            .zip(count.par_chunks_mut(CHUNK_PIXELS))
            .enumerate()
            .for_each(|(chunk, (((sum, sum_squares), sum_blanks), count))| {
                let target = Target { sum, sum_squares, sum_blanks, count };
                let from = chunk * CHUNK_PIXELS;
                pulp::Arch::new().dispatch(Part { target, from, cycles, saturation, sign });
            });
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

/// A part of the image and the cycles that it takes.
struct Part<'a> {
    target: Target<'a>,
    from: usize,
    cycles: &'a [Cycle<'a>],
    saturation: u16,
    sign: Sign,
}

impl pulp::WithSimd for Part<'_> {
    type Output = ();

    // Plain loops over integers: the compiler makes vectors of them, here for the widest the machine has.
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) {
        let range = self.from..self.from + self.target.sum.len();
        for cycle in self.cycles {
            let spray = &cycle.spray[range.clone()];
            match (cycle.blanks, self.sign) {
                ([blank], Sign::Add) => self.target.pair::<1>(&blank[range.clone()], spray, self.saturation),
                ([blank], Sign::Remove) => {
                    self.target.pair::<-1>(&blank[range.clone()], spray, self.saturation);
                }
                (blanks, Sign::Add) => self.target.cycle::<1>(blanks, self.from, spray, self.saturation),
                (blanks, Sign::Remove) => self.target.cycle::<-1>(blanks, self.from, spray, self.saturation),
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Sign {
    Add,
    Remove,
}

/// Pixels whose blanks are added up at a time, on the stack.
const BLOCK_PIXELS: usize = 256;

struct Target<'a> {
    sum: &'a mut [i64],
    sum_squares: &'a mut [u64],
    sum_blanks: &'a mut [u64],
    count: &'a mut [u32],
}

impl Target<'_> {
    /// One blank and one spray frame: the common case without scratch memory.
    #[inline(always)]
    fn pair<const SIGN: i64>(&mut self, blank: &[u16], spray: &[u16], saturation: u16) {
        let n = self.sum.len();
        let (blank, spray) = (&blank[..n], &spray[..n]);
        let (sum_squares, sum_blanks) = (&mut self.sum_squares[..n], &mut self.sum_blanks[..n]);
        let (sum, count) = (&mut self.sum[..n], &mut self.count[..n]);
        for i in 0..n {
            let valid = i32::from(blank[i].max(spray[i]) < saturation);
            let y = (i32::from(spray[i]) - i32::from(blank[i])) * valid;
            let size = y.unsigned_abs();
            put::<SIGN>(&mut sum[i], &mut sum_squares[i], y, size);
            let lit = u32::from(blank[i]) * valid.unsigned_abs();
            put_counts::<SIGN>(&mut sum_blanks[i], &mut count[i], lit, valid.unsigned_abs());
        }
    }

    /// Several blanks: `from` is the place of the first pixel in the blanks' frames.
    #[inline(always)]
    fn cycle<const SIGN: i64>(&mut self, blanks: &[&[u16]], from: usize, spray: &[u16], saturation: u16) {
        let scale = i32::try_from(blanks.len()).expect("at most 256 blanks");
        let (mut total, mut highest) = ([0_i32; BLOCK_PIXELS], [0_u16; BLOCK_PIXELS]);
        for start in (0..spray.len()).step_by(BLOCK_PIXELS) {
            let n = BLOCK_PIXELS.min(spray.len() - start);
            let block = start..start + n;
            let (total, highest) = (&mut total[..n], &mut highest[..n]);
            total.fill(0);
            highest.fill(0);
            for blank in blanks {
                let blank = &blank[from + start..from + start + n];
                for i in 0..n {
                    // At most 256 · 65 535: no check is needed, and one would stop the vectoriser.
                    total[i] = total[i].wrapping_add(i32::from(blank[i]));
                    highest[i] = highest[i].max(blank[i]);
                }
            }
            let spray = &spray[block.clone()];
            let (sum, count) = (&mut self.sum[block.clone()], &mut self.count[block.clone()]);
            let (sum_squares, sum_blanks) =
                (&mut self.sum_squares[block.clone()], &mut self.sum_blanks[block]);
            for i in 0..n {
                let valid = i32::from(highest[i].max(spray[i]) < saturation);
                let y = scale.wrapping_mul(i32::from(spray[i])).wrapping_sub(total[i]).wrapping_mul(valid);
                put::<SIGN>(&mut sum[i], &mut sum_squares[i], y, y.unsigned_abs());
                let lit = total[i].wrapping_mul(valid).unsigned_abs();
                put_counts::<SIGN>(&mut sum_blanks[i], &mut count[i], lit, valid.unsigned_abs());
            }
        }
    }
}

// Wrapping operations, because checked ones in a debug build stop the vectoriser; `cycles_max` is the proof that
// none wraps.
#[inline(always)]
fn put<const SIGN: i64>(sum: &mut i64, sum_squares: &mut u64, y: i32, size: u32) {
    let square = u64::from(size).wrapping_mul(u64::from(size));
    if SIGN > 0 {
        *sum = sum.wrapping_add(i64::from(y));
        *sum_squares = sum_squares.wrapping_add(square);
    } else {
        *sum = sum.wrapping_sub(i64::from(y));
        *sum_squares = sum_squares.wrapping_sub(square);
    }
}

#[inline(always)]
fn put_counts<const SIGN: i64>(sum_blanks: &mut u64, count: &mut u32, lit: u32, valid: u32) {
    if SIGN > 0 {
        *sum_blanks = sum_blanks.wrapping_add(u64::from(lit));
        *count = count.wrapping_add(valid);
    } else {
        *sum_blanks = sum_blanks.wrapping_sub(u64::from(lit));
        *count = count.wrapping_sub(valid);
    }
}

/// Mean, in counts, of `count` cycles of `blanks` blanks each. NaN for no cycle.
pub fn mean(sum: i64, count: u32, blanks: u16) -> f64 {
    // Below 2⁴⁸ (see `Sums`): the conversion is exact.
    #[expect(clippy::cast_precision_loss, reason = "sums stay below 2^48")]
    let sum = sum as f64;
    sum / (f64::from(count) * f64::from(blanks))
}

/// Sample variance (n − 1) in counts², from exact sums. NaN below two cycles, never negative.
pub fn variance(sum: i64, sum_squares: u64, count: u32, blanks: u16) -> f64 {
    if count < 2 {
        return f64::NAN;
    }
    // nΣY² − (ΣY)² is an exact integer below 2⁹⁶: no cancellation, whatever the mean. One rounding, so both ways
    // give the same bits; the short one serves all but the longest campaigns.
    let short = sum_squares.leading_zeros() + count.leading_zeros() >= 33 && sum.unsigned_abs() < 1 << 31;
    #[expect(clippy::cast_precision_loss, reason = "one rounding of the exact result")]
    let spread = if short {
        (u64::from(count) * sum_squares - sum.unsigned_abs() * sum.unsigned_abs()) as f64
    } else {
        (i128::from(count) * i128::from(sum_squares) - i128::from(sum) * i128::from(sum)) as f64
    };
    let b = f64::from(blanks);
    spread / (f64::from(count) * f64::from(count - 1) * (b * b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(seed: u64, pixels: usize) -> Vec<u16> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        (0..pixels)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                u16::try_from(state >> 50).unwrap()
            })
            .collect()
    }

    fn slow(cycles: &[(Vec<Vec<u16>>, Vec<u16>)], pixel: usize, saturation: u16) -> (i64, u64, u64, u32) {
        let mut out = (0, 0, 0, 0);
        for (blanks, spray) in cycles {
            if spray[pixel] >= saturation || blanks.iter().any(|b| b[pixel] >= saturation) {
                continue;
            }
            let total: i64 = blanks.iter().map(|b| i64::from(b[pixel])).sum();
            let y = i64::try_from(blanks.len()).unwrap() * i64::from(spray[pixel]) - total;
            out.0 += y;
            out.1 += u64::try_from(y * y).unwrap();
            out.2 += u64::try_from(total).unwrap();
            out.3 += 1;
        }
        out
    }

    fn add(sums: &mut Sums, cycle: &(Vec<Vec<u16>>, Vec<u16>)) {
        let blanks: Vec<&[u16]> = cycle.0.iter().map(Vec::as_slice).collect();
        sums.add_cycle(0, &blanks, &cycle.1).unwrap();
    }

    /// Against a plain loop, for one and for several blanks, in any order, merged, and after taking one out.
    #[test]
    fn sums_are_exact_in_any_order() {
        for blanks in [1_u16, 3] {
            let (rows, columns, saturation) = (7, 1301, 15_000);
            let cycles: Vec<_> = (0..6_u64)
                .map(|c| {
                    let dark =
                        (0..u64::from(blanks)).map(|b| frame(100 * c + b + 1, rows * columns)).collect();
                    (dark, frame(1000 + c, rows * columns))
                })
                .collect();
            let mut forward = Sums::new(1, rows, columns, blanks, saturation).unwrap();
            let mut other = forward.clone();
            let mut part = forward.clone();
            cycles.iter().for_each(|c| add(&mut forward, c));
            cycles[..2].iter().rev().for_each(|c| add(&mut other, c));
            cycles[2..].iter().for_each(|c| add(&mut part, c));
            other.merge(&part).unwrap();
            assert!(forward == other);
            let mut together = Sums::new(1, rows, columns, blanks, saturation).unwrap();
            let dark: Vec<Vec<&[u16]>> =
                cycles.iter().map(|(dark, _)| dark.iter().map(Vec::as_slice).collect()).collect();
            let all: Vec<Cycle<'_>> =
                dark.iter().zip(&cycles).map(|(blanks, (_, spray))| Cycle { blanks, spray }).collect();
            together.add_cycles(0, &all).unwrap();
            assert!(forward == together);
            for pixel in [0, 5, 8191, 8192, rows * columns - 1] {
                let level = &forward.levels()[0];
                let got =
                    (level.sum[pixel], level.sum_squares[pixel], level.sum_blanks[pixel], level.count[pixel]);
                assert_eq!(got, slow(&cycles, pixel, saturation));
                assert_eq!(level.saturated(pixel), 6 - level.count[pixel]);
            }
            let dark: Vec<&[u16]> = cycles[0].0.iter().map(Vec::as_slice).collect();
            forward.remove_cycle(0, &dark, &cycles[0].1).unwrap();
            let mut without = Sums::new(1, rows, columns, blanks, saturation).unwrap();
            cycles[1..].iter().for_each(|c| add(&mut without, c));
            assert!(forward == without);
        }
    }

    #[test]
    fn extreme_counts_do_not_overflow() {
        let mut sums = Sums::new(1, 1, 2, BLANKS_MAX, u16::MAX).unwrap();
        let high = [65_534_u16, 0];
        let low = [0_u16, 65_534];
        let blanks = vec![low.as_slice(); usize::from(BLANKS_MAX)];
        for _ in 0..1000 {
            sums.add_cycle(0, &blanks, &high).unwrap();
        }
        let level = &sums.levels()[0];
        assert_eq!(level.sum[0], 1000 * 256 * 65_534);
        assert_eq!(level.sum[1], -1000 * 256 * 65_534);
        assert!(mean(level.sum[1], 1000, BLANKS_MAX).to_bits() == (-65_534.0_f64).to_bits());
        assert!(
            variance(level.sum[1], level.sum_squares[1], 1000, BLANKS_MAX).to_bits() == 0.0_f64.to_bits()
        );
        assert!(sums.cycles_max() >= 65_536);
    }

    #[test]
    fn wrong_cycles_are_refused() {
        let mut sums = Sums::new(2, 1, 2, 2, 16_383).unwrap();
        let f = [1_u16, 2];
        assert_eq!(sums.add_cycle(0, &[&f], &f), Err(AccumulateError::Blanks { given: 1, expected: 2 }));
        assert_eq!(
            sums.add_cycle(0, &[&f, &f], &f[..1]),
            Err(AccumulateError::Pixels { given: 1, expected: 2 })
        );
        assert_eq!(sums.add_cycle(2, &[&f, &f], &f), Err(AccumulateError::Level { level: 2, levels: 2 }));
        assert_eq!(sums.remove_cycle(0, &[&f, &f], &f), Err(AccumulateError::Empty { level: 0 }));
        assert_eq!(Sums::new(1, 1, 1, 0, 1), Err(AccumulateError::BlanksPerCycle { blanks: 0 }));
        let unlike = Sums::new(2, 1, 2, 3, 16_383).unwrap();
        assert_eq!(sums.merge(&unlike), Err(AccumulateError::Unlike));
        let full = sums.cycles_max();
        sums.levels[1].cycles = full;
        assert_eq!(sums.add_cycle(1, &[&f, &f], &f), Err(AccumulateError::Full { level: 1, cycles: full }));
    }
}
