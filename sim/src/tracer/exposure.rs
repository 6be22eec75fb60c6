//! The pixels of an image from the medium and its in-scattered light: one sight through each, more where the image bends.

use super::behind::Behind;
use super::ends;
use super::errormap::{Summary, with_errors};
use super::fine::Fine;
use super::gather::{Field, Light, Sight};
use super::image::{Job, Stats, tell};
use super::interpolation::{PIXEL_MAX, Stencil, estimates, is_first};
use super::lanes::LANES;
use super::operator::Operator;
use super::packet::Packet;
use super::pieces::Pieces;
use super::pixels::{Frame, Refinement, in_tiles, sub_sight, sub_sights};
use super::sampling::Lit;
use super::shares::ROWS;
use super::spectrum::{One, Spectrum, narrow, vectorised};
use super::vector::Vector;
use rayon::prelude::*;

/// Sights of one parallel task.
const TASK_SIGHTS: usize = 256;

/// Pixels of one, where no sights are followed.
const TASK_PIXELS: usize = 2048;

/// Share of the target that the means over the pixels may err, rms; where nothing is scattered nothing else errs.
pub(super) const PIXEL_SHARE: f32 = 0.5;
const PIXEL_SHARE_ALONE: f32 = 0.95;

impl Job<'_> {
    pub(super) fn gather<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        lit: Option<&Lit<S>>,
        plate_seen: Vec<f32>,
        candidates: &[u32],
        stats: &mut Stats,
    ) -> Operator {
        let chamber = self.options.walls.apart();
        let ends_seen = chamber.map_or_else(Vec::new, |c| self.frame.ends_seen(c, &plate_seen));
        let behind = Behind { plate: plate_seen, ends: ends_seen };
        let field = Field {
            fine,
            plate: self.frame.plate,
            chamber,
            light: lit.map(|lit| Light::new(fine, &lit.scattered, &lit.leaves)),
        };
        let sparse = self.frame.pixel_in_cells(&fine.bricks) <= PIXEL_MAX;
        let columns = self.frame.camera.columns;
        let raster = self.frame.raster();
        let first: Vec<usize> =
            (0..candidates.len()).filter(|&i| !sparse || is_first(raster.at(candidates[i]))).collect();
        let mut taken = Taken::new(
            [fine.groups, fine.channels],
            self.width(fine.groups, fine.channels),
            candidates.len(),
        );
        let jobs: Vec<(usize, usize)> = first.iter().map(|&i| (i, 1)).collect();
        self.take(&field, &behind, candidates, &jobs, &mut taken);
        // Where one sight does not give the mean; where it does not, none is needed.
        let mut shown: Vec<[f32; ROWS]> = behind.plate.iter().map(|&seen| [seen, 0.0]).collect();
        for &i in &first {
            shown[candidates[i] as usize] = taken.summaries[i].shown;
        }
        let stencils = if sparse { self.stencils(candidates, &behind) } else { Vec::new() };
        let rows = self.frame.camera.rows;
        let estimates = estimates([rows, columns], candidates, &stencils, &shown);
        for (&pixel, estimate) in candidates.iter().zip(&estimates) {
            match estimate {
                Some([value, _]) if !is_first(raster.at(pixel)) => {
                    shown[pixel as usize] = *value;
                }
                _ => {}
            }
        }
        // Those that were seen to check the others are as good as samples.
        let interpolated: Vec<_> = estimates
            .iter()
            .zip(&taken.summaries)
            .map(|(e, summary)| e.filter(|_| summary.sights == 0).map(|[_, error]| error))
            .collect();
        let share = if lit.is_some() { PIXEL_SHARE } else { PIXEL_SHARE_ALONE };
        let budget = share * narrow(self.options.target_error);
        let mut refined = Vec::new();
        if sparse {
            refined = self.frame.refinements(&shown, candidates, &behind, &interpolated, &refined, budget);
            let jobs: Vec<(usize, usize)> = (0..candidates.len())
                .filter(|&i| refined[i].n > 0 && taken.summaries[i].sights == 0)
                .map(|i| (i, 1))
                .collect();
            self.take(&field, &behind, candidates, &jobs, &mut taken);
            for &(i, _) in &jobs {
                shown[candidates[i] as usize] = taken.summaries[i].shown;
            }
        }
        let refined = self.frame.refinements(&shown, candidates, &behind, &[], &refined, budget);
        let jobs: Vec<(usize, usize)> =
            (0..candidates.len()).map(|i| (i, refined[i].n)).filter(|&(_, n)| n > 1).collect();
        self.take(&field, &behind, candidates, &jobs, &mut taken);
        let left_out = taken.interpolate(&stencils, &refined, candidates, &behind);
        let Taken { values, summaries, .. } = taken;
        let rms = |row: usize| {
            let square = |r: &Refinement| f64::from(r.error[row]).powi(2);
            (refined.iter().map(square).sum::<f64>() / real(refined.len().max(1))).sqrt()
        };
        tell(stats, "sights", summaries.iter().map(|s| f64::from(s.sights)).sum());
        tell(stats, "cells_visited", summaries.iter().map(|s| f64::from(s.cells)).sum());
        tell(stats, "pixels_refined", real(refined.iter().filter(|r| r.n > 1).count()));
        tell(stats, "pixels_interpolated", real(left_out));
        tell(stats, "error_pixel", rms(0).max(rms(1)));
        let active: Vec<usize> = (0..candidates.len()).filter(|&i| summaries[i].met).collect();
        let operator = self.assemble(fine, behind, candidates, &values, &active);
        self.with_errors(operator, &summaries, &refined, &active, stats)
    }

    /// Where the pixels that are no samples are interpolated from: never across an edge between walls.
    fn stencils(&self, candidates: &[u32], behind: &Behind) -> Vec<Option<Stencil>> {
        let size = [self.frame.camera.rows, self.frame.camera.columns];
        let raster = self.frame.raster();
        let all = candidates.par_iter().with_min_len(1024);
        if behind.ends.is_empty() {
            return all.map(|&pixel| Stencil::new(raster, size, pixel)).collect();
        }
        all.map(|&pixel| {
            Stencil::new(raster, size, pixel)
                .filter(|stencil| stencil.terms().all(|(other, _)| behind.alike(pixel as usize, other)))
        })
        .collect()
    }

    /// Adds the sights of some candidates (their places, and how many per axis); values of an earlier pass give way.
    fn take<S: Spectrum>(
        &self,
        field: &Field<'_, S>,
        behind: &Behind,
        candidates: &[u32],
        jobs: &[(usize, usize)],
        taken: &mut Taken,
    ) {
        let (groups, width) = (field.fine.groups, taken.width);
        let jobs = in_tiles(self.frame.raster(), jobs, |&(i, _)| candidates[i]);
        let mut values = vec![0.0_f32; jobs.len() * width];
        // A task has about as many sights as any other.
        let sights: usize = jobs.iter().map(|(_, n)| n * n).sum();
        let size = (TASK_SIGHTS * jobs.len() / sights.max(1)).clamp(1, TASK_SIGHTS);
        let summaries: Vec<Summary> = values
            .par_chunks_mut(width * size)
            .zip(jobs.par_chunks(size))
            .flat_map_iter(|(values, jobs)| {
                let pixels: Vec<(u32, usize)> = jobs.iter().map(|&(i, n)| (candidates[i], n)).collect();
                let sights = self.sights(field, behind, &pixels);
                let finished = sights.iter().zip(values.chunks_exact_mut(width));
                finished.map(|(s, v)| finish(s, groups, v)).collect::<Vec<_>>()
            })
            .collect();
        for ((&(i, _), new), summary) in jobs.iter().zip(values.chunks_exact(width)).zip(summaries) {
            taken.values[i * width..(i + 1) * width].copy_from_slice(new);
            let before = taken.summaries[i];
            taken.summaries[i] = Summary {
                met: summary.met || before.met,
                sights: summary.sights + before.sights,
                cells: summary.cells + before.cells,
                ..summary
            };
        }
    }

    /// What the sights of some pixels collect; errors of one pixel in 16.
    fn sights<S: Spectrum>(
        &self,
        field: &Field<'_, S>,
        behind: &Behind,
        jobs: &[(u32, usize)],
    ) -> Vec<Sight<S>> {
        if let (Some(fine), None) = (field.fine.single(), field.chamber) {
            let pieces = field.light.as_ref().and_then(|light| light.pieces.as_ref());
            let sights = self.sights_together(fine, pieces, behind, jobs);
            return sights.iter().map(Sight::widened).collect();
        }
        let mut sights: Vec<Sight<S>> =
            jobs.iter().map(|_| Sight::new(field.fine.channels, field.chamber.is_some())).collect();
        vectorised(
            #[inline(always)]
            || {
                for (sight, &(pixel, n)) in sights.iter_mut().zip(jobs) {
                    let aims = self.aims(pixel, n, behind);
                    let mut k = 0;
                    while k < n * n {
                        let (ray, share) = aims.at(k);
                        if aims.errors {
                            sight.add::<true>(field, ray, share);
                        } else {
                            sight.add::<false>(field, ray, share);
                        }
                        k += 1;
                    }
                }
            },
        );
        sights
    }

    /// The same through a medium of one group, many sights at once.
    fn sights_together(
        &self,
        fine: &Fine<One>,
        pieces: Option<&Pieces>,
        behind: &Behind,
        jobs: &[(u32, usize)],
    ) -> Vec<Sight<One>> {
        let mut sights: Vec<Sight<One>> = jobs.iter().map(|_| Sight::new(fine.channels, false)).collect();
        let mut packet = Packet::new(fine.channels);
        let mut owners = [0; LANES];
        vectorised(
            #[inline(always)]
            || {
                let mut left = jobs.iter().enumerate();
                let mut now = None;
                let mut going = true;
                while going {
                    // Sub-sights of one pixel after the other, until the packet is full or nothing is left.
                    while packet.lanes() < LANES {
                        let Some((job, aims, k)) = &mut now else {
                            let Some((job, &(pixel, n))) = left.next() else {
                                going = false;
                                break;
                            };
                            now = Some((job, self.aims(pixel, n, behind), 0));
                            continue;
                        };
                        let (ray, share) = aims.at(*k);
                        owners[packet.lanes()] = *job;
                        packet.push(fine, self.frame.plate, ray, share, aims.errors);
                        *k += 1;
                        if *k == aims.n * aims.n {
                            now = None;
                        }
                    }
                    packet.run(fine, pieces);
                    for (lane, &job) in owners[..packet.lanes()].iter().enumerate() {
                        packet.take(pieces, lane, &mut sights[job]);
                    }
                    packet.clear();
                }
            },
        );
        sights
    }

    /// The sights through a pixel, `n` per axis.
    #[inline(always)]
    fn aims(&self, pixel: u32, n: usize, behind: &Behind) -> Aims<'_> {
        let [row, column] = self.frame.raster().at(pixel);
        let shares = if n > 1 { self.shares(row, column, n, behind.plate[pixel as usize]) } else { None };
        Aims { frame: &self.frame, row, column, n, shares, errors: with_errors(row, column) }
    }

    /// Weights of sub-sights that see the plate and of those that do not, where its edge crosses the pixel.
    fn shares(&self, row: usize, column: usize, n: usize, seen: f32) -> Option<[f32; 2]> {
        if seen <= 0.0 || seen >= 1.0 {
            return None;
        }
        let hits = sub_sights(row, column, n).filter(|&(r, c)| self.frame.sees(r, c)).count();
        let misses = n * n - hits;
        (hits > 0 && misses > 0).then(|| [seen / narrow(real(hits)), (1.0 - seen) / narrow(real(misses))])
    }

    pub(super) fn assemble<S: Spectrum>(
        &self,
        fine: &Fine<S>,
        behind: Behind,
        candidates: &[u32],
        values: &[f32],
        active: &[usize],
    ) -> Operator {
        let (groups, channels) = (fine.groups, fine.channels);
        let width = self.width(groups, channels);
        let part = |from: usize, to: usize| -> Vec<f32> {
            let mut out = vec![0.0; active.len() * (to - from)];
            if from == to {
                return out;
            }
            out.par_chunks_mut(1024 * (to - from)).zip(active.par_chunks(1024)).for_each(|(out, active)| {
                for (out, &i) in out.chunks_exact_mut(to - from).zip(active) {
                    out.copy_from_slice(&values[i * width + from..i * width + to]);
                }
            });
            out
        };
        Operator {
            rows: self.frame.camera.rows,
            columns: self.frame.camera.columns,
            groups,
            channels,
            plate_seen: behind.plate,
            ends_seen: behind.ends,
            pixels: active.iter().map(|&i| candidates[i]).collect(),
            a_plate: part(0, groups),
            emission: part(groups, groups * (1 + channels)),
            direct: part(groups * (1 + channels), groups * (1 + 2 * channels)),
            a_ends: part(groups * (1 + 2 * channels), width),
            ..Operator::default()
        }
    }
}

