//! The unit's running clock: which pulses come when, computed from one active pulse to the next.

use crate::rig::pulse::Pulse;

/// How often a mode lets pulses through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    Normal,
    Single,
    Burst(u64),
    DutyCycle { on: u64, off: u64 },
}

/// The output of one channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Output {
    pub(super) on: bool,
    pub(super) mode: Mode,
    pub(super) wait: u64,
    /// Clock pulse from which it counts.
    pub(super) from: u64,
    pub(super) delay_ns: u64,
    pub(super) width_ns: u64,
}

impl Output {
    /// The first clock pulse from `index` on in which it is active.
    pub(super) fn next_active(&self, index: u64) -> Option<u64> {
        let first = self.from + self.wait;
        let index = index.max(first);
        let count = index - first;
        let is_in = match self.mode {
            Mode::Normal => true,
            Mode::Single => count == 0,
            Mode::Burst(burst) => count < burst,
            Mode::DutyCycle { on, off } => {
                let place = count % (on + off);
                let next = if place < on { index } else { index + on + off - place };
                return self.on.then_some(next);
            }
        };
        (self.on && is_in).then_some(index)
    }

    pub(super) fn at(&self, index: u64) -> Option<(u64, u64)> {
        (self.next_active(index) == Some(index)).then_some((self.delay_ns, self.width_ns))
    }

    pub(super) fn fires_once(&self) -> bool {
        matches!(self.mode, Mode::Single | Mode::Burst(_))
    }
}

/// A stretch of clock pulses during which no setting changes.
#[derive(Debug, Clone)]
pub(super) struct Stretch {
    /// Time of the clock pulse `from`.
    pub(super) base_ns: u64,
    pub(super) period_ns: u64,
    /// The clock's own duty cycle: pulses on, pulses off.
    pub(super) on: u64,
    pub(super) off: u64,
    pub(super) from: u64,
    /// One past the last pulse.
    pub(super) end: Option<u64>,
    pub(super) next: u64,
    pub(super) camera: Output,
    pub(super) injector: Output,
}

impl Stretch {
    /// The period in which a pulse comes: off pulses of the clock are skipped.
    pub(super) fn slot(&self, index: u64) -> u64 {
        index / self.on * (self.on + self.off) + index % self.on
    }

    pub(super) fn time_ns(&self, index: u64) -> u64 {
        self.base_ns + (self.slot(index) - self.slot(self.from)) * self.period_ns
    }

    /// The first pulse later than `now_ns`.
    pub(super) fn first_after(&self, now_ns: u64) -> u64 {
        let Some(since_ns) = now_ns.checked_sub(self.base_ns) else { return self.from };
        let slot = self.slot(self.from) + since_ns / self.period_ns + 1;
        let cycle = self.on + self.off;
        slot / cycle * self.on + (slot % cycle).min(self.on)
    }

    pub(super) fn is_over(&self, now_ns: u64) -> bool {
        self.end.is_some_and(|end| now_ns >= self.time_ns(end))
    }

    pub(super) fn next_pulse(&self) -> Option<Pulse> {
        let camera = self.camera.next_active(self.next);
        let injector = self.injector.next_active(self.next);
        let index = camera.into_iter().chain(injector).min()?;
        (self.end.is_none_or(|end| index < end)).then(|| Pulse {
            t0_index: index,
            at_ns: self.time_ns(index),
            camera: self.camera.at(index),
            injector: self.injector.at(index),
        })
    }
}
