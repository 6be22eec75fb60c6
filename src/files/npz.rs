//! NumPy's `.npz`: a ZIP archive of arrays, reproducible to the byte.
//!
//! Every entry carries the ZIP epoch as its time, and entries are in the order given.

use super::FileError;
use super::npy::{self, Array};
use std::io::{Cursor, Read, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// Largest array that is unpacked, in bytes: a broken archive shall not fill the memory.
const ENTRY_BYTES_MAX: u64 = 1 << 33;

/// How the arrays are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// As they are: fast, and floating-point noise hardly shrinks.
    Stored,
    /// Deflated: for counts and flags.
    Deflated,
}

/// The bytes of an archive holding `arrays`, in this order.
///
/// # Errors
///
/// What the archive writer says; on memory it has no reason to.
pub fn to_bytes(arrays: &[(&str, &Array)], packing: Packing) -> std::io::Result<Vec<u8>> {
    let method = match packing {
        Packing::Stored => CompressionMethod::Stored,
        Packing::Deflated => CompressionMethod::Deflated,
    };
    let options = SimpleFileOptions::default()
        .compression_method(method)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, array) in arrays {
        let bytes = array.to_bytes();
        let large = u32::try_from(bytes.len()).is_err();
        zip.start_file(format!("{name}.npy"), options.large_file(large)).map_err(std::io::Error::other)?;
        zip.write_all(&bytes)?;
    }
    Ok(zip.finish().map_err(std::io::Error::other)?.into_inner())
}

/// All arrays of an archive, in its order, stored or deflated.
///
/// # Errors
///
/// When the file cannot be read, is no archive, or an entry is no array of a known type.
pub fn read(path: &Path) -> Result<Vec<(String, Array)>, FileError> {
    let bytes = std::fs::read(path).map_err(FileError::io(path))?;
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| FileError::format(path, e))?;
    let mut arrays = Vec::new();
    for index in 0..zip.len() {
        let entry = zip.by_index(index).map_err(|e| FileError::format(path, e))?;
        let Some(name) = entry.name().strip_suffix(".npy").map(str::to_owned) else { continue };
        let mut bytes = Vec::new();
        entry.take(ENTRY_BYTES_MAX).read_to_end(&mut bytes).map_err(FileError::io(path))?;
        let array = npy::parse(&bytes).map_err(|e| FileError::format(path, format!("{name}: {e}")))?;
        arrays.push((name, array));
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests {
    use super::npy::Values;
    use super::*;

    #[test]
    fn archives_come_back_and_are_reproducible() {
        let one = Array { shape: vec![2, 2], values: Values::F64(vec![1.0, f64::NAN, -3.5, 0.0]) };
        let two = Array { shape: vec![3], values: Values::U32(vec![7, 8, 9]) };
        let dir = tempfile::tempdir().unwrap();
        for packing in [Packing::Stored, Packing::Deflated] {
            let bytes = to_bytes(&[("one", &one), ("two", &two)], packing).unwrap();
            assert_eq!(bytes, to_bytes(&[("one", &one), ("two", &two)], packing).unwrap());
            let path = dir.path().join("a.npz");
            std::fs::write(&path, &bytes).unwrap();
            let back = read(&path).unwrap();
            assert_eq!(back.len(), 2);
            assert_eq!((back[1].0.as_str(), &back[1].1), ("two", &two));
            assert_eq!(back[0].1.to_bytes(), one.to_bytes());
        }
        std::fs::write(dir.path().join("b.npz"), b"not an archive").unwrap();
        assert!(read(&dir.path().join("b.npz")).is_err());
    }
}
