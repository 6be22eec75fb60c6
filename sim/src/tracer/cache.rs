//! In-scattered radiance towards the camera, estimated once per leaf of the medium and shared by all pixels.
//!
//! A camera sees every point from one direction only, so what is scattered into its sights is a scalar field per group
//! (backward form of the source function of RADMC-3D and SHDOM). One path serves all groups: directions are drawn
//! from the mean of their phase functions and weighted by the balance heuristic, transmittances are exact per group.
//! The radiance from walls is estimated too, and plate, walls and medium are divided by their sum, so that a uniform
//! enclosure stays uniform whatever the noise.

#![expect(clippy::needless_range_loop, reason = "loops over lanes step through several arrays at once")]

use super::camera::Sights;
use super::lanes::{Lane, exp_minus};
use super::packed::{Packed, narrow};
use super::plate::Plate;
use super::sobol::{self, Point};
use super::vector::{Vector, along, turn};
use crate::light::phase::PhaseFunction;
use rayon::prelude::*;

/// Angular bins of the common table of the phase functions.
const BINS: usize = 768;

/// Coordinates of the first point of a path: two for the direction, three in the cell, one for the cell.
const FIRST_DIMENSIONS: usize = 6;

/// Coordinates per further scattering.
const ORDER_DIMENSIONS: usize = 4;

/// Roulette starts below this mean weight, which it restores.
const ROULETTE_WEIGHT: f32 = 0.2;

/// A march stops when no group lets more than this through: the error that it admits.
const OPAQUE: f32 = 1e-4;

/// Scatterings after which a path is cut; with roulette, fewer than one in 10^5 paths get there.
const ORDERS_MAX: usize = 512;

/// Segments of a path that march on the cells themselves; later ones may take blocks of cells.
const FINE_ORDERS: usize = 2;

/// First coordinate of the choice of the cell whose emission stands for a segment's.
const EMISSION_DIMENSION: usize = 100_000;

/// Optical depth of a leaf that is still taken as one.
const LEAF_DEPTH: f32 = 0.3;

/// Largest ratio of extinctions within 4³ cells that is cut into leaves of this edge.
fn spread_max(edge: usize) -> f32 {
    if edge == 4 { 1.5 } else { 3.0 }
}

/// Cells along the edge of the largest leaf.
const LEAF_MAX: usize = 4;

/// Decay of the filter weights per optical depth of a leaf.
const FILTER_DECAY: f32 = 2.0;

/// Rows of sums in front of the channels: plate, walls.
pub(super) const ROWS_BEFORE_CHANNELS: usize = 2;

/// The phase functions of all groups over a common set of scattering angles, and their mean as a sampling density.
pub(super) struct PhaseLanes<const N: usize> {
    theta: Vec<f32>,
    /// p at the nodes, `[node]`.
    value: Vec<[Lane; N]>,
    cumulative: Vec<f64>,
    /// Width of a bin over twice its share of the mean: p sin θ times this is the weight.
    scale: Vec<f32>,
    guide: Vec<u16>,
}

impl<const N: usize> PhaseLanes<N> {
    /// Tabulates the groups' phase functions, renormalised on the table.
    #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "768 bins")]
    pub(super) fn new(phases: &[PhaseFunction]) -> Self {
        // Nodes crowd at forward angles, where droplets throw their light: θ = π t³ with a linear part.
        let theta: Vec<f64> = (0..=BINS)
            .map(|i| {
                let t = i as f64 / BINS as f64;
                std::f64::consts::PI * t * (0.02 + t * (0.3 + 0.68 * t))
            })
            .collect();
        let mut value = vec![[Lane::ZERO; N]; BINS + 1];
        let mut share = vec![0.0; BINS];
        for (g, phase) in phases.iter().enumerate() {
            // A peak narrower than the bins (asymmetry near ±1) must not become infinite.
            let p: Vec<f64> = theta.iter().map(|t| phase.value(t.cos()).min(1e12)).collect();
            let masses: Vec<f64> =
                (0..BINS).map(|i| bin_mass(theta[i], theta[i + 1], p[i], p[i + 1])).collect();
            let norm: f64 = masses.iter().sum();
            for i in 0..=BINS {
                value[i][g / 8].0[g % 8] = narrow(p[i] / norm);
            }
            for i in 0..BINS {
                share[i] += masses[i] / norm / phases.len() as f64;
            }
        }
        let mut cumulative = vec![0.0; BINS + 1];
        // A hundredth of the samples goes everywhere, so that no group's tail has a large weight.
        for i in 0..BINS {
            let solid = 0.5 * (theta[i].cos() - theta[i + 1].cos());
            share[i] = 0.98 * share[i] + 0.02 * solid;
            cumulative[i + 1] = cumulative[i] + share[i];
        }
        let total = cumulative[BINS];
        cumulative.iter_mut().for_each(|c| *c /= total);
        let scale = (0..BINS).map(|i| narrow(0.5 * (theta[i + 1] - theta[i]) * total / share[i])).collect();
        let mut bin = 0;
        let guide = (0..BINS)
            .map(|k| {
                while bin + 1 < BINS && cumulative[bin + 1] <= k as f64 / BINS as f64 {
                    bin += 1;
                }
                bin as u16
            })
            .collect();
        Self { theta: theta.iter().map(|&t| narrow(t)).collect(), value, cumulative, scale, guide }
    }

