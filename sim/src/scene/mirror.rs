//! What a far window mirrors: the sights that it sends back through the chamber.
//!
//! A sight that is mirrored passes the medium again and leaves through the near window, or ends at the walls beside it. In
//! the mirror the camera stands behind the far window, with left and right exchanged: the mirrored sights are an image of
//! their own, rendered like any other with the near window's opening in place of the plate. Multiplied by the window's
//! reflectance, it needs no more accuracy than the target divided by that. Knows no light.

use super::file::{Scene, WindowSource};
use crate::tracer::camera::Camera;
use crate::tracer::lens::Aperture;
use crate::tracer::plate::PlateShape;

type Vector = [f64; 3];

/// A window that covers all sights is drawn so much larger than they need.
const MARGIN: f64 = 1.01;

/// What is asked of the mirrored image at least.
const TARGET_MAX: f64 = 0.05;

/// The plane of a far window that mirrors, and the opening of the near one.
#[derive(Debug, Clone)]
pub struct Mirror {
    place: Vector,
    normal: Vector,
    opening: Option<Opening>,
    reflectance: f64,
}

/// The near window: its middle, its normal into the chamber, its diameter if given.
#[derive(Debug, Clone)]
struct Opening {
    centre: Vector,
    facing: Vector,
    diameter_m: Option<f64>,
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn along(a: Vector, s: f64, b: Vector) -> Vector {
    [0, 1, 2].map(|k| a[k] + s * b[k])
}

fn unit(a: Vector) -> Vector {
    let length = dot(a, a).sqrt();
    a.map(|c| c / length)
}

impl Mirror {
    /// The mirror of a scene; none unless its far window has `mirrors = "chamber"`.
    pub fn of(scene: &Scene) -> Option<Self> {
        let far = scene.windows.far.as_ref().filter(|w| w.mirrors_chamber)?;
        let normal = unit(far.normal);
        let opening = scene.windows.near.as_ref().map(|near| {
            let towards = along(far.position_m, -1.0, near.position_m);
            let facing = unit(near.normal);
            let facing = if dot(facing, towards) < 0.0 { facing.map(|c| -c) } else { facing };
            Opening { centre: near.position_m, facing, diameter_m: near.diameter_m }
        });
        let band = scene.band.as_ref().map(super::file::BandSource::nodes)?;
        let reflectance = band.wavelengths_um.iter().map(|&um| reflectance(far, um)).fold(0.0, f64::max);
        Some(Self { place: far.position_m, normal, opening, reflectance })
    }

    /// The error that the mirrored image may have for its part of the whole to keep `target`.
    pub fn target(&self, target: f64) -> f64 {
        (target / self.reflectance.max(f64::MIN_POSITIVE)).min(TARGET_MAX).max(target)
    }

    fn point(&self, p: Vector) -> Vector {
        along(p, -2.0 * dot(along(p, -1.0, self.place), self.normal), self.normal)
    }

    fn direction(&self, d: Vector) -> Vector {
        along(d, -2.0 * dot(d, self.normal), self.normal)
    }

    /// The camera in the mirror. Column c of its image shows what is mirrored in column (columns − 1 − c) of the camera's.
    pub fn camera(&self, camera: &Camera) -> Camera {
        Camera {
            position_m: self.point(camera.position_m),
            look_at_m: self.point(camera.look_at_m),
            up: self.direction(camera.up),
            ..camera.clone()
        }
    }

    /// The mirrored part of a ray, from the window on; none for rays that do not meet its plane.
    pub fn ray(&self, origin: Vector, direction: Vector) -> Option<(Vector, Vector)> {
        let distance = dot(along(self.place, -1.0, origin), self.normal) / dot(direction, self.normal);
        (distance.is_finite() && distance >= 0.0)
            .then(|| (along(origin, distance, direction), self.direction(direction)))
    }

    /// The near window's opening as mirrored sights see it: a disc, of its own diameter or so large that it covers all
    /// given sights and their mirrored parts. None without a near window.
    pub fn opening(&self, sights: &[(Vector, Vector)], aperture_m: f64) -> Option<PlateShape> {
        let opening = self.opening.as_ref()?;
        let across = |(origin, direction): (Vector, Vector)| {
            let distance =
                dot(along(opening.centre, -1.0, origin), opening.facing) / dot(direction, opening.facing);
            let met = along(along(origin, distance, direction), -1.0, opening.centre);
            dot(met, met).sqrt()
        };
        let covers = || {
            let reach = sights
                .iter()
                .flat_map(|&(origin, direction)| {
                    [Some((origin, direction)), self.ray(origin, direction)].into_iter().flatten()
                })
                .map(across)
                .filter(|r| r.is_finite())
                .fold(1e-6, f64::max);
            2.0 * (MARGIN * reach + aperture_m)
        };
        let diameter_m = opening.diameter_m.unwrap_or_else(covers);
        Some(PlateShape::Disc { centre_m: opening.centre, facing: opening.facing, diameter_m })
    }

    /// The near window's opening for all pixels of a camera.
    #[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
    pub fn opening_of(&self, camera: &Camera) -> Option<PlateShape> {
        let sights = camera.sights().ok()?;
        let corners: Vec<_> = [0, camera.rows]
            .into_iter()
            .flat_map(|row| [0, camera.columns].map(|column| sights.ray(row as f64, column as f64)))
            .collect();
        let aperture_m = match camera.lens.map(|l| (l.aperture, l.focus_m)) {
            Some((Aperture::DiameterM(d), _)) => d,
            // Twice the way to the plane in focus, at the cone's edge.
            Some((Aperture::Numerical(na), focus)) => 2.0 * focus * na.asin().tan(),
            None => 0.0,
        };
        self.opening(&corners, aperture_m)
    }
}

fn reflectance(window: &WindowSource, um: f64) -> f64 {
    window.plate.optics(um, window.temperature_k).reflectance
}
