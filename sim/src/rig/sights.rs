//! From rendered coefficient images to the electrons that each pixel expects.
//!
//! All spectral groups are summed once per plate temperature; after that a pixel of a shot costs a handful of
//! multiply-adds. Knows nothing of noise, time or triggers.
//!
//! Between the rendered density scales a pixel's images are interpolated linearly in v = 1 − exp(−τ·m), with m
//! the factor on the optical depth and τ the pixel's own optical depth at m = 1; the knots are m = 0 (no medium),
//! the rendered scales, and m = ∞ (extrapolated, then limited to legal coefficients). Every shot is therefore a
//! mean of legal coefficient sets: all stay in [0, 1], they change monotonically between knots, closure and the
//! isothermal enclosure hold exactly, and a gray absorbing medium is
//! reproduced to 8e-4 of its opacity or better. This rule is part of the
//! declared law of fluctuations.

use super::RigError;
use super::fluctuation::Shot;
use super::radiometry::{Optics, Sources, same};
use crate::tracer::operator::Operator;
use rayon::prelude::*;
use std::ops::Range;

/// Knots of the density interpolation at most: the rendered scales, empty and opaque.
pub const KNOTS_MAX: usize = 10;

/// Plate temperatures are expanded around multiples of this: the second-order term left out is below 2e-5 of the
/// plate's light (n²/2·(0.125/373)² with n = 12.1, the steepest exponent of the filtered band).
const LEVEL_GRID_K: f64 = 0.25;

/// Optical depths of the interpolation variable: equal steps of the logarithm between the limits. Any depth would
/// be legal; beyond the limits knots would coincide in f32. Rounding to a step (0.08 % at most) makes pixels share
/// their weights; a gray absorber, which would be exact, errs by at most as much of its opacity, and only beyond
/// the last scale (between scales by less than 1e-5).
const DEPTHS: u16 = 4096;
const DEPTH_LIMITS: [f64; 2] = [0.01, 6.0];

fn depth_class(depth: f64) -> u16 {
    let [low, high] = DEPTH_LIMITS;
    let part = libm::log(depth.clamp(low, high) / low) / libm::log(high / low);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 4095")]
    let class = (part * f64::from(DEPTHS - 1)).round() as u16;
    class
}

/// The optical depth of a class.
pub(super) fn class_depth(class: u16) -> f32 {
    let [low, high] = DEPTH_LIMITS;
    single(low * libm::exp(libm::log(high / low) * f64::from(class) / f64::from(DEPTHS - 1)))
}

/// A medium rendered at one factor on its optical depth.
#[derive(Debug, Clone)]
pub struct ScaleNode {
    /// Factor on the optical depth.
    pub scale: f64,
    /// The coefficient images. Channel 0: source 1; channels 1, 2, 3: photon radiances at temperature offsets
    /// 0, −δ, +δ; channels 4, 5: droplets only, source 1 and photon radiance.
    pub operator: Operator,
}

/// The rendered sights of one scene at all its density scales.
#[derive(Debug, Clone)]
pub struct Sights {
    rows: usize,
    columns: usize,
    groups: usize,
    offset_k: f64,
    nodes: Vec<ScaleNode>,
    plate_seen: Vec<f32>,
    pixels: Vec<u32>,
    /// Where the active pixels of each row begin in `pixels`; one entry more than rows.
    row_start: Vec<usize>,
    /// Optical depth of each active pixel at scale 1, that of the interpolation variable.
    depth: Vec<f32>,
    /// Its ordinal among [`DEPTHS`].
    depth_class: Vec<u16>,
    /// v at the knots of each depth class, `[class][knot]`.
    knots: Vec<f32>,
}

