//! From a table of recorded frames to a stack: which frame is what, checked, and written in the order of levels and cycles.
//!
//! Every complaint names the table's line and the frame's file. Nothing is written before the whole table makes sense,
//! and `case.json` comes last: a folder without it is no stack.

use crate::estimate::accumulate::BLANKS_MAX;
use crate::files::npy::NpyBlock;
use crate::files::recorded::{Frame, RawLayout, Recordings};
use crate::files::write_atomic;
use crate::stack::CaseCurve;
use crate::tables::TextTable;
use ditd_drivers::instrument::ShotKind;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Saturated part of a frame that is told.
const SATURATED_TOLD: f64 = 0.01;

/// Warnings that are told at most.
const WARNINGS_MAX: usize = 20;

/// What the table does not say.
#[derive(Debug, Clone)]
pub struct Constants {
    /// `case.json` to begin with: names and values that are carried over; null for none.
    pub case: Value,
    /// Transmittance of a window.
    pub gamma: f64,
    /// Emissivity of the plate.
    pub emissivity_plate: f64,
    /// Samples from this count on are saturated.
    pub saturation_count: u16,
    /// The camera's curve, if known.
    pub calibration: Option<CaseCurve>,
    /// Raw layout of files that do not describe themselves; the table's columns come first.
    pub raw: RawDefaults,
    /// Part of a frame's pixels that may be saturated.
    pub saturated_max: f64,
}

/// Raw layout as far as it was given.
#[derive(Debug, Clone, Copy, Default)]
pub struct RawDefaults {
    /// Bytes before the first frame.
    pub header_bytes: Option<u64>,
    /// Rows of a frame.
    pub rows: Option<usize>,
    /// Columns of a frame.
    pub columns: Option<usize>,
    /// Whether the high byte comes first.
    pub big_endian: Option<bool>,
    /// Bits of a sample.
    pub bits: Option<u32>,
}

/// What was imported.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Imported {
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub columns: usize,
    /// Blanks of each spray frame.
    pub blanks_per_spray: u16,
    /// Plate temperature of each level, in K.
    pub plate_temperature_k: Vec<Option<f64>>,
    /// Cycles of each level.
    pub cycles: Vec<usize>,
    /// Frames of the table that were discarded.
    pub discarded: usize,
    /// Part of the samples of each level that are saturated.
    pub saturated: Vec<f64>,
    /// What the operator should look at.
    pub warnings: Vec<String>,
}

/// A line of the table.
#[derive(Debug, Clone)]
struct Entry {
    line: usize,
    file: PathBuf,
    frame: usize,
    level: String,
    plate_k: Option<f64>,
    kind: Option<ShotKind>,
    time_s: Option<f64>,
    cycle: Option<String>,
    layout: Option<RawLayout>,
}

/// One spray frame and its blanks.
struct Cycle {
    spray: Entry,
    blanks: Vec<Entry>,
}

struct Level {
    name: String,
    cycles: Vec<Cycle>,
}

/// Reads the table at `table`, whose file names are relative to it, and writes the stack `out`.
///
/// # Errors
///
/// What is wrong, with file and line, in words.
pub fn import(table: &Path, out: &Path, constants: &Constants) -> Result<Imported, String> {
    let entries = entries(table, &constants.raw)?;
    let discarded = entries.iter().filter(|entry| entry.kind.is_none()).count();
    let levels = levels(table, entries)?;
    let blanks = levels[0].cycles[0].blanks.len();
    if out.join("case.json").exists() {
        return Err(format!("{}: is a stack already; it is never overwritten", out.display()));
    }
    std::fs::create_dir_all(out).map_err(|error| format!("{}: {error}", out.display()))?;
    let mut writer = Writer::new(table, constants);
    if let Err(why) = levels.iter().try_for_each(|level| writer.level(level, out)) {
        // What was begun is taken away, so that a mended table can be imported.
        for (block, name) in [(&writer.spray, "spray.npy"), (&writer.blank, "nospray.npy")] {
            if block.is_some() {
                let _ = std::fs::remove_file(out.join(name));
            }
        }
        return Err(why);
    }
    let Writer { shape, spray, blank, saturated, warnings, .. } = writer;
    for block in [spray, blank] {
        block.ok_or("the table has no frames")?.sync().map_err(|error| error.to_string())?;
    }
    let (rows, columns) = shape.ok_or("the table has no frames")?;
    let imported = Imported {
        rows,
        columns,
        blanks_per_spray: u16::try_from(blanks).map_err(|_| "too many blanks".to_owned())?,
        plate_temperature_k: levels.iter().map(plate_k).collect(),
        cycles: levels.iter().map(|level| level.cycles.len()).collect(),
        discarded,
        saturated,
        warnings,
    };
    let case = case(&imported, constants, table);
    let text = serde_json::to_string_pretty(&case).expect("numbers and texts") + "\n";
    write_atomic(&out.join("case.json"), text.as_bytes()).map_err(|error| error.to_string())?;
    Ok(imported)
}

