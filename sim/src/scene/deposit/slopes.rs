//! Vapour and temperature inside a CFD cell: a plane through its mean, as steep as its neighbours allow.
//!
//! A finite-volume code knows means of cells; painted as they are, they show as blocks. Knows no grid and no files.

use super::super::field::{CfdSpray, Grid};
use super::kernel::index;
use rayon::prelude::*;

/// Gas of one box: means of the box and slopes along the axes; values are those of the plane through the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GasPiece {
    pub(super) lower_m: [f64; 3],
    pub(super) upper_m: [f64; 3],
    pub(super) density_kg_m3: f64,
    pub(super) temperature_k: f64,
    /// In K/m.
    pub(super) temperature_slope: [f64; 3],
    /// Vapour in mol/m³; 0 in cells below the limit.
    pub(super) vapour_mol_m3: f64,
    /// In mol/m⁴; nowhere in the box the plane is below zero.
    pub(super) vapour_slope: [f64; 3],
}

impl GasPiece {
    pub(super) fn volume_m3(&self) -> f64 {
        (0..3).map(|a| self.upper_m[a] - self.lower_m[a]).product()
    }
}

/// The pieces of a spray.
pub(super) struct Pieces {
    pub(super) pieces: Vec<GasPiece>,
    /// All vapour of the spray, in mol.
    pub(super) total_mol: f64,
    /// Vapour of the cells below the limit, in mol.
    pub(super) left_out_mol: f64,
}

impl Pieces {
    /// Makes all planes level.
    pub(super) fn flatten(&mut self) {
        for piece in &mut self.pieces {
            (piece.vapour_slope, piece.temperature_slope) = ([0.0; 3], [0.0; 3]);
        }
    }
}

/// Makes pieces of the gas cells; cells with at most `vapour_min_mol_m3` have no vapour.
pub(super) fn pieces(spray: &CfdSpray, vapour_min_mol_m3: f64) -> Pieces {
    let cells = spray.cells.as_deref().unwrap_or_default();
    let molar = spray.fuel_molar_mass_kg_mol;
    let vapour: Vec<f64> = cells.iter().map(|c| c.density_kg_m3 * c.fuel_mass_fraction / molar).collect();
    let mut pieces: Vec<GasPiece> = cells
        .iter()
        .zip(&vapour)
        .map(|(cell, &mol_m3)| GasPiece {
            lower_m: cell.lower_m,
            upper_m: cell.upper_m,
            density_kg_m3: cell.density_kg_m3,
            temperature_k: cell.temperature_k,
            temperature_slope: [0.0; 3],
            vapour_mol_m3: if mol_m3 > vapour_min_mol_m3 { mol_m3 } else { 0.0 },
            vapour_slope: [0.0; 3],
        })
        .collect();
    let total_mol = cells.iter().map(|cell| cell.vapour_kg() / molar).sum();
    let thin = cells.iter().zip(&vapour).filter(|(_, mol_m3)| **mol_m3 <= vapour_min_mol_m3);
    let left_out_mol = thin.map(|(cell, _)| cell.vapour_kg() / molar).sum();
    if let Some(places) = Places::new(&pieces) {
        // Cells that a compact form left out are neighbours without vapour; where no cell is, there is a wall.
        let beyond = spray.remainder.map(|r| [0.0, r.temperature_mean_k]);
        let slopes: Vec<[[f64; 3]; 2]> = pieces
            .par_iter()
            .map(|piece| {
                if piece.vapour_mol_m3 > 0.0 { places.slopes(&pieces, piece, beyond) } else { [[0.0; 3]; 2] }
            })
            .collect();
        for (piece, [vapour, temperature]) in pieces.iter_mut().zip(slopes) {
            piece.vapour_slope = vapour;
            piece.temperature_slope = temperature;
        }
    }
    Pieces { pieces, total_mol, left_out_mol }
}

/// Bins of the search for neighbours, at most.
const BINS_MAX: f64 = 2_097_152.0;

/// Entries of the search per cell and bin, at most; a mesh has about 8, a heap of boxes that overlap has more.
const ENTRIES_MAX: usize = 64;

/// Finds the piece at a place.
struct Places {
    grid: Grid,
    start: Vec<u32>,
    pieces: Vec<u32>,
}

