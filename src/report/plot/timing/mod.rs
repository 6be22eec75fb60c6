//! The pulses of a program of shots as a drawing: one cycle in full, its pause broken, and the spray frame enlarged.
//!
//! Drawn from the same [`ShotProgram`] that the trigger unit is given, so that it can be laid beside the screen of an
//! oscilloscope. Pulses too short to be seen are drawn with a least width; the numbers tell the truth.

mod ink;

use super::FONT;
use ditd_drivers::instrument::{ShotKind, ShotProgram};
use ink::{
    BREAK, FAINT, FRAMES_DRAWN_MAX, HIGH, INK, LEFT, PULSE_MIN, RIGHT, ROW, SIGNALS, WIDTH, arrow, base,
    broken, frame_names, label, line, more, pulse, rect, text, ticks, time,
};

/// What is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Timing<'a> {
    /// Above everything.
    pub title: &'a str,
    /// The program.
    pub program: &'a ShotProgram,
    /// Integration time of the camera, in s.
    pub integration_s: f64,
    /// Read-out time of the camera, in s.
    pub readout_s: f64,
}

/// When a signal is on within a frame, in ns after its T0; `until` may lie beyond the period.
#[derive(Debug, Clone, Copy, PartialEq)]
struct On {
    signal: usize,
    from: f64,
    until: f64,
}

/// A column of the full cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Slot {
    Frame(u32),
    /// So many frames like their neighbours.
    More(u32),
}