fn at(table: &Path, line: usize) -> String {
    format!("{}:{line}", table.display())
}

/// The table's lines.
fn entries(table: &Path, raw: &RawDefaults) -> Result<Vec<Entry>, String> {
    let text = TextTable::read(table).map_err(|error| error.message)?;
    if text.is_empty() {
        return Err(format!("{}: no frames below the header", table.display()));
    }
    let folder = table.parent().unwrap_or(Path::new(""));
    let needed = |name: &str| {
        text.texts(name).ok_or_else(|| {
            format!(
                "{}: no column `{name}`; needed are file, kind, and level or plate_temperature_k",
                table.display()
            )
        })
    };
    let (files, kinds) = (needed("file")?, needed("kind")?);
    let first = |names: &[&str]| names.iter().find_map(|name| text.texts(name));
    let frames = first(&["frame", "page"]);
    let cycles = first(&["cycle", "pair"]);
    let (levels, plates, times) =
        (text.texts("level"), first(&["plate_temperature_k"]), text.texts("time_s"));
    if levels.is_none() && plates.is_none() {
        return Err(format!("{}: neither a column `level` nor `plate_temperature_k`", table.display()));
    }
    let layout = Layouts {
        header: text.texts("header_bytes"),
        rows: text.texts("rows"),
        columns: text.texts("columns"),
        order: text.texts("byte_order"),
        bits: text.texts("bits"),
    };
    (0..text.len())
        .map(|row| {
            let line = text.line(row);
            let wrong = |what: String| format!("{}: {what}", at(table, line));
            let cell = |column: &Option<Vec<&str>>| {
                column.as_ref().map(|column| column[row]).filter(|cell| !cell.is_empty()).map(str::to_owned)
            };
            let number = |column: &Option<Vec<&str>>, name: &str| -> Result<Option<f64>, String> {
                let Some(text) = cell(column) else { return Ok(None) };
                let value: f64 =
                    text.parse().map_err(|_| wrong(format!("{name}: {text:?} is not a number")))?;
                if value.is_finite() {
                    Ok(Some(value))
                } else {
                    Err(wrong(format!("{name}: {text} is not finite")))
                }
            };
            let kind = match kinds[row].to_lowercase().as_str() {
                "spray" => Some(ShotKind::Spray),
                "blank" | "nospray" | "no_spray" => Some(ShotKind::Blank),
                "discarded" | "discard" | "warm_up" | "warmup" => None,
                other => {
                    let what = format!("kind: {other:?} is none of spray, blank, discarded");
                    return Err(wrong(what));
                }
            };
            if files[row].is_empty() {
                return Err(wrong("file: is empty".into()));
            }
            let file = folder.join(files[row]);
            let frame = match cell(&frames) {
                None => 0,
                Some(text) => text.parse().map_err(|_| {
                    wrong(format!("frame: {text:?} is not a number of a frame (0 the first)"))
                })?,
            };
            let plate_k = number(&plates, "plate_temperature_k")?;
            if plate_k.is_some_and(|kelvin| kelvin <= 0.0) {
                return Err(wrong("plate_temperature_k: must be above 0 K".into()));
            }
            let level = cell(&levels).or_else(|| plate_k.map(|kelvin| kelvin.to_string()));
            let level = match (level, kind) {
                (Some(level), _) => level,
                (None, None) => String::new(),
                (None, Some(_)) => return Err(wrong("neither a level nor a plate temperature".into())),
            };
            Ok(Entry {
                line,
                layout: layout
                    .of(row, raw, &file)
                    .map_err(|why| wrong(format!("{}: {why}", file.display())))?,
                file,
                frame,
                level,
                plate_k,
                kind,
                time_s: number(&times, "time_s")?,
                cycle: cell(&cycles),
            })
        })
        .collect()
}

