//! Where paths begin: a place in a leaf, as the camera sees it, and the direction of its sight.

use super::bricks::EDGE;
use super::cache::Leaves;
use super::camera::Sights;
use super::fine::{CELLS, Fine, is_occupied};
use super::lens::disc;
use super::sobol::Coordinates;
use super::spectrum::{Spectrum, narrow, ones};
use super::vector::{Vector, along};

/// Optical depth of a cell below which places in it are taken as uniform; bends the mean by less.
const THIN: f64 = 1e-6;

/// Mean free paths into a cell up to which groups are weighted against each other; fewer than one path in 10^8 gets there.
const FARTHEST: f64 = 20.0;

/// First of the two coordinates of a place in the aperture.
const APERTURE_DIMENSION: usize = 400_000;

/// A leaf's occupied cells with the running sums of what they scatter.
pub(super) struct Members {
    cells: Vec<(usize, [f64; 3], f32)>,
}

impl Members {
    /// Nothing.
    pub(super) const NONE: Self = Self { cells: Vec::new() };

    /// Those of a leaf in the `owner`-th occupied brick; `scattering` is that of every place.
    pub(super) fn of<S: Spectrum>(
        fine: &Fine<S>,
        scattering: &[f32],
        leaves: &Leaves,
        owner: u32,
        leaf: usize,
    ) -> Self {
        let b = leaves.occupied[owner as usize];
        let (brick, base) = (leaves.bricks.list[b], leaves.bricks.at(b).map(|c| c * EDGE));
        let first = owner as usize * CELLS;
        let block = leaf - brick.first as usize;
        let mask = (1 << brick.log) - 1;
        let edge = EDGE >> brick.log;
        let low = [block >> (2 * brick.log), block >> brick.log & mask, block & mask].map(|i| i * edge);
        let mut cells = Vec::with_capacity(edge * edge * edge);
        let mut sum = 0.0;
        for x in low[0]..low[0] + edge {
            for y in low[1]..low[1] + edge {
                let from = first + (x * EDGE + y) * EDGE + low[2];
                for (i, (&ordinal, &scattering)) in
                    fine.ordinal[from..from + edge].iter().zip(&scattering[from..from + edge]).enumerate()
                {
                    if is_occupied(ordinal) {
                        // A cell that does not scatter still gets a value, though nothing will be multiplied with it.
                        sum += scattering.clamp(f32::MIN_POSITIVE, 1e30);
                        let at = [x + base[0], y + base[1], low[2] + i + base[2]];
                        cells.push((from + i, at.map(|c| c as f64), sum));
                    }
                }
            }
        }
        Self { cells }
    }
}

/// Where a path from a leaf begins, the direction of the sight there, and its weight.
#[inline(always)]
pub(super) fn start<S: Spectrum>(
    fine: &Fine<S>,
    sights: &Sights,
    members: &Members,
    at: &Coordinates,
) -> Option<(Vector, Vector, S)> {
    let cells = &members.cells;
    let last = cells.last()?;
    let wanted = narrow(at.get(2)) * last.2;
    let (cell, corner, _) = cells[cells.partition_point(|c| c.2 <= wanted).min(cells.len() - 1)];
    let place = fine.bricks.point([corner[0] + at.get(3), corner[1] + at.get(4), corner[2] + at.get(5)]);
    let (direction, distance) = if sights.has_lens() {
        // The mean over the aperture: what sights through one place differ by is left to the straight part.
        sights.towards_through(place, disc(at.get(APERTURE_DIMENSION), at.get(APERTURE_DIMENSION + 1)))
    } else {
        sights.towards(place)
    };
    (distance > 0.0).then(|| {
        let (place, weight) = seen_place(fine, cell, corner, place, direction);
        (place, direction, weight)
    })
}

/// Moves a uniform place in a cell along its sight to where the camera sees the cell scatter: exponentially towards the
/// near side, with the groups' weights against the mean. This makes the mean over samples the very mean that the
/// gather needs, however the source function falls off inside an opaque cell.
#[inline(always)]
fn seen_place<S: Spectrum>(
    fine: &Fine<S>,
    cell: usize,
    corner: Vector,
    start: Vector,
    direction: Vector,
) -> (Vector, S) {
    let low = fine.bricks.point(corner);
    let high = fine.bricks.point([corner[0] + 1.0, corner[1] + 1.0, corner[2] + 1.0]);
    let (mut before, mut behind) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        if direction[a].abs() > 1e-100 {
            let inverse = 1.0 / direction[a];
            let (t0, t1) = ((low[a] - start[a]) * inverse, (high[a] - start[a]) * inverse);
            before = before.max(t0.min(t1));
            behind = behind.min(t0.max(t1));
        }
    }
    let chord = behind - before;
    let k = f64::from(fine.core[cell][0].sum()) / fine.groups as f64;
    let depth = k * chord;
    if depth.is_nan() || depth < THIN {
        return (start, ones(fine.groups));
    }
    let open = -(-depth).exp_m1();
    let fraction = (-before / chord).clamp(0.0, 1.0);
    let place = (-(-fraction * open).ln_1p() / k).min(chord);
    let share = narrow(open / depth);
    let weight = if S::WIDTH == 1 {
        S::splat(share)
    } else {
        // e^((k̄ − k) s) for each group, kept finite.
        let (through, _) = fine.core[cell][0].split(narrow(place));
        ones::<S>(fine.groups).times(through).scaled(share * narrow((k * place).min(FARTHEST).exp()))
    };
    (along(start, before + place, direction), weight)
}
