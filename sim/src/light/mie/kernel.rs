//! The Mie series of several spheres at once: ratios downward, coefficients upward.
//!
//! Notation: ψ_n, χ_n Riccati–Bessel functions of x (ξ = ψ − iχ), r_n(z) = ψ_{n+1}(z)/ψ_n(z), z = m x,
//! u_a = (n+1)(1/m² − 1)/x − r_n(z)/m, u_b = −m r_n(z). With u = p + iq a coefficient is N/(N − iM) with
//! N = ψ_{n+1} + ψ_n u and M = χ_{n+1} + χ_n u. What keeps every digit:
//!
//! 1. r_n by downward recurrence, r_{n−1} = 1/((2n+1)/z − r_n). It maps the upper half-plane into itself, so Im r
//!    keeps its relative accuracy however weak the absorption.
//! 2. For m → 1 both parts of N from D_n = r_n(x) − r_n(z), which has a recurrence of its own,
//!    D_{n−1} = ((2n+1)(1−m)/(m x) + D_n) r_{n−1}(x) r_{n−1}(z), a sum of equal signs.
//! 3. With the Wronskian ψ_nχ_{n+1} − ψ_{n+1}χ_n = 1 the denominator is |N|² + |M|² − 2q, and
//!    Re a − |a|² = −q/|N − iM|²: sums of positive terms (q ≤ 0), so that no cross-section is ever a difference.
//!
//! Ratios instead of logarithmic derivatives: Du, Appl. Opt. 43, 1951 (2004).
//!
//! Limit: upward 60 products and a division an order, downward 11 and a division a step, of which there are |m|
//! times as many. With 8 numbers a vector, one such operation a cycle and 9 cycles a division: 11 cycles an order and
//! sphere (measured on a quiet core: 65 cycles a vector upward, 21 downward).

use super::climb::Climb;
use super::descent::{Descent, Ratios};
use super::factors::Factors;
use super::lengths::{Lane, integer};
use super::spheres::Spheres;
use super::sums::{Adding, Sink, Sums};
use super::vector::{Complexes, Lines, Vector};
use pulp::Simd;
use std::borrow::Cow;

/// Workspace that is used again for every batch.
pub(super) struct Workspace {
    /// r_n(x), Re r_n(z), Im r_n(z) of each order, [`ROW`] vectors for each of the `V`.
    ratios: Lines,
    /// Re D_n, Im D_n of each order.
    differences: Lines,
    factors: Cow<'static, Factors>,
}

/// Vectors of one order of ratios, and of differences.
const ROW: [usize; 2] = [3, 2];

impl Default for Workspace {
    fn default() -> Self {
        Self { ratios: Lines::default(), differences: Lines::default(), factors: Factors::reaching(0) }
    }
}

/// `V` vectors of spheres.
pub(super) struct Batch<S: Simd, const FUSED: bool, const V: usize> {
    on: Vector<S, FUSED>,
    spheres: [Spheres<S>; V],
    /// First and last order at which a downward recurrence starts.
    starts: (usize, usize),
}

impl<S: Simd, const FUSED: bool, const V: usize> Batch<S, FUSED, V> {
    /// As many spheres as `V` vectors hold.
    #[inline(always)]
    pub(super) fn new(simd: S, lanes: &[Lane]) -> Self {
        let on = Vector(simd);
        let width = S::F64_LANES;
        let mut spheres = [Spheres::new(on, &lanes[..width]); V];
        for (v, spheres) in spheres.iter_mut().enumerate().skip(1) {
            *spheres = Spheres::new(on, &lanes[v * width..(v + 1) * width]);
        }
        let mut starts = (usize::MAX, 0);
        for lane in lanes {
            let start = integer(lane.start);
            starts = (starts.0.min(start), starts.1.max(start));
        }
        Self { on, spheres, starts }
    }

    /// Last order of the longest series.
    #[inline(always)]
    pub(super) fn orders(&self) -> usize {
        let mut longest = 0;
        for spheres in &self.spheres {
            longest = longest.max(spheres.ends.1);
        }
        longest
    }

