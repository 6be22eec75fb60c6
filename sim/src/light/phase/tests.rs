//! Laws of every phase function, proved on all kinds: normalised, sampled as evaluated, with the mean cosine it claims.

use super::inverse::{angle, versine};
use super::*;
use crate::light::mie::Sphere;
use crate::light::quadrature::gauss_legendre;
use proptest::prelude::*;

/// Four spheres with numbers of droplets: a small spray.
pub(super) const SPRAY: ([f64; 4], [f64; 4]) = ([2.0, 6.5, 14.0, 31.0], [1.0, 0.3, 0.05, 0.01]);

pub(super) fn spray() -> Vec<Sphere> {
    SPRAY.0.iter().map(|&size_parameter| Sphere { size_parameter, n: 1.38, k: 0.09 }).collect()
}

fn table(nodes: u32, p: impl Fn(f64) -> f64) -> PhaseFunction {
    let theta: Vec<f64> = (0..=nodes).map(|i| PI * f64::from(i) / f64::from(nodes)).collect();
    let p: Vec<f64> = theta.iter().map(|&t| p(t)).collect();
    PhaseFunction::Table(Arc::new(PhaseTable::new(&theta, &p).unwrap().0))
}

/// Every kind, with nasty ones: two nodes, gaps without light, a narrow peak, one size of large spheres.
fn all() -> Vec<(String, PhaseFunction)> {
    let mut list = vec![
        ("isotropic".to_owned(), PhaseFunction::Isotropic),
        ("rayleigh".to_owned(), PhaseFunction::Rayleigh),
        ("peak".to_owned(), table(360, |t| 260.0 * (-t * t / 0.01).exp() + 0.4 + 0.2 * (9.0 * t).cos())),
        ("two nodes".to_owned(), table(1, |t| if t > 1.0 { 0.0 } else { 1.0 })),
        ("zigzag".to_owned(), table(40, |t| if (t * 40.0 / PI).round() % 2.0 == 0.0 { 0.0 } else { 1.0 })),
        ("gap".to_owned(), table(30, |t| if (1.0..2.0).contains(&t) { 0.0 } else { 1.0 })),
    ];
    for asymmetry in [-0.999, -0.5, -1e-9, 0.0, 1e-9, 0.3, 0.85, 0.99] {
        list.push((format!("hg {asymmetry}"), PhaseFunction::HenyeyGreenstein { asymmetry }));
    }
    let mie = mie::of_spheres(&spray(), &SPRAY.1, mie::DISTRIBUTION_ERROR).unwrap().phase;
    let large = Sphere { size_parameter: 200.0, n: 1.4, k: 1e-3 };
    let large = mie::of_spheres(&[large], &[1.0], mie::DISTRIBUTION_ERROR).unwrap().phase;
    let cut = truncation::cone(&mie, 0.03).unwrap().phase;
    list.extend([("spray".to_owned(), mie), ("large".to_owned(), large), ("cut".to_owned(), cut)]);
    list
}

/// ∫ weight(v) p/2 dv between two angles, by a rule that shares nothing with the sampler but the break points: twelve
/// Gauss points between those, halved often enough for the peaks.
fn integral(phase: &PhaseFunction, from: f64, to: f64, weight: impl Fn(f64) -> f64) -> f64 {
    let rule = gauss_legendre(12);
    let mut bounds: Vec<f64> =
        phase.smooth_between().into_iter().filter(|t| (from..=to).contains(t)).collect();
    bounds.extend([from, to]);
    bounds.sort_unstable_by(f64::total_cmp);
    let mut sum = 0.0;
    for t in bounds.windows(2) {
        for part in 0..4 {
            let step = 0.125 * (t[1] - t[0]);
            let middle = t[0] + step * f64::from(2 * part + 1);
            for (x, w) in &rule {
                let theta = middle + step * x;
                let v = versine(theta);
                sum += 0.5 * w * step * theta.sin() * weight(v) * phase.at_versine(v);
            }
        }
    }
    sum
}

