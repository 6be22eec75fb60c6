//! One path of light from the camera backwards, in f64 and without bias.
//!
//! Forced collisions, implicit capture, expected-value scores of emission and escape along every segment, and aimed rays
//! at small plates (balance heuristic of E. Veach, 1997).

use super::chamber::{ENDS, OUTSIDE, Walls};
use super::guess::{Flight, Guess, Tally};
use super::plate::Plate;
use super::shape::{Body, Piece};
use super::sobol::Point;
use super::vector::{Vector, along, dot, turn};
use std::f64::consts::{PI, TAU};

/// Roulette starts below this weight, which it restores.
const ROULETTE_WEIGHT: f64 = 0.05;

/// Coordinates per collision: distance, scattering angle, azimuth, two for aiming.
const DIMENSIONS: usize = 5;

/// Where the coordinates of the roulette start.
const ROULETTE_DIMENSIONS: usize = 1 << 29;

/// Where the coordinates start that choose a visited place.
const VISITED_DIMENSIONS: usize = 2 << 29;

/// A ray in its surroundings.
#[derive(Clone, Copy)]
pub(super) struct World<'a> {
    pub(super) body: &'a Body<'a>,
    pub(super) plate: Option<&'a Plate>,
    pub(super) walls: &'a Walls,
    pub(super) origin: Vector,
    pub(super) direction: Vector,
}

/// The straight sight: exact scores, and where the first collision may be.
pub(super) struct FirstSegment {
    /// Scores of what is not scattered.
    pub(super) direct: Vec<f64>,
    /// Extinction optical depth, up to the plate.
    pub(super) depth: f64,
    pub(super) through: f64,
    pieces: Vec<Piece>,
    /// Running sum of what each piece scatters.
    scattered: Vec<f64>,
}

impl FirstSegment {
    /// All that it scatters.
    pub(super) fn scatters(&self) -> f64 {
        self.scattered.last().copied().unwrap_or(0.0)
    }
}

/// Room for the segments of paths, used again and again.
#[derive(Default)]
pub(super) struct Scratch {
    pieces: Vec<Piece>,
    scattered: Vec<f64>,
}

