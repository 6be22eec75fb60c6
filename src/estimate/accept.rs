//! Which samples a map rests on: shots without a spray are left out as a whole, spikes sample by sample.
//!
//! The set is a pure function of all recorded cycles, whatever their order: medians of each level seed a line through
//! all levels; a frame is a misfire if its projection on that line is small; a sample is a spike if it is further from
//! it than five standard deviations of the variance law (more when there are few cycles). Means would be poisoned by what is looked for, and one level
//! alone could not tell; the line of all levels can. The map is then fitted to the exact sums of what is left.
//! Knows nothing of files: recorded cycles come from a [`Recorded`].

use super::accumulate::{AccumulateError, Sums};
use super::gate;
use super::law;
use super::map::FitInputs;
use rayon::prelude::*;

/// Standard deviations from which a sample is a spike, for many cycles: 6e-7 of normal samples, and shots of a lognormal
/// depth of 25 % lose less than 1e-4.
const SPIKE_SIGMAS: f64 = 5.0;

/// The gate is wider by this over the number of cycles, since its σ rests on few samples then: with four cycles of the
/// plain width one clean sample in six thousand was taken out. Spikes that matter are tens of σ.
const WIDER: f64 = 2.0;

/// Cycles of a level below which its median says nothing that the mean does not.
const CYCLES_MIN: usize = 3;

/// Rows and columns on each side whose robust variances are pooled, as the fit does.
const RADIUS: usize = 2;

/// Most bytes of differences that are held at a time; images are read in parts beyond.
const BYTES_MAX: usize = 256 << 20;

/// Takes a level's cycles one after the other: number of the cycle within its level, blanks, spray.
pub type Visitor<'a> = dyn FnMut(usize, &[&[u16]], &[u16]) + 'a;

/// Recorded cycles of a map, which can be gone through any number of times in any order.
pub trait Recorded {
    /// Why frames cannot be read.
    type Error: From<AccumulateError>;

    /// Cycles of a level, in the order of the record.
    fn cycles(&self, level: usize) -> usize;

    /// Calls `visit` for one cycle of a level.
    ///
    /// # Errors
    ///
    /// When a frame cannot be read.
    fn one(&mut self, level: usize, cycle: usize, visit: &mut Visitor<'_>) -> Result<(), Self::Error>;

    /// Calls `visit` for every cycle of a level.
    ///
    /// # Errors
    ///
    /// When a frame cannot be read.
    fn visit(&mut self, level: usize, visit: &mut Visitor<'_>) -> Result<(), Self::Error> {
        (0..self.cycles(level)).try_for_each(|cycle| self.one(level, cycle, visit))
    }
}

/// A cycle that was left out as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfire {
    /// Cycle within its level, from 0.
    pub cycle: usize,
    /// 1 for an ordinary shot, 0 for none.
    pub score: f64,
}

/// What was left out of one level.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LeftOut {
    /// Cycles without a spray.
    pub misfires: Vec<Misfire>,
    /// Samples left out as spikes, per cycle of the level.
    pub spikes: Vec<u32>,
}

/// Takes misfires and spikes out of `sums`, which hold all recorded cycles, and says what they were, level by level.
///
/// Levels of fewer than three cycles are left as they are, and so is everything when fewer than two levels have more.
/// `score_min` is the score below which a shot is a misfire: [`gate::SCORE_MIN`] unless the operator knows better.
///
/// # Errors
///
/// When a frame cannot be read or does not belong to the sums.
pub fn refine<R: Recorded>(
    sums: &mut Sums,
    inputs: &FitInputs<'_>,
    score_min: f64,
    recorded: &mut R,
) -> Result<Vec<LeftOut>, R::Error> {
    let levels = sums.levels().len();
    let mut out: Vec<LeftOut> = (0..levels)
        .map(|level| LeftOut { misfires: Vec::new(), spikes: vec![0; recorded.cycles(level)] })
        .collect();
    let judged: Vec<usize> = (0..levels)
        .filter(|&k| recorded.cycles(k) >= CYCLES_MIN && inputs.x_counts[k].is_some_and(f64::is_finite))
        .collect();
    if judged.len() < 2 || sums.columns() == 0 {
        return Ok(out);
    }
    let mut centres = Vec::with_capacity(judged.len());
    for &level in &judged {
        centres.push(Centre::of(level, sums, recorded)?);
    }
    let expectations = expectations(sums, inputs, &judged, &centres);
    drop(centres);
    for (&level, expected) in judged.iter().zip(&expectations) {
        out[level].misfires = misfires(level, sums, expected, score_min, recorded)?;
        take_out(level, sums, expected, &mut out[level], recorded)?;
    }
    Ok(out)
}

