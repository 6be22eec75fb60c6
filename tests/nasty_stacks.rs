//! Stacks that no line can be drawn through: flags and NaN, never an error or a wild number, whichever the estimator.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::estimate::map::{DitMap, Estimator, flag};
use ditd::files::npy::{self, Array, Values};
use ditd::stack::Stack;
use serde_json::{Value, json};

const ALL: [Estimator; 3] = [Estimator::Default, Estimator::Paper, Estimator::Ols];

/// A stack of one row; `frame(level, pair, pixel)` gives spray and blank.
struct Nasty<'a> {
    pixels: usize,
    pairs: &'a [usize],
    x: Value,
    saturation: u16,
    frame: &'a dyn Fn(usize, usize, usize) -> (u16, u16),
}

impl Nasty<'_> {
    fn fit(&self, estimator: Estimator) -> DitMap {
        let dir = tempfile::tempdir().unwrap();
        let (mut spray, mut blank) = (Vec::new(), Vec::new());
        for (level, &pairs) in self.pairs.iter().enumerate() {
            for pair in 0..pairs {
                for pixel in 0..self.pixels {
                    let (with, without) = (self.frame)(level, pair, pixel);
                    spray.push(with);
                    blank.push(without);
                }
            }
        }
        let frames = self.pairs.iter().sum();
        for (name, counts) in [("spray.npy", spray), ("nospray.npy", blank)] {
            let array = Array { shape: vec![frames, 1, self.pixels], values: Values::U16(counts) };
            npy::write(&dir.path().join(name), &array).unwrap();
        }
        let case = json!({
            "pairs_per_setpoint": self.pairs,
            "x_counts": self.x,
            "gamma": 0.95,
            "eps_B": 0.99,
            "saturation_count": self.saturation,
            "calibration": { "A": 7.2e5, "a_um": 3.4, "b_um_K": 1.5 },
        });
        std::fs::write(dir.path().join("case.json"), case.to_string()).unwrap();
        let mut stack = Stack::open(dir.path()).unwrap();
        let inputs = stack.inputs(estimator);
        stack.fit(&inputs).unwrap().map
    }
}

/// Whatever is finite is consistent: temperatures are possible ones inside their sets, and ours exists only where the
/// emissivity is positive and the set bounded.
fn check(map: &DitMap) {
    for i in 0..map.flags.len() {
        let (t, flags) = (map.temperature_k[i], map.flags[i]);
        if t.is_finite() {
            assert!(t > 0.0, "pixel {i}: {t} K");
            if map.estimator == Estimator::Default {
                let none = flag::NOT_RESOLVED | flag::NEGATIVE_EMISSIVITY | flag::TOO_FEW_LEVELS | flag::DEAD;
                assert!(flags & none == 0 && map.emissivity[i] >= 0.0, "pixel {i}: {t} K, {flags:b}");
                let (low, high) = (map.temperature_low_k[i], map.temperature_high_k[i]);
                assert!(!(low > t || high < t), "pixel {i}: {low} {t} {high}");
            }
        } else {
            assert!(t.is_nan() && flags != 0, "pixel {i}: {t} without a flag");
        }
        for channel in map.channels() {
            assert!(!channel[i].is_infinite() || map.estimator != Estimator::Default, "pixel {i}");
        }
        assert!(flags < 1 << 13, "{flags:b}");
    }
}

fn x(counts: &[f64]) -> Value {
    json!(counts)
}

const X5: [f64; 5] = [8.2, 19.0, 39.4, 140.6, 245.5];

/// Counts of a pixel of emissivity 0.7 whose spray is at 58 counts, with a ripple of a few counts.
fn ordinary(level: usize, pair: usize) -> (u16, u16) {
    let blank = 1500.0 + 0.95 * X5[level];
    let y = 0.95 * 0.7 * (58.0 - X5[level]);
    let ripple = f64::from(u32::try_from((level * 7 + pair * 5) % 4).unwrap()) - 1.5;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts near 1500")]
    let pair = ((blank + y + ripple).round() as u16, blank.round() as u16);
    pair
}

