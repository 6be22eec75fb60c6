//! Amplitudes S₁, S₂ and the phase function of one sphere.

use super::series::{coefficients, efficiencies};
use super::{MieError, Sphere};
use crate::light::complex::Complex;

/// A scattering direction, kept as 1 − |cos θ| so that angles near 0° and 180° lose nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction {
    /// 1 − |cos θ|, in [0, 1].
    versine: f64,
    /// θ > 90°.
    backward: bool,
}

impl Direction {
    /// From cos θ; exact for |cos θ| ≥ ½.
    ///
    /// # Errors
    ///
    /// [`MieError::Cosine`] outside [−1, 1].
    pub fn from_cosine(cosine: f64) -> Result<Self, MieError> {
        if (-1.0..=1.0).contains(&cosine) {
            Ok(Self { versine: 1.0 - cosine.abs(), backward: cosine < 0.0 })
        } else {
            Err(MieError::Cosine(cosine))
        }
    }

    /// From 1 − cos θ in [0, 2] (clamped): exact near forward.
    pub fn from_versine(versine: f64) -> Self {
        let versine = versine.clamp(0.0, 2.0);
        if versine <= 1.0 {
            Self { versine, backward: false }
        } else {
            Self { versine: 2.0 - versine, backward: true }
        }
    }

    /// From θ in degrees, 0 … 180: exact near both ends.
    ///
    /// # Errors
    ///
    /// [`MieError::Angle`] outside.
    pub fn from_degrees(theta_deg: f64) -> Result<Self, MieError> {
        if !(0.0..=180.0).contains(&theta_deg) {
            return Err(MieError::Angle(theta_deg.to_radians()));
        }
        let backward = theta_deg > 90.0;
        let from_axis = if backward { 180.0 - theta_deg } else { theta_deg };
        let sine = (0.5 * from_axis).to_radians().sin();
        Ok(Self { versine: 2.0 * sine * sine, backward })
    }

    /// From θ in radians, 0 … π.
    ///
    /// # Errors
    ///
    /// [`MieError::Angle`] outside.
    pub fn from_radians(theta_rad: f64) -> Result<Self, MieError> {
        if !(0.0..=std::f64::consts::PI).contains(&theta_rad) {
            return Err(MieError::Angle(theta_rad));
        }
        let backward = theta_rad > std::f64::consts::FRAC_PI_2;
        let half = if backward { (0.5 * theta_rad).cos() } else { (0.5 * theta_rad).sin() };
        Ok(Self { versine: 2.0 * half * half, backward })
    }

    /// 1 − cos θ, in [0, 2].
    pub fn versine(self) -> f64 {
        if self.backward { 2.0 - self.versine } else { self.versine }
    }

    /// cos θ.
    pub fn cosine(self) -> f64 {
        if self.backward { self.versine - 1.0 } else { 1.0 - self.versine }
    }
}

/// Amplitudes (S₁, S₂) at the cosines given, in Bohren and Huffman's convention (eq. 4.74).
///
/// Error below 1e-13 · max|S| · (1 + x/100) for the angle that belongs to the cosine; angles near 0° and 180°
/// are better handed to [`amplitudes_towards`]. Zero for x = 0 and for m = 1.
///
/// # Errors
///
/// As [`super::efficiencies`], and [`MieError::Cosine`].
pub fn amplitudes(
    size_parameter: f64,
    n: f64,
    k: f64,
    cos_theta: &[f64],
) -> Result<Vec<(Complex, Complex)>, MieError> {
    let directions = cos_theta.iter().map(|&mu| Direction::from_cosine(mu)).collect::<Result<Vec<_>, _>>()?;
    amplitudes_towards(Sphere { size_parameter, n, k }, &directions)
}

