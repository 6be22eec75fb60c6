//! The fewest wavelengths and weights that stand for a band in front of given absorbers.
//!
//! Optimal spectral sampling (Moncet, Uymin, Lipton, Snell 2008, J. Atmos. Sci. 65, 3917): out of the wavelengths of a
//! fine grid those are picked, and given positive weights, that reproduce black-body signals and a wide family of
//! columns. Picked one at a time, each time all exchanged until no exchange helps; the weights then bring down the
//! largest error. Equal stretches are taken where they do as well with fewer. Deterministic; knows no scene.

use super::columns::{Absorbers, Family, dot};
use super::equal::leak;
use super::exchange::Exchange;
use super::grid::{candidates, training_grid};
use super::{Band, BandError, Response, SOURCE_K, planck_signal};
use crate::light::fuel::Fuel;
use crate::light::planck::photon_radiance;

/// Temperatures at which black-body signals are held, K.
const SIGNALS_K: [f64; 5] = [350.0, 400.0, 450.0, 500.0, 550.0];
/// Relative error of black-body signals that a choice stays below, as a part of its target: 1e-5 for 1e-3, which is
/// half a millikelvin.
const SIGNAL_PART: f64 = 1e-2;
/// The training family is held to this part of the target, since other columns err more: up to twice as much in
/// the test with random ones.
const MARGIN: f64 = 0.45;
/// Most samples that are tried; the tracer takes 64.
const SAMPLES_MAX: usize = 48;
/// Largest number of equal stretches that they are measured against, and the numbers of leak samples among them.
const STRETCHES_MAX: usize = 64;
const LEAK_SAMPLES: [usize; 4] = [1, 2, 4, 8];
/// Times that the selection is made to grow; now and then a member goes when another comes.
const ATTEMPTS_MAX: usize = 80;
/// Rounds in which the weights of the columns follow their errors.
const ROUNDS: usize = 14;

/// A band that was chosen for a fuel, and how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// The band.
    pub band: Band,
    /// Largest absolute error of the emissivity (or scattered part) of the training columns, see
    /// [`Band::emissivity_error`]; 0 for a gray scene.
    pub emissivity_error: f64,
    /// Largest relative error of black-body signals, see [`Band::reference_error`].
    pub signal_error: f64,
}

impl Band {
    /// The fewest samples whose band emissivity errs by less than `target` (absolute, typically 1e-3) for columns of
    /// this fuel's liquid, droplets and vapour, as [`Band::automatic_for`].
    ///
    /// # Errors
    ///
    /// As [`Band::automatic_for`].
    pub fn automatic(response: &Response, fuel: &Fuel, target: f64) -> Result<Chosen, BandError> {
        Self::automatic_for(response, fuel, Absorbers::BOTH, target)
    }

    /// The fewest samples for the absorbers that are really in the scene. With none of them, and whenever the response
    /// is so narrow that nothing changes within it, that is what the black-body signals alone need: one wavelength
    /// for a narrow response.
    ///
    /// Training columns are held to 0.45 of the target, so that others are within it. At most 48 optimal samples, then
    /// up to 64 equal stretches, then the best there was, with the error it has. Wavelengths outside the band come last
    /// (see [`Band::leak_from`]); there is one at least where the leak is more than a tenth of the target.
    ///
    /// # Errors
    ///
    /// [`BandError::Target`] unless the target is positive; [`BandError::Dark`] when a black body of 350 K gives no signal
    /// that a number can hold (below 0.06 µm).
    pub fn automatic_for(
        response: &Response,
        fuel: &Fuel,
        absorbers: Absorbers,
        target: f64,
    ) -> Result<Chosen, BandError> {
        if target.is_nan() || target <= 0.0 {
            return Err(BandError::Target(target));
        }
        let fine = training_grid(response);
        if !SIGNALS_K.iter().all(|&t| planck_signal(&fine, t).is_normal()) {
            return Err(BandError::Dark(response.range_um()[1]));
        }
        let family = Family::training(&fine, fuel, absorbers);
        let optimal = Optimal::new(response, &fine, &family, target);
        let chosen = optimal.fewest(target);
        let enough = chosen.emissivity_error <= target;
        let fewer = if enough { chosen.um.len() } else { STRETCHES_MAX + 1 };
        let best = match equal(response, &family, MARGIN * target, fewer) {
            Some(equal) if enough && equal.emissivity_error <= MARGIN * target => equal,
            Some(equal) if !enough && equal.emissivity_error < chosen.emissivity_error => equal,
            _ => chosen,
        };
        let band = best.band(response);
        let signal_error = band.signal_error(&response.fine_whole());
        Ok(Chosen { band, emissivity_error: best.emissivity_error, signal_error })
    }

