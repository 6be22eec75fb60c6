//! The phase function of spheres much smaller than the wavelength, p = ¾ (1 + μ²): Rayleigh (1871).

/// p at the cosine.
pub(super) fn value(cosine: f64) -> f64 {
    0.75 * (1.0 + cosine * cosine)
}

/// The inverse of the cumulative distribution: the only real root of μ³ + 3 μ + 4 − 8 u = 0 (Cardano).
pub(super) fn sample(u: f64) -> f64 {
    // Odd in 2u − 1: with its modulus nothing cancels in the sum under the root.
    let half = (4.0 * u - 2.0).abs();
    let root = (half + half.hypot(1.0)).cbrt();
    (root - 1.0 / root).copysign(u - 0.5).clamp(-1.0, 1.0)
}

/// Share of the light at angles below that of the versine.
pub(super) fn within(versine: f64) -> f64 {
    // ⅜ ∫₀^v (1 + (1 − w)²) dw = ⅜ (2 v − v² + v³/3).
    (0.375 * versine * (2.0 - versine * (1.0 - versine / 3.0))).clamp(0.0, 1.0)
}
