//! Several drawings on one page, as an SVG file of its own.

use super::polar::Polar;
use super::{FONT, HEIGHT, Plot, WIDTH};
use crate::report::escape;

/// Height of the head line.
const HEAD: f64 = 44.0;

/// A page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sheet {
    /// Above the drawings; empty for none.
    pub title: String,
    /// The drawings, row by row.
    pub drawings: Vec<Drawing>,
    /// Drawings side by side, at least 1.
    pub columns: usize,
}

/// What stands on a page.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawing {
    /// Curves over an axis.
    Plot(Plot),
    /// Curves over an angle.
    Polar(Polar),
    /// Lines of text of one width.
    Notes(Vec<String>),
}

impl Sheet {
    /// The complete file, with a white ground and its name space, for any viewer.
    pub fn to_svg(&self) -> String {
        let columns = self.columns.max(1).min(self.drawings.len().max(1));
        let rows = self.drawings.len().div_ceil(columns);
        let head = if self.title.is_empty() { 0.0 } else { HEAD };
        #[expect(clippy::cast_precision_loss, reason = "a few drawings")]
        let place = |column: usize, row: usize| (column as f64 * WIDTH, head + row as f64 * HEIGHT);
        let (width, height) = (place(columns, 0).0, place(0, rows).1);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" {FONT}>\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n\
             <text x=\"{}\" y=\"28\" font-size=\"16\" text-anchor=\"middle\">{}</text>\n",
            0.5 * width,
            escape(&self.title)
        );
        for (index, drawing) in self.drawings.iter().enumerate() {
            let (x, y) = place(index % columns, index / columns);
            let body = match drawing {
                Drawing::Plot(plot) => plot.body(),
                Drawing::Polar(polar) => polar.body(),
                Drawing::Notes(lines) => notes(lines),
            };
            out += &format!("<g transform=\"translate({x} {y})\">\n{body}</g>\n");
        }
        out + "</svg>\n"
    }
}

/// Lines of text, 16 units apart.
fn notes(lines: &[String]) -> String {
    let mut out = String::new();
    for (line, text) in lines.iter().enumerate() {
        #[expect(clippy::cast_precision_loss, reason = "a few lines")]
        let y = 30.0 + 16.0 * line as f64;
        out += &format!(
            "<text x=\"24\" y=\"{y}\" font-family=\"ui-monospace,monospace\" font-size=\"11.5\" xml:space=\"preserve\">{}</text>\n",
            escape(text)
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawings_stand_in_rows_and_never_on_each_other() {
        let sheet = Sheet {
            title: "a & b".into(),
            drawings: vec![
                Drawing::Plot(Plot::default()),
                Drawing::Polar(Polar::default()),
                Drawing::Plot(Plot::default()),
            ],
            columns: 2,
        };
        let svg = sheet.to_svg();
        assert!(svg.starts_with("<svg xmlns=") && svg.contains("a &amp; b"));
        for at in ["translate(0 44)", "translate(640 44)", "translate(0 424)"] {
            assert!(svg.contains(at), "{at}");
        }
        assert!(svg.contains("viewBox=\"0 0 1280 804\""));
        assert!(Sheet::default().to_svg().ends_with("</svg>\n"));
    }
}
