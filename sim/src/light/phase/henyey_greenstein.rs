//! The phase function of Henyey and Greenstein (1941), every formula written so that nothing cancels at either peak
//! and nothing is divided by g.
//!
//! The argument is the versine 1 − cos θ, which keeps its digits at small angles.

/// p = (1 − g²) / ((1 − g)² + 2 g v)^(3/2).
pub(super) fn value(asymmetry: f64, versine: f64) -> f64 {
    let g = asymmetry.abs();
    let v = if asymmetry < 0.0 { 2.0 - versine } else { versine };
    if g >= 1.0 {
        return if v <= 0.0 { f64::MAX } else { 0.0 };
    }
    let base = (1.0 - g) * (1.0 - g) + 2.0 * g * v.max(0.0);
    (1.0 - g) * (1.0 + g) / (base * base.sqrt())
}

/// The inverse of the cumulative distribution, multiplied out: with s = 2u − 1,
/// μ = (s + g(s² + 3)/2 + g² s + g³(s² − 1)/2) / (1 + g s)².
pub(super) fn sample(asymmetry: f64, u: f64) -> f64 {
    let g = asymmetry;
    if g.abs() >= 1.0 {
        return g.signum();
    }
    let s = 2.0 * u - 1.0;
    let base = 1.0 + g * s;
    let numerator = s + 0.5 * g * (s * s + 3.0) + g * g * s + 0.5 * g * g * g * (s * s - 1.0);
    (numerator / (base * base)).clamp(-1.0, 1.0)
}

/// Share of the light at angles below that of the versine: (1 + g) v / (D (1 − g + D)), D² = (1 − g)² + 2 g v.
pub(super) fn within(asymmetry: f64, versine: f64) -> f64 {
    let g = asymmetry;
    if g >= 1.0 || versine >= 2.0 {
        return 1.0;
    }
    let root = ((1.0 - g) * (1.0 - g) + 2.0 * g * versine).max(0.0).sqrt();
    ((1.0 + g) * versine / (root * (1.0 - g + root))).clamp(0.0, 1.0)
}
