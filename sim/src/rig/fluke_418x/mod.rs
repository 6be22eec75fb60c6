//! The instrument's side of a Fluke 4180 or 4181 infrared calibrator on a stream of bytes.
//!
//! Same codec as the driver, same manual (Users Guide rev. 812301-EN, 2007): replies end with CR alone unless told
//! otherwise, sets are silent, bad commands get silence and an entry in the error queue, a reply that was not read
//! before the next command is lost. Knows no heat: that is the plate's.

mod unit;

#[cfg(test)]
mod tests;

use crate::rig::line::{Line, LineFault, Unsent, check_replies, check_seconds};
use crate::rig::plate::Plate;
use ditd_drivers::fluke_418x::{CommandError, Model};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;
use unit::{Complaint, Unit};

/// What a calibrator is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlukeBehaviour {
    /// Which model it says it is.
    #[serde(default = "FlukeBehaviour::paper_model")]
    pub model: Model,
    /// Time from a query to its reply, in seconds.
    #[serde(default = "FlukeBehaviour::reply_delay_s")]
    pub reply_delay_s: f64,
    /// Replies end with CR LF instead of CR alone.
    #[serde(default)]
    pub linefeed: bool,
    /// It was left in degrees Fahrenheit.
    #[serde(default)]
    pub fahrenheit: bool,
    /// It was left with a decimal comma.
    #[serde(default)]
    pub decimal_comma: bool,
    /// Conditional protection is on: keypad lock and soft cutout ask for the password.
    #[serde(default)]
    pub protected: bool,
    /// Level of its soft cutout in °C; as delivered when absent.
    pub soft_cutout_c: Option<f64>,
    /// Somebody sets it to °F at the keypad at this time, in seconds of the rig's clock.
    pub fahrenheit_at_s: Option<f64>,
    /// Somebody switches its output off at this time, in seconds of the rig's clock.
    pub output_off_at_s: Option<f64>,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub faults: Vec<LineFault>,
}

impl FlukeBehaviour {
    /// A 4181 as delivered.
    pub fn fluke_4181() -> Self {
        Self {
            model: Self::paper_model(),
            reply_delay_s: Self::reply_delay_s(),
            linefeed: false,
            fahrenheit: false,
            decimal_comma: false,
            protected: false,
            soft_cutout_c: None,
            fahrenheit_at_s: None,
            output_off_at_s: None,
            faults: Vec::new(),
        }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_replies(self.reply_delay_s, &self.faults)?;
        self.fahrenheit_at_s.iter().try_for_each(|at_s| check_seconds("fahrenheit_at_s", *at_s))?;
        self.output_off_at_s.iter().try_for_each(|at_s| check_seconds("output_off_at_s", *at_s))?;
        if self.soft_cutout_c.is_some_and(|level| !(0.0..=520.0).contains(&level)) {
            return Err("soft_cutout_c: 0 to 520".to_owned());
        }
        Ok(())
    }

    fn paper_model() -> Model {
        Model::Fluke4181
    }

    /// The manual says "at once"; 10 ms is what a reply of some ten characters takes at 9600 baud.
    fn reply_delay_s() -> f64 {
        0.010
    }
}

/// Answers on a stream until the other side has gone. `start` is the zero of the rig's clock, which the plate shares.
///
/// # Panics
/// When another user of the plate has panicked while holding it, or the behaviour fails its check.
pub async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    plate: Arc<Mutex<Plate>>,
    behaviour: FlukeBehaviour,
    start: Instant,
) {
    assert_eq!(behaviour.check(), Ok(()), "the behaviour was checked where it was read");
    let delay = Duration::from_secs_f64(behaviour.reply_delay_s);
    let mut line = Line::new(stream, behaviour.faults.clone(), Unsent::Lost, start);
    let mut unit = Unit::new(&behaviour, plate);
    while let Some(command) = line.next_command().await {
        unit.look(line.now_s());
        let answered = match command {
            Ok(text) => unit.obey(&text),
            Err(_) => Err(Complaint::Command(CommandError::Undefined)),
        };
        match answered {
            Ok(Some(answer)) => line.reply(&format!("{answer}{}", unit.line_end()), delay),
            Ok(None) => {}
            Err(complaint) => unit.complain(complaint),
        }
    }
}
