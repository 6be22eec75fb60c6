//! Line and point plots as inline SVG: axes with round ticks, error bars, a legend.

use super::escape;
use crate::estimate::calibration::{CalibrationFit, CalibrationPoint};
use crate::files::preview::{tick_label, tick_step, ticks};

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 380.0;
const LEFT: f64 = 72.0;
const RIGHT: f64 = 18.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 52.0;

/// Colours of the series in order (Okabe–Ito: told apart by colour-blind eyes), repeated after the last.
const PALETTE: [&str; 5] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9"];

/// Points that a series draws at most; longer ones are thinned evenly.
const POINTS_MAX: usize = 4000;

/// A plot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plot {
    /// Under the horizontal axis, with unit.
    pub x_label: String,
    /// Beside the vertical axis, with unit.
    pub y_label: String,
    /// What is drawn, in order.
    pub series: Vec<Series>,
    /// Vertical lines with a name, e.g. a crossing.
    pub marks: Vec<(f64, String)>,
    /// Draws the line y = 0.
    pub zero: bool,
}

/// One curve or set of points.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// In the legend; empty for none.
    pub name: String,
    /// Its points; those that are not finite are gaps.
    pub points: Vec<Point>,
    /// How they are drawn.
    pub style: Style,
}

/// A point with its error bar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Horizontal place.
    pub x: f64,
    /// Vertical place.
    pub y: f64,
    /// Half length of the error bar; zero or NaN for none.
    pub sigma: f64,
}

impl Point {
    /// A point without error bar.
    pub fn new(x: f64, y: f64) -> Self {
        Self { x, y, sigma: 0.0 }
    }
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// Joined by a line.
    Line,
    /// Dots with error bars.
    Dots,
}

/// A calibration: the curve, its points, and how far they are off is told by the bars.
pub fn calibration(fit: &CalibrationFit, points: &[CalibrationPoint]) -> Plot {
    let dots =
        points.iter().map(|p| Point { x: p.temperature_k, y: p.counts, sigma: p.sigma_counts }).collect();
    let (low, high) = (fit.range.low_k, fit.range.high_k);
    let curve = (0..=120)
        .map(|i| low + (high - low) * f64::from(i) / 120.0)
        .map(|t| Point::new(t, fit.curve.value(t) + fit.offset_counts))
        .collect();
    Plot {
        x_label: "plate temperature / K".into(),
        y_label: "counts".into(),
        series: vec![
            Series { name: "fitted curve".into(), points: curve, style: Style::Line },
            Series { name: "points".into(), points: dots, style: Style::Dots },
        ],
        ..Plot::default()
    }
}

/// The line of one pixel through its levels (the paper's Fig. 5); `levels` hold x, mean of spray − blank and the
/// mean's standard deviation.
pub fn pixel_line(levels: &[Point], slope: f64, offset: f64, name: &str) -> Plot {
    let crossing = -offset / slope;
    let finite = levels.iter().map(|p| p.x).filter(|x| x.is_finite());
    let low = finite.clone().fold(f64::INFINITY, f64::min);
    let high = finite.fold(f64::NEG_INFINITY, f64::max);
    let inside = crossing.is_finite() && crossing > low - (high - low) && crossing < high + (high - low);
    let (low, high) = if inside { (low.min(crossing), high.max(crossing)) } else { (low, high) };
    let line = [low, high].map(|x| Point::new(x, slope * x + offset)).to_vec();
    let marks = if inside { vec![(crossing, format!("S = {crossing:.2}"))] } else { Vec::new() };
    Plot {
        x_label: "x = plate signal behind the far window / counts".into(),
        y_label: "spray − blank / counts".into(),
        series: vec![
            Series { name: "fit".into(), points: line, style: Style::Line },
            Series { name: name.into(), points: levels.to_vec(), style: Style::Dots },
        ],
        marks,
        zero: true,
    }
}

