//! Small dense linear algebra of the Abel transforms: what a matrix of one row per radius needs, and no more.
//!
//! All sums run in one order, without fused operations: the same bits on any machine of one architecture and for any
//! number of threads.

use super::product::{Packed, Rows, multiply};

/// A dense matrix, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Matrix {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) values: Vec<f64>,
}

impl Matrix {
    pub(super) fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: vec![0.0; rows * columns] }
    }

    pub(super) fn from_fn(rows: usize, columns: usize, mut f: impl FnMut(usize, usize) -> f64) -> Self {
        let mut out = Self::zeros(rows, columns);
        for i in 0..rows {
            for j in 0..columns {
                out.values[i * columns + j] = f(i, j);
            }
        }
        out
    }

    pub(super) fn at(&self, row: usize, column: usize) -> f64 {
        self.values[row * self.columns + column]
    }

    pub(super) fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.columns..(row + 1) * self.columns]
    }

    pub(super) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.values[row * self.columns..(row + 1) * self.columns]
    }

    pub(super) fn transposed(&self) -> Self {
        Self::from_fn(self.columns, self.rows, |i, j| self.at(j, i))
    }

    /// self · other.
    pub(super) fn times(&self, other: &Self) -> Self {
        assert!(self.columns == other.rows, "as many columns as the other has rows");
        let mut out = Self::zeros(self.rows, other.columns);
        let order: Vec<usize> = (0..self.rows).collect();
        let left = Rows { values: &self.values, stride: self.columns, order: &order, depth: self.columns };
        multiply(&left, &Packed::new(other, None), &mut out.values);
        out
    }

    /// Inverse of an upper triangular matrix; None if it has none in f64.
    pub(super) fn upper_inverse(&self) -> Option<Self> {
        let n = self.rows;
        let mut out = Self::zeros(n, n);
        for i in (0..n).rev() {
            let pivot = self.at(i, i);
            let mut row = vec![0.0; n];
            row[i] = 1.0;
            for k in i + 1..n {
                let factor = self.at(i, k);
                if factor != 0.0 {
                    row[k..].iter_mut().zip(&out.row(k)[k..]).for_each(|(a, b)| *a -= factor * b);
                }
            }
            row[i..].iter_mut().for_each(|a| *a /= pivot);
            if !row.iter().all(|a| a.is_finite()) {
                return None;
            }
            out.row_mut(i).copy_from_slice(&row);
        }
        Some(out)
    }
}

/// Solves S·X = B for a symmetric positive definite S by Cholesky's method; None if it is not.
pub(super) fn solve_positive(s: &Matrix, b: &Matrix) -> Option<Matrix> {
    let (n, m) = (s.rows, b.columns);
    // S = UᵀU, row by row, so that the inner loops run along rows.
    let mut u = s.clone();
    for k in 0..n {
        let (done, below) = u.values.split_at_mut((k + 1) * n);
        let row = &mut done[k * n..];
        // What rounding leaves of a matrix that is not definite: its answer would be noise.
        if row[k].is_nan() || row[k] <= 1e-14 * s.at(k, k).abs() {
            return None;
        }
        let pivot = row[k].sqrt();
        row[k..].iter_mut().for_each(|v| *v /= pivot);
        for (i, below) in below.chunks_mut(n).enumerate() {
            let from = k + 1 + i;
            let factor = row[from];
            below[from..].iter_mut().zip(&row[from..]).for_each(|(v, u)| *v -= factor * u);
        }
    }
    let mut x = b.clone();
    for k in 0..n {
        let (done, below) = x.values.split_at_mut((k + 1) * m);
        let row = &mut done[k * m..];
        row.iter_mut().for_each(|v| *v /= u.at(k, k));
        for (i, below) in below.chunks_mut(m).enumerate() {
            let factor = u.at(k, k + 1 + i);
            below.iter_mut().zip(&*row).for_each(|(v, x)| *v -= factor * x);
        }
    }
    for k in (0..n).rev() {
        let (above, row) = x.values.split_at_mut(k * m);
        let row = &mut row[..m];
        row.iter_mut().for_each(|v| *v /= u.at(k, k));
        for (i, above) in above.chunks_mut(m).enumerate() {
            let factor = u.at(i, k);
            above.iter_mut().zip(&*row).for_each(|(v, x)| *v -= factor * x);
        }
    }
    Some(x)
}

