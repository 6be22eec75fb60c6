//! Inverse cumulative distributions in constant time: cells in which the density is linear in the cosine.
//!
//! In such a cell the inverse is one square root, and the density that is sampled can be evaluated exactly. Cells hold
//! the exact mass and the exact first moment of the density they stand for, so that the distribution is exact at their
//! ends and the mean cosine is exact; their number follows from the error wanted inside them.

use crate::light::quadrature::gauss_legendre;

/// Points of the Gauss rule on a piece.
const POINTS: usize = 6;
/// Where inside a piece its distribution is compared, on (−1, 1).
const COMPARED: [f64; 7] = [-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75];
/// What the points compared may miss of the largest error: one arch over four steps that peaks between two of them
/// is seen to 1 − 1/16, the rest is for narrower ones.
const UNSEEN: f64 = 1.2;
/// A piece is halved at most this often.
const HALVINGS_MAX: usize = 20;
/// Most cells; beyond it the error is what it is, and reported.
const CELLS_MAX: usize = 1 << 16;
/// Largest change of the mean cosine by a cell whose density would have to be negative at one end.
const MEAN_DEFECT: f64 = 1e-10;
/// Bins per octave of the versine, as a power of two, and the smallest octave.
const OCTAVE_BITS: u32 = 5;
const SMALLEST_OCTAVE: i32 = -45;

/// A density p over the versine v = 1 − cos θ, ½∫p dv = 1.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    cells: Vec<Cell>,
    /// First cell to look at for a share in each of as many equal bins as there are cells.
    by_share: Vec<u32>,
    /// The cell at the lower end of each bin of the versine, bins logarithmic.
    by_versine: Vec<u32>,
    /// Largest distance of the distribution from that it stands for.
    pub(super) error: f64,
    /// What the masses summed to before they were divided by it.
    pub(super) norm: f64,
}

#[derive(Debug, Clone, Copy)]
struct Cell {
    /// Share of the light at smaller angles.
    share: f64,
    /// Versine at the start.
    versine: f64,
    width: f64,
    mass: f64,
    /// Relative rise of the density from the middle to the end, in [−1, 1].
    tilt: f64,
}

