//! Frames of bytes on a wire: binary questions whose answers say their own length.
//!
//! For Modbus RTU and its like. Knows neither functions nor checksums: how bytes are cut into frames, and which frame is
//! whole, is told by [`FrameHabits`].

use super::{QUIET, RESYNC_TRIES, Wire};
use crate::error::DriverError;
use std::fmt::Write as _;
use std::time::Duration;
use tokio::time::Instant;

/// Tries of the recognisable question on a suspect line of an instrument that never answered it: silence is its answer.
const UNKNOWN_SIGN_TRIES: u32 = 2;

/// Most bytes that wait to be cut: two of the longest Modbus frames.
const BYTES_MAX: usize = 512;

/// What the bytes received so far are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameCut {
    /// The beginning of a frame.
    More,
    /// They begin with a whole frame of so many bytes.
    Whole(usize),
    /// They begin with what is no frame.
    Nonsense(&'static str),
}

/// How an instrument's frames look and how they are kept apart.
#[derive(Debug, Clone)]
pub struct FrameHabits {
    /// Silence between frames.
    pub gap: Duration,
    /// Cuts a frame off, checksum included.
    pub cut: fn(&[u8]) -> FrameCut,
    /// A harmless question whose answer no other question can have.
    pub sign: Option<FrameSign>,
}

/// A question and how its answer is recognised.
#[derive(Debug, Clone)]
pub struct FrameSign {
    /// The question, whole.
    pub question: Vec<u8>,
    /// True for an answer to it; must be false for answers to all other questions.
    pub fits: fn(&[u8]) -> bool,
}

impl Wire {
    /// Sends a frame and gives the one frame that answers it.
    ///
    /// # Errors
    /// As [`Wire::ask`].
    pub async fn ask_frame(
        &mut self,
        habits: &FrameHabits,
        question: &[u8],
        doing: &str,
    ) -> Result<Vec<u8>, DriverError> {
        let answered = self.ask_frame_once(habits, question, doing).await;
        self.outlive(answered).await
    }

    async fn ask_frame_once(
        &mut self,
        habits: &FrameHabits,
        question: &[u8],
        doing: &str,
    ) -> Result<Vec<u8>, DriverError> {
        self.must_be_there(doing)?;
        if !self.suspect {
            let wait = self.free_at.saturating_duration_since(Instant::now()).max(habits.gap);
            self.suspect = !self.no_bytes_for(wait, doing, |_| false).await?;
        }
        if self.suspect {
            self.resync_frames(habits, doing).await?;
        }
        self.suspect = true;
        self.owed = true;
        self.write(question, doing).await?;
        let until = Instant::now() + self.habits.deadline;
        let Some(answer) = self.frame_until(habits.cut, until, doing).await? else {
            let part: Vec<u8> = self.received.drain(..).collect();
            let unfinished = "the frame did not end in time";
            return Err(if part.is_empty() {
                self.silent(doing)
            } else {
                self.garbled(doing, in_hex(&part), unfinished)
            });
        };
        let answer = answer.map_err(|why| {
            let bytes: Vec<u8> = self.received.drain(..).collect();
            self.garbled(doing, in_hex(&bytes), why)
        })?;
        // What follows at once belongs to the answer, which is then no answer to this question alone.
        if !self.no_bytes_for(habits.gap, doing, |_| false).await? {
            return Err(self.garbled(doing, in_hex(&answer), "more bytes than one frame"));
        }
        self.trust();
        Ok(answer)
    }

    /// Drains the line and asks the recognisable question. An instrument that never answered it may not know it; then the
    /// line has been silent for [`UNKNOWN_SIGN_TRIES`] deadlines, and it is tried with the real question.
    async fn resync_frames(&mut self, habits: &FrameHabits, doing: &str) -> Result<(), DriverError> {
        let mut heard = 0;
        let tries = if self.sign_known { RESYNC_TRIES } else { UNKNOWN_SIGN_TRIES };
        for _ in 0..tries {
            heard += self.drain(habits.gap, doing).await?;
            let Some(sign) = &habits.sign else {
                let quiet = if self.owed { self.habits.deadline } else { Duration::ZERO };
                self.drain(quiet, doing).await?;
                self.trust();
                return Ok(());
            };
            self.write(&sign.question, doing).await?;
            let until = Instant::now() + self.habits.deadline;
            let mut recognised = false;
            while let Some(frame) = self.frame_until(habits.cut, until, doing).await? {
                heard += 1;
                match frame {
                    Ok(frame) if (sign.fits)(&frame) => {
                        recognised = true;
                        break;
                    }
                    Ok(_) => {}
                    // Not the start of a frame: the next byte may be.
                    Err(_) => drop(self.received.pop_front()),
                }
            }
            heard += self.received.len();
            if recognised && self.no_bytes_for(QUIET.max(habits.gap), doing, |_| false).await? {
                self.sign_known = true;
                self.trust();
                return Ok(());
            }
        }
        if heard == 0 && !self.sign_known {
            self.trust();
            return Ok(());
        }
        Err(self.not_found_again(doing, "a question of known answer", heard > 0, tries))
    }

    /// The next frame, or why the bytes at hand are none (they stay); `None` when no whole one is there by `until`.
    async fn frame_until(
        &mut self,
        cut: fn(&[u8]) -> FrameCut,
        until: Instant,
        doing: &str,
    ) -> Result<Option<Result<Vec<u8>, &'static str>>, DriverError> {
        loop {
            if !self.received.is_empty() {
                match cut(self.received.make_contiguous()) {
                    FrameCut::Whole(length) => {
                        let length = length.min(self.received.len());
                        return Ok(Some(Ok(self.received.drain(..length).collect())));
                    }
                    FrameCut::Nonsense(why) => return Ok(Some(Err(why))),
                    FrameCut::More if self.received.len() > BYTES_MAX => {
                        return Ok(Some(Err("longer than any frame")));
                    }
                    FrameCut::More => {}
                }
            }
            if !self.fill_until(until, doing).await? {
                return Ok(None);
            }
        }
    }
}

/// Bytes as people read them in a protocol analyser.
fn in_hex(bytes: &[u8]) -> String {
    let mut text = String::new();
    for byte in bytes {
        // Writing to a String cannot fail.
        let _ = write!(text, "{}{byte:02x}", if text.is_empty() { "" } else { " " });
    }
    text
}
