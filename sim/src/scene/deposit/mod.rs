//! Spreads a CFD spray on a uniform grid: droplets by kernels, vapour by overlap, nothing lost unsaid.
//!
//! Knows nothing of wavelengths: the grid keeps, per cell, which parcels' droplets are there and how many.

mod kernel;
mod noise;
mod placement;
mod vapour;

pub use placement::{Move, Placement};

use super::field::{CfdSpray, Gas, GasCell, Grid, Parcel, SprayField, junk};
use super::import::SceneError;
use kernel::narrow;
use rayon::prelude::*;
use std::borrow::Cow;
use vapour::{Spread, Sums};

/// Cells of a grid at most: 16 million, about 0.7 GB while the gas is summed.
pub const CELLS_MAX: usize = 1 << 24;

/// A corner point pair (lower, upper) in metres.
type Bounds = [[f64; 3]; 2];

/// How a spray is spread.
#[derive(Debug, Clone, PartialEq)]
pub struct DepositOptions {
    /// Edge of a grid cell in metres; `None`: that of the CFD cells where the vapour is (their mean, weighted
    /// with the vapour), or 1 mm for a spray without gas.
    pub cell_m: Option<f64>,
    /// Parcels on which the local density must rest, (Σ a)² / Σ a² with a the droplet area.
    pub n_eff: f64,
    /// Largest width of a kernel in units of the cell's edge; where parcels are rarer, N_eff stays lower.
    pub kernel_max: f64,
    /// Vapour below this concentration is left out, in mol/m³. The default 1e-5 is an optical depth of 4e-5 over
    /// 0.1 m at the strongest line of a C–H band (40 m²/mol).
    pub vapour_min_mol_m3: f64,
    /// Where the spray is put; `None`: as it is.
    pub placement: Option<Placement>,
    /// Only this part of the scene, in metres; `None`: all. What lies beyond is reported as outside.
    pub region_m: Option<[[f64; 3]; 2]>,
    /// Seed of the split into random halves.
    pub seed: u64,
}

impl Default for DepositOptions {
    /// Cells as the CFD's, N_eff 30, the whole spray as it is.
    fn default() -> Self {
        Self {
            cell_m: None,
            n_eff: 30.0,
            kernel_max: 4.0,
            vapour_min_mol_m3: 1e-5,
            placement: None,
            region_m: None,
            seed: 1,
        }
    }
}

/// What was done, and how good it is.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct DepositReport {
    /// Edges of a grid cell in metres.
    pub cell_m: [f64; 3],
    /// Cells of the grid.
    pub cells: usize,
    /// Cells with droplets.
    pub droplet_cells: usize,
    /// Cells with vapour.
    pub vapour_cells: usize,
    /// Droplets deposited.
    pub droplets: f64,
    /// Droplets of parcels outside the region or the walls.
    pub outside_droplets: f64,
    /// Parcels outside the region or the walls.
    pub outside_parcels: usize,
    /// Junk parcels, see [`junk`]: not deposited.
    pub junk_parcels: usize,
    /// Share of the droplet area that was in junk parcels.
    pub junk_area_share: f64,
    /// Largest relative difference, over the parcels, of the droplets deposited (before rounding to f32) and given.
    pub droplet_error: f64,
    /// Vapour deposited, in mol.
    pub vapour_mol: f64,
    /// Vapour outside, or below the limit of concentration, in mol.
    pub outside_vapour_mol: f64,
    /// Relative difference of the vapour deposited plus outside and the vapour given.
    pub vapour_error: f64,
    /// Mean N_eff reached by the kernels, weighted with droplet area.
    pub n_eff: f64,
    /// Share of the droplet area where N_eff is below what was asked.
    pub n_eff_short: f64,
    /// Mean kernel width in metres, weighted with droplet area; the standard deviation is half of it.
    pub kernel_m: f64,
    /// Parcel noise seen along x, y, z: rms difference of the transmission (geometric extinction) of two random
    /// halves of the parcels, doubled, over columns with an optical depth above 0.05. The whole's own noise is
    /// half of it. Raw parcels in 0.25 mm pixels have 0.22 to 0.29.
    pub split_half: [f64; 3],
}

