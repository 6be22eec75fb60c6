//! Guesses for a slab: cubic splines over the optical depth times Legendre polynomials of the cosine.
//!
//! Knots are dense at both faces, where radiance changes within a free path, and sparse inside, where it is the straight
//! line of diffusion, which the splines hold exactly.

use super::{Family, Flight, Guess, Tally};
use crate::light::phase::PhaseFunction;
use crate::light::phase::truncation::moments;
use crate::tracer::vector::{Vector, along};

/// Legendre polynomials, from order 0.
const ORDERS: usize = 8;

/// Splines that differ from zero between two knots.
const SPLINES: usize = 4;

/// Distance of the first knot from a face, in optical depth; every further one is [`GROWTH`] times as far from the last.
const FIRST_KNOT: f64 = 0.25;
const GROWTH: f64 = 2.0;

/// Thinnest and deepest slab for which splines make sense.
const DEPTH_LIMITS: [f64; 2] = [1e-6, 1e12];

/// A polynomial of degree 3 over one stretch, from 0 to 1.
type Cubic = [f64; 4];

#[derive(Debug)]
pub(super) struct SlabFamily {
    frame: Frame,
    /// The splines between neighbouring knots.
    cubics: Vec<[Cubic; SPLINES]>,
}

/// Coordinates and material.
#[derive(Debug, Clone)]
struct Frame {
    lower_m: f64,
    extinction: f64,
    depth: f64,
    /// ω χ_l − 1.
    loss: [f64; ORDERS],
    knots: Vec<f64>,
}

impl SlabFamily {
    pub(super) fn new(thickness_m: f64, extinction: f64, albedo: f64, phase: &PhaseFunction) -> Option<Self> {
        let depth = thickness_m * extinction;
        if !(DEPTH_LIMITS[0]..=DEPTH_LIMITS[1]).contains(&depth) {
            return None;
        }
        let chi = moments(phase, ORDERS);
        let loss = std::array::from_fn(|l| albedo * chi[l] - 1.0);
        let knots = knots(depth);
        let cubics = cubics(&knots);
        Some(Self { frame: Frame { lower_m: -0.5 * thickness_m, extinction, depth, loss, knots }, cubics })
    }

    fn add(&self, at: &At, weight: f64, losing: bool, features: &mut [f64]) {
        for (r, cubic) in self.cubics[at.stretch].iter().enumerate() {
            let (value, slope) = (value(cubic, at.x), at.cosine * slope(cubic, at.x) / at.width);
            let features = &mut features[(at.stretch + r) * ORDERS..][..ORDERS];
            for ((feature, loss), legendre) in features.iter_mut().zip(self.frame.loss).zip(at.legendre) {
                let term = if losing { loss * value + slope } else { value };
                *feature += weight * term * legendre;
            }
        }
    }
}

/// A place and direction in a slab.
struct At {
    stretch: usize,
    width: f64,
    /// Place in the stretch, from 0 to 1.
    x: f64,
    cosine: f64,
    legendre: [f64; ORDERS],
}

impl Frame {
    fn at(&self, place: Vector, direction: Vector) -> At {
        let depth = ((place[2] - self.lower_m) * self.extinction).clamp(0.0, self.depth);
        let last = self.knots.len() - 2;
        let stretch = self.knots[1..=last].partition_point(|k| *k <= depth);
        let width = self.knots[stretch + 1] - self.knots[stretch];
        let cosine = direction[2];
        let mut legendre = [1.0; ORDERS];
        legendre[1] = cosine;
        for l in 1..ORDERS - 1 {
            let order = l as f64;
            legendre[l + 1] =
                ((2.0 * order + 1.0) * cosine * legendre[l] - order * legendre[l - 1]) / (order + 1.0);
        }
        At { stretch, width, x: (depth - self.knots[stretch]) / width, cosine, legendre }
    }

