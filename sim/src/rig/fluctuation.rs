//! How one injection differs from the next: smooth random fields of optical depth and temperature.
//!
//! The declared law: at every pixel ln(optical depth) and the medium's temperature are shifted by a pair of
//! normal numbers of standard deviations `sigma_ln_tau` and `sigma_temperature_k` and the given correlation, the
//! same at every pixel; over the image they are smooth (correlation exp(−d²/2ℓ²) on average over seeds). Each
//! field is a sum of cosine modes with normal amplitudes, so both marginals are exactly normal. Knows nothing of
//! radiances.

use super::config::FluctuationConfig;
use super::noise::{Purpose, Stream, normal_quantile};

/// Cosine modes of a field. Twice as many normal amplitudes; more modes cost time and change no marginal.
const MODES: usize = 16;

/// The law by which injections differ.
#[derive(Debug, Clone)]
pub struct ShotLaw {
    law: FluctuationConfig,
    seed: u64,
    /// Wave number along the rows' direction of each mode, in radians per pixel.
    wave_row: [f64; MODES],
    /// cos and sin of each mode along a row, `[mode][column]`.
    cosine: Vec<f32>,
    sine: Vec<f32>,
    columns: usize,
}

/// The amplitudes of one injection.
#[derive(Debug, Clone)]
pub struct Shot<'a> {
    law: &'a ShotLaw,
    /// Per mode: cosine and sine amplitude of ln τ, then of the temperature in kelvin.
    amplitudes: [[f64; 4]; MODES],
}

impl ShotLaw {
    /// The law over an image of `columns` columns; `seed` chooses the modes and all injections.
    pub fn new(law: FluctuationConfig, seed: u64, columns: usize) -> Self {
        let stream = Stream::new(seed, Purpose::Modes, 0);
        // Normal wave numbers of deviation 1/ℓ give the correlation exp(−d²/2ℓ²) on average over seeds.
        let wave = |i: usize| stream.gaussian(i as u64) / law.correlation_length_px;
        let mut cosine = Vec::with_capacity(MODES * columns);
        let mut sine = Vec::with_capacity(MODES * columns);
        for mode in 0..MODES {
            let wave_column = wave(MODES + mode);
            for column in 0..columns {
                let (s, c) = libm::sincos(wave_column * column as f64);
                #[expect(clippy::cast_possible_truncation, reason = "fields are f32")]
                {
                    cosine.push(c as f32);
                    sine.push(s as f32);
                }
            }
        }
        Self { law, seed, wave_row: std::array::from_fn(wave), cosine, sine, columns }
    }

    /// The numbers of the law.
    pub fn law(&self) -> &FluctuationConfig {
        &self.law
    }

    /// Injection number `injection`, counted from 0 over the life of the rig.
    pub fn shot(&self, injection: u64) -> Shot<'_> {
        let stream = Stream::new(self.seed, Purpose::Injection, injection);
        let norm = 1.0 / libm::sqrt(MODES as f64);
        let amplitudes = std::array::from_fn(|mode| {
            let draw = |part: usize| stream.gaussian((4 * mode + part) as u64) * norm;
            let depth = [draw(0), draw(1)];
            let own = [draw(2), draw(3)];
            let [c, s] = [0, 1].map(|i| self.conditional(depth[i], own[i]));
            let tau = self.law.sigma_ln_tau;
            [depth[0] * tau, depth[1] * tau, c, s]
        });
        Shot { law: self, amplitudes }
    }

    /// Temperature shift in kelvin that goes with the standard normal numbers `depth` (shared) and `own`.
    fn conditional(&self, depth: f64, own: f64) -> f64 {
        let rho = self.law.correlation;
        self.law.sigma_temperature_k * (rho * depth + libm::sqrt(1.0 - rho * rho) * own)
    }

    /// The marginal law at any pixel for quadrature: `points` values of ln(τ factor), equally likely, each with
    /// the mean and the mean square (K, K²) of the temperature shift that go with it.
    ///
    /// One point in each of `points` equal strata of probability, its place in the stratum drawn per replicate:
    /// a base-2 net under Owen's scramble in one dimension. The mean over replicates is unbiased.
    pub fn marginal(&self, replicate: u64, points: usize) -> Vec<[f64; 3]> {
        let stream = Stream::new(self.seed, Purpose::Scramble, replicate);
        let (sigma, rho) = (self.law.sigma_temperature_k, self.law.correlation);
        let own = sigma * sigma * (1.0 - rho * rho);
        (0..points)
            .map(|i| {
                let p = (i as f64 + stream.uniform(i as u64)) / points as f64;
                let z = normal_quantile(p);
                let shift = sigma * rho * z;
                [self.law.sigma_ln_tau * z, shift, shift * shift + own]
            })
            .collect()
    }
}

