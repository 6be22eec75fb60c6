//! The inside of a chamber as a box: which of its walls a ray ends on.
//!
//! Walls are opaque and seen from inside only: a ray that comes from outside enters through the opening or window that it
//! needs, and ends on the wall where it leaves the box again. Knows no temperatures; the plate is asked before the walls.

use super::error::TracerError;
use super::vector::{Vector, dot, sub};

/// Walls of a chamber: at the lower and upper end of x, y, z.
pub const SIDES: usize = 6;

/// What a ray can end on besides the plate: the six walls, and the place outside for rays that miss the box.
pub const ENDS: usize = SIDES + 1;

/// The end of a ray that misses the box.
pub const OUTSIDE: usize = SIDES;

/// Names of the walls, in their order.
pub const SIDE_NAMES: [&str; SIDES] = ["x-", "x+", "y-", "y+", "z-", "z+"];

/// A distance this small against the chamber's size is rounding.
const ROUNDING: f64 = 1e-12;

/// The inside of a chamber: a box along the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chamber {
    lower: Vector,
    upper: Vector,
    slack: f64,
}

impl Chamber {
    /// A box between two corners, in metres.
    ///
    /// # Errors
    ///
    /// [`TracerError::Geometry`] unless all coordinates are finite and every upper one is above its lower one.
    pub fn new(lower_m: Vector, upper_m: Vector) -> Result<Self, TracerError> {
        let sound = |a: usize| lower_m[a].is_finite() && upper_m[a].is_finite() && lower_m[a] < upper_m[a];
        let size = sub(upper_m, lower_m);
        let slack = ROUNDING * dot(size, size).sqrt();
        if !([0, 1, 2].into_iter().all(sound) && slack.is_finite() && slack > 0.0) {
            let condition = "a box of finite size, upper_m above lower_m along every axis";
            return Err(TracerError::Geometry { what: "the chamber", condition });
        }
        Ok(Self { lower: lower_m, upper: upper_m, slack })
    }

    /// The lower corner in metres.
    pub fn lower_m(&self) -> Vector {
        self.lower
    }

    /// The upper corner in metres.
    pub fn upper_m(&self) -> Vector {
        self.upper
    }

    /// Height of a place above a wall, inwards, in metres; negative behind it.
    pub fn height(&self, side: usize, place: Vector) -> f64 {
        let axis = side / 2;
        if side.is_multiple_of(2) { place[axis] - self.lower[axis] } else { self.upper[axis] - place[axis] }
    }

    /// Whether a place lies inside, walls included.
    pub fn holds(&self, place: Vector) -> bool {
        (0..SIDES).all(|side| self.height(side, place) >= -self.slack)
    }

    /// The wall on which a ray ends, or [`OUTSIDE`]; `direction` should be a unit vector.
    #[inline]
    pub fn end(&self, origin: Vector, direction: Vector) -> usize {
        self.span(origin, direction).map_or(OUTSIDE, |span| span.side)
    }

    /// Where a ray enters and leaves the box; none where it misses it or has left it.
    #[inline]
    pub(super) fn span(&self, origin: Vector, direction: Vector) -> Option<Span> {
        let mut span = Span { enter: 0.0, leave: f64::INFINITY, side: OUTSIDE };
        for axis in 0..3 {
            let (o, d) = (origin[axis], direction[axis]);
            let (near, far, side) = match d {
                d if d > 0.0 => (self.lower[axis], self.upper[axis], 2 * axis + 1),
                d if d < 0.0 => (self.upper[axis], self.lower[axis], 2 * axis),
                _ if o < self.lower[axis] - self.slack || o > self.upper[axis] + self.slack => return None,
                _ => continue,
            };
            span.enter = span.enter.max((near - o) / d);
            let leave = (far - o) / d;
            if leave < span.leave {
                (span.leave, span.side) = (leave, side);
            }
        }
        (span.side < SIDES && span.enter <= span.leave + self.slack && span.leave >= -self.slack)
            .then_some(span)
    }
}

/// The part of a ray inside a chamber, in units of its direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    /// Not negative.
    pub(super) enter: f64,
    pub(super) leave: f64,
    /// The wall on which it ends.
    pub(super) side: usize,
}

/// What surrounds a medium.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Walls {
    /// Walls far away, all alike.
    #[default]
    Far,
    /// A chamber whose walls are all alike: media end at them.
    Alike(Chamber),
    /// A chamber whose walls are told apart.
    Apart(Chamber),
}

impl Walls {
    /// The chamber, if there is one.
    pub fn chamber(&self) -> Option<&Chamber> {
        match self {
            Self::Far => None,
            Self::Alike(chamber) | Self::Apart(chamber) => Some(chamber),
        }
    }

    /// The same surroundings without telling walls apart.
    #[must_use]
    pub fn together(self) -> Self {
        if let Self::Apart(chamber) = self { Self::Alike(chamber) } else { self }
    }

    /// The chamber whose walls are told apart, if they are.
    pub fn apart(&self) -> Option<&Chamber> {
        if let Self::Apart(chamber) = self { Some(chamber) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracer::vector::unit;

    fn chamber() -> Chamber {
        Chamber::new([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]).unwrap()
    }

    #[test]
    fn every_axis_ends_on_its_wall_and_a_ray_from_outside_on_the_far_one() {
        for (side, name) in SIDE_NAMES.iter().enumerate() {
            let mut d = [0.0; 3];
            d[side / 2] = if side.is_multiple_of(2) { -1.0 } else { 1.0 };
            assert_eq!(chamber().end([0.1, 0.2, -0.3], d), side, "{name}");
            // Through the opposite wall.
            assert_eq!(chamber().end(d.map(|c| -10.0 * c), d), side);
            // Already through, or past it.
            assert_eq!(chamber().end(d.map(|c| 10.0 * c), d), OUTSIDE);
            assert_eq!(chamber().end([9.0, 9.0, 9.0], d), OUTSIDE);
            // On the wall itself, outwards.
            let on = d.map(|c| c * chamber().upper[side / 2]);
            assert_eq!(chamber().end(on, d), side);
        }
    }

    #[test]
    fn ends_agree_with_a_march_in_small_steps() {
        let c = chamber();
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for _ in 0..500 {
            let at = [0, 1, 2].map(|a: usize| c.lower[a] + random() * (c.upper[a] - c.lower[a]));
            let d = unit([0; 3].map(|_| random() - 0.5)).unwrap();
            let mut place = at;
            while c.holds(place) {
                place = [0, 1, 2].map(|a: usize| place[a] + 1e-3 * d[a]);
            }
            // The wall behind which it is now; near an edge there may be two.
            let side = c.end(at, d);
            assert!(c.height(side, place) < 0.0, "{at:?} {d:?} ends on {side}");
            let span = c.span(at, d).unwrap();
            assert!(
                span.enter == 0.0
                    && c.height(side, [0, 1, 2].map(|a| at[a] + span.leave * d[a])).abs() < 1e-13
            );
        }
    }

    #[test]
    fn boxes_without_an_inside_are_refused() {
        for upper in [[1.0, 1.0, 0.0], [1.0, f64::NAN, 1.0], [f64::INFINITY, 1.0, 1.0], [-1.0, 1.0, 1.0]] {
            assert!(Chamber::new([0.0; 3], upper).is_err(), "{upper:?}");
        }
    }
}
