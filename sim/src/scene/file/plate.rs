//! The `[plate]` table.

use super::tables::{NumberOrFile, PlateKind, PlateMirrors, PlateTable};
use super::{Reader, SceneError, npy};
use crate::light::table::interpolate;
use crate::tracer::plate::{Plate, PlateShape};
use crate::tracer::uneven::{Deviation, UnevenPlate};
use std::path::Path;

/// The plate and its light.
#[derive(Debug, Clone)]
pub struct PlateSource {
    /// Form and place.
    pub shape: PlateShape,
    /// Temperature in K, if given.
    pub temperature_k: Option<f64>,
    /// Temperatures in K of which images are wanted besides; without `temperature_k` the first one stands for it.
    pub temperatures_k: Vec<f64>,
    /// Emissivity; the rest mirrors what is in front of the plate.
    pub emissivity: Emissivity,
    /// What the plate mirrors; none: the laboratory behind a far window, else the walls.
    pub mirrors: Option<PlateMirrors>,
    /// How its temperature differs over its face; none: it does not.
    pub deviation: Option<Deviation>,
}

/// The emissivity of the plate, in (0, 1].
#[derive(Debug, Clone, PartialEq)]
pub enum Emissivity {
    /// The same everywhere.
    Gray(f64),
    /// Over the wavelength in µm, ascending; straight between the points, constant beyond them.
    Spectral {
        /// Wavelengths in µm.
        wavelengths_um: Vec<f64>,
        /// Emissivities there.
        values: Vec<f64>,
    },
}

impl Emissivity {
    /// At a wavelength in µm.
    pub fn at(&self, um: f64) -> f64 {
        match self {
            Self::Gray(value) => *value,
            Self::Spectral { wavelengths_um, values } => {
                let last = wavelengths_um.len() - 1;
                interpolate(wavelengths_um, values, um.clamp(wavelengths_um[0], wavelengths_um[last]))
            }
        }
    }
}

impl Reader<'_> {
    pub(super) fn plate(&self, table: &PlateTable) -> Result<PlateSource, SceneError> {
        let shape = self.plate_shape(table)?;
        Plate::new(&shape).map_err(|e| self.wrong(format!("[plate] {e}")))?;
        self.temperature("[plate]", table.temperature_k)?;
        for &t in &table.temperatures_k {
            if !(t >= 0.0 && t.is_finite()) {
                return Err(self.wrong(format!(
                    "[plate] temperatures_k holds {t}; each must be finite and not negative"
                )));
            }
        }
        let temperatures_k = table.temperatures_k.clone();
        let temperature_k = table.temperature_k.or(temperatures_k.first().copied());
        Ok(PlateSource {
            emissivity: self.emissivity(table.emissivity.as_ref())?,
            deviation: self.deviation(table, &shape)?,
            mirrors: table.mirrors,
            shape,
            temperature_k,
            temperatures_k,
        })
    }

    fn plate_shape(&self, table: &PlateTable) -> Result<PlateShape, SceneError> {
        let facing = table.facing;
        let given = (table.centre_m, table.width_m, table.height_m, table.diameter_m, table.half_angle_deg);
        match (&table.shape, given) {
            (PlateKind::Rectangle, (Some(centre_m), Some(width_m), Some(height_m), None, None)) => {
                Ok(PlateShape::Rectangle { centre_m, facing, width_m, height_m })
            }
            (PlateKind::Disc, (Some(centre_m), None, None, Some(diameter_m), None)) => {
                Ok(PlateShape::Disc { centre_m, facing, diameter_m })
            }
            (PlateKind::Cone, (_, None, None, None, Some(half_angle_deg))) => {
                Ok(PlateShape::Cone { facing, half_angle_deg })
            }
            (PlateKind::Rectangle, _) => Err(self
                .wrong("[plate] shape \"rectangle\" needs exactly centre_m, facing, width_m and height_m")),
            (PlateKind::Disc, _) => {
                Err(self.wrong("[plate] shape \"disc\" needs exactly centre_m, facing and diameter_m"))
            }
            (PlateKind::Cone, _) => {
                Err(self.wrong("[plate] shape \"cone\" needs exactly facing and half_angle_deg"))
            }
        }
    }

    fn emissivity(&self, given: Option<&NumberOrFile>) -> Result<Emissivity, SceneError> {
        let possible = |e: f64| e > 0.0 && e <= 1.0;
        match given {
            None => Ok(Emissivity::Gray(1.0)),
            Some(NumberOrFile::Number(e)) if possible(*e) => Ok(Emissivity::Gray(*e)),
            Some(NumberOrFile::Number(_)) => {
                Err(self.wrong("[plate] emissivity must be above 0 and at most 1"))
            }
            Some(NumberOrFile::File(file)) => {
                let path = self.folder.join(file);
                let (wavelengths_um, values): (Vec<f64>, Vec<f64>) =
                    self.columns(&path, ["wavelength_um", "emissivity"])?.into_iter().unzip();
                let array =
                    |problem: &str| SceneError::Array { path: path.clone(), problem: problem.to_owned() };
                if wavelengths_um.is_empty() {
                    return Err(array("it has no rows"));
                }
                if wavelengths_um[0] <= 0.0 || wavelengths_um.windows(2).any(|w| w[0] >= w[1]) {
                    return Err(array("wavelength_um must be positive and ascending"));
                }
                if !values.iter().all(|&e| possible(e)) {
                    return Err(array("emissivity must be above 0 and at most 1"));
                }
                Ok(Emissivity::Spectral { wavelengths_um, values })
            }
        }
    }

    fn deviation(&self, table: &PlateTable, shape: &PlateShape) -> Result<Option<Deviation>, SceneError> {
        let deviation = match (table.non_uniformity_k, &table.non_uniformity_npy) {
            (None, None) => return Ok(None),
            (Some(edge_k), None) => Deviation::Parabolic { edge_k },
            (None, Some(file)) => self.map(&self.folder.join(file))?,
            (Some(_), Some(_)) => {
                return Err(self.wrong("[plate] non_uniformity_k and non_uniformity_npy exclude each other"));
            }
        };
        UnevenPlate::new(shape, &deviation).map_err(|e| {
            let key =
                if table.non_uniformity_k.is_some() { "non_uniformity_k" } else { "non_uniformity_npy" };
            self.wrong(format!("[plate] {key}: {e}"))
        })?;
        Ok(Some(deviation))
    }

    fn map(&self, path: &Path) -> Result<Deviation, SceneError> {
        let array = |problem: String| SceneError::Array { path: path.to_owned(), problem };
        let bytes =
            std::fs::read(path).map_err(|source| SceneError::Read { path: path.to_owned(), source })?;
        let map = npy::parse(&bytes).map_err(array)?;
        let [rows, columns] = map.shape[..] else {
            return Err(array(format!("its shape is {:?}; [rows, columns] is expected", map.shape)));
        };
        Ok(Deviation::Map { rows, columns, values: map.values })
    }
}
