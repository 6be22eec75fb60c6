//! NumPy's `.npy` arrays: reading and writing whole arrays, and append-only blocks of frames.
//!
//! Format: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html, versions 1 to 3. Reads
//! little- and big-endian f4 f8 u1 u2 u4 i4 and both orders; writes little-endian, C order.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Bytes of the header that [`NpyBlock`] writes: fixed, so that the number of frames can be patched in place.
pub const BLOCK_HEADER_BYTES: usize = 128;

/// Largest header that is read; NumPy's own limit for `safe` headers is 10 000.
const HEADER_BYTES_MAX: usize = 65_536;

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum NpyError {
    /// {path}: {source}
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// {path}: not a NumPy array: {reason}.
    #[error("{path}: not a NumPy array: {reason}.")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// {path}: holds {found}, expected {expected}.
    #[error("{path}: holds {found}, expected {expected}.")]
    Kind {
        /// The file.
        path: PathBuf,
        /// Type and shape found.
        found: String,
        /// Type and shape needed.
        expected: String,
    },
}

fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> NpyError {
    let path = path.to_path_buf();
    move |source| NpyError::Io { path, source }
}

/// Values of an array, in C order.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// 32-bit floating point.
    F32(Vec<f32>),
    /// 64-bit floating point.
    F64(Vec<f64>),
    /// Bytes.
    U8(Vec<u8>),
    /// 16-bit counts.
    U16(Vec<u16>),
    /// 32-bit unsigned.
    U32(Vec<u32>),
    /// 32-bit signed.
    I32(Vec<i32>),
}

/// An array with its shape, values in C order.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// The values; as many as the product of `shape`.
    pub values: Values,
}

impl Array {
    /// Values as f64, whatever they are stored as (all kinds are exact in f64).
    pub fn to_f64(&self) -> Vec<f64> {
        match &self.values {
            Values::F32(v) => v.iter().map(|&v| f64::from(v)).collect(),
            Values::F64(v) => v.clone(),
            Values::U8(v) => v.iter().map(|&v| f64::from(v)).collect(),
            Values::U16(v) => v.iter().map(|&v| f64::from(v)).collect(),
            Values::U32(v) => v.iter().map(|&v| f64::from(v)).collect(),
            Values::I32(v) => v.iter().map(|&v| f64::from(v)).collect(),
        }
    }

