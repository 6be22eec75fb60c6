//! How often an exchange that may be repeated without harm is tried.

use crate::error::DriverError;

/// A third failure in a row is no accident.
const TRIES_MAX: u32 = 3;

/// Counts the tries of one exchange.
#[derive(Debug, Default)]
pub(crate) struct Tries {
    failed: u32,
}

impl Tries {
    /// After a failure: `Ok` when the exchange is worth another try, else what the caller gets, with the number of tries.
    /// A line that is dead or gone is not: more tries would only take longer.
    pub(crate) fn again(&mut self, failure: DriverError) -> Result<(), DriverError> {
        self.failed += 1;
        match failure {
            DriverError::Silent { who, doing, waited, tries: 1, hint } if self.failed >= TRIES_MAX => {
                Err(DriverError::Silent { who, doing, waited, tries: self.failed, hint })
            }
            DriverError::Silent { tries: 1, .. } => Ok(()),
            DriverError::Garbled { .. } if self.failed < TRIES_MAX => Ok(()),
            failure => Err(failure),
        }
    }

    /// The same for what may be said again on a line that was lost and is back.
    pub(crate) fn again_if_reopened(&mut self, failure: DriverError) -> Result<(), DriverError> {
        if failure.is_reopened() && self.failed + 1 < TRIES_MAX {
            self.failed += 1;
            return Ok(());
        }
        self.again(failure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn silent(tries: u32) -> DriverError {
        let text = String::new;
        DriverError::Silent { who: text(), doing: text(), waited: Duration::ZERO, tries, hint: text() }
    }

    fn garbled() -> DriverError {
        let text = String::new;
        DriverError::Garbled { who: text(), doing: text(), answer: text(), why: text(), hint: text() }
    }

    fn reopened() -> DriverError {
        DriverError::Reopened { who: String::new(), doing: String::new(), why: String::new() }
    }

    #[test]
    fn the_third_failure_is_told_with_its_number() {
        for failure in [silent(1), garbled()] {
            let mut tries = Tries::default();
            assert!(tries.again(failure.clone()).is_ok() && tries.again(failure.clone()).is_ok());
            let told = tries.again(failure).unwrap_err();
            assert!(
                matches!(told, DriverError::Silent { tries: 3, .. } | DriverError::Garbled { .. }),
                "{told}"
            );
        }
    }

    #[test]
    fn a_dead_line_and_a_refusal_are_told_at_once() {
        for failure in [silent(5), DriverError::refused("", "", "", ""), DriverError::lost("", "", "", "")] {
            assert!(Tries::default().again(failure.clone()).is_err());
            assert!(Tries::default().again_if_reopened(failure).is_err());
        }
        assert!(Tries::default().again(reopened()).is_err());
        let mut tries = Tries::default();
        assert!(tries.again_if_reopened(reopened()).is_ok() && tries.again_if_reopened(reopened()).is_ok());
        assert!(tries.again_if_reopened(reopened()).unwrap_err().is_reopened());
    }
}