/// The table's own columns about raw files.
struct Layouts<'a> {
    header: Option<Vec<&'a str>>,
    rows: Option<Vec<&'a str>>,
    columns: Option<Vec<&'a str>>,
    order: Option<Vec<&'a str>>,
    bits: Option<Vec<&'a str>>,
}

impl Layouts<'_> {
    fn of(&self, row: usize, raw: &RawDefaults, file: &Path) -> Result<Option<RawLayout>, String> {
        if crate::files::recorded::describes_itself(file) {
            return Ok(None);
        }
        fn cell<T: std::str::FromStr>(
            column: Option<&Vec<&str>>,
            row: usize,
            name: &str,
            given: Option<T>,
        ) -> Result<T, String> {
            match column.map(|column| column[row]).filter(|cell| !cell.is_empty()) {
                Some(text) => text.parse().map_err(|_| format!("{name}: {text:?} is not a whole number")),
                None => given.ok_or_else(|| {
                    format!(
                        "raw frames need {name}: a column of the table, or --raw-{}",
                        name.replace('_', "-")
                    )
                }),
            }
        }
        let order = match self.order.as_ref().map(|column| column[row].to_lowercase()).as_deref() {
            Some("little" | "le" | "<") => Some(false),
            Some("big" | "be" | ">") => Some(true),
            None | Some("") => raw.big_endian,
            Some(other) => return Err(format!("byte_order: {other:?} is neither little nor big")),
        };
        Ok(Some(RawLayout {
            header_bytes: cell(self.header.as_ref(), row, "header_bytes", raw.header_bytes)?,
            rows: cell(self.rows.as_ref(), row, "rows", raw.rows)?,
            columns: cell(self.columns.as_ref(), row, "columns", raw.columns)?,
            big_endian: order
                .ok_or("raw frames need byte_order: a column of the table, or --raw-byte-order")?,
            bits: cell(self.bits.as_ref(), row, "bits", raw.bits)?,
        }))
    }
}

/// Levels in the order of their numbers, or of the table where they are no numbers.
fn levels(table: &Path, entries: Vec<Entry>) -> Result<Vec<Level>, String> {
    let mut names: Vec<String> = Vec::new();
    for entry in entries.iter().filter(|entry| entry.kind.is_some()) {
        if !names.contains(&entry.level) {
            names.push(entry.level.clone());
        }
    }
    let as_numbers: Option<Vec<f64>> = names.iter().map(|name| name.parse().ok()).collect();
    if let Some(numbers) = as_numbers {
        let mut order: Vec<usize> = (0..names.len()).collect();
        order.sort_by(|&a, &b| numbers[a].total_cmp(&numbers[b]));
        names = order.into_iter().map(|k| names[k].clone()).collect();
    }
    if names.is_empty() {
        return Err(format!("{}: no spray and no blank frame", table.display()));
    }
    let mut twice = entries.iter().filter(|entry| entry.kind.is_some()).collect::<Vec<_>>();
    twice.sort_by(|a, b| (&a.file, a.frame, a.line).cmp(&(&b.file, b.frame, b.line)));
    if let Some(pair) =
        twice.windows(2).find(|pair| (&pair[0].file, pair[0].frame) == (&pair[1].file, pair[1].frame))
    {
        return Err(format!(
            "{}: {} frame {} was taken in line {} already",
            at(table, pair[1].line),
            pair[1].file.display(),
            pair[1].frame,
            pair[0].line
        ));
    }
    let mut blanks = None;
    names
        .into_iter()
        .map(|name| {
            let mut own: Vec<Entry> =
                entries.iter().filter(|e| e.kind.is_some() && e.level == name).cloned().collect();
            // By time where every frame has one; the order of the table else.
            if own.iter().all(|entry| entry.time_s.is_some()) {
                own.sort_by(|a, b| a.time_s.unwrap_or(0.0).total_cmp(&b.time_s.unwrap_or(0.0)));
            }
            let cycles = paired(table, &name, own, &mut blanks)?;
            Ok(Level { name, cycles })
        })
        .collect()
}

