//! One pixel on a page: its line with the band it is known in, residuals, the calibration about its temperature, and the
//! numbers; also as text.

use super::plot::sheet::{Drawing, Sheet};
use super::plot::{Band, Plot, Point, Series, Span, Style};
use crate::estimate::pixel::{Measured, PixelLevel, PixelView};

/// Opacity of a 95 % set, and what the 68 % set inside adds.
const OPACITY: f64 = 0.16;

/// The page.
pub fn sheet(view: &PixelView, name: &str) -> Sheet {
    let title = format!(
        "{name}{}row {}, column {}, estimator {}",
        if name.is_empty() { "" } else { ": " },
        view.row,
        view.column,
        view.estimator
    );
    Sheet {
        title,
        drawings: vec![
            Drawing::Plot(line(view)),
            Drawing::Plot(calibration(view)),
            Drawing::Plot(residuals(view)),
            Drawing::Notes(text(view).lines().map(str::to_owned).collect()),
        ],
        columns: 2,
    }
}

fn level_points(view: &PixelView, value: impl Fn(&PixelLevel) -> f64) -> Vec<Point> {
    let known = view.levels.iter().filter(|level| level.accepted > 0);
    known
        .filter_map(|level| {
            let sigma = level.standard_error_counts;
            Some(Point {
                x: level.x_counts?,
                y: value(level),
                sigma: if sigma.is_finite() { sigma } else { 0.0 },
            })
        })
        .collect()
}

/// Mean differences over x, the line, its 68 % and 95 % band, and where it crosses zero.
fn line(view: &PixelView) -> Plot {
    let mut plot = Plot {
        x_label: "x = plate signal behind the far window / counts".into(),
        y_label: "spray − blank / counts".into(),
        zero: true,
        ..Plot::default()
    };
    let mut series = vec![Series {
        name: "level means ± standard error".into(),
        points: level_points(view, |level| level.difference_counts),
        style: Style::Dots,
    }];
    if let Some(line) = &view.line {
        let points = line.band.iter().map(|&[x, y, ..]| Point::new(x, y)).collect();
        series.push(Series { name: "line, 68 % and 95 % band".into(), points, style: Style::Line });
        for which in [2, 3] {
            let edges = line.band.iter().map(|one| [one[0], one[1] - one[which], one[1] + one[which]]);
            plot.bands.push(Band { edges: edges.collect(), series: 1, opacity: OPACITY });
        }
        let shown = line.band.first().zip(line.band.last());
        if shown.is_some_and(|(a, b)| (a[0]..=b[0]).contains(&line.crossing_counts)) {
            plot.marks.push((line.crossing_counts, format!("S = {:.2}", line.crossing_counts)));
        }
    }
    plot.series = series;
    plot
}

/// Means less the line, with the band about zero.
fn residuals(view: &PixelView) -> Plot {
    let mut plot = Plot {
        x_label: "x / counts".into(),
        y_label: "level mean − line / counts".into(),
        zero: true,
        ..Plot::default()
    };
    let points = level_points(view, |level| level.residual_counts);
    plot.series.push(Series { name: "residuals ± standard error".into(), points, style: Style::Dots });
    if let Some(line) = &view.line {
        for which in [2, 3] {
            let edges = line.band.iter().map(|one| [one[0], -one[which], one[which]]);
            plot.bands.push(Band { edges: edges.collect(), series: 1, opacity: OPACITY });
        }
    }
    plot
}

/// The curve about the temperature, the sets as stretches of it.
fn calibration(view: &PixelView) -> Plot {
    let curve = &view.calibration;
    let points = curve.points.iter().map(|&[t, counts]| Point::new(t, counts)).collect();
    let at = Point::new(view.temperature_k.value, curve.counts);
    let Measured { set_68, set_95, .. } = view.temperature_k;
    let span = |[low, high]: [f64; 2]| Span { low, high, series: 1, opacity: OPACITY };
    let marks = if view.temperature_k.value.is_finite() {
        vec![(view.temperature_k.value, format!("T = {:.2} K", view.temperature_k.value))]
    } else {
        Vec::new()
    };
    Plot {
        x_label: "temperature / K (shaded: 68 % and 95 % set)".into(),
        y_label: "counts of a black body".into(),
        series: vec![
            Series { name: "calibration curve".into(), points, style: Style::Line },
            Series { name: "ε_B (S + E_f) of the pixel".into(), points: vec![at], style: Style::Dots },
        ],
        marks,
        spans: vec![span(set_95), span(set_68)],
        ..Plot::default()
    }
}

