//! Mie efficiencies of droplets over diameter, temperature and wavelength, averaged over narrow bins of diameter.
//!
//! A parcel stands for droplets of nearly its diameter, never of exactly it: averaging over a bin removes the ripple
//! that would alias in weakly absorbing bands.

use super::super::field::Parcel;
use crate::light::fuel::Fuel;
use crate::light::mie::{Efficiencies, Sphere, efficiencies_of_many};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Width of a bin in ln d.
const BIN: f64 = 0.0125;
/// Diameters narrower than this in ln d are one size, computed exactly.
const ONE_SIZE: f64 = 1e-9;
/// Largest step between liquid temperatures, K: 10 K change n by 0.005, the phase 2x(n−1) at 100 µm by half a radian.
const STEP_K: f64 = 10.0;
/// Most liquid temperatures.
const TEMPERATURES_MAX: usize = 24;
/// Radii per bin: from, to.
const RADII: [usize; 2] = [2, 32];
/// Relative change at which the radii are enough, judged on the sum over the spray.
const TARGET: f64 = 1e-4;
/// Diameters that are taken for droplets, m.
const DIAMETERS_M: [f64; 2] = [1e-9, 1e-2];

/// Whether a parcel takes part: it has droplets of a possible size and temperature.
pub(super) fn counts(parcel: &Parcel) -> bool {
    parcel.droplets > 0.0
        && parcel.droplets.is_finite()
        && (DIAMETERS_M[0]..=DIAMETERS_M[1]).contains(&parcel.diameter_m)
        && parcel.temperature_k > 0.0
        && parcel.temperature_k.is_finite()
}

/// (Q_sca, Q_abs) per bin.
type Efficiency = Vec<(f64, f64)>;

/// Bin averages of Q_sca and Q_abs.
pub(super) struct DropletTable {
    /// ln d of the first bin's centre.
    first: f64,
    bins: usize,
    temperatures_k: Vec<f64>,
    /// (Q_sca, Q_abs), `[group][temperature][bin]`.
    values: Vec<Vec<(f64, f64)>>,
    spheres: usize,
    error: f64,
}

impl DropletTable {
    pub(super) fn new(parcels: &[Parcel], fuel: &Fuel, um: &[f64]) -> Self {
        let known = || parcels.iter().filter(|parcel| counts(parcel));
        let range = |of: fn(&Parcel) -> f64| {
            known()
                .map(of)
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
        };
        let [small, large] = range(|parcel| parcel.diameter_m.ln());
        let [cold, hot] = range(|parcel| parcel.temperature_k);
        if small > large {
            return Self {
                first: 0.0,
                bins: 0,
                temperatures_k: Vec::new(),
                values: Vec::new(),
                spheres: 0,
                error: 0.0,
            };
        }
        let one_size = large - small < ONE_SIZE;
        // Centres from `small` on; the last one is at or beyond `large`.
        let bins = if one_size { 1 } else { 2 + whole((large - small) / BIN) };
        let temperatures_k = nodes(cold, hot);
        let mut area = vec![0.0; bins];
        for parcel in known() {
            let bin = whole((parcel.diameter_m.ln() - small) / BIN + 0.5).min(bins - 1);
            area[bin] += parcel.area_m2();
        }
        let made: Vec<(Efficiency, usize, f64)> = (0..um.len() * temperatures_k.len())
            .into_par_iter()
            .map(|task| {
                let um = um[task / temperatures_k.len()];
                let (n, k) = fuel.liquid_index(um, temperatures_k[task % temperatures_k.len()]);
                let column = Column { first: small, bins, um, n, k };
                if one_size { (column.averages(1, 0.0), 1, 0.0) } else { column.converged(&area) }
            })
            .collect();
        let spheres = made.iter().map(|column| column.1).sum();
        let error = made.iter().map(|column| column.2).fold(0.0, f64::max);
        let mut values = Vec::with_capacity(um.len());
        let mut columns = made.into_iter();
        for _ in um {
            let group: Vec<(f64, f64)> =
                columns.by_ref().take(temperatures_k.len()).flat_map(|column| column.0).collect();
            values.push(group);
        }
        Self { first: small, bins, temperatures_k, values, spheres, error }
    }

