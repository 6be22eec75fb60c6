//! Fits an image: bands of rows on all threads, vectors of pixels within a row. Single pixels: `queries`.

use super::kernel::{self, ALONE, Constants, GAIN, Group, Scratch};
use super::lanes::{Lanes, Machine, Number, WIDEST};
use super::residuals::Residuals;
use super::rows::{Row, Walk};
use super::single::Pixel;
use super::thermometer::Thermometer;
use super::{CHANNELS, DitMap, Estimator, FitInputs, LEVELS_MAX, flag};
use crate::estimate::accumulate::Sums;
use crate::estimate::student::Quantiles;
use pulp::Simd;
use rayon::prelude::*;
use std::ops::Range;

/// Bands per thread: enough that one slow thread does not hold up the rest; each costs four rows of statistics more.
pub(super) const BANDS_PER_THREAD: usize = 2;

/// Pixels that take part in the estimate of the highest gain.
const GAINS_MAX: usize = 16_384;

/// What is the same for all pixels of a fit.
pub(super) struct Common<'a> {
    sums: &'a Sums,
    inputs: &'a FitInputs<'a>,
    /// Levels that have an x.
    pub(super) used: Vec<usize>,
    pub(super) constants: Constants,
    pub(super) residuals: Residuals,
}

impl<'a> Common<'a> {
    pub(super) fn new(sums: &'a Sums, inputs: &'a FitInputs<'a>) -> Self {
        let pixels = sums.rows() * sums.columns();
        let levels = sums.levels().len();
        assert!(inputs.x_counts.len() == levels, "one x per level");
        assert!(levels <= LEVELS_MAX, "at most 256 levels");
        assert!(inputs.flat_gain.is_none_or(|flat| flat.len() == pixels), "one gain per pixel");
        let known = |&k: &usize| inputs.x_counts[k].is_some_and(f64::is_finite);
        let used: Vec<usize> = (0..levels).filter(known).collect();
        let x: Vec<f64> = used.iter().filter_map(|&k| inputs.x_counts[k]).collect();
        let residuals = match inputs.estimator {
            Estimator::Default => Residuals::of(sums, inputs, &used, &x),
            Estimator::Paper | Estimator::Ols => Residuals::of(sums, inputs, &[], &[]),
        };
        let blanks = f64::from(sums.blanks_per_cycle());
        let constants = Constants::new(x, inputs, blanks, &Quantiles::new(inputs.confidence));
        Self { sums, inputs, used, constants, residuals }
    }

    /// Whether variances are pooled.
    pub(super) fn pools(&self) -> bool {
        self.inputs.estimator == Estimator::Default
    }
}

/// Rows of a map and where their answers go, channel by channel.
struct Band<'a, F> {
    rows: Range<usize>,
    planes: [&'a mut [F]; CHANNELS.len()],
    flags: &'a mut [u32],
}

/// Fits every pixel into `map`, whose memory is used again.
pub(super) fn solve_into<F: Solved>(sums: &Sums, inputs: &FitInputs<'_>, map: &mut DitMap<F>) {
    let common = Common::new(sums, inputs);
    let (rows, columns) = (sums.rows(), sums.columns());
    map.reshape(sums, inputs);
    if rows * columns == 0 {
        return;
    }
    let bands = match rayon::current_num_threads() {
        1 => 1,
        threads => (threads * BANDS_PER_THREAD).min(rows),
    };
    let height = rows.div_ceil(bands);
    let (planes, flags) = map.planes_mut();
    let mut planes = planes.map(Vec::as_mut_slice);
    let mut flags = flags.as_mut_slice();
    let mut tasks = Vec::with_capacity(bands);
    for start in (0..rows).step_by(height) {
        let rows = start..(start + height).min(rows);
        let pixels = rows.len() * columns;
        let planes = planes.each_mut().map(|plane| cut(plane, pixels));
        tasks.push(Band { rows, planes, flags: cut(&mut flags, pixels) });
    }
    tasks.into_par_iter().for_each(|band| F::fit_band(&common, band));
    mask_off_plate(map, inputs.estimator);
}

/// A kind of number that maps can be made of.
#[expect(private_interfaces, reason = "only this room fits bands")]
pub trait Solved: Number {
    /// Fits a band with the widest vectors of the machine.
    #[doc(hidden)]
    fn fit_band(common: &Common<'_>, band: Band<'_, Self>);
}

