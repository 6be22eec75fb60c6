//! Walks of rays through a regular lattice of cells, empty bricks of cells skipped.
//!
//! Cell boundaries are compared as integers in cell units, so that a ray along faces, edges or through corners takes
//! the same cells on its way in and out; every loop is bounded by the number of cells along the three axes.

use super::medium::EMPTY;
use super::vector::{Vector, along};

/// Cells along one edge of a brick of the upper level.
const BRICK: usize = 4;

/// Components below this count as zero: the ray would need 1e100 m to leave its cell sideways.
const SMALLEST_COMPONENT: f64 = 1e-100;

/// A box cut into equal cells, with the places of the occupied ones.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    lower: Vector,
    upper: Vector,
    /// Edge lengths of a cell in metres.
    pub(super) size: Vector,
    /// Cells along x, y, z.
    pub(super) cells: [usize; 3],
    bricks: [usize; 3],
    occupied: Vec<bool>,
    /// Ordinal of each cell or [`EMPTY`].
    pub(super) index: Vec<u32>,
}

impl Lattice {
    /// A lattice over the box; `index` as in `GridMedium`. The caller has checked the shapes.
    #[expect(clippy::cast_precision_loss, reason = "cell counts are far below 2^53")]
    pub(super) fn new(lower: Vector, upper: Vector, cells: [usize; 3], index: Vec<u32>) -> Self {
        let bricks = cells.map(|n| n.div_ceil(BRICK));
        let mut occupied = vec![false; bricks[0] * bricks[1] * bricks[2]];
        for x in 0..cells[0] {
            for y in 0..cells[1] {
                for z in 0..cells[2] {
                    if index[(x * cells[1] + y) * cells[2] + z] != EMPTY {
                        occupied[((x / BRICK) * bricks[1] + y / BRICK) * bricks[2] + z / BRICK] = true;
                    }
                }
            }
        }
        let size = [0, 1, 2].map(|a| (upper[a] - lower[a]) / cells[a] as f64);
        Self { lower, upper, size, cells, bricks, occupied, index }
    }

    /// The part of a ray (in units of its direction) inside the box and in front of the origin, if any.
    #[inline]
    pub(super) fn clip(&self, origin: Vector, direction: Vector, far: f64) -> Option<(f64, f64)> {
        clip_box(self.lower, self.upper, origin, direction, far)
    }

    /// Visits the occupied cells along a ray in order: ordinal, start and end in units of `direction`. The visitor
    /// returns false to stop.
    #[inline(always)]
    pub(super) fn walk(
        &self,
        origin: Vector,
        direction: Vector,
        far: f64,
        mut visit: impl FnMut(u32, f64, f64) -> bool,
    ) {
        let Some((start, end)) = self.clip(origin, direction, far) else { return };
        // Measuring from the entry point keeps the accuracy of rays that come from far away.
        let entry = along(origin, start, direction);
        let o = [0, 1, 2].map(|a| (entry[a] - self.lower[a]) / self.size[a]);
        let d = [0, 1, 2].map(|a| direction[a] / self.size[a]);
        let whole = [self.bricks[0] * BRICK, self.bricks[1] * BRICK, self.bricks[2] * BRICK];
        let length = end - start;
        steps::<BRICK>(o, d, 0.0, length, [0; 3], whole, |brick, t0, t1| {
            let [x, y, z] = brick;
            if !self.occupied[(x * self.bricks[1] + y) * self.bricks[2] + z] {
                return true;
            }
            let low = brick.map(|b| b * BRICK);
            let high = [0, 1, 2].map(|a| (low[a] + BRICK).min(self.cells[a]));
            steps::<1>(o, d, t0, t1, low, high, |[x, y, z], t0, t1| {
                let ordinal = self.index[(x * self.cells[1] + y) * self.cells[2] + z];
                ordinal == EMPTY || t1 <= t0 || visit(ordinal, start + t0, start + t1)
            })
        });
    }
}

