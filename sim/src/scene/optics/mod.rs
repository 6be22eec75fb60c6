//! From a spray on a grid to the coefficients that the tracer understands.
//!
//! Droplets become Mie cross-sections at their own temperature, vapour becomes absorption at the temperature of the
//! gas: two temperatures per cell. Sums are extensive: every droplet of every parcel counts once. Knows neither
//! cameras nor rays.

mod droplets;
mod pattern;
mod skip;
mod vapour;

use super::field::{Gas, Parcel, SprayField};
use crate::light::band::Band;
use crate::light::fuel::Fuel;
use crate::light::phase::PhaseFunction;
use crate::light::planck::photon_radiance;
use crate::tracer::medium::{EMPTY, GridMedium};
use droplets::DropletTable;
use rayon::prelude::*;
use skip::Choice;
pub use skip::{Skip, Work};
use vapour::VapourTable;

/// Share of the error wanted of the coefficients that the cumulative distribution of a phase function may use.
const PHASE_SHARE: f64 = 0.1;

/// What emits in a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Species {
    /// Liquid and vapour.
    All,
    /// The liquid only.
    Droplets,
    /// The vapour only.
    Vapour,
}

/// How strongly it emits, per k_abs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Strength {
    /// 1 everywhere: the image is the coefficient a_medium.
    Unit,
    /// B(λ, T + offset) in photons s⁻¹ m⁻² sr⁻¹ µm⁻¹ with T of the liquid for droplets, of the gas for vapour.
    Radiance {
        /// Added to the temperatures of the field, K.
        offset_k: f64,
    },
}

/// The sources of one emission channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Source {
    /// Who emits.
    pub species: Species,
    /// How strongly.
    pub strength: Strength,
}

impl Source {
    /// What channel 0 must be: everything, with strength 1.
    pub const UNIT: Self = Self { species: Species::All, strength: Strength::Unit };
    /// Everything at its own temperature.
    pub const RADIANCE: Self = Self { species: Species::All, strength: Strength::Radiance { offset_k: 0.0 } };

    fn of_droplets(self, wavelength_um: f64, temperature_k: f64) -> f64 {
        if self.species == Species::Vapour { 0.0 } else { self.strength.at(wavelength_um, temperature_k) }
    }

    fn of_vapour(self, wavelength_um: f64, temperature_k: f64) -> f64 {
        if self.species == Species::Droplets { 0.0 } else { self.strength.at(wavelength_um, temperature_k) }
    }
}

impl Strength {
    fn at(self, wavelength_um: f64, temperature_k: f64) -> f64 {
        match self {
            Self::Unit => 1.0,
            Self::Radiance { offset_k } => photon_radiance(wavelength_um, temperature_k + offset_k),
        }
    }
}

/// What the coefficients are wanted for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpticsOptions {
    /// Absolute error wanted of each coefficient of a sight: work that cannot change one by half of it is left undone.
    pub target_error: f64,
}

impl Default for OpticsOptions {
    /// The default target of images, 1e-3.
    fn default() -> Self {
        Self { target_error: 1e-3 }
    }
}

/// How the coefficients were made, and how good they are.
#[derive(Debug, Clone, PartialEq)]
pub struct OpticsReport {
    /// Bins of the droplet diameter, and Mie calculations in all.
    pub bins: usize,
    /// Mie calculations behind the table.
    pub spheres: usize,
    /// Mie calculations in all: those of the table and those of the phase functions.
    pub mie_spheres: usize,
    /// Temperatures at which the vapour's cross-section was computed, per wavelength.
    pub vapour_nodes: usize,
    /// Phase functions that were tabulated.
    pub phase_tables: usize,
    /// What was not done, why, and the error that this admits.
    pub skipped: Vec<Skip>,
    /// Liquid temperatures of the table.
    pub temperatures: usize,
    /// Largest relative change of a group's scattering or absorption, summed over the spray, when the number of
    /// radii per bin was last doubled.
    pub mie_error: f64,
    /// Mean cosine of each group: scattering-weighted mean of the exact ones; 0 where no phase function was tabulated.
    pub asymmetry: Vec<f64>,
    /// Mean cosine of the phase function of each group as it is sampled.
    pub asymmetry_tabulated: Vec<f64>,
    /// Most nodes of a phase function.
    pub phase_nodes: usize,
    /// Largest error of the cumulative distribution of a phase function.
    pub phase_error: f64,
    /// Wavelengths outside the fuel's liquid table (its ends were used), µm.
    pub outside_liquid_um: Vec<f64>,
    /// Cells whose gas is outside the temperatures of the vapour table (its ends were used).
    pub cells_outside_vapour_k: usize,
    /// Parcels without droplets or with an impossible diameter or temperature, left out.
    pub parcels_skipped: usize,
}

