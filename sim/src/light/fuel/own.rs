//! A fuel of the user's own: a small TOML file that names its tables, or the fuels it is mixed from.
//!
//! Tables:
//!
//! ```toml
//! name = "my heptane"                  # may be left out: then the file's name
//! liquid = "liquid.csv"                # wavelength_um, n, k
//! liquid_temperature_k = 299.15        # of that table; may be left out: 299.15
//! vapour = "vapour.csv"                # wavelength_um, sigma_m2_mol_300K, sigma_m2_mol_400K, …
//! molar_mass_kg_mol = 0.1002
//! density = { file = "density.csv" }   # T_K, rho_liq_kg_m3; or Rackett's equation from one value:
//! # density = { kg_m3 = 679.6, at_k = 298.15, critical_k = 540.2, compressibility = 0.2611 }
//! ```
//!
//! or a mixture by volume, at 299.15 K:
//!
//! ```toml
//! [[part]]
//! fuel = "ethanol"                     # a shipped fuel, or another such file
//! volume_fraction = 0.1
//! [[part]]
//! fuel = "my_gasoline.toml"
//! volume_fraction = 0.9
//! ```
//!
//! File names are relative to the file they stand in. `# status:`, `# source:` … at the top of a table are kept.

use super::{Density, Fuel, FuelError, LIQUID_REFERENCE_K, LIQUID_TABLE, NAMES, Part, VAPOUR_TABLE};
use crate::light::names;
use serde::Deserialize;
use std::path::Path;

/// Deepest nesting of mixtures in files: it stops files that name each other.
const DEPTH_MAX: usize = 8;

/// Range of Rackett's equation up to this part of T_c, as the shipped fits end there.
const RACKETT_TO: f64 = 0.9;
/// Lowest temperature of Rackett's equation in K, where the shipped fits begin.
const RACKETT_FROM_K: f64 = 280.0;

