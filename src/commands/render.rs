//! `ditd render`.

mod pictures;
mod shots;

use super::{CommandError, CommandResult};
use ditd_sim::scene::deposit::DepositReport;
use ditd_sim::scene::exposure::Moments;
use ditd_sim::scene::file::{self, MediumSource, Scene};
use ditd_sim::scene::lights::{EndShares, Lights, Mirrored, Share};
use ditd_sim::scene::mirror::Mirror;
use ditd_sim::scene::optics::{OpticsOptions, OpticsReport, Work};
use ditd_sim::tracer::camera::Camera;
use ditd_sim::tracer::chamber::{ENDS, OUTSIDE, SIDE_NAMES, SIDES, Walls};
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::mean_rays::{MeanRay, Setting, mean_rays};
use ditd_sim::tracer::medium::{EMPTY, GridMedium};
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::reference::render_reference;
use ditd_sim::tracer::shape::Body;
use ditd_sim::tracer::uneven::{self, UnevenPlate};
use pictures::{Picture, kelvin_name, write_pngs};
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
    /// Write a picture of the radiance to this PNG file; with several plate temperatures one each, on a common scale,
    /// with the temperature added to the name
    #[arg(long, conflicts_with = "rays")]
    png: Option<PathBuf>,
    /// Temperatures of the plate in K of which images are wanted, separated by commas: channels radiance_plate_400K …
    /// [default: the scene's temperatures_k in [plate]]
    #[arg(long, value_name = "K", value_delimiter = ',', conflicts_with = "rays")]
    plate_temperatures: Vec<f64>,
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
    /// Also follow shots 1 … N of a parametric spray through the light of the mean one: a file for each (FILE_shot1.exr …),
    /// and in FILE their mean and standard deviation
    #[arg(long, value_name = "N", conflicts_with_all = ["rays", "reference"])]
    shots: Option<u32>,
    /// Names the random numbers, with --shots also those of the shots [default: 1, for the shots the scene's seed]
    #[arg(long)]
    seed: Option<u64>,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

