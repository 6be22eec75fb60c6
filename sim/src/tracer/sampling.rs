//! In-scattered light of an image: the medium is cut into leaves, their cache is sampled in rounds, and both are repeated
//! until the errors of the image are below the target.

use super::blocks::Blocks;
use super::cache::{Cache, Leaves, Origin};
use super::camera::PixelFilter;
use super::cuts::{Limits, cut};
use super::fine::Fine;
use super::gather::{Field, Light, Sight};
use super::image::{ALBEDO_SHARE, Job, Stats, tell};
use super::paths::World;
use super::pixels::{in_tiles, sub_sights};
use super::places::{Places, depths};
use super::pyramid::Pyramid;
use super::reconstruct::{Scattered, pure_bias, reconstruct};
use super::scatter::Scatter;
use super::spectrum::{Spectrum, narrow, vectorised};
use super::visibility::{self, Probes, Views};
use rayon::prelude::*;

/// Rounds of sampling: a pilot and corrections.
const ROUNDS_MAX: usize = 8;

/// Paths of a round over those before it, at most.
const GROWTH_MAX: f64 = 3.0;

/// Mean square of the reconstruction's error that noise makes, over its own, since noisy leaves are mixed more: at least
/// so much (measured: 0.24 to 0.4).
const MIXED: f64 = 0.25;

/// Cuts of the medium into leaves: a first guess and finer ones.
const CUTS_MAX: usize = 3;

/// Share of the target beyond which a reconstruction error calls for smaller leaves: those cost new paths, while room for
/// noise is worth up to five times as many.
const RECUT: f64 = 1.1;

/// Paths of the pilot: as many as bring the noise to the target if the light that they tell deviates by so much (measured:
/// 0.08 to 0.13), but no more than bring it to twice the target where one path per image deviates by the second figure, since
/// leaves may turn out too coarse.
const PILOT_DEVIATION: [f64; 2] = [0.1, 0.5];

const PILOT_MIN: f64 = 12_288.0;

const PILOT_MAX: f64 = 1_048_576.0;

/// About so many sights are used to estimate errors between rounds.
const VIEWS: usize = 8192;

/// Target from which fewer sights tell where the camera looks.
const ROUGH: f64 = 2e-3;

/// Share of the target that the estimated errors of scattered light may take; the means over the pixels may take half of
/// it, so that both together stay below.
const MARGIN: f64 = 0.8;

/// Optical depth of what scatters in a leaf that lies alone, over the target: light changes by an eighth of itself there where
/// the surroundings are about as far as the leaf is wide.
const ALONE: f32 = 8.0;

/// Limits of leaves and of path blocks at a target of 1e-3.
const LEAF: Limits = Limits { depth: 0.25, spread: 0.085, alone: ALONE * 1e-3 };

const BLOCK: Limits = Limits { depth: 0.85, spread: 0.034, alone: f32::INFINITY };

/// Power of the target over 1e-3 with which they go, and its limits. The error of the leaves falls about as their depth
/// does, and that of the image costs least where it is half of the whole: measured on sprays that fill a third of the image
/// and on slender ones, from 4e-3 to 5e-4.
const FINER: f64 = 0.8;

const FINEST: f64 = 0.2;

const COARSEST: f64 = 4.5;

/// Blocks for paths go with its square where it is larger than one, up to here.
const ROUGHEST: f64 = 4.0;

/// Blocks for paths of several groups, which cost three times as much each, are so much rougher: a third fewer are visited,
/// and at a target of 1e-3 the error grows by 2e-4 to 3e-4 in quadrature.
const ROUGHER: f64 = 2.0;

/// In-scattered light with the leaves that it belongs to.
pub(super) struct Lit<S> {
    pub(super) scattered: Scattered<S>,
    pub(super) leaves: Leaves,
    /// Whether smaller cells are called for.
    pub(super) coarse: bool,
}