    /// Where a segment leaves the slab, if anything gets there, and where it starts.
    fn ends(&self, flight: &Flight<'_>) -> (Option<At>, Option<At>) {
        let Some(piece) = flight.pieces.first() else { return (None, None) };
        let place = |distance| along(flight.origin, distance, flight.direction);
        let start = self.at(place(piece.start), flight.direction);
        let end = (flight.through > 0.0).then(|| self.at(place(piece.end), flight.direction));
        (Some(start), end)
    }
}

impl Guess for SlabFamily {
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally) {
        let (start, end) = self.frame.ends(flight);
        if let Some(start) = start {
            self.add(&start, 1.0, false, &mut tally.features);
        }
        if let Some(end) = end {
            self.add(&end, -flight.through, false, &mut tally.features);
        }
    }

    fn fly(&self, flight: &Flight<'_>, _: u32, weight: f64, tally: &mut Tally) {
        if let (_, Some(end)) = self.frame.ends(flight) {
            self.add(&end, -weight * flight.through, false, &mut tally.features);
        }
    }

    fn collide(&self, place: Vector, direction: Vector, weight: f64, tally: &mut Tally) {
        self.add(&self.frame.at(place, direction), weight, true, &mut tally.features);
    }
}

impl Family for SlabFamily {
    fn len(&self) -> usize {
        (self.frame.knots.len() + SPLINES - 2) * ORDERS
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "u is in (0, 1)")]
    fn anywhere(&self, visited: Vector, u: f64) -> Option<Vector> {
        let Frame { lower_m, extinction, knots, .. } = &self.frame;
        // As many in every stretch.
        let along = u * (knots.len() - 1) as f64;
        let stretch = (along as usize).min(knots.len() - 2);
        let depth = knots[stretch] + (along - stretch as f64) * (knots[stretch + 1] - knots[stretch]);
        Some([visited[0], visited[1], lower_m + depth / extinction])
    }

    fn subtract(&self, place: Vector, direction: Vector, _: u32, tally: &mut Tally) {
        self.add(&self.frame.at(place, direction), -1.0, false, &mut tally.features);
    }

    fn fitted(&self, coefficients: &[f64], scores: usize) -> Box<dyn Guess> {
        let mut table = vec![[[0.0; 4]; ORDERS]; self.cubics.len() * scores];
        for (stretch, cubics) in self.cubics.iter().enumerate() {
            for (r, cubic) in cubics.iter().enumerate() {
                for l in 0..ORDERS {
                    for score in 0..scores {
                        let c = coefficients[((stretch + r) * ORDERS + l) * scores + score];
                        super::add(&mut table[stretch * scores + score][l], c, cubic);
                    }
                }
            }
        }
        Box::new(SlabGuess { frame: self.frame.clone(), scores, table })
    }
}

/// A combination of the family's functions for each score.
struct SlabGuess {
    frame: Frame,
    scores: usize,
    /// `[stretch][score][order]`.
    table: Vec<[Cubic; ORDERS]>,
}

impl SlabGuess {
    fn add(&self, at: &At, weight: f64, losing: bool, scores: &mut [f64]) {
        for (score, cubics) in scores.iter_mut().zip(&self.table[at.stretch * self.scores..]) {
            let mut sum = 0.0;
            for ((cubic, loss), legendre) in cubics.iter().zip(self.frame.loss).zip(at.legendre) {
                let value = value(cubic, at.x);
                let term =
                    if losing { loss * value + at.cosine * slope(cubic, at.x) / at.width } else { value };
                sum += term * legendre;
            }
            *score += weight * sum;
        }
    }
}

impl Guess for SlabGuess {
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally) {
        let (start, end) = self.frame.ends(flight);
        if let Some(start) = start {
            self.add(&start, 1.0, false, &mut tally.scores);
        }
        if let Some(end) = end {
            self.add(&end, -flight.through, false, &mut tally.scores);
        }
    }

    fn fly(&self, flight: &Flight<'_>, _: u32, weight: f64, tally: &mut Tally) {
        if let (_, Some(end)) = self.frame.ends(flight) {
            self.add(&end, -weight * flight.through, false, &mut tally.scores);
        }
    }

    fn collide(&self, place: Vector, direction: Vector, weight: f64, tally: &mut Tally) {
        self.add(&self.frame.at(place, direction), weight, true, &mut tally.scores);
    }
}

