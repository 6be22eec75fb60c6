//! The scene file: TOML text and the arrays beside it, read into a typed scene.
//!
//! Reads files and checks meaning; it traces nothing. Lengths in metres, temperatures in kelvin.

mod band;
mod camera;
mod cfd;
mod chamber;
mod lens;
mod media;
pub mod npy;
mod parametric;
mod phase;
mod plate;
mod tables;
mod window;

pub use band::{BandSource, Samples};
pub use chamber::ChamberSource;
pub use lens::Exposure;
pub use media::{CfdSource, MediumSource};
pub use parametric::ParametricSource;
pub use plate::{Emissivity, PlateSource};
pub use tables::PlateMirrors;
pub use window::{WindowSource, Windows};

use crate::light::names;
use crate::scene::deposit::DepositReport;
use crate::scene::optics::OpticsReport;
use crate::scene::spray::SprayShots;
use crate::tracer::camera::Camera;
use std::path::{Path, PathBuf};
use tables::{SceneTables, WallTable};

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
    #[error("scene {path}: {source}{}", meant(&source.to_string()))]
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
    #[error("scene {path}{}: {problem}", line.map_or(String::new(), |n| format!(", line {n}")))]
    Meaning {
        /// The scene file.
        path: PathBuf,
        /// Where in it, counted from 1, if that can be told.
        line: Option<usize>,
        /// What is wrong and what to do.
        problem: String,
    },
    /// A CFD spray cannot be read or spread on a grid.
    #[error("scene {path}: [medium] kind \"cfd\": {source}")]
    Spray {
        /// The scene file.
        path: PathBuf,
        /// File and place in it, and why.
        source: Box<crate::scene::import::SceneError>,
    },
}

/// A scene, read and checked.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The camera; none in scenes for single rays.
    pub camera: Option<Camera>,
    /// The black-body plate, if any.
    pub plate: Option<PlateSource>,
    /// Everything else inside the chamber; of a chamber whose walls are named one by one, the first of them.
    pub walls: Option<WallSource>,
    /// The chamber's walls one by one, if it has a box.
    pub chamber: Option<ChamberSource>,
    /// The spectral band of radiances, if given.
    pub band: Option<BandSource>,
    /// The medium; none where the scene is empty.
    pub medium: Option<MediumSource>,
    /// How long the camera looks, if it is not for a moment.
    pub exposure: Option<Exposure>,
    /// The windows between camera, medium and plate, and the laboratory outside them.
    pub windows: Windows,
    /// What was changed while reading, for the user to see.
    pub notes: Vec<String>,
    /// How the coefficients of a spray were made; none for other media.
    pub optics: Option<OpticsReport>,
    /// How shots of a parametric spray differ, per occupied cell of the medium in its order; none for other media.
    pub shots: Option<SprayShots>,
    /// How a CFD spray was spread on the tracer's grid, once it is.
    pub deposit: Option<DepositReport>,
}

/// The walls and their light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallSource {
    /// Temperature in K.
    pub temperature_k: f64,
    /// Emissivity; without `[chamber]` all walls shine as one black body.
    pub emissivity: f64,
}

/// Reads a scene file and the arrays it names. Sprays are described only: [`Scene::with_spray`] makes them.
///
/// # Errors
///
/// [`SceneError`] with the file, and line and place where the text is at fault.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    let text =
        std::fs::read_to_string(path).map_err(|source| SceneError::Read { path: path.to_owned(), source })?;
    let tables: SceneTables = toml::from_str(&text)
        .map_err(|source| SceneError::Parse { path: path.to_owned(), source: Box::new(source) })?;
    let reader = Reader { path, folder: path.parent().unwrap_or(Path::new("")), text: &text };
    reader.scene(tables)
}

struct Reader<'a> {
    path: &'a Path,
    folder: &'a Path,
    text: &'a str,
}

