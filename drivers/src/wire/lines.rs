//! Cuts bytes into lines of text.

/// Longest line that is accepted, in bytes without its end. The longest answer of the supported instruments (a list
/// of channels) has some 60; what is longer is noise, and is rejected as such.
pub const LINE_BYTES_MAX: usize = 256;

/// A line that was rejected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Garbage {
    /// What was received, lossily as text, capped at [`LINE_BYTES_MAX`] bytes.
    pub received: String,
    /// Why it is no line.
    pub why: &'static str,
}

/// Cuts bytes into lines.
///
/// CR, LF or CR LF ends a line, a lone CR at once; empty lines are skipped, so that the LF of a CR LF vanishes.
/// Bytes outside 0x20 … 0x7e reject the whole line.
///
/// ```
/// let mut decoder = ditd_drivers::wire::LineDecoder::default();
/// let lines: Vec<_> = b"24.091\r50.000\r\n".iter().filter_map(|byte| decoder.push(*byte)).collect();
/// assert_eq!(lines, [Ok("24.091".to_owned()), Ok("50.000".to_owned())]);
/// ```
#[derive(Debug, Clone, Default)]
pub struct LineDecoder {
    bytes: Vec<u8>,
    why: Option<&'static str>,
}

impl LineDecoder {
    /// Takes one byte; gives a line when the byte ended one.
    pub fn push(&mut self, byte: u8) -> Option<Result<String, Garbage>> {
        if matches!(byte, b'\r' | b'\n') {
            return self.end();
        }
        if !(0x20..=0x7e).contains(&byte) {
            self.why = Some("a byte that is not printable");
        }
        if self.bytes.len() < LINE_BYTES_MAX {
            self.bytes.push(byte);
        } else {
            self.why = Some("longer than any answer");
        }
        None
    }

    /// Forgets an unfinished line and gives its bytes.
    pub fn take(&mut self) -> Vec<u8> {
        self.why = None;
        std::mem::take(&mut self.bytes)
    }

    fn end(&mut self) -> Option<Result<String, Garbage>> {
        let why = self.why;
        let bytes = self.take();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        match why {
            Some(why) => Some(Err(Garbage { received: text, why })),
            None if bytes.is_empty() => None,
            None => Some(Ok(text)),
        }
    }
}
