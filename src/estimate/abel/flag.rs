//! Bits of the flags of an inverted image, with their names.

/// The pixel has no column: not finite, or of no finite σ.
pub const NO_INPUT: u32 = 1;
/// The medium is opaque there: ε + 2σ ≥ 1, so that its column is not known.
pub const OPAQUE: u32 = 1 << 1;
/// Columns that the value needs are missing: NaN.
pub const HIDDEN: u32 = 1 << 2;
/// A gap further out, or at this radius, was bridged by a straight line.
pub const BRIDGED: u32 = 1 << 3;
/// Only one half knows the column of this radius.
pub const ONE_SIDE: u32 = 1 << 4;
/// The row's column does not fall to zero at its end: what lies beyond counts as inside.
pub const TRUNCATED: u32 = 1 << 5;
/// Would be negative and was set to zero; σ is that of the answer without a bound.
pub const AT_BOUND: u32 = 1 << 6;
/// The search for the answer that is not negative did not settle.
pub const NOT_SETTLED: u32 = 1 << 7;

/// Every flag with its name and meaning, in order of bits.
pub const LEGEND: [(u32, &str, &str); 8] = [
    (NO_INPUT, "NO_INPUT", "the pixel has no column"),
    (OPAQUE, "OPAQUE", "emissivity + 2 sigma reaches 1, column not known"),
    (HIDDEN, "HIDDEN", "columns that the value needs are missing, NaN"),
    (BRIDGED, "BRIDGED", "a gap further out was bridged by a straight line"),
    (ONE_SIDE, "ONE_SIDE", "only one half knows the column of this radius"),
    (TRUNCATED, "TRUNCATED", "the row's column does not fall to zero at its end"),
    (AT_BOUND, "AT_BOUND", "would be negative, set to zero"),
    (NOT_SETTLED, "NOT_SETTLED", "search for a non-negative answer did not settle"),
];
