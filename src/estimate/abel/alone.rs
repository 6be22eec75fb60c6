//! Operators of rows that go alone, for the radii that are known and, if asked for, for weights of the row's own.

use super::elements;
use super::filtered::{self, Shells, cosines_seen, orthogonal, roughness};
use super::inverter::{Inverter, Kernel};
use super::matrix::{self, Matrix};
use super::request::Method;
use std::sync::OnceLock;

/// Shells of BASEX this far inside the first known radius reach beyond it.
const SHELL_REACH: usize = 3;

/// Least strength of BASEX where shells outnumber columns, relative to the mean square of a shell.
const SHELL_STRENGTH_MIN: f64 = 1e-10;

/// Operators are alike for rows of the same known radii and choice.
pub(super) type Key = (usize, usize, usize);

/// What the operators of all rows share, formed when it is first asked for.
pub(super) struct Alone<'a> {
    inverter: &'a Inverter,
    shells: OnceLock<Shells>,
    columns: OnceLock<Matrix>,
}

impl<'a> Alone<'a> {
    pub(super) fn new(inverter: &'a Inverter) -> Self {
        Self { inverter, shells: OnceLock::new(), columns: OnceLock::new() }
    }

    /// The operator on the radii `from` ‥ `to` alone: nothing is beyond, nothing is asked of what is inside. None where there
    /// is no radius or no answer. With `roots` of weights, one a known radius, columns count by them.
    pub(super) fn operator(&self, key: Key, roots: Option<&[f64]>) -> Option<Matrix> {
        let inverter = self.inverter;
        let (from, to, choice) = key;
        let (n, phase) = (inverter.grid.n, inverter.grid.phase);
        if from >= to {
            return None;
        }
        let trimmed =
            |matrix: &Matrix| Matrix::from_fn(to - from, to - from, |i, j| matrix.at(from + i, from + j));
        match &inverter.kernel {
            Kernel::Fixed(fixed, Some(reach)) => {
                let reach = *reach;
                let mut out = trimmed(&fixed.matrix);
                // The column just inside is not known: the parabola through the first three goes on.
                for i in 0..out.rows.min(reach) {
                    for lost in from.saturating_sub(reach)..from {
                        let weight = fixed.matrix.at(from + i, lost);
                        #[expect(clippy::cast_precision_loss, reason = "one or two radii")]
                        let t = -((from - lost) as f64);
                        let parabola = match out.columns {
                            1 => vec![1.0],
                            2 => vec![1.0 - t, t],
                            _ => vec![0.5 * (t - 1.0) * (t - 2.0), t * (2.0 - t), 0.5 * t * (t - 1.0)],
                        };
                        out.row_mut(i).iter_mut().zip(&parabola).for_each(|(d, share)| *d += weight * share);
                    }
                }
                Some(out)
            }
            kernel if from == 0 && to == n && roots.is_none() => Some(kernel.operator(choice).matrix.clone()),
            _ => {
                let strength = inverter.strength(choice);
                match inverter.settings.method {
                    Method::Basex => {
                        let shells = self.shells.get_or_init(|| filtered::shells(n, phase));
                        let first = from.saturating_sub(SHELL_REACH);
                        let part = |m: &Matrix| {
                            Matrix::from_fn(to - from, to - first, |i, k| m.at(from + i, first + k))
                        };
                        let (mut seen, own) = (part(&shells.seen), part(&shells.own));
                        scale_rows(&mut seen, roots);
                        let mut normal = seen.transposed().times(&seen);
                        #[expect(clippy::cast_precision_loss, reason = "numbers of radii")]
                        let mean =
                            (0..normal.rows).map(|k| normal.at(k, k)).sum::<f64>() / normal.rows as f64;
                        let least = strength.max(SHELL_STRENGTH_MIN * mean);
                        (0..normal.rows).for_each(|k| normal.row_mut(k)[k] += least);
                        let mut out = own.times(&matrix::solve_positive(&normal, &seen.transposed())?);
                        scale_columns(&mut out, roots);
                        // The disc that the whole row is corrected with, as far as it is known here.
                        let (disc, chords) = filtered::soft_disc(to, phase);
                        for i in 0..out.rows {
                            let made: f64 = out.row(i).iter().zip(&chords[from..]).map(|(d, p)| d * p).sum();
                            let factor = filtered::correction(made, disc[from + i]);
                            out.row_mut(i).iter_mut().for_each(|d| *d *= factor);
                        }
                        Some(out)
                    }
                    Method::Fourier => {
                        #[expect(
                            clippy::cast_possible_truncation,
                            clippy::cast_sign_loss,
                            reason = "a number of cosines"
                        )]
                        let cosines = (strength.max(0.0) as usize).min((to - from) / 2);
                        let (seen, own) = cosines_seen(n, phase, cosines);
                        let cut =
                            |m: &Matrix| Matrix::from_fn(to - from, cosines + 1, |i, k| m.at(from + i, k));
                        let mut seen = cut(&seen);
                        scale_rows(&mut seen, roots);
                        let both = orthogonal(&seen, &cut(&own), 0);
                        let mut out = both.meaning.times(&both.basis.transposed());
                        scale_columns(&mut out, roots);
                        Some(out)
                    }
                    _ => {
                        let Quadratic { a, quadratic, .. } = self.quadratic(key, roots);
                        let mut out = matrix::solve_positive(&quadratic, &a.transposed())?;
                        scale_columns(&mut out, roots);
                        Some(out)
                    }
                }
            }
        }
    }

    /// What is least for some radii and a choice. With `roots` of weights both A and p are multiplied by them.
    pub(super) fn quadratic(&self, key: Key, roots: Option<&[f64]>) -> Quadratic {
        let (from, to, choice) = key;
        let (grid, settings) = (&self.inverter.grid, &self.inverter.settings);
        let whole = self.columns.get_or_init(|| elements::columns(settings.elements, grid.n, grid.phase));
        let mut a = elements::part(whole, from, to);
        scale_rows(&mut a, roots);
        let mut quadratic = a.transposed().times(&a);
        let (strength, rough) = (self.inverter.strength(choice), roughness(to - from));
        quadratic.values.iter_mut().zip(&rough.values).for_each(|(v, rough)| *v += strength * rough);
        Quadratic { a, quadratic }
    }
}

/// Row i by `roots[i]`.
fn scale_rows(matrix: &mut Matrix, roots: Option<&[f64]>) {
    for (i, root) in roots.into_iter().flatten().enumerate() {
        matrix.row_mut(i).iter_mut().for_each(|value| *value *= root);
    }
}

/// Column j by `roots[j]`.
fn scale_columns(matrix: &mut Matrix, roots: Option<&[f64]>) {
    let Some(roots) = roots else { return };
    for i in 0..matrix.rows {
        matrix.row_mut(i).iter_mut().zip(roots).for_each(|(value, root)| *value *= root);
    }
}

/// |A f − p|² + λ |L f|² on the radii `from` ‥ `to`.
pub(super) struct Quadratic {
    /// A.
    pub(super) a: Matrix,
    /// AᵀA + λ LᵀL.
    pub(super) quadratic: Matrix,
}
