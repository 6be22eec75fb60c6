//! From radii back to pixels: both halves, their standard deviations and flags.

use super::answer::Answer;
use super::fold::reverse;
use super::grid::Grid;
use super::inverter::Inverter;
use super::rows::{Work, resize};
use super::{Inverted, flag};
use rayon::prelude::*;

/// Rows of one parallel task.
const TASK_ROWS: usize = 32;

impl Inverter {
    /// From radii to pixels.
    pub(super) fn unfold(&self, work: &Work<'_>, answer: &Answer, out: &mut Inverted) {
        let grid = &self.grid;
        let (rows, columns) = (work.rows, grid.columns);
        (out.rows, out.columns, out.axis) = (rows, columns, self.axis);
        resize(&mut out.alpha_per_m, rows * columns);
        resize(&mut out.sigma_alpha, rows * columns);
        out.flags.resize(rows * columns, 0);
        out.strength.clone_from(&answer.strength);
        out.discrepancy_failed = answer.discrepancy_failed;
        let both = grid.right.1.min(grid.left.1);
        let one_side = |column: usize| {
            // Rounding is for axes between the radii, whose rows all go alone.
            let i = grid.radii(column)[0].0;
            if i < both { 0 } else { flag::ONE_SIDE }
        };
        let one_side: Vec<u32> = (0..columns).map(one_side).collect();
        out.alpha_per_m
            .par_chunks_mut(TASK_ROWS * columns)
            .zip(out.sigma_alpha.par_chunks_mut(TASK_ROWS * columns))
            .zip(out.flags.par_chunks_mut(TASK_ROWS * columns))
            .enumerate()
            .for_each(|(task, ((alpha, sigma), flags))| {
                let first = task * TASK_ROWS;
                let one_side = &one_side;
                let part = Part { inverter: self, work, answer, first, one_side, alpha, sigma, flags };
                pulp::Arch::new().dispatch(part);
            });
    }

    #[inline(always)]
    fn unfold_row(&self, work: &Work<'_>, answer: &Answer, row: usize, alpha: &mut [f64], sigma: &mut [f64]) {
        let (grid, n) = (&self.grid, self.grid.n);
        let scale = work.scale / self.settings.pixel_m;
        if let Some(found) = &answer.incomplete[row] {
            alpha.iter_mut().zip(&found.values).for_each(|(to, v)| *to = v * scale);
            sigma.iter_mut().zip(&found.variances).for_each(|(to, v)| *to = v.sqrt() * scale);
            return;
        }
        let at = answer.place[row] * n..(answer.place[row] + 1) * n;
        mirrored(
            grid,
            &answer.values[at.clone()],
            alpha,
            #[inline(always)]
            |v| v * scale,
        );
        if work.given {
            mirrored(
                grid,
                &answer.variances[at],
                sigma,
                #[inline(always)]
                |v| v.sqrt() * scale,
            );
        } else {
            let noise = work.noise[row].sqrt() * scale;
            let unit = &self.kernel.operator(answer.choices[row]).unit_sigmas;
            mirrored(
                grid,
                unit,
                sigma,
                #[inline(always)]
                |v| v * noise,
            );
        }
    }
}

/// Some rows of an image.
struct Part<'a> {
    inverter: &'a Inverter,
    work: &'a Work<'a>,
    answer: &'a Answer,
    first: usize,
    one_side: &'a [u32],
    alpha: &'a mut [f64],
    sigma: &'a mut [f64],
    flags: &'a mut [u32],
}

impl pulp::WithSimd for Part<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { inverter, work, answer, first, one_side, alpha, sigma, flags } = self;
        let columns = one_side.len();
        let each = alpha.chunks_mut(columns).zip(sigma.chunks_mut(columns)).zip(flags.chunks_mut(columns));
        for (row, ((alpha, sigma), flags)) in (first..).zip(each) {
            inverter.unfold_row(work, answer, row, alpha, sigma);
            let edge = if work.truncated[row] { flag::TRUNCATED } else { 0 };
            let own = answer.incomplete[row].as_ref().map_or(one_side, |found| &found.flags);
            flags.iter_mut().zip(own).for_each(|(to, own)| *to = own | edge);
        }
    }
}

/// Numbers at the radii, changed, to both sides of the axis as far as they reach.
#[inline(always)]
fn mirrored(grid: &Grid, values: &[f64], to: &mut [f64], change: impl Fn(f64) -> f64) {
    let ((right, to_right), (left, to_left)) = (grid.right, grid.left);
    let both = to_right.min(to_left);
    to[right..right + to_right].iter_mut().zip(values).for_each(|(to, v)| *to = change(*v));
    // The other half is its mirror image, as far as both reach.
    let (to_the_left, rest) = to.split_at_mut(right);
    let own = usize::from(left == right);
    reverse(&rest[own..both], &mut to_the_left[right - (both - own)..]);
    for i in both..to_left {
        to[left - i] = change(values[i]);
    }
}