impl Cells {
    /// Cells for the density `p` (of angles in radians; not negative, of any norm), smooth between `bounds` (angles
    /// rising from 0 to π), so that the distribution is nowhere off by more than `target`. `None` for a density
    /// without mass.
    pub(super) fn new(bounds: &[f64], target: f64, p: &dyn Fn(&[f64]) -> Vec<f64>) -> Option<Self> {
        let rule = Rule::new();
        let pieces = rule.pieces(bounds, p);
        let norm: f64 = pieces.iter().map(|piece| piece.mass).sum();
        if !(norm > 0.0 && norm.is_finite()) {
            return None;
        }
        let mut builder = Builder { rule: &rule, p, norm, target, cells: Vec::new(), error: 0.0 };
        builder.cover(&pieces);
        let Builder { mut cells, error, .. } = builder;
        let norm: f64 = cells.iter().map(|cell| cell.mass).sum();
        let mut share = 0.0;
        for cell in &mut cells {
            cell.mass /= norm;
            cell.share = share;
            share += cell.mass;
        }
        let by_share = guide_by_share(&cells);
        let by_versine = guide_by_versine(&cells);
        Some(Self { cells, by_share, by_versine, error: error / norm, norm })
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// The density at a versine.
    #[inline]
    pub(super) fn value(&self, versine: f64) -> f64 {
        let cell = self.at(versine);
        let y = ((versine - cell.versine) / cell.width).clamp(0.0, 1.0);
        2.0 * cell.mass / cell.width * (1.0 + cell.tilt * (2.0 * y - 1.0))
    }

    /// Share of the light below a versine.
    pub(super) fn within(&self, versine: f64) -> f64 {
        let cell = self.at(versine);
        let y = ((versine - cell.versine) / cell.width).clamp(0.0, 1.0);
        (cell.share + cell.mass * y * (1.0 - cell.tilt * (1.0 - y))).min(1.0)
    }

    /// The versine below which the share `q` in [0, 1] of the light is scattered.
    #[inline]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "q is clamped to [0, 1]")]
    pub(super) fn sample(&self, q: f64) -> f64 {
        let q = q.clamp(0.0, 1.0);
        let bins = self.by_share.len();
        let mut i = self.by_share[((q * bins as f64) as usize).min(bins - 1)] as usize;
        while i + 1 < self.cells.len() && self.cells[i + 1].share <= q {
            i += 1;
        }
        let cell = &self.cells[i];
        // tilt y² + (1 − tilt) y = t, the root that does not cancel; a cell without mass is met only at q = 1.
        let t = if cell.mass > 0.0 { ((q - cell.share) / cell.mass).clamp(0.0, 1.0) } else { 0.0 };
        let down = 1.0 - cell.tilt;
        let root = (down * down + 4.0 * cell.tilt * t).max(0.0).sqrt();
        let y = 2.0 * t / (down + root + f64::MIN_POSITIVE);
        cell.versine + y.min(1.0) * cell.width
    }

    /// ½∫p v dv.
    pub(super) fn mean_versine(&self) -> f64 {
        self.cells.iter().map(|c| c.mass * (c.versine + c.width * (0.5 + c.tilt / 6.0))).sum()
    }

    /// Angles of the ends of the cells, from 0 to π.
    pub(super) fn bounds(&self) -> Vec<f64> {
        let mut list: Vec<f64> = self.cells.iter().map(|cell| angle(cell.versine)).collect();
        list.push(std::f64::consts::PI);
        list
    }

    #[inline]
    fn at(&self, versine: f64) -> &Cell {
        let bin = octave_bin(versine);
        let low = self.by_versine[bin] as usize;
        let high = self.by_versine[bin + 1] as usize;
        let inside = self.cells[low..=high].partition_point(|cell| cell.versine <= versine);
        &self.cells[low + inside.saturating_sub(1)]
    }
}

/// θ of a versine, accurate at both ends.
pub(super) fn angle(versine: f64) -> f64 {
    let half = |v: f64| 2.0 * (0.5 * v).max(0.0).sqrt().asin();
    if versine <= 1.0 { half(versine) } else { std::f64::consts::PI - half((2.0 - versine).max(0.0)) }
}

/// 1 − cos θ without cancellation.
pub(super) fn versine(theta: f64) -> f64 {
    let sine = (0.5 * theta).sin();
    2.0 * sine * sine
}

/// Ordinal among logarithmic bins that share the leading bits of the number.
#[inline]
#[expect(clippy::cast_possible_truncation, reason = "fewer than 2000 bins")]
fn octave_bin(versine: f64) -> usize {
    let shift = 52 - OCTAVE_BITS;
    let smallest = 2.0_f64.powi(SMALLEST_OCTAVE);
    ((versine.clamp(smallest, 2.0).to_bits() >> shift) - (smallest.to_bits() >> shift)) as usize
}

#[expect(clippy::cast_possible_truncation, reason = "at most 2^17 cells")]
fn guide_by_versine(cells: &[Cell]) -> Vec<u32> {
    let shift = 52 - OCTAVE_BITS;
    let smallest = 2.0_f64.powi(SMALLEST_OCTAVE).to_bits() >> shift;
    let mut cell = 0;
    let mut list: Vec<u32> = (0..=octave_bin(2.0) as u64)
        .map(|bin| {
            let lower = f64::from_bits((smallest + bin) << shift);
            while cell + 1 < cells.len() && cells[cell + 1].versine <= lower {
                cell += 1;
            }
            // Everything below the smallest octave falls into the first bin.
            if bin == 0 { 0 } else { cell as u32 }
        })
        .collect();
    list.push((cells.len() - 1) as u32);
    list
}

#[expect(clippy::cast_possible_truncation, reason = "at most 2^17 cells")]
fn guide_by_share(cells: &[Cell]) -> Vec<u32> {
    let bins = cells.len();
    let mut cell = 0;
    (0..bins)
        .map(|bin| {
            let lower = bin as f64 / bins as f64;
            while cell + 1 < bins && cells[cell + 1].share <= lower {
                cell += 1;
            }
            cell as u32
        })
        .collect()
}

/// A part of the angles on which the density is smooth, with its integrals.
struct Piece {
    theta: [f64; 2],
    versine: f64,
    width: f64,
    mass: f64,
    /// Integral of (v − versine) over the density.
    moment: f64,
    /// Versine from the start and mass up to there, at [`COMPARED`].
    inside: [(f64, f64); COMPARED.len()],
}

/// Gauss–Legendre on (−1, 1), with weights for parts of the interval.
struct Rule {
    rule: Vec<(f64, f64)>,
    parts: [[f64; POINTS]; COMPARED.len()],
}

impl Rule {
    fn new() -> Self {
        let rule = gauss_legendre(POINTS);
        // Integrals of the Lagrange polynomials through the nodes from −1 to the place, by the same rule.
        let parts = COMPARED.map(|end| {
            let mut weights = [0.0; POINTS];
            for &(x, w) in &rule {
                let at = 0.5 * (end + 1.0) * (x + 1.0) - 1.0;
                for (j, weight) in weights.iter_mut().enumerate() {
                    let others = (0..POINTS).filter(|&k| k != j);
                    let basis: f64 = others.map(|k| (at - rule[k].0) / (rule[j].0 - rule[k].0)).product();
                    *weight += 0.5 * (end + 1.0) * w * basis;
                }
            }
            weights
        });
        Self { rule, parts }
    }