    /// A scattering angle for `u` in (0, 1) and the weight of each group.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "u is in (0, 1)")]
    fn sample(&self, u: f64) -> (f64, f64, [Lane; N]) {
        let mut bin = usize::from(self.guide[((u * BINS as f64) as usize).min(BINS - 1)]);
        while bin + 1 < BINS && self.cumulative[bin + 1] <= u {
            bin += 1;
        }
        let (low, high) = (self.cumulative[bin], self.cumulative[bin + 1]);
        let f = narrow(((u - low) / (high - low)).clamp(0.0, 1.0));
        let theta = self.theta[bin] + f * (self.theta[bin + 1] - self.theta[bin]);
        let (sine, cosine) = f64::from(theta).sin_cos();
        let scale = narrow(sine) * self.scale[bin];
        let mut weight = [Lane::ZERO; N];
        for n in 0..N {
            weight[n] = self.value[bin][n].zip(self.value[bin + 1][n], |a, b| scale * (a + f * (b - a)));
        }
        (cosine, sine, weight)
    }
}

/// ½∫p sin θ dθ of a linear p by Simpson's rule: the table is renormalised with the same rule.
fn bin_mass(t0: f64, t1: f64, p0: f64, p1: f64) -> f64 {
    let middle = 0.5 * (p0 + p1) * (0.5 * (t0 + t1)).sin();
    (t1 - t0) / 12.0 * (p0 * t0.sin() + 4.0 * middle + p1 * t1.sin())
}

/// A block of cells that shares one estimate.
pub(super) struct Leaf {
    /// Lower corner in cells.
    corner: [usize; 3],
    /// Edge in cells.
    pub(super) edge: usize,
    /// Place of its cells in `Leaves::members`.
    first: usize,
    count: usize,
    /// Share of the samples.
    demand: f64,
    /// Mean optical depth of its edge.
    depth: f32,
    /// Scattering over extinction, mean over its cells.
    albedo: f32,
}

/// The leaves of a medium in Morton order, and the leaf of each cell.
pub(super) struct Leaves {
    pub(super) list: Vec<Leaf>,
    /// Cells of the leaves with the running sum of their scattering coefficients.
    members: Vec<([u16; 3], f32)>,
    /// Leaf of each occupied cell.
    pub(super) of_cell: Vec<u32>,
}

