//! One vector of spheres with the constants of their recurrences.

use super::lengths::{Lane, SIZE_MIN, integer};
use super::vector::{BATCH, Complexes, Vector};
use pulp::Simd;

/// One vector of spheres with the constants of their recurrences.
#[derive(Clone, Copy)]
pub(super) struct Spheres<S: Simd> {
    pub(super) x: S::f64s,
    pub(super) x_inverse: S::f64s,
    pub(super) m: Complexes<S::f64s>,
    pub(super) m_inverse: Complexes<S::f64s>,
    /// 1/|m|².
    pub(super) square_inverse: S::f64s,
    pub(super) last: S::f64s,
    pub(super) start: S::f64s,
    /// First and last order at which a series ends.
    pub(super) ends: (usize, usize),
}

impl<S: Simd> Spheres<S> {
    #[inline(always)]
    pub(super) fn new<const FUSED: bool>(on: Vector<S, FUSED>, lanes: &[Lane]) -> Self {
        let mut columns = [[0.0; BATCH]; 5];
        let mut ends = (usize::MAX, 0);
        for (i, lane) in lanes.iter().enumerate() {
            columns[0][i] = lane.sphere.size_parameter.max(SIZE_MIN);
            columns[1][i] = lane.sphere.n;
            columns[2][i] = lane.sphere.k;
            columns[3][i] = lane.last;
            columns[4][i] = lane.start;
            let last = integer(lane.last);
            ends = (ends.0.min(last), ends.1.max(last));
        }
        let x = on.load(&columns[0]);
        let m = Complexes { re: on.load(&columns[1]), im: on.load(&columns[2]) };
        let one = on.all(1.0);
        let square_inverse = on.div(one, m.norm_sqr(on));
        Self {
            x,
            x_inverse: on.div(one, x),
            m,
            m_inverse: m.conj(on).scaled(on, square_inverse),
            square_inverse,
            last: on.load(&columns[3]),
            start: on.load(&columns[4]),
            ends,
        }
    }
}
