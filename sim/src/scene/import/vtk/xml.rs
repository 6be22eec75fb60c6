//! VTK's XML files: tags, data arrays (text, base64, appended, zlib), unstructured grids and clouds.

use super::super::error::{Place, SceneError};
use super::super::named::Arrays;
use super::{Cell, Piece, decimal, faces_from};
use base64::Engine;
use base64::engine::general_purpose::STANDARD_NO_PAD;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// The time a file tells in its field `TimeValue`.
pub(super) fn time(file: &Path) -> Result<Option<f64>, SceneError> {
    let document = Document::open(file)?;
    document.time()
}

/// Names of the grid and cloud files that a `.vtm` lists.
pub(super) fn blocks(file: &Path) -> Result<Vec<String>, SceneError> {
    let document = Document::open(file)?;
    Ok(document
        .tags
        .iter()
        .filter(|t| t.name == "DataSet")
        .filter_map(|t| t.attributes.get("file").cloned())
        .filter(|f| f.ends_with(".vtu") || f.ends_with(".vtp"))
        .collect())
}

/// The pieces of a `.vtu` or `.vtp`.
pub(super) fn read(file: &Path) -> Result<Vec<Piece>, SceneError> {
    let document = Document::open(file)?;
    let is_grid = match document.kind.as_str() {
        "UnstructuredGrid" => true,
        "PolyData" => false,
        other => {
            return Err(SceneError::Unsupported {
                file: file.to_owned(),
                what: format!("a VTK file of type {other:?}"),
                hint: "Export an unstructured grid (.vtu) and clouds (.vtp)".into(),
            });
        }
    };
    let time_s = document.time()?;
    let starts: Vec<usize> =
        document.tags.iter().enumerate().filter(|(_, t)| t.name == "Piece").map(|(i, _)| i).collect();
    let mut pieces = Vec::new();
    for (number, &start) in starts.iter().enumerate() {
        let end = starts.get(number + 1).copied().unwrap_or(document.tags.len());
        let mut piece = document.piece(start, end, is_grid)?;
        piece.time_s = time_s;
        pieces.push(piece);
    }
    Ok(pieces)
}

struct Document<'a> {
    file: &'a Path,
    bytes: Vec<u8>,
    kind: String,
    big_endian: bool,
    /// Bytes of a length in a data header.
    header: usize,
    zlib: bool,
    tags: Vec<Tag>,
    /// Where appended data begin, and whether they are base64.
    appended: Option<(usize, bool)>,
}

/// An opening tag, with the section it stands in.
struct Tag {
    name: String,
    attributes: BTreeMap<String, String>,
    section: String,
    /// Byte range of what follows up to the next tag.
    text: std::ops::Range<usize>,
}

impl<'a> Document<'a> {
    fn open(file: &'a Path) -> Result<Self, SceneError> {
        let bytes = super::super::read_bytes(file)?;
        let mut document = Self {
            file,
            bytes,
            kind: String::new(),
            big_endian: false,
            header: 4,
            zlib: false,
            tags: Vec::new(),
            appended: None,
        };
        document.scan()?;
        let Some(root) = document.tags.iter().find(|t| t.name == "VTKFile") else {
            return Err(document.error(0, "`<VTKFile …>`", "no such tag"));
        };
        let value = |key: &str| root.attributes.get(key).map(String::as_str).unwrap_or_default();
        document.kind = value("type").to_owned();
        document.big_endian = value("byte_order") == "BigEndian";
        document.header = if value("header_type") == "UInt64" { 8 } else { 4 };
        match value("compressor") {
            "" => {}
            "vtkZLibDataCompressor" => document.zlib = true,
            other => {
                return Err(SceneError::Unsupported {
                    file: file.to_owned(),
                    what: format!("the compressor {other}"),
                    hint: "Export with zlib or none".into(),
                });
            }
        }
        Ok(document)
    }

