//! Many parcels as few kinds of droplets: what a cell holds is then a short list, however many parcels there are.
//!
//! A list of every parcel in every cell it reaches would take 100 GB for ten million parcels. Parcels of about the same
//! diameter and temperature are one kind: the cells keep how many droplets of each kind they hold. Every parcel keeps
//! its place, its kernel and its area, shared between the two kinds whose temperatures enclose its own so that the mean is
//! its own; its diameter becomes that of its kind, whose number and area are the sums over its parcels. Knows nothing of gas.

use super::super::field::{Grid, Parcel};
use super::super::import::SceneError;
use super::kernel::{index, narrow, stretch};
use super::widths::Found;
use rayon::prelude::*;

/// Entries (a parcel or kind in a cell) of a field at most, 8 bytes each: where parcels would make more, kinds
/// take their place. A spray of 20 000 parcels has some 10⁷.
pub(super) const ENTRIES_MAX: f64 = 67_108_864.0;

/// Width of a kind in ln d, and distance of the temperatures of kinds in K, doubled until the entries fit, at most so often.
///
/// Within half a width of 0.04 a cross-section changes by at most 2 % (Q is between d⁰ and d¹), and evenly to both sides.
/// Between temperatures h apart a radiance is interpolated: off by at most h²/8 of its curvature, at 3.4 µm and 380 K
/// 0.2 % for 4 K.
const STEP_LN: f64 = 0.04;
const STEP_K: f64 = 4.0;
const DOUBLINGS_MAX: u32 = 2;

/// Entries that even the widest kinds may need: 4 GB, and as much again while they are sorted by cells.
const ENTRIES_LIMIT: f64 = 536_870_912.0;

/// Parts of the grid, along x, that are filled side by side.
const SLABS: usize = 16;

/// A deposit by kinds.
pub(super) struct Kinds {
    /// One parcel that stands for all droplets of a kind.
    pub(super) parcels: Vec<Parcel>,
    /// Per kind, the cells that hold it and how many droplets per m³, in ascending order of the cells.
    pub(super) lists: Vec<Vec<(u32, f32)>>,
    /// Relative difference of the droplets deposited and given, over all kinds the largest.
    pub(super) error: f64,
}

/// About how many entries the parcels make, one by one.
pub(super) fn entries(grid: &Grid, widths: &[Found]) -> f64 {
    widths.iter().map(|w| reach(grid, w.0)).sum()
}

/// Cells in reach of a kernel.
fn reach(grid: &Grid, width_m: f64) -> f64 {
    let cell_m = grid.cell_m();
    (0..3).map(|a| (1.0 + 3.0 * width_m / cell_m[a]).min(grid.cells[a] as f64)).product()
}

