//! The files of an EnSight Gold case: geometry, values per element, measured particles and their values.

use super::super::error::{Place, SceneError};
use super::super::shape::{Box3, polyhedron, standard_faces};
use std::path::{Path, PathBuf};

/// How the numbers of a file are written; files of values do not say it, they follow their geometry.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Coding {
    binary: bool,
    /// Binary in Fortran's records: each with its length before and after.
    records: bool,
    big_endian: bool,
}

/// Volume elements and what is needed to find their values again.
pub(super) struct Geometry {
    pub(super) coding: Coding,
    /// All volume elements in the order of the file; true: no box.
    pub(super) boxes: Vec<(Box3, bool)>,
    parts: Vec<Part>,
}

struct Part {
    number: i64,
    groups: Vec<Group>,
}

struct Group {
    kind: String,
    count: usize,
    is_volume: bool,
}

/// Particles.
pub(super) struct Cloud {
    pub(super) coding: Coding,
    pub(super) positions: Vec<[f64; 3]>,
}

/// Reads the geometry file.
pub(super) fn geometry(file: &Path) -> Result<Geometry, SceneError> {
    let mut from = Reader::open(file)?;
    from.line()?;
    from.line()?;
    let node_ids = from.ids_given("node id")?;
    let element_ids = from.ids_given("element id")?;
    let mut geometry = Geometry { coding: from.coding, boxes: Vec::new(), parts: Vec::new() };
    let mut line = from.line()?;
    if line.starts_with("extents") {
        from.extents()?;
        line = from.line()?;
    }
    loop {
        if !line.starts_with("part") {
            return Err(from.error("`part`", format!("{line:?}")));
        }
        let number = from.part_number()?;
        from.line()?;
        let coordinates = from.line()?;
        if !coordinates.starts_with("coordinates") {
            if coordinates.starts_with("block") {
                return Err(SceneError::Unsupported {
                    file: file.to_owned(),
                    what: "a structured part (`block`)".into(),
                    hint: "Export as unstructured".into(),
                });
            }
            return Err(from.error("`coordinates`", format!("{coordinates:?}")));
        }
        let points = from.count()?;
        if node_ids {
            from.integers(points)?;
        }
        let [x, y, z] = [from.floats(points)?, from.floats(points)?, from.floats(points)?];
        let point = |i: usize| [x[i], y[i], z[i]];
        let mut part = Part { number, groups: Vec::new() };
        let next = loop {
            let Some(kind) = from.line_or_end()? else { break None };
            if kind.starts_with("part") {
                break Some(kind);
            }
            let count = from.count()?;
            if element_ids {
                from.integers(count)?;
            }
            let is_volume = from.elements(&kind, count, points, &point, &mut geometry.boxes)?;
            part.groups.push(Group { kind, count, is_volume });
        };
        geometry.parts.push(part);
        match next {
            Some(next) => line = next,
            None => {
                geometry.coding = from.coding;
                return Ok(geometry);
            }
        }
    }
}

/// Values of all volume elements, in the order of [`Geometry::boxes`].
pub(super) fn element_values(file: &Path, geometry: &Geometry) -> Result<Vec<f64>, SceneError> {
    let mut from = Reader::like(file, geometry.coding)?;
    from.line()?;
    let mut by_part: Vec<Option<Vec<f64>>> = geometry.parts.iter().map(|_| None).collect();
    let mut line = from.line_or_end()?;
    while let Some(found) = line {
        if !found.starts_with("part") {
            return Err(from.error("`part`", format!("{found:?}")));
        }
        let number = from.part_number()?;
        let Some(index) = geometry.parts.iter().position(|p| p.number == number) else {
            return Err(from.error("a part of the geometry", format!("part {number}")));
        };
        let mut values = Vec::new();
        let mut groups = geometry.parts[index].groups.iter();
        line = loop {
            let Some(kind) = from.line_or_end()? else { break None };
            if kind.starts_with("part") {
                break Some(kind);
            }
            // Groups come in the order of the geometry; one without values may be left out.
            let Some(group) = groups.find(|g| g.kind == kind) else {
                return Err(from.error("an element type of the geometry, in its order", format!("{kind:?}")));
            };
            let list = from.floats(group.count)?;
            if group.is_volume {
                values.extend(list);
            }
        };
        by_part[index] = Some(values);
    }
    let values: Vec<f64> = by_part.into_iter().flatten().flatten().collect();
    if values.len() != geometry.boxes.len() {
        return Err(SceneError::length(
            file,
            "values of the volume elements",
            geometry.boxes.len(),
            values.len(),
        ));
    }
    Ok(values)
}

