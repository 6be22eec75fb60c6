//! A transform of many strengths, ready to be applied: what the rows say of each strength, and the operator of each,
//! formed when it is first asked for.

use super::filtered::{Choice, Filtered};
use super::operator::Operator;
use super::operators::radius;
use super::product::{Number, Packed, Rows, multiply};
use std::ops::Range;
use std::sync::OnceLock;

/// Where answers are made of so small a part of the basis, coefficients are added up; else one operator is applied.
const NARROW: usize = 2;

/// The least smooth ones, which tell whether the rest is noise.
const SHORT_LAST: usize = 32;
/// It pays where there are so many members.
const SHORT_FROM: usize = 256;

/// The strengths of one width.
#[derive(Debug, Clone)]
pub(super) struct Bank {
    pub(super) filtered: Filtered,
    shares: Vec<f64>,
    operators: Vec<OnceLock<Operator>>,
    double: OnceLock<Screen<f64>>,
    single: OnceLock<Screen<f32>>,
    short: OnceLock<Short>,
    synthesis: OnceLock<Packed<f64>>,
}

impl Bank {
    /// `shares`: variances of the columns in variances of a pixel, see [`Operator::new`].
    pub(super) fn new(filtered: Filtered, shares: Vec<f64>) -> Self {
        let operators = filtered.choices.iter().map(|_| OnceLock::new()).collect();
        let (double, single, short) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        Self { filtered, shares, operators, double, single, short, synthesis: OnceLock::new() }
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
        self.double.get_or_init(|| Screen::new(&self.filtered, 0..self.filtered.analysis.columns))
    }

    /// In f32.
    pub(super) fn single(&self) -> &Screen<f32> {
        self.single.get_or_init(|| Screen::new(&self.filtered, 0..self.filtered.analysis.columns))
    }

    /// In f32 from the smoothest members alone; None where they are not few.
    pub(super) fn short(&self) -> Option<&Short> {
        let members = self.filtered.analysis.columns;
        let few = self.filtered.complete && members >= SHORT_FROM;
        few.then(|| self.short.get_or_init(|| Short::new(&self.filtered)))
    }

    /// Answers of a choice whose filter is 1 for the first coefficients and 0 for the others.
    pub(super) fn synthesised(&self, choice: usize, coefficients: &[f64], order: &[usize], out: &mut [f64]) {
        let filter = &self.filtered.choices[choice].filter;
        let depth = filter.iter().rposition(|&kept| kept > 0.0).map_or(0, |last| last + 1);
        let synthesis = self.synthesis.get_or_init(|| Packed::new(&self.filtered.synthesis, None));
        multiply(&Rows { values: coefficients, stride: filter.len(), order, depth }, synthesis, out);
    }
}

/// The smoothest members, and what is known of the others.
#[derive(Debug, Clone)]
pub(super) struct Short {
    pub(super) members: Range<usize>,
    pub(super) screen: Screen<f32>,
    /// The least smooth ones among them, and how many others there are.
    pub(super) last: Range<usize>,
    pub(super) others: f64,
    /// What each choice leaves of the squares of the others, all of one size.
    pub(super) left: Vec<f32>,
    /// The most that it keeps of any of them.
    pub(super) kept: Vec<f64>,
}

impl Short {
    fn new(filtered: &Filtered) -> Self {
        let (all, few) = (filtered.analysis.columns, filtered.short);
        // The strongest choice tells which end is smooth.
        let smooth_first =
            filtered.choices.last().is_none_or(|choice| choice.filter[0] >= choice.filter[all - 1]);
        let (members, last, others) = if smooth_first {
            (0..few, few - SHORT_LAST..few, few..all)
        } else {
            (all - few..all, 0..SHORT_LAST, 0..all - few)
        };
        let mean =
            |choice: &Choice| others.clone().map(|k| choice.left(k)).sum::<f64>() / radius(others.len(), 0.0);
        let most = |choice: &Choice| choice.filter[others.clone()].iter().copied().fold(0.0, f64::max);
        Self {
            screen: Screen::new(filtered, members.clone()),
            members,
            last,
            others: radius(others.len(), 0.0),
            left: filtered.choices.iter().map(|choice| f32::rounded(mean(choice))).collect(),
            kept: filtered.choices.iter().map(most).collect(),
        }
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
    /// Of some members.
    fn new(filtered: &Filtered, members: Range<usize>) -> Self {
        let (n, count, first) = (filtered.analysis.rows, members.len(), members.start);
        let left = |k: usize, choice: usize| filtered.choices[choice].left(first + k);
        let analysis = |i: usize, k: usize| filtered.analysis.at(i, first + k);
        Self {
            analysis: Packed::from_fn(n, count, None, analysis),
            left: Packed::from_fn(count, filtered.choices.len(), None, left),
        }
    }

    /// Coefficients of all rows, `[row][member]`.
    pub(super) fn coefficients(&self, columns: &[T], order: &[usize], out: &mut Vec<T>) {
        let n = self.analysis.rows;
        out.resize(order.len() * self.analysis.columns, T::default());
        multiply(&Rows { values: columns, stride: n, order, depth: n }, &self.analysis, out);
    }

    /// Squares of what each choice leaves of some squared coefficients, `[row][choice]`.
    pub(super) fn residuals(&self, squares: &[T]) -> Vec<T> {
        let members = self.left.rows;
        let order: Vec<usize> = (0..squares.len() / members.max(1)).collect();
        let mut out = vec![T::default(); order.len() * self.left.columns];
        let rows = Rows { values: squares, stride: members, order: &order, depth: members };
        multiply(&rows, &self.left, &mut out);
        out
    }
}