impl Places {
    /// `None` for nothing to search in, or boxes that overlap so much that they are no mesh.
    fn new(pieces: &[GasPiece]) -> Option<Self> {
        let mut lower_m = [f64::INFINITY; 3];
        let mut upper_m = [f64::NEG_INFINITY; 3];
        for piece in pieces {
            for a in 0..3 {
                lower_m[a] = lower_m[a].min(piece.lower_m[a]);
                upper_m[a] = upper_m[a].max(piece.upper_m[a]);
            }
        }
        let span: [f64; 3] = std::array::from_fn(|a| upper_m[a] - lower_m[a]);
        if pieces.is_empty() || !span.iter().all(|s| s.is_finite() && *s > 0.0) {
            return None;
        }
        let edge = (span.iter().product::<f64>() / (2.0 * pieces.len() as f64).min(BINS_MAX)).cbrt();
        let cells = span.map(|s| 1 + index((s / edge).min(BINS_MAX.cbrt()), 1 << 20));
        let grid = Grid { lower_m, upper_m, cells };
        let mut start = vec![0_u32; grid.len() + 1];
        let mut entries = 0;
        for piece in pieces {
            let (from, to) = (at(&grid, piece.lower_m), at(&grid, piece.upper_m));
            entries += (0..3).map(|a| to[a] - from[a] + 1).product::<usize>();
            if entries > ENTRIES_MAX * (pieces.len() + grid.len()) || entries > u32::MAX as usize {
                return None;
            }
            each_bin(&grid, from, to, |bin| start[bin + 1] += 1);
        }
        for bin in 0..grid.len() {
            start[bin + 1] += start[bin];
        }
        let mut next = start.clone();
        let mut list = vec![0_u32; entries];
        for (number, piece) in (0_u32..).zip(pieces) {
            each_bin(&grid, at(&grid, piece.lower_m), at(&grid, piece.upper_m), |bin| {
                list[next[bin] as usize] = number;
                next[bin] += 1;
            });
        }
        Some(Self { grid, start, pieces: list })
    }

    fn find<'a>(&self, pieces: &'a [GasPiece], place: [f64; 3]) -> Option<&'a GasPiece> {
        if (0..3).any(|a| place[a] < self.grid.lower_m[a] || place[a] > self.grid.upper_m[a]) {
            return None;
        }
        let bin = self.grid.linear(at(&self.grid, place));
        let list = &self.pieces[self.start[bin] as usize..self.start[bin + 1] as usize];
        list.iter()
            .map(|&number| &pieces[number as usize])
            .find(|piece| (0..3).all(|a| place[a] >= piece.lower_m[a] && place[a] <= piece.upper_m[a]))
    }

    /// Slopes of vapour and temperature of one piece.
    fn slopes(&self, pieces: &[GasPiece], piece: &GasPiece, beyond: Option<[f64; 2]>) -> [[f64; 3]; 2] {
        let edge: [f64; 3] = std::array::from_fn(|a| piece.upper_m[a] - piece.lower_m[a]);
        let own = [piece.vapour_mol_m3, piece.temperature_k];
        let (mut vapour, mut temperature) = ([0.0; 3], [0.0; 3]);
        for (axis, (vapour, temperature)) in vapour.iter_mut().zip(&mut temperature).enumerate() {
            let sides = [-1.0, 1.0].map(|side| self.beside(pieces, piece, axis, side, beyond));
            if let [Some((back_m, back)), Some((fore_m, fore))] = sides {
                let slope = |i: usize| limited((own[i] - back[i]) / back_m, (fore[i] - own[i]) / fore_m);
                (*vapour, *temperature) = (slope(0), slope(1));
            }
        }
        // Nowhere below zero.
        let fall: f64 = edge.iter().zip(vapour).map(|(edge, slope)| 0.5 * edge * f64::abs(slope)).sum();
        if fall > own[0] {
            vapour = vapour.map(|s| s * own[0] / fall);
        }
        [vapour, temperature]
    }

    /// Mean distance along an axis, and mean vapour and temperature, of the cells beyond a face: four places a quarter
    /// of an edge behind it, which lie in each of four neighbours of half the size.
    fn beside(
        &self,
        pieces: &[GasPiece],
        piece: &GasPiece,
        axis: usize,
        side: f64,
        beyond: Option<[f64; 2]>,
    ) -> Option<(f64, [f64; 2])> {
        let centre: [f64; 3] = std::array::from_fn(|a| 0.5 * (piece.lower_m[a] + piece.upper_m[a]));
        let edge: [f64; 3] = std::array::from_fn(|a| piece.upper_m[a] - piece.lower_m[a]);
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut found = 0.0;
        let mut way = 0.0;
        let mut values = [0.0; 2];
        for [u, v] in [[-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25], [0.25, 0.25]] {
            let mut place = centre;
            place[axis] += 0.75 * side * edge[axis];
            place[b] += u * edge[b];
            place[c] += v * edge[c];
            let (distance, [vapour, temperature]) = match (self.find(pieces, place), beyond) {
                (Some(other), _) => {
                    let middle = 0.5 * (other.lower_m[axis] + other.upper_m[axis]);
                    (side * (middle - centre[axis]), [other.vapour_mol_m3, other.temperature_k])
                }
                (None, Some(values)) => (edge[axis], values),
                (None, None) => continue,
            };
            // A box that overlaps its neighbours may find one behind itself.
            if distance > 0.25 * edge[axis] {
                found += 1.0;
                way += distance;
                values[0] += vapour;
                values[1] += temperature;
            }
        }
        (found > 0.0).then(|| (way / found, values.map(|v| v / found)))
    }
}

