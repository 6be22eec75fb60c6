//! The scene file: TOML text and the arrays beside it, read into a typed scene.
//!
//! Reads files and checks meaning; it traces nothing. Lengths in metres, temperatures in kelvin.

pub mod npy;

use crate::light::phase::{PhaseFunction, PhaseTable};
use crate::tracer::camera::{Camera, PixelFilter, Projection};
use crate::tracer::medium::{EMPTY, GridMedium};
use crate::tracer::plate::{Plate, PlateShape};
use crate::tracer::shape::{Body, Shape, ShapeMedium};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The newest version of the format that this program reads.
pub const SCHEMA: u32 = 1;

/// Why a scene cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file cannot be read.
    #[error("scene: reading {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not a scene; the message shows line and place.
    #[error("scene {path}: {source}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, place, and what was expected.
        source: Box<toml::de::Error>,
    },
    /// An array or table beside the scene is wrong.
    #[error("scene: {path}: {problem}")]
    Array {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The values do not make sense together.
    #[error("scene {path}: {problem}")]
    Meaning {
        /// The scene file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
}

/// A scene, read and checked.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The camera; none in scenes for single rays.
    pub camera: Option<Camera>,
    /// The black-body plate, if any.
    pub plate: Option<PlateSource>,
    /// Everything else inside the chamber.
    pub walls: Option<WallSource>,
    /// The spectral band of radiances, if given.
    pub band: Option<Band>,
    /// The medium; none where the scene is empty.
    pub medium: Option<MediumSource>,
    /// What was changed while reading, for the user to see.
    pub notes: Vec<String>,
}

/// The plate and its light.
#[derive(Debug, Clone)]
pub struct PlateSource {
    /// Form and place.
    pub shape: PlateShape,
    /// Temperature in K, if given.
    pub temperature_k: Option<f64>,
    /// Emissivity in (0, 1]; the rest mirrors the walls.
    pub emissivity: f64,
}

/// The walls and their light.
#[derive(Debug, Clone, Copy)]
pub struct WallSource {
    /// Temperature in K.
    pub temperature_k: f64,
    /// Emissivity; inside an isothermal closed chamber it does not matter.
    pub emissivity: f64,
}

/// Where radiances are taken in the spectrum.
#[derive(Debug, Clone)]
pub enum Band {
    /// At one wavelength in µm: radiances per µm.
    Wavelength(f64),
    /// Over a response: (wavelength in µm, response), rising; radiances are integrals over it.
    Response(Vec<(f64, f64)>),
}

/// The medium of a scene.
#[derive(Debug, Clone)]
pub enum MediumSource {
    /// An analytic shape with its temperature.
    Shape(ShapeMedium, Option<f64>),
    /// A grid with one group and two channels: 1, and the radiance of the band at the cells' temperatures (zero where none is given).
    Grid(Box<GridMedium>, bool),
    /// A CFD spray, still to be imported.
    Cfd(CfdSource),
}

/// A CFD spray as the scene names it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CfdSource {
    /// File or folder, relative to the scene file until read, absolute or relative to the working folder after.
    pub path: PathBuf,
    /// The time wanted, in seconds.
    pub time_s: f64,
    /// Name of the fuel.
    pub fuel: String,
    /// Place of the injector's tip in the CFD's coordinates.
    #[serde(default)]
    pub tip_m: Option<[f64; 3]>,
    /// Direction of the spray's axis in the CFD's coordinates.
    #[serde(default)]
    pub axis: Option<[f64; 3]>,
    /// Edge of the tracer's cells.
    #[serde(default)]
    pub cell_m: Option<f64>,
}

/// Reads a scene file and the arrays it names.
///
/// # Errors
///
/// [`SceneError`] with the file, and line and place where the text is at fault.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    let text =
        std::fs::read_to_string(path).map_err(|source| SceneError::Read { path: path.to_owned(), source })?;
    let tables: SceneTables = toml::from_str(&text)
        .map_err(|source| SceneError::Parse { path: path.to_owned(), source: Box::new(source) })?;
    let reader = Reader { path, folder: path.parent().unwrap_or(Path::new("")) };
    reader.scene(tables)
}