impl Shot<'_> {
    /// Writes ln(τ factor) and the temperature shift in kelvin for the columns from `first` on of one row.
    ///
    /// # Panics
    /// When the slices differ in length or reach beyond the last column.
    pub fn row(&self, row: usize, first: usize, ln_tau: &mut [f32], shift_k: &mut [f32]) {
        assert_eq!(ln_tau.len(), shift_k.len(), "both fields cover the same columns");
        assert!(first + ln_tau.len() <= self.law.columns, "columns lie inside the image");
        ln_tau.fill(0.0);
        shift_k.fill(0.0);
        for mode in 0..MODES {
            let (s, c) = libm::sincos(self.law.wave_row[mode] * row as f64);
            let [tau_c, tau_s, kelvin_c, kelvin_s] = self.amplitudes[mode];
            // a·cos(y + x) + b·sin(y + x), sorted by cos x and sin x.
            let turn = |a: f64, b: f64| {
                #[expect(clippy::cast_possible_truncation, reason = "fields are f32")]
                let pair = ((a * c + b * s) as f32, (b * c - a * s) as f32);
                pair
            };
            let (tau_x, tau_y) = turn(tau_c, tau_s);
            let (kelvin_x, kelvin_y) = turn(kelvin_c, kelvin_s);
            let start = mode * self.law.columns + first;
            let cosine = &self.law.cosine[start..start + ln_tau.len()];
            let sine = &self.law.sine[start..start + ln_tau.len()];
            for (((tau, kelvin), x), y) in ln_tau.iter_mut().zip(shift_k.iter_mut()).zip(cosine).zip(sine) {
                *tau += tau_x * x + tau_y * y;
                *kelvin += kelvin_x * x + kelvin_y * y;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: FluctuationConfig = FluctuationConfig {
        sigma_ln_tau: 0.25,
        sigma_temperature_k: 5.0,
        correlation: -0.4,
        correlation_length_px: 20.0,
    };

    /// 4000 injections at three far places: variances and correlation as declared, within five standard errors
    /// (relative 5·√(2/n) of a variance, 5·(1 − ρ²)/√n of a correlation).
    #[test]
    fn marginal_variances_and_correlation_are_the_declared_ones() {
        let law = ShotLaw::new(LAW, 11, 64);
        let n = 4000_u32;
        for (row, column) in [(0, 0), (17, 63), (400, 31)] {
            let (mut tt, mut kk, mut tk) = (0.0, 0.0, 0.0);
            for injection in 0..n {
                let (mut tau, mut kelvin) = ([0.0_f32], [0.0_f32]);
                law.shot(u64::from(injection)).row(row, column, &mut tau, &mut kelvin);
                let (t, k) = (f64::from(tau[0]), f64::from(kelvin[0]));
                tt += t * t;
                kk += k * k;
                tk += t * k;
            }
            let n = f64::from(n);
            assert!((tt / n / 0.0625 - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{tt}");
            assert!((kk / n / 25.0 - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{kk}");
            assert!((tk / (tt * kk).sqrt() + 0.4).abs() < 5.0 * 0.84 / n.sqrt(), "{tk}");
        }
    }

    /// Neighbours move together, distant pixels do not (mean over injections and seeds).
    #[test]
    fn fields_are_smooth_over_the_correlation_length() {
        let (mut near, mut far, mut own) = (0.0_f64, 0.0_f64, 0.0_f64);
        for seed in 0..200 {
            let law = ShotLaw::new(LAW, seed, 256);
            for injection in 0..10 {
                let (mut tau, mut kelvin) = (vec![0.0_f32; 256], vec![0.0_f32; 256]);
                law.shot(injection).row(5, 0, &mut tau, &mut kelvin);
                own += f64::from(tau[0] * tau[0]);
                near += f64::from(tau[0] * tau[20]);
                far += f64::from(tau[0] * tau[200]);
            }
        }
        // exp(−1/2) at one correlation length; 2000 partly dependent products.
        assert!((near / own - 0.6065).abs() < 0.1, "{}", near / own);
        assert!((far / own).abs() < 0.15, "{}", far / own);
    }

    #[test]
    fn quadrature_has_the_moments_of_the_law() {
        let law = ShotLaw::new(LAW, 3, 8);
        let points = law.marginal(0, 1024);
        let mean = |f: &dyn Fn(&[f64; 3]) -> f64| points.iter().map(f).sum::<f64>() / 1024.0;
        // A jittered net of n points errs by about n^-1.5 times the slope at the ends (a few).
        assert!(mean(&|p| p[0]).abs() < 2e-3);
        assert!((mean(&|p| p[0] * p[0]) - 0.0625).abs() < 1e-3);
        assert!((mean(&|p| p[2]) - 25.0).abs() < 0.1);
        assert!((mean(&|p| p[0] * p[1]) + 0.4 * 0.25 * 5.0).abs() < 5e-3);
        assert_ne!(points, law.marginal(1, 1024));
    }

    #[test]
    fn an_injection_is_the_same_whenever_it_is_asked_for() {
        let law = ShotLaw::new(LAW, 3, 32);
        let field = |injection| {
            let (mut tau, mut kelvin) = (vec![0.0_f32; 32], vec![0.0_f32; 32]);
            law.shot(injection).row(9, 0, &mut tau, &mut kelvin);
            (tau, kelvin)
        };
        let first = field(5);
        let other = field(6);
        assert_eq!(first, field(5));
        assert_ne!(first, other);
        // A part of a row has the values of the whole row.
        let (mut tau, mut kelvin) = (vec![0.0_f32; 4], vec![0.0_f32; 4]);
        law.shot(5).row(9, 20, &mut tau, &mut kelvin);
        assert_eq!(tau, first.0[20..24]);
    }
}