/// Plate temperature against time; one series for readings, one for set-points.
pub fn plate_temperature(readings: &[(f64, f64)], set_points: &[(f64, f64)]) -> Plot {
    let series = |name: &str, values: &[(f64, f64)]| Series {
        name: name.into(),
        points: values.iter().map(|&(t, v)| Point::new(t, v)).collect(),
        style: Style::Line,
    };
    Plot {
        x_label: "time / s".into(),
        y_label: "plate temperature / K".into(),
        series: vec![series("reading", readings), series("set-point", set_points)],
        ..Plot::default()
    }
}

impl Plot {
    /// The `<svg>` element as HTML takes it, without a name space. Without a finite point it says so.
    pub fn to_svg(&self) -> String {
        let mut out = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" \
             height=\"{HEIGHT}\" font-family=\"system-ui,sans-serif\" font-size=\"12\" fill=\"#1c2430\">\n"
        );
        match Frame::around(self) {
            Some(frame) => {
                frame.axes(self, &mut out);
                for (index, series) in self.series.iter().enumerate() {
                    frame.series(series, PALETTE[index % PALETTE.len()], &mut out);
                }
                frame.marks(self, &mut out);
                legend(self, &mut out);
            }
            None => out += &format!("<text x=\"{LEFT}\" y=\"{}\">no data</text>\n", HEIGHT / 2.0),
        }
        out + "</svg>\n"
    }
}

/// Where values lie on the page.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn around(plot: &Plot) -> Option<Self> {
        let points =
            || plot.series.iter().flat_map(|s| &s.points).filter(|p| p.x.is_finite() && p.y.is_finite());
        points().next()?;
        let bar = |p: &Point| if p.sigma.is_finite() { p.sigma } else { 0.0 };
        let span = |low: f64, high: f64| {
            let room = 0.04 * (high - low).max(1e-9 * high.abs()).max(1e-9);
            (low - room, high + room)
        };
        let fold = |values: &dyn Fn(&Point) -> (f64, f64)| {
            points().map(values).fold((f64::INFINITY, f64::NEG_INFINITY), |s, v| (s.0.min(v.0), s.1.max(v.1)))
        };
        let (left, right) = fold(&|p| (p.x, p.x));
        let (mut low, mut high) = fold(&|p| (p.y - bar(p), p.y + bar(p)));
        if plot.zero {
            (low, high) = (low.min(0.0), high.max(0.0));
        }
        Some(Self { x: span(left, right), y: span(low, high) })
    }

    fn px(&self, x: f64) -> f64 {
        LEFT + (x - self.x.0) / (self.x.1 - self.x.0) * (WIDTH - LEFT - RIGHT)
    }

    fn py(&self, y: f64) -> f64 {
        HEIGHT - BOTTOM - (y - self.y.0) / (self.y.1 - self.y.0) * (HEIGHT - TOP - BOTTOM)
    }

    fn axes(&self, plot: &Plot, out: &mut String) {
        let (bottom, right) = (HEIGHT - BOTTOM, WIDTH - RIGHT);
        let step = tick_step(self.x.1 - self.x.0);
        for tick in ticks(self.x.0, self.x.1, step) {
            let x = self.px(tick);
            *out += &format!("<path d=\"M{x:.2} {TOP}V{bottom}\" stroke=\"#e6e9ee\"/>");
            let (y, label) = (bottom + 17.0, tick_label(tick, step));
            *out += &format!("<text x=\"{x:.2}\" y=\"{y}\" text-anchor=\"middle\">{label}</text>\n");
        }
        let step = tick_step(self.y.1 - self.y.0);
        for tick in ticks(self.y.0, self.y.1, step) {
            let y = self.py(tick);
            *out += &format!("<path d=\"M{LEFT} {y:.2}H{right}\" stroke=\"#e6e9ee\"/>");
            let (x, base, label) = (LEFT - 8.0, y + 4.0, tick_label(tick, step));
            *out += &format!("<text x=\"{x}\" y=\"{base:.2}\" text-anchor=\"end\">{label}</text>\n");
        }
        if plot.zero {
            let y = self.py(0.0);
            *out += &format!("<path d=\"M{LEFT} {y:.2}H{right}\" stroke=\"#8a94a3\"/>\n");
        }
        *out += &format!("<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" stroke=\"#5b6675\" fill=\"none\"/>\n");
        let (x, y) = (0.5 * (LEFT + right), HEIGHT - 12.0);
        *out +=
            &format!("<text x=\"{x}\" y=\"{y}\" text-anchor=\"middle\">{}</text>\n", escape(&plot.x_label));
        let y = 0.5 * (TOP + bottom);
        *out += &format!(
            "<text x=\"16\" y=\"{y}\" text-anchor=\"middle\" transform=\"rotate(-90 16 {y})\">{}</text>\n",
            escape(&plot.y_label)
        );
    }

    fn series(&self, series: &Series, colour: &str, out: &mut String) {
        let thin = series.points.len().div_ceil(POINTS_MAX).max(1);
        let points = series.points.iter().step_by(thin);
        match series.style {
            Style::Line => {
                let mut path = String::new();
                let mut pen = 'M';
                for point in points {
                    if point.x.is_finite() && point.y.is_finite() {
                        path += &format!("{pen}{:.2} {:.2}", self.px(point.x), self.py(point.y));
                        pen = 'L';
                    } else {
                        pen = 'M';
                    }
                }
                *out +=
                    &format!("<path d=\"{path}\" stroke=\"{colour}\" stroke-width=\"1.8\" fill=\"none\"/>\n");
            }
            Style::Dots => {
                for point in points.filter(|p| p.x.is_finite() && p.y.is_finite()) {
                    let (x, y) = (self.px(point.x), self.py(point.y));
                    if point.sigma > 0.0 && point.sigma.is_finite() {
                        let (low, high) = (self.py(point.y - point.sigma), self.py(point.y + point.sigma));
                        *out += &format!(
                            "<path d=\"M{x:.2} {low:.2}V{high:.2}m-4 0h8M{:.2} {low:.2}h8\" stroke=\"{colour}\" fill=\"none\"/>",
                            x - 4.0
                        );
                    }
                    *out += &format!("<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"3.6\" fill=\"{colour}\"/>\n");
                }
            }
        }
    }

    fn marks(&self, plot: &Plot, out: &mut String) {
        for (at, name) in plot.marks.iter().filter(|(at, _)| *at >= self.x.0 && *at <= self.x.1) {
            let (x, bottom) = (self.px(*at), HEIGHT - BOTTOM);
            *out +=
                &format!("<path d=\"M{x:.2} {TOP}V{bottom}\" stroke=\"#5b6675\" stroke-dasharray=\"4 4\"/>");
            let (x, y) = (x + 5.0, bottom - 8.0);
            *out += &format!("<text x=\"{x:.2}\" y=\"{y}\">{}</text>\n", escape(name));
        }
    }
}