    /// The integrals over all intervals between bounds; the density is asked once.
    fn pieces(&self, bounds: &[f64], p: &dyn Fn(&[f64]) -> Vec<f64>) -> Vec<Piece> {
        let at: Vec<f64> = bounds
            .windows(2)
            .flat_map(|b| self.rule.iter().map(move |(x, _)| 0.5 * (b[0] + b[1]) + 0.5 * (b[1] - b[0]) * x))
            .collect();
        let values = p(&at);
        bounds
            .windows(2)
            .zip(at.chunks(POINTS).zip(values.chunks(POINTS)))
            .map(|(b, (at, values))| {
                let half = 0.5 * (b[1] - b[0]);
                // Product form of the difference of two versines.
                let from_start = |t: f64| 2.0 * (0.5 * (t + b[0])).sin() * (0.5 * (t - b[0])).sin();
                let density: [f64; POINTS] =
                    std::array::from_fn(|j| 0.5 * half * values[j].max(0.0) * at[j].sin());
                let (mut mass, mut moment) = (0.0, 0.0);
                for (j, (_, weight)) in self.rule.iter().enumerate() {
                    mass += weight * density[j];
                    moment += weight * density[j] * from_start(at[j]);
                }
                let inside = std::array::from_fn(|i| {
                    let part: f64 = self.parts[i].iter().zip(&density).map(|(w, d)| w * d).sum();
                    (from_start(0.5 * (b[0] + b[1]) + half * COMPARED[i]), part)
                });
                let width = from_start(b[1]);
                Piece { theta: [b[0], b[1]], versine: versine(b[0]), width, mass, moment, inside }
            })
            .collect()
    }
}

struct Builder<'a> {
    rule: &'a Rule,
    p: &'a dyn Fn(&[f64]) -> Vec<f64>,
    norm: f64,
    target: f64,
    cells: Vec<Cell>,
    error: f64,
}

impl Builder<'_> {
    /// One cell for neighbouring pieces where that is good enough, otherwise two halves.
    fn cover(&mut self, pieces: &[Piece]) {
        let (cell, error, good) = self.one(pieces);
        if good {
            self.error = self.error.max(error);
            self.cells.push(cell);
        } else if let [piece] = pieces {
            self.halve(piece, 0);
        } else {
            let (left, right) = pieces.split_at(pieces.len() / 2);
            self.cover(left);
            self.cover(right);
        }
    }

    fn halve(&mut self, piece: &Piece, depth: usize) {
        let (cell, error, good) = self.one(std::slice::from_ref(piece));
        let middle = 0.5 * (piece.theta[0] + piece.theta[1]);
        let narrow = middle <= piece.theta[0] || middle >= piece.theta[1];
        if good || narrow || depth >= HALVINGS_MAX || self.cells.len() >= CELLS_MAX {
            self.error = self.error.max(error);
            if cell.width > 0.0 {
                self.cells.push(cell);
            }
            return;
        }
        for half in self.rule.pieces(&[piece.theta[0], middle, piece.theta[1]], self.p) {
            self.halve(&half, depth + 1);
        }
    }

    /// The cell that has the mass and mean of some pieces, its largest error, and whether that is small enough.
    fn one(&self, pieces: &[Piece]) -> (Cell, f64, bool) {
        let start = pieces[0].versine;
        let last = &pieces[pieces.len() - 1];
        let width = (last.versine - start) + last.width;
        let mass: f64 = pieces.iter().map(|piece| piece.mass).sum();
        let moment: f64 =
            pieces.iter().map(|piece| piece.moment + (piece.versine - start) * piece.mass).sum();
        let wanted = if mass > 0.0 && width > 0.0 { 6.0 * (moment / (mass * width) - 0.5) } else { 0.0 };
        let tilt = wanted.clamp(-1.0, 1.0);
        let cell = Cell { share: 0.0, versine: start, width, mass, tilt };
        let model = |offset: f64| {
            let y = if width > 0.0 { (offset / width).min(1.0) } else { 0.0 };
            mass * y * (1.0 - tilt * (1.0 - y))
        };
        let (mut seen, mut before) = (0.0_f64, 0.0);
        for piece in pieces {
            let offset = piece.versine - start;
            seen = seen.max((model(offset) - before).abs());
            for (inside, part) in piece.inside {
                seen = seen.max((model(offset + inside) - before - part).abs());
            }
            before += piece.mass;
        }
        let worst = UNSEEN * seen;
        let defect = (wanted - tilt).abs() / 6.0 * mass * width;
        let good = worst <= self.target * self.norm && defect <= MEAN_DEFECT * self.norm;
        (cell, worst, good)
    }
}
