//! What the pixels see behind the medium, were it not there.

use super::chamber::ENDS;
use super::ends::{EDGE_SIGHTS, mixed};

/// Fewest sights per axis where the plate's edge crosses a pixel.
const EDGE_SIGHTS_MIN: usize = 4;

/// Shares of the pixels' areas.
pub(super) struct Behind {
    /// That see the plate, `[pixel]`.
    pub(super) plate: Vec<f32>,
    /// That see each wall and the place outside, `[pixel][end]`; empty unless walls are told apart.
    pub(super) ends: Vec<f32>,
}

impl Behind {
    fn ends(&self, pixel: usize) -> &[f32] {
        self.ends.get(pixel * ENDS..(pixel + 1) * ENDS).unwrap_or_default()
    }

    /// Fewest sights per axis of a pixel: more than one where an edge of the plate crosses it, as many as its shares were
    /// found with where one between walls does.
    pub(super) fn sights_min(&self, pixel: usize) -> usize {
        let plate = self.plate[pixel];
        if mixed(self.ends(pixel)) {
            EDGE_SIGHTS
        } else if plate > 0.0 && plate < 1.0 {
            EDGE_SIGHTS_MIN
        } else {
            1
        }
    }

    /// Whether two pixels see the same wall, or none, so that no edge between walls lies between them.
    pub(super) fn alike(&self, pixel: usize, other: usize) -> bool {
        let pairs = self.ends(pixel).iter().zip(self.ends(other));
        pairs.fold(true, |alike, (a, b)| alike & ((*a > 0.0) == (*b > 0.0)))
    }

    /// Adds a share of what a pixel shows where no medium is in front of it, to coefficients of `groups` each: of the plate
    /// first, of the ends from `ends` on.
    pub(super) fn add_to(&self, values: &mut [f32], groups: usize, ends: usize, pixel: usize, weight: f32) {
        values[..groups].iter_mut().for_each(|v| *v += weight * self.plate[pixel]);
        for (values, share) in values[ends..].chunks_exact_mut(groups).zip(self.ends(pixel)) {
            values.iter_mut().for_each(|v| *v += weight * share);
        }
    }
}
