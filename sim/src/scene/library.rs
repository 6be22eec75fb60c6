//! Fuels and window materials as scene and campaign files name them: shipped ones, or the user's own files.
//!
//! A fuel of the user's own is a file that ends in `.toml` (see `light::fuel`), a material one that ends in `.csv`.
//! Names come first; paths are relative to the folder of the file that names them. This is where the files are read;
//! `light` knows none.

use crate::light::fuel::{Fuel, FuelError};
use crate::light::window::{Material, WindowError};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// A file of the user's own: its path from the folder of the file that names it, and its text.
pub type OwnFile = (PathBuf, String);

/// A shipped fuel, or that of a file.
///
/// # Errors
///
/// [`FuelError`] with the names there are, or the file, row and what is wrong.
pub fn fuel(name: &str, folder: &Path) -> Result<Fuel, FuelError> {
    fuel_and_files(name, folder).map(|found| found.0)
}

/// The same with all files that it is read from; none for a shipped one.
///
/// # Errors
///
/// As [`fuel`].
pub fn fuel_and_files(name: &str, folder: &Path) -> Result<(Fuel, Vec<OwnFile>), FuelError> {
    let named = crate::light::fuel::NAMES.contains(&name) || !ends_in(name, "toml");
    let path = if named { Path::new(name).to_owned() } else { folder.join(name) };
    let files = RefCell::new(Vec::new());
    let open = |path: &Path| {
        let text = read(path)?;
        files.borrow_mut().push((from_folder(path, folder), text.clone()));
        Ok(text)
    };
    let fuel = Fuel::opened(&path, &open)?;
    Ok((fuel, files.into_inner()))
}

/// A shipped window material, or that of a file.
///
/// # Errors
///
/// [`WindowError`] with the names there are, or the file, row and what is wrong.
pub fn material(name: &str, folder: &Path) -> Result<Material, WindowError> {
    material_and_file(name, folder).map(|found| found.0)
}

/// The same with the file that it is read from; none for a shipped one.
///
/// # Errors
///
/// As [`material`].
pub fn material_and_file(name: &str, folder: &Path) -> Result<(Material, Option<OwnFile>), WindowError> {
    if let Some(material) = Material::named(name) {
        return Ok((material, None));
    }
    if !ends_in(name, "csv") {
        return Err(WindowError::Unknown { name: name.to_owned() });
    }
    let path = folder.join(name);
    let stem = path.file_stem().map_or_else(|| name.to_owned(), |stem| stem.to_string_lossy().into_owned());
    let wrong = |problem: String| WindowError::File { path: path.display().to_string(), problem };
    let text = read(&path).map_err(wrong)?;
    let material = Material::from_csv(&stem, &text).map_err(|error| wrong(error.to_string()))?;
    Ok((material, Some((from_folder(&path, folder), text))))
}

fn from_folder(path: &Path, folder: &Path) -> PathBuf {
    path.strip_prefix(folder).unwrap_or(path).to_owned()
}

/// Whether a name is that of a file of the user's own: nothing is known of it before it is read.
pub fn is_file(name: &str) -> bool {
    ends_in(name, "toml") || ends_in(name, "csv")
}

fn ends_in(name: &str, end: &str) -> bool {
    Path::new(name).extension().is_some_and(|own| own.eq_ignore_ascii_case(end))
}

fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|error| format!("reading the file: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_first_and_files_are_beside_the_file_that_names_them() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        write("mine/glass.csv", "wavelength_um,n\n3,1.5\n4,1.5\n");
        write(
            "mine/e50.toml",
            "[[part]]\nfuel = \"ethanol\"\nvolume_fraction = 0.5\n\
               [[part]]\nfuel = \"other.toml\"\nvolume_fraction = 0.5\n",
        );
        write("mine/other.toml", "[[part]]\nfuel = \"n-heptane\"\nvolume_fraction = 1\n");
        let glass = material("mine/glass.csv", folder.path()).unwrap();
        assert_eq!(glass.table().name(), "glass");
        assert_eq!(material("quartz", folder.path()).unwrap(), Material::FusedSilica);
        assert_eq!(fuel("mine/e50.toml", folder.path()).unwrap().name(), "e50");
        let (_, files) = fuel_and_files("mine/e50.toml", folder.path()).unwrap();
        let paths: Vec<&str> = files.iter().map(|file| file.0.to_str().unwrap()).collect();
        assert_eq!(paths, ["mine/e50.toml", "mine/other.toml"]);
        let (_, file) = material_and_file("mine/glass.csv", folder.path()).unwrap();
        assert_eq!(file.unwrap().0, Path::new("mine/glass.csv"));
        assert_eq!(fuel("toluene", folder.path()).unwrap().name(), "toluene");
        let missing = fuel("mine/none.toml", folder.path()).unwrap_err().to_string();
        assert!(missing.contains("none.toml: reading the file"), "{missing}");
        assert!(matches!(fuel("heptan", folder.path()), Err(FuelError::Unknown { .. })));
        assert!(matches!(material("none.csv", folder.path()), Err(WindowError::File { .. })));
        assert!(matches!(material("glas", folder.path()), Err(WindowError::Unknown { .. })));
    }
}