/// Amplitudes (S₁, S₂) towards the directions given.
///
/// # Errors
///
/// As [`super::efficiencies`].
pub fn amplitudes_towards(
    sphere: Sphere,
    directions: &[Direction],
) -> Result<Vec<(Complex, Complex)>, MieError> {
    let terms = Terms::new(sphere.checked()?);
    Ok(directions.iter().map(|&direction| terms.towards(direction)).collect())
}

/// Phase function p₁₁ = 2 (|S₁|² + |S₂|²) / (x² Q_sca) for unpolarised light: ½∫p₁₁ dμ = 1.
///
/// NaN when the sphere scatters nothing (x = 0, m = 1).
///
/// # Errors
///
/// As [`super::efficiencies`].
pub fn phase(sphere: Sphere, directions: &[Direction]) -> Result<Vec<f64>, MieError> {
    let q_sca = efficiencies(sphere.size_parameter, sphere.n, sphere.k)?.q_sca;
    let norm = 2.0 / (sphere.size_parameter * sphere.size_parameter) / q_sca;
    let amplitudes = amplitudes_towards(sphere, directions)?;
    Ok(amplitudes.into_iter().map(|(s1, s2)| norm * (s1.norm_sqr() + s2.norm_sqr())).collect())
}

/// The coefficients of one sphere with the factors of the angular recurrence, for many directions.
pub(super) struct Terms {
    terms: Vec<Term>,
}

/// One order, split into the half that is even under θ → π − θ and the half that is odd.
struct Term {
    a: Complex,
    b: Complex,
    /// (n + 1) / n.
    growth: f64,
    /// (2n + 1) / n.
    bend: f64,
    /// n + 1.
    above: f64,
}

impl Terms {
    pub(super) fn new(sphere: Sphere) -> Self {
        let terms = coefficients(sphere)
            .into_iter()
            .zip(1u32..)
            .map(|((a, b), n)| {
                let n = f64::from(n);
                let weight = (2.0 * n + 1.0) / (n * (n + 1.0));
                Term {
                    a: a * weight,
                    b: b * weight,
                    growth: (n + 1.0) / n,
                    bend: (2.0 * n + 1.0) / n,
                    above: n + 1.0,
                }
            })
            .collect();
        Self { terms }
    }

    /// (S₁, S₂).
    ///
    /// The angular functions are stepped by their differences (after Reinsch):
    /// δ_n = π_{n+1} − π_n = (n+1)/n δ_{n−1} − (2n+1)/n v π_n with v = 1 − |μ|, and
    /// τ_n = (n+1) δ_{n−1} − π_n − n v π_n: near the axis nothing cancels. Directions beyond 90° by parity:
    /// π_n(−μ) = (−1)^{n+1} π_n(μ), τ_n(−μ) = (−1)^n τ_n(μ).
    pub(super) fn towards(&self, direction: Direction) -> (Complex, Complex) {
        let v = direction.versine;
        let (mut s1, mut s2) = (Complex::default(), Complex::default());
        let (mut pi, mut delta) = (1.0, 1.0);
        let mut sign = 1.0;
        for term in &self.terms {
            let tau = term.above * delta - pi - (term.above - 1.0) * v * pi;
            let (signed_pi, signed_tau) =
                if direction.backward { (sign * pi, -sign * tau) } else { (pi, tau) };
            s1 = s1 + term.a * signed_pi + term.b * signed_tau;
            s2 = s2 + term.b * signed_pi + term.a * signed_tau;
            delta = term.growth * delta - term.bend * v * pi;
            pi += delta;
            sign = -sign;
        }
        (s1, s2)
    }