impl Leaves {
    /// Cuts the medium into leaves of 4, 2 or 1 cells so that their optical depth stays below 0.3, with demands by what
    /// the camera sees of them.
    #[expect(clippy::cast_precision_loss, reason = "edges are 1, 2 or 4")]
    pub(super) fn new<const N: usize>(medium: &Packed<N>, sights: &Sights) -> Self {
        let lattice = &medium.lattice;
        let cells = lattice.cells;
        let step = narrow((lattice.size[0] * lattice.size[1] * lattice.size[2]).cbrt());
        let ordinal = |c: [usize; 3]| lattice.index[(c[0] * cells[1] + c[1]) * cells[2] + c[2]];
        let mut blocks: Vec<(u64, [usize; 3])> = Vec::new();
        for x in (0..cells[0]).step_by(LEAF_MAX) {
            for y in (0..cells[1]).step_by(LEAF_MAX) {
                for z in (0..cells[2]).step_by(LEAF_MAX) {
                    blocks.push((morton([x / LEAF_MAX, y / LEAF_MAX, z / LEAF_MAX]), [x, y, z]));
                }
            }
        }
        blocks.sort_unstable();
        let mut leaves = Self { list: Vec::new(), members: Vec::new(), of_cell: vec![0; medium.k.len()] };
        let inside = |corner: [usize; 3], edge: usize| {
            let mut list = Vec::new();
            for x in corner[0]..(corner[0] + edge).min(cells[0]) {
                for y in corner[1]..(corner[1] + edge).min(cells[1]) {
                    for z in corner[2]..(corner[2] + edge).min(cells[2]) {
                        if ordinal([x, y, z]) != u32::MAX {
                            list.push([x, y, z]);
                        }
                    }
                }
            }
            list
        };
        for (_, corner) in blocks {
            let members = inside(corner, LEAF_MAX);
            let (mut thinnest, mut thickest) = (f32::INFINITY, 0.0_f32);
            for &c in &members {
                let k = medium.mean_k[ordinal(c) as usize][0];
                (thinnest, thickest) = (thinnest.min(k), thickest.max(k));
            }
            // Where the medium changes from cell to cell, so does what it scatters.
            let spread =
                if members.len() == LEAF_MAX.pow(3) { thickest / thinnest.max(1e-30) } else { f32::INFINITY };
            let fits =
                |edge: usize| thickest * step * edge as f32 <= LEAF_DEPTH && spread <= spread_max(edge);
            let edge = [4, 2].into_iter().find(|&e| fits(e)).unwrap_or(1);
            for part in 0..(LEAF_MAX / edge).pow(3) {
                let per_axis = LEAF_MAX / edge;
                let at = [part / (per_axis * per_axis), part / per_axis % per_axis, part % per_axis];
                let corner = [0, 1, 2].map(|a| corner[a] + at[a] * edge);
                let list = inside(corner, edge);
                if !list.is_empty() {
                    leaves.push(medium, corner, edge, step, &list);
                }
            }
        }
        leaves.demand(medium, sights);
        leaves
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "cells per axis are below 65536"
    )]
    fn push<const N: usize>(
        &mut self,
        medium: &Packed<N>,
        corner: [usize; 3],
        edge: usize,
        step: f32,
        list: &[[usize; 3]],
    ) {
        let cells = medium.lattice.cells;
        let (mut sum, mut extinction) = (0.0_f32, 0.0_f32);
        let first = self.members.len();
        for c in list {
            let ordinal = medium.lattice.index[(c[0] * cells[1] + c[1]) * cells[2] + c[2]] as usize;
            let [k, scattering] = medium.mean_k[ordinal];
            // A cell that does not scatter still gets a value, though nothing will be multiplied with it.
            sum += scattering.max(f32::MIN_POSITIVE);
            extinction += k;
            self.members.push((c.map(|i| i as u16), sum));
            self.of_cell[ordinal] = self.list.len() as u32;
        }
        let depth = extinction * step * edge as f32 / list.len() as f32;
        let albedo = if extinction > 0.0 { (sum / extinction).min(1.0) } else { 0.0 };
        self.list.push(Leaf { corner, edge, first, count: list.len(), demand: 0.0, depth, albedo });
    }

    /// Demand of each leaf: the share of the camera's sights that its scattering reaches, times its edge (the noise of
    /// a leaf counts in every pixel across it).
    fn demand<const N: usize>(&mut self, medium: &Packed<N>, sights: &Sights) {
        let lattice = &medium.lattice;
        let demands: Vec<f64> = self
            .list
            .par_iter()
            .map(|leaf| {
                let half = 0.5 * real(leaf.edge);
                let centre = lattice.place(leaf.corner.map(|c| real(c) + half));
                let (direction, distance) = sights.towards(centre);
                if distance <= 0.0 {
                    return 0.0;
                }
                let origin = along(centre, -distance, direction);
                let mut depth = 0.0_f64;
                lattice.walk(origin, direction, distance, |ordinal, t0, t1| {
                    depth += f64::from(medium.mean_k[ordinal as usize][0]) * (t1 - t0);
                    depth < 20.0
                });
                // The leaf's own front half counts as open.
                let open = (-(depth - 0.5 * f64::from(leaf.depth)).max(0.0)).exp();
                f64::from(leaf.albedo) * open * real(leaf.edge) * (-(-f64::from(leaf.depth)).exp_m1())
            })
            .collect();
        let total: f64 = demands.iter().sum();
        let floor = 1.0 / real(self.list.len().max(1));
        for (leaf, demand) in self.list.iter_mut().zip(demands) {
            leaf.demand = if total > 0.0 { 0.7 * demand / total + 0.3 * floor } else { floor };
        }
    }
}

