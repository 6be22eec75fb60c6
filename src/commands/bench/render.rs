//! The figures of the ray tracer: a cube of cells with eight plumes, seen by a pinhole camera against a plate.
//!
//! Errors are rms differences of `a_plate`, or of both coefficients, from pixels traced one by one, whose own errors are
//! taken out.

use super::{Figure, Watch};
use crate::commands::CommandError;
use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;
use ditd_sim::tracer::reference::render_reference;
use ditd_sim::tracer::relight::Lighting;
use std::fmt::Write as _;
use std::path::Path;

/// Pixels that are traced one by one, the error of each, and its paths at most: for the standard scene and for others.
const JUDGES: [Judge; 2] = [
    Judge { pixels: 3000, target: 5e-4, paths_max: 1 << 15 },
    Judge { pixels: 1000, target: 1e-3, paths_max: 1 << 14 },
];
const SEED: u64 = 1;

struct Judge {
    /// Pixels of the image; a third of them meets the medium.
    pixels: usize,
    target: f64,
    paths_max: u64,
}

/// The scene and what may be changed of it.
#[derive(Debug, Clone, Copy)]
struct Plumes {
    /// Cells along an edge of the cube [−1, 1]³ m.
    cells: usize,
    /// Largest optical depth of a sight.
    depth: f64,
    albedo: f64,
    /// Spectral groups: extinction, albedo and asymmetry change from one to the next.
    groups: usize,
}

const STANDARD: Plumes = Plumes { cells: 128, depth: 5.0, albedo: 0.5, groups: 1 };

/// Asymmetry of the first group.
const ASYMMETRY: f64 = 0.8;

/// Relative extinction below which cells are empty.
const FAINT: f64 = 1e-6;

/// Runs the figures; `export` is a folder for the scene, as `ditd render` and other programs read it.
pub(super) fn figures(watch: &Watch<'_>, export: Option<&Path>) -> Result<Vec<Figure>, CommandError> {
    if let Some(folder) = export {
        write(folder)
            .map_err(|e| CommandError::failure(format!("bench render: {}: {e}", folder.display())))?;
    }
    let mut figures = Vec::new();
    let mut add = |list: Result<Vec<Figure>, TracerError>| {
        let list = list.map_err(|e| CommandError::failure(format!("bench render: {e}")))?;
        figures.extend(list);
        Ok::<(), CommandError>(())
    };
    add(targets(watch))?;
    add(straight(watch))?;
    add(bands(watch))?;
    for depth in [1.0, 20.0, 80.0] {
        add(variant(watch, &format!("optical depth {depth}"), Plumes { depth, ..STANDARD }))?;
    }
    for albedo in [0.1, 0.9, 0.99] {
        add(variant(watch, &format!("albedo {albedo}"), Plumes { albedo, ..STANDARD }))?;
    }
    for cells in [32, 64, 256] {
        add(variant(watch, &format!("{cells}³ cells"), Plumes { cells, ..STANDARD }))?;
    }
    Ok(figures)
}

/// Time against error of the whole operator, and of what is done with it.
fn targets(watch: &Watch<'_>) -> Result<Vec<Figure>, TracerError> {
    let medium = STANDARD.medium()?;
    let judge = judge(&medium, &JUDGES[0])?;
    let mut figures = Vec::new();
    for target in [4e-2, 4e-3, 1e-3, 5e-4] {
        let (seconds, image) = timed(watch, &medium, target, true)?;
        figures.push(figure(&format!("operator, target {target:.0e}"), seconds, &image, Some(&judge)));
    }
    let (_, image) = timed(watch, &medium, 4e-3, true)?;
    figures.extend(relit(watch, image)?);
    Ok(figures)
}

/// Emission and absorption alone.
fn straight(watch: &Watch<'_>) -> Result<Vec<Figure>, TracerError> {
    let medium = Plumes { albedo: 0.0, ..STANDARD }.medium()?;
    let judge = judge(&medium, &JUDGES[1])?;
    let mut figures = Vec::new();
    for target in [4e-3, 1e-3] {
        let (seconds, image) = timed(watch, &medium, target, false)?;
        figures.push(figure(&format!("no scattering, target {target:.0e}"), seconds, &image, Some(&judge)));
    }
    Ok(figures)
}

/// The sample set of a band against one wavelength.
fn bands(watch: &Watch<'_>) -> Result<Vec<Figure>, TracerError> {
    let mut figures = Vec::new();
    for groups in [4, 15] {
        let medium = Plumes { groups, ..STANDARD }.medium()?;
        let (seconds, image) = timed(watch, &medium, 1e-3, true)?;
        figures.push(figure(&format!("{groups} wavelengths, target 1e-3"), seconds, &image, None));
        figures.extend(relit(watch, image)?);
    }
    Ok(figures)
}

