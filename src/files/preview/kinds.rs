//! A picture of bits: every pixel in the colour of its highest bit, and a legend of those that occur.

use super::{Canvas, encoded, sizes};
use crate::files::font;

/// One kind of pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind<'a> {
    /// Its bit.
    pub bit: u32,
    /// Its name.
    pub name: &'a str,
    /// Pixels that carry it.
    pub pixels: usize,
}

/// Pixels without a bit.
const NONE: [u8; 3] = [225, 225, 225];

/// Colours of the kinds in their order, repeated after the last: Okabe and Ito's and darker and lighter ones.
const COLOURS: [[u8; 3]; 16] = [
    [0, 0, 0],
    [230, 159, 0],
    [86, 180, 233],
    [0, 158, 115],
    [120, 94, 40],
    [0, 114, 178],
    [213, 94, 0],
    [204, 121, 167],
    [240, 228, 66],
    [122, 81, 149],
    [160, 200, 160],
    [90, 110, 130],
    [255, 150, 150],
    [150, 120, 220],
    [110, 60, 60],
    [60, 160, 160],
];

/// Draws `[rows · columns]` bits and encodes as PNG; kinds that no pixel carries are not in the legend.
///
/// # Errors
///
/// What the encoder says; on memory it has no reason to.
///
/// Panics when there is not one value per pixel.
pub fn kinds_to_png(
    rows: usize,
    columns: usize,
    bits: &[u32],
    kinds: &[Kind<'_>],
    title: &str,
) -> std::io::Result<Vec<u8>> {
    assert!(bits.len() == rows * columns, "one value per pixel");
    let (zoom, scale) = sizes(rows, columns);
    let (width, height) = (columns * zoom, rows * zoom);
    let line = (font::HEIGHT + 3) * scale;
    let margin = 6 * scale;
    let bare = bits.iter().filter(|&&bits| bits == 0).count();
    let mut legend = vec![(NONE, format!("none  {bare}"))];
    for (kind, colour) in kinds.iter().zip(COLOURS.iter().cycle()).filter(|(kind, _)| kind.pixels > 0) {
        legend.push((*colour, format!("{}  {}", kind.name, kind.pixels)));
    }
    let label = legend.iter().map(|(_, text)| font::text_width(text)).max().unwrap_or(0) * scale;
    let (top, left) = (margin + line + 2 * scale, margin + width + 2 * margin);
    let swatch = font::HEIGHT * scale;
    let total =
        (left + swatch + 4 * scale + label + margin).max(font::text_width(title) * scale + 2 * margin);
    let mut canvas = Canvas::new(total, top + height.max(legend.len() * line) + margin);
    canvas.text(margin, margin, scale, title);
    for (i, bits) in bits.iter().enumerate() {
        let highest = kinds.iter().rposition(|kind| bits & kind.bit != 0);
        let colour = highest.map_or(NONE, |k| COLOURS[k % COLOURS.len()]);
        canvas.fill(margin + i % columns * zoom, top + i / columns * zoom, zoom, zoom, colour);
    }
    for (k, (colour, text)) in legend.iter().enumerate() {
        let y = top + k * line;
        canvas.fill(left, y, swatch, swatch, *colour);
        canvas.text(left + swatch + 4 * scale, y, scale, text);
    }
    encoded(&canvas)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The highest bit colours a pixel; kinds that do not occur have no line.
    #[test]
    fn pixels_have_the_colour_of_their_highest_bit() {
        let kinds = [
            Kind { bit: 1, name: "ONE", pixels: 1 },
            Kind { bit: 2, name: "TWO", pixels: 0 },
            Kind { bit: 4, name: "FOUR", pixels: 2 },
        ];
        let bytes = kinds_to_png(2, 2, &[0, 1, 5, 4], &kinds, "flags").unwrap();
        assert_eq!(bytes, kinds_to_png(2, 2, &[0, 1, 5, 4], &kinds, "flags").unwrap());
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let count = |colour: [u8; 3]| pixels.as_chunks::<3>().0.iter().filter(|p| **p == colour).count();
        let square = 16 * 16;
        let swatch = font::HEIGHT * font::HEIGHT;
        // Black letters are of another ink.
        assert_eq!(count(COLOURS[0]), square + swatch);
        assert_eq!((count(COLOURS[1]), count(COLOURS[2])), (0, 2 * square + swatch));
        assert!(kinds_to_png(0, 0, &[], &[], "").is_ok());
    }
}
