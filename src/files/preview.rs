//! A picture for the eye: one channel in false colour with colour bar, unit and ticks, as PNG.
//!
//! Pixels without a value are grey. The colour maps are perceptually uniform.

pub mod kinds;

use super::font;

const BACKGROUND: [u8; 3] = [255, 255, 255];
const INK: [u8; 3] = [30, 30, 30];
const ABSENT: [u8; 3] = [150, 150, 150];

/// Ticks that a colour bar has at most.
const TICKS_MAX: f64 = 7.0;

/// Colour map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colours {
    /// Black, red, yellow: for temperature.
    Inferno,
    /// Violet, green, yellow: for anything else.
    Viridis,
}

/// What to draw.
#[derive(Debug, Clone, Copy)]
pub struct Preview<'a> {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Values `[rows · columns]`; not finite = grey.
    pub values: &'a [f64],
    /// Value of the darkest colour.
    pub low: f64,
    /// Value of the brightest colour, above `low`.
    pub high: f64,
    /// What is shown, above the picture.
    pub title: &'a str,
    /// Its unit, over the colour bar; empty for none.
    pub unit: &'a str,
    /// Colour map.
    pub colours: Colours,
}

/// A range for `values` that ends on round numbers and leaves out the lowest and highest hundredth; 0 … 1 if there
/// are none.
pub fn round_range(values: &[f64]) -> (f64, f64) {
    let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    if finite.is_empty() {
        return (0.0, 1.0);
    }
    finite.sort_unstable_by(f64::total_cmp);
    let last = finite.len() - 1;
    let (low, high) = (finite[last / 100], finite[last - last / 100]);
    let span = (high - low).max(1e-3 * high.abs()).max(1e-9);
    let step = tick_step(span);
    let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
    if high > low { (low, high) } else { (low, low + step) }
}

/// A step of 1, 2 or 5 times a power of ten that makes at most seven ticks.
pub fn tick_step(span: f64) -> f64 {
    let raw = span / (TICKS_MAX - 1.0);
    let power = libm::pow(10.0, libm::floor(libm::log10(raw)));
    let digit = raw / power;
    let nice = if digit <= 1.0 {
        1.0
    } else if digit <= 2.0 {
        2.0
    } else if digit <= 5.0 {
        5.0
    } else {
        10.0
    };
    nice * power
}

/// `value` with as many decimals as `step` needs.
pub fn tick_label(value: f64, step: f64) -> String {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 ..= 9")]
    let decimals = (-libm::floor(libm::log10(step) + 1e-9)).clamp(0.0, 9.0) as usize;
    // Avoids a negative zero.
    format!("{:.decimals$}", if value.abs() < 0.5 * step * 1e-6 { 0.0 } else { value })
}

/// Draws and encodes as PNG.
///
/// # Errors
///
/// What the encoder says; on memory it has no reason to.
///
/// Panics when the values are not rows · columns.
pub fn to_png(preview: &Preview<'_>) -> std::io::Result<Vec<u8>> {
    assert!(preview.values.len() == preview.rows * preview.columns, "one value per pixel");
    encoded(&draw(preview))
}

fn encoded(canvas: &Canvas) -> std::io::Result<Vec<u8>> {
    let size = |axis: usize| u32::try_from(axis).map_err(std::io::Error::other);
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, size(canvas.width)?, size(canvas.height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(std::io::Error::other)?;
    writer.write_image_data(&canvas.bytes).map_err(std::io::Error::other)?;
    writer.finish().map_err(std::io::Error::other)?;
    Ok(out)
}

struct Canvas {
    width: usize,
    height: usize,
    bytes: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, bytes: BACKGROUND.repeat(width * height) }
    }

    fn fill(&mut self, left: usize, top: usize, width: usize, height: usize, colour: [u8; 3]) {
        for y in top..(top + height).min(self.height) {
            for x in left..(left + width).min(self.width) {
                let at = 3 * (y * self.width + x);
                self.bytes[at..at + 3].copy_from_slice(&colour);
            }
        }
    }

    fn text(&mut self, left: usize, top: usize, scale: usize, text: &str) {
        for (i, character) in text.chars().enumerate() {
            for (column, bits) in font::glyph(character).into_iter().enumerate() {
                for row in (0..font::HEIGHT).filter(|row| bits >> row & 1 == 1) {
                    let x = left + (i * (font::WIDTH + 1) + column) * scale;
                    self.fill(x, top + row * scale, scale, scale, INK);
                }
            }
        }
    }
}

