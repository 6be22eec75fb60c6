//! The driver: programs a whole burst, reads every setting back, starts and stops it.

use super::command::{Command, Reply};
use super::settings::settings_of;
use super::table::{Key, table_row};
use super::value::{Value, encode_value};
use super::{INJECTOR_CHANNEL, RANGE};
use crate::error::DriverError;
use crate::instrument::{Begun, Identity, ShotProgram, TriggerUnit};
use crate::keyword::spell;
use crate::trigger_limits::{self, LIMIT_HINT, LastInjection, PANEL_HINT, TriggerLimits};
use crate::wire::{LineHabits, Sign, Tries, Wire, WireSettings};
use async_trait::async_trait;
use std::time::Duration;
use tokio::time::Instant;

/// Time that one command takes (manual, chapter 7: about 10 ms; faster sending may cause the unit not to respond).
const COMMAND_TIME: Duration = Duration::from_millis(10);

/// Bit rate of the RS-232 port at delivery; the USB port comes with 38400.
const BAUD: u32 = 115_200;

/// The line settings of the RS-232 port at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// A 9520 or 575 at the end of a wire.
#[derive(Debug)]
pub struct Quantum9520 {
    wire: Wire,
    limits: TriggerLimits,
    programmed: Option<ShotProgram>,
    started: Option<Started>,
    last_injection: LastInjection,
}

/// A burst that was started.
#[derive(Debug, Clone)]
struct Started {
    program: ShotProgram,
    at: Instant,
}

impl Quantum9520 {
    /// A driver over an open wire. Sends nothing.
    pub fn new(mut wire: Wire, limits: TriggerLimits) -> Self {
        wire.adopt(LineHabits {
            ending: "\r\n",
            deadline: Duration::from_secs(1),
            pace: COMMAND_TIME,
            // No command with `*`: while the unit boots it may lock up (manual, chapter 7).
            sign: Some(Sign { query: ":INST:CAT?", fits: |line| line.starts_with("T0,") }),
            hint: "Check power, cable and baud rate (RS-232 comes with 115200, USB with 38400).",
        });
        Self { wire, limits, programmed: None, started: None, last_injection: LastInjection::default() }
    }

    async fn exchange(&mut self, command: &Command, doing: &str) -> Result<Reply, DriverError> {
        let answer = self.wire.ask(&command.encode(), doing).await?;
        match Reply::decode(command.key, &answer) {
            Ok(Reply::Failed(error)) => {
                Err(self.refused(doing, format!("{} is answered by {error}", command.encode())))
            }
            Ok(reply) => Ok(reply),
            Err(why) => Err(self.wire.unexpected(doing, &answer, why)),
        }
    }

    /// An exchange that may be repeated without harm.
    async fn exchange_patiently(&mut self, command: &Command, doing: &str) -> Result<Reply, DriverError> {
        let mut tries = Tries::default();
        loop {
            match self.exchange(command, doing).await {
                // What it holds is read back after every program, so that it may be said again.
                Err(failure) => tries.again_if_reopened(failure)?,
                reply => return reply,
            }
        }
    }

    async fn query(&mut self, command: &Command, doing: &str) -> Result<Value, DriverError> {
        match self.exchange_patiently(command, doing).await? {
            Reply::Value(value) => Ok(value),
            _ => Err(self.wire.unexpected(doing, "ok", "expected a value")),
        }
    }

    async fn tell(&mut self, command: &Command, doing: &str) -> Result<(), DriverError> {
        match self.exchange_patiently(command, doing).await? {
            Reply::Done => Ok(()),
            reply => Err(self.wire.unexpected(doing, &reply.encode(command.key), "expected ok")),
        }
    }

    /// Tells a value and confirms it by its query.
    async fn set(&mut self, channel: u32, key: Key, value: Value, doing: &str) -> Result<(), DriverError> {
        self.tell(&Command::set_channel(channel, key, value.clone()), doing).await?;
        let taken = self.query(&Command::query_channel(channel, key), doing).await?;
        if taken == value {
            return Ok(());
        }
        let (told, taken) = (encode_value(key, &value), encode_value(key, &taken));
        let spelled = spell(table_row(key).spelling, Some(channel));
        Err(self.refused(doing, format!("{spelled}: told {told}, holds {taken}")))
    }

    async fn is_running(&mut self, doing: &str) -> Result<bool, DriverError> {
        let running = self.query(&Command::query(Key::Running), doing).await?;
        Ok(running == Value::Flag(true))
    }

    /// A reference that the clock does not follow makes every period wrong; the unit says so by a question mark after its
    /// name (seen at a 9530).
    async fn check_clock(&mut self, doing: &str) -> Result<(), DriverError> {
        match self.query(&Command::query_channel(0, Key::ClockIn), doing).await? {
            Value::Unlocked(source) => {
                Err(self.refused(doing, format!("its clock does not follow the reference {source}")))
            }
            _ => Ok(()),
        }
    }

    /// The injections of one burst keep their distance by its cycle; this keeps it between two bursts.
    fn check_interval(&self, program: &ShotProgram) -> Result<(), DriverError> {
        if !program.inject {
            return Ok(());
        }
        let first_ns = program.frame_ns(0, program.warm_up + program.blanks);
        let first = Instant::now() + Duration::from_nanos(first_ns + program.injector_delay_ns);
        match self.last_injection.complaint(first, &self.limits) {
            None => Ok(()),
            Some(why) => Err(DriverError::limit(self.wire.name(), "starting a burst", why, LIMIT_HINT)),
        }
    }

