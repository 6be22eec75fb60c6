//! How widely each parcel is spread: a quadratic B-spline along each axis, wide enough that the local density
//! rests on many parcels.
//!
//! 20 000 parcels stand for 7 million droplets; put into 1 mm cells as they are they make speckle, not a spray.

use super::super::field::{Grid, Parcel};
use rayon::prelude::*;

/// Steps by which the width grows, and their factor.
const STEPS: usize = 12;
const FACTOR: f64 = 1.2;

/// Shares below this part of a parcel's largest are left to the others: they would double the memory for 1 % of the
/// droplets.
const SHARE_MIN: f64 = 2e-3;

/// Integral of the quadratic B-spline of width 1 from −∞ to `x`; it is 0 below −3/2 and 1 above 3/2.
pub(super) fn spline_integral(x: f64) -> f64 {
    let a = x.abs();
    let above = if a >= 1.5 {
        0.0
    } else if a >= 0.5 {
        (1.5 - a).powi(3) / 6.0
    } else {
        0.5 - (0.75 * a - a * a * a / 3.0)
    };
    if x > 0.0 { 1.0 - above } else { above }
}

/// The spline itself, width 1.
fn spline(x: f64) -> f64 {
    let a = x.abs();
    if a >= 1.5 {
        0.0
    } else if a >= 0.5 {
        0.5 * (1.5 - a) * (1.5 - a)
    } else {
        0.75 - a * a
    }
}

/// Neighbours looked at for one width of all parcels together, about 1 s of one core: of a denser cloud every second, third …
/// is. Clouds of 20 000 parcels are never that dense.
const LOOKS_MAX: usize = 1 << 29;

/// Neighbours looked at for one parcel at least, if there are so many.
const LOOKS_MIN: usize = 256;

/// Parcels for which bins have the edge of the narrowest kernel; for more or fewer their volume goes with one over the number,
/// between these edges.
const PARCELS_PER_EDGE: f64 = 131_072.0;
const EDGES: [f64; 2] = [0.5, 1.5];

/// Finds kernels for a cloud.
pub(super) struct Widths {
    bins: Bins,
    min_m: f64,
    max_m: f64,
    /// Neighbours looked at for one parcel.
    looks: usize,
}

impl Widths {
    /// Kernels between two widths.
    pub(super) fn new(parcels: &[Parcel], min_m: f64, max_m: f64) -> Self {
        let edge = (PARCELS_PER_EDGE / parcels.len().max(1) as f64).cbrt().clamp(EDGES[0], EDGES[1]);
        let bins = Bins::new(parcels, max_m.max(min_m).min(edge * min_m));
        Self { bins, min_m, max_m, looks: (LOOKS_MAX / parcels.len().max(1)).max(LOOKS_MIN) }
    }

