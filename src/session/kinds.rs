//! `ditd calibrate` beyond the curve: windows, the plate's emissivity, flat, offset, noise.
//!
//! Each kind takes its frames with the campaign's engine into a folder of its own and writes one figure into
//! `calibration.json`. Where something has to be mounted or moved the operator is asked first; a simulated rig does it
//! by itself.

use super::{
    SessionError, Setting, calibration_folder, curve_at, file_at, frames_into, store_figure, store_flat,
};
use crate::calibrate::{self, CalibrateError, Calibration, Series};
use crate::config::Config;
use crate::plan::Plan;
use crate::reduce::{CurveSums, Total};
use crate::rigs::View;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Most folders of one kind below a calibration.
const FOLDERS_MAX: u32 = 1000;

/// A figure beside the curve.
#[derive(Debug, Clone, PartialEq)]
pub enum Figure {
    /// Transmittance of the windows.
    Windows,
    /// ε_B from mirrored surroundings at the two temperatures of `[calibration] ambient_k`.
    PlateFromAmbient,
    /// ε_B from the curve of a body of known emissivity, in a folder or its `calibration.json`.
    PlateFromReference {
        /// Where its curve is.
        standard: PathBuf,
        /// Its emissivity.
        emissivity: f64,
    },
    /// Gains and broken pixels.
    Flat,
    /// Counts without light.
    Offset,
    /// Electrons per count and read noise.
    Noise,
}

/// Asks the operator to do something; an error ends the calibration.
pub type Ask<'a> = dyn Fn(&str) -> Result<(), SessionError> + 'a;

/// Acquires a figure into the calibration at `out`; returns its name in the file and what it is.
///
/// # Errors
///
/// [`SessionError`]; also when `out` holds a calibration of another set-up.
pub fn acquire_figure(
    setting: &Setting<'_>,
    out: &Path,
    figure: &Figure,
    ask: &Ask<'_>,
) -> Result<(&'static str, Value), SessionError> {
    if let Some(file) = file_at(out)? {
        file.key.check(setting.config)?;
    }
    let config = setting.config;
    let utc = setting.utc();
    match figure {
        Figure::Windows => {
            let curve = curve(setting, out, ask)?;
            ask("Mount the windows: the chamber without spray, its walls as in the campaign.")?;
            let world = through_windows(config)?;
            let folder = free(out, "window")?;
            let (series, _) =
                take(setting, &folder, &world, View::Chamber, plan(config, Plan::of_standard_curve)?, 0)?;
            store(setting, out, "windows", &calibrate::windows(&series, &curve, config, &utc)?)
        }
        Figure::PlateFromAmbient => {
            let ambient = config.calibration.as_ref().and_then(|calibration| calibration.ambient_k);
            let ambient = ambient.ok_or_else(|| {
                CalibrateError::Missing(
                    "give two temperatures of what the plate mirrors, [calibration] ambient_k = [296.0, 400.0], or the curve of a body of known emissivity, --reference DIR"
                        .to_owned(),
                )
            })?;
            let curve = curve(setting, out, ask)?;
            let mut taken = Vec::new();
            for (part, kelvin) in (1..).zip(ambient) {
                ask(&format!(
                    "Bring all that the plate mirrors to {kelvin} K: a screen around the camera's sight."
                ))?;
                let world = surrounded(config, kelvin);
                let folder = free(out, "emissivity")?;
                taken.push(
                    take(setting, &folder, &world, View::Bench, plan(config, Plan::of_coldest)?, part)?.0,
                );
            }
            let pair = [&taken[0], &taken[1]];
            store(setting, out, "plate", &calibrate::plate_from_ambient(pair, ambient, &curve, &utc)?)
        }
        Figure::PlateFromReference { standard, emissivity } => {
            let reference = curve_at(&calibration_folder(standard))?;
            let curve = curve(setting, out, ask)?;
            let plate = calibrate::plate_from_reference(&curve, &reference, *emissivity, &utc)?;
            store(setting, out, "plate", &plate)
        }
        Figure::Flat => {
            ask(BARE)?;
            let folder = free(out, "flat")?;
            let (series, sums) =
                take(setting, &folder, config, View::Bench, plan(config, Plan::of_ends)?, 3)?;
            let flat = calibrate::flat(&series, &sums, &utc);
            store_flat(out, &flat.gains, config)?;
            store(setting, out, "flat", &flat.figures)
        }
        Figure::Offset => {
            let folder = free(out, "offset")?;
            let (series, _) =
                take(setting, &folder, config, View::Bench, plan(config, Plan::of_coldest)?, 4)?;
            store(setting, out, "offset", &calibrate::offset(&series, &utc)?)
        }
        Figure::Noise => {
            ask(BARE)?;
            let folder = free(out, "noise")?;
            let plan = plan(config, Plan::of_standard_curve)?;
            let (series, sums) = take(setting, &folder, config, View::Bench, plan, 5)?;
            let gains = calibrate::flat(&series, &sums, &utc).gains;
            store(setting, out, "noise", &calibrate::noise(&sums, &gains, &utc)?)
        }
    }
}