/// What has been found of the candidates.
struct Taken {
    /// Coefficients, `[candidate · width]`: plate, emission, direct emission, from `ends` on those of the ends of rays.
    values: Vec<f32>,
    width: usize,
    groups: usize,
    ends: usize,
    summaries: Vec<Summary>,
}

impl Taken {
    fn new([groups, channels]: [usize; 2], width: usize, candidates: usize) -> Self {
        let summaries = vec![Summary::default(); candidates];
        let ends = groups * (1 + 2 * channels);
        Self { values: vec![0.0; candidates * width], width, groups, ends, summaries }
    }

    /// Interpolates the candidates that got no sight; their number.
    fn interpolate(
        &mut self,
        stencils: &[Option<Stencil>],
        refined: &[Refinement],
        candidates: &[u32],
        behind: &Behind,
    ) -> usize {
        let (groups, width, ends) = (self.groups, self.width, self.ends);
        let mut place = vec![u32::MAX; behind.plate.len()];
        for (i, &pixel) in (0..).zip(candidates) {
            place[pixel as usize] = i;
        }
        let (values, summaries) = (&self.values, &self.summaries);
        let found: Vec<LeftOut> = stencils
            .par_chunks(TASK_PIXELS)
            .enumerate()
            .map(|(task, stencils)| {
                let places = task * TASK_PIXELS..;
                let left_out = places.zip(stencils).filter(|&(i, _)| refined[i].n == 0);
                let (mut which, mut found) = (Vec::new(), Vec::new());
                for (i, stencil) in left_out.filter_map(|(i, stencil)| Some((i, (*stencil)?))) {
                    let start = found.len();
                    found.resize(start + width, 0.0_f32);
                    let sum = &mut found[start..];
                    let mut met = false;
                    for (pixel, weight) in stencil.terms() {
                        match place[pixel] as usize {
                            p if p < summaries.len() => {
                                met |= summaries[p].met;
                                let from = &values[p * width..(p + 1) * width];
                                sum.iter_mut().zip(from).for_each(|(s, v)| *s += v * weight);
                            }
                            _ => behind.add_to(sum, groups, ends, pixel, weight),
                        }
                    }
                    bounded(sum, groups);
                    let (before, sum) = sum.split_at_mut(ends);
                    ends::close(sum, &before[..groups], &before[groups..2 * groups]);
                    which.push((i, met));
                }
                (which, found)
            })
            .collect();
        for (which, found) in &found {
            for (&(i, met), sum) in which.iter().zip(found.chunks_exact(width)) {
                self.values[i * width..(i + 1) * width].copy_from_slice(sum);
                self.summaries[i].met = met;
            }
        }
        found.iter().map(|(which, _)| which.len()).sum()
    }
}