#[test]
fn every_phase_function_is_normalised_and_has_its_mean_cosine() {
    for (name, phase) in all() {
        let norm = integral(&phase, 0.0, PI, |_| 1.0);
        // Backward peaks are known as finely as 1 − cos θ = 2 − … is.
        let allowed = 1e-12 + 2.3e-16 * phase.value(-1.0);
        assert!((norm - 1.0).abs() < allowed, "{name}: {norm}");
        // The cells of a table that is zero at a node carry its mean to 1e-10 each.
        let mean = 1.0 - integral(&phase, 0.0, PI, |v| v);
        assert!((mean - phase.mean_cosine()).abs() < 1e-9, "{name}: {mean} {}", phase.mean_cosine());
    }
}

/// The distribution of samples is that of `value`: `within` inverts `sample` to rounding, and is the integral of
/// `value` (to the stated error for tables).
#[test]
fn the_inverse_is_the_inverse_of_the_integral_of_the_value() {
    for (name, phase) in all() {
        let allowed = if matches!(phase, PhaseFunction::Table(_)) { SAMPLING_ERROR } else { 1e-12 };
        let (mut theta, mut sum) = (0.0, 0.0);
        for i in (0..=200).rev() {
            let u = f64::from(i) / 200.0;
            let cosine = phase.sample(u);
            // A cosine has an ulp of 1.1e-16, which is p/2 times as much of the light; the closed form of Henyey and
            // Greenstein's inverse loses two digits of it near the far end.
            let rounding = 1e-12 + 1e-14 * phase.value(cosine);
            let share = phase.within(cosine);
            let dark = phase.value(cosine) == 0.0;
            assert!((share - (1.0 - u)).abs() < rounding || dark, "{name} {u}: {share}");
            let next = angle(1.0 - cosine);
            sum += integral(&phase, theta, next.max(theta), |_| 1.0);
            theta = next.max(theta);
            assert!((sum - share).abs() < allowed + rounding, "{name} {u}: {sum} {share}");
        }
    }
}

/// dμ/du = 2/p: by central differences with step h, whose error is h²/6 of the third derivative.
#[test]
fn samples_thin_out_as_the_value_says() {
    for (name, phase) in all() {
        let (mut good, mut asked) = (0, 0);
        for i in 1..400 {
            let (u, h) = (f64::from(i) / 400.0, 1e-6);
            let (low, high) = (phase.sample(u - h), phase.sample(u + h));
            let slope = (high - low) / (2.0 * h);
            let value = phase.value(phase.sample(u));
            // Within h of an end of a cell or of a place without light the slope is that of two cells.
            asked += 1;
            good += i32::from((slope * value / 2.0 - 1.0).abs() < 2e-3);
        }
        assert!(good >= asked - 8, "{name}: {good} of {asked}");
    }
}

/// Which of 64 equal steps an angle is in.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an angle within 0 and π")]
fn bin(theta: f64) -> usize {
    ((theta * 64.0 / PI) as usize).min(63)
}

/// χ² of 64 bins of equal angle against the integral of `value`, 400 000 samples. The largest of 17 such numbers stays
/// below 115, the 1 − 7e-5 quantile of χ²(63), with probability 0.999.
#[test]
fn samples_are_distributed_as_evaluated() {
    let seed = 0x9e37_79b9_7f4a_7c15_u64;
    for (name, phase) in all() {
        let mut state = seed;
        let n = 400_000;
        let mut counts = [0.0; 64];
        for _ in 0..n {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let u = f64::from(u32::try_from(state >> 32).unwrap()) / 4_294_967_296.0;
            let theta = phase.sample(u).acos();
            counts[bin(theta)] += 1.0;
        }
        let (mut chi2, mut rest, mut rest_expected) = (0.0, 0.0, 0.0);
        for (b, count) in (0..64u8).zip(counts) {
            let edges = [b, b + 1].map(|b| PI * f64::from(b) / 64.0);
            let expected = f64::from(n) * integral(&phase, edges[0], edges[1], |_| 1.0);
            if expected < 8.0 {
                rest += count;
                rest_expected += expected;
            } else {
                chi2 += (count - expected) * (count - expected) / expected;
            }
        }
        if rest_expected > 1.0 {
            chi2 += (rest - rest_expected) * (rest - rest_expected) / rest_expected;
        }
        assert!(chi2 < 115.0, "{name}: chi2 {chi2} seed {seed}");
    }
}

