//! How walls and plate of a chamber face each other.
//!
//! From places on the plate every pair of walls, the one that light comes from and the one that it would end on were the
//! plate not there, is a spherical polygon, whose share of the plate's view is Lambert's contour integral; the mean over
//! the plate is by quadrature. A plate at infinity is done by directions.

use crate::light::quadrature::gauss_legendre_unit;
use crate::tracer::chamber::{Chamber, ENDS, OUTSIDE, SIDES};
use crate::tracer::plate::Plate;
use std::f64::consts::{PI, TAU};

/// Places per axis on a plate, and directions towards one at infinity. With a plate as wide as the chamber the shares err
/// by 1e-4, with a smaller one by less.
const PLACES: usize = 16;
const DIRECTIONS: [usize; 2] = [64, 128];

/// Relative distance at which a place lies in the plane of a wall.
const FLUSH: f64 = 1e-9;

type Vector = [f64; 3];

/// What a plate and the walls see of each other.
#[derive(Debug, Clone)]
pub(super) struct Facing {
    /// Exchange areas in m²: `[from][to]` of the light from a wall that the plate stops on the way to another wall.
    pub(super) hidden: [[f64; SIDES]; SIDES],
    /// Shares of what the plate sees, sum 1.
    pub(super) seen: [f64; ENDS],
}

impl Facing {
    /// No plate.
    pub(super) const NOTHING: Self =
        Self { hidden: [[0.0; SIDES]; SIDES], seen: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0] };

    pub(super) fn new(chamber: &Chamber, plate: &Plate) -> Self {
        match plate.area_m2() {
            Some(area) => Self::near(chamber, plate, area),
            None => Self::far(chamber, plate),
        }
    }

    fn near(chamber: &Chamber, plate: &Plate, area: f64) -> Self {
        let mut shares = [[0.0; SIDES]; SIDES];
        let rule = gauss_legendre_unit(PLACES);
        for &(u, weight_u) in &rule {
            for &(v, weight_v) in &rule {
                let here = view(chamber, plate.spot(u, v), plate.facing());
                for (sum, share) in shares.iter_mut().flatten().zip(here.iter().flatten()) {
                    *sum += weight_u * weight_v * share;
                }
            }
        }
        let mut seen = [0.0; ENDS];
        for (seen, row) in seen.iter_mut().zip(&shares) {
            *seen = row.iter().sum();
        }
        seen[OUTSIDE] = (1.0 - seen.iter().sum::<f64>()).max(0.0);
        Self { hidden: shares.map(|row| row.map(|share| area * share)), seen }
    }

    /// A plate at infinity: exchange areas of the walls along its directions. What it sees of a chamber is nothing.
    fn far(chamber: &Chamber, plate: &Plate) -> Self {
        let size = [0, 1, 2].map(|a: usize| chamber.upper_m()[a] - chamber.lower_m()[a]);
        let mut hidden = [[0.0; SIDES]; SIDES];
        for (u, weight) in gauss_legendre_unit(DIRECTIONS[0]) {
            for k in 0..DIRECTIONS[1] {
                let v = (k as f64 + 0.5) / DIRECTIONS[1] as f64;
                let Some((direction, density)) = plate.sample([0.0; 3], u, v) else { continue };
                add_direction(size, direction, weight / (density * DIRECTIONS[1] as f64 * PI), &mut hidden);
            }
        }
        Self { hidden, ..Self::NOTHING }
    }
}

/// Adds what runs along one direction, `weight` being its solid angle over π: areas of the walls times the cosine, by
/// the wall on which it ends.
fn add_direction(size: Vector, direction: Vector, weight: f64, hidden: &mut [[f64; SIDES]; SIDES]) {
    let slope = direction.map(f64::abs);
    // From the wall behind to the wall ahead, along each axis.
    let behind = |a: usize| 2 * a + usize::from(direction[a] < 0.0);
    for a in (0..3).filter(|&a| slope[a] > 0.0) {
        let [b, c] = [(a + 1) % 3, (a + 2) % 3];
        // How far light moves sideways before it reaches the opposite wall.
        let moved = |k: usize| size[a] * slope[k] / slope[a];
        let straight = (size[b] - moved(b)).max(0.0) * (size[c] - moved(c)).max(0.0);
        hidden[behind(a)][behind(a) ^ 1] += weight * slope[a] * straight;
        for (k, other) in [(b, c), (c, b)] {
            if slope[k] <= 0.0 {
                continue;
            }
            // Light that starts u before the wall ahead along k meets it first while it moves less along the others.
            let most = size[k].min(moved(k));
            let drift = slope[other] / slope[k];
            let most = if drift > 0.0 { most.min(size[other] / drift) } else { most };
            let area = most * (size[other] - 0.5 * drift * most);
            hidden[behind(a)][behind(k) ^ 1] += weight * slope[a] * area;
        }
    }
}

