//! The instrument's end of a line: commands in, replies out, and what can go wrong between.
//!
//! Replies, lines of text or frames of bytes, leave in the order in which they were made. A line can be pulled and
//! plugged in again: [`opener`] is the socket of a simulated instrument. Knows no command of any instrument.

use ditd_drivers::error::DriverError;
use ditd_drivers::wire::{ByteStream, FrameCut, Garbage, LineDecoder, Opener, is_nobody_there};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::time::{Instant, sleep, sleep_until};

/// Replies that wait to be sent at most; beyond, new ones are dropped, as a real output buffer does.
const REPLIES_WAITING_MAX: usize = 64;

/// Bytes that an in-memory wire holds before the sender waits: longer than any line of any protocol.
const PIPE_BYTES: usize = 4096;

/// How long to wait when nobody has the other end of a pseudo-terminal open.
const NOBODY_THERE: Duration = Duration::from_millis(200);

/// What goes wrong on the line. Replies are counted from 1; times are seconds of the rig's clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LineFault {
    /// Every `every`-th reply comes late, and those after it queue behind.
    Late {
        /// Which replies.
        every: u64,
        /// By how many seconds.
        delay_s: f64,
    },
    /// Every `every`-th reply has a byte that is not printable.
    Garbled {
        /// Which replies.
        every: u64,
    },
    /// Every `every`-th reply is lost.
    Missing {
        /// Which replies.
        every: u64,
    },
    /// Every `every`-th reply is sent twice.
    Doubled {
        /// Which replies.
        every: u64,
    },
    /// Nothing is answered any more.
    Silent {
        /// Since when.
        from_s: f64,
    },
    /// The plug is pulled and put back later. Whatever the unit remembers besides its plate is then as at delivery.
    Unplugged {
        /// When it is pulled.
        at_s: f64,
        /// For how long.
        for_s: f64,
    },
}

impl LineFault {
    /// Whether the fault can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Late { every, delay_s } => {
                check_every(*every).and_then(|()| check_seconds("delay_s", *delay_s))
            }
            Self::Garbled { every } | Self::Missing { every } | Self::Doubled { every } => {
                check_every(*every)
            }
            Self::Silent { from_s } => check_seconds("from_s", *from_s),
            Self::Unplugged { at_s, for_s } => {
                check_seconds("at_s", *at_s).and_then(|()| check_seconds("for_s", *for_s))
            }
        }
    }
}

/// What every instrument's behaviour on its line must be: a delay of its replies, and faults that can be played.
pub(super) fn check_replies(reply_delay_s: f64, faults: &[LineFault]) -> Result<(), String> {
    check_seconds("reply_delay_s", reply_delay_s)?;
    faults.iter().try_for_each(LineFault::check)
}

fn check_every(every: u64) -> Result<(), String> {
    if every > 0 { Ok(()) } else { Err("every = 0: replies are counted from 1".to_owned()) }
}

/// A time from 0 to the longest that a rig could run.
pub(super) fn check_seconds(name: &str, seconds: f64) -> Result<(), String> {
    // 10^9 s are 32 years.
    if (0.0..=1e9).contains(&seconds) {
        Ok(())
    } else {
        Err(format!("{name} = {seconds}: expected seconds from 0 to 1e9"))
    }
}

/// The socket of a simulated instrument: each opening gives one end of an in-memory wire, and `serve` the other, unless
/// one of `faults` has it unplugged just then. `start` is the zero of the rig's clock.
pub fn opener(
    who: impl Into<String>,
    faults: Vec<LineFault>,
    start: Instant,
    mut serve: impl FnMut(tokio::io::DuplexStream) + Send + 'static,
) -> Opener {
    let who = who.into();
    Box::new(move || {
        let now_s = start.elapsed().as_secs_f64();
        let is_unplugged = faults.iter().any(|fault| {
            matches!(fault, LineFault::Unplugged { at_s, for_s } if (*at_s..at_s + for_s).contains(&now_s))
        });
        let opened: Result<Box<dyn ByteStream>, DriverError> = if is_unplugged {
            Err(DriverError::Missing {
                who: who.clone(),
                why: "the plug is pulled".to_owned(),
                hint: "Plug it in again.".to_owned(),
            })
        } else {
            let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
            serve(theirs);
            Ok(Box::new(ours))
        };
        Box::pin(std::future::ready(opened))
    })
}

/// How an instrument treats a reply that was not yet sent when the next command comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unsent {
    /// It is sent all the same.
    Kept,
    /// It is lost.
    Lost,
}

struct Reply {
    bytes: Vec<u8>,
    sent: usize,
    due: Instant,
    losable: bool,
}

/// The instrument's end of a line.
pub struct Line<S> {
    input: ReadHalf<S>,
    output: WriteHalf<S>,
    decoder: LineDecoder,
    received: VecDeque<u8>,
    replies: VecDeque<Reply>,
    replies_made: u64,
    faults: Vec<LineFault>,
    unsent: Unsent,
    start: Instant,
    plugged: Instant,
}

