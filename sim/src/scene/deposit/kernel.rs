//! The kernel that spreads a parcel, a quadratic B-spline along each axis, and the cells it reaches.
//!
//! 20 000 parcels stand for 7 million droplets; put into 1 mm cells as they are they make speckle, not a spray. How wide
//! kernels are is decided elsewhere (`widths`).

use super::super::field::Grid;

/// Shares below this part of a parcel's largest are left to the others: they would double the memory for 1 % of the
/// droplets.
const SHARE_MIN: f64 = 2e-3;

/// Integral of the quadratic B-spline of width 1 from −∞ to `x`; it is 0 below −3/2 and 1 above 3/2.
pub(super) fn spline_integral(x: f64) -> f64 {
    let a = x.abs();
    let above = if a >= 1.5 {
        0.0
    } else if a >= 0.5 {
        let rest = 1.5 - a;
        rest * rest * rest / 6.0
    } else {
        0.5 - (0.75 * a - a * a * a / 3.0)
    };
    if x > 0.0 { 1.0 - above } else { above }
}

/// The spline itself, width 1.
pub(super) fn spline(x: f64) -> f64 {
    let a = x.abs();
    if a >= 1.5 {
        0.0
    } else if a >= 0.5 {
        0.5 * (1.5 - a) * (1.5 - a)
    } else {
        0.75 - a * a
    }
}

/// The cells that a parcel goes to, and the share each gets; the shares sum to 1.
///
/// `open` tells which cells are gas; what would go beyond the grid or into a wall goes to the others in
/// proportion. A parcel with no open cell in reach goes to the cell it lies in.
pub(super) fn shares(
    grid: &Grid,
    position_m: [f64; 3],
    width_m: f64,
    open: &(dyn Fn(usize) -> bool + Sync),
) -> Vec<(u32, f64)> {
    let mut along: [(usize, Vec<f64>); 3] = Default::default();
    for (a, (first, shares)) in along.iter_mut().enumerate() {
        *first = stretch(grid, a, position_m[a], width_m, shares);
    }
    let largest: f64 = along.iter().map(|a| a.1.iter().copied().fold(0.0, f64::max)).product();
    let mut shares = Vec::new();
    let mut sum = 0.0;
    for (x, share_x) in along[0].1.iter().enumerate() {
        for (y, share_y) in along[1].1.iter().enumerate() {
            for (z, share_z) in along[2].1.iter().enumerate() {
                let share = share_x * share_y * share_z;
                if share < SHARE_MIN * largest {
                    continue;
                }
                let cell = grid.linear([along[0].0 + x, along[1].0 + y, along[2].0 + z]);
                if open(cell) {
                    sum += share;
                    shares.push((narrow(cell), share));
                }
            }
        }
    }
    if shares.is_empty() {
        let cell_m = grid.cell_m();
        let own =
            std::array::from_fn(|a| index((position_m[a] - grid.lower_m[a]) / cell_m[a], grid.cells[a]));
        return vec![(narrow(grid.linear(own)), 1.0)];
    }
    for share in &mut shares {
        share.1 /= sum;
    }
    shares
}

/// The first cell along an axis that a kernel reaches; fills `shares` with those of it and the cells after it.
pub(super) fn stretch(
    grid: &Grid,
    axis: usize,
    position_m: f64,
    width_m: f64,
    shares: &mut Vec<f64>,
) -> usize {
    let cell_m = grid.cell_m()[axis];
    let place = (position_m - grid.lower_m[axis]) / cell_m;
    line(place, width_m / cell_m, grid.cells[axis], shares)
}

/// The first of `count` cells of edge 1 that a kernel about a place reaches; fills `shares` with those of it and the cells
/// after it.
pub(super) fn line(place: f64, width: f64, count: usize, shares: &mut Vec<f64>) -> usize {
    let first = index(place - 1.5 * width, count);
    let last = index(place + 1.5 * width, count);
    let per_width = 1.0 / width;
    let edge = |i: usize| spline_integral((i as f64 - place) * per_width);
    shares.clear();
    let mut below = edge(first);
    shares.extend((first..=last).map(|i| {
        let above = edge(i + 1);
        above - std::mem::replace(&mut below, above)
    }));
    first
}

/// The cell that holds a place given in cells from the lower end, at most `count − 1`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the value is clamped to 0 … count"
)]
pub(super) fn index(place: f64, count: usize) -> usize {
    (place.floor().clamp(0.0, count as f64) as usize).min(count - 1)
}

pub(super) fn narrow(cell: usize) -> u32 {
    u32::try_from(cell).expect("the grid was checked to have fewer than 2³² cells")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_integral_belongs_to_the_spline() {
        assert!(spline_integral(-1.5).abs() < 1e-16 && (spline_integral(1.5) - 1.0).abs() < 1e-16);
        assert!((spline_integral(0.0) - 0.5).abs() < 1e-16);
        for i in -20..=20 {
            let x = f64::from(i) * 0.08 + 0.003;
            let slope = (spline_integral(x + 1e-5) - spline_integral(x - 1e-5)) / 2e-5;
            assert!((slope - spline(x)).abs() < 1e-8, "{x}");
        }
    }

    #[test]
    fn shares_sum_to_one_at_walls_and_inside() {
        let grid = Grid { lower_m: [0.0; 3], upper_m: [0.01; 3], cells: [10; 3] };
        for position in [[0.005, 0.004, 0.003], [0.0, 0.01, 0.0], [0.0099, 0.0001, 0.005]] {
            for width in [0.0002, 0.001, 0.004] {
                let shares = shares(&grid, position, width, &|cell| cell % 10 != 7);
                let sum: f64 = shares.iter().map(|s| s.1).sum();
                assert!((sum - 1.0).abs() < 1e-14, "{position:?} {width}: {sum}");
                assert!(shares.iter().all(|s| s.0 % 10 != 7));
            }
        }
    }
}
