//! A plane slab by doubling, as an oracle for tests: discrete streams, no randomness, nothing shared with the tracer.
//!
//! Azimuthally averaged radiances; the redistribution between streams is the Legendre sum over as many moments as the
//! streams resolve.

use super::PhaseFunction;
use super::truncation::moments;
use crate::light::quadrature::gauss_legendre_unit;

/// Streams per side.
const STREAMS: usize = 24;
/// Halvings of the slab: the first layer is a few 1e-6 deep along the most oblique stream, and single scattering
/// is right to the square of that.
const DOUBLINGS: i32 = 28;

type Matrix = Vec<[f64; STREAMS]>;

/// Reflection and diffuse transmission of a slab.
pub(super) struct Slab {
    cosine: Vec<f64>,
    weight: Vec<f64>,
    reflection: Matrix,
    transmission: Matrix,
    depth: f64,
}

impl Slab {
    pub(super) fn new(phase: &PhaseFunction, depth: f64, albedo: f64) -> Self {
        Self::from_moments(&moments(phase, 2 * STREAMS), depth, albedo)
    }

    pub(super) fn from_moments(chi: &[f64], depth: f64, albedo: f64) -> Self {
        let (cosine, weight): (Vec<f64>, Vec<f64>) = gauss_legendre_unit(STREAMS).into_iter().unzip();
        let thin = depth / 2.0_f64.powi(DOUBLINGS);
        let once = |sign: f64| -> Matrix {
            let row = |i: usize| {
                std::array::from_fn(|j| {
                    0.5 * albedo * redistribution(chi, cosine[i], sign * cosine[j]) * thin / cosine[i]
                        * weight[j]
                })
            };
            (0..STREAMS).map(row).collect()
        };
        let (mut reflection, mut transmission) = (once(-1.0), once(1.0));
        let mut layer = thin;
        for _ in 0..DOUBLINGS {
            let mut through = transmission.clone();
            for (i, row) in through.iter_mut().enumerate() {
                row[i] += (-layer / cosine[i]).exp();
            }
            // (1 − R R)⁻¹ T, then R' = R + T R (…) and T' = T (…).
            let between = solve(product(&reflection, &reflection), through.clone());
            let back = product(&product(&through, &reflection), &between);
            for (own, more) in reflection.iter_mut().zip(&back) {
                own.iter_mut().zip(more).for_each(|(own, more)| *own += more);
            }
            transmission = product(&through, &between);
            layer *= 2.0;
            for (i, row) in transmission.iter_mut().enumerate() {
                row[i] -= (-layer / cosine[i]).exp();
            }
        }
        Self { cosine, weight, reflection, transmission, depth }
    }

    pub(super) fn streams(&self) -> usize {
        STREAMS
    }

    /// The share of light from behind, from directions of at least this cosine, that is seen along each stream in
    /// front; with the weight of the stream.
    pub(super) fn plate(&self, lowest_cosine: f64) -> Vec<(f64, f64)> {
        (0..STREAMS)
            .map(|i| {
                let lit = |j: usize| self.cosine[j] >= lowest_cosine;
                let diffuse: f64 = (0..STREAMS).filter(|&j| lit(j)).map(|j| self.transmission[i][j]).sum();
                let direct = if lit(i) { (-self.depth / self.cosine[i]).exp() } else { 0.0 };
                (diffuse + direct, self.weight[i])
            })
            .collect()
    }

    /// Everything that goes in comes out or is absorbed: reflected and transmitted along each stream.
    pub(super) fn seen(&self) -> Vec<f64> {
        self.plate(0.0).iter().zip(&self.reflection).map(|(t, r)| t.0 + r.iter().sum::<f64>()).collect()
    }

    /// Diffuse transmission from one stream to another.
    pub(super) fn scattered_through(&self, from: usize, to: usize) -> f64 {
        self.transmission[to][from]
    }

