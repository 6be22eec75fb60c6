//! The map that is looked at while shots come in: what a picture of the spray shows, in f32.

use super::answers::Answers;
use super::{CHANNELS, FitInputs};
use crate::estimate::accumulate::Sums;

/// A map to be looked at; channels and flags mean what they do in a [`DitMap`](super::DitMap).
#[derive(Debug, Clone, PartialEq)]
pub struct LookMap<F = f32> {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// ε = −slope/γ_near. May be outside 0 … 1 by its uncertainty.
    pub emissivity: Vec<F>,
    /// Effective temperature, in K.
    pub temperature_k: Vec<F>,
    /// Standard deviation of the emissivity.
    pub sigma_emissivity: Vec<F>,
    /// Standard deviation of the temperature by linear propagation, in K.
    pub sigma_temperature_k: Vec<F>,
    /// Lower end of Fieller's set of temperatures, in K; NaN if unbounded or outside the calibration.
    pub temperature_low_k: Vec<F>,
    /// Upper end, in K.
    pub temperature_high_k: Vec<F>,
    /// Slope of the blanks against I_cal: γ_far·γ_near·gain of the pixel. An alarm for fouled windows.
    pub gain: Vec<F>,
    /// Bits of [`flag`](super::flag).
    pub flags: Vec<u32>,
}

impl<F> LookMap<F> {
    /// A map of no pixels, to be filled by [`look_into`](super::look_into).
    pub fn empty() -> Self {
        Self {
            rows: 0,
            columns: 0,
            emissivity: Vec::new(),
            temperature_k: Vec::new(),
            sigma_emissivity: Vec::new(),
            sigma_temperature_k: Vec::new(),
            temperature_low_k: Vec::new(),
            temperature_high_k: Vec::new(),
            gain: Vec::new(),
            flags: Vec::new(),
        }
    }
}

impl<F> Answers<F> for LookMap<F> {
    const WANTED: [bool; CHANNELS.len()] =
        [false, false, false, true, true, true, true, false, false, false, true, true, false, true, false];

    fn prepare(&mut self, like: &Sums, _: &FitInputs<'_>) {
        (self.rows, self.columns) = (like.rows(), like.columns());
    }

    fn planes_mut(&mut self) -> ([Option<&mut Vec<F>>; CHANNELS.len()], &mut Vec<u32>) {
        let planes = [
            None,
            None,
            None,
            Some(&mut self.emissivity),
            Some(&mut self.temperature_k),
            Some(&mut self.sigma_emissivity),
            Some(&mut self.sigma_temperature_k),
            None,
            None,
            None,
            Some(&mut self.temperature_low_k),
            Some(&mut self.temperature_high_k),
            None,
            Some(&mut self.gain),
            None,
        ];
        (planes, &mut self.flags)
    }
}
