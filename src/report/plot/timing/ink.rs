//! What a timing drawing is made of: its measures and colours, lines, pulses, labels and times.

use crate::report::escape;

pub(super) const WIDTH: f64 = 1200.0;
pub(super) const LEFT: f64 = 132.0;
pub(super) const RIGHT: f64 = 28.0;
/// Height of one signal's row, and of its pulses.
pub(super) const ROW: f64 = 46.0;
pub(super) const HIGH: f64 = 24.0;
/// Width of the broken pause.
pub(super) const BREAK: f64 = 128.0;
/// Pulses are drawn at least this wide.
pub(super) const PULSE_MIN: f64 = 3.0;
/// Frames of a cycle that are drawn at most; of more, the first and the last of a kind.
pub(super) const FRAMES_DRAWN_MAX: usize = 12;

pub(super) const INK: &str = "#1c2430";
pub(super) const FAINT: &str = "#8a94a3";

/// The signals from top to bottom: name, what it is, colour.
pub(super) const SIGNALS: [(&str, &str, &str); 5] = [
    ("T0", "clock", "#5b6675"),
    ("injector", "output", "#d55e00"),
    ("camera", "trigger", "#0072b2"),
    ("exposure", "of the camera", "#009e73"),
    ("read-out", "of the camera", "#b6bdc9"),
];

/// The line on which a signal rests.
#[expect(clippy::cast_precision_loss, reason = "five rows")]
pub(super) fn base(top: f64, row: usize) -> f64 {
    top + ROW * (row as f64 + 1.0) - 8.0
}

pub(super) fn frame_names(out: &mut String, top: f64) {
    for (row, (name, what, _)) in SIGNALS.iter().enumerate() {
        let y = base(top, row);
        text(out, LEFT - 14.0, y - 9.0, "end", "font-size=\"13\"", name);
        text(out, LEFT - 14.0, y + 5.0, "end", &format!("font-size=\"10.5\" fill=\"{FAINT}\""), what);
    }
}

pub(super) fn more(out: &mut String, x: f64, column: f64, top: f64, count: u32) {
    for (row, (_, _, colour)) in SIGNALS.iter().enumerate() {
        let y = base(top, row);
        line(out, [x, y, x + column, y], colour, "1.4", "2 5");
    }
    let style = format!("fill=\"{FAINT}\"");
    text(out, x + 0.5 * column, top + 2.4 * ROW, "middle", &style, &format!("{count} more"));
}

/// Two torn edges with white between.
pub(super) fn broken(out: &mut String, [from, until]: [f64; 2], top: f64, is_flushed: bool) {
    let (high, low) = (top - 4.0, top + 5.0 * ROW);
    let torn = |x: f64, towards: f64| {
        let mut path = format!("M{x:.1} {high:.1}");
        let mut y = high;
        let mut side = 1.0;
        while y < low {
            let next = (y + 12.0).min(low);
            path += &format!("Q{:.1} {:.1} {x:.1} {next:.1}", x + side * towards, 0.5 * (y + next));
            (y, side) = (next, -side);
        }
        path
    };
    for x in [from + 6.0, until - 6.0] {
        *out += &format!(
            "<path d=\"{}\" stroke=\"#fff\" stroke-width=\"7\" fill=\"none\"/><path d=\"{}\" stroke=\"{FAINT}\" fill=\"none\"/>\n",
            torn(x, 5.0),
            torn(x, 5.0)
        );
    }
    // Between the rows of injector and camera, where no line runs.
    let (x, y) = (0.5 * (from + until), base(top, 1) + 20.0);
    let style = format!("fill=\"{FAINT}\" font-size=\"11\"");
    text(out, x, y, "middle", &style, "no exposures");
    if is_flushed {
        text(out, x, y + 14.0, "middle", &style, "vapour is flushed");
    }
}

pub(super) fn pulse(out: &mut String, x: f64, width: f64, y: f64, colour: &str) {
    rect(out, [x, y - HIGH, width, HIGH], colour, " fill-opacity=\"0.85\" rx=\"1\"");
}

