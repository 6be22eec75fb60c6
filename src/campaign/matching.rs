//! Says to which cycle and position a frame belongs: by the camera's clock and frame number, never by order.
//!
//! The first frame of a burst sets the origin; every further frame must lie on the trigger unit's grid. A frame
//! that is lost leaves its place empty and never shifts the ones after it. When the very first frame of a burst
//! is lost the origin is wrong by one place: then the first cycle cannot become complete, it is rejected, and the
//! origin is set anew. When one frame too many makes it complete all the same, the clocks tell ([`super::origin`]). Pure.
//!
//! A unit that is begun cycle by cycle has one grid per cycle. Where the next one lies the computer's clock tells, to a
//! few milliseconds: enough to know a frame from its neighbour, which keeps the rule that a lost first frame shifts nothing.

use super::origin::{BurstClock, Origins, Verdict};
use ditd_drivers::instrument::ShotProgram;

/// Distance of a time stamp from the trigger grid that is always allowed, as a fraction of the clock period: cameras
/// stamp to microseconds, so 5 % of tens of milliseconds is generous.
const GRID_TOLERANCE: f64 = 0.05;

/// Added per time since the last placed frame: how much the camera's clock and the trigger unit's may differ. The
/// unit's oscillator is good to 25 ppm (9520 data sheet), a camera's to some tens.
const CLOCK_TOLERANCE: f64 = 1e-4;

/// Beyond this fraction of a period a frame could change its place: after so long without a frame nothing is placed.
const AMBIGUOUS: f64 = 0.4;

/// Where a frame belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// Cycle within the burst.
    pub(super) cycle: u32,
    /// Position within the cycle.
    pub(super) position: u32,
}

/// Places the frames of one burst.
#[derive(Debug)]
pub(super) struct Matcher {
    program: ShotProgram,
    /// The last placed frame: its clock pulse, and its time by the camera in ns. The grid goes on from here, so that
    /// two clocks that drift apart never add up.
    anchor: Option<(i128, i128)>,
    confirmed: bool,
    /// Begun cycle by cycle: the present cycle, and when it began by this computer's clock, in ns.
    begun: Option<(u32, i128)>,
    /// The grid of the present cycle is known only from the computer's clock; its first frame sets it.
    loose: bool,
    /// When the burst began by the camera's clock, where that is known.
    clock: Option<BurstClock>,
    origins: Origins,
    /// Why the origin may be wrong.
    doubt: Option<String>,
}

impl Matcher {
    /// For a burst as the trigger unit took it, after others whose origins are known.
    pub(super) fn new(program: ShotProgram, origins: Origins) -> Self {
        Self {
            program,
            anchor: None,
            confirmed: false,
            begun: None,
            loose: false,
            clock: None,
            origins,
            doubt: None,
        }
    }

    /// The burst began so, by the camera's clock.
    pub(super) fn began(&mut self, clock: Option<BurstClock>) {
        self.clock = clock;
    }

    /// What is known of origins now.
    pub(super) fn origins(&self) -> Origins {
        self.origins
    }

    /// Why the cycle just collected must not count although it is complete: its first frame set an origin that is doubtful.
    pub(super) fn doubt(&mut self) -> Option<String> {
        self.doubt.take()
    }

    /// A cycle was begun at `at_ns` by this computer's clock, on a unit that is begun cycle by cycle: its pulses lie on a
    /// grid of their own. How far it lies from the last one the computer knows to some milliseconds, which is enough to tell
    /// a place from its neighbour; the cycle's first frame makes it exact.
    pub(super) fn begin(&mut self, cycle: u32, at_ns: u64) {
        let at = i128::from(at_ns);
        let before = self.begun.replace((cycle, at));
        if let (Some((pulse, stamp)), Some((last, last_at))) = (self.anchor, before) {
            let place = pulse - self.first_pulse(last);
            let period = i128::from(self.program.period_ns);
            let first_stamp = stamp - place * period + (at - last_at);
            self.anchor = Some((self.first_pulse(cycle), first_stamp));
            self.loose = true;
        }
    }