/// Reads a file of measured particles.
pub(super) fn measured(file: &Path) -> Result<Cloud, SceneError> {
    let mut from = Reader::open(file)?;
    from.line()?;
    let kind = from.line()?;
    if !kind.starts_with("particle coordinates") {
        return Err(from.error("`particle coordinates`", format!("{kind:?}")));
    }
    if from.coding.binary {
        let count = from.counted(|n| n.saturating_mul(16))?;
        from.integers(count)?;
        let flat = from.floats(3 * count)?;
        return Ok(Cloud {
            coding: from.coding,
            positions: flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        });
    }
    let count = from.count()?;
    let mut positions = Vec::with_capacity(from.bounded(count, 44)?);
    for _ in 0..count {
        // I8, then 3 E12.5: numbers may touch.
        let line = from.text_line()?;
        let numbers = from.columns(line.get(8..).unwrap_or_default(), 12)?;
        from.ended(&line, 8, 12)?;
        let &[x, y, z] = numbers.as_slice() else {
            return Err(from.error("a number of 8 columns and three of 12", format!("{line:?}")));
        };
        positions.push([x, y, z]);
    }
    Ok(Cloud { coding: from.coding, positions })
}

/// Values of measured particles: one header, no parts, six to a line in text.
pub(super) fn measured_values(file: &Path, count: usize, coding: Coding) -> Result<Vec<f64>, SceneError> {
    let mut from = Reader::like(file, coding)?;
    from.line()?;
    from.floats(count)
}

/// Reads lines and numbers from text or binary alike.
struct Reader {
    file: PathBuf,
    bytes: Vec<u8>,
    at: usize,
    line: usize,
    coding: Coding,
    /// The line read last was not ended by a line end.
    unended: bool,
}

impl Reader {
    /// Opens a file that says itself how it is written.
    fn open(file: &Path) -> Result<Self, SceneError> {
        let bytes = super::super::read_bytes(file)?;
        let mut coding = Coding { binary: bytes.starts_with(b"C Binary"), ..Coding::default() };
        if bytes.get(4..).is_some_and(|b| b.starts_with(b"Fortran Binary")) {
            coding = Coding { binary: true, records: true, big_endian: false };
        }
        Self::of(file, bytes, coding)
    }

    /// Opens a file that is written as its geometry is.
    fn like(file: &Path, coding: Coding) -> Result<Self, SceneError> {
        Self::of(file, super::super::read_bytes(file)?, coding)
    }

    fn of(file: &Path, bytes: Vec<u8>, coding: Coding) -> Result<Self, SceneError> {
        let mut reader = Self { file: file.to_owned(), bytes, at: 0, line: 0, coding, unended: false };
        if coding.records {
            reader.join_records()?;
        }
        if coding.binary
            && (reader.bytes.starts_with(b"C Binary") || reader.bytes.starts_with(b"Fortran Binary"))
        {
            reader.at = 80;
        }
        Ok(reader)
    }

    /// Takes the lengths of Fortran's records out: what is left is as C writes it. The first record of every file is a
    /// string of 80 bytes, which tells the byte order.
    fn join_records(&mut self) -> Result<(), SceneError> {
        let packed = std::mem::take(&mut self.bytes);
        let word = |at: usize, big: bool| -> Option<usize> {
            let raw: [u8; 4] = packed.get(at..at + 4)?.try_into().ok()?;
            usize::try_from(if big { u32::from_be_bytes(raw) } else { u32::from_le_bytes(raw) }).ok()
        };
        self.coding.big_endian = word(0, true) == Some(80);
        let big = self.coding.big_endian;
        let mut at = 0;
        while at < packed.len() {
            let record = word(at, big).and_then(|length| {
                let bytes = packed.get(at + 4..at.checked_add(4)?.checked_add(length)?)?;
                (word(at + 4 + length, big) == Some(length)).then_some(bytes)
            });
            let Some(record) = record else {
                let expected = "a Fortran record between two equal lengths";
                return Err(SceneError::malformed(
                    &self.file,
                    Place::Byte(at),
                    expected,
                    "others, or the end",
                ));
            };
            self.bytes.extend_from_slice(record);
            at += 8 + record.len();
        }
        Ok(())
    }

    fn error(&self, expected: &str, found: String) -> SceneError {
        let place = if self.coding.binary { Place::Byte(self.at) } else { Place::Line(self.line) };
        SceneError::malformed(&self.file, place, expected, found)
    }

    fn text_line(&mut self) -> Result<String, SceneError> {
        if self.at >= self.bytes.len() {
            self.line += 1;
            return Err(self.error("another line", "the end of the file".into()));
        }
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        let line = String::from_utf8_lossy(&rest[..length]).trim_end().to_owned();
        self.unended = length == rest.len();
        self.at += length + 1;
        self.line += 1;
        Ok(line)
    }