/// Pixel 0 saturated always, 1 in two levels, 2 dead at zero, 3 dead at a count, 4 constant difference on a plate that
/// is seen, 5 never a spray, 6 brighter the hotter the plate (negative emissivity), 7 ordinary.
#[test]
fn broken_pixels_have_flags_and_spare_the_others() {
    for (pairs, top) in [([3; 5], 16_383), ([1; 5], 16_383), ([2; 5], 65_535)] {
        let frame = |level: usize, pair: usize, pixel: usize| {
            let (spray, blank) = ordinary(level, pair);
            match pixel {
                0 => (top, blank),
                1 if level > 2 => (spray, top),
                2 => (0, 0),
                3 => (1777, 1777),
                4 => (blank + 5, blank),
                5 => (blank + u16::try_from((level + pair) % 2).unwrap(), blank),
                6 => (blank + u16::try_from(10 * level + pair % 2).unwrap(), blank),
                _ => (spray, blank),
            }
        };
        for estimator in ALL {
            let nasty = Nasty { pixels: 8, pairs: &pairs, x: x(&X5), saturation: top, frame: &frame };
            let map = nasty.fit(estimator);
            check(&map);
            let has = |pixel: usize, bits: u32| map.flags[pixel] & bits == bits;
            assert!(has(0, flag::SATURATED | flag::TOO_FEW_LEVELS) && map.temperature_k[0].is_nan());
            assert!(has(1, flag::SATURATED) && !has(1, flag::TOO_FEW_LEVELS));
            assert!(has(2, flag::DEAD) && has(3, flag::DEAD), "{:b} {:b}", map.flags[2], map.flags[3]);
            assert!(has(6, flag::NEGATIVE_EMISSIVITY));
            if estimator == Estimator::Default {
                assert!([2, 3, 6].iter().all(|&pixel| map.temperature_k[pixel].is_nan()));
            }
            assert!((map.temperature_k[7] - 448.8).abs() < 8.0, "{estimator:?}: {}", map.temperature_k[7]);
            assert!((map.emissivity[7] - 0.7).abs() < 0.05);
        }
    }
}

#[test]
fn levels_that_do_not_span_a_line_give_none() {
    let cases: [(Value, &[usize]); 6] = [
        (x(&[58.0; 5]), &[2; 5]),
        (json!([8.2, null, null, null, null]), &[2; 5]),
        (json!([null, null, null, null, null]), &[2; 5]),
        (x(&X5), &[3, 0, 0, 0, 0]),
        (x(&[8.2, 8.2 + 1e-6, 8.2, 8.2, 8.2 - 1e-6]), &[2; 5]),
        (x(&[8.2]), &[4]),
    ];
    for (x, pairs) in cases {
        for estimator in ALL {
            let frame = |level: usize, pair: usize, _: usize| ordinary(level, pair);
            let map =
                Nasty { pixels: 3, pairs, x: x.clone(), saturation: 16_383, frame: &frame }.fit(estimator);
            check(&map);
            assert!(map.flags.iter().all(|flags| flags & flag::TOO_FEW_LEVELS != 0), "{x} {pairs:?}");
            assert!(map.channels()[..12].iter().all(|channel| channel.iter().all(|v| v.is_nan())));
        }
    }
}

/// Two levels of one pair say nothing of their scatter; levels may be missing, in any order, and of any number.
#[test]
fn few_and_uneven_levels_still_answer() {
    let cases: [(Value, &[usize]); 4] = [
        (json!([8.2, null, null, null, 245.5]), &[1; 5]),
        (x(&X5), &[1, 4, 0, 2, 7]),
        (x(&X5), &[12, 1, 1, 1, 1]),
        (json!([8.2, 19.0, null, 140.6, 245.5]), &[2, 1, 5, 1, 3]),
    ];
    for (x, pairs) in cases {
        for estimator in ALL {
            let frame = |level: usize, pair: usize, _: usize| ordinary(level, pair);
            let map =
                Nasty { pixels: 4, pairs, x: x.clone(), saturation: 16_383, frame: &frame }.fit(estimator);
            check(&map);
            for i in 0..4 {
                assert!(
                    (map.temperature_k[i] - 448.8).abs() < 6.0,
                    "{estimator:?} {pairs:?}: {}",
                    map.temperature_k[i]
                );
                let expected = pairs.iter().enumerate();
                assert!(expected.into_iter().all(|(k, &n)| map.count[k * 4 + i] as usize == n));
            }
        }
    }
}

/// 16-bit counts over their whole range, and noise that fills it.
#[test]
fn whole_range_of_sixteen_bits_is_exact_and_finite() {
    let frame = |level: usize, pair: usize, pixel: usize| {
        let mixed = (level * 7919 + pair * 104_729 + pixel * 15_485_863) as u64;
        let bits = |salt: u64| {
            let mut z = (mixed + salt).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            z = (z ^ (z >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            u16::try_from(z >> 48).unwrap().min(65_534)
        };
        match pixel % 3 {
            0 => (65_534, 0),
            1 => (0, 65_534),
            _ => (bits(1), bits(2)),
        }
    };
    for estimator in ALL {
        let nasty = Nasty { pixels: 30, pairs: &[9; 5], x: x(&X5), saturation: 65_535, frame: &frame };
        let map = nasty.fit(estimator);
        check(&map);
        for (i, offset) in map.offset.iter().enumerate().take(2) {
            // A constant difference of all counts that there are: no slope, and exactly that offset.
            let want = if i == 0 { 65_534.0 } else { -65_534.0 };
            assert!(offset.is_nan() || (offset - want).abs() < 1e-9, "{offset}");
        }
    }
}
