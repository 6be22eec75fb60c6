//! How wide a kernel each parcel needs, so that the local density rests on many parcels.
//!
//! Parcels in one small cube are looked at as one *cluster*: their areas a summed, and the squares of them, in the
//! middle of their areas. A cluster of one is the parcel itself, so that clouds of few parcels are looked at one by one.
//! Cubes have a third to a sixth of the width of the kernel that looks at them, so that no kernel reaches more than 20³ of
//! them however many parcels there are, and the search takes a time that goes with the number of parcels.
//!
//! The price: the parcels of a cluster are seen, and look around, from its middle, at most h = w/3 away along each axis
//! and h/√12 in the mean. Where the density is even that changes nothing; where it falls to a half within one width, N_eff
//! of a parcel may be off by a tenth, to both sides alike. What N_eff parcels leave uncertain is more, 1/√N_eff or 18 % for
//! 30 of them.

use super::super::field::Parcel;
use super::kernel::{index, narrow, spline};
use rayon::prelude::*;

/// Steps by which the width grows, and their factor.
const STEPS: usize = 12;
const FACTOR: f64 = 1.2;

/// Cubes along the narrowest kernel that looks at them; along the widest there are twice as many.
const CUBES: f64 = 3.0;

/// Rows of cubes at most (64 MB): wider clouds, above 1 m for kernels of 1 mm, get larger cubes. No grid holds those.
const ROWS_MAX: f64 = 16_777_216.0;

/// Cubes in a row at most.
const ROW_MAX: usize = 1 << 31;

/// Clusters that a task looks from at least.
const TASK_MIN: usize = 64;

/// Width of a kernel in metres, and the N_eff reached there.
pub(super) type Found = (f64, f64);

/// Finds kernels for a cloud.
pub(super) struct Widths {
    /// The first for kernels up to twice the narrowest, the next up to four times …; none without parcels.
    levels: Vec<Level>,
    /// Parcels sorted by the clusters of the first level, and where each cluster begins; one entry more than clusters.
    order: Vec<u32>,
    start: Vec<u32>,
    min_m: f64,
    max_m: f64,
}

impl Widths {
    /// Kernels between two widths, for parcels whose places are finite.
    pub(super) fn new(parcels: &[Parcel], min_m: f64, max_m: f64) -> Self {
        let mut widths = Self { levels: Vec::new(), order: Vec::new(), start: vec![0], min_m, max_m };
        if parcels.is_empty() {
            return widths;
        }
        let cubes = Cubes::around(parcels, min_m / CUBES);
        let mut keyed: Vec<(u64, u32)> =
            parcels.par_iter().enumerate().map(|(i, p)| (cubes.key(p.position_m), narrow(i))).collect();
        keyed.par_sort_unstable();
        widths.order = keyed.iter().map(|k| k.1).collect();
        // N_eff knows no unit, and squares of areas in the largest of them neither vanish nor overflow.
        let area = |parcel: &Parcel| parcel.area_m2().min(f64::MAX);
        let largest = parcels.iter().map(area).fold(f64::MIN_POSITIVE, f64::max);
        let mut clusters = Vec::new();
        for group in keyed.chunk_by(|a, b| a.0 == b.0) {
            widths.start.push(widths.start[clusters.len()] + narrow(group.len()));
            let singles = group.iter().map(|k| &parcels[k.1 as usize]);
            let singles = singles.map(|parcel| Cluster::single(parcel.position_m, area(parcel) / largest));
            clusters.push((group[0].0, Cluster::merged(singles)));
        }
        drop(keyed);
        let widest = max_m.min(min_m * FACTOR.powf(STEPS as f64));
        let mut level = Level::new(cubes, clusters);
        let mut below_m = 2.0 * min_m;
        while below_m <= widest {
            let coarser = level.coarser();
            widths.levels.push(std::mem::replace(&mut level, coarser));
            below_m *= 2.0;
        }
        widths.levels.push(level);
        widths
    }

