//! Sprays computed elsewhere: finds out the form of a path, lists its times, reads one of them.
//!
//! Reads as little as the optics need: parcels (place, diameter, temperature, number, density) and gas cells
//! (box, temperature, pressure or density, mass fraction of the fuel). Judges nothing and spreads nothing.

mod csv;
mod ensight;
mod error;
mod gas_law;
mod named;
mod openfoam;
mod shape;
mod vtk;

pub use error::{Place, SceneError};
pub use gas_law::{NITROGEN_KG_MOL, fuel_molar_mass};

use super::compact;
use super::field::{CfdSpray, GasCell, Parcel};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Which time of a case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Time {
    /// The last one.
    Latest,
    /// The one at this many seconds, to within 1e-5 of its value.
    At(f64),
}

/// What the files do not say.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportOptions {
    /// Name of the fuel's field; `None`: the only field whose name is a fuel.
    pub fuel: Option<String>,
    /// Molar mass of the fuel in kg/mol; `None`: by its name.
    pub fuel_molar_mass_kg_mol: Option<f64>,
    /// Molar mass of the other gas in kg/mol.
    pub carrier_molar_mass_kg_mol: f64,
    /// Length in metres of the unit of length in the files (0.001 for exports in millimetres).
    pub length_unit_m: f64,
}

impl Default for ImportOptions {
    /// Fuel by name, nitrogen, metres.
    fn default() -> Self {
        Self {
            fuel: None,
            fuel_molar_mass_kg_mol: None,
            carrier_molar_mass_kg_mol: NITROGEN_KG_MOL,
            length_unit_m: 1.0,
        }
    }
}

impl ImportOptions {
    fn mixture(&self, file: &Path, fuel: &str) -> Result<gas_law::Mixture, SceneError> {
        let mass = self.fuel_molar_mass_kg_mol.or_else(|| fuel_molar_mass(fuel)).ok_or_else(|| {
            SceneError::missing(file, format!("the molar mass of {fuel:?}"), "Give it as an option")
        })?;
        Ok(gas_law::Mixture { fuel: mass, carrier: self.carrier_molar_mass_kg_mol })
    }
}

/// The times of a spray in seconds, ascending.
///
/// # Errors
///
/// [`SceneError::Unknown`] if the path is no spray, and whatever reading the case's index gives.
pub fn list(path: &Path) -> Result<Vec<f64>, SceneError> {
    match form(path)? {
        Form::OpenFoam(case) => Ok(openfoam::times(&case)?.into_iter().map(|t| t.0).collect()),
        Form::Ensight(file) => Ok(ensight::open(&file)?.times()),
        Form::Vtk(steps) => Ok(steps.into_iter().map(|s| s.time_s).collect()),
        Form::Csv(folder) => Ok(vec![csv::time(&folder)?]),
        Form::Compact(file) => Ok(vec![read_compact(&file)?.time_s]),
    }
}

/// Reads one time of a spray.
///
/// # Errors
///
/// [`SceneError::Unknown`] if the path is no spray, [`SceneError::Time`] if it has no such time, and
/// [`SceneError::Malformed`], [`SceneError::Missing`], [`SceneError::Length`] or [`SceneError::Access`] for
/// trouble with its files.
pub fn read(path: &Path, time: Time, options: &ImportOptions) -> Result<CfdSpray, SceneError> {
    match form(path)? {
        Form::OpenFoam(case) => {
            let times = openfoam::times(&case)?;
            let chosen = pick(&case, time, times, |t| t.0)?;
            openfoam::read(&case, &chosen, options)
        }
        Form::Ensight(file) => {
            let case = ensight::open(&file)?;
            case.read(pick(&file, time, case.times(), |t| *t)?, options)
        }
        Form::Vtk(steps) => vtk::read(&pick(path, time, steps, |s| s.time_s)?, options),
        Form::Csv(folder) => {
            pick(&folder, time, vec![csv::time(&folder)?], |t| *t)?;
            csv::read(&folder, options)
        }
        Form::Compact(file) => {
            let spray = read_compact(&file)?;
            pick(&file, time, vec![spray.time_s], |t| *t)?;
            Ok(spray)
        }
    }
}

/// A known form, with the file or folder where it starts.
enum Form {
    OpenFoam(PathBuf),
    Ensight(PathBuf),
    Vtk(Vec<vtk::Step>),
    Csv(PathBuf),
    Compact(PathBuf),
}

fn form(path: &Path) -> Result<Form, SceneError> {
    if !path.exists() {
        return Err(SceneError::Unknown {
            file: path.to_owned(),
            why: "there is no such file or folder".into(),
        });
    }
    if path.is_dir() { folder_form(path) } else { file_form(path) }
}

