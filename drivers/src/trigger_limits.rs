//! What a rig and a trigger unit allow of a program of shots; every unit asks here before it sends anything.
//!
//! The same questions are asked of a campaign file, so that what a unit would refuse at night is refused at the desk.
//! Knows no protocol. Distances between bursts are kept by [`LastInjection`], which each driver carries.

use crate::error::DriverError;
use crate::instrument::ShotProgram;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tokio::time::Instant;

/// A year: a longer burst is a slip of a decimal point, and its times would overflow.
const BURST_MAX_NS: u64 = 365 * 86_400 * 1_000_000_000;

/// What the rig allows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriggerLimits {
    /// Longest pulse that the injector (its coil, its driver) takes, in seconds.
    pub injector_pulse_max_s: f64,
    /// Shortest time between two injections, in seconds; also between the last of one burst and the first of the next.
    pub injection_interval_min_s: f64,
    /// Integration time of the camera, in seconds.
    pub camera_integration_s: f64,
    /// Time that the camera needs after an exposure before it takes the next trigger, in seconds: it does not expose
    /// while it reads out.
    pub camera_readout_s: f64,
}

/// What a unit can count and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnitRange {
    /// Shortest period of its clock, in nanoseconds.
    pub period_min_ns: u64,
    /// Longest period of its clock, in nanoseconds.
    pub period_max_ns: u64,
    /// Shortest pulse, in nanoseconds.
    pub width_min_ns: u64,
    /// Time that it needs between the end of its last pulse and the next period, in nanoseconds.
    pub recovery_ns: u64,
    /// Highest count of pulses.
    pub pulses_max: u64,
    /// What it counts.
    pub counts: Counts,
}

/// What a unit's burst counter counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counts {
    /// All clock pulses of a burst, pauses included.
    WholeBurst,
    /// The frames of one cycle; cycles are begun one by one.
    FramesOfCycle,
}

/// What a complaint is about, so that a configuration can name the key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    /// The limits themselves.
    Limits,
    /// The clock's period.
    Period,
    /// Exposure and read-out against the period.
    ReadOut,
    /// Cycles and pulses of a burst.
    Counts,
    /// The pause of a cycle.
    Pause,
    /// The camera's pulse.
    CameraPulse,
    /// The injector's pulse within the period.
    InjectorPulse,
    /// The injector's pulse against its limit.
    InjectorLength,
    /// Injections against the shortest interval.
    InjectionInterval,
}

/// Something that may not be programmed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Complaint {
    /// What it is about.
    pub about: About,
    /// The value and the limit, in words.
    pub why: String,
}

/// Everything that speaks against a program; empty when it may be sent.
pub fn complaints(program: &ShotProgram, limits: &TriggerLimits, range: &UnitRange) -> Vec<Complaint> {
    let mut found = Vec::new();
    let mut unless = |holds: bool, about: About, why: &dyn Fn() -> String| {
        if !holds {
            found.push(Complaint { about, why: why() });
        }
    };
    let values = [
        limits.injector_pulse_max_s,
        limits.injection_interval_min_s,
        limits.camera_integration_s,
        limits.camera_readout_s,
    ];
    let are_numbers = values.iter().all(|limit| limit.is_finite() && *limit >= 0.0);
    unless(are_numbers, About::Limits, &|| format!("the limits must be numbers from 0 on: {limits:?}"));

    let period_s = seconds(program.period_ns);
    let is_timed = (range.period_min_ns..=range.period_max_ns).contains(&program.period_ns);
    unless(is_timed, About::Period, &|| {
        let (least, most) = (seconds(range.period_min_ns), seconds(range.period_max_ns));
        format!("period {period_s} s: the unit's clock goes from {least:e} s to {most} s")
    });
    let camera_s = limits.camera_integration_s + limits.camera_readout_s;
    unless(period_s >= camera_s, About::ReadOut, &|| {
        format!("frames {period_s} s apart: exposure and read-out take {camera_s} s, and the camera is busy")
    });
    counts(program, range, &mut unless);
    pulses(program, limits, range, &mut unless);
    found
}

/// What a person should try when a program is not allowed.
pub(crate) const LIMIT_HINT: &str = "Change the times of the plan, or the limit if the rig really allows it.";

/// What a person should try when a trigger unit does not do what it is told.
pub(crate) const PANEL_HINT: &str =
    "Check that nobody works at its front panel, and switch it off and on if it persists.";

/// The question that each unit asks before it sends anything.
///
/// # Errors
/// [`DriverError::Limit`] with all [`complaints`].
pub(crate) fn check(
    who: &str,
    program: &ShotProgram,
    limits: &TriggerLimits,
    range: &UnitRange,
) -> Result<(), DriverError> {
    let why: Vec<_> = complaints(program, limits, range).into_iter().map(|complaint| complaint.why).collect();
    if why.is_empty() {
        return Ok(());
    }
    Err(DriverError::limit(who, "programming a burst", why.join("; "), LIMIT_HINT))
}

type Unless<'a> = dyn FnMut(bool, About, &dyn Fn() -> String) + 'a;