/// Sums over the samples of every leaf.
pub(super) struct Cache<const N: usize> {
    /// Rows per leaf: plate, walls, then the emission channels.
    pub(super) rows: usize,
    /// Sums per leaf and half of the samples: plate, walls, emission of channel 0.
    pub(super) halves: Vec<Halves<N>>,
    /// Samples taken.
    pub(super) samples: u64,
    /// Scatterings simulated.
    pub(super) scatterings: u64,
    batches: u32,
}

/// Sums over the two halves of the samples: plate, walls, emission of channel 0.
pub(super) type Halves<const N: usize> = [[[Lane; N]; 3]; 2];

/// What a path needs to know of its world.
pub(super) struct World<'a, const N: usize> {
    /// The medium on blocks of cells, for the later segments of a path.
    pub(super) coarse: Option<&'a Packed<N>>,
    pub(super) leaves: &'a Leaves,
    pub(super) phase: &'a PhaseLanes<N>,
    pub(super) plate: Option<&'a Plate>,
    pub(super) sights: &'a Sights,
    /// The medium itself, on which the leaves were cut.
    pub(super) fine: &'a Packed<N>,
    pub(super) groups: usize,
    pub(super) seed: u64,
}

impl<const N: usize> Cache<N> {
    /// A cache without samples.
    pub(super) fn new(leaves: &Leaves, channels: usize) -> Self {
        Self {
            rows: ROWS_BEFORE_CHANNELS + channels,
            halves: vec![[[[Lane::ZERO; N]; 3]; 2]; leaves.list.len()],
            samples: 0,
            scatterings: 0,
            batches: 0,
        }
    }

    /// Adds about `samples` paths, shared out by the leaves' demands. Neighbouring leaves take neighbouring points of
    /// one scrambled sequence per half, so that what one misses the next one has.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "sample counts are below 2^31"
    )]
    pub(super) fn add(
        &mut self,
        world: &World<'_, N>,
        sums: &mut [[Lane; N]],
        samples: f64,
        progress: &(dyn Fn(f64) + Sync),
    ) {
        let mut starts = Vec::with_capacity(world.leaves.list.len() + 1);
        let mut running = 0.0;
        starts.push(0_u32);
        for leaf in &world.leaves.list {
            running += leaf.demand * 0.5 * samples;
            starts.push((running + 0.5) as u32);
        }
        let batch = self.batches;
        self.batches += 1;
        let names = [0, 1].map(|half| sobol::sequence(world.seed, batch, half));
        let rows = self.rows;
        let done = std::sync::atomic::AtomicUsize::new(0);
        let arch = pulp::Arch::new();
        let block = 64;
        let counted: Vec<u64> = sums
            .par_chunks_mut(rows * block)
            .zip(self.halves.par_chunks_mut(block))
            .enumerate()
            .map(|(b, (sums, halves))| {
                let mut scatterings = 0;
                arch.dispatch(
                    #[inline(always)]
                    || {
                        for (i, (sums, halves)) in sums.chunks_mut(rows).zip(halves.iter_mut()).enumerate() {
                            let l = b * block + i;
                            scatterings +=
                                sample_leaf(world, l, starts[l]..starts[l + 1], names, sums, halves);
                        }
                    },
                );
                let n = done.fetch_add(block, std::sync::atomic::Ordering::Relaxed) + block;
                progress(real(n.min(world.leaves.list.len())) / real(world.leaves.list.len()));
                scatterings
            })
            .collect();
        self.scatterings += counted.iter().sum::<u64>();
        self.samples += 2 * u64::from(starts[world.leaves.list.len()]);
    }
}

