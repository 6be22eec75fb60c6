//! The figures of Mie theory. Errors are against arbitrary precision: `mie_reference.csv` beside this file holds spheres
//! of the table, the single spheres and some of the angles.

use super::{Figure, Watch};
use crate::commands::CommandError;
use ditd_sim::light::mie::{self, Direction, Efficiencies, Effort, Lognormal, Sphere};
use ditd_sim::light::phase;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::hint::black_box;

const N: f64 = 1.38;
const K: f64 = 0.09;
const SIZES: [f64; 5] = [1.0, 10.0, 100.0, 1e3, 1e4];
/// Like spheres that are computed side by side.
const SIDE_BY_SIDE: usize = 64;
/// Size parameter of the sphere that is seen from 181 angles.
const SIZE_ANGLES: f64 = 100.0;

/// Size distributions (median radius and wavelength in µm, width, n, k) with the means of Q_ext, Q_sca, Q_abs and g by a
/// trapezoid of 524 288 radii, of which 12 digits are good.
const DISTRIBUTIONS: [(&str, [f64; 5], [f64; 4]); 2] = [
    (
        "mean over sizes, absorbing (k = 0.09)",
        [5.0, 3.4, 0.5, 1.38, 0.09],
        [2.351_412_090_567, 1.204_330_104_229, 1.147_081_986_339, 0.932_746_265_623_3],
    ),
    (
        "mean over sizes, k = 0.002",
        [15.0, 4.6, 0.5, 1.39, 0.002],
        [2.205_864_764_894, 1.948_200_966_849, 0.257_663_798_045_1, 0.840_147_837_990_3],
    ),
];
/// Relative accuracy that is asked for.
const DISTRIBUTION_TARGET: f64 = 1e-6;

/// Error that is asked for of clouds: n and k of liquids are known to no more.
const CLOUD_TARGET: f64 = 1e-4;
const WAVELENGTHS: u32 = 64;

/// Index at a wavelength in µm of a liquid with one absorption line near 3.41 µm.
fn index(um: f64) -> (f64, f64) {
    let (nu0, gamma, strength) = (2930.0, 60.0, 0.02);
    let nu = 1e4 / um;
    let d = (nu0 * nu0 - nu * nu) / (nu0 * nu0);
    let g = gamma * nu / (nu0 * nu0);
    let den = d * d + g * g;
    (1.38 + 0.5 * strength * d / den * 0.1, (0.5 * strength * g / den * 0.2).max(5e-4))
}

/// 200 radii, even in ln r from 0.1 to 100 µm, at each of 64 wavelengths from 3 to 5 µm.
fn table() -> Vec<Sphere> {
    let mut spheres = Vec::new();
    for w in 0..WAVELENGTHS {
        let um = 3.0 + 2.0 * f64::from(w) / f64::from(WAVELENGTHS - 1);
        let (n, k) = index(um);
        for r in 0..200 {
            let radius = 0.1 * libm::pow(1000.0, f64::from(r) / 199.0);
            spheres.push(Sphere { size_parameter: 2.0 * PI * radius / um, n, k });
        }
    }
    spheres
}

/// What arbitrary precision says of one sphere or direction.
struct Reference {
    sphere: Sphere,
    theta_deg: f64,
    /// Q_ext, Q_sca, Q_abs, Q_back, g; or the parts of S₁, S₂.
    values: [f64; 5],
}

/// The references of one kind: `table`, `sphere`, `angle`.
fn references(kind: &str) -> Vec<Reference> {
    let of_kind = |line: &&str| line.split(',').next() == Some(kind);
    include_str!("mie_reference.csv")
        .lines()
        .filter(of_kind)
        .map(|line| {
            let mut numbers = line.split(',').skip(1).map(|field| field.parse().unwrap_or(f64::NAN));
            let mut next = || numbers.next().unwrap_or(f64::NAN);
            Reference {
                sphere: Sphere { size_parameter: next(), n: next(), k: next() },
                theta_deg: next(),
                values: [next(), next(), next(), next(), next()],
            }
        })
        .collect()
}

/// Worst relative error of Q_ext, Q_sca, Q_abs and g; NaN counts as infinite.
fn worst(answers: &[Efficiencies], references: &[Reference]) -> f64 {
    let mut worst = 0.0f64;
    for (q, reference) in answers.iter().zip(references) {
        let [ext, sca, abs, _, g] = reference.values;
        for (found, wanted) in [(q.q_ext, ext), (q.q_sca, sca), (q.q_abs, abs), (q.asymmetry, g)] {
            worst = larger(worst, (found / wanted - 1.0).abs());
        }
    }
    worst
}

fn larger(worst: f64, error: f64) -> f64 {
    if error.is_nan() { f64::INFINITY } else { worst.max(error) }
}

