//! The `[medium]` tables: analytic shapes, grids with their arrays, and what CFD and parametric sprays are made of.

use super::band::BandSource;
use super::parametric::ParametricSource;
use super::phase::thin;
use super::tables::{GridTable, MediumTable, NumberOrFile};
use super::{Reader, SceneError, npy};
use crate::light::band::Band;
use crate::scene::compact;
use crate::scene::spray::description::{Injector, SpraySource};
use crate::tracer::medium::{EMPTY, GridMedium};
use crate::tracer::shape::{Body, Shape, ShapeMedium};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The medium of a scene.
#[derive(Debug, Clone)]
pub enum MediumSource {
    /// An analytic shape with its temperature.
    Shape(ShapeMedium, Option<f64>),
    /// A grid with one group and two channels: 1, and the radiance of the band at the cells' temperatures (zero where none is given).
    Grid(Box<GridMedium>, bool),
    /// A CFD spray, still to be imported.
    Cfd(CfdSource),
    /// A parametric spray, still to be made.
    Parametric(Box<ParametricSource>),
    /// A grid with one group per sample of the band, and two channels: 1, and the radiance per µm of liquid and
    /// vapour at their own temperatures.
    Spectral(Box<GridMedium>, Band),
}

/// A CFD spray as the scene names it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CfdSource {
    /// File or folder, relative to the scene file until read, absolute or relative to the working folder after.
    pub path: PathBuf,
    /// Whether `path` names the spray that is part of the program, there being no such file.
    #[serde(skip)]
    pub embedded: bool,
    /// The scene file, for messages.
    #[serde(skip)]
    pub scene: PathBuf,
    /// The time wanted, in seconds; the last one if not given.
    #[serde(default)]
    pub time_s: Option<f64>,
    /// Name of a shipped fuel, or the path of a fuel of the user's own (`.toml`), relative to the scene file.
    pub fuel: String,
    /// Place of the injector's tip in the CFD's coordinates.
    #[serde(default)]
    pub tip_m: Option<[f64; 3]>,
    /// Direction of the spray's axis in the CFD's coordinates.
    #[serde(default)]
    pub axis: Option<[f64; 3]>,
    /// Place of the tip in the scene; the origin if another place is given but not this.
    #[serde(default)]
    pub scene_tip_m: Option<[f64; 3]>,
    /// Direction of the axis in the scene; −z if `axis` is given but not this.
    #[serde(default)]
    pub scene_axis: Option<[f64; 3]>,
    /// Turn about the axis in the scene, right-handed, in degrees.
    #[serde(default)]
    pub turn_deg: f64,
    /// Edge of the tracer's cells; that of the CFD's cells where the vapour is if not given.
    #[serde(default)]
    pub cell_m: Option<f64>,
    /// How many turned copies about the spray's axis make the whole: for a CFD of one sector of a symmetric spray.
    #[serde(default = "one")]
    pub sectors: u32,
    /// Length in metres of the unit of length in the CFD's files: 0.001 for millimetres.
    #[serde(default = "one_metre")]
    pub length_unit_m: f64,
    /// Name of the fuel's mass fraction in the CFD's files; the only one that is a fuel if not given.
    #[serde(default)]
    pub fuel_field: Option<String>,
    /// Half angle in degrees of the cone within which scattered light counts as unscattered; none if not given.
    #[serde(default)]
    pub truncate_deg: Option<f64>,
}

fn one() -> u32 {
    1
}

fn one_metre() -> f64 {
    1.0
}

impl Reader<'_> {
    pub(super) fn medium(
        &self,
        table: MediumTable,
        band: Option<&BandSource>,
        notes: &mut Vec<String>,
    ) -> Result<MediumSource, SceneError> {
        let (shape, albedo, temperature_k, phase) = match table {
            MediumTable::Grid(table) => return self.grid(&table, band, notes),
            MediumTable::Cfd(mut source) => {
                let path = self.folder.join(&source.path);
                source.embedded = !path.exists() && source.path == Path::new(compact::SHIPPED);
                source.path = path;
                source.scene = self.path.to_owned();
                return Ok(MediumSource::Cfd(source));
            }
            MediumTable::MultiHole(t) => return self.parametric(t.with_injector(Injector::MultiHole)),
            MediumTable::HollowCone(t) => return self.parametric(t.with_injector(Injector::HollowCone)),
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
        let medium = self.scattering(&phase, notes)?.shape(shape, albedo);
        Body::shape(&medium).map_err(|e| self.wrong(format!("[medium] {e}")))?;
        Ok(MediumSource::Shape(medium, temperature_k))
    }

    fn parametric(&self, spray: SpraySource<Injector>) -> Result<MediumSource, SceneError> {
        spray.check().map_err(|problem| self.wrong(problem))?;
        Ok(MediumSource::Parametric(Box::new(ParametricSource { spray, scene: self.path.to_owned() })))
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
        band: Option<&BandSource>,
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
        let scattering = self.scattering(&table.phase, notes)?;
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
            phase: vec![scattering.phase],
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
        if let Some(cut) = scattering.truncation {
            thin(&mut medium, &[cut]);
        }
        Ok(MediumSource::Grid(Box::new(medium), temperature.is_some()))
    }

    /// Several grids over the same cells with the same phase function become one; other mixtures are refused.
    pub(super) fn superpose(&self, media: Vec<MediumSource>) -> Result<Option<MediumSource>, SceneError> {
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