/// Steps through cells of edge `STRIDE` (in cell units) between `t0` and `t1`; true when the end was reached.
#[inline(always)]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "positions are clamped to the lattice before they become indices"
)]
fn steps<const STRIDE: usize>(
    o: Vector,
    d: Vector,
    t0: f64,
    t1: f64,
    low: [usize; 3],
    high: [usize; 3],
    mut visit: impl FnMut([usize; 3], f64, f64) -> bool,
) -> bool {
    let mut cell = [0_usize; 3];
    let mut next = [f64::INFINITY; 3];
    let (first, last) = (low.map(|l| l / STRIDE), high.map(|h| h.div_ceil(STRIDE) - 1));
    for a in 0..3 {
        let position = (o[a] + t0 * d[a]) / STRIDE as f64;
        cell[a] = (position.max(0.0) as usize).clamp(first[a], last[a]);
        if d[a].abs() >= SMALLEST_COMPONENT {
            let plane = if d[a] > 0.0 { cell[a] + 1 } else { cell[a] };
            next[a] = ((plane * STRIDE) as f64 - o[a]) / d[a];
        }
    }
    let mut t = t0;
    loop {
        let axis = if next[0] <= next[1] {
            if next[0] <= next[2] { 0 } else { 2 }
        } else if next[1] <= next[2] {
            1
        } else {
            2
        };
        let end = next[axis].min(t1).max(t);
        if !visit(cell, t, end) {
            return false;
        }
        if next[axis] >= t1 {
            return true;
        }
        t = end;
        if d[axis] > 0.0 {
            if cell[axis] == last[axis] {
                return true;
            }
            cell[axis] += 1;
            // Recomputed, not accumulated: the error stays that of one rounding.
            next[axis] = (((cell[axis] + 1) * STRIDE) as f64 - o[axis]) / d[axis];
        } else {
            if cell[axis] == first[axis] {
                return true;
            }
            cell[axis] -= 1;
            next[axis] = ((cell[axis] * STRIDE) as f64 - o[axis]) / d[axis];
        }
    }
}

/// The part of a ray inside a box, in units of its direction, from 0 to `far`; none where it misses or only touches.
#[inline]
pub(super) fn clip_box(
    lower: Vector,
    upper: Vector,
    origin: Vector,
    direction: Vector,
    far: f64,
) -> Option<(f64, f64)> {
    let (mut start, mut end) = (0.0_f64, far);
    for a in 0..3 {
        if direction[a].abs() < SMALLEST_COMPONENT {
            if origin[a] < lower[a] || origin[a] > upper[a] {
                return None;
            }
        } else {
            let (t0, t1) = ((lower[a] - origin[a]) / direction[a], (upper[a] - origin[a]) / direction[a]);
            start = start.max(t0.min(t1));
            end = end.min(t0.max(t1));
        }
    }
    (start < end).then_some((start, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full(n: usize) -> Lattice {
        Lattice::new([-1.0; 3], [1.0; 3], [n; 3], (0..u32::try_from(n * n * n).unwrap()).collect())
    }

    fn chord(lattice: &Lattice, o: Vector, d: Vector) -> (f64, usize) {
        let (mut sum, mut steps, mut last) = (0.0, 0, f64::NEG_INFINITY);
        lattice.walk(o, d, f64::INFINITY, |_, t0, t1| {
            assert!(t1 > t0 && t0 >= last);
            last = t1;
            sum += t1 - t0;
            steps += 1;
            true
        });
        (sum, steps)
    }

    #[test]
    fn segments_add_up_to_the_chord_on_faces_edges_and_corners() {
        let n = 13;
        let lattice = full(n);
        for d in [
            [1.0_f64, 0.0, 0.0],
            [0.0, -1.0, -0.0],
            [-0.0, 0.0, 1.0],
            [1e-30, 1.0, 0.0],
            [1.0, 1.0, 1.0],
            [1.0, -1.0, 0.0],
        ] {
            for i in 0..=n {
                let p = -1.0 + 2.0 * i as f64 / n as f64;
                let o = [0, 1, 2].map(|a: usize| if d[a].abs() < 1e-20 { p } else { -3.0 * d[a] });
                let (sum, steps) = chord(&lattice, o, d);
                // A ray that starts on an outer face and leaves through it has no chord.
                let (start, end) = lattice.clip(o, d, f64::INFINITY).unwrap_or((0.0, 0.0));
                assert!((sum - (end - start)).abs() < 1e-12, "{o:?} {d:?} {sum}");
                assert!(steps <= 3 * n);
            }
        }
    }

    #[test]
    fn random_chords_add_up_from_inside_and_outside() {
        let lattice = full(10);
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
        };
        for k in 0..2000 {
            let scale = if k % 2 == 0 { 0.9 } else { 3.0 };
            let o = [scale * random(), scale * random(), scale * random()];
            let d = [random(), random(), random()];
            let (sum, _) = chord(&lattice, o, d);
            let length = lattice.clip(o, d, f64::INFINITY).map_or(0.0, |(a, b)| b - a);
            assert!((sum - length).abs() < 1e-12);
        }
    }

    #[test]
    fn empty_bricks_are_not_visited() {
        let n: usize = 16;
        let mut index = vec![EMPTY; n * n * n];
        index[(8 * n + 8) * n + 8] = 0;
        let lattice = Lattice::new([0.0; 3], [1.0; 3], [n; 3], index);
        assert_eq!(lattice.occupied.iter().filter(|&&o| o).count(), 1);
        let middle = 8.5 / 16.0;
        let (sum, steps) = chord(&lattice, [-1.0, middle, middle], [1.0, 0.0, 0.0]);
        assert_eq!(steps, 1);
        assert!((sum - 1.0 / 16.0).abs() < 1e-15);
    }
}
