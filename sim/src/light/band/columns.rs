//! Columns of fuel in front of a black body: what the sampling of a band is judged by.
//!
//! A column is a mixture of vapour, liquid and droplets with one mean optical depth; it is seen as its emissivity
//! 1 − exp(−τ), or as the part of the light that its droplets scatter once, over the band and weighted with a black body.

use super::droplets::Indices;
#[cfg(test)]
use super::droplets::mie;
use super::{SOURCE_K, planck_signal};
use crate::light::fuel::Fuel;
use crate::light::planck::photon_radiance;

/// Which absorbers are in a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Absorbers {
    /// Liquid: films or droplets.
    pub liquid: bool,
    /// Vapour.
    pub vapour: bool,
}

impl Absorbers {
    /// Nothing whose absorption depends on the wavelength: the scene is gray.
    pub const NONE: Self = Self { liquid: false, vapour: false };
    /// Liquid and vapour.
    pub const BOTH: Self = Self { liquid: true, vapour: true };
}

/// Something that absorbs or scatters with a spectrum of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spectrum {
    /// Vapour at a temperature in K.
    Vapour(f64),
    /// Liquid at a temperature in K, without scattering.
    Liquid(f64),
    /// Droplets of a diameter in µm at a temperature in K, by anomalous diffraction: their absorption.
    DropletAbsorption(f64, f64),
    /// The same without the light that a sphere gathers: that part is known least, so columns are made with and without.
    StraightAbsorption(f64, f64),
    /// Their extinction.
    DropletExtinction(f64, f64),
    /// Droplets of a median diameter in µm at a temperature in K, lognormal with a width of 0.25, by Mie's theory.
    #[cfg(test)]
    MieAbsorption(f64, f64),
    /// The extinction of the same droplets; stands behind their absorption.
    #[cfg(test)]
    MieExtinction,
}

/// A column: spectra (by index) with their shares of the mean optical depth.
#[derive(Debug, Clone)]
pub(super) struct Column {
    pub(super) parts: Vec<(usize, f64)>,
    /// Mean optical depth, weighted with the response and a black body of 450 K.
    pub(super) depth: f64,
    /// Indices of absorption and extinction spectrum when the scattered part is meant and not the emissivity.
    pub(super) scattered: Option<(usize, usize)>,
}

/// Columns, and the values that a band should have for them.
pub(super) struct Family<'a> {
    fuel: &'a Fuel,
    spectra: Vec<Spectrum>,
    columns: Vec<Column>,
    /// 1/mean of each spectrum.
    scale: Vec<f64>,
    /// Values on the fine grid, `[column][source]` flattened: what is right.
    pub(super) wanted: Vec<f64>,
    /// Black bodies that weight the wavelengths: temperature in K and signal of the fine grid.
    sources: Vec<(f64, f64)>,
}

/// Mean optical depths of the columns, thin to opaque.
const DEPTHS: [f64; 8] = [0.05, 0.25, 0.8, 2.0, 4.5, 9.0, 17.0, 32.0];
/// Mixtures of three at depths of their own.
const MIXTURES: usize = 60;
/// Diameters of the droplets, µm.
const DIAMETERS_UM: [f64; 6] = [3.5, 5.5, 9.0, 14.0, 21.0, 30.0];
/// Temperatures of the black bodies that weight them, K.
const SOURCES_K: [f64; 2] = [350.0, 550.0];