fn counts(program: &ShotProgram, range: &UnitRange, unless: &mut Unless<'_>) {
    let period_s = seconds(program.period_ns);
    let frames = u64::from(program.warm_up) + u64::from(program.blanks) + 1;
    let cycle = u64::from(program.cycle_periods);
    let pulses = u64::from(program.wait_periods) + cycle * u64::from(program.cycles);
    let (counted, what) = match range.counts {
        Counts::WholeBurst => (pulses, "clock pulses in a burst"),
        Counts::FramesOfCycle => (frames, "frames in a cycle"),
    };
    let most = range.pulses_max;
    unless(program.cycles > 0 && counted <= most, About::Counts, &|| {
        format!("{counted} {what}, {} cycles: the unit counts from 1 to {most}", program.cycles)
    });
    unless(program.period_ns.saturating_mul(pulses) <= BURST_MAX_NS, About::Counts, &|| {
        format!("a burst of {pulses} periods of {period_s} s would last for more than a year")
    });
    unless(frames < cycle, About::Pause, &|| {
        format!("{frames} frames in a cycle of {cycle} periods: no pause is left")
    });
}

fn pulses(program: &ShotProgram, limits: &TriggerLimits, range: &UnitRange, unless: &mut Unless<'_>) {
    let least = range.width_min_ns;
    let last_ns = program.period_ns.saturating_sub(range.recovery_ns);
    let ends_ns = |delay_ns: u64, width_ns: u64| delay_ns.saturating_add(width_ns);
    let mut pulse = |name: &str, about: About, delay_ns: u64, width_ns: u64| {
        let end_ns = ends_ns(delay_ns, width_ns);
        unless(width_ns >= least && end_ns < last_ns, about, &|| {
            format!(
                "{name} pulse of {width_ns} ns ends {end_ns} ns after the clock: it must last for {least} ns at least \
                 and end within one period, before {last_ns} ns"
            )
        });
    };
    pulse("camera", About::CameraPulse, program.camera_delay_ns, program.camera_width_ns);
    if !program.inject {
        return;
    }
    pulse("injector", About::InjectorPulse, program.injector_delay_ns, program.injector_width_ns);
    let injector_s = seconds(program.injector_width_ns);
    unless(injector_s <= limits.injector_pulse_max_s, About::InjectorLength, &|| {
        format!("injector pulse {injector_s} s: the longest allowed is {} s", limits.injector_pulse_max_s)
    });
    let cycle_s = seconds(program.period_ns) * f64::from(program.cycle_periods);
    let interval_s = limits.injection_interval_min_s;
    unless(cycle_s >= interval_s, About::InjectionInterval, &|| {
        format!("injections {cycle_s} s apart: the shortest interval allowed is {interval_s} s")
    });
}

fn seconds(ns: u64) -> f64 {
    Duration::from_nanos(ns).as_secs_f64()
}

/// When fuel was last injected, at the latest. The injections of one burst keep their distance by its cycle; this keeps
/// it between two bursts, also when a program is sent again.
#[derive(Debug, Clone, Copy, Default)]
pub struct LastInjection(Option<Instant>);

impl LastInjection {
    /// Remembers an injection that took place, or may have taken place, at `at`.
    pub fn note(&mut self, at: Instant) {
        self.0 = Some(self.0.map_or(at, |last| last.max(at)));
    }

    /// The first moment at which fuel may be injected again; `None` when there was no injection yet.
    pub fn next_allowed(&self, limits: &TriggerLimits) -> Option<Instant> {
        self.0.map(|last| last + Duration::from_secs_f64(limits.injection_interval_min_s))
    }

