//! The line to one instrument: lines of text out and in, each exchange with a deadline.
//!
//! A wire never takes a late answer for the next one: after a time-out, garbage, unasked bytes or an exchange that
//! was dropped half-way the line is suspect, and it is trusted again only when it has been quiet and has answered
//! a recognisable query. Knows no command of any instrument, and does not reopen a line that has gone.

use crate::error::DriverError;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::{Instant, timeout, timeout_at};
use tokio_serial::SerialPortBuilderExt;

/// Longest line that is accepted, in bytes without its end. The longest answer of the supported instruments (a list
/// of channels) has some 60; what is longer is noise, and is rejected as such.
pub const LINE_BYTES_MAX: usize = 256;

/// Silence that a suspect line must keep before it is asked again. Measured with late answers on pseudo-terminals:
/// an answer that is being sent has no gap of more than some milliseconds at 1200 baud and above. If it were too short,
/// the recognisable query would still catch the rest of the answer; it would only cost another try.
pub const QUIET: Duration = Duration::from_millis(50);

/// How long a suspect line is drained before it is given up as babbling.
const QUIET_DEADLINE: Duration = Duration::from_secs(3);

/// How often a suspect line is asked who it is before it counts as dead.
pub const RESYNC_TRIES: u32 = 5;

/// Lines that one try of finding the thread again reads at most.
const RESYNC_LINES_MAX: u32 = 64;

/// How long a TCP connection may take to open.
const CONNECT_DEADLINE: Duration = Duration::from_secs(5);

/// A stream of bytes in both directions.
pub trait ByteStream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<S: AsyncRead + AsyncWrite + Send + Unpin> ByteStream for S {}

/// What is set when a line is opened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WireSettings {
    /// Bits per second of a serial line (8 data bits, no parity, 1 stop bit); without meaning on TCP.
    pub baud: u32,
}

/// How an instrument behaves on its line; its driver says so.
#[derive(Debug, Clone, Copy)]
pub struct LineHabits {
    /// What ends a command.
    pub ending: &'static str,
    /// Longest wait for an answer.
    pub deadline: Duration,
    /// Shortest time from the end of an exchange to the next command; the line must be silent meanwhile.
    pub pace: Duration,
    /// A harmless query that is answered recognisably, for finding the thread again.
    pub sign: Option<Sign>,
    /// What a person should try when the instrument does not answer.
    pub hint: &'static str,
}

/// A query and how its answer is recognised.
#[derive(Debug, Clone, Copy)]
pub struct Sign {
    /// The query.
    pub query: &'static str,
    /// True for an answer to it; must be false for answers to all other queries.
    pub fits: fn(&str) -> bool,
}

impl LineHabits {
    /// For a stream about whose instrument nothing is known yet: CR, one second, no pause, no sign.
    pub fn plain() -> Self {
        Self {
            ending: "\r",
            deadline: Duration::from_secs(1),
            pace: Duration::ZERO,
            sign: None,
            hint: "Check power and cable.",
        }
    }
}

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

/// The line to one instrument.
pub struct Wire {
    name: String,
    stream: Box<dyn ByteStream>,
    habits: LineHabits,
    decoder: LineDecoder,
    received: VecDeque<u8>,
    suspect: bool,
    free_at: Instant,
}

