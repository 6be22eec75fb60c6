//! `ditd render`.

use super::{CommandError, CommandResult};
use ditd_sim::scene::file::{self, MediumSource, Scene};
use ditd_sim::tracer::camera::Camera;
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::shape::Body;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Default target of single rays: absolute standard error of each coefficient.
const RAY_TARGET: f64 = 1e-4;

/// Default target of images.
const IMAGE_TARGET: f64 = 1e-3;

/// Most paths per single ray.
const RAY_PATHS_MAX: u64 = 1 << 24;

/// Arguments of `ditd render`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene file
    scene: PathBuf,
    /// Write the coefficient images to this EXR file
    #[arg(long)]
    out: Option<PathBuf>,
    /// Compute single rays instead: a CSV file with origin_x_m … direction_z, printed back with the coefficients
    #[arg(long, value_name = "RAYS.csv", conflicts_with = "out")]
    rays: Option<PathBuf>,
    /// Absolute rms error wanted of each coefficient [default: 1e-3, with --rays 1e-4]
    #[arg(long)]
    target_error: Option<f64>,
    /// Trace every pixel on its own, unbiased and slow
    #[arg(long)]
    reference: bool,
    /// Add the coefficients of each spectral group
    #[arg(long)]
    groups: bool,
    /// Names the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for a scene or a table of rays that makes no sense, 1 where a file cannot be written.
pub fn run(args: Args) -> CommandResult {
    let mut scene = file::load(&args.scene).map_err(|e| CommandError::usage(e.to_string()))?;
    if let Some(MediumSource::Cfd(source)) = &scene.medium {
        let medium =
            file::cfd_medium(source, scene.band.as_ref()).map_err(|e| CommandError::usage(e.to_string()))?;
        scene.medium = Some(MediumSource::Grid(Box::new(medium), true));
    }
    for note in &scene.notes {
        eprintln!("ditd: {note}");
    }
    if args.target_error.is_some_and(|t| t.is_nan() || t <= 0.0) {
        return Err(CommandError::usage("render: --target-error must be positive"));
    }
    match &args.rays {
        Some(rays) => single_rays(&scene, rays, &args),
        None => image(&scene, &args),
    }
}

/// A medium of nothing, for scenes without one.
fn nothing() -> GridMedium {
    GridMedium {
        lower_m: [0.0; 3],
        upper_m: [1.0; 3],
        cells: [1; 3],
        groups: 1,
        channels: 2,
        index: vec![EMPTY],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: vec![ditd_sim::light::phase::PhaseFunction::Isotropic],
    }
}

/// Traces rays one by one.
fn trace(
    scene: &Scene,
    rays: &[([f64; 3], [f64; 3])],
    target_error: f64,
    seed: u64,
) -> Result<Vec<RayAnswer>, CommandError> {
    let usage = |e: ditd_sim::tracer::error::TracerError| CommandError::usage(format!("render: {e}"));
    let plate = scene.plate.as_ref().map(|p| Plate::new(&p.shape)).transpose().map_err(usage)?;
    let options = RayOptions { target_error, seed, paths_max: RAY_PATHS_MAX };
    let empty = nothing();
    let body = match &scene.medium {
        Some(MediumSource::Shape(shape, _)) => Body::shape(shape),
        Some(MediumSource::Grid(grid, _)) => Body::grid(grid, 0),
        Some(MediumSource::Cfd(_)) | None => Body::grid(&empty, 0),
    };
    render_rays(&body.map_err(usage)?, rays, plate.as_ref(), &options).map_err(usage)
}

/// Radiances of plate, walls and medium in the scene's band, where their temperatures are given.
struct Lights {
    plate: f64,
    walls: f64,
    /// Radiance of a medium of one temperature; none where the second channel holds it.
    medium: Option<f64>,
}

