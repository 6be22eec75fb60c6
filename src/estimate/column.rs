//! From the emissivity of a sight to the column of what absorbs along it, and its uncertainty.
//!
//! In a gray band ε = 1 − exp(−τ) and τ = −ln(1 − ε) is additive along the sight. In a band with structure it is not: strong
//! lines are black before weak ones are seen. What is additive is the amount u of the absorber, and
//! ε = 1 − Σ g_i exp(−κ_i τ), its curve of growth, with weights g (response · light of the plate, Σ g = 1) and relative
//! absorption κ (Σ g κ = 1): τ is then the depth that thin layers of the same absorber add up to, k̄·u with the band's mean
//! absorption coefficient k̄. Pure: arrays in, arrays out.

/// Standard deviations by which ε must stay below 1 for a column to be told.
pub const OPAQUE_SIGMAS: f64 = 2.0;

/// Depth from which a column is not told, whatever its σ: exp(−36) is below the rounding of ε.
const DEPTH_MAX: f64 = 36.0;

/// Steps of the search for a depth.
const STEPS_MAX: usize = 200;

/// How the emissivity grows with the column of an absorber.
#[derive(Debug, Clone, PartialEq)]
pub struct Growth {
    /// Weight and relative absorption of each part of the band; Σ g = Σ g κ = 1.
    parts: Vec<(f64, f64)>,
    /// Σ g k before it was made 1: in the unit of the coefficients given.
    mean: f64,
}

/// Columns of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Depths {
    /// τ; NaN where the sight is opaque or ε is not known.
    pub depth: Vec<f64>,
    /// Its standard deviation; NaN with it, or where σ of ε is not known.
    pub sigma: Vec<f64>,
    /// Where ε + 2σ ≥ 1.
    pub opaque: Vec<bool>,
}

impl Growth {
    /// A gray band.
    pub fn gray() -> Self {
        Self { parts: vec![(1.0, 1.0)], mean: 1.0 }
    }

    /// From weights g ≥ 0 (response times the light that is absorbed) and absorption coefficients k ≥ 0 of the parts of a
    /// band, both in any unit.
    ///
    /// # Errors
    ///
    /// What is wrong with them, in words.
    pub fn new(weights: &[f64], coefficients: &[f64]) -> Result<Self, String> {
        if weights.len() != coefficients.len() {
            return Err(format!("{} weights for {} coefficients", weights.len(), coefficients.len()));
        }
        if !weights.iter().chain(coefficients).all(|v| v.is_finite() && *v >= 0.0) {
            return Err("weights and coefficients must be numbers that are not negative".into());
        }
        let whole: f64 = weights.iter().sum();
        let mean = weights.iter().zip(coefficients).map(|(g, k)| g * k).sum::<f64>() / whole;
        if !(mean > 0.0 && mean.is_finite()) {
            return Err("nothing absorbs: weights or coefficients are all zero".into());
        }
        let parts = weights.iter().zip(coefficients).map(|(g, k)| (g / whole, k / mean)).collect();
        Ok(Self { parts, mean })
    }

    /// Mean absorption coefficient of the band for a thin layer, in the unit of the coefficients given.
    pub fn mean_coefficient(&self) -> f64 {
        self.mean
    }

    /// ε of a depth.
    pub fn emissivity(&self, depth: f64) -> f64 {
        -self.parts.iter().map(|(g, k)| g * (-k * depth).exp_m1()).sum::<f64>()
    }

    /// dε/dτ.
    fn slope(&self, depth: f64) -> f64 {
        self.parts.iter().map(|(g, k)| g * k * (-k * depth).exp()).sum()
    }

    /// The depth of an ε; negative for ε < 0 as noise makes it; NaN where no depth below 36 has it.
    pub fn depth(&self, emissivity: f64) -> f64 {
        if let [_] = self.parts[..] {
            let depth = -(-emissivity).ln_1p();
            return if depth <= DEPTH_MAX { depth } else { f64::NAN };
        }
        // ε is concave and rising: ε ≤ τ, and −ln(1 − ε) ≤ τ by Jensen's inequality.
        if emissivity.is_nan() || emissivity >= self.emissivity(DEPTH_MAX) {
            return f64::NAN;
        }
        let (mut low, mut high) = if emissivity >= 0.0 { (0.0, DEPTH_MAX) } else { (emissivity * 2.0, 0.0) };
        // Below zero the growth is exponential: e(−x) ≤ −x.
        if emissivity < 0.0 {
            low = emissivity;
        }
        let mut depth = if emissivity >= 0.0 { -(-emissivity).ln_1p() } else { emissivity };
        for _ in 0..STEPS_MAX {
            let excess = self.emissivity(depth) - emissivity;
            if excess > 0.0 {
                high = high.min(depth)
            } else {
                low = low.max(depth)
            }
            let next = depth - excess / self.slope(depth);
            let next = if next > low && next < high { next } else { 0.5 * (low + high) };
            let done = (next - depth).abs() <= 1e-15 * depth.abs();
            depth = next;
            if done {
                break;
            }
        }
        depth
    }

