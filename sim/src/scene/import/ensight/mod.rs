//! EnSight Gold: the case file, its time sets, and how its files make one spray.
//!
//! Text, C and Fortran binary of either byte order; gas per element, parcels as measured particles. Does not read
//! structured blocks, single-file transients or gas per node. Seen from OpenFOAM v1912's `foamToEnsight`; the rules are those
//! of the EnSight User Manual, chapter "EnSight Gold Casefile Format".

mod files;

use super::super::field::CfdSpray;
use super::error::{Place, SceneError};
use super::named::{self, Arrays};
use super::{ImportOptions, Made};
use std::path::{Path, PathBuf};

/// A case file, read.
#[derive(Debug, Default)]
pub(super) struct Case {
    file: PathBuf,
    model: Option<Named>,
    measured: Option<Named>,
    variables: Vec<Variable>,
    sets: Vec<TimeSet>,
}

/// A file name, perhaps with `*` for the step, and the number of its time set.
#[derive(Debug, Clone)]
struct Named {
    set: Option<i64>,
    file: String,
}

#[derive(Debug)]
struct Variable {
    kind: Kind,
    name: String,
    file: Named,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Element,
    Measured,
    Other,
}

#[derive(Debug, Default)]
struct TimeSet {
    number: i64,
    steps: usize,
    start: i64,
    increment: i64,
    numbers: Vec<i64>,
    values: Vec<f64>,
}

/// Reads a `.case` file.
pub(super) fn open(file: &Path) -> Result<Case, SceneError> {
    let bytes = super::read_bytes(file)?;
    let text = String::from_utf8_lossy(&bytes);
    if !text.to_ascii_lowercase().contains("ensight gold") {
        return Err(SceneError::malformed(file, Place::Whole, "`type: ensight gold`", "no such line"));
    }
    let mut case = Case { file: file.to_owned(), ..Case::default() };
    let mut section = String::new();
    // Numbers may go on over the following lines; this is the list they belong to.
    let mut list = "";
    for (index, raw) in text.lines().enumerate() {
        let line = raw.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let broken = |expected: &str| {
            SceneError::malformed(file, Place::Line(index + 1), expected, format!("{raw:?}"))
        };
        let Some((key, value)) = line.split_once(':') else {
            if line.chars().all(|c| c.is_ascii_uppercase() || c == ' ') {
                section = line.to_owned();
                list = "";
            } else {
                case.add_numbers(list, line).ok_or_else(|| broken("a section or numbers"))?;
            }
            continue;
        };
        let key = key.trim().to_ascii_lowercase();
        match section.as_str() {
            "GEOMETRY" if key == "model" => {
                case.model = Some(named_file(value).ok_or_else(|| broken("a file"))?)
            }
            "GEOMETRY" if key == "measured" => {
                case.measured = Some(named_file(value).ok_or_else(|| broken("a file"))?);
            }
            "VARIABLE" => {
                if let Some(variable) = variable(&key, value) {
                    case.variables.push(variable);
                }
            }
            "TIME" => {
                list = case.time_entry(&key, value).ok_or_else(|| broken("a time entry with its numbers"))?;
            }
            _ => {}
        }
    }
    case.check(&text)?;
    Ok(case)
}

impl Case {
    /// What a case must have; one that was cut off lacks some of it.
    fn check(&self, text: &str) -> Result<(), SceneError> {
        let refuse = |expected: String, found: String| {
            let end = Place::Line(text.lines().count());
            Err(SceneError::malformed(&self.file, end, expected, found))
        };
        if self.model.is_none() && self.measured.is_none() {
            return refuse("a model or measured particles under GEOMETRY".into(), "none".into());
        }
        let named = self.model.iter().chain(&self.measured).chain(self.variables.iter().map(|v| &v.file));
        for set in named.filter_map(|n| n.set) {
            if !self.sets.iter().any(|s| s.number == set) {
                return refuse(format!("time set {set} under TIME"), "none".into());
            }
        }
        for set in &self.sets {
            let (steps, values) = (set.steps, set.values.len());
            if steps != values && (steps > 0 || values == 0) {
                return refuse(
                    format!("{} time values of set {}", steps.max(1), set.number),
                    values.to_string(),
                );
            }
        }
        if !self.sets.is_empty() && !text.ends_with(['\n', '\r']) {
            return refuse("a line end after the last number".into(), "the end of the file".into());
        }
        Ok(())
    }

    /// All times in seconds, ascending as the case gives them; a case without times has the one time 0.
    pub(super) fn times(&self) -> Vec<f64> {
        let longest = self.sets.iter().max_by_key(|s| s.values.len()).map(|s| s.values.clone());
        longest.filter(|v| !v.is_empty()).unwrap_or_else(|| vec![0.0])
    }

