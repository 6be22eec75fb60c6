//! A lens in front of the camera: sights through one image point that cross in the plane in focus.
//!
//! The image is in object space: a point of it is a point of the plane in focus, and every sight through it passes the
//! aperture somewhere else. Pupils are uniform: over the area of a thin lens, over the sines of the angles of a
//! telecentric one (Abbe's sine condition). No aberration, no diffraction, no fall-off towards the corners.

use super::camera::{Camera, Projection, Sights};
use super::error::TracerError;
use super::vector::{Vector, along, dot, sub};

/// Largest numerical aperture of a telecentric lens, in air.
pub const NUMERICAL_APERTURE_MAX: f64 = 0.9;

/// How wide the lens is open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Aperture {
    /// Diameter in metres of the entrance pupil, centred at the position of a pinhole camera; not negative.
    DiameterM(f64),
    /// Sine of the half angle of the cone of sights of a telecentric camera, 0 to [`NUMERICAL_APERTURE_MAX`].
    Numerical(f64),
}

/// A lens without aberrations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// How wide it is open.
    pub aperture: Aperture,
    /// Distance in metres from the camera's position, along its axis, to the plane in focus; positive.
    pub focus_m: f64,
}

/// The lens of a camera, checked: unit vectors to the right and up, radius in metres or as a sine, distance in focus.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pupil {
    right: Vector,
    upward: Vector,
    radius: f64,
    focus: f64,
}

impl Camera {
    /// The lens, checked; none where it is closed down to a point.
    pub(super) fn pupil(&self, right: Vector, upward: Vector) -> Result<Option<Pupil>, TracerError> {
        let geometry = |what, condition| Err(TracerError::Geometry { what, condition });
        let Some(Lens { aperture, focus_m: focus }) = self.lens else { return Ok(None) };
        if !(focus > 0.0 && focus.is_finite()) {
            return geometry("the lens's distance in focus", "positive and finite");
        }
        let radius = match (aperture, self.projection) {
            (Aperture::DiameterM(d), Projection::Pinhole { .. }) => {
                if !(d >= 0.0 && d.is_finite()) {
                    return geometry("the lens's diameter", "finite and not negative");
                }
                0.5 * d
            }
            (Aperture::Numerical(na), Projection::Telecentric { .. }) => {
                if !(0.0..=NUMERICAL_APERTURE_MAX).contains(&na) {
                    return geometry("the lens's numerical aperture", "between 0 and 0.9");
                }
                na
            }
            (Aperture::DiameterM(_), _) => {
                return geometry(
                    "a lens with a diameter",
                    "at a pinhole camera; telecentric ones have a numerical aperture",
                );
            }
            (Aperture::Numerical(_), _) => {
                return geometry(
                    "a lens with a numerical aperture",
                    "at a telecentric camera; others have a diameter",
                );
            }
        };
        Ok((radius > 0.0).then_some(Pupil { right, upward, radius, focus }))
    }
}

impl Pupil {
    /// The point of the aperture at `at` in the unit disc, from the camera's position; for a telecentric lens the
    /// sideways part of a unit direction.
    #[inline]
    fn offset(&self, at: [f64; 2]) -> Vector {
        let [a, b] = at.map(|c| c * self.radius);
        [0, 1, 2].map(|k| a * self.right[k] + b * self.upward[k])
    }

    /// Unit direction of all sights of a telecentric lens that pass the aperture there, and its cosine to the axis.
    #[inline]
    fn slanted(&self, forward: Vector, at: [f64; 2]) -> (Vector, f64) {
        let sideways = self.offset(at);
        let cosine = (1.0 - dot(sideways, sideways)).max(0.0).sqrt();
        (along(sideways, cosine, forward), cosine)
    }
}

impl Sights {
    /// Whether sights through an image point differ.
    pub(super) fn has_lens(&self) -> bool {
        self.pupil.is_some()
    }