/// How a file is opened: its text, or why there is none.
pub type Open<'a> = &'a dyn Fn(&Path) -> Result<String, String>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FuelFile {
    name: Option<String>,
    liquid: Option<String>,
    liquid_temperature_k: Option<f64>,
    vapour: Option<String>,
    molar_mass_kg_mol: Option<f64>,
    density: Option<DensityTable>,
    #[serde(default)]
    part: Vec<PartTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DensityTable {
    file: Option<String>,
    kg_m3: Option<f64>,
    at_k: Option<f64>,
    critical_k: Option<f64>,
    compressibility: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PartTable {
    fuel: String,
    volume_fraction: f64,
}

impl Fuel {
    /// A shipped fuel by its name, or the user's own by the path of its TOML file; `open` reads files.
    ///
    /// ```
    /// use ditd_sim::light::fuel::Fuel;
    /// let text = "[[part]]\nfuel = \"ethanol\"\nvolume_fraction = 0.2\n\
    ///             [[part]]\nfuel = \"isooctane\"\nvolume_fraction = 0.8\n";
    /// let fuel = Fuel::opened("e20.toml".as_ref(), &|_| Ok(text.to_owned()))?;
    /// assert_eq!(fuel.name(), "e20");
    /// assert!(Fuel::opened("ethanol".as_ref(), &|path| Err(format!("no {path:?}"))).is_ok());
    /// # Ok::<(), ditd_sim::light::fuel::FuelError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`FuelError`]: no such name, or the file, row and what would be right.
    pub fn opened(name: &Path, open: Open<'_>) -> Result<Self, FuelError> {
        opened(name, open, 0)
    }
}

fn opened(path: &Path, open: Open<'_>, depth: usize) -> Result<Fuel, FuelError> {
    if let Some(name) = path.to_str().filter(|name| NAMES.contains(name)) {
        return Fuel::named(name);
    }
    if !path.extension().is_some_and(|end| end.eq_ignore_ascii_case("toml")) {
        return Err(FuelError::unknown(&path.to_string_lossy()));
    }
    let file = Place { path, open };
    if depth >= DEPTH_MAX {
        return Err(
            file.wrong(format!("mixtures are nested deeper than {DEPTH_MAX}: do files name each other?"))
        );
    }
    let text = file.text(path)?;
    let tables: FuelFile = toml::from_str(&text).map_err(|error| file.wrong(error.to_string().trim_end()))?;
    let stem = || path.file_stem().map_or("own".to_owned(), |stem| stem.to_string_lossy().into_owned());
    let name = tables.name.clone().unwrap_or_else(stem);
    if tables.part.is_empty() { file.pure(&name, &tables) } else { file.mixture(&name, &tables, depth) }
}

/// A fuel's file, for messages and for the files beside it.
struct Place<'a> {
    path: &'a Path,
    open: Open<'a>,
}

impl Place<'_> {
    fn wrong(&self, problem: impl Into<String>) -> FuelError {
        wrong(self.path, problem)
    }

    fn text(&self, path: &Path) -> Result<String, FuelError> {
        (self.open)(path).map_err(|problem| wrong(path, problem))
    }

    fn beside(&self, file: &str) -> std::path::PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(file)
    }

    fn pure(&self, name: &str, tables: &FuelFile) -> Result<Fuel, FuelError> {
        let (Some(liquid), Some(vapour), Some(molar_mass), Some(density)) =
            (&tables.liquid, &tables.vapour, tables.molar_mass_kg_mol, &tables.density)
        else {
            return Err(self.wrong(
                "a fuel needs liquid, vapour, molar_mass_kg_mol and density, or [[part]] tables to be mixed from",
            ));
        };
        let (liquid, vapour) = (self.beside(liquid), self.beside(vapour));
        let density = self.density(density)?;
        let reference_k = tables.liquid_temperature_k.unwrap_or(LIQUID_REFERENCE_K);
        let (liquid_text, vapour_text) = (self.text(&liquid)?, self.text(&vapour)?);
        Fuel::of_tables_at(name, &liquid_text, &vapour_text, molar_mass, (density, reference_k)).map_err(
            |error| match error {
                FuelError::Table { which: LIQUID_TABLE, source, .. } => wrong(&liquid, source.to_string()),
                FuelError::Table { which: VAPOUR_TABLE, source, .. } => wrong(&vapour, source.to_string()),
                other => self.wrong(other.to_string()),
            },
        )
    }

    fn density(&self, table: &DensityTable) -> Result<Density, FuelError> {
        match *table {
            DensityTable { file: Some(ref file), kg_m3: None, at_k: None, critical_k: None, compressibility: None } => {
                let path = self.beside(file);
                Density::from_csv(&self.text(&path)?).map_err(|error| wrong(&path, error.to_string()))
            }
            DensityTable {
                file: None,
                kg_m3: Some(reference_kg_m3),
                at_k: Some(reference_k),
                critical_k: Some(critical_k),
                compressibility: Some(compressibility),
            } => {
                let range_k = [RACKETT_FROM_K, RACKETT_TO * critical_k];
                let possible = reference_kg_m3 > 0.0
                    && reference_k > 0.0
                    && reference_k < critical_k
                    && range_k[0] < range_k[1]
                    && critical_k.is_finite()
                    && compressibility > 0.0
                    && compressibility < 1.0;
                if !possible {
                    return Err(self.wrong(
                        "density: Rackett's equation needs kg_m3 above 0, at_k between 0 and critical_k, critical_k \
                         above 312 and compressibility between 0 and 1",
                    ));
                }
                Ok(Density::Rackett { reference_kg_m3, reference_k, critical_k, compressibility, range_k })
            }
            _ => Err(self.wrong(
                "density needs exactly file, or exactly kg_m3, at_k, critical_k and compressibility (Rackett's)",
            )),
        }
    }

    fn mixture(&self, name: &str, tables: &FuelFile, depth: usize) -> Result<Fuel, FuelError> {
        let others = [
            tables.liquid.is_some(),
            tables.vapour.is_some(),
            tables.density.is_some(),
            tables.molar_mass_kg_mol.is_some(),
            tables.liquid_temperature_k.is_some(),
        ];
        if others.contains(&true) {
            return Err(self.wrong("a fuel has either its own tables or [[part]] tables, not both"));
        }
        let part = |table: &PartTable| {
            let path = if NAMES.contains(&table.fuel.as_str()) {
                Path::new(&table.fuel).to_owned()
            } else {
                self.beside(&table.fuel)
            };
            let fuel = opened(&path, self.open, depth + 1).map_err(|error| match error {
                FuelError::Unknown { .. } => self.wrong(format!(
                    "[[part]] fuel `{}` is not known{}; known are {}, or another file that ends in .toml",
                    table.fuel,
                    names::guessed(&table.fuel, &NAMES),
                    NAMES.join(", ")
                )),
                other => other,
            })?;
            Ok(Part { fuel, volume_fraction: table.volume_fraction })
        };
        let parts = tables.part.iter().map(part).collect::<Result<Vec<_>, FuelError>>()?;
        Fuel::mixture(name, &parts).map_err(|error| self.wrong(error.to_string()))
    }
}