    /// Refuses a last line that was cut off within a number: what is left of it may look like one.
    fn ended(&self, line: &str, before: usize, width: usize) -> Result<(), SceneError> {
        if self.unended && (line.len() < before || !(line.len() - before).is_multiple_of(width)) {
            return Err(self.error(&format!("a number of {width} columns"), "the end of the file".into()));
        }
        Ok(())
    }

    /// 80 bytes, or a line of text; without blanks around it.
    fn line(&mut self) -> Result<String, SceneError> {
        if !self.coding.binary {
            return self.text_line().map(|l| l.trim().to_owned());
        }
        let raw = self.take(80)?;
        let end = raw.iter().position(|&b| b == 0).unwrap_or(raw.len());
        Ok(String::from_utf8_lossy(&raw[..end]).trim().to_owned())
    }

    fn line_or_end(&mut self) -> Result<Option<String>, SceneError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        if rest.iter().all(|b| b.is_ascii_whitespace()) { Ok(None) } else { self.line().map(Some) }
    }

    fn take(&mut self, length: usize) -> Result<&[u8], SceneError> {
        let rest = self.bytes.len().saturating_sub(self.at);
        if length > rest {
            return Err(self.error(&format!("{length} bytes"), format!("{rest} to the end of the file")));
        }
        self.at += length;
        Ok(&self.bytes[self.at - length..self.at])
    }

    /// Refuses a count that the rest of the file cannot hold.
    fn bounded(&self, count: usize, bytes_each: usize) -> Result<usize, SceneError> {
        let rest = self.bytes.len().saturating_sub(self.at);
        if count.saturating_mul(bytes_each) > rest + bytes_each {
            return Err(
                self.error(&format!("{count} entries"), format!("{rest} bytes to the end of the file"))
            );
        }
        Ok(count)
    }

    fn integers(&mut self, count: usize) -> Result<Vec<i64>, SceneError> {
        if self.coding.binary {
            let big = self.coding.big_endian;
            let raw = self.take(count.saturating_mul(4))?;
            return Ok(raw
                .chunks_exact(4)
                .map(|c| {
                    let b = [c[0], c[1], c[2], c[3]];
                    i64::from(if big { i32::from_be_bytes(b) } else { i32::from_le_bytes(b) })
                })
                .collect());
        }
        #[expect(clippy::cast_possible_truncation, reason = "whole numbers of ten columns fit")]
        Ok(self.text_numbers(count, 10)?.into_iter().map(|v| v as i64).collect())
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f64>, SceneError> {
        if self.coding.binary {
            let big = self.coding.big_endian;
            let raw = self.take(count.saturating_mul(4))?;
            return Ok(raw
                .chunks_exact(4)
                .map(|c| {
                    let b = [c[0], c[1], c[2], c[3]];
                    f64::from(if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) })
                })
                .collect());
        }
        self.text_numbers(count, 12)
    }

    /// Numbers in columns of fixed width, over as many lines as it takes.
    fn text_numbers(&mut self, count: usize, width: usize) -> Result<Vec<f64>, SceneError> {
        let mut numbers = Vec::with_capacity(self.bounded(count, 2)?);
        while numbers.len() < count {
            let line = self.text_line()?;
            numbers.extend(self.columns(&line, width)?);
            self.ended(&line, 0, width)?;
        }
        if numbers.len() > count {
            return Err(self.error(&format!("{count} numbers"), format!("{}", numbers.len())));
        }
        Ok(numbers)
    }

    /// Cuts at fixed columns, because negative numbers touch; at blanks if the columns do not fit.
    fn columns(&self, line: &str, width: usize) -> Result<Vec<f64>, SceneError> {
        let fixed: Option<Vec<f64>> = line.is_ascii().then_some(()).and_then(|()| {
            line.as_bytes().chunks(width).map(|c| std::str::from_utf8(c).ok()?.trim().parse().ok()).collect()
        });
        fixed
            .or_else(|| line.split_whitespace().map(|w| w.parse().ok()).collect())
            .ok_or_else(|| self.error(&format!("numbers of {width} columns"), format!("{line:?}")))
    }

    fn count(&mut self) -> Result<usize, SceneError> {
        let value = self.integers(1)?[0];
        usize::try_from(value).map_err(|_| self.error("a number that is not negative", value.to_string()))
    }

    /// A count after which this many bytes follow: tells the byte order of binary files.
    fn counted(&mut self, bytes: impl Fn(usize) -> usize) -> Result<usize, SceneError> {
        let at = self.at;
        for big_endian in [false, true] {
            self.at = at;
            self.coding.big_endian = big_endian;
            if let Ok(count) = self.count()
                && bytes(count) == self.bytes.len().saturating_sub(self.at)
            {
                return Ok(count);
            }
        }
        self.at = at;
        let rest = self.bytes.len().saturating_sub(at);
        Err(self.error(
            "a number of particles that fits the length of the file",
            format!("{rest} bytes after it"),
        ))
    }

    /// A part number; it tells the byte order, because parts are numbered from 1.
    fn part_number(&mut self) -> Result<i64, SceneError> {
        let number = self.integers(1)?[0];
        if self.coding.binary && !(1..1 << 16).contains(&number) {
            self.coding.big_endian = !self.coding.big_endian;
            self.at -= 4;
            let swapped = self.integers(1)?[0];
            if !(1..1 << 16).contains(&swapped) {
                return Err(self.error("a part number of 1 … 65535", number.to_string()));
            }
            return Ok(swapped);
        }
        Ok(number)
    }

    fn ids_given(&mut self, what: &str) -> Result<bool, SceneError> {
        let line = self.line()?;
        let rule = line.strip_prefix(what).map(str::trim);
        match rule {
            Some("given" | "ignore") => Ok(true),
            Some("off" | "assign") => Ok(false),
            _ => Err(self.error(&format!("`{what} off|given|assign|ignore`"), format!("{line:?}"))),
        }
    }

    fn extents(&mut self) -> Result<(), SceneError> {
        self.floats(6).map(|_| ())
    }

    /// Reads a group of elements; adds boxes and returns true if they are volumes.
    fn elements(
        &mut self,
        kind: &str,
        count: usize,
        points: usize,
        point: &dyn Fn(usize) -> [f64; 3],
        boxes: &mut Vec<(Box3, bool)>,
    ) -> Result<bool, SceneError> {
        match kind {
            "nfaced" => {
                self.polyhedra(count, points, point, boxes)?;
                return Ok(true);
            }
            "nsided" => {
                let corners: i64 = self.integers(count)?.iter().sum();
                let corners = usize::try_from(corners)
                    .map_err(|_| self.error("corner numbers", corners.to_string()))?;
                self.integers(corners)?;
                return Ok(false);
            }
            _ => {}
        }
        let digits = kind.trim_start_matches(|c: char| !c.is_ascii_digit());
        let nodes: usize = if kind == "point" { 1 } else { digits.parse().unwrap_or(0) };
        let corners = match kind.trim_start_matches("g_").trim_end_matches(|c: char| c.is_ascii_digit()) {
            "tetra" => 4,
            "pyramid" => 5,
            "penta" => 6,
            "hexa" => 8,
            "point" | "bar" | "tria" | "quad" => 0,
            _ => return Err(self.error("an element type", format!("{kind:?}"))),
        };
        if nodes == 0 || nodes < corners {
            return Err(self.error("an element type with its number of nodes", format!("{kind:?}")));
        }
        let flat = self.integers(count.saturating_mul(nodes))?;
        let Some(faces) = standard_faces(corners) else { return Ok(false) };
        for element in flat.chunks_exact(nodes) {
            let ids = self.nodes(&element[..corners], points)?;
            let (bounds, volume, centre) = polyhedron(|i| point(ids[i]), faces.iter().copied());
            boxes.push(bounds.stand_in(volume, centre));
        }
        Ok(true)
    }

    fn polyhedra(
        &mut self,
        count: usize,
        points: usize,
        point: &dyn Fn(usize) -> [f64; 3],
        boxes: &mut Vec<(Box3, bool)>,
    ) -> Result<(), SceneError> {
        let faces_of = self.sizes(count)?;
        let faces: usize = faces_of.iter().sum();
        let corners_of = self.sizes(faces)?;
        let flat = self.integers(corners_of.iter().sum())?;
        let ids = self.nodes(&flat, points)?;
        let mut start = 0;
        let mut sides = Vec::with_capacity(faces);
        for corners in corners_of {
            sides.push(&ids[start..start + corners]);
            start += corners;
        }
        let mut rest = sides.as_slice();
        for number in faces_of {
            let (own, others) = rest.split_at(number);
            rest = others;
            let (bounds, volume, centre) = polyhedron(point, own.iter().copied());
            boxes.push(bounds.stand_in(volume, centre));
        }
        Ok(())
    }

    fn sizes(&mut self, count: usize) -> Result<Vec<usize>, SceneError> {
        self.integers(count)?
            .into_iter()
            .map(|v| {
                usize::try_from(v)
                    .ok()
                    .filter(|&v| v > 0 && v < 1 << 20)
                    .ok_or_else(|| self.error("a number of faces or corners", v.to_string()))
            })
            .collect()
    }

    /// Node numbers from 1 made into indices from 0.
    fn nodes(&self, numbers: &[i64], points: usize) -> Result<Vec<usize>, SceneError> {
        numbers
            .iter()
            .map(|&n| {
                usize::try_from(n - 1)
                    .ok()
                    .filter(|&i| i < points)
                    .ok_or_else(|| self.error(&format!("a node of 1 … {points}"), n.to_string()))
            })
            .collect()
    }
}
