//! Every pixel on its own, unbiased and slow: the judge of image mode.
//!
//! Backward Monte Carlo from random places of the pixel's area through the cells themselves: no cache, no merged cells, no
//! reconstruction. Standard errors come from independent scrambles of the random points.

use super::blocks::Blocks;
use super::camera::{Camera, PixelFilter};
use super::chamber::ENDS;
use super::ends;
use super::error::TracerError;
use super::fine::Fine;
use super::gather::{Field, Sight};
use super::image::{GROUPS_MAX, RenderOptions};
use super::medium::GridMedium;
use super::operator::Operator;
use super::paths::{MEDIUM, Memory, PLATE, World};
use super::pixels::{Frame, sub_sights};
use super::plate::{Plate, PlateShape};
use super::scatter::Scatter;
use super::sobol::{self, Sequence};
use super::spectrum::{One, Spectrum, Wide, narrow, vectorised};
use super::vector::along;
use rayon::prelude::*;

/// Independent scrambles per pixel.
const REPLICATES: usize = 8;

/// Points of each in the first round; each further round doubles them.
const FIRST_POINTS: u32 = 16;

/// Sub-sights per axis for the emission along the straight sight.
const DIRECT_SIGHTS: usize = 4;

/// Straight sights of pixels whose sights spread over an aperture or an exposure.
const SPREAD_SIGHTS: u32 = 256;

/// The coordinates that choose them: those of the pixel as ever, the others beyond what paths take.
const SPREAD_DIMENSIONS: [usize; 5] = [4, 5, 400_000, 400_001, 400_002];

/// Renders some pixels of an image, or all that meet the medium, each to the target error.
///
/// # Errors
///
/// As [`super::image::render_image`].
pub fn render_reference(
    medium: &GridMedium,
    camera: &Camera,
    plate: Option<&PlateShape>,
    options: &RenderOptions,
    chosen: Option<&[u32]>,
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
    match medium.groups {
        1 => Ok(render::<One>(medium, &frame, options, chosen, progress)),
        2..=16 => Ok(render::<[Wide; 1]>(medium, &frame, options, chosen, progress)),
        17..=64 => Ok(render::<[Wide; 4]>(medium, &frame, options, chosen, progress)),
        _ => Err(TracerError::Groups { groups: medium.groups, limit: GROUPS_MAX }),
    }
}

/// One pixel: plate, emission, direct emission and ends by groups; errors of plate, medium and the worst end; paths.
struct Answer {
    values: Vec<f32>,
    errors: [f32; 3],
    paths: u64,
    scatterings: u64,
    met: bool,
}

fn render<S: Spectrum>(
    medium: &GridMedium,
    frame: &Frame<'_>,
    options: &RenderOptions,
    chosen: Option<&[u32]>,
    progress: &(dyn Fn(f64) + Sync),
) -> Operator {
    let fine = Fine::<S>::new(medium, 1);
    let blocks = Blocks::cells(&fine);
    let scatter = Scatter::new(&medium.phase);
    let chamber = options.walls.apart();
    let world = World { blocks: &blocks, scatter: &scatter, plate: frame.plate, chamber };
    let candidates = frame.candidates(&fine.bricks, &fine.occupied);
    let wanted: Vec<u32> = match chosen {
        Some(list) => list.iter().copied().filter(|p| candidates.binary_search(p).is_ok()).collect(),
        None => candidates,
    };
    let done = std::sync::atomic::AtomicUsize::new(0);
    let answers: Vec<Answer> = wanted
        .par_iter()
        .map(|&pixel| {
            let answer = vectorised(
                #[inline(always)]
                || one(&fine, &world, frame, options, pixel),
            );
            let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(n as f64 / wanted.len() as f64);
            answer
        })
        .collect();
    let (groups, channels) = (medium.groups, medium.channels);
    let mut operator = Operator {
        rows: frame.camera.rows,
        columns: frame.camera.columns,
        groups,
        channels,
        plate_seen: frame.plate_seen(),
        ..Operator::default()
    };
    if let Some(chamber) = chamber {
        operator.ends_seen = frame.ends_seen(chamber, &operator.plate_seen);
    }
    let (mut paths, mut scatterings) = (0, 0);
    for (&pixel, answer) in wanted.iter().zip(&answers).filter(|(_, answer)| answer.met) {
        operator.pixels.push(pixel);
        operator.a_plate.extend(&answer.values[..groups]);
        operator.emission.extend(&answer.values[groups..groups * (1 + channels)]);
        operator.direct.extend(&answer.values[groups * (1 + channels)..groups * (1 + 2 * channels)]);
        operator.a_ends.extend(&answer.values[groups * (1 + 2 * channels)..]);
        operator.error_plate.push(answer.errors[0]);
        operator.error_medium.push(answer.errors[1]);
        operator.error_ends.extend(chamber.map(|_| answer.errors[2]));
        paths += answer.paths;
        scatterings += answer.scatterings;
    }
    operator.stats = vec![
        ("pixels".to_owned(), operator.plate_seen.len() as f64),
        ("pixels_active".to_owned(), operator.pixels.len() as f64),
        ("paths".to_owned(), paths as f64),
        ("scatterings".to_owned(), scatterings as f64),
    ];
    operator
}