/// Medians of one level, per pixel, in counts; NaN without a sample.
struct Centre {
    median: Vec<f32>,
    /// Variance of a sample from the median absolute deviation.
    variance: Vec<f32>,
    samples: Vec<u16>,
}

impl Centre {
    fn of<R: Recorded>(level: usize, sums: &Sums, recorded: &mut R) -> Result<Self, R::Error> {
        let pixels = sums.rows() * sums.columns();
        let cycles = recorded.cycles(level);
        let (b, saturation) = (i32::from(sums.blanks_per_cycle()), sums.saturation_count());
        let mut out = Self { median: Vec::new(), variance: Vec::new(), samples: Vec::new() };
        let part = (BYTES_MAX / (4 * cycles)).clamp(1, pixels);
        for from in (0..pixels).step_by(part) {
            let range = from..(from + part).min(pixels);
            let mut held = vec![ABSENT; range.len() * cycles];
            recorded.visit(level, &mut |cycle, blanks, spray| {
                let range = range.clone();
                held.par_chunks_mut(cycles).enumerate().for_each(|(i, held)| {
                    let i = range.start + i;
                    held[cycle] = difference(blanks, spray, i, b, saturation).unwrap_or(ABSENT);
                });
            })?;
            let found: Vec<(f32, f32, u16)> =
                held.par_chunks_mut(cycles).map(|held| centre(held, f64::from(b))).collect();
            for (median, variance, samples) in found {
                out.median.push(median);
                out.variance.push(variance);
                out.samples.push(samples);
            }
        }
        Ok(out)
    }
}

/// Stands for a sample that was saturated: no difference is that small.
const ABSENT: i32 = i32::MIN;

/// Y = b·spray − Σ blanks of a pixel; None where a sample is saturated.
fn difference(blanks: &[&[u16]], spray: &[u16], i: usize, b: i32, saturation: u16) -> Option<i32> {
    let mut total = 0;
    let mut highest = spray[i];
    for blank in blanks {
        total += i32::from(blank[i]);
        highest = highest.max(blank[i]);
    }
    (highest < saturation).then(|| b * i32::from(spray[i]) - total)
}

/// Median, variance by the median absolute deviation, and number of the samples that are there.
#[expect(clippy::cast_possible_truncation, reason = "a seed needs no more digits; cycles saturate at 65 535")]
fn centre(held: &mut [i32], b: f64) -> (f32, f32, u16) {
    held.sort_unstable();
    let absent = held.iter().take_while(|&&y| y == ABSENT).count();
    let samples = &mut held[absent..];
    if samples.is_empty() {
        return (f32::NAN, f32::NAN, 0);
    }
    let twice = middle(samples);
    // Twice the deviation from the median, which may be a half.
    samples.iter_mut().for_each(|y| *y = (2 * i64::from(*y) - twice).unsigned_abs().min(1 << 30) as i32);
    samples.sort_unstable();
    #[expect(clippy::cast_precision_loss, reason = "differences below 2^25")]
    let (median, deviation) = (twice as f64 / (2.0 * b), middle(samples) as f64 / (4.0 * b));
    let sigma = 1.4826 * small_sample(samples.len()) * deviation;
    (median as f32, (sigma * sigma) as f32, u16::try_from(samples.len()).unwrap_or(u16::MAX))
}