impl<'a> Family<'a> {
    /// The columns that a choice of samples is trained on: pure vapour (300, 450, 650 K), liquid (280, 350, 450 K),
    /// droplets of 3.5 to 30 µm, and mixtures.
    pub(super) fn training(fine: &[(f64, f64)], fuel: &'a Fuel, absorbers: Absorbers) -> Self {
        let mut spectra = Vec::new();
        let mut mixtures: Vec<Vec<(usize, f64)>> = Vec::new();
        let mut scattered = Vec::new();
        if absorbers.vapour {
            spectra.extend([300.0, 450.0, 650.0].map(Spectrum::Vapour));
        }
        if absorbers.liquid {
            spectra.extend([280.0, 350.0, 450.0].map(Spectrum::Liquid));
            for diameter_um in DIAMETERS_UM {
                spectra.push(Spectrum::DropletAbsorption(diameter_um, 350.0));
                spectra.push(Spectrum::DropletExtinction(diameter_um, 350.0));
            }
            spectra.extend([7.0, 20.0].map(|diameter_um| Spectrum::StraightAbsorption(diameter_um, 350.0)));
        }
        for index in 0..spectra.len() {
            mixtures.push(vec![(index, 1.0)]);
        }
        let find = |wanted: Spectrum| spectra.iter().position(|s| *s == wanted);
        for diameter_um in [5.5, 14.0, 30.0] {
            let absorption = find(Spectrum::DropletAbsorption(diameter_um, 350.0));
            scattered.extend(absorption.zip(find(Spectrum::DropletExtinction(diameter_um, 350.0))));
        }
        let mix = |a: Spectrum, b: Spectrum, share: f64| {
            find(a).zip(find(b)).map(|(a, b)| vec![(a, share), (b, 1.0 - share)])
        };
        for share in [0.25, 0.5, 0.75] {
            mixtures.extend(mix(Spectrum::Vapour(450.0), Spectrum::Liquid(350.0), share));
        }
        let film = Spectrum::Liquid(280.0);
        mixtures.extend(mix(film, Spectrum::DropletAbsorption(21.0, 350.0), 0.5));
        mixtures.extend(mix(film, Spectrum::DropletExtinction(9.0, 350.0), 0.5));
        for (kelvin, diameter_um) in [(300.0, 9.0), (450.0, 14.0), (650.0, 3.5)] {
            let vapour = Spectrum::Vapour(kelvin);
            mixtures.extend(mix(vapour, Spectrum::DropletExtinction(diameter_um, 350.0), 0.5));
            mixtures.extend(mix(vapour, Spectrum::DropletAbsorption(diameter_um, 350.0), 0.3));
        }
        let mut columns = Vec::new();
        for depth in DEPTHS {
            let column =
                |parts: &[(usize, f64)], scattered| Column { parts: parts.to_vec(), depth, scattered };
            columns.extend(mixtures.iter().map(|parts| column(parts, None)));
            columns.extend(scattered.iter().map(|&pair| column(&[(pair.1, 1.0)], Some(pair))));
        }
        for i in 0..if spectra.is_empty() { 0 } else { MIXTURES } {
            // Multiples of irrational numbers: evenly spread, and the same always.
            let spread = |ratio: f64| (ratio * (i as f64 + 0.5)).fract();
            let parts = [0.754_877_7, 0.569_840_3, 0.819_172_5].map(|ratio| {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "0 to the number of spectra"
                )]
                let index = (spread(ratio) * spectra.len() as f64) as usize;
                (index.min(spectra.len() - 1), 0.1 + spread(1.9 * ratio))
            });
            let sum: f64 = parts.iter().map(|part| part.1).sum();
            let parts = parts.iter().map(|&(index, share)| (index, share / sum)).collect();
            columns.push(Column { parts, depth: 0.3 * 100f64.powf(spread(0.618_034)), scattered: None });
        }
        Self::new(fine, fuel, spectra, columns, &SOURCES_K)
    }

    /// Columns with their values on the fine grid of a response. Columns of which a part absorbs nothing in the band
    /// are left out.
    pub(super) fn new(
        fine: &[(f64, f64)],
        fuel: &'a Fuel,
        spectra: Vec<Spectrum>,
        columns: Vec<Column>,
        sources_k: &[f64],
    ) -> Self {
        let um: Vec<f64> = fine.iter().map(|point| point.0).collect();
        let unscaled = Values::of(&um, fuel, &spectra, &vec![1.0; spectra.len()]);
        let source: Vec<f64> =
            fine.iter().map(|&(um, weight)| weight * photon_radiance(um, SOURCE_K)).collect();
        let all: f64 = source.iter().sum();
        let scale: Vec<f64> = unscaled
            .spectra
            .iter()
            .map(|s| all / s.iter().zip(&source).map(|(value, source)| value * source).sum::<f64>())
            .collect();
        let there = |column: &Column| {
            let scattered = column.scattered.map_or(0, |pair| pair.0);
            column.parts.iter().all(|part| scale[part.0].is_finite())
                && (column.scattered.is_none() || scale[scattered].is_finite())
        };
        let columns: Vec<Column> = columns.into_iter().filter(there).collect();
        let sources = sources_k.iter().map(|&t| (t, planck_signal(fine, t))).collect();
        let mut family = Self { fuel, spectra, columns, scale, wanted: Vec::new(), sources };
        let weights: Vec<f64> = fine.iter().map(|point| point.1).collect();
        family.wanted = family.seen(&um, &weights);
        family
    }

    /// Number of values: columns times black bodies.
    pub(super) fn len(&self) -> usize {
        self.columns.len() * self.sources.len()
    }

    /// The spectra at some wavelengths.
    pub(super) fn values(&self, um: &[f64]) -> Values {
        Values::of(um, self.fuel, &self.spectra, &self.scale)
    }

    /// What each wavelength adds to each value for weight 1, `[wavelength][value]`.
    pub(super) fn parts(&self, um: &[f64]) -> Vec<Vec<f64>> {
        let (values, light) = (self.values(um), self.light(um));
        let mut parts = vec![Vec::with_capacity(self.len()); um.len()];
        for column in &self.columns {
            let shares = values.share(column);
            for light in &light {
                for (place, part) in parts.iter_mut().enumerate() {
                    part.push(shares[place] * light[place]);
                }
            }
        }
        parts
    }

    /// The values of samples.
    fn seen(&self, um: &[f64], weights: &[f64]) -> Vec<f64> {
        let values = self.values(um);
        let weigh = |light: Vec<f64>| light.iter().zip(weights).map(|(l, w)| l * w).collect::<Vec<f64>>();
        let light: Vec<Vec<f64>> = self.light(um).into_iter().map(weigh).collect();
        self.columns
            .iter()
            .flat_map(|column| {
                let shares = values.share(column);
                light.iter().map(move |light| dot(&shares, light)).collect::<Vec<f64>>()
            })
            .collect()
    }

    /// Radiances of the black bodies over their signals, `[source][wavelength]`.
    fn light(&self, um: &[f64]) -> Vec<Vec<f64>> {
        let of = |&(t, total): &(f64, f64)| um.iter().map(|&um| photon_radiance(um, t) / total).collect();
        self.sources.iter().map(of).collect()
    }

    /// The column of the largest error, for messages.
    #[cfg(test)]
    pub(super) fn worst(&self, um: &[f64], weights: &[f64]) -> String {
        let found = self.seen(um, weights);
        let error = |i: usize| (found[i] - self.wanted[i]).abs();
        let worst = (0..found.len()).max_by(|&a, &b| error(a).total_cmp(&error(b))).unwrap_or(0);
        let column = &self.columns[worst / self.sources.len()];
        let parts: Vec<(Spectrum, f64)> = column.parts.iter().map(|p| (self.spectra[p.0], p.1)).collect();
        format!("{parts:?}, depth {}, scattered {:?}", column.depth, column.scattered)
    }

    /// Largest absolute error of samples (wavelengths in µm, weights) over the columns.
    pub(super) fn largest_error(&self, um: &[f64], weights: &[f64]) -> f64 {
        let found = self.seen(um, weights);
        found.iter().zip(&self.wanted).map(|(found, wanted)| (found - wanted).abs()).fold(0.0, f64::max)
    }
}

