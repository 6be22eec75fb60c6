//! OpenFOAM case folders: times, gas fields, clouds; whole or decomposed.
//!
//! Text and binary, packed or not, also mixed. Positions as coordinates in space or barycentric. Does not read
//! collated cases (`processorsN`). All seen with v1912.

mod foam_file;
mod mesh;

use super::super::field::{CfdSpray, GasCell, Parcel};
use super::error::{Place, SceneError};
use super::shape::Box3;
use super::{ImportOptions, Made, gas_law, names};
use foam_file::{FoamFile, Spot, Values};
use mesh::Mesh;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// True if a folder looks like a case.
pub(super) fn is_case(folder: &Path) -> bool {
    folder.join("constant/polyMesh").is_dir() || folder.join("processor0").is_dir()
}

/// True if a folder is a collated case.
pub(super) fn is_collated(folder: &Path) -> bool {
    names(folder).is_ok_and(|n| {
        n.iter().any(|n| {
            n.strip_prefix("processors").is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
        })
    })
}

/// Times with gas or a cloud, ascending: value in seconds and folder name.
pub(super) fn times(case: &Path) -> Result<Vec<(f64, String)>, SceneError> {
    let mut found = BTreeMap::new();
    for part in parts(case)? {
        for name in names(&part)? {
            let folder = part.join(&name);
            let Some(value) = name.parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0) else {
                continue;
            };
            if foam_file::find(&folder, "T").is_some() || folder.join("lagrangian").is_dir() {
                found.insert(name, value);
            }
        }
    }
    let mut times: Vec<_> = found.into_iter().map(|(name, value)| (value, name)).collect();
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(times)
}

/// Reads one time.
pub(super) fn read(
    case: &Path,
    time: &(f64, String),
    options: &ImportOptions,
) -> Result<CfdSpray, SceneError> {
    let folders = parts(case)?;
    let meshes: Vec<Mesh> = folders
        .par_iter()
        .map(|part| mesh_of(part, &time.1).and_then(|(mesh, points)| Mesh::read(&mesh, &points)))
        .collect::<Result<_, _>>()?;
    let chosen: Vec<PathBuf> = folders.iter().map(|f| f.join(&time.1)).collect();
    let fuel = fuel_name(case, &chosen, options)?;
    let mut made = Made { time_s: time.0, fuel: fuel.clone().unwrap_or_default(), ..Made::default() };
    let mixture = match &fuel {
        Some(name) => Some(options.mixture(case, name)?),
        None => None,
    };
    let pieces: Vec<Piece> = (0..folders.len())
        .into_par_iter()
        .map(|i| {
            let gas = || match (&fuel, mixture) {
                (Some(name), Some(mixture)) => gas_cells(&chosen[i], &meshes[i], name, mixture).map(Some),
                _ => Ok(None),
            };
            let (cells, cloud) = rayon::join(gas, || clouds(&chosen[i], i, &meshes));
            Ok(Piece { cells: cells?, cloud: cloud? })
        })
        .collect::<Result<_, SceneError>>()?;
    for piece in pieces {
        if let Some((cells, shaped)) = piece.cells {
            made.cells.get_or_insert_default().extend(cells);
            made.shaped_cells += shaped;
        }
        if let Some(cloud) = piece.cloud {
            made.parcels.get_or_insert_default().extend(cloud.parcels);
            let keeps_density = made.liquid_density_kg_m3.is_some() || !made.density_missing;
            match cloud.density {
                Some(density) if keeps_density => {
                    made.liquid_density_kg_m3.get_or_insert_default().extend(density)
                }
                _ => made.density_missing = true,
            }
        }
    }
    // A time without any cloud is a time before injection, not a form without liquid.
    made.parcels.get_or_insert_default();
    if made.parcels.as_ref().is_some_and(Vec::is_empty) {
        made.liquid_density_kg_m3.get_or_insert_default();
    }
    made.finish(case, options)
}

struct Piece {
    cells: Option<(Vec<GasCell>, usize)>,
    cloud: Option<Cloud>,
}