#[inline(always)]
fn value(cubic: &Cubic, x: f64) -> f64 {
    cubic[0] + x * (cubic[1] + x * (cubic[2] + x * cubic[3]))
}

#[inline(always)]
fn slope(cubic: &Cubic, x: f64) -> f64 {
    cubic[1] + x * (2.0 * cubic[2] + x * (3.0 * cubic[3]))
}

/// Symmetric knots from 0 to the depth.
fn knots(depth: f64) -> Vec<f64> {
    let (mut near, mut next, mut step) = (vec![0.0], FIRST_KNOT, FIRST_KNOT);
    // Stretches grow, so that the last one before the middle is kept only where it leaves half a step.
    while next + 0.5 * step < 0.5 * depth {
        near.push(next);
        step *= GROWTH;
        next += step;
    }
    let far: Vec<f64> = near.iter().rev().map(|k| depth - k).collect();
    near.extend(far);
    near
}

/// The cubic B-splines between neighbouring knots, the outer knots fourfold: recursion of C. de Boor on polynomials.
fn cubics(knots: &[f64]) -> Vec<[Cubic; SPLINES]> {
    const DEGREE: usize = SPLINES - 1;
    let last = knots.len() - 1;
    let knot = |i: usize| knots[i.saturating_sub(DEGREE).min(last)];
    (0..last)
        .map(|stretch| {
            let (origin, width) = (knots[stretch], knots[stretch + 1] - knots[stretch]);
            let k = stretch + DEGREE;
            let mut splines = [[0.0; 4]; SPLINES];
            splines[0][0] = 1.0;
            for j in 1..=DEGREE {
                let mut saved = [0.0; 4];
                for (r, spline) in splines[..j].iter_mut().enumerate() {
                    let (left, right) = (knot(k + 1 + r - j), knot(k + r + 1));
                    let part = spline.map(|c| c / (right - left));
                    // (right − s) part and (s − left) part with s = origin + width x.
                    *spline = saved;
                    saved = [0.0; 4];
                    for power in 0..j {
                        spline[power] += (right - origin) * part[power];
                        spline[power + 1] -= width * part[power];
                        saved[power] += (origin - left) * part[power];
                        saved[power + 1] += width * part[power];
                    }
                }
                splines[j] = saved;
            }
            splines
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The splines of every stretch sum to one and join with two derivatives.
    #[test]
    fn splines_are_a_partition_and_smooth() {
        for depth in [0.1, 1.0, 40.0, 1e9] {
            let knots = knots(depth);
            assert!(knots.windows(2).all(|k| k[1] > k[0]), "{knots:?}");
            let cubics = cubics(&knots);
            for (i, splines) in cubics.iter().enumerate() {
                for x in [0.0, 0.3, 1.0] {
                    let sum: f64 = splines.iter().map(|c| value(c, x)).sum();
                    assert!((sum - 1.0).abs() < 1e-12, "{depth} {i} {sum}");
                }
                let Some(next) = cubics.get(i + 1) else { continue };
                let (here, there) = (knots[i + 1] - knots[i], knots[i + 2] - knots[i + 1]);
                for r in 0..SPLINES - 1 {
                    assert!((value(&splines[r + 1], 1.0) - value(&next[r], 0.0)).abs() < 1e-12);
                    let (a, b) = (slope(&splines[r + 1], 1.0) / here, slope(&next[r], 0.0) / there);
                    assert!(
                        (a - b).abs() < 1e-12 * (a.abs() + b.abs() + 1.0 / here),
                        "{depth} {i} {r}: {a} {b}"
                    );
                }
            }
        }
    }
}