#[test]
fn limits_of_the_asymmetry_give_no_nan() {
    for asymmetry in [-1.0, -0.9999, -0.0, 0.0, 5e-324, 0.9999, 1.0] {
        let phase = PhaseFunction::HenyeyGreenstein { asymmetry };
        for i in 0..=64 {
            let mu = phase.sample(f64::from(i) / 64.0);
            assert!((-1.0..=1.0).contains(&mu));
            assert!(phase.value(mu).is_finite());
            assert!((0.0..=1.0).contains(&phase.within(mu)));
        }
    }
    for (name, phase) in all() {
        for u in [0.0, 5e-324, 1e-17, 0.5, 1.0 - f64::EPSILON / 2.0, 1.0] {
            let mu = phase.sample(u);
            assert!((-1.0..=1.0).contains(&mu) && phase.value(mu) >= 0.0, "{name} {u}: {mu}");
        }
        for mu in [-2.0, -1.0, -0.0, 1.0, 2.0] {
            assert!(phase.value(mu).is_finite() && phase.within(mu).is_finite(), "{name} {mu}");
        }
    }
}

/// The contract of a table: linear in the angle, to rounding.
#[test]
fn a_table_is_linear_in_the_angle() {
    let theta = [0.0, 0.02, 0.3, 1.5, 2.0, PI];
    let p = [900.0, 40.0, 2.0, 0.0, 0.1, 0.3];
    let (table, norm) = PhaseTable::new(&theta, &p).unwrap();
    for i in 0..5 {
        for f in [0.0, 0.1, 0.5, 0.9] {
            let at = theta[i] + f * (theta[i + 1] - theta[i]);
            let wanted = p[i] + f * (p[i + 1] - p[i]);
            // An ulp of the cosine moves the angle by 1.1e-16 / sin θ.
            let slope = (p[i + 1] - p[i]).abs() / (theta[i + 1] - theta[i]);
            let allowed = 4e-16 * slope / at.sin().max(1e-8) + 1e-14 * wanted;
            let found = norm * table.value(at.cos());
            assert!((found - wanted).abs() <= allowed, "{at}: {found} {wanted}");
        }
    }
    let (error, cells) = table.sampling();
    assert!(error <= SAMPLING_ERROR && cells < 4000, "{error:e} with {cells}");
}

#[test]
fn spike_and_bad_norm_are_renormalised_and_reported() {
    for scale in [1e-300, 1.0, 1e294] {
        let p = [1e6, 3.0, 3.0].map(|p| p * scale);
        let (table, norm) = PhaseTable::new(&[0.0, 1e-3, PI], &p).unwrap();
        // 3 everywhere plus a triangle: ½∫(1e6 − 3)(1 − θ/1e-3) θ dθ = (1e6 − 3)·1e-6/12, sin θ = θ to 2e-7.
        assert!((norm / scale - 3.0 - 999_997.0 * 1e-6 / 12.0).abs() < 1e-6);
        let phase = PhaseFunction::Table(Arc::new(table));
        assert!((integral(&phase, 0.0, PI, |_| 1.0) - 1.0).abs() < 1e-12);
    }
}

