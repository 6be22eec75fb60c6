//! What windows are made of: index over wavelength and temperature, shipped or the user's own.

use crate::light::names;
use crate::light::provenance::Provenance;
use crate::light::table::{Table, TableError, interpolate, locate};
use std::sync::{Arc, LazyLock};

/// Names of the materials that are shipped, as [`Material::named`] takes them.
pub const NAMES: [&str; 6] = ["CaF2", "sapphire", "fused-silica", "ZnSe", "Ge", "Si"];

/// Why there is no such material.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WindowError {
    /// The name is not known.
    #[error(
        "window material `{name}` is unknown{}; there are {}; a material of your own is a file that ends in .csv",
        names::guessed(name, &NAMES),
        NAMES.join(", ")
    )]
    Unknown {
        /// The name asked for.
        name: String,
    },
    /// A table of the user's own cannot be used.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// What is wrong in it.
        problem: String,
    },
}

/// What a window is made of.
#[derive(Debug, Clone, PartialEq)]
pub enum Material {
    /// Calcium fluoride: n of Malitson (1963) with the temperature shift of Zheng et al. (2023), k a model.
    CalciumFluoride,
    /// Sapphire, ordinary ray: n up to 5.0 µm, beyond it the last value; absorption neglected (Fresnel only).
    Sapphire,
    /// Fused silica: n and k of Franta (2016); k depends on the water in the glass.
    FusedSilica,
    /// Zinc selenide, absorption neglected.
    ZincSelenide,
    /// Germanium, absorption neglected: right below 320 K only.
    Germanium,
    /// Silicon, absorption neglected.
    Silicon,
    /// The user's own.
    Own(Arc<IndexTable>),
}

/// Index of a material over wavelength and temperature.
#[derive(Debug, Clone, PartialEq)]
pub struct IndexTable {
    name: String,
    um: Vec<f64>,
    kelvin: Vec<f64>,
    /// `[temperature][wavelength]`; a single row holds at all temperatures.
    n: Vec<Vec<f64>>,
    /// Empty where absorption is neglected.
    k: Vec<f64>,
    provenance: Provenance,
}

struct Shipped {
    caf2: IndexTable,
    sapphire: IndexTable,
    silica: IndexTable,
    znse: IndexTable,
    germanium: IndexTable,
    silicon: IndexTable,
}

static SHIPPED: LazyLock<Shipped> =
    LazyLock::new(|| Shipped::parse().expect("the shipped tables are read by a test"));

impl Shipped {
    fn parse() -> Result<Self, TableError> {
        Ok(Self {
            caf2: IndexTable::parse(NAMES[0], include_str!("../../../data/optics/window_CaF2.csv"))?,
            sapphire: IndexTable::parse(NAMES[1], include_str!("../../../data/optics/window_sapphire.csv"))?,
            silica: IndexTable::parse(
                NAMES[2],
                include_str!("../../../data/optics/window_fused_silica.csv"),
            )?,
            znse: IndexTable::parse(NAMES[3], include_str!("../../../data/optics/window_ZnSe.csv"))?,
            germanium: IndexTable::parse(NAMES[4], include_str!("../../../data/optics/window_Ge.csv"))?,
            silicon: IndexTable::parse(NAMES[5], include_str!("../../../data/optics/window_Si.csv"))?,
        })
    }
}

impl Material {
    /// The shipped material of a configuration's word, in any case: one of [`NAMES`], or `calcium-fluoride`,
    /// `al2o3`, `sio2`, `quartz`, `zinc-selenide`, `germanium`, `silicon`.
    pub fn named(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().replace(['_', ' '], "-").as_str() {
            "caf2" | "calcium-fluoride" => Some(Self::CalciumFluoride),
            "sapphire" | "al2o3" => Some(Self::Sapphire),
            "fused-silica" | "sio2" | "quartz" => Some(Self::FusedSilica),
            "znse" | "zinc-selenide" => Some(Self::ZincSelenide),
            "ge" | "germanium" => Some(Self::Germanium),
            "si" | "silicon" => Some(Self::Silicon),
            _ => None,
        }
    }

    /// The user's own material: a table with the columns wavelength_um, n or several `n_<T>K`, and k; without k it does
    /// not absorb.
    ///
    /// ```
    /// use ditd_sim::light::window::Material;
    /// let glass = Material::from_csv("glass", "wavelength_um,n_300K,n_400K,k\n3,1.5,1.4,0\n4,1.5,1.4,1e-6\n")?;
    /// assert!((glass.index(3.5, 350.0).0 - 1.45).abs() < 1e-12);
    /// # Ok::<(), ditd_sim::light::table::TableError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`TableError`] with the row, unless wavelengths ascend, n is above 0 and k not negative.
    pub fn from_csv(name: &str, text: &str) -> Result<Self, TableError> {
        Ok(Self::Own(Arc::new(IndexTable::parse(name, text)?)))
    }

    /// Index (n, k) at a wavelength in µm and a temperature in K; both are clamped to the table (shipped: 2.5–6 µm;
    /// 297–640 K for calcium fluoride, one temperature for the others). n is linear; k, which spans decades, is linear
    /// in its logarithm where it is above 0.
    pub fn index(&self, wavelength_um: f64, temperature_k: f64) -> (f64, f64) {
        self.table().index(wavelength_um, temperature_k)
    }

    /// Its table: name, ranges, provenance.
    pub fn table(&self) -> &IndexTable {
        let shipped = &*SHIPPED;
        match self {
            Self::CalciumFluoride => &shipped.caf2,
            Self::Sapphire => &shipped.sapphire,
            Self::FusedSilica => &shipped.silica,
            Self::ZincSelenide => &shipped.znse,
            Self::Germanium => &shipped.germanium,
            Self::Silicon => &shipped.silicon,
            Self::Own(table) => table,
        }
    }
}

