//! What holds for every method: closed forms, variances, holes, nasty images.

use super::operators::radius;
use super::*;

const PHASES: [(usize, f64); 4] = [(41, 20.0), (40, 19.5), (43, 18.0), (41, 19.83)];

fn settings(method: Method, centre: f64) -> Settings {
    let strength = if method == Method::Fourier { 8.0 } else { 0.5 };
    Settings {
        method,
        elements: Elements::Linear,
        strength: Strength::Fixed(strength),
        centre: Some(centre),
        pixel_m: 1e-3,
        weighted: false,
    }
}

/// Columns of a Gaussian of `width` pixels and its coefficient, in 1/m for pixels of 1 mm.
fn gaussian(rows: usize, columns: usize, centre: f64, width: f64) -> (Vec<f64>, Vec<f64>) {
    let f = |c: usize| (-((radius(c, 0.0) - centre) / width).powi(2)).exp();
    let each = || (0..rows).flat_map(|_| 0..columns);
    let column = each().map(|c| width * std::f64::consts::PI.sqrt() * f(c) * 1e-3).collect();
    (column, each().map(f).collect())
}

fn pseudo_noise(i: usize) -> f64 {
    ((i * 7919 + 13) % 1009) as f64 / 504.0 - 1.0
}

#[test]
fn every_method_finds_a_gaussian_about_any_axis() {
    for (columns, centre) in PHASES {
        let (column, truth) = gaussian(3, columns, centre, 6.0);
        for method in Method::ALL {
            // By the second derivative on the axis, 2/6²: rings err by two thirds of a quarter of it, hats and
            // parabolas less; the exponentials of Hansen and Law, cubic interpolation and strengths a little.
            let wanted = Settings { strength: Strength::Automatic, ..settings(method, centre) };
            let image = Columns { values: &column, sigmas: None, rows: 3, columns };
            let found = invert(&image, &wanted).unwrap();
            for (got, want) in found.alpha_per_m.iter().zip(&truth) {
                assert!((got - want).abs() < 0.04, "{method:?} {columns} {centre}: {got} {want}");
            }
            let rms = found.alpha_per_m.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let rms = (rms / radius(truth.len(), 0.0)).sqrt();
            assert!(rms < 0.012, "{method:?} {columns} {centre}: {rms}");
        }
    }
}

/// All but the bounded one are linear: each pixel's share of each answer, measured by moving it, squared and summed
/// is the variance that was told. On whole rows, rows with holes, and about axes between the radii.
#[test]
fn variances_are_those_of_the_operators_rows() {
    for (columns, centre) in PHASES {
        for method in Method::ALL.into_iter().filter(|m| *m != Method::DaunNonNegative) {
            for (holes, weighted) in [(false, false), (true, false), (false, true), (true, true)] {
                let (mut values, _) = gaussian(1, columns, centre, 7.0);
                if holes {
                    values[4] = f64::NAN;
                    (16..24).for_each(|c| values[c] = f64::NAN);
                }
                let sigmas: Vec<f64> = (0..columns).map(|c| 1e-5 * (2.0 + pseudo_noise(c))).collect();
                let run = |values: &[f64]| {
                    let image = Columns { values, sigmas: Some(&sigmas), rows: 1, columns };
                    invert(&image, &Settings { weighted, ..settings(method, centre) }).unwrap()
                };
                let first = run(&values);
                let mut sums = vec![0.0; columns];
                for c in (0..columns).filter(|&c| values[c].is_finite()) {
                    let mut moved = values.clone();
                    moved[c] += sigmas[c];
                    let then = run(&moved);
                    for (i, sum) in sums.iter_mut().enumerate() {
                        *sum += (then.alpha_per_m[i] - first.alpha_per_m[i]).powi(2);
                    }
                }
                for (i, sum) in sums.iter().enumerate() {
                    let (told, measured) = (first.sigma_alpha[i], sum.sqrt());
                    if first.alpha_per_m[i].is_nan() {
                        assert!(told.is_nan() && first.flags[i] & flag::HIDDEN != 0);
                    } else {
                        let close = (told - measured).abs() < 1e-6 * measured + 1e-12;
                        assert!(close, "{method:?} {centre} {holes} {i}: {told} {measured}");
                    }
                }
            }
        }
    }
}