    /// Largest absolute error of the band emissivity of columns of the fuel's vapour, its liquid, its droplets and
    /// mixtures, and of the part of the light that the droplets scatter once; mean optical depths 0.05 to 32, weighted
    /// with black bodies of 350 and 550 K; against a 1 nm quadrature (4 nm where the response is below a thousandth).
    pub fn emissivity_error(&self, response: &Response, fuel: &Fuel) -> f64 {
        Family::training(&training_grid(response), fuel, Absorbers::BOTH)
            .largest_error(&self.wavelengths_um, &self.weights)
    }
}

/// Samples with the errors they have.
struct Candidate {
    um: Vec<f64>,
    weights: Vec<f64>,
    emissivity_error: f64,
}

impl Candidate {
    /// In band ascending, then the leak.
    fn band(&self, response: &Response) -> Band {
        let [low, high] = response.in_band_um();
        let outside = |um: f64| !(low..=high).contains(&um);
        let mut samples: Vec<(f64, f64)> =
            self.um.iter().copied().zip(self.weights.iter().copied()).collect();
        samples.sort_by(|a, b| outside(a.0).cmp(&outside(b.0)).then(a.0.total_cmp(&b.0)));
        let leak_from = samples.iter().position(|sample| outside(sample.0));
        let (wavelengths_um, weights) = samples.into_iter().unzip();
        Band { wavelengths_um, weights, leak_from }
    }
}

/// The best of equal stretches with fewer than `fewer` samples in all.
fn equal(response: &Response, family: &Family<'_>, target: f64, fewer: usize) -> Option<Candidate> {
    let leaks: Vec<Vec<(f64, f64)>> = LEAK_SAMPLES.iter().map(|&count| leak(response, count)).collect();
    let mut best: Option<Candidate> = None;
    for total in 1..fewer {
        for leak in leaks.iter().filter(|leak| leak.len() < total) {
            let Ok(band) = Band::in_band(response, total - leak.len()) else { continue };
            let Band { wavelengths_um, weights, .. } = band.with_leak(leak);
            let emissivity_error = family.largest_error(&wavelengths_um, &weights);
            if best.as_ref().is_none_or(|b| emissivity_error < b.emissivity_error) {
                best = Some(Candidate { um: wavelengths_um, weights, emissivity_error });
            }
        }
        if best.as_ref().is_some_and(|b| b.emissivity_error <= target) && family.len() > 0 {
            return best;
        }
    }
    // In front of nothing the signals decide, and those the optimal samples hold better.
    best.filter(|_| family.len() > 0)
}

/// The problem: candidates, and what is wanted of them. All errors in units of what is allowed.
struct Optimal {
    um: Vec<f64>,
    /// Whether a candidate is outside the band.
    outside: Vec<bool>,
    /// `[candidate]`: values of the columns, then parts of the black-body signals, for weight 1.
    vectors: Vec<Vec<f64>>,
    wanted: Vec<f64>,
    /// Number of columns among them.
    columns: usize,
    leak_needed: bool,
}

