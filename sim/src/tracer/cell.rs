//! One cell: emission of a constant or linear source, in forms that survive every optical depth from 5e-324 to infinity.

/// Optical depth below which the weights are summed as series.
const SERIES_BELOW: f64 = 1.0;

/// Terms of the series: 1/21! is below 2e-20.
const TERMS: i32 = 20;

/// 1 − e^−τ, to one rounding.
pub fn absorbed(tau: f64) -> f64 {
    -(-tau).exp_m1()
}

/// Weight of the source at the far side of a cell with a linear source: (1 − e^−τ)/τ − e^−τ, relative error below 1e-14.
pub fn far_weight(tau: f64) -> f64 {
    if tau < SERIES_BELOW {
        // Σ (−1)^(k+1) τ^k k/(k+1)!
        return series(tau, f64::from);
    }
    if tau.is_infinite() { 0.0 } else { absorbed(tau) / tau - (-tau).exp() }
}

/// Weight of the source at the camera's side of a cell with a linear source: 1 − (1 − e^−τ)/τ, relative error below 1e-14.
pub fn near_weight(tau: f64) -> f64 {
    if tau < SERIES_BELOW {
        return series(tau, |_| 1.0);
    }
    1.0 - absorbed(tau) / tau
}

/// Mean depth from which a uniform cell's emission comes, as a fraction of the cell seen from the camera: ½ for thin
/// cells, 1/τ for opaque ones.
pub fn mean_depth_fraction(tau: f64) -> f64 {
    if tau < 1e-30 { 0.5 } else { far_weight(tau) / absorbed(tau) }
}

/// Σ_{k ≥ 1} (−1)^(k+1) τ^k factor(k) / (k+1)!
fn series(tau: f64, factor: impl Fn(i32) -> f64) -> f64 {
    let mut term = 0.5 * tau;
    let mut sum = factor(1) * term;
    for k in 2..=TERMS {
        term *= -tau / f64::from(k + 1);
        sum += factor(k) * term;
    }
    sum
}