macro_rules! solved {
    ($number:ty) => {
        #[expect(private_interfaces, reason = "only this room fits bands")]
        impl Solved for $number {
            fn fit_band(common: &Common<'_>, band: Band<'_, Self>) {
                struct Task<'a>(&'a Common<'a>, Band<'a, $number>);
                impl pulp::WithSimd for Task<'_> {
                    type Output = ();
                    #[inline(always)]
                    fn with_simd<S: Simd>(self, simd: S) {
                        fit_rows(simd, self.0, self.1);
                    }
                }
                pulp::Arch::new().dispatch(Task(common, band));
            }
        }
    };
}

solved!(f64);
solved!(f32);

#[inline(always)]
fn fit_rows<S: Simd, F: Machine<S>>(simd: S, common: &Common<'_>, band: Band<'_, F>) {
    let (columns, stride) = (common.sums.columns(), common.sums.columns().next_multiple_of(WIDEST));
    let mut writer = Writer {
        flags: vec![F::of(0.0); stride],
        asked: vec![F::of(0.0); stride],
        last: [[F::of(0.0); WIDEST]; CHANNELS.len()],
        pixel: Pixel::default(),
    };
    let thermometer = Thermometer::new(common.inputs);
    let mut walk = Walk::new(common.sums, common.inputs, &common.used);
    let mut scratch = None;
    walk.start(band.rows, common.pools());
    let mut planes = band.planes;
    let mut flags = band.flags;
    while let Some(row) = walk.row() {
        // Rows go straight to where they stay: a copy of fifteen channels costs a tenth of a solve.
        let mut channels: [&mut [F]; CHANNELS.len()] = planes.each_mut().map(|plane| cut(plane, columns));
        let bits = cut(&mut flags, columns);
        writer.fit(simd, common, &row, &mut scratch, &mut channels);
        writer.flag(bits);
        writer.alone(common, &row, &mut channels, bits);
        writer.read(&thermometer, &mut channels, bits);
    }
}

/// Takes the first `n` of what is left.
fn cut<'a, T>(left: &mut &'a mut [T], n: usize) -> &'a mut [T] {
    let (first, rest) = std::mem::take(left).split_at_mut(n);
    *left = rest;
    first
}

/// Where a row's channels go.
type Channels<'a, F> = [&'a mut [F]; CHANNELS.len()];

/// Answers of a row.
struct Writer<F> {
    flags: Vec<F>,
    asked: Vec<F>,
    last: [[F; WIDEST]; CHANNELS.len()],
    pixel: Pixel,
}

