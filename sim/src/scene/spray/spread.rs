//! Jets placed in space and spread on the grid, holding on to every gram.
//!
//! Each tube of each section is stood for by points of equal mass (a low-discrepancy set, several to a cell); a point
//! gives its mass to the eight cells around it. What is summed over cells is what the jet has, up to rounding.

use super::jet::{Jet, Opening};
use super::place::Place;
use super::profile::DEVELOPED;
use super::sizes::sphere_kg;
use crate::scene::field::{Gas, Grid, Parcel, SprayField};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Points to a cell's edge.
const POINTS: f64 = 3.0;
/// Nodes of a tube's radii over its fuel.
const NODES: usize = 16;
/// Fewest and most points of a tube in one section.
const POINTS_RANGE: [f64; 2] = [6.0, 60_000.0];
/// Share of the fuel beyond the last section that is spread.
const TAIL: f64 = 2e-7;
/// Sections are bowed: those of equal time are fast in the middle. The bow is this times the half width from edge to
/// middle, which rounds the tip as seen in shadowgraphs; no mass moves across the axis by it.
const BOW: f64 = 1.0;
/// Cells of a grid at most.
pub(super) const CELLS_MAX: usize = 1 << 24;

/// A jet's fuel on the grid.
pub(super) struct Spreading<'a> {
    pub(super) jet: &'a Jet,
    pub(super) place: &'a Place,
    pub(super) grid: Grid,
    /// Sections that are spread.
    last: usize,
}

/// One tube of one section: where it is.
#[derive(Debug, Clone, Copy)]
struct Element {
    section: usize,
    tube: usize,
}

impl<'a> Spreading<'a> {
    /// Lays a grid of cells of `cell_m` around the jets.
    ///
    /// # Errors
    ///
    /// In words, when it has too many cells.
    pub(super) fn new(jet: &'a Jet, place: &'a Place, cell_m: f64) -> Result<Self, String> {
        let tip = jet.within_m(1.0 - TAIL) / jet.step_m;
        let last = (1..=jet.sections.len()).find(|&i| i as f64 >= tip).unwrap_or(jet.sections.len());
        let (mut lower, mut upper) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for jet_number in 0..place.jets() {
            for section in 0..=last {
                let s = jet.step_m * section as f64;
                let half = (1.0 + BOW) * jet.start.opening.half_m(s);
                // A hole's section is one point and a ball; a sheet's is a ring of them.
                let angles = if matches!(place, Place::Holes(_)) { 1 } else { 64 };
                for turn in 0..angles {
                    let at = place.point(jet_number, s, 0.0, 2.0 * PI * f64::from(turn) / f64::from(angles));
                    for a in 0..3 {
                        lower[a] = lower[a].min(at[a] - half);
                        upper[a] = upper[a].max(at[a] + half);
                    }
                }
            }
        }
        let cells = std::array::from_fn(|a| 3.0 + ((upper[a] - lower[a]) / cell_m).ceil());
        let number: f64 = cells.iter().product();
        if number.is_nan() || number > CELLS_MAX as f64 {
            return Err(format!(
                "cells of {cell_m:.2e} m make a grid of {number:.2e} cells, more than {CELLS_MAX}"
            ));
        }
        let lower_m: [f64; 3] =
            std::array::from_fn(|a| 0.5 * (lower[a] + upper[a]) - 0.5 * cells[a] * cell_m);
        let upper_m = std::array::from_fn(|a| lower_m[a] + cells[a] * cell_m);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most CELLS_MAX")]
        let cells = cells.map(|c| c as usize);
        Ok(Self { jet, place, grid: Grid { lower_m, upper_m, cells }, last })
    }

    fn elements(&self) -> Vec<Element> {
        let tubes = |section: usize| 0..self.jet.sections[section].tubes.len();
        (0..self.last)
            .filter(|&section| self.jet.sections[section].fuel_kg > 0.0)
            .flat_map(|section| tubes(section).map(move |tube| Element { section, tube }))
            .collect()
    }

