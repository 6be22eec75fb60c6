//! OpenFOAM case folders: times, gas fields, clouds; whole or decomposed.
//!
//! Text and binary, packed or not, also mixed. Positions as coordinates in space or barycentric. Processors each in a
//! folder of their own, or together in `processorsN` (or several `processorsN_A-B`). All seen with v1912 but the last,
//! which follow OpenFOAM's sources.

mod foam_file;
mod mesh;

use super::super::field::{CfdSpray, GasCell, Parcel};
use super::error::{Place, SceneError};
use super::shape::Box3;
use super::{ImportOptions, Made, gas_law, names};
use foam_file::{FoamFile, Folder, Spot, Values};
use mesh::Mesh;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// True if a folder looks like a case.
pub(super) fn is_case(folder: &Path) -> bool {
    folder.join("constant/polyMesh").is_dir()
        || folder.join("processor0").is_dir()
        || collated(folder).is_ok_and(|parts| !parts.is_empty())
}

/// Times with gas or a cloud, ascending: value in seconds and folder name.
pub(super) fn times(case: &Path) -> Result<Vec<(f64, String)>, SceneError> {
    let mut found = BTreeMap::new();
    for part in parts(case)? {
        for name in names(&part.path)? {
            let folder = part.join(&name);
            let Some(value) = name.parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0) else {
                continue;
            };
            if folder.file("T").is_some() || folder.path.join("lagrangian").is_dir() {
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
        .map(|part| {
            let (mesh, points) = mesh_of(part, &time.1);
            Mesh::read(&mesh, &points)
        })
        .collect::<Result<_, _>>()?;
    let chosen: Vec<Folder> = folders.iter().map(|f| f.join(&time.1)).collect();
    let mut made = Made { time_s: time.0, ..Made::default() };
    let clouds_wanted = cloud_names(&chosen, &mut made.notes)?;
    let fuel = fuel_name(case, &chosen, &clouds_wanted, options, &mut made.notes)?;
    made.fuel = fuel.clone().unwrap_or_default();
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
            let (cells, cloud) = rayon::join(gas, || clouds(&chosen[i], &clouds_wanted, i, &meshes));
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

/// The case itself, or its parts in the order of the processors.
fn parts(case: &Path) -> Result<Vec<Folder>, SceneError> {
    let whole = Folder { path: case.to_owned(), block: 0 };
    let mut numbered: Vec<(usize, Folder)> = names(case)?
        .iter()
        .filter_map(|n| {
            let number = n.strip_prefix("processor")?.parse().ok()?;
            Some((number, Folder { path: case.join(n), block: 0 }))
        })
        .filter(|(_, folder)| folder.path.is_dir())
        .collect();
    let mut together = collated(case)?;
    // Some programs leave empty single folders beside the common one.
    let has_mesh = |parts: &[(usize, Folder)]| {
        parts.iter().any(|(_, folder)| folder.join("constant/polyMesh").file("faces").is_some())
    };
    if numbered.is_empty() || (!has_mesh(&numbered) && has_mesh(&together)) {
        numbered = std::mem::take(&mut together);
    }
    if numbered.is_empty() {
        return Ok(vec![whole]);
    }
    numbered.sort_by_key(|(number, _)| *number);
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
    let has_times = || {
        names(case)
            .is_ok_and(|n| n.iter().any(|n| n.parse::<f64>().is_ok_and(|t| t > 0.0) && case.join(n).is_dir()))
    };
    if whole.join("constant/polyMesh").file("faces").is_some() && has_times() {
        return Ok(vec![whole]);
    }
    Ok(numbered.into_iter().map(|n| n.1).collect())
}

/// Most processors that a folder's name is believed to stand for.
const PROCESSORS_MAX: usize = 1 << 16;

/// The parts of `processorsN` or of all `processorsN_A-B`, with the processors' numbers.
fn collated(case: &Path) -> Result<Vec<(usize, Folder)>, SceneError> {
    let mut parts = Vec::new();
    for name in names(case)? {
        let Some(rest) = name.strip_prefix("processors") else { continue };
        let (count, range) = rest.split_once('_').map_or((rest, None), |(count, range)| (count, Some(range)));
        let Some(count) = count.parse::<usize>().ok().filter(|n| (1..=PROCESSORS_MAX).contains(n)) else {
            continue;
        };
        let ends = match range {
            None => Some((0, count - 1)),
            Some(range) => range.split_once('-').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?))),
        };
        let Some((first, last)) = ends.filter(|(first, last)| first <= last && *last < count) else {
            continue;
        };
        let path = case.join(&name);
        parts.extend(
            (first..=last).map(|number| (number, Folder { path: path.clone(), block: number - first })),
        );
    }
    Ok(parts)
}