    /// The complete file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let (descr, bytes): (&str, Vec<u8>) = match &self.values {
            Values::F32(v) => ("<f4", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Values::F64(v) => ("<f8", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Values::U8(v) => ("|u1", v.clone()),
            Values::U16(v) => ("<u2", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Values::U32(v) => ("<u4", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Values::I32(v) => ("<i4", v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        };
        let mut out = header(descr, &self.shape, 64);
        out.extend_from_slice(&bytes);
        out
    }
}

/// Reads a whole array.
///
/// # Errors
///
/// When the file cannot be read, is not an array of a known type, or is shorter than its header says.
pub fn read(path: &Path) -> Result<Array, NpyError> {
    let bytes = std::fs::read(path).map_err(io_error(path))?;
    parse(&bytes).map_err(|reason| NpyError::Format { path: path.to_path_buf(), reason })
}

/// Writes a whole array.
///
/// # Errors
///
/// When the file cannot be written.
pub fn write(path: &Path, array: &Array) -> Result<(), NpyError> {
    std::fs::write(path, array.to_bytes()).map_err(io_error(path))
}

/// Reads an array from the bytes of a file.
///
/// # Errors
///
/// What is wrong, in words.
pub fn parse(bytes: &[u8]) -> Result<Array, String> {
    let header = Header::parse(bytes)?;
    let count = header.count()?;
    let size = header.kind.bytes();
    let length = count.checked_mul(size).ok_or("its shape overflows")?;
    let body = bytes.get(header.length..).unwrap_or_default();
    let body = body
        .get(..length)
        .ok_or_else(|| format!("{length} bytes of values expected, {} present", body.len()))?;
    let values = header.kind.decode(body, header.big_endian);
    let values = if header.fortran { values.from_fortran(&header.shape) } else { values };
    Ok(Array { shape: header.shape, values })
}

/// Reads an array of u16 frames `[n, rows, columns]` one frame at a time, without holding it in memory.
#[derive(Debug)]
pub struct FrameReader {
    path: PathBuf,
    file: BufReader<File>,
    /// Number of frames.
    pub frames: usize,
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub columns: usize,
    start: u64,
}

impl FrameReader {
    /// Opens the array and checks its type and length.
    ///
    /// # Errors
    ///
    /// When it is not a C-ordered little-endian u16 array of three axes, or shorter than its header says.
    pub fn open(path: &Path) -> Result<Self, NpyError> {
        let mut file = File::open(path).map_err(io_error(path))?;
        let length = file.metadata().map_err(io_error(path))?.len();
        let header = Header::read(&mut file, path)?;
        let wrong = |found: String| NpyError::Kind {
            path: path.to_path_buf(),
            found,
            expected: "u16 in C order with shape [frames, rows, columns]".into(),
        };
        let &[frames, rows, columns] = header.shape.as_slice() else {
            return Err(wrong(format!("shape {:?}", header.shape)));
        };
        if header.kind != Kind::U16 || header.fortran || header.big_endian {
            return Err(wrong(format!("{:?}, Fortran order: {}", header.kind, header.fortran)));
        }
        let bytes = header.count().ok().and_then(|c| u64::try_from(c).ok()).and_then(|c| c.checked_mul(2));
        let start = u64::try_from(header.length).expect("a header is short");
        if bytes.and_then(|b| b.checked_add(start)).is_none_or(|needed| needed > length) {
            return Err(wrong(format!("{length} bytes for shape {:?}", header.shape)));
        }
        Ok(Self { path: path.to_path_buf(), file: BufReader::new(file), frames, rows, columns, start })
    }

    /// Reads the next frame into `frame`, of rows · columns pixels.
    ///
    /// # Errors
    ///
    /// When the file ends or cannot be read.
    pub fn next_into(&mut self, frame: &mut [u16]) -> Result<(), NpyError> {
        assert!(frame.len() == self.rows * self.columns, "a frame has rows · columns pixels");
        let mut bytes = vec![0; 2 * frame.len()];
        self.file.read_exact(&mut bytes).map_err(io_error(&self.path))?;
        for (pixel, pair) in frame.iter_mut().zip(bytes.as_chunks::<2>().0) {
            *pixel = u16::from_le_bytes(*pair);
        }
        Ok(())
    }

    /// Goes to a frame, 0 the first.
    ///
    /// # Errors
    ///
    /// When the file cannot be sought.
    pub fn go_to(&mut self, frame: usize) -> Result<(), NpyError> {
        let bytes = u64::try_from(2 * frame * self.rows * self.columns).expect("a place in a file");
        self.file.seek(SeekFrom::Start(self.start + bytes)).map(|_| ()).map_err(io_error(&self.path))
    }
}

/// A growing array of u16 frames `[n, rows, columns]` whose header is always 128 bytes.
///
/// Frames are appended first and counted later ([`NpyBlock::sync`]), so a crash leaves at worst frames that the
/// header does not count yet, or a torn one: [`NpyBlock::repair`] mends both.
#[derive(Debug)]
pub struct NpyBlock {
    path: PathBuf,
    file: File,
    rows: usize,
    columns: usize,
    frames: usize,
}

impl NpyBlock {
    /// Creates the file with no frame in it; refuses to overwrite.
    ///
    /// # Errors
    ///
    /// When the file exists or cannot be written.
    pub fn create(path: &Path, rows: usize, columns: usize) -> Result<Self, NpyError> {
        let mut file =
            OpenOptions::new().read(true).write(true).create_new(true).open(path).map_err(io_error(path))?;
        file.write_all(&block_header(0, rows, columns)).map_err(io_error(path))?;
        Ok(Self { path: path.to_path_buf(), file, rows, columns, frames: 0 })
    }

    /// Opens a block after a crash: frames that are complete are counted, a torn one is cut off.
    ///
    /// # Errors
    ///
    /// When the file is not a block of frames or cannot be written.
    pub fn repair(path: &Path) -> Result<Self, NpyError> {
        let mut file = OpenOptions::new().read(true).write(true).open(path).map_err(io_error(path))?;
        let header = Header::read(&mut file, path)?;
        let format = |reason: &str| NpyError::Format { path: path.to_path_buf(), reason: reason.into() };
        let &[_, rows, columns] = header.shape.as_slice() else {
            return Err(format("a block of frames has three axes"));
        };
        if header.length != BLOCK_HEADER_BYTES || header.kind != Kind::U16 || header.fortran {
            return Err(format("a block of frames is u16 in C order behind a header of 128 bytes"));
        }
        let frame_bytes = rows
            .checked_mul(columns)
            .and_then(|pixels| pixels.checked_mul(2))
            .and_then(|bytes| u64::try_from(bytes).ok())
            .filter(|&bytes| bytes > 0)
            .ok_or_else(|| format("its frames have no pixels"))?;
        let start = u64::try_from(BLOCK_HEADER_BYTES).expect("128");
        let present = file.metadata().map_err(io_error(path))?.len().saturating_sub(start);
        let complete = present / frame_bytes;
        file.set_len(start + complete * frame_bytes).map_err(io_error(path))?;
        let frames = usize::try_from(complete).map_err(|_| format("too many frames"))?;
        let mut block = Self { path: path.to_path_buf(), file, rows, columns, frames };
        block.sync()?;
        Ok(block)
    }

    /// Frames appended so far.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Appends one frame of rows · columns pixels and returns its index.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn append(&mut self, frame: &[u16]) -> Result<usize, NpyError> {
        assert!(frame.len() == self.rows * self.columns, "a frame has rows · columns pixels");
        let bytes: Vec<u8> = frame.iter().flat_map(|pixel| pixel.to_le_bytes()).collect();
        self.file.seek(SeekFrom::End(0)).map_err(io_error(&self.path))?;
        self.file.write_all(&bytes).map_err(io_error(&self.path))?;
        self.frames += 1;
        Ok(self.frames - 1)
    }

    /// Makes the frames durable, then writes their number into the header and makes that durable.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn sync(&mut self) -> Result<(), NpyError> {
        let error = io_error(&self.path);
        let header = block_header(self.frames, self.rows, self.columns);
        let mut write = || -> std::io::Result<()> {
            self.file.sync_data()?;
            self.file.seek(SeekFrom::Start(0))?;
            self.file.write_all(&header)?;
            self.file.sync_data()
        };
        write().map_err(error)
    }
}

fn block_header(frames: usize, rows: usize, columns: usize) -> Vec<u8> {
    let header = header("<u2", &[frames, rows, columns], BLOCK_HEADER_BYTES);
    assert!(header.len() == BLOCK_HEADER_BYTES, "the header of three axes fits 128 bytes");
    header
}

fn header(descr: &str, shape: &[usize], align: usize) -> Vec<u8> {
    let axes = match shape {
        [] => "()".to_owned(),
        [one] => format!("({one},)"),
        many => format!("({})", many.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    };
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {axes}, }}");
    let total = (10 + text.len() + 1).div_ceil(align) * align;
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    let length = u16::try_from(total - 10).expect("a header of a few axes is short");
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(text.as_bytes());
    out.resize(total - 1, b' ');
    out.push(b'\n');
    out
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    F32,
    F64,
    U8,
    U16,
    U32,
    I32,
}

