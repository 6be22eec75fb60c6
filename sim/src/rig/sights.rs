//! The rendered sights of one scene at several densities, joined to coefficients for any density.
//!
//! Between the rendered density scales a pixel's images are interpolated linearly in v = 1 − exp(−τ·m), with m
//! the factor on the optical depth and τ the pixel's own optical depth at m = 1; the knots are m = 0 (no medium),
//! the rendered scales, and m = ∞ (extrapolated, then limited to legal coefficients). Every shot is therefore a
//! mean of legal coefficient sets: all stay in [0, 1], they change monotonically between knots, closure and the
//! isothermal enclosure hold exactly, and a gray absorbing medium is reproduced to 8e-4 of its opacity or better.
//! This rule is part of the declared law of fluctuations. Knows no band, plate or wall temperature.

use super::RigError;
use super::radiometry::same;
use crate::tracer::operator::Operator;
use std::ops::Range;

/// Knots of the density interpolation at most: the rendered scales, empty and opaque.
pub const KNOTS_MAX: usize = 10;

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
    /// [`RigError::Shape`] when they do not have the same shape, groups and channels.
    pub fn new(mut nodes: Vec<ScaleNode>, offset_k: f64) -> Result<Self, RigError> {
        let Some(first) = nodes.first().map(|node| &node.operator) else {
            return Err(RigError::Shape { why: "no density scale was rendered".to_owned() });
        };
        if nodes.len() + 2 > KNOTS_MAX || nodes.windows(2).any(|pair| pair[0].scale >= pair[1].scale) {
            let why = format!("one to {} density scales, ascending, are expected", KNOTS_MAX - 2);
            return Err(RigError::Shape { why });
        }
        for node in &nodes {
            check_operator(&node.operator, first)?;
        }
        let (rows, columns, groups) = (first.rows, first.columns, first.groups);
        let plate_seen = first.plate_seen.clone();
        // Which pixels at the edge of the spray are seen to meet it depends on where the tracer looked.
        let mut pixels: Vec<u32> =
            nodes.iter().flat_map(|node| node.operator.pixels.iter().copied()).collect();
        pixels.sort_unstable();
        pixels.dedup();
        for node in &mut nodes {
            node.operator = std::mem::take(&mut node.operator).with_pixels(&pixels);
        }
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
        let step = v[n] - v[n - 1];
        if step > 0.0 { f64::from((1.0 - v[n]) / step) } else { 0.0 }
    }

    /// Number of spectral groups of the operators; 0 without a medium.
    pub(super) fn groups(&self) -> usize {
        self.groups
    }

    /// Part of each pixel that sees the plate when the medium is absent, `[row, column]`.
    pub(super) fn seen(&self) -> &[f32] {
        &self.plate_seen
    }

    /// Ordinals of the active pixels of one row.
    pub(super) fn active(&self, row: usize) -> Range<usize> {
        self.row_start[row]..self.row_start[row + 1]
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
    /// Of the plate.
    pub(super) plate: f64,
    /// Of the medium, with in-scattering.
    pub(super) medium: Emission,
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
}

/// The knot at or below `v` and the part of the way to the next one.
pub(super) fn place(knots: &[f32], v: f32) -> (usize, f32) {
    let inner = &knots[1..knots.len() - 1];
    let k = inner.iter().filter(|&&knot| knot <= v).count();
    let step = knots[k + 1] - knots[k];
    // Knots of great depths coincide in f32: then the next one is as good.
    (k, if step > 0.0 { ((v - knots[k]) / step).clamp(0.0, 1.0) } else { 1.0 })
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
    if !inside || op.pixels.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err(RigError::Shape { why: "pixels of the image, ascending, are expected".to_owned() });
    }
    Ok(())
}

