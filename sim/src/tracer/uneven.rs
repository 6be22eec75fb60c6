//! A plate that is not equally warm everywhere: how far it is from its temperature, as the sights of an image see it.
//!
//! The coefficient a_plate knows one temperature only. Beside it stand two more images, the plate's light times its
//! deviation δ in K, and times δ²: the mean and spread of the deviation in what a sight sees of the plate. The straight
//! part of a sight is weighed exactly, with δ where it meets the plate; the share of the plate that is scattered into the
//! sight is taken to see the plate's mean, which is told as an error: this share times the standard deviation of δ over
//! the plate. Knows no light.

use super::camera::Camera;
use super::error::TracerError;
use super::fine::Fine;
use super::gather::{Field, Sight};
use super::image::{GROUPS_MAX, RenderOptions};
use super::medium::GridMedium;
use super::operator::Operator;
use super::pixels::{Frame, sub_sights};
use super::plate::{Plate, PlateShape};
use super::sobol::{self, Sequence};
use super::spectrum::{One, Spectrum, Wide, narrow, vectorised};
use super::spread::SubSight;
use super::vector::Vector;
use rayon::prelude::*;

/// Sub-sights of pixels that spread over an aperture or an exposure, and per axis of those with the plate's edge.
const SPREAD_SIGHTS: u32 = 32;
const EDGE_SIGHTS: usize = 4;

/// Places per axis from which means over the plate are taken.
const MEAN_PLACES: usize = 256;

/// Names the sequence of sub-sights.
const NAME: u32 = 0x756e_6576;

/// The deviation of the plate's temperature, in K, over its face.
#[derive(Debug, Clone, PartialEq)]
pub enum Deviation {
    /// edge_k · ρ², ρ² = (x / half width)² + (y / half height)², of a disc (r / radius)²: zero in the middle, `edge_k`
    /// at the middle of the edges.
    Parabolic {
        /// Edge minus centre.
        edge_k: f64,
    },
    /// A table `[row][column]` over the rectangle, or the square around the disc: row 0 at the top, column 0 at the left
    /// as seen from the front, values at the middles of equal fields, straight between them, constant beyond the outer.
    Map {
        /// Number of rows.
        rows: usize,
        /// Number of columns.
        columns: usize,
        /// Row-major values in K.
        values: Vec<f64>,
    },
}

impl Deviation {
    /// At a place given in half widths to the right and half heights up.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        match self {
            Self::Parabolic { edge_k } => edge_k * (x * x + y * y),
            Self::Map { rows, columns, values } => {
                let split = |part: f64, n: usize| {
                    let at = (part.clamp(0.0, 1.0) * real(n) - 0.5).clamp(0.0, real(n - 1));
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "from 0 to n − 1"
                    )]
                    let low = (at as usize).min(n - 1);
                    (low, (low + 1).min(n - 1), at - real(low))
                };
                let (top, bottom, v) = split(0.5 * (1.0 - y), *rows);
                let (left, right, u) = split(0.5 * (1.0 + x), *columns);
                let line = |row: usize| {
                    let [a, b] = [left, right].map(|column| values[row * columns + column]);
                    a + u * (b - a)
                };
                let [a, b] = [line(top), line(bottom)];
                a + v * (b - a)
            }
        }
    }

    /// Means of δ and δ² over a plate.
    fn means(&self, round: bool) -> [f64; 2] {
        let (mut sum, mut count) = ([0.0; 2], 0.0);
        let place = |i: usize| (real(2 * i + 1)) / real(MEAN_PLACES) - 1.0;
        for i in 0..MEAN_PLACES {
            for j in 0..MEAN_PLACES {
                let at = [place(i), place(j)];
                if !round || at[0] * at[0] + at[1] * at[1] <= 1.0 {
                    let d = self.at(at);
                    sum = [sum[0] + d, sum[1] + d * d];
                    count += 1.0;
                }
            }
        }
        sum.map(|s| s / count)
    }
}

/// A plate with its deviation.
#[derive(Debug, Clone)]
pub struct UnevenPlate {
    plate: Plate,
    deviation: Deviation,
    means: [f64; 2],
}

impl UnevenPlate {
    /// Checks a plate and its deviation.
    ///
    /// # Errors
    ///
    /// [`TracerError`] for an impossible shape, a cone (it has no places), or values that are not finite or not as many as
    /// rows times columns.
    pub fn new(shape: &PlateShape, deviation: &Deviation) -> Result<Self, TracerError> {
        let round = match shape {
            PlateShape::Rectangle { .. } => false,
            PlateShape::Disc { .. } => true,
            PlateShape::Cone { .. } => {
                return Err(TracerError::Geometry {
                    what: "an uneven plate",
                    condition: "a rectangle or a disc",
                });
            }
        };
        let values = match deviation {
            Deviation::Parabolic { edge_k } => std::slice::from_ref(edge_k),
            Deviation::Map { rows, columns, values } => {
                let expected = rows * columns;
                if values.len() != expected || expected == 0 {
                    let what = "the plate's map";
                    return Err(TracerError::Shape { what, found: values.len(), expected: expected.max(1) });
                }
                values
            }
        };
        if !values.iter().all(|v| v.is_finite()) {
            return Err(TracerError::Geometry { what: "the plate's deviation", condition: "finite" });
        }
        Ok(Self { plate: Plate::new(shape)?, means: deviation.means(round), deviation: deviation.clone() })
    }