/// The lights of a scene, if band and all temperatures are known.
fn lights(scene: &Scene) -> Option<Lights> {
    let band = scene.band.as_ref()?;
    let walls = scene.walls.map(|w| band.radiance(w.temperature_k));
    let plate = match &scene.plate {
        Some(plate) => {
            let own = band.radiance(plate.temperature_k?);
            // The plate mirrors the chamber, whose closed walls are black whatever their emissivity.
            plate.emissivity * own + (1.0 - plate.emissivity) * walls.unwrap_or(0.0)
        }
        None => 0.0,
    };
    let medium = match &scene.medium {
        Some(MediumSource::Shape(_, temperature)) => Some(band.radiance((*temperature)?)),
        Some(MediumSource::Grid(_, true)) => None,
        Some(MediumSource::Grid(_, false) | MediumSource::Cfd(_)) => return None,
        None => Some(0.0),
    };
    Some(Lights { plate, walls: walls?, medium })
}

impl Lights {
    /// Radiance, that of the medium alone, and its standard error.
    fn radiance(&self, answer: &RayAnswer) -> [f64; 3] {
        let a_medium = answer.medium[0];
        let medium = match self.medium {
            Some(radiance) => a_medium * radiance,
            None => answer.medium.get(1).copied().unwrap_or(f64::NAN),
        };
        let total = answer.plate * self.plate + answer.walls * self.walls + medium;
        // By closure the walls carry minus the errors of the others: only contrasts against them count. The
        // covariance follows from the error of the sum; a medium of several temperatures counts with its mean.
        let mean = if a_medium > 0.0 { medium / a_medium } else { self.walls };
        let (p, m) = (self.plate - self.walls, mean - self.walls);
        let [sp, sw, sm] = [answer.se_plate, answer.se_walls, answer.se_medium[0]].map(|s| s * s);
        let variance = p * p * sp + m * m * sm + p * m * (sw - sp - sm);
        [total, medium, variance.max(0.0).sqrt()]
    }
}

const COEFFICIENTS: [&str; 6] = ["a_plate", "a_walls", "a_medium", "se_plate", "se_walls", "se_medium"];
const RADIANCES: [&str; 3] = ["radiance", "radiance_medium", "se_radiance"];

fn coefficients(answer: &RayAnswer) -> [f64; 6] {
    let a = answer;
    [a.plate, a.walls, a.medium[0], a.se_plate, a.se_walls, a.se_medium[0]]
}

fn single_rays(scene: &Scene, path: &Path, args: &Args) -> CommandResult {
    let text = if path == Path::new("-") {
        std::io::read_to_string(std::io::stdin())
    } else {
        std::fs::read_to_string(path)
    };
    let text = text.map_err(|e| CommandError::usage(format!("render: reading {}: {e}", path.display())))?;
    let table = RayTable::parse(&text)
        .map_err(|e| CommandError::usage(format!("render: {}: {e}", path.display())))?;
    let answers = trace(scene, &table.rays, args.target_error.unwrap_or(RAY_TARGET), args.seed)?;
    let lights = lights(scene);
    let mut names: Vec<&str> = COEFFICIENTS.to_vec();
    if args.groups {
        names.extend(["a_plate_g00", "a_walls_g00", "a_medium_g00"]);
    }
    names.extend(RADIANCES);
    let rows = answers.iter().map(|answer| {
        let mut row = coefficients(answer).to_vec();
        if args.groups {
            row.extend(coefficients(answer)[..3].to_vec());
        }
        row.extend(lights.as_ref().map_or([f64::NAN; 3], |l| l.radiance(answer)));
        row
    });
    if args.json {
        let list: Vec<serde_json::Value> = rows
            .map(|row| names.iter().zip(row).map(|(n, v)| ((*n).to_owned(), serde_json::json!(v))).collect())
            .collect();
        return print(&serde_json::json!({ "rays": list }).to_string());
    }
    let mut out = format!("{},{}\n", table.header, names.join(","));
    for (line, row) in table.lines.iter().zip(rows) {
        out.push_str(line);
        for value in row {
            // 17 significant digits; an unknown radiance is an empty field.
            if value.is_nan() {
                out.push(',');
            } else {
                let _ = write!(out, ",{value:.16e}");
            }
        }
        out.push('\n');
    }
    print(out.trim_end())
}