impl Sights {
    /// Joins the operators of one scene, ascending in scale; `offset_k` is the δ of their temperature channels.
    ///
    /// # Errors
    /// [`RigError::Shape`] when they do not show the same pixels, groups and channels.
    pub fn new(nodes: Vec<ScaleNode>, offset_k: f64) -> Result<Self, RigError> {
        let Some(first) = nodes.first().map(|node| &node.operator) else {
            return Err(RigError::Shape { why: "no density scale was rendered".to_owned() });
        };
        if nodes.len() + 2 > KNOTS_MAX || nodes.windows(2).any(|pair| pair[0].scale >= pair[1].scale) {
            let why = format!("one to {} density scales, ascending, are expected", KNOTS_MAX - 2);
            return Err(RigError::Shape { why });
        }
        let pixels = first.pixels.clone();
        for node in &nodes {
            check_operator(&node.operator, first)?;
        }
        let (rows, columns, groups) = (first.rows, first.columns, first.groups);
        let plate_seen = first.plate_seen.clone();
        let row_start =
            (0..=rows).map(|row| pixels.partition_point(|&p| (p as usize) < row * columns)).collect();
        let mut sights = Self {
            rows,
            columns,
            groups,
            offset_k,
            nodes,
            plate_seen,
            row_start,
            depth: Vec::new(),
            depth_class: Vec::new(),
            knots: Vec::new(),
            pixels,
        };
        sights.depth_class = (0..sights.pixels.len()).map(|i| depth_class(sights.depth_of(i))).collect();
        sights.depth = sights.depth_class.iter().map(|&class| class_depth(class)).collect();
        sights.knots = (0..DEPTHS).flat_map(|class| sights.knots_of(class_depth(class))).collect();
        Ok(sights)
    }

