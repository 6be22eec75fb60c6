//! The unit against the manual, and the driver over it.

use crate::rig::pulser::{self, PulserBehaviour, TriggerFault};
use crate::rig::pulser_bench::{
    all, assert_a_dead_unit_is_told, assert_bad_answers_change_nothing, driven, heard, limits, made, meant,
    program, run, served, with,
};
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{ShotProgram, TriggerUnit};
use ditd_drivers::quantum_9520::{Quantum9520, UnitError};
use ditd_drivers::trigger_limits::TriggerLimits;
use ditd_drivers::wire::Wire;
use std::time::Duration;
use tokio::io::duplex;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep};

const DRIVER: &str = "quantum_9520";

/// Exchanges as chapter 7 describes them.
#[tokio::test(start_paused = true)]
async fn a_transcript_goes_as_the_manual_says() {
    let (mut near, mut pulses) = served(DRIVER, PulserBehaviour::delivered());
    for (said, expected) in [
        (":SYST:STAT?\r\n", "0\r\n"),
        (":INST:CAT?\r\n", "T0,CHA,CHB,CHC,CHD,CHE,CHF,CHG,CHH\r\n"),
        ("*IDN?\r\n", "QC,9528,10123,5.9\r\n"),
        (":PULSE1:WIDT 0.00012\r\n", "ok\r\n"),
        (":PULSE1:WIDT?\r\n", "0.000120000\r\n"),
        (":pulse1:width?\r\n", "0.000120000\r\n"),
        (":PULSE:STATE?\r\n", "0\r\n"),
        (":PULSE1:POL?\r\n", "NORM\r\n"),
        (":PULSE1:POLAR?\r\n", "?3\r\n"),
        ("PULSE1:POL?\r\n", "?1\r\n"),
        (":PULSE1:WIDT\r\n", "?4\r\n"),
        (":PULSE1:WIDT -1\r\n", "?5\r\n"),
        (":SYST:STAT 1\r\n", "?6\r\n"),
        ("*TRG?\r\n", "?7\r\n"),
        (":PULSE1:CGAT PULS\r\n", "?8\r\n"),
        ("*TRG\r\n", "?8\r\n"),
        (":PULSE9:STATE 1\r\n", "?3\r\n"),
        (":SYST:COMM:SER:ECH 1\r\n", "ok\r\n"),
        (":PULSE1:STATE?\r\n", ":PULSE1:STATE?\r\n0\r\n"),
        (":SYST:COMM:SER:ECH 0\r\n", ":SYST:COMM:SER:ECH 0\r\nok\r\n"),
        // Arms, and fires nothing.
        (":PULSE0:TRIG:MODE TRIG\r\n", "ok\r\n"),
        (":PULSE0:COUN:STAT 1\r\n", "ok\r\n"),
        (":PULSE1:STATE 1\r\n", "ok\r\n"),
        (":PULSE0:STATE 1\r\n", "ok\r\n"),
        (":SYST:STAT?\r\n", "1\r\n"),
    ] {
        assert_eq!(heard(&mut near, said).await, expected, "{said}");
    }
    assert!(all(&mut pulses).await.is_empty());
    assert_eq!(heard(&mut near, "*TRG\r\n").await, "ok\r\n");
    assert_eq!(heard(&mut near, ":PULSE0:COUN:COUN? TCNTS\r\n").await, "1\r\n");
    assert_eq!(all(&mut pulses).await.len(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_programmed_burst_makes_exactly_the_pulses_that_are_meant() {
    for program in [
        program(),
        ShotProgram { wait_periods: 0, warm_up: 0, ..program() },
        ShotProgram { inject: false, ..program() },
        ShotProgram { blanks: 0, cycles: 1, ..program() },
    ] {
        let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
        unit.identify().await.unwrap();
        assert_eq!(unit.program(&program).await.unwrap(), program);
        let collected = tokio::spawn(async move { all(&mut receiver).await });
        unit.start().await.unwrap();
        assert!(unit.running().await.unwrap());
        let pulses = collected.await.unwrap();
        assert_eq!(made(&pulses, &program), meant(&program));
        assert!(!unit.running().await.unwrap());
    }
}

/// 1200 cycles of 15 s are five hours of virtual time; the clock wakes up for active pulses only, which the number
/// of timers it needs does not show, but the time of this test does.
#[tokio::test(start_paused = true)]
async fn a_campaign_of_five_hours_costs_nothing_and_keeps_its_times_exactly() {
    let program = ShotProgram { period_ns: 10_000_130, cycle_periods: 1500, cycles: 1200, ..program() };
    let (mut unit, receiver) = driven(DRIVER, PulserBehaviour::delivered());
    let pulses = run(unit.as_mut(), receiver, &program).await.unwrap();
    assert_eq!(made(&pulses, &program), meant(&program));
}

#[tokio::test(start_paused = true)]
async fn a_stop_cuts_the_burst_and_leaves_the_injector_off() {
    let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
    unit.program(&program()).await.unwrap();
    unit.start().await.unwrap();
    let started = Instant::now();
    for _ in 0..9 {
        receiver.recv().await.unwrap();
    }
    for _ in 0..2 {
        unit.make_safe().await.unwrap();
        assert!(!unit.running().await.unwrap());
    }
    assert!(started.elapsed() < Duration::from_secs(18));
    let late = all(&mut receiver).await;
    assert!(late.len() < 6 && late.iter().all(|pulse| pulse.injector.is_none()), "{late:?}");
    let error = unit.start().await.unwrap_err();
    assert!(matches!(error, DriverError::Refused { .. }), "{error}");
}

/// The injector is switched off before the clock: no injection after the first of the two commands.
#[tokio::test(start_paused = true)]
async fn switching_a_channel_off_during_a_run_takes_effect_at_once() {
    let (mut near, mut receiver) = served(DRIVER, PulserBehaviour::delivered());
    for said in [
        ":PULSE0:PER 0.1\r\n",
        ":PULSE1:STATE 1\r\n",
        ":PULSE2:STATE 1\r\n",
        ":PULSE2:CMOD DCYC\r\n",
        ":PULSE2:PCO 1\r\n",
        ":PULSE2:OCO 1\r\n",
        ":PULSE0:STATE 1\r\n",
    ] {
        assert_eq!(heard(&mut near, said).await, "ok\r\n");
    }
    sleep(Duration::from_millis(1020)).await;
    assert_eq!(heard(&mut near, ":PULSE2:STATE 0\r\n").await, "ok\r\n");
    sleep(Duration::from_millis(1000)).await;
    assert_eq!(heard(&mut near, ":PULSE0:STATE 0\r\n").await, "ok\r\n");
    let pulses = all(&mut receiver).await;
    for (index, pulse) in (0_u64..).zip(&pulses) {
        assert_eq!(pulse.t0_index, index);
        assert_eq!(pulse.at_ns - pulses[0].at_ns, index * 100_000_000);
        assert_eq!(pulse.injector.is_some(), index % 2 == 0 && index <= 10, "{index}");
    }
    assert!((20..=22).contains(&pulses.len()), "{}", pulses.len());
}

/// Each system mode with each channel mode, against the manual's description.
#[tokio::test(start_paused = true)]
async fn modes_restrict_as_the_manual_says() {
    for (system, channel, expected) in [
        ("SING", "NORM", vec![0]),
        ("BURS", "NORM", vec![0, 1, 2, 3, 4, 5]),
        ("BURS", "SING", vec![0]),
        ("BURS", "BURS", vec![0, 1, 2]),
        ("BURS", "DCYC", vec![0, 1, 5]),
        // Two clock pulses on, one off: the sixth pulse comes in the ninth period.
        ("DCYC", "BURS", vec![0, 1, 3]),
    ] {
        let (mut near, mut receiver) = served(DRIVER, PulserBehaviour::delivered());
        for said in [
            ":PULSE0:PER 1".to_owned(),
            format!(":PULSE0:MODE {system}"),
            ":PULSE0:BCO 6".to_owned(),
            ":PULSE0:PCO 2".to_owned(),
            ":PULSE0:OCO 1".to_owned(),
            ":PULSE1:STATE 1".to_owned(),
            format!(":PULSE1:CMOD {channel}"),
            ":PULSE1:BCO 3".to_owned(),
            ":PULSE1:PCO 2".to_owned(),
            ":PULSE1:OCO 3".to_owned(),
            ":PULSE0:STATE 1".to_owned(),
        ] {
            assert_eq!(heard(&mut near, &format!("{said}\r\n")).await, "ok\r\n", "{said}");
        }
        let pulses = all(&mut receiver).await;
        let seconds: Vec<_> =
            pulses.iter().map(|pulse| (pulse.at_ns - pulses[0].at_ns) / 1_000_000_000).collect();
        assert_eq!(seconds, expected, "{system} {channel}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_channel_that_fires_once_needs_to_be_armed_again() {
    let (mut near, mut receiver) = served(DRIVER, PulserBehaviour::delivered());
    let run = [":PULSE0:STATE 1\r\n", ":PULSE0:STATE 0\r\n"];
    for said in [":PULSE1:STATE 1\r\n", ":PULSE1:CMOD SING\r\n", run[0], run[1]] {
        assert_eq!(heard(&mut near, said).await, "ok\r\n");
    }
    assert_eq!(all(&mut receiver).await.len(), 1);
    for said in run {
        assert_eq!(heard(&mut near, said).await, "ok\r\n");
    }
    assert_eq!(all(&mut receiver).await.len(), 0);
    for said in ["*ARM\r\n", run[0], run[1]] {
        assert_eq!(heard(&mut near, said).await, "ok\r\n");
    }
    assert_eq!(all(&mut receiver).await.len(), 1);
}

#[tokio::test(start_paused = true)]
async fn limits_are_refused_before_anything_is_sent() {
    let (near, _far) = duplex(256);
    let mut unit = Quantum9520::new(Wire::over(near, "trigger unit"), limits());
    for (words, bad) in [
        ("longest allowed", ShotProgram { injector_width_ns: 5_000_001, ..program() }),
        ("shortest interval", ShotProgram { cycle_periods: 749, ..program() }),
        ("busy", ShotProgram { period_ns: 8_000_000, ..program() }),
        ("no pause", ShotProgram { blanks: 797, ..program() }),
        ("counts", ShotProgram { cycles: 20_000, ..program() }),
        ("counts", ShotProgram { cycles: 0, ..program() }),
        ("counts", ShotProgram { cycles: u32::MAX, cycle_periods: u32::MAX, ..program() }),
        ("5000 s", ShotProgram { period_ns: 10, ..program() }),
        ("a year", ShotProgram { period_ns: 5_000_000_000_000, cycles: 10_000, ..program() }),
        ("camera pulse", ShotProgram { camera_delay_ns: 19_990_000, ..program() }),
        ("camera pulse", ShotProgram { camera_delay_ns: u64::MAX, ..program() }),
        ("injector pulse", ShotProgram { injector_delay_ns: 19_000_000, ..program() }),
    ] {
        let error = unit.program(&bad).await.unwrap_err();
        assert!(matches!(error, DriverError::Limit { .. }), "{error}");
        assert!(error.to_string().contains(words), "{error}");
    }
    let (near, _far) = duplex(256);
    let no_number = TriggerLimits { injection_interval_min_s: f64::NAN, ..limits() };
    let mut unlimited = Quantum9520::new(Wire::over(near, "trigger unit"), no_number);
    let error = unlimited.program(&program()).await.unwrap_err();
    assert!(matches!(error, DriverError::Limit { .. }), "{error}");
    // Nobody answers on this line: a program that passed the limits would be silent.
    let error = unit.program(&program()).await.unwrap_err();
    assert!(matches!(error, DriverError::Silent { .. }), "{error}");
}

#[tokio::test(start_paused = true)]
async fn two_bursts_keep_the_shortest_interval_between_injections() {
    let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
    tokio::spawn(async move { while receiver.recv().await.is_some() {} });
    let short = ShotProgram { cycles: 1, wait_periods: 0, ..program() };
    unit.program(&short).await.unwrap();
    unit.start().await.unwrap();
    sleep(Duration::from_secs(5)).await;
    unit.stop().await.unwrap();
    unit.program(&short).await.unwrap();
    let error = unit.start().await.unwrap_err();
    assert!(matches!(error, DriverError::Limit { .. }), "{error}");
    sleep(Duration::from_secs(10)).await;
    unit.start().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn what_was_not_taken_is_refused() {
    let odd = ShotProgram { period_ns: 20_000_003, ..program() };
    let (mut unit, _pulses) = driven(DRIVER, PulserBehaviour::delivered());
    let error = unit.program(&odd).await.unwrap_err();
    assert!(error.to_string().contains("told 0.020000003, holds 0.020000000"), "{error}");

    for fault in [
        TriggerFault::Ignores { command: ":PULSE2:WCO".to_owned() },
        TriggerFault::Refuses { command: ":PULSE0:MODE BURS".to_owned(), error: UnitError::Unavailable },
    ] {
        let (mut unit, _pulses) = driven(DRIVER, with(fault));
        let error = unit.program(&program()).await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    }
    let (mut unit, _pulses) =
        driven(DRIVER, with(TriggerFault::Ignores { command: ":PULSE0:STATE 1".to_owned() }));
    unit.program(&program()).await.unwrap();
    let error = unit.start().await.unwrap_err();
    assert!(matches!(error, DriverError::Refused { .. }), "{error}");
}

#[tokio::test(start_paused = true)]
async fn the_clock_is_stopped_even_if_the_injector_is_not() {
    let fault =
        TriggerFault::Refuses { command: ":PULSE2:STATE 0".to_owned(), error: UnitError::Unavailable };
    let (mut near, _receiver) = served(DRIVER, with(fault));
    assert_eq!(heard(&mut near, ":PULSE0:STATE 1\r\n").await, "ok\r\n");
    let mut unit = Quantum9520::new(Wire::over(near, "trigger unit"), limits());
    let error = unit.make_safe().await.unwrap_err();
    assert!(matches!(error, DriverError::Refused { .. }), "{error}");
    assert!(!unit.running().await.unwrap());
}

#[tokio::test(start_paused = true)]
async fn lost_pulses_are_lost_and_the_others_keep_their_times() {
    let program = program();
    let (mut unit, receiver) = driven(DRIVER, with(TriggerFault::DropsCameraPulse { pulse: 8 }));
    let pulses = run(unit.as_mut(), receiver, &program).await.unwrap();
    let mut expected = meant(&program);
    expected.remove(8);
    assert_eq!(made(&pulses, &program), expected);

    let (mut unit, mut receiver) = driven(DRIVER, with(TriggerFault::DropsAllPulses { from_s: 0.0 }));
    unit.program(&program).await.unwrap();
    unit.start().await.unwrap();
    assert!(unit.running().await.unwrap());
    assert!(all(&mut receiver).await.is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_mute_unit_that_runs_for_ever_still_answers() {
    let (mut near, mut receiver) = served(DRIVER, with(TriggerFault::DropsAllPulses { from_s: 2.0 }));
    for said in [":PULSE0:PER 1\r\n", ":PULSE1:STATE 1\r\n", ":PULSE0:STATE 1\r\n"] {
        assert_eq!(heard(&mut near, said).await, "ok\r\n");
    }
    assert_eq!(all(&mut receiver).await.len(), 2);
    for _ in 0..100 {
        assert_eq!(heard(&mut near, ":PULSE1:WIDT 0.001\r\n").await, "ok\r\n");
    }
    assert_eq!(heard(&mut near, ":SYST:STAT?\r\n").await, "1\r\n");
}

/// A spray whose camera trigger is lost is still a spray: the injector has fired.
#[tokio::test(start_paused = true)]
async fn a_lost_camera_pulse_does_not_stop_the_injector() {
    let program = ShotProgram { cycles: 1, ..program() };
    let (mut unit, mut receiver) = driven(DRIVER, with(TriggerFault::DropsCameraPulse { pulse: 6 }));
    unit.program(&program).await.unwrap();
    unit.start().await.unwrap();
    let pulses = all(&mut receiver).await;
    assert_eq!(pulses.len(), 7);
    assert!(pulses[6].camera.is_none() && pulses[6].injector.is_some());
}

#[tokio::test(start_paused = true)]
async fn a_full_channel_delays_pulses_but_no_answers() {
    let program = program();
    let (near, far) = duplex(256);
    let (sender, mut receiver) = mpsc::channel(1);
    tokio::spawn(pulser::serve(
        pulser::model(DRIVER).unwrap(),
        far,
        sender,
        PulserBehaviour::delivered(),
        Instant::now(),
    ));
    let mut unit = Quantum9520::new(Wire::over(near, "trigger unit"), limits());
    unit.program(&program).await.unwrap();
    unit.start().await.unwrap();
    sleep(Duration::from_secs(40)).await;
    assert!(unit.running().await.unwrap());
    unit.stop().await.unwrap();
    let pulses = all(&mut receiver).await;
    // All pulses that were due before the stop, and none after it.
    assert_eq!(made(&pulses, &program), meant(&program)[..21]);
}

#[tokio::test(start_paused = true)]
async fn a_burst_goes_on_when_the_line_has_gone() {
    let program = program();
    let (mut unit, mut receiver) = driven(DRIVER, PulserBehaviour::delivered());
    unit.program(&program).await.unwrap();
    unit.start().await.unwrap();
    drop(unit);
    let mut pulses = Vec::new();
    while let Some(pulse) = receiver.recv().await {
        pulses.push(pulse);
    }
    assert_eq!(made(&pulses, &program), meant(&program));
}

#[tokio::test(start_paused = true)]
async fn a_booting_unit_is_waited_for_and_not_locked_up() {
    let behaviour = PulserBehaviour { boot_s: 3.0, echo: true, ..PulserBehaviour::delivered() };
    let (mut unit, _pulses) = driven(DRIVER, behaviour.clone());
    assert_eq!(unit.identify().await.unwrap().model, "9528");
    // A star while booting locks it up for ever.
    let (mut near, _pulses) = served(DRIVER, behaviour);
    assert_eq!(heard(&mut near, "*IDN?\r\n").await, "");
    sleep(Duration::from_secs(10)).await;
    assert_eq!(heard(&mut near, ":SYST:STAT?\r\n").await, "");
}

#[tokio::test(start_paused = true)]
async fn faults_of_the_line_do_not_change_the_program() {
    assert_bad_answers_change_nothing(DRIVER, made).await;
}

#[tokio::test(start_paused = true)]
async fn a_dead_unit_is_silent_and_a_pulled_line_is_lost() {
    assert_a_dead_unit_is_told(DRIVER).await;
}
