//! Asks for memory before it is needed: sums of the next row, and where answers go.
//!
//! The machine fetches ahead by itself only where it is already reading, and a row of one sum is hardly longer than a
//! page: without this, reading sums takes its time on top of everything else. Changes no number; elsewhere than on
//! x86 it does nothing.

use crate::estimate::accumulate::{Cells, Planes, Sums, Width};
use std::ops::Range;

/// Pixels between two calls for the same plane: numbers of four bytes in a line of the cache.
const STEP: usize = 16;

/// Sums that will be read next.
pub(super) struct Ahead<'a> {
    sums: &'a Sums,
    used: &'a [usize],
    pixels: Range<usize>,
}

impl<'a> Ahead<'a> {
    /// The sums of some pixels.
    pub(super) fn new(sums: &'a Sums, used: &'a [usize], pixels: Range<usize>) -> Self {
        Self { sums, used, pixels }
    }

    /// Asks for the line that begins at the so-manieth of the pixels.
    #[inline(always)]
    pub(super) fn fetch(&self, offset: usize) {
        let pixel = self.pixels.start + offset;
        if !offset.is_multiple_of(STEP) || pixel >= self.pixels.end {
            return;
        }
        for &level in self.used {
            match self.sums.levels()[level].cells() {
                Some(Cells::Short(planes)) => of(planes, pixel),
                Some(Cells::Narrow(planes)) => of(planes, pixel),
                Some(Cells::Wide(planes)) => of(planes, pixel),
                None => {}
            }
        }
    }
}

#[inline(always)]
fn of<W: Width>(planes: &Planes<W>, pixel: usize) {
    line(&planes.sum, pixel);
    line(&planes.squares, pixel);
    line(&planes.blanks, pixel);
    line(&planes.count, pixel);
}

/// Numbers between what is written and what is asked for.
const ROOM: usize = 64;

/// Asks for the line that will be written some vectors after number `at`.
#[inline(always)]
pub(super) fn room<T>(numbers: &[T], at: usize) {
    line(numbers, at + ROOM);
}

/// Asks for what is around one number, if there is one.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn line<T>(numbers: &[T], at: usize) {
    use pulp::core_arch::x86::Sse;
    if let (Some(sse), Some(number)) = (Sse::try_new(), numbers.get(at)) {
        sse._mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T1 }>(std::ptr::from_ref(number).cast());
    }
}

#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
fn line<T>(_: &[T], _: usize) {}
