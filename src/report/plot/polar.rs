//! Polar plots of scattering: angle from the forward direction, logarithmic radius, mirrored about the axis of the light.

use super::axis::power_label;
use super::{HEIGHT, PALETTE, WIDTH};
use crate::report::escape;

/// Decades that are drawn at most; what is weaker lies in the centre.
const DECADES_MAX: i32 = 7;
/// Radius of the outer circle.
const RADIUS: f64 = 150.0;
/// Radius where the lowest decade begins, so that the centre stays readable.
const HOLE: f64 = 12.0;
const CENTRE: (f64, f64) = (0.42 * WIDTH, 0.51 * HEIGHT);

/// A polar plot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polar {
    /// Above the legend: what the radius is.
    pub label: String,
    /// What is drawn, in order.
    pub curves: Vec<Curve>,
}

/// A quantity over the scattering angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// In the legend.
    pub name: String,
    /// (angle in degrees from forward, 0 … 180; value above 0); others are gaps.
    pub points: Vec<(f64, f64)>,
}

/// Decades of the radius: centre and outer circle.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Decades {
    low: i32,
    high: i32,
}

impl Decades {
    fn around(curves: &[Curve]) -> Option<Self> {
        let values =
            curves.iter().flat_map(|curve| &curve.points).map(|p| p.1).filter(|v| v.is_finite() && *v > 0.0);
        let (low, high) = values.fold((f64::INFINITY, 0.0f64), |span, v| (span.0.min(v), span.1.max(v)));
        if high <= 0.0 {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "decades of doubles: a few hundred")]
        let (low, high) = (libm::floor(libm::log10(low)) as i32, libm::ceil(libm::log10(high) - 1e-9) as i32);
        let high = high.max(low + 1);
        Some(Self { low: low.max(high - DECADES_MAX), high })
    }

    /// Distance from the centre.
    fn reach(self, value: f64) -> f64 {
        let share = (libm::log10(value) - f64::from(self.low)) / f64::from(self.high - self.low);
        HOLE + (RADIUS - HOLE) * share.clamp(-HOLE / (RADIUS - HOLE), 1.0)
    }
}

/// Where a direction and a distance lie; forward is to the right, `side` 1 up or −1 down.
fn at(theta_deg: f64, reach: f64, side: f64) -> (f64, f64) {
    let theta = theta_deg.to_radians();
    (CENTRE.0 + reach * libm::cos(theta), CENTRE.1 - side * reach * libm::sin(theta))
}

impl Polar {
    /// The drawing, as large as a [`super::Plot`]. Without a value to show it says so.
    pub(super) fn body(&self) -> String {
        let Some(decades) = Decades::around(&self.curves) else {
            return format!("<text x=\"{}\" y=\"{}\">no data</text>\n", CENTRE.0 - 30.0, CENTRE.1);
        };
        let mut out = String::new();
        grid(decades, &mut out);
        for (index, curve) in self.curves.iter().enumerate() {
            let colour = PALETTE[index % PALETTE.len()];
            for side in [1.0, -1.0] {
                let path = path(curve, decades, side);
                out +=
                    &format!("<path d=\"{path}\" stroke=\"{colour}\" stroke-width=\"1.6\" fill=\"none\"/>\n");
            }
        }
        labels(decades, &mut out);
        self.legend(&mut out);
        out
    }

    fn legend(&self, out: &mut String) {
        let x = CENTRE.0 + RADIUS + 50.0;
        *out += &format!("<text x=\"{x}\" y=\"34\">{}</text>\n", escape(&self.label));
        for (index, curve) in self.curves.iter().enumerate() {
            let colour = PALETTE[index % PALETTE.len()];
            #[expect(clippy::cast_precision_loss, reason = "a few curves")]
            let y = 56.0 + 19.0 * index as f64;
            *out += &format!(
                "<path d=\"M{x} {:.1}h18\" stroke=\"{colour}\" stroke-width=\"2.4\"/><text x=\"{}\" y=\"{y}\">{}</text>\n",
                y - 4.0,
                x + 24.0,
                escape(&curve.name)
            );
        }
    }
}

fn path(curve: &Curve, decades: Decades, side: f64) -> String {
    let mut path = String::new();
    let mut pen = 'M';
    for &(theta, value) in &curve.points {
        if value.is_finite() && value > 0.0 && theta.is_finite() {
            let (x, y) = at(theta, decades.reach(value), side);
            path += &format!("{pen}{x:.2} {y:.2}");
            pen = 'L';
        } else {
            pen = 'M';
        }
    }
    path
}

