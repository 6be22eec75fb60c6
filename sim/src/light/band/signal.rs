//! Black-body signals of a response, integrated to rounding.
//!
//! A response is a polynomial between its nodes, and Planck's law is analytic: each piece is integrated by
//! Gauss–Legendre nodes whose number follows from its width in x = hc/(λkT). Responses that are functions and not
//! tables go through an adaptive rule with a stated error.

use super::Response;
use crate::light::planck::{SECOND_RADIATION_UM_K, SPEED_OF_LIGHT, photon_radiance};
use crate::light::quadrature::{Adaptive, adaptive, gauss_legendre};
use std::sync::LazyLock;

/// exp(−x) beyond this is nothing.
const X_MAX: f64 = 800.0;
/// Widest panel in x (or in 4 ln λ where x < 4).
const PANEL: f64 = 2.0;
/// Largest number of nodes of a panel, and the largest degree that they are counted for.
const NODES_MAX: usize = 24;
/// Coldest temperature that [`BandSignal`] keeps its nodes for, unless asked otherwise, in K.
pub const COLDEST_K: f64 = 150.0;

/// Black-body signals of one response, with the quadrature kept.
#[derive(Debug, Clone)]
pub struct BandSignal {
    response: Response,
    coldest_k: f64,
    points: Vec<(f64, f64)>,
}

impl BandSignal {
    /// Keeps the nodes that hold for every temperature from `coldest_k` up.
    pub fn new(response: &Response, coldest_k: f64) -> Self {
        let coldest_k = if coldest_k > 0.0 { coldest_k } else { COLDEST_K };
        Self { response: response.clone(), coldest_k, points: points(response, coldest_k, false) }
    }

    /// Wavelengths in µm and weights (response × Δλ in µm) of the quadrature.
    pub fn points(&self) -> &[(f64, f64)] {
        &self.points
    }

    /// ∫ R(λ) L(λ, T) dλ: photons s⁻¹ m⁻² sr⁻¹ times the unit of the response. Relative error below
    /// 1e-14 + 2⁻⁵¹ x with x = hc/λkT at the long end (4e-14 at 300 K), at any temperature; 0 where it underflows. Below the coldest temperature the nodes are made anew.
    pub fn signal(&self, temperature_k: f64) -> f64 {
        if temperature_k >= self.coldest_k {
            sum(&self.points, temperature_k)
        } else {
            signal(&self.response, temperature_k)
        }
    }

    /// The signal and its first two derivatives by 1/T (K, K²), for temperatures from the coldest up.
    pub(super) fn moments(&self, temperature_k: f64) -> [f64; 3] {
        moments(self.points.iter().copied(), temperature_k)
    }
}

/// ∫ R(λ) L(λ, T) dλ, as [`BandSignal::signal`], for one temperature.
pub fn signal(response: &Response, temperature_k: f64) -> f64 {
    if temperature_k > 0.0 {
        sum(&points(response, temperature_k, true), temperature_k)
    } else {
        0.0 * temperature_k
    }
}

/// ∫ R(λ) L(λ, T) dλ of a smooth response over [from, to] µm to a `relative` error, which is estimated (from above)
/// in the answer. Cut at kinks and steps.
pub fn smooth_signal(
    response: impl Fn(f64) -> f64,
    [from, to]: [f64; 2],
    temperature_k: f64,
    relative: f64,
) -> Adaptive {
    adaptive(|um| response(um) * photon_radiance(um, temperature_k), from, to, relative)
}

/// Σ w and Σ w dⁿL/d(1/T)ⁿ for n = 0, 1, 2 over samples.
pub(super) fn moments(samples: impl Iterator<Item = (f64, f64)>, temperature_k: f64) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for (um, weight) in samples {
        let rate = SECOND_RADIATION_UM_K / um;
        let occupation = 1.0 / (rate / temperature_k).exp_m1();
        let square = um * um;
        let value = weight * 2e18 * SPEED_OF_LIGHT / (square * square) * occupation;
        let slope = -rate * (1.0 + occupation);
        sums[0] += value;
        sums[1] += value * slope;
        // n′ = −k n (1 + n), n″ = k² n (1 + n)(1 + 2n).
        sums[2] += value * -slope * rate * (1.0 + 2.0 * occupation);
    }
    sums
}

fn sum(points: &[(f64, f64)], temperature_k: f64) -> f64 {
    // Partial sums: the rounding of thousands of terms stays that of tens.
    points
        .chunks(64)
        .map(|chunk| chunk.iter().map(|&(um, w)| w * photon_radiance(um, temperature_k)).sum::<f64>())
        .sum()
}

