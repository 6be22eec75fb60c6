//! Vapour and gas temperature on the grid, by exact overlap of CFD cells with grid cells.

use super::super::field::Grid;
use super::kernel::index;
use super::slopes::{GasPiece, Pieces};

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

/// Spreads the pieces: the plane of each is integrated exactly over each overlap, so that its vapour stays its own.
pub(super) fn spread(grid: &Grid, gas: &Pieces) -> Spread {
    let mut spread = Spread {
        sums: vec![Sums::default(); grid.len()],
        outside_mol: gas.left_out_mol,
        total_mol: gas.total_mol,
    };
    let mut parts = Vec::new();
    for piece in &gas.pieces {
        let inside = overlaps(grid, piece, &mut parts);
        let vapour: f64 = parts.iter().map(|p| p.vapour_mol).sum();
        let warmth: f64 = parts.iter().map(|p| p.vapour_mol * p.temperature_k).sum();
        // Where vapour and temperature vary together the mean over the vapour moves; it is put back.
        let shift =
            if vapour > 0.0 && inside > 1.0 - 1e-9 { piece.temperature_k - warmth / vapour } else { 0.0 };
        let (volume, mass) = (piece.volume_m3(), piece.volume_m3() * piece.density_kg_m3);
        for part in &parts {
            let sums = &mut spread.sums[part.cell];
            sums.vapour_mol += part.vapour_mol;
            sums.vapour_warmth += part.vapour_mol * (part.temperature_k + shift);
            sums.mass_kg += part.share * mass;
            sums.mass_warmth += part.share * mass * part.temperature_k;
            sums.filled_m3 += part.share * volume;
        }
        // A piece inside the grid has nothing outside: if some of it got lost, the sums will tell.
        let is_inside =
            (0..3).all(|a| piece.lower_m[a] >= grid.lower_m[a] && piece.upper_m[a] <= grid.upper_m[a]);
        if !is_inside {
            spread.outside_mol += piece.vapour_mol_m3 * volume - vapour;
        }
    }
    spread
}

/// What a piece has in common with one grid cell.
struct Part {
    cell: usize,
    /// Share of the piece's volume.
    share: f64,
    vapour_mol: f64,
    temperature_k: f64,
}

/// Fills `parts`; returns the share of the piece inside the grid.
fn overlaps(grid: &Grid, piece: &GasPiece, parts: &mut Vec<Part>) -> f64 {
    parts.clear();
    let along: [(usize, Vec<(f64, f64)>); 3] =
        std::array::from_fn(|a| stretches(grid, a, piece.lower_m[a], piece.upper_m[a]));
    let volume = piece.volume_m3();
    let mut inside = 0.0;
    for (x, &(share_x, off_x)) in along[0].1.iter().enumerate() {
        for (y, &(share_y, off_y)) in along[1].1.iter().enumerate() {
            for (z, &(share_z, off_z)) in along[2].1.iter().enumerate() {
                let share = share_x * share_y * share_z;
                let plane = |mean: f64, slope: [f64; 3]| {
                    mean + slope[0] * off_x + slope[1] * off_y + slope[2] * off_z
                };
                // Not below zero but for rounding.
                let vapour_mol_m3 = plane(piece.vapour_mol_m3, piece.vapour_slope).max(0.0);
                inside += share;
                parts.push(Part {
                    cell: grid.linear([along[0].0 + x, along[1].0 + y, along[2].0 + z]),
                    share,
                    vapour_mol: share * volume * vapour_mol_m3,
                    temperature_k: plane(piece.temperature_k, piece.temperature_slope),
                });
            }
        }
    }
    inside
}

/// The first grid cell along an axis that a stretch meets; for it and those after it the share of the stretch, and
/// how far the middle of that share is from the middle of the stretch, in metres.
fn stretches(grid: &Grid, axis: usize, lower: f64, upper: f64) -> (usize, Vec<(f64, f64)>) {
    let size = (grid.upper_m[axis] - grid.lower_m[axis]) / grid.cells[axis] as f64;
    if upper <= grid.lower_m[axis] || lower >= grid.upper_m[axis] || upper <= lower {
        return (0, Vec::new());
    }
    let (whole_start, whole_end) = ((lower - grid.lower_m[axis]) / size, (upper - grid.lower_m[axis]) / size);
    let start = whole_start.max(0.0);
    let end = whole_end.min(grid.cells[axis] as f64);
    let length = (upper - lower) / size;
    let middle = 0.5 * (whole_start + whole_end);
    let (first, last) = (index(start, grid.cells[axis]), index(end, grid.cells[axis]));
    let shares = (first..=last)
        .map(|i| {
            let (from, to) = (start.max(i as f64), end.min(i as f64 + 1.0));
            (((to - from) / length).max(0.0), (0.5 * (from + to) - middle) * size)
        })
        .collect();
    (first, shares)
}
