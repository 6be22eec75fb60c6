//! The attenuated transform: what a medium round about an axis emits at every radius, from what is seen of it, with its
//! absorption known.
//!
//! A sight at distance y sees I(y) = ∫ j(r) exp(−∫ α ds') ds, the inner integral from the place to the camera. In rings of
//! constant α and j this is a triangular system, solved outside in: exact for any depth where α is. j/α is the source,
//! for thermal light of one temperature per ring B(T(r)). Noise is not smoothed; it grows inwards, and its variance goes
//! through exactly for the seen light, linearly for α in j/α. That α's error also shifts the attenuation is left out: it
//! changes j by at most the depth times α's relative error.

use super::Inverted;
use super::flag;
use super::fold::{self, Pixels};
use super::grid::Grid;
use super::matrix::Matrix;
use super::operators::radius;
use super::request::{AbelError, Columns, check};
use rayon::prelude::*;

/// Standard deviations that α must be above zero for a source to be told.
const SIGNIFICANT_SIGMAS: f64 = 2.0;

/// Sources at every pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Sources {
    /// j/α in the unit of the seen light, `[rows · columns]`; NaN where it is not known.
    pub source: Vec<f64>,
    /// Its standard deviation; NaN where it is not known.
    pub sigma_source: Vec<f64>,
    /// Bits of [`flag`].
    pub flags: Vec<u32>,
}

/// The sources behind `seen` light about the axis of `inverted`, with pixels of `pixel_m`.
///
/// `seen` has the light that the medium itself sends (no background), in any unit, with σ where it is known. α is taken
/// from `inverted`, whose halves are the same; where it is not above zero by two standard deviations there is no source.
///
/// # Errors
///
/// [`AbelError`] when the images differ in shape or the pixel has no size.
pub fn sources(seen: &Columns<'_>, inverted: &Inverted, pixel_m: f64) -> Result<Sources, AbelError> {
    check(seen)?;
    let Columns { values, sigmas, rows, columns } = *seen;
    if (inverted.rows, inverted.columns) != (rows, columns) {
        let sigmas = sigmas.map_or(0, <[f64]>::len);
        return Err(AbelError::Shape {
            values: values.len(),
            sigmas,
            rows: inverted.rows,
            columns: inverted.columns,
        });
    }
    if !(pixel_m > 0.0 && pixel_m.is_finite()) {
        return Err(AbelError::Setting { name: "the size of a pixel", must: "positive", found: pixel_m });
    }
    let grid = Grid::new(columns, inverted.axis.column);
    let variances: Option<Vec<f64>> =
        sigmas.map(|s| s.iter().map(|s| if *s >= 0.0 { s * s } else { f64::NAN }).collect());
    let found: Vec<Vec<(f64, f64, u32)>> = (0..rows)
        .into_par_iter()
        .map(|row| {
            let at = row * columns..(row + 1) * columns;
            let pixels =
                Pixels { values: &values[at.clone()], variances: variances.as_ref().map(|v| &v[at.clone()]) };
            let alpha: Vec<f64> = inverted.alpha_per_m[at.clone()].iter().map(|a| a * pixel_m).collect();
            let sigma: Vec<f64> = inverted.sigma_alpha[at].iter().map(|s| s * pixel_m).collect();
            one_row(&grid, &pixels, &alpha, &sigma)
        })
        .collect();
    let each = || found.iter().flatten();
    Ok(Sources {
        source: each().map(|one| one.0).collect(),
        sigma_source: each().map(|one| one.1).collect(),
        flags: each().map(|one| one.2).collect(),
    })
}

