//! An angular pattern as a cosine series: values, distribution, mean cosine.
//!
//! A sphere with N orders scatters a polynomial of degree 2N in cos θ, so the series is exact.

use super::series::fused;
use super::vector::{BATCH, Vector};
use pulp::Simd;
use std::f64::consts::PI;

/// Angles at which two patterns are compared.
const COMPARED: usize = 48;

/// What many spheres scatter together.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pattern {
    /// c_k with Σ number · (|S₁|² + |S₂|²) = Σ c_k cos kθ; empty when nothing scatters.
    pub cosines: Vec<f64>,
}

impl Pattern {
    /// Σ c_k cos kθ by Clenshaw's recurrence.
    pub fn at(&self, cosine: f64) -> f64 {
        let (mut next, mut after) = (0.0, 0.0);
        for &c in self.cosines.iter().skip(1).rev() {
            (next, after) = (c + 2.0 * cosine * next - after, next);
        }
        self.cosines.first().map_or(0.0, |first| first + cosine * next - after)
    }

    /// The series' ½∫ from θ = 0, times sin θ, as a cosine series itself: e_k with ½∫₀^θ = Σ e_k cos kθ.
    ///
    /// Absolute error below 1e-11 of [`Pattern::total`] when it is evaluated by a recurrence.
    pub fn within(&self) -> Self {
        // ½∫cos kt sin t dt = ¼ [(1 − cos (k+1)θ)/(k+1) − (1 − cos (k−1)θ)/(k−1)].
        let c = |k: usize| self.cosines.get(k).copied().unwrap_or(0.0);
        let mut cosines = vec![0.0; if self.cosines.is_empty() { 0 } else { self.cosines.len() + 1 }];
        for k in (1..cosines.len()).rev() {
            let below = if k == 1 { 2.0 * c(0) } else { c(k - 1) };
            cosines[k] = (c(k + 1) - below) / (4.0 * k as f64);
            cosines[0] -= cosines[k];
        }
        Self { cosines }
    }

    /// [`Pattern::at`] many cosines at once.
    pub fn at_many(&self, cosines: &[f64]) -> Vec<f64> {
        pulp::Arch::new().dispatch(Evaluation { series: &self.cosines, at: cosines })
    }

    /// Mean cosine of the series, taken as a phase function of any norm; 0 when nothing scatters.
    pub fn mean_cosine(&self) -> f64 {
        // ½∫cos kθ cos θ sin θ dθ = 1/(4 − k²) for odd k, 0 for even k.
        let odd = self.cosines.iter().skip(1).step_by(2).zip(0u32..);
        let sum: f64 = odd.map(|(c, i)| c / (4.0 - f64::from(2 * i + 1).powi(2))).sum();
        let total = self.total();
        if total > 0.0 { sum / total } else { 0.0 }
    }

    /// Divided by its total; as it is when nothing scatters.
    pub fn normalised(self) -> Self {
        let total = self.total();
        if total > 0.0 { self.scaled(total.recip()) } else { self }
    }

    /// Times a number.
    pub fn scaled(mut self, factor: f64) -> Self {
        for c in &mut self.cosines {
            *c *= factor;
        }
        self
    }

    /// The sum of both.
    pub fn and(mut self, other: &Self) -> Self {
        if self.cosines.len() < other.cosines.len() {
            self.cosines.resize(other.cosines.len(), 0.0);
        }
        for (own, other) in self.cosines.iter_mut().zip(&other.cosines) {
            *own += other;
        }
        self
    }

    /// Largest distance between the cumulative distributions of two patterns, compared at 48 angles that grow as squares
    /// from 0.08°; 1 when only one of them scatters.
    pub fn distance(&self, other: &Self) -> f64 {
        let cosines: Vec<f64> = (1..=COMPARED)
            .map(|i| {
                let u = i as f64 / COMPARED as f64;
                (PI * u * u).cos()
            })
            .collect();
        let shares = |pattern: &Self| {
            let total = pattern.total();
            let within = pattern.within().at_many(&cosines);
            within.into_iter().map(move |share| if total > 0.0 { share / total } else { 0.0 })
        };
        shares(self).zip(shares(other)).fold(0.0, |largest, (a, b)| largest.max((a - b).abs()))
    }

    /// ½∫ of the series over the sphere: Σ number x² Q_sca / 2.
    pub fn total(&self) -> f64 {
        // ½∫cos kθ sin θ dθ = 1/(1 − k²) for even k, 0 for odd k.
        self.cosines.iter().step_by(2).zip(0u32..).map(|(c, i)| c / (1.0 - 4.0 * f64::from(i * i))).sum()
    }
}

/// Σ c_k cos kθ at many cos θ.
struct Evaluation<'a> {
    series: &'a [f64],
    at: &'a [f64],
}

impl pulp::WithSimd for Evaluation<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        if fused::<S>() { self.run::<S, true>(simd) } else { self.run::<S, false>(simd) }
    }
}

