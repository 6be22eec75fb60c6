//! The driver: programs one cycle, reads every setting back, begins cycle after cycle, and stops.
//!
//! Sets are silent: after each program, and after silence, the error queue is read.

use super::command::{Command, Fault};
use super::settings::{Setting, at_rest, settings_of};
use super::table::Key;
use super::value::Value;
use super::{RANGE, event_status, instrument_status, status_byte};
use crate::error::DriverError;
use crate::instrument::{Begun, Identity, ShotProgram, TriggerUnit};
use crate::trigger_limits::{self, LastInjection, PANEL_HINT, TriggerLimits};
use crate::wire::{LineHabits, Sign, Tries, Wire, WireSettings};
use async_trait::async_trait;
use std::time::Duration;
use tokio::time::{Instant, sleep, sleep_until};

/// Bit rate of the RS-232 port at delivery (maker's driver).
const BAUD: u32 = 9600;

/// Left between two lines: a line of 25 characters takes 26 ms at 9600 baud, and no source says how much the unit stores.
const PACE: Duration = Duration::from_millis(30);

/// Codes that are read from the error queue at most: more are a queue that never empties.
const ERRORS_MAX: u32 = 32;

/// How long before a cycle is due the unit is asked whether it may begin, when nobody asked before.
const PREPARATION: Duration = Duration::from_secs(3);

/// How often a stop asks whether the burst is over.
const BUSY_POLL: Duration = Duration::from_millis(50);

/// How long a stop waits beyond the burst that the driver knows of.
const BUSY_MARGIN: Duration = Duration::from_secs(2);

/// The line settings of the RS-232 port at delivery.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// A DG645 at the end of a wire.
#[derive(Debug)]
pub struct Dg645 {
    wire: Wire,
    limits: TriggerLimits,
    programmed: Option<ShotProgram>,
    /// The cycle that is begun next, once the program was started.
    next_cycle: Option<u32>,
    /// It was asked whether that cycle may begin, and it may.
    is_ready: bool,
    /// Until when the last burst makes pulses.
    busy_until: Option<Instant>,
    last_injection: LastInjection,
}

impl Dg645 {
    /// A driver over an open wire. Sends nothing.
    pub fn new(mut wire: Wire, limits: TriggerLimits) -> Self {
        wire.adopt(LineHabits {
            ending: "\r\n",
            deadline: Duration::from_secs(1),
            pace: PACE,
            sign: Some(Sign { query: "*IDN?", fits: |line| line.contains(",DG645,") }),
            hint: "Check power, cable and baud rate (RS-232 comes with 9600; on a network use TCP port 5025).",
        });
        Self {
            wire,
            limits,
            programmed: None,
            next_cycle: None,
            is_ready: false,
            busy_until: None,
            last_injection: LastInjection::default(),
        }
    }

    /// Tells what may be told twice: once more when the line was lost and is back.
    async fn tell(&mut self, command: &Command, doing: &str) -> Result<(), DriverError> {
        match self.wire.tell(&command.encode(), doing).await {
            Err(error) if error.is_reopened() => self.wire.tell(&command.encode(), doing).await,
            result => result,
        }
    }

    /// A query that is asked once: its answer may change what the unit remembers.
    async fn query_once(&mut self, key: Key, index: u32, doing: &str) -> Result<Value, DriverError> {
        let answer = self.wire.ask(&Command::query(key, index).encode(), doing).await?;
        Value::decode(key, &answer).map_err(|why| self.wire.unexpected(doing, &answer, why))
    }

    /// A query that may be repeated without harm. After silence the error queue says whether the question was bad.
    async fn query(&mut self, key: Key, index: u32, doing: &str) -> Result<Value, DriverError> {
        let mut tries = Tries::default();
        loop {
            match self.query_once(key, index, doing).await {
                Err(failure) => {
                    let is_silent = matches!(failure, DriverError::Silent { .. });
                    tries.again_if_reopened(failure)?;
                    if is_silent {
                        self.check_errors(doing).await?;
                    }
                }
                value => return value,
            }
        }
    }