    /// Depths of emissivities with standard deviations `sigma` (NaN or none: not known).
    ///
    /// Panics unless there is a σ per emissivity, if any.
    pub fn depths(&self, emissivity: &[f64], sigma: Option<&[f64]>) -> Depths {
        assert!(sigma.is_none_or(|sigma| sigma.len() == emissivity.len()), "one σ per emissivity");
        let n = emissivity.len();
        let mut out = Depths { depth: vec![f64::NAN; n], sigma: vec![f64::NAN; n], opaque: vec![false; n] };
        for i in 0..n {
            let e = emissivity[i];
            let s = sigma.map_or(0.0, |sigma| sigma[i]);
            let margin = if s.is_finite() { OPAQUE_SIGMAS * s } else { 0.0 };
            let depth = self.depth(e);
            if e + margin >= 1.0 || (e.is_finite() && depth.is_nan()) {
                out.opaque[i] = true;
                continue;
            }
            out.depth[i] = depth;
            if sigma.is_some() {
                out.sigma[i] = s / self.slope(depth);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_bands_have_their_logarithm() {
        let gray = Growth::gray();
        let found = gray.depths(&[0.5, 0.0, -0.01, 0.9, 1.0, 1.2, f64::NAN, 1e-12], Some(&[0.01; 8]));
        assert!((found.depth[0] - 2.0_f64.ln()).abs() < 1e-15 && (found.sigma[0] - 0.02).abs() < 1e-15);
        assert!(found.depth[1].abs() < 1e-300 && found.depth[2] < 0.0 && found.depth[2] > -0.01);
        assert_eq!(found.opaque, [false, false, false, false, true, true, false, false]);
        assert!(found.depth[4].is_nan() && found.depth[6].is_nan());
        assert!((found.depth[7] - 1e-12).abs() < 1e-24);
        // ε + 2σ reaches 1.
        assert!(gray.depths(&[0.9], Some(&[0.051])).opaque[0]);
        assert!(gray.depths(&[0.9], None).depth[0] > 2.3);
    }

    /// Back and forth at every depth, and a structured band is never as black as a gray one of the same thin depth.
    #[test]
    fn growth_is_inverted_over_its_range() {
        let growth = Growth::new(&[2.0, 1.0, 1.0], &[0.1, 3.0, 40.0]).unwrap();
        assert!((growth.mean_coefficient() - 10.8).abs() < 1e-12);
        for depth in [-0.3, -1e-6, 1e-14, 1e-6, 0.01, 0.3, 1.0, 5.0, 20.0, 35.0] {
            let e = growth.emissivity(depth);
            let bound = 4e-16 * (e.abs() / growth.slope(depth)).max(depth.abs()) + 4e-16 * depth.abs();
            assert!((growth.depth(e) - depth).abs() <= 4.0 * bound, "{depth} {}", growth.depth(e));
            assert!(depth < 0.0 || e <= -(-depth).exp_m1());
        }
        // One part is dark: ε cannot be told above what the others reach.
        let half = Growth::new(&[1.0, 1.0], &[0.0, 1.0]).unwrap();
        assert!(half.depth(0.6).is_nan() && half.depths(&[0.6], None).opaque[0]);
        assert!(Growth::new(&[1.0], &[0.0]).is_err() && Growth::new(&[0.0], &[1.0]).is_err());
        assert!(Growth::new(&[1.0], &[-1.0]).is_err() && Growth::new(&[1.0], &[]).is_err());
        assert!(Growth::new(&[], &[]).is_err());
    }

    /// σ of a depth is the change that σ of ε makes.
    #[test]
    fn sigma_follows_the_slope() {
        let growth = Growth::new(&[1.0, 1.0], &[0.2, 5.0]).unwrap();
        let (e, s) = (0.6, 1e-6);
        let found = growth.depths(&[e], Some(&[s]));
        let measured = 0.5 * (growth.depth(e + s) - growth.depth(e - s));
        assert!((found.sigma[0] / measured - 1.0).abs() < 1e-6);
    }
}