impl<S: AsyncRead + AsyncWrite> Line<S> {
    /// The end of a line over a stream; `start` is the zero of the rig's clock.
    pub fn new(stream: S, faults: Vec<LineFault>, unsent: Unsent, start: Instant) -> Self {
        let (input, output) = tokio::io::split(stream);
        Self {
            input,
            output,
            decoder: LineDecoder::default(),
            received: VecDeque::new(),
            replies: VecDeque::new(),
            replies_made: 0,
            faults,
            unsent,
            start,
            plugged: Instant::now(),
        }
    }

    /// The next command; replies are sent meanwhile. `None` when the other side has gone for good or the plug was pulled.
    /// May be dropped at any point without losing anything.
    pub async fn next_command(&mut self) -> Option<Result<String, Garbage>> {
        loop {
            while let Some(byte) = self.received.pop_front() {
                if let Some(command) = self.decoder.push(byte) {
                    self.forget_unsent();
                    return Some(command);
                }
            }
            self.listen().await?;
        }
    }

    /// The next frame that `cut` finds, as [`Line::next_command`]; bytes that begin none are dropped.
    pub async fn next_frame(&mut self, cut: fn(&[u8]) -> FrameCut) -> Option<Vec<u8>> {
        loop {
            while !self.received.is_empty() {
                match cut(self.received.make_contiguous()) {
                    FrameCut::Whole(length) => {
                        let length = length.min(self.received.len());
                        let frame = self.received.drain(..length).collect();
                        self.forget_unsent();
                        return Some(frame);
                    }
                    FrameCut::Nonsense(_) => drop(self.received.pop_front()),
                    FrameCut::More => break,
                }
            }
            self.listen().await?;
        }
    }

    fn forget_unsent(&mut self) {
        if self.unsent == Unsent::Lost {
            self.replies.retain(|reply| reply.sent > 0 || !reply.losable);
        }
    }

    /// Sends or receives something. `None` when there is nobody any more.
    async fn listen(&mut self) -> Option<()> {
        let mut chunk = [0; 256];
        let due = self.replies.front().map_or_else(Instant::now, |reply| reply.due);
        let pulled = self.pulled();
        tokio::select! {
            biased;
            () = sleep_until(pulled.unwrap_or(due)), if pulled.is_some() => return None,
            read = self.input.read(&mut chunk) => match read {
                Ok(0) => return None,
                Ok(count) => self.received.extend(&chunk[..count]),
                Err(error) if is_nobody_there(&error) => sleep(NOBODY_THERE).await,
                Err(_) => return None,
            },
            sent = send(&mut self.output, self.replies.front(), due), if !self.replies.is_empty() => {
                match sent {
                    Ok(count) => self.note_sent(count),
                    Err(error) if is_nobody_there(&error) => self.replies.clear(),
                    Err(_) => return None,
                }
            }
        }
        Some(())
    }

    /// When the plug will be pulled next; pullings from before this line was plugged in are over.
    fn pulled(&self) -> Option<Instant> {
        let pullings = self.faults.iter().filter_map(|fault| match fault {
            LineFault::Unplugged { at_s, .. } => Some(self.start + Duration::from_secs_f64(*at_s)),
            _ => None,
        });
        pullings.filter(|at| *at > self.plugged).min()
    }

    /// Queues a reply, with its line end, to be sent after `delay`.
    pub fn reply(&mut self, text: &str, delay: Duration) {
        self.reply_bytes(text.as_bytes().to_vec(), delay);
    }

    /// Queues a frame to be sent after `delay`.
    pub fn reply_bytes(&mut self, mut bytes: Vec<u8>, delay: Duration) {
        self.replies_made += 1;
        let mut due = Instant::now() + delay;
        let mut losable = true;
        let count = self.replies_made;
        let hits = |every: &u64| count.is_multiple_of(*every);
        for fault in &self.faults {
            match fault {
                LineFault::Late { every, delay_s } if hits(every) => {
                    due += Duration::from_secs_f64(*delay_s);
                    // It is on its way already: no later command calls it back.
                    losable = false;
                }
                LineFault::Garbled { every } if hits(every) => {
                    let middle = bytes.len() / 2;
                    bytes[middle] = if bytes[middle] == 0x07 { 0x08 } else { 0x07 };
                }
                LineFault::Missing { every } if hits(every) => return,
                LineFault::Doubled { every } if hits(every) => bytes = bytes.repeat(2),
                LineFault::Silent { from_s } if self.start.elapsed().as_secs_f64() >= *from_s => return,
                _ => {}
            }
        }
        if self.replies.len() < REPLIES_WAITING_MAX {
            // Behind a late one everything is late.
            let due = self.replies.back().map_or(due, |last| due.max(last.due));
            self.replies.push_back(Reply { bytes, sent: 0, due, losable });
        }
    }

