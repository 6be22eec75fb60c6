//! What holds for the curve of any camera, before its filter is named: how far b can be.
//!
//! b = c2·s²/(2 λ₀²) for a response of mean wavelength λ₀ and rms width s ([`super::Passband`]), and no camera's relative
//! width is negative. Fitted to band integrals over 340 … 610 K, b is 0.7 µm K for 3.34 … 3.46 µm, 1.6 for 3.8 … 4.0, 22 for
//! 7.7 … 9.3, 38 for 3.7 … 4.8, 101 for 8 … 12, 112 for 3 … 5, 179 for 1.5 … 5.1, 202 for 2 … 5.5, 226 for 7.5 … 14; a
//! leak of 1 % over 1 … 6 µm makes 234 of a filter of 3.4 µm. With a free offset ten noisy points know b to ± 18 only.
//!
//! What is said here: the relative width is anywhere between none and a fifth, each as likely, and b a little off. Where points
//! know better they decide.

use super::C2_UM_K;
use super::band::Known;

/// Largest relative rms width: b = 288 µm K, above all bands there are.
const WIDTH_MAX: f64 = 0.2;

/// Standard deviation of b about c2·s²/(2 λ₀²), in µm K: what a leak of 1e-4 moves it.
const SOFT_UM_K: f64 = 3.0;

/// Widths that are tried. From one to the next b rises by 1.4 at most, half of its softness.
const WIDTHS: u32 = 400;

/// Mean and standard deviation of b, in µm K, when points alone say `fitted`.
///
/// The part of the variance that comes from what bands are like counts twice. One camera has one band: where its points say
/// nothing b is off by 1.1 (narrow bands) or 1.5 (7.5 … 14 µm) standard deviations of all bands in every calibration, and 0.8
/// or 1.1 of what is told.
pub(super) fn b_of_any_band(fitted: Known) -> Known {
    let (soft, own) = (SOFT_UM_K * SOFT_UM_K, fitted.sigma * fitted.sigma);
    // For a width b is normal about its own value, and so is what the points say of it.
    let each = || {
        (0..WIDTHS).map(move |k| {
            let width = WIDTH_MAX * (f64::from(k) + 0.5) / f64::from(WIDTHS);
            let b = 0.5 * C2_UM_K * width * width;
            let off = fitted.value - b;
            let mean = fitted.value - off * (own / (own + soft));
            (mean, -0.5 * off * off / (own + soft))
        })
    };
    let likeliest = each().map(|(_, log)| log).fold(f64::NEG_INFINITY, f64::max);
    let weighed = || each().map(move |(mean, log)| (mean, libm::exp(log - likeliest)));
    let sum: f64 = weighed().map(|(_, weight)| weight).sum();
    let mean = weighed().map(|(mean, weight)| weight * mean).sum::<f64>() / sum;
    let spread = weighed().map(|(one, weight)| weight * (one - mean) * (one - mean)).sum::<f64>() / sum;
    let variance = spread + own * (soft / (own + soft));
    let by_bands = if own > variance { 1.0 - variance / own } else { 0.0 };
    Known { value: mean, sigma: (variance * (1.0 + by_bands)).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(value: f64, sigma: f64) -> Known {
        b_of_any_band(Known { value, sigma })
    }

    /// Points that know b decide, wherever it is; points that know little are drawn to what bands have; for nothing known b is
    /// that of uniform widths, mean c2·0.2²/6 = 95.9 and mean square (c2/2)²·0.2⁴/5.
    #[test]
    fn points_that_know_decide() {
        for b in [-40.0, 1.5, 120.0, 400.0] {
            let sure = of(b, 1e-6);
            assert!((sure.value - b).abs() < 1e-9 && (sure.sigma / 1e-6 - 1.0).abs() < 1e-6);
        }
        for b in [-30.0, 1.5, 120.0, 250.0] {
            let some = of(b, 18.0);
            assert!((-5.0..=290.0).contains(&some.value) && some.sigma < 25.0, "{b} {some:?}");
        }
        // In the middle of the range widths hardly prefer any b: d ln p/db = −1/(2b).
        let open = of(120.0, 18.0);
        assert!((open.value - (120.0 - 18.0 * 18.0 / 240.0)).abs() < 0.5 && (open.sigma - 18.0).abs() < 1.5);
        let none = of(0.0, 1e9);
        let mean = C2_UM_K * 0.04 / 6.0;
        let square = (0.5 * C2_UM_K).powi(2) * 0.2_f64.powi(4) / 5.0;
        assert!((none.value / mean - 1.0).abs() < 1e-5, "{none:?} {mean}");
        let sigma = (2.0 * (square - mean * mean + SOFT_UM_K * SOFT_UM_K)).sqrt();
        assert!((none.sigma / sigma - 1.0).abs() < 1e-4, "{none:?} {sigma}");
    }
}