    /// Number of orders.
    pub(super) fn len(&self) -> usize {
        self.terms.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amplitudes_agree_with_the_multiprecision_table() {
        let text = include_str!("../../../tests/data/light/mie_amplitudes.csv");
        let rows: Vec<Vec<f64>> = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').skip(1).map(|field| field.parse().unwrap()).collect())
            .collect();
        let mut worst = (0.0f64, 0.0f64);
        for sphere_rows in rows.chunk_by(|p, q| p[..3] == q[..3]) {
            let sphere =
                Sphere { size_parameter: sphere_rows[0][0], n: sphere_rows[0][1], k: sphere_rows[0][2] };
            let towards: Vec<Direction> =
                sphere_rows.iter().map(|row| Direction::from_degrees(row[3]).unwrap()).collect();
            let found = amplitudes_towards(sphere, &towards).unwrap();
            let p11 = phase(sphere, &towards).unwrap();
            let largest =
                sphere_rows.iter().map(|r| r[4].hypot(r[5]).max(r[6].hypot(r[7]))).fold(0.0, f64::max);
            let allowed = 1e-13 * largest * (1.0 + sphere.size_parameter / 100.0);
            let p_largest = sphere_rows.iter().map(|r| r[8]).fold(0.0, f64::max);
            for ((row, (s1, s2)), p) in sphere_rows.iter().zip(found).zip(p11) {
                let error =
                    (s1 - Complex::new(row[4], row[5])).abs().max((s2 - Complex::new(row[6], row[7])).abs());
                worst.0 = worst.0.max(error / allowed);
                assert!(error <= allowed, "{sphere:?} {} deg: {:.2} of the bound", row[3], error / allowed);
                // p is quadratic in S and divided by Q_sca: four times the relative bound of S at most.
                let p_allowed = 4e-13 * p_largest * (1.0 + sphere.size_parameter / 100.0);
                worst.1 = worst.1.max((p - row[8]).abs() / p_allowed);
                assert!((p - row[8]).abs() <= p_allowed, "{sphere:?} {} deg", row[3]);
            }
        }
        println!("worst: S {:.3}, p11 {:.3} of the bound", worst.0, worst.1);
    }

    #[test]
    fn cosine_and_angle_give_the_same_direction() {
        for degrees in [0.0, 10.0, 60.0, 90.0, 91.0, 150.0, 180.0] {
            let theta = f64::to_radians(degrees);
            let by_degrees = Direction::from_degrees(degrees).unwrap();
            for other in [
                Direction::from_radians(theta).unwrap(),
                Direction::from_cosine(theta.cos()).unwrap(),
                Direction::from_versine(1.0 - theta.cos()),
            ] {
                assert!((other.cosine() - by_degrees.cosine()).abs() < 4.0 * f64::EPSILON, "{degrees}");
            }
        }
        assert!(matches!(Direction::from_cosine(1.1), Err(MieError::Cosine(_))));
        assert!(matches!(Direction::from_degrees(f64::NAN), Err(MieError::Angle(_))));
        assert!(matches!(Direction::from_radians(-0.1), Err(MieError::Angle(_))));
        assert!(amplitudes(1.0, 1.4, 0.1, &[0.0, 2.0]).is_err());
    }

    #[test]
    fn backscatter_is_four_times_the_amplitude_squared() {
        // Equality of two definitions (README of the table): different sums, so to rounding times their length.
        for (x, n, k) in [(0.1, 1.4, 0.1), (5.0, 1.4, 0.08), (30.0, 1.5, 0.0)] {
            let q = efficiencies(x, n, k).unwrap().q_back;
            let s1 = amplitudes(x, n, k, &[-1.0]).unwrap()[0].0;
            assert!((4.0 * s1.norm_sqr() / (x * x) / q - 1.0).abs() < 1e-11);
        }
    }

    #[test]
    fn forward_amplitude_gives_the_extinction() {
        // Optical theorem: Q_ext = 4 Re S(0) / x².
        for (x, n, k) in [(0.1, 1.4, 0.1), (5.0, 1.4, 0.08), (300.0, 1.5, 0.0)] {
            let q = efficiencies(x, n, k).unwrap().q_ext;
            let s1 = amplitudes(x, n, k, &[1.0]).unwrap()[0].0;
            assert!((4.0 * s1.re / (x * x) / q - 1.0).abs() < 1e-12);
        }
    }
}
