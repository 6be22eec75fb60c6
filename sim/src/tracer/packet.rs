//! Many sights at once through a medium of one spectral group, what can be computed side by side being so.
//!
//! In-scattered light is linear inside each piece, so a sight needs only the sums of weight · (1, x, y, z) times the
//! coefficients of the pieces, which are put together when it is complete.

use super::bricks::{Brick, EDGE, EDGE_LOG};
use super::fine::Fine;
use super::gather::{OPAQUE, Sight};
use super::lanes::{Floats, Ints, LANES, NO_INTS, ZEROS};
use super::pieces::Pieces;
use super::plate::Plate;
use super::shares::ROWS;
use super::spectrum::{One, Spectrum, split};
use super::vector::Vector;
use super::walk::{NOWHERE, Step, Walk};

/// Steps between two rounds of light.
const STEPS: usize = 8;

/// The lanes, and what they collect.
pub(super) struct Packet {
    walk: Walk,
    through: Floats,
    /// Emission of channel 0 along the straight sight.
    own: Floats,
    cells: Ints,
    sees_plate: [bool; LANES],
    share: [f32; LANES],
    /// Lanes whose errors are followed.
    errors: [bool; LANES],
    lanes: usize,
    /// Of the last steps: piece and place, weight of all light and of what is scattered, the latter times where.
    piece: [Ints; STEPS],
    place: [Ints; STEPS],
    weight: [Floats; STEPS],
    turned: [Floats; STEPS],
    moment: [Floats; STEPS],
    /// Σ turned · coefficients and Σ turned · at · coefficients of two rows, `[lane · pairs + pair]`.
    sums: Vec<[[f32; 8]; 2]>,
    /// Straight emission of the channels from 1 on, `[lane · (channels − 1) + channel − 1]`.
    direct: Vec<f32>,
    noise: [[f32; ROWS]; LANES],
    bias: [[f32; ROWS]; LANES],
}

impl Packet {
    /// No lanes yet.
    pub(super) fn new(channels: usize) -> Self {
        Self {
            walk: Walk::new(),
            through: ZEROS,
            own: ZEROS,
            cells: NO_INTS,
            sees_plate: [false; LANES],
            share: [0.0; LANES],
            errors: [false; LANES],
            lanes: 0,
            piece: [NO_INTS; STEPS],
            place: [NO_INTS; STEPS],
            weight: [ZEROS; STEPS],
            turned: [ZEROS; STEPS],
            moment: [ZEROS; STEPS],
            sums: vec![[[0.0; 8]; 2]; LANES * (1 + channels).div_ceil(2)],
            direct: vec![0.0; LANES * (channels - 1)],
            noise: [[0.0; ROWS]; LANES],
            bias: [[0.0; ROWS]; LANES],
        }
    }

    /// Sights in it, at most [`LANES`].
    #[inline(always)]
    pub(super) fn lanes(&self) -> usize {
        self.lanes
    }

    /// Adds a sight from `origin` along the unit vector `direction`.
    #[inline(always)]
    pub(super) fn push(
        &mut self,
        fine: &Fine<One>,
        plate: Option<&Plate>,
        ray: (Vector, Vector),
        share: f32,
        errors: bool,
    ) {
        let l = self.lanes;
        let hit = plate.and_then(|p| p.hit(ray.0, ray.1));
        self.walk.send(&fine.bricks, l, ray, hit.unwrap_or(f64::INFINITY));
        self.through.0[l] = share;
        self.own.0[l] = 0.0;
        self.cells.0[l] = 0;
        self.sees_plate[l] = hit.is_some();
        self.share[l] = share;
        self.errors[l] = errors;
        self.noise[l] = [0.0; ROWS];
        self.bias[l] = [0.0; ROWS];
        self.lanes += 1;
    }

