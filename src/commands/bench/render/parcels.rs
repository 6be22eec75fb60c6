//! CFD sprays: what packing, spreading, optics and rendering cost with the number of parcels and with the grid, and what
//! is left of the parcels' noise.

use super::super::{Figure, Watch};
use super::curves::{Findings, Page, beside, log_log, marked};
use super::image::several;
use crate::commands::CommandError;
use crate::report::plot::Point;
use ditd_sim::light::band::Band;
use ditd_sim::light::fuel::Fuel;
use ditd_sim::scene::compact;
use ditd_sim::scene::deposit::{self, DepositOptions, DepositReport};
use ditd_sim::scene::field::{CfdSpray, GasCell, Parcel};
use ditd_sim::scene::optics::{OpticsOptions, Source, optics};
use ditd_sim::tracer::camera::{Camera, PixelFilter, Projection};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::PlateShape;
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::path::Path;

/// Parcels that stand for the same spray.
const NUMBERS: [u32; 5] = [1000, 10_000, 100_000, 1_000_000, 10_000_000];

/// Edges of grid cells for the shipped spray, m: the first is what the others are measured by.
const EDGES_M: [f64; 5] = [0.25e-3, 0.35e-3, 0.5e-3, 1e-3, 2e-3];

/// Target of the images with scattering; of those that only compare sprays, well below what is compared.
const TARGET: f64 = 4e-3;
const TARGET_STRAIGHT: f64 = 1e-3;

/// Wavelength of the optics, µm.
const WAVELENGTH_UM: f64 = 3.4;

/// Pixels count where one of two images has lost so much of the plate (optical depth 0.3).
const THROUGH_MAX: f32 = 0.74;

/// Mass of the liquid of the synthetic spray, kg, and its density, kg/m³: those of the shipped one.
const LIQUID_KG: f64 = 2.5e-6;
const DENSITY_KG_M3: f64 = 610.0;

/// Median diameter in m and width in ln d of its droplets.
const DIAMETER_M: f64 = 9e-6;
const SIGMA_LN: f64 = 0.45;

/// Half width and depth of its vessel in m, and the edge of the vessel's cells.
const VESSEL_M: [f64; 2] = [0.025, 0.05];
const EDGE_M: f64 = 1e-3;

/// The same spray by more and more parcels.
pub(super) fn parcels(watch: &Watch<'_>) -> Result<Findings, CommandError> {
    let fuel = Fuel::named("n-heptane").map_err(failed)?;
    let mut findings = Findings::default();
    let (mut times, mut noise): ([Vec<Point>; 4], Vec<Point>) = Default::default();
    let mut images = Vec::new();
    for number in NUMBERS {
        let spray = synthetic(number);
        let (packing, bytes) = several(watch, || Ok::<_, CommandError>(compact::pack(&spray)))?;
        let (unpacking, _) =
            several(watch, || compact::unpack(&bytes, Path::new("synthetic"))).map_err(failed)?;
        drop(bytes);
        let made = Made::new(watch, spray, &DepositOptions::default(), &fuel)?;
        let (rendering, image) = several(watch, || render(&made.medium, TARGET, true)).map_err(failed)?;
        images.push((number, render(&made.medium, TARGET_STRAIGHT, false).map_err(failed)?));
        let report = &made.report;
        let worst = 0.5 * report.split_half.into_iter().fold(0.0, f64::max);
        let kinds = if report.kinds > 0 { format!(", {} kinds", report.kinds) } else { String::new() };
        let kind = format!(
            "parcel noise of the transmission, declared; N_eff {:.0}, kernels {:.2} mm, {} cells of {:.2} mm with droplets{kinds}",
            report.n_eff,
            1e3 * report.kernel_m,
            report.droplet_cells,
            1e3 * report.cell_m[0]
        );
        let named = |what: &str, seconds: f64, error: f64, kind: &str| {
            told(format!("{number} parcels: {what}"), seconds, error, kind.to_owned(), number as usize)
        };
        let declared = super::curves::rms(image.error_plate.iter().map(|&e| f64::from(e)));
        findings.figures.extend([
            named("pack as .spray", packing, 6e-8, "rounding to single precision, relative"),
            named("unpack", unpacking, 0.0, "exact"),
            named("deposit", made.deposit_seconds, worst, &kind),
            named("optics at one wavelength", made.optics_seconds, made.mie_error, "Mie table, relative"),
            named("image, target 4e-3", rendering, declared, "rms as declared"),
        ]);
        let x = f64::from(number);
        for (list, seconds) in
            times.iter_mut().zip([unpacking, made.deposit_seconds, made.optics_seconds, rendering])
        {
            list.push(Point::new(x, seconds));
        }
        noise.push(Point::new(x, worst));
    }
    let mut truth = Vec::new();
    if let Some((_, best)) = images.last() {
        for (number, image) in &images[..images.len() - 1] {
            let error = difference(image, best);
            eprintln!("{number} parcels: transmission off by {error:.1e} rms from that of the most parcels");
            truth.push(Point::new(f64::from(*number), error));
        }
    }
    let [unpacking, depositing, optics, rendering] = times;
    let cost = log_log(
        "parcels",
        "time / s",
        vec![
            marked("unpack", unpacking),
            marked("deposit", depositing),
            marked("optics", optics),
            marked("image, target 4e-3", rendering),
        ],
    );
    let errors = log_log(
        "parcels",
        "rms error of the transmission",
        vec![marked("against 10⁷ parcels", truth), marked("declared noise", noise)],
    );
    findings.pages.push(Page {
        name: "render_parcels",
        sheet: beside("a spray of 2.5 mg in 1 mm cells, by the number of its parcels", [cost, errors]),
    });
    Ok(findings)
}

