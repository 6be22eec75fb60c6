//! One HTML file that shows a campaign's result: pictures, plots, tables, warnings. No network, no scripts.
//!
//! Equal contents are equal bytes. Shows what it is given and judges nothing.

pub mod mie;
pub mod pixel;
pub mod plot;
pub mod run;

pub use plot::{Plot, Point, Series, Style};

/// What a report shows, in order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Heading and title of the page.
    pub title: String,
    /// One line under it: what, where, which software.
    pub subtitle: String,
    /// What the reader must know first; nothing is shown if there are none.
    pub warnings: Vec<String>,
    /// Everything else.
    pub blocks: Vec<Block>,
}

/// A part of a report.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A heading.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Pictures side by side, each with its caption.
    Pictures(Vec<Picture>),
    /// Names and values.
    Values(Vec<(String, String)>),
    /// A table, e.g. of levels.
    Table {
        /// Heads of the columns.
        head: Vec<String>,
        /// Rows, as long as `head`.
        rows: Vec<Vec<String>>,
    },
    /// A plot with its caption.
    Plot {
        /// Under the plot.
        caption: String,
        /// What is plotted.
        plot: Plot,
    },
}

/// A PNG with its caption.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Under the picture; also its text for readers who cannot see it.
    pub caption: String,
    /// The bytes of a PNG file.
    pub png: Vec<u8>,
}

const STYLE: &str = "\
:root{color-scheme:light}\
body{font:15px/1.5 system-ui,sans-serif;color:#1c2430;background:#f4f5f7;margin:0}\
main{max-width:1080px;margin:0 auto;padding:28px 24px 60px;background:#fff}\
h1{font-size:26px;margin:0}h2{font-size:19px;margin:36px 0 10px;border-bottom:1px solid #dde1e7;padding-bottom:4px}\
.subtitle{color:#5b6675;margin:4px 0 20px}\
.warnings{border-left:4px solid #c77700;background:#fff6e5;padding:10px 16px;margin:16px 0}\
.warnings ul{margin:4px 0;padding-left:20px}\
.pictures{display:flex;flex-wrap:wrap;gap:20px}figure{margin:0}\
figure img{max-width:100%;height:auto;display:block;border:1px solid #dde1e7}\
figcaption{color:#5b6675;font-size:13px;margin-top:4px}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:8px 0}\
th,td{padding:4px 14px 4px 0;text-align:left;border-bottom:1px solid #eceff3;vertical-align:top}\
th{font-weight:600}table.grid td,table.grid th{text-align:right}\
table.grid td:first-child,table.grid th:first-child{text-align:left}\
svg{max-width:100%;height:auto}\
@media print{body{background:#fff}main{padding:0}h2{break-after:avoid}figure,table{break-inside:avoid}}";

impl Report {
    /// The complete file.
    pub fn to_html(&self) -> String {
        let mut out = String::from("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
        out += "<meta name=\"viewport\" content=\"width=device-width\">\n";
        out += &format!("<title>{}</title>\n<style>{STYLE}</style>\n</head>\n", escape(&self.title));
        out += &format!("<body>\n<main>\n<h1>{}</h1>\n", escape(&self.title));
        out += &format!("<p class=\"subtitle\">{}</p>\n", escape(&self.subtitle));
        if !self.warnings.is_empty() {
            out += "<div class=\"warnings\"><strong>Warnings</strong>\n<ul>\n";
            for warning in &self.warnings {
                out += &format!("<li>{}</li>\n", escape(warning));
            }
            out += "</ul>\n</div>\n";
        }
        for block in &self.blocks {
            block.write(&mut out);
        }
        out + "</main>\n</body>\n</html>\n"
    }
}

impl Block {
    fn write(&self, out: &mut String) {
        match self {
            Self::Heading(text) => *out += &format!("<h2>{}</h2>\n", escape(text)),
            Self::Text(text) => *out += &format!("<p>{}</p>\n", escape(text)),
            Self::Pictures(pictures) => {
                *out += "<div class=\"pictures\">\n";
                for Picture { caption, png } in pictures {
                    let caption = escape(caption);
                    let source = base64(png);
                    *out +=
                        &format!("<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{source}\">");
                    *out += &format!("<figcaption>{caption}</figcaption></figure>\n");
                }
                *out += "</div>\n";
            }
            Self::Values(values) => {
                *out += "<table>\n";
                for (name, value) in values {
                    let (name, value) = (escape(name), escape(value));
                    *out += &format!("<tr><th scope=\"row\">{name}</th><td>{value}</td></tr>\n");
                }
                *out += "</table>\n";
            }
            Self::Table { head, rows } => {
                let cells = |tag: &str, cells: &[String]| -> String {
                    cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
                };
                *out += &format!("<table class=\"grid\">\n<tr>{}</tr>\n", cells("th", head));
                for row in rows {
                    *out += &format!("<tr>{}</tr>\n", cells("td", row));
                }
                *out += "</table>\n";
            }
            Self::Plot { caption, plot } => {
                let svg = plot.to_svg();
                *out += &format!("<figure>{svg}<figcaption>{}</figcaption></figure>\n", escape(caption));
            }
        }
    }
}

/// Text as HTML and SVG show it.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            other => out.push(other),
        }
    }
    out
}

/// Base 64 with padding (RFC 4648, section 4).
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let byte = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for digit in 0..4 {
            if digit <= group.len() {
                let place = usize::try_from(bits >> (18 - 6 * digit) & 63).expect("six bits");
                out.push(char::from(DIGITS[place]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// RFC 4648, section 10.
    #[test]
    fn base64_agrees_with_the_standard() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn report_is_one_escaped_and_repeatable_file() {
        let report = Report {
            title: "a <b> & c".into(),
            subtitle: "ditd".into(),
            warnings: vec!["window fouled".into()],
            blocks: vec![
                Block::Heading("Levels".into()),
                Block::Table { head: vec!["T / K".into()], rows: vec![vec!["373.00".into()]] },
                Block::Values(vec![("estimator".into(), "default".into())]),
                Block::Pictures(vec![Picture { caption: "T".into(), png: vec![1, 2, 3] }]),
                Block::Plot { caption: "line".into(), plot: Plot::default() },
            ],
        };
        let html = report.to_html();
        assert_eq!(html, report.to_html());
        assert!(html.contains("<h1>a &lt;b&gt; &amp; c</h1>") && html.contains("window fouled"));
        assert!(!html.contains("http:") && !html.contains("https:") && !html.contains("<script"));
    }
}