/// Folders of the mesh's topology and of its points at a time; a moving mesh has new ones in the time folder.
fn mesh_of(part: &Folder, time: &str) -> (Folder, Folder) {
    let moved = part.join(time).join("polyMesh");
    let mesh =
        if moved.file("faces").is_some() { moved.clone() } else { part.join("constant").join("polyMesh") };
    let points = if moved.file("points").is_some() { moved } else { mesh.clone() };
    (mesh, points)
}

/// What a parcel must have.
const NEEDED: [&str; 3] = ["d", "T", "nParticle"];

/// Names of the clouds of droplets at a time, over all parts.
///
/// A cloud that nowhere has one of the lists that droplets must have is one of something else; it is passed over and
/// said so, if there is another.
fn cloud_names(times: &[Folder], notes: &mut Vec<String>) -> Result<Vec<String>, SceneError> {
    let mut lists: BTreeMap<String, [bool; 3]> = BTreeMap::new();
    for time in times {
        let lagrangian = time.join("lagrangian");
        if !lagrangian.path.is_dir() {
            continue;
        }
        for name in names(&lagrangian.path)? {
            let folder = lagrangian.join(&name);
            if folder.file("positions").or_else(|| folder.file("coordinates")).is_some() {
                let has = lists.entry(name).or_default();
                for (has, list) in has.iter_mut().zip(NEEDED) {
                    *has |= folder.file(list).is_some();
                }
            }
        }
    }
    if lists.values().any(|has| has.iter().all(|h| *h)) {
        lists.retain(|name, has| {
            let missing: Vec<&str> =
                NEEDED.into_iter().zip(*has).filter(|(_, has)| !has).map(|l| l.0).collect();
            if !missing.is_empty() {
                notes.push(format!("cloud {name} is not read: it has no {}", missing.join(", ")));
            }
            missing.is_empty()
        });
    }
    if lists.len() > 1 {
        let all = lists.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        notes.push(format!("several clouds are read as one spray: {all}"));
    }
    Ok(lists.into_keys().collect())
}

/// Name of the fuel's field; `None` if no part has gas at this time.
fn fuel_name(
    case: &Path,
    times: &[Folder],
    clouds: &[String],
    options: &ImportOptions,
    notes: &mut Vec<String>,
) -> Result<Option<String>, SceneError> {
    let Some(folder) = times.iter().find(|f| f.file("T").is_some()) else { return Ok(None) };
    if let Some(name) = &options.fuel {
        return Ok(Some(name.clone()));
    }
    let plain = |folder: &Path| -> Result<Vec<String>, SceneError> {
        let files = names(folder)?.into_iter().filter(|n| folder.join(n).is_file());
        Ok(files.map(|n| n.strip_suffix(".gz").map_or(n.clone(), str::to_owned)).collect())
    };
    let fields = plain(&folder.path)?;
    // What the droplets are made of: their list Y…(l).
    let mut liquids = Vec::new();
    for time in times {
        for cloud in clouds {
            let folder = time.path.join("lagrangian").join(cloud);
            if folder.is_dir() {
                liquids.extend(plain(&folder)?.iter().filter_map(|n| {
                    n.strip_prefix('Y').and_then(|n| n.strip_suffix("(l)")).map(str::to_owned)
                }));
            }
        }
    }
    let found = gas_law::find_fuel(&fields, &liquids).map_err(|why| {
        SceneError::missing(
            case,
            format!("the fuel's mass fraction in {}", folder.path.display()),
            format!("It has {why}"),
        )
    })?;
    notes.extend(found.note);
    Ok(Some(found.name))
}

fn gas_cells(
    time: &Folder,
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
        values.ok_or_else(|| {
            SceneError::missing(&time.path.join(name), "this field", "Write it with the others")
        })
    };
    let temperature = need(temperature?, "T")?;
    let fraction = need(fraction?, fuel)?;
    let (density, pressure) = (density?, pressure?);
    if density.is_none() && pressure.is_none() {
        return Err(SceneError::missing(
            &time.path.join("rho"),
            "this field, and p too",
            "Write one of them",
        ));
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
fn clouds(
    time: &Folder,
    names: &[String],
    part: usize,
    meshes: &[Mesh],
) -> Result<Option<Cloud>, SceneError> {
    let mut all: Option<Cloud> = None;
    for name in names {
        let folder = time.join("lagrangian").join(name);
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

fn cloud(folder: &Folder, places: &FoamFile, part: usize, meshes: &[Mesh]) -> Result<Cloud, SceneError> {
    let spots = places.spots()?;
    let list = |name: &str| -> Result<Option<Vec<f64>>, SceneError> {
        let Some(file) = FoamFile::find(folder, name)? else { return Ok(None) };
        file.scalars(spots.len()).map(Some)
    };
    let need = |name: &str| {
        list(name)?.ok_or_else(|| {
            SceneError::missing(&folder.path.join(name), "this list", "Write it with the others")
        })
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
