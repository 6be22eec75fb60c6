//! Bytes of a wire: written, read and drained, each within a time.

use super::lines::LINE_BYTES_MAX;
use super::open::loss_hint;
use super::{QUIET, Wire};
use crate::error::DriverError;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, timeout, timeout_at};

/// How long a suspect line is drained before it is given up as babbling.
const QUIET_DEADLINE: Duration = Duration::from_secs(3);

impl Wire {
    /// True when nothing but line ends comes within `wait`; at least what has arrived already is looked at.
    pub(super) async fn is_quiet_for(&mut self, wait: Duration, doing: &str) -> Result<bool, DriverError> {
        self.no_bytes_for(wait, doing, |byte| matches!(byte, b'\r' | b'\n')).await
    }

    /// True when no byte comes within `wait` but those that may; what has come is dropped.
    pub(super) async fn no_bytes_for(
        &mut self,
        wait: Duration,
        doing: &str,
        may: fn(u8) -> bool,
    ) -> Result<bool, DriverError> {
        let until = Instant::now() + wait;
        loop {
            while let Some(byte) = self.received.pop_front() {
                if !may(byte) {
                    self.received.clear();
                    return Ok(false);
                }
            }
            if !self.fill_until(until, doing).await? {
                return Ok(true);
            }
        }
    }

    /// Reads and drops until the line has been quiet for [`QUIET`], or for `quiet` if that is longer. The number of
    /// bytes dropped.
    pub(super) async fn drain(&mut self, quiet: Duration, doing: &str) -> Result<usize, DriverError> {
        let quiet = quiet.max(QUIET);
        let give_up = Instant::now() + QUIET_DEADLINE + quiet;
        self.decoder.take();
        let mut dropped = self.received.len();
        self.received.clear();
        while self.fill_until(Instant::now() + quiet, doing).await? {
            dropped += self.received.len();
            self.received.clear();
            if Instant::now() >= give_up {
                return Err(self.garbled(doing, String::new(), "the line never falls silent"));
            }
        }
        Ok(dropped)
    }

    /// Reads once; false when nothing came by `until`.
    pub(super) async fn fill_until(&mut self, until: Instant, doing: &str) -> Result<bool, DriverError> {
        let mut chunk = [0; LINE_BYTES_MAX];
        match timeout_at(until, self.stream.read(&mut chunk)).await {
            Err(_) => Ok(false),
            Ok(Ok(0)) => Err(self.lost(doing, None)),
            Ok(Ok(count)) => {
                self.received.extend(&chunk[..count]);
                Ok(true)
            }
            Ok(Err(error)) => Err(self.lost(doing, Some(&error))),
        }
    }

    /// Writes within the deadline.
    pub(super) async fn write(&mut self, bytes: &[u8], doing: &str) -> Result<(), DriverError> {
        let deadline = self.habits.deadline;
        let written = timeout(deadline, async {
            self.stream.write_all(bytes).await?;
            self.stream.flush().await
        })
        .await;
        self.free_at = Instant::now() + self.habits.pace;
        match written {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(self.lost(doing, Some(&error))),
            Err(_) => Err(self.silent(doing)),
        }
    }

    /// The line has ended: by an error of the system, or because the other side closed it.
    fn lost(&self, doing: &str, error: Option<&io::Error>) -> DriverError {
        DriverError::lost(
            &self.name,
            doing,
            error.map_or_else(|| "the other side closed it".to_owned(), ToString::to_string),
            loss_hint(error).to_owned(),
        )
    }
}
