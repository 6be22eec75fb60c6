//! One OpenFOAM file: header, then a list or a field, in text or binary, packed or not.
//!
//! Knows the syntax only; what a list means is decided by the caller. The header is text in binary files too;
//! `arch "LSB;label=32;scalar=64"` tells the sizes. Seen with OpenFOAM v1912.
//!
//! A collated file (`decomposedBlockData`) holds one block of bytes for each processor; the first begins with the header
//! that counts for all (`decomposedBlockData.C`).

use super::super::error::{Place, SceneError};
use std::path::{Path, PathBuf};

/// Longest list `N{value}` of whole numbers that is believed; meshes have no such lists but of a few entries.
const EQUAL_LABELS_MAX: usize = 1 << 26;

/// A value for all, or one for each.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Values {
    /// `uniform 523` of a field: one value for however many cells there are.
    Uniform(f64),
    /// One value each.
    Each(Vec<f64>),
}

/// Polygons: face `f` has the points `point[start[f]..start[f + 1]]`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Faces {
    pub(super) start: Vec<u32>,
    pub(super) point: Vec<u32>,
}

impl Faces {
    pub(super) fn len(&self) -> usize {
        self.start.len() - 1
    }

    pub(super) fn points(&self, face: usize) -> &[u32] {
        &self.point[self.start[face] as usize..self.start[face + 1] as usize]
    }
}

/// Where a parcel is, in either of OpenFOAM's ways.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spot {
    /// Position in metres.
    Cartesian([f64; 3]),
    /// Weights of a tetrahedron's corners, cell, face and point of the face that name the tetrahedron.
    Barycentric { weights: [f64; 4], cell: usize, face: usize, tet_point: usize },
}

/// A file with its header read.
#[derive(Debug)]
pub(super) struct FoamFile {
    path: PathBuf,
    bytes: Vec<u8>,
    /// Where the bytes begin in the file.
    origin: usize,
    body: usize,
    binary: bool,
    big_endian: bool,
    label: usize,
    scalar: usize,
    class: String,
}

/// A folder of one part of a case: its own, or one that it shares with other processors.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Folder {
    pub(super) path: PathBuf,
    /// Which block of a collated file is this part's; 0 where files are not shared.
    pub(super) block: usize,
}

impl Folder {
    pub(super) fn join(&self, name: &str) -> Self {
        Self { path: self.path.join(name), block: self.block }
    }

    /// The file itself, or its packed twin; `None` if there is neither.
    pub(super) fn file(&self, name: &str) -> Option<PathBuf> {
        let plain = self.path.join(name);
        let packed = self.path.join(format!("{name}.gz"));
        [plain, packed].into_iter().find(|p| p.is_file())
    }
}

impl FoamFile {
    /// Opens `name` or `name.gz` in a folder; `None` if there is neither, or nothing in it for this part.
    pub(super) fn find(folder: &Folder, name: &str) -> Result<Option<Self>, SceneError> {
        match folder.file(name) {
            Some(path) => Self::open(&path, folder.block),
            None => Ok(None),
        }
    }

    /// Opens `name` or `name.gz` in a folder.
    pub(super) fn need(folder: &Folder, name: &str) -> Result<Self, SceneError> {
        Self::find(folder, name)?.ok_or_else(|| {
            SceneError::missing(
                &folder.path.join(name),
                "this file (or its .gz)",
                "Copy the whole case, mesh included",
            )
        })
    }

    fn open(path: &Path, block: usize) -> Result<Option<Self>, SceneError> {
        let mut file = Self::of(path, super::super::read_bytes(path)?, 0);
        file.read_header()?;
        if file.class != "decomposedBlockData" {
            return Ok(Some(file));
        }
        let mut at = file.start();
        let (mut first, mut own) = (0..0, 0..0);
        for number in 0..=block {
            let length = at.count()?;
            at.skip_space();
            at.raw(length, 1)?;
            let end = if length > 0 { at.at - 1 } else { at.at };
            own = end - length..end;
            if number == 0 {
                first = own.clone();
            }
        }
        let mut head = Self::of(path, file.bytes[first.clone()].to_vec(), first.start);
        head.read_header()?;
        if block == 0 {
            return Ok(Some(head));
        }
        let bytes = file.bytes[own.clone()].to_vec();
        // A processor without parcels has nothing in its block.
        let is_empty = bytes.iter().all(u8::is_ascii_whitespace);
        Ok((!is_empty).then_some(Self { bytes, body: 0, origin: own.start, ..head }))
    }

