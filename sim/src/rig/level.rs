//! The images of one plate temperature: from coefficients to the electrons that each pixel expects.
//!
//! All spectral groups are summed once per plate temperature; after that a pixel of a shot costs a handful of
//! multiply-adds. Knows nothing of noise, time or triggers.

use super::RigError;
use super::fluctuation::Shot;
use super::radiometry::{Optics, Sources, same};
use super::sights::{Coefficients, Emission, KNOTS_MAX, Sights, place};
use rayon::prelude::*;
use std::ops::Range;

/// Plate temperatures are expanded around multiples of this: the second-order term left out is below 2e-5 of the
/// plate's light (n²/2·(0.125/373)² with n = 12.1, the steepest exponent of the filtered band).
const LEVEL_GRID_K: f64 = 0.25;

/// The temperature at which the images for a plate at `plate_k` are made: it does not depend on history.
pub fn level_reference_k(plate_k: f64) -> f64 {
    (plate_k / LEVEL_GRID_K).round() * LEVEL_GRID_K
}

/// Images per knot.
pub(super) const IMAGES: usize = 6;
/// Spray minus blank at the reference temperature, in electrons per second.
pub(super) const DIFFERENCE: usize = 0;
/// Its derivative by the plate's temperature.
pub(super) const PLATE_SLOPE: usize = 1;
/// Its change per kelvin of the medium's temperature shift.
pub(super) const SHIFT: usize = 2;
/// Its change per squared kelvin of the shift.
pub(super) const SHIFT_SQUARED: usize = 3;
/// Light that an opaque layer of gas in front of the plate would add to the spray image.
const VAPOUR: usize = 4;
/// Its derivative by the plate's temperature.
const VAPOUR_SLOPE: usize = 5;

pub(super) type Images = [f32; IMAGES];

/// All images of the band for one plate temperature.
#[derive(Debug, Clone)]
pub struct Level {
    reference_k: f64,
    blank: BlankLight,
    /// `[active pixel][knot]`.
    values: Vec<Images>,
    knots: usize,
}

/// What changes from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Illumination {
    /// True temperature of the plate's surface, in kelvin.
    pub plate_k: f64,
    /// Integration time, in seconds.
    pub integration_s: f64,
    /// Optical depth of left-over vapour between plate and spray, where the spray is opaque.
    pub vapour_depth: f64,
}

impl Level {
    /// The images of the band for a plate near `plate_k`: at [`level_reference_k`], with slopes.
    ///
    /// # Errors
    /// [`RigError::Shape`] when the operators have other groups than the band.
    pub fn near(sights: &Sights, optics: &Optics, plate_k: f64) -> Result<Self, RigError> {
        Self::at(sights, optics, level_reference_k(plate_k))
    }

    /// The images of the band expanded around exactly `reference_k`.
    ///
    /// # Errors
    /// [`RigError::Shape`] when the operators have other groups than the band.
    pub fn at(sights: &Sights, optics: &Optics, reference_k: f64) -> Result<Self, RigError> {
        if sights.knot_count() > 0 {
            same("spectral groups of the operators", sights.groups(), optics.groups())?;
        }
        let sources: Vec<Sources> = (0..optics.groups()).map(|g| optics.sources(g, reference_k)).collect();
        let knots = sights.knot_count();
        let values = (0..sights.pixels().len())
            .into_par_iter()
            .with_min_len(1024)
            .flat_map_iter(|i| pixel_images(sights, i, &sources).into_iter().take(knots))
            .collect();
        Ok(Self { reference_k, blank: BlankLight::of(&sources), values, knots })
    }

    /// The temperature around which the images were made, in kelvin.
    pub fn reference_k(&self) -> f64 {
        self.reference_k
    }

    /// Images of active pixel `i` at its knots.
    pub(super) fn images(&self, i: usize) -> &[Images] {
        &self.values[i * self.knots..(i + 1) * self.knots]
    }

    /// Electrons per second of a pixel that sees the plate with the part `seen` of its area, without medium.
    pub fn blank_electrons_per_s(&self, seen: f64, plate_k: f64) -> f64 {
        let step = plate_k - self.reference_k;
        let b = &self.blank;
        b.walls + step * b.walls_slope + seen * (b.plate + step * b.plate_slope)
    }

    /// Expected electrons of a frame without spray, `[row, column]`.
    ///
    /// # Panics
    /// When `electrons` is not one number per pixel of `sights`.
    pub fn expect_blank(&self, sights: &Sights, light: Illumination, electrons: &mut [f32]) {
        let (layer, slope) = (self.blank.vapour, self.blank.vapour_slope);
        let through_layer = single(layer + (light.plate_k - self.reference_k) * slope);
        self.expect_rows(sights, light, electrons, |_, active, row_start, out| {
            if light.vapour_depth <= 0.0 {
                return;
            }
            for i in active {
                let change = sights.plate_seen(i) * vapour_layer(light, sights.depth()[i]) * through_layer;
                out[sights.pixels()[i] as usize - row_start] += change * single(light.integration_s);
            }
        });
    }

