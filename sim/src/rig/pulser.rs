//! A trigger unit as a task: a unit's answers and pulses between its line and its outputs, and what can go wrong there.
//!
//! What is common to all models. A model ([`Unit`]) knows its commands and its clock; this room sends its pulses in
//! time, and plays faults of outputs, line and power. A clock does not tick through idle pulses: it is asked for the next
//! one with an active output and sleeps until then, so that a pause of a campaign costs nothing. Widths and delays
//! are numbers in a [`Pulse`], never sleeps.

use super::dg645::DelayGenerator;
use super::line::{Line, LineFault, Unsent, check_seconds};
use super::pulse::Pulse;
use super::quantum_9520::PulseGenerator;
use ditd_drivers::quantum_9520::UnitError;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc::{self, Permit};
use tokio::time::{Instant, sleep_until};

/// What a trigger unit does wrong, besides its line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum TriggerFault {
    /// One trigger of the camera is missing.
    DropsCameraPulse {
        /// Which, counted from 0 over the unit's whole life.
        pulse: u64,
    },
    /// One trigger of the camera comes twice: a contact that bounces, a neighbour that couples in.
    DoublesCameraPulse {
        /// Which, counted from 0 over the unit's whole life.
        pulse: u64,
        /// How much later the second one comes, in seconds.
        after_s: f64,
    },
    /// The unit says that it runs, and nothing leaves its outputs.
    DropsAllPulses {
        /// Since when, in seconds of the rig's clock.
        from_s: f64,
    },
    /// A command is answered by an error (a 9520), or puts one into the error queue (a DG645: illegal value).
    Refuses {
        /// Start of the command in the manual's spelling, such as `:PULSE2:STATE 1` or `BURC`.
        command: String,
        /// The answer of a 9520.
        #[serde(default = "unavailable")]
        error: UnitError,
    },
    /// A command that sets something is taken without complaint and not obeyed.
    Ignores {
        /// Start of the command in the manual's spelling.
        command: String,
    },
    /// Its power fails: outputs at rest, settings as delivered, no answer until it has booted again.
    Reboots {
        /// When, in seconds of the rig's clock.
        at_s: f64,
        /// How long it boots, in seconds.
        boot_s: f64,
    },
    /// Its line is pulled for good; what it was told last it goes on with.
    LinePulled {
        /// When, in seconds of the rig's clock.
        at_s: f64,
    },
}

fn unavailable() -> UnitError {
    UnitError::Unavailable
}

impl TriggerFault {
    fn check(&self) -> Result<(), String> {
        match self {
            Self::DropsAllPulses { from_s } => check_seconds("from_s", *from_s),
            Self::DoublesCameraPulse { after_s, .. } => check_seconds("after_s", *after_s),
            Self::Reboots { at_s, boot_s } => {
                check_seconds("at_s", *at_s).and_then(|()| check_seconds("boot_s", *boot_s))
            }
            Self::LinePulled { at_s } => check_seconds("at_s", *at_s),
            Self::DropsCameraPulse { .. } | Self::Refuses { .. } | Self::Ignores { .. } => Ok(()),
        }
    }
}

/// What a trigger unit is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PulserBehaviour {
    /// Time of one command, in seconds.
    #[serde(default = "PulserBehaviour::command_s")]
    pub command_s: f64,
    /// Time from the start of the rig's clock until the unit has booted, in seconds.
    #[serde(default)]
    pub boot_s: f64,
    /// It was left with its echo on (a 9520).
    #[serde(default)]
    pub echo: bool,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub line_faults: Vec<LineFault>,
    /// What else goes wrong; nothing when absent.
    #[serde(default)]
    pub faults: Vec<TriggerFault>,
}

impl PulserBehaviour {
    /// A unit as delivered, booted.
    pub fn delivered() -> Self {
        Self {
            command_s: Self::command_s(),
            boot_s: 0.0,
            echo: false,
            line_faults: Vec::new(),
            faults: Vec::new(),
        }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_seconds("command_s", self.command_s)?;
        check_seconds("boot_s", self.boot_s)?;
        self.line_faults.iter().try_for_each(LineFault::check)?;
        self.faults.iter().try_for_each(TriggerFault::check)
    }