    /// Finds all tags; stops at appended data, which may be raw.
    fn scan(&mut self) -> Result<(), SceneError> {
        let mut at = 0;
        let mut open: Vec<String> = Vec::new();
        while let Some(offset) = self.bytes[at..].iter().position(|&b| b == b'<') {
            let start = at + offset;
            if self.bytes[start..].starts_with(b"<!--") {
                let length = find(&self.bytes[start..], b"-->").unwrap_or(self.bytes.len() - start);
                at = start + length;
                continue;
            }
            let Some(length) = self.bytes[start..].iter().position(|&b| b == b'>') else {
                return Err(self.error(start, "`>` after `<`", "the end of the file"));
            };
            let end = start + length;
            let inside = String::from_utf8_lossy(&self.bytes[start + 1..end]).into_owned();
            at = end + 1;
            if inside.starts_with('?') || inside.starts_with('!') {
                continue;
            }
            if let Some(name) = inside.strip_prefix('/') {
                if open.pop().as_deref() != Some(name.trim()) {
                    return Err(self.error(start, "a closing tag that fits", &format!("</{name}>")));
                }
                continue;
            }
            let closed = inside.ends_with('/');
            let inside = inside.trim_end_matches('/');
            let (name, rest) = inside.split_once(char::is_whitespace).unwrap_or((inside, ""));
            let attributes = attributes(rest);
            let text_end =
                at + self.bytes[at..].iter().position(|&b| b == b'<').unwrap_or(self.bytes.len() - at);
            let section = open.last().cloned().unwrap_or_default();
            if name == "AppendedData" {
                let mark = self.bytes[at..].iter().position(|&b| b == b'_');
                let mark = mark.ok_or_else(|| self.error(at, "`_` before the appended data", "none"))?;
                let is_base64 = attributes.get("encoding").is_some_and(|e| e == "base64");
                self.appended = Some((at + mark + 1, is_base64));
                return Ok(());
            }
            self.tags.push(Tag { name: name.to_owned(), attributes, section, text: at..text_end });
            if !closed {
                open.push(name.to_owned());
            }
        }
        if open.is_empty() {
            Ok(())
        } else {
            Err(self.error(self.bytes.len(), &format!("</{}>", open[open.len() - 1]), "the end of the file"))
        }
    }

    fn error(&self, at: usize, expected: &str, found: &str) -> SceneError {
        SceneError::malformed(self.file, Place::Byte(at), expected, found)
    }

    fn time(&self) -> Result<Option<f64>, SceneError> {
        let named =
            |t: &&Tag| t.name == "DataArray" && t.attributes.get("Name").is_some_and(|n| n == "TimeValue");
        let Some(tag) = self.tags.iter().find(named) else { return Ok(None) };
        let value = self.numbers(tag)?.first().copied();
        let single = tag.attributes.get("type").is_some_and(|t| t == "Float32");
        Ok(value.map(|v| if single { decimal(v) } else { v }))
    }