    /// Width of each parcel's spline in metres, and the N_eff = (Σ a K)² / Σ (a K)² reached there, a the droplet area.
    ///
    /// The smallest width of min · 1.2^k, at most max, that reaches `n_eff`; `before`, empty or found for a smaller
    /// N_eff, is where the search goes on.
    pub(super) fn find(&self, parcels: &[Parcel], n_eff: f64, before: &[(f64, f64)]) -> Vec<(f64, f64)> {
        // Neighbours one after another, so that what they look at is at hand.
        let found: Vec<(f64, f64)> = self
            .bins
            .order
            .par_iter()
            .map(|&i| {
                let i = i as usize;
                let n_eff_at = |width: f64| self.bins.n_eff(parcels[i].position_m, width, self.looks);
                let (mut width, mut reached) =
                    before.get(i).copied().unwrap_or_else(|| (self.min_m, n_eff_at(self.min_m)));
                for _ in 0..STEPS {
                    if reached >= n_eff || width >= self.max_m {
                        break;
                    }
                    width = (width * FACTOR).min(self.max_m);
                    reached = n_eff_at(width);
                }
                (width, reached)
            })
            .collect();
        let mut widths = vec![(0.0, 0.0); parcels.len()];
        for (&i, found) in self.bins.order.iter().zip(found) {
            widths[i as usize] = found;
        }
        widths
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
    let width = width_m / cell_m;
    let first = index(place - 1.5 * width, grid.cells[axis]);
    let last = index(place + 1.5 * width, grid.cells[axis]);
    let edge = |i: usize| spline_integral((i as f64 - place) / width);
    shares.clear();
    shares.extend((first..=last).map(|i| edge(i + 1) - edge(i)));
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

/// Parcels sorted into cubes, for finding neighbours.
struct Bins {
    grid: Grid,
    start: Vec<u32>,
    /// Position and area, sorted by bin.
    parcels: Vec<([f64; 3], f64)>,
    /// Number of each of them in the cloud.
    order: Vec<u32>,
}

/// Bins along an axis at most; wider clouds get wider bins.
const BINS_MAX: usize = 128;

impl Bins {
    fn new(parcels: &[Parcel], size_m: f64) -> Self {
        if parcels.is_empty() {
            let grid = Grid { lower_m: [0.0; 3], upper_m: [1.0; 3], cells: [1; 3] };
            return Self { grid, start: vec![0; 2], parcels: Vec::new(), order: Vec::new() };
        }
        let mut lower_m = [f64::INFINITY; 3];
        let mut upper_m = [f64::NEG_INFINITY; 3];
        for parcel in parcels {
            for a in 0..3 {
                lower_m[a] = lower_m[a].min(parcel.position_m[a]);
                upper_m[a] = upper_m[a].max(parcel.position_m[a]);
            }
        }
        let mut cells = [1; 3];
        for a in 0..3 {
            let number = ((upper_m[a] - lower_m[a]) / size_m).ceil().clamp(1.0, BINS_MAX as f64);
            cells[a] = index(number, 1 + BINS_MAX);
            upper_m[a] = upper_m[a].max(lower_m[a] + number * size_m);
        }
        let grid = Grid { lower_m, upper_m, cells };
        let bin: Vec<usize> = parcels.iter().map(|p| grid.linear(bin_of(&grid, p.position_m))).collect();
        let mut start = vec![0_u32; grid.len() + 1];
        for &b in &bin {
            start[b + 1] += 1;
        }
        for b in 0..grid.len() {
            start[b + 1] += start[b];
        }
        let mut next = start.clone();
        let mut sorted = vec![([0.0; 3], 0.0); parcels.len()];
        let mut order = vec![0; parcels.len()];
        for (i, (parcel, &b)) in parcels.iter().zip(&bin).enumerate() {
            sorted[next[b] as usize] = (parcel.position_m, parcel.area_m2());
            order[next[b] as usize] = narrow(i);
            next[b] += 1;
        }
        Self { grid, start, parcels: sorted, order }
    }

    /// N_eff at a place. Of more than `looks` neighbours only every second, third … counts, for as many: both sums shrink
    /// alike, so that N_eff is as many times the sample's.
    fn n_eff(&self, position_m: [f64; 3], width_m: f64, looks: usize) -> f64 {
        let first = bin_of(&self.grid, position_m.map(|x| x - 1.5 * width_m));
        let last = bin_of(&self.grid, position_m.map(|x| x + 1.5 * width_m));
        let rows = || {
            (first[0]..=last[0]).flat_map(move |x| (first[1]..=last[1]).map(move |y| [x, y])).map(|[x, y]| {
                let ends = [first[2], last[2]].map(|z| self.grid.linear([x, y, z]));
                self.start[ends[0]] as usize..self.start[ends[1] + 1] as usize
            })
        };
        let every = rows().map(|row| row.len()).sum::<usize>().div_ceil(looks).max(1);
        let (mut sum, mut squares) = (0.0, 0.0);
        // How many of the next row come before the next one that is looked at.
        let mut skip = 0;
        for row in rows() {
            let length = row.len();
            for (place, area) in self.parcels[row].iter().skip(skip).step_by(every) {
                if (0..3).any(|a| (place[a] - position_m[a]).abs() >= 1.5 * width_m) {
                    continue;
                }
                let weight: f64 = (0..3).map(|a| spline((place[a] - position_m[a]) / width_m)).product();
                sum += weight * area;
                squares += (weight * area) * (weight * area);
            }
            skip = (skip + every - length % every) % every;
        }
        if squares > 0.0 { every as f64 * sum * sum / squares } else { 0.0 }
    }
}

fn bin_of(grid: &Grid, position_m: [f64; 3]) -> [usize; 3] {
    let cell_m = grid.cell_m();
    std::array::from_fn(|a| index((position_m[a] - grid.lower_m[a]) / cell_m[a], grid.cells[a]))
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

    #[test]
    fn widths_grow_until_enough_parcels_are_inside() {
        // A lattice of equal parcels 0.5 mm apart: N_eff = n w³ / 0.55³ with n = 8 per mm³.
        let mut parcels = Vec::new();
        for i in 0..20_i32.pow(3) {
            let at = [i / 400, i / 20 % 20, i % 20].map(|v| f64::from(v) * 0.5e-3);
            parcels.push(Parcel { position_m: at, diameter_m: 1e-5, temperature_k: 380.0, droplets: 100.0 });
        }
        let middle = 10 * 400 + 10 * 20 + 10;
        let (width, n_eff) = Widths::new(&parcels, 0.5e-3, 5e-3).find(&parcels, 30.0, &[])[middle];
        assert!(n_eff >= 30.0);
        let expected = 8e9 * width.powi(3) / 0.55_f64.powi(3);
        assert!((n_eff / expected - 1.0).abs() < 0.1, "{n_eff} against {expected}");
    }

    #[test]
    fn a_sample_of_the_neighbours_finds_the_same() {
        let mut parcels = Vec::new();
        for i in 0..40_i32.pow(3) {
            let at = [i / 1600, i / 40 % 40, i % 40].map(|v| f64::from(v) * 0.25e-3);
            let droplets = 100.0 + f64::from(i % 7);
            parcels.push(Parcel { position_m: at, diameter_m: 1e-5, temperature_k: 380.0, droplets });
        }
        let bins = Bins::new(&parcels, 1e-3);
        let [all, some] = [usize::MAX, 2000].map(|looks| bins.n_eff([5e-3; 3], 2e-3, looks));
        // 2000 of 13 824 parcels in bins of 24³: some 250 have weight.
        assert!((some / all - 1.0).abs() < 0.1, "{all} {some}");
    }
}