/// Traces the points `range` of both halves from one leaf.
#[inline(always)]
fn sample_leaf<const N: usize>(
    world: &World<'_, N>,
    leaf: usize,
    range: std::ops::Range<u32>,
    names: [u32; 2],
    sums: &mut [[Lane; N]],
    halves: &mut Halves<N>,
) -> u64 {
    let mut scatterings = 0;
    let leaf = &world.leaves.list[leaf];
    let members = &world.leaves.members[leaf.first..leaf.first + leaf.count];
    let total = members[leaf.count - 1].1;
    let mut own = vec![[Lane::ZERO; N]; sums.len()];
    for (half, &name) in names.iter().enumerate() {
        own.iter_mut().for_each(|row| *row = [Lane::ZERO; N]);
        for index in range.clone() {
            let point = Point::new(name, index);
            let wanted = narrow(point.coordinate(5)) * total;
            let member = members.partition_point(|m| m.1 <= wanted).min(leaf.count - 1);
            let cell = members[member].0;
            let units = [0, 1, 2].map(|a| f64::from(cell[a]) + point.coordinate(2 + a));
            let start = world.fine.lattice.place(units);
            let (direction, distance) = world.sights.towards(start);
            if distance > 0.0 {
                let (start, weight) = seen_place(world.fine, cell, start, direction);
                scatterings += trace(world, point, start, direction, weight, &mut own);
            }
        }
        for (sum, row) in sums.iter_mut().zip(&own) {
            for n in 0..N {
                sum[n] = sum[n] + row[n];
            }
        }
        for (value, row) in halves[half].iter_mut().zip(&own) {
            for n in 0..N {
                value[n] = value[n] + row[n];
            }
        }
    }
    scatterings
}

/// Moves a uniform place in a cell along its sight to where the camera sees the cell scatter: exponentially towards the
/// near side, with the groups' weights against the mean. This makes the mean over samples the very mean that the
/// gather needs, however the source function falls off inside an opaque cell.
#[inline(always)]
fn seen_place<const N: usize>(
    medium: &Packed<N>,
    cell: [u16; 3],
    start: Vector,
    direction: Vector,
) -> (Vector, [Lane; N]) {
    let lattice = &medium.lattice;
    let cells = lattice.cells;
    let c = cell.map(usize::from);
    let ordinal = lattice.index[(c[0] * cells[1] + c[1]) * cells[2] + c[2]] as usize;
    let (low, high) = (lattice.place(c.map(real)), lattice.place(c.map(|i| real(i + 1))));
    let (mut before, mut behind) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        if direction[a].abs() > 1e-100 {
            let (t0, t1) = ((low[a] - start[a]) / direction[a], (high[a] - start[a]) / direction[a]);
            before = before.max(t0.min(t1));
            behind = behind.min(t0.max(t1));
        }
    }
    let chord = behind - before;
    let k = f64::from(medium.mean_k[ordinal][0]);
    let depth = k * chord;
    if depth.is_nan() || depth < 1e-6 {
        return (start, [Lane::ONE; N]);
    }
    let open = -(-depth).exp_m1();
    let fraction = (-before / chord).clamp(0.0, 1.0);
    let place = (-(-fraction * open).ln_1p() / k).min(chord);
    let (mean, share, at) = (narrow(k), narrow(open / depth), narrow(place));
    let weight = medium.k[ordinal].map(|k| k.map(|k| share * ((mean - k) * at).clamp(-20.0, 20.0).exp()));
    (along(start, before + place, direction), weight)
}

/// Where and with what throughput a path scatters next.
struct Choice<const N: usize> {
    ordinal: u32,
    start: f64,
    length: f64,
    weight: [Lane; N],
    probability: f32,
}