fn grid(decades: Decades, out: &mut String) {
    let (x, y) = CENTRE;
    for decade in decades.low..=decades.high {
        let reach = decades.reach(libm::pow(10.0, f64::from(decade)));
        let colour = if decade == decades.high { "#5b6675" } else { "#dfe3e9" };
        *out += &format!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{reach:.2}\" stroke=\"{colour}\" fill=\"none\"/>\n"
        );
    }
    for spoke in 0..12 {
        let theta = 30.0 * f64::from(spoke);
        let ((x0, y0), (x1, y1)) = (at(theta, HOLE, 1.0), at(theta, RADIUS, 1.0));
        *out += &format!("<path d=\"M{x0:.2} {y0:.2}L{x1:.2} {y1:.2}\" stroke=\"#e6e9ee\"/>\n");
    }
}

fn labels(decades: Decades, out: &mut String) {
    for (theta, side) in [0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0]
        .into_iter()
        .map(|t| (t, 1.0))
        .chain([30.0, 60.0, 90.0, 120.0, 150.0].into_iter().map(|t| (t, -1.0)))
    {
        let (x, y) = at(theta, RADIUS + 8.0, side);
        let cosine = libm::cos(theta.to_radians());
        let anchor = if cosine > 0.1 {
            "start"
        } else if cosine < -0.1 {
            "end"
        } else {
            "middle"
        };
        // Text stands on its base line: from the middle upwards no shift, from the middle downwards its height.
        let base = y + 4.0 - 4.0 * side * libm::sin(theta.to_radians());
        *out += &format!("<text x=\"{x:.2}\" y=\"{base:.2}\" text-anchor=\"{anchor}\">{theta}°</text>\n");
    }
    let every = if decades.high - decades.low > 4 { 2 } else { 1 };
    for decade in (decades.low..=decades.high).filter(|d| (decades.high - d) % every == 0) {
        let (x, y) = at(105.0, decades.reach(libm::pow(10.0, f64::from(decade))), -1.0);
        // White behind the label, so that no curve runs through it.
        *out += &format!(
            "<text x=\"{x:.2}\" y=\"{:.2}\" text-anchor=\"middle\" font-size=\"10\" stroke=\"#fff\" stroke-width=\"3\" paint-order=\"stroke\" fill=\"#5b6675\">{}</text>\n",
            y + 3.5,
            power_label(1, decade)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(points: &[(f64, f64)]) -> Curve {
        Curve { name: "a < b".into(), points: points.to_vec() }
    }

    #[test]
    fn a_decade_is_a_circle_and_forward_is_right() {
        let decades = Decades::around(&[curve(&[(0.0, 1000.0), (180.0, 0.011)])]).unwrap();
        assert_eq!(decades, Decades { low: -2, high: 3 });
        assert!((decades.reach(1000.0) - RADIUS).abs() < 1e-9 && (decades.reach(0.01) - HOLE).abs() < 1e-9);
        assert!((decades.reach(10.0) - HOLE - 0.6 * (RADIUS - HOLE)).abs() < 1e-9);
        let ((x, y), (_, up)) = (at(0.0, 10.0, 1.0), at(90.0, 10.0, 1.0));
        assert!(x > CENTRE.0 && (y - CENTRE.1).abs() < 1e-9 && up < CENTRE.1);
        // Weaker than seven decades is in the centre, not behind it.
        let deep = Decades::around(&[curve(&[(0.0, 1.0), (90.0, 1e-30)])]).unwrap();
        assert!((deep.high - deep.low) == DECADES_MAX && deep.reach(1e-30) == 0.0);
    }

    #[test]
    fn nasty_values_are_gaps() {
        for points in [&[][..], &[(0.0, f64::NAN)], &[(0.0, 0.0), (90.0, -1.0)]] {
            assert!(Polar { label: String::new(), curves: vec![curve(points)] }.body().contains("no data"));
        }
        let gap = Polar {
            label: "p".into(),
            curves: vec![curve(&[(0.0, 1.0), (60.0, f64::INFINITY), (90.0, 0.5), (180.0, 5e-324)])],
        };
        let body = gap.body();
        assert!(!body.contains("NaN") && !body.contains("inf") && body.contains("a &lt; b"), "{body}");
    }
}