#[expect(clippy::print_stdout, reason = "the command's answer")]
#[expect(clippy::unnecessary_wraps, reason = "the end of a command")]
fn print(text: &str) -> CommandResult {
    println!("{text}");
    Ok(())
}

/// The rays of a CSV file, with their lines as they were.
struct RayTable {
    header: String,
    lines: Vec<String>,
    rays: Vec<([f64; 3], [f64; 3])>,
}

impl RayTable {
    fn parse(text: &str) -> Result<Self, String> {
        let names = ["origin_x_m", "origin_y_m", "origin_z_m", "direction_x", "direction_y", "direction_z"];
        let mut lines =
            text.lines().enumerate().map(|(i, l)| (i + 1, l.trim_end())).filter(|(_, l)| !l.is_empty());
        let (_, header) = lines.next().ok_or("it is empty")?;
        let columns: Vec<&str> = header.split(',').map(str::trim).collect();
        let mut places = [0; 6];
        for (place, name) in places.iter_mut().zip(names) {
            *place =
                columns.iter().position(|c| *c == name).ok_or_else(|| format!("it has no column {name}"))?;
        }
        let mut table = Self { header: header.to_owned(), lines: Vec::new(), rays: Vec::new() };
        for (number, line) in lines {
            let cells: Vec<&str> = line.split(',').map(str::trim).collect();
            let mut v = [0.0; 6];
            for ((value, &place), name) in v.iter_mut().zip(&places).zip(names) {
                *value = cells
                    .get(place)
                    .and_then(|c| c.parse().ok())
                    .ok_or_else(|| format!("line {number}: {name} is not a number"))?;
            }
            table.rays.push(([v[0], v[1], v[2]], [v[3], v[4], v[5]]));
            table.lines.push(line.to_owned());
        }
        Ok(table)
    }
}