/// Cycles of a level: by their numbers where there are any, else every spray frame takes as many blanks as there are for
/// each, in order.
fn paired(
    table: &Path,
    level: &str,
    own: Vec<Entry>,
    expected: &mut Option<usize>,
) -> Result<Vec<Cycle>, String> {
    let (sprays, blanks): (Vec<Entry>, Vec<Entry>) =
        own.into_iter().partition(|entry| entry.kind == Some(ShotKind::Spray));
    let place = sprays.first().or(blanks.first()).map_or(0, |entry| entry.line);
    let numbered = sprays.iter().chain(&blanks).filter(|entry| entry.cycle.is_some()).count();
    if numbered > 0 && numbered < sprays.len() + blanks.len() {
        let without = sprays.iter().chain(&blanks).find(|entry| entry.cycle.is_none());
        let entry = without.expect("some have no number");
        return Err(format!(
            "{}: {} has no cycle where other frames of level {level} have",
            at(table, entry.line),
            entry.file.display()
        ));
    }
    if sprays.is_empty() || blanks.is_empty() {
        return Err(format!(
            "{}: level {level} has {} spray and {} blank frames: both are needed",
            at(table, place),
            sprays.len(),
            blanks.len()
        ));
    }
    let groups: Vec<(Entry, Vec<Entry>)> = if numbered > 0 {
        let mut left = blanks;
        let mut groups = Vec::new();
        for spray in sprays {
            let (mine, others): (Vec<Entry>, Vec<Entry>) =
                left.into_iter().partition(|blank| blank.cycle == spray.cycle);
            left = others;
            groups.push((spray, mine));
        }
        if let Some(blank) = left.first() {
            return Err(format!(
                "{}: {} is a blank of cycle {}, of which level {level} has no other spray frame",
                at(table, blank.line),
                blank.file.display(),
                blank.cycle.as_deref().unwrap_or_default()
            ));
        }
        groups
    } else {
        let each = blanks.len() / sprays.len();
        if each == 0 || each * sprays.len() != blanks.len() {
            return Err(format!(
                "{}: level {level} has {} spray and {} blank frames: as many blanks are needed for every spray frame, \
                 or a column `cycle` that says which belong together",
                at(table, place),
                sprays.len(),
                blanks.len()
            ));
        }
        let mut blanks = blanks.into_iter();
        sprays.into_iter().map(|spray| (spray, blanks.by_ref().take(each).collect())).collect()
    };
    for (spray, mine) in &groups {
        let wanted = *expected.get_or_insert(mine.len());
        if mine.len() != wanted || wanted == 0 || wanted > usize::from(BLANKS_MAX) {
            return Err(format!(
                "{}: {} has {} blanks where every spray frame of a stack has the same number, {} (1 … {BLANKS_MAX})",
                at(table, spray.line),
                spray.file.display(),
                mine.len(),
                wanted.max(1)
            ));
        }
    }
    Ok(groups.into_iter().map(|(spray, blanks)| Cycle { spray, blanks }).collect())
}

/// Mean plate temperature at the spray frames, or the blanks' where those have none.
fn plate_k(level: &Level) -> Option<f64> {
    let of_sprays: Vec<f64> = level.cycles.iter().filter_map(|cycle| cycle.spray.plate_k).collect();
    let of_blanks = || level.cycles.iter().flat_map(|cycle| &cycle.blanks).filter_map(|blank| blank.plate_k);
    let known = if of_sprays.is_empty() { of_blanks().collect() } else { of_sprays };
    let first = *known.first()?;
    // A mean of equal numbers may differ from them by rounding.
    if known.iter().all(|kelvin| kelvin.to_bits() == first.to_bits()) {
        return Some(first);
    }
    #[expect(clippy::cast_precision_loss, reason = "a number of frames")]
    let count = known.len() as f64;
    Some(known.iter().sum::<f64>() / count)
}

/// Writes frames and looks at them.
struct Writer<'a> {
    table: &'a Path,
    constants: &'a Constants,
    recordings: Recordings,
    shape: Option<(usize, usize)>,
    spray: Option<NpyBlock>,
    blank: Option<NpyBlock>,
    saturated: Vec<f64>,
    warnings: Vec<String>,
}

impl<'a> Writer<'a> {
    fn new(table: &'a Path, constants: &'a Constants) -> Self {
        Self {
            table,
            constants,
            recordings: Recordings::default(),
            shape: None,
            spray: None,
            blank: None,
            saturated: Vec::new(),
            warnings: Vec::new(),
        }
    }

