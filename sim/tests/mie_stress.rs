//! Mie theory under stress: random and extreme spheres keep the laws, give the same bits in any company, and answer
//! smoothly; what has no answer is refused by name.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use ditd_sim::light::mie::{
    Direction, Efficiencies, Lognormal, MieError, Sphere, amplitudes, amplitudes_towards, cumulative,
    efficiencies, efficiencies_of_many, lognormal, phase,
};
use ditd_sim::light::quadrature::gauss_legendre;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        rng_seed: RngSeed::Fixed(20_261_126),
        failure_persistence: None,
        ..Default::default()
    }
}

/// Any sphere that takes less than 3e4 orders: x from 1e-10 to 1e3, n from 0.01 to 100, k 0 or from 1e-16 to 100.
fn any_sphere() -> impl Strategy<Value = Sphere> {
    let k = prop_oneof![1 => Just(0.0), 3 => (-16.0f64..2.0).prop_map(|e| 10f64.powf(e))];
    (-10.0f64..3.0, -2.0f64..2.0, k).prop_map(|(x, n, k)| {
        let n = 10f64.powf(n);
        let size_parameter = 10f64.powf(x).min(3e4 / n.hypot(k));
        Sphere { size_parameter, n, k }
    })
}

/// Spheres whose patterns take few orders.
fn quick_sphere() -> impl Strategy<Value = Sphere> {
    let k = prop_oneof![1 => Just(0.0), 3 => (-14.0f64..1.5).prop_map(|e| 10f64.powf(e))];
    (-6.0f64..1.8, -1.5f64..1.0, k).prop_map(|(x, n, k)| Sphere {
        size_parameter: 10f64.powf(x),
        n: 10f64.powf(n),
        k,
    })
}

fn alone(sphere: Sphere) -> Efficiencies {
    efficiencies(sphere.size_parameter, sphere.n, sphere.k).unwrap()
}

fn bits(q: Efficiencies) -> [u64; 5] {
    [q.q_ext, q.q_sca, q.q_abs, q.q_back, q.asymmetry].map(f64::to_bits)
}

/// |d ln q / d ln x| and the same for the index, at most, by differences. Lines narrower than the step are missed; in
/// these samples there are none.
fn condition(sphere: Sphere) -> f64 {
    let step = 1e-9;
    let at =
        |x: f64, n: f64, k: f64| efficiencies(sphere.size_parameter * x, sphere.n * n, sphere.k * k).unwrap();
    let here = alone(sphere);
    [at(1.0 + step, 1.0, 1.0), at(1.0 - step, 1.0, 1.0), at(1.0, 1.0 + step, 1.0), at(1.0, 1.0, 1.0 + step)]
        .iter()
        .flat_map(|q| [q.q_ext / here.q_ext, q.q_sca / here.q_sca])
        .fold(0.0, |worst, ratio| (f64::abs(ratio - 1.0) / step).max(worst))
}

/// What an amplitude may be off by: 1e-13 of the largest, and the rounding of x and m.
fn slack(sphere: Sphere, largest: f64) -> f64 {
    (1e-13 * (1.0 + sphere.size_parameter / 100.0) + 2.2e-16 * 8.0 * condition(sphere)) * largest
}

fn assert_sane(sphere: Sphere, q: Efficiencies) {
    let what = format!("{sphere:?}: {q:?}");
    assert!([q.q_ext, q.q_sca, q.q_abs, q.q_back, q.asymmetry].iter().all(|v| v.is_finite()), "{what}");
    assert!(q.q_sca >= 0.0 && q.q_back >= 0.0 && q.asymmetry.abs() <= 1.0, "{what}");
    assert!(if sphere.k > 0.0 { q.q_abs >= 0.0 } else { q.q_abs == 0.0 }, "{what}");
    assert_eq!(q.q_ext.to_bits(), (q.q_sca + q.q_abs).to_bits(), "{what}");
}

proptest! {
    #![proptest_config(cases(400))]

    #[test]
    fn any_sphere_has_a_sane_answer(sphere in any_sphere()) {
        let q = alone(sphere);
        assert_sane(sphere, q);
        // Nothing here is so small that it may vanish: 1e-300 is far below (1e-10)⁴ |m − 1|².
        prop_assert!(q.q_sca > 0.0 && (q.q_abs > 0.0 || sphere.k == 0.0), "{q:?}");
    }
}

