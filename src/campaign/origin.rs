//! Whether the first frame of a burst is the burst's first: what the clocks of camera and computer say of it.
//!
//! A burst whose first frame was lost, and after whose last frame one more came a period later, has as many frames as it
//! should, evenly spaced, numbered without a gap, and every label one place off. The frames cannot show it. The time
//! between the trigger unit's start and the first stamp can: a lost first frame makes it longer by a period. Pure.

use ditd_drivers::instrument::{Begun, CameraClock};
use tokio::time::Instant;

/// By how much the clocks of camera and computer may differ in rate: a camera's oscillator and a computer's are good to
/// some tens of ppm each.
const CLOCK_TOLERANCE: f64 = 1e-4;

/// Two lags that differ by less than this fraction of a period are the same: a lost frame makes a whole period.
const SAME: f64 = 0.4;

/// A start whose moment is less certain than usual by more than this fraction of a period tells nothing by comparison: the
/// computer was busy. Below what would make one lag look like another.
const BUSY: f64 = 0.3;

/// Between which stamps of the camera's clock the first T0 pulse of a burst came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BurstClock {
    earliest_ns: i128,
    latest_ns: i128,
}

impl BurstClock {
    /// Of a unit that has begun `ahead_ns` after the first T0 pulse of its burst, as told by a camera's clock.
    pub(super) fn new(begun: Begun, ahead_ns: u64, clock: CameraClock) -> Self {
        let device = i128::from(clock.device_ns) - i128::from(ahead_ns);
        let least = signed_ns(begun.earliest, clock.latest);
        let most = signed_ns(begun.latest, clock.earliest);
        let drift = drift_ns(least.unsigned_abs().max(most.unsigned_abs()));
        Self { earliest_ns: device + least - drift, latest_ns: device + most + drift }
    }

    /// How long after the T0 pulse that comes `ahead_ns` after the first one a frame was stamped.
    pub(super) fn lag(&self, stamp_ns: i128, ahead_ns: i128) -> Lag {
        let drift = drift_ns(ahead_ns.unsigned_abs());
        Lag {
            least_ns: stamp_ns - ahead_ns - self.latest_ns - drift,
            most_ns: stamp_ns - ahead_ns - self.earliest_ns + drift,
        }
    }
}

/// Between which times after its T0 pulse a frame was stamped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Lag {
    least_ns: i128,
    most_ns: i128,
}

impl Lag {
    fn uncertainty_ns(self) -> i128 {
        self.most_ns - self.least_ns
    }
}

/// What is known of a first frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Verdict {
    /// No frame is missing before it.
    First,
    /// The clocks do not tell.
    Untold,
    /// One may be missing, as the words say.
    Doubtful(String),
}

/// The lags of the bursts before.
#[derive(Debug, Clone, Copy, Default)]
pub struct Origins {
    /// Of a first frame that was one.
    usual: Option<Lag>,
    /// Of the last one that was doubtful.
    doubted: Option<Lag>,
}

impl Origins {
    /// Judges a first frame of a burst of frames `period_ns` apart, of which `frames` belong together.
    ///
    /// Within a period of its own pulse it is the first for certain, since no camera stamps a frame before its trigger.
    /// Where the rig is slower than that (a slow line to the trigger unit, a camera that stamps at its read-out), it is
    /// compared with the bursts before; two in a row that are late by the same time are how the rig is.
    pub(super) fn judge(&mut self, lag: Lag, period_ns: i128, frames: u32) -> Verdict {
        let is_other_clock = lag.most_ns < 0 || lag.least_ns > i128::from(frames + 1) * period_ns;
        if is_other_clock {
            return Verdict::Untold;
        }
        let within = |part: f64, ns: i128| (ns as f64) <= part * period_ns as f64;
        if lag.most_ns < period_ns {
            return self.learn(lag);
        }
        if let Some(usual) = self.usual {
            if !within(BUSY, lag.uncertainty_ns() - usual.uncertainty_ns()) {
                return Verdict::Untold;
            }
            if within(SAME, lag.most_ns - usual.most_ns) {
                return self.learn(lag);
            }
        }
        let before = self.doubted.replace(lag);
        if before.is_some_and(|before| within(SAME, (lag.most_ns - before.most_ns).abs())) {
            self.usual = None;
            return self.learn(lag);
        }
        Verdict::Doubtful(format!(
            "the first frame is stamped {:.1} ms after its trigger, more than a period or than usual: one before it may be \
             missing",
            lag.most_ns as f64 * 1e-6
        ))
    }

    /// The most certain lag is the one to compare with.
    fn learn(&mut self, lag: Lag) -> Verdict {
        self.doubted = None;
        if self.usual.is_none_or(|usual| lag.uncertainty_ns() <= usual.uncertainty_ns()) {
            self.usual = Some(lag);
        }
        Verdict::First
    }
}

