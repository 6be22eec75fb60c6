//! Image mode: a gridded medium with many spectral groups seen by a camera, rendered once into an [`Operator`].
//!
//! The straight sight is exact; in-scattered light comes from the camera-directed cache, sampled until the noise of the
//! coefficients is below the target. Walls are never estimated: they follow by closure. The same bits come out for
//! any number of threads, since every random number is a function of (seed, batch, leaf, sample).

use super::cache::{Cache, Leaves, PhaseLanes, World};
use super::camera::{Camera, PixelFilter, Sights};
use super::error::TracerError;
use super::gather::Sight;
use super::lanes::Lane;
use super::medium::GridMedium;
use super::operator::Operator;
use super::packed::{Packed, narrow};
use super::plate::{Plate, PlateShape};
use super::reconstruct::{self, Scattered};
use rayon::prelude::*;

/// Most spectral groups in one operator.
pub const GROUPS_MAX: usize = 64;

/// Rounds of sampling: a first guess and corrections.
const ROUNDS_MAX: usize = 4;

/// Paths per leaf in the first round.
const FIRST_PATHS_PER_LEAF: f64 = 8.0;

/// Every so many active pixels one is used to estimate the noise between rounds.
const PROBE_STRIDE: usize = 17;

/// Sub-sights per axis in pixels that the plate's edge crosses.
const EDGE_SIGHTS: usize = 4;

/// Cells along an axis from which on later segments of paths march on blocks of 2³ cells.
const COARSE_FROM_CELLS: usize = 40;

/// Pixels of one parallel task.
const TASK_PIXELS: usize = 64;

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
    /// From its third segment on a path marches on blocks of this many cells cubed (1 = the cells; 0 = by their number).
    pub path_coarsening: usize,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { target_error: 1e-3, seed: 1, scatter: true, paths_max: 1 << 26, path_coarsening: 0 }
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
    let sights = camera.sights()?;
    let plate = plate.map(Plate::new).transpose()?;
    let job = Job { medium, camera, sights, plate: plate.as_ref(), options, progress };
    match medium.groups.div_ceil(8) {
        1 => Ok(job.render::<1>()),
        2 => Ok(job.render::<2>()),
        3 => Ok(job.render::<3>()),
        4 => Ok(job.render::<4>()),
        5 | 6 => Ok(job.render::<6>()),
        7 | 8 => Ok(job.render::<8>()),
        _ => Err(TracerError::Groups { groups: medium.groups, limit: GROUPS_MAX }),
    }
}

struct Job<'a> {
    medium: &'a GridMedium,
    camera: &'a Camera,
    sights: Sights,
    plate: Option<&'a Plate>,
    options: &'a RenderOptions,
    progress: &'a (dyn Fn(f64) + Sync),
}

/// One pixel that meets the medium.
#[derive(Clone, Copy)]
struct Active {
    pixel: u32,
    /// Sub-sights per axis.
    sights: usize,
}

