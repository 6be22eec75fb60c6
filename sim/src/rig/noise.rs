//! Random numbers of the simulated rig: counter-based, keyed by what they are for.
//!
//! A number depends only on its key (seed, purpose, ordinal) and its counter (pixel, mode), never on the order
//! of work, so that results have the same bits for any number of threads. Not for cryptography.

use std::sync::LazyLock;

/// Cells of the quantile table.
const CELLS: usize = 4096;
/// Cells at each end in which the quantile is computed instead of interpolated: there it bends too much.
const TAIL_CELLS: usize = 16;

/// Purposes of random numbers: two purposes never share a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Photon and read noise of one exposure.
    Exposure = 1,
    /// Photon arrivals below the Gaussian threshold.
    FewPhotons = 2,
    /// Gain of each pixel.
    Gain = 3,
    /// Offset of each pixel.
    Offset = 4,
    /// Phases of the slow offset drift.
    Drift = 5,
    /// Wave vectors of the shot fields.
    Modes = 6,
    /// Amplitudes of the shot fields of one injection.
    Injection = 7,
    /// Scrambles of low-discrepancy points.
    Scramble = 8,
    /// The zero of a device clock.
    Clock = 9,
    /// Mass and direction of each plume of one shot of a parametric spray.
    Plumes = 10,
    /// Turbulence of one shot of a parametric spray.
    Turbulence = 11,
    /// Noise of process values.
    Sensors = 12,
}

/// A stream of random numbers that is addressed, not stepped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stream {
    first: u64,
    second: u64,
}

impl Stream {
    /// The stream for one purpose and one ordinal (exposure, injection, replicate…) under a seed.
    pub fn new(seed: u64, purpose: Purpose, ordinal: u64) -> Self {
        let key = mix(mix(seed ^ 0x6a09_e667_f3bc_c908) ^ (purpose as u64).wrapping_mul(GOLDEN));
        let first = mix(key ^ ordinal.wrapping_mul(GOLDEN));
        Self { first, second: mix(first ^ 0xbb67_ae85_84ca_a73b) }
    }

    /// 64 random bits at `counter`.
    #[inline]
    pub fn bits(self, counter: u64) -> u64 {
        // The finaliser of SplitMix64 (Steele, Lea and Flood 2014) with a second key between its two rounds: two
        // streams whose first keys differ by a multiple of the increment still have nothing in common.
        let x = counter.wrapping_mul(GOLDEN).wrapping_add(self.first);
        let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = x ^ (x >> 27) ^ self.second;
        let x = x.wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// Uniform in (0, 1): odd multiples of 2⁻⁵³.
    #[inline]
    pub fn uniform(self, counter: u64) -> f64 {
        unit(self.bits(counter))
    }

    /// Standard normal number, from the quantile function in full precision.
    pub fn gaussian(self, counter: u64) -> f64 {
        normal_quantile(self.uniform(counter))
    }

    /// Standard normal number, fast: see [`QuantileTable`].
    #[inline]
    pub fn gaussian_fast(self, table: &QuantileTable, counter: u64) -> f32 {
        table.at(self.bits(counter))
    }
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

#[inline]
fn mix(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[inline]
fn unit(bits: u64) -> f64 {
    let whole = (bits >> 12) as f64;
    (whole + 0.5) * (1.0 / 4_503_599_627_370_496.0)
}

/// The normal quantile at 4096 equal steps of probability, linear between them, computed outside them.
///
/// The chord of the quantile lies at most 1.5e-4 off where it is used; the variance of the numbers is 1 within
/// 1e-5 and the largest is 8.2. One draw costs a hash and two neighbouring loads.
#[derive(Debug)]
pub struct QuantileTable {
    nodes: Vec<[f32; 2]>,
}

impl QuantileTable {
    /// The one table, made at first use.
    pub fn shared() -> &'static Self {
        static TABLE: LazyLock<QuantileTable> = LazyLock::new(QuantileTable::build);
        &TABLE
    }

    fn build() -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "4096 steps, f32 table")]
        let node = |i: usize| normal_quantile((i as f64 / CELLS as f64).clamp(1e-17, 1.0 - 1e-16)) as f32;
        Self { nodes: (0..CELLS).map(|i| [node(i), node(i + 1) - node(i)]).collect() }
    }

    #[inline]
    fn at(&self, bits: u64) -> f32 {
        let cell = (bits >> 52) as usize;
        if (TAIL_CELLS..CELLS - TAIL_CELLS).contains(&cell) {
            let part = ((bits >> 28) & 0xff_ffff) as f32 * (1.0 / 16_777_216.0);
            let [low, step] = self.nodes[cell];
            low + step * part
        } else {
            #[expect(clippy::cast_possible_truncation, reason = "f32 is the precision of the fast draw")]
            let tail = normal_quantile(unit(bits)) as f32;
            tail
        }
    }
}

/// Inverse of the standard normal distribution function, for `p` in (0, 1).
///
/// Algorithm AS 241, PPND16 (Wichura 1988, Applied Statistics 37, 477): relative error about 1e-16.
pub fn normal_quantile(p: f64) -> f64 {
    let q = p - 0.5;
    if q.abs() <= 0.425 {
        let r = 0.180_625 - q * q;
        return q * ratio(r, &CENTRE);
    }
    let r = libm::sqrt(-libm::log(if q < 0.0 { p } else { 1.0 - p }));
    let magnitude = if r <= 5.0 { ratio(r - 1.6, &MIDDLE) } else { ratio(r - 5.0, &FAR) };
    if q < 0.0 { -magnitude } else { magnitude }
}