fn variant(watch: &Watch<'_>, name: &str, plumes: Plumes) -> Result<Vec<Figure>, TracerError> {
    let medium = plumes.medium()?;
    let judge = judge(&medium, &JUDGES[1])?;
    let (seconds, image) = timed(watch, &medium, 1e-3, true)?;
    Ok(vec![figure(&format!("{name}, target 1e-3"), seconds, &image, Some(&judge))])
}

/// A further frame from an operator.
fn relit(watch: &Watch<'_>, image: Operator) -> Result<Vec<Figure>, TracerError> {
    let groups = image.groups;
    let mut out = vec![0.0; image.plate_seen.len()];
    let mut failed = None;
    let mut kelvin = 1.0;
    let seconds = watch.fastest(|| {
        kelvin += 1e-3;
        let light = Lighting {
            ends: Vec::new(),
            plate: vec![3.0 * kelvin; groups],
            walls: vec![kelvin; groups],
            channel: 0,
            medium: vec![2.0; groups],
        };
        failed = failed.take().or(image.relight(&light, &mut out).err());
    });
    match failed {
        Some(e) => Err(e),
        None => Ok(vec![Figure {
            name: format!("further frame, {groups} wavelengths"),
            seconds,
            error: 6e-8,
            error_kind: "rounding to f32, relative".into(),
            n: out.len(),
            threads: rayon::current_num_threads(),
            seed: None,
        }]),
    }
}

fn timed(
    watch: &Watch<'_>,
    medium: &GridMedium,
    target_error: f64,
    scatter: bool,
) -> Result<(f64, Operator), TracerError> {
    let options = RenderOptions { target_error, scatter, seed: SEED, ..RenderOptions::default() };
    let mut best = Err(TracerError::Geometry { what: "the bench", condition: "run at least once" });
    // Renders are long enough for the clock, and what comes between can only make them longer.
    let seconds = watch.best_of(3, || {
        best = render_image(medium, &camera(), Some(&plate()), &options, &|_| {});
    });
    best.map(|image| (seconds, image))
}

/// Some pixels traced one by one.
fn judge(medium: &GridMedium, judge: &Judge) -> Result<Operator, TracerError> {
    let camera = camera();
    let pixels = camera.rows * camera.columns;
    // A step that shares no factor with the columns walks over all of them.
    let chosen: Vec<u32> =
        (0..pixels).step_by((pixels / judge.pixels) | 1).filter_map(|p| u32::try_from(p).ok()).collect();
    let options = RenderOptions {
        target_error: judge.target,
        seed: 1234,
        paths_max: judge.paths_max,
        ..RenderOptions::default()
    };
    render_reference(medium, &camera, Some(&plate()), &options, Some(&chosen), &|_| {})
}

fn figure(name: &str, seconds: f64, image: &Operator, judge: Option<&Operator>) -> Figure {
    let declared = |errors: &[f32]| rms(errors.iter().map(|&e| f64::from(e)));
    let (error, error_kind) = match judge {
        Some(judge) => {
            let [plate, medium] = true_errors(image, judge);
            let worse = plate.max(medium);
            let [told_plate, told_medium] = [declared(&image.error_plate), declared(&image.error_medium)];
            let text = format!(
                "a_plate {plate:.1e}, a_medium {medium:.1e} rms of {} pixels; declared {told_plate:.1e}, {told_medium:.1e}",
                judge.pixels.len()
            );
            (worse, text)
        }
        None => {
            let worse = declared(&image.error_plate).max(declared(&image.error_medium));
            (worse, "rms as declared, all wavelengths".to_owned())
        }
    };
    eprintln!("{name}: {seconds:.3} s, {error_kind}");
    Figure {
        name: name.to_owned(),
        seconds,
        error,
        error_kind,
        n: image.pixels.len(),
        threads: rayon::current_num_threads(),
        seed: Some(SEED),
    }
}