impl Evaluation<'_> {
    /// Clenshaw's recurrence.
    #[inline(always)]
    fn run<S: Simd, const FUSED: bool>(&self, simd: S) -> Vec<f64> {
        /// Vectors of angles side by side.
        const WAYS: usize = 4;
        let on = Vector::<S, FUSED>(simd);
        let width = S::F64_LANES;
        let mut found = Vec::with_capacity(self.at.len());
        let Some((&constant, rest)) = self.series.split_first() else { return vec![0.0; self.at.len()] };
        for chunk in self.at.chunks(WAYS * width) {
            let mut cosine = [on.all(0.0); WAYS];
            let mut twice = cosine;
            for (w, cosines) in chunk.chunks(width).enumerate() {
                let mut numbers = [0.0; BATCH];
                numbers[..cosines.len()].copy_from_slice(cosines);
                cosine[w] = on.load(&numbers);
                twice[w] = on.add(cosine[w], cosine[w]);
            }
            let mut next = [on.all(0.0); WAYS];
            let mut after = next;
            for c in rest.iter().rev() {
                let c = on.all(*c);
                for w in 0..WAYS {
                    let here = on.mul_add(twice[w], next[w], on.sub(c, after[w]));
                    after[w] = next[w];
                    next[w] = here;
                }
            }
            for (w, cosines) in chunk.chunks(width).enumerate() {
                let sum = on.mul_add(cosine[w], next[w], on.sub(on.all(constant), after[w]));
                found.extend_from_slice(&on.store(sum)[..cosines.len()]);
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Direction, MieError, Sphere, amplitudes_towards, efficiencies};
    use super::*;

    fn sphere(size_parameter: f64, n: f64, k: f64) -> Sphere {
        Sphere { size_parameter, n, k }
    }

    #[test]
    fn the_series_is_the_sum_of_the_amplitudes() {
        let spheres = [
            sphere(1e-3, 1.4, 0.1),
            sphere(0.5, 1.33, 0.0),
            sphere(5.0, 1.4, 0.08),
            sphere(6.0, 1.02, 1e-3),
            sphere(40.0, 1.5, 1e-4),
            sphere(300.0, 1.38, 0.09),
            sphere(700.0, 1.3, 2e-3),
        ];
        let numbers = [1e12, 3.0, 1.0, 7.0, 0.2, 0.0, 1e-5];
        let pattern = Pattern::of(&spheres, &numbers).unwrap();
        let degrees = [0.0, 0.01, 0.5, 3.0, 17.0, 60.0, 90.0, 123.4, 170.0, 179.9, 180.0];
        let towards: Vec<Direction> = degrees.iter().map(|d| Direction::from_degrees(*d).unwrap()).collect();
        let mut wanted = vec![0.0; degrees.len()];
        let mut scattered = 0.0;
        for (sphere, number) in spheres.iter().zip(numbers) {
            for (sum, (s1, s2)) in wanted.iter_mut().zip(amplitudes_towards(*sphere, &towards).unwrap()) {
                *sum += number * (s1.norm_sqr() + s2.norm_sqr());
            }
            let q = efficiencies(sphere.size_parameter, sphere.n, sphere.k).unwrap().q_sca;
            scattered += number * sphere.size_parameter * sphere.size_parameter * q;
        }
        let largest = wanted.iter().fold(0.0f64, |a, &b| a.max(b));
        for ((degrees, wanted), direction) in degrees.iter().zip(&wanted).zip(&towards) {
            let found = pattern.at(direction.cosine());
            assert!((found - wanted).abs() < 1e-8 * largest, "{degrees}: {found:e} {wanted:e}");
        }
        assert!((pattern.total() / (0.5 * scattered) - 1.0).abs() < 1e-8);
        // The distribution from its own series: nothing at 0°, everything at 180°, and a rise of f sin θ dθ/2.
        let within = pattern.within();
        assert!((within.at(-1.0) / pattern.total() - 1.0).abs() < 1e-10);
        assert!((within.at(1.0) / pattern.total()).abs() < 1e-10);
        let cosines: Vec<f64> = (0..77).map(|i| (f64::from(i) * 0.04).cos()).collect();
        for (cosine, many) in cosines.iter().zip(within.at_many(&cosines)) {
            assert!((within.at(*cosine) - many).abs() < 1e-10 * pattern.total());
            let (theta, h) = (cosine.acos(), 1e-4);
            let rise = (within.at((theta + h).cos()) - within.at((theta - h).cos())) / (2.0 * h);
            // Truncation: h²/6 of the third derivative, below (2N)² of the largest value.
            let wanted = 0.5 * pattern.at(*cosine) * theta.sin();
            assert!((rise - wanted).abs() < 1e-2 * largest.max(1.0) * 1e-2, "{theta}: {rise} {wanted}");
        }
    }

    #[test]
    fn equal_spheres_add_up_and_nothing_scatters_nothing() {
        let one = Pattern::of(&[sphere(12.0, 1.4, 0.01)], &[100.0]).unwrap();
        let many = Pattern::of(&[sphere(12.0, 1.4, 0.01); 100], &[1.0; 100]).unwrap();
        for (one, many) in one.cosines.iter().zip(&many.cosines) {
            assert!((one - many).abs() < 1e-12 * one.abs().max(one.abs()) + 1e-9, "{one} {many}");
        }
        assert!(Pattern::of(&[sphere(0.0, 1.4, 0.0)], &[1.0]).unwrap().cosines.is_empty());
        assert!(Pattern::of(&[], &[]).unwrap().cosines.is_empty());
        assert!(matches!(Pattern::of(&[sphere(2e5, 1.4, 0.0)], &[1.0]), Err((0, MieError::TooLarge { .. }))));
        assert!(matches!(Pattern::of(&[sphere(2.0, 1.4, -1.0)], &[1.0]), Err((0, MieError::Index { .. }))));
    }
}
