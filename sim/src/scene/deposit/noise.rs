//! How much of the picture is parcel noise: two random halves of the parcels, doubled, against each other.

use super::super::field::SprayField;

/// Extinction efficiency of large droplets, the limit of Mie theory; only this test uses it.
const EXTINCTION_EFFICIENCY: f64 = 2.0;

/// Columns with less optical depth than this are not looked at: they would dilute the error.
const DEPTH_MIN: f64 = 0.05;

/// Root mean square difference of the transmission of two halves, per view axis x, y, z.
///
/// The noise of a doubled half is √2 that of the whole, so the whole's own noise is half of this difference.
/// Columns are those of the grid: with constant cells all pixels inside one column see the same.
pub(super) fn split_half(field: &SprayField, seed: u64) -> [f64; 3] {
    let area: Vec<f64> = field
        .parcels
        .iter()
        .map(|p| EXTINCTION_EFFICIENCY * std::f64::consts::FRAC_PI_4 * p.diameter_m * p.diameter_m)
        .collect();
    let first_half: Vec<bool> =
        (0..field.parcels.len() as u64).map(|i| mix(seed ^ mix(i)) & 1 == 0).collect();
    let extinction: Vec<[f64; 2]> = (0..field.cells.len())
        .map(|i| {
            let mut halves = [0.0; 2];
            for entry in field.deposit_start[i] as usize..field.deposit_start[i + 1] as usize {
                let parcel = field.deposit_parcel[entry] as usize;
                halves[usize::from(first_half[parcel])] +=
                    f64::from(field.deposit_per_m3[entry]) * area[parcel];
            }
            halves
        })
        .collect();
    std::array::from_fn(|axis| view_error(field, &extinction, axis))
}

fn view_error(field: &SprayField, extinction: &[[f64; 2]], axis: usize) -> f64 {
    let grid = &field.grid;
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let step = grid.cell_m()[axis];
    let mut depth = vec![[0.0; 2]; grid.cells[a] * grid.cells[b]];
    for (&cell, halves) in field.cells.iter().zip(extinction) {
        let at = grid.cell(cell as usize);
        let column = &mut depth[at[a] * grid.cells[b] + at[b]];
        column[0] += step * halves[0];
        column[1] += step * halves[1];
    }
    let mut squares = 0.0;
    let mut count = 0.0;
    for [one, other] in depth {
        if one + other > DEPTH_MIN {
            let difference = (-2.0 * one).exp() - (-2.0 * other).exp();
            squares += difference * difference;
            count += 1.0;
        }
    }
    if count > 0.0 { f64::sqrt(squares / count) } else { 0.0 }
}

/// SplitMix64's finaliser (Steele, Lea, Flood 2014).
fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