    /// What speaks against an injection at `first`.
    pub fn complaint(&self, first: Instant, limits: &TriggerLimits) -> Option<String> {
        let last = self.0?;
        let interval_s = first.saturating_duration_since(last).as_secs_f64();
        let least = limits.injection_interval_min_s;
        (interval_s < least).then(|| {
            format!(
                "the last injection would be only {interval_s:.3} s before the first: {least} s are needed"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use About::{
        CameraPulse, Counts as Count, InjectionInterval, InjectorLength, InjectorPulse, Limits, Pause,
        Period, ReadOut,
    };

    const RANGE: UnitRange = UnitRange {
        period_min_ns: 50,
        period_max_ns: 5_000_000_000_000,
        width_min_ns: 10,
        recovery_ns: 100,
        pulses_max: 9_999_999,
        counts: Counts::WholeBurst,
    };

    fn limits() -> TriggerLimits {
        TriggerLimits {
            injector_pulse_max_s: 0.005,
            injection_interval_min_s: 15.0,
            camera_integration_s: 25e-6,
            camera_readout_s: 0.008,
        }
    }

    fn program() -> ShotProgram {
        ShotProgram {
            period_ns: 20_000_000,
            wait_periods: 5,
            warm_up: 2,
            blanks: 4,
            inject: true,
            cycle_periods: 800,
            cycles: 6,
            camera_delay_ns: 2_000_000,
            camera_width_ns: 25_000,
            injector_delay_ns: 500_000,
            injector_width_ns: 1_500_000,
        }
    }

    fn abouts(program: &ShotProgram, limits: &TriggerLimits) -> Vec<About> {
        complaints(program, limits, &RANGE).into_iter().map(|complaint| complaint.about).collect()
    }

    /// Each limit alone, just inside and just outside.
    #[test]
    fn each_limit_is_drawn_where_it_says() {
        let good = [
            program(),
            ShotProgram { injector_width_ns: 5_000_000, ..program() },
            ShotProgram { cycle_periods: 750, ..program() },
            ShotProgram { blanks: 796, ..program() },
            ShotProgram { camera_delay_ns: 20_000_000 - 25_000 - 101, ..program() },
            ShotProgram { camera_width_ns: 10, injector_width_ns: 10, ..program() },
            // Without injection nothing of the injector counts.
            ShotProgram { inject: false, injector_width_ns: 0, cycle_periods: 8, ..program() },
        ];
        for program in good {
            assert_eq!(abouts(&program, &limits()), [], "{program:?}");
        }
        for (bad, about) in [
            (ShotProgram { injector_width_ns: 5_000_001, ..program() }, vec![InjectorLength]),
            (ShotProgram { cycle_periods: 749, ..program() }, vec![InjectionInterval]),
            (ShotProgram { blanks: 797, ..program() }, vec![Pause]),
            (ShotProgram { period_ns: 8_000_000, cycle_periods: 1900, ..program() }, vec![ReadOut]),
            (ShotProgram { cycles: 12_500, ..program() }, vec![Count]),
            (ShotProgram { cycles: 0, ..program() }, vec![Count]),
            (ShotProgram { cycles: u32::MAX, cycle_periods: u32::MAX, ..program() }, vec![Count, Count]),
            (ShotProgram { period_ns: 5_000_000_000_000, cycles: 10_000, ..program() }, vec![Count]),
            (ShotProgram { period_ns: 5_000_000_000_010, cycles: 1, ..program() }, vec![Period]),
            (ShotProgram { camera_delay_ns: 20_000_000 - 25_000 - 100, ..program() }, vec![CameraPulse]),
            (ShotProgram { camera_delay_ns: u64::MAX, ..program() }, vec![CameraPulse]),
            (ShotProgram { camera_width_ns: 0, ..program() }, vec![CameraPulse]),
            (ShotProgram { camera_width_ns: 9, ..program() }, vec![CameraPulse]),
            (ShotProgram { injector_width_ns: 0, ..program() }, vec![InjectorPulse]),
            (ShotProgram { injector_delay_ns: 19_000_000, ..program() }, vec![InjectorPulse]),
        ] {
            assert_eq!(abouts(&bad, &limits()), about, "{bad:?}");
        }
    }

    #[test]
    fn a_period_below_the_clocks_is_named_and_nothing_overflows() {
        let found = abouts(&ShotProgram { period_ns: 0, ..program() }, &limits());
        assert!(found.contains(&Period) && found.contains(&CameraPulse), "{found:?}");
        let all = u32::MAX;
        let worst = ShotProgram {
            period_ns: u64::MAX,
            wait_periods: all,
            warm_up: all,
            blanks: all,
            cycle_periods: all,
            cycles: all,
            ..program()
        };
        assert!(abouts(&worst, &limits()).contains(&Pause));
    }

    #[test]
    fn limits_that_are_no_numbers_allow_nothing() {
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            for limits in [
                TriggerLimits { injector_pulse_max_s: bad, ..limits() },
                TriggerLimits { injection_interval_min_s: bad, ..limits() },
                TriggerLimits { camera_integration_s: bad, ..limits() },
                TriggerLimits { camera_readout_s: bad, ..limits() },
            ] {
                assert!(abouts(&program(), &limits).contains(&Limits), "{limits:?}");
            }
        }
    }

    /// A unit that is begun cycle by cycle counts the frames of one only.
    #[test]
    fn the_unit_says_what_it_counts() {
        let range = UnitRange { pulses_max: 7, counts: Counts::FramesOfCycle, ..RANGE };
        assert_eq!(complaints(&program(), &limits(), &range), []);
        let one_more = ShotProgram { blanks: 5, ..program() };
        assert_eq!(complaints(&one_more, &limits(), &range)[0].about, Count);
    }

    #[tokio::test(start_paused = true)]
    async fn the_interval_runs_from_the_latest_injection() {
        let mut last = LastInjection::default();
        let now = Instant::now();
        assert_eq!(last.complaint(now, &limits()), None);
        last.note(now + Duration::from_secs(3));
        last.note(now);
        let first = |s: u64| now + Duration::from_secs(s);
        assert!(last.complaint(first(0), &limits()).is_some());
        assert!(last.complaint(first(17), &limits()).is_some_and(|why| why.contains("14.000 s")));
        assert_eq!(last.complaint(first(18), &limits()), None);
        assert_eq!(last.next_allowed(&limits()), Some(first(18)));
    }
}