/// Shares of the view from a place on the plate, `[wall that is seen][wall that is hidden behind the plate]`.
fn view(chamber: &Chamber, place: Vector, facing: Vector) -> [[f64; SIDES]; SIDES] {
    let (low, high) = (chamber.lower_m(), chamber.upper_m());
    let flush = FLUSH * [0, 1, 2].map(|a: usize| high[a] - low[a]).into_iter().fold(0.0, f64::max);
    let height: [f64; SIDES] = std::array::from_fn(|side| chamber.height(side, place));
    let inside = height.iter().all(|&h| h >= -flush);
    let mounted = height.iter().position(|h| h.abs() <= flush).filter(|_| inside);
    let walls: [[Vector; 4]; SIDES] = std::array::from_fn(|side| corners(low, high, side, place));
    let mut shares = [[0.0; SIDES]; SIDES];
    for seen in (0..SIDES).filter(|&seen| height[seen] > flush) {
        let mut above = Polygon::new(&walls[seen]);
        above.clip(facing);
        for (hidden, wall) in walls.iter().enumerate() {
            let mut part = above.clone();
            match mounted {
                Some(wall) if wall != hidden => continue,
                Some(_) => {}
                // From inside, light goes on behind the plate; from outside, it has come in through the wall.
                None if inside => part.clip_to(wall, -1.0),
                None if height[hidden] < -flush => part.clip_to(wall, 1.0),
                None => continue,
            }
            shares[seen][hidden] = part.share(facing);
        }
    }
    shares
}

/// Corners of a wall seen from a place, in order around it.
fn corners(low: Vector, high: Vector, side: usize, place: Vector) -> [Vector; 4] {
    let axis = side / 2;
    let [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
    [(low[b], low[c]), (high[b], low[c]), (high[b], high[c]), (low[b], high[c])].map(|(at_b, at_c)| {
        let mut corner = [0.0; 3];
        corner[axis] = if side.is_multiple_of(2) { low[axis] } else { high[axis] };
        (corner[b], corner[c]) = (at_b, at_c);
        [0, 1, 2].map(|a: usize| corner[a] - place[a])
    })
}

/// A convex cone of directions by its edges, in order.
#[derive(Clone)]
struct Polygon(Vec<Vector>);

impl Polygon {
    fn new(corners: &[Vector]) -> Self {
        Self(corners.to_vec())
    }

    /// Keeps what lies on the positive side of a plane through the eye.
    fn clip(&mut self, normal: Vector) {
        let mut kept = Vec::with_capacity(self.0.len() + 1);
        for (i, &a) in self.0.iter().enumerate() {
            let b = self.0[(i + 1) % self.0.len()];
            let (da, db) = (dot(normal, a), dot(normal, b));
            if da >= 0.0 {
                kept.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                let t = da / (da - db);
                kept.push([0, 1, 2].map(|k: usize| a[k] + t * (b[k] - a[k])));
            }
        }
        self.0 = kept;
    }

    /// Keeps what lies in the cone of a wall's corners (sign 1) or opposite to it (sign −1).
    fn clip_to(&mut self, wall: &[Vector; 4], sign: f64) {
        let middle = [0, 1, 2].map(|k: usize| wall.iter().map(|c| c[k]).sum::<f64>());
        for i in 0..4 {
            let edge = cross(wall[i], wall[(i + 1) % 4]);
            let inwards = if dot(edge, middle) < 0.0 { -sign } else { sign };
            self.clip(edge.map(|c| inwards * c));
        }
    }

    /// Its part of the cosine-weighted half space about a unit normal.
    fn share(&self, normal: Vector) -> f64 {
        let mut sum = 0.0;
        for (i, &a) in self.0.iter().enumerate() {
            let b = self.0[(i + 1) % self.0.len()];
            let edge = cross(a, b);
            let length = dot(edge, edge).sqrt();
            if length > 0.0 {
                sum += length.atan2(dot(a, b)) * dot(edge, normal) / length;
            }
        }
        (sum / TAU).abs()
    }
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
