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
    /// Noise of plate and channel 0: Σ weight · noise of the cache.
    pub(super) noise: [[Lane; N]; 2],
    /// Error of the reconstruction of plate and channel 0: Σ weight · bias of the cache.
    pub(super) bias: [[Lane; N]; 2],
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
            noise: [[Lane::ZERO; N]; 2],
            bias: [[Lane::ZERO; N]; 2],
            count: 0,
        }
    }

    /// Back to nothing.
    pub(super) fn clear(&mut self) {
        self.plate = [Lane::ZERO; N];
        self.emission.iter_mut().chain(&mut self.direct).for_each(|row| *row = [Lane::ZERO; N]);
        self.noise = [[Lane::ZERO; N]; 2];
        self.bias = [[Lane::ZERO; N]; 2];
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
                if scattered.slope.is_empty() {
                    for n in 0..N {
                        self.plate[n].add_product(weight[n], rows[0][n]);
                    }
                } else {
                    let middle = super::vector::along(origin, 0.5 * (t0 + t1), direction);
                    let [x, y, z] = medium.lattice.offset(middle);
                    let slopes = &scattered.slope[3 * o * scattered.rows..3 * (o + 1) * scattered.rows];
                    let (along_x, rest) = slopes.split_at(scattered.rows);
                    let (along_y, along_z) = rest.split_at(scattered.rows);
                    for (r, row) in rows.iter().enumerate() {
                        let to = if r == 0 { &mut self.plate } else { &mut self.emission[r - 1] };
                        for n in 0..N {
                            let here = row[n]
                                + along_x[r][n].map(|v| v * x)
                                + along_y[r][n].map(|v| v * y)
                                + along_z[r][n].map(|v| v * z);
                            // A steep slope must not make light negative.
                            to[n].add_product(weight[n], here.map(|v| v.max(0.0)));
                        }
                    }
                }
                for n in 0..N {
                    let share = weight[n] * medium.albedo[o][n];
                    self.noise[0][n].add_product(share, scattered.noise[o][0][n]);
                    self.noise[1][n].add_product(share, scattered.noise[o][1][n]);
                    self.bias[0][n].add_product(share, scattered.bias[o][0][n]);
                    self.bias[1][n].add_product(share, scattered.bias[o][1][n]);
                }
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

impl<const N: usize> Sight<N> {
    /// Rms noise over the groups, of plate and channel 0.
    pub(super) fn noise_rms(&self, groups: usize) -> [f32; 2] {
        self.rms(&self.noise, groups)
    }

    /// Rms over the groups of noise and reconstruction together, of plate and channel 0.
    pub(super) fn error_rms(&self, groups: usize) -> [f32; 2] {
        let (noise, bias) = (self.rms(&self.noise, groups), self.rms(&self.bias, groups));
        [noise[0].hypot(bias[0]), noise[1].hypot(bias[1])]
    }

    fn rms(&self, rows: &[[Lane; N]; 2], groups: usize) -> [f32; 2] {
        let scale = 1.0 / super::packed::narrow(self.count.max(1) as f64);
        rows.map(|row| {
            let square: f32 = row.iter().map(|lane| lane.map(|v| v * v).sum()).sum();
            (square / super::packed::narrow(groups as f64)).sqrt() * scale
        })
    }
}
