//! From crossings to temperatures: a row at a time, with a logarithm that vectors can do.

use super::kernel::ASKED;
use super::lanes::Number;
use super::{FitInputs, flag};
use crate::estimate::calibration::{C2_UM_K, EXTRAPOLATION_MAX, Residual};

/// I_cal(T_eff) = ε_B·(S + E_f), inverted: T = (c2/ln(1 + A/I) − b)/a.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thermometer<'a, F> {
    plate: F,
    far: F,
    a_counts: F,
    /// c2/a, b/a, a/c2, and ln 2.
    scale: F,
    shift_k: F,
    steepness: F,
    ln2: F,
    /// Calibrated temperatures, and the limits of extrapolation, in K.
    low_k: F,
    high_k: F,
    coldest_k: F,
    hottest_k: F,
    residual: Option<&'a Residual>,
}

/// What is known of a black body of some counts.
#[derive(Clone, Copy)]
struct Body<F> {
    /// NaN for no light.
    kelvin: F,
    /// dT/dI, in K per count; garbage for no light.
    slope: F,
    lit: bool,
}

impl<'a, F: Number> Thermometer<'a, F> {
    pub(super) fn new(inputs: &FitInputs<'a>) -> Self {
        let (low_k, high_k, coldest_k, hottest_k) = match inputs.range {
            None => (0.0, f64::INFINITY, 0.0, f64::INFINITY),
            Some(range) => {
                let (cold, hot) = (1.0 / range.low_k, 1.0 / range.high_k);
                let margin = EXTRAPOLATION_MAX * (cold - hot);
                // A limit beyond 1/T = 0 is none.
                let hottest_k = if hot > margin { 1.0 / (hot - margin) } else { f64::INFINITY };
                (range.low_k, range.high_k, 1.0 / (cold + margin), hottest_k)
            }
        };
        Self {
            plate: F::of(inputs.emissivity_plate),
            far: F::of(inputs.far_window_counts),
            a_counts: F::of(inputs.curve.a_counts),
            scale: F::of(C2_UM_K / inputs.curve.a_um),
            shift_k: F::of(inputs.curve.b_um_k / inputs.curve.a_um),
            steepness: F::of(inputs.curve.a_um / C2_UM_K),
            ln2: F::of(std::f64::consts::LN_2),
            low_k: F::of(low_k),
            high_k: F::of(high_k),
            coldest_k: F::of(coldest_k),
            hottest_k: F::of(hottest_k),
            residual: inputs.residual,
        }
    }

    /// Turns crossings into temperatures in place; NaN outside the calibration.
    #[inline(always)]
    pub(super) fn read(&self, crossings: &mut [F]) {
        match self.residual {
            None => self.read_by(&|kelvin| (kelvin, F::of(1.0)), crossings),
            Some(residual) => self.read_by(&|kelvin| corrected(residual, kelvin), crossings),
        }
    }

    #[inline(always)]
    fn read_by(&self, corrected: &impl Fn(F) -> (F, F), crossings: &mut [F]) {
        // A copy, so that no choice between its numbers becomes one between places in memory: those are gathered.
        let own = *self;
        for value in crossings {
            let kelvin = corrected(own.body(own.counts(*value)).kelvin).0;
            *value = if own.outside(kelvin) { F::NAN } else { kelvin };
        }
    }

    /// The same with flags where they are [`ASKED`] for, whose mark is taken off, and standard deviations of the
    /// crossings into kelvins.
    #[inline(always)]
    pub(super) fn read_flagged<const N: usize>(
        &self,
        crossings: &mut [F],
        sigmas: [&mut [F]; N],
        flags: &mut [u32],
    ) {
        match self.residual {
            None => self.read_flagged_by(&|kelvin| (kelvin, F::of(1.0)), crossings, sigmas, flags),
            Some(residual) => {
                self.read_flagged_by(&|kelvin| corrected(residual, kelvin), crossings, sigmas, flags);
            }
        }
    }

