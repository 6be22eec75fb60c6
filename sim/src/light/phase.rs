//! Phase functions: isotropic, Henyey–Greenstein, tabulated.

use std::sync::Arc;

/// An angular distribution of scattered light, normalised so that ½∫p dμ = 1.
#[derive(Debug, Clone)]
pub enum PhaseFunction {
    /// The same into all directions.
    Isotropic,
    /// Henyey and Greenstein (1941) with mean cosine `asymmetry` in [−1, 1].
    HenyeyGreenstein {
        /// Mean cosine.
        asymmetry: f64,
    },
    /// A table over the scattering angle, linear in the angle between nodes.
    Table(Arc<PhaseTable>),
}

/// A tabulated phase function, normalised at construction, with its cumulative distribution.
#[derive(Debug, Clone)]
pub struct PhaseTable {}