/// The shipped spray on finer and finer grids.
pub(super) fn import(watch: &Watch<'_>) -> Result<Findings, CommandError> {
    let fuel = Fuel::named("n-heptane").map_err(failed)?;
    let mut findings = Findings::default();
    let (reading, spray) = several(watch, compact::shipped).map_err(failed)?;
    let count = spray.cells.as_ref().map_or(0, Vec::len) + spray.parcels.as_ref().map_or(0, Vec::len);
    findings.figures.push(told("shipped spray: unpack".into(), reading, 0.0, "exact".into(), count));
    let (mut times, mut errors): ([Vec<Point>; 2], Vec<Point>) = Default::default();
    let mut best: Option<Operator> = None;
    for edge_m in EDGES_M {
        let options = DepositOptions { cell_m: Some(edge_m), ..DepositOptions::default() };
        let made = Made::new(watch, spray.clone(), &options, &fuel)?;
        let (rendering, image) =
            several(watch, || render(&made.medium, TARGET_STRAIGHT, false)).map_err(failed)?;
        let error = best.as_ref().map_or(0.0, |best| difference(&image, best));
        let kind = match best {
            Some(_) => "rms of the transmission against the finest grid",
            None => "the finest grid, by which the others are measured",
        };
        let name = format!("shipped spray: deposit in cells of {:.2} mm", 1e3 * edge_m);
        let cells = made.medium.occupied();
        findings.figures.push(told(name, made.deposit_seconds, error, kind.into(), cells));
        let name = format!("shipped spray: image without scattering, cells of {:.2} mm", 1e3 * edge_m);
        findings.figures.push(told(name, rendering, error, kind.into(), image.pixels.len()));
        times[0].push(Point::new(1e3 * edge_m, made.deposit_seconds));
        times[1].push(Point::new(1e3 * edge_m, rendering));
        errors.push(Point::new(1e3 * edge_m, error));
        best = best.or(Some(image));
    }
    let [depositing, rendering] = times;
    let label = "edge of a grid cell / mm";
    findings.pages.push(Page {
        name: "render_import",
        sheet: beside(
            "the shipped CFD spray, by the grid it is spread on",
            [
                log_log(
                    label,
                    "time / s",
                    vec![marked("deposit", depositing), marked("image, no scattering", rendering)],
                ),
                log_log(label, "rms difference of transmission from 0.25 mm", vec![marked("", errors)]),
            ],
        ),
    });
    Ok(findings)
}

/// A spray as a medium.
struct Made {
    report: DepositReport,
    deposit_seconds: f64,
    medium: GridMedium,
    mie_error: f64,
    optics_seconds: f64,
}