proptest! {
    #![proptest_config(cases(60))]

    #[test]
    fn company_and_order_do_not_change_a_bit(
        spheres in prop::collection::vec(any_sphere(), 1..40),
        turn in 0usize..40,
    ) {
        let together = efficiencies_of_many(&spheres).unwrap();
        let mut turned = spheres.clone();
        turned.rotate_left(turn % spheres.len());
        turned.reverse();
        let mut again = efficiencies_of_many(&turned).unwrap();
        again.reverse();
        again.rotate_right(turn % spheres.len());
        for ((sphere, a), b) in spheres.iter().zip(&together).zip(&again) {
            prop_assert_eq!(bits(*a), bits(alone(*sphere)), "{:?}", sphere);
            prop_assert_eq!(bits(*a), bits(*b), "{:?}", sphere);
        }
    }

    #[test]
    fn neighbours_in_size_do_not_change_a_bit(start in -3.0f64..2.3, step in 1e-4f64..0.02, count in 1usize..70) {
        // As in a size distribution: the batch of like spheres, also where the series get one order longer.
        let spheres: Vec<Sphere> = (0..count)
            .map(|i| Sphere { size_parameter: 10f64.powf(start + step * i as f64), n: 1.38, k: 0.09 })
            .collect();
        for (sphere, q) in spheres.iter().zip(efficiencies_of_many(&spheres).unwrap()) {
            prop_assert_eq!(bits(q), bits(alone(*sphere)), "{:?} of {}", sphere, count);
        }
    }
}

proptest! {
    #![proptest_config(cases(150))]

    #[test]
    fn amplitudes_obey_the_theorems(sphere in quick_sphere()) {
        let x = sphere.size_parameter;
        let q = alone(sphere);
        let ends = amplitudes(x, sphere.n, sphere.k, &[1.0, -1.0]).unwrap();
        let ((forward, forward_2), (back, back_2)) = (ends[0], ends[1]);
        let slack = slack(sphere, forward.abs().max(back.abs()));
        // Forward and back, both polarisations are one.
        prop_assert!((forward - forward_2).abs() <= slack);
        prop_assert!((back + back_2).abs() <= slack);
        // The optical theorem, and the radar cross-section.
        let per = 4.0 / (x * x);
        prop_assert!((per * forward.re - q.q_ext).abs() <= per * slack, "{} {q:?}", per * forward.re);
        let radar = per * back.norm_sqr();
        let allowed = per * (2.0 * back.abs() + slack) * slack;
        prop_assert!((radar - q.q_back).abs() <= allowed, "{radar} {q:?}");
    }

    #[test]
    fn cosines_and_angles_give_the_same_amplitudes(sphere in quick_sphere(), theta in 1.0f64..179.0) {
        let by_angle = amplitudes_towards(sphere, &[Direction::from_degrees(theta).unwrap()]).unwrap()[0];
        let cosine = theta.to_radians().cos();
        let by_cosine = amplitudes(sphere.size_parameter, sphere.n, sphere.k, &[cosine, 1.0]).unwrap();
        // The cosine is rounded by 2⁻⁵³, the amplitude is a polynomial of degree N in it: N² times that at most
        // (Markov), N = x + 10 (1 + x)^(1/3).
        let degree = sphere.size_parameter + 10.0 * (1.0 + sphere.size_parameter).cbrt();
        let largest = by_cosine[1].0.abs().max(by_cosine[0].0.abs()).max(by_cosine[0].1.abs());
        let allowed = 2.0 * slack(sphere, largest) + 2.2e-16 * degree * degree * largest;
        prop_assert!((by_angle.0 - by_cosine[0].0).abs() <= allowed);
        prop_assert!((by_angle.1 - by_cosine[0].1).abs() <= allowed);
    }
}

