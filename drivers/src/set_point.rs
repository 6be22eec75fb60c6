//! A calibrator's set-point before it is sent: on the instrument's steps, and held against the configured limit.

use crate::error::DriverError;
use crate::instrument::CalibratorSettings;
use crate::quantity::Kelvin;

/// What a person should try when a set-point is not allowed.
pub(crate) const LIMIT_HINT: &str = "Change the levels, or the limit if the rig really allows it.";

/// Temperatures in °C and kelvin that are meant to be equal differ by this much at most: some roundings of 64-bit numbers
/// below 2000.
const ROUNDING_C: f64 = 1e-9;

/// A set-point that may be sent.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SetPoint {
    /// In °C, on the instrument's steps.
    pub(crate) celsius: f64,
    /// What is done, for messages.
    pub(crate) doing: String,
}

impl SetPoint {
    /// The step nearest to `target`, never above the limit. `steps_per_c` is 10 or 100.
    ///
    /// # Errors
    /// [`DriverError::Limit`] before the instrument is prepared, for what is no number, and above the limit.
    pub(crate) fn new(
        who: &str,
        target: Kelvin,
        steps_per_c: f64,
        settings: Option<&CalibratorSettings>,
    ) -> Result<Self, DriverError> {
        let wanted_c = target.celsius();
        let decimals = if steps_per_c > 10.0 { 2 } else { 1 };
        let doing = format!("setting {wanted_c:.decimals$} °C");
        let Some(settings) = settings else {
            let why = "the limits are not known before the instrument is prepared";
            return Err(DriverError::limit(who, doing, why, LIMIT_HINT));
        };
        if !wanted_c.is_finite() {
            return Err(DriverError::limit(who, doing, "the set-point is not a number", LIMIT_HINT));
        }
        let limit_c = settings.limit.celsius();
        // Written so that a limit which is no number allows nothing.
        let is_allowed = |celsius: f64| celsius <= limit_c + ROUNDING_C;
        if !is_allowed(wanted_c) {
            let why = format!("the configured limit is {limit_c:.2} °C");
            return Err(DriverError::limit(who, doing, why, LIMIT_HINT));
        }
        let steps = wanted_c * steps_per_c;
        let nearest_c = steps.round() / steps_per_c;
        // A step below is at most one step off; above the limit nothing is.
        let celsius = if is_allowed(nearest_c) { nearest_c } else { steps.floor() / steps_per_c };
        Ok(Self { celsius, doing })
    }
}

/// What speaks against a limit for set-points: it must be a number.
pub(crate) fn check_limit(who: &str, settings: &CalibratorSettings) -> Result<(), DriverError> {
    if settings.limit.0.is_finite() {
        return Ok(());
    }
    Err(DriverError::limit(who, "preparing", "the configured limit is not a number", LIMIT_HINT))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::KelvinDelta;
    use proptest::prelude::*;

    fn settings(limit: f64) -> CalibratorSettings {
        CalibratorSettings {
            display_emissivity: 0.95,
            limit: Kelvin(limit),
            rate_k_per_min: 100.0,
            stability: KelvinDelta(0.4),
        }
    }

    fn taken(target: f64, steps_per_c: f64, limit: f64) -> Result<f64, DriverError> {
        SetPoint::new("plate", Kelvin(target), steps_per_c, Some(&settings(limit))).map(|point| point.celsius)
    }

    proptest! {
        /// A level at the limit is allowed, whatever the numbers do in °C, and never rounded to above it.
        #[test]
        fn the_limit_itself_is_allowed_and_nothing_above(centi in 27_000_u32..80_000, above in 1_u32..500) {
            let limit = f64::from(centi) / 100.0;
            for steps_per_c in [10.0, 100.0] {
                let celsius = taken(limit, steps_per_c, limit).unwrap();
                prop_assert!(Kelvin::from_celsius(celsius).0 <= limit + 2.0 * ROUNDING_C);
                prop_assert!(Kelvin::from_celsius(celsius).0 > limit - 1.0 / steps_per_c - ROUNDING_C);
                let error = taken(limit + f64::from(above) / 100.0, steps_per_c, limit).unwrap_err();
                prop_assert!(error.is_interlock_or_limit());
            }
        }

        #[test]
        fn below_the_limit_the_nearest_step_is_taken(milli in 270_000_u32..600_000) {
            let target = f64::from(milli) / 1000.0;
            let off = Kelvin::from_celsius(taken(target, 100.0, 700.0).unwrap()).0 - target;
            prop_assert!(off.abs() <= 0.005 + ROUNDING_C);
        }
    }

    #[test]
    fn what_is_no_number_is_not_allowed() {
        for (target, limit) in [(f64::NAN, 500.0), (f64::INFINITY, 500.0), (400.0, f64::NAN)] {
            assert!(taken(target, 100.0, limit).unwrap_err().is_interlock_or_limit());
        }
        assert!(check_limit("plate", &settings(f64::INFINITY)).is_err());
        assert!(SetPoint::new("plate", Kelvin(400.0), 100.0, None).unwrap_err().is_interlock_or_limit());
    }
}