    /// Width of each cluster's spline in metres, and the N_eff = (Σ a K)² / Σ (a K)² reached there, a the droplet area.
    ///
    /// The smallest width of min · 1.2^k, at most max, that reaches `n_eff`; `before`, empty or found for a smaller
    /// N_eff, is where the search goes on.
    pub(super) fn find(&self, n_eff: f64, before: &[Found]) -> Vec<Found> {
        let Some(finest) = self.levels.first() else { return Vec::new() };
        let clusters = finest.clusters.par_iter().enumerate().with_min_len(TASK_MIN);
        clusters
            .map(|(i, cluster)| {
                let n_eff_at = |width_m: f64| self.n_eff(cluster.place_m, width_m);
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
            .collect()
    }

    /// What was found for the clusters, parcel by parcel.
    pub(super) fn of_parcels(&self, found: &[Found]) -> Vec<Found> {
        let mut widths = vec![(0.0, 0.0); self.order.len()];
        for (ends, found) in self.start.windows(2).zip(found) {
            for &parcel in &self.order[ends[0] as usize..ends[1] as usize] {
                widths[parcel as usize] = *found;
            }
        }
        widths
    }

    fn n_eff(&self, place_m: [f64; 3], width_m: f64) -> f64 {
        let mut below_m = 2.0 * self.min_m;
        let mut level = 0;
        while level + 1 < self.levels.len() && below_m <= width_m {
            level += 1;
            below_m *= 2.0;
        }
        self.levels[level].n_eff(place_m, width_m)
    }
}

/// Cubes in rows: a cube's key is its row, then its number in the row.
#[derive(Clone, Copy)]
struct Cubes {
    /// The axes of the row number, the last one fastest, and the axis along which rows run: the longest.
    axes: [usize; 3],
    lower_m: [f64; 3],
    edge_m: f64,
    /// Cubes along each of `axes`.
    count: [usize; 3],
}

impl Cubes {
    /// Cubes of this edge, or larger ones if that makes too many rows.
    fn around(parcels: &[Parcel], edge_m: f64) -> Self {
        let mut lower = [f64::INFINITY; 3];
        let mut upper = [f64::NEG_INFINITY; 3];
        for parcel in parcels {
            for a in 0..3 {
                lower[a] = lower[a].min(parcel.position_m[a]);
                upper[a] = upper[a].max(parcel.position_m[a]);
            }
        }
        let mut axes = [0, 1, 2];
        axes.sort_by(|&a, &b| (upper[a] - lower[a]).total_cmp(&(upper[b] - lower[b])));
        let span = axes.map(|a| upper[a] - lower[a]);
        let rows = |edge_m: f64| (1.0 + span[0] / edge_m) * (1.0 + span[1] / edge_m);
        let mut edge_m = edge_m.max(span[2] / (ROW_MAX - 1) as f64);
        // Places are finite, so that this ends after at most 2100 doublings.
        while rows(edge_m) > ROWS_MAX {
            edge_m *= 2.0;
        }
        let count = span.map(|span| 1 + index(span / edge_m, ROW_MAX));
        Self { axes, lower_m: axes.map(|a| lower[a]), edge_m, count }
    }

    /// Number along the `i`-th of the axes of the cube that a place lies in, or the nearest one.
    fn number(&self, i: usize, place_m: f64) -> usize {
        index((place_m - self.lower_m[i]) / self.edge_m, self.count[i])
    }

    fn key(&self, place_m: [f64; 3]) -> u64 {
        let [x, y, z] = std::array::from_fn(|i| self.number(i, place_m[self.axes[i]]));
        (((x * self.count[1] + y) as u64) << 32) | z as u64
    }

    /// Twice as large, and what a key becomes.
    fn coarser(&self) -> (Self, impl Fn(u64) -> u64) {
        let count = self.count.map(|n| n.div_ceil(2));
        let (across, new_across) = (self.count[1] as u64, count[1] as u64);
        let key = move |key: u64| {
            let (row, z) = (key >> 32, key & u64::from(u32::MAX));
            ((row / across / 2 * new_across + row % across / 2) << 32) | (z / 2)
        };
        (Self { edge_m: 2.0 * self.edge_m, count, ..*self }, key)
    }
}

/// Parcels that are looked at as one.
#[derive(Debug, Clone, Copy)]
struct Cluster {
    /// Middle of the areas; of the places, if there is no area.
    place_m: [f64; 3],
    /// Σ a and Σ a², in units of the largest area and its square.
    area: f64,
    square: f64,
}

impl Cluster {
    fn single(place_m: [f64; 3], area: f64) -> Self {
        Self { place_m, area, square: area * area }
    }

    /// One of several, at least one.
    fn merged(several: impl Iterator<Item = Self> + Clone) -> Self {
        let (mut area, mut square, mut count) = (0.0, 0.0, 0.0);
        for one in several.clone() {
            area += one.area;
            square += one.square;
            count += 1.0;
        }
        let mut place_m = [0.0; 3];
        for one in several {
            let share = if area > 0.0 { one.area / area } else { 1.0 / count };
            for (sum, place) in place_m.iter_mut().zip(one.place_m) {
                *sum += share * place;
            }
        }
        Self { place_m, area, square }
    }
}

/// A cloud as clusters of one size.
struct Level {
    cubes: Cubes,
    /// Sorted by key, and those keys.
    clusters: Vec<Cluster>,
    keys: Vec<u64>,
    /// Their places along the rows, ascending in each row.
    along_m: Vec<f64>,
    /// Where each row begins; one entry more than rows.
    rows: Vec<u32>,
}

impl Level {
    fn new(cubes: Cubes, keyed: Vec<(u64, Cluster)>) -> Self {
        let (keys, clusters): (Vec<u64>, Vec<Cluster>) = keyed.into_iter().unzip();
        let mut rows = vec![0_u32; cubes.count[0] * cubes.count[1] + 1];
        let mut row = 0;
        for (i, key) in keys.iter().enumerate() {
            let own = index((key >> 32) as f64, rows.len());
            rows[row + 1..=own].fill(narrow(i));
            row = own.max(row);
        }
        rows[row + 1..].fill(narrow(keys.len()));
        let along_m = clusters.iter().map(|c| c.place_m[cubes.axes[2]]).collect();
        Self { cubes, clusters, keys, along_m, rows }
    }

    fn coarser(&self) -> Self {
        let (cubes, key) = self.cubes.coarser();
        let mut keyed: Vec<(u64, u32)> =
            self.keys.iter().enumerate().map(|(i, &k)| (key(k), narrow(i))).collect();
        keyed.par_sort_unstable();
        let group = |group: &[(u64, u32)]| {
            (group[0].0, Cluster::merged(group.iter().map(|k| self.clusters[k.1 as usize])))
        };
        Self::new(cubes, keyed.chunk_by(|a, b| a.0 == b.0).map(group).collect())
    }

    /// N_eff at a place; 0 where no droplet is in reach.
    fn n_eff(&self, place_m: [f64; 3], width_m: f64) -> f64 {
        let Cubes { axes, count, .. } = self.cubes;
        let reach = 1.5 * width_m;
        let [from, to] = [-reach, reach].map(|reach| {
            let number = |i: usize| self.cubes.number(i, place_m[axes[i]] + reach);
            [number(0), number(1)]
        });
        let along = axes[2];
        let [low, high] = [place_m[along] - reach, place_m[along] + reach];
        let per_width = 1.0 / width_m;
        let (mut sum, mut squares) = (0.0, 0.0);
        for x in from[0]..=to[0] {
            let rows = &self.rows[x * count[1] + from[1]..=x * count[1] + to[1] + 1];
            for ends in rows.windows(2).filter(|ends| ends[0] < ends[1]) {
                let row = ends[0] as usize..ends[1] as usize;
                let first = row.start + self.along_m[row.clone()].partition_point(|&z| z <= low);
                let within = self.along_m[first..row.end].iter().zip(&self.clusters[first..row.end]);
                for (_, cluster) in within.take_while(|(z, _)| **z < high) {
                    let at: [f64; 3] =
                        std::array::from_fn(|a| spline((cluster.place_m[a] - place_m[a]) * per_width));
                    let weight = at[0] * at[1] * at[2];
                    sum += weight * cluster.area;
                    squares += weight * weight * cluster.square;
                }
            }
        }
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIN_M: f64 = 1e-3;

    /// Uniform in 0 … 1: SplitMix64 (Steele, Lea, Flood 2014).
    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = *state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn parcel(position_m: [f64; 3], droplets: f64) -> Parcel {
        Parcel { position_m, diameter_m: 1e-5, temperature_k: 380.0, droplets }
    }

    /// Parcels of very different weights, dense about the origin and thin towards 10 mm: r goes with the `power` of a uniform
    /// number.
    fn cloud(count: usize, power: f64) -> Vec<Parcel> {
        let mut state = 5;
        let mut draw = move || random(&mut state);
        let place = |_: usize, draw: &mut dyn FnMut() -> f64| {
            let direction: [f64; 3] = std::array::from_fn(|_| 2.0 * draw() - 1.0);
            let radius = 0.01 * draw().powf(power);
            direction.map(|d| radius * d)
        };
        (0..count).map(|i| parcel(place(i, &mut draw), 10.0 / (0.02 + draw()))).collect()
    }

    /// (Σ a K)² / Σ (a K)² over all parcels, one by one.
    fn brute(parcels: &[Parcel], place_m: [f64; 3], width_m: f64) -> f64 {
        let weights = parcels.iter().map(|p| {
            let at = |a: usize| spline((p.position_m[a] - place_m[a]) / width_m);
            p.area_m2() * at(0) * at(1) * at(2)
        });
        let (sum, squares) = weights.fold((0.0, 0.0), |(s, q), w| (s + w, q + w * w));
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }

    fn search(parcels: &[Parcel], n_eff: f64) -> Vec<Found> {
        let widths = Widths::new(parcels, MIN_M, 4.0 * MIN_M);
        widths.of_parcels(&widths.find(n_eff, &[]))
    }

    #[test]
    fn widths_grow_until_enough_parcels_are_inside() {
        // A lattice of equal parcels 0.5 mm apart: N_eff = n w³ / 0.55³ with n = 8 per mm³.
        let place = |i: i32| [i / 400, i / 20 % 20, i % 20].map(|v| f64::from(v) * 0.5e-3);
        let parcels: Vec<Parcel> = (0..20_i32.pow(3)).map(|i| parcel(place(i), 100.0)).collect();
        let widths = Widths::new(&parcels, 0.5e-3, 5e-3);
        let middle = 10 * 400 + 10 * 20 + 10;
        let (width, n_eff) = widths.of_parcels(&widths.find(30.0, &[]))[middle];
        assert!(n_eff >= 30.0);
        let expected = 8e9 * width.powi(3) / 0.55_f64.powi(3);
        assert!((n_eff / expected - 1.0).abs() < 0.1, "{n_eff} against {expected}");
    }

    #[test]
    fn clusters_find_what_all_parcels_one_by_one_find() {
        for (count, power) in [(300, 1.0), (3000, 0.4), (3000, 1.5), (6000, 2.2)] {
            let parcels = cloud(count, power);
            let found = search(&parcels, 30.0);
            let (mut bias, mut squares, mut wide) = (0.0, 0.0, 0);
            for (parcel, (width, reached)) in parcels.iter().zip(&found) {
                let error = reached / brute(&parcels, parcel.position_m, *width) - 1.0;
                bias += error / count as f64;
                squares += error * error / count as f64;
                assert!(*reached >= 30.0 || *width >= 4.0 * MIN_M);
                wide += usize::from(*width > 1.1 * MIN_M);
            }
            println!("{count} {power}: {bias:.1e} {:.1e}, {wide} wide", squares.sqrt());
            // Said at the top: a tenth for a parcel at a steep place, to both sides alike.
            assert!(bias.abs() < 0.02 && squares.sqrt() < 0.1, "{count} {power}: {bias} {}", squares.sqrt());
            assert!(power > 2.0 || wide > count / 4, "{count} {power}: {wide}");
        }
    }

    #[test]
    fn parcels_alone_in_their_cubes_are_looked_at_one_by_one() {
        // A warped lattice of 0.4 mm: no two in a cube of 1/3 mm, and kernels of the first level only.
        let warp = |v: f64| v * 0.4e-3 + 0.02e-3 * (5.0 * v).sin();
        let place = |i: i32| [i / 144, i / 12 % 12, i % 12].map(|v| warp(f64::from(v)));
        let parcels: Vec<Parcel> =
            (0..12_i32.pow(3)).map(|i| parcel(place(i), 1.0 + f64::from(i % 7))).collect();
        for (parcel, (width, reached)) in parcels.iter().zip(search(&parcels, 10.0)) {
            let expected = brute(&parcels, parcel.position_m, width);
            assert!(width < 2.0 * MIN_M && (reached / expected - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn clusters_hold_the_cloud_at_every_level() {
        let parcels = cloud(5000, 2.0);
        let widths = Widths::new(&parcels, MIN_M, 9.0 * MIN_M);
        assert_eq!(widths.levels.len(), 4);
        let largest = parcels.iter().map(Parcel::area_m2).fold(0.0, f64::max);
        let sum = |value: &dyn Fn(&Parcel) -> f64| parcels.iter().map(value).sum::<f64>();
        for level in &widths.levels {
            let of = |value: &dyn Fn(&Cluster) -> f64| level.clusters.iter().map(value).sum::<f64>();
            let area = |p: &Parcel| p.area_m2() / largest;
            assert!((of(&|c| c.area) / sum(&area) - 1.0).abs() < 1e-12);
            assert!((of(&|c| c.square) / sum(&|p| area(p).powi(2)) - 1.0).abs() < 1e-12);
            for a in 0..3 {
                let [moment, expected] =
                    [of(&|c| c.area * c.place_m[a]), sum(&|p| area(p) * p.position_m[a])];
                assert!((moment - expected).abs() < 1e-12 * sum(&|p| area(p) * p.position_m[a].abs()));
            }
            assert!(level.keys.windows(2).all(|k| k[0] < k[1]));
            assert_eq!(level.rows.last(), Some(&narrow(level.clusters.len())));
        }
        assert!(widths.levels.windows(2).all(|l| l[1].clusters.len() < l[0].clusters.len()));
    }

    #[test]
    fn however_many_parcels_a_kernel_sees_few_clusters() {
        // 30 parcels in each of 12³ cubes.
        let mut state = 3;
        let parcels: Vec<Parcel> =
            (0..51_840).map(|_| parcel(std::array::from_fn(|_| 4e-3 * random(&mut state)), 1.0)).collect();
        let widths = Widths::new(&parcels, MIN_M, 4.0 * MIN_M);
        assert!(widths.levels[0].clusters.len() <= 12_usize.pow(3));
        assert!(widths.levels[1].clusters.len() <= 6_usize.pow(3));
        let found = widths.find(30.0, &[]);
        // All find 1000 and more at once: n w³ / 0.55³, an eighth of it in a corner.
        assert!(found.iter().all(|f| f.0 <= MIN_M && f.1 > 500.0));
        let middle = found[found.len() / 2];
        assert!(middle.1 < 810.0e9 * MIN_M.powi(3) / 0.55_f64.powi(3) * 1.3, "{middle:?}");
    }

    #[test]
    fn nothing_one_and_many_at_one_place() {
        assert!(search(&[], 30.0).is_empty());
        let [(width, n_eff)] = search(&[parcel([1.0, -2.0, 3.0], 5.0)], 30.0)[..] else { panic!("one") };
        assert!((width - 4.0 * MIN_M).abs() < 1e-15 && (n_eff - 1.0).abs() < 1e-12);
        // 40 equal ones at one place are 40, and a heavy one among them makes (40 + 40)² / (40 + 40²).
        let mut parcels = vec![parcel([0.5; 3], 2.0); 40];
        assert!(search(&parcels, 30.0).iter().all(|f| (f.1 / 40.0 - 1.0).abs() < 1e-12 && f.0 <= MIN_M));
        parcels.push(parcel([0.5; 3], 80.0));
        assert!(search(&parcels, 30.0).iter().all(|f| (f.1 / (6400.0 / 1640.0) - 1.0).abs() < 1e-12));
    }

    #[test]
    fn weights_without_measure_do_no_harm() {
        // Areas of 1e-300, none at all, and one beyond all numbers.
        let tiny: Vec<Parcel> = cloud(500, 1.0).iter().map(|p| parcel(p.position_m, 1e-290)).collect();
        let usual: Vec<Parcel> = tiny.iter().map(|p| parcel(p.position_m, 1.0)).collect();
        for (a, b) in search(&tiny, 30.0).iter().zip(search(&usual, 30.0)) {
            assert!((a.0 / b.0 - 1.0).abs() < 1e-12 && (a.1 / b.1 - 1.0).abs() < 1e-9, "{a:?} {b:?}");
        }
        let none: Vec<Parcel> = tiny.iter().map(|p| parcel(p.position_m, 0.0)).collect();
        assert!(search(&none, 30.0).iter().all(|f| f.1.abs() < f64::MIN_POSITIVE && f.0 > 3.9 * MIN_M));
        let mut one = usual;
        one.push(Parcel { diameter_m: 1e200, ..parcel([0.0; 3], 1.0) });
        assert!(search(&one, 30.0).iter().all(|f| f.0.is_finite() && f.1.is_finite()));
    }

    #[test]
    fn a_parcel_far_away_makes_no_large_table() {
        let mut parcels = cloud(200, 1.0);
        parcels.push(parcel([1e9, -1e9, 0.0], 1.0));
        parcels.push(parcel([1e300, 0.0, -1e300], 1.0));
        let widths = Widths::new(&parcels, MIN_M, 4.0 * MIN_M);
        assert!(widths.levels[0].rows.len() < 17_000_000);
        let found = widths.of_parcels(&widths.find(30.0, &[]));
        assert!(found.len() == 202 && found.iter().all(|f| f.0.is_finite() && f.1.is_finite()));
    }

    #[test]
    fn going_on_from_a_search_is_searching_anew() {
        let parcels = cloud(2000, 1.0);
        let widths = Widths::new(&parcels, MIN_M, 4.0 * MIN_M);
        let first = widths.find(30.0, &[]);
        assert_eq!(widths.find(70.0, &first), widths.find(70.0, &[]));
    }

    #[test]
    fn any_number_of_threads_finds_the_same_bits() {
        let parcels = cloud(4000, 1.5);
        let [one, three] = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| search(&parcels, 30.0))
        });
        assert_eq!(one, three);
    }
}
