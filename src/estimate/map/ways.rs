//! The estimators as types: a fit is compiled for each, so that none shares its registers with the others.

use super::Estimator;

/// How lines are weighted.
pub(super) trait Way {
    /// Its name.
    const ESTIMATOR: Estimator;
}

/// See [`Estimator::Default`].
pub(super) struct Ours;

/// See [`Estimator::Paper`].
pub(super) struct Papers;

/// See [`Estimator::Ols`].
pub(super) struct Unweighted;

impl Way for Ours {
    const ESTIMATOR: Estimator = Estimator::Default;
}

impl Way for Papers {
    const ESTIMATOR: Estimator = Estimator::Paper;
}

impl Way for Unweighted {
    const ESTIMATOR: Estimator = Estimator::Ols;
}