fn wrong(path: &Path, problem: impl Into<String>) -> FuelError {
    FuelError::File { path: path.display().to_string(), problem: problem.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::provenance::Status;

    const LIQUID: &str = "# status: measured\n# source: me\nwavelength_um,n,k\n3,1.4,0.1\n4,1.3,0.2\n";
    const VAPOUR: &str = "wavelength_um,sigma_m2_mol_300K\n3,1\n4,3\n";
    const OWN: &str = "liquid = \"l.csv\"\nvapour = \"v.csv\"\nmolar_mass_kg_mol = 0.1\nliquid_temperature_k = 320\n\
                       density = { file = \"d.csv\" }\n";

    /// The files of a folder `mine`, with one of them replaced.
    fn opened_with(name: &str, text: &str) -> Result<Fuel, FuelError> {
        let files = |path: &Path| {
            let file = path.strip_prefix("mine").map_err(|_| format!("wrong folder {}", path.display()))?;
            let file = file.to_string_lossy().into_owned();
            match file.as_str() {
                own if own == name => Ok(text.to_owned()),
                "own.toml" => Ok(OWN.to_owned()),
                "l.csv" => Ok(LIQUID.to_owned()),
                "v.csv" => Ok(VAPOUR.to_owned()),
                "d.csv" => Ok("T_K,rho_liq_kg_m3\n300,700\n400,600\n".to_owned()),
                _ => Err("there is no such file".to_owned()),
            }
        };
        Fuel::opened(
            Path::new(if name.ends_with("mix.toml") { "mine/mix.toml" } else { "mine/own.toml" }),
            &files,
        )
    }

    fn message(name: &str, text: &str) -> String {
        opened_with(name, text).unwrap_err().to_string()
    }

    #[test]
    fn tables_beside_the_file_are_the_fuel() {
        let fuel = opened_with("", "").unwrap();
        assert_eq!(fuel.name(), "own");
        assert_eq!(fuel.liquid_provenance().status, Some(Status::Measured));
        // At the temperature of its table the index is that of the table.
        let (n, k) = fuel.liquid_index(3.0, 320.0);
        assert!((n - 1.4).abs() < 1e-14 && (k - 0.1).abs() < 1e-14);
        assert!(fuel.liquid_index(3.0, 400.0).0 < n && fuel.liquid_index(3.0, 299.15).0 > n);
        assert!((fuel.vapour_cross_section_m2_mol(3.5, 900.0) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn files_can_be_mixed_with_shipped_fuels() {
        let text = "name = \"blend\"\n[[part]]\nfuel = \"own.toml\"\nvolume_fraction = 0.4\n\
                    [[part]]\nfuel = \"toluene\"\nvolume_fraction = 0.6\n";
        let fuel = opened_with("mix.toml", text).unwrap();
        assert_eq!(fuel.name(), "blend");
        let [from, to] = fuel.liquid_range_um();
        assert!((from - 3.0).abs() < 0.02 && (to - 4.0).abs() < 0.02, "{from} {to}");
        let loops = "[[part]]\nfuel = \"mix.toml\"\nvolume_fraction = 1.0\n";
        assert!(message("mix.toml", loops).contains("nested deeper"));
        let both = format!("molar_mass_kg_mol = 1\n{text}");
        assert!(message("mix.toml", &both).contains("not both"));
        assert!(message("mix.toml", &text.replace("toluene", "tolune")).contains("did you mean `toluene`?"));
        assert!(message("mix.toml", &text.replace("0.6", "0.7")).contains("sum of the volume fractions"));
    }

    #[test]
    fn every_mistake_names_its_file_and_place() {
        for (file, text, wanted) in [
            (
                "l.csv",
                "wavelength_um,n,k\n3,1.4,x\n",
                "mine/l.csv: row 1 (line 2), column `k`: `x` is not a number",
            ),
            (
                "l.csv",
                "um,n,k\n3,1.4,0\n",
                "mine/l.csv: the table has no column `wavelength_um`; it has um, n, k",
            ),
            ("v.csv", "# status: good\nwavelength_um\n", "mine/v.csv: line 1: status `good` is none of"),
            (
                "v.csv",
                "wavelength_um,sigma_m2_mol_300K\n4,1\n3,1\n",
                "mine/v.csv: column `wavelength_um` must ascend",
            ),
            (
                "d.csv",
                "T_K,rho_liq_kg_m3\n300,700\n400,-1\n",
                "mine/d.csv: row 2 (line 3), column `rho_liq_kg_m3`",
            ),
            ("own.toml", "liquid = \"l.csv\"\n", "mine/own.toml: a fuel needs liquid, vapour"),
        ] {
            let found = message(file, text);
            assert!(found.starts_with(wanted), "{found}");
        }
        assert!(
            message("own.toml", &OWN.replace("l.csv", "none.csv")).starts_with("mine/none.csv: there is no")
        );
        assert!(message("own.toml", &OWN.replace("0.1", "-0.1")).contains("molar mass"));
        assert!(message("own.toml", &format!("colour = 1\n{OWN}")).contains("colour"));
        let rackett = |text: &str| OWN.replace("{ file = \"d.csv\" }", text);
        let good = "{ kg_m3 = 679.6, at_k = 298.15, critical_k = 540.2, compressibility = 0.2611 }";
        assert!(opened_with("own.toml", &rackett(good)).is_ok());
        for bad in [good.replace("298.15", "600"), good.replace("0.2611", "2"), good.replace("540.2", "nan")]
        {
            assert!(message("own.toml", &rackett(&bad)).contains("Rackett"), "{bad}");
        }
        assert!(message("own.toml", &rackett("{ kg_m3 = 700 }")).contains("exactly"));
    }
}