fn legend(plot: &Plot, out: &mut String) {
    let named = plot.series.iter().enumerate().filter(|(_, s)| !s.name.is_empty());
    for (line, (index, series)) in named.enumerate() {
        let colour = PALETTE[index % PALETTE.len()];
        #[expect(clippy::cast_precision_loss, reason = "a few series")]
        let y = TOP + 14.0 + 18.0 * line as f64;
        let (x, text) = (WIDTH - RIGHT - 8.0, escape(&series.name));
        *out += &format!("<text x=\"{x}\" y=\"{y}\" text-anchor=\"end\" fill=\"{colour}\">{text}</text>\n");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plots_survive_nasty_values() {
        let nasty =
            [Point { x: 1.0, y: f64::NAN, sigma: 1.0 }, Point { x: 2.0, y: 3.0, sigma: f64::INFINITY }];
        for plot in [
            pixel_line(&nasty, 0.0, 1.0, "pixel"),
            pixel_line(&[], f64::NAN, 1.0, "pixel"),
            plate_temperature(&[(0.0, 300.0)], &[]),
            Plot::default(),
        ] {
            let svg = plot.to_svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }

    #[test]
    fn crossing_is_marked() {
        let levels = [Point { x: 10.0, y: 5.0, sigma: 0.5 }, Point { x: 100.0, y: -40.0, sigma: 1.0 }];
        let plot = pixel_line(&levels, -0.5, 10.0, "row 1, column 2");
        assert_eq!(plot.marks, [(20.0, "S = 20.00".to_owned())]);
        assert!(plot.to_svg().contains("S = 20.00"));
    }
}
