//! Line and point plots as inline SVG: axes with round ticks, error bars, a legend.

mod axis;
pub mod polar;
pub mod sheet;
pub mod timing;

pub use axis::Scale;

use super::escape;
use crate::estimate::calibration::{CalibrationFit, CalibrationPoint};
use axis::{Axis, Tick};

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 380.0;
/// How text looks on every drawing.
const FONT: &str = "font-family=\"system-ui,sans-serif\" font-size=\"12\" fill=\"#1c2430\"";
const LEFT: f64 = 72.0;
const RIGHT: f64 = 18.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 52.0;

/// Colours of the series in order (Okabe–Ito: told apart by colour-blind eyes), repeated after the last.
const PALETTE: [&str; 8] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#5b6675", "#7a5195"];

/// Points that a series draws at most; longer ones are thinned evenly.
const POINTS_MAX: usize = 4000;

/// A plot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plot {
    /// Under the horizontal axis, with unit.
    pub x_label: String,
    /// Beside the vertical axis, with unit.
    pub y_label: String,
    /// How the horizontal axis is laid out.
    pub x_scale: Scale,
    /// How the vertical axis is laid out.
    pub y_scale: Scale,
    /// What is drawn, in order.
    pub series: Vec<Series>,
    /// Vertical lines with a name, e.g. a crossing.
    pub marks: Vec<(f64, String)>,
    /// Draws the line y = 0, on a linear axis.
    pub zero: bool,
    /// Shaded between two curves, behind everything else.
    pub bands: Vec<Band>,
    /// Shaded between two places of the horizontal axis, behind everything else.
    pub spans: Vec<Span>,
}

/// A shaded band between two curves.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Horizontal place, lower and upper edge; those that are not finite are left out.
    pub edges: Vec<[f64; 3]>,
    /// Number of the series whose colour it takes.
    pub series: usize,
    /// 0 … 1.
    pub opacity: f64,
}

/// A shaded stretch of the horizontal axis, over the whole height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// From here …
    pub low: f64,
    /// … to here; nothing is drawn unless both are finite and it is above `low`.
    pub high: f64,
    /// Number of the series whose colour it takes.
    pub series: usize,
    /// 0 … 1.
    pub opacity: f64,
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
    /// Both.
    Marked,
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
        ..Plot::default()
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
        format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" {FONT}>\n{}</svg>\n",
            self.body()
        )
    }

    /// What stands inside the element.
    fn body(&self) -> String {
        let Some(frame) = Frame::around(self) else {
            return format!("<text x=\"{LEFT}\" y=\"{}\">no data</text>\n", HEIGHT / 2.0);
        };
        let mut out = String::new();
        frame.shades(self, &mut out);
        frame.axes(self, &mut out);
        for (index, series) in self.series.iter().enumerate() {
            frame.series(series, PALETTE[index % PALETTE.len()], &mut out);
        }
        frame.marks(self, &mut out);
        frame.legend(self, &mut out);
        out
    }
}

/// Where values lie on the page.
struct Frame {
    x: Axis,
    y: Axis,
}

impl Frame {
    fn around(plot: &Plot) -> Option<Self> {
        let points = || {
            let all = plot.series.iter().flat_map(|s| &s.points);
            all.filter(|p| plot.x_scale.shows(p.x) && plot.y_scale.shows(p.y))
        };
        points().next()?;
        let bar = |p: &Point| if p.sigma.is_finite() { p.sigma } else { 0.0 };
        let zero = (plot.zero && plot.y_scale == Scale::Linear).then_some(0.0);
        let edges = plot.bands.iter().flat_map(|band| &band.edges);
        let edges = edges.flat_map(|&[_, low, high]| [low, high]).filter(|y| plot.y_scale.shows(*y));
        let ends = points().flat_map(|p| [p.y - bar(p), p.y, p.y + bar(p)]).chain(zero).chain(edges);
        Some(Self {
            x: Axis::around(points().map(|p| p.x), plot.x_scale)?,
            y: Axis::around(ends, plot.y_scale)?,
        })
    }

    /// Whether a point has a place.
    fn shows(&self, point: &Point) -> bool {
        self.x.shows(point.x) && self.y.shows(point.y)
    }

    fn px(&self, x: f64) -> f64 {
        LEFT + self.x.place(x) * (WIDTH - LEFT - RIGHT)
    }