/// Spreads parcels, sorted into kinds. `open` tells which cells are gas, as for [`super::kernel::shares`].
///
/// # Errors
///
/// [`SceneError::Deposit`] if even few kinds would not fit into memory.
pub(super) fn spread(
    grid: &Grid,
    parcels: &[Parcel],
    widths: &[Found],
    open: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Kinds, SceneError> {
    let (parcels, widths) = arranged(grid, parcels, widths);
    let groups = sorted(grid, &parcels, &widths)?;
    let mask: Vec<bool> = (0..grid.len()).into_par_iter().map(open).collect();
    let mask = (!mask.par_iter().all(|open| *open)).then_some(mask);
    let job = Job { grid, mask: mask.as_deref(), rows: 0..grid.cells[0] };
    let scale: Vec<f64> = parcels
        .par_iter()
        .zip(&widths)
        .map_init(Stretches::default, |along, (parcel, width)| {
            job.open_share(along, parcel.position_m, width.0).recip()
        })
        .collect();
    let mut cells = vec![0.0_f64; grid.len()];
    let mut kinds = Kinds { parcels: Vec::new(), lists: Vec::new(), error: 0.0 };
    let (volume, plane) = (grid.cell_volume_m3(), grid.cells[1] * grid.cells[2]);
    let part = grid.cells[0].div_ceil(SLABS);
    let widest = widths.iter().fold(0.0, |widest: f64, w| widest.max(w.0));
    // A kernel reaches no row further from its own than so many.
    let reach = 1 + index(1.5 * widest / grid.cell_m()[0], grid.cells[0] + 1);
    for group in groups.chunk_by(|a, b| a.kind == b.kind) {
        let kind = mean(&parcels, group);
        let own = kind.area_m2() / kind.droplets;
        let lists: Vec<(f64, Vec<(u32, f32)>)> = cells
            .par_chunks_mut(part * plane)
            .enumerate()
            .map(|(slab, cells)| {
                let first = slab * part;
                let job = Job { rows: first..first + cells.len() / plane, ..job.clone() };
                let mut along = Stretches::default();
                let [from, to] = [first.saturating_sub(reach), job.rows.end + reach]
                    .map(|row| group.partition_point(|member| (member.row as usize) < row));
                for member in &group[from..to] {
                    let i = member.parcel as usize;
                    let droplets = member.share * parcels[i].area_m2() / own;
                    job.add(&mut along, parcels[i].position_m, widths[i].0, [droplets, scale[i]], cells);
                }
                drain(cells, first * plane, volume)
            })
            .collect();
        let found: f64 = lists.iter().map(|list| list.0).sum();
        kinds.error = kinds.error.max((found / kind.droplets - 1.0).abs());
        kinds.lists.push(lists.into_iter().flat_map(|list| list.1).collect());
        kinds.parcels.push(kind);
    }
    Ok(kinds)
}

/// Parcels and their kernels in the order in which kinds look them up: ten million at random places of memory would take
/// longer than all the rest.
fn arranged(grid: &Grid, parcels: &[Parcel], widths: &[Found]) -> (Vec<Parcel>, Vec<Found>) {
    let first = |(i, parcel)| split(grid, i, parcel, 1.0).next().map(|m| (m.kind, m.row, m.parcel));
    let mut order: Vec<_> = parcels.par_iter().enumerate().filter_map(first).collect();
    order.par_sort_unstable();
    order.par_iter().map(|key| (parcels[key.2 as usize], widths[key.2 as usize])).unzip()
}

/// A parcel as a member of a kind.
#[derive(Debug, Clone, Copy)]
struct Member {
    /// Numbers of the kind's diameter and temperature.
    kind: [i32; 2],
    /// Row of cells, along x, that the parcel lies in.
    row: u32,
    parcel: u32,
    /// Share of the parcel that belongs to the kind.
    share: f64,
    /// Temperature of the kind.
    temperature_k: f64,
}

/// The members of all kinds, kind by kind and row by row, with kinds as fine as [`ENTRIES_MAX`] allows.
fn sorted(grid: &Grid, parcels: &[Parcel], widths: &[Found]) -> Result<Vec<Member>, SceneError> {
    let mut doubling = 0;
    loop {
        let wide = f64::from(1 << doubling);
        let mut members: Vec<Member> = parcels
            .par_iter()
            .enumerate()
            .flat_map_iter(|(i, parcel)| split(grid, i, parcel, wide))
            .collect();
        members.par_sort_unstable_by_key(|member| (member.kind, member.row, member.parcel));
        let bound: f64 = members
            .chunk_by(|a, b| a.kind == b.kind)
            .map(|group| {
                let all: f64 = group.iter().map(|m| reach(grid, widths[m.parcel as usize].0)).sum();
                all.min(grid.len() as f64)
            })
            .sum();
        if bound <= ENTRIES_MAX || (doubling == DOUBLINGS_MAX && bound <= ENTRIES_LIMIT) {
            return Ok(members);
        }
        if doubling == DOUBLINGS_MAX {
            let why = format!("{} parcels reach cells {bound:.1e} times, even as few kinds", parcels.len());
            return Err(super::refuse(why, "Take larger cells or a smaller region"));
        }
        doubling += 1;
    }
}

/// The kinds of a parcel: one diameter, and the temperatures below and above its own.
#[expect(clippy::cast_possible_truncation, reason = "logarithms of doubles, and kelvins that saturate")]
fn split(grid: &Grid, parcel: usize, of: &Parcel, wide: f64) -> impl Iterator<Item = Member> {
    let row = narrow(index((of.position_m[0] - grid.lower_m[0]) / grid.cell_m()[0], grid.cells[0]));
    let size = (of.diameter_m.ln() / (STEP_LN * wide)).floor() as i32;
    let step_k = STEP_K * wide;
    let below = (of.temperature_k / step_k).floor();
    let above = of.temperature_k / step_k - below;
    // No kind has no temperature: below the first one all stays at it.
    let places =
        if below < 1.0 { [(1.0, 1.0), (1.0, 0.0)] } else { [(below, 1.0 - above), (below + 1.0, above)] };
    let member = move |(place, share): (f64, f64)| Member {
        kind: [size, place as i32],
        row,
        parcel: narrow(parcel),
        share,
        temperature_k: place * step_k,
    };
    places.into_iter().map(member).filter(|member| member.share > 0.0)
}

/// The parcel that stands for a group: its number and area are theirs.
fn mean(parcels: &[Parcel], group: &[Member]) -> Parcel {
    let sum = |value: &dyn Fn(&Parcel) -> f64| -> f64 {
        group.iter().map(|member| member.share * value(&parcels[member.parcel as usize])).sum()
    };
    let (droplets, area) = (sum(&|p| p.droplets), sum(&Parcel::area_m2));
    Parcel {
        position_m: std::array::from_fn(|a| sum(&|p| p.area_m2() * p.position_m[a]) / area),
        diameter_m: (area / (std::f64::consts::FRAC_PI_4 * droplets)).sqrt(),
        temperature_k: group[0].temperature_k,
        droplets,
    }
}

/// First cell and shares of a kernel along each axis.
type Stretches = [(usize, Vec<f64>); 3];

/// Rows of cells (along x) that are filled.
#[derive(Clone)]
struct Job<'a> {
    grid: &'a Grid,
    /// Which cells are gas; none where all are.
    mask: Option<&'a [bool]>,
    rows: std::ops::Range<usize>,
}

