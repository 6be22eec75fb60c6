//! Lines, lateness, loss: the wire against peers that misbehave.

use super::open::serial_hint;
use super::*;
use proptest::prelude::*;
use std::time::Duration;
use tokio::io::duplex;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::timeout;

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
    let wire = Wire::open(&address, "plate calibrator", &settings).await.unwrap();
    let mut wire = wire.reopening(Reopening::never());
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

/// A line that can be pulled and plugged: what is opened next, and a count of openings.
struct Socket {
    peers: std::sync::Arc<std::sync::Mutex<VecDeque<tokio::io::DuplexStream>>>,
}

impl Socket {
    fn new() -> Self {
        Self { peers: std::sync::Arc::default() }
    }

    /// Gives the far end of what the next opening connects to.
    fn plug(&self) -> tokio::io::DuplexStream {
        let (near, far) = duplex(64);
        self.peers.lock().unwrap().push_back(near);
        far
    }

    fn opener(&self) -> Opener {
        let peers = std::sync::Arc::clone(&self.peers);
        Box::new(move || {
            let next = peers.lock().unwrap().pop_front();
            Box::pin(async move {
                match next {
                    Some(stream) => Ok(Box::new(stream) as Box<dyn ByteStream>),
                    None => Err(DriverError::Missing {
                        who: "socket".to_owned(),
                        why: "nothing is plugged in".to_owned(),
                        hint: String::new(),
                    }),
                }
            })
        })
    }
}

async fn plugged(socket: &Socket) -> Wire {
    let mut wire = Wire::plugged(socket.opener(), "socket").await.unwrap();
    wire.adopt(habits());
    wire
}

#[tokio::test(start_paused = true)]
async fn a_line_that_is_back_in_time_is_told_as_reopened_and_works_again() {
    let socket = Socket::new();
    tokio::spawn(counter(socket.plug(), 1000, Duration::ZERO));
    let mut wire = plugged(&socket).await;
    assert_eq!(wire.ask("n1?", "counting").await.unwrap(), "1");
    // Pulled: a peer that ends; plugged in again 3.2 s later.
    drop(std::mem::replace(&mut wire.stream, Box::new(duplex(8).0)));
    let peers = std::sync::Arc::clone(&socket.peers);
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(3200)).await;
        let (near, far) = duplex(64);
        peers.lock().unwrap().push_back(near);
        counter(far, 1000, Duration::ZERO).await;
    });
    let begun = Instant::now();
    let error = wire.ask("n2?", "counting").await.unwrap_err();
    assert!(error.is_reopened(), "{error}");
    assert!(error.to_string().contains("counting: the line was gone"), "{error}");
    assert!(begun.elapsed() <= Duration::from_millis(3700), "{:?}", begun.elapsed());
    // The question was not repeated; the next one finds the thread first.
    assert_eq!(wire.ask("n3?", "counting").await.unwrap(), "3");
}

#[tokio::test(start_paused = true)]
async fn a_line_that_stays_away_is_lost_and_later_exchanges_do_not_wait() {
    let socket = Socket::new();
    drop(socket.plug());
    let mut wire = plugged(&socket).await;
    let begun = Instant::now();
    let error = wire.ask("n1?", "counting").await.unwrap_err();
    assert!(matches!(error, DriverError::Lost { .. }), "{error}");
    assert!(
        error.to_string().contains("tried to open it again 21 times in 10.0 s: nothing is plugged"),
        "{error}"
    );
    assert_eq!(begun.elapsed(), Duration::from_secs(10));
    for _ in 0..3 {
        assert!(matches!(wire.tell("n2", "telling").await, Err(DriverError::Lost { .. })));
    }
    assert_eq!(begun.elapsed(), Duration::from_secs(10));
    // And yet it is found when somebody plugs it in.
    tokio::spawn(counter(socket.plug(), 1000, Duration::ZERO));
    assert!(wire.tell("n2", "telling").await.unwrap_err().is_reopened());
    assert_eq!(wire.ask("n3?", "counting").await.unwrap(), "3");
}

#[tokio::test(start_paused = true)]
async fn a_policy_of_zero_never_opens_again() {
    for seconds in [0.0, -3.0, f64::NAN] {
        let socket = Socket::new();
        drop(socket.plug());
        let mut wire = plugged(&socket).await.reopening(Reopening::for_s(seconds));
        let _spare = socket.plug();
        for _ in 0..2 {
            let error = wire.ask("n1?", "counting").await.unwrap_err();
            assert!(matches!(error, DriverError::Lost { .. }), "{error}");
        }
        assert_eq!(socket.peers.lock().unwrap().len(), 1);
    }
}

