//! Phase functions: isotropic, Henyey–Greenstein, tabulated.
//!
//! Each one evaluates, samples exactly what it evaluates, and knows its mean cosine. Polarisation is absent.

use std::f64::consts::PI;
use std::sync::Arc;

/// Largest distance of a table's ends from 0 and π that is taken for rounding, in radians.
const END_TOLERANCE_RAD: f64 = 1e-6;

/// Limit of the safeguarded Newton iteration inside one segment of a table; bisection alone needs 53.
const INVERSION_STEPS_MAX: usize = 80;

/// An angular distribution of scattered light, normalised so that ½∫p dμ = 1.
#[derive(Debug, Clone)]
pub enum PhaseFunction {
    /// The same into all directions.
    Isotropic,
    /// Henyey and Greenstein (1941) with mean cosine `asymmetry` in [−1, 1].
    HenyeyGreenstein {
        /// Mean cosine.
        asymmetry: f64,
    },
    /// A table over the scattering angle, linear in the angle between nodes.
    Table(Arc<PhaseTable>),
}

/// A tabulated phase function, normalised at construction, with its cumulative distribution.
#[derive(Debug, Clone)]
pub struct PhaseTable {
    theta_rad: Vec<f64>,
    value: Vec<f64>,
    /// ½∫p sin θ dθ from 0 to each node; the last entry is 1.
    cumulative: Vec<f64>,
    mean_cosine: f64,
}

/// Why a table is not a phase function.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhaseError {
    /// phase table: {angles} angles and {values} values; give at least two pairs
    #[error("phase table: {angles} angles and {values} values; give at least two pairs")]
    Length {
        /// Number of angles given.
        angles: usize,
        /// Number of values given.
        values: usize,
    },
    /// phase table: the angles must rise from 0 to 180 degrees, entry {entry} does not
    #[error("phase table: the angles must rise from 0 to 180 degrees, entry {entry} does not")]
    Angle {
        /// Index of the first bad angle.
        entry: usize,
    },
    /// phase table: entry {entry} is negative or not a number
    #[error("phase table: entry {entry} is negative or not a number")]
    Value {
        /// Index of the first bad value.
        entry: usize,
    },
    /// phase table: it is zero at all angles
    #[error("phase table: it is zero at all angles")]
    Zero,
}

impl PhaseFunction {
    /// The phase function at the cosine of the scattering angle (1 = forward), normalised so that ½∫p dμ = 1.
    ///
    /// At asymmetry ±1 the function is a Dirac peak: zero everywhere but at the peak itself, where the largest
    /// finite number stands for it.
    pub fn value(&self, cosine: f64) -> f64 {
        match self {
            Self::Isotropic => 1.0,
            Self::HenyeyGreenstein { asymmetry } => henyey_greenstein(*asymmetry, cosine),
            Self::Table(table) => table.value(cosine),
        }
    }

    /// The cosine of the scattering angle below which the fraction `u` in [0, 1] of the light is scattered. Distributed as `value` when `u` is uniform.
    pub fn sample(&self, u: f64) -> f64 {
        match self {
            Self::Isotropic => (2.0 * u - 1.0).clamp(-1.0, 1.0),
            Self::HenyeyGreenstein { asymmetry } => henyey_greenstein_sample(*asymmetry, u),
            Self::Table(table) => table.sample(u),
        }
    }

    /// The mean cosine ½∫p μ dμ.
    pub fn mean_cosine(&self) -> f64 {
        match self {
            Self::Isotropic => 0.0,
            Self::HenyeyGreenstein { asymmetry } => *asymmetry,
            Self::Table(table) => table.mean_cosine,
        }
    }
}

/// p(μ) = (1 − g²) / ((1 − g)² + 2 g (1 − μ))^(3/2): Henyey and Greenstein (1941), the denominator written so that
/// it does not cancel near the forward peak.
fn henyey_greenstein(asymmetry: f64, cosine: f64) -> f64 {
    let g = asymmetry.abs();
    let mu = if asymmetry < 0.0 { -cosine } else { cosine };
    if g >= 1.0 {
        return if mu >= 1.0 { f64::MAX } else { 0.0 };
    }
    let base = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - mu).max(0.0);
    (1.0 - g) * (1.0 + g) / (base * base.sqrt())
}

