//! Frames as cameras' own programs record them: TIFF (one page or many), raw counts behind a stated header, NPY. Lossless.
//!
//! One file stays open between frames, so that pages of a long file are not looked for from its beginning again.

use super::FileError;
use super::npy::{self, FrameReader, Values};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};

/// Most pixels of a frame: 256 million.
const PIXELS_MAX: usize = 1 << 28;

/// A frame of counts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Counts in row order, row 0 at the top.
    pub counts: Vec<u16>,
}

/// How a raw file is laid out: a header, then frames without gaps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawLayout {
    /// Bytes before the first frame.
    pub header_bytes: u64,
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub columns: usize,
    /// Whether the first byte of a sample is its high one.
    pub big_endian: bool,
    /// Bits of a sample, 1 … 16; up to 8 are one byte, more are two with the bits at the low end.
    pub bits: u32,
}

/// Reads frames of any number of files.
#[derive(Debug, Default)]
pub struct Recordings {
    open: Option<(PathBuf, Open)>,
}

enum Open {
    Tiff(Box<Decoder<BufReader<File>>>),
    Raw(File, u64),
    Blocks(FrameReader),
    Whole(Vec<Frame>),
}

impl std::fmt::Debug for Open {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Tiff(_) => "Tiff",
            Self::Raw(..) => "Raw",
            Self::Blocks(_) => "Blocks",
            Self::Whole(_) => "Whole",
        })
    }
}

/// Whether the name is that of a TIFF file.
fn is_tiff(path: &Path) -> bool {
    has_extension(path, &["tif", "tiff", "btf", "tf8"])
}

/// Whether a file of this name has its own description, so that no layout is needed.
pub fn describes_itself(path: &Path) -> bool {
    is_tiff(path) || has_extension(path, &["npy"])
}

fn has_extension(path: &Path, known: &[&str]) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| known.contains(&extension.as_str()))
}

impl Recordings {
    /// Frame `index` (0 the first) of a file. Names ending in .tif or .tiff are TIFF, in .npy NumPy arrays, all others raw
    /// and need a `layout`.
    ///
    /// # Errors
    ///
    /// When the file is missing, of another size or kind than it should be, or has no such frame.
    pub fn frame(
        &mut self,
        path: &Path,
        index: usize,
        layout: Option<&RawLayout>,
    ) -> Result<Frame, FileError> {
        if self.open.as_ref().is_none_or(|(open, _)| open != path) {
            self.open = None;
            let file = match (is_tiff(path), has_extension(path, &["npy"])) {
                (true, _) => open_tiff(path)?,
                (_, true) => open_npy(path)?,
                _ => {
                    let file = File::open(path).map_err(FileError::io(path))?;
                    let length = file.metadata().map_err(FileError::io(path))?.len();
                    Open::Raw(file, length)
                }
            };
            self.open = Some((path.to_path_buf(), file));
        }
        let Some((_, file)) = &mut self.open else { unreachable!("opened above") };
        match file {
            Open::Tiff(decoder) => tiff_page(path, decoder, index),
            Open::Raw(file, length) => {
                let layout = layout.ok_or_else(|| {
                    FileError::format(
                        path,
                        "raw frames need their header bytes, rows, columns, byte order and bits",
                    )
                })?;
                raw_frame(path, file, *length, index, layout)
            }
            Open::Blocks(reader) => {
                if index >= reader.frames {
                    return Err(no_frame(path, index, reader.frames));
                }
                let mut counts = vec![0; reader.rows * reader.columns];
                reader.go_to(index)?;
                reader.next_into(&mut counts)?;
                Ok(Frame { rows: reader.rows, columns: reader.columns, counts })
            }
            Open::Whole(frames) => {
                frames.get(index).cloned().ok_or_else(|| no_frame(path, index, frames.len()))
            }
        }
    }
}

fn no_frame(path: &Path, index: usize, frames: usize) -> FileError {
    FileError::format(path, format!("has no frame {index} (counted from 0), it holds {frames}"))
}

fn open_tiff(path: &Path) -> Result<Open, FileError> {
    let file = File::open(path).map_err(FileError::io(path))?;
    let decoder = Decoder::new(BufReader::new(file)).map_err(|error| FileError::format(path, error))?;
    Ok(Open::Tiff(Box::new(decoder.with_limits(Limits::default()))))
}

fn tiff_page(path: &Path, decoder: &mut Decoder<BufReader<File>>, index: usize) -> Result<Frame, FileError> {
    let wrong = |error: tiff::TiffError| FileError::format(path, error);
    decoder
        .seek_to_image(index)
        .map_err(|error| FileError::format(path, format!("has no page {index} (counted from 0): {error}")))?;
    let (columns, rows) = decoder.dimensions().map_err(wrong)?;
    let kind = decoder.colortype().map_err(wrong)?;
    if !matches!(kind, ColorType::Gray(1..=16)) {
        let what = format!("page {index} is {kind:?}, expected grey of at most 16 bits");
        return Err(FileError::format(path, what));
    }
    let counts = match decoder.read_image().map_err(wrong)? {
        DecodingResult::U16(counts) => counts,
        DecodingResult::U8(counts) if kind == ColorType::Gray(8) => {
            counts.into_iter().map(u16::from).collect()
        }
        _ => {
            let what = format!("page {index} is {kind:?} of a kind of samples that are no whole counts");
            return Err(FileError::format(path, what));
        }
    };
    let frame = Frame { rows: rows as usize, columns: columns as usize, counts };
    if frame.rows * frame.columns != frame.counts.len() {
        return Err(FileError::format(
            path,
            format!("page {index} has another number of samples than pixels"),
        ));
    }
    Ok(frame)
}

