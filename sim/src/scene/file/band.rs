//! The `[band]` table, and tables of two columns.

use super::tables::{BandTable, SamplesChoice};
use super::{Reader, SceneError};
use crate::light::band::{Band, Response};
use std::path::Path;

/// Where radiances are taken in the spectrum.
#[derive(Debug, Clone)]
pub enum BandSource {
    /// At one wavelength in µm: radiances per µm.
    Wavelength(f64),
    /// Over a response: radiances are integrals over it.
    Response {
        /// Nodes of the table: (wavelength in µm, response), rising.
        points: Vec<(f64, f64)>,
        /// The same as a function.
        response: Response,
        /// How finely spectral media are sampled.
        samples: Samples,
    },
}

/// Number of spectral groups of a medium that is not gray.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Samples {
    /// As many as the fuel needs for errors of emissivity below 1e-3.
    Automatic,
    /// This many in band, and one for what leaks through outside of it.
    Number(usize),
}

impl BandSource {
    /// Photon radiance of a black body in photons s⁻¹ m⁻² sr⁻¹, per µm at one wavelength, over a response its integral
    /// (trapezoidal between the points of the table).
    pub fn radiance(&self, temperature_k: f64) -> f64 {
        self.nodes().signal(temperature_k)
    }

    /// The nodes of the table with trapezoidal weights: what gray media are lit with.
    pub fn nodes(&self) -> Band {
        match self {
            Self::Wavelength(um) => Band::monochromatic(*um),
            Self::Response { points, .. } => {
                let um = |i: usize| points[i.min(points.len() - 1)].0;
                Band {
                    wavelengths_um: points.iter().map(|p| p.0).collect(),
                    weights: points
                        .iter()
                        .enumerate()
                        .map(|(i, p)| 0.5 * (um(i + 1) - um(i.saturating_sub(1))) * p.1)
                        .collect(),
                    leak_from: None,
                }
            }
        }
    }
}

impl Reader<'_> {
    pub(super) fn band(&self, table: &BandTable) -> Result<BandSource, SceneError> {
        let samples = match &table.samples {
            None => Samples::Automatic,
            Some(SamplesChoice::Word(word)) if word == "auto" => Samples::Automatic,
            Some(SamplesChoice::Number(n)) if *n > 0 => Samples::Number(*n),
            Some(_) => return Err(self.wrong("[band] samples must be \"auto\" or a whole number above 0")),
        };
        match (table.wavelength_um, &table.response) {
            (Some(um), None) if um > 0.0 && um.is_finite() => Ok(BandSource::Wavelength(um)),
            (Some(_), None) => Err(self.wrong("[band] wavelength_um must be positive")),
            (None, Some(file)) => {
                let path = self.folder.join(file);
                let points = self.columns(&path, ["wavelength_um", "response"])?;
                let (um, values) = points.iter().copied().unzip();
                let response = Response::new(um, values)
                    .map_err(|e| SceneError::Array { path, problem: e.to_string() })?;
                Ok(BandSource::Response { points, response, samples })
            }
            _ => Err(self.wrong("[band] needs exactly one of wavelength_um and response")),
        }
    }

    /// Two columns of a CSV file with a header.
    pub(super) fn columns(&self, path: &Path, names: [&str; 2]) -> Result<Vec<(f64, f64)>, SceneError> {
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
}
