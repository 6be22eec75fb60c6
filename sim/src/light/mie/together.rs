//! The angular pattern of many spheres together: Σ number · (|S₁|² + |S₂|²).
//!
//! A sphere with N orders scatters a polynomial of degree 2N in cos θ, so 2N + 2 values at the middles of equal steps
//! of θ are all there is to know. Spheres of similar N share their angles and the angular functions π_n, τ_n there;
//! values of all of them are summed before anything else is done with them, so that the series of a size distribution
//! costs what its spheres cost: 8 products per order and pair of angles ±μ (the limit: N² fused operations for a
//! sphere of N orders, eight to a cycle). Angles are symmetric about 90°, and π_n(−μ) = (−1)^{n+1} π_n(μ),
//! τ_n(−μ) = (−1)^n τ_n(μ) give both of a pair.

use super::angular::{Amplitudes, Angles, Coefficients};
use super::climb::Order;
use super::factors::{Factor, Factors};
use super::kernel::{Batch, Workspace};
use super::lengths::{Lane, integer};
use super::pattern::Pattern;
use super::series::{by_size, fused, near};
use super::sums::Sink;
use super::vector::{BATCH, Lines, Vector};
use super::{MieError, Sphere};
use pulp::Simd;
use rayon::prelude::*;
use std::cell::RefCell;
use std::f64::consts::PI;

/// Spheres of one class that are summed in one task: fixes the order of additions for any number of threads.
const TASK: usize = 256;
/// Vectors of angles that are summed side by side.
const SIDE: usize = 2;
/// Values of π_n and τ_n that are kept at a time: a quarter of a second-level cache.
const TABLE: usize = 16 * 1024;
/// Largest size parameter: memory and work grow with its square.
const SIZE_PATTERN: f64 = 1e5;

impl Pattern {
    /// Cosine series of the light that `spheres` scatter, each of them `numbers` times (any unit, not negative).
    ///
    /// ½∫ Σ c_k cos kθ sin θ dθ = Σ number x² Q_sca / 2. Relative error below 1e-8 of the series' largest value
    /// (length of the series after Wiscombe, Appl. Opt. 19, 1505 (1980)). Runs on rayon's threads; the answer does
    /// not depend on their number.
    ///
    /// # Errors
    ///
    /// The index of the first bad sphere and what is wrong with it; size parameters above 1e5 are refused.
    pub fn of(spheres: &[Sphere], numbers: &[f64]) -> Result<Self, (usize, MieError)> {
        assert!(spheres.len() == numbers.len(), "one number for each sphere");
        for (index, sphere) in spheres.iter().enumerate() {
            let Sphere { size_parameter, n, k } = sphere.checked().map_err(|error| (index, error))?;
            if size_parameter > SIZE_PATTERN {
                let inside = size_parameter * n.hypot(k);
                return Err((index, MieError::TooLarge { size_parameter, inside, limit: SIZE_PATTERN }));
            }
        }
        let classes = classes(spheres, numbers);
        let tasks: Vec<(usize, &[u32])> = classes
            .iter()
            .flat_map(|(pairs, members)| members.chunks(TASK).map(move |task| (*pairs, task)))
            .collect();
        let arch = pulp::Arch::new();
        let parts: Vec<Halves> = tasks
            .par_iter()
            .map(|&(pairs, members)| arch.dispatch(Task { pairs, members, spheres, numbers }))
            .collect();
        let mut cosines = Vec::new();
        let mut tasks = tasks.iter().zip(parts).peekable();
        while let Some((&(pairs, _), mut sum)) = tasks.next() {
            while let Some((_, more)) = tasks.next_if(|(task, _)| task.0 == pairs) {
                sum.add(&more);
            }
            sum.add_series(arch, &mut cosines);
        }
        Ok(Self { cosines })
    }
}

/// Orders that the angles need: |a_n|² is below 1e-14 of its largest beyond.
fn orders(size_parameter: f64) -> f64 {
    (size_parameter + 4.05 * size_parameter.cbrt() + 3.0).ceil()
}

/// Pairs of angles for so many orders: whole vectors, steps of a sixth at most.
fn pairs_for(orders: f64) -> usize {
    let mut pairs = 8;
    while (pairs as f64) < orders + 1.0 {
        pairs += (pairs / 48).max(1) * 8;
    }
    pairs
}

/// Spheres that scatter and count, by the number of pairs of angles they need, ascending.
fn classes(spheres: &[Sphere], numbers: &[f64]) -> Vec<(usize, Vec<u32>)> {
    let mut classes: Vec<(usize, Vec<u32>)> = Vec::new();
    for &at in &by_size(spheres) {
        let sphere = &spheres[at as usize];
        // Strictly above 0, also no NaN.
        if numbers[at as usize] > 0.0 && sphere.size_parameter > 0.0 {
            let pairs = pairs_for(orders(sphere.size_parameter));
            match classes.iter_mut().find(|class| class.0 == pairs) {
                Some(class) => class.1.push(at),
                None => classes.push((pairs, vec![at])),
            }
        }
    }
    classes.sort_by_key(|class| class.0);
    classes
}