impl<F: Number> Writer<F> {
    #[inline(always)]
    fn fit<S: Simd>(
        &mut self,
        simd: S,
        common: &Common<'_>,
        row: &Row<'_, F>,
        scratch: &mut Option<Scratch<<F as Machine<S>>::Lanes>>,
        channels: &mut Channels<'_, F>,
    ) where
        F: Machine<S>,
    {
        let (each, constants) = (row.stride / F::WIDTH, &common.constants);
        let one = F::read(simd, row.flat, 0).all(0.0);
        let scratch = scratch.get_or_insert_with(|| Scratch::new(one, constants));
        for vector in 0..row.columns.div_ceil(F::WIDTH) {
            if vector == 0 || !row.alike {
                for (k, place) in scratch.places.iter_mut().enumerate() {
                    place.count = F::read(simd, row.count, k * each + vector);
                }
                scratch.place(one, constants);
            }
            for (k, level) in scratch.levels.iter_mut().enumerate() {
                let at = k * each + vector;
                // One by one: a whole `Level` would go through the stack.
                level.mean = F::read(simd, row.mean, at);
                level.squares = F::read(simd, row.squares, at);
                level.blank = F::read(simd, row.blank, at);
                level.pooled = F::read(simd, row.pooled, at);
            }
            let group = Group {
                flat: F::read(simd, row.flat, vector),
                flags: F::read(simd, row.flags, vector),
                alive: F::read(simd, row.alive, vector),
                first_mean: one,
                singles: row.singles,
            };
            let answer = kernel::fit(one, constants, common.inputs.estimator, group, scratch);
            let to = vector * F::WIDTH..(vector + 1) * F::WIDTH;
            F::write(&mut self.flags[to.clone()], answer.flags);
            F::write(&mut self.asked[to.clone()], answer.asked);
            // The last pixels of a row may be fewer than a vector holds.
            let whole = to.end <= row.columns;
            let last = &mut self.last;
            macro_rules! write {
                // Spelled out: a loop over vectors would take them through the stack.
                ($($channel:literal)*) => {$(
                    let numbers =
                        if whole { &mut channels[$channel][to.clone()] } else { &mut last[$channel][..F::WIDTH] };
                    F::write(numbers, answer.channels[$channel]);
                )*};
            }
            write!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14);
            if !whole {
                for (channel, last) in channels.iter_mut().zip(last) {
                    let end = &mut channel[to.start..];
                    end.copy_from_slice(&last[..end.len()]);
                }
            }
        }
    }

    /// Flags as bits.
    #[inline(always)]
    fn flag(&self, bits: &mut [u32]) {
        for (bits, &flags) in bits.iter_mut().zip(&self.flags) {
            *bits = flags.bits_of();
        }
    }

    /// Pixels that were marked, one by one.
    fn alone(
        &mut self,
        common: &Common<'_>,
        row: &Row<'_, F>,
        channels: &mut Channels<'_, F>,
        bits: &mut [u32],
    ) {
        if bits.iter().fold(0, |any, bits| any | bits) & ALONE == 0 {
            return;
        }
        for i in 0..row.columns {
            if bits[i] & ALONE == 0 {
                continue;
            }
            bits[i] = row.flags[i].bits_of();
            let residuals = common.residuals.at(row.row * row.columns + i);
            self.pixel.gather(row, i, common.inputs, &common.constants, residuals);
            let Some(answer) = self.pixel.fit(&common.constants) else {
                bits[i] |= flag::TOO_FEW_LEVELS;
                channels[..GAIN].iter_mut().for_each(|channel| channel[i] = F::NAN);
                self.asked[i] = F::of(0.0);
                continue;
            };
            for (channel, value) in channels[..GAIN].iter_mut().zip(&answer.channels) {
                channel[i] = F::of(value.1);
            }
            bits[i] |= answer.flags.1.bits_of();
            self.asked[i] = F::of(answer.asked.1);
        }
    }

    #[inline(always)]
    fn read(&self, thermometer: &Thermometer<'_, F>, channels: &mut Channels<'_, F>, bits: &mut [u32]) {
        let [_, _, _, _, temperature, _, sigma, _, _, _, low, high, noise, _, _] = channels;
        thermometer.read_flagged(temperature, [sigma, noise], &self.asked, bits);
        thermometer.read(low);
        thermometer.read(high);
    }
}

