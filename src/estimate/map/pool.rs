//! Variances pooled over a pixel's neighbours: windows of 5 × 5, cut at the edges.

use super::lanes::{Aligned, Number};
use super::rows::{RADIUS, Slot, WINDOW};
use std::ops::Range;

/// Pooled variances of one row, and what the next row may use again.
pub(super) struct Pool<F> {
    /// `[level][stride]`; NaN where there is none.
    pub(super) pooled: Aligned<F>,
    /// 1/Σ(n − 1), `[level][stride]`.
    shares: Aligned<F>,
    /// Sums over the rows of a window, with a margin of zeros on both sides.
    vertical: Vec<F>,
    /// A row of zeros, for what is above and below the image.
    nothing: Vec<F>,
    /// Rows of the window and cycles of the levels that `shares` belong to; 0 rows for none.
    known: (usize, Vec<F>),
    stride: usize,
}

impl<F: Number> Pool<F> {
    pub(super) fn new(levels: usize, stride: usize) -> Self {
        let zero = F::of(0.0);
        Self {
            pooled: Aligned::new(zero, levels * stride),
            shares: Aligned::new(zero, levels * stride),
            vertical: vec![zero; stride + 2 * RADIUS],
            nothing: vec![zero; stride],
            known: (0, vec![zero; levels]),
            stride,
        }
    }

    /// Pools over some rows of `slots`: squared deviations over the sum of n − 1, dead pixels left out (they have no
    /// deviations).
    #[inline(always)]
    pub(super) fn take(&mut self, slots: &[Slot<F>], window: Range<usize>) {
        self.share(slots, window.clone());
        let n = self.stride;
        for (k, to) in self.pooled.chunks_exact_mut(n).enumerate() {
            let here = k * n..(k + 1) * n;
            let [a, b, c, d, e] =
                rows(window.clone(), |row| &slots[row % WINDOW].squares[here.clone()], &self.nothing);
            let inner = &mut self.vertical[RADIUS..RADIUS + n];
            for i in 0..n {
                inner[i] = a[i] + b[i] + c[i] + d[i] + e[i];
            }
            let (v, shares) = (&self.vertical[..n + 2 * RADIUS], &self.shares[here]);
            for i in 0..n {
                to[i] = (v[i] + v[i + 1] + v[i + 2] + v[i + 3] + v[i + 4]) * shares[i];
            }
        }
    }

    /// 1/Σ(n − 1): as before where all rows of the window are like those of the one before.
    #[inline(always)]
    fn share(&mut self, slots: &[Slot<F>], window: Range<usize>) {
        let n = self.stride;
        let mut plain = true;
        let mut known = self.known.0 == window.len();
        for row in window.clone() {
            let slot = &slots[row % WINDOW];
            plain &= slot.plain();
            for (count, before) in slot.count.chunks_exact(n).zip(&self.known.1) {
                known &= count[0] == *before;
            }
        }
        if plain && known {
            return;
        }
        let one = F::of(1.0);
        for (k, to) in self.shares.chunks_exact_mut(n).enumerate() {
            let here = k * n..(k + 1) * n;
            let inner = &mut self.vertical[RADIUS..RADIUS + n];
            inner.fill(F::of(0.0));
            for row in window.clone() {
                let slot = &slots[row % WINDOW];
                let (count, alive) = (&slot.count[here.clone()], &slot.alive[..n]);
                for i in 0..n {
                    let weight = if count[i] < one { F::of(0.0) } else { (count[i] - one) * alive[i] };
                    inner[i] = inner[i] + weight;
                }
            }
            let v = &self.vertical[..n + 2 * RADIUS];
            for i in 0..n {
                to[i] = one / (v[i] + v[i + 1] + v[i + 2] + v[i + 3] + v[i + 4]);
            }
        }
        let first = &slots[window.start % WINDOW];
        let mut alike = plain;
        for (k, known) in self.known.1.iter_mut().enumerate() {
            *known = first.count[k * n];
            for row in window.clone() {
                alike &= slots[row % WINDOW].count[k * n] == *known;
            }
        }
        self.known.0 = if alike { window.len() } else { 0 };
    }
}

/// The rows of a window, nothing for those that are not there. Zeros change no sum, so where they stand does not matter.
#[inline(always)]
fn rows<'a, F>(window: Range<usize>, row: impl Fn(usize) -> &'a [F], nothing: &'a [F]) -> [&'a [F]; WINDOW] {
    let mut rows = [nothing; WINDOW];
    for (to, at) in rows.iter_mut().zip(window) {
        *to = row(at);
    }
    rows
}
