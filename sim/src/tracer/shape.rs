//! Media of exact analytic form, and the pieces into which any medium cuts a ray.
//!
//! All in f64. A piece has one extinction profile (constant or Gaussian) and one material.

use super::chord::{gaussian_depth, gaussian_place, span};
use super::error::TracerError;
use super::lattice::Lattice;
use super::medium::GridMedium;
use super::vector::{Vector, unit};
use crate::light::phase::PhaseFunction;

/// What stands for an infinite optical depth of a slab: light of an albedo below 1 − 1e-15 does not come back from there.
const DEPTH_OF_HALF_SPACE: f64 = 1e9;

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
    pub(super) kind: Kind<'a>,
    pub(super) phase: &'a PhaseFunction,
    /// Channels: 1 for shapes.
    pub(super) channels: usize,
}

#[derive(Debug, Clone)]
pub(super) enum Kind<'a> {
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
    /// [`TracerError`] for lengths that are not positive, places that are not finite, a negative extinction, or an albedo outside [0, 1].
    pub fn shape(medium: &'a ShapeMedium) -> Result<Self, TracerError> {
        let positive = |what, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(value)
            } else {
                Err(TracerError::Geometry { what, condition: "positive and finite" })
            }
        };
        let finite = |what, places: &[Vector]| {
            if places.iter().flatten().all(|c| c.is_finite()) {
                Ok(())
            } else {
                Err(TracerError::Geometry { what, condition: "finite" })
            }
        };
        let mut shape = medium.shape.clone();
        let extinction = match &mut shape {
            Shape::Slab { thickness_m, optical_depth } => {
                positive("the slab's thickness", *thickness_m)?;
                // Not `min`, which would take what is not a number for an infinite depth.
                let depth =
                    if *optical_depth > DEPTH_OF_HALF_SPACE { DEPTH_OF_HALF_SPACE } else { *optical_depth };
                depth / *thickness_m
            }
            Shape::Sphere { centre_m, radius_m, extinction } => {
                finite("the sphere's centre", &[*centre_m])?;
                positive("the sphere's radius", *radius_m)?;
                *extinction
            }
            Shape::Cylinder { centre_m, radius_m, extinction, axis } => {
                finite("the cylinder's centre", &[*centre_m])?;
                positive("the cylinder's radius", *radius_m)?;
                let condition = "a direction of finite length";
                *axis =
                    unit(*axis).ok_or(TracerError::Geometry { what: "the cylinder's axis", condition })?;
                *extinction
            }
            Shape::Gaussian { centre_m, width_m, extinction } => {
                finite("the gaussian's centre", &[*centre_m])?;
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