/// What a port set to another rate hears: bytes at every try, none of them readable.
#[tokio::test(start_paused = true)]
async fn rubbish_at_every_try_asks_for_the_baud_rate() {
    for answer in [&b"\xf8\x00\x81\r"[..], b"\xfe\x80\xf8"] {
        let (near, mut far) = duplex(64);
        tokio::spawn(async move {
            let mut seen = [0; 64];
            while let Ok(1..) = far.read(&mut seen).await {
                far.write_all(answer).await.unwrap();
            }
        });
        let mut wire = Wire::over(near, "wrong rate");
        wire.baud = Some(9600);
        wire.adopt(habits());
        let error = wire.ask("a?", "asking").await.unwrap_err();
        assert!(error.to_string().contains("wrong baud rate? The line is set to 9600"), "{error}");
        assert!(error.is_missing_device());
    }
}

/// Without a recognisable query an answer that comes after its deadline is waited out.
#[tokio::test(start_paused = true)]
async fn without_a_sign_a_late_answer_is_outlasted() {
    for delay_ms in [1020, 1500, 1900] {
        let (near, far) = duplex(64);
        tokio::spawn(counter(far, 5, Duration::from_millis(delay_ms)));
        let mut wire = Wire::over(near, "counter");
        wire.adopt(LineHabits { sign: None, ..habits() });
        let mut good = 0;
        for index in 0..100 {
            if let Ok(answer) = wire.ask(&format!("n{index}?"), "counting").await {
                assert_eq!(answer, index.to_string(), "stale at {delay_ms} ms");
                good += 1;
            }
        }
        assert!(good >= 60, "{good} at {delay_ms} ms");
    }
}

/// Real time, on pseudo-terminals: pulled, and another one under the same name a moment later.
#[cfg(unix)]
#[tokio::test]
async fn an_unplugged_serial_port_is_opened_again_under_its_name() {
    use tokio_serial::{SerialPort, SerialStream};
    let folder = std::env::temp_dir().join(format!("ditd-wire-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let link = folder.join("by-id");
    let plug = |link: &std::path::Path| {
        let (far, near) = SerialStream::pair().unwrap();
        let name = near.name().unwrap();
        drop(near);
        std::fs::remove_file(link).ok();
        std::os::unix::fs::symlink(name, link).unwrap();
        far
    };
    let answer = |mut far: SerialStream| async move {
        let mut decoder = LineDecoder::default();
        while let Ok(byte) = far.read_u8().await {
            if let Some(Ok(line)) = decoder.push(byte) {
                let answer: &[u8] = if line == "*IDN?" { b"SIM,1,2,3\r" } else { b"24.091\r" };
                far.write_all(answer).await.unwrap();
            }
            if decoder.clone().take() == b"!" {
                return;
            }
        }
    };
    let first = tokio::spawn(answer(plug(&link)));
    let settings = WireSettings { baud: 9600 };
    let address = format!("serial:{}", link.display());
    let wire = Wire::open(&address, "plate calibrator", &settings).await.unwrap();
    let mut wire =
        wire.reopening(Reopening { every: Duration::from_millis(20), within: Duration::from_secs(5) });
    wire.adopt(habits());
    assert_eq!(wire.ask("T?", "asking").await.unwrap(), "24.091");
    first.abort();
    assert!(first.await.is_err());
    let second = tokio::spawn(answer(plug(&link)));
    let error = wire.ask("T?", "asking").await.unwrap_err();
    assert!(error.is_reopened(), "{error}");
    assert_eq!(wire.ask("T?", "asking").await.unwrap(), "24.091");
    second.abort();
    std::fs::remove_dir_all(&folder).ok();
}

/// Real time, on TCP: the far end closes the connection and listens on.
#[tokio::test]
async fn a_reset_connection_is_made_again() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("tcp:{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        let mut served = 0;
        while let Ok((mut stream, _)) = listener.accept().await {
            served += 1;
            let mut decoder = LineDecoder::default();
            let mut asked = 0;
            while let Ok(byte) = stream.read_u8().await {
                let Some(Ok(line)) = decoder.push(byte) else { continue };
                asked += 1;
                if served == 1 && asked == 3 {
                    break;
                }
                let answer: &[u8] = if line == "*IDN?" { b"SIM,1,2,3\r" } else { b"24.091\r" };
                stream.write_all(answer).await.unwrap();
            }
        }
    });
    let settings = WireSettings { baud: 9600 };
    let mut wire = Wire::open(&address, "plate calibrator", &settings).await.unwrap();
    wire.adopt(habits());
    assert_eq!(wire.ask("T?", "asking").await.unwrap(), "24.091");
    assert!(wire.ask("T?", "asking").await.unwrap_err().is_reopened());
    assert_eq!(wire.ask("T?", "asking").await.unwrap(), "24.091");
}

#[tokio::test]
async fn a_file_that_is_no_port_and_a_closed_tcp_port_say_what_they_are() {
    let settings = WireSettings { baud: 9600 };
    let error = Wire::open("serial:/dev/null", "plate calibrator", &settings).await.unwrap_err();
    assert!(matches!(error, DriverError::Missing { .. }), "{error}");
    assert!(error.to_string().contains("no serial port"), "{error}");
    let error = Wire::open("tcp:127.0.0.1:1", "plate calibrator", &settings).await.unwrap_err();
    assert!(error.to_string().contains("nothing listens"), "{error}");
}