/// The inverse of the cumulative distribution, multiplied out so that nothing is divided by g: with s = 2u − 1,
/// μ = (s + g(s² + 3)/2 + g² s + g³(s² − 1)/2) / (1 + g s)².
fn henyey_greenstein_sample(asymmetry: f64, u: f64) -> f64 {
    let g = asymmetry;
    if g.abs() >= 1.0 {
        return g.signum();
    }
    let s = 2.0 * u - 1.0;
    let base = 1.0 + g * s;
    let numerator = s + 0.5 * g * (s * s + 3.0) + g * g * s + 0.5 * g * g * g * (s * s - 1.0);
    (numerator / (base * base)).clamp(-1.0, 1.0)
}

impl PhaseTable {
    /// Makes a phase function from values `p11` at the scattering angles `theta_rad` (rising from 0 to π), linear in
    /// the angle between nodes, and renormalises it exactly. Returns the norm ½∫p sin θ dθ that was found.
    ///
    /// # Errors
    ///
    /// [`PhaseError`] for fewer than two nodes, angles that do not rise from 0 to π, negative or undefined values, and
    /// a table that is zero everywhere.
    pub fn new(theta_rad: &[f64], p11: &[f64]) -> Result<(Self, f64), PhaseError> {
        if theta_rad.len() != p11.len() || theta_rad.len() < 2 {
            return Err(PhaseError::Length { angles: theta_rad.len(), values: p11.len() });
        }
        let mut theta = theta_rad.to_vec();
        let last = theta.len() - 1;
        if theta[0].is_nan() || theta[0].abs() > END_TOLERANCE_RAD {
            return Err(PhaseError::Angle { entry: 0 });
        }
        if theta[last].is_nan() || (theta[last] - PI).abs() > END_TOLERANCE_RAD {
            return Err(PhaseError::Angle { entry: last });
        }
        theta[0] = 0.0;
        theta[last] = PI;
        if let Some(entry) = (1..=last)
            .find(|&i| !matches!(theta[i].partial_cmp(&theta[i - 1]), Some(std::cmp::Ordering::Greater)))
        {
            return Err(PhaseError::Angle { entry });
        }
        if let Some(entry) = p11.iter().position(|&p| !(p.is_finite() && p >= 0.0)) {
            return Err(PhaseError::Value { entry });
        }
        // A spike of 1e300 must not overflow the sum.
        let peak = p11.iter().fold(0.0_f64, |peak, &p| peak.max(p));
        if peak <= 0.0 {
            return Err(PhaseError::Zero);
        }
        let mut value: Vec<f64> = p11.iter().map(|&p| p / peak).collect();
        let mut cumulative = vec![0.0; theta.len()];
        let mut first_moment = 0.0;
        for i in 1..=last {
            cumulative[i] = cumulative[i - 1] + mass(theta[i - 1], theta[i], value[i - 1], value[i]);
            first_moment += cosine_mass(theta[i - 1], theta[i], value[i - 1], value[i]);
        }
        let norm = cumulative[last];
        if norm <= 0.0 {
            return Err(PhaseError::Zero);
        }
        value.iter_mut().chain(cumulative.iter_mut()).for_each(|v| *v /= norm);
        let mean_cosine = (first_moment / norm).clamp(-1.0, 1.0);
        Ok((Self { theta_rad: theta, value, cumulative, mean_cosine }, norm * peak))
    }

    /// The normalised phase function at the cosine of the scattering angle.
    pub fn value(&self, cosine: f64) -> f64 {
        let theta = cosine.clamp(-1.0, 1.0).acos();
        let i = self.theta_rad.partition_point(|&t| t <= theta).clamp(1, self.theta_rad.len() - 1);
        let (t0, t1) = (self.theta_rad[i - 1], self.theta_rad[i]);
        let f = (theta - t0) / (t1 - t0);
        self.value[i - 1] * (1.0 - f) + self.value[i] * f
    }