/// Spreads a spray on a grid.
///
/// Droplets: each parcel's number is shared among cells by a quadratic B-spline along each axis, as wide as its
/// neighbourhood needs; the shares of a parcel sum to 1. Vapour: by exact overlap of boxes. Gas temperature:
/// weighted with the vapour where there is vapour, else with the mass; where no CFD cell is known, the mean of
/// the cells left out, or the liquid's temperature.
///
/// # Errors
///
/// [`SceneError::Deposit`] if there is neither liquid nor gas, an option is out of range, or the grid would have
/// more than [`CELLS_MAX`] cells.
pub fn field(spray: &CfdSpray, options: &DepositOptions) -> Result<(SprayField, DepositReport), SceneError> {
    check(options)?;
    let placed = match &options.placement {
        Some(placement) => Cow::Owned(placement.apply(spray, options.vapour_min_mol_m3)),
        None => Cow::Borrowed(spray),
    };
    let all = placed.parcels.as_deref().unwrap_or_default();
    let gas_cells = placed.cells.as_deref().unwrap_or_default();
    if all.is_empty() && gas_cells.is_empty() {
        return Err(refuse(
            "there are neither parcels nor gas cells",
            "Choose a time after the injection began",
        ));
    }
    let size_m = options.cell_m.unwrap_or_else(|| local_cell_m(gas_cells));
    let bounds = intersect(placed.domain_m, options.region_m);
    let sorted = sort_parcels(all, bounds);
    let widths = kernel::widths(&sorted.inside, options.n_eff, size_m, options.kernel_max.max(1.0) * size_m);
    let grid = choose_grid(&placed, &sorted.inside, &widths, options, size_m, bounds)?;
    let spread = vapour::spread(&grid, gas_cells, placed.fuel_molar_mass_kg_mol, options.vapour_min_mol_m3);
    // Cells that no CFD cell fills are walls, if all CFD cells are known and there are any.
    let walls_known = placed.domain_m.is_some() && placed.remainder.is_none();
    let open = |cell: usize| !walls_known || spread.sums[cell].filled_m3 > 0.0;
    let shares: Vec<Vec<(u32, f64)>> = sorted
        .inside
        .par_iter()
        .zip(&widths)
        .map(|(parcel, width)| kernel::shares(&grid, parcel.position_m, width.0, &open))
        .collect();
    let droplet_error =
        shares.iter().map(|list| (list.iter().map(|s| s.1).sum::<f64>() - 1.0).abs()).fold(0.0, f64::max);
    let field =
        assemble(grid, &sorted.inside, &shares, &spread, placed.remainder.map(|r| r.temperature_mean_k));
    let mut report = DepositReport {
        droplets: sorted.inside.iter().map(|p| p.droplets).sum(),
        outside_droplets: sorted.outside_droplets,
        outside_parcels: sorted.outside_parcels,
        junk_parcels: sorted.junk_parcels,
        junk_area_share: sorted.junk_area_share,
        droplet_error,
        ..gas_report(&field, &spread)
    };
    let area: f64 = sorted.inside.iter().map(Parcel::area_m2).sum();
    let mean = |value: &dyn Fn(&(f64, f64)) -> f64| {
        let sum: f64 = sorted.inside.iter().zip(&widths).map(|(p, w)| p.area_m2() * value(w)).sum();
        if area > 0.0 { sum / area } else { 0.0 }
    };
    report.n_eff = mean(&|w| w.1);
    report.n_eff_short = mean(&|w| f64::from(u8::from(w.1 < options.n_eff)));
    report.kernel_m = mean(&|w| w.0);
    report.split_half = noise::split_half(&field, options.seed);
    Ok((field, report))
}

fn check(options: &DepositOptions) -> Result<(), SceneError> {
    let positive = |v: f64| v.is_finite() && v > 0.0;
    let good = options.cell_m.is_none_or(positive)
        && options.n_eff.is_finite()
        && positive(options.kernel_max)
        && options.vapour_min_mol_m3 >= 0.0;
    if good {
        Ok(())
    } else {
        Err(refuse("an option is not a positive number", "Check cell, N_eff and kernel"))
    }
}

