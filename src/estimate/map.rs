//! From exact sums to the map: emissivity, effective temperature, their uncertainty and flags, per pixel.
//!
//! Spray minus blank is a line in x = γ_far·I_cal(T_plate): slope −γ_near·ε, zero at the crossing S, and the
//! effective temperature follows from I_cal(T_eff) = ε_B·(S + E_f). T_eff is the emissivity-weighted,
//! intensity-averaged temperature of the shots. A pixel without an answer has a flag and NaN, never a guess and never
//! an error. Bits are the same for any number of threads and on any machine of one architecture: no fused
//! operations, logarithms from `libm`.
//!
//! Knows nothing of files, frames or instruments.

use super::accumulate::{self, Sums};
use super::calibration::{Range, Reach, SakumaHattori};
use super::law;
use super::line::{self, Covariance, Fieller, Line};
use super::student::{NORMAL_95, Quantiles};
use rayon::prelude::*;

/// Most levels of a map.
pub const LEVELS_MAX: usize = 256;

/// How the lines are weighted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// Ours: weights from a variance law fitted to pooled variances, sandwich covariance, Student's t.
    Default,
    /// The paper's: weight n/max(s², 1/12) with each level's own variance, normal quantiles; pixels with a level of
    /// one cycle take the unweighted line.
    Paper,
    /// All levels alike, variance from the scatter about the line.
    Ols,
}

impl Estimator {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Paper => "paper",
            Self::Ols => "ols",
        }
    }
}

/// The camera's own noise.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraNoise {
    /// Standard deviation of a dark sample, in counts, without rounding.
    pub read_noise_counts: f64,
    /// Electrons per count; infinite for no shot noise.
    pub electrons_per_count: f64,
    /// Counts that hold no electrons.
    pub zero_counts: f64,
}

impl CameraNoise {
    /// A camera of which nothing is known: rounding only.
    pub const ROUNDING_ONLY: Self =
        Self { read_noise_counts: 0.0, electrons_per_count: f64::INFINITY, zero_counts: 0.0 };

    /// Variance, in counts², of spray − mean of `blanks` blanks at the given mean counts.
    pub fn variance(&self, spray_counts: f64, blank_counts: f64, blanks: f64) -> f64 {
        let fixed = self.read_noise_counts * self.read_noise_counts + line::ROUNDING_VARIANCE;
        let shot = |counts: f64| (counts - self.zero_counts).max(0.0) / self.electrons_per_count;
        fixed + shot(spray_counts) + (fixed + shot(blank_counts)) / blanks
    }
}

/// What the fit has to know besides the counts.
#[derive(Debug, Clone, PartialEq)]
pub struct FitInputs<'a> {
    /// x = γ_far·I_cal(T_plate) per level, in counts, with the mean plate reading of the accepted shots; a level
    /// without x is left out.
    pub x_counts: Vec<Option<f64>>,
    /// Transmittance of the window on the camera's side.
    pub gamma_near: f64,
    /// Transmittance of the window on the plate's side; used for the gain only, x holds it already.
    pub gamma_far: f64,
    /// Emissivity of the plate, ε_B.
    pub emissivity_plate: f64,
    /// E_f: the far window's own light and what it mirrors, in counts of the crossing's scale. Zero as in the paper.
    pub far_window_counts: f64,
    /// I_cal of a black body without offset.
    pub curve: SakumaHattori,
    /// Where the curve is calibrated; None trusts it everywhere.
    pub range: Option<Range>,
    /// The camera's own noise.
    pub camera: CameraNoise,
    /// How the lines are weighted.
    pub estimator: Estimator,
    /// Confidence of the low/high channels, 0.95 for archived maps.
    pub confidence: f64,
    /// Gain of each pixel against the calibrated one, `[rows · columns]`: counts are divided by it. x stays nominal.
    pub flat_gain: Option<&'a [f64]>,
}

/// Bits of the `flags` channel.
pub mod flag {
    /// Fewer than two levels left, or all at one x: no line.
    pub const TOO_FEW_LEVELS: u32 = 1;
    /// At least one cycle was left out because a sample was saturated.
    pub const SATURATED: u32 = 1 << 1;
    /// The pixel never changes, neither with shots nor with the plate.
    pub const DEAD: u32 = 1 << 2;
    /// Spray minus blank is the same in every cycle of every level. Few quiet cycles can do that by chance where there
    /// is no spray, so it says something only together with others.
    pub const CONSTANT: u32 = 1 << 3;
    /// The pixel does not see the plate: its blanks do not follow it.
    pub const NO_PLATE: u32 = 1 << 4;
    /// Fieller's set of the crossing is unbounded: the slope is not significant. `default` gives no temperature.
    pub const NOT_RESOLVED: u32 = 1 << 5;
    /// The emissivity is negative. `default` gives no temperature.
    pub const NEGATIVE_EMISSIVITY: u32 = 1 << 6;
    /// The crossing stands for no light, or less than none: no temperature.
    pub const NO_RADIANCE: u32 = 1 << 7;
    /// The temperature is outside the calibrated range by at most 10 % of it in 1/T.
    pub const EXTRAPOLATED: u32 = 1 << 8;
    /// The temperature would be further outside: NaN.
    pub const OUT_OF_RANGE: u32 = 1 << 9;
    /// The paper's weights were not possible (a level with one cycle): unweighted line.
    pub const FELL_BACK_TO_OLS: u32 = 1 << 10;
    /// Too little data for a statistical uncertainty: sigmas are NaN (`ols`) or the camera's noise only (`default`).
    pub const NO_STATISTICS: u32 = 1 << 11;