    /// Fuel of an element in one jet, kg.
    fn fuel_kg(&self, element: Element) -> f64 {
        let [from, to] = Jet::tube_shares(element.tube);
        self.jet.sections[element.section].fuel_kg * (to - from)
    }

    /// Area within each node of an element's radii, as a share of the section: smooth over the share of the fuel even in the
    /// middle, where η is not.
    fn areas(&self, element: Element) -> [f64; NODES + 1] {
        let profile = self.jet.profile(&self.jet.sections[element.section]);
        let [from, to] = Jet::tube_shares(element.tube);
        std::array::from_fn(|i| profile.area(profile.eta(from + (to - from) * i as f64 / NODES as f64)))
    }

    /// Shares of the mass of an element of jet `jet`, with these areas, by cell, added to `cells`.
    fn scatter(&self, jet: usize, element: Element, areas: &[f64; NODES + 1], cells: &mut Cells) {
        let profile = self.jet.profile(&self.jet.sections[element.section]);
        let begin = self.jet.step_m * element.section as f64;
        let middle = begin + 0.5 * self.jet.step_m;
        let half = self.jet.start.opening.half_m(middle);
        let part = areas[NODES] - areas[0];
        let volume = part * self.jet.step_m * self.jet.start.opening.area_m2(middle);
        let wanted = volume * POINTS.powi(3) / self.grid.cell_volume_m3();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within POINTS_RANGE")]
        let points = wanted.clamp(POINTS_RANGE[0], POINTS_RANGE[1]).ceil() as u32;
        let sheet = matches!(self.jet.start.opening, Opening::Sheet { .. });
        // A start of its own for each element, so that neighbours do not repeat each other.
        let offset = (element.section * 16 + element.tube + 1000 * jet) as f64 * 0.618_033_988_749_895;
        let mean_bow = mean_square();
        for i in 0..points {
            let [u, v, w] = low_discrepancy(i, offset);
            let place = u * NODES as f64;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ≤ u < 1")]
            let node = (place as usize).min(NODES - 1);
            let area = areas[node] + (place - node as f64) * (areas[node + 1] - areas[node]);
            let eta = profile.eta_of_area(area);
            let s = begin + self.jet.step_m * v;
            let wide = self.jet.start.opening.half_m(s);
            let (aside, angle) = if sheet {
                // Both faces of the sheet in turn.
                let side = if i % 2 == 0 { 1.0 } else { -1.0 };
                (side * eta * wide, 2.0 * PI * w)
            } else {
                (eta * wide, 2.0 * PI * w)
            };
            let bowed = (s + BOW * half * (mean_bow - eta * eta)).max(0.25 * s);
            let at = self.place.point(jet, bowed, aside, angle);
            self.deposit(at, 1.0 / f64::from(points), cells);
        }
    }

