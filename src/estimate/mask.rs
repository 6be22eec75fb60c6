//! Marks pixels that an operator does not want to trust: too little emissivity, too uncertain a temperature.
//!
//! Nothing is taken away: a masked pixel keeps its numbers and gets a flag.

use super::map::{DitMap, flag};

/// What is wanted of a pixel; None wants nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    /// Emissivities below this are flagged `LOW_EMISSIVITY`.
    pub emissivity_below: Option<f64>,
    /// Standard deviations of the temperature above this, in K, are flagged `HIGH_SIGMA`, and temperatures without one.
    pub sigma_above_k: Option<f64>,
}

impl Limits {
    /// These, and the other's where there is none.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            emissivity_below: self.emissivity_below.or(other.emissivity_below),
            sigma_above_k: self.sigma_above_k.or(other.sigma_above_k),
        }
    }

    /// What is wrong with them, in words; None for nothing.
    pub fn problem(&self) -> Option<String> {
        let emissivity = self.emissivity_below.filter(|limit| !(-1.0..=1.0).contains(limit));
        let sigma = self.sigma_above_k.filter(|limit| !(*limit > 0.0 && limit.is_finite()));
        let emissivity =
            emissivity.map(|limit| format!("an emissivity to mask below must lie in −1 … 1, found {limit}"));
        emissivity.or_else(|| sigma.map(|limit| format!("a σ to mask above must be positive, found {limit}")))
    }

    /// Flags the pixels of a map that do not keep to the limits.
    pub fn apply(&self, map: &mut DitMap) {
        for i in 0..map.flags.len() {
            if self.emissivity_below.is_some_and(|limit| map.emissivity[i] < limit) {
                map.flags[i] |= flag::LOW_EMISSIVITY;
            }
            // A σ that is not known keeps to no limit.
            let sigma = map.sigma_temperature_k[i];
            let too_much = |limit: f64| map.temperature_k[i].is_finite() && (sigma > limit || sigma.is_nan());
            if self.sigma_above_k.is_some_and(too_much) {
                map.flags[i] |= flag::HIGH_SIGMA;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_flag_and_take_nothing_away() {
        let mut map = DitMap {
            rows: 1,
            columns: 5,
            emissivity: vec![0.5, 0.1, f64::NAN, 0.5, 0.5],
            temperature_k: vec![450.0, 450.0, f64::NAN, 450.0, 450.0],
            sigma_temperature_k: vec![0.5, 0.5, f64::NAN, 3.0, f64::NAN],
            flags: vec![0, 0, flag::TOO_FEW_LEVELS, 0, flag::NO_STATISTICS],
            ..DitMap::empty()
        };
        let before = map.clone();
        Limits::default().apply(&mut map);
        assert_eq!(map.flags, before.flags);
        Limits { emissivity_below: Some(0.2), sigma_above_k: Some(1.0) }.apply(&mut map);
        let (low, high) = (flag::LOW_EMISSIVITY, flag::HIGH_SIGMA);
        assert_eq!(map.flags, [0, low, flag::TOO_FEW_LEVELS, high, high | flag::NO_STATISTICS]);
        let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&map.temperature_k), bits(&before.temperature_k));
        assert_eq!(bits(&map.emissivity), bits(&before.emissivity));
        assert!(Limits { emissivity_below: Some(f64::NAN), ..Limits::default() }.problem().is_some());
        assert!(Limits { sigma_above_k: Some(0.0), ..Limits::default() }.problem().is_some());
        let own = Limits { emissivity_below: Some(0.3), sigma_above_k: None };
        let other = Limits { emissivity_below: Some(0.1), sigma_above_k: Some(2.0) };
        assert_eq!(own.or(other), Limits { emissivity_below: Some(0.3), sigma_above_k: Some(2.0) });
    }
}
