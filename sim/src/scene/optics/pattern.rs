//! The angular pattern of a whole spray: mean of the Mie phase functions, weighted with scattering.

use super::super::field::Parcel;
use super::Pattern;
use super::droplets::{counts, whole};
use crate::light::fuel::Fuel;
use crate::light::mie::{Direction, Sphere, amplitudes_towards, efficiencies};
use std::f64::consts::PI;

/// Width of a class of diameters in ln d: patterns of many sizes are averaged, so classes may be wide.
const CLASS: f64 = 0.05;
/// Number of angles, and the exponent of their spacing: steps of 0.05° at 0° and 2° at 180°.
const ANGLES: usize = 361;
const WARP: f64 = 4.0;

/// The mean pattern at one wavelength with what is known about it; empty, with zeros, when nothing scatters.
#[derive(Debug, Clone, Default)]
pub(super) struct Mean {
    pub(super) pattern: Pattern,
    /// Exact mean cosine, and that of the table.
    pub(super) asymmetry: f64,
    pub(super) asymmetry_tabulated: f64,
    /// Mie calculations it took.
    pub(super) spheres: usize,
}

/// The mean pattern of parcels at one wavelength.
pub(super) fn mean_pattern(parcels: &[Parcel], fuel: &Fuel, um: f64) -> Mean {
    let classes = classes(parcels);
    let area: f64 = classes.iter().map(|class| class.1).sum();
    if area <= 0.0 {
        return Mean::default();
    }
    let spheres = classes.len();
    let warm: f64 = parcels.iter().filter(|p| counts(p)).map(|p| p.area_m2() * p.temperature_k).sum();
    let (n, k) = fuel.liquid_index(um, warm / area);
    let theta_rad = angles();
    let towards: Vec<Direction> =
        theta_rad.iter().filter_map(|&theta| Direction::from_radians(theta).ok()).collect();
    let mut p11 = vec![0.0; theta_rad.len()];
    let (mut scattered, mut forward) = (0.0, 0.0);
    for (diameter_m, area) in classes {
        let x = PI * diameter_m / (um * 1e-6);
        let sphere = Sphere { size_parameter: x, n, k };
        let (Ok(q), Ok(amplitudes)) = (efficiencies(x, n, k), amplitudes_towards(sphere, &towards)) else {
            continue;
        };
        scattered += area * q.q_sca;
        forward += area * q.q_sca * q.asymmetry;
        // Number of droplets ∝ area/x²; C_sca p ∝ |S₁|² + |S₂|².
        let number = 2.0 * area / (x * x);
        for (sum, (s1, s2)) in p11.iter_mut().zip(amplitudes) {
            *sum += number * (s1.norm_sqr() + s2.norm_sqr());
        }
    }
    if scattered <= 0.0 {
        return Mean { spheres, ..Mean::default() };
    }
    for p in &mut p11 {
        *p /= scattered;
    }
    let (norm, mean) = moments(&theta_rad, &p11);
    for p in &mut p11 {
        *p /= norm;
    }
    let pattern = Pattern { theta_rad, p11 };
    Mean { pattern, asymmetry: forward / scattered, asymmetry_tabulated: mean / norm, spheres }
}

/// Scattering angles, dense about the forward direction, the last one at most π.
fn angles() -> Vec<f64> {
    let mut theta: Vec<f64> =
        (0..ANGLES).map(|i| PI * (WARP * i as f64 / (ANGLES - 1) as f64).exp_m1() / WARP.exp_m1()).collect();
    theta[ANGLES - 1] = PI;
    theta
}

/// Diameters in metres with the geometric area of their droplets.
fn classes(parcels: &[Parcel]) -> Vec<(f64, f64)> {
    let known = || parcels.iter().filter(|parcel| counts(parcel));
    let (small, large) = known()
        .map(|p| p.diameter_m.ln())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |r, d| (r.0.min(d), r.1.max(d)));
    if small > large {
        return Vec::new();
    }
    let mut sums = vec![(0.0, 0.0); 1 + whole((large - small) / CLASS)];
    for parcel in known() {
        let class = whole((parcel.diameter_m.ln() - small) / CLASS).min(sums.len() - 1);
        sums[class].0 += parcel.area_m2() * parcel.diameter_m.ln();
        sums[class].1 += parcel.area_m2();
    }
    sums.into_iter().filter(|sum| sum.1 > 0.0).map(|(ln_d, area)| ((ln_d / area).exp(), area)).collect()
}

/// ½∫p sin θ dθ and ½∫p cos θ sin θ dθ of the straight pieces between the nodes, exactly.
fn moments(theta: &[f64], p11: &[f64]) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for (t, p) in theta.windows(2).zip(p11.windows(2)) {
        // Four-point Gauss on a piece: sin and cos of at most 2° steps to rounding.
        const RULE: [(f64, f64); 4] = [
            (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
            (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
            (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
            (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        ];
        let half = 0.5 * (t[1] - t[0]);
        for (node, weight) in RULE {
            let share = 0.5 * (1.0 + node);
            let at = t[0] + 2.0 * half * share;
            let value = 0.5 * weight * half * at.sin() * (p[0] + share * (p[1] - p[0]));
            sums.0 += value;
            sums.1 += value * at.cos();
        }
    }
    sums
}