/// Follows one path backwards from a scattering at `start` seen along `direction`; adds what it collects to `rows`.
#[inline(always)]
fn trace<const N: usize>(
    world: &World<'_, N>,
    point: Point,
    start: Vector,
    direction: Vector,
    seen: [Lane; N],
    rows: &mut [[Lane; N]],
) -> u64 {
    let groups = narrow(real(world.groups));
    let (cosine, sine, mut weight) = world.phase.sample(point.coordinate(0));
    for n in 0..N {
        weight[n] = weight[n] * seen[n];
    }
    let mut direction = turn(direction, cosine, sine, std::f64::consts::TAU * point.coordinate(1));
    let mut origin = start;
    for order in 0..ORDERS_MAX {
        let dimension = FIRST_DIMENSIONS + ORDER_DIMENSIONS * order;
        let medium = if order < FINE_ORDERS { world.fine } else { world.coarse.unwrap_or(world.fine) };
        let plate = world.plate.and_then(|p| p.hit(origin, direction));
        let far = plate.unwrap_or(f64::INFINITY);
        let mut u = point.coordinate(dimension);
        let mut total = 0.0_f64;
        let mut choice =
            Choice { ordinal: u32::MAX, start: 0.0, length: 0.0, weight: [Lane::ZERO; N], probability: 0.0 };
        // Channel 0 is summed over all cells; the others, whose sources change little along a segment, are taken from
        // one cell drawn by its emission, which keeps them unbiased and saves most of the memory traffic.
        let mut v = point.coordinate(EMISSION_DIMENSION + order);
        let mut emission_total = 0.0_f64;
        let mut emitter =
            Choice { ordinal: u32::MAX, start: 0.0, length: 0.0, weight: [Lane::ZERO; N], probability: 1.0 };
        medium.lattice.walk(origin, direction, far, |ordinal, t0, t1| {
            let o = ordinal as usize;
            let length = narrow(t1 - t0);
            let entering = weight;
            let mut scattered = Lane::ZERO;
            let mut absorbed = [Lane::ZERO; N];
            let mut most = Lane::ZERO;
            let [k, albedo, source] = &medium.core[o];
            let mut emitted = Lane::ZERO;
            for n in 0..N {
                let e = exp_minus(k[n].map(|k| k * length));
                absorbed[n] = entering[n] * e.map(|e| 1.0 - e);
                weight[n] = entering[n] * e;
                scattered.add_product(absorbed[n], albedo[n]);
                let own = absorbed[n] * source[n];
                rows[ROWS_BEFORE_CHANNELS][n] = rows[ROWS_BEFORE_CHANNELS][n] + own;
                emitted = emitted + own;
                most = most.zip(weight[n], f32::max);
            }
            let own = f64::from(emitted.sum());
            if own > 0.0 && medium.channels > 1 {
                emission_total += own;
                let share = own / emission_total;
                if v < share {
                    v /= share;
                    emitter = Choice {
                        ordinal,
                        start: t0,
                        length: own,
                        weight: absorbed,
                        probability: emitted.sum(),
                    };
                } else {
                    v = (v - share) / (1.0 - share);
                }
            }
            let here = scattered.sum();
            if here > 0.0 {
                // A reservoir of one: each cell replaces the choice in proportion to what it scatters.
                total += f64::from(here);
                let share = f64::from(here) / total;
                if u < share {
                    u /= share;
                    choice =
                        Choice { ordinal, start: t0, length: t1 - t0, weight: entering, probability: here };
                } else {
                    u = (u - share) / (1.0 - share);
                }
            }
            most.0.iter().fold(0.0_f32, |a, &b| a.max(b)) > OPAQUE
        });
        if emitter.ordinal != u32::MAX {
            let scale = narrow(emission_total / f64::from(emitter.probability));
            let o = emitter.ordinal as usize;
            let sources = &medium.source[o * medium.channels..(o + 1) * medium.channels];
            for (row, source) in rows[ROWS_BEFORE_CHANNELS..].iter_mut().zip(sources).skip(1) {
                for n in 0..N {
                    row[n].add_product(emitter.weight[n].map(|w| w * scale), source[n]);
                }
            }
        }
        let row = &mut rows[usize::from(plate.is_none())];
        for n in 0..N {
            row[n] = row[n] + weight[n];
        }
        if choice.ordinal == u32::MAX {
            return order as u64 + 1;
        }
        // The place inside the cell by the mean extinction, corrected per group.
        let o = choice.ordinal as usize;
        let k = f64::from(medium.mean_k[o][0]).max(1e-30);
        let open = -(-k * choice.length).exp_m1();
        let depth = (-(-point.coordinate(dimension + 1) * open).ln_1p() / k).min(choice.length);
        let density = k * (-k * depth).exp() / open;
        let scale = narrow(total / f64::from(choice.probability) / density);
        let place = narrow(depth);
        let (cosine, sine, phase) = world.phase.sample(point.coordinate(dimension + 2));
        let mut mean = 0.0;
        for n in 0..N {
            let k = medium.k[o][n];
            let reached = exp_minus(k.map(|k| k * place));
            weight[n] = choice.weight[n] * reached * k * medium.albedo[o][n] * phase[n];
            weight[n] = weight[n].map(|w| w * scale);
            mean += weight[n].sum();
        }
        mean /= groups;
        if mean < ROULETTE_WEIGHT {
            // The choice's last bits are still unused.
            let survival = mean / ROULETTE_WEIGHT;
            if u >= f64::from(survival) {
                return order as u64 + 1;
            }
            for lane in &mut weight {
                *lane = lane.map(|w| w / survival);
            }
        }
        origin = along(origin, choice.start + depth, direction);
        direction = turn(direction, cosine, sine, std::f64::consts::TAU * point.coordinate(dimension + 3));
    }
    ORDERS_MAX as u64
}

