//! Rows and columns of the pixels of an image, which are numbered row by row.

/// An image's pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Raster {
    columns: u32,
    /// 2⁶⁴ over the number of columns, rounded up: the upper half of its product with a pixel's number is the row (Granlund
    /// and Montgomery, PLDI 1994), which takes a fifth of a division's time.
    reciprocal: u64,
}

impl Raster {
    /// `columns` is at least 1, and all pixels' numbers are below 2³².
    pub(super) fn new(columns: usize) -> Self {
        let columns = u32::try_from(columns).unwrap_or(u32::MAX).max(1);
        Self { columns, reciprocal: (u64::MAX / u64::from(columns)).wrapping_add(1) }
    }

    pub(super) fn columns(self) -> usize {
        self.columns as usize
    }

    /// Row and column of a pixel.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "a row's number is not above the pixel's")]
    pub(super) fn at(self, pixel: u32) -> [usize; 2] {
        // Of a single column the reciprocal does not fit, and wraps to zero.
        let row = if self.reciprocal == 0 {
            pixel
        } else {
            ((u128::from(pixel) * u128::from(self.reciprocal)) >> 64) as u32
        };
        [row as usize, (pixel - row * self.columns) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_columns_are_those_of_a_division() {
        for columns in [1, 2, 3, 7, 320, 640, 641, 1280, 4095, 65_536, 1 << 31, u32::MAX] {
            let raster = Raster::new(columns as usize);
            let ends = (0..50).flat_map(|k| [k * columns.min(80_000_000) / 3, k, u32::MAX - k]);
            let steps = (0..5000_u32).map(|k| k.wrapping_mul(0x9E37_79B1));
            for pixel in ends.chain(steps) {
                let expected = [pixel / columns, pixel % columns].map(|v| v as usize);
                assert_eq!(raster.at(pixel), expected, "{pixel} of {columns}");
            }
        }
    }
}