/// All figures, measured now: on one thread, but for the clouds.
///
/// # Errors
///
/// Status 1 when there is no such thread, or Mie theory refuses a sphere.
pub(super) fn figures(watch: &Watch<'_>) -> Result<Vec<Figure>, CommandError> {
    let failed = |what: String| CommandError::failure(format!("bench mie: {what}"));
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| failed(e.to_string()))?;
    let mut figures = alone.install(|| measured(watch)).map_err(|error| failed(error.to_string()))?;
    // Clouds are what all threads are for.
    for effort in [Effort::of_radii(CLOUD_TARGET, 8192, 512), Effort::to(CLOUD_TARGET)] {
        figures.push(clouds(watch, &effort).map_err(failed)?);
    }
    Ok(figures)
}

/// Means and sampling tables of one cloud at the 64 wavelengths of the table.
fn clouds(watch: &Watch<'_>, effort: &Effort) -> Result<Figure, String> {
    let sizes = Lognormal { median_radius_um: 5.0, sigma_ln: 0.5 };
    let one = |wave: u32| -> Result<(mie::Bulk, phase::mie::MiePhase), String> {
        let um = 3.0 + 2.0 * f64::from(wave) / f64::from(WAVELENGTHS - 1);
        let (n, k) = index(um);
        let bulk = mie::bulk_with(sizes, um, n, k, effort).map_err(|error| error.to_string())?;
        let asymmetry = bulk.pattern.mean_cosine();
        let table = phase::mie::of_pattern(&bulk.pattern, asymmetry, CLOUD_TARGET);
        Ok((bulk, table.map_err(|error| error.to_string())?))
    };
    let all = || (0..WAVELENGTHS).into_par_iter().map(one).collect::<Result<Vec<_>, String>>();
    let made = all()?;
    let seconds = timed(watch, all);
    let error = made.iter().fold(0.0, |worst, (bulk, table)| {
        larger(larger(worst, bulk.means.error), bulk.pattern_error + table.error)
    });
    let radii: usize = made.iter().map(|(bulk, _)| bulk.means.radii).sum();
    let name = if effort.adaptive { "adaptive" } else { "8192 radii each" };
    Ok(Figure {
        name: format!("cloud at {WAVELENGTHS} wavelengths: means, sampling table; {name}"),
        seconds,
        error,
        error_kind: format!("estimate of the worst mean (relative) and distribution; {radii} radii"),
        n: made.len(),
        threads: rayon::current_num_threads(),
        seed: None,
    })
}

fn measured(watch: &Watch<'_>) -> Result<Vec<Figure>, mie::MieError> {
    let mut figures = vec![whole_table(watch)?];
    for size_parameter in SIZES {
        figures.push(one_sphere(watch, size_parameter)?);
    }
    for size_parameter in SIZES {
        figures.push(like_spheres(watch, size_parameter)?);
    }
    figures.push(angles(watch)?);
    for distribution in &DISTRIBUTIONS {
        figures.push(mean_over_sizes(watch, distribution)?);
    }
    Ok(figures)
}

fn figure(name: String, seconds: f64, n: usize, error: f64, error_kind: &str) -> Figure {
    Figure { name, seconds, error, error_kind: error_kind.to_owned(), n, threads: 1, seed: None }
}

/// Minimum time of a call whose answer nobody reads.
fn timed<T>(watch: &Watch<'_>, work: impl Fn() -> T) -> f64 {
    watch.fastest(|| {
        black_box(work());
    })
}

const EFFICIENCIES: &str = "Q_ext, Q_sca, Q_abs, g: worst, relative";

fn many(spheres: &[Sphere]) -> Result<Vec<Efficiencies>, mie::MieError> {
    mie::efficiencies_of_many(spheres).map_err(|(_, error)| error)
}

fn whole_table(watch: &Watch<'_>) -> Result<Figure, mie::MieError> {
    let spheres = table();
    many(&spheres)?;
    let seconds = timed(watch, || mie::efficiencies_of_many(black_box(&spheres)));
    let references = references("table");
    let known: Vec<Sphere> = references.iter().map(|reference| reference.sphere).collect();
    let error = worst(&many(&known)?, &references);
    let kind = format!("{EFFICIENCIES}, {} of the spheres", references.len());
    Ok(figure("table of 200 radii x 64 wavelengths".into(), seconds, spheres.len(), error, &kind))
}

fn one_sphere(watch: &Watch<'_>, size_parameter: f64) -> Result<Figure, mie::MieError> {
    let answer = mie::efficiencies(size_parameter, N, K)?;
    let seconds = timed(watch, || mie::efficiencies(black_box(size_parameter), N, K));
    let error = worst(&[answer], &of_size(size_parameter));
    Ok(figure(format!("one sphere, x = {size_parameter}"), seconds, 1, error, EFFICIENCIES))
}