    /// Every flag with its name and meaning, in order of bits.
    pub const LEGEND: [(u32, &str, &str); 12] = [
        (TOO_FEW_LEVELS, "TOO_FEW_LEVELS", "fewer than two levels left, no line"),
        (SATURATED, "SATURATED", "cycles left out because of saturated samples"),
        (DEAD, "DEAD", "pixel never changes"),
        (CONSTANT, "CONSTANT", "spray minus blank is the same in every cycle"),
        (NO_PLATE, "NO_PLATE", "pixel does not see the plate"),
        (NOT_RESOLVED, "NOT_RESOLVED", "slope not significant, set of temperatures unbounded"),
        (NEGATIVE_EMISSIVITY, "NEGATIVE_EMISSIVITY", "emissivity below zero"),
        (NO_RADIANCE, "NO_RADIANCE", "crossing without light"),
        (EXTRAPOLATED, "EXTRAPOLATED", "temperature up to 10 % outside the calibrated range in 1/T"),
        (OUT_OF_RANGE, "OUT_OF_RANGE", "temperature further outside, NaN"),
        (FELL_BACK_TO_OLS, "FELL_BACK_TO_OLS", "a level with one cycle, unweighted line"),
        (NO_STATISTICS, "NO_STATISTICS", "no statistical uncertainty"),
    ];
}

/// Names and units of the f64 channels, in the order of [`DitMap::channels`].
pub const CHANNELS: [(&str, &str); 14] = [
    ("slope", "1"),
    ("offset", "counts"),
    ("crossing", "counts"),
    ("emissivity", "1"),
    ("temperature_k", "K"),
    ("sigma_emissivity", "1"),
    ("sigma_temperature_k", "K"),
    ("chi2", "1"),
    ("emissivity_low", "1"),
    ("emissivity_high", "1"),
    ("temperature_low_k", "K"),
    ("temperature_high_k", "K"),
    ("gain", "1"),
    ("sigma_gain", "1"),
];

/// A map; every channel is `[rows · columns]` in row order, row 0 at the top, NaN = no answer (see the flags).
#[derive(Debug, Clone, PartialEq)]
pub struct DitMap {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Levels, with or without x.
    pub levels: usize,
    /// How it was fitted.
    pub estimator: Estimator,
    /// Confidence of the low/high channels.
    pub confidence: f64,
    /// Slope of spray − blank against x: −γ_near·ε.
    pub slope: Vec<f64>,
    /// Value of the line at x = 0, in counts.
    pub offset: Vec<f64>,
    /// x where the line is zero, in counts.
    pub crossing: Vec<f64>,
    /// ε = −slope/γ_near. May be outside 0 … 1 by its uncertainty.
    pub emissivity: Vec<f64>,
    /// Effective temperature, in K.
    pub temperature_k: Vec<f64>,
    /// Standard deviation of the emissivity.
    pub sigma_emissivity: Vec<f64>,
    /// Standard deviation of the temperature by linear propagation, in K.
    pub sigma_temperature_k: Vec<f64>,
    /// Weighted squares of the line's residuals: large for scattering, drift or a wrong plate temperature.
    pub chi2: Vec<f64>,
    /// Lower end of the emissivity's interval.
    pub emissivity_low: Vec<f64>,
    /// Upper end.
    pub emissivity_high: Vec<f64>,
    /// Lower end of Fieller's set of temperatures, in K; NaN if unbounded or outside the calibration.
    pub temperature_low_k: Vec<f64>,
    /// Upper end, in K.
    pub temperature_high_k: Vec<f64>,
    /// Slope of the blanks against I_cal: γ_far·γ_near·gain of the pixel. An alarm for fouled windows.
    pub gain: Vec<f64>,
    /// Standard deviation of `gain` from the scatter about its line; NaN for two levels.
    pub sigma_gain: Vec<f64>,
    /// Cycles that count, `[levels · rows · columns]`.
    pub count: Vec<u32>,
    /// Bits of [`flag`].
    pub flags: Vec<u32>,
}

impl DitMap {
    /// The f64 channels in the order of [`CHANNELS`].
    pub fn channels(&self) -> [&[f64]; CHANNELS.len()] {
        [
            &self.slope,
            &self.offset,
            &self.crossing,
            &self.emissivity,
            &self.temperature_k,
            &self.sigma_emissivity,
            &self.sigma_temperature_k,
            &self.chi2,
            &self.emissivity_low,
            &self.emissivity_high,
            &self.temperature_low_k,
            &self.temperature_high_k,
            &self.gain,
            &self.sigma_gain,
        ]
    }

    /// How many pixels carry each flag, in the order of [`flag::LEGEND`].
    pub fn flag_counts(&self) -> Vec<(&'static str, usize)> {
        flag::LEGEND
            .iter()
            .map(|&(bit, name, _)| (name, self.flags.iter().filter(|&&f| f & bit != 0).count()))
            .collect()
    }
}

