//! What the sights of a scene collect: single rays one by one, images by the operator of their medium.

use super::{Args, RAY_PATHS_MAX, count};
use crate::commands::CommandError;
use ditd_sim::scene::file::{MediumSource, Scene};
use ditd_sim::scene::lights::{EndShares, Mirrored, Share};
use ditd_sim::scene::mirror::Mirror;
use ditd_sim::tracer::camera::Camera;
use ditd_sim::tracer::chamber::{ENDS, Walls};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::mean_rays::{MeanRay, Setting, mean_rays};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::reference::render_reference;
use ditd_sim::tracer::shape::Body;
use ditd_sim::tracer::uneven::{self, UnevenPlate};

/// What sights collect: per sight one share per spectral group, and the walls one by one where they are told apart.
pub(super) struct Collected {
    pub(super) shares: Vec<Vec<Share>>,
    pub(super) ends: Vec<EndShares>,
    pub(super) stats: Vec<(String, f64)>,
}

impl Collected {
    pub(super) fn of(&self, sight: usize) -> (&[Share], Option<&EndShares>) {
        (&self.shares[sight], self.ends.get(sight))
    }
}

/// Shares of all pixels of a camera, with any plate.
pub(super) fn rendered(
    scene: &Scene,
    camera: &Camera,
    walls: Walls,
    plate: Option<&PlateShape>,
    target: f64,
    args: &Args,
) -> Result<Collected, CommandError> {
    if matches!(&scene.medium, Some(MediumSource::Shape(..))) {
        pixel_by_pixel(scene, camera, walls, plate, target, args.seed())
    } else {
        operator(scene, camera, walls, plate, target, args)
    }
}

/// The same with what the far window mirrors, where it mirrors the chamber.
pub(super) fn trace_mirrored(
    scene: &Scene,
    walls: Walls,
    rays: &[([f64; 3], [f64; 3])],
    target_error: f64,
    seed: u64,
) -> Result<Collected, CommandError> {
    let plate = scene.plate.as_ref().map(|p| &p.shape);
    let mut collected = trace(scene, walls, rays, plate, target_error, seed)?;
    let Some(mirror) = Mirror::of(scene) else { return Ok(collected) };
    // Rays that pass the window's plane by see no plate behind it either.
    let back: Vec<_> = rays.iter().map(|&(o, d)| mirror.ray(o, d).unwrap_or((o, d))).collect();
    let opening = mirror.opening(rays, 0.0);
    let target_error = mirror.target(target_error);
    let mirrored = trace(scene, walls.together(), &back, opening.as_ref(), target_error, seed)?;
    for (shares, mirrored) in collected.shares.iter_mut().zip(&mirrored.shares) {
        mirror_in(shares, mirrored);
    }
    Ok(collected)
}

/// Traces rays one by one.
fn trace(
    scene: &Scene,
    walls: Walls,
    rays: &[([f64; 3], [f64; 3])],
    shape: Option<&PlateShape>,
    target_error: f64,
    seed: u64,
) -> Result<Collected, CommandError> {
    let usage = |e: ditd_sim::tracer::error::TracerError| CommandError::usage(format!("render: {e}"));
    let plate = shape.map(Plate::new).transpose().map_err(usage)?;
    let options = RayOptions { target_error, seed, paths_max: RAY_PATHS_MAX, walls, ..RayOptions::default() };
    let empty = nothing();
    let bodies = match &scene.medium {
        Some(MediumSource::Shape(shape, _)) => vec![Body::shape(shape)],
        Some(MediumSource::Grid(grid, _)) => vec![Body::grid(grid, 0)],
        Some(MediumSource::Spectral(grid, _)) => (0..grid.groups).map(|g| Body::grid(grid, g)).collect(),
        Some(MediumSource::Cfd(_) | MediumSource::Parametric(_)) | None => vec![Body::grid(&empty, 0)],
    };
    let own = scene.plate.as_ref().filter(|p| Some(&p.shape) == shape);
    let uneven = if own.is_some() { uneven_plate(scene)? } else { None };
    let mut shares = vec![Vec::new(); rays.len()];
    let mut ends = vec![EndShares::default(); if walls.apart().is_some() { rays.len() } else { 0 }];
    let mut paths = 0;
    let groups = bodies.len();
    for body in bodies {
        let answers = render_rays(&body.map_err(usage)?, rays, plate.as_ref(), &options).map_err(usage)?;
        for ((shares, answer), &(origin, direction)) in shares.iter_mut().zip(&answers).zip(rays) {
            paths += answer.paths;
            let mut share = share(answer);
            if let Some(uneven) = &uneven {
                let met = uneven.seen(origin, direction).is_some();
                let straight = if met { answer.direct_transmittance } else { 0.0 };
                share.excess = uneven.of_ray(origin, direction, answer.plate, straight);
            }
            shares.push(share);
        }
        for (ends, answer) in ends.iter_mut().zip(&answers) {
            add_ends(ends, answer, groups);
        }
    }
    let stats = vec![("pixels".to_owned(), count(rays.len())), ("paths".to_owned(), paths as f64)];
    Ok(Collected { shares, ends, stats })
}