/// Places of candidates without sights, whether they meet the medium, and their values.
type LeftOut = (Vec<(usize, bool)>, Vec<f32>);

/// Keeps interpolated coefficients (plate, emission, direct emission) in their ranges.
fn bounded(values: &mut [f32], groups: usize) {
    values.iter_mut().for_each(|v| *v = v.max(0.0));
    for g in 0..groups {
        let sum = values[g] + values[groups + g];
        if sum > 1.0 {
            values[g] /= sum;
            values[groups + g] /= sum;
        }
    }
}

/// Sights through one pixel.
struct Aims<'a> {
    frame: &'a Frame<'a>,
    row: usize,
    column: usize,
    /// Sights per axis.
    n: usize,
    /// Weights of those that see the plate and of those that do not.
    shares: Option<[f32; 2]>,
    /// Whether their errors are followed.
    errors: bool,
}

impl Aims<'_> {
    /// Origin, direction and weight of the k-th sight.
    #[inline(always)]
    fn at(&self, k: usize) -> ((Vector, Vector), f32) {
        let (r, c) = sub_sight(self.row, self.column, self.n, k);
        let share = match self.shares {
            None => 1.0,
            Some([on, _]) if self.frame.sees(r, c) => on,
            Some([_, off]) => off,
        };
        (self.frame.sights.ray(r, c), share)
    }
}