    /// Follows all sights to their ends; what they meet is kept in pieces of `cuts`, a list of all bricks, or in none.
    /// `each` is called for every few steps.
    #[inline(always)]
    fn follow(&mut self, fine: &Fine<One>, cuts: &[Brick], mut each: impl FnMut(&mut Self, usize)) {
        for l in self.lanes..LANES {
            self.walk.stop(l);
            self.through.0[l] = 0.0;
            self.errors[l] = false;
        }
        let mut going = true;
        while going {
            let mut kept = 0;
            while kept < STEPS && going {
                going = self.step(fine, cuts, kept);
                kept += 1;
            }
            each(self, kept);
        }
    }

    /// Follows all sights and collects what they see.
    #[inline(always)]
    pub(super) fn run(&mut self, fine: &Fine<One>, pieces: Option<&Pieces>) {
        self.sums.iter_mut().for_each(|s| *s = [[0.0; 8]; 2]);
        self.direct.iter_mut().for_each(|d| *d = 0.0);
        self.follow(
            fine,
            pieces.map(|p| p.cuts.as_slice()).unwrap_or_default(),
            #[inline(always)]
            |packet, kept| {
                if let Some(pieces) = pieces {
                    packet.lit(pieces, kept);
                }
                if fine.channels > 1 {
                    packet.emission(fine, kept);
                }
            },
        );
    }

    /// Follows all sights and tells, lane by lane, how much each piece of `cuts` on the way scatters into them; a piece
    /// may come several times in a row.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "pieces are counted from zero")]
    pub(super) fn visit(
        &mut self,
        fine: &Fine<One>,
        cuts: &[Brick],
        mut seen: impl FnMut(usize, usize, f32),
    ) {
        self.follow(
            fine,
            cuts,
            #[inline(always)]
            |packet, kept| {
                for l in 0..packet.lanes {
                    for s in 0..kept {
                        let turned = packet.turned[s].0[l];
                        if turned > 0.0 {
                            seen(l, packet.piece[s].0[l] as usize, turned);
                        }
                    }
                }
            },
        );
    }