impl Reader<'_> {
    /// A problem that starts with the table it is about, as `[plate] …`: the line is that of the key it names.
    fn wrong(&self, problem: impl Into<String>) -> SceneError {
        self.wrong_in(0, problem)
    }

    /// The same in the table that is number `nth` of its name, counted from 0.
    fn wrong_in(&self, nth: usize, problem: impl Into<String>) -> SceneError {
        let problem = problem.into();
        SceneError::Meaning { path: self.path.to_owned(), line: line_of(self.text, nth, &problem), problem }
    }

    fn scene(&self, tables: SceneTables) -> Result<Scene, SceneError> {
        if let Some(schema) = tables.schema.filter(|&s| s == 0 || s > SCHEMA) {
            return Err(self.wrong(format!("schema {schema}; this program reads schema 1 to {SCHEMA}")));
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
        let exposure = tables.exposure.map(|e| self.exposure(&e, medium.as_ref())).transpose()?;
        if exposure.is_some_and(|e| e.time_s > 0.0 && e.motion_m().iter().all(|m| *m == 0.0))
            && !matches!(medium, None | Some(MediumSource::Parametric(_)))
        {
            notes.push(
                "exposure: the medium stands still; give [exposure] velocity_m_s to see it move".to_owned(),
            );
        }
        let mut scene = Scene {
            camera,
            plate,
            walls,
            chamber: None,
            band,
            medium,
            exposure,
            windows: Windows::default(),
            notes,
            optics: None,
            shots: None,
            deposit: None,
        };
        scene.windows = self.windows(&tables.window, tables.lab.as_ref(), &scene)?;
        scene.chamber = self.chamber(tables.chamber.as_ref(), &tables.wall, &scene)?;
        scene.walls = scene.walls.or(scene.chamber.as_ref().map(|c| c.walls[0]));
        let laboratory = scene.plate.as_ref().is_some_and(|p| p.mirrors == Some(PlateMirrors::Laboratory));
        if laboratory && scene.windows.lab_temperature_k.is_none() {
            return Err(
                self.wrong("[plate] mirrors \"laboratory\" needs a table [lab] with its temperature_k")
            );
        }
        Ok(scene)
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
}

/// For a message about an unknown key or kind: which known one it may have meant.
fn meant(message: &str) -> String {
    let Some((_, rest)) =
        message.split_once("unknown field `").or_else(|| message.split_once("unknown variant `"))
    else {
        return String::new();
    };
    // `wrong`, expected one of `a`, `b`: every second piece is a name.
    let names: Vec<&str> = rest.split('`').step_by(2).map(str::trim).collect();
    let known: Vec<&str> = rest.split('`').skip(2).step_by(2).collect();
    names.first().map_or(String::new(), |wrong| names::guessed(wrong, &known))
}

/// Line, counted from 1, of the key that a problem of table `nth` names, else of that table's head.
fn line_of(text: &str, nth: usize, problem: &str) -> Option<usize> {
    let table = problem.strip_prefix('[').and_then(|p| p.split_once(']')).map(|p| p.0);
    let words: Vec<&str> = problem.split(|c: char| !(c.is_alphanumeric() || c == '_')).collect();
    let mut found = None;
    let mut heads = 0;
    let mut inside = table.is_none();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if let Some(head) = line.strip_prefix('[') {
            let name = head.trim_start_matches('[').split(']').next().unwrap_or_default().trim();
            inside = Some(name) == table && heads == nth;
            heads += usize::from(Some(name) == table);
            if inside {
                found = Some(number);
            }
        } else if inside
            && line
                .split_once('=')
                .is_some_and(|(key, _)| !key.starts_with('#') && words.contains(&key.trim()))
        {
            return Some(number);
        }
    }
    found
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
        let band = BandSource::Wavelength(3.4);
        for (t, exitance) in [(300.0, 1.054_573_394_580_724_5e19), (500.0, 2.975_579_254_200_778e21)] {
            assert!((band.radiance(t) * std::f64::consts::PI / exitance - 1.0).abs() < 1e-14 * 20.0);
        }
        assert!(band.radiance(0.0).abs() < f64::MIN_POSITIVE);
    }
}
