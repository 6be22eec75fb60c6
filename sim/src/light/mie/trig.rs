//! Sine and cosine of a vector of size parameters.
//!
//! Reduction by multiples of π/2 with fused operations: x − q·(π/2)₁ is exact (both lie on a grid of 2⁻⁵² and the
//! rest is below 1), the second part of π/2 carries on to 107 bits. Polynomials of fdlibm (Sun Microsystems 1993,
//! k_sin.c, k_cos.c): within 1 ulp of the larger of the two for x below [`REACH`].

use super::vector::Vector;
use pulp::Simd;
use std::f64::consts::FRAC_2_PI;

/// Beyond it, and on machines without fused operations, the standard library is asked number by number.
const REACH: f64 = 1e5;
/// π/2 rounded to a double, and what is missing to it.
const HALF_PI: [f64; 2] = [std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17];
/// 1.5 · 2⁵²: adding and subtracting it rounds to a whole number.
const ROUND: f64 = 6_755_399_441_055_744.0;
const SINE: f64 = -1.666_666_666_666_663_2e-1;
const SINE_TAIL: [f64; 5] = [
    8.333_333_333_322_49e-3,
    -1.984_126_982_985_795e-4,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];
const COSINE: [f64; 6] = [
    4.166_666_666_666_66e-2,
    -1.388_888_888_887_411e-3,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];

/// (sin x, cos x) of numbers that are not negative.
#[inline(always)]
pub(super) fn sine_cosine<S: Simd, const FUSED: bool>(
    on: Vector<S, FUSED>,
    x: S::f64s,
) -> (S::f64s, S::f64s) {
    let (mut sine, mut cosine) = if FUSED { reduced(on, x) } else { (x, x) };
    let numbers = on.store(x);
    let mut largest = 0.0f64;
    for number in &numbers[..S::F64_LANES] {
        largest = largest.max(*number);
    }
    if !FUSED || largest > REACH {
        let (mut sines, mut cosines) = (on.store(sine), on.store(cosine));
        for i in 0..S::F64_LANES {
            if !FUSED || numbers[i] > REACH {
                (sines[i], cosines[i]) = numbers[i].sin_cos();
            }
        }
        sine = on.load(&sines);
        cosine = on.load(&cosines);
    }
    (sine, cosine)
}

/// To the next whole number.
#[inline(always)]
fn round<S: Simd, const FUSED: bool>(on: Vector<S, FUSED>, value: S::f64s) -> S::f64s {
    on.sub(on.add(value, on.all(ROUND)), on.all(ROUND))
}

/// Σ c_i z^i.
#[inline(always)]
fn chain<S: Simd, const FUSED: bool, const C: usize>(
    on: Vector<S, FUSED>,
    c: [f64; C],
    z: S::f64s,
) -> S::f64s {
    let mut sum = on.all(c[C - 1]);
    let mut i = C - 1;
    while i > 0 {
        i -= 1;
        sum = on.mul_add(sum, z, on.all(c[i]));
    }
    sum
}

#[inline(always)]
fn reduced<S: Simd, const FUSED: bool>(on: Vector<S, FUSED>, x: S::f64s) -> (S::f64s, S::f64s) {
    let quarter = round(on, on.mul(x, on.all(FRAC_2_PI)));
    let first = on.sub_mul(x, quarter, on.all(HALF_PI[0]));
    let r = on.sub_mul(first, quarter, on.all(HALF_PI[1]));
    let rest = on.sub_mul(on.sub(first, r), quarter, on.all(HALF_PI[1]));

    let z = on.mul(r, r);
    let half = on.all(0.5);
    let cube = on.mul(z, r);
    // r − ((z (rest/2 − r³ p) − rest) − r³ s₁).
    let inner = on.sub_mul(on.mul(half, rest), cube, chain(on, SINE_TAIL, z));
    let inner = on.sub_mul(on.mul_sub(z, inner, rest), cube, on.all(SINE));
    let sine = on.sub(r, inner);
    let half_z = on.mul(half, z);
    let one = on.all(1.0);
    let top = on.sub(one, half_z);
    let low = on.sub_mul(on.mul(on.mul(z, z), chain(on, COSINE, z)), r, rest);
    let cosine = on.add(top, on.add(on.sub(on.sub(one, top), half_z), low));

    // q modulo 4 as −2 … 2.
    let d = on.sub_mul(quarter, on.all(4.0), round(on, on.mul(quarter, on.all(0.25))));
    let square = on.mul(d, d);
    let odd = on.at_most(on.mul(on.sub(square, one), on.sub(square, one)), on.all(0.5));
    let (first, second) = (on.select(odd, cosine, sine), on.select(odd, sine, cosine));
    (signed(on, d, first, -0.5, 1.5), signed(on, d, second, -1.5, 0.5))
}

/// `value` where d is within `from` and `to`, its negative elsewhere.
#[inline(always)]
fn signed<S: Simd, const FUSED: bool>(
    on: Vector<S, FUSED>,
    d: S::f64s,
    value: S::f64s,
    from: f64,
    to: f64,
) -> S::f64s {
    let negative = on.neg(value);
    let inside = on.select(on.at_most(d, on.all(to)), value, negative);
    on.select(on.at_most(d, on.all(from)), negative, inside)
}