#[inline(always)]
fn one<S: Spectrum>(
    fine: &Fine<S>,
    world: &World<'_, S>,
    frame: &Frame<'_>,
    options: &RenderOptions,
    pixel: u32,
) -> Answer {
    let (groups, channels) = (fine.groups, fine.channels);
    let (row, column) = (pixel as usize / frame.camera.columns, pixel as usize % frame.camera.columns);
    let centre = frame.camera.pixel_filter == PixelFilter::Centre;
    let field = Field { fine, plate: frame.plate, chamber: world.chamber, light: None };
    let mut sight = Sight::<S>::new(channels, world.chamber.is_some());
    if frame.spreads() {
        let sequence = Sequence::new(sobol::sequence(options.seed, pixel, u32::MAX));
        let mut run = sequence.from(0);
        for _ in 0..SPREAD_SIGHTS {
            let at = run.next();
            let sub = frame.sub_sight(row, column, [0, 1, 2, 3, 4].map(|d: usize| at.get(d)));
            sight.add_moved::<false>(&field, sub.ray, sub.moved, 1.0);
        }
    } else {
        for (r, c) in sub_sights(row, column, if centre { 1 } else { DIRECT_SIGHTS }) {
            sight.add::<false>(&field, frame.sights.ray(r, c), 1.0);
        }
    }
    let mut memory = Memory::new();
    let rows_count = world.rows();
    let mut replicates = vec![vec![S::ZERO; rows_count]; REPLICATES];
    // f64 sums of the rows of each replicate: millions of paths would not fit into f32.
    let width = rows_count * groups;
    let mut sums = vec![vec![0.0_f64; width]; REPLICATES];
    let mut points = 0;
    let mut errors;
    loop {
        let next = if points == 0 { FIRST_POINTS } else { points * 2 };
        for (r, (rows, sums)) in (0..).zip(replicates.iter_mut().zip(&mut sums)) {
            let sequence = Sequence::new(sobol::sequence(options.seed, pixel, r));
            let mut run = sequence.from(points);
            for _ in points..next {
                let at = run.next();
                rows.iter_mut().for_each(|row| *row = S::ZERO);
                if frame.spreads() {
                    let places = SPREAD_DIMENSIONS.map(|d| at.get(d));
                    let sub = frame.sub_sight(row, column, places);
                    // The medium stays where it is: everything else moves the other way.
                    let back = sub.moved.map(|c| -c);
                    let plate = world.plate.map(|p| p.moved(back));
                    let world = World { plate: plate.as_ref(), ..*world };
                    let ((origin, direction), one) = (sub.ray, S::splat(1.0));
                    world.follow(&at, (along(origin, 1.0, back), direction), one, None, rows, &mut memory);
                } else {
                    let jitter = if centre { [0.5; 2] } else { [at.get(4), at.get(5)] };
                    let (origin, direction) =
                        frame.sights.ray(row as f64 + jitter[0], column as f64 + jitter[1]);
                    world.follow(&at, (origin, direction), S::splat(1.0), None, rows, &mut memory);
                }
                for (k, row) in rows.iter().enumerate() {
                    for g in 0..groups {
                        sums[k * groups + g] += f64::from(row.get(g));
                    }
                }
            }
        }
        points = next;
        errors = [0.0; 3];
        let ends = (world.first_end()..rows_count).map(|row| (2, row));
        for (kind, row) in [(0, PLATE), (1, MEDIUM)].into_iter().chain(ends) {
            let mut square = 0.0;
            for g in 0..groups {
                let n = REPLICATES as f64;
                let mean = sums.iter().map(|s| s[row * groups + g]).sum::<f64>() / n;
                square +=
                    sums.iter().map(|s| (s[row * groups + g] - mean).powi(2)).sum::<f64>() / (n * (n - 1.0));
            }
            let error: f64 = (square / groups as f64).sqrt() / f64::from(points);
            errors[kind] = error.max(errors[kind]);
        }
        let paths = u64::from(points) * REPLICATES as u64;
        if errors.iter().all(|e| *e <= options.target_error) || paths * 2 > options.paths_max {
            break;
        }
    }
    let scale = 1.0 / (f64::from(points) * REPLICATES as f64);
    let total = |k: usize, g: usize| scale * sums.iter().map(|s| s[k * groups + g]).sum::<f64>();
    let mut values = Vec::with_capacity(groups * (1 + 2 * channels + ENDS));
    values.extend((0..groups).map(|g| narrow(total(PLATE, g))));
    for c in 0..channels {
        values.extend((0..groups).map(|g| narrow(total(MEDIUM + c, g))));
    }
    values.extend((0..groups).map(|g| sight.direct.get(g) / sight.weight));
    for [direct, _] in &sight.extra {
        values.extend((0..groups).map(|g| direct.get(g) / sight.weight));
    }
    if world.chamber.is_some() {
        let mut shares: Vec<f32> = (world.first_end()..rows_count)
            .flat_map(|k| (0..groups).map(move |g| (k, g)))
            .map(|(k, g)| narrow(total(k, g)))
            .collect();
        ends::close(&mut shares, &values[..groups], &values[groups..2 * groups]);
        values.extend(shares);
    }
    Answer {
        values,
        errors: errors.map(narrow),
        paths: u64::from(points) * REPLICATES as u64,
        scatterings: memory.scatterings,
        met: sight.met || sums.iter().any(|s| s[MEDIUM * groups] > 0.0),
    }
}
