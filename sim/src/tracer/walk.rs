//! Many rays side by side, each stepping from block to block of a two-level grid on its own, and over an empty brick in
//! one step (packet traversal, Wald et al., Computer Graphics Forum 20, 153, 2001).
//!
//! Positions are f32 in cells: the length inside a cell errs by up to 2⁻²⁴ of the cells along the box, 3e-5 of a cell for
//! 512 of them.

use super::bricks::{Bricks, EDGE, EDGE_LOG, NONE};
use super::lanes::{Floats, Ints, LANES, NO_INTS, ZEROS, larger, smaller, whole};
use super::spectrum::narrow;
use super::vector::{Vector, along};

/// Farther than any cell: where a ray never leaves a cell along an axis.
const NEVER: f32 = 1e30;

/// Smaller components of a direction in cells per metre count as none.
const STILL: f64 = 1e-20;

/// The rays.
pub(super) struct Walk {
    /// Entry into the box in cells from its lower corner, and cells per metre.
    pub(super) entry: [Floats; 3],
    pub(super) slope: [Floats; 3],
    /// Metres per cell with the sign of the direction, and what is added where it stands still.
    inverse: [Floats; 3],
    still: [Floats; 3],
    /// 1 where the ray goes to higher cells.
    upward: [Ints; 3],
    cell: [Ints; 3],
    /// Where the ray is and where it ends, in metres from its entry.
    pub(super) at: Floats,
    pub(super) end: Floats,
    /// Steps that it may still take.
    left: Ints,
}

/// What the rays crossed in one step.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// Number of the brick.
    pub(super) brick: Ints,
    /// Place of the block, or −1 in an empty brick.
    pub(super) place: Ints,
    /// The cell in which the ray was.
    pub(super) cell: [Ints; 3],
    /// Where it was, and where it left; the same for rays that had ended.
    pub(super) start: Floats,
    pub(super) exit: Floats,
    /// 1 where it is still in the box, and has not taken more steps than there are cells.
    inside: Ints,
}

/// The place of an empty brick's block.
pub(super) const NOWHERE: i32 = NONE.cast_signed();

impl Walk {
    /// Rays that have ended.
    pub(super) fn new() -> Self {
        Self {
            entry: [ZEROS; 3],
            slope: [ZEROS; 3],
            inverse: [ZEROS; 3],
            still: [ZEROS; 3],
            upward: [NO_INTS; 3],
            cell: [NO_INTS; 3],
            at: ZEROS,
            end: ZEROS,
            left: NO_INTS,
        }
    }

