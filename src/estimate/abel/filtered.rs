//! Transforms with a strength: what the data say in a basis, a filter on it, and what that is at the radii.
//!
//! f = synthesis · φ(strength) · analysis · p. All strengths share one analysis, so that a strength can be found for
//! every row from the squares of its coefficients alone.

use super::elements;
use super::matrix::{self, Matrix};
use super::operators::radius;
use super::request::Elements;
use ditd_sim::light::quadrature::gauss_legendre_unit;
use std::f64::consts::PI;

/// Tikhonov strengths are searched from here …
const STRENGTH_MIN: f64 = 1e-6;
/// … in steps of the fourth root of ten …
const STRENGTHS_PER_DECADE: f64 = 4.0;
/// … this often: to 10⁸, where half a thousand radii are flat.
const STRENGTHS: usize = 57;

/// Cosines of the Fourier method at most: finer features are left to the other methods.
const COSINES_MAX: usize = 96;

/// A column of a basis that is shorter than this after what the others hold is taken out of it, is not believed.
const INDEPENDENT_MIN: f64 = 1e-9;

/// A transform with a strength, at `n` radii.
#[derive(Debug, Clone)]
pub(super) struct Filtered {
    /// Columns are the basis of the data: orthonormal.
    pub(super) analysis: Matrix,
    /// Rows are what each of them means at the radii.
    pub(super) synthesis: Matrix,
    /// From the weakest to the strongest.
    pub(super) choices: Vec<Choice>,
    /// Whether the basis holds all data.
    pub(super) complete: bool,
    /// So many of the smoothest members choose a strength where the others hold noise: what is kept of those falls below a half.
    pub(super) short: usize,
}

/// One strength.
#[derive(Debug, Clone)]
pub(super) struct Choice {
    /// Tikhonov's λ in pixels, or the number of cosines.
    pub(super) strength: f64,
    /// What is kept of each coefficient, 0 … 1.
    pub(super) filter: Vec<f64>,
    /// Factors on the answer; empty for none.
    pub(super) correction: Vec<f64>,
}

impl Choice {
    /// What is left of the square of a coefficient.
    pub(super) fn left(&self, k: usize) -> f64 {
        (1.0 - self.filter[k]).powi(2)
    }

    /// Degrees of freedom that the answer takes from the data.
    pub(super) fn freedom(&self) -> f64 {
        self.filter.iter().sum()
    }
}

impl Filtered {
    /// The operator of one choice: row i belongs to radius i.
    pub(super) fn operator(&self, choice: usize) -> Matrix {
        let Choice { filter, correction, .. } = &self.choices[choice];
        let mut scaled = self.synthesis.transposed();
        for i in 0..scaled.rows {
            let factor = correction.get(i).copied().unwrap_or(1.0);
            scaled.row_mut(i).iter_mut().zip(filter).for_each(|(value, filter)| *value *= filter * factor);
        }
        scaled.times(&self.analysis.transposed())
    }
}

fn strengths() -> impl Iterator<Item = f64> {
    #[expect(clippy::cast_precision_loss, reason = "small numbers")]
    (0..STRENGTHS).map(|k| STRENGTH_MIN * libm::pow(10.0, k as f64 / STRENGTHS_PER_DECADE))
}

/// Square of the differences between neighbours, LᵀL, with free ends.
pub(super) fn roughness(n: usize) -> Matrix {
    Matrix::from_fn(n, n, |i, j| match i.abs_diff(j) {
        0 if n == 1 => 0.0,
        0 if i == 0 || i + 1 == n => 1.0,
        0 => 2.0,
        1 => -1.0,
        _ => 0.0,
    })
}