#[test]
fn bad_tables_are_refused() {
    assert!(matches!(PhaseTable::new(&[0.0], &[1.0]), Err(PhaseError::Length { .. })));
    assert!(matches!(PhaseTable::new(&[0.0, 1.0, 1.0, PI], &[1.0; 4]), Err(PhaseError::Angle { entry: 2 })));
    assert!(matches!(PhaseTable::new(&[0.0, 3.0], &[1.0; 2]), Err(PhaseError::Angle { entry: 1 })));
    assert!(matches!(PhaseTable::new(&[0.0, PI], &[1.0, f64::NAN]), Err(PhaseError::Value { entry: 1 })));
    assert!(matches!(PhaseTable::new(&[0.0, PI], &[0.0, 0.0]), Err(PhaseError::Zero)));
    let sphere = Sphere { size_parameter: 3.0, n: 1.4, k: 0.0 };
    let refused = |sphere: Sphere, number: f64| mie::of_spheres(&[sphere], &[number], 1e-4).unwrap_err();
    assert!(matches!(refused(sphere, -1.0), PhaseError::Value { entry: 0 }));
    assert!(matches!(refused(sphere, 0.0), PhaseError::Zero));
    for size_parameter in [f64::NAN, 2e5] {
        assert!(matches!(
            refused(Sphere { size_parameter, ..sphere }, 1.0),
            PhaseError::Sphere { entry: 0, .. }
        ));
    }
    assert!(matches!(mie::of_spheres(&[sphere], &[], 1e-4), Err(PhaseError::Length { .. })));
}

proptest! {
    /// Any table: nodes down to 1e-9 rad apart, values over twelve decades, with zeros.
    #[test]
    fn any_table_is_sampled_as_it_is_evaluated(
        steps in prop::collection::vec((-9.0..0.0f64, -12.0..0.5f64), 2..40),
        us in prop::collection::vec(0.0..1.0f64, 20),
    ) {
        // A last step that cosines resolve: all angles within 1.5e-8 of π have the same one.
        let mut steps = steps;
        steps.push((-2.0, -3.0));
        let total: f64 = steps.iter().map(|s| 10f64.powf(s.0)).sum();
        let mut theta = vec![0.0];
        let mut sum = 0.0;
        for step in &steps {
            sum += 10f64.powf(step.0);
            theta.push(PI * sum / total);
        }
        let last = theta.len() - 1;
        theta[last] = PI;
        let mut p11: Vec<f64> =
            steps.iter().map(|s| if s.1 > 0.0 { 0.0 } else { 10f64.powf(s.1) }).collect();
        p11.push(1e-3);
        // Steps below the rounding of the sum are refused, as they must be.
        if let Ok((table, norm)) = PhaseTable::new(&theta, &p11) {
            prop_assert!(norm > 0.0 && norm.is_finite());
            let (error, cells) = table.sampling();
            prop_assert!(error <= SAMPLING_ERROR && cells < 1 << 16, "{error:e} {cells}");
            let phase = PhaseFunction::Table(Arc::new(table));
            let one = integral(&phase, 0.0, PI, |_| 1.0);
            let mean = 1.0 - integral(&phase, 0.0, PI, |v| v);
            // Peaks, backward ones above all, are known as finely as 1 − cos θ is.
            let rounding = 1e-12 + 2.3e-16 * p11.iter().fold(0.0f64, |m, p| m.max(p / norm));
            // Angles close to π are known from their cosines to 1e-16 over their distance.
            prop_assert!((one - 1.0).abs() < 1e-7 + rounding, "{one}");
            prop_assert!((mean - phase.mean_cosine()).abs() < 1e-7 + rounding, "{mean}");
            for u in us {
                let cosine = phase.sample(u);
                prop_assert!((-1.0..=1.0).contains(&cosine));
                let error = (phase.within(cosine) - (1.0 - u)).abs();
                let ulp = 1e-15 * phase.value(cosine);
                prop_assert!(error < rounding + ulp, "{u}: {error:e} {ulp:e}");
            }
        }
    }
}