/// Fits every pixel.
///
/// Panics when the inputs do not fit the sums (number of levels, size of the flat), which is the caller's mistake.
pub fn solve(sums: &Sums, inputs: &FitInputs<'_>) -> DitMap {
    let pixels = sums.rows() * sums.columns();
    let levels = sums.levels().len();
    assert!(inputs.x_counts.len() == levels, "one x per level");
    assert!(levels <= LEVELS_MAX, "at most 256 levels");
    assert!(inputs.flat_gain.is_none_or(|flat| flat.len() == pixels), "one gain per pixel");
    let statistics = Statistics::of(sums, inputs);
    let pools = match inputs.estimator {
        Estimator::Default => Pools::of(&statistics, sums.rows(), sums.columns()),
        Estimator::Paper | Estimator::Ols => Pools::default(),
    };
    let gains = gains(&statistics, inputs);
    let plate = plate_gain_limit(&gains);
    let quantiles = Quantiles::new(inputs.confidence);
    let solver = Solver {
        inputs,
        statistics: &statistics,
        pools: &pools,
        gains: &gains,
        plate,
        quantiles: &quantiles,
    };
    // Zeroed, not NaN: such memory is only touched by the threads that fill it. Every value is written.
    let mut planes: [Vec<f64>; CHANNELS.len()] = std::array::from_fn(|_| vec![0.0; pixels]);
    let mut flags = vec![0_u32; pixels];
    let columns = sums.columns().max(1);
    by_row(&mut planes, &mut flags, columns).into_par_iter().enumerate().for_each(|(row, mut out)| {
        let mut pixel = Pixel::default();
        for column in 0..out.flags.len() {
            let (values, flags) = solver.pixel(row * columns + column, &mut pixel);
            for (plane, value) in out.planes.iter_mut().zip(values) {
                plane[column] = value;
            }
            out.flags[column] = flags;
        }
    });
    let [
        slope,
        offset,
        crossing,
        emissivity,
        temperature_k,
        sigma_emissivity,
        sigma_temperature_k,
        chi2,
        emissivity_low,
        emissivity_high,
        temperature_low_k,
        temperature_high_k,
        gain,
        sigma_gain,
    ] = planes;
    DitMap {
        rows: sums.rows(),
        columns: sums.columns(),
        levels,
        estimator: inputs.estimator,
        confidence: inputs.confidence,
        slope,
        offset,
        crossing,
        emissivity,
        temperature_k,
        sigma_emissivity,
        sigma_temperature_k,
        chi2,
        emissivity_low,
        emissivity_high,
        temperature_low_k,
        temperature_high_k,
        gain,
        sigma_gain,
        count: sums.levels().iter().map(|level| level.count.as_slice()).collect::<Vec<_>>().concat(),
        flags,
    }
}

/// Fits other values at other abscissae with the weights that [`solve`] gives the measured ones.
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
    let statistics = Statistics::of(sums, inputs);
    let pools = match inputs.estimator {
        Estimator::Default => Pools::of(&statistics, sums.rows(), sums.columns()),
        Estimator::Paper | Estimator::Ols => Pools::default(),
    };
    let quantiles = Quantiles::new(inputs.confidence);
    let solver = Solver {
        inputs,
        statistics: &statistics,
        pools: &pools,
        gains: &[],
        plate: None,
        quantiles: &quantiles,
    };
    let used: Vec<usize> = (0..levels).filter(|&k| inputs.x_counts[k].is_some_and(f64::is_finite)).collect();
    (0..sums.rows() * sums.columns())
        .into_par_iter()
        .map_init(Pixel::default, |pixel, i| {
            solver.gather(i, pixel);
            let weights = solver.weights(pixel)?;
            let present = used
                .iter()
                .zip(&statistics.levels)
                .filter(|(_, level)| level.count[i] > 0.0 && level.mean[i].is_finite());
            let (mut others_x, mut others_y) = (Vec::with_capacity(levels), Vec::with_capacity(levels));
            for (&k, _) in present {
                others_x.push(x[k]);
                others_y.push(y[k][i]);
            }
            line::weighted(&others_x, &others_y, &weights)
        })
        .collect()
}

struct RowOut<'a> {
    planes: Vec<&'a mut [f64]>,
    flags: &'a mut [u32],
}

fn by_row<'a>(
    planes: &'a mut [Vec<f64>; CHANNELS.len()],
    flags: &'a mut [u32],
    columns: usize,
) -> Vec<RowOut<'a>> {
    let mut rows: Vec<RowOut<'a>> = flags
        .chunks_mut(columns)
        .map(|flags| RowOut { planes: Vec::with_capacity(CHANNELS.len()), flags })
        .collect();
    for plane in planes {
        for (row, values) in rows.iter_mut().zip(plane.chunks_mut(columns)) {
            row.planes.push(values);
        }
    }
    rows
}

/// Means and variances of the levels that have an x.
struct Statistics {
    x: Vec<f64>,
    levels: Vec<LevelStatistics>,
    /// Per pixel: flags that need all levels.
    flags: Vec<u32>,
    blanks: f64,
}

