//! The loops that add cycles to sums: a block of pixels at a time, whose sums stay in the first-level cache.
//!
//! Plain loops over integers, compiled for the widest vectors of the machine. Each is over numbers of one width, since
//! the widest number of a loop decides how many the compiler takes at a time.

use super::Cycle;
use super::planes::{ADD, PUT, Planes, REMOVE, Width};
use rayon::prelude::*;

/// Pixels that one task handles.
const CHUNK_PIXELS: usize = 8192;

/// Pixels that take a cycle at once: their sums and what is between stay in the first-level cache.
const BLOCK_ONE: usize = 512;

/// Pixels that take all cycles at once, as long a piece of each frame as a page of memory: the machine fetches ahead
/// within a page, and their sums stay in the second-level cache.
const BLOCK_MANY: usize = 2048;

/// Cycles of 14 bit that are added up in 16 and 32 bit before they reach the sums: Σ blanks < 4 · 2¹⁴ = 2¹⁶,
/// ΣY² < 4 · 2²⁸ = 2³⁰.
const GROUP: usize = 4;

/// Saturation count up to which samples that count have 14 bits.
const SHORT: u16 = 1 << 14;

/// What happens to the sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    /// They hold nothing yet, whatever their memory says.
    Put,
    /// Cycles are added.
    Add,
    /// Cycles are taken out.
    Remove,
}

/// How samples are judged, and what happens to the sums.
#[derive(Clone, Copy)]
pub(super) struct Settings {
    pub(super) saturation: u16,
    pub(super) how: How,
}

impl Settings {
    /// What happens to the sums at the `place`th time: they hold nothing only once.
    #[inline(always)]
    fn how(self, place: usize) -> How {
        if self.how == How::Put && place > 0 { How::Add } else { self.how }
    }
}

/// Adds cycles to the sums of all pixels, on all threads.
pub(super) fn apply<W: Width>(planes: &mut Planes<W>, cycles: &[Cycle<'_>], settings: Settings) {
    let Planes { sum, squares, blanks, count } = planes;
    sum.par_chunks_mut(CHUNK_PIXELS)
        .zip(squares.par_chunks_mut(CHUNK_PIXELS))
        .zip(blanks.par_chunks_mut(CHUNK_PIXELS))
        .zip(count.par_chunks_mut(CHUNK_PIXELS))
        .enumerate()
        .for_each(|(chunk, (((sum, squares), blanks), count))| {
            let target = Target::<W> { sum, squares, blanks, count };
            pulp::Arch::new().dispatch(Part { target, from: chunk * CHUNK_PIXELS, cycles, settings });
        });
}

/// Sums of a part of the image.
struct Target<'a, W: Width> {
    sum: &'a mut [W::Sum],
    squares: &'a mut [W::Squares],
    blanks: &'a mut [W::Blanks],
    count: &'a mut [W::Count],
}

/// A part of the image and the cycles that it takes; `from` is its first pixel.
struct Part<'a, W: Width> {
    target: Target<'a, W>,
    from: usize,
    cycles: &'a [Cycle<'a>],
    settings: Settings,
}

impl<W: Width> pulp::WithSimd for Part<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let short =
            self.settings.saturation <= SHORT && self.cycles.iter().all(|cycle| cycle.blanks.len() == 1);
        match (short, self.cycles.len()) {
            (true, 1) => self.short::<BLOCK_ONE>(),
            (true, _) => self.short::<BLOCK_MANY>(),
            (false, _) => self.any(),
        }
    }
}