    /// Origin and unit direction of the sight through an image position that passes the aperture at `at` in the unit disc.
    #[inline]
    pub(super) fn ray_through(&self, row: f64, column: f64, at: [f64; 2]) -> (Vector, Vector) {
        let Some(pupil) = &self.pupil else { return self.ray(row, column) };
        let x = 2.0 * column / self.columns - 1.0;
        let y = 1.0 - 2.0 * row / self.rows;
        if self.parallel {
            let (direction, cosine) = pupil.slanted(self.forward, at);
            let place = along(along(self.position, x, self.right), y, self.upward);
            let focused = along(place, pupil.focus, self.forward);
            return (along(focused, -pupil.focus / cosine, direction), direction);
        }
        // To the focused point, by the chief sight: measured from the aperture's point, that is a small correction.
        let chief = along(along(self.forward, x, self.right), y, self.upward);
        let offset = pupil.offset(at);
        let direction = along(chief, -1.0 / pupil.focus, offset);
        let length = dot(direction, direction).sqrt();
        (along(self.position, 1.0, offset), direction.map(|c| c / length))
    }

    /// Where the aperture's point `at` in the unit disc sees a point of the scene, in rows and columns; none for points
    /// that are not clearly in front of the lens.
    pub(super) fn project_through(&self, point: Vector, at: [f64; 2]) -> Option<(f64, f64)> {
        let Some(pupil) = &self.pupil else { return self.project(point) };
        let from = sub(point, self.position);
        let depth = dot(from, self.forward);
        let (x, y) = if self.parallel {
            let (direction, cosine) = pupil.slanted(self.forward, at);
            let focused = along(from, (pupil.focus - depth) / cosine, direction);
            (self.across(focused, self.right), self.across(focused, self.upward))
        } else if depth > 1e-9 * dot(from, from).sqrt() {
            let offset = pupil.offset(at);
            let focused = along(offset.map(|c| c / pupil.focus), 1.0 / depth, sub(from, offset));
            (self.across(focused, self.right), self.across(focused, self.upward))
        } else {
            return None;
        };
        Some((0.5 * (1.0 - y) * self.rows, 0.5 * (1.0 + x) * self.columns))
    }

    /// Unit direction in which the aperture's point `at` looks at a point, and the distance to it along the sight.
    #[inline]
    pub(super) fn towards_through(&self, point: Vector, at: [f64; 2]) -> (Vector, f64) {
        let Some(pupil) = &self.pupil else { return self.towards(point) };
        let from = sub(point, self.position);
        if self.parallel {
            let (direction, cosine) = pupil.slanted(self.forward, at);
            return (direction, dot(from, self.forward) / cosine);
        }
        let from = sub(from, pupil.offset(at));
        let distance = dot(from, from).sqrt();
        if distance > 0.0 { (from.map(|c| c / distance), distance) } else { (self.forward, 0.0) }
    }

    fn across(&self, from: Vector, axis: Vector) -> f64 {
        dot(from, axis) / dot(axis, axis)
    }
}