/// Per pixel; NaN without a cycle (variance: without two).
struct LevelStatistics {
    mean: Vec<f64>,
    variance: Vec<f64>,
    blank: Vec<f64>,
    count: Vec<f64>,
}

impl Statistics {
    fn of(sums: &Sums, inputs: &FitInputs<'_>) -> Self {
        let b = sums.blanks_per_cycle();
        let gain = |pixel: usize| inputs.flat_gain.map_or(1.0, |flat| flat[pixel]);
        let used: Vec<usize> =
            (0..sums.levels().len()).filter(|&k| inputs.x_counts[k].is_some_and(f64::is_finite)).collect();
        let levels: Vec<LevelStatistics> = used
            .par_iter()
            .map(|&k| {
                let level = &sums.levels()[k];
                let pixels = 0..level.sum.len();
                let mean = pixels
                    .clone()
                    .map(|i| accumulate::mean(level.sum[i], level.count[i], b) / gain(i))
                    .collect();
                let variance = pixels
                    .clone()
                    .map(|i| {
                        let g = gain(i);
                        accumulate::variance(level.sum[i], level.sum_squares[i], level.count[i], b) / (g * g)
                    })
                    .collect();
                let blank = pixels
                    .map(|i| {
                        // Below 2⁵⁶; one rounding of a mean of counts does no harm.
                        #[expect(clippy::cast_precision_loss, reason = "a sum of counts")]
                        let sum = level.sum_blanks[i] as f64;
                        sum / (f64::from(level.count[i]) * f64::from(b)) / gain(i)
                    })
                    .collect();
                let count = level.count.iter().map(|&n| f64::from(n)).collect();
                LevelStatistics { mean, variance, blank, count }
            })
            .collect();
        let flags = (0..sums.rows() * sums.columns())
            .into_par_iter()
            .map(|i| {
                let lost = sums.levels().iter().any(|level| level.saturated(i) > 0);
                let saturated = if lost { flag::SATURATED } else { 0 };
                saturated | constancy(&levels, i)
            })
            .collect();
        let x = used.iter().filter_map(|&k| inputs.x_counts[k]).collect();
        Self { x, levels, flags, blanks: f64::from(b) }
    }
}

/// Flags of a pixel that does not change.
#[expect(clippy::float_cmp, reason = "equal integers have equal means")]
fn constancy(levels: &[LevelStatistics], pixel: usize) -> u32 {
    let mut seen = levels.iter().filter(|level| level.count[pixel] > 0.0);
    let Some(first) = seen.next() else { return 0 };
    // A level of one cycle has no variance and cannot contradict.
    let still = |level: &LevelStatistics| level.count[pixel] < 2.0 || level.variance[pixel] == 0.0;
    let (mut same, mut dark) = (still(first), true);
    let (mut levels, mut repeated) = (1, first.count[pixel] >= 2.0);
    for level in seen {
        same &= still(level) && level.mean[pixel] == first.mean[pixel];
        dark &= level.blank[pixel] == first.blank[pixel];
        repeated |= level.count[pixel] >= 2.0;
        levels += 1;
    }
    let constant = if same && repeated && levels >= 2 { flag::CONSTANT } else { 0 };
    let dead = if same && dark && levels >= 2 && (repeated || levels >= 3) { flag::DEAD } else { 0 };
    constant | dead
}

/// Statistics shared by neighbours, per level.
#[derive(Default)]
struct Pools {
    /// Sample variances over 5 × 5 pixels.
    variance: Vec<Vec<f64>>,
    /// Squared residuals of the unweighted line over 9 × 9 pixels, for maps with one cycle per level; else empty.
    residual_squares: Vec<Vec<f64>>,
}

impl Pools {
    fn of(statistics: &Statistics, rows: usize, columns: usize) -> Self {
        let usable = |i: usize| statistics.flags[i] & flag::DEAD == 0;
        let variance: Vec<Vec<f64>> = statistics
            .levels
            .iter()
            .map(|level| {
                let weight: Vec<f64> = level
                    .count
                    .iter()
                    .enumerate()
                    .map(|(i, &n)| if n >= 2.0 && usable(i) { n - 1.0 } else { 0.0 })
                    .collect();
                pool(&level.variance, &weight, rows, columns, 2)
            })
            .collect();
        let repeated = statistics.levels.iter().filter(|level| level.count.iter().any(|&n| n >= 2.0)).count();
        let points = statistics.x.len();
        if repeated >= 2 || points < 3 {
            return Self { variance, residual_squares: Vec::new() };
        }
        let mut squares = vec![vec![f64::NAN; rows * columns]; points];
        let mut weight = vec![0.0; rows * columns];
        let ones = vec![1.0; points];
        let mut y = vec![0.0; points];
        for i in (0..rows * columns).filter(|&i| usable(i)) {
            for (y, level) in y.iter_mut().zip(&statistics.levels) {
                *y = level.mean[i];
            }
            let Some(line) = line::weighted(&statistics.x, &y, &ones) else { continue };
            weight[i] = 1.0;
            for (k, (&x, &y)) in statistics.x.iter().zip(&y).enumerate() {
                let residual = (y - line.mean_y) - line.slope * (x - line.mean_x);
                squares[k][i] = residual * residual;
            }
        }
        let residual_squares = squares.iter().map(|level| pool(level, &weight, rows, columns, 4)).collect();
        Self { variance, residual_squares }
    }
}