    fn piece(&self, start: usize, end: usize, is_grid: bool) -> Result<Piece, SceneError> {
        let mut piece = Piece { is_grid, ..Piece::default() };
        let mut topology: BTreeMap<String, Vec<i64>> = BTreeMap::new();
        for tag in self.tags[start..end].iter().filter(|t| t.name == "DataArray") {
            let name = tag.attributes.get("Name").cloned().unwrap_or_default();
            let components: usize =
                tag.attributes.get("NumberOfComponents").and_then(|n| n.parse().ok()).unwrap_or(1);
            match tag.section.as_str() {
                "Points" => {
                    let flat = self.numbers(tag)?;
                    piece.points = flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
                }
                "Cells" => {
                    #[expect(
                        clippy::cast_possible_truncation,
                        reason = "indices are whole numbers below 2⁵³"
                    )]
                    let whole = self.numbers(tag)?.into_iter().map(|v| v as i64).collect();
                    topology.insert(name, whole);
                }
                "CellData" if is_grid && components == 1 => {
                    piece.cell_arrays.insert(name, self.numbers(tag)?);
                }
                "PointData" if !is_grid && components == 1 => {
                    piece.point_arrays.insert(name, self.numbers(tag)?);
                }
                _ => {}
            }
        }
        self.check_count(&self.tags[start], "NumberOfPoints", piece.points.len())?;
        self.check_arrays(&piece.point_arrays, piece.points.len())?;
        if is_grid {
            piece.cells = self.cells(&topology)?;
            self.check_count(&self.tags[start], "NumberOfCells", piece.cells.len())?;
            self.check_arrays(&piece.cell_arrays, piece.cells.len())?;
        }
        Ok(piece)
    }

    fn check_count(&self, tag: &Tag, key: &str, found: usize) -> Result<(), SceneError> {
        match tag.attributes.get(key).and_then(|n| n.parse::<usize>().ok()) {
            Some(expected) if expected != found => Err(SceneError::length(self.file, key, expected, found)),
            _ => Ok(()),
        }
    }

    fn check_arrays(&self, arrays: &Arrays, expected: usize) -> Result<(), SceneError> {
        match arrays.iter().find(|(_, v)| v.len() != expected) {
            Some((name, v)) => {
                Err(SceneError::length(self.file, format!("values of {name:?}"), expected, v.len()))
            }
            None => Ok(()),
        }
    }

    fn cells(&self, topology: &BTreeMap<String, Vec<i64>>) -> Result<Vec<Cell>, SceneError> {
        let need = |name: &str| {
            topology.get(name).ok_or_else(|| {
                SceneError::missing(
                    self.file,
                    format!("the array {name:?} of the cells"),
                    "Export the file again",
                )
            })
        };
        let (corners, offsets, kinds) = (need("connectivity")?, need("offsets")?, need("types")?);
        if offsets.len() != kinds.len() {
            return Err(SceneError::length(self.file, "types of cells", offsets.len(), kinds.len()));
        }
        let broken = |index: usize| {
            self.error(0, "offsets and faces that fit the lists", &format!("others at cell {index}"))
        };
        let mut cells = Vec::with_capacity(kinds.len());
        let mut start = 0;
        for (index, (&end, &kind)) in offsets.iter().zip(kinds).enumerate() {
            let end = usize::try_from(end).map_err(|_| broken(index))?;
            let list = corners.get(start..end).ok_or_else(|| broken(index))?;
            let corners = list
                .iter()
                .map(|&p| usize::try_from(p).ok())
                .collect::<Option<_>>()
                .ok_or_else(|| broken(index))?;
            let faces = if kind == 42 && topology.contains_key("polyhedron_offsets") {
                self.polyhedron(topology, index).ok_or_else(|| broken(index))?
            } else if kind == 42 {
                let (faces, ends) = (need("faces")?, need("faceoffsets")?);
                // faceoffsets hold the end of each polyhedron's faces, −1 for other cells.
                let before =
                    ends.get(..index).and_then(|e| e.iter().rev().find(|&&e| e >= 0)).copied().unwrap_or(0);
                usize::try_from(before)
                    .ok()
                    .and_then(|b| faces_from(faces.get(b..)?))
                    .ok_or_else(|| broken(index))?
            } else {
                Vec::new()
            };
            cells.push(Cell { kind: u8::try_from(kind).map_err(|_| broken(index))?, corners, faces });
            start = end;
        }
        Ok(cells)
    }

    /// Faces of a polyhedron in the way of files since VTK 9.4: cells list faces, faces list points.
    fn polyhedron(&self, topology: &BTreeMap<String, Vec<i64>>, index: usize) -> Option<Vec<Vec<usize>>> {
        let list = |ends: &str, items: &str, index: usize| -> Option<Vec<usize>> {
            let ends = topology.get(ends)?;
            let start =
                index.checked_sub(1).map_or(Some(0), |before| usize::try_from(*ends.get(before)?).ok())?;
            let end = usize::try_from(*ends.get(index)?).ok()?;
            let items = topology.get(items)?.get(start..end)?;
            items.iter().map(|&i| usize::try_from(i).ok()).collect()
        };
        let faces = list("polyhedron_offsets", "polyhedron_to_faces", index)?;
        let faces: Vec<Vec<usize>> = faces
            .into_iter()
            .map(|face| list("face_offsets", "face_connectivity", face))
            .collect::<Option<_>>()?;
        (!faces.is_empty() && faces.iter().all(|f| !f.is_empty())).then_some(faces)
    }

    /// The numbers of a data array.
    fn numbers(&self, tag: &Tag) -> Result<Vec<f64>, SceneError> {
        let at = tag.text.start;
        let kind = tag.attributes.get("type").map(String::as_str).unwrap_or_default();
        let raw = match tag.attributes.get("format").map(String::as_str) {
            Some("binary") => self.base64_block(&self.bytes[tag.text.clone()], at)?,
            Some("appended") => {
                let offset = tag.attributes.get("offset").and_then(|o| o.parse::<usize>().ok());
                let (Some(offset), Some((start, is_base64))) = (offset, self.appended) else {
                    return Err(self.error(at, "appended data and an offset", "none"));
                };
                let from = self.bytes.get(start.saturating_add(offset)..).unwrap_or_default();
                if is_base64 {
                    self.base64_block(from, start + offset)?
                } else {
                    self.raw_block(from, start + offset)?
                }
            }
            _ => return self.text_numbers(tag),
        };
        decode(&raw, kind, self.big_endian)
            .ok_or_else(|| self.error(at, "a number type that VTK has", &format!("{kind:?}")))
    }

    fn text_numbers(&self, tag: &Tag) -> Result<Vec<f64>, SceneError> {
        String::from_utf8_lossy(&self.bytes[tag.text.clone()])
            .split_whitespace()
            .map(|w| w.parse().map_err(|_| self.error(tag.text.start, "numbers", &format!("{w:?}"))))
            .collect()
    }

    fn length(&self, raw: &[u8]) -> Option<usize> {
        let value = match (self.header, self.big_endian) {
            (4, false) => u64::from(u32::from_le_bytes(raw.get(..4)?.try_into().ok()?)),
            (4, true) => u64::from(u32::from_be_bytes(raw.get(..4)?.try_into().ok()?)),
            (_, false) => u64::from_le_bytes(raw.get(..8)?.try_into().ok()?),
            (_, true) => u64::from_be_bytes(raw.get(..8)?.try_into().ok()?),
        };
        usize::try_from(value).ok()
    }

    /// Lengths of the parts after a compressed block's header: (bytes of the header, packed lengths).
    fn packed_lengths(&self, raw: &[u8]) -> Option<(usize, Vec<usize>)> {
        let count = self.length(raw)?;
        if count > raw.len() {
            return None;
        }
        let lengths =
            (0..count).map(|i| self.length(raw.get((3 + i) * self.header..)?)).collect::<Option<Vec<_>>>()?;
        Some(((3 + count) * self.header, lengths))
    }

    fn raw_block(&self, from: &[u8], at: usize) -> Result<Vec<u8>, SceneError> {
        let short = || self.error(at, "data of the length in their header", "the end of the data");
        if self.zlib {
            let (header, lengths) = self.packed_lengths(from).ok_or_else(short)?;
            let packed = from.get(header..header + lengths.iter().sum::<usize>()).ok_or_else(short)?;
            return self.inflate(packed, &lengths, at);
        }
        let length = self.length(from).ok_or_else(short)?;
        from.get(self.header..).and_then(|d| d.get(..length)).map(<[u8]>::to_vec).ok_or_else(short)
    }

    /// Base64 with its header in the same stream or, as with a compressor, in one of its own.
    fn base64_block(&self, text: &[u8], at: usize) -> Result<Vec<u8>, SceneError> {
        let clean: Vec<u8> = text
            .iter()
            .copied()
            .skip_while(u8::is_ascii_whitespace)
            .take_while(|b| {
                b.is_ascii_alphanumeric() || matches!(b, b'+' | b'/' | b'=' | b'\n' | b'\r' | b' ')
            })
            .filter(|b| !b.is_ascii_whitespace())
            .collect();
        let decode = |part: &[u8]| {
            let end = part.iter().position(|&b| b == b'=').unwrap_or(part.len());
            STANDARD_NO_PAD.decode(&part[..end]).map_err(|e| self.error(at, "base64", &e.to_string()))
        };
        let chars = |bytes: usize| 4 * bytes.div_ceil(3);
        let short = || self.error(at, "data of the length in their header", "the end of the data");
        if self.zlib {
            let first = decode(clean.get(..chars(self.header)).ok_or_else(short)?)?;
            let count = self.length(&first).filter(|&c| c <= clean.len()).ok_or_else(short)?;
            let header_chars = chars((3 + count) * self.header);
            let header = decode(clean.get(..header_chars).ok_or_else(short)?)?;
            let (_, lengths) = self.packed_lengths(&header).ok_or_else(short)?;
            let packed_chars = chars(lengths.iter().sum());
            let packed = decode(clean.get(header_chars..header_chars + packed_chars).ok_or_else(short)?)?;
            return self.inflate(&packed, &lengths, at);
        }
        let own_stream = clean.get(chars(self.header) - 1) == Some(&b'=');
        if own_stream {
            let header = decode(&clean[..chars(self.header)])?;
            let length = self.length(&header).ok_or_else(short)?;
            let start = chars(self.header);
            let mut data = decode(clean.get(start..start + chars(length)).ok_or_else(short)?)?;
            data.truncate(length);
            return Ok(data);
        }
        let first = decode(clean.get(..chars(self.header)).ok_or_else(short)?)?;
        let length = self.length(&first).ok_or_else(short)?;
        let whole = chars(length.checked_add(self.header).ok_or_else(short)?);
        let mut data = decode(clean.get(..whole).ok_or_else(short)?)?;
        data.drain(..self.header);
        Ok(data)
    }

    fn inflate(&self, packed: &[u8], lengths: &[usize], at: usize) -> Result<Vec<u8>, SceneError> {
        let mut data = Vec::new();
        let mut rest = packed;
        for &length in lengths {
            let (part, after) = rest
                .split_at_checked(length)
                .ok_or_else(|| self.error(at, "packed data", "the end of the data"))?;
            flate2::read::ZlibDecoder::new(part)
                .read_to_end(&mut data)
                .map_err(|e| self.error(at, "zlib data", &e.to_string()))?;
            rest = after;
        }
        Ok(data)
    }
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes.windows(wanted.len()).position(|w| w == wanted)
}