/// A hole about the axis leaves what is outside of it as it is; a hole on one side nothing but a flag.
#[test]
fn holes_hide_what_they_must_and_no_more() {
    let (columns, centre) = (61, 30.0);
    let (whole, truth) = gaussian(2, columns, centre, 9.0);
    for method in Method::ALL {
        let mut values = whole.clone();
        (25..36).for_each(|c| values[c] = f64::NAN);
        values[columns + 50] = f64::NAN;
        let wanted = Settings { strength: Strength::Automatic, ..settings(method, centre) };
        let image = Columns { values: &values, sigmas: None, rows: 2, columns };
        let found = invert(&image, &wanted).unwrap();
        for c in 0..columns {
            let inside = (25..36).contains(&c);
            assert_eq!(found.alpha_per_m[c].is_nan(), inside, "{method:?} {c}");
            assert_eq!(found.flags[c] & flag::HIDDEN != 0, inside);
            assert_eq!(found.flags[c] & flag::NO_INPUT != 0, inside);
            if !inside {
                // Next to the hole the strength has only one neighbour to hold on to.
                let error = (found.alpha_per_m[c] - truth[c]).abs();
                assert!(error < 0.05, "{method:?} {c} {error}");
            }
            let other = columns + c;
            assert!((found.alpha_per_m[other] - truth[other]).abs() < 0.03, "{method:?} {c}");
            let beside = c == 50 || c == 10;
            assert_eq!(found.flags[other] & flag::ONE_SIDE != 0, beside, "{method:?} {c}");
        }
        assert_ne!(found.flags[columns + 50] & flag::NO_INPUT, 0);
    }
}

/// Elements of every degree, on whole rows and beside a hole about the axis, free and bounded, about any axis.
#[test]
fn elements_of_every_degree_find_a_gaussian() {
    for (columns, centre) in PHASES {
        for elements in Elements::ALL {
            for method in [Method::Daun, Method::DaunNonNegative] {
                let (mut values, truth) = gaussian(2, columns, centre, 6.0);
                let hole = |c: usize| (radius(c, 0.0) - centre).abs() < 5.0;
                (0..columns).filter(|&c| hole(c)).for_each(|c| values[c] = f64::NAN);
                let wanted =
                    Settings { elements, strength: Strength::Fixed(1e-6), ..settings(method, centre) };
                let image = Columns { values: &values, sigmas: None, rows: 2, columns };
                let found = invert(&image, &wanted).unwrap();
                for (i, (got, want)) in found.alpha_per_m.iter().zip(&truth).enumerate() {
                    if i < columns && hole(i) {
                        assert!(got.is_nan());
                    } else {
                        // The last radius takes what lies beyond; interpolated axes miss pixels beside the hole too.
                        let known = got.is_finite() || i < columns;
                        let error = if got.is_finite() { (got - want).abs() } else { 0.0 };
                        assert!(known && error < 0.04, "{elements:?} {method:?} {centre} {i}: {got} {want}");
                    }
                }
            }
        }
    }
}

