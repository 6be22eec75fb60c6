//! Why a cycle was not accepted.

/// Why a cycle was not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccumulateError {
    /// a cycle has {given} blanks where {expected} are expected. Check `blanks` of the campaign.
    #[error("a cycle has {given} blanks where {expected} are expected. Check `blanks` of the campaign.")]
    Blanks {
        /// Blanks handed in.
        given: usize,
        /// Blanks per cycle of these sums.
        expected: usize,
    },
    /// a frame has {given} pixels where {expected} are expected. Check the camera's region of interest.
    #[error(
        "a frame has {given} pixels where {expected} are expected. Check the camera's region of interest."
    )]
    Pixels {
        /// Pixels handed in.
        given: usize,
        /// rows · columns of these sums.
        expected: usize,
    },
    /// level {level} does not exist: there are {levels}.
    #[error("level {level} does not exist: there are {levels}.")]
    Level {
        /// Level asked for, from 0.
        level: usize,
        /// Number of levels.
        levels: usize,
    },
    /// level {level} holds {cycles} cycles, more would overflow the sums of squares. Use fewer blanks per cycle.
    #[error(
        "level {level} holds {cycles} cycles, more would overflow the sums of squares. Use fewer blanks per cycle."
    )]
    Full {
        /// Level, from 0.
        level: usize,
        /// Cycles it holds.
        cycles: u32,
    },
    /// level {level} holds no cycle that could be taken out.
    #[error("level {level} holds no cycle that could be taken out.")]
    Empty {
        /// Level, from 0.
        level: usize,
    },
    /// sums of different shape, number of blanks or saturation count cannot be merged.
    #[error("sums of different shape, number of blanks or saturation count cannot be merged.")]
    Unlike,
    /// {blanks} blanks per cycle: 1 to 256 are possible.
    #[error("{blanks} blanks per cycle: 1 to 256 are possible.")]
    BlanksPerCycle {
        /// Blanks per cycle asked for.
        blanks: u16,
    },
}