impl<W: Width> Part<'_, W> {
    /// The sums of block after block of pixels, and where they begin in the frames.
    #[inline(always)]
    fn blocks(&mut self, size: usize) -> impl Iterator<Item = (usize, Target<'_, W>)> {
        let Target { sum, squares, blanks, count } = &mut self.target;
        let each = sum.chunks_mut(size).zip(squares.chunks_mut(size));
        let more = blanks.chunks_mut(size).zip(count.chunks_mut(size));
        let from = self.from;
        each.zip(more).enumerate().map(move |(place, ((sum, squares), (blanks, count)))| {
            (from + place * size, Target { sum, squares, blanks, count })
        })
    }

    /// Cycles of one blank and 14 bits, by the group.
    #[inline(always)]
    fn short<const BLOCK: usize>(mut self) {
        let (cycles, settings) = (self.cycles, self.settings);
        let mut memory = Short::<BLOCK>::new();
        for (from, mut block) in self.blocks(BLOCK) {
            for (place, group) in cycles.chunks(GROUP).enumerate() {
                match settings.how(place) {
                    How::Put => block.short::<PUT, BLOCK>(&mut memory, from, group, settings.saturation),
                    How::Add => block.short::<ADD, BLOCK>(&mut memory, from, group, settings.saturation),
                    How::Remove => {
                        block.short::<REMOVE, BLOCK>(&mut memory, from, group, settings.saturation)
                    }
                }
            }
        }
    }

    /// Any cycles.
    #[inline(always)]
    fn any(mut self) {
        let (cycles, settings) = (self.cycles, self.settings);
        let mut memory = Long::new();
        for (from, mut block) in self.blocks(BLOCK_ONE) {
            for (place, cycle) in cycles.iter().enumerate() {
                match settings.how(place) {
                    How::Put => block.any::<PUT>(&mut memory, from, cycle, settings.saturation),
                    How::Add => block.any::<ADD>(&mut memory, from, cycle, settings.saturation),
                    How::Remove => block.any::<REMOVE>(&mut memory, from, cycle, settings.saturation),
                }
            }
        }
    }
}

/// What is between samples of 14 bits and sums, for one block.
struct Short<const BLOCK: usize> {
    difference: [[i16; BLOCK]; GROUP],
    light: [u16; BLOCK],
    square: [u32; BLOCK],
    valid: [u16; BLOCK],
}

impl<const BLOCK: usize> Short<BLOCK> {
    fn new() -> Self {
        Self { difference: [[0; BLOCK]; GROUP], light: [0; BLOCK], square: [0; BLOCK], valid: [0; BLOCK] }
    }
}

/// What is between any samples and sums, for one block.
struct Long {
    total: [u32; BLOCK_ONE],
    highest: [u16; BLOCK_ONE],
    y: [i32; BLOCK_ONE],
    valid: [u16; BLOCK_ONE],
}

impl Long {
    fn new() -> Self {
        Self { total: [0; BLOCK_ONE], highest: [0; BLOCK_ONE], y: [0; BLOCK_ONE], valid: [0; BLOCK_ONE] }
    }
}

