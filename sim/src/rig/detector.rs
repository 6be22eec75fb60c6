//! From expected electrons to raw counts: photon noise, read noise, fixed pattern, drift, warm-up, clipping.
//!
//! count = round(gain_p · (electrons + noise) / electrons_per_count + offset_p(t) + warm-up), from 0 to 2^bits − 1.
//! Noise is keyed by (seed, exposure, pixel): a frame has the same bits for any number of threads. Knows nothing
//! of scenes.

use super::RigError;
use super::config::{DetectorConfig, DriftConfig};
use super::noise::{Purpose, QuantileTable, Stream};
use rayon::prelude::*;

/// Below this mean the arrivals of a pixel are drawn from Poisson's law itself; above it a normal number of the
/// same mean and variance is drawn together with the read noise. At the threshold the neglected skewness is
/// 64^-½ = 0.125 of the photon noise alone, and below 4e-6 of the sum with 600 electrons of read noise.
const FEW_ELECTRONS: f32 = 64.0;

/// Sines that make up a slow drift.
const DRIFT_WAVES: usize = 3;

/// The detector of one camera.
#[derive(Debug, Clone)]
pub struct Detector {
    config: DetectorConfig,
    seed: u64,
    columns: usize,
    /// Relative gain divided by electrons per count, and offset in counts: `[row, column]`.
    pattern: Vec<[f32; 2]>,
}

/// Which exposure of the rig this is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Ordinal over the life of the rig: the key of its noise.
    pub ordinal: u64,
    /// Time since the rig's start, in seconds.
    pub at_s: f64,
    /// Frames since the last pause: 0 for the first one after it.
    pub since_pause: u32,
}

impl Detector {
    /// A detector of `rows` × `columns` pixels; `seed` chooses its fixed pattern and all its noise.
    ///
    /// # Errors
    /// [`RigError::Config`] for impossible numbers.
    pub fn new(config: DetectorConfig, seed: u64, rows: usize, columns: usize) -> Result<Self, RigError> {
        config.validate()?;
        let gain = Stream::new(seed, Purpose::Gain, 0);
        let offset = Stream::new(seed, Purpose::Offset, 0);
        let pattern = (0..(rows * columns) as u64)
            .map(|p| {
                let relative = 1.0 + config.gain_spread * gain.gaussian(p);
                let counts = config.offset_counts + config.offset_spread_counts * offset.gaussian(p);
                [single(relative / config.electrons_per_count), single(counts)]
            })
            .collect();
        Ok(Self { config, seed, columns, pattern })
    }

    /// Its numbers.
    pub fn config(&self) -> &DetectorConfig {
        &self.config
    }

    /// Raw counts of one exposure with the given expected electrons, both `[row, column]`.
    ///
    /// # Panics
    /// When the image has another size than the detector.
    pub fn read(&self, exposure: Exposure, electrons: &[f32]) -> Vec<u16> {
        assert_eq!(electrons.len(), self.pattern.len(), "one expectation per pixel");
        let rows = self.pattern.len() / self.columns;
        let offset = self.offset_of(exposure, rows);
        let mut counts = vec![0_u16; electrons.len()];
        counts.par_chunks_mut(self.columns).enumerate().with_min_len(16).for_each(|(row, out)| {
            self.read_row(exposure.ordinal, row, offset, electrons, out);
        });
        counts
    }

    fn read_row(&self, ordinal: u64, row: usize, offset: Offset, electrons: &[f32], out: &mut [u16]) {
        let noise = Stream::new(self.seed, Purpose::Exposure, ordinal);
        let table = QuantileTable::shared();
        let read = single(self.config.read_noise_electrons);
        let read_variance = read * read;
        let top = f32::from(self.config.counts_max());
        let start = row * self.columns;
        let (common, slope) = offset.along(row);
        for (column, count) in out.iter_mut().enumerate() {
            let pixel = start + column;
            let mean = electrons[pixel];
            let normal = noise.gaussian_fast(table, pixel as u64);
            let collected = if mean >= FEW_ELECTRONS {
                mean + (mean + read_variance).sqrt() * normal
            } else {
                self.arrivals(ordinal, pixel as u64, mean) + read * normal
            };
            let [gain, fixed] = self.pattern[pixel];
            let value = gain * collected + fixed + common + slope * column as f32;
            *count = rounded(value, top);
        }
    }