/// What has to be for all frames of the plate alone.
pub(super) const BARE: &str = "Take chamber and windows away: the camera looks straight at the plate.";

/// The curve of `out`; without one it is acquired first.
fn curve(setting: &Setting<'_>, out: &Path, ask: &Ask<'_>) -> Result<Calibration, SessionError> {
    match file_at(out)? {
        Some(file) if file.has_curve => curve_at(out),
        _ => {
            ask(BARE)?;
            Ok(super::calibrate(setting, out)?.calibration)
        }
    }
}

fn plan(config: &Config, of: fn(&Config) -> Option<Plan>) -> Result<Plan, SessionError> {
    of(config).ok_or_else(super::no_table)
}

/// Frames of one kind into their folder. `part` keeps the simulated camera from drawing the noise of another kind again.
fn take(
    setting: &Setting<'_>,
    folder: &Path,
    world: &Config,
    view: View,
    plan: Plan,
    part: u64,
) -> Result<(Series, CurveSums), SessionError> {
    let reduced = frames_into(setting, folder, world, view, plan, part)?;
    let Total::Curve(sums) = reduced.total else {
        return Err(SessionError::Other("calibration: the record holds no calibration frames".to_owned()));
    };
    let series = calibrate::series(&sums, &reduced.levels, setting.config)?;
    Ok((series, sums))
}

fn store(
    setting: &Setting<'_>,
    out: &Path,
    name: &'static str,
    figure: &impl serde::Serialize,
) -> Result<(&'static str, Value), SessionError> {
    let value =
        serde_json::to_value(figure).map_err(|error| SessionError::Other(format!("calibration: {error}")))?;
    store_figure(setting, out, name, value.clone())?;
    Ok((name, value))
}

/// The first free folder of a name below `out`.
fn free(out: &Path, name: &str) -> Result<PathBuf, SessionError> {
    let named = |n: u32| if n == 1 { out.join(name) } else { out.join(format!("{name}-{n}")) };
    (1..=FOLDERS_MAX).map(named).find(|path| !path.exists()).ok_or_else(|| {
        SessionError::Other(format!("{}: {FOLDERS_MAX} of them lie there", out.join(name).display()))
    })
}

/// The simulated chamber without spray.
fn through_windows(config: &Config) -> Result<Config, SessionError> {
    let mut world = config.clone();
    if let Some(rig) = &mut world.rig {
        if rig.chamber.is_none() {
            return Err(CalibrateError::Missing(
                "the simulated rig has no [rig.chamber], so no windows".to_owned(),
            )
            .into());
        }
        (rig.spray, rig.fluctuation) = (None, None);
    }
    Ok(world)
}

/// The simulated laboratory at another temperature.
fn surrounded(config: &Config, ambient_k: f64) -> Config {
    let mut world = config.clone();
    if let Some(rig) = &mut world.rig {
        rig.plate_view.lab_temperature_k = ambient_k;
    }
    world
}