    /// The part of it that is scattered once, in closed form, for moments and an albedo.
    pub(super) fn once_through(&self, chi: &[f64], albedo: f64, depth: f64, from: usize, to: usize) -> f64 {
        let (a, b) = (self.cosine[to], self.cosine[from]);
        let path = ((-depth / b).exp() - (-depth / a).exp()) * b / (b - a);
        0.5 * albedo * redistribution(chi, a, b) * path * self.weight[from]
    }
}

/// Σ (2l + 1) χ_l P_l(a) P_l(b).
fn redistribution(chi: &[f64], a: f64, b: f64) -> f64 {
    let (mut before, mut now) = ([0.0; 2], [1.0; 2]);
    let mut sum = 0.0;
    for (l, chi) in chi.iter().enumerate() {
        let l = l as f64;
        sum += (2.0 * l + 1.0) * chi * now[0] * now[1];
        for (k, mu) in [a, b].into_iter().enumerate() {
            (before[k], now[k]) = (now[k], ((2.0 * l + 1.0) * mu * now[k] - l * before[k]) / (l + 1.0));
        }
    }
    sum
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    a.iter()
        .map(|row| {
            let mut sum = [0.0; STREAMS];
            for (k, factor) in row.iter().enumerate() {
                sum.iter_mut().zip(&b[k]).for_each(|(sum, b)| *sum += factor * b);
            }
            sum
        })
        .collect()
}

/// (1 − a)⁻¹ b by elimination; a is a contraction, so no pivot is small.
fn solve(mut a: Matrix, mut b: Matrix) -> Matrix {
    for (i, row) in a.iter_mut().enumerate() {
        row.iter_mut().for_each(|v| *v = -*v);
        row[i] += 1.0;
    }
    for i in 0..STREAMS {
        let (pivot, source) = (a[i], b[i]);
        for k in (0..STREAMS).filter(|&k| k != i) {
            let factor = a[k][i] / pivot[i];
            a[k].iter_mut().zip(&pivot).for_each(|(v, p)| *v -= factor * p);
            b[k].iter_mut().zip(&source).for_each(|(v, p)| *v -= factor * p);
        }
    }
    for i in 0..STREAMS {
        let pivot = a[i][i];
        b[i].iter_mut().for_each(|v| *v /= pivot);
    }
    b
}

/// The oracle against one that is not ours: rows of `slab_scatter.csv` (matrix exponential, checked with
/// PythonicDISORT), and conservation.
#[test]
fn the_oracle_agrees_with_published_slabs() {
    let conservative = Slab::new(&PhaseFunction::HenyeyGreenstein { asymmetry: 0.5 }, 2.0, 1.0);
    for share in conservative.seen() {
        // The thin layers leave a few 1e-6 of what the most oblique stream sees.
        assert!((share - 1.0).abs() < 1e-5, "{share}");
    }
    let text = include_str!("../../../tests/data/rte/slab_scatter.csv");
    let mut rows = 0;
    for line in text.lines().skip(1) {
        let row: Vec<&str> = line.split(',').collect();
        let number = |i: usize| row[i].parse::<f64>().unwrap();
        let asymmetry = if row[1] == "hg0_5" { 0.5 } else { 0.9 };
        if !row[1].starts_with("hg") || number(4) > 0.0 || number(3) > 20.0 || rows > 12 {
            continue;
        }
        rows += 1;
        let slab = Slab::new(&PhaseFunction::HenyeyGreenstein { asymmetry }, number(3), number(2));
        let plate = slab.plate(0.0);
        // Linear between the streams around the row's cosine: their spacing squared.
        let mu = number(5);
        let i = slab.cosine.partition_point(|&c| c < mu).clamp(1, STREAMS - 1);
        let f = (mu - slab.cosine[i - 1]) / (slab.cosine[i] - slab.cosine[i - 1]);
        let found = plate[i - 1].0 * (1.0 - f) + plate[i].0 * f;
        assert!((found - number(6)).abs() < 6e-3, "{line}: {found}");
    }
    assert!(rows > 4, "{rows} rows");
}
