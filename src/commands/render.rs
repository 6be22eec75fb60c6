//! `ditd render`.

mod collected;
mod columns;
mod image;
mod pictures;
mod rays;
mod report;
mod shots;

use super::{CommandError, CommandResult};
use ditd_sim::scene::exposure::Moments;
use ditd_sim::scene::file;
use ditd_sim::scene::optics::OpticsOptions;
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
    for path in args.out.iter().chain(&args.png) {
        check_place(path)?;
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
        (Some(table), _) => rays::single_rays(&scenes[0].1, table, &args),
        (None, Some(number)) => shots::images(scenes, number, &args),
        (None, None) => image::image(scenes, moments.pixels, &args),
    }
}

/// Refuses a file that could not be written, before any work is done for it.
fn check_place(path: &Path) -> Result<(), CommandError> {
    let refuse = |problem: String| Err(CommandError::usage(format!("render: {}: {problem}", path.display())));
    if path.is_dir() {
        return refuse(format!("is a folder. Name a file, {} for example", path.join("image").display()));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder.filter(|folder| !folder.is_dir()) {
        Some(folder) => {
            refuse(format!("there is no folder {}. Create it, or name another place", folder.display()))
        }
        None => Ok(()),
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn count(n: usize) -> f64 {
    n as f64
}
