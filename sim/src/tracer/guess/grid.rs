//! Guesses for a grid: constant in each cell, from values at the crossings of a few planes.
//!
//! A function that jumps between cells has no derivative. Its transport equation is used in its integral form instead:
//! ψ = Σ over segments of w (∫ k_sca V e^−τ ds − φ at the collision where the segment starts), exact sums over the cells.

use super::{Family, Flight, Guess, Tally};
use crate::light::phase::PhaseFunction;
use crate::light::phase::truncation::moments;
use crate::tracer::lattice::Lattice;
use crate::tracer::medium::{EMPTY, GridMedium};
use crate::tracer::vector::Vector;

/// Planes along one axis; between neighbours lies an equal share of what scatters.
const PLANES: usize = 5;

/// Functions of the direction: 1 and its three components.
const PARTS: usize = 4;

/// Most entries of the table of a fitted guess.
const TABLE_MAX: usize = 1 << 23;

#[derive(Debug, Clone)]
pub(super) struct GridFamily {
    planes: [usize; 3],
    /// Along each axis and for each cell, the plane below and the weight of the one above.
    places: [Vec<(usize, f64)>; 3],
    /// Cell of each ordinal.
    cells: Vec<[u32; 3]>,
    /// Mean cosine.
    cosine: f64,
}

impl GridFamily {
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 cells, as EMPTY demands")]
    pub(super) fn new(
        lattice: &Lattice,
        medium: &GridMedium,
        group: usize,
        phase: &PhaseFunction,
    ) -> Option<Self> {
        let occupied = medium.occupied();
        if occupied == 0 || occupied * PARTS * (1 + medium.channels) > TABLE_MAX {
            return None;
        }
        let mut cells = vec![[0; 3]; occupied];
        let mut sums = lattice.cells.map(|n| vec![0.0; n]);
        let [_, ny, nz] = lattice.cells;
        for (at, &ordinal) in lattice.index.iter().enumerate() {
            if ordinal == EMPTY {
                continue;
            }
            let cell = [at / (ny * nz), at / nz % ny, at % nz];
            cells[ordinal as usize] = cell.map(|c| c as u32);
            // Rooted, so that dense cells do not take all planes.
            let scatters = medium.k_sca[ordinal as usize * medium.groups + group].sqrt();
            for a in 0..3 {
                sums[a][cell[a]] += scatters;
            }
        }
        let mut planes = [1; 3];
        let places = [0, 1, 2].map(|a| {
            let levels = planes_of(&sums[a]);
            planes[a] = levels.len();
            (0..sums[a].len()).map(|cell| between(&levels, cell as f64 + 0.5)).collect()
        });
        Some(Self { planes, places, cells, cosine: moments(phase, 2)[1] })
    }

    /// Calls `sink` with the ordinal and weight of the crossings around a cell.
    #[inline(always)]
    fn around(&self, ordinal: u32, mut sink: impl FnMut(usize, f64)) {
        let cell = self.cells[ordinal as usize];
        let [x, y, z] = [0, 1, 2].map(|a| self.places[a][cell[a] as usize]);
        for (i, wx) in [(x.0, 1.0 - x.1), (x.0 + 1, x.1)] {
            for (j, wy) in [(y.0, 1.0 - y.1), (y.0 + 1, y.1)] {
                for (k, wz) in [(z.0, 1.0 - z.1), (z.0 + 1, z.1)] {
                    let weight = wx * wy * wz;
                    if weight != 0.0 {
                        sink((i * self.planes[1] + j) * self.planes[2] + k, weight);
                    }
                }
            }
        }
    }

    fn add(&self, cell: u32, parts: [f64; PARTS], features: &mut [f64]) {
        self.around(cell, |crossing, weight| {
            super::add(&mut features[crossing * PARTS..][..PARTS], weight, &parts);
        });
    }

    /// The functions of the direction after averaging over what is scattered into it, times `factor`.
    #[inline(always)]
    fn averaged(&self, direction: Vector, factor: f64) -> [f64; PARTS] {
        let own = factor * self.cosine;
        [factor, own * direction[0], own * direction[1], own * direction[2]]
    }
}

