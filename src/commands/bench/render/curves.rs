//! Figures as pictures: what was measured against what was changed, on logarithmic axes.

use super::super::Figure;
use crate::report::plot::sheet::{Drawing, Sheet};
use crate::report::plot::{Plot, Point, Scale, Series, Style};

/// Everything that one subject has found.
#[derive(Debug, Default)]
pub(super) struct Findings {
    pub(super) figures: Vec<Figure>,
    /// Pictures of its own.
    pub(super) pages: Vec<Page>,
    /// Its curves of error against time of one pixel or ray.
    pub(super) fronts: Vec<Series>,
}

/// A picture.
#[derive(Debug)]
pub(super) struct Page {
    /// Its file's name without ending.
    pub(super) name: &'static str,
    pub(super) sheet: Sheet,
}

/// One run of a sweep.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// What was changed.
    pub(super) x: f64,
    pub(super) seconds: f64,
    /// True rms error with its standard error, and the error that was declared.
    pub(super) error: f64,
    pub(super) uncertainty: f64,
    pub(super) declared: f64,
}

/// Time and error beside each other, over the same axis.
pub(super) fn sweep(title: &str, x_label: &str, target: f64, samples: &[Sample]) -> Sheet {
    let ends = samples.iter().map(|s| s.x).fold([f64::INFINITY, 0.0], |[a, b], x| [a.min(x), b.max(x)]);
    let times = samples.iter().map(|s| Point::new(s.x, s.seconds)).collect();
    let truth = samples.iter().map(|s| Point { x: s.x, y: s.error, sigma: s.uncertainty }).collect();
    let declared = samples.iter().map(|s| Point::new(s.x, s.declared)).collect();
    beside(
        title,
        [
            log_log(x_label, "time / s", vec![marked("", times)]),
            log_log(
                x_label,
                "rms error of the coefficients",
                vec![
                    marked("true", truth),
                    marked("declared", declared),
                    line("target", ends.map(|x| Point::new(x, target)).to_vec()),
                ],
            ),
        ],
    )
}

/// Two drawings on a page.
pub(super) fn beside(title: &str, drawings: [Plot; 2]) -> Sheet {
    Sheet { title: title.to_owned(), drawings: drawings.map(Drawing::Plot).to_vec(), columns: 2 }
}

/// One drawing on a page.
pub(super) fn alone(title: &str, drawing: Plot) -> Sheet {
    Sheet { title: title.to_owned(), drawings: vec![Drawing::Plot(drawing)], columns: 1 }
}

pub(super) fn log_log(x_label: &str, y_label: &str, series: Vec<Series>) -> Plot {
    let (x_label, y_label) = (x_label.to_owned(), y_label.to_owned());
    Plot { x_label, y_label, x_scale: Scale::Log, y_scale: Scale::Log, series, ..Plot::default() }
}

pub(super) fn marked(name: &str, points: Vec<Point>) -> Series {
    Series { name: name.to_owned(), points, style: Style::Marked }
}

pub(super) fn line(name: &str, points: Vec<Point>) -> Series {
    Series { name: name.to_owned(), points, style: Style::Line }
}

/// Root mean square; 0 of nothing.
pub(super) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        count += 1.0;
    }
    (sum / f64::max(count, 1.0)).sqrt()
}
