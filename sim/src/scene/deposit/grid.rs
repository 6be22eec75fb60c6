//! Which grid a spray is spread on: how fine, and where its planes lie.

use super::super::field::{CfdSpray, GasCell, Grid, Parcel};
use super::super::import::SceneError;
use super::kernel::index;
use super::slopes::GasPiece;
use super::{Bounds, CELLS_MAX, refuse};

/// Occupied cells wanted at most: what the tracer renders in seconds.
const OCCUPIED_MAX: f64 = 2e5;

/// Grid cells along the edge of a CFD cell at most: with a plane in each CFD cell, finer steps are below those that
/// the planes leave at its faces.
const FINER_MAX: f64 = 3.0;

/// Sizes of a grid cell are those of the CFD cells over powers of this number: sprays that differ little get the same.
const SIZE_STEP: f64 = 1.044_273_782_427_413_8; // 2^(1/16)

/// Share of CFD cells that are no boxes up to which the grid may be finer than they are: the boxes that stand for them
/// leave gaps.
const SHAPED_MAX: f64 = 0.05;

/// Mean edge of the CFD cells, weighted with their vapour, between 0.1 and 5 mm; 1 mm without vapour.
pub(super) fn resolution_m(cells: &[GasCell]) -> f64 {
    let vapour: f64 = cells.iter().map(GasCell::vapour_kg).sum();
    let edges: f64 = cells.iter().map(|c| c.vapour_kg() * c.volume_m3().cbrt()).sum();
    if vapour > 0.0 { (edges / vapour).clamp(1e-4, 5e-3) } else { 1e-3 }
}

/// What goes on the grid.
pub(super) struct Contents<'a> {
    pub(super) pieces: &'a [GasPiece],
    pub(super) parcels: &'a [Parcel],
    /// Kernel width and N_eff of each parcel.
    pub(super) widths: &'a [(f64, f64)],
}

impl Contents<'_> {
    /// Boxes that hold vapour or droplets.
    fn boxes(&self) -> impl Iterator<Item = Bounds> {
        let gas = self.pieces.iter().filter(|p| p.vapour_mol_m3 > 0.0).map(|p| [p.lower_m, p.upper_m]);
        let droplets = self.parcels.iter().zip(self.widths).map(|(parcel, (width, _))| {
            [parcel.position_m.map(|x| x - 1.5 * width), parcel.position_m.map(|x| x + 1.5 * width)]
        });
        gas.chain(droplets)
    }
}

/// The grid with cells of at most this edge.
pub(super) fn of_size(
    contents: &Contents<'_>,
    size_m: f64,
    bounds: Option<Bounds>,
) -> Result<Grid, SceneError> {
    let mut lower = [f64::INFINITY; 3];
    let mut upper = [f64::NEG_INFINITY; 3];
    for [low, high] in contents.boxes() {
        for a in 0..3 {
            lower[a] = lower[a].min(low[a]);
            upper[a] = upper[a].max(high[a]);
        }
    }
    let Some([lower, upper]) = super::intersect(Some([lower, upper]), bounds) else {
        return Err(refuse("there is nothing to spread", "Choose another time"));
    };
    if (0..3).any(|a| upper[a].partial_cmp(&lower[a]) != Some(std::cmp::Ordering::Greater)) {
        return Err(refuse(
            "no droplets and no vapour within the walls or the region",
            "Check region and placement",
        ));
    }
    // Planes lie where they lie for every spray in the same vessel: sprays that differ little, other times, halves of
    // the parcels, differ little on the grid too.
    let (mut snapped_lower, mut snapped_upper, mut cells) = (lower, upper, [1; 3]);
    let mut product = 1.0;
    for a in 0..3 {
        let (origin, step) = match bounds {
            Some([low, high]) => {
                (low[a], (high[a] - low[a]) / ((high[a] - low[a]) / size_m - 1e-6).ceil().max(1.0))
            }
            None => (0.0, size_m),
        };
        let first = ((lower[a] - origin) / step + 1e-6).floor();
        let last = ((upper[a] - origin) / step - 1e-6).ceil().max(first + 1.0);
        snapped_lower[a] = origin + first * step;
        snapped_upper[a] = origin + last * step;
        product *= last - first;
        cells[a] = 1 + index(last - first - 1.0, CELLS_MAX);
    }
    if !f64::is_finite(product) || product > CELLS_MAX as f64 {
        let why = format!("cells of {size_m} m make a grid of {product:.3e} cells, more than {CELLS_MAX}");
        return Err(refuse(why, "Take larger cells or a smaller region"));
    }
    Ok(Grid { lower_m: snapped_lower, upper_m: snapped_upper, cells })
}

/// The finest grid that [`OCCUPIED_MAX`] and [`FINER_MAX`] allow, from the CFD's resolution downwards.
pub(super) fn automatic(
    spray: &CfdSpray,
    contents: &Contents<'_>,
    resolution_m: f64,
    bounds: Option<Bounds>,
) -> Result<Grid, SceneError> {
    let coarse = of_size(contents, resolution_m, bounds)?;
    let cells = spray.cells.as_ref().map_or(0, Vec::len);
    if spray.shaped_cells as f64 > SHAPED_MAX * cells as f64 {
        return Ok(coarse);
    }
    let cell_m = coarse.cell_m();
    let mut occupied = vec![false; coarse.len()];
    // Kernels count with their least width: how wide they are is a matter of noise.
    let widths = vec![(resolution_m, 0.0); contents.parcels.len()];
    for [lower, upper] in (Contents { widths: &widths, ..*contents }).boxes() {
        let place = |corner: [f64; 3], inward: f64| -> [usize; 3] {
            std::array::from_fn(|a| {
                index((corner[a] - coarse.lower_m[a]) / cell_m[a] + inward, coarse.cells[a])
            })
        };
        let (from, to) = (place(lower, 1e-6), place(upper, -1e-6));
        for x in from[0]..=to[0] {
            for y in from[1]..=to[1] {
                let line = coarse.linear([x, y, 0]);
                occupied[line + from[2]..=line + to[2]].fill(true);
            }
        }
    }
    let volume = occupied.iter().filter(|o| **o).count() as f64 * coarse.cell_volume_m3();
    let finer = (resolution_m / (volume / OCCUPIED_MAX).cbrt()).clamp(1.0, FINER_MAX);
    let size_m = resolution_m / SIZE_STEP.powf((finer.ln() / SIZE_STEP.ln()).floor());
    // A wide vessel with little in it may still be too large a grid.
    of_size(contents, size_m, bounds).or(Ok(coarse))
}
