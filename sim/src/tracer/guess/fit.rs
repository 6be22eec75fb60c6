//! Least squares of path scores on the ψ of a family of functions.

use super::Tally;

/// What is added to the diagonal of the normalised matrix against rounding.
const RIDGE: f64 = 1e-11;

/// Ratio of the variance left of a path to that of a coefficient, before it is known: functions that hardly any path has
/// met get small coefficients.
const FIRST_RATIO: f64 = 1e-2;

/// Fits of one score, each with the ratio that the one before has left.
const ROUNDS: usize = 3;

/// Sums over the paths of one ray.
#[derive(Debug, Clone)]
pub(in crate::tracer) struct Moments {
    functions: usize,
    scores: usize,
    /// Number of paths with an unknown mean.
    paths: f64,
    /// Number of all paths.
    all: f64,
    /// Σψ_i ψ_j, lower triangle by rows.
    squares: Vec<f64>,
    /// Σψ_i y, `[function][score]`.
    products: Vec<f64>,
    features: Vec<f64>,
    values: Vec<f64>,
    /// Σy², as it is, and of the differences from the means.
    powers: Vec<f64>,
    scatter: Vec<f64>,
}

impl Moments {
    pub(in crate::tracer) fn new(functions: usize, scores: usize) -> Self {
        Self {
            functions,
            scores,
            paths: 0.0,
            all: 0.0,
            squares: vec![0.0; functions * (functions + 1) / 2],
            products: vec![0.0; functions * scores],
            features: vec![0.0; functions],
            values: vec![0.0; scores],
            powers: vec![0.0; scores],
            scatter: vec![0.0; scores],
        }
    }

    /// Adds a path of which score + Σ c ψ should always be the same.
    pub(in crate::tracer) fn add(&mut self, path: &Tally) {
        self.add_null(path);
        self.paths += 1.0;
        super::add(&mut self.features, 1.0, &path.features);
        super::add(&mut self.values, 1.0, &path.scores);
    }

    /// Adds a path of which score + Σ c ψ should be zero.
    pub(in crate::tracer) fn add_null(&mut self, path: &Tally) {
        self.all += 1.0;
        for ((power, scatter), y) in self.powers.iter_mut().zip(&mut self.scatter).zip(&path.scores) {
            *power += y * y;
            *scatter += y * y;
        }
        for (i, &feature) in path.features.iter().enumerate() {
            if feature == 0.0 {
                continue;
            }
            super::add(&mut self.squares[i * (i + 1) / 2..][..=i], feature, &path.features[..=i]);
            super::add(&mut self.products[i * self.scores..][..self.scores], feature, &path.scores);
        }
    }

    /// Adds the paths of another ray; each ray keeps its own means.
    pub(in crate::tracer) fn merge(&mut self, mut other: Self) {
        let means: Vec<f64> = other.features.iter().map(|f| f / other.paths.max(1.0)).collect();
        for i in 0..self.functions {
            let sum = other.features[i];
            super::add(&mut other.squares[i * (i + 1) / 2..][..=i], -sum, &means[..=i]);
            super::add(&mut other.products[i * self.scores..][..self.scores], -means[i], &other.values);
        }
        for (scatter, value) in other.scatter.iter_mut().zip(&other.values) {
            *scatter -= value * value / other.paths.max(1.0);
        }
        super::add(&mut self.powers, 1.0, &other.powers);
        super::add(&mut self.scatter, 1.0, &other.scatter);
        self.all += other.all;
        super::add(&mut self.squares, 1.0, &other.squares);
        super::add(&mut self.products, 1.0, &other.products);
    }
}

/// The coefficients `[function][score]` that take most variance out of score + Σ c ψ; zero for functions that no path
/// has met, none where there is nothing to fit.
pub(in crate::tracer) fn solve(moments: &Moments) -> Option<Vec<f64>> {
    let Moments { functions, scores, squares, products, .. } = moments;
    let diagonal = |i: usize| squares[i * (i + 1) / 2 + i];
    let largest = (0..*functions).map(diagonal).fold(0.0, f64::max);
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let met: Vec<usize> = (0..*functions).filter(|&i| diagonal(i) > 1e-20 * largest).collect();
    let mut coefficients = vec![0.0; functions * scores];
    for score in 0..*scores {
        let power = moments.powers[score] / moments.all;
        if power <= 0.0 {
            continue;
        }
        let wanted: Vec<f64> = met.iter().map(|&i| -products[i * scores + score]).collect();
        let mut ratio = FIRST_RATIO;
        let mut own = Vec::new();
        for _ in 0..ROUNDS {
            own = regularised(squares, &met, &wanted, ratio);
            // (1/n) Σ (y + c ψ)² of the solution, from the normal equations.
            let left = moments.scatter[score]
                - own.iter().zip(&wanted).map(|(c, w)| c * w).sum::<f64>()
                - ratio * own.iter().map(|c| c * c).sum::<f64>();
            ratio = (left / moments.all / power).clamp(RIDGE, 1.0);
        }
        for (&i, c) in met.iter().zip(&own) {
            coefficients[i * scores + score] = *c;
        }
    }
    coefficients.iter().all(|c| c.is_finite()).then_some(coefficients)
}

/// (G + ratio) c = wanted for the rows and columns `met` of the packed triangle G, by Cholesky's decomposition.
fn regularised(squares: &[f64], met: &[usize], wanted: &[f64], ratio: f64) -> Vec<f64> {
    let n = met.len();
    let scale: Vec<f64> = met.iter().map(|&i| 1.0 / (squares[i * (i + 1) / 2 + i] + ratio).sqrt()).collect();
    let mut matrix = vec![0.0; n * (n + 1) / 2];
    for i in 0..n {
        let (before, row) = matrix.split_at_mut(i * (i + 1) / 2);
        let from = &squares[met[i] * (met[i] + 1) / 2..];
        for j in 0..i {
            let above = &before[j * (j + 1) / 2..][..=j];
            row[j] = (from[met[j]] * scale[i] * scale[j] - dot(&row[..j], &above[..j])) / above[j];
        }
        row[i] = (1.0 + RIDGE - dot(&row[..i], &row[..i])).max(RIDGE * RIDGE).sqrt();
    }
    let row = |i: usize| &matrix[i * (i + 1) / 2..][..=i];
    let mut x: Vec<f64> = wanted.iter().zip(&scale).map(|(w, s)| w * s).collect();
    for i in 0..n {
        x[i] = (x[i] - dot(&row(i)[..i], &x[..i])) / row(i)[i];
    }
    for i in (0..n).rev() {
        x[i] /= row(i)[i];
        let own = x[i];
        super::add(&mut x[..i], -own, &row(i)[..i]);
    }
    x.iter().zip(&scale).map(|(x, s)| x * s).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scores that are a combination of features, with another mean for each ray, are found again.
    #[test]
    fn a_linear_dependence_is_found() {
        let mut all = Moments::new(3, 1);
        for ray in 0..4 {
            let mut own = Moments::new(3, 1);
            for k in 0..50 {
                let t = f64::from(k * 7 % 50 + ray);
                let features = vec![t.sin(), 1e6 * t.cos(), 0.0];
                let scores = vec![3.0 * features[0] - 2e-6 * features[1] + f64::from(ray)];
                own.add(&Tally { scores, features, ..Tally::default() });
            }
            all.merge(own);
        }
        let found = solve(&all).unwrap();
        assert!((found[0] + 3.0).abs() < 1e-5 && (found[1] - 2e-6).abs() < 1e-11, "{found:?}");
        assert_eq!(found[2].to_bits(), 0, "a function that no path has met");
    }
}