    fn first_pulse(&self, cycle: u32) -> i128 {
        i128::from(self.program.frame_ns(cycle, 0)) / i128::from(self.program.period_ns)
    }

    /// Places a frame by its time stamp. `due` is the cycle that is being collected: the first frame of all is taken
    /// for that cycle's first.
    ///
    /// # Errors
    ///
    /// Words that say how the stamp misses the grid.
    pub(super) fn place(&mut self, device_ns: u64, due: u32) -> Result<Place, String> {
        let period = i128::from(self.program.period_ns);
        let first = self.first_pulse(due);
        let stamp = i128::from(device_ns);
        let (anchor_pulse, anchor_ns) = match self.anchor {
            Some(anchor) => anchor,
            None => {
                self.judge_origin(stamp, first * period);
                *self.anchor.insert((first, stamp))
            }
        };
        let since = stamp - anchor_ns;
        let pulses = (since + period / 2).div_euclid(period);
        let off = since - pulses * period;
        let allowed = if self.loose {
            AMBIGUOUS * period as f64
        } else {
            GRID_TOLERANCE * period as f64 + CLOCK_TOLERANCE * since.unsigned_abs() as f64
        };
        if allowed > AMBIGUOUS * period as f64 {
            return Err(format!(
                "time stamp {device_ns} ns comes {:.0} s after the last one: too long to place it on a grid of {period} ns",
                since as f64 * 1e-9
            ));
        }
        if off.unsigned_abs() as f64 > allowed {
            return Err(format!(
                "time stamp {device_ns} ns lies {off} ns off the trigger grid of {period} ns"
            ));
        }
        let pulse = anchor_pulse + pulses;
        let in_cycles = pulse - i128::from(self.program.wait_periods);
        let cycle = in_cycles.div_euclid(i128::from(self.program.cycle_periods));
        let position = in_cycles.rem_euclid(i128::from(self.program.cycle_periods));
        match (u32::try_from(cycle), u32::try_from(position)) {
            (Ok(cycle), Ok(position))
                if cycle < self.program.cycles && position < self.program.frames_per_cycle() =>
            {
                self.anchor = Some((pulse, stamp));
                self.loose = false;
                Ok(Place { cycle, position })
            }
            _ => Err(format!("time stamp {device_ns} ns lies in the pause, where no frame was triggered")),
        }
    }

    fn judge_origin(&mut self, stamp: i128, ahead: i128) {
        let Some(clock) = self.clock else { return };
        let delay = i128::from(self.program.camera_delay_ns);
        let lag = clock.lag(stamp, ahead + delay);
        let verdict =
            self.origins.judge(lag, i128::from(self.program.period_ns), self.program.frames_per_cycle());
        self.doubt = match verdict {
            Verdict::Doubtful(why) => Some(why),
            Verdict::First | Verdict::Untold => None,
        };
    }