fn signed_ns(a: Instant, b: Instant) -> i128 {
    let ns = |duration: std::time::Duration| i128::try_from(duration.as_nanos()).unwrap_or(i128::MAX / 4);
    ns(a.saturating_duration_since(b)) - ns(b.saturating_duration_since(a))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "rounded up: a fraction of a burst's length in nanoseconds"
)]
fn drift_ns(since_ns: u128) -> i128 {
    (CLOCK_TOLERANCE * since_ns as f64).ceil() as i128
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const PERIOD_NS: i128 = 20_000_000;
    const FRAMES: u32 = 4;

    fn lag(least_ms: i128, most_ms: i128) -> Lag {
        Lag { least_ns: least_ms * 1_000_000, most_ns: most_ms * 1_000_000 }
    }

    fn judged(origins: &mut Origins, least_ms: i128, most_ms: i128) -> Verdict {
        origins.judge(lag(least_ms, most_ms), PERIOD_NS, FRAMES)
    }

    #[test]
    fn within_a_period_it_is_the_first_and_a_period_later_it_is_not() {
        let mut origins = Origins::default();
        assert_eq!(judged(&mut origins, -7, 5), Verdict::First);
        assert!(matches!(judged(&mut origins, 13, 25), Verdict::Doubtful(_)));
        assert_eq!(judged(&mut origins, -7, 5), Verdict::First);
        // Without anything to compare with it is doubtful all the same.
        assert!(matches!(judged(&mut Origins::default(), 13, 25), Verdict::Doubtful(_)));
    }

    /// A slow rig costs one burst, and is known from then on; a frame that is lost there is seen.
    #[test]
    fn a_rig_that_is_always_late_is_learnt() {
        let mut origins = Origins::default();
        assert!(matches!(judged(&mut origins, -30, 33), Verdict::Doubtful(_)));
        assert_eq!(judged(&mut origins, -30, 35), Verdict::First);
        assert_eq!(judged(&mut origins, -30, 31), Verdict::First);
        assert!(matches!(judged(&mut origins, -10, 54), Verdict::Doubtful(_)));
        assert_eq!(judged(&mut origins, -30, 34), Verdict::First);
        // The doubtful one is forgotten: it takes two in a row.
        assert!(matches!(judged(&mut origins, -10, 54), Verdict::Doubtful(_)));
    }

    /// The first burst of all is the one that lacks its first frame: the next one, sooner by a period, is right.
    #[test]
    fn a_fault_in_the_first_burst_is_not_learnt() {
        let mut origins = Origins::default();
        assert!(matches!(judged(&mut origins, -10, 53), Verdict::Doubtful(_)));
        assert!(matches!(judged(&mut origins, -30, 33), Verdict::Doubtful(_)));
        assert_eq!(judged(&mut origins, -30, 33), Verdict::First);
    }

    #[test]
    fn a_busy_computer_and_another_clock_tell_nothing() {
        let mut origins = Origins::default();
        assert_eq!(judged(&mut origins, -7, 5), Verdict::First);
        assert_eq!(judged(&mut origins, -10, 25), Verdict::Untold);
        assert_eq!(judged(&mut origins, -9_000, -8_000), Verdict::Untold);
        assert_eq!(judged(&mut origins, 9_000, 9_010), Verdict::Untold);
    }

    #[tokio::test(start_paused = true)]
    async fn a_burst_is_placed_on_the_cameras_clock_with_all_that_is_uncertain() {
        let zero = Instant::now() + Duration::from_secs(10);
        let ms = Duration::from_millis;
        let clock = CameraClock { device_ns: 5_000_000_000, earliest: zero, latest: zero + ms(1) };
        let begun = Begun { earliest: zero + ms(3), latest: zero + ms(13) };
        let burst = BurstClock::new(begun, 0, clock);
        // Stamped 20 ms after the clock was read, two periods after the first pulse.
        let lag = burst.lag(5_060_000_000, 2 * PERIOD_NS);
        let drift = drift_ns(13_000_000) + drift_ns(40_000_000);
        assert_eq!(lag, Lag { least_ns: 7_000_000 - drift, most_ns: 18_000_000 + drift });
        // A cycle that was begun by itself, 15 s into the burst, is on the same line.
        let later = Duration::from_secs(15);
        let begun = Begun { earliest: begun.earliest + later, latest: begun.latest + later };
        let there = BurstClock::new(begun, 15_000_000_000, clock);
        let drift = drift_ns(15_013_000_000);
        assert_eq!(there.lag(5_020_000_000, 0).most_ns, 18_000_000 + drift);
        // Read before or after: the sign is kept.
        let before = CameraClock { earliest: zero + ms(100), latest: zero + ms(101), ..clock };
        assert!(BurstClock::new(Begun { earliest: zero, latest: zero }, 0, before).latest_ns < 5_000_000_000);
    }
}
