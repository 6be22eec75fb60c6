//! Fits an image: bands of rows on all threads, vectors of pixels within a row. Single pixels: `queries`.

use super::answers::{self, Answers, Channels, cut_channels};
use super::kernel::Constants;
use super::lanes::{Machine, WIDEST};
use super::plate;
use super::residuals::Residuals;
use super::rows::Walk;
use super::source::Source;
use super::writer::Writer;
use super::{Estimator, FitInputs, LEVELS_MAX};
use crate::estimate::student::Quantiles;
use pulp::Simd;
use rayon::prelude::*;
use std::marker::PhantomData;
use std::ops::Range;

/// Bands per thread: enough that one slow thread does not hold up the rest; each costs four rows of statistics more.
pub(super) const BANDS_PER_THREAD: usize = 2;

/// What is the same for all pixels of a fit.
pub(super) struct Common<'a> {
    pub(super) source: Source<'a>,
    pub(super) inputs: &'a FitInputs<'a>,
    /// Levels that have an x.
    pub(super) used: Vec<usize>,
    pub(super) constants: Constants,
    pub(super) residuals: Residuals,
}

impl<'a> Common<'a> {
    pub(super) fn new(source: Source<'a>, inputs: &'a FitInputs<'a>) -> Self {
        let sums = source.like();
        let pixels = sums.rows() * sums.columns();
        let levels = sums.levels().len();
        assert!(inputs.x_counts.len() == levels, "one x per level");
        assert!(levels <= LEVELS_MAX, "at most 256 levels");
        assert!(inputs.flat_gain.is_none_or(|flat| flat.len() == pixels), "one gain per pixel");
        let known = |&k: &usize| inputs.x_counts[k].is_some_and(f64::is_finite);
        let used: Vec<usize> = (0..levels).filter(known).collect();
        let x: Vec<f64> = used.iter().filter_map(|&k| inputs.x_counts[k]).collect();
        let residuals = match (inputs.estimator, source) {
            (Estimator::Default, Source::Sums(sums)) => Residuals::of(sums, inputs, &used, &x),
            // Shots that would need them are summed first.
            _ => Residuals::none(),
        };
        let blanks = f64::from(sums.blanks_per_cycle());
        let constants = Constants::new(x, inputs, blanks, &Quantiles::new(inputs.confidence));
        Self { source, inputs, used, constants, residuals }
    }

    /// Whether variances are pooled.
    pub(super) fn pools(&self) -> bool {
        self.inputs.estimator == Estimator::Default
    }
}

/// Rows of a map and where their answers go, channel by channel.
struct Band<'a, F> {
    rows: Range<usize>,
    channels: Channels<'a, F>,
    flags: &'a mut [u32],
}

/// Fits every pixel into `map`, whose memory is used again.
pub(super) fn solve_into<F: Machine, M: Answers<F>>(source: Source<'_>, inputs: &FitInputs<'_>, map: &mut M) {
    let (common, sums) = (Common::new(source, inputs), source.like());
    let (rows, columns) = (sums.rows(), sums.columns());
    map.prepare(sums, inputs);
    answers::reshape(map, rows * columns);
    if rows * columns == 0 {
        return;
    }
    let bands = match rayon::current_num_threads() {
        1 => 1,
        threads => (threads * BANDS_PER_THREAD).min(rows),
    };
    let height = rows.div_ceil(bands);
    let (mut channels, mut flags) = answers::whole(map);
    let mut tasks = Vec::with_capacity(bands);
    for start in (0..rows).step_by(height) {
        let rows = start..(start + height).min(rows);
        let pixels = rows.len() * columns;
        let channels = cut_channels(&mut channels, pixels);
        let flags = flags.split_off_mut(..pixels).expect("flags of every row");
        tasks.push(Band { rows, channels, flags });
    }
    let widest = pulp::Arch::new();
    tasks
        .into_par_iter()
        .for_each(|band| widest.dispatch(Task { common: &common, band, map: PhantomData::<M> }));
    plate::mask(&common, map);
}

/// A band to be fitted with the widest vectors of the machine.
struct Task<'a, F, M> {
    common: &'a Common<'a>,
    band: Band<'a, F>,
    map: PhantomData<M>,
}

