//! Guesses for spheres, cylinders, boxes and Gaussians: polynomials of place and direction.
//!
//! In a Gaussian they carry the extinction's own factor, so that their derivatives per optical depth stay finite where
//! it thins out.

use super::{Family, Flight, Guess, Tally};
use crate::light::phase::PhaseFunction;
use crate::light::phase::truncation::moments;
use crate::tracer::shape::Shape;
use crate::tracer::vector::{Vector, along, dot, frame, sub};

/// Highest degree of the polynomials of place that go with directional functions of order 0, 1 and 2.
const DEGREES: [u8; 3] = [4, 3, 2];

/// Directional functions of these orders, as polynomials of the direction.
const HARMONICS: [usize; 9] = [0, 1, 1, 1, 2, 2, 2, 2, 2];

/// Highest power of one coordinate, plus one.
const POWERS: usize = DEGREES[0] as usize + 1;

/// Optical depths per length of the coordinates for which polynomials make sense.
const DEPTH_LIMITS: [f64; 2] = [1e-6, 1e9];

/// Radii along the axis of a cylinder within which places are told apart.
const AXIAL_RADII: f64 = 2.0;

#[derive(Debug, Clone)]
pub(super) struct SolidFamily {
    centre: Vector,
    axes: [Vector; 3],
    /// Lengths of the coordinates' unit along the axes.
    size: Vector,
    /// Whether the third coordinate runs from −∞ to ∞ and is squeezed into (−1, 1).
    endless: bool,
    /// 1/width² of a Gaussian, otherwise 0.
    narrowing: f64,
    extinction: f64,
    /// ω χ_l − 1.
    loss: [f64; 3],
    /// Powers of the coordinates, by degree.
    monomials: Vec<[u8; 3]>,
    /// Number of monomials that go with each order.
    counts: [usize; 3],
}

impl SolidFamily {
    pub(super) fn new(shape: &Shape, extinction: f64, albedo: f64, phase: &PhaseFunction) -> Option<Self> {
        let upright = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (centre, axes, size) = match shape {
            Shape::Slab { .. } => return None,
            Shape::Sphere { centre_m, radius_m, .. } => (*centre_m, upright, [*radius_m; 3]),
            Shape::Cylinder { centre_m, axis, radius_m, .. } => {
                let (u, v) = frame(*axis);
                (*centre_m, [u, v, *axis], [*radius_m, *radius_m, AXIAL_RADII * radius_m])
            }
            Shape::Gaussian { centre_m, width_m, .. } => (*centre_m, upright, [*width_m; 3]),
            Shape::Cuboid { lower_m, upper_m, .. } => (
                [0, 1, 2].map(|a| 0.5 * lower_m[a] + 0.5 * upper_m[a]),
                upright,
                [0, 1, 2].map(|a| 0.5 * (upper_m[a] - lower_m[a])),
            ),
        };
        let depths = size.map(|s| s * extinction);
        if !depths.iter().all(|d| (DEPTH_LIMITS[0]..=DEPTH_LIMITS[1]).contains(d)) {
            return None;
        }
        let narrowing =
            if let Shape::Gaussian { width_m, .. } = shape { 1.0 / (width_m * width_m) } else { 0.0 };
        let chi = moments(phase, 3);
        let mut monomials = Vec::new();
        for degree in 0..=DEGREES[0] {
            for x in 0..=degree {
                for y in 0..=degree - x {
                    monomials.push([x, y, degree - x - y]);
                }
            }
        }
        let counts = DEGREES.map(|d| monomials.iter().filter(|m| m.iter().sum::<u8>() <= d).count());
        Some(Self {
            centre,
            axes,
            size,
            endless: matches!(shape, Shape::Cylinder { .. }),
            narrowing,
            extinction,
            loss: std::array::from_fn(|l| albedo * chi[l] - 1.0),
            monomials,
            counts,
        })
    }