/// Tikhonov's regularisation with the differences of neighbours (K. J. Daun et al., Appl. Opt. 45, 4638 (2006)):
/// |A f − p|² + λ |L f|² is least.
pub(super) fn daun(n: usize, phase: f64, of: Elements, fixed: Option<f64>) -> Option<Filtered> {
    let inverse = elements::inverse(of, &elements::columns(of, n, phase))?;
    // With q = A f: |q − p|² + λ qᵀ K q, K = A⁻ᵀ LᵀL A⁻¹ = V μ Vᵀ, so that q = V (1 + λμ)⁻¹ Vᵀ p.
    let k = inverse.transposed().times(&roughness(n).times(&inverse));
    let k = Matrix::from_fn(n, n, |i, j| 0.5 * (k.at(i, j) + k.at(j, i)));
    let (mu, v) = matrix::eigen(&k)?;
    let choice = |strength: f64| Choice {
        strength,
        filter: mu.iter().map(|mu| 1.0 / (1.0 + strength * mu.max(0.0))).collect(),
        correction: Vec::new(),
    };
    let choices = fixed.map_or_else(|| strengths().map(choice).collect(), |one| vec![choice(one)]);
    Some(Filtered {
        synthesis: inverse.times(&v).transposed(),
        analysis: v,
        choices,
        complete: true,
        short: 128,
    })
}

/// BASEX (V. Dribinski et al., Rev. Sci. Instrum. 73, 2634 (2002)): shells of a Gaussian-like section, one a pixel, with
/// Tikhonov's regularisation of their amplitudes, and divided by what it makes of a disc, as PyAbel does.
pub(super) fn basex(n: usize, phase: f64, fixed: Option<f64>) -> Option<Filtered> {
    let Shells { seen, own } = shells(n, phase);
    let (squares, v) = matrix::eigen(&seen.times(&seen.transposed()))?;
    let largest = squares.last().copied().unwrap_or(0.0);
    let mut synthesis = v.transposed().times(&seen).times(&own.transposed());
    for (k, &square) in squares.iter().enumerate() {
        let scale = if square > INDEPENDENT_MIN * INDEPENDENT_MIN * largest { 1.0 / square } else { 0.0 };
        synthesis.row_mut(k).iter_mut().for_each(|value| *value *= scale);
    }
    let (disc, chords) = soft_disc(n, phase);
    // The disc's coefficients serve every strength.
    let seen: Vec<f64> = (0..n).map(|k| (0..n).map(|i| v.at(i, k) * chords[i]).sum()).collect();
    let choice = |strength: f64| {
        let filter: Vec<f64> = squares.iter().map(|&s| s.max(0.0) / (s.max(0.0) + strength)).collect();
        let mut made = vec![0.0; n];
        for k in 0..n {
            let amplitude = filter[k] * seen[k];
            made.iter_mut().zip(synthesis.row(k)).for_each(|(made, value)| *made += amplitude * value);
        }
        let correction = made.iter().zip(&disc).map(|(&made, &disc)| correction(made, disc)).collect();
        Choice { strength, filter, correction }
    };
    let choices = fixed.map_or_else(|| strengths().map(choice).collect(), |one| vec![choice(one)]);
    Some(Filtered { analysis: v, synthesis, choices, complete: true, short: 192 })
}

/// Least part of a disc that is corrected for.
const CORRECTED_MIN: f64 = 0.1;

/// What makes the disc out of what BASEX makes of it. Where next to nothing is left of it, a factor would only blow up
/// noise.
pub(super) fn correction(made: f64, disc: f64) -> f64 {
    if made > CORRECTED_MIN * disc { disc / made } else { 1.0 }
}

/// The shells of BASEX at the radii: as they are seen, and as they are. `[radius][shell]`.
pub(super) struct Shells {
    pub(super) seen: Matrix,
    pub(super) own: Matrix,
}

pub(super) fn shells(n: usize, phase: f64) -> Shells {
    // ρ(r) = (e/κ²)^κ² r^2κ² exp(−r²) peaks at κ; between two pixels κ is half an integer as well.
    let own = |r: f64, kappa: f64| {
        let square = kappa * kappa;
        if kappa <= 0.0 {
            (-r * r).exp()
        } else if r <= 0.0 {
            0.0
        } else {
            (square * (1.0 + 2.0 * (r / kappa).ln()) - r * r).exp()
        }
    };
    // Beyond this distance from its peak a shell is below e^−72.
    let reach = 6.0;
    let seen = |y: f64, kappa: f64| {
        if y > kappa + reach {
            return 0.0;
        }
        // 2 ∫ ρ(√(y² + z²)) dz by the trapezoidal rule, which converges faster than any power here: the section's
        // width in z is at least ½ (error e^−79); the root at the axis of the first shells needs smaller steps (e^−31).
        let step: f64 = if kappa < 3.0 { 0.1 } else { 0.25 };
        let from = if kappa - reach > y { ((kappa - reach).powi(2) - y * y).sqrt() } else { 0.0 };
        let to = ((kappa + reach).powi(2) - y * y).sqrt();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few thousand steps")]
        let (first, last) = ((from / step) as usize, (to / step).ceil() as usize);
        let mut sum = 0.0;
        for k in first..=last {
            let z = radius(k, 0.0) * step;
            let weight = if k == 0 { 0.5 } else { 1.0 };
            sum += weight * own(y.hypot(z), kappa);
        }
        2.0 * step * sum
    };
    Shells {
        seen: Matrix::from_fn(n, n, |i, k| seen(radius(i, phase), radius(k, phase))),
        own: Matrix::from_fn(n, n, |i, k| own(radius(i, phase), radius(k, phase))),
    }
}

