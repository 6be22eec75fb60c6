//! What the operator sees on standard error: a bar on a terminal, sparse lines elsewhere.

use crate::campaign::{Progress, Recorder};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};

/// Progress on standard error.
#[derive(Debug)]
pub struct Console {
    bar: Option<ProgressBar>,
    title: String,
    cycles: String,
    waiting: Waiting,
}

/// Which reasons of waiting were told on a stream that is no terminal.
#[derive(Debug, Default)]
struct Waiting {
    /// Kind of the reason told last, and how many were given since.
    told: Option<(String, u32)>,
}

/// The same kind of reason is told again after so many: with a reading a second every five minutes.
const TOLD_AGAIN: u32 = 300;

/// Another kind of reason is not told sooner: two that take turns would fill a log.
const TOLD_APART: u32 = 15;

impl Waiting {
    /// Whether a reason is worth a line.
    fn is_news(&mut self, reason: &str) -> bool {
        // The kind of a reason is its words: numbers change with every reading.
        let kind: String = reason.chars().filter(|c| c.is_alphabetic() || c.is_whitespace()).collect();
        let is_news = match &mut self.told {
            None => true,
            Some((told, since)) => {
                *since += 1;
                *since >= if *told == kind { TOLD_AGAIN } else { TOLD_APART }
            }
        };
        if is_news {
            self.told = Some((kind, 0));
        }
        is_news
    }
}

impl Console {
    /// For a phase called `title`.
    pub fn new(title: &str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(1);
            let style = ProgressStyle::with_template("{prefix} [{bar:30}] {pos}/{len} {wide_msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(title.to_owned());
            bar
        });
        Self { bar, title: title.to_owned(), cycles: String::new(), waiting: Waiting::default() }
    }

    /// A line that stays.
    pub fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(format!("{}: {text}", self.title)),
            // A terminal that has gone must not end a campaign.
            None => drop(writeln!(std::io::stderr(), "{}: {text}", self.title)),
        }
    }

    /// Work that is not made of cycles: a fraction of 0 … 1.
    pub fn fraction(&self, text: &str, done: f64) {
        if let Some(bar) = &self.bar {
            bar.set_length(100);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to 0 … 100"
            )]
            bar.set_position((done.clamp(0.0, 1.0) * 100.0) as u64);
            bar.set_message(text.to_owned());
        }
    }

    /// Ends the bar.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Seconds as `1 h 02 min`, `3 min 10 s` or `12 s`.
pub fn duration_words(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return "unknown".to_owned();
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates; checked not negative"
    )]
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

impl Progress for Console {
    fn cycle(&mut self, done: u32, planned: u32, eta_s: f64) {
        self.cycles = format!("about {} left", duration_words(eta_s));
        if let Some(bar) = &self.bar {
            bar.set_length(u64::from(planned));
            bar.set_position(u64::from(done));
            bar.set_message(self.cycles.clone());
        }
    }

    fn waiting(&mut self, reason: &str, eta_s: Option<f64>) {
        let eta = eta_s.map_or_else(String::new, |s| format!(", about {} left", duration_words(s)));
        match &self.bar {
            Some(bar) => bar.set_message(format!("waiting: {reason}{eta}")),
            None if self.waiting.is_news(reason) => self.line(&format!("waiting: {reason}{eta}")),
            None => {}
        }
    }

    fn note(&mut self, text: &str) {
        self.line(text);
    }

    fn level_done(&mut self, recorder: &Recorder) {
        let reduced = recorder.reduced();
        let done = reduced.levels.iter().filter(|level| level.accepted > 0).count();
        if let Some(state) = reduced.levels.iter().rfind(|level| level.accepted > 0) {
            let retaken = state.rejected.len();
            self.line(&format!(
                "level {done} of {}: {:.2} K, {} cycle(s){}",
                reduced.levels.len(),
                state.plate_mean_k().unwrap_or(f64::NAN),
                state.accepted,
                if retaken > 0 { format!(", {retaken} taken again") } else { String::new() }
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A soak as it is told in a log: from far outside, once in the band, and then nothing for five minutes.
    #[test]
    fn a_log_gets_new_kinds_of_reasons_and_not_every_number() {
        let mut waiting = Waiting::default();
        let outside =
            (0..200).filter(|n| waiting.is_news(&format!("{n}.00 K, band 373.00 ± 0.30 K"))).count();
        assert_eq!(outside, 1);
        let held = (0..60).filter(|n| waiting.is_news(&format!("373.1 K in band, held {n} of 60 s"))).count();
        assert_eq!(held, 1);
        let turns = (0..100).filter(|n| waiting.is_news(["in band", "outside"][n % 2])).count();
        assert!((5..=8).contains(&turns), "{turns}");
    }

    #[test]
    fn durations_read_like_words() {
        assert_eq!(duration_words(12.4), "12 s");
        assert_eq!(duration_words(190.0), "3 min 10 s");
        assert_eq!(duration_words(3720.0), "1 h 02 min");
        assert_eq!(duration_words(f64::NAN), "unknown");
    }
}
