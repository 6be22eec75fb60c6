//! Image mode: a gridded medium with many spectral groups seen by a camera, rendered once into an [`Operator`].
//!
//! The straight sight is exact; in-scattered light comes from the camera-directed cache, sampled until the errors of the
//! coefficients are below the target. Walls are never estimated: they follow by closure. The same bits come out for
//! any number of threads, since every random number is a function of (seed, batch, leaf, sample).

use super::blocks::Blocks;
use super::cache::{Cache, Leaves, Origin};
use super::camera::{Camera, PixelFilter};
use super::chamber::{ENDS, Walls};
use super::cuts::{Limits, cut};
use super::ends;
use super::error::TracerError;
use super::fine::{CELLS, Fine};
use super::gather::{Field, Light, Sight};
use super::medium::GridMedium;
use super::operator::Operator;
use super::paths::World;
use super::pixels::{Frame, sub_sights};
use super::plate::{Plate, PlateShape};
use super::reconstruct::{ROWS, Scattered, reconstruct};
use super::scatter::Scatter;
use super::spectrum::{Lane, One, Spectrum, narrow, vectorised};
use super::visibility;
use rayon::prelude::*;

/// Most spectral groups in one operator.
pub const GROUPS_MAX: usize = 64;

/// Rounds of sampling: a pilot and corrections.
const ROUNDS_MAX: usize = 8;

/// Paths of a round over those before it, at most.
const GROWTH_MAX: f64 = 3.0;

/// Cuts of the medium into leaves: a first guess and finer ones.
const CUTS_MAX: usize = 3;

/// Paths of the pilot: as many as bring the noise to twice the target where one path per image has a deviation of 0.5.
const PILOT_DEVIATION: f64 = 0.25;
const PILOT_MIN: f64 = 8192.0;
const PILOT_MAX: f64 = 1_048_576.0;

/// At least so many candidates are used to estimate errors between rounds.
const PROBES: usize = 8192;

/// Share of the target that the estimated errors of scattered light may take.
const MARGIN: f64 = 0.75;

/// Pixels of one parallel task.
const TASK_PIXELS: usize = 64;

/// Errors are computed for pixels at this distance, and averaged up to that one.
const ERROR_STRIDE: usize = 4;
const ERROR_REACH: usize = 8;

/// Share of the target that a single sight through a pixel may err.
pub(super) const PIXEL_SHARE: f32 = 0.5;

/// Albedo over target below which scattering is left out: what is scattered changes a coefficient by at most the albedo.
const ALBEDO_SHARE: f64 = 0.1;

/// Depth and spread of leaves and of path blocks at a target of 1e-3; they go with the root of the target.
const LEAF: Limits = Limits { depth: 0.3, spread: 0.1 };
const BLOCK: Limits = Limits { depth: 1.0, spread: 0.04 };

/// Cells are cut into at most so many along an edge, down to this optical depth at a target of 1e-3, and so many in all.
const SUBDIVISION_MAX: usize = 4;
const SUBDIVIDED_DEPTH: f64 = 0.1;
const SUBDIVIDED_CELLS_MAX: usize = 1 << 19;

/// How an image is rendered.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderOptions {
    /// Wanted rms standard error of a_plate, a_medium, and the walls where they are told apart, over the pixels that meet the medium.
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
        1 => Ok(job.render::<One>()),
        2..=8 => Ok(job.render::<[Lane; 1]>()),
        9..=16 => Ok(job.render::<[Lane; 2]>()),
        17..=24 => Ok(job.render::<[Lane; 3]>()),
        25..=32 => Ok(job.render::<[Lane; 4]>()),
        33..=64 => Ok(job.render::<[Lane; 8]>()),
        _ => Err(TracerError::Groups { groups: medium.groups, limit: GROUPS_MAX }),
    }
}

pub(super) struct Job<'a> {
    medium: &'a GridMedium,
    pub(super) frame: Frame<'a>,
    pub(super) options: &'a RenderOptions,
    progress: &'a (dyn Fn(f64) + Sync),
}

