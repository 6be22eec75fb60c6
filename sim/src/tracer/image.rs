//! Image mode: a gridded medium with many spectral groups seen by a camera, rendered once into an [`Operator`].
//!
//! The straight sight is exact; in-scattered light comes from the camera-directed cache, sampled until the errors of the
//! coefficients are below the target. Walls are never estimated: they follow by closure. The same bits come out for
//! any number of threads, since every random number is a function of (seed, batch, leaf, sample).

use super::camera::Camera;
use super::chamber::{ENDS, Walls};
use super::error::TracerError;
use super::fine::Fine;
use super::medium::GridMedium;
use super::operator::Operator;
use super::pixels::Frame;
use super::plate::{Plate, PlateShape};
use super::sampling::Lit;
use super::shots::denser;
use super::spectrum::{Lane, One, Spectrum, Wide};
use rayon::prelude::*;

/// Most spectral groups in one operator.
pub const GROUPS_MAX: usize = 64;

/// Albedo over target below which scattering is left out: what is scattered changes a coefficient by at most the albedo.
pub(super) const ALBEDO_SHARE: f64 = 0.1;

/// Cells are cut into at most so many along an edge, down to this optical depth at a target of 1e-3, and so many in all.
const SUBDIVISION_MAX: usize = 4;
const SUBDIVIDED_DEPTH: f64 = 0.1;
const SUBDIVIDED_CELLS_MAX: usize = 1 << 19;

/// Cells times groups up to which they are cut once more where they turned out too coarse.
const SUBDIVIDED_AGAIN_MAX: usize = 1 << 22;

/// How an image is rendered.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderOptions {
    /// Wanted rms standard error of a_plate and a_medium over the pixels that meet the medium.
    pub target_error: f64,
    /// Names the random numbers.
    pub seed: u64,
    /// False: scattered light is lost, only the straight sights count.
    pub scatter: bool,
    /// Upper limit of the number of paths; when it is reached the operator's errors say so.
    pub paths_max: u64,
    /// What surrounds the medium, which must lie inside.
    pub walls: Walls,
    /// How far the medium moves during the exposure, in metres; zero: it stands still. The exposure is centred at the
    /// medium's own moment, and the light scattered into the sights is that of this moment: what changes evenly cancels.
    pub motion_m: [f64; 3],
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            target_error: 1e-3,
            seed: 1,
            scatter: true,
            paths_max: 1 << 28,
            motion_m: [0.0; 3],
            walls: Walls::Far,
        }
    }
}

impl RenderOptions {
    pub(super) fn check_motion(&self) -> Result<(), TracerError> {
        if self.motion_m.iter().all(|c| c.is_finite()) {
            return Ok(());
        }
        Err(TracerError::Geometry { what: "the medium's motion during the exposure", condition: "finite" })
    }
}

