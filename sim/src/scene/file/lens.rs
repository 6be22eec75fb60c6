//! The lens of `[camera]`, and the `[exposure]` table.

use super::tables::{CameraTable, ExposureTable, LensTable};
use super::{MediumSource, Reader, SceneError};
use crate::tracer::camera::Projection;
use crate::tracer::lens::{Aperture, Lens, NUMERICAL_APERTURE_MAX};

/// How long the camera looks, and how the medium moves meanwhile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Duration in seconds, centred at the scene's moment.
    pub time_s: f64,
    /// Velocity of the whole medium in m/s.
    pub velocity_m_s: [f64; 3],
}

impl Exposure {
    /// How far the medium moves.
    pub fn motion_m(&self) -> [f64; 3] {
        self.velocity_m_s.map(|v| v * self.time_s)
    }
}

impl Reader<'_> {
    pub(super) fn lens(
        &self,
        camera: &CameraTable,
        lens: &LensTable,
        projection: Projection,
    ) -> Result<Lens, SceneError> {
        let wrong = |problem: &str| Err(self.wrong(format!("[camera] lens: {problem}")));
        let away: f64 = camera.position_m.iter().zip(&camera.look_at_m).map(|(p, l)| (p - l).powi(2)).sum();
        let focus_m = lens.focus_m.unwrap_or(away.sqrt());
        if !(focus_m > 0.0 && focus_m.is_finite()) {
            return wrong("focus_m (the distance in focus) must be positive and finite");
        }
        let given = (lens.f_number, lens.focal_length_m, lens.aperture_m, lens.numerical_aperture);
        let aperture = match (projection, given) {
            (Projection::Pinhole { .. }, (Some(f_number), Some(focal_length_m), None, None)) => {
                if f_number.is_nan() || f_number <= 0.0 {
                    return wrong("f_number must be above 0");
                }
                if !(focal_length_m > 0.0 && focal_length_m < focus_m) {
                    return wrong(
                        "focal_length_m must be above 0 and below focus_m: nothing nearer is ever in focus",
                    );
                }
                Aperture::DiameterM(focal_length_m / f_number)
            }
            (Projection::Pinhole { .. }, (None, None, Some(aperture_m), None)) => {
                if !(aperture_m >= 0.0 && aperture_m.is_finite()) {
                    return wrong("aperture_m (the diameter) must be finite and not negative");
                }
                Aperture::DiameterM(aperture_m)
            }
            (Projection::Telecentric { .. }, (None, None, None, Some(sine))) => {
                if !(0.0..=NUMERICAL_APERTURE_MAX).contains(&sine) {
                    return wrong("numerical_aperture must be from 0 to 0.9");
                }
                Aperture::Numerical(sine)
            }
            (Projection::Pinhole { .. }, _) => {
                return wrong(
                    "a pinhole's lens needs f_number and focal_length_m, or aperture_m; focus_m besides",
                );
            }
            (Projection::Telecentric { .. }, _) => {
                return wrong("a telecentric lens needs numerical_aperture; focus_m besides");
            }
        };
        Ok(Lens { aperture, focus_m })
    }

    pub(super) fn exposure(
        &self,
        table: &ExposureTable,
        medium: Option<&MediumSource>,
    ) -> Result<Exposure, SceneError> {
        let ExposureTable { time_s, velocity_m_s } = *table;
        if !(time_s >= 0.0 && time_s.is_finite()) {
            return Err(
                self.wrong(format!("[exposure] time_s is {time_s}; it must be finite and not negative"))
            );
        }
        let velocity = velocity_m_s.unwrap_or_default();
        if !velocity.iter().all(|v| v.is_finite()) {
            return Err(self.wrong("[exposure] velocity_m_s must be three finite numbers"));
        }
        if let Some(MediumSource::Parametric(source)) = medium {
            if velocity_m_s.is_some() {
                return Err(self.wrong(
                    "[exposure] velocity_m_s: a parametric spray moves by itself; leave it out, or give a grid or CFD",
                ));
            }
            if 0.5 * time_s >= source.spray.time_s {
                return Err(self.wrong(format!(
                    "[exposure] time_s is {time_s}; the spray's time_s is its middle, and must be more than half of it \
                     after the start of injection"
                )));
            }
        }
        Ok(Exposure { time_s, velocity_m_s: velocity })
    }
}