impl Args {
    fn seed(&self) -> u64 {
        self.seed.unwrap_or(1)
    }
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for a scene or a table of rays that makes no sense, 1 where a file cannot be written.
pub fn run(args: Args) -> CommandResult {
    if args.target_error.is_some_and(|t| t.is_nan() || t <= 0.0) {
        return Err(CommandError::usage("render: --target-error must be positive"));
    }
    let default = if args.rays.is_some() { RAY_TARGET } else { IMAGE_TARGET };
    let options = OpticsOptions { target_error: args.target_error.unwrap_or(default) };
    let scene = file::load(&args.scene).map_err(|e| CommandError::usage(e.to_string()))?;
    if let Some(number) = args.shots {
        shots::check(&scene, number)?;
    }
    // Single rays are of one moment.
    let moments = if args.rays.is_some() {
        Moments { scenes: vec![(1.0, scene)], pixels: 0.0 }
    } else {
        scene.moments().map_err(|e| CommandError::usage(e.to_string()))?
    };
    let mut scenes = Vec::with_capacity(moments.scenes.len());
    for (weight, scene) in moments.scenes {
        let scene = scene.with_spray(&options).map_err(|e| CommandError::usage(e.to_string()))?;
        for note in &scene.notes {
            eprintln!("ditd: {note}");
        }
        scenes.push((weight, scene));
    }
    match (&args.rays, args.shots) {
        (Some(rays), _) => single_rays(&scenes[0].1, rays, &args),
        (None, Some(number)) => shots::images(scenes, number, &args),
        (None, None) => image(scenes, moments.pixels, &args),
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

/// What sights collect: per sight one share per spectral group, and the walls one by one where they are told apart.
struct Collected {
    shares: Vec<Vec<Share>>,
    ends: Vec<EndShares>,
    stats: Vec<(String, f64)>,
}

impl Collected {
    fn of(&self, sight: usize) -> (&[Share], Option<&EndShares>) {
        (&self.shares[sight], self.ends.get(sight))
    }
}

/// Traces rays one by one.
fn trace(
    scene: &Scene,
    walls: Walls,
    rays: &[([f64; 3], [f64; 3])],
    shape: Option<&PlateShape>,
    target_error: f64,
    seed: u64,
) -> Result<Collected, CommandError> {
    let usage = |e: ditd_sim::tracer::error::TracerError| CommandError::usage(format!("render: {e}"));
    let plate = shape.map(Plate::new).transpose().map_err(usage)?;
    let options = RayOptions { target_error, seed, paths_max: RAY_PATHS_MAX, walls, ..RayOptions::default() };
    let empty = nothing();
    let bodies = match &scene.medium {
        Some(MediumSource::Shape(shape, _)) => vec![Body::shape(shape)],
        Some(MediumSource::Grid(grid, _)) => vec![Body::grid(grid, 0)],
        Some(MediumSource::Spectral(grid, _)) => (0..grid.groups).map(|g| Body::grid(grid, g)).collect(),
        Some(MediumSource::Cfd(_) | MediumSource::Parametric(_)) | None => vec![Body::grid(&empty, 0)],
    };
    let own = scene.plate.as_ref().filter(|p| Some(&p.shape) == shape);
    let uneven = if own.is_some() { uneven_plate(scene)? } else { None };
    let mut shares = vec![Vec::new(); rays.len()];
    let mut ends = vec![EndShares::default(); if walls.apart().is_some() { rays.len() } else { 0 }];
    let mut paths = 0;
    let groups = bodies.len();
    for body in bodies {
        let answers = render_rays(&body.map_err(usage)?, rays, plate.as_ref(), &options).map_err(usage)?;
        for ((shares, answer), &(origin, direction)) in shares.iter_mut().zip(&answers).zip(rays) {
            paths += answer.paths;
            let mut share = share(answer);
            if let Some(uneven) = &uneven {
                let met = uneven.seen(origin, direction).is_some();
                let straight = if met { answer.direct_transmittance } else { 0.0 };
                share.excess = uneven.of_ray(origin, direction, answer.plate, straight);
            }
            shares.push(share);
        }
        for (ends, answer) in ends.iter_mut().zip(&answers) {
            add_ends(ends, answer, groups);
        }
    }
    let stats = vec![("pixels".to_owned(), count(rays.len())), ("paths".to_owned(), paths as f64)];
    Ok(Collected { shares, ends, stats })
}

/// Adds one spectral group of a ray; its standard errors become the rms over all groups.
#[expect(clippy::cast_precision_loss, reason = "groups are few")]
fn add_ends(ends: &mut EndShares, answer: &RayAnswer, groups: usize) {
    ends.shares.push(std::array::from_fn(|end| answer.ends[end]));
    for (sum, se) in ends.se.iter_mut().zip(&answer.se_ends) {
        *sum = sum.hypot(se / (groups as f64).sqrt());
    }
}

/// The same with what the far window mirrors, where it mirrors the chamber.
fn trace_mirrored(
    scene: &Scene,
    walls: Walls,
    rays: &[([f64; 3], [f64; 3])],
    target_error: f64,
    seed: u64,
) -> Result<Collected, CommandError> {
    let plate = scene.plate.as_ref().map(|p| &p.shape);
    let mut collected = trace(scene, walls, rays, plate, target_error, seed)?;
    let Some(mirror) = Mirror::of(scene) else { return Ok(collected) };
    // Rays that pass the window's plane by see no plate behind it either.
    let back: Vec<_> = rays.iter().map(|&(o, d)| mirror.ray(o, d).unwrap_or((o, d))).collect();
    let opening = mirror.opening(rays, 0.0);
    let target_error = mirror.target(target_error);
    let mirrored = trace(scene, walls.together(), &back, opening.as_ref(), target_error, seed)?;
    for (shares, mirrored) in collected.shares.iter_mut().zip(&mirrored.shares) {
        mirror_in(shares, mirrored);
    }
    Ok(collected)
}

/// Puts what the far window mirrors into the shares of a sight.
fn mirror_in(shares: &mut [Share], mirrored: &[Share]) {
    for (share, there) in shares.iter_mut().zip(mirrored) {
        share.mirrored = Some(Mirrored {
            opening: there.plate,
            medium: there.medium,
            emission: there.emission,
            se: there.se[0].hypot(there.se[2]),
        });
    }
}

fn share(answer: &RayAnswer) -> Share {
    Share {
        plate: answer.plate,
        walls: answer.walls,
        medium: answer.medium[0],
        emission: answer.medium.get(1).copied().unwrap_or(0.0),
        se: [answer.se_plate, answer.se_walls, answer.se_medium[0]],
        ..Share::default()
    }
}

/// The plate of a scene with the deviation of its temperature, if it is uneven.
fn uneven_plate(scene: &Scene) -> Result<Option<UnevenPlate>, CommandError> {
    let plate = scene.plate.as_ref().and_then(|p| p.deviation.as_ref().map(|d| (&p.shape, d)));
    plate
        .map(|(shape, deviation)| UnevenPlate::new(shape, deviation))
        .transpose()
        .map_err(|e| CommandError::usage(format!("render: {e}")))
}

/// Names and values of what is printed or written of each sight.
struct Columns {
    lights: Lights,
    windows: bool,
    /// Whether the walls of a chamber are told apart.
    apart: bool,
    uneven: bool,
    /// Spectral groups to list.
    groups: usize,
}

impl Columns {
    fn new(scene: &Scene, list_groups: bool, apart: bool) -> Self {
        let groups = match &scene.medium {
            Some(MediumSource::Spectral(grid, _)) => grid.groups,
            _ => 1,
        };
        Self {
            lights: Lights::new(scene),
            windows: scene.windows.any(),
            apart,
            uneven: scene.plate.as_ref().is_some_and(|p| p.deviation.is_some()),
            groups: if list_groups { groups } else { 0 },
        }
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            ["a_plate", "a_walls", "a_medium", "se_plate", "se_walls", "se_medium"].map(String::from).into();
        let extra = ["a_window", "a_camera_side"];
        if self.windows {
            names.extend([extra[0], extra[1], "se_window"].map(String::from));
        }
        if self.uneven {
            names.push("plate_excess_k".to_owned());
        }
        let ends = || (0..if self.apart { ENDS } else { 0 }).map(end_name);
        if self.apart {
            names.extend(ends());
            names.push("se_wall".to_owned());
        }
        for g in 0..self.groups {
            names.extend(["a_plate", "a_walls", "a_medium"].map(|n| format!("{n}_g{g:02}")));
            names.extend(ends().map(|n| format!("{n}_g{g:02}")));
            if self.windows {
                names.extend(extra.map(|n| format!("{n}_g{g:02}")));
            }
        }
        names.extend(["radiance", "radiance_medium", "se_radiance"].map(String::from));
        names
    }

    fn values(&self, (shares, ends): (&[Share], Option<&EndShares>)) -> Vec<f64> {
        let (seen, by_end) = match ends {
            Some(ends) => self.lights.see_apart(shares, ends),
            None => (self.lights.see(shares), [0.0; ENDS]),
        };
        let [se_plate, se_walls, se_medium, se_window] = seen.se;
        let mut values = vec![seen.plate, seen.walls, seen.medium, se_plate, se_walls, se_medium];
        if self.windows {
            values.extend([seen.window, seen.camera_side, se_window]);
        }
        if self.uneven {
            values.push(seen.plate_excess_k);
        }
        if let Some(ends) = ends {
            values.extend(by_end);
            values.push(ends.se.iter().copied().fold(0.0, f64::max));
        }
        for g in 0..self.groups {
            let seen = self.lights.see_group(shares, g);
            values.extend([seen.plate, seen.walls, seen.medium]);
            values.extend(ends.iter().flat_map(|ends| self.lights.ends_of_group(shares, ends, g)));
            if self.windows {
                values.extend([seen.window, seen.camera_side]);
            }
        }
        values.extend([seen.radiance, seen.radiance_medium, seen.se_radiance]);
        values
    }
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
    let walls = scene.surroundings(&[]);
    if scene.camera.as_ref().is_some_and(|c| c.lens.is_some()) || scene.exposure.is_some() {
        eprintln!("ditd: single rays pass no lens and see the middle of the exposure");
    }
    let target_error = args.target_error.unwrap_or(RAY_TARGET);
    let collected = trace_mirrored(scene, walls, &table.rays, target_error, args.seed())?;
    let columns = Columns::new(scene, args.groups, walls.apart().is_some());
    let names = columns.names();
    let rows = (0..table.rays.len()).map(|sight| columns.values(collected.of(sight)));
    if args.json {
        let list: Vec<serde_json::Value> = rows
            .map(|row| names.iter().zip(row).map(|(n, v)| (n.clone(), serde_json::json!(v))).collect())
            .collect();
        return super::print(&format!("{}\n", serde_json::json!({ "rays": list })));
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
    super::print(&out)
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
    channels: Vec<(String, Vec<f32>)>,
    stats: Vec<(String, f64)>,
}

/// The mean over the moments of the exposure, or of the only one.
fn image(scenes: Vec<(f64, Scene)>, pixels_moved: f64, args: &Args) -> CommandResult {
    let count = scenes.len();
    let mut mean: Option<(Images, Vec<Picture>, Camera, Scene)> = None;
    for (weight, scene) in scenes {
        let (images, pictures, camera, scene) = one_image(scene, args)?;
        let Some((sum, shown, ..)) = &mut mean else {
            let scaled = if count > 1 { weight } else { 1.0 };
            let mut first = (images, pictures, camera, scene);
            first.0.scale(scaled);
            first.1.iter_mut().for_each(|p| p.values.iter_mut().for_each(|v| *v *= scaled));
            mean = Some(first);
            continue;
        };
        sum.add(&images, weight)?;
        for (sum, picture) in shown.iter_mut().zip(&pictures) {
            sum.values.iter_mut().zip(&picture.values).for_each(|(s, v)| *s += weight * v);
        }
    }
    let Some((mut images, pictures, camera, scene)) = mean else {
        return Err(CommandError::usage("render: the exposure has no moment"));
    };
    if count > 1 {
        images.stats.push(("exposure_moments".to_owned(), count as f64));
        images.stats.push(("exposure_pixels".to_owned(), pixels_moved));
    }
    if let Some(png) = &args.png {
        write_pngs(png, &camera, &scene, &pictures)?;
    }
    if let Some(out) = &args.out {
        write_exr(out, &camera, &images)
            .map_err(|e| CommandError::failure(format!("render: writing {}: {e}", out.display())))?;
    }
    report(&images, args.json)
}

impl Images {
    #[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
    fn scale(&mut self, weight: f64) {
        self.channels.iter_mut().for_each(|(_, v)| v.iter_mut().for_each(|v| *v *= weight as f32));
        self.stats.iter_mut().for_each(|(_, v)| *v *= weight);
    }

    /// Adds a weighted moment; standard errors as if they were fully correlated, which bounds them from above.
    #[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
    fn add(&mut self, other: &Self, weight: f64) -> Result<(), CommandError> {
        let names = |images: &Self| images.channels.iter().map(|c| c.0.clone()).collect::<Vec<_>>();
        if names(self) != names(other) {
            return Err(CommandError::usage(
                "render: the moments of the exposure have different numbers of spectral groups; leave out --groups, or \
                 give [band] samples a number",
            ));
        }
        for ((_, sum), (_, values)) in self.channels.iter_mut().zip(&other.channels) {
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += weight as f32 * v);
        }
        for (name, value) in &mut self.stats {
            if let Some((_, other)) = other.stats.iter().find(|(n, _)| n == name) {
                *value += weight * other;
            }
        }
        Ok(())
    }
}

fn one_image(mut scene: Scene, args: &Args) -> Result<(Images, Vec<Picture>, Camera, Scene), CommandError> {
    let temperatures_k = plate_temperatures(&mut scene, args)?;
    let camera = camera_of(&scene)?;
    let target = args.target_error.unwrap_or(IMAGE_TARGET);
    let plate = scene.plate.as_ref().map(|p| &p.shape);
    let walls = scene.surroundings(&temperatures_k);
    let mut collected = rendered(&scene, &camera, walls, plate, target, args)?;
    let mut stats = std::mem::take(&mut collected.stats);
    if let Some(mirror) = Mirror::of(&scene) {
        let (back, more) = (mirror.camera(&camera), mirror.opening_of(&camera));
        let alike = walls.together();
        let mirrored = rendered(&scene, &back, alike, more.as_ref(), mirror.target(target), args)?;
        stats.extend(mirrored.stats.into_iter().map(|(name, value)| (format!("mirrored_{name}"), value)));
        for (pixel, shares) in collected.shares.iter_mut().enumerate() {
            // In the mirror left is right.
            let (row, column) = (pixel / camera.columns, pixel % camera.columns);
            let there = &mirrored.shares[row * camera.columns + camera.columns - 1 - column];
            mirror_in(shares, there);
        }
    }
    if scene.chamber.is_some() {
        // Walls that all shine alike are one.
        let skipped = if walls.apart().is_some() { 0 } else { SIDES };
        stats.push(("skipped_walls".to_owned(), count(skipped)));
    }
    stats.extend(scene.optics.iter().flat_map(optics_stats));
    stats.extend(scene.deposit.iter().flat_map(deposit_stats));
    let views = Views::new(&mut scene, &temperatures_k, args, walls)?;
    let (channels, pictures) = views.images(&collected);
    Ok((Images { channels, stats }, pictures, camera, scene))
}

fn camera_of(scene: &Scene) -> Result<Camera, CommandError> {
    let camera = scene
        .camera
        .clone()
        .ok_or_else(|| CommandError::usage("render: the scene has no [camera]; add one or use --rays"))?;
    if camera.rows == 0 || camera.columns == 0 {
        return Err(CommandError::usage("render: the camera has no pixels"));
    }
    Ok(camera)
}

/// What is made of the shares of all pixels: coefficients, and images at the plate's temperatures. Transport is linear, so
/// that those enter only here.
struct Views {
    columns: Columns,
    at_plate: Vec<(f64, Lights)>,
}

impl Views {
    fn new(
        scene: &mut Scene,
        temperatures_k: &[f64],
        args: &Args,
        walls: Walls,
    ) -> Result<Self, CommandError> {
        let columns = Columns::new(scene, args.groups, walls.apart().is_some());
        let mut at_plate = Vec::new();
        for &kelvin in temperatures_k {
            if let Some(plate) = &mut scene.plate {
                plate.temperature_k = Some(kelvin);
            }
            let lights = Lights::new(scene);
            if !lights.lit() {
                return Err(CommandError::usage(
                    "render: images at plate temperatures need [band], and temperatures of [walls] and [medium]",
                ));
            }
            at_plate.push((kelvin, lights));
        }
        Ok(Self { columns, at_plate })
    }

    /// Channels of an image file, and radiances to be shown.
    fn images(&self, collected: &Collected) -> (Vec<(String, Vec<f32>)>, Vec<Picture>) {
        let mut channels = channels(&self.columns, collected);
        let lights = &self.columns.lights;
        if self.at_plate.is_empty() && lights.lit() {
            return (channels, vec![Picture { name: None, values: radiance(lights, collected) }]);
        }
        let mut pictures = Vec::new();
        for (kelvin, lights) in &self.at_plate {
            let values = radiance(lights, collected);
            #[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
            let single = values.iter().map(|&v| v as f32).collect();
            channels.push((format!("radiance_plate_{}", kelvin_name(*kelvin)), single));
            pictures.push(Picture { name: Some(*kelvin), values });
        }
        (channels, pictures)
    }
}

/// Shares of all pixels of a camera, with any plate.
fn rendered(
    scene: &Scene,
    camera: &Camera,
    walls: Walls,
    plate: Option<&PlateShape>,
    target: f64,
    args: &Args,
) -> Result<Collected, CommandError> {
    if matches!(&scene.medium, Some(MediumSource::Shape(..))) {
        pixel_by_pixel(scene, camera, walls, plate, target, args.seed())
    } else {
        operator(scene, camera, walls, plate, target, args)
    }
}

/// The plate temperatures of which images are wanted: those of the command, else of the scene.
fn plate_temperatures(scene: &mut Scene, args: &Args) -> Result<Vec<f64>, CommandError> {
    let Some(plate) = &mut scene.plate else {
        if args.plate_temperatures.is_empty() {
            return Ok(Vec::new());
        }
        return Err(CommandError::usage("render: --plate-temperatures needs a scene with a [plate]"));
    };
    if args.plate_temperatures.is_empty() {
        return Ok(plate.temperatures_k.clone());
    }
    if let Some(bad) = args.plate_temperatures.iter().find(|t| !(t.is_finite() && **t >= 0.0)) {
        return Err(CommandError::usage(format!(
            "render: --plate-temperatures holds {bad}; each must be finite and not negative"
        )));
    }
    // Coefficients of a band are weighted with the plate's light: without a temperature of its own, the first one's.
    plate.temperature_k = plate.temperature_k.or(args.plate_temperatures.first().copied());
    Ok(args.plate_temperatures.clone())
}

fn radiance(lights: &Lights, collected: &Collected) -> Vec<f64> {
    (0..collected.shares.len())
        .map(|sight| match collected.of(sight) {
            (shares, Some(ends)) => lights.see_apart(shares, ends).0.radiance,
            (shares, None) => lights.see(shares).radiance,
        })
        .collect()
}

/// The column or channel of a wall, or of the place outside.
fn end_name(end: usize) -> String {
    if end == OUTSIDE { "a_outside".to_owned() } else { format!("a_wall_{}", SIDE_NAMES[end]) }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn count(n: usize) -> f64 {
    n as f64
}

/// What the coefficients of a spray took, and what was left out: groups and the most that it can cost.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn optics_stats(report: &OpticsReport) -> Vec<(String, f64)> {
    let mut stats = vec![
        ("mie_spheres".to_owned(), report.mie_spheres as f64),
        ("vapour_nodes".to_owned(), report.vapour_nodes as f64),
        ("phase_tables".to_owned(), report.phase_tables as f64),
    ];
    for work in [Work::Mie, Work::Vapour, Work::Phase] {
        let skips = || report.skipped.iter().filter(|skip| skip.work == work);
        let groups: usize = skips().map(|skip| skip.groups).sum();
        let error = skips().map(|skip| skip.admitted_error).fold(0.0, f64::max);
        stats.push((format!("skipped_{}_groups", work.name()), groups as f64));
        stats.push((format!("skipped_{}_error", work.name()), error));
    }
    stats
}

/// How the spray was spread on the grid: what got lost, and how much of the picture is parcel noise.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn deposit_stats(report: &DepositReport) -> Vec<(String, f64)> {
    let [x, y, z] = report.split_half;
    let stats = [
        ("spray_cell_m", report.cell_m[0]),
        ("spray_droplet_cells", report.droplet_cells as f64),
        ("spray_vapour_cells", report.vapour_cells as f64),
        ("spray_droplets", report.droplets),
        ("spray_outside_droplets", report.outside_droplets),
        ("spray_outside_parcels", report.outside_parcels as f64),
        ("spray_junk_parcels", report.junk_parcels as f64),
        ("spray_droplet_error", report.droplet_error),
        ("spray_vapour_mol", report.vapour_mol),
        ("spray_outside_vapour_mol", report.outside_vapour_mol),
        ("spray_vapour_error", report.vapour_error),
        ("n_eff", report.n_eff),
        ("n_eff_short", report.n_eff_short),
        ("kernel_m", report.kernel_m),
        ("split_half_x", x),
        ("split_half_y", y),
        ("split_half_z", z),
    ];
    stats.map(|(name, value)| (name.to_owned(), value)).to_vec()
}

/// The image of a gridded medium: by the cache, or with `--reference` pixel by pixel.
fn operator(
    scene: &Scene,
    camera: &Camera,
    walls: Walls,
    plate: Option<&PlateShape>,
    target_error: f64,
    args: &Args,
) -> Result<Collected, CommandError> {
    let empty = nothing();
    let medium = gridded(scene).unwrap_or(&empty);
    let options = render_options(scene, walls, target_error, args);
    let operator = if args.reference {
        render_reference(medium, camera, plate, &options, None, &|_| {})
    } else {
        render_image(medium, camera, plate, &options, &|_| {})
    };
    let operator = operator.map_err(|e| CommandError::usage(format!("render: {e}")))?;
    let mut collected = collected(&operator, walls);
    let groups = operator.groups;
    // Only the scene's own plate is uneven, not the opening that stands for it in a mirror.
    let own = scene.plate.as_ref().filter(|p| Some(&p.shape) == plate);
    if let Some(uneven) = own.and(uneven_plate(scene)?) {
        let excess = uneven::excess(medium, camera, &uneven, &options, &operator)
            .map_err(|e| CommandError::usage(format!("render: {e}")))?;
        for (shares, seen) in collected.shares.iter_mut().zip(&excess.seen) {
            shares.iter_mut().for_each(|share| share.excess = seen.map(f64::from));
        }
        for (&pixel, found) in operator.pixels.iter().zip(excess.active.chunks_exact(groups)) {
            for (share, found) in collected.shares[pixel as usize].iter_mut().zip(found) {
                share.excess = found.map(f64::from);
            }
        }
        collected.stats.push(("plate_excess_error_k".to_owned(), excess.error_k));
    }
    Ok(collected)
}

/// The medium of a scene if it is on a grid.
fn gridded(scene: &Scene) -> Option<&GridMedium> {
    match &scene.medium {
        Some(MediumSource::Grid(grid, _) | MediumSource::Spectral(grid, _)) => Some(grid.as_ref()),
        _ => None,
    }
}

fn render_options(scene: &Scene, walls: Walls, target_error: f64, args: &Args) -> RenderOptions {
    let motion_m = scene.exposure.map_or([0.0; 3], |e| e.motion_m());
    RenderOptions { target_error, seed: args.seed(), walls, motion_m, ..RenderOptions::default() }
}

/// The shares of all pixels of an operator.
fn collected(operator: &Operator, walls: Walls) -> Collected {
    let groups = operator.groups;
    let mut shares: Vec<Vec<Share>> = operator
        .plate_seen
        .iter()
        .map(|&seen| {
            let plate = f64::from(seen);
            vec![Share { plate, walls: 1.0 - plate, ..Share::default() }; groups]
        })
        .collect();
    for (i, &pixel) in operator.pixels.iter().enumerate() {
        // Errors are known as rms over the groups. Those of plate and medium are not jointly known: the bound for
        // independent ones.
        let [se_plate, se_medium] =
            [&operator.error_plate, &operator.error_medium].map(|errors| f64::from(errors[i]));
        for (g, share) in shares[pixel as usize].iter_mut().enumerate() {
            let emission = |c: usize| f64::from(operator.emission[(i * operator.channels + c) * groups + g]);
            let plate = f64::from(operator.a_plate[i * groups + g]);
            *share = Share {
                plate,
                walls: 1.0 - plate - emission(0),
                medium: emission(0),
                emission: emission(1),
                se: [se_plate, se_plate.hypot(se_medium), se_medium],
                ..Share::default()
            };
        }
    }
    let ends = if walls.apart().is_some() { ends_of(operator) } else { Vec::new() };
    Collected { shares, ends, stats: operator.stats.clone() }
}

/// The walls one by one, of every pixel.
fn ends_of(operator: &Operator) -> Vec<EndShares> {
    let groups = operator.groups;
    let mut ends: Vec<EndShares> = operator
        .ends_seen
        .chunks_exact(ENDS)
        .map(|seen| EndShares {
            shares: vec![std::array::from_fn(|end| f64::from(seen[end])); groups],
            se: [0.0; ENDS],
        })
        .collect();
    for (i, &pixel) in operator.pixels.iter().enumerate() {
        let shares = &operator.a_ends[i * ENDS * groups..(i + 1) * ENDS * groups];
        ends[pixel as usize] = EndShares {
            shares: (0..groups)
                .map(|g| std::array::from_fn(|end| f64::from(shares[end * groups + g])))
                .collect(),
            se: [f64::from(operator.error_ends[i]); ENDS],
        };
    }
    ends
}

/// Analytic shapes: every pixel as a ray of its own through its centre, or with a lens or motion as the mean of rays.
#[expect(clippy::cast_precision_loss, reason = "images are smaller than 2^53")]
fn pixel_by_pixel(
    scene: &Scene,
    camera: &Camera,
    walls: Walls,
    plate: Option<&PlateShape>,
    target: f64,
    seed: u64,
) -> Result<Collected, CommandError> {
    let usage = |e: ditd_sim::tracer::error::TracerError| CommandError::usage(format!("render: {e}"));
    let pixels = (camera.rows * camera.columns) as f64;
    let motion_m = scene.exposure.map_or([0.0; 3], |e| e.motion_m());
    let own = scene.plate.as_ref().filter(|p| Some(&p.shape) == plate);
    let uneven = if own.is_some() { uneven_plate(scene)? } else { None };
    let setting = Setting { camera, plate, uneven: uneven.as_ref(), motion_m };
    if let (true, Some(MediumSource::Shape(shape, _))) = (setting.spreads(), &scene.medium) {
        if walls.chamber().is_some() {
            return Err(CommandError::usage(
                "render: [medium] is a shape, seen through a lens or in motion, in a [chamber]; give it as a grid, or leave \
                 out one of them",
            ));
        }
        let body = Body::shape(shape).map_err(usage)?;
        let options =
            RayOptions { target_error: target, seed, paths_max: RAY_PATHS_MAX, ..RayOptions::default() };
        let means = mean_rays(&body, &setting, &options).map_err(usage)?;
        let sum = |f: fn(&MeanRay) -> f64| means.iter().map(f).sum::<f64>();
        let stats = vec![
            ("pixels".to_owned(), pixels),
            ("sights".to_owned(), sum(|m| f64::from(m.rays))),
            ("paths".to_owned(), sum(|m| m.paths as f64)),
        ];
        let shares = means
            .iter()
            .map(|m| {
                let walls = (1.0 - m.plate - m.medium).max(0.0);
                let (plate, medium, se, excess) = (m.plate, m.medium, m.se, m.excess);
                vec![Share { plate, walls, medium, se, excess, ..Share::default() }]
            })
            .collect();
        return Ok(Collected { shares, ends: Vec::new(), stats });
    }
    let sights = camera.sights().map_err(usage)?;
    let rays: Vec<_> = (0..camera.rows * camera.columns)
        .map(|i| sights.ray((i / camera.columns) as f64 + 0.5, (i % camera.columns) as f64 + 0.5))
        .collect();
    trace(scene, walls, &rays, plate, target, seed)
}

#[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
fn channels(columns: &Columns, collected: &Collected) -> Vec<(String, Vec<f32>)> {
    let pixels = collected.shares.len();
    let mut channels: Vec<(String, Vec<f32>)> =
        columns.names().into_iter().map(|name| (name, Vec::with_capacity(pixels))).collect();
    for pixel in 0..pixels {
        for (channel, value) in channels.iter_mut().zip(columns.values(collected.of(pixel))) {
            channel.1.push(value as f32);
        }
    }
    // Radiances of a scene that does not give all temperatures.
    if !columns.lights.lit() {
        channels.truncate(channels.len() - 3);
    }
    channels
}

fn write_exr(path: &Path, camera: &Camera, images: &Images) -> exr::error::UnitResult {
    use exr::prelude::*;
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = images
        .channels
        .iter()
        .map(|(name, values)| AnyChannel::new(name.as_str(), FlatSamples::F32(values.clone())))
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

/// Mean over an image; 0 of none.
fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&x| f64::from(x)).sum::<f64>() / count(values.len().max(1))
}

fn report(images: &Images, json: bool) -> CommandResult {
    let means: Vec<(String, f64)> =
        images.channels.iter().map(|(name, values)| (format!("mean_{name}"), mean(values))).collect();
    let all = images.stats.iter().chain(&means);
    if json {
        let map: serde_json::Map<String, serde_json::Value> =
            all.map(|(name, value)| (name.clone(), serde_json::json!(value))).collect();
        return super::print(&format!("{}\n", serde_json::Value::Object(map)));
    }
    let lines: Vec<String> = all.map(|(name, value)| format!("{name:24} {value}")).collect();
    super::print(&format!("{}\n", lines.join("\n")))
}
