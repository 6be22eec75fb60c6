//! Numbers that belong to an order of the series: they are read, not computed, beside the vectors.

use std::borrow::Cow;
use std::sync::LazyLock;

/// Orders whose factors are made at the first use …
const TABLE: usize = 2048;

/// … and those that are made when a series is longer than that.
const LARGE: usize = 65_536;

static FACTORS: LazyLock<Factors> = LazyLock::new(|| Factors::up_to(TABLE));
static MANY_FACTORS: LazyLock<Factors> = LazyLock::new(|| Factors::up_to(LARGE));

/// Numbers that belong to an order n, from n = 0. Columns of their own: read from memory into all lanes at once they
/// cost nothing beside the arithmetic.
#[derive(Debug, Clone, Default)]
pub(super) struct Factors {
    /// 2n + 1.
    odd: Vec<f64>,
    /// n.
    order: Vec<f64>,
    /// n + 1.
    above: Vec<f64>,
    /// n(n + 1).
    product: Vec<f64>,
    /// (2n+1)/(n(n+1)), of the sum of the mean cosine.
    across: Vec<f64>,
    /// (n−1)(n+1)/n, of the sum of the mean cosine.
    along: Vec<f64>,
    /// (−1)^n (2n+1).
    alternating: Vec<f64>,
}

impl Factors {
    fn up_to(count: usize) -> Self {
        let mut factors = Self::default();
        factors.reach(count);
        factors
    }

    /// The factors of at least `count` orders.
    pub(super) fn reaching(count: usize) -> Cow<'static, Self> {
        if count <= TABLE {
            Cow::Borrowed(&FACTORS)
        } else if count <= LARGE {
            Cow::Borrowed(&MANY_FACTORS)
        } else {
            Cow::Owned(Self::up_to(count))
        }
    }

    fn reach(&mut self, count: usize) {
        for n in self.odd.len()..count {
            let order = n as f64;
            let odd = 2.0 * order + 1.0;
            self.odd.push(odd);
            self.order.push(order);
            self.above.push(order + 1.0);
            self.product.push(order * (order + 1.0));
            self.across.push(odd / (order * (order + 1.0)));
            self.along.push((order - 1.0) * (order + 1.0) / order);
            self.alternating.push(if n % 2 == 0 { odd } else { -odd });
        }
    }

    /// The numbers of order `n`.
    #[inline(always)]
    pub(super) fn at(&self, n: usize) -> Factor {
        Factor {
            odd: self.odd[n],
            order: self.order[n],
            above: self.above[n],
            product: self.product[n],
            across: self.across[n],
            along: self.along[n],
            alternating: self.alternating[n],
        }
    }
}

/// One row of [`Factors`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Factor {
    pub(super) odd: f64,
    pub(super) order: f64,
    pub(super) above: f64,
    pub(super) product: f64,
    pub(super) across: f64,
    pub(super) along: f64,
    pub(super) alternating: f64,
}