fn folder_form(folder: &Path) -> Result<Form, SceneError> {
    if openfoam::is_case(folder) {
        return Ok(Form::OpenFoam(folder.to_owned()));
    }
    if csv::is_pair(folder) {
        return Ok(Form::Csv(folder.to_owned()));
    }
    let cases: Vec<String> = names(folder)?.into_iter().filter(|n| n.ends_with(".case")).collect();
    match cases.as_slice() {
        [] => {}
        [one] => return Ok(Form::Ensight(folder.join(one))),
        several => {
            let why = format!("several .case files ({}); name one", several.join(", "));
            return Err(SceneError::Unknown { file: folder.to_owned(), why });
        }
    }
    let steps = vtk::folder_steps(folder)?;
    if !steps.is_empty() {
        return Ok(Form::Vtk(steps));
    }
    Err(SceneError::Unknown {
        file: folder.to_owned(),
        why: "the folder has none of the files looked for".into(),
    })
}

fn file_form(file: &Path) -> Result<Form, SceneError> {
    let extension = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match extension.as_str() {
        "spray" => Ok(Form::Compact(file.to_owned())),
        "case" => Ok(Form::Ensight(file.to_owned())),
        "csv" => folder_form(file.parent().unwrap_or(Path::new("."))),
        _ if vtk::is_vtk(file) => Ok(Form::Vtk(vtk::file_steps(file)?)),
        // The empty marker file that ParaView users keep in a case.
        "foam" => folder_form(file.parent().unwrap_or(Path::new("."))),
        _ => Err(SceneError::Unknown { file: file.to_owned(), why: format!("the ending is {extension:?}") }),
    }
}

/// All bytes of a file, unpacked if it starts like gzip.
fn read_bytes(path: &Path) -> Result<Vec<u8>, SceneError> {
    let raw = std::fs::read(path).map_err(|e| SceneError::access(path, "reading", &e))?;
    if !raw.starts_with(&[0x1f, 0x8b]) {
        return Ok(raw);
    }
    let mut bytes = Vec::with_capacity(raw.len().saturating_mul(6));
    flate2::read::MultiGzDecoder::new(raw.as_slice()).read_to_end(&mut bytes).map_err(|e| {
        SceneError::malformed(path, Place::Byte(bytes.len()), "more packed bytes", e.to_string())
    })?;
    Ok(bytes)
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Result<Vec<String>, SceneError> {
    let entries = std::fs::read_dir(folder).map_err(|e| SceneError::access(folder, "listing", &e))?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| SceneError::access(folder, "listing", &e))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

fn read_compact(file: &Path) -> Result<CfdSpray, SceneError> {
    let bytes = std::fs::read(file).map_err(|e| SceneError::access(file, "reading", &e))?;
    compact::unpack(&bytes, file)
}

/// Relative difference of times that are the same; single precision has 6e-8, five digits of text 1e-5.
const SAME_TIME: f64 = 1e-5;

fn pick<T>(file: &Path, time: Time, times: Vec<T>, seconds: impl Fn(&T) -> f64) -> Result<T, SceneError> {
    let present = times.iter().map(|t| seconds(t).to_string()).collect::<Vec<_>>().join(", ");
    let mut times = times;
    let found = match time {
        Time::Latest => times.len().checked_sub(1),
        Time::At(asked) => {
            times.iter().position(|t| (seconds(t) - asked).abs() <= SAME_TIME * asked.abs().max(SAME_TIME))
        }
    };
    match (found, time) {
        (Some(index), _) => Ok(times.swap_remove(index)),
        (None, Time::At(asked_s)) => {
            let apart = |t: &T| (seconds(t) - asked_s).abs();
            let nearest =
                times.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).map(|t| seconds(t).to_string());
            let nearest = nearest.unwrap_or_else(|| "none".into());
            Err(SceneError::Time { file: file.to_owned(), asked_s, nearest, present })
        }
        (None, Time::Latest) => {
            Err(SceneError::missing(file, "any time", "Look into the folder: is it the case?"))
        }
    }
}

/// What a reader has gathered so far.
#[derive(Default)]
struct Made {
    time_s: f64,
    parcels: Option<Vec<Parcel>>,
    liquid_density_kg_m3: Option<Vec<f64>>,
    density_missing: bool,
    cells: Option<Vec<GasCell>>,
    shaped_cells: usize,
    fuel: String,
    /// What the droplets are made of, where the form tells.
    liquids: Vec<String>,
    notes: Vec<String>,
}

/// Share of the parcels whose numbers may make no sense (not finite, negative); solvers leave some behind.
const BROKEN_MAX: f64 = 0.01;

/// A chamber wider than this was not meant in metres, and neither was a droplet.
const WIDE_M: f64 = 3.0;
const LARGE_M: f64 = 5e-3;

