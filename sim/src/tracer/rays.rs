//! Single rays, unbiased and in f64: the judge of the image mode.
//!
//! Backward Monte Carlo (`path`) whose noise is reduced by a guess of the radiance inside the medium (`guess`), learned
//! from paths of their own. Random numbers are scrambled Sobol points in 32 independent scrambles; standard errors come
//! from their scatter, so that they hold whatever the correlations inside one. Results do not depend on the number of
//! threads; those of a list of rays share the guess, so that a ray's noise depends on the others.

use super::chamber::{ENDS, Walls};
use super::error::TracerError;
use super::guess::{self, Family, Guess, Moments, Nothing, Tally};
use super::path::{FirstSegment, Scratch, World};
use super::plate::Plate;
use super::shape::Body;
use super::sobol::{self, Point};
use super::vector::{Vector, along, unit};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Independent scrambles; their scatter gives standard errors with 31 degrees of freedom (12 % uncertain).
const REPLICATES: u32 = 32;

/// Points per scramble in the first round, each further round doubles them; and in lists so long (images) that the error
/// of a single ray's standard error averages out.
const FIRST_POINTS: u32 = 64;
const FIRST_POINTS_OF_MANY: u32 = 4;
const MANY_RAYS: usize = 1000;

/// Collisions after which a path is cut and counted, as a part of the ray's limit, and bounds of it.
const COLLISIONS_PART: u64 = 20;
const PATH_COLLISIONS: [usize; 2] = [1000, 2_000_000];

/// Paths from which a guess is learned: as many tasks as its paths are shared by, and how many per function.
const LEARNING_TASKS: u32 = 16;
const PATHS_PER_FUNCTION: usize = 16;
const LEARNING_PATHS: [usize; 2] = [2048, 8192];

/// Collisions after which a path from anywhere stops: every stretch of it says by itself how wrong a guess is.
const LOCAL_COLLISIONS: usize = 16;

/// Coordinates that choose directions from visited places.
const STARTING_DIMENSIONS: usize = 3 << 29;

/// Collisions after which a task of learning stops, as a part of a ray's limit.
const LEARNING_COLLISIONS_PART: u64 = 80;

/// Times the paths of learning that all rays together must still need before a guess is worth learning.
const WORTH_LEARNING: f64 = 2.0;

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
    /// What surrounds the medium.
    pub walls: Walls,
}

/// Default of [`RayOptions::collisions_max`]: about 10 s of one core at 250 ns a collision.
pub const COLLISIONS_PER_RAY_MAX: u64 = 40_000_000;