/// Nodes and weights of the response's integral for temperatures from `coldest_k` up, or for that one `only`: then
/// wavelengths that give nothing are left out.
fn points(response: &Response, coldest_k: f64, only: bool) -> Vec<(f64, f64)> {
    static RULES: LazyLock<Vec<Vec<(f64, f64)>>> =
        LazyLock::new(|| (1..=NODES_MAX).map(gauss_legendre).collect());
    let mut points = Vec::new();
    for piece in response.nodes_um().windows(2) {
        let (from, to) = (piece[0], piece[1]);
        let coldest_x = |um: f64| SECOND_RADIATION_UM_K / (um * coldest_k);
        if (only && coldest_x(to) > X_MAX) || response.at(0.5 * (from + to)) == 0.0 {
            continue;
        }
        // Panels of equal ratio of wavelengths: their width in x, or in 4 ln λ, is bounded alike. Where x is beyond
        // X_MAX at the coldest temperature, the first that gives anything has x = X_MAX.
        let steepness = coldest_x(from).clamp(4.0, X_MAX);
        let stretch = (to / from).ln();
        let panels = (stretch * steepness / PANEL).ceil().max(1.0);
        // With Bernstein's ellipse drawn where the integrand has grown by a factor of 10: error ~ 100 (width/8)^2n,
        // below 1e-16 for n = 20.7/ln(8/width); the polynomial takes half its degree of the order.
        let width = (steepness * (stretch / panels).exp_m1()).max(1e-12);
        let order = (20.7 / (8.0 / width).ln()).ceil() + 0.5 * response.degree() as f64;
        let rule = RULES.iter().find(|rule| rule.len() as f64 >= order).unwrap_or(&RULES[NODES_MAX - 1]);
        let mut low = from;
        let mut panel = 1.0;
        while panel <= panels {
            let high = if panel < panels { from * (stretch * panel / panels).exp() } else { to };
            let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
            for &(node, share) in rule {
                let um = middle + half * node;
                points.push((um, half * share * response.at(um)));
            }
            low = high;
            panel += 1.0;
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::planck::photon_radiance_band;

    fn csv(rows: &[(f64, f64)]) -> Response {
        let (um, value) = rows.iter().copied().unzip();
        Response::new(um, value).unwrap()
    }

    #[test]
    fn a_flat_response_is_plancks_band() {
        // Two ways: this quadrature in λ, and that of planck in x, which agrees with 50 digits.
        for (from, to) in [(3.0, 5.0), (3.4, 3.4000001), (0.2, 40.0), (8.0, 14.0)] {
            let flat = csv(&[(from, 1.0), (to, 1.0)]);
            let kept = BandSignal::new(&flat, COLDEST_K);
            for t in [2.0, 5.0, 30.0, 150.0, 300.0, 450.0, 1e3, 6e3, 1e7] {
                let wanted = photon_radiance_band(from, to, t);
                let found = kept.signal(t);
                // The narrow band's width is rounded by ulp(3.4)/1e-7; rounding of the nodes is amplified by x.
                let x = SECOND_RADIATION_UM_K / (to * t);
                let bound = 1e-14 + 2.0 * f64::EPSILON * x + 4.4e-16 * to / (to - from);
                assert!(
                    (found - wanted).abs() <= bound * wanted + 1e-300,
                    "{from}..{to} {t}: {found} {wanted}"
                );
            }
            assert!(kept.signal(0.0) == 0.0 && kept.signal(1e-3) == 0.0 && kept.signal(f64::NAN).is_nan());
        }
    }

    #[test]
    fn pieces_of_tables_and_their_products_agree_with_the_adaptive_rule() {
        let filter = csv(&[(3.2, 0.0), (3.35, 0.8), (3.4, 1.0), (3.45, 0.75), (3.6, 0.0)]);
        let detector = csv(&[(2.0, 0.2), (3.37, 0.9), (5.5, 0.1)]);
        let lens = csv(&[(3.0, 0.95), (3.42, 0.9), (4.0, 0.97)]);
        let all = Response::product(&[filter.clone(), detector, lens]).unwrap();
        for response in [filter, all, Response::filtered_insb().unwrap()] {
            for t in [60.0, 250.0, 373.15, 449.0, 800.0] {
                let found = BandSignal::new(&response, COLDEST_K).signal(t);
                let (mut wanted, mut error) = (0.0, 0.0);
                for piece in response.nodes_um().windows(2) {
                    let part = smooth_signal(|um| response.at(um), [piece[0], piece[1]], t, 1e-13);
                    wanted += part.value;
                    error += part.error;
                }
                assert!(error <= 3e-13 * wanted, "{t}: {error:e}");
                assert!((found / wanted - 1.0).abs() < 3e-14, "{t}: {}", found / wanted - 1.0);
            }
        }
    }

    #[test]
    fn a_smooth_response_states_its_error() {
        // A gaussian filter against the same as a table of 0.1 nm, whose own error is h²/8 · R″/R ~ 1e-8/8 · 1/w².
        let gauss = |um: f64| (-0.5 * ((um - 3.4) / 0.05f64).powi(2)).exp();
        let nodes: Vec<f64> = (0..=8000).map(|i| 3.0 + 1e-4 * f64::from(i)).collect();
        let table = Response::new(nodes.clone(), nodes.iter().map(|&um| gauss(um)).collect()).unwrap();
        let found = smooth_signal(gauss, [3.0, 3.8], 450.0, 1e-12);
        assert!(found.error <= 1e-12 * found.value);
        assert!((signal(&table, 450.0) / found.value - 1.0).abs() < 1e-6);
    }

    #[test]
    fn derivatives_by_inverse_temperature_are_the_slopes() {
        let kept = BandSignal::new(&Response::filtered_insb().unwrap(), COLDEST_K);
        for t in [200.0, 450.0, 3000.0] {
            let [value, slope, curvature] = kept.moments(t);
            assert!((value / kept.signal(t) - 1.0).abs() < 1e-13);
            let h = 1e-4 / t;
            let at = |shift: f64| kept.moments(1.0 / (1.0 / t + shift * h));
            let (down, up) = (at(-1.0), at(1.0));
            // Central differences: h²/6 f‴ with f‴/f′ ~ (hc/λk)² and h hc/λk = 1e-4 x.
            let allowed = (1e-4 * SECOND_RADIATION_UM_K / (2.5 * t)).powi(2) + 1e-9;
            assert!(((up[0] - down[0]) / (2.0 * h) / slope - 1.0).abs() < allowed);
            assert!(((up[1] - down[1]) / (2.0 * h) / curvature - 1.0).abs() < allowed);
        }
    }
}