/// The numbers, for people.
pub fn text(view: &PixelView) -> String {
    let set = |[low, high]: [f64; 2], digits: usize| {
        if low.is_finite() && high.is_finite() {
            format!("{low:.digits$} … {high:.digits$}")
        } else {
            "not bounded".to_owned()
        }
    };
    let value = |measured: &Measured, digits: usize| {
        if measured.value.is_finite() {
            format!(
                "{:.digits$} ± {:.digits$}   68 % {}   95 % {}",
                measured.value,
                measured.sigma,
                set(measured.set_68, digits),
                set(measured.set_95, digits)
            )
        } else {
            "no answer".to_owned()
        }
    };
    let mut out = format!("pixel      row {}, column {}\n", view.row, view.column);
    out += &format!("T_eff / K  {}\n", value(&view.temperature_k, 2));
    out += &format!("emissivity {}\n", value(&view.emissivity, 4));
    if let Some(line) = &view.line {
        out += &format!(
            "line       slope {:.5}, offset {:.3}, crossing S {:.3} counts\n",
            line.slope, line.offset_counts, line.crossing_counts
        );
        out += &format!("χ²         {:.2} for {} degrees of freedom\n", line.chi2, line.degrees_of_freedom);
    } else {
        out += "line       none: fewer than two levels\n";
    }
    out += &format!(
        "curve      {:.3} counts there, {:.3} counts/K\n",
        view.calibration.counts, view.calibration.slope_counts_per_k
    );
    out += &format!(
        "gain       {:.4} ± {:.4} (γ_far γ_near gain); flat {:.4}\n\n",
        view.gain[0], view.gain[1], view.flat_gain
    );
    out += "   plate/K        x     n  out    spray    blank  spray−blank   ±error  residual  weight\n";
    for level in &view.levels {
        let plate = level.plate_temperature_k.map_or_else(|| "–".into(), |kelvin| format!("{kelvin:.2}"));
        let x = level.x_counts.map_or_else(|| "–".into(), |x| format!("{x:.2}"));
        let left_out = level.spikes + level.saturated + u32::try_from(level.misfires).unwrap_or(u32::MAX);
        out += &format!(
            "{plate:>10} {x:>8} {:>5} {left_out:>4} {:>8.1} {:>8.1} {:>12.3} {:>8.3} {:>9.3} {:>6.1}%\n",
            level.accepted,
            level.mean_spray_counts,
            level.mean_blank_counts,
            level.difference_counts,
            level.standard_error_counts,
            level.residual_counts,
            100.0 * level.weight_share
        );
    }
    if view.flags.is_empty() {
        out += "\nno flags\n";
    } else {
        out += "\n";
        for flag in &view.flags {
            out += &format!("{}: {}\n", flag.name, flag.meaning);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::SakumaHattori;
    use crate::estimate::pixel::{NamedFlag, PixelCurve};

    /// A pixel without any answer has a page without a NaN in its drawings.
    #[test]
    fn pixels_without_an_answer_have_a_page() {
        let nothing = Measured {
            value: f64::NAN,
            sigma: f64::NAN,
            set_68: [f64::NAN; 2],
            set_95: [f64::NAN, f64::INFINITY],
        };
        let view = PixelView {
            row: 1,
            column: 2,
            estimator: "default",
            blanks_per_cycle: 1,
            flat_gain: 1.0,
            levels: Vec::new(),
            line: None,
            emissivity: nothing,
            temperature_k: nothing,
            calibration: PixelCurve {
                curve: SakumaHattori { a_counts: 1.0, a_um: 3.4, b_um_k: 0.0 },
                range: None,
                counts: f64::NAN,
                slope_counts_per_k: f64::NAN,
                points: Vec::new(),
            },
            gain: [f64::NAN; 2],
            flags: vec![NamedFlag {
                bit: 1,
                name: "TOO_FEW_LEVELS",
                meaning: "fewer than two levels left, no line",
            }],
        };
        let svg = sheet(&view, "a < b").to_svg();
        assert!(svg.contains("a &lt; b") && svg.contains("TOO_FEW_LEVELS"));
        assert!(!svg.contains("=\"NaN") && !svg.contains("inf\""), "{svg}");
        assert!(text(&view).contains("no answer"));
    }
}
