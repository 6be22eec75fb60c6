//! What can go wrong while a spray is read, packed or spread on a grid.

use std::path::{Path, PathBuf};

/// Where in a file the trouble is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Line, counted from 1 (text files).
    Line(usize),
    /// Byte offset from the start of the (unpacked) file, counted from 0 (binary files).
    Byte(usize),
    /// The file as a whole.
    Whole,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
            Self::Whole => write!(f, "the file as a whole"),
        }
    }
}

/// Trouble with a spray.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// A file or folder could not be read or written.
    #[error("{}: {doing}: {why}. Check the path and the permissions", file.display())]
    Access {
        /// File or folder.
        file: PathBuf,
        /// The act.
        doing: &'static str,
        /// What the system said.
        why: String,
    },
    /// None of the known forms of a spray.
    #[error(
        "{}: not a spray of a known form: {why}. Known: OpenFOAM case folder (with constant/polyMesh, \
         processor0 or processorsN), EnSight Gold .case, VTK .vtm/.vtu/.vtp/.vtk, a folder with parcels.csv and cells.csv, \
         a .spray file",
        file.display()
    )]
    Unknown {
        /// File or folder.
        file: PathBuf,
        /// What was found instead.
        why: String,
    },
    /// A file is cut off, foreign or damaged.
    #[error("{} ({place}): expected {expected}, found {found}. Write or copy the file again", file.display())]
    Malformed {
        /// File.
        file: PathBuf,
        /// Line or byte.
        place: Place,
        /// What should have been there.
        expected: String,
        /// What was there.
        found: String,
    },
    /// Something needed is absent.
    #[error("{}: {what} is missing. {hint}", file.display())]
    Missing {
        /// File or folder.
        file: PathBuf,
        /// What is missing.
        what: String,
        /// What to try.
        hint: String,
    },
    /// Lists that belong together have different lengths.
    #[error("{}: {what}: expected {expected} values, found {found}. Do the files belong together?", file.display())]
    Length {
        /// File.
        file: PathBuf,
        /// Which list.
        what: String,
        /// Number wanted.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// No such time in the case.
    #[error("{}: no time {asked_s} s; the nearest is {nearest} s. There are: {present}", file.display())]
    Time {
        /// File or folder.
        file: PathBuf,
        /// The time asked for, in seconds.
        asked_s: f64,
        /// The nearest time present in seconds, as text.
        nearest: String,
        /// The times present, as text.
        present: String,
    },
    /// A form that we know of but do not read.
    #[error("{}: {what} is not read. {hint}", file.display())]
    Unsupported {
        /// File or folder.
        file: PathBuf,
        /// The form.
        what: String,
        /// What to try.
        hint: String,
    },
    /// The bytes of a `.spray` file do not fit their checksum.
    #[error("{}: checksum {found:08x} where {expected:08x} is written: the file is damaged. Copy it again", file.display())]
    Checksum {
        /// File.
        file: PathBuf,
        /// Checksum written in the file.
        expected: u32,
        /// Checksum of the bytes.
        found: u32,
    },
    /// The spray cannot be spread on a grid as asked.
    #[error("spreading the spray on a grid: {why}. {hint}")]
    Deposit {
        /// What is wrong.
        why: String,
        /// What to try.
        hint: String,
    },
}

impl SceneError {
    pub(crate) fn access(file: &Path, doing: &'static str, why: &std::io::Error) -> Self {
        Self::Access { file: file.to_owned(), doing, why: why.to_string() }
    }

    pub(crate) fn missing(file: &Path, what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Missing { file: file.to_owned(), what: what.into(), hint: hint.into() }
    }

    pub(crate) fn malformed(
        file: &Path,
        place: Place,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Malformed { file: file.to_owned(), place, expected: expected.into(), found: found.into() }
    }

    pub(crate) fn length(file: &Path, what: impl Into<String>, expected: usize, found: usize) -> Self {
        Self::Length { file: file.to_owned(), what: what.into(), expected, found }
    }
}