    #[inline(always)]
    fn read_flagged_by<const N: usize>(
        &self,
        corrected: &impl Fn(F) -> (F, F),
        crossings: &mut [F],
        mut sigmas: [&mut [F]; N],
        flags: &mut [u32],
    ) {
        let n = crossings.len();
        let flags = &mut flags[..n];
        for sigmas in &mut sigmas {
            *sigmas = &mut std::mem::take(sigmas)[..n];
        }
        let own = *self;
        for i in 0..n {
            let body = own.body(own.counts(crossings[i]));
            let (kelvin, by_equation) = corrected(body.kelvin);
            let light = body.lit && kelvin.is_number();
            let outside = own.outside(kelvin);
            let inside = own.low_k <= kelvin && kelvin <= own.high_k;
            let bits = if !light {
                flag::NO_RADIANCE
            } else if outside {
                flag::OUT_OF_RANGE
            } else if inside {
                0
            } else {
                flag::EXTRAPOLATED
            };
            let before = flags[i];
            flags[i] = (before & !ASKED) | if before & ASKED == 0 { 0 } else { bits };
            let known = light && !outside;
            let slope = own.plate * body.slope * by_equation;
            for sigmas in &mut sigmas {
                // One NaN where nothing is known: the sign of a product of two depends on how it was compiled.
                let sigma_k = sigmas[i] * slope;
                sigmas[i] = if known { sigma_k } else { F::NAN };
            }
            crossings[i] = if known { kelvin } else { F::NAN };
        }
    }

    #[inline(always)]
    fn counts(&self, crossing: F) -> F {
        self.plate * (crossing + self.far)
    }

    /// NaN and everything beyond 10 % of the range in 1/T.
    #[inline(always)]
    fn outside(&self, kelvin: F) -> bool {
        let inside = self.coldest_k <= kelvin && kelvin <= self.hottest_k;
        !inside
    }

    /// Temperature of a black body of these counts, and its slope: dT/dI = w²/(I (1 + I/A) c2 a) with w = a T + b.
    #[inline(always)]
    fn body(&self, counts: F) -> Body<F> {
        let lit = F::LEAST <= counts && counts.is_number();
        let counts = if lit { counts } else { self.a_counts };
        let whole = counts + self.a_counts;
        let width = self.scale / logarithm(whole, counts, self.a_counts, self.ln2);
        // w = a·width, so that w²/(c2 a) = width²·a/c2.
        let slope = width * width * (self.steepness * self.a_counts) / (counts * whole);
        let kelvin = if lit { width - self.shift_k } else { F::NAN };
        Body { kelvin, slope, lit }
    }
}

/// Temperature for one of the equation, and their ratio of small changes.
fn corrected<F: Number>(residual: &Residual, equation: F) -> (F, F) {
    let (kelvin, slope) = residual.apply(equation.wide());
    (F::of(kelvin), F::of(slope))
}

/// ln(whole/part) for whole = part + more, all normal numbers > 0: k·ln 2 and the series of the inverse hyperbolic
/// tangent, one division in all. Within three ulps of the result, and an ulp of `whole` over `part`.
#[inline(always)]
fn logarithm<F: Number>(whole: F, part: F, more: F, ln2: F) -> F {
    let (k, lifted) = whole.lift(part);
    // Exact for neighbours within a factor of two; where `more` is the smaller, what rounding took from `whole` comes back.
    let off = if F::of(0.0) < k { whole - lifted } else { more };
    let s = off / (whole + lifted);
    let z = s * s;
    let mut sum = F::of(0.0);
    for &c in F::LOGARITHM.iter().rev() {
        sum = sum * z + F::of(c);
    }
    k * ln2 + ((s + s) + s * (z * sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against the C library's logarithm, over all quotients that a curve can have.
        #[test]
        fn logarithm_is_the_librarys(exponent in -200..40_i32, m in 1.0..2.0_f64, more in 1.0..1e9_f64) {
            let part = more * m * 2.0_f64.powi(exponent);
            let (got, want) = (logarithm(part + more, part, more, std::f64::consts::LN_2), libm::log1p(more / part));
            prop_assert!((got - want).abs() <= 4.0 * f64::EPSILON * want.abs(), "{part:e}: {got} {want}");
        }

        #[test]
        fn short_logarithm_is_the_librarys(exponent in -80..10_i32, m in 1.0..2.0_f32, more in 1.0..1e9_f32) {
            let part = more * m * 2.0_f32.powi(exponent);
            let got = f64::from(logarithm(part + more, part, more, std::f32::consts::LN_2));
            let want = libm::log1p(f64::from(more) / f64::from(part));
            prop_assert!((got - want).abs() <= 4.0 * f64::from(f32::EPSILON) * want.abs(), "{part:e}: {got} {want}");
        }
    }
}
