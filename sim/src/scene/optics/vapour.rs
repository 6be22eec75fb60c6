//! Absorption and emission of the fuel's vapour, at the temperature of the gas.

use super::super::field::Gas;
use super::Source;
use crate::light::fuel::Fuel;
use crate::light::table::locate;

/// Cross-section of the vapour per group over temperature, at steps of 1 K: the fuel's table is linear between
/// whole kelvins, so nothing is lost.
pub(super) struct VapourTable {
    nodes_k: Vec<f64>,
    /// m²/mol, `[node][group]`.
    m2_mol: Vec<Vec<f64>>,
}

impl VapourTable {
    pub(super) fn new(fuel: &Fuel, um: &[f64]) -> Self {
        let [cold, hot] = fuel.vapour_range_k();
        let mut nodes_k = vec![cold];
        let mut next = cold.floor() + 1.0;
        while next < hot {
            nodes_k.push(next);
            next += 1.0;
        }
        nodes_k.push(hot.max(cold + 1e-3));
        let at = |t: &f64| um.iter().map(|&um| fuel.vapour_cross_section_m2_mol(um, *t)).collect();
        let m2_mol = nodes_k.iter().map(at).collect();
        Self { nodes_k, m2_mol }
    }

    /// Number of temperatures.
    pub(super) fn nodes(&self) -> usize {
        self.nodes_k.len()
    }

    /// Adds absorption and emission of a cell's vapour.
    pub(super) fn add(
        &self,
        gas: &Gas,
        um: &[f64],
        sources: &[Source],
        ext: &mut [f64],
        emission: &mut [f64],
    ) {
        if gas.vapour_mol_m3 <= 0.0 {
            return;
        }
        let (cold, warmth) = locate(&self.nodes_k, gas.temperature_k);
        let (below, above) = (&self.m2_mol[cold], &self.m2_mol[cold + 1]);
        for (group, &um) in um.iter().enumerate() {
            let k_abs = gas.vapour_mol_m3 * (below[group] + warmth * (above[group] - below[group]));
            if k_abs > 0.0 {
                ext[group] += k_abs;
                for (channel, source) in sources.iter().enumerate() {
                    emission[channel * ext.len() + group] += k_abs * source.of_vapour(um, gas.temperature_k);
                }
            }
        }
    }
}
