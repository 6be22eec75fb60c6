//! Takes the walls' light out of a map, if somebody knows how much of it there is.
//!
//! Light of the chamber's walls that the spray scatters into the sight looks like light of the spray. With the wall
//! share w = a_walls/(1 − a_plate) the effective radiance is L_eff = (1 − w)·L_obj + w·B(T_E), so that
//! L_obj = (L_eff − w·B(T_E))/(1 − w): what the spray itself gives. w comes from `ditd render` or another model of the
//! transport, with its σ: nothing in a measured map can tell it, χ² is blind to it. A bare albedo gives an upper bound
//! of it only (single scattering in a black cavity, all light that is scattered replaced by the walls'): such a
//! correction is labelled so and is never applied by default; it would shift by tens of kelvins where the bias is one.

use super::calibration::SakumaHattori;

/// What is known of the walls' share.
#[derive(Debug, Clone, PartialEq)]
pub struct WallLight {
    /// w per pixel, `[rows · columns]`, 0 … 1 exclusive; NaN where it is not known.
    pub share: Vec<f64>,
    /// Standard deviation of w per pixel, ≥ 0.
    pub sigma_share: Vec<f64>,
    /// Temperature of the walls, in K.
    pub wall_k: f64,
    /// Its standard deviation, in K.
    pub sigma_wall_k: f64,
    /// Whether `share` is an upper bound from a bare albedo.
    pub upper_bound: bool,
}

/// A map's temperatures without the walls' light, `[rows · columns]`; NaN where the map has none, the share is not
/// known, or the walls would outshine what was seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Corrected {
    /// Temperature of the spray's own radiance, in K.
    pub temperature_object_k: Vec<f64>,
    /// Its standard deviation in K: of the map, of the share and of the walls' temperature.
    pub sigma_temperature_object_k: Vec<f64>,
    /// Whether the share was an upper bound.
    pub upper_bound: bool,
}

/// Corrects temperatures `seen_k` of standard deviations `sigma_seen_k`, both in K and `[rows · columns]`.
///
/// Panics unless there is one share and one σ per pixel, which is the caller's mistake.
pub fn corrected(
    seen_k: &[f64],
    sigma_seen_k: &[f64],
    curve: &SakumaHattori,
    light: &WallLight,
) -> Corrected {
    let pixels = seen_k.len();
    assert!(light.share.len() == pixels && light.sigma_share.len() == pixels, "one share per pixel");
    assert!(sigma_seen_k.len() == pixels, "one σ per pixel");
    // In counts of I_cal all radiances have the same factor ε_B, so it cancels.
    let walls = curve.value(light.wall_k);
    let sigma_walls = curve.derivative(light.wall_k) * light.sigma_wall_k;
    let both = (0..pixels).map(|i| {
        let (seen_k, w) = (seen_k[i], light.share[i]);
        if !(0.0..1.0).contains(&w) {
            return (f64::NAN, f64::NAN);
        }
        let seen = curve.value(seen_k);
        let own = (seen - w * walls) / (1.0 - w);
        let kelvin = curve.inverse(own);
        // ∂L_obj: by L_eff 1/(1 − w), by w (L_obj − B)/(1 − w), by B −w/(1 − w).
        let of_map = curve.derivative(seen_k) * sigma_seen_k[i];
        let of_share = (own - walls) * light.sigma_share[i];
        let of_walls = w * sigma_walls;
        let sigma = of_map.hypot(of_share).hypot(of_walls) / (1.0 - w);
        (kelvin, sigma * curve.inverse_derivative(own, kelvin))
    });
    let (temperature_object_k, sigma_temperature_object_k) = both.unzip();
    Corrected { temperature_object_k, sigma_temperature_object_k, upper_bound: light.upper_bound }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn light(share: f64, sigma: f64) -> WallLight {
        WallLight {
            share: vec![share],
            sigma_share: vec![sigma],
            wall_k: 523.0,
            sigma_wall_k: 2.0,
            upper_bound: false,
        }
    }

    fn found(kelvin: f64, sigma: f64, light: &WallLight) -> (f64, f64) {
        let out = corrected(&[kelvin], &[sigma], &CURVE, light);
        (out.temperature_object_k[0], out.sigma_temperature_object_k[0])
    }

    /// Mixed radiances come apart again, and σ is what small steps of each input say.
    #[test]
    fn mixed_light_comes_apart() {
        let (own, w) = (430.0, 0.12);
        let mixed = CURVE.inverse((1.0 - w) * CURVE.value(own) + w * CURVE.value(523.0));
        let at = |kelvin: f64, share: f64, wall_k: f64| {
            let light = WallLight { wall_k, ..light(share, 0.0) };
            found(kelvin, 0.0, &light).0
        };
        assert!((at(mixed, w, 523.0) - own).abs() < 1e-9);
        let steps = [
            (at(mixed + 0.01, w, 523.0) - own) / 0.01 * 0.5,
            (at(mixed, w + 1e-5, 523.0) - own) / 1e-5 * 0.03,
            (at(mixed, w, 523.01) - own) / 0.01 * 2.0,
        ];
        let (_, found) = found(mixed, 0.5, &light(w, 0.03));
        let want = steps.iter().map(|s| s * s).sum::<f64>().sqrt();
        assert!((found / want - 1.0).abs() < 1e-2, "{found} {want}");
    }

    #[test]
    fn what_is_not_known_stays_unknown() {
        for share in [f64::NAN, -0.1, 1.0, 1.5] {
            assert!(found(450.0, 1.0, &light(share, 0.0)).0.is_nan());
        }
        // The walls alone would be brighter than what was seen.
        assert!(found(400.0, 1.0, &light(0.5, 0.0)).0.is_nan());
        let none = found(f64::NAN, f64::NAN, &light(0.1, 0.0));
        assert!(none.0.is_nan() && none.1.is_nan());
        let whole = found(450.0, 1.0, &light(0.0, 0.0));
        assert!((whole.0 - 450.0).abs() < 1e-9 && (whole.1 - 1.0).abs() < 1e-9);
    }
}
