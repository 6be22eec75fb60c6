//! What reaches the simulated camera and injector from the trigger unit's outputs.

/// One T0 pulse of the trigger unit with the outputs that are on in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// Ordinal of the T0 pulse since the unit was started.
    pub t0_index: u64,
    /// Time of T0 in nanoseconds since the rig's start.
    pub at_ns: u64,
    /// Camera output: delay after T0 and width, in nanoseconds; `None` when it stays at rest.
    pub camera: Option<(u64, u64)>,
    /// Injector output: delay after T0 and width, in nanoseconds; `None` when it stays at rest.
    pub injector: Option<(u64, u64)>,
}