fn refuse(why: impl Into<String>, hint: &str) -> SceneError {
    SceneError::Deposit { why: why.into(), hint: hint.into() }
}

/// Mean edge of the CFD cells, weighted with their vapour, between 0.1 and 5 mm; 1 mm without vapour.
fn local_cell_m(cells: &[GasCell]) -> f64 {
    let vapour: f64 = cells.iter().map(GasCell::vapour_kg).sum();
    let edges: f64 = cells.iter().map(|c| c.vapour_kg() * c.volume_m3().cbrt()).sum();
    if vapour > 0.0 { (edges / vapour).clamp(1e-4, 5e-3) } else { 1e-3 }
}

fn intersect(one: Option<Bounds>, other: Option<Bounds>) -> Option<Bounds> {
    match (one, other) {
        (Some([l, u]), Some([l2, u2])) => {
            Some([std::array::from_fn(|a| l[a].max(l2[a])), std::array::from_fn(|a| u[a].min(u2[a]))])
        }
        (one, other) => one.or(other),
    }
}

struct Sorted {
    inside: Vec<Parcel>,
    outside_droplets: f64,
    outside_parcels: usize,
    junk_parcels: usize,
    junk_area_share: f64,
}

fn sort_parcels(parcels: &[Parcel], bounds: Option<Bounds>) -> Sorted {
    let mut sorted = Sorted {
        inside: Vec::with_capacity(parcels.len()),
        outside_droplets: 0.0,
        outside_parcels: 0,
        junk_parcels: 0,
        junk_area_share: 0.0,
    };
    let total: f64 = parcels.iter().map(Parcel::area_m2).filter(|a| a.is_finite()).sum();
    for (parcel, is_junk) in parcels.iter().zip(junk(parcels)) {
        // A parcel on a wall may lie a rounding of single precision beyond it.
        let within = bounds.is_none_or(|[lower, upper]| {
            (0..3).all(|a| {
                let slack = 1e-6 * (upper[a] - lower[a]);
                parcel.position_m[a] >= lower[a] - slack && parcel.position_m[a] <= upper[a] + slack
            })
        });
        if is_junk {
            sorted.junk_parcels += 1;
            if parcel.area_m2().is_finite() && total > 0.0 {
                sorted.junk_area_share += parcel.area_m2() / total;
            }
        } else if within {
            sorted.inside.push(*parcel);
        } else {
            sorted.outside_parcels += 1;
            sorted.outside_droplets += parcel.droplets;
        }
    }
    sorted
}

/// The bounding box of vapour and kernels, within walls and region, cut into cells of at most the wanted size.
fn choose_grid(
    spray: &CfdSpray,
    parcels: &[Parcel],
    widths: &[(f64, f64)],
    options: &DepositOptions,
    size_m: f64,
    bounds: Option<Bounds>,
) -> Result<Grid, SceneError> {
    let mut lower = [f64::INFINITY; 3];
    let mut upper = [f64::NEG_INFINITY; 3];
    let mut extend = |low: [f64; 3], high: [f64; 3]| {
        for a in 0..3 {
            lower[a] = lower[a].min(low[a]);
            upper[a] = upper[a].max(high[a]);
        }
    };
    for (parcel, (width, _)) in parcels.iter().zip(widths) {
        extend(parcel.position_m.map(|x| x - 1.5 * width), parcel.position_m.map(|x| x + 1.5 * width));
    }
    for cell in spray.cells.iter().flatten() {
        let moles = cell.density_kg_m3 * cell.fuel_mass_fraction / spray.fuel_molar_mass_kg_mol;
        if moles > options.vapour_min_mol_m3 {
            extend(cell.lower_m, cell.upper_m);
        }
    }
    let Some([lower, upper]) = intersect(Some([lower, upper]), bounds) else {
        return Err(refuse("there is nothing to spread", "Choose another time"));
    };
    if (0..3).any(|a| upper[a].partial_cmp(&lower[a]) != Some(std::cmp::Ordering::Greater)) {
        return Err(refuse(
            "no droplets and no vapour within the walls or the region",
            "Check region and placement",
        ));
    }
    let counts: [f64; 3] = std::array::from_fn(|a| ((upper[a] - lower[a]) / size_m - 1e-6).ceil().max(1.0));
    let product: f64 = counts.iter().product();
    if !product.is_finite() || product > CELLS_MAX as f64 {
        let why = format!("cells of {size_m} m make a grid of {product:.3e} cells, more than {CELLS_MAX}");
        return Err(refuse(why, "Take larger cells or a smaller region"));
    }
    Ok(Grid { lower_m: lower, upper_m: upper, cells: counts.map(|c| 1 + kernel::index(c - 1.0, CELLS_MAX)) })
}

