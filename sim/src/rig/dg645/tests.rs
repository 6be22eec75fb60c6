//! The unit against its sources, and the driver over it.

use crate::rig::pulse::Pulse;
use crate::rig::pulser::{PulserBehaviour, TriggerFault};
use crate::rig::pulser_bench::{
    all, assert_a_dead_unit_is_told, assert_bad_answers_change_nothing, begin_all, driven, heard, meant,
    program, run, served, with,
};
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{ShotProgram, TriggerUnit};
use ditd_drivers::quantum_9520::UnitError;
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::time::{Instant, sleep};

const DRIVER: &str = "dg645";

/// Time within which a cycle begins after it is due: the command's bytes and tokio's grain.
const PROMPT_NS: u64 = 2_000_000;

/// The pulses that came, each with its place in its cycle; cycles must be in time to [`PROMPT_NS`], and frames exact.
fn made(pulses: &[Pulse], program: &ShotProgram) -> Vec<(u64, Option<(u64, u64)>)> {
    let frames = program.frames_per_cycle() as usize;
    let zero_ns = pulses[0].at_ns - program.frame_ns(0, 0);
    let mut made = Vec::new();
    for (cycle, burst) in (0_u32..).zip(pulses.chunks(frames)) {
        let due_ns = zero_ns + program.frame_ns(cycle, 0);
        let late_ns = burst[0].at_ns.abs_diff(due_ns);
        assert!(late_ns <= PROMPT_NS, "cycle {cycle} is {late_ns} ns off");
        for (position, pulse) in (0_u32..).zip(burst) {
            assert_eq!(pulse.camera, Some((program.camera_delay_ns, program.camera_width_ns)));
            assert_eq!(pulse.at_ns - burst[0].at_ns, u64::from(position) * program.period_ns);
            made.push((program.frame_ns(cycle, position), pulse.injector));
        }
    }
    made
}

async fn told(near: &mut DuplexStream, commands: &[&str]) {
    for command in commands {
        assert_eq!(heard(near, &format!("{command}\r\n")).await, "", "{command}");
    }
}

/// Exchanges as the maker's driver and its tests show them.
#[tokio::test(start_paused = true)]
async fn a_transcript_goes_as_the_sources_say() {
    let (mut near, mut pulses) = served(DRIVER, PulserBehaviour::delivered());
    for (said, expected) in [
        ("*IDN?", "Stanford Research Systems,DG645,s/n001645,ver1.14.10E\r\n"),
        ("*ESR?", "128\r\n"),
        ("*ESR?", "0\r\n"),
        ("TSRC?", "5\r\n"),
        ("INHB?", "1\r\n"),
        ("LAMP?1", "2.50\r\n"),
        ("DLAY?3", "2,+0.000000010000\r\n"),
        ("DLAY 3,2,1.000000e-03", ""),
        ("DLAY? 3", "2,+0.001000000000\r\n"),
        ("DLAY 3,2,0.000000000007", ""),
        ("DLAY?3", "2,+0.000000000005\r\n"),
        ("LERR?", "0\r\n"),
        ("TSRC 99", ""),
        ("TRAT -1", ""),
        ("DLAY 2,2,0", ""),
        ("DLAY 3,2,1999", ""),
        ("DLAY 2,0,2", ""),
        ("LERR?", "10\r\n"),
        ("LERR?", "10\r\n"),
        ("LERR?", "13\r\n"),
        ("LERR?", "12\r\n"),
        ("LERR?", "0\r\n"),
        ("*IDN", ""),
        ("*ESR?", "48\r\n"),
        ("*SRE? 3", ""),
        ("*CLS", ""),
        ("LERR?", "0\r\n"),
        ("PULS?", ""),
        ("*RST", ""),
        ("INSR?", "0\r\n"),
        ("*TRG", ""),
        ("INSR?", "5\r\n"),
        ("INSR?", "0\r\n"),
        ("*STB?", "0\r\n"),
    ] {
        assert_eq!(heard(&mut near, &format!("{said}\r\n")).await, expected, "{said}");
    }
    // One shot of every output, as delivered.
    assert_eq!(all(&mut pulses).await.len(), 1);
}

/// Prescale and phase with single triggers, as the sources say: the injector on every second trigger.
#[tokio::test(start_paused = true)]
async fn a_prescaled_output_fires_on_every_second_trigger() {
    let (mut near, mut pulses) = served(DRIVER, PulserBehaviour::delivered());
    told(&mut near, &["ADVT 1", "PRES 1,2", "*TRG", "*TRG", "*TRG", "*TRG"]).await;
    let fired: Vec<bool> = all(&mut pulses).await.iter().map(|pulse| pulse.injector.is_some()).collect();
    assert_eq!(fired, [true, false, true, false]);
}

