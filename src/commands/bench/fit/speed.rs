//! Times of sums and solves on full frames, 640 × 512 pixels and five levels, beside a copy of the bytes touched.
//!
//! On one thread the time of longer work is the processor's, where the system tells it: what else runs on the machine interrupts work
//! of many milliseconds in every run. On two threads it is the clock's.

use super::super::{Figure, Watch};
use super::shots::{self, CAMERA, Field, PLATES_K, STRONG};
use crate::estimate::accumulate::{Cycle, Sums};
use crate::estimate::map::{DitMap, Estimator, LookMap, Shots, look_at, look_into, solve_into};
use std::hint::black_box;

const ROWS: usize = 512;
const COLUMNS: usize = 640;
const CYCLES: usize = 10;
const SEED: u64 = 77;

/// Bytes of a pixel that a cycle of one blank reads and writes: ΣY, ΣY², Σ blanks, count, twice; two samples.
const BYTES_TOUCHED: usize = 2 * (4 + 8 + 4 + 2) + 4;

/// A batch lasts about this long, s: the system counts processor time in steps of some milliseconds.
const BATCH: f64 = 0.1;

/// Batches that a time is the minimum of.
const BATCHES: usize = 8;

/// Processor time of this thread, s; None where the system does not tell.
fn processor() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

/// Minimum time of `work`, s.
pub(super) fn fastest(watch: &Watch<'_>, threads: usize, mut work: impl FnMut()) -> f64 {
    let whole = watch.best_of(3, &mut work);
    if threads > 1 || processor().is_none() || whole < SHORT {
        return whole.min(watch.fastest(work));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most a hundred")]
    let calls = (BATCH / whole).clamp(1.0, 100.0) as u32;
    let batch = || {
        let begin = processor();
        (0..calls).for_each(|_| work());
        processor().zip(begin).map_or(f64::INFINITY, |(end, begin)| (end - begin) / f64::from(calls))
    };
    std::iter::repeat_with(batch).take(BATCHES).fold(f64::INFINITY, f64::min)
}

/// Work below this is over before another process gets its turn, s: the clock's minimum is good.
const SHORT: f64 = 2e-3;

type Pair = (Vec<u16>, Vec<u16>);

/// Times on one thread and on all.
pub(super) fn figures(watch: &Watch<'_>) -> Result<Vec<Figure>, String> {
    let field = Field { rows: ROWS, columns: COLUMNS, regime: STRONG, common: 0.5 };
    let pairs: Vec<Vec<Pair>> = (0..PLATES_K.len())
        .map(|level| (0..CYCLES).map(|cycle| field.pair(level, cycle, SEED)).collect())
        .collect();
    let truths = field.truths();
    let mut figures = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| e.to_string())?;
        pool.install(|| measured(watch, &pairs, &truths, threads, &mut figures));
    }
    Ok(figures)
}

fn empty() -> Sums {
    Sums::new(PLATES_K.len(), ROWS, COLUMNS, 1, 16_383).expect("one blank is allowed")
}

fn add_all(sums: &mut Sums, pairs: &[Vec<Pair>]) {
    for (level, pairs) in pairs.iter().enumerate() {
        let blanks = alone(pairs);
        sums.add_cycles(level, &cycles(pairs, &blanks)).expect("frames of this shape");
    }
}

/// The blank of every pair, as cycles take it.
fn alone(pairs: &[Pair]) -> Vec<[&[u16]; 1]> {
    pairs.iter().map(|(blank, _)| [blank.as_slice()]).collect()
}

fn cycles<'a>(pairs: &'a [Pair], blanks: &'a [[&'a [u16]; 1]]) -> Vec<Cycle<'a>> {
    pairs.iter().zip(blanks).map(|((_, spray), blanks)| Cycle { blanks, spray }).collect()
}

