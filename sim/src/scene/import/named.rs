//! Arrays with names, as most forms have them, made into parcels and gas cells.

use super::super::field::{GasCell, Parcel};
use super::error::SceneError;
use super::gas_law;
use super::shape::Box3;
use super::{ImportOptions, Made};
use std::collections::BTreeMap;
use std::path::Path;

/// Arrays of scalars by name.
pub(super) type Arrays = BTreeMap<String, Vec<f64>>;

/// Names under which codes write a quantity; compared without case.
const DIAMETER: &[&str] = &["d", "diameter", "drop_diameter", "droplet_diameter", "particle_diameter"];
const DROPLETS: &[&str] =
    &["nparticle", "droplets", "number", "n", "num_drop", "number_in_parcel", "number_of_droplets"];
const PARCEL_MASS: &[&str] = &["mass", "parcel_mass", "m"];
const TEMPERATURE: &[&str] = &["t", "temp", "temperature", "static_temperature", "drop_temperature"];
const PRESSURE: &[&str] = &["p", "pressure", "static_pressure", "absolute_pressure"];
const DENSITY: &[&str] = &["rho", "density", "drop_density"];
const FRACTION: &[&str] = &["y", "mass_fraction", "fuel_mass_fraction", "y_fuel"];

/// True if a parcel's quantity of this name can be of use; the others need not be read.
pub(super) fn is_parcel_quantity(name: &str) -> bool {
    [DIAMETER, DROPLETS, PARCEL_MASS, TEMPERATURE, DENSITY]
        .concat()
        .iter()
        .any(|n| name.eq_ignore_ascii_case(n))
}

/// True if the arrays are those of a cloud: they have a droplet's diameter.
pub(super) fn is_cloud(arrays: &Arrays) -> bool {
    find(arrays, DIAMETER).is_some()
}

/// Adds parcels; diameter, temperature and number (or the parcel's mass and density) must be there.
pub(super) fn add_parcels(
    made: &mut Made,
    file: &Path,
    positions: &[[f64; 3]],
    arrays: &Arrays,
) -> Result<(), SceneError> {
    let list = |names: &[&str]| checked(file, arrays, names, positions.len());
    let need = |names: &[&str], what: &str| {
        list(names)?.ok_or_else(|| {
            let present = arrays.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            SceneError::missing(
                file,
                format!("the parcels' {what} ({})", names.join(", ")),
                format!("It has: {present}"),
            )
        })
    };
    let diameter = need(DIAMETER, "diameter")?;
    let temperature = need(TEMPERATURE, "temperature")?;
    let density = list(DENSITY)?;
    let droplets: Vec<f64> = match (list(DROPLETS)?, list(PARCEL_MASS)?, density) {
        (Some(number), _, _) => number.to_vec(),
        (None, Some(mass), Some(rho)) => (0..positions.len())
            .map(|i| mass[i] / (rho[i] * std::f64::consts::PI / 6.0 * diameter[i].powi(3)))
            .collect(),
        _ => need(DROPLETS, "number of droplets (or mass and density)")?.to_vec(),
    };
    let before = made.parcels.as_ref().map_or(0, Vec::len);
    made.parcels.get_or_insert_default().extend(positions.iter().enumerate().map(|(i, &position_m)| {
        Parcel { position_m, diameter_m: diameter[i], temperature_k: temperature[i], droplets: droplets[i] }
    }));
    match density {
        Some(rho) if before == 0 || made.liquid_density_kg_m3.is_some() => {
            made.liquid_density_kg_m3.get_or_insert_default().extend(rho);
        }
        _ => made.density_missing |= !positions.is_empty(),
    }
    Ok(())
}

/// Adds gas cells: boxes with, per cell, true if it is no box.
pub(super) fn add_cells(
    made: &mut Made,
    file: &Path,
    boxes: &[(Box3, bool)],
    arrays: &Arrays,
    options: &ImportOptions,
) -> Result<(), SceneError> {
    let names: Vec<String> = arrays.keys().cloned().collect();
    let fuel = match &options.fuel {
        Some(name) => name.clone(),
        None => match names.iter().find(|n| FRACTION.contains(&n.to_ascii_lowercase().as_str())) {
            Some(name) => name.clone(),
            None => {
                let found = gas_law::find_fuel(&names, &made.liquids).map_err(|why| {
                    SceneError::missing(file, "the fuel's mass fraction", format!("It has {why}"))
                })?;
                made.notes.extend(found.note);
                found.name
            }
        },
    };
    let mixture = options.mixture(file, &fuel)?;
    let list = |names: &[&str]| checked(file, arrays, names, boxes.len());
    let missing = |what: &str| {
        SceneError::missing(file, format!("the gas's {what}"), format!("It has: {}", names.join(", ")))
    };
    let temperature = list(TEMPERATURE)?.ok_or_else(|| missing("temperature (T)"))?;
    let fraction = list(&[fuel.as_str()])?.ok_or_else(|| missing(&format!("mass fraction of {fuel}")))?;
    let (pressure, density) = (list(PRESSURE)?, list(DENSITY)?);
    if pressure.is_none() && density.is_none() {
        return Err(missing("pressure (p) or density (rho)"));
    }
    let cells = made.cells.get_or_insert_default();
    for (i, (cell, shaped)) in boxes.iter().enumerate() {
        made.shaped_cells += usize::from(*shaped);
        let gas: GasCell = super::gas_cell(
            [cell.lower, cell.upper],
            temperature[i],
            pressure.map(|p| p[i]),
            density.map(|rho| rho[i]),
            fraction[i],
            mixture,
        );
        cells.push(gas);
    }
    made.fuel = fuel;
    Ok(())
}

fn find<'a>(arrays: &'a Arrays, names: &[&str]) -> Option<(&'a String, &'a Vec<f64>)> {
    names.iter().find_map(|name| arrays.iter().find(|(key, _)| key.eq_ignore_ascii_case(name)))
}

fn checked<'a>(
    file: &Path,
    arrays: &'a Arrays,
    names: &[&str],
    count: usize,
) -> Result<Option<&'a [f64]>, SceneError> {
    match find(arrays, names) {
        Some((name, values)) if values.len() != count => {
            Err(SceneError::length(file, format!("values of {name:?}"), count, values.len()))
        }
        found => Ok(found.map(|(_, values)| values.as_slice())),
    }
}