    /// Expected electrons of a frame with the spray of `shot` (`None`: the spray as rendered), `[row, column]`.
    ///
    /// # Panics
    /// When `electrons` is not one number per pixel of `sights`.
    pub fn expect_spray(
        &self,
        sights: &Sights,
        light: Illumination,
        shot: Option<&Shot<'_>>,
        electrons: &mut [f32],
    ) {
        let step = single(light.plate_k - self.reference_k);
        self.expect_rows(sights, light, electrons, |row, active, row_start, out| {
            let fields = RowFields::of(shot, row, sights.columns());
            for i in active {
                let column = sights.pixels()[i] as usize - row_start;
                let (factor, shift) = fields.at(column);
                let v = -libm::expm1f(-sights.depth()[i] * factor);
                let blended = blend(sights.knots(i), self.images(i), v);
                let [difference, slope, one, two, layer, layer_slope] = blended;
                let mut change = difference + step * slope + shift * (one + shift * two);
                if light.vapour_depth > 0.0 {
                    change += vapour_layer(light, sights.depth()[i]) * (layer + step * layer_slope);
                }
                out[column] += change * single(light.integration_s);
            }
        });
    }

    /// Fills blank light into every pixel, then lets `add` change each row: (row, its active pixels, linear index
    /// of its first pixel, its electrons).
    fn expect_rows(
        &self,
        sights: &Sights,
        light: Illumination,
        electrons: &mut [f32],
        add: impl Fn(usize, Range<usize>, usize, &mut [f32]) + Sync,
    ) {
        assert_eq!(electrons.len(), sights.seen().len(), "one number per pixel");
        let walls = single(light.integration_s * self.blank_electrons_per_s(0.0, light.plate_k));
        let full = single(light.integration_s * self.blank_electrons_per_s(1.0, light.plate_k));
        let columns = sights.columns();
        electrons.par_chunks_mut(columns).enumerate().for_each(|(row, out)| {
            let start = row * columns;
            for (electron, seen) in out.iter_mut().zip(&sights.seen()[start..start + columns]) {
                *electron = walls + seen * (full - walls);
            }
            add(row, sights.active(row), start, out);
        });
    }
}

/// Light without a medium, in electrons per second: parts for pixels that do not, or do, see the plate.
#[derive(Debug, Clone, Copy, Default)]
struct BlankLight {
    walls: f64,
    walls_slope: f64,
    plate: f64,
    plate_slope: f64,
    vapour: f64,
    vapour_slope: f64,
}

impl BlankLight {
    fn of(sources: &[Sources]) -> Self {
        let mut light = Self::default();
        for s in sources {
            light.walls += s.inside * s.walls + s.outside * s.camera_side;
            light.walls_slope += s.inside * s.walls_per_far * s.far_slope;
            light.plate += s.inside * (s.far - s.walls);
            light.plate_slope += s.inside * (1.0 - s.walls_per_far) * s.far_slope;
            light.vapour += s.inside * (s.gas - s.far);
            light.vapour_slope -= s.inside * s.far_slope;
        }
        light
    }
}

/// All groups of one pixel summed, at all its knots.
fn pixel_images(sights: &Sights, i: usize, sources: &[Sources]) -> [Images; KNOTS_MAX] {
    let mut sums = [[0.0_f64; IMAGES]; KNOTS_MAX];
    let seen = f64::from(sights.plate_seen(i));
    for (g, source) in sources.iter().enumerate() {
        let coefficients = sights.coefficients(i, g);
        for (sum, c) in sums.iter_mut().zip(&coefficients[..sights.knot_count()]) {
            add_group(sum, c, seen, source);
        }
    }
    sums.map(|sum| sum.map(single))
}

fn add_group(sum: &mut [f64; IMAGES], c: &Coefficients, seen: f64, s: &Sources) {
    let Emission { weight, calm, shift, shift_squared } = c.medium;
    let dimmed = c.plate - seen;
    let q = s.inside;
    // Against the blank: plate light that is lost, wall light that comes (closure), the medium's own light.
    sum[DIFFERENCE] += q * (dimmed * (s.far - s.walls) - weight * s.walls + calm);
    sum[PLATE_SLOPE] += q * s.far_slope * (dimmed * (1.0 - s.walls_per_far) - weight * s.walls_per_far);
    sum[SHIFT] += q * shift;
    sum[SHIFT_SQUARED] += q * shift_squared;
    sum[VAPOUR] += q * c.plate * (s.gas - s.far);
    sum[VAPOUR_SLOPE] -= q * c.plate * s.far_slope;
}

/// The fields of a shot along one row.
struct RowFields {
    ln_tau: Vec<f32>,
    shift_k: Vec<f32>,
}

impl RowFields {
    fn of(shot: Option<&Shot<'_>>, row: usize, columns: usize) -> Self {
        let length = if shot.is_some() { columns } else { 0 };
        let mut fields = Self { ln_tau: vec![0.0; length], shift_k: vec![0.0; length] };
        if let Some(shot) = shot {
            shot.row(row, 0, &mut fields.ln_tau, &mut fields.shift_k);
        }
        fields
    }

    /// Factor on the optical depth and temperature shift in kelvin at `column`; (1, 0) without a shot.
    fn at(&self, column: usize) -> (f32, f32) {
        match (self.ln_tau.get(column), self.shift_k.get(column)) {
            (Some(&ln_tau), Some(&shift)) => (libm::expf(ln_tau), shift),
            _ => (1.0, 0.0),
        }
    }
}

/// Images at `v`, linear between the knots on both sides.
fn blend(knots: &[f32], images: &[Images], v: f32) -> Images {
    let (k, part) = place(knots, v);
    std::array::from_fn(|image| images[k][image] + part * (images[k + 1][image] - images[k][image]))
}

/// Opacity of the left-over vapour where the spray has the optical depth `depth`: 1 − exp(−A·(1 − exp(−τ))).
fn vapour_layer(light: Illumination, depth: f32) -> f32 {
    -libm::expm1f(single(light.vapour_depth) * libm::expm1f(-depth))
}

#[expect(clippy::cast_possible_truncation, reason = "images are f32")]
fn single(value: f64) -> f32 {
    value as f32
}
