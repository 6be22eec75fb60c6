//! Least squares of few columns by orthogonal rows: no normal equations, so that nearly dependent columns keep their
//! digits.

pub(super) fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(super) fn column_norms(rows: &[[f64; 4]]) -> [f64; 4] {
    std::array::from_fn(|j| {
        let norm = rows.iter().map(|row| row[j] * row[j]).sum::<f64>().sqrt();
        if norm > 0.0 { norm } else { 1.0 }
    })
}

/// Least-squares step of the rows extended by √damping · column norm.
pub(super) fn damped_step(rows: &[[f64; 4]], residuals: &[f64], damping: f64) -> [f64; 4] {
    let norms = column_norms(rows);
    let mut all: Vec<[f64; 4]> = rows.iter().map(|row| std::array::from_fn(|j| row[j] / norms[j])).collect();
    let mut right = residuals.to_vec();
    for j in 0..4 {
        let mut row = [0.0; 4];
        row[j] = damping.sqrt();
        all.push(row);
        right.push(0.0);
    }
    let scaled = solve(all, right).1;
    std::array::from_fn(|j| scaled[j] / norms[j])
}

/// Modified Gram–Schmidt on the augmented matrix: returns R and the solution. A column without content gives zero.
pub(super) fn solve(mut rows: Vec<[f64; 4]>, mut right: Vec<f64>) -> ([[f64; 4]; 4], [f64; 4]) {
    let mut r = [[0.0; 4]; 4];
    let mut z = [0.0; 4];
    for j in 0..4 {
        let norm = rows.iter().map(|row| row[j] * row[j]).sum::<f64>().sqrt();
        r[j][j] = norm;
        if norm <= 1e-150 {
            continue;
        }
        rows.iter_mut().for_each(|row| row[j] /= norm);
        for k in j + 1..4 {
            let projection: f64 = rows.iter().map(|row| row[j] * row[k]).sum();
            r[j][k] = projection;
            rows.iter_mut().for_each(|row| row[k] -= projection * row[j]);
        }
        let projection: f64 = rows.iter().zip(&right).map(|(row, right)| row[j] * right).sum();
        z[j] = projection;
        rows.iter().zip(&mut right).for_each(|(row, right)| *right -= projection * row[j]);
    }
    let mut x = [0.0; 4];
    for j in (0..4).rev() {
        let above: f64 = (j + 1..4).map(|k| r[j][k] * x[k]).sum();
        x[j] = if r[j][j] > 1e-150 { (z[j] - above) / r[j][j] } else { 0.0 };
    }
    (r, x)
}

/// Inverse of an upper triangle; rows of absent parameters are zero.
pub(super) fn upper_inverse(r: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
    // By columns: column c solves R·z = e_c from below.
    let columns: [[f64; 4]; 4] = std::array::from_fn(|column| {
        let mut z = [0.0; 4];
        for i in (0..=column).rev() {
            let unit = if i == column { 1.0 } else { 0.0 };
            let above: f64 = (i + 1..=column).map(|k| r[i][k] * z[k]).sum();
            z[i] = if r[i][i] > 1e-12 { (unit - above) / r[i][i] } else { 0.0 };
        }
        z
    });
    std::array::from_fn(|row| columns.map(|column| column[row]))
}