impl Job<'_> {
    /// In-scattered light, unless nothing scatters or nobody would see it.
    pub(super) fn lit<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        candidates: &[u32],
        stats: &mut Stats,
    ) -> Option<Lit<S>> {
        let limit = ALBEDO_SHARE * self.options.target_error;
        let scatters = self.options.scatter
            && !candidates.is_empty()
            && fine.core.par_iter().any(|c| f64::from(c[1].largest()) > limit);
        if !scatters {
            // What is left out: paths; and the error that it admits where the target allows it.
            let albedo = fine.core.par_iter().map(|c| c[1].largest()).reduce(|| 0.0, f32::max);
            let error = if self.options.scatter { f64::from(albedo) } else { 0.0 };
            tell(stats, "skipped_scattering", 1.0);
            tell(stats, "skipped_scattering_error", error);
            return None;
        }
        Some(self.scatter(fine, candidates, stats))
    }

    /// Samples the cache until the errors of the image are below the target.
    fn scatter<S: Spectrum>(&self, fine: &Fine<S>, candidates: &[u32], stats: &mut Stats) -> Lit<S> {
        // What the estimates of the errors miss is left room for.
        let target = MARGIN * self.options.target_error;
        let scatter = Scatter::<S>::new(&self.medium.phase);
        let pyramid = Pyramid::new(fine);
        let probes = self.probes(fine, candidates);
        let mut scale = (self.options.target_error / 1e-3).powf(FINER).clamp(FINEST, COARSEST);
        let (mut rounds, mut cuts) = (0, 0);
        loop {
            let limits = |l: Limits, scale: f64| Limits {
                depth: l.depth * narrow(scale),
                spread: l.spread * narrow(scale),
                alone: l.alone * narrow(scale),
            };
            // A rough image may follow its paths through a rougher medium.
            let rough =
                scale.max((scale * scale).min(ROUGHEST)) * if fine.groups > 1 { ROUGHER } else { 1.0 };
            let blocks = Blocks::<S>::new(fine, &pyramid, limits(BLOCK, rough));
            let bricks = cut(fine, &pyramid, limits(LEAF, scale));
            let count: usize = fine.occupied.iter().map(|&b| bricks.list[b].blocks()).sum();
            let mut leaves = Leaves { bricks, occupied: fine.occupied.clone(), demand: vec![0.0; count] };
            let depths = depths(fine, &pyramid, &leaves);
            let views = visibility::demand(fine, &mut leaves, &depths, &probes);
            let places = Places::new(&pyramid, &leaves, &depths, fine.channels);
            let chamber = self.options.walls.apart();
            let world = World { blocks: &blocks, scatter: &scatter, plate: self.frame.plate, chamber };
            let scattering = pyramid.scattering.as_slice();
            let (sights, seed) = (self.frame.sights, self.options.seed);
            let origin = Origin { fine, scattering, leaves: &leaves, sights, seed };
            let mut cache = Cache::<S>::new(count, fine.channels, chamber.is_some());
            // Leaves with fewer than a path each tell nothing of their own error.
            let seen = leaves.demand.iter().filter(|&&d| d > 0.0).count();
            let noise = views.noise_of_a_path(&leaves.demand, fine.groups);
            let [likely, most] = PILOT_DEVIATION;
            let pilot = (noise * (likely / target).powi(2)).min((0.5 * most / target).powi(2));
            let mut wanted = pilot.clamp(PILOT_MIN, PILOT_MAX).max(real(seen));
            let mut round = 0;
            let (scattered, [noise, bias], recut) = loop {
                let left = real_wide(self.options.paths_max.saturating_sub(cache.samples));
                let done = 0.05 + 0.2 * real(rounds.min(4));
                let told = |p: f64| (self.progress)(done + 0.15 * p);
                cache.add(&origin, &world, wanted.min(left), &told);
                rounds += 1;
                round += 1;
                let scattered = reconstruct(&places, &cache);
                let errors = self.probe(fine, &scattered, &leaves, &views, candidates);
                // What is left for noise beside the reconstruction: at least half of the target, and half of the other
                // error where no leaves are small enough, since less would hardly change the sum.
                let [whole, own, other] = [target, errors[0], errors[1]].map(|e| e * e);
                let least = (whole / 4.0).max(other / 4.0);
                let enough = own <= (whole - other).max(least);
                let last = round == ROUNDS_MAX || cache.samples >= self.options.paths_max;
                // Noise makes leaves mix, which adds to their own error: that is known when the noise is lower.
                let recut = errors[1] > RECUT * target
                    && (last || errors[0] <= target.max(0.5 * errors[1]))
                    && cuts + 1 < CUTS_MAX
                    && cache.samples < self.options.paths_max
                    && cuttable(&views, &scattered, &places, fine.groups);
                if enough || recut || last {
                    break (scattered, errors, recut);
                }
                // A part of the other error goes with the noise.
                let room = ((whole - (other - MIXED * own).max(0.0)) / (1.0 + MIXED)).max(least);
                wanted = real_wide(cache.samples) * (1.1 * own / room - 1.0).min(GROWTH_MAX);
            };
            cuts += 1;
            if !recut {
                for (name, value) in [
                    ("leaves", real(count)),
                    ("leaves_seen", real(seen)),
                    ("leaves_skipped", real(count - seen)),
                    ("blocks", real(blocks.core.len())),
                    ("paths", real_wide(cache.samples)),
                    ("scatterings", real_wide(cache.scatterings)),
                    ("blocks_visited", real_wide(cache.blocks)),
                    ("rounds", real(rounds)),
                    ("cuts", real(cuts)),
                    ("error_noise", noise),
                    ("error_reconstruction", bias),
                ] {
                    tell(stats, name, value);
                }
                let coarse = bias > RECUT * target && cache.samples < self.options.paths_max;
                return Lit { scattered, leaves, coarse };
            }
            scale *= (0.6 * target / bias).powf(0.75).clamp(0.2, 0.7);
        }
    }

    /// Sights close enough together that no leaf is missed that a pixel can see.
    fn probes<S: Spectrum>(&self, fine: &Fine<S>, candidates: &[u32]) -> Probes<'_> {
        let wide = self.frame.pixel_in_cells(&fine.bricks);
        let centre = self.frame.camera.pixel_filter == PixelFilter::Centre;
        // One probe for about every cell; for a rough image fewer will do: leaves beside those that were seen get some too.
        let rough = if self.options.target_error >= ROUGH { 2 } else { 1 };
        let stride = if wide <= 0.25 {
            4
        } else if wide <= 1.0 / 3.0 {
            3.max(2 * rough)
        } else if wide <= 0.5 {
            2 * rough
        } else {
            1
        };
        let fine_sights = if centre || wide <= 1.0 {
            1
        } else if wide <= 2.0 {
            2
        } else {
            4
        };
        let mut places: Vec<(f64, f64)> = in_tiles(self.frame.raster(), candidates, |&p| p)
            .into_iter()
            .map(|p| self.frame.raster().at(p).into())
            // Rows are shifted against each other, so that the sights do not line up with the cells.
            .filter(|&(row, column)| row % stride == 0 && (column + row / stride) % stride == 0)
            .flat_map(|(row, column)| sub_sights(row, column, fine_sights))
            .collect();
        let even = places.len();
        if self.frame.spreads() {
            places.extend(self.frame.beside(&fine.bricks, stride));
        }
        // An odd stride walks through all columns.
        let stride = (even / VIEWS).max(1) | 1;
        Probes { sights: self.frame.sights, plate: self.frame.plate, places, even, stride }
    }

    /// Rms noise and reconstruction error over the views, the larger ones of plate and medium.
    fn probe<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        scattered: &Scattered<S>,
        leaves: &Leaves,
        views: &Views<S>,
        candidates: &[u32],
    ) -> [f64; 2] {
        let [noise, bias] = views.errors(&scattered.leaves, fine.groups, |_| true);
        let pure = [0, 1].map(|row: usize| f64::from(pure_bias(narrow(noise[row]), narrow(bias[row]))));
        let [ends_noise, ends_bias] = self.probe_ends(fine, scattered, leaves, candidates);
        [noise[0].max(noise[1]).max(ends_noise).sqrt(), pure[0].max(pure[1]).max(ends_bias).sqrt()]
    }

    /// Mean squares of noise and bias of the walls' shares, where they are told apart.
    fn probe_ends<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        scattered: &Scattered<S>,
        leaves: &Leaves,
        candidates: &[u32],
    ) -> [f64; 2] {
        let chamber = self.options.walls.apart();
        if chamber.is_none() {
            return [0.0; 2];
        }
        let light = Light::new(fine, scattered, leaves);
        let field = Field { fine, plate: self.frame.plate, chamber, light: Some(light) };
        let columns = self.frame.camera.columns;
        let stride = (candidates.len() / VIEWS).max(1) | 1;
        let probed: Vec<[f32; 2]> = candidates
            .par_iter()
            .step_by(stride)
            .with_min_len(64)
            .filter_map(|&pixel| {
                let mut sight = Sight::<S>::new(field.fine.channels, true);
                let (row, column) = (pixel as usize / columns, pixel as usize % columns);
                let ray = self.frame.sights.ray(real(row) + 0.5, real(column) + 0.5);
                vectorised(
                    #[inline(always)]
                    || sight.add::<true>(&field, ray, 1.0),
                );
                sight.met.then(|| sight.ends_errors(field.fine.groups))
            })
            .collect();
        let mean = |kind: usize| {
            probed.iter().map(|e| f64::from(e[kind]).powi(2)).sum::<f64>() / real(probed.len().max(1))
        };
        let [noise, bias] = [mean(0), mean(1)];
        [noise, f64::from(pure_bias(narrow(noise), narrow(bias)))]
    }
}

/// Whether smaller leaves would help: those that can still be cut make half of the reconstruction's error.
fn cuttable<S: Spectrum>(
    views: &Views<S>,
    scattered: &Scattered<S>,
    places: &Places<'_>,
    groups: usize,
) -> bool {
    let [_, all] = views.errors(&scattered.leaves, groups, |_| true);
    let [_, some] = views.errors(&scattered.leaves, groups, |leaf| !places.is_cell(leaf));
    some[0].max(some[1]) > 0.25 * all[0].max(all[1])
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}

#[expect(clippy::cast_precision_loss, reason = "path counts are far below 2^53")]
fn real_wide(n: u64) -> f64 {
    n as f64
}