    fn of(path: &Path, bytes: Vec<u8>, origin: usize) -> Self {
        Self {
            path: path.to_owned(),
            bytes,
            origin,
            body: 0,
            binary: false,
            big_endian: false,
            label: 4,
            scalar: 8,
            class: String::new(),
        }
    }

    fn read_header(&mut self) -> Result<(), SceneError> {
        let mut at = Cursor { file: self, at: 0 };
        at.skip_space();
        if at.word() != b"FoamFile" {
            return Err(self.malformed(at.at.saturating_sub(8), "an OpenFOAM header `FoamFile {`", None));
        }
        at.expect(b'{')?;
        let mut entries = Vec::new();
        loop {
            at.skip_space();
            if at.peek() == Some(b'}') {
                at.at += 1;
                break;
            }
            let key = String::from_utf8_lossy(at.word()).into_owned();
            let start = at.at;
            while at.peek().is_some_and(|b| b != b';') {
                // `arch` has semicolons inside its quotes.
                if at.peek() == Some(b'"') {
                    at.at += 1;
                    while at.peek().is_some_and(|b| b != b'"') {
                        at.at += 1;
                    }
                }
                at.at += 1;
            }
            if at.peek().is_none() {
                return Err(self.malformed(self.bytes.len(), "the header to end with `}`", None));
            }
            entries.push((key, String::from_utf8_lossy(&self.bytes[start..at.at]).trim().to_owned()));
            at.at += 1;
        }
        self.body = at.at;
        for (key, value) in entries {
            match key.as_str() {
                "format" => self.binary = value == "binary",
                "class" => self.class = value,
                "arch" => {
                    self.big_endian = value.contains("MSB");
                    self.label = if value.contains("label=64") { 8 } else { 4 };
                    self.scalar = if value.contains("scalar=32") { 4 } else { 8 };
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// The file's path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Everything after the header, as text; for dictionaries.
    pub(super) fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes[self.body..]).into_owned()
    }

    /// The internal field of a scalar gas field.
    pub(super) fn internal_field(&self) -> Result<Values, SceneError> {
        let key = b"internalField";
        let found = self.bytes[self.body..].windows(key.len()).position(|w| w == key);
        let Some(offset) = found else {
            return Err(self.malformed(self.bytes.len(), "`internalField`", None));
        };
        let mut at = Cursor { file: self, at: self.body + offset + key.len() };
        at.skip_space();
        match at.word() {
            b"uniform" => Ok(Values::Uniform(at.number()?)),
            b"nonuniform" => {
                at.skip_space();
                if at.peek().is_some_and(|b| b.is_ascii_alphabetic()) {
                    at.word();
                }
                at.scalars().map(Values::Each)
            }
            _ => Err(at.error("`uniform` or `nonuniform`")),
        }
    }

    /// A list of scalars, one for each of this many parcels.
    pub(super) fn scalars(&self, expected: usize) -> Result<Vec<f64>, SceneError> {
        // Asked before anything is reserved: `4000000000{1}` is a valid list.
        let found = self.start().count()?;
        if found != expected {
            return Err(SceneError::length(&self.path, "values of the parcels", expected, found));
        }
        self.start().scalars()
    }

    /// A list of whole numbers that are not negative.
    pub(super) fn labels(&self) -> Result<Vec<u32>, SceneError> {
        let mut at = self.start();
        at.labels()
    }

    /// A list of points.
    pub(super) fn vectors(&self) -> Result<Vec<[f64; 3]>, SceneError> {
        let mut at = self.start();
        let count = at.count()?;
        if self.binary {
            let raw = at.raw(count, 3 * self.scalar)?;
            let flat = self.decode_scalars(raw);
            return Ok(flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect());
        }
        at.expect(b'(')?;
        let mut points = Vec::with_capacity(at.bounded(count, 7)?);
        for _ in 0..count {
            points.push(at.tuple()?);
        }
        at.expect(b')')?;
        Ok(points)
    }

    /// The faces of a mesh: `faceList` or `faceCompactList`.
    pub(super) fn faces(&self) -> Result<Faces, SceneError> {
        let mut at = self.start();
        if self.class == "faceCompactList" {
            let start = at.labels()?;
            let point = at.labels()?;
            let ordered = start.windows(2).all(|w| w[0] <= w[1]);
            if !ordered || start.first() != Some(&0) || start.last().map(|&s| s as usize) != Some(point.len())
            {
                return Err(self.malformed(
                    self.body,
                    "ascending offsets that end at the number of points",
                    None,
                ));
            }
            return Ok(Faces { start, point });
        }
        let count = at.count()?;
        let mut faces = Faces { start: Vec::with_capacity(at.bounded(count, 6)? + 1), point: Vec::new() };
        faces.start.push(0);
        at.expect(b'(')?;
        for _ in 0..count {
            let corners = at.count()?;
            if self.binary {
                let raw = at.raw(corners, self.label)?;
                faces.point.extend(self.decode_labels(raw, at.at)?);
            } else {
                at.expect(b'(')?;
                for _ in 0..at.bounded(corners, 2)? {
                    faces.point.push(at.label()?);
                }
                at.expect(b')')?;
            }
            faces.start.push(self.narrow(faces.point.len() as i64, at.at)?);
        }
        at.expect(b')')?;
        Ok(faces)
    }

    /// The places of all parcels: a `positions` or `coordinates` file, told apart by their records.
    ///
    /// OpenFOAM.org from version 5 writes barycentric records into a file called `positions`.
    pub(super) fn spots(&self) -> Result<Vec<Spot>, SceneError> {
        let mut at = self.start();
        let count = at.count()?;
        at.expect(b'(')?;
        let mut spots = Vec::with_capacity(at.bounded(count, 5)?);
        for _ in 0..count {
            at.expect(b'(')?;
            spots.push(if self.binary { at.binary_spot()? } else { at.text_spot()? });
        }
        at.expect(b')')?;
        Ok(spots)
    }

    fn start(&self) -> Cursor<'_> {
        Cursor { file: self, at: self.body }
    }

    fn decode_scalars(&self, raw: &[u8]) -> Vec<f64> {
        match (self.scalar, self.big_endian) {
            (4, false) => decode(raw, |b| f64::from(f32::from_le_bytes(b))),
            (4, true) => decode(raw, |b| f64::from(f32::from_be_bytes(b))),
            (_, false) => decode(raw, f64::from_le_bytes),
            (_, true) => decode(raw, f64::from_be_bytes),
        }
    }

    fn decode_labels(&self, raw: &[u8], at: usize) -> Result<Vec<u32>, SceneError> {
        let wide: Vec<i64> = match (self.label, self.big_endian) {
            (4, false) => decode(raw, |b| i64::from(i32::from_le_bytes(b))),
            (4, true) => decode(raw, |b| i64::from(i32::from_be_bytes(b))),
            (_, false) => decode(raw, i64::from_le_bytes),
            (_, true) => decode(raw, i64::from_be_bytes),
        };
        wide.into_iter().map(|v| self.narrow(v, at)).collect()
    }

    fn narrow(&self, value: i64, at: usize) -> Result<u32, SceneError> {
        u32::try_from(value)
            .map_err(|_| self.malformed(at, "a whole number of 0 … 2³²−1", Some(value.to_string())))
    }

    fn malformed(&self, at: usize, expected: &str, found: Option<String>) -> SceneError {
        let at = at.min(self.bytes.len());
        let place = if self.binary || self.origin > 0 {
            Place::Byte(self.origin + at)
        } else {
            Place::Line(1 + self.bytes[..at].iter().filter(|&&b| b == b'\n').count())
        };
        let found = found.unwrap_or_else(|| match &self.bytes[at..] {
            [] => "the end of the file".to_owned(),
            rest => format!("{:?}", String::from_utf8_lossy(&rest[..rest.len().min(24)])),
        });
        SceneError::malformed(&self.path, place, expected, found)
    }
}

fn decode<const N: usize, T>(raw: &[u8], value: impl Fn([u8; N]) -> T) -> Vec<T> {
    raw.chunks_exact(N).map(|c| value(std::array::from_fn(|i| c[i]))).collect()
}

/// A place in a file.
#[derive(Clone, Copy)]
struct Cursor<'a> {
    file: &'a FoamFile,
    at: usize,
}