    /// The scattering angles of the nodes in radians.
    pub fn theta_rad(&self) -> &[f64] {
        &self.theta_rad
    }

    /// The cosine of the angle beyond which the fraction `u` of the light is scattered.
    fn sample(&self, u: f64) -> f64 {
        let u = (1.0 - u).clamp(0.0, 1.0);
        let i = self.cumulative.partition_point(|&c| c <= u).clamp(1, self.theta_rad.len() - 1);
        let (t0, t1) = (self.theta_rad[i - 1], self.theta_rad[i]);
        let (p0, p1) = (self.value[i - 1], self.value[i]);
        let wanted = u - self.cumulative[i - 1];
        let slope = (p1 - p0) / (t1 - t0);
        let (mut low, mut high) = (t0, t1);
        // Starts from the inverse for a density that is linear in the angle: two steps then suffice in narrow segments.
        let (d0, d1) = (0.5 * p0 * t0.sin() * (t1 - t0), 0.5 * p1 * t1.sin() * (t1 - t0));
        let root = (d0 * d0 + 2.0 * (d1 - d0) * wanted).max(0.0).sqrt();
        let guess = if d0 + root > 0.0 { (2.0 * wanted / (d0 + root)).clamp(0.0, 1.0) } else { 0.5 };
        let mut theta = t0 + guess * (t1 - t0);
        for _ in 0..INVERSION_STEPS_MAX {
            let p = p0 + slope * (theta - t0);
            let excess = mass(t0, theta, p0, p) - wanted;
            if excess > 0.0 {
                high = theta;
            } else {
                low = theta;
            }
            let density = 0.5 * p * theta.sin();
            let newton = theta - excess / density;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            if (next - theta).abs() <= 4.0 * f64::EPSILON * theta {
                break;
            }
            theta = next;
        }
        theta.cos()
    }
}

/// ½∫p sin θ dθ over a segment on which p is linear: exact, and free of cancellation for narrow segments.
fn mass(t0: f64, t1: f64, p0: f64, p1: f64) -> f64 {
    let (middle, half) = (0.5 * (t0 + t1), 0.5 * (t1 - t0));
    if half <= 0.0 {
        return 0.0;
    }
    let mean = 0.5 * (p0 + p1);
    let slope = 0.5 * (p1 - p0) / half;
    mean * middle.sin() * half.sin() + slope * middle.cos() * sine_excess(half)
}

/// ½∫p cos θ sin θ dθ over a segment on which p is linear.
fn cosine_mass(t0: f64, t1: f64, p0: f64, p1: f64) -> f64 {
    let (middle, half) = (t0 + t1, t1 - t0);
    let mean = 0.5 * (p0 + p1);
    let slope = (p1 - p0) / half;
    0.25 * (mean * middle.sin() * half.sin() + 0.5 * slope * middle.cos() * sine_excess(half))
}

