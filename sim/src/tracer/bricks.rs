//! A two-level grid: bricks of 8³ cells, each cut into 1, 2, 4 or 8 blocks along its edges, empty bricks left out.
//!
//! Shallow trees are traversed faster than pointer octrees, and a brick's own resolution is all the adaptivity that
//! smooth media need. Steps are added up within a brick only, and a ray leaves a brick where the coarse level says, so
//! that segments add up to the chord along faces, edges and through corners; every loop is bounded.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over axes and rows step through several arrays at once"
)]

use super::lattice::clip_box;
use super::vector::{Vector, along};

/// Cells along the edge of a brick.
pub(super) const EDGE: usize = 8;

/// Its logarithm.
pub(super) const EDGE_LOG: u32 = 3;

/// Components below this count as zero: the ray would need 1e100 cells to leave its cell sideways.
const SMALLEST_COMPONENT: f64 = 1e-100;

/// Marks an empty brick.
pub(super) const NONE: u32 = u32::MAX;

/// One brick: where its blocks begin, and how finely it is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Brick {
    /// Place of its first block, or [`NONE`].
    pub(super) first: u32,
    /// log₂ of the number of blocks along an edge, at most 3.
    pub(super) log: u32,
}

impl Brick {
    /// A brick without blocks.
    pub(super) const EMPTY: Self = Self { first: NONE, log: 0 };

    /// Place of the block that holds a cell, given by its coordinates inside the brick.
    #[inline(always)]
    pub(super) fn place(self, x: usize, y: usize, z: usize) -> usize {
        let down = EDGE_LOG - self.log;
        self.first as usize + ((x >> down) << (2 * self.log) | (y >> down) << self.log | (z >> down))
    }

    /// Number of its blocks.
    pub(super) fn blocks(self) -> usize {
        if self.first == NONE { 0 } else { 1 << (3 * self.log) }
    }
}

/// A box of cells in bricks.
#[derive(Debug, Clone)]
pub(super) struct Bricks {
    pub(super) lower: Vector,
    upper: Vector,
    /// Edge lengths of a cell in metres.
    pub(super) size: Vector,
    /// Cells along x, y, z.
    pub(super) cells: [usize; 3],
    /// Bricks along x, y, z.
    pub(super) count: [usize; 3],
    /// All bricks, `[(x · ny + y) · nz + z]`.
    pub(super) list: Vec<Brick>,
}

impl Bricks {
    /// All bricks empty; `cells` along each axis between the corners.
    pub(super) fn new(lower: Vector, upper: Vector, cells: [usize; 3]) -> Self {
        let count = cells.map(|n| n.div_ceil(EDGE));
        let size = [0, 1, 2].map(|a| (upper[a] - lower[a]) / real(cells[a]));
        Self { lower, upper, size, cells, count, list: vec![Brick::EMPTY; count[0] * count[1] * count[2]] }
    }

    /// Coordinates of a brick.
    pub(super) fn at(&self, brick: usize) -> [usize; 3] {
        [
            brick / (self.count[1] * self.count[2]),
            brick / self.count[2] % self.count[1],
            brick % self.count[2],
        ]
    }

    /// A point given in cell units.
    #[inline(always)]
    pub(super) fn point(&self, units: Vector) -> Vector {
        let (low, size) = (self.lower, self.size);
        [low[0] + units[0] * size[0], low[1] + units[1] * size[1], low[2] + units[2] * size[2]]
    }

    /// Cell units of a point.
    #[inline(always)]
    pub(super) fn units(&self, point: Vector) -> Vector {
        let (low, size) = (self.lower, self.size);
        [(point[0] - low[0]) / size[0], (point[1] - low[1]) / size[1], (point[2] - low[2]) / size[2]]
    }

    /// The part of a ray (in units of its direction) inside the box and in front of the origin, if any.
    #[inline]
    pub(super) fn clip(&self, origin: Vector, direction: Vector, far: f64) -> Option<(f64, f64)> {
        clip_box(self.lower, self.upper, origin, direction, far)
    }

