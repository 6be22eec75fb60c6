//! The figures of the ray tracer, subject by subject: time and true error, as numbers and as pictures.
//!
//! The standard scene is a cube of cells with eight plumes, seen by a pinhole camera against a plate (`plumes`); images
//! are measured by pixels traced one by one (`judge`), rays by answers from elsewhere (`rays`), sprays by more parcels
//! and finer grids (`parcels`).

mod curves;
mod image;
mod judge;
mod parcels;
mod plumes;
mod rays;

use super::{Figure, Output, Watch};
use crate::commands::CommandError;
use crate::files::write_atomic;
use curves::{Findings, Page, alone, log_log};
use std::path::{Path, PathBuf};

/// Arguments of `ditd bench render`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    pub(super) output: Output,
    /// Only these subjects, separated by commas (all if not given)
    #[arg(long, value_name = "SUBJECT,…", value_delimiter = ',', num_args = 1..)]
    only: Vec<Subject>,
    /// Also draw the curves into this folder, one SVG a subject and one of error against time for all
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
    /// Also write the standard scenes into this folder, as `ditd render` and other programs read it
    #[arg(long, value_name = "DIR")]
    export: Option<PathBuf>,
}

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Subject {
    /// Image mode: time against error, targets 4e-2 to 5e-4; further frames of one operator
    Targets,
    /// Image mode, plumes that are dense all along: two targets
    Full,
    /// Image mode, emission and absorption only
    Straight,
    /// Pixels traced one by one
    Reference,
    /// Single rays through slabs and a grid
    Rays,
    /// Scenes of 32³ to 512³ cells (about 6 GiB of memory)
    Size,
    /// Optical depths of 0.1 to 80
    Depth,
    /// Albedos of 0.1 to 0.999
    Albedo,
    /// One to 32 wavelengths at once
    Bands,
    /// Sprays of 1e3 to 1e7 parcels: deposit, optics, image
    Parcels,
    /// The shipped spray: unpacking, deposit on grids of 2 to 0.25 mm
    Import,
}

/// Runs the subjects that are asked for.
///
/// # Errors
///
/// Status 1 when a scene cannot be rendered, or a file cannot be written.
pub(super) fn figures(watch: &Watch<'_>, args: &Args) -> Result<Vec<Figure>, CommandError> {
    if let Some(folder) = &args.export {
        plumes::write(folder).map_err(|e| unwritten(folder, &e.to_string()))?;
    }
    if let Some(folder) = &args.plot {
        std::fs::create_dir_all(folder).map_err(|e| unwritten(folder, &e.to_string()))?;
    }
    let standard = image::Standard::default();
    let mut figures = Vec::new();
    let mut fronts = Vec::new();
    for &subject in <Subject as clap::ValueEnum>::value_variants() {
        if !(args.only.is_empty() || args.only.contains(&subject)) {
            continue;
        }
        let found = run(watch, subject, &standard)?;
        figures.extend(found.figures);
        fronts.extend(found.fronts);
        if let Some(folder) = &args.plot {
            found.pages.iter().try_for_each(|page| draw(folder, page))?;
        }
    }
    if let (Some(folder), false) = (&args.plot, fronts.is_empty()) {
        let plot = log_log("time of a pixel or ray / s", "true rms error of the coefficients", fronts);
        let sheet = alone("error against time of every mode", plot);
        draw(folder, &Page { name: "render_front", sheet })?;
    }
    Ok(figures)
}

fn run(watch: &Watch<'_>, subject: Subject, standard: &image::Standard) -> Result<Findings, CommandError> {
    match subject {
        Subject::Targets => image::targets(watch, standard),
        Subject::Full => image::full(watch),
        Subject::Straight => image::straight(watch),
        Subject::Reference => image::reference(watch, standard),
        Subject::Rays => rays::rays(watch),
        Subject::Size => image::size(watch),
        Subject::Depth => image::depth(watch),
        Subject::Albedo => image::albedo(watch),
        Subject::Bands => image::bands(watch),
        Subject::Parcels => return parcels::parcels(watch),
        Subject::Import => return parcels::import(watch),
    }
    .map_err(|e| CommandError::failure(format!("bench render: {e}")))
}

fn draw(folder: &Path, page: &Page) -> Result<(), CommandError> {
    let path = folder.join(format!("{}.svg", page.name));
    write_atomic(&path, page.sheet.to_svg().as_bytes()).map_err(|e| unwritten(&path, &e.to_string()))
}

fn unwritten(path: &Path, why: &str) -> CommandError {
    CommandError::failure(format!("bench render: {}: {why}", path.display()))
}
