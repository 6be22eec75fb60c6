//! The walls' light taken out of a fitted map, if its share is given: `object.npz` beside `dit.npz`.
//!
//! Never done unless asked for, and the map itself stays as it is.

use super::super::CommandError;
use super::fitted::curve;
use crate::estimate::walls::{Corrected, WallLight, corrected};
use crate::files::npy::{Array, Values};
use crate::files::npz::{self, Packing};
use crate::files::{self, image, result};
use std::path::{Path, PathBuf};

/// What is known of the walls' light.
#[derive(Debug, clap::Args)]
pub(super) struct WallArgs {
    /// Share w = a_walls/(1 − a_plate) of the walls' light: a number, or a picture of `ditd render` (a_walls, a_plate) of the map's size
    #[arg(long, value_name = "W|FILE.exr", requires = "wall_temperature")]
    wall_share: Option<String>,
    /// Standard deviation of the share
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0, requires = "wall_share")]
    wall_share_sigma: f64,
    /// The share is a bare albedo, an upper bound: labelled so
    #[arg(long, requires = "wall_share")]
    wall_share_is_bound: bool,
    /// Temperature of the walls, K
    #[arg(long, value_name = "K", requires = "wall_share")]
    wall_temperature: Option<f64>,
    /// Its standard deviation, K
    #[arg(long, value_name = "K", default_value_t = 0.0, requires = "wall_share")]
    wall_temperature_sigma: f64,
}

/// Corrects the map in `out` if a share was given; returns what to print.
///
/// # Errors
///
/// Status 2 when the share cannot be used, 1 when files cannot be read or written.
pub(super) fn correct(args: &WallArgs, out: &Path) -> Result<String, CommandError> {
    let (Some(share), Some(wall_k)) = (&args.wall_share, args.wall_temperature) else {
        return Ok(String::new());
    };
    let usage = |why: String| CommandError::usage(format!("fit: --wall-share {share}: {why}"));
    let failed = |why: String| CommandError::failure(format!("fit: {why}"));
    let sane = wall_k > 0.0 && args.wall_share_sigma >= 0.0 && args.wall_temperature_sigma >= 0.0;
    if !(sane && wall_k.is_finite()) {
        return Err(usage("temperatures must be positive, standard deviations not negative".into()));
    }
    let arrays = result::read_npz(&out.join("dit.npz")).map_err(|error| failed(error.to_string()))?;
    let plane = |name: &str| -> Result<(Vec<usize>, Vec<f64>), CommandError> {
        let found = arrays.iter().find(|(found, _)| found == name);
        let (_, array) = found.ok_or_else(|| failed(format!("dit.npz has no {name}")))?;
        Ok((array.shape.clone(), array.to_f64()))
    };
    let (shape, seen_k) = plane("temperature_k")?;
    let (_, sigma_k) = plane("sigma_temperature_k")?;
    let shares = match share.parse::<f64>() {
        Ok(w) if (0.0..1.0).contains(&w) => vec![w; seen_k.len()],
        Ok(w) => return Err(usage(format!("{w} is not from 0 to below 1"))),
        Err(_) => picture(&PathBuf::from(share), &shape).map_err(usage)?,
    };
    let light = WallLight {
        sigma_share: vec![args.wall_share_sigma; shares.len()],
        share: shares,
        wall_k,
        sigma_wall_k: args.wall_temperature_sigma,
        upper_bound: args.wall_share_is_bound,
    };
    let found = corrected(&seen_k, &sigma_k, &curve(out).map_err(failed)?, &light);
    write(out, &shape, &found, &light).map_err(failed)?;
    Ok(words(&seen_k, &found))
}

/// w per pixel from the coefficients of a rendered picture.
fn picture(path: &Path, shape: &[usize]) -> Result<Vec<f64>, String> {
    let picture = image::read_exr(path).map_err(|error| error.to_string())?;
    if shape != [picture.rows, picture.columns] {
        return Err(format!("{} x {} pixels where the map has {shape:?}", picture.rows, picture.columns));
    }
    let channel = |name: &str| {
        let found = picture.channels.iter().find(|(found, _)| found == name);
        found.map(|(_, values)| values).ok_or_else(|| format!("no channel {name}"))
    };
    let (walls, plate) = (channel("a_walls")?, channel("a_plate")?);
    // Where nothing is in the sight (a_plate = 1) there is no share.
    let each = walls.iter().zip(plate);
    Ok(each.map(|(&walls, &plate)| f64::from(walls) / (1.0 - f64::from(plate))).collect())
}

fn write(out: &Path, shape: &[usize], found: &Corrected, light: &WallLight) -> Result<(), String> {
    let image = |values: &[f64]| Array { shape: shape.to_vec(), values: Values::F64(values.to_vec()) };
    let bound = u32::from(found.upper_bound);
    let arrays = [
        ("temperature_object_k", image(&found.temperature_object_k)),
        ("sigma_temperature_object_k", image(&found.sigma_temperature_object_k)),
        ("wall_share", image(&light.share)),
        ("wall_share_is_upper_bound", Array { shape: vec![1], values: Values::U32(vec![bound]) }),
    ];
    let named: Vec<(&str, &Array)> = arrays.iter().map(|(name, array)| (*name, array)).collect();
    let bytes = npz::to_bytes(&named, Packing::Stored).map_err(|error| error.to_string())?;
    files::write_atomic(&out.join("object.npz"), &bytes).map_err(|error| error.to_string())
}

fn words(seen_k: &[f64], found: &Corrected) -> String {
    let each = found.temperature_object_k.iter().zip(seen_k);
    let mut shifts: Vec<f64> = each.map(|(own, seen)| own - seen).filter(|shift| shift.is_finite()).collect();
    shifts.sort_unstable_by(f64::total_cmp);
    let Some(median) = shifts.get(shifts.len() / 2) else {
        return "walls     no pixel with a temperature and a share\n".to_owned();
    };
    let label = if found.upper_bound { "UPPER BOUND of the walls' share, " } else { "" };
    format!(
        "walls     {label}object.npz: {} pixels without the walls' light, median shift {median:+.2} K\n",
        shifts.len()
    )
}
