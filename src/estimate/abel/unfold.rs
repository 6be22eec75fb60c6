//! From radii back to pixels: both halves, their standard deviations and flags.

use super::answer::Answer;
use super::inverter::Inverter;
use super::request::Columns;
use super::rows::{Work, resize};
use super::{Inverted, flag};
use rayon::prelude::*;

impl Inverter {
    /// From radii to pixels.
    pub(super) fn unfold(&self, image: &Columns<'_>, work: &Work<'_>, answer: &Answer, out: &mut Inverted) {
        let grid = &self.grid;
        let (rows, columns, n) = (image.rows, image.columns, grid.n);
        let scale = work.scale / self.settings.pixel_m;
        (out.rows, out.columns, out.axis) = (rows, columns, self.axis);
        resize(&mut out.alpha_per_m, rows * columns);
        resize(&mut out.sigma_alpha, rows * columns);
        out.flags.resize(rows * columns, 0);
        out.strength.clone_from(&answer.strength);
        out.discrepancy_failed = answer.discrepancy_failed;
        let ((right, to_right), (left, to_left)) = (grid.right, grid.left);
        let both = to_right.min(to_left);
        let one_side = |column: usize| {
            // Rounding is for axes between the radii, whose rows all go alone.
            let i = grid.radii(column)[0].0;
            if i < both { 0 } else { flag::ONE_SIDE }
        };
        let one_side: Vec<u32> = (0..columns).map(one_side).collect();
        out.alpha_per_m
            .par_chunks_mut(columns)
            .zip(out.sigma_alpha.par_chunks_mut(columns))
            .zip(out.flags.par_chunks_mut(columns))
            .enumerate()
            .for_each(|(row, ((alpha, sigma), flags))| {
                let edge = if work.truncated[row] { flag::TRUNCATED } else { 0 };
                if let Some(found) = &answer.incomplete[row] {
                    for column in 0..columns {
                        alpha[column] = found.values[column] * scale;
                        sigma[column] = found.variances[column].sqrt() * scale;
                        flags[column] = found.flags[column] | edge;
                    }
                    return;
                }
                let at = row * n..(row + 1) * n;
                for (values, to, unit) in
                    [(&answer.values[at.clone()], alpha, false), (&answer.variances[at], sigma, true)]
                {
                    let half = to[right..right + to_right].iter_mut().zip(values);
                    if unit {
                        half.for_each(|(to, v)| *to = v.sqrt() * scale);
                    } else {
                        half.for_each(|(to, v)| *to = v * scale);
                    }
                    // The other half is its mirror image, as far as both reach.
                    let (to_the_left, rest) = to.split_at_mut(right);
                    let own = usize::from(left == right);
                    let mirrored = to_the_left.iter_mut().rev().zip(&rest[own..]);
                    mirrored.take(both - own).for_each(|(to, v)| *to = *v);
                    for i in both..to_left {
                        to[left - i] = if unit { values[i].sqrt() * scale } else { values[i] * scale };
                    }
                }
                flags.iter_mut().zip(&one_side).for_each(|(flags, one_side)| *flags = one_side | edge);
            });
    }
}