    /// Tells whether the cycle just collected was complete. An incomplete one before any complete one makes the
    /// origin doubtful: it is dropped, and the next frame sets it anew.
    pub(super) fn collected(&mut self, complete: bool) {
        if complete {
            self.confirmed = true;
        } else if !self.confirmed {
            self.anchor = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program() -> ShotProgram {
        ShotProgram {
            period_ns: 20_000_000,
            wait_periods: 1,
            warm_up: 1,
            blanks: 2,
            inject: true,
            cycle_periods: 754,
            cycles: 4,
            camera_delay_ns: 900_000,
            camera_width_ns: 25_000,
            injector_delay_ns: 0,
            injector_width_ns: 1_000_000,
        }
    }

    fn stamp(cycle: u32, position: u32) -> u64 {
        7_000_000_123 + program().frame_ns(cycle, position)
    }

    #[test]
    fn every_frame_finds_its_place() {
        let mut matcher = Matcher::new(program(), Origins::default());
        for cycle in 0..4 {
            for position in 0..4 {
                assert_eq!(matcher.place(stamp(cycle, position), cycle), Ok(Place { cycle, position }));
            }
        }
    }

    #[test]
    fn a_lost_frame_does_not_shift_the_next() {
        let mut matcher = Matcher::new(program(), Origins::default());
        for position in 0..4 {
            matcher.place(stamp(0, position), 0).unwrap();
        }
        matcher.collected(true);
        assert_eq!(matcher.place(stamp(1, 1), 1), Ok(Place { cycle: 1, position: 1 }));
        assert_eq!(matcher.place(stamp(1, 3), 1), Ok(Place { cycle: 1, position: 3 }));
    }

    #[test]
    fn losing_the_very_first_frame_costs_one_cycle_and_no_label() {
        let mut matcher = Matcher::new(program(), Origins::default());
        let found: Vec<_> = (1..4).map(|p| matcher.place(stamp(0, p), 0).unwrap().position).collect();
        assert_eq!(found, [0, 1, 2], "shifted, and therefore incomplete: position 3 never comes");
        matcher.collected(false);
        for position in 0..4 {
            assert_eq!(matcher.place(stamp(1, position), 1), Ok(Place { cycle: 1, position }));
        }
    }

    #[test]
    fn clocks_that_drift_apart_do_not_add_up() {
        // 50 ppm over 49 cycles of 15 s is 37 ms: two places, if it added up.
        let program = ShotProgram { cycles: 49, ..program() };
        let mut matcher = Matcher::new(program.clone(), Origins::default());
        for cycle in 0..49 {
            for position in 0..4 {
                let exact = program.frame_ns(cycle, position);
                let stamp = 7_000_000_123 + exact + exact / 20_000;
                assert_eq!(matcher.place(stamp, cycle), Ok(Place { cycle, position }));
            }
            matcher.collected(true);
        }
    }

    /// Begun by hand, cycles come some milliseconds late; a cycle's lost first frame is still seen.
    #[test]
    fn cycles_that_are_begun_by_hand_have_grids_of_their_own() {
        let mut matcher = Matcher::new(program(), Origins::default());
        let late_ns = |cycle: u32| u64::from(cycle * 7 % 5) * 1_500_000;
        for cycle in 0..4 {
            // What the computer notes is off by another millisecond.
            matcher.begin(cycle, 55_000 + program().frame_ns(cycle, 0) + late_ns(cycle) + 1_000_000);
            for position in u32::from(cycle == 2)..4 {
                let at = stamp(cycle, position) + late_ns(cycle);
                assert_eq!(matcher.place(at, cycle), Ok(Place { cycle, position }));
            }
            matcher.collected(cycle != 2);
        }
        // 10 ms off is between two places: refused, and the next frame is not.
        let mut matcher = Matcher::new(program(), Origins::default());
        matcher.begin(0, 0);
        matcher.place(stamp(0, 0), 0).unwrap();
        matcher.collected(true);
        matcher.begin(1, program().frame_ns(1, 0) - program().frame_ns(0, 0));
        assert!(matcher.place(stamp(1, 0) + 10_000_000, 1).is_err());
        assert_eq!(matcher.place(stamp(1, 1) + 3_000_000, 1), Ok(Place { cycle: 1, position: 1 }));
    }

    #[test]
    fn a_stamp_off_the_grid_or_in_the_pause_is_refused() {
        let mut matcher = Matcher::new(program(), Origins::default());
        matcher.place(stamp(0, 0), 0).unwrap();
        assert!(matcher.place(stamp(0, 1) + 5_000_000, 0).is_err());
        assert!(matcher.place(stamp(0, 100), 0).is_err());
        assert!(matcher.place(stamp(9, 0), 0).is_err());
    }
}
