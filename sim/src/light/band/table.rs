//! Fast tables of a band's signal over temperature, and of the temperature of a signal.
//!
//! ln S is nearly straight against 1/T: quintic Hermite pieces with exact first and second derivatives, equal steps of
//! 1/T. Never extrapolates.

use super::signal::{BandSignal, moments};
use super::{Band, BandError};

/// Pieces that the search begins and ends with.
const PIECES: [usize; 2] = [8, 8192];
/// Steps of Newton's method inside a piece; two to four are usual.
const ROUNDS_MAX: usize = 12;
/// Smallest error that can be asked for: the rounding of ln S (some 50) is 1e-14.
const ERROR_MIN: f64 = 1e-13;

/// Signal of black bodies over a range of temperatures, both ways.
#[derive(Debug, Clone)]
pub struct SignalTable {
    range_k: [f64; 2],
    /// 1/T at the first node (the hottest), and the step, in 1/K.
    first: f64,
    step: f64,
    /// Coefficients of ln S in powers of the place inside each piece (0 … 1).
    pieces: Vec<[f64; 6]>,
    /// ln S at the nodes, falling.
    ln_signal: Vec<f64>,
    error: f64,
}

impl SignalTable {
    /// Of a response's exact integral, between two temperatures in K, to a `relative` error of the signal (1e-9 is
    /// ample; at least 1e-13).
    ///
    /// # Errors
    ///
    /// [`BandError::Range`] unless 0 < low < high and the signal is a number all over the range; or when 8192 pieces
    /// do not reach the error.
    pub fn of_response(signal: &BandSignal, range_k: [f64; 2], relative: f64) -> Result<Self, BandError> {
        Self::new(range_k, relative, |t| signal.moments(t))
    }

    /// Of the samples of a band; as [`SignalTable::of_response`].
    ///
    /// # Errors
    ///
    /// As [`SignalTable::of_response`].
    pub fn of_band(band: &Band, range_k: [f64; 2], relative: f64) -> Result<Self, BandError> {
        Self::new(range_k, relative, |t| moments(band.samples(), t))
    }

    fn new(range_k: [f64; 2], relative: f64, exact: impl Fn(f64) -> [f64; 3]) -> Result<Self, BandError> {
        let [low, high] = range_k;
        let bad = |why: &str| Err(BandError::Range(format!("{low} to {high} K: {why}")));
        if !(low > 0.0 && high > low && high.is_finite()) {
            return bad("they must be above 0 and rise");
        }
        let relative = relative.max(ERROR_MIN);
        let mut count = PIECES[0];
        while count <= PIECES[1] {
            let (first, last) = (1.0 / high, 1.0 / low);
            let step = (last - first) / count as f64;
            let node = |i: usize| if i == count { last } else { first + step * i as f64 };
            let derivatives: Vec<[f64; 3]> =
                (0..=count).map(|i| logarithmic(exact(1.0 / node(i)), step)).collect();
            if derivatives.iter().flatten().any(|d| !d.is_finite()) {
                return bad("the signal is no ordinary number there");
            }
            let pieces: Vec<[f64; 6]> =
                derivatives.windows(2).map(|ends| hermite(ends[0], ends[1])).collect();
            let mut worst = 0.0_f64;
            for (i, piece) in pieces.iter().enumerate() {
                for place in [0.25, 0.5, 0.75] {
                    let wanted = exact(1.0 / (node(i) + step * place))[0].ln();
                    worst = worst.max((polynomial(piece, place) - wanted).abs());
                }
            }
            // The error is largest in the middle of a piece, where it was measured; twice that is stated.
            if 2.0 * worst <= relative && pieces.iter().all(falls) {
                let ln_signal = derivatives.iter().map(|d| d[0]).collect();
                return Ok(Self {
                    range_k,
                    first,
                    step,
                    pieces,
                    ln_signal,
                    error: (2.0 * worst).max(ERROR_MIN),
                });
            }
            count *= 2;
        }
        bad("a table of 8192 pieces does not reach the error that was asked for")
    }

    /// Temperatures of the ends, K.
    pub fn range_k(&self) -> [f64; 2] {
        self.range_k
    }

    /// Relative error of the signal: twice the largest that was measured between the nodes. The relative error of a
    /// temperature is smaller by ∂ ln S/∂ ln T.
    pub fn relative_error(&self) -> f64 {
        self.error
    }

    /// Number of pieces.
    pub fn pieces(&self) -> usize {
        self.pieces.len()
    }

