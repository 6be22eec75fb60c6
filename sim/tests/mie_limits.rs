//! Mie theory where closed forms are known: small spheres, matched indices, weak absorption, large opaque spheres.
//!
//! Tolerances are the next term of each expansion plus the rounding that the program states.

use ditd_sim::light::complex::Complex;
use ditd_sim::light::mie::{Sphere, amplitudes, efficiencies};
use ditd_sim::light::quadrature::gauss_legendre;
use std::f64::consts::PI;

/// Rounding that is allowed to a cross-section with condition number 4 at most, relative.
const ROUNDING: f64 = 2.2e-16 * (64.0 + 32.0);

fn number(re: f64) -> Complex {
    Complex::new(re, 0.0)
}

/// Indices away from the poles of the expansion (m² = −2, m² = −3/2).
const INDICES: [(f64, f64); 9] = [
    (1.4, 0.08),
    (1.33, 0.0),
    (1.5, 1e-9),
    (0.6, 0.0),
    (0.3, 0.4),
    (2.5, 1.0),
    (1.0, 0.5),
    (4.0, 0.02),
    (1.01, 0.001),
];

#[test]
fn small_spheres_follow_the_expansion_to_the_second_order() {
    // Bohren and Huffman, eq. 5.4 and 5.7: a₁ = −(2i x³/3) L [1 + (3/5) x² (m²−2)/(m²+2) + (2i/3) x³ L], L = (m²−1)/(m²+2);
    // a₂, b₁ are smaller by x². What is left out is of the relative order (1 + |m|)⁴ x⁴, with factors below 1.
    for (n, k) in INDICES {
        for x in [1e-10, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2] {
            let q = efficiencies(x, n, k).unwrap();
            let square = Complex::new(n, k) * Complex::new(n, k);
            let l = (square - number(1.0)) / (square + number(2.0));
            let rise = (square - number(2.0)) / (square + number(2.0));
            let bend = 1.2 * x * x * rise.re - 4.0 / 3.0 * x.powi(3) * l.im;
            let q_sca = 8.0 / 3.0 * x.powi(4) * l.norm_sqr() * (1.0 + bend);
            let next = (1.0 + n.hypot(k)).powi(4) * x.powi(4);
            let what = format!("x {x}, m {n} + {k} i: {q:?}");
            assert!((q.q_sca / q_sca - 1.0).abs() < next + ROUNDING, "{what} {q_sca}");

            // Q_ext of eq. 5.7 without the scattered part, whose leading term is (8/3) x⁴ |L|².
            let fourth = square * square;
            let numerator = fourth + square * 27.0 + number(38.0);
            let inner = l * numerator / (square * 2.0 + number(3.0)) * (x * x / 15.0);
            let absorbed = 4.0 * x * (l * (number(1.0) + inner)).im;
            let q_abs = absorbed + 8.0 / 3.0 * x.powi(4) * ((l * l).re - l.norm_sqr());
            // Its imaginary parts are sums of the terms of a real expansion times k: the next is x⁵, of Im(m²).
            let next = 8.0 * (1.0 + n.hypot(k)).powi(6) * x.powi(5) * n * k;
            // The formula itself cancels where |Im L| is far below |L|.
            let cancelled = 16.0 * f64::EPSILON * x * l.abs() * (1.0 + n.hypot(k));
            let rounding = ROUNDING * q_abs.abs() + if k > 0.0 { cancelled } else { 0.0 };
            assert!((q.q_abs - q_abs).abs() <= next + rounding, "{what} {q_abs}");

            // g = x² Re[(m²+2)(m²+3)/(15(2m²+3))], from a₁ with a₂ and b₁.
            let ratio =
                (square + number(2.0)) * (square + number(3.0)) / (square * 2.0 + number(3.0)) * (1.0 / 15.0);
            let next = (1.0 + n.hypot(k)).powi(4) * x.powi(4);
            assert!((q.asymmetry - x * x * ratio.re).abs() <= next + ROUNDING * q.asymmetry.abs(), "{what}");
            // The pattern of a dipole, 1 + cos²: back as forward, Q_back = (3/2) Q_sca to the order x².
            let next = (1.0 + n.hypot(k)).powi(3) * x * x;
            assert!((q.q_back / (1.5 * q.q_sca) - 1.0).abs() < next + 2.0 * ROUNDING, "{what}");
        }
    }
}

