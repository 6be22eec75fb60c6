//! Sixteen sights at once through a medium of one spectral group (packet traversal, Wald et al., Computer Graphics
//! Forum 20, 153, 2001).
//!
//! Every lane steps from cell to cell on its own, and over an empty brick in one step; what can be computed side by side
//! is. In-scattered light is linear inside each piece, so a sight needs only the sums of weight · (1, x, y, z) times the
//! coefficients of the pieces, which are put together when it is complete. Positions are f32: the length inside a cell
//! errs by up to 2⁻²⁴ of the cells along the box, 3e-5 of a cell for 512 of them.

use super::bricks::{Brick, EDGE, EDGE_LOG, NONE};
use super::fine::Fine;
use super::gather::{OPAQUE, Sight};
use super::lanes::{Floats, Ints, LANES, NEVER, NO_INTS, STILL, ZEROS, larger, smaller, whole};
use super::pieces::Pieces;
use super::plate::Plate;
use super::reconstruct::ROWS;
use super::spectrum::{One, Spectrum, narrow, split};
use super::vector::{Vector, along};

/// Steps between two rounds of light.
const STEPS: usize = 8;

/// The lanes, and what they collect.
pub(super) struct Packet {
    /// Entry into the box in cells from its lower corner, and cells per metre.
    entry: [Floats; 3],
    slope: [Floats; 3],
    /// Metres per cell with the sign of the direction, and what is added where it stands still.
    inverse: [Floats; 3],
    still: [Floats; 3],
    /// 1 where the sight goes to higher cells.
    upward: [Ints; 3],
    cell: [Ints; 3],
    /// Where the sight is and where it ends, in metres from its entry.
    at: Floats,
    end: Floats,
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
    /// Σ turned · coefficients and Σ turned · at · coefficients, `[lane · rows + row]`.
    sums: Vec<[[f32; 4]; 2]>,
    /// Straight emission of the channels from 1 on, `[lane · (channels − 1) + channel − 1]`.
    direct: Vec<f32>,
    noise: [[f32; ROWS]; LANES],
    bias: [[f32; ROWS]; LANES],
}