impl Default for RayOptions {
    fn default() -> Self {
        Self {
            target_error: 1e-4,
            seed: 1,
            paths_max: 1 << 22,
            collisions_max: COLLISIONS_PER_RAY_MAX,
            walls: Walls::Far,
        }
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
    /// Shares of the walls one by one and of the place outside, as [`super::chamber::ENDS`] says, with the walls' share as
    /// their sum; empty unless the walls are told apart.
    pub ends: Vec<f64>,
    /// Standard errors of these shares.
    pub se_ends: Vec<f64>,
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
    let worlds: Vec<World<'_>> = rays
        .iter()
        .map(|&(origin, direction)| {
            let direction = unit(direction)
                .filter(|_| origin.iter().all(|c| c.is_finite()))
                .ok_or(TracerError::Geometry { what: "a ray", condition: "a finite origin and direction" })?;
            // Media begin at the wall through which a ray comes in.
            let enter =
                options.walls.chamber().and_then(|c| c.span(origin, direction)).map_or(0.0, |s| s.enter);
            let hidden = plate.and_then(|p| p.hit(origin, direction)).is_some_and(|hit| hit < enter);
            let origin = if enter > 0.0 && !hidden { along(origin, enter, direction) } else { origin };
            Ok(World { body, plate, walls: &options.walls, origin, direction })
        })
        .collect::<Result<_, _>>()?;
    let limits = Limits::new(rays.len(), options);
    let mut states: Vec<State> = worlds
        .par_iter()
        .zip(numbers())
        .map(|(world, number)| {
            let first = world.first();
            // Nothing to find: no plate, a medium that does not emit, and walls that are all alike.
            let dark = plate.is_none() && body.is_conservative() && options.walls.apart().is_none();
            if first.scatters() <= 0.0 || dark {
                return State::Done(Run::new(world, &first, &limits).answer(&first));
            }
            let mut run = Run::new(world, &first, &limits);
            for _ in 0..2 {
                if !run.enough(options) {
                    run.round(number, &Nothing, options);
                }
            }
            if run.enough(options) {
                State::Done(run.answer(&first))
            } else {
                State::Open(run.needs(options))
            }
        })
        .collect();
    let open: Vec<usize> = (0..states.len()).filter(|&i| matches!(states[i], State::Open(_))).collect();
    let needed: f64 = states.iter().map(|s| if let State::Open(paths) = s { *paths } else { 0.0 }).sum();
    let guess = guess::family(body)
        .filter(|family| needed > WORTH_LEARNING * learning_paths(family.as_ref()) as f64)
        .and_then(|family| learn(family.as_ref(), &worlds, &open, &limits, options.seed));
    states.par_iter_mut().zip(&worlds).zip(numbers()).for_each(|((state, world), number)| {
        if let State::Open(needed) = state {
            *state = State::Done(finish(world, number, *needed, guess.as_deref(), (&limits, options)));
        }
    });
    Ok(states
        .into_iter()
        .map(|state| match state {
            State::Done(answer) => answer,
            State::Open(_) => unreachable!("every open ray has been finished"),
        })
        .collect())
}

/// A ray's answer, or about how many paths it would need.
enum State {
    Done(RayAnswer),
    Open(f64),
}

/// Numbers of the rays, as their random numbers know them.
fn numbers() -> impl IndexedParallelIterator<Item = u32> {
    (0..u32::MAX).into_par_iter()
}

fn learning_paths(family: &dyn Family) -> usize {
    (PATHS_PER_FUNCTION * family.len()).clamp(LEARNING_PATHS[0], LEARNING_PATHS[1])
}

/// Fits the family to the scores of paths of a few of the rays; none where they do not determine it.
fn learn(
    family: &dyn Family,
    worlds: &[World<'_>],
    open: &[usize],
    limits: &Limits,
    seed: u64,
) -> Option<Box<dyn Guess>> {
    let paths = u32::try_from(learning_paths(family)).ok()? / LEARNING_TASKS;
    let tasks: Vec<Moments> = (0..LEARNING_TASKS)
        .into_par_iter()
        .map(|task| {
            let world = &worlds[open[task as usize * open.len() / LEARNING_TASKS as usize]];
            let first = world.first();
            let mut moments = Moments::new(family.len(), world.scores());
            let mut tally = Tally::new(world.scores(), family.len());
            let mut scratch = Scratch::default();
            // Names that no ray's own paths have.
            let names = [0, 1, 2].map(|kind| sobol::sequence(!seed, u32::MAX - kind, task));
            for index in 0..paths / 2 {
                let point = Point::new(names[0], index);
                tally.clear();
                world.path(&first, point, family, limits.path, &mut scratch, &mut tally);
                moments.add(&tally);
                let (visited, cell) = tally.visited;
                let mut null = |place: Vector, collisions: usize, name: u32| {
                    let point = Point::new(name, index);
                    let direction = anywhere(
                        point.coordinate(STARTING_DIMENSIONS),
                        point.coordinate(STARTING_DIMENSIONS + 1),
                    );
                    let inner = World { origin: place, direction, ..*world };
                    let first = inner.first();
                    tally.clear();
                    tally.scores.copy_from_slice(&first.direct);
                    inner.path(&first, point, family, collisions, &mut scratch, &mut tally);
                    family.subtract(place, direction, cell, &mut tally);
                    moments.add_null(&tally);
                };
                null(visited, limits.path, names[1]);
                let u = Point::new(names[2], index).coordinate(STARTING_DIMENSIONS + 2);
                if let Some(place) = family.anywhere(visited, u) {
                    null(place, LOCAL_COLLISIONS, names[2]);
                }
                if tally.collisions > limits.learning {
                    break;
                }
            }
            moments
        })
        .collect();
    let mut all = Moments::new(family.len(), worlds[open[0]].scores());
    tasks.into_iter().for_each(|task| all.merge(task));
    let coefficients = guess::solve(&all)?;
    Some(family.fitted(&coefficients, worlds[open[0]].scores()))
}

/// A direction, uniform over the sphere.
fn anywhere(u: f64, v: f64) -> Vector {
    let cosine = 2.0 * u - 1.0;
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let (s, c) = (TAU * v).sin_cos();
    [sine * c, sine * s, cosine]
}

/// Traces a ray until its target or a limit is reached, with the guess if it needs fewer paths than without.
fn finish(
    world: &World<'_>,
    number: u32,
    needed: f64,
    guess: Option<&dyn Guess>,
    (limits, options): (&Limits, &RayOptions),
) -> RayAnswer {
    let first = world.first();
    let mut run = Run::new(world, &first, limits);
    let mut used: &dyn Guess = &Nothing;
    if let Some(guess) = guess {
        // Few paths tell little about the rare ones that a guess leaves.
        for _ in 0..3 {
            if !run.exhausted(options) {
                run.round(number, guess, options);
            }
        }
        if run.needs(options) < needed {
            used = guess;
        } else {
            run = Run::new(world, &first, limits);
        }
    }
    while !run.enough(options) {
        run.round(number, used, options);
    }
    run.answer(&first)
}

/// What follows from the options and the number of rays.
struct Limits {
    first_points: u32,
    /// Collisions per path.
    path: usize,
    /// Collisions per task of learning.
    learning: u64,
}

impl Limits {
    fn new(rays: usize, options: &RayOptions) -> Self {
        let path = usize::try_from(options.collisions_max / COLLISIONS_PART).unwrap_or(usize::MAX);
        Self {
            first_points: if rays > MANY_RAYS { FIRST_POINTS_OF_MANY } else { FIRST_POINTS },
            path: path.clamp(PATH_COLLISIONS[0], PATH_COLLISIONS[1]),
            learning: options.collisions_max / LEARNING_COLLISIONS_PART,
        }
    }
}

/// Paths of one ray.
struct Run<'a> {
    world: &'a World<'a>,
    first: &'a FirstSegment,
    limits: &'a Limits,
    replicates: Vec<Tally>,
    /// Points per replicate so far.
    points: u32,
    errors: Errors,
    /// The largest error that counts, one round before.
    worst_before: f64,
}

/// Standard errors of plate, walls, channels and walls one by one.
#[derive(Default)]
struct Errors {
    plate: f64,
    walls: f64,
    channels: Vec<f64>,
    ends: Vec<f64>,
}

impl<'a> Run<'a> {
    fn new(world: &'a World<'a>, first: &'a FirstSegment, limits: &'a Limits) -> Self {
        let scores = world.scores();
        let channels = world.first_end() - 1;
        let ends = vec![0.0; scores - 1 - channels];
        let errors = Errors { channels: vec![0.0; channels], ends, ..Errors::default() };
        let replicates = vec![Tally::new(scores, 0); REPLICATES as usize];
        Self { world, first, limits, replicates, points: 0, errors, worst_before: f64::INFINITY }
    }

