//! The medium as the straight sights read it: every cell at its own resolution, coefficients in f32.

use super::bricks::{Brick, Bricks, EDGE, NONE};
use super::medium::{EMPTY, GridMedium};
use super::spectrum::{One, Spectrum, narrow};
use rayon::prelude::*;

/// Extinction beyond which a cell of any size is opaque in f32; keeps products finite.
const K_MAX: f64 = 1e30;

/// Cells of a brick.
pub(super) const CELLS: usize = EDGE * EDGE * EDGE;

/// Coefficients per occupied cell.
#[derive(Clone)]
pub(super) struct Fine<S> {
    pub(super) bricks: Bricks,
    /// Number of each occupied brick in `bricks`, in the order of their cells.
    pub(super) occupied: Vec<usize>,
    /// Ordinal of the cell at each place, or [`EMPTY`].
    pub(super) slot: Vec<u32>,
    /// Its ordinal in the medium, `[ordinal]`.
    pub(super) original: Vec<u32>,
    /// Extinction in 1/m, and scattering over extinction, `[place]`; zero where nothing is. What is not scattered is
    /// emitted by channel 0.
    pub(super) core: Vec<[S; 2]>,
    /// Emission coefficient over extinction of the channels from 1 on, `[ordinal · (channels − 1) + channel − 1]`.
    pub(super) source: Vec<S>,
    pub(super) channels: usize,
    pub(super) groups: usize,
}

impl<S: Spectrum> Fine<S> {
    /// Packs a checked medium, each cell cut into `factor`³ equal ones.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "as many places as fit into u32 are checked by the caller"
    )]
    pub(super) fn new(medium: &GridMedium, factor: usize) -> Self {
        let mut bricks = Bricks::new(medium.lower_m, medium.upper_m, medium.cells.map(|n| n * factor));
        let offset = |medium: &GridMedium, c: [usize; 3]| offset(medium, c.map(|i| i / factor));
        let occupied: Vec<usize> = (0..bricks.list.len())
            .into_par_iter()
            .with_min_len(64)
            .filter(|&b| cells(&bricks, b).any(|(_, c)| medium.index[offset(medium, c)] != EMPTY))
            .collect();
        for (i, &b) in occupied.iter().enumerate() {
            bricks.list[b] = Brick { first: (i * CELLS) as u32, log: 3 };
        }
        let original: Vec<u32> = occupied
            .par_iter()
            .flat_map_iter(|&b| {
                cells(&bricks, b).map(|(_, c)| medium.index[offset(medium, c)]).filter(|&o| o != EMPTY)
            })
            .collect();
        let mut slot = vec![EMPTY; occupied.len() * CELLS];
        let counts: Vec<u32> = slot
            .par_chunks_mut(CELLS)
            .zip(&occupied)
            .map(|(slots, &b)| {
                let mut n = 0;
                for (local, c) in cells(&bricks, b) {
                    if medium.index[offset(medium, c)] != EMPTY {
                        slots[local] = n;
                        n += 1;
                    }
                }
                n
            })
            .collect();
        let mut running = 0;
        let firsts: Vec<u32> = counts
            .iter()
            .map(|n| {
                running += n;
                running - n
            })
            .collect();
        slot.par_chunks_mut(CELLS).zip(firsts).for_each(|(slots, first)| {
            slots.iter_mut().filter(|s| **s != EMPTY).for_each(|s| *s += first);
        });
        let (groups, channels) = (medium.groups, medium.channels);
        let spectrum = |f: &dyn Fn(usize) -> f64| {
            let mut s = S::ZERO;
            for g in 0..groups {
                s.set(g, narrow(f(g)));
            }
            s
        };
        let over = |values: &[f64], o: usize| {
            let k = &medium.k_ext[o * groups..(o + 1) * groups];
            spectrum(&|g| if k[g] > 0.0 { values[g] / k[g] } else { 0.0 })
        };
        let one = S::splat(1.0);
        let core = slot
            .par_iter()
            .with_min_len(CELLS)
            .map(|&slot| {
                if slot == EMPTY {
                    return [S::ZERO; 2];
                }
                let o = original[slot as usize] as usize;
                let albedo = over(&medium.k_sca[o * groups..(o + 1) * groups], o);
                // A sum of roundings may exceed the extinction by a unit in the last place.
                let albedo = one.minus(one.minus(albedo).not_negative());
                [spectrum(&|g| medium.k_ext[o * groups + g].min(K_MAX)), albedo]
            })
            .collect();
        let source = original
            .par_iter()
            .with_min_len(1024)
            .flat_map_iter(|&o| {
                let o = o as usize;
                (1..channels).map(move |c| {
                    let start = (o * channels + c) * groups;
                    over(&medium.emission[start..start + groups], o)
                })
            })
            .collect();
        Self { bricks, occupied, slot, original, core, source, channels, groups }
    }
}

impl<S: Spectrum> Fine<S> {
    /// Itself, if it holds a single group.
    pub(super) fn single(&self) -> Option<&Fine<One>> {
        (self as &dyn std::any::Any).downcast_ref()
    }
}

/// The cells of a brick inside the box: number in the brick and coordinates.
pub(super) fn cells(bricks: &Bricks, brick: usize) -> impl Iterator<Item = (usize, [usize; 3])> {
    let low = bricks.at(brick).map(|b| b * EDGE);
    let high = [0, 1, 2].map(|a| (low[a] + EDGE).min(bricks.cells[a]));
    (low[0]..high[0]).flat_map(move |x| {
        (low[1]..high[1]).flat_map(move |y| {
            (low[2]..high[2])
                .map(move |z| (((x - low[0]) * EDGE + y - low[1]) * EDGE + z - low[2], [x, y, z]))
        })
    })
}

fn offset(medium: &GridMedium, c: [usize; 3]) -> usize {
    (c[0] * medium.cells[1] + c[1]) * medium.cells[2] + c[2]
}

/// Whether a place is occupied.
pub(super) fn is_occupied(slot: u32) -> bool {
    slot != EMPTY
}

const _: () = assert!(NONE == EMPTY);
