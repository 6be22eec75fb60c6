//! Modbus RTU: frames in both directions, and a master that asks one unit over a wire.
//!
//! Source: MODBUS Application Protocol Specification V1.1b3 (functions 3, 4, 6; exception codes) and MODBUS over Serial
//! Line V1.02 (CRC-16, low byte first; 3.5 characters of silence between frames). Knows no register of any instrument.

use crate::error::DriverError;
use crate::wire::{FrameCut, FrameHabits, FrameSign, LineHabits, Tries, Wire};
use std::time::Duration;

/// Registers that one question can read (specification, function 3).
pub const COUNT_MAX: u16 = 125;

/// Shortest silence between frames: above 19200 baud the specification fixes 1.75 ms; timers here have a grain of 1 ms.
const GAP_MIN: Duration = Duration::from_millis(3);

/// Bits of a character on the line, parity or second stop bit included.
const BITS_PER_CHARACTER: f64 = 11.0;

/// A question to a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// Function 3: holding registers.
    Holding {
        /// First register.
        register: u16,
        /// How many, 1 … 125.
        count: u16,
    },
    /// Function 4: input registers.
    Input {
        /// First register.
        register: u16,
        /// How many, 1 … 125.
        count: u16,
    },
    /// Function 6: writes one holding register.
    Write {
        /// The register.
        register: u16,
        /// What it shall hold.
        value: u16,
    },
}

/// What a unit answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// To functions 3 and 4.
    Registers(Vec<u16>),
    /// To function 6: what was written, repeated.
    Written {
        /// The register.
        register: u16,
        /// What it holds now.
        value: u16,
    },
    /// Refused, with the exception code.
    Refused(u8),
}

impl Question {
    fn function(self) -> u8 {
        match self {
            Self::Holding { .. } => 3,
            Self::Input { .. } => 4,
            Self::Write { .. } => 6,
        }
    }

    /// The whole frame for a unit.
    ///
    /// ```
    /// use ditd_drivers::modbus::Question;
    /// let frame = Question::Holding { register: 0x6b, count: 3 }.encode(0x11);
    /// assert_eq!(frame, [0x11, 0x03, 0x00, 0x6b, 0x00, 0x03, 0x76, 0x87]);
    /// assert_eq!(Question::decode(&frame), Ok((0x11, Question::Holding { register: 0x6b, count: 3 })));
    /// ```
    pub fn encode(self, unit: u8) -> Vec<u8> {
        let (first, second) = match self {
            Self::Holding { register, count } | Self::Input { register, count } => (register, count),
            Self::Write { register, value } => (register, value),
        };
        let [a, b] = first.to_be_bytes();
        let [c, d] = second.to_be_bytes();
        sealed(vec![unit, self.function(), a, b, c, d])
    }

    /// Reads a whole frame as the unit does: to whom it is, and what is asked.
    ///
    /// # Errors
    /// Says what is wrong: length, checksum, function or count.
    pub fn decode(frame: &[u8]) -> Result<(u8, Self), &'static str> {
        let body = unsealed(frame)?;
        let &[unit, function, a, b, c, d] = body else { return Err("expected six bytes and a checksum") };
        let (first, second) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let question = match function {
            3 | 4 if !(1..=COUNT_MAX).contains(&second) => return Err("a count that is not allowed"),
            3 => Self::Holding { register: first, count: second },
            4 => Self::Input { register: first, count: second },
            6 => Self::Write { register: first, value: second },
            _ => return Err("a function that is not known"),
        };
        Ok((unit, question))
    }
}

impl Answer {
    /// The whole frame by which a unit answers a question.
    pub fn encode(&self, unit: u8, question: Question) -> Vec<u8> {
        let function = question.function();
        match self {
            Self::Registers(values) => {
                let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
                let length = u8::try_from(bytes.len()).expect("at most 125 registers are asked for");
                sealed([&[unit, function, length], &bytes[..]].concat())
            }
            Self::Written { register, value } => {
                let ([a, b], [c, d]) = (register.to_be_bytes(), value.to_be_bytes());
                sealed(vec![unit, function, a, b, c, d])
            }
            Self::Refused(code) => sealed(vec![unit, function | 0x80, *code]),
        }
    }