/// A disc to the last radius with an edge of two parabolas, one pixel each, and its columns.
pub(super) fn soft_disc(n: usize, phase: f64) -> (Vec<f64>, Vec<f64>) {
    let edge = radius(n, phase) - 0.5;
    let profile = |r: f64| {
        let t = r - edge;
        if t <= -1.0 {
            1.0
        } else if t <= 0.0 {
            1.0 - 0.5 * (t + 1.0) * (t + 1.0)
        } else {
            0.5 * (1.0 - t).max(0.0).powi(2)
        }
    };
    let rule = gauss_legendre_unit(16);
    let column = |y: f64| {
        let mut sum = 0.0;
        let mut from = 0.0;
        for end in [edge - 1.0, edge, edge + 1.0] {
            let to = (end * end - y * y).max(0.0).sqrt();
            if to > from {
                let part = |&(t, w): &(f64, f64)| w * profile(y.hypot(from + t * (to - from)));
                sum += (to - from) * rule.iter().map(part).sum::<f64>();
                from = to;
            }
        }
        2.0 * sum
    };
    ((0..n).map(|i| profile(radius(i, phase))).collect(), (0..n).map(|i| column(radius(i, phase))).collect())
}

/// The Fourier method (G. Pretzler, Z. Naturforsch. 46a, 639 (1991)): f = a₀ + Σ a_k (1 − (−1)^k cos(kπ r/R)) fitted to the
/// columns by least squares; the strength is the number of cosines.
pub(super) fn fourier(n: usize, phase: f64, fixed: Option<f64>) -> Filtered {
    let most = COSINES_MAX.min(n / 2);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 ..= most")]
    let fixed = fixed.map(|cosines| cosines.clamp(0.0, radius(most, 0.0)) as usize);
    let cosines = fixed.unwrap_or(most);
    let (seen, own) = cosines_seen(n, phase, cosines);
    let Orthogonal { basis, meaning } = orthogonal(&seen, &own, 0);
    let choice = |count: usize| Choice {
        strength: radius(count, 0.0),
        filter: (0..=cosines).map(|k| f64::from(u8::from(k <= count))).collect(),
        correction: Vec::new(),
    };
    let choices = match fixed {
        Some(count) => vec![choice(count)],
        None => (0..=cosines).rev().map(choice).collect(),
    };
    Filtered { analysis: basis, synthesis: meaning.transposed(), choices, complete: false, short: 0 }
}

/// Columns of the constant and the cosines, as seen and as they are: `[radius][k]`.
pub(super) fn cosines_seen(n: usize, phase: f64, cosines: usize) -> (Matrix, Matrix) {
    let edge = radius(n, phase);
    // Twice the nodes that the fastest cosine has half periods, and some for the root: exact to rounding.
    let rule = gauss_legendre_unit(2 * cosines + 24);
    let mut seen = Matrix::zeros(n, cosines + 1);
    let mut own = Matrix::zeros(n, cosines + 1);
    let values = |r: f64, out: &mut [f64], weight: f64| {
        let c = libm::cos(PI * r / edge);
        let (mut before, mut now) = (1.0, c);
        out[0] += weight;
        for (k, out) in out.iter_mut().enumerate().skip(1) {
            *out += weight * (1.0 - if k % 2 == 0 { now } else { -now });
            (before, now) = (now, 2.0 * c * now - before);
        }
    };
    for i in 0..n {
        let y = radius(i, phase);
        let chord = (edge * edge - y * y).sqrt();
        for &(t, weight) in &rule {
            values(y.hypot(t * chord), seen.row_mut(i), 2.0 * chord * weight);
        }
        values(y, own.row_mut(i), 1.0);
    }
    (seen, own)
}

