//! Along the sights of a camera: exact emission and transmission per cell, plus the cached in-scattered light.

#![expect(clippy::needless_range_loop, reason = "loops over lanes step through several arrays at once")]

use super::lanes::{Lane, exp_minus};
use super::packed::Packed;
use super::plate::Plate;
use super::reconstruct::Scattered;
use super::vector::Vector;

/// What one sight collects, groups in lanes.
pub(super) struct Sight<const N: usize> {
    /// Share of the plate, in-scattering included.
    pub(super) plate: [Lane; N],
    /// Emission with in-scattering, per channel.
    pub(super) emission: Vec<[Lane; N]>,
    /// Emission along the straight sight, per channel.
    pub(super) direct: Vec<[Lane; N]>,
    /// Noise of plate and channel 0: mean over groups of Σ weight · noise of the cache.
    pub(super) noise: [f32; 2],
    /// Sights added.
    pub(super) count: usize,
}

impl<const N: usize> Sight<N> {
    /// Nothing collected yet.
    pub(super) fn new(channels: usize) -> Self {
        Self {
            plate: [Lane::ZERO; N],
            emission: vec![[Lane::ZERO; N]; channels],
            direct: vec![[Lane::ZERO; N]; channels],
            noise: [0.0; 2],
            count: 0,
        }
    }

    /// Back to nothing.
    pub(super) fn clear(&mut self) {
        self.plate = [Lane::ZERO; N];
        self.emission.iter_mut().chain(&mut self.direct).for_each(|row| *row = [Lane::ZERO; N]);
        self.noise = [0.0; 2];
        self.count = 0;
    }

    /// Adds the sight from `origin` along `direction`. `scattered` holds, per cell, albedo · J.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        medium: &Packed<N>,
        scattered: Option<&Scattered<N>>,
        plate: Option<&Plate>,
        ray: (Vector, Vector),
    ) {
        let (origin, direction) = ray;
        let hit = plate.and_then(|p| p.hit(origin, direction));
        let mut through = [Lane::ONE; N];
        medium.lattice.walk(origin, direction, hit.unwrap_or(f64::INFINITY), |ordinal, t0, t1| {
            let o = ordinal as usize;
            let length = super::packed::narrow(t1 - t0);
            let mut weight = [Lane::ZERO; N];
            let mut most = Lane::ZERO;
            for n in 0..N {
                let e = exp_minus(medium.k[o][n].map(|k| k * length));
                weight[n] = through[n] * e.map(|e| 1.0 - e);
                through[n] = through[n] * e;
                most = most.zip(through[n], f32::max);
            }
            let sources = &medium.source[o * medium.channels..(o + 1) * medium.channels];
            for (row, source) in self.direct.iter_mut().zip(sources) {
                for n in 0..N {
                    row[n].add_product(weight[n], source[n]);
                }
            }
            if let Some(scattered) = scattered {
                let rows = &scattered.value[o * scattered.rows..(o + 1) * scattered.rows];
                for n in 0..N {
                    self.plate[n].add_product(weight[n], rows[0][n]);
                }
                for (row, source) in self.emission.iter_mut().zip(&rows[1..]) {
                    for n in 0..N {
                        row[n].add_product(weight[n], source[n]);
                    }
                }
                let mut share = Lane::ZERO;
                for n in 0..N {
                    share.add_product(weight[n], medium.albedo[o][n]);
                }
                let share = share.sum();
                self.noise[0] += share * scattered.noise[o][0];
                self.noise[1] += share * scattered.noise[o][1];
            }
            // Smallest normal number of f32: beyond it nothing can be seen.
            most.0.iter().fold(0.0_f32, |a, &b| a.max(b)) > 1e-30
        });
        if hit.is_some() {
            for n in 0..N {
                self.plate[n] = self.plate[n] + through[n];
            }
        }
        self.count += 1;
    }
}

/// Noise of one sight from group means alone: what the sampling loop needs to decide when to stop.
pub(super) fn noise_along<const N: usize>(
    medium: &Packed<N>,
    noise: &[[f32; 2]],
    plate: Option<&Plate>,
    ray: (Vector, Vector),
) -> [f64; 2] {
    let (origin, direction) = ray;
    let far = plate.and_then(|p| p.hit(origin, direction)).unwrap_or(f64::INFINITY);
    let mut through = 1.0_f64;
    let mut sum = [0.0; 2];
    medium.lattice.walk(origin, direction, far, |ordinal, t0, t1| {
        let o = ordinal as usize;
        let [k, scattering] = medium.mean_k[o].map(f64::from);
        let e = (-k * (t1 - t0)).exp();
        let share = if k > 0.0 { through * (1.0 - e) * scattering / k } else { 0.0 };
        sum[0] += share * f64::from(noise[o][0]);
        sum[1] += share * f64::from(noise[o][1]);
        through *= e;
        through > 1e-9
    });
    sum
}