    /// Reads a whole frame as the answer of a unit to a question.
    ///
    /// # Errors
    /// Says what is wrong: checksum, another unit, another function, or what does not fit the question.
    pub fn decode(frame: &[u8], unit: u8, question: Question) -> Result<Self, &'static str> {
        let body = unsealed(frame)?;
        let [from, function, rest @ ..] = body else { return Err("expected unit and function") };
        if *from != unit {
            return Err("an answer of another unit");
        }
        if *function == question.function() | 0x80 {
            return match rest {
                [code] => Ok(Self::Refused(*code)),
                _ => Err("expected one exception code"),
            };
        }
        if *function != question.function() {
            return Err("an answer to another function");
        }
        match (question, rest) {
            (Question::Holding { count, .. } | Question::Input { count, .. }, [length, bytes @ ..]) => {
                if bytes.len() != usize::from(*length) || bytes.len() != 2 * usize::from(count) {
                    return Err("another number of registers than asked for");
                }
                let pairs = bytes.chunks_exact(2);
                Ok(Self::Registers(pairs.map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()))
            }
            (Question::Write { register, .. }, &[a, b, c, d]) => {
                let written = u16::from_be_bytes([a, b]);
                if written == register {
                    Ok(Self::Written { register, value: u16::from_be_bytes([c, d]) })
                } else {
                    Err("another register than the one written")
                }
            }
            _ => Err("an answer of the wrong length"),
        }
    }
}

/// What an exception code means (specification, section 7).
pub fn exception_words(code: u8) -> &'static str {
    match code {
        1 => "it does not know this function",
        2 => "it has no such register",
        3 => "the value is not allowed",
        4 => "it failed while obeying",
        5 | 6 => "it is busy",
        _ => "for a reason of its own",
    }
}

/// Cuts an answer off the bytes of a line.
pub fn cut_answer(bytes: &[u8]) -> FrameCut {
    let length = match bytes {
        [] | [_] | [_, 3 | 4] => return FrameCut::More,
        [_, 3 | 4, length, ..] => 5 + usize::from(*length),
        [_, 6, ..] => 8,
        [_, 0x83 | 0x84 | 0x86, ..] => 5,
        _ => return FrameCut::Nonsense("a function that was not asked for"),
    };
    if bytes.len() < length {
        return FrameCut::More;
    }
    match unsealed(&bytes[..length]) {
        Ok(_) => FrameCut::Whole(length),
        Err(why) => FrameCut::Nonsense(why),
    }
}

/// Cuts a question off the bytes of a line, as a unit does: all questions here have eight bytes.
pub fn cut_question(bytes: &[u8]) -> FrameCut {
    match bytes {
        [_, function, ..] if !matches!(function, 3 | 4 | 6) => {
            FrameCut::Nonsense("a function that is not known")
        }
        _ if bytes.len() < 8 => FrameCut::More,
        _ => match unsealed(&bytes[..8]) {
            Ok(_) => FrameCut::Whole(8),
            Err(why) => FrameCut::Nonsense(why),
        },
    }
}

/// CRC-16 of Modbus: polynomial 0xA001, start 0xFFFF.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |crc, byte| {
        (0..8)
            .fold(crc ^ u16::from(*byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xa001 } else { crc >> 1 })
    })
}

fn sealed(mut body: Vec<u8>) -> Vec<u8> {
    let crc = crc16(&body);
    body.extend(crc.to_le_bytes());
    body
}

fn unsealed(frame: &[u8]) -> Result<&[u8], &'static str> {
    let Some((body, &[low, high])) = frame.split_last_chunk::<2>() else {
        return Err("too short for a frame");
    };
    if crc16(body) == u16::from_le_bytes([low, high]) { Ok(body) } else { Err("the checksum does not fit") }
}

/// One unit at the end of a wire.
#[derive(Debug)]
pub struct Master {
    wire: Wire,
    unit: u8,
    habits: FrameHabits,
}

impl Master {
    /// A master for `unit` over an open wire at `baud`. `sign` is a harmless reading whose count no other question of this
    /// master has, so that its answer, or its refusal, is recognised; no other question may be refused in ordinary life.
    pub fn new(mut wire: Wire, unit: u8, baud: u32, sign: Option<Question>, hint: &'static str) -> Self {
        let gap = Duration::from_secs_f64(3.5 * BITS_PER_CHARACTER / f64::from(baud.max(300)));
        let gap = gap.max(GAP_MIN);
        wire.adopt(LineHabits {
            ending: "",
            // Units answer within some milliseconds; a USB adapter or a gateway under load adds up to some hundred.
            deadline: Duration::from_secs(1),
            pace: gap,
            sign: None,
            hint,
        });
        let sign = sign.map(|question| FrameSign {
            question: question.encode(unit),
            fits: match question {
                Question::Holding { count: 2, .. } => |frame: &[u8]| is_sign(frame, 4),
                _ => |frame: &[u8]| is_sign(frame, 2 * SIGN_COUNT),
            },
        });
        Self { wire, unit, habits: FrameHabits { gap, cut: cut_answer, sign } }
    }

