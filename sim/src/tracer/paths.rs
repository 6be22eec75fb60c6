//! Scattered paths, followed backwards: expected-value scores of emission and escape on every segment, implicit capture,
//! roulette only below a fifth of the weight.
//!
//! One path serves all spectral groups: transmittances are exact per group, directions and places are drawn from means
//! and weighted.

use super::blocks::Blocks;
use super::bricks::Segment;
use super::chamber::{Chamber, ENDS};
use super::plate::Plate;
use super::scatter::Scatter;
use super::sobol::Coordinates;
use super::spectrum::{Spectrum, narrow};
use super::vector::{Vector, along, turn};

/// Coordinates that a path's first point takes: angle, azimuth, cell, place in it, group.
pub(super) const FIRST_DIMENSIONS: usize = 7;

/// Coordinates per further scattering: place, depth in the block, angle, azimuth. The group is hashed.
pub(super) const ORDER_DIMENSIONS: usize = 4;

/// Roulette starts below this mean weight, which it restores.
pub(super) const ROULETTE_WEIGHT: f32 = 0.2;

/// A march stops when no group lets more than this through: the error that it admits.
pub(super) const OPAQUE: f32 = 1e-4;

/// Scatterings after which a path is cut; with roulette, fewer than one in 10^5 paths of albedo 0.99 get there.
pub(super) const ORDERS_MAX: usize = 512;

/// First coordinates of roulette, of the choice of the group, and of the block whose emission stands for a segment's.
pub(super) const ROULETTE_DIMENSION: usize = 100_000;
pub(super) const GROUP_DIMENSION: usize = 200_000;
const EMISSION_DIMENSION: usize = 300_000;

/// Rows of scores in front of the channels: plate, walls.
pub(super) const PLATE: usize = 0;
pub(super) const WALLS: usize = 1;
pub(super) const MEDIUM: usize = 2;

/// What paths move in.
pub(super) struct World<'a, S> {
    pub(super) blocks: &'a Blocks<S>,
    pub(super) scatter: &'a Scatter<'a, S>,
    pub(super) plate: Option<&'a Plate>,
    /// The chamber whose walls are told apart, if they are.
    pub(super) chamber: Option<&'a Chamber>,
}

/// A block along a segment.
struct Visit<S> {
    place: usize,
    start: f64,
    end: f64,
    /// Running sums over the segment of what is scattered and emitted, all groups together.
    scattered: f32,
    emitted: f32,
    /// Weight on entering.
    weight: S,
}

/// Memory of a path: kept from one to the next.
pub(super) struct Memory<S> {
    visits: Vec<Visit<S>>,
    /// Scatterings and blocks so far.
    pub(super) scatterings: u64,
    pub(super) blocks: u64,
}

impl<S: Spectrum> Memory<S> {
    pub(super) fn new() -> Self {
        Self { visits: Vec::with_capacity(256), scatterings: 0, blocks: 0 }
    }
}