/// Weighted mean over a window of (2·radius + 1)² pixels, cut at the edges; NaN where no weight is. Values of zero
/// weight are not read.
fn pool(values: &[f64], weights: &[f64], rows: usize, columns: usize, radius: usize) -> Vec<f64> {
    let mut out = vec![f64::NAN; rows * columns];
    out.par_chunks_mut(columns.max(1)).enumerate().for_each(|(row, out)| {
        let mut sums = vec![(0.0, 0.0); columns];
        for from in row.saturating_sub(radius)..(row + radius + 1).min(rows) {
            let line = from * columns..(from + 1) * columns;
            for ((sum, &value), &weight) in sums.iter_mut().zip(&values[line.clone()]).zip(&weights[line]) {
                sum.0 += if weight > 0.0 { weight * value } else { 0.0 };
                sum.1 += weight;
            }
        }
        for (column, out) in out.iter_mut().enumerate() {
            let window = column.saturating_sub(radius)..(column + radius + 1).min(columns);
            let (sum, weight) = sums[window].iter().fold((0.0, 0.0), |s, v| (s.0 + v.0, s.1 + v.1));
            if weight > 0.0 {
                *out = sum / weight;
            }
        }
    });
    out
}

/// Gain and its standard deviation of every pixel.
fn gains(statistics: &Statistics, inputs: &FitInputs<'_>) -> Vec<(f64, f64)> {
    (0..statistics.flags.len())
        .into_par_iter()
        .with_min_len(1024)
        .map_init(Pixel::default, |pixel, i| gain(statistics, inputs, i, pixel))
        .collect()
}

/// Gain below which a pixel does not see the plate: half of the 90th percentile of all pixels, if the blanks follow
/// the plate clearly at all. None when that cannot be told.
fn plate_gain_limit(gains: &[(f64, f64)]) -> Option<f64> {
    let mut finite: Vec<(f64, f64)> = gains.iter().copied().filter(|(gain, _)| gain.is_finite()).collect();
    if finite.is_empty() {
        return None;
    }
    let place = (finite.len() - 1) * 9 / 10;
    let order = |a: &(f64, f64), b: &(f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
    let (_, &mut (high, sigma), _) = finite.select_nth_unstable_by(place, order);
    // Six standard deviations of one pixel, so that noise alone masks none; NaN fails.
    (high > 6.0 * sigma).then_some(0.5 * high)
}

/// Slope of the blanks against I_cal and its standard deviation; NaN below three levels, where nothing tells drift
/// from gain (the slope itself needs two).
fn gain(statistics: &Statistics, inputs: &FitInputs<'_>, i: usize, pixel: &mut Pixel) -> (f64, f64) {
    pixel.clear();
    for (&x, level) in statistics.x.iter().zip(&statistics.levels) {
        if level.count[i] > 0.0 {
            pixel.x.push(x / inputs.gamma_far);
            pixel.y.push(level.blank[i]);
            pixel.weights.push(1.0);
        }
    }
    match line::weighted(&pixel.x, &pixel.y, &pixel.weights) {
        Some(line) => (line.slope, line.covariance_scaled(pixel.x.len()).slope.sqrt()),
        None => (f64::NAN, f64::NAN),
    }
}

/// Reusable memory for one pixel.
#[derive(Default)]
struct Pixel {
    x: Vec<f64>,
    y: Vec<f64>,
    count: Vec<f64>,
    own: Vec<f64>,
    pooled: Vec<f64>,
    camera: Vec<f64>,
    residual_squares: Vec<f64>,
    weights: Vec<f64>,
    scratch: law::Scratch,
}

impl Pixel {
    fn clear(&mut self) {
        for values in [
            &mut self.x,
            &mut self.y,
            &mut self.count,
            &mut self.own,
            &mut self.pooled,
            &mut self.camera,
            &mut self.residual_squares,
            &mut self.weights,
        ] {
            values.clear();
        }
    }
}

struct Solver<'a> {
    inputs: &'a FitInputs<'a>,
    statistics: &'a Statistics,
    pools: &'a Pools,
    gains: &'a [(f64, f64)],
    plate: Option<f64>,
    quantiles: &'a Quantiles,
}

/// A line with its uncertainty, from whichever estimator.
struct Fitted {
    line: Line,
    covariance: Covariance,
    slope_variance: f64,
    /// Quantiles for the crossing and the slope.
    t_crossing: f64,
    t_slope: f64,
    flags: u32,
}