impl Job<'_> {
    fn render<const N: usize>(&self) -> Operator {
        let fine = Packed::<N>::new(self.medium, 1);
        let (plate_seen, active) = self.survey(&fine);
        let mut stats = vec![
            ("pixels".to_owned(), real(plate_seen.len())),
            ("pixels_active".to_owned(), real(active.len())),
            ("pixels_skipped".to_owned(), real(plate_seen.len() - active.len())),
            ("cells_occupied".to_owned(), real(fine.k.len())),
        ];
        (self.progress)(0.02);
        let scatters = self.medium.k_sca.iter().any(|&k| k > 0.0);
        let scattered = (self.options.scatter && scatters && !active.is_empty())
            .then(|| self.scatter(&fine, &active, &mut stats));
        let operator = self.gather(&fine, scattered.as_ref(), plate_seen, &active, stats);
        (self.progress)(1.0);
        operator
    }

    /// Which pixels meet the medium, how finely they must be sampled, and what each sees of the plate.
    fn survey<const N: usize>(&self, fine: &Packed<N>) -> (Vec<f32>, Vec<Active>) {
        let (rows, columns) = (self.camera.rows, self.camera.columns);
        let box_filter = self.camera.pixel_filter == PixelFilter::Box;
        let meets = |row: f64, column: f64| {
            let (origin, direction) = self.sights.ray(row, column);
            let mut met = false;
            fine.lattice.walk(origin, direction, f64::INFINITY, |_, _, _| {
                met = true;
                false
            });
            met
        };
        let sees = |row: f64, column: f64| {
            let (origin, direction) = self.sights.ray(row, column);
            self.plate.is_some_and(|p| p.hit(origin, direction).is_some())
        };
        // Corners of pixels are shared: one flag per corner.
        let corners: Vec<[bool; 2]> = (0..=rows)
            .into_par_iter()
            .flat_map_iter(|r| (0..=columns).map(move |c| [meets(real(r), real(c)), sees(real(r), real(c))]))
            .collect();
        let wide = self.pixel_is_wide(fine);
        let surveyed: Vec<(f32, Option<Active>)> = (0..rows * columns)
            .into_par_iter()
            .with_min_len(256)
            .map(|pixel| {
                let (row, column) = (pixel / columns, pixel % columns);
                let at = [0, 1, columns + 1, columns + 2].map(|k| corners[row * (columns + 1) + column + k]);
                let centre =
                    [meets(real(row) + 0.5, real(column) + 0.5), sees(real(row) + 0.5, real(column) + 0.5)];
                let same = |k: usize| at.iter().all(|c| c[k] == centre[k]);
                let (edge, border) = (box_filter && !same(1), box_filter && !same(0));
                let sights = if edge {
                    EDGE_SIGHTS
                } else if border || (wide && box_filter) {
                    2
                } else {
                    1
                };
                let seen = if edge {
                    let hits = sub_sights(row, column, EDGE_SIGHTS).filter(|&(r, c)| sees(r, c)).count();
                    narrow(real(hits) / real(EDGE_SIGHTS * EDGE_SIGHTS))
                } else {
                    f32::from(u8::from(centre[1]))
                };
                let active = centre[0] || (box_filter && at.iter().any(|c| c[0]));
                let pixel = u32::try_from(pixel).unwrap_or(u32::MAX);
                (seen, active.then_some(Active { pixel, sights }))
            })
            .collect();
        (surveyed.iter().map(|s| s.0).collect(), surveyed.iter().filter_map(|s| s.1).collect())
    }

    /// Whether a pixel covers more than half a cell where the camera looks at the medium.
    fn pixel_is_wide<const N: usize>(&self, fine: &Packed<N>) -> bool {
        let cells = fine.lattice.cells.map(|n| 0.5 * real(n));
        let centre = fine.lattice.place(cells);
        let (_, distance) = self.sights.towards(centre);
        let (o0, d0) = self.sights.ray(0.5 * real(self.camera.rows), 0.5 * real(self.camera.columns));
        let (o1, d1) = self.sights.ray(0.5 * real(self.camera.rows), 0.5 * real(self.camera.columns) + 1.0);
        let apart = super::vector::sub(
            super::vector::along(o1, distance, d1),
            super::vector::along(o0, distance, d0),
        );
        let smallest = fine.lattice.size.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        super::vector::dot(apart, apart).sqrt() > 0.5 * smallest
    }

    /// Samples the cache until the noise of the image is below the target.
    fn scatter<const N: usize>(
        &self,
        fine: &Packed<N>,
        active: &[Active],
        stats: &mut Vec<(String, f64)>,
    ) -> Scattered<N> {
        let factor = match self.options.path_coarsening {
            0 if self.medium.cells.iter().any(|&n| n >= COARSE_FROM_CELLS) => 2,
            0 => 1,
            f => f,
        };
        let coarse = (factor > 1).then(|| Packed::<N>::new(self.medium, factor));
        let leaves = Leaves::new(fine, &self.sights);
        let phase = PhaseLanes::new(&self.medium.phase);
        let world = World {
            coarse: coarse.as_ref(),
            leaves: &leaves,
            phase: &phase,
            plate: self.plate,
            sights: &self.sights,
            fine,
            groups: self.medium.groups,
            seed: self.options.seed,
        };
        let mut cache = Cache::<N>::new(&leaves, self.medium.channels);
        let mut sums = vec![[Lane::ZERO; N]; leaves.list.len() * cache.rows];
        let mut wanted = FIRST_PATHS_PER_LEAF * real(leaves.list.len());
        let mut rounds = 0;
        let (mut scattered, error) = loop {
            let left = real_wide(self.options.paths_max.saturating_sub(cache.samples));
            let share = 0.05 + 0.3 * real(rounds);
            cache.add(&world, &mut sums, wanted.min(left), &|p| (self.progress)(share + 0.3 * p));
            rounds += 1;
            let scattered = reconstruct::per_cell(fine, &leaves, &cache, &sums);
            let error = self.probe(fine, &scattered, active);
            let ratio = error / self.options.target_error;
            if ratio <= 1.0 || rounds == ROUNDS_MAX || cache.samples >= self.options.paths_max {
                break (scattered, error);
            }
            wanted = real_wide(cache.samples) * (1.1 * ratio * ratio - 1.0);
        };
        scattered.times_albedo(fine);
        stats.extend([
            ("leaves".to_owned(), real(leaves.list.len())),
            ("paths".to_owned(), real_wide(cache.samples)),
            ("scatterings".to_owned(), real_wide(cache.scatterings)),
            ("rounds".to_owned(), real(rounds)),
            ("path_coarsening".to_owned(), real(factor)),
            ("error_estimated".to_owned(), error),
        ]);
        scattered
    }

    /// Rms noise over a part of the active pixels, the larger one of plate and medium.
    fn probe<const N: usize>(&self, fine: &Packed<N>, scattered: &Scattered<N>, active: &[Active]) -> f64 {
        let probed: Vec<[f32; 2]> = active
            .par_iter()
            .step_by(if active.len() > 64 * PROBE_STRIDE { PROBE_STRIDE } else { 1 })
            .map(|a| {
                let (row, column) =
                    (a.pixel as usize / self.camera.columns, a.pixel as usize % self.camera.columns);
                let ray = self.sights.ray(real(row) + 0.5, real(column) + 0.5);
                let mut sight = Sight::<N>::new(self.medium.channels);
                pulp::Arch::new().dispatch(
                    #[inline(always)]
                    || sight.add(fine, Some(scattered), self.plate, ray),
                );
                sight.noise_rms(self.medium.groups)
            })
            .collect();
        let square = |v: f32| f64::from(v) * f64::from(v);
        let mean = |k: usize| probed.iter().map(|n| square(n[k])).sum::<f64>() / real(probed.len().max(1));
        mean(0).max(mean(1)).sqrt()
    }

    fn gather<const N: usize>(
        &self,
        fine: &Packed<N>,
        scattered: Option<&Scattered<N>>,
        plate_seen: Vec<f32>,
        active: &[Active],
        stats: Vec<(String, f64)>,
    ) -> Operator {
        let (groups, channels) = (self.medium.groups, self.medium.channels);
        let n = active.len();
        let mut operator = Operator {
            rows: self.camera.rows,
            columns: self.camera.columns,
            groups,
            channels,
            plate_seen,
            pixels: active.iter().map(|a| a.pixel).collect(),
            a_plate: vec![0.0; n * groups],
            emission: vec![0.0; n * groups * channels],
            direct: vec![0.0; n * groups * channels],
            error_plate: vec![0.0; n],
            error_medium: vec![0.0; n],
            stats,
        };
        let arch = pulp::Arch::new();
        let wide = groups * channels;
        let noise: Vec<[f32; 2]> = active
            .par_chunks(TASK_PIXELS)
            .zip(operator.a_plate.par_chunks_mut(TASK_PIXELS * groups))
            .zip(operator.emission.par_chunks_mut(TASK_PIXELS * wide))
            .zip(operator.direct.par_chunks_mut(TASK_PIXELS * wide))
            .flat_map_iter(|(((active, plates), emissions), directs)| {
                let mut sight = Sight::<N>::new(channels);
                let mut noise = Vec::with_capacity(active.len());
                for (i, a) in active.iter().enumerate() {
                    arch.dispatch(
                        #[inline(always)]
                        || self.pixel(fine, scattered, *a, &mut sight),
                    );
                    let share = 1.0 / narrow(real(sight.count.max(1)));
                    unpack(&sight.plate, share, &mut plates[i * groups..(i + 1) * groups]);
                    for c in 0..channels {
                        let place = (i * channels + c) * groups..(i * channels + c + 1) * groups;
                        let total = if scattered.is_some() { &sight.emission[c] } else { &sight.direct[c] };
                        unpack(total, share, &mut emissions[place.clone()]);
                        unpack(&sight.direct[c], share, &mut directs[place]);
                    }
                    close(
                        &mut plates[i * groups..(i + 1) * groups],
                        &mut emissions[i * wide..i * wide + groups],
                    );
                    noise.push(sight.error_rms(groups));
                }
                noise
            })
            .collect();
        self.spread_errors(&noise, &mut operator);
        operator
    }

    #[inline(always)]
    fn pixel<const N: usize>(
        &self,
        fine: &Packed<N>,
        scattered: Option<&Scattered<N>>,
        active: Active,
        sight: &mut Sight<N>,
    ) {
        let (row, column) =
            (active.pixel as usize / self.camera.columns, active.pixel as usize % self.camera.columns);
        sight.clear();
        for (r, c) in sub_sights(row, column, active.sights) {
            sight.add(fine, scattered, self.plate, self.sights.ray(r, c));
        }
    }

    /// The half differences are single draws: their rms over 9×9 pixels is the error.
    fn spread_errors(&self, noise: &[[f32; 2]], operator: &mut Operator) {
        let (rows, columns) = (operator.rows, operator.columns);
        let mut image = vec![[f32::NAN; 2]; rows * columns];
        for (&pixel, &n) in operator.pixels.iter().zip(noise) {
            image[pixel as usize] = n;
        }
        let pixels = &operator.pixels;
        let spread: Vec<[f32; 2]> = pixels
            .par_iter()
            .with_min_len(256)
            .map(|&pixel| {
                let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                let mut sum = [0.0_f32; 3];
                for r in row.saturating_sub(8)..(row + 9).min(rows) {
                    if (r + row) % 2 == 1 {
                        continue;
                    }
                    for c in (column.saturating_sub(8)..(column + 9).min(columns))
                        .filter(|c| (c + column) % 2 == 0)
                    {
                        let n = image[r * columns + c];
                        if !n[0].is_nan() {
                            sum = [sum[0] + n[0] * n[0], sum[1] + n[1] * n[1], sum[2] + 1.0];
                        }
                    }
                }
                [(sum[0] / sum[2]).sqrt(), (sum[1] / sum[2]).sqrt()]
            })
            .collect();
        operator.error_plate = spread.iter().map(|s| s[0]).collect();
        operator.error_medium = spread.iter().map(|s| s[1]).collect();
        let rms = |errors: &[f32]| {
            (errors.iter().map(|&e| f64::from(e) * f64::from(e)).sum::<f64>() / real(errors.len().max(1)))
                .sqrt()
        };
        operator.stats.push(("error_plate_rms".to_owned(), rms(&operator.error_plate)));
        operator.stats.push(("error_medium_rms".to_owned(), rms(&operator.error_medium)));
    }
}

/// Positions of `n`² sub-sights in a pixel.
fn sub_sights(row: usize, column: usize, n: usize) -> impl Iterator<Item = (f64, f64)> {
    let place = move |k: usize| (real(k) + 0.5) / real(n);
    (0..n * n).map(move |k| (real(row) + place(k / n), real(column) + place(k % n)))
}

fn unpack<const N: usize>(lanes: &[Lane; N], share: f32, out: &mut [f32]) {
    for (g, value) in out.iter_mut().enumerate() {
        *value = lanes[g / 8].0[g % 8] * share;
    }
}

/// Keeps a_plate + a_medium at most 1 against the rounding of their sums (1e-6), so that a_walls is never negative.
fn close(plate: &mut [f32], medium: &mut [f32]) {
    for (p, m) in plate.iter_mut().zip(medium) {
        let sum = *p + *m;
        if sum > 1.0 {
            *p /= sum;
            *m /= sum;
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

#[expect(clippy::cast_precision_loss, reason = "path counts are far below 2^53")]
fn real_wide(n: u64) -> f64 {
    n as f64
}