/// Eigenvalues of a symmetric matrix, ascending, and eigenvectors as columns: Householder's reduction to three diagonals
/// and implicit QL (H. Bowdler et al., Numer. Math. 11, 293 (1968), after J. Wilkinson and C. Reinsch). None if the
/// iteration does not end.
pub(super) fn eigen(symmetric: &Matrix) -> Option<(Vec<f64>, Matrix)> {
    let n = symmetric.rows;
    let mut z = symmetric.clone();
    if n == 0 {
        return Some((Vec::new(), Matrix::zeros(0, 0)));
    }
    let (mut d, mut e) = (vec![0.0; n], vec![0.0; n]);
    three_diagonals(&mut z, &mut d, &mut e);
    // Rotations act on columns of z: as rows of the transpose they are contiguous.
    let mut z = z.transposed();
    e.rotate_left(1);
    if let Some(last) = e.last_mut() {
        *last = 0.0;
    }
    for l in 0..n {
        let mut rounds = 0;
        loop {
            let m = (l..n.saturating_sub(1))
                .find(|&m| e[m].abs() <= f64::EPSILON * (d[m].abs() + d[m + 1].abs()))
                .unwrap_or(n - 1);
            if m == l {
                break;
            }
            rounds += 1;
            if rounds > QL_ROUNDS_MAX {
                return None;
            }
            let mut g = (d[l + 1] - d[l]) / (2.0 * e[l]);
            let mut r = g.hypot(1.0);
            g = d[m] - d[l] + e[l] / (g + r.copysign(g));
            let (mut s, mut c, mut p) = (1.0, 1.0, 0.0);
            let mut early = false;
            for i in (l..m).rev() {
                let (mut f, b) = (s * e[i], c * e[i]);
                r = f.hypot(g);
                e[i + 1] = r;
                if r.abs() < f64::MIN_POSITIVE {
                    d[i + 1] -= p;
                    e[m] = 0.0;
                    early = true;
                    break;
                }
                (s, c) = (f / r, g / r);
                g = d[i + 1] - p;
                r = (d[i] - g) * s + 2.0 * c * b;
                p = s * r;
                d[i + 1] = g + p;
                g = c * r - b;
                let (low, high) = z.values.split_at_mut((i + 1) * n);
                for (low, high) in low[i * n..].iter_mut().zip(&mut high[..n]) {
                    f = *high;
                    *high = s * *low + c * f;
                    *low = c * *low - s * f;
                }
            }
            if early {
                continue;
            }
            d[l] -= p;
            e[l] = g;
            e[m] = 0.0;
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| d[a].total_cmp(&d[b]));
    let values = order.iter().map(|&k| d[k]).collect();
    let vectors = Matrix::from_fn(n, n, |i, k| z.at(order[k], i));
    Some((values, vectors))
}

/// Rounds of QL for one eigenvalue: two to three are usual.
const QL_ROUNDS_MAX: u32 = 60;

/// Householder's reduction (tred2): z becomes the orthogonal matrix, d the diagonal, e[1..] what is beside it.
fn three_diagonals(z: &mut Matrix, d: &mut [f64], e: &mut [f64]) {
    let n = z.rows;
    for i in (1..n).rev() {
        let mut h = 0.0;
        let scale: f64 = z.row(i)[..i].iter().map(|v| v.abs()).sum();
        if i == 1 || scale < f64::MIN_POSITIVE {
            e[i] = z.at(i, i - 1);
            d[i] = h;
            continue;
        }
        for v in &mut z.row_mut(i)[..i] {
            *v /= scale;
            h += *v * *v;
        }
        let f = z.at(i, i - 1);
        let g = -h.sqrt().copysign(f);
        e[i] = scale * g;
        h -= f * g;
        z.row_mut(i)[i - 1] = f - g;
        let (low, high) = z.values.split_at_mut(i * n);
        let u = &high[..i];
        // p = A u / h, from the lower triangle.
        let mut p = vec![0.0; i];
        for j in 0..i {
            let row = &low[j * n..j * n + j + 1];
            let (mut own, other) = (row[j] * u[j], u[j]);
            for k in 0..j {
                own += row[k] * u[k];
                p[k] += row[k] * other;
            }
            p[j] += own;
        }
        let mut both = 0.0;
        for j in 0..i {
            p[j] /= h;
            both += p[j] * u[j];
        }
        let half = both / (2.0 * h);
        p.iter_mut().zip(u).for_each(|(p, u)| *p -= half * u);
        for (j, (&f, &g)) in u.iter().zip(&p).enumerate() {
            let row = &mut low[j * n..j * n + j + 1];
            row.iter_mut().zip(p.iter().zip(u)).for_each(|(v, (p, u))| *v -= f * p + g * u);
        }
        for j in 0..i {
            z.values[j * n + i] = z.values[i * n + j] / h;
        }
        d[i] = h;
    }
    if n > 0 {
        (d[0], e[0]) = (0.0, 0.0);
    }
    for (i, d) in d.iter_mut().enumerate() {
        if *d != 0.0 {
            // Columns before i, changed by u = row i and u/h = column i.
            let mut g = vec![0.0; i];
            for k in 0..i {
                let factor = z.at(i, k);
                g.iter_mut().zip(&z.row(k)[..i]).for_each(|(g, v)| *g += factor * v);
            }
            for k in 0..i {
                let factor = z.at(k, i);
                z.row_mut(k)[..i].iter_mut().zip(&g).for_each(|(v, g)| *v -= g * factor);
            }
        }
        *d = z.at(i, i);
        z.row_mut(i)[i] = 1.0;
        for j in 0..i {
            z.values[j * n + i] = 0.0;
            z.values[i * n + j] = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A full matrix without structure.
    fn rough(rows: usize, columns: usize) -> Matrix {
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        Matrix::from_fn(rows, columns, |i, j| ((i * 37 + j * 101 + 7) % 64) as f64 / 64.0 - 0.4)
    }

    fn plain(a: &Matrix, b: &Matrix) -> Matrix {
        Matrix::from_fn(a.rows, b.columns, |i, j| (0..a.columns).map(|k| a.at(i, k) * b.at(k, j)).sum())
    }

    /// V diag(d) Vᵀ is the matrix, and V is orthogonal, to rounding.
    #[test]
    fn eigenvectors_make_up_the_matrix() {
        for n in [1, 2, 3, 10, 57] {
            let a = rough(n, n);
            let s = Matrix::from_fn(n, n, |i, j| a.at(i, j) + a.at(j, i));
            let (d, v) = eigen(&s).unwrap();
            assert!(d.windows(2).all(|pair| pair[0] <= pair[1]));
            let scaled = Matrix::from_fn(n, n, |i, k| v.at(i, k) * d[k]);
            let back = plain(&scaled, &v.transposed());
            let unit = plain(&v.transposed(), &v);
            let bound = 1e-14 * n as f64;
            for i in 0..n {
                for j in 0..n {
                    assert!((back.at(i, j) - s.at(i, j)).abs() < bound * 4.0, "{n} {i} {j}");
                    assert!((unit.at(i, j) - f64::from(u8::from(i == j))).abs() < bound);
                }
            }
        }
        let zero = eigen(&Matrix::zeros(4, 4)).unwrap();
        assert!(zero.0.iter().all(|d| d.abs() < f64::MIN_POSITIVE));
        assert!(eigen(&Matrix::zeros(0, 0)).is_some());
    }

    #[test]
    fn solutions_solve() {
        let a = rough(12, 12);
        let s = plain(&a.transposed(), &a);
        let s = Matrix::from_fn(12, 12, |i, j| s.at(i, j) + f64::from(u8::from(i == j)));
        let b = rough(12, 3);
        let x = solve_positive(&s, &b).unwrap();
        for (got, want) in plain(&s, &x).values.iter().zip(&b.values) {
            assert!((got - want).abs() < 1e-13);
        }
        assert_eq!(solve_positive(&Matrix::zeros(2, 2), &Matrix::zeros(2, 1)), None);
        let upper = Matrix::from_fn(9, 9, |i, j| if j < i { 0.0 } else { a.at(i, j) + 2.0 });
        let unit = plain(&upper, &upper.upper_inverse().unwrap());
        for (i, value) in unit.values.iter().enumerate() {
            assert!((value - f64::from(u8::from(i % 10 == 0))).abs() < 1e-12);
        }
    }
}