    /// The blocks of occupied bricks along a ray, from its origin to `far`, in order.
    #[inline(always)]
    pub(super) fn march(&self, origin: Vector, direction: Vector, far: f64) -> March<'_> {
        let (start, end) = self.clip(origin, direction, far).unwrap_or((0.0, 0.0));
        // Measuring from the entry point keeps the accuracy of rays that come from far away.
        let o = self.units(along(origin, start, direction));
        let d = [direction[0] / self.size[0], direction[1] / self.size[1], direction[2] / self.size[2]];
        let line = Line::new(o, d);
        let outer = Stepper::new(&line, 0.0, real(EDGE), [0; 3], self.count);
        let inner = outer;
        let brick = Brick::EMPTY;
        March {
            bricks: self,
            line,
            outer,
            inner,
            brick,
            start,
            length: end - start,
            t: 0.0,
            leave: 0.0,
            inside: false,
        }
    }
}

/// A part of a ray inside one block.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    /// Place of the block.
    pub(super) place: usize,
    /// Its coordinates in the brick, in blocks.
    pub(super) block: [usize; 3],
    /// Where it begins and ends, in units of the ray's direction.
    pub(super) start: f64,
    pub(super) end: f64,
}

/// A walk along a ray.
pub(super) struct March<'a> {
    bricks: &'a Bricks,
    line: Line,
    outer: Stepper,
    inner: Stepper,
    /// The brick in which the walk is.
    brick: Brick,
    start: f64,
    length: f64,
    /// Where the walk is, where it leaves the brick, and whether there are blocks left in it.
    t: f64,
    leave: f64,
    inside: bool,
}

impl March<'_> {
    /// The next block.
    #[inline(always)]
    pub(super) fn next(&mut self) -> Option<Segment> {
        loop {
            if self.inside {
                let end = self.inner.exit().min(self.leave);
                let [x, y, z] = self.inner.cell;
                let log = self.brick.log;
                let place = self.brick.first as usize + (x << (2 * log) | y << log | z);
                let start = self.t;
                self.inside = end < self.leave && self.inner.step();
                if end > start {
                    self.t = end;
                    let (start, end) = (self.start + start, self.start + end);
                    return Some(Segment { place, block: [x, y, z], start, end });
                }
            } else {
                // Here a brick begins, the first one too.
                self.t = self.leave;
                if self.t >= self.length {
                    return None;
                }
                let [x, y, z] = self.outer.cell;
                let brick = self.bricks.list[(x * self.bricks.count[1] + y) * self.bricks.count[2] + z];
                self.leave = self.outer.exit().min(self.length).max(self.t);
                if brick.first != NONE && self.leave > self.t {
                    let base = [x * EDGE, y * EDGE, z * EDGE];
                    let n = 1 << brick.log;
                    self.brick = brick;
                    self.inner = Stepper::new(&self.line, self.t, real(EDGE >> brick.log), base, [n, n, n]);
                    self.inside = true;
                }
                if !self.outer.step() {
                    // The last brick: nothing follows it.
                    self.length = self.leave;
                }
            }
        }
    }
}

/// A ray in cell units.
struct Line {
    o: Vector,
    inverse: Vector,
    /// +1, −1, or 0 for no motion along the axis.
    sign: Vector,
    d: Vector,
}

impl Line {
    #[inline(always)]
    fn new(o: Vector, d: Vector) -> Self {
        let mut line = Self { o, inverse: [f64::INFINITY; 3], sign: [0.0; 3], d };
        for a in 0..3 {
            if d[a].abs() >= SMALLEST_COMPONENT {
                line.inverse[a] = 1.0 / d[a];
                line.sign[a] = if d[a] > 0.0 { 1.0 } else { -1.0 };
            }
        }
        line
    }
}