/// Adds one spectral group of a ray; its standard errors become the rms over all groups.
#[expect(clippy::cast_precision_loss, reason = "groups are few")]
fn add_ends(ends: &mut EndShares, answer: &RayAnswer, groups: usize) {
    ends.shares.push(std::array::from_fn(|end| answer.ends[end]));
    for (sum, se) in ends.se.iter_mut().zip(&answer.se_ends) {
        *sum = sum.hypot(se / (groups as f64).sqrt());
    }
}

fn share(answer: &RayAnswer) -> Share {
    Share {
        plate: answer.plate,
        walls: answer.walls,
        medium: answer.medium[0],
        emission: answer.medium.get(1).copied().unwrap_or(0.0),
        se: [answer.se_plate, answer.se_walls, answer.se_medium[0]],
        ..Share::default()
    }
}

/// Puts what the far window mirrors into the shares of a sight.
pub(super) fn mirror_in(shares: &mut [Share], mirrored: &[Share]) {
    for (share, there) in shares.iter_mut().zip(mirrored) {
        share.mirrored = Some(Mirrored {
            opening: there.plate,
            medium: there.medium,
            emission: there.emission,
            se: there.se[0].hypot(there.se[2]),
        });
    }
}

/// The plate of a scene with the deviation of its temperature, if it is uneven.
fn uneven_plate(scene: &Scene) -> Result<Option<UnevenPlate>, CommandError> {
    let plate = scene.plate.as_ref().and_then(|p| p.deviation.as_ref().map(|d| (&p.shape, d)));
    plate
        .map(|(shape, deviation)| UnevenPlate::new(shape, deviation))
        .transpose()
        .map_err(|e| CommandError::usage(format!("render: {e}")))
}

/// A medium of nothing, for scenes without one.
fn nothing() -> GridMedium {
    GridMedium {
        lower_m: [0.0; 3],
        upper_m: [1.0; 3],
        cells: [1; 3],
        groups: 1,
        channels: 2,
        index: vec![EMPTY],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: vec![ditd_sim::light::phase::PhaseFunction::Isotropic],
    }
}

/// The image of a gridded medium: by the cache, or with `--reference` pixel by pixel.
fn operator(
    scene: &Scene,
    camera: &Camera,
    walls: Walls,
    plate: Option<&PlateShape>,
    target_error: f64,
    args: &Args,
) -> Result<Collected, CommandError> {
    let empty = nothing();
    let medium = gridded(scene).unwrap_or(&empty);
    let options = render_options(scene, walls, target_error, args);
    let operator = if args.reference {
        render_reference(medium, camera, plate, &options, None, &|_| {})
    } else {
        render_image(medium, camera, plate, &options, &|_| {})
    };
    let operator = operator.map_err(|e| CommandError::usage(format!("render: {e}")))?;
    let mut collected = collected(&operator, walls);
    let groups = operator.groups;
    // Only the scene's own plate is uneven, not the opening that stands for it in a mirror.
    let own = scene.plate.as_ref().filter(|p| Some(&p.shape) == plate);
    if let Some(uneven) = own.and(uneven_plate(scene)?) {
        let excess = uneven::excess(medium, camera, &uneven, &options, &operator)
            .map_err(|e| CommandError::usage(format!("render: {e}")))?;
        for (shares, seen) in collected.shares.iter_mut().zip(&excess.seen) {
            shares.iter_mut().for_each(|share| share.excess = seen.map(f64::from));
        }
        for (&pixel, found) in operator.pixels.iter().zip(excess.active.chunks_exact(groups)) {
            for (share, found) in collected.shares[pixel as usize].iter_mut().zip(found) {
                share.excess = found.map(f64::from);
            }
        }
        collected.stats.push(("plate_excess_error_k".to_owned(), excess.error_k));
    }
    Ok(collected)
}

/// The medium of a scene if it is on a grid.
pub(super) fn gridded(scene: &Scene) -> Option<&GridMedium> {
    match &scene.medium {
        Some(MediumSource::Grid(grid, _) | MediumSource::Spectral(grid, _)) => Some(grid.as_ref()),
        _ => None,
    }
}

pub(super) fn render_options(scene: &Scene, walls: Walls, target_error: f64, args: &Args) -> RenderOptions {
    let motion_m = scene.exposure.map_or([0.0; 3], |e| e.motion_m());
    RenderOptions { target_error, seed: args.seed(), walls, motion_m, ..RenderOptions::default() }
}

