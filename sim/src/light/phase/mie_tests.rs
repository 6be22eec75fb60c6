//! Phase functions of spheres against exact distributions, a multiprecision table, and another program.

use super::tests::{SPRAY, spray};
use super::*;
use crate::light::mie as spheres;
use crate::light::mie::{Direction, Sphere};

/// Two sources: the multiprecision cumulative distributions of 20 spheres, x from 1e-6 to 300.
#[test]
fn mie_distributions_agree_with_the_multiprecision_table() {
    let text = include_str!("../../../tests/data/light/mie_phase_cdf.csv");
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').skip(1).map(|field| field.parse().unwrap()).collect())
        .collect();
    for sphere_rows in rows.chunk_by(|p, q| p[..3] == q[..3]) {
        let sphere = Sphere { size_parameter: sphere_rows[0][0], n: sphere_rows[0][1], k: sphere_rows[0][2] };
        for (target, nodes) in [(1e-4, 256), (1e-5, 1024), (mie::DISTRIBUTION_ERROR, 4096)] {
            let found = mie::of_spheres(&[sphere], &[1.0], target).unwrap();
            assert!(found.error <= target && found.nodes <= nodes, "{sphere:?}: {} nodes", found.nodes);
            assert!((found.phase.mean_cosine() - found.asymmetry).abs() < 1e-9, "{sphere:?}");
            for row in sphere_rows {
                let share = found.phase.within(row[3].to_radians().cos());
                assert!((share - row[4]).abs() <= target, "{sphere:?} {} deg: {share} {}", row[3], row[4]);
            }
        }
    }
}

/// The error between nodes that is stated is the one that there is, at 2000 angles that are no nodes.
#[test]
fn the_stated_error_of_the_distribution_is_the_true_one() {
    for x in [0.5, 18.5, 92.4, 300.0] {
        let sphere = Sphere { size_parameter: x, n: 1.38, k: 0.001 };
        let angles: Vec<f64> = (1..2000).map(|i| PI * (f64::from(i) / 2000.0).powi(2)).collect();
        let towards: Vec<Direction> =
            angles.iter().map(|&theta| Direction::from_radians(theta).unwrap()).collect();
        let exact = spheres::cumulative(sphere, &towards).unwrap();
        for target in [1e-4, 1e-6] {
            let found = mie::of_spheres(&[sphere], &[1.0], target).unwrap();
            let worst = angles
                .iter()
                .zip(&exact)
                .map(|(theta, exact)| (found.phase.within(theta.cos()) - exact).abs())
                .fold(0.0, f64::max);
            println!("x {x}: {} nodes, stated {:.2e}, found {worst:.2e}", found.nodes, found.error);
            assert!(worst <= found.error && worst >= 0.3 * found.error, "{x}: {worst:e} {:e}", found.error);
        }
    }
}

/// Two sources: values and distribution of four spheres, from miepython 3 (S1_S2 in Bohren's norm) and a 400 point rule.
#[test]
fn a_mixture_of_spheres_agrees_with_miepython() {
    let found = mie::of_spheres(&spray(), &SPRAY.1, mie::DISTRIBUTION_ERROR).unwrap();
    assert!((found.asymmetry - 0.903_619_197_484_837_7).abs() < 1e-13);
    let rows = [
        (2.0_f64, 0.334_923_510_854_309_2, 967.083_503_179_61),
        (5.0, 1.220_819_284_514_191_9, 304.236_143_700_732_27),
        (10.0, 2.152_258_681_694_313_2, 105.570_911_424_110_65),
        (20.0, 3.099_890_053_139_622, 20.219_563_254_050_453),
        (45.0, 3.624_371_714_862_956, 3.088_813_950_309_709_6),
        (90.0, 3.922_199_231_716_603_7, 0.232_553_366_782_553_14),
        (135.0, 3.983_559_076_038_078_6, 0.110_937_606_433_269_75),
        (170.0, 3.999_122_368_464_166, 0.106_855_357_638_373_41),
    ];
    // That program's amplitudes are twice Bohren's: its distribution ends at 4.
    for (degrees, share, p11) in rows {
        let cosine = degrees.to_radians().cos();
        assert!((found.phase.within(cosine) - share / 4.0).abs() <= found.error, "{degrees}");
        // The density inside a cell is a straight line: a few percent where it has the least to say.
        let value = found.phase.value(cosine);
        assert!((value / (p11 / 4.0) - 1.0).abs() < 0.1, "{degrees}: {value}");
    }
}

