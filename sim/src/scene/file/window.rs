//! The `[[window]]` and `[lab]` tables.
//!
//! A window covers all sights of its side and is met head on: what it does is light::window at normal incidence.

use super::tables::{LabTable, WindowMirrors, WindowTable};
use super::{MediumSource, Reader, Scene, SceneError};
use crate::light::window::Plate;
use crate::scene::library;
use crate::tracer::plate::PlateShape;
use crate::tracer::shape::Shape;

/// Largest angle between a window's normal and the line of sight in degrees: at 20° the reflectance of an uncoated
/// window is that of normal incidence to 1e-3.
const TILT_MAX_DEG: f64 = 20.0;

/// A plane window.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowSource {
    /// Material and thickness.
    pub plate: Plate,
    /// Temperature in K.
    pub temperature_k: f64,
    /// Its middle.
    pub position_m: [f64; 3],
    /// Its normal, of any length, to either side.
    pub normal: [f64; 3],
    /// Its diameter, if it has a border.
    pub diameter_m: Option<f64>,
    /// Whether the sights that it mirrors pass the medium again (far window only), instead of seeing walls.
    pub mirrors_chamber: bool,
}

/// The windows of a scene; at most one on each side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Windows {
    /// Between camera and medium.
    pub near: Option<WindowSource>,
    /// Between medium and plate.
    pub far: Option<WindowSource>,
    /// Temperature of the laboratory outside, in K.
    pub lab_temperature_k: Option<f64>,
}

impl Windows {
    /// Whether there is any window.
    pub fn any(&self) -> bool {
        self.near.is_some() || self.far.is_some()
    }
}

type Vector = [f64; 3];

fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

