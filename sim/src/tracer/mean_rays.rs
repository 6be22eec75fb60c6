//! The pixels of analytic shapes whose sights spread over a lens or an exposure: each the mean of single rays.
//!
//! The rays are those of `spread`, in two halves of opposite pairs; a pixel gets more until half the difference of the
//! halves, pooled over its neighbours, is below the target. The medium stays where it is: camera and plate move the
//! other way.

use super::camera::Camera;
use super::error::TracerError;
use super::pixels::Frame;
use super::plate::{Plate, PlateShape};
use super::rays::{RayOptions, render_rays};
use super::shape::Body;
use super::shares::ROWS;
use super::sobol::{self, Sequence};
use super::spectrum::narrow;
use super::spread::{NAMES, place, pool};
use super::uneven::UnevenPlate;
use super::vector::sub;

/// Pairs of rays in each half of a pixel's, at first and at most.
const PAIRS_MIN: u32 = 2;
const PAIRS_MAX: u32 = 64;

/// Share of the target that the mean over the rays may err; the rest is for the noise of each.
const PIXEL_SHARE: f64 = 0.5;

/// Rays traced at once.
const BATCH: usize = 1 << 16;

/// A pixel's mean.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MeanRay {
    /// Share of the plate.
    pub plate: f64,
    /// Share of the medium.
    pub medium: f64,
    /// Standard errors of plate, walls and medium, the noise of single rays and that of their mean.
    pub se: [f64; 3],
    /// The plate's share times the deviation of its temperature, and times its square.
    pub excess: [f64; 2],
    /// Rays traced.
    pub rays: u32,
    /// Paths of all of them.
    pub paths: u64,
}

/// What a pixel's rays have in common.
pub struct Setting<'a> {
    /// The camera, with its lens.
    pub camera: &'a Camera,
    /// The plate.
    pub plate: Option<&'a PlateShape>,
    /// The same plate with its deviation, if it is uneven.
    pub uneven: Option<&'a UnevenPlate>,
    /// How far the medium moves during the exposure, in metres.
    pub motion_m: [f64; 3],
}

impl Setting<'_> {
    /// Whether pixels are means of rays: the camera has a lens, or the medium moves.
    pub fn spreads(&self) -> bool {
        self.camera.lens.is_some() || self.motion_m.iter().any(|m| *m != 0.0)
    }
}

/// Sums of a pixel: the halves' plate and medium; the rays' squared errors; the excess.
#[derive(Clone, Copy, Default)]
struct Sums {
    halves: [[f64; ROWS]; 2],
    squares: [f64; 3],
    excess: [f64; 2],
    rays: u32,
    paths: u64,
}