impl Packet {
    /// No lanes yet.
    pub(super) fn new(channels: usize) -> Self {
        Self {
            entry: [ZEROS; 3],
            slope: [ZEROS; 3],
            inverse: [ZEROS; 3],
            still: [ZEROS; 3],
            upward: [NO_INTS; 3],
            cell: [NO_INTS; 3],
            at: ZEROS,
            end: ZEROS,
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
            sums: vec![[[0.0; 4]; 2]; LANES * (1 + channels)],
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
    #[expect(clippy::cast_possible_truncation, reason = "clamped to the box, whose cells fit into i32")]
    pub(super) fn push(
        &mut self,
        fine: &Fine<One>,
        plate: Option<&Plate>,
        (origin, direction): (Vector, Vector),
        share: f32,
        errors: bool,
    ) {
        let l = self.lanes;
        let bricks = &fine.bricks;
        let hit = plate.and_then(|p| p.hit(origin, direction));
        let (start, end) = bricks.clip(origin, direction, hit.unwrap_or(f64::INFINITY)).unwrap_or((0.0, 0.0));
        let entry = bricks.units(along(origin, start, direction));
        for a in 0..3 {
            let slope = direction[a] / bricks.size[a];
            let moves = slope.abs() > STILL;
            self.entry[a].0[l] = narrow(entry[a]);
            self.slope[a].0[l] = narrow(slope);
            self.inverse[a].0[l] = if moves { narrow(1.0 / slope) } else { 0.0 };
            self.still[a].0[l] = if moves { 0.0 } else { NEVER };
            self.upward[a].0[l] = i32::from(slope > 0.0);
            let last = bricks.cells[a] - 1;
            self.cell[a].0[l] = entry[a].clamp(0.0, count(last)) as i32;
        }
        self.at.0[l] = 0.0;
        self.end.0[l] = narrow(end - start);
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
            // Idle lanes stand in a cell of the box and never move.
            for a in 0..3 {
                self.cell[a].0[l] = 0;
            }
            (self.at.0[l], self.end.0[l], self.through.0[l]) = (0.0, 0.0, 0.0);
            self.errors[l] = false;
        }
        // Every step changes a cell; rounding may turn it back once.
        let most = 2 * fine.bricks.cells.iter().sum::<usize>() + STEPS;
        let mut step = 0;
        let mut going = true;
        while going && step < most {
            let mut kept = 0;
            while kept < STEPS && going {
                going = self.step(fine, cuts, kept);
                kept += 1;
            }
            step += kept;
            each(self, kept);
        }
    }

    /// Follows all sights and collects what they see.
    #[inline(always)]
    pub(super) fn run(&mut self, fine: &Fine<One>, pieces: Option<&Pieces>) {
        self.sums.iter_mut().for_each(|s| *s = [[0.0; 4]; 2]);
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
        clippy::cast_precision_loss,
        reason = "cells stay inside the box, whose bricks, cells and places fit into 31 bits"
    )]
    fn step(&mut self, fine: &Fine<One>, cuts: &[Brick], kept: usize) -> bool {
        let bricks = &fine.bricks;
        let [_, ny, nz] = bricks.count.map(|n| n as i32);
        let last = bricks.cells.map(|n| n as i32 - 1);
        let low = EDGE as i32 - 1;
        let [cx, cy, cz] = self.cell;
        let (mut brick, mut local) = (NO_INTS, NO_INTS);
        for l in 0..LANES {
            let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]];
            brick.0[l] = ((x >> EDGE_LOG) * ny + (y >> EDGE_LOG)) * nz + (z >> EDGE_LOG);
            local.0[l] = (x & low) << (2 * EDGE_LOG) | (y & low) << EDGE_LOG | (z & low);
        }
        let (mut k, mut albedo, mut size) = (ZEROS, ZEROS, NO_INTS);
        let (mut first, mut down) = (NO_INTS, NO_INTS);
        for l in 0..LANES {
            let b = brick.0[l] as usize;
            let cells = bricks.list[b].first;
            if cells == NONE {
                size.0[l] = EDGE as i32;
            } else {
                let place = cells as usize + local.0[l] as usize;
                let [here, scattering] = fine.core[place];
                k.0[l] = here.get(0);
                albedo.0[l] = scattering.get(0);
                size.0[l] = 1;
                self.place[kept].0[l] = place as i32;
                if let Some(cut) = cuts.get(b) {
                    first.0[l] = cut.first as i32;
                    down.0[l] = (EDGE_LOG - cut.log) as i32;
                }
            }
        }
        let mut next = [ZEROS; 3];
        let mut base = [NO_INTS; 3];
        for a in 0..3 {
            for l in 0..LANES {
                let from = self.cell[a].0[l] & -size.0[l];
                base[a].0[l] = from;
                let face = from + if self.upward[a].0[l] == 1 { size.0[l] } else { 0 };
                next[a].0[l] =
                    (face as f32 - self.entry[a].0[l]).mul_add(self.inverse[a].0[l], self.still[a].0[l]);
            }
        }
        let mut leave = ZEROS;
        let mut exit = ZEROS;
        for l in 0..LANES {
            let least = smaller(smaller(next[0].0[l], next[1].0[l]), next[2].0[l]);
            leave.0[l] = least;
            exit.0[l] = larger(smaller(least, self.end.0[l]), self.at.0[l]);
        }
        for l in 0..LANES {
            let length = exit.0[l] - self.at.0[l];
            let depth = k.0[l] * length;
            let (passed, stopped) = split(depth);
            let weight = self.through.0[l] * stopped;
            self.through.0[l] *= passed;
            let turned = weight * albedo.0[l];
            self.own.0[l] += weight - turned;
            self.weight[kept].0[l] = weight;
            self.turned[kept].0[l] = turned;
            self.moment[kept].0[l] = turned * (0.5 * (exit.0[l] + self.at.0[l]));
            self.cells.0[l] += i32::from(depth > 0.0);
        }
        for l in 0..LANES {
            let shift = down.0[l];
            let log = EDGE_LOG as i32 - shift;
            let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]].map(|c| (c & low) >> shift);
            self.piece[kept].0[l] = first.0[l] + (((x << log) + y) << log) + z;
        }
        let mut inside = Ints([1; LANES]);
        for a in 0..3 {
            for l in 0..LANES {
                let (from, wide) = (base[a].0[l], size.0[l]);
                let place = whole(exit.0[l].mul_add(self.slope[a].0[l], self.entry[a].0[l]));
                let within = place.max(from).min(from + wide - 1);
                let beyond = if self.upward[a].0[l] == 1 { from + wide } else { from - 1 };
                let cell = if next[a].0[l] <= leave.0[l] { beyond } else { within };
                let kept = cell.max(0).min(last[a]);
                inside.0[l] &= i32::from(cell == kept);
                self.cell[a].0[l] = kept;
            }
        }
        let mut going = 0;
        for l in 0..LANES {
            self.at.0[l] = exit.0[l];
            let on = inside.0[l] == 1 && exit.0[l] < self.end.0[l] && self.through.0[l] > OPAQUE;
            self.end.0[l] = if on { self.end.0[l] } else { exit.0[l] };
            going |= i32::from(on);
        }
        going == 1
    }

    /// What is scattered into the sights over the last steps.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "pieces are counted from zero")]
    fn lit(&mut self, pieces: &Pieces, kept: usize) {
        let rows = pieces.rows;
        for l in 0..self.lanes {
            for row in 0..rows {
                let [mut sum, mut moment] = self.sums[l * rows + row];
                for s in 0..kept {
                    let line = pieces.lines[self.piece[s].0[l] as usize * rows + row];
                    let (turned, at) = (self.turned[s].0[l], self.moment[s].0[l]);
                    for i in 0..4 {
                        sum[i] = line[i].mul_add(turned, sum[i]);
                        moment[i] = line[i].mul_add(at, moment[i]);
                    }
                }
                self.sums[l * rows + row] = [sum, moment];
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
                    let o = fine.slot[self.place[s].0[l] as usize] as usize;
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
            let rows = pieces.rows;
            let value = |row: usize| {
                let [sum, moment] = self.sums[lane * rows + row];
                let mut all = sum[0];
                for a in 0..3 {
                    let from = self.entry[a].0[lane] - pieces.middle[a];
                    all += sum[1 + a].mul_add(from, moment[1 + a] * self.slope[a].0[lane]);
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

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn count(n: usize) -> f64 {
    n as f64
}
