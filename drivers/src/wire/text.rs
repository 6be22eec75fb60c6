//! Lines of text on a wire: commands without an answer, questions with one, and the thread found again.

use super::lines::Garbage;
use super::{QUIET, RESYNC_TRIES, Wire};
use crate::error::DriverError;
use std::time::Duration;
use tokio::time::Instant;

/// Lines that one try of finding the thread again reads at most.
const RESYNC_LINES_MAX: u32 = 64;

impl Wire {
    /// Sends a command that has no answer.
    ///
    /// # Errors
    /// As for [`Wire::ask`], except that nothing is waited for after the command.
    pub async fn tell(&mut self, command: &str, doing: &str) -> Result<(), DriverError> {
        let told = self.tell_once(command, doing).await;
        self.outlive(told).await
    }

    /// Sends a question and gives its one answer. A single echo of the question is skipped: no instrument here
    /// answers a question with the question.
    ///
    /// # Errors
    /// [`DriverError::Silent`] without an answer within the deadline, [`DriverError::Garbled`] for a rejected line,
    /// [`DriverError::Lost`] when the line has ended and stays so, [`DriverError::Reopened`] when it had ended and was
    /// opened again: the question is then not repeated.
    pub async fn ask(&mut self, question: &str, doing: &str) -> Result<String, DriverError> {
        let answered = self.ask_once(question, doing).await;
        self.outlive(answered).await
    }

    /// Waits for silence, drains the line, and asks the recognisable query until its answer, and nothing after it,
    /// has come. Without such a query the silence must outlast the deadline of an answer that may still come.
    ///
    /// # Errors
    /// [`DriverError::Silent`] when no try was answered readably, [`DriverError::Garbled`] when the line never falls
    /// silent, [`DriverError::Lost`] and [`DriverError::Reopened`] as for [`Wire::ask`].
    pub async fn resync(&mut self, doing: &str) -> Result<(), DriverError> {
        let found = self.resync_once(doing).await;
        self.outlive(found).await
    }

    async fn tell_once(&mut self, command: &str, doing: &str) -> Result<(), DriverError> {
        self.make_ready(doing).await?;
        self.suspect = true;
        self.write_line(command, doing).await?;
        self.suspect = false;
        Ok(())
    }

    async fn ask_once(&mut self, question: &str, doing: &str) -> Result<String, DriverError> {
        self.make_ready(doing).await?;
        // Stays set if this future is dropped half-way: the answer is then still to come.
        self.suspect = true;
        self.owed = true;
        self.write_line(question, doing).await?;
        let until = Instant::now() + self.habits.deadline;
        let mut echo_seen = false;
        let answer = loop {
            match self.line_until(until, doing).await? {
                None => return Err(self.no_answer(doing)),
                Some(Err(garbage)) => return Err(self.garbled(doing, garbage.received, garbage.why)),
                Some(Ok(line)) if !echo_seen && line.eq_ignore_ascii_case(question) => echo_seen = true,
                Some(Ok(line)) => break line,
            }
        };
        if let Some(sign) = self.habits.sign
            && sign.query != question
            && (sign.fits)(&answer)
        {
            return Err(self.garbled(doing, answer, "a late answer to an earlier query"));
        }
        self.suspect = false;
        self.owed = false;
        self.free_at = Instant::now() + self.habits.pace;
        Ok(answer)
    }

    async fn resync_once(&mut self, doing: &str) -> Result<(), DriverError> {
        self.must_be_there(doing)?;
        self.suspect = true;
        let Some(sign) = self.habits.sign else {
            let quiet = if self.owed { self.habits.deadline } else { Duration::ZERO };
            self.drain(quiet, doing).await?;
            self.trust();
            return Ok(());
        };
        let mut unreadable = 0;
        for _ in 0..RESYNC_TRIES {
            self.drain(Duration::ZERO, doing).await?;
            self.write_line(sign.query, doing).await?;
            let until = Instant::now() + self.habits.deadline;
            let mut recognised = false;
            let mut garbage = false;
            for _ in 0..RESYNC_LINES_MAX {
                match self.line_until(until, doing).await? {
                    None => break,
                    Some(Ok(line)) if (sign.fits)(&line) => {
                        recognised = true;
                        break;
                    }
                    Some(Ok(_)) => {}
                    Some(Err(_)) => garbage = true,
                }
            }
            if recognised && self.is_quiet_for(QUIET, doing).await? {
                self.trust();
                return Ok(());
            }
            // At a wrong rate even the line's end may not be one.
            garbage |= self.decoder.take().iter().any(|byte| !(0x20..=0x7e).contains(byte));
            unreadable += u32::from(garbage && !recognised);
        }
        Err(self.not_found_again(doing, sign.query, unreadable == RESYNC_TRIES, RESYNC_TRIES))
    }

    pub(super) fn trust(&mut self) {
        self.suspect = false;
        self.owed = false;
        self.free_at = Instant::now();
    }

    /// Lets the pace pass. Bytes that nobody asked for, other than the LF of a CR LF, make the line suspect.
    async fn make_ready(&mut self, doing: &str) -> Result<(), DriverError> {
        self.must_be_there(doing)?;
        if !self.suspect {
            let wait = self.free_at.saturating_duration_since(Instant::now());
            self.suspect = !self.is_quiet_for(wait, doing).await?;
        }
        if self.suspect { self.resync_once(doing).await } else { Ok(()) }
    }

    /// The next line, or `None` when there is none by `until`.
    async fn line_until(
        &mut self,
        until: Instant,
        doing: &str,
    ) -> Result<Option<Result<String, Garbage>>, DriverError> {
        loop {
            while let Some(byte) = self.received.pop_front() {
                if let Some(line) = self.decoder.push(byte) {
                    return Ok(Some(line));
                }
            }
            if !self.fill_until(until, doing).await? {
                return Ok(None);
            }
        }
    }

    async fn write_line(&mut self, line: &str, doing: &str) -> Result<(), DriverError> {
        self.decoder.take();
        let bytes = [line.as_bytes(), self.habits.ending.as_bytes()].concat();
        self.write(&bytes, doing).await
    }

    fn no_answer(&mut self, doing: &str) -> DriverError {
        let unfinished = self.decoder.take();
        if unfinished.is_empty() {
            return self.silent(doing);
        }
        self.garbled(doing, String::from_utf8_lossy(&unfinished).into_owned(), "the line did not end in time")
    }
}