    /// Doubles the paths.
    fn round(&mut self, number: u32, guess: &dyn Guess, options: &RayOptions) {
        let (before, next) =
            (self.points, if self.points == 0 { self.limits.first_points } else { self.points * 2 });
        let (world, first, limits) = (self.world, self.first, self.limits);
        // Scenes that differ have noise of their own: rows of a table of scenes are independent.
        let own = sobol::hash_of(first.scatters());
        self.replicates.par_iter_mut().zip(numbers()).for_each(|(tally, r)| {
            let name = sobol::sequence(options.seed, number ^ own, r);
            let mut scratch = Scratch::default();
            for index in before..next {
                world.path(first, Point::new(name, index), guess, limits.path, &mut scratch, tally);
            }
        });
        self.points = next;
        self.worst_before = if before == 0 { f64::INFINITY } else { self.worst() };
        self.errors = self.errors();
    }

    /// Whether the target is reached twice in a row (a round without the rare paths that matter looks better than it
    /// is), or another round would pass a limit.
    fn enough(&self, options: &RayOptions) -> bool {
        let target = options.target_error;
        self.points > 0
            && (self.worst() <= target && self.worst_before <= 2.0 * target || self.exhausted(options))
    }

    /// Whether another round would pass a limit.
    fn exhausted(&self, options: &RayOptions) -> bool {
        let collisions: u64 = self.replicates.iter().map(|r| r.collisions).sum();
        self.points > 0
            && (self.paths() * 2 > options.paths_max
                || self.points > u32::MAX / 2
                || collisions * 2 > options.collisions_max)
    }