    /// Shares a point among the eight cells around it.
    fn deposit(&self, at: [f64; 3], share: f64, cells: &mut Cells) {
        let size = self.grid.cell_m();
        let mut low = [0_usize; 3];
        let mut part = [0.0; 3];
        for a in 0..3 {
            let last = self.grid.cells[a] - 2;
            let place = ((at[a] - self.grid.lower_m[a]) / size[a] - 0.5).clamp(0.0, last as f64 + 1.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to the grid"
            )]
            let cell = (place as usize).min(last);
            low[a] = cell;
            part[a] = place - cell as f64;
        }
        for corner in 0..8_usize {
            let bit = |a: usize| corner >> a & 1;
            let weight: f64 = (0..3).map(|a| if bit(a) == 1 { part[a] } else { 1.0 - part[a] }).product();
            let cell = self.grid.linear(std::array::from_fn(|a| low[a] + bit(a)));
            cells.add(cell, weight * share);
        }
    }

    /// Every element of every jet on the grid.
    pub(super) fn scattered(&self) -> Scattered {
        let elements = self.elements();
        let jets = self.place.jets();
        let by_jet = elements
            .par_iter()
            .map_init(
                || Cells::new(self.grid.len()),
                |cells, &element| {
                    let areas = self.areas(element);
                    let on_grid = |jet| {
                        self.scatter(jet, element, &areas, cells);
                        cells.drain()
                    };
                    (0..jets).map(on_grid).collect()
                },
            )
            .collect();
        Scattered { elements, by_jet }
    }

    /// The spray's field, all jets together.
    pub(super) fn field(
        &self,
        scattered: &Scattered,
        fuel_molar_kg_mol: f64,
        liquid_kg_m3: impl Fn(f64) -> f64 + Sync,
    ) -> SprayField {
        let sum = |cells: &mut Cells, jets: &Vec<Vec<(u32, f64)>>| {
            jets.iter().flatten().for_each(|&(cell, share)| cells.add(cell as usize, share));
            cells.drain()
        };
        let pairs: Vec<Vec<(u32, f64)>> =
            scattered.by_jet.par_iter().map_init(|| Cells::new(self.grid.len()), sum).collect();
        self.assemble(&scattered.elements, &pairs, fuel_molar_kg_mol, liquid_kg_m3)
    }

    /// Fuel of each jet by cell, kg, ascending in the cell's linear index.
    pub(super) fn fuel_by_jet(&self, scattered: &Scattered) -> Vec<Vec<(u32, f64)>> {
        (0..self.place.jets())
            .into_par_iter()
            .map(|jet| {
                let mut cells = Cells::new(self.grid.len());
                for (&element, by_jet) in scattered.elements.iter().zip(&scattered.by_jet) {
                    let fuel_kg = self.fuel_kg(element);
                    by_jet[jet].iter().for_each(|&(cell, share)| cells.add(cell as usize, share * fuel_kg));
                }
                cells.drain()
            })
            .collect()
    }

    fn assemble(
        &self,
        elements: &[Element],
        pairs: &[Vec<(u32, f64)>],
        fuel_molar_kg_mol: f64,
        liquid_kg_m3: impl Fn(f64) -> f64,
    ) -> SprayField {
        let volume = self.grid.cell_volume_m3();
        let jets = self.place.jets() as f64;
        let classes = &self.jet.start.classes;
        let mut parcels = Vec::new();
        // Per element its parcels, and per cell how many deposits there will be.
        let mut ranges = Vec::with_capacity(elements.len());
        let mut count = vec![0_u32; self.grid.len()];
        let mut vapour_mol = vec![0.0; self.grid.len()];
        let mut warmth = vec![0.0; self.grid.len()];
        for (element, pairs) in elements.iter().zip(pairs) {
            let first = parcels.len();
            let section = &self.jet.sections[element.section];
            let tube = &section.tubes[element.tube];
            let fuel_kg = self.fuel_kg(*element);
            let s = self.jet.step_m * (element.section as f64 + 0.5);
            for (drops, class) in tube.drops.iter().zip(classes).filter(|(d, _)| d.left > 0.0) {
                let fresh_kg = sphere_kg(class.diameter_m, self.jet.liquid_kg_m3());
                let density = liquid_kg_m3(drops.temperature_k);
                let diameter_m = class.diameter_m * (drops.left * self.jet.liquid_kg_m3() / density).cbrt();
                parcels.push(Parcel {
                    position_m: self.place.point(0, s, 0.0, 0.0),
                    diameter_m,
                    temperature_k: drops.temperature_k,
                    droplets: jets * fuel_kg * class.share / fresh_kg,
                });
            }
            ranges.push(first..parcels.len());
            let mol = fuel_kg * tube.vapour(classes) / fuel_molar_kg_mol;
            for &(cell, share) in pairs {
                let cell = cell as usize;
                count[cell] += u32::try_from(parcels.len() - first).unwrap_or(u32::MAX);
                vapour_mol[cell] += share * mol;
                warmth[cell] += share * mol * tube.gas_k;
            }
        }
        let mut occupied = vec![false; self.grid.len()];
        for &(cell, _) in pairs.iter().flatten() {
            occupied[cell as usize] = true;
        }
        let mut field = SprayField {
            grid: self.grid,
            cells: Vec::new(),
            gas: Vec::new(),
            parcels,
            deposit_start: vec![0],
            deposit_parcel: Vec::new(),
            deposit_per_m3: Vec::new(),
        };
        let mut next = vec![0_u32; self.grid.len()];
        let mut filled = 0_u32;
        for (cell, &entries) in count.iter().enumerate().filter(|(cell, _)| occupied[*cell]) {
            next[cell] = filled;
            filled += entries;
            field.cells.push(u32::try_from(cell).unwrap_or(u32::MAX));
            field.deposit_start.push(filled);
            let temperature_k =
                if vapour_mol[cell] > 0.0 { warmth[cell] / vapour_mol[cell] } else { self.jet.start.gas_k };
            field.gas.push(Gas { temperature_k, vapour_mol_m3: vapour_mol[cell] / volume });
        }
        field.deposit_parcel = vec![0; filled as usize];
        field.deposit_per_m3 = vec![0.0; filled as usize];
        for (range, pairs) in ranges.iter().zip(pairs) {
            for parcel in range.clone() {
                for &(cell, share) in pairs {
                    let slot = next[cell as usize] as usize;
                    next[cell as usize] += 1;
                    field.deposit_parcel[slot] = u32::try_from(parcel).unwrap_or(u32::MAX);
                    // `share` sums to the number of jets; the parcel stands for all of them.
                    #[expect(
                        clippy::cast_possible_truncation,
                        reason = "the field is kept in single precision"
                    )]
                    let density = (share / jets * field.parcels[parcel].droplets / volume) as f32;
                    field.deposit_per_m3[slot] = density;
                }
            }
        }
        field
    }
}

