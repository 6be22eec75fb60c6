//! Fits an image: bands of rows on all threads, vectors of pixels within a row.

use super::kernel::{self, ALONE, Constants, GAIN, Group, Level, Scratch};
use super::lanes::{Lanes, Machine, Number, WIDEST};
use super::residuals::Residuals;
use super::rows::{Row, Walk};
use super::single::{Detail, Pixel, Prospect};
use super::thermometer::Thermometer;
use super::{CHANNELS, DitMap, Estimator, FitInputs, LEVELS_MAX, flag};
use crate::estimate::accumulate::Sums;
use crate::estimate::line::{self, Line};
use crate::estimate::student::Quantiles;
use pulp::Simd;
use rayon::prelude::*;
use std::ops::Range;

/// Bands per thread: enough that one slow thread does not hold up the rest; each costs four rows of statistics more.
const BANDS_PER_THREAD: usize = 2;

/// Pixels that take part in the estimate of the highest gain.
const GAINS_MAX: usize = 16_384;

/// What is the same for all pixels of a fit.
struct Common<'a> {
    sums: &'a Sums,
    inputs: &'a FitInputs<'a>,
    /// Levels that have an x.
    used: Vec<usize>,
    constants: Constants,
    residuals: Residuals,
}

impl<'a> Common<'a> {
    fn new(sums: &'a Sums, inputs: &'a FitInputs<'a>) -> Self {
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
    fn pools(&self) -> bool {
        self.inputs.estimator == Estimator::Default
    }
}

/// Rows of a map and where their answers go, channel by channel.
struct Band<'a, F> {
    rows: Range<usize>,
    planes: Vec<&'a mut [F]>,
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
    let mut tasks: Vec<Band<'_, F>> = flags
        .chunks_mut(height * columns)
        .enumerate()
        .map(|(band, flags)| Band {
            rows: band * height..band * height + flags.len() / columns,
            planes: Vec::with_capacity(CHANNELS.len()),
            flags,
        })
        .collect();
    for plane in planes {
        for (task, values) in tasks.iter_mut().zip(plane.chunks_mut(height * columns)) {
            task.planes.push(values);
        }
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
fn fit_rows<S: Simd, F: Machine<S>>(simd: S, common: &Common<'_>, mut band: Band<'_, F>) {
    let stride = common.sums.columns().next_multiple_of(WIDEST);
    let mut writer = Writer {
        channels: std::array::from_fn(|_| vec![F::of(0.0); stride]),
        flags: vec![F::of(0.0); stride],
        asked: vec![F::of(0.0); stride],
        bits: vec![0; common.sums.columns()],
        pixel: Pixel::default(),
    };
    let mut scratch = Scratch::default();
    let thermometer = Thermometer::new(common.inputs);
    let mut walk = Walk::new(common.sums, common.inputs, &common.used);
    let first = band.rows.start;
    walk.start(band.rows.clone(), common.pools());
    while let Some(row) = walk.row() {
        writer.fit(simd, common, &row, &mut scratch);
        writer.alone(common, &row);
        writer.read(&thermometer);
        let to = (row.row - first) * row.columns..(row.row - first + 1) * row.columns;
        for (plane, values) in band.planes.iter_mut().zip(&writer.channels) {
            plane[to.clone()].copy_from_slice(&values[..row.columns]);
        }
        band.flags[to].copy_from_slice(&writer.bits);
    }
}

/// Answers of a row.
struct Writer<F> {
    channels: [Vec<F>; CHANNELS.len()],
    flags: Vec<F>,
    asked: Vec<F>,
    bits: Vec<u32>,
    pixel: Pixel,
}

impl<F: Number> Writer<F> {
    #[inline(always)]
    fn fit<S: Simd>(
        &mut self,
        simd: S,
        common: &Common<'_>,
        row: &Row<'_, F>,
        scratch: &mut Scratch<<F as Machine<S>>::Lanes>,
    ) where
        F: Machine<S>,
    {
        let each = row.stride / F::WIDTH;
        let one = F::read(simd, row.flat, 0).all(0.0);
        scratch.prepare(common.used.len(), one);
        for vector in 0..row.columns.div_ceil(F::WIDTH) {
            for (k, level) in scratch.levels.iter_mut().enumerate() {
                let at = k * each + vector;
                *level = Level {
                    count: F::read(simd, row.count, at),
                    mean: F::read(simd, row.mean, at),
                    own: F::read(simd, row.own, at),
                    blank: F::read(simd, row.blank, at),
                    pooled: F::read(simd, row.pooled, at),
                };
            }
            let group = Group {
                flat: F::read(simd, row.flat, vector),
                flags: F::read(simd, row.flags, vector),
                alive: F::read(simd, row.alive, vector),
                singles: row.singles,
            };
            let answer = kernel::fit(one, &common.constants, common.inputs.estimator, &group, scratch);
            for (channel, value) in self.channels.iter_mut().zip(answer.channels) {
                F::write(channel, vector, value);
            }
            F::write(&mut self.flags, vector, answer.flags);
            F::write(&mut self.asked, vector, answer.asked);
        }
        for (bits, &flags) in self.bits.iter_mut().zip(&self.flags) {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "sums of bits below 2^24"
            )]
            let exact = flags.wide() as u32;
            *bits = exact;
        }
    }

