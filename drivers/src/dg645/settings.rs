//! The settings that make one burst of the unit one cycle of a program.
//!
//! A burst is the frames of a cycle: the camera's output fires in each of its delay cycles, the injector's is prescaled by
//! their number and its phase puts it on the last. As many delay cycles as the prescaler counts to make a burst, so
//! the next burst begins where this one did.

use super::table::Key;
use super::value::Value;
use super::{CAMERA_OUTPUT, INJECTOR_OUTPUT};
use crate::instrument::ShotProgram;

/// Amplitude of a pulse that fires the injector, in volts: the highest (maker's driver), so that a terminated TTL input
/// still sees 2.5 V.
pub(super) const ARMED_V: f64 = 5.0;

/// Amplitude of a pulse that fires nothing, in volts: the lowest. A TTL input takes everything below 0.8 V for low. The
/// unit has no switch for an output.
pub(super) const DISARMED_V: f64 = 0.5;

/// Single shot: begun by `*TRG` and by nothing else.
pub(super) const SINGLE_SHOT: u64 = 5;

const PS_PER_NS: i64 = 1000;

/// One setting: key, index, value.
pub(super) type Setting = (Key, u32, Value);

/// What makes the injector's output harmless and the unit wait, in this order.
pub(super) fn at_rest() -> [Setting; 3] {
    [
        (Key::Amplitude, INJECTOR_OUTPUT, Value::Real(DISARMED_V)),
        (Key::TriggerSource, 0, Value::Count(SINGLE_SHOT)),
        (Key::BurstMode, 0, Value::Count(0)),
    ]
}

/// Everything that a program needs, in the order in which it is told. A key may come twice: the last one counts.
pub(super) fn settings_of(program: &ShotProgram) -> Vec<Setting> {
    let frames = u64::from(program.frames_per_cycle());
    let mut settings = at_rest().to_vec();
    settings.extend([
        // An inverted output would be on with a low amplitude, a shifted one never off.
        (Key::Polarity, INJECTOR_OUTPUT, Value::Count(1)),
        (Key::Offset, INJECTOR_OUTPUT, Value::Real(0.0)),
        (Key::AdvancedTrigger, 0, Value::Count(1)),
        (Key::Holdoff, 0, Value::Time(0)),
        (Key::Prescale, 0, Value::Count(1)),
        (Key::Prescale, CAMERA_OUTPUT, Value::Count(1)),
        (Key::Phase, CAMERA_OUTPUT, Value::Count(0)),
        // With factor 1 the counter has no state but zero: from here it counts, whatever an aborted burst left behind.
        (Key::Phase, INJECTOR_OUTPUT, Value::Count(0)),
        (Key::Prescale, INJECTOR_OUTPUT, Value::Count(1)),
        (Key::Prescale, INJECTOR_OUTPUT, Value::Count(frames)),
        (Key::Phase, INJECTOR_OUTPUT, Value::Count(frames - 1)),
    ]);
    let pulse = |output: u32, delay_ns: u64, width_ns: u64| {
        let first = 2 * output;
        [
            (Key::Delay, first, Value::Delay { after: 0, ps: ps(delay_ns) }),
            (Key::Delay, first + 1, Value::Delay { after: first, ps: ps(width_ns) }),
        ]
    };
    // The outputs that are not used must not make the delay cycle longer than the period.
    settings.extend([pulse(3, 0, 10), pulse(4, 0, 10)].into_iter().flatten());
    settings.extend(pulse(CAMERA_OUTPUT, program.camera_delay_ns, program.camera_width_ns));
    let injector =
        if program.inject { (program.injector_delay_ns, program.injector_width_ns) } else { (0, 10) };
    settings.extend(pulse(INJECTOR_OUTPUT, injector.0, injector.1));
    settings.extend([
        (Key::BurstCount, 0, Value::Count(frames)),
        (Key::BurstPeriod, 0, Value::Time(ps(program.period_ns))),
        (Key::BurstDelay, 0, Value::Time(0)),
        (Key::BurstT0, 0, Value::Count(0)),
        (Key::BurstMode, 0, Value::Count(1)),
    ]);
    if program.inject {
        settings.push((Key::Amplitude, INJECTOR_OUTPUT, Value::Real(ARMED_V)));
    }
    settings
}

fn ps(ns: u64) -> i64 {
    // Checked before: a period is at most 42.9 s, and everything else ends within it.
    i64::try_from(ns).expect("times are below a minute") * PS_PER_NS
}
