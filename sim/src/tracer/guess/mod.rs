//! Guesses of the radiance inside a medium, which take the noise out of paths without touching their mean.
//!
//! For any function φ(x, Ω), what a path collects of φ's own transport equation has the mean zero: with the weight w of
//! a segment from a to b, its transmittance e^−τ, and the next collision x′ in it,
//!
//! ψ = φ(a₀, Ω₀) − Σ w e^−τ φ(b, Ω) + Σ w (1 − e^−τ) (ω V − 1 + D) φ (x′, Ω),
//!
//! where V averages φ over what is scattered into Ω and D is the derivative per optical depth along the ray. If φ were
//! the radiance itself, ψ plus the path's own score would be the answer without any noise. So combinations of simple
//! functions are fitted to the scores of a few paths (`fit`), and then the ψ of that combination is added to other,
//! independent paths: a martingale control variate (S. Henderson and P. Glynn, Math. Oper. Res. 27, 253, 2002). The
//! mean is that of the paths for every φ, good or bad.
//!
//! - [`slab`]: splines over the depth, Legendre polynomials of the direction;
//! - [`solid`]: polynomials in a sphere, cylinder, box or Gaussian;
//! - [`grid`]: values at a few planes of a lattice, constant in each cell, with sums over cells in place of D.

mod fit;
mod grid;
mod slab;
mod solid;

pub(super) use fit::{Moments, solve};

use super::shape::{Body, Kind, Piece, Shape};
use super::vector::Vector;

/// What a path leaves behind.
#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    /// Sums of the plate's share and of the channels.
    pub(super) scores: Vec<f64>,
    /// Sums of ψ of every function of a family, while a guess is being learned.
    pub(super) features: Vec<f64>,
    /// Collisions.
    pub(super) collisions: u64,
    /// Paths that were cut.
    pub(super) cut: u64,
    /// Their weights.
    pub(super) cut_weight: f64,
    /// One of the collisions of a path with features, each as likely as the others: place and cell.
    pub(super) visited: (Vector, u32),
}

impl Tally {
    pub(super) fn new(scores: usize, features: usize) -> Self {
        Self { scores: vec![0.0; scores], features: vec![0.0; features], ..Self::default() }
    }

    /// Forgets scores and features.
    pub(super) fn clear(&mut self) {
        self.scores.fill(0.0);
        self.features.fill(0.0);
    }
}

/// A straight segment of a path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flight<'a> {
    pub(super) origin: Vector,
    pub(super) direction: Vector,
    pub(super) pieces: &'a [Piece],
    /// Running sum of what the pieces scatter, for weight 1.
    pub(super) scattered: &'a [f64],
    pub(super) through: f64,
}

/// Adds ψ to what a path leaves: of a whole family to the features, of a fitted combination to the scores.
pub(super) trait Guess: Sync {
    /// The first segment, from the camera.
    fn enter(&self, flight: &Flight<'_>, tally: &mut Tally);
    /// A segment from a collision in cell `cell`; `weight` holds at its start.
    fn fly(&self, flight: &Flight<'_>, cell: u32, weight: f64, tally: &mut Tally);
    /// The next collision in a segment, before scattering; `weight` has its 1 − e^−τ.
    fn collide(&self, place: Vector, direction: Vector, weight: f64, tally: &mut Tally);
}

/// Functions whose combinations are guesses; adds to the features.
pub(super) trait Family: Guess {
    /// Number of functions.
    fn len(&self) -> usize;
    /// A place anywhere in the medium, for `u` uniform in (0, 1): where paths hardly come, which deep media have.
    fn anywhere(&self, _visited: Vector, _u: f64) -> Option<Vector> {
        None
    }
    /// Adds −φ of every function at a place in a cell to the features.
    fn subtract(&self, place: Vector, direction: Vector, cell: u32, tally: &mut Tally);
    /// The combination with these coefficients, `[function][score]`.
    fn fitted(&self, coefficients: &[f64], scores: usize) -> Box<dyn Guess>;
}

/// No guess.
pub(super) struct Nothing;

impl Guess for Nothing {
    fn enter(&self, _: &Flight<'_>, _: &mut Tally) {}
    fn fly(&self, _: &Flight<'_>, _: u32, _: f64, _: &mut Tally) {}
    fn collide(&self, _: Vector, _: Vector, _: f64, _: &mut Tally) {}
}

/// The family that fits a body; none where there is nothing to guess.
pub(super) fn family<'a>(body: &'a Body<'a>) -> Option<Box<dyn Family + 'a>> {
    match &body.kind {
        Kind::Grid { lattice, medium, group } => {
            grid::GridFamily::new(lattice, medium, *group, body.phase).map(|f| Box::new(f) as _)
        }
        Kind::Shape { shape: Shape::Slab { thickness_m, .. }, extinction, albedo } => {
            slab::SlabFamily::new(*thickness_m, *extinction, *albedo, body.phase).map(|f| Box::new(f) as _)
        }
        Kind::Shape { shape, extinction, albedo } => {
            solid::SolidFamily::new(shape, *extinction, *albedo, body.phase).map(|f| Box::new(f) as _)
        }
    }
}

/// Adds `factor` · `values` to `sums`.
#[inline(always)]
fn add(sums: &mut [f64], factor: f64, values: &[f64]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += factor * value;
    }
}