impl<'a> Cursor<'a> {
    fn rest(&self) -> &'a [u8] {
        self.file.bytes.get(self.at..).unwrap_or_default()
    }

    fn peek(&self) -> Option<u8> {
        self.file.bytes.get(self.at).copied()
    }

    fn error(&self, expected: &str) -> SceneError {
        self.file.malformed(self.at, expected, None)
    }

    /// Passes blanks and comments.
    fn skip_space(&mut self) {
        loop {
            let rest = self.rest();
            self.at += rest.iter().take_while(|b| b.is_ascii_whitespace()).count();
            let rest = self.rest();
            if rest.starts_with(b"//") {
                self.at += rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
            } else if rest.starts_with(b"/*") {
                self.at += rest.windows(2).position(|w| w == b"*/").map_or(rest.len(), |p| p + 2);
            } else {
                return;
            }
        }
    }

    /// The next run of bytes without blanks, brackets or semicolons; `List<scalar>` is one word.
    fn word(&mut self) -> &'a [u8] {
        self.skip_space();
        let rest = self.rest();
        let ends = |b: &u8| b.is_ascii_whitespace() || matches!(b, b'(' | b')' | b'{' | b'}' | b';');
        let length = rest.iter().position(ends).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    fn expect(&mut self, byte: u8) -> Result<(), SceneError> {
        self.skip_space();
        if self.peek() != Some(byte) {
            return Err(self.error(&format!("`{}`", char::from(byte))));
        }
        self.at += 1;
        Ok(())
    }

    fn number(&mut self) -> Result<f64, SceneError> {
        self.skip_space();
        let start = *self;
        let word = self.word();
        std::str::from_utf8(word).ok().and_then(|w| w.parse().ok()).ok_or_else(|| start.error("a number"))
    }

    fn label(&mut self) -> Result<u32, SceneError> {
        self.skip_space();
        let start = *self;
        let word = self.word();
        let mut value: u32 = 0;
        for &byte in word {
            let digit = byte.wrapping_sub(b'0');
            let next = value.checked_mul(10).and_then(|v| v.checked_add(u32::from(digit)));
            match next {
                Some(next) if digit < 10 => value = next,
                _ => return Err(start.error("a whole number of 0 … 2³²−1")),
            }
        }
        if word.is_empty() { Err(start.error("a whole number")) } else { Ok(value) }
    }

    fn count(&mut self) -> Result<usize, SceneError> {
        self.label().map(|n| n as usize)
    }

    /// Refuses a count that the rest of the file cannot hold, so that a foreign file cannot ask for all memory.
    fn bounded(&self, count: usize, bytes_each: usize) -> Result<usize, SceneError> {
        if count.saturating_mul(bytes_each) > self.rest().len() + bytes_each {
            return Err(self.file.malformed(
                self.file.bytes.len(),
                &format!("{count} entries of a list"),
                Some("the end of the file".into()),
            ));
        }
        Ok(count)
    }

    /// `(` raw bytes `)`; an empty list may lack the brackets.
    fn raw(&mut self, count: usize, size: usize) -> Result<&'a [u8], SceneError> {
        if count == 0 {
            if self.rest().starts_with(b"()") {
                self.at += 2;
            }
            return Ok(&[]);
        }
        self.expect(b'(')?;
        let length = count * size;
        let raw = self.rest().get(..length).ok_or_else(|| {
            let found = format!("{} bytes to the end of the file", self.rest().len());
            self.file.malformed(self.at, &format!("{length} bytes of a list of {count}"), Some(found))
        })?;
        self.at += length;
        self.expect(b')')?;
        Ok(raw)
    }

    fn scalars(&mut self) -> Result<Vec<f64>, SceneError> {
        let count = self.count()?;
        self.skip_space();
        if self.peek() == Some(b'{') {
            self.at += 1;
            let value = self.number()?;
            self.expect(b'}')?;
            return Ok(vec![value; count]);
        }
        if self.file.binary {
            let raw = self.raw(count, self.file.scalar)?;
            return Ok(self.file.decode_scalars(raw));
        }
        self.expect(b'(')?;
        let mut values = Vec::with_capacity(self.bounded(count, 2)?);
        for _ in 0..count {
            values.push(self.number()?);
        }
        self.expect(b')')?;
        Ok(values)
    }

    fn labels(&mut self) -> Result<Vec<u32>, SceneError> {
        let count = self.count()?;
        self.skip_space();
        if self.peek() == Some(b'{') {
            self.at += 1;
            let value = self.label()?;
            self.expect(b'}')?;
            if count > EQUAL_LABELS_MAX {
                return Err(self.error(&format!("at most {EQUAL_LABELS_MAX} equal numbers")));
            }
            return Ok(vec![value; count]);
        }
        if self.file.binary {
            let raw = self.raw(count, self.file.label)?;
            return self.file.decode_labels(raw, self.at);
        }
        self.expect(b'(')?;
        let mut values = Vec::with_capacity(self.bounded(count, 2)?);
        for _ in 0..count {
            values.push(self.label()?);
        }
        self.expect(b')')?;
        Ok(values)
    }

    fn tuple<const N: usize>(&mut self) -> Result<[f64; N], SceneError> {
        self.expect(b'(')?;
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number()?;
        }
        self.expect(b')')?;
        Ok(values)
    }

    /// The rest of `(x y z) cell` or `(a b c d) cell face tetPoint` after its first bracket.
    fn text_spot(&mut self) -> Result<Spot, SceneError> {
        let mut values = [0.0; 4];
        let mut count = 0;
        loop {
            self.skip_space();
            if self.peek() == Some(b')') {
                self.at += 1;
                break;
            }
            if count == values.len() {
                return Err(self.error("`)` after three or four numbers"));
            }
            values[count] = self.number()?;
            count += 1;
        }
        let cell = self.count()?;
        match count {
            3 => Ok(Spot::Cartesian([values[0], values[1], values[2]])),
            4 => {
                Ok(Spot::Barycentric { weights: values, cell, face: self.count()?, tet_point: self.count()? })
            }
            _ => Err(self.error("three or four numbers of a place")),
        }
    }

    /// A binary record after its opening bracket; the closing one tells which kind it is.
    fn binary_spot(&mut self) -> Result<Spot, SceneError> {
        let (scalar, label) = (self.file.scalar, self.file.label);
        let rest = self.rest();
        let short = 3 * scalar + label;
        let long = 4 * scalar + 3 * label;
        let closes = |length: usize| {
            rest.get(length) == Some(&b')') && matches!(rest.get(length + 1), Some(b'\n' | b'(' | b')'))
        };
        let length = if closes(short) {
            short
        } else if closes(long) {
            long
        } else {
            return Err(self.error(&format!("a parcel record of {short} or {long} bytes and `)`")));
        };
        let scalars = (length - if length == short { label } else { 3 * label }) / scalar;
        let values = self.file.decode_scalars(&rest[..scalars * scalar]);
        let labels = self.file.decode_labels(&rest[scalars * scalar..length], self.at)?;
        self.at += length + 1;
        match (values.as_slice(), labels.as_slice()) {
            (&[x, y, z], _) => Ok(Spot::Cartesian([x, y, z])),
            (&[a, b, c, d], &[cell, face, tet_point]) => Ok(Spot::Barycentric {
                weights: [a, b, c, d],
                cell: cell as usize,
                face: face as usize,
                tet_point: tet_point as usize,
            }),
            _ => Err(self.error("a parcel record")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> Result<FoamFile, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("x"), text).unwrap();
        FoamFile::need(&Folder { path: folder.path().to_owned(), block: 0 }, "x")
    }

    const HEAD: &str =
        "/* c */\nFoamFile\n{\n version 2.0;\n format ascii;\n class scalarField;\n}\n// * //\n\n";

    #[test]
    fn constant_lists_and_fields_are_accepted() {
        assert_eq!(file(&format!("{HEAD}3{{1.5}}\n")).unwrap().scalars(3).unwrap(), vec![1.5; 3]);
        let uniform = file(&format!("{HEAD}internalField uniform 523;\n")).unwrap();
        assert_eq!(uniform.internal_field().unwrap(), Values::Uniform(523.0));
        let each =
            file(&format!("{HEAD}internalField nonuniform List<scalar> \n2\n(\n1\n2e-3\n)\n;\n")).unwrap();
        assert_eq!(each.internal_field().unwrap(), Values::Each(vec![1.0, 2e-3]));
        assert!(file(&format!("{HEAD}0()\n")).unwrap().scalars(0).unwrap().is_empty());
    }

    #[test]
    fn truncated_list_names_the_line_and_what_was_expected() {
        let error = file(&format!("{HEAD}3\n(\n1\n2\n")).unwrap().scalars(3).unwrap_err();
        let SceneError::Malformed { place, found, .. } = &error else { panic!("{error}") };
        assert_eq!((*place, found.as_str()), (Place::Line(14), "the end of the file"));
    }

    #[test]
    fn a_foreign_file_is_refused_by_its_header() {
        let error = file("hello\n").unwrap_err();
        assert!(error.to_string().contains("FoamFile"), "{error}");
    }

    #[test]
    fn a_huge_count_does_not_ask_for_memory() {
        assert!(file(&format!("{HEAD}4000000000\n(\n1\n)\n")).unwrap().scalars(4_000_000_000).is_err());
    }

    #[test]
    fn both_kinds_of_places_are_read_from_text() {
        let spots =
            file(&format!("{HEAD}2\n(\n(1 2 3) 4\n(0.1 0.2 0.3 0.4) 5 6 1\n)\n")).unwrap().spots().unwrap();
        assert_eq!(spots[0], Spot::Cartesian([1.0, 2.0, 3.0]));
        let weights = [0.1, 0.2, 0.3, 0.4];
        assert_eq!(spots[1], Spot::Barycentric { weights, cell: 5, face: 6, tet_point: 1 });
    }
}