/// The sum over spheres at θ_i = (i + ½) π / (2 pairs), i < pairs: half of f(θ) + f(π − θ), and of their difference.
struct Halves {
    even: Vec<f64>,
    odd: Vec<f64>,
}

impl Halves {
    fn add(&mut self, other: &Self) {
        for (own, other) in self.even.iter_mut().zip(&other.even).chain(self.odd.iter_mut().zip(&other.odd)) {
            *own += other;
        }
    }

    /// Adds the cosine series through these values.
    fn add_series(&self, arch: pulp::Arch, cosines: &mut Vec<f64>) {
        let count = 2 * self.even.len();
        if cosines.len() < count {
            cosines.resize(count, 0.0);
        }
        arch.dispatch(Transform { halves: self, cosines });
    }
}

/// Adds to `cosines` the cosine series through the values of `halves`.
struct Transform<'a> {
    halves: &'a Halves,
    cosines: &'a mut [f64],
}

impl pulp::WithSimd for Transform<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if fused::<S>() { self.run::<S, true>(simd) } else { self.run::<S, false>(simd) }
    }
}

impl Transform<'_> {
    /// c_k = 2/count Σ f(θ_i) cos kθ_i; cos k(i + ½)h over i by the three-term recurrence, several k side by side
    /// (its rounding grows as count²: 1e-10 for count = 1000).
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "counted loops over WAYS unroll, so that vectors stay in registers"
    )]
    fn run<S: Simd, const FUSED: bool>(self, simd: S) {
        /// Vectors of k side by side.
        const WAYS: usize = 4;
        let on = Vector::<S, FUSED>(simd);
        let width = S::F64_LANES;
        let pairs = self.halves.even.len();
        let step = PI / (2 * pairs) as f64;
        for (parity, half) in [&self.halves.even, &self.halves.odd].into_iter().enumerate() {
            let mut first = 0;
            while first < pairs {
                let number = |w: usize, lane: usize| (parity + 2 * (first + w * width + lane)) as f64;
                let mut here = [on.all(0.0); WAYS];
                let mut turn = [on.all(0.0); WAYS];
                for w in 0..WAYS {
                    let (mut halves, mut turns) = ([0.0; BATCH], [0.0; BATCH]);
                    for lane in 0..width {
                        let angle = number(w, lane) * step;
                        halves[lane] = (0.5 * angle).cos();
                        turns[lane] = 2.0 * angle.cos();
                    }
                    here[w] = on.load(&halves);
                    turn[w] = on.load(&turns);
                }
                let mut below = here;
                let mut sums = [on.all(0.0); WAYS];
                for value in half {
                    let value = on.all(*value);
                    for w in 0..WAYS {
                        sums[w] = on.mul_add(value, here[w], sums[w]);
                        let above = on.mul_sub(turn[w], here[w], below[w]);
                        below[w] = here[w];
                        here[w] = above;
                    }
                }
                for w in 0..WAYS {
                    for (lane, sum) in on.store(sums[w]).into_iter().enumerate().take(width) {
                        let k = parity + 2 * (first + w * width + lane);
                        if k < 2 * pairs {
                            self.cosines[k] += sum * if k == 0 { 1.0 } else { 2.0 } / pairs as f64;
                        }
                    }
                }
                first += WAYS * width;
            }
        }
    }
}

/// Memory of a task, kept by its thread for the next one: clearing fresh pages costs as much as a tenth of the sums.
#[derive(Default)]
struct Scratch {
    workspace: Workspace,
    /// Coefficients, list after list.
    coefficients: Lines,
    /// w π_n and w τ_n.
    angular: Lines,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Numbers that a thread keeps at most: 8 MiB.
const KEPT: usize = 1 << 20;

/// The sum over a few spheres of one class.
struct Task<'a> {
    pairs: usize,
    members: &'a [u32],
    spheres: &'a [Sphere],
    numbers: &'a [f64],
}

impl pulp::WithSimd for Task<'_> {
    type Output = Halves;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Halves {
        match S::F64_LANES {
            8 => self.run::<S, true, 2>(simd),
            4 => self.run::<S, true, 4>(simd),
            2 => self.run::<S, false, 4>(simd),
            _ => self.run::<S, false, 1>(simd),
        }
    }
}