#[test]
fn nasty_images_give_numbers_or_flags() {
    for method in Method::ALL {
        for columns in 1..6 {
            for values in
                [vec![0.0; columns], vec![1.0; columns], vec![f64::NAN; columns], vec![-3.0; columns]]
            {
                let wanted =
                    Settings { centre: None, strength: Strength::Automatic, ..settings(method, 0.0) };
                let image = Columns { values: &values, sigmas: None, rows: 1, columns };
                let found = invert(&image, &wanted).unwrap();
                for (i, value) in found.alpha_per_m.iter().enumerate() {
                    assert_eq!(
                        value.is_nan(),
                        found.flags[i] & flag::HIDDEN != 0,
                        "{method:?} {columns} {values:?}"
                    );
                    assert!(value.is_nan() == values[0].is_nan());
                    assert!(values[0] != 0.0 || *value == 0.0);
                }
            }
        }
        // Magnitudes whose squares are beyond f64, beside rows of nothing.
        let (mut values, truth) = gaussian(3, 41, 20.0, 6.0);
        values[..41].iter_mut().for_each(|v| *v *= 1e250);
        values[82..].fill(0.0);
        let image = Columns { values: &values, sigmas: None, rows: 3, columns: 41 };
        let found = invert(&image, &settings(method, 20.0)).unwrap();
        assert!((found.alpha_per_m[14] / 1e250 - truth[14]).abs() < 0.04, "{method:?}");
        assert!(found.alpha_per_m[82..].iter().all(|v| *v == 0.0));
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let image = Columns { values: &[1.0; 6], sigmas: None, rows: 2, columns: 3 };
    let good = settings(Method::Fourier, 1.0);
    assert!(invert(&image, &good).is_ok());
    let wrong = [
        Settings { centre: Some(3.0), ..good },
        Settings { centre: Some(f64::NAN), ..good },
        Settings { pixel_m: 0.0, ..good },
        Settings { strength: Strength::Fixed(-1.0), ..good },
        Settings { strength: Strength::Fixed(f64::NAN), ..good },
    ];
    assert!(wrong.iter().all(|settings| invert(&image, settings).is_err()));
    let shapes = [
        Columns { values: &[1.0; 5], ..image },
        Columns { sigmas: Some(&[1.0; 5]), ..image },
        Columns { rows: 0, values: &[], ..image },
    ];
    assert!(shapes.iter().all(|image| invert(image, &good).is_err()));
}

/// A column below zero has no answer above: the bounded method gives zero there and says so, and what is positive is not
/// worse than before.
#[test]
fn bounded_answers_are_not_negative() {
    let (columns, centre) = (61, 30.0);
    let (mut values, truth) = gaussian(20, columns, centre, 6.0);
    values.iter_mut().enumerate().for_each(|(i, v)| *v += 2e-4 * pseudo_noise(i));
    let image = Columns { values: &values, sigmas: None, rows: 20, columns };
    let run = |method| {
        invert(&image, &Settings { strength: Strength::Automatic, ..settings(method, centre) }).unwrap()
    };
    let (free, bound) = (run(Method::Daun), run(Method::DaunNonNegative));
    assert!(free.alpha_per_m.iter().any(|a| *a < 0.0));
    assert!(bound.alpha_per_m.iter().all(|a| *a >= 0.0));
    let at_bound = bound.flags.iter().filter(|f| **f & flag::AT_BOUND != 0).count();
    assert!(at_bound > 100 && bound.flags.iter().all(|f| f & flag::NOT_SETTLED == 0));
    let error =
        |found: &Inverted| found.alpha_per_m.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    assert!(error(&bound) < error(&free));
}

/// A row that does not end at zero is flagged, and a strength too weak for the noise is not taken because σ was told
/// too small.
#[test]
fn ends_and_noise_are_judged() {
    let (columns, centre) = (81, 40.0);
    let (mut values, _) = gaussian(30, columns, centre, 12.0);
    let noise = 1e-4;
    values.iter_mut().enumerate().for_each(|(i, v)| *v += noise * pseudo_noise(i * 31 + i / 7));
    let ask = |values: &[f64], sigma: Option<f64>| {
        let sigmas = sigma.map(|sigma| vec![sigma; values.len()]);
        let image = Columns { values, sigmas: sigmas.as_deref(), rows: 30, columns };
        let wanted = Settings { strength: Strength::Automatic, ..settings(Method::Fourier, centre) };
        invert(&image, &wanted).unwrap()
    };
    // The noise above is uniform: σ is 1/√3 of its amplitude.
    let by_data = ask(&values, None);
    let by_sigma = ask(&values, Some(noise / 3.0_f64.sqrt()));
    let too_small = ask(&values, Some(0.1 * noise));
    assert!(too_small.discrepancy_failed == 30 && too_small.strength == by_data.strength);
    assert!(by_sigma.strength.iter().zip(&by_data.strength).all(|(a, b)| a <= b));
    assert!(by_data.flags.iter().all(|f| f & flag::TRUNCATED == 0));
    let raised: Vec<f64> = values.iter().map(|v| v + 0.002).collect();
    assert!(ask(&raised, None).flags.iter().all(|f| f & flag::TRUNCATED != 0));
}

/// The same bits for any number of threads.
#[test]
fn threads_change_nothing() {
    let (values, _) = gaussian(70, 41, 20.0, 6.0);
    let image = Columns { values: &values, sigmas: None, rows: 70, columns: 41 };
    for method in Method::ALL {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let found = pool.install(|| invert(&image, &settings(method, 20.0))).unwrap();
            found.alpha_per_m.iter().chain(&found.sigma_alpha).map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(run(1), run(3), "{method:?}");
    }
}

/// Normal variables, the sum of twelve uniform ones each.
fn normals() -> impl FnMut() -> f64 {
    let mut state = 5_u64;
    move || {
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(u32::try_from(state >> 40).unwrap()) / 16_777_216.0 - 0.5
        };
        (0..12).map(|_| uniform()).sum()
    }
}

