//! What is asked of single pixels beside the map: how one was fitted, what it tells of further shots, its weights.

use super::rows::Walk;
use super::single::{Detail, Pixel, Prospect};
use super::solver::{BANDS_PER_THREAD, Common};
use super::source::Source;
use super::{Estimator, FitInputs};
use crate::estimate::accumulate::Sums;
use crate::estimate::line::{self, Line};
use rayon::prelude::*;

/// How the pixel at `row` and `column` is fitted; None where it has no line.
///
/// Panics when there is no such pixel, which is the caller's mistake.
pub fn detail(sums: &Sums, inputs: &FitInputs<'_>, row: usize, column: usize) -> Option<Detail> {
    assert!(row < sums.rows() && column < sums.columns(), "a pixel of the sums");
    let common = Common::new(Source::Sums(sums), inputs);
    let mut pixel = Pixel::default();
    let mut walk = Walk::<f64>::new(common.source, inputs, &common.used);
    walk.start(row..row + 1, common.pools());
    let at = walk.row()?;
    let residuals = common.residuals.at(row * sums.columns() + column);
    pixel.gather(&at, column, inputs, &common.constants, residuals);
    pixel.detail(inputs.estimator, &common.used)
}

/// What is known of the pixels whose emissivity is above `emissivity_min`, for forecasts: at most `pixels_max` of
/// them, evenly taken, by our own estimator.
pub fn prospects(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    emissivity_min: f64,
    pixels_max: usize,
) -> Vec<Prospect> {
    let inputs = &FitInputs { estimator: Estimator::Default, ..inputs.clone() };
    let common = Common::new(Source::Sums(sums), inputs);
    if sums.columns() == 0 || pixels_max == 0 {
        return Vec::new();
    }
    let mut pixel = Pixel::default();
    let mut found = Vec::new();
    let mut walk = Walk::<f64>::new(common.source, inputs, &common.used);
    walk.start(0..sums.rows(), true);
    while let Some(row) = walk.row() {
        for column in 0..row.columns {
            // A first look by the unweighted line: most pixels see no spray.
            let i = row.row * row.columns + column;
            pixel.gather(&row, column, inputs, &common.constants, common.residuals.at(i));
            if row.alive[column] > 0.0
                && let Some(slope) = pixel.unweighted_slope()
                && -slope > emissivity_min * inputs.gamma_near
            {
                found.push(pixel.prospect(inputs));
            }
        }
    }
    let step = found.len().div_ceil(pixels_max).max(1);
    found.into_iter().step_by(step).flatten().collect()
}

/// Fits other values at other abscissae with the weights that [`super::solve`] gives the measured ones.
///
/// `x` and `y` belong to the levels of `sums` (all of them; a level without an x in `inputs` is left out), `y` is
/// `[level][pixel]`. This is how a simulated world's expected counts are read: same weights, no noise. `None` for a
/// pixel without a line.
pub fn lines_with_same_weights(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    x: &[f64],
    y: &[Vec<f64>],
) -> Vec<Option<Line>> {
    let levels = sums.levels().len();
    assert!(x.len() == levels && y.len() == levels, "one x and one image per level");
    by_pixel(sums, inputs, |used, pixel, i| {
        pixel.weights(inputs.estimator).and_then(|weights| {
            let x: Vec<f64> = pixel.levels.iter().map(|&k| x[used[k]]).collect();
            let y: Vec<f64> = pixel.levels.iter().map(|&k| y[used[k]][i]).collect();
            line::weighted(&x, &y, &weights)
        })
    })
}

/// How much of a level's error in x goes over into a pixel's crossing: dS/dx_k, `[pixel · levels + level]`, adding up to
/// one. NaN for a pixel without a line, 0 for a level that is not there.
pub fn crossing_shares(sums: &Sums, inputs: &FitInputs<'_>) -> Vec<f64> {
    let levels = sums.levels().len();
    let shares = by_pixel(sums, inputs, |used, pixel, _| {
        let mut all = vec![f64::NAN; levels];
        if let Some(shares) = pixel.crossing_shares(inputs.estimator) {
            all.fill(0.0);
            pixel.levels.iter().zip(shares).for_each(|(&k, share)| all[used[k]] = share);
        }
        all
    });
    shares.concat()
}

/// What `of` makes of every pixel, on all threads; it is told which levels have an x, the pixel's own and its place.
fn by_pixel<T: Send>(
    sums: &Sums,
    inputs: &FitInputs<'_>,
    of: impl Fn(&[usize], &mut Pixel, usize) -> T + Sync,
) -> Vec<T> {
    let common = Common::new(Source::Sums(sums), inputs);
    if sums.columns() == 0 {
        return Vec::new();
    }
    let bands = rayon::current_num_threads() * BANDS_PER_THREAD;
    let height = sums.rows().div_ceil(bands).max(1);
    let starts: Vec<usize> = (0..sums.rows()).step_by(height).collect();
    let bands: Vec<Vec<T>> = starts
        .into_par_iter()
        .map(|start| {
            let rows = start..(start + height).min(sums.rows());
            let mut pixel = Pixel::default();
            let mut found = Vec::with_capacity(rows.len() * sums.columns());
            let mut walk = Walk::<f64>::new(common.source, inputs, &common.used);
            walk.start(rows, common.pools());
            while let Some(row) = walk.row() {
                for column in 0..row.columns {
                    let i = row.row * row.columns + column;
                    pixel.gather(&row, column, inputs, &common.constants, common.residuals.at(i));
                    found.push(of(&common.used, &mut pixel, i));
                }
            }
            found
        })
        .collect();
    bands.into_iter().flatten().collect()
}