impl Job<'_> {
    /// Share of a kernel that lies in open cells of the grid; 0 where none is in reach.
    fn open_share(&self, along: &mut Stretches, position_m: [f64; 3], width_m: f64) -> f64 {
        self.stretch(along, position_m, width_m);
        match self.mask {
            None => along.iter().map(|a| a.1.iter().sum::<f64>()).product(),
            Some(mask) => {
                let mut sum = 0.0;
                self.lines(along, |line, share| {
                    let open = &mask[line..line + along[2].1.len()];
                    let inside = along[2].1.iter().zip(open).filter(|(_, open)| **open);
                    sum += share * inside.map(|(share, _)| share).sum::<f64>();
                });
                sum
            }
        }
    }

    /// Adds the droplets of a parcel, of which `scale` is the reciprocal of its open share, to `cells`, the cells of the
    /// rows. What has no open cell in reach goes to the cell it lies in.
    fn add(
        &self,
        along: &mut Stretches,
        position_m: [f64; 3],
        width_m: f64,
        [droplets, scale]: [f64; 2],
        cells: &mut [f64],
    ) {
        let grid = self.grid;
        let start = self.rows.start * grid.cells[1] * grid.cells[2];
        let cell_m = grid.cell_m();
        let place: [f64; 3] = std::array::from_fn(|a| (position_m[a] - grid.lower_m[a]) / cell_m[a]);
        if scale.is_infinite() {
            let own = std::array::from_fn(|a| index(place[a], grid.cells[a]));
            if self.rows.contains(&own[0]) {
                cells[grid.linear(own) - start] += droplets;
            }
            return;
        }
        let half = 1.5 * width_m / cell_m[0];
        let ends = [place[0] - half, place[0] + half].map(|end| index(end, grid.cells[0]));
        if ends[1] < self.rows.start || ends[0] >= self.rows.end {
            return;
        }
        self.stretch(along, position_m, width_m);
        self.lines(along, |line, share| {
            let own = droplets * scale * share;
            let range = line..line + along[2].1.len();
            let sums = &mut cells[range.start - start..range.end - start];
            match self.mask {
                None => sums.iter_mut().zip(&along[2].1).for_each(|(sum, share)| *sum += own * share),
                Some(mask) => {
                    for ((sum, share), open) in sums.iter_mut().zip(&along[2].1).zip(&mask[range]) {
                        if *open {
                            *sum += own * share;
                        }
                    }
                }
            }
        });
    }

    fn stretch(&self, along: &mut Stretches, position_m: [f64; 3], width_m: f64) {
        for (axis, (first, shares)) in along.iter_mut().enumerate() {
            *first = stretch(self.grid, axis, position_m[axis], width_m, shares);
        }
    }

    /// Calls for every line along z inside the rows: its first cell in reach, and the share of x and y.
    fn lines(&self, along: &Stretches, mut line: impl FnMut(usize, f64)) {
        let [(x_first, in_x), (y_first, in_y), (z_first, _)] = along;
        for (x, share_x) in (*x_first..).zip(in_x).filter(|(x, _)| self.rows.contains(x)) {
            for (y, share_y) in (*y_first..).zip(in_y) {
                line(self.grid.linear([x, y, *z_first]), share_x * share_y);
            }
        }
    }
}

