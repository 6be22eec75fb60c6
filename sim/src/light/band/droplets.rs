//! Droplets as the choice of samples sees them: fast, smooth over the wavelength, right to some ten percent.

use crate::light::fuel::Fuel;
use std::f64::consts::PI;

/// Indices of a liquid at some wavelengths, computed once for each temperature.
pub(super) struct Indices<'a> {
    um: &'a [f64],
    fuel: &'a Fuel,
    known: Vec<(f64, Vec<(f64, f64)>)>,
}

impl<'a> Indices<'a> {
    pub(super) fn new(um: &'a [f64], fuel: &'a Fuel) -> Self {
        Self { um, fuel, known: Vec::new() }
    }

    /// Index (n, k) at each wavelength.
    pub(super) fn of(&mut self, kelvin: f64) -> impl Iterator<Item = (f64, f64)> + '_ {
        let found = self.known.iter().position(|(t, _)| t.to_bits() == kelvin.to_bits());
        let place = found.unwrap_or_else(|| {
            let index = self.um.iter().map(|&um| self.fuel.liquid_index(um, kelvin)).collect();
            self.known.push((kelvin, index));
            self.known.len() - 1
        });
        self.known[place].1.iter().copied()
    }

    /// [`anomalous_diffraction`] of droplets.
    pub(super) fn droplets(&mut self, diameter_um: f64, kelvin: f64) -> impl Iterator<Item = [f64; 3]> + '_ {
        let um = self.um;
        self.of(kelvin).zip(um).map(move |((n, k), um)| anomalous_diffraction(PI * diameter_um / um, n, k))
    }
}

/// Efficiencies of absorption, extinction, and absorption along straight lines by van de Hulst's anomalous diffraction (1957, sections 11.22 and 11.23).
///
/// Within 10 to 30 % of Mie's for fuels, and without the ripple of a single size, which a spray of many does not show:
/// here only the course over the wavelength matters.
fn anomalous_diffraction(size_parameter: f64, n: f64, k: f64) -> [f64; 3] {
    let across = 4.0 * size_parameter * k;
    let absorption = if across > 1e-3 {
        1.0 + 2.0 * (-across).exp() / across + 2.0 * (-across).exp_m1() / (across * across)
    } else {
        across * (2.0 / 3.0 - 0.25 * across)
    };
    let shift = (n - 1.0).abs().max(1e-3);
    let phase = 2.0 * size_parameter * shift;
    let beta = (k / shift).atan();
    let (ratio, lost) = (beta.cos() / phase, (-phase * k / shift).exp());
    let extinction = 2.0
        - 4.0 * lost * ratio * (phase - beta).sin()
        - 4.0 * ratio * ratio * (lost * (phase - 2.0 * beta).cos() - (2.0 * beta).cos());
    // A transparent sphere gathers light into itself: (n³ − (n² − 1)^1.5)/n, C. F. Bohren and D. R. Huffman 1983,
    // eq. 7.2.
    let gathered = if n > 1.0 { (n * n * n - (n * n - 1.0).powf(1.5)) / n } else { 1.0 };
    let whole = absorption * (1.0 + (gathered - 1.0) * (-across).exp());
    [whole, extinction.max(whole), absorption]
}

/// Mean of Mie's efficiencies over so many sizes that Mie's ripple, whose period in x is 0.8, is met four times each.
#[cfg(test)]
pub(super) fn mie(um: &[f64], fuel: &Fuel, median_um: f64, kelvin: f64) -> Vec<[f64; 2]> {
    use crate::light::mie::{Sphere, efficiencies_of_many};
    let index: Vec<(f64, f64)> = um.iter().map(|&um| fuel.liquid_index(um, kelvin)).collect();
    let mut sums = vec![[0.0; 2]; um.len()];
    let largest = PI * median_um * (0.25f64 * 2.5).exp() / 2.5;
    let sizes = (0.625 * largest / 0.2).ceil().max(10.0);
    for size in 0..=2000 {
        let deviation = 2.5 * (f64::from(size) / sizes - 1.0);
        if deviation > 2.5 {
            break;
        }
        let ratio = (0.25 * deviation).exp();
        let area = ratio * ratio * (-0.5 * deviation * deviation).exp();
        let sphere = |(&um, &(n, k)): (&f64, &(f64, f64))| Sphere {
            size_parameter: PI * median_um * ratio / um,
            n,
            k,
        };
        let spheres: Vec<Sphere> = um.iter().zip(&index).map(sphere).collect();
        for (sum, one) in sums.iter_mut().zip(efficiencies_of_many(&spheres).unwrap()) {
            sum[0] += area * one.q_abs;
            sum[1] += area * one.q_ext;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anomalous_diffraction_follows_mies_theory_over_the_band() {
        let fuel = Fuel::named("n-octane").unwrap();
        let um: Vec<f64> = (0..40).map(|i| 3.2 + 0.02 * f64::from(i)).collect();
        for diameter_um in [4.0, 9.0] {
            let exact = mie(&um, &fuel, diameter_um, 320.0);
            let mut indices = Indices::new(&um, &fuel);
            let found: Vec<[f64; 3]> = indices.droplets(diameter_um, 320.0).collect();
            for part in 0..2 {
                let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / um.len() as f64;
                let scale =
                    mean(&mut found.iter().map(|f| f[part])) / mean(&mut exact.iter().map(|e| e[part]));
                for ((found, exact), um) in found.iter().zip(&exact).zip(&um) {
                    // Only the course counts. Van de Hulst's approximation is one for n → 1; here n − 1 is 0.4.
                    let ratio = found[part] / exact[part] / scale;
                    assert!((0.6..1.7).contains(&ratio), "{diameter_um} um, {um} um, part {part}: {ratio}");
                }
            }
        }
        // Nothing that absorbs nothing, and no more than is met.
        let [absorbed, met, straight] = anomalous_diffraction(10.0, 1.4, 0.0);
        assert!(absorbed.abs() < 1e-300 && straight.abs() < 1e-300 && met > 1.0);
        assert!(anomalous_diffraction(1e-3, 1.0, 0.0)[1] >= 0.0);
    }
}