    /// δ in K where a ray meets the plate; none where it does not.
    pub fn seen(&self, origin: Vector, direction: Vector) -> Option<f64> {
        self.plate.hit(origin, direction)?;
        self.plate.place(origin, direction).map(|place| self.deviation.at(place))
    }

    /// What a sight sees of the plate, times δ and δ²: `straight` times them along it, and the rest of `all` of the plate's
    /// share the means.
    fn weighed(&self, all: f64, straight: f64, sums: [f64; 2]) -> [f64; 2] {
        let scattered = (all - straight).max(0.0);
        let scale = if straight > all && straight > 0.0 { all / straight } else { 1.0 };
        [0, 1].map(|k: usize| scale * sums[k] + scattered * self.means[k])
    }

    /// The same for a single ray: the plate's share, and the part of it that comes straight.
    pub fn of_ray(&self, origin: Vector, direction: Vector, all: f64, straight: f64) -> [f64; 2] {
        match self.seen(origin, direction) {
            Some(d) => self.weighed(all, straight, [straight * d, straight * d * d]),
            None => self.weighed(all, 0.0, [0.0; 2]),
        }
    }

    /// Standard deviation of δ over the plate.
    pub fn spread_k(&self) -> f64 {
        (self.means[1] - self.means[0] * self.means[0]).max(0.0).sqrt()
    }
}

/// The plate's light times δ and δ², in K and K².
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Excess {
    /// Without the medium, `[pixel]`.
    pub seen: Vec<[f32; 2]>,
    /// With it, `[active pixel][group]` of the operator.
    pub active: Vec<[f32; 2]>,
    /// What taking the mean for the scattered part may err, in K times its share: rms over active pixels and groups.
    pub error_k: f64,
}

/// How an operator's pixels see an uneven plate.
///
/// # Errors
///
/// [`TracerError`] for a medium or camera that makes no sense, or an operator that is not of them.
pub fn excess(
    medium: &GridMedium,
    camera: &Camera,
    plate: &UnevenPlate,
    options: &RenderOptions,
    operator: &Operator,
) -> Result<Excess, TracerError> {
    medium.check()?;
    options.check_motion()?;
    let sights = camera.sights()?;
    let expected = camera.rows * camera.columns;
    if operator.plate_seen.len() != expected || operator.groups != medium.groups {
        return Err(TracerError::Shape { what: "the operator", found: operator.plate_seen.len(), expected });
    }
    let frame = Frame { camera, sights: &sights, plate: Some(&plate.plate), motion: options.motion_m };
    let view = View { frame, plate, seed: options.seed };
    match medium.groups {
        1 => Ok(view.excess::<One>(medium, operator)),
        2..=16 => Ok(view.excess::<[Wide; 1]>(medium, operator)),
        17..=64 => Ok(view.excess::<[Wide; 4]>(medium, operator)),
        groups => Err(TracerError::Groups { groups, limit: GROUPS_MAX }),
    }
}

struct View<'a> {
    frame: Frame<'a>,
    plate: &'a UnevenPlate,
    seed: u64,
}