    /// Who is at the other end, as messages say it.
    pub fn name(&self) -> &str {
        self.wire.name()
    }

    /// Reads registers.
    ///
    /// # Errors
    /// [`DriverError::Refused`] with the unit's exception, and those of [`Wire::ask_frame`] after three tries.
    pub async fn read(&mut self, question: Question, doing: &str) -> Result<Vec<u16>, DriverError> {
        match self.exchange(question, doing).await? {
            Answer::Registers(values) => Ok(values),
            answer => Err(self.misfit(question, &answer, doing)),
        }
    }

    /// Writes a register; returns what the unit says it holds.
    ///
    /// # Errors
    /// As [`Master::read`].
    pub async fn write(&mut self, register: u16, value: u16, doing: &str) -> Result<u16, DriverError> {
        let question = Question::Write { register, value };
        match self.exchange(question, doing).await? {
            Answer::Written { value, .. } => Ok(value),
            answer => Err(self.misfit(question, &answer, doing)),
        }
    }

    /// A refusal, or an answer of another kind than the question's, which decoding excludes.
    fn misfit(&self, question: Question, answer: &Answer, doing: &str) -> DriverError {
        let why = match answer {
            Answer::Refused(code) => {
                format!("{question:?}: exception {code}: {}", exception_words(*code))
            }
            other => format!("{question:?} was answered by {other:?}"),
        };
        DriverError::refused(
            self.wire.name(),
            doing,
            why,
            "Check unit, function and register against the instrument's table.",
        )
    }

    /// Reading twice and writing the same twice do no harm.
    async fn exchange(&mut self, question: Question, doing: &str) -> Result<Answer, DriverError> {
        let mut tries = Tries::default();
        loop {
            let asked = self.wire.ask_frame(&self.habits, &question.encode(self.unit), doing).await;
            let failure = match asked {
                Ok(frame) => match Answer::decode(&frame, self.unit, question) {
                    Ok(answer) => return Ok(answer),
                    Err(why) => self.wire.unexpected(doing, &format!("{frame:02x?}"), why),
                },
                Err(failure) => failure,
            };
            tries.again(failure)?;
        }
    }
}

/// Registers that the sign of a general master reads: more than any value has.
pub const SIGN_COUNT: usize = 3;