    fn worst(&self) -> f64 {
        let walls = self.errors.ends.iter().copied().fold(self.errors.walls, f64::max);
        self.errors.plate.max(walls).max(self.errors.channels[0])
    }

    /// About how many paths the target needs.
    fn needs(&self, options: &RayOptions) -> f64 {
        let ratio = self.worst() / options.target_error;
        self.paths() as f64 * ratio * ratio
    }

    fn paths(&self) -> u64 {
        u64::from(self.points) * u64::from(REPLICATES)
    }

    /// Standard errors from the scatter of the replicates, and what cut paths may still have found.
    fn errors(&self) -> Errors {
        let cut = self.replicates.iter().map(|r| r.cut_weight).sum::<f64>() / self.paths() as f64;
        // What emits nothing has nothing left to find.
        let cut_medium = if cut > 0.0 && !self.world.body.is_conservative() { cut } else { 0.0 };
        let error = |cut: f64, value: &dyn Fn(&Tally) -> f64| {
            let n = f64::from(REPLICATES);
            let mean = self.replicates.iter().map(value).sum::<f64>() / n;
            let square = self.replicates.iter().map(|r| (value(r) - mean).powi(2)).sum::<f64>();
            (square / (n * (n - 1.0))).sqrt() / f64::from(self.points) + cut
        };
        Errors {
            plate: error(cut, &|r| r.scores[0]),
            walls: error(cut, &|r| r.scores[0] + r.scores[1]),
            channels: (1..self.world.first_end()).map(|c| error(cut_medium, &|r| r.scores[c])).collect(),
            ends: (self.world.first_end()..self.world.scores())
                .map(|k| error(cut, &|r| r.scores[k]))
                .collect(),
        }
    }

    fn answer(&self, first: &FirstSegment) -> RayAnswer {
        let mean = |k: usize| {
            let sum: f64 = self.replicates.iter().map(|r| r.scores[k]).sum();
            if self.points > 0 { sum / self.paths() as f64 } else { 0.0 }
        };
        let plate = (first.direct[0] + mean(0)).clamp(0.0, 1.0);
        // What a guess leaves of the noise may be negative.
        let mut medium: Vec<f64> =
            (1..self.world.first_end()).map(|c| (first.direct[c] + mean(c)).max(0.0)).collect();
        // Only a_medium is a share; other channels are in the unit of their source.
        // A share below the rounding of 1 keeps its digits.
        medium[0] = medium[0].min(1.0 - plate + 0.5 * f64::EPSILON).min(1.0);
        let walls = (1.0 - plate - medium[0]).max(0.0);
        let ends: Vec<f64> = (self.world.first_end()..self.world.scores())
            .map(|k| (first.direct[k] + mean(k)).max(0.0))
            .collect();
        RayAnswer {
            plate,
            walls,
            medium,
            ends: closed(ends, walls),
            se_ends: self.errors.ends.clone(),
            se_plate: self.errors.plate,
            se_walls: self.errors.walls,
            se_medium: self.errors.channels.clone(),
            optical_depth: first.depth,
            direct_transmittance: first.through,
            paths: self.paths(),
            cut: self.replicates.iter().map(|r| r.cut).sum(),
        }
    }
}

/// Shares of the walls with the sum that closure gives them.
fn closed(mut ends: Vec<f64>, walls: f64) -> Vec<f64> {
    let sum: f64 = ends.iter().sum();
    let even = walls / ENDS as f64;
    ends.iter_mut().for_each(|share| *share = if sum > 0.0 { *share * (walls / sum) } else { even });
    ends
}