impl Wire {
    /// A wire over a stream that exists already, for instance an in-memory pipe. `name` says who is at the other end,
    /// as it should stand at the start of an error message.
    pub fn over(stream: impl ByteStream + 'static, name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            stream: Box::new(stream),
            habits: LineHabits::plain(),
            decoder: LineDecoder::default(),
            received: VecDeque::new(),
            // Whatever was said on the line before is unknown.
            suspect: true,
            free_at: Instant::now(),
        }
    }

    /// Opens `serial:/dev/…` or `tcp:host:port`. `role` is the instrument's part in the rig, for messages.
    ///
    /// # Errors
    /// [`DriverError::Missing`] when the address is malformed, or the device is absent, busy or not permitted.
    pub async fn open(address: &str, role: &str, settings: &WireSettings) -> Result<Self, DriverError> {
        let who = format!("{role} at {address}");
        let missing =
            |why: String, hint: &str| DriverError::Missing { who: who.clone(), why, hint: hint.to_owned() };
        match address.split_once(':') {
            Some(("serial", path)) => match tokio_serial::new(path, settings.baud).open_native_async() {
                Ok(port) => Ok(Self::over(port, who)),
                Err(error) => Err(missing(error.to_string(), serial_hint(&error.to_string()))),
            },
            Some(("tcp", peer)) => {
                match timeout(CONNECT_DEADLINE, tokio::net::TcpStream::connect(peer)).await {
                    Ok(Ok(stream)) => Ok(Self::over(stream, who)),
                    Ok(Err(error)) => Err(missing(
                        error.to_string(),
                        "Check that the instrument is on, the network cable plugged, and host and port right.",
                    )),
                    Err(_) => Err(missing(
                        format!("no connection in {} s", CONNECT_DEADLINE.as_secs()),
                        "Check the host name, the route and any firewall between here and the instrument.",
                    )),
                }
            }
            _ => Err(missing(
                "the address names no kind of line".to_owned(),
                "Write serial:/dev/serial/by-id/… or tcp:host:port.",
            )),
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

    /// Sends a command that has no answer.
    ///
    /// # Errors
    /// As for [`Wire::ask`], except that nothing is waited for after the command.
    pub async fn tell(&mut self, command: &str, doing: &str) -> Result<(), DriverError> {
        self.make_ready(doing).await?;
        self.suspect = true;
        self.write_line(command, doing).await?;
        self.suspect = false;
        Ok(())
    }

    /// Sends a question and gives its one answer. A single echo of the question is skipped: no instrument here
    /// answers a question with the question.
    ///
    /// # Errors
    /// [`DriverError::Silent`] without an answer within the deadline, [`DriverError::Garbled`] for a rejected line,
    /// [`DriverError::Lost`] when the line has ended.
    pub async fn ask(&mut self, question: &str, doing: &str) -> Result<String, DriverError> {
        self.make_ready(doing).await?;
        // Stays set if this future is dropped half-way: the answer is then still to come.
        self.suspect = true;
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
        self.free_at = Instant::now() + self.habits.pace;
        Ok(answer)
    }

    /// Waits for silence, drains the line, and asks the recognisable query until its answer, and nothing after it,
    /// has come.
    ///
    /// # Errors
    /// [`DriverError::Silent`] when no try was answered, [`DriverError::Garbled`] when the line never falls silent,
    /// [`DriverError::Lost`] when it has ended.
    pub async fn resync(&mut self, doing: &str) -> Result<(), DriverError> {
        self.suspect = true;
        let Some(sign) = self.habits.sign else {
            self.drain(doing).await?;
            self.suspect = false;
            return Ok(());
        };
        for _ in 0..RESYNC_TRIES {
            self.drain(doing).await?;
            self.write_line(sign.query, doing).await?;
            let until = Instant::now() + self.habits.deadline;
            let mut recognised = false;
            for _ in 0..RESYNC_LINES_MAX {
                match self.line_until(until, doing).await? {
                    None => break,
                    Some(Ok(line)) if (sign.fits)(&line) => {
                        recognised = true;
                        break;
                    }
                    Some(_) => {}
                }
            }
            if recognised && self.is_quiet_for(QUIET, doing).await? {
                self.suspect = false;
                self.free_at = Instant::now();
                return Ok(());
            }
        }
        Err(DriverError::Silent {
            who: self.name.clone(),
            doing: format!("{doing}: finding the thread again with {}", sign.query),
            waited: self.habits.deadline,
            tries: RESYNC_TRIES,
            hint: self.habits.hint.to_owned(),
        })
    }

    /// The error for an answer that is a line, but not what the driver expected. Declares the line suspect.
    pub fn unexpected(&mut self, doing: &str, answer: &str, why: &str) -> DriverError {
        self.suspect = true;
        self.garbled(doing, answer.to_owned(), why)
    }

    /// Lets the pace pass. Bytes that nobody asked for, other than the LF of a CR LF, make the line suspect.
    async fn make_ready(&mut self, doing: &str) -> Result<(), DriverError> {
        if !self.suspect {
            let wait = self.free_at.saturating_duration_since(Instant::now());
            self.suspect = !self.is_quiet_for(wait, doing).await?;
        }
        if self.suspect { self.resync(doing).await } else { Ok(()) }
    }

    /// True when nothing but line ends comes within `wait`; at least what has arrived already is looked at.
    async fn is_quiet_for(&mut self, wait: Duration, doing: &str) -> Result<bool, DriverError> {
        let until = Instant::now() + wait;
        loop {
            while let Some(byte) = self.received.pop_front() {
                if !matches!(byte, b'\r' | b'\n') {
                    self.received.clear();
                    return Ok(false);
                }
            }
            if !self.fill_until(until, doing).await? {
                return Ok(true);
            }
        }
    }

    /// Reads and drops until the line has been quiet for [`QUIET`].
    async fn drain(&mut self, doing: &str) -> Result<(), DriverError> {
        let give_up = Instant::now() + QUIET_DEADLINE;
        self.decoder.take();
        self.received.clear();
        while self.fill_until(Instant::now() + QUIET, doing).await? {
            self.received.clear();
            if Instant::now() >= give_up {
                return Err(self.garbled(doing, String::new(), "the line never falls silent"));
            }
        }
        Ok(())
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

    /// Reads once; false when nothing came by `until`.
    async fn fill_until(&mut self, until: Instant, doing: &str) -> Result<bool, DriverError> {
        let mut chunk = [0; LINE_BYTES_MAX];
        match timeout_at(until, self.stream.read(&mut chunk)).await {
            Err(_) => Ok(false),
            Ok(Ok(0)) => Err(self.lost(doing, "the other side closed it".to_owned())),
            Ok(Ok(count)) => {
                self.received.extend(&chunk[..count]);
                Ok(true)
            }
            Ok(Err(error)) => Err(self.lost(doing, error.to_string())),
        }
    }

    async fn write_line(&mut self, line: &str, doing: &str) -> Result<(), DriverError> {
        self.decoder.take();
        let bytes = [line.as_bytes(), self.habits.ending.as_bytes()].concat();
        let deadline = self.habits.deadline;
        let written = timeout(deadline, async {
            self.stream.write_all(&bytes).await?;
            self.stream.flush().await
        })
        .await;
        self.free_at = Instant::now() + self.habits.pace;
        match written {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(self.lost(doing, error.to_string())),
            Err(_) => Err(self.silent(doing)),
        }
    }

    fn no_answer(&mut self, doing: &str) -> DriverError {
        let unfinished = self.decoder.take();
        if unfinished.is_empty() {
            return self.silent(doing);
        }
        self.garbled(doing, String::from_utf8_lossy(&unfinished).into_owned(), "the line did not end in time")
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

    fn lost(&self, doing: &str, why: String) -> DriverError {
        DriverError::Lost {
            who: self.name.clone(),
            doing: doing.to_owned(),
            why,
            hint: "Plug it in again and check its power.".to_owned(),
        }
    }
}

impl std::fmt::Debug for Wire {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wire")
            .field("name", &self.name)
            .field("suspect", &self.suspect)
            .finish_non_exhaustive()
    }
}

/// What to try when a serial port does not open. The serial library gives absent, busy and forbidden ports one kind
/// of error; only its text tells them apart.
fn serial_hint(why: &str) -> &'static str {
    let why = why.to_lowercase();
    if why.contains("permission") || why.contains("denied") {
        "Add the user to the group that owns the port (often dialout), then log in again."
    } else if why.contains("lock") || why.contains("busy") {
        "Another program holds the port: stop it (a second daemon, a terminal program, a modem manager)."
    } else {
        "Check the cable, and name the port by /dev/serial/by-id/…: USB adapters change their numbers."
    }
}

/// True when an error of a pseudo-terminal's master side means that nobody has the other side open.
pub fn is_nobody_there(error: &io::Error) -> bool {
    // EIO, Linux and macOS alike.
    error.raw_os_error() == Some(5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tokio::io::duplex;

    const SIGN: Sign = Sign { query: "*IDN?", fits: |line| line.starts_with("SIM,") };

    fn habits() -> LineHabits {
        LineHabits { pace: Duration::from_millis(5), sign: Some(SIGN), ..LineHabits::plain() }
    }

    fn lines(bytes: &[u8]) -> Vec<Result<String, Garbage>> {
        let mut decoder = LineDecoder::default();
        bytes.iter().filter_map(|byte| decoder.push(*byte)).collect()
    }

    #[test]
    fn a_lone_cr_ends_a_line_at_once() {
        let mut decoder = LineDecoder::default();
        assert!(b"24.1".iter().all(|byte| decoder.push(*byte).is_none()));
        assert_eq!(decoder.push(b'\r'), Some(Ok("24.1".to_owned())));
        assert_eq!(decoder.push(b'\n'), None);
    }

    #[test]
    fn every_line_end_is_understood_and_empty_lines_are_skipped() {
        let expected: Vec<_> = ["a", "b", "c", "d"].map(|line| Ok(line.to_owned())).into();
        assert_eq!(lines(b"\r\na\rb\nc\r\n\r\r\n\nd\r"), expected);
    }

    #[test]
    fn unprintable_bytes_and_overlong_lines_are_rejected_and_the_next_line_is_good() {
        let got = lines(b"2\x014\r25.0\r");
        assert!(got[0].is_err());
        assert_eq!(got[1], Ok("25.0".to_owned()));
        let mut long = vec![b'1'; LINE_BYTES_MAX + 1];
        long.extend(b"\r7\r");
        let got = lines(&long);
        assert!(got[0].is_err());
        assert_eq!(got[1], Ok("7".to_owned()));
        assert_eq!(lines(&[&[b'1'; LINE_BYTES_MAX][..], b"\r"].concat())[0].as_ref().unwrap().len(), 256);
    }

    proptest! {
        #[test]
        fn any_printable_lines_survive_any_line_end(
            texts in prop::collection::vec("[ -~]{1,40}", 0..8),
            ending in prop::sample::select(vec!["\r", "\n", "\r\n"]),
        ) {
            let bytes: String = texts.iter().map(|text| format!("{text}{ending}")).collect();
            let got: Vec<_> = lines(bytes.as_bytes()).into_iter().map(Result::unwrap).collect();
            prop_assert_eq!(got, texts);
        }
    }

    /// An instrument that answers `nN?` with `N`; every `late`-th answer comes after `delay`.
    async fn counter(mut stream: tokio::io::DuplexStream, late: u64, delay: Duration) {
        let mut decoder = LineDecoder::default();
        let mut count = 0_u64;
        while let Ok(byte) = stream.read_u8().await {
            let Some(Ok(line)) = decoder.push(byte) else { continue };
            count += 1;
            if count.is_multiple_of(late) {
                tokio::time::sleep(delay).await;
            }
            let answer = if line == "*IDN?" {
                "SIM,1,2,3\r".to_owned()
            } else {
                format!("{}\r", line.trim_start_matches('n').trim_end_matches('?'))
            };
            if stream.write_all(answer.as_bytes()).await.is_err() {
                return;
            }
        }
    }

    /// 720 questions, every seventh answer late by more than the deadline: each answer that is accepted is the answer
    /// to its own question.
    #[tokio::test(start_paused = true)]
    async fn late_answer_is_not_taken_for_the_next() {
        for delay_ms in [1010, 1049, 1051, 1100, 1500, 2300, 3900] {
            let (near, far) = duplex(64);
            tokio::spawn(counter(far, 7, Duration::from_millis(delay_ms)));
            let mut wire = Wire::over(near, "counter");
            wire.adopt(habits());
            let (mut good, mut late) = (0, 0);
            for index in 0..720 {
                match wire.ask(&format!("n{index}?"), "counting").await {
                    Ok(answer) => {
                        assert_eq!(answer, index.to_string(), "stale at {delay_ms} ms");
                        good += 1;
                    }
                    Err(_) => late += 1,
                }
            }
            // Not a matter of luck: at least every second question gets its own answer.
            assert!(good > 360 && late > 50, "{good} good, {late} late at {delay_ms} ms");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_doubled_answer_is_not_taken_for_the_next() {
        let (near, mut far) = duplex(64);
        let peer = tokio::spawn(async move {
            let mut decoder = LineDecoder::default();
            let mut asked = 0;
            while let Ok(byte) = far.read_u8().await {
                let answer = match decoder.push(byte) {
                    Some(Ok(line)) if line == "*IDN?" => "SIM,1\r",
                    Some(Ok(_)) => {
                        asked += 1;
                        if asked == 1 { "11\r11\r" } else { "22\r" }
                    }
                    _ => continue,
                };
                far.write_all(answer.as_bytes()).await.unwrap();
            }
        });
        let mut wire = Wire::over(near, "doubled");
        wire.adopt(habits());
        assert_eq!(wire.ask("a?", "asking").await.unwrap(), "11");
        assert_eq!(wire.ask("b?", "asking").await.unwrap(), "22");
        drop(wire);
        peer.await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn an_exchange_dropped_half_way_leaves_no_stale_answer() {
        let (near, far) = duplex(64);
        tokio::spawn(counter(far, 3, Duration::from_millis(300)));
        let mut wire = Wire::over(near, "counter");
        wire.adopt(habits());
        for index in 0..30 {
            let question = format!("n{index}?");
            let asked = timeout(Duration::from_millis(100), wire.ask(&question, "counting")).await;
            if let Ok(answer) = asked {
                assert_eq!(answer.unwrap(), index.to_string());
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_echo_is_skipped_once() {
        let (near, mut far) = duplex(64);
        tokio::spawn(async move {
            let mut seen = [0; 64];
            while let Ok(count @ 1..) = far.read(&mut seen).await {
                far.write_all(&seen[..count]).await.unwrap();
                far.write_all(b"ok\r\n").await.unwrap();
            }
        });
        let mut wire = Wire::over(near, "echo");
        wire.adopt(LineHabits { ending: "\r\n", ..LineHabits::plain() });
        assert_eq!(wire.ask(":PULSE1:STATE 1", "setting").await.unwrap(), "ok");
    }

    #[tokio::test(start_paused = true)]
    async fn silence_is_silent_and_a_closed_line_is_lost() {
        let (near, far) = duplex(64);
        let mut wire = Wire::over(near, "nobody");
        wire.adopt(habits());
        let error = wire.ask("a?", "asking").await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { tries: RESYNC_TRIES, .. }), "{error}");
        drop(far);
        let error = wire.ask("a?", "asking").await.unwrap_err();
        assert!(matches!(error, DriverError::Lost { .. }), "{error}");
        assert!(error.is_missing_device());
    }

    #[tokio::test(start_paused = true)]
    async fn an_unfinished_line_is_garbled_not_silent() {
        let (near, mut far) = duplex(64);
        let mut wire = Wire::over(near, "half");
        wire.adopt(LineHabits { sign: None, ..habits() });
        let peer = tokio::spawn(async move {
            let mut seen = [0; 8];
            far.read_exact(&mut seen[..3]).await.unwrap();
            far.write_all(b"24.").await.unwrap();
            far
        });
        let error = wire.ask("a?", "asking").await.unwrap_err();
        assert!(matches!(error, DriverError::Garbled { ref answer, .. } if answer == "24."), "{error}");
        peer.await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn a_babbling_line_is_given_up() {
        let (near, mut far) = duplex(64);
        tokio::spawn(async move {
            while far.write_all(b"x").await.is_ok() {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        });
        let mut wire = Wire::over(near, "babbler");
        wire.adopt(habits());
        let error = wire.ask("a?", "asking").await.unwrap_err();
        assert!(matches!(error, DriverError::Garbled { .. }), "{error}");
    }

    /// Real time, on a pseudo-terminal: the path of a real port, and what a second daemon gets.
    #[cfg(unix)]
    #[tokio::test]
    async fn a_serial_port_is_opened_once_and_carries_lines() {
        use tokio_serial::{SerialPort, SerialStream};
        let (mut far, near) = SerialStream::pair().unwrap();
        let address = format!("serial:{}", near.name().unwrap());
        drop(near);
        let settings = WireSettings { baud: 9600 };
        let mut wire = Wire::open(&address, "plate calibrator", &settings).await.unwrap();
        wire.adopt(LineHabits { sign: None, ..habits() });
        let error = Wire::open(&address, "plate calibrator", &settings).await.unwrap_err();
        assert!(error.to_string().contains("Another program"), "{error}");
        let answered = tokio::spawn(async move {
            let mut bytes = [0; 3];
            far.read_exact(&mut bytes).await.unwrap();
            far.write_all(b"24.091\r").await.unwrap();
            // Held open until the other side has read.
            far
        });
        assert_eq!(wire.ask("T?", "asking").await.unwrap(), "24.091");
        drop(answered.await.unwrap());
        let error = wire.ask("T?", "asking").await.unwrap_err();
        assert!(matches!(error, DriverError::Lost { .. }), "{error}");
    }

    #[tokio::test]
    async fn what_cannot_be_opened_is_missing_and_says_what_to_try() {
        let settings = WireSettings { baud: 9600 };
        for address in ["serial:/dev/no-such-port", "tcp:127.0.0.1:1", "/dev/ttyUSB0"] {
            let error = Wire::open(address, "plate calibrator", &settings).await.unwrap_err();
            assert!(matches!(error, DriverError::Missing { .. }), "{error}");
            assert!(error.to_string().starts_with(&format!("plate calibrator at {address}")), "{error}");
        }
        assert!(serial_hint("Permission denied").contains("dialout"));
        assert!(serial_hint("Unable to acquire exclusive lock on serial port").contains("Another program"));
    }
}
