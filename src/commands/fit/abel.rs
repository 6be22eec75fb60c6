//! A fitted map turned into the medium behind it: `abel.npz` beside `dit.npz`.
//!
//! Only when asked for: it takes the spray to be round about a vertical axis, and the map stays as it is.

use super::super::CommandError;
use super::super::abel::{How, MethodName, arrays, mark_opaque, readable, write};
use super::fitted::Fitted;
use crate::estimate::abel::{Columns, Strength, emission, flag, invert};
use crate::estimate::calibration::SakumaHattori;
use crate::files::npy::{Array, Values};
use std::path::{Path, PathBuf};

/// How to invert a map.
#[derive(Debug, clap::Args)]
pub(super) struct AbelArgs {
    /// Also invert the map about a vertical axis, into OUT/abel.npz: absorption and temperature at every radius
    #[arg(long, value_enum, value_name = "METHOD")]
    abel: Option<MethodName>,
    /// Size of a pixel in the plane of the axis, m
    #[arg(long, value_name = "P", default_value_t = 1.0, requires = "abel")]
    abel_pixel_m: f64,
    /// The axis in columns from the middle of the first one; found if not given
    #[arg(long, value_name = "C", requires = "abel")]
    abel_centre: Option<f64>,
    /// How strongly to regularise, as in `ditd abel`
    #[arg(long, value_name = "HOW", default_value = "auto", requires = "abel", value_parser = super::super::abel::strength)]
    abel_strength: Strength,
    /// Daun's method without negative values
    #[arg(long, requires = "abel")]
    abel_non_negative: bool,
    /// Degree of the elements of Daun's method, 0 … 3, as in `ditd abel`
    #[arg(long, requires = "abel", value_name = "DEGREE", value_parser = clap::value_parser!(u8).range(0..=3))]
    abel_degree: Option<u8>,
    /// Columns of a row count by 1/σ² in a fit of its own, as in `ditd abel`
    #[arg(long, requires = "abel")]
    abel_weighted: bool,
    /// Curve of growth of the absorber in the band, as in `ditd abel`; without it the medium counts as gray
    #[arg(long, value_name = "FILE.csv", requires = "abel")]
    abel_growth: Option<PathBuf>,
}

/// Emissivities below this many standard deviations shine too little to tell a temperature.
const FAINT_SIGMAS: f64 = 3.0;

/// Inverts the map in `out` if asked to; returns what to print.
///
/// # Errors
///
/// Status 2 for settings that make no sense, 1 when files cannot be read or written.
pub(super) fn inverted(args: &AbelArgs, out: &Path) -> Result<String, CommandError> {
    let Some(method) = args.abel else { return Ok(String::new()) };
    let how = How {
        pixel_m: args.abel_pixel_m,
        centre: args.abel_centre,
        strength: args.abel_strength,
        non_negative: args.abel_non_negative,
        degree: args.abel_degree,
        weighted: args.abel_weighted,
        growth: args.abel_growth.clone(),
    };
    let settings = how.settings(method)?;
    let growth = how.growth()?;
    let map = Fitted::read(out)?;
    let (rows, columns) = (map.rows, map.columns);
    let emissivity = map.plane("emissivity")?;
    let sigma = map.plane("sigma_emissivity")?;
    let depths = growth.depths(emissivity, Some(sigma));
    let wrong = |error| CommandError::usage(format!("fit: --abel: {error}."));
    // A line of two levels or of equal weights may have no σ: the halves tell then.
    let known = sigma.iter().any(|s| s.is_finite());
    let seen =
        Columns { values: &depths.depth, sigmas: known.then_some(depths.sigma.as_slice()), rows, columns };
    let mut found = invert(&seen, &settings).map_err(wrong)?;
    mark_opaque(&mut found, &depths.opaque);
    let (light, sigma_light) = light(&map, &map.curve)?;
    let light = Columns { values: &light, sigmas: Some(&sigma_light), rows, columns };
    let sources = emission::sources(&light, &found, settings.pixel_m).map_err(wrong)?;
    let plane = |values: Vec<f64>| Array { shape: vec![rows, columns], values: Values::F64(values) };
    let kelvin: Vec<f64> = sources.source.iter().map(|&counts| map.curve.inverse(counts)).collect();
    let sigma_kelvin: Vec<f64> = kelvin
        .iter()
        .zip(&sources.sigma_source)
        .map(|(&kelvin, sigma)| sigma / map.curve.derivative(kelvin))
        .collect();
    let warm = kelvin.iter().filter(|kelvin| kelvin.is_finite()).count();
    let mut all = arrays(&found);
    all.extend([
        ("column", plane(depths.depth)),
        ("sigma_column", plane(depths.sigma)),
        ("temperature_k", plane(kelvin)),
        ("sigma_temperature_k", plane(sigma_kelvin)),
    ]);
    write(&out.join("abel.npz"), &all)?;
    let opaque = found.flags.iter().filter(|&&flags| flags & flag::OPAQUE != 0).count();
    let note = if opaque > 0 { format!("; {opaque} pixels too dense for a column") } else { String::new() };
    Ok(format!(
        "abel      {}          abel.npz: a temperature at {warm} pixels{note}\n",
        readable(&found, &settings)
    ))
}

/// Light that the medium sends, ε·I_cal(T_eff) in counts, and its σ. Where ε is too small for a temperature the light is
/// nearly none: it is taken to be of the median temperature.
fn light(map: &Fitted, curve: &SakumaHattori) -> Result<(Vec<f64>, Vec<f64>), CommandError> {
    let (emissivity, sigma) = (map.plane("emissivity")?, map.plane("sigma_emissivity")?);
    let (kelvin, sigma_k) = (map.plane("temperature_k")?, map.plane("sigma_temperature_k")?);
    let mut known: Vec<f64> = (0..kelvin.len())
        .filter(|&i| emissivity[i] > FAINT_SIGMAS * sigma[i] && kelvin[i].is_finite())
        .map(|i| kelvin[i])
        .collect();
    known.sort_unstable_by(f64::total_cmp);
    let usual = known.get(known.len() / 2).map_or(f64::NAN, |&kelvin| curve.value(kelvin));
    let each = (0..kelvin.len()).map(|i| {
        let (e, s) = (emissivity[i], sigma[i]);
        if e < FAINT_SIGMAS * s {
            return (e * usual, s * usual);
        }
        let (counts, slope) = (curve.value(kelvin[i]), curve.derivative(kelvin[i]));
        (e * counts, (counts * s).hypot(e * slope * sigma_k[i]))
    });
    Ok(each.unzip())
}
