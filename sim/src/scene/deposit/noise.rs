//! How much of the picture is parcel noise: random halves of the parcels, doubled, against each other.
//!
//! Looks at the kernels themselves, projected on pixels: no grid, no walls; and at all splits at once, by their
//! expectation, so that the answer has no noise of its own.

use super::super::field::Parcel;
use super::kernel::{index, line};
use rayon::prelude::*;

/// Extinction efficiency of large droplets, the limit of Mie theory; only this test uses it.
const EXTINCTION_EFFICIENCY: f64 = 2.0;

/// Columns with less optical depth than this are not looked at: they would dilute the error.
const DEPTH_MIN: f64 = 0.3;

/// Edge of a pixel in metres, about that of a camera that sees a whole spray.
const PIXEL_M: f64 = 0.25e-3;

/// Pixels along an axis at most; wider clouds get wider pixels.
const PIXELS_MAX: usize = 1024;

/// Parcels that are looked at, at most: of more, every second, third … stands for as many.
const PARCELS_MAX: usize = 1 << 20;

/// Root mean square difference of the transmission of two halves, per view axis x, y, z; 0 without parcels.
///
/// The noise of a doubled half is √2 that of the whole, so the whole's own noise is half of this difference.
///
/// With x_i the optical depth of parcel i in a pixel and a random sign for the half it is in, the doubled halves have
/// the optical depths τ ± D, D = Σ ± x_i. Their transmissions differ by 2 e^(−τ) sinh D, and the mean of its square over
/// all signs is 2 e^(−2τ) (Π cosh 2x_i − 1).
pub(super) fn split_half(parcels: &[Parcel], widths: &[(f64, f64)]) -> [f64; 3] {
    let every = parcels.len().div_ceil(PARCELS_MAX).max(1);
    let views: Vec<f64> =
        (0..3_usize).into_par_iter().map(|axis| view_error(parcels, widths, axis, every)).collect();
    [views[0], views[1], views[2]]
}

fn view_error(parcels: &[Parcel], widths: &[(f64, f64)], axis: usize, every: usize) -> f64 {
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut lower = [f64::INFINITY; 2];
    let mut upper = [f64::NEG_INFINITY; 2];
    for (parcel, (width, _)) in parcels.iter().zip(widths) {
        for (i, x) in [parcel.position_m[a], parcel.position_m[b]].into_iter().enumerate() {
            lower[i] = lower[i].min(x - 1.5 * width);
            upper[i] = upper[i].max(x + 1.5 * width);
        }
    }
    if parcels.is_empty() {
        return 0.0;
    }
    let span = [upper[0] - lower[0], upper[1] - lower[1]];
    let pixel = PIXEL_M.max(span[0].max(span[1]) / PIXELS_MAX as f64);
    let counts = span.map(|s| 1 + index(s / pixel, PIXELS_MAX));
    // Optical depth τ, and Σ ln cosh 2x.
    let mut depths = vec![0.0_f64; counts[0] * counts[1]];
    let mut spreads = depths.clone();
    let (mut in_rows, mut along) = (Vec::new(), Vec::new());
    for (parcel, (width, _)) in parcels.iter().zip(widths).step_by(every) {
        let depth = EXTINCTION_EFFICIENCY * parcel.area_m2() / (pixel * pixel);
        let width = width / pixel;
        let row = line((parcel.position_m[a] - lower[0]) / pixel, width, counts[0], &mut in_rows);
        let column = line((parcel.position_m[b] - lower[1]) / pixel, width, counts[1], &mut along);
        let largest = |shares: &[f64]| shares.iter().copied().fold(0.0, f64::max);
        let faint = 2.0 * depth * largest(&in_rows) * largest(&along) < SERIES_BELOW;
        for (i, share) in in_rows.iter().enumerate() {
            let first = (row + i) * counts[1] + column;
            let pixels = first..first + along.len();
            let sums = depths[pixels.clone()].iter_mut().zip(&mut spreads[pixels]).zip(&along);
            let own = share * depth;
            if faint {
                sums.for_each(|((depth, spread), share)| {
                    *depth += own * share;
                    *spread += ln_cosh_series(2.0 * own * share);
                });
            } else {
                sums.for_each(|((depth, spread), share)| {
                    *depth += own * share;
                    *spread += ln_cosh(2.0 * own * share);
                });
            }
        }
    }
    let (mut squares, mut count) = (0.0, 0.0);
    let all = depths.into_iter().zip(spreads).map(|(d, s)| (d * every as f64, s * every as f64));
    for (depth, spread) in all.filter(|sums| sums.0 > DEPTH_MIN) {
        // The difference of two numbers between 0 and 1 is at most 1, however rare and heavy the parcels are; Σ ln cosh
        // is at most 2τ, so that nothing overflows.
        squares += 2.0 * ((spread - 2.0 * depth).exp() - (-2.0 * depth).exp()).max(0.0);
        count += 1.0;
    }
    if count > 0.0 { f64::sqrt(squares / count) } else { 0.0 }
}