proptest! {
    #![proptest_config(cases(40))]

    #[test]
    fn patterns_hold_all_light_and_have_the_mean_cosine(sphere in quick_sphere()) {
        let q = alone(sphere);
        let x = sphere.size_parameter;
        // p₁₁ is a polynomial of degree 2N in μ: N + 1 nodes are exact.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a hundred or so")]
        let rule = gauss_legendre((x + 7.4 * x.cbrt() + 6.0) as usize);
        let towards: Vec<Direction> = rule.iter().map(|&(mu, _)| Direction::from_cosine(mu).unwrap()).collect();
        let p = phase(sphere, &towards).unwrap();
        let largest = p.iter().fold(0.0f64, |a, &b| a.max(b)).max(phase(sphere, &[Direction::from_versine(0.0)]).unwrap()[0]);
        let (mut all, mut forward, mut allowed) = (0.0, 0.0, 2.2e-16 * (64.0 + x + 8.0 * condition(sphere)));
        for (&(mu, weight), p) in rule.iter().zip(&p) {
            all += 0.5 * weight * p;
            forward += 0.5 * weight * p * mu;
            // δp = 2 |S| δS, with δS relative to the largest |S|.
            allowed += 0.5 * weight * 2.0 * (p * largest).sqrt() * slack(sphere, 1.0);
        }
        prop_assert!((all - 1.0).abs() <= allowed, "{all}");
        prop_assert!((forward - q.asymmetry).abs() <= allowed, "{forward} {q:?}");
        let half = cumulative(sphere, &[Direction::from_versine(2.0), Direction::from_versine(0.0)]).unwrap();
        prop_assert!((half[0] - 1.0).abs() <= allowed + 1e-12 && half[1] == 0.0, "{half:?}");
    }

    #[test]
    fn the_scattered_fraction_never_falls_with_the_angle(sphere in quick_sphere()) {
        let towards: Vec<Direction> =
            (0..=36).map(|i| Direction::from_degrees(5.0 * f64::from(i)).unwrap()).collect();
        let fractions = cumulative(sphere, &towards).unwrap();
        prop_assert!(fractions.is_sorted_by(|a, b| *b - *a >= -1e-12), "{fractions:?}");
    }
}

#[test]
fn the_largest_spheres_end_in_time_with_sane_answers() {
    for (size_parameter, n, k) in [
        (1e6, 1.4, 0.08),
        (1e6, 1.33, 0.0),
        (1e6, 0.01, 0.0),
        (1e6, 1.0 + 1e-12, 0.0),
        (1e6, 0.02, 1e-14),
        (1e5, 1.4, 1e-14),
        (1e4, 100.0, 0.0),
        (1e4, 100.0, 100.0),
        (1e4, 0.01, 100.0),
        (1e-10, 100.0, 100.0),
        (1e-10, 0.01, 1e-14),
        (1e-10, 1.0 + 1e-12, 0.0),
    ] {
        let sphere = Sphere { size_parameter, n, k };
        let q = alone(sphere);
        assert_sane(sphere, q);
        assert!(q.q_sca > 0.0, "{sphere:?} {q:?}");
    }
}

#[test]
fn spheres_at_zeros_of_the_functions_lose_nothing() {
    // sin x = 0, cos x = 0, tan x = x as near as doubles come, inside and outside; the neighbours tell what is due.
    for zero in
        [std::f64::consts::PI, 0.5 * std::f64::consts::PI, 4.493_409_457_909_064, 7.725_251_836_937_707]
    {
        for times in [1.0, 2.0, 3.0, 10.0, 33.0] {
            for (n, k) in [(1.4, 0.0), (1.33, 0.01), (2.0, 1e-9)] {
                for x in [zero * times, zero * times / n] {
                    let [low, here, high] =
                        [1.0 - 1e-10, 1.0, 1.0 + 1e-10].map(|f| efficiencies(x * f, n, k).unwrap());
                    let rest = (here.q_sca - 0.5 * (low.q_sca + high.q_sca)).abs() / here.q_sca;
                    // Linear between them but for rounding: (1e-10 c)² with c < 1e4 off the sharpest lines.
                    let c = (high.q_sca / low.q_sca - 1.0).abs() / 2e-10;
                    let allowed = 4.0 * 2.2e-16 * (64.0 + 8.0 * c + x) + 1e-12 * c.max(1.0).powi(2) * 1e-6;
                    assert!(rest < allowed, "x {x}, {n} + {k} i: {rest:e} against {allowed:e}");
                }
            }
        }
    }
}

/// Largest fourth difference of ln q over a scan even in ln x.
fn fourth_differences(from: f64, step: f64, count: usize) -> Vec<(f64, [f64; 4])> {
    let spheres: Vec<Sphere> = (0..count)
        .map(|i| Sphere { size_parameter: from * (step * i as f64).exp(), n: 1.38, k: 0.09 })
        .collect();
    let logs: Vec<[f64; 4]> = efficiencies_of_many(&spheres)
        .unwrap()
        .iter()
        .map(|q| [q.q_ext, q.q_sca, q.q_abs, q.asymmetry].map(f64::ln))
        .collect();
    logs.windows(5)
        .zip(&spheres)
        .map(|(w, sphere)| {
            let difference = |c: usize| w[0][c] - 4.0 * w[1][c] + 6.0 * w[2][c] - 4.0 * w[3][c] + w[4][c];
            (sphere.size_parameter, [0, 1, 2, 3].map(difference))
        })
        .collect()
}

