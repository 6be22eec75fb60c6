//! The answer of the ray tracer: coefficient images that serve every plate and wall temperature.

use super::chamber::ENDS;

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

impl Operator {
    /// The same image with an entry for each of `pixels` (linear indices, ascending, those of the operator among them):
    /// whatever the operator does not hold meets no medium.
    #[must_use]
    pub fn with_pixels(self, pixels: &[u32]) -> Self {
        if self.pixels == pixels {
            return self;
        }
        let (groups, ends) = (self.groups, if self.ends_seen.is_empty() { 0 } else { ENDS });
        let mut wide = Self {
            pixels: pixels.to_vec(),
            a_plate: Vec::with_capacity(pixels.len() * groups),
            emission: Vec::with_capacity(pixels.len() * groups * self.channels),
            direct: Vec::with_capacity(pixels.len() * groups * self.channels),
            error_plate: Vec::with_capacity(pixels.len()),
            error_medium: Vec::with_capacity(pixels.len()),
            a_ends: Vec::with_capacity(pixels.len() * groups * ends),
            error_ends: Vec::with_capacity(if ends > 0 { pixels.len() } else { 0 }),
            ..Self::default()
        };
        let mut next = 0;
        for &pixel in pixels {
            let held = self.pixels.get(next) == Some(&pixel);
            let copy = |to: &mut Vec<f32>, from: &[f32], each: usize| match from
                .get(next * each..(next + 1) * each)
            {
                Some(values) if held => to.extend_from_slice(values),
                _ => to.resize(to.len() + each, 0.0),
            };
            copy(&mut wide.emission, &self.emission, groups * self.channels);
            copy(&mut wide.direct, &self.direct, groups * self.channels);
            copy(&mut wide.error_plate, &self.error_plate, 1);
            copy(&mut wide.error_medium, &self.error_medium, 1);
            if held {
                copy(&mut wide.a_plate, &self.a_plate, groups);
            } else {
                let seen = self.plate_seen.get(pixel as usize).copied().unwrap_or(0.0);
                wide.a_plate.resize(wide.a_plate.len() + groups, seen);
            }
            if ends > 0 {
                copy(&mut wide.error_ends, &self.error_ends, 1);
                if held {
                    copy(&mut wide.a_ends, &self.a_ends, groups * ends);
                } else {
                    let from = pixel as usize * ends;
                    for &seen in self.ends_seen.get(from..from + ends).unwrap_or(&[0.0; ENDS]) {
                        wide.a_ends.resize(wide.a_ends.len() + groups, seen);
                    }
                }
            }
            next += usize::from(held);
        }
        Self {
            rows: self.rows,
            columns: self.columns,
            groups,
            channels: self.channels,
            plate_seen: self.plate_seen,
            ends_seen: self.ends_seen,
            stats: self.stats,
            ..wide
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_that_are_added_meet_no_medium() {
        let one = Operator {
            rows: 1,
            columns: 4,
            groups: 2,
            channels: 1,
            plate_seen: vec![1.0, 0.5, 1.0, 0.25],
            pixels: vec![2],
            a_plate: vec![0.7, 0.6],
            emission: vec![0.1, 0.2],
            direct: vec![0.05, 0.06],
            error_plate: vec![1e-3],
            error_medium: vec![2e-3],
            stats: vec![("rays".to_owned(), 3.0)],
            ..Operator::default()
        };
        let wide = one.clone().with_pixels(&[1, 2, 3]);
        assert_eq!(wide.a_plate, [0.5, 0.5, 0.7, 0.6, 0.25, 0.25]);
        assert_eq!(wide.emission, [0.0, 0.0, 0.1, 0.2, 0.0, 0.0]);
        assert_eq!(wide.direct, [0.0, 0.0, 0.05, 0.06, 0.0, 0.0]);
        assert_eq!(wide.error_plate, [0.0, 1e-3, 0.0]);
        assert_eq!(wide.error_medium, [0.0, 2e-3, 0.0]);
        assert!(wide.a_ends.is_empty() && wide.error_ends.is_empty());
        assert_eq!(wide.stats, one.stats);
        assert_eq!(one.clone().with_pixels(&[2]).a_plate, one.a_plate);
    }

    #[test]
    fn added_pixels_see_the_walls_as_they_are() {
        let seen: Vec<f32> = (0..2 * ENDS).map(|i| if i < ENDS { 0.0 } else { 1.0 / 8.0 }).collect();
        let one = Operator {
            rows: 1,
            columns: 2,
            groups: 1,
            channels: 1,
            plate_seen: vec![1.0, 0.0],
            ends_seen: seen.clone(),
            pixels: vec![0],
            a_plate: vec![0.5],
            emission: vec![0.25],
            direct: vec![0.25],
            error_plate: vec![0.0],
            error_medium: vec![0.0],
            a_ends: vec![0.25 / 8.0; ENDS],
            error_ends: vec![1e-3],
            ..Operator::default()
        };
        let wide = one.clone().with_pixels(&[0, 1]);
        assert_eq!(wide.a_ends[..ENDS], one.a_ends[..]);
        assert_eq!(wide.a_ends[ENDS..], seen[ENDS..]);
        assert_eq!(wide.error_ends, [1e-3, 0.0]);
    }
}
