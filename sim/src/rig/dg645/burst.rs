//! Delay cycles: one burst after a trigger, and the prescalers that let an output through.

/// One burst, or one delay cycle when burst mode is off.
#[derive(Debug, Clone, Copy)]
pub(super) struct Burst {
    /// Time of the first delay cycle.
    pub(super) start_ns: u64,
    pub(super) period_ns: u64,
    /// Delay cycles.
    pub(super) count: u64,
    /// Delay cycles that are made.
    pub(super) made: u64,
}

impl Burst {
    /// Time of the next delay cycle; `None` when all are made.
    pub(super) fn next_ns(&self) -> Option<u64> {
        (self.made < self.count).then(|| self.start_ns + self.made * self.period_ns)
    }

    /// When its last delay cycle is over; `cycle_ns` is the length of one.
    pub(super) fn end_ns(&self, cycle_ns: u64) -> u64 {
        self.start_ns + self.count.saturating_sub(1) * self.period_ns + cycle_ns
    }
}

/// A prescaler: lets through when its counter stands at the phase.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prescaler {
    pub(super) factor: u64,
    pub(super) phase: u64,
    counter: u64,
}

impl Prescaler {
    pub(super) fn delivered() -> Self {
        Self { factor: 1, phase: 0, counter: 0 }
    }

    pub(super) fn is_open(&self) -> bool {
        self.counter == self.phase
    }

    pub(super) fn step(&mut self) {
        self.counter = (self.counter + 1) % self.factor;
    }

    pub(super) fn set_factor(&mut self, factor: u64) {
        self.factor = factor;
        self.counter %= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factor_one_leaves_no_state_but_zero() {
        let mut prescaler = Prescaler::delivered();
        prescaler.set_factor(9);
        prescaler.phase = 8;
        for _ in 0..5 {
            assert!(!prescaler.is_open());
            prescaler.step();
        }
        prescaler.set_factor(1);
        prescaler.set_factor(9);
        let open: Vec<u64> = (0..27)
            .filter(|_| {
                let is_open = prescaler.is_open();
                prescaler.step();
                is_open
            })
            .collect();
        assert_eq!(open, [8, 17, 26]);
    }
}
