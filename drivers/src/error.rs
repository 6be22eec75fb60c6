//! What can go wrong between the daemon and an instrument.
//!
//! Every message has four parts: who, doing what, why, what to try. The variant tells the orchestrator what
//! kind of answer the trouble needs; the text is for a tired person.

use std::time::Duration;

/// Trouble with an instrument or its wire.
#[derive(Debug, Clone, thiserror::Error)]
pub enum DriverError {
    /// The wire could not be opened: the device is missing, busy, or not permitted.
    #[error("{who}: opening the line: {why}. {hint}")]
    Missing {
        /// Instrument and address.
        who: String,
        /// What the system said.
        why: String,
        /// What to try.
        hint: String,
    },
    /// No answer, or no frame, within the deadline.
    #[error("{who}: {doing}: no answer in {} s ({tries} tries). {hint}", .waited.as_secs_f64())]
    Silent {
        /// Instrument and address.
        who: String,
        /// The act that was waiting.
        doing: String,
        /// The deadline of one try.
        waited: Duration,
        /// Number of tries.
        tries: u32,
        /// What to try.
        hint: String,
    },
    /// An answer that does not fit the question.
    #[error("{who}: {doing}: unexpected answer {answer:?}: {why}. {hint}")]
    Garbled {
        /// Instrument and address.
        who: String,
        /// The act.
        doing: String,
        /// The bytes received, lossily as text.
        answer: String,
        /// What was expected.
        why: String,
        /// What to try.
        hint: String,
    },
    /// The instrument refused, or took something else than what it was told.
    #[error("{who}: {doing}: refused: {why}. {hint}")]
    Refused {
        /// Instrument and address.
        who: String,
        /// The act.
        doing: String,
        /// The instrument's own words, or told against taken.
        why: String,
        /// What to try.
        hint: String,
    },
    /// A limit of the instrument or of the configuration would be broken; nothing was sent.
    #[error("{who}: {doing}: limit: {why}. {hint}")]
    Limit {
        /// Instrument and address.
        who: String,
        /// The act.
        doing: String,
        /// The limit and the value.
        why: String,
        /// What to try.
        hint: String,
    },
    /// The instrument reports that its own protection has acted (a tripped cutout).
    #[error("{who}: {doing}: interlock: {why}. {hint}")]
    Interlock {
        /// Instrument and address.
        who: String,
        /// The act.
        doing: String,
        /// What has tripped.
        why: String,
        /// What to try.
        hint: String,
    },
    /// The line had ended and has been opened again. What the instrument holds is not known, and what was being done was
    /// not repeated.
    #[error(
        "{who}: {doing}: the line was gone ({why}) and has been opened again; what the instrument holds is not known. \
         Check plugs and power: it may go again."
    )]
    Reopened {
        /// Instrument and address.
        who: String,
        /// The act.
        doing: String,
        /// What the system said when it went.
        why: String,
    },
    /// The line has ended: unplugged, or the other side has gone.
    #[error("{who}: {doing}: the line is gone: {why}. {hint}")]
    Lost {
        /// Instrument and address.
        who: String,
        /// The act.
        doing: String,
        /// What the system said.
        why: String,
        /// What to try.
        hint: String,
    },
}

/// The variants of four parts, as their messages read: who, doing what, why, what to try.
impl DriverError {
    /// See [`DriverError::Refused`].
    pub fn refused(
        who: impl Into<String>,
        doing: impl Into<String>,
        why: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Refused { who: who.into(), doing: doing.into(), why: why.into(), hint: hint.into() }
    }

    /// See [`DriverError::Limit`].
    pub fn limit(
        who: impl Into<String>,
        doing: impl Into<String>,
        why: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Limit { who: who.into(), doing: doing.into(), why: why.into(), hint: hint.into() }
    }

    /// See [`DriverError::Interlock`].
    pub fn interlock(
        who: impl Into<String>,
        doing: impl Into<String>,
        why: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Interlock { who: who.into(), doing: doing.into(), why: why.into(), hint: hint.into() }
    }

    /// See [`DriverError::Lost`].
    pub fn lost(
        who: impl Into<String>,
        doing: impl Into<String>,
        why: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Lost { who: who.into(), doing: doing.into(), why: why.into(), hint: hint.into() }
    }
}

impl DriverError {
    /// True for trouble that the process's exit status 3 (device missing) stands for.
    pub fn is_missing_device(&self) -> bool {
        matches!(self, Self::Missing { .. } | Self::Lost { .. } | Self::Silent { .. } | Self::Reopened { .. })
    }

    /// True when the line was lost and is there again, so that the instrument can be told what it must hold.
    pub fn is_reopened(&self) -> bool {
        matches!(self, Self::Reopened { .. })
    }

    /// True for trouble that exit status 4 (interlock or limit) stands for.
    pub fn is_interlock_or_limit(&self) -> bool {
        matches!(self, Self::Limit { .. } | Self::Interlock { .. })
    }
}