fn assemble(
    grid: Grid,
    parcels: &[Parcel],
    shares: &[Vec<(u32, f64)>],
    spread: &Spread,
    ambient_k: Option<f64>,
) -> SprayField {
    let volume = grid.cell_volume_m3();
    let mut count = vec![0_u32; grid.len()];
    for (cell, _) in shares.iter().flatten() {
        count[*cell as usize] += 1;
    }
    let mut cells = Vec::new();
    let mut start = vec![0_u32];
    let mut next = vec![0_u32; grid.len()];
    let mut filled = 0_u32;
    for (cell, &entries) in count.iter().enumerate() {
        if entries > 0 || spread.sums[cell].vapour_mol > 0.0 {
            next[cell] = filled;
            filled += entries;
            cells.push(narrow(cell));
            start.push(filled);
        }
    }
    let mut deposit_parcel = vec![0_u32; filled as usize];
    let mut deposit_per_m3 = vec![0_f32; filled as usize];
    for (index, list) in shares.iter().enumerate() {
        for (cell, share) in list {
            let slot = next[*cell as usize] as usize;
            next[*cell as usize] += 1;
            deposit_parcel[slot] = narrow(index);
            #[expect(clippy::cast_possible_truncation, reason = "the field is kept in single precision")]
            let density = (share * parcels[index].droplets / volume) as f32;
            deposit_per_m3[slot] = density;
        }
    }
    let gas = cells
        .iter()
        .enumerate()
        .map(|(i, &cell)| {
            let sums = &spread.sums[cell as usize];
            let liquid = || {
                let first = deposit_parcel.get(start[i] as usize);
                first.map_or(f64::NAN, |&p| parcels[p as usize].temperature_k)
            };
            let temperature_k = gas_temperature_k(sums).or(ambient_k).unwrap_or_else(liquid);
            Gas { temperature_k, vapour_mol_m3: sums.vapour_mol / volume }
        })
        .collect();
    SprayField {
        grid,
        cells,
        gas,
        parcels: parcels.to_vec(),
        deposit_start: start,
        deposit_parcel,
        deposit_per_m3,
    }
}

fn gas_temperature_k(sums: &Sums) -> Option<f64> {
    if sums.vapour_mol > 0.0 {
        Some(sums.vapour_warmth / sums.vapour_mol)
    } else if sums.mass_kg > 0.0 {
        Some(sums.mass_warmth / sums.mass_kg)
    } else {
        None
    }
}

/// The report with all that concerns grid and gas.
fn gas_report(field: &SprayField, spread: &Spread) -> DepositReport {
    let vapour_mol: f64 = spread.sums.iter().map(|s| s.vapour_mol).sum();
    let difference = (vapour_mol + spread.outside_mol - spread.total_mol).abs();
    DepositReport {
        cell_m: field.grid.cell_m(),
        cells: field.grid.len(),
        droplet_cells: field.deposit_start.windows(2).filter(|w| w[1] > w[0]).count(),
        vapour_cells: field.gas.iter().filter(|g| g.vapour_mol_m3 > 0.0).count(),
        droplets: 0.0,
        outside_droplets: 0.0,
        outside_parcels: 0,
        junk_parcels: 0,
        junk_area_share: 0.0,
        droplet_error: 0.0,
        vapour_mol,
        outside_vapour_mol: spread.outside_mol,
        vapour_error: if spread.total_mol > 0.0 { difference / spread.total_mol } else { 0.0 },
        n_eff: 0.0,
        n_eff_short: 0.0,
        kernel_m: 0.0,
        split_half: [0.0; 3],
    }
}