/// Source, σ and flags at the pixels of a row; α per pixel length.
fn one_row(grid: &Grid, pixels: &Pixels<'_>, alpha: &[f64], sigma_alpha: &[f64]) -> Vec<(f64, f64, u32)> {
    let joined = fold::join(grid, pixels);
    let missing =
        |column: usize| if pixels.known(column) { flag::HIDDEN } else { flag::HIDDEN | flag::NO_INPUT };
    let mut out: Vec<(f64, f64, u32)> =
        (0..grid.columns).map(|column| (f64::NAN, f64::NAN, missing(column))).collect();
    // α at the radii, from the side that has it; outside of what is known there is none.
    let at_radius = |values: &[f64], i: usize| -> f64 {
        let sides = [fold_side(grid, i, true), fold_side(grid, i, false)];
        let known = sides.into_iter().flatten().map(|c| values[c]).find(|v| v.is_finite());
        known.unwrap_or(f64::NAN)
    };
    let alphas: Vec<f64> = (0..grid.n).map(|i| at_radius(alpha, i)).collect();
    // From outside in, as far as both α and the light are known.
    let to = joined.to;
    let from = (joined.from..to).rev().take_while(|&i| alphas[i].is_finite()).last();
    let Some(from) = from else { return out };
    let used: Vec<f64> = alphas[from..to].iter().map(|a| a.max(0.0)).collect();
    let Some(inverse) = seen_of_rings(from, grid.phase, &used).upper_inverse() else { return out };
    let mixes = &joined.mixes[from - joined.from..];
    let light: Vec<f64> =
        mixes.iter().map(|mix| mix.iter().map(|&(c, w)| w * pixels.values[c]).sum()).collect();
    let mut weights = vec![0.0; grid.columns];
    let mut radii = Vec::with_capacity(to - from);
    for (i, &a) in used.iter().enumerate() {
        let row = inverse.row(i);
        let j: f64 = row.iter().zip(&light).map(|(k, light)| k * light).sum();
        weights.fill(0.0);
        for (k, mix) in row.iter().zip(mixes) {
            mix.iter().for_each(|&(column, weight)| weights[column] += k * weight);
        }
        let variance: f64 = match pixels.variances {
            Some(known) => {
                weights.iter().zip(known).filter(|(w, _)| **w != 0.0).map(|(w, v)| w * w * v).sum()
            }
            None => f64::NAN,
        };
        let s = at_radius(sigma_alpha, from + i);
        let source = j / a;
        // Without a known σ of α that it is positive must do.
        let clear = a > if s.is_finite() { SIGNIFICANT_SIGMAS * s } else { 0.0 };
        let spread = if s.is_finite() { s * source } else { 0.0 };
        let sigma = (variance + spread * spread).sqrt() / a;
        radii.push(if clear { (source, sigma) } else { (f64::NAN, f64::NAN) });
    }
    for (column, out) in out.iter_mut().enumerate() {
        let mix = grid.radii(column);
        if mix.iter().all(|(i, _)| (from..to).contains(i)) {
            let value = mix.iter().map(|&(i, w)| w * radii[i - from].0).sum::<f64>();
            // Neighbours are alike: the nearest one's σ is told.
            let nearest = mix.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(from, |m| m.0);
            let flags = mix.iter().fold(out.2 & flag::NO_INPUT, |flags, &(i, _)| flags | joined.flags[i]);
            let hidden = if value.is_nan() { flag::HIDDEN } else { 0 };
            *out = (value, if value.is_nan() { f64::NAN } else { radii[nearest - from].1 }, flags | hidden);
        }
    }
    out
}

/// The pixel nearest to a radius on one side, if there is one.
fn fold_side(grid: &Grid, i: usize, right: bool) -> Option<usize> {
    let at = grid.centre + if right { radius(i, grid.phase) } else { -radius(i, grid.phase) };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the row")]
    let inside = (-0.5..radius(grid.columns, 0.0) - 0.5).contains(&at).then(|| at.round().max(0.0) as usize);
    inside
}