impl Solver<'_> {
    fn pixel(&self, i: usize, pixel: &mut Pixel) -> ([f64; CHANNELS.len()], u32) {
        let mut values = [f64::NAN; CHANNELS.len()];
        let mut flags = self.statistics.flags[i];
        let (gain, sigma_gain) = self.gains[i];
        values[12] = gain;
        values[13] = sigma_gain;
        if self.plate.is_some_and(|limit| gain < limit) {
            flags |= flag::NO_PLATE;
        }
        self.gather(i, pixel);
        let fitted = match self.inputs.estimator {
            Estimator::Ols => self.ols(pixel),
            Estimator::Paper => self.paper(pixel),
            Estimator::Default => self.default(pixel),
        };
        let Some(fitted) = fitted else { return (values, flags | flag::TOO_FEW_LEVELS) };
        let unseen = flags & (flag::DEAD | flag::NO_PLATE) != 0;
        if unseen && self.inputs.estimator == Estimator::Default {
            return (values, flags);
        }
        flags |= fitted.flags;
        flags |= self.judge(&fitted, &mut values);
        (values, flags)
    }

    fn gather(&self, i: usize, pixel: &mut Pixel) {
        pixel.clear();
        let default = self.inputs.estimator == Estimator::Default;
        let flat = self.inputs.flat_gain.map_or(1.0, |flat| flat[i]);
        for (k, (&x, level)) in self.statistics.x.iter().zip(&self.statistics.levels).enumerate() {
            if !(level.count[i] > 0.0 && level.mean[i].is_finite()) {
                continue;
            }
            pixel.x.push(x);
            pixel.y.push(level.mean[i]);
            pixel.count.push(level.count[i]);
            pixel.own.push(level.variance[i]);
            if default {
                pixel.pooled.push(self.pools.variance[k][i]);
                let blank = level.blank[i] * flat;
                let spray = blank + level.mean[i] * flat;
                let camera = self.inputs.camera.variance(spray, blank, self.statistics.blanks);
                pixel.camera.push(camera / (flat * flat));
                if let Some(squares) = self.pools.residual_squares.get(k) {
                    pixel.residual_squares.push(squares[i]);
                }
            }
        }
        // Pooled residuals belong to the line through all levels.
        if pixel.x.len() != self.statistics.x.len() {
            pixel.residual_squares.clear();
        }
    }

    /// The weights that the estimator gives the gathered levels.
    fn weights(&self, pixel: &mut Pixel) -> Option<Vec<f64>> {
        match self.inputs.estimator {
            Estimator::Ols => self.ols(pixel).map(|_| pixel.weights.clone()),
            Estimator::Paper => self.paper(pixel).map(|_| pixel.weights.clone()),
            Estimator::Default => self.default(pixel).map(|_| pixel.scratch.weights().to_vec()),
        }
    }

    fn ols(&self, pixel: &mut Pixel) -> Option<Fitted> {
        pixel.weights.resize(pixel.x.len(), 1.0);
        let line = line::weighted(&pixel.x, &pixel.y, &pixel.weights)?;
        let points = pixel.x.len();
        #[expect(clippy::cast_precision_loss, reason = "a number of levels")]
        let t = self.quantiles.at((points - 2) as f64);
        let flags = if points == 2 { flag::NO_STATISTICS } else { 0 };
        let covariance = line.covariance_scaled(points);
        Some(Fitted { line, covariance, slope_variance: covariance.slope, t_crossing: t, t_slope: t, flags })
    }

    fn paper(&self, pixel: &mut Pixel) -> Option<Fitted> {
        if pixel.own.iter().any(|v| v.is_nan()) {
            let fitted = self.ols(pixel)?;
            return Some(Fitted { flags: fitted.flags | flag::FELL_BACK_TO_OLS, ..fitted });
        }
        let own = pixel.own.iter().zip(&pixel.count);
        pixel.weights.extend(own.map(|(&v, &n)| n / v.max(line::ROUNDING_VARIANCE)));
        let line = line::weighted(&pixel.x, &pixel.y, &pixel.weights)?;
        let t = self.quantiles.at(f64::INFINITY);
        let covariance = line.covariance();
        Some(Fitted {
            line,
            covariance,
            slope_variance: covariance.slope,
            t_crossing: t,
            t_slope: t,
            flags: 0,
        })
    }

    fn default(&self, pixel: &mut Pixel) -> Option<Fitted> {
        let samples = law::Samples {
            x: &pixel.x,
            y: &pixel.y,
            count: &pixel.count,
            own: &pixel.own,
            pooled: &pixel.pooled,
            camera: &pixel.camera,
            residual_squares: &pixel.residual_squares,
        };
        let fit = law::fit(&samples, &mut pixel.scratch)?;
        Some(Fitted {
            line: fit.line,
            covariance: fit.covariance,
            slope_variance: fit.slope_variance,
            t_crossing: self.quantiles.at(fit.freedom_crossing),
            t_slope: self.quantiles.at(fit.freedom_slope),
            flags: if fit.camera_only { flag::NO_STATISTICS } else { 0 },
        })
    }

    /// From the line to emissivity and temperature; returns flags.
    fn judge(&self, fitted: &Fitted, values: &mut [f64; CHANNELS.len()]) -> u32 {
        let Fitted { line, covariance, slope_variance, t_crossing, t_slope, .. } = fitted;
        let inputs = self.inputs;
        let default = inputs.estimator == Estimator::Default;
        let mut flags = 0;
        let emissivity = -line.slope / inputs.gamma_near;
        let sigma = slope_variance.sqrt() / inputs.gamma_near;
        values[0] = line.slope;
        values[1] = line.offset;
        values[2] = line.crossing;
        values[3] = emissivity;
        values[5] = sigma;
        values[7] = line.chi2;
        values[8] = emissivity - t_slope * sigma;
        values[9] = emissivity + t_slope * sigma;
        if emissivity < 0.0 {
            flags |= flag::NEGATIVE_EMISSIVITY;
        }
        let bounds = match line.fieller(covariance, *t_crossing) {
            Fieller::Bounded { low, high } => Some((low, high)),
            Fieller::Complement { .. } | Fieller::WholeLine => {
                if covariance.slope.is_finite() {
                    flags |= flag::NOT_RESOLVED;
                }
                None
            }
        };
        if default && flags & (flag::NOT_RESOLVED | flag::NEGATIVE_EMISSIVITY) != 0 {
            values[2] = f64::NAN;
            return flags;
        }
        let (temperature, reach) = self.temperature(line.crossing);
        flags |= reach;
        values[4] = temperature;
        let counts = inputs.emissivity_plate * (line.crossing + inputs.far_window_counts);
        values[6] = line.crossing_variance(covariance).sqrt()
            * inputs.emissivity_plate
            * inputs.curve.inverse_derivative(counts, temperature);
        if let Some((low, high)) = bounds {
            values[10] = self.temperature(low).0;
            values[11] = self.temperature(high).0;
        }
        flags
    }

    /// Temperature of a crossing, NaN outside the calibration, and the flags that say so.
    fn temperature(&self, crossing: f64) -> (f64, u32) {
        let counts = self.inputs.emissivity_plate * (crossing + self.inputs.far_window_counts);
        if !(counts > 0.0 && counts.is_finite()) {
            return (f64::NAN, flag::NO_RADIANCE);
        }
        let temperature = self.inputs.curve.inverse(counts);
        match self.inputs.range.map_or(Reach::Inside, |range| range.reach(temperature)) {
            Reach::Inside => (temperature, 0),
            Reach::Extrapolated => (temperature, flag::EXTRAPOLATED),
            Reach::Outside => (f64::NAN, flag::OUT_OF_RANGE),
        }
    }
}