impl Task<'_> {
    #[inline(always)]
    fn run<S: Simd, const FUSED: bool, const V: usize>(&self, simd: S) -> Halves {
        let on = Vector::<S, FUSED>(simd);
        let width = S::F64_LANES;
        let mut scratch = SCRATCH.take();
        let longest = self
            .members
            .iter()
            .fold(0.0f64, |longest, &at| longest.max(orders(self.spheres[at as usize].size_parameter)));
        let longest = integer(longest);
        // Both kinds of indices may leave a batch that is not full.
        let most = (self.members.len() / (V * width) + 2) * V;
        scratch.coefficients.reach(4 * width * longest * most);
        let coefficients = scratch.coefficients.vectors::<S>();
        let mut lists: Vec<List> = Vec::new();
        for near_one in [true, false] {
            let members: Vec<u32> = self
                .members
                .iter()
                .copied()
                .filter(|&at| near(&self.spheres[at as usize]) == near_one)
                .collect();
            for chunk in members.chunks(V * width) {
                self.coefficients::<S, FUSED, V>(
                    simd,
                    chunk,
                    near_one,
                    &mut scratch.workspace,
                    (coefficients, 4 * longest),
                    &mut lists,
                );
            }
        }
        let block = SIDE * width;
        let mut sums = vec![[on.all(0.0); 2]; self.pairs / width];
        let blocks_at_once = (TABLE / (2 * block * longest.max(1))).max(1);
        let table = Factors::reaching(longest + 1);
        let vectors = self.pairs / width;
        let mut first = 0;
        while first < vectors {
            let count = (blocks_at_once * SIDE).min(vectors - first);
            scratch.angular.reach(2 * width * longest * count);
            let angular = Angular::filled(
                on,
                scratch.angular.vectors::<S>(),
                self.pairs,
                first,
                count,
                &table,
                longest,
            );
            for (list, coefficients) in lists.iter().zip(coefficients.chunks(4 * longest)) {
                list.add::<S, FUSED>(on, coefficients, &angular, &mut sums[first..first + count]);
            }
            first += count;
        }
        let mut halves = Halves { even: vec![0.0; self.pairs], odd: vec![0.0; self.pairs] };
        for (v, [even, odd]) in sums.iter().enumerate() {
            halves.even[v * width..(v + 1) * width].copy_from_slice(&on.store(*even)[..width]);
            halves.odd[v * width..(v + 1) * width].copy_from_slice(&on.store(*odd)[..width]);
        }
        if scratch.coefficients.len().max(scratch.angular.len()) <= KEPT {
            SCRATCH.set(scratch);
        }
        halves
    }

    /// Coefficients of a batch, a list for each vector.
    #[inline(always)]
    fn coefficients<S: Simd, const FUSED: bool, const V: usize>(
        &self,
        simd: S,
        chunk: &[u32],
        near_one: bool,
        workspace: &mut Workspace,
        (coefficients, stride): (&mut [S::f64s], usize),
        lists: &mut Vec<List>,
    ) {
        let width = S::F64_LANES;
        let mut lanes = [Lane::new(Sphere { size_parameter: 0.0, n: 1.5, k: 0.0 }); BATCH];
        let mut numbers = [0.0; BATCH];
        for i in 0..V * width {
            // A batch that is not full repeats its first sphere, without weight.
            let at = chunk[if i < chunk.len() { i } else { 0 }] as usize;
            let sphere = self.spheres[at];
            let lane = Lane::new(sphere);
            lanes[i] = Lane { last: lane.last.min(orders(sphere.size_parameter)), ..lane };
            numbers[i] = if i < chunk.len() { self.numbers[at] } else { 0.0 };
        }
        let batch = Batch::<S, FUSED, V>::new(simd, &lanes[..V * width]);
        if near_one {
            batch.descend::<true>(workspace);
        } else {
            batch.descend::<false>(workspace);
        }
        for v in 0..V {
            let mut list = List { orders: 0, numbers: [0.0; BATCH] };
            list.numbers[..width].copy_from_slice(&numbers[v * width..(v + 1) * width]);
            let place = &mut coefficients[lists.len() * stride..][..stride];
            let mut writing = Writing::<S> { place, orders: 0 };
            if near_one {
                batch.climb::<true>(workspace, v, &mut writing);
            } else {
                batch.climb::<false>(workspace, v, &mut writing);
            }
            list.orders = writing.orders;
            lists.push(list);
        }
    }
}

/// One vector of spheres, whose coefficients Re a, Im a, Re b, Im b of n = 1, 2 … stand elsewhere.
struct List {
    orders: usize,
    numbers: [f64; BATCH],
}

/// Writes coefficients one after the other.
struct Writing<'a, S: Simd> {
    place: &'a mut [S::f64s],
    orders: usize,
}

impl<S: Simd> Sink<S::f64s> for Writing<'_, S> {
    #[inline(always)]
    fn take(&mut self, _: Factor, order: Order<S::f64s>) {
        let row = &mut self.place[4 * self.orders..][..4];
        row[0] = order.a.re;
        row[1] = order.a.im;
        row[2] = order.b.re;
        row[3] = order.b.im;
        self.orders += 1;
    }
}

