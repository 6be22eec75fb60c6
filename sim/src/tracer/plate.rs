//! The black-body plate as a target of rays: rectangle, disc, or a cone of directions at infinity.
//!
//! One-sided: rays that arrive from behind do not see it. Knows no temperature.

use super::error::TracerError;
use super::vector::{Vector, along, cross, dot, frame, sub, unit};

/// The plate's form and place; lengths in metres.
#[derive(Debug, Clone, PartialEq)]
pub enum PlateShape {
    /// A rectangle; its height runs along the projection of z (of y when it faces along z), its width across.
    Rectangle {
        /// Centre.
        centre_m: Vector,
        /// Direction of its outward normal.
        facing: Vector,
        /// Width.
        width_m: f64,
        /// Height.
        height_m: f64,
    },
    /// A disc.
    Disc {
        /// Centre.
        centre_m: Vector,
        /// Direction of its outward normal.
        facing: Vector,
        /// Diameter.
        diameter_m: f64,
    },
    /// All directions within `half_angle_deg` of −`facing`, at infinity.
    Cone {
        /// Direction towards the scene.
        facing: Vector,
        /// Half angle in degrees, at most 90.
        half_angle_deg: f64,
    },
}

/// A checked plate, ready for rays.
#[derive(Debug, Clone)]
pub struct Plate {
    form: Form,
    centre: Vector,
    facing: Vector,
    /// Unit vectors along width and height.
    across: Vector,
    upward: Vector,
}

#[derive(Debug, Clone, Copy)]
enum Form {
    Rectangle { half_width: f64, half_height: f64 },
    Disc { radius: f64 },
    Cone { cos_limit: f64, versine: f64 },
}