/// Figures of the work, by name.
pub(super) type Stats = Vec<(String, f64)>;

/// In-scattered light with the leaves that it belongs to.
pub(super) struct Lit<S> {
    pub(super) scattered: Scattered<S>,
    pub(super) leaves: Leaves,
}

/// What is known of a pixel besides its coefficients.
#[derive(Clone, Copy, Default)]
pub(super) struct Summary {
    /// Plate and medium, mean over the groups.
    pub(super) shown: [f32; ROWS],
    /// Noise and reconstruction error together, of plate and medium.
    pub(super) error: [f32; ROWS],
    /// The same of the wall that is known least.
    pub(super) error_ends: f32,
    pub(super) met: bool,
    pub(super) sights: u32,
    pub(super) cells: u32,
}

impl Job<'_> {
    fn render<S: Spectrum>(&self) -> Operator {
        let factor = self.subdivision();
        let fine = Fine::<S>::new(self.medium, factor);
        let mut stats = Stats::new();
        let plate_seen = self.frame.plate_seen();
        let candidates = self.frame.candidates(&fine.bricks, &fine.occupied);
        let pixels = plate_seen.len();
        tell(&mut stats, "cells", real(self.medium.index.len()));
        tell(&mut stats, "cells_occupied", real(self.medium.occupied()));
        tell(&mut stats, "subdivision", real(factor));
        tell(&mut stats, "bricks", real(fine.bricks.list.len()));
        tell(&mut stats, "bricks_skipped", real(fine.bricks.list.len() - fine.occupied.len()));
        (self.progress)(0.05);
        let lit = self.lit(&fine, &candidates, &mut stats);
        let mut operator = if self.frame.spreads() {
            self.gather_spread(&fine, lit.as_ref(), plate_seen, &candidates, &mut stats)
        } else {
            self.gather(&fine, lit.as_ref(), plate_seen, &candidates, &mut stats)
        };
        stats.insert(0, ("pixels".to_owned(), real(pixels)));
        stats.insert(1, ("pixels_active".to_owned(), real(operator.pixels.len())));
        stats.insert(2, ("pixels_skipped".to_owned(), real(pixels - operator.pixels.len())));
        operator.stats = stats;
        (self.progress)(1.0);
        operator
    }

    /// Into how many each cell is cut along its edges: light that is scattered inside a cell changes over a mean free path,
    /// and with the extinction from one cell to the next.
    fn subdivision(&self) -> usize {
        let m = self.medium;
        let size = [0, 1, 2].map(|a| (m.upper_m[a] - m.lower_m[a]) / real(m.cells[a]));
        let edge = size[0].max(size[1]).max(size[2]);
        let scatters =
            |(&e, &s): (&f64, &f64)| if s > ALBEDO_SHARE * self.options.target_error * e { e } else { 0.0 };
        let most = m.k_ext.par_iter().zip(&m.k_sca).map(scatters).reduce(|| 0.0, f64::max);
        let wanted = SUBDIVIDED_DEPTH * (self.options.target_error / 1e-3).sqrt().clamp(0.3, 3.0);
        let mut factor = 1;
        while self.options.scatter
            && factor < SUBDIVISION_MAX
            && most * edge > wanted * real(factor)
            && m.occupied() * (2 * factor).pow(3) <= SUBDIVIDED_CELLS_MAX
        {
            factor *= 2;
        }
        factor
    }

    /// In-scattered light, unless nothing scatters or nobody would see it.
    fn lit<S: Spectrum>(&self, fine: &Fine<S>, candidates: &[u32], stats: &mut Stats) -> Option<Lit<S>> {
        let albedo = fine.core.par_iter().map(|c| c[1].largest()).reduce(|| 0.0, f32::max);
        let skipped = f64::from(albedo) <= ALBEDO_SHARE * self.options.target_error;
        if !self.options.scatter || skipped || candidates.is_empty() {
            // What is left out: paths; and the error that it admits where the target allows it.
            tell(stats, "skipped_scattering", 1.0);
            tell(
                stats,
                "skipped_scattering_error",
                if self.options.scatter { f64::from(albedo) } else { 0.0 },
            );
            return None;
        }
        Some(self.scatter(fine, candidates, stats))
    }

    /// Samples the cache until the errors of the image are below the target.
    fn scatter<S: Spectrum>(&self, fine: &Fine<S>, candidates: &[u32], stats: &mut Stats) -> Lit<S> {
        // What the estimates of the errors miss is left room for.
        let target = MARGIN * self.options.target_error;
        let scatter = Scatter::<S>::new(&self.medium.phase);
        let probes = self.probes(fine, candidates);
        let mut scale = (target / 1e-3).sqrt().clamp(0.3, 3.0);
        let (mut rounds, mut cuts) = (0, 0);
        loop {
            let limits =
                |l: Limits| Limits { depth: l.depth * narrow(scale), spread: l.spread * narrow(scale) };
            let blocks = Blocks::<S>::new(fine, limits(BLOCK));
            let bricks = cut(fine, limits(LEAF));
            let count: usize = fine.occupied.iter().map(|&b| bricks.list[b].blocks()).sum();
            let mut leaves = Leaves { bricks, occupied: fine.occupied.clone(), demand: vec![0.0; count] };
            visibility::demand(fine, &mut leaves, self.frame.sights, self.frame.plate, &probes);
            let chamber = self.options.walls.apart();
            let world = World { blocks: &blocks, scatter: &scatter, plate: self.frame.plate, chamber };
            let origin = Origin { fine, leaves: &leaves, sights: self.frame.sights, seed: self.options.seed };
            let mut cache = Cache::<S>::new(count, fine.channels, chamber.is_some());
            let mut wanted = (PILOT_DEVIATION / target).powi(2).clamp(PILOT_MIN, PILOT_MAX);
            let mut round = 0;
            let (scattered, [noise, bias]) = loop {
                let left = real_wide(self.options.paths_max.saturating_sub(cache.samples));
                let done = 0.05 + 0.2 * real(rounds.min(4));
                let told = |p: f64| (self.progress)(done + 0.15 * p);
                cache.add(&origin, &world, wanted.min(left), &told);
                rounds += 1;
                round += 1;
                let scattered = reconstruct(fine, &leaves, &cache);
                let errors = self.probe(fine, &scattered, &leaves, candidates);
                // What is left for noise beside the reconstruction, a third of the target at least.
                let room = (target * target - errors[1] * errors[1]).max(target * target / 9.0).sqrt();
                let ratio = errors[0] / room;
                if ratio <= 1.0 || round == ROUNDS_MAX || cache.samples >= self.options.paths_max {
                    break (scattered, errors);
                }
                // Differences between leaves hold noise too: the reconstruction looks worse than it is until there is less.
                wanted = real_wide(cache.samples) * (1.1 * ratio * ratio - 1.0).min(GROWTH_MAX);
            };
            cuts += 1;
            let done = bias <= 0.8 * target
                || cuts == CUTS_MAX
                || finest(&leaves)
                || cache.samples >= self.options.paths_max;
            if done {
                for (name, value) in [
                    ("leaves", real(count)),
                    ("leaves_seen", real(leaves.demand.iter().filter(|&&d| d > 0.0).count())),
                    ("leaves_skipped", real(leaves.demand.iter().filter(|&&d| d <= 0.0).count())),
                    ("blocks", real(blocks.core.len())),
                    ("paths", real_wide(cache.samples)),
                    ("scatterings", real_wide(cache.scatterings)),
                    ("blocks_visited", real_wide(cache.blocks)),
                    ("rounds", real(rounds)),
                    ("cuts", real(cuts)),
                    ("error_noise", noise),
                    ("error_reconstruction", bias),
                ] {
                    tell(stats, name, value);
                }
                return Lit { scattered, leaves };
            }
            scale *= (0.6 * target / bias).sqrt().clamp(0.2, 0.7);
        }
    }

    /// Sights close enough together that no leaf is missed that a pixel can see.
    fn probes<S: Spectrum>(&self, fine: &Fine<S>, candidates: &[u32]) -> Vec<(f64, f64)> {
        let columns = self.frame.camera.columns;
        let wide = self.frame.pixel_in_cells(&fine.bricks);
        let centre = self.frame.camera.pixel_filter == PixelFilter::Centre;
        let stride = if wide <= 0.25 {
            4
        } else if wide <= 0.5 {
            2
        } else {
            1
        };
        let fine_sights = if centre || wide <= 1.0 {
            1
        } else if wide <= 2.0 {
            2
        } else {
            4
        };
        let mut probes: Vec<(f64, f64)> = candidates
            .iter()
            .map(|&p| (p as usize / columns, p as usize % columns))
            // Rows are shifted against each other, so that the sights do not line up with the cells.
            .filter(|&(row, column)| row % stride == 0 && (column + row / stride) % stride == 0)
            .flat_map(|(row, column)| sub_sights(row, column, fine_sights))
            .collect();
        if self.frame.spreads() {
            probes.extend(self.frame.beside(&fine.bricks, stride));
        }
        probes
    }

    /// Rms noise and reconstruction error over a part of the pixels, the larger ones of plate and medium.
    fn probe<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        scattered: &Scattered<S>,
        leaves: &Leaves,
        candidates: &[u32],
    ) -> [f64; 2] {
        let light = Light::new(scattered, leaves);
        let chamber = self.options.walls.apart();
        let field = Field { fine, plate: self.frame.plate, chamber, light: Some(light) };
        let columns = self.frame.camera.columns;
        // An odd stride walks through all columns.
        let stride = (candidates.len() / PROBES).max(1) | 1;
        let probed: Vec<[[f32; ROWS + 1]; 2]> = candidates
            .par_iter()
            .step_by(stride)
            .with_min_len(64)
            .map_init(
                || Sight::<S>::new(fine.channels, chamber.is_some()),
                |sight, &pixel| {
                    let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                    sight.clear();
                    vectorised(
                        #[inline(always)]
                        || {
                            sight.add::<true>(
                                &field,
                                self.frame.sights.ray(real(row) + 0.5, real(column) + 0.5),
                                1.0,
                            )
                        },
                    );
                    sight.met.then(|| {
                        let ([noise, bias], ends) =
                            (sight.errors(fine.groups), sight.ends_errors(fine.groups));
                        [[noise[0], noise[1], ends[0]], [bias[0], bias[1], ends[1]]]
                    })
                },
            )
            .flatten()
            .collect();
        let mean = |kind: usize, row: usize| {
            probed.iter().map(|e| f64::from(e[kind][row]).powi(2)).sum::<f64>() / real(probed.len().max(1))
        };
        [0, 1].map(|kind: usize| mean(kind, 0).max(mean(kind, 1)).max(mean(kind, 2)).sqrt())
    }

    fn gather<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        lit: Option<&Lit<S>>,
        plate_seen: Vec<f32>,
        candidates: &[u32],
        stats: &mut Stats,
    ) -> Operator {
        let chamber = self.options.walls.apart();
        let ends_seen = chamber.map_or_else(Vec::new, |c| self.frame.ends_seen(c, &plate_seen));
        let field = Field {
            fine,
            plate: self.frame.plate,
            chamber,
            light: lit.map(|lit| Light::new(&lit.scattered, &lit.leaves)),
        };
        let width = self.width(fine.groups, fine.channels);
        let mut values = vec![0.0_f32; candidates.len() * width];
        let mut summaries: Vec<Summary> = values
            .par_chunks_mut(width * TASK_PIXELS)
            .zip(candidates.par_chunks(TASK_PIXELS))
            .flat_map_iter(|(values, pixels)| {
                let jobs: Vec<(u32, usize)> = pixels.iter().map(|&p| (p, 1)).collect();
                self.pixels(&field, &plate_seen, &jobs, values)
            })
            .collect();
        // Where the image bends from pixel to pixel, one sight does not give the mean.
        let mut shown: Vec<[f32; ROWS]> = plate_seen.iter().map(|&seen| [seen, 0.0]).collect();
        for (&pixel, summary) in candidates.iter().zip(&summaries) {
            shown[pixel as usize] = summary.shown;
        }
        let tolerance = PIXEL_SHARE * narrow(self.options.target_error);
        let refined: Vec<(usize, [f32; ROWS])> = candidates
            .par_iter()
            .with_min_len(1024)
            .map(|&p| {
                let pixel = p as usize;
                let (n, error) = self.frame.refinement(&shown, pixel, plate_seen[pixel], tolerance);
                let seen = ends_seen.get(pixel * ENDS..(pixel + 1) * ENDS).unwrap_or_default();
                (if ends::mixed(seen) { ends::EDGE_SIGHTS } else { n }, error)
            })
            .collect();
        let again: Vec<usize> = (0..candidates.len()).filter(|&i| refined[i].0 > 1).collect();
        let mut more = vec![0.0_f32; again.len() * width];
        let second: Vec<Summary> = more
            .par_chunks_mut(width * 16)
            .zip(again.par_chunks(16))
            .flat_map_iter(|(values, chosen)| {
                let jobs: Vec<(u32, usize)> = chosen.iter().map(|&i| (candidates[i], refined[i].0)).collect();
                self.pixels(&field, &plate_seen, &jobs, values)
            })
            .collect();
        for ((&i, values_more), summary) in again.iter().zip(more.chunks_exact(width)).zip(second) {
            values[i * width..(i + 1) * width].copy_from_slice(values_more);
            let before = summaries[i];
            summaries[i] = Summary {
                met: summary.met || before.met,
                sights: summary.sights + before.sights,
                cells: summary.cells + before.cells,
                ..summary
            };
        }
        let rms = |row: usize| {
            let square = |e: &(usize, [f32; ROWS])| f64::from(e.1[row]).powi(2);
            (refined.iter().map(square).sum::<f64>() / real(refined.len().max(1))).sqrt()
        };
        tell(stats, "sights", summaries.iter().map(|s| f64::from(s.sights)).sum());
        tell(stats, "cells_visited", summaries.iter().map(|s| f64::from(s.cells)).sum());
        tell(stats, "pixels_refined", real(again.len()));
        tell(stats, "error_pixel", rms(0).max(rms(1)));
        let active: Vec<usize> = (0..candidates.len()).filter(|&i| summaries[i].met).collect();
        let mut operator = self.assemble(fine, plate_seen, candidates, &values, &active);
        operator.ends_seen = ends_seen;
        self.errors(operator, &summaries, &refined, &active, stats)
    }

    /// Coefficients of a pixel: plate, emission, direct emission, and ends of rays where walls are told apart.
    pub(super) fn width(&self, groups: usize, channels: usize) -> usize {
        groups * (1 + 2 * channels + if self.options.walls.apart().is_some() { ENDS } else { 0 })
    }

    /// The sights of some pixels with so many sub-sights per axis; coefficients into `values`, pixel by pixel as
    /// [`Job::width`] says.
    fn pixels<S: Spectrum>(
        &self,
        field: &Field<'_, S>,
        plate_seen: &[f32],
        jobs: &[(u32, usize)],
        values: &mut [f32],
    ) -> Vec<Summary> {
        let (groups, channels) = (field.fine.groups, field.fine.channels);
        let columns = self.frame.camera.columns;
        let mut sight = Sight::<S>::new(channels, field.chamber.is_some());
        let width = self.width(groups, channels);
        let mut summaries = Vec::with_capacity(jobs.len());
        vectorised(
            #[inline(always)]
            || {
                for (&(pixel, n), values) in jobs.iter().zip(values.chunks_exact_mut(width)) {
                    let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                    sight.clear();
                    (sight.sights, sight.cells) = (0, 0);
                    let shares = self.shares(row, column, n, plate_seen[pixel as usize]);
                    let mut k = 0;
                    while k < n * n {
                        let place = [k / n, k % n].map(|i| (real(i) + 0.5) / real(n));
                        let (r, c) = (real(row) + place[0], real(column) + place[1]);
                        let ray = self.frame.sights.ray(r, c);
                        let share = match shares {
                            None => 1.0,
                            Some([on, _]) if self.frame.sees(r, c) => on,
                            Some([_, off]) => off,
                        };
                        if with_errors(row, column) {
                            sight.add::<true>(field, ray, share);
                        } else {
                            sight.add::<false>(field, ray, share);
                        }
                        k += 1;
                    }
                    summaries.push(finish(&sight, groups, values));
                }
            },
        );
        summaries
    }

    /// Weights of sub-sights that see the plate and of those that do not, where its edge crosses the pixel.
    fn shares(&self, row: usize, column: usize, n: usize, seen: f32) -> Option<[f32; 2]> {
        if n == 1 || seen <= 0.0 || seen >= 1.0 {
            return None;
        }
        let hits = sub_sights(row, column, n).filter(|&(r, c)| self.frame.sees(r, c)).count();
        let misses = n * n - hits;
        (hits > 0 && misses > 0).then(|| [seen / narrow(real(hits)), (1.0 - seen) / narrow(real(misses))])
    }

    pub(super) fn assemble<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        plate_seen: Vec<f32>,
        candidates: &[u32],
        values: &[f32],
        active: &[usize],
    ) -> Operator {
        let (groups, channels) = (fine.groups, fine.channels);
        let width = self.width(groups, channels);
        let part = |from: usize, to: usize| -> Vec<f32> {
            let mut out = vec![0.0; active.len() * (to - from)];
            if from == to {
                return out;
            }
            out.par_chunks_mut(1024 * (to - from)).zip(active.par_chunks(1024)).for_each(|(out, active)| {
                for (out, &i) in out.chunks_exact_mut(to - from).zip(active) {
                    out.copy_from_slice(&values[i * width + from..i * width + to]);
                }
            });
            out
        };
        Operator {
            rows: self.frame.camera.rows,
            columns: self.frame.camera.columns,
            groups,
            channels,
            plate_seen,
            pixels: active.iter().map(|&i| candidates[i]).collect(),
            a_plate: part(0, groups),
            emission: part(groups, groups * (1 + channels)),
            direct: part(groups * (1 + channels), groups * (1 + 2 * channels)),
            a_ends: part(groups * (1 + 2 * channels), width),
            ..Operator::default()
        }
    }

    /// The half differences are single draws: their rms over nearby pixels is the error, to which that of the mean over
    /// the pixel's area is added.
    pub(super) fn errors(
        &self,
        mut operator: Operator,
        summaries: &[Summary],
        refined: &[(usize, [f32; ROWS])],
        active: &[usize],
        stats: &mut Stats,
    ) -> Operator {
        let (rows, columns) = (operator.rows, operator.columns);
        let mut image = vec![[f32::NAN; ROWS + 1]; rows * columns];
        let (mut mean, mut count) = ([0.0_f32; ROWS + 1], 0.0_f32);
        for (&pixel, &i) in operator.pixels.iter().zip(active) {
            if with_errors(pixel as usize / columns, pixel as usize % columns) {
                let [plate, medium] = summaries[i].error;
                let square = [plate, medium, summaries[i].error_ends].map(|e| e * e);
                image[pixel as usize] = square;
                mean = [mean[0] + square[0], mean[1] + square[1], mean[2] + square[2]];
                count += 1.0;
            }
        }
        let mean = mean.map(|m| m / count.max(1.0));
        let spread: Vec<[f32; ROWS + 1]> = operator
            .pixels
            .par_iter()
            .zip(active)
            .with_min_len(256)
            .map(|(&pixel, &i)| {
                let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                let (mut sum, mut n) = ([0.0_f32; ROWS + 1], 0.0_f32);
                let low = [row, column].map(|i| i.saturating_sub(ERROR_REACH).next_multiple_of(ERROR_STRIDE));
                for r in (low[0]..(row + ERROR_REACH + 1).min(rows)).step_by(ERROR_STRIDE) {
                    for c in (low[1]..(column + ERROR_REACH + 1).min(columns)).step_by(ERROR_STRIDE) {
                        let e = image[r * columns + c];
                        if !e[0].is_nan() {
                            sum = [sum[0] + e[0], sum[1] + e[1], sum[2] + e[2]];
                            n += 1.0;
                        }
                    }
                }
                if n <= 0.0 {
                    // A lonely pixel between those with errors.
                    (sum, n) = (mean, 1.0);
                }
                let [plate, medium] = refined[i].1;
                let pixel = [plate, medium, plate.max(medium)];
                [0, 1, 2].map(|k: usize| (sum[k] / n).sqrt().hypot(pixel[k]))
            })
            .collect();
        operator.error_plate = spread.iter().map(|s| s[0]).collect();
        operator.error_medium = spread.iter().map(|s| s[1]).collect();
        let rms = |errors: &[f32]| {
            (errors.iter().map(|&e| f64::from(e).powi(2)).sum::<f64>() / real(errors.len().max(1))).sqrt()
        };
        tell(stats, "error_plate_rms", rms(&operator.error_plate));
        tell(stats, "error_medium_rms", rms(&operator.error_medium));
        if self.options.walls.apart().is_some() {
            operator.error_ends = spread.iter().map(|s| s[2]).collect();
            tell(stats, "error_walls_rms", rms(&operator.error_ends));
        }
        operator
    }
}