#[test]
fn efficiencies_are_smooth_across_every_switch() {
    // Where a program changes its method the answers jump by the sum of both errors. ln q is analytic in ln x: for small
    // spheres a straight line and a series in x², with fourth derivative below 16 · 4 x²; for large ones waves of at most
    // 2x + 2 radians per unit of ln x. Rounding of ln q is amplified by 16 = 1 + 4 + 6 + 4 + 1, that of ln x by 16 c ln x.
    let rounding =
        |x: f64| 16.0 * (2.2e-16 * (64.0 + 8.0 * 4.0 + x) + 4.0 * 2.2e-16 * f64::ln(x).abs().max(24.0));
    let small = fourth_differences(1e-10, 0.002, 11_500)
        .into_iter()
        .map(|(x, d)| (x, d, 0.002f64.powi(4) * 64.0 * x * x));
    let waves = |x: f64| 1e-5f64.powi(4) * (2.0 * x + 2.0).powi(4);
    let large = fourth_differences(0.1, 1e-5, 530_000).into_iter().map(|(x, d)| (x, d, waves(x)));
    for (x, differences, curvature) in small.chain(large) {
        for (column, difference) in differences.iter().enumerate() {
            let allowed = rounding(x) + curvature;
            assert!(difference.abs() < allowed, "x {x}, column {column}: {difference:e} against {allowed:e}");
        }
    }
}

#[test]
fn what_has_no_answer_is_refused_by_every_function() {
    let nan = f64::NAN;
    let infinite = f64::INFINITY;
    let ahead = [Direction::from_versine(0.0)];
    for (x, n, k) in [
        (-1.0, 1.4, 0.1),
        (-1e-300, 1.4, 0.1),
        (nan, 1.4, 0.1),
        (infinite, 1.4, 0.1),
        (1.0, 0.0, 0.1),
        (1.0, -1.4, 0.1),
        (1.0, nan, 0.1),
        (1.0, infinite, 0.1),
        (1.0, 1.4, -1e-300),
        (1.0, 1.4, nan),
        (1.0, 1.4, infinite),
        (1.0, 1e-4, 0.0),
        (1.0, 1e5, 0.0),
    ] {
        let sphere = Sphere { size_parameter: x, n, k };
        let wanted = |error: &MieError| match error {
            MieError::Size(_) => !(0.0..infinite).contains(&x),
            MieError::Index { .. } => true,
            _ => false,
        };
        assert!(efficiencies(x, n, k).is_err_and(|e| wanted(&e)), "{sphere:?}");
        assert!(amplitudes_towards(sphere, &ahead).is_err_and(|e| wanted(&e)), "{sphere:?}");
        assert!(phase(sphere, &ahead).is_err_and(|e| wanted(&e)), "{sphere:?}");
        assert!(cumulative(sphere, &ahead).is_err_and(|e| wanted(&e)), "{sphere:?}");
        let good = Sphere { size_parameter: 1.0, n: 1.4, k: 0.1 };
        assert!(
            efficiencies_of_many(&[good, good, sphere, sphere]).is_err_and(|(at, e)| at == 2 && wanted(&e))
        );
    }
    let sizes = Lognormal { median_radius_um: 5.0, sigma_ln: 0.5 };
    for (sizes, wavelength) in [
        (Lognormal { median_radius_um: -5.0, ..sizes }, 3.4),
        (Lognormal { median_radius_um: nan, ..sizes }, 3.4),
        (Lognormal { sigma_ln: -0.1, ..sizes }, 3.4),
        (Lognormal { sigma_ln: nan, ..sizes }, 3.4),
        (sizes, 0.0),
        (sizes, nan),
    ] {
        assert!(matches!(lognormal(sizes, wavelength, 1.4, 0.1, 1e-6), Err(MieError::Distribution { .. })));
    }
    assert!(matches!(lognormal(sizes, 3.4, 1.4, -0.1, 1e-6), Err(MieError::Index { .. })));
}