/// Takes what is in the cells, leaving zeros: its sum, and a list by density, `first` being the number of the first.
fn drain(cells: &mut [f64], first: usize, volume_m3: f64) -> (f64, Vec<(u32, f32)>) {
    let mut sum = 0.0;
    let mut list = Vec::new();
    for (cell, droplets) in cells.iter_mut().enumerate().filter(|(_, droplets)| **droplets > 0.0) {
        sum += *droplets;
        #[expect(clippy::cast_possible_truncation, reason = "the field is kept in single precision")]
        list.push((narrow(first + cell), (*droplets / volume_m3) as f32));
        *droplets = 0.0;
    }
    (sum, list)
}

#[cfg(test)]
mod tests {
    use super::super::kernel::shares;
    use super::*;

    /// Parcels in a column of a box of 10 mm, of many sizes and temperatures.
    fn cloud(count: u32) -> Vec<Parcel> {
        let part = |i: u32, by: f64| (f64::from(i) * by).fract();
        (0..count)
            .map(|i| Parcel {
                position_m: [0.618_034, 0.754_878, 0.569_840].map(|by| 0.01 * part(i, by)),
                diameter_m: 4e-6 + 2e-5 * part(i, 0.819_173),
                temperature_k: 360.0 + 30.0 * part(i, 0.671_044),
                droplets: 1e3 + 1e3 * part(i, 0.549_700),
            })
            .collect()
    }

