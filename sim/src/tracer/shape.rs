//! Media of exact analytic form, and the pieces into which any medium cuts a ray.
//!
//! All in f64. A piece has one extinction profile (constant or Gaussian) and one material.

use super::error::TracerError;
use super::lattice::{Lattice, clip_box};
use super::medium::GridMedium;
use super::vector::{Vector, along, dot, sub, unit};
use crate::light::phase::PhaseFunction;
use std::f64::consts::{FRAC_PI_2, SQRT_2};

/// What stands for an infinite optical depth of a slab: light of an albedo below 1 − 1e-15 does not come back from there.
const DEPTH_OF_HALF_SPACE: f64 = 1e9;

/// Widths from its centre beyond which a Gaussian holds less than 1e-300 of its peak.
const GAUSSIAN_REACH: f64 = 40.0;

/// Limit of the search for a place inside a Gaussian; bisection alone needs 64.
const GAUSSIAN_STEPS_MAX: usize = 100;

/// The form of a uniform or Gaussian medium; lengths in metres.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Between two planes z = ±thickness/2, infinite sideways; the extinction follows from the optical depth.
    Slab {
        /// Distance of the planes.
        thickness_m: f64,
        /// Extinction optical depth along z; infinite for a half space.
        optical_depth: f64,
    },
    /// A sphere.
    Sphere {
        /// Centre.
        centre_m: Vector,
        /// Radius.
        radius_m: f64,
        /// Extinction in 1/m.
        extinction: f64,
    },
    /// A cylinder, infinite along its axis.
    Cylinder {
        /// A point on the axis.
        centre_m: Vector,
        /// Direction of the axis.
        axis: Vector,
        /// Radius.
        radius_m: f64,
        /// Extinction in 1/m.
        extinction: f64,
    },
    /// extinction · exp(−r²/(2 w²)), unbounded.
    Gaussian {
        /// Centre.
        centre_m: Vector,
        /// The length w.
        width_m: f64,
        /// Extinction at the centre in 1/m.
        extinction: f64,
    },
    /// A box along the axes.
    Cuboid {
        /// Lower corner.
        lower_m: Vector,
        /// Upper corner.
        upper_m: Vector,
        /// Extinction in 1/m.
        extinction: f64,
    },
}

/// A shape filled with one material.
#[derive(Debug, Clone)]
pub struct ShapeMedium {
    /// Its form and extinction.
    pub shape: Shape,
    /// Scattering over extinction, in [0, 1].
    pub albedo: f64,
    /// How it scatters.
    pub phase: PhaseFunction,
}

/// A medium for single rays: an analytic shape, or one spectral group of a grid.
#[derive(Debug, Clone)]
pub struct Body<'a> {
    kind: Kind<'a>,
    pub(super) phase: &'a PhaseFunction,
    /// Channels: 1 for shapes.
    pub(super) channels: usize,
}

#[derive(Debug, Clone)]
enum Kind<'a> {
    Shape { shape: Shape, extinction: f64, albedo: f64 },
    Grid { lattice: Lattice, medium: &'a GridMedium, group: usize },
}

/// A part of a ray inside the medium.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) start: f64,
    pub(super) end: f64,
    /// Optical depth, possibly infinite.
    pub(super) depth: f64,
    /// Scattering over extinction.
    pub(super) albedo: f64,
    /// Ordinal of a grid's cell, 0 for shapes.
    pub(super) cell: u32,
}