impl Kind {
    fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::F32 | Self::U32 | Self::I32 => 4,
            Self::F64 => 8,
        }
    }

    fn decode(self, bytes: &[u8], big_endian: bool) -> Values {
        fn each<const N: usize, T>(bytes: &[u8], big: bool, from: fn([u8; N]) -> T) -> Vec<T> {
            let (chunks, _) = bytes.as_chunks::<N>();
            chunks
                .iter()
                .map(|&chunk| {
                    let mut chunk = chunk;
                    if big {
                        chunk.reverse();
                    }
                    from(chunk)
                })
                .collect()
        }
        match self {
            Self::F32 => Values::F32(each(bytes, big_endian, f32::from_le_bytes)),
            Self::F64 => Values::F64(each(bytes, big_endian, f64::from_le_bytes)),
            Self::U8 => Values::U8(bytes.to_vec()),
            Self::U16 => Values::U16(each(bytes, big_endian, u16::from_le_bytes)),
            Self::U32 => Values::U32(each(bytes, big_endian, u32::from_le_bytes)),
            Self::I32 => Values::I32(each(bytes, big_endian, i32::from_le_bytes)),
        }
    }
}

impl Values {
    #[expect(clippy::wrong_self_convention, reason = "reads as what it does: from Fortran order to C order")]
    fn from_fortran(self, shape: &[usize]) -> Self {
        fn reorder<T: Copy>(values: &[T], shape: &[usize]) -> Vec<T> {
            let mut strides = vec![1; shape.len()];
            for axis in 1..shape.len() {
                strides[axis] = strides[axis - 1] * shape[axis - 1];
            }
            let mut index = vec![0; shape.len()];
            let mut out = Vec::with_capacity(values.len());
            for _ in 0..values.len() {
                let at: usize = index.iter().zip(&strides).map(|(i, s)| i * s).sum();
                out.push(values[at]);
                for axis in (0..shape.len()).rev() {
                    index[axis] += 1;
                    if index[axis] < shape[axis] {
                        break;
                    }
                    index[axis] = 0;
                }
            }
            out
        }
        match self {
            Self::F32(v) => Self::F32(reorder(&v, shape)),
            Self::F64(v) => Self::F64(reorder(&v, shape)),
            Self::U8(v) => Self::U8(reorder(&v, shape)),
            Self::U16(v) => Self::U16(reorder(&v, shape)),
            Self::U32(v) => Self::U32(reorder(&v, shape)),
            Self::I32(v) => Self::I32(reorder(&v, shape)),
        }
    }
}