/// An orthonormal basis of what is seen, and what its members are.
pub(super) struct Orthogonal {
    pub(super) basis: Matrix,
    pub(super) meaning: Matrix,
}

/// Gram's and Schmidt's method, twice, on the rows from `from` on; members that hold nothing new become zero.
pub(super) fn orthogonal(seen: &Matrix, own: &Matrix, from: usize) -> Orthogonal {
    let (mut basis, mut meaning) = (seen.transposed(), own.transposed());
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for k in 0..basis.rows {
        let length = dot(&basis.row(k)[from..], &basis.row(k)[from..]).sqrt();
        for _ in 0..2 {
            for j in 0..k {
                let share = dot(&basis.row(j)[from..], &basis.row(k)[from..]);
                for matrix in [&mut basis, &mut meaning] {
                    let (before, now) = matrix.values.split_at_mut(k * matrix.columns);
                    let before = &before[j * matrix.columns..(j + 1) * matrix.columns];
                    now.iter_mut().zip(before).for_each(|(now, before)| *now -= share * before);
                }
            }
        }
        let left = dot(&basis.row(k)[from..], &basis.row(k)[from..]).sqrt();
        let scale = if left > INDEPENDENT_MIN * length { 1.0 / left } else { 0.0 };
        for matrix in [&mut basis, &mut meaning] {
            matrix.row_mut(k).iter_mut().for_each(|value| *value *= scale);
        }
    }
    Orthogonal { basis: basis.transposed(), meaning: meaning.transposed() }
}

#[cfg(test)]
mod tests {
    use super::super::operators::hats;
    use super::*;

    fn error(operator: &Matrix, column: &[f64], truth: &[f64]) -> f64 {
        let each = (0..operator.rows).map(|i| {
            let f: f64 = operator.row(i).iter().zip(column).map(|(a, b)| a * b).sum();
            (f - truth[i]).abs()
        });
        each.fold(0.0, f64::max)
    }

    /// Weak strengths leave a smooth profile as it is, and strong ones do not.
    #[test]
    fn gaussians_come_back_and_strength_flattens_them() {
        let n = 60;
        for phase in [0.0, 0.5] {
            let truth: Vec<f64> = (0..n).map(|i| (-(radius(i, phase) / 14.0).powi(2)).exp()).collect();
            let column: Vec<f64> = truth.iter().map(|f| 14.0 * PI.sqrt() * f).collect();
            for (name, filtered, bound) in [
                ("daun", daun(n, phase, Elements::Linear, None).unwrap(), 2.7e-3),
                ("basex", basex(n, phase, None).unwrap(), 3e-3),
                ("fourier", fourier(n, phase, None), 1e-5),
            ] {
                let weak = error(&filtered.operator(0), &column, &truth);
                assert!(weak < bound, "{name} {phase}: {weak}");
                let last = filtered.choices.len() - 1;
                assert!(error(&filtered.operator(last), &column, &truth) > 0.1, "{name}");
                let freedoms: Vec<f64> = filtered.choices.iter().map(Choice::freedom).collect();
                assert!(freedoms.windows(2).all(|pair| pair[0] >= pair[1]));
            }
        }
    }

    /// The operator of a strength solves its normal equations.
    #[test]
    fn daun_minimises_what_it_says() {
        let (n, strength) = (25, 3.0);
        let a = hats(n, 0.0);
        let operator = daun(n, 0.0, Elements::Linear, Some(strength)).unwrap().operator(0);
        let left = a.transposed().times(&a);
        let rough = roughness(n);
        let left = Matrix::from_fn(n, n, |i, j| left.at(i, j) + strength * rough.at(i, j));
        let got = left.times(&operator);
        for (got, want) in got.values.iter().zip(&a.transposed().values) {
            assert!((got - want).abs() < 1e-9, "{got} {want}");
        }
    }
}