/// A pattern that is not what it claims is noticed by its mean cosine.
#[test]
fn patterns_that_miss_their_mean_cosine_are_refused() {
    let sphere = Sphere { size_parameter: 60.0, n: 1.4, k: 0.05 };
    let asymmetry = spheres::efficiencies(sphere.size_parameter, sphere.n, sphere.k).unwrap().asymmetry;
    let mut pattern = spheres::Pattern::of(&[sphere], &[1.0]).unwrap();
    assert!(mie::of_pattern(&pattern, asymmetry, 1e-6).is_ok());
    assert!(matches!(mie::of_pattern(&pattern, f64::NAN, 1e-4), Err(PhaseError::Unresolved { .. })));
    pattern.cosines.truncate(40);
    assert!(matches!(mie::of_pattern(&pattern, asymmetry, 1e-4), Err(PhaseError::Unresolved { .. })));
    assert!(matches!(mie::of_pattern(&spheres::Pattern::default(), 0.0, 1e-4), Err(PhaseError::Zero)));
}

/// A spray of 24 sizes about 5 µm at 3.4 µm, x up to 143: few nodes do, and the distribution is the mean of the exact
/// ones of all spheres.
#[test]
fn a_spray_needs_few_nodes_for_its_stated_error() {
    let sizes = (0..24).map(|i| {
        let z = -3.0 + 8.5 * (f64::from(i) + 0.5) / 24.0;
        let size_parameter = std::f64::consts::TAU * 5.0 * f64::exp(0.5 * z) / 3.4;
        (Sphere { size_parameter, n: 1.38, k: 0.09 }, (-0.5 * z * z).exp())
    });
    let (list, numbers): (Vec<Sphere>, Vec<f64>) = sizes.unzip();
    let angles: Vec<f64> = (1..60).map(|i| PI * (f64::from(i) / 60.0).powi(2)).collect();
    let towards: Vec<Direction> = angles.iter().map(|&t| Direction::from_radians(t).unwrap()).collect();
    let (mut exact, mut scattered) = (vec![0.0; angles.len()], 0.0);
    for (sphere, number) in list.iter().zip(&numbers) {
        let x = sphere.size_parameter;
        let own = number * x * x * spheres::efficiencies(x, sphere.n, sphere.k).unwrap().q_sca;
        scattered += own;
        for (sum, share) in exact.iter_mut().zip(spheres::cumulative(*sphere, &towards).unwrap()) {
            *sum += own * share;
        }
    }
    for (target, nodes) in [(1e-4, 64), (1e-5, 128), (1e-6, 256)] {
        let found = mie::of_spheres(&list, &numbers, target).unwrap();
        assert!(found.error <= target && found.nodes <= nodes, "{target:e}: {} nodes", found.nodes);
        assert!((found.phase.mean_cosine() - found.asymmetry).abs() < 1e-9);
        for (theta, exact) in angles.iter().zip(&exact) {
            let share = found.phase.within(theta.cos());
            // The cosine's ulp is 1e-16 p/2 of the light.
            assert!((share - exact / scattered).abs() <= found.error, "{target:e} {theta}: {share}");
        }
    }
}

/// The diffraction peak of x = 1000 is a milliradian wide.
#[test]
fn the_peak_of_large_spheres_is_resolved() {
    let sphere = Sphere { size_parameter: 1000.0, n: 1.38, k: 0.01 };
    let angles: Vec<f64> = (1..30).map(|i| 2e-4 * f64::from(i)).collect();
    let towards: Vec<Direction> = angles.iter().map(|&t| Direction::from_radians(t).unwrap()).collect();
    let exact = spheres::cumulative(sphere, &towards).unwrap();
    let found = mie::of_spheres(&[sphere], &[1.0], 1e-5).unwrap();
    assert!(found.nodes <= 1024, "{} nodes", found.nodes);
    assert!((found.phase.mean_cosine() - found.asymmetry).abs() < 1e-9);
    for (theta, exact) in angles.iter().zip(exact) {
        let share = found.phase.within(theta.cos());
        assert!((share - exact).abs() <= found.error, "{theta}: {share} {exact}");
    }
}
