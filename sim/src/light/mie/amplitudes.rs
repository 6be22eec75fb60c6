//! Amplitudes S₁, S₂ and the phase function of one sphere.

use super::angular::{Amplitudes, Angles, Coefficients};
use super::factors::Factors;
use super::series::{efficiencies, fused, terms};
use super::vector::{BATCH, Vector};
use super::{MieError, Sphere};
use crate::light::complex::Complex;
use pulp::Simd;

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
    Ok(terms.towards(directions))
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

/// The coefficients of one sphere, for many directions: Re a, Im a, Re b, Im b, each times (2n+1)/(n(n+1)).
pub(super) struct Terms {
    terms: Vec<[f64; 4]>,
}

impl Terms {
    pub(super) fn new(sphere: Sphere) -> Self {
        Self { terms: terms(sphere) }
    }

    /// (S₁, S₂) towards each direction.
    ///
    /// Every direction is computed with its mirror image; where the list is its own mirror image, as angles in equal
    /// steps from 0° to 180° are, half of it is enough.
    pub(super) fn towards(&self, directions: &[Direction]) -> Vec<(Complex, Complex)> {
        let mirrored =
            directions.iter().zip(directions.iter().rev()).take(directions.len() / 2).all(|(one, other)| {
                one.versine.to_bits() == other.versine.to_bits() && one.backward != other.backward
            });
        let half = if mirrored { directions.len().div_ceil(2) } else { directions.len() };
        let mut found = vec![(Complex::default(), Complex::default()); directions.len()];
        pulp::Arch::new().dispatch(Towards { terms: &self.terms, directions, half, found: &mut found });
        found
    }

    /// Number of orders.
    pub(super) fn len(&self) -> usize {
        self.terms.len()
    }
}

/// Terms, directions, and the place of what is found. Beyond `half` the directions mirror those before it.
struct Towards<'a> {
    terms: &'a [[f64; 4]],
    directions: &'a [Direction],
    half: usize,
    found: &'a mut [(Complex, Complex)],
}

impl pulp::WithSimd for Towards<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if fused::<S>() { self.run::<S, true>(simd) } else { self.run::<S, false>(simd) }
    }
}

impl Towards<'_> {
    #[inline(always)]
    fn run<S: Simd, const FUSED: bool>(mut self, simd: S) {
        /// Vectors side by side: one alone waits for itself.
        const SIDE: usize = 2;
        let on = Vector::<S, FUSED>(simd);
        let width = S::F64_LANES;
        let table = Factors::reaching(self.terms.len() + 1);
        let mut first = 0;
        while first < self.half {
            let count = (self.half - first).min(SIDE * width);
            let mut versines = [[0.0; BATCH]; SIDE];
            for (versines, directions) in
                versines.iter_mut().zip(self.directions[first..first + count].chunks(width))
            {
                for (versine, direction) in versines.iter_mut().zip(directions) {
                    *versine = direction.versine;
                }
            }
            if count > width {
                self.pairs::<S, FUSED, SIDE>(on, &table, &versines, first);
            } else {
                self.pairs::<S, FUSED, 1>(on, &table, &versines, first);
            }
            first += count;
        }
    }

    /// The directions of `SIDE` vectors from `first` on, and their mirror images.
    #[inline(always)]
    fn pairs<S: Simd, const FUSED: bool, const SIDE: usize>(
        &mut self,
        on: Vector<S, FUSED>,
        table: &Factors,
        versines: &[[f64; BATCH]; 2],
        first: usize,
    ) {
        let width = S::F64_LANES;
        let mut sums = [Amplitudes::<S>::nothing(on); SIDE];
        let mut angles = [Angles::<S>::new(on, on.load(&versines[0])); SIDE];
        for s in 1..SIDE {
            angles[s] = Angles::new(on, on.load(&versines[s]));
        }
        let mut n = 1;
        while n <= self.terms.len() {
            let factor = table.at(n);
            let term = Coefficients::of(on, self.terms[n - 1]);
            for s in 0..SIDE {
                let (pi, tau) = angles[s].step(on, factor);
                sums[s] = sums[s].with_odd(on, &term, pi, tau);
            }
            n += 1;
            if n > self.terms.len() {
                break;
            }
            let factor = table.at(n);
            let term = Coefficients::of(on, self.terms[n - 1]);
            for s in 0..SIDE {
                let (pi, tau) = angles[s].step(on, factor);
                sums[s] = sums[s].with_even(on, &term, pi, tau);
            }
            n += 1;
        }
        let last = self.directions.len() - 1;
        for (s, sums) in sums.iter().enumerate() {
            let [ahead, behind] = sums.both(on);
            let begin = first + s * width;
            for at in begin..(begin + width).min(self.half) {
                let lane = at - begin;
                let of = |parts: &[[f64; BATCH]; 4]| {
                    (
                        Complex::new(parts[0][lane], parts[1][lane]),
                        Complex::new(parts[2][lane], parts[3][lane]),
                    )
                };
                let backward = self.directions[at].backward;
                self.found[at] = of(if backward { &behind } else { &ahead });
                // The mirror image, where it is one of the directions.
                if last - at >= self.half {
                    self.found[last - at] = of(if backward { &ahead } else { &behind });
                }
            }
        }
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
    fn a_list_that_is_its_own_mirror_image_gives_what_each_direction_gives() {
        let sphere = Sphere { size_parameter: 12.3, n: 1.4, k: 1e-3 };
        let all: Vec<Direction> =
            (0..=180).map(|degrees| Direction::from_degrees(f64::from(degrees)).unwrap()).collect();
        // Whole, with an even number of directions, and back to front; against one at a time.
        let even: Vec<Direction> = all.iter().copied().filter(|d| d.cosine().abs() > 1e-3).collect();
        let back: Vec<Direction> = all.iter().rev().copied().collect();
        for list in [&all, &even, &back] {
            for (direction, found) in list.iter().zip(amplitudes_towards(sphere, list).unwrap()) {
                assert_eq!(found, amplitudes_towards(sphere, &[*direction]).unwrap()[0], "{direction:?}");
            }
        }
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