/// Steps from block to block of one level.
#[derive(Clone, Copy)]
struct Stepper {
    cell: [usize; 3],
    /// Where the ray leaves the block along each axis, and what a step adds.
    next: Vector,
    delta: Vector,
    /// Steps left along each axis; negative once the level is left.
    left: [isize; 3],
    step: [isize; 3],
}

impl Stepper {
    /// Blocks of edge `stride` from the cell `base` on, `count` along each axis; begins at `t`.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_possible_wrap,
        reason = "positions are clamped to the level before they become indices"
    )]
    fn new(line: &Line, t: f64, stride: f64, base: [usize; 3], count: [usize; 3]) -> Self {
        let mut stepper =
            Self { cell: [0; 3], next: [f64::INFINITY; 3], delta: [0.0; 3], left: [0; 3], step: [0; 3] };
        for a in 0..3 {
            let base = real(base[a]);
            let position = (line.o[a] + t * line.d[a] - base) / stride;
            let cell = (position.max(0.0) as usize).min(count[a] - 1);
            stepper.cell[a] = cell;
            if line.sign[a] > 0.0 {
                stepper.next[a] = (base + real(cell + 1) * stride - line.o[a]) * line.inverse[a];
                stepper.left[a] = (count[a] - 1 - cell) as isize;
                stepper.step[a] = 1;
            } else if line.sign[a] < 0.0 {
                stepper.next[a] = (base + real(cell) * stride - line.o[a]) * line.inverse[a];
                stepper.left[a] = cell as isize;
                stepper.step[a] = -1;
            }
            stepper.delta[a] = stride * line.inverse[a] * line.sign[a];
        }
        stepper
    }

    /// Where the ray leaves the present block.
    #[inline(always)]
    fn exit(&self) -> f64 {
        self.next[0].min(self.next[1]).min(self.next[2])
    }

    /// To the next block, diagonally where the ray meets an edge; false where the level ends.
    #[inline(always)]
    #[expect(
        clippy::cast_sign_loss,
        clippy::cast_possible_wrap,
        reason = "stays in the level while steps are left"
    )]
    fn step(&mut self) -> bool {
        let exit = self.exit();
        let mut ended = false;
        for a in 0..3 {
            let crossed = self.next[a] <= exit;
            self.next[a] += if crossed { self.delta[a] } else { 0.0 };
            let moved = if crossed { self.step[a] } else { 0 };
            self.cell[a] = (self.cell[a] as isize + moved) as usize;
            self.left[a] -= isize::from(crossed);
            ended |= self.left[a] < 0;
        }
        !ended
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
#[inline(always)]
fn real(n: usize) -> f64 {
    n as f64
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cells of a small grid")]
mod tests {
    use super::*;

    /// Bricks of mixed resolution, some empty.
    fn mixed(cells: [usize; 3]) -> Bricks {
        let mut bricks = Bricks::new([-1.0, -0.5, 0.25], [1.0, 2.0, 0.75], cells);
        let mut first = 0;
        for (i, brick) in bricks.list.iter_mut().enumerate() {
            if i % 5 != 3 {
                *brick = Brick { first, log: u32::try_from(i % 4).unwrap() };
                first += u32::try_from(brick.blocks()).unwrap();
            }
        }
        bricks
    }

    fn full(n: usize, log: u32) -> Bricks {
        let mut bricks = Bricks::new([-1.0; 3], [1.0; 3], [n; 3]);
        let mut first = 0;
        for brick in &mut bricks.list {
            *brick = Brick { first, log };
            first += u32::try_from(brick.blocks()).unwrap();
        }
        bricks
    }

    fn chord(bricks: &Bricks, o: Vector, d: Vector) -> (f64, usize) {
        let (mut sum, mut steps, mut last) = (0.0, 0, f64::NEG_INFINITY);
        let mut march = bricks.march(o, d, f64::INFINITY);
        while let Some(Segment { start, end, .. }) = march.next() {
            assert!(end >= start && start >= last);
            last = end;
            sum += end - start;
            steps += 1;
        }
        (sum, steps)
    }

    #[test]
    fn segments_add_up_to_the_chord_on_faces_edges_and_corners() {
        for (n, log) in [(13, 3), (16, 2), (24, 0), (8, 1)] {
            let bricks = full(n, log);
            for d in [
                [1.0_f64, 0.0, 0.0],
                [0.0, -1.0, -0.0],
                [-0.0, 0.0, 1.0],
                [1e-30, 1.0, 0.0],
                [1.0, 1.0, 1.0],
                [-1.0, -1.0, -1.0],
                [1.0, -1.0, 0.0],
            ] {
                for i in 0..=n {
                    let p = -1.0 + 2.0 * i as f64 / n as f64;
                    let o = [0, 1, 2].map(|a: usize| if d[a].abs() < 1e-20 { p } else { -3.0 * d[a] });
                    let (sum, steps) = chord(&bricks, o, d);
                    // A ray that starts on an outer face and leaves through it has no chord.
                    let (start, end) = bricks.clip(o, d, f64::INFINITY).unwrap_or((0.0, 0.0));
                    assert!((sum - (end - start)).abs() < 1e-12, "{o:?} {d:?} {sum}");
                    assert!(steps <= 3 * n.next_multiple_of(EDGE));
                }
            }
        }
    }

    #[test]
    fn every_segment_lies_in_the_block_that_is_named() {
        let bricks = mixed([21, 37, 16]);
        let mut owner = Vec::new();
        for (i, brick) in bricks.list.iter().enumerate() {
            owner.resize(owner.len() + brick.blocks(), i);
        }
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
        };
        for k in 0..4000 {
            let scale = if k % 2 == 0 { 0.5 } else { 3.0 };
            let o = [scale * random(), scale * random() + 0.75, scale * random() + 0.5];
            let d = [random(), random(), if k % 3 == 0 { 0.0 } else { random() }];
            let mut covered = 0.0;
            let mut march = bricks.march(o, d, f64::INFINITY);
            while let Some(Segment { place, start: t0, end: t1, .. }) = march.next() {
                let middle = bricks.units(along(o, 0.5 * (t0 + t1), d));
                let cell = [0, 1, 2].map(|a| (middle[a] as usize).min(bricks.cells[a] - 1));
                let b = cell.map(|c| c / EDGE);
                let number = (b[0] * bricks.count[1] + b[1]) * bricks.count[2] + b[2];
                let c = cell.map(|c| c % EDGE);
                // Segments shorter than the rounding of places may be named by a neighbour.
                if t1 - t0 > 1e-12 {
                    assert_eq!(place, bricks.list[number].place(c[0], c[1], c[2]));
                    assert_eq!(owner[place], number);
                }
                covered += t1 - t0;
            }
            let length = bricks.clip(o, d, f64::INFINITY).map_or(0.0, |(a, b)| b - a);
            assert!(covered <= length + 1e-12);
        }
    }

    #[test]
    fn random_chords_add_up_from_inside_and_outside() {
        let bricks = full(20, 3);
        let mut state = 9_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
        };
        for k in 0..2000 {
            let scale = if k % 2 == 0 { 0.9 } else { 3.0 };
            let o = [scale * random(), scale * random(), scale * random()];
            let d = [random(), random(), random()];
            let (sum, _) = chord(&bricks, o, d);
            let length = bricks.clip(o, d, f64::INFINITY).map_or(0.0, |(a, b)| b - a);
            assert!((sum - length).abs() < 1e-12);
        }
    }

    #[test]
    fn empty_bricks_are_not_visited() {
        let mut bricks = Bricks::new([0.0; 3], [1.0; 3], [16; 3]);
        bricks.list[7] = Brick { first: 0, log: 3 };
        let middle = 8.5 / 16.0;
        let (sum, steps) = chord(&bricks, [-1.0, middle, middle], [1.0, 0.0, 0.0]);
        assert_eq!(steps, 8);
        assert!((sum - 0.5).abs() < 1e-15);
    }
}