/// What a pulse is, inside it when there is room, else beside it.
pub(super) fn label(out: &mut String, [from, until]: [f64; 2], y: f64, colour: &str, words: &str) {
    let width = 6.6 * words.chars().count() as f64;
    let middle = y - 0.5 * HIGH + 4.5;
    if until - from > width + 12.0 {
        // Light bars carry dark text.
        let ink = if colour == SIGNALS[4].2 { INK } else { "#fff" };
        text(out, 0.5 * (from + until), middle, "middle", &format!("fill=\"{ink}\""), words);
    } else if until + width + 12.0 < WIDTH - RIGHT {
        text(out, until + 8.0, middle, "start", &format!("fill=\"{INK}\""), words);
    } else {
        // Over the guides that run there.
        rect(
            out,
            [from - 0.93 * width - 14.0, y - HIGH + 2.0, 0.93 * width + 12.0, HIGH - 5.0],
            "#fff",
            " fill-opacity=\"0.6\"",
        );
        text(out, from - 8.0, middle, "end", &format!("fill=\"{INK}\""), words);
    }
}

pub(super) fn arrow(out: &mut String, from: f64, until: f64, y: f64) {
    if until - from < 14.0 {
        return;
    }
    *out += &format!(
        "<path d=\"M{:.1} {y:.1}H{:.1}M{:.1} {:.1}l-6 4l6 4M{:.1} {:.1}l6 4l-6 4\" stroke=\"{INK}\" fill=\"none\"/>\n",
        from + 2.0,
        until - 2.0,
        from + 8.0,
        y - 4.0,
        until - 8.0,
        y - 4.0
    );
}

/// Round times under the enlarged frame.
pub(super) fn ticks(
    out: &mut String,
    from: f64,
    until: f64,
    place: &dyn Fn(f64) -> f64,
    top: f64,
    bottom: f64,
) {
    let rough = (until - from) / 9.0;
    let power = libm::pow(10.0, libm::floor(libm::log10(rough)));
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|step| *step >= rough).unwrap_or(rough);
    for number in 0..20_i32 {
        let at = f64::from(number) * step;
        if at > until {
            break;
        }
        let x = place(at);
        line(out, [x, top - 4.0, x, bottom], "#e9dfd7", "1", "");
        line(out, [x, bottom, x, bottom + 6.0], FAINT, "1", "");
        text(out, x, bottom + 20.0, "middle", "font-size=\"11\"", &time(at));
    }
    let style = format!("fill=\"{FAINT}\" font-size=\"11\"");
    text(out, LEFT, bottom + 40.0, "start", &style, "time after this frame's T0");
}

pub(super) fn line(out: &mut String, [x0, y0, x1, y1]: [f64; 4], colour: &str, width: &str, dashes: &str) {
    let dashes = if dashes.is_empty() { String::new() } else { format!(" stroke-dasharray=\"{dashes}\"") };
    *out += &format!(
        "<path d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"{dashes}/>\n"
    );
}

pub(super) fn rect(out: &mut String, [x, y, width, height]: [f64; 4], fill: &str, more: &str) {
    *out += &format!(
        "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\"{more}/>\n"
    );
}

pub(super) fn text(out: &mut String, x: f64, y: f64, anchor: &str, style: &str, words: &str) {
    *out += &format!(
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{}</text>\n",
        escape(words)
    );
}

/// A time in the unit that suits it, with at most four digits after the point.
pub(super) fn time(ns: f64) -> String {
    let (value, unit) = match ns.abs() {
        0.0 => return "0".to_owned(),
        t if t < 1e3 => (ns, "ns"),
        t if t < 1e6 => (ns * 1e-3, "µs"),
        t if t < 1e9 => (ns * 1e-6, "ms"),
        t if t < 3.6e12 => (ns * 1e-9, "s"),
        _ => (ns / 3.6e12, "h"),
    };
    let digits = format!("{value:.4}");
    format!("{} {unit}", digits.trim_end_matches('0').trim_end_matches('.'))
}