/// An answer of so many bytes, or a refusal: nothing else that is asked for has either.
fn is_sign(frame: &[u8], bytes: usize) -> bool {
    matches!(frame, [_, 3 | 4, length, ..] if usize::from(*length) == bytes)
        || matches!(frame, [_, 0x83 | 0x84, ..])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
    use tokio::time::sleep;

    fn any_question() -> impl Strategy<Value = Question> {
        prop_oneof![
            (any::<u16>(), 1..=COUNT_MAX).prop_map(|(register, count)| Question::Holding { register, count }),
            (any::<u16>(), 1..=COUNT_MAX).prop_map(|(register, count)| Question::Input { register, count }),
            (any::<u16>(), any::<u16>()).prop_map(|(register, value)| Question::Write { register, value }),
        ]
    }

    fn answer_to(question: Question, refused: bool) -> Answer {
        match question {
            _ if refused => Answer::Refused(2),
            Question::Write { register, value } => Answer::Written { register, value },
            Question::Holding { register, count } | Question::Input { register, count } => {
                Answer::Registers((0..count).map(|index| register.wrapping_add(index)).collect())
            }
        }
    }

    proptest! {
        #[test]
        fn questions_and_answers_survive_the_line(question in any_question(), unit: u8, refused: bool) {
            let frame = question.encode(unit);
            prop_assert_eq!(cut_question(&frame), FrameCut::Whole(8));
            prop_assert_eq!(Question::decode(&frame), Ok((unit, question)));
            let answer = answer_to(question, refused);
            let frame = answer.encode(unit, question);
            prop_assert_eq!(cut_answer(&frame), FrameCut::Whole(frame.len()));
            for cut in 0..frame.len() {
                prop_assert_eq!(cut_answer(&frame[..cut]), FrameCut::More);
            }
            prop_assert_eq!(Answer::decode(&frame, unit, question), Ok(answer));
        }

        #[test]
        fn one_changed_bit_is_found(question in any_question(), unit: u8, at: usize, bit in 0_u8..8) {
            let mut frame = answer_to(question, false).encode(unit, question);
            let at = at % frame.len();
            frame[at] ^= 1 << bit;
            prop_assert!(Answer::decode(&frame, unit, question).is_err());
        }

        #[test]
        fn no_bytes_make_the_codec_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), question in any_question()) {
            let _ = cut_answer(&bytes);
            let _ = cut_question(&bytes);
            drop(Answer::decode(&bytes, 1, question));
            let _ = Question::decode(&bytes);
        }
    }

    /// The specification's own examples (V1.1b3, function 6; a public table of CRCs for the frame).
    #[test]
    fn known_frames_are_written() {
        assert_eq!(Question::Write { register: 1, value: 3 }.encode(1), [1, 6, 0, 1, 0, 3, 0x98, 0x0b]);
        assert_eq!(Question::Holding { register: 0, count: 1 }.encode(1), [1, 3, 0, 0, 0, 1, 0x84, 0x0a]);
        assert!(
            Answer::decode(&[1, 3, 2, 0, 5, 0, 0], 1, Question::Holding { register: 0, count: 1 }).is_err()
        );
    }

    /// A unit that answers register n with n; every `late`-th answer comes after `delay`.
    async fn unit(mut stream: DuplexStream, late: u64, delay: Duration) {
        let mut bytes = Vec::new();
        let mut count = 0_u64;
        while let Ok(byte) = stream.read_u8().await {
            bytes.push(byte);
            let FrameCut::Whole(_) = cut_question(&bytes) else { continue };
            let (unit, question) = Question::decode(&bytes).unwrap();
            bytes.clear();
            count += 1;
            if count.is_multiple_of(late) {
                sleep(delay).await;
            }
            let frame = answer_to(question, false).encode(unit, question);
            if stream.write_all(&frame).await.is_err() {
                return;
            }
        }
    }

    const SIGN: Question = Question::Holding { register: 0, count: 3 };

    #[tokio::test(start_paused = true)]
    async fn a_late_frame_is_not_taken_for_the_next() {
        for delay_ms in [1010, 1049, 1060, 1500, 2300, 3900] {
            let (near, far) = duplex(64);
            tokio::spawn(unit(far, 7, Duration::from_millis(delay_ms)));
            let mut master = Master::new(Wire::over(near, "unit"), 1, 19_200, Some(SIGN), "");
            let mut good = 0;
            for register in 0..300 {
                if let Ok(values) = master.read(Question::Holding { register, count: 1 }, "reading").await {
                    assert_eq!(values, [register], "stale at {delay_ms} ms");
                    good += 1;
                }
            }
            assert!(good > 150, "{good} good at {delay_ms} ms");
        }
    }

    /// The sign is not known to it, and it says nothing then.
    #[tokio::test(start_paused = true)]
    async fn a_unit_without_the_sign_is_asked_all_the_same() {
        let (near, mut far) = duplex(64);
        tokio::spawn(async move {
            let mut frame = [0; 8];
            while far.read_exact(&mut frame).await.is_ok() {
                let (unit, question) = Question::decode(&frame).unwrap();
                if question != SIGN {
                    far.write_all(&answer_to(question, false).encode(unit, question)).await.unwrap();
                }
            }
        });
        let mut master = Master::new(Wire::over(near, "unit"), 9, 9600, Some(SIGN), "");
        for register in 5..9 {
            assert_eq!(
                master.read(Question::Input { register, count: 1 }, "reading").await.unwrap(),
                [register]
            );
        }
    }

    #[tokio::test(start_paused = true)]
    async fn refusal_silence_and_rubbish_are_told_apart() {
        let (near, mut far) = duplex(64);
        tokio::spawn(async move {
            let mut frame = [0; 8];
            while far.read_exact(&mut frame).await.is_ok() {
                let (unit, question) = Question::decode(&frame).unwrap();
                far.write_all(&Answer::Refused(2).encode(unit, question)).await.unwrap();
            }
        });
        let mut master = Master::new(Wire::over(near, "unit"), 1, 9600, Some(SIGN), "hint");
        let error = master.read(Question::Input { register: 7, count: 1 }, "reading").await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
        assert!(error.to_string().contains("no such register"), "{error}");

        let (near, far) = duplex(64);
        let mut master = Master::new(Wire::over(near, "unit"), 1, 9600, Some(SIGN), "hint");
        let error = master.read(Question::Input { register: 7, count: 1 }, "reading").await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { tries: 3, .. }), "{error}");
        drop(far);

        // Another rate: every question is answered by bytes that are no frame.
        let (near, mut far) = duplex(64);
        tokio::spawn(async move {
            let mut frame = [0; 8];
            while far.read_exact(&mut frame).await.is_ok() {
                far.write_all(&[0xf8, 0x00, 0x7e, 0xe0]).await.unwrap();
            }
        });
        let mut master = Master::new(Wire::over(near, "unit"), 1, 9600, Some(SIGN), "hint");
        let error = master.read(Question::Input { register: 7, count: 1 }, "reading").await.unwrap_err();
        assert!(error.to_string().contains("wrong baud rate"), "{error}");
    }
}