/// Interleaves the bits of three coordinates below 2^16.
fn morton(c: [usize; 3]) -> u64 {
    let mut code = 0;
    for bit in 0..16 {
        for (a, &value) in c.iter().enumerate() {
            code |= ((value as u64 >> bit) & 1) << (3 * bit + 2 - a);
        }
    }
    code
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

impl Leaves {
    /// The leaf at a place in cell units, if the cell there is occupied.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked against the lattice"
    )]
    fn at<const N: usize>(&self, medium: &Packed<N>, units: Vector) -> Option<usize> {
        let cells = medium.lattice.cells;
        let inside = (0..3).all(|a| units[a] >= 0.0 && units[a] < real(cells[a]));
        let c = units.map(|u| u as usize);
        let ordinal =
            if inside { medium.lattice.index[(c[0] * cells[1] + c[1]) * cells[2] + c[2]] } else { u32::MAX };
        (ordinal != u32::MAX).then(|| self.of_cell[ordinal as usize] as usize)
    }

    /// A leaf and its up to 26 neighbours with the weights of the filter.
    pub(super) fn neighbours<const N: usize>(
        &self,
        medium: &Packed<N>,
        leaf: usize,
    ) -> impl Iterator<Item = (usize, f32)> {
        let own = &self.list[leaf];
        let edge = real(own.edge);
        let centre = own.corner.map(|c| real(c) + 0.5 * edge);
        // Over a mean free path the source function changes by itself: no averaging across it.
        let across = (-FILTER_DECAY * own.depth).exp();
        (0..27_usize).filter_map(move |k| {
            let offset = [k / 9, k / 3 % 3, k % 3].map(|i| real(i) - 1.0);
            let distance: f64 = offset.iter().map(|o| o.abs()).sum();
            if distance == 0.0 {
                return Some((leaf, 1.0));
            }
            let place = [0, 1, 2].map(|a| centre[a] + offset[a] * edge);
            let other = self.at(medium, place)?;
            let (a, b) =
                (own.depth / narrow(edge), self.list[other].depth / narrow(real(self.list[other].edge)));
            let alike = (a.min(b) / a.max(b).max(1e-30)).powi(4);
            let weight = narrow(0.5_f64.powf(distance)) * across * alike;
            (other != leaf && weight > 1e-2).then_some((other, weight))
        })
    }

    /// The leaves on both sides along each axis, where both are there.
    pub(super) fn opposite<const N: usize>(
        &self,
        medium: &Packed<N>,
        leaf: usize,
    ) -> impl Iterator<Item = [usize; 2]> {
        let own = &self.list[leaf];
        let edge = real(own.edge);
        let centre = own.corner.map(|c| real(c) + 0.5 * edge);
        (0..3).filter_map(move |axis| {
            let beside = |step: f64| {
                let mut place = centre;
                place[axis] += step;
                self.at(medium, place)
            };
            Some([beside(-edge)?, beside(edge)?])
        })
    }

    /// The leaves between whose centres a cell lies, with the weights of linear interpolation.
    pub(super) fn around<const N: usize>(
        &self,
        medium: &Packed<N>,
        ordinal: usize,
        cell: [u16; 3],
    ) -> impl Iterator<Item = (usize, f32)> {
        let leaf = self.of_cell[ordinal] as usize;
        let own = &self.list[leaf];
        let edge = real(own.edge);
        let offset = [0, 1, 2].map(|a| (f64::from(cell[a]) + 0.5 - real(own.corner[a])) / edge - 0.5);
        let centre = own.corner.map(|c| real(c) + 0.5 * edge);
        let corners = if own.edge == 1 { 1 } else { 8 };
        (0..corners).filter_map(move |k: usize| {
            let mut weight = 1.0;
            let mut place = centre;
            for a in 0..3 {
                if (k >> a) & 1 == 1 {
                    weight *= offset[a].abs();
                    place[a] += edge * offset[a].signum();
                } else if own.edge > 1 {
                    weight *= 1.0 - offset[a].abs();
                }
            }
            if k == 0 {
                Some((leaf, narrow(weight)))
            } else {
                Some((self.at(medium, place)?, narrow(weight)))
            }
        })
    }
}
