//! Opens a line that has gone again.
//!
//! The policy lives here so that drivers stay simple: an exchange that finds the line gone waits for it, and ends with
//! one error of its own kind. Nothing is sent on the new line by itself and no exchange is repeated, since only the driver
//! knows what may be said twice and what the instrument may have forgotten.

use super::Wire;
use crate::error::DriverError;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// How often and how long a line that has gone is tried to be opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reopening {
    /// Time between tries.
    pub every: Duration,
    /// Time from the loss after which it is given up; zero: never opened again.
    pub within: Duration,
}

impl Reopening {
    /// Every half second for ten seconds: a USB adapter that was pulled and plugged, or that the kernel has reset, is back
    /// within two or three.
    pub fn usual() -> Self {
        Self::for_s(10.0)
    }

    /// Every half second for so many seconds, at most an hour; 0, and what is no number, is never.
    pub fn for_s(seconds: f64) -> Self {
        let seconds = if seconds > 0.0 { seconds.min(3600.0) } else { 0.0 };
        Self { every: Duration::from_millis(500), within: Duration::from_secs_f64(seconds) }
    }

    /// A line that has gone stays gone.
    pub fn never() -> Self {
        Self::for_s(0.0)
    }
}

impl Wire {
    /// The same wire with another policy; without effect on a wire over a given stream.
    #[must_use]
    pub fn reopening(mut self, reopening: Reopening) -> Self {
        self.reopening = reopening;
        self
    }

    /// The error of an exchange that would begin on a line that was lost before.
    pub(super) fn must_be_there(&self, doing: &str) -> Result<(), DriverError> {
        if !self.gone {
            return Ok(());
        }
        Err(DriverError::lost(
            &self.name,
            doing,
            "it was lost before",
            "Plug it in again and check its power.",
        ))
    }

    /// Passes a result on; of a loss it makes a line that is open again, if the policy allows and the device is there.
    ///
    /// Once the time is used up each later exchange tries only once, without waiting: what must be made safe elsewhere is
    /// not held up, and an instrument that was plugged in meanwhile is found all the same.
    pub(super) async fn outlive<T>(&mut self, result: Result<T, DriverError>) -> Result<T, DriverError> {
        let (who, doing, why, hint) = match result {
            Err(DriverError::Lost { who, doing, why, hint }) => (who, doing, why, hint),
            other => return other,
        };
        let waited_before = self.gone;
        self.gone = true;
        if self.reopening.within.is_zero() {
            return Err(DriverError::Lost { who, doing, why, hint });
        }
        let Some(opener) = &mut self.opener else {
            return Err(DriverError::Lost { who, doing, why, hint });
        };
        let begun = Instant::now();
        let mut tries = 0;
        let refusal = loop {
            tries += 1;
            match opener().await {
                Ok(stream) => {
                    self.stream = stream;
                    self.decoder.take();
                    self.received.clear();
                    self.suspect = true;
                    self.gone = false;
                    return Err(DriverError::Reopened { who, doing, why });
                }
                Err(refusal) => {
                    if waited_before || begun.elapsed() + self.reopening.every > self.reopening.within {
                        break refusal;
                    }
                }
            }
            sleep(self.reopening.every).await;
        };
        let refusal = match refusal {
            DriverError::Missing { why, .. } => why,
            other => other.to_string(),
        };
        let why = format!(
            "{why}; tried to open it again {tries} times in {:.1} s: {refusal}",
            begun.elapsed().as_secs_f64()
        );
        Err(DriverError::Lost { who, doing, why, hint })
    }
}