impl Guess for GridFamily {
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally) {
        let mut before = 0.0;
        for (piece, &scattered) in flight.pieces.iter().zip(flight.scattered) {
            self.add(piece.cell, self.averaged(flight.direction, scattered - before), &mut tally.features);
            before = scattered;
        }
    }

    fn fly(&self, flight: &Flight<'_>, cell: u32, weight: f64, tally: &mut Tally) {
        let [x, y, z] = flight.direction.map(|c| -weight * c);
        self.add(cell, [-weight, x, y, z], &mut tally.features);
        let mut before = 0.0;
        for (piece, &scattered) in flight.pieces.iter().zip(flight.scattered) {
            let parts = self.averaged(flight.direction, weight * (scattered - before));
            self.add(piece.cell, parts, &mut tally.features);
            before = scattered;
        }
    }

    fn collide(&self, _: Vector, _: Vector, _: f64, _: &mut Tally) {}
}

impl Family for GridFamily {
    fn len(&self) -> usize {
        self.planes.iter().product::<usize>() * PARTS
    }

    fn subtract(&self, _: Vector, direction: Vector, cell: u32, tally: &mut Tally) {
        let [x, y, z] = direction;
        self.add(cell, [-1.0, -x, -y, -z], &mut tally.features);
    }

    fn fitted(&self, coefficients: &[f64], scores: usize) -> Box<dyn Guess> {
        let mut table = vec![[0.0; PARTS]; self.cells.len() * scores];
        for (ordinal, values) in (0..).zip(table.chunks_exact_mut(scores)) {
            self.around(ordinal, |crossing, weight| {
                for (part, c) in
                    coefficients[crossing * PARTS * scores..].chunks_exact(scores).take(PARTS).enumerate()
                {
                    for (value, c) in values.iter_mut().zip(c) {
                        value[part] += weight * c;
                    }
                }
            });
        }
        Box::new(GridGuess { scores, cosine: self.cosine, table })
    }
}

/// A combination of the family's functions for each score.
struct GridGuess {
    scores: usize,
    cosine: f64,
    /// `[ordinal][score]`.
    table: Vec<[f64; PARTS]>,
}

impl GridGuess {
    #[inline(always)]
    fn add(&self, cell: u32, factor: f64, direction: Vector, scores: &mut [f64]) {
        let table = &self.table[cell as usize * self.scores..][..self.scores];
        for (score, [mean, x, y, z]) in scores.iter_mut().zip(table) {
            *score += factor * (mean + x * direction[0] + y * direction[1] + z * direction[2]);
        }
    }

    #[inline(always)]
    fn along(&self, flight: &Flight<'_>, weight: f64, scores: &mut [f64]) {
        let direction = flight.direction.map(|c| self.cosine * c);
        let mut before = 0.0;
        for (piece, &scattered) in flight.pieces.iter().zip(flight.scattered) {
            self.add(piece.cell, weight * (scattered - before), direction, scores);
            before = scattered;
        }
    }
}

impl Guess for GridGuess {
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally) {
        self.along(flight, 1.0, &mut tally.scores);
    }

    fn fly(&self, flight: &Flight<'_>, cell: u32, weight: f64, tally: &mut Tally) {
        self.add(cell, -weight, flight.direction, &mut tally.scores);
        self.along(flight, weight, &mut tally.scores);
    }

    fn collide(&self, _: Vector, _: Vector, _: f64, _: &mut Tally) {}
}

/// Places of the planes in cell units: at the ends of what is occupied, and where the sum passes equal shares.
fn planes_of(sums: &[f64]) -> Vec<f64> {
    let total: f64 = sums.iter().sum();
    let (Some(first), Some(last)) = (sums.iter().position(|s| *s > 0.0), sums.iter().rposition(|s| *s > 0.0))
    else {
        return vec![0.0];
    };
    let mut planes = vec![first as f64];
    let mut before = 0.0;
    for (cell, sum) in sums.iter().enumerate() {
        let mut wanted = planes.len() as f64 / (PLANES - 1) as f64 * total;
        while planes.len() < PLANES - 1 && *sum > 0.0 && before + sum >= wanted {
            planes.push(cell as f64 + (wanted - before) / sum);
            wanted = planes.len() as f64 / (PLANES - 1) as f64 * total;
        }
        before += sum;
    }
    planes.push((last + 1) as f64);
    // Planes in one cell tell nothing apart.
    planes.dedup_by(|next, kept| *next - *kept < 0.5);
    planes
}

/// The plane below a place and the weight of the next.
fn between(planes: &[f64], place: f64) -> (usize, f64) {
    let below = planes.partition_point(|p| *p <= place).clamp(1, planes.len().max(2) - 1) - 1;
    match planes.get(below + 1) {
        Some(next) => (below, ((place - planes[below]) / (next - planes[below])).clamp(0.0, 1.0)),
        None => (below, 0.0),
    }
}
