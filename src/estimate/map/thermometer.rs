//! From crossings to temperatures: a row at a time, with a logarithm that vectors can do.

use super::lanes::Number;
use super::{FitInputs, flag};
use crate::estimate::calibration::{C2_UM_K, EXTRAPOLATION_MAX, Residual};

/// I_cal(T_eff) = ε_B·(S + E_f), inverted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thermometer<'a, F> {
    plate: F,
    far: F,
    a_counts: F,
    a_um: F,
    b_um_k: F,
    c2: F,
    /// Calibrated temperatures, and the least and the greatest 1/T of extrapolation.
    low_k: F,
    high_k: F,
    cold: F,
    hot: F,
    residual: Option<&'a Residual>,
}

impl<'a, F: Number> Thermometer<'a, F> {
    pub(super) fn new(inputs: &FitInputs<'a>) -> Self {
        let (low_k, high_k, cold, hot) = match inputs.range {
            None => (0.0, f64::INFINITY, f64::INFINITY, 0.0),
            Some(range) => {
                let (cold, hot) = (1.0 / range.low_k, 1.0 / range.high_k);
                let margin = EXTRAPOLATION_MAX * (cold - hot);
                (range.low_k, range.high_k, cold + margin, hot - margin)
            }
        };
        Self {
            plate: F::of(inputs.emissivity_plate),
            far: F::of(inputs.far_window_counts),
            a_counts: F::of(inputs.curve.a_counts),
            a_um: F::of(inputs.curve.a_um),
            b_um_k: F::of(inputs.curve.b_um_k),
            c2: F::of(C2_UM_K),
            low_k: F::of(low_k),
            high_k: F::of(high_k),
            cold: F::of(cold),
            hot: F::of(hot),
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
        for value in crossings {
            let counts = self.counts(*value);
            let kelvin = corrected(self.kelvin(counts)).0;
            *value = if self.outside(kelvin) { F::NAN } else { kelvin };
        }
    }

    /// The same with flags where `asked` is 1, and the crossings' standard deviations into kelvins.
    #[inline(always)]
    pub(super) fn read_flagged(
        &self,
        crossings: &mut [F],
        sigmas: [&mut [F]; 2],
        asked: &[F],
        flags: &mut [u32],
    ) {
        match self.residual {
            None => self.read_flagged_by(&|kelvin| (kelvin, F::of(1.0)), crossings, sigmas, asked, flags),
            Some(residual) => {
                self.read_flagged_by(&|kelvin| corrected(residual, kelvin), crossings, sigmas, asked, flags);
            }
        }
    }

    #[inline(always)]
    fn read_flagged_by(
        &self,
        corrected: &impl Fn(F) -> (F, F),
        crossings: &mut [F],
        [sigmas, noises]: [&mut [F]; 2],
        asked: &[F],
        flags: &mut [u32],
    ) {
        let zero = F::of(0.0);
        let each = crossings.iter_mut().zip(sigmas.iter_mut().zip(noises.iter_mut()));
        for (((value, (sigma, noise)), &asked), flags) in each.zip(asked).zip(flags.iter_mut()) {
            let counts = self.counts(*value);
            let equation = self.kelvin(counts);
            let (kelvin, by_equation) = corrected(equation);
            let light = zero < counts && kelvin.is_number();
            let outside = self.outside(kelvin);
            let inside = self.low_k <= kelvin && kelvin <= self.high_k;
            let bits = if !light {
                flag::NO_RADIANCE
            } else if outside {
                flag::OUT_OF_RANGE
            } else if inside {
                0
            } else {
                flag::EXTRAPOLATED
            };
            *flags |= if zero < asked { bits } else { 0 };
            let known = light && !outside;
            let kept = if known { equation } else { F::NAN };
            // dT/dI = w²/(I (1 + I/A) c2 a) with w = a T + b.
            let w = self.a_um * kept + self.b_um_k;
            let slope = w * w / (counts * (F::of(1.0) + counts / self.a_counts) * self.c2 * self.a_um);
            let slope = self.plate * slope * by_equation;
            // One NaN where nothing is known: the sign of a product of two depends on how it was compiled.
            let (sigma_k, noise_k) = (*sigma * slope, *noise * slope);
            *sigma = if known { sigma_k } else { F::NAN };
            *noise = if known { noise_k } else { F::NAN };
            *value = if known { kelvin } else { F::NAN };
        }
    }

    #[inline(always)]
    fn counts(&self, crossing: F) -> F {
        self.plate * (crossing + self.far)
    }

    /// NaN and everything beyond 10 % of the range in 1/T.
    #[inline(always)]
    fn outside(&self, kelvin: F) -> bool {
        let at = F::of(1.0) / kelvin;
        let inside = self.low_k <= kelvin && kelvin <= self.high_k;
        let near = F::of(0.0) < kelvin && at <= self.cold && self.hot <= at;
        !(inside || near)
    }

    /// Temperature of a black body of these counts; NaN for none.
    #[inline(always)]
    fn kelvin(&self, counts: F) -> F {
        let (zero, one) = (F::of(0.0), F::of(1.0));
        let x = self.a_counts / counts;
        let u = one + x;
        let lit = zero < counts && u.is_number();
        let u = if lit { u } else { one + one };
        // ln(1 + x) = ln(u) + (what rounding took from x)/u.
        let lost = if lit { x - (u - one) } else { zero };
        let kelvin = (self.c2 / (logarithm(u) + lost / u) - self.b_um_k) / self.a_um;
        if lit { kelvin } else { F::NAN }
    }
}

/// Temperature for one of the equation, and their ratio of small changes.
fn corrected<F: Number>(residual: &Residual, equation: F) -> (F, F) {
    let (kelvin, slope) = residual.apply(equation.wide());
    (F::of(kelvin), F::of(slope))
}

/// ln(u) of a normal number u > 0, to an ulp: FreeBSD's e_log.c by K. C. Ng, without its branches.
#[inline(always)]
fn logarithm<F: Number>(u: F) -> F {
    let (k, m) = u.split();
    let f = m - F::of(1.0);
    let s = f / (F::of(2.0) + f);
    let z = s * s;
    let w = z * z;
    let even = w
        * (F::of(3.999_999_999_940_942e-1)
            + w * (F::of(2.222_219_843_214_978_4e-1) + w * F::of(1.531_383_769_920_937_3e-1)));
    let odd = z
        * (F::of(6.666_666_666_666_735e-1)
            + w * (F::of(2.857_142_874_366_239e-1)
                + w * (F::of(1.818_357_216_161_805e-1) + w * F::of(1.479_819_860_511_658_6e-1))));
    let half_square = F::of(0.5) * f * f;
    let high = F::of(F::LN2_HIGH);
    let low = F::of(F::LN2_LOW);
    k * high - ((half_square - (s * (half_square + (even + odd)) + k * low)) - f)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against the C library's logarithm, at any exponent: two ulps of the result and one of the argument's.
        #[test]
        fn logarithm_is_the_librarys(exponent in -1000..1000_i32, m in 1.0..2.0_f64) {
            let u = m * 2.0_f64.powi(exponent);
            let (got, want) = (logarithm(u), libm::log(u));
            prop_assert!((got - want).abs() <= 2.0 * f64::EPSILON * want.abs() + 1e-16, "{u:e}: {got} {want}");
        }

        #[test]
        fn short_logarithm_is_the_librarys(exponent in -120..120_i32, m in 1.0..2.0_f32) {
            let u = m * 2.0_f32.powi(exponent);
            let (got, want) = (f64::from(logarithm(u)), libm::log(f64::from(u)));
            prop_assert!((got - want).abs() <= 2.0 * f64::from(f32::EPSILON) * want.abs() + 1e-7, "{u:e}: {got} {want}");
        }
    }
}
