//! Where the spray is put in the scene: injector tip and axis of the CFD mesh onto those of the scene.

use super::super::field::Parcel;
use super::super::import::SceneError;
use super::slopes::GasPiece;

/// Parts along each edge into which a cell is cut when it is turned out of the axes.
const PARTS: usize = 3;

/// A rigid motion from the coordinates of the CFD mesh to those of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    rotation: [[f64; 3]; 3],
    from_m: [f64; 3],
    to_m: [f64; 3],
}

/// What is to be moved where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Move {
    /// Injector tip in the CFD mesh, in metres.
    pub tip_m: [f64; 3],
    /// Spray axis in the CFD mesh, away from the injector; any length but zero.
    pub axis: [f64; 3],
    /// Injector tip in the scene, in metres.
    pub scene_tip_m: [f64; 3],
    /// Spray axis in the scene; any length but zero.
    pub scene_axis: [f64; 3],
    /// Turn about the axis in the scene, right-handed, in radians; it comes last.
    pub turn_rad: f64,
}

/// A spray that is one of several equal sectors about an axis, as vessels with cyclic walls are computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sectors {
    /// How many sectors make the whole; at least 1.
    pub number: u32,
    /// A place on the axis in the CFD mesh, in metres.
    pub tip_m: [f64; 3],
    /// Direction of the axis in the CFD mesh; any length but zero.
    pub axis: [f64; 3],
}

/// Sectors at most: no injector has as many holes.
const SECTORS_MAX: u32 = 64;

impl Sectors {
    /// The turns that make the whole of one sector, the first of them none.
    pub(super) fn turns(&self) -> Result<Vec<Placement>, SceneError> {
        if !(1..=SECTORS_MAX).contains(&self.number) {
            return Err(refuse(&format!("{} sectors are not between 1 and {SECTORS_MAX}", self.number)));
        }
        (0..self.number)
            .map(|turn| {
                Placement::new(Move {
                    tip_m: self.tip_m,
                    axis: self.axis,
                    scene_tip_m: self.tip_m,
                    scene_axis: self.axis,
                    turn_rad: std::f64::consts::TAU * f64::from(turn) / f64::from(self.number),
                })
            })
            .collect()
    }
}

impl Placement {
    /// The shortest turn that brings the axes together, then the turn about the axis, tip onto tip.
    ///
    /// Axes that point against each other are turned about x, or about y if they lie along x.
    ///
    /// # Errors
    ///
    /// [`SceneError::Deposit`] for an axis of length zero or a number that is not finite.
    pub fn new(wanted: Move) -> Result<Self, SceneError> {
        let from = unit(wanted.axis)?;
        let to = unit(wanted.scene_axis)?;
        if !wanted.tip_m.iter().chain(&wanted.scene_tip_m).chain([&wanted.turn_rad]).all(|v| v.is_finite()) {
            return Err(refuse("a tip or turn is not finite"));
        }
        let normal = cross(from, to);
        let cosine = dot(from, to);
        let sine = dot(normal, normal).sqrt();
        let bring = if sine < 1e-12 {
            if cosine > 0.0 { rotation([0.0, 0.0, 1.0], 0.0, 1.0) } else { half_turn(from) }
        } else {
            rotation(normal.map(|v| v / sine), sine, cosine)
        };
        let turn = rotation(to, wanted.turn_rad.sin(), wanted.turn_rad.cos());
        let mut product = multiply(turn, bring);
        // Quarter turns are meant exactly: then boxes stay boxes.
        if product.iter().flatten().all(|v| (v - v.round()).abs() < 1e-12) {
            product = product.map(|row| row.map(f64::round));
        }
        Ok(Self { rotation: product, from_m: wanted.tip_m, to_m: wanted.scene_tip_m })
    }

    /// A point of the CFD mesh in the scene, in metres.
    pub fn point(&self, point_m: [f64; 3]) -> [f64; 3] {
        let arm: [f64; 3] = std::array::from_fn(|a| point_m[a] - self.from_m[a]);
        std::array::from_fn(|a| self.to_m[a] + dot(self.rotation[a], arm))
    }