/// Renders all pixels of an image, row by row.
///
/// # Errors
///
/// [`TracerError::Geometry`] for a camera, plate, motion or target that makes no sense.
pub fn mean_rays(
    body: &Body<'_>,
    setting: &Setting<'_>,
    options: &RayOptions,
) -> Result<Vec<MeanRay>, TracerError> {
    let camera = setting.camera;
    let sights = camera.sights()?;
    let plate = setting.plate.map(Plate::new).transpose()?;
    if !setting.motion_m.iter().all(|c| c.is_finite()) {
        return Err(TracerError::Geometry {
            what: "the medium's motion during the exposure",
            condition: "finite",
        });
    }
    let frame = Frame { camera, sights: &sights, plate: plate.as_ref(), motion: setting.motion_m };
    let pixels: Vec<u32> = (0..u32::try_from(camera.rows * camera.columns).unwrap_or(u32::MAX)).collect();
    let mut sums = vec![Sums::default(); pixels.len()];
    let mut errors = vec![[0.0_f32; ROWS]; pixels.len()];
    let mut open: Vec<usize> = (0..pixels.len()).collect();
    let mut pairs = 0;
    while !open.is_empty() && pairs < PAIRS_MAX {
        let next = if pairs == 0 { PAIRS_MIN } else { 2 * pairs };
        // Their noise averages out over all rays of a pixel.
        let target_error = options.target_error * f64::from(4 * next).sqrt();
        for pair in pairs..next {
            for (half, name) in NAMES.iter().enumerate() {
                for opposite in [false, true] {
                    // All pixels look at one moment, at which the plate is in one place.
                    let moment = time(options.seed, *name, pair, opposite);
                    let back = setting.motion_m.map(|m| (0.5 - moment) * m);
                    let moved = plate.as_ref().map(|p| p.moved(back));
                    for (batch, chosen) in open.chunks(BATCH).enumerate() {
                        let subs: Vec<_> = chosen
                            .iter()
                            .map(|&i| {
                                let (row, column) = (i / camera.columns, i % camera.columns);
                                let sequence = Sequence::new(sobol::sequence(options.seed, pixels[i], *name));
                                let mut at = place(&sequence.from(pair).next(), opposite);
                                at[4] = moment;
                                frame.sub_sight(row, column, at)
                            })
                            .collect();
                        let rays: Vec<_> = subs.iter().map(|s| (sub(s.ray.0, s.moved), s.ray.1)).collect();
                        let number = (pair * 4) as u64 + 2 * half as u64 + u64::from(opposite);
                        let seed = options.seed ^ (number + 1) << 20 ^ (batch as u64) << 40;
                        let options = RayOptions { target_error, seed, ..options.clone() };
                        let answers = render_rays(body, &rays, moved.as_ref(), &options)?;
                        for ((&i, sub), answer) in chosen.iter().zip(&subs).zip(&answers) {
                            let sum = &mut sums[i];
                            sum.halves[half][0] += answer.plate;
                            sum.halves[half][1] += answer.medium[0];
                            let se = [answer.se_plate, answer.se_walls, answer.se_medium[0]];
                            (0..3).for_each(|k| sum.squares[k] += se[k] * se[k]);
                            if let Some(uneven) = setting.uneven {
                                let straight = if uneven.seen(sub.ray.0, sub.ray.1).is_some() {
                                    answer.direct_transmittance
                                } else {
                                    0.0
                                };
                                let more = uneven.of_ray(sub.ray.0, sub.ray.1, answer.plate, straight);
                                (0..2).for_each(|k| sum.excess[k] += more[k]);
                            }
                            sum.rays += 1;
                            sum.paths += answer.paths;
                        }
                    }
                }
            }
        }
        pairs = next;
        let per_half = 0.5 / f64::from(pairs);
        let squares: Vec<[f32; ROWS]> = sums
            .iter()
            .map(|s| {
                [0, 1].map(|k: usize| narrow((0.5 * per_half * (s.halves[0][k] - s.halves[1][k])).powi(2)))
            })
            .collect();
        let tolerance = narrow(PIXEL_SHARE * options.target_error);
        let size = [camera.rows, camera.columns];
        // Halves of closed pixels have fewer rays; they are read by those beside them only, as they were.
        let known: Vec<[f32; ROWS]> = (0..pixels.len())
            .map(|i| if sums[i].rays == 4 * pairs { squares[i] } else { errors[i].map(|e| e * e) })
            .collect();
        pool(size, &pixels, &known, &mut open, &mut errors, tolerance);
    }
    Ok(sums
        .iter()
        .zip(&errors)
        .map(|(s, e)| {
            let n = f64::from(s.rays.max(1));
            let [plate, medium] = [0, 1].map(|k: usize| (s.halves[0][k] + s.halves[1][k]) / n);
            let noise = s.squares.map(|q| q.sqrt() / n);
            let [p, m] = e.map(f64::from);
            let se = [noise[0].hypot(p), noise[1].hypot(p.hypot(m)), noise[2].hypot(m)];
            MeanRay { plate, medium, se, excess: s.excess.map(|x| x / n), rays: s.rays, paths: s.paths }
        })
        .collect())
}

/// The moment of a ray in its exposure, the same for all pixels.
fn time(seed: u64, name: u32, pair: u32, opposite: bool) -> f64 {
    let sequence = Sequence::new(sobol::sequence(seed, u32::MAX, name));
    let u = sequence.from(pair).next().get(0);
    if opposite { 1.0 - u } else { u }
}
