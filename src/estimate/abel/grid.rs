//! Where the axis is among the pixels, which radii there are, and how pixels become radii and radii pixels.
//!
//! Radii are (i + phase) pixels with phase 0 or ½, whichever is nearer to where the pixels are. An axis elsewhere than on a
//! pixel or half way between two shifts the pixels by a quarter at most: cubic interpolation, whose weights take part in
//! the variances.

use super::operators::radius;

/// An axis this near to a pixel or the middle of two, in pixels, is taken to be there.
pub(super) const SNAP: f64 = 1e-9;

/// A value made of pixels: their columns and weights.
pub(super) type Mix = Vec<(usize, f64)>;

/// The radii of one image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    pub(super) columns: usize,
    /// The axis, in columns.
    pub(super) centre: f64,
    pub(super) phase: f64,
    /// Radii.
    pub(super) n: usize,
    /// First column to the right of the axis, or on it, and radii on that side.
    pub(super) right: (usize, usize),
    /// The same to the left.
    pub(super) left: (usize, usize),
    /// Whether pixels are at radii.
    pub(super) plain: bool,
}

/// A half of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Left,
    Right,
}

impl Grid {
    /// The grid of `columns` ≥ 1 pixels about an axis at 0 ≤ `centre` ≤ columns − 1.
    pub(super) fn new(columns: usize, centre: f64) -> Self {
        let twice = (2.0 * centre).round();
        let plain = (2.0 * centre - twice).abs() <= 2.0 * SNAP;
        let centre = if plain { 0.5 * twice } else { centre };
        let phase = if (twice - 2.0 * (0.5 * twice).floor()).abs() < 0.5 { 0.0 } else { 0.5 };
        let last = radius(columns - 1, 0.0);
        // A quarter of a pixel at most is missing beyond the last one.
        let count = |room: f64| {
            let radii = (room - phase + 0.25 + SNAP).floor() + 1.0;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ..= columns")]
            let radii = radii.max(0.0) as usize;
            radii
        };
        let (to_right, to_left) = (count(last - centre), count(centre));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ..= columns")]
        let column = |at: f64| at.round().max(0.0) as usize;
        Self {
            columns,
            centre,
            phase,
            n: to_right.max(to_left).max(1),
            right: (column(centre + phase), to_right),
            left: (column(centre - phase), to_left),
            plain,
        }
    }

    /// Radii of a side.
    pub(super) fn count(&self, side: Side) -> usize {
        match side {
            Side::Left => self.left.1,
            Side::Right => self.right.1,
        }
    }

    /// The pixels of radius `i` on one side, for a plain grid one.
    pub(super) fn pixels(&self, side: Side, i: usize) -> Mix {
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        let at = self.centre + sign * radius(i, self.phase);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ..= columns")]
        if self.plain { vec![(at.round() as usize, 1.0)] } else { cubic(at, self.columns) }
    }

    /// Distance of a pixel from the axis, in pixels.
    pub(super) fn distance(&self, column: usize) -> f64 {
        (radius(column, 0.0) - self.centre).abs()
    }

    /// The radii that a pixel's value is made of. Beyond the last radius it is that one's.
    pub(super) fn radii(&self, column: usize) -> Mix {
        let at = self.distance(column) - self.phase;
        let last = radius(self.n - 1, 0.0);
        if self.plain || at >= last {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ..= columns")]
            return vec![(at.clamp(0.0, last).round() as usize, 1.0)];
        }
        // The profile goes on beyond the axis as its mirror image.
        let mirrored = if self.phase > 0.0 { 2 } else { 1 };
        let shift = radius(self.n, 0.0) + 2.0;
        let mut mix = Mix::new();
        for (index, weight) in cubic(at + shift, 2 * self.n + 2) {
            let own = self.n + 2;
            let radius = if index >= own { index - own } else { own - index - (mirrored - 1) };
            match mix.iter_mut().find(|(known, _)| *known == radius.min(self.n - 1)) {
                Some((_, sum)) => *sum += weight,
                None => mix.push((radius.min(self.n - 1), weight)),
            }
        }
        mix
    }
}

/// Lagrange's weights of the four points about `at` among 0 … count − 1, fewer where there are fewer.
fn cubic(at: f64, count: usize) -> Mix {
    let points = count.min(4);
    let first = (at.floor() - 1.0).clamp(0.0, radius(count - points, 0.0));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ..= count")]
    let first = first as usize;
    (first..first + points)
        .map(|j| {
            let others = (first..first + points).filter(|&k| k != j);
            let weight =
                others.map(|k| (at - radius(k, 0.0)) / (radius(j, 0.0) - radius(k, 0.0))).product::<f64>();
            (j, weight)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(mix: &Mix, f: impl Fn(usize) -> f64) -> f64 {
        mix.iter().map(|&(i, w)| w * f(i)).sum()
    }

    #[test]
    fn axes_on_and_between_pixels_need_no_interpolation() {
        let on = Grid::new(7, 3.0);
        assert_eq!((on.phase, on.n, on.right, on.left, on.plain), (0.0, 4, (3, 4), (3, 4), true));
        let between = Grid::new(8, 3.5);
        assert_eq!((between.phase, between.n, between.right, between.left), (0.5, 4, (4, 4), (3, 4)));
        let beside = Grid::new(8, 1.5);
        assert_eq!((beside.n, beside.right, beside.left), (6, (2, 6), (1, 2)));
        let edge = Grid::new(5, 0.0);
        assert_eq!((edge.n, edge.right.1, edge.left.1), (5, 5, 1));
        for columns in 1..4 {
            let grid = Grid::new(columns, 0.5 * radius(columns - 1, 0.0));
            assert_eq!(grid.n, columns.div_ceil(2));
        }
    }

    /// An even polynomial of the third degree at most between its mirrored points goes both ways without loss.
    #[test]
    fn other_axes_interpolate_to_the_third_degree() {
        for centre in [6.2, 6.45, 6.8, 3.1] {
            let grid = Grid::new(14, centre);
            let f = |r: f64| 3.0 + 0.5 * r * r;
            for side in [Side::Left, Side::Right] {
                for i in 0..grid.count(side) {
                    let got = value(&grid.pixels(side, i), |c| f(grid.distance(c)));
                    assert!((got - f(radius(i, grid.phase))).abs() < 1e-12, "{centre} {side:?} {i}");
                }
            }
            for column in 0..14 {
                let r = grid.distance(column);
                if r < radius(grid.n - 1, grid.phase) - 1.0 {
                    let got = value(&grid.radii(column), |i| f(radius(i, grid.phase)));
                    assert!((got - f(r)).abs() < 1e-12, "{centre} {column}: {got} {}", f(r));
                }
            }
        }
    }
}