    /// Reads one of the times.
    pub(super) fn read(&self, time_s: f64, options: &ImportOptions) -> Result<CfdSpray, SceneError> {
        let mut made = Made { time_s, ..Made::default() };
        let mut coding = None;
        if let Some(model) = &self.model {
            let file = self.path(model, time_s)?;
            let geometry = files::geometry(&file)?;
            coding = Some(geometry.coding);
            let mut arrays = Arrays::new();
            for variable in self.variables.iter().filter(|v| v.kind == Kind::Element) {
                let values = files::element_values(&self.path(&variable.file, time_s)?, &geometry)?;
                arrays.insert(variable.name.clone(), values);
            }
            if !geometry.boxes.is_empty() {
                named::add_cells(&mut made, &self.file, &geometry.boxes, &arrays, options)?;
            }
        }
        if let Some(measured) = &self.measured {
            let cloud = files::measured(&self.path(measured, time_s)?)?;
            // Values are written by the same program in the same way; text says nothing of it.
            let values_coding = if cloud.coding == files::Coding::default() {
                coding.unwrap_or(cloud.coding)
            } else {
                cloud.coding
            };
            let mut arrays = Arrays::new();
            let wanted =
                |v: &&Variable| v.kind == Kind::Measured && named::is_parcel_quantity(plain_name(&v.name));
            for variable in self.variables.iter().filter(wanted) {
                let file = self.path(&variable.file, time_s)?;
                let values = files::measured_values(&file, cloud.positions.len(), values_coding)?;
                arrays.insert(plain_name(&variable.name).to_owned(), values);
            }
            named::add_parcels(&mut made, &self.file, &cloud.positions, &arrays)?;
        }
        made.finish(&self.file, options)
    }

    fn time_entry(&mut self, key: &str, value: &str) -> Option<&'static str> {
        if key == "time set" {
            let number = value.split_whitespace().next()?.parse().ok()?;
            self.sets.push(TimeSet { number, increment: 1, ..TimeSet::default() });
            return Some("");
        }
        let set = self.sets.last_mut()?;
        match key {
            "number of steps" => set.steps = value.trim().parse().ok()?,
            "filename start number" => set.start = value.trim().parse().ok()?,
            "filename increment" => set.increment = value.trim().parse().ok()?,
            "filename numbers" => return self.add_numbers("numbers", value).map(|()| "numbers"),
            "time values" => return self.add_numbers("values", value).map(|()| "values"),
            _ => {}
        }
        Some("")
    }

    fn add_numbers(&mut self, list: &str, text: &str) -> Option<()> {
        let set = self.sets.last_mut()?;
        for word in text.split_whitespace() {
            match list {
                "numbers" => set.numbers.push(word.parse().ok()?),
                "values" => set.values.push(word.parse().ok()?),
                _ => return None,
            }
        }
        Some(())
    }

    /// The file of a name at a time: `*` becomes the step's number, padded with zeros to the number of stars.
    fn path(&self, named: &Named, time_s: f64) -> Result<PathBuf, SceneError> {
        let folder = self.file.parent().unwrap_or(Path::new("."));
        let stars = named.file.matches('*').count();
        if stars == 0 {
            return Ok(folder.join(&named.file));
        }
        let set = named.set.and_then(|n| self.sets.iter().find(|s| s.number == n)).or(self.sets.first());
        let number = set.and_then(|set| {
            let step = set
                .values
                .iter()
                .enumerate()
                .min_by(|a, b| (a.1 - time_s).abs().total_cmp(&(b.1 - time_s).abs()))
                .map_or(0, |s| s.0);
            if set.numbers.is_empty() {
                Some(set.start + set.increment * i64::try_from(step).ok()?)
            } else {
                set.numbers.get(step).copied()
            }
        });
        let number = number.ok_or_else(|| {
            SceneError::missing(
                &self.file,
                format!("the number of {} at {time_s} s", named.file),
                "Check TIME",
            )
        })?;
        Ok(folder.join(named.file.replace(&"*".repeat(stars), &format!("{number:0stars$}"))))
    }
}

/// `[time set] [file set] name`.
fn named_file(value: &str) -> Option<Named> {
    let words: Vec<&str> = value.split_whitespace().filter(|w| !w.starts_with("change_coords")).collect();
    Some(Named { set: words.first()?.parse().ok(), file: words.last()?.trim_matches('"').to_owned() })
}

/// `scalar per element: [time set] [file set] name file`.
fn variable(key: &str, value: &str) -> Option<Variable> {
    let kind = match key {
        "scalar per element" => Kind::Element,
        "scalar per measured node" => Kind::Measured,
        _ => Kind::Other,
    };
    let words: Vec<&str> = value.split_whitespace().collect();
    let file = words.last()?;
    let name = words.get(words.len().checked_sub(2)?)?;
    let set = if words.len() > 2 { words[0].parse().ok() } else { None };
    Some(Variable { kind, name: (*name).to_owned(), file: Named { set, file: (*file).to_owned() } })
}

/// OpenFOAM puts `c0` before the names of cloud 0.
fn plain_name(name: &str) -> &str {
    let rest = name.strip_prefix('c').map(|r| r.trim_start_matches(|c: char| c.is_ascii_digit()));
    match rest {
        Some(rest) if !rest.is_empty() && rest.len() + 1 < name.len() => rest,
        _ => name,
    }
}
