//! VTK's legacy files (`# vtk DataFile Version`): text or big-endian binary, versions 2.0 to 5.1.
//!
//! OpenFOAM puts a `FIELD FieldData 1 TimeValue` block between `DATASET` and `POINTS`, where other readers stop.

use super::super::error::{Place, SceneError};
use super::super::named::Arrays;
use super::xml::decode;
use super::{Cell, Piece, decimal, faces_from};
use std::io::Read;
use std::path::Path;

/// Reads a file.
pub(super) fn read(file: &Path) -> Result<Piece, SceneError> {
    let bytes = super::super::read_bytes(file)?;
    let mut from = Reader { file, bytes: &bytes, at: 0, binary: false };
    let first = from.line()?;
    if !first.starts_with("# vtk DataFile") {
        return Err(from.error("`# vtk DataFile Version`", &first));
    }
    from.line()?;
    from.binary = from.line()?.trim() == "BINARY";
    let mut piece = Piece::default();
    let mut topology = Topology::default();
    let mut place = Section::Dataset;
    // Tuples of the arrays of this section.
    let mut tuples = 0;
    while let Some(line) = from.line_or_end() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(&key) = words.first() else { continue };
        let count = |i: usize| words.get(i).and_then(|w| w.parse::<usize>().ok());
        let need = |i: usize| count(i).ok_or_else(|| from.error("a number in this line", &line));
        match key {
            "DATASET" => match words.get(1).copied() {
                Some("UNSTRUCTURED_GRID") => piece.is_grid = true,
                Some("POLYDATA") => {}
                _ => {
                    return Err(SceneError::Unsupported {
                        file: file.to_owned(),
                        what: line,
                        hint: "Export an unstructured grid".into(),
                    });
                }
            },
            "POINTS" => {
                let number = need(1)?.saturating_mul(3);
                let flat = from.numbers(number, words.get(2).copied().unwrap_or("float"))?;
                piece.points = flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
            }
            "CELLS" => {
                let (cells, size) = (need(1)?, need(2)?);
                topology.read(&mut from, cells, size)?;
            }
            "CELL_TYPES" => topology.kinds = whole(from.numbers(need(1)?, "int")?),
            "VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS" => {
                let (count, size) = (need(1)?, need(2)?);
                Topology::default().read(&mut from, count, size)?;
            }
            "CELL_DATA" => (place, tuples) = (Section::Cells, need(1)?),
            "POINT_DATA" => (place, tuples) = (Section::Points, need(1)?),
            "FIELD" => {
                for _ in 0..need(2)? {
                    field_array(&mut from, place, &mut piece)?;
                }
            }
            "SCALARS" => {
                let components = count(3).unwrap_or(1);
                let name = words.get(1).copied().unwrap_or_default().to_owned();
                let kind = words.get(2).copied().unwrap_or("float").to_owned();
                from.line()?;
                let values = from.numbers(tuples.saturating_mul(components), &kind)?;
                keep(place, &mut piece, name, values, components);
            }
            "VECTORS" | "NORMALS" => {
                from.numbers(tuples.saturating_mul(3), words.get(2).copied().unwrap_or("float"))?;
            }
            "METADATA" => from.pass_metadata(),
            _ => return Err(from.error("a keyword of the format", &line)),
        }
    }
    if piece.is_grid {
        piece.cells = topology.cells(&from)?;
    }
    Ok(piece)
}

/// True if the head of a file says that it holds points and surfaces, as clouds are written; false if it cannot be read.
pub(super) fn is_poly_data(file: &Path) -> bool {
    // Two lines of at most 256 characters, BINARY or ASCII, DATASET.
    let mut head = Vec::new();
    let read = std::fs::File::open(file).and_then(|f| f.take(1024).read_to_end(&mut head));
    read.is_ok() && String::from_utf8_lossy(&head).lines().take(4).any(|l| l.trim() == "DATASET POLYDATA")
}

#[derive(Clone, Copy, PartialEq)]
enum Section {
    Dataset,
    Cells,
    Points,
}

/// `name components tuples type`, then the values.
fn field_array(from: &mut Reader<'_>, place: Section, piece: &mut Piece) -> Result<(), SceneError> {
    let mut line = from.next_line()?;
    while line == "METADATA" {
        from.pass_metadata();
        line = from.next_line()?;
    }
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[name, components, tuples, kind] = words.as_slice() else {
        return Err(from.error("name, components, tuples and type", &line));
    };
    let (Ok(components), Ok(tuples)) = (components.parse::<usize>(), tuples.parse::<usize>()) else {
        return Err(from.error("numbers of components and tuples", &line));
    };
    let values = from.numbers(components.saturating_mul(tuples), kind)?;
    if place == Section::Dataset {
        if name == "TimeValue" {
            piece.time_s = values.first().map(|&v| if kind == "float" { decimal(v) } else { v });
        }
    } else {
        keep(place, piece, name.to_owned(), values, components);
    }
    Ok(())
}

fn keep(place: Section, piece: &mut Piece, name: String, values: Vec<f64>, components: usize) {
    let arrays: &mut Arrays = match place {
        Section::Cells => &mut piece.cell_arrays,
        _ => &mut piece.point_arrays,
    };
    if components == 1 {
        arrays.insert(name, values);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "indices are whole numbers below 2⁵³")]
fn whole(values: Vec<f64>) -> Vec<i64> {
    values.into_iter().map(|v| v as i64).collect()
}

#[derive(Default)]
struct Topology {
    /// Per cell what its line holds, without the leading length.
    lists: Vec<Vec<i64>>,
    kinds: Vec<i64>,
}