impl<W: Width> Target<'_, W> {
    /// At most [`GROUP`] cycles of one blank and 14 bits.
    #[inline(always)]
    fn short<const HOW: i32, const BLOCK: usize>(
        &mut self,
        memory: &mut Short<BLOCK>,
        from: usize,
        group: &[Cycle<'_>],
        saturation: u16,
    ) {
        match group {
            [a, b, c, d] => self.group::<HOW, 4, BLOCK>(memory, from, [a, b, c, d], saturation),
            [a, b, c] => self.group::<HOW, 3, BLOCK>(memory, from, [a, b, c], saturation),
            [a, b] => self.group::<HOW, 2, BLOCK>(memory, from, [a, b], saturation),
            [a] => self.group::<HOW, 1, BLOCK>(memory, from, [a], saturation),
            _ => {}
        }
    }

    /// So many cycles of one blank and 14 bits: samples in 16 bit first, then wider.
    #[inline(always)]
    fn group<const HOW: i32, const CYCLES: usize, const BLOCK: usize>(
        &mut self,
        memory: &mut Short<BLOCK>,
        from: usize,
        cycles: [&Cycle<'_>; CYCLES],
        saturation: u16,
    ) {
        let n = self.sum.len();
        let blank = cycles.map(|cycle| &cycle.blanks[0][from..][..n]);
        let spray = cycles.map(|cycle| &cycle.spray[from..][..n]);
        let Short { difference, light, square, valid } = memory;
        let (light, valid, square) = (&mut light[..n], &mut valid[..n], &mut square[..n]);
        let mut each = difference.iter_mut();
        let y: [&mut [i16]; CYCLES] =
            std::array::from_fn(|_| &mut each.next().expect("as many as a group has")[..n]);
        for i in 0..n {
            let (mut lit, mut counting) = (0_u16, 0_u16);
            for k in 0..CYCLES {
                let (b, s) = (blank[k][i], spray[k][i]);
                let keep = if b.max(s) < saturation { u16::MAX } else { 0 };
                lit = lit.wrapping_add(b & keep);
                counting = counting.wrapping_sub(keep);
                y[k][i] = (s.wrapping_sub(b) & keep).cast_signed();
            }
            light[i] = lit;
            valid[i] = counting;
        }
        let (sum, y) = (&mut self.sum[..n], y.map(|y| &*y));
        for i in 0..n {
            let (mut total, mut squares) = (0_i32, 0_i32);
            for y in y {
                let y = i32::from(y[i]);
                total = total.wrapping_add(y);
                squares = squares.wrapping_add(y.wrapping_mul(y));
            }
            sum[i] = W::sum::<HOW>(sum[i], total);
            square[i] = squares.cast_unsigned();
        }
        self.put_squares::<HOW>(square);
        for (blanks, &light) in self.blanks.iter_mut().zip(light.iter()) {
            *blanks = W::blanks::<HOW>(*blanks, u32::from(light));
        }
        self.put_counts::<HOW>(valid);
    }

    /// A cycle of any number of blanks and 16 bits.
    #[inline(always)]
    fn any<const HOW: i32>(&mut self, memory: &mut Long, from: usize, cycle: &Cycle<'_>, saturation: u16) {
        let n = self.sum.len();
        let scale = u32::try_from(cycle.blanks.len()).expect("at most 256 blanks");
        let (total, highest) = (&mut memory.total[..n], &mut memory.highest[..n]);
        total.fill(0);
        highest.copy_from_slice(&cycle.spray[from..from + n]);
        for blank in cycle.blanks {
            let blank = &blank[from..from + n];
            for i in 0..n {
                // At most 256 · 65 535.
                total[i] = total[i].wrapping_add(u32::from(blank[i]));
            }
            for i in 0..n {
                highest[i] = highest[i].max(blank[i]);
            }
        }
        let (spray, y) = (&cycle.spray[from..from + n], &mut memory.y[..n]);
        let valid = &mut memory.valid[..n];
        for i in 0..n {
            valid[i] = u16::from(highest[i] < saturation);
        }
        let sum = &mut self.sum[..n];
        for i in 0..n {
            let kept = u32::from(valid[i]);
            let light = total[i].wrapping_mul(kept);
            y[i] =
                scale.wrapping_mul(u32::from(spray[i])).wrapping_mul(kept).wrapping_sub(light).cast_signed();
            total[i] = light;
            sum[i] = W::sum::<HOW>(sum[i], y[i]);
        }
        let squares = &mut self.squares[..n];
        for i in 0..n {
            let size = u64::from(y[i].unsigned_abs());
            squares[i] = W::squares::<HOW>(squares[i], size.wrapping_mul(size));
        }
        let blanks = &mut self.blanks[..n];
        for i in 0..n {
            blanks[i] = W::blanks::<HOW>(blanks[i], total[i]);
        }
        self.put_counts::<HOW>(valid);
    }

    #[inline(always)]
    fn put_squares<const HOW: i32>(&mut self, more: &[u32]) {
        for (squares, &more) in self.squares.iter_mut().zip(more) {
            *squares = W::squares::<HOW>(*squares, u64::from(more));
        }
    }

    #[inline(always)]
    fn put_counts<const HOW: i32>(&mut self, valid: &[u16]) {
        for (count, &valid) in self.count.iter_mut().zip(valid) {
            *count = W::count::<HOW>(*count, valid);
        }
    }
}