impl Timing<'_> {
    /// The complete SVG file, with a white ground.
    pub fn to_svg(&self) -> String {
        let panel = 5.0 * ROW;
        let (first, second) = (116.0, 116.0 + panel + 108.0);
        let height = second + panel + 138.0;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" \
             height=\"{height}\" {FONT}>\n<rect width=\"{WIDTH}\" height=\"{height}\" fill=\"#fff\"/>\n"
        );
        text(&mut out, 24.0, 32.0, "start", "font-size=\"19\" font-weight=\"600\"", self.title);
        text(&mut out, 24.0, 54.0, "start", &format!("font-size=\"13\" fill=\"{FAINT}\""), &self.summary());
        self.cycle(&mut out, first);
        self.zoom(&mut out, second);
        self.numbers(&mut out, second + panel + 76.0);
        out + "</svg>\n"
    }

    fn summary(&self) -> String {
        let p = self.program;
        let last = if p.inject { "1 spray frame" } else { "no spray" };
        let blanks = if p.inject { p.blanks } else { p.blanks + 1 };
        format!(
            "{} cycles of {} discarded + {blanks} blank + {last}, {} apart; a cycle every {}",
            p.cycles,
            p.warm_up,
            time(p.period_ns as f64),
            time(p.cycle_ns() as f64)
        )
    }

    /// What is on within a frame of this kind.
    fn on(&self, kind: ShotKind) -> Vec<On> {
        let p = self.program;
        let camera = p.camera_delay_ns as f64;
        let exposed = camera + self.integration_s * 1e9;
        let mut on = vec![
            On { signal: 0, from: 0.0, until: 0.0 },
            On { signal: 2, from: camera, until: camera + p.camera_width_ns as f64 },
            On { signal: 3, from: camera, until: exposed },
            On { signal: 4, from: exposed, until: exposed + self.readout_s * 1e9 },
        ];
        if kind == ShotKind::Spray {
            let from = p.injector_delay_ns as f64;
            on.push(On { signal: 1, from, until: from + p.injector_width_ns as f64 });
        }
        on
    }

    // ------------------------------------------------------------------------------------------ the cycle

    fn slots(&self) -> Vec<Slot> {
        let p = self.program;
        let frames = p.frames_per_cycle();
        if frames as usize <= FRAMES_DRAWN_MAX {
            return (0..frames).map(Slot::Frame).collect();
        }
        let mut slots = Vec::new();
        for (from, until) in [(0, p.warm_up), (p.warm_up, frames - 1)] {
            let count = until - from;
            if count <= 5 {
                slots.extend((from..until).map(Slot::Frame));
            } else {
                slots.extend([Slot::Frame(from), Slot::Frame(from + 1), Slot::More(count - 4)]);
                slots.extend([Slot::Frame(until - 2), Slot::Frame(until - 1)]);
            }
        }
        slots.push(Slot::Frame(frames - 1));
        slots
    }

    fn cycle(&self, out: &mut String, top: f64) {
        let p = self.program;
        let slots = self.slots();
        let period = p.period_ns as f64;
        let right = WIDTH - RIGHT;
        #[expect(clippy::cast_precision_loss, reason = "a dozen columns")]
        let column = (right - LEFT - BREAK) / (slots.len() as f64 + 1.0);
        text(out, 24.0, top - 34.0, "start", "font-size=\"14\" font-weight=\"600\"", "One cycle");
        let mut x = LEFT;
        for slot in &slots {
            match slot {
                Slot::Frame(position) => self.frame(out, x, column, top, *position, 0.0),
                Slot::More(count) => more(out, x, column, top, *count),
            }
            x += column;
        }
        let (pause, next) = (x, x + BREAK);
        self.frame(out, next, column, top, 0, p.cycle_ns() as f64);
        frame_names(out, top);
        for (row, (_, _, colour)) in SIGNALS.iter().enumerate() {
            let y = base(top, row);
            line(out, [pause, y, next, y], colour, "1.4", "2 5");
        }
        broken(out, [pause, next], top, p.inject);
        let length = p.cycle_ns() as f64 - period * f64::from(p.frames_per_cycle());
        let middle = 0.5 * (pause + next);
        text(out, middle, top - 12.0, "middle", "font-weight=\"600\"", &format!("pause {}", time(length)));
        text(out, right - 0.5 * column, top - 12.0, "middle", &format!("fill=\"{FAINT}\""), "next cycle");
        let y = top + 5.0 * ROW + 40.0;
        let style = format!("fill=\"{FAINT}\" font-size=\"11\"");
        text(out, LEFT, y, "start", &style, "time after the first frame's T0");
    }

    /// One frame's column: its name, the signals, and its T0 on the time axis.
    fn frame(&self, out: &mut String, x: f64, column: f64, top: f64, position: u32, later_ns: f64) {
        let p = self.program;
        let Some(kind) = p.kind_at(position) else { return };
        let bottom = top + 5.0 * ROW;
        let (fill, ink, name) = match kind {
            ShotKind::WarmUp => ("#eef0f3", FAINT, format!("discarded {}", position + 1)),
            ShotKind::Blank => ("#e3f0f9", "#0072b2", format!("blank {}", position - p.warm_up + 1)),
            ShotKind::Spray => ("#fbe6d6", "#d55e00", "spray".to_owned()),
        };
        rect(out, [x + 1.0, top - 4.0, column - 2.0, bottom - top + 4.0], fill, "");
        if later_ns <= 0.0 {
            let weight = if kind == ShotKind::Spray { "700" } else { "400" };
            // In narrow columns only the number is there; the colour tells the kind.
            #[expect(clippy::cast_precision_loss, reason = "a short word")]
            let fits = 6.5 * (name.chars().count() as f64) < column;
            let name = if fits { name.as_str() } else { name.rsplit(' ').next().unwrap_or_default() };
            let style = format!("fill=\"{ink}\" font-weight=\"{weight}\"");
            text(out, x + 0.5 * column, top - 12.0, "middle", &style, name);
        }
        let period = (p.period_ns as f64).max(1.0);
        let place = |ns: f64| x + (ns / period).min(1.0) * column;
        for (row, (_, _, colour)) in SIGNALS.iter().enumerate() {
            let y = base(top, row);
            line(out, [x, y, x + column, y], colour, "1.4", "");
        }
        for on in self.on(kind) {
            let from = place(on.from);
            let width = (place(on.until.min(period)) - from).max(PULSE_MIN);
            pulse(out, from, width, base(top, on.signal), SIGNALS[on.signal].2);
        }
        line(out, [x, bottom, x, bottom + 6.0], FAINT, "1", "");
        let at_ns = later_ns + if later_ns > 0.0 { 0.0 } else { period * f64::from(position) };
        text(out, x, bottom + 20.0, "middle", "font-size=\"11\"", &time(at_ns));
    }

    // ------------------------------------------------------------------------------------------- the zoom

    fn zoom(&self, out: &mut String, top: f64) {
        let p = self.program;
        let kind = if p.inject { ShotKind::Spray } else { ShotKind::Blank };
        let on = self.on(kind);
        let period = p.period_ns as f64;
        let shown = on.iter().filter(|on| on.signal < 4).map(|on| on.until).fold(0.0, f64::max);
        let until = (1.32 * shown).min(period).max(1.0);
        let from = -0.06 * until;
        let right = WIDTH - RIGHT;
        let place = |ns: f64| LEFT + (ns - from) / (until - from) * (right - LEFT);
        let bottom = top + 5.0 * ROW;
        let title = if p.inject { "The spray frame, enlarged" } else { "A frame, enlarged" };
        text(out, 24.0, top - 22.0, "start", "font-size=\"14\" font-weight=\"600\"", title);
        let fill = if p.inject { "#fdf3ec" } else { "#f1f7fc" };
        rect(out, [LEFT, top - 4.0, right - LEFT, bottom - top + 4.0], fill, "");
        ticks(out, from, until, &place, top, bottom);
        for on in on.iter().filter(|on| on.signal != 0 && on.signal != 4) {
            let x = place(on.from);
            line(out, [x, top, x, bottom], SIGNALS[on.signal].2, "1", "1 4");
        }
        frame_names(out, top);
        for (row, (_, _, colour)) in SIGNALS.iter().enumerate() {
            line(out, [LEFT, base(top, row), right, base(top, row)], colour, "1.6", "");
        }
        for on in &on {
            let (x, end) = (place(on.from), place(on.until).min(right));
            pulse(out, x, (end - x).max(PULSE_MIN), base(top, on.signal), SIGNALS[on.signal].2);
            if place(on.until) > right + 1.0 {
                let y = base(top, on.signal) - 0.5 * HIGH;
                *out += &format!(
                    "<path d=\"M{:.1} {:.1}l8 7l-8 7\" stroke=\"{INK}\" fill=\"none\"/>\n",
                    right - 14.0,
                    y - 7.0
                );
            }
        }
        self.dimensions(out, &on, &place, top);
    }

    fn dimensions(&self, out: &mut String, on: &[On], place: &dyn Fn(f64) -> f64, top: f64) {
        let right = WIDTH - RIGHT;
        let words = |signal: usize, on: &On| {
            let length = time(on.until - on.from);
            match signal {
                1 => format!("injection {length}"),
                2 => format!("trigger {length}"),
                3 => format!("exposure {length}"),
                _ => format!(
                    "read-out {length}, until {} after T0; the next frame comes at {}",
                    time(on.until),
                    time(self.program.period_ns as f64)
                ),
            }
        };
        for on in on.iter().filter(|on| on.signal > 0) {
            let (x, end) = (place(on.from), place(on.until).min(right));
            label(out, [x, end], base(top, on.signal), SIGNALS[on.signal].2, &words(on.signal, on));
        }
        if on.iter().any(|on| on.signal == 1) && self.program.camera_delay_ns > self.program.injector_delay_ns
        {
            let (from, until) = (self.program.injector_delay_ns as f64, self.program.camera_delay_ns as f64);
            let y = base(top, 3) - 0.5 * HIGH;
            arrow(out, place(from), place(until), y);
            let words = format!("{} after the start of injection", time(until - from));
            let (middle, width) = (0.5 * (place(from) + place(until)), 6.4 * words.chars().count() as f64);
            if place(until) - place(from) > width + 20.0 {
                rect(out, [middle - 0.5 * width - 4.0, y - 9.0, width + 8.0, 18.0], "#fdf3ec", "");
                text(out, middle, y + 4.0, "middle", "", &words);
            }
        }
    }

    fn numbers(&self, out: &mut String, y: f64) {
        let p = self.program;
        let mut entries = vec![
            ("period", time(p.period_ns as f64)),
            ("cycle", format!("{} = {} periods", time(p.cycle_ns() as f64), p.cycle_periods)),
            ("burst", format!("{} cycles, {}", p.cycles, time(p.burst_ns() as f64))),
            (
                "camera",
                format!("T0 + {}, {} wide", time(p.camera_delay_ns as f64), time(p.camera_width_ns as f64)),
            ),
        ];
        if p.inject {
            entries.push((
                "injector",
                format!(
                    "T0 + {}, {} wide",
                    time(p.injector_delay_ns as f64),
                    time(p.injector_width_ns as f64)
                ),
            ));
        }
        line(out, [24.0, y - 22.0, WIDTH - RIGHT, y - 22.0], "#e1e5ea", "1", "");
        #[expect(clippy::cast_precision_loss, reason = "five entries")]
        let step = (WIDTH - 24.0 - RIGHT) / entries.len() as f64;
        for (place, (name, value)) in entries.iter().enumerate() {
            #[expect(clippy::cast_precision_loss, reason = "five entries")]
            let x = 24.0 + step * place as f64;
            text(out, x, y, "start", &format!("font-size=\"11\" fill=\"{FAINT}\""), name);
            text(out, x, y + 18.0, "start", "font-size=\"13\"", value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program() -> ShotProgram {
        ShotProgram {
            period_ns: 20_000_000,
            wait_periods: 1,
            warm_up: 4,
            blanks: 4,
            inject: true,
            cycle_periods: 759,
            cycles: 12,
            camera_delay_ns: 900_000,
            camera_width_ns: 25_000,
            injector_delay_ns: 0,
            injector_width_ns: 1_000_000,
        }
    }

    fn svg(program: &ShotProgram) -> String {
        Timing { title: "a < b", program, integration_s: 25e-6, readout_s: 0.0066 }.to_svg()
    }

    #[test]
    fn every_frame_is_named_once_and_the_numbers_are_there() {
        let svg = svg(&program());
        for (words, count) in [
            (">discarded 4<", 1),
            (">blank 4<", 1),
            (">blank 5<", 0),
            (">spray<", 1),
            (">pause 15 s<", 1),
            (">injection 1 ms<", 1),
            (">exposure 25 µs<", 1),
            (">900 µs after the start of injection<", 1),
            (">15.18 s = 759 periods<", 1),
            ("until 7.525 ms after T0", 1),
            ("a &lt; b", 1),
        ] {
            assert_eq!(svg.matches(words).count(), count, "{words}");
        }
        // One injection in the cycle, one in the zoom.
        assert_eq!(svg.matches("fill=\"#d55e00\" fill-opacity").count(), 2);
    }

    #[test]
    fn long_cycles_are_shortened_and_nothing_leaves_the_page() {
        let long = ShotProgram { warm_up: 1000, blanks: 256, cycle_periods: 5000, ..program() };
        let svg_long = svg(&long);
        assert!(svg_long.contains(">996 more<") && svg_long.contains(">252 more<"), "{svg_long}");
        let none = ShotProgram { inject: false, ..program() };
        assert!(!svg(&none).contains(">spray<") && svg(&none).contains(">blank 5<"));
        for program in [
            long,
            none,
            ShotProgram { warm_up: 0, blanks: 0, cycle_periods: 2, ..program() },
            ShotProgram { injector_delay_ns: 15_000_000, camera_delay_ns: 19_900_000, ..program() },
            ShotProgram { period_ns: 0, ..program() },
            ShotProgram { camera_delay_ns: 0, camera_width_ns: 0, injector_width_ns: 0, ..program() },
        ] {
            let svg = svg(&program);
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{program:?}");
            let widths = svg.split(" width=\"").skip(1).filter_map(|rest| rest.split('"').next());
            assert!(widths.flat_map(str::parse::<f64>).all(|width| (0.0..=WIDTH).contains(&width)), "{svg}");
        }
    }

    #[test]
    fn times_choose_their_unit() {
        let words: Vec<String> =
            [0.0, 10.0, 25e3, 900e3, 7.525e6, 15.18e9, 7.2e12].into_iter().map(time).collect();
        assert_eq!(words, ["0", "10 ns", "25 µs", "900 µs", "7.525 ms", "15.18 s", "2 h"]);
    }
}
