//! Pixels that need no sight of their own: where cells are wide against pixels, three pixels in four can be interpolated
//! from those of even rows and columns, as far as the image is smooth there.

use super::lanes::larger;
use super::raster::Raster;
use super::shares::ROWS;
use super::spectrum::narrow;
use rayon::prelude::*;

/// The widest pixel, in cells, beside which another may be left out: whatever a cell shows is then seen in passing.
pub(super) const PIXEL_MAX: f64 = 0.4;

/// Pixels along the edge of a tile with one check, and of one over which differences are smoothed.
const CHECK_TILE: usize = 8;
const TILE: usize = 4;

/// Classes of checks at most, and checks in one at least.
const CLASSES_MAX: usize = 16;
const CLASS_MIN: usize = 48;

/// Share of the largest step between samples that counts as a difference: where a step may hide.
const STEEP: f32 = 0.05;

/// Weights along a line of four samples.
const OUTER: f32 = -1.0 / 16.0;
const INNER: f32 = 9.0 / 16.0;

/// Whether a pixel is a sample, from which others are interpolated.
fn is_sample(row: usize, column: usize) -> bool {
    row.is_multiple_of(2) && column.is_multiple_of(2)
}

/// Whether a pixel gets a sight to check the interpolation by: one other pixel of each tile.
fn is_check([row, column]: [usize; 2]) -> bool {
    let tile = (row / CHECK_TILE).wrapping_mul(0x9E37_79B1) ^ (column / CHECK_TILE).wrapping_mul(0x85EB_CA77);
    let mixed = (tile ^ (tile >> 15)).wrapping_mul(0x2C1B_3C6D);
    // One of the 16 quarters of the tile, and one of its three pixels that are no samples.
    let (quarter, which) = (mixed >> 8 & 15, mixed >> 16 & 0xffff);
    let [down, right] = [[0, 1], [1, 0], [1, 1]][which % 3];
    row % CHECK_TILE == 2 * (quarter / 4) + down && column % CHECK_TILE == 2 * (quarter % 4) + right
}

/// Whether a pixel is seen first.
pub(super) fn is_first(at: [usize; 2]) -> bool {
    is_sample(at[0], at[1]) || is_check(at)
}

/// Values and errors of two images at the pixels that can be interpolated.
///
/// How far cubic and linear interpolation differ, smoothed over tiles since a pixel by itself may look smooth by chance,
/// says where errors are large; pixels that were seen say how large.
pub(super) fn estimates(
    [rows, columns]: [usize; 2],
    pixels: &[u32],
    stencils: &[Option<Stencil>],
    images: &[[f32; ROWS]],
) -> Vec<Option<[[f32; ROWS]; 2]>> {
    let mut found: Vec<Option<[[f32; ROWS]; 2]>> =
        stencils.par_iter().with_min_len(1024).map(|stencil| stencil.map(|s| s.estimate(images))).collect();
    let [down, across] = [rows.div_ceil(TILE), columns.div_ceil(TILE)];
    let raster = Raster::new(columns);
    let tile = |pixel: u32| {
        let [row, column] = raster.at(pixel);
        row / TILE * across + column / TILE
    };
    let mut tiles = vec![([0.0_f32; ROWS], 0.0_f32); down * across];
    for (&pixel, found) in pixels.iter().zip(&found) {
        if let Some([_, error]) = found {
            let (sum, count) = &mut tiles[tile(pixel)];
            for k in 0..ROWS {
                sum[k] += error[k] * error[k];
            }
            *count += 1.0;
        }
    }
    let smooth: Vec<[f32; ROWS]> = (0..down * across)
        .map(|t| {
            let (r, c) = (t / across, t % across);
            let (mut sum, mut count) = ([0.0_f32; ROWS], 0.0_f32);
            for r in r.saturating_sub(1)..(r + 2).min(down) {
                for c in c.saturating_sub(1)..(c + 2).min(across) {
                    let (s, n) = tiles[r * across + c];
                    sum = [0, 1].map(|k: usize| sum[k] + s[k]);
                    count += n;
                }
            }
            sum.map(|s| (s / count.max(1.0)).sqrt())
        })
        .collect();
    let smoothed = |pixel: u32, error: [f32; ROWS]| {
        let smooth = smooth[tile(pixel)];
        [0, 1].map(|k: usize| error[k].max(smooth[k]))
    };
    let mut checks = [const { Vec::<[f32; 2]>::new() }; ROWS];
    let checked = pixels.iter().zip(&found).filter(|&(&pixel, _)| is_check(raster.at(pixel)));
    for (&pixel, found) in checked {
        let Some([value, error]) = found else { continue };
        let error = smoothed(pixel, *error);
        for k in 0..ROWS {
            checks[k].push([error[k], images[pixel as usize][k] - value[k]]);
        }
    }
    let scales = checks.map(Scale::new);
    found.par_iter_mut().zip(pixels).with_min_len(1024).for_each(|(found, &pixel)| {
        if let Some([_, error]) = found {
            let smooth = smoothed(pixel, *error);
            *error = [0, 1].map(|k: usize| scales[k].error(smooth[k]));
        }
    });
    found
}