    /// Calls `sink` with the ordinal of every function and what it adds.
    #[inline(always)]
    fn each(
        &self,
        place: Vector,
        direction: Vector,
        weight: f64,
        losing: bool,
        mut sink: impl FnMut(usize, f64),
    ) {
        let offset = sub(place, self.centre);
        let mut powers = [[1.0; POWERS]; 3];
        // Coordinates and their derivatives along the ray.
        let mut speeds = [0.0; 3];
        for a in 0..3 {
            let mut coordinate = dot(offset, self.axes[a]) / self.size[a];
            let mut speed = dot(direction, self.axes[a]) / self.size[a];
            if self.endless && a == 2 {
                let length = 1.0_f64.hypot(coordinate);
                speed /= length * length * length;
                coordinate = if coordinate.is_finite() { coordinate / length } else { coordinate.signum() };
            }
            speeds[a] = speed;
            for k in 1..POWERS {
                powers[a][k] = powers[a][k - 1] * coordinate;
            }
        }
        let factor = (-0.5 * self.narrowing * dot(offset, offset)).exp();
        let bend = self.narrowing * dot(offset, direction);
        let [x, y, z] = direction;
        let harmonics = [1.0, x, y, z, x * y, y * z, z * x, x * x - y * y, 3.0 * z * z - 1.0];
        let mut values = [(0.0, 0.0); 35];
        for (value, m) in values.iter_mut().zip(&self.monomials) {
            let [i, j, k] = m.map(usize::from);
            let p = powers[0][i] * powers[1][j] * powers[2][k];
            let derivative = |a: usize, n: usize, rest: f64| {
                if n == 0 { 0.0 } else { n as f64 * powers[a][n - 1] * speeds[a] * rest }
            };
            let along = derivative(0, i, powers[1][j] * powers[2][k])
                + derivative(1, j, powers[0][i] * powers[2][k])
                + derivative(2, k, powers[0][i] * powers[1][j]);
            *value = (factor * p, (along - bend * p) / self.extinction);
        }
        let mut ordinal = 0;
        for (harmonic, order) in harmonics.iter().zip(HARMONICS) {
            for (value, slope) in &values[..self.counts[order]] {
                let term = if losing { self.loss[order] * value + slope } else { *value };
                sink(ordinal, weight * term * harmonic);
                ordinal += 1;
            }
        }
    }

    /// The three parts of ψ, see [`Guess`].
    #[inline(always)]
    fn enter(&self, flight: &Flight<'_>, mut sink: impl FnMut(usize, f64)) {
        let Some(piece) = flight.pieces.first() else { return };
        // A ray inside an endless cylinder, along it, starts where it is and leaves nowhere.
        self.each(
            along(flight.origin, piece.start, flight.direction),
            flight.direction,
            1.0,
            false,
            &mut sink,
        );
        self.leave(flight, 1.0, &mut sink);
    }

    #[inline(always)]
    fn leave(&self, flight: &Flight<'_>, weight: f64, sink: impl FnMut(usize, f64)) {
        let Some(piece) = flight.pieces.first() else { return };
        if flight.through > 0.0 {
            let end = along(flight.origin, piece.end, flight.direction);
            self.each(end, flight.direction, -weight * flight.through, false, sink);
        }
    }
}

impl Guess for SolidFamily {
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally) {
        self.enter(flight, |i, v| tally.features[i] += v);
    }

    fn fly(&self, flight: &Flight<'_>, _: u32, weight: f64, tally: &mut Tally) {
        self.leave(flight, weight, |i, v| tally.features[i] += v);
    }

    fn collide(&self, place: Vector, direction: Vector, weight: f64, tally: &mut Tally) {
        self.each(place, direction, weight, true, |i, v| tally.features[i] += v);
    }
}

impl Family for SolidFamily {
    fn len(&self) -> usize {
        HARMONICS.iter().map(|&order| self.counts[order]).sum()
    }

    fn subtract(&self, place: Vector, direction: Vector, _: u32, tally: &mut Tally) {
        self.each(place, direction, -1.0, false, |i, v| tally.features[i] += v);
    }

    fn fitted(&self, coefficients: &[f64], scores: usize) -> Box<dyn Guess> {
        Box::new(SolidGuess { family: self.clone(), scores, coefficients: coefficients.to_vec() })
    }
}

/// A combination of the family's functions for each score.
struct SolidGuess {
    family: SolidFamily,
    scores: usize,
    coefficients: Vec<f64>,
}

impl SolidGuess {
    #[inline(always)]
    fn add(&self, tally: &mut Tally, ordinal: usize, value: f64) {
        super::add(&mut tally.scores, value, &self.coefficients[ordinal * self.scores..][..self.scores]);
    }
}

impl Guess for SolidGuess {
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally) {
        self.family.enter(flight, |i, v| self.add(tally, i, v));
    }

    fn fly(&self, flight: &Flight<'_>, _: u32, weight: f64, tally: &mut Tally) {
        self.family.leave(flight, weight, |i, v| self.add(tally, i, v));
    }

    fn collide(&self, place: Vector, direction: Vector, weight: f64, tally: &mut Tally) {
        self.family.each(place, direction, weight, true, |i, v| self.add(tally, i, v));
    }
}
