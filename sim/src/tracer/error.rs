//! What can be wrong with a scene given to the tracer.

/// Why a scene cannot be traced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TracerError {
    /// The medium's arrays do not fit together.
    #[error("medium: {what} has {found} entries, {expected} expected")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that the cells, groups and channels ask for.
        expected: usize,
    },
    /// A coefficient is negative, infinite or not a number, or scattering exceeds extinction.
    #[error("medium: {what} of entry {entry} is {value}; it must be {condition}")]
    Coefficient {
        /// Which coefficient.
        what: &'static str,
        /// Where in its array.
        entry: usize,
        /// What was found.
        value: f64,
        /// What is legal.
        condition: &'static str,
    },
    /// A length, direction or angle has no meaning.
    #[error("{what} must be {condition}")]
    Geometry {
        /// Which quantity.
        what: &'static str,
        /// What is legal.
        condition: &'static str,
    },
    /// More spectral groups than one operator holds.
    #[error("medium: {groups} spectral groups; an image takes at most {limit}, render in parts")]
    Groups {
        /// Groups given.
        groups: usize,
        /// The limit.
        limit: usize,
    },
}