impl Topology {
    /// `CELLS cells size`, or since version 5.1 `CELLS cells+1 size` with `OFFSETS` and `CONNECTIVITY`.
    fn read(&mut self, from: &mut Reader<'_>, cells: usize, size: usize) -> Result<(), SceneError> {
        let back = from.at;
        if let Some(line) = from.line_or_end()
            && let Some(kind) = line.strip_prefix("OFFSETS")
        {
            let offsets = whole(from.numbers(cells, kind.trim())?);
            let line = from.next_line()?;
            let kind = line.strip_prefix("CONNECTIVITY").map(str::trim).unwrap_or_default().to_owned();
            let flat = whole(from.numbers(size, &kind)?);
            for pair in offsets.windows(2) {
                let range = usize::try_from(pair[0]).ok().zip(usize::try_from(pair[1]).ok());
                let list = range.and_then(|(a, b)| flat.get(a..b));
                self.lists
                    .push(list.ok_or_else(|| from.error("offsets that fit the list", "others"))?.to_vec());
            }
            return Ok(());
        }
        from.at = back;
        let flat = whole(from.numbers(size, "int")?);
        let mut rest = flat.as_slice();
        for index in 0..cells {
            let split =
                rest.split_first().and_then(|(&n, after)| after.split_at_checked(usize::try_from(n).ok()?));
            let Some((list, after)) = split else {
                return Err(from.error("as many corners as the cells say", &format!("fewer at cell {index}")));
            };
            self.lists.push(list.to_vec());
            rest = after;
        }
        Ok(())
    }

    fn cells(self, from: &Reader<'_>) -> Result<Vec<Cell>, SceneError> {
        if self.kinds.len() != self.lists.len() {
            return Err(SceneError::length(from.file, "types of cells", self.lists.len(), self.kinds.len()));
        }
        let broken = || from.error("cells with corners and faces", "a broken list");
        self.lists
            .into_iter()
            .zip(self.kinds)
            .map(|(list, kind)| {
                let kind = u8::try_from(kind).map_err(|_| broken())?;
                if kind == 42 {
                    return Ok(Cell {
                        kind,
                        corners: Vec::new(),
                        faces: faces_from(&list).ok_or_else(broken)?,
                    });
                }
                let corners = list.iter().map(|&p| usize::try_from(p).ok()).collect::<Option<_>>();
                Ok(Cell { kind, corners: corners.ok_or_else(broken)?, faces: Vec::new() })
            })
            .collect()
    }
}

struct Reader<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    at: usize,
    binary: bool,
}

impl Reader<'_> {
    fn error(&self, expected: &str, found: &str) -> SceneError {
        let place = if self.binary {
            Place::Byte(self.at)
        } else {
            Place::Line(self.bytes[..self.at.min(self.bytes.len())].iter().filter(|&&b| b == b'\n').count())
        };
        let shown: String = found.chars().take(40).collect();
        SceneError::malformed(self.file, place, expected, format!("{shown:?}"))
    }

    fn line(&mut self) -> Result<String, SceneError> {
        self.line_or_end().ok_or_else(|| self.error("another line", "the end of the file"))
    }

    /// The next line that is not blank: in text the rest of a line of numbers comes first.
    fn next_line(&mut self) -> Result<String, SceneError> {
        loop {
            let line = self.line()?;
            if !line.is_empty() {
                return Ok(line);
            }
        }
    }

    /// Remarks on an array, up to a blank line.
    fn pass_metadata(&mut self) {
        while self.line_or_end().is_some_and(|l| !l.is_empty()) {}
    }

    fn line_or_end(&mut self) -> Option<String> {
        let rest = self.bytes.get(self.at..).filter(|r| !r.is_empty())?;
        let length = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += length + 1;
        Some(String::from_utf8_lossy(&rest[..length]).trim().to_owned())
    }

    fn numbers(&mut self, count: usize, kind: &str) -> Result<Vec<f64>, SceneError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        if !self.binary {
            let mut values = Vec::new();
            let mut used = 0;
            while values.len() < count {
                used += rest[used..].iter().take_while(|b| b.is_ascii_whitespace()).count();
                let word = &rest[used..];
                let length = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
                let parsed = std::str::from_utf8(&word[..length]).ok().and_then(|w| w.parse().ok());
                let Some(value) = parsed else {
                    self.at += used;
                    return Err(self.error("a number", &String::from_utf8_lossy(&word[..length])));
                };
                if length == word.len() {
                    // What is left of a number that was cut off may look like one.
                    self.at += used;
                    return Err(self.error("a line end after the last number", "the end of the file"));
                }
                values.push(value);
                used += length;
            }
            self.at += used;
            return Ok(values);
        }
        let width = match kind {
            "float" | "int" | "unsigned_int" => 4,
            "char" | "unsigned_char" => 1,
            "short" | "unsigned_short" => 2,
            "double" | "long" | "unsigned_long" | "vtktypeint64" | "vtkIdType" => 8,
            _ => return Err(self.error("a number type of the format", kind)),
        };
        let length = count.saturating_mul(width);
        let Some(raw) = rest.get(..length) else {
            return Err(
                self.error(&format!("{length} bytes of {kind}"), &format!("{} to the end", rest.len()))
            );
        };
        self.at += length;
        // A line end follows binary data.
        if self.bytes.get(self.at) == Some(&b'\n') {
            self.at += 1;
        }
        decode(raw, kind, true).ok_or_else(|| self.error("a number type of the format", kind))
    }
}
