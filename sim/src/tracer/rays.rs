//! Single rays, unbiased and in f64: the judge of the image mode.
//!
//! Backward Monte Carlo with a deterministic straight sight, forced collisions, implicit capture, expected-value scores
//! of emission and escape along every segment, and aimed rays at small plates (balance heuristic of E. Veach, 1997).
//! Random numbers are scrambled Sobol points in 32 independent scrambles; standard errors come from their scatter, so
//! that they hold whatever the correlations inside one. Results do not depend on the number of threads.

use super::error::TracerError;
use super::plate::Plate;
use super::shape::{Body, Piece};
use super::sobol::{self, Point};
use super::vector::{Vector, along, turn, unit};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Independent scrambles; their scatter gives standard errors with 31 degrees of freedom (12 % uncertain).
const REPLICATES: u32 = 32;

/// Points per scramble in the first round; each further round doubles them.
const FIRST_POINTS: u32 = 64;

/// Roulette starts below this weight, which it restores.
const ROULETTE_WEIGHT: f64 = 0.05;

/// Collisions after which a path is cut and counted in [`RayAnswer::cut`].
const COLLISIONS_MAX: usize = 200_000;

/// Coordinates per collision: distance, scattering angle, azimuth, two for aiming.
const DIMENSIONS: usize = 5;

/// How rays are computed.
#[derive(Debug, Clone, PartialEq)]
pub struct RayOptions {
    /// Wanted standard error of each coefficient, absolute.
    pub target_error: f64,
    /// Names the random numbers.
    pub seed: u64,
    /// Most paths per ray; when they are used up the standard errors say how far it got.
    pub paths_max: u64,
    /// Most collisions per ray, over all its paths: bounds the time in deep media that hardly absorb, where a single
    /// path has thousands. When they are used up the standard errors say how far it got.
    pub collisions_max: u64,
}

/// Default of [`RayOptions::collisions_max`]: about 20 s of one core at 200 ns a collision.
pub const COLLISIONS_PER_RAY_MAX: u64 = 100_000_000;

impl Default for RayOptions {
    fn default() -> Self {
        Self { target_error: 1e-4, seed: 1, paths_max: 1 << 22, collisions_max: COLLISIONS_PER_RAY_MAX }
    }
}

/// The coefficients of one ray with their standard errors (0 where nothing was estimated).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RayAnswer {
    /// Share of the plate.
    pub plate: f64,
    /// Share of the walls: 1 − plate − medium.
    pub walls: f64,
    /// Emission of the medium's channels; channel 0 is the coefficient a_medium.
    pub medium: Vec<f64>,
    /// Standard error of the plate's share.
    pub se_plate: f64,
    /// Standard error of the walls' share.
    pub se_walls: f64,
    /// Standard errors of the channels.
    pub se_medium: Vec<f64>,
    /// Extinction optical depth of the straight sight, up to the plate if it meets it.
    pub optical_depth: f64,
    /// Transmittance of the straight sight, exact.
    pub direct_transmittance: f64,
    /// Paths traced.
    pub paths: u64,
    /// Paths cut at the limit of collisions: each leaves at most 0.05 / paths of bias.
    pub cut: u64,
}

/// Computes rays (origin in metres, direction of any length).
///
/// # Errors
///
/// [`TracerError::Geometry`] for an undefined origin or direction or a target that is not positive.
pub fn render_rays(
    body: &Body<'_>,
    rays: &[(Vector, Vector)],
    plate: Option<&Plate>,
    options: &RayOptions,
) -> Result<Vec<RayAnswer>, TracerError> {
    if options.target_error.is_nan() || options.target_error <= 0.0 {
        return Err(TracerError::Geometry { what: "the target error", condition: "positive" });
    }
    rays.par_iter()
        .enumerate()
        .map(|(number, &(origin, direction))| {
            let direction = unit(direction)
                .filter(|_| origin.iter().all(|c| c.is_finite()))
                .ok_or(TracerError::Geometry { what: "a ray", condition: "a finite origin and direction" })?;
            let world = World { body, plate, origin, direction, channels: body.channels };
            Ok(world.ray(u32::try_from(number).unwrap_or(u32::MAX), options))
        })
        .collect()
}

struct World<'a> {
    body: &'a Body<'a>,
    plate: Option<&'a Plate>,
    origin: Vector,
    direction: Vector,
    channels: usize,
}