    /// A Poisson number of mean `mean` below [`FEW_ELECTRONS`], by inversion.
    fn arrivals(&self, ordinal: u64, pixel: u64, mean: f32) -> f32 {
        let mean = f64::from(mean.max(0.0));
        let mut rest = Stream::new(self.seed, Purpose::FewPhotons, ordinal).uniform(pixel);
        let mut chance = libm::exp(-mean);
        let mut number = 0.0_f64;
        // The tail beyond 400 has no weight in f64 for a mean of 64.
        while rest > chance && number < 400.0 {
            rest -= chance;
            number += 1.0;
            chance *= mean / number;
        }
        single(number)
    }

    fn offset_of(&self, exposure: Exposure, rows: usize) -> Offset {
        let warm_up = self
            .config
            .warm_up
            .map_or(0.0, |w| w.counts * libm::exp(-f64::from(exposure.since_pause) / w.frames));
        let none = DriftConfig { common_counts: 0.0, tilt_counts: 0.0, time_s: 1.0 };
        let drift = self.config.drift.unwrap_or(none);
        let wave = |shape: u64| self.drift_wave(shape, exposure.at_s / drift.time_s);
        let (half_rows, half_columns) = (rows as f64 / 2.0, self.columns as f64 / 2.0);
        Offset {
            common: warm_up + drift.common_counts * wave(0) - drift.tilt_counts * (wave(1) + wave(2)),
            per_row: drift.tilt_counts * wave(1) / half_rows,
            per_column: drift.tilt_counts * wave(2) / half_columns,
        }
    }

    /// A sum of sines of incommensurate periods with unit variance over long times.
    fn drift_wave(&self, shape: u64, phase: f64) -> f64 {
        // Periods of 2π, 2π·√2 and 2π·√5 time scales.
        const SLOWER: [f64; DRIFT_WAVES] = [1.0, std::f64::consts::SQRT_2, 2.236_067_977_499_79];
        let stream = Stream::new(self.seed, Purpose::Drift, shape);
        let sum: f64 = (0..DRIFT_WAVES)
            .map(|i| libm::sin(phase / SLOWER[i] + std::f64::consts::TAU * stream.uniform(i as u64)))
            .sum();
        sum * libm::sqrt(2.0 / 3.0)
    }
}

/// Offset of one exposure in counts: a plane over the image.
#[derive(Debug, Clone, Copy)]
struct Offset {
    common: f64,
    per_row: f64,
    per_column: f64,
}

impl Offset {
    fn along(self, row: usize) -> (f32, f32) {
        let common = self.common + self.per_row * row as f64;
        (single(common), single(self.per_column))
    }
}

/// Nearest count; halves go up.
#[inline]
fn rounded(value: f32, top: f32) -> u16 {
    let limited = (value + 0.5).clamp(0.0, top);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to 0 … 65535")]
    let count = limited as u16;
    count
}

