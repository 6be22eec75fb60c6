//! The plain pair `parcels.csv` and `cells.csv`: what every code can write.
//!
//! The header names quantity and unit: `x_m`, `d_um`, `T [K]`, `p (bar)` … Lengths m, mm, um; temperatures K, C;
//! pressures Pa, kPa, MPa, bar; densities kg/m3, g/cm3; masses kg, g, mg; volumes m3, mm3; times are not in it.
//! Without a unit: SI. Cells are centre and volume (a cube stands for the cell), centre and edges (dx, dy, dz), or
//! corners (x_min … z_max). `#` begins a comment; `# time_s = 0.0009` gives the time, `# rows = 7975` the number of rows:
//! without it nobody can tell that a table was cut off between two rows.

use super::super::field::CfdSpray;
use super::error::{Place, SceneError};
use super::named::{self, Arrays};
use super::shape::Box3;
use super::{ImportOptions, Made};
use std::path::Path;

const PARCELS: &str = "parcels.csv";
const CELLS: &str = "cells.csv";

/// True if a folder has one of the two.
pub(super) fn is_pair(folder: &Path) -> bool {
    folder.join(PARCELS).is_file() || folder.join(CELLS).is_file()
}

/// The time in seconds that a comment gives; 0 if there is none.
pub(super) fn time(folder: &Path) -> Result<f64, SceneError> {
    for name in [PARCELS, CELLS] {
        let file = folder.join(name);
        if file.is_file()
            && let Some(time_s) = Table::read(&file)?.time_s
        {
            return Ok(time_s);
        }
    }
    Ok(0.0)
}

/// Reads the pair, or the one that is there.
pub(super) fn read(folder: &Path, options: &ImportOptions) -> Result<CfdSpray, SceneError> {
    let mut made = Made { time_s: time(folder)?, ..Made::default() };
    let parcels = folder.join(PARCELS);
    if parcels.is_file() {
        let mut table = Table::read(&parcels)?;
        made.notes.extend(table.note.take());
        let positions = table.triple(["x", "y", "z"])?.ok_or_else(|| {
            SceneError::missing(&parcels, "the columns x, y, z", "Name them so, with units")
        })?;
        named::add_parcels(&mut made, &parcels, &positions, &table.arrays)?;
    }
    let cells = folder.join(CELLS);
    if cells.is_file() {
        let mut table = Table::read(&cells)?;
        made.notes.extend(table.note.take());
        let boxes = table.boxes()?;
        named::add_cells(&mut made, &cells, &boxes, &table.arrays, options)?;
    }
    made.finish(folder, options)
}

struct Table<'a> {
    file: &'a Path,
    time_s: Option<f64>,
    arrays: Arrays,
    rows: usize,
    note: Option<String>,
}

impl<'a> Table<'a> {
    fn read(file: &'a Path) -> Result<Self, SceneError> {
        let bytes = super::read_bytes(file)?;
        let text = String::from_utf8_lossy(&bytes);
        let mut table = Self { file, time_s: None, arrays: Arrays::new(), rows: 0, note: None };
        let mut rows_said = None;
        let mut header: Vec<(String, Unit)> = Vec::new();
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for (index, raw) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            let line = raw.trim();
            let place = Place::Line(index + 1);
            if let Some(comment) = line.strip_prefix('#') {
                if let Some((key, value)) = comment.split_once('=') {
                    let broken = |expected: &str| {
                        SceneError::malformed(file, place, expected, format!("{:?}", value.trim()))
                    };
                    match key.trim() {
                        "time_s" => {
                            let time = value.trim().parse::<f64>().ok().filter(|t| t.is_finite());
                            table.time_s = Some(time.ok_or_else(|| broken("a time in seconds"))?);
                        }
                        "rows" => {
                            let rows =
                                value.trim().parse::<usize>().map_err(|_| broken("a number of rows"))?;
                            rows_said = Some(rows);
                        }
                        _ => {}
                    }
                }
                continue;
            }
            if line.is_empty() {
                continue;
            }
            let separator = if line.contains(';') { ';' } else { ',' };
            let fields = line.split(separator).map(|f| f.trim().trim_matches('"').trim());
            if header.is_empty() {
                for field in fields {
                    header.push(column(field).ok_or_else(|| {
                        let expected =
                            "a column name, perhaps with a unit of m, mm, um, K, C, Pa, bar, kg/m3 …";
                        SceneError::malformed(file, place, expected, format!("{field:?}"))
                    })?);
                }
                columns = vec![Vec::new(); header.len()];
                continue;
            }
            let numbers: Vec<f64> = fields
                .map(|f| {
                    f.parse().map_err(|_| SceneError::malformed(file, place, "a number", format!("{f:?}")))
                })
                .collect::<Result<_, _>>()?;
            if numbers.len() != header.len() {
                let expected = format!("{} columns", header.len());
                return Err(SceneError::malformed(file, place, expected, numbers.len().to_string()));
            }
            for ((column, number), (_, unit)) in columns.iter_mut().zip(numbers).zip(&header) {
                column.push(number * unit.factor + unit.shift);
            }
            table.rows += 1;
        }
        if header.is_empty() {
            return Err(SceneError::malformed(file, Place::Line(1), "a header", "the end of the file"));
        }
        match rows_said {
            Some(said) if said != table.rows => {
                return Err(SceneError::length(file, "rows", said, table.rows));
            }
            None if !text.ends_with(['\n', '\r']) => {
                table.note = Some(format!("{} ends without a line end: was it cut off?", file.display()));
            }
            _ => {}
        }
        let mut seen: Vec<&str> = header.iter().map(|(name, _)| name.as_str()).collect();
        seen.sort_unstable();
        if let Some(twice) = seen.windows(2).find(|w| w[0] == w[1]) {
            let found = format!("{:?} twice", twice[0]);
            return Err(SceneError::malformed(file, Place::Line(1), "each column once", found));
        }
        table.arrays = header.into_iter().map(|h| h.0).zip(columns).collect();
        Ok(table)
    }

    /// Takes three columns out of the table, if all are there.
    fn triple(&mut self, names: [&str; 3]) -> Result<Option<Vec<[f64; 3]>>, SceneError> {
        let keys = names.map(|name| self.arrays.keys().find(|k| k.eq_ignore_ascii_case(name)).cloned());
        let [Some(a), Some(b), Some(c)] = keys else { return Ok(None) };
        let mut take = |key: &str| self.arrays.remove(key).unwrap_or_default();
        let (a, b, c) = (take(&a), take(&b), take(&c));
        Ok(Some((0..self.rows).map(|i| [a[i], b[i], c[i]]).collect()))
    }

    fn boxes(&mut self) -> Result<Vec<(Box3, bool)>, SceneError> {
        let lower = self.triple(["x_min", "y_min", "z_min"])?;
        let upper = self.triple(["x_max", "y_max", "z_max"])?;
        if let (Some(lower), Some(upper)) = (lower, upper) {
            return Ok(lower
                .into_iter()
                .zip(upper)
                .map(|(lower, upper)| (Box3 { lower, upper }, false))
                .collect());
        }
        let centre = self.triple(["x", "y", "z"])?;
        let edges = self.triple(["dx", "dy", "dz"])?;
        let volume = self.arrays.remove("volume").or_else(|| self.arrays.remove("V"));
        match (centre, edges, volume) {
            (Some(centre), Some(edges), _) => {
                Ok(centre.iter().zip(edges).map(|(c, e)| (around(c, e), false)).collect())
            }
            (Some(centre), None, Some(volume)) => {
                Ok(centre.iter().zip(volume).map(|(c, v)| (around(c, [v.cbrt(); 3]), true)).collect())
            }
            _ => Err(SceneError::missing(
                self.file,
                "the cells' shape: x, y, z with volume or with dx, dy, dz, or x_min … z_max",
                "Name the columns so, with units",
            )),
        }
    }
}