    /// True if boxes of the mesh are boxes of the scene.
    pub fn keeps_boxes(&self) -> bool {
        self.rotation.iter().flatten().all(|v| v.abs() < 1e-12 || (v.abs() - 1.0).abs() < 1e-12)
    }

    /// Parcels in the scene.
    pub(super) fn parcels(&self, parcels: &[Parcel]) -> Vec<Parcel> {
        parcels.iter().map(|p| Parcel { position_m: self.point(p.position_m), ..*p }).collect()
    }

    /// Gas in the scene. Pieces that stay boxes are moved exactly; others with vapour are cut into 27 cubes of the same
    /// volume in all, the rest become one cube.
    pub(super) fn pieces(&self, pieces: &[GasPiece]) -> Vec<GasPiece> {
        if self.keeps_boxes() {
            let turned = |slope: [f64; 3]| std::array::from_fn(|a| dot(self.rotation[a], slope));
            return pieces
                .iter()
                .map(|piece| {
                    let [lower_m, upper_m] = self.moved_box(piece.lower_m, piece.upper_m);
                    GasPiece {
                        lower_m,
                        upper_m,
                        temperature_slope: turned(piece.temperature_slope),
                        vapour_slope: turned(piece.vapour_slope),
                        ..*piece
                    }
                })
                .collect();
        }
        pieces
            .iter()
            .flat_map(|piece| self.cubes(piece, if piece.vapour_mol_m3 > 0.0 { PARTS } else { 1 }))
            .collect()
    }

    /// The walls in the scene; `None` where they do not lie along the axes.
    pub(super) fn walls(&self, [lower, upper]: [[f64; 3]; 2]) -> Option<[[f64; 3]; 2]> {
        self.keeps_boxes().then(|| self.moved_box(lower, upper))
    }

    fn moved_box(&self, lower: [f64; 3], upper: [f64; 3]) -> [[f64; 3]; 2] {
        let (a, b) = (self.point(lower), self.point(upper));
        [std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i]))]
    }

    /// Parts at places that lie evenly about the centre, so that the planes keep their means.
    fn cubes(&self, piece: &GasPiece, parts: usize) -> Vec<GasPiece> {
        let step: [f64; 3] = std::array::from_fn(|a| (piece.upper_m[a] - piece.lower_m[a]) / parts as f64);
        let half = 0.5 * step.iter().product::<f64>().cbrt();
        (0..parts.pow(3))
            .map(|i| {
                let at = [i / (parts * parts), i / parts % parts, i % parts];
                let off: [f64; 3] =
                    std::array::from_fn(|a| (at[a] as f64 + 0.5 - 0.5 * parts as f64) * step[a]);
                let centre =
                    self.point(std::array::from_fn(|a| 0.5 * (piece.lower_m[a] + piece.upper_m[a]) + off[a]));
                GasPiece {
                    lower_m: centre.map(|c| c - half),
                    upper_m: centre.map(|c| c + half),
                    density_kg_m3: piece.density_kg_m3,
                    temperature_k: piece.temperature_k + dot(piece.temperature_slope, off),
                    temperature_slope: [0.0; 3],
                    vapour_mol_m3: (piece.vapour_mol_m3 + dot(piece.vapour_slope, off)).max(0.0),
                    vapour_slope: [0.0; 3],
                }
            })
            .collect()
    }
}

fn refuse(why: &str) -> SceneError {
    SceneError::Deposit { why: why.into(), hint: "Check tip, axis and turn of the spray".into() }
}

fn unit(axis: [f64; 3]) -> Result<[f64; 3], SceneError> {
    let length = dot(axis, axis).sqrt();
    if length.is_finite() && length > 0.0 {
        Ok(axis.map(|v| v / length))
    } else {
        Err(refuse("an axis has no length"))
    }
}