#[expect(clippy::cast_possible_truncation, reason = "f32 holds counts to 1e-3")]
fn single(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::WarmUpConfig;

    const ROWS: usize = 64;
    const COLUMNS: usize = 80;

    fn exposure(ordinal: u64) -> Exposure {
        Exposure { ordinal, at_s: 0.0, since_pause: 100 }
    }

    fn moments(detector: &Detector, electrons: f32, frames: u64) -> (f64, f64, f64) {
        let image = vec![electrons; ROWS * COLUMNS];
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for ordinal in 0..frames {
            for &count in &detector.read(exposure(ordinal), &image) {
                n += 1.0;
                sum += f64::from(count);
                squares += f64::from(count) * f64::from(count);
            }
        }
        let mean = sum / n;
        (n, mean, squares / n - mean * mean)
    }

    /// Mean offset + e/g and variance (e + r²)/g² + 1/12 (rounding), within five standard errors. With noise of
    /// over one count the rounding error is uniform to 1e-8 (Widrow).
    #[test]
    fn mean_and_variance_follow_the_model() {
        let detector = Detector::new(DetectorConfig::assumed(), 5, ROWS, COLUMNS).unwrap();
        for electrons in [3000.0_f32, 30_000.0, 120_000.0] {
            let (n, mean, variance) = moments(&detector, electrons, 40);
            let e = f64::from(electrons);
            let expected = (e + 600.0 * 600.0) / (427.0 * 427.0) + 1.0 / 12.0;
            assert!((mean - 500.0 - e / 427.0).abs() < 5.0 * (expected / n).sqrt() + 1e-4, "{mean}");
            assert!((variance / expected - 1.0).abs() < 5.0 * (2.0 / n).sqrt() + 1e-4, "{variance}");
        }
    }

    /// Without read noise and with one electron per count, few photons are Poisson numbers: χ² of the counts.
    #[test]
    fn few_photons_follow_poisson() {
        let config = DetectorConfig {
            electrons_per_count: 1.0,
            read_noise_electrons: 0.0,
            offset_counts: 0.0,
            ..DetectorConfig::assumed()
        };
        let detector = Detector::new(config, 5, ROWS, COLUMNS).unwrap();
        let image = vec![4.0_f32; ROWS * COLUMNS];
        let mut seen = [0.0_f64; 12];
        for ordinal in 0..20 {
            for &count in &detector.read(exposure(ordinal), &image) {
                seen[usize::from(count).min(11)] += 1.0;
            }
        }
        let n: f64 = seen.iter().sum();
        let mut chance = (-4.0_f64).exp();
        let mut left = 1.0;
        let mut chi2 = 0.0;
        for (k, &number) in seen.iter().enumerate() {
            let p = if k == 11 { left } else { chance };
            chi2 += (number - n * p).powi(2) / (n * p);
            left -= chance;
            chance *= 4.0 / (k as f64 + 1.0);
        }
        // 11 degrees of freedom: mean 11, standard deviation 4.7.
        assert!(chi2 < 35.0, "{chi2}");
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let config =
            DetectorConfig { gain_spread: 0.02, offset_spread_counts: 4.0, ..DetectorConfig::assumed() };
        let detector = Detector::new(config, 5, ROWS, COLUMNS).unwrap();
        let image: Vec<f32> = (0..ROWS * COLUMNS).map(|p| p as f32).collect();
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| detector.read(exposure(9), &image))
        };
        let one = with(1);
        assert_eq!(one, with(3));
        assert_ne!(one, detector.read(exposure(10), &image));
    }

    /// The first frames after a pause are brighter by counts·exp(−n/frames); noise of a mean over all pixels of
    /// one frame: 1.5 counts / √5120 = 0.02.
    #[test]
    fn warm_up_decays_with_the_frames() {
        let warm_up = Some(WarmUpConfig { counts: 20.0, frames: 1.5, idle_s: 1.0 });
        let config = DetectorConfig { warm_up, ..DetectorConfig::assumed() };
        let detector = Detector::new(config, 5, ROWS, COLUMNS).unwrap();
        let image = vec![50_000.0_f32; ROWS * COLUMNS];
        for n in 0..6_u32 {
            let frame = detector.read(Exposure { since_pause: n, ..exposure(u64::from(n)) }, &image);
            let mean = frame.iter().map(|&c| f64::from(c)).sum::<f64>() / frame.len() as f64;
            let expected = 500.0 + 50_000.0 / 427.0 + 20.0 * (-f64::from(n) / 1.5).exp();
            assert!((mean - expected).abs() < 0.12, "{n}: {mean} {expected}");
        }
    }

    #[test]
    fn counts_stay_on_the_scale() {
        let config =
            DetectorConfig { offset_counts: 0.0, read_noise_electrons: 0.0, ..DetectorConfig::assumed() };
        let detector = Detector::new(config, 5, 1, 2).unwrap();
        let counts = detector.read(exposure(0), &[1e12, -1e9]);
        assert_eq!(counts, [16383, 0]);
    }

    /// Over many time scales the drift has the declared deviation; it moves slowly and leaves the noise alone.
    #[test]
    fn drift_has_the_declared_size_and_is_slow() {
        let drift = Some(DriftConfig { common_counts: 2.0, tilt_counts: 0.0, time_s: 100.0 });
        let config = DetectorConfig { drift, read_noise_electrons: 0.0, ..DetectorConfig::assumed() };
        let detector = Detector::new(config, 5, 2, 2).unwrap();
        let at = |s: f64| detector.offset_of(Exposure { at_s: s, ..exposure(0) }, 2).common;
        let n = 20_000;
        let squares: f64 = (0..n).map(|i| at(f64::from(i) * 37.0).powi(2)).sum();
        // Three sines sampled over 7400 time scales: the mean square is exact to about one period in 1000.
        assert!((squares / f64::from(n) / 4.0 - 1.0).abs() < 0.01, "{squares}");
        let step = (at(50.0) - at(51.0)).abs();
        // |d/dt| ≤ 2·√(2/3)·Σ 1/(slower·100 s)
        assert!(step < 0.036, "{step}");
    }
}
