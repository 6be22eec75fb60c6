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
    last_reason: String,
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
        Self { bar, title: title.to_owned(), cycles: String::new(), last_reason: String::new() }
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
        self.last_reason = reason.to_owned();
        if let Some(bar) = &self.bar {
            let eta = eta_s.map_or_else(String::new, |s| format!(", about {}", duration_words(s)));
            bar.set_message(format!("waiting: {reason}{eta}"));
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
    use super::duration_words;

    #[test]
    fn durations_read_like_words() {
        assert_eq!(duration_words(12.4), "12 s");
        assert_eq!(duration_words(190.0), "3 min 10 s");
        assert_eq!(duration_words(3720.0), "1 h 02 min");
        assert_eq!(duration_words(f64::NAN), "unknown");
    }
}
