//! Spreads a CFD spray on a uniform grid: droplets by kernels, vapour by planes in the CFD's cells, nothing lost unsaid.
//!
//! Knows nothing of wavelengths: the grid keeps, per cell, which parcels' droplets are there and how many.

mod grid;
mod kernel;
mod kinds;
mod noise;
mod placement;
mod slopes;
mod vapour;
mod widths;

pub use placement::{Move, Placement, Sectors};

use super::field::{CfdSpray, Gas, Grid, Parcel, SprayField, junk};
use super::import::SceneError;
use grid::Contents;
use kernel::narrow;
use kinds::Kinds;
use rayon::prelude::*;
use std::borrow::Cow;
use vapour::{Spread, Sums};
use widths::{Found, Widths};

/// Cells of a grid at most: 16 million, about 0.7 GB while the gas is summed.
pub const CELLS_MAX: usize = 1 << 24;

/// A corner point pair (lower, upper) in metres.
type Bounds = [[f64; 3]; 2];

/// How a spray is spread.
#[derive(Debug, Clone, PartialEq)]
pub struct DepositOptions {
    /// Largest edge of a grid cell in metres; `None`: as fine as about 2 · 10⁵ occupied cells allow, between a quarter
    /// and the whole of the edge of the CFD cells where the vapour is (their mean, weighted with the vapour; 1 mm for
    /// a spray without gas).
    pub cell_m: Option<f64>,
    /// Parcels on which the local density must rest, (Σ a)² / Σ a² with a the droplet area.
    pub n_eff: f64,
    /// Difference of two halves of the parcels that is admitted, see [`DepositReport::split_half`]: where it is
    /// larger, `n_eff` is raised.
    pub noise_max: f64,
    /// Largest width of a kernel in units of the edge of the CFD's cells; where parcels are rarer, N_eff stays lower.
    /// The smallest is one edge (of the grid's cells, if those are asked to be larger): the CFD knows nothing finer.
    pub kernel_max: f64,
    /// Vapour below this concentration is left out, in mol/m³. The default 1e-4 is an optical depth of 2e-4 over
    /// 50 mm at the strongest line of a C–H band (40 m²/mol).
    pub vapour_min_mol_m3: f64,
    /// A sector of a symmetric spray is made whole; `None`: the spray is whole.
    pub sectors: Option<Sectors>,
    /// Where the spray is put; `None`: as it is.
    pub placement: Option<Placement>,
    /// Only this part of the scene, in metres; `None`: all. What lies beyond is reported as outside.
    pub region_m: Option<[[f64; 3]; 2]>,
}