impl<S: Spectrum> World<'_, S> {
    /// Number of rows: plate, walls, channels, and the ends of rays where walls are told apart.
    pub(super) fn rows(&self) -> usize {
        self.first_end() + if self.chamber.is_some() { ENDS } else { 0 }
    }

    /// Where the rows of the ends begin.
    pub(super) fn first_end(&self) -> usize {
        MEDIUM + self.blocks.channels
    }

    /// The direction after a path's first scattering, and each group's weight.
    #[inline(always)]
    pub(super) fn turned(&self, at: &Coordinates, direction: Vector) -> (Vector, S) {
        let (cosine, share) = self.scatter.sample(at.get(0), at.get(6));
        (turned(direction, cosine, at.get(1)), share)
    }

    /// Follows one path from `origin` along `direction`. Roulette is played against `unit`; without one, against what is
    /// scattered first: a faint share of a sight is followed like any other.
    #[inline(always)]
    pub(super) fn follow(
        &self,
        at: &Coordinates,
        (mut origin, mut direction): (Vector, Vector),
        mut weight: S,
        unit: Option<f32>,
        rows: &mut [S],
        memory: &mut Memory<S>,
    ) {
        let per_group = 1.0 / narrow(real(self.blocks.groups));
        let mut unit = unit;
        let (mut plate_row, mut walls_row, mut medium_row) = (S::ZERO, S::ZERO, S::ZERO);
        for order in 0..ORDERS_MAX {
            let dimension = FIRST_DIMENSIONS + ORDER_DIMENSIONS * order;
            let hit = self.plate.and_then(|p| p.hit(origin, direction));
            let visits = &mut memory.visits;
            visits.clear();
            let (mut scattered, mut emitted) = (0.0_f32, 0.0_f32);
            let mut march = self.blocks.bricks.march(origin, direction, hit.unwrap_or(f64::INFINITY));
            while let Some(Segment { place, start, end, .. }) = march.next() {
                let [k, albedo] = self.blocks.core[place];
                let (through, stopped) = k.split(narrow(end - start));
                let here = weight.times(stopped);
                let again = here.times(albedo);
                let own = here.minus(again);
                medium_row = medium_row.plus(own);
                scattered += again.sum();
                emitted += own.sum();
                visits.push(Visit { place, start, end, scattered, emitted, weight });
                weight = weight.times(through);
                if !weight.any_above(OPAQUE) {
                    break;
                }
            }
            memory.scatterings += 1;
            memory.blocks += memory.visits.len() as u64;
            let visits = &memory.visits;
            if hit.is_some() {
                plate_row = plate_row.plus(weight);
            } else {
                walls_row = walls_row.plus(weight);
                if let Some(chamber) = self.chamber {
                    let end = self.first_end() + chamber.end(origin, direction);
                    rows[end] = rows[end].plus(weight);
                }
            }
            if self.blocks.channels > 1 && emitted > 0.0 {
                self.emission(visits, emitted, narrow(at.get(EMISSION_DIMENSION + order)), rows);
            }
            if !(scattered > 0.0 && scattered.is_finite()) {
                break;
            }
            let mean = scattered * per_group;
            let mut scale = 1.0;
            let least = ROULETTE_WEIGHT * *unit.get_or_insert(mean.min(1.0));
            if mean < least {
                scale = least / mean;
                if narrow(at.get(ROULETTE_DIMENSION + order)) * least >= mean {
                    break;
                }
            }
            let wanted = narrow(at.get(dimension)) * scattered;
            let chosen = visits.partition_point(|v| v.scattered <= wanted).min(visits.len() - 1);
            let visit = &visits[chosen];
            let before = if chosen == 0 { 0.0 } else { visits[chosen - 1].scattered };
            // The place inside the block by the mean extinction, corrected per group.
            let [k, albedo] = self.blocks.core[visit.place];
            let length = visit.end - visit.start;
            let mean_k = f64::from(k.sum() * per_group).max(1e-30);
            let open = -(-mean_k * length).exp_m1();
            let depth = (-(-at.get(dimension + 1) * open).ln_1p() / mean_k).min(length);
            let (cosine, share) = self.scatter.sample(at.get(dimension + 2), at.get(GROUP_DIMENSION + order));
            if S::WIDTH == 1 {
                // One group: the densities cancel, and what is captured goes on.
                weight = S::splat(scattered * scale);
            } else {
                let density = mean_k * (-mean_k * depth).exp() / open;
                let chance = (visit.scattered - before) / scattered;
                let (through, _) = k.split(narrow(depth));
                weight = visit.weight.times(through).times(k).times(albedo).times(share);
                weight = weight.scaled(scale / (chance * narrow(density)));
            }
            origin = along(origin, visit.start + depth, direction);
            direction = turned(direction, cosine, at.get(dimension + 3));
        }
        rows[PLATE] = rows[PLATE].plus(plate_row);
        rows[WALLS] = rows[WALLS].plus(walls_row);
        rows[MEDIUM] = rows[MEDIUM].plus(medium_row);
    }

    /// Scores the channels from 1 on by one block drawn from what the segment's blocks emit in channel 0: their sources
    /// change little along a segment, and most of the memory traffic is saved.
    #[inline(always)]
    fn emission(&self, visits: &[Visit<S>], emitted: f32, u: f32, rows: &mut [S]) {
        let chosen = visits.partition_point(|v| v.emitted <= u * emitted).min(visits.len() - 1);
        let before = if chosen == 0 { 0.0 } else { visits[chosen - 1].emitted };
        let visit = &visits[chosen];
        let chance = (visit.emitted - before) / emitted;
        if chance <= 0.0 {
            return;
        }
        let [k, _] = self.blocks.core[visit.place];
        let (_, stopped) = k.split(narrow(visit.end - visit.start));
        let here = visit.weight.times(stopped).scaled(1.0 / chance);
        let extra = self.blocks.channels - 1;
        let sources = &self.blocks.source[visit.place * extra..(visit.place + 1) * extra];
        for (row, source) in rows[MEDIUM + 1..].iter_mut().zip(sources) {
            *row = row.plus_product(here, *source);
        }
    }
}

/// A direction at a scattering angle, azimuth `turns` full turns.
#[inline(always)]
pub(super) fn turned(direction: Vector, cosine: f64, turns: f64) -> Vector {
    let sine = ((1.0 - cosine) * (1.0 + cosine)).max(0.0).sqrt();
    turn(direction, cosine, sine, std::f64::consts::TAU * turns)
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