impl Optimal {
    fn new(response: &Response, fine: &[(f64, f64)], family: &Family<'_>, target: f64) -> Self {
        let [low, high] = response.in_band_um();
        let fine_um: Vec<f64> = fine.iter().map(|p| p.0).collect();
        let um = candidates(response, fine, &family.values(&fine_um));
        let totals = SIGNALS_K.map(|t| planck_signal(fine, t));
        let (column_unit, signal_unit) = (1.0 / (MARGIN * target), 1.0 / (SIGNAL_PART * target));
        let mut vectors = family.parts(&um);
        for (vector, &um) in vectors.iter_mut().zip(&um) {
            vector.iter_mut().for_each(|value| *value *= column_unit);
            let part = |(&t, all): (&f64, f64)| photon_radiance(um, t) / all * signal_unit;
            vector.extend(SIGNALS_K.iter().zip(totals).map(part));
        }
        let columns = family.wanted.iter().map(|wanted| wanted * column_unit);
        let outside: Vec<bool> = um.iter().map(|um| !(low..=high).contains(um)).collect();
        let leak: Vec<(f64, f64)> = fine.iter().copied().filter(|p| !(low..=high).contains(&p.0)).collect();
        let share = planck_signal(&leak, SOURCE_K) / planck_signal(fine, SOURCE_K);
        Self {
            vectors,
            wanted: columns.chain(SIGNALS_K.map(|_| signal_unit)).collect(),
            columns: family.len(),
            leak_needed: share > 0.1 * target && outside.contains(&true),
            um,
            outside,
        }
    }

    /// Adds samples until the target is met, or there are 48, or no more candidates: then the best there was.
    fn fewest(&self, target: f64) -> Candidate {
        let mut exchange = Exchange::new(&self.vectors, &self.wanted);
        // The first member may be held to the leak.
        let allowed =
            |place: usize, candidate: usize| place > 0 || !self.leak_needed || self.outside[candidate];
        let mut best: Option<(f64, Candidate)> = None;
        for _ in 0..ATTEMPTS_MAX {
            if exchange.members().len() >= SAMPLES_MAX.min(self.um.len()) || !exchange.grow(&allowed) {
                break;
            }
            let last = exchange.members().len() == SAMPLES_MAX.min(self.um.len());
            if let Some(found) = self.judged(&exchange, last, target)
                && best.as_ref().is_none_or(|(least, _)| found.0 < *least)
            {
                best = Some(found);
            }
            if best.as_ref().is_some_and(|(merit, _)| *merit <= 1.0) {
                break;
            }
        }
        // Grown one at a time there may be one too many.
        while best.as_ref().is_some_and(|(merit, _)| *merit <= 1.0) && exchange.shrink(&allowed) {
            match self.judged(&exchange, false, target) {
                Some(found) if found.0 <= 1.0 => best = Some(found),
                _ => break,
            }
        }
        // One wavelength can always be weighted by its signal.
        best.map_or_else(|| self.single(target), |(_, candidate)| candidate)
    }

    /// The selection with its weights and its largest error in units of what is allowed; `None` where no weights can
    /// do (unless it is the last chance), or the best are not positive.
    fn judged(&self, exchange: &Exchange, last: bool, target: f64) -> Option<(f64, Candidate)> {
        // No weights have a largest error below the smallest rms one.
        let hopeless = exchange.residual() > self.wanted.len() as f64;
        if hopeless && !last && exchange.members().len() > 1 {
            return None;
        }
        let (weights, merit) = self.weights(exchange.members(), if hopeless { 1 } else { ROUNDS })?;
        let um = exchange.members().iter().map(|&m| self.um[m]).collect();
        let errors = self.errors(exchange.members(), &weights);
        let columns = errors[..self.columns].iter().copied().fold(0.0, f64::max);
        Some((merit, Candidate { um, weights, emissivity_error: columns * MARGIN * target }))
    }

