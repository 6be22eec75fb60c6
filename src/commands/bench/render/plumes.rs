//! The standard scenes of the ray tracer's figures: a cube of cells with eight plumes, a pinhole camera, a plate.

use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::plate::PlateShape;
use rayon::prelude::*;
use std::fmt::Write as _;
use std::path::Path;

/// What may be changed of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plumes {
    /// Cells along an edge of the cube [−1, 1]³ m.
    pub(super) cells: usize,
    /// Largest optical depth of a sight.
    pub(super) depth: f64,
    /// Scattering over extinction in the first group.
    pub(super) albedo: f64,
    /// Spectral groups: extinction, albedo and asymmetry change from one to the next.
    pub(super) groups: usize,
    pub(super) form: Form,
}

/// How plumes look; lengths in m, z pointing up from the nozzle at (0, 0, 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Form {
    /// Standard deviation of a plume's extinction at the nozzle, and its growth with the distance.
    width: [f64; 2],
    /// Distance of its axis from the middle over that from the nozzle.
    cone: f64,
    /// Extinction along its axis goes with this power of its width.
    power: i32,
    /// Extinction below which cells are empty, over that of one plume at the nozzle.
    faint: f64,
}

/// Dense at the nozzle, thin further on: nearly half of all cells hold something, most of them very little.
const SLENDER: Form = Form { width: [0.03, 0.05], cone: 0.36, power: -2, faint: 1e-6 };

/// As dense all along as widening leaves it: a third of the image is spray, with a mean transmittance of 0.89 and 40 times
/// the mean extinction in the densest cell.
const FULL: Form = Form { width: [0.06, 0.06], cone: 0.32, power: -1, faint: 7.8e-3 };

pub(super) const STANDARD: Plumes = Plumes { cells: 128, depth: 5.0, albedo: 0.5, groups: 1, form: SLENDER };

pub(super) const STANDARD_FULL: Plumes = Plumes { form: FULL, ..STANDARD };

/// Asymmetry of the first group.
const ASYMMETRY: f64 = 0.8;

/// Scale of the extinction at which its optical depths are measured: all small, none lost in f32.
const PROBE: f64 = 1e-3;

pub(super) fn camera() -> Camera {
    Camera {
        projection: Projection::Pinhole { horizontal_fov_deg: 30.0 },
        position_m: [0.0, -6.0, 0.0],
        look_at_m: [0.0, 0.0, 0.0],
        up: [0.0, 0.0, 1.0],
        columns: 640,
        rows: 512,
        pixel_filter: PixelFilter::Box,
        lens: None,
    }
}

pub(super) fn plate() -> PlateShape {
    PlateShape::Rectangle { centre_m: [0.0, 3.0, 0.0], facing: [0.0, -1.0, 0.0], width_m: 6.0, height_m: 5.0 }
}

impl Plumes {
    /// Gaussian plumes from one nozzle at the top, for which the largest optical depth of a sight is as asked.
    pub(super) fn medium(self) -> Result<GridMedium, TracerError> {
        let mut probe = self.empty();
        (probe.index, probe.k_ext) = self.extinction();
        let occupied = probe.k_ext.len();
        (probe.groups, probe.phase) = (1, vec![PhaseFunction::Isotropic]);
        (probe.k_sca, probe.emission) = (vec![0.0; occupied], vec![0.0; occupied]);
        let options = RenderOptions { scatter: false, target_error: 1e-2, ..RenderOptions::default() };
        let image = render_image(&probe, &camera(), Some(&plate()), &options, &|_| {})?;
        let least = image.a_plate.iter().fold(1.0_f32, |a, &b| a.min(b));
        let scale = self.depth / -f64::from(least).ln();
        Ok(self.filled(probe, scale))
    }

    #[expect(clippy::cast_precision_loss, reason = "groups are few")]
    fn empty(self) -> GridMedium {
        let asymmetry = |g: usize| ASYMMETRY + 0.1 * g as f64 / self.groups as f64;
        GridMedium {
            lower_m: [-1.0; 3],
            upper_m: [1.0; 3],
            cells: [self.cells; 3],
            groups: self.groups,
            channels: 1,
            index: Vec::new(),
            k_ext: Vec::new(),
            k_sca: Vec::new(),
            emission: Vec::new(),
            phase: (0..self.groups)
                .map(|g| PhaseFunction::HenyeyGreenstein { asymmetry: asymmetry(g) })
                .collect(),
        }
    }

    /// Which cells are occupied, and their extinction at the scale of the probe.
    #[expect(clippy::cast_precision_loss, reason = "cells are few")]
    fn extinction(self) -> (Vec<u32>, Vec<f64>) {
        let n = self.cells;
        let place = |i: usize| -1.0 + 2.0 * (i as f64 + 0.5) / n as f64;
        let lines: Vec<Vec<f64>> = (0..n * n)
            .into_par_iter()
            .map(|i| self.form.column(place(i / n), place(i % n), (0..n).map(place)))
            .collect();
        let (mut index, mut k_ext) = (Vec::with_capacity(n * n * n), Vec::new());
        let mut ordinal = 0;
        for k in lines.into_iter().flatten() {
            if k < self.form.faint * self.form.nozzle() {
                index.push(EMPTY);
            } else {
                index.push(ordinal);
                ordinal += 1;
                k_ext.push(PROBE * k);
            }
        }
        (index, k_ext)
    }

