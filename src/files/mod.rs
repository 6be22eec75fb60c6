//! File formats of frames and results: NPY, NPZ, EXR, TIFF, PNG, and the set of files of one map.
//!
//! Equal results are equal bytes: no times, hosts or hash orders get into a file.

pub mod npy;