    #[test]
    fn kinds_hold_what_their_parcels_hold_cell_by_cell() {
        let grid = Grid { lower_m: [0.0; 3], upper_m: [0.01; 3], cells: [10; 3] };
        let open = |cell: usize| cell % 10 != 7;
        let parcels = cloud(4000);
        let widths = vec![(1e-3, 0.0); parcels.len()];
        let kinds = spread(&grid, &parcels, &widths, &open).unwrap();
        assert!(kinds.parcels.len() > 100 && kinds.parcels.len() < parcels.len(), "{}", kinds.parcels.len());
        assert!(kinds.error < 1e-12, "{}", kinds.error);
        let (mut area, mut warmth) = (vec![[0.0; 2]; grid.len()], vec![[0.0; 2]; grid.len()]);
        let mut put = |cell: u32, parcel: &Parcel, droplets: f64, way: usize| {
            let own = parcel.area_m2() / parcel.droplets * droplets;
            area[cell as usize][way] += own;
            warmth[cell as usize][way] += own * parcel.temperature_k;
        };
        for parcel in &parcels {
            for (cell, share) in shares(&grid, parcel.position_m, 1e-3, &open) {
                put(cell, parcel, share * parcel.droplets, 0);
            }
        }
        for (kind, list) in kinds.parcels.iter().zip(&kinds.lists) {
            assert!(list.windows(2).all(|w| w[0].0 < w[1].0));
            for (cell, density) in list {
                put(*cell, kind, f64::from(*density) * grid.cell_volume_m3(), 1);
            }
        }
        for (cell, ([one, kinds], [warm, of_kinds])) in area.iter().zip(&warmth).enumerate() {
            assert_eq!(open(cell), *kinds > 0.0);
            if open(cell) {
                // The list of parcels leaves out shares below 2e-3 of the largest: about 1 % of the droplets moves.
                assert!((kinds / one - 1.0).abs() < 0.03, "{cell}: {one} {kinds}");
                // Of 30 K, as much moves with them.
                assert!((of_kinds / kinds - warm / one).abs() < 0.3, "{cell}");
            }
        }
        // In all: number, area and temperature are the parcels' own.
        let sum = |list: &[Parcel], value: &dyn Fn(&Parcel) -> f64| list.iter().map(value).sum::<f64>();
        for value in [&(|p: &Parcel| p.droplets) as &dyn Fn(&Parcel) -> f64, &Parcel::area_m2, &|p| {
            p.area_m2() * p.temperature_k
        }] {
            assert!((sum(&kinds.parcels, value) / sum(&parcels, value) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_parcel_behind_walls_stays_in_its_cell() {
        let grid = Grid { lower_m: [0.0; 3], upper_m: [0.01; 3], cells: [10; 3] };
        let parcels = [Parcel { temperature_k: 361.0, ..cloud(1)[0] }];
        let kinds = spread(&grid, &parcels, &[(1e-3, 0.0)], &|_| false).unwrap();
        // Its temperature lies between those of two kinds.
        assert!(kinds.lists.iter().all(|list| list.len() == 1) && kinds.error < 1e-12);
        assert_eq!(kinds.lists.len(), 2);
        assert_eq!(grid.cell(kinds.lists[0][0].0 as usize), [0; 3]);
    }

    #[test]
    fn kinds_are_as_fine_as_memory_allows() {
        let grid = Grid { lower_m: [0.0; 3], upper_m: [0.01; 3], cells: [100; 3] };
        let parcels = cloud(3000);
        let count = |width_m: f64| {
            let widths = vec![(width_m, 0.0); parcels.len()];
            let members = sorted(&grid, &parcels, &widths).unwrap();
            members.chunk_by(|a, b| a.kind == b.kind).count()
        };
        // Kinds of half the width are about four times as many; of a million cells each, 67 fit.
        let (fine, coarse) = (count(1e-4), count(4e-3));
        assert!(fine > 200 && coarse < fine / 3 && coarse > 10, "{fine} {coarse}");
        let large = Grid { cells: [250; 3], ..grid };
        let error = sorted(&large, &parcels, &vec![(4e-3, 0.0); parcels.len()]).unwrap_err();
        assert!(matches!(error, SceneError::Deposit { .. }), "{error}");
    }

    #[test]
    fn a_kind_is_made_of_shares_that_keep_the_temperature() {
        let grid = Grid { lower_m: [0.0; 3], upper_m: [0.01; 3], cells: [10; 3] };
        for temperature_k in [0.5, 3.99, 4.0, 361.3, 5000.1] {
            let parcel = Parcel { temperature_k, ..cloud(1)[0] };
            let members: Vec<Member> = split(&grid, 0, &parcel, 1.0).collect();
            let share: f64 = members.iter().map(|m| m.share).sum();
            let mean: f64 = members.iter().map(|m| m.share * m.temperature_k).sum();
            assert!((share - 1.0).abs() < 1e-12);
            let wanted = temperature_k.max(STEP_K);
            assert!((mean / wanted - 1.0).abs() < 1e-12, "{temperature_k}: {mean}");
        }
    }
}