    /// 9520 manual, chapter 7: about 10 ms a command; the same is assumed of a DG645.
    fn command_s() -> f64 {
        0.010
    }

    /// What the faults do to a command, given in the manual's spelling.
    pub(super) fn meddling(&self, spelled: &str, is_set: bool) -> Option<Meddling> {
        let starts = |prefix: &String| {
            spelled.get(..prefix.len()).is_some_and(|start| start.eq_ignore_ascii_case(prefix))
        };
        self.faults.iter().find_map(|fault| match fault {
            TriggerFault::Refuses { command, error } if starts(command) => Some(Meddling::Refused(*error)),
            TriggerFault::Ignores { command } if is_set && starts(command) => Some(Meddling::Ignored),
            _ => None,
        })
    }
}

/// What a fault does to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Meddling {
    Refused(UnitError),
    Ignored,
}

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

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: from 0 to 1e9 s")]
fn from_seconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// When the unit has no power, and until when it boots.
struct Power {
    failures: VecDeque<(u64, u64)>,
    booted_ns: u64,
}

impl Power {
    fn new(behaviour: &PulserBehaviour) -> Self {
        let mut failures: Vec<(u64, u64)> = behaviour
            .faults
            .iter()
            .filter_map(|fault| match fault {
                TriggerFault::Reboots { at_s, boot_s } => {
                    Some((from_seconds(*at_s), from_seconds(at_s + boot_s)))
                }
                _ => None,
            })
            .collect();
        failures.sort_unstable();
        Self { failures: failures.into(), booted_ns: from_seconds(behaviour.boot_s) }
    }

    fn next_failure_ns(&self) -> Option<u64> {
        self.failures.front().map(|(at_ns, _)| *at_ns)
    }

    fn fail(&mut self) {
        if let Some((_, booted_ns)) = self.failures.pop_front() {
            self.booted_ns = self.booted_ns.max(booted_ns);
        }
    }

    fn is_booting(&self, now_ns: u64) -> bool {
        now_ns < self.booted_ns
    }
}

/// Where a pulse comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Origin {
    Unit,
    /// The second one of a pulse that came twice.
    Echo,
}

/// The outputs' sockets: what the faults leave of the unit's pulses, and what they add.
struct Outputs {
    faults: Vec<TriggerFault>,
    camera_pulses: u64,
    echoes: VecDeque<Pulse>,
}

impl Outputs {
    fn new(faults: Vec<TriggerFault>) -> Self {
        Self { faults, camera_pulses: 0, echoes: VecDeque::new() }
    }

    /// The next thing that happens: the unit's pulse or an echo, whichever is first.
    fn next(&self, pulse: Option<Pulse>) -> Option<(Pulse, Origin)> {
        let unit = pulse.map(|pulse| (pulse, Origin::Unit));
        let echo = self.echoes.front().map(|pulse| (*pulse, Origin::Echo));
        match (unit, echo) {
            (Some(unit), Some(echo)) if echo.0.at_ns < unit.0.at_ns => Some(echo),
            (unit, echo) => unit.or(echo),
        }
    }

    /// What leaves the sockets of a pulse whose time has come.
    fn pass(&mut self, mut pulse: Pulse, origin: Origin) -> Option<Pulse> {
        if origin == Origin::Echo {
            self.echoes.pop_front();
        } else if pulse.camera.is_some() {
            // Counted by the unit's output, whether or not a fault takes the pulse away.
            let ordinal = self.camera_pulses;
            self.camera_pulses += 1;
            for fault in &self.faults {
                match fault {
                    TriggerFault::DropsCameraPulse { pulse: dropped } if *dropped == ordinal => {
                        pulse.camera = None
                    }
                    TriggerFault::DoublesCameraPulse { pulse: doubled, after_s } if *doubled == ordinal => {
                        let at_ns = pulse.at_ns + from_seconds(*after_s);
                        let echo = Pulse { at_ns, injector: None, ..pulse };
                        let place = self.echoes.partition_point(|other| other.at_ns <= at_ns);
                        self.echoes.insert(place, echo);
                    }
                    _ => {}
                }
            }
        }
        let is_mute = self.faults.iter().any(|fault| {
            matches!(fault, TriggerFault::DropsAllPulses { from_s } if from_seconds(*from_s) <= pulse.at_ns)
        });
        let is_there = pulse.camera.is_some() || pulse.injector.is_some();
        (is_there && !is_mute).then_some(pulse)
    }