impl Made {
    fn new(
        watch: &Watch<'_>,
        spray: CfdSpray,
        options: &DepositOptions,
        fuel: &Fuel,
    ) -> Result<Self, CommandError> {
        let (deposit_seconds, (field, report)) =
            several(watch, || deposit::field(&spray, options)).map_err(failed)?;
        drop(spray);
        let band = Band::monochromatic(WAVELENGTH_UM);
        let wanted = OpticsOptions { target_error: TARGET };
        let (optics_seconds, made) =
            several(watch, || Ok::<_, CommandError>(optics(&field, fuel, &band, &[Source::UNIT], &wanted)))?;
        let mie_error = made.report.mie_error;
        Ok(Self { report, deposit_seconds, medium: made.medium, mie_error, optics_seconds })
    }
}

fn failed(error: impl std::fmt::Display) -> CommandError {
    CommandError::failure(format!("bench render: {error}"))
}

fn told(name: String, seconds: f64, error: f64, error_kind: String, n: usize) -> Figure {
    eprintln!("{name}: {seconds:.3} s, {error:.1e}, {error_kind}");
    Figure { name, seconds, error, error_kind, n, threads: rayon::current_num_threads(), seed: Some(1) }
}

fn render(
    medium: &GridMedium,
    target_error: f64,
    scatter: bool,
) -> Result<Operator, ditd_sim::tracer::error::TracerError> {
    let camera = Camera {
        projection: Projection::Pinhole { horizontal_fov_deg: 10.0 },
        position_m: [0.0, -0.35, -0.025],
        look_at_m: [0.0, 0.0, -0.025],
        up: [0.0, 0.0, 1.0],
        columns: 640,
        rows: 512,
        pixel_filter: PixelFilter::Box,
        lens: None,
    };
    let plate = PlateShape::Rectangle {
        centre_m: [0.0, 0.2, -0.025],
        facing: [0.0, -1.0, 0.0],
        width_m: 0.3,
        height_m: 0.3,
    };
    let options = RenderOptions { target_error, scatter, ..RenderOptions::default() };
    render_image(medium, &camera, Some(&plate), &options, &|_| {})
}

/// Rms difference of a_plate of two images over the pixels where one of them shows a spray.
fn difference(one: &Operator, other: &Operator) -> f64 {
    let [a, b] = [one, other].map(|image| {
        let mut plate = image.plate_seen.clone();
        for (&pixel, &a) in image.pixels.iter().zip(&image.a_plate) {
            plate[pixel as usize] = a;
        }
        plate
    });
    let shown = a.iter().zip(&b).filter(|(a, b)| a.min(**b) < THROUGH_MAX);
    super::curves::rms(shown.map(|(a, b)| f64::from(a - b)))
}

/// Random numbers of one parcel: SplitMix64 (Steele, Lea, Flood 2014), keyed by the parcel.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        #[expect(clippy::cast_precision_loss, reason = "53 bits")]
        let u = ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
        u
    }

    /// Two independent standard normal numbers (Box and Muller 1958).
    fn normal(&mut self) -> [f64; 2] {
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        let angle = TAU * self.uniform();
        [radius * libm::cos(angle), radius * libm::sin(angle)]
    }
}

/// Where the axis of a plume is at a depth below the tip, and the plume's standard deviation there; all in m.
fn plume(hole: f64, depth: f64) -> ([f64; 2], f64) {
    let angle = TAU * (hole + 0.3) / 8.0;
    ([0.36 * depth * libm::cos(angle), 0.36 * depth * libm::sin(angle)], 0.4e-3 + 0.05 * depth)
}