    /// Signal of a black body; `None` outside the range.
    pub fn signal(&self, temperature_k: f64) -> Option<f64> {
        if !(temperature_k >= self.range_k[0] && temperature_k <= self.range_k[1]) {
            return None;
        }
        let place = ((1.0 / temperature_k - self.first) / self.step).max(0.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 8192 by the range")]
        let index = (place as usize).min(self.pieces.len() - 1);
        Some(polynomial(&self.pieces[index], place - index as f64).exp())
    }

    /// Temperature of a black body with this signal, in K; `None` outside the range. Inverse of
    /// [`SignalTable::signal`] to rounding.
    pub fn temperature(&self, signal: f64) -> Option<f64> {
        let wanted = signal.ln();
        let last = self.ln_signal.len() - 1;
        // The ends are met to rounding.
        let slack = 1e-14 * self.ln_signal[0].abs().max(1.0);
        if !(wanted <= self.ln_signal[0] + slack && wanted >= self.ln_signal[last] - slack) {
            return None;
        }
        let index = self.ln_signal.partition_point(|&ln| ln >= wanted).clamp(1, last) - 1;
        let piece = &self.pieces[index];
        let (left, right) = (self.ln_signal[index], self.ln_signal[index + 1]);
        let mut place = ((left - wanted) / (left - right)).clamp(0.0, 1.0);
        for _ in 0..ROUNDS_MAX {
            let (value, slope) = with_slope(piece, place);
            let next = (place - (value - wanted) / slope).clamp(0.0, 1.0);
            let moved = (next - place).abs();
            place = next;
            // Quadratic: the step after one of 1e-8 is below rounding.
            if moved < 1e-8 {
                break;
            }
        }
        Some(1.0 / (self.first + self.step * (index as f64 + place)))
    }
}

/// ln S and its derivatives by the place inside a piece of this width.
fn logarithmic([value, slope, curvature]: [f64; 3], step: f64) -> [f64; 3] {
    if !(value.is_normal() && value > 0.0) {
        return [f64::NAN; 3];
    }
    let ratio = slope / value;
    [value.ln(), ratio * step, (curvature / value - ratio * ratio) * step * step]
}

/// The quintic with these values and derivatives at 0 and 1.
fn hermite([f0, d0, s0]: [f64; 3], [f1, d1, s1]: [f64; 3]) -> [f64; 6] {
    // What is left of value, slope and curvature at 1 after the first three terms.
    let value = f1 - f0 - d0 - 0.5 * s0;
    let slope = d1 - d0 - s0;
    let curvature = s1 - s0;
    [
        f0,
        d0,
        0.5 * s0,
        10.0 * value - 4.0 * slope + 0.5 * curvature,
        -15.0 * value + 7.0 * slope - curvature,
        6.0 * value - 3.0 * slope + 0.5 * curvature,
    ]
}

fn polynomial(c: &[f64; 6], t: f64) -> f64 {
    c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
}

fn with_slope(c: &[f64; 6], t: f64) -> (f64, f64) {
    let slope = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5])));
    (polynomial(c, t), slope)
}

/// Whether a piece falls all along: the Bernstein coefficients of its derivative are negative, between which the
/// derivative lies.
fn falls(c: &[f64; 6]) -> bool {
    let d = [c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c[4], 5.0 * c[5]];
    // Of t^k in Bernstein's basis of degree 4: C(j, k)/C(4, k) at j.
    [
        d[0],
        d[0] + d[1] / 4.0,
        d[0] + d[1] / 2.0 + d[2] / 6.0,
        d[0] + 0.75 * d[1] + 0.5 * d[2] + 0.25 * d[3],
        d[0] + d[1] + d[2] + d[3] + d[4],
    ]
    .iter()
    .all(|&b| b < 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::Response;
    use super::*;

    fn open_band() -> Response {
        Response::shipped(&["QE_InSb_model", "lens_transmission_model"]).unwrap()
    }

    #[test]
    fn a_table_holds_the_error_it_states_between_its_nodes() {
        for response in [Response::filtered_insb().unwrap(), open_band()] {
            let exact = BandSignal::new(&response, 100.0);
            for (range, relative) in
                [([200.0, 1000.0], 1e-9), ([290.0, 700.0], 1e-12), ([100.0, 3000.0], 1e-9)]
            {
                let table = SignalTable::of_response(&exact, range, relative).unwrap();
                assert!(table.relative_error() <= relative);
                println!("{range:?} {relative:e}: {} pieces, {:e}", table.pieces(), table.relative_error());
                // 997 temperatures, at no special places.
                let mut before = 0.0;
                for i in 0..=997 {
                    let t = range[0] + (range[1] - range[0]) * f64::from(i) / 997.0;
                    let (found, wanted) = (table.signal(t).unwrap(), exact.signal(t));
                    // Rounding of ln S: 60 ulp at 1e24.
                    let allowed = table.relative_error() + 2e-14;
                    assert!((found / wanted - 1.0).abs() <= allowed, "{t}: {}", found / wanted - 1.0);
                    assert!(found > before, "{t} K: the signal does not rise");
                    before = found;
                    let back = table.temperature(found).unwrap();
                    assert!((back / t - 1.0).abs() < 1e-14, "{t}: {back}");
                    let of_exact = table.temperature(
                        wanted.clamp(table.signal(range[0]).unwrap(), table.signal(range[1]).unwrap()),
                    );
                    assert!((of_exact.unwrap() / t - 1.0).abs() <= allowed);
                }
            }
        }
    }

    #[test]
    fn outside_a_table_there_is_no_answer() {
        let band = Band::monochromatic(3.4);
        let table = SignalTable::of_band(&band, [300.0, 600.0], 1e-9).unwrap();
        for t in [299.9, 600.1, 0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(table.signal(t), None, "{t}");
        }
        for t in [299.0, 601.0] {
            assert_eq!(table.temperature(band.signal(t)), None, "{t}");
        }
        // 0 K and no signal have a logarithm without number.
        for signal in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(table.temperature(signal), None, "{signal}");
        }
        for range in [[0.0, 300.0], [300.0, 300.0], [300.0, f64::INFINITY], [f64::NAN, 300.0], [1.0, 300.0]] {
            assert!(SignalTable::of_band(&band, range, 1e-9).is_err(), "{range:?}");
        }
    }
}
