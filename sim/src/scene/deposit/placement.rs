//! Where the spray is put in the scene: injector tip and axis of the CFD mesh onto those of the scene.

use super::super::field::{CfdSpray, GasCell};
use super::super::import::SceneError;

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

    /// The spray in the scene. Cells that stay boxes are moved exactly; others with more than
    /// `vapour_min_mol_m3` of vapour are cut into 27 cubes of the same volume in all, the rest become one cube,
    /// and the walls are forgotten.
    pub(super) fn apply(&self, spray: &CfdSpray, vapour_min_mol_m3: f64) -> CfdSpray {
        let mut placed = spray.clone();
        for parcel in placed.parcels.iter_mut().flatten() {
            parcel.position_m = self.point(parcel.position_m);
        }
        if self.keeps_boxes() {
            for cell in placed.cells.iter_mut().flatten() {
                [cell.lower_m, cell.upper_m] = self.moved_box(cell.lower_m, cell.upper_m);
            }
            placed.domain_m = spray.domain_m.map(|[lower, upper]| self.moved_box(lower, upper));
            return placed;
        }
        placed.domain_m = None;
        placed.cells = spray.cells.as_ref().map(|cells| {
            cells
                .iter()
                .flat_map(|cell| {
                    let moles = cell.density_kg_m3 * cell.fuel_mass_fraction / spray.fuel_molar_mass_kg_mol;
                    self.cubes(cell, if moles > vapour_min_mol_m3 { PARTS } else { 1 })
                })
                .collect()
        });
        placed
    }

    fn moved_box(&self, lower: [f64; 3], upper: [f64; 3]) -> [[f64; 3]; 2] {
        let (a, b) = (self.point(lower), self.point(upper));
        [std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i]))]
    }

    fn cubes(&self, cell: &GasCell, parts: usize) -> Vec<GasCell> {
        let step: [f64; 3] = std::array::from_fn(|a| (cell.upper_m[a] - cell.lower_m[a]) / parts as f64);
        let half = 0.5 * step.iter().product::<f64>().cbrt();
        (0..parts.pow(3))
            .map(|i| {
                let at = [i / (parts * parts), i / parts % parts, i % parts];
                let centre =
                    self.point(std::array::from_fn(|a| cell.lower_m[a] + (at[a] as f64 + 0.5) * step[a]));
                GasCell { lower_m: centre.map(|c| c - half), upper_m: centre.map(|c| c + half), ..*cell }
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