impl Made {
    fn finish(mut self, file: &Path, options: &ImportOptions) -> Result<CfdSpray, SceneError> {
        let mixture = match self.cells {
            Some(_) => options.mixture(file, &self.fuel)?,
            None => gas_law::Mixture {
                fuel: options.fuel_molar_mass_kg_mol.unwrap_or(f64::NAN),
                carrier: options.carrier_molar_mass_kg_mol,
            },
        };
        let unit = options.length_unit_m;
        for parcel in self.parcels.iter_mut().flatten() {
            parcel.position_m = parcel.position_m.map(|x| x * unit);
        }
        let mut domain = shape::Box3::EMPTY;
        for cell in self.cells.iter_mut().flatten() {
            cell.lower_m = cell.lower_m.map(|x| x * unit);
            cell.upper_m = cell.upper_m.map(|x| x * unit);
            domain.extend(cell.lower_m);
            domain.extend(cell.upper_m);
        }
        let sound = |c: &GasCell| {
            c.volume_m3().is_finite()
                && c.temperature_k.is_finite()
                && c.density_kg_m3.is_finite()
                && c.fuel_mass_fraction.is_finite()
        };
        if let Some(index) = self.cells.iter().flatten().position(|c| !sound(c)) {
            let expected = "a finite shape, temperature, density and mass fraction in every gas cell";
            return Err(SceneError::malformed(
                file,
                Place::Whole,
                expected,
                format!("others in cell {index}"),
            ));
        }
        let has_cells = self.cells.as_ref().is_some_and(|c| !c.is_empty());
        self.check_parcels(file)?;
        self.note_units(domain);
        Ok(CfdSpray {
            time_s: self.time_s,
            parcels: self.parcels,
            liquid_density_kg_m3: if self.density_missing { None } else { self.liquid_density_kg_m3 },
            cells: self.cells,
            shaped_cells: self.shaped_cells,
            remainder: None,
            domain_m: has_cells.then_some([domain.lower, domain.upper]),
            fuel: self.fuel,
            fuel_molar_mass_kg_mol: mixture.fuel,
            carrier_molar_mass_kg_mol: mixture.carrier,
            notes: self.notes,
        })
    }

    /// A few parcels without sense are junk; many are a damaged or foreign file.
    fn check_parcels(&mut self, file: &Path) -> Result<(), SceneError> {
        let good = |v: f64| v.is_finite() && v >= 0.0;
        let sound = |p: &Parcel| {
            good(p.diameter_m)
                && good(p.temperature_k)
                && good(p.droplets)
                && p.position_m.iter().all(|x| x.is_finite())
        };
        let parcels = self.parcels.as_deref().unwrap_or_default();
        let broken = parcels.iter().filter(|p| !sound(p)).count();
        if broken as f64 > BROKEN_MAX * parcels.len() as f64 {
            let first = parcels.iter().position(|p| !sound(p)).unwrap_or(0);
            let expected =
                "parcels with finite places and diameters, temperatures and numbers that are not negative";
            let found = format!("others in {broken} of {} (the first is number {first})", parcels.len());
            return Err(SceneError::malformed(file, Place::Whole, expected, found));
        }
        if broken > 0 {
            self.notes.push(format!(
                "{broken} parcels have numbers that make no sense; they are in no sum but the count"
            ));
        }
        Ok(())
    }

    /// Says so when the numbers look like those of other units.
    fn note_units(&mut self, domain: shape::Box3) {
        let parcels = self.parcels.as_deref().unwrap_or_default();
        let mut reach = domain;
        parcels
            .iter()
            .filter(|p| p.position_m.iter().all(|x| x.is_finite()))
            .for_each(|p| reach.extend(p.position_m));
        let widest = (0..3).map(|a| reach.upper[a] - reach.lower[a]).fold(0.0, f64::max);
        if widest > WIDE_M {
            self.notes.push(format!(
                "the spray's box is {widest:.4} m wide; if the file has millimetres, give the length unit 0.001"
            ));
        }
        let mut diameters: Vec<f64> = parcels.iter().map(|p| p.diameter_m).collect();
        diameters.sort_by(f64::total_cmp);
        if let Some(&median) = diameters.get(diameters.len() / 2)
            && median > LARGE_M
        {
            self.notes.push(format!(
                "the median diameter of the droplets is {median:.4} m; if the file has micrometres, write them in metres"
            ));
        }
    }
}

/// One gas cell; whichever of pressure and density is missing follows from the other (one must be there).
fn gas_cell(
    corners_m: [[f64; 3]; 2],
    temperature_k: f64,
    pressure_pa: Option<f64>,
    density_kg_m3: Option<f64>,
    fuel_mass_fraction: f64,
    mixture: gas_law::Mixture,
) -> GasCell {
    let density = density_kg_m3
        .or_else(|| pressure_pa.map(|p| mixture.density(p, temperature_k, fuel_mass_fraction)))
        .unwrap_or(f64::NAN);
    let pressure =
        pressure_pa.unwrap_or_else(|| mixture.pressure(density, temperature_k, fuel_mass_fraction));
    GasCell {
        lower_m: corners_m[0],
        upper_m: corners_m[1],
        temperature_k,
        pressure_pa: pressure,
        density_kg_m3: density,
        fuel_mass_fraction,
    }
}