fn half_turn(axis: [f64; 3]) -> [[f64; 3]; 3] {
    let about = if axis[0].abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let along = dot(about, axis);
    let flat: [f64; 3] = std::array::from_fn(|a| about[a] - along * axis[a]);
    let length = dot(flat, flat).sqrt();
    rotation(flat.map(|v| v / length), 0.0, -1.0)
}

/// Rodrigues' rotation about a unit axis.
fn rotation(axis: [f64; 3], sine: f64, cosine: f64) -> [[f64; 3]; 3] {
    let [x, y, z] = axis;
    let t = 1.0 - cosine;
    [
        [t * x * x + cosine, t * x * y - sine * z, t * x * z + sine * y],
        [t * x * y + sine * z, t * y * y + cosine, t * y * z - sine * x],
        [t * x * z - sine * y, t * y * z + sine * x, t * z * z + cosine],
    ]
}

fn multiply(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moved(axis: [f64; 3], scene_axis: [f64; 3], turn_rad: f64) -> Placement {
        let tip_m = [0.0, 0.0715, 0.0];
        Placement::new(Move { tip_m, axis, scene_tip_m: [0.0, 0.0, 0.01], scene_axis, turn_rad }).unwrap()
    }

    #[test]
    fn the_tip_goes_to_the_tip_and_the_axis_to_the_axis() {
        for (axis, scene_axis) in [
            ([0.0, -1.0, 0.0], [0.0, 0.0, -1.0]),
            ([0.0, 1.0, 0.0], [0.0, -2.0, 0.0]),
            ([3.0, 0.0, 0.0], [-1.0, 0.0, 0.0]),
            ([1.0, 2.0, 3.0], [0.3, -0.2, 0.5]),
        ] {
            let placement = moved(axis, scene_axis, 0.4);
            let tip = placement.point([0.0, 0.0715, 0.0]);
            assert!(tip.iter().zip([0.0, 0.0, 0.01]).all(|(a, b)| (a - b).abs() < 1e-15), "{tip:?}");
            let from = unit(axis).unwrap();
            let to = unit(scene_axis).unwrap();
            let end = placement.point([from[0], 0.0715 + from[1], from[2]]);
            for a in 0..3 {
                assert!((end[a] - tip[a] - to[a]).abs() < 1e-14, "{axis:?} to {scene_axis:?}: {end:?}");
            }
        }
    }

    #[test]
    fn sectors_come_round_and_the_first_stays() {
        let sectors = Sectors { number: 8, tip_m: [0.0, 0.001, 0.0], axis: [0.0, 0.0, -2.0] };
        let turns = sectors.turns().unwrap();
        let place = [0.01, 0.001, -0.02];
        for (number, turn) in (0_u32..).zip(&turns) {
            let angle = -std::f64::consts::FRAC_PI_4 * f64::from(number);
            let expected = [0.01 * angle.cos(), 0.001 + 0.01 * angle.sin(), -0.02];
            let found = turn.point(place);
            assert!((0..3).all(|a| (found[a] - expected[a]).abs() < 1e-15), "{found:?} {expected:?}");
        }
        for number in [0, 65] {
            assert!(Sectors { number, ..sectors }.turns().is_err());
        }
    }

    #[test]
    fn quarter_turns_keep_boxes_and_others_do_not() {
        let quarter = std::f64::consts::FRAC_PI_2;
        assert!(moved([0.0, -1.0, 0.0], [0.0, 0.0, -1.0], quarter).keeps_boxes());
        assert!(!moved([0.0, -1.0, 0.0], [0.0, 0.0, -1.0], 0.3).keeps_boxes());
        assert!(
            Placement::new(Move {
                tip_m: [0.0; 3],
                axis: [0.0; 3],
                scene_tip_m: [0.0; 3],
                scene_axis: [0.0, 0.0, -1.0],
                turn_rad: 0.0
            })
            .is_err()
        );
    }
}