    async fn register(&mut self, key: Key, doing: &str) -> Result<u64, DriverError> {
        match self.query(key, 0, doing).await? {
            Value::Count(bits) => Ok(bits),
            value => Err(self.wire.unexpected(doing, &value.encode(), "expected a register")),
        }
    }

    /// Empties the error queue; what is in it refuses the act.
    async fn check_errors(&mut self, doing: &str) -> Result<(), DriverError> {
        let mut found = Vec::new();
        for _ in 0..ERRORS_MAX {
            let code = match self.query_once(Key::LastError, 0, doing).await {
                Ok(Value::Count(code)) => code,
                Ok(value) => return Err(self.wire.unexpected(doing, &value.encode(), "expected a code")),
                // A code that got lost is an error that nobody will see any more: the read-back is the witness.
                Err(error) if is_answer_lost(&error) => continue,
                Err(error) => return Err(error),
            };
            let Some(fault) = Fault::from_code(code) else {
                if found.is_empty() {
                    return Ok(());
                }
                return Err(self.refused(doing, found.join(", ")));
            };
            found.push(fault.to_string());
        }
        Err(self.refused(doing, format!("its error queue does not get empty: {}", found.join(", "))))
    }

    /// A burst begins now, or may begin.
    fn note_fired(&mut self, program: &ShotProgram) -> Instant {
        let now = Instant::now();
        if program.inject {
            self.last_injection.note(now + injection_after(program));
        }
        let frames = u64::from(program.frames_per_cycle());
        self.busy_until = Some(now + Duration::from_nanos(program.period_ns * frames));
        now
    }

    /// What an earlier user left in the queue is none of our business.
    async fn forget_errors(&mut self, doing: &str) -> Result<(), DriverError> {
        match self.check_errors(doing).await {
            Err(DriverError::Refused { .. }) => self.tell(&Command::act(Key::ClearStatus), doing).await,
            result => result,
        }
    }

    async fn confirm(&mut self, (key, index, told): &Setting, doing: &str) -> Result<(), DriverError> {
        let taken = self.query(*key, *index, doing).await?;
        if taken.is_same(told) {
            return Ok(());
        }
        let spelled = Command::query(*key, *index).encode();
        let (told, taken) = (told.encode(), taken.encode());
        Err(self.refused(doing, format!("{spelled}: told {told}, holds {taken}")))
    }

    async fn set(&mut self, setting: &Setting, doing: &str) -> Result<(), DriverError> {
        self.tell(&Command::set(setting.0, setting.1, setting.2.clone()), doing).await?;
        self.confirm(setting, doing).await
    }

    async fn is_busy(&mut self, doing: &str) -> Result<bool, DriverError> {
        let bits = self.register(Key::StatusByte, doing).await?;
        Ok(bits & (status_byte::BUSY | status_byte::BURST) != 0)
    }

    /// The unit forgets its program when its power fails, and says so once.
    async fn check_power(&mut self, doing: &str) -> Result<(), DriverError> {
        let events = match self.query_once(Key::EventStatus, 0, doing).await {
            Ok(Value::Count(bits)) => bits,
            Err(error) if !is_answer_lost(&error) => return Err(error),
            _ => {
                // The answer is lost and the register is empty now: what it said may be read from the settings.
                let Some(program) = self.programmed.clone() else { return Ok(()) };
                let [.., last] = &settings_of(&program)[..] else { return Ok(()) };
                return self.confirm(last, doing).await;
            }
        };
        if events & event_status::POWER_ON == 0 {
            return Ok(());
        }
        self.programmed = None;
        let why = "it was switched off and on in between, and its program is lost".to_owned();
        Err(self.refused(doing, why))
    }

    /// An inhibit input that silences an output while the others go on makes sprays without fuel and labels without
    /// truth. One that stops triggers as a whole is a safety circuit, and is left alone.
    async fn check_inhibit(&mut self, doing: &str) -> Result<(), DriverError> {
        match self.query(Key::Inhibit, 0, doing).await? {
            Value::Count(0 | 1) => Ok(()),
            value => Err(self.refused(
                doing,
                format!(
                    "INHB is {}: its inhibit input would silence outputs while frames are taken; set it to \
                     triggers (1) or off (0)",
                    value.encode()
                ),
            )),
        }
    }