/// Coefficient images, row-major, as they go into the EXR file.
struct Images {
    channels: Vec<(&'static str, Vec<f32>)>,
    stats: Vec<(String, f64)>,
}

fn image(scene: &Scene, args: &Args) -> CommandResult {
    let camera = scene
        .camera
        .as_ref()
        .ok_or_else(|| CommandError::usage("render: the scene has no [camera]; add one or use --rays"))?;
    if camera.rows == 0 || camera.columns == 0 {
        return Err(CommandError::usage("render: the camera has no pixels"));
    }
    let target = args.target_error.unwrap_or(IMAGE_TARGET);
    let gridded = matches!(&scene.medium, Some(MediumSource::Grid(..)) | None);
    let images = if gridded && !args.reference {
        fast(scene, camera, target, args.seed)?
    } else {
        pixel_by_pixel(scene, camera, target, args.seed)?
    };
    if let Some(out) = &args.out {
        write_exr(out, camera, &images)
            .map_err(|e| CommandError::failure(format!("render: writing {}: {e}", out.display())))?;
    }
    report(&images, args.json)
}

fn fast(scene: &Scene, camera: &Camera, target_error: f64, seed: u64) -> Result<Images, CommandError> {
    let empty = nothing();
    let medium = match &scene.medium {
        Some(MediumSource::Grid(grid, _)) => grid.as_ref(),
        _ => &empty,
    };
    let plate: Option<&PlateShape> = scene.plate.as_ref().map(|p| &p.shape);
    let options = RenderOptions { target_error, seed, ..RenderOptions::default() };
    let operator = render_image(medium, camera, plate, &options, &|_| {})
        .map_err(|e| CommandError::usage(format!("render: {e}")))?;
    let lights = lights(scene);
    let n = operator.plate_seen.len();
    let mut answers: Vec<RayAnswer> = operator
        .plate_seen
        .iter()
        .map(|&seen| RayAnswer {
            plate: f64::from(seen),
            walls: 1.0 - f64::from(seen),
            medium: vec![0.0; 2],
            se_medium: vec![0.0; 2],
            ..RayAnswer::default()
        })
        .collect();
    for (i, &pixel) in operator.pixels.iter().enumerate() {
        let answer = &mut answers[pixel as usize];
        answer.plate = f64::from(operator.a_plate[i]);
        answer.medium = operator.emission[2 * i..2 * i + 2].iter().map(|&v| f64::from(v)).collect();
        answer.walls = 1.0 - answer.plate - answer.medium[0];
        answer.se_plate = f64::from(operator.error_plate[i]);
        answer.se_medium[0] = f64::from(operator.error_medium[i]);
        // Plate and medium errors are not jointly known here: the bound for independent ones.
        answer.se_walls = answer.se_plate.hypot(answer.se_medium[0]);
    }
    Ok(Images { channels: channels(&answers, lights.as_ref(), n), stats: operator.stats })
}

/// Every pixel as a ray of its own through its centre.
#[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
fn pixel_by_pixel(scene: &Scene, camera: &Camera, target: f64, seed: u64) -> Result<Images, CommandError> {
    let sights = camera.sights().map_err(|e| CommandError::usage(format!("render: {e}")))?;
    let rays: Vec<_> = (0..camera.rows * camera.columns)
        .map(|i| sights.ray((i / camera.columns) as f64 + 0.5, (i % camera.columns) as f64 + 0.5))
        .collect();
    let answers = trace(scene, &rays, target, seed)?;
    let paths: u64 = answers.iter().map(|a| a.paths).sum();
    let lights = lights(scene);
    let stats = vec![("pixels".to_owned(), rays.len() as f64), ("paths".to_owned(), paths as f64)];
    Ok(Images { channels: channels(&answers, lights.as_ref(), rays.len()), stats })
}

#[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
fn channels(answers: &[RayAnswer], lights: Option<&Lights>, pixels: usize) -> Vec<(&'static str, Vec<f32>)> {
    let mut channels: Vec<(&'static str, Vec<f32>)> =
        COEFFICIENTS.iter().map(|&name| (name, Vec::with_capacity(pixels))).collect();
    for answer in answers {
        for (channel, value) in channels.iter_mut().zip(coefficients(answer)) {
            channel.1.push(value as f32);
        }
    }
    if let Some(lights) = lights {
        let values: Vec<[f64; 3]> = answers.iter().map(|a| lights.radiance(a)).collect();
        for (k, name) in RADIANCES.into_iter().enumerate() {
            channels.push((name, values.iter().map(|v| v[k] as f32).collect()));
        }
    }
    channels
}

fn write_exr(path: &Path, camera: &Camera, images: &Images) -> exr::error::UnitResult {
    use exr::prelude::*;
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = images
        .channels
        .iter()
        .map(|(name, values)| AnyChannel::new(*name, FlatSamples::F32(values.clone())))
        .collect();
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::SMALL_LOSSLESS };
    let layer = Layer::new(
        (camera.columns, camera.rows),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(list),
    );
    Image::from_layer(layer).write().to_file(path)
}

#[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
fn report(images: &Images, json: bool) -> CommandResult {
    let means: Vec<(String, f64)> = images
        .channels
        .iter()
        .map(|(name, v)| {
            (format!("mean_{name}"), v.iter().map(|&x| f64::from(x)).sum::<f64>() / v.len().max(1) as f64)
        })
        .collect();
    let all = images.stats.iter().chain(&means);
    if json {
        let map: serde_json::Map<String, serde_json::Value> =
            all.map(|(name, value)| (name.clone(), serde_json::json!(value))).collect();
        return print(&serde_json::Value::Object(map).to_string());
    }
    let lines: Vec<String> = all.map(|(name, value)| format!("{name:24} {value}")).collect();
    print(&lines.join("\n"))
}
