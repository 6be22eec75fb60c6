//! A trigger unit as a task: a unit's answers and pulses between its line and its outputs, and what can go wrong there.
//!
//! What is common to all models. A model ([`Unit`]) knows its commands and its clock; this room sends its pulses in
//! time, and plays faults of outputs, line and power. A clock does not tick through idle pulses: it is asked for the next
//! one with an active output and sleeps until then, so that a pause of a campaign costs nothing. Widths and delays
//! are numbers in a [`Pulse`], never sleeps.

mod behaviour;
mod outputs;

pub(super) use behaviour::Meddling;
pub use behaviour::{PulserBehaviour, TriggerFault};

use super::dg645::DelayGenerator;
use super::line::{Line, Unsent};
use super::pulse::Pulse;
use super::quantum_9520::PulseGenerator;
use outputs::{Origin, Outputs, Power};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc::{self, Permit};
use tokio::time::{Instant, sleep_until};

/// A model of trigger unit: its commands and its clock.
pub(super) trait Unit {
    /// The answer to a line with its line end, at `now_ns` of the rig's clock; `None` when it has none.
    fn answer(&mut self, line: &str, now_ns: u64) -> Option<String>;
    /// A line came while it boots.
    fn hear_while_booting(&mut self, line: &str);
    /// The next pulse with an active output, if nothing more is told.
    fn next_pulse(&mut self) -> Option<Pulse>;
    /// Goes on to the pulse after this one.
    fn note_sent(&mut self, pulse: Pulse);
    /// Its power has failed and come back.
    fn power_cycle(&mut self);
}

/// The simulated units: the driver's name, and how one is switched on.
type SwitchOn = fn(&PulserBehaviour) -> Box<dyn Unit + Send>;

const UNITS: &[(&str, SwitchOn)] = &[
    ("quantum_9520", |behaviour| Box::new(PulseGenerator::new(behaviour.clone()))),
    ("dg645", |behaviour| Box::new(DelayGenerator::new(behaviour.clone()))),
];

/// The unit that the driver of this name talks to, as [`serve`] takes it; `None` for an unknown name.
pub fn model(driver: &str) -> Option<Model> {
    UNITS.iter().find(|(name, _)| *name == driver).map(|(_, switch_on)| Model(*switch_on))
}

/// A model of simulated unit.
#[derive(Debug, Clone, Copy)]
pub struct Model(SwitchOn);

/// Answers on a stream and sends the pulses of a running clock. `start` is the zero of the rig's clock.
///
/// When `pulses` is full the clock's next pulse waits, with its time unchanged, and commands are answered all the
/// same. When the other side of the stream has gone, a running burst goes on to its end, as a real one does. Ends when
/// both have ended.
///
/// # Panics
/// When the behaviour fails its check.
pub async fn serve(
    model: Model,
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    pulses: mpsc::Sender<Pulse>,
    behaviour: PulserBehaviour,
    start: Instant,
) {
    assert_eq!(behaviour.check(), Ok(()), "the behaviour was checked where it was read");
    let command_time = Duration::from_secs_f64(behaviour.command_s);
    // Commands sent too fast "may cause the unit to not respond properly" (9520): the earlier answer is lost.
    let mut line = Some(Line::new(stream, behaviour.line_faults.clone(), Unsent::Lost, start));
    let mut unit = (model.0)(&behaviour);
    let mut power = Power::new(&behaviour);
    let mut outputs = Outputs::new(behaviour.faults);
    loop {
        let next = outputs.next(unit.next_pulse()).filter(|_| !pulses.is_closed());
        if line.is_none() && next.is_none() {
            return;
        }
        let due = next.map_or(start, |(pulse, _)| start + Duration::from_nanos(pulse.at_ns));
        let failure = power.next_failure_ns().map(|ns| start + Duration::from_nanos(ns));
        let pull = outputs.pulled_ns().filter(|_| line.is_some()).map(|ns| start + Duration::from_nanos(ns));
        tokio::select! {
            biased;
            () = sleep_until(failure.unwrap_or(start)), if failure.is_some() => {
                power.fail();
                outputs.rest();
                unit.power_cycle();
            }
            () = sleep_until(pull.unwrap_or(start)), if pull.is_some() => line = None,
            command = next_command(&mut line), if line.is_some() => match (command, &mut line) {
                (Some(command), Some(line)) => {
                    let now_ns = nanoseconds(start.elapsed());
                    let command = command.as_deref().unwrap_or("garbage");
                    if power.is_booting(now_ns) {
                        unit.hear_while_booting(command);
                    } else if let Some(answer) = unit.answer(command, now_ns) {
                        line.reply(&answer, command_time);
                    }
                }
                _ => line = None,
            },
            permit = permit_at(due, &pulses), if next.is_some() => {
                if let (Some(permit), Some((pulse, origin))) = (permit, next) {
                    if origin == Origin::Unit {
                        unit.note_sent(pulse);
                    }
                    if let Some(pulse) = outputs.pass(pulse, origin) {
                        permit.send(pulse);
                    }
                }
            }
        }
    }
}

async fn next_command<S: AsyncRead + AsyncWrite>(
    line: &mut Option<Line<S>>,
) -> Option<Result<String, ditd_drivers::wire::Garbage>> {
    match line {
        Some(line) => line.next_command().await,
        None => None,
    }
}

/// A place in the channel once the time has come; `None` when nobody takes pulses any more.
async fn permit_at(due: Instant, pulses: &mpsc::Sender<Pulse>) -> Option<Permit<'_, Pulse>> {
    sleep_until(due).await;
    pulses.reserve().await.ok()
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).expect("a rig runs for less than 584 years")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_driver_has_its_simulated_unit() {
        for unit in ditd_drivers::TRIGGER_UNITS {
            assert!(model(unit.name).is_some(), "{}", unit.name);
        }
        assert!(model("pulser").is_none());
    }
}