/// Pixels whose blanks do not follow the plate: gain below half of the 90th percentile of all pixels, if the blanks
/// follow the plate clearly at all. Our own estimator gives them no answer.
fn mask_off_plate<F: Number>(map: &mut DitMap<F>, estimator: Estimator) {
    let step = map.gain.len().div_ceil(GAINS_MAX).max(1);
    let mut gains: Vec<(F, F)> = map
        .gain
        .iter()
        .zip(&map.sigma_gain)
        .step_by(step)
        .map(|(&gain, &sigma)| (gain, sigma))
        .filter(|(gain, _)| gain.is_number())
        .collect();
    if gains.is_empty() {
        return;
    }
    let place = (gains.len() - 1) * 9 / 10;
    let order =
        |a: &(F, F), b: &(F, F)| a.0.wide().total_cmp(&b.0.wide()).then(a.1.wide().total_cmp(&b.1.wide()));
    let (_, &mut (high, sigma), _) = gains.select_nth_unstable_by(place, order);
    // Six standard deviations of one pixel, so that noise alone masks none; NaN fails.
    let clear = F::of(6.0) * sigma < high;
    if !clear {
        return;
    }
    let limit = F::of(0.5) * high;
    for i in 0..map.gain.len() {
        if map.gain[i] < limit {
            map.flags[i] |= flag::NO_PLATE;
            if estimator == Estimator::Default {
                map.silence(i);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::SakumaHattori;
    use crate::estimate::map::{CONFIDENCE, CameraNoise, lines_with_same_weights, solve};

    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };
    const PLATES_K: [f64; 5] = [373.0, 403.0, 433.0, 498.0, 533.0];

    fn inputs(estimator: Estimator) -> FitInputs<'static> {
        FitInputs {
            x_counts: PLATES_K.iter().map(|&t| Some(0.95 * CURVE.value(t))).collect(),
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

    /// Shots over 23 columns (no multiple of any vector), with dead, saturated and missing pixels.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
    fn sums(cycles: u32) -> Sums {
        let (rows, columns) = (11, 23);
        let mut sums = Sums::new(PLATES_K.len(), rows, columns, 1, 16_383).unwrap();
        let mut state = 3_u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(u32::try_from(state >> 40).unwrap()) / 16_777_216.0 - 0.5
        };
        for (level, plate) in PLATES_K.into_iter().enumerate() {
            let x = 0.95 * CURVE.value(plate);
            for _ in 0..cycles {
                let blank: Vec<u16> =
                    (0..rows * columns).map(|_| (1500.0 + 0.95 * x + 4.0 * noise()).round() as u16).collect();
                let mut spray: Vec<u16> = (0..rows * columns)
                    .map(|i| {
                        let emissivity = f64::from(u32::try_from(i % columns).unwrap()) / 25.0;
                        let shot = emissivity * (1.0 + 0.3 * noise());
                        (1500.0 + 0.95 * (x + shot * (60.0 - x)) + 4.0 * noise()).round() as u16
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

    /// One number at a time gives the bits of the widest vectors, and of any number of threads.
    #[test]
    fn width_and_threads_do_not_change_a_bit() {
        for estimator in [Estimator::Default, Estimator::Paper, Estimator::Ols] {
            for cycles in [1, 2, 5] {
                let (sums, inputs) = (sums(cycles), inputs(estimator));
                let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
                let (one, three) =
                    (pool(1).install(|| solve(&sums, &inputs)), pool(3).install(|| solve(&sums, &inputs)));
                assert_eq!(bits(&one), bits(&three));
                assert_eq!(one.flags, three.flags);
                let mut scalar = DitMap::empty();
                scalar.reshape(&sums, &inputs);
                let common = Common::new(&sums, &inputs);
                let (planes, flags) = scalar.planes_mut();
                let planes = planes.map(Vec::as_mut_slice);
                fit_rows(pulp::Scalar::new(), &common, Band { rows: 0..sums.rows(), planes, flags });
                mask_off_plate(&mut scalar, estimator);
                assert_eq!(bits(&one), bits(&scalar), "{estimator:?} {cycles}");
                assert_eq!(one.flags, scalar.flags);
            }
        }
    }

    /// The vectors' mathematics against the plain functions of `law` and `line`: the weights of another writing of
    /// the same equations give the same line (1e-9: some hundred roundings, amplified by crossings outside the x).
    #[test]
    fn vectors_agree_with_the_plain_functions() {
        for estimator in [Estimator::Default, Estimator::Paper, Estimator::Ols] {
            let (sums, inputs) = (sums(4), inputs(estimator));
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
                    assert!(map.flags[i] & flag::DEAD != 0, "{i}: {:b}", map.flags[i]);
                    continue;
                }
                assert!((map.slope[i] - line.slope).abs() <= 1e-9 * line.slope.abs().max(1e-3));
                assert!((map.chi2[i] - line.chi2).abs() <= 1e-8 * line.chi2.max(1.0));
                compared += 1;
            }
            assert!(compared > 230);
        }
    }

    /// In f32 temperatures move by less than a hundredth of their standard deviation, and flags stay.
    #[test]
    fn single_precision_is_good_for_looking() {
        let (sums, inputs) = (sums(4), inputs(Estimator::Default));
        let map = solve(&sums, &inputs);
        let mut live = DitMap::<f32>::empty();
        super::super::solve_into(&sums, &inputs, &mut live);
        for i in 0..map.flags.len() {
            if map.temperature_k[i].is_finite() && map.emissivity[i] > 0.1 {
                let off = (f64::from(live.temperature_k[i]) - map.temperature_k[i]).abs();
                assert!(off < 0.01 * map.sigma_temperature_k[i] && off < 0.005, "{i}: {off}");
                assert_eq!(live.flags[i], map.flags[i]);
            }
        }
    }
}