impl<F: Machine, M: Answers<F>> pulp::WithSimd for Task<'_, F, M> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { common, mut band, .. } = self;
        let columns = common.source.like().columns();
        let mut writer = Writer::<F, M>::new(common, columns.next_multiple_of(WIDEST));
        let mut walk = Walk::new(common.source, common.inputs, &common.used);
        walk.start(band.rows, common.pools());
        while let Some(row) = walk.row() {
            let channels = cut_channels(&mut band.channels, columns);
            let flags = band.flags.split_off_mut(..columns).expect("flags of every row");
            writer.row(simd, &row, channels, flags);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::accumulate::Sums;
    use crate::estimate::calibration::SakumaHattori;
    use crate::estimate::map::{
        CONFIDENCE, CameraNoise, DitMap, LookMap, flag, lines_with_same_weights, look_into, solve,
    };
    use pulp::WithSimd;

    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
    const PLATES_K: [f64; 7] = [373.0, 403.0, 433.0, 498.0, 533.0, 453.0, 513.0];
    const ALL: [Estimator; 3] = [Estimator::Default, Estimator::Paper, Estimator::Ols];

    fn inputs(levels: usize, estimator: Estimator) -> FitInputs<'static> {
        FitInputs {
            x_counts: PLATES_K[..levels].iter().map(|&t| Some(0.95 * CURVE.value(t))).collect(),
            gamma_near: 0.95,
            gamma_far: 0.95,
            emissivity_plate: 0.99,
            far_window_counts: 0.0,
            curve: CURVE,
            residual: None,
            range: None,
            camera: CameraNoise { read_noise_counts: 1.2, electrons_per_count: 500.0, zero_counts: 1500.0 },
            estimator,
            confidence: CONFIDENCE,
            flat_gain: None,
        }
    }

    /// Shots over 23 columns (no multiple of any vector), with dead, saturated and missing pixels. The camera adds noise
    /// of some counts; every third row sees little of the plate.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
    fn sums(levels: usize, cycles: u32, counts: f64) -> Sums {
        let (rows, columns) = (11, 23);
        let mut sums = Sums::new(levels, rows, columns, 1, 16_383).unwrap();
        let mut state = 3_u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(u32::try_from(state >> 40).unwrap()) / 16_777_216.0 - 0.5
        };
        for (level, plate) in PLATES_K[..levels].iter().enumerate() {
            let x = 0.95 * CURVE.value(*plate);
            for _ in 0..cycles {
                let sees = |i: usize| if i / columns % 3 == 2 { 0.2 } else { 0.95 };
                let blank: Vec<u16> = (0..rows * columns)
                    .map(|i| (1500.0 + sees(i) * x + counts * noise()).round() as u16)
                    .collect();
                let mut spray: Vec<u16> = (0..rows * columns)
                    .map(|i| {
                        let emissivity = f64::from(u32::try_from(i % columns).unwrap()) / 25.0;
                        let shot = emissivity * (1.0 + 0.3 * noise());
                        (1500.0 + sees(i) * (x + shot * (60.0 - x)) + counts * noise()).round() as u16
                    })
                    .collect();
                spray[30] = 16_383;
                if level > 2 {
                    spray[31] = 16_383;
                }
                let mut blank = blank;
                (blank[40], spray[40]) = (1700, 1700);
                sums.add_cycle(level, &[&blank], &spray).unwrap();
            }
        }
        sums
    }

    fn bits(map: &DitMap) -> Vec<u64> {
        let channels = map.channels();
        channels.iter().flat_map(|channel| channel.iter().map(|v| v.to_bits())).collect()
    }

    /// What there is to look at, NaN as one number.
    fn looked_at<F: Machine>(map: &mut LookMap<F>) -> Vec<u64> {
        let (channels, _) = answers::whole(map);
        channels.iter().flat_map(|channel| channel.iter().map(|v| v.wide().to_bits())).collect()
    }

    /// A map by one number at a time.
    fn by_scalars<F: Machine, M: Answers<F>>(sums: &Sums, inputs: &FitInputs<'_>, map: &mut M) {
        let common = Common::new(Source::Sums(sums), inputs);
        map.prepare(sums, inputs);
        answers::reshape(map, sums.rows() * sums.columns());
        let (channels, flags) = answers::whole(map);
        let band = Band { rows: 0..sums.rows(), channels, flags };
        Task { common: &common, band, map: PhantomData::<M> }.with_simd(pulp::Scalar::new());
        plate::mask(&common, map);
    }

    /// Levels that are counted by the compiler and some that are not; cycles; noise of the camera.
    const KINDS: [(usize, u32, f64); 7] =
        [(5, 1, 4.0), (5, 2, 4.0), (5, 5, 4.0), (2, 3, 4.0), (3, 2, 0.0), (6, 3, 4.0), (7, 3, 4.0)];

    /// One number at a time gives the bits of the widest vectors, and of any number of threads.
    #[test]
    fn width_and_threads_do_not_change_a_bit() {
        for (estimator, (levels, cycles, counts)) in ALL.into_iter().flat_map(|e| KINDS.map(|kind| (e, kind)))
        {
            let (sums, inputs) = (sums(levels, cycles, counts), inputs(levels, estimator));
            let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            let (one, three) =
                (pool(1).install(|| solve(&sums, &inputs)), pool(3).install(|| solve(&sums, &inputs)));
            assert_eq!(bits(&one), bits(&three));
            assert_eq!(one.flags, three.flags);
            let mut scalar = DitMap::empty();
            by_scalars(&sums, &inputs, &mut scalar);
            assert_eq!(bits(&one), bits(&scalar), "{estimator:?} {levels} {cycles}");
            assert_eq!(one.flags, scalar.flags);
            let (mut look, mut scalar) = (LookMap::empty(), LookMap::empty());
            pool(3).install(|| look_into(&sums, &inputs, &mut look));
            by_scalars::<f32, _>(&sums, &inputs, &mut scalar);
            assert_eq!(looked_at(&mut look), looked_at(&mut scalar), "{estimator:?} {levels} {cycles}");
            assert_eq!(look.flags, scalar.flags);
        }
    }

    /// A map to be looked at has the bits and flags of the one that is kept, where numbers are alike. Pixels beside the
    /// plate are found, though it has no `sigma_gain`, also where many pixels have the same gain (no noise).
    #[test]
    fn what_is_looked_at_is_what_is_kept() {
        let mut masked = 0;
        for (estimator, (levels, cycles, counts)) in ALL.into_iter().flat_map(|e| KINDS.map(|kind| (e, kind)))
        {
            let (sums, inputs) = (sums(levels, cycles, counts), inputs(levels, estimator));
            let kept = solve(&sums, &inputs);
            let mut look = LookMap::<f64>::empty();
            by_scalars(&sums, &inputs, &mut look);
            let channels = kept.channels();
            let of_kept = [3, 4, 5, 6, 10, 11, 13].into_iter().flat_map(|k| channels[k]);
            let of_kept: Vec<u64> = of_kept.map(|v| v.to_bits()).collect();
            assert_eq!(looked_at(&mut look), of_kept, "{estimator:?} {levels} {cycles}");
            assert_eq!(look.flags, kept.flags);
            masked += kept.flags.iter().filter(|&&flags| flags & flag::NO_PLATE != 0).count();
        }
        assert!(masked > 500, "{masked}");
    }

    /// The vectors' mathematics against the plain functions of `law` and `line`: the weights of another writing of
    /// the same equations give the same line (1e-9: some hundred roundings, amplified by crossings outside the x).
    #[test]
    fn vectors_agree_with_the_plain_functions() {
        for (estimator, levels) in ALL.into_iter().flat_map(|e| [2, 3, 4, 5, 6, 7].map(|levels| (e, levels)))
        {
            let (sums, inputs) = (sums(levels, 4, 4.0), inputs(levels, estimator));
            let map = solve(&sums, &inputs);
            let x: Vec<f64> = inputs.x_counts.iter().map(|x| x.unwrap()).collect();
            let y: Vec<Vec<f64>> = sums
                .levels()
                .iter()
                .map(|level| {
                    (0..map.flags.len())
                        .map(|i| crate::estimate::accumulate::mean(level.sum(i), level.count(i), 1))
                        .collect()
                })
                .collect();
            let lines = lines_with_same_weights(&sums, &inputs, &x, &y);
            let mut compared = 0;
            for (i, line) in lines.iter().enumerate() {
                let Some(line) = line else {
                    assert!(map.flags[i] & flag::TOO_FEW_LEVELS != 0 && map.slope[i].is_nan());
                    continue;
                };
                if map.slope[i].is_nan() {
                    assert!(map.flags[i] & (flag::DEAD | flag::NO_PLATE) != 0, "{i}: {:b}", map.flags[i]);
                    continue;
                }
                assert!((map.slope[i] - line.slope).abs() <= 1e-9 * line.slope.abs().max(1e-3));
                assert!((map.chi2[i] - line.chi2).abs() <= 1e-8 * line.chi2.max(1.0));
                compared += 1;
            }
            assert!(compared > 140, "{compared}");
        }
    }

    /// In f32 temperatures move by less than a hundredth of their standard deviation, and flags stay.
    #[test]
    fn single_precision_is_good_for_looking() {
        let (sums, inputs) = (sums(5, 4, 4.0), inputs(5, Estimator::Default));
        let map = solve(&sums, &inputs);
        let mut live = LookMap::empty();
        look_into(&sums, &inputs, &mut live);
        for i in 0..map.flags.len() {
            if map.temperature_k[i].is_finite() && map.emissivity[i] > 0.1 {
                let off = (f64::from(live.temperature_k[i]) - map.temperature_k[i]).abs();
                assert!(off < 0.01 * map.sigma_temperature_k[i] && off < 0.005, "{i}: {off}");
                assert_eq!(live.flags[i], map.flags[i]);
            }
        }
    }
}