fn attributes(text: &str) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut rest = text;
    while let Some((key, after)) = rest.split_once('=') {
        let after = after.trim_start();
        let Some(quote) = after.chars().next().filter(|q| *q == '"' || *q == '\'') else { break };
        let Some((value, next)) = after[1..].split_once(quote) else { break };
        found.insert(key.trim().to_owned(), value.to_owned());
        rest = next;
    }
    found
}

/// Numbers of VTK's type names; `None` for a name that is none.
pub(super) fn decode(raw: &[u8], kind: &str, big_endian: bool) -> Option<Vec<f64>> {
    fn each<const N: usize>(raw: &[u8], big: bool, value: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        raw.chunks_exact(N)
            .map(|c| value(std::array::from_fn(|i| if big { c[N - 1 - i] } else { c[i] })))
            .collect()
    }
    let big = big_endian;
    Some(match kind {
        "Float32" | "float" => each(raw, big, |b| f64::from(f32::from_le_bytes(b))),
        "Float64" | "double" => each(raw, big, f64::from_le_bytes),
        "Int8" | "char" => each(raw, big, |b: [u8; 1]| f64::from(i8::from_le_bytes(b))),
        "UInt8" | "unsigned_char" => each(raw, big, |b: [u8; 1]| f64::from(b[0])),
        "Int16" | "short" => each(raw, big, |b| f64::from(i16::from_le_bytes(b))),
        "UInt16" | "unsigned_short" => each(raw, big, |b| f64::from(u16::from_le_bytes(b))),
        "Int32" | "int" => each(raw, big, |b| f64::from(i32::from_le_bytes(b))),
        "UInt32" | "unsigned_int" => each(raw, big, |b| f64::from(u32::from_le_bytes(b))),
        "Int64" | "long" | "vtktypeint64" | "vtkIdType" => each(raw, big, |b| i64::from_le_bytes(b) as f64),
        "UInt64" | "unsigned_long" | "vtktypeuint64" => each(raw, big, |b| u64::from_le_bytes(b) as f64),
        _ => return None,
    })
}