/// Whether a pixel's errors are followed: for one in 16, of which those nearby are averaged.
pub(super) fn with_errors(row: usize, column: usize) -> bool {
    row.is_multiple_of(ERROR_STRIDE) && column.is_multiple_of(ERROR_STRIDE)
}

/// Whether no leaf can be cut further.
fn finest(leaves: &Leaves) -> bool {
    leaves.occupied.len() * CELLS == leaves.demand.len()
}

/// A complete sight as coefficients.
pub(super) fn finish<S: Spectrum>(sight: &Sight<S>, groups: usize, values: &mut [f32]) -> Summary {
    let share = 1.0 / sight.weight.max(f32::MIN_POSITIVE);
    let channels = sight.emission.len();
    let mut shown = [0.0; ROWS];
    for g in 0..groups {
        let mut plate = sight.plate.get(g) * share;
        let mut medium = (sight.direct[0].get(g) + sight.emission[0].get(g)) * share;
        // Against the rounding of the sums (1e-6), so that the walls' share is never negative.
        let sum = plate + medium;
        if sum > 1.0 {
            plate /= sum;
            medium /= sum;
        }
        values[g] = plate;
        values[groups + g] = medium;
        shown[0] += plate;
        shown[1] += medium;
        values[(1 + channels) * groups + g] = sight.direct[0].get(g) * share;
        for c in 1..channels {
            let direct = sight.direct[c].get(g);
            values[(1 + c) * groups + g] = (direct + sight.emission[c].get(g)) * share;
            values[(1 + channels + c) * groups + g] = direct * share;
        }
    }
    let (before, ends) = values.split_at_mut((1 + 2 * channels) * groups);
    for (end, values) in sight.ends.iter().zip(ends.chunks_exact_mut(groups)) {
        for (g, value) in values.iter_mut().enumerate() {
            *value = end.get(g) * share;
        }
    }
    ends::close(ends, &before[..groups], &before[groups..2 * groups]);
    let per_group = 1.0 / narrow(real(groups));
    let [noise, bias] = sight.errors(groups);
    let [noise_ends, bias_ends] = sight.ends_errors(groups);
    Summary {
        shown: shown.map(|s| s * per_group),
        error: [noise[0].hypot(bias[0]), noise[1].hypot(bias[1])],
        error_ends: noise_ends.hypot(bias_ends),
        met: sight.met,
        sights: u32::try_from(sight.sights).unwrap_or(u32::MAX),
        cells: u32::try_from(sight.cells).unwrap_or(u32::MAX),
    }
}

pub(super) fn tell(stats: &mut Stats, name: &str, value: f64) {
    stats.push((name.to_owned(), value));
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

#[expect(clippy::cast_precision_loss, reason = "path counts are far below 2^53")]
fn real_wide(n: u64) -> f64 {
    n as f64
}
