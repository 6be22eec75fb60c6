//! Least squares with answers that are not negative.

use super::matrix::{self, Matrix};

/// An answer that is not negative.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bounded {
    pub(super) values: Vec<f64>,
    /// Those that are free: the others are zero because they would be negative.
    pub(super) free: Vec<usize>,
    /// Whether the conditions of a minimum hold to rounding.
    pub(super) settled: bool,
}

/// Exchanges of whole sets that may fail before single exchanges follow (J. Kim and H. Park, SIAM J. Sci. Comput. 33, 3261
/// (2011), section 3).
const FULL_EXCHANGES: u32 = 3;

/// x ≥ 0 for which xᵀKx/2 − bᵀx is least, K positive definite: block principal pivoting. `start` are the values of a
/// solution nearby: its positive ones begin as free.
pub(super) fn minimum(k: &Matrix, b: &[f64], start: &[f64]) -> Bounded {
    let n = k.rows;
    let mut free: Vec<bool> = start.iter().map(|&x| x > 0.0).collect();
    let (mut fewest, mut patience) = (n + 1, FULL_EXCHANGES);
    let scale = b.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    let mut best = vec![0.0; n];
    // Single exchanges end by themselves (Murty's rule); rounding could make them go round.
    for _ in 0..=4 * n + 20 {
        let Some((values, slopes)) = answer(k, b, &free) else { break };
        // Wrong are free values below zero, and bound ones that would better be positive.
        let tolerance = 1e-12 * scale;
        let wrong: Vec<usize> =
            (0..n).filter(|&i| if free[i] { values[i] < 0.0 } else { slopes[i] < -tolerance }).collect();
        best = values;
        if wrong.is_empty() {
            return Bounded { values: best, free: (0..n).filter(|&i| free[i]).collect(), settled: true };
        }
        if wrong.len() < fewest {
            (fewest, patience) = (wrong.len(), FULL_EXCHANGES);
        } else {
            patience = patience.saturating_sub(1);
        }
        if patience > 0 {
            wrong.iter().for_each(|&i| free[i] = !free[i]);
        } else if let Some(&last) = wrong.last() {
            free[last] = !free[last];
        }
    }
    best.iter_mut().for_each(|v| *v = v.max(0.0));
    let free = (0..n).filter(|&i| best[i] > 0.0).collect();
    Bounded { values: best, free, settled: false }
}

/// The minimum over the free values, the others zero, and the slopes K x − b.
fn answer(k: &Matrix, b: &[f64], free: &[bool]) -> Option<(Vec<f64>, Vec<f64>)> {
    let n = k.rows;
    let at: Vec<usize> = (0..n).filter(|&i| free[i]).collect();
    let mut values = vec![0.0; n];
    if !at.is_empty() {
        let part = Matrix::from_fn(at.len(), at.len(), |i, j| k.at(at[i], at[j]));
        let right = Matrix::from_fn(at.len(), 1, |i, _| b[at[i]]);
        let found = matrix::solve_positive(&part, &right)?;
        at.iter().zip(&found.values).for_each(|(&i, &value)| values[i] = value);
    }
    let slopes =
        (0..n).map(|i| k.row(i).iter().zip(&values).map(|(k, x)| k * x).sum::<f64>() - b[i]).collect();
    Some((values, slopes))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the minimum free values have no slope, and bound ones a rising one, whatever it starts from.
    #[test]
    fn conditions_of_a_minimum_hold() {
        for seed in 0..20_usize {
            let n = 3 + 2 * seed;
            #[expect(clippy::cast_precision_loss, reason = "small numbers")]
            let a = Matrix::from_fn(n + 2, n, |i, j| ((i * 31 + j * 17 + seed * 7) % 41) as f64 / 20.0 - 1.0);
            let mut k = a.transposed().times(&a);
            (0..n).for_each(|i| k.row_mut(i)[i] += 0.1);
            #[expect(clippy::cast_precision_loss, reason = "small numbers")]
            let b: Vec<f64> = (0..n).map(|i| ((i * 13 + seed) % 11) as f64 - 5.0).collect();
            for start in [vec![0.0; n], vec![1.0; n]] {
                let found = minimum(&k, &b, &start);
                assert!(found.settled);
                for (i, b) in b.iter().enumerate() {
                    let slope = k.row(i).iter().zip(&found.values).map(|(k, x)| k * x).sum::<f64>() - b;
                    if found.free.contains(&i) {
                        assert!(found.values[i] >= 0.0 && slope.abs() < 1e-9, "{seed} {i} {slope}");
                    } else {
                        assert!(
                            found.values[i].abs() < f64::MIN_POSITIVE && slope > -1e-9,
                            "{seed} {i} {slope}"
                        );
                    }
                }
            }
        }
        assert!(minimum(&Matrix::zeros(0, 0), &[], &[]).settled);
    }
}
