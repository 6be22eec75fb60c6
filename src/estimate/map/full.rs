//! The map that is kept: all channels in f64, with counts of cycles.

use super::answers::Answers;
use super::{CHANNELS, CONFIDENCE, Estimator, FitInputs, flag};
use crate::estimate::accumulate::Sums;
use crate::estimate::budget::Budget;

/// A map to be kept; every channel is `[rows · columns]` in row order, row 0 at the top, NaN = no answer (see the flags).
#[derive(Debug, Clone, PartialEq)]
pub struct DitMap {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Levels, with or without x.
    pub levels: usize,
    /// How it was fitted.
    pub estimator: Estimator,
    /// Confidence of the low/high channels.
    pub confidence: f64,
    /// Slope of spray − blank against x: −γ_near·ε.
    pub slope: Vec<f64>,
    /// Value of the line at x = 0, in counts.
    pub offset: Vec<f64>,
    /// x where the line is zero, in counts.
    pub crossing: Vec<f64>,
    /// ε = −slope/γ_near. May be outside 0 … 1 by its uncertainty.
    pub emissivity: Vec<f64>,
    /// Effective temperature, in K.
    pub temperature_k: Vec<f64>,
    /// Standard deviation of the emissivity.
    pub sigma_emissivity: Vec<f64>,
    /// Standard deviation of the temperature by linear propagation, in K.
    pub sigma_temperature_k: Vec<f64>,
    /// Weighted squares of the line's residuals: large for scattering, drift or a wrong plate temperature.
    pub chi2: Vec<f64>,
    /// Lower end of the emissivity's interval.
    pub emissivity_low: Vec<f64>,
    /// Upper end.
    pub emissivity_high: Vec<f64>,
    /// Lower end of Fieller's set of temperatures, in K; NaN if unbounded or outside the calibration.
    pub temperature_low_k: Vec<f64>,
    /// Upper end, in K.
    pub temperature_high_k: Vec<f64>,
    /// The camera's part of `sigma_temperature_k`, in K: what would be left if all shots were alike.
    pub sigma_t_noise_k: Vec<f64>,
    /// Slope of the blanks against I_cal: γ_far·γ_near·gain of the pixel. An alarm for fouled windows.
    pub gain: Vec<f64>,
    /// Standard deviation of `gain` from the scatter about its line; NaN for two levels.
    pub sigma_gain: Vec<f64>,
    /// Cycles that count, `[levels · rows · columns]`.
    pub count: Vec<u32>,
    /// Cycles left out of the pixel alone as spikes, `[levels · rows · columns]`; empty if there are none.
    pub rejected: Vec<u32>,
    /// Bits of [`flag`].
    pub flags: Vec<u32>,
    /// What `temperature_k` may be wrong by, part by part; None until it is asked for.
    pub budget: Option<Budget>,
}

impl DitMap {
    /// The f64 channels in the order of [`CHANNELS`].
    pub fn channels(&self) -> [&[f64]; CHANNELS.len()] {
        [
            &self.slope,
            &self.offset,
            &self.crossing,
            &self.emissivity,
            &self.temperature_k,
            &self.sigma_emissivity,
            &self.sigma_temperature_k,
            &self.chi2,
            &self.emissivity_low,
            &self.emissivity_high,
            &self.temperature_low_k,
            &self.temperature_high_k,
            &self.sigma_t_noise_k,
            &self.gain,
            &self.sigma_gain,
        ]
    }

    /// A map of no pixels, to be filled by [`solve_into`].
    pub fn empty() -> Self {
        Self {
            rows: 0,
            columns: 0,
            levels: 0,
            estimator: Estimator::Default,
            confidence: CONFIDENCE,
            slope: Vec::new(),
            offset: Vec::new(),
            crossing: Vec::new(),
            emissivity: Vec::new(),
            temperature_k: Vec::new(),
            sigma_emissivity: Vec::new(),
            sigma_temperature_k: Vec::new(),
            chi2: Vec::new(),
            emissivity_low: Vec::new(),
            emissivity_high: Vec::new(),
            temperature_low_k: Vec::new(),
            temperature_high_k: Vec::new(),
            sigma_t_noise_k: Vec::new(),
            gain: Vec::new(),
            sigma_gain: Vec::new(),
            count: Vec::new(),
            rejected: Vec::new(),
            flags: Vec::new(),
            budget: None,
        }
    }

    /// Copies the numbers of cycles from the sums: a fifth of a solve's time, and of no use where it is only looked at.
    pub(super) fn keep_counts(&mut self, sums: &Sums) {
        let pixels = sums.rows() * sums.columns();
        for level in sums.levels() {
            self.count.extend((0..pixels).map(|pixel| level.count(pixel)));
        }
        if sums.levels().iter().any(|level| level.has_outliers()) {
            for level in sums.levels() {
                self.rejected.extend((0..pixels).map(|pixel| level.outliers(pixel)));
            }
        }
    }

    /// How many pixels carry each flag, in the order of [`flag::LEGEND`].
    pub fn flag_counts(&self) -> Vec<(&'static str, usize)> {
        flag::LEGEND
            .iter()
            .map(|&(bit, name, _)| (name, self.flags.iter().filter(|&&f| f & bit != 0).count()))
            .collect()
    }
}

impl Answers<f64> for DitMap {
    const WANTED: [bool; CHANNELS.len()] = [true; CHANNELS.len()];

    fn prepare(&mut self, like: &Sums, inputs: &FitInputs<'_>) {
        (self.rows, self.columns, self.levels) = (like.rows(), like.columns(), like.levels().len());
        (self.estimator, self.confidence) = (inputs.estimator, inputs.confidence);
        self.budget = None;
        self.count.clear();
        self.rejected.clear();
    }

    fn planes_mut(&mut self) -> ([Option<&mut Vec<f64>>; CHANNELS.len()], &mut Vec<u32>) {
        let planes = [
            &mut self.slope,
            &mut self.offset,
            &mut self.crossing,
            &mut self.emissivity,
            &mut self.temperature_k,
            &mut self.sigma_emissivity,
            &mut self.sigma_temperature_k,
            &mut self.chi2,
            &mut self.emissivity_low,
            &mut self.emissivity_high,
            &mut self.temperature_low_k,
            &mut self.temperature_high_k,
            &mut self.sigma_t_noise_k,
            &mut self.gain,
            &mut self.sigma_gain,
        ];
        (planes.map(Some), &mut self.flags)
    }
}