    /// The scene at its own scale, with all groups.
    #[expect(clippy::cast_precision_loss, reason = "groups are few")]
    fn filled(self, probe: GridMedium, scale: f64) -> GridMedium {
        let shares: Vec<[f64; 2]> = (0..self.groups)
            .map(|g| {
                let albedo = (self.albedo + 0.3 * ((7 * g) % 16) as f64 / 16.0).min(1.0);
                [scale * (1.0 - 0.4 * g as f64 / self.groups as f64), albedo]
            })
            .collect();
        let each = |value: &(dyn Fn(f64, f64) -> f64 + Sync)| -> Vec<f64> {
            let all = probe.k_ext.par_iter().with_min_len(4096);
            all.flat_map_iter(|&k| shares.iter().map(move |[scale, albedo]| value(k * scale, *albedo)))
                .collect()
        };
        let [k_ext, k_sca, emission] =
            [each(&|k, _| k), each(&|k, albedo| k * albedo), each(&|k, albedo| k - k * albedo)];
        GridMedium { index: probe.index, k_ext, k_sca, emission, ..self.empty() }
    }
}

/// Exponent beyond which a plume adds nothing: e^−36 of the nozzle's extinction is 2e-10 of the faintest cell's.
const EXPONENT_MAX: f64 = 36.0;

impl Form {
    /// Extinction of one plume at the nozzle, in arbitrary units.
    fn nozzle(self) -> f64 {
        self.width[0].powi(self.power)
    }

    /// Directions of the plumes, from the axis.
    fn holes(self) -> [[f64; 2]; 8] {
        std::array::from_fn(|hole| {
            #[expect(clippy::cast_precision_loss, reason = "eight holes")]
            let angle = std::f64::consts::TAU * (hole as f64 + 0.3) / 8.0;
            [self.cone * libm::cos(angle), self.cone * libm::sin(angle)]
        })
    }

    /// Plumes that widen with the distance from (0, 0, 1), in arbitrary units, for all heights of a column of cells.
    fn column(self, x: f64, y: f64, heights: impl Iterator<Item = f64>) -> Vec<f64> {
        let holes = self.holes();
        let one = |z: f64| {
            let depth = 1.0 - z;
            let width = self.width[0] + self.width[1] * depth;
            let sum: f64 = holes
                .iter()
                .map(|[cos, sin]| {
                    ((x - cos * depth).powi(2) + (y - sin * depth).powi(2)) / (2.0 * width * width)
                })
                .filter(|exponent| *exponent < EXPONENT_MAX)
                .map(|exponent| libm::exp(-exponent))
                .sum();
            if sum > 0.0 {
                sum * libm::exp(-libm::pow(depth / 1.7, 8.0)) * width.powi(self.power)
            } else {
                0.0
            }
        };
        heights.map(one).collect()
    }
}

/// The scenes for other programs, the full plumes in a folder of their own.
pub(super) fn write(folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    write_one(STANDARD, folder)?;
    write_one(STANDARD_FULL, &folder.join("full"))
}

/// A scene: extinction of every cell in f32, and the scene file.
fn write_one(scene: Plumes, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder)?;
    let medium = scene.medium()?;
    let (n, albedo) = (scene.cells, scene.albedo);
    let cells: Vec<f32> = medium
        .index
        .iter()
        .map(|&i| {
            #[expect(clippy::cast_possible_truncation, reason = "f32 is what others read")]
            let k = medium.k_ext.get(i as usize).map_or(0.0, |&k| k as f32);
            k
        })
        .collect();
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({n}, {n}, {n}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(header.len())?.to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(cells.iter().flat_map(|k| k.to_le_bytes()));
    std::fs::write(folder.join("sigma.npy"), bytes)?;
    let mut text = String::new();
    let _ = write!(
        text,
        "[camera]\nkind = \"pinhole\"\nposition_m = [0, -6, 0]\nlook_at_m = [0, 0, 0]\nup = [0, 0, 1]\n\
         columns = 640\nrows = 512\nhorizontal_fov_deg = 30\n\n\
         [plate]\nshape = \"rectangle\"\ncentre_m = [0, 3, 0]\nfacing = [0, -1, 0]\nwidth_m = 6\nheight_m = 5\n\
         temperature_k = 400\n\n[walls]\ntemperature_k = 300\n\n[band]\nwavelength_um = 3.4\n\n\
         [medium]\nkind = \"grid\"\nextinction_npy = \"sigma.npy\"\nlower_m = [-1, -1, -1]\nupper_m = [1, 1, 1]\n\
         albedo = {albedo}\ntemperature_k = 450\nphase = {{ kind = \"henyey-greenstein\", asymmetry = {ASYMMETRY} }}\n"
    );
    std::fs::write(folder.join("scene.toml"), text)?;
    Ok(())
}