#[test]
fn small_spheres_scatter_as_dipoles() {
    for (n, k) in INDICES {
        let x = 1e-6;
        let cosines = [1.0, 0.7, 0.1, -0.4, -1.0];
        for (mu, (s1, s2)) in cosines.iter().zip(amplitudes(x, n, k, &cosines).unwrap()) {
            let off = (s2 - s1 * *mu).abs() / s1.abs();
            assert!(off < (1.0 + n.hypot(k)).powi(3) * x * x + 1e-13, "{n} {k} {mu}: {off:e}");
        }
    }
}

/// (4/9) x⁴ ∫ G² (1 + cos²θ) sin θ dθ with G = 3 (sin u − u cos u)/u³, u = 2 x sin(θ/2): Q_sca / |m − 1|² of
/// Rayleigh, Gans and Debye (van de Hulst, Light Scattering by Small Particles, section 7.2).
fn gans(x: f64) -> f64 {
    // The integrand has about 4x/π waves over μ.
    let sum: f64 = gauss_legendre(200)
        .into_iter()
        .map(|(mu, weight)| {
            let u = x * (2.0 * (1.0 - mu)).sqrt();
            let form = if u < 0.3 {
                let s = u * u;
                1.0 - s / 10.0 + s * s / 280.0 - s * s * s / 15120.0 + s.powi(4) / 1_330_560.0
            } else {
                3.0 * (u.sin() - u * u.cos()) / (u * u * u)
            };
            weight * form * form * (1.0 + mu * mu)
        })
        .sum();
    4.0 / 9.0 * x.powi(4) * sum
}

#[test]
fn matched_spheres_scatter_with_the_square_of_the_contrast() {
    // The phase lag in the sphere, 2x|m−1|, and |m−1| itself are what the law leaves out. G loses 4e-16/u² · 3 to
    // rounding at u = 0.3, and at the switch leaves out u¹⁰/1.7e8.
    for x in [0.1, 0.5, 1.0, 3.0, 10.0, 30.0] {
        let law = gans(x);
        for contrast in [1e-4, -1e-6, 1e-8, -1e-9, 1e-10, -1e-11, 1e-12] {
            for k in [0.0, 0.3, 3.0] {
                // The contrast that the double next to 1 + contrast has.
                let n = 1.0 + contrast;
                let k = k * f64::abs(contrast);
                let from_one = (n - 1.0).hypot(k);
                let q = efficiencies(x, n, k).unwrap();
                let left_out = 4.0 * (1.0 + 2.0 * x) * from_one + 1e-12;
                let off = q.q_sca / (law * from_one * from_one) - 1.0;
                assert!(off.abs() < left_out, "x {x}, m − 1 = {} + {k} i: {off:e}", n - 1.0);
                // Every part of the volume absorbs alike: Q_abs = (8/3) x k.
                if k > 0.0 {
                    let off = q.q_abs / (8.0 / 3.0 * x * k) - 1.0;
                    assert!(off.abs() < left_out, "x {x}, m − 1 = {} + {k} i: Q_abs {off:e}", n - 1.0);
                }
            }
        }
    }
}

#[test]
fn weak_absorption_is_proportional_to_k() {
    // Q_abs/k falls as 1 − c k, c the share of the sharpest line near (6e3 for x = 47.3 with n = 1.5): measured at a
    // larger k, and then the law must hold at the smaller ones up to (c k)².
    for x in [1e-6, 0.01, 0.7, 3.3, 12.1, 47.3, 111.7] {
        for n in [0.5, 1.33, 1.5, 2.4, 50.0] {
            if x * n > 300.0 {
                continue;
            }
            let at = |k: f64| efficiencies(x, n, k).unwrap();
            let off = |k: f64| at(k).q_abs / at(1e-14).q_abs / (k / 1e-14) - 1.0;
            let far = off(3e-11);
            assert!(far.abs() < 0.01, "{x} {n}: on a line, {far:e}");
            let rounding = 4.4e-16 * (64.0 + 8.0 * far.abs() / 3e-11 + x);
            for (k, share) in [(3e-12, 0.1), (3e-13, 0.01)] {
                let rest = off(k) - share * far;
                assert!(rest.abs() < rounding + far * far + far.abs() * 1e-3, "{x} {n} {k}: {rest:e}");
            }
            // And scattering does not see it.
            let (none, one) = (at(0.0), at(1e-14));
            let seen = far.abs() / 3e-11 * 1e-14;
            assert!((one.q_sca / none.q_sca - 1.0).abs() < rounding + seen, "{x} {n}");
            assert!(none.q_abs == 0.0 && one.q_abs > 0.0);
        }
    }
}

