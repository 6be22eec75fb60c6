//! The `[band]` table, and tables of two columns.

use super::tables::{BandTable, SamplesChoice};
use super::{Reader, SceneError};
use crate::light::band::{Band, BandSignal, COLDEST_K, Response, SignalTable};
use std::path::Path;
use std::sync::OnceLock;

/// Temperatures over which radiances of a response are tabled, K …
const TABLED_K: [f64; 2] = [250.0, 1000.0];
/// … and the relative error of the table: that of the sums it stands for.
const TABLE_ERROR: f64 = 1e-12;

/// Where radiances are taken in the spectrum.
#[derive(Debug, Clone)]
pub enum BandSource {
    /// At one wavelength in µm: radiances per µm.
    Wavelength(f64),
    /// Over a response: radiances are integrals over it.
    Response {
        /// The table as a function.
        response: Response,
        /// Its black-body signals.
        signal: Box<Signal>,
        /// How finely spectral media are sampled.
        samples: Samples,
    },
}

/// Black-body signals of a response: exact, and as a table that is made when it is first asked for.
#[derive(Debug, Clone)]
pub struct Signal {
    exact: BandSignal,
    table: OnceLock<Option<SignalTable>>,
}

impl Signal {
    fn new(response: &Response) -> Self {
        Self { exact: BandSignal::new(response, COLDEST_K), table: OnceLock::new() }
    }

    /// ∫ R(λ) L(λ, T) dλ in photons s⁻¹ m⁻² sr⁻¹; a grid of cells asks for one each.
    fn at(&self, temperature_k: f64) -> f64 {
        // Without a table (a response so cold that its signal underflows) the integral itself.
        let table =
            self.table.get_or_init(|| SignalTable::of_response(&self.exact, TABLED_K, TABLE_ERROR).ok());
        let tabled = table.as_ref().and_then(|table| table.signal(temperature_k));
        tabled.unwrap_or_else(|| self.exact.signal(temperature_k))
    }
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
    /// (the response straight between the points of its table). Relative error below 2e-12.
    pub fn radiance(&self, temperature_k: f64) -> f64 {
        match self {
            Self::Wavelength(um) => Band::monochromatic(*um).signal(temperature_k),
            Self::Response { signal, .. } => signal.at(temperature_k),
        }
    }

    /// The nodes of the exact integral: what gray media are lit with.
    pub fn nodes(&self) -> Band {
        match self {
            Self::Wavelength(um) => Band::monochromatic(*um),
            Self::Response { signal, .. } => {
                let (wavelengths_um, weights) = signal.exact.points().iter().copied().unzip();
                Band { wavelengths_um, weights, leak_from: None }
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
                let (um, values) = points.into_iter().unzip();
                let response = Response::new(um, values)
                    .map_err(|e| SceneError::Array { path, problem: e.to_string() })?;
                let signal = Box::new(Signal::new(&response));
                Ok(BandSource::Response { response, signal, samples })
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