    fn rest(&mut self) {
        self.echoes.clear();
    }

    fn pulled_ns(&self) -> Option<u64> {
        let pulled = self.faults.iter().filter_map(|fault| match fault {
            TriggerFault::LinePulled { at_s } => Some(from_seconds(*at_s)),
            _ => None,
        });
        pulled.min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulse(index: u64, injector: bool) -> Pulse {
        Pulse {
            t0_index: index,
            at_ns: index * 20_000_000,
            camera: Some((0, 25_000)),
            injector: injector.then_some((0, 1_000_000)),
        }
    }

    /// The injector of a pulse whose camera trigger is lost fires all the same, and an echo never injects.
    #[test]
    fn faults_of_the_outputs_touch_the_camera_only() {
        let faults = vec![
            TriggerFault::DropsCameraPulse { pulse: 1 },
            TriggerFault::DoublesCameraPulse { pulse: 2, after_s: 0.005 },
        ];
        let mut outputs = Outputs::new(faults);
        let passed: Vec<_> =
            [pulse(0, false), pulse(1, true), pulse(2, true)].map(|p| outputs.pass(p, Origin::Unit)).into();
        assert_eq!(passed[0], Some(pulse(0, false)));
        assert_eq!(passed[1], Some(Pulse { camera: None, ..pulse(1, true) }));
        assert_eq!(passed[2], Some(pulse(2, true)));
        let (echo, origin) = outputs.next(Some(pulse(3, false))).unwrap();
        assert_eq!((echo.at_ns, echo.injector, origin), (45_000_000, None, Origin::Echo));
        assert_eq!(outputs.pass(echo, origin), Some(echo));
        assert_eq!(outputs.next(Some(pulse(3, false))), Some((pulse(3, false), Origin::Unit)));
    }

    #[test]
    fn a_behaviour_is_read_from_a_file_and_unknown_keys_are_refused() {
        let text = "boot_s = 2.0\n[[faults]]\nkind = \"drops-camera-pulse\"\npulse = 3\n\
                    [[faults]]\nkind = \"refuses\"\ncommand = \":PULSE0:STATE\"\nerror = \"unavailable\"\n\
                    [[faults]]\nkind = \"refuses\"\ncommand = \"BURC\"\n\
                    [[faults]]\nkind = \"reboots\"\nat_s = 1.0\nboot_s = 3.0\n\
                    [[line_faults]]\nkind = \"silent\"\nfrom_s = 9.0\n";
        let behaviour: PulserBehaviour = toml::from_str(text).unwrap();
        assert_eq!(behaviour.faults.len(), 4);
        assert_eq!(behaviour.line_faults, [LineFault::Silent { from_s: 9.0 }]);
        assert_eq!(toml::from_str::<PulserBehaviour>("").unwrap(), PulserBehaviour::delivered());
        assert!(toml::from_str::<PulserBehaviour>("colour = 1\n").is_err());
        for (text, key) in [
            ("boot_s = nan\n", "boot_s"),
            ("[[faults]]\nkind = \"line-pulled\"\nat_s = -1.0\n", "at_s"),
            ("[[faults]]\nkind = \"doubles-camera-pulse\"\npulse = 1\nafter_s = inf\n", "after_s"),
        ] {
            let impossible: PulserBehaviour = toml::from_str(text).unwrap();
            assert!(impossible.check().unwrap_err().starts_with(key), "{text}");
        }
    }

    #[test]
    fn every_driver_has_its_simulated_unit() {
        for unit in ditd_drivers::TRIGGER_UNITS {
            assert!(model(unit.name).is_some(), "{}", unit.name);
        }
        assert!(model("pulser").is_none());
    }
}
