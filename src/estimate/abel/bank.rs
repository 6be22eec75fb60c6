//! A transform of many strengths, ready to be applied: what the rows say of each strength, and the operator of each,
//! formed when it is first asked for.

use super::filtered::Filtered;
use super::matrix::Matrix;
use super::operator::Operator;
use super::product::{Number, Packed, Rows, multiply};
use std::sync::OnceLock;

/// Where answers are made of so small a part of the basis, coefficients are added up; else one operator is applied.
const NARROW: usize = 2;

/// The strengths of one width.
#[derive(Debug, Clone)]
pub(super) struct Bank {
    pub(super) filtered: Filtered,
    shares: Vec<f64>,
    operators: Vec<OnceLock<Operator>>,
    double: OnceLock<Screen<f64>>,
    single: OnceLock<Screen<f32>>,
    synthesis: OnceLock<Packed<f64>>,
}

impl Bank {
    /// `shares`: variances of the columns in variances of a pixel, see [`Operator::new`].
    pub(super) fn new(filtered: Filtered, shares: Vec<f64>) -> Self {
        let operators = filtered.choices.iter().map(|_| OnceLock::new()).collect();
        let (double, single, synthesis) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        Self { filtered, shares, operators, double, single, synthesis }
    }

    /// The operator of one choice.
    pub(super) fn operator(&self, choice: usize) -> &Operator {
        let form = || Operator::new(self.filtered.operator(choice), None, &self.shares);
        self.operators[choice].get_or_init(form)
    }

    /// Whether a few coefficients make up an answer.
    pub(super) fn is_narrow(&self) -> bool {
        NARROW * self.filtered.analysis.columns < self.filtered.analysis.rows
    }

    /// Residuals of every choice in f64.
    pub(super) fn double(&self) -> &Screen<f64> {
        self.double.get_or_init(|| Screen::new(&self.filtered))
    }

    /// In f32.
    pub(super) fn single(&self) -> &Screen<f32> {
        self.single.get_or_init(|| Screen::new(&self.filtered))
    }

    /// Answers of a choice whose filter is 1 for the first coefficients and 0 for the others.
    pub(super) fn synthesised(&self, choice: usize, coefficients: &[f64], order: &[usize], out: &mut [f64]) {
        let filter = &self.filtered.choices[choice].filter;
        let depth = filter.iter().rposition(|&kept| kept > 0.0).map_or(0, |last| last + 1);
        let synthesis = self.synthesis.get_or_init(|| Packed::new(&self.filtered.synthesis, None));
        multiply(&Rows { values: coefficients, stride: filter.len(), order, depth }, synthesis, out);
    }
}

/// From columns to the residuals of every choice, in numbers of one width.
#[derive(Debug, Clone)]
pub(super) struct Screen<T> {
    analysis: Packed<T>,
    /// What each choice leaves of a squared coefficient.
    left: Packed<T>,
}

impl<T: Number> Screen<T> {
    fn new(filtered: &Filtered) -> Self {
        let members = filtered.analysis.columns;
        let left = |k: usize, choice: usize| (1.0 - filtered.choices[choice].filter[k]).powi(2);
        let left = Matrix::from_fn(members, filtered.choices.len(), left);
        Self { analysis: Packed::new(&filtered.analysis, None), left: Packed::new(&left, None) }
    }

    /// Coefficients of all rows, `[row][member]`.
    pub(super) fn coefficients(&self, columns: &[T], order: &[usize], out: &mut Vec<T>) {
        let n = self.analysis.rows;
        out.resize(order.len() * self.analysis.columns, T::default());
        multiply(&Rows { values: columns, stride: n, order, depth: n }, &self.analysis, out);
    }

    /// Squares of what each choice leaves of some squared coefficients, `[row][choice]`.
    pub(super) fn residuals(&self, squares: &[T], order: &[usize]) -> Vec<T> {
        let members = self.left.rows;
        let mut out = vec![T::default(); order.len() * self.left.columns];
        multiply(&Rows { values: squares, stride: members, order, depth: members }, &self.left, &mut out);
        out
    }
}