    /// Pixels that were marked, one by one.
    fn alone(&mut self, common: &Common<'_>, row: &Row<'_, F>) {
        for i in 0..row.columns {
            if self.bits[i] & ALONE == 0 {
                continue;
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "sums of bits below 2^24"
            )]
            let before = row.flags[i].wide() as u32;
            self.bits[i] = before;
            let residuals = common.residuals.at(row.row * row.columns + i);
            self.pixel.gather(row, i, common.inputs, &common.constants, residuals);
            let Some(answer) = self.pixel.fit(&common.constants) else {
                self.bits[i] |= flag::TOO_FEW_LEVELS;
                self.channels[..GAIN].iter_mut().for_each(|channel| channel[i] = F::NAN);
                self.asked[i] = F::of(0.0);
                continue;
            };
            for (channel, value) in self.channels[..GAIN].iter_mut().zip(&answer.channels) {
                channel[i] = F::of(value.1);
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "sums of bits below 2^24"
            )]
            let flags = answer.flags.1 as u32;
            self.bits[i] |= flags;
            self.asked[i] = F::of(answer.asked.1);
        }
    }

    #[inline(always)]
    fn read(&mut self, thermometer: &Thermometer<'_, F>) {
        let [_, _, _, _, temperature, _, sigma, _, _, _, low, high, noise, _, _] = &mut self.channels;
        thermometer.read_flagged(temperature, [sigma, noise], &self.asked, &mut self.bits);
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

/// How the pixel at `row` and `column` is fitted; None where it has no line.
///
/// Panics when there is no such pixel, which is the caller's mistake.
pub fn detail(sums: &Sums, inputs: &FitInputs<'_>, row: usize, column: usize) -> Option<Detail> {
    assert!(row < sums.rows() && column < sums.columns(), "a pixel of the sums");
    let common = Common::new(sums, inputs);
    let mut pixel = Pixel::default();
    let mut walk = Walk::<f64>::new(sums, inputs, &common.used);
    walk.start(row..row + 1, common.pools());
    let at = walk.row()?;
    let residuals = common.residuals.at(row * sums.columns() + column);
    pixel.gather(&at, column, inputs, &common.constants, residuals);
    pixel.detail(inputs.estimator, &common.used)
}

/// What is known of the pixels whose emissivity is above `emissivity_min`, for forecasts: at most `pixels_max` of
/// them, evenly taken, by our own estimator.
pub fn prospects(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    emissivity_min: f64,
    pixels_max: usize,
) -> Vec<Prospect> {
    let inputs = &FitInputs { estimator: Estimator::Default, ..inputs.clone() };
    let common = Common::new(sums, inputs);
    if sums.columns() == 0 || pixels_max == 0 {
        return Vec::new();
    }
    let mut pixel = Pixel::default();
    let mut found = Vec::new();
    let mut walk = Walk::<f64>::new(sums, inputs, &common.used);
    walk.start(0..sums.rows(), true);
    while let Some(row) = walk.row() {
        for column in 0..row.columns {
            // A first look by the unweighted line: most pixels see no spray.
            let i = row.row * row.columns + column;
            pixel.gather(&row, column, inputs, &common.constants, common.residuals.at(i));
            if row.alive[column] > 0.0
                && let Some(slope) = pixel.unweighted_slope()
                && -slope > emissivity_min * inputs.gamma_near
            {
                found.push(pixel.prospect(inputs));
            }
        }
    }
    let step = found.len().div_ceil(pixels_max).max(1);
    found.into_iter().step_by(step).flatten().collect()
}

/// Fits other values at other abscissae with the weights that [`super::solve`] gives the measured ones.
///
/// `x` and `y` belong to the levels of `sums` (all of them; a level without an x in `inputs` is left out), `y` is
/// `[level][pixel]`. This is how a simulated world's expected counts are read: same weights, no noise. `None` for a
/// pixel without a line.
pub fn lines_with_same_weights(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    x: &[f64],
    y: &[Vec<f64>],
) -> Vec<Option<Line>> {
    let levels = sums.levels().len();
    assert!(x.len() == levels && y.len() == levels, "one x and one image per level");
    by_pixel(sums, inputs, |used, pixel, i| {
        pixel.weights(inputs.estimator).and_then(|weights| {
            let x: Vec<f64> = pixel.levels.iter().map(|&k| x[used[k]]).collect();
            let y: Vec<f64> = pixel.levels.iter().map(|&k| y[used[k]][i]).collect();
            line::weighted(&x, &y, &weights)
        })
    })
}

/// How much of a level's error in x goes over into a pixel's crossing: dS/dx_k, `[pixel · levels + level]`, adding up to
/// one. NaN for a pixel without a line, 0 for a level that is not there.
pub fn crossing_shares(sums: &Sums, inputs: &FitInputs<'_>) -> Vec<f64> {
    let levels = sums.levels().len();
    let shares = by_pixel(sums, inputs, |used, pixel, _| {
        let mut all = vec![f64::NAN; levels];
        if let Some(shares) = pixel.crossing_shares(inputs.estimator) {
            all.fill(0.0);
            pixel.levels.iter().zip(shares).for_each(|(&k, share)| all[used[k]] = share);
        }
        all
    });
    shares.concat()
}

/// What `of` makes of every pixel, on all threads; it is told which levels have an x, the pixel's own and its place.
fn by_pixel<T: Send>(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    of: impl Fn(&[usize], &mut Pixel, usize) -> T + Sync,
) -> Vec<T> {
    let common = Common::new(sums, inputs);
    if sums.columns() == 0 {
        return Vec::new();
    }
    let bands = rayon::current_num_threads() * BANDS_PER_THREAD;
    let height = sums.rows().div_ceil(bands).max(1);
    let starts: Vec<usize> = (0..sums.rows()).step_by(height).collect();
    let bands: Vec<Vec<T>> = starts
        .into_par_iter()
        .map(|start| {
            let rows = start..(start + height).min(sums.rows());
            let mut pixel = Pixel::default();
            let mut found = Vec::with_capacity(rows.len() * sums.columns());
            let mut walk = Walk::<f64>::new(sums, inputs, &common.used);
            walk.start(rows, common.pools());
            while let Some(row) = walk.row() {
                for column in 0..row.columns {
                    let i = row.row * row.columns + column;
                    pixel.gather(&row, column, inputs, &common.constants, common.residuals.at(i));
                    found.push(of(&common.used, &mut pixel, i));
                }
            }
            found
        })
        .collect();
    bands.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::SakumaHattori;
    use crate::estimate::map::{CONFIDENCE, CameraNoise, solve};

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
                let planes = planes.into_iter().map(Vec::as_mut_slice).collect();
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
                    (0..level.sum.len())
                        .map(|i| crate::estimate::accumulate::mean(level.sum[i], level.count[i], 1))
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