/// What a sight at radius from + i sees of ring from + j that emits 1 per pixel length: both its pieces, each behind what
/// lies between it and the camera. `alpha` per pixel length, ≥ 0.
fn seen_of_rings(from: usize, phase: f64, alpha: &[f64]) -> Matrix {
    let n = alpha.len();
    let mut out = Matrix::zeros(n, n);
    for i in 0..n {
        let y = radius(from + i, phase);
        let leg = |r: f64| ((r - y) * (r + y)).max(0.0).sqrt();
        let piece = |j: usize| {
            let r = radius(from + j, phase);
            leg(r + 0.5) - leg((r - 0.5).max(0.0))
        };
        // Depth from the ring's inner side to the closest point of the sight, and from its outer side to the camera.
        let pieces: Vec<f64> = (i..n).map(piece).collect();
        let mut outer = 0.0;
        let total: f64 = pieces.iter().zip(&alpha[i..]).map(|(l, a)| l * a).sum();
        for j in (i..n).rev() {
            let (length, depth) = (pieces[j - i], pieces[j - i] * alpha[j]);
            // (1 − e^−τ)/τ, 1 for no depth.
            let own = if depth > 0.0 { -(-depth).exp_m1() / depth } else { 1.0 };
            let inner = (total - outer - depth).max(0.0);
            // The near piece is behind the rings outside of it, the far one also behind all inside twice and the near one.
            let far = (-(outer + depth + 2.0 * inner)).exp();
            out.row_mut(i)[j] = length * own * ((-outer).exp() + far);
            outer += depth;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::centre::Axis;
    use super::*;

    /// A thick uniform disc of one source: 1 − exp(−chord·α) of it is seen, and it comes back to rounding, about any axis
    /// on the grid.
    #[test]
    fn thick_uniform_discs_come_back() {
        for (columns, centre) in [(41, 20.0), (40, 19.5)] {
            let edge = radius(columns, 0.0) * 0.5;
            for depth in [1e-6, 0.05, 0.2] {
                let chord = |c: usize| {
                    let y: f64 = radius(c, 0.0) - centre;
                    2.0 * (edge * edge - y * y).max(0.0).sqrt()
                };
                let light: Vec<f64> = (0..columns).map(|c| -7.0 * (-depth * chord(c)).exp_m1()).collect();
                let inverted = Inverted {
                    rows: 1,
                    columns,
                    alpha_per_m: vec![depth / 1e-4; columns],
                    sigma_alpha: vec![0.01 * depth / 1e-4; columns],
                    flags: vec![0; columns],
                    axis: Axis { column: centre, sigma: 0.0, found: false },
                    strength: vec![f64::NAN],
                    discrepancy_failed: 0,
                };
                let sigmas = vec![1e-12 * depth; columns];
                let seen = Columns { values: &light, sigmas: Some(&sigmas), rows: 1, columns };
                let found = sources(&seen, &inverted, 1e-4).unwrap();
                for (source, sigma) in found.source.iter().zip(&found.sigma_source) {
                    // The far rings of eight depths lose a few digits.
                    assert!((source - 7.0).abs() < 1e-9, "{depth} {source}");
                    // α's one per cent, and next to nothing of the light's.
                    assert!((sigma - 0.07).abs() < 1e-3, "{depth} {sigma}");
                }
            }
        }
    }

    /// Light that is missing at the axis hides what is there only; no absorption, no source.
    #[test]
    fn missing_light_and_absorption_have_no_source() {
        let columns = 21;
        let mut light = vec![1.0; columns];
        (7..14).for_each(|c| light[c] = f64::NAN);
        let mut alpha = vec![50.0; columns];
        (alpha[1], alpha[19]) = (1.0, 1.0);
        let inverted = Inverted {
            rows: 1,
            columns,
            alpha_per_m: alpha,
            sigma_alpha: vec![1.0; columns],
            flags: vec![0; columns],
            axis: Axis { column: 10.0, sigma: 0.0, found: false },
            strength: vec![f64::NAN],
            discrepancy_failed: 0,
        };
        let seen = Columns { values: &light, sigmas: None, rows: 1, columns };
        let found = sources(&seen, &inverted, 1e-3).unwrap();
        for c in 0..columns {
            let hidden = (7..14).contains(&c) || c == 1 || c == 19;
            assert_eq!(found.source[c].is_nan(), hidden, "{c}");
            assert_eq!(found.flags[c] & flag::HIDDEN != 0, hidden, "{c}");
        }
        assert!(sources(&seen, &inverted, 0.0).is_err());
        assert!(sources(&Columns { rows: 3, columns: 7, ..seen }, &inverted, 1.0).is_err());
    }
}
