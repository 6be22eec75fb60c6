//! VTK files: which files make one time, and how they make a spray.
//!
//! XML (`.vtm`, `.vtu`, `.vtp`) and legacy (`.vtk`) unstructured grids and clouds. Gas per cell. Does not read
//! structured grids, parallel index files (`.pvtu`), or compressors other than zlib. Seen from OpenFOAM v1912's
//! `foamToVTK`, whose clouds lie in `lagrangian/NAME/NAME_INDEX.vtp` beside the mesh's file.

mod legacy;
mod xml;

use super::super::field::CfdSpray;
use super::error::{Place, SceneError};
use super::named::{self, Arrays};
use super::shape::{Box3, polyhedron, standard_faces};
use super::{ImportOptions, Made};
use std::path::{Path, PathBuf};

/// What one file holds.
#[derive(Debug, Default)]
pub(super) struct Piece {
    pub(super) time_s: Option<f64>,
    pub(super) points: Vec<[f64; 3]>,
    pub(super) cells: Vec<Cell>,
    pub(super) cell_arrays: Arrays,
    pub(super) point_arrays: Arrays,
    pub(super) is_grid: bool,
}

/// One cell; corners and faces are indices of points.
#[derive(Debug)]
pub(super) struct Cell {
    pub(super) kind: u8,
    pub(super) corners: Vec<usize>,
    /// Faces of a polyhedron (kind 42).
    pub(super) faces: Vec<Vec<usize>>,
}

/// The files of one time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    pub(super) time_s: f64,
    files: Vec<PathBuf>,
}

const ENDINGS: [&str; 4] = ["vtm", "vtu", "vtk", "vtp"];

/// True for a file that this room reads.
pub(super) fn is_vtk(file: &Path) -> bool {
    let name = file.to_string_lossy().to_ascii_lowercase();
    is_series(&name) || ENDINGS.iter().any(|e| name.ends_with(&format!(".{e}")))
}

/// True for the name of a list of files and times.
fn is_series(name: &str) -> bool {
    let plain = name.strip_suffix(".json").unwrap_or(name);
    plain.strip_suffix(".series").is_some_and(|n| ENDINGS.iter().any(|e| n.ends_with(&format!(".{e}"))))
}

/// The times of a folder: those of its grid files with their clouds, or of its clouds alone; empty if none.
pub(super) fn folder_steps(folder: &Path) -> Result<Vec<Step>, SceneError> {
    for ending in ENDINGS {
        let mut files = Vec::new();
        let places = if ending == "vtp" { cloud_folders(folder)? } else { vec![folder.to_owned()] };
        for place in places {
            files.extend(with_ending(&place, ending)?);
        }
        if !files.is_empty() {
            return steps_of(&files);
        }
    }
    Ok(Vec::new())
}

/// The times of a file: one, or those of a `.series`.
pub(super) fn file_steps(file: &Path) -> Result<Vec<Step>, SceneError> {
    if is_series(&file.to_string_lossy().to_ascii_lowercase()) {
        let folder = file.parent().unwrap_or(Path::new("."));
        let listed: Vec<PathBuf> = series(file)?.into_iter().map(|(name, _)| folder.join(name)).collect();
        return steps_of(&listed);
    }
    steps_of(std::slice::from_ref(&file.to_owned()))
}

/// Reads one time.
pub(super) fn read(step: &Step, options: &ImportOptions) -> Result<CfdSpray, SceneError> {
    let mut made = Made { time_s: step.time_s, ..Made::default() };
    let mut all = Vec::new();
    for file in &step.files {
        all.extend(pieces(file)?);
    }
    let clouds = || all.iter().filter(|(_, piece)| !piece.is_grid && named::is_cloud(&piece.point_arrays));
    // OpenFOAM's names of what droplets are made of: Y…(l).
    made.liquids = clouds()
        .flat_map(|(_, piece)| piece.point_arrays.keys())
        .filter_map(|name| Some(name.strip_prefix('Y')?.strip_suffix("(l)")?.to_owned()))
        .collect();
    for (file, piece) in all.iter().filter(|(_, piece)| piece.is_grid) {
        let (boxes, arrays) = boxes(file, piece)?;
        if !boxes.is_empty() {
            named::add_cells(&mut made, file, &boxes, &arrays, options)?;
        }
    }
    for (file, piece) in clouds() {
        named::add_parcels(&mut made, file, &piece.points, &piece.point_arrays)?;
    }
    let mut names: Vec<String> = clouds().map(|(file, _)| file.display().to_string()).collect();
    names.dedup();
    if names.len() > 1 {
        made.notes.push(format!("several clouds are read as one spray: {}", names.join(", ")));
    }
    let Some(first) = step.files.first() else {
        return Err(SceneError::missing(Path::new("."), "a file of this time", "Check the path"));
    };
    if made.cells.is_none() && made.parcels.is_none() {
        return Err(SceneError::missing(
            first,
            "volume cells or a cloud with diameters (d)",
            "Export them too",
        ));
    }
    made.finish(first, options)
}