/// One line of known variances, as `ditd fit LINES.json` prints it.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownLine {
    /// The line.
    pub line: Line,
    /// Its covariance.
    pub covariance: Covariance,
    /// ε = −slope/γ.
    pub emissivity: f64,
    /// Temperature of the crossing, in K; NaN for a crossing ≤ 0.
    pub temperature_k: f64,
}

/// Fits one line with known variances. None if the points do not define a line.
pub fn known_line(
    x: &[f64],
    y: &[f64],
    variance: &[f64],
    gamma: f64,
    emissivity_plate: f64,
    curve: &SakumaHattori,
) -> Option<KnownLine> {
    let weights: Vec<f64> = variance.iter().map(|v| 1.0 / v).collect();
    let line = line::weighted(x, y, &weights)?;
    Some(KnownLine {
        covariance: line.covariance(),
        emissivity: -line.slope / gamma,
        temperature_k: curve.inverse(emissivity_plate * line.crossing),
        line,
    })
}

/// The usual confidence of the archived channels.
pub const CONFIDENCE: f64 = 0.95;

/// Quantile that belongs to [`CONFIDENCE`] for known variances.
pub const T_KNOWN: f64 = NORMAL_95;

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of ten thousands, so that rounding is below 10 mK and noise-free levels test the equations.
    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e7, a_um: 3.4, b_um_k: 1.5 };
    const PLATES_K: [f64; 4] = [403.0, 433.0, 463.0, 533.0];
    const GAMMA_NEAR: f64 = 0.93;
    const GAMMA_FAR: f64 = 0.96;
    const EMISSIVITY_PLATE: f64 = 0.98;
    const FAR_WINDOW: f64 = 150.0;

    fn inputs(estimator: Estimator) -> FitInputs<'static> {
        FitInputs {
            x_counts: PLATES_K.iter().map(|&t| Some(GAMMA_FAR * CURVE.value(t))).collect(),
            gamma_near: GAMMA_NEAR,
            gamma_far: GAMMA_FAR,
            emissivity_plate: EMISSIVITY_PLATE,
            far_window_counts: FAR_WINDOW,
            curve: CURVE,
            range: None,
            camera: CameraNoise::ROUNDING_ONLY,
            estimator,
            confidence: CONFIDENCE,
            flat_gain: None,
        }
    }

    /// Sums of a row of pixels (emissivity, temperature, gain), two cycles of two blanks; the second cycle is one
    /// count brighter with spray. A gain of zero does not see the plate.
    fn sums(pixels: &[(f64, f64, f64)]) -> Sums {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
        let counts = |signal: f64| (1000.0 + signal).round() as u16;
        let mut sums = Sums::new(PLATES_K.len(), 1, pixels.len(), 2, 60_000).unwrap();
        for (level, &plate) in PLATES_K.iter().enumerate() {
            let x = GAMMA_FAR * CURVE.value(plate);
            let blank: Vec<u16> =
                pixels.iter().map(|p| counts(p.2 * GAMMA_NEAR * (x + FAR_WINDOW))).collect();
            for cycle in [0.0, 1.0] {
                let spray: Vec<u16> = pixels
                    .iter()
                    .map(|&(emissivity, temperature_k, gain)| {
                        let s = CURVE.value(temperature_k) / EMISSIVITY_PLATE - FAR_WINDOW;
                        let signal = x + FAR_WINDOW + emissivity * (s - x);
                        counts(gain * GAMMA_NEAR * signal + cycle)
                    })
                    .collect();
                sums.add_cycle(level, &[&blank, &blank], &spray).unwrap();
            }
        }
        sums
    }

    const ALL: [Estimator; 3] = [Estimator::Default, Estimator::Paper, Estimator::Ols];

    #[test]
    fn windows_plate_and_flat_follow_the_equations() {
        let flat = [1.0, 0.8, 1.0];
        let sums = sums(&[(0.7, 449.0, 1.0), (0.7, 449.0, 0.8), (0.3, 480.0, 1.0)]);
        for estimator in ALL {
            let map = solve(&sums, &FitInputs { flat_gain: Some(&flat), ..inputs(estimator) });
            for (i, (emissivity, temperature)) in
                [(0.7, 449.0), (0.7, 449.0), (0.3, 480.0)].into_iter().enumerate()
            {
                assert!((map.emissivity[i] - emissivity).abs() < 2e-4, "{estimator:?} {}", map.emissivity[i]);
                assert!((map.temperature_k[i] - temperature).abs() < 0.1, "{}", map.temperature_k[i]);
                assert!((map.gain[i] - GAMMA_NEAR * GAMMA_FAR).abs() < 1e-3, "{}", map.gain[i]);
                assert_eq!(map.flags[i], 0);
            }
        }
    }

    #[test]
    fn pixels_beside_the_plate_are_masked() {
        let sums = sums(&[(0.7, 449.0, 1.0), (0.5, 449.0, 1.0), (0.6, 449.0, 0.0)]);
        let map = solve(&sums, &inputs(Estimator::Default));
        assert_eq!(map.flags[0] & flag::NO_PLATE, 0);
        assert_ne!(map.flags[2] & flag::NO_PLATE, 0);
        assert!(map.temperature_k[2].is_nan() && map.emissivity[2].is_nan());
    }

    #[test]
    fn temperatures_outside_the_calibration_are_marked() {
        let sums = sums(&[(0.7, 449.0, 1.0), (0.7, 538.0, 1.0), (0.7, 600.0, 1.0)]);
        let range = Some(Range { low_k: 403.0, high_k: 533.0 });
        for estimator in ALL {
            let map = solve(&sums, &FitInputs { range, ..inputs(estimator) });
            assert_eq!(map.flags[0], 0);
            assert_eq!(map.flags[1], flag::EXTRAPOLATED);
            assert!(map.temperature_k[1].is_finite());
            assert_eq!(map.flags[2], flag::OUT_OF_RANGE);
            assert!(map.temperature_k[2].is_nan() && map.sigma_temperature_k[2].is_nan());
        }
    }

    #[test]
    fn levels_without_x_are_left_out() {
        let sums = sums(&[(0.7, 449.0, 1.0)]);
        for estimator in ALL {
            let mut few = inputs(estimator);
            few.x_counts[1] = None;
            let map = solve(&sums, &few);
            assert!((map.temperature_k[0] - 449.0).abs() < 0.1);
            assert_eq!(map.count, [2, 2, 2, 2]);
            few.x_counts = vec![None, few.x_counts[2], Some(f64::NAN), None];
            let none = solve(&sums, &few);
            assert_eq!(none.flags[0] & flag::TOO_FEW_LEVELS, flag::TOO_FEW_LEVELS);
            assert!(none.channels()[..12].iter().all(|channel| channel[0].is_nan()));
        }
    }

    /// Dead, saturated, empty and one-pixel maps: flags and NaN, whichever the estimator.
    #[test]
    fn nasty_sums_give_flags() {
        for estimator in ALL {
            let empty = Sums::new(4, 2, 3, 2, 60_000).unwrap();
            let map = solve(&empty, &inputs(estimator));
            assert!(map.flags.iter().all(|f| f & flag::TOO_FEW_LEVELS != 0));
            let mut dead = Sums::new(4, 1, 2, 2, 60_000).unwrap();
            for level in 0..4 {
                for _ in 0..2 {
                    dead.add_cycle(level, &[&[0, 60_000], &[0, 60_000]], &[0, 60_000]).unwrap();
                }
            }
            let map = solve(&dead, &inputs(estimator));
            assert_ne!(map.flags[0] & flag::DEAD, 0);
            assert_ne!(map.flags[1] & flag::SATURATED, 0);
            assert!(map.temperature_k.iter().all(|t| t.is_nan()));
            let none = Sums::new(4, 0, 0, 2, 60_000).unwrap();
            assert!(solve(&none, &inputs(estimator)).flags.is_empty());
        }
    }

    #[test]
    fn neighbours_are_averaged_by_weight() {
        let values = [1.0, 2.0, 3.0, f64::NAN, 5.0, 6.0];
        let weights = [1.0, 1.0, 1.0, 0.0, 2.0, 1.0];
        let pooled = pool(&values, &weights, 2, 3, 1);
        assert!((pooled[0] - (1.0 + 2.0 + 10.0) / 4.0).abs() < 1e-15);
        assert!((pooled[5] - (2.0 + 3.0 + 10.0 + 6.0) / 5.0).abs() < 1e-15);
        assert!(pool(&[f64::NAN], &[0.0], 1, 1, 2)[0].is_nan());
    }
}