    /// Sights without a medium. `plate_seen` is the part of each pixel that sees the plate, `[row, column]`.
    ///
    /// # Errors
    /// [`RigError::Shape`] when `plate_seen` is not one number per pixel.
    pub fn empty(rows: usize, columns: usize, plate_seen: Vec<f32>) -> Result<Self, RigError> {
        same("pixels of plate_seen", plate_seen.len(), rows * columns)?;
        Ok(Self {
            rows,
            columns,
            groups: 0,
            offset_k: 1.0,
            nodes: Vec::new(),
            plate_seen,
            pixels: Vec::new(),
            row_start: vec![0; rows + 1],
            depth: Vec::new(),
            depth_class: Vec::new(),
            knots: Vec::new(),
        })
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns of the image.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Linear indices of the pixels that meet the medium, ascending.
    pub fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// Optical depth of each active pixel at scale 1 in the sense of the interpolation.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// Whether temperature offsets were rendered.
    pub fn has_temperature_offsets(&self) -> bool {
        self.nodes.first().is_none_or(|n| n.operator.channels >= 4)
    }

    /// Emission along the straight sight of active pixel `i` in group `g` at all knots, for all species.
    pub(super) fn direct(&self, i: usize, g: usize) -> [Emission; KNOTS_MAX] {
        self.direct_of(i, g, &|op| if op.channels >= 4 { [0, 1, 2, 3] } else { [0, 1, 1, 1] })
    }

    /// The same of the droplets alone; `None` without their channels. They have no temperature offsets.
    pub(super) fn direct_droplets(&self, i: usize, g: usize) -> Option<[Emission; KNOTS_MAX]> {
        let rendered = self.nodes.first().is_some_and(|n| n.operator.channels >= 6);
        rendered.then(|| self.direct_of(i, g, &|_| [4, 5, 5, 5]))
    }

    fn direct_of(
        &self,
        i: usize,
        g: usize,
        channels: &dyn Fn(&Operator) -> [usize; 4],
    ) -> [Emission; KNOTS_MAX] {
        let mut all = [Emission::default(); KNOTS_MAX];
        for (slot, node) in all[1..].iter_mut().zip(&self.nodes) {
            let op = &node.operator;
            let read = |c: usize| f64::from(op.direct[(i * op.channels + c) * op.groups + g]);
            let [weight, calm, cold, hot] = channels(op).map(read);
            *slot = Emission::from_offsets(weight, [calm, cold, hot], self.offset_k);
        }
        let n = self.nodes.len();
        let (before, last) = (all[n - 1], all[n]);
        let weight = (last.weight + (last.weight - before.weight) * self.reach(i)).clamp(0.0, 1.0);
        all[n + 1] = last.scaled_to(weight);
        all
    }

    /// How far the opaque knot lies beyond the last rendered one, in units of the last step between knots.
    fn reach(&self, i: usize) -> f64 {
        let (v, n) = (self.knots(i), self.nodes.len());
        f64::from((1.0 - v[n]) / (v[n] - v[n - 1]))
    }

    pub(super) fn knot_count(&self) -> usize {
        if self.nodes.is_empty() { 0 } else { self.nodes.len() + 2 }
    }

    /// v at the knots of active pixel `i`, ascending from 0 to 1.
    pub(super) fn knots(&self, i: usize) -> &[f32] {
        self.class_knots(self.depth_class[i])
    }

    /// Ordinal of the optical depth of each active pixel: pixels of one class share knots and weights.
    pub(super) fn depth_classes(&self) -> &[u16] {
        &self.depth_class
    }

    /// v at the knots of a depth class, ascending from 0 to 1.
    pub(super) fn class_knots(&self, class: u16) -> &[f32] {
        let (n, class) = (self.knot_count(), usize::from(class));
        &self.knots[class * n..(class + 1) * n]
    }

    pub(super) fn plate_seen(&self, i: usize) -> f32 {
        self.plate_seen[self.pixels[i] as usize]
    }

    /// From the rendered scale nearest to 1: −ln(a_plate / plate_seen), or −ln(1 − a_medium) away from the plate.
    fn depth_of(&self, i: usize) -> f64 {
        let nearest =
            |a: &&ScaleNode, b: &&ScaleNode| (a.scale - 1.0).abs().total_cmp(&(b.scale - 1.0).abs());
        let Some(node) = self.nodes.iter().min_by(nearest) else { return DEPTH_LIMITS[0] };
        let op = &node.operator;
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let seen = self.plate_seen(i);
        let through = if seen > 0.5 {
            mean(&op.a_plate[i * self.groups..(i + 1) * self.groups]) / seen
        } else {
            let start = i * op.channels * self.groups;
            1.0 - mean(&op.emission[start..start + self.groups])
        };
        -libm::log(f64::from(through.clamp(1e-6, 1.0))) / node.scale
    }

    fn knots_of(&self, depth: f32) -> Vec<f32> {
        #[expect(clippy::cast_possible_truncation, reason = "knots are f32")]
        let at = |node: &ScaleNode| -libm::expm1(-f64::from(depth) * node.scale) as f32;
        std::iter::once(0.0).chain(self.nodes.iter().map(at)).chain(std::iter::once(1.0)).collect()
    }

    /// The images of the band for a plate near `plate_k` (exactly: at the multiple of 0.25 K next to it, with
    /// slopes), all groups summed.
    ///
    /// # Errors
    /// [`RigError::Shape`] when the operators have other groups than the band.
    pub fn level(&self, optics: &Optics, plate_k: f64) -> Result<Level, RigError> {
        self.level_at(optics, level_reference_k(plate_k))
    }

    /// The images of the band expanded around exactly `reference_k`.
    ///
    /// # Errors
    /// [`RigError::Shape`] when the operators have other groups than the band.
    pub fn level_at(&self, optics: &Optics, reference_k: f64) -> Result<Level, RigError> {
        if !self.nodes.is_empty() {
            same("spectral groups of the operators", self.groups, optics.groups())?;
        }
        let sources: Vec<Sources> = (0..optics.groups()).map(|g| optics.sources(g, reference_k)).collect();
        let n = self.knot_count();
        let values = (0..self.pixels.len())
            .into_par_iter()
            .with_min_len(1024)
            .flat_map_iter(|i| self.pixel_images(i, &sources).into_iter().take(n))
            .collect();
        Ok(Level { reference_k, blank: BlankLight::of(&sources), values, knots: n })
    }

    fn pixel_images(&self, i: usize, sources: &[Sources]) -> [Images; KNOTS_MAX] {
        let mut sums = [[0.0_f64; IMAGES]; KNOTS_MAX];
        for (g, source) in sources.iter().enumerate() {
            let coefficients = self.coefficients(i, g);
            for (sum, c) in sums.iter_mut().zip(&coefficients[..self.knot_count()]) {
                c.add_to(sum, f64::from(self.plate_seen(i)), source);
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "images are f32: 6e-8 of a few 1e5 electrons")]
        sums.map(|sum| sum.map(|x| x as f32))
    }

    /// Coefficients of active pixel `i` in group `g` at all knots.
    pub(super) fn coefficients(&self, i: usize, g: usize) -> [Coefficients; KNOTS_MAX] {
        let mut all =
            [Coefficients { plate: f64::from(self.plate_seen(i)), medium: Emission::default() }; KNOTS_MAX];
        let n = self.nodes.len();
        for (slot, node) in all[1..].iter_mut().zip(&self.nodes) {
            *slot = Coefficients::read(&node.operator, i, g, self.offset_k);
        }
        all[n + 1] = Coefficients::beyond(&all[n - 1], &all[n], self.reach(i));
        all
    }
}

/// The temperature at which the images for a plate at `plate_k` are made: it does not depend on history.
pub fn level_reference_k(plate_k: f64) -> f64 {
    (plate_k / LEVEL_GRID_K).round() * LEVEL_GRID_K
}

/// Emission along the straight sight of one pixel, group and knot, in powers of the temperature shift.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Emission {
    /// For source 1.
    pub(super) weight: f64,
    /// Photon radiance at the rendered temperatures.
    pub(super) calm: f64,
    /// Change per kelvin of the shift.
    pub(super) shift: f64,
    /// Change per squared kelvin.
    pub(super) shift_squared: f64,
}