    fn level(&mut self, level: &Level, out: &Path) -> Result<(), String> {
        let (mut saturated, mut samples) = (0.0, 0.0);
        for cycle in &level.cycles {
            for (entry, is_spray) in
                std::iter::once((&cycle.spray, true)).chain(cycle.blanks.iter().map(|blank| (blank, false)))
            {
                let frame = self.read(entry)?;
                let part = self.judge(entry, &frame)?;
                #[expect(clippy::cast_precision_loss, reason = "a number of pixels")]
                let pixels = frame.counts.len() as f64;
                saturated += part * pixels;
                samples += pixels;
                let (block, name) =
                    if is_spray { (&mut self.spray, "spray.npy") } else { (&mut self.blank, "nospray.npy") };
                if block.is_none() {
                    let path = out.join(name);
                    *block = Some(
                        NpyBlock::create(&path, frame.rows, frame.columns)
                            .map_err(|error| format!("{error}. Is there an unfinished import?"))?,
                    );
                }
                if let Some(block) = block {
                    block.append(&frame.counts).map_err(|error| error.to_string())?;
                }
            }
        }
        self.saturated.push(saturated / samples);
        if plate_k(level).is_none() {
            self.warn(format!("level {} has no plate temperature: it will be left out of maps", level.name));
        }
        Ok(())
    }

    fn warn(&mut self, text: String) {
        if self.warnings.len() < WARNINGS_MAX {
            self.warnings.push(text);
        }
    }

    fn read(&mut self, entry: &Entry) -> Result<Frame, String> {
        let place = at(self.table, entry.line);
        let frame = self
            .recordings
            .frame(&entry.file, entry.frame, entry.layout.as_ref())
            .map_err(|error| format!("{place}: {error}"))?;
        let (rows, columns) = *self.shape.get_or_insert((frame.rows, frame.columns));
        if (frame.rows, frame.columns) != (rows, columns) {
            return Err(format!(
                "{place}: {} frame {} is {} x {} pixels, the first one was {rows} x {columns}",
                entry.file.display(),
                entry.frame,
                frame.rows,
                frame.columns
            ));
        }
        Ok(frame)
    }

    /// Saturated part of a frame.
    fn judge(&mut self, entry: &Entry, frame: &Frame) -> Result<f64, String> {
        let limit = self.constants.saturation_count;
        let saturated = frame.counts.iter().filter(|&&count| count >= limit).count();
        #[expect(clippy::cast_precision_loss, reason = "numbers of pixels")]
        let part = saturated as f64 / frame.counts.len() as f64;
        let place = at(self.table, entry.line);
        let file = entry.file.display();
        let text = format!(
            "{place}: {file} frame {}: {:.1} % of the pixels are saturated (at {limit} counts or more)",
            entry.frame,
            100.0 * part
        );
        if part > self.constants.saturated_max {
            return Err(text);
        }
        if part > SATURATED_TOLD {
            self.warn(text);
        }
        Ok(part)
    }
}

/// The stack's `case.json`: what was given, and what the table says over it.
fn case(imported: &Imported, constants: &Constants, table: &Path) -> Value {
    let mut case = if constants.case.is_object() { constants.case.clone() } else { json!({}) };
    // x that was given for the very same levels stays; else it follows from curve and temperatures.
    let given: Option<Vec<Option<f64>>> = serde_json::from_value(case["setpoints_K"].clone())
        .ok()
        .filter(|given| *given == imported.plate_temperature_k);
    let keeps_x = given.is_some()
        && case["gamma"].as_f64() == Some(constants.gamma)
        && case["x_counts"].as_array().is_some_and(|x| x.len() == imported.cycles.len());
    let own = case.as_object_mut().expect("an object, see above");
    if !keeps_x {
        own.remove("x_counts");
    }
    let name = table.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    own.entry("name").or_insert(json!(name));
    own.insert("pairs_per_setpoint".into(), json!(imported.cycles));
    own.insert("setpoints_K".into(), json!(imported.plate_temperature_k));
    own.insert("blanks_per_spray".into(), json!(imported.blanks_per_spray));
    own.insert("gamma".into(), json!(constants.gamma));
    own.insert("eps_B".into(), json!(constants.emissivity_plate));
    own.insert("saturation_count".into(), json!(constants.saturation_count));
    match &constants.calibration {
        Some(curve) => own.insert("calibration".into(), json!(curve)),
        None => own.remove("calibration"),
    };
    case
}