#[expect(clippy::cast_possible_truncation, reason = "images are f32")]
fn single(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::sample::{self, Choices};

    fn nodes() -> Vec<ScaleNode> {
        let node = |scale| ScaleNode { scale, operator: sample::operator(&Choices::usual(), scale) };
        [0.7, 1.0, 1.4].map(node).to_vec()
    }

    /// Noisy coefficients included, every knot holds coefficients that a medium could have.
    #[test]
    fn coefficients_are_legal_at_all_knots() {
        let mut noisy = nodes();
        for (k, node) in noisy.iter_mut().enumerate() {
            for (i, a) in node.operator.a_plate.iter_mut().enumerate() {
                let wiggle = if (i * 7 + k * 3) % 5 < 2 { 0.97 } else { 1.03 };
                *a = (*a * wiggle).min(1.0);
            }
        }
        for sights in [Sights::new(nodes(), 8.0).unwrap(), Sights::new(noisy, 8.0).unwrap()] {
            for i in 0..sights.pixels().len() {
                for g in 0..sights.groups() {
                    for c in &sights.coefficients(i, g)[..sights.knot_count()] {
                        let walls = 1.0 - c.plate - c.medium.weight;
                        // The middle knots are as rendered: f32 noise of 3 % may take walls below zero there.
                        assert!((0.0..=1.0).contains(&c.plate) && walls > -0.031, "{i} {g} {c:?}");
                        assert!((0.0..=1.0).contains(&c.medium.weight));
                    }
                    let opaque = sights.coefficients(i, g)[sights.knot_count() - 1];
                    assert!(opaque.plate + opaque.medium.weight <= 1.0 + 1e-12);
                }
            }
        }
    }

    /// At a rendered scale the place is its knot; in between and beyond it is a part from 0 to 1, also where
    /// knots coincide.
    #[test]
    fn every_value_has_a_place() {
        let sights = Sights::new(nodes(), 8.0).unwrap();
        for i in 0..sights.pixels().len() {
            let knots = sights.knots(i);
            for (k, &knot) in knots[..4].iter().enumerate() {
                let (found, part) = place(knots, knot);
                assert!(found == k && part < 1e-6, "{knots:?} {k}: {found} {part}");
            }
            let (found, part) = place(knots, 1.0);
            assert!(found == 3 && part >= 1.0);
        }
        let degenerate = [0.0, 0.5, 1.0, 1.0, 1.0];
        for v in [0.0, 0.3, 0.7, 1.0] {
            let (k, part) = place(&degenerate, v);
            assert!(k < 4 && (0.0..=1.0).contains(&part), "{v}: {k} {part}");
        }
    }

    /// A pixel that one scale did not meet is one through which it is not seen.
    #[test]
    fn scales_may_meet_different_pixels() {
        let mut nodes = nodes();
        let all = Sights::new(nodes.clone(), 8.0).unwrap();
        let (groups, channels) = (all.groups(), nodes[0].operator.channels);
        let op = &mut nodes[1].operator;
        let gone = op.pixels.remove(0);
        op.a_plate.drain(..groups);
        op.emission.drain(..groups * channels);
        op.direct.drain(..groups * channels);
        let sights = Sights::new(nodes, 8.0).unwrap();
        assert_eq!(sights.pixels(), all.pixels());
        assert_eq!(sights.pixels()[0], gone);
        let missed = sights.coefficients(0, 0)[2];
        let bits = |c: &Coefficients| [c.plate, c.medium.weight].map(f64::to_bits);
        assert_eq!(bits(&missed), [f64::from(sights.plate_seen(0)), 0.0].map(f64::to_bits));
        for i in 1..all.pixels().len() {
            let knots = 0..all.knot_count();
            assert!(knots.clone().all(|k| {
                let [a, b] = [&sights, &all].map(|s| bits(&s.coefficients(i, 0)[k]));
                a == b
            }));
        }
    }

    #[test]
    fn images_of_different_scenes_are_refused() {
        let refused = |change: &dyn Fn(&mut Vec<ScaleNode>)| {
            let mut nodes = nodes();
            change(&mut nodes);
            matches!(Sights::new(nodes, 8.0), Err(RigError::Shape { .. }))
        };
        assert!(!refused(&|_| {}));
        assert!(refused(&|nodes| nodes.clear()));
        assert!(refused(&|nodes| nodes.swap(0, 1)));
        assert!(refused(&|nodes| nodes[1].operator.pixels.swap(0, 1)));
        assert!(refused(&|nodes| nodes[2].operator.rows += 1));
        assert!(refused(&|nodes| nodes[2].operator.a_plate.truncate(5)));
        assert!(Sights::empty(2, 3, vec![1.0; 5]).is_err());
    }
}
