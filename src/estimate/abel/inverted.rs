//! What a caller gets: an inverted image.

use super::{centre, flag};

/// An inverted image.
#[derive(Debug, Clone, PartialEq)]
pub struct Inverted {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// The local coefficient at every pixel, 1/m, `[rows · columns]`; NaN where it is not known.
    pub alpha_per_m: Vec<f64>,
    /// Its standard deviation, 1/m; NaN where it is not known. Without given σ from what the halves of the rows around differ,
    /// or where there is one half only from the ripple of neighbouring columns. Of the noise alone: what a strength or
    /// pixels smooth away is not in it.
    pub sigma_alpha: Vec<f64>,
    /// Bits of [`flag`].
    pub flags: Vec<u32>,
    /// The axis.
    pub axis: centre::Axis,
    /// Strength of each row: λ in pixel units or the number of cosines; NaN where the method has none.
    pub strength: Vec<f64>,
    /// Rows for which no strength fitted the given σ, so that cross-validation chose.
    pub discrepancy_failed: usize,
}

impl Inverted {
    /// An image of no pixels, to be filled by [`super::Inverter::invert_into`].
    pub fn empty() -> Self {
        Self {
            rows: 0,
            columns: 0,
            alpha_per_m: Vec::new(),
            sigma_alpha: Vec::new(),
            flags: Vec::new(),
            axis: centre::Axis { column: f64::NAN, sigma: f64::NAN, found: false },
            strength: Vec::new(),
            discrepancy_failed: 0,
        }
    }

    /// How many pixels carry each flag, in the order of [`flag::LEGEND`].
    pub fn flag_counts(&self) -> Vec<(&'static str, usize)> {
        let count = |bit: u32| self.flags.iter().filter(|&&flags| flags & bit != 0).count();
        flag::LEGEND.iter().map(|&(bit, name, _)| (name, count(bit))).collect()
    }
}