/// Groups files by their time, each with the clouds that belong to it.
fn steps_of(files: &[PathBuf]) -> Result<Vec<Step>, SceneError> {
    let mut steps: Vec<Step> = Vec::new();
    for file in files {
        let time_s = time_of(file)?;
        let mut all = vec![file.clone()];
        let is_cloud = is_cloud_file(file);
        if !is_cloud {
            all.extend(clouds_beside(file)?);
        }
        match steps.iter_mut().find(|s| (s.time_s - time_s).abs() <= 1e-9 * time_s.abs()) {
            Some(step) if is_cloud || step.files.iter().all(|f| is_cloud_file(f)) => {
                all.retain(|f| !step.files.contains(f));
                step.files.extend(all);
            }
            _ => steps.push(Step { time_s, files: all }),
        }
    }
    steps.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Ok(steps)
}

fn is_cloud_file(file: &Path) -> bool {
    let ending = file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    ending == "vtp" || (ending == "vtk" && legacy::is_poly_data(file))
}

/// The time that a `.series` beside the file or the file itself tells; 0 if neither does.
fn time_of(file: &Path) -> Result<f64, SceneError> {
    let folder = file.parent().unwrap_or(Path::new("."));
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if file.is_file() {
        for entry in super::names(folder)?.iter().filter(|n| is_series(&n.to_ascii_lowercase())) {
            if let Some((_, time_s)) = series(&folder.join(entry))?.into_iter().find(|(n, _)| *n == name) {
                return Ok(time_s);
            }
        }
    }
    let extension = file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let time = if extension == "vtk" { legacy::read(file)?.time_s } else { xml::time(file)? };
    Ok(time.unwrap_or(0.0))
}

/// Names and times of a `.series` file.
fn series(file: &Path) -> Result<Vec<(String, f64)>, SceneError> {
    let bytes = super::read_bytes(file)?;
    let parsed: serde_json::Value = serde_json::from_slice(&bytes)
        .map_err(|e| SceneError::malformed(file, Place::Line(e.line()), "a series in JSON", e.to_string()))?;
    let listed = parsed
        .get("files")
        .and_then(|f| f.as_array())
        .ok_or_else(|| SceneError::malformed(file, Place::Whole, "a list `files`", "none"))?;
    Ok(listed
        .iter()
        .filter_map(|f| Some((f.get("name")?.as_str()?.to_owned(), f.get("time")?.as_f64()?)))
        .collect())
}

/// Clouds beside a grid's file, with the same index at the end of the name.
fn clouds_beside(file: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let folder = file.parent().unwrap_or(Path::new("."));
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let Some((_, index)) = stem.rsplit_once('_') else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    for place in cloud_folders(folder)? {
        for cloud in with_ending(&place, "vtp")? {
            if cloud.file_stem().is_some_and(|s| s.to_string_lossy().ends_with(&format!("_{index}"))) {
                found.push(cloud);
            }
        }
    }
    Ok(found)
}

/// The folder itself and the folders in its `lagrangian`.
fn cloud_folders(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let mut found = vec![folder.to_owned()];
    let lagrangian = folder.join("lagrangian");
    if lagrangian.is_dir() {
        found.extend(super::names(&lagrangian)?.iter().map(|n| lagrangian.join(n)).filter(|p| p.is_dir()));
    }
    Ok(found)
}

fn with_ending(folder: &Path, ending: &str) -> Result<Vec<PathBuf>, SceneError> {
    let fits = |p: &PathBuf| p.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) && p.is_file();
    Ok(super::names(folder)?.iter().map(|n| folder.join(n)).filter(fits).collect())
}