/// Elements on the grid.
pub(super) struct Scattered {
    elements: Vec<Element>,
    /// Per element and jet the cells it reaches, ascending, and the share of its mass that each gets.
    by_jet: Vec<Vec<Vec<(u32, f64)>>>,
}

/// Sums by cell, of which few are touched.
struct Cells {
    sums: Vec<f64>,
    touched: Vec<u32>,
}

impl Cells {
    fn new(number: usize) -> Self {
        Self { sums: vec![0.0; number], touched: Vec::new() }
    }

    fn add(&mut self, cell: usize, value: f64) {
        if value > 0.0 {
            if self.sums[cell] <= 0.0 {
                self.touched.push(u32::try_from(cell).unwrap_or(u32::MAX));
            }
            self.sums[cell] += value;
        }
    }

    /// The touched cells with their sums, ascending; there are none afterwards.
    fn drain(&mut self) -> Vec<(u32, f64)> {
        self.touched.sort_unstable();
        let sums = &mut self.sums;
        let list =
            self.touched.iter().map(|&cell| (cell, std::mem::take(&mut sums[cell as usize]))).collect();
        self.touched.clear();
        list
    }
}

/// Mean of η² over the fuel of the developed round profile: about which the sections are bowed.
fn mean_square() -> f64 {
    // ∫ η³ (1 − η^α)² dη / ∫ η (1 − η^α)² dη.
    let a = DEVELOPED;
    let upper = 0.25 - 2.0 / (a + 4.0) + 1.0 / (2.0 * a + 4.0);
    let lower = 0.5 - 2.0 / (a + 2.0) + 1.0 / (2.0 * a + 2.0);
    upper / lower
}

/// Point `i` of the additive recurrence of the plastic number's generalisation in three dimensions (Roberts 2018).
fn low_discrepancy(i: u32, offset: f64) -> [f64; 3] {
    const STEP: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];
    let i = f64::from(i) + 0.5;
    std::array::from_fn(|a| (STEP[a] * i + offset * (a as f64 + 1.0)).fract())
}