#[tokio::test(start_paused = true)]
async fn the_internal_rate_runs_until_it_is_stopped() {
    let (mut near, mut pulses) = served(DRIVER, PulserBehaviour::delivered());
    told(&mut near, &["TRAT 0.5", "BURC 3", "BURP 0.1", "BURM 1", "TSRC 0"]).await;
    sleep(Duration::from_secs(5)).await;
    told(&mut near, &["TSRC 5"]).await;
    let times: Vec<u64> = all(&mut pulses).await.iter().map(|pulse| pulse.at_ns / 1_000_000).collect();
    let after: Vec<u64> = times.iter().map(|at| at - times[0]).collect();
    assert_eq!(after, [0, 100, 200, 2000, 2100, 2200]);
}

#[tokio::test(start_paused = true)]
async fn a_trigger_during_a_burst_is_overlooked_and_told() {
    let (mut near, mut pulses) = served(DRIVER, PulserBehaviour::delivered());
    told(&mut near, &["BURC 3", "BURP 2", "BURM 1", "*TRG", "*TRG"]).await;
    assert_eq!(heard(&mut near, "*STB?\r\n").await, "6\r\n");
    assert_eq!(heard(&mut near, "INSR?\r\n").await, "3\r\n");
    assert_eq!(all(&mut pulses).await.len(), 3);
    assert_eq!(heard(&mut near, "INSR?\r\n").await, "12\r\n");
    assert_eq!(heard(&mut near, "*STB?\r\n").await, "0\r\n");
}

#[tokio::test(start_paused = true)]
async fn a_programmed_burst_makes_exactly_the_pulses_that_are_meant() {
    for program in [
        program(),
        ShotProgram { wait_periods: 0, warm_up: 0, ..program() },
        ShotProgram { inject: false, ..program() },
        ShotProgram { blanks: 0, warm_up: 0, cycles: 1, ..program() },
        ShotProgram { period_ns: 10_000_130, cycle_periods: 1500, cycles: 240, ..program() },
    ] {
        let (mut unit, receiver) = driven(DRIVER, PulserBehaviour::delivered());
        assert_eq!(unit.identify().await.unwrap().model, "DG645");
        assert!(unit.is_begun_by_cycle());
        let pulses = run(unit.as_mut(), receiver, &program).await.unwrap();
        assert_eq!(made(&pulses, &program), meant(&program));
        assert!(!unit.running().await.unwrap());
        let error = unit.begin_cycle(program.cycles, Instant::now()).await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    }
}

/// Nobody begins a cycle any more, so nothing is fired any more.
#[tokio::test(start_paused = true)]
async fn without_its_driver_it_fires_nothing_more() {
    let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
    unit.program(&program()).await.unwrap();
    unit.start().await.unwrap();
    unit.begin_cycle(0, Instant::now()).await.unwrap();
    drop(unit);
    let mut pulses = Vec::new();
    while let Some(pulse) = receiver.recv().await {
        pulses.push(pulse);
    }
    assert_eq!(made(&pulses, &program()), meant(&ShotProgram { cycles: 1, ..program() }));
}

/// A stop in the middle of a burst leaves the prescaler where it stood: the next program must not inherit it.
#[tokio::test(start_paused = true)]
async fn a_burst_that_was_cut_does_not_shift_the_next() {
    for position in 0..7_u64 {
        let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
        let short = ShotProgram { period_ns: 1_000_000_000, cycle_periods: 20, cycles: 2, ..program() };
        unit.program(&short).await.unwrap();
        unit.start().await.unwrap();
        unit.begin_cycle(0, Instant::now()).await.unwrap();
        sleep(Duration::from_millis(1000 * position + 500)).await;
        unit.stop().await.unwrap();
        assert!(!unit.running().await.unwrap());
        let cut = all(&mut receiver).await;
        assert!(cut.len() as u64 >= position && cut.len() as u64 <= position + 1, "{}", cut.len());
        assert!(cut.iter().enumerate().all(|(place, pulse)| pulse.injector.is_some() == (place == 6)));
        sleep(Duration::from_secs(20)).await;
        let pulses = run(unit.as_mut(), receiver, &short).await.unwrap();
        assert_eq!(made(&pulses, &short), meant(&short), "cut after {position}");
    }
}

#[tokio::test(start_paused = true)]
async fn two_bursts_keep_the_shortest_interval_between_injections() {
    let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
    let short = ShotProgram { cycles: 1, wait_periods: 0, ..program() };
    for _ in 0..3 {
        unit.program(&short).await.unwrap();
        unit.start().await.unwrap();
        begin_all(unit.as_mut(), &short).await.unwrap();
        sleep(Duration::from_secs(1)).await;
        unit.stop().await.unwrap();
    }
    let fired: Vec<u64> =
        all(&mut receiver).await.iter().filter(|p| p.injector.is_some()).map(|p| p.at_ns).collect();
    assert_eq!(fired.len(), 3);
    // To tokio's grain of a millisecond.
    assert!(fired.windows(2).all(|pair| pair[1] - pair[0] >= 15_000_000_000 - 1_000_000), "{fired:?}");
}