impl Plate {
    /// Checks a shape.
    ///
    /// # Errors
    ///
    /// [`TracerError::Geometry`] for lengths that are not positive, a facing of length zero, or an angle outside (0, 90].
    pub fn new(shape: &PlateShape) -> Result<Self, TracerError> {
        let positive = |what, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(value)
            } else {
                Err(TracerError::Geometry { what, condition: "positive and finite" })
            }
        };
        let (facing, centre, form) = match *shape {
            PlateShape::Rectangle { centre_m, facing, width_m, height_m } => {
                let half_width = 0.5 * positive("the plate's width", width_m)?;
                let half_height = 0.5 * positive("the plate's height", height_m)?;
                (facing, centre_m, Form::Rectangle { half_width, half_height })
            }
            PlateShape::Disc { centre_m, facing, diameter_m } => {
                (facing, centre_m, Form::Disc { radius: 0.5 * positive("the plate's diameter", diameter_m)? })
            }
            PlateShape::Cone { facing, half_angle_deg } => {
                let angle = positive("the plate's half angle", half_angle_deg)?;
                if angle > 90.0 {
                    return Err(TracerError::Geometry {
                        what: "the plate's half angle",
                        condition: "at most 90 degrees",
                    });
                }
                let half = (0.5 * angle.to_radians()).sin();
                let versine = if angle >= 90.0 { 1.0 } else { 2.0 * half * half };
                (facing, [0.0; 3], Form::Cone { cos_limit: 1.0 - versine, versine })
            }
        };
        if !centre.iter().all(|c| c.is_finite()) {
            return Err(TracerError::Geometry { what: "the plate's centre", condition: "finite" });
        }
        let facing = unit(facing).ok_or(TracerError::Geometry {
            what: "the plate's facing",
            condition: "a direction of finite length",
        })?;
        let reference = if facing[2].abs() > 0.999_999 { [0.0, 1.0, 0.0] } else { [0.0, 0.0, 1.0] };
        let across = unit(cross(reference, facing)).unwrap_or_else(|| frame(facing).0);
        let upward = cross(facing, across);
        Ok(Self { form, centre, facing, across, upward })
    }

    /// Distance along the ray (in units of `direction`) at which it meets the plate; infinite for a cone.
    #[inline]
    pub fn hit(&self, origin: Vector, direction: Vector) -> Option<f64> {
        let towards = -dot(self.facing, direction);
        if let Form::Cone { cos_limit, .. } = self.form {
            return (towards > 0.0 && towards >= cos_limit).then_some(f64::INFINITY);
        }
        if towards <= 0.0 {
            return None;
        }
        let distance = dot(self.facing, sub(origin, self.centre)) / towards;
        if distance.is_nan() || distance < 0.0 {
            return None;
        }
        let place = sub(along(origin, distance, direction), self.centre);
        let (a, b) = (dot(place, self.across), dot(place, self.upward));
        let inside = match self.form {
            Form::Rectangle { half_width, half_height } => a.abs() <= half_width && b.abs() <= half_height,
            Form::Disc { radius } => a * a + b * b <= radius * radius,
            Form::Cone { .. } => false,
        };
        inside.then_some(distance)
    }

    /// Its area in m²; none for a cone.
    pub(crate) fn area_m2(&self) -> Option<f64> {
        match self.form {
            Form::Rectangle { half_width, half_height } => Some(4.0 * half_width * half_height),
            Form::Disc { radius } => Some(std::f64::consts::PI * radius * radius),
            Form::Cone { .. } => None,
        }
    }

    /// Its unit normal, towards the scene.
    pub(crate) fn facing(&self) -> Vector {
        self.facing
    }

    /// A place on it, uniform over its area for uniform `u` and `v` in (0, 1); the origin for a cone.
    pub(crate) fn spot(&self, u: f64, v: f64) -> Vector {
        let (a, b) = match self.form {
            Form::Rectangle { half_width, half_height } => {
                ((2.0 * u - 1.0) * half_width, (2.0 * v - 1.0) * half_height)
            }
            Form::Disc { radius } => {
                let (s, c) = (std::f64::consts::TAU * v).sin_cos();
                (radius * u.sqrt() * c, radius * u.sqrt() * s)
            }
            Form::Cone { .. } => (0.0, 0.0),
        };
        along(along(self.centre, a, self.across), b, self.upward)
    }

    /// Which of the rays `first` + i · `step` meet the plate (origins and directions of any length). The same as
    /// [`Plate::hit`] but for rounding at the very edge, and without a division.
    #[inline(always)]
    pub(super) fn covers(&self, first: (Vector, Vector), step: (Vector, Vector), meets: &mut [bool]) {
        let from = sub(first.0, self.centre);
        // Along the plate's axes everything is linear in i.
        let axis = |a: Vector| [dot(from, a), dot(step.0, a), dot(first.1, a), dot(step.1, a)];
        let [h, a, b] = [axis(self.facing), axis(self.across), axis(self.upward)];
        let at = |v: [f64; 4], i: f64| (v[1].mul_add(i, v[0]), v[3].mul_add(i, v[2]));
        for (i, meets) in meets.iter_mut().enumerate() {
            #[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
            let i = i as f64;
            let ((height, towards), (a, da), (b, db)) = (at(h, i), at(a, i), at(b, i));
            let towards = -towards;
            let front = (towards > 0.0) & (height >= 0.0);
            // The place on the plate times `towards`.
            let (a, b) = (a * towards + height * da, b * towards + height * db);
            *meets = match self.form {
                Form::Rectangle { half_width, half_height } => {
                    front & (a.abs() <= half_width * towards) & (b.abs() <= half_height * towards)
                }
                Form::Disc { radius } => front & (a * a + b * b <= (radius * towards).powi(2)),
                Form::Cone { cos_limit, .. } => {
                    let square = towards * towards + da * da + db * db;
                    (towards > 0.0) & (towards * towards >= cos_limit * cos_limit * square)
                }
            };
        }
    }

    /// Where the ray meets its plane from the front, in half widths (or radii) to the right and half heights up, as seen
    /// from the front; none for a cone, and for rays that do not meet it so.
    pub(super) fn place(&self, origin: Vector, direction: Vector) -> Option<[f64; 2]> {
        let halves = match self.form {
            Form::Rectangle { half_width, half_height } => [half_width, half_height],
            Form::Disc { radius } => [radius; 2],
            Form::Cone { .. } => return None,
        };
        let towards = -dot(self.facing, direction);
        let distance = dot(self.facing, sub(origin, self.centre)) / towards;
        if !(towards > 0.0 && distance >= 0.0) {
            return None;
        }
        let place = sub(along(origin, distance, direction), self.centre);
        Some([dot(place, self.across) / halves[0], dot(place, self.upward) / halves[1]])
    }

    /// The same plate elsewhere; a cone's directions stay.
    pub(super) fn moved(&self, by: Vector) -> Self {
        Self { centre: along(self.centre, 1.0, by), ..self.clone() }
    }

    /// Its centre; none for a cone.
    pub(super) fn centre(&self) -> Option<Vector> {
        (!matches!(self.form, Form::Cone { .. })).then_some(self.centre)
    }

    /// Whether it fills most of a half space, so that aiming at it gains nothing.
    pub fn is_wide(&self) -> bool {
        matches!(self.form, Form::Cone { versine, .. } if versine > 0.5)
    }

    /// A direction from `origin` towards the plate, with its density per steradian; none where the plate cannot be
    /// aimed at (behind its face, or so near that the density has no bound).
    pub fn sample(&self, origin: Vector, u: f64, v: f64) -> Option<(Vector, f64)> {
        if let Form::Cone { versine, .. } = self.form {
            let drop = versine * u;
            let sine = (drop * (2.0 - drop)).max(0.0).sqrt();
            let axis = self.facing.map(|c| -c);
            let direction = super::vector::turn(axis, 1.0 - drop, sine, std::f64::consts::TAU * v);
            return Some((direction, 1.0 / (std::f64::consts::TAU * versine)));
        }
        let (a, b) = match self.form {
            Form::Rectangle { half_width, half_height } => {
                ((2.0 * u - 1.0) * half_width, (2.0 * v - 1.0) * half_height)
            }
            Form::Disc { radius } => {
                let (s, c) = (std::f64::consts::TAU * v).sin_cos();
                (radius * u.sqrt() * c, radius * u.sqrt() * s)
            }
            Form::Cone { .. } => return None,
        };
        let target = along(along(self.centre, a, self.across), b, self.upward);
        let direction = unit(sub(target, origin))?;
        let density = self.density(origin, direction);
        (density > 0.0).then_some((direction, density))
    }

    /// Density per steradian with which [`Plate::sample`] gives a direction that meets the plate; zero where it cannot.
    #[inline]
    pub fn density(&self, origin: Vector, direction: Vector) -> f64 {
        let area = match self.form {
            Form::Cone { versine, .. } => return 1.0 / (std::f64::consts::TAU * versine),
            Form::Rectangle { half_width, half_height } => 4.0 * half_width * half_height,
            Form::Disc { radius } => std::f64::consts::PI * radius * radius,
        };
        let towards = -dot(self.facing, direction);
        let height = dot(self.facing, sub(origin, self.centre));
        if towards <= 0.0 || height <= 0.0 {
            return 0.0;
        }
        let distance = height / towards;
        let density = distance * distance / (area * towards);
        if density.is_finite() { density } else { 0.0 }
    }
}