impl List {
    /// Adds what its spheres scatter at the angles of `angular`.
    #[inline(always)]
    fn add<S: Simd, const FUSED: bool>(
        &self,
        on: Vector<S, FUSED>,
        coefficients: &[S::f64s],
        angular: &Angular<'_, S>,
        sums: &mut [[S::f64s; 2]],
    ) {
        let numbers: &[f64] = pulp::bytemuck::cast_slice(coefficients);
        for lane in 0..S::F64_LANES {
            let number = self.numbers[lane];
            if number <= 0.0 {
                continue;
            }
            let weight = on.all(number);
            let mut v = 0;
            while v + SIDE <= sums.len() {
                let found = square::<FUSED, SIDE, S>(on, &numbers[lane..], angular, v, self.orders);
                for (sum, found) in sums[v..v + SIDE].iter_mut().zip(found) {
                    sum[0] = on.mul_add(found[0], weight, sum[0]);
                    sum[1] = on.mul_add(found[1], weight, sum[1]);
                }
                v += SIDE;
            }
            while v < sums.len() {
                let [found] = square::<FUSED, 1, S>(on, &numbers[lane..], angular, v, self.orders);
                sums[v][0] = on.mul_add(found[0], weight, sums[v][0]);
                sums[v][1] = on.mul_add(found[1], weight, sums[v][1]);
                v += 1;
            }
        }
    }
}

/// w π_n and w τ_n, w = (2n+1)/(n(n+1)), at some vectors of angles: `[vector][order − 1]`.
struct Angular<'a, S: Simd> {
    orders: usize,
    values: &'a [S::f64s],
}

impl<'a, S: Simd> Angular<'a, S> {
    #[inline(always)]
    fn filled<const FUSED: bool>(
        on: Vector<S, FUSED>,
        values: &'a mut [S::f64s],
        pairs: usize,
        first: usize,
        count: usize,
        table: &Factors,
        orders: usize,
    ) -> Self {
        let width = S::F64_LANES;
        for (vector, rows) in (first..first + count).zip(values.chunks_mut(2 * orders)) {
            let mut versines = [0.0; BATCH];
            for (lane, versine) in versines.iter_mut().enumerate().take(width) {
                let sine = (PI * ((vector * width + lane) as f64 + 0.5) / (4 * pairs) as f64).sin();
                *versine = 2.0 * sine * sine;
            }
            let mut angles = Angles::new(on, on.load(&versines));
            for (n, row) in (1..).zip(rows.chunks_mut(2)) {
                let factor = table.at(n);
                let (pi, tau) = angles.step(on, factor);
                let weight = on.all(factor.across);
                row[0] = on.mul(pi, weight);
                row[1] = on.mul(tau, weight);
            }
        }
        Self { orders, values }
    }
}

/// |S₁|² + |S₂|² of one sphere at `SIDE` vectors of pairs of angles: half the sum over both angles of a pair, and half
/// the difference. `numbers` are the coefficients from this sphere's place on, `S::F64_LANES` apart.
#[inline(always)]
#[expect(
    clippy::needless_range_loop,
    reason = "counted loops over SIDE unroll, so that the sums stay in registers"
)]
fn square<const FUSED: bool, const SIDE: usize, S: Simd>(
    on: Vector<S, FUSED>,
    numbers: &[f64],
    angular: &Angular<'_, S>,
    first: usize,
    orders: usize,
) -> [[S::f64s; 2]; SIDE] {
    let width = S::F64_LANES;
    let mut sums = [Amplitudes::<S>::nothing(on); SIDE];
    let mut n = 0;
    while n < orders {
        // n counts from 0.
        let row = &numbers[4 * width * n..4 * width * n + 3 * width + 1];
        let factors = Coefficients::of(on, [row[0], row[width], row[2 * width], row[3 * width]]);
        for s in 0..SIDE {
            let row = &angular.values[2 * ((first + s) * angular.orders + n)..][..2];
            let (pi, tau) = (row[0], row[1]);
            sums[s] = sums[s].with_odd(on, &factors, pi, tau);
        }
        n += 1;
        if n == orders {
            break;
        }
        let row = &numbers[4 * width * n..4 * width * n + 3 * width + 1];
        let factors = Coefficients::of(on, [row[0], row[width], row[2 * width], row[3 * width]]);
        for s in 0..SIDE {
            let row = &angular.values[2 * ((first + s) * angular.orders + n)..][..2];
            let (pi, tau) = (row[0], row[1]);
            sums[s] = sums[s].with_even(on, &factors, pi, tau);
        }
        n += 1;
    }
    let mut found = [[on.all(0.0); 2]; SIDE];
    for s in 0..SIDE {
        found[s] = sums[s].square(on);
    }
    found
}
