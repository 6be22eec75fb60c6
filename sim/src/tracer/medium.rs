//! The medium as the tracer sees it: constant coefficients per cell, per spectral group.
//!
//! Knows nothing of droplets, vapour or fuels; those are turned into coefficients in `scene::optics`.

use crate::light::phase::PhaseFunction;

/// Marks an empty cell in [`GridMedium::index`].
pub const EMPTY: u32 = u32::MAX;

/// A box of equal cells, constant inside each cell; empty cells cost four bytes.
///
/// All coefficients are in 1/m. Group `g` of `groups` is one wavelength sample; channel `c` of `channels` is one
/// set of sources. The emission coefficient of a channel is Σ_species k_abs · S with S the source of that channel:
/// channel 0 has S = 1 for everything, so that its image is the coefficient a_medium and the walls follow by
/// closure (1 − a_plate − a_medium); further channels hold radiances B(λ_g, T_cell), or zones.
#[derive(Debug, Clone)]
pub struct GridMedium {
    /// Lower corner in metres.
    pub lower_m: [f64; 3],
    /// Upper corner in metres.
    pub upper_m: [f64; 3],
    /// Number of cells along x, y, z.
    pub cells: [usize; 3],
    /// Number of spectral groups, at least 1.
    pub groups: usize,
    /// Number of emission channels, at least 1.
    pub channels: usize,
    /// Ordinal of the coefficients of cell `(x · ny + y) · nz + z`, or [`EMPTY`].
    pub index: Vec<u32>,
    /// Extinction, `[ordinal][group]`.
    pub k_ext: Vec<f64>,
    /// Scattering, `[ordinal][group]`; at most the extinction.
    pub k_sca: Vec<f64>,
    /// Emission coefficients (k_abs · source), `[ordinal][channel][group]`.
    pub emission: Vec<f64>,
    /// Phase function of each group, for the whole medium.
    pub phase: Vec<PhaseFunction>,
}
