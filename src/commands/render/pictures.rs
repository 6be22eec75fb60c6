//! Pictures of `ditd render`: radiances in false colours, all of a kind on one scale.

use super::super::CommandError;
use crate::files::preview::{self, Colours, Preview};
use ditd_sim::scene::file::{BandSource, Scene};
use ditd_sim::tracer::camera::Camera;
use std::path::{Path, PathBuf};

/// A radiance image, of a plate temperature if one is named.
pub(super) struct Picture {
    pub(super) name: Option<f64>,
    pub(super) values: Vec<f64>,
}

impl Picture {
    pub(super) fn title(&self, what: &str) -> String {
        self.name.map_or(what.to_owned(), |kelvin| format!("{what}, plate {kelvin} K"))
    }
}

/// Writes each picture as PNG, all on one scale.
pub(super) fn write_pngs(
    path: &Path,
    camera: &Camera,
    scene: &Scene,
    pictures: &[Picture],
) -> Result<(), CommandError> {
    let scale = Scale::of(scene, pictures)?;
    for picture in pictures {
        let out = match picture.name {
            Some(kelvin) if pictures.len() > 1 => beside(path, &kelvin_name(kelvin)),
            _ => path.to_owned(),
        };
        scale.write(&out, camera, &picture.title("radiance"), &picture.values)?;
    }
    Ok(())
}

/// The path with something added to the name of the file.
pub(super) fn beside(path: &Path, addition: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or(String::new(), |e| format!(".{}", e.to_string_lossy()));
    path.with_file_name(format!("{stem}_{addition}{extension}"))
}

/// The range of radiances that colours stand for.
pub(super) struct Scale {
    factor: f64,
    low: f64,
    high: f64,
    unit: String,
}

impl Scale {
    pub(super) fn of(scene: &Scene, pictures: &[Picture]) -> Result<Self, CommandError> {
        if pictures.is_empty() {
            return Err(CommandError::usage(
                "render: --png shows radiances: give [band] and the temperatures of [plate], [walls] and [medium]",
            ));
        }
        let all = || pictures.iter().flat_map(|p| p.values.iter().copied());
        // Tick labels stay short: a power of ten goes to the unit.
        let largest = all().filter(|v| v.is_finite()).fold(0.0, f64::max);
        let power = if largest > 0.0 { libm::floor(libm::log10(largest)) } else { 0.0 };
        let factor = libm::pow(10.0, -power);
        let scaled: Vec<f64> = all().map(|v| v * factor).collect();
        let (low, high) = preview::round_range(&scaled);
        let per = if matches!(scene.band, Some(BandSource::Wavelength(_))) { " um" } else { "" };
        Ok(Self { factor, low, high, unit: format!("1e{power:.0} ph/(s m2 sr{per})") })
    }

    pub(super) fn write(
        &self,
        path: &Path,
        camera: &Camera,
        title: &str,
        values: &[f64],
    ) -> Result<(), CommandError> {
        let values: Vec<f64> = values.iter().map(|v| v * self.factor).collect();
        let png = preview::to_png(&Preview {
            rows: camera.rows,
            columns: camera.columns,
            values: &values,
            low: self.low,
            high: self.high,
            title,
            unit: &self.unit,
            colours: Colours::Inferno,
        });
        png.and_then(|bytes| std::fs::write(path, bytes))
            .map_err(|e| CommandError::failure(format!("render: writing {}: {e}", path.display())))
    }
}

/// A temperature as part of a name: no dots, which EXR channels cannot have.
pub(super) fn kelvin_name(kelvin: f64) -> String {
    format!("{kelvin}K").replace('.', "_")
}