/// Renders a medium as seen by a camera.
///
/// `progress` is called now and then, from any thread, with the share of the work done.
///
/// # Errors
///
/// [`TracerError`] for a medium, camera or plate that makes no sense, or more than [`GROUPS_MAX`] groups.
pub fn render_image(
    medium: &GridMedium,
    camera: &Camera,
    plate: Option<&PlateShape>,
    options: &RenderOptions,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Operator, TracerError> {
    let mut image = None;
    let mut take = |operator| image = Some(operator);
    render_shots(medium, camera, plate, options, &mut std::iter::empty(), &mut take, progress)?;
    Ok(image.unwrap_or_default())
}

/// Renders a medium, and then further shots of it whose densities differ cell by cell; `take` gets all operators in
/// their order.
///
/// `shots` gives the factors of each shot on the densities, one per occupied cell in the medium's order. Only the sights
/// are followed again; light scattered into them is that of the medium itself, brought in line with the densities around
/// (module `shots`). The statistics of a shot tell its own work.
///
/// # Errors
///
/// As [`render_image`]; [`TracerError::Shape`] and [`TracerError::Coefficient`] for factors that do not fit, are negative
/// or undefined.
pub fn render_shots(
    medium: &GridMedium,
    camera: &Camera,
    plate: Option<&PlateShape>,
    options: &RenderOptions,
    shots: &mut dyn Iterator<Item = Vec<f32>>,
    take: &mut dyn FnMut(Operator),
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(), TracerError> {
    medium.check()?;
    if options.target_error.is_nan() || options.target_error <= 0.0 {
        return Err(TracerError::Geometry { what: "the target error", condition: "positive" });
    }
    options.check_motion()?;
    let sights = camera.sights()?;
    let plate = plate.map(Plate::new).transpose()?;
    let frame = Frame { camera, sights: &sights, plate: plate.as_ref(), motion: options.motion_m };
    let job = Job { medium, frame, options, progress };
    match medium.groups {
        1 => job.render::<One>(shots, take),
        2..=8 => job.render::<[Lane; 1]>(shots, take),
        9..=16 => job.render::<[Wide; 1]>(shots, take),
        17..=32 => job.render::<[Wide; 2]>(shots, take),
        33..=64 => job.render::<[Wide; 4]>(shots, take),
        _ => Err(TracerError::Groups { groups: medium.groups, limit: GROUPS_MAX }),
    }
}

pub(super) struct Job<'a> {
    pub(super) medium: &'a GridMedium,
    pub(super) frame: Frame<'a>,
    pub(super) options: &'a RenderOptions,
    pub(super) progress: &'a (dyn Fn(f64) + Sync),
}

/// Figures of the work, by name.
pub(super) type Stats = Vec<(String, f64)>;

impl Job<'_> {
    fn render<S: Spectrum>(
        &self,
        shots: &mut dyn Iterator<Item = Vec<f32>>,
        take: &mut dyn FnMut(Operator),
    ) -> Result<(), TracerError> {
        let plate_seen = self.frame.plate_seen();
        let mut factor = self.subdivision();
        let (fine, candidates, lit, stats) = loop {
            let mut stats = Stats::new();
            let fine = Fine::<S>::new(self.medium, factor);
            let candidates = self.frame.candidates(&fine.bricks, &fine.occupied);
            tell(&mut stats, "cells", real(self.medium.index.len()));
            tell(&mut stats, "cells_occupied", real(self.medium.occupied()));
            tell(&mut stats, "subdivision", real(factor));
            tell(&mut stats, "bricks", real(fine.bricks.list.len()));
            tell(&mut stats, "bricks_skipped", real(fine.bricks.list.len() - fine.occupied.len()));
            (self.progress)(0.05);
            let lit = self.lit(&fine, &candidates, &mut stats);
            if !(lit.as_ref().is_some_and(|lit| lit.coarse) && self.divides_again(factor)) {
                break (fine, candidates, lit, stats);
            }
            factor *= 2;
        };
        take(self.shown(&fine, lit.as_ref(), plate_seen.clone(), &candidates, stats));
        (self.progress)(1.0);
        for factors in shots {
            let (fine, lit) = denser(&fine, self.medium.occupied(), lit.as_ref(), &factors)?;
            take(self.shown(&fine, lit.as_ref(), plate_seen.clone(), &candidates, Stats::new()));
        }
        Ok(())
    }

    /// The image of a medium whose in-scattered light is known.
    fn shown<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        lit: Option<&Lit<S>>,
        plate_seen: Vec<f32>,
        candidates: &[u32],
        mut stats: Stats,
    ) -> Operator {
        let pixels = plate_seen.len();
        let mut operator = if self.frame.spreads() {
            self.gather_spread(fine, lit, plate_seen, candidates, &mut stats)
        } else {
            self.gather(fine, lit, plate_seen, candidates, &mut stats)
        };
        stats.insert(0, ("pixels".to_owned(), real(pixels)));
        stats.insert(1, ("pixels_active".to_owned(), real(operator.pixels.len())));
        stats.insert(2, ("pixels_skipped".to_owned(), real(pixels - operator.pixels.len())));
        operator.stats = stats;
        operator
    }

    /// Coefficients of a pixel: plate, emission, direct emission, and ends of rays where walls are told apart.
    pub(super) fn width(&self, groups: usize, channels: usize) -> usize {
        groups * (1 + 2 * channels + if self.options.walls.apart().is_some() { ENDS } else { 0 })
    }

    /// Into how many each cell is cut along its edges: light that is scattered inside a cell changes over a mean free path,
    /// and with the extinction from one cell to the next.
    fn subdivision(&self) -> usize {
        let m = self.medium;
        let room = |factor: usize| {
            factor < SUBDIVISION_MAX && m.occupied() * (2 * factor).pow(3) <= SUBDIVIDED_CELLS_MAX
        };
        if !(self.options.scatter && room(1)) {
            return 1;
        }
        let size = [0, 1, 2].map(|a| (m.upper_m[a] - m.lower_m[a]) / real(m.cells[a]));
        let edge = size[0].max(size[1]).max(size[2]);
        let scatters =
            |(&e, &s): (&f64, &f64)| if s > ALBEDO_SHARE * self.options.target_error * e { e } else { 0.0 };
        let most = m.k_ext.par_iter().zip(&m.k_sca).map(scatters).reduce(|| 0.0, f64::max);
        let wanted = SUBDIVIDED_DEPTH * (self.options.target_error / 1e-3).sqrt().clamp(0.3, 3.0);
        let mut factor = 1;
        while most * edge > wanted * real(factor) && room(factor) {
            factor *= 2;
        }
        factor
    }

    /// Whether cells that are too coarse for the light scattered in them may be cut once more.
    fn divides_again(&self, factor: usize) -> bool {
        let cells = self.medium.occupied().saturating_mul((2 * factor).pow(3));
        2 * factor <= SUBDIVISION_MAX
            && cells.saturating_mul(self.medium.groups.max(4) / 4) <= SUBDIVIDED_AGAIN_MAX
    }
}

pub(super) fn tell(stats: &mut Stats, name: &str, value: f64) {
    stats.push((name.to_owned(), value));
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