/// Numerator and denominator of a rational function, highest power first.
type Rational = ([f64; 8], [f64; 8]);

fn ratio(r: f64, (top, bottom): &Rational) -> f64 {
    let horner = |c: &[f64; 8]| c.iter().fold(0.0, |sum, a| sum * r + a);
    horner(top) / horner(bottom)
}

const CENTRE: Rational = (
    [
        2_509.080_928_730_122_7,
        33_430.575_583_588_13,
        67_265.770_927_008_7,
        45_921.953_931_549_87,
        13_731.693_765_509_46,
        1_971.590_950_306_551_3,
        133.141_667_891_784_38,
        3.387_132_872_796_366_5,
    ],
    [
        5_226.495_278_852_855,
        28_729.085_735_721_943,
        39_307.895_800_092_71,
        21_213.794_301_586_597,
        5_394.196_021_424_751,
        687.187_007_492_057_9,
        42.313_330_701_600_91,
        1.0,
    ],
);

const MIDDLE: Rational = (
    [
        7.745_450_142_783_414e-4,
        2.272_384_498_926_918_4e-2,
        0.241_780_725_177_450_6,
        1.270_458_252_452_368_4,
        3.647_848_324_763_204_5,
        5.769_497_221_460_691,
        4.630_337_846_156_546,
        1.423_437_110_749_683_5,
    ],
    [
        1.050_750_071_644_416_9e-9,
        5.475_938_084_995_345e-4,
        1.519_866_656_361_645_7e-2,
        0.148_103_976_427_480_08,
        0.689_767_334_985_1,
        1.676_384_830_183_803_8,
        2.053_191_626_637_759,
        1.0,
    ],
);

const FAR: Rational = (
    [
        2.010_334_399_292_288_1e-7,
        2.711_555_568_743_487_6e-5,
        1.242_660_947_388_078_4e-3,
        2.653_218_952_657_612_4e-2,
        0.296_560_571_828_504_87,
        1.784_826_539_917_291_3,
        5.463_784_911_164_114,
        6.657_904_643_501_103,
    ],
    [
        2.044_263_103_389_939_8e-15,
        1.421_511_758_316_446e-7,
        1.846_318_317_510_054_8e-5,
        7.868_691_311_456_133e-4,
        1.487_536_129_085_061_5e-2,
        0.136_929_880_922_735_8,
        0.599_832_206_555_888,
        1.0,
    ],
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Second source: the complementary error function of the libm crate.
    #[test]
    fn quantile_inverts_the_distribution_function() {
        for i in 1..2000 {
            let p = f64::from(i) / 2000.0;
            let back = 0.5 * libm::erfc(-normal_quantile(p) / std::f64::consts::SQRT_2);
            assert!((back - p).abs() < 4e-16, "{p}: {back}");
        }
        for p in [1e-6, 1e-10, 1e-15] {
            let back = 0.5 * libm::erfc(-normal_quantile(p) / std::f64::consts::SQRT_2);
            assert!((back / p - 1.0).abs() < 1e-12, "{p}: {back}");
        }
    }

    /// Moments of 4 million draws; a moment's standard error is the root of its variance over n.
    #[test]
    fn fast_gaussian_has_the_moments_of_a_normal_number() {
        let stream = Stream::new(7, Purpose::Exposure, 3);
        let table = QuantileTable::shared();
        let n = 4_000_000_u32;
        let mut moments = [0.0_f64; 4];
        for i in 0..n {
            let z = f64::from(stream.gaussian_fast(table, u64::from(i)));
            let mut power = 1.0;
            for m in &mut moments {
                power *= z;
                *m += power;
            }
        }
        let bound = |variance: f64| 5.0 * (variance / f64::from(n)).sqrt();
        let m: Vec<f64> = moments.iter().map(|s| s / f64::from(n)).collect();
        assert!(m[0].abs() < bound(1.0), "mean {}", m[0]);
        assert!((m[1] - 1.0).abs() < bound(2.0) + 1e-5, "variance {}", m[1]);
        assert!(m[2].abs() < bound(15.0), "third {}", m[2]);
        assert!((m[3] - 3.0).abs() < bound(96.0) + 1e-4, "fourth {}", m[3]);
    }

    /// χ² of 64 equally likely cells, over neighbouring counters and neighbouring ordinals.
    #[test]
    fn bits_are_uniform_along_counters_and_ordinals() {
        let n = 640_000_u64;
        let chi2 = |draw: &dyn Fn(u64) -> u64| -> f64 {
            let mut cells = [0.0_f64; 64];
            for i in 0..n {
                cells[usize::try_from(draw(i) >> 58).unwrap()] += 1.0;
            }
            let expected = 10_000.0;
            cells.iter().map(|c| (c - expected).powi(2) / expected).sum()
        };
        let along = chi2(&|i| Stream::new(1, Purpose::Gain, 0).bits(i));
        let across = chi2(&|i| Stream::new(1, Purpose::Gain, i).bits(0));
        let seeds = chi2(&|i| Stream::new(i, Purpose::Gain, 0).bits(0));
        // 63 degrees of freedom: mean 63, standard deviation 11.2; five of them up.
        for value in [along, across, seeds] {
            assert!((15.0..119.0).contains(&value), "{along} {across} {seeds}");
        }
    }
}