/// From how far two interpolations differ to the error of the better one: rms errors of the checks, class by class.
struct Scale {
    /// Mean difference and rms error of each class, both rising.
    classes: Vec<[f32; 2]>,
}

impl Scale {
    /// From differences and errors of the checks.
    fn new(mut checks: Vec<[f32; 2]>) -> Self {
        checks.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let size = (checks.len() / CLASSES_MAX).max(CLASS_MIN);
        let mut classes: Vec<[f32; 2]> = Vec::new();
        let mut least = 0.0;
        // So few checks that they make no class tell nothing.
        for class in checks.chunks_exact(size) {
            let n = narrow(real(class.len()));
            let difference = class.iter().map(|c| c[0]).sum::<f32>() / n;
            let error = (class.iter().map(|c| c[1] * c[1]).sum::<f32>() / n).sqrt();
            // A class that did better than one of smaller differences was lucky.
            least = error.max(least);
            classes.push([difference, least]);
        }
        Self { classes }
    }

    /// The error that goes with a difference; infinite without any checks.
    fn error(&self, difference: f32) -> f32 {
        let classes = &self.classes;
        let Some([most, worst]) = classes.last() else { return f32::INFINITY };
        let above = classes.partition_point(|c| c[0] < difference);
        if above == 0 {
            classes[0][1]
        } else if above == classes.len() {
            // Beyond all checks: in proportion.
            if *most > 0.0 { worst * (difference / most) } else { f32::INFINITY }
        } else {
            let ([d0, e0], [d1, e1]) = (classes[above - 1], classes[above]);
            e0 + (e1 - e0) * ((difference - d0) / (d1 - d0))
        }
    }
}

/// Where a pixel gets its value from: four samples along each of one or two lines.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stencil {
    pixel: u32,
    /// From the pixel to the next sample along each line; the same where there is one line.
    steps: [u32; 2],
}

impl Stencil {
    /// The samples about a pixel that is none; nothing near the edges of the image.
    pub(super) fn new(raster: Raster, [rows, columns]: [usize; 2], pixel: u32) -> Option<Self> {
        let wide = u32::try_from(columns).ok()?;
        let [row, column] = raster.at(pixel);
        let (across, along) = (!column.is_multiple_of(2), !row.is_multiple_of(2));
        let fits = |i: usize, n: usize| i >= 3 && i + 3 < n;
        if (!across && !along) || (across && !fits(column, columns)) || (along && !fits(row, rows)) {
            return None;
        }
        let steps = match (across, along) {
            (true, true) => [wide + 1, wide - 1],
            (true, false) => [1, 1],
            _ => [wide, wide],
        };
        Some(Self { pixel, steps })
    }

    fn line(self, step: u32) -> [usize; 4] {
        [self.pixel - 3 * step, self.pixel - step, self.pixel + step, self.pixel + 3 * step]
            .map(|p| p as usize)
    }

    /// The pixels that it takes values from, with their weights.
    pub(super) fn terms(self) -> impl Iterator<Item = (usize, f32)> {
        let [one, other] = self.steps;
        let (lines, share) = if one == other { (1, 1.0) } else { (2, 0.5) };
        self.steps.into_iter().take(lines).flat_map(move |step| {
            self.line(step).into_iter().zip([OUTER, INNER, INNER, OUTER].map(|w| share * w))
        })
    }

    /// Value of two images at the pixel, and how far it is from a linear interpolation.
    #[inline]
    fn estimate(self, images: &[[f32; ROWS]]) -> [[f32; ROWS]; 2] {
        let one = Line::new(self.line(self.steps[0]).map(|p| images[p]));
        let other = if self.steps[0] == self.steps[1] {
            one
        } else {
            Line::new(self.line(self.steps[1]).map(|p| images[p]))
        };
        let (mut value, mut error) = ([0.0; ROWS], [0.0; ROWS]);
        for k in 0..ROWS {
            value[k] = 0.5 * (one.cubic[k] + other.cubic[k]);
            error[k] = larger(one.bent[k], other.bent[k])
                + 0.5 * (one.cubic[k] - other.cubic[k]).abs()
                + STEEP * larger(one.steep[k], other.steep[k]);
        }
        [value, error]
    }
}