#[test]
fn large_absorbing_spheres_extinguish_twice_their_shadow() {
    // Nussenzveig and Wiscombe, Phys. Rev. Lett. 45, 1490 (1980): Q_ext = 2 + 1.9923861 x^(−2/3) + O(1/x), when the
    // light that goes through is absorbed (2 k x ≫ 1). The factor of 1/x depends on m and is below 10 for these.
    for (n, k) in [(1.4, 0.08), (1.33, 0.5), (2.0, 1.0), (1.1, 0.3)] {
        for x in [3e2, 1e3, 1e4, 1e5, 1e6] {
            let q = efficiencies(x, n, k).unwrap();
            let rest = (q.q_ext - 2.0 - 1.992_386_1 * x.powf(-2.0 / 3.0)) * x;
            assert!(rest.abs() < 10.0, "x {x}, {n} + {k} i: {rest}");
        }
    }
}

/// Share of unpolarised light from all sides that a flat surface of index n + i k reflects: ∫ R 2 sin cos dθ.
fn mirrored(n: f64, k: f64) -> f64 {
    gauss_legendre(64)
        .into_iter()
        .map(|(node, weight)| {
            let cosine = 0.5 * (node + 1.0);
            let square = Complex::new(n, k) * Complex::new(n, k);
            let inside = (square + number(cosine * cosine - 1.0)).sqrt();
            let share = |a: Complex, b: Complex| ((a - b) / (a + b)).norm_sqr();
            let (across, along) = (share(number(cosine), inside), share(square * cosine, inside));
            0.5 * weight * (across + along) * cosine
        })
        .sum()
}

#[test]
fn large_opaque_spheres_absorb_what_their_surface_does_not_reflect() {
    // Geometric optics; the edge adds an amount of the order x^(−2/3), with a factor below 3 for these indices.
    for (n, k) in [(1.4, 0.08), (1.33, 0.5), (2.0, 1.0), (1.1, 0.3), (0.5, 2.0)] {
        let limit = 1.0 - mirrored(n, k);
        let mut before = f64::INFINITY;
        for x in [1e3, 1e4, 1e5] {
            let q = efficiencies(x, n, k).unwrap();
            let off = (q.q_abs - limit).abs();
            assert!(off < 3.0 * x.powf(-2.0 / 3.0), "x {x}, {n} + {k} i: {} against {limit}", q.q_abs);
            assert!(off < before, "comes nearer");
            before = off;
        }
    }
}

#[test]
fn small_and_large_spheres_of_extreme_index_have_their_limits() {
    // A small perfect conductor has Q_sca = (10/3) x⁴ and g = −2/5 (a₁ and b₁ = −a₁/2, both imaginary), which is
    // approached as 1/(|m| x): the skin is λ/(2πk) thick.
    let q = efficiencies(1e-2, 1.0, 9e3).unwrap();
    assert!((q.q_sca / (10.0 / 3.0 * 1e-8) - 1.0).abs() < 0.03, "{q:?}");
    assert!((q.asymmetry + 0.4).abs() < 0.03, "{q:?}");
    // n = 50: far from lines a small sphere is a dipole with L → 1.
    let q = efficiencies(1e-4, 50.0, 0.0).unwrap();
    let l: f64 = 2499.0 / 2502.0;
    assert!((q.q_sca / (8.0 / 3.0 * 1e-16 * l * l) - 1.0).abs() < 1e-3, "{q:?}");
    // Emptier than its surroundings, n = 0.01: L = −1/2.
    let q = efficiencies(1e-4, 0.01, 0.0).unwrap();
    assert!((q.q_sca / (8.0 / 3.0 * 1e-16 * 0.25) - 1.0).abs() < 1e-3, "{q:?}");
    let sphere = Sphere { size_parameter: 2.0 * PI, n: 1.0, k: 0.0 };
    assert!(efficiencies(sphere.size_parameter, sphere.n, sphere.k).unwrap().q_ext == 0.0);
}