impl<'a> Body<'a> {
    /// A shape, checked.
    ///
    /// # Errors
    ///
    /// [`TracerError`] for lengths that are not positive, a negative extinction, or an albedo outside [0, 1].
    pub fn shape(medium: &'a ShapeMedium) -> Result<Self, TracerError> {
        let positive = |what, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(value)
            } else {
                Err(TracerError::Geometry { what, condition: "positive and finite" })
            }
        };
        let mut shape = medium.shape.clone();
        let extinction = match &mut shape {
            Shape::Slab { thickness_m, optical_depth } => {
                positive("the slab's thickness", *thickness_m)?;
                optical_depth.min(DEPTH_OF_HALF_SPACE) / *thickness_m
            }
            Shape::Sphere { radius_m, extinction, .. } => {
                positive("the sphere's radius", *radius_m)?;
                *extinction
            }
            Shape::Cylinder { radius_m, extinction, axis, .. } => {
                positive("the cylinder's radius", *radius_m)?;
                let condition = "a direction of finite length";
                *axis =
                    unit(*axis).ok_or(TracerError::Geometry { what: "the cylinder's axis", condition })?;
                *extinction
            }
            Shape::Gaussian { width_m, extinction, .. } => {
                positive("the gaussian's width", *width_m)?;
                *extinction
            }
            Shape::Cuboid { lower_m, upper_m, extinction } => {
                for a in 0..3 {
                    positive("the box's size along every axis", upper_m[a] - lower_m[a])?;
                }
                *extinction
            }
        };
        let wrong =
            |what, value, condition| Err(TracerError::Coefficient { what, entry: 0, value, condition });
        if !(extinction >= 0.0 && extinction.is_finite()) {
            return wrong("extinction", extinction, "finite and not negative");
        }
        if !(0.0..=1.0).contains(&medium.albedo) {
            return wrong("albedo", medium.albedo, "between 0 and 1");
        }
        let kind = Kind::Shape { shape, extinction, albedo: medium.albedo };
        Ok(Self { kind, phase: &medium.phase, channels: 1 })
    }

    /// One spectral group of a grid, checked.
    ///
    /// # Errors
    ///
    /// [`TracerError`] as [`GridMedium::check`] says, or for a group that does not exist.
    pub fn grid(medium: &'a GridMedium, group: usize) -> Result<Self, TracerError> {
        medium.check()?;
        let Some(phase) = medium.phase.get(group) else {
            return Err(TracerError::Geometry { what: "the group", condition: "one of the medium's groups" });
        };
        let lattice = Lattice::new(medium.lower_m, medium.upper_m, medium.cells, medium.index.clone());
        Ok(Self { kind: Kind::Grid { lattice, medium, group }, phase, channels: medium.channels })
    }

    /// Whether nothing in it absorbs: then it emits nothing either.
    pub(super) fn is_conservative(&self) -> bool {
        match &self.kind {
            Kind::Shape { albedo, .. } => *albedo >= 1.0,
            Kind::Grid { medium, .. } => medium.emission.iter().all(|&e| e <= 0.0),
        }
    }

    /// Source of a channel in a piece's material: emission over absorption.
    #[inline]
    pub(super) fn emission_over_extinction(&self, piece: &Piece, channel: usize) -> f64 {
        match &self.kind {
            Kind::Shape { albedo, .. } => 1.0 - albedo,
            Kind::Grid { medium, group, .. } => {
                let cell = piece.cell as usize;
                let k = medium.k_ext[cell * medium.groups + group];
                let emission = medium.emission[(cell * medium.channels + channel) * medium.groups + group];
                if k > 0.0 { emission / k } else { 0.0 }
            }
        }
    }

    /// Cuts the ray from 0 to `far` (in units of the unit vector `direction`) into pieces, in order.
    pub(super) fn pieces(&self, origin: Vector, direction: Vector, far: f64, out: &mut Vec<Piece>) {
        out.clear();
        match &self.kind {
            Kind::Grid { lattice, medium, group } => {
                lattice.walk(origin, direction, far, |cell, start, end| {
                    let entry = cell as usize * medium.groups + group;
                    let (k, sca) = (medium.k_ext[entry], medium.k_sca[entry]);
                    if k > 0.0 {
                        out.push(Piece {
                            start,
                            end,
                            depth: k * (end - start),
                            albedo: (sca / k).min(1.0),
                            cell,
                        });
                    }
                    true
                })
            }
            Kind::Shape { shape, extinction, albedo } => {
                let Some((start, end)) = span(shape, origin, direction, far) else { return };
                let depth = if let Shape::Gaussian { centre_m, width_m, .. } = shape {
                    gaussian_depth(*centre_m, *width_m, *extinction, (origin, direction), (start, end))
                } else if *extinction > 0.0 {
                    extinction * (end - start)
                } else {
                    0.0
                };
                if depth > 0.0 {
                    out.push(Piece { start, end, depth, albedo: *albedo, cell: 0 });
                }
            }
        }
    }

    /// The distance at which the optical depth from the piece's start is `depth`.
    pub(super) fn place(&self, piece: &Piece, depth: f64, origin: Vector, direction: Vector) -> f64 {
        match &self.kind {
            Kind::Shape { shape: Shape::Gaussian { centre_m, width_m, .. }, extinction, .. } => {
                gaussian_place(*centre_m, *width_m, *extinction, (origin, direction), piece, depth)
            }
            Kind::Shape { extinction, .. } => (piece.start + depth / extinction).min(piece.end),
            Kind::Grid { medium, group, .. } => {
                let k = medium.k_ext[piece.cell as usize * medium.groups + group];
                (piece.start + depth / k).min(piece.end)
            }
        }
    }

    /// Extinction optical depth along a ray; `direction` need not be a unit vector.
    pub fn optical_depth(&self, origin: Vector, direction: Vector) -> f64 {
        let Some(direction) = unit(direction) else { return f64::NAN };
        let mut pieces = Vec::new();
        self.pieces(origin, direction, f64::INFINITY, &mut pieces);
        pieces.iter().map(|p| p.depth).sum()
    }
}

/// The part of a ray inside a shape, none where it misses or touches.
fn span(shape: &Shape, origin: Vector, direction: Vector, far: f64) -> Option<(f64, f64)> {
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

fn gaussian_depth(
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
fn gaussian_place(
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
