//! The one wall clock: made in `main`, handed down as a value.

use jiff::Timestamp;
use std::time::{Duration, Instant};

/// Host time since the program's start, and UTC.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    begun: Instant,
}

impl Clock {
    /// Starts the clock. Only `main` calls this.
    #[expect(clippy::disallowed_methods, reason = "this is the one place where host time enters")]
    pub fn start() -> Self {
        Self { begun: Instant::now() }
    }

    /// Host time since the start.
    pub fn elapsed(&self) -> Duration {
        self.begun.elapsed()
    }

    /// UTC now, RFC 3339.
    pub fn utc(&self) -> String {
        Timestamp::now().to_string()
    }
}
