//! Says to which cycle and position a frame belongs: by the camera's clock and frame number, never by order.
//!
//! The first frame of a burst sets the origin; every further frame must lie on the trigger unit's grid. A frame
//! that is lost leaves its place empty and never shifts the ones after it. When the very first frame of a burst
//! is lost the origin is wrong by one place: then the first cycle cannot become complete, it is rejected, and the
//! origin is set anew. Pure.

use ditd_drivers::instrument::ShotProgram;

/// Largest distance of a time stamp from the trigger grid, as a fraction of the clock period: cameras stamp to
/// microseconds and the unit's oscillator is good to 25 ppm (9520 data sheet), so 5 % of a period of tens of
/// milliseconds is generous, and still far from half a period, where a frame could change its place.
const GRID_TOLERANCE: f64 = 0.05;

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
    /// Camera time of the burst's first clock pulse, in ns; may lie before the camera's zero.
    origin_ns: Option<i128>,
    confirmed: bool,
}

impl Matcher {
    /// For a burst as the trigger unit took it.
    pub(super) fn new(program: ShotProgram) -> Self {
        Self { program, origin_ns: None, confirmed: false }
    }

    /// Places a frame by its time stamp. `due` is the cycle that is being collected: the origin is set as if an
    /// unplaced frame were that cycle's first.
    ///
    /// # Errors
    ///
    /// Words that say how the stamp misses the grid.
    pub(super) fn place(&mut self, device_ns: u64, due: u32) -> Result<Place, String> {
        let period = i128::from(self.program.period_ns);
        let origin =
            *self.origin_ns.get_or_insert(i128::from(device_ns) - i128::from(self.program.frame_ns(due, 0)));
        let since = i128::from(device_ns) - origin;
        let pulse = (since + period / 2).div_euclid(period);
        let off = since - pulse * period;
        if off.unsigned_abs() as f64 > GRID_TOLERANCE * period as f64 {
            return Err(format!(
                "time stamp {device_ns} ns lies {off} ns off the trigger grid of {period} ns"
            ));
        }
        let in_cycles = pulse - i128::from(self.program.wait_periods);
        let cycle = in_cycles.div_euclid(i128::from(self.program.cycle_periods));
        let position = in_cycles.rem_euclid(i128::from(self.program.cycle_periods));
        match (u32::try_from(cycle), u32::try_from(position)) {
            (Ok(cycle), Ok(position))
                if cycle < self.program.cycles && position < self.program.frames_per_cycle() =>
            {
                Ok(Place { cycle, position })
            }
            _ => Err(format!("time stamp {device_ns} ns lies in the pause, where no frame was triggered")),
        }
    }

    /// Tells whether the cycle just collected was complete. An incomplete one before any complete one makes the
    /// origin doubtful: it is dropped, and the next frame sets it anew.
    pub(super) fn collected(&mut self, complete: bool) {
        if complete {
            self.confirmed = true;
        } else if !self.confirmed {
            self.origin_ns = None;
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
        let mut matcher = Matcher::new(program());
        for cycle in 0..4 {
            for position in 0..4 {
                assert_eq!(matcher.place(stamp(cycle, position), cycle), Ok(Place { cycle, position }));
            }
        }
    }

    #[test]
    fn a_lost_frame_does_not_shift_the_next() {
        let mut matcher = Matcher::new(program());
        for position in 0..4 {
            matcher.place(stamp(0, position), 0).unwrap();
        }
        matcher.collected(true);
        assert_eq!(matcher.place(stamp(1, 1), 1), Ok(Place { cycle: 1, position: 1 }));
        assert_eq!(matcher.place(stamp(1, 3), 1), Ok(Place { cycle: 1, position: 3 }));
    }

    #[test]
    fn losing_the_very_first_frame_costs_one_cycle_and_no_label() {
        let mut matcher = Matcher::new(program());
        let found: Vec<_> = (1..4).map(|p| matcher.place(stamp(0, p), 0).unwrap().position).collect();
        assert_eq!(found, [0, 1, 2], "shifted, and therefore incomplete: position 3 never comes");
        matcher.collected(false);
        for position in 0..4 {
            assert_eq!(matcher.place(stamp(1, position), 1), Ok(Place { cycle: 1, position }));
        }
    }

    #[test]
    fn a_stamp_off_the_grid_or_in_the_pause_is_refused() {
        let mut matcher = Matcher::new(program());
        matcher.place(stamp(0, 0), 0).unwrap();
        assert!(matcher.place(stamp(0, 1) + 5_000_000, 0).is_err());
        assert!(matcher.place(stamp(0, 100), 0).is_err());
        assert!(matcher.place(stamp(9, 0), 0).is_err());
    }
}