impl View<'_> {
    fn sights(&self, pixel: usize, seen: f32) -> Vec<SubSight> {
        let columns = self.frame.camera.columns;
        let (row, column) = (pixel / columns, pixel % columns);
        if self.frame.spreads() {
            #[expect(clippy::cast_possible_truncation, reason = "images are smaller than 2^32")]
            let sequence = Sequence::new(sobol::sequence(self.seed, pixel as u32, NAME));
            let mut run = sequence.from(0);
            return (0..SPREAD_SIGHTS)
                .map(|_| {
                    let at = run.next();
                    self.frame.sub_sight(row, column, [0, 1, 2, 3, 4].map(|d: usize| at.get(d)))
                })
                .collect();
        }
        let n = if seen > 0.0 && seen < 1.0 { EDGE_SIGHTS } else { 1 };
        sub_sights(row, column, n)
            .map(|(r, c)| SubSight { ray: self.frame.sights.ray(r, c), moved: [0.0; 3] })
            .collect()
    }

    fn excess<S: Spectrum>(&self, medium: &GridMedium, operator: &Operator) -> Excess {
        let seen: Vec<[f32; 2]> = operator
            .plate_seen
            .par_iter()
            .enumerate()
            .with_min_len(256)
            .map(|(pixel, &share)| {
                if share <= 0.0 {
                    return [0.0; 2];
                }
                let found: Vec<f64> = self
                    .sights(pixel, share)
                    .iter()
                    .filter_map(|sub| self.plate.seen(sub.ray.0, sub.ray.1))
                    .collect();
                // A plate so small that no sight met it: its mean.
                let n = real(found.len());
                let mean = |power: i32| found.iter().map(|d| d.powi(power)).sum::<f64>() / n;
                let means = if found.is_empty() { self.plate.means } else { [mean(1), mean(2)] };
                means.map(|m| narrow(f64::from(share) * m))
            })
            .collect();
        let fine = Fine::<S>::new(medium, 1);
        let field = Field { fine: &fine, plate: self.frame.plate, chamber: None, light: None };
        let groups = operator.groups;
        let pixels: Vec<(Vec<[f32; 2]>, f64)> = operator
            .pixels
            .par_iter()
            .enumerate()
            .with_min_len(16)
            .map(|(i, &pixel)| {
                let subs = self.sights(pixel as usize, operator.plate_seen[pixel as usize]);
                let mut sums = vec![[0.0_f64; 3]; groups];
                vectorised(
                    #[inline(always)]
                    || {
                        for sub in &subs {
                            let Some(d) = self.plate.seen(sub.ray.0, sub.ray.1) else { continue };
                            let mut sight = Sight::<S>::new(fine.channels, false);
                            sight.add_moved::<false>(&field, sub.ray, sub.moved, 1.0);
                            for (g, sum) in sums.iter_mut().enumerate() {
                                let through = f64::from(sight.plate.get(g)) / real(subs.len());
                                *sum = [sum[0] + through, sum[1] + through * d, sum[2] + through * d * d];
                            }
                        }
                    },
                );
                let mut square = 0.0;
                let out = sums
                    .iter()
                    .enumerate()
                    .map(|(g, &[straight, first, second])| {
                        let all = f64::from(operator.a_plate[i * groups + g]);
                        square += (all - straight).max(0.0).powi(2);
                        self.plate.weighed(all, straight, [first, second]).map(narrow)
                    })
                    .collect();
                (out, square)
            })
            .collect();
        let square: f64 = pixels.iter().map(|p| p.1).sum();
        let error_k = self.plate.spread_k() * (square / real((pixels.len() * groups).max(1))).sqrt();
        Excess { seen, active: pixels.into_iter().flat_map(|p| p.0).collect(), error_k }
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const DISC: PlateShape =
        PlateShape::Disc { centre_m: [0.0, 1.0, 0.0], facing: [0.0, -1.0, 0.0], diameter_m: 0.2 };

    /// Means of ρ² and ρ⁴ are 1/2 and 1/3 over a disc, 2/3 and 28/45 over a rectangle; the midpoints err by the border's
    /// cells at most.
    #[test]
    fn means_are_those_of_the_parabola() {
        let parabola = Deviation::Parabolic { edge_k: 2.0 };
        let [one, two] = parabola.means(true);
        assert!((one - 1.0).abs() < 1e-3 && (two - 4.0 / 3.0).abs() < 4e-3, "{one} {two}");
        let [one, two] = parabola.means(false);
        assert!((one - 4.0 / 3.0).abs() < 1e-4 && (two - 4.0 * 28.0 / 45.0).abs() < 1e-3, "{one} {two}");
    }

    #[test]
    fn places_are_seen_from_the_front() {
        // Top left hot, as the camera on the −y side sees it with z up: −x, +z.
        let map = Deviation::Map { rows: 2, columns: 3, values: vec![7.0, 0.0, 0.0, 0.0, 0.0, -1.0] };
        let plate = UnevenPlate::new(&DISC, &map).unwrap();
        let seen = |x: f64, z: f64| plate.seen([x, -1.0, z], [0.0, 1.0, 0.0]);
        assert!((seen(-0.07, 0.06).unwrap() - 7.0).abs() < 1e-12);
        assert!((seen(0.07, -0.06).unwrap() + 1.0).abs() < 1e-12);
        // Straight between the middles of the fields.
        assert!((seen(-1.0 / 30.0, 0.05).unwrap() - 3.5).abs() < 1e-9);
        assert_eq!(seen(0.2, 0.0), None);
    }

    #[test]
    fn impossible_deviations_are_refused() {
        let cone = PlateShape::Cone { facing: [0.0, -1.0, 0.0], half_angle_deg: 10.0 };
        let bad = |shape: &PlateShape, d: Deviation| assert!(UnevenPlate::new(shape, &d).is_err(), "{d:?}");
        bad(&cone, Deviation::Parabolic { edge_k: 1.0 });
        bad(&DISC, Deviation::Parabolic { edge_k: f64::NAN });
        bad(&DISC, Deviation::Map { rows: 2, columns: 2, values: vec![0.0; 3] });
        bad(&DISC, Deviation::Map { rows: 0, columns: 2, values: Vec::new() });
    }
}
