//! The answer of the ray tracer: coefficient images that serve every plate and wall temperature.

/// Coefficient images of one scene, stored once and re-lit often.
///
/// For a pixel that meets the medium the radiance of group `g` is
/// `a_plate · L_plate + (1 − a_plate − a_medium) · L_walls + emission[channel]`, with the channel that holds the
/// radiances of the wanted medium temperatures and `a_medium` = emission of channel 0 (source 1).
/// All arrays are row-major with row 0 at the top; coefficients are dimensionless, channel images of radiance
/// sources are in the unit of their source.
#[derive(Debug, Clone, Default)]
pub struct Operator {
    /// Rows of the image.
    pub rows: usize,
    /// Columns of the image.
    pub columns: usize,
    /// Number of spectral groups.
    pub groups: usize,
    /// Number of emission channels.
    pub channels: usize,
    /// Fraction of each pixel's area that sees the plate when the medium is absent, `[row · columns + column]`.
    pub plate_seen: Vec<f32>,
    /// Linear indices of the pixels that meet the medium, ascending. All others have a_plate = plate_seen, no emission.
    pub pixels: Vec<u32>,
    /// a_plate, `[active pixel][group]`.
    pub a_plate: Vec<f32>,
    /// Emission with in-scattering, `[active pixel][channel][group]`.
    pub emission: Vec<f32>,
    /// Emission along the straight sight only, extinction applied, no in-scattering: `[active pixel][channel][group]`.
    pub direct: Vec<f32>,
    /// Estimated error of a_plate (sampling noise, and what the reconstruction of scattered light bends), `[active
    /// pixel]`, rms over groups and over nearby pixels.
    pub error_plate: Vec<f32>,
    /// The same of a_medium.
    pub error_medium: Vec<f32>,
    /// Where walls are told apart, their shares and that of the place outside, which sum to 1 − a_plate − a_medium:
    /// `[active pixel][end][group]`, the ends as in [`super::chamber::ENDS`]; else empty.
    pub a_ends: Vec<f32>,
    /// What each pixel's area sees of the ends when the medium is absent, sum 1 − plate_seen: `[pixel][end]`, or empty.
    pub ends_seen: Vec<f32>,
    /// Estimated error of the share of the wall that is known least, `[active pixel]`, or empty.
    pub error_ends: Vec<f32>,
    /// What was done and what was skipped.
    pub stats: Vec<(String, f64)>,
}