impl Emission {
    fn from_offsets(weight: f64, [calm, cold, hot]: [f64; 3], offset_k: f64) -> Self {
        let shift = (hot - cold) / (2.0 * offset_k);
        let shift_squared = (hot + cold - 2.0 * calm) / (2.0 * offset_k * offset_k);
        Self { weight, calm, shift, shift_squared }
    }

    /// Source temperatures kept, amount changed.
    fn scaled_to(self, weight: f64) -> Self {
        let grown = if self.weight > 1e-9 { weight / self.weight } else { 0.0 };
        Self {
            weight,
            calm: self.calm * grown,
            shift: self.shift * grown,
            shift_squared: self.shift_squared * grown,
        }
    }
}

/// Coefficients of one pixel, group and knot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coefficients {
    plate: f64,
    medium: Emission,
}

impl Coefficients {
    fn read(op: &Operator, i: usize, g: usize, offset_k: f64) -> Self {
        let channel = |c: usize| f64::from(op.emission[(i * op.channels + c) * op.groups + g]);
        let radiances = if op.channels >= 4 { [1, 2, 3] } else { [1, 1, 1] };
        Self {
            plate: f64::from(op.a_plate[i * op.groups + g]),
            medium: Emission::from_offsets(channel(0), radiances.map(channel), offset_k),
        }
    }

    /// Beyond the last rendered scale: on along the line from `before` through `last`, kept legal.
    fn beyond(before: &Self, last: &Self, reach: f64) -> Self {
        let on = |a: f64, b: f64| b + (b - a) * reach;
        let plate = on(before.plate, last.plate).clamp(0.0, 1.0);
        let weight = on(before.medium.weight, last.medium.weight).clamp(0.0, 1.0 - plate);
        Self { plate, medium: last.medium.scaled_to(weight) }
    }

    /// The plate's coefficient.
    pub(super) fn plate(&self) -> f64 {
        self.plate
    }

