//! Phase functions that are linear in the cosine between nodes: sampled exactly as evaluated.
//!
//! They stand for smooth ones (Mie, or one without its peak) to a stated error of the cumulative distribution.

use super::inverse::Cells;

/// A phase function of cells, each linear in the cosine, normalised.
#[derive(Debug, Clone)]
pub struct PhaseCells {
    cells: Cells,
    mean_cosine: f64,
}

impl PhaseCells {
    pub(super) fn new(cells: Cells) -> Self {
        let mean_cosine = 1.0 - cells.mean_versine();
        Self { cells, mean_cosine }
    }

    /// The phase function at the cosine of the scattering angle.
    pub fn value(&self, cosine: f64) -> f64 {
        self.cells.value(1.0 - cosine.clamp(-1.0, 1.0))
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.cells.len() + 1
    }

    /// Angles of the nodes from 0 to π in radians.
    pub fn theta_rad(&self) -> Vec<f64> {
        self.cells.bounds()
    }

    /// Largest distance of the cumulative distribution from that of the function it stands for, from the points
    /// compared between nodes; at the nodes there is none.
    pub fn error(&self) -> f64 {
        self.cells.error
    }

    /// The mean cosine.
    pub fn mean_cosine(&self) -> f64 {
        self.mean_cosine
    }

    pub(super) fn cells(&self) -> &Cells {
        &self.cells
    }
}