/// sin h − h cos h, by its series where the difference would cancel.
fn sine_excess(h: f64) -> f64 {
    if h > 0.3 {
        return h.sin() - h * h.cos();
    }
    // Σ (−1)^k h^(2k+3) (2k+2)/(2k+3)!: seven terms leave less than 1e-17 relative at 0.3.
    let square = h * h;
    let mut term = h * square / 6.0;
    let mut sum = 2.0 * term;
    for k in 1..7_i32 {
        let m = f64::from(2 * k + 3);
        term *= -square / (m * (m - 1.0));
        sum += term * f64::from(2 * k + 2);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mie_like() -> PhaseFunction {
        let theta: Vec<f64> = (0..=360).map(|i| PI * f64::from(i) / 360.0).collect();
        let p: Vec<f64> =
            theta.iter().map(|&t| 260.0 * (-t * t / 0.01).exp() + 0.4 + 0.2 * (9.0 * t).cos()).collect();
        PhaseFunction::Table(Arc::new(PhaseTable::new(&theta, &p).unwrap().0))
    }

    fn all() -> Vec<PhaseFunction> {
        let mut list = vec![PhaseFunction::Isotropic, mie_like()];
        for asymmetry in [-0.999, -0.5, -1e-9, 0.0, 1e-9, 0.3, 0.85, 0.99] {
            list.push(PhaseFunction::HenyeyGreenstein { asymmetry });
        }
        list
    }

    /// ½∫p dμ over [a, b] in the angle, fine midpoint rule.
    fn integral(phase: &PhaseFunction, a: f64, b: f64, weight: impl Fn(f64) -> f64) -> f64 {
        let n = 200_000;
        let h = (b - a) / f64::from(n);
        (0..n)
            .map(|i| {
                let t = a + (f64::from(i) + 0.5) * h;
                0.5 * phase.value(t.cos()) * weight(t.cos()) * t.sin() * h
            })
            .sum()
    }

    #[test]
    fn every_phase_function_is_normalised_and_has_its_mean_cosine() {
        for phase in all() {
            assert!((integral(&phase, 0.0, PI, |_| 1.0) - 1.0).abs() < 2e-4, "{phase:?}");
            assert!((integral(&phase, 0.0, PI, |mu| mu) - phase.mean_cosine()).abs() < 2e-4, "{phase:?}");
        }
    }

    /// χ² of 64 bins of equal angle against the integral of `value`; 1 % quantile of χ²(63) is 92.
    #[test]
    fn samples_are_distributed_as_evaluated() {
        let seed = 0x9e37_79b9_7f4a_7c15_u64;
        for phase in all() {
            let mut state = seed;
            let n = 100_000;
            let bins = 64;
            let mut counts = vec![0.0; bins];
            for _ in 0..n {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let u = f64::from(u32::try_from(state >> 32).unwrap()) / 4_294_967_296.0;
                let theta = phase.sample(u).clamp(-1.0, 1.0).acos();
                let bin = (0..bins).rev().find(|&b| theta >= PI * b as f64 / bins as f64).unwrap();
                counts[bin] += 1.0;
            }
            let (mut chi2, mut rest, mut rest_expected) = (0.0, 0.0, 0.0);
            for (b, count) in counts.iter().enumerate() {
                let expected = f64::from(n)
                    * integral(&phase, PI * b as f64 / 64.0, PI * (b + 1) as f64 / 64.0, |_| 1.0);
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
            assert!(chi2 < 115.0, "chi2 {chi2} seed {seed} {phase:?}");
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
            }
        }
    }

    #[test]
    fn spike_and_bad_norm_are_renormalised_and_reported() {
        let (table, norm) = PhaseTable::new(&[0.0, 1e-3, PI], &[1e6, 3.0, 3.0]).unwrap();
        // 3 everywhere plus a triangle: ½∫(1e6 − 3)(1 − θ/1e-3) θ dθ = (1e6 − 3)·1e-6/12, sin θ = θ to 2e-7.
        assert!((norm - 3.0 - 999_997.0 * 1e-6 / 12.0).abs() < 1e-6);
        assert!((integral(&PhaseFunction::Table(Arc::new(table)), 0.0, PI, |_| 1.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn bad_tables_are_refused() {
        assert!(matches!(PhaseTable::new(&[0.0], &[1.0]), Err(PhaseError::Length { .. })));
        assert!(matches!(
            PhaseTable::new(&[0.0, 1.0, 1.0, PI], &[1.0; 4]),
            Err(PhaseError::Angle { entry: 2 })
        ));
        assert!(matches!(PhaseTable::new(&[0.0, 3.0], &[1.0; 2]), Err(PhaseError::Angle { entry: 1 })));
        assert!(matches!(PhaseTable::new(&[0.0, PI], &[1.0, f64::NAN]), Err(PhaseError::Value { entry: 1 })));
        assert!(matches!(PhaseTable::new(&[0.0, PI], &[0.0, 0.0]), Err(PhaseError::Zero)));
    }
}