    /// One step of every lane, into the given place of the memory; whether any lane goes on.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        reason = "cells stay inside the box, whose bricks, cells and places fit into 31 bits"
    )]
    fn step(&mut self, fine: &Fine<One>, cuts: &[Brick], kept: usize) -> bool {
        let step = self.walk.step::<true>(&fine.bricks);
        let Step { brick, place, cell: [cx, cy, cz], start, exit, .. } = step;
        let (mut k, mut albedo) = (ZEROS, ZEROS);
        // An empty brick is one piece, the first one: nothing is multiplied with it, but it is read.
        let (mut first, mut down) = (NO_INTS, Ints([EDGE_LOG as i32; LANES]));
        for l in 0..LANES {
            if place.0[l] != NOWHERE {
                let [here, scattering] = fine.core[place.0[l] as usize];
                k.0[l] = here.get(0);
                albedo.0[l] = scattering.get(0);
                if let Some(cut) = cuts.get(brick.0[l] as usize) {
                    first.0[l] = cut.first as i32;
                    down.0[l] = (EDGE_LOG - cut.log) as i32;
                }
            }
        }
        self.place[kept] = place;
        for l in 0..LANES {
            let depth = k.0[l] * (exit.0[l] - start.0[l]);
            let (passed, stopped) = split(depth);
            let weight = self.through.0[l] * stopped;
            self.through.0[l] *= passed;
            let turned = weight * albedo.0[l];
            self.own.0[l] += weight - turned;
            self.weight[kept].0[l] = weight;
            self.turned[kept].0[l] = turned;
            self.moment[kept].0[l] = turned * (0.5 * (exit.0[l] + start.0[l]));
            self.cells.0[l] += i32::from(depth > 0.0);
        }
        let low = EDGE as i32 - 1;
        for l in 0..LANES {
            let shift = down.0[l];
            let log = EDGE_LOG as i32 - shift;
            let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]].map(|c| (c & low) >> shift);
            self.piece[kept].0[l] = first.0[l] + (((x << log) + y) << log) + z;
        }
        self.walk.settle(&step, |l| self.through.0[l] > OPAQUE) > 0
    }

    /// What is scattered into the sights over the last steps.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "pieces are counted from zero")]
    fn lit(&mut self, pieces: &Pieces, kept: usize) {
        let pairs = pieces.pairs;
        for l in 0..self.lanes {
            for pair in 0..pairs {
                let [mut sum, mut moment] = self.sums[l * pairs + pair];
                for s in 0..kept {
                    let line = pieces.lines[self.piece[s].0[l] as usize * pairs + pair];
                    let (turned, at) = (self.turned[s].0[l], self.moment[s].0[l]);
                    for i in 0..8 {
                        sum[i] = line[i].mul_add(turned, sum[i]);
                        moment[i] = line[i].mul_add(at, moment[i]);
                    }
                }
                self.sums[l * pairs + pair] = [sum, moment];
            }
            if self.errors[l] {
                for s in 0..kept {
                    let [noise, bias] = pieces.errors[self.piece[s].0[l] as usize];
                    for row in 0..ROWS {
                        self.noise[l][row] += self.turned[s].0[l] * noise[row];
                        self.bias[l][row] += self.turned[s].0[l] * bias[row];
                    }
                }
            }
        }
    }

    /// Straight emission of the channels from 1 on over the last steps.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "places are counted from zero")]
    fn emission(&mut self, fine: &Fine<One>, kept: usize) {
        let extra = fine.channels - 1;
        for l in 0..self.lanes {
            for s in 0..kept {
                let weight = self.weight[s].0[l];
                if weight > 0.0 {
                    let o = fine.ordinal[self.place[s].0[l] as usize] as usize;
                    let source = &fine.source[o * extra..(o + 1) * extra];
                    for (sum, source) in self.direct[l * extra..(l + 1) * extra].iter_mut().zip(source) {
                        *sum = source.get(0).mul_add(weight, *sum);
                    }
                }
            }
        }
    }

    /// Adds what a lane has collected to a pixel's sum.
    pub(super) fn take(&self, pieces: Option<&Pieces>, lane: usize, sight: &mut Sight<One>) {
        let extra = sight.extra.len();
        if self.sees_plate[lane] {
            sight.plate = sight.plate.plus(One::splat(self.through.0[lane]));
        }
        sight.direct = sight.direct.plus(One::splat(self.own.0[lane]));
        for c in 0..extra {
            let to = &mut sight.extra[c][0];
            *to = to.plus(One::splat(self.direct[lane * extra + c]));
        }
        if let Some(pieces) = pieces {
            let value = |row: usize| {
                let [sum, moment] =
                    self.sums[lane * pieces.pairs + row / 2].map(|pair| pair.as_chunks::<4>().0[row % 2]);
                let mut all = sum[0];
                for a in 0..3 {
                    let from = self.walk.entry[a].0[lane] - pieces.middle[a];
                    all += sum[1 + a].mul_add(from, moment[1 + a] * self.walk.slope[a].0[lane]);
                }
                One::splat(all.max(0.0))
            };
            sight.plate = sight.plate.plus(value(0));
            sight.medium = sight.medium.plus(value(1));
            for c in 0..extra {
                let to = &mut sight.extra[c][1];
                *to = to.plus(value(ROWS + c));
            }
            for row in 0..ROWS {
                sight.noise[row] = sight.noise[row].plus(One::splat(self.noise[lane][row]));
                sight.bias[row] = sight.bias[row].plus(One::splat(self.bias[lane][row]));
            }
        }
        let cells = u64::from(self.cells.0[lane].unsigned_abs());
        sight.met |= cells > 0;
        sight.weight += self.share[lane];
        sight.sights += 1;
        sight.cells += cells;
    }

    /// Ready for other sights.
    pub(super) fn clear(&mut self) {
        self.lanes = 0;
    }
}