    fn py(&self, y: f64) -> f64 {
        HEIGHT - BOTTOM - self.y.place(y) * (HEIGHT - TOP - BOTTOM)
    }

    fn shades(&self, plot: &Plot, out: &mut String) {
        for &Span { low, high, series, opacity } in &plot.spans {
            // What lies beyond the axis is cut off.
            let inside = |x: f64| self.px(x).clamp(LEFT, WIDTH - RIGHT);
            if low.is_finite() && high.is_finite() && inside(high) > inside(low) {
                let (x, width) = (inside(low), inside(high) - inside(low));
                let (height, colour) = (HEIGHT - BOTTOM - TOP, PALETTE[series % PALETTE.len()]);
                *out += &format!(
                    "<rect x=\"{x:.2}\" y=\"{TOP}\" width=\"{width:.2}\" height=\"{height}\" fill=\"{colour}\" fill-opacity=\"{opacity}\"/>\n"
                );
            }
        }
        for band in &plot.bands {
            let shown =
                |&&[x, low, high]: &&[f64; 3]| self.x.shows(x) && self.y.shows(low) && self.y.shows(high);
            let edges: Vec<&[f64; 3]> = band.edges.iter().filter(shown).collect();
            let upper = edges.iter().map(|[x, _, high]| (x, high));
            let lower = edges.iter().rev().map(|[x, low, _]| (x, low));
            let corner = |(x, y): (&f64, &f64)| format!("{:.2},{:.2}", self.px(*x), self.py(*y));
            let corners: Vec<String> = upper.chain(lower).map(corner).collect();
            let colour = PALETTE[band.series % PALETTE.len()];
            *out += &format!(
                "<polygon points=\"{}\" fill=\"{colour}\" fill-opacity=\"{}\"/>\n",
                corners.join(" "),
                band.opacity
            );
        }
    }

    fn axes(&self, plot: &Plot, out: &mut String) {
        let (bottom, right) = (HEIGHT - BOTTOM, WIDTH - RIGHT);
        let colour = |tick: &Tick| if tick.label.is_empty() { "#f2f4f7" } else { "#e6e9ee" };
        for tick in self.x.ticks() {
            let (x, y) = (self.px(tick.value), bottom + 17.0);
            *out += &format!("<path d=\"M{x:.2} {TOP}V{bottom}\" stroke=\"{}\"/>", colour(&tick));
            let label = tick.label;
            *out += &format!("<text x=\"{x:.2}\" y=\"{y}\" text-anchor=\"middle\">{label}</text>\n");
        }
        for tick in self.y.ticks() {
            let y = self.py(tick.value);
            *out += &format!("<path d=\"M{LEFT} {y:.2}H{right}\" stroke=\"{}\"/>", colour(&tick));
            let (x, base, label) = (LEFT - 8.0, y + 4.0, tick.label);
            *out += &format!("<text x=\"{x}\" y=\"{base:.2}\" text-anchor=\"end\">{label}</text>\n");
        }
        if plot.zero && self.y.shows(0.0) {
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
        if series.style != Style::Dots {
            self.line(points.clone(), colour, out);
        }
        if series.style != Style::Line {
            self.dots(points, colour, out);
        }
    }

    fn line<'a>(&self, points: impl Iterator<Item = &'a Point>, colour: &str, out: &mut String) {
        let mut path = String::new();
        let mut pen = 'M';
        for point in points {
            if self.shows(point) {
                path += &format!("{pen}{:.2} {:.2}", self.px(point.x), self.py(point.y));
                pen = 'L';
            } else {
                pen = 'M';
            }
        }
        *out += &format!("<path d=\"{path}\" stroke=\"{colour}\" stroke-width=\"1.8\" fill=\"none\"/>\n");
    }