/// A medium with what is known about its making.
#[derive(Debug, Clone)]
pub struct Optics {
    /// The coefficients.
    pub medium: GridMedium,
    /// How it was made.
    pub report: OpticsReport,
}

/// Coefficients of a spray for the wavelengths of a band, one group per sample, and one channel per source.
///
/// Channel 0 must be [`Source::UNIT`]. See [`optics`] for the same with a report.
pub fn medium(
    field: &SprayField,
    fuel: &Fuel,
    band: &Band,
    sources: &[Source],
    options: &OpticsOptions,
) -> GridMedium {
    optics(field, fuel, band, sources, options).medium
}

/// [`medium`] with a report. Runs on rayon's threads; the answer does not depend
/// on their number.
///
/// Emission of radiance channels is per µm at each group's wavelength: the band's weights come later. What cannot
/// change a coefficient by half of the error wanted is not computed; the report says what and why.
pub fn optics(
    field: &SprayField,
    fuel: &Fuel,
    band: &Band,
    sources: &[Source],
    options: &OpticsOptions,
) -> Optics {
    assert!(sources.first() == Some(&Source::UNIT), "channel 0 has source 1 for everything");
    assert!(!band.is_empty(), "a medium has at least one group");
    assert!(field.deposit_start.len() == field.cells.len() + 1, "one range of deposits per cell, and an end");
    assert!(field.gas.len() == field.cells.len(), "one gas per occupied cell");
    let um = &band.wavelengths_um;
    let (groups, channels) = (um.len(), sources.len());
    let mut skipped = Vec::new();
    // Parcels that no cell holds a droplet of need no cross-sections.
    let parcels: &[Parcel] = if field.deposit_parcel.is_empty() { &[] } else { &field.parcels };
    if !parcels.iter().any(droplets::counts) {
        let reason = "no cell holds droplets";
        skipped.push(Skip { work: Work::Mie, reason, groups, admitted_error: 0.0 });
    }
    let table = DropletTable::new(parcels, fuel, um);
    let rows = ParcelRows::new(parcels, &table, um, sources);
    let vapour = field.gas.iter().any(|gas| gas.vapour_mol_m3 > 0.0).then(|| VapourTable::new(fuel, um));
    if vapour.is_none() {
        let reason = "no cell holds vapour";
        skipped.push(Skip { work: Work::Vapour, reason, groups, admitted_error: 0.0 });
    }

    let cells = field.cells.len();
    let mut k_ext = vec![0.0; cells * groups];
    let mut k_sca = vec![0.0; cells * groups];
    let mut emission = vec![0.0; cells * channels * groups];
    k_ext
        .par_chunks_mut(groups)
        .zip(k_sca.par_chunks_mut(groups))
        .zip(emission.par_chunks_mut(channels * groups))
        .enumerate()
        .for_each(|(cell, ((ext, sca), emission))| {
            let range = field.deposit_start[cell] as usize..field.deposit_start[cell + 1] as usize;
            for deposit in range {
                let row = rows.row(field.deposit_parcel[deposit] as usize);
                let density = f64::from(field.deposit_per_m3[deposit]);
                let (own_sca, rest) = row.split_at(groups);
                let (own_abs, own_emission) = rest.split_at(groups);
                for (((ext, sca), own_sca), own_abs) in
                    ext.iter_mut().zip(sca.iter_mut()).zip(own_sca).zip(own_abs)
                {
                    *sca += density * own_sca;
                    *ext += density * (own_sca + own_abs);
                }
                for (sum, own) in emission.iter_mut().zip(own_emission) {
                    *sum += density * own;
                }
            }
            if let Some(vapour) = &vapour {
                vapour.add(&field.gas[cell], um, sources, ext, emission);
            }
        });

    let mut index = vec![EMPTY; field.grid.cells.iter().product()];
    for (ordinal, &cell) in (0u32..).zip(&field.cells) {
        index[cell as usize] = ordinal;
    }
    let choices = choices(parcels, fuel, um, [&k_ext, &k_sca], options.target_error);
    skipped.extend(skip::sum(&choices));
    let made: Vec<pattern::Mean> = um
        .par_iter()
        .zip(&choices)
        .map(|(&um, choice)| match choice {
            Choice::Table => pattern::mean_phase(parcels, fuel, um, PHASE_SHARE * options.target_error),
            Choice::Isotropic(..) => pattern::Mean::given(PhaseFunction::Isotropic),
            Choice::Rayleigh(..) => pattern::Mean::given(PhaseFunction::Rayleigh),
        })
        .collect();
    let [low, high] = fuel.liquid_range_um();
    let [cold, hot] = fuel.vapour_range_k();
    let outside = |gas: &&Gas| gas.vapour_mol_m3 > 0.0 && !(cold..=hot).contains(&gas.temperature_k);
    let report = OpticsReport {
        bins: table.bins(),
        spheres: table.spheres(),
        mie_spheres: table.spheres() + made.iter().map(|mean| mean.spheres).sum::<usize>(),
        vapour_nodes: vapour.as_ref().map_or(0, VapourTable::nodes),
        phase_tables: choices.iter().filter(|choice| **choice == Choice::Table).count(),
        skipped,
        temperatures: table.temperatures(),
        mie_error: table.error(),
        asymmetry: made.iter().map(|mean| mean.asymmetry).collect(),
        asymmetry_tabulated: made.iter().map(|mean| mean.asymmetry_tabulated).collect(),
        phase_nodes: made.iter().map(|mean| mean.nodes).max().unwrap_or(0),
        phase_error: made.iter().map(|mean| mean.error).fold(0.0, f64::max),
        outside_liquid_um: um.iter().copied().filter(|um| !(low..=high).contains(um)).collect(),
        cells_outside_vapour_k: field.gas.iter().filter(outside).count(),
        parcels_skipped: field.parcels.iter().filter(|parcel| !droplets::counts(parcel)).count(),
    };
    let medium = GridMedium {
        lower_m: field.grid.lower_m,
        upper_m: field.grid.upper_m,
        cells: field.grid.cells,
        groups,
        channels,
        index,
        k_ext,
        k_sca,
        emission,
        phase: made.into_iter().map(|mean| mean.phase).collect(),
    };
    Optics { medium, report }
}