    /// Injector's amplitude down, single shot, burst mode off, each tried even if an earlier one failed; then waits until
    /// no pulse is made any more.
    async fn halt(&mut self, doing: &str) -> Result<(), DriverError> {
        (self.next_cycle, self.is_ready) = (None, false);
        let mut first = Ok(());
        for setting in at_rest() {
            let done = self.set_patiently(&setting, doing).await;
            first = first.and(done);
        }
        first.and(self.await_rest(doing).await)
    }

    async fn set_patiently(&mut self, setting: &Setting, doing: &str) -> Result<(), DriverError> {
        // Told twice it is the same: the line may have swallowed it, or have been lost and be back.
        match self.set(setting, doing).await {
            Ok(()) => Ok(()),
            Err(_) => self.set(setting, doing).await,
        }
    }

    async fn await_rest(&mut self, doing: &str) -> Result<(), DriverError> {
        let now = Instant::now();
        let until = self.busy_until.map_or(now, |until| until.max(now)) + BUSY_MARGIN;
        while self.is_busy(doing).await? {
            if Instant::now() >= until {
                return Err(self.refused(doing, "it still makes pulses".to_owned()));
            }
            sleep(BUSY_POLL).await;
        }
        self.busy_until = None;
        Ok(())
    }

    /// The program whose next cycle this is.
    fn next_program(&self, cycle: u32, doing: &str) -> Result<ShotProgram, DriverError> {
        match (&self.programmed, self.next_cycle) {
            (Some(program), Some(next)) if next == cycle && cycle < program.cycles => Ok(program.clone()),
            _ => Err(self.refused(doing, format!("cycle {cycle} is not the next one of the program"))),
        }
    }

    /// `due`, or later when the injection of a cycle that begins then would be too near to the last one.
    fn allowed_from(&self, program: &ShotProgram, due: Instant) -> Instant {
        match self.last_injection.next_allowed(&self.limits) {
            Some(allowed) if program.inject => {
                due.max(allowed.checked_sub(injection_after(program)).unwrap_or(allowed))
            }
            _ => due,
        }
    }

    fn refused(&self, doing: &str, why: String) -> DriverError {
        DriverError::refused(self.wire.name(), doing, why, PANEL_HINT)
    }
}

/// The question was heard, or may have been, and its answer will not come any more.
fn is_answer_lost(error: &DriverError) -> bool {
    matches!(
        error,
        DriverError::Silent { tries: 1, .. } | DriverError::Garbled { .. } | DriverError::Reopened { .. }
    )
}

/// Offset of the injection from the first delay cycle of its burst.
fn injection_after(program: &ShotProgram) -> Duration {
    let frames = u64::from(program.warm_up + program.blanks);
    Duration::from_nanos(program.period_ns * frames + program.injector_delay_ns)
}