fn like_spheres(watch: &Watch<'_>, size_parameter: f64) -> Result<Figure, mie::MieError> {
    let spheres = [Sphere { size_parameter, n: N, k: K }; SIDE_BY_SIDE];
    let answers = many(&spheres)?;
    let seconds = timed(watch, || mie::efficiencies_of_many(black_box(&spheres)));
    let name = format!("{SIDE_BY_SIDE} like spheres, x = {size_parameter}");
    let error = worst(&answers[..1], &of_size(size_parameter));
    Ok(figure(name, seconds, SIDE_BY_SIDE, error, EFFICIENCIES))
}

fn of_size(size_parameter: f64) -> Vec<Reference> {
    let mut references = references("sphere");
    references.retain(|r| r.sphere.size_parameter.to_bits() == size_parameter.to_bits());
    references
}

fn angles(watch: &Watch<'_>) -> Result<Figure, mie::MieError> {
    let sphere = Sphere { size_parameter: SIZE_ANGLES, n: N, k: K };
    let towards = (0..=180)
        .map(|degrees| Direction::from_degrees(f64::from(degrees)))
        .collect::<Result<Vec<_>, mie::MieError>>()?;
    mie::amplitudes_towards(sphere, &towards)?;
    let seconds = timed(watch, || mie::amplitudes_towards(black_box(sphere), black_box(&towards)));
    let (mut error, mut largest) = (0.0, 0.0f64);
    for reference in references("angle") {
        let direction = Direction::from_degrees(reference.theta_deg)?;
        for (s1, s2) in mie::amplitudes_towards(sphere, &[direction])? {
            let [re_1, im_1, re_2, im_2, _] = reference.values;
            error = larger(error, (s1.re - re_1).hypot(s1.im - im_1));
            error = larger(error, (s2.re - re_2).hypot(s2.im - im_2));
            largest = largest.max(re_1.hypot(im_1));
        }
    }
    let name = format!("181 angles, x = {SIZE_ANGLES}");
    Ok(figure(name, seconds, towards.len(), error / largest, "S1, S2: worst, over the largest"))
}

fn mean_over_sizes(
    watch: &Watch<'_>,
    (name, [median_radius_um, wavelength_um, sigma_ln, n, k], wanted): &(&str, [f64; 5], [f64; 4]),
) -> Result<Figure, mie::MieError> {
    let sizes = Lognormal { median_radius_um: *median_radius_um, sigma_ln: *sigma_ln };
    let mean = || mie::lognormal(black_box(sizes), *wavelength_um, *n, *k, DISTRIBUTION_TARGET);
    let means = mean()?;
    let seconds = timed(watch, mean);
    let found = [means.q_ext, means.q_sca, means.q_abs, means.asymmetry];
    let error = found
        .iter()
        .zip(wanted)
        .fold(0.0, |worst, (found, wanted)| larger(worst, (found / wanted - 1.0).abs()));
    let kind = format!("means: worst, relative; asked for {DISTRIBUTION_TARGET:e}");
    Ok(figure((*name).to_owned(), seconds, means.radii, error, &kind))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_references_are_spheres_of_the_table() {
        let (table, references) = (table(), references("table"));
        assert!(table.len() == 12_800 && references.len() == 65);
        for (i, reference) in references.iter().enumerate() {
            let own = table[7 + 197 * i];
            // Logarithms and powers of two libraries: a few units of the last place.
            let close = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-14;
            assert!(close(own.size_parameter, reference.sphere.size_parameter));
            assert!(close(own.n, reference.sphere.n) && close(own.k, reference.sphere.k));
        }
    }

    #[test]
    fn every_figure_is_measured_with_a_small_error() {
        let clock = crate::clock::Clock::start();
        let figures = figures(&Watch { clock: &clock, seconds: 0.0 }).unwrap();
        assert_eq!(figures.len(), 1 + 2 * SIZES.len() + 1 + DISTRIBUTIONS.len() + 2);
        for figure in figures {
            // 2.2e-16 · (64 + 8 c + x) for the largest sphere; the means are asked to 1e-6.
            let allowed = match figure.name.split(' ').next() {
                // 8192 radii are too few at some wavelengths, and say so.
                Some("cloud") => 2e-3,
                Some("mean") => 1e-6,
                _ => 3e-12,
            };
            assert!(figure.seconds > 0.0 && figure.error < allowed && figure.n > 0, "{figure:?}");
        }
    }

    #[test]
    fn every_figure_has_a_reference_that_is_met() {
        for size_parameter in SIZES {
            let reference = of_size(size_parameter);
            assert_eq!(reference.len(), 1);
            // The bound of the efficiencies, with condition numbers below 2 for this index.
            let q = mie::efficiencies(size_parameter, N, K).unwrap();
            assert!(worst(&[q], &reference) < 2.2e-16 * (64.0 + 16.0 + size_parameter), "{size_parameter}");
        }
        let nothing = Efficiencies { q_ext: f64::NAN, ..Efficiencies::default() };
        assert!(worst(&[nothing], &of_size(1.0)).is_infinite());
        assert_eq!(references("angle").len(), 13);
    }
}
