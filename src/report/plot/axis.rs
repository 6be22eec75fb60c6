//! One axis of a plot: which values lie where, linear or logarithmic, and its round ticks.

use crate::files::preview::{tick_label, tick_step, ticks};

/// Decades of a logarithmic axis that are labelled at most; of more, every second, third … is.
const DECADES_LABELLED_MAX: i32 = 8;
/// Decades of a logarithmic axis up to which 2 and 5 are labelled as well.
const DECADES_FINE_MAX: f64 = 3.2;
/// … and up to which every digit is.
const DECADES_FULL_MAX: f64 = 0.9;
/// Decades that a logarithmic axis may span.
const DECADES_MAX: f64 = 600.0;

/// How values are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scale {
    /// Equal differences are equal lengths.
    #[default]
    Linear,
    /// Equal ratios are equal lengths; values that are not above 0 are not drawn.
    Log,
}

impl Scale {
    /// Whether a value has a place on it.
    pub fn shows(self, value: f64) -> bool {
        value.is_finite() && (self == Self::Linear || value > 0.0)
    }
}

/// A mark on an axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    /// Where.
    pub(super) value: f64,
    /// Its label; empty for a line between labels.
    pub(super) label: String,
}

/// A range of values on a scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    low: f64,
    high: f64,
    scale: Scale,
}

impl Axis {
    /// Around values, with a little room at both ends; `None` when none of them can be shown.
    pub(super) fn around(values: impl Iterator<Item = f64>, scale: Scale) -> Option<Self> {
        let (low, high) = values
            .filter(|&value| scale.shows(value))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |span, v| (span.0.min(v), span.1.max(v)));
        if low > high {
            return None;
        }
        Some(match scale {
            Scale::Linear => {
                let room = 0.04 * (high - low).max(1e-9 * high.abs()).max(1e-9);
                Self { low: low - room, high: high + room, scale }
            }
            Scale::Log => {
                let ends = (libm::log10(low), libm::log10(high).min(libm::log10(low) + DECADES_MAX));
                let room = (0.02 * (ends.1 - ends.0)).max(0.02);
                let end = |decade: f64| libm::pow(10.0, decade.clamp(-300.0, 300.0));
                Self { low: end(ends.0 - room), high: end(ends.1 + room), scale }
            }
        })
    }

    /// Where a value lies: 0 at the low end, 1 at the high end, also outside.
    pub(super) fn place(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Log => libm::log(value / self.low) / libm::log(self.high / self.low),
        }
    }

    /// Whether a value lies between the ends.
    pub(super) fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// Whether a value can be drawn at all.
    pub(super) fn shows(&self, value: f64) -> bool {
        self.scale.shows(value)
    }

    /// Its ticks, ascending.
    pub(super) fn ticks(&self) -> Vec<Tick> {
        match self.scale {
            Scale::Linear => {
                let step = tick_step(self.high - self.low);
                ticks(self.low, self.high, step)
                    .into_iter()
                    .map(|value| Tick { value, label: tick_label(value, step) })
                    .collect()
            }
            Scale::Log => self.log_ticks(),
        }
    }

    fn log_ticks(&self) -> Vec<Tick> {
        let (first, last) = (libm::log10(self.low), libm::log10(self.high));
        let span = last - first;
        // Within a factor of about two the ticks of a linear axis say more.
        if span < 0.35 {
            return Self { scale: Scale::Linear, ..*self }.ticks();
        }
        #[expect(clippy::cast_possible_truncation, reason = "decades of doubles: a few hundred")]
        let (first, last) = (libm::floor(first) as i32, libm::ceil(last) as i32);
        let every = ((last - first) / DECADES_LABELLED_MAX).max(0) + 1;
        let mut marks = Vec::new();
        for decade in first..=last {
            let power = libm::pow(10.0, f64::from(decade));
            for digit in 1..10 {
                let value = power * f64::from(digit);
                let labelled = match digit {
                    1 => decade.rem_euclid(every) == 0,
                    2 | 5 => span <= DECADES_FINE_MAX,
                    _ => span <= DECADES_FULL_MAX,
                };
                let drawn = labelled || (every == 1 && span < 6.0) || digit == 1;
                if drawn && self.holds(value * (1.0 + 1e-12)) {
                    let label = if labelled { power_label(digit, decade) } else { String::new() };
                    marks.push(Tick { value, label });
                }
            }
        }
        marks
    }
}

/// A digit times a power of ten: plain where that is short.
pub(super) fn power_label(digit: i32, decade: i32) -> String {
    match decade {
        0..=3 => format!("{digit}{}", "0".repeat(usize::try_from(decade).unwrap_or(0))),
        -3..=-1 => format!("0.{}{digit}", "0".repeat(usize::try_from(-decade - 1).unwrap_or(0))),
        _ => {
            let raised: String = decade.to_string().chars().map(raised).collect();
            if digit == 1 { format!("10{raised}") } else { format!("{digit}·10{raised}") }
        }
    }
}

fn raised(sign: char) -> char {
    match sign {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '0' | '4'..='9' => char::from_u32('⁰' as u32 + sign as u32 - '0' as u32).unwrap_or(sign),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: Axis) -> Vec<String> {
        axis.ticks().into_iter().map(|tick| tick.label).filter(|label| !label.is_empty()).collect()
    }

    #[test]
    fn decades_are_labelled_and_evenly_spaced() {
        let axis = Axis::around([0.1, 50.0].into_iter(), Scale::Log).unwrap();
        assert_eq!(labels(axis), ["0.1", "0.2", "0.5", "1", "2", "5", "10", "20", "50"]);
        let step = axis.place(1.0) - axis.place(0.1);
        assert!((axis.place(10.0) - axis.place(1.0) - step).abs() < 1e-14);
        assert!(axis.place(0.1) > 0.0 && axis.place(50.0) < 1.0);
        let axis = Axis::around([1e-6, 1e4].into_iter(), Scale::Log).unwrap();
        assert_eq!(labels(axis), ["10⁻⁶", "10⁻⁴", "0.01", "1", "100", "10⁴"]);
        let axis = Axis::around([1.0, 4.0].into_iter(), Scale::Log).unwrap();
        assert_eq!(labels(axis), ["1", "2", "3", "4"]);
        let axis = Axis::around([300.0, 420.0].into_iter(), Scale::Log).unwrap();
        assert_eq!(labels(axis)[0], "300");
    }

    #[test]
    fn values_without_a_place_do_not_stretch_the_axis() {
        let with = Axis::around([0.0, -1.0, f64::NAN, f64::INFINITY, 2.0, 20.0].into_iter(), Scale::Log);
        assert_eq!(with, Axis::around([2.0, 20.0].into_iter(), Scale::Log));
        assert!(Axis::around([0.0, -1.0].into_iter(), Scale::Log).is_none());
        assert!(Axis::around([f64::NAN].into_iter(), Scale::Linear).is_none());
        for scale in [Scale::Linear, Scale::Log] {
            let one = Axis::around([7.0].into_iter(), scale).unwrap();
            assert!((one.place(7.0) - 0.5).abs() < 1e-6 && !one.ticks().is_empty(), "{one:?}");
        }
        let wide = Axis::around([5e-324, 1.7e308].into_iter(), Scale::Log).unwrap();
        assert!(wide.place(1.0).is_finite() && labels(wide).len() < 20);
    }
}