impl Default for DepositOptions {
    /// As fine as is rendered in seconds, N_eff 30 or more, the whole spray as it is.
    fn default() -> Self {
        Self {
            cell_m: None,
            n_eff: 30.0,
            noise_max: 0.045,
            kernel_max: 4.0,
            vapour_min_mol_m3: 1e-4,
            sectors: None,
            placement: None,
            region_m: None,
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
    /// Kinds of droplets that the parcels were sorted into, for there are too many to be kept one by one in every cell; 0:
    /// each by itself.
    pub kinds: usize,
    /// Largest relative difference, over the parcels or kinds, of the droplets deposited (before rounding to f32) and given.
    pub droplet_error: f64,
    /// Vapour deposited, in mol.
    pub vapour_mol: f64,
    /// Vapour outside, or below the limit of concentration, in mol.
    pub outside_vapour_mol: f64,
    /// Relative difference of the vapour deposited plus outside and the vapour given.
    pub vapour_error: f64,
    /// Mean N_eff reached by the kernels, weighted with droplet area.
    pub n_eff: f64,
    /// N_eff wanted in the end: that of the options, or more where the noise asked for it.
    pub n_eff_wanted: f64,
    /// Share of the droplet area where N_eff is below that of the options.
    pub n_eff_short: f64,
    /// Mean kernel width in metres, weighted with droplet area; the standard deviation is half of it.
    pub kernel_m: f64,
    /// Parcel noise seen along x, y, z: rms difference of the transmission (geometric extinction) of two random
    /// halves of the parcels, doubled, over pixels of 0.25 mm with an optical depth above 0.3, expected over all halves. The whole's own noise is
    /// half of it. Raw parcels have 0.22 to 0.29.
    pub split_half: [f64; 3],
}

/// How many parcels the droplets' density rests on, and how noisy it is.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Smoothness {
    /// As in [`DepositReport::n_eff`].
    pub n_eff: f64,
    /// As in [`DepositReport::kernel_m`].
    pub kernel_m: f64,
    /// As in [`DepositReport::split_half`].
    pub split_half: [f64; 3],
}

/// What [`field`] would report of the kernels, without spreading anything; `None` without droplets.
///
/// # Errors
///
/// [`SceneError::Deposit`] if an option is out of range.
pub fn smoothness(spray: &CfdSpray, options: &DepositOptions) -> Result<Option<Smoothness>, SceneError> {
    check(options)?;
    let sorted = sort_parcels(spray.parcels.as_deref().unwrap_or_default(), spray.domain_m);
    if sorted.inside.is_empty() {
        return Ok(None);
    }
    let kernels = Kernels::choose(&sorted.inside, options, width_min_m(spray, options));
    Ok(Some(kernels.smoothness(&sorted.inside)))
}

/// Spreads a spray on a grid.
///
/// Droplets: each parcel's number is shared among cells by a quadratic B-spline along each axis, as wide as its
/// neighbourhood needs; the shares of a parcel sum to 1. Very many parcels are sorted into kinds of droplets
/// ([`DepositReport::kinds`]): then the area of each parcel is kept in every cell, and diameters and temperatures nearly. Vapour: a plane in each CFD cell, as steep as its neighbours
/// allow and nowhere below zero (level on a grid no finer than the CFD), integrated exactly over each overlap, so that each CFD cell keeps its vapour. Gas
/// temperature: likewise a plane; weighted with the vapour where there is vapour, else with the mass; where no CFD cell
/// is known, the mean of the cells left out, or the liquid's temperature.
///
/// # Errors
///
/// [`SceneError::Deposit`] if there is neither liquid nor gas, an option is out of range, the grid would have
/// more than [`CELLS_MAX`] cells, or its cells would hold more droplets of all kinds than fit into memory.
pub fn field(spray: &CfdSpray, options: &DepositOptions) -> Result<(SprayField, DepositReport), SceneError> {
    check(options)?;
    let all = spray.parcels.as_deref().unwrap_or_default();
    if all.is_empty() && spray.cells.as_ref().is_none_or(Vec::is_empty) {
        return Err(refuse(
            "there are neither parcels nor gas cells",
            "Choose a time after the injection began",
        ));
    }
    let mut gas = slopes::pieces(spray, options.vapour_min_mol_m3);
    // A grid no finer than the CFD shows no blocks of it, and has the columns of its cells as they are.
    if options.cell_m.is_some_and(|size_m| size_m >= resolution_m(spray)) {
        gas.flatten();
    }
    let mut parcels = Cow::Borrowed(all);
    let mut walls = spray.domain_m;
    if let Some(sectors) = &options.sectors {
        let turns = sectors.turns()?;
        gas.pieces = turns.iter().flat_map(|turn| turn.pieces(&gas.pieces)).collect();
        gas.total_mol *= turns.len() as f64;
        gas.left_out_mol *= turns.len() as f64;
        parcels = Cow::Owned(turns.iter().flat_map(|turn| turn.parcels(all)).collect());
        // The box of a sector says nothing of the whole.
        walls = None;
    }
    if let Some(placement) = &options.placement {
        gas.pieces = placement.pieces(&gas.pieces);
        parcels = Cow::Owned(placement.parcels(&parcels));
        walls = walls.and_then(|walls| placement.walls(walls));
    }
    let bounds = intersect(walls, options.region_m);
    let sorted = sort_parcels(&parcels, bounds);
    let kernels = Kernels::choose(&sorted.inside, options, width_min_m(spray, options));
    let contents = Contents { pieces: &gas.pieces, parcels: &sorted.inside, widths: &kernels.widths };
    let grid = match options.cell_m {
        Some(size_m) => grid::of_size(&contents, size_m, bounds)?,
        None => grid::automatic(spray, &contents, resolution_m(spray), bounds)?,
    };
    let spread = vapour::spread(&grid, &gas);
    // Cells that no CFD cell fills are walls, if all CFD cells are known and there are any.
    let walls_known = walls.is_some() && spray.remainder.is_none();
    let open = |cell: usize| !walls_known || spread.sums[cell].filled_m3 > 0.0;
    let smooth = kernels.smoothness(&sorted.inside);
    let n_eff_short = kernels.mean(&sorted.inside, &|w| f64::from(u8::from(w.1 < options.n_eff)));
    let droplets = sorted.inside.iter().map(|p| p.droplets).sum();
    let parcels = sorted.inside.len();
    let deposit = deposited(&grid, sorted.inside, &kernels.widths, &open)?;
    let (droplet_error, kinds) = (deposit.error, deposit.parcels.len());
    let field = assemble(grid, deposit, &spread, spray.remainder.map(|r| r.temperature_mean_k));
    let report = DepositReport {
        droplets,
        outside_droplets: sorted.outside_droplets,
        outside_parcels: sorted.outside_parcels,
        junk_parcels: sorted.junk_parcels,
        junk_area_share: sorted.junk_area_share,
        kinds: if kinds < parcels { kinds } else { 0 },
        droplet_error,
        n_eff: smooth.n_eff,
        n_eff_wanted: kernels.wanted,
        n_eff_short,
        kernel_m: smooth.kernel_m,
        split_half: smooth.split_half,
        ..gas_report(&field, &spread)
    };
    Ok((field, report))
}

fn resolution_m(spray: &CfdSpray) -> f64 {
    grid::resolution_m(spray.cells.as_deref().unwrap_or_default())
}

fn width_min_m(spray: &CfdSpray, options: &DepositOptions) -> f64 {
    resolution_m(spray).max(options.cell_m.unwrap_or(0.0))
}

/// Rounds of widening kernels until the noise is as asked.
const ROUNDS: usize = 6;

/// Kernels of the parcels.
struct Kernels {
    /// Width in metres and N_eff of each parcel.
    widths: Vec<Found>,
    wanted: f64,
    split_half: [f64; 3],
}

impl Kernels {
    /// The narrowest kernels that rest on enough parcels and are quiet enough.
    fn choose(parcels: &[Parcel], options: &DepositOptions, width_min_m: f64) -> Self {
        let width_max_m = options.kernel_max.max(1.0) * width_min_m;
        let search = Widths::new(parcels, width_min_m, width_max_m);
        let mut wanted = options.n_eff;
        let mut found = Vec::new();
        for round in 1.. {
            found = search.find(wanted, &found);
            let widths = search.of_parcels(&found);
            let split_half = noise::split_half(parcels, &widths);
            let worst = split_half.into_iter().fold(0.0, f64::max);
            let widest = widths.iter().all(|w| w.0 >= width_max_m);
            if worst <= options.noise_max || widest || round == ROUNDS {
                return Self { widths, wanted, split_half };
            }
            // Its square goes with the number of parcels that a column rests on, which goes slower than that of a
            // volume.
            let reached = widths.iter().map(|w| w.1).fold(f64::INFINITY, f64::min).max(wanted);
            wanted = reached * (worst / options.noise_max).powi(3).clamp(1.1, 3.0);
        }
        unreachable!("the last round returns")
    }