/// Eight plumes of droplets below (0, 0, 0), with vapour around them, in a vessel of cubes.
fn synthetic(number: u32) -> CfdSpray {
    // Every parcel stands for the same area; the mean of d³ over d² follows from the distribution weighted with d².
    let [side, deep] = VESSEL_M;
    let mut parcels: Vec<Parcel> = (0..number)
        .into_par_iter()
        .map(|i| {
            // Draws of different numbers of parcels are independent.
            let mut random =
                Random((u64::from(number) << 32 | u64::from(i)).wrapping_mul(0x2545_f491_4f6c_dd1d));
            let depth = 2e-3 + 0.036 * random.uniform().sqrt();
            let ([x, y], width) = plume((8.0 * random.uniform()).floor(), depth);
            let [dx, dy] = random.normal();
            let [size, warmth] = random.normal();
            let diameter_m = DIAMETER_M * libm::exp(SIGMA_LN * size);
            Parcel {
                position_m: [
                    (x + width * dx).clamp(-0.999 * side, 0.999 * side),
                    (y + width * dy).clamp(-0.999 * side, 0.999 * side),
                    -depth,
                ],
                diameter_m,
                temperature_k: 375.0 + 2.0 * warmth + 200.0 * (0.04 - depth),
                droplets: 1.0 / (diameter_m * diameter_m),
            }
        })
        .collect();
    let mass: f64 = DENSITY_KG_M3 * parcels.iter().map(Parcel::volume_m3).sum::<f64>();
    for parcel in &mut parcels {
        parcel.droplets *= LIQUID_KG / mass;
    }
    CfdSpray {
        time_s: 1e-3,
        parcels: Some(parcels),
        liquid_density_kg_m3: None,
        cells: Some(gas()),
        shaped_cells: 0,
        remainder: None,
        domain_m: Some([[-side, -side, -deep], [side, side, 0.0]]),
        fuel: "C7H16".into(),
        fuel_molar_mass_kg_mol: 0.100_2,
        carrier_molar_mass_kg_mol: 0.028,
        notes: Vec::new(),
    }
}

fn gas() -> Vec<GasCell> {
    let [side, deep] = VESSEL_M;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "50 cells")]
    let n = (deep / EDGE_M).round() as u32;
    (0..n * n * n)
        .map(|i| {
            let corner = [i / (n * n), i / n % n, i % n].map(|c| EDGE_M * f64::from(c));
            let lower_m = [corner[0] - side, corner[1] - side, corner[2] - deep];
            let [x, y, z] = lower_m.map(|c| c + 0.5 * EDGE_M);
            let near: f64 = (0..8)
                .map(|hole| {
                    let ([px, py], width) = plume(f64::from(hole), -z);
                    let square = (x - px).powi(2) + (y - py).powi(2);
                    libm::exp(-square / (4.0 * width * width))
                })
                .sum::<f64>()
                .min(1.0)
                * libm::exp(-libm::pow(-z / 0.042, 8.0));
            GasCell {
                lower_m,
                upper_m: lower_m.map(|c| c + EDGE_M),
                temperature_k: 523.0 - 90.0 * near,
                pressure_pa: 4e5,
                density_kg_m3: 3.0,
                fuel_mass_fraction: 0.12 * near,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn synthetic_sprays_are_the_same_spray_by_other_parcels() {
        let totals = [1000, 30_000].map(|n| synthetic(n).totals());
        for totals in &totals {
            assert!(totals.vapour_mass_kg.unwrap() > 1e-7, "{totals:?}");
            // Of lognormal droplets drawn by area: D32 = d exp(σ²/2); 1000 draws know it to 2 %.
            let sauter = 1e6 * DIAMETER_M * libm::exp(0.5 * SIGMA_LN * SIGMA_LN);
            assert!((totals.d32_um.unwrap() / sauter - 1.0).abs() < 0.08, "{totals:?}");
        }
        let [few, many] = totals.map(|t| t.geometric_area_m2.unwrap());
        assert!((few / many - 1.0).abs() < 0.08, "{few} {many}");
        let volume: f64 = synthetic(1000).parcels.unwrap().iter().map(Parcel::volume_m3).sum();
        assert!((volume * DENSITY_KG_M3 / LIQUID_KG - 1.0).abs() < 1e-12);
    }

    #[test]
    fn differences_count_where_a_spray_is() {
        let image = |a: f32| Operator {
            groups: 1,
            channels: 1,
            plate_seen: vec![1.0; 4],
            pixels: vec![1, 2],
            a_plate: vec![a, 0.9],
            ..Operator::default()
        };
        assert!((difference(&image(0.5), &image(0.6)) - 0.1).abs() < 1e-6);
        assert!(difference(&image(0.9), &image(0.8)).abs() < f64::MIN_POSITIVE);
    }
}
