//! File formats of frames and results: NPY, NPZ, EXR, TIFF, PNG, and the set of files of one map.
//!
//! Equal results are equal bytes: no times, hosts or hash orders get into a file.

pub mod font;
pub mod image;
pub mod npy;
pub mod npz;
pub mod preview;
pub mod recorded;
pub mod result;

pub use result::{ResultMeta, write_atomic, write_result};

use std::path::{Path, PathBuf};

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// {path}: {source}
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// {path}: {reason}
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// An array.
    #[error(transparent)]
    Npy(#[from] npy::NpyError),
}

impl FileError {
    fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }

    fn format(path: &Path, reason: impl std::fmt::Display) -> Self {
        Self::Format { path: path.to_path_buf(), reason: reason.to_string() }
    }
}
