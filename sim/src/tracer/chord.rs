//! Closed forms along a ray through an analytic shape: where it is inside, and how deep a Gaussian is.
//!
//! Written from the point of closest approach, so that rays from far away keep their digits.

use super::lattice::clip_box;
use super::shape::{Piece, Shape};
use super::vector::{Vector, along, dot, sub};
use std::f64::consts::{FRAC_PI_2, SQRT_2};

/// Widths from its centre beyond which a Gaussian holds less than 1e-300 of its peak.
const GAUSSIAN_REACH: f64 = 40.0;

/// Limit of the search for a place inside a Gaussian; bisection alone needs 64.
const GAUSSIAN_STEPS_MAX: usize = 100;

/// The part of a ray inside a shape, none where it misses or touches.
pub(super) fn span(shape: &Shape, origin: Vector, direction: Vector, far: f64) -> Option<(f64, f64)> {
    match shape {
        Shape::Slab { thickness_m, .. } => {
            let half = 0.5 * thickness_m;
            let inf = f64::INFINITY;
            clip_box([-inf, -inf, -half], [inf, inf, half], origin, direction, far)
        }
        Shape::Cuboid { lower_m, upper_m, .. } => clip_box(*lower_m, *upper_m, origin, direction, far),
        Shape::Sphere { centre_m, radius_m, .. } => ball(sub(origin, *centre_m), direction, *radius_m, far),
        Shape::Cylinder { centre_m, axis, radius_m, .. } => {
            let offset = sub(origin, *centre_m);
            let across = along(direction, -dot(direction, *axis), *axis);
            let offset = along(offset, -dot(offset, *axis), *axis);
            let speed = dot(across, across).sqrt();
            if speed < 1e-100 {
                return (dot(offset, offset) < radius_m * radius_m && far > 0.0).then_some((0.0, far));
            }
            let (start, end) = ball(offset, across.map(|c| c / speed), *radius_m, far * speed)?;
            Some((start / speed, end / speed))
        }
        Shape::Gaussian { centre_m, width_m, .. } => {
            let closest = dot(sub(*centre_m, origin), direction);
            let (start, end) =
                ((closest - GAUSSIAN_REACH * width_m).max(0.0), closest + GAUSSIAN_REACH * width_m);
            (start < end.min(far)).then_some((start, end.min(far)))
        }
    }
}

/// The part of a ray inside a ball around the origin of coordinates, from the point of closest approach so that far
/// origins keep their digits.
fn ball(offset: Vector, direction: Vector, radius: f64, far: f64) -> Option<(f64, f64)> {
    let closest = -dot(offset, direction);
    let nearest = along(offset, closest, direction);
    let miss = dot(nearest, nearest).sqrt();
    let square = (radius - miss) * (radius + miss);
    if square <= 0.0 {
        return None;
    }
    let half = square.sqrt();
    let (start, end) = ((closest - half).max(0.0), (closest + half).min(far));
    (start < end).then_some((start, end))
}

/// Where along a ray the Gaussian is closest, and its extinction there.
fn gaussian_ray(centre: Vector, width: f64, extinction: f64, ray: (Vector, Vector)) -> (f64, f64) {
    let closest = dot(sub(centre, ray.0), ray.1);
    let nearest = sub(along(ray.0, closest, ray.1), centre);
    (closest, extinction * (-0.5 * dot(nearest, nearest) / (width * width)).exp())
}

pub(super) fn gaussian_depth(
    centre: Vector,
    width: f64,
    extinction: f64,
    ray: (Vector, Vector),
    span: (f64, f64),
) -> f64 {
    let (closest, peak) = gaussian_ray(centre, width, extinction, ray);
    let (a, b) = ((span.0 - closest) / (width * SQRT_2), (span.1 - closest) / (width * SQRT_2));
    // On one side of the centre the difference of two erf cancels; that of two erfc does not.
    let difference = if a > 0.0 {
        libm::erfc(a) - libm::erfc(b)
    } else if b < 0.0 {
        libm::erfc(-b) - libm::erfc(-a)
    } else {
        libm::erf(b) - libm::erf(a)
    };
    peak * width * FRAC_PI_2.sqrt() * difference
}

/// Safeguarded Newton search for the place where the depth from the piece's start is `depth`.
pub(super) fn gaussian_place(
    centre: Vector,
    width: f64,
    extinction: f64,
    ray: (Vector, Vector),
    piece: &Piece,
    depth: f64,
) -> f64 {
    let (closest, peak) = gaussian_ray(centre, width, extinction, ray);
    let (mut low, mut high) = (piece.start, piece.end);
    let mut t = closest.clamp(low, high);
    for _ in 0..GAUSSIAN_STEPS_MAX {
        let excess = gaussian_depth(centre, width, extinction, ray, (piece.start, t)) - depth;
        if excess > 0.0 {
            high = t;
        } else {
            low = t;
        }
        let s = (t - closest) / width;
        let newton = t - excess / (peak * (-0.5 * s * s).exp());
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - t).abs() <= 1e-14 * width {
            break;
        }
        t = next;
    }
    t
}