impl IndexTable {
    fn parse(name: &str, text: &str) -> Result<Self, TableError> {
        let table = Table::parse(text)?;
        let um = table.wavelengths_um()?;
        let column = |name: &str| {
            table.possible(name, "finite and above 0", |n| n > 0.0 && n.is_finite()).map(<[f64]>::to_vec)
        };
        let warm = table.over_temperature("n_");
        let (kelvin, n) = if warm.is_empty() {
            (vec![], vec![column("n")?])
        } else {
            let columns = warm.iter().map(|(_, name)| column(name)).collect::<Result<_, _>>()?;
            (warm.iter().map(|(kelvin, _)| *kelvin).collect(), columns)
        };
        let k = if table.names().iter().any(|own| own == "k") {
            let wanted = "finite and not negative (k > 0 absorbs)";
            table.possible("k", wanted, |k| k >= 0.0 && k.is_finite())?.to_vec()
        } else {
            vec![]
        };
        Ok(Self { name: name.to_owned(), um, kelvin, n, k, provenance: table.provenance().clone() })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What the file says of itself.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Range in µm; outside it the ends are used.
    pub fn range_um(&self) -> [f64; 2] {
        [self.um[0], self.um[self.um.len() - 1]]
    }

    /// Range in K, if n depends on the temperature; outside it the ends are used.
    pub fn range_k(&self) -> Option<[f64; 2]> {
        Some([*self.kelvin.first()?, *self.kelvin.last()?])
    }

    /// Whether absorption is known.
    pub fn absorbs(&self) -> bool {
        !self.k.is_empty()
    }

    fn index(&self, wavelength_um: f64, temperature_k: f64) -> (f64, f64) {
        let at = |column: &[f64]| interpolate(&self.um, column, wavelength_um);
        let n = if self.n.len() == 1 {
            at(&self.n[0])
        } else {
            let (cold, warmth) = locate(&self.kelvin, temperature_k);
            (1.0 - warmth) * at(&self.n[cold]) + warmth * at(&self.n[cold + 1])
        };
        if self.k.is_empty() {
            return (n, 0.0);
        }
        let (lower, fraction) = locate(&self.um, wavelength_um);
        let (from, to) = (self.k[lower], self.k[lower + 1]);
        let k = if from > 0.0 && to > 0.0 {
            (from.ln() + fraction * (to.ln() - from.ln())).exp()
        } else {
            from + fraction * (to - from)
        };
        (n, k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_material_has_status_and_source() {
        for name in NAMES {
            let material = Material::named(name).unwrap();
            let table = material.table();
            assert_eq!(table.name(), name);
            assert!(table.provenance().status.is_some() && !table.provenance().source.is_empty(), "{name}");
            let (n, k) = material.index(3.4, 300.0);
            assert!(n > 1.3 && n < 4.1 && (0.0..1e-3).contains(&k), "{name}: {n} {k}");
        }
        assert_eq!(Material::named("CaF2"), Some(Material::CalciumFluoride));
        assert_eq!(Material::named("fused_silica"), Some(Material::FusedSilica));
        assert_eq!(Material::named("zinc selenide"), Some(Material::ZincSelenide));
        assert_eq!(Material::named("wood"), None);
        // Sapphire's formula ends at 5 µm; beyond it the last value holds.
        assert_eq!(Material::Sapphire.table().range_um()[1].to_bits(), 5f64.to_bits());
        let [end, beyond] = [5.0, 6.0].map(|um| Material::Sapphire.index(um, 295.0).0.to_bits());
        assert_eq!(end, beyond);
        // Handbook values at 3.4 um and room temperature: ZnSe 2.435, Ge 4.036, Si 3.430.
        for (name, n) in [("ZnSe", 2.435), ("Ge", 4.036), ("Si", 3.430)] {
            assert!((Material::named(name).unwrap().index(3.4, 295.0).0 - n).abs() < 5e-3, "{name}");
        }
    }

    #[test]
    fn k_is_straight_in_its_logarithm_but_survives_zeros() {
        let own = Material::from_csv("own", "wavelength_um,n,k\n3,1.5,1e-8\n4,1.5,1e-4\n5,1.5,0\n").unwrap();
        assert!((own.index(3.5, 300.0).1 / 1e-6 - 1.0).abs() < 1e-12);
        assert!((own.index(4.5, 300.0).1 / 5e-5 - 1.0).abs() < 1e-12);
        assert!((own.index(9.0, 300.0).1).abs() < f64::MIN_POSITIVE);
    }

    #[test]
    fn impossible_tables_are_refused_with_their_row() {
        for (text, wanted) in [
            ("wavelength_um,k\n3,0\n4,0\n", "no column `n`"),
            ("wavelength_um,n\n3,1.5\n4,0\n", "row 2 (line 3), column `n`: 0 is not possible"),
            ("wavelength_um,n,k\n3,1.5,-1\n4,1.5,0\n", "row 1 (line 2), column `k`"),
            ("wavelength_um,n\n4,1.5\n3,1.5\n", "must ascend"),
            ("wavelength_um,n\n-3,1.5\n3,1.5\n", "column `wavelength_um`: -3"),
            ("wavelength_um,n\n3,1.5\n", "at least two rows"),
            ("", "empty"),
        ] {
            let found = Material::from_csv("own", text).unwrap_err().to_string();
            assert!(found.contains(wanted), "{found}");
        }
        let error = WindowError::Unknown { name: "sapfire".to_owned() }.to_string();
        assert!(error.contains("did you mean `sapphire`?"), "{error}");
    }
}
