//! The camera as a maker of rays: pinhole or telecentric.
//!
//! Row 0 of the image is the `up` side, column 0 the left side as seen by the camera. Sights through a lens: `lens`.

use super::error::TracerError;
use super::lens::{Lens, Pupil};
use super::vector::{Vector, along, cross, sub, unit};

/// How the lines of sight are arranged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// All sights start at the position; full horizontal field of view in degrees, in (0, 180).
    Pinhole {
        /// Full angle between the left and right edges of the image.
        horizontal_fov_deg: f64,
    },
    /// All sights are parallel; width of the seen field in metres.
    Telecentric {
        /// Distance between the left and right edges of the image.
        width_m: f64,
    },
}

/// How a pixel's value is taken from its area.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelFilter {
    /// The mean over the pixel's area.
    #[default]
    Box,
    /// The sight through its centre.
    Centre,
}

/// A camera; lengths in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Arrangement of the sights.
    pub projection: Projection,
    /// Where the sights start.
    pub position_m: Vector,
    /// A point on the optical axis.
    pub look_at_m: Vector,
    /// The direction shown upwards.
    pub up: Vector,
    /// Columns of the image.
    pub columns: usize,
    /// Rows of the image.
    pub rows: usize,
    /// How a pixel's value is taken from its area.
    pub pixel_filter: PixelFilter,
    /// The lens; none where everything is in focus.
    pub lens: Option<Lens>,
}

/// A camera with its frame of unit vectors.
#[derive(Debug, Clone)]
pub struct Sights {
    pub(super) position: Vector,
    pub(super) forward: Vector,
    /// Half the image's extent to the right and up: directions at unit distance (pinhole) or metres (telecentric).
    pub(super) right: Vector,
    pub(super) upward: Vector,
    pub(super) parallel: bool,
    pub(super) rows: f64,
    pub(super) columns: f64,
    pub(super) pupil: Option<Pupil>,
}

impl Camera {
    /// Checks the camera and prepares its sights.
    ///
    /// # Errors
    ///
    /// [`TracerError::Geometry`] for undefined positions, a direction of length zero, `up` along the axis, or a field of
    /// view outside (0, 180) degrees, a lens that is not positive or not of the camera's kind.
    pub fn sights(&self) -> Result<Sights, TracerError> {
        let geometry = |what, condition| TracerError::Geometry { what, condition };
        if !self.position_m.iter().chain(&self.look_at_m).all(|c| c.is_finite()) {
            return Err(geometry("the camera's position and look_at", "finite"));
        }
        let forward = unit(sub(self.look_at_m, self.position_m))
            .ok_or(geometry("the camera's look_at", "another point than its position"))?;
        let up = unit(self.up).ok_or(geometry("the camera's up", "a direction of finite length"))?;
        let right = cross(forward, up);
        if super::vector::dot(right, right) < 1e-12 {
            return Err(geometry("the camera's up", "across its line of sight"));
        }
        let right = unit(right).ok_or(geometry("the camera's up", "across its line of sight"))?;
        let upward = cross(right, forward);
        let half = match self.projection {
            Projection::Pinhole { horizontal_fov_deg: angle } if angle > 0.0 && angle < 180.0 => {
                (0.5 * angle.to_radians()).tan()
            }
            Projection::Telecentric { width_m } if width_m > 0.0 && width_m.is_finite() => 0.5 * width_m,
            Projection::Pinhole { .. } => {
                return Err(geometry("the camera's field of view", "between 0 and 180 degrees"));
            }
            Projection::Telecentric { .. } => {
                return Err(geometry("the camera's width", "positive and finite"));
            }
        };
        #[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
        let (rows, columns) = (self.rows as f64, self.columns as f64);
        let tall = half * rows / columns.max(1.0);
        let pupil = self.pupil(right, upward)?;
        Ok(Sights {
            pupil,
            position: self.position_m,
            forward,
            right: right.map(|c| c * half),
            upward: upward.map(|c| c * tall),
            parallel: matches!(self.projection, Projection::Telecentric { .. }),
            rows,
            columns,
        })
    }
}

impl Sights {
    /// Origin and unit direction of the sight through image position (`row`, `column`), in pixels from the upper left
    /// corner: the centre of pixel (0, 0) is (0.5, 0.5).
    #[inline]
    pub fn ray(&self, row: f64, column: f64) -> (Vector, Vector) {
        let x = 2.0 * column / self.columns - 1.0;
        let y = 1.0 - 2.0 * row / self.rows;
        if self.parallel {
            (along(along(self.position, x, self.right), y, self.upward), self.forward)
        } else {
            let d = along(along(self.forward, x, self.right), y, self.upward);
            let length = super::vector::dot(d, d).sqrt();
            (self.position, d.map(|c| c / length))
        }
    }

    /// Origin and direction, not of unit length, at the left end of an image row, and what both change by per column.
    pub(super) fn row(&self, row: f64) -> [(Vector, Vector); 2] {
        let y = 1.0 - 2.0 * row / self.rows;
        let (left, step) = (self.right.map(|c| -c), self.right.map(|c| 2.0 * c / self.columns));
        if self.parallel {
            let origin = along(along(self.position, 1.0, left), y, self.upward);
            [(origin, self.forward), (step, [0.0; 3])]
        } else {
            let direction = along(along(self.forward, 1.0, left), y, self.upward);
            [(self.position, direction), ([0.0; 3], step)]
        }
    }

    /// Where a point appears, in rows and columns as in [`Sights::ray`]; none for points that are not clearly in front
    /// of a pinhole.
    #[inline]
    pub fn project(&self, point: Vector) -> Option<(f64, f64)> {
        let from = sub(point, self.position);
        let depth = super::vector::dot(from, self.forward);
        let across = |axis: Vector| super::vector::dot(from, axis) / super::vector::dot(axis, axis);
        let (x, y) = (across(self.right), across(self.upward));
        let (x, y) = if self.parallel {
            (x, y)
        } else if depth > 1e-9 * super::vector::dot(from, from).sqrt() {
            (x / depth, y / depth)
        } else {
            return None;
        };
        Some((0.5 * (1.0 - y) * self.rows, 0.5 * (1.0 + x) * self.columns))
    }

    /// Unit direction in which the camera looks at a point, and the distance to it along the sight.
    #[inline]
    pub fn towards(&self, point: Vector) -> (Vector, f64) {
        let from = sub(point, self.position);
        if self.parallel {
            return (self.forward, super::vector::dot(from, self.forward));
        }
        let distance = super::vector::dot(from, from).sqrt();
        if distance > 0.0 { (from.map(|c| c / distance), distance) } else { (self.forward, 0.0) }
    }
}
