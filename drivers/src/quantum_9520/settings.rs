//! The settings that make the unit repeat a program by itself.

use super::table::Key;
use super::value::Value;
use super::{CAMERA_CHANNEL, INJECTOR_CHANNEL, PS_PER_NS};
use crate::instrument::ShotProgram;

/// The settings that make the unit repeat a program by itself.
///
/// The clock runs one burst of all pulses, pauses included. The camera's channel is on for the frames of a cycle and
/// off for the rest of it; the injector's is on for one pulse a cycle, and its wait count puts that pulse on the
/// last frame.
pub(super) fn settings_of(program: &ShotProgram) -> Vec<(u32, Key, Value)> {
    let word = |text: &str| Value::Word(text.to_owned());
    let frames = program.frames_per_cycle();
    let spray_wait = program.wait_periods + program.warm_up + program.blanks;
    let burst = program.wait_periods + program.cycle_periods * program.cycles;
    let camera_off = program.cycle_periods - frames;
    let mut settings = vec![
        // Off first: a change of counts while a channel is on could let a pulse out.
        (INJECTOR_CHANNEL, Key::State, Value::Flag(false)),
        (0, Key::Period, time(program.period_ns)),
        (0, Key::Mode, word("BURS")),
        (0, Key::BurstCount, count(burst)),
        // With a trigger mode on, STATE 1 would only arm.
        (0, Key::TriggerMode, word("DIS")),
        (0, Key::GateMode, word("DIS")),
    ];
    for (channel, on, off, wait, delay_ns, width_ns) in [
        (
            CAMERA_CHANNEL,
            frames,
            camera_off,
            program.wait_periods,
            program.camera_delay_ns,
            program.camera_width_ns,
        ),
        (
            INJECTOR_CHANNEL,
            1,
            program.cycle_periods - 1,
            spray_wait,
            program.injector_delay_ns,
            program.injector_width_ns,
        ),
    ] {
        if channel == INJECTOR_CHANNEL && !program.inject {
            continue;
        }
        settings.extend([
            (channel, Key::Sync, word("T0")),
            (channel, Key::ChannelMode, word("DCYC")),
            (channel, Key::OnCount, count(on)),
            (channel, Key::OffCount, count(off)),
            (channel, Key::WaitCount, count(wait)),
            (channel, Key::Delay, time(delay_ns)),
            (channel, Key::Width, time(width_ns)),
            (channel, Key::State, Value::Flag(true)),
        ]);
    }
    settings
}

fn time(ns: u64) -> Value {
    // Checked before: a period is at most 5000 s, and everything else ends within it.
    Value::Time(i64::try_from(ns).expect("times are below 5000 s") * PS_PER_NS)
}

fn count(pulses: u32) -> Value {
    Value::Count(u64::from(pulses))
}