impl Reader<'_> {
    pub(super) fn windows(
        &self,
        tables: &[WindowTable],
        lab: Option<&LabTable>,
        scene: &Scene,
    ) -> Result<Windows, SceneError> {
        if let Some(lab) = lab {
            self.temperature("[lab]", Some(lab.temperature_k))?;
        }
        let mut windows = Windows { lab_temperature_k: lab.map(|l| l.temperature_k), ..Windows::default() };
        if tables.is_empty() {
            return Ok(windows);
        }
        if scene.band.is_none() {
            return Err(self.wrong("[window] needs a [band]: windows depend on the wavelength"));
        }
        if lab.is_none() {
            return Err(self
                .wrong("[window] needs a table [lab] with its temperature: outside the windows is the lab"));
        }
        let along = self.line_of_sight(scene)?;
        let middle = middle(scene);
        for (n, table) in tables.iter().enumerate() {
            let window = self.window(n, table, along, scene)?;
            let place = dot(sub(table.position_m, middle), along);
            if place < 0.0 && table.mirrors.is_some() {
                return Err(self.wrong_in(
                    n,
                    "[window] mirrors is for the window on the plate's side; what the near one mirrors comes with it",
                ));
            }
            let side = if place < 0.0 { &mut windows.near } else { &mut windows.far };
            if side.is_some() {
                let which = if place < 0.0 { "camera" } else { "plate" };
                return Err(self.wrong_in(
                    n,
                    format!(
                        "[window] position_m: a second window on the {which}'s side; one is traced on each"
                    ),
                ));
            }
            *side = Some(window);
        }
        if windows.far.is_some() && scene.plate.is_none() {
            return Err(self.wrong("[window] behind the medium, but there is no [plate] to see through it"));
        }
        Ok(windows)
    }

    /// Direction from the camera to the plate.
    fn line_of_sight(&self, scene: &Scene) -> Result<Vector, SceneError> {
        let towards = match (&scene.camera, &scene.plate) {
            (Some(camera), _) => sub(camera.look_at_m, camera.position_m),
            (None, Some(plate)) => {
                let (PlateShape::Rectangle { facing, .. }
                | PlateShape::Disc { facing, .. }
                | PlateShape::Cone { facing, .. }) = plate.shape;
                facing.map(|c| -c)
            }
            (None, None) => {
                return Err(self.wrong("[window] needs a [camera] or a [plate]: its side cannot be told"));
            }
        };
        Ok(towards.map(|c| c / length(towards)))
    }

    fn window(
        &self,
        n: usize,
        table: &WindowTable,
        along: Vector,
        scene: &Scene,
    ) -> Result<WindowSource, SceneError> {
        let material = library::material(&table.material, self.folder)
            .map_err(|error| self.wrong_in(n, format!("[window] material: {error}")))?;
        if !(table.thickness_m >= 0.0 && table.thickness_m.is_finite()) {
            return Err(self.wrong_in(n, "[window] thickness_m must be finite and not negative"));
        }
        if !(table.temperature_k >= 0.0 && table.temperature_k.is_finite()) {
            return Err(self.wrong_in(n, "[window] temperature_k must be finite and not negative"));
        }
        if table.diameter_m.is_some_and(|d| d.is_nan() || d <= 0.0) {
            return Err(self.wrong_in(n, "[window] diameter_m must be positive"));
        }
        let cosine = dot(table.normal, along).abs() / length(table.normal);
        if cosine.is_nan() || cosine < TILT_MAX_DEG.to_radians().cos() {
            return Err(self.wrong_in(
                n,
                format!(
                    "[window] normal is more than {TILT_MAX_DEG}° away from the line of sight; only windows that \
                     are met head on are traced"
                ),
            ));
        }
        if let Some(camera) = &scene.camera {
            let distance = dot(sub(table.position_m, camera.position_m), along);
            if distance <= 0.0 {
                return Err(self.wrong_in(n, "[window] position_m is behind the camera"));
            }
            if let Some(PlateShape::Rectangle { centre_m, .. } | PlateShape::Disc { centre_m, .. }) =
                scene.plate.as_ref().map(|p| &p.shape)
                && dot(sub(*centre_m, table.position_m), along) <= 0.0
            {
                return Err(self.wrong_in(n, "[window] position_m is behind the plate"));
            }
            self.covers(n, table, along, scene)?;
        }
        Ok(WindowSource {
            plate: Plate { material, thickness_m: table.thickness_m },
            temperature_k: table.temperature_k,
            position_m: table.position_m,
            normal: table.normal,
            diameter_m: table.diameter_m,
            mirrors_chamber: table.mirrors == Some(WindowMirrors::Chamber),
        })
    }

    /// A window on the camera's side must be met by the sights of all corners of the image.
    #[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
    fn covers(&self, n: usize, table: &WindowTable, along: Vector, scene: &Scene) -> Result<(), SceneError> {
        let (Some(camera), Some(diameter_m)) = (&scene.camera, table.diameter_m) else { return Ok(()) };
        if dot(sub(table.position_m, middle(scene)), along) >= 0.0 {
            return Ok(());
        }
        let sights = camera.sights().map_err(|e| self.wrong(format!("[camera] {e}")))?;
        for row in [0, camera.rows] {
            for column in [0, camera.columns] {
                let (origin, direction) = sights.ray(row as f64, column as f64);
                let distance =
                    dot(sub(table.position_m, origin), table.normal) / dot(direction, table.normal);
                let met = [0, 1, 2].map(|a| origin[a] + distance * direction[a]);
                if length(sub(met, table.position_m)) > 0.5 * diameter_m {
                    return Err(self.wrong_in(
                        n,
                        "[window] diameter_m: the corners of the image look past this window; only windows \
                         that cover all sights are traced",
                    ));
                }
            }
        }
        Ok(())
    }
}

/// The middle of the medium, from which a window is near or far; that of the picture where the medium has none.
fn middle(scene: &Scene) -> Vector {
    let halfway = |a: Vector, b: Vector| [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]));
    match &scene.medium {
        Some(MediumSource::Shape(medium, _)) => match &medium.shape {
            Shape::Slab { .. } => [0.0; 3],
            Shape::Sphere { centre_m, .. }
            | Shape::Cylinder { centre_m, .. }
            | Shape::Gaussian { centre_m, .. } => *centre_m,
            Shape::Cuboid { lower_m, upper_m, .. } => halfway(*lower_m, *upper_m),
        },
        Some(MediumSource::Grid(grid, _) | MediumSource::Spectral(grid, _)) => {
            halfway(grid.lower_m, grid.upper_m)
        }
        Some(MediumSource::Cfd(_) | MediumSource::Parametric(_)) | None => {
            scene.camera.as_ref().map_or([0.0; 3], |c| c.look_at_m)
        }
    }
}