fn raw_frame(
    path: &Path,
    file: &mut File,
    length: u64,
    index: usize,
    layout: &RawLayout,
) -> Result<Frame, FileError> {
    let &RawLayout { header_bytes, rows, columns, big_endian, bits } = layout;
    let pixels = rows.checked_mul(columns).filter(|pixels| (1..=PIXELS_MAX).contains(pixels));
    let (Some(pixels), 1..=16) = (pixels, bits) else {
        return Err(FileError::format(path, format!("cannot be {rows} x {columns} pixels of {bits} bits")));
    };
    let size = if bits > 8 { 2 } else { 1 };
    let frame_bytes = u64::try_from(pixels * size).expect("at most 2^29");
    let body = length.checked_sub(header_bytes);
    let whole = body.filter(|body| *body > 0 && body % frame_bytes == 0);
    let Some(body) = whole else {
        return Err(FileError::format(
            path,
            format!(
                "has {length} bytes, which is not a header of {header_bytes} and whole frames of {frame_bytes} ({rows} x {columns} pixels, {bits} bits)"
            ),
        ));
    };
    let frames = usize::try_from(body / frame_bytes).unwrap_or(usize::MAX);
    if index >= frames {
        return Err(no_frame(path, index, frames));
    }
    let at = header_bytes + u64::try_from(index).unwrap_or(u64::MAX) * frame_bytes;
    let mut bytes = vec![0; pixels * size];
    file.seek(SeekFrom::Start(at)).map_err(FileError::io(path))?;
    file.read_exact(&mut bytes).map_err(FileError::io(path))?;
    let counts: Vec<u16> = match (size, big_endian) {
        (1, _) => bytes.into_iter().map(u16::from).collect(),
        (_, true) => bytes.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect(),
        (_, false) => bytes.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect(),
    };
    let largest = counts.iter().copied().max().unwrap_or(0);
    if u32::from(largest) >> bits != 0 {
        let what = format!(
            "frame {index} has a sample of {largest}, more than {bits} bits: are byte order, bits and header right?"
        );
        return Err(FileError::format(path, what));
    }
    Ok(Frame { rows, columns, counts })
}

fn open_npy(path: &Path) -> Result<Open, FileError> {
    // Long recordings stay on the disk; other layouts are read whole.
    if let Ok(reader) = FrameReader::open(path) {
        return Ok(Open::Blocks(reader));
    }
    let array = npy::read(path)?;
    let counts = match array.values {
        Values::U16(counts) => counts,
        Values::U8(counts) => counts.into_iter().map(u16::from).collect(),
        _ => return Err(FileError::format(path, "holds no u16 or u8 counts")),
    };
    let (rows, columns) = match array.shape[..] {
        [rows, columns] | [_, rows, columns] => (rows, columns),
        _ => {
            let what = format!(
                "has the shape {:?}, expected [rows, columns] or [frames, rows, columns]",
                array.shape
            );
            return Err(FileError::format(path, what));
        }
    };
    if rows * columns == 0 {
        return Err(FileError::format(path, "has frames without pixels"));
    }
    let frame = |counts: &[u16]| Frame { rows, columns, counts: counts.to_vec() };
    Ok(Open::Whole(counts.chunks(rows * columns).map(frame).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Raw files say nothing of themselves: what was stated must fit their size and their counts.
    #[test]
    fn raw_files_must_fit_what_is_stated() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.raw");
        let counts: Vec<u16> = vec![1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 4095];
        let mut bytes = b"head!".to_vec();
        bytes.extend(counts.iter().flat_map(|v| v.to_be_bytes()));
        std::fs::write(&path, &bytes).unwrap();
        let layout = RawLayout { header_bytes: 5, rows: 2, columns: 3, big_endian: true, bits: 12 };
        let read = |index: usize, layout: RawLayout| Recordings::default().frame(&path, index, Some(&layout));
        assert_eq!(read(1, layout).unwrap().counts, counts[6..]);
        assert!(read(2, layout).unwrap_err().to_string().contains("holds 2"));
        assert!(
            read(0, RawLayout { header_bytes: 4, ..layout }).unwrap_err().to_string().contains("29 bytes")
        );
        let swapped = read(1, RawLayout { big_endian: false, ..layout }).unwrap_err().to_string();
        assert!(swapped.contains("byte order"), "{swapped}");
        assert!(read(0, RawLayout { rows: 0, ..layout }).is_err());
        assert!(read(0, RawLayout { bits: 17, ..layout }).is_err());
        assert!(read(0, RawLayout { header_bytes: 500, ..layout }).is_err());
        assert!(Recordings::default().frame(&path, 0, None).is_err());
        assert!(Recordings::default().frame(&dir.path().join("no.tif"), 0, None).is_err());
    }

    #[test]
    fn arrays_of_any_order_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.npy");
        let text = "{'descr': '>u2', 'fortran_order': False, 'shape': (2, 1, 2), }\n";
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&u16::try_from(text.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(text.as_bytes());
        bytes.extend([7_u16, 8, 9, 60_000].iter().flat_map(|v| v.to_be_bytes()));
        std::fs::write(&path, bytes).unwrap();
        let mut all = Recordings::default();
        assert_eq!(all.frame(&path, 1, None).unwrap().counts, [9, 60_000]);
        assert!(all.frame(&path, 2, None).is_err());
    }
}