    /// Mean over the parcels, weighted with droplet area.
    fn mean(&self, parcels: &[Parcel], value: &dyn Fn(&Found) -> f64) -> f64 {
        let area: f64 = parcels.iter().map(Parcel::area_m2).sum();
        let sum: f64 = parcels.iter().zip(&self.widths).map(|(p, w)| p.area_m2() * value(w)).sum();
        if area > 0.0 { sum / area } else { 0.0 }
    }

    fn smoothness(&self, parcels: &[Parcel]) -> Smoothness {
        Smoothness {
            n_eff: self.mean(parcels, &|w| w.1),
            kernel_m: self.mean(parcels, &|w| w.0),
            split_half: self.split_half,
        }
    }
}

fn check(options: &DepositOptions) -> Result<(), SceneError> {
    let positive = |v: f64| v.is_finite() && v > 0.0;
    let good = options.cell_m.is_none_or(positive)
        && options.n_eff.is_finite()
        && positive(options.noise_max)
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

/// Parcels one by one, or as kinds where that would be too much.
fn deposited(
    grid: &Grid,
    parcels: Vec<Parcel>,
    widths: &[(f64, f64)],
    open: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Kinds, SceneError> {
    if kinds::entries(grid, widths) > kinds::ENTRIES_MAX {
        return kinds::spread(grid, &parcels, widths, open);
    }
    let volume = grid.cell_volume_m3();
    let (errors, lists): (Vec<f64>, Vec<_>) = parcels
        .par_iter()
        .zip(widths)
        .map(|(parcel, width)| {
            let shares = kernel::shares(grid, parcel.position_m, width.0, open);
            let error = (shares.iter().map(|s| s.1).sum::<f64>() - 1.0).abs();
            let density = |share: f64| {
                #[expect(clippy::cast_possible_truncation, reason = "the field is kept in single precision")]
                let density = (share * parcel.droplets / volume) as f32;
                density
            };
            (error, shares.into_iter().map(|(cell, share)| (cell, density(share))).collect())
        })
        .unzip();
    Ok(Kinds { parcels, lists, error: errors.into_iter().fold(0.0, f64::max) })
}

fn assemble(grid: Grid, deposit: Kinds, spread: &Spread, ambient_k: Option<f64>) -> SprayField {
    let Kinds { parcels, lists, .. } = deposit;
    let volume = grid.cell_volume_m3();
    let mut count = vec![0_u32; grid.len()];
    for (cell, _) in lists.iter().flatten() {
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
    for (index, list) in lists.into_iter().enumerate() {
        for (cell, density) in list {
            let slot = next[cell as usize] as usize;
            next[cell as usize] += 1;
            deposit_parcel[slot] = narrow(index);
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
    SprayField { grid, cells, gas, parcels, deposit_start: start, deposit_parcel, deposit_per_m3 }
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
        kinds: 0,
        droplet_error: 0.0,
        vapour_mol,
        outside_vapour_mol: spread.outside_mol,
        vapour_error: if spread.total_mol > 0.0 { difference / spread.total_mol } else { 0.0 },
        n_eff: 0.0,
        n_eff_wanted: 0.0,
        n_eff_short: 0.0,
        kernel_m: 0.0,
        split_half: [0.0; 3],
    }
}