struct Cloud {
    parcels: Vec<Parcel>,
    density: Option<Vec<f64>>,
}

/// The case itself, or its processor folders in the order of their numbers.
fn parts(case: &Path) -> Result<Vec<PathBuf>, SceneError> {
    if !case.join("processor0").is_dir() {
        return Ok(vec![case.to_owned()]);
    }
    let mut numbered: Vec<(usize, PathBuf)> = names(case)?
        .iter()
        .filter_map(|n| Some((n.strip_prefix("processor")?.parse().ok()?, case.join(n))))
        .collect();
    numbered.sort();
    for (expected, (number, _)) in numbered.iter().enumerate() {
        if *number != expected {
            let folder = case.join(format!("processor{expected}"));
            return Err(SceneError::missing(
                &folder,
                "this folder",
                "Copy all processor folders of the case",
            ));
        }
    }
    // A reconstructed case keeps its processor folders; then the whole mesh is the better source.
    let whole = foam_file::find(&case.join("constant/polyMesh"), "faces").is_some();
    let has_times = || {
        names(case)
            .is_ok_and(|n| n.iter().any(|n| n.parse::<f64>().is_ok_and(|t| t > 0.0) && case.join(n).is_dir()))
    };
    if whole && has_times() {
        return Ok(vec![case.to_owned()]);
    }
    Ok(numbered.into_iter().map(|n| n.1).collect())
}

/// Folders of the mesh's topology and of its points at a time; a moving mesh has new ones in the time folder.
fn mesh_of(part: &Path, time: &str) -> Result<(PathBuf, PathBuf), SceneError> {
    let constant = part.join("constant/polyMesh");
    let moved = part.join(time).join("polyMesh");
    let mesh = if foam_file::find(&moved, "faces").is_some() { moved.clone() } else { constant.clone() };
    let points = if foam_file::find(&moved, "points").is_some() { moved } else { mesh.clone() };
    Ok((mesh, points))
}

/// Name of the fuel's field; `None` if no part has gas at this time.
fn fuel_name(case: &Path, times: &[PathBuf], options: &ImportOptions) -> Result<Option<String>, SceneError> {
    let Some(folder) = times.iter().find(|f| foam_file::find(f, "T").is_some()) else { return Ok(None) };
    if let Some(name) = &options.fuel {
        return Ok(Some(name.clone()));
    }
    let fields: Vec<String> = names(folder)?
        .iter()
        .filter(|n| folder.join(n).is_file())
        .map(|n| n.strip_suffix(".gz").unwrap_or(n).to_owned())
        .collect();
    gas_law::find_fuel(&fields).map(Some).map_err(|why| {
        SceneError::missing(
            case,
            format!("the fuel's mass fraction in {}", folder.display()),
            format!("It has {why}"),
        )
    })
}

fn gas_cells(
    time: &Path,
    mesh: &Mesh,
    fuel: &str,
    mixture: gas_law::Mixture,
) -> Result<(Vec<GasCell>, usize), SceneError> {
    let field = |name: &str| -> Result<Option<Vec<f64>>, SceneError> {
        let Some(file) = FoamFile::find(time, name)? else { return Ok(None) };
        match file.internal_field()? {
            Values::Uniform(value) => Ok(Some(vec![value; mesh.cells()])),
            Values::Each(values) if values.len() == mesh.cells() => Ok(Some(values)),
            Values::Each(values) => {
                Err(SceneError::length(file.path(), "values of the cells", mesh.cells(), values.len()))
            }
        }
    };
    let ((temperature, fraction), (density, pressure)) = rayon::join(
        || rayon::join(|| field("T"), || field(fuel)),
        || rayon::join(|| field("rho"), || field("p")),
    );
    let need = |values: Option<Vec<f64>>, name: &str| {
        values.ok_or_else(|| SceneError::missing(&time.join(name), "this field", "Write it with the others"))
    };
    let temperature = need(temperature?, "T")?;
    let fraction = need(fraction?, fuel)?;
    let (density, pressure) = (density?, pressure?);
    if density.is_none() && pressure.is_none() {
        return Err(SceneError::missing(&time.join("rho"), "this field, and p too", "Write one of them"));
    }
    let mut shaped = 0;
    let cells = (0..mesh.cells())
        .map(|i| {
            let (stood, is_shaped) = mesh.cell_box(i).stand_in(mesh.volume_m3(i), mesh.centre_m(i));
            shaped += usize::from(is_shaped);
            let Box3 { lower, upper } = stood;
            let known = |values: &Option<Vec<f64>>| values.as_ref().map(|v| v[i]);
            super::gas_cell(
                [lower, upper],
                temperature[i],
                known(&pressure),
                known(&density),
                fraction[i],
                mixture,
            )
        })
        .collect();
    Ok((cells, shaped))
}