impl World<'_> {
    /// Number of scores: the plate's share, the channels, and the walls' shares where they are told apart.
    pub(super) fn scores(&self) -> usize {
        self.first_end() + if self.walls.apart().is_some() { ENDS } else { 0 }
    }

    /// Where the scores of the walls begin.
    pub(super) fn first_end(&self) -> usize {
        1 + self.body.channels
    }

    /// How far a ray goes that meets the plate at `hit` or not at all, and on which wall it ends then.
    #[inline]
    fn reach(&self, origin: Vector, direction: Vector, hit: Option<f64>) -> (f64, usize) {
        let far = hit.unwrap_or(f64::INFINITY);
        match self.walls.chamber().and_then(|chamber| chamber.span(origin, direction)) {
            Some(span) => (far.min(span.leave.max(0.0)), span.side),
            None => (far, OUTSIDE),
        }
    }

    /// Adds what a segment lets through to the wall on which it ends, if walls are told apart.
    #[inline]
    fn ends(&self, scores: &mut [f64], end: usize, through: f64) {
        if self.walls.apart().is_some() {
            scores[self.first_end() + end] += through;
        }
    }

    pub(super) fn first(&self) -> FirstSegment {
        let hit = self.plate.and_then(|p| p.hit(self.origin, self.direction));
        let (mut pieces, mut scattered) = (Vec::new(), Vec::new());
        let (far, end) = self.reach(self.origin, self.direction, hit);
        self.body.pieces(self.origin, self.direction, far, &mut pieces);
        let mut direct = vec![0.0; self.scores()];
        let through = self.collect(&pieces, 1.0, &mut direct, &mut scattered);
        if hit.is_some() {
            direct[0] += through;
        } else {
            self.ends(&mut direct, end, through);
        }
        let depth = pieces.iter().map(|p| p.depth).sum();
        FirstSegment { direct, depth, through, pieces, scattered }
    }

    /// Adds the emission of all pieces times `weight` to the channels' scores, and lists the running sum of what they
    /// scatter; returns the transmittance.
    #[inline]
    fn collect(&self, pieces: &[Piece], weight: f64, scores: &mut [f64], scattered: &mut Vec<f64>) -> f64 {
        scattered.clear();
        let (mut depth, mut sum) = (0.0_f64, 0.0);
        for piece in pieces {
            let stopped = (-depth).exp() * -(-piece.depth).exp_m1();
            for (c, score) in scores[1..self.first_end()].iter_mut().enumerate() {
                *score += weight * stopped * self.body.emission_over_extinction(piece, c);
            }
            sum += stopped * piece.albedo;
            scattered.push(sum);
            depth += piece.depth;
        }
        (-depth).exp()
    }

    /// A collision drawn from what the pieces scatter, and its cell.
    #[inline]
    fn collide(&self, pieces: &[Piece], scattered: &[f64], ray: (Vector, Vector), u: f64) -> (Vector, u32) {
        let last = scattered.len() - 1;
        let wanted = u * scattered[last];
        let i = if last == 0 { 0 } else { scattered.partition_point(|&c| c <= wanted).min(last) };
        let below = if i == 0 { 0.0 } else { scattered[i - 1] };
        let share = ((wanted - below) / (scattered[i] - below)).clamp(0.0, 1.0 - f64::EPSILON);
        let piece = &pieces[i];
        let depth = -(share * (-piece.depth).exp_m1()).ln_1p();
        (along(ray.0, self.body.place(piece, depth, ray.0, ray.1), ray.1), piece.cell)
    }

    /// Follows one path from its first collision and adds what it finds; cuts and counts it after so many collisions.
    pub(super) fn path(
        &self,
        first: &FirstSegment,
        point: Point,
        guess: &dyn Guess,
        collisions_max: usize,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) {
        let Scratch { pieces, scattered } = scratch;
        let (mut direction, mut weight) = (self.direction, first.scatters());
        let flight = Flight {
            origin: self.origin,
            direction,
            pieces: &first.pieces,
            scattered: &first.scattered,
            through: first.through,
        };
        guess.enter(&flight, tally);
        if weight <= 0.0 {
            return;
        }
        let ray = (self.origin, direction);
        let (mut place, mut cell) = self.collide(&first.pieces, &first.scattered, ray, point.coordinate(0));
        guess.collide(place, direction, -(-first.depth).exp_m1(), tally);
        for collision in 0..collisions_max {
            tally.collisions += 1;
            let dimension = DIMENSIONS * collision;
            if !tally.features.is_empty() {
                let earlier = point.coordinate(VISITED_DIMENSIONS + dimension) * (collision + 1) as f64;
                if earlier < 1.0 {
                    tally.visited = (place, cell);
                }
            }
            self.aim(place, direction, weight, point, dimension, pieces, tally);
            let cosine = self.body.phase.sample(point.coordinate(dimension + 1));
            let sine = ((1.0 - cosine) * (1.0 + cosine)).max(0.0).sqrt();
            direction = turn(direction, cosine, sine, TAU * point.coordinate(dimension + 2));
            let plate = self.plate.and_then(|p| p.hit(place, direction).map(|t| (p, t)));
            let (far, end) = self.reach(place, direction, plate.map(|p| p.1));
            self.body.pieces(place, direction, far, pieces);
            let through = self.collect(pieces, weight, &mut tally.scores, scattered);
            if let Some((plate, _)) = plate {
                // Share of this technique in the balance heuristic, written so that infinite densities stay finite.
                let aimed = if aims(plate) { plate.density(place, direction) } else { 0.0 };
                let own = self.body.phase.value(cosine) / (4.0 * PI);
                let share = if aimed > 0.0 { 1.0 / (1.0 + aimed / own) } else { 1.0 };
                tally.scores[0] += weight * through * share;
            } else {
                self.ends(&mut tally.scores, end, weight * through);
            }
            let flight = Flight { origin: place, direction, pieces, scattered, through };
            guess.fly(&flight, cell, weight, tally);
            let left = scattered.last().copied().unwrap_or(0.0);
            if left <= 0.0 {
                return;
            }
            let ray = (place, direction);
            (place, cell) = self.collide(pieces, scattered, ray, point.coordinate(dimension + DIMENSIONS));
            // Only guesses of shapes, which are one piece, want the stopped share.
            let stopped = pieces.first().map_or(0.0, |piece| -(-piece.depth).exp_m1());
            guess.collide(place, direction, weight * stopped, tally);
            weight *= left;
            if weight < ROULETTE_WEIGHT {
                let u = point.coordinate(ROULETTE_DIMENSIONS + dimension);
                if u * ROULETTE_WEIGHT >= weight {
                    return;
                }
                weight = ROULETTE_WEIGHT;
            }
        }
        tally.cut += 1;
        tally.cut_weight += weight;
    }

    /// Scores the plate along a direction drawn from its solid angle.
    #[expect(clippy::too_many_arguments, reason = "the state of a path, named at its only call")]
    fn aim(
        &self,
        place: Vector,
        direction: Vector,
        weight: f64,
        point: Point,
        dimension: usize,
        pieces: &mut Vec<Piece>,
        tally: &mut Tally,
    ) {
        let Some(plate) = self.plate.filter(|p| aims(p)) else { return };
        let (u, v) = (point.coordinate(dimension + 3), point.coordinate(dimension + 4));
        let Some((aimed, density)) = plate.sample(place, u, v) else { return };
        let Some(distance) = plate.hit(place, aimed) else { return };
        let own = self.body.phase.value(dot(direction, aimed)) / (4.0 * PI);
        if own > 0.0 {
            let (far, _) = self.reach(place, aimed, Some(distance));
            self.body.pieces(place, aimed, far, pieces);
            let depth: f64 = pieces.iter().map(|p| p.depth).sum();
            tally.scores[0] += weight * (-depth).exp() / (1.0 + density / own);
        }
    }
}

/// Whether aiming pays: not at a plate that fills the half space.
fn aims(plate: &Plate) -> bool {
    !plate.is_wide()
}