/// Arguments below which the series of ln cosh is good to 1e-7 of its value.
const SERIES_BELOW: f64 = 0.1;

/// ln cosh y for y ≥ 0, to 1e-7 of its value.
fn ln_cosh(y: f64) -> f64 {
    if y < SERIES_BELOW { ln_cosh_series(y) } else { y + (0.5 + 0.5 * (-2.0 * y).exp()).ln() }
}

fn ln_cosh_series(y: f64) -> f64 {
    let square = y * y;
    square * (0.5 - square * (1.0 / 12.0 - square / 45.0))
}

#[cfg(test)]
mod tests {
    use super::super::kernel::spline_integral;
    use super::*;

    /// Uniform in 0 … 1: SplitMix64 (Steele, Lea, Flood 2014).
    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = *state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Equal parcels at random places of a cube of 10 mm.
    fn cube(count: usize, area_m2: f64) -> Vec<Parcel> {
        let diameter_m = 1e-5_f64;
        let droplets = area_m2 / (std::f64::consts::FRAC_PI_4 * diameter_m * diameter_m);
        let mut state = 7;
        (0..count)
            .map(|_| Parcel {
                position_m: std::array::from_fn(|_| 0.01 * random(&mut state)),
                diameter_m,
                temperature_k: 380.0,
                droplets,
            })
            .collect()
    }

    #[test]
    fn noise_of_random_parcels_follows_from_their_number() {
        // n parcels per area of optical depth 2a each, seen through a kernel with ∫K² = (0.55/w)² (the spline's
        // 11/20 along each axis): the halves differ by the variance 4 n (2a)² ∫K² times the transmission squared.
        let (count, depth, width) = (8000, 1.0_f64, 1e-3_f64);
        let area = 0.5 * depth * 1e-4 / count as f64;
        let parcels = cube(count, area);
        let found = split_half(&parcels, &vec![(width, 0.0); count]);
        let variance = 4.0 * count as f64 / 1e-4 * (2.0 * area).powi(2) * (0.55 / width).powi(2);
        let expected = (-depth).exp() * variance.sqrt();
        for error in found {
            // At the rim, a quarter of the pixels, the cube is thinner: less light is lost, and less noise seen.
            assert!((error / expected - 1.0).abs() < 0.15, "{error} {expected}");
        }
    }

    #[test]
    fn the_expectation_is_that_of_random_halves() {
        // 40 splits by hand, each half spread by itself.
        let (count, width) = (3000, 1.5e-3);
        let parcels = cube(count, 0.4 * 1e-4 / count as f64);
        let widths = vec![(width, 0.0); count];
        let expected = split_half(&parcels, &widths)[0];
        let mut state = 99;
        let depth = |chosen: &[bool], place: [f64; 2]| -> f64 {
            let kernel =
                |x: f64| spline_integral((x + 0.125e-3) / width) - spline_integral((x - 0.125e-3) / width);
            let own = |p: &Parcel| {
                let shares = kernel(place[0] - p.position_m[1]) * kernel(place[1] - p.position_m[2]);
                2.0 * p.area_m2() / 0.25e-3_f64.powi(2) * shares
            };
            2.0 * parcels.iter().zip(chosen).filter(|(_, c)| **c).map(|(p, _)| own(p)).sum::<f64>()
        };
        let mut squares = 0.0;
        let mut looks = 0.0;
        for _ in 0..40 {
            let first: Vec<bool> = (0..count).map(|_| random(&mut state) < 0.5).collect();
            let second: Vec<bool> = first.iter().map(|c| !c).collect();
            for _ in 0..20 {
                let place = [0.0015 + 0.007 * random(&mut state), 0.0015 + 0.007 * random(&mut state)];
                squares += ((-depth(&first, place)).exp() - (-depth(&second, place)).exp()).powi(2);
                looks += 1.0;
            }
        }
        let found = f64::sqrt(squares / looks);
        // 800 looks, about half of them independent: the rms is known to 4 %; the rim adds as above.
        assert!((found / expected - 1.0).abs() < 0.15, "{found} {expected}");
    }

    #[test]
    fn nothing_has_no_noise() {
        assert!(split_half(&[], &[]).iter().all(|e| e.abs() < f64::MIN_POSITIVE));
    }
}