    /// r_n(x), r_n(z) for n = 0 … `orders`; with `NEAR` also D_n.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "counted loops over V unroll, so that the vectors stay in registers"
    )]
    pub(super) fn descend<const NEAR: bool>(&self, workspace: &mut Workspace) {
        let on = self.on;
        let orders = self.orders();
        if workspace.ratios.reach(ROW[0] * V * S::F64_LANES * (orders + 1)) {
            workspace.factors = Factors::reaching(orders + 1);
        }
        if NEAR {
            workspace.differences.reach(ROW[1] * V * S::F64_LANES * (orders + 1));
        }
        let (ratios, differences) = (workspace.ratios.vectors::<S>(), workspace.differences.vectors::<S>());
        let mut descents = [Descent::<S>::new(on, &self.spheres[0]); V];
        for v in 1..V {
            descents[v] = Descent::new(on, &self.spheres[v]);
        }
        // Each recurrence starts at its own order, so that a sphere has the same bits in any company.
        for n in (self.starts.0 + 1..=self.starts.1).rev() {
            for v in 0..V {
                descents[v] = descents[v].step::<FUSED, NEAR, true>(on, n);
                if n <= orders + 1 {
                    descents[v].keep::<NEAR>((n - 1) * V + v, ratios, differences);
                }
            }
        }
        let beyond = self.starts.0.min(orders + 1);
        for n in (beyond + 1..=self.starts.0).rev() {
            for v in 0..V {
                descents[v] = descents[v].step::<FUSED, NEAR, false>(on, n);
            }
        }
        for n in (1..=beyond).rev() {
            for v in 0..V {
                descents[v] = descents[v].step::<FUSED, NEAR, false>(on, n);
                descents[v].keep::<NEAR>((n - 1) * V + v, ratios, differences);
            }
        }
    }

    /// Coefficients of vector `v` for n = 1, 2 … in turn; zeros for spheres whose series has ended.
    #[inline(always)]
    pub(super) fn climb<const NEAR: bool>(
        &self,
        workspace: &Workspace,
        v: usize,
        sink: &mut impl Sink<S::f64s>,
    ) {
        let on = self.on;
        let spheres = &self.spheres[v];
        let (ratios, differences) = (workspace.ratios.read::<S>(), workspace.differences.read::<S>());
        let at = |n: usize| Ratios::of(&ratios[ROW[0] * (n * V + v)..][..ROW[0]]);
        let mut climb = Climb::new(on, spheres, at(0).outside);
        let difference = |n: usize| {
            let row = &differences[ROW[1] * (n * V + v)..][..ROW[1]];
            Complexes { re: row[0], im: row[1] }
        };
        let table: &Factors = &workspace.factors;
        let nothing = Complexes { re: on.all(0.0), im: on.all(0.0) };
        for n in 1..=spheres.ends.0 {
            let factor = table.at(n);
            let difference = if NEAR { difference(n) } else { nothing };
            sink.take(factor, climb.step::<FUSED, NEAR, false>(on, factor, at(n), difference));
        }
        for n in spheres.ends.0 + 1..=spheres.ends.1 {
            let factor = table.at(n);
            let difference = if NEAR { difference(n) } else { nothing };
            sink.take(factor, climb.step::<FUSED, NEAR, true>(on, factor, at(n), difference));
        }
    }

    /// Sums that are still empty.
    #[inline(always)]
    pub(super) fn adding<const WATCH: bool>(&self) -> Adding<S, FUSED, WATCH> {
        Adding::new(self.on)
    }

    /// Sums over the series of every sphere; with `WATCH` their strain too.
    #[inline(always)]
    pub(super) fn sums<const NEAR: bool, const WATCH: bool>(
        &self,
        workspace: &mut Workspace,
        sums: &mut [Sums],
    ) {
        self.descend::<NEAR>(workspace);
        for v in 0..V {
            let mut adding = self.adding::<WATCH>();
            self.climb::<NEAR>(workspace, v, &mut adding);
            adding.finish(&mut sums[v * S::F64_LANES..(v + 1) * S::F64_LANES]);
        }
    }
}