/// A point of the unit disc for a point of the unit square: areas and neighbours are kept, opposite points stay opposite.
/// P. Shirley and K. Chiu, J. Graphics Tools 2(3), 45 (1997).
#[inline]
pub(super) fn disc(u: f64, v: f64) -> [f64; 2] {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    if a == 0.0 && b == 0.0 {
        return [0.0; 2];
    }
    let (radius, angle) =
        if a.abs() > b.abs() { (a, FRAC_PI_4 * (b / a)) } else { (b, FRAC_PI_2 - FRAC_PI_4 * (a / b)) };
    let (sine, cosine) = angle.sin_cos();
    [radius * cosine, radius * sine]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracer::camera::PixelFilter;

    fn camera(projection: Projection, aperture: Aperture) -> Camera {
        Camera {
            projection,
            position_m: [0.1, -0.6, 0.05],
            look_at_m: [0.0, 0.0, 0.0],
            up: [0.1, 0.0, 1.0],
            columns: 64,
            rows: 48,
            pixel_filter: PixelFilter::Box,
            lens: Some(Lens { aperture, focus_m: 0.5 }),
        }
    }

    fn cameras() -> [Camera; 2] {
        [
            camera(Projection::Pinhole { horizontal_fov_deg: 25.0 }, Aperture::DiameterM(0.02)),
            camera(Projection::Telecentric { width_m: 0.2 }, Aperture::Numerical(0.05)),
        ]
    }

    /// Through one image point all sights meet in the plane in focus, where the pinhole's own sight meets it; elsewhere
    /// they are apart by the circle of confusion.
    #[test]
    fn sights_meet_in_the_plane_in_focus() {
        for camera in cameras() {
            let sights = camera.sights().unwrap();
            let plain = Camera { lens: None, ..camera.clone() }.sights().unwrap();
            let at_depth = |(origin, direction): (Vector, Vector), depth: f64| {
                let begun = dot(sub(origin, camera.position_m), sights.forward);
                along(origin, (depth - begun) / dot(direction, sights.forward), direction)
            };
            let focus = at_depth(plain.ray(7.25, 60.5), 0.5);
            let mut largest = 0.0_f64;
            for k in 0..16 {
                let (s, c) = (f64::from(k) * 0.4).sin_cos();
                let ray = sights.ray_through(7.25, 60.5, [c, s]);
                assert!((dot(ray.1, ray.1) - 1.0).abs() < 1e-14);
                let off = sub(at_depth(ray, 0.5), focus);
                assert!(dot(off, off).sqrt() < 1e-15, "{off:?}");
                let apart = sub(at_depth(ray, 0.6), at_depth(plain.ray(7.25, 60.5), 0.6));
                largest = largest.max(dot(apart, apart).sqrt());
                // Back again: the same image point, the same direction.
                let point = at_depth(ray, 0.63);
                let (row, column) = sights.project_through(point, [c, s]).unwrap();
                assert!((row - 7.25).abs() < 1e-11 && (column - 60.5).abs() < 1e-11, "{row} {column}");
                let (direction, distance) = sights.towards_through(point, [c, s]);
                let there = sub(along(ray.0, distance, direction), point);
                assert!(dot(there, there).sqrt() < 1e-14, "{there:?}");
            }
            // Radius of the aperture · 0.1 m / 0.5 m, or 0.1 m · tan of the cone's half angle.
            let wanted =
                if sights.parallel { 0.1 * 0.05 / (1.0_f64 - 0.0025).sqrt() } else { 0.01 * 0.1 / 0.5 };
            assert!((largest / wanted - 1.0).abs() < 1e-9, "{largest} {wanted}");
        }
    }

    #[test]
    fn the_disc_map_keeps_areas_and_opposites() {
        let n = 200;
        let (mut inside, mut square) = (0.0, 0.0);
        for i in 0..n * n {
            let (u, v) = ((f64::from(i / n) + 0.5) / f64::from(n), (f64::from(i % n) + 0.5) / f64::from(n));
            let [x, y] = disc(u, v);
            let [a, b] = disc(1.0 - u, 1.0 - v);
            assert!((x + a).abs() < 1e-12 && (y + b).abs() < 1e-12);
            let r2 = x * x + y * y;
            assert!(r2 <= 1.0 + 1e-12);
            square += r2;
            inside += f64::from(u8::from(x > 0.3));
        }
        let all = f64::from(n * n);
        // Mean of r² over a disc is ½ (the midpoints' error is 1/(12 n²) of the second derivative); the segment beyond
        // x = 0.3 has the share (acos 0.3 − 0.3 √(1 − 0.09)) / π, its border crosses at most 4n of n² cells.
        assert!((square / all - 0.5).abs() < 1e-4, "{}", square / all);
        let share = (0.3_f64.acos() - 0.3 * (0.91_f64).sqrt()) / std::f64::consts::PI;
        assert!((inside / all - share).abs() < 2.0 / f64::from(n), "{} {share}", inside / all);
    }

    #[test]
    fn impossible_lenses_are_refused() {
        let [pinhole, parallel] = cameras();
        let lens = |aperture, focus_m| Some(Lens { aperture, focus_m });
        for (camera, bad) in [
            (&pinhole, lens(Aperture::DiameterM(-1.0), 0.5)),
            (&pinhole, lens(Aperture::DiameterM(f64::NAN), 0.5)),
            (&pinhole, lens(Aperture::DiameterM(0.02), 0.0)),
            (&pinhole, lens(Aperture::DiameterM(0.02), f64::INFINITY)),
            (&pinhole, lens(Aperture::Numerical(0.1), 0.5)),
            (&parallel, lens(Aperture::DiameterM(0.02), 0.5)),
            (&parallel, lens(Aperture::Numerical(1.0), 0.5)),
        ] {
            let camera = Camera { lens: bad, ..camera.clone() };
            assert!(matches!(camera.sights(), Err(TracerError::Geometry { .. })), "{bad:?}");
        }
        let closed = Camera { lens: lens(Aperture::DiameterM(0.0), 0.5), ..pinhole };
        assert!(!closed.sights().unwrap().has_lens());
    }
}