#[derive(Debug)]
struct Header {
    kind: Kind,
    big_endian: bool,
    fortran: bool,
    shape: Vec<usize>,
    /// Bytes before the values.
    length: usize,
}

impl Header {
    fn count(&self) -> Result<usize, String> {
        self.shape
            .iter()
            .try_fold(1_usize, |product, &axis| product.checked_mul(axis))
            .ok_or_else(|| "its shape overflows".to_owned())
    }

    fn read(file: &mut File, path: &Path) -> Result<Self, NpyError> {
        let format = |reason: String| NpyError::Format { path: path.to_path_buf(), reason };
        let mut bytes = vec![0; 12];
        file.read_exact(&mut bytes).map_err(|_| format("it is shorter than a header".into()))?;
        let length = Self::total(&bytes).map_err(format)?;
        bytes.resize(length, 0);
        file.read_exact(&mut bytes[12..]).map_err(|_| format("its header is cut off".into()))?;
        Self::parse(&bytes).map_err(format)
    }

    /// Bytes before the values, from the first twelve bytes.
    fn total(bytes: &[u8]) -> Result<usize, String> {
        let cut = "it is shorter than a header";
        if bytes.get(..6).ok_or(cut)? != b"\x93NUMPY" {
            return Err("it does not begin with the magic string".into());
        }
        let major = *bytes.get(6).ok_or(cut)?;
        let byte = |i: usize| bytes.get(i).copied().map(usize::from).ok_or_else(|| cut.to_owned());
        let total = match major {
            1 => 10 + byte(8)? + (byte(9)? << 8),
            2 | 3 => 12 + byte(8)? + (byte(9)? << 8) + (byte(10)? << 16) + (byte(11)? << 24),
            _ => return Err(format!("its version {major} is not known")),
        };
        if !(12..=HEADER_BYTES_MAX).contains(&total) {
            return Err(format!("a header of {total} bytes is not believed"));
        }
        Ok(total)
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let length = Self::total(bytes)?;
        let start = if bytes.get(6) == Some(&1) { 10 } else { 12 };
        let text = bytes.get(start..length).ok_or("its header is cut off")?;
        let text = std::str::from_utf8(text).map_err(|_| "its header is not text")?;
        let descr = field(text, "descr")?.trim_start().trim_start_matches(['\'', '"']);
        let descr = descr.split(['\'', '"']).next().unwrap_or_default();
        let (big_endian, name) = match descr.split_at_checked(1) {
            Some(("<" | "|" | "=", name)) => (false, name),
            Some((">", name)) => (true, name),
            _ => return Err(format!("its type {descr:?} is not known")),
        };
        let kind = match name {
            "f4" => Kind::F32,
            "f8" => Kind::F64,
            "u1" => Kind::U8,
            "u2" => Kind::U16,
            "u4" => Kind::U32,
            "i4" => Kind::I32,
            _ => return Err(format!("its type {descr:?} is not one of f4 f8 u1 u2 u4 i4")),
        };
        let fortran = match field(text, "fortran_order")?.trim_start() {
            order if order.starts_with("True") => true,
            order if order.starts_with("False") => false,
            _ => return Err("its order is neither True nor False".into()),
        };
        let shape = field(text, "shape")?.trim_start();
        let axes = shape.strip_prefix('(').and_then(|s| s.split(')').next()).ok_or("its shape is missing")?;
        let shape = axes
            .split(',')
            .map(str::trim)
            .filter(|axis| !axis.is_empty())
            .map(|axis| axis.parse().map_err(|_| format!("its axis {axis:?} is not a number")))
            .collect::<Result<Vec<usize>, String>>()?;
        Ok(Self { kind, big_endian, fortran, shape, length })
    }
}