/// All clouds of one part; `None` where the part has none (a processor without parcels writes no folder).
fn clouds(time: &Path, part: usize, meshes: &[Mesh]) -> Result<Option<Cloud>, SceneError> {
    let lagrangian = time.join("lagrangian");
    if !lagrangian.is_dir() {
        return Ok(None);
    }
    let mut all: Option<Cloud> = None;
    for name in names(&lagrangian)? {
        let folder = lagrangian.join(&name);
        let places = match FoamFile::find(&folder, "positions")? {
            Some(file) => Some(file),
            None => FoamFile::find(&folder, "coordinates")?,
        };
        let Some(places) = places else { continue };
        let one = cloud(&folder, &places, part, meshes)?;
        match &mut all {
            None => all = Some(one),
            Some(sum) => {
                sum.parcels.extend(one.parcels);
                sum.density = sum.density.take().zip(one.density).map(|(mut a, b)| {
                    a.extend(b);
                    a
                });
            }
        }
    }
    Ok(all)
}

fn cloud(folder: &Path, places: &FoamFile, part: usize, meshes: &[Mesh]) -> Result<Cloud, SceneError> {
    let spots = places.spots()?;
    let list = |name: &str| -> Result<Option<Vec<f64>>, SceneError> {
        let Some(file) = FoamFile::find(folder, name)? else { return Ok(None) };
        file.scalars(spots.len()).map(Some)
    };
    let need = |name: &str| {
        list(name)?
            .ok_or_else(|| SceneError::missing(&folder.join(name), "this list", "Write it with the others"))
    };
    let (diameter, temperature, droplets) = (need("d")?, need("T")?, need("nParticle")?);
    let density = list("rho")?;
    let beyond = beyond(part, meshes);
    let mut parcels = Vec::with_capacity(spots.len());
    for (i, spot) in spots.iter().enumerate() {
        let position_m = match *spot {
            Spot::Cartesian(position) => position,
            Spot::Barycentric { weights, cell, face, tet_point } => meshes[part]
                .position_m(weights, [cell, face, tet_point], &|face| beyond.get(&face).copied())
                .ok_or_else(|| {
                    let found = format!("cell {cell}, face {face}, point {tet_point} of parcel {i}");
                    SceneError::malformed(places.path(), Place::Whole, "numbers that fit the mesh", found)
                })?,
        };
        parcels.push(Parcel {
            position_m,
            diameter_m: diameter[i],
            temperature_k: temperature[i],
            droplets: droplets[i],
        });
    }
    Ok(Cloud { parcels, density })
}

/// For each face of a part that lies on a seam: the cell centre across, and whether this side decides.
fn beyond(part: usize, meshes: &[Mesh]) -> BTreeMap<usize, ([f64; 3], bool)> {
    let mut across = BTreeMap::new();
    for seam in &meshes[part].seams {
        let partner = meshes.get(seam.there).and_then(|mesh| {
            let twin = mesh.seams.iter().find(|s| s.there == seam.here && s.faces == seam.faces)?;
            Some(mesh.seam_centres(twin))
        });
        for (i, centre) in partner.unwrap_or_default().into_iter().enumerate() {
            across.insert(seam.first_face + i, (centre, seam.here < seam.there));
        }
    }
    across
}
