//! What the tests of the trigger units share: a unit on an in-memory line, its driver, and the pulses that are meant.

use super::line::LineFault;
use super::pulse::Pulse;
use super::pulser::{self, PulserBehaviour, TriggerFault};
use ditd_drivers::TRIGGER_UNITS;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{ShotKind, ShotProgram, TriggerUnit};
use ditd_drivers::trigger_limits::TriggerLimits;
use ditd_drivers::wire::Wire;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, timeout};

/// A pulse of the camera: its time, and the injector's delay and width when it fires with it.
pub(super) type Made = (u64, Option<(u64, u64)>);

pub(super) fn limits() -> TriggerLimits {
    TriggerLimits {
        injector_pulse_max_s: 0.005,
        injection_interval_min_s: 15.0,
        camera_integration_s: 25e-6,
        camera_readout_s: 0.008,
    }
}

pub(super) fn program() -> ShotProgram {
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

pub(super) fn served(driver: &str, behaviour: PulserBehaviour) -> (DuplexStream, mpsc::Receiver<Pulse>) {
    let (near, far) = duplex(256);
    let (sender, receiver) = mpsc::channel(64);
    tokio::spawn(pulser::serve(pulser::model(driver).unwrap(), far, sender, behaviour, Instant::now()));
    (near, receiver)
}

pub(super) fn driven(
    driver: &str,
    behaviour: PulserBehaviour,
) -> (Box<dyn TriggerUnit>, mpsc::Receiver<Pulse>) {
    let (near, receiver) = served(driver, behaviour);
    let model = TRIGGER_UNITS.iter().find(|model| model.name == driver).unwrap();
    ((model.drive)(Wire::over(near, "trigger unit"), limits()), receiver)
}

pub(super) fn with(fault: TriggerFault) -> PulserBehaviour {
    PulserBehaviour { faults: vec![fault], ..PulserBehaviour::delivered() }
}

/// Begins every cycle of a started burst when it is due, as the campaign does.
pub(super) async fn begin_all(unit: &mut dyn TriggerUnit, program: &ShotProgram) -> Result<(), DriverError> {
    let first = Instant::now() + Duration::from_nanos(program.frame_ns(0, 0));
    let first = unit.begin_cycle(0, first).await?.earliest;
    for cycle in 1..program.cycles {
        unit.begin_cycle(cycle, first + Duration::from_nanos(u64::from(cycle) * program.cycle_ns())).await?;
    }
    Ok(())
}

/// Programs a burst and runs it to its end; the pulses that came.
pub(super) async fn run(
    unit: &mut dyn TriggerUnit,
    mut receiver: mpsc::Receiver<Pulse>,
    program: &ShotProgram,
) -> Result<Vec<Pulse>, DriverError> {
    unit.program(program).await?;
    let collected = tokio::spawn(async move { all(&mut receiver).await });
    unit.start().await?;
    begin_all(unit, program).await?;
    Ok(collected.await.unwrap())
}

/// Bad answers cost time, and change no pulse. `made` is as [`made`] for the unit.
pub(super) async fn assert_bad_answers_change_nothing(
    driver: &str,
    made: fn(&[Pulse], &ShotProgram) -> Vec<Made>,
) {
    for fault in [
        LineFault::Late { every: 9, delay_s: 1.3 },
        LineFault::Garbled { every: 9 },
        LineFault::Missing { every: 9 },
        LineFault::Doubled { every: 9 },
        LineFault::Missing { every: 4 },
    ] {
        let behaviour = PulserBehaviour { line_faults: vec![fault.clone()], ..PulserBehaviour::delivered() };
        let (mut unit, receiver) = driven(driver, behaviour);
        let pulses = run(unit.as_mut(), receiver, &program()).await.unwrap();
        assert_eq!(made(&pulses, &program()), meant(&program()), "{fault:?}");
    }
}

/// A unit that does not answer any more is silent, one whose line was pulled is lost: told, and not waited for.
pub(super) async fn assert_a_dead_unit_is_told(driver: &str) {
    let silent = PulserBehaviour {
        line_faults: vec![LineFault::Silent { from_s: 10.0 }],
        ..PulserBehaviour::delivered()
    };
    for (behaviour, is_lost) in [(silent, false), (with(TriggerFault::LinePulled { at_s: 10.0 }), true)] {
        let (mut unit, _pulses) = driven(driver, behaviour);
        unit.identify().await.unwrap();
        sleep(Duration::from_secs(10)).await;
        let error = unit.make_safe().await.unwrap_err();
        assert_eq!(matches!(error, DriverError::Lost { .. }), is_lost, "{error}");
        assert_eq!(matches!(error, DriverError::Silent { .. }), !is_lost, "{error}");
    }
}

/// Takes pulses until none has come for a whole cycle.
pub(super) async fn all(receiver: &mut mpsc::Receiver<Pulse>) -> Vec<Pulse> {
    let mut pulses = Vec::new();
    while let Ok(Some(pulse)) = timeout(Duration::from_secs(60), receiver.recv()).await {
        pulses.push(pulse);
    }
    pulses
}

/// The pulses that a program means, from the seam's own definitions.
pub(super) fn meant(program: &ShotProgram) -> Vec<Made> {
    let injection = Some((program.injector_delay_ns, program.injector_width_ns));
    (0..program.cycles)
        .flat_map(|cycle| (0..program.frames_per_cycle()).map(move |position| (cycle, position)))
        .map(|(cycle, position)| {
            let is_spray = program.kind_at(position) == Some(ShotKind::Spray);
            (program.frame_ns(cycle, position), injection.filter(|_| is_spray))
        })
        .collect()
}

/// The pulses that came, in the same form, on a unit that makes its pauses by its own clock.
pub(super) fn made(pulses: &[Pulse], program: &ShotProgram) -> Vec<Made> {
    let base_ns = pulses[0].at_ns - program.frame_ns(0, 0);
    pulses
        .iter()
        .map(|pulse| {
            assert_eq!(pulse.camera, Some((program.camera_delay_ns, program.camera_width_ns)));
            assert_eq!(pulse.t0_index * program.period_ns, pulse.at_ns - base_ns);
            (pulse.at_ns - base_ns, pulse.injector)
        })
        .collect()
}

pub(super) async fn heard(near: &mut DuplexStream, said: &str) -> String {
    near.write_all(said.as_bytes()).await.unwrap();
    let mut bytes = [0; 128];
    match timeout(Duration::from_millis(500), near.read(&mut bytes)).await {
        Ok(count) => String::from_utf8_lossy(&bytes[..count.unwrap()]).into_owned(),
        Err(_) => String::new(),
    }
}
