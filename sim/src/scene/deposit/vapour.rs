//! Vapour and gas temperature on the grid, by exact overlap of CFD cells with grid cells.

use super::super::field::{GasCell, Grid};
use super::kernel::index;

/// Sums per grid cell.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    /// Fuel vapour in mol.
    pub(super) vapour_mol: f64,
    /// Its product with the gas temperature.
    pub(super) vapour_warmth: f64,
    /// Gas in kg.
    pub(super) mass_kg: f64,
    /// Its product with the gas temperature.
    pub(super) mass_warmth: f64,
    /// Part of the cell that CFD cells fill, in m³.
    pub(super) filled_m3: f64,
}

/// Gas of a whole spray on a grid.
pub(super) struct Spread {
    pub(super) sums: Vec<Sums>,
    /// Vapour beyond the grid or in cells below the limit, in mol.
    pub(super) outside_mol: f64,
    /// All vapour of the spray, in mol.
    pub(super) total_mol: f64,
}

/// Spreads the cells; vapour counts only in cells with more than `vapour_min_mol_m3` of it.
pub(super) fn spread(
    grid: &Grid,
    cells: &[GasCell],
    fuel_molar_mass_kg_mol: f64,
    vapour_min_mol_m3: f64,
) -> Spread {
    let mut spread = Spread { sums: vec![Sums::default(); grid.len()], outside_mol: 0.0, total_mol: 0.0 };
    for cell in cells {
        let vapour = cell.vapour_kg() / fuel_molar_mass_kg_mol;
        let mass = cell.volume_m3() * cell.density_kg_m3;
        spread.total_mol += vapour;
        let counted = if vapour > vapour_min_mol_m3 * cell.volume_m3() { vapour } else { 0.0 };
        let along: [(usize, Vec<f64>); 3] =
            std::array::from_fn(|a| overlaps(grid, a, cell.lower_m[a], cell.upper_m[a]));
        let mut inside = 0.0;
        for (x, share_x) in along[0].1.iter().enumerate() {
            for (y, share_y) in along[1].1.iter().enumerate() {
                for (z, share_z) in along[2].1.iter().enumerate() {
                    let share = share_x * share_y * share_z;
                    let sums =
                        &mut spread.sums[grid.linear([along[0].0 + x, along[1].0 + y, along[2].0 + z])];
                    sums.vapour_mol += share * counted;
                    sums.vapour_warmth += share * counted * cell.temperature_k;
                    sums.mass_kg += share * mass;
                    sums.mass_warmth += share * mass * cell.temperature_k;
                    sums.filled_m3 += share * cell.volume_m3();
                    inside += share;
                }
            }
        }
        spread.outside_mol += vapour - inside * counted;
    }
    spread
}

/// The first grid cell along an axis that a stretch meets, and the shares of the stretch in it and those after it.
fn overlaps(grid: &Grid, axis: usize, lower: f64, upper: f64) -> (usize, Vec<f64>) {
    let size = (grid.upper_m[axis] - grid.lower_m[axis]) / grid.cells[axis] as f64;
    if upper <= grid.lower_m[axis] || lower >= grid.upper_m[axis] || upper <= lower {
        return (0, Vec::new());
    }
    let start = ((lower - grid.lower_m[axis]) / size).max(0.0);
    let end = ((upper - grid.lower_m[axis]) / size).min(grid.cells[axis] as f64);
    let length = (upper - lower) / size;
    let (first, last) = (index(start, grid.cells[axis]), index(end, grid.cells[axis]));
    let shares =
        (first..=last).map(|i| ((end.min(i as f64 + 1.0) - start.max(i as f64)) / length).max(0.0)).collect();
    (first, shares)
}