    /// Sends a ray through the box, up to `far` in units of the unit vector `direction`; where it enters.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "clamped to the box, whose cells fit into i32"
    )]
    pub(super) fn send(
        &mut self,
        bricks: &Bricks,
        lane: usize,
        (origin, direction): (Vector, Vector),
        far: f64,
    ) -> f64 {
        let (start, end) = bricks.clip(origin, direction, far).unwrap_or((0.0, 0.0));
        let entry = bricks.units(along(origin, start, direction));
        for a in 0..3 {
            let slope = direction[a] / bricks.size[a];
            let moves = slope.abs() > STILL;
            self.entry[a].0[lane] = narrow(entry[a]);
            self.slope[a].0[lane] = narrow(slope);
            self.inverse[a].0[lane] = if moves { narrow(1.0 / slope) } else { 0.0 };
            self.still[a].0[lane] = if moves { 0.0 } else { NEVER };
            self.upward[a].0[lane] = i32::from(slope > 0.0);
            self.cell[a].0[lane] = (larger(narrow(entry[a]), 0.0) as i32).min(bricks.cells[a] as i32 - 1);
        }
        self.at.0[lane] = 0.0;
        self.end.0[lane] = narrow(end - start);
        // Every step changes a cell; rounding may turn it back once.
        self.left.0[lane] = 2 * bricks.cells.iter().sum::<usize>() as i32 + 8;
        start
    }

    /// Ends a ray where it is.
    #[inline(always)]
    pub(super) fn stop(&mut self, lane: usize) {
        self.end.0[lane] = self.at.0[lane];
    }

    /// Whether a ray has come to its end.
    #[inline(always)]
    pub(super) fn has_ended(&self, lane: usize) -> bool {
        self.at.0[lane] >= self.end.0[lane]
    }

    /// Ends the rays that leave the box, have come to their ends, or are not wanted any more; how many go on.
    #[inline(always)]
    pub(super) fn settle(&mut self, step: &Step, wanted: impl Fn(usize) -> bool) -> i32 {
        let mut going = 0;
        for l in 0..LANES {
            let on = step.inside.0[l] == 1 && self.at.0[l] < self.end.0[l] && wanted(l);
            self.end.0[l] = if on { self.end.0[l] } else { self.at.0[l] };
            going += i32::from(on);
        }
        going
    }

    /// One step of every ray, to be settled before the next one. `CELLS` promises that every occupied brick is cut into its cells, which takes less time.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "cells stay inside the box, whose bricks, cells and places fit into 31 bits"
    )]
    pub(super) fn step<const CELLS: bool>(&mut self, bricks: &Bricks) -> Step {
        let [_, ny, nz] = bricks.count.map(|n| n as i32);
        let last = bricks.cells.map(|n| n as i32 - 1);
        let low = EDGE as i32 - 1;
        let start = self.at;
        let was = self.cell;
        let [cx, cy, cz] = was;
        let mut brick = NO_INTS;
        for l in 0..LANES {
            let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]];
            brick.0[l] = ((x >> EDGE_LOG) * ny + (y >> EDGE_LOG)) * nz + (z >> EDGE_LOG);
        }
        let (mut place, mut size) = (NO_INTS, NO_INTS);
        if CELLS {
            let mut local = NO_INTS;
            for l in 0..LANES {
                let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]].map(|c| c & low);
                local.0[l] = x << (2 * EDGE_LOG) | y << EDGE_LOG | z;
            }
            for l in 0..LANES {
                let first = bricks.list[brick.0[l] as usize].first as i32;
                let empty = first == NOWHERE;
                place.0[l] = if empty { NOWHERE } else { first + local.0[l] };
                size.0[l] = if empty { EDGE as i32 } else { 1 };
            }
        } else {
            let (mut first, mut down) = (NO_INTS, NO_INTS);
            for l in 0..LANES {
                let cut = bricks.list[brick.0[l] as usize];
                first.0[l] = cut.first as i32;
                // An empty brick is one block.
                down.0[l] = EDGE_LOG as i32 - cut.log as i32;
            }
            for l in 0..LANES {
                let shift = down.0[l];
                let log = EDGE_LOG as i32 - shift;
                let [x, y, z] = [cx.0[l], cy.0[l], cz.0[l]].map(|c| (c & low) >> shift);
                place.0[l] = first.0[l] + (((x << log) + y) << log) + z;
                size.0[l] = 1 << shift;
            }
        }
        let mut next = [ZEROS; 3];
        let mut base = [NO_INTS; 3];
        for a in 0..3 {
            for l in 0..LANES {
                let from = was[a].0[l] & -size.0[l];
                base[a].0[l] = from;
                let face = from + if self.upward[a].0[l] == 1 { size.0[l] } else { 0 };
                next[a].0[l] =
                    (face as f32 - self.entry[a].0[l]).mul_add(self.inverse[a].0[l], self.still[a].0[l]);
            }
        }
        let (mut leave, mut exit) = (ZEROS, ZEROS);
        for l in 0..LANES {
            let least = smaller(smaller(next[0].0[l], next[1].0[l]), next[2].0[l]);
            leave.0[l] = least;
            exit.0[l] = larger(smaller(least, self.end.0[l]), start.0[l]);
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
        for l in 0..LANES {
            self.left.0[l] -= 1;
            inside.0[l] = if self.left.0[l] > 0 { inside.0[l] } else { 0 };
        }
        self.at = exit;
        Step { brick, place, cell: was, start, exit, inside }
    }
}
