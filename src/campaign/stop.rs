//! The operator's wish to stop, as a value that is read between steps.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// What the operator wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wish {
    /// Go on.
    GoOn,
    /// Pause after this cycle (first Ctrl-C).
    Pause,
    /// Stop now, safely (second Ctrl-C, SIGTERM, SIGHUP).
    Stop,
}

/// A wish that threads share.
#[derive(Debug, Clone, Default)]
pub struct StopFlag(Arc<AtomicU8>);

impl StopFlag {
    /// Another Ctrl-C: go on → pause → stop.
    pub fn escalate(&self) {
        // The closure never returns None, so the update cannot fail.
        let _ = self.0.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |value| Some((value + 1).min(2)));
    }

    /// Stop now.
    pub fn stop(&self) {
        self.0.store(2, Ordering::SeqCst);
    }

    /// The present wish.
    pub fn wish(&self) -> Wish {
        match self.0.load(Ordering::SeqCst) {
            0 => Wish::GoOn,
            1 => Wish::Pause,
            _ => Wish::Stop,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_ctrl_c_pauses_and_the_second_stops() {
        let flag = StopFlag::default();
        assert_eq!(flag.wish(), Wish::GoOn);
        flag.escalate();
        assert_eq!(flag.wish(), Wish::Pause);
        flag.escalate();
        flag.escalate();
        assert_eq!(flag.wish(), Wish::Stop);
    }
}
