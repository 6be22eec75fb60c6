//! File formats of results: NPY, NPZ, EXR, TIFF, PNG.