/// Rms errors of a_plate and a_medium over the judged pixels, the judge's own taken out.
fn true_errors(image: &Operator, judge: &Operator) -> [f64; 2] {
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for (j, pixel) in judge.pixels.iter().enumerate() {
        let Ok(i) = image.pixels.binary_search(pixel) else { continue };
        for g in 0..image.groups {
            let plate = f64::from(image.a_plate[i * image.groups + g] - judge.a_plate[j * image.groups + g]);
            let at = |op: &Operator, k: usize| f64::from(op.emission[k * op.channels * op.groups + g]);
            sums[0] += plate * plate - f64::from(judge.error_plate[j]).powi(2);
            sums[1] += (at(image, i) - at(judge, j)).powi(2) - f64::from(judge.error_medium[j]).powi(2);
            count += 1.0;
        }
    }
    sums.map(|s: f64| (s.max(0.0) / f64::max(count, 1.0)).sqrt())
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        count += 1.0;
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

fn camera() -> Camera {
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

fn plate() -> PlateShape {
    PlateShape::Rectangle { centre_m: [0.0, 3.0, 0.0], facing: [0.0, -1.0, 0.0], width_m: 6.0, height_m: 5.0 }
}

impl Plumes {
    /// Gaussian plumes from one nozzle at the top, for which the largest optical depth of a sight is as asked.
    fn medium(self) -> Result<GridMedium, TracerError> {
        let probe = Plumes { groups: 1, albedo: 0.0, ..self }.scaled(1e-3);
        let options = RenderOptions { scatter: false, target_error: 1e-2, ..RenderOptions::default() };
        let image = render_image(&probe, &camera(), Some(&plate()), &options, &|_| {})?;
        let least = image.a_plate.iter().fold(1.0_f32, |a, &b| a.min(b));
        Ok(self.scaled(1e-3 * self.depth / -f64::from(least).ln()))
    }

    #[expect(clippy::cast_precision_loss, reason = "cells and groups are few")]
    fn scaled(self, scale: f64) -> GridMedium {
        let n = self.cells;
        let mut medium = GridMedium {
            lower_m: [-1.0; 3],
            upper_m: [1.0; 3],
            cells: [n; 3],
            groups: self.groups,
            channels: 1,
            index: vec![EMPTY; n * n * n],
            k_ext: Vec::new(),
            k_sca: Vec::new(),
            emission: Vec::new(),
            phase: (0..self.groups)
                .map(|g| PhaseFunction::HenyeyGreenstein {
                    asymmetry: ASYMMETRY + 0.1 * g as f64 / self.groups as f64,
                })
                .collect(),
        };
        let mut ordinal = 0;
        let place = |i: usize| -1.0 + 2.0 * (i as f64 + 0.5) / n as f64;
        for x in 0..n {
            for y in 0..n {
                for z in 0..n {
                    let k = plumes([place(x), place(y), place(z)]);
                    if k < FAINT * NOZZLE {
                        continue;
                    }
                    medium.index[(x * n + y) * n + z] = ordinal;
                    ordinal += 1;
                    for g in 0..self.groups {
                        let part = g as f64 / self.groups as f64;
                        let k = k * scale * (1.0 - 0.4 * part);
                        let albedo = (self.albedo + 0.3 * ((7 * g) % 16) as f64 / 16.0).min(1.0);
                        medium.k_ext.push(k);
                        medium.k_sca.push(k * albedo);
                        medium.emission.push(k - k * albedo);
                    }
                }
            }
        }
        medium
    }
}

/// Extinction of one plume at the nozzle.
const NOZZLE: f64 = 1.0 / (0.03 * 0.03);

/// Eight plumes that widen with the distance from (0, 0, 1), in arbitrary units.
fn plumes(p: [f64; 3]) -> f64 {
    let depth = 1.0 - p[2];
    let width = 0.03 + 0.05 * depth;
    let end = libm::exp(-libm::pow(depth / 1.7, 8.0));
    (0..8)
        .map(|hole| {
            let angle = std::f64::consts::TAU * (f64::from(hole) + 0.3) / 8.0;
            let (dx, dy) = (p[0] - 0.36 * depth * libm::cos(angle), p[1] - 0.36 * depth * libm::sin(angle));
            libm::exp(-(dx * dx + dy * dy) / (2.0 * width * width)) * end / (width * width)
        })
        .sum()
}

/// The scene for other programs: extinction of every cell in f32, and the scene file.
fn write(folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder)?;
    let medium = STANDARD.medium()?;
    let n = STANDARD.cells;
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
    let mut scene = String::new();
    let _ = write!(
        scene,
        "[camera]\nkind = \"pinhole\"\nposition_m = [0, -6, 0]\nlook_at_m = [0, 0, 0]\nup = [0, 0, 1]\n\
         columns = 640\nrows = 512\nhorizontal_fov_deg = 30\n\n\
         [plate]\nshape = \"rectangle\"\ncentre_m = [0, 3, 0]\nfacing = [0, -1, 0]\nwidth_m = 6\nheight_m = 5\n\
         temperature_k = 400\n\n[walls]\ntemperature_k = 300\n\n[band]\nwavelength_um = 3.4\n\n\
         [medium]\nkind = \"grid\"\nextinction_npy = \"sigma.npy\"\nlower_m = [-1, -1, -1]\nupper_m = [1, 1, 1]\n\
         albedo = {}\ntemperature_k = 450\nphase = {{ kind = \"henyey-greenstein\", asymmetry = {ASYMMETRY} }}\n",
        STANDARD.albedo
    );
    std::fs::write(folder.join("scene.toml"), scene)?;
    Ok(())
}