    /// The middle candidate with the weight of the signal at the middle temperature.
    fn single(&self, target: f64) -> Candidate {
        let middle = self.um.len() / 2;
        let place = self.columns + SIGNALS_K.len() / 2;
        let weight = self.wanted[place] / self.vectors[middle][place];
        let errors = self.errors(&[middle], &[weight]);
        let columns = errors[..self.columns].iter().copied().fold(0.0, f64::max);
        Candidate {
            um: vec![self.um[middle]],
            weights: vec![weight],
            emissivity_error: columns * MARGIN * target,
        }
    }

    /// Positive weights of these candidates with a small largest error (Lawson's algorithm: least squares in which a
    /// column weighs the more the worse it was), and that error.
    fn weights(&self, members: &[usize], rounds: usize) -> Option<(Vec<f64>, f64)> {
        let mut importance = vec![1.0_f64; self.wanted.len()];
        let mut best: Option<(Vec<f64>, f64)> = None;
        for _ in 0..rounds {
            let scale: Vec<f64> = importance.iter().map(|i| i.sqrt()).collect();
            let scaled =
                |vector: &Vec<f64>| vector.iter().zip(&scale).map(|(v, s)| v * s).collect::<Vec<f64>>();
            let columns = members.iter().map(|&m| scaled(&self.vectors[m])).collect();
            let Some(weights) = least_squares(columns, scaled(&self.wanted)) else { break };
            if !weights.iter().all(|&w| w > 0.0 && w.is_finite()) {
                break;
            }
            let errors = self.errors(members, &weights);
            let largest = errors.iter().copied().fold(0.0, f64::max);
            if best.as_ref().is_none_or(|(_, least)| largest < *least) {
                best = Some((weights, largest));
            }
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            if mean.is_nan() || mean <= 0.0 {
                break;
            }
            for (importance, error) in importance.iter_mut().zip(&errors) {
                *importance *= 0.1 + error / mean;
            }
            let normal = importance.len() as f64 / importance.iter().sum::<f64>();
            importance.iter_mut().for_each(|i| *i *= normal);
        }
        best
    }

    fn errors(&self, members: &[usize], weights: &[f64]) -> Vec<f64> {
        let mut errors = self.wanted.clone();
        for (&member, weight) in members.iter().zip(weights) {
            for (error, value) in errors.iter_mut().zip(&self.vectors[member]) {
                *error -= weight * value;
            }
        }
        errors.iter_mut().for_each(|error| *error = error.abs());
        errors
    }
}

/// Least squares by modified Gram–Schmidt with the right side as one more column; `None` when columns depend on each other.
fn least_squares(mut columns: Vec<Vec<f64>>, mut wanted: Vec<f64>) -> Option<Vec<f64>> {
    let count = columns.len();
    let mut triangle = vec![vec![0.0; count + 1]; count];
    for i in 0..count {
        let norm = dot(&columns[i], &columns[i]).sqrt();
        if !(norm > 0.0 && norm.is_finite()) {
            return None;
        }
        triangle[i][i] = norm;
        let (done, rest) = columns.split_at_mut(i + 1);
        let own = &mut done[i];
        own.iter_mut().for_each(|v| *v /= norm);
        for (j, other) in rest.iter_mut().enumerate() {
            triangle[i][i + 1 + j] = remove(own, other);
        }
        triangle[i][count] = remove(own, &mut wanted);
    }
    let mut solution = vec![0.0; count];
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|j| triangle[i][j] * solution[j]).sum();
        solution[i] = (triangle[i][count] - known) / triangle[i][i];
    }
    Some(solution)
}

/// Takes the part along `direction` (of length 1) out of a vector; its size.
fn remove(direction: &[f64], vector: &mut [f64]) -> f64 {
    let size = dot(direction, vector);
    for (v, d) in vector.iter_mut().zip(direction) {
        *v -= size * d;
    }
    size
}