fn pieces(file: &Path) -> Result<Vec<(PathBuf, Piece)>, SceneError> {
    let extension = file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if extension == "vtk" {
        return Ok(vec![(file.to_owned(), legacy::read(file)?)]);
    }
    if extension != "vtm" {
        return Ok(xml::read(file)?.into_iter().map(|p| (file.to_owned(), p)).collect());
    }
    let folder = file.parent().unwrap_or(Path::new("."));
    let mut all = Vec::new();
    for name in xml::blocks(file)? {
        let block = folder.join(&name);
        // Boundary patches come as .vtp too; they have no diameters and are passed over later.
        all.extend(xml::read(&block)?.into_iter().map(|p| (block.clone(), p)));
    }
    Ok(all)
}

/// Boxes of the volume cells, and the cell arrays without the values of other cells.
fn boxes(file: &Path, piece: &Piece) -> Result<(Vec<(Box3, bool)>, Arrays), SceneError> {
    let mut boxes = Vec::with_capacity(piece.cells.len());
    let mut keep = Vec::with_capacity(piece.cells.len());
    let limit = piece.points.len();
    for (index, cell) in piece.cells.iter().enumerate() {
        let beyond = cell.corners.iter().chain(cell.faces.iter().flatten()).find(|&&p| p >= limit);
        if let Some(point) = beyond {
            let expected = format!("points below {limit}");
            return Err(SceneError::malformed(
                file,
                Place::Whole,
                expected,
                format!("{point} in cell {index}"),
            ));
        }
        let shape = volume_box(cell, &piece.points);
        keep.push(shape.is_some());
        boxes.extend(shape);
    }
    let mut arrays = Arrays::new();
    for (name, values) in &piece.cell_arrays {
        if values.len() != keep.len() {
            return Err(SceneError::length(file, format!("values of {name:?}"), keep.len(), values.len()));
        }
        let kept = values.iter().zip(&keep).filter(|(_, keep)| **keep).map(|(v, _)| *v).collect();
        arrays.insert(name.clone(), kept);
    }
    Ok((boxes, arrays))
}

/// The box of a volume cell; `None` for points, lines and surfaces. Numbers of kinds: VTK File Formats, table 1–2.
fn volume_box(cell: &Cell, points: &[[f64; 3]]) -> Option<(Box3, bool)> {
    if cell.kind == 42 {
        let (bounds, volume, centre) = polyhedron(|p| points[p], cell.faces.iter().map(Vec::as_slice));
        return Some(bounds.stand_in(volume, centre));
    }
    if cell.kind == 11 {
        let mut bounds = Box3::EMPTY;
        cell.corners.iter().for_each(|&p| bounds.extend(points[p]));
        return Some((bounds, false));
    }
    let corners = match cell.kind {
        10 | 24 => 4,
        14 | 27 => 5,
        13 | 26 => 6,
        12 | 25 | 29 => 8,
        _ => return None,
    };
    let faces = standard_faces(corners)?;
    if cell.corners.len() < corners {
        return None;
    }
    let (bounds, volume, centre) = polyhedron(|i| points[cell.corners[i]], faces.iter().copied());
    Some(bounds.stand_in(volume, centre))
}

/// A number in single precision as the decimal it was meant to be: 0.0007, not 0.000699999975.
fn decimal(value: f64) -> f64 {
    #[expect(clippy::cast_possible_truncation, reason = "it was single precision in the file")]
    let single = value as f32;
    single.to_string().parse().unwrap_or(value)
}

/// Cells of a flat list of faces: number of faces, then per face its number of points and the points.
fn faces_from(stream: &[i64]) -> Option<Vec<Vec<usize>>> {
    let (&number, mut rest) = stream.split_first()?;
    let mut faces = Vec::new();
    for _ in 0..number {
        let (&count, after) = rest.split_first()?;
        let (face, after) = after.split_at_checked(usize::try_from(count).ok()?)?;
        if face.is_empty() {
            return None;
        }
        faces.push(face.iter().map(|&p| usize::try_from(p).ok()).collect::<Option<_>>()?);
        rest = after;
    }
    (!faces.is_empty()).then_some(faces)
}