/// How the phase function of each group is to be made.
fn choices(
    parcels: &[Parcel],
    fuel: &Fuel,
    um: &[f64],
    [k_ext, k_sca]: [&[f64]; 2],
    target: f64,
) -> Vec<Choice> {
    let groups = um.len();
    let largest = parcels
        .iter()
        .filter(|parcel| droplets::counts(parcel))
        .max_by(|a, b| a.diameter_m.total_cmp(&b.diameter_m));
    let choice = |(group, &um): (usize, &f64)| {
        let albedo = k_sca
            .iter()
            .zip(k_ext)
            .skip(group)
            .step_by(groups)
            .filter(|k| *k.0 > 0.0)
            .fold(0.0_f64, |most, (sca, ext)| most.max(sca / ext));
        let size = largest.map_or(0.0, |parcel| {
            let (n, k) = fuel.liquid_index(um, parcel.temperature_k);
            std::f64::consts::PI * parcel.diameter_m / (um * 1e-6) * n.hypot(k).max(1.0)
        });
        Choice::new(albedo.min(1.0), size, target)
    };
    um.iter().enumerate().map(choice).collect()
}

/// Per parcel what one droplet contributes: `[sca | abs | emission of channel 0 | …]`, each over the groups, in m².
struct ParcelRows {
    width: usize,
    rows: Vec<f64>,
}

impl ParcelRows {
    fn new(parcels: &[Parcel], table: &DropletTable, um: &[f64], sources: &[Source]) -> Self {
        let groups = um.len();
        let width = groups * (2 + sources.len());
        let mut rows = vec![0.0; width * parcels.len()];
        rows.par_chunks_mut(width).zip(parcels).for_each(|(row, parcel)| {
            if !droplets::counts(parcel) {
                return;
            }
            let area = std::f64::consts::FRAC_PI_4 * parcel.diameter_m * parcel.diameter_m;
            for (group, &um) in um.iter().enumerate() {
                let (q_sca, q_abs) = table.efficiencies(group, parcel);
                row[group] = area * q_sca;
                row[groups + group] = area * q_abs;
                for (channel, source) in sources.iter().enumerate() {
                    row[(2 + channel) * groups + group] =
                        area * q_abs * source.of_droplets(um, parcel.temperature_k);
                }
            }
        });
        Self { width, rows }
    }

    fn row(&self, parcel: usize) -> &[f64] {
        &self.rows[parcel * self.width..(parcel + 1) * self.width]
    }
}

#[cfg(test)]
mod skip_tests;
#[cfg(test)]
mod tests;
