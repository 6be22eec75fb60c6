//! The unit's sockets: power, and what the faults leave of its pulses and add to them.

use super::behaviour::{PulserBehaviour, TriggerFault};
use crate::rig::pulse::Pulse;
use std::collections::VecDeque;

/// When the unit has no power, and until when it boots.
pub(super) struct Power {
    failures: VecDeque<(u64, u64)>,
    booted_ns: u64,
}

impl Power {
    pub(super) fn new(behaviour: &PulserBehaviour) -> Self {
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

    pub(super) fn next_failure_ns(&self) -> Option<u64> {
        self.failures.front().map(|(at_ns, _)| *at_ns)
    }

    pub(super) fn fail(&mut self) {
        if let Some((_, booted_ns)) = self.failures.pop_front() {
            self.booted_ns = self.booted_ns.max(booted_ns);
        }
    }

    pub(super) fn is_booting(&self, now_ns: u64) -> bool {
        now_ns < self.booted_ns
    }
}

/// Where a pulse comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    Unit,
    /// The second one of a pulse that came twice.
    Echo,
}

/// The outputs' sockets: what the faults leave of the unit's pulses, and what they add.
pub(super) struct Outputs {
    faults: Vec<TriggerFault>,
    camera_pulses: u64,
    echoes: VecDeque<Pulse>,
}

impl Outputs {
    pub(super) fn new(faults: Vec<TriggerFault>) -> Self {
        Self { faults, camera_pulses: 0, echoes: VecDeque::new() }
    }

    /// The next thing that happens: the unit's pulse or an echo, whichever is first.
    pub(super) fn next(&self, pulse: Option<Pulse>) -> Option<(Pulse, Origin)> {
        let unit = pulse.map(|pulse| (pulse, Origin::Unit));
        let echo = self.echoes.front().map(|pulse| (*pulse, Origin::Echo));
        match (unit, echo) {
            (Some(unit), Some(echo)) if echo.0.at_ns < unit.0.at_ns => Some(echo),
            (unit, echo) => unit.or(echo),
        }
    }

    /// What leaves the sockets of a pulse whose time has come.
    pub(super) fn pass(&mut self, mut pulse: Pulse, origin: Origin) -> Option<Pulse> {
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

    pub(super) fn rest(&mut self) {
        self.echoes.clear();
    }

    pub(super) fn pulled_ns(&self) -> Option<u64> {
        let pulled = self.faults.iter().filter_map(|fault| match fault {
            TriggerFault::LinePulled { at_s } => Some(from_seconds(*at_s)),
            _ => None,
        });
        pulled.min()
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: from 0 to 1e9 s")]
fn from_seconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
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
}