/// A complete sight as coefficients.
pub(super) fn finish<S: Spectrum>(sight: &Sight<S>, groups: usize, values: &mut [f32]) -> Summary {
    let share = 1.0 / sight.weight.max(f32::MIN_POSITIVE);
    let channels = 1 + sight.extra.len();
    let mut shown = [0.0; ROWS];
    for g in 0..groups {
        let mut plate = sight.plate.get(g) * share;
        let mut medium = (sight.direct.get(g) + sight.medium.get(g)) * share;
        // Against the rounding of the sums (1e-6), so that the walls' share is never negative.
        let sum = plate + medium;
        if sum > 1.0 {
            plate /= sum;
            medium /= sum;
        }
        values[g] = plate;
        values[groups + g] = medium;
        shown[0] += plate;
        shown[1] += medium;
        values[(1 + channels) * groups + g] = sight.direct.get(g) * share;
        for (c, [direct, scattered]) in sight.extra.iter().enumerate() {
            let direct = direct.get(g);
            values[(2 + c) * groups + g] = (direct + scattered.get(g)) * share;
            values[(2 + channels + c) * groups + g] = direct * share;
        }
    }
    let (before, ends) = values.split_at_mut((1 + 2 * channels) * groups);
    for (end, values) in sight.ends.iter().zip(ends.chunks_exact_mut(groups)) {
        for (g, value) in values.iter_mut().enumerate() {
            *value = end.get(g) * share;
        }
    }
    ends::close(ends, &before[..groups], &before[groups..2 * groups]);
    let per_group = 1.0 / narrow(real(groups));
    Summary {
        shown: shown.map(|s| s * per_group),
        errors: sight.errors(groups),
        errors_ends: sight.ends_errors(groups),
        met: sight.met,
        sights: u32::try_from(sight.sights).unwrap_or(u32::MAX),
        cells: u32::try_from(sight.cells).unwrap_or(u32::MAX),
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn real(n: usize) -> f64 {
    n as f64
}