/// The monotonised central slope (van Leer 1977): the central one, at most twice the flatter side, 0 at extrema.
fn limited(back: f64, fore: f64) -> f64 {
    if back * fore <= 0.0 {
        return 0.0;
    }
    let flat = 2.0 * back.abs().min(fore.abs());
    (0.5 * (back + fore)).abs().min(flat).copysign(back)
}

fn at(grid: &Grid, place: [f64; 3]) -> [usize; 3] {
    let cell_m = grid.cell_m();
    std::array::from_fn(|a| index((place[a] - grid.lower_m[a]) / cell_m[a], grid.cells[a]))
}

fn each_bin(grid: &Grid, from: [usize; 3], to: [usize; 3], mut visit: impl FnMut(usize)) {
    for x in from[0]..=to[0] {
        for y in from[1]..=to[1] {
            for z in from[2]..=to[2] {
                visit(grid.linear([x, y, z]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::field::GasCell;
    use super::*;

    /// Cells of a box 8 × 8 × 8 mm, 1 mm each, those of the upper half in x cut into eight.
    fn mesh(fraction: impl Fn([f64; 3]) -> f64) -> CfdSpray {
        let mut cells = Vec::new();
        let mut add = |lower_m: [f64; 3], edge: f64| {
            let centre = lower_m.map(|x| x + 0.5 * edge);
            cells.push(GasCell {
                lower_m,
                upper_m: lower_m.map(|x| x + edge),
                temperature_k: 400.0 + 2e3 * centre[1],
                pressure_pa: 4e5,
                density_kg_m3: 3.0,
                fuel_mass_fraction: fraction(centre),
            });
        };
        for i in 0..512_u32 {
            let at = [i / 64, i / 8 % 8, i % 8].map(|v| f64::from(v) * 1e-3);
            if i / 64 < 4 {
                add(at, 1e-3);
            } else {
                for j in 0..8_u32 {
                    let part = [j / 4, j / 2 % 2, j % 2];
                    add(std::array::from_fn(|a| at[a] + 0.5e-3 * f64::from(part[a])), 0.5e-3);
                }
            }
        }
        CfdSpray {
            time_s: 0.0,
            parcels: None,
            liquid_density_kg_m3: None,
            cells: Some(cells),
            shaped_cells: 0,
            remainder: None,
            domain_m: Some([[0.0; 3], [8e-3; 3]]),
            fuel: "C7H16".into(),
            fuel_molar_mass_kg_mol: 0.1,
            carrier_molar_mass_kg_mol: 0.028,
            notes: Vec::new(),
        }
    }

    #[test]
    fn a_plane_is_found_exactly_inside_the_mesh_and_at_its_refinement() {
        let spray = mesh(|[x, y, z]| 0.1 + 3.0 * x - 2.0 * y + z);
        let made = pieces(&spray, 0.0);
        let mut inside = 0;
        for piece in &made.pieces {
            let off_walls = (0..3).all(|a| piece.lower_m[a] > 1e-6 && piece.upper_m[a] < 8e-3 - 1e-6);
            if !off_walls {
                continue;
            }
            inside += 1;
            // Fine cells that touch coarse ones see the coarse mean off their own line: across the axis it differs.
            if (piece.lower_m[0] - 4e-3).abs() > 1e-6 {
                let slopes = piece.vapour_slope.map(|s| s * 0.1 / 3.0);
                for (slope, expected) in slopes.iter().zip([3.0, -2.0, 1.0]) {
                    assert!((slope - expected).abs() < 1e-9, "{piece:?}");
                }
                assert!((piece.temperature_slope[1] - 2e3).abs() < 1e-6, "{piece:?}");
            }
        }
        assert!(inside > 1000);
    }

    #[test]
    fn no_plane_falls_below_zero_and_extrema_stay_flat() {
        let spray =
            mesh(|[x, y, z]| if (x - 2.5e-3).hypot(y - 2.5e-3).hypot(z - 2.5e-3) < 1e-3 { 0.3 } else { 0.0 });
        let made = pieces(&spray, 1e-5);
        assert!(made.total_mol > 0.0);
        for piece in &made.pieces {
            let fall: f64 = (0..3)
                .map(|a| 0.5 * (piece.upper_m[a] - piece.lower_m[a]) * piece.vapour_slope[a].abs())
                .sum();
            assert!(fall <= piece.vapour_mol_m3 * (1.0 + 1e-12), "{piece:?}");
        }
    }

    #[test]
    fn the_limiter_is_central_between_and_zero_at_extrema() {
        let close =
            |found: f64, expected: f64| assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        close(limited(1.0, 1.0), 1.0);
        close(limited(1.0, 2.0), 1.5);
        close(limited(-1.0, -10.0), -2.0);
        close(limited(1.0, -1.0), 0.0);
        close(limited(0.0, 5.0), 0.0);
    }
}