/// Where σ varies tenfold within rows, from pixel to pixel or from the axis outwards, columns that count by 1/σ² give a smaller
/// error than columns that count alike, and the σ that is told is that of the error. With the same σ everywhere weights
/// change nothing, and methods that fit nothing take none.
#[test]
fn weights_within_a_row_pay_where_its_sigmas_differ() {
    let (rows, columns, centre) = (60, 122, 60.5);
    let (clean, truth) = gaussian(rows, columns, centre, 20.0);
    let peak = clean.iter().copied().fold(0.0, f64::max);
    let by_pixel = |i: usize| libm::pow(10.0, 0.5 * pseudo_noise(i) - 0.5);
    let by_radius = |i: usize| libm::pow(10.0, -(radius(i % columns, -centre) / centre).abs());
    let kinds: [&dyn Fn(usize) -> f64; 2] = [&by_pixel, &by_radius];
    for kind in kinds {
        let sigmas: Vec<f64> = (0..rows * columns).map(|i| 0.02 * peak * kind(i)).collect();
        let mut normal = normals();
        let values: Vec<f64> = clean.iter().zip(&sigmas).map(|(v, s)| v + s * normal()).collect();
        // So weak that errors are noise, not what is smoothed away.
        for (method, strength) in [(Method::Daun, 30.0), (Method::Basex, 3.0), (Method::Fourier, 12.0)] {
            let (strength, elements) = (Strength::Fixed(strength), Elements::Linear);
            let run = |sigmas: &[f64], weighted| {
                let image = Columns { values: &values, sigmas: Some(sigmas), rows, columns };
                let wanted = Settings { strength, elements, weighted, ..settings(method, centre) };
                invert(&image, &wanted).unwrap()
            };
            let judge = |found: &Inverted| {
                let (mut error, mut z, mut n) = (0.0, 0.0, 0.0);
                for (i, truth) in
                    truth.iter().enumerate().filter(|(i, _)| (8..columns - 8).contains(&(i % columns)))
                {
                    let off = found.alpha_per_m[i] - truth;
                    error += off * off;
                    z += (off / found.sigma_alpha[i]).powi(2);
                    n += 1.0;
                }
                ((error / n).sqrt(), (z / n).sqrt())
            };
            let (alike, weighted) = (judge(&run(&sigmas, false)), judge(&run(&sigmas, true)));
            assert!(weighted.0 < 0.95 * alike.0, "{method:?}: {weighted:?} {alike:?}");
            assert!((0.8..1.2).contains(&weighted.1), "{method:?}: {weighted:?}");
            let same = vec![0.01 * peak; rows * columns];
            let (common, own) = (run(&same, false), run(&same, true));
            for (a, b) in common.alpha_per_m.iter().zip(&own.alpha_per_m) {
                assert!((a - b).abs() < 1e-6, "{method:?} {a} {b}");
            }
        }
        let image = Columns { values: &values, sigmas: Some(&sigmas), rows, columns };
        let dasch = |weighted| {
            invert(&image, &Settings { weighted, ..settings(Method::ThreePoint, centre) })
                .unwrap()
                .alpha_per_m
        };
        assert_eq!(dasch(false), dasch(true));
    }
}
