//! The moments of an exposure at which a parametric spray is looked at.
//!
//! The light of an exposure is the mean over its time. Gauss–Legendre takes this mean from a few moments: as many as the
//! spray's tips pass pixels while it lasts. Media of other kinds stand still or move as a whole (`tracer::spread`).

use super::file::{MediumSource, ParametricSource, Scene, SceneError};
use crate::light::quadrature::gauss_legendre;
use crate::tracer::camera::{Camera, Projection};

/// Moments at most.
pub const MOMENTS_MAX: usize = 8;

/// The scenes that an exposure is the mean of.
#[derive(Debug, Clone)]
pub struct Moments {
    /// Weight and scene; the weights add up to 1.
    pub scenes: Vec<(f64, Scene)>,
    /// How far the tips go during the exposure in pixels; 0 for other media than parametric sprays.
    pub pixels: f64,
}

impl Scene {
    /// The moments of the scene's exposure, before its spray is made: the scene itself unless it has an `[exposure]` and
    /// a parametric spray.
    ///
    /// # Errors
    ///
    /// [`SceneError`] for a spray that cannot be made at the ends of the exposure.
    pub fn moments(self) -> Result<Moments, SceneError> {
        let alone = |scene: Self| Moments { scenes: vec![(1.0, scene)], pixels: 0.0 };
        let (Some(exposure), Some(MediumSource::Parametric(source)), Some(camera)) =
            (&self.exposure, &self.medium, &self.camera)
        else {
            return Ok(alone(self));
        };
        if exposure.time_s <= 0.0 {
            return Ok(alone(self));
        }
        let at = |time_s: f64| {
            let mut source = ParametricSource::clone(source);
            source.spray.time_s = time_s;
            source
        };
        let (middle, half) = (source.spray.time_s, 0.5 * exposure.time_s);
        let tips = |time_s: f64| at(time_s).made().map(|(_, spray)| spray.summary.tips_m);
        let (before, after) = (tips(middle - half)?, tips(middle + half)?);
        let moved = before.iter().zip(&after).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
        let pixels = moved / pixel_m(camera, source.spray.tip_m);
        let count = (1..MOMENTS_MAX).find(|&n| real(n) >= pixels).unwrap_or(MOMENTS_MAX);
        if count == 1 {
            return Ok(Moments { pixels, ..alone(self) });
        }
        let scenes = gauss_legendre(count)
            .into_iter()
            .map(|(x, weight)| {
                let medium = MediumSource::Parametric(Box::new(at(middle + half * x)));
                (0.5 * weight, Self { medium: Some(medium), ..self.clone() })
            })
            .collect();
        Ok(Moments { scenes, pixels })
    }
}

/// Width of a pixel where the spray is, in metres.
fn pixel_m(camera: &Camera, place: [f64; 3]) -> f64 {
    let from = |p: [f64; 3]| [0, 1, 2].map(|k| p[k] - camera.position_m[k]);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let axis = from(camera.look_at_m);
    let distance = (dot(from(place), axis) / dot(axis, axis).sqrt()).abs();
    let width = match camera.projection {
        Projection::Pinhole { horizontal_fov_deg } => {
            2.0 * distance * (0.5 * horizontal_fov_deg.to_radians()).tan()
        }
        Projection::Telecentric { width_m } => width_m,
    };
    width / real(camera.columns.max(1))
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