#[tokio::test(start_paused = true)]
async fn what_was_not_taken_is_refused() {
    let ignored = |command: &str| TriggerFault::Ignores { command: command.to_owned() };
    let refused =
        |command: &str| TriggerFault::Refuses { command: command.to_owned(), error: UnitError::Unavailable };
    for fault in [ignored("PHAS 1"), ignored("BURC"), ignored("LAMP 1,5"), refused("BURP"), refused("DLAY 3")]
    {
        let (mut unit, mut receiver) = driven(DRIVER, with(fault.clone()));
        let error = unit.program(&program()).await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{fault:?}: {error}");
        let error = unit.start().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{fault:?}: {error}");
        assert!(all(&mut receiver).await.is_empty());
    }
    let (mut unit, mut receiver) = driven(DRIVER, with(ignored("*TRG")));
    unit.program(&program()).await.unwrap();
    unit.start().await.unwrap();
    let error = unit.begin_cycle(0, Instant::now()).await.unwrap_err();
    assert!(error.to_string().contains("no trigger"), "{error}");
    assert!(all(&mut receiver).await.is_empty());
    let odd = ShotProgram { period_ns: 20_000_003, ..program() };
    let (mut unit, _pulses) = driven(DRIVER, PulserBehaviour::delivered());
    let error = unit.program(&odd).await.unwrap_err();
    assert!(error.to_string().contains("told 0.020000003000, holds 0.020000000000"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn limits_are_refused_before_anything_is_sent() {
    let (near, _far) = tokio::io::duplex(4096);
    let wire = ditd_drivers::wire::Wire::over(near, "trigger unit");
    let mut unit = ditd_drivers::dg645::Dg645::new(wire, crate::rig::pulser_bench::limits());
    for (words, bad) in [
        ("longest allowed", ShotProgram { injector_width_ns: 5_000_001, ..program() }),
        ("shortest interval", ShotProgram { cycle_periods: 749, ..program() }),
        ("camera pulse", ShotProgram { camera_delay_ns: 19_974_900, ..program() }),
        ("42.9", ShotProgram { period_ns: 42_900_000_001, ..program() }),
    ] {
        let error = unit.program(&bad).await.unwrap_err();
        assert!(matches!(error, DriverError::Limit { .. }) && error.to_string().contains(words), "{error}");
    }
}

/// Its outputs may be silenced by an input while frames go on: such a setting is refused.
#[tokio::test(start_paused = true)]
async fn an_inhibited_output_is_refused() {
    let (mut near, _pulses) = served(DRIVER, PulserBehaviour::delivered());
    told(&mut near, &["INHB 2"]).await;
    let wire = ditd_drivers::wire::Wire::over(near, "trigger unit");
    let mut unit = ditd_drivers::dg645::Dg645::new(wire, crate::rig::pulser_bench::limits());
    let error = unit.program(&program()).await.unwrap_err();
    assert!(error.to_string().contains("INHB"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_unit_that_was_switched_off_and_on_is_noticed() {
    let (mut unit, mut receiver) = driven(DRIVER, with(TriggerFault::Reboots { at_s: 20.0, boot_s: 4.0 }));
    unit.identify().await.unwrap();
    unit.program(&program()).await.unwrap();
    unit.start().await.unwrap();
    let error = begin_all(unit.as_mut(), &program()).await.unwrap_err();
    assert!(error.to_string().contains("switched off and on"), "{error}");
    unit.make_safe().await.unwrap();
    let fired = all(&mut receiver).await.iter().filter(|pulse| pulse.injector.is_some()).count();
    assert_eq!(fired, 2);
}

#[tokio::test(start_paused = true)]
async fn faults_of_the_line_do_not_change_the_program() {
    assert_bad_answers_change_nothing(DRIVER, made).await;
}

#[tokio::test(start_paused = true)]
async fn the_injector_is_off_even_if_the_clock_is_not_confirmed() {
    let fault = TriggerFault::Refuses { command: "BURM 0".to_owned(), error: UnitError::Unavailable };
    let (mut unit, mut receiver) = driven(DRIVER, with(fault));
    let slow = ShotProgram { period_ns: 200_000_000, cycle_periods: 80, ..program() };
    // The program itself needs BURM 0 and BURM 1; told by hand it runs.
    let error = unit.program(&slow).await.unwrap_err();
    assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    unit.make_safe().await.unwrap_err();
    assert!(all(&mut receiver).await.is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_dead_unit_is_silent_and_a_pulled_line_is_lost() {
    assert_a_dead_unit_is_told(DRIVER).await;
}