/// Photon radiance of a black body per µm: 2c/λ⁴ / (exp(hc/λkT) − 1), exact SI constants of 2019.
fn photon_radiance(wavelength_um: f64, temperature_k: f64) -> f64 {
    let metres = wavelength_um * 1e-6;
    let x = 6.626_070_15e-34 * 299_792_458.0 / (metres * 1.380_649e-23 * temperature_k);
    if temperature_k > 0.0 { 2e-6 * 299_792_458.0 / metres.powi(4) / x.exp_m1() } else { 0.0 }
}

impl Band {
    /// Photon radiance of a black body in photons s⁻¹ m⁻² sr⁻¹, per µm at one wavelength, over a response its integral
    /// (trapezoidal between the points of the table).
    pub fn radiance(&self, temperature_k: f64) -> f64 {
        match self {
            Self::Wavelength(um) => photon_radiance(*um, temperature_k),
            Self::Response(points) => points
                .windows(2)
                .map(|w| {
                    let value = |p: (f64, f64)| p.1 * photon_radiance(p.0, temperature_k);
                    0.5 * (w[1].0 - w[0].0) * (value(w[0]) + value(w[1]))
                })
                .sum(),
        }
    }
}

/// Turns a CFD spray into a medium: the place where import, deposit and optics are joined.
///
/// # Errors
///
/// Always, until the import of sprays is connected.
pub fn cfd_medium(source: &CfdSource, _band: Option<&Band>) -> Result<GridMedium, SceneError> {
    Err(SceneError::Meaning {
        path: source.path.clone(),
        problem: "sprays from CFD cannot be rendered from a scene file yet; use kind = \"grid\"".to_owned(),
    })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneTables {
    #[serde(default)]
    schema: Option<u32>,
    camera: Option<CameraTable>,
    plate: Option<PlateTable>,
    walls: Option<WallTable>,
    lab: Option<LabTable>,
    #[serde(default)]
    window: Vec<WindowTable>,
    band: Option<BandTable>,
    #[serde(default)]
    medium: Media,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    kind: CameraKind,
    position_m: [f64; 3],
    look_at_m: [f64; 3],
    up: [f64; 3],
    columns: usize,
    rows: usize,
    horizontal_fov_deg: Option<f64>,
    width_m: Option<f64>,
    #[serde(default)]
    pixel_filter: FilterKind,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum CameraKind {
    Pinhole,
    Telecentric,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
enum FilterKind {
    #[default]
    Box,
    Centre,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlateTable {
    shape: PlateKind,
    centre_m: Option<[f64; 3]>,
    facing: [f64; 3],
    width_m: Option<f64>,
    height_m: Option<f64>,
    diameter_m: Option<f64>,
    half_angle_deg: Option<f64>,
    temperature_k: Option<f64>,
    #[serde(default = "one")]
    emissivity: f64,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum PlateKind {
    Rectangle,
    Disc,
    Cone,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WallTable {
    temperature_k: f64,
    #[serde(default = "one")]
    emissivity: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read so that a scene with windows gets one clear answer")]
struct LabTable {
    temperature_k: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read so that a scene with windows gets one clear answer")]
struct WindowTable {
    position_m: [f64; 3],
    normal: [f64; 3],
    material: String,
    thickness_m: f64,
    temperature_k: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BandTable {
    wavelength_um: Option<f64>,
    response: Option<PathBuf>,
    #[serde(default)]
    #[expect(dead_code, reason = "gray media need no spectral samples; accepted by the format")]
    samples: Option<toml::Value>,
}

/// `[medium]` or `[[medium]]`.
#[derive(Default)]
struct Media(Vec<MediumTable>);

impl<'de> Deserialize<'de> for Media {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = Media;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a table [medium] or tables [[medium]]")
            }
            fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Media, A::Error> {
                let table = MediumTable::deserialize(serde::de::value::MapAccessDeserializer::new(map))?;
                Ok(Media(vec![table]))
            }
            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut seq: A) -> Result<Media, A::Error> {
                let mut list = Vec::new();
                while let Some(table) = seq.next_element()? {
                    list.push(table);
                }
                Ok(Media(list))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
enum MediumTable {
    Grid(GridTable),
    Slab(SlabTable),
    Sphere(RoundTable),
    Cylinder(RoundTable),
    Gaussian(GaussianTable),
    Box(BoxTable),
    Cfd(CfdSource),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GridTable {
    extinction_npy: PathBuf,
    lower_m: [f64; 3],
    upper_m: [f64; 3],
    albedo: NumberOrFile,
    temperature_k: Option<NumberOrFile>,
    #[serde(default)]
    phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum NumberOrFile {
    Number(f64),
    File(PathBuf),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SlabTable {
    optical_depth: f64,
    thickness_m: f64,
    albedo: f64,
    temperature_k: Option<f64>,
    #[serde(default)]
    phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RoundTable {
    centre_m: [f64; 3],
    radius_m: f64,
    extinction: f64,
    axis: Option<[f64; 3]>,
    albedo: f64,
    temperature_k: Option<f64>,
    #[serde(default)]
    phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GaussianTable {
    centre_m: [f64; 3],
    width_m: f64,
    extinction: f64,
    albedo: f64,
    temperature_k: Option<f64>,
    #[serde(default)]
    phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoxTable {
    lower_m: [f64; 3],
    upper_m: [f64; 3],
    extinction: f64,
    albedo: f64,
    temperature_k: Option<f64>,
    #[serde(default)]
    phase: PhaseChoice,
}

#[derive(Deserialize, Default)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
enum PhaseChoice {
    #[default]
    Isotropic,
    HenyeyGreenstein {
        asymmetry: f64,
    },
    Table {
        file: PathBuf,
    },
}

fn one() -> f64 {
    1.0
}

struct Reader<'a> {
    path: &'a Path,
    folder: &'a Path,
}

impl Reader<'_> {
    fn wrong(&self, problem: impl Into<String>) -> SceneError {
        SceneError::Meaning { path: self.path.to_owned(), problem: problem.into() }
    }

    fn scene(&self, tables: SceneTables) -> Result<Scene, SceneError> {
        if let Some(schema) = tables.schema.filter(|&s| s == 0 || s > SCHEMA) {
            return Err(self.wrong(format!("schema {schema}; this program reads schema 1 to {SCHEMA}")));
        }
        if !tables.window.is_empty() || tables.lab.is_some() {
            return Err(self.wrong("windows are not traced yet; remove [[window]] and [lab]"));
        }
        let mut notes = Vec::new();
        let camera = tables.camera.map(|c| self.camera(&c)).transpose()?;
        let plate = tables.plate.map(|p| self.plate(&p)).transpose()?;
        let walls = tables.walls.map(|w| self.walls(&w)).transpose()?;
        let band = tables.band.map(|b| self.band(&b)).transpose()?;
        let media = tables
            .medium
            .0
            .into_iter()
            .map(|m| self.medium(m, band.as_ref(), &mut notes))
            .collect::<Result<Vec<_>, _>>()?;
        let medium = self.superpose(media)?;
        Ok(Scene { camera, plate, walls, band, medium, notes })
    }

    fn camera(&self, table: &CameraTable) -> Result<Camera, SceneError> {
        let projection = match (&table.kind, table.horizontal_fov_deg, table.width_m) {
            (CameraKind::Pinhole, Some(horizontal_fov_deg), None) => {
                Projection::Pinhole { horizontal_fov_deg }
            }
            (CameraKind::Telecentric, None, Some(width_m)) => Projection::Telecentric { width_m },
            (CameraKind::Pinhole, ..) => {
                return Err(self.wrong("[camera] kind \"pinhole\" needs horizontal_fov_deg and no width_m"));
            }
            (CameraKind::Telecentric, ..) => {
                return Err(
                    self.wrong("[camera] kind \"telecentric\" needs width_m and no horizontal_fov_deg")
                );
            }
        };
        let pixel_filter = match table.pixel_filter {
            FilterKind::Box => PixelFilter::Box,
            FilterKind::Centre => PixelFilter::Centre,
        };
        let camera = Camera {
            projection,
            position_m: table.position_m,
            look_at_m: table.look_at_m,
            up: table.up,
            columns: table.columns,
            rows: table.rows,
            pixel_filter,
        };
        camera.sights().map_err(|e| self.wrong(format!("[camera] {e}")))?;
        Ok(camera)
    }

    fn plate(&self, table: &PlateTable) -> Result<PlateSource, SceneError> {
        let facing = table.facing;
        let given = (table.centre_m, table.width_m, table.height_m, table.diameter_m, table.half_angle_deg);
        let shape = match (&table.shape, given) {
            (PlateKind::Rectangle, (Some(centre_m), Some(width_m), Some(height_m), None, None)) => {
                PlateShape::Rectangle { centre_m, facing, width_m, height_m }
            }
            (PlateKind::Disc, (Some(centre_m), None, None, Some(diameter_m), None)) => {
                PlateShape::Disc { centre_m, facing, diameter_m }
            }
            (PlateKind::Cone, (_, None, None, None, Some(half_angle_deg))) => {
                PlateShape::Cone { facing, half_angle_deg }
            }
            (PlateKind::Rectangle, _) => {
                return Err(self.wrong(
                    "[plate] shape \"rectangle\" needs exactly centre_m, facing, width_m and height_m",
                ));
            }
            (PlateKind::Disc, _) => {
                return Err(
                    self.wrong("[plate] shape \"disc\" needs exactly centre_m, facing and diameter_m")
                );
            }
            (PlateKind::Cone, _) => {
                return Err(self.wrong("[plate] shape \"cone\" needs exactly facing and half_angle_deg"));
            }
        };
        Plate::new(&shape).map_err(|e| self.wrong(format!("[plate] {e}")))?;
        self.temperature("[plate]", table.temperature_k)?;
        if !(table.emissivity > 0.0 && table.emissivity <= 1.0) {
            return Err(self.wrong("[plate] emissivity must be above 0 and at most 1"));
        }
        Ok(PlateSource { shape, temperature_k: table.temperature_k, emissivity: table.emissivity })
    }

    fn walls(&self, table: &WallTable) -> Result<WallSource, SceneError> {
        self.temperature("[walls]", Some(table.temperature_k))?;
        if !(table.emissivity > 0.0 && table.emissivity <= 1.0) {
            return Err(self.wrong("[walls] emissivity must be above 0 and at most 1"));
        }
        Ok(WallSource { temperature_k: table.temperature_k, emissivity: table.emissivity })
    }

    fn temperature(&self, what: &str, value: Option<f64>) -> Result<(), SceneError> {
        match value {
            Some(t) if !(t >= 0.0 && t.is_finite()) => {
                Err(self.wrong(format!("{what} temperature_k is {t}; it must be finite and not negative")))
            }
            _ => Ok(()),
        }
    }

    fn band(&self, table: &BandTable) -> Result<Band, SceneError> {
        match (table.wavelength_um, &table.response) {
            (Some(um), None) if um > 0.0 && um.is_finite() => Ok(Band::Wavelength(um)),
            (Some(_), None) => Err(self.wrong("[band] wavelength_um must be positive")),
            (None, Some(file)) => {
                let path = self.folder.join(file);
                let points = self.columns(&path, ["wavelength_um", "response"])?;
                let rising = points.windows(2).all(|w| w[1].0 > w[0].0);
                if points.len() < 2 || !rising || points.iter().any(|p| p.0 <= 0.0 || p.1 < 0.0) {
                    let problem =
                        "needs at least two rising positive wavelengths and no negative response".to_owned();
                    return Err(SceneError::Array { path, problem });
                }
                Ok(Band::Response(points))
            }
            _ => Err(self.wrong("[band] needs exactly one of wavelength_um and response")),
        }
    }

    /// Two columns of a CSV file with a header.
    fn columns(&self, path: &Path, names: [&str; 2]) -> Result<Vec<(f64, f64)>, SceneError> {
        let array = |problem: String| SceneError::Array { path: path.to_owned(), problem };
        let text = std::fs::read_to_string(path)
            .map_err(|source| SceneError::Read { path: path.to_owned(), source })?;
        let mut lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'));
        let (_, header) = lines.next().ok_or_else(|| array("it is empty".to_owned()))?;
        let header: Vec<&str> = header.split(',').map(str::trim).collect();
        let place = |name: &str| {
            header.iter().position(|h| *h == name).ok_or_else(|| array(format!("it has no column {name}")))
        };
        let (a, b) = (place(names[0])?, place(names[1])?);
        lines
            .map(|(line, text)| {
                let cells: Vec<&str> = text.split(',').map(str::trim).collect();
                let number = |i: usize| {
                    cells.get(i).and_then(|c| c.parse::<f64>().ok()).filter(|v| v.is_finite()).ok_or_else(
                        || array(format!("line {}: column {} is not a number", line + 1, header[i])),
                    )
                };
                Ok((number(a)?, number(b)?))
            })
            .collect()
    }

    fn phase(&self, choice: &PhaseChoice, notes: &mut Vec<String>) -> Result<PhaseFunction, SceneError> {
        match choice {
            PhaseChoice::Isotropic => Ok(PhaseFunction::Isotropic),
            PhaseChoice::HenyeyGreenstein { asymmetry } if asymmetry.abs() <= 1.0 => {
                Ok(PhaseFunction::HenyeyGreenstein { asymmetry: *asymmetry })
            }
            PhaseChoice::HenyeyGreenstein { asymmetry } => {
                Err(self.wrong(format!("phase: asymmetry {asymmetry} is outside -1 to 1")))
            }
            PhaseChoice::Table { file } => {
                let path = self.folder.join(file);
                let points = self.columns(&path, ["theta_deg", "p11"])?;
                let theta: Vec<f64> = points.iter().map(|p| p.0.to_radians()).collect();
                let p11: Vec<f64> = points.iter().map(|p| p.1).collect();
                let (table, norm) = PhaseTable::new(&theta, &p11)
                    .map_err(|e| SceneError::Array { path: path.clone(), problem: e.to_string() })?;
                notes.push(format!("{}: norm {norm:.9} found, renormalised to 1", file.display()));
                Ok(PhaseFunction::Table(Arc::new(table)))
            }
        }
    }

    fn medium(
        &self,
        table: MediumTable,
        band: Option<&Band>,
        notes: &mut Vec<String>,
    ) -> Result<MediumSource, SceneError> {
        let (shape, albedo, temperature_k, phase) = match table {
            MediumTable::Grid(table) => return self.grid(&table, band, notes),
            MediumTable::Cfd(mut source) => {
                source.path = self.folder.join(&source.path);
                return Ok(MediumSource::Cfd(source));
            }
            MediumTable::Slab(t) => {
                if t.optical_depth.is_nan() || t.optical_depth < 0.0 {
                    return Err(self.wrong("[medium] optical_depth must not be negative"));
                }
                let shape = Shape::Slab { thickness_m: t.thickness_m, optical_depth: t.optical_depth };
                (shape, t.albedo, t.temperature_k, t.phase)
            }
            MediumTable::Sphere(t) => {
                if t.axis.is_some() {
                    return Err(self.wrong("[medium] kind \"sphere\" has no axis"));
                }
                let shape =
                    Shape::Sphere { centre_m: t.centre_m, radius_m: t.radius_m, extinction: t.extinction };
                (shape, t.albedo, t.temperature_k, t.phase)
            }
            MediumTable::Cylinder(t) => {
                let axis =
                    t.axis.ok_or_else(|| self.wrong("[medium] kind \"cylinder\" needs axis = [x, y, z]"))?;
                let (centre_m, radius_m, extinction) = (t.centre_m, t.radius_m, t.extinction);
                (Shape::Cylinder { centre_m, axis, radius_m, extinction }, t.albedo, t.temperature_k, t.phase)
            }
            MediumTable::Gaussian(t) => {
                let shape =
                    Shape::Gaussian { centre_m: t.centre_m, width_m: t.width_m, extinction: t.extinction };
                (shape, t.albedo, t.temperature_k, t.phase)
            }
            MediumTable::Box(t) => {
                let shape =
                    Shape::Cuboid { lower_m: t.lower_m, upper_m: t.upper_m, extinction: t.extinction };
                (shape, t.albedo, t.temperature_k, t.phase)
            }
        };
        self.temperature("[medium]", temperature_k)?;
        let medium = ShapeMedium { shape, albedo, phase: self.phase(&phase, notes)? };
        Body::shape(&medium).map_err(|e| self.wrong(format!("[medium] {e}")))?;
        Ok(MediumSource::Shape(medium, temperature_k))
    }

    fn array(&self, file: &Path) -> Result<npy::Array, SceneError> {
        let path = self.folder.join(file);
        let bytes = std::fs::read(&path).map_err(|source| SceneError::Read { path: path.clone(), source })?;
        npy::parse(&bytes).map_err(|problem| SceneError::Array { path, problem })
    }

    /// One value per cell.
    fn field(&self, choice: &NumberOrFile, shape: &[usize]) -> Result<Vec<f64>, SceneError> {
        match choice {
            NumberOrFile::Number(value) => Ok(vec![*value; shape.iter().product()]),
            NumberOrFile::File(file) => {
                let array = self.array(file)?;
                if array.shape != shape {
                    let problem =
                        format!("its shape is {:?}, that of the extinction is {shape:?}", array.shape);
                    return Err(SceneError::Array { path: self.folder.join(file), problem });
                }
                Ok(array.values)
            }
        }
    }

    fn grid(
        &self,
        table: &GridTable,
        band: Option<&Band>,
        notes: &mut Vec<String>,
    ) -> Result<MediumSource, SceneError> {
        let extinction = self.array(&table.extinction_npy)?;
        let &[nx, ny, nz] = extinction.shape.as_slice() else {
            let problem = format!("its shape is {:?}; three axes x, y, z are needed", extinction.shape);
            return Err(SceneError::Array { path: self.folder.join(&table.extinction_npy), problem });
        };
        let albedo = self.field(&table.albedo, &extinction.shape)?;
        let temperature =
            table.temperature_k.as_ref().map(|t| self.field(t, &extinction.shape)).transpose()?;
        let mut medium = GridMedium {
            lower_m: table.lower_m,
            upper_m: table.upper_m,
            cells: [nx, ny, nz],
            groups: 1,
            channels: 2,
            index: vec![EMPTY; nx * ny * nz],
            k_ext: Vec::new(),
            k_sca: Vec::new(),
            emission: Vec::new(),
            phase: vec![self.phase(&table.phase, notes)?],
        };
        let mut radiance_at = (f64::NAN, 0.0);
        for (cell, &k) in extinction.values.iter().enumerate() {
            // Written so that a NaN is kept and refused by the check below.
            if k == 0.0 {
                continue;
            }
            if !(0.0..=1.0).contains(&albedo[cell]) {
                return Err(
                    self.wrong(format!("[medium] albedo of cell {cell} is {}, not in 0 to 1", albedo[cell]))
                );
            }
            let t = temperature.as_ref().map_or(0.0, |t| t[cell]);
            self.temperature("[medium]", Some(t))?;
            if t.to_bits() != radiance_at.0.to_bits() {
                radiance_at = (t, band.map_or(0.0, |b| b.radiance(t)));
            }
            medium.index[cell] = u32::try_from(medium.k_ext.len()).unwrap_or(EMPTY);
            medium.k_ext.push(k);
            medium.k_sca.push(albedo[cell] * k);
            let absorbed = (1.0 - albedo[cell]) * k;
            medium.emission.extend([absorbed, absorbed * radiance_at.1]);
        }
        medium.check().map_err(|e| self.wrong(format!("[medium] {e}")))?;
        Ok(MediumSource::Grid(Box::new(medium), temperature.is_some()))
    }

    /// Several grids over the same cells with the same phase function become one; other mixtures are refused.
    fn superpose(&self, media: Vec<MediumSource>) -> Result<Option<MediumSource>, SceneError> {
        let mut media = media.into_iter();
        let Some(mut sum) = media.next() else { return Ok(None) };
        for next in media {
            let (MediumSource::Grid(a, hot_a), MediumSource::Grid(b, hot_b)) = (&mut sum, &next) else {
                return Err(self.wrong("several [[medium]] can be added only when all are grids"));
            };
            let close =
                |a: [f64; 3], b: [f64; 3]| a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1e-12 * a.abs());
            if a.cells != b.cells || !close(a.lower_m, b.lower_m) || !close(a.upper_m, b.upper_m) {
                return Err(self.wrong("grids of several [[medium]] must share lower_m, upper_m and shape"));
            }
            if format!("{:?}", a.phase) != format!("{:?}", b.phase) {
                return Err(self.wrong("grids of several [[medium]] must share their phase function"));
            }
            for cell in 0..b.index.len() {
                if b.index[cell] == EMPTY {
                    continue;
                }
                let from = b.index[cell] as usize;
                if a.index[cell] == EMPTY {
                    a.index[cell] = u32::try_from(a.k_ext.len()).unwrap_or(EMPTY);
                    a.k_ext.push(0.0);
                    a.k_sca.push(0.0);
                    a.emission.extend([0.0; 2]);
                }
                let to = a.index[cell] as usize;
                a.k_ext[to] += b.k_ext[from];
                a.k_sca[to] += b.k_sca[from];
                a.emission[2 * to] += b.emission[2 * from];
                a.emission[2 * to + 1] += b.emission[2 * from + 1];
            }
            *hot_a &= *hot_b;
        }
        Ok(Some(sum))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(text: &str) -> Result<Scene, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        load(&path)
    }

    const SLAB: &str = "[medium]\nkind = \"slab\"\noptical_depth = inf\nthickness_m = 1\nalbedo = 0.5\n";

    #[test]
    fn unknown_keys_are_refused_with_their_line() {
        let error =
            scene(&format!("[walls]\ntemperature_k = 300\ncolour = 1\n{SLAB}")).unwrap_err().to_string();
        assert!(error.contains("line 3") && error.contains("colour"), "{error}");
        let error = scene(&format!("{SLAB}colour = 1\n")).unwrap_err().to_string();
        assert!(error.contains("colour"), "{error}");
    }

    #[test]
    fn one_and_several_media_are_read_and_integers_are_numbers() {
        assert!(matches!(scene(SLAB).unwrap().medium, Some(MediumSource::Shape(..))));
        let one = SLAB.replace("[medium]", "[[medium]]");
        assert!(scene(&one).unwrap().medium.is_some());
        let error = scene(&format!("{one}{one}")).unwrap_err().to_string();
        assert!(error.contains("grids"), "{error}");
        assert!(scene("schema = 1\n").unwrap().medium.is_none());
        assert!(scene("schema = 2\n").unwrap_err().to_string().contains("schema 2"));
    }

    #[test]
    fn band_radiance_is_plancks() {
        // planck_spectral.csv: exitance at 300 K and 3.4 µm, and at 500 K.
        let band = Band::Wavelength(3.4);
        for (t, exitance) in [(300.0, 1.054_573_394_580_724_5e19), (500.0, 2.975_579_254_200_778e21)] {
            assert!((band.radiance(t) * std::f64::consts::PI / exitance - 1.0).abs() < 1e-14 * 20.0);
        }
        assert!(band.radiance(0.0).abs() < f64::MIN_POSITIVE);
    }
}