/// Spectra of a family at some wavelengths.
pub(super) struct Values {
    /// `[spectrum][wavelength]`, mean 1 over the band.
    spectra: Vec<Vec<f64>>,
    /// As they are, before that.
    scale: Vec<f64>,
}

impl Values {
    fn of(um: &[f64], fuel: &Fuel, spectra: &[Spectrum], scale: &[f64]) -> Self {
        let mut indices = Indices::new(um, fuel);
        #[cfg(test)]
        let mut droplets_by_mie = Vec::new();
        let spectra: Vec<Vec<f64>> = spectra
            .iter()
            .zip(scale)
            .map(|(spectrum, scale)| {
                let mut values: Vec<f64> = match *spectrum {
                    Spectrum::Vapour(t) => {
                        um.iter().map(|&um| fuel.vapour_cross_section_m2_mol(um, t)).collect()
                    }
                    Spectrum::Liquid(t) => indices.of(t).zip(um).map(|((_, k), um)| k / um).collect(),
                    Spectrum::DropletAbsorption(d, t) => indices.droplets(d, t).map(|q| q[0]).collect(),
                    Spectrum::DropletExtinction(d, t) => indices.droplets(d, t).map(|q| q[1]).collect(),
                    Spectrum::StraightAbsorption(d, t) => indices.droplets(d, t).map(|q| q[2]).collect(),
                    #[cfg(test)]
                    Spectrum::MieAbsorption(d, t) => {
                        droplets_by_mie = mie(um, fuel, d, t);
                        droplets_by_mie.iter().map(|q| q[0]).collect()
                    }
                    #[cfg(test)]
                    // Of the same droplets as the absorption before it.
                    Spectrum::MieExtinction => droplets_by_mie.iter().map(|q| q[1]).collect(),
                };
                for value in &mut values {
                    *value *= scale;
                }
                values
            })
            .collect();
        Self { spectra, scale: scale.to_vec() }
    }

    /// Part of the light that a column takes (or scatters) at each wavelength.
    fn share(&self, column: &Column) -> Vec<f64> {
        let Column { parts, depth, scattered } = column;
        let mut shares = vec![0.0; self.spectra.first().map_or(0, Vec::len)];
        for &(spectrum, share) in parts {
            for (at, value) in shares.iter_mut().zip(&self.spectra[spectrum]) {
                *at += share * depth * value;
            }
        }
        // Absolute errors count: no need of expm1.
        for share in &mut shares {
            *share = 1.0 - (-*share).exp();
        }
        if let Some((absorption, extinction)) = *scattered {
            for (place, share) in shares.iter_mut().enumerate() {
                let absorbed = self.spectra[absorption][place] / self.scale[absorption];
                let met = self.spectra[extinction][place] / self.scale[extinction];
                *share *= if met > 0.0 { 1.0 - absorbed / met } else { 0.0 };
            }
        }
        shares
    }

    /// How much the spectra change from each wavelength to the next, summed; 0 at the last.
    pub(super) fn structure(&self) -> Vec<f64> {
        let mut changes = vec![0.0; self.spectra.first().map_or(0, Vec::len)];
        for spectrum in &self.spectra {
            for (change, pair) in changes.iter_mut().zip(spectrum.windows(2)) {
                // As emissivities of a column of mean depth 1.
                let difference = ((-pair[0]).exp() - (-pair[1]).exp()).abs();
                *change += if difference.is_finite() { difference } else { 0.0 };
            }
        }
        changes
    }
}

/// Scalar product in eight partial sums, which the compiler turns into vectors.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a, b) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for lane in 0..8 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum::<f64>() + rest
}