    /// Seconds of the rig's clock.
    pub fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn note_sent(&mut self, count: usize) {
        if let Some(reply) = self.replies.front_mut() {
            reply.sent += count;
            if reply.sent >= reply.bytes.len() {
                self.replies.pop_front();
            }
        }
    }
}

/// Sends some of a reply when it is due; dropped half-way, nothing was sent.
async fn send<S: AsyncWrite>(
    output: &mut WriteHalf<S>,
    reply: Option<&Reply>,
    due: Instant,
) -> io::Result<usize> {
    let Some(reply) = reply else { return Ok(0) };
    sleep_until(due).await;
    output.write(&reply.bytes[reply.sent..]).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::duplex;

    /// A line whose commands are answered by themselves, 100 ms later.
    async fn parrot(stream: tokio::io::DuplexStream, faults: Vec<LineFault>, unsent: Unsent) {
        let mut line = Line::new(stream, faults, unsent, Instant::now());
        while let Some(command) = line.next_command().await {
            line.reply(&format!("{}\r", command.unwrap()), Duration::from_millis(100));
        }
    }

    async fn heard(faults: Vec<LineFault>, unsent: Unsent, said: &[&str]) -> String {
        let (mut near, far) = duplex(256);
        tokio::spawn(parrot(far, faults, unsent));
        for text in said {
            // A plug that was pulled takes no more.
            let _ = near.write_all(text.as_bytes()).await;
            sleep(Duration::from_millis(50)).await;
        }
        let mut bytes = vec![0; 256];
        let mut heard = String::new();
        while let Ok(Ok(count @ 1..)) =
            tokio::time::timeout(Duration::from_secs(60), near.read(&mut bytes)).await
        {
            heard.push_str(&String::from_utf8_lossy(&bytes[..count]));
        }
        heard
    }

    #[tokio::test(start_paused = true)]
    async fn an_unread_reply_is_lost_where_the_instrument_loses_it() {
        let said = ["a\r", "b\r", "c\r"];
        assert_eq!(heard(vec![], Unsent::Kept, &said).await, "a\rb\rc\r");
        assert_eq!(heard(vec![], Unsent::Lost, &said).await, "c\r");
    }

    #[tokio::test(start_paused = true)]
    async fn every_fault_shows() {
        let said = ["ab\r", "cd\r", "ef\r"];
        for (fault, expected) in [
            (LineFault::Late { every: 2, delay_s: 5.0 }, "ab\rcd\ref\r"),
            (LineFault::Garbled { every: 2 }, "ab\rc\u{7}\ref\r"),
            (LineFault::Missing { every: 2 }, "ab\ref\r"),
            (LineFault::Doubled { every: 2 }, "ab\rcd\rcd\ref\r"),
            (LineFault::Silent { from_s: 0.07 }, "ab\rcd\r"),
            (LineFault::Unplugged { at_s: 0.12, for_s: 9.0 }, "ab\r"),
        ] {
            assert_eq!(heard(vec![fault.clone()], Unsent::Kept, &said).await, expected, "{fault:?}");
        }
    }

    #[test]
    fn impossible_faults_are_named() {
        for (fault, name) in [
            (LineFault::Late { every: 1, delay_s: -1.0 }, "delay_s"),
            (LineFault::Late { every: 0, delay_s: 1.0 }, "every"),
            (LineFault::Silent { from_s: f64::NAN }, "from_s"),
        ] {
            assert!(fault.check().unwrap_err().starts_with(name), "{fault:?}");
        }
        assert_eq!(LineFault::Doubled { every: 3 }.check(), Ok(()));
    }

    #[tokio::test(start_paused = true)]
    async fn a_late_reply_cannot_be_called_back() {
        let late = LineFault::Late { every: 1, delay_s: 5.0 };
        assert_eq!(heard(vec![late], Unsent::Lost, &["a\r", "b\r"]).await, "a\rb\r");
    }

    #[tokio::test(start_paused = true)]
    async fn a_socket_is_empty_while_the_plug_is_pulled() {
        let start = Instant::now();
        let faults = vec![LineFault::Unplugged { at_s: 10.0, for_s: 5.0 }];
        let served = faults.clone();
        let mut opener = opener("parrot", faults, start, move |stream| {
            let mut line = Line::new(stream, served.clone(), Unsent::Kept, start);
            tokio::spawn(async move { while line.next_command().await.is_some() {} });
        });
        let mut first = opener().await.unwrap();
        sleep(Duration::from_secs(9)).await;
        let mut byte = [0];
        let pulled = first.read(&mut byte).await.unwrap();
        assert_eq!((pulled, start.elapsed()), (0, Duration::from_secs(10)));
        assert!(opener().await.is_err());
        sleep(Duration::from_secs(5)).await;
        let mut second = opener().await.unwrap();
        let read = tokio::time::timeout(Duration::from_secs(3600), second.read(&mut byte)).await;
        assert!(read.is_err(), "it is pulled once");
    }
}
