//! Between f64 and f32, in the vectors of the machine.

use pulp::{Arch, Simd, WithSimd};

/// value · scale, rounded to f32.
pub(super) fn narrowed(from: &[f64], scale: f64, to: &mut [f32]) {
    Arch::new().dispatch(Narrowed { from, scale, to });
}

/// value · scale in f64.
pub(super) fn widened(from: &[f32], scale: f64, to: &mut [f64]) {
    Arch::new().dispatch(Widened { from, scale, to });
}

/// Squares.
pub(super) fn squared(values: &mut [f32]) {
    Arch::new().dispatch(Squared(values));
}

/// Sums of every `N` numbers, as far as there is room; the last may be of fewer.
pub(super) fn blocked<const N: usize>(from: &[f32], to: &mut [f32]) {
    Arch::new().dispatch(Blocked::<N> { from, to });
}

/// The smallest of those above zero (infinite for none) and the largest (zero for none) of numbers ≥ 0.
pub(super) fn span(values: &[f64]) -> (f64, f64) {
    Arch::new().dispatch(Span(values))
}

struct Narrowed<'a> {
    from: &'a [f64],
    scale: f64,
    to: &'a mut [f32],
}

impl WithSimd for Narrowed<'_> {
    type Output = ();
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
    fn with_simd<S: Simd>(self, _: S) {
        self.to.iter_mut().zip(self.from).for_each(|(to, v)| *to = (v * self.scale) as f32);
    }
}

struct Widened<'a> {
    from: &'a [f32],
    scale: f64,
    to: &'a mut [f64],
}

impl WithSimd for Widened<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.to.iter_mut().zip(self.from).for_each(|(to, v)| *to = f64::from(*v) * self.scale);
    }
}

struct Blocked<'a, const N: usize> {
    from: &'a [f32],
    to: &'a mut [f32],
}

impl<const N: usize> WithSimd for Blocked<'_, N> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (whole, rest) = self.from.as_chunks::<N>();
        self.to.iter_mut().zip(whole).for_each(|(to, block)| *to = block.iter().sum());
        if let Some(to) = self.to.get_mut(whole.len()) {
            *to = rest.iter().sum();
        }
    }
}

struct Squared<'a>(&'a mut [f32]);

impl WithSimd for Squared<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.iter_mut().for_each(|v| *v *= *v);
    }
}

struct Span<'a>(&'a [f64]);

impl WithSimd for Span<'_> {
    type Output = (f64, f64);
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> (f64, f64) {
        // Numbers ≥ 0 are in the order of their bits, which vectors can compare; zero less one is above all of them.
        let (mut least, mut most) = (u64::MAX, 0);
        for v in self.0 {
            let bits = v.to_bits() & (u64::MAX >> 1);
            least = least.min(bits.wrapping_sub(1));
            most = most.max(bits);
        }
        let least = if least == u64::MAX { f64::INFINITY } else { f64::from_bits(least + 1) };
        (least, f64::from_bits(most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_leave_zero_out() {
        assert_eq!(span(&[0.0, 3.0, -0.0, 1e-300, 2.0]), (1e-300, 3.0));
        assert_eq!(span(&[0.0, 0.0]), (f64::INFINITY, 0.0));
        assert_eq!(span(&[]), (f64::INFINITY, 0.0));
    }

    #[test]
    fn numbers_go_both_ways() {
        let from: Vec<f64> = (0..37).map(|i| f64::from(i) * 0.1).collect();
        let (mut narrow, mut wide) = ([0.0_f32; 37], [0.0; 37]);
        narrowed(&from, 4.0, &mut narrow);
        widened(&narrow, 0.25, &mut wide);
        assert!(from.iter().zip(wide).all(|(a, b)| (a - b).abs() <= 6e-8 * a));
        squared(&mut narrow);
        assert!(
            narrow
                .iter()
                .zip(&from)
                .all(|(s, v)| (f64::from(*s) - 16.0 * v * v).abs() <= 2e-7 * 16.0 * v * v)
        );
    }
}
