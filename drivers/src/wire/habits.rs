//! How an instrument behaves on its line; its driver says so.

use std::time::Duration;

/// How an instrument behaves on its line; its driver says so.
#[derive(Debug, Clone, Copy)]
pub struct LineHabits {
    /// What ends a command.
    pub ending: &'static str,
    /// Longest wait for an answer.
    pub deadline: Duration,
    /// Shortest time from the end of an exchange to the next command; the line must be silent meanwhile.
    pub pace: Duration,
    /// A harmless query that is answered recognisably, for finding the thread again.
    pub sign: Option<Sign>,
    /// What a person should try when the instrument does not answer.
    pub hint: &'static str,
}

/// A query and how its answer is recognised.
#[derive(Debug, Clone, Copy)]
pub struct Sign {
    /// The query.
    pub query: &'static str,
    /// True for an answer to it; must be false for answers to all other queries.
    pub fits: fn(&str) -> bool,
}

impl LineHabits {
    /// For a stream about whose instrument nothing is known yet: CR, one second, no pause, no sign.
    pub fn plain() -> Self {
        Self {
            ending: "\r",
            deadline: Duration::from_secs(1),
            pace: Duration::ZERO,
            sign: None,
            hint: "Check power and cable.",
        }
    }
}