fn measured(
    watch: &Watch<'_>,
    pairs: &[Vec<Pair>],
    truths: &[shots::Truth],
    threads: usize,
    figures: &mut Vec<Figure>,
) {
    let mut say = |name: &str, seconds: f64, error: f64, kind: &str| {
        figures.push(Figure {
            name: name.to_owned(),
            seconds,
            error,
            error_kind: kind.to_owned(),
            n: ROWS * COLUMNS,
            threads,
            seed: Some(SEED),
        });
    };
    let mut sums = empty();
    add_all(&mut sums, pairs);
    // Levels and frames take turns, as in a campaign that never finds its sums in the cache by chance.
    let mut turn = 0;
    let mut running = sums.clone();
    let update = fastest(watch, threads, || {
        turn += 1;
        let level = turn % PLATES_K.len();
        let (blank, spray) = &pairs[level][turn % CYCLES];
        running.add_cycle(level, &[blank], spray).expect("a cycle more");
    });
    say("a cycle of one blank added", update, 0.0, "exact");
    if threads == 1 {
        let half = ROWS * COLUMNS * BYTES_TOUCHED / 2;
        let buffers: Vec<Vec<u8>> =
            (0..PLATES_K.len()).map(|i| vec![u8::try_from(i).unwrap_or(0); half]).collect();
        let mut targets = buffers.clone();
        let copy = fastest(watch, threads, || {
            turn += 1;
            let at = turn % PLATES_K.len();
            targets[at].copy_from_slice(black_box(&buffers[at]));
        });
        black_box(&targets);
        say("copy of as many bytes", copy, update / copy, "time of the update over this");
    }
    let ten: Vec<&[u16]> = pairs[0].iter().map(|(blank, _)| blank.as_slice()).collect();
    let mut many = Sums::new(1, ROWS, COLUMNS, 10, 16_383).expect("ten blanks");
    let ten = fastest(watch, threads, || many.add_cycle(0, &ten, &pairs[0][0].1).expect("a cycle more"));
    say("a cycle of ten blanks added", ten, 0.0, "exact");
    for estimator in [Estimator::Default, Estimator::Paper, Estimator::Ols] {
        let inputs = shots::inputs(estimator, CAMERA);
        let (mut kept, mut looked_at) = (DitMap::empty(), LookMap::empty());
        let long = fastest(watch, threads, || solve_into(black_box(&sums), &inputs, &mut kept));
        let short = fastest(watch, threads, || look_into(black_box(&sums), &inputs, &mut looked_at));
        let name = estimator.name();
        say(&format!("solve, all channels in f64: {name}"), long, rms(&kept.temperature_k, truths), KIND);
        let error = rms(&wide(&looked_at), truths);
        say(&format!("solve, what is looked at in f32: {name}"), short, error, KIND);
    }
    let mut fresh = empty();
    let adding = fastest(watch, threads, || {
        fresh.clear();
        add_all(&mut fresh, pairs);
    });
    say("50 raw pairs to sums", adding, 0.0, "exact");
    let blanks: Vec<Vec<[&[u16]; 1]>> = pairs.iter().map(|pairs| alone(pairs)).collect();
    let levels = pairs.iter().zip(&blanks).map(|(pairs, blanks)| cycles(pairs, blanks)).collect();
    let at_hand = Shots::new(&fresh, levels).expect("frames of this shape");
    for estimator in [Estimator::Default, Estimator::Paper] {
        let mut map = LookMap::empty();
        let inputs = shots::inputs(estimator, CAMERA);
        let whole = fastest(watch, threads, || {
            look_at(black_box(&at_hand), &inputs, &mut map).expect("frames of this shape");
        });
        let name = format!("50 raw pairs to what is looked at in f32: {}", estimator.name());
        say(&name, whole, rms(&wide(&map), truths), KIND);
        let summed = fastest(watch, threads, || {
            fresh.clear();
            add_all(&mut fresh, pairs);
            look_into(&fresh, &inputs, &mut map);
        });
        let name = format!("the same by sums of the whole image: {}", estimator.name());
        say(&name, summed, rms(&wide(&map), truths), KIND);
    }
}

/// What the error of a map is.
const KIND: &str = "rms of T where emissivity > 0.2, K";

fn wide(map: &LookMap) -> Vec<f64> {
    map.temperature_k.iter().map(|&t| f64::from(t)).collect()
}

/// Rms error of T where ε > 0.2, K.
fn rms(temperature_k: &[f64], truths: &[shots::Truth]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for (t, truth) in temperature_k.iter().zip(truths) {
        if truth.emissivity > 0.2 && t.is_finite() {
            sum += (t - truth.temperature_k).powi(2);
            n += 1.0;
        }
    }
    (sum / n).sqrt()
}