/// The straight sight: exact scores, and where the first collision may be.
struct FirstSegment {
    pieces: Vec<Piece>,
    /// Running sum of what each piece scatters.
    cumulative: Vec<f64>,
}

/// One scramble's sums: plate, then channels.
#[derive(Clone)]
struct Replicate {
    sums: Vec<f64>,
    collisions: u64,
    cut: u64,
}

impl World<'_> {
    fn ray(&self, number: u32, options: &RayOptions) -> RayAnswer {
        let hit = self.plate.and_then(|p| p.hit(self.origin, self.direction));
        let mut pieces = Vec::new();
        self.body.pieces(self.origin, self.direction, hit.unwrap_or(f64::INFINITY), &mut pieces);
        let mut direct = vec![0.0; 1 + self.channels];
        let mut cumulative = Vec::new();
        let through = self.collect(&pieces, 1.0, &mut direct, &mut cumulative);
        if hit.is_some() {
            direct[0] += through;
        }
        let optical_depth = pieces.iter().map(|p| p.depth).sum();
        let scattered = cumulative.last().copied().unwrap_or(0.0);
        let first = FirstSegment { pieces, cumulative };
        // Nothing to find: no plate, and a medium that does not emit.
        let needless = scattered <= 0.0 || (self.plate.is_none() && self.body.is_conservative());
        let mut replicates = vec![
            Replicate { sums: vec![0.0; 1 + self.channels], collisions: 0, cut: 0 };
            REPLICATES as usize
        ];
        let mut points = 0_u32;
        let mut errors = (0.0, 0.0, vec![0.0; self.channels]);
        if !needless {
            loop {
                let next = if points == 0 { FIRST_POINTS } else { points.saturating_mul(2) };
                replicates.par_iter_mut().enumerate().for_each(|(r, replicate)| {
                    let name = sobol::sequence(options.seed, number, u32::try_from(r).unwrap_or(0));
                    for index in points..next {
                        self.path(&first, Point::new(name, index), replicate);
                    }
                });
                points = next;
                errors = self.errors(&replicates, f64::from(points));
                let worst = errors.0.max(errors.1).max(errors.2[0]);
                if worst <= options.target_error
                    || u64::from(points) * u64::from(REPLICATES) * 2 > options.paths_max
                    || replicates.iter().map(|r| r.collisions).sum::<u64>() * 2 > options.collisions_max
                {
                    break;
                }
            }
        }
        let paths = u64::from(points) * u64::from(REPLICATES);
        let mean = |k: usize| {
            let sum: f64 = replicates.iter().map(|r| r.sums[k]).sum();
            if points > 0 { sum / (f64::from(points) * f64::from(REPLICATES)) } else { 0.0 }
        };
        let plate = (direct[0] + mean(0)).clamp(0.0, 1.0);
        let mut medium: Vec<f64> = (0..self.channels).map(|c| direct[1 + c] + mean(1 + c)).collect();
        // Only a_medium is a share; other channels are in the unit of their source.
        medium[0] = medium[0].min(1.0 - plate);
        RayAnswer {
            plate,
            walls: 1.0 - plate - medium[0],
            medium,
            se_plate: errors.0,
            se_walls: errors.1,
            se_medium: errors.2,
            optical_depth,
            direct_transmittance: through,
            paths,
            cut: replicates.iter().map(|r| r.cut).sum(),
        }
    }

    /// Standard errors of plate, walls and channels from the scatter of the replicates.
    fn errors(&self, replicates: &[Replicate], points: f64) -> (f64, f64, Vec<f64>) {
        let error = |value: &dyn Fn(&Replicate) -> f64| {
            let n = f64::from(REPLICATES);
            let mean = replicates.iter().map(value).sum::<f64>() / n;
            let square = replicates.iter().map(|r| (value(r) - mean).powi(2)).sum::<f64>();
            (square / (n * (n - 1.0))).sqrt() / points
        };
        let channels = (0..self.channels).map(|c| error(&|r: &Replicate| r.sums[1 + c])).collect();
        (error(&|r| r.sums[0]), error(&|r| r.sums[0] + r.sums[1]), channels)
    }

    /// Adds the emission of all pieces times `weight`, and the running sum of what they scatter; returns the transmittance.
    #[inline]
    fn collect(&self, pieces: &[Piece], weight: f64, scores: &mut [f64], cumulative: &mut Vec<f64>) -> f64 {
        cumulative.clear();
        let (mut depth, mut scattered) = (0.0_f64, 0.0);
        for piece in pieces {
            let stopped = (-depth).exp() * -(-piece.depth).exp_m1();
            for (c, score) in scores[1..].iter_mut().enumerate() {
                *score += weight * stopped * self.body.emission_over_extinction(piece, c);
            }
            scattered += stopped * piece.albedo;
            cumulative.push(scattered);
            depth += piece.depth;
        }
        (-depth).exp()
    }

    /// A collision drawn from what the pieces scatter.
    #[inline]
    fn collide(&self, pieces: &[Piece], cumulative: &[f64], ray: (Vector, Vector), u: f64) -> Vector {
        let last = cumulative.len() - 1;
        let wanted = u * cumulative[last];
        let i = cumulative.partition_point(|&c| c <= wanted).min(last);
        let below = if i == 0 { 0.0 } else { cumulative[i - 1] };
        let share = ((wanted - below) / (cumulative[i] - below)).clamp(0.0, 1.0 - f64::EPSILON);
        let piece = &pieces[i];
        let depth = -(share * (-piece.depth).exp_m1()).ln_1p();
        along(ray.0, self.body.place(piece, depth, ray.0, ray.1), ray.1)
    }

    fn path(&self, first: &FirstSegment, point: Point, replicate: &mut Replicate) {
        let mut place = self.collide(
            &first.pieces,
            &first.cumulative,
            (self.origin, self.direction),
            point.coordinate(0),
        );
        let mut weight = first.cumulative[first.cumulative.len() - 1];
        let mut direction = self.direction;
        let (mut pieces, mut cumulative) = (Vec::new(), Vec::new());
        for collision in 0..COLLISIONS_MAX {
            replicate.collisions += 1;
            let dimension = DIMENSIONS * collision;
            self.aim(place, direction, weight, point, dimension, &mut pieces, replicate);
            let cosine = self.body.phase.sample(point.coordinate(dimension + 1));
            let sine = ((1.0 - cosine) * (1.0 + cosine)).max(0.0).sqrt();
            direction = turn(direction, cosine, sine, TAU * point.coordinate(dimension + 2));
            let plate = self.plate.and_then(|p| p.hit(place, direction).map(|t| (p, t)));
            self.body.pieces(place, direction, plate.map_or(f64::INFINITY, |p| p.1), &mut pieces);
            let through = self.collect(&pieces, weight, &mut replicate.sums, &mut cumulative);
            if let Some((plate, _)) = plate {
                // Share of this technique in the balance heuristic, written so that infinite densities stay finite.
                let aimed = if aims(plate) { plate.density(place, direction) } else { 0.0 };
                let own = self.body.phase.value(cosine) / (4.0 * PI);
                let share = if aimed > 0.0 { 1.0 / (1.0 + aimed / own) } else { 1.0 };
                replicate.sums[0] += weight * through * share;
            }
            weight *= cumulative.last().copied().unwrap_or(0.0);
            if weight < ROULETTE_WEIGHT {
                let u = point.coordinate(dimension + DIMENSIONS + 1_000_003);
                if u * ROULETTE_WEIGHT >= weight {
                    return;
                }
                weight = ROULETTE_WEIGHT;
            }
            place = self.collide(
                &pieces,
                &cumulative,
                (place, direction),
                point.coordinate(dimension + DIMENSIONS),
            );
        }
        replicate.cut += 1;
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
        replicate: &mut Replicate,
    ) {
        let Some(plate) = self.plate.filter(|p| aims(p)) else { return };
        let (u, v) = (point.coordinate(dimension + 3), point.coordinate(dimension + 4));
        let Some((aimed, density)) = plate.sample(place, u, v) else { return };
        let Some(distance) = plate.hit(place, aimed) else { return };
        let own = self.body.phase.value(super::vector::dot(direction, aimed)) / (4.0 * PI);
        if own > 0.0 {
            self.body.pieces(place, aimed, distance, pieces);
            let depth: f64 = pieces.iter().map(|p| p.depth).sum();
            replicate.sums[0] += weight * (-depth).exp() / (1.0 + density / own);
        }
    }
}

/// Whether aiming pays: not at a plate that fills the half space.
fn aims(plate: &Plate) -> bool {
    !plate.is_wide()
}