/// How much pixels and letters are enlarged: small maps by a whole factor, so that their pixels stay visible squares.
fn sizes(rows: usize, columns: usize) -> (usize, usize) {
    let zoom = (384 / columns.max(rows).max(1)).clamp(1, 16);
    (zoom, if columns * zoom >= 300 { 2 } else { 1 })
}

fn draw(preview: &Preview<'_>) -> Canvas {
    let &Preview { rows, columns, values, low, high, .. } = preview;
    let (zoom, scale) = sizes(rows, columns);
    let (width, height) = (columns * zoom, rows * zoom);
    let line = (font::HEIGHT + 3) * scale;
    let margin = 6 * scale;
    let top = margin + line + 2 * scale;
    let step = tick_step(high - low);
    let ticks = ticks(low, high, step);
    let label = ticks.iter().map(|&t| font::text_width(&tick_label(t, step))).max().unwrap_or(0);
    let label = label.max(font::text_width(preview.unit)) * scale;
    let (bar_left, bar_width) = (margin + width + 2 * margin, 10 * scale);
    let title = font::text_width(preview.title) * scale + 2 * margin;
    // A bar lower than seven lines of text would run its labels together.
    let bar_height = height.max(7 * line);
    let total = (bar_left + bar_width + 4 * scale + label + margin).max(title);
    let mut canvas = Canvas::new(total, top + line + bar_height + margin);
    canvas.text(margin, margin, scale, preview.title);
    let top = top + line;
    canvas.text(bar_left, top - line, scale, preview.unit);
    for row in 0..rows {
        for column in 0..columns {
            let value = values[row * columns + column];
            let colour = if value.is_finite() {
                colour(preview.colours, (value - low) / (high - low))
            } else {
                ABSENT
            };
            canvas.fill(margin + column * zoom, top + row * zoom, zoom, zoom, colour);
        }
    }
    for y in 0..bar_height {
        #[expect(clippy::cast_precision_loss, reason = "pixels")]
        let place = 1.0 - (y as f64 + 0.5) / bar_height as f64;
        canvas.fill(bar_left, top + y, bar_width, 1, colour(preview.colours, place));
    }
    for tick in ticks {
        let place = 1.0 - (tick - low) / (high - low);
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 ≤ place ≤ 1, pixels"
        )]
        let y = top + (place.clamp(0.0, 1.0) * (bar_height - 1) as f64).round() as usize;
        canvas.fill(bar_left + bar_width, y, 3 * scale, scale.min(top + bar_height - y), INK);
        let text_top = y.saturating_sub(font::HEIGHT * scale / 2);
        canvas.text(bar_left + bar_width + 4 * scale, text_top, scale, &tick_label(tick, step));
    }
    canvas
}

/// Multiples of `step` between `low` and `high`.
pub fn ticks(low: f64, high: f64, step: f64) -> Vec<f64> {
    let first = (low / step - 1e-6).ceil();
    (0..32).map(|i| (first + f64::from(i)) * step).take_while(|t| *t <= high + 1e-6 * step).collect()
}

fn colour(colours: Colours, place: f64) -> [u8; 3] {
    let gradient = match colours {
        Colours::Inferno => colorous::INFERNO,
        Colours::Viridis => colorous::VIRIDIS,
    };
    let colorous::Color { r, g, b } = gradient.eval_continuous(place.clamp(0.0, 1.0));
    [r, g, b]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_ticks_are_round() {
        let values: Vec<f64> = (0..1000).map(|i| 383.0 + 0.07 * f64::from(i)).collect();
        let (low, high) = round_range(&values);
        assert!((low - 380.0).abs() < 1e-9 && (high - 460.0).abs() < 1e-9, "{low} {high}");
        assert_eq!(ticks(low, high, tick_step(high - low)).len(), 5);
        assert_eq!(tick_label(0.2, 0.2), "0.2");
        assert_eq!(tick_label(380.0, 20.0), "380");
        assert_eq!(tick_label(-1e-17, 0.5), "0.0");
        assert_eq!(round_range(&[f64::NAN]), (0.0, 1.0));
        let (low, high) = round_range(&[449.0; 5]);
        assert!(low < high);
    }

    #[test]
    fn absent_pixels_are_grey_and_bytes_repeat() {
        let values = [0.0, f64::NAN, 1.0, 0.5];
        let preview = Preview {
            rows: 2,
            columns: 2,
            values: &values,
            low: 0.0,
            high: 1.0,
            title: "emissivity",
            unit: "",
            colours: Colours::Viridis,
        };
        let bytes = to_png(&preview).unwrap();
        assert_eq!(bytes, to_png(&preview).unwrap());
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert!(pixels.as_chunks::<3>().0.contains(&ABSENT));
    }
}