    /// Remembers when the injector was last fired, at the latest.
    fn note_last_injection(&mut self) {
        let Some(Started { program, at }) = self.started.take().filter(|started| started.program.inject)
        else {
            return;
        };
        let last_ns = program.frame_ns(program.cycles - 1, program.warm_up + program.blanks);
        let planned = at + Duration::from_nanos(last_ns + program.injector_delay_ns);
        self.last_injection.note(planned.min(Instant::now()));
    }

    /// Injector channel off, then clock off; the second is done even if the first fails.
    async fn halt(&mut self, doing: &str) -> Result<(), DriverError> {
        let injector = self.switch_off(INJECTOR_CHANNEL, doing).await;
        let clock = self.switch_off(0, doing).await;
        // A burst of which nobody knows that it has stopped goes on injecting: it is noted when that is known.
        if injector.is_ok() || clock.is_ok() {
            self.note_last_injection();
        }
        injector.and(clock)
    }

    /// Told twice when the first time fails, whatever the reason: off is off, and a line that was lost may be back.
    async fn switch_off(&mut self, channel: u32, doing: &str) -> Result<(), DriverError> {
        match self.set(channel, Key::State, Value::Flag(false), doing).await {
            Ok(()) => Ok(()),
            Err(_) => self.set(channel, Key::State, Value::Flag(false), doing).await,
        }
    }

    fn refused(&self, doing: &str, why: String) -> DriverError {
        DriverError::refused(self.wire.name(), doing, why, PANEL_HINT)
    }
}

#[async_trait]
impl TriggerUnit for Quantum9520 {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let doing = "asking who it is";
        // Answered only when the unit has booted; until then no command with `*` may be sent.
        self.is_running(doing).await?;
        self.tell(&Command::set(Key::Echo, Value::Flag(false)), "switching the echo off").await?;
        let answer = self.query(&Command::query(Key::Identity), doing).await?;
        let text = encode_value(Key::Identity, &answer);
        Identity::of_fields(&text).ok_or_else(|| {
            self.wire.unexpected(doing, &text, "expected maker, model, serial number and version")
        })
    }

    async fn program(&mut self, program: &ShotProgram) -> Result<ShotProgram, DriverError> {
        let doing = "programming a burst";
        self.programmed = None;
        trigger_limits::check(self.wire.name(), program, &self.limits, &RANGE)?;
        if self.is_running(doing).await? {
            return Err(self.refused(doing, "the unit still runs".to_owned()));
        }
        self.note_last_injection();
        self.check_clock(doing).await?;
        let settings = settings_of(program);
        for (channel, key, value) in &settings {
            self.tell(&Command::set_channel(*channel, *key, value.clone()), doing).await?;
        }
        // Read back after everything is set: a later command may have moved an earlier value. The injector's channel
        // is in the list twice when it is used; only its last setting counts.
        for (index, (channel, key, value)) in settings.iter().enumerate() {
            let superseded = settings[index + 1..].iter().any(|later| later.0 == *channel && later.1 == *key);
            if superseded {
                continue;
            }
            let taken = self.query(&Command::query_channel(*channel, *key), doing).await?;
            if taken != *value {
                let (told, taken) = (encode_value(*key, value), encode_value(*key, &taken));
                let spelled = spell(table_row(*key).spelling, Some(*channel));
                return Err(self.refused(doing, format!("{spelled}: told {told}, holds {taken}")));
            }
        }
        self.programmed = Some(program.clone());
        Ok(program.clone())
    }

    async fn start(&mut self) -> Result<Begun, DriverError> {
        let doing = "starting a burst";
        let Some(program) = self.programmed.clone() else {
            return Err(self.refused(doing, "no burst has been programmed since the last error".to_owned()));
        };
        if self.is_running(doing).await? {
            return Err(self.refused(doing, "the unit still runs".to_owned()));
        }
        self.note_last_injection();
        self.check_interval(&program)?;
        let at = Instant::now();
        self.started = Some(Started { program: program.clone(), at });
        // Sent once: repeated after a lost answer it might start a second burst. Whether it was taken, the unit's
        // state tells.
        let taken = match self.exchange(&Command::set_channel(0, Key::State, Value::Flag(true)), doing).await
        {
            Ok(_) => Some(Instant::now()),
            Err(DriverError::Silent { .. } | DriverError::Garbled { .. }) => None,
            Err(error) if error.is_reopened() => None,
            Err(error) => return Err(error),
        };
        let running = self.is_running(doing).await?;
        // A burst that is over already is no failure.
        if running || at.elapsed() >= Duration::from_nanos(program.burst_ns()) {
            return Ok(Begun { earliest: at, latest: taken.unwrap_or_else(Instant::now) });
        }
        Err(self.refused(doing, "told to run, it does not run".to_owned()))
    }

    async fn running(&mut self) -> Result<bool, DriverError> {
        self.is_running("asking whether pulses are made").await
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        self.halt("stopping the clock").await
    }

    async fn make_safe(&mut self) -> Result<(), DriverError> {
        self.programmed = None;
        self.halt("bringing it to its safe state").await
    }
}