/// Twice the median of sorted values.
fn middle(sorted: &[i32]) -> i64 {
    let half = sorted.len() / 2;
    let at = |i: usize| i64::from(sorted[i]);
    if sorted.len() % 2 == 1 { 2 * at(half) } else { at(half - 1) + at(half) }
}

/// What the median absolute deviation of few normal samples lacks (C. Croux, P. Rousseeuw 1992, table 1).
fn small_sample(n: usize) -> f64 {
    const FEW: [f64; 10] = [1.0, 1.0, 1.196, 1.495, 1.363, 1.206, 1.200, 1.140, 1.129, 1.107];
    #[expect(clippy::cast_precision_loss, reason = "a number of cycles")]
    let many = n as f64 / (n as f64 - 0.8);
    FEW.get(n).copied().unwrap_or(many)
}

/// What is expected of one level, per pixel: spray − blank in counts and half the width of its gate. NaN for a pixel
/// that has no line: nothing of it is judged.
struct Expected {
    counts: Vec<f32>,
    gate: Vec<f32>,
}

/// The line through all levels' medians and the gate around it, for every judged level.
fn expectations(sums: &Sums, inputs: &FitInputs<'_>, judged: &[usize], centres: &[Centre]) -> Vec<Expected> {
    let (rows, columns) = (sums.rows(), sums.columns());
    let pooled: Vec<Vec<f64>> = centres.iter().map(|centre| pooled(centre, rows, columns)).collect();
    let x: Vec<f64> = judged.iter().filter_map(|&k| inputs.x_counts[k]).collect();
    let b = f64::from(sums.blanks_per_cycle());
    let each: Vec<Vec<(f32, f32)>> = (0..rows * columns)
        .into_par_iter()
        .map_init(law::Scratch::default, |scratch, i| {
            let none = vec![(f32::NAN, f32::NAN); x.len()];
            let mut level = Vec::with_capacity(x.len());
            let (mut at, mut y, mut count, mut own, mut near, mut camera) =
                (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
            for (k, centre) in centres.iter().enumerate() {
                if usize::from(centre.samples[i]) < CYCLES_MIN {
                    continue;
                }
                let sum = &sums.levels()[judged[k]];
                #[expect(clippy::cast_precision_loss, reason = "a mean of counts")]
                let blank = sum.sum_blanks(i) as f64 / (f64::from(sum.count(i)) * b);
                level.push(k);
                at.push(x[k]);
                y.push(f64::from(centre.median[i]));
                // A median is worth 2/π of a mean.
                count.push(f64::from(centre.samples[i]) * std::f64::consts::FRAC_2_PI);
                own.push(f64::from(centre.variance[i]));
                near.push(pooled[k][i]);
                camera.push(inputs.camera.variance(blank + f64::from(centre.median[i]), blank, b));
            }
            let samples = law::Samples {
                x: &at,
                y: &y,
                count: &count,
                own: &own,
                pooled: &near,
                camera: &camera,
                residual_squares: &[],
            };
            let Some(fit) = law::fit(&samples, scratch) else { return none };
            let line = fit.line;
            let mut out = none;
            for (j, &k) in level.iter().enumerate() {
                let d = x[k] - line.mean_x;
                let expected = line.mean_y + line.slope * d;
                // The law alone, of an unknown camera and few cycles, can find too little near the crossing.
                let shot = (count[j] / scratch.weights()[j]).max(near[j]);
                let of_line = 1.0 / line.weight + d * d / line.spread;
                let sigmas = SPIKE_SIGMAS * (1.0 + WIDER / f64::from(centres[k].samples[i]));
                #[expect(clippy::cast_possible_truncation, reason = "a gate needs no more digits")]
                let pair = (expected as f32, (sigmas * (shot + of_line).sqrt()) as f32);
                out[k] = pair;
            }
            out
        })
        .collect();
    (0..x.len())
        .map(|k| Expected {
            counts: each.iter().map(|pixel| pixel[k].0).collect(),
            gate: each.iter().map(|pixel| pixel[k].1).collect(),
        })
        .collect()
}

/// Robust variances over neighbours: the mean of those that are there.
fn pooled(centre: &Centre, rows: usize, columns: usize) -> Vec<f64> {
    let mut out = vec![f64::NAN; rows * columns];
    out.par_chunks_mut(columns).enumerate().for_each(|(row, out)| {
        for (column, out) in out.iter_mut().enumerate() {
            let (mut sum, mut n) = (0.0, 0.0);
            for from in row.saturating_sub(RADIUS)..(row + RADIUS + 1).min(rows) {
                let window = from * columns + column.saturating_sub(RADIUS)
                    ..from * columns + (column + RADIUS + 1).min(columns);
                for i in window.filter(|&i| usize::from(centre.samples[i]) >= CYCLES_MIN) {
                    sum += f64::from(centre.variance[i]);
                    n += 1.0;
                }
            }
            if n > 0.0 {
                *out = sum / n;
            }
        }
    });
    out
}

/// Cycles of a level without a spray: their differences, with spikes cut off, projected on what is expected.
fn misfires<R: Recorded>(
    level: usize,
    sums: &Sums,
    expected: &Expected,
    score_min: f64,
    recorded: &mut R,
) -> Result<Vec<Misfire>, R::Error> {
    let (b, saturation) = (i32::from(sums.blanks_per_cycle()), sums.saturation_count());
    let mut scores = vec![f64::NAN; recorded.cycles(level)];
    recorded.visit(level, &mut |cycle, blanks, spray| {
        scores[cycle] = score(expected, blanks, spray, b, saturation);
    })?;
    let missed = gate::misfires(&scores, score_min);
    let both = missed.into_iter().zip(scores).enumerate();
    Ok(both.filter(|(_, (missed, _))| *missed).map(|(cycle, (_, score))| Misfire { cycle, score }).collect())
}

/// Σ w ŷ y / Σ w ŷ², weights by the width of the gate; y is cut off where neither a shot nor none could bring it.
/// Summed in order: the same bits for any number of threads.
fn score(expected: &Expected, blanks: &[&[u16]], spray: &[u16], b: i32, saturation: u16) -> f64 {
    let (mut up, mut down) = (0.0, 0.0);
    for (i, (&counts, &gate)) in expected.counts.iter().zip(&expected.gate).enumerate() {
        let (counts, gate) = (f64::from(counts), f64::from(gate));
        if !(counts.is_finite() && gate > 0.0) {
            continue;
        }
        let Some(y) = difference(blanks, spray, i, b, saturation) else { continue };
        let y = f64::from(y) / f64::from(b);
        let y = y.clamp(counts.min(0.0) - gate, counts.max(0.0) + gate);
        let w = 1.0 / (gate * gate);
        up += w * counts * y;
        down += w * counts * counts;
    }
    up / down
}

/// Takes misfires and then spikes out of the sums.
fn take_out<R: Recorded>(
    level: usize,
    sums: &mut Sums,
    expected: &Expected,
    out: &mut LeftOut,
    recorded: &mut R,
) -> Result<(), R::Error> {
    let (b, saturation) = (i32::from(sums.blanks_per_cycle()), sums.saturation_count());
    let mut trouble = Ok(());
    recorded.visit(level, &mut |cycle, blanks, spray| {
        if trouble.is_err() {
            return;
        }
        if out.misfires.iter().any(|misfire| misfire.cycle == cycle) {
            trouble = sums.remove_cycle(level, blanks, spray);
            return;
        }
        let spikes: Vec<usize> = expected
            .counts
            .par_iter()
            .zip(&expected.gate)
            .enumerate()
            .filter(|(i, (counts, gate))| {
                let y = difference(blanks, spray, *i, b, saturation);
                y.is_some_and(|y| {
                    (f64::from(y) / f64::from(b) - f64::from(**counts)).abs() > f64::from(**gate)
                })
            })
            .map(|(i, _)| i)
            .collect();
        out.spikes[cycle] = u32::try_from(spikes.len()).unwrap_or(u32::MAX);
        for i in spikes {
            sums.remove_sample(level, i, blanks, spray);
        }
    })?;
    Ok(trouble?)
}
