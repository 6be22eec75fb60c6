//! Bits of a map's `flags` channel, with their names.

/// Fewer than two levels left, or all at one x: no line.
pub const TOO_FEW_LEVELS: u32 = 1;
/// At least one cycle was left out because a sample was saturated.
pub const SATURATED: u32 = 1 << 1;
/// The pixel never changes, neither with shots nor with the plate.
pub const DEAD: u32 = 1 << 2;
/// Spray minus blank is the same in every cycle of every level. Few quiet cycles can do that by chance where there
/// is no spray, so it says something only together with others.
pub const CONSTANT: u32 = 1 << 3;
/// The pixel does not see the plate: its blanks do not follow it.
pub const NO_PLATE: u32 = 1 << 4;
/// Fieller's set of the crossing is unbounded: the slope is not significant. `default` gives no temperature.
pub const NOT_RESOLVED: u32 = 1 << 5;
/// The emissivity is negative. `default` gives no temperature.
pub const NEGATIVE_EMISSIVITY: u32 = 1 << 6;
/// The crossing stands for no light, or less than none: no temperature.
pub const NO_RADIANCE: u32 = 1 << 7;
/// The temperature is outside the calibrated range by at most 10 % of it in 1/T.
pub const EXTRAPOLATED: u32 = 1 << 8;
/// The temperature would be further outside: NaN.
pub const OUT_OF_RANGE: u32 = 1 << 9;
/// The paper's weights were not possible (a level with one cycle): unweighted line.
pub const FELL_BACK_TO_OLS: u32 = 1 << 10;
/// Too little data for a statistical uncertainty: sigmas are NaN (`ols`) or the camera's noise only (`default`).
pub const NO_STATISTICS: u32 = 1 << 11;

/// At least one cycle was left out of this pixel alone: further from the line than five standard deviations.
pub const OUTLIERS: u32 = 1 << 12;

/// The emissivity is below the limit that was asked for. The numbers stay.
pub const LOW_EMISSIVITY: u32 = 1 << 13;
/// The temperature's standard deviation is above the limit that was asked for, or not known. The numbers stay.
pub const HIGH_SIGMA: u32 = 1 << 14;

/// Every flag with its name and meaning, in order of bits.
pub const LEGEND: [(u32, &str, &str); 15] = [
    (TOO_FEW_LEVELS, "TOO_FEW_LEVELS", "fewer than two levels left, no line"),
    (SATURATED, "SATURATED", "cycles left out because of saturated samples"),
    (DEAD, "DEAD", "pixel never changes"),
    (CONSTANT, "CONSTANT", "spray minus blank is the same in every cycle"),
    (NO_PLATE, "NO_PLATE", "pixel does not see the plate"),
    (NOT_RESOLVED, "NOT_RESOLVED", "slope not significant, set of temperatures unbounded"),
    (NEGATIVE_EMISSIVITY, "NEGATIVE_EMISSIVITY", "emissivity below zero"),
    (NO_RADIANCE, "NO_RADIANCE", "crossing without light"),
    (EXTRAPOLATED, "EXTRAPOLATED", "temperature up to 10 % outside the calibrated range in 1/T"),
    (OUT_OF_RANGE, "OUT_OF_RANGE", "temperature further outside, NaN"),
    (FELL_BACK_TO_OLS, "FELL_BACK_TO_OLS", "a level with one cycle, unweighted line"),
    (NO_STATISTICS, "NO_STATISTICS", "no statistical uncertainty"),
    (OUTLIERS, "OUTLIERS", "cycles left out as spikes"),
    (LOW_EMISSIVITY, "LOW_EMISSIVITY", "masked: emissivity below the limit asked for"),
    (HIGH_SIGMA, "HIGH_SIGMA", "masked: sigma of the temperature above the limit asked for"),
];