    fn dots<'a>(&self, points: impl Iterator<Item = &'a Point>, colour: &str, out: &mut String) {
        for point in points.filter(|p| self.shows(p)) {
            let (x, y) = (self.px(point.x), self.py(point.y));
            // On a logarithmic axis a bar that reaches 0 has no end.
            let ends = self.y.shows(point.y - point.sigma);
            if point.sigma > 0.0 && point.sigma.is_finite() && ends {
                let (low, high) = (self.py(point.y - point.sigma), self.py(point.y + point.sigma));
                *out += &format!(
                    "<path d=\"M{x:.2} {low:.2}V{high:.2}m-4 0h8M{:.2} {low:.2}h8\" stroke=\"{colour}\" fill=\"none\"/>",
                    x - 4.0
                );
            }
            *out += &format!("<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"3.6\" fill=\"{colour}\"/>\n");
        }
    }

    fn marks(&self, plot: &Plot, out: &mut String) {
        for (at, name) in plot.marks.iter().filter(|(at, _)| self.x.holds(*at)) {
            let (x, bottom) = (self.px(*at), HEIGHT - BOTTOM);
            *out +=
                &format!("<path d=\"M{x:.2} {TOP}V{bottom}\" stroke=\"#5b6675\" stroke-dasharray=\"4 4\"/>");
            let (x, y) = (x + 5.0, bottom - 8.0);
            *out += &format!("<text x=\"{x:.2}\" y=\"{y}\">{}</text>\n", escape(name));
        }
    }

    /// Names of the series, in the corner where the fewest points are: right above, left above, right below, left below.
    fn legend(&self, plot: &Plot, out: &mut String) {
        let named: Vec<(usize, &Series)> =
            plot.series.iter().enumerate().filter(|(_, s)| !s.name.is_empty()).collect();
        let longest = named.iter().map(|(_, s)| s.name.chars().count()).max().unwrap_or(0);
        #[expect(clippy::cast_precision_loss, reason = "a few series with short names")]
        let (width, height) = (7.0 * longest as f64 + 12.0, 18.0 * named.len() as f64 + 4.0);
        let (right, bottom) = (WIDTH - RIGHT - 8.0, HEIGHT - BOTTOM - 8.0);
        let corners = [
            (right, TOP, "end"),
            (LEFT + 10.0, TOP, "start"),
            (right, bottom - height, "end"),
            (LEFT + 10.0, bottom - height, "start"),
        ];
        let covered = |&(x, top, anchor): &(f64, f64, &str)| {
            let from = if anchor == "end" { x - width } else { x };
            let inside = |p: &&Point| {
                let (x, y) = (self.px(p.x), self.py(p.y));
                (from..from + width).contains(&x) && (top..top + height).contains(&y)
            };
            let drawn = plot.series.iter().flat_map(|s| &s.points).filter(|p| self.shows(p));
            drawn.filter(inside).count()
        };
        let (x, top, anchor) =
            corners.into_iter().min_by_key(covered).expect("there are four corners to choose from");
        for (line, (index, series)) in named.into_iter().enumerate() {
            let (colour, text) = (PALETTE[index % PALETTE.len()], escape(&series.name));
            #[expect(clippy::cast_precision_loss, reason = "a few series")]
            let y = top + 14.0 + 18.0 * line as f64;
            *out += &format!(
                "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" fill=\"{colour}\">{text}</text>\n"
            );
        }
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
            let log = Plot { x_scale: Scale::Log, y_scale: Scale::Log, ..plot.clone() };
            for svg in [plot.to_svg(), log.to_svg()] {
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            }
        }
    }

    #[test]
    fn the_legend_stands_where_no_curve_is() {
        let rising = |x: f64| Point::new(x, x);
        let points: Vec<Point> = (0..200).map(|i| rising(f64::from(i))).collect();
        let falling = points.iter().map(|p| Point::new(p.x, -p.y)).collect();
        let plot = |points| Plot {
            series: vec![Series { name: "curve".into(), points, style: Style::Line }],
            ..Plot::default()
        };
        assert!(plot(points).to_svg().contains("text-anchor=\"start\" fill=\"#0072b2\">curve"));
        assert!(plot(falling).to_svg().contains("text-anchor=\"end\" fill=\"#0072b2\">curve"));
    }

    #[test]
    fn crossing_is_marked() {
        let levels = [Point { x: 10.0, y: 5.0, sigma: 0.5 }, Point { x: 100.0, y: -40.0, sigma: 1.0 }];
        let plot = pixel_line(&levels, -0.5, 10.0, "row 1, column 2");
        assert_eq!(plot.marks, [(20.0, "S = 20.00".to_owned())]);
        assert!(plot.to_svg().contains("S = 20.00"));
    }
}
