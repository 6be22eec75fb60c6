//! The line to one instrument: lines of text or frames of bytes, each exchange with a deadline.
//!
//! A wire never takes a late answer for the next one: after a time-out, garbage, unasked bytes or an exchange that
//! was dropped half-way the line is suspect, and it is trusted again only when it has been quiet and has answered
//! a recognisable query. A line that has gone (unplugged, reset) is opened again as its [`Reopening`] says, and the
//! exchange that noticed it ends with [`DriverError::Reopened`]: only the driver knows what the instrument must be told
//! again. Knows no command of any instrument.

mod bytes;
mod frames;
mod habits;
mod lines;
mod open;
mod reopen;
mod text;
mod tries;

#[cfg(test)]
mod tests;

pub use frames::{FrameCut, FrameHabits, FrameSign};
pub use habits::{LineHabits, Sign};
pub use lines::{Garbage, LINE_BYTES_MAX, LineDecoder};
pub use open::{Opener, Opening, WireSettings, is_nobody_there};
pub use reopen::Reopening;
pub(crate) use tries::Tries;

use crate::error::DriverError;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

/// Silence that a suspect line must keep before it is asked again. Measured with late answers on pseudo-terminals:
/// an answer that is being sent has no gap of more than some milliseconds at 1200 baud and above. If it were too short,
/// the recognisable query would still catch the rest of the answer; it would only cost another try.
pub const QUIET: Duration = Duration::from_millis(50);

/// How often a suspect line is asked who it is before it counts as dead.
pub const RESYNC_TRIES: u32 = 5;

/// A stream of bytes in both directions.
pub trait ByteStream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<S: AsyncRead + AsyncWrite + Send + Unpin> ByteStream for S {}

/// The line to one instrument.
pub struct Wire {
    name: String,
    stream: Box<dyn ByteStream>,
    habits: LineHabits,
    decoder: LineDecoder,
    received: VecDeque<u8>,
    suspect: bool,
    /// A question was sent whose answer has not come: it may still be on its way.
    owed: bool,
    free_at: Instant,
    opener: Option<Opener>,
    reopening: Reopening,
    /// The instrument has answered its recognisable frame before, so that silence is no answer to it.
    sign_known: bool,
    /// Bits per second, where the line has such a thing.
    baud: Option<u32>,
    /// The stream has ended, and no other is there.
    gone: bool,
}

impl Wire {
    /// A wire over a stream that exists already, for instance an in-memory pipe. `name` says who is at the other end,
    /// as it should stand at the start of an error message. Such a wire cannot be opened again.
    pub fn over(stream: impl ByteStream + 'static, name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            stream: Box::new(stream),
            habits: LineHabits::plain(),
            decoder: LineDecoder::default(),
            received: VecDeque::new(),
            // Whatever was said on the line before is unknown.
            suspect: true,
            owed: false,
            free_at: Instant::now(),
            opener: None,
            reopening: Reopening::never(),
            sign_known: false,
            baud: None,
            gone: false,
        }
    }

    /// Tells the wire how the instrument at its end behaves.
    pub fn adopt(&mut self, habits: LineHabits) {
        self.habits = habits;
    }

    /// Who is at the other end, as messages say it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Bits per second, where the line is a serial one that was opened here.
    pub fn baud(&self) -> Option<u32> {
        self.baud
    }

    /// Longest wait for an answer.
    pub fn deadline(&self) -> Duration {
        self.habits.deadline
    }

    /// What a person should try when the instrument does not answer.
    pub fn hint(&self) -> &'static str {
        self.habits.hint
    }

    /// Declares the line suspect: an answer was a line, but not an answer to the question.
    pub fn distrust(&mut self) {
        self.suspect = true;
    }

    /// The error for an answer that is a line, but not what the driver expected. Declares the line suspect.
    pub fn unexpected(&mut self, doing: &str, answer: &str, why: &str) -> DriverError {
        self.suspect = true;
        self.garbled(doing, answer.to_owned(), why)
    }

    fn silent(&self, doing: &str) -> DriverError {
        DriverError::Silent {
            who: self.name.clone(),
            doing: doing.to_owned(),
            waited: self.habits.deadline,
            tries: 1,
            hint: self.habits.hint.to_owned(),
        }
    }

    fn garbled(&self, doing: &str, answer: String, why: &str) -> DriverError {
        DriverError::Garbled {
            who: self.name.clone(),
            doing: doing.to_owned(),
            answer,
            why: why.to_owned(),
            hint: "Check the baud rate, the cable's shield and that no other program uses the line."
                .to_owned(),
        }
    }

    /// The error of a suspect line that did not come back: dead, or unreadable at every try.
    fn not_found_again(&self, doing: &str, asked: &str, unreadable: bool, tries: u32) -> DriverError {
        let hint = match self.baud {
            _ if !unreadable => self.habits.hint.to_owned(),
            Some(baud) => format!(
                "Something answers, but unreadably at every try: wrong baud rate? The line is set to {baud}; set `baud` \
                 to what the instrument shows in its communication menu, or the instrument to {baud}."
            ),
            None => "Something answers, but unreadably at every try: wrong baud rate at the far end of the connection, or \
                     another kind of instrument."
                .to_owned(),
        };
        DriverError::Silent {
            who: self.name.clone(),
            doing: format!("{doing}: finding the thread again with {asked}"),
            waited: self.habits.deadline,
            tries,
            hint,
        }
    }
}

impl std::fmt::Debug for Wire {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wire")
            .field("name", &self.name)
            .field("suspect", &self.suspect)
            .field("gone", &self.gone)
            .finish_non_exhaustive()
    }
}