    /// (Q_sca, Q_abs) of a droplet of a parcel that [`counts`].
    pub(super) fn efficiencies(&self, group: usize, parcel: &Parcel) -> (f64, f64) {
        let values = &self.values[group];
        let at = ((parcel.diameter_m.ln() - self.first) / BIN).max(0.0);
        let lower = whole(at).min(self.bins.saturating_sub(2));
        let share = (at - lower as f64).clamp(0.0, 1.0);
        let next = (lower + 1).min(self.bins - 1);
        let over_bins = |temperature: usize| {
            let row = &values[temperature * self.bins..(temperature + 1) * self.bins];
            mix(row[lower], row[next], share)
        };
        if self.temperatures_k.len() == 1 {
            return over_bins(0);
        }
        let (cold, warmth) = crate::light::table::locate(&self.temperatures_k, parcel.temperature_k);
        mix(over_bins(cold), over_bins(cold + 1), warmth)
    }

    pub(super) fn bins(&self) -> usize {
        self.bins
    }

    pub(super) fn temperatures(&self) -> usize {
        self.temperatures_k.len()
    }

    pub(super) fn spheres(&self) -> usize {
        self.spheres
    }

    pub(super) fn error(&self) -> f64 {
        self.error
    }
}

/// Temperatures from `cold` to `hot` in equal steps.
fn nodes(cold: f64, hot: f64) -> Vec<f64> {
    if hot - cold < 1e-6 {
        return vec![0.5 * (cold + hot)];
    }
    let steps = (1 + whole((hot - cold) / STEP_K)).min(TEMPERATURES_MAX - 1);
    (0..=steps).map(|i| cold + (hot - cold) * i as f64 / steps as f64).collect()
}

fn mix(a: (f64, f64), b: (f64, f64), share: f64) -> (f64, f64) {
    (a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1))
}

/// One wavelength and one index over all bins.
struct Column {
    first: f64,
    bins: usize,
    um: f64,
    n: f64,
    k: f64,
}

impl Column {
    /// Averages with as many radii per bin as the spray needs: values, Mie calculations, last relative change.
    fn converged(&self, area: &[f64]) -> (Efficiency, usize, f64) {
        let total = |values: &[(f64, f64)]| {
            values
                .iter()
                .zip(area)
                .fold((0.0, 0.0), |sum, (q, area)| (sum.0 + area * q.0, sum.1 + area * q.1))
        };
        let mut radii = RADII[0];
        let mut values = self.averages(radii, BIN);
        let mut spheres = radii * self.bins;
        let mut change_before = 0.0f64;
        loop {
            radii *= 2;
            // Midpoints of twice as many parts are all new: the mean of both rules uses all of them.
            let finer = self.averages(radii, BIN);
            spheres += radii * self.bins;
            let (old, new) = (total(&values), total(&finer));
            let change = relative(old.0, new.0).max(relative(old.1, new.1));
            for (value, finer) in values.iter_mut().zip(&finer) {
                *value = mix(*value, *finer, 2.0 / 3.0);
            }
            // Narrow lines alias at random: one small change may be luck (see `mie::lognormal`).
            let error = change.max(0.5 * change_before);
            if error <= TARGET || radii >= RADII[1] {
                return (values, spheres, error);
            }
            change_before = change;
            values = finer;
        }
    }

    /// Averages over `radii` midpoints of bins of `width`.
    fn averages(&self, radii: usize, width: f64) -> Vec<(f64, f64)> {
        let spheres: Vec<Sphere> = (0..self.bins * radii)
            .map(|i| {
                let inside = ((i % radii) as f64 + 0.5) / radii as f64 - 0.5;
                let ln_d = self.first + BIN * (i / radii) as f64 + width * inside;
                Sphere { size_parameter: PI * ln_d.exp() / (self.um * 1e-6), n: self.n, k: self.k }
            })
            .collect();
        // Indices of the fuel tables and bounded diameters have an answer; an index the user supplied that has none
        // is treated as no droplet at all.
        let answers =
            efficiencies_of_many(&spheres).unwrap_or_else(|_| vec![Efficiencies::default(); spheres.len()]);
        answers
            .chunks(radii)
            .map(|bin| {
                let sum = bin.iter().fold((0.0, 0.0), |sum, q| (sum.0 + q.q_sca, sum.1 + q.q_abs));
                (sum.0 / radii as f64, sum.1 / radii as f64)
            })
            .collect()
    }
}

fn relative(old: f64, new: f64) -> f64 {
    if new > 0.0 { (new - old).abs() / new } else { 0.0 }
}

/// A count that is known to be small and not negative.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "bounded by the range of diameters"
)]
pub(super) fn whole(count: f64) -> usize {
    count.clamp(0.0, 1e6) as usize
}
