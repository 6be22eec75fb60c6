//! The wavelengths that a choice of samples is judged on, and those it may pick from.

use super::columns::Values;
use super::{Response, SOURCE_K};
use crate::light::planck::photon_radiance;

/// Candidates among the fine grid: in bright parts of the response, and in the others.
const CANDIDATES: [usize; 2] = [240, 48];
/// Response above this part of its maximum is bright.
const BRIGHT: f64 = 1e-3;

/// The fine grid of the response; where it is dim, four steps are taken together.
pub(super) fn training_grid(response: &Response) -> Vec<(f64, f64)> {
    let limit = BRIGHT * response.maximum();
    let mut grid: Vec<(f64, f64)> = Vec::new();
    // Number, Σ w and Σ w λ of the dim steps gathered.
    let mut dim = (0, 0.0, 0.0);
    let flush = |dim: &mut (i32, f64, f64), grid: &mut Vec<(f64, f64)>| {
        if dim.1 > 0.0 {
            grid.push((dim.2 / dim.1, dim.1));
        }
        *dim = (0, 0.0, 0.0);
    };
    for (um, weight) in response.fine_whole().into_iter().filter(|point| point.1 > 0.0) {
        let bright = response.at(um) >= limit;
        // Never across a stretch without response.
        let far = dim.1 > 0.0 && um - dim.2 / dim.1 > 4.5e-3;
        if bright || far || dim.0 == 4 {
            flush(&mut dim, &mut grid);
        }
        if bright {
            grid.push((um, weight));
        } else {
            dim = (dim.0 + 1, dim.1 + weight, dim.2 + weight * um);
        }
    }
    flush(&mut dim, &mut grid);
    grid
}

/// Wavelengths out of the fine grid: at equal shares of the signal and of the spectra's changes, apart for the bright
/// parts of the response and the others.
pub(super) fn candidates(response: &Response, fine: &[(f64, f64)], values: &Values) -> Vec<f64> {
    let limit = BRIGHT * response.maximum();
    let structure = values.structure();
    let mut picked = Vec::new();
    for (bright, count) in [(true, CANDIDATES[0]), (false, CANDIDATES[1])] {
        let places: Vec<usize> =
            (0..fine.len()).filter(|&i| (response.at(fine[i].0) >= limit) == bright).collect();
        let signal = |i: usize| fine[i].1 * photon_radiance(fine[i].0, SOURCE_K);
        let all_signal: f64 = places.iter().map(|&i| signal(i)).sum();
        // A change counts as much as there is light to see it.
        let change = |i: usize| structure.get(i).copied().unwrap_or(0.0) * signal(i);
        let all_change: f64 = places.iter().map(|&i| change(i)).sum();
        let share = |i: usize| {
            let flat = 1.0 / places.len() as f64;
            let lit = if all_signal > 0.0 { signal(i) / all_signal } else { flat };
            let changing = if all_change > 0.0 { change(i) / all_change } else { flat };
            (flat + lit + changing) / 3.0
        };
        let mut gathered = 0.0;
        let mut next = 0.5 / count as f64;
        for &i in &places {
            gathered += share(i);
            if gathered >= next || places.len() <= count {
                picked.push(fine[i].0);
                while next <= gathered {
                    next += 1.0 / count as f64;
                }
            }
        }
    }
    picked.sort_by(f64::total_cmp);
    picked
}