/// The shares of all pixels of an operator.
pub(super) fn collected(operator: &Operator, walls: Walls) -> Collected {
    let groups = operator.groups;
    let mut shares: Vec<Vec<Share>> = operator
        .plate_seen
        .iter()
        .map(|&seen| {
            let plate = f64::from(seen);
            vec![Share { plate, walls: 1.0 - plate, ..Share::default() }; groups]
        })
        .collect();
    for (i, &pixel) in operator.pixels.iter().enumerate() {
        // Errors are known as rms over the groups. Those of plate and medium are not jointly known: the bound for
        // independent ones.
        let [se_plate, se_medium] =
            [&operator.error_plate, &operator.error_medium].map(|errors| f64::from(errors[i]));
        for (g, share) in shares[pixel as usize].iter_mut().enumerate() {
            let emission = |c: usize| f64::from(operator.emission[(i * operator.channels + c) * groups + g]);
            let plate = f64::from(operator.a_plate[i * groups + g]);
            *share = Share {
                plate,
                walls: 1.0 - plate - emission(0),
                medium: emission(0),
                emission: emission(1),
                se: [se_plate, se_plate.hypot(se_medium), se_medium],
                ..Share::default()
            };
        }
    }
    let ends = if walls.apart().is_some() { ends_of(operator) } else { Vec::new() };
    Collected { shares, ends, stats: operator.stats.clone() }
}

/// The walls one by one, of every pixel.
fn ends_of(operator: &Operator) -> Vec<EndShares> {
    let groups = operator.groups;
    let mut ends: Vec<EndShares> = operator
        .ends_seen
        .chunks_exact(ENDS)
        .map(|seen| EndShares {
            shares: vec![std::array::from_fn(|end| f64::from(seen[end])); groups],
            se: [0.0; ENDS],
        })
        .collect();
    for (i, &pixel) in operator.pixels.iter().enumerate() {
        let shares = &operator.a_ends[i * ENDS * groups..(i + 1) * ENDS * groups];
        ends[pixel as usize] = EndShares {
            shares: (0..groups)
                .map(|g| std::array::from_fn(|end| f64::from(shares[end * groups + g])))
                .collect(),
            se: [f64::from(operator.error_ends[i]); ENDS],
        };
    }
    ends
}

/// Analytic shapes: every pixel as a ray of its own through its centre, or with a lens or motion as the mean of rays.
#[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
fn pixel_by_pixel(
    scene: &Scene,
    camera: &Camera,
    walls: Walls,
    plate: Option<&PlateShape>,
    target: f64,
    seed: u64,
) -> Result<Collected, CommandError> {
    let usage = |e: ditd_sim::tracer::error::TracerError| CommandError::usage(format!("render: {e}"));
    let pixels = (camera.rows * camera.columns) as f64;
    let motion_m = scene.exposure.map_or([0.0; 3], |e| e.motion_m());
    let own = scene.plate.as_ref().filter(|p| Some(&p.shape) == plate);
    let uneven = if own.is_some() { uneven_plate(scene)? } else { None };
    let setting = Setting { camera, plate, uneven: uneven.as_ref(), motion_m };
    if let (true, Some(MediumSource::Shape(shape, _))) = (setting.spreads(), &scene.medium) {
        if walls.chamber().is_some() {
            return Err(CommandError::usage(
                "render: [medium] is a shape, seen through a lens or in motion, in a [chamber]; give it as a grid, or leave \
                 out one of them",
            ));
        }
        let body = Body::shape(shape).map_err(usage)?;
        let options =
            RayOptions { target_error: target, seed, paths_max: RAY_PATHS_MAX, ..RayOptions::default() };
        let means = mean_rays(&body, &setting, &options).map_err(usage)?;
        let sum = |f: fn(&MeanRay) -> f64| means.iter().map(f).sum::<f64>();
        let stats = vec![
            ("pixels".to_owned(), pixels),
            ("sights".to_owned(), sum(|m| f64::from(m.rays))),
            ("paths".to_owned(), sum(|m| m.paths as f64)),
        ];
        let shares = means
            .iter()
            .map(|m| {
                let walls = (1.0 - m.plate - m.medium).max(0.0);
                let (plate, medium, se, excess) = (m.plate, m.medium, m.se, m.excess);
                vec![Share { plate, walls, medium, se, excess, ..Share::default() }]
            })
            .collect();
        return Ok(Collected { shares, ends: Vec::new(), stats });
    }
    let sights = camera.sights().map_err(usage)?;
    let rays: Vec<_> = (0..camera.rows * camera.columns)
        .map(|i| sights.ray((i / camera.columns) as f64 + 0.5, (i % camera.columns) as f64 + 0.5))
        .collect();
    trace(scene, walls, &rays, plate, target, seed)
}