fn around(centre: &[f64; 3], edges: [f64; 3]) -> Box3 {
    Box3 {
        lower: std::array::from_fn(|a| centre[a] - 0.5 * edges[a]),
        upper: std::array::from_fn(|a| centre[a] + 0.5 * edges[a]),
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Unit {
    factor: f64,
    shift: f64,
}

const SI: Unit = Unit { factor: 1.0, shift: 0.0 };

/// Quantity and unit of a header field; `None` for an empty name or a unit in brackets that is not known.
fn column(field: &str) -> Option<(String, Unit)> {
    let bracketed = field.split_once(['[', '(']).filter(|_| field.ends_with([']', ')']));
    let (name, unit) = match bracketed {
        // Parentheses may belong to the name, as in OpenFOAM's YC7H16(l).
        Some((name, rest)) => match unit(rest.trim_end_matches([']', ')'])) {
            Some(unit) => (name.trim(), unit),
            None if field.ends_with(')') => (field, SI),
            None => return None,
        },
        None => named_unit(field),
    };
    (!name.is_empty()).then(|| (name.trim_matches('_').to_owned(), unit))
}

/// `rho_kg_m3`: the longest ending that is a unit.
fn named_unit(field: &str) -> (&str, Unit) {
    for (at, _) in field.match_indices('_') {
        // A whole name of an extent (`x_min`) is not a unit of minutes, and `Y_C7H16` is not one either.
        if at > 0
            && let Some(unit) = unit(&field[at + 1..])
        {
            return (&field[..at], unit);
        }
    }
    (field, SI)
}

fn unit(text: &str) -> Option<Unit> {
    let factor = match text.trim().replace(['^', '*', ' '], "").replace('/', "_").as_str() {
        "m" | "K" | "Pa" | "kg_m3" | "kg" | "m3" | "-" | "1" | "" => 1.0,
        "mm" | "g" => 1e-3,
        "um" | "µm" | "μm" | "micron" | "mg" => 1e-6,
        "mm3" => 1e-9,
        "cm" => 1e-2,
        "cm3" => 1e-6,
        "kPa" | "g_cm3" => 1e3,
        "MPa" => 1e6,
        "bar" => 1e5,
        "C" | "degC" | "°C" => return Some(Unit { factor: 1.0, shift: 273.15 }),
        _ => return None,
    };
    Some(Unit { factor, shift: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_names_quantity_and_unit() {
        let cases = [
            ("x_mm", "x", 1e-3),
            ("x_min_mm", "x_min", 1e-3),
            ("d [um]", "d", 1e-6),
            ("rho_kg_m3", "rho", 1.0),
            ("rho (g/cm3)", "rho", 1e3),
            ("p_bar", "p", 1e5),
            ("C7H16", "C7H16", 1.0),
            ("YC7H16(l)", "YC7H16(l)", 1.0),
            ("x_min", "x_min", 1.0),
        ];
        for (field, name, factor) in cases {
            let (found, unit) = column(field).unwrap();
            assert_eq!((found.as_str(), unit.factor, unit.shift), (name, factor, 0.0), "{field}");
        }
        assert_eq!(column("T [C]").unwrap().1, Unit { factor: 1.0, shift: 273.15 });
        assert_eq!(column("T [furlong]"), None);
    }
}
