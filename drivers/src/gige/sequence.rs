//! Frame numbers and time stamps without wraps and restarts. Pure.
//!
//! A stream numbers its frames from 1; standard ids have 16 bits and go from 65535 to 1 (GigE Vision: 0 is never used),
//! extended ones do not wrap. A camera's clock may start anew when it restarts. What leaves here never goes back.

/// The largest standard frame id.
const LAST_STANDARD: u64 = 65_535;

/// A step of ids by more than this forward is taken for a step back: at 100 frames a second five minutes of silence.
const STEP_MAX: u64 = 32_768;

/// Makes numbers that go on over wraps and over starts of the stream.
#[derive(Debug, Clone, Default)]
pub struct Numbers {
    /// Number that the next stream's frame 1 gets.
    base: u64,
    /// The last raw id and the number that it got, in this stream.
    last: Option<(u64, u64)>,
}

/// What a frame id says about the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Numbered {
    /// The number, consecutive unless frames are missing.
    pub number: u64,
    /// Frames that are missing before this one, within the stream.
    pub missing: u64,
}

impl Numbers {
    /// A new stream begins: its numbers go on after the last one of the stream before.
    pub fn restart(&mut self) {
        if let Some((_, number)) = self.last.take() {
            self.base = number + 1;
        }
    }

    /// The number of a raw id. `None` for an id that was there before, or lies behind the last one.
    pub fn take(&mut self, raw: u64) -> Option<Numbered> {
        let Some((last_raw, last)) = self.last else {
            // The first frame of a stream has id 1; a larger one says how many are missing before it, unless the camera
            // counts on over its starts, which shows as a large number.
            let first = if (1..=STEP_MAX).contains(&raw) { raw - 1 } else { 0 };
            let number = self.base + first;
            self.last = Some((raw, number));
            return Some(Numbered { number, missing: first });
        };
        let step = if raw > last_raw {
            raw - last_raw
        } else if last_raw <= LAST_STANDARD {
            // 65535 → 1: the ring has 65535 members, 0 is none of them.
            (raw + LAST_STANDARD - last_raw) % LAST_STANDARD
        } else {
            0
        };
        if step == 0 || (step > STEP_MAX && last_raw <= LAST_STANDARD) {
            return None;
        }
        let number = last + step;
        self.last = Some((raw, number));
        Some(Numbered { number, missing: step - 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_go_on_over_the_wrap() {
        let mut numbers = Numbers::default();
        let first = numbers.take(1).unwrap();
        assert_eq!(first, Numbered { number: 0, missing: 0 });
        for raw in 2..=65_535 {
            assert_eq!(numbers.take(raw).unwrap(), Numbered { number: raw - 1, missing: 0 });
        }
        assert_eq!(numbers.take(1).unwrap(), Numbered { number: 65_535, missing: 0 });
        assert_eq!(numbers.take(4).unwrap(), Numbered { number: 65_538, missing: 2 });
    }

    #[test]
    fn a_gap_over_the_wrap_is_counted() {
        let mut numbers = Numbers::default();
        for raw in (1..=65_534).step_by(20_000) {
            numbers.take(raw);
        }
        numbers.take(65_534).unwrap();
        assert_eq!(numbers.take(2).unwrap().missing, 2, "65535 and 1");
    }

    #[test]
    fn a_frame_that_comes_twice_or_late_has_no_number() {
        let mut numbers = Numbers::default();
        numbers.take(1).unwrap();
        numbers.take(3).unwrap();
        assert_eq!(numbers.take(3), None);
        assert_eq!(numbers.take(2), None);
        assert_eq!(numbers.take(4).unwrap().number, 3);
    }

    #[test]
    fn a_new_stream_goes_on_and_says_what_its_start_lacks() {
        let mut numbers = Numbers::default();
        numbers.take(1).unwrap();
        numbers.take(2).unwrap();
        numbers.restart();
        assert_eq!(numbers.take(2).unwrap(), Numbered { number: 3, missing: 1 });
        numbers.restart();
        numbers.restart();
        assert_eq!(
            numbers.take(60_000).unwrap(),
            Numbered { number: 4, missing: 0 },
            "counts over its starts"
        );
        let mut extended = Numbers::default();
        extended.take(1).unwrap();
        assert_eq!(extended.take(70_000).map(|n| n.number), None, "not a step that a stream makes");
    }

    #[test]
    fn extended_ids_pass_the_standard_range() {
        let mut numbers = Numbers::default();
        numbers.take(30_000).unwrap();
        numbers.take(60_000).unwrap();
        assert_eq!(numbers.take(70_000).unwrap().missing, 9_999);
        assert_eq!(numbers.take(70_001).unwrap().number, 70_000);
        assert_eq!(numbers.take(70_001), None);
    }
}