#[async_trait]
impl TriggerUnit for Dg645 {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let doing = "asking who it is";
        let answer = self.query(Key::Identity, 0, doing).await?.encode();
        let identity = Identity::of_fields(&answer).filter(|identity| identity.model == "DG645");
        let identity = identity.ok_or_else(|| {
            self.wire.unexpected(doing, &answer, "expected maker, DG645, serial and version")
        })?;
        self.forget_errors(doing).await?;
        // That it was switched on at some time is no news: from here on it is.
        self.register(Key::EventStatus, doing).await?;
        Ok(identity)
    }

    async fn program(&mut self, program: &ShotProgram) -> Result<ShotProgram, DriverError> {
        let doing = "programming a burst";
        (self.programmed, self.next_cycle, self.is_ready) = (None, None, false);
        trigger_limits::check(self.wire.name(), program, &self.limits, &RANGE)?;
        self.forget_errors(doing).await?;
        if self.is_busy(doing).await? {
            return Err(self.refused(doing, "the unit still makes pulses".to_owned()));
        }
        self.check_inhibit(doing).await?;
        let settings = settings_of(program);
        for (key, index, value) in &settings {
            self.tell(&Command::set(*key, *index, value.clone()), doing).await?;
        }
        self.check_errors(doing).await?;
        for (place, setting) in settings.iter().enumerate() {
            let superseded =
                settings[place + 1..].iter().any(|later| (later.0, later.1) == (setting.0, setting.1));
            if !superseded {
                self.confirm(setting, doing).await?;
            }
        }
        self.register(Key::EventStatus, doing).await?;
        self.programmed = Some(program.clone());
        Ok(program.clone())
    }

    async fn start(&mut self) -> Result<Begun, DriverError> {
        let doing = "starting a burst";
        if self.programmed.is_none() {
            return Err(self.refused(doing, "no burst has been programmed since the last error".to_owned()));
        }
        self.check_power(doing).await?;
        if self.is_busy(doing).await? {
            return Err(self.refused(doing, "the unit still makes pulses".to_owned()));
        }
        self.register(Key::InstrumentStatus, doing).await?;
        (self.next_cycle, self.is_ready) = (Some(0), false);
        let now = Instant::now();
        Ok(Begun { earliest: now, latest: now })
    }

    fn is_begun_by_cycle(&self) -> bool {
        true
    }

    async fn ready_cycle(&mut self, cycle: u32, due: Instant) -> Result<Instant, DriverError> {
        let doing = "preparing a cycle";
        let program = self.next_program(cycle, doing)?;
        self.is_ready = false;
        self.check_power(doing).await?;
        self.await_rest(doing).await?;
        // Emptied, so that what it says after the trigger is about this trigger.
        let before = match self.query_once(Key::InstrumentStatus, 0, doing).await {
            Ok(Value::Count(bits)) => bits,
            _ => self.register(Key::InstrumentStatus, doing).await?,
        };
        if before & instrument_status::RATE != 0 {
            let why = "it was triggered while its burst ran: somebody else triggers it, or a delay is longer than \
                       the period";
            return Err(self.refused(doing, why.to_owned()));
        }
        self.is_ready = true;
        Ok(self.allowed_from(&program, due))
    }

    async fn begin_cycle(&mut self, cycle: u32, due: Instant) -> Result<Begun, DriverError> {
        let doing = "beginning a cycle";
        let program = self.next_program(cycle, doing)?;
        let due = self.allowed_from(&program, due);
        if !self.is_ready {
            sleep_until(due.checked_sub(PREPARATION).unwrap_or(due)).await;
            self.ready_cycle(cycle, due).await?;
        }
        sleep_until(due).await;
        (self.next_cycle, self.is_ready) = (Some(cycle + 1), false);
        self.note_fired(&program);
        // Sent once: repeated it might be a second burst.
        let told = self.wire.tell(&Command::act(Key::Trigger).encode(), doing).await;
        // The line may have kept its pace first: the burst begins when the command has gone.
        let earliest = self.note_fired(&program);
        match told {
            Err(error) if !error.is_reopened() => return Err(error),
            _ => {}
        }
        let asked = self.query_once(Key::InstrumentStatus, 0, doing).await;
        let fired = Begun { earliest, latest: Instant::now() };
        match asked {
            Ok(Value::Count(bits)) if bits & instrument_status::TRIGGER != 0 => Ok(fired),
            Ok(Value::Count(bits)) if bits & instrument_status::INHIBITED != 0 => {
                Err(self.refused(doing, "its inhibit input keeps it from triggering".to_owned()))
            }
            Ok(_) => Err(self.refused(doing, "told to trigger, it has seen no trigger".to_owned())),
            // Asked again the register would be empty. The camera's frames will tell.
            Err(error) if is_answer_lost(&error) || matches!(error, DriverError::Silent { .. }) => Ok(fired),
            Err(error) => Err(error),
        }
    }

    async fn running(&mut self) -> Result<bool, DriverError> {
        self.is_busy("asking whether pulses are made").await
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        self.halt("stopping the clock").await
    }

    async fn make_safe(&mut self) -> Result<(), DriverError> {
        self.programmed = None;
        self.halt("bringing it to its safe state").await
    }
}
