//! `ditd bench`: times of this machine, each with the error of what was timed.
//!
//! Every time is the minimum of several runs: what else the machine does can only make it longer.

mod fit;
mod mie;
mod render;
#[cfg(feature = "aravis")]
mod wires;

use super::{CommandResult, print};
use crate::clock::Clock;
use serde::Serialize;
use std::fmt::Write as _;

/// A number is measured for this long, s …
const SECONDS: f64 = 0.3;
/// … but at least this often, and …
const RUNS_MIN: u32 = 5;
/// … at most this often.
const RUNS_MAX: u32 = 100_000;
/// Short work is repeated within a run until the run takes this long, s: a thousand grains of the clock.
const RUN_MIN: f64 = 5e-5;

/// Arguments of `ditd bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, clap::Subcommand)]
enum Task {
    /// The estimator: errors and coverage on generated shots, times of sums and solves; some minutes
    Fit(fit::Args),
    /// Mie theory: tables of spheres, single spheres, angles, size distributions on one thread; clouds on all
    Mie(Output),
    /// Instruments on their lines: exchanges, rates and latency of a GigE camera on loopback; some minutes
    #[cfg(feature = "aravis")]
    Wires(wires::Args),
    /// The ray tracer: time against error of every mode, and with the size of scene and spray; a minute or two a subject
    Render(render::Args),
}

#[derive(Debug, clap::Args)]
struct Output {
    /// Print a list of JSON objects
    #[arg(long)]
    json: bool,
}

/// One figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Figure {
    /// What was timed.
    name: String,
    /// Time of all of it, s; the minimum of several runs.
    seconds: f64,
    /// Error of its answers.
    error: f64,
    /// What that error is.
    error_kind: String,
    /// How many things were computed.
    n: usize,
    /// Threads that were used.
    threads: usize,
    /// Seed of its random numbers; none where there are none.
    seed: Option<u64>,
}

/// Runs the command.
///
/// # Errors
///
/// Status 1 when something cannot be measured or printed.
pub fn run(args: &Args, clock: &Clock) -> CommandResult {
    if cfg!(debug_assertions) {
        eprintln!("ditd bench: this is a development build; figures are those of `cargo build --release`");
    }
    let watch = Watch { clock, seconds: SECONDS };
    let (output, figures) = match &args.task {
        Task::Fit(args) => (&args.output, fit::figures(&watch, args)?),
        Task::Mie(output) => (output, mie::figures(&watch)?),
        #[cfg(feature = "aravis")]
        Task::Wires(args) => (&args.output, wires::figures(&watch, args)?),
        Task::Render(args) => (&args.output, render::figures(&watch, args)?),
    };
    if output.json { print(&format!("{}\n", serde_json::json!(figures))) } else { print(&table(&figures)) }
}

/// A stopwatch that repeats.
struct Watch<'a> {
    clock: &'a Clock,
    /// How long a number is measured, s.
    seconds: f64,
}

impl Watch<'_> {
    /// Minimum time of a few runs of long work, s.
    fn best_of(&self, runs: u32, mut work: impl FnMut()) -> f64 {
        let mut best = f64::INFINITY;
        for _ in 0..runs {
            let begin = self.clock.elapsed().as_secs_f64();
            work();
            best = best.min(self.clock.elapsed().as_secs_f64() - begin);
        }
        best
    }

    /// Minimum time of `work`, s. It runs twice before, so that nothing is cold.
    fn fastest(&self, mut work: impl FnMut()) -> f64 {
        let now = || self.clock.elapsed().as_secs_f64();
        let mut timed = |calls: u32| {
            let begin = now();
            for _ in 0..calls {
                work();
            }
            (now() - begin) / f64::from(calls)
        };
        timed(1);
        let once = timed(1).max(1e-9);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to 1 ..= 50 000"
        )]
        let calls = (RUN_MIN / once).clamp(1.0, 5e4) as u32;
        let (begin, mut best) = (now(), once);
        for run in 0..RUNS_MAX {
            if run >= RUNS_MIN && now() - begin > self.seconds {
                break;
            }
            best = best.min(timed(calls));
        }
        best
    }
}

/// Figures for the eye.
fn table(figures: &[Figure]) -> String {
    let width = figures.iter().map(|figure| figure.name.chars().count()).max().unwrap_or(0).max(4);
    let mut out = format!(
        "{:width$} {:>10} {:>10} {:>8} {:>8}  error of\n",
        "name", "time", "each", "threads", "error"
    );
    for figure in figures {
        #[expect(clippy::cast_precision_loss, reason = "counts far below 2⁵³")]
        let each = figure.seconds / figure.n.max(1) as f64;
        let _ = writeln!(
            out,
            "{:width$} {:>10} {:>10} {:>8} {:>8.1e}  {}",
            figure.name,
            duration(figure.seconds),
            duration(each),
            figure.threads,
            figure.error,
            figure.error_kind
        );
    }
    out
}

/// Three digits with a unit that fits.
fn duration(seconds: f64) -> String {
    let (value, unit) = match seconds {
        s if s >= 1.0 => (s, "s"),
        s if s >= 1e-3 => (s * 1e3, "ms"),
        s if s >= 1e-6 => (s * 1e6, "µs"),
        s => (s * 1e9, "ns"),
    };
    let decimals = match value {
        v if v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        _ => 2,
    };
    format!("{value:.decimals$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_three_digits_and_a_unit() {
        for (seconds, text) in [
            (2.5, "2.50 s"),
            (0.0123, "12.3 ms"),
            (4.56e-7, "456 ns"),
            (1.04e-6, "1.04 µs"),
            (123.4, "123 s"),
        ] {
            assert_eq!(duration(seconds), text);
        }
    }

    #[test]
    fn the_minimum_of_work_is_the_time_of_one_call() {
        let mut calls = 0u64;
        let clock = Clock::start();
        let took = Watch { clock: &clock, seconds: 0.0 }.fastest(|| calls += 1);
        assert!(took > 0.0 && took < 1e-3 && calls > u64::from(RUNS_MIN), "{took} {calls}");
    }

    #[test]
    fn figures_are_printed_with_every_key() {
        let figure = Figure {
            name: "work".into(),
            seconds: 2e-3,
            error: 1e-15,
            error_kind: "truth".into(),
            n: 4,
            threads: 1,
            seed: None,
        };
        let json = serde_json::json!([figure]);
        for key in ["name", "seconds", "error", "error_kind", "n", "threads", "seed"] {
            assert!(json[0].get(key).is_some(), "{key}");
        }
        assert!(table(&[figure]).contains("2.00 ms     500 µs"));
    }
}