    fn add_to(&self, sum: &mut [f64; IMAGES], seen: f64, s: &Sources) {
        let Emission { weight, calm, shift, shift_squared } = self.medium;
        let dimmed = self.plate - seen;
        let q = s.inside;
        // Against the blank: plate light that is lost, wall light that comes (closure), the medium's own light.
        sum[DIFFERENCE] += q * (dimmed * (s.far - s.walls) - weight * s.walls + calm);
        sum[PLATE_SLOPE] += q * s.far_slope * (dimmed * (1.0 - s.walls_per_far) - weight * s.walls_per_far);
        sum[SHIFT] += q * shift;
        sum[SHIFT_SQUARED] += q * shift_squared;
        sum[VAPOUR] += q * self.plate * (s.gas - s.far);
        sum[VAPOUR_SLOPE] -= q * self.plate * s.far_slope;
    }
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
                let change = sights.plate_seen(i) * vapour_layer(light, sights.depth[i]) * through_layer;
                out[sights.pixels[i] as usize - row_start] += change * single(light.integration_s);
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
            let fields = RowFields::of(shot, row, sights.columns);
            for i in active {
                let column = sights.pixels[i] as usize - row_start;
                let (factor, shift) = fields.at(column);
                let v = -libm::expm1f(-sights.depth[i] * factor);
                let blended = blend(sights.knots(i), self.images(i), v);
                let [difference, slope, one, two, layer, layer_slope] = blended;
                let mut change = difference + step * slope + shift * (one + shift * two);
                if light.vapour_depth > 0.0 {
                    change += vapour_layer(light, sights.depth[i]) * (layer + step * layer_slope);
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
        assert_eq!(electrons.len(), sights.plate_seen.len(), "one number per pixel");
        let walls = single(light.integration_s * self.blank_electrons_per_s(0.0, light.plate_k));
        let full = single(light.integration_s * self.blank_electrons_per_s(1.0, light.plate_k));
        let columns = sights.columns;
        electrons.par_chunks_mut(columns).enumerate().for_each(|(row, out)| {
            let start = row * columns;
            for (electron, seen) in out.iter_mut().zip(&sights.plate_seen[start..start + columns]) {
                *electron = walls + seen * (full - walls);
            }
            add(row, sights.row_start[row]..sights.row_start[row + 1], start, out);
        });
    }
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

/// The knot at or below `v` and the part of the way to the next one.
pub(super) fn place(knots: &[f32], v: f32) -> (usize, f32) {
    let inner = &knots[1..knots.len() - 1];
    let k = inner.iter().filter(|&&knot| knot <= v).count();
    (k, ((v - knots[k]) / (knots[k + 1] - knots[k])).clamp(0.0, 1.0))
}

/// Opacity of the left-over vapour where the spray has the optical depth `depth`: 1 − exp(−A·(1 − exp(−τ))).
fn vapour_layer(light: Illumination, depth: f32) -> f32 {
    -libm::expm1f(single(light.vapour_depth) * libm::expm1f(-depth))
}

fn check_operator(op: &Operator, first: &Operator) -> Result<(), RigError> {
    let active = op.pixels.len();
    same("rows", op.rows, first.rows)?;
    same("columns", op.columns, first.columns)?;
    same("groups", op.groups, first.groups)?;
    same("channels", op.channels, first.channels)?;
    same("plate_seen", op.plate_seen.len(), op.rows * op.columns)?;
    same("a_plate", op.a_plate.len(), active * op.groups)?;
    same("emission", op.emission.len(), active * op.channels * op.groups)?;
    same("direct", op.direct.len(), active * op.channels * op.groups)?;
    if op.channels < 2 {
        return Err(RigError::Shape { why: "channel 0 (source 1) and 1 (radiance) are needed".to_owned() });
    }
    let inside = op.pixels.iter().all(|&p| (p as usize) < op.rows * op.columns);
    if op.pixels != first.pixels || !inside || op.pixels.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err(RigError::Shape { why: "all scales show the same pixels, ascending".to_owned() });
    }
    Ok(())
}

#[expect(clippy::cast_possible_truncation, reason = "images are f32")]
fn single(value: f64) -> f32 {
    value as f32
}