/// What follows `'key':` in the header's dictionary.
fn field<'a>(text: &'a str, key: &str) -> Result<&'a str, String> {
    let at = text
        .find(&format!("'{key}'"))
        .or_else(|| text.find(&format!("\"{key}\"")))
        .ok_or_else(|| format!("its header has no {key}"))?;
    let rest = &text[at + key.len() + 2..];
    rest.trim_start().strip_prefix(':').ok_or_else(|| format!("its header has no value for {key}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_come_back() {
        let arrays = [
            Array { shape: vec![2, 3], values: Values::F64(vec![1.5, f64::INFINITY, -0.0, 4.0, 5.0, 6.0]) },
            Array { shape: vec![3], values: Values::U16(vec![0, 1, 65_535]) },
            Array { shape: vec![], values: Values::I32(vec![-7]) },
            Array { shape: vec![0, 4], values: Values::F32(vec![]) },
            Array { shape: vec![1, 2], values: Values::U8(vec![3, 4]) },
            Array { shape: vec![2], values: Values::U32(vec![u32::MAX, 4]) },
        ];
        for array in arrays {
            let bytes = array.to_bytes();
            assert_eq!(parse(&bytes).unwrap(), array);
            assert!(bytes.len() >= 64);
        }
    }

    /// The header in the words of NumPy's format description, with an order that we never write.
    #[test]
    fn fortran_order_and_big_endian_are_read() {
        let text = "{'descr': '>u2', 'fortran_order': True, 'shape': (2, 3), }\n";
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&u16::try_from(text.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(text.as_bytes());
        for count in [1_u16, 4, 2, 5, 3, 6] {
            bytes.extend_from_slice(&count.to_be_bytes());
        }
        let array = parse(&bytes).unwrap();
        assert_eq!(array, Array { shape: vec![2, 3], values: Values::U16(vec![1, 2, 3, 4, 5, 6]) });
    }

    #[test]
    fn broken_files_are_refused() {
        let good = Array { shape: vec![2], values: Values::F64(vec![1.0, 2.0]) }.to_bytes();
        for cut in [0, 5, 9, 11, 40, good.len() - 1] {
            assert!(parse(&good[..cut]).is_err(), "{cut}");
        }
        let mut other = good.clone();
        other[6] = 9;
        assert!(parse(&other).unwrap_err().contains("version"));
        let mut complex = good;
        let kind = complex.windows(3).position(|w| w == b"<f8").unwrap();
        complex[kind + 1] = b'c';
        assert!(parse(&complex).unwrap_err().contains("<c8"));
    }

    #[test]
    fn torn_block_is_repaired() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("spray.npy");
        let mut block = NpyBlock::create(&path, 2, 3).unwrap();
        assert!(NpyBlock::create(&path, 2, 3).is_err(), "never overwritten");
        assert_eq!(block.append(&[1, 2, 3, 4, 5, 6]).unwrap(), 0);
        block.sync().unwrap();
        assert_eq!(block.append(&[7, 8, 9, 10, 11, 12]).unwrap(), 1);
        drop(block);
        let mut bytes = std::fs::read(&path).unwrap();
        assert_eq!(bytes.len(), BLOCK_HEADER_BYTES + 24);
        bytes.extend_from_slice(&[9, 9, 9]);
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(read(&path).unwrap().shape, [1, 2, 3]);
        let mut block = NpyBlock::repair(&path).unwrap();
        assert_eq!(block.frames(), 2);
        block.append(&[13; 6]).unwrap();
        block.sync().unwrap();
        let array = read(&path).unwrap();
        assert_eq!(array.shape, [3, 2, 3]);
        let Values::U16(values) = array.values else { panic!("u16") };
        assert_eq!(values[..12], [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
        let mut reader = FrameReader::open(&path).unwrap();
        let mut frame = [0; 6];
        for _ in 0..3 {
            reader.next_into(&mut frame).unwrap();
        }
        assert_eq!(frame, [13; 6]);
        assert!(reader.next_into(&mut frame).is_err());
        reader.go_to(0).unwrap();
        reader.next_into(&mut frame).unwrap();
        assert_eq!(frame, [1, 2, 3, 4, 5, 6]);
    }
}