/// Two images along four samples.
#[derive(Clone, Copy)]
struct Line {
    /// Value in the middle, how far it is from a linear interpolation, and the largest step between samples.
    cubic: [f32; ROWS],
    bent: [f32; ROWS],
    steep: [f32; ROWS],
}

impl Line {
    #[inline(always)]
    fn new([a, b, c, d]: [[f32; ROWS]; 4]) -> Self {
        let mut line = Self { cubic: [0.0; ROWS], bent: [0.0; ROWS], steep: [0.0; ROWS] };
        for k in 0..ROWS {
            line.cubic[k] = INNER * (b[k] + c[k]) + OUTER * (a[k] + d[k]);
            line.bent[k] = (line.cubic[k] - 0.5 * (b[k] + c[k])).abs();
            line.steep[k] = larger(larger((a[k] - b[k]).abs(), (c[k] - d[k]).abs()), (b[k] - c[k]).abs());
        }
        line
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubics_are_exact() {
        let (rows, columns) = (30, 40);
        let image = |f: &dyn Fn(f32, f32) -> f32| -> Vec<[f32; ROWS]> {
            #[expect(clippy::cast_precision_loss, reason = "small numbers")]
            let value = |i: usize| f((i / columns) as f32, (i % columns) as f32);
            (0..rows * columns).map(|i| [value(i), 1.0]).collect()
        };
        let smooth =
            image(&|r, c| 0.3 + 0.02 * r - 0.01 * c + 1e-3 * (r - 8.0) * (c - 9.0) - 1e-4 * c * c * c);
        let mut inside = 0;
        for pixel in 0..rows * columns {
            let Some(stencil) =
                Stencil::new(Raster::new(columns), [rows, columns], u32::try_from(pixel).unwrap())
            else {
                continue;
            };
            assert!(stencil.terms().all(|(p, _)| is_sample(p / columns, p % columns)));
            let sum: f32 = stencil.terms().map(|(_, w)| w).sum();
            assert!((sum - 1.0).abs() < 1e-6);
            let [value, error] = stencil.estimate(&smooth);
            // Along a diagonal r·c is quadratic, so its two lines agree in the middle.
            assert!((value[0] - smooth[pixel][0]).abs() < 2e-6, "{pixel}");
            assert!((value[1] - 1.0).abs() < 1e-6 && error[1] < 1e-6);
            inside += 1;
        }
        assert!(inside > rows * columns / 3);
    }

    #[test]
    fn errors_are_those_of_the_pixels_that_nobody_saw() {
        let (rows, columns) = (240, 320);
        // Kinks along slanted lines, rare on the left and dense on the right, and a part without any.
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        let value = |i: usize| {
            let (r, c) = ((i / columns) as f32, (i % columns) as f32);
            let wide = if c < 160.0 { 23.0 } else { 7.0 };
            let phase = (c - 0.31 * r).rem_euclid(wide);
            if r < 60.0 { 0.5 } else { 0.01 * phase.min(wide - phase) }
        };
        let images: Vec<[f32; ROWS]> = (0..rows * columns).map(|i| [value(i), 0.0]).collect();
        let pixels: Vec<u32> = (0..).take(rows * columns).collect();
        let stencils: Vec<_> =
            pixels.iter().map(|&p| Stencil::new(Raster::new(columns), [rows, columns], p)).collect();
        let found = estimates([rows, columns], &pixels, &stencils, &images);
        // Over the left and the right part, and where nothing happens.
        for (part, low, high) in [(0, 0.7, 1.6), (1, 0.7, 1.6)] {
            let (mut square, mut declared) = (0.0_f64, 0.0_f64);
            for (i, found) in found.iter().enumerate() {
                let Some([value, error]) = found else { continue };
                if i / columns >= 70 && (i % columns) / 160 == part {
                    square += f64::from(value[0] - images[i][0]).powi(2);
                    declared += f64::from(error[0]).powi(2);
                }
            }
            let ratio = (declared / square).sqrt();
            assert!((low..high).contains(&ratio), "{part}: {ratio}");
        }
        let calm = found[30 * columns + 41].unwrap();
        assert!((calm[0][0] - 0.5).abs() < 1e-6 && calm[1][0] < 1e-3, "{calm:?}");
    }
}
