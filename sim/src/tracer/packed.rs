//! The medium in the form that image rendering reads: f32 lanes over groups, on the cells or on blocks of cells.

use super::lanes::Lane;
use super::lattice::Lattice;
use super::medium::{EMPTY, GridMedium};

/// Extinction beyond which a cell of any size is opaque in f32; keeps products finite.
const K_MAX: f64 = 1e30;

/// Coefficients per occupied cell, groups in lanes; unused lanes are empty space.
pub(super) struct Packed<const N: usize> {
    pub(super) lattice: Lattice,
    pub(super) channels: usize,
    /// Extinction in 1/m, `[ordinal]`.
    pub(super) k: Vec<[Lane; N]>,
    /// Scattering over extinction, `[ordinal]`.
    pub(super) albedo: Vec<[Lane; N]>,
    /// Emission coefficient over extinction, `[ordinal · channels + channel]`.
    pub(super) source: Vec<[Lane; N]>,
    /// Extinction, albedo and source of channel 0 side by side: all that a path needs in most cells, `[ordinal]`.
    pub(super) core: Vec<[[Lane; N]; 3]>,
    /// Extinction and scattering, mean over groups, `[ordinal]`.
    pub(super) mean_k: Vec<[f32; 2]>,
}

impl<const N: usize> Packed<N> {
    /// Blocks of `factor`³ cells with the mean coefficients of their volume; factor 1 is the medium itself.
    pub(super) fn new(medium: &GridMedium, factor: usize) -> Self {
        let (groups, channels) = (medium.groups, medium.channels);
        let blocks = medium.cells.map(|n| n.div_ceil(factor));
        let mut index = vec![EMPTY; blocks[0] * blocks[1] * blocks[2]];
        let mut sums: Vec<f64> = Vec::new();
        let width = groups * (2 + channels);
        for x in 0..medium.cells[0] {
            for y in 0..medium.cells[1] {
                for z in 0..medium.cells[2] {
                    let ordinal = medium.index[(x * medium.cells[1] + y) * medium.cells[2] + z];
                    if ordinal == EMPTY {
                        continue;
                    }
                    let block = ((x / factor) * blocks[1] + y / factor) * blocks[2] + z / factor;
                    if index[block] == EMPTY {
                        index[block] = u32::try_from(sums.len() / width).unwrap_or(EMPTY);
                        sums.resize(sums.len() + width, 0.0);
                    }
                    let (o, start) = (ordinal as usize, index[block] as usize * width);
                    let sum = &mut sums[start..start + width];
                    let add =
                        |to: &mut [f64], from: &[f64]| to.iter_mut().zip(from).for_each(|(a, b)| *a += b);
                    add(&mut sum[..groups], &medium.k_ext[o * groups..(o + 1) * groups]);
                    add(&mut sum[groups..2 * groups], &medium.k_sca[o * groups..(o + 1) * groups]);
                    let emission = o * groups * channels..(o + 1) * groups * channels;
                    add(&mut sum[2 * groups..], &medium.emission[emission]);
                }
            }
        }
        let size = [0, 1, 2].map(|a| (medium.upper_m[a] - medium.lower_m[a]) / count(medium.cells[a]));
        let upper = [0, 1, 2].map(|a| {
            if factor == 1 {
                medium.upper_m[a]
            } else {
                medium.lower_m[a] + size[a] * count(blocks[a] * factor)
            }
        });
        let mut packed = Self {
            lattice: Lattice::new(medium.lower_m, upper, blocks, index),
            channels,
            k: Vec::new(),
            albedo: Vec::new(),
            source: Vec::new(),
            core: Vec::new(),
            mean_k: Vec::new(),
        };
        let share = 1.0 / count(factor * factor * factor);
        for sum in sums.chunks_exact(width) {
            let (k, sca) = (&sum[..groups], &sum[groups..2 * groups]);
            let over_k = |values: &[f64]| lanes::<N>(values, |g, v| if k[g] > 0.0 { v / k[g] } else { 0.0 });
            packed.k.push(lanes(k, |_, v| (v * share).min(K_MAX)));
            packed.albedo.push(over_k(sca));
            for c in 0..channels {
                packed.source.push(over_k(&sum[(2 + c) * groups..(3 + c) * groups]));
            }
            let last = packed.k.len() - 1;
            packed.core.push([packed.k[last], packed.albedo[last], packed.source[last * channels]]);
            let mean = |v: &[f64]| narrow((v.iter().sum::<f64>() * share / count(groups)).min(K_MAX));
            packed.mean_k.push([mean(k), mean(sca)]);
        }
        packed
    }
}

fn lanes<const N: usize>(values: &[f64], f: impl Fn(usize, f64) -> f64) -> [Lane; N] {
    let mut out = [Lane::ZERO; N];
    for (g, &v) in values.iter().enumerate() {
        out[g / 8].0[g % 8] = narrow(f(g, v));
    }
    out
}

#[expect(clippy::cast_precision_loss, reason = "counts of cells and groups are far below 2^53")]
fn count(n: usize) -> f64 {
    n as f64
}

/// The nearest f32.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is what is asked for")]
pub(super) fn narrow(value: f64) -> f32 {
    value as f32
}
